"""The analogs of a moment, against loops over the definition and closed forms."""

from functools import cache

import numpy as np
import pytest
from sklearn.base import clone

from sklearn_koopman._forecasting import _analogs
from sklearn_koopman._forecasting._analogs import Analogs, find_analogs

AGES, FOLLOWS = np.array([8, 8, 13, 30]), np.array([0, 5, 13, 30])
DEFAULTS = {
    "window": 4,
    "n_analogs": 3,
    "bandwidth": 3.0,
    "exclusion": 8,
    "max_past": None,
}


def find(states, piece=None, rows=None, ages=AGES, follows=FOLLOWS, **parameters):
    states = np.asarray(states, dtype=float).reshape(len(states), -1)
    piece = np.zeros(len(states), dtype=int) if piece is None else piece
    rows = np.arange(len(states)) if rows is None else np.asarray(rows)
    scale = np.asarray(parameters.pop("scale", np.ones(states.shape[1])))
    return find_analogs(
        states,
        piece,
        rows,
        np.asarray(ages),
        np.asarray(follows),
        scale=scale,
        **DEFAULTS | parameters,
    )


def find_by_loops(x, piece, row, age, follow, scale, parameters):
    """Return places and weights of the analogs of one row, from the definition."""
    window, exclusion = parameters["window"], parameters["exclusion"]

    def is_whole(first, last):
        return first >= 0 and piece[first] >= 0 and piece[first] == piece[last]

    @cache
    def distance(j):
        if j > row or not is_whole(j - window + 1, j):
            return None
        return sum(
            ((x[row - s, c] - x[j - s, c]) / scale[c]) ** 2
            for s in range(window)
            for c in range(x.shape[1])
        ) / (window * x.shape[1])

    if not is_whole(row - window + 1, row):
        return [], []
    past = parameters["max_past"]
    candidates = []
    for j in range(0 if past is None else max(row - past, 0), row - age + 1):
        d = distance(j)
        if d is None or not is_whole(j, j + follow):
            continue
        beside = [distance(j - 1), distance(j + 1)]
        if all(other is None or d <= other for other in beside):
            candidates.append((d, -j))
    picked = []
    for d, minus_j in sorted(candidates):
        if all(abs(j + minus_j) >= exclusion for j, _ in picked):
            picked.append((-minus_j, d))
    picked = picked[: parameters["n_analogs"]]
    if not picked:
        return [], []
    nearest = picked[0][1]
    raw = np.exp(
        [-(d - nearest) / (parameters["bandwidth"] * nearest) for _, d in picked]
    )
    return [j for j, _ in picked], raw / raw.sum()


def make_pieces(seed, n_rows=260):
    """A noisy oscillation in two columns: gaps of NaN, and one without a row."""
    rng = np.random.default_rng(seed)
    phase = np.cumsum(rng.uniform(0.2, 0.4, n_rows))
    x = np.column_stack([np.cos(phase), 3 * np.sin(2 * phase)])
    x += rng.normal(scale=0.3, size=x.shape)
    piece = np.zeros(n_rows, dtype=int)
    for number, start in enumerate(np.sort(rng.choice(np.arange(5, 250), 4, False)), 1):
        piece[start:] = number
        if number > 1:
            width = rng.integers(1, 4)
            x[start : start + width] = np.nan
    piece[np.isnan(x).any(axis=1)] = -1
    return x, piece


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"window": 1, "exclusion": 3, "n_analogs": 20},
        {"window": 7, "max_past": 60},
        {"window": 20, "exclusion": 1, "bandwidth": 0.5},
        {"n_analogs": 1, "max_past": 13},
    ],
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_equals_loops_over_the_definition(seed, parameters):
    x, piece = make_pieces(seed)
    scale = np.array([0.7, 2.0])
    found = find(x, piece, scale=scale, **parameters)
    n_analogs = 0
    for row in range(len(x)):
        for k, (age, follow) in enumerate(zip(AGES, FOLLOWS, strict=True)):
            places, weights = find_by_loops(
                x, piece, row, age, follow, scale, DEFAULTS | parameters
            )
            n, n_analogs = len(places), n_analogs + len(places)
            assert found.places[row, k, :n].tolist() == places
            assert (found.places[row, k, n:] == -1).all()
            np.testing.assert_allclose(found.weights[row, k, :n], weights, atol=1e-12)
            assert (found.weights[row, k, n:] == 0).all()
    assert n_analogs > 300


