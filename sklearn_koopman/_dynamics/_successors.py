"""Which state follows which: the pairs that an operator is estimated from."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from sklearn.utils import check_array

from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman._utils._validation import check_magnitude
from sklearn_koopman.trajectories import successor_rows


def check_successors(X: Any, X_next: Any) -> Array:
    """Validate X_next as X is validated, names of features included."""
    if np.shape(X_next) != np.shape(X):
        raise ValueError(
            f"X_next has shape {np.shape(X_next)}, but X has {np.shape(X)}; pass "
            "the successor of every row, or sample_index where some have none."
        )
    names, of_X = (getattr(data, "columns", None) for data in (X_next, X))
    if names is not None and of_X is not None and list(names) != list(of_X):
        raise ValueError(
            f"X_next has the columns {list(names)}, but X has {list(of_X)}; bring "
            "them into one order."
        )
    successors = check_array(X_next, dtype=np.float64, input_name="X_next")
    check_magnitude(successors, smallest=0.0, name="X_next")
    return np.asarray(successors, dtype=np.float64)


def find_successors(X: Array, X_next: Any, sample_index: Any) -> tuple[Indices, Array]:
    """Return the rows that have a successor, and these."""
    links = None
    if sample_index is not None:
        if np.shape(sample_index)[:1] != X.shape[:1]:
            raise ValueError(
                f"sample_index has shape {np.shape(sample_index)}, but X has {len(X)} "
                "rows; pass one integer a row."
            )
        links = successor_rows(sample_index)
    if X_next is not None:
        if links is not None and not np.allclose(
            X_next[links[0]], X[links[1]], rtol=1e-6, atol=1e-6 * np.abs(X).max()
        ):
            raise ValueError(
                "X_next and sample_index contradict each other: the row that is one "
                "higher in sample_index is not the successor in X_next. Pass one of "
                "them; behind a scaler, transform X_next, too (transform_input)."
            )
        if (links is None or len(links[0]) == 0) and on_another_scale(X, X_next):
            warnings.warn(
                "X_next seems to live on another scale than X, as it does when a "
                "scaler in front transforms X only; then the eigenvalues are wrong. "
                "Enable metadata routing and use Pipeline(..., "
                "transform_input=['X_next']), or pass sample_index instead.",
                UserWarning,
                stacklevel=3,
            )
        return np.arange(len(X)), X_next
    if links is not None:
        if len(links[0]) == 0:
            raise ValueError(
                f"sample_index links none of the n_samples={len(X)} rows: no index is "
                "one higher than another. Pass consecutive integers along each "
                "trajectory."
            )
        return links[0], X[links[1]]
    if len(X) < 2:
        raise ValueError(
            "n_samples=1: one row has no successor; pass a trajectory of at least two "
            "rows, or X_next."
        )
    return np.arange(len(X) - 1), X[1:]


def on_another_scale(X: Array, X_next: Array) -> bool:
    """Tell whether successors plainly are in other units than the states.

    Along a trajectory sampled k times a step, the successor of a row is the row k
    further on. If instead it is a linear function of that row, feature by feature, but
    another one than the identity, then one of them has been scaled. Where rows do not
    follow each other, only a difference of all features by a factor of 30 tells.
    """
    spread = X.std(axis=0)
    varies = spread > 1e-9 * np.abs(X).max(axis=0)
    if len(X) < 10 or not varies.any():
        return False
    ratio = X_next.std(axis=0)[varies] / spread[varies]
    if (ratio > 30).all() or ((ratio > 0) & (ratio < 1 / 30)).all():
        return True
    # Eight features are enough, and many take long.
    shown = np.flatnonzero(varies)[:8]
    now, then, spread = X[:512, shown], X_next[:512, shown], spread[shown]
    ratio = ratio[:8]
    scale = then.std(axis=0)
    same, _ = _distance_from_line(now, then)
    scaled = False
    for k in range(1, min(64, len(now) // 4)):
        following, images = now[k:], then[:-k]
        apart = np.median(np.abs(images - following), axis=0)
        if (apart < 0.02 * spread).all():
            return False
        left, slope = _distance_from_line(following, images)
        # The map itself may be linear; but then the row tells its successor as well.
        clear = (same > 1e-6 * scale) & (left < np.minimum(0.02 * scale, same / 3))
        # Scaled as a whole, and not just from one turn of a spiral to the next.
        clear &= np.abs(slope - ratio) < 0.1 * ratio
        scaled |= bool((clear & (apart > 0.05 * spread)).any())
    return scaled


def _distance_from_line(a: Array, b: Array) -> tuple[Array, Array]:
    """Distance of features b from their best linear functions of a, and the slopes.

    In root mean square over the nearest four fifths of the rows, since trajectories end
    in between.
    """
    kept = np.ones(a.shape)
    for _ in range(3):
        count = kept.sum(axis=0)
        x = a - (kept * a).sum(axis=0) / count
        y = b - (kept * b).sum(axis=0) / count
        length = (kept * x**2).sum(axis=0)
        slope = (kept * x * y).sum(axis=0) / np.where(length > 0, length, 1.0)
        squares = (y - slope * x) ** 2
        kept = (squares <= np.quantile(squares, 0.8, axis=0)).astype(float)
    return np.sqrt((kept * squares).sum(axis=0) / kept.sum(axis=0)), slope
