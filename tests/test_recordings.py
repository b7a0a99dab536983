"""Recordings as they are: gaps, clocks, rates, wraps, frames and the past."""

import warnings
from math import factorial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.linear_model import LinearRegression

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
    current_states,
    trajectory_pairs,
)
from sklearn_koopman._utils._embedding import embed
from sklearn_koopman._utils._frames import index_level
from sklearn_koopman._utils._validation import refuse_masked
from sklearn_koopman._utils._wraps import find_wraps
from sklearn_koopman.datasets import make_pendulum, make_walking
from sklearn_koopman.diagnostics import calibration_study
from sklearn_koopman.kinematics import fill_gaps, unwrap_angles

NAMES = ["X", "y", "X_next", "groups", "sample_index", "time", "frame"]


def counted(n_samples, trial=0, n_features=1):
    """Samples that tell their trial and their frame: 1000 trial + frame."""
    numbers = 1000.0 * trial + np.arange(n_samples)
    return np.repeat(numbers[:, None], n_features, axis=1)


def with_nan(x, frames):
    x = x.copy()
    x[frames] = np.nan
    return x


def assert_same_pairs(pairs, expected, names=NAMES):
    for name in names:
        assert_array_equal(pairs[name], expected[name], err_msg=name)


# --- what other parts call ----------------------------------------------------------


def test_masked_values_are_refused_and_counted():
    masked = np.ma.masked_greater(np.arange(6.0).reshape(3, 2), 3)
    with pytest.raises(ValueError, match=r"^X holds 2 masked values; .*split"):
        refuse_masked(X=masked)
    with pytest.raises(ValueError, match=r"^y holds 2 masked"):
        refuse_masked(X=np.ones(3), y=list(masked))
    with pytest.raises(ValueError, match=r"^X_next holds 1 masked"):
        refuse_masked(X_next=np.ma.array([1, 2], mask=[True, False]), y=None)
    refuse_masked(X=np.ma.array([1.0, 2]), y=[[1.0], [2.0]], sample_index=None)


def test_levels_of_an_index():
    index = pd.MultiIndex.from_tuples(
        [(7, 3), (7, 4), (9, 8)], names=["trial", "sample_index"]
    )
    frame = pd.DataFrame({"hip": [1.0, 2, 3]}, index=index)
    assert_array_equal(index_level("trial", frame), [7, 7, 9])
    other = [[1.0], [2.0], [3.0]], np.ones(3), None, pd.Series([1.0, 2, 3])
    assert_array_equal(index_level("sample_index", *other, frame["hip"]), [3, 4, 8])
    assert_array_equal(index_level("sample_index", frame.loc[7]), [3, 4])
    assert index_level("frame", frame, *other) is None
    first = frame.set_axis(index.set_levels([5, 6], level=0))
    with pytest.raises(ValueError, match=r"differ in the level 'trial'.*y\.loc\[X"):
        index_level("trial", first, frame)
    with pytest.raises(ValueError, match=r"'trial' is a column.*set_index"):
        index_level("trial", frame.reset_index())


# --- arrays with three axes, masked arrays ------------------------------------------


def test_each_remedy_for_three_axes_makes_two():
    rng = np.random.default_rng(0)
    markers = rng.normal(size=(20, 5, 3))
    points = np.concatenate([markers.transpose(2, 1, 0), np.ones((1, 5, 20))])
    assert points.shape == (4, 5, 20)  # as a c3d reader gives it
    for array in (markers, points, np.ma.array(markers)):
        for form in (array, [array]):
            with pytest.raises(ValueError, match=r"^trajectories.*list\(array\)") as e:
                trajectory_pairs(form)
            remedy = "points[:3].transpose(2, 1, 0).reshape(20, -1)"
            if array is not points:
                remedy = "array.reshape(20, -1)"
            assert remedy in str(e.value)
    with pytest.raises(ValueError, match=r"^outputs.*axes"):
        trajectory_pairs(markers[:, 0], markers)
    n_frames = 20
    flat = trajectory_pairs(markers.reshape(len(markers), -1))
    assert_same_pairs(
        trajectory_pairs(points[:3].transpose(2, 1, 0).reshape(n_frames, -1)), flat
    )
    assert flat.X.shape == (19, 15)
    assert set(trajectory_pairs(list(markers)).groups) == set(range(20))


def masked_forms(x, mask):
    """The same recording with masked values, in every form."""
    poisoned = np.where(mask, 9000, x)
    masked = np.ma.array(poisoned, mask=mask)
    rows = [
        [np.ma.masked if m else v for v, m in zip(*r, strict=False)]
        for r in zip(x, mask, strict=False)
    ]
    objects = np.array(rows, dtype=object)
    yield masked
    yield masked.astype(int)
    yield masked.astype(object)
    yield masked.astype(np.float32)
    yield objects
    yield rows
    yield list(masked)  # of masked rows
    yield np.where(mask, None, x)


def test_masked_values_are_gaps():
    x = counted(12, n_features=2)
    mask = np.zeros(x.shape, dtype=bool)
    mask[4, 1] = mask[8] = True
    expected = trajectory_pairs(with_nan(x, [4, 8]), gaps="split")
    assert_array_equal(expected.X[:, 0], [0, 1, 2, 5, 6, 9, 10])
    for form in masked_forms(x, mask):
        assert_same_pairs(trajectory_pairs([form], gaps="split"), expected)
        outputs = trajectory_pairs([x], [form], gaps="split")
        assert_same_pairs(outputs, expected)
        with pytest.raises(ValueError, match=r"trajectories\[0\] holds .*2 of 12"):
            trajectory_pairs([form])
    scalar = np.ma.array(x[:, 0], mask=mask[:, 1])
    single = trajectory_pairs(x, scalar, gaps="split")
    assert_array_equal(single.y, expected.y[:, 0])
    with pytest.raises(ValueError, match=r"outputs\[0\] holds masked values in 2 of"):
        trajectory_pairs(x, scalar)
    ragged = np.empty(2, dtype=object)
    ragged[:] = [np.ma.array(x, mask=mask), x[:5]]
    both = trajectory_pairs(ragged, gaps="split")
    assert_array_equal(both.X[both.groups == 0], expected.X)
    nothing_masked = trajectory_pairs(np.ma.array(x))
    assert_same_pairs(nothing_masked, trajectory_pairs(x))


# --- gaps ---------------------------------------------------------------------------

