"""Recordings: their samples, clocks, gaps and names."""

from __future__ import annotations

import warnings
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from sklearn.utils import check_array

from ._clocks import HOLE, Clock, find_clocks, read_together, resolve_rates
from ._typing import Array, Indices, Mask
from ._validation import check_choice, check_columns, check_number
from ._wraps import find_wraps, warn_of_wraps


class Samples(NamedTuple):
    """Consecutive samples, evenly spaced in time.

    Attributes
    ----------
    states : ndarray of shape (n_samples, n_features)
        The states.
    outputs : ndarray of shape (n_samples,) or (n_samples, n_outputs)
        The outputs.
    frame : ndarray of shape (n_samples,)
        The number of each sample in its recording, or its label in an integer index.
    time : ndarray of shape (n_samples,)
        In seconds if the rate is known, else in samples.
    remaining : ndarray of shape (n_samples,)
        The number of samples from each one to the end of its recording.
    """

    states: Array
    outputs: Array
    frame: Indices
    time: Array
    remaining: Indices

    def take(self, piece: slice) -> Samples:
        """Return some of the samples."""
        x, y, frame, time, remaining = self
        return Samples(x[piece], y[piece], frame[piece], time[piece], remaining[piece])


class Recording(NamedTuple):
    """All samples of a recording, and where they follow each other without a gap.

    Attributes
    ----------
    samples : Samples
        All of them, NaN where there is a gap.
    pieces : list of slice
        The stretches without a gap, in the order of time.
    """

    samples: Samples
    pieces: list[slice]

    def cut(self, rate: float | None, *, from_end: bool = False) -> list[Samples]:
        """Return the pieces, resampled if there is a rate to resample them to.

        Parameters
        ----------
        rate : float or None
            The new rate in samples a second.
        from_end : bool, default=False
            Whether the new samples are counted back from the last sample of the
            recording, instead of on from the first one of the piece.

        Returns
        -------
        pieces : list of Samples
            One a piece. Some may hold no samples if they are counted from the end.
        """
        cut = [self.samples.take(piece) for piece in self.pieces]
        if rate is None:
            return cut
        first, last = self.samples.time[[0, -1]]
        return [
            _resample(piece, rate, first, last, last if from_end else piece.time[0])
            for piece in cut
        ]


class Recordings(NamedTuple):
    """Recordings with the same columns.

    Attributes
    ----------
    recordings : list of Recording
        One for each trajectory.
    names : list of str
        The names of the states.
    output_names : list of str
        The names of the outputs.
    is_pandas : bool
        Whether the states of one of them, at least, were a DataFrame of pandas.
    rate : float or None
        Samples a second of all of them, where they or an index tell.
    """

    recordings: list[Recording]
    names: list[str]
    output_names: list[str]
    is_pandas: bool
    rate: float | None


def read_recordings(
    trajectories: Any,
    outputs: Any,
    *,
    gaps: str,
    rates: Any,
    resample: Any,
    name: str = "trajectories",
) -> Recordings:
    """Validate recordings, and find their clocks, gaps and wraps.

    Parameters
    ----------
    trajectories : array-like, or list of them
        The states of one recording or of several.
    outputs : array-like, list of them or None
        The outputs; None takes the states.
    gaps : {"raise", "split"}
        Whether a gap is an error.
    rates : None, float or list of float
        Samples a second, of all recordings or of each.
    resample : float or None
        The rate that the recordings will be resampled to.
    name : str, default="trajectories"
        The parameter that holds the states, for errors.

    Returns
    -------
    recordings : Recordings
        One for each trajectory.

    Raises
    ------
    ValueError
        If anything is wrong with the recordings. The message says what, and where.

    Warns
    -----
    UserWarning
        If angles wrap.
    """
    check_choice(gaps, "gaps", ("raise", "split"))
    if resample is not None:
        check_number(resample, "resample", positive=True)
    items = _as_list(trajectories, name)
    states = _as_arrays(items, name, gaps)
    names = output_names = _column_names(items, states[0], "x")
    targets, measured = items, states
    if outputs is not None:
        targets = _as_list(outputs, "outputs")
        measured = _as_arrays(targets, "outputs", gaps)
        output_names = _column_names(targets, measured[0], "y")
    lengths = _check_lengths(states, measured)
    labels = [
        read_together(item, target, number)
        for number, (item, target) in enumerate(zip(items, targets, strict=True))
    ]
    clocks = find_clocks(labels, lengths, resample)
    if gaps == "raise":
        _refuse_holes(clocks)
    rates = resolve_rates(rates, clocks, resample)
    recordings = [
        _divide(*each) for each in zip(states, measured, clocks, rates, strict=True)
    ]
    wraps = _wraps_in(recordings, "states", name, names)
    if outputs is not None:
        wraps |= _wraps_in(recordings, "outputs", "outputs", output_names)
    warn_of_wraps(wraps)
    is_pandas = any(hasattr(item, "iloc") for item in items)
    rate = rates[0] if resample is None else resample
    return Recordings(recordings, names, output_names, is_pandas, rate)


