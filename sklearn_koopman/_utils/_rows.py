"""Equal rows: which they are, and their mean outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sklearn_koopman._utils._typing import Array, Indices


def distinct_rows(X: Array) -> tuple[Indices, Indices, Indices]:
    """Find equal rows.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The rows.

    Returns
    -------
    first : ndarray of shape (n_distinct,)
        The first of each lot of equal rows, in rising order.
    group : ndarray of shape (n_samples,)
        Which of them each row equals.
    counts : ndarray of shape (n_distinct,)
        How many rows equal each of them.
    """
    _, first, group, counts = np.unique(
        X, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    # In the order of the rows, not in that of their values.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[group.reshape(-1)], counts[order]


def group_means(values: Array, group: Indices) -> Array:
    """Average the rows of each group.

    Parameters
    ----------
    values : ndarray of shape (n_samples, n_columns)
        The rows.
    group : ndarray of shape (n_samples,)
        The number of the group that each row belongs to, as `distinct_rows` gives it.

    Returns
    -------
    means : ndarray of shape (n_groups, n_columns)
        The mean of each group.
    """
    counts = np.bincount(group)
    means = np.zeros((len(counts), values.shape[1]))
    np.add.at(means, group, values)
    means /= counts[:, np.newaxis]
    return means


@dataclass(frozen=True)
class AveragedOutputs:
    """Outputs at distinct states, as means of the rows that are equal."""

    means: Array  # (n_distinct, n_outputs)
    counts: Array  # (n_distinct,): how many rows each stands for
    scatter: Array  # (n_outputs,): sum of the squared deviations from the means

    def take(self, rows: Indices) -> AveragedOutputs:
        """Return the values at some of the states."""
        return AveragedOutputs(self.means[rows], self.counts[rows], self.scatter)

    def joined(self, y: Array) -> AveragedOutputs:
        """Return these values with those of further rows."""
        return AveragedOutputs(
            np.vstack([self.means, y]),
            np.append(self.counts, np.ones(len(y))),
            self.scatter,
        )


def merge_equal_rows(
    X: Array, values: AveragedOutputs, exact: bool, numbers: Indices
) -> tuple[Indices, AveragedOutputs]:
    """Average the values of equal rows.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The states.
    values : AveragedOutputs
        Their values.
    exact : bool
        Whether equal rows must have equal values.
    numbers : ndarray of shape (n_samples,)
        The numbers of the rows, for the error.

    Returns
    -------
    first : ndarray of shape (n_distinct,)
        The first of each lot of equal rows, in rising order.
    merged : AveragedOutputs
        The values there.

    Raises
    ------
    ValueError
        If `exact`, and equal rows have different values.
    """
    first, group, _ = distinct_rows(X)
    if len(first) == len(X):
        return first, values
    counts = np.zeros(len(first))
    np.add.at(counts, group, values.counts)
    means = np.zeros((len(first), values.means.shape[1]))
    np.add.at(means, group, values.counts[:, np.newaxis] * values.means)
    means /= counts[:, np.newaxis]
    deviation = values.means - means[group]
    worst = int(np.abs(deviation).max(axis=1).argmax())
    limit = 1e-10 * np.abs(values.means).max()
    if exact and np.abs(deviation[worst]).max() > limit:
        equal = np.flatnonzero(group == group[worst])
        away = np.abs(values.means[equal] - values.means[equal[0]]).max(axis=1)
        raise ValueError(
            f"rows {numbers[equal[0]]} and {numbers[equal[away.argmax()]]} of X are "
            "equal but their outputs differ: with alpha=0 no function interpolates "
            "both. Set alpha > 0 or method='least_squares', or add delays to the "
            "states."
        )
    scatter = values.scatter + values.counts @ deviation**2
    return first, AveragedOutputs(means, counts, scatter)