offsets_lists = st.lists(st.integers(1, 4), max_size=3).map(
    lambda steps: tuple(np.cumsum([0, *steps]).tolist())
)


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(
    there=st.lists(st.lists(st.booleans(), min_size=1, max_size=40), min_size=1),
    lag=st.integers(1, 4),
    delays=offsets_lists,
    kind=st.sampled_from(["nan", "masked", "outputs", "index"]),
)
def test_no_pair_reaches_across_a_gap(there, lag, delays, kind):
    there = [np.array(flags) for flags in there]
    reach = delays[-1]

    def windows(flags):
        rows = range(reach, len(flags) - lag)
        return [k for k in rows if flags[k - reach : k + lag + 1].all()]

    expected = [(i, k) for i, flags in enumerate(there) for k in windows(flags)]
    states, outputs = [], None
    for i, flags in enumerate(there):
        x = counted(len(flags), i, n_features=2)
        if kind == "nan":
            x[~flags, i % 2] = np.nan
        elif kind == "masked":
            x[~flags, 1] = 9e9
            x = np.ma.array(x, mask=np.column_stack([flags, flags]) < 1)
        elif kind == "index":
            x = pd.DataFrame(x)[flags]
        states.append(x)
    if kind == "outputs":
        outputs = [
            np.where(flags, x[:, 0], np.nan)
            for flags, x in zip(there, states, strict=True)
        ]
    options = {"lag": lag, "delays": delays, "gaps": "split"}
    is_left = [bool(windows(flags)) for flags in there]
    if kind == "index":
        # The clock of frames is that of all recordings: one without gaps sets it.
        states.append(pd.DataFrame(counted(50, len(there), 2)))
        is_left.append(True)
        expected += [(len(there), k) for k in windows(np.ones(50, dtype=bool))]
        if any(not flags.any() for flags in there):
            return
    if not all(is_left):
        with pytest.raises(ValueError, match=f"^trajectory {is_left.index(False)} "):
            trajectory_pairs(states, outputs, **options)
        return
    pairs = trajectory_pairs(states, outputs, **options)
    X, X_next, y = (np.asarray(pairs[name]) for name in ("X", "X_next", "y"))
    trial, frame = np.array(expected).T
    assert_array_equal(X[:, 0], 1000 * trial + frame)
    assert_array_equal(pairs.groups, trial)
    assert_array_equal(pairs.frame, frame)
    ages = np.repeat(delays, 2)
    assert_array_equal(X[:, :1] - X, np.broadcast_to(ages, X.shape))
    assert_array_equal(X_next - X, np.full(X.shape, lag))
    assert_array_equal(y.reshape(len(y), -1)[:, 0] - X[:, 0], lag)
    # Row j follows row i, by the clock, exactly if it does within one piece.
    clock = pairs.sample_index
    assert len(set(clock)) == len(clock)
    follows = clock == clock[:, None] + 1
    allowed = (trial == trial[:, None]) & (frame == frame[:, None] + lag)
    full = {(i, k) for i, k in expected}
    flags = [*there, np.ones(50, dtype=bool)]
    for i, j in np.argwhere(allowed):
        stretch = flags[trial[i]][frame[i] - reach : frame[j] + lag + 1]
        allowed[i, j] = stretch.all() and (trial[j], frame[j]) in full
    assert_array_equal(follows, allowed)


def test_gaps_raise_unless_they_split():
    x = counted(9, n_features=2)
    x[4, 1] = np.nan
    with pytest.raises(ValueError, match=r"1 of 9.*sample 4.*fill_gaps.*gaps='split'"):
        trajectory_pairs(x)
    message = r"^trajectory 1 has 4 samples in its longest piece between gaps.*need 5;"
    with pytest.raises(ValueError, match=message):
        trajectory_pairs([counted(5, 1, 2), x], gaps="split", lag=2, delays=3)
    with pytest.raises(ValueError, match=r"^trajectory 0 has 0 samples in its longest"):
        trajectory_pairs(np.full((5, 1), np.nan), gaps="split")
    with pytest.raises(ValueError, match=r"^gaps must be one of 'raise', 'split', got"):
        trajectory_pairs(x, gaps="skip")
    with pytest.raises(ValueError, match=r"trajectories\[0\].*infinity"):
        trajectory_pairs(np.where(np.isnan(x), np.inf, x), gaps="split")


# --- clocks -------------------------------------------------------------------------


def test_rows_dropped_from_a_frame_are_holes():
    x = counted(30, n_features=2)
    x[[5, 6, 17], 0] = np.nan
    frame = pd.DataFrame(x, columns=["hip", "knee"])
    dropped = frame.dropna()
    with pytest.raises(ValueError, match=r"2 places, first from 4 to 7; .*'split'"):
        trajectory_pairs(dropped)
    split = trajectory_pairs(dropped, gaps="split")
    assert_array_equal(split.y - split.X, 1)
    assert len(split.X) == 24
    expected = trajectory_pairs(frame, gaps="split")
    assert_same_pairs(split, expected)
    # Frames that begin anywhere, at any constant step.
    moved = frame.set_axis(range(100, 190, 3)).dropna()
    split = trajectory_pairs(moved, gaps="split", rates=10)
    assert_array_equal(split.X, expected.X)
    assert_array_equal(split.frame, 100 + 3 * expected.frame)
    assert_allclose(split.time, expected.frame / 10)
    assert_array_equal(moved.loc[split.frame], split.X)
    # A step that is no multiple of the usual one is a hole, too.
    uneven = pd.DataFrame(counted(6), index=[0, 2, 4, 7, 9, 11])
    assert_array_equal(trajectory_pairs(uneven, gaps="split").frame, [0, 2, 7, 9])
    # Every second frame is half of the rate.
    halves = [frame.fillna(0.0), frame.fillna(0.0)[::2]]
    with pytest.raises(ValueError, match=r"trajectory 1 has a hole in 14 places"):
        trajectory_pairs(halves)
    assert len(trajectory_pairs(halves[1]).X) == 14
    resampled = trajectory_pairs(halves, rates=[100, 50], resample=50)
    assert_array_equal(np.bincount(resampled.groups), [14, 14])


def stamped(stamps, as_index=pd.Index):
    return pd.DataFrame(counted(len(stamps)), index=as_index(stamps))


def seconds(stamps):
    return pd.to_timedelta(np.round(np.asarray(stamps) * 1e9).astype("i8"), unit="ns")


@pytest.mark.parametrize(
    ("as_index", "start"),
    [
        (pd.Index, 3.0),
        (seconds, 3.0),
        (lambda s: pd.Timestamp("2026-11-29", tz="UTC") + seconds(s), 0.0),
        (lambda s: pd.Timestamp("2026-11-29") + seconds(s), 0.0),
    ],
)
def test_time_stamps_are_a_clock(as_index, start):
    frame = stamped(3.0 + np.arange(40) / 200, as_index).drop(
        index=as_index(3.0 + np.arange(40) / 200)[[9, 20, 21]]
    )
    with pytest.raises(ValueError, match=r"a hole in 2 places"):
        trajectory_pairs(frame)
    pairs = trajectory_pairs(frame, gaps="split")
    assert_array_equal(pairs.y - pairs.X, 1)
    assert_allclose(pairs.time, start + pairs.X.to_numpy()[:, 0] / 200, atol=1e-9)
    assert_array_equal(frame.iloc[pairs.frame], pairs.X)
    resampled = trajectory_pairs(frame, gaps="split", resample=400)
    assert_allclose(resampled.y - resampled.X, 0.5, atol=1e-8)


