"""Successors of states: the pairs from which an operator is estimated."""

from typing import Any

import numpy as np
from sklearn.utils import check_array

from .._utils._labels import REMEDY, order_of_labels
from .._utils._recordings import find_wraps, warn_of_wraps
from .._utils._typing import Array, Indices, Mask
from .._utils._validation import check_columns, check_magnitude
from .._utils._warnings import warn
from ..trajectories import match_successors, successor_rows

# Values agree that differ by at most this part of the largest one, since some of them
# may have been rounded to single precision.
AGREEMENT = 1e-6
# So many outputs are looked up among the states before all of them are.
SAMPLE = 64


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
    if len(links[0]) and y is not None:
        _check_outputs(X, given, y, links)
    if (np.diff(clock) == 1).all():
        _check_delays(X)
    _warn_of_wraps(X, given, links)
    return links


def _check_outputs(
    X: Array, given: Any, y: Any, links: tuple[Indices, Indices]
) -> None:
    """Refuse links if the outputs are columns of the states, but of other rows."""
    outputs = np.asarray(y, dtype=np.float64).reshape(len(X), -1)
    starts = range(X.shape[1] - outputs.shape[1] + 1)
    if any(_agree(outputs, X, links, start).all() for start in starts):
        return
    matched = match_successors(given, y) if _may_match(outputs, X) else None
    # Outputs that are the state of their own row tell nothing of successors.
    if matched is None or np.mean(matched[0] == matched[1]) > 0.5:
        return
    start = max(starts, key=lambda start: _agree(outputs, X, matched, start).sum())
    first = np.flatnonzero(~_agree(outputs, X, links, start))[0]
    row, following = links[0][first], links[1][first]
    where = matched[1][matched[0] == row]
    finding = f"the state of row {where[0]}" if len(where) else "no row's state"
    raise ValueError(
        f"y of most rows is the state of a row. That of row {row} is {finding}, but "
        f"row {following} would be taken to follow row {row}. {REMEDY}"
    )


def _check_delays(X: Array) -> None:
    """Refuse rows in which the delayed copies of a state belong to other rows."""
    earlier = X[:, 1:]
    if X.shape[1] == 1 or not _may_match(X[:, :1], earlier):
        return
    matched = match_successors(earlier, X[:, 0])
    if matched is None:
        return
    shift = int(np.median(matched[1] - matched[0]))
    if shift < 1 or np.mean(matched[1] - matched[0] == shift) < 0.5:
        return
    links = np.arange(len(X) - shift), np.arange(shift, len(X))
    agree = [_agree(X[:, :1], earlier, links, k) for k in range(earlier.shape[1])]
    best = max(agree, key=np.sum)
    if best.all():
        return
    row = int(np.flatnonzero(~best)[0])
    raise ValueError(
        f"Most rows hold copies of what the row {shift} before them holds, but row "
        f"{row + shift} does not: a recording ends before it. {REMEDY}"
    )


def _warn_of_wraps(X: Array, given: Any, links: tuple[Indices, Indices]) -> None:
    """Warn of angles that wrap, as trajectory_pairs does, which has not seen these."""
    turns = find_wraps(X[links[0]], X[links[1]])
    names = list(getattr(given, "columns", range(X.shape[1])))
    for turn in {*turns.values()}:
        shown = [str(names[column]) for column in turns if turns[column] == turn]
        warn_of_wraps("X", shown, turn)


def _agree(
    outputs: Array, X: Array, links: tuple[Indices, Indices], start: int
) -> Mask:
    """Tell which outputs are the values in some columns of the row that is linked."""
    columns = X[links[1], start : start + outputs.shape[1]]
    tolerance = AGREEMENT * np.abs(outputs).max(axis=0)
    agree: Mask = (np.abs(outputs[links[0]] - columns) <= tolerance).all(axis=1)
    return agree


def _may_match(outputs: Array, X: Array) -> bool:
    """Tell whether a sample of the outputs occurs in some column of the states."""
    sample = np.unique(outputs[:: max(len(outputs) // SAMPLE, 1), 0])
    tolerance = AGREEMENT * np.abs(sample).max()
    below = np.searchsorted(sample - tolerance, X, side="right")
    occurs = below > np.searchsorted(sample + tolerance, X, side="left")
    return bool((occurs.sum(axis=0) >= len(sample) / 4).any())


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
