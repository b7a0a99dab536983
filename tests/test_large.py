"""Conjugate gradients, against dense factorisations and closed forms."""

import pickle
import warnings

import numpy as np
import pytest
from designs import every_pair
from reference import attainable_residual, dense_interpolant, monomials, squared_power
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process.kernels import (
    RBF,
    DotProduct,
    Kernel,
    Matern,
    NormalizedKernelMixin,
    StationaryKernelMixin,
    WhiteKernel,
)
from sklearn.model_selection import GridSearchCV
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_koopman import KernelEDMD, KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman._linalg._conjugate_gradient import POWER_STEPS, conjugate_gradients
from sklearn_koopman._linalg._iterative import MAX_DENSITY_TO_HOLD, IterativeSystem
from sklearn_koopman._linalg._preconditioners import (
    banded_solver,
    bandwidth,
    low_rank_inverse,
    neighbor_preconditioner,
    pivoted_factor,
)
from sklearn_koopman._linalg._systems import is_dense_affordable
from sklearn_koopman._matrices._sections import KernelSections, sparse_tree
from sklearn_koopman._matrices._sparse import cross, density, gram, kd_tree
from sklearn_koopman.kernels import KERNELS, Gaussian, MaternSobolev, Wendland
from sklearn_koopman.solvers import ConjugateGradient

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

RNG = np.random.default_rng(0)
SQUARE = RNG.uniform(size=(700, 2))
STATES = RNG.normal(size=(220, 2))
ELSEWHERE = STATES[:25] + 0.05


def outputs(X, n_outputs=3):
    columns = [np.sin(3 * X[:, 0]), np.cos(2 * X[:, -1]) + 5.0, X[:, 0] ** 2 - X[:, -1]]
    return np.column_stack(columns)[:, :n_outputs]


Y = outputs(STATES)


def attainable(dense, X, y):
    """Return the relative residual that rounding allows the iterative solver.

    The systems are those that conjugate gradients are given, as dense matrices.
    """
    states, first, group, counts = np.unique(
        X, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    y = np.reshape(y, (len(X), -1)).astype(float)
    centers, alpha, trend = dense.centers_, dense.alpha, dense.trend
    K, P = dense.kernel_(centers), monomials(centers, trend)
    if len(centers) == len(states):
        means = np.zeros((len(states), y.shape[1]))
        np.add.at(means, group.ravel(), y)
        order = np.argsort(first)  # centres are in the order of the rows
        means, counts = (means / counts[:, np.newaxis])[order], counts[order]
        return attainable_residual(K + np.diag(alpha / counts), means, P)
    # Normal equations, and the random vectors that estimate the trace.
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(X), 16))
    k, T = dense.kernel_(X, centers), monomials(X, trend)
    rest = k - T @ np.linalg.lstsq(T, k, rcond=None)[0]
    A = k.T @ rest + alpha * K
    return attainable_residual(A, rest.T @ np.hstack([y, signs]), P)


def both(X, y, solver=None, **parameters):
    """The same estimate by conjugate gradients and by a dense factor."""
    dense = KoopmanKernelRegressor(solver="pivoted_cholesky", **parameters).fit(X, y)
    if solver is None:
        # Four times what rounding allows, and 1e-12 where it allows that.
        solver = ConjugateGradient(tol=max(1e-12, 4 * attainable(dense, X, y)))
    iterative = KoopmanKernelRegressor(solver=solver, **parameters).fit(X, y)
    assert isinstance(iterative.solver_, ConjugateGradient)
    assert dense.solver_ == "pivoted_cholesky"
    return iterative, dense


def assert_agree(X, y, at, solver=None, tol=1e-8, **parameters):
    iterative, dense = both(X, y, solver, **parameters)
    size = np.maximum(np.abs(y).max(axis=0), np.finfo(float).tiny)
    difference = np.abs(iterative.predict(at) - dense.predict(at))
    if solver is None:  # it is proportional to the residual
        tol *= iterative.solver_.tol / 1e-12
    assert (difference / size).max() < tol
    assert iterative.solver_residual_ <= iterative.solver_.tol
    P, expected = iterative.power_function(at), dense.power_function(at)
    # Squared, since the root of what rounding leaves is large.
    assert (P**2 - expected**2).min() > -1e-11 * max(1.0, expected.max() ** 2)
    np.testing.assert_allclose(P**2, expected**2, rtol=1e-9, atol=1e-9)
    assert (np.abs(iterative.signal_std_ - dense.signal_std_) / size).max() < 1e-6
    if parameters.get("trend") is not None:
        np.testing.assert_allclose(
            iterative.trend_coef_,
            dense.trend_coef_,
            atol=1e-7 * max(np.abs(y).max(), 1e-300) / np.abs(X).max(),
            rtol=1e-7,
        )
    return iterative, dense


@pytest.mark.slow
@parametrize_with_checks([KoopmanKernelRegressor(solver=ConjugateGradient())])
def test_scikit_learn_check_of_interpolation(estimator, check):
    check(estimator)


@pytest.mark.slow
@parametrize_with_checks(
    [
        KoopmanKernelRegressor(
            centers=SeparatedCenterSelector(0.5),
            method="least_squares",
            solver=ConjugateGradient(),
            trend="constant",
        )
    ]
)
def test_scikit_learn_check_of_least_squares(estimator, check):
    check(estimator)


# Agreement with the dense solver.


@every_pair(
    trend=[None, "constant", "linear"],
    alpha=[0.0, 1e-3, 1.0, 1e10],
    preconditioner=["auto", "neighbors", "nystroem"],
)
def test_interpolation(trend, alpha, preconditioner):
    solver = ConjugateGradient(tol=1e-12, preconditioner=preconditioner, rank=150)
    model, dense = assert_agree(
        STATES, Y, ELSEWHERE, solver, beta=0.5, alpha=alpha, trend=trend
    )
    np.testing.assert_allclose(model.noise_std_, dense.noise_std_, rtol=1e-8)
    np.testing.assert_allclose(model.dual_coef_, dense.dual_coef_, atol=1e-7)
    assert not hasattr(model, "rcond_")


@every_pair(
    trend=[None, "constant", "linear"],
    alpha=[0.0, 1e-6, 1.0, 1e10],
    kernel=["matern12", "matern32", "wendland_c2"],
)
def test_least_squares_at_chosen_centres(trend, alpha, kernel):
    model, dense = assert_agree(
        STATES,
        Y,
        ELSEWHERE,
        kernel=kernel,
        beta=0.8,
        alpha=alpha,
        trend=trend,
        centers=SeparatedCenterSelector(0.3),
        method="least_squares",
    )
    # The effective number of parameters is estimated, of 220 rows.
    np.testing.assert_allclose(model.noise_std_, dense.noise_std_, rtol=0.05)
    if alpha == 0:
        np.testing.assert_allclose(model.noise_std_, dense.noise_std_, rtol=1e-8)


@pytest.mark.parametrize("preconditioner", ["auto", "neighbors", "nystroem"])
def test_smooth_kernel_with_noise_takes_few_iterations(preconditioner):
    solver = ConjugateGradient(preconditioner=preconditioner)
    model, _ = assert_agree(
        STATES, Y, ELSEWHERE, solver, kernel="gaussian", beta=0.7, alpha=1e-2
    )
    if preconditioner != "neighbors":
        assert model.n_iter_ <= 3


