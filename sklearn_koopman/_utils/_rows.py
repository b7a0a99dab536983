"""Rows: how far they spread, which are equal, and the means of their outputs."""

from typing import Any, NamedTuple, Self

import numpy as np
from sklearn.utils import gen_batches

from ._typing import Array, Indices
from ._warnings import warn

# Rows that are compared with their mean at a time, so that no copy of all is made.
CHUNK_ROWS = 2**12


def spread(X: Array, sample_weight: Array | None = None) -> float:
    """Measure how far rows spread, the scale that estimators take by default.

    It is the root of the mean squared distance of the rows from their mean.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The rows.
    sample_weight : ndarray of shape (n_samples,), default=None
        How often each row counts, at least one of them above 0. By default all once.

    Returns
    -------
    spread : float
        The square root of the sum of the variances of the columns; 1 if all rows that
        count are equal.
    """
    if sample_weight is not None:
        X, sample_weight = X[sample_weight > 0], sample_weight[sample_weight > 0]
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


def warn_without_spread(estimator: Any, spread: float) -> None:
    """Warn that the first of several batches had no spread, which later ones need.

    Parameters
    ----------
    estimator : estimator instance
        What learns from the batches.
    spread : float
        The spread of the first batch; 1 where there is none.

    Warns
    -----
    UserWarning
        If a parameter stands for the spread.
    """
    if spread != 1:
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
        The number of rows with that state.
    scatter : ndarray of shape (n_outputs,)
        The sum of the squared deviations of all rows from the means.
    """

    means: Array
    counts: Array
    scatter: Array

    def take(self, rows: Indices) -> Self:
        """Return the outputs at some of the states."""
        return type(self)(self.means[rows], self.counts[rows], self.scatter)

    def joined(self, y: Array) -> Self:
        """Return these outputs followed by those of further, distinct rows."""
        counts = np.append(self.counts, np.ones(len(y)))
        return type(self)(np.vstack([self.means, y]), counts, self.scatter)


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
    counts = np.bincount(group, values.counts).astype(np.float64)
    means = group_means(values.means, group, values.counts)
    scatter = values.scatter + values.counts @ (values.means - means[group]) ** 2
    return first, AveragedOutputs(means, counts, scatter)


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
