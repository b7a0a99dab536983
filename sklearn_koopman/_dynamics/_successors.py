"""Successors of states: the pairs from which an operator is estimated."""

from typing import Any

import numpy as np
from sklearn.utils import check_array

from .._utils._labels import REMEDY, order_of_labels
from .._utils._typing import Array, Indices
from .._utils._validation import check_columns, check_magnitude
from .._utils._warnings import warn
from .._utils._wraps import find_wraps, warn_of_wraps
from ..trajectories import successor_rows
from ._shifts import find_break, find_contradiction


def check_successors(X: Any, X_next: Any) -> Array:
    """Validate X_next as X is validated, with its names of features."""
    if np.shape(X_next) != np.shape(X):
        raise ValueError(
            f"X_next has shape {np.shape(X_next)}, but X has {np.shape(X)}; pass "
            "the successor of every row, or sample_index where some have none."
        )
    check_columns(X_next, "X_next", X, "X")
    successors: Array = check_array(X_next, dtype=np.float64, input_name="X_next")
    check_magnitude(successors, smallest=0.0, name="X_next")
    return successors


def find_successors(
    X: Array,
    X_next: Array | None,
    sample_index: Any,
    given: tuple[Any, Any],
    weights: Array | None = None,
) -> tuple[Indices, Array]:
    """Return the rows of X that have a successor, and their successors.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The states.
    X_next : ndarray of shape (n_samples, n_features) or None
        The successors of all rows, if they are given.
    sample_index : array-like of shape (n_samples,) or None
        The place of each row on its trajectory. Without it and `X_next`, the labels of
        a data frame tell which rows follow each other, or else their order.
    given : tuple of two array-likes
        The states and the outputs as the user gave them. The outputs may be None.
    weights : ndarray of shape (n_samples,), default=None
        The weights of the rows. One of weight zero starts no pair, and is no successor
        of another row either.

    Returns
    -------
    rows : ndarray of shape (n_pairs,)
        The rows that have a successor.
    successors : ndarray of shape (n_pairs, n_features)
        Their successors.

    Raises
    ------
    ValueError
        If no row has a successor; if `X_next` and `sample_index` contradict each other,
        or the rows their order.

    Warns
    -----
    UserWarning
        If `X_next` appears to be on another scale than `X`; if the rows are a recording
        with angles that wrap.
    """
    rows = following = np.arange(0)
    if X_next is None and sample_index is None:
        rows, following = _follow_order(X, *given)
    elif sample_index is not None:
        if np.shape(sample_index)[:1] != X.shape[:1]:
            raise ValueError(
                f"sample_index has shape {np.shape(sample_index)}, but X has {len(X)} "
                "rows; pass one integer a row."
            )
        rows, following = successor_rows(sample_index)
    if X_next is not None:
        present = np.arange(len(X)) if weights is None else np.flatnonzero(weights)
        if sample_index is None or len(rows) == 0:
            if _is_on_another_scale(X[present], X_next[present]):
                warn(
                    "X_next seems to be on another scale than X, as if a scaler had "
                    "transformed X only. Pass sample_index instead, or set "
                    "transform_input=['X_next'] of the pipeline."
                )
        elif not np.allclose(
            X_next[rows], X[following], rtol=1e-6, atol=1e-6 * np.abs(X).max()
        ):
            raise ValueError(
                "X_next and sample_index contradict each other; pass one of them. "
                "Behind a scaler, transform X_next, too (transform_input=['X_next'])."
            )
        return present, X_next[present]
    if weights is not None:
        linked = (weights[rows] > 0) & (weights[following] > 0)
        rows, following = rows[linked], following[linked]
    if len(rows) == 0:
        kind = "rows" if weights is None else "rows, or none of positive weight"
        raise ValueError(
            f"Order or sample_index links none of the n_samples={len(X)} {kind}; pass "
            "at least two, with consecutive integers along trajectories, or X_next."
        )
    return rows, X[following]


def _follow_order(X: Array, given: Any, y: Any) -> tuple[Indices, Indices]:
    """Link rows by the labels of a data frame, else by their order.

    Neither knows of steps of several rows, and the order knows of no ends. They are
    trusted unless the outputs, or delayed copies of the states, contradict.
    """
    clock = order_of_labels(given, y)
    if clock is None:
        clock = np.arange(len(X))
    links = successor_rows(clock)
    if len(links[0]):
        _check_order(X, y, clock)
    names = [str(name) for name in getattr(given, "columns", range(X.shape[1]))]
    turns = find_wraps(X[links[0]], X[links[1]])
    warn_of_wraps({"X": {names[column]: turn for column, turn in turns.items()}})
    return links


def _check_order(X: Array, y: Any, clock: Indices) -> None:
    """Refuse an order of the rows that outputs or delayed copies contradict."""
    order = np.argsort(clock)
    clock = clock[order]
    states = X[order]
    if y is not None:
        outputs = np.asarray(y, dtype=np.float64).reshape(len(X), -1)[order]
        found = find_contradiction(outputs, states, clock)
        if found is not None:
            k = found.rows[np.argmax(found.is_equal == (found.shift > 1))]
            row, after, true = order[[k, k + 1, k + found.shift]]
            finding = f"another row; that of row {row} is the state of row {true}"
            if found.shift == 1:
                finding = f"the next row; that of row {row} is not that of row {after}"
            raise ValueError(
                f"y of most rows is the state of {finding}, but row {after} would be "
                f"taken to follow row {row}. {REMEDY}"
            )
    if (np.diff(clock) == 1).all():
        found = find_break(states)
        if found is not None:
            row = order[found.rows[np.argmin(found.is_equal)] + found.shift]
            raise ValueError(
                f"Most rows hold copies of what stands {found.shift} rows before them, "
                f"but row {row} does not: a recording ends before it. {REMEDY}"
            )


def _is_on_another_scale(X: Array, X_next: Array) -> bool:
    """Return whether the successors appear to be in other units than the states.

    They are if the spreads of all features differ by a factor of 30. They are, too, if
    the states have mean 0 and standard deviation 1, as StandardScaler leaves them, and
    the successors do not. Since motion alone can cause this, three conditions must
    hold. A mean differs by 0.2, or a standard deviation by 20 %, in some feature: in
    recorded trajectories short steps change them by up to 15 %, and by less than 5 % if
    the trajectories have many samples. The steps are short: states and successors are
    correlated in all features. And hardly any value of a successor occurs among the
    states: along trajectories that are given in full, most do.
    """
    spread = X.std(axis=0)
    varies = spread > 1e-9 * np.abs(X).max(axis=0)
    if len(X) < 10 or not varies.any():
        return False
    X, X_next, spread = X[:, varies], X_next[:, varies], spread[varies]
    next_spread = X_next.std(axis=0)
    ratio = next_spread / spread
    if (ratio > 30).all() or ((ratio > 0) & (ratio < 1 / 30)).all():
        return True
    if max(np.abs(X.mean(axis=0)).max(), np.abs(spread - 1).max()) > 1e-4:
        return False
    shift = np.abs(X_next.mean(axis=0))
    changes = (shift > 0.2) | (ratio > 1.2) | (ratio < 1 / 1.2)
    is_short = (X * X_next).mean(axis=0) > 0.7 * next_spread
    return bool(changes.any() and is_short.all() and np.isin(X_next, X).mean() < 0.1)
