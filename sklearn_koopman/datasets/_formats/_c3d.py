"""C3D, by the library ezc3d."""

from typing import Any

import numpy as np

from ._c3d_layout import MAGIC, count_frames
from ._recording import Format, Marker, Recording
from ._text import File, Table

MAX_BLOCK = 8  # in which the parameters begin; mostly 2
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
            f"{file.path}: C3D files are read by ezc3d; install it by pip install "
            "ezc3d, or with this package by pip install 'sklearn-koopman[c3d]'."
        ) from error
    n_frames = count_frames(file.data)
    try:
        content = ezc3d.c3d(str(file.path))
    except Exception as error:  # ezc3d raises many kinds
        raise ValueError(
            f"the file is no C3D, or is damaged: {error}; export it again."
        ) from error
    section = content["parameters"]["POINT"]
    # ezc3d returns NaN where the residual of a point is below 0.
    # It reads the zeros that fill the last block as frames if there are 65,535.
    points = content["data"]["points"][:3, :, :n_frames]
    positions = np.moveaxis(points, 0, 2)  # points, frames, axes
    n_points, n_frames = positions.shape[:2]
    if n_points and not n_frames:
        raise ValueError("the file has a head, but no frames; export it again.")
    no_points = {name for group in NO_POINTS for name in _texts(section, group)}
    markers, labels = [], []
    for i, label in enumerate(_texts(section, "LABELS")[:n_points]):
        labels += [f"{label} {axis}" for axis in "XYZ"]
        if label and label not in no_points:
            markers.append(Marker.from_label(label, range(3 * i, 3 * i + 3)))
    header = content["header"]["points"]
    frames = header["first_frame"] + np.arange(n_frames)  # from 0
    rate = float(header["frame_rate"])
    return Recording(
        table=Table(
            np.column_stack([*positions, frames]),
            [*labels, "Frame"],
            frames + 1,
            {},
            "frame",
        ),
        markers=markers,
        rate=rate if 0 < rate < np.inf else None,
        rate_name="POINT:RATE",
        unit=next(iter(_texts(section, "UNITS")), None) or None,
        stamps=3 * n_points,
        is_seconds=False,
    )


def _texts(section: Any, name: str) -> list[str]:
    """Return the texts of a parameter, which has a second part beyond 255 of them."""
    texts: list[str] = []
    for part in (name, *(f"{name}{i}" for i in range(2, len(section)))):
        if part not in section:
            break
        texts += [str(value).strip() for value in section[part]["value"]]
    return texts


C3D = Format("C3D", _is_c3d, _read)
