"""Scores of forecasts, against loops over starts and steps."""

import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.inspection import permutation_importance
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, cross_val_score, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    TrajectoryKFold,
    make_forecast_scorer,
    make_valid_time_scorer,
    trajectory_pairs,
)
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.scoring import ForecastScorer, HorizonErrorScorer, ValidTimeScorer

LENGTHS = [14, 40, 25, 31, 18, 22]
PARTS = [(0, 700), (700, 801)]  # first start, number of starts


@pytest.fixture(scope="module")
def swings():
    data = make_pendulum(
        40, initial="random", n_trajectories=len(LENGTHS), random_state=0
    )
    trajectories = [x[: n + 1] for x, n in zip(data.trajectories, LENGTHS, strict=True)]
    outputs = [data.G(x) for x in trajectories]
    return trajectories, outputs


@pytest.fixture(scope="module")
def model(swings):
    pairs = trajectory_pairs(*swings)
    model = KernelEDMD("matern32", trend="linear", n_modes=0)
    return model.fit(pairs.X[::3], pairs.y[::3], X_next=pairs.X_next[::3])


def errors_by_loops(model, trajectories, outputs, n_steps, relift=False):
    """Squared distances after 1 to n_steps steps from every start that has so many."""
    errors = []
    for x, y in zip(trajectories, outputs, strict=True):
        starts = range(len(x) - n_steps)
        forecasts = model.forecast(x, n_steps, relift=relift)[starts]
        for start, y_pred in zip(starts, forecasts, strict=True):
            truth = y[start + 1 : start + 1 + n_steps]
            errors.append(np.square(y_pred - truth).reshape(n_steps, -1).sum(axis=1))
    return np.array(errors)


@pytest.mark.parametrize("relift", [False, True])
@pytest.mark.parametrize("discount", [1.0, 0.8])
@pytest.mark.parametrize("n_steps", [1, 7, 20])
def test_error_over_the_horizon(swings, model, n_steps, discount, relift):
    pairs = trajectory_pairs(*swings)
    errors = errors_by_loops(model, *swings, n_steps, relift)
    weights = discount ** np.arange(n_steps)
    expected = -np.sqrt(errors.mean(axis=0) @ weights / weights.sum())
    scorer = make_forecast_scorer(n_steps, discount=discount, relift=relift)
    score = scorer(model, pairs.X, pairs.y, sample_index=pairs.sample_index)
    assert score == pytest.approx(expected, rel=1e-9)
    # Rows in any order, with gaps in the clock, are the same rows.
    order = np.random.default_rng(0).permutation(len(pairs.X))
    shuffled = scorer(
        model, pairs.X[order], pairs.y[order], sample_index=pairs.sample_index[order]
    )
    assert shuffled == pytest.approx(expected, rel=1e-9)


def test_several_outputs_count_alike(swings):
    trajectories, _ = swings
    pairs = trajectory_pairs(trajectories)
    model = KernelEDMD(trend="linear", n_modes=0)
    model.fit(pairs.X[::3], X_next=pairs.X_next[::3])
    errors = errors_by_loops(model, trajectories, trajectories, 5)
    expected = -np.sqrt(errors.mean() / 2)
    given = make_forecast_scorer(5)(
        model, pairs.X, pairs.y, sample_index=pairs.sample_index
    )
    assert given == pytest.approx(expected, rel=1e-9)


def test_states_are_the_default_outputs(swings):
    """Rows of whole trajectories: the last one has no successor but is one."""
    trajectories, _ = swings
    X = np.vstack(trajectories)
    index = np.concatenate(
        [100 * i + np.arange(len(x)) for i, x in enumerate(trajectories)]
    )
    model = KernelEDMD(trend="linear", n_modes=0).fit(X, sample_index=index)
    errors = errors_by_loops(model, trajectories, trajectories, 6)
    expected = -np.sqrt(errors.mean() / 2)
    assert make_forecast_scorer(6)(model, X, sample_index=index) == pytest.approx(
        expected, rel=1e-9
    )
    # A single trajectory needs no clock.
    first = trajectories[1]
    model.fit(first)
    errors = errors_by_loops(model, [first], [first], 6)
    assert make_forecast_scorer(6)(model, first) == pytest.approx(
        -np.sqrt(errors.mean() / 2), rel=1e-9
    )


