"""DeepLabCut's CSV, which Lightning Pose writes, too."""

from collections.abc import Sequence

from ._recording import PIXELS, Format, Marker, Recording
from ._text import File, find_delimiter, number_lines, read_table, split

AXES = ("x", "y", "z")
HEAD = ("scorer", "individuals", "bodyparts", "coords")


def _is_deeplabcut(file: File) -> bool:
    return file.first_line.lstrip('"').startswith("scorer") and len(file.lines) > 2


def _read(file: File) -> Recording:
    delimiter = find_delimiter(file.lines[0])
    head: dict[str, list[str]] = {}
    for line in file.lines:
        key, *fields = split(line, delimiter)
        if key not in HEAD or key in head:
            break
        head[key] = fields
    names, coordinates = head.get("bodyparts"), head.get("coords")
    n_columns = len(coordinates or ())
    individuals = head.get("individuals", [""] * n_columns)
    if not names or not coordinates or not n_columns == len(names) == len(individuals):
        raise ValueError(
            "lines 1 to 4: expected the rows 'scorer', 'individuals' (where there are "
            "several), 'bodyparts' and 'coords', of the same length."
        )
    rows = number_lines(file.lines, len(head))
    for number, line in rows[:1]:
        if not split(line, delimiter)[0].isdigit():
            raise ValueError(
                f"line {number}: found {split(line, delimiter)[0]!r}, expected the "
                "number of a frame; labels of single pictures are no recording."
            )
    labels = ["frame", *(f"{n} {c}" for n, c in zip(names, coordinates, strict=True))]
    parts: dict[tuple[str, str], list[int]] = {}
    for place, part in enumerate(zip(individuals, names, strict=True)):
        parts.setdefault(part, []).append(place)
    markers = []
    for (individual, name), places in parts.items():
        axes = [coordinates[i] for i in places]
        if {"x", "y"} & {*axes}:  # Lightning Pose marks sets of frames, too
            markers.append(_marker(individual, name, axes, places))
    table = read_table(rows, labels, delimiter)
    is_planar = all(len(marker.columns) == 2 for marker in markers)
    return Recording(
        table=table,
        markers=markers,
        unit=PIXELS if is_planar else None,
        stamps=0,
        is_seconds=False,
    )


def _marker(
    individual: str, name: str, axes: Sequence[str], places: Sequence[int]
) -> Marker:
    """Return a marker from its axes, and the places where they stand."""
    columns = {axis: 1 + place for axis, place in zip(axes, places, strict=True)}
    if not {"x", "y"} <= {*axes} or len(columns) < len(axes):
        raise ValueError(
            f"body part {name!r} has the columns {axes}, expected x and y, each "
            "export the file again."
        )
    coordinates = [columns[axis] for axis in AXES if axis in columns]
    return Marker(name, coordinates, individual, columns.get("likelihood"))


DEEPLABCUT = Format("DeepLabCut", _is_deeplabcut, _read)
