"""Cross-validation without refitting, against refits."""

import pickle
import warnings

import numpy as np
import pytest
import sklearn
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import LinAlgWarning
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.exceptions import FitFailedWarning
from sklearn.gaussian_process.kernels import (
    RBF,
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
from sklearn_koopman._linalg import _leave_out, _leave_out_least_squares
from sklearn_koopman._matrices._polynomial import DEGREES
from sklearn_koopman._regression import _candidates
from sklearn_koopman.kernels import Gaussian, MaternSobolev, as_kernel

ROUTES = ["folds", "cholesky", "eigen"]
TRENDS = [None, "constant", "linear"]


@pytest.fixture
def samples():
    """Noisy values at 90 points along three wandering trajectories."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (90, 2))
    y = np.column_stack([np.sin(X[:, 0]) + X[:, 1], np.cos(X).prod(axis=1)])
    return X, y + 0.1 * rng.standard_normal(y.shape), np.arange(90) // 30


@pytest.fixture
def repeated(samples):
    """With equal rows, two and three at a time, in the same and in other groups."""
    X, y, groups = samples
    again = np.array([0, 1, 2, 31, 31, 60, 61, 62, 63, 5])
    order = np.random.default_rng(1).permutation(100)
    X, y = np.vstack([X, X[again]]), np.vstack([y, y[again] + 0.3])
    groups = np.concatenate([groups, np.resize([0, 1, 2], 10)])
    return X[order], y[order], groups[order]


def splits(name, X, groups):
    splitter = {
        "rows": LeaveOneOut(),
        "groups": LeaveOneGroupOut(),
        "many": KFold(17),
        "shuffled": ShuffleSplit(4, test_size=0.3, random_state=0),
        "small": ShuffleSplit(3, train_size=0.4, test_size=0.2, random_state=0),
    }[name]
    return list(splitter.split(X, groups=groups if name == "groups" else None))


def refitted(X, y, folds, centers, method, options):
    """Held-out predictions by definition: the centres that are left, or all of them."""
    predictions = []
    for train, test in folds:
        own = centers
        if centers is not None and method == "interpolation":
            is_row = (centers[:, np.newaxis] == X[train]).all(axis=2).any(axis=1)
            own = centers[is_row]
        model = KoopmanKernelRegressor(centers=own, method=method, **options)
        predictions.append(model.fit(X[train], y[train]).predict(X[test]))
    return np.concatenate(predictions)


def held_out(X, y, folds, centers, method, kernel, beta, alphas, trend, **options):
    left = [_leave_out.Fold.of(train, test, len(X)) for train, test in folds]
    search = _candidates.Search.of(
        X,
        y,
        centers,
        left,
        interpolates=method == "interpolation",
        degree=DEGREES[trend],
        drop_dependent=True,
    )
    return search.predictions(
        as_kernel(kernel, beta, X.shape[1]), alphas, search.distances()
    )


@pytest.fixture
def force(monkeypatch):
    """Choose the way to the held-out values, and forbid refits on it."""

    def forced(route, refits=False):
        monkeypatch.setattr(_leave_out, "interpolation_route", lambda *args: route)
        monkeypatch.setattr(
            _leave_out_least_squares, "regression_route", lambda *args: route
        )
        if not refits:
            monkeypatch.setattr(_candidates.Search, "_refit", refuse)

    def refuse(self, kernel, kept, alpha):
        def predicted(i):
            raise AssertionError(f"fold {i} was refitted")

        return predicted

    return forced


# --- Held-out predictions are those of refits ----------------------------------------

CASES = {
    None: ("matern32", 1.0),
    "constant": ("gaussian", 0.3),
    "linear": ("wendland_c4", 2.0),
}
FOLDS = ["rows", "groups", "many", "shuffled", "small"]


@pytest.mark.parametrize("folds", FOLDS)
@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("data", ["samples", "repeated"])
@pytest.mark.parametrize("centers", ["all", "some"])
def test_interpolation(request, force, data, centers, folds, trend):
    X, y, groups = request.getfixturevalue(data)
    chosen, alphas = None, [1e-3, 0.5]
    if centers == "some":
        chosen = SeparatedCenterSelector(0.3).fit(X).cluster_centers_
    if centers == "some" or data == "samples":
        alphas.insert(0, 0.0)
    compare(
        force, X, y, splits(folds, X, groups), chosen, "interpolation", alphas, trend
    )


@pytest.mark.parametrize("folds", FOLDS)
@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("centers", ["rows", "elsewhere"])
def test_least_squares(repeated, force, centers, folds, trend):
    X, y, groups = repeated
    chosen = X[::6] if centers == "rows" else X[::6] + 0.05
    cut = splits(folds, X, groups)
    alphas = [0.0, 1e-3, 0.5]
    # A third of the rows hardly determines as many coefficients without a weight.
    refits = folds == "small"
    compare(force, X, y, cut, chosen, "least_squares", alphas, trend, refits)


def compare(force, X, y, folds, centers, method, alphas, trend, refits=False):
    kernel, beta = CASES[trend]
    options = {"kernel": kernel, "beta": beta, "trend": trend}
    expected = [
        refitted(X, y, folds, centers, method, {**options, "alpha": alpha})
        for alpha in alphas
    ]
    for route in ROUTES:
        force(route, refits)
        found = held_out(X, y, folds, centers, method, alphas=alphas, **options)
        assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


def test_a_fold_may_score_rows_that_it_learned_from(samples, force):
    X, y, _ = samples
    every = np.arange(len(X))
    cut = [(every, every), (every[20:], every[::3])]
    for method, centers in (("interpolation", None), ("least_squares", X[::5])):
        compare(force, X, y, cut, centers, method, [0.1], None, refits=True)


def test_rows_between_train_and_test_are_left_out(samples, force):
    X, y, _ = samples
    cut = list(TrajectoryKFold(5, gap=3).split(X))
    for method, centers in (("interpolation", None), ("least_squares", X[::5])):
        compare(force, X, y, cut, centers, method, [0.0, 0.1], "constant")


def test_a_noise_term_of_the_kernel_counts_at_the_centres_only(samples, force):
    X, y, _ = samples
    kernel = 2.0 * RBF(0.7) + WhiteKernel(0.05)
    for method, centers in (("interpolation", X[::2]), ("least_squares", X[::5])):
        options = {"kernel": kernel, "beta": None, "trend": "constant"}
        cut = list(KFold(9).split(X))
        expected = refitted(X, y, cut, centers, method, {**options, "alpha": 0.1})
        for route in ROUTES:
            force(route)
            [found] = held_out(X, y, cut, centers, method, alphas=[0.1], **options)
            assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("route", ROUTES)
def test_a_trend_that_a_fold_does_not_determine(force, method, route):
    """One group alone tells of the second feature: without it that is constant."""
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (40, 2))
    X[10:, 1] = 0.25
    y = X @ [[1.0], [2.0]] + 0.1 * rng.standard_normal((40, 1))
    groups = np.arange(40) // 10
    cut = splits("groups", X, groups)
    centers = None if method == "interpolation" else X[::3]
    force(route, refits=True)
    options = {"kernel": "matern32", "beta": 0.5, "trend": "linear"}
    expected = refitted(X, y, cut, centers, method, {**options, "alpha": 0.01})
    [found] = held_out(X, y, cut, centers, method, alphas=[0.01], **options)
    assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("route", ROUTES)
@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
def test_ill_conditioned_matrices_lose_no_digits_in_silence(
    samples, force, method, route
):
    """Closed forms agree with refits as far as these are determined."""
    X, y, groups = samples
    force(route, refits=True)
    y = y[:, :1] * 0 + np.sin(X.sum(axis=1, keepdims=True))
    centers = None if method == "interpolation" else X[::2]
    for folds in ("rows", "groups", "many"):
        cut = splits(folds, X, groups)
        for kernel, beta in (("wendland_c6", 20.0), ("gaussian", 1.0)):
            options = {"kernel": kernel, "beta": beta, "trend": None}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LinAlgWarning)
                expected = refitted(
                    X, y, cut, centers, method, {**options, "alpha": 1e-9}
                )
            [found] = held_out(X, y, cut, centers, method, alphas=[1e-9], **options)
            assert_allclose(found, expected, rtol=0, atol=3e-6)


def test_the_cheapest_way_follows_from_counting():
    """Few large folds are factored, many small ones share, many weights decompose."""

    def interpolation(n_folds, n_alphas, M=2400):
        none = np.empty((0, 1))
        changes = [
            _leave_out.Change(
                slice(0, 0),
                np.arange(size),
                none,
                np.full(size, np.inf),
                np.arange(0),
                np.arange(0),
            )
            for size in [M // n_folds] * n_folds
        ]
        return _leave_out.interpolation_route(M, changes, n_alphas)

    assert interpolation(4, 5) == "folds"
    assert interpolation(48, 5) == "cholesky"
    assert interpolation(2400, 1) == "cholesky"
    assert interpolation(48, 50) == "eigen"

    def least_squares(n_folds, n_alphas, M=2400, n=10_000):
        parts = np.array_split(np.arange(n), n_folds)
        folds = [_leave_out.Fold(part, part) for part in parts]
        return _leave_out_least_squares.regression_route(M, folds, n, n_alphas)

    assert least_squares(4, 5) == "folds"
    assert least_squares(48, 1) == "cholesky"
    assert least_squares(48, 5) == "eigen"


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
        expected = refitted(X, y, cut, None, "interpolation", options)
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


def test_candidates_without_an_estimate_come_last():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((60, 3))
    model = KoopmanKernelRegressorCV([ExpSineSquared(), "matern32"], None, [1e-3], cv=3)
    with pytest.warns(FitFailedWarning, match=r"1 of 2 .*ExpSineSquared") as caught:
        model.fit(X, X[:, 0])
    assert len(caught) == 1
    assert model.best_kernel_ == "matern32"
    assert_array_equal(model.cv_results_["rank_test_score"], [2, 1])
    assert np.isnan(model.cv_results_["split0_test_score"][0])
    with pytest.raises(ValueError, match="None of 1 candidates has a score"):
        KoopmanKernelRegressorCV([ExpSineSquared()], None, [1e-3], cv=3).fit(X, X[:, 0])


def test_strict_solver_lets_singular_candidates_fail():
    X = np.linspace(0, 1, 100)[:, np.newaxis]
    model = KoopmanKernelRegressorCV(
        ["gaussian", "matern12"], [1.0], solver="cholesky", cv=3
    )
    with pytest.warns(FitFailedWarning, match="gaussian"):
        model.fit(X, X[:, 0])
    assert model.best_kernel_ == "matern12"


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
        ({"kernels": "matern32"}, "kernels must be a list of values, got 'matern32'"),
        ({"kernels": Gaussian()}, "kernels must be a list"),
        ({"kernels": []}, "kernels must hold at least one value"),
        ({"kernels": ["cubic"]}, "kernel must be one of .* got 'cubic'"),
        ({"betas": 1.0}, "betas must be a list of values, got 1.0"),
        ({"betas": [0.0]}, "betas must be a finite positive number, got 0.0"),
        ({"betas": ["wide"]}, "betas must be a finite positive number, got 'wide'"),
        ({"alphas": [-1.0]}, "alphas must be a finite non-negative number, got -1.0"),
        ({"alphas": None}, "alphas must be a list"),
        ({"centers": "precomputed"}, "the folds need the states themselves"),
        ({"centers": "all"}, "centers must be None, an array or a selector, got 'all'"),
        ({"method": "regression"}, "method must be one of .* got 'regression'"),
        ({"trend": "cubic"}, "trend must be one of .* got 'cubic'"),
        ({"solver": "cg"}, "solver must be .* got 'cg'"),
        ({"scoring": "size"}, "size"),
        ({"cv": [(np.arange(60), np.arange(0))]}, "fold 0 60 training rows and 0 test"),
        ({"cv": [(np.arange(0), np.arange(9))]}, "fold 0 0 training rows and 9 test"),
        ({"cv": [([1, 1, 2], [3])]}, "repeats rows in the training part of fold 0"),
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
    with pytest.raises(ValueError, match=r"leaves no centre .* fold 0.*than 5"):
        model.fit(X, y, groups)


def test_one_row_has_no_other(samples):
    with pytest.raises(ValueError, match="n_samples = 1"):
        search().fit([[1.0, 2.0]], [1.0])


# --- scikit-learn's own checks --------------------------------------------------------


@parametrize_with_checks(
    [
        KoopmanKernelRegressorCV(),
        KoopmanKernelRegressorCV(cv=3, alphas=(0.0, 0.1), n_jobs=2),
        KoopmanKernelRegressorCV(["matern32", "wendland_c2"], trend="linear"),
        KoopmanKernelRegressorCV([1.0 * RBF() + WhiteKernel(0.1)], betas=None, cv=3),
        KoopmanKernelRegressorCV(
            centers=SeparatedCenterSelector(0.1), method="least_squares", alphas=(0.01,)
        ),
        KoopmanKernelRegressorCV(
            centers=SeparatedCenterSelector(0.1),
            method="least_squares",
            alphas=(0.01, 1.0),
            trend="linear",
            cv=3,
        ),
    ]
)
def test_scikit_learn_check(estimator, check):
    check(estimator)