def _check_lengths(states: list[Array], outputs: list[Array]) -> list[int]:
    """Return the lengths of the recordings, which are those of their outputs."""
    if len(states) != len(outputs):
        raise ValueError(
            f"outputs holds {len(outputs)} arrays for {len(states)} trajectories; "
            "pass one array of outputs for every trajectory."
        )
    for number, (x, y) in enumerate(zip(states, outputs, strict=True)):
        if len(x) != len(y):
            raise ValueError(
                f"trajectory {number} has {len(x)} samples but its outputs have "
                f"{len(y)}; states and outputs must be sampled together."
            )
    return [len(x) for x in states]


def _divide(x: Array, y: Array, clock: Clock, rate: float | None) -> Recording:
    """Number and time the samples of a recording, and find the pieces between gaps."""
    is_there = _complete(x) & _complete(y.reshape(len(y), -1))
    is_link = is_there[1:] & is_there[:-1] & (clock.steps <= HOLE)
    return Recording(_samples(x, y, clock, rate), _pieces(is_there, is_link))


def _wraps_in(
    recordings: list[Recording], kind: str, label: str, names: list[str]
) -> dict[str, dict[str, float]]:
    """Find angles that wrap in the states or outputs, but not across gaps."""
    wraps = {}
    for number, (samples, pieces) in enumerate(recordings):
        values = getattr(samples, kind).reshape(len(samples.time), -1)
        is_start = np.zeros(len(values), dtype=bool)
        for piece in pieces:
            is_start[piece.start : piece.stop - 1] = True
        starts = np.flatnonzero(is_start)
        turns = find_wraps(values[starts], values[starts + 1])
        wraps[f"{label}[{number}]"] = {names[c]: turn for c, turn in turns.items()}
    return wraps


def _as_list(data: Any, name: str) -> list[Any]:
    """Return one recording or several as a list; refuse arrays with three axes."""
    if isinstance(data, np.ndarray) and data.dtype == object and data.ndim == 1:
        data = list(data)  # of arrays of unequal length
    shape = getattr(data, "shape", None)
    if shape is not None:
        _refuse_axes(shape, name)
        return [data]
    is_list = hasattr(data, "__len__") and not isinstance(data, str | bytes | dict)
    if not is_list or len(data) == 0:
        remedy = "; pass list(data.values())" if isinstance(data, dict) else ""
        raise ValueError(
            f"{name} must be an array or a non-empty list of arrays, got a "
            f"{type(data).__name__}{remedy}."
        )
    # One recording may be a list of rows, which are lists, or of numbers.
    first = [data[0]] if name == "outputs" else data[0]
    is_row = isinstance(first, list | tuple) and len(first) > 0
    if is_row and all(isinstance(value, Real) for value in first):
        return [list(data)]
    return list(data)


def _column_names(items: list[Any], first: Array, prefix: str) -> list[str]:
    """Return the names of the columns of the first frame, else numbered ones.

    Parameters
    ----------
    items : list of array-like
        The recordings as they were given.
    first : ndarray of shape (n_samples,) or (n_samples, n_columns)
        The values of the first one.
    prefix : str
        What to put in front of the number of a column without a name.

    Returns
    -------
    names : list of str
        One a column. Parts of a name with several are joined by "_".
    """
    n_columns = first.shape[1] if first.ndim == 2 else 1
    for item in items:
        columns = getattr(item, "columns", None)
        if first.ndim == 1 and getattr(item, "name", None):
            columns = [item.name]  # of a Series
        if columns is not None and list(columns) != list(range(n_columns)):
            return [
                "_".join(map(str, name)) if isinstance(name, tuple) else str(name)
                for name in columns
            ]
    return [f"{prefix}{column}" for column in range(n_columns)]


def _refuse_holes(clocks: list[Clock]) -> None:
    """Refuse indices that leave out samples."""
    for number, clock in enumerate(clocks):
        is_hole = clock.steps > HOLE
        if is_hole.any():
            first = int(is_hole.argmax())
            before, after = clock.labels[[first, first + 1]]
            raise ValueError(
                f"the index of trajectory {number} has a hole in {is_hole.sum()} "
                f"places, first from {before:.12g} to {after:.12g}; pass "
                "gaps='split', or fill it by reindexing and kinematics.fill_gaps. "
                "(Only an index that counts neither frames nor seconds may be dropped "
                "by reset_index(drop=True).)"
            )


def _refuse_axes(shape: tuple[int, ...], name: str) -> None:
    """Refuse arrays with more than two axes."""
    if len(shape) < 3:
        return
    remedy = "Several trajectories are a list of arrays with two axes: list(array)."
    if len(shape) == 3 and shape[0] in (3, 4) and shape[2] > 4:
        remedy = (
            "Points of a c3d file, of shape (4, markers, frames), become a recording "
            f"by points[:3].transpose(2, 1, 0).reshape({shape[2]}, -1). {remedy}"
        )
    elif len(shape) == 3 and shape[2] in (2, 3):
        remedy = (
            "One recording of shape (frames, markers, 3) becomes one with two axes by "
            f"array.reshape({shape[0]}, -1). {remedy}"
        )
    raise ValueError(f"{name} has shape {shape}, not (n_samples, n_features). {remedy}")


