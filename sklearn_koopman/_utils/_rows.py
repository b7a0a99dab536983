"""Rows: their spread, their weights, which are equal, and means of their outputs."""

from typing import Any, NamedTuple, Self

import numpy as np
from sklearn.utils import gen_batches

from ._typing import Array, Indices
from ._validation import check_sample_weight
from ._warnings import warn

# Rows that are compared with their mean at a time, so that no copy of all is made.
CHUNK_ROWS = 2**12
# Rows whose keys are computed at a time, so that they stay in the cache.
KEY_ROWS = 2**13


def spread(X: Array, sample_weight: Array | None = None) -> float:
    """Measure how far rows spread, the scale that estimators take by default.

    It is the root of the mean squared distance of the rows from their mean.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The rows.
    sample_weight : ndarray of shape (n_samples,), default=None
        How often each row counts, more than 0. By default all once.

    Returns
    -------
    spread : float
        The square root of the sum of the variances of the columns; 1 if all rows are
        equal.
    """
    # Differences from the least values, in units of the largest difference: then
    # neither an offset nor a unit costs digits, and equal rows have exactly none.
    least = X.min(axis=0)
    with np.errstate(over="ignore"):
        unit = float((X.max(axis=0) - least).max())
    if unit == 0:
        return 1.0
    if unit == np.inf:
        return 2 * spread(X / 2, sample_weight)
    weights = np.ones(len(X)) if sample_weight is None else sample_weight
    chunks = list(gen_batches(len(X), CHUNK_ROWS))

    def deviations(rows: slice, center: Any) -> Array:
        difference = np.subtract(X[rows], least, order="C")
        difference /= unit
        difference -= center
        return difference

    total = weights.sum()
    moments = [
        np.einsum("i,ij->j", weights[rows], deviations(rows, 0.0)) for rows in chunks
    ]
    mean = np.sum(moments, axis=0) / total
    squares = 0.0
    for rows in chunks:
        difference = deviations(rows, mean)
        squares += np.einsum("i,ij,ij->", weights[rows], difference, difference)
    return unit * float(np.sqrt(squares / total))


def warn_without_spread(estimator: Any, X: Any) -> None:
    """Warn that the first of several batches had no spread, which later ones need.

    Parameters
    ----------
    estimator : estimator instance
        What learns from the batches.
    X : array-like of shape (n_samples, n_features)
        The first batch.

    Warns
    -----
    UserWarning
        If all of its rows are equal, and a parameter stands for the spread.
    """
    X = np.asarray(X, dtype=np.float64)
    if (X[0] != X).any():
        return
    given = estimator.get_params()
    names = ["separation", "centers__separation"]
    if isinstance(given.get("kernel"), str):
        names.append("beta")
    used = [f"{name}='scale'" for name in names if isinstance(given.get(name), str)]
    if used:
        warn(
            f"All rows of the first batch are equal, so that {' and '.join(used)} "
            "takes 1 for the spread of the states; begin with more rows, or set a "
            "number in the unit of the states."
        )


def drop_absent(
    sample_weight: Any, X: Array, y: Array
) -> tuple[Array | None, Indices, Array, Array]:
    """Drop the rows of weight zero.

    Parameters
    ----------
    sample_weight : array-like of shape (n_samples,) or None
        The weights, as the user gives them.
    X, y : ndarray of shape (n_samples, ...)
        The data.

    Returns
    -------
    weights : ndarray of shape (n_present,) or None
        The weights that are positive; None if none were given.
    numbers : ndarray of shape (n_present,)
        The rows that have them.
    X, y : ndarray of shape (n_present, ...)
        The data there.

    Raises
    ------
    ValueError
        If the weights are no finite numbers of at least 0, one a row.
    """
    weights = check_sample_weight(sample_weight, len(X))
    if weights is None or weights.all():
        return weights, np.arange(len(X)), X, y
    present = np.flatnonzero(weights)
    return weights[present], present, X[present], y[present]


def total_weight(X: Array, weights: Array | None) -> float:
    """Return the sum of the weights; the number of rows if they have none."""
    return float(len(X) if weights is None else weights.sum())