def test_weights_sum_to_one_or_are_zero():
    x, piece = make_pieces(3)
    found = find(x, piece)
    total = found.weights.sum(axis=2)
    has_analogs = found.places[..., 0] >= 0
    np.testing.assert_allclose(total[has_analogs], 1, rtol=1e-14)
    assert (total[~has_analogs] == 0).all()
    assert 0.5 < has_analogs.mean() < 1


def test_periodic_motion_is_forecast_exactly():
    period = np.random.default_rng(0).normal(size=(40, 2))
    x = np.tile(period, (6, 1))
    found = find(x, rows=[150, 239])
    for row, places, weights in zip([150, 239], *found, strict=True):
        assert places[0].tolist() == [row - 40, row - 80, row - 120]
        assert (places == places[0]).all()
        assert (weights == 1 / 3).all()
        for k, h in enumerate(FOLLOWS):
            forecast = weights[k] @ x[places[k] + h]
            np.testing.assert_allclose(forecast, period[(row + h) % 40], rtol=1e-14)


def test_only_exact_repetitions_have_weight():
    rng = np.random.default_rng(1)
    x = np.tile(rng.normal(size=(40, 2)), (5, 1))
    x[:120] += 0.1 * rng.normal(size=(120, 2))
    x[77:82] = x[157:162] = x[37:42]
    found = find(x, rows=[158], window=2)
    # Rows 37 to 41 repeat: windows of 2 that end in 38 to 41.
    assert found.places[0, 0, :2].tolist() == [78, 38]
    assert found.weights[0, 0].tolist() == [0.5, 0.5, 0]


@pytest.mark.parametrize(("error", "is_shared"), [(1e-15, True), (1e-12, False)])
def test_differences_by_rounding_are_none(error, is_shared):
    # Values of some 1000 with a spread of 1, as positions in a laboratory have.
    period = 1000 + np.random.default_rng(2).normal(size=(40, 2))
    x = np.tile(period, (4, 1))
    x[:80] *= 1 + error * np.random.default_rng(3).choice([-1, 1], size=(80, 2))
    found = find(x, rows=[155])
    weights = [1 / 3] * 3 if is_shared else [1, 0, 0]
    assert found.weights[0].tolist() == [weights] * 4
    assert found.places[0, 0, 0] == 115


def test_nothing_depends_on_the_future():
    x, piece = make_pieces(4)
    whole = find(x, piece)
    rng = np.random.default_rng(5)
    for row in [60, 120, 199, 258]:
        other, other_piece = x.copy(), piece.copy()
        other[row + 1 :] = rng.normal(size=(len(x) - row - 1, 2))
        other_piece[row + 1 :] = rng.choice([piece[row], piece[row] + 1])
        for part in [
            find(other, other_piece),
            find(x[: row + 1], piece[: row + 1]),
            find(x[: row + 1], piece[: row + 1], rows=[row]),
        ]:
            n = min(len(part.places), row + 1)
            for ours, theirs in zip(part, whole, strict=True):
                expected = theirs[row + 1 - n : row + 1]
                np.testing.assert_array_equal(ours[:n], expected)


@pytest.mark.parametrize("max_past", [None, 50])
def test_rows_do_not_depend_on_each_other(max_past):
    x, piece = make_pieces(6)
    whole = find(x, piece, max_past=max_past)
    subset = np.flatnonzero(np.random.default_rng(7).uniform(size=len(x)) < 0.4)
    part = find(x, piece, rows=subset, max_past=max_past)
    for ours, theirs in zip(part, whole, strict=True):
        np.testing.assert_array_equal(ours, theirs[subset])


