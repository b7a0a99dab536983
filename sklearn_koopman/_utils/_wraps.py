"""Angles that wrap at a full turn."""

import numpy as np

from ._typing import Array
from ._warnings import warn

TURNS = (360.0, 2 * np.pi)
# Angles that wrap have glitches in no more than this part of their steps.
MAX_STRANGE = 0.1
# A joint that turns farther than this, in radians, has its angles in degrees.
MAX_TURN = 4 * np.pi


def find_degrees(angles: Array) -> tuple[int, float] | None:
    """Find the column whose angles, in radians, are too large for any joint.

    Parameters
    ----------
    angles : ndarray of shape (n_samples, n_columns)
        Angles that are said to be in radians, NaN where they are missing.

    Returns
    -------
    found : tuple of int and float, or None
        The column with the largest angle, and this angle.
    """
    sizes = np.max(np.abs(angles), axis=0, initial=0.0, where=~np.isnan(angles))
    if sizes.max(initial=0.0) <= MAX_TURN:
        return None
    return int(sizes.argmax()), float(sizes.max())


def find_wraps(rows: Array, following: Array) -> dict[int, float]:
    """Find the columns that hold angles which wrap.

    Such a column lies within one turn and steps now and then by nearly a turn. Counted
    around the circle, these steps are about as small as the others, which distinguishes
    them from the jumps of a switch or of a sawtooth. A few steps may be neither, as
    those into and out of a glitch; noise has many of them.

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
    largest = np.abs(following - rows).max(axis=0, initial=0.0)
    for column in np.flatnonzero(largest >= 0.75 * min(TURNS)).tolist():
        for turn in TURNS:
            if _wraps(rows[:, column], following[:, column], turn):
                turns[column] = turn
    return turns


def _wraps(values: Array, following: Array, turn: float) -> bool:
    """Tell whether one column holds angles that wrap at this turn."""
    size = np.abs(following - values)
    around = np.abs(size - turn)  # the size of a wrap as a motion
    is_small = size <= 0.25 * turn
    if not is_small.any():
        return False
    usual = np.sort(size[is_small])
    # The largest ones may be those into and out of a small glitch or two.
    large = usual[-1 - min(len(usual) // 100, 4)]
    is_wrap = around <= min(2 * large, 0.25 * turn)
    if not is_wrap.any():
        return False
    ordered = np.sort(np.concatenate([values, following]))
    # Rounded angles may leave the turn a little.
    n_inside = np.searchsorted(ordered, ordered + 1.01 * turn, side="right")
    n_outside = len(ordered) - (n_inside - np.arange(len(ordered))).max()
    n_strange = max(n_outside / 2, np.count_nonzero(~(is_small | is_wrap)))
    if n_strange == 0:
        return True
    is_rare = n_strange <= min(np.count_nonzero(is_wrap), MAX_STRANGE * len(size))
    # The jumps of a noisy switch differ from a turn by more than its noise, while an
    # angle that swings is at most sqrt(2) times as fast as in the mean square.
    is_usual = np.median(around[is_wrap]) <= 1.5 * np.sqrt(np.mean(usual**2))
    return bool(is_rare and is_usual)


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
        "angles wrap, and the jumps are no motion. Encode angles that turn on and on "
        "by kinematics.RotationEncoder; unwrap others by "
        f"kinematics.unwrap_angles(..., period={period}), before gaps are filled."
    )
