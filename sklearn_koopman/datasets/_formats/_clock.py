"""Frame numbers and rates, from the stamps of a file."""

import numpy as np

from ..._utils._typing import Array
from ..._utils._warnings import warn
from ._recording import Recording
from ._text import Table

# Stamps in seconds may be rounded to milliseconds, and rates to 1 %.
TIME_ROUNDING = 0.001
RATE_TOLERANCE = 0.01
MAX_DECIMALS = 12


def read_clock(recording: Recording, rate: float | None) -> tuple[Array, float]:
    """Return the time of each frame in seconds, and the frames per second.

    A rate that is None is that of the file, or is read off its stamps in seconds. Where
    these do not tell, it is returned as NaN.
    """
    rate_name = "rate" if rate is not None else recording.rate_name
    given, rate = rate, rate if rate is not None else recording.rate
    table, column = recording.table, recording.stamps
    if column is None:
        _warn_of_rates(given, recording)
        return np.arange(len(table)) / (rate or np.nan), rate or np.nan
    stamps = _stamps(table, column)
    is_whole = bool((stamps == np.rint(stamps)).all())
    is_frames = is_whole if recording.is_seconds is None else not recording.is_seconds
    _check_steps(table, column, stamps, is_frames=is_frames)
    if is_frames:
        _warn_of_rates(given, recording)
        return (stamps - recording.first_frame) / (rate or np.nan), rate or np.nan
    steps, span = len(stamps) - 1, float(stamps[-1] - stamps[0])
    rate = rate or (rate_of_stamps(stamps) if steps else np.nan)
    if abs(span - steps / rate) > RATE_TOLERANCE * steps / rate + TIME_ROUNDING:
        raise ValueError(
            f"Time advances by {steps / span:.4g} frames per second, but {rate_name} "
            f"is {rate:g}; correct Time, or pass rate={steps / span:.4g}."
        )
    # Time begins at a whole frame if rounding allows it.
    first, frames = stamps[0] * rate, np.arange(len(stamps))
    whole = np.rint(first)
    is_rounded = abs(first - whole) <= TIME_ROUNDING * rate
    return ((whole if is_rounded else first) + frames) / rate, rate


def _warn_of_rates(given: float | None, recording: Recording) -> None:
    """Warn of a rate that is given against the head, where no seconds decide."""
    stated = recording.rate
    if given and stated and abs(given - stated) > RATE_TOLERANCE * stated:
        warn(
            f"rate={given:g} is used, but {recording.rate_name} is {stated:g}; leave "
            "rate out if the file is right."
        )


def _stamps(table: Table, column: int) -> Array:
    """Return the column of the clock; refuse blanks."""
    stamps: Array = table.read([column])[:, 0]
    for i in np.flatnonzero(~np.isfinite(stamps)):
        raise ValueError(
            f"{table.place(i)}: {table.labels[column]} is blank; write it, or remove "
            "the line."
        )
    return stamps


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
    if not len(steps):
        return
    forward = np.sort(steps[steps > 0])
    # The lower median: one of two steps may be long.
    usual = 1.0 if is_frames or not len(forward) else forward[(len(forward) - 1) // 2]
    uneven = steps != 1 if is_frames else (steps <= 0) | (steps > 1.5 * usual)
    for i in np.flatnonzero(uneven):
        raise ValueError(
            f"{table.place(i + 1)}: {table.labels[column]} goes from {stamps[i]:g} to "
            f"{stamps[i + 1]:g}; sort the frames, and split the file at gaps."
        )
    even = np.linspace(stamps[0], stamps[-1], len(stamps))
    late = np.abs(stamps - even)
    if late.max() > max(usual / 2, TIME_ROUNDING):
        raise ValueError(
            f"the steps of {table.labels[column]} vary from {steps.min():.4g} to "
            f"{steps.max():.4g}; export the file at a fixed rate."
        )
