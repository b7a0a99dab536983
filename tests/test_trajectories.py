"""Pairing against plain loops; folds against brute force and in scikit-learn."""

import numpy as np
import pandas as pd
import pytest
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.neighbors import KNeighborsRegressor

from sklearn_koopman import TrajectoryKFold, trajectory_pairs


def make_trajectories(lengths, n_features=2, n_outputs=3, seed=0):
    rng = np.random.default_rng(seed)
    states = [rng.normal(size=(n, n_features)) for n in lengths]
    outputs = [rng.normal(size=(n, n_outputs)) for n in lengths]
    return states, outputs


def pairs_by_loops(states, outputs, lag, delays, delay_step, outputs_in_state):
    """Rows X, y, X_next, and the trajectory and time (number, k) of each."""
    X, y, X_next, times = [], [], [], []

    def row(number, k):
        copies = [k - copy * delay_step for copy in range(delays)]
        columns = [states[number][time] for time in copies]
        if outputs_in_state:
            columns += [np.ravel(outputs[number][time]) for time in copies]
        return np.concatenate(columns)

    for number in range(len(states)):
        for k in range(len(states[number])):
            if k < (delays - 1) * delay_step or k + lag >= len(states[number]):
                continue
            X.append(row(number, k))
            y.append(outputs[number][k + lag])
            X_next.append(row(number, k + lag))
            times.append((number, k))
    return np.array(X), np.array(y), np.array(X_next), times


# Of lag, delays and delay_step.
SETTINGS = [(1, 1, 1), (1, 3, 1), (1, 2, 4), (2, 1, 1), (3, 2, 2), (5, 3, 1), (4, 1, 7)]
settings = pytest.mark.parametrize(("lag", "delays", "delay_step"), SETTINGS)


# --- pairs --------------------------------------------------------------------------


@every_pair(setting=SETTINGS, outputs_in_state=[False, True], seed=range(3))
def test_pairs_are_those_of_the_loops(setting, outputs_in_state, seed):
    lag, delays, delay_step = setting
    # From the shortest that gives one pair, on.
    least = lag + (delays - 1) * delay_step + 1
    lengths = least + np.random.default_rng(seed).integers(0, 12, 4)
    lengths[seed] = least
    states, outputs = make_trajectories(lengths, seed=seed)
    options = {"lag": lag, "delays": delays, "delay_step": delay_step}
    pairs = trajectory_pairs(
        states, outputs, **options, outputs_in_state=outputs_in_state
    )
    X, y, X_next, times = pairs_by_loops(
        states, outputs, **options, outputs_in_state=outputs_in_state
    )
    assert_array_equal(pairs.X, X)
    assert_array_equal(pairs.y, y)
    assert_array_equal(pairs.X_next, X_next)
    assert_array_equal(pairs.groups, [number for number, _ in times])

    # Row j succeeds row i, on the same trajectory and one lag later, by the clock.
    succeeds = [[after == (number, k + lag) for after in times] for number, k in times]
    clock = pairs.sample_index
    assert len(set(clock)) == len(clock)
    assert_array_equal(clock == clock[:, None] + 1, succeeds)
    for i, j in np.argwhere(succeeds):
        assert_array_equal(pairs.X_next[i], pairs.X[j])


