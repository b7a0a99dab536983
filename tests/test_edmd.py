"""The operator, its forecasts, and how states and successors are paired."""

import pickle
import subprocess
import sys
import warnings

import joblib
import numpy as np
import pandas as pd
import pytest
from designs import covering, every_pair
from reference import dense_least_squares, kernel_matrix, monomials
from scipy import linalg
from scipy.linalg import LinAlgWarning
from sklearn import config_context
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.gaussian_process.kernels import DotProduct
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import get_tags

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman._dynamics._operator import interpolate_operator
from sklearn_koopman._dynamics._spectrum import (
    best_weights,
    eigenvectors,
    measure,
    unpack,
)
from sklearn_koopman._linalg._systems import DirectSystem
from sklearn_koopman._matrices._sections import KernelSections
from sklearn_koopman.datasets import make_pendulum, make_walking
from sklearn_koopman.kernels import MaternSobolev, Wendland
from sklearn_koopman.trajectories import successor_rows

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

CHOICES = {
    "method": ["interpolation", "least_squares"],
    "trend": [None, "constant", "linear"],
    "alpha": [0.0, 1e-3],
    "centers": [None, SeparatedCenterSelector(0.4)],
}
SETTINGS = [dict(zip(CHOICES, row, strict=True)) for row in covering(**CHOICES)]


def name_of(setting):
    return " ".join(str(value) for value in setting.values())


@pytest.fixture(scope="module")
def pendulum():
    return make_pendulum(n_samples=256)


@pytest.fixture(scope="module")
def swings():
    """Ten pendulums of unequal length, from one state after another of random ones."""
    lengths = [23, 8, 31, 2, 17, 12, 40, 5, 9, 28]
    long = make_pendulum(
        40, initial="random", n_trajectories=len(lengths), random_state=0
    )
    return [
        trajectory[: length + 1]
        for trajectory, length in zip(long.trajectories, lengths, strict=True)
    ]


