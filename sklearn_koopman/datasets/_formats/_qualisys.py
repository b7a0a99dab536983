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

NAMES = "MARKER_NAMES"
# One of these is among the first lines.
KEYS = ("NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", NAMES)
N_LINES_TO_LOOK_AT = 5
CLOCKS = ("Frame", "Time")


def _is_qualisys(file: File) -> bool:
    first = file.lines[:N_LINES_TO_LOOK_AT]
    return any(line.lstrip().startswith(KEYS) for line in first)


def _read(file: File) -> Recording:
    head, columns, n_head = _head(file.lines)
    names = head.get(NAMES, [""])
    if not any(names):
        raise ValueError(
            f"there are no names after {NAMES}; export the 3D data of the markers, "
            "with their names in the header."
        )
    labels = _labels(names, columns, file.lines[n_head:])
    clocks = [label for label in CLOCKS if label in labels]
    rows = number_lines(file.lines, n_head) if clocks else _rows(file.lines, n_head)
    markers = _markers(names, labels)
    table = read_table(rows, labels, "\t")
    warn_of_count("NO_OF_FRAMES", head.get("NO_OF_FRAMES", [""])[0], [len(table)])
    warn_of_count("NO_OF_MARKERS", head.get("NO_OF_MARKERS", [""])[0], [len(names)])
    return Recording(
        table=table,
        markers=markers,
        rate=to_rate(head.get("FREQUENCY", [""])[0]),
        rate_name="FREQUENCY",
        unit="mm",
        stamps=labels.index(clocks[-1]) if clocks else None,
        is_seconds="Time" in clocks,
        first_frame=1,
    )


def _head(lines: Sequence[str]) -> tuple[dict[str, list[str]], list[str], int]:
    """Return the values of the head by their keys, the names of columns that end it.

    The last is the number of its lines. There may be no names of columns.
    """
    head: dict[str, list[str]] = {}
    columns: list[str] = []
    for number, line in enumerate(lines):
        fields = split(line, "\t")
        key, *values = fields
        # Frames begin with a number, or with a blank or a word where it is missing.
        is_frame = line and (not key[:1].isalpha() or is_number(key))
        axes = {f"{name} {axis}" for name in head.get(NAMES, []) for axis in "XYZ"}
        if key in CLOCKS or axes & {*fields}:
            columns = drop_end(fields)
        elif NAMES in head and is_frame:
            return head, columns, number
        else:
            head[key] = drop_end(values) or [""]
    return head, columns, len(lines)


def _labels(
    names: Sequence[str], columns: Sequence[str], frames: Sequence[str]
) -> list[str]:
    """Return the names of all columns; some files have none, or those of the clock."""
    if {*columns} - {*CLOCKS}:
        return [*columns]
    axes = [f"{name} {axis}" for name in names for axis in "XYZ"]
    n_fields = len(split(frames[0], "\t")) if frames else 0
    has_clocks = not columns and n_fields == len(CLOCKS) + len(axes)
    return [*(CLOCKS if has_clocks else columns), *axes]


def _markers(names: Sequence[str], labels: Sequence[str]) -> list[Marker]:
    """Return the markers that have names, with the places of their columns."""
    places = {label: i for i, label in enumerate(labels)}
    markers = []
    for name in filter(None, names):
        axes = [f"{name} {axis}" for axis in "XYZ"]
        for label in axes:
            if labels.count(label) != 1:
                raise ValueError(
                    f"{labels.count(label)} columns are called {label!r}, not one; "
                    f"export X, Y and Z of each marker after {NAMES}, and give each "
                    "its own name."
                )
        markers.append(Marker.from_label(name, [places[label] for label in axes]))
    return markers


def _rows(lines: Sequence[str], first: int) -> list[Line]:
    """Return the lines of frames; one in which all markers are lost is all tabs."""
    return [
        (number, line)
        for number, line in enumerate(lines[first:], first + 1)
        if line.strip(" ")
    ]


QUALISYS = Format("Qualisys", _is_qualisys, _read)