def test_nystroem_of_low_rank():
    # Half of the eigenvalues are left to the shift.
    solver = ConjugateGradient(preconditioner="nystroem", rank=60)
    model, _ = assert_agree(STATES, Y, ELSEWHERE, solver, beta=1.0, alpha=1e-2)
    assert 5 < model.n_iter_ < 120
    few = ConjugateGradient(preconditioner="nystroem", rank=5)
    worse, _ = assert_agree(STATES, Y, ELSEWHERE, few, beta=1.0, alpha=1e-2)
    assert worse.n_iter_ > model.n_iter_


def test_auto_takes_columns_only_where_they_suffice():
    def has_neighbors(alpha=1e-2, **parameters):
        sections = KernelSections(Gaussian(1.0), STATES)
        solver = ConjugateGradient(**parameters)
        nugget = np.full(220, alpha)
        return IterativeSystem(sections, nugget, None, solver).W is not None

    assert not has_neighbors()
    assert has_neighbors(rank=10)
    assert not has_neighbors(rank=10, preconditioner="nystroem")
    assert has_neighbors(preconditioner="neighbors")
    assert has_neighbors(alpha=0.0)


@every_pair(
    kernel=[
        1.5 * RBF(0.3) + WhiteKernel(0.1),
        2.0 * Matern(1.0, nu=1.5),
        MaternSobolev(1.0) + WhiteKernel(1e-2),
        RBF([1.0, 5.0]) + WhiteKernel(0.01),
        DotProduct() + WhiteKernel(1.0),
        Wendland(0.5) * MaternSobolev(1.0),
    ],
    method=["interpolation", "least_squares"],
    trend=[None, "linear"],
)
def test_foreign_kernels(kernel, method, trend):
    centers = None if method == "interpolation" else STATES[:60]
    assert_agree(
        STATES,
        Y,
        ELSEWHERE,
        kernel=kernel,
        alpha=0.01,
        method=method,
        trend=trend,
        centers=centers,
    )


@every_pair(
    alpha=[1e-2, 3.0], method=["interpolation", "least_squares"], trend=[None, "linear"]
)
def test_equal_rows_count(alpha, method, trend):
    X = np.vstack([STATES, STATES[:50], STATES[:20]])
    y = np.vstack([Y, Y[:50] + 0.1, Y[:20] - 0.3])
    model, dense = assert_agree(
        X, y, ELSEWHERE, alpha=alpha, method=method, trend=trend
    )
    assert len(model.centers_) == 220
    np.testing.assert_allclose(model.noise_std_, dense.noise_std_, rtol=1e-8)
    # Three rows at one state have a third of alpha.
    K = model.kernel_(model.centers_)
    weight = alpha / np.repeat([3.0, 2.0, 1.0], [20, 30, 170])
    values = model.predict(model.centers_) + weight[:, np.newaxis] * model.dual_coef_
    mean = Y + np.repeat([-0.2 / 3, 0.05, 0.0], [20, 30, 170])[:, np.newaxis]
    np.testing.assert_allclose(values, mean, atol=1e-8)
    assert K.shape == (220, 220)


COMPACT = {
    "square": SQUARE,
    "curve": np.column_stack(
        [np.cos(np.linspace(0, 6, 700)), np.sin(np.linspace(0, 9, 700))]
    ),
    "line in 10-D": np.outer(np.linspace(0, 1, 700), RNG.normal(size=10)),
    "cube in 6-D": RNG.uniform(size=(700, 6)),
    "interval": RNG.uniform(size=(700, 1)),
    "lattice": np.stack(np.meshgrid(*2 * [np.arange(26) / 26]), -1).reshape(-1, 2),
    "clusters": np.vstack([SQUARE[:350], 1e6 + SQUARE[350:]]),
}


@pytest.mark.parametrize("place", COMPACT)
@pytest.mark.parametrize("preconditioner", ["auto", "banded", "neighbors"])
def test_compact_support(place, preconditioner):
    X = COMPACT[place]
    beta = {"cube in 6-D": 0.6, "interval": 0.03}.get(place, 0.0625)
    at = X[::31] + 0.01 * RNG.normal(size=X[::31].shape)
    solver = ConjugateGradient(tol=1e-12, preconditioner=preconditioner)
    model, _ = assert_agree(
        X, outputs(X), at, solver, kernel="wendland_c2", beta=beta, alpha=1e-4
    )
    sections = KernelSections(model.kernel_, X)
    assert sparse_tree(sections, X, MAX_DENSITY_TO_HOLD) is not None
    if preconditioner == "banded":  # a direct solution, and refinements of it
        assert model.n_iter_ <= 4


@pytest.mark.parametrize("beta", [1e-8, 0.03, 10.0])
@pytest.mark.parametrize("preconditioner", ["auto", "banded", "neighbors", "nystroem"])
def test_identity_and_full_matrices(beta, preconditioner):
    solver = ConjugateGradient(preconditioner=preconditioner)
    states = SQUARE[:300]
    for trend in (None, "linear"):
        model, _ = assert_agree(
            states,
            outputs(states),
            states[:20] + 0.01,
            solver,
            kernel="wendland_c0",
            beta=beta,
            alpha=1e-2,
            trend=trend,
        )
        if beta < 1e-6 and trend is None:
            np.testing.assert_allclose(
                model.dual_coef_, outputs(states) / 1.01, rtol=1e-10
            )


@pytest.mark.parametrize(
    ("beta", "trend"),
    [
        (1e-8, None),
        (1e-8, "linear"),
        (0.08, "linear"),
        pytest.param(0.05, None, marks=pytest.mark.slow),
        pytest.param(0.05, "linear", marks=pytest.mark.slow),
        pytest.param(0.08, None, marks=pytest.mark.slow),
    ],
)
def test_sparse_least_squares(beta, trend):
    rows = np.random.default_rng(1).uniform(size=(400, 2))
    X = np.vstack([SQUARE[:250], rows])
    assert_agree(
        X,
        outputs(X),
        rows[:30],
        kernel="wendland_c2",
        beta=beta,
        alpha=1e-2,
        trend=trend,
        centers=SQUARE[:250],
        method="least_squares",
    )


@pytest.mark.parametrize("trend", [None, "constant", "linear"])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 12])
def test_fewer_centres_than_neighbours_and_polynomials(n, trend):
    for y in (Y[:n], np.full((n, 1), 3.0)):
        assert_agree(STATES[:n], y, ELSEWHERE, trend=trend)
    parameters = {
        "trend": trend,
        "method": "least_squares",
        "centers": STATES[:n],
        "alpha": 0.1,
    }
    if trend == "linear" and n < 3:
        for solver in (ConjugateGradient(), "pivoted_cholesky"):
            model = KoopmanKernelRegressor(solver=solver, **parameters)
            with pytest.raises(ValueError, match=rf"the {n} independent centres do no"):
                model.fit(STATES, Y)
    else:
        assert_agree(STATES, Y, ELSEWHERE, **parameters)


