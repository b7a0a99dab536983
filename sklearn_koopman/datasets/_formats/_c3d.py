"""C3D, by the library ezc3d."""

from typing import Any

import numpy as np

from ._recording import Format, Marker, Recording, split_prefix
from ._text import File, Table

# The second byte of every file; the first is the number of a block, mostly 2.
MAGIC = 0x50
MAX_BLOCK = 8
# Groups of names, in the section POINT, of what is stored like points, but is none.
NO_POINTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")


def _is_c3d(file: File) -> bool:
    begin = file.data[:2]
    has_magic = len(begin) == 2 and 1 <= begin[0] <= MAX_BLOCK and begin[1] == MAGIC
    return file.suffix == ".c3d" or has_magic


def _read(file: File) -> Recording:
    try:
        import ezc3d
    except ImportError as error:
        raise ImportError(
            f"{file.path}: C3D files are read by ezc3d; install it by "
            "pip install 'sklearn-koopman[c3d]'."
        ) from error
    try:
        content = ezc3d.c3d(str(file.path))
    except Exception as error:  # ezc3d raises many kinds
        raise ValueError(f"the file is no C3D, or is damaged: {error}") from error
    section = content["parameters"]["POINT"]
    no_points = {name for group in NO_POINTS for name in _texts(section, group)}
    positions = np.moveaxis(content["data"]["points"][:3], 0, 2)  # points, frames, axes
    residuals = content["data"]["meta_points"]["residuals"][0]
    positions = np.where(residuals[:, :, np.newaxis] < 0, np.nan, positions)
    n_frames = positions.shape[1]
    markers, labels = [], []
    for i, label in enumerate(_texts(section, "LABELS")):
        labels += [f"{label} {axis}" for axis in "XYZ"]
        if i < len(positions) and label and label not in no_points:
            individual, name = split_prefix(label)
            markers.append(Marker(name, range(3 * i, 3 * i + 3), individual))
    values = np.moveaxis(positions, 0, 1).reshape(n_frames, -1)
    header = content["header"]["points"]
    clock = header["first_frame"] + np.arange(n_frames)
    rate = float(header["frame_rate"])
    return Recording(
        table=Table(
            np.column_stack([values, clock]),
            [*labels, "Frame"],
            range(1, n_frames + 1),
            {},
            "frame",
        ),
        markers=markers,
        rate=rate if rate > 0 else None,
        rate_name="POINT:RATE",
        unit=next(iter(_texts(section, "UNITS")), None),
        stamps=values.shape[1],
        is_seconds=False,
    )


def _texts(section: Any, name: str) -> list[str]:
    """Return the texts of a parameter; none if it is not there."""
    values = section[name]["value"] if name in section else []
    return [str(value).strip() for value in values]


C3D = Format("C3D", _is_c3d, _read)
