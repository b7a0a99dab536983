"""Bands from the errors on units (persons or recordings) that a model has not seen.

A score is the size of an error in units of a scale, s = |error| / scale. Scores are of
shape (n_rows, n_horizons, n_outputs), NaN where there is no error. Rows of one unit
are similar, so that the unit counts and not the row: each of K units has the mass
1 / (K + 1), spread evenly over its rows, and the mass 1 / (K + 1) lies at infinity, for
the unit to come. If units are exchangeable, a score of the new one is below the
quantile of this mixture, at the level c, with a probability of at least c (Lee, Barber
and Willett, arXiv 2306.06342). Each horizon and output has its own mixture, of the
units that have an error there.

With the largest score of each row (`largest_scores`) in place of its scores, the same
functions give bands that hold at all horizons and outputs at once.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .._utils._typing import Array, Indices
from .._utils._validation import check_number

# The expected share of the rows of a new unit that a band covers, where the unit is
# exchangeable with those that calibrate. In folds, no unit is compared with those of
# its own fold, which may cost as much as they weigh.
_FOLDS = ", less (1 - F / K) / (F + 1) if the K units are left out in F equal folds"
GUARANTEES = {
    "draws": "about the coverage that is asked for, seldom less",
    "mixture": "at least the coverage that is asked for",
    "plus": "at least twice the coverage less 1, as 0.8 for 0.9" + _FOLDS,
    "minmax": "at least the coverage that is asked for" + _FOLDS,
    "pooled": "none",
}
# Rounding of sums of masses: levels that differ by less are equal.
TOLERANCE = 1e-9
# Sums of a prediction and the size of an error are equal within this part of both.
ROUNDING = 8 * float(np.finfo(np.float64).eps)


def largest_scores(scores: Array) -> Array:
    """Return the largest score of each row.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_horizons, n_outputs)
        Scores, NaN where there is no error.

    Returns
    -------
    largest : ndarray of shape (n_rows, 1, 1)
        NaN where a row lacks any score: the largest one might be the one that lacks.
    """
    largest: Array = scores.max(axis=(1, 2), keepdims=True)
    return largest


def count_units(scores: Array, units: Indices) -> Indices:
    """Count the units that have a score, for each horizon and output.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_horizons, n_outputs)
        Scores, NaN where there is no error.
    units : ndarray of shape (n_rows,)
        The unit of each row, a number from 0.

    Returns
    -------
    n_units : ndarray of shape (n_horizons, n_outputs)
        The numbers of units.
    """
    counts = np.empty(scores.shape[1:], dtype=np.intp)
    for cell, _, own in _cells(scores, units):
        counts[cell] = len(np.unique(own))
    return counts


def check_coverage(coverage: Any, n_units: int | Indices) -> None:
    """Refuse a coverage that so many units do not support.

    Parameters
    ----------
    coverage : float
        The coverage that is asked for.
    n_units : int or ndarray of shape (n_horizons, n_outputs)
        The number of units. Of several numbers the smallest one counts.

    Raises
    ------
    ValueError
        If `coverage` is not between 0 and 1, or K units support less: the mass of all
        of them is K / (K + 1), and the rest lies at infinity.
    """
    check_level(coverage)
    n_least = int(np.min(n_units))
    level = coverage * (1 - TOLERANCE)
    needed = int(np.ceil(level / (1 - level)))
    if n_least >= needed:
        return
    largest = np.floor(1000 * n_least / (n_least + 1)) / 1000
    where = " at some horizon" if n_least < np.max(n_units) else ""
    lower = f"ask for a coverage of at most {largest:g}, " if n_least else ""
    raise ValueError(
        f"coverage={coverage:g} needs {needed} units (groups, or recordings if there "
        f"are no groups), but {n_least} have errors{where}; these support at most "
        f"{n_least}/{n_least + 1}. Calibrate with more of them, {lower}or take bands "
        "without guarantee by fit_conformalize(..., method='pooled')."
    )


def check_level(coverage: Any) -> None:
    """Refuse a coverage that is not between 0 and 1."""
    check_number(coverage, "coverage", positive=True)
    if coverage >= 1:
        raise ValueError(
            f"coverage must be below 1, got {coverage!r}; 0.9 stands for 90 %."
        )


def mixture_quantile(scores: Array, units: Indices, coverage: float) -> Array:
    """Return the quantile of the mixture of units, for each horizon and output.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_horizons, n_outputs)
        Scores, NaN where there is no error.
    units : ndarray of shape (n_rows,)
        The unit of each row, a number from 0.
    coverage : float
        The level.

    Returns
    -------
    quantile : ndarray of shape (n_horizons, n_outputs)
        The smallest score at which the mass reaches the level. Infinite where the
        units do not support it.

    Notes
    -----
    The cost is that of sorting the rows, for each horizon and output.
    """
    quantile = np.empty(scores.shape[1:])
    for cell, values, own in _cells(scores, units):
        n_rows = np.bincount(own)
        total = coverage * (np.count_nonzero(n_rows) + 1)
        quantile[cell] = _quantile(values, 1 / n_rows[own], total)
    return quantile


def expected_quantile(scores: Array, units: Indices, coverage: float) -> Array:
    """Return the expected quantile of one score of each unit, drawn at random.

    Of K scores, one of each unit, the ceil(coverage (K + 1))-th smallest covers a score
    of a new unit with a probability of at least `coverage`, as all of them are
    exchangeable. This is its mean over all draws, which are not carried out. The mean
    covers at least as much if the distribution function of scores is concave over the
    range of the quantiles of draws: there, larger errors are rarer. Errors with a
    second hump beyond the others break that. It is narrower than `mixture_quantile`,
    which covers up to 1 / (K + 1) more than is asked for, whatever the errors.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_horizons, n_outputs)
        Scores, NaN where there is no error.
    units : ndarray of shape (n_rows,)
        The unit of each row, a number from 0.
    coverage : float
        The level.

    Returns
    -------
    quantile : ndarray of shape (n_horizons, n_outputs)
        The mean. Infinite where the units do not support the level.

    Notes
    -----
    With the share F_i(t) of the scores of unit i that are at most t, the quantile of a
    draw is at most t with the probability that at most K - r of K independent events
    of the probabilities 1 - F_i(t) happen, r = ceil(coverage (K + 1)). The cost is that
    of sorting the rows, times K (K - r + 1).
    """
    quantile = np.empty(scores.shape[1:])
    for cell, values, own in _cells(scores, units):
        quantile[cell] = _expected(values, own, coverage)
    return quantile


def _expected(values: Array, own: Indices, coverage: float) -> float:
    """Return the expected quantile of one value of each unit."""
    present = np.unique(own)
    n_above = len(present) - int(np.ceil(coverage * (len(present) + 1) - TOLERANCE))
    if n_above < 0:
        return np.inf
    levels = np.unique(values)
    # Entry m: the probability that so many of the units so far are above each level.
    probability = np.zeros((n_above + 1, len(levels)))
    probability[0] = 1.0
    for unit in present:
        sizes = np.sort(values[own == unit])
        below = np.searchsorted(sizes, levels, "right") / len(sizes)
        moved = probability[:-1] * (1 - below)
        probability *= below
        probability[1:] += moved
    reached = probability.sum(axis=0)
    return float(levels @ np.diff(reached, prepend=0.0))


def pooled_quantile(scores: Array, coverage: float) -> Array:
    """Return the quantile of the scores of all rows, for each horizon and output.

    A band of these has no guarantee: a new unit is not a mean of those that calibrate.

    Parameters
    ----------
    scores : ndarray of shape (n_rows, n_horizons, n_outputs)
        Scores, NaN where there is no error.
    coverage : float
        The level.

    Returns
    -------
    quantile : ndarray of shape (n_horizons, n_outputs)
        The smallest score that the share `coverage` of all scores does not exceed.
        Infinite where there are no scores.
    """
    quantile = np.empty(scores.shape[1:])
    for cell, values, own in _cells(scores, np.arange(len(scores))):
        quantile[cell] = _quantile(values, np.ones(len(own)), coverage * len(own))
    return quantile


def symmetric_band(predictions: Array, half_width: Array) -> Array:
    """Return the intervals of a half width about predictions.

    Parameters
    ----------
    predictions : ndarray of shape (n_rows, n_horizons, n_outputs)
        The predictions.
    half_width : ndarray, broadcast to (n_rows, n_horizons, n_outputs)
        The quantile of the scores, times the scale.

    Returns
    -------
    intervals : ndarray of shape (n_rows, n_horizons, n_outputs, 2)
        Lower and upper ends.
    """
    return np.stack([predictions - half_width, predictions + half_width], axis=-1)


def minmax_band(
    predictions: Array,
    scores: Array,
    units: Indices,
    models: Indices,
    scale: Array,
    coverage: float,
) -> Array:
    """Return the intervals of jackknife-minmax.

    From the least prediction, less the quantile of the mixture, to the greatest one,
    plus the quantile, over the models that have left out a unit.

    Parameters
    ----------
    predictions : ndarray of shape (n_models, n_rows, n_horizons, n_outputs)
        The predictions of each model at the rows in question.
    scores : ndarray of shape (n_scores, n_horizons, n_outputs) or (n_scores, 1, 1)
        Scores of each unit by the model that has left it out, NaN where there is no
        error; or the largest ones of each row.
    units : ndarray of shape (n_scores,)
        The unit of each row of scores, a number from 0.
    models : ndarray of shape (n_units,)
        The model that has left out each unit. Units of one fold share a model.
    scale : ndarray, broadcast to (n_models, n_rows, n_horizons, n_outputs)
        The scale by which errors of each model are divided in such rows.
    coverage : float
        The coverage.

    Returns
    -------
    intervals : ndarray of shape (n_rows, n_horizons, n_outputs, 2)
        Lower and upper ends; NaN where a model has no prediction.
    """
    used = np.unique(models)
    reach = mixture_quantile(scores, units, coverage) * scale[used]
    lower = (predictions[used] - reach).min(axis=0)
    upper = (predictions[used] + reach).max(axis=0)
    return np.stack([lower, upper], axis=-1)


def plus_band(
    predictions: Array,
    scores: Array,
    units: Indices,
    models: Indices,
    scale: Array,
    coverage: float,
) -> Array:
    """Return the intervals of jackknife+.

    The upper end is the quantile of the mixture of m_i + s_ir, at the level `coverage`,
    where m_i is the prediction of the model without unit i and s_ir the size of the
    error of that model at row r of unit i. The lower end is the same, mirrored.

    Parameters
    ----------
    predictions : ndarray of shape (n_models, n_rows, n_horizons, n_outputs)
        The predictions of each model at the rows in question.
    scores : ndarray of shape (n_scores, n_horizons, n_outputs) or (n_scores, 1, 1)
        Scores of each unit by the model that has left it out, NaN where there is no
        error; or the largest ones of each row.
    units : ndarray of shape (n_scores,)
        The unit of each row of scores, a number from 0.
    models : ndarray of shape (n_units,)
        The model that has left out each unit. Units of one fold share a model.
    scale : ndarray, broadcast to (n_models, n_rows, n_horizons, n_outputs)
        The scale by which errors of each model are divided in such rows.
    coverage : float
        The coverage.

    Returns
    -------
    intervals : ndarray of shape (n_rows, n_horizons, n_outputs, 2)
        Lower and upper ends; NaN where a model has no prediction, infinite where
        that of a model is.

    Notes
    -----
    The mixtures of all rows hold the same errors, shifted by the predictions. So errors
    are sorted once, and each end is found by bisection, in some 20 searches of them for
    each unit and row. The band lies within that of `minmax_band`; where all models
    agree both are that of `mixture_quantile`.
    """
    intervals = np.empty((*predictions.shape[1:], 2))
    intervals[:] = -np.inf, np.inf
    missing = np.isnan(predictions[np.unique(models)]).any(axis=0)
    scores = np.broadcast_to(scores, (len(scores), *predictions.shape[2:]))
    scale = np.broadcast_to(scale, predictions.shape)
    for (horizon, output), values, own in _cells(scores, units):
        present = np.unique(own)
        total = coverage * (len(present) + 1)
        if total * (1 - TOLERANCE) > len(present):
            continue
        sizes = [np.sort(values[own == unit]) for unit in present]
        means = predictions[models[present], :, horizon, output]
        units_of = scale[models[present], :, horizon, output]
        intervals[:, horizon, output, 0] = -_upper_end(-means, units_of, sizes, total)
        intervals[:, horizon, output, 1] = _upper_end(means, units_of, sizes, total)
    intervals[missing] = np.nan
    return intervals


def _cells(
    scores: Array, units: Indices
) -> Iterator[tuple[tuple[int, int], Array, Indices]]:
    """Yield each horizon and output, with its scores and their units."""
    for horizon, output in np.ndindex(scores.shape[1], scores.shape[2]):
        values = scores[:, horizon, output]
        counts = ~np.isnan(values)
        yield (horizon, output), values[counts], units[counts]


def _upper_end(
    means: Array, scale: Array, sizes: Sequence[Array], total: float
) -> Array:
    """Return the quantile of the mixture of sizes, scaled and shifted unit by unit.

    Parameters
    ----------
    means : ndarray of shape (n_units, n_rows)
        The prediction for each unit, of the model that has left it out.
    scale : ndarray of shape (n_units, n_rows)
        What the sizes of each unit are multiplied by.
    sizes : sequence of n_units ndarrays
        The sizes of the errors of each unit, sorted.
    total : float
        The number of units whose mass is to be reached.

    Returns
    -------
    end : ndarray of shape (n_rows,)
        The smallest sum of a mean and one of its sizes at which it is reached. Infinite
        where it never is.
    """
    end = np.full(means.shape[1], np.inf)
    lengths = [len(own) for own in sizes]
    weights = 1 / np.array(lengths)
    common = _quantile(np.concatenate(sizes), np.repeat(weights, lengths), total)
    rows = np.flatnonzero(np.isfinite(means).all(axis=0))
    if common == np.inf or not len(rows):
        return end
    means, scale = means[:, rows], scale[:, rows]
    magnitude = (np.abs(means) + scale * common).max(axis=0)
    # The end lies between those that one unit alone would have with the same masses.
    low = (means + scale * common).min(axis=0) - TOLERANCE * magnitude
    high = (means + scale * common).max(axis=0) + TOLERANCE * magnitude
    fenced = [np.concatenate([[-np.inf], own, [np.inf]]) for own in sizes]
    total = total * (1 - TOLERANCE) + weights.sum()  # places count the fence below, too
    below = _find_places(low, means, scale, fenced)
    above = _find_places(high, means, scale, fenced)
    while len(rows):
        first = np.min(_take_sums(below, means, scale, fenced), axis=0)
        last = np.max(_take_sums(above - 1, means, scale, fenced), axis=0)
        is_open = last - first > ROUNDING * magnitude
        end[rows] = last
        rows, magnitude = rows[is_open], magnitude[is_open]
        means, scale = means[:, is_open], scale[:, is_open]
        below, above = below[:, is_open], above[:, is_open]
        places = _find_places((first + last)[is_open] / 2, means, scale, fenced)
        is_reached = weights @ places >= total
        below = np.where(is_reached, below, places)
        above = np.where(is_reached, places, above)
    return end


def _find_places(
    ends: Array, means: Array, scale: Array, sizes: Sequence[Array]
) -> Indices:
    """Find the first size of each unit that, scaled and shifted, is above each end."""
    units = zip(means, scale, sizes, strict=True)
    return np.array(
        [np.searchsorted(own, (ends - mean) / by, "right") for mean, by, own in units]
    )


def _take_sums(
    places: Indices, means: Array, scale: Array, sizes: Sequence[Array]
) -> Array:
    """Return the sums of the means and the scaled sizes at these places."""
    units = zip(places, means, scale, sizes, strict=True)
    return np.array([mean + by * own[place] for place, mean, by, own in units])


def _quantile(values: Array, masses: Array, total: float) -> float:
    """Return the smallest value at which the masses reach a total, infinite if none."""
    order = np.argsort(values)
    place = np.searchsorted(np.cumsum(masses[order]), total * (1 - TOLERANCE))
    return float(values[order[place]]) if place < len(order) else np.inf
