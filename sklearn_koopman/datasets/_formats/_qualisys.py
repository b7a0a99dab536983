"""Qualisys Track Manager's TSV."""

from collections.abc import Sequence

from ._recording import Format, Marker, Recording, warn_of_count
from ._text import (
    File,
    Line,
    drop_end,
    is_number,
    number_lines,
    read_table,
    split,
    to_rate,
)

KEYS = ("NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "MARKER_NAMES")
CLOCKS = ("Frame", "Time")


def _is_qualisys(file: File) -> bool:
    return file.first_line.startswith(KEYS)


def _read(file: File) -> Recording:
    head, n_head = _head(file.lines)
    names = head.get("MARKER_NAMES", [])
    if not names:
        raise ValueError(
            "there are no names after MARKER_NAMES; export the 3D data of the markers, "
            "with their names in the header."
        )
    clocks = _clocks(head, len(names), file.lines[n_head:])
    labels = [*clocks, *(f"{name} {axis}" for name in names for axis in "XYZ")]
    rows = number_lines(file.lines, n_head) if clocks else _rows(file.lines, n_head)
    table = read_table(rows, labels, "\t")
    warn_of_count("NO_OF_FRAMES", head.get("NO_OF_FRAMES", [""])[0], [len(table)])
    markers = []
    for column, name in zip(range(len(clocks), len(labels), 3), names, strict=True):
        if name:
            markers.append(Marker.from_label(name, range(column, column + 3)))
    return Recording(
        table=table,
        markers=markers,
        rate=to_rate(head.get("FREQUENCY", [""])[0]),
        rate_name="FREQUENCY",
        unit="mm",
        stamps=len(clocks) - 1 if clocks else None,
        is_seconds="Time" in clocks,
        first_frame=1,
    )


def _head(lines: Sequence[str]) -> tuple[dict[str, list[str]], int]:
    """Return the values of the head by their keys, and the number of its lines."""
    head: dict[str, list[str]] = {}
    for number, line in enumerate(lines):
        key, *values = split(line, "\t")
        # Frames begin with a number, or with a blank or a word where it is missing.
        is_frame = line and (not key[:1].isalpha() or is_number(key))
        if "MARKER_NAMES" in head and is_frame:
            return head, number
        head[key] = drop_end(values) or [""]
    return head, len(lines)


def _clocks(
    head: dict[str, list[str]], n_markers: int, frames: Sequence[str]
) -> list[str]:
    """Return the names of the columns in front of the markers."""
    if CLOCKS[0] in head:
        return [*CLOCKS] if head[CLOCKS[0]][0] == CLOCKS[1] else [CLOCKS[0]]
    if CLOCKS[1] in head:
        return [CLOCKS[1]]
    n_fields = len(split(frames[0], "\t")) if frames else 0
    return [*CLOCKS] if n_fields == 3 * n_markers + len(CLOCKS) else []


def _rows(lines: Sequence[str], first: int) -> list[Line]:
    """Return the lines of frames; one in which all markers are lost is all tabs."""
    return [
        (number, line)
        for number, line in enumerate(lines[first:], first + 1)
        if line.strip(" ")
    ]


QUALISYS = Format("Qualisys", _is_qualisys, _read)
