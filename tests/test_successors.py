"""How an operator finds out which rows follow each other, and when it refuses."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.compose import TransformedTargetRegressor
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    SeparatedCenterSelector,
    TrajectoryKFold,
    forecast,
    make_forecast_scorer,
    trajectory_pairs,
)
from sklearn_koopman._dynamics._shifts import find_break, find_contradiction
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.kinematics import unwrap_angles

FREQUENCY = 0.1198  # in Hz, of the pendulum that swings by 2.24 rad


def indexed(values, pairs):
    """A data frame with the index that trajectory_pairs of data frames makes."""
    index = pd.MultiIndex.from_arrays(
        [pairs.groups, pairs.sample_index], names=["trial", "sample_index"]
    )
    return pd.DataFrame(values, index=index)


def operator(**settings):
    return KernelEDMD(
        "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23), **settings
    )


def links(model, n):
    """The rows that have a successor: with every one a centre, all that do."""
    return np.isin(np.arange(n), model.center_indices_)


@pytest.fixture(scope="module")
def swings():
    data = make_pendulum(60, initial="random", n_trajectories=5, random_state=0)
    return list(data.trajectories)


@pytest.fixture(scope="module")
def lagged():
    return trajectory_pairs(make_pendulum(400, step=0.1).trajectories[0], lag=10)


# A step of several rows


@pytest.mark.parametrize("of", ["X", "y"])
def test_frequency_of_a_lag_by_the_index(lagged, of):
    """Of steps of 1 s; taken for 0.1 s, the motion would seem ten times slower."""
    X, y = indexed(lagged.X, lagged), indexed(lagged.y, lagged)
    given = (X, lagged.y) if of == "X" else (lagged.X, y)
    model = operator().fit(*given)
    frequencies = model.continuous_eigenvalues(dt=1.0)[1]
    slow = frequencies[np.argsort(np.abs(np.abs(frequencies) - FREQUENCY))[0]]
    assert abs(slow) == pytest.approx(FREQUENCY, abs=1e-3)
    explicit = operator().fit(lagged.X, lagged.y, sample_index=lagged.sample_index)
    np.testing.assert_array_equal(model.eigenvalues_, explicit.eigenvalues_)
    error = np.abs(model.forecast(lagged.X[:1], 20)[0] - lagged.y[:200:10]).max()
    assert error < 0.02
    # What came out before: the rows in order, believed.
    wrong = operator().fit(lagged.X, lagged.y, sample_index=range(len(lagged.X)))
    error = np.abs(wrong.forecast(lagged.X[:1], 20)[0] - lagged.y[:200:10]).max()
    assert error > 1.0


@pytest.mark.parametrize("frame", [False, True])
@pytest.mark.parametrize("delays", [1, 3])
@pytest.mark.parametrize("column", [slice(None), 1])
def test_a_lag_contradicts_the_order(frame, delays, column):
    trajectory = make_pendulum(120, step=0.1).trajectories[0]
    pairs = trajectory_pairs(trajectory, lag=10, delays=delays)
    # The labels of a frame that was made from an array are no more than its order.
    X = pd.DataFrame(pairs.X) if frame else pairs.X
    with pytest.raises(
        ValueError,
        match=r"row 0 is the state of row 10, but row 1 would .*=pairs\.sample_index",
    ):
        operator().fit(X, pairs.y[:, column])


@pytest.mark.parametrize("scaled", [False, True])
def test_frames_of_trajectory_pairs_need_nothing_else(swings, scaled):
    """Through the whole way: lag, several trials, folds, forecasts."""
    frames = [pd.DataFrame(x, columns=["velocity", "angle"]) for x in swings]
    pairs, plain = (trajectory_pairs(x, lag=4) for x in (frames, swings))
    edmd = KernelEDMD("wendland_c4", beta=4.0, n_modes=0)
    model = make_pipeline(StandardScaler(), edmd) if scaled else edmd
    given = {"kerneledmd__" * scaled + "sample_index": plain.sample_index}
    wanted = clone(model).fit(plain.X, plain.y, **given)
    found = clone(model).fit(pairs.X, pairs.y)
    np.testing.assert_allclose(
        forecast(found, pairs.X[:5], 8), forecast(wanted, plain.X[:5], 8), atol=1e-9
    )
    scorer = make_forecast_scorer(8)
    folds = TrajectoryKFold(5)
    scores = cross_val_score(
        model, pairs.X, pairs.y, groups=plain.groups, scoring=scorer, cv=folds
    )
    for (train, test), score in zip(
        folds.split(plain.X, groups=plain.groups), scores, strict=True
    ):
        name = next(iter(given))
        one = clone(model).fit(
            plain.X[train], plain.y[train], **{name: plain.sample_index[train]}
        )
        index = plain.sample_index[test]
        assert score == pytest.approx(
            scorer(one, plain.X[test], plain.y[test], index), rel=1e-6
        )


# Several trials


@pytest.mark.parametrize("kind", ["states", "outputs in the state", "delays alone"])
def test_ends_of_trials_contradict_the_order(swings, kind):
    outputs = None if kind == "states" else [np.sin(x[:, 1]) for x in swings]
    pairs = trajectory_pairs(
        swings, outputs, delays=2, outputs_in_state=outputs is not None
    )
    y = None if kind == "delays alone" else pairs.y
    found = (
        r"row 59 does not: a recording ends before it"
        if y is None
        else r"row 58 is not that of row 59, but row 59 would be taken to follow row 58"
    )
    for X in (pairs.X, pd.DataFrame(pairs.X)):
        with pytest.raises(ValueError, match=found + ".* every row is one .*=range"):
            KernelEDMD(n_modes=0).fit(X, y)
    for clock in (pairs.sample_index, range(len(pairs.X))):
        KernelEDMD(n_modes=0).fit(pairs.X, y, sample_index=clock)
    KernelEDMD(n_modes=0).fit(pairs.X, y, X_next=pairs.X_next)
    KernelEDMD(n_modes=0).fit(indexed(pairs.X, pairs), y)


def test_index_links_what_the_clock_links(swings):
    pairs = trajectory_pairs(swings)
    order = np.random.default_rng(0).permutation(len(pairs.X))
    X, y = (indexed(z, pairs).iloc[order] for z in (pairs.X, pairs.y))
    explicit = KernelEDMD(n_modes=0).fit(
        pairs.X[order], sample_index=pairs.sample_index[order]
    )
    for given in ((X,), (X, y), (X.to_numpy(), y)):
        model = KernelEDMD(n_modes=0).fit(*given)
        np.testing.assert_array_equal(
            links(model, len(order)), links(explicit, len(order))
        )
        np.testing.assert_allclose(
            model.predict(pairs.X[:9]), explicit.predict(pairs.X[:9]), rtol=1e-6
        )
    # One trial of it, whose index has one level left.
    one = indexed(pairs.X, pairs).loc[2]
    alone = KernelEDMD(n_modes=0).fit(one)
    assert links(alone, len(one)).sum() == len(one) - 1


def test_explicit_successors_win_over_the_index(swings):
    pairs = trajectory_pairs(swings)
    X = indexed(pairs.X, pairs)
    reverse = -pairs.sample_index
    model = KernelEDMD(n_modes=0).fit(X, sample_index=reverse)
    plain = KernelEDMD(n_modes=0).fit(pairs.X, sample_index=reverse)
    np.testing.assert_array_equal(model.koopman_matrix_, plain.koopman_matrix_)
    backwards = np.roll(pairs.X, 1, axis=0)
    model = KernelEDMD(n_modes=0).fit(X, X_next=pd.DataFrame(backwards))
    plain = KernelEDMD(n_modes=0).fit(pairs.X, X_next=backwards)
    np.testing.assert_array_equal(model.koopman_matrix_, plain.koopman_matrix_)


# Behind a scaler, and other maps of single columns


def hertz(f, n=400, phase=0.0):
    """A motion of f Hz at 100 Hz, which needs no delays."""
    t = 0.01 * np.arange(n)[:, None]
    phases = phase + np.array([0.0, np.pi / 2])
    return np.cos(2 * np.pi * f * t + phases) + 0.2 * np.cos(5.3 * t + 3 * phases)


TRIALS = [hertz(1.0, phase=p) * a for p, a in [(0, 1), (1, 1.1), (2, 0.8)]]
LINEAR = {"trend": "linear", "centers": SeparatedCenterSelector(), "alpha": 1e-3}
LINEAR |= {"method": "least_squares", "n_modes": 0}
FINDING = r"row 0 is the state of row 15, but row 1 would"


@pytest.mark.parametrize("scaler", [StandardScaler(), MinMaxScaler((2, 5))])
@pytest.mark.parametrize("delays", [1, 5])
def test_a_lag_contradicts_behind_a_scaler(scaler, delays):
    pairs = trajectory_pairs(TRIALS, lag=15, delays=delays, delay_step=3)
    pipeline = make_pipeline(scaler, KernelEDMD(**LINEAR))
    mixed = np.column_stack([np.exp(pairs.y[:, 0]), pairs.y])
    for y in (pairs.y, pairs.y[:, 1], pairs.y[:, ::-1], mixed, 3 - 2 * -pairs.y):
        with pytest.raises(ValueError, match=FINDING):
            pipeline.fit(pairs.X, y)
        with pytest.raises(ValueError, match=FINDING):
            pipeline.fit(pairs.X.astype(np.float32), y.astype(np.float32))
    both = TransformedTargetRegressor(pipeline, transformer=StandardScaler())
    with pytest.raises(ValueError, match=FINDING):
        both.fit(pairs.X, pairs.y)
    # Frames whose index both steps have lost.
    frames = trajectory_pairs([pd.DataFrame(x) for x in TRIALS], lag=15)
    with pytest.raises(ValueError, match=FINDING):
        pipeline.fit(frames.X, frames.y.to_numpy())
    clock = {"kerneledmd__sample_index": pairs.sample_index}
    pipeline.fit(pairs.X, pairs.y, **clock)


def test_the_lag_of_the_clock_gives_the_frequency():
    """The pairs that are refused: 1 Hz, and not the 1/15 of it that came out."""
    angles = [2 * np.pi * 0.01 * np.arange(400) + phase for phase in (0, 1, 2)]
    trials = [np.c_[np.cos(angle), np.sin(angle)] for angle in angles]
    pairs = trajectory_pairs(trials, lag=15)
    model = KernelEDMD(**LINEAR | {"n_modes": None})
    with pytest.raises(ValueError, match=FINDING):
        make_pipeline(StandardScaler(), model).fit(pairs.X, pairs.y)
    model.fit(pairs.X, pairs.y, sample_index=pairs.sample_index)
    frequencies = np.abs(model.continuous_eigenvalues(dt=0.15)[1])
    assert np.abs(frequencies - 1.0).min() < 1e-3


def test_columns_of_states_in_another_order_and_number():
    trials = [np.c_[x, x[:, 0] * x[:, 1]] for x in TRIALS]
    pairs = trajectory_pairs(trials, lag=4)
    for columns in ([0, 2], [1, 0], [2]):
        with pytest.raises(ValueError, match="row 0 is the state of row 4, but"):
            KernelEDMD(**LINEAR).fit(pairs.X, pairs.y[:, columns])


@pytest.mark.parametrize("kind", ["identical", "periodic", "rounded", "at rest"])
def test_ends_of_trials_whose_values_repeat(kind):
    trials = [hertz(1.0, n=130)] * 2
    if kind == "periodic":
        angles = np.arange(130) * np.pi / 25 + [[0], [1]]
        trials = [np.c_[np.cos(angle), np.sin(angle)] for angle in angles]
    if kind == "rounded":
        trials = [x.round(2) for x in TRIALS]
    if kind == "at rest":
        trials = [np.vstack([x[:1].repeat(60, axis=0), x]) for x in TRIALS]
    n = len(trials[0]) - 1
    pairs = trajectory_pairs(trials)
    pipeline = make_pipeline(StandardScaler(), KernelEDMD(**LINEAR))
    for model in (pipeline, KernelEDMD(**LINEAR)):
        with pytest.raises(ValueError, match=f"row {n - 1} is not that of row {n}, b"):
            model.fit(pairs.X, pairs.y)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("scaled", [False, True])
def test_delays_newest_or_oldest_first_show_the_ends(order, scaled):
    pairs = trajectory_pairs(TRIALS, delays=4, delay_step=2)
    X = pairs.X.reshape(-1, 4, 2)[:, ::order].reshape(-1, 8)
    model = KernelEDMD(**LINEAR)
    if scaled:
        model = make_pipeline(StandardScaler(), model)
    with pytest.raises(ValueError, match="row 393 does not: a recording ends"):
        model.fit(X)
    model.fit(X[:393])


def test_blocks_left_out_of_arrays_need_their_numbers():
    """Of a motion whose blocks are whole periods in one column."""
    x = np.c_[hertz(1.0, 601), np.sin(2 * np.pi * 0.01 * np.arange(601))]
    number = np.arange(600)
    for train, _ in TrajectoryKFold(4).split(x[:-1]):
        whole = (np.diff(train) == 1).all()
        model = KernelEDMD(**LINEAR)
        if whole:
            model.fit(x[:-1][train], x[1:][train])
            continue
        with pytest.raises(ValueError, match=r"sample_index=range\(n\) of all"):
            model.fit(x[:-1][train], x[1:][train])
        model.fit(x[:-1][train], x[1:][train], sample_index=number[train])
    scores = cross_val_score(
        KernelEDMD(**LINEAR), x[:-1], x[1:], cv=TrajectoryKFold(4), error_score="raise",
        params={"sample_index": number},
    )  # fmt: skip
    assert scores.min() > 0.99


def test_a_sine_is_no_later_cosine():
    """A quarter of a period makes one of the other, up to sign."""
    angle = np.arange(300) * 2 * np.pi / 100
    cosine = np.cos(angle)[:, None]
    for y in (np.sin(angle), -np.sin(angle), -np.cos(angle)):
        for scale in (1.0, 7.0):
            KernelEDMD(**LINEAR).fit(scale * cosine[:-1], y[1:])


@pytest.mark.parametrize("deform", [
    lambda x: x.round(1), lambda x: np.clip(x, -0.5, 0.7), np.float32, np.sign,
    lambda x: np.vstack([x, x[-1:].repeat(200, axis=0)]), lambda x: 1000 + x,
    lambda x: np.c_[x, np.arange(len(x))], lambda x: np.c_[x > 0, x[:, 0]],
])  # fmt: skip
def test_deformed_single_trials_are_trusted(deform):
    """By the order, as by the numbers of the rows."""
    model = KernelEDMD(**LINEAR | {"centers": None, "kernel": "gaussian"})
    for f in (1.0, 1.37):
        x = np.asarray(deform(hertz(f, 150)), dtype=float)
        pairs = trajectory_pairs(x, delays=2)
        for y in (pairs.y, pairs.y[:, 0] ** 2, np.float32(pairs.y)):
            for X in (pairs.X, StandardScaler().fit_transform(pairs.X)):
                find = find_contradiction(y.reshape(len(X), -1), X, np.arange(len(X)))
                assert find is None
                assert find_break(X) is None
    model.fit(pairs.X, pairs.y)


# Labels as a clock


LABELS = {
    "frames": (lambda k: 3 * k + 7, True),
    "seconds": (lambda k: 0.01 * k, True),
    "seconds, rounded": (lambda k: np.round(k / 400, 3), True),
    "dates": (lambda k: pd.to_datetime(10 * k, unit="ms", utc=True), True),
    "durations": (lambda k: pd.to_timedelta(10 * k, unit="ms"), True),
    "names": (lambda k: [f"frame {i}" for i in k], False),
}


@pytest.mark.parametrize(("label", "tell"), LABELS.values(), ids=LABELS)
@pytest.mark.parametrize("of", ["X", "y"])
def test_holes_in_the_labels_are_no_steps(label, tell, of):
    """As after dropna: rows 20 to 24 and 50 are gone."""
    x = make_pendulum(80).trajectories[0]
    k = np.delete(np.arange(80), [20, 21, 22, 23, 24, 50])
    frame = pd.DataFrame(x[k], index=label(k))
    y = np.sin(x[k, 1])
    given = (frame, y) if of == "X" else (x[k], pd.Series(y, index=label(k)))
    rows = links(KernelEDMD(n_modes=0).fit(*given), len(k))
    expected = np.isin(k + 1, k) if tell else np.arange(len(k)) < len(k) - 1
    np.testing.assert_array_equal(rows, expected)
    # Labels tell of rows in any order.
    order = np.random.default_rng(0).permutation(len(k))
    if tell and of == "X":
        shuffled = links(KernelEDMD(n_modes=0).fit(frame.iloc[order]), len(k))
        np.testing.assert_array_equal(shuffled, expected[order])


@pytest.mark.parametrize("fraction", [0.05, 0.1, 0.5])
def test_steps_of_a_sample_are_not_the_usual_one(fraction):
    """Of rows drawn at random, only those that were neighbours follow each other."""
    x = pd.DataFrame(np.cumsum(np.random.default_rng(0).normal(size=(3000, 2)), axis=0))
    few = x.sample(frac=fraction, random_state=1)
    model = KernelEDMD(n_modes=0, alpha=1e-3).fit(few)
    follows = np.isin(few.index + 1, few.index)
    assert 0 < follows.sum() < len(few) - 1
    np.testing.assert_array_equal(links(model, len(few)), follows)


def test_whole_milliseconds_are_no_frames():
    x = pd.DataFrame(make_pendulum(79).trajectories[0])
    stamped = x.set_axis(np.rint(np.arange(80) * 1000 / 150).astype(int))
    message = r"the rows steps by 6 to 7, .*whole milliseconds .*index / 1000\)"
    with pytest.raises(ValueError, match=message):
        KernelEDMD(n_modes=0).fit(stamped)
    model = KernelEDMD(n_modes=0).fit(stamped.set_axis(stamped.index / 1000))
    assert links(model, 80).sum() == 79


def test_irregular_stamps_and_missing_labels_are_refused():
    x = pd.DataFrame(make_pendulum(39).trajectories[0])
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 40))
    with pytest.raises(ValueError, match=r"rows are irregular.*resample=.*sample_i"):
        KernelEDMD().fit(x.set_axis(stamps))
    for labels in ([np.nan, *range(39)], pd.to_datetime([None, *range(39)])):
        with pytest.raises(
            ValueError, match=r"rows has no label in row 0 \((nan|NaT)\)"
        ):
            KernelEDMD().fit(x.set_axis(pd.Index(labels)))


def test_a_block_left_out_is_a_hole():
    x = make_pendulum(100).trajectories[0]
    X, y = pd.DataFrame(x[:-1]), pd.DataFrame(x[1:])
    for train, _ in TrajectoryKFold(4).split(X):
        model = KernelEDMD(n_modes=0).fit(X.iloc[train], y.iloc[train])
        np.testing.assert_array_equal(
            links(model, len(train)), np.isin(train + 1, train)
        )


@pytest.mark.parametrize("kind", ["repeated", "names", "levels"])
def test_labels_of_several_recordings_are_refused(swings, kind):
    one, two = (pd.DataFrame(x) for x in swings[:2])
    joined = pd.concat([one, two])
    message = "has the label 0 in rows 0 and 61"
    if kind == "names":
        joined = joined.set_axis(np.repeat(["s1", "s2"], 61))
        message = "holds 2 recordings"
    if kind == "levels":
        joined = pd.concat([one, two], keys=["a", "b"], names=["trial", "frame"])
        message = "holds 2 recordings"
    remedy = "trajectory_pairs as a list of data frames.*=pairs.sample_index"
    with pytest.raises(ValueError, match=f"{message}.*{remedy}"):
        KernelEDMD(n_modes=0).fit(joined)
    with pytest.raises(ValueError, match=message):
        KernelEDMD(n_modes=0).fit(joined.to_numpy(), joined)
    index = 100 * (np.arange(len(joined)) // 61) + np.arange(len(joined))
    KernelEDMD(n_modes=0).fit(joined, sample_index=index)


# No false alarms


def single(x):
    return x[:-1].astype(np.float32).astype(np.float64), x[1:]


rng = np.random.default_rng(0)
walk = np.cumsum(rng.standard_normal((90, 3)), axis=0)
rest = np.vstack([np.zeros((30, 2)), make_pendulum(60).trajectories[0]])
turn = np.exp(2j * np.pi * np.arange(61) / 20)
turn = np.column_stack([turn.real, turn.imag])
rotation = np.linalg.lstsq(turn[:-1], turn[1:], rcond=None)[0]
TRUSTED = {
    "one trial": (walk[:-1], walk[1:]),
    "one output of it": (walk[:-1], walk[1:, 1]),
    "a constant column": (np.c_[np.ones(89), walk[:-1]], np.ones(89)),
    "at rest": (rest[:-1], rest[1:]),
    "a period of whole rows": (turn[:-1], turn[1:]),
    "a period, computed anew": (turn[:-1], turn[:-1] @ rotation),
    "rounded to single precision": single(walk),
    "rounded to a tenth": (walk[:-1].round(1), walk[1:].round(1)),
    "a contact": (np.c_[walk[:, 0], walk > 0], 1.0 * (walk[:, 1] > -1)),
    "the value of one state": (walk[:-1], np.full(89, walk[40, 1])),
    "outputs that are no states": (walk[:-1], np.sin(walk[1:, 0])),
    "outputs of its own row": (walk, walk[:, 0]),
    "more outputs than features": (walk[:-1], np.hstack([walk, walk])[1:]),
    "delays of one trial": (trajectory_pairs(walk, delays=3, delay_step=4).X, None),
    "one pair": (walk[:2], None),
}  # fmt: skip


@pytest.mark.parametrize(("X", "y"), TRUSTED.values(), ids=TRUSTED)
def test_rows_that_nothing_contradicts_are_trusted(X, y):
    settings = {"method": "least_squares", "alpha": 1e-3, "n_modes": 0}
    centers = np.unique(X, axis=0)[::4]
    model = KernelEDMD(centers=centers, **settings).fit(X, y)
    clock = clone(model).fit(X, y, sample_index=range(len(X)))
    np.testing.assert_array_equal(model.koopman_matrix_, clock.koopman_matrix_)
    single = np.asarray(X, dtype=np.float32)
    KernelEDMD(centers=centers, **settings).fit(single, y)
    scaled = KernelEDMD(centers=SeparatedCenterSelector(0.5), **settings)
    make_pipeline(StandardScaler(), scaled).fit(X, y)


@pytest.mark.parametrize("turn", [360, 2 * np.pi])
@pytest.mark.parametrize("frame", [False, True])
def test_angles_of_a_recording_that_wrap_warn(turn, frame):
    angle = np.cumsum(0.3 + 0.05 * np.sin(np.arange(120.0))) * turn / (2 * np.pi)
    x = np.column_stack([np.sin(np.arange(120) / 9), angle % turn])
    X = pd.DataFrame(x, columns=["a", "crank"]) if frame else x
    column, period = "crank" if frame else "1", "360" if turn == 360 else r"2 \* np.pi"
    with pytest.warns(UserWarning, match=rf"in column {column}: .* period={period}\)"):
        KernelEDMD(n_modes=0, alpha=1e-3).fit(X)
    # With a clock, as of trajectory_pairs, the angles have been looked at before.
    KernelEDMD(n_modes=0, alpha=1e-3).fit(X, sample_index=range(120))
    KernelEDMD(n_modes=0, alpha=1e-3).fit(unwrap_angles(x, period=turn))


# Pipelines and cross-validation, without metadata routing


def test_index_of_the_outputs_serves_behind_a_scaler(swings):
    pairs = trajectory_pairs(swings)
    X, y = indexed(pairs.X, pairs), indexed(np.sin(pairs.X_next[:, :1]), pairs)
    pipeline = make_pipeline(StandardScaler(), KernelEDMD(trend="linear", n_modes=9))
    wanted = clone(pipeline).fit(
        pairs.X, y.to_numpy(), kerneledmd__sample_index=pairs.sample_index
    )
    for given in ((X, y), (pairs.X, y), (X, y[0])):
        found = clone(pipeline).fit(*given)[-1].eigenvalues_
        np.testing.assert_allclose(found, wanted[-1].eigenvalues_, atol=1e-9)
    kept = (
        clone(pipeline)
        .set_output(transform="pandas")
        .fit(X.set_axis(["a", "b"], axis=1))
    )
    np.testing.assert_allclose(
        kept[-1].eigenvalues_, wanted[-1].eigenvalues_, atol=1e-9
    )


def test_searches_need_no_routing_for_frames(swings):
    """Every fold of the training rows is linked as its rows of the clock are."""
    pairs = trajectory_pairs(swings, lag=2)
    X, y = indexed(pairs.X, pairs), indexed(pairs.y, pairs)
    seen = []

    class Recorded(KernelEDMD):
        def fit(self, X, y=None, *, X_next=None, sample_index=None):
            super().fit(X, y, X_next=X_next, sample_index=sample_index)
            seen.append(self.center_indices_)
            return self

    pipeline = make_pipeline(StandardScaler(), Recorded(alpha=1e-6, n_modes=0))
    search = GridSearchCV(
        pipeline,
        {"recorded__beta": [0.5, 5.0]},
        cv=TrajectoryKFold(5),
        refit=False,
        error_score="raise",
    ).fit(X, y, groups=pairs.groups)
    assert search.cv_results_["split0_test_score"].max() > 0.9
    folds = list(TrajectoryKFold(5).split(X, groups=pairs.groups))
    for number, rows in enumerate(seen):
        train = pairs.sample_index[folds[number % 5][0]]
        np.testing.assert_array_equal(rows, np.flatnonzero(np.isin(train + 1, train)))
    assert len(seen) == 10
