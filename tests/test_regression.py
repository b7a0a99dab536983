"""The regressor against independent dense computations and closed forms."""

import pickle
import subprocess
import sys
import tracemalloc

import joblib
import numpy as np
import pytest
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from reference import (
    dense_interpolant,
    dense_least_squares,
    kernel_matrix,
    monomials,
    squared_power,
)
from scipy.interpolate import RBFInterpolator
from scipy.linalg import LinAlgWarning, null_space, solve_triangular
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.frozen import FrozenEstimator
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    ExpSineSquared,
    Matern,
    WhiteKernel,
)
from sklearn.kernel_ridge import KernelRidge

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.kernels import KERNELS, MaternSobolev, Wendland

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

METHODS = ["interpolation", "least_squares"]


@pytest.fixture(scope="module")
def pendulum():
    return make_pendulum(n_samples=256)


@pytest.fixture
def scattered():
    """Noisy values of a smooth function at 120 scattered points, and new points."""
    rng = np.random.default_rng(0)
    X, X_new = rng.uniform(-2, 2, (120, 2)), rng.uniform(-2.5, 2.5, (40, 2))
    y = np.column_stack([np.sin(X[:, 0]) + X[:, 1], np.cos(X).prod(axis=1)])
    return X, y + 0.1 * rng.standard_normal(y.shape), X_new


def matern(X, Y, beta):
    return kernel_matrix("matern32", X, Y, beta)


# --- The paper's pendulum ------------------------------------------------------------


def test_pendulum_keeps_the_centres_of_the_paper(pendulum):
    selector = SeparatedCenterSelector(0.23)
    model = KoopmanKernelRegressor(centers=selector).fit(pendulum.X, pendulum.y)
    assert len(model.centers_) == 37
    assert_array_equal(pendulum.X[model.center_indices_], model.centers_)


@pytest.mark.parametrize("kernel", KERNELS)
def test_pendulum_interpolates_at_the_centres(pendulum, kernel):
    model = KoopmanKernelRegressor(
        kernel, beta=1.0, centers=SeparatedCenterSelector(0.23)
    ).fit(pendulum.X, pendulum.y)
    # Higham, Accuracy and Stability (2002), theorem 10.4 with a diagonal of ones, and
    # the rounding errors of the prediction.
    M = len(model.centers_)
    rounding = 2 * (M + 1) * np.finfo(float).eps * np.abs(model.dual_coef_).sum()
    assert rounding < 1e-7
    u = pendulum.y[model.center_indices_]
    assert_allclose(model.predict(model.centers_), u, atol=rounding, rtol=0)


def test_pendulum_agrees_with_a_dense_solve(pendulum):
    model = KoopmanKernelRegressor(beta=1.0, centers=SeparatedCenterSelector(0.23))
    model.fit(pendulum.X, pendulum.y)
    centers, u = model.centers_, pendulum.y[model.center_indices_]
    coefficients = np.linalg.solve(matern(centers, centers, 1.0), u)
    assert_allclose(model.dual_coef_, coefficients, rtol=1e-8)
    assert_allclose(
        model.predict(pendulum.X),
        matern(pendulum.X, centers, 1.0) @ coefficients,
        rtol=1e-8,
    )


def test_pendulum_error_reaches_rounding_with_a_smooth_kernel():
    """About 1000 centres on the orbit, compared on the same discrete orbit."""
    orbit = make_pendulum(n_samples=20_000)
    model = KoopmanKernelRegressor(
        "wendland_c6", beta=2.0, centers=SeparatedCenterSelector(0.0085)
    ).fit(orbit.X, orbit.y)
    assert 900 < len(model.centers_) < 1100
    assert np.abs(model.predict(orbit.X) - orbit.G(orbit.f(orbit.X))).max() < 1e-12


def test_predicts_the_output_after_the_row_not_of_the_row(pendulum):
    model = KoopmanKernelRegressor("wendland_c6", beta=4.0).fit(pendulum.X, pendulum.y)
    state = pendulum.X[100:101]
    assert_allclose(model.predict(state), pendulum.G(pendulum.f(state)), atol=1e-8)
    assert abs(model.predict(state)[0] - pendulum.G(state)[0]) > 1e-2


