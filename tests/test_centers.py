"""Centres against plain loops, brute force and deeptime's regular space clustering."""

import pickle
import tracemalloc
from copy import deepcopy
from itertools import combinations, pairwise

import numpy as np
import pandas as pd
import pytest
from designs import every_pair
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum

# Random data of small extent, too, are compared with loops.
pytestmark = pytest.mark.filterwarnings("ignore:separation=.* leaves too few centres")

every_order = pytest.mark.parametrize("order", ["sequential", "farthest"])


def distances(X, x):
    return np.linalg.norm(X - x, axis=1)


def sequential_loop(X, separation):
    """Algorithm 1 of the paper, as it stands there."""
    kept = [0]
    for row in range(1, len(X)):
        if all(distances(X[kept], X[row]) > separation):
            kept.append(row)
    return kept


def farthest_loop(X, separation=0.0, max_centers=None):
    kept = [0]
    gap = distances(X, X[0])
    while len(kept) < (max_centers or len(X)) and gap.max() > separation:
        kept.append(int(gap.argmax()))  # the lowest of equally far ones
        gap = np.minimum(gap, distances(X, X[kept[-1]]))
    return kept


LOOPS = {"sequential": sequential_loop, "farthest": farthest_loop}


def all_distances(X, Y):
    return np.stack([distances(X, y) for y in Y], axis=1)