@pytest.mark.parametrize("tolerance", [1e-4, 1e-3, 1e-2, 10.0])
def test_valid_horizon_counts_the_steps_before_the_first_miss(swings, model, tolerance):
    pairs = trajectory_pairs(*swings)
    errors = errors_by_loops(model, *swings, 12)
    counts = []
    for row in errors:
        bad = np.flatnonzero(row > tolerance**2)
        counts.append(bad[0] if len(bad) else 12)
    scorer = make_valid_time_scorer(12, tolerance)
    score = scorer(model, pairs.X, pairs.y, sample_index=pairs.sample_index)
    assert score == pytest.approx(np.mean(counts))
    assert (tolerance < 5) == (0 < score < 12)


@pytest.mark.parametrize("delays", [1, 3])
@pytest.mark.parametrize("kind", ["states", "outputs in the state"])
def test_ends_of_trajectories_are_seen_where_outputs_are_states(swings, delays, kind):
    """Without the clock; the outputs of a row are columns of the one that follows."""
    trajectories, outputs = swings
    if kind == "states":
        pairs = trajectory_pairs(trajectories, delays=delays)
    else:
        pairs = trajectory_pairs(
            trajectories, outputs, delays=delays, outputs_in_state=True
        )
    model = KernelEDMD(trend="linear", n_modes=0)
    model.fit(pairs.X[::2], pairs.y[::2], X_next=pairs.X_next[::2])
    for scorer in (make_forecast_scorer(8), make_valid_time_scorer(8, 0.01)):
        seen = scorer(model, pairs.X, pairs.y)
        assert seen == scorer(model, pairs.X, pairs.y, sample_index=pairs.sample_index)
        frame = pd.DataFrame(pairs.X)
        assert seen == scorer(model, frame.to_numpy(), pd.DataFrame(pairs.y))
    # Had it crossed the ends, the error would be as large as the swings.
    consecutive = np.arange(len(pairs.X))
    wrong = make_forecast_scorer(8)(model, pairs.X, pairs.y, sample_index=consecutive)
    assert wrong < 3 * make_forecast_scorer(8)(model, pairs.X, pairs.y)


def test_successors_are_found_whatever_the_lag_and_precision(swings):
    """A lag of three makes interleaved runs, whose rows are not side by side."""
    trajectories, _ = swings
    pairs = trajectory_pairs(trajectories, lag=3)
    model = KernelEDMD(trend="linear", n_modes=0).fit(pairs.X, X_next=pairs.X_next)
    order = np.random.default_rng(0).permutation(len(pairs.X))
    scorer = make_forecast_scorer(4)
    wanted = scorer(model, pairs.X, pairs.y, pairs.sample_index)
    assert scorer(model, pairs.X, pairs.y) == wanted
    assert scorer(model, pairs.X[order], pairs.y[order]) == pytest.approx(wanted)
    single = pairs.X.astype(np.float32)
    wanted = scorer(model, single, pairs.y, pairs.sample_index)
    assert scorer(model, single, pairs.y) == wanted


def test_rows_that_cannot_be_linked_are_refused(swings, model):
    """Outputs that are no states, a model of several trajectories, and no clock."""
    pairs = trajectory_pairs(*swings)
    for scorer in (make_forecast_scorer(4), make_valid_time_scorer(4, 0.1)):
        with pytest.raises(ValueError, match=r"pass sample_index.*metadata_routing"):
            scorer(model, pairs.X, pairs.y)
    with pytest.raises(ValueError, match="pass sample_index"):
        make_forecast_scorer(4)(model, pairs.X)
    # A model of one trajectory in the order of time is scored on another.
    trajectories, outputs = swings
    one = KernelEDMD(n_modes=0).fit(trajectories[1][:-1], outputs[1][1:])
    x, y = trajectories[2][:-1], outputs[2][1:]
    assert make_forecast_scorer(4)(one, x, y) == make_forecast_scorer(4)(
        one, x, y, sample_index=range(len(x))
    )


