"""OpenSim's TRC, also as other programs write it."""

from ._recording import Format, Marker, Recording, warn_of_count
from ._text import (
    SHOWN,
    File,
    drop_end,
    find_delimiter,
    find_row_delimiter,
    is_number,
    number_lines,
    read_table,
    split,
    to_rate,
)

N_HEADER_LINES = 4  # and one of axes, mostly
NUMBERS = ("DataRate", "NumFrames", "NumMarkers")


def _is_trc(file: File) -> bool:
    return file.suffix == ".trc" or file.first_line.startswith("PathFileType")


def _read(file: File) -> Recording:
    lines = file.lines
    if not file.first_line.startswith("PathFileType"):
        raise ValueError(
            f"line 1: found {lines[0][:SHOWN]!r}, expected the five lines of a TRC "
            "header, the first beginning with 'PathFileType'."
        )
    if len(lines) < N_HEADER_LINES:
        raise ValueError(
            f"line {len(lines)} is the last one, but a TRC header has five lines; copy "
            "or export the file again."
        )
    settings = _settings(lines)
    delimiter = find_delimiter(lines[3].strip())
    head = drop_end(split(lines[3].rstrip(), delimiter))
    if [label[:5].lower() for label in head[:2]] != ["frame", "time"]:
        raise ValueError(
            f"line 4: found {lines[3][:SHOWN]!r}, expected 'Frame#', 'Time' and the "
            "names of the markers, separated by tabs, commas or blanks."
        )
    axes = split(lines[4], delimiter) if len(lines) > N_HEADER_LINES else []
    has_axes = any(axes) and not any(map(is_number, filter(None, axes)))
    rows = number_lines(lines, N_HEADER_LINES + has_axes)
    if not has_axes:
        n_fields = max([2, *(_count_numbers(row, delimiter) for _, row in rows)])
        axes = ["", "", *("XYZ"[i % 3] for i in range(n_fields - 2))]
    markers, labels = _markers(head, axes)
    labels = [*head[:2], *labels]
    if rows:
        delimiter = find_row_delimiter(rows[0][1].strip(), delimiter, len(labels))
    table = read_table(rows, labels, delimiter)
    warn_of_count("NumFrames in line 3", settings.get("NumFrames"), [len(table)])
    n_markers = [len(markers), (len(labels) - 2) / 3]
    warn_of_count("NumMarkers in line 3", settings.get("NumMarkers"), n_markers)
    return Recording(
        table=table,
        markers=markers,
        rate=to_rate(settings.get("DataRate", "")),
        rate_name="DataRate in line 3",
        unit=settings.get("Units"),
        stamps=1,
        is_seconds=True,
    )


def _count_numbers(row: str, delimiter: str | None) -> int:
    """Return the number of fields of a row; none of a comment."""
    fields = drop_end(split(row, delimiter))
    return len(fields) if is_number(fields[0]) else 0


def _settings(lines: list[str]) -> dict[str, str]:
    """Return the values of line 3 by their names in line 2."""
    delimiter = find_delimiter(lines[1].strip())
    names, values = (drop_end(split(line, delimiter)) for line in lines[1:3])
    if len(values) != len(names):  # some programs write empty fields in between
        names, values = list(filter(None, names)), list(filter(None, values))
    settings = dict(zip(names, values, strict=False))
    for name in NUMBERS:
        if not is_number(settings.get(name, "")):
            raise ValueError(
                f"line 3: {name} is {settings[name]!r}, expected a number; write one "
                "value in line 3 for each name in line 2."
            )
    return settings


def _markers(head: list[str], axes: list[str]) -> tuple[list[Marker], list[str]]:
    """Return the markers, from their names and axes, and the labels of all columns."""
    places = [i for i, axis in enumerate(axes) if axis]
    names = [(i, name) for i, name in enumerate(head) if i > 1 and name]
    if len(places) == 3 * len(names):
        starts = list(range(0, len(places), 3))
    else:  # a column without a name stands where its marker has none
        # Names beyond the last column are of virtual markers, which are not exported.
        names = [(i, name) for i, name in names if i <= max(places, default=0)]
        starts = [places.index(i) if i in places else len(places) for i, _ in names]
    labels = [axes[place] for place in places]
    markers = []
    for start, (_, name) in zip(starts, names, strict=True):
        triple = [axis[:1].upper() for axis in labels[start : start + 3]]
        if start % 3 or sorted(triple) != ["X", "Y", "Z"]:
            raise ValueError(
                f"lines 4 and 5: there are {len(names)} names of markers and "
                f"{len(places)} columns, and {name!r} does not stand above an X, a Y "
                "and a Z; export the file again."
            )
        order = [start + triple.index(axis) for axis in "XYZ"]
        markers.append(Marker.from_label(name, [2 + i for i in order]))
        for i, axis in zip(order, "XYZ", strict=True):
            labels[i] = f"{name}{axis}"
    return markers, labels


TRC = Format("TRC", _is_trc, _read)
