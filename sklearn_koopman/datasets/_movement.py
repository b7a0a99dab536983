"""Markers from datasets of the package movement, by their attributes alone."""

import os
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from sklearn.utils import Bunch

from .._utils._typing import Array
from .._utils._validation import check_number
from ._formats._positions import Choices, check_choices, select_positions
from ._formats._recording import PIXELS, Marker, Recording
from ._formats._text import Table

AXES = "xyz"
ORDER = ("time", "individual", "keypoint", "space")
# Dimensions are in the plural before version 0.17.
SINGULAR = {"individuals": "individual", "keypoints": "keypoint"}
LOAD = "dataset = movement.io.load_dataset({path!r}, source_software='...', fps=...)"


def markers_from_movement(
    dataset: Any,
    *,
    markers: Sequence[str] | None = None,
    rate: float | None = None,
    unit: str | None = None,
    gaps: str = "raise",
    zeros: str = "gap",
    min_likelihood: float | None = None,
    individual: str | None = None,
) -> Bunch:
    """Take the positions of keypoints from a dataset of the package movement.

    Its ``movement.io.load_dataset`` opens the poses that DeepLabCut, SLEAP, Lightning
    Pose, Anipose and others write, and those in NWB files.

    Parameters
    ----------
    dataset : xarray.Dataset
        Poses, as ``load_dataset`` returns them: the variable `position` over time,
        space, keypoints and individuals, in any order, and `confidence` where there is
        one. Keypoints or individuals may be missing where one was selected. Only its
        attributes are used; xarray is not needed.
    markers : sequence of str, default=None
        Names of the keypoints to take, with or without the individual in front, as in
        ``"mouse:snout"``; None takes all. Only those that are taken are checked for
        gaps.
    rate : float, default=None
        Frames per second. None takes the attribute `fps` of the dataset, or its time
        where that is in seconds. It must agree with a time in seconds within 1 %.
    unit : {"mm", "cm", "m", "px"}, default=None
        Unit of the coordinates. None takes planar ones as pixels, "px". Those in space
        come from a calibration, which the dataset does not tell, and need it.
    gaps : {"raise", "nan"}, default="raise"
        Whether gaps in the keypoints that are taken are refused, or returned as NaN,
        for instance to fill them by :func:`~sklearn_koopman.kinematics.fill_gaps`.
    zeros : {"gap", "keep"}, default="gap"
        Whether a keypoint that stands at exactly 0, 0 is lost or is really there.
    min_likelihood : float, default=None
        The smallest confidence of a position that is kept; what is below is a gap. None
        keeps all but those below zero.
    individual : str, default=None
        The person or animal to take, where the dataset holds several.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes that :func:`load_markers` returns: `markers`, `names`,
        `time`, `rate`, `unit`, `likelihood` unless no confidence is known,
        `individuals` if they have names, `filename` (the attribute `source_file`, or
        an empty text) and `DESCR`.

    Raises
    ------
    TypeError
        If `dataset` is a path, a variable alone, or something else without a variable
        `position`.
    ValueError
        If the dataset holds bounding boxes, or `position` has other dimensions or other
        axes than x, y and z; if `fps` is no positive number; if neither the dataset nor
        the call tells the rate or the unit; and for the reasons of :func:`load_markers`
        that concern markers and time. Frames are counted from 0 in the message.

    Warns
    -----
    UserWarning
        If `rate` differs from `fps` by more than 1 %, and time is not in seconds.

    See Also
    --------
    load_markers : Reads files of markers, among them the CSV of DeepLabCut.
    sklearn_koopman.kinematics.fill_gaps : Fills short gaps.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.

    Examples
    --------
    With the package, ``dataset = movement.io.load_dataset("mouse.slp",
    source_software="SLEAP", fps=50)``. Here a stand-in has the same attributes:

    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from sklearn_koopman.datasets import markers_from_movement
    >>> position = SimpleNamespace(
    ...     dims=("time", "space", "keypoints"),
    ...     values=np.array([[[310.0, 270.5], [98.0, 97.5]], [[314, 274], [99, 98]]]),
    ...     coords={"space": ["x", "y"], "keypoints": ["snout", "tail"]},
    ... )
    >>> dataset = SimpleNamespace(position=position, attrs={"fps": 50.0})
    >>> mouse = markers_from_movement(dataset)
    >>> mouse.markers["tail"]
    array([[270.5,  97.5],
           [274. ,  98. ]])
    >>> mouse.time, mouse.unit
    (array([0.  , 0.02]), 'px')
    """
    choices = Choices(markers, rate, unit, gaps, zeros, min_likelihood, individual)
    check_choices(choices)
    _check_dataset(dataset)
    where = str(dataset.attrs.get("source_file") or "")
    try:
        return select_positions(_read(dataset), choices, where)
    except ValueError as error:
        raise ValueError(f"{where or 'dataset'}: {error}") from error