@settings
def test_no_pair_straddles_two_trajectories(lag, delays, delay_step):
    # Sample k of trajectory i is the number 1000 i + k.
    states = [1000.0 * i + np.arange(n)[:, None] for i, n in enumerate((30, 9, 9, 17))]
    pairs = trajectory_pairs(states, lag=lag, delays=delays, delay_step=delay_step)
    together = np.hstack([pairs.X, pairs.X_next, pairs.y])
    expected = np.repeat(pairs.groups[:, None], together.shape[1], axis=1)
    assert_array_equal(together // 1000, expected)
    assert_array_equal(pairs.y[:, 0] - pairs.X[:, 0], lag)
    assert_array_equal(-np.diff(pairs.X, axis=1), delay_step)
    assert set(pairs.groups) == {0, 1, 2, 3}


def test_outputs_default_to_the_states():
    states, _ = make_trajectories([8, 11])
    pairs = trajectory_pairs(states, lag=2, delays=3)
    assert_array_equal(pairs.y, pairs.X_next[:, :2])
    assert_array_equal(pairs.y, np.vstack([states[0][4:], states[1][4:]]))


@pytest.mark.parametrize("outputs_in_state", [False, True])
def test_scalar_outputs(outputs_in_state):
    states, outputs = make_trajectories([9, 12])
    outputs = [y[:, 0] for y in outputs]
    options = {"lag": 2, "delays": 2, "delay_step": 3}
    options["outputs_in_state"] = outputs_in_state
    pairs = trajectory_pairs(states, outputs, **options)
    X, y, X_next, _ = pairs_by_loops(states, outputs, **options)
    assert pairs.y.ndim == 1
    assert_array_equal(pairs.X, X)
    assert_array_equal(pairs.y, y)
    assert_array_equal(pairs.X_next, X_next)


def test_order_of_the_columns():
    # Current copy first, then older ones; the outputs behind all copies of the state.
    x = np.arange(4.0)[:, None]
    pairs = trajectory_pairs(x, 10 + x, delays=2, outputs_in_state=True)
    assert_array_equal(pairs.X, [[1, 0, 11, 10], [2, 1, 12, 11]])
    assert_array_equal(pairs.X_next, [[2, 1, 12, 11], [3, 2, 13, 12]])
    assert_array_equal(pairs.y, [[12], [13]])


def test_forms_of_input_agree():
    states, outputs = make_trajectories([10, 10, 10])
    options = {"lag": 2, "delays": 2, "outputs_in_state": True}
    expected = trajectory_pairs(states, outputs, **options)
    forms = [
        (tuple(states), tuple(outputs)),
        (list(np.stack(states)), list(np.stack(outputs))),
        ([x.tolist() for x in states], [y.tolist() for y in outputs]),
        ([np.asfortranarray(x) for x in states], outputs),
        (
            [pd.DataFrame(x, index=range(50, 60)) for x in states],
            [pd.DataFrame(y, index=range(50, 60)) for y in outputs],
        ),
    ]
    for form in forms:
        pairs = trajectory_pairs(*form, **options)
        for name in ("X", "y", "X_next", "groups", "sample_index"):
            assert_array_equal(pairs[name], expected[name])
            is_frame = form is forms[-1] and name in ("X", "y", "X_next")
            assert type(pairs[name]) is (pd.DataFrame if is_frame else np.ndarray)


def test_one_trajectory():
    [x], [y] = make_trajectories([15])
    expected = trajectory_pairs([x], [y], lag=2)
    for form in [(x, y), ([x], y), (pd.DataFrame(x), pd.DataFrame(y))]:
        pairs = trajectory_pairs(*form, lag=2)
        assert_array_equal(pairs.X, expected.X)
        assert_array_equal(pairs.y, expected.y)
        assert_array_equal(pairs.groups, 0)
    series = trajectory_pairs(pd.DataFrame(x), pd.Series(y[:, 0]))
    assert_array_equal(series.y, y[1:, 0])


def test_results_are_copies():
    [x], _ = make_trajectories([6])
    before = x.copy()
    pairs = trajectory_pairs(x)
    for name in ("X", "y", "X_next"):
        pairs[name][:] = np.nan
        others = {"X", "y", "X_next"} - {name}
        assert not any(np.isnan(pairs[other]).any() for other in others)
        pairs = trajectory_pairs(x)
    assert_array_equal(x, before)


def test_integers_and_single_precision_become_double():
    x = np.arange(10).reshape(5, 2)
    assert trajectory_pairs(x).X.dtype == trajectory_pairs(x).y.dtype == float
    single = np.float32(x) / 3
    assert_array_equal(trajectory_pairs(single).X, single[:-1].astype(float))


@pytest.mark.parametrize(
    ("options", "least"),
    [
        ({}, 2),
        ({"lag": 4}, 5),
        ({"delays": 3}, 4),
        ({"lag": 3, "delays": 3, "delay_step": 2}, 8),
    ],
)
def test_too_short_a_trajectory_is_named(options, least):
    states, _ = make_trajectories([20, least, 20])
    assert np.sum(trajectory_pairs(states, **options).groups == 1) == 1
    states[1] = states[1][1:]
    message = f"^trajectory 1 has {least - 1} samples, but lag=.*need {least};"
    with pytest.raises(ValueError, match=message):
        trajectory_pairs(states, **options)


def broken(value):
    [x], _ = make_trajectories([6])
    x[3:5, 1] = value
    return x


GOOD = np.arange(12.0).reshape(6, 2)


@pytest.mark.parametrize(
    ("trajectories", "outputs", "options", "message"),
    [
        ([GOOD, broken(np.nan)], None, {}, r"trajectories\[1\] .*NaN in 2 of 6.*le 3"),
        ([GOOD], [broken(np.nan)[:, 1]], {}, r"outputs\[0\] holds NaN in 2 of 6"),
        (broken(np.nan), None, {}, r"trajectories\[0\] holds NaN.*split"),
        ([GOOD, broken(np.inf)], None, {}, r"trajectories\[1\].*infinity"),
        ([GOOD, GOOD[:, :1]], None, {}, r"trajectories\[1\].*\(6, 1\).*\(6, 2\)"),
        ([[[1.0, 2.0], [3.0]]], None, {}, r"trajectories\[0\]: "),
        ([GOOD] * 2, [GOOD, GOOD[:, 0]], {}, r"outputs\[1\].*\(6,\).*\(6, 2\)"),
        ([GOOD] * 3, [GOOD] * 2, {}, "outputs holds 2 arrays for 3 trajectories"),
        ([GOOD] * 2, [GOOD, GOOD[1:]], {}, "trajectory 1 has 6 .* outputs have 5"),
        (GOOD, GOOD[1:], {}, "trajectory 0 has 6 .* outputs have 5"),
        ([], None, {}, "trajectories must be .*a non-empty list"),
        ([GOOD], [], {}, "outputs must be .*a non-empty list"),
        (np.empty((0, 5, 2)), None, {}, r"trajectories .*\(0, 5, 2\), not"),
        ([GOOD, np.empty((0, 2))], None, {}, r"trajectories\[1\].* 0 sample"),
        (GOOD[:, 0], None, {}, r"trajectories\[0\].*\(6,\).*reshape\(-1, 1\)"),
        (np.zeros((2, 3, 4, 5)), None, {}, r"trajectories .*\(2, 3, 4, 5\), not"),
        (None, None, {}, "trajectories must be .*NoneType"),
        ("walk", None, {}, "trajectories must be .*str"),
        ({"walk": GOOD}, None, {}, "trajectories must be .*dict"),
        (iter([GOOD]), None, {}, "trajectories must be .*iterator"),
        ([np.array([["a"], ["b"]])], None, {}, r"trajectories\[0\].*'a'"),
        (GOOD, None, {"outputs_in_state": True}, "outputs_in_state=True needs outputs"),
        (GOOD, None, {"lag": 0}, "lag must be .* got 0"),
        (GOOD, None, {"lag": -2}, "lag must be .* got -2"),
        (GOOD, None, {"delays": 0}, "delays must be .* got 0"),
        (GOOD, None, {"delay_step": 0}, "delay_step must be .* got 0"),
    ],
)
def test_bad_trajectories(trajectories, outputs, options, message):
    with pytest.raises(ValueError, match=message):
        trajectory_pairs(trajectories, outputs, **options)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in ("lag", "delays", "delay_step")
        for value in (1.0, "1", None)
        if (name, value) != ("delay_step", None)
    ],
)
def test_counts_are_integers(name, value):
    with pytest.raises((TypeError, ValueError), match=f"^{name} must be"):
        trajectory_pairs(GOOD, **{name: value})
    assert_array_equal(trajectory_pairs(GOOD, **{name: np.int32(1)}).X, GOOD[:-1])