def _as_arrays(items: list[Any], name: str, gaps: str) -> list[Array]:
    """Validate recordings into float arrays with NaN in their gaps."""
    arrays: list[Array] = []
    frames = [n for n, item in enumerate(items) if hasattr(item, "columns")]
    named = frames[0] if frames else 0
    for number, item in enumerate(items):
        label = f"{name}[{number}]"
        _refuse_axes(getattr(item, "shape", ()), label)
        try:
            array, is_masked = _as_array(item)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{label}: {error}") from error
        if array.ndim != 2 and (array.ndim != 1 or name != "outputs"):
            raise ValueError(
                f"{label} has shape {array.shape}, not (n_samples, n_features); pass "
                "several trajectories as a list, a scalar one with .reshape(-1, 1), or "
                "of a Series .to_frame()."
            )
        empty = np.flatnonzero(np.isnan(array).reshape(len(array), -1).any(axis=1))
        if len(empty) and gaps == "raise":
            raise ValueError(
                f"{label} holds {'masked values' if is_masked else 'NaN'} in "
                f"{len(empty)} of {len(array)} samples, first in sample {empty[0]}; "
                "fill the gaps by kinematics.fill_gaps, or pass gaps='split'."
            )
        arrays.append(array)
        if array.shape[1:] != arrays[0].shape[1:]:
            raise ValueError(
                f"{label} has shape {array.shape}, but {name}[0] has "
                f"{arrays[0].shape}; pass arrays with the same columns."
            )
        check_columns(item, label, items[named], f"{name}[{named}]")
    return arrays


def _as_array(item: Any) -> tuple[Array, bool]:
    """Return an array of floats, NaN where values are masked, and whether any are."""
    is_masked = False
    with warnings.catch_warnings():
        # A masked element among Python objects becomes NaN, as it should.
        warnings.filterwarnings("ignore", message=".*converting a masked element")
        if isinstance(item, list | tuple | np.ma.MaskedArray):
            masked: Any = np.ma.array(item)  # keeps the masks of the rows of a list
            is_masked = bool(np.ma.getmaskarray(masked).any())
            item = (
                masked.astype(np.float64).filled(np.nan) if is_masked else masked.data
            )
        array = check_array(
            item, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan"
        )
    return array, is_masked


def _samples(x: Array, y: Array, clock: Clock, rate: float | None) -> Samples:
    """Number the samples of a recording, and time them."""
    steps = np.maximum(np.rint(clock.steps), 1).astype(np.intp)
    place = np.concatenate([[0], np.cumsum(steps)])
    frame, time = np.arange(len(x)), place / (rate or 1.0)
    if clock.labels is not None:
        if clock.labels.dtype.kind == "i":
            frame = clock.labels
        else:
            time = clock.labels
    return Samples(x, y, frame, time, place[-1] - place)


def _complete(values: Array) -> Mask:
    """Return which rows have no NaN."""
    return np.asarray(np.isfinite(values).all(axis=1))


def _pieces(is_there: Mask, is_link: Mask) -> list[slice]:
    """Return the longest stretches of samples that follow each other."""
    is_start = is_there & ~np.concatenate([[False], is_link])
    is_stop = is_there & ~np.concatenate([is_link, [False]])
    starts, stops = np.flatnonzero(is_start), np.flatnonzero(is_stop) + 1
    return [slice(*ends) for ends in zip(starts, stops, strict=True)]


def _resample(
    piece: Samples, rate: float, first: float, last: float, anchor: float
) -> Samples:
    """Interpolate a piece at all times within it that are whole periods from an anchor.

    Parameters
    ----------
    piece : Samples
        Consecutive samples, timed in seconds.
    rate : float
        The new rate in samples a second.
    first, last : float
        The times of the first and last sample of the recording.
    anchor : float
        The time of one new sample.

    Returns
    -------
    resampled : Samples
        The new samples.
    """
    start, stop = piece.time[[0, -1]]
    # Times are sums of rounded numbers: a millionth of a period is no extrapolation.
    numbers = np.arange(
        np.ceil((start - anchor) * rate - 1e-6),
        np.floor((stop - anchor) * rate + 1e-6) + 1,
    )
    time = np.clip(anchor + numbers / rate, start, stop)

    def interpolate(values: Array) -> Array:
        degree = min(3, len(values) - 1)
        if not degree:
            return values[: len(time)]
        return make_interp_spline(piece.time - start, values, degree)(time - start)

    return Samples(
        interpolate(piece.states),
        interpolate(piece.outputs),
        (np.rint((anchor - first) * rate) + numbers).astype(np.intp),
        time,
        np.rint((last - time) * rate).astype(np.intp),
    )
