"""Weights of rows: whole ones repeat rows, zero leaves them out, all are multiplied."""

import pickle
import warnings
from itertools import pairwise, product

import numpy as np
import pytest
import sklearn
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from reference import (
    dense_interpolant,
    dense_least_squares,
    kernel_matrix,
    monomials,
    squared_power,
)
from scipy.spatial.distance import cdist
from sklearn.base import BaseEstimator, clone
from sklearn.cluster import KMeans
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.metrics import make_scorer, max_error, mean_squared_error, r2_score
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
)
from sklearn_koopman._linalg._least_squares import sum_normal_equations
from sklearn_koopman._linalg._systems import DirectSystem
from sklearn_koopman._matrices._sections import KernelSections
from sklearn_koopman._utils._rows import (
    AveragedOutputs,
    average_at,
    count_distinct,
    weights_at,
)
from sklearn_koopman.kernels import Wendland
from sklearn_koopman.solvers import ConjugateGradient

TRENDS = [None, "constant", "linear"]
METHODS = ["interpolation", "least_squares"]
# The first and the last row would be centres, if they were present.
WHOLE = np.random.default_rng(3).integers(0, 4, 60)
WHOLE[[0, -1]] = 0
WHOLE[[1, 2]] = [3, 1]
FRACTIONS = np.where(WHOLE == 0, 0.0, np.random.default_rng(4).uniform(0.2, 3.0, 60))
PRESENT = np.flatnonzero(WHOLE)
# Numbers of the rows that the repeated ones come from.
REPEATED = np.repeat(np.arange(60), WHOLE)


@pytest.fixture
def noisy():
    """Sixty states, outputs with noise, and fifteen more states."""
    rng = np.random.default_rng(0)
    X, X_new = rng.uniform(-1, 1, (60, 2)), rng.uniform(-1, 1, (15, 2))
    y = np.column_stack([np.sin(3 * X[:, 0]), X[:, 0] * X[:, 1]])
    return X, y + 0.1 * rng.standard_normal(y.shape), X_new


CENTERS = {
    "all": lambda X: None,
    "sequential": lambda X: SeparatedCenterSelector(0.35),
    "farthest": lambda X: SeparatedCenterSelector(
        0.0, order="farthest", max_centers=15
    ),
    "array": lambda X: X[PRESENT[::3]],
    "elsewhere": lambda X: X[PRESENT[::3]] + 0.05,
    # A tolerance would be in units of a variance without weights.
    "KMeans": lambda X: KMeans(8, init=X[PRESENT[:8]], n_init=1, tol=0.0),
    "precomputed": lambda X: "precomputed",
}
AMONG_ROWS = ["all", "sequential", "farthest", "array", "precomputed"]
SOLVERS = {
    "auto": "auto",
    "cholesky": "cholesky",
    "iterative": ConjugateGradient(tol=1e-12),
}


def make(X, centers, solver="auto", **options):
    """Return a regressor and what turns states to its input.

    Where options do not go together, centres count.
    """
    if centers == "precomputed":
        solver = "auto" if solver == "iterative" else solver
        if options.get("trend") == "linear":
            options["trend"] = "constant"
    if centers not in AMONG_ROWS:
        options["method"] = "least_squares"
    model = KoopmanKernelRegressor(
        "matern32",
        beta=1.0,
        centers=CENTERS[centers](X),
        solver=SOLVERS[solver],
        **options,
    )
    if centers == "precomputed":
        return model, lambda states: cdist(states, X[PRESENT[::3]])
    return model, lambda states: states


def assert_same_estimate(found, expected, X_new, rtol=1e-9, noise=1e-9):
    for name in ("signal_std_", "noise_std_"):
        assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=max(rtol, noise)
        )
    assert_allclose(found.predict(X_new), expected.predict(X_new), rtol=rtol, atol=rtol)
    power = expected.power_function(X_new)
    assert_allclose(found.power_function(X_new), power, rtol=rtol, atol=rtol)
    if hasattr(expected, "_averages") and not hasattr(expected, "n_iter_"):
        norm = None if hasattr(expected, "centers_") else 1.0
        bounds = [one.error_bound(X_new, norm) for one in (found, expected)]
        assert_allclose(*bounds, rtol=rtol)


# --- Regression: repeated rows and absent ones ----------------------------------------


@every_pair(
    centers=CENTERS, method=METHODS, trend=TRENDS, solver=SOLVERS, alpha=[0.0, 0.1]
)
# A trend is not determined outside, which the bound says.
@pytest.mark.filterwarnings("ignore:.*off the manifold")
def test_whole_weights_are_repeated_rows(noisy, centers, method, trend, solver, alpha):
    X, y, X_new = noisy
    model, rows = make(X, centers, solver, method=method, trend=trend, alpha=alpha)
    found = clone(model).fit(rows(X), y, sample_weight=WHOLE)
    expected = clone(model).fit(rows(X[REPEATED]), y[REPEATED])
    if expected.center_indices_ is not None:
        own = REPEATED[expected.center_indices_]
        assert_array_equal(found.center_indices_, own)
    # Conjugate gradients end at their tolerance, and estimate the noise at random.
    iterative = solver == "iterative"
    rtol, noise = (1e-6, 0.05) if iterative else (1e-9, 1e-9)
    assert_same_estimate(found, expected, rows(X_new), rtol, noise)


@every_pair(centers=CENTERS, method=METHODS, trend=TRENDS, solver=SOLVERS)
@pytest.mark.filterwarnings("ignore:.*off the manifold")
def test_rows_of_weight_zero_are_absent(noisy, centers, method, trend, solver):
    X, y, X_new = noisy
    model, rows = make(X, centers, solver, method=method, trend=trend, alpha=0.1)
    found = clone(model).fit(rows(X), y, sample_weight=FRACTIONS)
    expected = clone(model).fit(
        rows(X[PRESENT]), y[PRESENT], sample_weight=FRACTIONS[PRESENT]
    )
    if expected.center_indices_ is not None:
        own = PRESENT[expected.center_indices_]
        assert_array_equal(found.center_indices_, own)
    assert_same_estimate(found, expected, rows(X_new), 1e-12, 1e-12)
    once = clone(model).fit(rows(X), y, sample_weight=WHOLE > 0)
    without = clone(model).fit(rows(X[PRESENT]), y[PRESENT])
    assert_same_estimate(once, without, rows(X_new), 1e-9, 1e-9)


@every_pair(centers=["all", "sequential", "farthest"], method=METHODS)
def test_rows_of_weight_zero_would_have_been_centres(noisy, centers, method):
    X, y, _ = noisy
    model, _ = make(X, centers, method=method, alpha=0.1)
    assert 0 in clone(model).fit(X, y).center_indices_
    found = model.fit(X, y, sample_weight=WHOLE)
    assert np.isin(found.center_indices_, PRESENT).all()
    assert_array_equal(found.centers_, X[found.center_indices_])


