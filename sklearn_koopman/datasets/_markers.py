"""Marker files: the tab-separated format of Fukuchi et al., and OpenSim's TRC."""

import os
from collections.abc import Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.utils import Bunch

from .._utils._typing import Array
from .._utils._validation import check_choice, check_number

IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# As files spell them out; the British end in -metre.
SPELLED_OUT = {"millimeters": "mm", "centimeters": "cm", "meters": "m"}
# Markers of a body that are closer together than this, in mm, or farther apart, have
# the unit that brings them nearest to the usual size.
MIN_BODY_SIZE, USUAL_BODY_SIZE, MAX_BODY_SIZE = 200.0, 1000.0, 3000.0
FRAMES_TO_MEASURE = 200
# Stamps in seconds may be rounded to milliseconds, and rates to 1 %.
TIME_ROUNDING = 0.001
RATE_TOLERANCE = 0.01


class _Header(NamedTuple):
    """The contents of the head of a marker file."""

    labels: list[str]  # of all columns
    columns: dict[str, list[int]]  # X, Y and Z column of each marker
    n_lines: int
    time_column: int
    rate: float
    unit: str = "mm"
    n_frames: float | None = None


_Rows = list[tuple[int, list[str]]]  # number of a line, from 1, and its fields


def load_markers(
    path: str | os.PathLike[str],
    *,
    markers: Sequence[str] | None = None,
    rate: float = 150.0,
    unit: str | None = None,
    gaps: str = "raise",
) -> Bunch:
    r"""Read marker positions from a tab-separated or an OpenSim TRC file.

    A file that is named ``*.trc`` or begins with ``PathFileType`` is read as TRC, any
    other file as the tab-separated format of [1]_. Coordinates are returned as they are
    in the file.

    Parameters
    ----------
    path : str or path-like
        The file.
    markers : sequence of str, default=None
        Names of the markers to read; None reads all. Only markers that are read are
        checked for gaps.
    rate : float, default=150.0
        Frames per second of a tab-separated file, which does not state it. Not used
        for TRC files, which state it.
    unit : {"mm", "cm", "m"}, default=None
        Unit of the coordinates. None takes the unit of the TRC header, or "mm" for a
        tab-separated file, and refuses a body that would be smaller than 20 cm or
        larger than 3 m, and that another unit brings nearer to 1 m. The body is that of
        all markers of the file, whichever are read. A unit that is given wins over the
        header, and is not checked.
    gaps : {"raise", "nan"}, default="raise"
        Whether gaps in the markers that are read are refused, or returned as NaN, for
        instance to fill them by :func:`~sklearn_koopman.kinematics.fill_gaps`.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        markers : dict of str to ndarray of shape (n_frames, 3)
            Positions of each marker.
        names : list of str
            The markers, in the order of the file or of `markers`.
        time : ndarray of shape (n_frames,)
            Time [s]: the number of the frame divided by the rate.
        rate : float
            Frames per second.
        unit : str
            Unit of the coordinates.
        filename : str
            The path of the file.
        DESCR : str
            A summary in one line.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is empty or not of either format; if a marker is missing, appears
        twice, or lacks a coordinate; if a marker that is read has gaps, unless `gaps`
        lets them pass; if a line has too few or too many fields, or a field is not a
        number; if frames are missing or out of order; if the rate or the numbers of
        frames and markers contradict the file; if the file names no unit, or one that
        the size of the body contradicts. The message names the file, the line or
        marker, and what to do.

    See Also
    --------
    load_trials : Reads arrays of several trials.
    make_walking : Synthetic markers.
    sklearn_koopman.kinematics.fill_gaps : Fills short gaps.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.

    Notes
    -----
    The tab-separated format has one line of column names,
    ``Time  NAMEX  NAMEY  NAMEZ ...``, and one line a frame. `Time` holds either the
    number of the frame or seconds; seconds may be rounded to milliseconds, and must
    agree with `rate` within 1 %. Frame numbers are whole and advance by one.

    The size of a body is the median over some hundred frames of the largest extent of
    all markers of the file along an axis. A single marker has no size, and is not
    checked.

    A gap is a blank, NaN or infinite coordinate. Some programs write ``0  0  0``
    instead; such zeros cannot be told from a position and are returned as they are.

    References
    ----------
    .. [1] C. A. Fukuchi, R. K. Fukuchi and M. Duarte, "A public dataset of overground
       and treadmill walking kinematics and kinetics in healthy individuals", PeerJ 6,
       e4640, 2018.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from sklearn_koopman.datasets import load_markers
    >>> text = "Time\tHipX\tHipY\tHipZ\tKneeX\tKneeY\tKneeZ\n"
    >>> text += "0\t0.0\t900.0\t80.0\t150.0\t480.0\t80.0\n"
    >>> text += "1\t9.5\t901.2\t80.1\t161.0\t481.5\t79.8\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "trial.txt"
    ...     _ = path.write_text(text)
    ...     trial = load_markers(path, rate=100)
    >>> trial.markers["Knee"]
    array([[150. , 480. ,  80. ],
           [161. , 481.5,  79.8]])
    >>> trial.time, trial.unit
    (array([0.  , 0.01]), 'mm')
    """
    check_number(rate, "rate", positive=True)
    check_choice(unit, "unit", (None, *IN_MM))
    check_choice(gaps, "gaps", ("raise", "nan"))
    where = os.fspath(path)
    # Bytes that cannot be decoded matter only where a name or number is expected.
    text = Path(path).read_text(encoding="utf-8-sig", errors="replace")
    lines = text.split("\n")
    is_trc = where.lower().endswith(".trc") or text.startswith("PathFileType")
    try:
        header = _trc_header(lines) if is_trc else _tsv_header(lines, float(rate))
        names = _select(markers, list(header.columns))
        rows = _rows(lines, header)
        frames = _frame_numbers(rows, header)
        positions = _positions(rows, header, names)
        if gaps == "raise":
            _refuse_gaps(positions, [line for line, _ in rows])
        units = unit or _unit_of_file(header.unit, _body(rows, header))
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return Bunch(
        markers=positions,
        names=names,
        time=frames / header.rate,
        rate=header.rate,
        unit=units,
        filename=where,
        DESCR=f"{len(names)} markers in {len(frames)} frames at {header.rate:g} Hz, "
        f"coordinates in {units}, read from {where}",
    )