@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_centres_on_a_line_in_many_dimensions(trend):
    X = np.outer(np.linspace(0, 5, 150), np.random.default_rng(2).normal(size=10))
    assert_agree(
        X, outputs(X), X[:20] * 1.003, kernel="matern12", trend=trend, beta=2.0
    )


@pytest.mark.parametrize("trend", [None, "linear"])
def test_clusters_far_apart(trend):
    X = np.vstack([STATES[:100], STATES[100:] + 1e6])
    assert_agree(X, Y, X[:30] + 0.01, trend=trend, beta=1.0)


def test_centres_that_nearly_coincide():
    X = np.vstack([STATES, STATES[:5] + 1e-12])
    y = np.vstack([Y, Y[:5]])
    assert_agree(X, y, ELSEWHERE, alpha=1e-6)
    # Not positive definite up to rounding, but for the roughest kernel.
    assert_agree(X, y, ELSEWHERE, kernel="matern12")
    with pytest.raises((ValueError, ConvergenceWarning), match=r"residual (of )?\d"):
        KoopmanKernelRegressor(solver=ConjugateGradient()).fit(X, y)
    X = np.vstack([SQUARE, SQUARE[:5] + 1e-12])
    y = np.append(np.ones(700), np.zeros(5))
    model = KoopmanKernelRegressor(
        "wendland_c2", beta=0.1, solver=ConjugateGradient(preconditioner="banded")
    )
    with pytest.raises(ValueError, match=r"not positive definite.*separation"):
        model.fit(X, y)


@pytest.mark.parametrize(
    ("unit", "method"),
    [
        (1e-200, "interpolation"),
        (1e-100, "least_squares"),
        (1e100, "interpolation"),
        (1e200, "least_squares"),
    ],
)
def test_units_of_the_states(unit, method):
    states = SQUARE[:300]
    centers = None if method == "interpolation" else states[:120] * unit
    for kernel in ("matern32", "wendland_c2"):
        if kernel == "wendland_c2" and not 1e-150 < unit < 1e150:
            continue  # the kd-tree of SciPy squares distances
        model = KoopmanKernelRegressor(
            kernel,
            beta=0.2 * unit,
            method=method,
            centers=centers,
            alpha=1e-2,
            solver=ConjugateGradient(),
        ).fit(states * unit, outputs(states))
        expected = clone(model).set_params(
            beta=0.2, centers=None if centers is None else states[:120]
        )
        expected.fit(states, outputs(states))
        np.testing.assert_allclose(
            model.predict(states * unit), expected.predict(states), atol=1e-7
        )
        assert abs(model.n_iter_ - expected.n_iter_) <= 5


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_units_of_the_outputs(method, trend):
    model = KoopmanKernelRegressor(
        beta=0.5,
        solver=ConjugateGradient(),
        method=method,
        trend=trend,
        alpha=1e-2,
        centers=None if method == "interpolation" else STATES[:80],
    )
    one = clone(model).fit(STATES, Y[:, 0])
    expected = one.predict(ELSEWHERE)[:, np.newaxis]
    # The smallest and the largest have squares out of range, also of a product.
    scales = np.array([1e-200, 1e-160, 1e-140, 1.0, 1e12, 1e140, 1e149])
    y = np.column_stack([Y[:, :1] * scales, np.zeros(len(Y))])
    together = clone(model).fit(STATES, y)
    found = together.predict(ELSEWHERE)
    assert not found[:, -1].any()
    found = found[:, :-1] / scales
    np.testing.assert_allclose(found, np.tile(expected, (1, 7)), rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        together.signal_std_[2:-1], one.signal_std_ * scales[2:], rtol=1e-7
    )
    assert 0 < together.solver_residual_ <= 1e-10
    for unit in (1e-149, 1e149):
        alone = clone(model).fit(STATES, Y[:, :1] * unit)
        np.testing.assert_allclose(
            alone.predict(ELSEWHERE) / unit, expected, rtol=0, atol=1e-8
        )
    for unit in (1e-200, 1e200):
        with pytest.raises(ValueError, match=r"^y has values up to .*rescale y"):
            clone(model).fit(STATES, Y * unit)


@pytest.mark.parametrize("value", [0.0, 3.0, -1e9])
@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_outputs_that_the_polynomials_tell(value, method):
    centers = None if method == "interpolation" else STATES[:70]
    for trend in ("constant", "linear"):
        y = np.full(len(STATES), value)
        if trend == "linear":
            y = y + STATES @ [2.0, -1.0]
        model = KoopmanKernelRegressor(
            trend=trend, centers=centers, method=method, solver=ConjugateGradient()
        ).fit(STATES, y)
        np.testing.assert_allclose(
            model.predict(STATES), y, rtol=1e-12, atol=1e-11 * np.abs(y).max()
        )
        np.testing.assert_allclose(model.dual_coef_, 0, atol=1e-9 * abs(y).max())


def test_small_outputs_beside_a_large_constant():
    y = 1e8 + Y
    model, dense = both(STATES, y, trend="constant", beta=0.5)
    # Projections of 220 values of 1e8 have errors of as many units in the last place.
    np.testing.assert_allclose(
        model.predict(ELSEWHERE),
        dense.predict(ELSEWHERE),
        rtol=220 * np.finfo(float).eps,
    )


def test_no_outputs_take_no_iterations():
    model = KoopmanKernelRegressor(solver=ConjugateGradient()).fit(
        STATES, np.zeros(220)
    )
    assert model.n_iter_ == 0
    assert model.solver_residual_ == 0.0
    assert not model.predict(ELSEWHERE).any()


def test_integer_fortran_ordered_and_flat_arrays():
    X = np.random.default_rng(3).integers(0, 50, size=(100, 3))
    X = np.unique(X, axis=0)
    y = X[:, 0] % 7
    model, _ = assert_agree(X, y, X[:20] + 0.5, beta=10.0)
    assert model.dual_coef_.shape == (len(X),)
    assert model.predict(X).shape == y.shape
    assert np.ndim(model.signal_std_) == 0
    other = clone(model).fit(np.asfortranarray(X), y)
    np.testing.assert_allclose(other.dual_coef_, model.dual_coef_, rtol=1e-10)
    column = clone(model).fit(X, y[:, np.newaxis])
    assert column.predict(X).shape == (len(X), 1)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_threads(method):
    centers = None if method == "interpolation" else STATES[:63]
    parameters = {"beta": 0.5, "method": method, "centers": centers, "alpha": 0.1}
    solver = ConjugateGradient(tol=1e-12)
    alone = KoopmanKernelRegressor(solver=solver, **parameters)
    shared = clone(alone).set_params(n_jobs=2)
    alone.fit(STATES, Y)
    shared.fit(STATES, Y)
    size = np.abs(alone.dual_coef_).max()
    np.testing.assert_allclose(
        shared.dual_coef_, alone.dual_coef_, rtol=1e-6, atol=1e-8 * size
    )
    np.testing.assert_allclose(
        shared.predict(ELSEWHERE), alone.predict(ELSEWHERE), rtol=1e-9
    )


@pytest.mark.parametrize("n", [50, 60, 63])
def test_just_below_the_height_of_a_tile(n):
    assert_agree(STATES[:n], Y[:n], ELSEWHERE)


# What is said of convergence.