def test_time_stamps_may_jitter_but_not_wander():
    rounded = stamped(np.round(np.arange(500) / 240, 3))  # steps of 4 and 5 ms
    pairs = trajectory_pairs(rounded)
    assert_array_equal(pairs.y - pairs.X, 1)
    assert_array_equal(trajectory_pairs(rounded, rates=240).X, pairs.X)
    wandering = stamped(np.cumsum([1, 1, 1, 1.4, 1, 1]))
    with pytest.raises(ValueError, match=r"irregular: from row 2 to 3.* resample="):
        trajectory_pairs(wandering)
    grid = trajectory_pairs(wandering, resample=1.0)
    # Interpolated at 1, 2, ..., and linear up to row 2.
    assert_allclose(grid.time, np.arange(1, 6))


HOLEY = np.delete(np.arange(30), [10, 11, 20])
CLOCKS = {
    "objects": lambda k: pd.Index(list(k), dtype=object),
    "stamps as objects": lambda k: pd.Index(
        list(pd.Timestamp("2026-11-29", tz="UTC") + pd.to_timedelta(k / 100, unit="s")),
        dtype=object,
    ),
    # Across the hour that a clock in Berlin shows twice.
    "time zone": lambda k: (
        pd.Timestamp("2026-10-25 00:59:59.8", tz="UTC")
        + pd.to_timedelta(k / 100, unit="s")
    ).tz_convert("Europe/Berlin"),
    "periods": lambda k: pd.period_range("2026-11-29", periods=30, freq="s")[k],
    "nullable": lambda k: pd.Index(pd.array(k, dtype="Int64")),
    "numbers": lambda k: pd.Index(k),
    "seconds": lambda k: pd.Index(k / 100),
}


@pytest.mark.parametrize("as_index", CLOCKS.values(), ids=CLOCKS)
def test_every_reader_sees_the_holes(as_index):
    x = np.random.default_rng(0).normal(size=(30, 1)).cumsum(axis=0)
    frame = pd.DataFrame(x[HOLEY], index=as_index(HOLEY))
    with pytest.raises(ValueError, match="trajectory 0 has a hole in 2 places"):
        trajectory_pairs(frame)
    pairs = trajectory_pairs(frame, gaps="split")
    follows = np.isin(HOLEY + 1, HOLEY)
    assert_array_equal(pairs.X.to_numpy(), x[HOLEY[follows]])
    model = KernelEDMD(n_modes=0).fit(frame)
    assert_array_equal(model.center_indices_, np.flatnonzero(follows))
    with pytest.raises(
        ValueError, match=r"recording goes from .* by recording\.reindex"
    ):
        fill_gaps(frame, max_gap=3)
    whole = pd.DataFrame(x, index=as_index(np.arange(30)))
    assert len(trajectory_pairs(whole).X) == 29
    whole.iloc[4] = np.nan
    assert_array_equal(fill_gaps(whole, max_gap=3)[1], [4])
    [(_, test), _] = TrajectoryKFold(2).split(frame)
    assert_array_equal(test, range(14))


@pytest.mark.parametrize("missing", [pd.NaT, np.nan])
def test_a_missing_label_is_named(missing):
    labels = pd.to_datetime([*range(19), None]) if missing is pd.NaT else None
    labels = pd.Index([*range(19), np.nan]) if labels is None else labels
    frame = stamped(labels)
    for read in (
        trajectory_pairs,
        KernelEDMD().fit,
        lambda x: fill_gaps(x, max_gap=1),
        lambda x: next(TrajectoryKFold(2).split(x)),
    ):
        with pytest.raises(
            ValueError, match=r"has no label in row 19 \((nan|NaT)\); d"
        ):
            read(frame)


def test_names_that_repeat_are_recordings():
    x = counted(30)
    names = pd.Index(["s1"] * 15 + ["s2"] * 15)
    for index in (names, pd.CategoricalIndex(names), names.astype(object)):
        frame = pd.DataFrame(x, index=index)
        with pytest.raises(
            ValueError, match=r"0 holds 2 recordings; .*groupby\(level=0"
        ):
            trajectory_pairs(frame)
        with pytest.raises(ValueError, match=r"rows holds 2 recordings.*sample_index="):
            KernelEDMD().fit(frame)
        with pytest.raises(
            ValueError, match=r"holds 2 recordings; pass them one by one"
        ):
            fill_gaps(frame, max_gap=1)
        with pytest.raises(
            ValueError, match=r"^the index restarts or repeats.*groups="
        ):
            next(TrajectoryKFold(2).split(frame))
        parts = [part for _, part in frame.groupby(level=0, observed=True)]
        assert_array_equal(np.bincount(trajectory_pairs(parts).groups), [14, 14])
    one = pd.DataFrame(x, index=["s1"] * 30)
    assert len(trajectory_pairs(one).X) == 29


