"""Cross-validation in closed form, against refits."""

import pickle
import warnings

import numpy as np
import pytest
import sklearn
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import LinAlgWarning
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.exceptions import FitFailedWarning
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    ExpSineSquared,
    Matern,
    WhiteKernel,
)
from sklearn.metrics import make_scorer, max_error, mean_absolute_error, r2_score
from sklearn.model_selection import (
    GridSearchCV,
    GroupKFold,
    KFold,
    LeaveOneGroupOut,
    LeaveOneOut,
    ShuffleSplit,
    cross_val_score,
)
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from sklearn_koopman import (
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
)
from sklearn_koopman._linalg._leave_out import (
    Fold,
    leave_out_interpolation,
    leave_out_least_squares,
)
from sklearn_koopman.kernels import Gaussian, MaternSobolev
from sklearn_koopman.solvers import ConjugateGradient

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

TRENDS = [None, "constant", "linear"]


@pytest.fixture
def samples():
    """Noisy values at 60 points of three trajectories."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 2))
    y = np.column_stack([np.sin(X[:, 0]) + X[:, 1], np.cos(X).prod(axis=1)])
    return X, y + 0.1 * rng.standard_normal(y.shape), np.arange(60) // 20


@pytest.fixture
def repeated(samples):
    """With equal rows, two and three at a time, in the same and in other groups."""
    X, y, groups = samples
    again = np.array([0, 1, 2, 21, 21, 40, 41, 42, 43, 5])
    order = np.random.default_rng(1).permutation(70)
    X, y = np.vstack([X, X[again]]), np.vstack([y, y[again] + 0.3])
    groups = np.concatenate([groups, np.resize([0, 1, 2], 10)])
    return X[order], y[order], groups[order]


def splits(name, X, groups):
    if name == "overlapping":  # tests rows that it has learned from
        every = np.arange(len(X))
        return [(every, every), (every[20:], every[::3])]
    splitter = {
        "rows": LeaveOneOut(),
        "groups": LeaveOneGroupOut(),
        "many": KFold(17),
        "two": KFold(2, shuffle=True, random_state=0),
        "shuffled": ShuffleSplit(5, test_size=0.3, random_state=0),
        "few rows": ShuffleSplit(3, train_size=0.4, test_size=0.2, random_state=0),
        "gaps": TrajectoryKFold(5, gap=3),
    }[name]
    return list(splitter.split(X, groups=groups if name == "groups" else None))


SPLITS = [
    *("rows", "groups", "many", "two", "shuffled", "few rows", "gaps", "overlapping")
]


def refitted(X, y, folds, centers=None, method="interpolation", beta=None, **options):
    """Held-out predictions by definition: the centres that are left, or all of them."""
    predictions = []
    for train, test in folds:
        own = centers
        if centers is not None and method == "interpolation":
            is_row = (centers[:, np.newaxis] == X[train]).all(axis=2).any(axis=1)
            own = centers[is_row]
        model = KoopmanKernelRegressor(beta=beta, centers=own, method=method, **options)
        predictions.append(model.fit(X[train], y[train]).predict(X[test]))
    return np.concatenate(predictions)


def held_out(X, y, folds, alphas, *, kernel, beta=None, **options):
    """Held-out predictions as a scorer gets them, for every alpha."""
    seen = []

    def record(estimator, X, y):
        seen.append(estimator.predict(X))
        return 0.0

    KoopmanKernelRegressorCV(
        [kernel], [beta], alphas, cv=folds, scoring=record, **options
    ).fit(X, y)
    return [
        np.concatenate(seen[i : i + len(folds)])
        for i in range(0, len(seen), len(folds))
    ]


def compare(X, y, folds, alphas, *, atol=1e-8, **options):
    found = held_out(X, y, folds, alphas, **options)
    expected = [refitted(X, y, folds, alpha=alpha, **options) for alpha in alphas]
    assert_allclose(found, expected, rtol=1e-8, atol=atol)


# --- Held-out predictions are those of refits ----------------------------------------

KERNELS = [
    *(("matern32", 1.0), ("gaussian", 0.3), ("wendland_c4", 2.0)),
    (2.0 * RBF(0.3) + WhiteKernel(0.05), None),  # noise counts on the diagonal only
]


@every_pair(
    data=["samples", "repeated"],
    kind=["every row", "some rows", "fitted to rows", "fitted elsewhere"],
    trend=TRENDS,
    cut=SPLITS,
    which=range(len(KERNELS)),
)
def test_predictions_are_those_of_refits(request, data, kind, trend, cut, which):
    X, y, groups = request.getfixturevalue(data)
    alphas, options = [1e-3, 0.5], {"method": "interpolation"}
    if kind == "some rows":
        options["centers"] = SeparatedCenterSelector(0.3).fit(X).cluster_centers_
    elif kind != "every row":
        centers = np.unique(X[::6], axis=0)
        options = {"method": "least_squares", "centers": centers}
        if kind == "fitted elsewhere":
            options["centers"] = centers + 0.05
    # Without a weight, equal rows have no interpolant where their outputs differ, and
    # few rows do not determine the coefficients.
    if (kind, data) != ("every row", "repeated") and cut != "few rows":
        alphas.append(0.0)
    kernel, beta = KERNELS[which]
    folds = splits(cut, X, groups)
    compare(X, y, folds, alphas, kernel=kernel, beta=beta, trend=trend, **options)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_a_trend_that_a_fold_does_not_determine(method):
    """The second feature varies in one group alone, and is constant without it."""
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (40, 2))
    X[10:, 1] = 0.25
    y = X @ [[1.0], [2.0]] + 0.1 * rng.standard_normal((40, 1))
    folds = splits("groups", X, np.arange(40) // 10)
    options = {"kernel": "matern32", "beta": 0.5, "trend": "linear", "method": method}
    if method == "least_squares":
        options["centers"] = X[::3]
    compare(X, y, folds, [0.01], **options)


def test_centres_that_do_not_determine_the_trend_are_refused():
    """They share their second feature, in which the other rows differ."""
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (40, 2))
    X[:10, 1] = 0.25
    y = X @ [1.0, 2.0] + 0.1 * rng.standard_normal(40)
    model = KoopmanKernelRegressorCV(
        alphas=[0.1], centers=X[:10], method="least_squares", trend="linear", cv=4
    )
    with pytest.raises(ValueError, match="independent centres do not determine"):
        model.fit(X, y)
    model.set_params(centers=X[::4]).fit(X, y)


@every_pair(
    centers=[None, slice(None, None, 2)], trend=[None, "constant"], cut=["two", "far"]
)
def test_directions_that_one_fold_alone_determines(centers, trend, cut):
    """Two groups of rows, out of reach of each other."""
    rng = np.random.default_rng(3)
    X = np.vstack([rng.uniform(0, 1, (30, 2)), rng.uniform(9, 10, (30, 2))])
    y = X @ [[1.0], [2.0]] + rng.standard_normal((60, 1))
    one, other = np.arange(30), np.arange(30, 60)
    folds = [(one, other), (other, one)] if cut == "far" else splits("two", X, None)
    options = {"kernel": "wendland_c2", "beta": 1.5, "trend": trend}
    if centers is not None:
        options |= {"centers": X[centers], "method": "least_squares"}
    compare(X, y, folds, [1e-6, 1e-3], **options)


def test_the_order_of_equal_rows_does_not_matter(samples):
    """Their mean output counts, and not that of the first one."""
    X, y, _ = samples
    X[1] = X[0]
    every = np.arange(60)
    folds = [(every[:40], every[40:]), (every[39::-1], every[40:])]
    options = {"kernel": "matern32", "centers": X[::2]}
    compare(X, y, folds, [0.1], **options)
    one, other = np.split(held_out(X, y, folds, [0.1], **options)[0], 2)
    assert_allclose(one, other, atol=1e-9)


@every_pair(
    method=["interpolation", "least_squares"],
    cut=["rows", "groups", "many"],
    kernel=[("wendland_c6", 20.0), ("gaussian", 1.0)],
)
def test_ill_conditioned_matrices_lose_no_digits_in_silence(
    samples, method, cut, kernel
):
    """The closed form agrees with refits as far as these are determined."""
    X, _, groups = samples
    y = np.sin(X.sum(axis=1))
    kernel, beta = kernel
    options = {"kernel": kernel, "beta": beta, "method": method}
    options["centers"] = None if method == "interpolation" else X[::2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        compare(X, y, splits(cut, X, groups), [1e-9], atol=3e-6, **options)


# --- The closed form itself ----------------------------------------------------------


def gram(X, beta=1.0):
    return Gaussian(beta)(X)


@pytest.mark.parametrize("q", [0, 1])
def test_interpolation_of_arrays(q):
    """By the bordered system of every fold, with noise, weights and other rows."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-3, 3, (40, 2))
    K, M = gram(X)[:, :30], 30
    noise, weight = np.full(M, 0.01), rng.uniform(0.5, 1, M)
    P = np.full((40, q), 1 / np.sqrt(M))
    u = rng.standard_normal((M, 2))
    cuts = [([3], [3]), ([0, 1, 29], [29, 0, 35, 7]), ([], [31, 2]), ([5, 6], [38])]
    folds = [Fold(np.array(out, dtype=int), np.array(test)) for out, test in cuts]
    folds.append(Fold(np.array([1]), np.array([1]), needs_refit=True))
    outcomes = leave_out_interpolation(K, noise, P, weight, u, folds, [0.1, 1.0])
    for alpha, predictions in zip([0.1, 1.0], outcomes, strict=True):
        assert predictions[-1] is None
        for fold, found in zip(folds[:-1], predictions, strict=False):
            stay = np.delete(np.arange(M), fold.out)
            system = np.zeros((len(stay) + q, len(stay) + q))
            system[: len(stay), : len(stay)] = K[stay][:, stay] + np.diag(
                noise[stay] + alpha / weight[stay]
            )
            system[: len(stay), len(stay) :] = P[stay]
            system[len(stay) :, : len(stay)] = P[stay].T
            solved = np.linalg.solve(system, np.vstack([u[stay], np.zeros((q, 2))]))
            rows = np.hstack([K[fold.test][:, stay], P[fold.test]])
            assert_allclose(found, rows @ solved, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("size", [1, 3, 15, 25])
@pytest.mark.parametrize("q", [0, 1])
def test_least_squares_of_arrays(q, size):
    """By the normal equations of every fold; small and large ones go other ways."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 2))
    K, M, alpha = gram(X)[:, :12], 12, 0.1
    y = rng.standard_normal((60, 2))
    P = np.full((60, q), 1 / np.sqrt(M))
    parts = [np.sort(part) for part in rng.permutation(60)[: 2 * size].reshape(2, size)]
    # The second also leaves out a row that is in neither part.
    folds = [Fold(parts[0], parts[0][::-1]), Fold(parts[1], parts[1][1:] - 0)]
    folds = [fold for fold in folds if len(fold.test)]
    rows = np.arange(60)
    [predictions] = leave_out_least_squares(
        K, np.zeros(M), P, rows, y, folds, [alpha], is_verified=False
    )
    for fold, found in zip(folds, predictions, strict=True):
        stay = np.delete(rows, fold.out)
        A = np.hstack([K, P])
        penalty = np.zeros((M + q, M + q))
        penalty[:M, :M] = alpha * K[:M]
        # The coefficients of the sections are orthogonal to the polynomials.
        basis = np.linalg.svd(
            np.append(P[:M, 0] if q else np.zeros(M), np.zeros(q))[None]
        )
        basis = basis.Vh[q:].T
        normal = basis.T @ (A[stay].T @ A[stay] + penalty) @ basis
        c = basis @ np.linalg.solve(normal, basis.T @ (A[stay].T @ y[stay]))
        assert_allclose(found, A[fold.test] @ c, rtol=1e-8, atol=1e-8)


def test_folds_that_rounding_would_spoil_are_given_back():
    """Nearly equal centres in one fold, and a function that one fold alone sees."""
    X = np.vstack([np.linspace(0, 1, 10), np.zeros(10)]).T
    X[1] = X[0] + 1e-7
    u = np.ones((10, 1))
    near, other = (
        Fold(np.arange(2), np.arange(2)),
        Fold(np.arange(5, 8), np.arange(5, 8)),
    )
    K = gram(X, 0.1)
    none = np.empty((10, 0))
    [found] = leave_out_interpolation(
        K, np.zeros(10), none, np.ones(10), u, [near, other], [1e-13]
    )
    assert found[0] is None
    assert found[1] is not None

    X = np.vstack([X[2:], [[50.0, 0.0]]])
    rows = np.arange(9)
    K, none = gram(X, 0.1)[:, [0, 4, 8]], np.empty((9, 0))
    K = K[[0, 4, 8, 1, 2, 3, 5, 6, 7]]
    folds = [Fold(np.array([2]), np.array([2])), Fold(np.array([7]), np.array([7]))]
    [found] = leave_out_least_squares(
        K, np.zeros(3), none, rows, np.ones((9, 1)), folds, [0.0], is_verified=False
    )
    assert found[0] is None
    assert found[1] is not None


@pytest.mark.parametrize("scale", [1.0, 1e-30])
def test_a_row_that_alone_determines_a_polynomial(scale):
    """What is left of its 1 x 1 system is rounding."""
    rng = np.random.default_rng(0)
    K = scale * gram(rng.uniform(-2, 2, (20, 2)))
    P, _ = np.linalg.qr(np.column_stack([np.ones(20), np.arange(20) == 3]))
    folds = [Fold(np.array([i]), np.array([i])) for i in (3, 4)]
    u, noise = rng.standard_normal((20, 1)), np.full(20, 0.1 * scale)
    [found] = leave_out_interpolation(K, noise, P, np.ones(20), u, folds, [0.0])
    assert found[0] is None
    assert found[1] is not None


def test_predictions_at_centres_do_not_depend_on_other_test_rows():
    """They come from the small system, also where the coefficients are huge."""
    X = np.linspace(0, 1, 30)[:, np.newaxis]
    K, u = gram(X, 0.2)[:, ::2], np.sin(5 * X[::2])
    K = np.vstack([K[::2], K[1::2]])
    folds = [Fold(np.arange(3), np.arange(n)) for n in (3, 20)]
    none = np.empty((30, 0))
    [found] = leave_out_interpolation(
        K, np.zeros(15), none, np.ones(15), u, folds, [1e-12]
    )
    assert_array_equal(found[1][:3], found[0])


def test_interpolants_that_miss_their_values_are_refused():
    """The matrix is not singular, but the coefficients are too large for doubles."""
    X = np.linspace(0, 1, 40)[:, np.newaxis]
    u = np.random.default_rng(0).standard_normal((40, 1))
    folds, none = [Fold(np.arange(2), np.arange(2))], np.empty((40, 0))
    [error] = leave_out_interpolation(
        gram(X), np.zeros(40), none, np.ones(40), u, folds, [1e-13]
    )
    assert isinstance(error, np.linalg.LinAlgError)
    assert "misses its values" in str(error)


def test_singular_matrices_are_refused():
    X = np.zeros((3, 1))
    folds = [Fold(np.arange(1), np.arange(1))]
    none, u = np.empty((3, 0)), np.ones((3, 1))
    [error, found] = leave_out_interpolation(
        gram(X), np.zeros(3), none, np.ones(3), u, folds, [0.0, 0.1]
    )
    assert isinstance(error, np.linalg.LinAlgError)
    assert_allclose(found[0], 2 / 2.1)
    X = np.array([[0.0], [1e-6], [1.0]])
    arguments = gram(X), np.zeros(3), none, np.arange(3), u, folds, [0.1]
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        leave_out_least_squares(*arguments, is_verified=False)
    [found] = leave_out_least_squares(*arguments, is_verified=True)
    assert np.isfinite(found[0]).all()


class Counted(RBF):
    """Counts its evaluations."""

    calls = 0

    def __call__(self, X, Y=None, eval_gradient=False):
        type(self).calls += 1
        return super().__call__(X, Y, eval_gradient)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("scale", [0.7, 20.0])
def test_one_matrix_serves_all_folds(samples, method, scale):
    """Also where dependent centres are left out."""
    X, y, _ = samples
    counts = []
    for cv in (None, KFold(3, shuffle=True, random_state=0)):
        model = KoopmanKernelRegressorCV(
            [Counted(scale)], None, [1e-6, 0.1], centers=X[::2], method=method, cv=cv
        )
        Counted.calls = 0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            model.fit(X, y)
        counts.append(Counted.calls)
    assert counts[0] == counts[1]


# --- The search ----------------------------------------------------------------------

GRID = {
    "kernel": ["matern12", "matern52", MaternSobolev(1.0, 1.5)],
    "beta": [0.3, 3.0, None],
    "alpha": [1e-3, 0.1],
}


def search(**options):
    grid = {name + "s": values for name, values in GRID.items()}
    return KoopmanKernelRegressorCV(**{**grid, **options})


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("n_jobs", [None, 2])
def test_scores_and_winner_are_those_of_a_grid_search(samples, trend, method, n_jobs):
    X, y, groups = samples
    centers = None if method == "interpolation" else X[::5]
    ours = search(
        centers=centers, method=method, trend=trend, cv=GroupKFold(3), n_jobs=n_jobs
    ).fit(X, y, groups)
    theirs = GridSearchCV(
        KoopmanKernelRegressor(centers=centers, method=method, trend=trend),
        GRID,
        cv=GroupKFold(3),
    ).fit(X, y, groups=groups)
    assert ours.cv_results_["params"] == theirs.cv_results_["params"]
    for name, values in ours.cv_results_.items():
        if name.endswith("test_score"):
            assert_allclose(values, theirs.cv_results_[name], rtol=1e-8, atol=1e-10)
        elif name != "params":
            assert list(values) == list(theirs.cv_results_[name])
            assert values.dtype == theirs.cv_results_[name].dtype
    assert ours.best_index_ == theirs.best_index_
    assert ours.best_kernel_ == theirs.best_params_["kernel"]
    assert ours.best_beta_ == theirs.best_params_["beta"]
    assert ours.best_alpha_ == theirs.best_params_["alpha"]
    assert_allclose(ours.best_score_, theirs.best_score_, rtol=1e-8)
    best = theirs.best_estimator_
    assert_allclose(ours.predict(X + 0.1), best.predict(X + 0.1))
    for found, expected in zip(
        ours.predict(X, return_std=True), best.predict(X, return_std=True), strict=True
    ):
        assert_allclose(found, expected)
    assert_allclose(ours.power_function(X + 0.1), best.power_function(X + 0.1))
    assert ours.score(X, y) == best.score(X, y)
    for name in ("dual_coef_", "centers_", "signal_std_", "noise_std_", "rcond_"):
        assert_allclose(getattr(ours, name), getattr(best, name))
    assert hasattr(ours, "trend_coef_") == (trend is not None)
    if method == "interpolation":
        bound = best.error_bound(X[:5] + 0.01, 2.0)
        assert_allclose(ours.error_bound(X[:5] + 0.01, 2.0), bound)


@pytest.mark.parametrize(
    "scoring",
    ["neg_mean_absolute_error", make_scorer(max_error, greater_is_better=False), "r2"],
)
def test_scorers_see_the_held_out_predictions(samples, scoring):
    X, y, _ = samples
    y = y[:, 0]
    ours = search(cv=4, scoring=scoring).fit(X, y)
    theirs = GridSearchCV(KoopmanKernelRegressor(), GRID, cv=4, scoring=scoring).fit(
        X, y
    )
    for name in ("mean_test_score", "split3_test_score", "std_test_score"):
        assert_allclose(ours.cv_results_[name], theirs.cv_results_[name], rtol=1e-8)


def test_leave_one_out_scores_all_rows_together(samples):
    X, y, _ = samples
    ours = search().fit(X, y)
    scored = search(scoring="r2").fit(X, y)
    absolute = search(scoring=make_scorer(mean_absolute_error)).fit(X, y)
    cut = splits("rows", X, None)
    for i in (0, 4, 9):
        options = ours.cv_results_["params"][i]
        expected = refitted(X, y, cut, **options)
        squared = np.square(expected - y)
        assert_allclose(ours.cv_results_["mean_test_score"][i], -squared.mean())
        assert_allclose(
            ours.cv_results_["std_test_score"][i], squared.mean(axis=1).std()
        )
        assert_allclose(scored.cv_results_["mean_test_score"][i], r2_score(y, expected))
        assert_allclose(
            absolute.cv_results_["mean_test_score"][i], np.abs(expected - y).mean()
        )
    assert not any(name.startswith("split") for name in ours.cv_results_)


def test_results_make_a_frame(samples):
    pandas = pytest.importorskip("pandas")
    X, y, _ = samples
    frame = pandas.DataFrame(search(cv=3).fit(X, y).cv_results_)
    assert len(frame) == 18
    best = frame.sort_values("rank_test_score").iloc[0]
    assert best.mean_test_score == frame.mean_test_score.max()


def test_names_of_features_are_kept(samples):
    pandas = pytest.importorskip("pandas")
    X, y, _ = samples
    frame = pandas.DataFrame(X, columns=["angle", "speed"])
    model = search(cv=3).fit(frame, y)
    assert_array_equal(model.feature_names_in_, ["angle", "speed"])
    assert_array_equal(model.predict(frame), search(cv=3).fit(X, y).predict(X))
    with pytest.warns(UserWarning, match="valid feature names"):
        model.predict(X)
    assert not hasattr(model.fit(X, y), "feature_names_in_")


def test_a_second_fit_leaves_nothing_of_the_first(samples):
    X, y, _ = samples
    model = search(cv=3, trend="linear").fit(X, y)
    assert model.trend_coef_.shape == (3, 2)
    assert 0 < model.rcond_ == model.best_estimator_.rcond_
    model.set_params(trend=None).fit(X, y)
    assert not hasattr(model, "trend_coef_")
    assert model.dual_coef_ is model.best_estimator_.dual_coef_


@pytest.mark.parametrize("shape", [(-1,), (-1, 1)])
def test_shape_of_the_outputs_is_kept(samples, shape):
    X, y, _ = samples
    y = y[:, 0].reshape(shape)
    model = search(cv=3).fit(X, y)
    assert model.predict(X).shape == y.shape
    assert model.dual_coef_.shape == y.shape


def test_the_centres_are_chosen_once(samples):
    """Random ones too: the winner has those that it was chosen with."""
    X, y, groups = samples
    kmeans = KMeans(12, n_init=1, init="random")
    model = search(centers=kmeans, method="least_squares", cv=GroupKFold(3))
    model.fit(X, y, groups)
    refits = GridSearchCV(
        KoopmanKernelRegressor(centers=model.centers_, method="least_squares"),
        GRID,
        cv=GroupKFold(3),
    ).fit(X, y, groups=groups)
    assert_allclose(
        model.cv_results_["mean_test_score"],
        refits.cv_results_["mean_test_score"],
        rtol=1e-8,
    )
    assert model.center_indices_ is None
    assert not hasattr(kmeans, "cluster_centers_")


def test_foreign_kernels_keep_their_scale(samples):
    X, y, _ = samples
    kernels = [Matern(0.5, nu=1.5), 1.0 * RBF(0.7) + WhiteKernel(0.1), DotProduct()]
    for betas in (None, [None]):
        model = KoopmanKernelRegressorCV(kernels, betas, [0.1], cv=3).fit(X, y)
        assert model.best_beta_ is None
        assert model.best_kernel_ in kernels
    with pytest.raises(ValueError, match=r"beta=1\.0 scales the kernels of"):
        KoopmanKernelRegressorCV(kernels, [1.0]).fit(X, y)


def test_pipeline_clone_and_search_within_search(samples):
    X, y, groups = samples
    pipeline = make_pipeline(StandardScaler(), clone(search(cv=GroupKFold(3))))
    pipeline.fit(X, y, koopmankernelregressorcv__groups=groups)
    direct = search(cv=GroupKFold(3)).fit(StandardScaler().fit_transform(X), y, groups)
    assert_allclose(
        pipeline.predict(X), direct.predict(StandardScaler().fit_transform(X))
    )
    scores = cross_val_score(search(), X, y, cv=3)
    assert (scores > 0.5).all()


@pytest.mark.parametrize("routing", [False, True])
def test_groups_are_routed(samples, routing):
    X, y, groups = samples
    with sklearn.config_context(enable_metadata_routing=routing):
        direct = search(cv=LeaveOneGroupOut()).fit(X, y, groups=groups)
        pipeline = make_pipeline(StandardScaler(), search(cv=TrajectoryKFold(3)))
        if routing:
            pipeline.fit(X, y, groups=groups)
            scores = cross_val_score(
                search(cv=GroupKFold(2)),
                X,
                y,
                cv=GroupKFold(3),
                params={"groups": groups},
            )
            assert np.isfinite(scores).all()
        else:
            pipeline.fit(X, y, koopmankernelregressorcv__groups=groups)
    assert "split2_test_score" in direct.cv_results_
    inner = pipeline[-1]
    expected = search(cv=GroupKFold(3)).fit(pipeline[0].transform(X), y, groups)
    assert_allclose(inner.best_score_, expected.best_score_, rtol=1e-8)


def test_pickle_is_small_and_predicts_the_same(samples):
    rng = np.random.default_rng(0)
    X, y = rng.uniform(size=(800, 2)), rng.standard_normal(800)
    model = search(centers=SeparatedCenterSelector(0.01)).fit(X, y)
    dump = pickle.dumps(model)
    assert len(dump) < 0.05 * 8 * 800**2
    assert_array_equal(pickle.loads(dump).predict(X), model.predict(X))


def test_no_unit_of_the_states_overflows(samples):
    X, y, _ = samples
    plain = search(kernels=["matern32"], betas=[0.3, 3.0], cv=3).fit(X, y)
    for unit in (1e-140, 1e140):
        scaled = search(kernels=["matern32"], betas=[0.3 * unit, 3.0 * unit], cv=3).fit(
            X * unit, y
        )
        assert_allclose(scaled.best_score_, plain.best_score_, rtol=1e-8)


# --- What goes wrong ------------------------------------------------------------------


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_dependent_centres_are_left_out_of_all_folds(method):
    rng = np.random.default_rng(0)
    X = np.sort(rng.uniform(0, 1, (150, 1)), axis=0)
    y = np.sin(5 * X[:, 0])
    cv = KFold(5, shuffle=True, random_state=0)
    model = KoopmanKernelRegressorCV(
        ["gaussian"], [0.5], centers=X[::2], method=method, cv=cv
    )
    with pytest.warns(LinAlgWarning, match="centres that depend") as caught:
        model.fit(X, y)
    assert len(caught) == 1
    kept = model.centers_
    assert len(kept) < 75
    assert model.best_score_ > 1 - 1e-6


def test_a_fold_without_the_independent_centres_has_others():
    """A constant kernel needs one centre, and any will do."""
    X = np.linspace(0, 1, 12)[:, np.newaxis]
    options = {"kernel": ConstantKernel(), "centers": X[::2]}
    folds = list(KFold(3).split(X))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        compare(X, np.ones(12), folds, [0.0], **options)


def test_candidates_without_an_estimate_come_last():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((60, 3))
    model = KoopmanKernelRegressorCV(
        [ExpSineSquared(), "matern32"], [None], [1e-3], cv=3
    )
    with pytest.warns(FitFailedWarning, match=r"1 of 2 .*ExpSineSquared") as caught:
        model.fit(X, X[:, 0])
    assert len(caught) == 1
    assert model.best_kernel_ == "matern32"
    assert_array_equal(model.cv_results_["rank_test_score"], [2, 1])
    assert np.isnan(model.cv_results_["split0_test_score"][0])
    with pytest.raises(ValueError, match="None of 1 candidates has a score"):
        KoopmanKernelRegressorCV([ExpSineSquared()], None, [1e-3], cv=3).fit(X, X[:, 0])


@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_predictions_that_overflow_have_no_score():
    X = np.append(np.linspace(-1, 1, 30), 1e308)[:, np.newaxis]
    y = 1e6 * np.append(X[:30, 0], 0.0)
    with pytest.warns(FitFailedWarning, match="not finite"):
        model = KoopmanKernelRegressorCV(
            [DotProduct(), RBF()], None, [1.0], centers=X[:30], cv=3
        ).fit(X, y)
    assert np.isnan(model.cv_results_["mean_test_score"][0])
    assert np.isfinite(model.cv_results_["mean_test_score"][1])


def test_strict_solver_lets_singular_candidates_fail():
    X = np.linspace(0, 1, 100)[:, np.newaxis]
    model = KoopmanKernelRegressorCV(
        ["gaussian", "matern12"], [1.0], solver="cholesky", cv=3
    )
    with pytest.warns(FitFailedWarning, match="gaussian"):
        model.fit(X, X[:, 0])
    assert model.best_kernel_ == "matern12"


def test_equal_rows_with_equal_outputs_need_none():
    X = np.repeat(np.linspace(0, 1, 10), 2)[:, np.newaxis]
    compare(X, np.sin(X[:, 0]), splits("two", X, None), [0.0, 0.1], kernel="matern32")


def test_equal_rows_with_different_outputs_need_a_weight():
    X = np.repeat(np.linspace(0, 1, 10), 2)[:, np.newaxis]
    y = np.arange(20.0)
    with pytest.warns(FitFailedWarning, match="rows 0 and 1 of X are equal"):
        model = KoopmanKernelRegressorCV(alphas=[0.0, 0.1]).fit(X, y)
    assert model.best_alpha_ == 0.1
    with pytest.raises(ValueError, match="rows 0 and 1 of X are equal"):
        KoopmanKernelRegressorCV().fit(X, y)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernels": "matern32"}, "kernels must be a non-empty list, got 'mat"),
        ({"kernels": Gaussian()}, "kernels must be a non-empty list"),
        ({"kernels": []}, "kernels must be a non-empty list"),
        ({"kernels": ["cubic"]}, "kernel must be one of .* got 'cubic'"),
        ({"betas": 1.0}, "betas must be a non-empty list, got 1.0"),
        ({"betas": [0.0]}, "beta must be a finite positive number, got 0.0"),
        ({"betas": ["wide"]}, "beta must be .* .scale. or None, got .wide"),
        ({"alphas": [-1.0]}, "alphas must be a finite non-negative number, got -1.0"),
        ({"alphas": None}, "alphas must be a non-empty list"),
        ({"centers": "precomputed"}, "the folds need the states themselves"),
        ({"centers": "all"}, "centers must be None, an array or a selector, got 'all'"),
        ({"method": "regression"}, "method must be one of .* got 'regression'"),
        ({"trend": "cubic"}, "trend must be one of .* got 'cubic'"),
        ({"solver": "cg"}, "solver must be .* got 'cg'"),
        ({"solver": ConjugateGradient()}, "solver must be .* got ConjugateGradient"),
        ({"scoring": "size"}, "size"),
        (
            {"cv": [(np.arange(60), np.arange(0))]},
            "has 0 test rows and 60 training rows",
        ),
        ({"cv": [(np.arange(0), np.arange(9))]}, "has 9 test rows and 0 training rows"),
        ({"cv": [([1, 1, 2], [3])]}, "3 training rows, of which 2 are distinct"),
        ({"cv": []}, "gives no folds"),
        ({"centers": [[0.0, 0.0]], "cv": 2}, "no rows of X"),
    ],
)
def test_bad_input_is_refused(samples, options, message):
    X, y, _ = samples
    model = search(**options)
    with pytest.raises(ValueError, match=message):
        model.fit(X, y)
    assert not [name for name in vars(model) if name.endswith("_")]


def test_a_fold_without_centres_is_refused(samples):
    X, y, groups = samples
    model = search(centers=X[:5], cv=LeaveOneGroupOut())
    with pytest.raises(
        ValueError, match=r"cv=Leave.* holds out all centres in fold 0.*than 5"
    ):
        model.fit(X, y, groups)


def test_one_row_has_no_other(samples):
    with pytest.raises(ValueError, match="n_samples=1"):
        search().fit([[1.0, 2.0]], [1.0])


# --- scikit-learn's own checks --------------------------------------------------------


@parametrize_with_checks(
    [
        KoopmanKernelRegressorCV(["matern32", "wendland_c2"], trend="linear"),
        KoopmanKernelRegressorCV(
            centers=SeparatedCenterSelector(0.1),
            method="least_squares",
            alphas=(0.01, 1.0),
            trend="constant",
            cv=3,
            n_jobs=2,
        ),
    ]
)
def test_scikit_learn_check(estimator, check):
    check(estimator)