# --- folds of trajectories ----------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n_splits", [2, 3, 7])
def test_folds_are_whole_trajectories(n_splits, seed):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 40, 7 + seed)
    groups = rng.permutation(np.repeat(rng.permutation(100)[: len(lengths)], lengths))
    rows = np.arange(len(groups))
    folds = list(TrajectoryKFold(n_splits).split(rows, groups=groups))
    assert len(folds) == n_splits == TrajectoryKFold(n_splits).get_n_splits()
    assert_array_equal(np.sort(np.concatenate([test for _, test in folds])), rows)
    for train, test in folds:
        assert_array_equal(np.sort(np.concatenate([train, test])), rows)
        assert not set(groups[train]) & set(groups[test])
    # The largest first, each to the smallest fold: balanced up to one trajectory.
    sizes = np.array([len(test) for _, test in folds])
    assert np.ptp(sizes) <= lengths.max()
    loads = np.zeros(n_splits, dtype=int)
    for length in np.sort(lengths)[::-1]:
        loads[loads.argmin()] += length
    assert_array_equal(np.sort(sizes), np.sort(loads))


@pytest.mark.parametrize(
    "groups",
    [
        np.repeat(["run", "walk", "jump"], [4, 3, 5]),
        pd.Series(np.repeat(["run", "walk", "jump"], [4, 3, 5]), index=range(90, 102)),
        np.repeat([2, -1, 7], [4, 3, 5]).tolist(),
    ],
)
def test_labels_of_any_kind(groups):
    X = pd.DataFrame({"hip": np.arange(12.0)})
    folds = {tuple(test) for _, test in TrajectoryKFold(3).split(X, groups=groups)}
    assert folds == {tuple(range(4)), tuple(range(4, 7)), tuple(range(7, 12))}