@pytest.mark.parametrize("max_past", [None, 50])
def test_size_of_blocks_does_not_matter(max_past, monkeypatch):
    x, piece = make_pieces(8)
    whole = find(x, piece, max_past=max_past)
    for entries in [1, 2000, 20_000]:
        monkeypatch.setattr(_analogs, "BLOCK_ENTRIES", entries)
        part = find(x, piece, max_past=max_past)
        for ours, theirs in zip(part, whole, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_max_past_bounds_what_is_read():
    x, _ = make_pieces(9)
    x = np.where(np.isnan(x), 0.1, x)
    bounded = find(x, rows=[259], max_past=70)
    assert bounded.places[bounded.places >= 0].min() >= 259 - 70
    n_rows = 70 + DEFAULTS["window"] + 1
    tail = find(x[-n_rows:], rows=[n_rows - 1], max_past=70)
    np.testing.assert_array_equal(tail.weights, bounded.weights)
    shifted = np.where(tail.places < 0, -1, tail.places + 260 - n_rows)
    np.testing.assert_array_equal(shifted, bounded.places)


def test_all_analogs_keep_their_places():
    x, piece = make_pieces(10)
    found = find(x, piece, n_analogs=5)
    row, k, _ = np.nonzero(found.places >= 0)
    places = found.places[found.places >= 0]
    assert (row - places >= AGES[k]).all()
    assert (piece[places] == piece[places + FOLLOWS[k]]).all()
    assert (piece[places] == piece[places - 3]).all()
    assert (piece[places] != piece[row]).any()
    ordered = np.sort(found.places, axis=2)
    apart = np.diff(ordered, axis=2)[ordered[..., :-1] >= 0]
    assert apart.min() >= DEFAULTS["exclusion"]


def test_equal_windows_share_from_the_latest_on():
    found = find(np.full(60, 0.1), rows=[59], ages=[8, 13], follows=[0, 13])
    assert found.places[0].tolist() == [[51, 43, 35], [46, 38, 30]]
    assert (found.weights == 1 / 3).all()


def test_the_end_of_the_range_is_no_minimum():
    # Along a ramp the distance falls up to the present row.
    assert (find(np.arange(100.0)).places == -1).all()


def test_ends_of_a_piece_may_be_minima():
    ramp = np.arange(12.0)
    x = np.concatenate([ramp, [np.nan], ramp + 5, [np.nan], ramp - 5])
    piece = np.repeat([0, -1, 1, -1, 2], [12, 1, 12, 1, 12])
    found = find(x, piece, rows=[17, 37], ages=[8, 8], follows=[0, 1])
    # Row 17 is 9, as row 9. Row 37 is 6, as row 6; below all of the second piece, whose
    # first window ends in row 16 with 8.
    assert found.places[0].tolist() == [[9, -1, -1]] * 2
    assert found.places[1].tolist() == [[6, 16, -1]] * 2
    # Row 24 is 16, above all of the first piece; nothing is known to follow that.
    found = find(x, piece, rows=[24], ages=[8, 8], follows=[0, 1])
    assert found.places[0].tolist() == [[11, -1, -1], [-1, -1, -1]]


def test_scale_weighs_the_columns():
    x, piece = make_pieces(11)
    alone = find(x[:, :1], piece)
    scaled = find(x, piece, scale=[1.0, 1e100])
    np.testing.assert_array_equal(alone.places, scaled.places)
    np.testing.assert_allclose(alone.weights, scaled.weights, rtol=1e-12)
    units = np.array([0.25, 1024.0])
    ours, theirs = find(x * units, piece, scale=units), find(x, piece)
    np.testing.assert_array_equal(ours.places, theirs.places)
    np.testing.assert_array_equal(ours.weights, theirs.weights)


def test_wide_bandwidths_give_equal_weights_and_narrow_ones_the_nearest():
    x, piece = make_pieces(12)
    wide, narrow = (find(x, piece, bandwidth=b) for b in (1e12, 1e-300))
    np.testing.assert_array_equal(wide.places, narrow.places)
    counts = (wide.places >= 0).sum(axis=2, keepdims=True)
    equal = np.where(wide.places >= 0, 1 / np.maximum(counts, 1), 0)
    np.testing.assert_allclose(wide.weights, equal, rtol=1e-8)
    assert (narrow.weights[..., 1:] == 0).all()
    assert (narrow.weights[..., :1] == (counts > 0)).all()


@pytest.mark.parametrize(
    ("n_rows", "window"), [(1, 1), (1, 4), (3, 4), (8, 1), (11, 4), (30, 40)]
)
def test_short_recordings_have_no_analogs(n_rows, window):
    x = np.random.default_rng(0).normal(size=(n_rows, 2))
    found = find(x, window=window)
    assert found.places.shape == found.weights.shape == (n_rows, 4, 3)
    assert (found.places == -1).all()
    assert (found.weights == 0).all()


def test_rows_in_gaps_and_without_a_window_have_no_analogs():
    x, piece = make_pieces(13)
    gap = np.flatnonzero(piece == -1)
    found = find(x, piece, rows=np.unique(np.concatenate([gap, gap + 1, gap + 3])))
    assert (found.places == -1).all()
    assert find(x, piece, rows=np.array([], dtype=int)).places.shape == (0, 4, 3)


def test_parameters_left_open_follow_the_delays():
    analogs = Analogs(n_analogs=7, bandwidth=2.0, max_past=500)
    resolved = analogs.resolve(np.array([0, 5, 20]))
    assert resolved.get_params() == {
        "window": 21,
        "n_analogs": 7,
        "bandwidth": 2.0,
        "exclusion": 42,
        "max_past": 500,
    }
    assert analogs.window is None
    assert Analogs().resolve([0, 5]).window == 10
    assert Analogs(window=6).resolve([0, 5, 20]).exclusion == 12
    assert Analogs(exclusion=1).resolve([0]).get_params()["exclusion"] == 1
    assert clone(analogs).get_params() == analogs.get_params()


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        ("window", 0),
        ("window", 2.5),
        ("n_analogs", 0),
        ("n_analogs", None),
        ("bandwidth", 0.0),
        ("bandwidth", np.nan),
        ("exclusion", 0),
        ("exclusion", "auto"),
        ("max_past", 0),
        ("max_past", True),
    ],
)
def test_parameters_outside_their_range_are_refused(parameter, value):
    analogs = Analogs(**{parameter: value})
    with pytest.raises(ValueError, match=rf"baseline\.{parameter} must be .*got"):
        analogs.check()
    with pytest.raises(ValueError, match=rf"baseline\.{parameter} must be"):
        analogs.resolve([0])