@every_pair(
    centers=["all", "sequential", "array", "precomputed"],
    trend=TRENDS,
    solver=SOLVERS,
    alpha=[0.0, 0.1],
)
@pytest.mark.filterwarnings("ignore:.*off the manifold")
def test_equal_rows_count_by_their_weighted_mean(noisy, centers, trend, solver, alpha):
    """With contradicting outputs, which at chosen centres are no error without alpha.

    One row with the mean output and the sum of the weights says the same.
    """
    X, y, X_new = noisy
    model, rows = make(
        X, centers, solver, method="interpolation", trend=trend, alpha=alpha
    )
    again = np.array([1, 2, 2, 20, 30])
    more = y[again] + 1.0
    if centers == "all" and alpha == 0:
        more = y[again]
    weights = np.append(FRACTIONS, [0.5, 0.3, 2.0, 0.0, 1.0])
    found = clone(model).fit(
        rows(np.vstack([X, X[again]])), np.vstack([y, more]), sample_weight=weights
    )
    means, sums = weights[:60, np.newaxis] * y, FRACTIONS.copy()
    np.add.at(means, again, weights[60:, np.newaxis] * more)
    np.add.at(sums, again, weights[60:])
    means[sums > 0] /= sums[sums > 0, np.newaxis]
    expected = clone(model).fit(rows(X), means, sample_weight=sums)
    rtol = 1e-6 if solver == "iterative" else 1e-9
    assert_same_estimate(found, expected, rows(X_new), rtol)
    # The noise of a centre is that of its mean: nothing is left without alpha.
    if alpha == 0 and centers != "precomputed":
        reached = found.predict(found.centers_)
        assert_allclose(reached, means[found.center_indices_], atol=10 * rtol)


def test_contradictions_of_rows_that_are_all_interpolated_name_the_rows_given():
    X, y = np.array([[0.0], [1.0], [2.0], [1.0]]), np.array([0.0, 1.0, 2.0, 3.0])
    model = KoopmanKernelRegressor("matern32", beta=1.0)
    with pytest.raises(ValueError, match="rows 1 and 3 of X are equal"):
        model.fit(X, y, sample_weight=[0, 1, 1, 2])
    model.fit(X, y, sample_weight=[0, 1, 1, 0])
    assert_allclose(model.predict([[1.0]]), 1.0)


# --- Regression: independent computations ---------------------------------------------


@every_pair(centers=CENTERS, trend=TRENDS, alpha=[0.0, 0.1], solver=SOLVERS)
def test_least_squares_are_those_of_a_dense_solution(
    noisy, centers, trend, alpha, solver
):
    """Rows are multiplied by the roots of their weights; the weights sum up to n."""
    X, y, X_new = noisy
    if centers in ("all", "precomputed"):
        centers = "array"
    model, _ = make(
        X, centers, solver, method="least_squares", trend=trend, alpha=alpha
    )
    model.fit(X, y, sample_weight=FRACTIONS)
    Xi, root = model.centers_, np.sqrt(FRACTIONS)[:, np.newaxis]
    K, A = kernel_matrix("matern32", Xi, Xi), kernel_matrix("matern32", X, Xi)
    P = monomials(X, trend)
    solve = dense_least_squares(K, monomials(Xi, trend), root * A, root * P, alpha)
    solve = solve * root.T
    parts = kernel_matrix("matern32", X_new, Xi), monomials(X_new, trend)
    functions = np.hstack(parts)
    iterative = solver == "iterative"
    expected = functions @ solve @ y
    atol = 1e-6 if iterative else 1e-9
    assert_allclose(model.predict(X_new), expected, atol=atol)
    hat = np.hstack([A, P]) @ solve
    spare = FRACTIONS.sum() - np.trace(hat)
    noise = np.sqrt(FRACTIONS @ (y - hat @ y) ** 2 / spare)
    assert_allclose(model.noise_std_, noise, rtol=0.05 if iterative else 1e-8)


@every_pair(centers=["all", "sequential", "array"], trend=TRENDS, solver=SOLVERS)
def test_interpolants_have_alpha_over_the_weight_on_the_diagonal(
    noisy, centers, trend, solver
):
    X, y, X_new = noisy
    alpha = 0.2
    model, _ = make(
        X, centers, solver, method="interpolation", trend=trend, alpha=alpha
    )
    model.fit(X, y, sample_weight=FRACTIONS)
    rows = model.center_indices_
    Xi, P = X[rows], monomials(X[rows], trend)
    K = kernel_matrix("matern32", Xi, Xi) + np.diag(alpha / FRACTIONS[rows])
    c, b = dense_interpolant(K, P, y[rows])
    k, p = kernel_matrix("matern32", X_new, Xi), monomials(X_new, trend)
    atol = 1e-7 if solver == "iterative" else 1e-10
    assert_allclose(model.predict(X_new), k @ c + p @ b, atol=atol)
    power = squared_power(K, P, k.T, p)
    assert_allclose(model.power_function(X_new) ** 2, power, atol=atol)
    signal = np.sqrt((y[rows] * c).sum(axis=0) / (len(rows) - P.shape[1]))
    assert_allclose(model.signal_std_, signal, rtol=10 * atol)
    assert_allclose(model.noise_std_, signal * np.sqrt(alpha), rtol=10 * atol)


@pytest.mark.filterwarnings("ignore:sample_weight")
@every_pair(centers=CENTERS, method=METHODS, trend=TRENDS, times=[1e-20, 7.0, 1e20])
def test_only_the_ratio_of_weights_and_alpha_matters(
    noisy, centers, method, trend, times
):
    X, y, X_new = noisy
    model, rows = make(X, centers, method=method, trend=trend, alpha=0.1)
    expected = clone(model).fit(rows(X), y, sample_weight=FRACTIONS)
    model.set_params(alpha=0.1 * times)
    found = model.fit(rows(X), y, sample_weight=times * FRACTIONS)
    expected = expected.predict(rows(X_new))
    assert_allclose(found.predict(rows(X_new)), expected, rtol=1e-9, atol=1e-9)


@every_pair(centers=AMONG_ROWS, trend=TRENDS)
def test_without_alpha_interpolants_ignore_weights(noisy, centers, trend):
    X, y, X_new = noisy
    model, rows = make(X, centers, method="interpolation", trend=trend)
    found = clone(model).fit(rows(X), y, sample_weight=FRACTIONS)
    expected = model.fit(rows(X), y, sample_weight=WHOLE > 0)
    assert_array_equal(found.predict(rows(X_new)), expected.predict(rows(X_new)))


