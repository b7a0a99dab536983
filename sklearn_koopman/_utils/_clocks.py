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
# More samples for one than this are a mistake in the unit of time.
MAX_UPSAMPLING = 50
UNITS = {"milliseconds": 1000, "microseconds": 10**6, "nanoseconds": 10**9}


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


def find_index(*data: Any) -> Any:
    """Return the index of the first DataFrame or Series, else None.

    Parameters
    ----------
    *data : object
        DataFrames, Series, or anything else, which has no index.

    Returns
    -------
    index : pandas.Index or None
        Its index.
    """
    indices = (getattr(item, "index", None) for item in data)
    # A list has a method of this name.
    return next((i for i in indices if hasattr(i, "get_level_values")), None)


def read_labels(index: Any, label: str) -> Any:
    """Return what the innermost level of an index tells about time.

    Parameters
    ----------
    index : pandas.Index
        The index.
    label : str
        Whose index it is, for errors.

    Returns
    -------
    labels : ndarray of shape (n_samples,), or None
        Frames, which are integers, of whole numbers and periods; seconds, which are
        floats, of all other numbers and times; None of anything else.

    Raises
    ------
    ValueError
        If some of these labels are missing.
    """
    index = index.get_level_values(-1).infer_objects()
    kind = index.dtype.kind
    is_period = kind == "O" and hasattr(index, "asi8")
    if kind not in "iufmM" and not is_period:
        return None
    if index.hasnans:
        row = int(np.argmax(index.isna()))
        raise ValueError(
            f"the index of {label} has no label in row {row} ({index[row]}); drop "
            "that row, or number the rows by reset_index(drop=True) if none is missing."
        )
    if is_period:
        return index.asi8
    if kind in "iu":
        return index.to_numpy(dtype=np.int64)
    if kind == "M":
        index = index - index.min()
    return (index if kind == "f" else index.total_seconds()).to_numpy(dtype=np.float64)


def count_recordings(index: Any) -> int:
    """Return how many recordings an index tells apart.

    Parameters
    ----------
    index : pandas.Index
        The index.

    Returns
    -------
    n_recordings : int
        The number of distinct labels of its outer levels; or, of an index of names,
        that of the names if some of them repeat.
    """
    if index.nlevels > 1:
        return int(index.droplevel(-1).nunique(dropna=False))
    index = index.infer_objects()
    is_name = index.dtype.kind == "O" and not hasattr(index, "asi8")
    return int(index.nunique(dropna=False)) if is_name and not index.is_unique else 1


def find_steps(
    labels: Any, label: str, remedy: str | None, usual: Any = None
) -> tuple[Array, float]:
    """Return the steps of labels, relative to the usual one.

    The usual step of frames is the smallest, since holes are longer. That of seconds is
    the mean over those that are not much longer than the median, since they jitter.

    Parameters
    ----------
    labels : ndarray of shape (n_samples,)
        Rising frames or seconds, at least two.
    label : str
        Whose index they are, for errors.
    remedy : str or None
        What to do about irregular time stamps; None allows them.
    usual : int, default=None
        The usual step of frames, if other recordings tell it.

    Returns
    -------
    steps : ndarray of shape (n_samples - 1,)
        The steps. Those longer than `HOLE` are holes.
    usual : float
        The usual one.

    Raises
    ------
    ValueError
        If seconds are irregular, or if frames seem to be milliseconds.
    """
    step = np.diff(labels)
    if labels.dtype.kind == "i":
        _refuse_milliseconds(step, label)
        usual = step.min() if usual is None else usual
        # A step that is no multiple of the usual one is a hole, too.
        return np.where(step > usual, np.maximum(step / usual, 2), 1.0), float(usual)
    usual = step[step <= HOLE * np.median(step)].mean()
    relative = step / usual
    is_odd = (np.abs(relative - 1) > JITTER) & (relative <= HOLE)
    if is_odd.any() and remedy is not None:
        first = int(is_odd.argmax())
        raise ValueError(
            f"the time stamps of {label} are irregular: from row {first} to "
            f"{first + 1} they step by {step[first]:.6g}, but by {usual:.6g} on "
            f"average; {remedy}."
        )
    return relative, float(usual)