def test_trials_of_several_calls_are_different():
    parts = [trajectory_pairs([pd.DataFrame(counted(9, k)) for k in p]) for p in
             ([0, 1], [2, 3])]  # fmt: skip
    joined = pd.concat([part.X for part in parts], keys=["a", "b"])
    folds = list(TrajectoryKFold(4).split(joined))
    seen = [np.unique(joined.iloc[test, 0] // 1000).tolist() for _, test in folds]
    assert sorted(seen) == [[0], [1], [2], [3]]
    # Further levels inside the trial do not divide it.
    other = joined.set_axis(joined.index.set_names([None, "trial", "frame"]))
    assert len(list(TrajectoryKFold(4).split(other))) == 4


def test_milliseconds_are_told_from_frames():
    for rate in (120, 150, 240, 400):
        stamps = np.rint(np.arange(600) * 1000 / rate).astype(int)
        frame = pd.DataFrame(counted(600), index=stamps)
        for gaps in ("raise", "split"):
            with pytest.raises(ValueError, match=r"whole milliseconds.*index / 1000\)"):
                trajectory_pairs(frame, gaps=gaps)
        with pytest.raises(ValueError, match=r"recording steps by .*index / 1000\)"):
            fill_gaps(frame, max_gap=1)
        pairs = trajectory_pairs(frame.set_axis(frame.index / 1000))
        assert_array_equal(pairs.y - pairs.X, 1)
    micro = pd.DataFrame(
        counted(600), index=np.rint(np.arange(600) * 1e6 / 150).astype(int)
    )
    with pytest.raises(ValueError, match=r"by 6666 to 6667, .*microseconds.*1000000\)"):
        trajectory_pairs(micro)


def test_remedies_for_two_indices_and_for_frames_as_floats():
    x, y = pd.DataFrame(counted(9)), pd.DataFrame(counted(9), index=range(1, 10))
    with pytest.raises(
        ValueError, match=r"by outputs.set_axis\(states.index\) if their"
    ):
        trajectory_pairs(x, y)
    assert len(trajectory_pairs(x, y.set_axis(x.index)).X) == 8
    floats = x.set_axis(np.arange(9.0))
    message = r"0 100 Hz, but its index, .* has 1 Hz; .*data.index.astype\(int\)"
    with pytest.raises(ValueError, match=message):
        trajectory_pairs(floats, rates=100)
    pairs = trajectory_pairs(floats.set_axis(floats.index.astype(int)), rates=100)
    assert_allclose(pairs.time, np.arange(8) / 100)


def test_an_index_without_order_is_no_clock():
    x = counted(10)
    two = pd.concat([pd.DataFrame(x[:6]), pd.DataFrame(x[:4])])
    with pytest.raises(ValueError, match=r"row 5 to 6 \(5 to 0\); .*groupby"):
        trajectory_pairs(two)
    with pytest.raises(ValueError, match=r"trajectory 1 does not increase from row 2"):
        trajectory_pairs([pd.DataFrame(x), stamped([0.0, 1, 2, 2, 3])])
    with pytest.raises(ValueError, match=r"no label in row 2 \(nan\); drop that row"):
        trajectory_pairs(stamped([0.0, 1, np.nan, 3]))
    for labels in (list("abcdefghij"), [True, False] * 5):
        named = pd.DataFrame(x, index=labels)
        assert_same_pairs(trajectory_pairs(named), trajectory_pairs(x))
    keys = pd.MultiIndex.from_arrays([[1] * 6 + [2] * 4, [*range(6), *range(4)]])
    several = pd.DataFrame(x, index=keys)
    with pytest.raises(ValueError, match=r"2 recordings; .*groupby\(level=0\)"):
        trajectory_pairs(several)
    pairs = trajectory_pairs([part for _, part in several.groupby(level=0)])
    assert_same_pairs(pairs, trajectory_pairs([x[:6], x[6:]]))
    holes = several.loc[[1]].drop(index=(1, 2))
    assert len(trajectory_pairs(holes, gaps="split").X) == 3


def test_states_and_outputs_share_their_index():
    x = pd.DataFrame(counted(10))
    moved = pd.Series(np.arange(10.0), index=range(1, 11))
    with pytest.raises(ValueError, match=r"outputs of trajectory 0 have different ind"):
        trajectory_pairs(x, moved)
    # An array has no index, and takes that of the other.
    for pairs in (
        trajectory_pairs(x.to_numpy()[1:], moved.drop(3), gaps="split"),
        trajectory_pairs(x.drop(2)[:9], np.arange(9.0), gaps="split"),
    ):
        assert len(pairs.X) == 7


# --- rates --------------------------------------------------------------------------


def circle(rate, phase=0.0, duration=4.0):
    angle = 2 * np.pi * np.arange(int(duration * rate) + 1) / rate + phase
    return np.column_stack([np.sin(angle), np.cos(angle)])


def found_frequency(pairs, rate):
    """The frequency of the slowest oscillation that KernelEDMD finds."""
    model = KernelEDMD(
        beta=3.0,
        method="least_squares",
        centers=SeparatedCenterSelector(0.3),
        alpha=1e-6,
    )
    model.fit(pairs.X, X_next=pairs.X_next, sample_index=pairs.sample_index)
    frequencies = np.angle(model.eigenvalues_) * rate / (2 * np.pi)
    best = np.argsort(model.residuals_)[:3]
    return frequencies[best].max()


@pytest.mark.parametrize("rate", [100, 150, 200])
def test_trials_of_two_rates_have_one_frequency(rate):
    trials = [circle(100), circle(200, phase=1.0)]
    assert abs(found_frequency(trajectory_pairs(trials), 100) - 0.667) < 0.01
    with pytest.raises(ValueError, match=r"from 100 to 200 Hz.*resample=100"):
        trajectory_pairs(trials, rates=[100, 200])
    pairs = trajectory_pairs(trials, rates=[100, 200], resample=rate)
    assert_array_equal(np.bincount(pairs.groups), [4 * rate, 4 * rate])
    assert abs(found_frequency(pairs, rate) - 1) < 1e-4


def test_rates_must_agree():
    frames = [stamped(np.arange(20) / rate) for rate in (100, 200)]
    with pytest.raises(ValueError, match=r"from 100 to 200 Hz.*resample=100"):
        trajectory_pairs(frames)
    with pytest.raises(
        ValueError, match=r"^rates gives trajectory 1 100 Hz, but.* 200"
    ):
        trajectory_pairs(frames, rates=100)
    with pytest.raises(ValueError, match=r"^rates gives trajectory 0 90 Hz"):
        trajectory_pairs(frames, rates=[90, 200], resample=100)
    with pytest.raises(ValueError, match=r"^rates=.*holds 3 rates for 2 trajectories"):
        trajectory_pairs(frames, rates=[100, 200, 100])
    for wrong in (0, -1.0, np.inf, "fast"):
        with pytest.raises(ValueError, match=r"rates|could not convert"):
            trajectory_pairs(counted(9), rates=wrong)
        with pytest.raises(ValueError, match=r"^resample must be"):
            trajectory_pairs(counted(9), rates=10, resample=wrong)
    with pytest.raises(
        ValueError, match=r"^resample=50 needs the rate of trajectory 1"
    ):
        trajectory_pairs([frames[0], counted(9)], resample=50)
    with pytest.raises(ValueError, match=r"from 100 to 100.5 Hz"):
        trajectory_pairs([counted(9), counted(9)], rates=[100, 100.5])
    # Read off time stamps, rates are equal within 1 %, and serve all trajectories.
    near = trajectory_pairs([frames[0], stamped(np.arange(20) / 100.5), counted(9)])
    assert_allclose(near.time[near.groups == 2], np.arange(8) / 100)
    equal = trajectory_pairs([counted(9), counted(9)], rates=[100, 100])
    assert_array_equal(equal.X, trajectory_pairs([counted(9)] * 2).X)


@pytest.mark.parametrize("n_samples", [1, 2, 3, 4, 20])
@pytest.mark.parametrize("rate", [40, 100, 230])
def test_resampling_is_a_spline_that_extrapolates_nothing(n_samples, rate):
    """Splines of degree min(3, n - 1) reproduce polynomials of that degree."""
    degree = min(3, n_samples - 1)
    times = np.arange(n_samples) / 100
    cubic = np.polynomial.Polynomial([1.0, 2, -30, 400][: degree + 1])
    piece = np.concatenate([cubic(times), [np.nan], cubic(np.arange(30) / 100)])
    options = {"gaps": "split", "rates": 100, "resample": rate}
    x = np.column_stack([piece, 2 * piece])
    pairs = trajectory_pairs(x, 3 * piece, **options)
    n_new = int((n_samples - 1) / 100 * rate + 1e-9) + 1
    is_first = pairs.time < n_samples / 100
    assert is_first.sum() == n_new - 1
    grid = np.arange(n_new) / rate
    assert_allclose(pairs.time[is_first], grid[:-1], atol=1e-12)
    assert_array_equal(pairs.frame[is_first], range(n_new - 1))
    values = cubic(grid)
    assert_allclose(pairs.X[is_first], np.outer(values[:-1], [1, 2]), atol=1e-9)
    assert_allclose(pairs.y[is_first], 3 * values[1:], atol=1e-9)
    assert not np.isnan(pairs.X).any()
    # The second piece begins with its own first sample.
    start = (n_samples + 1) / 100
    second = pairs.time[~is_first]
    assert_allclose(second, start + np.arange(len(second)) / rate, atol=1e-12)
    frames = np.rint(start * rate) + np.arange(len(second))
    assert_array_equal(pairs.frame[~is_first], frames)


def test_resampling_to_the_own_rate_changes_nothing():
    x = np.random.default_rng(0).normal(size=(50, 2))
    pairs = trajectory_pairs(x, lag=2, delays=(0, 3), rates=70, resample=70)
    expected = trajectory_pairs(x, lag=2, delays=(0, 3), rates=70)
    assert_allclose(pairs.X, expected.X, atol=1e-12)
    assert_array_equal(pairs.frame, expected.frame)


# --- time, frames and names ---------------------------------------------------------


@pytest.mark.parametrize("embedding", ["copies", "differences"])
@pytest.mark.parametrize("lag", [1, 3])
@pytest.mark.parametrize("delays", [1, 3, (0, 2, 5)])
def test_frames_lead_back_to_the_recording(embedding, lag, delays):
    rng = np.random.default_rng(0)
    recordings = [with_nan(rng.normal(size=(40, 2)), [0, 13]), rng.normal(size=(9, 2))]
    outputs = [x[:, 0] for x in recordings]
    options = {"lag": lag, "delays": delays, "embedding": embedding, "gaps": "split"}
    pairs = trajectory_pairs(recordings, outputs, outputs_in_state=True, **options)
    for number, recording in enumerate(recordings):
        rows = pairs.groups == number
        frame = pairs.frame[rows]
        assert_array_equal(pairs.X[rows, :2], recording[frame])
        assert_array_equal(pairs.X_next[rows, :2], recording[frame + lag])
        assert_array_equal(pairs.y[rows], recording[frame + lag, 0])
        assert_array_equal(pairs.time[rows], frame)
    timed = trajectory_pairs(recordings, outputs, rates=50.0, **options)
    assert_array_equal(timed.frame, pairs.frame)
    assert_allclose(timed.time, pairs.frame / 50)


def test_feature_names():
    x, y = counted(12, n_features=2), counted(12)
    delays = (0, 2, 5)
    pairs = trajectory_pairs(x, y, delays=delays, outputs_in_state=True)
    assert pairs.feature_names == (
        ["x0", "x1", "x0_t-2", "x1_t-2", "x0_t-5", "x1_t-5", "y0", "y0_t-2", "y0_t-5"]
    )
    frame, series = pd.DataFrame(x, columns=["hip", "knee"]), pd.Series(y[:, 0])
    options = {"delays": delays, "embedding": "differences", "outputs_in_state": True}
    pairs = trajectory_pairs(frame, series.rename("ankle"), **options)
    assert pairs.feature_names == (
        [
            "hip",
            "knee",
            "hip_d1",
            "knee_d1",
            "hip_d2",
            "knee_d2",
            "ankle",
            "ankle_d1",
            "ankle_d2",
        ]
    )
    assert pairs.y.name == "ankle"
    pairs = trajectory_pairs(frame, frame[["hip"]], outputs_in_state=True)
    assert list(pairs.X) == pairs.feature_names == ["hip", "knee", "output_hip"]
    assert list(pairs.y) == ["hip"]
    tuples = pd.DataFrame(x, columns=pd.MultiIndex.from_product([["hip"], ["x", "y"]]))
    assert trajectory_pairs([x, tuples]).feature_names == ["hip_x", "hip_y"]
    assert trajectory_pairs(pd.DataFrame(x)).feature_names == ["x0", "x1"]
    numbered = pd.DataFrame(x, columns=[4, 7])
    assert trajectory_pairs(numbered, series).feature_names == ["4", "7"]
    assert trajectory_pairs(numbered, series).y.name == "y0"


def test_frames_come_out_where_frames_come_in():
    frames = [
        pd.DataFrame(counted(n, i, 2), columns=["hip", "knee"])
        for i, n in enumerate((9, 7))
    ]
    ankles = [frame[["hip"]].set_axis(["ankle"], axis=1) for frame in frames]
    options = {"lag": 2, "delays": 2}
    arrays = trajectory_pairs(
        [f.to_numpy() for f in frames], [a.to_numpy() for a in ankles], **options
    )
    pairs = trajectory_pairs(frames, ankles, **options)
    assert_same_pairs(pairs, arrays)
    for name in ("X", "y", "X_next"):
        index = pairs[name].index
        assert list(index.names) == ["trial", "sample_index"]
        assert_array_equal(index.get_level_values("trial"), pairs.groups)
        assert_array_equal(index.get_level_values("sample_index"), pairs.sample_index)
    assert list(pairs.X) == list(pairs.X_next) == pairs.feature_names
    assert list(pairs.y) == ["ankle"]
    series = trajectory_pairs(frames, [a["ankle"] for a in ankles], **options)
    assert isinstance(series.y, pd.Series)
    assert series.y.index.equals(series.X.index)
    assert type(trajectory_pairs([f.to_numpy() for f in frames]).X) is np.ndarray
    model = LinearRegression().fit(pairs.X, pairs.y)
    assert list(model.feature_names_in_) == pairs.feature_names
    with config_context(transform_output="pandas"):
        asked = trajectory_pairs([f.to_numpy() for f in frames], **options)
        assert list(asked.X) == asked.feature_names == ["x0", "x1", "x0_t-1", "x1_t-1"]
        assert list(asked.y) == ["x0", "x1"]
        assert asked.X.index.equals(pairs.X.index)
        assert isinstance(current_states(frames[0].to_numpy()), pd.DataFrame)


class PlainFrame:
    """What polars' frames have: names and values, but no index."""

    def __init__(self, values, columns):
        self.values, self.columns, self.shape = values, columns, values.shape

    def __len__(self):
        return len(self.values)

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype=dtype)


def test_frames_of_others_give_names():
    x = counted(8, n_features=2)
    frame = PlainFrame(x, ["hip", "knee"])
    for form in (frame, [frame]):
        pairs = trajectory_pairs(form)
        assert pairs.feature_names == ["hip", "knee"]
        assert type(pairs.X) is np.ndarray
        assert_same_pairs(pairs, trajectory_pairs(x))


# --- angles that wrap ---------------------------------------------------------------


def wrapped(turn, low, speed=0.15, n_samples=400):
    """An angle that grows, with an oscillation, counted within one turn from low."""
    phase = np.arange(n_samples) * speed
    angle = phase + 0.5 * np.sin(phase)
    return (angle * turn / (2 * np.pi) - low) % turn + low


@pytest.mark.parametrize(
    ("turn", "period"), [(360.0, "period=360"), (2 * np.pi, r"period=2 \* np.pi")]
)
@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize("speed", [0.03, 0.3, 0.9])
def test_angles_that_wrap_warn_once(turn, period, centred, speed):
    angle = wrapped(turn, -turn / 2 if centred else 0.0, speed)
    smooth = np.sin(np.arange(400) * 0.1)
    good = np.column_stack([smooth, smooth])
    bad = pd.DataFrame({"shank": smooth, "thigh": np.round(angle, 3)})
    recordings = [good, bad, bad]
    message = rf"^trajectories\[1\] \(and 1 more arr.* column thigh: .*{period}\)"
    with pytest.warns(UserWarning, match=message) as caught:
        trajectory_pairs(recordings)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match=r"^outputs\[0\] .*in column y0:"):
        trajectory_pairs(good, angle)
    with pytest.warns(UserWarning, match=r"^recording\[0\] .*in column x1:"):
        current_states(np.column_stack([smooth, angle]))
    # Each column is named with its own turn.
    other = angle * (2 * np.pi / 360 if turn == 360 else 360 / (2 * np.pi))
    with pytest.warns(UserWarning, match=r"^trajectories\[0\] jumps .* column x[01]:"):
        trajectory_pairs(np.column_stack([angle, other]))
    # The remedy, for states and outputs.
    unwrapped = unwrap_angles(angle, period=turn)
    trajectory_pairs(np.column_stack([smooth, unwrapped]), unwrapped)