@every_pair(
    least=[1e-12, 1e-40, 1e-300, 5e-324],
    kernel=["matern32", "gaussian"],
    solver=["auto", "cholesky", "iterative"],
)
def test_tiny_weights_are_nearly_none(noisy, least, kernel, solver):
    """Their huge nuggets do not hide how well the others are conditioned."""
    X, y, X_new = noisy
    weights = np.where(np.arange(60) % 3 == 0, least, 1.0)
    present = weights == 1
    model = KoopmanKernelRegressor(kernel, beta=1.0, alpha=1e-2, solver=SOLVERS[solver])
    found = clone(model).fit(X, y, sample_weight=weights)
    expected = clone(model).fit(X[present], y[present])
    assert len(found.center_indices_) == 60
    predicted = expected.predict(X_new)
    atol = 1e-5 if solver == "iterative" else 1e-7
    assert_allclose(found.predict(X_new), predicted, atol=atol)


def test_weights_of_the_inverse_variance_lower_the_error():
    """Every other row is ten times as noisy."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (400, 1))
    sigma = np.where(np.arange(400) % 2, 0.05, 0.5)
    y = np.sin(4 * X[:, 0]) + sigma * rng.standard_normal(400)
    X_new = np.linspace(-1, 1, 200)[:, np.newaxis]
    truth = np.sin(4 * X_new[:, 0])
    weights = sigma**-2 / np.mean(sigma**-2)
    for options in (
        {"alpha": 0.02},
        {
            "alpha": 0.02,
            "method": "least_squares",
            "centers": SeparatedCenterSelector(0.1),
        },
    ):
        model = KoopmanKernelRegressor("matern52", beta=1.0, **options)
        errors = [
            np.sqrt(np.mean((model.fit(X, y, w).predict(X_new) - truth) ** 2))
            for w in (None, weights)
        ]
        assert errors[1] < errors[0] / 2
    # Of a row of weight one: 1 / sigma^2 is half the mean of 1 / 0.05^2 and 1 / 0.5^2.
    assert_allclose(model.noise_std_, np.mean(sigma**-2) ** -0.5, rtol=0.1)


@pytest.mark.parametrize("preconditioner", ["nystroem", "neighbors"])
def test_preconditioners_stand_weights_of_all_sizes(noisy, preconditioner):
    X, y, X_new = noisy
    weights = 10.0 ** np.random.default_rng(0).uniform(-4, 4, 60)
    solver = ConjugateGradient(
        preconditioner=preconditioner, tol=1e-10, max_iter=40, rank=40
    )
    model = KoopmanKernelRegressor("matern32", beta=1.0, alpha=0.1)
    expected = clone(model).fit(X, y, sample_weight=weights).predict(X_new)
    found = model.set_params(solver=solver).fit(X, y, sample_weight=weights)
    assert_allclose(found.predict(X_new), expected, atol=1e-6)


@pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")
@pytest.mark.parametrize("beta", [0.2, 5.0])
@pytest.mark.parametrize("trend", TRENDS)
def test_sparse_least_squares_are_weighted(beta, trend):
    """With a kernel matrix that is held as a sparse one, or multiplied anew."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (900, 2))
    y, weights = np.sin(3 * X), rng.uniform(0.1, 3, 900)
    model = KoopmanKernelRegressor(
        Wendland(beta, 2),
        centers=X[::6],
        method="least_squares",
        alpha=0.05,
        trend=trend,
    )
    expected = clone(model).fit(X, y, sample_weight=weights)
    solver = ConjugateGradient(tol=1e-10)
    found = model.set_params(solver=solver).fit(X, y, sample_weight=weights)
    X_new = rng.uniform(-0.9, 0.9, (50, 2))
    assert_allclose(found.predict(X_new), expected.predict(X_new), atol=1e-6)


def test_noise_terms_of_the_kernel_join_the_nugget(noisy):
    X, y, X_new = noisy
    model = KoopmanKernelRegressor(RBF(0.5) + WhiteKernel(0.05), beta=None, alpha=0.1)
    model.fit(X, y, sample_weight=FRACTIONS)
    Xi = X[PRESENT]
    K = RBF(0.5)(Xi) + np.diag(0.05 + 0.1 / FRACTIONS[PRESENT])
    expected = RBF(0.5)(X_new, Xi) @ np.linalg.solve(K, y[PRESENT])
    assert_allclose(model.predict(X_new), expected, atol=1e-9)


@pytest.mark.slow
def test_sums_that_workers_share_are_weighted(noisy):
    X, y, _ = noisy
    sections = KernelSections(Wendland(1.0, 2), X[:12])
    sums = []
    for n_jobs, operations in ((1, 1e9), (2, 0.0)):
        system = DirectSystem(sections, np.zeros(12), 1, "cholesky")
        upper = np.empty((12, 12), order="F")
        outputs = y.__getitem__
        sums.append(
            sum_normal_equations(
                system, upper, X, outputs, 2, n_jobs, FRACTIONS, operations
            )
        )
    a, t = system.design(X)
    for equations in sums:
        expected = (a * FRACTIONS) @ a.T
        assert_allclose(np.triu(equations.upper, 1), np.triu(expected, 1), atol=1e-9)
        assert_allclose(equations.squares, expected.diagonal(), atol=1e-9)
        assert_allclose(equations.TT, (t * FRACTIONS) @ t.T, atol=1e-9)
        assert_allclose(equations.AT, (a * FRACTIONS) @ t.T, atol=1e-9)
        assert_allclose(equations.Ay, (a * FRACTIONS) @ y, atol=1e-9)
        assert_allclose(equations.yy, FRACTIONS @ y**2)
        assert_allclose(equations.diagonal, FRACTIONS.sum())


# --- Batches --------------------------------------------------------------------------


@every_pair(
    kind=[
        ("all", "interpolation"),
        ("all", "least_squares"),
        ("sequential", "interpolation"),
        ("array", "least_squares"),
    ],
    trend=TRENDS,
    alpha=[0.0, 0.1],
    bounds=[(0, 30, 60), (0, 20, 24, 27, 50, 60)],
)
@pytest.mark.filterwarnings("ignore:.*off the manifold")
def test_batches_with_weights_are_one_fit(noisy, kind, trend, alpha, bounds):
    X, y, X_new = noisy
    weights = FRACTIONS.copy()
    weights[25:27] = [0.0, 1.5]
    # Equal rows, in one batch and across batches.
    X[[28, 51, 55]] = X[[27, 1, 2]]
    weights[[51, 55]] = [0.7, 2.0]
    if kind == ("all", "interpolation") and alpha == 0:
        y[[28, 51, 55]] = y[[27, 1, 2]]
    centers, method = kind
    model, _ = make(X, centers, method=method, trend=trend, alpha=alpha)
    if centers == "array":
        model.set_params(centers=X[PRESENT[:12]])
    expected = clone(model).fit(X, y, sample_weight=weights)
    for start, stop in pairwise(bounds):
        rows = slice(start, stop)
        model.partial_fit(X[rows], y[rows], sample_weight=weights[rows])
    if centers != "array":
        assert_array_equal(model.center_indices_, expected.center_indices_)
    noise = 1e-6 if centers == "array" or alpha == 0 else 1e-9
    assert_same_estimate(model, expected, X_new, 1e-9, noise)


