"""Clocks of recordings: what their indices and rates tell about time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ._typing import Array
from ._validation import check_positive

# Neighbouring time stamps may differ by this part of the usual step. Stamps at 250 Hz
# that are rounded to milliseconds do so.
JITTER = 0.25
HOLE = 1.5  # usual steps: a longer one is a gap
# Rates that were read off time stamps are equal within this part.
RATE_TOLERANCE = 0.01


class Clock(NamedTuple):
    """What the index of a recording tells about its samples.

    Attributes
    ----------
    labels : ndarray of shape (n_samples,) or None
        Whole numbers, which are frames, or seconds; None for neither.
    steps : ndarray of shape (n_samples - 1,)
        Steps of the labels, of which 1 is the usual one.
    rate : float or None
        Samples a second, where the labels are seconds.
    """

    labels: Any
    steps: Array
    rate: float | None


def read_labels(states: Any, outputs: Any, number: int) -> Any:
    """Return the frames (integers) or seconds (floats) of an index, or None."""
    index, other = (_index(item) for item in (states, outputs))
    if index is not None and other is not None and not index.equals(other):
        raise ValueError(
            f"the states and outputs of trajectory {number} have different indices; "
            "bring them to one, by outputs.reindex(states.index) for example."
        )
    index = other if index is None else index
    if index is None:
        return None
    label = f"trajectory {number}"
    if index.nlevels > 1:
        outer = index.droplevel(-1)
        if outer.nunique() > 1:
            raise ValueError(
                f"the index of {label} holds {outer.nunique()} recordings; pass them "
                "as a list, [part for _, part in data.groupby(level=0)]."
            )
        index = index.get_level_values(-1)
    kind = index.dtype.kind
    if kind not in "iufmM":
        return None
    if kind == "M":
        index = index - index[0]
    labels = index.total_seconds() if kind in "mM" else index
    labels = labels.to_numpy(dtype=np.int64 if kind in "iu" else np.float64)
    is_back = ~(np.diff(labels) > 0)
    if is_back.any():
        first = int(is_back.argmax())
        raise ValueError(
            f"the index of {label} does not increase from row {first} to {first + 1} "
            f"({labels[first]} to {labels[first + 1]}); pass several recordings as a "
            "list, [part for _, part in data.groupby(...)], or sort one by sort_index."
        )
    return labels


def _index(item: Any) -> Any:
    """Return the index of a pandas object, else None."""
    index = getattr(item, "index", None)  # a list has a method of this name
    return index if hasattr(index, "get_level_values") else None


def find_clocks(labels: list[Any], states: list[Array], resample: Any) -> list[Clock]:
    """Find the usual step of each index; refuse time stamps that have none."""
    steps = [
        np.ones(len(x) - 1) if own is None else np.diff(own)
        for x, own in zip(states, labels, strict=True)
    ]
    # Frames have one usual step in all recordings of one rate: every second frame in
    # one of them is half of the rate.
    smallest = [step.min() for step in steps if step.dtype.kind == "i" and len(step)]
    clocks = []
    for number, (own, step) in enumerate(zip(labels, steps, strict=True)):
        if own is None or not len(step):
            clocks.append(Clock(own, step, None))
            continue
        if own.dtype.kind == "i":
            usual = step.min() if resample is not None else min(smallest)
            # A step that is no multiple of the usual one is a hole, too.
            relative = np.where(step > usual, np.maximum(step / usual, 2), 1.0)
            clocks.append(Clock(own, relative, None))
            continue
        usual = step[step <= HOLE * np.median(step)].mean()
        relative = step / usual
        is_odd = (np.abs(relative - 1) > JITTER) & (relative <= HOLE)
        if is_odd.any() and resample is None:
            first = int(is_odd.argmax())
            raise ValueError(
                f"the time stamps of trajectory {number} are irregular: from row "
                f"{first} to {first + 1} they step by {step[first]:.6g}, but by "
                f"{usual:.6g} on average; pass resample=, or interpolate the recording "
                "onto a regular grid."
            )
        clocks.append(Clock(own, relative, float(1 / usual)))
    return clocks


def resolve_rates(rates: Any, clocks: list[Clock], resample: Any) -> list[float | None]:
    """Return the rate of each recording; refuse rates that differ or contradict."""
    n = len(clocks)
    found = [clock.rate for clock in clocks]
    given: list[float | None] = [None] * n
    if rates is not None:
        numbers = check_positive(rates, "rates")
        if len(numbers) not in ({1, n} if np.ndim(rates) == 0 else {n}):
            raise ValueError(
                f"rates={rates!r} holds {len(numbers)} rates for {n} trajectories; "
                "pass one number, or one for each."
            )
        given = np.broadcast_to(numbers, n).tolist()
    for number, (own, other) in enumerate(zip(given, found, strict=True)):
        if own and other and abs(own / other - 1) > RATE_TOLERANCE:
            raise ValueError(
                f"rates gives trajectory {number} {own:g} Hz, but its index has "
                f"{other:g} Hz; correct one of them, or leave rates out."
            )
    known = [own or other for own, other in zip(given, found, strict=True)]
    if resample is not None:
        if None in known:
            raise ValueError(
                f"resample={resample!r} needs the rate of trajectory "
                f"{known.index(None)}; pass rates=, or frames indexed by seconds."
            )
        return known
    every = [rate for rate in known if rate is not None]
    if not every:
        return known
    slowest, fastest = min(every), max(every)
    if fastest > slowest * (1 + (RATE_TOLERANCE if rates is None else 0)):
        raise ValueError(
            f"the trajectories have unequal rates, from {slowest:g} to {fastest:g} Hz, "
            "so that a lag means different times; pass resample=, for example "
            f"resample={slowest:g}."
        )
    return [rate or slowest for rate in known]