def test_gap_is_not_used_with_groups():
    groups = [0, 0, 1, 1, 2, 2]
    for train, test in TrajectoryKFold(3, gap=100).split(np.zeros(6), groups=groups):
        assert_array_equal(np.sort(np.concatenate([train, test])), range(6))


# --- blocks of one trajectory -------------------------------------------------------


@every_pair(n_samples=[13, 15, 40], n_splits=[2, 3, 5], gap=[0, 1, 4])
def test_blocks_with_gaps_on_both_sides(n_samples, n_splits, gap):
    folds = list(TrajectoryKFold(n_splits, gap=gap).split(np.zeros((n_samples, 1))))
    assert len(folds) == n_splits
    # The blocks come in the order of time, cover it and differ by at most one row.
    assert_array_equal(np.concatenate([test for _, test in folds]), range(n_samples))
    assert np.ptp([len(test) for _, test in folds]) <= 1
    for train, test in folds:
        apart = [
            row
            for row in range(n_samples)
            if min(abs(row - other) for other in test) > gap
        ]
        assert_array_equal(train, apart)


@pytest.mark.parametrize(
    ("lag", "delays", "delay_step"), [(1, 1, 1), (1, 3, 2), (3, 1, 1), (2, 4, 3)]
)
@pytest.mark.parametrize("n_splits", [2, 4])
def test_the_gap_of_the_docstring_keeps_samples_apart(
    lag, delays, delay_step, n_splits
):
    # Every entry is the number of the raw sample that it was taken from.
    pairs = trajectory_pairs(
        np.arange(100.0)[:, None], lag=lag, delays=delays, delay_step=delay_step
    )
    gap = lag + (delays - 1) * delay_step

    def shared(gap):
        for train, test in TrajectoryKFold(n_splits, gap=gap).split(pairs.X):
            used = [{*pairs.X[r].ravel(), *pairs.y[r].ravel()} for r in (train, test)]
            yield len(used[0] & used[1])

    assert not any(shared(gap))
    assert all(shared(gap - 1))


@pytest.mark.parametrize("as_array", [list, np.asarray, pd.DataFrame])
def test_only_the_number_of_rows_counts(as_array):
    X = as_array([[0.0], [0.0], [0.0], [0.0], [0.0]])
    [(first, _), (second, _)] = TrajectoryKFold(2, gap=1).split(X)
    assert_array_equal(first, [4])
    assert_array_equal(second, [0, 1])


# --- bad splits ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n_splits", "gap", "n_samples", "groups", "message"),
    [
        (1, 0, 12, None, "n_splits must be .* got 1"),
        (0, 0, 12, None, "n_splits must be .* got 0"),
        (3, -1, 12, None, "gap must be .* got -1"),
        (3, 4, 12, None, "^gap=4 leaves no training rows .*of 4 rows"),
        (2, 6, 12, None, "^gap=6 leaves no training rows .*of 6 rows"),
        (13, 0, 12, None, "n_splits=13 greater than the number of .*n_samples=12"),
        (2, 0, 0, None, "n_splits=2 greater than the number of .*n_samples=0"),
        (3, 0, 12, [1] * 5 + [2] * 7, "n_splits=3 greater than .* groups: 2"),
        (2, 0, 12, [1] * 12, "n_splits=2 greater than .* groups: 1"),
        (2, 0, 12, [1] * 11, r"\[12, 11\]"),
    ],
)
def test_bad_splits(n_splits, gap, n_samples, groups, message):
    folds = TrajectoryKFold(n_splits, gap=gap)
    with pytest.raises(ValueError, match=message):
        list(folds.split(np.zeros((n_samples, 1)), groups=groups))


def test_gap_may_leave_a_row_on_each_side():
    [_, (train, test), _] = TrajectoryKFold(3, gap=3).split(np.zeros((12, 1)))
    assert_array_equal(test, [4, 5, 6, 7])
    assert_array_equal(train, [0, 11])