def make_data(kind, dimension, n_samples=400):
    rng = np.random.default_rng(dimension)
    if kind == "pendulum":
        # The orbit and its delayed copies, on a curve in any dimension.
        X = make_pendulum(n_samples, noise=0).X
        padded = np.vstack([X, X[: dimension // 2]])
        copies = [padded[i : i + n_samples] for i in range(dimension // 2 + 1)]
        return np.hstack(copies)[:, :dimension]
    steps = {"normal": rng.normal, "walk": rng.normal, "uniform": rng.uniform}
    X = steps[kind](size=(n_samples, dimension))
    return X.cumsum(axis=0) if kind == "walk" else X


every_data = pytest.mark.parametrize("kind", ["normal", "uniform", "walk", "pendulum"])
every_dimension = pytest.mark.parametrize("dimension", [2, 3, 5, 10, 30])
FRACTIONS = (0.03, 0.3, 0.7, 1.2, 1.5)  # of the median distance


# --- selection ----------------------------------------------------------------------


@every_data
@every_dimension
def test_sequential_is_the_double_loop(kind, dimension):
    X = make_data(kind, dimension, 250)
    typical = np.median(distances(X, X.mean(axis=0)))
    sizes = set()
    for separation in typical * np.array(FRACTIONS):
        actual = SeparatedCenterSelector(separation).fit(X).center_indices_
        assert_array_equal(actual, sequential_loop(X, separation))
        sizes.add(len(actual))
    assert len(sizes) > 1


@every_data
@every_dimension
def test_sequential_is_regular_space_clustering(kind, dimension):
    clustering = pytest.importorskip("deeptime.clustering", reason="the oracle")
    X = make_data(kind, dimension, 400)
    for fraction in FRACTIONS:
        separation = fraction * np.median(distances(X, X.mean(axis=0)))
        oracle = clustering.RegularSpace(dmin=separation, max_centers=len(X) + 1)
        selector = SeparatedCenterSelector(separation).fit(X)
        expected = oracle.fit(X).fetch_model().cluster_centers
        assert_array_equal(selector.cluster_centers_, expected)
        assert_array_equal(selector.cluster_centers_, X[selector.center_indices_])


@every_data
@every_dimension
def test_farthest_is_the_greedy_loop(kind, dimension):
    X = make_data(kind, dimension, 250)
    typical = np.median(distances(X, X.mean(axis=0)))
    for separation in typical * np.array(FRACTIONS):
        selector = SeparatedCenterSelector(separation, order="farthest").fit(X)
        assert_array_equal(selector.center_indices_, farthest_loop(X, separation))


@every_pair(
    order=["sequential", "farthest"], dimension=[1, 2, 3, 8], spacing=[1.0, 0.1, 1 / 3]
)
def test_ties_on_a_lattice(order, dimension, spacing):
    # In tenths and thirds equal distances differ in the last digit; the comparison is
    # that of the rounded distances, never of a kd-tree's squares.
    rng = np.random.default_rng(0)
    for _ in range(5):
        X = spacing * rng.integers(-3, 4, (150, dimension))
        for factor in (1, 2, np.sqrt(2), 5, 0.3 / 0.1):
            separation = spacing * factor
            selector = SeparatedCenterSelector(separation, order=order).fit(X)
            expected = LOOPS[order](X, separation)
            assert_array_equal(selector.center_indices_, expected)


def test_separation_is_strict():
    X = np.arange(10.0)[:, None]
    assert_array_equal(SeparatedCenterSelector(2).fit(X).center_indices_, [0, 3, 6, 9])
    below = np.nextafter(2, 0)
    kept = SeparatedCenterSelector(below).fit(X).center_indices_
    assert_array_equal(kept, [0, 2, 4, 6, 8])
    kept = SeparatedCenterSelector(5, order="farthest").fit(X[:6]).center_indices_
    assert_array_equal(kept, [0])


def test_pendulum_of_the_paper():
    selector = SeparatedCenterSelector(0.23).fit(make_pendulum().X)
    assert len(selector.center_indices_) == 37


def test_walking_is_the_double_loop(walking):
    angles = walking[0][0]
    assert len(angles) == 3199
    for order, separation in (("sequential", 0.02), ("farthest", 0.05)):
        selector = SeparatedCenterSelector(separation, order=order).fit(angles)
        expected = LOOPS[order](angles, separation)
        assert_array_equal(selector.center_indices_, expected)
        assert 50 < len(expected) < 1500


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    arrays(
        float,
        array_shapes(min_dims=2, max_dims=2, max_side=12),
        elements=st.integers(-6, 6).map(float),
    ),
    st.floats(0, 9),
    st.integers(-1000, 1000),
    st.sampled_from(["sequential", "farthest"]),
)
def test_centres_are_a_maximal_separated_set(X, separation, shift, order):
    selector = SeparatedCenterSelector(separation, order=order).fit(X)
    kept = selector.center_indices_
    between = all_distances(X, X[kept])
    assert kept[0] == 0
    assert len(set(kept)) == len(kept)
    assert (between[kept] + 1e9 * np.eye(len(kept)) > separation).all()
    assert (between.min(axis=1) <= separation).all()
    if order == "sequential":
        assert (np.diff(kept) > 0).all()
    # Distances of integers do not depend on where the integers lie.
    again = SeparatedCenterSelector(separation, order=order).fit(X + shift)
    assert_array_equal(again.center_indices_, kept)


@every_order
def test_zero_separation_keeps_each_distinct_row(order):
    rng = np.random.default_rng(1)
    X = rng.integers(0, 4, (200, 3)) / 3
    selector = SeparatedCenterSelector(0, order=order).fit(X)
    _, first = np.unique(X, axis=0, return_index=True)
    assert len(first) < 65
    assert_array_equal(np.sort(selector.center_indices_), np.sort(first))
    assert selector.fill_distance_ == 0
    # The nearest neighbour of 1 / 3 is one unit in the last place off.
    X = np.array([[1 / 3], [np.nextafter(1 / 3, 1)], [1 / 3]])
    selector = SeparatedCenterSelector(0, order=order).fit(X)
    assert_array_equal(selector.center_indices_, [0, 1])


@every_order
@pytest.mark.parametrize("copies", [1, 2, 3000])
def test_equal_rows(order, copies):
    selector = SeparatedCenterSelector(0, order=order).fit(np.full((copies, 2), 0.1))
    assert_array_equal(selector.center_indices_, [0])
    assert_array_equal(selector.labels_, np.zeros(copies))
    assert selector.separation_distance_ == np.inf
    assert selector.fill_distance_ == 0
    assert_array_equal(selector.transform([[0.1, 1.1]]), [[1.0]])


@every_order
def test_repeated_rows_do_not_change_the_centres(order):
    X = make_data("normal", 2, 80)
    rows = np.sort(np.random.default_rng(0).integers(0, 80, 2000))
    rows[0] = 0
    distinct = X[np.unique(rows)]
    expected = distinct[LOOPS[order](distinct, 0.4)]
    selector = SeparatedCenterSelector(0.4, order=order).fit(X[rows])
    assert_array_equal(selector.cluster_centers_, expected)
    assert_array_equal(X[rows][selector.center_indices_], expected)


# --- farthest first -----------------------------------------------------------------


def test_farthest_centres_are_nested():
    X = make_data("normal", 3)
    kept = SeparatedCenterSelector(0.5, order="farthest").fit(X).center_indices_
    for m in (1, 2, 7, len(kept) - 1, len(kept), len(kept) + 5):
        selector = SeparatedCenterSelector(0.5, order="farthest", max_centers=m)
        assert_array_equal(selector.fit(X).center_indices_, kept[:m])
    # Each next one lies as far off as the samples did.
    fills = [
        SeparatedCenterSelector(0, order="farthest", max_centers=m).fit(X)
        for m in range(1, 12)
    ]
    for before, after in pairwise(fills):
        gap = distances(before.cluster_centers_, after.cluster_centers_[-1]).min()
        assert_allclose(gap, before.fill_distance_, rtol=1e-14)


@pytest.mark.parametrize("seed", range(8))
def test_farthest_fills_within_twice_the_best(seed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(10, 2)) ** 3
    D = all_distances(X, X)
    for m in range(1, 5):
        best = min(D[:, s].min(axis=1).max() for s in combinations(range(10), m))
        selector = SeparatedCenterSelector(0, order="farthest", max_centers=m).fit(X)
        assert best <= selector.fill_distance_ * (1 + 1e-14)
        assert selector.fill_distance_ <= 2 * best


def test_max_centers_takes_the_first_in_order_of_the_rows():
    X = make_data("walk", 2)
    full = sequential_loop(X, 1.0)
    for m in (1, 5, len(full), len(full) + 1):
        selector = SeparatedCenterSelector(1.0, max_centers=m).fit(X)
        assert_array_equal(selector.center_indices_, full[:m])
        fill = all_distances(X, X[full[:m]]).min(axis=1).max()
        assert_allclose(selector.fill_distance_, fill, rtol=1e-14)
    assert SeparatedCenterSelector(1.0, max_centers=5).fit(X).fill_distance_ > 1


# --- batch by batch -----------------------------------------------------------------


def stream(selector, X, ends):
    """Fit to the batches that end at the given rows; none is empty."""
    ends = sorted({end for end in ends if 0 < end < len(X)})
    for batch in np.split(X, ends):
        assert selector.partial_fit(batch) is selector
    return selector


def check_stream(X, ends, **parameters):
    """Compare with one fit to all samples; return both selectors."""
    whole = SeparatedCenterSelector(**parameters).fit(X)
    parts = stream(SeparatedCenterSelector(**parameters), X, ends)
    assert_array_equal(parts.center_indices_, whole.center_indices_)
    assert_array_equal(parts.cluster_centers_, whole.cluster_centers_)
    assert parts.center_indices_.dtype == whole.center_indices_.dtype
    assert parts.n_samples_seen_ == whole.n_samples_seen_ == len(X)
    assert_allclose(parts.separation_distance_, whole.separation_distance_, rtol=1e-15)
    assert parts.fill_distance_ >= whole.fill_distance_ * (1 - 1e-15)
    if parameters.get("max_centers") is None:
        assert parts.fill_distance_ <= parameters["separation"]
    last = X[max([0, *(end for end in ends if 0 < end < len(X))]) :]
    nearest = all_distances(last, whole.cluster_centers_)
    rows = np.arange(len(last))
    assert_allclose(nearest[rows, parts.labels_], nearest.min(axis=1), rtol=1e-14)
    return whole, parts


def make_hard(kind, dimension, n_samples, seed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n_samples, dimension))
    if kind == "lattice":
        return 0.1 * rng.integers(-2, 3, (n_samples, dimension))
    if kind == "duplicates":
        return X[rng.integers(0, n_samples // 4 + 1, n_samples)]
    if kind == "line":
        return np.linspace(0, 4, n_samples)[:, np.newaxis] * np.ones(dimension)
    if kind == "clusters":
        return 1e-3 * X + rng.integers(0, 3, (n_samples, 1))
    if kind == "spread":
        return X * 10.0 ** rng.integers(-8, 3, (n_samples, 1))
    return X.cumsum(axis=0)


HARD = ["lattice", "duplicates", "line", "clusters", "spread", "walk"]
# Multiples of the lattice's spacing, met exactly by some distances and missed by
# others in the last digit; and what lies between them.
SEPARATIONS = [0.0, 0.1, 0.2, 0.1 * np.sqrt(2), 0.3, 1e-3, 0.7, 1.0, 3.0]


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(
    st.sampled_from(HARD),
    st.sampled_from([1, 2, 3, 5, 8, 9, 17, 30]),
    st.integers(1, 300),
    st.sampled_from(SEPARATIONS),
    st.sampled_from([(1.0, 0.0), (1.0, 1e8), (1e-140, 0.0), (1e120, 0.0), (0.3, -7)]),
    st.lists(st.integers(1, 299), max_size=8),
    st.none() | st.integers(1, 40),
    st.integers(0, 9),
)
def test_batches_give_the_centres_of_one_fit(
    kind, dimension, n_samples, separation, move, ends, max_centers, seed
):
    unit, offset = move
    X = unit * make_hard(kind, dimension, n_samples, seed) + offset
    # A first batch of values near zero alone is refused.
    X[0] = np.where(X[0] == 0, 0, np.maximum(np.abs(X[0]), unit))
    separation *= unit
    whole, _ = check_stream(X, ends, separation=separation, max_centers=max_centers)
    expected = sequential_loop(X, separation)[:max_centers]
    assert_array_equal(whole.center_indices_, expected)


@pytest.mark.parametrize("kind", HARD)
@pytest.mark.parametrize("dimension", [1, 3, 10])
def test_one_row_at_a_time(kind, dimension):
    X = make_hard(kind, dimension, 60, 3)
    for separation, max_centers in ((0.2, None), (0.7, None), (0.2, 5)):
        check_stream(X, range(60), separation=separation, max_centers=max_centers)


@pytest.mark.parametrize(
    "size", [pytest.param(1, marks=pytest.mark.slow), 7, 64, 65, 1000]
)
def test_small_batches_with_many_centres(size):
    # Enough for several trees, which merge many times.
    rng = np.random.default_rng(size)
    X = rng.uniform(size=(3000, 2))
    whole, parts = check_stream(X, range(0, 3000, size), separation=0.02)
    assert len(whole.center_indices_) > 1000
    sizes = [tree.n for tree in parts._trees]
    assert sum(sizes) == len(whole.center_indices_)
    assert all(before >= 2 * after for before, after in pairwise(sizes))
    held = np.vstack([tree.data for tree in parts._trees])
    assert_array_equal(held, parts.cluster_centers_)


@pytest.mark.slow
def test_ties_between_batches():
    # Whether 0.1 * 3 - 0.1 * 2 is above 0.1 is for rounding to say, the same in all.
    X = 0.1 * np.random.default_rng(0).integers(-4, 5, (300, 2))
    for separation in (0.1, 0.2, 0.1 * np.sqrt(2), 0.3, 0.5):
        expected = sequential_loop(X, separation)
        for size in (1, 10, 199):
            ends = range(0, 300, size)
            parts = stream(SeparatedCenterSelector(separation), X, ends)
            assert_array_equal(parts.center_indices_, expected)


def test_columns_in_memory_do_not_change_the_rounding():
    # NumPy adds the squares of columns in another order than those of rows.
    for seed in range(8):
        X = 0.1 * np.random.default_rng(seed).integers(-1, 2, (300, 12))
        for separation in (0.1, 0.2, 0.3, 0.4):
            expected = sequential_loop(X, separation)
            columns = np.asfortranarray(X)
            selector = SeparatedCenterSelector(separation).fit(columns)
            assert_array_equal(selector.center_indices_, expected)
            selector.fit(columns[:100]).partial_fit(columns[100:])
            assert_array_equal(selector.center_indices_, expected)


def test_fill_distance_of_batches_is_an_upper_bound():
    X = np.array([[0.0], [0.8], [1.1], [0.9]])
    whole = SeparatedCenterSelector(1.0).fit(X)
    parts = stream(SeparatedCenterSelector(1.0), X, [2])
    # 0.8 is measured before 1.1 is known.
    assert parts.fill_distance_ == 0.8
    assert_allclose(whole.fill_distance_, 0.3)
    assert stream(SeparatedCenterSelector(1.0), X, []).fill_distance_ < 0.31
    # Centres that reach their number leave samples uncovered.
    parts = SeparatedCenterSelector(1.0, max_centers=2)
    parts = stream(parts, np.arange(9.0)[:, np.newaxis], [5])
    assert_array_equal(parts.center_indices_, [0, 2])
    assert parts.fill_distance_ == 6
    assert_array_equal(parts.labels_, [1, 1, 1, 1])


def test_labels_are_those_of_the_last_batch():
    selector = SeparatedCenterSelector(1.0).fit([[0.0], [2.0], [4.0]])
    # Nearer to an old centre, to a new one of the same batch, to that itself.
    selector.partial_fit([[2.9], [5.4], [6.0], [3.2]])
    assert_array_equal(selector.center_indices_, [0, 1, 2, 4])
    assert_array_equal(selector.labels_, [1, 3, 3, 2])
    assert selector.separation_distance_ == (5.4 - 4.0) / 2


def test_fit_starts_anew_and_partial_fit_goes_on():
    X, Y = make_data("walk", 3), make_data("normal", 2)
    selector = stream(SeparatedCenterSelector(0.5), X, [100])
    selector.fit(Y[:300])
    assert selector.n_samples_seen_ == 300
    assert_array_equal(selector.center_indices_, sequential_loop(Y[:300], 0.5))
    selector.partial_fit(Y[300:])
    assert selector.n_samples_seen_ == 400
    assert_array_equal(selector.center_indices_, sequential_loop(Y, 0.5))
    # The centres found farthest first serve as a start, too.
    selector.set_params(order="farthest").fit(Y[:300])
    first = selector.center_indices_
    selector.set_params(order="sequential").partial_fit(Y[300:])
    assert_array_equal(selector.center_indices_[: len(first)], first)
    assert (all_distances(Y, selector.cluster_centers_).min(axis=1) <= 0.5).all()


@pytest.mark.parametrize("travel", [lambda s: pickle.loads(pickle.dumps(s)), deepcopy])
def test_batches_go_on_after_a_copy(travel):
    X = make_data("uniform", 3)
    selector = SeparatedCenterSelector(0.2)
    for batch in np.split(X, 8):
        selector = travel(selector.partial_fit(batch))
        assert not hasattr(selector, "_trees")
    assert_array_equal(selector.center_indices_, sequential_loop(X, 0.2))
    again = clone(selector)
    assert not hasattr(again, "n_samples_seen_")
    assert_array_equal(stream(again, X, [7]).cluster_centers_, X[again.center_indices_])
    assert_array_equal(again.center_indices_, selector.center_indices_)


def test_a_pickle_holds_the_centres_but_no_trees():
    X = make_data("uniform", 3)
    selector = stream(SeparatedCenterSelector(0.0), X, [200])
    arrays = selector.cluster_centers_, selector.center_indices_, selector.labels_
    assert len(pickle.dumps(selector)) < sum(a.nbytes for a in arrays) + 1500


def test_parameters_set_between_batches_hold_from_the_next_one():
    X = np.arange(10.0)[:, np.newaxis]
    selector = SeparatedCenterSelector(1.0).partial_fit(X[:4])
    assert_array_equal(selector.center_indices_, [0, 2])
    selector.set_params(separation=2.5).partial_fit(X[4:7])
    assert_array_equal(selector.center_indices_, [0, 2, 5])
    selector.set_params(separation=0.0, max_centers=2).partial_fit(X[7:9])
    assert_array_equal(selector.center_indices_, [0, 2, 5])
    selector.set_params(max_centers=None).partial_fit(X[9:])
    assert_array_equal(selector.center_indices_, [0, 2, 5, 9])
    assert_array_equal(selector.cluster_centers_, [[0], [2], [5], [9]])


def test_batches_hold_the_centres_and_one_batch_only():
    rng = np.random.default_rng(0)
    selector = SeparatedCenterSelector(0.1)
    for _ in range(10):
        selector.partial_fit(rng.uniform(size=(2000, 3)))
    tracemalloc.start()
    try:
        for _ in range(100):
            selector.partial_fit(rng.uniform(size=(2000, 3)))
        rest, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    centers = selector.cluster_centers_.nbytes
    assert selector.n_samples_seen_ == 220_000
    assert rest < 3 * centers + 2000 * 10
    assert peak < 10 * centers + 10 * 2000 * 3 * 8 < 220_000 * 3 * 8 / 4


# Some batches are arrays, though the first was a frame.
@pytest.mark.filterwarnings("ignore:X does not have valid feature names")
def test_batches_are_checked_and_leave_the_selector_as_it_was():
    X = make_data("normal", 2)
    frame = pd.DataFrame(X, columns=["hip", "knee"])
    selector = SeparatedCenterSelector(0.5).partial_fit(frame[:100])
    before = {**vars(selector)}
    for batch, message in (
        (X[:, :1], "X has 1 features, but SeparatedCenterSelector is expecting 2"),
        (frame[["knee", "hip"]], "feature names"),
        ([[0.0, np.nan]], "NaN"),
        (np.empty((0, 2)), r"0 sample\(s\)"),
        ([[1e200, 0.0]], "rescale X"),
    ):
        with pytest.raises(ValueError, match=message):
            selector.partial_fit(batch)
    for parameters in ({"separation": -1}, {"max_centers": 0}, {"order": "random"}):
        (name,) = parameters
        with pytest.raises(ValueError, match=f"^{name} must be"):
            clone(selector).set_params(**parameters).partial_fit(X)
        valid = selector.get_params()[name]
        with pytest.raises(ValueError, match=f"^{name} must be"):
            selector.set_params(**parameters).partial_fit(frame)
        selector.set_params(**{name: valid})
    after = vars(selector)
    assert after.keys() == before.keys()
    assert all(after[name] is before[name] for name in before)
    with pytest.warns(UserWarning, match="does not have valid feature names"):
        selector.partial_fit(X[100:])
    assert_array_equal(selector.center_indices_, sequential_loop(X, 0.5))
    assert_array_equal(selector.feature_names_in_, ["hip", "knee"])


def test_values_near_zero_are_fine_once_the_scale_is_known():
    selector = SeparatedCenterSelector().partial_fit([[0.0], [3.0]])
    selector.partial_fit([[1e-200]])
    assert_array_equal(selector.center_indices_, [0, 1])
    with pytest.raises(ValueError, match="1e-200"):
        SeparatedCenterSelector(1.0).partial_fit([[0.0]]).partial_fit([[1e-200]])


def test_farthest_first_has_no_batches():
    selector = SeparatedCenterSelector(order="farthest")
    assert not hasattr(selector, "partial_fit")
    assert not hasattr(selector.fit([[0.0], [3.0]]), "partial_fit")
    with pytest.raises(AttributeError, match="no attribute 'partial_fit'") as error:
        selector.partial_fit([[9.0]])
    assert "use order='sequential', or fit" in str(error.value.__cause__)


# --- fitted attributes and methods --------------------------------------------------


@every_order
@every_data
@pytest.mark.parametrize("dimension", [2, 10])
def test_attributes_and_methods_by_brute_force(order, kind, dimension):
    X, new = np.split(make_data(kind, dimension, 240), [200])
    selector = SeparatedCenterSelector(0.6, order=order).fit(X)
    centers = X[selector.center_indices_]
    between = all_distances(X, centers)
    assert_array_equal(selector.cluster_centers_, centers)
    assert_array_equal(selector.labels_, between.argmin(axis=1))
    assert_array_equal(selector.fit_predict(X), selector.labels_)
    assert_array_equal(selector.predict(X), selector.labels_)
    assert_allclose(selector.fill_distance_, between.min(axis=1).max(), rtol=1e-14)
    pairs = all_distances(centers, centers)
    nearest = pairs[~np.eye(len(centers), dtype=bool)].min()
    assert_allclose(selector.separation_distance_, nearest / 2, rtol=1e-14)
    assert 2 * selector.separation_distance_ > 0.6 >= selector.fill_distance_

    between = all_distances(new, centers)
    assert_allclose(selector.transform(new), between, rtol=1e-13)
    assert_array_equal(selector.predict(new), between.argmin(axis=1))
    assert_allclose(selector.fit_transform(X), all_distances(X, centers), rtol=1e-13)


def test_distances_of_centres_to_themselves_are_zero_far_from_the_origin():
    # The dot-product formula leaves about 1e-8 * |x| here.
    X = 1e6 + make_data("normal", 3, 100)
    selector = SeparatedCenterSelector(0.2).fit(X)
    between = selector.transform(X)
    m = len(selector.center_indices_)
    assert_array_equal(between[selector.center_indices_, range(m)], 0)
    assert_allclose(between, all_distances(X, selector.cluster_centers_), rtol=1e-14)


@every_order
def test_order_of_the_rows_matters(order):
    X = np.array([[0.0], [1.0], [2.0], [3.0], [4.0]])
    forward = SeparatedCenterSelector(1.5, order=order).fit(X)
    backward = SeparatedCenterSelector(1.5, order=order).fit(X[1:])
    expected = {"sequential": ([0, 2, 4], [0, 2]), "farthest": ([0, 4, 2], [0, 3])}
    assert_array_equal(forward.center_indices_, expected[order][0])
    assert_array_equal(backward.center_indices_, expected[order][1])


@every_order
def test_refit_forgets(order):
    X = make_data("normal", 3)
    selector = SeparatedCenterSelector(0.8, order=order).fit(make_data("walk", 2))
    assert_array_equal(selector.fit(X).center_indices_, LOOPS[order](X, 0.8))
    assert selector.n_features_in_ == 3


@every_order
def test_clone_and_pickle(order):
    X = make_data("uniform", 3)
    selector = SeparatedCenterSelector(0.3, order=order, max_centers=40).fit(X)
    same = clone(selector)
    assert not hasattr(same, "center_indices_")
    assert same.get_params() == selector.get_params()
    assert_array_equal(same.fit(X).center_indices_, selector.center_indices_)
    loaded = pickle.loads(pickle.dumps(selector))
    assert_array_equal(loaded.transform(X), selector.transform(X))
    assert_array_equal(loaded.predict(X), selector.labels_)


# --- forms of input -----------------------------------------------------------------


@every_order
def test_single_precision_is_taken_at_its_value(order):
    X = make_data("normal", 3).astype(np.float32)
    selector = SeparatedCenterSelector(0.5, order=order).fit(X)
    assert_array_equal(selector.center_indices_, LOOPS[order](X.astype(float), 0.5))
    assert selector.cluster_centers_.dtype == selector.transform(X).dtype == float


@every_order
def test_read_only_memory_map(order, tmp_path):
    X = make_data("normal", 3)
    np.save(tmp_path / "states.npy", X)
    mapped = np.load(tmp_path / "states.npy", mmap_mode="r")
    selector = SeparatedCenterSelector(0.5, order=order).fit(mapped)
    assert_array_equal(selector.center_indices_, LOOPS[order](X, 0.5))
    assert_array_equal(selector.predict(mapped), selector.labels_)


@every_order
@pytest.mark.parametrize("layout", [np.asfortranarray, lambda X: X[::-1][::-1], list])
def test_layout_of_the_array_does_not_matter(order, layout):
    X = make_data("normal", 3)
    selector = SeparatedCenterSelector(0.5, order=order).fit(layout(X))
    assert_array_equal(selector.center_indices_, LOOPS[order](X, 0.5))


def test_data_frames():
    X = make_data("normal", 2)
    frame = pd.DataFrame(X, columns=["hip", "knee"], index=range(1000, 1400))
    selector = SeparatedCenterSelector(0.5).fit(frame)
    kept = sequential_loop(X, 0.5)
    names = [f"separatedcenterselector{i}" for i in range(len(kept))]
    assert_array_equal(selector.center_indices_, kept)
    assert_array_equal(selector.feature_names_in_, ["hip", "knee"])
    assert_array_equal(selector.get_feature_names_out(), names)

    out = selector.set_output(transform="pandas").transform(frame)
    assert_array_equal(out.columns, names)
    assert_array_equal(out.index, frame.index)
    assert_allclose(out, all_distances(X, X[kept]), rtol=1e-13)
    with pytest.raises(ValueError, match="feature names"):
        selector.predict(frame[["knee", "hip"]])


def test_pipeline_separates_scaled_states():
    X = make_data("normal", 2) * [1, 1000]
    pipeline = make_pipeline(StandardScaler(), SeparatedCenterSelector(0.3)).fit(X)
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    kept = sequential_loop(scaled, 0.3)
    assert len(kept) != len(sequential_loop(X, 0.3))
    assert_array_equal(pipeline[-1].center_indices_, kept)
    assert_allclose(pipeline.transform(X), all_distances(scaled, scaled[kept]))


@pytest.mark.parametrize(
    "order", ["sequential", pytest.param("farthest", marks=pytest.mark.slow)]
)
def test_memory_is_linear(order):
    X = np.random.default_rng(0).normal(size=(20_000, 3))
    selector = SeparatedCenterSelector(0.2, order=order)
    tracemalloc.start()
    try:
        selector.fit(X)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    n_centers = len(selector.center_indices_)
    assert n_centers > 2000
    assert peak < 10 * X.nbytes < len(X) * n_centers * 8 / 60


# --- bad input ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"separation": -0.1}, "^separation must be .*non-negative.*got -0.1"),
        ({"separation": np.nan}, "^separation must be .*got nan"),
        ({"separation": np.inf}, "^separation must be .*got inf"),
        ({"separation": "0.1"}, "^separation must be .*got '0.1'"),
        ({"separation": None}, "^separation must be .*got None"),
        ({"separation": [0.1]}, r"^separation must be .*got \[0.1\]"),
        (
            {"order": "random"},
            "^order must be one of 'sequential', 'farthest', got 'ran",
        ),
        ({"order": None}, "^order must be .*got None"),
        ({"max_centers": 0}, "^max_centers must be .* got 0"),
        ({"max_centers": -3}, "^max_centers must be .* got -3"),
    ],
)
def test_bad_parameters(parameters, message):
    selector = SeparatedCenterSelector(**parameters)
    with pytest.raises(ValueError, match=message):
        selector.fit([[0.0], [1.0]])
    assert not hasattr(selector, "center_indices_")


@every_order
@pytest.mark.parametrize(
    ("X", "message"),
    [
        ([[0.0, np.nan]], "X contains NaN"),
        ([[0.0, -np.inf]], "X contains infinity"),
        ([0.0, 1.0], "Expected 2D array, got 1D"),
        (np.zeros((2, 2, 2)), "dim 3"),
        (np.empty((0, 2)), r"0 sample\(s\)"),
        (np.empty((2, 0)), r"0 feature\(s\)"),
        ([["a", "b"]], "'a'"),
        (np.array([[1j]]), "Complex"),
        ([[1.0], [1e200]], r"^X has values up to 1e\+200.*rescale X"),
        ([[0.0], [-1e-200]], "^X has values up to 1e-200.*rescale X"),
    ],
)
def test_bad_samples(order, X, message):
    selector = SeparatedCenterSelector(order=order)
    with pytest.raises(ValueError, match=message):
        selector.fit(X)
    assert not hasattr(selector, "center_indices_")


def test_methods_check_their_input():
    selector = SeparatedCenterSelector()
    for method in (selector.predict, selector.transform):
        with pytest.raises(NotFittedError):
            method([[0.0, 0.0]])
    selector.fit([[0.0, 0.0], [3.0, 0.0]])
    for method in (selector.predict, selector.transform):
        with pytest.raises(ValueError, match=r"3 features.* 2 features"):
            method([[0.0, 0.0, 0.0]])
        with pytest.raises(ValueError, match="NaN"):
            method([[0.0, np.nan]])


@every_order
def test_largest_and_smallest_scales(order):
    X = make_data("normal", 3, 100)
    expected = LOOPS[order](X, 0.5)
    for scale in (2.0**-480, 2.0**480):
        selector = SeparatedCenterSelector(0.5 * scale, order=order).fit(X * scale)
        assert_array_equal(selector.center_indices_, expected)
    for separation in (1e160, 1e308):
        selector = SeparatedCenterSelector(separation, order=order).fit(X)
        assert_array_equal(selector.center_indices_, [0])


@pytest.mark.parametrize("method", ["predict", "transform"])
def test_states_too_large_for_distances_are_refused_when_predicting(method):
    selector = SeparatedCenterSelector().fit([[0.0, 0.0], [3.0, 0.0]])
    with pytest.raises(ValueError, match=r"1e\+200.*rescale"):
        getattr(selector, method)([[1e200, 0.0]])
    assert_allclose(selector.transform([[1e-200, 0.0]]), [[0.0, 3.0]])


def test_distances_keep_their_bounds_on_lattices():
    """Where distances equal the separation up to rounding."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        X = 0.1 * rng.integers(-3, 4, (60, 8))
        for separation in (0.1, 0.2, 0.3, 0.4):
            selector = SeparatedCenterSelector(separation).fit(X)
            assert selector.fill_distance_ <= separation * (1 + 1e-15)
            assert 2 * selector.separation_distance_ > separation