@pytest.mark.parametrize(
    "glitch",
    [
        {150: 0.0},
        {150: 1e4},
        {150: 720.0, 300: 200.0},
        dict.fromkeys(range(200, 205), 10000.0),
        dict.fromkeys((30, 110, 190, 270), 100.0),
    ],
)
@pytest.mark.parametrize("turn", [360.0, 2 * np.pi])
def test_glitches_do_not_mute_wraps(glitch, turn):
    angle = wrapped(turn, 0.0)
    for row, value in glitch.items():
        angle[row] = value * turn / 360
    assert np.sum(np.diff(wrapped(turn, 0.0)) < -turn / 2) == 9
    assert find_wraps(angle[:-1, None], angle[1:, None]) == {0: turn}
    # Without the wraps they do not warn.
    angle = 0.4 * turn * np.sin(np.arange(400) * 0.1)
    for row, value in glitch.items():
        angle[row] = value * turn / 360
    assert find_wraps(angle[:-1, None], angle[1:, None]) == {}


def test_a_short_turn_in_a_long_recording_wraps():
    heading = np.full(2000, 345.0)
    heading[1000:1010] += np.arange(0, 40, 4)
    heading[1010:] = 385.0
    assert find_wraps(heading[:-1, None] % 360, heading[1:, None] % 360) == {0: 360.0}