# --- Interpolation -------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_interpolation_equals_kernel_ridge(scattered, alpha):
    X, y, X_new = scattered
    ours = KoopmanKernelRegressor(beta=1.5, alpha=alpha).fit(X, y).predict(X_new)
    ridge = KernelRidge(alpha=alpha, kernel="precomputed").fit(matern(X, X, 1.5), y)
    assert_allclose(ours, ridge.predict(matern(X_new, X, 1.5)), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("alpha", [0.0, 0.3])
@pytest.mark.parametrize(("trend", "degree"), [("constant", 0), ("linear", 1)])
def test_trend_equals_scipys_interpolator(scattered, trend, degree, alpha):
    X, y, X_new = scattered
    beta = 0.3  # the condition number leaves ten digits
    model = KoopmanKernelRegressor("gaussian", beta=beta, alpha=alpha, trend=trend)
    theirs = RBFInterpolator(
        X,
        y,
        kernel="gaussian",
        epsilon=1 / (beta * np.sqrt(2)),
        degree=degree,
        smoothing=alpha,
    )
    assert_allclose(
        model.fit(X, y).predict(X_new), theirs(X_new), rtol=1e-8, atol=1e-10
    )


def test_trend_coefficients_are_those_of_the_saddle_system(scattered):
    X, y, _ = scattered
    model = KoopmanKernelRegressor(beta=1.5, trend="linear").fit(X, y)
    P = monomials(X, origin=X.mean(axis=0))
    c, b = dense_interpolant(matern(X, X, 1.5), P, y)
    assert_allclose(model.dual_coef_, c, atol=1e-9)
    assert_allclose(model.trend_coef_, b, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_linear_trend_extrapolates_linear_outputs(method):
    rng = np.random.default_rng(1)
    X, far = rng.normal(1e3, 1, (80, 3)), rng.normal(1e3, 50, (20, 3))
    A = rng.normal(size=(3, 2))
    model = KoopmanKernelRegressor(
        trend="linear", method=method, centers=SeparatedCenterSelector(0.5)
    ).fit(X, X @ A)
    assert_allclose(model.predict(far), far @ A, rtol=1e-9)


def test_constant_trend_is_the_value_far_away(scattered):
    X, y, _ = scattered
    model = KoopmanKernelRegressor(trend="constant").fit(X, y[:, 0])
    assert model.trend_coef_.shape == (1,)
    assert_allclose(model.predict([[1e3, 1e3]]), model.trend_coef_)
    assert_allclose(
        KoopmanKernelRegressor().fit(X, y[:, 0]).predict([[1e3, 1e3]]), 0, atol=1e-30
    )


def test_trend_ignores_constant_features_and_few_centres():
    X = np.column_stack([np.linspace(0, 1, 12), np.full(12, 7.1)])
    model = KoopmanKernelRegressor(trend="linear").fit(X, 2 * X[:, 0])
    assert_allclose(model.predict([[3.0, 7.1]]), [6.0], rtol=1e-9)
    one = KoopmanKernelRegressor(trend="linear").fit([[1.0, 2.0]], [5.0])
    assert_allclose(one.predict([[9.0, -4.0]]), [5.0])


def test_outputs_are_independent_of_each_other(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(trend="linear", alpha=0.1)
    both = clone(model).fit(X, y).predict(X_new, return_std=True)
    for column in range(2):
        one = clone(model).fit(X, y[:, column]).predict(X_new, return_std=True)
        assert one[0].shape == one[1].shape == (len(X_new),)
        assert_allclose(both[0][:, column], one[0], rtol=1e-10)
        assert_allclose(both[1][:, column], one[1], rtol=1e-10)


# --- Least squares -------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 0.05])
@pytest.mark.parametrize("centers", [None, "array", "selector", "kmeans"])
def test_least_squares_equals_stacked_lstsq(scattered, alpha, centers):
    X, y, X_new = scattered
    choice = {
        None: None,
        "array": X[::4] + 0.01,
        "selector": SeparatedCenterSelector(0.6),
        "kmeans": KMeans(15, n_init=1, random_state=0),
    }[centers]
    model = KoopmanKernelRegressor(
        beta=1.5, centers=choice, method="least_squares", alpha=alpha
    ).fit(X, y)
    Xi = model.centers_
    A, nothing = matern(X, Xi, 1.5), monomials(Xi, None)
    solve = dense_least_squares(
        matern(Xi, Xi, 1.5), nothing, A, monomials(X, None), alpha
    )
    expected = matern(X_new, Xi, 1.5) @ solve @ y
    assert_allclose(model.predict(X_new), expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("alpha", [0.0, 0.05])
@pytest.mark.parametrize("trend", ["constant", "linear"])
def test_least_squares_with_trend_equals_constrained_lstsq(scattered, trend, alpha):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(
        beta=1.5,
        centers=SeparatedCenterSelector(0.6),
        method="least_squares",
        alpha=alpha,
        trend=trend,
    ).fit(X, y)
    Xi = model.centers_
    P = monomials(Xi, trend)
    solve = dense_least_squares(
        matern(Xi, Xi, 1.5), P, matern(X, Xi, 1.5), monomials(X, trend), alpha
    )
    functions = np.hstack([matern(X_new, Xi, 1.5), monomials(X_new, trend)])
    assert_allclose(model.predict(X_new), functions @ solve @ y, rtol=1e-8, atol=1e-9)
    assert_allclose(P.T @ model.dual_coef_, 0, atol=1e-9)


@pytest.mark.parametrize("trend", [None, "constant", "linear"])
@pytest.mark.parametrize("alpha", [0.0, 0.2])
def test_methods_agree_where_every_row_is_a_centre(scattered, trend, alpha):
    X, y, X_new = scattered
    same = {
        method: KoopmanKernelRegressor(trend=trend, alpha=alpha, method=method)
        .fit(X, y)
        .predict(X_new, return_std=True)
        for method in METHODS
    }
    # The general path of least squares, which does not know that the rows are centres.
    general = KoopmanKernelRegressor(
        trend=trend, alpha=alpha, method="least_squares", centers=X
    ).fit(X, y)
    assert_allclose(same["interpolation"][0], same["least_squares"][0], rtol=1e-12)
    assert_allclose(general.predict(X_new), same["interpolation"][0], atol=1e-9)


@pytest.mark.parametrize("alpha", [1e-8, 1e4, 1e12])
def test_no_weight_harms_the_trend(scattered, alpha):
    """In the limit the kernel part vanishes, and linear regression remains."""
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(
        beta=1.0,
        centers=SeparatedCenterSelector(0.6),
        method="least_squares",
        alpha=alpha,
        trend="linear",
    ).fit(X, y)
    Xi = model.centers_
    N = null_space(monomials(Xi).T)
    L = np.linalg.cholesky(matern(Xi, Xi, 1.0))
    # The polynomials are eliminated by projection, and the weight by scaling.
    Q = np.linalg.qr(monomials(X))[0]
    A = matern(X, Xi, 1.0) @ N
    A = np.vstack([(A - Q @ (Q.T @ A)) / np.sqrt(alpha), L.T @ N])
    target = np.vstack([(y - Q @ (Q.T @ y)) / np.sqrt(alpha), np.zeros((len(Xi), 2))])
    c = N @ np.linalg.lstsq(A, target, rcond=None)[0]
    b = np.linalg.lstsq(monomials(X), y - matern(X, Xi, 1.0) @ c, rcond=None)[0]
    expected = matern(X_new, Xi, 1.0) @ c + monomials(X_new) @ b
    assert_allclose(model.predict(X_new), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("alpha", [0.0, 0.1])
def test_trend_alone_where_it_takes_every_centre(scattered, alpha):
    """One centre and a constant, or three and a linear tail: no kernel part is left."""
    X, y, X_new = scattered
    options = {"method": "least_squares", "alpha": alpha}
    constant = KoopmanKernelRegressor(centers=X[:1], trend="constant", **options)
    assert_allclose(
        constant.fit(X, y).predict(X_new),
        np.broadcast_to(y.mean(axis=0), (40, 2)),
        rtol=1e-9,
    )
    linear = KoopmanKernelRegressor(centers=X[:3], trend="linear", **options)
    b = np.linalg.lstsq(monomials(X), y, rcond=None)[0]
    assert_allclose(linear.fit(X, y).predict(X_new), monomials(X_new) @ b, rtol=1e-9)


@pytest.mark.parametrize("trend", [None, "linear"])
def test_a_vanishing_weight_is_none(scattered, trend):
    X, y, X_new = scattered
    none, tiny = (
        KoopmanKernelRegressor(
            centers=X[::4], method="least_squares", alpha=alpha, trend=trend
        )
        .fit(X, y)
        .predict(X_new, return_std=True)
        for alpha in (0.0, 1e-300)
    )
    assert_allclose(none, tiny, rtol=1e-10)


def test_trend_that_the_centres_do_not_determine_is_refused():
    rng = np.random.default_rng(6)
    X = rng.standard_normal((200, 10))
    X[:, 3] = 7.0  # a feature that does not vary needs no centres
    y = X @ rng.standard_normal((10, 2)) + 3.0
    model = KoopmanKernelRegressor(
        centers=KMeans(9, n_init=1, random_state=0),
        method="least_squares",
        trend="linear",
    )
    with pytest.raises(ValueError, match=r"the 9 independent .* more centres than fea"):
        model.fit(X, y)
    assert not hasattr(model, "dual_coef_")
    model.set_params(centers__n_clusters=10).fit(X, y)
    far = 100 * rng.standard_normal((20, 10))
    far[:, 3] = 7.0
    expected = far @ np.linalg.lstsq(X, y, rcond=None)[0]
    assert_allclose(model.predict(far), expected, rtol=1e-6)
    # Centres in a plane.
    model.set_params(centers=np.insert(X[:20, :9], 9, 0.0, axis=1))
    with pytest.raises(ValueError, match="not all in one plane"):
        model.fit(X, y)


def test_trend_is_zero_in_directions_that_rows_do_not_show():
    rng = np.random.default_rng(7)
    X = np.column_stack([rng.uniform(-1, 1, 50), np.zeros(50)])
    centers = rng.uniform(-1, 1, (6, 2))
    model = KoopmanKernelRegressor(
        centers=centers, method="least_squares", trend="linear", alpha=1e-3
    ).fit(X, 2 * X[:, 0])
    assert_allclose(model.predict(X), 2 * X[:, 0], atol=1e-6)
    other = KoopmanKernelRegressor(
        centers=X[::10], method="least_squares", trend="linear", alpha=1e-3
    ).fit(X, 2 * X[:, 0])
    assert_allclose(other.trend_coef_[1:], [2.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("kernel", ["matern12", "matern32", "wendland_c2"])
def test_rows_that_do_not_determine_the_centres_are_refused(kernel):
    rng = np.random.default_rng(8)
    X = np.repeat(rng.uniform(-1, 1, (11, 2)), 3, axis=0)
    y = np.sin(X[:, 0])
    for _ in range(20):
        centers = rng.uniform(-1, 1, (12, 2))
        model = KoopmanKernelRegressor(kernel, centers=centers, method="least_squares")
        with pytest.raises(ValueError, match=r"12 centres; set alpha > 0"):
            model.fit(X, y)


def test_least_squares_keeps_accuracy_that_normal_equations_lose():
    """A condition number of 1e13 in the sections, whose normal equations square it."""
    X = np.linspace(0, 1, 400)[:, np.newaxis]
    y, centers = np.sin(7 * X[:, 0]), X[::4]
    model = KoopmanKernelRegressor(
        "matern52", beta=2.0, centers=centers, method="least_squares"
    ).fit(X, y)
    K = model.kernel_(X, centers)
    assert np.linalg.cond(K) > 1e13
    L = np.linalg.cholesky(model.kernel_(centers))
    A = solve_triangular(L, K.T, lower=True).T
    best = np.linalg.norm(A @ np.linalg.lstsq(A, y, rcond=None)[0] - y)
    assert np.linalg.norm(model.predict(X) - y) < 1.001 * best
    normal = K @ np.linalg.solve(K.T @ K, K.T @ y)
    assert np.linalg.norm(normal - y) > 10 * best


def test_equal_rows_count_by_their_number(scattered):
    """As kernel ridge regression on all rows, and least squares, has it."""
    X, y, X_new = scattered
    X = np.vstack([X, X[:30], X[:10]])
    y = np.vstack([y, y[:30] + 1.0, y[:10] - 2.0])
    model = KoopmanKernelRegressor(beta=1.5, alpha=0.2).fit(X, y)
    ridge = KernelRidge(alpha=0.2, kernel="precomputed").fit(matern(X, X, 1.5), y)
    assert len(model.centers_) == 120
    assert_array_equal(model.center_indices_, np.arange(120))
    assert_allclose(
        model.predict(X_new), ridge.predict(matern(X_new, X, 1.5)), rtol=1e-8, atol=1e-9
    )
    mean = clone(model).set_params(alpha=0, method="least_squares").fit(X, y)
    assert_allclose(mean.predict(X[:10]), (3 * y[:10] - 1.0) / 3, atol=1e-9)


# --- Power function and standard deviation -------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 0.1])
def test_power_function_is_the_schur_complement(scattered, alpha):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(beta=1.5, alpha=alpha).fit(X, y)
    k, K = matern(X, X_new, 1.5), matern(X, X, 1.5) + alpha * np.eye(len(X))
    schur = squared_power(K, monomials(X, None), k, monomials(X_new, None))
    assert_allclose(model.power_function(X_new), np.sqrt(schur), atol=1e-8)
    assert model.power_function(X_new).max() <= 1
    if alpha == 0:
        assert model.power_function(X).max() < 1e-6


@pytest.mark.parametrize("trend", ["constant", "linear"])
def test_power_function_with_trend_is_that_of_universal_kriging(scattered, trend):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(beta=1.5, trend=trend).fit(X, y)
    P, p = monomials(X, trend), monomials(X_new, trend)
    variance = squared_power(matern(X, X, 1.5), P, matern(X, X_new, 1.5), p)
    assert_allclose(model.power_function(X_new), np.sqrt(variance), atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_power_function_bounds_the_error_in_the_native_space(method):
    """For functions of known norm: finite combinations of kernel sections."""
    rng = np.random.default_rng(2)
    X, X_new = rng.uniform(-1, 1, (60, 2)), rng.uniform(-1.5, 1.5, (2000, 2))
    points, weights = rng.uniform(-1.5, 1.5, (30, 2)), rng.standard_normal(30)
    norm = np.sqrt(weights @ matern(points, points, 1.0) @ weights)
    model = KoopmanKernelRegressor(method=method)
    model.fit(X, matern(X, points, 1.0) @ weights)
    error = np.abs(model.predict(X_new) - matern(X_new, points, 1.0) @ weights)
    assert (error <= norm * model.power_function(X_new) + 1e-12).all()
    assert (error > 0.1 * norm * model.power_function(X_new)).any()


def test_standard_deviation_is_that_of_a_gaussian_process(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(beta=1.5, alpha=0.1).fit(X, y[:, 0])
    variance = model.signal_std_**2
    process = GaussianProcessRegressor(
        ConstantKernel(variance) * Matern(1.5, nu=1.5),
        alpha=0.1 * variance,
        optimizer=None,
    ).fit(X, y[:, 0])
    mean, std = process.predict(X_new, return_std=True)
    ours, our_std = model.predict(X_new, return_std=True)
    assert_allclose(ours, mean, rtol=1e-8)
    # Theirs is that of the function, ours includes the noise of the outputs.
    assert_allclose(our_std**2, std**2 + 0.1 * variance, rtol=1e-8)
    assert_allclose(model.noise_std_**2, 0.1 * variance)
    # The amplitude maximises the likelihood.
    likelihoods = [
        GaussianProcessRegressor(
            ConstantKernel(v) * Matern(1.5, nu=1.5), alpha=0.1 * v, optimizer=None
        )
        .fit(X, y[:, 0])
        .log_marginal_likelihood_value_
        for v in variance * np.array([0.98, 1.0, 1.02])
    ]
    assert np.argmax(likelihoods) == 1


def test_standard_deviation_covers_what_it_should():
    """Samples of the process itself, whose outputs are off by 2 std in 5 % of cases."""
    rng = np.random.default_rng(3)
    X = rng.uniform(0, 4, (300, 2))
    factor = np.linalg.cholesky(9 * matern(X, X, 1.0) + 0.04 * np.eye(300))
    y = factor @ rng.standard_normal((300, 40))
    model = KoopmanKernelRegressor(beta=1.0, alpha=0.04 / 9).fit(X[:200], y[:200])
    assert_allclose(model.signal_std_.mean(), 3.0, rtol=0.05)
    mean, std = model.predict(X[200:], return_std=True)
    assert np.mean(np.abs(y[200:] - mean) < 1.96 * std) == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("trend", [None, "linear"])
@pytest.mark.parametrize("alpha", [0.0, 0.05, 10.0])
def test_effective_parameters_are_the_trace_of_the_hat_matrix(scattered, alpha, trend):
    X, _, _ = scattered
    model = KoopmanKernelRegressor(
        centers=X[::5], method="least_squares", alpha=alpha, trend=trend
    )
    hat = model.fit(X, np.eye(len(X))).predict(X)
    model.fit(X, X[:, 0] ** 3)
    residual = X[:, 0] ** 3 - hat @ X[:, 0] ** 3
    freedom = len(X) - np.trace(hat)
    assert_allclose(model.noise_std_, np.sqrt(residual @ residual / freedom), rtol=1e-6)


def test_standard_deviation_of_least_squares_covers_what_it_should():
    rng = np.random.default_rng(9)
    X = rng.uniform(0, 3, (400, 2))
    factor = np.linalg.cholesky(4 * matern(X, X, 2.0) + 0.25 * np.eye(400))
    y = factor @ rng.standard_normal((400, 40))
    model = KoopmanKernelRegressor(
        beta=2.0,
        method="least_squares",
        alpha=0.25 / 4,
        centers=SeparatedCenterSelector(0.2),
    ).fit(X[:300], y[:300])
    assert_allclose(model.noise_std_.mean(), 0.5, rtol=0.03)
    mean, std = model.predict(X[300:], return_std=True)
    assert np.mean(np.abs(y[300:] - mean) < 1.96 * std) == pytest.approx(0.95, abs=0.02)


def test_noise_of_least_squares_is_that_of_the_residuals():
    rng = np.random.default_rng(4)
    X = rng.uniform(0, 4, (3000, 1))
    y = np.sin(2 * X[:, 0]) + 0.2 * rng.standard_normal(3000)
    model = KoopmanKernelRegressor(
        method="least_squares", centers=SeparatedCenterSelector(0.3)
    ).fit(X, y)
    residual = y - model.predict(X)
    assert_allclose(
        model.noise_std_, np.sqrt(residual @ residual / (3000 - len(model.centers_)))
    )
    assert_allclose(model.noise_std_, 0.2, rtol=0.05)


# --- Centres in all their forms ------------------------------------------------------


@every_pair(
    kernel=[*KERNELS, Matern(1.5, nu=2.5), 2.0 * RBF(0.7)],
    n_features=[1, 3, 6],
    method=METHODS,
    trend=[None, "constant"],
)
def test_distances_serve_as_well_as_states(
    scattered, method, trend, kernel, n_features
):
    X, y, X_new = scattered
    lift = np.random.default_rng(0).standard_normal((2, n_features))
    X, X_new = X @ lift, X_new @ lift
    if n_features > 3 and isinstance(kernel, str) and kernel.startswith("wendland"):
        kernel = KERNELS[kernel](beta=3.0, dimension=n_features)
    selector = SeparatedCenterSelector(0.3).fit(X)
    options = {"beta": None, "method": method, "trend": trend, "alpha": 1e-3}
    inside = KoopmanKernelRegressor(
        kernel, centers=SeparatedCenterSelector(0.3), **options
    ).fit(X, y)
    outside = KoopmanKernelRegressor(kernel, centers="precomputed", **options)
    outside.fit(selector.transform(X), y)
    distances = selector.transform(X_new)
    for ours, theirs in zip(
        inside.predict(X_new, return_std=True),
        outside.predict(distances, return_std=True),
        strict=True,
    ):
        assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)
    assert not hasattr(outside, "centers_")
    assert_array_equal(inside.center_indices_, outside.center_indices_)


def test_a_noise_kernel_counts_at_the_centres_only(scattered):
    X, y, X_new = scattered
    noisy = KoopmanKernelRegressor(Matern(1.5, nu=1.5) + WhiteKernel(0.2)).fit(X, y)
    ridge = KoopmanKernelRegressor(beta=1.5, alpha=0.2).fit(X, y)
    assert_allclose(noisy.predict(X_new), ridge.predict(X_new), rtol=1e-9)
    distances = cdist(X, X)
    outside = KoopmanKernelRegressor(noisy.kernel, centers="precomputed")
    outside.fit(distances, y)
    assert_allclose(outside.predict(cdist(X_new, X)), ridge.predict(X_new), rtol=1e-9)


def test_a_small_noise_kernel_keeps_the_centres(scattered):
    """The estimate misses the outputs by that noise, as it should."""
    X, y, X_new = scattered
    kernel = RBF(10.0) + WhiteKernel(1e-8)
    model = KoopmanKernelRegressor(kernel).fit(X, y)
    process = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None).fit(X, y)
    assert len(model.centers_) == len(X)
    assert_allclose(model.predict(X_new), process.predict(X_new), rtol=1e-4, atol=1e-4)
    for noise in (0.3, 10.0):
        model = KoopmanKernelRegressor(Matern(0.01) + WhiteKernel(noise)).fit(X, y)
        assert 0.3 < model.rcond_ <= 1


def test_a_kernel_of_any_kind_serves(scattered):
    """Not radial, not stationary: Bayesian linear regression, in effect."""
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(DotProduct(1.0), alpha=0.1).fit(X, y)
    P = np.hstack([np.ones((len(X), 1)), X])
    ridge = np.linalg.solve(P.T @ P + 0.1 * np.eye(3), P.T @ y)
    assert_allclose(model.predict(X_new), monomials(X_new) @ ridge, rtol=1e-8)


def test_array_of_centres_is_found_among_the_rows(scattered):
    X, y, _ = scattered
    rows = np.array([7, 3, 50, 90])
    model = KoopmanKernelRegressor(centers=X[rows]).fit(X, y)
    assert_array_equal(model.center_indices_, rows)
    assert_allclose(model.predict(X[rows]), y[rows], atol=1e-10)
    twice = KoopmanKernelRegressor(centers=X[rows]).fit(
        np.vstack([X, X]), np.vstack([y, -y])
    )
    assert_array_equal(twice.center_indices_, rows)  # the first of equal rows


def test_frozen_selector_does_not_point_into_other_data(scattered):
    X, y, X_new = scattered
    frozen = FrozenEstimator(SeparatedCenterSelector(0.7).fit(X))
    order = np.random.default_rng(0).permutation(len(X))
    direct = KoopmanKernelRegressor(centers=frozen).fit(X, y)
    shuffled = KoopmanKernelRegressor(centers=frozen).fit(X[order], y[order])
    assert_allclose(shuffled.predict(X_new), direct.predict(X_new), rtol=1e-9)
    assert_array_equal(X[order][shuffled.center_indices_], direct.centers_)


def test_wendland_takes_the_dimension_of_the_data(scattered):
    X, y, _ = scattered
    model = KoopmanKernelRegressor("wendland_c2").fit(np.hstack([X, X, X]), y)
    assert model.kernel_.dimension == 6
    composed = KoopmanKernelRegressor(2.0 * Wendland(3.0) + MaternSobolev()).fit(X, y)
    assert composed.kernel_.k1.k2.dimension == 3  # the least, as for distances
    assert composed.kernel.k1.k2.dimension is None  # the parameter stays as it was
    distances = KoopmanKernelRegressor("wendland_c2", beta=1.0, centers="precomputed")
    assert distances.fit(cdist(X, X), y).kernel_.dimension == 3


# --- Matrices that are not positive definite -----------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_dependent_centres_are_left_out_with_a_warning(method):
    X = np.linspace(0, 1, 300)[:, np.newaxis]
    y = np.sin(5 * X[:, 0])
    model = KoopmanKernelRegressor(
        "gaussian", centers=SeparatedCenterSelector(0.0), method=method
    )
    with pytest.warns(LinAlgWarning, match=r"on 300 centres.*\d+ centres that depend"):
        model.fit(X, y)
    assert len(model.centers_) == len(model.dual_coef_) < 100
    assert_array_equal(X[model.center_indices_], model.centers_)
    # The function is in the native space, to the digits that are left.
    assert np.abs(model.predict(X) - y).max() < 2e-5
    assert model.power_function(X).max() < 1e-6


def test_strict_solver_refuses():
    X = np.linspace(0, 1, 300)[:, np.newaxis]
    model = KoopmanKernelRegressor("gaussian", solver="cholesky")
    with pytest.raises(ValueError, match=r"kernel=Gaussian.*300 centres.*separation"):
        model.fit(X, X[:, 0])


def test_no_solution_is_used_that_misses_its_values():
    """Cholesky succeeds here, but noise has coefficients too large for the digits."""
    rng = np.random.default_rng(0)
    X = np.linspace(0, 1, 60)[:, np.newaxis]
    y = rng.standard_normal(60)
    np.linalg.cholesky(KERNELS["wendland_c6"](beta=3.0)(X))
    with pytest.warns(LinAlgWarning, match="centres that depend"):
        model = KoopmanKernelRegressor("wendland_c6", beta=3.0).fit(X, y)
    missed = model.predict(model.centers_) - y[model.center_indices_]
    # Solutions are accepted up to 1e-6, with rounding errors of their own.
    size = np.abs(model.dual_coef_).sum()
    rounding = 2 * len(missed) * np.finfo(float).eps * size
    assert rounding < 1e-3
    assert np.abs(missed).max() <= 1e-6 * np.abs(y).max() + rounding


@pytest.mark.parametrize("method", METHODS)
def test_a_kernel_that_is_not_positive_definite_is_refused(method):
    X = np.random.default_rng(0).standard_normal((40, 3))
    model = KoopmanKernelRegressor(
        ExpSineSquared(), centers=X[:20], method=method, alpha=1e-3
    )
    with pytest.raises(ValueError, match=r"ExpSineSquared.*is not positive definite"):
        model.fit(X, X[:, 0])


def test_trend_that_is_lost_with_dependent_centres_is_refused():
    """A kernel too wide to tell one centre from another leaves a single one."""
    rng = np.random.default_rng(10)
    X, A = rng.standard_normal((100, 6)), rng.standard_normal((6, 2))
    model = KoopmanKernelRegressor(
        "gaussian",
        beta=1e8,
        centers=X[:20],
        method="least_squares",
        alpha=1e-3,
        trend="linear",
    )
    with pytest.raises(ValueError, match="independent centres do not determine"):
        model.fit(X, X @ A)


def test_regularised_least_squares_leaves_centres_out_in_silence():
    """They change nothing: the estimate is that of twice as wide a separation."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0, 1, (500, 1))
    y = np.sin(5 * X[:, 0]) + 0.1 * rng.standard_normal(500)
    model = KoopmanKernelRegressor(
        "gaussian",
        beta=0.5,
        centers=SeparatedCenterSelector(0.005),
        method="least_squares",
        alpha=1e-2,
    ).fit(X, y)
    selected = SeparatedCenterSelector(0.005).fit(X).cluster_centers_
    assert len(model.centers_) < len(selected)
    # Kernel ridge regression on all rows has the dropped directions, too.
    K = model.kernel_(X)
    ridge = K @ np.linalg.solve(K + 1e-2 * np.eye(500), y)
    assert_allclose(model.predict(X), ridge, atol=1e-6)


# --- Memory, threads, pickles --------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "trend", "M"),
    [
        ("interpolation", "linear", 1000),
        ("least_squares", None, 1000),
        pytest.param("interpolation", None, 2000, marks=pytest.mark.slow),
        pytest.param("least_squares", "linear", 2000, marks=pytest.mark.slow),
    ],
)
def test_fit_holds_little_more_than_one_matrix(method, trend, M):
    """And blocks of rows, of 8 MB at most, for least squares."""
    rng = np.random.default_rng(0)
    X, y = rng.uniform(size=(2 * M, 3)), rng.standard_normal((2 * M, 2))
    centers = X[:M].copy()
    model = KoopmanKernelRegressor(
        "matern12", centers=centers, method=method, trend=trend
    )
    tracemalloc.start()
    try:
        model.fit(X, y)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    blocks = 8e6 if method == "least_squares" else 0.2 * 8 * M**2
    assert peak < 1.05 * 8 * M**2 + blocks


def test_prediction_never_holds_the_kernel_matrix():
    rng = np.random.default_rng(0)
    X, y = rng.uniform(size=(1000, 3)), rng.standard_normal(1000)
    X_new = rng.uniform(size=(10_000, 3))
    model = KoopmanKernelRegressor("matern12").fit(X, y)
    tracemalloc.start()
    try:
        model.predict(X_new)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        model.power_function(X_new)
        _, peak_power = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 0.1 * 8 * 10_000 * 1000
    assert peak_power < 0.1 * 8 * 10_000 * 1000


def test_threads_and_blocks_change_nothing(scattered):
    X, y, _ = scattered
    X_new = np.random.default_rng(5).uniform(-2, 2, (3000, 2))
    one = KoopmanKernelRegressor(trend="linear").fit(X, y)
    two = KoopmanKernelRegressor(trend="linear", n_jobs=2).fit(X, y)
    # BLAS may sum the products with 120 coefficients in another order.
    rounding = 2 * 120 * np.finfo(float).eps * np.abs(one.dual_coef_).sum(axis=0)
    assert rounding.max() < 1e-9
    y, std = one.predict(X_new, return_std=True)
    y_two, std_two = two.predict(X_new, return_std=True)
    assert (np.abs(y_two - y) <= rounding).all()
    # The squared power function is one less a sum of squares that is one at most.
    assert_allclose(std_two**2, std**2, rtol=0, atol=1e-12 * one.signal_std_.max() ** 2)
    rows = np.vstack([one.predict(x[np.newaxis]) for x in X_new[:50]])
    assert (np.abs(y[:50] - rows) <= rounding).all()


def test_pickle_is_small_and_the_factor_comes_back(scattered):
    rng = np.random.default_rng(0)
    X, y = rng.uniform(size=(1500, 3)), rng.standard_normal((1500, 2))
    model = KoopmanKernelRegressor("matern12", trend="linear", alpha=0.1).fit(X, y)
    dump = pickle.dumps(model)
    assert len(dump) < 20 * 8 * 1500 < 0.02 * 8 * 1500**2
    loaded = pickle.loads(dump)
    X_new = rng.uniform(size=(100, 3))
    assert_array_equal(loaded.predict(X_new), model.predict(X_new))
    assert_allclose(
        loaded.power_function(X_new), model.power_function(X_new), rtol=1e-12
    )


def test_pickle_of_distances_says_what_it_cannot_do(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(beta=1.0, centers="precomputed").fit(cdist(X, X), y)
    loaded = pickle.loads(pickle.dumps(model))
    distances = cdist(X_new, X)
    assert_array_equal(loaded.predict(distances), model.predict(distances))
    with pytest.raises(ValueError, match=r"precomputed.*not pickled.*fit again"):
        loaded.power_function(distances)


@pytest.mark.slow
def test_another_process_predicts_the_same_bits(tmp_path, pendulum):
    model = KoopmanKernelRegressor(
        "wendland_c4", beta=3.0, centers=SeparatedCenterSelector(0.05)
    ).fit(pendulum.X, np.column_stack([pendulum.y, pendulum.X_next]))
    joblib.dump((model, pendulum.X), tmp_path / "model.joblib")
    code = (
        "import sys, joblib, numpy as np\n"
        "model, X = joblib.load(sys.argv[1])\n"
        "np.save(sys.argv[2], model.predict(X))\n"
    )
    result = tmp_path / "result.npy"
    subprocess.run(
        [sys.executable, "-c", code, tmp_path / "model.joblib", result], check=True
    )
    assert_array_equal(np.load(result), model.predict(pendulum.X))


def test_parameters_set_after_the_fit_wait_for_the_next(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(alpha=0.1, trend="constant").fit(X, y)
    before = model.predict(X_new, return_std=True)
    model.set_params(
        centers="precomputed", alpha=1.0, trend=None, beta=9.0, method="least_squares"
    )
    for loaded in (model, pickle.loads(pickle.dumps(model))):
        for after, value in zip(
            loaded.predict(X_new, return_std=True), before, strict=True
        ):
            assert_allclose(after, value, rtol=1e-12)


def test_refitting_forgets_the_former_fit(scattered):
    X, y, X_new = scattered
    model = KoopmanKernelRegressor(beta=1.0, trend="linear").fit(X, y)
    model.set_params(trend=None, centers="precomputed").fit(cdist(X, X), y)
    assert not hasattr(model, "trend_coef_")
    assert not hasattr(model, "centers_")
    fresh = KoopmanKernelRegressor(beta=1.0).fit(X, y)
    assert_allclose(model.predict(cdist(X_new, X)), fresh.predict(X_new), rtol=1e-9)