@pytest.mark.parametrize("tol", [1e-2, 1e-5, 1e-9])
@pytest.mark.parametrize("trend", [None, "linear"])
def test_residual_is_the_true_one(tol, trend):
    solver = ConjugateGradient(tol=tol, preconditioner="neighbors", n_neighbors=3)
    model = KoopmanKernelRegressor(
        beta=1.0, alpha=1e-3, trend=trend, solver=solver
    ).fit(STATES, Y)
    K = model.kernel_(STATES) + 1e-3 * np.eye(220)
    residual, size = Y - K @ model.dual_coef_, Y
    if trend is not None:
        P = np.column_stack([np.ones(220), STATES])
        Q, _ = np.linalg.qr(P)
        residual, size = residual - Q @ (Q.T @ residual), Y - Q @ (Q.T @ Y)
        np.testing.assert_allclose(P.T @ model.dual_coef_, 0, atol=1e-10)
    true = (np.linalg.norm(residual, axis=0) / np.linalg.norm(size, axis=0)).max()
    assert model.solver_residual_ == pytest.approx(true, rel=1e-3)
    assert 1e-4 * tol < true <= tol + attainable(model, STATES, Y)
    assert model.n_iter_ >= 1


def test_a_tighter_tolerance_takes_more_iterations():
    def fitted(tol):
        return KoopmanKernelRegressor(solver=ConjugateGradient(tol=tol)).fit(STATES, Y)

    assert fitted(1e-2).n_iter_ < fitted(1e-5).n_iter_ < fitted(1e-11).n_iter_


def test_too_few_iterations():
    solver = ConjugateGradient(max_iter=2)
    model = KoopmanKernelRegressor(solver=solver, beta=3.0)
    with pytest.warns(ConvergenceWarning, match=r"ended after 2 iter.*max_iter"):
        model.fit(STATES, Y)
    assert model.n_iter_ == 2
    assert 1e-10 < model.solver_residual_ < 1
    dense = KoopmanKernelRegressor(beta=3.0).fit(STATES, Y)
    with pytest.warns(ConvergenceWarning, match=r"power function is too large"):
        P = model.power_function(ELSEWHERE)
    # Too large, never too small.
    expected = dense.power_function(ELSEWHERE)
    assert (P - expected).min() > -1e-9
    assert P.max() > expected.max() + 1e-4
    assert (P <= 1 + 1e-12).all()
    with pytest.warns(ConvergenceWarning, match=r"power function is too large"):
        model.predict(ELSEWHERE, return_std=True)


NOISE = np.random.default_rng(21).normal(size=(220, 2))


@every_pair(
    kernel=["matern12", "matern32", "wendland_c2", "matern52"],
    y=[Y, NOISE],  # the latter are met by coefficients of alternating signs
    preconditioner=["auto", "banded", "neighbors", "nystroem"],
    method=["interpolation", "least_squares"],
)
def test_tolerance_below_rounding_is_no_failure(kernel, y, preconditioner, method):
    if preconditioner == "banded":
        kernel = "wendland_c2"
    solver = ConjugateGradient(tol=1e-17, preconditioner=preconditioner)
    parameters = {"beta": 0.5, "alpha": 1e-4, "method": method}
    if method == "least_squares":
        parameters["centers"] = STATES[:60]
    iterative, dense = both(STATES, y, solver, kernel=kernel, **parameters)
    assert (
        0 < iterative.solver_residual_ < 100 * max(attainable(dense, STATES, y), 1e-15)
    )
    difference = iterative.predict(ELSEWHERE) - dense.predict(ELSEWHERE)
    assert np.abs(difference).max() < 1e-8


def test_rounding_is_no_excuse_for_too_few_iterations():
    solver = ConjugateGradient(tol=1e-17, max_iter=3)
    model = KoopmanKernelRegressor(solver=solver, beta=0.5)
    with pytest.warns(ConvergenceWarning, match=r"after 3 iterations .*Raise max_iter"):
        model.fit(STATES, Y)
    assert model.solver_residual_ > 1e3 * attainable(model, STATES, Y)


def test_rounding_is_no_excuse_for_a_large_residual():
    # Of noise and a smooth kernel, rounding leaves a thousandth.
    model = KoopmanKernelRegressor("matern52", beta=20.0, solver=ConjugateGradient())
    with pytest.warns(ConvergenceWarning, match=r"is singular up to|Raise max_"):
        model.fit(STATES, NOISE)
    assert model.solver_residual_ > 1e-6


@pytest.mark.parametrize("trend", [None, "linear"])
def test_singular_matrices_are_not_passed_over(trend):
    model = KoopmanKernelRegressor(
        "gaussian", trend=trend, solver=ConjugateGradient(max_iter=100)
    )
    # Where rounding leads to is chance; that it is told is not.
    with pytest.raises((ValueError, ConvergenceWarning), match=r"residual .*alpha"):
        model.fit(STATES, Y)
    assert not hasattr(model, "dual_coef_")
    with pytest.warns(ConvergenceWarning):
        model.set_params(method="least_squares", centers=STATES[:50]).fit(STATES, Y)
    # Whatever the weights, the power function is finite, and no less than zero.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        P = model.power_function(ELSEWHERE)
    assert (P >= 0).all()
    if trend is None:
        assert (P <= 1).all()