def test_wraps_must_outnumber_glitches():
    angle = wrapped(360.0, 0.0, 0.05)
    assert np.sum(np.diff(angle) < -180) == 3
    angle[100] = angle[100] + 180  # two steps
    assert find_wraps(angle[:-1, None], angle[1:, None]) == {0: 360.0}
    angle[110] = angle[110] + 180
    assert find_wraps(angle[:-1, None], angle[1:, None]) == {}


def test_a_wrap_across_a_gap_is_no_step():
    angle = np.array([340.0, 345, 350, 355, np.nan, 5, 10, 15, 20])[:, None]
    trajectory_pairs(angle, gaps="split")
    with pytest.warns(UserWarning, match="wrap"):
        trajectory_pairs(angle[~np.isnan(angle[:, 0])])


@pytest.mark.parametrize(
    "signal",
    [
        np.tile([0.0, 300.0], 40),
        np.repeat([0.0, 5.0, 0.0, 5.0], 20),  # contact
        np.tile(np.arange(0.0, 6.0, 0.1), 5),  # a sawtooth
        np.tile(np.arange(0.0, 301.0, 5.0), 5),
        # A switch and a sawtooth with noise, and with a glitch.
        np.tile([0.0, 350.0], 10).repeat(15)
        + np.random.default_rng(0).normal(0, 3.5, 300),
        np.tile([0.0, 300.0], 10).repeat(15) + 40.0 * (np.arange(300) == 100),
        np.tile(np.arange(0.0, 301.0, 5.0), 5) + 40.0 * (np.arange(305) == 100),
        180 * np.sin(np.arange(300) * 3.1),
        np.random.default_rng(2).beta(0.3, 0.3, 300) * 360,
        np.arange(1000.0),
        np.concatenate([np.arange(0.0, 500, 10), np.arange(850.0, 1300, 10)]),
        np.cumsum(np.full(50, 300.0)),
        180 * np.sin(np.arange(200) * 1.7),
        np.random.default_rng(0).uniform(0, 2 * np.pi, 300),
        np.random.default_rng(1).uniform(-180, 180, 300),
        np.array([0.1, 6.2]),
        np.zeros(20),
    ],
)
def test_other_jumps_are_no_wraps(signal):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory_pairs(signal[:, None], signal)
    assert find_wraps(signal[:-1, None], signal[1:, None]) == {}


def test_wraps_of_consecutive_rows():
    angles = np.column_stack([wrapped(360.0, 0.0), wrapped(2 * np.pi, -np.pi)])
    both = np.column_stack([angles, angles[:, 0] / 2])
    turns = find_wraps(both[:-1], both[1:])
    assert turns == {0: 360.0, 1: 2 * np.pi}
    assert find_wraps(both[:0], both[:0]) == {}
    # Rounded, the ends of the circle are a little more than a turn apart.
    rounded = np.array([3.0, 3.1, 3.1416, -3.1416, -3.1, -3.0])[:, None]
    assert find_wraps(rounded[:-1], rounded[1:]) == {0: 2 * np.pi}


# --- the past -----------------------------------------------------------------------


@pytest.mark.parametrize("embedding", ["copies", "differences"])
def test_numbers_of_delays_are_offsets(embedding):
    x = np.random.default_rng(0).normal(size=(40, 2))
    options = {"lag": 2, "embedding": embedding}
    for delays, step in [(1, None), (3, None), (3, 1), (4, 5), (np.int64(2), 3)]:
        offsets = tuple(range(0, delays * (step or 1), step or 1))
        assert_same_pairs(
            trajectory_pairs(x, delays=delays, delay_step=step, **options),
            trajectory_pairs(x, delays=offsets, **options),
        )
    irregular = trajectory_pairs(x, delays=np.array([0, 1, 5]))
    assert_array_equal(irregular.X, np.hstack([x[5:-1], x[4:-2], x[0:-6]]))