@pytest.mark.parametrize("decimals", [1, 2])
def test_rounded_states_are_not_mistaken_for_each_other(swings, decimals):
    """Where values occur more than once, they do not tell what follows."""
    trajectories, _ = swings
    rounded = [x.round(decimals) for x in trajectories]
    pairs = trajectory_pairs(rounded, [x[:, 1] for x in rounded])
    model = KernelEDMD(n_modes=0, alpha=1e-3)
    model.fit(pairs.X, pairs.y, sample_index=pairs.sample_index)
    with pytest.raises(ValueError, match="pass sample_index"):
        make_forecast_scorer(4)(model, pairs.X, pairs.y)


def test_pipeline_of_one_step(swings):
    trajectories, _ = swings
    pipeline = make_pipeline(KernelEDMD(n_modes=0)).fit(trajectories[1])
    score = make_forecast_scorer(4)(pipeline, trajectories[1])
    assert score == make_forecast_scorer(4)(pipeline[-1], trajectories[1])


def test_names_of_features_reach_the_estimator(swings):
    trajectories, outputs = swings
    X, y = pd.DataFrame(trajectories[1][:-1], columns=["p", "q"]), outputs[1][1:]
    scores = cross_val_score(
        KernelEDMD(trend="linear", n_modes=0),
        X,
        y,
        scoring=make_forecast_scorer(3),
        cv=TrajectoryKFold(3),
        error_score="raise",
    )
    assert (scores < 0).all()


def test_states_in_a_pipeline_are_compared_as_it_transforms_them(swings):
    trajectories, _ = swings
    X = 1000 * np.vstack(trajectories)
    index = np.concatenate(
        [100 * i + np.arange(len(x)) for i, x in enumerate(trajectories)]
    )
    pipeline = make_pipeline(StandardScaler(), KernelEDMD(trend="linear", n_modes=0))
    pipeline.fit(X, kerneledmd__sample_index=index)
    Z = pipeline[0].transform(X)
    bare = clone(pipeline[-1]).fit(Z, sample_index=index)
    score = make_forecast_scorer(5)(pipeline, X, sample_index=index)
    assert score == make_forecast_scorer(5)(bare, Z, sample_index=index)
    assert -0.1 < score < 0


@pytest.mark.parametrize("n_jobs", [None, pytest.param(2, marks=pytest.mark.slow)])
def test_search_without_and_with_metadata_routing(swings, n_jobs):
    trajectories, _ = swings
    pairs = trajectory_pairs(trajectories)
    search = GridSearchCV(
        make_pipeline(StandardScaler(), KernelEDMD(trend="linear", n_modes=0)),
        {"kerneledmd__beta": [0.05, 5.0], "kerneledmd__kernel": ["wendland_c4"]},
        scoring={
            "error": make_forecast_scorer(10),
            "steps": make_valid_time_scorer(10, 0.05),
        },
        refit="error",
        cv=TrajectoryKFold(3),
        n_jobs=n_jobs,
        error_score="raise",
    )
    off = clone(search).fit(
        pairs.X,
        pairs.X_next,
        groups=pairs.groups,
        kerneledmd__sample_index=pairs.sample_index,
    )
    with config_context(enable_metadata_routing=True):
        on = clone(search).fit(
            pairs.X, pairs.X_next, groups=pairs.groups, sample_index=pairs.sample_index
        )
    for name in ("mean_test_error", "mean_test_steps"):
        np.testing.assert_allclose(off.cv_results_[name], on.cv_results_[name])
    assert off.best_params_["kerneledmd__beta"] == 5.0
    worse, better = off.cv_results_["mean_test_steps"]
    assert worse < better <= 10


def test_search_over_states_alone(swings):
    """No outputs at all: the clock reaches the scorer by metadata routing."""
    trajectories, _ = swings
    X = np.vstack(trajectories)
    groups = np.repeat(np.arange(len(trajectories)), [len(x) for x in trajectories])
    index = np.concatenate(
        [100 * i + np.arange(len(x)) for i, x in enumerate(trajectories)]
    )
    with config_context(enable_metadata_routing=True):
        scores = cross_validate(
            KernelEDMD(trend="linear", n_modes=0),
            X,
            scoring=make_forecast_scorer(5),
            cv=TrajectoryKFold(3),
            params={"groups": groups, "sample_index": index},
            error_score="raise",
        )["test_score"]
    assert (scores < 0).all()
    # One trajectory a fold is told apart by the folds themselves.
    lone = cross_val_score(
        KernelEDMD(trend="linear", n_modes=0),
        trajectories[1],
        scoring=make_forecast_scorer(5),
        cv=TrajectoryKFold(3),
        error_score="raise",
    )
    assert (lone < 0).all()