def test_batches_go_on_after_a_pickle(noisy):
    """Also of one that was written before there were weights."""
    X, y, X_new = noisy
    model = KoopmanKernelRegressor(
        "matern32", beta=1.0, method="least_squares", alpha=0.0
    )
    X[50:] = X[:10]
    weights = np.append(np.ones(30), FRACTIONS[30:])
    expected = clone(model).fit(X, y, sample_weight=weights)
    model.partial_fit(X[:30], y[:30])
    for old in (False, True):
        loaded = pickle.loads(pickle.dumps(model))
        if old:
            del loaded._weight
        loaded.partial_fit(X[30:], y[30:], sample_weight=weights[30:])
        assert_same_estimate(loaded, expected, X_new, noise=1e-7)


def test_a_batch_with_bad_weights_is_not_counted(noisy):
    X, y, X_new = noisy
    model = KoopmanKernelRegressor(
        "matern32", beta=1.0, centers=X[:9], method="least_squares", alpha=0.1
    )
    model.partial_fit(X[:30], y[:30], sample_weight=WHOLE[:30])
    with pytest.raises(ValueError, match="sample_weight"):
        model.partial_fit(X[30:], y[30:], sample_weight=-WHOLE[30:])
    model.partial_fit(X[30:], y[30:], sample_weight=WHOLE[30:])
    expected = clone(model).fit(X, y, sample_weight=WHOLE)
    assert_same_estimate(model, expected, X_new, noise=1e-7)


# --- Selection of centres -------------------------------------------------------------


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_default_scales_count_weights(noisy, method):
    """The spread of the rows, and with it scale and separation, is a weighted one."""
    X, y, X_new = noisy
    X = X**3  # few are far out
    model = KoopmanKernelRegressor(
        centers=SeparatedCenterSelector(), method=method, alpha=0.1
    )
    found = clone(model).fit(X, y, sample_weight=WHOLE)
    repeated = clone(model).fit(X[REPEATED], y[REPEATED])
    assert_allclose(found.kernel_.beta, repeated.kernel_.beta, rtol=1e-14)
    alike = clone(model).fit(X, y).kernel_.beta
    assert abs(found.kernel_.beta / alike - 1) > 0.01
    assert_array_equal(found.centers_, repeated.centers_)
    assert len(found.centers_) < 45
    assert_allclose(found.predict(X_new), repeated.predict(X_new), rtol=1e-9)
    operator = KernelEDMD(centers=SeparatedCenterSelector(), method=method, alpha=0.1)
    X_next = 0.9 * X
    found = clone(operator).fit(X, y, X_next=X_next, sample_weight=WHOLE)
    repeated = clone(operator).fit(X[REPEATED], y[REPEATED], X_next=X_next[REPEATED])
    assert_allclose(found.kernel_.beta, repeated.kernel_.beta, rtol=1e-14)
    assert_array_equal(found.centers_, repeated.centers_)
    search = KoopmanKernelRegressorCV(alphas=[0.1], cv=3, method=method)
    found = clone(search).fit(X, y, sample_weight=WHOLE)
    betas = clone(search).fit(X[REPEATED], y[REPEATED]).cv_results_["param_beta"]
    assert_allclose(
        found.cv_results_["param_beta"].astype(float), betas.astype(float), rtol=1e-14
    )


class Recorder(BaseEstimator):
    """Takes every row that it sees as a centre, and weights, if it is so made."""

    def fit(self, X, y=None):
        self.cluster_centers_ = np.array(X)
        return self


class WeightedRecorder(Recorder):
    seen = []

    def fit(self, X, y=None, sample_weight=None):
        self.seen.append(sample_weight)
        return super().fit(X)


@pytest.mark.parametrize("kind", ["regressor", "operator", "search"])
def test_selectors_see_weights_if_they_take_any(noisy, kind):
    X, y, _ = noisy
    for selector in (Recorder(), WeightedRecorder()):
        options = {"centers": selector, "method": "least_squares"}
        model = {
            "regressor": KoopmanKernelRegressor(beta=1.0, alpha=0.1, **options),
            "operator": KernelEDMD(beta=1.0, alpha=0.1, **options),
            "search": KoopmanKernelRegressorCV(
                betas=[1.0], alphas=[0.1], cv=3, **options
            ),
        }[kind]
        more = {"X_next": 0.9 * X} if kind == "operator" else {}
        WeightedRecorder.seen.clear()
        clone(model).fit(X, y, **more)
        assert all(weights is None for weights in WeightedRecorder.seen)
        WeightedRecorder.seen.clear()
        fitted = model.fit(X, y, sample_weight=FRACTIONS, **more)
        assert_array_equal(fitted.centers_, X[PRESENT])
        if isinstance(selector, WeightedRecorder):
            assert_array_equal(WeightedRecorder.seen[0], FRACTIONS[PRESENT])


# --- Operators ------------------------------------------------------------------------