@pytest.mark.parametrize(
    "delays", [(1, 2), (0, 2, 2), (0, 5, 1), (), (0, 1.5), ((0, 1),), (0, -1), "01"]
)
def test_bad_offsets(delays):
    with pytest.raises(ValueError, match=r"^delays must be"):
        trajectory_pairs(counted(20), delays=delays)


def test_offsets_have_no_step():
    with pytest.raises(ValueError, match=r"^delay_step=1 has no meaning beside"):
        trajectory_pairs(counted(20), delays=(0, 1), delay_step=1)
    with pytest.raises(ValueError, match=r"^embedding must be one of 'copies'"):
        trajectory_pairs(counted(20), embedding="derivatives")


@pytest.mark.parametrize("offsets", [(0,), (0, 1), (0, 3), (0, 1, 2, 5, 10), (0, 4, 5)])
def test_differences_are_derivatives_of_polynomials(offsets):
    """Divided differences of (t - now)^k: derivatives over j!, if k <= j."""
    offsets = np.array(offsets)
    orders = np.arange(len(offsets))
    rows = embed(counted(30, n_features=2), offsets, "differences")
    assert_array_equal(rows[:, :2], counted(30, n_features=2)[offsets[-1] :])
    for now in (offsets[-1], 25):
        times = np.arange(30.0) - now
        for power in orders:
            row = embed(times[:, None] ** power, offsets, "differences")
            # The leading difference of t^k is 1, higher ones vanish.
            expected = np.where(orders[power:] == power, 1.0, 0.0)
            assert_allclose(row[now - offsets[-1], power:], expected, atol=1e-9)
    # To first order in the step for any smooth function.
    h = 1e-3
    wave = np.exp(h * (np.arange(30.0) - 29))[:, None]
    derivatives = embed(wave, offsets, "differences")[-1] / h**orders
    exact = 1 / np.array([factorial(j) for j in orders])
    assert_allclose(derivatives, exact, rtol=2 * h * offsets[-1] + 1e-2)


@pytest.mark.parametrize("offsets", [(0, 1), (0, 1, 2), (0, 5, 10), (0, 1, 2, 5, 10)])
def test_a_linear_map_leads_from_copies_to_differences_and_back(offsets):
    x = np.random.default_rng(0).normal(size=(60, 2))
    copies = embed(x, np.array(offsets), "copies")
    differences = embed(x, np.array(offsets), "differences")
    assert copies.shape == differences.shape
    forth, _, rank, _ = np.linalg.lstsq(copies, differences, rcond=None)
    assert rank == copies.shape[1]
    assert_allclose(copies @ forth, differences, atol=1e-12)
    assert_allclose(differences @ np.linalg.inv(forth), copies, atol=1e-9)
    # By the definition, one column alone.
    times = -np.array(offsets, dtype=float)
    for j in range(len(offsets)):
        weights = [
            1 / np.prod([times[i] - times[k] for k in range(j + 1) if k != i])
            for i in range(j + 1)
        ]
        expected = copies[:, 1 : 2 * j + 2 : 2] @ weights
        assert_allclose(differences[:, 2 * j + 1], expected, atol=1e-12)


@pytest.mark.parametrize("embedding", ["copies", "differences"])
def test_outputs_in_the_state_are_embedded_alike(embedding):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(30, 2)), rng.normal(size=(30, 3))
    options = {"delays": (0, 2, 3), "embedding": embedding}
    both = trajectory_pairs(x, y, outputs_in_state=True, **options)
    assert_array_equal(both.X[:, :6], trajectory_pairs(x, **options).X)
    assert_array_equal(both.X[:, 6:], trajectory_pairs(y, **options).X)


# --- the newest states --------------------------------------------------------------

SETTINGS = [
    {},
    {"lag": 4},
    {"lag": 3, "delays": 3, "delay_step": 2},
    {"lag": 15, "delays": (0, 1, 4), "embedding": "differences"},
    {"lag": 2, "delays": (0, 3), "outputs_in_state": True},
]


@pytest.mark.parametrize("options", SETTINGS)
@pytest.mark.parametrize("gap", [None, 2, 14, 17, 18])
def test_current_states_are_those_of_a_recording_that_goes_on(options, gap):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(60, 2)), rng.normal(size=(60, 1))
    options = {**options, "gaps": "split"}
    lag = options.get("lag", 1)
    # Before the gap there are enough samples for a pair; behind it, there may be none.
    x[39] = np.nan
    if gap is not None:
        x[40 + gap] = np.nan
    pairs = trajectory_pairs(x, y, **options)
    rows = []
    for newest in range(60 - lag, 60):
        went_on = [
            np.vstack([z[: newest + 1], np.ones((lag, 1)) * z[0]]) for z in (x, y)
        ]
        longer = trajectory_pairs(*went_on, **options)
        rows.append(longer.X[longer.frame == newest])
        assert newest not in pairs.frame
    expected = np.vstack(rows)
    if len(expected):
        assert_array_equal(current_states(x, y, **options), expected)
    else:
        with pytest.raises(ValueError, match="none of the last"):
            current_states(x, y, **options)


def test_windows_of_the_length_needed():
    x = np.random.default_rng(0).normal(size=(30, 2))
    options = {"lag": 5, "delays": (0, 2, 7)}
    whole = current_states(x, **options)
    assert whole.shape == (5, 6)
    assert_array_equal(current_states(x[-8:], **options), whole[-1:])
    assert_array_equal(current_states(x[-10:], **options), whole[-3:])
    with pytest.raises(ValueError, match=r"^none of the last 5 .*need 8 samples"):
        current_states(x[-7:], **options)
    x[-5] = np.nan
    with pytest.raises(ValueError, match=r"^recording\[0\] holds NaN in 1 of 30"):
        current_states(x, **options)
    with pytest.raises(ValueError, match=r"^none of the last 5 samples has a whole"):
        current_states(x, **options, gaps="split")
    with pytest.raises(ValueError, match=r"^recording holds 2 recordings"):
        current_states([x, x], gaps="split")
    # Outputs that are not in the state do not cut it.
    y = np.full(30, np.nan)
    y[:20] = 1.0
    options["gaps"] = "split"
    assert_array_equal(
        current_states(x[:25], y[:25], **options), current_states(x[:25], **options)
    )