def test_a_past_without_analogs_is_refused():
    Analogs(max_past=20).resolve([0])
    with pytest.raises(ValueError, match=r"max_past must be at least exclusion=20"):
        Analogs(max_past=19).resolve([0])


@pytest.mark.slow
def test_walking_is_forecast_by_its_own_past(walking):
    """As a prototype by loops: ankle at 150 Hz, windows of 20 samples."""
    trials = [np.hstack(pair) for pair in zip(*walking, strict=True)]
    horizons = np.array([15, 30, 45, 75, 112, 150])
    errors = [[] for _ in horizons]
    for x in trials:
        found = find(
            x,
            ages=np.maximum(horizons, 40),
            follows=horizons,
            scale=np.concatenate(trials).std(axis=0),
            window=20,
            exclusion=40,
            n_analogs=10,
        )
        rows = np.arange(335, len(x) - 150)
        for k, h in enumerate(horizons):
            places, weights = found.places[rows, k], found.weights[rows, k]
            forecast = np.einsum("ij,ijk->ik", weights, x[places + h, 2:])
            errors[k].append(((forecast - x[rows + h, 2:]) ** 2).sum(axis=1))
    rms = [np.sqrt(np.concatenate(error).mean()) for error in errors]
    np.testing.assert_allclose(rms, [12.3, 14.7, 17.4, 23.5, 31.4, 37.9], atol=0.12)