def relative(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


# The three forms of the estimate


@pytest.mark.parametrize("kernel", [MaternSobolev(1.0, 1.5), Wendland(4.0, 4)])
def test_edmd_matrix_of_the_paper(pendulum, kernel):
    """A = Psi(X+) (Psi(X)^T Psi(X))^-1 Psi(X)^T with N = M, applied to any g."""
    rows = SeparatedCenterSelector(0.23).fit(pendulum.X).center_indices_
    X, X_next = pendulum.X[rows], pendulum.X_next[rows]
    Psi, Psi_next = kernel(X), kernel(X, X_next)
    A = Psi_next @ linalg.solve(Psi.T @ Psi, Psi.T)  # as printed
    g = np.random.default_rng(0).standard_normal(len(rows))
    x = pendulum.X[1::7]
    model = KernelEDMD(kernel).fit(X, kernel(X_next, X) @ g, X_next=X_next)
    # g^T A psi(x) estimates g(f(x)); its outputs at the centres are those given here.
    expected = kernel(x, X) @ A.T @ g
    assert relative(model.predict(x), expected) < 1e-8
    # And further steps are further multiplications.
    for step in range(5):
        assert relative(model.forecast(x, 5)[:, step], expected) < 1e-8
        A_power = np.linalg.matrix_power(A.T, step + 2)
        expected = kernel(x, X) @ A_power @ g


def test_edmd_with_more_pairs_than_functions_is_least_squares(pendulum):
    kernel = MaternSobolev(1.0, 1.5)
    centers = pendulum.X[::8]
    Psi, Psi_next = kernel(pendulum.X, centers), kernel(pendulum.X_next, centers)
    A = np.linalg.lstsq(Psi, Psi_next, rcond=None)[0]
    g = np.random.default_rng(0).standard_normal(len(centers))
    model = KernelEDMD(kernel, centers=centers, method="least_squares")
    model.fit(pendulum.X, Psi_next @ g, X_next=pendulum.X_next)
    x = pendulum.X[1::7] + 0.01
    for step, y in enumerate(np.moveaxis(model.forecast(x, 4), 1, 0)):
        expected = kernel(x, centers) @ np.linalg.matrix_power(A, step + 1) @ g
        assert relative(y, expected) < 1e-8


def test_three_forms_of_the_estimate(pendulum):
    """Projection, operator and EDMD agree as far as they are the same thing."""
    kernel = Wendland(4.0, 4)
    rows = SeparatedCenterSelector(0.23).fit(pendulum.X).center_indices_
    xi, successors = pendulum.X[rows], pendulum.X_next[rows]
    x = pendulum.X[::5]
    u = pendulum.G(successors)
    K, K_next = kernel(xi), kernel(successors, xi)
    model = KernelEDMD(kernel).fit(xi, u, X_next=successors)
    # Form 1, the projection of U_f G.
    assert relative(model.predict(x), kernel(x, xi) @ linalg.solve(K, u)) < 1e-10
    # Form 2 approximates G by its interpolant at the centres first ...
    inner = K_next @ linalg.solve(K, pendulum.G(xi))
    operator = KernelEDMD(kernel).fit(xi, inner, X_next=successors).predict(x)
    coefficients = linalg.solve(K, K_next @ linalg.solve(K, pendulum.G(xi)))
    assert relative(operator, kernel(x, xi) @ coefficients) < 1e-10
    # ... which costs something, but no more than its fill distance allows.
    assert 1e-6 < np.abs(operator - model.predict(x)).max() < 1e-3
    # With the interpolant at the successors instead, it is form 1.
    pullback = KoopmanKernelRegressor(kernel).fit(successors, u)
    inner = pullback.predict(successors)
    same = KernelEDMD(kernel).fit(xi, inner, X_next=successors).predict(x)
    assert relative(same, model.predict(x)) < 1e-9


def test_pullback_estimate_of_the_outputs(pendulum):
    """The theorem on the pullback space: coefficients k(f(Xi), f(Xi))^-1 u."""
    kernel = MaternSobolev(1.0, 1.5)
    rows = SeparatedCenterSelector(0.23).fit(pendulum.X).center_indices_
    successors, u = pendulum.X_next[rows], pendulum.y[rows]
    model = KoopmanKernelRegressor(kernel).fit(successors, u)
    np.testing.assert_allclose(
        model.dual_coef_, linalg.solve(kernel(successors), u), rtol=1e-9
    )
    # It estimates G, not G o f.
    x = pendulum.X[40:60]
    assert np.abs(model.predict(x) - pendulum.G(x)).max() < 0.02
    assert np.abs(model.predict(x) - pendulum.G(pendulum.f(x))).max() > 0.1


# The operator against dense computations


@pytest.mark.parametrize("setting", SETTINGS, ids=name_of)
def test_operator_agrees_with_a_dense_computation(setting, pendulum):
    """Ridge regression with the polynomials unpenalised, on explicit matrices.

    The estimate minimises |y - K c - P b|^2 + alpha c^T K c with c orthogonal to the
    polynomials on the centres; the operator does so for every function of the space.
    """
    X, X_next, y = pendulum.X[::4], pendulum.X_next[::4], pendulum.y[::4]
    model = KernelEDMD("matern32", beta=1.0, **setting).fit(X, y, X_next=X_next)
    centers, trend = model.centers_, setting["trend"]

    def functions(x):
        kernels = kernel_matrix("matern32", x, centers)
        return np.hstack([kernels, monomials(x, trend)])

    rows = np.arange(len(X))
    if setting["method"] == "interpolation" and setting["centers"] is not None:
        rows = model.center_indices_
    solve = dense_least_squares(
        kernel_matrix("matern32", centers, centers),
        monomials(centers, trend),
        kernel_matrix("matern32", X[rows], centers),
        monomials(X[rows], trend),
        setting["alpha"],
    )
    c, A = solve @ y[rows], solve @ functions(X_next[rows])

    x = np.random.default_rng(1).uniform(-2, 2, (20, 2))
    for y_pred in np.moveaxis(model.forecast(x, 3), 1, 0):
        expected = functions(x) @ c
        assert relative(y_pred, expected) < 1e-7
        c = A @ c
    values = np.linalg.eigvals(A)
    for wanted in model.eigenvalues_[:5]:
        assert np.abs(values - wanted).min() < 1e-7


def test_koopman_matrix_is_similar_to_that_on_coefficients(pendulum):
    """L^T (K^-1 K+) L^-T, as the docstring says."""
    rows = SeparatedCenterSelector(0.23).fit(pendulum.X).center_indices_
    xi, successors = pendulum.X[rows], pendulum.X_next[rows]
    model = KernelEDMD("matern32", beta=1.0).fit(xi, X_next=successors)
    kernel = MaternSobolev(1.0, 1.5)
    K, K_next = kernel(xi), kernel(successors, xi)
    L = linalg.cholesky(K, lower=True)
    expected = L.T @ linalg.solve(K, K_next) @ linalg.inv(L.T)
    np.testing.assert_allclose(model.koopman_matrix_, expected, atol=1e-10)


@pytest.mark.parametrize("setting", SETTINGS, ids=name_of)
def test_eigenfunctions_and_modes(setting, pendulum):
    model = KernelEDMD("matern32", beta=2.0, **setting)
    model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    phi = model.eigenfunctions(pendulum.X)
    np.testing.assert_allclose(np.mean(np.abs(phi) ** 2, axis=0), 1.0, rtol=1e-6)
    assert phi.dtype == np.complex128
    leading = phi[0, :7]
    np.testing.assert_allclose(leading.imag, 0.0, atol=1e-6)
    assert (leading.real > 0).all()
    # They are carried by their eigenvalues, as far as the residuals say.
    phi_next = model.eigenfunctions(pendulum.X_next)
    errors = np.sqrt(np.mean(np.abs(phi_next - model.eigenvalues_ * phi) ** 2, axis=0))
    assert (errors[:5] < 10 * model.residuals_[:5] + 1e-9).all()
    # The modes expand the outputs.
    y = ((phi * model.eigenvalues_) @ model.modes_).real
    np.testing.assert_allclose(y, model.predict(pendulum.X), atol=1e-7)
    order = model.residuals_ / np.abs(model.eigenvalues_)
    assert (np.diff(order) > -1e-9 * order[:-1]).all()
    upper = np.flatnonzero(model.eigenvalues_.imag > 0)
    np.testing.assert_array_equal(
        model.eigenvalues_[upper + 1], model.eigenvalues_[upper].conj()
    )


def fresh_residuals(model, X, X_next):
    phi, phi_next = model.eigenfunctions(X), model.eigenfunctions(X_next)
    defect = np.mean(np.abs(phi_next - model.eigenvalues_ * phi) ** 2, axis=0)
    return np.sqrt(defect / np.mean(np.abs(phi) ** 2, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "kernel", ["matern32", pytest.param("wendland_c4", marks=pytest.mark.slow)]
)
def test_residuals_of_interpolation_are_honest(kernel):
    """What seems true on few states holds on fresh ones: chaos, and random walks."""
    rng = np.random.default_rng(0)
    maps = {
        "logistic": lambda x: 4 * x * (1 - x),
        "cat": lambda x: x @ [[2, 1], [1, 1]] % 1,
        "contraction": lambda x: np.tanh(0.8 * (x - 0.5)) + 0.5,
        "random": lambda x: 0.5 + 0.6 * (x - 0.5) + 0.2 * rng.standard_normal(x.shape),
    }
    for name, f in maps.items():
        d = 2 if name == "cat" else 1
        X, fresh = rng.uniform(0, 1, (300, d)), rng.uniform(0, 1, (5000, d))
        X_next, fresh_next = f(X), f(fresh)
        for centers in (None, SeparatedCenterSelector(0.02 if d == 1 else 0.08)):
            model = KernelEDMD(kernel, beta=1.0, centers=centers)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LinAlgWarning)
                model.fit(X, X_next=X_next)
            true = fresh_residuals(model, fresh, fresh_next)
            claimed = model.residuals_
            bad = np.flatnonzero((claimed < 0.05) & (true > 0.3))
            assert (bad > 100).all(), (name, centers)  # none that anyone would take
            # Among the first few there is nothing that vanishes at once.
            assert np.abs(model.eigenvalues_[:3]).min() > 0.05


@pytest.mark.parametrize("alpha", [0.0, pytest.param(1e-4, marks=pytest.mark.slow)])
def test_residuals_do_not_depend_on_outputs_being_given(alpha):
    """Least squares at every state: the clock leaves the last row without successor."""
    x = [0.3]
    for _ in range(300):
        x.append(3.9 * x[-1] * (1 - x[-1]))
    X = np.array(x)[:, np.newaxis]
    fresh = np.random.default_rng(0).uniform(X.min(), X.max(), (5000, 1))
    fresh_next = 3.9 * fresh * (1 - fresh)
    model = KernelEDMD("matern12", method="least_squares", alpha=alpha)
    model.fit(X, np.sin(X))
    true = fresh_residuals(model, fresh, fresh_next)
    assert np.sum((model.residuals_[:100] < 0.05) & (true[:100] > 0.3)) == 0


def test_residuals_of_a_finite_random_map():
    """Equal states with different successors are data: sqrt(1 - lambda^2)."""
    P = np.array([[0.7, 0.2, 0.1], [0.2, 0.6, 0.2], [0.1, 0.2, 0.7]])  # reversible
    rng = np.random.default_rng(0)
    states = [0]
    for _ in range(20_000):
        states.append(rng.choice(3, p=P[states[-1]]))
    model = KernelEDMD(beta=1.0).fit(np.eye(3)[states])
    expected = np.sort(np.linalg.eigvals(P).real)[::-1]
    np.testing.assert_allclose(model.eigenvalues_, expected, atol=0.02)
    np.testing.assert_allclose(
        model.residuals_, np.sqrt(np.maximum(1 - expected**2, 0)), atol=0.02
    )


def test_reduced_model_of_a_nearly_defective_operator():
    """Nearly parallel eigenfunctions: normal equations would lose all digits."""
    X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    X_next = X @ np.array([[0.9, 1.0], [0.0, 0.9]]).T
    for n_modes in (3, 4, 6, 10):
        model = KernelEDMD(
            "wendland_c2",
            beta=3.0,
            trend="linear",
            method="least_squares",
            centers=X[:30],
            n_modes=n_modes,
        ).fit(X, X_next=X_next)
        # Rounding makes the angle between eigenfunctions 1e-8 or more.
        np.testing.assert_allclose(model.predict(X), X_next, atol=1e-5)


# One step ahead


def test_prediction_is_of_the_next_state_not_of_the_present(pendulum):
    """A shift by hand: an off-by-one would be two thousand times worse."""
    trajectory = pendulum.trajectories[0]
    model = KernelEDMD("wendland_c4", beta=4.0).fit(trajectory)
    y = model.predict(trajectory[:-1])
    step = np.abs(trajectory[1:] - trajectory[:-1]).max()
    assert step > 0.1
    assert np.abs(y - trajectory[1:]).max() < 1e-10
    forecast = model.forecast(trajectory[:1], 200)[0]
    assert np.abs(forecast - trajectory[1:201]).max() < 1e-6
    assert np.abs(forecast - trajectory[:200]).max() > 0.1
    # Outputs given as y are those of the next step, too.
    model.fit(trajectory[:-1], pendulum.y)
    forecast = model.forecast(trajectory[:1], 100)[0]
    assert np.abs(forecast - pendulum.G(trajectory[1:101])).max() < 1e-6


# Forecasts


def brute_force(model, x, n_steps):
    """Interpolation without a trend, with dense inverses."""
    kernel, xi = model.kernel_, model.centers_
    successors, outputs = model._test_pairs
    B = linalg.solve(kernel(xi), kernel(successors, xi))
    c = linalg.solve(kernel(xi), outputs)
    steps = []
    for _ in range(n_steps):
        steps.append(kernel(x, xi) @ c)
        c = B @ c
    return np.stack(steps, axis=1)


@pytest.mark.parametrize("n_rows", [1, 3, 300])
@pytest.mark.parametrize("n_outputs", [None, 1, 3])
def test_forecast_by_either_route_equals_brute_force(pendulum, n_rows, n_outputs):
    rows = SeparatedCenterSelector(0.23).fit(pendulum.X).center_indices_
    outputs = np.cos(pendulum.X_next @ [[1.0, 2.0, 0.5], [0.3, -1.0, 1.0]])
    outputs = outputs[:, 0] if n_outputs is None else outputs[:, :n_outputs]
    model = KernelEDMD("wendland_c4", beta=4.0, centers=pendulum.X[rows])
    model.fit(pendulum.X, outputs, X_next=pendulum.X_next)
    model._test_pairs = pendulum.X_next[rows], outputs[rows]
    x = np.tile(pendulum.X, (2, 1))[:n_rows]
    expected = brute_force(model, x, 60)
    y = model.forecast(x, 60)
    assert y.shape == (n_rows, 60, *outputs.shape[1:])
    assert relative(y, expected) < 1e-8
    np.testing.assert_allclose(y[:, 0], model.predict(x), rtol=1e-12, atol=1e-14)
    # A few rows go by eigenvalues. Without a spectrum, all go by powers.
    assert relative(model.forecast(x[:2], 60), expected[:2]) < 1e-8
    model.set_params(n_modes=0).fit(pendulum.X, outputs, X_next=pendulum.X_next)
    assert relative(model.forecast(x, 60), expected) < 1e-8


@pytest.mark.slow
def test_forecast_of_more_steps_than_a_block(pendulum):
    model = KernelEDMD("wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23))
    model.fit(pendulum.X, X_next=pendulum.X_next)
    x, n_steps = pendulum.X[:2], 60_000
    by_modes = model.forecast(x, n_steps)
    model.set_params(n_modes=0).fit(pendulum.X, X_next=pendulum.X_next)
    by_powers = model.forecast(x, n_steps)
    shown = np.arange(0, n_steps, 997)
    B = np.linalg.solve(
        model.kernel_(model.centers_),
        model.kernel_(pendulum.X_next[model.center_indices_], model.centers_),
    )
    eigenvalues, vectors = np.linalg.eig(B)
    u = pendulum.X_next[model.center_indices_]
    first = np.linalg.solve(model.kernel_(model.centers_), u)
    start = model.kernel_(x, model.centers_) @ vectors
    weights = np.linalg.solve(vectors, first)
    powers = eigenvalues[:, np.newaxis] ** shown
    expected = np.einsum("im,ms,mo->iso", start, powers, weights).real
    # Phases of the orbit drift by rounding in every step.
    tolerance = 1e-9 * (1 + shown[:, np.newaxis] / 100)
    for y in (by_modes, by_powers):
        assert (np.abs(y[:, shown] - expected) < tolerance).all()


def test_relifted_forecast_iterates_the_state_map(pendulum):
    centers = SeparatedCenterSelector(0.1)
    model = KernelEDMD("wendland_c4", beta=4.0, centers=centers)
    model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    states = clone(model).fit(pendulum.X, X_next=pendulum.X_next)
    x, expected = pendulum.X[[0, 50]], []
    for _ in range(20):
        expected.append(model.predict(x))
        x = states.predict(x)
    y = model.forecast(pendulum.X[[0, 50]], 20, relift=True)
    np.testing.assert_allclose(y, np.stack(expected, axis=1), rtol=1e-8)


@pytest.mark.parametrize("relift", [False, True])
@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_a_thousand_steps_on_the_orbit(method, relift):
    """256 samples are three rounds; twelve more follow."""
    long = make_pendulum(1256)
    X, X_next = long.X[:256], long.X_next[:256]
    model = KernelEDMD(
        "wendland_c4",
        beta=4.0,
        centers=SeparatedCenterSelector(0.1),
        method=method,
        trend="linear",
    ).fit(X, X_next=X_next)
    y = model.forecast(long.X[:256:50], 1000, relift=relift)
    truth = np.stack([long.X_next[i : i + 1000] for i in range(0, 256, 50)])
    assert np.abs(y - truth).max() < 2e-3


def test_diverging_forecast_warns_once_and_returns_what_it_computed():
    x = np.linspace(-1, 1, 30)[:, np.newaxis]
    model = KernelEDMD("gaussian", trend="linear", centers=x[::6])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.fit(x, X_next=2 * x)
    for relift in (False, True):
        with pytest.warns(RuntimeWarning, match="diverge") as caught:
            y = model.forecast(x, 2000, relift=relift)
        assert len(caught) == 1
        expected = 2.0 ** np.arange(1, 11) * x
        np.testing.assert_allclose(y[:, :10, 0], expected, rtol=1e-6)
        assert np.isnan(y[0, -1, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.forecast(x, 8)


def test_reduced_model_is_consistent(pendulum):
    """Prediction, forecast, modes and matrix tell the same."""
    for n_modes in range(1, 12):
        model = KernelEDMD(
            "wendland_c4",
            beta=4.0,
            centers=SeparatedCenterSelector(0.1),
            n_modes=n_modes,
        ).fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
        lam = model.eigenvalues_
        assert n_modes <= len(lam) <= n_modes + 1
        np.testing.assert_allclose(np.sort_complex(lam), np.sort_complex(lam.conj()))
        phi = model.eigenfunctions(pendulum.X)
        steps = model.forecast(pendulum.X, 9)
        np.testing.assert_allclose(steps[:, 0], model.predict(pendulum.X), atol=1e-12)
        for s in range(9):
            y = (phi * lam ** (s + 1)) @ model.modes_
            np.testing.assert_allclose(steps[:, s], y.real, atol=1e-10)
        values = np.linalg.eigvals(model.koopman_matrix_)
        np.testing.assert_allclose(
            np.sort(np.abs(np.angle(values))), np.sort(np.abs(np.angle(lam))), atol=1e-9
        )
        assert model.modes_.shape == lam.shape == model.residuals_.shape


def test_more_modes_approximate_better_and_all_of_them_exactly(pendulum):
    def error(n_modes):
        model = KernelEDMD(
            "wendland_c4",
            beta=4.0,
            centers=SeparatedCenterSelector(0.1),
            n_modes=n_modes,
        ).fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
        truth = make_pendulum(456).y[200:456]
        return np.abs(model.forecast(pendulum.X, 201)[:, -1] - truth).max()

    errors = [error(n) for n in (1, 3, 5, 9, 13, 1000)]
    assert (np.diff(errors) < 0).all()
    assert errors[0] > 0.3
    assert errors[-1] < 2e-4
    assert error(None) == errors[-1]


def test_without_modes_there_is_no_spectrum_but_the_same_forecast(pendulum):
    whole = KernelEDMD("wendland_c4", beta=4.0).fit(pendulum.X)
    bare = KernelEDMD("wendland_c4", beta=4.0, n_modes=0).fit(pendulum.X)
    assert bare.eigenvalues_.shape == bare.residuals_.shape == (0,)
    assert bare.modes_.shape == (0, 2)
    x = pendulum.X[:3]
    np.testing.assert_allclose(bare.forecast(x, 50), whole.forecast(x, 50), atol=1e-8)
    with pytest.raises(ValueError, match="n_modes=0"):
        bare.eigenfunctions(x)
    with pytest.raises(ValueError, match="n_modes=0"):
        bare.continuous_eigenvalues(0.1)


def test_continuous_eigenvalues():
    """A damped oscillation of 1.5 Hz that falls by e^-0.4 a second, at 50 Hz."""
    rate, damping, frequency = 50.0, 0.4, 1.5
    angle = 2 * np.pi * frequency / rate
    F = np.exp(-damping / rate) * np.array(
        [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    )
    x = [np.array([1.0, 0.0])]
    for _ in range(60):
        x.append(F @ x[-1])
    model = KernelEDMD("wendland_c2", beta=0.5, trend="linear").fit(np.array(x))
    growth_rates, frequencies = model.continuous_eigenvalues(1 / rate)
    # Residuals of rounding errors have no order.
    order = np.argsort(-growth_rates[:3], kind="stable")
    growth_rates, frequencies = growth_rates[order], frequencies[order]
    np.testing.assert_allclose(growth_rates, [0, -damping, -damping], atol=1e-8)
    np.testing.assert_allclose(frequencies[:3], [0, frequency, -frequency], atol=1e-8)


def test_continuous_eigenvalues_of_nothing_left():
    """An eigenvalue of zero decays at once."""
    model = KernelEDMD("wendland_c0", beta=0.5).fit(
        [[0.0], [2.0]], X_next=[[2.0], [9.0]]
    )
    np.testing.assert_array_equal(model.eigenvalues_, [0, 0])
    growth_rates, frequencies = model.continuous_eigenvalues(0.1)
    np.testing.assert_array_equal(growth_rates, [-np.inf, -np.inf])
    np.testing.assert_array_equal(frequencies, [0, 0])
    np.testing.assert_array_equal(model.modes_, np.zeros((2, 1)))
    np.testing.assert_array_equal(model.forecast([[0.0]], 3)[0, :, 0], [2, 9, 0])


# Pairing


def test_ten_trajectories_equal_their_explicit_pairs(swings):
    pairs = trajectory_pairs(swings)
    X = np.vstack(swings)
    # The clock of the concatenation: each trajectory with a gap to the next.
    index = np.concatenate(
        [1000 * number + np.arange(len(x)) for number, x in enumerate(swings)]
    )
    explicit = KernelEDMD(trend="linear").fit(pairs.X, X_next=pairs.X_next)
    concatenated = KernelEDMD(trend="linear").fit(X, sample_index=index)
    np.testing.assert_array_equal(X[concatenated.center_indices_], pairs.X)
    np.testing.assert_array_equal(explicit.eigenvalues_, concatenated.eigenvalues_)
    np.testing.assert_array_equal(explicit.predict(X), concatenated.predict(X))
    np.testing.assert_array_equal(
        explicit.forecast(X[:5], 30), concatenated.forecast(X[:5], 30)
    )
    # Without the clock, the last row of one would lead to the first of the next.
    apart = KernelEDMD(trend="linear").fit(X).predict(X) - explicit.predict(X)
    assert np.abs(apart[len(swings[0]) - 1]).max() > 0.1


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("with_outputs", [False, True])
def test_shuffled_rows_equal_ordered_ones(swings, method, with_outputs):
    X = np.vstack(swings)
    index = np.concatenate(
        [1000 * number + np.arange(len(x)) for number, x in enumerate(swings)]
    )
    y = np.sin(X[:, :1]) if with_outputs else None
    order = np.random.default_rng(0).permutation(len(X))
    settings = {"method": method, "alpha": 1e-6, "centers": X[:-1:3][:60]}
    rows = np.isin(np.arange(len(X)), successor_rows(index)[0])
    settings["centers"] = X[rows][::3]
    ordered = KernelEDMD(**settings).fit(X, y, sample_index=index)
    shuffled = KernelEDMD(**settings).fit(
        X[order], None if y is None else y[order], sample_index=index[order]
    )
    np.testing.assert_allclose(
        np.sort_complex(shuffled.eigenvalues_[:9]),
        np.sort_complex(ordered.eigenvalues_[:9]),
        atol=1e-9,
    )
    np.testing.assert_allclose(shuffled.predict(X), ordered.predict(X), atol=1e-9)


def test_consecutive_rows_are_one_trajectory(pendulum):
    trajectory = pendulum.trajectories[0]
    settings = {"kernel": "wendland_c4", "beta": 4.0}
    consecutive = KernelEDMD(**settings).fit(trajectory)
    explicit = KernelEDMD(**settings).fit(trajectory[:-1], X_next=trajectory[1:])
    clock = KernelEDMD(**settings).fit(trajectory, sample_index=range(5, 262))
    for model in (explicit, clock):
        np.testing.assert_array_equal(model.eigenvalues_, consecutive.eigenvalues_)
        np.testing.assert_array_equal(
            model.predict(trajectory), consecutive.predict(trajectory)
        )


def test_rows_without_successor_serve_for_outputs_and_are_no_centres():
    """Only they tell the output near 2; only linked rows tell the operator."""
    rng = np.random.default_rng(0)
    linked = rng.uniform(-1, 1, (80, 1))
    alone = rng.uniform(1, 2, (40, 1))
    X = np.vstack([linked, 0.9 * linked, alone])
    index = np.concatenate(
        [3 * np.arange(80), 3 * np.arange(80) + 1, 1000 + 2 * np.arange(40)]
    )
    y = X**3
    for centers in (
        None,
        SeparatedCenterSelector(0.02),
        np.linspace(-1, 2, 20)[:, None],
    ):
        model = KernelEDMD(
            "gaussian", beta=1.0, centers=centers, method="least_squares", alpha=1e-8
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            model.fit(X, y, sample_index=index)
            without = clone(model).fit(X[:160], y[:160], sample_index=index[:160])
        x = np.array([[1.7]])
        assert (
            np.abs(model.predict(x) - x**3) < 1e-3 < np.abs(without.predict(x) - x**3)
        )
        np.testing.assert_allclose(
            model.koopman_matrix_, without.koopman_matrix_, atol=1e-6
        )
        if not isinstance(centers, np.ndarray):
            assert (model.center_indices_ < 80).all()
            np.testing.assert_array_equal(model.centers_, X[model.center_indices_])


def test_equal_states_with_different_successors_are_a_random_map():
    """A coin decides between x/2 and -x/2: the mean of a function over both."""
    x = np.linspace(-1, 1, 12)[:, np.newaxis]
    X, X_next = np.vstack([x, x]), np.vstack([x / 2, -x / 2])
    model = KernelEDMD("gaussian", beta=0.3).fit(X, X_next=X_next)
    np.testing.assert_allclose(model.predict(x), np.zeros((12, 1)), atol=1e-12)
    # Its square loses no sign: an output that is random only through the state.
    model.fit(X, np.abs(X_next).ravel(), X_next=X_next)
    np.testing.assert_allclose(model.predict(x), np.abs(x).ravel() / 2, atol=1e-9)
    kernel = model.kernel_
    K = kernel(x)
    K_next = (kernel(x / 2, x) + kernel(-x / 2, x)) / 2
    values = np.linalg.eigvals(linalg.solve(K, K_next))
    for wanted in model.eigenvalues_[:4]:
        assert np.abs(values - wanted).min() < 1e-6


@pytest.mark.parametrize(
    ("index", "rows", "successors"),
    [
        ([0, 1, 2], [0, 1], [1, 2]),
        ([5, 3, 4, 9, 10], [1, 2, 3], [2, 0, 4]),
        ([2.0, 1.0], [1], [0]),
        ([7, 9, 11], [], []),
        ([-1, 0], [0], [1]),
        (np.array([2, 1, 0], dtype=np.uint8), [1, 2], [0, 1]),
        ([], [], []),
    ],
)
def test_successor_rows(index, rows, successors):
    found = successor_rows(index)
    np.testing.assert_array_equal(found[0], rows)
    np.testing.assert_array_equal(found[1], successors)


# Pipelines


def same_eigenvalues(a, b):
    """Compare sets, since nearly equal residuals may change places."""
    distance = np.abs(a.eigenvalues_[:, np.newaxis] - b.eigenvalues_)
    return max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-9


def clock(trajectories):
    return np.concatenate(
        [1000 * number + np.arange(len(x)) for number, x in enumerate(trajectories)]
    )


def test_scaler_in_front_changes_no_eigenvalue_with_sample_index(swings):
    """Isotropic: after division by the spread, the scaler's factors are all 100."""
    X = np.vstack(swings)
    X = 100 * X / X.std(axis=0) + 700
    index = clock(swings)
    order = np.random.default_rng(0).permutation(len(X))
    rows = successor_rows(index)[0]
    centers = SeparatedCenterSelector(30.0).fit(X[rows]).cluster_centers_
    settings = {"trend": "linear", "method": "least_squares"}
    plain = KernelEDMD("wendland_c4", beta=400.0, centers=centers, **settings)
    plain.fit(X, sample_index=index)
    scaled = StandardScaler().fit(X).transform(centers)
    pipeline = make_pipeline(
        StandardScaler(),
        KernelEDMD("wendland_c4", beta=4.0, centers=scaled, **settings),
    )
    pipeline.fit(X[order], kerneledmd__sample_index=index[order])
    assert same_eigenvalues(pipeline[-1], plain)
    wrong = make_pipeline(StandardScaler(), clone(pipeline[-1]))
    wrong.fit(X[order])  # as if the rows were in order
    assert not same_eigenvalues(wrong[-1], plain)
    # The default outputs are those states that the operator sees: scaled ones.
    y = pipeline[0].inverse_transform(pipeline.predict(X))
    np.testing.assert_allclose(y, plain.predict(X), rtol=1e-8)


@pytest.mark.parametrize("requested", [False, True])
def test_scaler_in_front_changes_no_eigenvalue_with_x_next(swings, requested):
    pairs = trajectory_pairs(swings)
    spread = pairs.X.std(axis=0)
    X, X_next = (100 * x / spread + 700 for x in (pairs.X, pairs.X_next))
    plain = KernelEDMD(
        "wendland_c4", beta=400.0, centers=SeparatedCenterSelector(30.0)
    ).fit(X, X_next=X_next)
    with config_context(enable_metadata_routing=True):
        edmd = KernelEDMD("wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.3))
        if requested:
            edmd.set_fit_request(X_next=True)
        pipeline = Pipeline(
            [("scale", StandardScaler()), ("edmd", edmd)], transform_input=["X_next"]
        ).fit(X, X_next=X_next)
    assert same_eigenvalues(pipeline["edmd"], plain)
    with pytest.warns(UserWarning, match="transform_input"):
        wrong = Pipeline([("scale", StandardScaler()), ("edmd", clone(edmd))]).fit(
            X, edmd__X_next=X_next
        )
    assert not same_eigenvalues(wrong["edmd"], plain)


def delayed_walking():
    angle = np.linspace(0, 30, 400)[:, np.newaxis]
    return [np.hstack([0.3 + 0.4 * np.sin(angle), 0.5 - 0.3 * np.cos(angle)])] * 2


@pytest.mark.parametrize(
    ("trajectories", "delays"),
    [
        (make_pendulum(100).trajectories, 1),  # spreads of 1.2 and 1.3
        (
            [  # spreads below 1.2 would be too near to those of scaled states
                2 * x
                for x in make_pendulum(
                    30, initial="random", n_trajectories=5, random_state=0
                ).trajectories
            ],
            2,
        ),
        (delayed_walking(), 3),  # less than one, and shifted
        ([1000 * x for x in delayed_walking()], 1),  # in mm, say
        ([x + 50 for x in delayed_walking()], 1),  # a shift alone
    ],
)
def test_unscaled_successors_warn(trajectories, delays):
    pairs = trajectory_pairs(trajectories, delays=delays)
    X = StandardScaler().fit_transform(pairs.X)
    with pytest.warns(UserWarning, match=r"another scale.*transform_input"):
        KernelEDMD(n_modes=0, alpha=1e-6).fit(X, X_next=pairs.X_next)


def scattered(matrix, n=60, d=2):
    X = np.random.default_rng(0).uniform(-1, 3, (n, d))
    return X, X @ np.atleast_2d(matrix).T


def lagged(x, lag):
    x = x.reshape(len(x), -1)
    return x[:-lag], x[lag:]


t = np.arange(200.0)
swing = make_pendulum(200).trajectories[0]
grid = np.linspace(-1, 1, 40)[:, np.newaxis]
turns = np.arange(400)[:, np.newaxis]
spiral = np.exp(-0.01 * turns) * np.cos(turns * 2 * np.pi / 21 - [[0, np.pi / 2]])
LEGITIMATE = {
    "contraction": scattered(np.diag([0.5, 0.05])),
    "rotation": scattered([[0.6, -0.8], [0.8, 0.6]]),
    "expansion": scattered(2.0 * np.eye(2)),
    "grid": (grid, 0.5 * grid + 3),
    "logistic": (grid / 2 + 0.5, 4 * (grid / 2 + 0.5) * (0.5 - grid / 2)),
    "every third sample": (make_pendulum(90).X[::3], make_pendulum(90).X_next[::3]),
    "every second of a spiral": (spiral[:-1:2], spiral[1::2]),
    "constant feature": scattered(np.diag([0.5, 0.0])),
    "noise": (
        np.random.default_rng(1).standard_normal((50, 3)),
        np.random.default_rng(2).standard_normal((50, 3)),
    ),
    "trajectories": (make_pendulum(50).X, make_pendulum(50).X_next),
    "one feature grows": scattered(np.diag([40.0, 1.0])),
    "all come to rest": scattered(np.zeros((2, 2))),
    "still at first": lagged(
        np.column_stack([np.r_[np.zeros(600), np.sin(t / 5)], np.sin(np.arange(800))]),
        1,
    ),
    "one pair": (np.ones((1, 2)), np.zeros((1, 2))),
    "fixed point": (np.ones((20, 2)), np.ones((20, 2))),
}


@pytest.mark.parametrize("pairs", LEGITIMATE.values(), ids=LEGITIMATE)
def test_successors_on_the_same_scale_do_not_warn(pairs):
    X, X_next = pairs
    KernelEDMD(n_modes=0, alpha=1e-6).fit(X, X_next=X_next)  # warnings are errors


@pytest.mark.parametrize(("lag", "delays", "delay_step"), [(1, 1, 1), (3, 3, 5)])
@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize(
    "trajectories",
    [
        make_pendulum(256).trajectories,
        make_pendulum(
            30, initial="random", n_trajectories=5, random_state=0
        ).trajectories,
        make_walking(speeds=[0.8, 1.2], n_strides=5, random_state=0).trajectories,
        [spiral],
    ],
    ids=["pendulum", "pendulums", "walking", "spiral"],
)
def test_motion_that_was_scaled_with_its_successors_does_not_warn(
    trajectories, every, lag, delays, delay_step
):
    """Its means and spreads change only where successors are later states, too."""
    pairs = trajectory_pairs(
        trajectories, lag=lag, delays=delays, delay_step=delay_step
    )
    X, X_next = pairs.X[::every], pairs.X_next[::every]
    scaler = StandardScaler().fit(X)
    centers = SeparatedCenterSelector(0.5)
    model = KernelEDMD(centers=centers, method="least_squares", alpha=0.1, n_modes=0)
    model.fit(scaler.transform(X), X_next=scaler.transform(X_next))


def scaled(X, X_next):
    return (X - X.mean(axis=0)) / X.std(axis=0), X_next


short = trajectory_pairs(
    make_pendulum(4, initial="random", n_trajectories=17, random_state=1).trajectories
)
UNSCALED = {
    "40 times": scattered(40 * np.eye(2)),
    "a fortieth": scattered(np.eye(2) / 40),
    "lag": scaled(*lagged(swing, 3)),
    "short trajectories": scaled(short.X, short.X_next),
}


@pytest.mark.parametrize("pairs", UNSCALED.values(), ids=UNSCALED)
def test_successors_in_other_units_warn(pairs):
    X, X_next = pairs
    with pytest.warns(UserWarning, match=r"another scale.*transform_input"):
        KernelEDMD(n_modes=0, alpha=1e-6).fit(X, X_next=X_next)


def test_clock_vouches_for_the_scale_of_successors():
    x = np.random.default_rng(0).uniform(1, 2, (10, 1))
    index = np.concatenate([3 * np.arange(10), 3 * np.arange(10) + 1])
    X = np.vstack([x, 40 * x])
    KernelEDMD(n_modes=0).fit(X, X_next=40 * X, sample_index=index)  # no warning


def test_successors_and_clock_agree_up_to_rounding():
    X = np.column_stack([np.cos(np.pi / 2 * t[:12]), np.sin(np.pi / 2 * t[:12])])
    X += 1e-3 * t[:12, np.newaxis]
    model = KernelEDMD(n_modes=0, alpha=1e-3)
    model.fit(X[:-1], X_next=X[1:] + 1e-8, sample_index=range(11))
    X[:, 0] -= X[1, 0]  # a state of zero, up to rounding
    model.fit(X[:-1], X_next=X[1:] + 1e-8, sample_index=range(11))
    with pytest.raises(ValueError, match="contradict each other"):
        model.fit(X[:-1], X_next=1.01 * X[1:], sample_index=range(11))


def test_search_in_a_pipeline_over_trajectories(swings):
    X, index = np.vstack(swings), clock(swings)
    groups = index // 1000
    y = np.sin(X[:, 1])
    grid = {
        "edmd__centers__separation": [0.05, 0.3],
        "edmd__kernel": ["matern32", "wendland_c4"],
    }
    pipeline = Pipeline(
        [
            ("scale", StandardScaler()),
            ("edmd", KernelEDMD(centers=SeparatedCenterSelector(), beta=4.0)),
        ]
    )
    search = GridSearchCV(pipeline, grid, cv=TrajectoryKFold(5), error_score="raise")
    off = clone(search).fit(X, y, groups=groups, edmd__sample_index=index)
    with config_context(enable_metadata_routing=True):
        on = clone(search).fit(X, y, groups=groups, sample_index=index)
    np.testing.assert_array_equal(
        off.cv_results_["mean_test_score"], on.cv_results_["mean_test_score"]
    )
    assert off.best_params_ == {
        "edmd__centers__separation": 0.05,
        "edmd__kernel": "wendland_c4",
    }


# Pickles


def test_pickle_holds_the_operator_and_its_eigenfunctions(pendulum):
    settings = {"kernel": "wendland_c4", "beta": 4.0}
    whole = KernelEDMD(**settings).fit(pendulum.X, X_next=pendulum.X_next)
    matrix = 8 * whole.rank_**2
    before = whole.eigenfunctions(pendulum.X)
    whole.forecast(pendulum.X[:2], 100)  # all that is computed when first needed
    assert 2 * matrix < len(pickle.dumps(whole)) < 2.1 * matrix
    loaded = pickle.loads(pickle.dumps(whole))
    np.testing.assert_array_equal(loaded.eigenfunctions(pendulum.X), before)
    reduced = KernelEDMD(**settings, n_modes=6).fit(pendulum.X, X_next=pendulum.X_next)
    assert len(pickle.dumps(reduced)) < 0.15 * matrix
    loaded = pickle.loads(pickle.dumps(reduced))
    np.testing.assert_array_equal(
        loaded.forecast(pendulum.X, 20), reduced.forecast(pendulum.X, 20)
    )
    np.testing.assert_array_equal(
        loaded.eigenfunctions(pendulum.X), reduced.eigenfunctions(pendulum.X)
    )


@pytest.mark.parametrize("n_modes", [60, 120, 180, 250])
def test_pickle_of_fewer_modes_is_smaller(pendulum, n_modes):
    model = KernelEDMD("wendland_c4", beta=4.0, n_modes=n_modes)
    model.fit(pendulum.X, X_next=pendulum.X_next)
    matrix = 8 * len(model.centers_) ** 2
    # The eigenfunctions, and the matrix that acts on them.
    share = n_modes / 256
    assert len(pickle.dumps(model)) < (share + share**2 + 0.15) * matrix
    loaded = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(loaded.koopman_matrix_, model.koopman_matrix_)


def test_start_far_outside_is_no_divergence():
    """A linear map that contracts: 5000, 2500, and so on."""
    x = np.linspace(-1, 1, 30)[:, np.newaxis]
    model = KernelEDMD("wendland_c2", trend="linear", n_modes=0).fit(x, X_next=x / 2)
    y = model.forecast([[1e4]], 8)  # warnings are errors
    np.testing.assert_allclose(y[0, :, 0], 1e4 * 0.5 ** np.arange(1, 9))


@pytest.mark.slow
def test_another_process_forecasts_the_same_bits(pendulum, tmp_path):
    model = KernelEDMD("wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.1))
    model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    x = pendulum.X[[0, 9]]
    joblib.dump(model, tmp_path / "model.joblib")
    np.save(tmp_path / "x.npy", x)
    code = (
        "import joblib, numpy as np\n"
        "model, x = joblib.load('model.joblib'), np.load('x.npy')\n"
        "np.savez('y.npz', many=model.forecast(x, 300), one=model.predict(x),\n"
        "         relift=model.forecast(x, 9, relift=True),\n"
        "         phi=model.eigenfunctions(x))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    with np.load(tmp_path / "y.npz") as y:
        # There by powers, since the spectrum is not pickled; here by eigenvalues.
        np.testing.assert_allclose(y["many"], model.forecast(x, 300), rtol=1e-9)
        np.testing.assert_array_equal(y["one"], model.predict(x))
        np.testing.assert_array_equal(y["relift"], model.forecast(x, 9, relift=True))
        np.testing.assert_array_equal(y["phi"], model.eigenfunctions(x))


# Bad input


BAD = {
    "both kinds of successor": (
        {},
        {"X_next": np.ones((6, 2)), "sample_index": range(6)},
        r"X_next and sample_index contradict each other.*transform_input",
    ),
    "X_next of another length": ({}, {"X_next": np.ones((5, 2))}, r"X_next has shape"),
    "X_next of other features": ({}, {"X_next": np.ones((6, 3))}, r"X_next has shape"),
    "NaN in X_next": ({}, {"X_next": np.full((6, 2), np.nan)}, r"X_next contains NaN"),
    "no successors": ({}, {"sample_index": range(0, 12, 2)}, r"links none of the n_sa"),
    "equal indices": ({}, {"sample_index": [0, 1, 2, 2, 3, 4]}, r"rows 2 and 3 both"),
    "fractions": ({}, {"sample_index": np.arange(6) / 2}, r"must hold integers"),
    "NaN index": ({}, {"sample_index": [0, 1, 2, 3, 4, np.nan]}, r"hold integers"),
    "words": ({}, {"sample_index": list("abcdef")}, r"array of integers"),
    "short index": ({}, {"sample_index": range(5)}, r"shape \(5,\), but X has 6 rows"),
    "wide index": ({}, {"sample_index": np.ones((6, 1))}, r"one-dimensional"),
    "infinite index": ({}, {"sample_index": np.full(6, np.inf)}, r"not exact"),
    "huge index": ({}, {"sample_index": 1e17 + np.arange(6)}, r"not exact"),
    "flat X_next": ({}, {"X_next": np.ones(6)}, r"X_next has shape \(6,\)"),
    "huge X_next": ({}, {"X_next": np.full((6, 2), 1e200)}, r"X_next has values up to"),
    "huge outputs": ({}, {"y": np.full(6, 1e200)}, r"y has values up to"),
    "distances": ({"centers": "precomputed"}, {}, r"needs the states"),
    "negative modes": ({"n_modes": -1}, {}, r"n_modes must be an integer"),
    "half a mode": ({"n_modes": 2.5}, {}, r"n_modes must be an integer"),
    "truth as modes": ({"n_modes": True}, {}, r"n_modes must be an integer"),
    "unknown kernel": ({"kernel": "matern"}, {}, r"kernel"),
    "zero beta": ({"beta": 0.0}, {}, r"beta"),
    "negative alpha": ({"alpha": -1.0}, {}, r"alpha"),
    "unknown method": ({"method": "dmd"}, {}, r"method must be"),
    "unknown trend": ({"trend": "quadratic"}, {}, r"trend must be"),
    "unknown solver": ({"solver": "qr"}, {}, r"solver must be"),
    "centres of another dimension": ({"centers": np.ones((3, 5))}, {}, r"5 features"),
    "centres that are no rows": ({"centers": np.full((3, 2), 9.0)}, {}, r"no rows of"),
    "a centre without successor": (
        {"centers": np.array([[5.0, 25.0]])},
        {},
        r"no rows of X.*\(Rows are counted among the 5 with a successor\.\)",
    ),
    "more centres than rows": (
        {"method": "least_squares", "centers": np.arange(20.0).reshape(10, 2)},
        {},
        r"alpha=0 needs at least as many rows",
    ),
    "dependent centres": (
        {"solver": "cholesky", "kernel": "gaussian", "beta": 1e6},
        {},
        r"not positive definite|misses its values",
    ),
}


@pytest.mark.parametrize(("parameters", "arguments", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_refused_and_leaves_the_former_fit(parameters, arguments, message):
    X = np.column_stack([np.arange(6.0), np.arange(6.0) ** 2])
    model = KernelEDMD().fit(X)
    before = model.predict(X)
    with pytest.raises(ValueError, match=message):
        model.set_params(**parameters).fit(X, **arguments)
    np.testing.assert_array_equal(
        model.set_params(**KernelEDMD().get_params()).predict(X), before
    )
    unfitted = KernelEDMD(**parameters)
    with pytest.raises(ValueError, match=message):
        unfitted.fit(X, **arguments)
    with pytest.raises(NotFittedError):
        unfitted.forecast(X, 2)


def test_successors_have_the_columns_of_the_states(pendulum):
    X = pd.DataFrame(pendulum.X, columns=["p", "q"])
    X_next = pd.DataFrame(pendulum.X_next, columns=["p", "q"])
    model = KernelEDMD(n_modes=0).fit(X, X_next=X_next)
    assert list(model.feature_names_in_) == ["p", "q"]
    with pytest.raises(ValueError, match=r"X_next has the columns \['q', 'p'\]"):
        model.fit(X, X_next=X_next[["q", "p"]])


def test_successors_and_clock_together(swings):
    """As a search needs, whose scorer asks for the clock."""
    pairs = trajectory_pairs(swings)
    both = KernelEDMD().fit(
        pairs.X, X_next=pairs.X_next, sample_index=pairs.sample_index
    )
    one = KernelEDMD().fit(pairs.X, X_next=pairs.X_next)
    np.testing.assert_array_equal(both.koopman_matrix_, one.koopman_matrix_)


def test_one_row_is_no_trajectory():
    with pytest.raises(ValueError, match=r"n_samples=1.*X_next"):
        KernelEDMD().fit([[1.0, 2.0]])
    model = KernelEDMD().fit([[1.0, 2.0]], X_next=[[3.0, 4.0]])
    np.testing.assert_allclose(model.predict([[1.0, 2.0]]), [[3.0, 4.0]])


@pytest.mark.parametrize("n_steps", [0, -1, 1.5, True, "ten", None])
def test_number_of_steps(n_steps, pendulum):
    model = KernelEDMD(n_modes=0).fit(pendulum.X[:20])
    with pytest.raises(ValueError, match="n_steps must be an integer of at least 1"):
        model.forecast(pendulum.X, n_steps)


@pytest.mark.parametrize("relift", ["no", None, 1])
def test_relift_is_yes_or_no(relift, pendulum):
    model = KernelEDMD(n_modes=0).fit(pendulum.X[:20])
    with pytest.raises(ValueError, match="relift must be True or False"):
        model.forecast(pendulum.X, 2, relift=relift)


@pytest.mark.parametrize("dt", [0, -0.1, np.nan, np.inf, "second", True])
def test_time_step(dt, pendulum):
    model = KernelEDMD().fit(pendulum.X[:20])
    with pytest.raises(ValueError, match="dt must be a finite positive number"):
        model.continuous_eigenvalues(dt)


def test_dependent_centres_are_left_out_with_a_warning(pendulum):
    model = KernelEDMD("gaussian", beta=2.0)
    with pytest.warns(LinAlgWarning, match="were left out") as caught:
        model.fit(pendulum.X, X_next=pendulum.X_next)
    assert len(caught) == 1
    assert model.rank_ == len(model.koopman_matrix_) == len(model.centers_) < 100
    # What is left still knows the orbit.
    assert np.abs(model.predict(pendulum.X) - pendulum.X_next).max() < 1e-5
    assert model.residuals_[:3].max() < 1e-5


def test_refitting_forgets_the_former_fit(pendulum):
    model = KernelEDMD("wendland_c4", beta=4.0, trend="linear", n_modes=3)
    model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    model.eigenfunctions(pendulum.X)
    parameters = {"trend": None, "n_modes": None, "kernel": "matern32"}
    model.set_params(**parameters).fit(pendulum.X[:50])
    fresh = clone(model).fit(pendulum.X[:50])
    assert vars(model).keys() == vars(fresh).keys()
    np.testing.assert_array_equal(
        model.eigenfunctions(pendulum.X), fresh.eigenfunctions(pendulum.X)
    )
    np.testing.assert_array_equal(
        model.forecast(pendulum.X, 5), fresh.forecast(pendulum.X, 5)
    )


@every_pair(
    method=["interpolation", "least_squares"],
    alpha=[0.0, 1e-3],
    trend=[None, "linear"],
    centers=[None, SeparatedCenterSelector(0.23)],
    one_output=[False, True],
)
def test_uncertainty_one_step_ahead_is_that_of_the_regressor(
    pendulum, method, alpha, trend, centers, one_output
):
    y = pendulum.y if one_output else pendulum.X_next
    settings = {"kernel": "matern52", "beta": 4.0, "method": method, "alpha": alpha}
    settings |= {"trend": trend, "centers": centers}
    model = KernelEDMD(**settings).fit(pendulum.X, y, X_next=pendulum.X_next)
    regressor = KoopmanKernelRegressor(**settings).fit(pendulum.X, y)
    x = pendulum.X[:50] + 0.05
    expected, expected_std = regressor.predict(x, return_std=True)
    predicted, std = model.predict(x, return_std=True)
    assert std.shape == predicted.shape == expected.shape
    np.testing.assert_allclose(predicted, expected, atol=1e-7)
    np.testing.assert_allclose(std, expected_std, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(model.signal_std_, regressor.signal_std_, rtol=1e-5)
    np.testing.assert_allclose(
        model.noise_std_, regressor.noise_std_, rtol=1e-5, atol=1e-7
    )
    P, expected = model.power_function(x), regressor.power_function(x)
    np.testing.assert_allclose(P**2, expected**2, rtol=1e-6, atol=1e-12)
    loaded = pickle.loads(pickle.dumps(model))
    np.testing.assert_allclose(loaded.predict(x, return_std=True)[1], std, rtol=1e-9)


# Limits and rare cases


def test_matrix_of_a_reduced_model_acts_on_parts_of_eigenfunctions(pendulum):
    """Also the sign between both parts of a pair, which no eigenvalue tells."""
    model = KernelEDMD(
        "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.1), n_modes=5
    ).fit(pendulum.X, X_next=pendulum.X_next)
    now, then = (
        np.where(model.eigenvalues_.imag < 0, -phi.imag, phi.real)
        for phi in (model.eigenfunctions(x) for x in (pendulum.X, pendulum.X_next))
    )
    np.testing.assert_allclose(now @ model.koopman_matrix_, then, atol=1e-3)


def test_reduced_model_is_the_best_in_mean_square(pendulum):
    model = KernelEDMD("matern32", beta=1.0, centers=pendulum.X[::16], n_modes=5)
    model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    whole = clone(model).set_params(n_modes=None)
    whole.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    phi = model.eigenfunctions(pendulum.X)
    parts = np.hstack([phi.real, phi.imag])
    y = whole.predict(pendulum.X)
    best = parts @ np.linalg.lstsq(parts, y, rcond=None)[0]
    assert np.abs(best - y).max() > 1e-3  # the other modes are missed
    np.testing.assert_allclose(model.predict(pendulum.X), best, atol=1e-9)


def test_blocks_of_rows_add_up(pendulum):
    """What is measured on many rows does not depend on how many are held at once."""
    X, X_next = pendulum.X, pendulum.X_next
    sections = KernelSections(Wendland(4.0, 4, 3), X[:40:2])
    system = DirectSystem(sections, np.zeros(20), 1, "cholesky")
    rows, group = np.arange(0, 40, 2), np.arange(len(X)) // 2
    whole = interpolate_operator(system, X_next, X_next, rows, group)
    parts = interpolate_operator(system, X_next, X_next, rows, group, block_entries=60)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_allclose(other, one, atol=1e-9)
    eigenvalues, vectors = eigenvectors(whole[0])
    functions, counted = system.expand(vectors), np.arange(len(X)) % 3 == 0
    once = measure(functions, eigenvalues, X, X_next, counted)
    for one, other in zip(
        once,
        measure(functions, eigenvalues, X, X_next, counted, block_entries=100),
        strict=True,
    ):
        np.testing.assert_allclose(other, one, rtol=1e-9)
    targets, few = system.expand(whole[1]), functions.take(slice(0, 5))
    kept = eigenvalues[:5]
    if kept[-1].imag > 0:  # a conjugate pair stays together
        few, kept = functions.take(slice(0, 6)), eigenvalues[:6]
    weights = best_weights(few, kept, targets, X)
    divided = best_weights(few, kept, targets, X, block_entries=100)
    values = unpack(few(X), kept)
    np.testing.assert_allclose(values @ divided, values @ weights, atol=1e-8)


def test_defective_operator_has_bounded_modes():
    """K = I and K+ = ((a, b), (0, a)): both eigenvectors are one."""
    model = KernelEDMD("wendland_c0", beta=1.0)
    model.fit([[0.0], [1.0]], X_next=[[0.75], [1.75]])
    np.testing.assert_array_equal(model.eigenvalues_, [0.0625, 0.0625])
    assert np.abs(model.modes_).max() < 10


def test_polynomials_that_the_centres_do_not_determine():
    """Two centres in three dimensions."""
    rng = np.random.default_rng(0)
    X, F = rng.uniform(-1, 1, (40, 3)), 0.5 * rng.standard_normal((3, 3))
    model = KernelEDMD(trend="linear", method="least_squares", centers=X[:2])
    with pytest.raises(ValueError, match="2 independent centres do not determine"):
        model.fit(X, X_next=X @ F)
    model = KernelEDMD(trend="linear").fit(X[:2], X_next=X[:2] @ F)
    assert model.rank_ == 2
    np.testing.assert_allclose(model.predict(X[:2]), X[:2] @ F, atol=1e-12)


def test_feature_that_is_constant():
    """One polynomial vanishes everywhere, and has no size to be divided by."""
    x = np.random.default_rng(0).uniform(-1, 1, (40, 1))
    X, X_next = np.insert(x, 1, 3.0, axis=1), np.insert(0.5 * x, 1, 3.0, axis=1)
    model = KernelEDMD(trend="linear", method="least_squares", centers=X[::4])
    model.fit(X, X_next=X_next)
    assert np.isfinite(model.modes_).all()
    np.testing.assert_allclose(model.forecast(X[:3], 50)[..., 1], 3.0)


def test_modes_of_eigenvalues_that_vanish_up_to_rounding():
    for seed in range(3):
        X = np.random.default_rng(seed).uniform(-1, 1, (40, 2))
        model = KernelEDMD(DotProduct(1.0), centers=X[:3])
        model.fit(X, X_next=X @ np.array([[0.9, 0.6], [-0.3, -0.2]]))  # of rank one
        lost = np.abs(model.eigenvalues_) < 1e-14
        assert lost.sum() == 1
        np.testing.assert_array_equal(model.modes_[lost], 0)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_divergence_is_told_by_step_and_output(scale):
    """2 ** s passes 2000 in step 11, however large another output is."""
    x = np.linspace(-1, 1, 30)[:, np.newaxis]
    model = KernelEDMD("gaussian", trend="linear", centers=x[::6])
    model.fit(x, np.hstack([2 * x, np.full((30, 1), scale)]), X_next=2 * x)
    message = "^2 of 2 forecasts diverge, the first at step 11: .* 1000 times"
    with pytest.warns(RuntimeWarning, match=message):
        model.forecast([[1.0], [-0.9]], 15)


@pytest.mark.parametrize("n_modes", [0, 2])
def test_what_cannot_be_followed_is_nan(n_modes):
    """By powers, and by eigenvalues, whose powers overflow."""
    x = np.linspace(-1, 1, 30)[:, np.newaxis]
    model = KernelEDMD("gaussian", trend="linear", centers=x[::6], n_modes=n_modes)
    model.fit(x, X_next=2 * x)
    with pytest.warns(RuntimeWarning, match="diverge"):
        y = model.forecast(x, 2000)
    assert not np.isinf(y).any()
    assert np.isnan(y[:, -1]).all()
    np.testing.assert_allclose(y[:, 9, 0], 2.0**10 * x[:, 0], rtol=1e-6)


def test_rows_without_successor_change_no_interpolant():
    rng = np.random.default_rng(0)
    linked, alone = rng.uniform(-1, 1, (20, 1)), rng.uniform(1, 2, (10, 1))
    X = np.vstack([linked, 0.9 * linked, alone])
    clock = 3 * np.arange(20)
    index = np.concatenate([clock, clock + 1, 100 + 2 * np.arange(10)])
    y = np.sin(5 * X)
    model = KernelEDMD(beta=1.0).fit(X, y, sample_index=index)
    pairs = KernelEDMD(beta=1.0).fit(linked, y[:20], X_next=0.9 * linked)
    np.testing.assert_array_equal(model.predict(X), pairs.predict(X))


def test_outputs_of_all_rows_are_those_of_the_regressor():
    """Least squares with a clock: the last row of a trajectory has an output, too."""
    X = make_pendulum(60, step=0.02).X
    y = np.sin(3 * X[:, 0])
    settings = {"centers": X[:-1:4], "method": "least_squares", "alpha": 0.1}
    settings["beta"] = 1.0
    model = KernelEDMD(**settings).fit(X, y, sample_index=range(60))
    regressor = KoopmanKernelRegressor(**settings).fit(X, y)
    np.testing.assert_allclose(model.predict(X), regressor.predict(X), rtol=1e-9)
    # Without centres, all rows that have a successor are, however near to each other.
    model.set_params(centers=None).fit(X, y, sample_index=range(60))
    np.testing.assert_array_equal(model.center_indices_, range(59))


@pytest.mark.parametrize("given", [False, True])
def test_chosen_centres_take_the_mean_of_equal_rows(given):
    x = np.linspace(-1, 1, 12)[:, np.newaxis]
    centers = x if given else SeparatedCenterSelector(0.01)
    model = KernelEDMD("gaussian", beta=0.3, centers=centers)
    model.fit(np.vstack([x, x]), X_next=np.vstack([x / 2, x / 4]))
    np.testing.assert_allclose(model.predict(x), 3 * x / 8, atol=1e-9)
    np.testing.assert_allclose(model.forecast(x, 2)[:, 1], 9 * x / 64, atol=1e-3)


def test_outputs_are_optional_by_the_tags():
    assert not get_tags(KernelEDMD()).target_tags.required


def test_rows_are_counted_aloud_only_where_some_have_no_successor():
    X = np.arange(6.0)[:, np.newaxis]
    with pytest.raises(ValueError, match="no rows of X") as caught:
        KernelEDMD(centers=[[9.0]]).fit(X, X_next=X)
    assert "are counted" not in str(caught.value)