@pytest.mark.parametrize("name", ["n_splits", "gap"])
@pytest.mark.parametrize("value", [2.0, "2", None])
def test_parameters_are_integers(name, value):
    folds = TrajectoryKFold(**{name: value})
    with pytest.raises((TypeError, ValueError), match=f"^{name} must be"):
        list(folds.split(np.zeros((12, 1))))


def test_repr_and_keywords():
    assert repr(TrajectoryKFold(3, gap=2)) == "TrajectoryKFold(gap=2, n_splits=3)"
    assert (TrajectoryKFold().n_splits, TrajectoryKFold().gap) == (5, 0)
    with pytest.raises(TypeError, match="positional"):
        TrajectoryKFold(3, 2)


# --- in scikit-learn's model selection ----------------------------------------------


@pytest.fixture
def regression():
    """Groups of rows whose held-out scores all differ."""
    rng = np.random.default_rng(0)
    groups = np.repeat([0, 1, 2, 3], [30, 25, 20, 15])
    X = rng.normal(size=(90, 2)) + groups[:, None]
    y = X[:, 0] * groups + X[:, 1] + 0.1 * rng.normal(size=90)
    return X, y, groups


def held_out_score(estimator, X, y, test):
    return clone(estimator).fit(X[~test], y[~test]).score(X[test], y[test])


@pytest.mark.parametrize("routing", [False, True])
def test_cross_val_score_leaves_trajectories_out(regression, routing):
    X, y, groups = regression
    model = KNeighborsRegressor(3)
    # Four groups in two folds by size: {0, 3} and {1, 2}; in four, one each.
    expected = [held_out_score(model, X, y, groups == group) for group in range(4)]
    with config_context(enable_metadata_routing=routing):
        arguments = {"params": {"groups": groups}} if routing else {"groups": groups}
        four = cross_val_score(model, X, y, cv=TrajectoryKFold(4), **arguments)
        two = cross_val_score(model, X, y, cv=TrajectoryKFold(2), **arguments)
    assert_allclose(np.sort(four), np.sort(expected), rtol=1e-12)
    expected = [
        held_out_score(model, X, y, np.isin(groups, s)) for s in ([0, 3], [1, 2])
    ]
    assert_allclose(np.sort(two), np.sort(expected), rtol=1e-12)


def test_cross_val_score_without_groups_leaves_blocks_out(regression):
    X, y, _ = regression
    scores = cross_val_score(KNeighborsRegressor(3), X, y, cv=TrajectoryKFold(3, gap=5))
    near = [range(35), range(25, 65), range(55, 90)]
    expected = []
    for start, left_out in zip((0, 30, 60), near, strict=True):
        train = np.setdiff1d(np.arange(90), left_out)
        model = KNeighborsRegressor(3).fit(X[train], y[train])
        expected.append(model.score(X[start : start + 30], y[start : start + 30]))
    assert_allclose(scores, expected, rtol=1e-12)


@pytest.mark.parametrize("routing", [False, True])
def test_grid_search_leaves_trajectories_out(regression, routing):
    X, y, groups = regression
    grid = {"n_neighbors": [1, 4, 12]}
    with config_context(enable_metadata_routing=routing):
        search = GridSearchCV(KNeighborsRegressor(), grid, cv=TrajectoryKFold(4))
        search = clone(search).fit(X, y, groups=pd.Series(groups))
    expected = [
        np.mean(
            [
                held_out_score(KNeighborsRegressor(k), X, y, groups == group)
                for group in range(4)
            ]
        )
        for k in grid["n_neighbors"]
    ]
    assert_allclose(search.cv_results_["mean_test_score"], expected, rtol=1e-12)
    assert search.best_params_["n_neighbors"] == [1, 4, 12][np.argmax(expected)]


def test_object_array_of_trajectories_is_a_list():
    ragged = np.empty(2, dtype=object)
    ragged[:] = [np.arange(8.0).reshape(4, 2), np.arange(6.0).reshape(3, 2)]
    pairs = trajectory_pairs(ragged)
    assert_array_equal(pairs.X, trajectory_pairs(list(ragged)).X)


def test_frames_with_columns_in_another_order_are_refused():
    pd = pytest.importorskip("pandas", reason="frames are pandas'")
    first = pd.DataFrame({"hip": [0.0, 1, 2], "knee": [10.0, 11, 12]})
    with pytest.raises(
        ValueError, match=r"trajectories\[1\] has the columns.*one order"
    ):
        trajectory_pairs([first, first[["knee", "hip"]]])