def test_divergence_scores_what_was_asked_for():
    x = 2.0 ** np.arange(-10, 4)[:, np.newaxis]
    model = KernelEDMD(trend="linear", n_modes=0).fit(x)
    trajectory = 2.0 ** np.arange(-1000, 20)[:, np.newaxis]
    clock = np.arange(len(trajectory))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match="left the range of numbers"):
            make_forecast_scorer(1010, error_score="raise")(
                model, trajectory + 1e-3, None, clock
            )
        for value in (-7.0, -np.inf, np.nan):
            scorer = make_forecast_scorer(1010, error_score=value)
            np.testing.assert_equal(
                scorer(model, trajectory + 1e-3, None, clock), value
            )
        steps = make_valid_time_scorer(1010, 1.0)(model, trajectory + 1e-3, None, clock)
    assert 8 < steps < 11  # 2 ** s times the error that it starts with


def test_scorers_can_be_pickled_compared_and_read():
    for scorer, kind in (
        (make_forecast_scorer(5, error_score=-9.0), HorizonErrorScorer),
        (make_valid_time_scorer(3, 0.1), ValidTimeScorer),
    ):
        assert type(scorer) is kind
        assert isinstance(scorer, ForecastScorer)
        assert eval(repr(scorer)) == scorer
        assert pickle.loads(pickle.dumps(scorer)) == scorer
        assert clone(scorer, safe=False) == scorer
    assert repr(make_valid_time_scorer(3, 0.1)) == (
        "ValidTimeScorer(n_steps=3, relift=False, tolerance=0.1)"
    )
    assert make_forecast_scorer(5) != make_forecast_scorer(6)


BAD = {
    "no steps": (lambda: make_forecast_scorer(0), "n_steps must be an integer"),
    "half steps": (
        lambda: make_valid_time_scorer(1.5, 1.0),
        "n_steps must be an integer",
    ),
    "no weight": (
        lambda: make_forecast_scorer(3, discount=0.0),
        "discount must be a finite",
    ),
    "usury": (
        lambda: make_forecast_scorer(3, discount=1.1),
        "discount must be at most 1",
    ),
    "no tolerance": (
        lambda: make_valid_time_scorer(3, 0.0),
        "tolerance must be a finite",
    ),
    "relift": (lambda: make_forecast_scorer(3, relift="yes"), "relift must be True or"),
    "error_score": (
        lambda: make_forecast_scorer(3, error_score="no"),
        "error_score must be",
    ),
    "NaN": (lambda: make_valid_time_scorer(3, np.nan), "tolerance must be a finite"),
}