@pytest.mark.parametrize(
    ("kernel", "alpha"), [("matern32", 0.0), ("wendland_c4", 0.3), ("gaussian", 1e-3)]
)
@pytest.mark.parametrize("trend", [None, "linear"])
def test_standard_deviation(kernel, alpha, trend):
    model, dense = both(STATES, Y, kernel=kernel, alpha=alpha, beta=0.5, trend=trend)
    X = np.vstack([ELSEWHERE, STATES[:10], STATES[:5] + 30.0])
    found, expected = (m.predict(X, return_std=True)[1] for m in (model, dense))
    assert found.shape == (40, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("degree", [None, 1])
def test_batches_of_the_power_function(degree):
    sections = KernelSections(MaternSobolev(0.5), STATES)
    system = IterativeSystem(sections, np.zeros(220), degree, ConjugateGradient())
    X = np.vstack([ELSEWHERE, ELSEWHERE + 0.1])
    whole = system.power(X)
    for batch_rows in (7, 50):
        found = system.power(X, batch_rows=batch_rows)
        np.testing.assert_allclose(found, whole, atol=1e-9)


@pytest.mark.parametrize("trend", [None, "constant"])
@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_pickle(trend, method):
    model = KoopmanKernelRegressor(
        "wendland_c2",
        beta=0.1,
        trend=trend,
        method=method,
        centers=None if method == "interpolation" else SQUARE[:600],
        alpha=0.01,
        solver=ConjugateGradient(),
    ).fit(SQUARE, outputs(SQUARE))
    at = SQUARE[:9] + 0.01
    P = model.power_function(at)
    data = pickle.dumps(model)
    assert len(data) < 100_000
    loaded = pickle.loads(data)
    np.testing.assert_array_equal(loaded.predict(at), model.predict(at))
    np.testing.assert_allclose(loaded.power_function(at), P, atol=1e-9)
    assert loaded.n_iter_ == model.n_iter_


# The estimator's interface.


def test_solver_is_cloned_and_tuned():
    solver = ConjugateGradient(tol=1e-3)
    model = KoopmanKernelRegressor(solver=solver).fit(STATES, Y)
    assert model.solver_ is not solver
    assert model.solver_.get_params() == solver.get_params()
    search = GridSearchCV(
        KoopmanKernelRegressor(solver=solver, beta=0.5),
        {"solver__tol": [0.5, 1e-9], "solver__n_neighbors": [1, 8]},
        error_score="raise",
    ).fit(STATES, Y)
    assert search.best_params_["solver__tol"] == 1e-9
    assert solver.tol == 1e-3
    assert clone(solver).get_params() == solver.get_params()


def test_results_do_not_depend_on_the_order_of_fits():
    solver = ConjugateGradient(random_state=np.random.RandomState(5))
    model = KoopmanKernelRegressor("gaussian", alpha=0.1, solver=solver)
    first = model.fit(STATES, Y).dual_coef_
    np.testing.assert_array_equal(model.fit(STATES, Y).dual_coef_, first)


def test_dense_fit_after_an_iterative_one():
    model = KoopmanKernelRegressor(solver=ConjugateGradient()).fit(STATES, Y)
    model.set_params(solver="auto").fit(STATES, Y)
    assert model.solver_ == "pivoted_cholesky"
    assert not hasattr(model, "n_iter_")
    assert not hasattr(model, "solver_residual_")
    assert hasattr(model, "rcond_")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("tol", 0.0),
        ("tol", -1e-3),
        ("tol", np.nan),
        ("tol", 1.0),
        ("tol", "small"),
        ("max_iter", 0),
        ("max_iter", 2.5),
        ("rank", 0),
        ("rank", True),
        ("n_neighbors", 0),
        ("preconditioner", "ilu"),
        ("preconditioner", None),
        ("preconditioner", ["auto"]),
        ("random_state", -1),
        ("random_state", "seed"),
    ],
)
def test_bad_parameters_are_named(name, value):
    model = KoopmanKernelRegressor(solver=ConjugateGradient(**{name: value}))
    with pytest.raises(
        ValueError, match=rf"solver\.{name} .*{str(value).strip(chr(91))[:4]}"
    ):
        model.fit(STATES, Y)


def test_what_conjugate_gradients_cannot_do():
    solver = ConjugateGradient()
    with pytest.raises(ValueError, match=r"solver must be .* got ConjugateGradient"):
        KernelEDMD(solver=solver).fit(STATES)
    with pytest.raises(ValueError, match=r"solver=ConjugateGradient\(\) needs the st"):
        KoopmanKernelRegressor(solver=solver, beta=1.0, centers="precomputed").fit(
            np.abs(STATES), Y
        )
    banded = ConjugateGradient(preconditioner="banded")
    with pytest.raises(ValueError, match=r"no compact support.*banded"):
        KoopmanKernelRegressor(solver=banded).fit(STATES, Y)
    model = KoopmanKernelRegressor(solver=solver)
    with pytest.raises(AttributeError, match="partial_fit"):
        model.partial_fit(STATES, Y)
    model.fit(STATES, Y)
    with pytest.raises(ValueError, match=r"error_bound .* conjugate gradients"):
        model.error_bound(STATES)
    with pytest.raises(ValueError, match="solver must be one of"):
        model.set_params(solver=ConjugateGradient).fit(STATES, Y)
    with pytest.raises(ValueError, match="20 rows and 40 centres"):
        KoopmanKernelRegressor(
            solver=solver, method="least_squares", centers=STATES[:40]
        ).fit(STATES[:20], Y[:20])


def test_what_is_too_large_for_a_dense_matrix():
    sections = KernelSections(MaternSobolev(0.5), STATES)
    # A matrix of 220 x 220 with the room to factor it takes 500 kB.
    assert not is_dense_affordable(sections, memory=2 * 500_000)
    assert is_dense_affordable(sections, memory=2 * 510_000)
    assert is_dense_affordable(sections)
    sections = KernelSections(Wendland(0.02, 2, 3), SQUARE)
    assert not is_dense_affordable(sections, dense_centers=699)
    assert is_dense_affordable(sections, dense_centers=700)
    assert not is_dense_affordable(sections, memory=2 * 5_000_000, dense_centers=700)
    for kernel in (Wendland(0.5, 2, 3), MaternSobolev(0.02)):
        assert is_dense_affordable(KernelSections(kernel, SQUARE), dense_centers=699)


def test_auto_for_many_centres_of_compact_support():
    X = np.linspace(0, 1, 5001)[:, np.newaxis]

    def solver_of(n, beta):
        model = KoopmanKernelRegressor("wendland_c2", beta=beta).fit(X[:n], X[:n, 0])
        np.testing.assert_allclose(model.predict(X[:9] + 1e-5), X[:9, 0], atol=1e-3)
        return model.solver_

    assert isinstance(solver_of(5001, 1e-3), ConjugateGradient)
    assert solver_of(1000, 1e-3) == "pivoted_cholesky"


# The parts.


def spd(n, condition, seed=0):
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return (Q * np.logspace(0, -np.log10(condition), n)) @ Q.T


def test_conjugate_gradients_end_after_as_many_steps_as_eigenvalues():
    Q, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(60, 60)))
    A = (Q * np.repeat([1.0, 2.0, 5.0, 9.0], 15)) @ Q.T
    b = np.random.default_rng(5).normal(size=(60, 2))
    found = conjugate_gradients(
        A.__matmul__, b, lambda v: v, np.empty((60, 0)), 1e-12, 100
    )
    assert found.n_iter == 4
    np.testing.assert_allclose(found.x, np.linalg.solve(A, b), rtol=1e-10, atol=1e-12)


def test_columns_stop_on_their_own():
    A = spd(50, 1e3)
    rng = np.random.default_rng(6)
    eigenvector = np.linalg.eigh(A)[1][:, :1]
    b = np.hstack([eigenvector, np.zeros((50, 1)), 1e6 * rng.normal(size=(50, 1))])
    widths = []

    def counted(V):
        widths.append(V.shape[1])
        return A @ V

    found = conjugate_gradients(counted, b, lambda v: v, np.empty((50, 0)), 1e-10, 500)
    assert widths[:3] == [2, 1, 1]
    np.testing.assert_allclose(A @ found.x, b, atol=1e-3)
    np.testing.assert_allclose(A @ found.x[:, 0], b[:, 0], atol=1e-9)
    assert not found.x[:, 1].any()
    assert found.residual.shape == (3,)
    assert found.residual[1] == 0
    assert found.residual.max() <= 1e-10
    assert found.has_converged(1e-10)


def test_residual_that_drifts_is_computed_anew():
    A = spd(40, 1e6)
    b = np.random.default_rng(7).normal(size=(40, 1))
    found = conjugate_gradients(
        A.__matmul__, b, lambda v: v, np.empty((40, 0)), 1e-9, 4000
    )
    true = np.linalg.norm(b - A @ found.x) / np.linalg.norm(b)
    # Two evaluations of b - A x differ by eps |A| |x|, and |A| is one.
    rounding = np.finfo(float).eps * np.linalg.norm(found.x) / np.linalg.norm(b)
    assert rounding < 1e-10
    assert found.residual[0] == pytest.approx(true, abs=rounding)
    assert true < 1e-9 + rounding