def _tsv_header(lines: list[str], rate: float) -> _Header:
    """Read the line of column names of a tab-separated file."""
    labels = _cells(lines[0])
    if labels[0].lower() != "time" or len(labels) == 1:
        raise ValueError(
            f"line 1: found {lines[0][:40]!r}, expected tab-separated names 'Time', "
            "'NAMEX', 'NAMEY', 'NAMEZ', ...; TRC files begin with 'PathFileType'."
        )
    for label in labels[1:]:
        if len(label) == 1 or label[-1:] not in ("X", "Y", "Z"):
            raise ValueError(
                f"line 1: column {label!r} is not the X, Y or Z of a marker; name it "
                "so, or remove the column."
            )
    return _Header(labels, _columns(labels, 1), 1, 0, rate)


def _trc_header(lines: list[str]) -> _Header:
    """Read the five lines of the head of a TRC file."""
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise ValueError(
            f"line 1: found {lines[0][:40]!r}, expected the five lines of a TRC "
            "header, the first beginning with 'PathFileType'."
        )
    meta = dict(zip(_cells(lines[1]), _cells(lines[2]), strict=False))
    numbers = []
    for key in ("DataRate", "NumFrames", "NumMarkers"):
        try:
            numbers.append(float(meta[key]))
        except (KeyError, ValueError):
            raise ValueError(
                f"line 3: {key} is {meta.get(key)!r}, expected a number; separate "
                "the names of line 2 and the values of line 3 by tabs."
            ) from None
    rate, n_frames, n_markers = numbers
    unit = meta.get("Units", "")
    check_number(rate, "line 3: DataRate", positive=True)
    head, axes = _cells(lines[3]), _cells(lines[4])[2:]
    if [label[:5].lower() for label in head[:2]] != ["frame", "time"]:
        raise ValueError(
            f"line 4: found {lines[3][:40]!r}, expected 'Frame#', 'Time' and the names "
            "of the markers, separated by tabs."
        )
    names = [label for label in head[2:] if label]
    if not n_markers == len(names) == len(axes) / 3:
        raise ValueError(
            f"lines 3 to 5: NumMarkers is {n_markers:g}, but there are {len(names)} "
            f"names and {len(axes)} columns, not 3 for each; export the file again."
        )
    labels = [f"{names[i // 3]}{axis[:1].upper()}" for i, axis in enumerate(axes)]
    labels = [*head[:2], *labels]
    return _Header(labels, _columns(labels, 2), 5, 1, rate, unit, n_frames)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip().split("\t")]


