"""Angles that wrap at a full turn."""

import numpy as np

from ._typing import Array
from ._warnings import warn

TURNS = (360.0, 2 * np.pi)


def find_wraps(rows: Array, following: Array) -> dict[int, float]:
    """Find the columns that hold angles which wrap.

    Such a column lies within one turn and steps now and then by nearly a turn, never by
    about half of one. Counted around the circle, these steps are about as small as the
    others, which distinguishes them from the jumps of a switch or of a sawtooth.

    Parameters
    ----------
    rows : ndarray of shape (n_links, n_columns)
        Samples.
    following : ndarray of shape (n_links, n_columns)
        The next sample after each of them.

    Returns
    -------
    turns : dict of int to float
        The full turn, 360 or 2 pi, of each column that wraps.
    """
    turns: dict[int, float] = {}
    size = np.abs(following - rows)
    if size.max(initial=0.0) < 0.75 * min(TURNS):
        return turns
    high = np.maximum(rows.max(axis=0), following.max(axis=0))
    extent = high - np.minimum(rows.min(axis=0), following.min(axis=0))
    for turn in TURNS:
        is_wrap, is_small = size >= 0.75 * turn, size <= 0.25 * turn
        usual = np.where(is_small, size, 0.0).max(axis=0)
        around = np.where(is_wrap, np.abs(turn - size), 0.0).max(axis=0)
        wraps = is_wrap.any(axis=0) & (is_wrap | is_small).all(axis=0)
        # Rounded angles may leave the turn a little.
        wraps &= (extent <= 1.01 * turn) & (around <= 2 * usual)
        turns |= dict.fromkeys(np.flatnonzero(wraps).tolist(), turn)
    return turns


def warn_of_wraps(found: dict[str, dict[str, float]]) -> None:
    """Warn of angles that wrap, and say how to mend them.

    Parameters
    ----------
    found : dict of str to dict of str to float
        The turns of the columns of arrays, by name. The first of them is shown.
    """
    found = {label: turns for label, turns in found.items() if turns}
    if not found:
        return
    label, turns = next(iter(found.items()))
    turn = next(iter(turns.values()))
    columns = ", ".join(name for name in turns if turns[name] == turn)
    others = f" (and {len(found) - 1} more arrays)" if len(found) > 1 else ""
    period = "360" if turn == 360 else "2 * np.pi"
    warn(
        f"{label}{others} jumps by almost a full turn in column {columns}: these "
        "angles wrap, and the jumps are no motion. Unwrap them by np.unwrap(..., "
        f"axis=0, period={period})."
    )