def test_iterations_are_limited_over_restarts():
    calls = []
    A = spd(40, 1e12)

    def counted(V):
        calls.append(1)
        return A @ V

    b = np.random.default_rng(8).normal(size=(40, 1))
    found = conjugate_gradients(counted, b, lambda v: v, np.empty((40, 0)), 1e-15, 37)
    assert found.n_iter == 37
    assert len(calls) <= 37 + 3 + POWER_STEPS
    assert found.residual[0] > 1e-15


def test_restarts_count_as_iterations():
    A = spd(40, 1e6)
    b = np.random.default_rng(8).normal(size=(40, 1))

    def solved(max_iter):
        return conjugate_gradients(
            A.__matmul__, b, lambda v: v, np.empty((40, 0)), 1e-14, max_iter
        )

    free = solved(10_000)
    for fewer in (1, 5, 20, 40):
        assert solved(free.n_iter - fewer).n_iter <= free.n_iter - fewer


def test_iterations_end_where_rounding_allows_no_less():
    A = spd(40, 1e3)
    b = np.random.default_rng(25).normal(size=(40, 2))
    found = conjugate_gradients(
        A.__matmul__, b, lambda v: v, np.empty((40, 0)), 1e-17, 20_000
    )
    assert found.residual.min() > 1e-17
    assert found.has_converged(1e-17)
    # Every restart halves a residual: there are at most fifty.
    assert found.n_iter < 5_000