def test_current_states_of_frames():
    frame = pd.DataFrame({"hip": np.arange(20.0)}, index=range(100, 120))
    options = {"lag": 3, "delays": (0, 5), "gaps": "split"}
    newest = current_states(frame, **options)
    assert list(newest) == trajectory_pairs(frame, **options).feature_names
    assert_array_equal(newest.index, [117, 118, 119])
    assert_array_equal(newest["hip"], frame.loc[newest.index, "hip"])
    dropped = frame.drop(index=[113])
    # A hole in the past of 117 and 118 only.
    assert_array_equal(current_states(dropped, **options).index, [119])
    assert_array_equal(
        current_states(frame.drop(index=[118]), lag=3, gaps="split"), [[17], [19]]
    )


def test_current_states_are_resampled_up_to_the_last_sample():
    times = np.arange(33) / 100
    x = np.column_stack([times, times**3])
    options = {"lag": 3, "delays": (0, 2), "rates": 100, "resample": 30}
    newest = current_states(x, **options)
    expected = times[-1] - np.arange(2, -1, -1) / 30
    assert_allclose(newest[:, 0], expected, atol=1e-12)
    assert_allclose(newest[:, 1], expected**3, atol=1e-12)
    assert_allclose(newest[:, 2], expected - 2 / 30, atol=1e-12)
    # The samples behind a gap are too few for a past, but not those before it.
    x[30] = np.nan
    newest = current_states(x, **options, gaps="split")
    assert_allclose(newest[:, 0], expected[:2], atol=1e-12)
    stamps = pd.DataFrame(x[:30], index=5 + times[:30])
    del options["rates"]
    assert_allclose(
        current_states(stamps, **options).to_numpy()[:, 0],
        times[29] - np.arange(2, -1, -1) / 30,
        atol=1e-9,
    )


# --- folds by the index -------------------------------------------------------------


def test_folds_leave_out_the_trials_of_the_index():
    frames = [pd.DataFrame(counted(n, i)) for i, n in enumerate((9, 12, 7))]
    pairs = trajectory_pairs(frames, lag=2)
    expected = list(TrajectoryKFold(3).split(pairs.X, groups=pairs.groups))
    X = pairs.X.to_numpy()
    for data in ((pairs.X, pairs.y), (X, pairs.y), (X, pairs.y["x0"]), (pairs.X,)):
        folds = list(TrajectoryKFold(3).split(*data))
        for fold, own in zip(folds, expected, strict=True):
            assert_array_equal(fold[0], own[0])
            assert_array_equal(fold[1], own[1])
    # Given groups come first; one trial gives blocks.
    halves = np.arange(len(X)) % 2
    [(_, test), _] = TrajectoryKFold(2).split(pairs.X, groups=halves)
    assert len({*halves[test]}) == 1
    one = pairs.X.loc[[1]]
    tests = [test for _, test in TrajectoryKFold(3).split(one)]
    assert_array_equal(np.concatenate(tests), range(len(one)))


def test_searches_and_studies_leave_out_the_trials_of_the_index():
    walking = make_walking(3, n_strides=2, rate=50, random_state=0)
    angles = [pd.DataFrame(x, columns=["hip", "knee"]) for x in walking.trajectories]
    pairs = trajectory_pairs(angles, walking.outputs, lag=4, delays=2)
    X, y = pairs.X.to_numpy(), pairs.y.to_numpy()
    search = KoopmanKernelRegressorCV(betas=[1.0], cv=TrajectoryKFold(3))
    expected = search.fit(X, y, groups=pairs.groups).best_score_
    assert search.fit(X, y).best_score_ > expected + 1e-3
    for data in ((pairs.X, pairs.y), (pairs.X, y), (X, pairs.y)):
        assert search.fit(*data).best_score_ == expected
    model = search.best_estimator_
    for cv in (None, 3):
        study = calibration_study(model, pairs.X, y, cv=cv)
        own = calibration_study(model, X, y, groups=pairs.groups, cv=cv)
        assert study.ratio == own.ratio


def test_datasets_keep_their_arrays():
    with config_context(transform_output="pandas"):
        data = make_pendulum(20)
        assert type(data.X) is np.ndarray
        assert_allclose(data.f(data.X), data.X_next)


def test_an_index_that_restarts_needs_groups():
    X = pd.DataFrame(counted(20))
    several = pd.concat([X[:12], X[:8]])
    stamps = several.set_axis(several.index / 100)
    keys = pd.MultiIndex.from_arrays([[1] * 12 + [2] * 8, several.index])
    y = np.zeros(20)
    by_frame = several.sort_index()
    forms = several[0], stamps, several.set_axis(keys), by_frame
    for data in ((several, y), *((form,) for form in forms)):
        with pytest.raises(ValueError, match=r"^the index restarts.*groups="):
            next(TrajectoryKFold(2).split(*data))
        assert (
            len(list(TrajectoryKFold(2).split(*data, groups=[1] * 12 + [2] * 8))) == 2
        )
    with pytest.raises(ValueError, match=r"^the index restarts"):
        next(TrajectoryKFold(2).split(y, several[0]))
    for good in (X, X.set_axis(range(5, 45, 2)), X.set_axis(["a"] * 20)):
        [(_, test), _] = TrajectoryKFold(2).split(good)
        assert_array_equal(test, range(10))


def test_current_states_after_resampling_are_indexed_by_time():
    """Counted back from the last sample, new samples have no whole frame numbers."""
    line = pd.DataFrame({"hip": np.arange(10.0)})  # 200 Hz, to 0.045 s
    now = current_states(line, rates=200, resample=100, lag=3)
    assert now.index.name == "time"
    assert_allclose(now.index, [0.025, 0.035, 0.045])
    assert_allclose(now["hip"], [5.0, 7.0, 9.0])


def test_plain_lists_are_recordings():
    """One recording may be a list of its rows, and its outputs a list of numbers."""
    rows = [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    pairs = trajectory_pairs(rows, [6.0, 7.0, 8.0])
    assert_array_equal(pairs.X, rows[:2])
    assert_array_equal(pairs.y, [7.0, 8.0])
    assert_array_equal(trajectory_pairs([rows, rows]).groups, [0, 0, 1, 1])
    assert_array_equal(current_states(rows, delays=2), [[4.0, 5.0, 2.0, 3.0]])
    with pytest.raises(ValueError, match=r"dict; pass list\(data.values\(\)\)"):
        trajectory_pairs({"T01": rows})


def test_time_stamps_in_another_unit_than_seconds_are_told():
    """Milliseconds with a fraction would make 100,000 samples of a second."""
    stamps = np.arange(50) / 0.15 + 0.5
    with pytest.raises(ValueError, match=r"makes 667 samples of each .* in seconds"):
        trajectory_pairs(pd.DataFrame({"hip": stamps}, index=stamps), resample=100)


def test_names_that_collide_with_those_of_the_past_are_refused():
    frame = pd.DataFrame({"hip": np.arange(9.0), "hip_t-1": np.arange(9.0)})
    with pytest.raises(ValueError, match=r"names \['hip_t-1'\] more than once"):
        trajectory_pairs(frame, delays=2)
