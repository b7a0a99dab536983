"""Bands from units left out: quantiles by hand, and what the bands cover."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import erf

from sklearn_koopman._forecasting._calibration import (
    GUARANTEES,
    check_coverage,
    count_units,
    largest_scores,
    mixture_quantile,
    pooled_quantile,
    symmetric_band,
)
from sklearn_koopman._forecasting._calibration import minmax_band as minmax_of_rows
from sklearn_koopman._forecasting._calibration import plus_band as plus_of_rows


def plus_band(predictions, scores, units, models, scale, coverage):
    """The band where the scale of a model is the same in all rows."""
    return plus_of_rows(
        predictions, scores, units, models, scale[:, np.newaxis], coverage
    )


def minmax_band(predictions, scores, units, models, scale, coverage):
    """The band where the scale of a model is the same in all rows."""
    return minmax_of_rows(
        predictions, scores, units, models, scale[:, np.newaxis], coverage
    )


# Means of draws are compared with what is promised less this many standard errors of
# the mean: a true promise fails for one seed in 30,000.
N_ERRORS = 4.0


def by_hand(values, masses, level):
    """Sort the points of a distribution, infinity last, and add up their masses."""
    points = sorted(zip(values, masses, strict=True))
    reached = 0.0
    for value, mass in points:
        reached += mass
        if reached >= level - 1e-12:
            return value
    return np.inf


def masses_of(units):
    """Return 1 / (K + 1) a unit, spread over its rows."""
    names, n_rows = np.unique(units, return_counts=True)
    shares = dict(zip(names, 1 / n_rows / (len(names) + 1), strict=True))
    return [shares[unit] for unit in units]


def ragged(rng, n_units, longest=40):
    """Draw scores of units of different sizes, in mixed order, some missing."""
    n_rows = rng.integers(1, longest, n_units)
    units = rng.permutation(np.repeat(np.arange(n_units), n_rows))
    scores = rng.exponential(size=(len(units), 2, 3))
    scores[rng.random(scores.shape) < 0.2] = np.nan
    return scores, units


def covered(low, high, outcomes):
    return ((low <= outcomes) & (outcomes <= high)).mean()


def assert_at_least(shares, promised):
    error = np.std(shares) / np.sqrt(len(shares))
    assert np.mean(shares) >= promised - N_ERRORS * error


# --- quantiles ----------------------------------------------------------------------


@pytest.mark.parametrize("coverage", [0.05, 0.5, 0.8, 0.9, 0.97])
@pytest.mark.parametrize("n_units", [1, 4, 12, 35])
def test_mixture_quantile_is_that_by_hand(n_units, coverage):
    rng = np.random.default_rng(n_units)
    scores, units = ragged(rng, n_units)
    found = mixture_quantile(scores, units, coverage)
    for cell in np.ndindex(2, 3):
        column = scores[(slice(None), *cell)]
        kept = ~np.isnan(column)
        masses = masses_of(units[kept])
        assert found[cell] == by_hand(column[kept], masses, coverage)


def test_nine_units_at_90_percent_take_the_largest_score_of_all():
    rng = np.random.default_rng(0)
    units = np.repeat(np.arange(9), rng.integers(1, 50, 9))
    scores = rng.exponential(size=(len(units), 2, 1))
    assert_array_equal(mixture_quantile(scores, units, 0.9), scores.max(axis=0))
    # The largest unit-mass that may be left above is zero: one row less is too low.
    eight = units < 8
    assert_array_equal(mixture_quantile(scores[eight], units[eight], 0.9), np.inf)


@pytest.mark.parametrize(
    ("n_units", "coverage", "rank"), [(19, 0.9, 18), (19, 0.95, 19), (4, 0.5, 3)]
)
def test_units_of_one_row_give_the_split_conformal_rank(n_units, coverage, rank):
    # The ceil((K + 1) coverage)-th smallest of K scores.
    scores = np.random.default_rng(1).permutation(n_units) + 1.0
    found = mixture_quantile(scores.reshape(-1, 1, 1), np.arange(n_units), coverage)
    assert found.item() == rank


def test_rows_repeated_change_nothing():
    scores, units = ragged(np.random.default_rng(2), 15)
    short = units < 7
    again = np.concatenate([scores, scores[short]])
    found = mixture_quantile(again, np.concatenate([units, units[short]]), 0.8)
    assert_array_equal(found, mixture_quantile(scores, units, 0.8))
    assert (pooled_quantile(again, 0.8) != pooled_quantile(scores, 0.8)).any()


def test_a_unit_without_a_score_does_not_count_there():
    scores, units = ragged(np.random.default_rng(3), 12)
    scores[units == 5, 1] = np.nan
    kept = units != 5
    assert_array_equal(count_units(scores, units), [[12] * 3, [11] * 3])
    found = mixture_quantile(scores, units, 0.7)
    without = mixture_quantile(scores[kept], units[kept], 0.7)
    assert_array_equal(found[1], without[1])
    assert (found[0] != without[0]).any()


def test_pooled_quantile_counts_every_row_alike():
    scores, _ = ragged(np.random.default_rng(4), 6)
    found = pooled_quantile(scores, 0.9)
    for cell in np.ndindex(2, 3):
        column = scores[(slice(None), *cell)]
        expected = np.nanquantile(column, 0.9, method="inverted_cdf")
        assert found[cell] == expected
    # Nine tenths of ten rows are nine, whatever 0.9 is in binary.
    assert pooled_quantile(np.arange(10.0).reshape(-1, 1, 1), 0.9).item() == 8
    assert pooled_quantile(np.full((3, 1, 1), np.nan), 0.9).item() == np.inf


def test_infinite_scores_stay_above_all_others():
    scores = np.array([1.0, 2.0, np.inf, 4.0]).reshape(-1, 1, 1)
    units = np.arange(4)
    assert mixture_quantile(scores, units, 0.6).item() == 4
    assert mixture_quantile(scores, units, 0.8).item() == np.inf


def test_largest_scores_are_of_rows_that_have_all():
    scores = np.array([[[1.0, 2.0], [3.0, 0.5]], [[9.0, 1.0], [np.nan, 1.0]]])
    assert_array_equal(largest_scores(scores), [[[3.0]], [[np.nan]]])


def test_symmetric_band():
    predictions = np.array([[[1.0, 2.0]], [[np.nan, 4.0]]])
    band = symmetric_band(predictions, np.array([[0.5, np.inf]]))
    expected = [[[[0.5, 1.5], [-np.inf, np.inf]]], [[[np.nan] * 2, [-np.inf, np.inf]]]]
    assert_array_equal(band, expected)


# --- how much coverage units support ------------------------------------------------


@pytest.mark.parametrize("n_units", [1, 4, 9, 19, 99, 999])
def test_units_support_their_number_over_one_more(n_units):
    check_coverage(n_units / (n_units + 1), n_units)
    with pytest.raises(ValueError, match=f"needs {n_units + 1} units"):
        check_coverage((n_units + 1) / (n_units + 2), n_units)
    scores = np.ones((n_units, 1, 1))
    units = np.arange(n_units)
    assert mixture_quantile(scores, units, n_units / (n_units + 1)).item() == 1
    assert mixture_quantile(scores, units, n_units / (n_units + 1) + 1e-6) == np.inf


def test_too_few_units_are_told_the_remedies():
    with pytest.raises(ValueError) as error:
        check_coverage(0.9, 4)
    message = str(error.value)
    assert "needs 9 units" in message
    assert "but 4 have errors; these support at most 4/5" in message
    assert "at most 0.8, or" in message
    assert "method='pooled'" in message
    with pytest.raises(ValueError, match="7 have errors at some horizon"):
        check_coverage(0.9, np.array([[12], [7]]))
    with pytest.raises(ValueError, match=r"0 have errors; .* with more of them, or"):
        check_coverage(0.9, 0)


@pytest.mark.parametrize("lowered", [12, 13, 27, 700])
def test_the_coverage_that_is_proposed_is_supported(lowered):
    with pytest.raises(ValueError) as error:
        check_coverage(0.9999, lowered)
    proposed = str(error.value).partition("coverage of at most ")[2].partition(",")[0]
    check_coverage(float(proposed), lowered)


@pytest.mark.parametrize("coverage", [0, 1, 90, -0.1, np.nan, "0.9", True, None])
def test_coverage_lies_between_0_and_1(coverage):
    with pytest.raises(ValueError, match="coverage must be"):
        check_coverage(coverage, 100)


# --- bands of models that have left out units ---------------------------------------


def draw_models(rng, n_units, n_models, size):
    scores, units = ragged(rng, n_units)
    models = np.concatenate(
        [np.arange(n_models), rng.integers(0, n_models, n_units - n_models)]
    )
    predictions = 3 + size * rng.normal(size=(n_models, 6, 2, 3))
    scale = rng.uniform(0.5, 2.0, (n_models, 2, 3))
    return predictions, scores, units, models, scale


@pytest.mark.parametrize("size", [0.0, 1e-8, 0.5, 1e4])
@pytest.mark.parametrize(
    ("n_units", "n_models", "coverage"),
    [(1, 1, 0.4), (5, 5, 0.8), (12, 12, 0.9), (12, 3, 0.6), (30, 10, 0.05)],
)
def test_plus_is_the_quantile_by_hand(n_units, n_models, coverage, size):
    rng = np.random.default_rng(n_units)
    drawn = draw_models(rng, n_units, n_models, size)
    predictions, scores, units, models, scale = drawn
    found = plus_band(*drawn, coverage)
    for cell in np.ndindex(2, 3):
        column = scores[(slice(None), *cell)]
        kept = np.flatnonzero(~np.isnan(column))
        model = models[units[kept]]
        sizes = column[kept] * scale[(model, *cell)]
        masses = masses_of(units[kept])
        for row in range(6):
            means = predictions[(model, row, *cell)]
            lower = -by_hand(sizes - means, masses, coverage)
            upper = by_hand(sizes + means, masses, coverage)
            expected = np.array([lower, upper])
            rounding = 1e-14 * (np.abs(means).max() + sizes.max())
            assert_allclose(found[(row, *cell)], expected, rtol=0, atol=rounding)


def test_plus_with_equal_sums():
    # Rounded values: many rows share the sum of a prediction and an error.
    rng = np.random.default_rng(5)
    predictions, scores, units, models, scale = draw_models(rng, 9, 9, 0.3)
    predictions, scores = predictions.round(1), scores.round(1)
    found = plus_band(predictions, scores, units, models, np.ones_like(scale), 0.7)
    assert_allclose(found, found.round(1), rtol=0, atol=1e-12)
    shifted = scores[:, 0, 0] + predictions[units, 0, 0, 0]
    kept = ~np.isnan(shifted)
    expected = by_hand(shifted[kept], masses_of(units[kept]), 0.7)
    assert_allclose(found[0, 0, 0, 1], expected, rtol=1e-14)


def test_models_that_agree_give_the_band_of_the_mixture():
    drawn = draw_models(np.random.default_rng(6), 12, 12, 0.5)
    predictions, scores, units, models, scale = drawn
    same = np.broadcast_to(predictions[:1], predictions.shape)
    scale = np.broadcast_to(scale[:1], scale.shape)
    half_width = mixture_quantile(scores, units, 0.9) * scale[0]
    expected = symmetric_band(predictions[0], half_width)
    for band in (plus_band, minmax_band):
        found = band(same, scores, units, models, scale, 0.9)
        assert_allclose(found, expected, rtol=1e-13)


def test_minmax_is_the_widest_of_all_models_and_holds_plus():
    drawn = draw_models(np.random.default_rng(7), 12, 4, 0.5)
    predictions, scores, units, _, scale = drawn
    half_width = (mixture_quantile(scores, units, 0.8) * scale)[:, np.newaxis]
    band = minmax_band(*drawn, 0.8)
    assert_array_equal(band[..., 0], (predictions - half_width).min(axis=0))
    assert_array_equal(band[..., 1], (predictions + half_width).max(axis=0))
    # With one scale for all models, as each prediction lies between the extremes.
    drawn = (*drawn[:4], np.ones_like(scale))
    band, plus = minmax_band(*drawn, 0.8), plus_band(*drawn, 0.8)
    assert (band[..., 0] <= plus[..., 0]).all()
    assert (plus[..., 1] <= band[..., 1]).all()
    assert (plus != band).any()


def test_order_of_rows_and_numbers_of_models_do_not_matter():
    drawn = draw_models(np.random.default_rng(8), 10, 5, 0.5)
    predictions, scores, units, models, scale = drawn
    rng = np.random.default_rng(9)
    rows, order = rng.permutation(len(units)), rng.permutation(5)
    others = (predictions[order], scores[rows], units[rows], np.argsort(order)[models])
    for band in (plus_band, minmax_band):
        found = band(*others, scale[order], 0.7)
        assert_allclose(found, band(*drawn, 0.7), rtol=1e-14)


@pytest.mark.parametrize("band", [plus_band, minmax_band])
def test_bands_by_largest_scores_take_one_quantile_for_all(band):
    drawn = draw_models(np.random.default_rng(10), 12, 12, 0.5)
    predictions, scores, units, models, scale = drawn
    largest = largest_scores(scores)
    found = band(predictions, largest, units, models, scale, 0.7)
    everywhere = np.broadcast_to(largest, scores.shape)
    assert_array_equal(found, band(predictions, everywhere, units, models, scale, 0.7))
    assert (found[..., 1] > band(*drawn, 0.7)[..., 1]).all()


@pytest.mark.parametrize("band", [plus_band, minmax_band])
def test_bands_end_where_they_know_nothing(band):
    drawn = draw_models(np.random.default_rng(11), 4, 4, 0.5)
    predictions, scores = drawn[:2]
    predictions[2, 3, 1, 0] = np.nan
    scores[:, 0, 2] = np.nan
    found = band(*drawn, 0.7)
    assert np.isnan(found[3, 1, 0]).all()
    assert_array_equal(found[:, 0, 2], np.tile([-np.inf, np.inf], (6, 1)))
    rest = np.ones((6, 2, 3), dtype=bool)
    rest[3, 1, 0], rest[:, 0, 2] = False, False
    assert np.isfinite(found[rest]).all()
    # More than four units support.
    wide = band(*drawn, 0.81)
    assert_array_equal(np.isnan(wide), np.isnan(found))
    assert np.isinf(wide[~np.isnan(wide)]).all()


@pytest.mark.parametrize("band", [plus_band, minmax_band])
def test_rounding_of_the_coverage_opens_no_band(band):
    drawn = draw_models(np.random.default_rng(16), 9, 9, 0.5)
    drawn[1][np.isnan(drawn[1])] = 1.0  # nine units everywhere
    rounded = 0.9 + 1e-10
    check_coverage(rounded, 9)
    assert_array_equal(band(*drawn, rounded), band(*drawn, 0.9))
    assert np.isfinite(band(*drawn, 0.9)).all()


def test_a_model_that_diverges_leaves_the_band_open():
    drawn = draw_models(np.random.default_rng(15), 9, 9, 0.5)
    drawn[0][4, 2, 0, 1] = -np.inf
    found = plus_band(*drawn, 0.7)
    assert_array_equal(found[2, 0, 1], [-np.inf, np.inf])
    assert np.count_nonzero(np.isinf(found)) == 2


# --- what the bands cover -----------------------------------------------------------


def draw_noisy_short(rng, n_units):
    """Draw errors of units of which half are short, with errors twice as large."""
    is_short = rng.random(n_units) < 0.5
    n_rows, size = np.where(is_short, 20, 400), np.where(is_short, 2.0, 1.0)
    units = np.repeat(np.arange(n_units), n_rows)
    return np.abs(size[units] * rng.normal(size=len(units))).reshape(-1, 1, 1), units


def share_below(limit):
    """Return the expected share of the rows of a new unit with errors below a limit."""
    return (erf(limit / np.sqrt(2)) + erf(limit / np.sqrt(8))) / 2


def test_the_mixture_covers_where_pooling_does_not():
    rng = np.random.default_rng(12)
    mixed, pooled = [], []
    for _ in range(200):
        scores, units = draw_noisy_short(rng, 20)
        mixed.append(share_below(mixture_quantile(scores, units, 0.9).item()))
        pooled.append(share_below(pooled_quantile(scores, 0.9).item()))
    assert_at_least(mixed, 0.9)
    # At most one unit of 21 more than is promised (Lee, Barber and Willett).
    assert np.mean(mixed) < 0.9 + 1 / 21
    assert 0.74 < np.mean(pooled) < 0.79


def test_all_horizons_are_covered_at_once():
    rng = np.random.default_rng(13)
    together, apart = [], []
    n_rows = np.tile([3, 8, 20], 8)
    for _ in range(150):
        unit_size = rng.lognormal(sigma=0.4, size=25)
        units = np.repeat(np.arange(25), [*n_rows, 30])
        errors = unit_size[units, np.newaxis, np.newaxis] * rng.normal(
            size=(len(units), 4, 2)
        )
        scores, known = np.abs(errors) * [1.0, 5.0], units < 24
        scale = np.array([1.0, 5.0])
        scores /= scale
        limit = mixture_quantile(largest_scores(scores[known]), units[known], 0.8)
        together.append((scores[~known] <= limit).all(axis=(1, 2)).mean())
        limit = mixture_quantile(scores[known], units[known], 0.8)
        apart.append((scores[~known] <= limit).all(axis=(1, 2)).mean())
    assert_at_least(together, 0.8)
    assert np.mean(apart) < 0.5


@pytest.mark.parametrize("n_folds", [12, 4])
def test_bands_of_left_out_units_cover_what_is_promised(n_folds):
    # A model is the mean of the units it has seen; each has a level of its own.
    rng = np.random.default_rng(14)
    n_rows = np.tile([2, 5, 30], 4)
    units = np.repeat(np.arange(12), n_rows)
    models = np.arange(12) % n_folds
    covers = {plus_band: [], minmax_band: []}
    for _ in range(250):
        levels, sizes = rng.normal(size=13), rng.lognormal(sigma=0.5, size=13)
        outcomes = levels[units] + sizes[units] * rng.normal(size=len(units))
        new = levels[12] + sizes[12] * rng.normal(size=20)
        means = np.bincount(units, outcomes) / n_rows
        learned = np.array([means[models != fold].mean() for fold in range(n_folds)])
        scores = np.abs(outcomes - learned[models[units]]).reshape(-1, 1, 1)
        shape = (n_folds, 1, 1)
        for band, shares in covers.items():
            drawn = learned.reshape(*shape, 1), scores, units, models, np.ones(shape)
            low, high = band(*drawn, 0.8).ravel()
            shares.append(covered(low, high, new))
    fewer = (1 - n_folds / 12) / (n_folds + 1)
    assert_at_least(covers[plus_band], 0.6 - fewer)
    assert_at_least(covers[minmax_band], 0.8 - fewer)
    # In truth a mean hardly depends on one unit, and both hold what was asked for.
    assert np.mean(covers[plus_band]) > 0.78
    assert np.mean(covers[plus_band]) <= np.mean(covers[minmax_band]) < 0.95


def test_guarantees_are_stated_for_every_method():
    assert set(GUARANTEES) == {"draws", "mixture", "plus", "minmax", "pooled"}
    assert GUARANTEES["plus"].startswith("at least twice the coverage less 1")
    assert GUARANTEES["minmax"].startswith("at least the coverage")
