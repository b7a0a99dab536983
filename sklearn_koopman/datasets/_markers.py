"""Marker files: the tab-separated format of Fukuchi et al., and OpenSim's TRC."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sklearn.utils import Bunch

from .._utils._typing import Array
from .._utils._validation import check_choice, check_number

UNITS = ("mm", "cm", "m")
# Markers of a body that are all closer together than this, in mm, have another unit.
MIN_BODY_SIZE = 200.0
# Stamps in seconds may be rounded to milliseconds, and rates to 1 %.
TIME_ROUNDING = 0.001
RATE_TOLERANCE = 0.01


class _Header(NamedTuple):
    """The contents of the head of a marker file."""

    labels: list[str]  # of all columns
    columns: dict[str, list[int]]  # X, Y and Z column of each marker
    n_lines: int
    time_column: int
    rate: float | None = None
    unit: str | None = None
    n_frames: int | None = None


_Rows = list[tuple[int, list[str]]]  # number of a line, from 1, and its fields


def load_markers(
    path: str | os.PathLike[str],
    *,
    markers: Sequence[str] | None = None,
    rate: float = 150.0,
    unit: str | None = None,
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
        tab-separated file, where the size of the body is checked. A unit that is given
        for a tab-separated file is not checked.

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
        twice, or lacks a coordinate; if a marker that is read has gaps; if a line has
        too few or too many fields, or a field is not a number; if frames are missing
        or out of order; if the rate, the unit or the numbers of frames and markers
        contradict the file. The message names the file, the line or marker, and what
        to do.

    See Also
    --------
    load_trials : Reads arrays of several trials.
    make_walking : Synthetic markers.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.

    Notes
    -----
    The tab-separated format has one line of column names,
    ``Time  NAMEX  NAMEY  NAMEZ ...``, and one line a frame. `Time` holds either the
    number of the frame or seconds; seconds may be rounded to milliseconds, and must
    agree with `rate` within 1 %. Frame numbers are whole and advance by one.

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
    check_choice(unit, "unit", (None, *UNITS))
    where = os.fspath(path)
    lines = _read_lines(Path(path))
    is_trc = where.lower().endswith(".trc") or lines[0].startswith("PathFileType")
    header = _trc_header(lines, where) if is_trc else _tsv_header(lines, where)
    names = _select(markers, header.columns, where)
    if unit is not None and header.unit not in (None, unit):
        raise ValueError(
            f"{where}, line 3: the unit is {header.unit!r} but unit={unit!r}; leave "
            "unit out, or correct the header."
        )

    rows = _rows(lines, header, where)
    frames = _frame_numbers(rows, header, float(rate), where)
    positions = _positions(rows, header, names, where)
    if header.unit is None and unit is None:
        _check_millimetres(positions, where)
    frame_rate = float(rate) if header.rate is None else header.rate
    units = header.unit or unit or "mm"
    return Bunch(
        markers=positions,
        names=names,
        time=frames / frame_rate,
        rate=frame_rate,
        unit=units,
        filename=where,
        DESCR=f"{len(names)} markers in {len(frames)} frames at {frame_rate:g} Hz, "
        f"coordinates in {units}, read from {where}",
    )


def _read_lines(path: Path) -> list[str]:
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not a file; check the path and the name.")
    # Bytes that cannot be decoded matter only where a name or number is expected.
    lines = path.read_text(encoding="utf-8-sig", errors="replace").split("\n")
    if not any(line.strip() for line in lines):
        raise ValueError(f"{path} is empty; export the markers again.")
    return lines


def _tsv_header(lines: list[str], where: str) -> _Header:
    """Read the line of column names of a tab-separated file."""
    labels = _cells(lines[0])
    if labels[0].lower() != "time" or len(labels) == 1:
        raise ValueError(
            f"{where}, line 1: found {lines[0][:40]!r}, expected tab-separated column "
            "names 'Time', 'NAMEX', 'NAMEY', 'NAMEZ', ...; or a TRC file, which begins "
            "with 'PathFileType'."
        )
    for label in labels[1:]:
        if len(label) == 1 or label[-1:] not in ("X", "Y", "Z"):
            raise ValueError(
                f"{where}, line 1: column {label!r} is not the X, Y or Z of a marker; "
                "name it so, or remove the column."
            )
    return _Header(labels, _columns(labels, 1, f"{where}, line 1"), 1, 0)


def _trc_header(lines: list[str], where: str) -> _Header:
    """Read the five lines of the head of a TRC file."""
    if len(lines) < 5 or not lines[0].startswith("PathFileType"):
        raise ValueError(
            f"{where}, line 1: found {lines[0][:40]!r}, expected the five lines of a "
            "TRC header, the first beginning with 'PathFileType'."
        )
    meta = dict(zip(_cells(lines[1]), _cells(lines[2]), strict=False))
    rate = _header_number(meta, "DataRate", where)
    n_frames = _header_number(meta, "NumFrames", where)
    n_markers = _header_number(meta, "NumMarkers", where)
    if not 0 < rate < np.inf:
        raise ValueError(
            f"{where}, line 3: DataRate is {rate:g}; write the frames per second."
        )
    unit = meta.get("Units", "").lower()
    if unit not in UNITS:
        raise ValueError(
            f"{where}, line 3: Units is {meta.get('Units')!r}; convert the file to one "
            f"of {UNITS}."
        )
    head = _cells(lines[3])
    if [label[:5].lower() for label in head[:2]] != ["frame", "time"]:
        raise ValueError(
            f"{where}, line 4: found {lines[3][:40]!r}, expected 'Frame#', 'Time' and "
            "the names of the markers, separated by tabs."
        )
    names, axes = [label for label in head[2:] if label], _cells(lines[4])[2:]
    if len(names) != n_markers:
        raise ValueError(
            f"{where}, line 4: found {len(names)} markers, but NumMarkers in line 3 is "
            f"{n_markers:g}; the file is damaged, export it again."
        )
    if len(axes) != 3 * len(names):
        raise ValueError(
            f"{where}, line 5: found {len(axes)} columns, expected X, Y and Z of each "
            f"of the {len(names)} markers of line 4; export all three coordinates."
        )
    labels = [f"{names[i // 3]}{axis[:1].upper()}" for i, axis in enumerate(axes)]
    labels = [*head[:2], *labels]
    columns = _columns(labels, 2, f"{where}, lines 4 and 5")
    return _Header(labels, columns, 5, 1, rate, unit, int(n_frames))


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip().split("\t")]


def _columns(labels: list[str], first: int, where: str) -> dict[str, list[int]]:
    """Return the X, Y and Z column of each marker, from the labels of columns."""
    columns = {}
    for name in dict.fromkeys(label[:-1] for label in labels[first:]):
        triple = [f"{name}{axis}" for axis in "XYZ"]
        for label in triple:
            if label not in labels:
                raise ValueError(
                    f"{where}: marker {name!r} lacks the column {label}; export all "
                    "three coordinates."
                )
            if labels.count(label) > 1:
                raise ValueError(
                    f"{where}: marker {name!r} appears twice (column {label!r}); "
                    "rename or remove one."
                )
        columns[name] = [labels.index(label) for label in triple]
    return columns


def _header_number(meta: dict[str, str], key: str, where: str) -> float:
    try:
        return float(meta[key])
    except (KeyError, ValueError):
        raise ValueError(
            f"{where}, line 3: {key} is {meta.get(key)!r}, expected a number; lines 2 "
            "and 3 of a TRC file hold names and values separated by tabs."
        ) from None


def _select(
    markers: Sequence[str] | None, available: Iterable[str], where: str
) -> list[str]:
    """Return the names of the markers to read."""
    names = list(available)
    if markers is None:
        return names
    if isinstance(markers, str) or len(markers) == 0:
        raise ValueError(
            f"markers={markers!r}; pass a list of names, such as {names[:2]}, or None "
            "for all."
        )
    for marker in markers:
        if marker not in names:
            close = get_close_matches(str(marker), names, n=4, cutoff=0.5)
            hint = f"did you mean one of {close}? " * bool(close)
            raise ValueError(
                f"{where} has no marker {marker!r}; {hint}The file holds {names}."
            )
    return list(dict.fromkeys(markers))


def _rows(lines: list[str], header: _Header, where: str) -> _Rows:
    """Split the frames into fields, one for each column."""
    n_columns = len(header.labels)
    rows: _Rows = []
    for number, line in enumerate(lines[header.n_lines :], header.n_lines + 1):
        if not line.strip():
            continue
        fields = line.split("\t")
        if len(fields) < n_columns or any(f.strip() for f in fields[n_columns:]):
            raise ValueError(
                f"{where}, line {number}: found {len(fields)} fields separated by "
                f"tabs, expected {n_columns}; the line is damaged, export the file "
                "again."
            )
        rows.append((number, fields))
    if not rows:
        raise ValueError(
            f"{where} holds no frames after line {header.n_lines}; export it again."
        )
    if header.n_frames not in (None, len(rows)):
        raise ValueError(
            f"{where}, line {rows[-1][0]}: the file ends after {len(rows)} frames, "
            f"but NumFrames in line 3 is {header.n_frames}; it was cut or edited, "
            "export it again."
        )
    return rows


def _floats(rows: _Rows, column: int, header: _Header, where: str) -> Array:
    """Convert one column; blank fields become NaN."""
    values = np.empty(len(rows))
    for i, (line, fields) in enumerate(rows):
        text = fields[column].strip()
        try:
            values[i] = float(text) if text else np.nan
        except ValueError:
            raise ValueError(
                f"{where}, line {line}: {text!r} in column {header.labels[column]!r} "
                "is not a number; write numbers with a decimal point, and leave "
                "missing ones blank."
            ) from None
    return values


def _frame_numbers(rows: _Rows, header: _Header, rate: float, where: str) -> Array:
    """Return whole frame numbers from a column of frame numbers or of seconds."""
    stamps = _floats(rows, header.time_column, header, where)
    for i in np.flatnonzero(~np.isfinite(stamps)):
        raise ValueError(
            f"{where}, line {rows[i][0]}: Time is blank; write the frame number."
        )
    steps = np.diff(stamps)
    for i in np.flatnonzero(steps <= 0):
        raise ValueError(
            f"{where}, line {rows[i + 1][0]}: Time goes from {stamps[i]:g} to "
            f"{stamps[i + 1]:g}; sort the frames, and keep each trial in its own file."
        )
    whole = header.rate is None and bool((stamps == np.rint(stamps)).all())
    usual = 1.0 if whole or len(rows) == 1 else np.sort(steps)[(len(steps) - 1) // 2]
    for i in np.flatnonzero(steps > 1.5 * usual):
        raise ValueError(
            f"{where}, line {rows[i + 1][0]}: Time leaps from {stamps[i]:g} to "
            f"{stamps[i + 1]:g} where frames are {usual:g} apart; split the file where "
            "frames are missing, or restore them."
        )
    if whole:
        return stamps
    stated = rate if header.rate is None else header.rate
    span, expected = stamps[-1] - stamps[0], len(steps) / stated
    if abs(span - expected) > RATE_TOLERANCE * expected + TIME_ROUNDING:
        found = len(steps) / span
        remedy = f"DataRate in line 3 is {stated:g}; correct the header"
        if header.rate is None:
            remedy = f"rate={stated:g}; pass rate={found:.4g}"
        raise ValueError(
            f"{where}: Time advances by {found:.4g} frames per second, but {remedy}."
        )
    return np.rint(stamps[0] * stated) + np.arange(len(stamps))


def _positions(
    rows: _Rows, header: _Header, names: list[str], where: str
) -> dict[str, Array]:
    """Return the coordinates of the named markers, which must have no gaps."""
    positions: dict[str, Array] = {}
    gaps = []
    for name in names:
        columns = [_floats(rows, i, header, where) for i in header.columns[name]]
        positions[name] = np.column_stack(columns)
        lost = np.flatnonzero(~np.isfinite(positions[name]).all(axis=1))
        if len(lost):
            line = rows[lost[0]][0]
            gaps.append(f"{name!r} in {len(lost)} frames, first in line {line}")
    if gaps:
        raise ValueError(
            f"{where}: of {len(rows)} frames, coordinates are missing for "
            f"{'; '.join(gaps)}. Fill the gaps where the motion was tracked, cut the "
            "file there, or leave these markers out by markers=[...]."
        )
    return positions


def _check_millimetres(positions: dict[str, Array], where: str) -> None:
    """Refuse coordinates that are too small to be millimetres."""
    cloud = np.stack(list(positions.values()))
    extent = float(np.median(np.ptp(cloud, axis=0).max(axis=-1)))
    if len(cloud) > 1 and extent < MIN_BODY_SIZE:
        guess = "m" if extent < 3 else "cm"
        raise ValueError(
            f"{where}: the markers of a frame are only {extent:.3g} apart, which looks "
            f"like {guess} instead of mm; pass unit={guess!r}, or unit='mm' if they "
            "are that close."
        )
