"""The tab-separated format of Fukuchi et al. (2018)."""

from ._recording import Format, Marker, Recording
from ._text import File, drop_end, number_lines, read_table, split


def _is_tabbed(file: File) -> bool:
    return file.lines[0].lstrip().lower().startswith("time\t")


def _read(file: File) -> Recording:
    labels = drop_end(split(file.lines[0], "\t"))
    for label in labels[1:]:
        if len(label) == 1 or label[-1:] not in ("X", "Y", "Z"):
            raise ValueError(
                f"line 1: column {label!r} is not the X, Y or Z of a marker; name it "
                "so, or remove the column."
            )
    markers = []
    for name in dict.fromkeys(label[:-1] for label in labels[1:]):
        triple = [f"{name}{axis}" for axis in "XYZ"]
        for label in triple:
            if labels.count(label) != 1:
                raise ValueError(
                    f"marker {name!r} has {labels.count(label)} columns {label!r}, not "
                    "one; export X, Y and Z of all markers, and give each its own name."
                )
        markers.append(Marker.from_label(name, [labels.index(x) for x in triple]))
    table = read_table(number_lines(file.lines, 1), labels, "\t")
    return Recording(table=table, markers=markers, unit="mm", stamps=0)


TABBED = Format("tab-separated", _is_tabbed, _read)
