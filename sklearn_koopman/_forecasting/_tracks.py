"""Recordings as arrays with gaps: the past of every row, and what follows it."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_array

from .._utils._clocks import RATE_TOLERANCE
from .._utils._embedding import embed
from .._utils._recordings import Recording, read_recordings
from .._utils._typing import Array, Indices
from .._utils._validation import check_columns, check_integer


class Track(NamedTuple):
    """One recording.

    Attributes
    ----------
    states : ndarray of shape (n_rows, n_features)
        The samples, NaN in gaps.
    outputs : ndarray of shape (n_rows, n_outputs)
        What is to be forecast, NaN where it is not known.
    pieces : list of slice
        The stretches without a gap.
    """

    states: Array
    outputs: Array
    pieces: Sequence[slice]

    @property
    def piece(self) -> Indices:
        """The number of the piece that each row is in, -1 in gaps."""
        numbers = np.full(len(self.states), -1)
        for number, rows in enumerate(self.pieces):
            numbers[rows] = number
        return numbers

    def embedded(self, offsets: Indices, embedding: str) -> Array:
        """Return the past of every row, NaN where it is too short."""
        width = len(offsets) * self.states.shape[1]
        past = np.full((len(self.states), width), np.nan)
        for rows in self.pieces:
            first = min(rows.start + int(offsets[-1]), rows.stop)
            past[first : rows.stop] = embed(self.states[rows], offsets, embedding)
        return past

    def following(self, horizons: Indices) -> Array:
        """Return the outputs at all horizons, NaN where a gap or the end comes first.

        Returns
        -------
        outputs : ndarray of shape (n_rows, n_horizons, n_outputs)
            Entry k, h is the output `horizons[h]` rows after row k.
        """
        shape = (len(self.states), len(horizons), self.outputs.shape[1])
        following = np.full(shape, np.nan)
        for rows in self.pieces:
            outputs = self.outputs[rows]
            for number, horizon in enumerate(horizons):
                known = outputs[horizon:]
                following[rows.start : rows.start + len(known), number] = known
        return following


class Tracks(NamedTuple):
    """Recordings with the same columns.

    Attributes
    ----------
    tracks : list of Track
        One a recording.
    names : list of str
        The names of the columns, numbered ones where there are none.
    has_names : bool
        Whether the names are those of DataFrames.
    output_names : list of str
        The names of the outputs.
    rate : float or None
        Samples a second, where an index of time stamps tells.
    columns : ndarray of int
        The columns that are the outputs; none if these are given by themselves.
    """

    tracks: list[Track]
    names: list[str]
    has_names: bool
    output_names: list[str]
    rate: float | None
    columns: Indices


class Seen(NamedTuple):
    """What the recordings of `fit` were like.

    Attributes
    ----------
    names : list of str
        The names of their columns, numbered ones where they had none.
    has_names : bool
        Whether they had names.
    rate : float or None
        Samples a second, if known.
    n_outputs : int or None
        The number of outputs that were no columns.
    """

    names: list[str]
    has_names: bool
    rate: float | None
    n_outputs: int | None


def read_tracks(X: Any, y: Any, targets: Any, seen: Seen | None = None) -> Tracks:
    """Validate recordings, and find their gaps and outputs.

    Parameters
    ----------
    X : list of array-like of shape (n_rows, n_features)
        The recordings.
    y : list of array-like of shape (n_rows,) or (n_rows, n_outputs), or None
        Outputs that are no columns of `X`.
    targets : None, or list of str or int
        The columns of `X` that are forecast; None takes all, unless there is `y`.
    seen : Seen, default=None
        What the recordings have to be like; None in `fit`.
    """
    items = as_list(X, "X")
    read = read_recordings(
        items, None, gaps="split", rates=None, resample=None, name="X"
    )
    has_names = any(map(_has_names, items))
    names = read.names
    if seen is not None:
        _check_seen(read.names, has_names, read.rate, seen)
        names = seen.names
    states = [_without_gaps(recording) for recording in read.recordings]
    columns: list[int] = []
    if y is not None:
        if targets is not None:
            raise ValueError(
                f"both y and targets={targets!r} say what is forecast; pass y for "
                "outputs that X does not hold, else targets alone."
            )
        outputs, output_names = _read_outputs(items, y)
        n_outputs = outputs[0].shape[1]
        if seen is not None and seen.n_outputs not in (None, n_outputs):
            raise ValueError(
                f"y has {n_outputs} outputs, that of fit had {seen.n_outputs}; pass "
                "the same outputs."
            )
    elif seen is not None and seen.n_outputs is not None:
        outputs = [np.full((len(each), seen.n_outputs), np.nan) for each in states]
        output_names = [f"y{number}" for number in range(seen.n_outputs)]
    else:
        columns = find_columns(targets, names)
        outputs = [each[:, columns] for each in states]
        output_names = [names[column] for column in columns]
    tracks = [
        Track(each, output, recording.pieces)
        for each, output, recording in zip(
            states, outputs, read.recordings, strict=True
        )
    ]
    return Tracks(
        tracks,
        names,
        has_names,
        output_names,
        read.rate,
        np.array(columns, dtype=np.intp),
    )


def check_horizons(horizons: Any) -> Indices:
    """Return horizons as an array; refuse any but different positive whole numbers."""
    numbers = np.asarray(horizons)
    is_list = numbers.ndim == 1 and numbers.dtype.kind in "iu" and len(numbers) > 0
    if not is_list or numbers.min() < 1 or len(np.unique(numbers)) < len(numbers):
        raise ValueError(
            "horizons must be different positive numbers of samples, such as (15, 30), "
            f"got {horizons!r}."
        )
    return numbers.astype(np.intp)


def pick_start(past: Array, following: Array, start: int | None) -> int:
    """Return a row to forecast from, by default the last one that can be judged.

    Parameters
    ----------
    past : ndarray of shape (n_rows, n_embedded)
        The past of the rows, NaN where there is no forecast.
    following : ndarray of shape (n_rows, n_horizons, n_outputs)
        What came, NaN where that is not known.
    start : int or None
        The row that was asked for.
    """
    has_past = np.asarray(np.isfinite(past).all(axis=1))
    if start is not None:
        check_integer(start, "start", 0)
        if start >= len(past):
            raise ValueError(
                f"start={start} is no row; choose one from 0 to {len(past) - 1}."
            )
        if not has_past[start]:
            raise ValueError(
                f"start={start} has no forecast, as its past is too short or holds a "
                "gap; choose another row."
            )
        return int(start)
    judged = has_past & np.isfinite(following).all(axis=(1, 2))
    rows = np.flatnonzero(judged if judged.any() else has_past)
    if not len(rows):
        raise ValueError(
            "the recording has no forecast, as the past of every row is too short or "
            "holds a gap; pass a longer one, or fill its gaps by kinematics.fill_gaps."
        )
    return int(rows[-1])


def as_list(data: Any, name: str) -> list[Any]:
    """Return recordings as a list; refuse what is no list of recordings."""
    if isinstance(data, np.ndarray) and data.dtype == object and data.ndim == 1:
        data = list(data)
    if isinstance(data, dict):
        raise ValueError(f"{name} is a dict; pass list({name}.values()).")
    if not isinstance(data, list | tuple) or len(data) == 0:
        shape = getattr(data, "shape", None)
        what = f"of shape {shape}" if shape is not None else repr(data)[:40]
        remedy = f"; pass [{name}] for one recording" if shape is not None else ""
        if shape is not None and len(shape) == 3:
            remedy = f"; pass list({name}) if its first axis counts recordings"
        raise ValueError(
            f"{name} must be a non-empty list of recordings, of shape (n_rows, "
            f"n_columns) each, got {type(data).__name__} {what}{remedy}."
        )
    for number, item in enumerate(data):
        if getattr(item, "shape", None) is None:
            raise ValueError(
                f"{name}[{number}] is a {type(item).__name__}; a recording is an array "
                "or a DataFrame: pass numpy.asarray of it, and one recording as [it]."
            )
    return list(data)


def find_columns(targets: Any, names: list[str]) -> list[int]:
    """Return the numbers of the columns that are forecast."""
    if targets is None:
        return list(range(len(names)))
    if isinstance(targets, str | bytes) or not np.iterable(targets):
        raise ValueError(f"targets={targets!r} must be a list of columns; pass [...].")
    columns: list[int] = []
    for target in targets:
        is_number = isinstance(target, int | np.integer) and not isinstance(
            target, bool
        )
        if is_number and 0 <= target < len(names):
            columns.append(int(target))
        elif isinstance(target, str) and target in names:
            columns.append(names.index(target))
        else:
            raise ValueError(
                f"targets holds {target!r}, which is no column of X; it has {names}."
            )
    if not columns or len({*columns}) < len(columns):
        raise ValueError(f"targets={targets!r} must name each of some columns once.")
    return columns


def _has_names(recording: Any) -> bool:
    """Whether the columns of a recording have names, other than their numbers."""
    columns = getattr(recording, "columns", None)
    return columns is not None and list(columns) != list(range(len(columns)))


def _check_seen(
    names: list[str], has_names: bool, rate: float | None, seen: Seen
) -> None:
    """Refuse recordings that are not like those of `fit`."""
    differ = seen.has_names and has_names and names != seen.names
    if differ or len(names) != len(seen.names):
        raise ValueError(
            f"the recordings have the columns {names}, those of fit had {seen.names}; "
            "pass the same columns in the same order."
        )
    if rate and seen.rate and abs(rate / seen.rate - 1) > RATE_TOLERANCE:
        raise ValueError(
            f"the recordings have {rate:g} samples a second, those of fit had "
            f"{seen.rate:g}; interpolate them to the same rate."
        )


def _without_gaps(recording: Recording) -> Array:
    """Return the states, NaN in all columns of rows in gaps."""
    states = recording.samples.states.copy()
    is_gap = np.ones(len(states), dtype=bool)
    for rows in recording.pieces:
        is_gap[rows] = False
    states[is_gap] = np.nan
    return states


def _read_outputs(items: list[Any], y: Any) -> tuple[list[Array], list[str]]:
    """Return outputs that are given by themselves, NaN where they are missing."""
    given = as_list(y, "y")
    if len(given) != len(items):
        raise ValueError(
            f"y holds {len(given)} recordings, X {len(items)}; pass one for each."
        )
    outputs: list[Array] = []
    for number, (values, states) in enumerate(zip(given, items, strict=True)):
        if isinstance(values, np.ma.MaskedArray):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        output = check_array(
            values,
            dtype=np.float64,
            ensure_2d=False,
            ensure_all_finite="allow-nan",
            input_name=f"y[{number}]",
        )
        output = output.reshape(len(output), -1)
        if len(output) != len(states):
            raise ValueError(
                f"y[{number}] has {len(output)} rows, X[{number}] {len(states)}; "
                "outputs stand in the rows in which they are measured, not shifted."
            )
        if outputs and output.shape[1] != outputs[0].shape[1]:
            raise ValueError(
                f"y[{number}] has {output.shape[1]} outputs, y[0] "
                f"{outputs[0].shape[1]}; pass the same outputs for all recordings."
            )
        check_columns(values, f"y[{number}]", given[0], "y[0]")
        is_frame = [hasattr(each, "iloc") for each in (values, states)]
        if all(is_frame) and not values.index.equals(states.index):
            raise ValueError(
                f"y[{number}] and X[{number}] have different indices; bring them to "
                "one by reindex."
            )
        outputs.append(output)
    names = getattr(given[0], "columns", None)
    names = [f"y{i}" for i in range(outputs[0].shape[1])] if names is None else names
    return outputs, [str(name) for name in names]