@pytest.mark.parametrize(("make", "message"), BAD.values(), ids=BAD)
def test_bad_parameters(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bad_data(swings, model):
    pairs = trajectory_pairs(*swings)
    with pytest.raises(
        ValueError, match=r"None of the 150 held-out rows .*n_steps=41 "
    ):
        make_forecast_scorer(41)(
            model, pairs.X, pairs.y, sample_index=pairs.sample_index
        )
    with pytest.raises(ValueError, match="inconsistent numbers of samples"):
        make_forecast_scorer(4)(model, pairs.X, pairs.y[:-1])
    with pytest.raises(TypeError, match=r"LinearRegression has no method forecast"):
        make_forecast_scorer(4)(
            LinearRegression().fit(pairs.X, pairs.y),
            pairs.X,
            pairs.y,
            pairs.sample_index,
        )
    with pytest.raises(
        ValueError, match="y has 2 outputs, but the estimator forecasts 1"
    ):
        make_forecast_scorer(4)(model, pairs.X, pairs.X_next, pairs.sample_index)


@pytest.fixture(scope="module")
def states():
    data = make_pendulum(40, initial="random", n_trajectories=3, random_state=0)
    pairs = trajectory_pairs(data.trajectories)
    model = KernelEDMD(trend="linear", n_modes=0)
    return pairs, model.fit(pairs.X, X_next=pairs.X_next)


@pytest.mark.slow
def test_many_starts_are_scored_in_parts():
    """4 million forecast outputs at a time: here from about 1,000 of the starts."""
    x = make_pendulum(3500).trajectories[0]
    model = KernelEDMD("wendland_c4", beta=4.0, n_modes=10).fit(x[:60])
    scorer = make_forecast_scorer(2000)
    whole = scorer(model, x)
    parts = [(n, scorer(model, x[first : first + n + 2000])) for first, n in PARTS]
    expected = -np.sqrt(
        np.average([s**2 for _, s in parts], weights=[n for n, _ in parts])
    )
    assert len(x) - 2000 == sum(n for n, _ in parts)
    assert whole == pytest.approx(expected, rel=1e-9)
    assert parts[0][1] != pytest.approx(parts[1][1], rel=1e-6)


def test_an_error_of_the_tolerance_is_tolerated():
    """A state at rest, off by one from what it is said to be."""
    model = KernelEDMD("wendland_c0", n_modes=0).fit([[0.0], [0.0]])
    assert make_valid_time_scorer(3, 1.0)(model, np.zeros((3, 1)), np.ones((3, 1))) == 3


def test_states_at_rest_follow_each_other():
    """Equal rows: the next one is the successor, and none runs in circles."""
    x = np.concatenate([np.zeros(5), np.linspace(0, 1, 6)])[:, np.newaxis]
    model = KernelEDMD(trend="linear", n_modes=0, alpha=1e-3).fit(x)
    X, y = x[:-1], x[1:]
    expected = make_forecast_scorer(3)(model, X, y, sample_index=range(10))
    assert make_forecast_scorer(3)(model, X, y) == expected


def test_outputs_in_single_precision_are_found_among_states_in_double(states):
    pairs, model = states
    wanted = make_forecast_scorer(4)(model, pairs.X, pairs.y, pairs.sample_index)
    single = make_forecast_scorer(4)(model, pairs.X, pairs.y.astype(np.float32))
    assert single == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("kind", ["now and then a state", "states as objects"])
def test_outputs_that_do_not_tell_what_follows(states, kind):
    """Then the rows are one trajectory."""
    pairs, _ = states
    X = pairs.X[:39]
    y = np.where(np.arange(39) % 4 == 0, pairs.X_next[:39, 0], -7.0)
    model = KernelEDMD(trend="linear", n_modes=0).fit(X, y)
    wanted = make_forecast_scorer(4)(model, X, y, sample_index=range(39))
    states = X.astype(object) if kind == "states as objects" else X
    assert make_forecast_scorer(4)(model, states, y) == wanted


def test_divergence_by_eigenvalues_scores_what_was_asked_for():
    """Their powers reach numbers whose squares overflow, without a warning."""
    x = 2.0 ** np.arange(-10, 4)[:, np.newaxis]
    model = KernelEDMD(trend="linear", n_modes=2).fit(x)
    trajectory = 2.0 ** np.arange(-1000, 20)[:, np.newaxis] + 1e-3
    scorer = make_forecast_scorer(1010, error_score=-7.0)
    assert scorer(model, trajectory, None, range(1020)) == -7.0


# Frames need no metadata routing; arrays are told so


def framed(pairs):
    """X and y with the index that trajectory_pairs of data frames makes."""
    index = pd.MultiIndex.from_arrays(
        [pairs.groups, pairs.sample_index], names=["trial", "sample_index"]
    )
    return pd.DataFrame(pairs.X, index), pd.DataFrame(pairs.y, index)


@pytest.fixture(scope="module")
def pairs(swings):
    """With a lag, and outputs that are no states."""
    return trajectory_pairs(*swings, lag=2)


@pytest.mark.parametrize("of", ["X and y", "X", "y"])
def test_held_out_frames_tell_what_follows(swings, pairs, of):
    X, y = framed(pairs)
    model = KernelEDMD(trend="linear", n_modes=0).fit(X.to_numpy(), y)
    scorer = make_forecast_scorer(4)
    wanted = scorer(model, pairs.X, pairs.y, sample_index=pairs.sample_index)
    held_out = X if "X" in of else pairs.X, y if "y" in of else pairs.y
    assert scorer(model, *held_out) == wanted
    # What is given wins over the index.
    backwards = scorer(model, *held_out, sample_index=-pairs.sample_index)
    assert backwards < 2 * wanted


@pytest.mark.parametrize("several", [False, True])
def test_search_over_frames_without_metadata_routing(pairs, several):
    X, y = framed(pairs)
    error, steps = make_forecast_scorer(5), make_valid_time_scorer(5, 0.05)
    pipeline = make_pipeline(StandardScaler(), KernelEDMD(trend="linear", n_modes=0))
    search = GridSearchCV(
        pipeline,
        {"kerneledmd__beta": [0.05, 5.0]},
        scoring={"error": error, "steps": steps} if several else error,
        refit="error" if several else True,
        cv=TrajectoryKFold(3),
    )
    found = clone(search).fit(X, y, groups=pairs.groups)
    with config_context(enable_metadata_routing=True):
        routed = search.fit(
            pairs.X, pairs.y, groups=pairs.groups, sample_index=pairs.sample_index
        )
    name = "mean_test_error" if several else "mean_test_score"
    np.testing.assert_allclose(found.cv_results_[name], routed.cv_results_[name])
    assert np.ptp(found.cv_results_[name]) > 0.001
    scores = cross_val_score(
        found.best_estimator_,
        X,
        y,
        groups=pairs.groups,
        scoring=error,
        cv=TrajectoryKFold(3),
    )
    assert scores.mean() == pytest.approx(found.best_score_, rel=1e-9)


def test_labels_show_the_holes_of_held_out_rows(swings):
    """Two blocks of one trajectory are held out together."""
    x = pd.DataFrame(swings[0][1])
    y = pd.Series(swings[1][1], x.index)
    model = KernelEDMD(n_modes=0).fit(x[:-1], y[1:])
    kept = np.r_[2:12, 20:30]
    scorer = make_forecast_scorer(3)
    score = scorer(model, x.iloc[kept], y.iloc[kept + 1])
    assert score == scorer(model, x.iloc[kept], y.iloc[kept + 1], sample_index=kept)
    arrays = x.iloc[kept].to_numpy(), y.iloc[kept + 1].to_numpy()
    assert scorer(model, *arrays) < 10 * score


@pytest.mark.parametrize("n_jobs", [None, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("error_score", [np.nan, "raise"])
def test_searches_say_what_to_set(pairs, error_score, n_jobs):
    """Where nan and a warning for every fold came out before."""
    edmd = KernelEDMD(n_modes=0)
    scorer = make_forecast_scorer(4)
    given = {"cv": TrajectoryKFold(3), "error_score": error_score, "n_jobs": n_jobs}
    index = {"sample_index": pairs.sample_index}
    message = (
        r"held-out rows follow each other; pass sample_index=pairs\.sample_index, in a "
        r"search to its fit .*enable_metadata_routing=True.*data frames"
    )
    for scoring in (scorer, {"a": make_valid_time_scorer(4, 0.1), "b": scorer}):
        search = GridSearchCV(
            edmd, {"beta": [1.0]}, scoring=scoring, refit=False, **given
        )
        with pytest.raises(ValueError, match=message):
            search.fit(pairs.X, pairs.y, groups=pairs.groups, **index)
        with pytest.raises(ValueError, match=message):
            cross_validate(
                edmd,
                pairs.X,
                pairs.y,
                groups=pairs.groups,
                scoring=scoring,
                params=index,
                **given,
            )
    with pytest.raises(ValueError, match=message):
        cross_val_score(
            edmd,
            pairs.X,
            pairs.y,
            groups=pairs.groups,
            scoring=scorer,
            params=index,
            **given,
        )


def test_other_callers_get_the_error_itself(pairs):
    """A number is all that they could use."""
    model = KernelEDMD(n_modes=0)
    model.fit(pairs.X, pairs.y, sample_index=pairs.sample_index)
    with pytest.raises(ValueError, match=r"^It is not known which of the held-out"):
        permutation_importance(
            model, pairs.X, pairs.y, scoring=make_forecast_scorer(4), n_repeats=1
        )
    # Other functions of that module of scikit-learn add scores up.
    module = {"__name__": "sklearn.model_selection._validation"}
    exec("def add(scorer, *data): return 0 + scorer(*data)", module)
    with pytest.raises(ValueError, match=r"^It is not known which of the held-out"):
        module["add"](make_forecast_scorer(4), model, pairs.X, pairs.y)
    # In a thread, nobody stands behind the call.
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(make_forecast_scorer(4), model, pairs.X, pairs.y)
        with pytest.raises(ValueError, match=r"^It is not known which of the held-out"):
            future.result()
