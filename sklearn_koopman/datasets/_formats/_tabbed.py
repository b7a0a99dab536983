"""The tab-separated format of Fukuchi et al. (2018)."""

import re

from ._recording import Format, Marker, Recording
from ._text import File, drop_end, number_lines, read_table, split

LABEL = re.compile(r"(.+?)[ ._]?([XYZ])")


def _is_tabbed(file: File) -> bool:
    return file.lines[0].lstrip().lower().startswith("time\t")


def _read(file: File) -> Recording:
    labels = drop_end(split(file.lines[0], "\t"))
    columns: dict[str, dict[str, list[int]]] = {}
    for column, label in enumerate(labels[1:], 1):
        parts = LABEL.fullmatch(label)
        if not parts:
            raise ValueError(
                f"line 1: column {label!r} is not the X, Y or Z of a marker; name it "
                "so, or remove the column."
            )
        name, axis = parts.groups()
        columns.setdefault(name, {x: [] for x in "XYZ"})[axis].append(column)
    markers = []
    for name, axes in columns.items():
        for axis, places in axes.items():
            if len(places) != 1:
                raise ValueError(
                    f"marker {name!r} has {len(places)} columns {name + axis!r}, not "
                    "one; export X, Y and Z of all markers, and give each its own name."
                )
        markers.append(Marker.from_label(name, [axes[x][0] for x in "XYZ"]))
    table = read_table(number_lines(file.lines, 1), labels, "\t")
    return Recording(table=table, markers=markers, unit="mm", stamps=0)


TABBED = Format("tab-separated", _is_tabbed, _read)
