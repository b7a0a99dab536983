"""Power function and error bound against extremal functions and 50-digit arithmetic."""

import pickle
import re
import warnings
from decimal import Decimal, localcontext

import numpy as np
import pandas as pd
import pytest
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from reference import monomials, profile, saddle_point_matrix
from scipy.linalg import LinAlgWarning, null_space
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.gaussian_process.kernels import RBF, Matern, WhiteKernel

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.kernels import KERNELS

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

TRENDS = [None, "constant", "linear"]


@pytest.fixture
def scattered():
    """A smooth function of two outputs at 60 scattered points, and points nearby."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (60, 2))
    y = np.column_stack([np.sin(X[:, 0]) + X[:, 1], np.cos(X).prod(axis=1)])
    return X, y, X[rng.integers(0, 60, 200)] + rng.normal(0, 0.03, (200, 2))


def interpolant_norm(K, P, u):
    """Native seminorm of the interpolant, from coefficients that annihilate P."""
    N = null_space(P.T) if P.shape[1] else np.eye(len(K))
    return np.sqrt(np.sum(N.T @ u * np.linalg.solve(N.T @ K @ N, N.T @ u), axis=0))


def farthest_half(X):
    """Farthest first: the more distant half of the points, by a plain loop."""
    chosen = [0]
    while len(chosen) < (len(X) + 1) // 2:
        chosen.append(int(cdist(X, X[chosen]).min(axis=1).argmax()))
    return chosen


def norms(model, X):
    """The native norms that a bound is made with."""
    bound = model.error_bound(X)
    power = np.hypot(model.power_function(X), np.sqrt(1e-13))
    norm = bound.T / power
    assert_allclose(norm, np.broadcast_to(norm[..., :1], norm.shape), rtol=1e-9)
    return norm[..., 0]


# --- Power function ------------------------------------------------------------------


def decimal_power(name, centers, X, beta):
    """Square root of the Schur complement, by Cholesky with 50 digits."""

    def section(x, y):
        squares = [(Decimal(a) - Decimal(b)) ** 2 for a, b in zip(x, y, strict=True)]
        r = sum(squares).sqrt() / Decimal(beta)
        return profile(name, r, len(x), Decimal.exp, Decimal.sqrt, Decimal)

    with localcontext() as context:
        context.prec = 50
        rows = [[float(v) for v in row] for row in centers]
        L = []
        for i, x in enumerate(rows):
            L.append([])
            for j in range(i + 1):
                rest = section(x, rows[j]) - sum(
                    (L[i][k] * L[j][k] for k in range(j)), Decimal(0)
                )
                L[i].append(rest.sqrt() if i == j else rest / L[j][j])
        powers = []
        for x in X:
            x, a = [float(v) for v in x], []
            for i, row in enumerate(L):
                left = sum((row[k] * a[k] for k in range(i)), Decimal(0))
                a.append((section(x, rows[i]) - left) / row[i])
            powers.append(float((1 - sum(v * v for v in a)).sqrt()))
    return np.array(powers)


@pytest.mark.parametrize("d", [2, 5])
@pytest.mark.parametrize("kernel", KERNELS)
def test_power_function_is_the_schur_complement_of_fifty_digits(kernel, d):
    rng = np.random.default_rng(0)
    X, X_new = rng.uniform(-1, 1, (14, d)), rng.uniform(-1.5, 1.5, (6, d))
    beta = 2.5 if kernel.startswith("wendland") else 0.75
    model = KoopmanKernelRegressor(kernel, beta=beta).fit(X, X[:, 0])
    power = model.power_function(X_new)
    assert 0.01 < power.min() < power.max() <= 1
    assert_allclose(power, decimal_power(kernel, X, X_new, beta), atol=1e-8, rtol=0)


@pytest.mark.parametrize("kernel", KERNELS)
def test_power_function_is_zero_at_the_centres_and_one_far_away(kernel):
    rng = np.random.default_rng(1)
    X = rng.uniform(-1, 1, (40, 3))
    model = KoopmanKernelRegressor(kernel, beta=0.7).fit(X, X[:, 0])
    assert model.power_function(X).max() < 1e-6
    between = model.power_function(rng.uniform(-3, 3, (10_000, 3)))
    assert between.min() > 1e-6
    assert between.max() <= 1
    assert model.power_function([[1e6, 0, 0]]) == pytest.approx(1, abs=1e-9)


def test_power_function_falls_as_centres_are_added():
    rng = np.random.default_rng(2)
    X, X_new = rng.uniform(-1, 1, (80, 2)), rng.uniform(-1, 1, (500, 2))
    powers = [
        KoopmanKernelRegressor("matern12").fit(X[:M], X[:M]).power_function(X_new)
        for M in (10, 20, 40, 80)
    ]
    assert (np.diff(powers, axis=0) < 1e-12).all()
    assert powers[-1].max() < 0.7 * powers[0].max()


def test_power_function_of_one_and_two_centres():
    """From phi(0), phi(1) and phi(2) alone."""
    one, two = np.exp(-1.0), np.exp(-2.0)
    model = KoopmanKernelRegressor("matern12").fit([[0.0]], [5.0])
    assert_allclose(
        model.power_function([[1.0], [-2.0]]), np.sqrt([1 - one**2, 1 - two**2])
    )
    assert_allclose(
        model.error_bound([[1.0], [-1.0]], norm=5), 5 * np.sqrt([1 - one**2] * 2)
    )
    model.fit([[0.0], [2.0]], [1.0, 1.0])
    halfway = np.sqrt(1 - 2 * one**2 / (1 + two))
    assert_allclose(model.power_function([[1.0]]), [halfway])
    # The interpolant has the squared norm 2 / (1 + phi(2)), that of one centre 1.
    norm = np.sqrt(4 / (1 + two) - 1)
    assert_allclose(model.error_bound([[1.0]]), [halfway * norm])


# --- The bound, given the norm -------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*off the manifold:UserWarning")
@every_pair(kernel=KERNELS, d=[2, 3], alpha=[0.0, 1e-3], trend=[None, "linear"])
def test_bound_holds_for_functions_of_known_norm(kernel, d, alpha, trend):
    rng = np.random.default_rng(3)
    X, X_new = rng.uniform(-1, 1, (50, d)), rng.uniform(-1.5, 1.5, (9_000, d))
    X_new = np.vstack([X_new, np.repeat(X, 20, axis=0)])
    X_new[9_000:] += 1e-3 * rng.standard_normal((1_000, d))
    points, weights = rng.uniform(-1.5, 1.5, (25, d)), rng.standard_normal((25, 2))
    model = KoopmanKernelRegressor(kernel, beta=1.2, alpha=alpha, trend=trend)
    k = KERNELS[kernel](beta=1.2)
    norm = np.sqrt(np.sum(weights * (k(points) @ weights), axis=0))

    def g(Z):  # with a trend, polynomials are for free
        return k(Z, points) @ weights + (100 * Z[:, :1] if trend else 0)

    model.fit(X, g(X))
    error = np.abs(model.predict(X_new) - g(X_new))
    bound = model.error_bound(X_new, norm)
    assert bound.shape == error.shape == (10_000, 2)
    assert (error <= bound).all()


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_bound_is_attained_by_the_worst_function(kernel, trend):
    """That is the section at x less its best approximation from the centres."""
    rng = np.random.default_rng(4)
    X, x = rng.uniform(-1, 1, (30, 2)), np.array([[0.15, -0.4]])
    beta = 0.3 if kernel == "gaussian" else 0.8
    k = KERNELS[kernel](beta=beta)
    P, p = monomials(X, trend), monomials(x, trend)
    saddle = saddle_point_matrix(k(X), P)
    w = np.linalg.solve(saddle, np.vstack([k(X, x), p.T]))[: len(X)]
    points, weights = np.vstack([x, X]), np.vstack([[[1.0]], -w])
    norm = np.sqrt(weights.T @ k(points) @ weights).item()
    model = KoopmanKernelRegressor(kernel, beta=beta, trend=trend)
    model.fit(X, (k(X, points) @ weights).ravel())
    error = abs(model.predict(x) - (k(x, points) @ weights).ravel())
    assert norm > 0.01
    assert_allclose(error, norm**2, rtol=1e-6)
    assert_allclose(model.error_bound(x, norm), norm**2, rtol=1e-6)


@pytest.mark.parametrize("trend", [None, "linear"])
@pytest.mark.parametrize(
    ("kernel", "beta"), [("gaussian", 3.0), ("wendland_c6", 300.0)]
)
def test_bound_holds_where_dependent_centres_were_left_out(kernel, beta, trend):
    rng = np.random.default_rng(5)
    X, X_new = rng.uniform(-1, 1, (250, 2)), rng.uniform(-1, 1, (10_000, 2))
    points, weights = rng.uniform(-1.5, 1.5, (25, 2)), rng.standard_normal(25)
    k = KERNELS[kernel](beta=beta)
    norm = np.sqrt(weights @ k(points) @ weights)
    model = KoopmanKernelRegressor(kernel, beta=beta, trend=trend)
    with pytest.warns(LinAlgWarning, match="centres that depend"):
        model.fit(X, k(X, points) @ weights)
    assert len(model.centers_) < 250
    error = np.abs(model.predict(X_new) - k(X_new, points) @ weights)
    assert (error <= model.error_bound(X_new, norm)).all()
    # Nothing but rounding is left of the power function, and the bound says so.
    assert_allclose(model.error_bound(model.centers_, norm), 0, atol=1e-6 * norm)


def test_bound_holds_for_a_kernel_of_another_amplitude_and_library():
    """Four times the kernel halves the norm, and doubles the power function."""
    rng = np.random.default_rng(6)
    X = rng.uniform(-1, 1, (40, 2))
    X_new = X + rng.normal(0, 0.05, X.shape)
    ours = KoopmanKernelRegressor("matern52", beta=0.9).fit(X, np.sin(X[:, 0]))
    theirs = KoopmanKernelRegressor(4.0 * Matern(0.9, nu=2.5)).fit(X, np.sin(X[:, 0]))
    assert_allclose(
        theirs.power_function(X_new), 2 * ours.power_function(X_new), rtol=1e-7
    )
    assert_allclose(
        theirs.error_bound(X_new, 3.0), ours.error_bound(X_new, 6.0), rtol=1e-7
    )
    assert_allclose(theirs.error_bound(X_new), ours.error_bound(X_new), rtol=1e-7)


def test_bound_is_norm_times_power_for_each_output(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor().fit(X, y)
    power = model.power_function(X_new)[:, np.newaxis]
    for norm in (2.5, [2.5, 2.5]):
        assert_allclose(
            model.error_bound(X_new, norm), 2.5 * np.tile(power, 2), rtol=1e-6
        )
    assert_allclose(model.error_bound(X_new, [3.0, 0.5]), power * [3.0, 0.5], rtol=1e-6)
    assert_array_equal(model.error_bound(X_new, 0), np.zeros((200, 2)))
    single = KoopmanKernelRegressor().fit(X, y[:, 0])
    column = KoopmanKernelRegressor().fit(X, y[:, :1])
    assert single.error_bound(X_new).shape == (200,)
    assert column.error_bound(X_new).shape == (200, 1)
    assert_allclose(column.error_bound(X_new)[:, 0], single.error_bound(X_new))
    assert_allclose(
        model.error_bound(X_new)[:, 0], single.error_bound(X_new), rtol=1e-10
    )


# --- The norm, estimated -------------------------------------------------------------


@every_pair(n_samples=[59, 60], trend=TRENDS, alpha=[0.0, 0.2])
def test_norm_is_extrapolated_from_half_of_the_centres(
    scattered, trend, alpha, n_samples
):
    X, y, X_new = (a[:n_samples] for a in scattered)
    model = KoopmanKernelRegressor("wendland_c2", beta=2, trend=trend, alpha=alpha)
    K = KERNELS["wendland_c2"](beta=2)(X) + alpha * np.eye(len(X))
    P, half = monomials(X, trend), farthest_half(X)
    fine = interpolant_norm(K, P, y)
    coarse = interpolant_norm(K[np.ix_(half, half)], P[half], y[half])
    assert (coarse < 0.9999 * fine).all()
    assert_allclose(
        norms(model.fit(X, y), X_new), np.sqrt(2 * fine**2 - coarse**2), rtol=1e-8
    )


@pytest.mark.parametrize("kernel", [name for name in KERNELS if name != "gaussian"])
def test_estimated_norm_approaches_the_truth(kernel):
    """It lies between the norm of the interpolant and root two times the truth."""
    rng = np.random.default_rng(7)
    points, weights = rng.uniform(-1, 1, (12, 2)), rng.standard_normal(12)
    beta = 0.5 if kernel == "inverse_multiquadric" else 1.5
    k = KERNELS[kernel](beta=beta)
    truth = np.sqrt(weights @ k(points) @ weights)
    X = rng.uniform(-1.1, 1.1, (500, 2))
    ratios = []
    for M in (15, 60, 500):
        u = k(X[:M], points) @ weights
        model = KoopmanKernelRegressor(kernel, beta=beta).fit(X[:M], u)
        estimate = norms(model, X[:5] + 0.01)
        seminorm = interpolant_norm(k(X[:M]), np.empty((M, 0)), u)
        assert seminorm * (1 - 1e-9) <= estimate <= np.sqrt(2) * truth
        ratios.append(estimate / truth)
    tolerance = 0.12 if kernel in ("matern12", "wendland_c0") else 0.02
    assert abs(ratios[-1] - 1) < tolerance
    assert abs(ratios[-1] - 1) < abs(ratios[0] - 1)


def test_bound_by_the_estimated_norm_covers_the_pendulum():
    """And is far too large, as documented: the output is smoother than it has to be."""
    data = make_pendulum(1000)
    X, y, X_new, y_new = data.X[::2], data.y[::2], data.X[1::2], data.y[1::2]
    for kernel in ("matern12", "matern32", "wendland_c2", "wendland_c4"):
        model = KoopmanKernelRegressor(
            kernel, beta=3.0, centers=SeparatedCenterSelector(0.1)
        ).fit(X, y)
        error = np.abs(model.predict(X_new) - y_new)
        bound = model.error_bound(X_new)
        assert (error <= bound).all()
        assert bound.max() > 5 * error.max()


@pytest.mark.parametrize("scale", [1e-8, 1e8])
def test_bound_has_the_unit_of_the_outputs_and_none_of_the_states(scattered, scale):
    X, y, X_new = scattered
    plain = KoopmanKernelRegressor(beta=1.0, trend="linear").fit(X, y)
    bound = plain.error_bound(X_new)
    states = KoopmanKernelRegressor(beta=scale, trend="linear").fit(scale * X, y)
    assert_allclose(states.error_bound(scale * X_new), bound, rtol=1e-6)
    outputs = KoopmanKernelRegressor(beta=1.0, trend="linear").fit(X, scale * y)
    assert_allclose(outputs.error_bound(X_new), scale * bound, rtol=1e-9)


def test_outputs_that_are_zero_have_the_bound_zero(scattered):
    X, _, X_new = scattered
    model = KoopmanKernelRegressor().fit(X, np.zeros(60, dtype=int))
    assert_array_equal(model.error_bound(X_new), np.zeros(200))
    # As have polynomials, where they are part of the estimate.
    model = KoopmanKernelRegressor(trend="linear").fit(X, X)
    assert_allclose(model.error_bound(X_new), 0, atol=1e-12)


# --- Off the manifold ----------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 1e-4])
@pytest.mark.parametrize("trend", [None, "linear"])
def test_no_state_of_the_same_orbit_is_off_the_manifold(trend, alpha):
    """The configuration of the tests turns a warning into an error."""
    data = make_pendulum(2000)
    for separation in (0.4, 0.1):
        model = KoopmanKernelRegressor(
            beta=2.0,
            centers=SeparatedCenterSelector(separation),
            trend=trend,
            alpha=alpha,
        ).fit(data.X[:1000], data.y[:1000])
        assert model.error_bound(data.X).max() > 0
        alone = KoopmanKernelRegressor(beta=2.0, trend=trend, alpha=alpha)
        alone.fit(data.X[:256], data.y[:256])
        assert alone.error_bound(data.X[256:]).max() > 0


@pytest.mark.parametrize("alpha", [0.0, 0.01])
@pytest.mark.parametrize("trend", [None, "linear"])
def test_states_are_off_the_manifold_beyond_any_centre_left_out(trend, alpha):
    """Counted with one model for each centre that is left out."""
    centers = make_pendulum(70).X[::3]
    rng = np.random.default_rng(8)
    X_new = make_pendulum(500).X + rng.normal(0, 0.15, (500, 2))
    options = {"beta": 1.5, "trend": trend, "alpha": alpha}
    model = KoopmanKernelRegressor(**options).fit(centers, centers)
    farthest = max(
        KoopmanKernelRegressor(**options)
        .fit(np.delete(centers, i, axis=0), np.delete(centers, i, axis=0))
        .power_function(centers[i : i + 1])
        .item()
        for i in range(len(centers))
    )
    power = model.power_function(X_new)
    expected = int((power > farthest).sum())
    assert 20 < expected < 480
    assert not (abs(power / farthest - 1) < 1e-5).any()
    with pytest.warns(UserWarning, match=f"{expected} of 500 states are off") as caught:
        model.error_bound(X_new)
    assert len(caught) == 1
    numbers = re.findall(r"at most ([\d.e-]+) at centres", str(caught[0].message))
    assert float(numbers[0]) == pytest.approx(farthest, rel=0.05)


def test_another_orbit_is_off_the_manifold_of_the_first():
    one, other = make_pendulum(256), make_pendulum(100, initial=(0.0, 1.0))
    model = KoopmanKernelRegressor(
        "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ).fit(one.X, one.y)
    mixed = np.vstack([one.X[:30], other.X])
    with pytest.warns(UserWarning, match="100 of 130 states"):
        bound = model.error_bound(mixed)
    assert bound[30:].min() > 10 * bound[:30].max()


# --- What it takes and refuses -------------------------------------------------------


def test_bound_survives_the_pickle_and_a_change_of_parameters(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(alpha=0.01, trend="linear").fit(X, y)
    before = pickle.dumps(model)
    bound = model.error_bound(X_new)
    after = pickle.dumps(model)
    assert len(after) == len(before)
    for loaded in (pickle.loads(before), pickle.loads(after)):
        assert_allclose(loaded.error_bound(X_new), bound, rtol=1e-12)
    model.set_params(alpha=1.0, trend=None, beta=9.0, method="least_squares")
    assert_allclose(model.error_bound(X_new), bound, rtol=1e-12)


def test_bound_of_a_refitted_model_is_that_of_a_fresh_one(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor().fit(X, y)
    model.error_bound(X_new)
    model.fit(X[:20], 10 * y[:20])
    fresh = KoopmanKernelRegressor().fit(X[:20], 10 * y[:20])
    assert_array_equal(model.error_bound(X_new[:3]), fresh.error_bound(X_new[:3]))


def test_bound_from_distances_takes_a_given_norm(scattered):
    X, y, X_new = scattered
    states = KoopmanKernelRegressor("wendland_c2", beta=2.0).fit(X, y)
    model = KoopmanKernelRegressor("wendland_c2", beta=2.0, centers="precomputed")
    distances, model = cdist(X_new, X), model.fit(cdist(X, X), y)
    assert_allclose(
        model.error_bound(distances, [2.0, 1.0]),
        states.error_bound(X_new, [2.0, 1.0]),
        rtol=1e-8,
    )
    with pytest.raises(ValueError, match=r"precomputed.*give norm"):
        model.error_bound(distances)
    with pytest.raises(ValueError, match="not pickled"):
        pickle.loads(pickle.dumps(model)).error_bound(distances, 1.0)


def test_least_squares_at_chosen_centres_has_no_bound(scattered):
    X, y, X_new = scattered
    chosen = KoopmanKernelRegressor(method="least_squares", centers=X[:20]).fit(X, y)
    for norm in (None, 1.0):
        with pytest.raises(ValueError, match=r"method='least_squares'.*return_std"):
            chosen.error_bound(X_new, norm)
    # Where every row is a centre it is interpolation.
    every = KoopmanKernelRegressor(method="least_squares", alpha=0.1).fit(X, y)
    same = KoopmanKernelRegressor(alpha=0.1).fit(X, y)
    assert_array_equal(every.error_bound(X_new), same.error_bound(X_new))


def test_equal_rows_count_by_their_number(scattered):
    X, y, X_new = scattered
    twice = KoopmanKernelRegressor(alpha=0.1).fit(np.vstack([X, X]), np.vstack([y, y]))
    once = KoopmanKernelRegressor(alpha=0.05).fit(X, y)
    assert_allclose(twice.error_bound(X_new), once.error_bound(X_new), rtol=1e-9)


def test_frames_lists_and_integers_are_states(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(RBF(0.3)).fit(X, y[:, 0])
    bound = model.error_bound(X_new)
    assert_array_equal(model.error_bound(X_new.tolist()), bound)
    frame = KoopmanKernelRegressor(RBF(0.3)).fit(
        pd.DataFrame(X, columns=["p", "q"]), pd.Series(y[:, 0])
    )
    assert_array_equal(
        frame.error_bound(pd.DataFrame(X_new, columns=["p", "q"])), bound
    )
    assert_array_equal(model.error_bound([[0, 0]]), model.error_bound([[0.0, 0.0]]))


@pytest.mark.parametrize(
    "norm", [-1.0, np.nan, np.inf, [1.0, -1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]], []]
)
def test_a_norm_that_is_none_is_refused(scattered, norm):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor().fit(X, y)
    with pytest.raises(ValueError, match=r"^norm must be"):
        model.error_bound(X_new, norm)


def test_states_that_are_none_are_refused(scattered):
    X, y, _ = scattered
    model = KoopmanKernelRegressor().fit(X, y)
    with pytest.raises(ValueError, match="NaN"):
        model.error_bound([[np.nan, 0.0]])
    with pytest.raises(ValueError, match="1 features, but"):
        model.error_bound([[0.0]])


def test_bound_holds_where_a_factorisation_succeeds_by_chance():
    """At a reciprocal condition number of 1e-19 the last rows of a factor are noise."""
    kernel = KERNELS["gaussian"](beta=0.1)
    X = np.linspace(-1, 1, 60)[:, np.newaxis]
    X_new = np.linspace(-1.5, 1.5, 1001)[:, np.newaxis]
    rng = np.random.default_rng(0)
    Z, c = rng.uniform(-1.5, 1.5, (10, 1)), rng.standard_normal(10)
    norm = np.sqrt(c @ kernel(Z) @ c)
    with pytest.warns(LinAlgWarning, match="numerically singular"):
        model = KoopmanKernelRegressor(kernel).fit(X, kernel(X, Z) @ c)
    assert model.rcond_ > 1e-17
    error = np.abs(model.predict(X_new) - kernel(X_new, Z) @ c)
    with pytest.warns(UserWarning, match="off the manifold"):
        assert (error <= model.error_bound(X_new, norm)).all()
    assert error.max() > 1e-3


def test_noise_of_a_kernel_is_no_distance_from_the_manifold():
    """A noise term means the same as alpha: it bounds nothing, and warns of nothing."""
    pendulum = make_pendulum(600)
    train, rest = pendulum.X[::2], pendulum.X[1::2]
    centers = SeparatedCenterSelector(0.05)
    noisy = KoopmanKernelRegressor(
        Matern(1.0, nu=1.5) + WhiteKernel(0.01), centers=centers
    ).fit(train, pendulum.y[::2])
    ridge = KoopmanKernelRegressor(
        Matern(1.0, nu=1.5), alpha=0.01, centers=centers
    ).fit(train, pendulum.y[::2])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_allclose(
            noisy.error_bound(rest, 1.0), ridge.error_bound(rest, 1.0), rtol=1e-6
        )


def test_a_trend_that_no_centre_tells_has_no_bound():
    X = np.column_stack([np.linspace(0, 1, 20), np.zeros(20)])
    model = KoopmanKernelRegressor(beta=1.0, trend="linear").fit(X, np.sin(3 * X[:, 0]))
    with pytest.warns(UserWarning, match="1 of 2 states are off the manifold"):
        bound = model.error_bound([[0.5, 0.2], [0.52, 0.0]], norm=1.0)
    assert bound[0] == np.inf
    assert 0 < bound[1] < 0.1


def test_norm_is_not_estimated_from_centres_that_a_trend_meets():
    model = KoopmanKernelRegressor(trend="linear").fit([[0.0, 1.0], [1.0, 0.0]], [0, 1])
    with pytest.raises(ValueError, match="cannot be estimated from 2 centres"):
        model.error_bound([[0.5, 0.5]])
    assert np.isfinite(model.error_bound([[0.5, 0.5]], norm=1.0)).all()


def test_a_centre_apart_does_not_silence_the_warning():
    pendulum = make_pendulum(256)
    X, y = np.vstack([pendulum.X, [[50.0, 50.0]]]), np.append(pendulum.y, 1.0)
    model = KoopmanKernelRegressor(beta=1.0, centers=SeparatedCenterSelector(0.23))
    model.fit(X, y)
    with pytest.warns(UserWarning, match="1 of 1 states are off"):
        model.error_bound([[-10.0, -10.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.error_bound(X)


def test_states_that_no_centre_reaches_are_off_the_manifold():
    pendulum = make_pendulum(256)
    model = KoopmanKernelRegressor(
        "wendland_c2", beta=0.2, centers=SeparatedCenterSelector(0.23)
    ).fit(pendulum.X, pendulum.y)
    with pytest.warns(UserWarning, match="2 of 3 states .* raise beta"):
        model.error_bound([[-1e6, 0.0], model.centers_[0], [9.0, 9.0]])


@pytest.mark.parametrize("unit", [1e-100, 1e100])
def test_norms_are_estimated_in_any_unit(unit):
    pendulum = make_pendulum(100)
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector(0.3))
    bound = clone(model).fit(pendulum.X, pendulum.y).error_bound(pendulum.X)
    scaled = clone(model).fit(pendulum.X, unit * pendulum.y).error_bound(pendulum.X)
    assert_allclose(scaled / unit, bound, rtol=1e-12)


@pytest.mark.parametrize("norm", ["auto", True, -1.0, np.nan, [1.0, "b"]])
def test_norms_that_are_no_numbers(norm):
    model = KoopmanKernelRegressor().fit([[0.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]])
    with pytest.raises(ValueError, match="norm must be"):
        model.error_bound([[0.5]], norm)


def test_directions_that_no_centre_tells_are_found_in_any_unit():
    rng = np.random.default_rng(0)
    far = np.column_stack([1.7e9 + np.arange(60.0), rng.random(60), np.zeros(60)])
    model = KoopmanKernelRegressor(beta=10.0, trend="linear").fit(far, far[:, 1])
    with pytest.warns(UserWarning, match="off the manifold"):
        assert model.error_bound([[1.7e9 + 3.5, 0.5, 0.9]], norm=1.0) == np.inf
    uneven = np.column_stack([1e5 * rng.random(60), 1e-6 * rng.random(60)])
    model = KoopmanKernelRegressor(
        Matern(length_scale=[1e5, 1e-6], nu=1.5), trend="linear"
    ).fit(uneven, uneven[:, 0])
    with pytest.warns(UserWarning, match="off the manifold"):
        assert np.isfinite(model.error_bound([[5e4, 2e-4]], norm=1.0)).all()
    line = np.linspace(0, 1, 20)[:, np.newaxis] * [1.0, 2.0]
    model = KoopmanKernelRegressor(trend="linear").fit(line, np.sin(line[:, 0]))
    with pytest.warns(UserWarning, match="1 of 2 states"):
        bound = model.error_bound([[0.52, 1.04], [0.5, 1.5]], norm=1.0)
    assert np.isfinite(bound[0])
    assert bound[1] == np.inf


def test_one_centre_makes_no_estimate_of_the_norm():
    model = KoopmanKernelRegressor().fit([[0.0]], [1.0])
    with pytest.raises(ValueError, match="cannot be estimated from 1 centres"):
        model.error_bound([[0.5]])
    with pytest.warns(UserWarning, match="there is one centre only"):
        model.error_bound([[1e3]], norm=1.0)


def test_bound_is_that_of_the_model_as_it_was_fitted():
    X = np.linspace(0, 1, 20)[:, np.newaxis]
    model = KoopmanKernelRegressor(beta=1.0, centers="precomputed").fit(
        cdist(X, X), X[:, 0]
    )
    bound = model.error_bound(cdist(X, X), norm=1.0)
    model.set_params(trend="linear")
    assert_array_equal(model.error_bound(cdist(X, X), norm=1.0), bound)
