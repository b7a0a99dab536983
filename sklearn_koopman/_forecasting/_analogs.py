"""Analogs: earlier moments of a recording whose past resembles that of the present."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isqrt
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.base import BaseEstimator

from .._utils._typing import Array, Indices, Mask
from .._utils._validation import check_integer, check_number

# A quarter of the expected distance of two windows that have nothing in common.
SIMILAR = 0.5
# At an end of a piece the minimum may lie beyond: such windows are to be nearer.
END = 0.1
SHORTEST_WINDOW = 10  # windows of 5 to 20 samples served walking at 150 Hz alike

# Distances of a block of present rows: 1 MB, which stays in the cache.
BLOCK_ENTRIES = 2**17

# Windows are equal if they differ by less than this share of their largest value.
ROUNDING = 8 * np.finfo(np.float64).eps


class Analogs(BaseEstimator):
    """Forecasts from a recording's own past, for the `baseline` of a forecaster.

    The analogs of row i are earlier rows j of the same recording whose past resembles
    that of row i. The distance of two rows is the mean squared difference of the
    samples up to them,

    .. math:: d_{ij} = \\frac{1}{w p} \\sum_{s=0}^{w-1} \\sum_{c=1}^{p}
       \\left( \\frac{x_{i-s,c} - x_{j-s,c}}{\\sigma_c} \\right)^2,

    for windows of w samples of p columns, with the standard deviations
    :math:`\\sigma_c` of the columns in training. Analogs are local minima of
    :math:`d_{ij}` over j, the smallest first, each at least `exclusion` rows from those
    before it. The forecast for h rows ahead is the weighted mean of what followed
    them,

    .. math:: \\hat y_{i+h} = \\frac{\\sum_j w_{ij} \\, y_{j+h}}{\\sum_j w_{ij}}, \\quad
       w_{ij} = \\exp\\left(-\\frac{d_{ij} - d_i}{b \\, d_i}\\right),

    where :math:`d_i` is the smallest distance of row i, and b the `bandwidth`. Analogs
    whose windows equal the present one share all the weight. This is kernel analog
    forecasting ([2]_, [3]_), a kernel estimate of the Koopman operator from the one
    recording; forecasts from single analogs are older ([1]_).

    Parameters
    ----------
    window : int, default=None
        The number w of samples that are compared, up to the present one. None means
        one more than the largest delay of the forecaster, and at least 10.
    n_analogs : int, default=10
        Largest number of analogs of a row.
    bandwidth : float, default=3.0
        How fast the weight of an analog falls with its distance, in units of the
        smallest distance. As it grows, the weights become equal.
    exclusion : int, default=None
        Smallest number of rows between two analogs, and between the present row and
        its analogs. For h rows ahead these are also at least h rows back, so that what
        followed is known. None means 2 `window`.
    max_past : int, default=None
        Largest number of rows from the present one back to an analog, which bounds the
        time that long recordings take. None means no bound.

    Notes
    -----
    Nothing is learned, and a new recording needs no fit. Row i depends on rows up to i
    alone, and on no more than the last ``max_past + window + 1``.

    A window that differs by more than 0.5 is no analog; two that have nothing in common
    differ by 2 on average. Windows, and analogs with what followed them, lie on one
    side of every gap. Analogs come from all pieces between gaps. At the ends of a piece
    one neighbour suffices for a local minimum, if the distance is at most 0.05. Of
    equal distances the later row is taken first. Windows count as equal if the root of
    their distance is at most 8 times the machine epsilon times the largest value, over
    :math:`\\sigma_c`, in the present one.

    Time is O(T L p) for T rows and L rows of past, that is O(T^2 p) without `max_past`.
    Memory is O(T) for each horizon, and some MB.

    References
    ----------
    .. [1] E. N. Lorenz, "Atmospheric Predictability as Revealed by Naturally Occurring
       Analogues", Journal of the Atmospheric Sciences 26, 1969.
    .. [2] Z. Zhao and D. Giannakis, "Analog forecasting with dynamics-adapted kernels",
       Nonlinearity 29, 2016.
    .. [3] R. Alexander and D. Giannakis, "Operator-theoretic framework for forecasting
       nonlinear time series with kernel analog techniques", Physica D 409, 2020.

    Examples
    --------
    The values for the forecaster's delays of 0, 5 and 20 samples:

    >>> from sklearn_koopman import Analogs
    >>> analogs = Analogs(max_past=3000).resolve([0, 5, 20])
    >>> analogs.window, analogs.exclusion, analogs.max_past
    (21, 42, 3000)
    """

    __module__ = "sklearn_koopman.forecaster"

    def __init__(
        self,
        *,
        window: int | None = None,
        n_analogs: int = 10,
        bandwidth: float = 3.0,
        exclusion: int | None = None,
        max_past: int | None = None,
    ) -> None:
        self.window = window
        self.n_analogs = n_analogs
        self.bandwidth = bandwidth
        self.exclusion = exclusion
        self.max_past = max_past

    def check(self) -> None:
        """Refuse parameters outside their range.

        Raises
        ------
        ValueError
            If a parameter is outside its range.
        """
        check_integer(self.n_analogs, "baseline.n_analogs", 1)
        check_number(self.bandwidth, "baseline.bandwidth", positive=True)
        for name in ("window", "exclusion", "max_past"):
            if getattr(self, name) is not None:
                check_integer(getattr(self, name), f"baseline.{name}", 1)

    def resolve(self, offsets: Sequence[int] | Indices) -> Analogs:
        """Return analogs with numbers for `window` and `exclusion`.

        Parameters
        ----------
        offsets : sequence of int
            The delays of the forecaster, in samples.

        Returns
        -------
        analogs : Analogs
            `window` is max(10, largest offset + 1) where it was None, and `exclusion`
            2 `window`.

        Raises
        ------
        ValueError
            If a parameter is outside its range, or `max_past` is less than `exclusion`,
            so that no row has an analog.
        """
        self.check()
        window, exclusion = self.window, self.exclusion
        if window is None:
            window = max(SHORTEST_WINDOW, int(max(offsets)) + 1)
        if exclusion is None:
            exclusion = 2 * window
        if self.max_past is not None and self.max_past < exclusion:
            raise ValueError(
                f"baseline.max_past must be at least exclusion={exclusion}, as nearer "
                f"rows are no analogs, got {self.max_past!r}."
            )
        return Analogs(
            window=window,
            n_analogs=self.n_analogs,
            bandwidth=self.bandwidth,
            exclusion=exclusion,
            max_past=self.max_past,
        )


class AnalogSet(NamedTuple):
    """The analogs of some rows of one recording, the nearest first.

    Attributes
    ----------
    places : ndarray of shape (n_rows, n_ages, n_analogs)
        The rows of the recording that are analogs, -1 where there are fewer.
    weights : ndarray of shape (n_rows, n_ages, n_analogs)
        They sum to 1 over the analogs of a row and age, and are 0 where there is none.
    """

    places: Indices
    weights: Array


def find_analogs(
    states: Array,
    piece: Indices,
    rows: Indices,
    ages: Indices,
    follows: Indices,
    *,
    scale: Array,
    window: int,
    n_analogs: int,
    bandwidth: float,
    exclusion: int,
    max_past: int | None,
    max_distance: float = np.inf,
) -> AnalogSet:
    """Find the analogs of some rows of a recording, and their weights.

    The results for a row are the same whichever other rows are asked for.

    Parameters
    ----------
    states : ndarray of shape (n_samples, n_features)
        The recording, with any values in rows of gaps.
    piece : ndarray of shape (n_samples,)
        The number of the piece between gaps that each row belongs to, -1 in gaps.
    rows : ndarray of shape (n_rows,)
        The present rows, rising.
    ages, follows : ndarrays of shape (n_ages,)
        Analogs for ``ages[k]`` are at least so many rows back, and the ``follows[k]``
        rows after them are in their piece; ``follows[k] <= ages[k]``, ``ages[k] >= 1``.
    scale : ndarray of shape (n_features,)
        What the columns are divided by.
    window, n_analogs, bandwidth, exclusion, max_past : int or float
        As in :class:`Analogs`, with numbers for `window` and `exclusion`.
    max_distance : float, default=inf
        The largest distance of an analog.

    Returns
    -------
    analogs : AnalogSet
        The analogs of each row and age.
    """
    states = np.where((piece >= 0)[:, np.newaxis], states / scale, 0.0)
    behind, ahead = _count_within(piece)
    has_window = (piece >= 0) & (behind >= window - 1)
    reach = len(piece) if max_past is None else max_past
    shape = (len(rows), len(ages), n_analogs)
    result = AnalogSet(np.full(shape, -1, dtype=np.intp), np.zeros(shape))
    usable = np.flatnonzero(has_window[rows])
    for block in _cut_blocks(rows, usable, window, reach):
        present = rows[block]
        row, places, distances = _find_minima(
            states, present, has_window, window, reach, ages.min()
        )
        at_end = (behind[places] == window - 1) | (ahead[places] == 0)
        similar = distances <= np.where(at_end, END * max_distance, max_distance)
        row, places, distances = row[similar], places[similar], distances[similar]
        places, distances = _tabulate(row, places, distances, len(present))
        back = present[:, np.newaxis] - places
        widest = _pick(places, places >= 0, exclusion, n_analogs)
        for k, (age, follow) in enumerate(zip(ages, follows, strict=True)):
            allowed = (places >= 0) & (back >= age) & (ahead[places] >= follow)
            picks = widest.copy()
            # Those picked from more candidates are those picked from fewer, if allowed.
            good = (picks < 0) | np.take_along_axis(allowed, picks, axis=1)
            anew = np.flatnonzero(~good.all(axis=1))
            picks[anew] = _pick(places[anew], allowed[anew], exclusion, n_analogs)
            result.places[block, k] = np.take_along_axis(places, picks, axis=1)
            result.weights[block, k] = _weigh(
                np.take_along_axis(distances, picks, axis=1), bandwidth
            )
    return result


def _count_within(piece: Indices) -> tuple[Indices, Indices]:
    """Return the numbers of rows before and after each row, within its piece."""
    n_rows = len(piece)
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(piece)) + 1, [n_rows]])
    sizes = np.diff(bounds)
    behind = np.arange(n_rows) - np.repeat(bounds[:-1], sizes)
    return behind, np.repeat(sizes, sizes) - 1 - behind


def _cut_blocks(
    rows: Indices, usable: Indices, window: int, reach: int
) -> Iterator[Indices]:
    """Cut places in `rows` into blocks of consecutive rows that the cache holds."""
    runs = np.split(usable, np.flatnonzero(np.diff(rows[usable]) != 1) + 1)
    for run in runs:
        while len(run):
            past = min(rows[run[0]], reach)
            # n rows have past + n columns; windows overlap from one block to the next.
            size = max(2 * window, BLOCK_ENTRIES // (past + isqrt(BLOCK_ENTRIES)))
            yield run[:size]
            run = run[size:]


def _find_minima(
    states: Array,
    present: Indices,
    has_window: Mask,
    window: int,
    reach: int,
    youngest: int,
) -> tuple[Indices, Indices, Array]:
    """Find the local minima of the distance of consecutive rows to their past.

    Returns
    -------
    row, place : ndarrays of shape (n_minima,)
        The minima: places in `present`, rising, and rows of the recording.
    distance : ndarray of shape (n_minima,)
        The distances there, 0 where rounding explains them.
    """
    first = present[0] - window + 1
    # One column more on each side than analogs may have, to be their neighbours.
    start = max(present[0] - reach - 1, window - 1)
    stop = max(present[-1] - youngest + 2, start)
    past = states[start - window + 1 : stop]
    squares = cdist(states[first : present[-1] + 1], past, "sqeuclidean")
    sums = _sum_diagonals(squares, window)
    defined = has_window[start:stop]
    sums[:, ~defined] = np.inf
    is_minimum = np.tile(defined, (len(present), 1))
    is_minimum[:, 1:] &= sums[:, 1:] <= sums[:, :-1]
    is_minimum[:, :-1] &= sums[:, :-1] <= sums[:, 1:]
    row, column = np.nonzero(is_minimum)
    place = column + start
    back = present[row] - place
    kept = (back >= youngest) & (back <= reach)
    row, place = row[kept], place[kept]
    distance = sums[row, place - start] / (window * states.shape[1])
    windows = np.lib.stride_tricks.sliding_window_view(
        np.abs(states[first : present[-1] + 1]).max(axis=1), window
    )
    rounding = (ROUNDING * windows.max(axis=1)) ** 2
    return row, place, np.where(distance <= rounding[row], 0.0, distance)


def _sum_diagonals(values: Array, length: int) -> Array:
    """Return the sums of so many consecutive values along each diagonal.

    They are added in an order that depends on `length` alone, and without cancelling:
    zeros give zero.
    """
    if length == 1:
        return values
    half = length // 2
    n_rows, n_columns = np.subtract(values.shape, length - 1)
    halves = _sum_diagonals(values, half)
    later_halves = halves[half:, half:]
    sums: Array = halves[:n_rows, :n_columns] + later_halves[:n_rows, :n_columns]
    if length % 2:
        sums += values[length - 1 :, length - 1 :]
    return sums


def _tabulate(
    row: Indices, place: Indices, distance: Array, n_rows: int
) -> tuple[Indices, Array]:
    """Return tables of the minima of each row, the nearest first, then the latest.

    The last column holds no minimum, but place -1 and an infinite distance.
    """
    order = np.lexsort((-place, distance, row))
    counts = np.bincount(row, minlength=n_rows)
    rank = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    places = np.full((n_rows, counts.max() + 1), -1, dtype=np.intp)
    distances = np.full(places.shape, np.inf)
    places[row, rank] = place[order]
    distances[row, rank] = distance[order]
    return places, distances


def _pick(places: Indices, free: Mask, exclusion: int, n_analogs: int) -> Indices:
    """Return the first free columns of each row whose places keep their distance.

    Where there are fewer than `n_analogs`, it is -1.
    """
    free = free.copy()
    row = np.arange(len(places))
    picks = np.full((len(places), n_analogs), -1, dtype=np.intp)
    for k in range(n_analogs):
        column = free.argmax(axis=1)
        found = free[row, column]
        if not found.any():
            break
        picks[found, k] = column[found]
        picked = places[row, column][:, np.newaxis]
        free &= np.abs(places - picked) >= exclusion
    return picks


def _weigh(distances: Array, bandwidth: float) -> Array:
    """Return weights of analogs that sum to 1, or are 0 where there is no analog."""
    nearest = distances[:, :1]
    with np.errstate(all="ignore"):
        weights = np.exp((1 - distances / nearest) / bandwidth)
        weights[distances == nearest] = 1.0  # also 0 / 0
        weights[distances == np.inf] = 0.0  # also inf / inf
        total = weights.sum(axis=1, keepdims=True)
        return np.where(total > 0, weights / total, 0.0)
