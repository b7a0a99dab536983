"""Visual3D's text."""

from ._recording import Format, Marker, Recording
from ._text import File, drop_end, number_lines, read_table, split

N_HEADER_LINES = 5  # recordings, signals, types, folders, axes
ITEM = "ITEM"
POSITIONS = ("TARGET", "LANDMARK")


def _is_visual3d(file: File) -> bool:
    lines = file.lines
    return len(lines) >= N_HEADER_LINES and lines[4].strip().startswith(ITEM)


def _read(file: File) -> Recording:
    recordings, names, types, _, axes = (
        split(line, "\t") for line in file.lines[:N_HEADER_LINES]
    )
    axes = drop_end(axes)
    if len({*recordings[1 : len(axes)]}) > 1:
        raise ValueError(
            f"line 1: the file holds several recordings, {recordings[1]!r} and others; "
            "export each to its own file."
        )
    markers = []
    labels = [ITEM]
    for column in range(1, len(axes)):
        name = names[column] if column < len(names) else ""
        kind = types[column] if column < len(types) else ""
        labels.append(f"{name} {axes[column]}")
        is_position = name and kind.upper() in POSITIONS
        if is_position and axes[column : column + 3] == [*"XYZ"]:
            if len({*names[column : column + 3]}) > 1:
                raise ValueError(
                    f"line 2: an X, a Y and a Z have the names "
                    f"{names[column : column + 3]}, expected one name; export the file "
                    "again."
                )
            markers.append(Marker.from_label(name, range(column, column + 3)))
    if not markers:
        raise ValueError(
            f"line 3: the file holds {sorted({*types[1:]})}, not the X, Y and Z of a "
            "TARGET or LANDMARK; export the positions of markers."
        )
    table = read_table(number_lines(file.lines, N_HEADER_LINES), labels, "\t")
    return Recording(
        table=table, markers=markers, stamps=0, is_seconds=False, first_frame=1
    )


VISUAL3D = Format("Visual3D", _is_visual3d, _read)