@pytest.fixture
def twisted():
    """States of a nonlinear map of the plane, their successors and outputs of these."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (60, 2))
    turn = np.array([[0.8, 0.5], [-0.5, 0.8]])
    X_next = (X @ turn) * (1 - 0.1 * np.square(X).sum(axis=1, keepdims=True))
    X_next += 0.01 * rng.standard_normal(X.shape)
    return X, X_next, X_next[:, 0] ** 2


def assert_same_operator(found, expected, X_new, rtol=1e-7):
    for name in ("predict", "power_function"):
        values = getattr(expected, name)(X_new)
        assert_allclose(getattr(found, name)(X_new), values, rtol=rtol, atol=rtol)
    y = expected.forecast(X_new, 3)
    assert_allclose(found.forecast(X_new, 3), y, rtol=rtol, atol=rtol)
    for name in ("signal_std_", "noise_std_"):
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=rtol)
    if expected.n_modes == 0:
        return
    # Spurious ones that nearly tie may be sorted either way, and those of a null space
    # are any functions in it.
    for values in ("eigenvalues_", "residuals_"):
        one, other = (
            np.sort_complex(getattr(model, values)[np.abs(model.eigenvalues_) > 1e-9])
            for model in (found, expected)
        )
        assert_allclose(one, other, rtol=1e-6, atol=1e-7)
    few = slice(0, 3)
    phi = [np.abs(model.eigenfunctions(X_new)[:, few]) for model in (found, expected)]
    assert_allclose(*phi, rtol=1e-4, atol=1e-5)


@every_pair(
    centers=["all", "sequential", "farthest", "array", "elsewhere", "KMeans"],
    method=METHODS,
    trend=TRENDS,
    alpha=[0.0, 0.05],
    n_modes=[None, 0, 6],
    outputs=[False, True],
)
@pytest.mark.filterwarnings("ignore:.*forecasts diverge")
def test_whole_weights_are_repeated_pairs(
    twisted, centers, method, trend, alpha, n_modes, outputs
):
    if centers not in AMONG_ROWS:
        method = "least_squares"
    X, X_next, y = twisted
    y = y if outputs else None
    model = KernelEDMD(
        "matern32",
        beta=2.0,
        centers=CENTERS[centers](X),
        method=method,
        trend=trend,
        alpha=alpha,
        n_modes=n_modes,
    )
    found = clone(model).fit(X, y, X_next=X_next, sample_weight=WHOLE)
    expected = clone(model).fit(
        X[REPEATED], None if y is None else y[REPEATED], X_next=X_next[REPEATED]
    )
    if expected.center_indices_ is not None:
        own = REPEATED[expected.center_indices_]
        assert_array_equal(found.center_indices_, own)
    assert_same_operator(found, expected, X[PRESENT[:9]] + 0.01)
    weights = FRACTIONS[PRESENT]
    here = clone(model).fit(
        X[PRESENT],
        None if y is None else y[PRESENT],
        X_next=X_next[PRESENT],
        sample_weight=weights,
    )
    found = model.fit(X, y, X_next=X_next, sample_weight=FRACTIONS)
    assert_same_operator(found, here, X[PRESENT[:9]] + 0.01, 1e-9)
    # Nor does the unit of weights matter to anything but the noise.
    scaled = clone(model).set_params(alpha=3 * alpha)
    scaled.fit(X, y, X_next=X_next, sample_weight=3 * FRACTIONS)
    assert_allclose(scaled.predict(X), found.predict(X), atol=1e-8)
    if n_modes != 0:
        values = np.sort(found.residuals_)
        assert_allclose(np.sort(scaled.residuals_), values, rtol=1e-6, atol=1e-9)


@every_pair(
    kind=product(["all", "sequential", "array"], METHODS),
    trend=TRENDS,
    alpha=[0.0, 0.05],
)
def test_random_maps_have_weighted_means(twisted, kind, trend, alpha):
    """Equal states with different successors, of weights that differ."""
    centers, method = kind
    X, X_next, y = twisted
    again = PRESENT[::2]
    X, X_next = np.vstack([X, X[again]]), np.vstack([X_next, -X_next[again]])
    y, weights = np.append(y, 1 + y[again]), np.append(WHOLE, 1 + WHOLE[again] % 3)
    model = KernelEDMD(
        "matern32",
        beta=2.0,
        centers=CENTERS[centers](X),
        method=method,
        trend=trend,
        alpha=alpha,
    )
    found = clone(model).fit(X, y, X_next=X_next, sample_weight=weights)
    rows = np.repeat(np.arange(len(X)), weights)
    expected = clone(model).fit(X[rows], y[rows], X_next=X_next[rows])
    assert_same_operator(found, expected, X[PRESENT[:9]] + 0.01, 1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_pairs_are_few_however_heavy_they_are(twisted, method):
    """Fewer than centres, so that these are left out one by one for the residuals."""
    X, X_next, _ = twisted
    few = PRESENT[:25]
    centers = X[few[:20]] if method == "interpolation" else X[few[0] : few[0] + 40]
    model = KernelEDMD("matern32", beta=2.0, centers=centers, method=method, alpha=0.05)
    rows = np.repeat(few, 3)
    expected = clone(model).fit(X[rows], X_next=X_next[rows])
    found = model.fit(X[few], X_next=X_next[few], sample_weight=np.full(25, 3))
    assert_same_operator(found, expected, X_next[few[:9]])
    uncertain = found.residuals_ / np.hypot(1, np.abs(found.eigenvalues_))
    assert uncertain.min() > 0
    lighter = clone(model).set_params(alpha=0.05 / 3).fit(X[few], X_next=X_next[few])
    if method == "interpolation":  # elsewhere, alpha is that of one row
        assert_allclose(lighter.residuals_, found.residuals_, rtol=1e-6)


def test_every_centre_of_a_trajectory_is_left_out_with_its_weight():
    """Least squares has outputs of the last state, too, which is no centre."""
    t = 0.3 * np.arange(30)
    X = np.column_stack([np.cos(t), np.sin(1.7 * t)])
    model = KernelEDMD("matern32", beta=2.0, method="least_squares", alpha=0.03)
    expected = clone(model).set_params(alpha=0.01).fit(X, X[:, 0])
    found = model.fit(X, X[:, 0], sample_weight=np.full(30, 3.0))
    assert_allclose(found.eigenvalues_, expected.eigenvalues_, atol=1e-9)
    assert_allclose(found.residuals_, expected.residuals_, rtol=1e-6)


@pytest.mark.parametrize("alpha", [0.0, 0.1])
def test_operators_are_those_of_weighted_normal_equations(twisted, alpha):
    X, X_next, _ = twisted
    model = KernelEDMD(
        "matern32", beta=2.0, centers=X[1:10], method="least_squares", alpha=alpha
    ).fit(X, X_next=X_next, sample_weight=FRACTIONS)
    K, A, B = (kernel_matrix("matern32", x, X[1:10], 2.0) for x in (X[1:10], X, X_next))
    W = np.diag(FRACTIONS)
    U = np.linalg.solve(A.T @ W @ A + alpha * K, A.T @ W @ B)
    lam = np.linalg.eigvals(U)
    assert_allclose(
        np.sort_complex(model.eigenvalues_), np.sort_complex(lam), atol=1e-7
    )
    now, then = model.eigenfunctions(X), model.eigenfunctions(X_next)
    assert_allclose(FRACTIONS @ np.abs(now) ** 2 / FRACTIONS.sum(), 1.0)
    defect = FRACTIONS @ np.abs(then - model.eigenvalues_ * now) ** 2
    assert_allclose(model.residuals_, np.sqrt(defect / FRACTIONS.sum()), rtol=1e-7)
    y = A @ np.linalg.solve(A.T @ W @ A + alpha * K, A.T @ W @ X_next)
    assert_allclose(model.predict(X), y, atol=1e-9)


def test_reduced_operators_weigh_the_rows_of_their_outputs(twisted):
    """The best expansion in mean square has its weights, too."""
    X, X_next, _ = twisted
    weights = FRACTIONS[PRESENT] ** 4
    model = KernelEDMD("matern32", beta=2.0, centers=X[PRESENT[::3]], n_modes=6)
    model.fit(X[PRESENT], X_next=X_next[PRESENT], sample_weight=weights)
    whole = clone(model).set_params(n_modes=None)
    whole.fit(X[PRESENT], X_next=X_next[PRESENT], sample_weight=weights)
    phi, y = model.eigenfunctions(X[PRESENT]), whole.predict(X[PRESENT])
    root = np.sqrt(weights)[:, np.newaxis]
    parts = np.hstack([phi.real, phi.imag])
    best = parts @ np.linalg.lstsq(root * parts, root * y, rcond=1e-12)[0]
    assert_allclose(model.predict(X[PRESENT]), best, atol=1e-8)
    other = parts @ np.linalg.lstsq(parts, y, rcond=1e-12)[0]
    assert np.abs(other - best).max() > 1e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("linked_by", ["order", "sample_index"])
@pytest.mark.parametrize("outputs", [False, True])
def test_no_link_bridges_an_absent_row(method, linked_by, outputs):
    """A row of weight zero starts no pair, and is no successor of another row."""
    t = 0.3 * np.arange(40)
    X = np.column_stack([np.cos(t), np.sin(t)])
    y = X[:, 0] ** 3 if outputs else None
    weights = np.random.default_rng(0).uniform(0.5, 2, 40)
    weights[[0, 10, 11, 25]] = 0.0
    if outputs:
        y[10] = 1e6  # whatever is there does not matter
    present = np.flatnonzero(weights)
    model = KernelEDMD("matern32", beta=2.0, method=method, alpha=1e-3)
    clock = {} if linked_by == "order" else {"sample_index": np.arange(40)}
    found = clone(model).fit(X, y, sample_weight=weights, **clock)
    expected = clone(model).fit(
        X[present],
        None if y is None else y[present],
        sample_index=present,
        sample_weight=weights[present],
    )
    assert_array_equal(found.center_indices_, present[expected.center_indices_])
    assert_array_equal(found._limit, expected._limit)
    assert not np.isin([9, 24], found.center_indices_).any() or outputs
    assert_same_operator(found, expected, X[:5] + 0.01, 1e-9)
    if not outputs:  # the motion of the circle is seen, and no jump
        values = found.eigenvalues_[np.abs(np.angle(found.eigenvalues_) - 0.3) < 0.05]
        assert len(values)
    # With successors given, a row's own weight is all that counts.
    pairs = clone(model).fit(X[:-1], X_next=X[1:], sample_weight=weights[:-1])
    assert {9, 24} <= set(pairs.center_indices_)


def test_no_pair_is_left():
    X = np.arange(5.0)[:, np.newaxis]
    with pytest.raises(ValueError, match="n_samples=5 rows, or none of pos"):
        KernelEDMD(beta=1.0).fit(X, sample_weight=[1, 0, 1, 0, 1])


def test_equal_centres_have_equal_images(twisted):
    """An array may hold a state twice; with alpha nothing needs to be dropped."""
    X, X_next, _ = twisted
    once = KernelEDMD("matern32", beta=2.0, centers=X[:8], alpha=0.1)
    twice = KernelEDMD("matern32", beta=2.0, centers=X[[*range(8), 3]], alpha=0.1)
    twice.fit(X, X_next=X_next)
    # The second copy halves the nugget of the state.
    weights = np.ones(60)
    weights[3] = 2.0
    once.fit(X, X_next=X_next, sample_weight=weights)
    assert_allclose(twice.predict(X), once.predict(X), atol=1e-9)
    assert_allclose(twice.forecast(X, 4), once.forecast(X, 4), atol=1e-9)


# --- Search ---------------------------------------------------------------------------


def held_out(X, y, folds, alphas, weights=None, **options):
    """Held-out predictions as a scorer gets them, for every alpha, and all weights."""
    seen, seen_weights = [], []

    def record(estimator, X, y, sample_weight=None):
        seen.append(estimator.predict(X))
        seen_weights.append(sample_weight)
        return 0.0

    KoopmanKernelRegressorCV(
        ["matern32"], [1.0], alphas, cv=folds, scoring=record, **options
    ).fit(X, y, sample_weight=weights)
    parts = range(0, len(seen), len(folds))
    return [np.concatenate(seen[i : i + len(folds)]) for i in parts], seen_weights


FOLDS = {
    "blocks": list(KFold(4).split(np.zeros((60, 1)))),
    "small": list(KFold(20).split(np.zeros((60, 1)))),
    "overlapping": [(np.arange(60), np.arange(60)), (np.arange(20, 60), np.arange(40))],
}


@every_pair(
    centers=["all", "array", "elsewhere"], method=METHODS, trend=TRENDS, cut=FOLDS
)
def test_weighted_folds_are_those_of_refits(noisy, centers, method, trend, cut):
    if centers not in AMONG_ROWS:
        method = "least_squares"
    X, y, _ = noisy
    X[[28, 51, 55]] = X[[27, 1, 2]]  # equal rows in one fold and in several
    folds, centers = FOLDS[cut], CENTERS[centers](X)
    options = {"centers": centers, "method": method, "trend": trend}
    alphas = [1e-3, 0.3]
    found, seen = held_out(X, y, folds, alphas, FRACTIONS, **options)
    for alpha, predictions in zip(alphas, found, strict=True):
        expected = []
        for train, test in folds:
            kept, held = (rows[FRACTIONS[rows] > 0] for rows in (train, test))
            own = dict(options)
            if centers is not None and method == "interpolation":
                is_row = (centers[:, np.newaxis] == X[kept]).all(axis=2).any(axis=1)
                own["centers"] = centers[is_row]
            model = KoopmanKernelRegressor("matern32", beta=1.0, alpha=alpha, **own)
            model.fit(X[kept], y[kept], sample_weight=FRACTIONS[kept])
            expected.append(model.predict(X[held]))
        assert_allclose(predictions, np.concatenate(expected), rtol=1e-8, atol=1e-8)
    tests = [test[FRACTIONS[test] > 0] for _, test in folds]
    for rows, weights in zip(tests * len(alphas), seen, strict=True):
        assert_array_equal(weights, FRACTIONS[rows])


@pytest.mark.parametrize("method", METHODS)
def test_whole_weights_are_repeated_rows_of_folds(noisy, method):
    X, y, X_new = noisy
    groups = np.arange(60) // 12
    model = KoopmanKernelRegressorCV(
        ["matern32", "wendland_c4"],
        [0.5, 2.0],
        [1e-2, 1.0],
        centers=SeparatedCenterSelector(0.3),
        method=method,
        cv=[(groups != g, groups == g) for g in range(5)],
    )
    found = clone(model).fit(X, y, sample_weight=WHOLE)
    own = groups[REPEATED]
    folds = [(np.flatnonzero(own != g), np.flatnonzero(own == g)) for g in range(5)]
    expected = clone(model).set_params(cv=folds).fit(X[REPEATED], y[REPEATED])
    for name, values in expected.cv_results_.items():
        if name.endswith("_score"):
            assert_allclose(found.cv_results_[name], values, rtol=1e-8, atol=1e-9)
    assert found.best_index_ == expected.best_index_
    assert_allclose(found.predict(X_new), expected.predict(X_new), atol=1e-9)
    assert_array_equal(found.center_indices_, REPEATED[expected.center_indices_])
    own = groups[PRESENT]
    folds = [(np.flatnonzero(own != g), np.flatnonzero(own == g)) for g in range(5)]
    expected = clone(model).set_params(cv=folds)
    expected.fit(X[PRESENT], y[PRESENT], sample_weight=WHOLE[PRESENT])
    scores = expected.cv_results_["mean_test_score"]
    assert_allclose(found.cv_results_["mean_test_score"], scores, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_scores_are_weighted(noisy, method):
    """By default and with metrics that take weights; others get none."""
    X, y, _ = noisy
    folds = FOLDS["blocks"]
    model = KoopmanKernelRegressorCV(
        ["matern32"], [1.0], [0.1], centers=X[PRESENT[::2]], method=method, cv=folds
    )
    [predictions], _ = held_out(
        X, y, folds, [0.1], FRACTIONS, centers=X[PRESENT[::2]], method=method
    )
    tests = [test[FRACTIONS[test] > 0] for _, test in folds]
    parts = np.split(predictions, np.cumsum([len(rows) for rows in tests])[:-1])

    def scores(scoring):
        fitted = clone(model).set_params(scoring=scoring)
        fitted.fit(X, y, sample_weight=FRACTIONS)
        return [fitted.cv_results_[f"split{i}_test_score"][0] for i in range(4)]

    def expected(metric, weighed=True):
        values = []
        for rows, own in zip(tests, parts, strict=True):
            more = {"sample_weight": FRACTIONS[rows]} if weighed else {}
            values.append(metric(y[rows], own, **more))
        return values

    def largest(y, predicted):
        return max_error(y[:, 0], predicted[:, 0])

    def plain(estimator, X, y):
        return -mean_squared_error(y, estimator.predict(X))

    assert_allclose(scores(None), expected(r2_score), rtol=1e-7)
    assert_allclose(scores("r2"), expected(r2_score), rtol=1e-7)
    errors = np.array(expected(mean_squared_error))
    assert_allclose(scores("neg_mean_squared_error"), -errors, rtol=1e-7)
    assert_allclose(
        scores(make_scorer(largest)), expected(largest, weighed=False), rtol=1e-7
    )
    errors = np.array(expected(mean_squared_error, weighed=False))
    assert_allclose(scores(plain), -errors, rtol=1e-7)


def test_leave_one_out_has_a_weighted_mean_squared_error(noisy):
    X, y, _ = noisy
    model = KoopmanKernelRegressorCV(["matern32"], [0.3, 1.0], [0.1, 1.0])
    model.fit(X, y, sample_weight=FRACTIONS)
    for params, mean, std in zip(
        model.cv_results_["params"],
        model.cv_results_["mean_test_score"],
        model.cv_results_["std_test_score"],
        strict=True,
    ):
        one = KoopmanKernelRegressor(**params)
        errors = []
        for row in PRESENT:
            others = PRESENT[row != PRESENT]
            one.fit(X[others], y[others], sample_weight=FRACTIONS[others])
            errors.append(np.mean((one.predict(X[[row]]) - y[row]) ** 2))
        weights = FRACTIONS[PRESENT]
        expected = np.average(errors, weights=weights)
        assert_allclose(-mean, expected, rtol=1e-8)
        spread = np.average((np.array(errors) - expected) ** 2, weights=weights)
        assert_allclose(std, np.sqrt(spread), rtol=1e-8)
    whole = clone(model).set_params(scoring="r2").fit(X, y, sample_weight=FRACTIONS)
    assert whole.cv_results_["mean_test_score"].max() <= 1


def test_the_winner_is_fitted_with_the_weights(noisy):
    X, y, X_new = noisy
    model = KoopmanKernelRegressorCV(["matern32"], [0.5, 1.0], [0.1, 1.0], cv=4)
    model.fit(X, y, sample_weight=FRACTIONS)
    winner = KoopmanKernelRegressor(
        "matern32", beta=model.best_beta_, alpha=model.best_alpha_
    ).fit(X, y, sample_weight=FRACTIONS)
    assert_array_equal(model.predict(X_new), winner.predict(X_new))
    assert_array_equal(model.center_indices_, PRESENT)


def test_folds_of_absent_rows_are_refused(noisy):
    X, y, _ = noisy
    weights = np.ones(60)
    weights[:15] = 0
    model = KoopmanKernelRegressorCV(["matern32"], [1.0], cv=4)
    with pytest.raises(ValueError, match=r"Fold 0 .*0 test rows.*weight 0 are absent"):
        model.fit(X, y, sample_weight=weights)


@pytest.mark.filterwarnings("ignore:sample_weight")
def test_tiny_weights_do_not_spoil_the_closed_form(noisy):
    X, y, _ = noisy
    weights = np.where(np.arange(60) % 3 == 0, 1e-30, 1.0)
    folds = FOLDS["blocks"]
    for options in ({}, {"centers": X[1::3], "method": "least_squares"}):
        [found], _ = held_out(X, y, folds, [0.1], weights, **options)
        expected = []
        for train, test in folds:
            kept = train[weights[train] == 1]
            model = KoopmanKernelRegressor("matern32", beta=1.0, alpha=0.1, **options)
            expected.append(model.fit(X[kept], y[kept]).predict(X[test]))
        assert_allclose(found, np.concatenate(expected), atol=1e-7)


# --- Routing --------------------------------------------------------------------------


def test_weights_are_routed_if_asked_for(noisy):
    X, y, X_new = noisy
    grid = {"alpha": [0.01, 1.0]}
    options = {"beta": 1.0, "centers": X[PRESENT[::2]], "method": "least_squares"}
    expected = KoopmanKernelRegressor("matern32", alpha=0.01, **options)
    expected.fit(X, y, sample_weight=FRACTIONS)
    for routing in (False, True):
        with sklearn.config_context(enable_metadata_routing=routing):
            model = KoopmanKernelRegressor("matern32", **options)
            if routing:
                model.set_fit_request(sample_weight=True)
                model.set_score_request(sample_weight=True)
            search = GridSearchCV(model, grid, cv=FOLDS["blocks"])
            with warnings.catch_warnings():
                # The newest scikit-learn does not see the weights of a default scorer.
                warnings.filterwarnings("ignore", "The scoring", UserWarning)
                search.fit(X, y, sample_weight=FRACTIONS)
        assert search.best_params_ == {"alpha": 0.01}
        assert_array_equal(search.predict(X_new), expected.predict(X_new))


def test_pipelines_pass_weights_on(noisy):
    X, y, X_new = noisy
    own = FRACTIONS + 0.1
    with sklearn.config_context(enable_metadata_routing=True):
        model = KoopmanKernelRegressorCV(["matern32"], [1.0], [0.1], cv=3)
        pipeline = Pipeline(
            [
                ("scale", StandardScaler().set_fit_request(sample_weight=False)),
                ("model", model.set_fit_request(sample_weight=True)),
            ]
        ).fit(X, y, sample_weight=own)
    scaler = StandardScaler().fit(X)
    expected = clone(model).fit(scaler.transform(X), y, sample_weight=own)
    found = pipeline.predict(X_new)
    assert_array_equal(found, expected.predict(scaler.transform(X_new)))


@pytest.mark.parametrize(
    "estimator", [KoopmanKernelRegressor(), KoopmanKernelRegressorCV(), KernelEDMD()]
)
def test_no_weights_are_asked_for_by_default(estimator):
    with sklearn.config_context(enable_metadata_routing=True):
        requests = estimator.get_metadata_routing()
        assert requests.fit.requests["sample_weight"] is None
        asked = clone(estimator).set_fit_request(sample_weight=True)
        assert asked.get_metadata_routing().fit.requests["sample_weight"] is True
        if hasattr(estimator, "partial_fit"):
            asked.set_partial_fit_request(sample_weight=True)


# --- Bad weights ----------------------------------------------------------------------

BAD = {
    "negative": (np.append(np.ones(59), -0.5), "from 0 .* from -0.5"),
    "nan": (np.append(np.ones(59), np.nan), "NaN"),
    "infinite": (np.append(np.ones(59), np.inf), "infinity"),
    "too many": (np.ones(61), r"shape \(61,\), but X has 60 rows"),
    "one a value": (np.ones((60, 2)), r"shape \(60, 2\)"),
    "a number": (2.0, r"shape \(\)"),
    "all zero": (np.zeros(60), "not only zeros"),
    "masked": (np.ma.masked_greater(np.arange(60.0), 50), "9 masked values"),
    "too large": (np.full(60, 1e308), r"to 1e\+150"),
}


@pytest.mark.parametrize("kind", ["regressor", "batches", "search", "operator"])
@pytest.mark.parametrize("bad", BAD)
def test_bad_weights_are_refused_and_leave_the_former_fit(noisy, kind, bad):
    X, y, X_new = noisy
    weights, message = BAD[bad]
    model = {
        "regressor": KoopmanKernelRegressor("matern32", beta=1.0),
        "batches": KoopmanKernelRegressor("matern32", beta=1.0),
        "search": KoopmanKernelRegressorCV(["matern32"], [1.0], cv=3),
        "operator": KernelEDMD("matern32", beta=1.0, n_modes=0),
    }[kind]
    model.fit(X, y)
    before = model.predict(X_new)
    fit = model.partial_fit if kind == "batches" else model.fit
    with pytest.raises(ValueError, match=rf"(?s)sample_weight.*{message}"):
        fit(X, y, sample_weight=weights)
    assert_array_equal(model.predict(X_new), before)


@pytest.mark.parametrize("kind", ["regressor", "batches", "operator"])
def test_weights_that_tell_no_noise_or_lose_digits_warn(noisy, kind):
    """Weights of sum one gave a standard deviation of 0 without a word."""
    X, y, _ = noisy
    centers = X[::6]
    options = {"beta": 1.0, "centers": centers, "method": "least_squares", "alpha": 0.1}
    if kind == "operator":
        model = KernelEDMD(n_modes=0, **options)
        data = {"X": X, "y": y, "X_next": 0.9 * X}
    else:
        model = KoopmanKernelRegressor(**options)
        data = {"X": X, "y": y}
    weights = np.random.default_rng(0).uniform(0.5, 2.0, 60)
    weights /= weights.mean()

    def fit(sample_weight, alpha):
        own = clone(model).set_params(alpha=alpha)
        fit = own.partial_fit if kind == "batches" else own.fit
        return fit(**data, sample_weight=sample_weight)

    expected = fit(weights, 0.1).noise_std_
    assert (expected > 0.05).all()
    with pytest.warns(UserWarning, match="sums to 1, no more than .* by their mean"):
        fit(weights / 60, 0.1 / 60)
    weights[7] = 1e12
    with pytest.warns(
        UserWarning, match=r"to 1e\+12, so that least .* loses 12 digits"
    ):
        fit(weights, 0.1)


def test_first_batch_whose_present_rows_are_equal_warns(noisy):
    X, y, _ = noisy
    rows = [0, 0, 1, 2]
    with pytest.warns(UserWarning, match="rows of the first batch are equal"):
        KoopmanKernelRegressor(alpha=0.1).partial_fit(X[rows], y[rows], [1, 1, 0, 0])


def test_metric_without_a_signature_gets_no_weights(noisy):
    X, y, _ = noisy
    scorer = make_scorer(np.dot)
    options = {"betas": [1.0], "alphas": [0.1], "cv": 3, "scoring": scorer}
    search = KoopmanKernelRegressorCV(**options)
    search.fit(X, y[:, 0], sample_weight=np.ones(60))
    assert np.isfinite(search.best_score_)


# --- Rows -----------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["C", "F"])
def test_equal_rows_are_found_in_every_layout(order):
    """Points and rows may lie in memory in other ways, and zeros have signs."""
    rng = np.random.default_rng(0)
    X = np.asarray(rng.integers(-2, 3, (5000, 3)) / 3.0, order=order)
    points = np.unique(X, axis=0)[::2].copy()
    points[points == 0] = -0.0
    y, weights = rng.standard_normal((5000, 2)), rng.uniform(0.1, 2, 5000)
    found = average_at(points, X, AveragedOutputs.of(y, weights))
    equal = (points[:, np.newaxis] == X).all(axis=2)
    sums = equal @ weights
    assert_allclose(found.counts, sums)
    assert_allclose(found.means, (equal * weights) @ y / sums[:, np.newaxis])
    assert_allclose(weights_at(points, X, weights), sums)
    assert_array_equal(weights_at(points, X, None), equal.sum(axis=1))
    assert_array_equal(weights_at(points + 9, X, weights), 0)
    assert count_distinct(X) == len(np.unique(X, axis=0))


def test_points_that_are_one_row_keep_its_outputs():
    """To the last bit, without a division by the weight; equal points share them."""
    rng = np.random.default_rng(0)
    X, y, weights = (
        rng.normal(size=(30, 2)),
        rng.normal(size=(30, 1)),
        rng.uniform(size=30),
    )
    rows = np.array([7, 3, 3, 20])
    found = average_at(X[rows], X, AveragedOutputs.of(y, weights))
    assert_array_equal(found.means, y[rows])
    assert_array_equal(found.counts, weights[rows])
