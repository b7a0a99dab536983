"""Vicon's CSV, of Nexus and of the older Workstation."""

from collections.abc import Sequence

from ._recording import Format, Marker, Recording
from ._text import (
    SHOWN,
    File,
    Line,
    drop_end,
    find_delimiter,
    is_number,
    number_lines,
    read_table,
    split,
    to_rate,
)

SECTION = "trajectories"
OTHER_SECTIONS = ("devices", "joints", "model outputs", "segments", "events")
# What follows the name of the section: rate, names, axes; then units, mostly.
N_HEADER_LINES = 3
MAX_RATE_FIELDS = 2  # the rate, and its unit
CLOCKS = ("frame", "field")


def _name(line: str) -> str:
    """Return what a line holds but for the delimiters at its ends."""
    return line.strip(' \t,;"')


def _find_section(lines: Sequence[str]) -> int | None:
    """Return the place of the line that begins the positions of the markers."""
    return next((i for i, x in enumerate(lines) if _name(x).lower() == SECTION), None)


def _sections(lines: Sequence[str]) -> list[str]:
    """Return the names of the sections of a file."""
    return [
        name for name in map(_name, lines) if name.lower() in (SECTION, *OTHER_SECTIONS)
    ]


def _is_vicon(file: File) -> bool:
    return bool(_sections(file.lines[:1]))


def _read(file: File) -> Recording:
    place = _find_section(file.lines)
    if place is None or len(file.lines) <= place + N_HEADER_LINES:
        raise ValueError(
            f"the file holds {_sections(file.lines)}, but no section 'Trajectories'; "
            "export the trajectories of the markers, too."
        )
    rate_line, name_line, axis_line = file.lines[place + 1 : place + 4]
    delimiter = find_delimiter(axis_line)
    names, axes = split(name_line, delimiter), split(axis_line, delimiter)
    axes = drop_end(axes)
    if not axes or not axes[0].lower().startswith(CLOCKS):
        raise ValueError(
            f"line {place + 4}: found {axis_line[:SHOWN]!r}, expected 'Frame' and the "
            "X, Y and Z of each marker; export the file again."
        )
    columns = {
        i: name for i, name in enumerate(names) if name and axes[i : i + 3] == [*"XYZ"]
    }
    if not columns:
        raise ValueError(
            f"lines {place + 3} and {place + 4}: no name stands above an X, a Y and a "
            "Z; export the trajectories of the markers."
        )
    for i, name in enumerate(names):
        if name and i not in columns and axes[i : i + 1] in (["X"], ["Y"], ["Z"]):
            raise ValueError(
                f"lines {place + 3} and {place + 4}: {name!r} stands above "
                f"{axes[i : i + 3]}, not above an X, a Y and a Z; export the file "
                "again."
            )
    first = place + 1 + N_HEADER_LINES
    units = split(file.lines[first], delimiter) if len(file.lines) > first else []
    has_units = any(units) and not any(map(is_number, filter(None, units)))
    labels = list(axes)
    markers = []
    for column, name in columns.items():
        markers.append(Marker.from_label(name, range(column, column + 3)))
        labels[column : column + 3] = [f"{name} {axis}" for axis in "XYZ"]
    return Recording(
        table=read_table(_rows(file.lines, first + has_units), labels, delimiter),
        markers=markers,
        rate=to_rate(split(rate_line, delimiter)[0]),
        rate_name=f"the rate in line {place + 2}",
        unit=next(iter(units[min(columns) :]), None) if has_units else None,
        stamps=0,
        is_seconds=False,
        first_frame=1,
    )


def _rows(lines: Sequence[str], first: int) -> list[Line]:
    """Return the lines of frames; a blank line and the name of a section end them."""
    rows = number_lines(lines, first)
    ends = (i for i, (n, _) in enumerate(rows) if _begins_section(lines[n - 2 : n + 1]))
    return rows[: next(ends, len(rows))]


def _begins_section(lines: Sequence[str]) -> bool:
    """Whether a blank line is followed by the name of a section, and by its rate."""
    before, name, *after = lines
    if before.strip(" \t,;") or find_delimiter(_name(name)) or is_number(_name(name)):
        return False
    rate = drop_end(split(after[0], find_delimiter(after[0]))) if after else []
    has_rate = 1 <= len(rate) <= MAX_RATE_FIELDS and to_rate(rate[0]) is not None
    return has_rate or bool(_sections([name]))


VICON = Format("Vicon", _is_vicon, _read)