def _columns(labels: list[str], first: int) -> dict[str, list[int]]:
    """Return the X, Y and Z column of each marker, from the labels of columns."""
    columns = {}
    for name in dict.fromkeys(label[:-1] for label in labels[first:]):
        triple = [f"{name}{axis}" for axis in "XYZ"]
        for label in triple:
            if labels.count(label) != 1:
                raise ValueError(
                    f"marker {name!r} has {labels.count(label)} columns {label!r}, not "
                    "one; export X, Y and Z of all markers, and give each its own name."
                )
        columns[name] = [labels.index(label) for label in triple]
    return columns


def _select(markers: Sequence[str] | None, names: list[str]) -> list[str]:
    """Return the names of the markers to read."""
    if markers is None:
        return names
    if isinstance(markers, str) or len(markers) == 0:
        raise ValueError(
            f"markers={markers!r}; pass a list of names, such as {names[:2]}, or None."
        )
    for marker in markers:
        if marker not in names:
            close = get_close_matches(str(marker), names, n=4, cutoff=0.5)
            hint = f"did you mean one of {close}? " * bool(close)
            raise ValueError(f"no marker {marker!r}; {hint}The file holds {names}.")
    return list(dict.fromkeys(markers))


def _rows(lines: list[str], header: _Header) -> _Rows:
    """Split the frames into fields, one for each column."""
    n_columns = len(header.labels)
    rows = [
        (number, line.split("\t"))
        for number, line in enumerate(lines, 1)
        if number > header.n_lines and line.strip()
    ]
    for number, fields in rows:
        if len(fields) < n_columns or any(f.strip() for f in fields[n_columns:]):
            raise ValueError(
                f"line {number}: found {len(fields)} fields separated by tabs, "
                f"expected {n_columns}; the line is damaged, export the file again."
            )
    if not rows:
        raise ValueError(f"no frames after line {header.n_lines}; export them again.")
    if header.n_frames not in (None, len(rows)):
        raise ValueError(
            f"found {len(rows)} frames, but NumFrames in line 3 is {header.n_frames}; "
            "the file was cut or edited, export it again."
        )
    return rows


def _floats(rows: _Rows, column: int, header: _Header) -> Array:
    """Convert one column; blank fields become NaN."""
    values = np.empty(len(rows))
    for i, (line, fields) in enumerate(rows):
        text = fields[column].strip()
        try:
            values[i] = float(text or "nan")
        except ValueError:
            raise ValueError(
                f"line {line}: {text!r} in column {header.labels[column]!r} is not a "
                "number; write a decimal point, and leave missing numbers blank."
            ) from None
    return values