def _refuse_milliseconds(step: Array, label: str) -> None:
    """Refuse whole numbers that are time stamps, whose steps differ throughout."""
    least = step.min()
    is_usual = step <= HOLE * least
    n_odd = (is_usual & (step > least)).sum()
    if is_usual.mean() > 0.5 and n_odd > max(2, 0.05 * len(step)):
        unit, factor = next(
            (unit, factor)
            for unit, factor in UNITS.items()
            if least < factor or unit == "nanoseconds"
        )
        raise ValueError(
            f"the index of {label} steps by {least} to {step[is_usual].max()}, as time "
            f"stamps in whole {unit} do, but whole numbers count frames; make it "
            f"seconds, data.set_axis(data.index / {factor})."
        )


def read_together(states: Any, outputs: Any, number: int) -> Any:
    """Return the labels of a recording, which its states and outputs must share.

    Parameters
    ----------
    states, outputs : object
        The states and outputs as they were given.
    number : int
        The number of the recording, for errors.

    Returns
    -------
    labels : ndarray of shape (n_samples,), or None
        As of `read_labels`, rising.

    Raises
    ------
    ValueError
        If the indices differ, do not increase, or tell several recordings apart.
    """
    index, other = find_index(states), find_index(outputs)
    label = f"trajectory {number}"
    if index is not None and other is not None and not index.equals(other):
        raise ValueError(
            f"the states and outputs of {label} have different indices; bring them to "
            "one, by outputs.set_axis(states.index) if their rows belong together as "
            "they stand, or by outputs.reindex(states.index) if their labels do."
        )
    index = other if index is None else index
    if index is None:
        return None
    n_recordings = count_recordings(index)
    if n_recordings > 1:
        raise ValueError(
            f"the index of {label} holds {n_recordings} recordings; pass them as a "
            "list, [part for _, part in data.groupby(level=0)], or drop an index that "
            "means nothing by reset_index(drop=True)."
        )
    labels = read_labels(index, label)
    if labels is None:
        return None
    is_back = ~(np.diff(labels) > 0)
    if is_back.any():
        first = int(is_back.argmax())
        raise ValueError(
            f"the index of {label} does not increase from row {first} to {first + 1} "
            f"({labels[first]} to {labels[first + 1]}); pass several recordings as a "
            "list, [part for _, part in data.groupby(...)], or sort one by sort_index."
        )
    return labels


def find_clocks(labels: list[Any], lengths: list[int], resample: Any) -> list[Clock]:
    """Find the usual step of each index; refuse time stamps that have none.

    Parameters
    ----------
    labels : list of ndarray of shape (n_samples,), or None
        The labels of each recording.
    lengths : list of int
        The number of samples of each.
    resample : float or None
        The rate that the recordings will be resampled to.

    Returns
    -------
    clocks : list of Clock
        One for each recording.

    Raises
    ------
    ValueError
        If time stamps are irregular, unless they will be resampled.
    """
    frames = [own for own in labels if own is not None and own.dtype.kind == "i"]
    usual, remedy = None, None
    if resample is None:
        # Frames have one usual step in all recordings of one rate: every second frame
        # in one of them is half of the rate.
        usual = min((np.diff(f).min() for f in frames if len(f) > 1), default=None)
        remedy = "pass resample=, or interpolate the recording onto a regular grid"
    clocks = []
    for number, (own, n) in enumerate(zip(labels, lengths, strict=True)):
        if own is None or n < 2:
            clocks.append(Clock(own, np.ones(max(n - 1, 0)), None))
            continue
        steps, step = find_steps(own, f"trajectory {number}", remedy, usual)
        clocks.append(Clock(own, steps, 1 / step if own.dtype.kind == "f" else None))
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
            labels = clocks[number].labels
            hint = ""
            if (labels == np.rint(labels)).all():
                hint = " (for frames: data.set_axis(data.index.astype(int)))"
            raise ValueError(
                f"rates gives trajectory {number} {own:g} Hz, but its index, which is "
                f"in seconds, has {other:g} Hz; correct one of them{hint}, or leave "
                "rates out."
            )
    known = [own or other for own, other in zip(given, found, strict=True)]
    if resample is not None:
        for number, rate in enumerate(known):
            if rate is None:
                raise ValueError(
                    f"resample={resample!r} needs the rate of trajectory {number}; "
                    "pass rates=, or frames of two or more rows indexed by seconds."
                )
            if resample > MAX_UPSAMPLING * rate:
                raise ValueError(
                    f"resample={resample!r} makes {resample / rate:.3g} samples of "
                    f"each one of trajectory {number}, whose rate is {rate:.4g} Hz; "
                    "an index of time stamps must be in seconds."
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
            f"resample={slowest:.4g}, or interpolate them to one rate before."
        )
    return [rate or slowest for rate in known]