def distinct_rows(X: Array) -> tuple[Indices, Indices, Indices]:
    """Find equal rows.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The rows.

    Returns
    -------
    first : ndarray of shape (n_distinct,)
        The first row of each group of equal rows, in rising order.
    group : ndarray of shape (n_samples,)
        The number of the group that each row belongs to.
    counts : ndarray of shape (n_distinct,)
        The number of rows in each group.
    """
    _, first, group, counts = np.unique(
        X, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    # NumPy numbers the groups by their values. Here they are numbered by their rows.
    order = np.argsort(first)
    return first[order], np.argsort(order)[group.reshape(-1)], counts[order]


def count_distinct(X: Array) -> int:
    """Count distinct rows, in less time than `distinct_rows` takes to find them."""
    return len(np.unique(_keys(X)))


def weights_at(points: Array, X: Array, weights: Array | None) -> Array:
    """Return the summed weights of the rows that equal each point."""
    rows = _rows_that_may_equal(points, X)
    own = None if weights is None else weights[rows]
    _, group, _ = distinct_rows(np.vstack([points, X[rows]]))
    sums = np.bincount(group[len(points) :], own, minlength=group.max() + 1)
    return sums[group[: len(points)]].astype(np.float64)


def group_means(values: Array, group: Indices, weights: Array | None = None) -> Array:
    """Average the rows of each group.

    Parameters
    ----------
    values : ndarray of shape (n_samples, n_columns)
        The rows.
    group : ndarray of shape (n_samples,)
        The number of the group that each row belongs to, as `distinct_rows` gives it.
    weights : ndarray of shape (n_samples,), default=None
        The weight of each row. By default all are equal.

    Returns
    -------
    means : ndarray of shape (n_groups, n_columns)
        The mean of each group.
    """
    sums = np.zeros((group.max() + 1, values.shape[1]))
    np.add.at(sums, group, values if weights is None else weights[:, None] * values)
    return sums / np.bincount(group, weights)[:, np.newaxis]


class AveragedOutputs(NamedTuple):
    """Outputs at distinct states: the means over the rows with the same state.

    Attributes
    ----------
    means : ndarray of shape (n_distinct, n_outputs)
        The mean outputs at each state.
    counts : ndarray of shape (n_distinct,)
        The number of rows with that state, or the sum of their weights.
    scatter : ndarray of shape (n_outputs,)
        The weighted sum of the squared deviations of all rows from the means.
    """

    means: Array
    counts: Array
    scatter: Array

    def take(self, rows: Indices) -> Self:
        """Return the outputs at some of the states."""
        return type(self)(self.means[rows], self.counts[rows], self.scatter)

    @classmethod
    def of(cls, y: Array, weights: Array | None) -> Self:
        """Return the outputs of rows that are all taken for distinct."""
        counts = np.ones(len(y)) if weights is None else weights
        return cls(y, counts, np.zeros(y.shape[1]))

    def joined(self, y: Array, weights: Array | None) -> Self:
        """Return these outputs followed by those of further rows."""
        _, counts, _ = self.of(y, weights)
        counts = np.append(self.counts, counts)
        return type(self)(np.vstack([self.means, y]), counts, self.scatter)

    def merged(self, group: Indices) -> Self:
        """Return the averages over groups of these outputs, if any two share one."""
        if len(group) == group.max() + 1:
            return self.take(np.argsort(group))
        counts = np.bincount(group, self.counts).astype(np.float64)
        means = group_means(self.means, group, self.counts)
        scatter = self.scatter + self.counts @ (self.means - means[group]) ** 2
        return type(self)(means, counts, scatter)


def average_equal_rows(
    X: Array, values: AveragedOutputs, exact: bool, numbers: Indices
) -> tuple[Indices, AveragedOutputs]:
    """Average the outputs of equal rows.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The states.
    values : AveragedOutputs
        The outputs of these rows, which may be averages themselves.
    exact : bool
        Whether equal rows must have equal outputs.
    numbers : ndarray of shape (n_samples,)
        The numbers of the rows, for the error.

    Returns
    -------
    first : ndarray of shape (n_distinct,)
        The first row of each group of equal rows, in rising order.
    averaged : AveragedOutputs
        The outputs at these rows.

    Raises
    ------
    ValueError
        If `exact`, and equal rows have different outputs.
    """
    first, group, _ = distinct_rows(X)
    if len(first) == len(X):
        return first, values
    if exact:
        _check_equal_rows_agree(values.means, group, numbers)
    return first, values.merged(group)


def average_at(points: Array, X: Array, values: AveragedOutputs) -> AveragedOutputs:
    """Average the outputs of the rows that equal each of some points.

    Parameters
    ----------
    points : ndarray of shape (n_points, n_features)
        The points; each is among the rows.
    X : ndarray of shape (n_samples, n_features)
        The states.
    values : AveragedOutputs
        The outputs of these rows, which may be averages themselves.

    Returns
    -------
    averaged : AveragedOutputs
        The outputs at the points.
    """
    rows = _rows_that_may_equal(points, X)
    _, group, _ = distinct_rows(np.vstack([points, X[rows]]))
    # The groups of the points have the first numbers.
    own, group = group[: len(points)], group[len(points) :]
    at_points = group <= own.max()
    rows, group = rows[at_points], group[at_points]
    return values.take(rows).merged(group).take(own)


def average_at_distance_zero(
    rows: Indices, distances: Array, values: AveragedOutputs
) -> AveragedOutputs:
    """Average the outputs of the rows at distance zero from each of some centres.

    Parameters
    ----------
    rows : ndarray of shape (n_centers,)
        One such row for each centre.
    distances : ndarray of shape (n_samples, n_centers)
        The distances of the rows to the centres.
    values : AveragedOutputs
        The outputs of the rows.

    Returns
    -------
    averaged : AveragedOutputs
        The outputs at the centres.
    """
    nearest = distances.argmin(axis=1)
    at_center = np.flatnonzero(distances[np.arange(len(distances)), nearest] == 0)
    # Equal centres share one of their numbers.
    used, group = np.unique(nearest[at_center], return_inverse=True)
    own = np.searchsorted(used, nearest[rows])
    return values.take(at_center).merged(group).take(own)


def _rows_that_may_equal(points: Array, X: Array) -> Indices:
    """Return all rows that equal a point, and hardly any other."""
    keys, wanted = _keys(X), np.sort(_keys(points))
    place = np.minimum(np.searchsorted(wanted, keys), len(wanted) - 1)
    return np.flatnonzero(wanted[place] == keys)


def _keys(X: Array) -> Array:
    """Return numbers that are equal for equal rows, and hardly for any others.

    They are sums of the entries, weighted at random. Terms are added in the same order
    for every row: a matrix product would not give equal rows equal sums.
    """
    factors = np.random.default_rng(0).uniform(1.0, 2.0, size=(X.shape[1],))
    keys = np.zeros(len(X))
    for start in range(0, len(X), KEY_ROWS):
        rows = slice(start, start + KEY_ROWS)
        for column, factor in enumerate(factors):
            keys[rows] += factor * X[rows, column]
    return keys


def _check_equal_rows_agree(values: Array, group: Indices, numbers: Indices) -> None:
    """Refuse equal rows whose outputs differ by more than rounding.

    Parameters
    ----------
    values : ndarray of shape (n_samples, n_outputs)
        The outputs.
    group : ndarray of shape (n_samples,)
        The number of the group of equal rows that each row belongs to.
    numbers : ndarray of shape (n_samples,)
        The numbers of the rows, for the error.

    Raises
    ------
    ValueError
        If the outputs of a group differ.
    """
    deviation = np.abs(values - group_means(values, group)[group]).max(axis=1)
    worst = int(deviation.argmax())
    if deviation[worst] <= 1e-10 * np.abs(values).max():
        return
    equal = np.flatnonzero(group == group[worst])
    away = np.abs(values[equal] - values[equal[0]]).max(axis=1)
    one, other = numbers[equal[[0, away.argmax()]]]
    raise ValueError(
        f"rows {one} and {other} of X are equal but their outputs differ; set alpha > "
        "0 or method='least_squares', or add delays to the states."
    )