def _frame_numbers(rows: _Rows, header: _Header) -> Array:
    """Return whole frame numbers from a column of frame numbers or of seconds."""
    stamps = _floats(rows, header.time_column, header)
    for i in np.flatnonzero(~np.isfinite(stamps)):
        raise ValueError(f"line {rows[i][0]}: Time is blank; write the frame number.")
    steps = np.diff(stamps)
    is_trc = header.n_frames is not None
    whole = not is_trc and bool((stamps == np.rint(stamps)).all())
    usual = 1.0 if whole or len(rows) == 1 else np.sort(steps)[(len(steps) - 1) // 2]
    for i in [*np.flatnonzero(steps <= 0), *np.flatnonzero(steps > 1.5 * usual)]:
        raise ValueError(
            f"line {rows[i + 1][0]}: Time goes from {stamps[i]:g} to "
            f"{stamps[i + 1]:g}; sort the frames, and split the file at gaps."
        )
    if whole:
        return stamps
    span, expected = stamps[-1] - stamps[0], len(steps) / header.rate
    if abs(span - expected) > RATE_TOLERANCE * expected + TIME_ROUNDING:
        name = "DataRate in line 3" if is_trc else "rate"
        raise ValueError(
            f"Time advances by {len(steps) / span:.4g} frames per second, but {name} "
            f"is {header.rate:g}; correct {name}."
        )
    return np.rint(stamps[0] * header.rate) + np.arange(len(stamps))


def _positions(rows: _Rows, header: _Header, names: list[str]) -> dict[str, Array]:
    """Return the coordinates of the markers; a blank or infinite one becomes NaN."""
    positions = {}
    for name in names:
        columns = [_floats(rows, i, header) for i in header.columns[name]]
        values = np.column_stack(columns)
        positions[name] = np.where(np.isfinite(values), values, np.nan)
    return positions


def _body(rows: _Rows, header: _Header) -> list[Array]:
    """Return all markers of the file in some of its frames, spread over it evenly."""
    some = rows[:: max(len(rows) // FRAMES_TO_MEASURE, 1)]
    body: list[Array] = []
    for name in header.columns:
        with suppress(ValueError):  # what is not read may be damaged
            body += _positions(some, header, [name]).values()
    return body


def _refuse_gaps(positions: dict[str, Array], lines: list[int]) -> None:
    """Refuse gaps, all of them at once; each frame is a line of the file."""
    gaps = []
    for name, values in positions.items():
        lost = np.flatnonzero(np.isnan(values).any(axis=1))
        if len(lost):
            first = lines[lost[0]]
            gaps.append(f"{name!r} in {len(lost)} frames, first in line {first}")
    if gaps:
        raise ValueError(
            f"of {len(lines)} frames, coordinates are missing for {'; '.join(gaps)}. "
            "Fill short gaps: pass gaps='nan', and the markers to "
            "kinematics.fill_gaps; or cut the file there, or leave these markers out."
        )


def _unit_of_file(claimed: str, body: list[Array]) -> str:
    """Return the unit that a file claims; refuse it if the body has another size."""
    name = claimed.lower().replace("metre", "meter")
    unit = SPELLED_OUT.get(name, name)
    if unit not in IN_MM:
        raise ValueError(
            f"the file gives {claimed!r} as its unit, not 'mm', 'cm' or 'm'; pass "
            "unit, which wins over the file."
        )
    cloud = np.stack(body)
    # Unlike max and min, these ignore NaN.
    extents = np.fmax.reduce(cloud) - np.fmin.reduce(cloud)
    sizes = np.fmax.reduce(extents, axis=1)
    sizes = sizes[sizes > 0]  # frames with several markers
    if not len(sizes):
        return unit
    size = float(np.median(sizes))
    is_usual = MIN_BODY_SIZE <= size * IN_MM[unit] <= MAX_BODY_SIZE
    likely = min(IN_MM, key=lambda u: abs(np.log(size * IN_MM[u] / USUAL_BODY_SIZE)))
    if not is_usual and likely != unit:
        raise ValueError(
            f"the markers of a frame are {size:.3g} apart, like {likely} instead of "
            f"{unit}; pass unit={likely!r}, or unit={unit!r} if the file is right."
        )
    return unit
