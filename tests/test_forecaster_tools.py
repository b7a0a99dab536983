"""The forecaster in scikit-learn's tools, by hand, and with bad input."""

import pickle
import pickletools

import joblib
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.experimental import enable_halving_search_cv  # noqa: F401
from sklearn.linear_model import LinearRegression, MultiTaskLassoCV, Ridge, RidgeCV
from sklearn.metrics import r2_score
from sklearn.model_selection import (
    GridSearchCV,
    GroupKFold,
    HalvingGridSearchCV,
    KFold,
    LeaveOneGroupOut,
    cross_val_score,
    cross_validate,
)
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.utils import estimator_checks

from sklearn_koopman import (
    Analogs,
    KernelEDMD,
    KoopmanForecaster,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
    join_recordings,
    make_horizon_scorer,
    trajectory_pairs,
)
from sklearn_koopman.scoring import RecordingErrorScorer

LENGTHS = (90, 70, 110, 80, 95, 100)
GROUPS = [0, 0, 1, 1, 2, 2]
HORIZONS = (6, 2)
DELAYS = (0, 2, 3)


def make_recordings(lengths=LENGTHS, seed=0):
    """Draw three columns that nearly repeat each other, of another phase each time."""
    rng = np.random.default_rng(seed)
    recordings = []
    for length in lengths:
        phase = 0.35 * np.arange(length) + rng.uniform(0, 6)
        columns = [np.sin(phase), np.cos(2 * phase), np.sin(3 * phase + 1)]
        noise = 0.1 * rng.normal(size=(length, 3))
        recordings.append(np.column_stack(columns) + noise)
    return recordings


def make_forecaster(**parameters):
    """Return a forecaster that takes a hundredth of a second to fit."""
    return KoopmanForecaster(
        **{
            "estimator": Ridge(),
            "targets": [0, 2],
            "horizons": HORIZONS,
            "delays": DELAYS,
            "baseline": None,
            **parameters,
        }
    )


def repeat_last(recording, horizons):
    """Forecast that the targets remain as they are."""
    now = np.asarray(recording)[:, np.newaxis, [0, 2]]
    return np.repeat(now, len(horizons), axis=1)


BASELINES = {
    "none": None,
    "last": "last",
    "linear": "linear",
    "analogs": Analogs(window=5, exclusion=6),
    "custom": repeat_last,
    "auto": "auto",
}
every_baseline = pytest.mark.parametrize("baseline", BASELINES.values(), ids=BASELINES)


@pytest.fixture(scope="module")
def recordings():
    return make_recordings()


@pytest.fixture(scope="module")
def fitted(recordings):
    """Return forecasters by the name of their baseline."""
    return {
        name: make_forecaster(baseline=baseline).fit(recordings[1:])
        for name, baseline in BASELINES.items()
    }


# --- by hand ------------------------------------------------------------------------


def embed(recording):
    """Return the rows with a past, from max(DELAYS) on."""
    first = max(DELAYS)
    n = len(recording)
    return np.hstack([recording[first - age : n - age] for age in DELAYS])


def tabulate(recordings):
    """Return states, outputs at all horizons, and the recording of each row."""
    lag, first = max(HORIZONS), max(DELAYS)
    pairs = trajectory_pairs(recordings, lag=lag, delays=DELAYS)
    truth = [
        np.stack([x[first + h :][: len(x) - first - lag, [0, 2]] for h in HORIZONS], 1)
        for x in recordings
    ]
    return pairs.X, np.concatenate(truth), pairs.groups


def baseline_by_hand(name, states):
    """Return a baseline of embedded rows; columns 0 to 2 are now, 3 to 5 earlier."""
    now, before = states[:, [0, 2]], states[:, [3, 5]]
    ahead = np.array(HORIZONS)[:, np.newaxis]
    if name == "none":
        return np.zeros((len(states), len(HORIZONS), 2))
    step = (now - before)[:, np.newaxis] if name == "linear" else 0.0
    return now[:, np.newaxis] + ahead * step


def test_direct_forecasts_are_those_of_pairs_for_each_horizon(recordings, fitted):
    states, truth, _ = tabulate(recordings[1:])
    for column in range(len(HORIZONS)):
        ridge = Ridge().fit(states, truth[:, column])
        for x, forecasts in zip(
            recordings, fitted["none"].predict(recordings), strict=True
        ):
            assert forecasts.shape == (len(x), 2, 2)
            assert np.isnan(forecasts[: max(DELAYS)]).all()
            assert_allclose(
                forecasts[max(DELAYS) :, column],
                ridge.predict(embed(x)),
                rtol=1e-9,
                atol=1e-11,
            )


@pytest.mark.parametrize("name", ["last", "linear"])
def test_corrections_and_their_weights_by_hand(name):
    """Of motion that follows no rule, so that what was learned is half believed."""
    delays = (0, 1, 3)  # the step before is that of row k - 1
    rng = np.random.default_rng(0)
    recordings = [rng.normal(size=(n, 3)).cumsum(axis=0) for n in LENGTHS]
    forecaster = make_forecaster(baseline=name, delays=delays).fit(recordings)
    lag, first = max(HORIZONS), 3
    pairs = trajectory_pairs(recordings, lag=lag, delays=delays)
    truth = np.concatenate(
        [
            np.stack([x[first + h :][: len(x) - first - lag, [0, 2]] for h in HORIZONS])
            for x in recordings
        ],
        axis=1,
    ).transpose(1, 0, 2)
    said = baseline_by_hand(name, pairs.X)
    wanted = (truth - said).reshape(len(said), -1)
    scale = np.sqrt((wanted**2).mean(axis=0))
    assert_allclose(forecaster.correction_scales_[name].ravel(), scale)
    left_out = np.empty_like(wanted)
    folds = TrajectoryKFold(5).split(pairs.X, groups=pairs.groups)
    for train, test in folds:
        ridge = Ridge().fit(pairs.X[train], wanted[train] / scale)
        left_out[test] = scale * ridge.predict(pairs.X[test])
    unit = np.vstack(recordings)[:, [0, 2]].std(axis=0)
    offered, wanted = (each.reshape(-1, 2, 2) / unit for each in (left_out, wanted))
    weights = (offered * wanted).sum(axis=(0, 2)) / (offered**2).sum(axis=(0, 2))
    weights = np.clip(weights, 0, 1)
    assert ((weights > 0.05) & (weights < 0.95)).any()
    assert_allclose(forecaster.horizon_weights_, weights, rtol=1e-9)
    errors = (weights[:, np.newaxis] * offered - wanted) * unit
    scale_of_errors = np.sqrt((errors**2).mean(axis=0))
    assert_allclose(forecaster.error_scale_, scale_of_errors, rtol=1e-9)
    # The forecasts of a new recording.
    new = make_recordings([40], seed=9)[0]
    ridge = Ridge().fit(pairs.X, (truth - said).reshape(len(said), -1) / scale)
    state = np.hstack([new[first - age : 40 - age] for age in delays])
    correction = (ridge.predict(state) * scale).reshape(-1, 2, 2)
    expected = baseline_by_hand(name, state) + weights[:, np.newaxis] * correction
    assert_allclose(
        forecaster.predict([new])[0][first:], expected, rtol=1e-9, atol=1e-11
    )
    assert_array_equal(
        forecaster.predict_baseline([new])[0][first:], baseline_by_hand(name, state)
    )


