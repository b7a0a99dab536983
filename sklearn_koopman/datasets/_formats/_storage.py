"""OpenSim's storage, .mot and .sto: one column for each coordinate."""

import re
from typing import NamedTuple

from ._recording import Recording, warn_of_count
from ._text import (
    SHOWN,
    File,
    find_delimiter,
    is_number,
    number_lines,
    read_table,
    split,
)

END_OF_HEAD = "endheader"
TIME = "time"
IN_DEGREES = "inDegrees"
ANSWERS = {"yes": "degrees", "no": "radians"}
# How the first line begins, without blanks, where OpenSim stored something else.
NO_ANGLES = (
    *("speeds", "velocities", "accelerations", "positions", "positionerrors"),
    *("staticoptimization", "inversedynamics", "jointreaction", "momentarm"),
    *("modelmarkererrors", "modelmarkerlocations", "fiber", "tendon"),
)


class Storage(NamedTuple):
    """The columns of a file, and the unit that it gives for angles."""

    recording: Recording  # without markers
    names: list[str]  # of all columns but the clock
    unit: str | None


def read_storage(file: File) -> Storage:
    """Read a file of coordinates; the recording holds its table and its clock."""
    heads = [line.strip().lower() for line in file.lines]
    if END_OF_HEAD not in heads:
        raise ValueError(
            f"line 1: found {file.lines[0][:SHOWN]!r}, and no line 'endheader'; "
            "load_angles reads OpenSim's .mot and .sto files. Markers are read by "
            "load_markers, and kinematics.leg_angles makes angles of them."
        )
    if "".join(heads[0].split()).startswith(NO_ANGLES):
        raise ValueError(
            f"line 1: the file holds {file.lines[0].strip()[:SHOWN]!r}, no angles; "
            "read its columns by numpy or pandas."
        )
    n_head = heads.index(END_OF_HEAD) + 1
    settings = _settings(file.lines[: n_head - 1])
    rows = number_lines(file.lines, n_head)
    if not rows:
        raise ValueError(f"nothing follows line {n_head}; export the file again.")
    number, line = rows[0]
    delimiter = find_delimiter(line.strip())
    labels = split(line.strip(), delimiter)
    if labels[0].lower() != TIME or len(labels) == 1 or any(map(is_number, labels)):
        raise ValueError(
            f"line {number}: found {line[:SHOWN]!r}, expected 'time' and the names of "
            "the coordinates; export the file again."
        )
    kind = settings.get("DataType", "double")
    if kind != "double":
        raise ValueError(
            f"the file holds values of the type {kind}, not angles; read its columns "
            "by numpy, and pass rotations to kinematics.RotationEncoder."
        )
    # Fields may be separated by blanks under names that are separated by tabs.
    delimiter = "\t" if any("\t" in text.strip() for _, text in rows[1:]) else None
    table = read_table(rows[1:], labels, delimiter)
    warn_of_count("nRows", settings.get("nRows"), [len(table)])
    return Storage(
        recording=Recording(table=table, markers=[], stamps=0, is_seconds=True),
        names=labels[1:],
        unit=ANSWERS.get(settings.get(IN_DEGREES, "").lower()),
    )


def _settings(lines: list[str]) -> dict[str, str]:
    """Return the values of the head by their names; ``=`` or blanks part them."""
    pairs = (re.split(r"\s*=\s*|\s+", line.strip(), maxsplit=1) for line in lines)
    return {pair[0]: pair[1] for pair in pairs if len(pair) == 2}