def _check_dataset(dataset: Any) -> None:
    """Refuse what is no dataset of poses."""
    if isinstance(dataset, str | os.PathLike):
        raise TypeError(
            f"dataset={dataset!r} is a path; open it by\n"
            f"    {LOAD.format(path=os.fspath(dataset))}\n"
            "with the package movement (pip install movement), and pass the dataset."
        )
    if not hasattr(getattr(dataset, "position", None), "dims"):
        is_variable = hasattr(dataset, "dims") and hasattr(dataset, "values")
        hint = ", not one of its variables" if is_variable else ""
        raise TypeError(
            f"dataset is a {type(dataset).__name__} without a variable 'position'; "
            f"pass the Dataset that load_dataset of movement returns{hint}."
        )
    if dataset.attrs.get("ds_type") == "bboxes" or hasattr(dataset, "shape"):
        raise ValueError(
            "the dataset holds bounding boxes, not poses; pass their centres, a row a "
            "frame, to trajectory_pairs."
        )


def _read(dataset: Any) -> Recording:
    """Lay out a dataset as a table, with a column for each coordinate."""
    coords = {
        SINGULAR.get(name, name): np.asarray(coord)
        for name, coord in dataset.position.coords.items()
    }
    position = _arrange(dataset.position, "position", ORDER)
    n_frames, n_individuals, n_keypoints, n_axes = position.shape
    if not n_frames:
        raise ValueError("position has no frames; pass a recording of several.")
    axes = _names(coords, "space") or [*AXES[:n_axes]]
    if sorted(axes) not in (["x", "y"], ["x", "y", "z"]):
        raise ValueError(
            f"position has the axes {axes}; pass positions along x and y, or x, y, z."
        )
    fields = [position[..., axes.index(axis)] for axis in sorted(axes)]
    confidence = getattr(dataset, "confidence", None)
    if confidence is not None and np.isfinite(confidence.values).any():
        likelihood = _arrange(confidence, "confidence", ORDER[:-1])
        fields.append(np.broadcast_to(likelihood, position.shape[:3]))
    values = np.stack(fields, axis=3).reshape(n_frames, -1)
    individuals = _names(coords, "individual") or _number("id", n_individuals)
    keypoints = _names(coords, "keypoint") or _number("keypoint", n_keypoints)
    if n_individuals == 1 and "individual" not in coords:
        individuals = [""]
    markers: list[Marker] = []
    for individual, name in product(individuals, keypoints):
        start = len(fields) * len(markers)
        end = start + n_axes
        likelihood_column = end if len(fields) > n_axes else None
        markers.append(Marker(name, range(start, end), individual, likelihood_column))
    has_time = "time" in coords
    if has_time:
        values = np.column_stack([values, _time(coords["time"])])
    fps, time_unit = dataset.attrs.get("fps"), dataset.attrs.get("time_unit")
    if fps is not None:
        check_number(fps, "the attribute fps", positive=True)
    n_columns = values.shape[1]
    return Recording(
        table=Table(values, ["time"] * n_columns, range(n_frames), {}, "frame"),
        markers=markers,
        rate=None if fps is None else float(fps),
        rate_name="fps",
        unit=PIXELS if n_axes == 2 else None,
        stamps=n_columns - 1 if has_time else None,
        is_seconds={"seconds": True, "frames": False}.get(time_unit),
    )


def _arrange(variable: Any, name: str, order: Sequence[str]) -> Array:
    """Return the values of a variable over some dimensions, in their order."""
    dims = [SINGULAR.get(dim, dim) for dim in variable.dims]
    for dim in dims:
        if dim not in order:
            raise ValueError(
                f"{name} has the dimensions {variable.dims}; select one of {dim!r}, as "
                f"by dataset.isel({dim}=0)."
            )
    if not {"time", "space"} & {*order} <= {*dims}:
        raise ValueError(
            f"{name} has the dimensions {variable.dims}; pass all of time and space."
        )
    values = np.asarray(variable.values, dtype=np.float64)
    sizes = dict(zip(dims, values.shape, strict=True))
    values = values.transpose([dims.index(dim) for dim in order if dim in dims])
    return values.reshape([sizes.get(dim, 1) for dim in order])


def _names(coords: dict[str, Any], dim: str) -> list[str]:
    """Return the names along a dimension, or of the one that was selected."""
    return [str(name) for name in np.atleast_1d(coords.get(dim, []))]


def _number(name: str, count: int) -> list[str]:
    """Return names as movement gives them to what has none."""
    return [f"{name}_{i}" for i in range(count)]


def _time(coord: Any) -> Array:
    """Return the stamps of the frames; refuse dates."""
    if coord.dtype.kind not in "iuf":
        raise ValueError(
            f"time is of the type {coord.dtype}; pass it in seconds, or in frames."
        )
    return np.asarray(coord, dtype=np.float64)