def test_solution_in_the_complement():
    A = spd(30, 1e4)
    P, _ = np.linalg.qr(np.random.default_rng(9).normal(size=(30, 3)))
    b = np.random.default_rng(10).normal(size=(30, 2))
    M = np.diag(np.linspace(1, 2, 30))
    found = conjugate_gradients(A.__matmul__, b, M.__matmul__, P, 1e-12, 500)
    full = np.block([[A, P], [P.T, np.zeros((3, 3))]])
    expected = np.linalg.solve(full, np.vstack([b, np.zeros((3, 2))]))[:30]
    np.testing.assert_allclose(found.x, expected, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(P.T @ found.x, 0, atol=1e-10)


@pytest.mark.skipif(
    np.finfo(np.longdouble).eps == np.finfo(float).eps, reason="no extended precision"
)
@every_pair(
    kernel=[MaternSobolev(0.3), MaternSobolev(3.0, 2.5), Wendland(1.0, 2, 3)],
    y=[Y, NOISE],
    inverse=["exact", "none"],
    degree=[None, 1],
)
def test_rounding_is_estimated_well(kernel, y, inverse, degree):
    K = kernel(STATES)
    P = monomials(STATES, None if degree is None else "linear")
    Q, _ = np.linalg.qr(P)
    # A good preconditioner takes no step along the largest eigenvectors.
    inverted = np.linalg.inv(K) if inverse == "exact" else np.eye(220)
    found = conjugate_gradients(
        K.__matmul__, y, inverted.__matmul__, Q, tol=1e-17, max_iter=500
    )
    size = np.linalg.norm(y - Q @ (Q.T @ y), axis=0)
    exact = K.astype(np.longdouble) @ found.x.astype(np.longdouble)
    error = np.asarray(K @ found.x - exact, dtype=float)
    actual = np.linalg.norm(error, axis=0) / size
    assert (actual < found.rounding).all()
    assert (found.rounding < 1e4 * actual).all()


def test_rounding_is_not_looked_for_where_the_tolerance_is_met():
    calls = []
    A = spd(40, 1e2)

    def counted(V):
        calls.append(1)
        return A @ V

    b = np.random.default_rng(8).normal(size=(40, 1))
    found = conjugate_gradients(counted, b, lambda v: v, np.empty((40, 0)), 1e-9, 500)
    assert found.has_converged(1e-9)
    assert not found.rounding.any()
    assert len(calls) <= found.n_iter + 3


def test_rounding_of_one_column_is_no_excuse_for_another():
    Q, _ = np.linalg.qr(np.random.default_rng(22).normal(size=(50, 50)))
    A = (Q * np.r_[1.0, 1e-6, np.full(47, 1e-3), 1e-12]) @ Q.T
    # The solution of the first column is large; the second has two steps to go.
    b = np.column_stack([Q[:, -1], Q[:, 0] + 1e-3 * Q[:, 1]])
    found = conjugate_gradients(
        A.__matmul__, b, lambda v: v, np.empty((50, 0)), 1e-10, 1
    )
    assert found.residual[1] == pytest.approx(1e-3, rel=0.01)
    assert found.residual[1] < found.rounding[0]
    assert found.rounding[1] < 1e-13
    assert not found.has_converged(1e-10)
    alone = conjugate_gradients(
        A.__matmul__, b[:, :1], lambda v: v, np.empty((50, 0)), 1e-10, 100
    )
    assert alone.residual[0] < alone.rounding[0]


@pytest.mark.parametrize("unit", [1e-300, 1e-160, 1e160, 1e300])
def test_unit_of_the_right_hand_side(unit):
    A = spd(40, 1e4)
    b = np.random.default_rng(23).normal(size=(40, 2))

    def solved(b):
        return conjugate_gradients(
            A.__matmul__, b, lambda v: v, np.empty((40, 0)), 1e-10, 500
        )

    one, found = solved(b), solved(b * [1.0, unit])
    np.testing.assert_allclose(found.x / [1.0, unit], one.x, rtol=1e-6, atol=1e-6)
    assert found.residual.max() <= 1e-10


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0])
def test_products_that_misbehave_leave_the_residual_of_nothing(value):
    b = np.ones((10, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of inf - inf
        found = conjugate_gradients(
            lambda v: value * v, b, lambda v: v, np.empty((10, 0)), 1e-10, 50
        )
    assert not found.x.any()
    np.testing.assert_array_equal(found.residual, 1.0)
    assert not found.has_converged(1e-10)


def test_product_that_is_not_reproduced_never_makes_it_worse():
    rng = np.random.default_rng(24)
    A = spd(30, 1e3)
    b = rng.normal(size=(30, 3))
    found = conjugate_gradients(
        lambda v: A @ v + 0.3 * rng.normal(size=v.shape) * np.linalg.norm(v),
        b,
        lambda v: v,
        np.empty((30, 0)),
        1e-10,
        500,
    )
    assert np.isfinite(found.x).all()
    assert (found.residual <= 1).all()
    assert not found.has_converged(1e-10)


def test_indefinite_matrix_leaves_a_residual():
    A = np.diag(np.r_[np.ones(5), -np.ones(5)])
    b = np.ones((10, 1))
    found = conjugate_gradients(
        A.__matmul__, b, lambda v: v, np.empty((10, 0)), 1e-10, 50
    )
    assert not found.has_converged(1e-10)


class Cone(StationaryKernelMixin, NormalizedKernelMixin, Kernel):
    """The kernel 1 - |x - y|, positive definite for coefficients of mean zero only."""

    def __init__(self):
        """Take no parameters, as scikit-learn wants it said."""

    def __call__(self, X, Y=None, eval_gradient=False):
        return 1.0 - cdist(X, X if Y is None else Y)


@pytest.mark.parametrize("preconditioner", ["auto", "neighbors", "nystroem"])
def test_indefinite_kernel_is_refused(preconditioner):
    solver = ConjugateGradient(preconditioner=preconditioner)
    model = KoopmanKernelRegressor(Cone(), solver=solver)
    with pytest.raises(ValueError, match=r"No estimate.*diverge .*1\.0e\+00.*alpha"):
        model.fit(STATES, Y)
    assert not hasattr(model, "dual_coef_")


@pytest.mark.parametrize("trend", ["constant", "linear"])
@pytest.mark.parametrize("preconditioner", ["auto", "nystroem"])
def test_polynomials_make_an_indefinite_kernel_definite(trend, preconditioner):
    # A Cholesky factor has no use for it: the matrix is that of the saddle point.
    solver = ConjugateGradient(tol=1e-12, preconditioner=preconditioner)
    model = KoopmanKernelRegressor(Cone(), trend=trend, solver=solver).fit(STATES, Y)
    K, k = model.kernel_(STATES), model.kernel_(STATES, ELSEWHERE)
    P, p = monomials(STATES, trend), monomials(ELSEWHERE, trend)
    c, d = dense_interpolant(K, P, Y)
    np.testing.assert_allclose(model.dual_coef_, c, atol=1e-9 * np.abs(c).max())
    np.testing.assert_allclose(model.predict(ELSEWHERE), k.T @ c + p @ d, atol=1e-9)
    np.testing.assert_allclose(
        model.power_function(ELSEWHERE) ** 2, squared_power(K, P, k, p), atol=1e-9
    )


@pytest.mark.parametrize("trend", [None, "linear"])
def test_weights_that_diverge_leave_the_power_function_sound(trend):
    # Up to rounding the matrix is singular, and states far away make it worse: without
    # further care the squared power function is off by several units there.
    X = np.vstack([3 * ELSEWHERE, ELSEWHERE + 1, ELSEWHERE])
    sections = KernelSections(Gaussian(3.0), STATES)
    solver = ConjugateGradient(max_iter=300)
    degree = None if trend is None else 1
    system = IterativeSystem(sections, np.zeros(220), degree, solver)
    with pytest.warns(ConvergenceWarning, match="power function is too large"):
        P = system.power(X)
    # Weights that reproduce the polynomials, and no more.
    T = monomials(STATES, trend)
    w = T @ np.linalg.pinv(T.T @ T) @ monomials(X, trend).T
    K, k = sections.kernel(STATES), sections.kernel(STATES, X)
    quadratic = np.einsum("ij,ij->j", w, K @ w - 2 * k)
    assert (P >= 0).all()
    assert (P**2 - (1 + quadratic)).max() < 1e-8 * (1 + np.abs(quadratic).max())


def order_and_predecessors(W):
    """Return the order of the centres, and which of those before each one is tied to.

    Row i of W has the i-th centre, and the earlier ones that it is conditioned on.
    """
    order, tied = [], []
    for i in range(W.shape[0]):
        members = set(W.indices[W.indptr[i] : W.indptr[i + 1]])
        (own,) = members.difference(order)
        tied.append(members - {own})
        order.append(own)
    return np.array(order), tied


@pytest.mark.parametrize("n", [1, 2, 3, 7, 64, 100, 1000])
def test_order_is_a_permutation_from_coarse_to_fine(n):
    points = np.random.default_rng(11).uniform(size=(n, 2))
    W = neighbor_preconditioner(MaternSobolev(1.0), points, np.ones(n), 3)
    order, tied = order_and_predecessors(W)
    assert sorted(order) == list(range(n))
    assert [len(members) for members in tied] == [min(i, 3) for i in range(n)]
    if n == 1000:
        # The first 30 cover the square; the first 30 in the order of a kd-tree's
        # leaves would lie in one corner.
        first = points[order[:30]]
        gap = np.linalg.norm(points[:, None] - first, axis=-1).min(axis=1).max()
        assert gap < 0.35


@pytest.mark.parametrize("k", [0, 1, 5, 30])
@pytest.mark.parametrize("seed", [0, 1])
def test_nearest_predecessors(k, seed):
    x = np.random.default_rng(seed).normal(size=(400, 3))
    if seed:  # of clusters, so that many neighbours are no predecessors
        x = np.round(x) + 1e-3 * x
    W = neighbor_preconditioner(MaternSobolev(1.0), x, np.full(400, 1.1), k)
    order, tied = order_and_predecessors(W)
    distances = np.linalg.norm(x[:, np.newaxis] - x, axis=-1)
    for i, own in enumerate(order):
        earlier = order[:i]
        assert tied[i] == set(earlier[np.argsort(distances[own, earlier])[:k]])


@pytest.mark.parametrize("kernel", [MaternSobolev(0.5, 0.5), RBF(0.1)])
def test_all_predecessors_make_an_exact_inverse(kernel):
    points, diagonal = STATES[:80], np.linspace(1.1, 1.5, 80)
    K = kernel(points)
    K[np.diag_indices(80)] = diagonal
    W = neighbor_preconditioner(kernel, points, diagonal, 200).toarray()
    np.testing.assert_allclose(W @ K @ W.T, np.eye(80), atol=1e-10)
    # With fewer, the rows are still of unit variance (the diagonal is exact).
    W = neighbor_preconditioner(kernel, points, diagonal, 6).toarray()
    assert (np.count_nonzero(W, axis=1) <= 7).all()
    np.testing.assert_allclose(np.diag(W @ K @ W.T), 1, atol=1e-10)


def test_exponential_kernel_on_a_line_needs_two_neighbours():
    # A Markov process: of predecessors, only the nearest on both sides matter.
    points = np.sort(np.random.default_rng(12).uniform(size=(200, 1)), axis=0)
    kernel = MaternSobolev(0.3, 0.5)
    K = kernel(points)
    W = neighbor_preconditioner(kernel, points, np.ones(200), 12).toarray()
    np.testing.assert_allclose(W @ K @ W.T, np.eye(200), atol=1e-9)


def test_preconditioner_of_centres_that_coincide():
    points = np.vstack([STATES[:40], STATES[:10], STATES[:10] + 1e-15])
    W = neighbor_preconditioner(MaternSobolev(1.0), points, np.ones(60), 12)
    assert np.isfinite(W.toarray()).all()
    assert (np.count_nonzero(W.toarray(), axis=1) > 1).sum() == 59


def test_preconditioner_does_not_depend_on_the_unit():
    kernel = MaternSobolev
    expected = neighbor_preconditioner(kernel(1.0), STATES, np.ones(220), 9).toarray()
    for unit in (1e-250, 1e250):
        found = neighbor_preconditioner(kernel(unit), STATES * unit, np.ones(220), 9)
        np.testing.assert_allclose(found.toarray(), expected, rtol=1e-6, atol=1e-9)


def test_batches_of_the_preconditioner():
    kernel = MaternSobolev(1.0)
    expected = neighbor_preconditioner(kernel, STATES, np.ones(220), 9).toarray()
    for entries in (1, 1000):
        found = neighbor_preconditioner(
            kernel, STATES, np.ones(220), 9, entries_per_batch=entries
        )
        np.testing.assert_allclose(found.toarray(), expected, rtol=1e-9)


@pytest.mark.parametrize("rank", [1, 7, 40, 300])
def test_pivoted_factor(rank):
    K = RBF(0.5)(STATES)
    random = np.random.RandomState(0)
    F, left = pivoted_factor(lambda p: K[:, p].copy(), K.diagonal(), rank, random)
    assert F.shape[1] <= rank
    rest = K - F @ F.T
    assert np.linalg.eigvalsh(rest).min() > -1e-11
    assert left == pytest.approx(rest.diagonal().mean(), abs=1e-12)
    if rank == 300:
        np.testing.assert_allclose(rest, 0, atol=1e-6)
    if rank == 40:
        best = np.linalg.eigvalsh(K)[:-40].sum() / 220
        assert left < 30 * best


def test_pivoted_factor_of_low_rank_matrix():
    A = np.random.default_rng(13).normal(size=(100, 4))
    K = A @ A.T
    F, left = pivoted_factor(
        lambda p: K[:, p].copy(), K.diagonal(), 50, np.random.RandomState(0)
    )
    np.testing.assert_allclose(F @ F.T, K, atol=1e-6)
    assert left < 1e-10
    F, left = pivoted_factor(
        lambda p: K[:, p].copy(), np.zeros(100), 50, np.random.RandomState(0)
    )
    assert F.shape == (100, 0)
    assert left == 0


@pytest.mark.parametrize("shift", [1e-9, 1e-3, 10.0])
@pytest.mark.parametrize("rank", [0, 1, 8])
def test_low_rank_inverse(shift, rank):
    rng = np.random.default_rng(14)
    F, v = rng.normal(size=(30, rank)), rng.normal(size=(30, 2))
    A = F @ F.T + shift * np.eye(30)
    found = low_rank_inverse(F, shift)(v)
    np.testing.assert_allclose(A @ found, v, atol=1e-13 * rank**2 / shift + 1e-13)


@pytest.mark.parametrize("n_features", range(1, 11))
def test_sparse_gram_and_cross_matrices(n_features):
    rng = np.random.default_rng(15)
    points, X = rng.uniform(size=(150, n_features)), rng.uniform(size=(40, n_features))
    X[:5] = points[:5]
    kernel = Wendland(0.4 * np.sqrt(n_features), 2, max(n_features, 3))
    diagonal = np.linspace(1, 2, 150)
    K = gram(kernel, points, diagonal)
    expected = kernel(points)
    share = np.mean(expected != 0)
    expected[np.diag_indices(150)] = diagonal
    np.testing.assert_allclose(K.toarray(), expected, rtol=1e-9, atol=1e-14)
    tree = kd_tree(kernel, points)
    found = cross(kernel, X, points, tree)
    np.testing.assert_allclose(
        found.toarray(), kernel(X, points), rtol=1e-9, atol=1e-14
    )
    assert density(kernel, tree, points) == pytest.approx(share)
    assert 0 < density(kernel, tree, np.vstack([points] * 7)) < 1


@pytest.mark.parametrize("block_entries", [1, 1000])
def test_sparse_blocks(block_entries):
    kernel = Wendland(0.2, 2, 3)
    points = SQUARE if block_entries > 1 else SQUARE[:60]
    tree, ones = kd_tree(kernel, points), np.ones(len(points))
    for K in (
        gram(kernel, points, ones, block_entries=block_entries),
        cross(kernel, points, points, tree, block_entries=block_entries),
    ):
        np.testing.assert_allclose(K.toarray(), kernel(points), rtol=1e-10, atol=1e-14)


def test_band_of_a_shuffled_curve():
    order = np.random.default_rng(16).permutation(300)
    t = np.arange(300)[order]
    points = np.column_stack([np.cos(t / 60), np.sin(t / 60)])
    kernel = Wendland(0.1, 2, 3)  # six neighbours on both sides
    K = gram(kernel, points, np.full(300, 1.1))
    order, width = bandwidth(K)
    assert sorted(order) == list(range(300))
    assert width <= 12
    dense = K.toarray()[np.ix_(order, order)]
    i, j = np.nonzero(dense)
    assert width == np.abs(i - j).max()
    b = np.random.default_rng(17).normal(size=(300, 2))
    np.testing.assert_allclose(K @ banded_solver(K, order, width)(b), b, atol=1e-11)


def test_diagonal_matrix_has_no_band():
    points = 10.0 * np.arange(20)[:, np.newaxis]
    kernel = Wendland(1.0)
    K = gram(kernel, points, np.full(20, 4.0))
    order, width = bandwidth(K)
    assert width == 0
    b = np.arange(20.0)[:, np.newaxis]
    np.testing.assert_allclose(banded_solver(K, order, width)(b), b / 4)


def test_wide_bands_are_not_factored():
    def preconditioned(operations=1e4, **parameters):
        sections = KernelSections(Wendland(0.12, 2, 3), SQUARE)
        return IterativeSystem(
            sections,
            np.zeros(700),
            None,
            ConjugateGradient(**parameters),
            max_banded_operations=operations,
        )

    narrow = preconditioned(operations=1e10)
    assert narrow.W is None
    assert narrow.interpolate(outputs(SQUARE)).n_iter <= 4
    assert preconditioned(preconditioner="banded").W is None
    rows = np.diff(preconditioned().W.indptr)
    assert rows.max() == 11
    rows = np.diff(preconditioned(n_neighbors=4).W.indptr)
    assert rows.max() == 5


def test_neighbours_of_kernels_without_compact_support():
    sections = KernelSections(MaternSobolev(0.5), SQUARE)
    system = IterativeSystem(sections, np.zeros(700), None, ConjugateGradient())
    assert np.diff(system.W.indptr).max() == 31


@pytest.mark.parametrize(
    "name",
    [
        "wendland_c2",
        pytest.param("matern32", marks=pytest.mark.slow),
        pytest.param("matern12", marks=pytest.mark.slow),
        pytest.param("matern52", marks=pytest.mark.slow),
    ],
)
def test_iterations_stay_few(name):
    X = np.random.default_rng(18).uniform(size=(1500, 2))
    model = KoopmanKernelRegressor(
        name, beta=0.3, solver=ConjugateGradient(preconditioner="neighbors")
    ).fit(X, outputs(X))
    assert model.n_iter_ < 40


def test_more_rows_per_centre_take_no_more_iterations():
    X = np.random.default_rng(20).uniform(size=(3000, 2))
    model = KoopmanKernelRegressor(
        alpha=0.1, centers=X[:100], method="least_squares", solver=ConjugateGradient()
    )
    assert model.fit(X, outputs(X)).n_iter_ < 40


@pytest.mark.parametrize("name", KERNELS)
def test_every_kernel(name):
    assert_agree(
        SQUARE[:200],
        outputs(SQUARE[:200]),
        SQUARE[200:230],
        kernel=name,
        beta=0.3,
        alpha=1e-3,
        trend="constant",
    )


def test_many_features():
    X = np.random.default_rng(19).normal(size=(200, 8))
    assert_agree(X, outputs(X), X[:20] + 0.1, beta=4.0, alpha=0.1, trend="linear")
    assert_agree(
        X,
        outputs(X),
        X[:20] + 0.1,
        beta=4.0,
        alpha=0.1,
        centers=X[:70],
        method="least_squares",
    )
