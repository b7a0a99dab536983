"""Frame numbers and rates, from the stamps of a file."""

import numpy as np

from .._utils._typing import Array
from ._formats._recording import Recording
from ._formats._text import Table

# Stamps in seconds may be rounded to milliseconds, and rates to 1 %.
TIME_ROUNDING = 0.001
RATE_TOLERANCE = 0.01
MAX_DECIMALS = 12


def read_clock(recording: Recording, rate: float | None) -> tuple[Array, float | None]:
    """Return the number of each frame, from 0 at time 0, and the frames per second.

    A rate that is None is that of the file, or is read off its stamps in seconds. It
    remains None where these do not tell.
    """
    rate_name = "rate" if rate is not None else recording.rate_name
    rate = rate if rate is not None else recording.rate
    table, column = recording.table, recording.stamps
    if column is None:
        return np.arange(float(len(table))), rate
    stamps: Array = table.read([column])[:, 0]
    for i in np.flatnonzero(~np.isfinite(stamps)):
        raise ValueError(
            f"{table.place(i)}: {table.labels[column]} is blank; write it, or remove "
            "the line."
        )
    is_whole = bool((stamps == np.rint(stamps)).all())
    is_frames = is_whole if recording.is_seconds is None else not recording.is_seconds
    _check_steps(table, column, stamps, is_frames=is_frames)
    if is_frames:
        return stamps - recording.first_frame, rate
    steps, span = len(stamps) - 1, float(stamps[-1] - stamps[0])
    if rate is None:
        if not steps:
            return np.zeros(1), None
        rate = rate_of_stamps(stamps)
    if abs(span - steps / rate) > RATE_TOLERANCE * steps / rate + TIME_ROUNDING:
        raise ValueError(
            f"Time advances by {steps / span:.4g} frames per second, but {rate_name} "
            f"is {rate:g}; correct Time, or pass rate={steps / span:.4g}."
        )
    return np.rint(stamps[0] * rate) + np.arange(len(stamps)), rate


def rate_of_stamps(stamps: Array) -> float:
    """Return the rate of even stamps in seconds; a whole one if rounding allows it."""
    rate = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    whole = max(np.rint(rate), 1.0)
    decimals = next(
        (d for d in range(MAX_DECIMALS) if (np.round(stamps, d) == stamps).all()),
        MAX_DECIMALS,
    )
    exact = stamps[0] + np.arange(len(stamps)) / whole
    # Both the first stamp and each other one may be off by half of the last digit.
    is_whole = np.abs(stamps - exact).max() <= 1.01 * 10.0**-decimals
    return float(whole if is_whole else rate)


def _check_steps(table: Table, column: int, stamps: Array, *, is_frames: bool) -> None:
    """Refuse stamps that do not advance evenly."""
    steps = np.diff(stamps)
    if is_frames or not len(steps):
        uneven = np.flatnonzero(steps != 1)
    else:
        usual = np.sort(steps)[(len(steps) - 1) // 2]
        uneven = np.flatnonzero((steps <= 0) | (steps > 1.5 * usual))
    for i in uneven:
        raise ValueError(
            f"{table.place(i + 1)}: {table.labels[column]} goes from {stamps[i]:g} to "
            f"{stamps[i + 1]:g}; sort the frames, and split the file at gaps."
        )