def test_baseline_of_a_user(recordings, fitted):
    own, last = fitted["custom"], fitted["last"]
    assert_array_equal(own.horizon_weights_, last.horizon_weights_)
    for name in ("predict", "predict_baseline"):
        for a, b in zip(
            *(getattr(f, name)(recordings) for f in (own, last)), strict=True
        ):
            assert_array_equal(a, b)
    assert own.baselines_.tolist() == ["custom"] * 2


@pytest.mark.parametrize("in_pipeline", [False, True])
def test_operator_by_hand(recordings, in_pipeline):
    """Its step is the greatest common divisor of the horizons."""
    step, lag, first = 2, max(HORIZONS), max(DELAYS)
    operator = KernelEDMD(trend="linear", n_modes=0, alpha=1.0, method="least_squares")
    estimator = make_pipeline(StandardScaler(), operator) if in_pipeline else operator
    forecaster = make_forecaster(estimator=estimator, baseline="auto").fit(recordings)
    assert forecaster.baselines_.tolist() == ["direct"] * 2
    outputs = [x[:, [0, 2]] for x in recordings]
    pairs = trajectory_pairs(recordings, outputs, lag=step, delays=DELAYS)
    # Rows that have outputs at all horizons.
    rows = pairs.frame < np.array(LENGTHS)[pairs.groups] - lag
    states = pairs.X
    scaler = StandardScaler().fit(states[rows]) if in_pipeline else None
    if in_pipeline:
        states = scaler.transform(states)
    operator.fit(states[rows], pairs.y[rows], sample_index=pairs.sample_index[rows])
    for x, forecasts in zip(recordings, forecaster.predict(recordings), strict=True):
        state = scaler.transform(embed(x)) if in_pipeline else embed(x)
        steps = operator.forecast(state, lag // step)
        expected = steps[:, [h // step - 1 for h in HORIZONS]]
        assert_allclose(forecasts[first:], expected, rtol=1e-6, atol=1e-8)


def test_outputs_that_are_no_columns(recordings):
    """One output of one axis; the states are all three columns."""
    y = [x[:, 0] - x[:, 2] for x in recordings]
    forecaster = make_forecaster(targets=None, baseline="auto").fit(recordings, y)
    assert (forecaster.n_outputs_, forecaster.baselines_.tolist()) == (
        1,
        ["direct"] * 2,
    )
    states, truth, _ = tabulate(recordings)
    ridge = Ridge().fit(states, truth[:, :, 0] - truth[:, :, 1])
    for x, forecasts in zip(recordings, forecaster.predict(recordings), strict=True):
        assert_allclose(
            forecasts[max(DELAYS) :, :, 0],
            ridge.predict(embed(x)),
            rtol=1e-9,
            atol=1e-11,
        )
    with_axis = make_forecaster(targets=None).fit(
        recordings, [values[:, np.newaxis] for values in y]
    )
    series = make_forecaster(targets=None).fit(recordings, list(map(pd.Series, y)))
    expected = forecaster.forecast(recordings)
    for other in (with_axis, series):
        assert_array_equal(other.forecast(recordings), expected)
    errors = forecaster.errors(recordings, y)
    forecasts = forecaster.predict(recordings)
    assert_array_equal(errors[0][:-6, 0, 0], forecasts[0][:-6, 0, 0] - y[0][6:])
    assert np.isnan(errors[0][-6:, 0]).all()


@pytest.mark.parametrize("name", BASELINES)
def test_score_and_errors_by_hand(name, recordings, fitted):
    weights = [1.0, 2.0, 0.0, 0.5, 1.0, 3.0]
    forecasts = fitted[name].predict(recordings)
    scores = []
    for column, horizon in enumerate(HORIZONS):
        for output, target in enumerate([0, 2]):
            truth, predicted, of_rows = [], [], []
            for x, each, weight in zip(recordings, forecasts, weights, strict=True):
                rows = slice(max(DELAYS), len(x) - horizon)
                truth.append(x[max(DELAYS) + horizon :, target])
                predicted.append(each[rows, column, output])
                of_rows.append(np.full(len(truth[-1]), weight))
            pair = np.concatenate(truth), np.concatenate(predicted)
            scores.append(r2_score(*pair, sample_weight=np.concatenate(of_rows)))
    score = fitted[name].score(recordings, sample_weight=weights)
    assert score == pytest.approx(np.mean(scores), rel=1e-9)


# --- what rows depend on ------------------------------------------------------------


@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize("row", [10, 60, 88])
def test_no_row_looks_ahead(name, row, recordings, fitted):
    """What baselines say is the same bit by bit, corrections are up to rounding.

    The last bits of a product of matrices depend on the number of rows.
    """
    now = recordings[0]
    other = now.copy()
    other[row + 1 :] = 5 * np.random.default_rng(1).normal(size=now[row + 1 :].shape)
    gap = now.copy()
    gap[row + 1 :] = np.nan
    said = fitted[name].predict_baseline([now])[0][: row + 1]
    forecasts = fitted[name].predict([now])[0][: row + 1]
    for changed in (other, gap, now[: row + 1]):
        assert_array_equal(fitted[name].predict_baseline([changed])[0][: row + 1], said)
        assert_allclose(
            fitted[name].predict([changed])[0][: row + 1],
            forecasts,
            rtol=1e-9,
            atol=1e-11,
        )
    assert_allclose(
        fitted[name].forecast([now[: row + 1]])[0],
        forecasts[row],
        rtol=1e-9,
        atol=1e-11,
    )


def test_no_analog_is_nearer_than_its_horizon(recordings):
    """A period is 18 rows: what follows the last analog by 40 is not known yet."""
    forecaster = make_forecaster(baseline=Analogs(window=5), horizons=[2, 40])
    forecaster.fit(recordings[1:])
    now = recordings[0]
    other = now.copy()
    other[61:] += np.random.default_rng(1).normal(size=other[61:].shape)
    a, b = forecaster.predict_baseline([now, other])
    assert_array_equal(a[:61], b[:61])
    assert np.isfinite(a[60]).all()
    assert_allclose(*(f[:61] for f in forecaster.predict([now, other])), rtol=1e-9)


@pytest.mark.parametrize("name", BASELINES)
def test_no_forecast_crosses_a_gap(name, recordings, fitted):
    """Those around it are those of the pieces, joined for analogs of both."""
    now = recordings[0]
    missing = slice(40, 45)
    holed = now.copy()
    holed[missing, 1] = np.nan
    whole = pd.DataFrame(now, columns=list("abc"))
    forms = {
        "NaN": holed,
        "masked": np.ma.masked_invalid(holed),
        "hole": whole.drop(index=range(40, 45)),
    }
    joined = join_recordings([now[:40], now[45:]])
    expected = fitted[name].predict([joined])[0]
    expected = np.delete(expected, 40, axis=0)
    assert np.isnan(expected[[0, 1, 2, 40, 41, 42]]).all()
    assert np.isfinite(expected[[3, 39, 43, 84]]).all()
    errors = np.delete(fitted[name].errors([joined])[0], 40, axis=0)
    for form, recording in forms.items():
        forecasts, own_errors = (
            getattr(fitted[name], method)([recording])[0]
            for method in ("predict", "errors")
        )
        if form != "hole":
            assert np.isnan(forecasts[missing]).all()
            forecasts = np.delete(forecasts, missing, axis=0)
            own_errors = np.delete(own_errors, missing, axis=0)
        assert_allclose(forecasts, expected, rtol=1e-9, atol=1e-11)
        assert_allclose(own_errors, errors, rtol=1e-9, atol=1e-11)
    assert np.isnan(errors[34:40, 0]).all()
    assert np.isfinite(errors[33, 0]).all()
    if name not in ("analogs", "auto"):
        pieces = fitted[name].predict([now[:40], now[45:]])
        assert_allclose(np.concatenate(pieces), expected, rtol=1e-9, atol=1e-11)


def test_gaps_in_training_are_those_of_pieces(recordings):
    holed = [x.copy() for x in recordings]
    pieces = []
    for x in holed:
        x[30] = np.nan
        pieces += [x[:30], x[31:]]
    a = make_forecaster(targets=[0, 2]).fit(holed)
    b = make_forecaster(targets=[0, 2]).fit(pieces)
    for one, other in zip(a.predict(recordings), b.predict(recordings), strict=True):
        assert_allclose(one, other, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("form", [np.float32, np.int64, "frames", "tuple", "objects"])
def test_forms_of_recordings(form, recordings):
    X = [np.rint(64 * x) for x in recordings]
    given = X
    if form == "frames":
        given = [pd.DataFrame(x, columns=list("abc")) for x in X]
    elif form == "tuple":
        given = tuple(X)
    elif form == "objects":
        given = np.empty(len(X), dtype=object)
        given[:] = X
    else:
        given = [x.astype(form) for x in X]
    a, b = (make_forecaster(baseline="auto").fit(each) for each in (X, given))
    assert_array_equal(a.forecast(X), b.forecast(given))
    assert a.score(X) == b.score(given)


def test_equal_lengths_one_feature_one_output():
    X = [x[:60, :1] for x in make_recordings()]
    forecaster = make_forecaster(targets=None, horizons=[4], baseline="auto").fit(X)
    assert [f.shape for f in forecaster.predict(X)] == [(60, 1, 1)] * 6
    assert forecaster.score(X) > 0.5


def test_names_of_columns(recordings):
    frames = [pd.DataFrame(x, columns=list("abc")) for x in recordings]
    by_name = make_forecaster(targets=["a", "c"]).fit(frames)
    by_number = make_forecaster(targets=[0, 2]).fit(recordings)
    assert by_name.feature_names_in_.tolist() == list("abc")
    assert not hasattr(by_number, "feature_names_in_")
    expected = by_number.forecast(recordings)
    # Arrays have no names that could be wrong.
    for forecaster in (by_name, by_number):
        for X in (frames, recordings):
            assert_array_equal(forecaster.forecast(X), expected)
    message = r"columns \['c', 'a', 'b'\], those of fit had \['a', 'b', 'c'\]; pass"
    other = [x[list("cab")] for x in frames]
    for method in ("predict", "forecast", "score", "errors", "predict_baseline"):
        with pytest.raises(ValueError, match=message):
            getattr(by_name, method)(other)
    with pytest.raises(ValueError, match=r"\['x0', 'x1'\], those of fit had"):
        by_name.predict([x[:, :2] for x in recordings])
    # Labels that only count columns are no names.
    counted = make_forecaster(targets=[0, 2]).fit([pd.DataFrame(x) for x in recordings])
    assert_array_equal(counted.forecast(frames), expected)
    nested = pd.MultiIndex.from_product([["m"], list("abc")])
    X = [pd.DataFrame(x, columns=nested) for x in recordings]
    assert_array_equal(
        make_forecaster(targets=["m_a", "m_c"]).fit(X).forecast(X), expected
    )


# --- scikit-learn's tools -----------------------------------------------------------


def test_default_score_with_lists_alone(recordings):
    """With y=None, in each of its forms, and with outputs."""
    scores = cross_val_score(make_forecaster(), recordings, cv=KFold(3))
    expected = [
        make_forecaster()
        .fit([recordings[i] for i in train])
        .score([recordings[i] for i in test])
        for train, test in KFold(3).split(recordings)
    ]
    assert_array_equal(scores, expected)
    outputs = [x[:, [0, 2]] for x in recordings]
    scores = cross_val_score(
        make_forecaster(targets=None), recordings, outputs, cv=KFold(3)
    )
    assert_allclose(scores, expected, rtol=1e-9)


@pytest.mark.parametrize("cv", [GroupKFold(3), LeaveOneGroupOut()])
def test_search(cv, recordings):
    grids = [
        {"delays": [(0,), (0, 2, 4)], "embedding": ["copies", "differences"]},
        {"baseline": [None, "last", "auto"], "estimator__alpha": [0.1, 10.0]},
        {"baseline": [Analogs()], "baseline__window": [4, 8]},
    ]
    search = GridSearchCV(
        make_forecaster(),
        grids,
        scoring=make_horizon_scorer(4),
        cv=cv,
        error_score="raise",
    ).fit(recordings, groups=GROUPS)
    assert len(search.cv_results_["params"]) == 12
    assert np.unique(search.cv_results_["mean_test_score"]).size > 8
    best = search.best_estimator_
    assert best.forecast(recordings).shape == (6, 2, 2)
    # The one with a single copy knows least.
    assert search.cv_results_["rank_test_score"][0] >= 10
    scorer = make_horizon_scorer(4)
    for place in (1, 5, 11):
        parameters = search.cv_results_["params"][place]
        expected = []
        for train, test in cv.split(recordings, groups=GROUPS):
            model = make_forecaster().set_params(**parameters)
            model.fit([recordings[i] for i in train])
            expected.append(scorer(model, [recordings[i] for i in test]))
        assert search.cv_results_["mean_test_score"][place] == pytest.approx(
            np.mean(expected), rel=1e-12
        )


def test_halving_search(recordings):
    search = HalvingGridSearchCV(
        make_forecaster(),
        {"delays": [(0,), (0, 2), (0, 2, 4), (0, 4)]},
        scoring=make_horizon_scorer(4),
        cv=KFold(2),
        min_resources=4,
        factor=2,
        random_state=0,
        error_score="raise",
    ).fit([*recordings, *make_recordings(seed=7)])
    assert search.n_resources_ == [4, 8]
    assert search.best_params_["delays"] != (0,)


def test_several_scorers(recordings):
    outputs = [x[:, 1] for x in recordings]
    scoring = {
        "all": make_horizon_scorer(3),
        "near": make_horizon_scorer(3, horizon=2),
        "far": make_horizon_scorer(3, horizon=6),
    }
    scores = cross_validate(
        make_forecaster(targets=None),
        recordings,
        outputs,
        groups=GROUPS,
        cv=GroupKFold(3),
        scoring=scoring,
        error_score="raise",
    )
    near, far = scores["test_near"], scores["test_far"]
    assert (far != near).all()
    assert_allclose(scores["test_all"], -np.sqrt((near**2 + far**2) / 2))


def test_weights_reach_the_scorer_by_routing(recordings):
    weights = np.array([1.0, 0.0, 2.0, 0.0, 3.0, 0.0])
    with config_context(enable_metadata_routing=True):
        search = GridSearchCV(
            make_forecaster(),
            {"delays": [(0, 2)]},
            scoring=make_horizon_scorer(2),
            cv=GroupKFold(3),
            error_score="raise",
        ).fit(recordings, groups=GROUPS, sample_weight=weights)
    expected = []
    for train, test in GroupKFold(3).split(recordings, groups=GROUPS):
        model = make_forecaster(delays=(0, 2)).fit([recordings[i] for i in train])
        heavy = [recordings[i] for i in test if weights[i]]
        expected.append(make_horizon_scorer(2)(model, heavy))
    assert_allclose(search.cv_results_["mean_test_score"], np.mean(expected))


@pytest.mark.slow
def test_several_jobs(recordings):
    one, two = (
        make_forecaster(baseline="auto", n_jobs=n).fit(recordings) for n in (None, 2)
    )
    assert_array_equal(one.baselines_, two.baselines_)
    assert_allclose(one.horizon_weights_, two.horizon_weights_, rtol=1e-9)
    assert_allclose(one.forecast(recordings), two.forecast(recordings), rtol=1e-9)


@pytest.mark.slow
def test_search_with_several_jobs(recordings):
    search = GridSearchCV(
        make_forecaster(),
        {"baseline": [None, "last", Analogs(window=4)]},
        scoring=make_horizon_scorer(3),
        cv=GroupKFold(3),
        error_score="raise",
    )
    one, two = (
        clone(search).set_params(n_jobs=n).fit(recordings, groups=GROUPS)
        for n in (1, 2)
    )
    assert_allclose(*(s.cv_results_["mean_test_score"] for s in (one, two)), rtol=1e-9)


@pytest.mark.parametrize(
    "estimator",
    [
        RidgeCV(),
        MultiTaskLassoCV(cv=3, alphas=[0.1, 0.2], max_iter=100_000),
        GridSearchCV(Ridge(), {"alpha": [0.1, 1.0]}),
        GridSearchCV(Ridge(), {"alpha": [0.1, 1.0]}, cv=GroupKFold(2)),
        make_pipeline(
            StandardScaler(), GridSearchCV(Ridge(), {"alpha": [1.0]}, cv=GroupKFold(2))
        ),
        KoopmanKernelRegressorCV(
            betas=[1.0],
            alphas=[0.1],
            centers=SeparatedCenterSelector(0.5),
            cv=GroupKFold(2),
        ),
    ],
    ids=lambda estimator: type(estimator).__name__,
)
@pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")
def test_estimators_that_choose(estimator, recordings):
    forecaster = make_forecaster(estimator=estimator).fit(recordings)
    assert forecaster.score(recordings) > 0.7


@pytest.mark.parametrize(
    "check",
    [
        "check_estimator_cloneable",
        "check_estimator_repr",
        "check_estimator_tags_renamed",
        "check_estimators_unfitted",
        "check_fit1d",
        "check_get_params_invariance",
        "check_mixin_order",
        "check_no_attributes_set_in_init",
        "check_parameters_default_constructible",
        "check_set_params",
        "check_valid_tag_types",
    ],
)
@pytest.mark.parametrize(
    "estimator",
    [KoopmanForecaster(), make_forecaster(baseline=Analogs(window=4))],
    ids=["default", "nested"],
)
def test_scikit_learn_check(check, estimator):
    """Those that give no data, or data that are refused."""
    if check == "check_parameters_default_constructible":
        estimator = KoopmanForecaster()
    getattr(estimator_checks, check)("KoopmanForecaster", estimator)


@pytest.mark.parametrize(
    "check",
    [
        "check_estimator_cloneable",
        "check_estimator_repr",
        "check_get_params_invariance",
        "check_no_attributes_set_in_init",
        "check_parameters_default_constructible",
        "check_set_params",
    ],
)
def test_scikit_learn_check_of_analogs(check):
    getattr(estimator_checks, check)("Analogs", Analogs())


@every_baseline
def test_fit_changes_neither_parameters_nor_data(baseline, recordings):
    """As check_dict_unchanged, check_estimators_overwrite_params, check_fit_idempotent
    and check_dont_overwrite_attributes do for rows."""
    forecaster = make_forecaster(baseline=baseline)
    parameters = pickle.dumps(forecaster.get_params())
    X = [x.copy() for x in recordings]
    for x in X:
        x.setflags(write=False)
    assert forecaster.fit(X) is forecaster
    assert pickle.dumps(forecaster.get_params()) == parameters
    state = joblib.hash(vars(forecaster))
    first = forecaster.forecast(X)
    for method in ("predict", "predict_baseline", "errors", "score"):
        getattr(forecaster, method)(X)
    assert joblib.hash(vars(forecaster)) == state
    assert {
        name
        for name in vars(forecaster)
        if not name.endswith("_") and name not in forecaster.get_params(deep=False)
    } == set()
    assert_array_equal(forecaster.fit(X).forecast(X), first)
    assert_array_equal(clone(forecaster).fit(X).forecast(X), first)


def test_a_fit_that_fails_leaves_all_as_it_was(recordings):
    forecaster = make_forecaster(baseline="auto").fit(recordings)
    forecaster.conformalize(make_recordings(seed=2))
    state = joblib.hash(vars(forecaster))
    with pytest.raises(ValueError, match="no row of"):
        forecaster.fit([recordings[0], recordings[1][:5]])
    assert joblib.hash(vars(forecaster)) == state


def test_html(recordings):
    forecaster = make_forecaster(baseline=Analogs(window=4))
    for each in (forecaster, clone(forecaster).fit(recordings)):
        page = each._repr_html_()
        assert "KoopmanForecaster" in page
        assert "Ridge" in page
        assert "window=4" in page


def calibrate(kind, recordings):
    """Return a forecaster as it is after one of the ways to fit it."""
    baseline = {"plain": "auto", "operator": None}.get(kind, Analogs(window=4))
    forecaster = make_forecaster(baseline=baseline)
    if kind == "operator":
        forecaster.set_params(estimator=KernelEDMD(n_modes=0, alpha=1.0))
    if kind in ("plus", "pooled"):
        return forecaster.fit_conformalize(recordings, method=kind)
    forecaster.fit(recordings)
    if kind == "calibrated":
        forecaster.conformalize(make_recordings(seed=4))
    return forecaster


def evaluate(forecaster, X):
    """Return all that a forecaster says."""
    with_band = hasattr(forecaster, "calibration_")
    bands = forecaster.forecast_interval(X, coverage=0.8) if with_band else ()
    return [forecaster.forecast(X), *bands]


KINDS = ("plain", "operator", "calibrated", "plus", "pooled")


@pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_storage(kind, recordings, tmp_path):
    forecaster = calibrate(kind, recordings)
    assert hasattr(forecaster, "calibration_") == (kind not in ("plain", "operator"))
    assert hasattr(forecaster, "fold_estimators_") == (kind == "plus")
    expected = evaluate(forecaster, recordings)
    joblib.dump(forecaster, tmp_path / "model.joblib")
    copies = [
        pickle.loads(pickle.dumps(forecaster)),
        joblib.load(tmp_path / "model.joblib"),
    ]
    names = {
        argument.replace(" ", ".")
        for operation, argument, _ in pickletools.genops(pickle.dumps(forecaster, 2))
        if operation.name == "GLOBAL"
    }
    own = [name for name in names if name.startswith("sklearn_koopman.")]
    assert "sklearn_koopman.forecaster.KoopmanForecaster" in own
    assert not [name for name in own if "._" in name]
    skops = pytest.importorskip("skops.io", reason="stores without pickles")
    data = skops.dumps(forecaster)
    untrusted = skops.get_untrusted_types(data=data)
    assert {name for name in untrusted if "._" in name} <= {
        "sklearn.utils._bunch.Bunch"
    }
    public = ("sklearn_koopman.", "sklearn.")
    assert all(name.startswith(public) for name in untrusted)
    copies.append(skops.loads(data, trusted=untrusted))
    for copy in copies:
        for values, wanted in zip(evaluate(copy, recordings), expected, strict=True):
            assert_allclose(values, wanted, rtol=1e-9, atol=1e-11)


# --- the scorer ---------------------------------------------------------------------


@pytest.mark.parametrize("start", [3, 20])
@pytest.mark.parametrize("horizon", [None, 2, 6])
@pytest.mark.parametrize("name", ["none", "analogs"])
def test_score_of_horizons_by_hand(name, horizon, start, recordings, fitted):
    """Analogs are scored with what stands in for them."""
    forecasts = fitted[name].predict(recordings)
    squares = []
    for column, h in enumerate(HORIZONS):
        if horizon in (None, h):
            errors = [
                f[start : len(x) - h, column] - x[start + h :, [0, 2]]
                for f, x in zip(forecasts, recordings, strict=True)
            ]
            squares.append((np.concatenate(errors) ** 2).mean())
    score = make_horizon_scorer(start, horizon=horizon)(fitted[name], recordings)
    assert score == pytest.approx(-np.sqrt(np.mean(squares)), rel=1e-12)


def test_weights_of_recordings(recordings, fitted):
    model, scorer = fitted["none"], make_horizon_scorer(5, horizon=2)
    n_rows = np.array(LENGTHS) - 5 - 2
    squares = np.array([scorer(model, [x]) ** 2 for x in recordings])
    weights = np.array([1.0, 2.0, 0.0, 0.5, 1.0, 3.0])
    expected = -np.sqrt(np.average(squares, weights=weights * n_rows))
    score = scorer(model, recordings, sample_weight=weights)
    assert score == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ValueError, match="sample_weight has shape"):
        scorer(model, recordings, sample_weight=[1.0])


def test_rows_that_a_candidate_leaves_out_are_not_passed_over(recordings, fitted):
    """Also behind a gap; the number that the message names is enough."""
    model = fitted["none"]
    with pytest.raises(
        ValueError,
        match=r"start=1 scores rows of X\[0\] that have no forecast, the first is row "
        "1; set start to 3",
    ):
        make_horizon_scorer(1)(model, recordings)
    holed = recordings[0].copy()
    holed[40] = np.nan
    with pytest.raises(ValueError, match=r"first is row 2; set start to 3"):
        make_horizon_scorer(2)(model, [holed])
    pieces = [holed[:40], holed[41:]]
    for name in ("none", "linear"):
        for start in (3, 10):
            scorer = make_horizon_scorer(start)
            assert scorer(fitted[name], [holed]) == pytest.approx(
                scorer(fitted[name], pieces), rel=1e-9
            )

    def silent(recording, horizons):
        said = repeat_last(recording, horizons)
        said[17] = np.nan
        return said

    model = make_forecaster(baseline=silent).fit(recordings)
    with pytest.raises(ValueError, match=r"the first is row 17; set start to 18"):
        make_horizon_scorer(3)(model, recordings)
    make_horizon_scorer(18)(model, recordings)


def test_candidates_are_scored_on_the_same_rows(recordings):
    """A candidate that needs more past than start gets no score, and a warning."""
    search = GridSearchCV(
        make_forecaster(),
        {"delays": [(0,), (0, 8)]},
        scoring=make_horizon_scorer(4),
        cv=KFold(2),
    )
    with (
        pytest.warns(UserWarning, match="set start to 8"),
        pytest.warns(UserWarning, match="non-finite"),
    ):
        search.fit(recordings)
    scores = search.cv_results_["mean_test_score"]
    assert np.isfinite(scores).tolist() == [True, False]
    assert search.best_params_ == {"delays": (0,)}
    search.set_params(scoring=make_horizon_scorer(8)).fit(recordings)
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()


def test_missing_outputs_are_not_scored(recordings):
    y = [x[:, :2].copy() for x in recordings]
    model = make_forecaster(targets=None, horizons=[2]).fit(recordings, y)
    y[0][30:40, 0] = np.nan
    y[1] = np.ma.masked_greater(y[1], 0.9)
    errors = model.errors(recordings, y)
    assert np.isnan(errors[0][28:38, 0, 0]).all()
    assert np.isfinite(errors[0][28:38, 0, 1]).all()
    squares = np.concatenate([each[5:, 0] for each in errors]) ** 2
    expected = -np.sqrt(np.nanmean(squares, axis=0).mean())
    score = make_horizon_scorer(5)(model, recordings, y)
    assert score == pytest.approx(expected, rel=1e-12)


def test_scorer_takes_pipelines_and_searches(recordings, fitted):
    halves = FunctionTransformer(lambda X: [x / 2 for x in X])
    pipeline = make_pipeline(halves, make_forecaster()).fit(recordings)
    scorer = make_horizon_scorer(5)
    bare = pipeline[-1]
    small = [x / 2 for x in recordings]
    assert scorer(pipeline, recordings) == scorer(bare, small)
    search = GridSearchCV(make_forecaster(), {"delays": [(0, 2)]}, cv=KFold(2))
    search.fit(recordings)
    assert scorer(search, recordings) == scorer(search.best_estimator_, recordings)


def test_scorer_can_be_pickled_compared_and_read():
    scorer = make_horizon_scorer(5, horizon=2)
    assert repr(scorer) == "RecordingErrorScorer(start=5, horizon=2)"
    assert eval(repr(scorer), {"RecordingErrorScorer": RecordingErrorScorer}) == scorer
    assert pickle.loads(pickle.dumps(scorer)) == scorer
    assert clone(scorer, safe=False) == scorer
    assert make_horizon_scorer(5) != make_horizon_scorer(6)


def test_bad_scorers(recordings, fitted):
    for start in (-1, 1.5, None, True):
        with pytest.raises(ValueError, match="start must be an integer of at least 0"):
            make_horizon_scorer(start)
    for horizon in (0, 2.0, "2"):
        with pytest.raises(ValueError, match="horizon must be an integer of at least"):
            make_horizon_scorer(0, horizon=horizon)
    model = fitted["none"]
    with pytest.raises(ValueError, match=r"horizon=3 is none of .*, \[6, 2\]; name"):
        make_horizon_scorer(0, horizon=3)(model, recordings)
    with pytest.raises(ValueError, match=r"from start=64 on has .* came 6 rows later"):
        make_horizon_scorer(64)(model, [recordings[1]])
    make_horizon_scorer(64, horizon=2)(model, [recordings[1]])
    with pytest.raises(TypeError, match="LinearRegression has no method errors"):
        make_horizon_scorer(0)(LinearRegression(), recordings)
    with pytest.raises(NotFittedError):
        make_horizon_scorer(0)(make_forecaster(), recordings)
    with pytest.raises(ValueError, match="fit was not given y"):
        make_horizon_scorer(5)(model, recordings, recordings)


# --- joined recordings --------------------------------------------------------------


def test_joined_recordings(recordings):
    a, b, c = recordings[:3]
    joined = join_recordings([a, b, c])
    gap = np.full((1, 3), np.nan)
    assert_array_equal(joined, np.vstack([a, gap, b, gap, c]))
    assert_array_equal(join_recordings([a]), a)
    masked = np.ma.masked_greater(a, 0.5)
    assert_array_equal(
        join_recordings((masked, b)), np.vstack([masked.filled(np.nan), gap, b])
    )
    whole = np.rint(a).astype(int), b.astype(np.float32)
    assert join_recordings(whole).dtype == np.float64


def test_joined_frames(recordings):
    a, b = (pd.DataFrame(x, columns=list("abc")) for x in recordings[:2])
    a.index = a.index / 100  # seconds
    joined = join_recordings([a, b])
    assert joined.columns.tolist() == list("abc")
    assert joined.index.equals(pd.RangeIndex(len(a) + len(b) + 1))
    assert_array_equal(joined.to_numpy(), join_recordings(recordings[:2]))
    mixed = join_recordings([recordings[0], b])
    pd.testing.assert_frame_equal(mixed, joined)
    pd.testing.assert_frame_equal(join_recordings(b), b)
    # A hole in an index is a gap in the result, too.
    holed = join_recordings([a.drop(index=a.index[10:20]), b])
    assert_array_equal(holed, join_recordings([a[:10], a[20:], b]))
    assert join_recordings([a.where(a < 0.5), b]).isna().sum().sum() > 3


def test_earlier_trials_serve_a_new_one(recordings, fitted):
    """Its first rows have analogs in them, and later ones know of both."""
    earlier, now = recordings[1], recordings[0]
    alone = fitted["analogs"].predict_baseline([now])[0]
    joined = fitted["analogs"].predict_baseline([join_recordings([earlier, now])])[0]
    rows = slice(4, 10)
    assert np.isnan(alone[rows]).all()
    assert np.isfinite(joined[-len(now) :][rows]).all()
    truth = np.stack([now[4 + h : 10 + h, [0, 2]] for h in HORIZONS], axis=1)
    error = joined[-len(now) :][rows] - truth
    assert np.sqrt((error**2).mean()) < 0.35 * np.std(now)


BAD_TO_JOIN = {
    "dict": ({"a": np.ones((3, 1))}, r"pass list\(data.values\(\)\)"),
    "none": ([], "non-empty list"),
    "columns": ([np.ones((3, 1)), np.ones((3, 2))], r"recordings\[1\] has shape"),
    "one axis": ([np.ones(3), np.ones(4)], r"recordings\[0\] has shape \(3,\)"),
    "three axes": (np.ones((2, 3, 4)), r"recordings has shape \(2, 3, 4\)"),
    "infinity": ([np.ones((3, 1)), np.full((3, 1), np.inf)], r"recordings\[1\]: .*inf"),
    "names": (
        [
            np.ones((3, 2)),
            pd.DataFrame(np.ones((3, 2)), columns=list("ab")),
            pd.DataFrame(np.ones((3, 2)), columns=list("ba")),
        ],
        r"recordings\[2\] has the columns \['b', 'a'\], but recordings\[1\]",
    ),
    "rates": (
        [pd.DataFrame(np.ones((5, 1)), index=np.arange(5.0) / r) for r in (10, 20)],
        "unequal rates, from 10 to 20 Hz.* interpolate them to one rate",
    ),
}


@pytest.mark.parametrize(("data", "message"), BAD_TO_JOIN.values(), ids=BAD_TO_JOIN)
def test_bad_recordings_to_join(data, message):
    with pytest.raises(ValueError, match=message):
        join_recordings(data)


# --- bad input ----------------------------------------------------------------------

X = make_recordings()
FRAMES = [pd.DataFrame(x, columns=list("abc")) for x in X]
BAD_RECORDINGS = {
    "dict": ({"a": X[0]}, r"X is a dict; pass list\(X.values\(\)\)"),
    "two axes": (X[0], r"ndarray of shape \(90, 3\); pass \[X\] for one recording"),
    "frame": (FRAMES[0], r"DataFrame of shape \(90, 3\); pass \[X\]"),
    "three axes": (np.ones((2, 50, 3)), r"shape \(2, 50, 3\); pass list\(X\) if"),
    "lists": ([x.tolist() for x in X], r"X\[0\] is a list; .* numpy.asarray of it"),
    "rows": ([[1.0, 2.0], [3.0, 4.0]], r"X\[0\] is a list"),
    "empty": ([], "non-empty list of recordings"),
    "nothing": (None, "non-empty list of recordings"),
    "generator": ((x for x in X), "non-empty list of recordings, .* generator"),
    "no rows": ([X[0], X[1][:0]], r"X\[1\]: Found array with 0 sample"),
    "short": (
        [X[0], X[1][:9], X[2], X[3][:4]],
        r"no row of X\[1\] \(9 rows\), X\[3\] \(4 rows\) has .* takes 10 rows",
    ),
    "gaps": (
        [X[0], np.where(np.arange(70)[:, np.newaxis] % 9 == 8, np.nan, X[1])],
        r"no row of X\[1\] \(70 rows\) has .*fill_gaps",
    ),
    "widths": ([X[0], X[1][:, :2]], r"X\[1\] has shape \(70, 2\), but X\[0\] has"),
    "one axis": ([X[0][:, 0], X[1][:, 0]], r"X\[0\] has shape \(90,\).* \.reshape"),
    "infinity": ([X[0], np.where(X[1] > 0, np.inf, X[1])], r"X\[1\]: .* infinity"),
    "text": ([X[0], X[1].astype(str).astype(object) + "a"], r"X\[1\]: "),
    "complex": ([X[0], X[1] + 1j], r"X\[1\]: .*Complex data not supported"),
    "names": (
        [X[0], FRAMES[1], FRAMES[2][["c", "b", "a"]]],
        r"X\[2\] has the columns \['c', 'b', 'a'\], but X\[1\] has",
    ),
    "rates": (
        [
            x.set_axis(np.arange(len(x)) / rate)
            for x, rate in zip(FRAMES, [100, 100, 50, 100, 100, 100], strict=True)
        ],
        "unequal rates, from 50 to 100 Hz",
    ),
}


@pytest.mark.parametrize(
    ("data", "message"), BAD_RECORDINGS.values(), ids=BAD_RECORDINGS
)
def test_bad_recordings(data, message):
    with pytest.raises(ValueError, match=message):
        make_forecaster().fit(data)


BAD_PARAMETERS = {
    "horizon 0": ({"horizons": (0, 1)}, r"horizons must be .*, got \(0, 1\)"),
    "half": ({"horizons": (1.5,)}, r"horizons must be .*, got \(1.5,\)"),
    "twice": ({"horizons": (2, 2)}, r"horizons must be different positive"),
    "no list": ({"horizons": 3}, r"horizons must be .*such as \(15, 30\), got 3"),
    "none": ({"horizons": ()}, r"horizons must be .*, got \(\)"),
    "truth": ({"horizons": (True,)}, "horizons must be"),
    "target": (
        {"targets": [0, 3]},
        r"targets holds 3, which is no column of X; it has",
    ),
    "negative": ({"targets": [-1]}, "targets holds -1"),
    "name": ({"targets": ["a"]}, r"targets holds 'a', .* \['x0', 'x1', 'x2'\]"),
    "target twice": ({"targets": [0, 0]}, r"targets=\[0, 0\] must name each"),
    "name and number": ({"targets": [0, "x0"]}, "must name each of some columns once"),
    "no target": ({"targets": []}, r"targets=\[\] must name"),
    "one target": ({"targets": 0}, r"targets=0 must be a list"),
    "text": ({"targets": "x0"}, r"targets='x0' must be a list"),
    "baseline": (
        {"baseline": "mean"},
        "baseline must be one of None, 'auto', 'last', 'linear', 'analogs', got 'mean'",
    ),
    "number": ({"baseline": 2}, "baseline must be one of"),
    "window": ({"baseline": Analogs(window=0)}, "baseline.window must be an integer"),
    "shape": (
        {"baseline": lambda recording, horizons: recording},
        r"baseline returned .*\(90, 3\) for .* 90 rows; return .* \(90, 2, 2\)",
    ),
    "operator": (
        {"estimator": KernelEDMD(), "baseline": "last"},
        "baseline='last' needs .* an operator forecasts by itself; leave baseline out",
    ),
    "delays": ({"delays": (1, 2)}, r"delays must be .*, got \(1, 2\)"),
    "embedding": ({"embedding": "both"}, "embedding must be one of 'copies', 'diff"),
}


@pytest.mark.parametrize(
    ("parameters", "message"), BAD_PARAMETERS.values(), ids=BAD_PARAMETERS
)
def test_bad_parameters(parameters, message):
    with pytest.raises(ValueError, match=message):
        make_forecaster(**parameters).fit(X)


Y = [x[:, :2] for x in X]
BAD_OUTPUTS = {
    "targets": ({"targets": [0]}, Y, r"both y and targets=\[0\] say what is forecast"),
    "baseline": ({"baseline": "last"}, Y, "baseline='last' needs .* but y holds them"),
    "analogs": ({"baseline": Analogs()}, Y, "but y holds them; leave baseline out"),
    "number": ({}, Y[1:], "y holds 5 recordings, X 6; pass one for each"),
    "array": ({}, Y[0], r"y must be a non-empty list .* pass \[y\] for one"),
    "dict": ({}, {"a": Y[0]}, r"y is a dict; pass list\(y.values\(\)\)"),
    "rows": (
        {},
        [Y[0], Y[1][1:], *Y[2:]],
        r"y\[1\] has 69 rows, X\[1\] 70; .* not shifted",
    ),
    "width": ({}, [Y[0], X[1], *Y[2:]], r"y\[1\] has 3 outputs, y\[0\] 2; pass"),
    "infinity": ({}, [Y[0], np.full((70, 2), np.inf), *Y[2:]], r"y\[1\].* infinity"),
    "nothing": (
        {},
        [Y[0], Y[1] * np.nan, *Y[2:]],
        r"no row of X\[1\] \(70 rows\) has a past and outputs",
    ),
    "names": (
        {},
        [
            pd.DataFrame(y, columns=list(names))
            for y, names in zip(Y, ["ab", "ba", *["ab"] * 4], strict=True)
        ],
        r"y\[1\] has the columns \['b', 'a'\], but y\[0\] has \['a', 'b'\]",
    ),
}


@pytest.mark.parametrize(
    ("parameters", "y", "message"), BAD_OUTPUTS.values(), ids=BAD_OUTPUTS
)
def test_bad_outputs(parameters, y, message):
    with pytest.raises(ValueError, match=message):
        make_forecaster(**{"targets": None, "baseline": "auto", **parameters}).fit(X, y)


def test_outputs_are_given_as_in_fit(fitted):
    with_outputs = make_forecaster(targets=None).fit(X, Y)
    for method in ("score", "errors", "conformalize"):
        with pytest.raises(ValueError, match="fit was given y; pass the outputs here"):
            getattr(with_outputs, method)(X)
        with pytest.raises(ValueError, match="fit was not given y"):
            getattr(fitted["last"], method)(X, Y)
        with pytest.raises(ValueError, match="y has 3 outputs, that of fit had 2"):
            getattr(with_outputs, method)(X, X)


def test_another_rate_is_refused():
    frames = [x.set_axis(np.arange(len(x)) / 100) for x in FRAMES]
    forecaster = make_forecaster().fit(frames)
    assert forecaster.rate_ == pytest.approx(100)
    forecaster.forecast(FRAMES)  # whose index counts frames
    slow = [x.set_axis(np.arange(len(x)) / 50) for x in FRAMES]
    message = "recordings have 50 samples a second, those of fit had 100; interpolate"
    with pytest.raises(ValueError, match=message):
        forecaster.forecast(slow)
    assert make_forecaster().fit(FRAMES).rate_ is None


def test_angles_that_wrap_are_warned_of(fitted):
    turning = [np.column_stack([x[:, :2], (40.0 * np.arange(len(x))) % 360]) for x in X]
    message = r"X\[0\] \(and 5 more arrays\) jumps by almost a full turn in column x2"
    with pytest.warns(UserWarning, match=message) as record:
        make_forecaster().fit(turning)
    assert len(record) == 1
    assert record[0].filename == __file__


def test_rows_without_forecast_are_warned_of(fitted):
    """Where somebody waits for the forecast, and only there."""
    short = [X[0], X[1][:3]]
    for method in ("predict", "predict_baseline", "errors"):
        assert np.isnan(getattr(fitted["last"], method)(short)[1]).all()
    message = r"1 of 2 recordings have no forecast, the first is X\[1\]: .*4 rows"
    with pytest.warns(UserWarning, match=message) as record:
        forecasts = fitted["last"].forecast(short)
    assert record[0].filename == __file__
    assert np.isfinite(forecasts[0]).all()
    assert np.isnan(forecasts[1]).all()


def test_scores_that_cannot_be(fitted):
    with pytest.raises(ValueError, match="no two rows have both a forecast and"):
        fitted["last"].score([X[0][:9]])
    with pytest.raises(ValueError, match="sample_weight has shape"):
        fitted["last"].score(X, sample_weight=[1.0])
    with pytest.raises(ValueError, match="not only zeros"):
        fitted["last"].score(X, sample_weight=np.zeros(6))


def test_nothing_before_fit():
    for method in (
        *("predict", "forecast", "score", "errors", "predict_baseline"),
        *("conformalize", "predict_interval", "forecast_interval"),
    ):
        with pytest.raises(NotFittedError):
            getattr(make_forecaster(), method)(X)
