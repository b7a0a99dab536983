"""From marker positions to gap-free recordings, joint angles and body-frame outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from ._utils._clocks import HOLE, count_recordings, find_index, find_steps, read_labels
from ._utils._typing import Array, Indices, Mask
from ._utils._validation import check_integer, check_number
from ._utils._warnings import warn
from ._utils._wraps import find_wraps, warn_of_wraps

__all__ = ["fill_gaps", "leg_angles", "unwrap_angles"]

# No knee bends farther for long; with two markers swapped, a leg that is bent by less
# than a right angle seems to.
MAX_KNEE_FLEXION = 135.0
# An ankle above the hip by more than this part of the leg is upside down: one that
# lies, even on a cushion, is not, and one that cycles or runs is most of the time.
MIN_HEADSTAND = 0.5


def fill_gaps(recording: Any, *, max_gap: int) -> tuple[Any, Indices]:
    r"""Interpolate the short gaps of a recording by cubic splines.

    A gap is a run of frames in which a column holds NaN or is masked. Each column is
    filled on its own.

    Parameters
    ----------
    recording : array-like, DataFrame, Series or dict
        One recording of evenly spaced frames, in any unit, of shape (n_frames,),
        (n_frames, n_columns) or (n_frames, n_markers, 2 or 3); or the positions of
        several markers by name, as :func:`~sklearn_koopman.datasets.load_markers`
        returns them. It is not changed. A frame that was dropped is no gap yet: it
        needs a row of NaN.
    max_gap : int
        The largest number of frames of a gap that is filled, at least 1. Longer gaps
        are left, and so are those at the start and the end, whatever their length.

    Returns
    -------
    filled : ndarray, DataFrame, Series or dict of str to ndarray
        The recording as floats, in its shape and unit; NaN where it has not been
        filled. A DataFrame keeps its index and columns, a masked array becomes a plain
        one.
    frames : ndarray of int of shape (n_filled,)
        The frames, from 0 and in rising order, in which at least one value was filled.

    Raises
    ------
    ValueError
        If the recording is empty or has another shape, as a list of several
        recordings has; if it holds infinity or what is no number; if the index of a
        DataFrame jumps, repeats or lacks labels; if the markers of a dict differ in
        their number of frames; if `max_gap` is no positive integer.

    Warns
    -----
    UserWarning
        If a column that is filled holds angles that wrap at 360 degrees or 2 pi, since
        a spline across a wrap passes through all angles in between: unwrap them first,
        by :func:`unwrap_angles`.

    See Also
    --------
    leg_angles : Joint angles from markers without gaps.
    unwrap_angles : Angles without jumps, also across gaps.
    sklearn_koopman.datasets.load_markers : Reads markers, with ``gaps="nan"`` those
        that have gaps.

    Notes
    -----
    A column is cut at the gaps that are not filled. Through the samples of each piece
    goes one interpolating cubic spline with not-a-knot ends, so that what lies beyond
    a long gap has no influence. Polynomials up to degree three are returned exactly.
    Through three samples goes a parabola, through two a line.

    In a gap of g frames, a sinusoid of amplitude 1 and period P frames is missed by at
    most :math:`20.3\, ((g + 1) / P)^4` away from the ends of a piece; that is 5/384 of
    the fourth power of the step times the fourth derivative [1]_. Fill gaps up to a
    tenth of the shortest period that matters: that costs 0.2 %. Independent noise of
    the samples becomes up to about :math:`1 + 0.35\, g` times as large in the gap, but
    :math:`2 + 0.35\, g^2` times where only one sample of the piece lies on one side.

    The cost is linear in the number of values.

    References
    ----------
    .. [1] C. A. Hall and W. W. Meyer, "Optimal error bounds for cubic spline
       interpolation", Journal of Approximation Theory 16, 1976.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.kinematics import fill_gaps
    >>> height = np.arange(10.0) ** 2
    >>> height[[0, 3, 6, 7]] = np.nan
    >>> filled, frames = fill_gaps(height, max_gap=1)
    >>> filled
    array([nan,  1.,  4.,  9., 16., 25., nan, nan, 64., 81.])
    >>> frames
    array([3])
    """
    check_integer(max_gap, "max_gap", 1)
    if isinstance(recording, Mapping):
        pieces = {k: fill_gaps(x, max_gap=max_gap) for k, x in recording.items()}
        lengths = {name: len(filled) for name, (filled, _) in pieces.items()}
        if len({*lengths.values()}) != 1:
            raise ValueError(
                f"recording holds markers of {lengths} frames; pass at least one "
                "marker, and only those of one recording."
            )
        frames = np.unique(np.concatenate([rows for _, rows in pieces.values()]))
        return {name: filled for name, (filled, _) in pieces.items()}, frames
    values = np.array(_as_floats(recording, "recording"), order="C")
    _check_recording(recording, values)
    columns = values.reshape(len(values), -1)  # a view
    was_lost = np.isnan(columns)
    for column in np.flatnonzero(was_lost.any(axis=0)):
        _fill_column(columns[:, column], max_gap)
    is_filled = was_lost & ~np.isnan(columns)
    _warn_of_wraps(recording, columns, was_lost, is_filled)
    return _like(recording, values), np.flatnonzero(is_filled.any(axis=1))


def leg_angles(
    hip: ArrayLike,
    knee: ArrayLike,
    ankle: ArrayLike,
    *,
    forward: ArrayLike,
    up: ArrayLike,
    normalize: bool = False,
) -> tuple[Array, Array]:
    r"""Hip and knee flexion of one leg, and its ankle relative to the hip.

    The markers are projected onto the sagittal plane spanned by `forward` and `up`.
    The two angles are the states of the walking example of [1]_ and the ankle is its
    output.

    Parameters
    ----------
    hip : array-like of shape (n_frames, 3)
        Positions of the hip marker, such as the greater trochanter.
    knee : array-like of shape (n_frames, 3)
        Positions of the knee marker, in the same frames, axes and unit.
    ankle : array-like of shape (n_frames, 3)
        Positions of the ankle marker, in the same frames, axes and unit.
    forward : int or array-like of shape (3,)
        Direction of walking: the number of a column (0, 1 or 2), or a vector of any
        length, for instance ``[-1, 0, 0]`` for somebody who walks against the first
        axis.
    up : int or array-like of shape (3,)
        The vertical, given in the same way; orthogonal to `forward` within 1e-6.
    normalize : bool, default=False
        Whether the ankle is divided by the length of this leg: the mean over all
        frames of the three-dimensional lengths of thigh and shank, added. It makes
        the outputs of one person comparable with those of another.

    Returns
    -------
    angles : ndarray of shape (n_frames, 2)
        Hip flexion and knee flexion in radians, both in (-pi, pi].

        * Hip flexion is the angle of the thigh against the downward vertical:
          positive with the knee in front of the hip.
        * Knee flexion is the angle of the thigh less the angle of the shank: 0 for a
          straight leg, positive with the heel drawn towards the buttock.
    ankle : ndarray of shape (n_frames, 2)
        Ankle minus hip along `forward` and `up`, in the unit of the markers, or as a
        fraction of the length of the leg if `normalize` is set.

    Raises
    ------
    ValueError
        If the markers differ in shape or are not of shape (n_frames, 3); if one holds
        NaN or infinity, or is masked; if a segment has no length in the sagittal
        plane; if thigh and shank differ more than tenfold in length, as they do when
        units are mixed; if `forward` or `up` is no direction, or they are not
        orthogonal.

    Warns
    -----
    UserWarning
        If in more than half of the frames the leg stands on its head: its ankle is
        above its hip by more than half of the length of the leg, as with `up` pointing
        down, or hip and ankle swapped. If in more than half of the frames the knee is
        bent by more than 135 degrees, either way, as with any other two markers
        swapped. A leg that lies on a bench does not warn, so that a horizontal `up` is
        not found out.

    See Also
    --------
    fill_gaps : Fills short gaps in the markers.
    sklearn_koopman.datasets.load_markers : Reads markers from a file.
    sklearn_koopman.trajectories.trajectory_pairs : Pairs angles and ankle positions.

    Notes
    -----
    Let :math:`v^{(1)}` and :math:`v^{(2)}` be the projected vectors from hip to knee
    and from knee to ankle, with components :math:`(v_f, v_u)`. Then

    .. math::
        \theta^{(1)} &= \operatorname{atan2}(v^{(1)}_f, -v^{(1)}_u), \\
        \theta^{(2)} &= \operatorname{atan2}(v^{(1)}_u v^{(2)}_f
                        - v^{(1)}_f v^{(2)}_u,\; v^{(1)} \cdot v^{(2)}).

    [1]_ (Section 4.2) takes the knee angle from the dot product alone, which loses
    the sign of an overstretched knee and most digits near a straight one. With the
    projected lengths :math:`\ell_i = \|v^{(i)}\|` the planar forward kinematics

    .. math::
        y_f &= \ell_1 \sin\theta^{(1)} + \ell_2 \sin(\theta^{(1)} - \theta^{(2)}), \\
        y_u &= -\ell_1 \cos\theta^{(1)} - \ell_2 \cos(\theta^{(1)} - \theta^{(2)})

    return the ankle exactly. The projected lengths change from frame to frame as the
    leg leaves the plane and the skin moves, so that for real markers the map from the
    angles to the ankle has to be estimated.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    .. [2] C. A. Fukuchi, R. K. Fukuchi and M. Duarte, "A public dataset of overground
       and treadmill walking kinematics and kinetics in healthy individuals", PeerJ 6,
       e4640, 2018.

    Examples
    --------
    A leg with the thigh 30 degrees forward and the shank hanging down:

    >>> import numpy as np
    >>> from sklearn_koopman.kinematics import leg_angles
    >>> hip, knee, ankle = [[0, 900, 0]], [[200, 553.6, 0]], [[200, 153.6, 0]]
    >>> angles, ankle = leg_angles(hip, knee, ankle, forward=0, up=1)
    >>> np.degrees(angles).round(2)
    array([[30., 30.]])
    >>> ankle
    array([[ 200. , -746.4]])
    """
    positions = _check_markers(hip=hip, knee=knee, ankle=ankle)
    axes = np.column_stack([_direction(forward, "forward"), _direction(up, "up")])
    if abs(axes[:, 0] @ axes[:, 1]) > 1e-6:
        raise ValueError(
            f"forward={forward!r} and up={up!r} are not orthogonal; subtract from one "
            "its part along the other, or use two different columns."
        )
    segments = np.diff(positions, axis=0)
    planar = segments @ axes
    lengths = _check_segments(segments, planar)
    # In a complex plane whose real axis points straight down.
    thigh, shank = -planar[..., 1] + 1j * planar[..., 0]
    # The sum turns -0.0 into 0.0: a shank folded onto the thigh is at pi, not -pi.
    bend = thigh * shank.conj() + 0.0
    angles = np.column_stack([np.angle(thigh), np.angle(bend)])
    reach = (positions[2] - positions[0]) @ axes
    _warn_of_headstand(angles, reach / lengths.sum(), up)
    return angles, reach / lengths.sum() if normalize else reach


def unwrap_angles(angles: Any, *, period: float) -> Any:
    """Remove the jumps of angles that wrap, also across gaps.

    An angle that passes the end of the circle jumps by a full turn, which is no motion.
    From each jump on, this adds the turns that undo it.

    Parameters
    ----------
    angles : array-like, DataFrame or Series
        One recording, of shape (n_frames,), (n_frames, n_columns) or (n_frames,
        n_joints, 2 or 3). It is not changed.
    period : float
        The full turn in the unit of the angles: 360 for degrees, ``2 * np.pi`` for
        radians.

    Returns
    -------
    unwrapped : ndarray, DataFrame or Series
        The angles as floats, in their shape and unit; NaN where they are NaN or masked.
        A DataFrame keeps its index and columns, a masked array becomes a plain one.

    Raises
    ------
    ValueError
        If `angles` is empty or has another shape, as a list of several recordings has;
        if it holds infinity or what is no number; if the index of a DataFrame jumps; if
        `period` is no positive number.

    See Also
    --------
    fill_gaps : Fills gaps; angles that wrap have to be unwrapped before.
    numpy.unwrap : The same without gaps; it loses all that follows a NaN.

    Notes
    -----
    Each valid frame comes to lie within half a turn of the last valid one before it. So
    during a gap, as from frame to frame, an angle must not move by more than half a
    turn: else it is off by full turns from there on. So is what follows a glitch; set
    glitches to NaN before.

    Columns that do not wrap are returned exactly. The cost is linear in the number of
    values.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.kinematics import fill_gaps, unwrap_angles
    >>> heading = [340.0, 350.0, np.nan, 10.0, 20.0]
    >>> unwrapped = unwrap_angles(heading, period=360)
    >>> unwrapped
    array([340., 350.,  nan, 370., 380.])
    >>> fill_gaps(unwrapped, max_gap=1)[0]
    array([340., 350., 360., 370., 380.])
    """
    check_number(period, "period", positive=True)
    values = np.array(_as_floats(angles, "angles"), order="C")
    _check_recording(angles, values, "angles")
    columns = values.reshape(len(values), -1)  # a view
    for column in columns.T:
        is_valid = ~np.isnan(column)
        column[is_valid] = np.unwrap(column[is_valid], period=period)
    return _like(angles, values)


def _check_recording(recording: Any, values: Array, name: str = "recording") -> None:
    """Refuse infinity, and data whose rows are not the frames of one recording."""
    is_list = isinstance(recording, list | tuple)
    is_cloud = values.ndim == 3 and values.shape[2] in (2, 3) and not is_list
    if not values.size or not (values.ndim in (1, 2) or is_cloud):
        raise ValueError(
            f"{name} is a {type(recording).__name__} of shape {values.shape}; pass "
            "one recording, an array of shape (n_frames, n_columns) or (n_frames, "
            "n_markers, 3), and several one by one."
        )
    lost = np.flatnonzero(np.isinf(values).reshape(len(values), -1).any(axis=1))
    if len(lost):
        raise ValueError(
            f"{name} holds infinity in {len(lost)} of {len(values)} frames, first "
            f"in frame {lost[0]}; replace it by NaN if it marks a gap."
        )
    index = find_index(recording)
    labels = None if index is None else read_labels(index, name)
    if index is not None and count_recordings(index) > 1:
        raise ValueError(
            f"the index of {name} holds {count_recordings(index)} recordings; pass "
            "them one by one, or drop an index that means nothing by "
            "reset_index(drop=True)."
        )
    if labels is None or len(labels) < 2:
        return
    is_jump, usual = np.diff(labels) <= 0, 1.0
    if not is_jump.any():
        remedy = "interpolate it onto a regular grid"
        steps, usual = find_steps(labels, name, remedy)
        is_jump = steps > HOLE
    for row in np.flatnonzero(is_jump)[:1]:
        clock = index.get_level_values(-1).infer_objects()
        before, after = clock[[row, row + 1]]
        times, near = "times", "a quarter of the step"
        kind, n_steps = clock.dtype.kind, round((labels[-1] - labels[0]) / usual)
        if kind in "iu":
            times, near = f"range({labels[0]}, {labels[-1] + 1}, {usual:.0f})", "0"
        elif kind == "f":
            ends = f"{labels[0]:.12g}, {labels[-1]:.12g}"
            times, near = f"np.linspace({ends}, {n_steps + 1})", f"{usual / 4:.3g}"
        raise ValueError(
            f"the index of {name} goes from {before} to {after}, which is not the "
            "usual step; pass one recording, with a row of NaN for each missing frame, "
            f"by {name}.reindex({times}, method='nearest', tolerance={near})."
        )


def _like(recording: Any, values: Array) -> Any:
    """Return values with the index and the columns of a recording that has them."""
    if not hasattr(recording, "iloc"):
        return values
    frame = recording.astype(np.float64)
    frame[:] = values
    return frame


def _warn_of_wraps(
    recording: Any, columns: Array, was_lost: Mask, is_filled: Mask
) -> None:
    """Warn of angles that wrap among the columns that have been filled."""
    names = list(getattr(recording, "columns", range(columns.shape[1])))
    turns = {}
    for number in np.flatnonzero(is_filled.any(axis=0)):
        is_link = ~(was_lost[1:, number] | was_lost[:-1, number])
        column = columns[:, [number]]
        for turn in find_wraps(column[:-1][is_link], column[1:][is_link]).values():
            turns[str(names[number])] = turn
    warn_of_wraps({"recording": turns})


def _fill_column(column: Array, max_gap: int) -> None:
    """Fill the short gaps of a column in place."""
    valid = np.flatnonzero(~np.isnan(column))
    cuts = np.flatnonzero(np.diff(valid) > max_gap + 1) + 1
    for known in np.split(valid, cuts):
        if len(known) > 1:
            piece = np.arange(known[0], known[-1])
            lost = piece[np.isnan(column[piece])]
            if len(lost):
                column[lost] = CubicSpline(known, column[known])(lost)


def _check_markers(**markers: Any) -> Array:
    """Validate markers into a finite array of shape (n_markers, n_frames, 3)."""
    positions = {name: _as_floats(marker, name) for name, marker in markers.items()}
    shapes = {name: position.shape for name, position in positions.items()}
    shape = shapes["hip"]
    if {*shapes.values()} != {shape} or shape[1:] != (3,) or not shape[0]:
        raise ValueError(
            f"the markers have the shapes {shapes}; give all three of them one shape "
            "(n_frames, 3), one row of coordinates for each frame."
        )
    for name, position in positions.items():
        gaps = np.flatnonzero(~np.isfinite(position).all(axis=1))
        if len(gaps):
            raise ValueError(
                f"{name} holds NaN or infinity (or is masked) in {len(gaps)} of "
                f"{shape[0]} frames, first in frame {gaps[0]}; fill short gaps by "
                "kinematics.fill_gaps, or cut the recording there."
            )
    return np.array([*positions.values()])


def _as_floats(value: Any, name: str) -> Array:
    """Convert to floats, masked values to NaN; name the parameter that cannot be."""
    try:
        if hasattr(value, "iloc"):  # NumPy does not convert pandas' missing values
            value = value.astype(np.float64)
        return np.ma.filled(np.ma.asarray(value, dtype=np.float64), np.nan)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}.") from error


def _direction(value: Any, name: str) -> Array:
    """Return a unit vector from the number of a column or a vector."""
    is_column = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if is_column and 0 <= value < 3:
        return np.eye(3)[int(value)]
    vector = _as_floats(value, name)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not 0 < length < np.inf:
        raise ValueError(
            f"{name}={value!r} is no direction; pass the number of a column (0, 1 or "
            "2) or a finite vector of 3 components other than zero."
        )
    return np.asarray(vector / length)


def _check_segments(segments: Array, planar: Array) -> Array:
    """Return the mean lengths of thigh and shank; refuse implausible ones."""
    lengths = np.linalg.norm(segments, axis=-1).mean(axis=-1)
    is_flat = np.linalg.norm(planar, axis=-1) <= 1e-9 * lengths[:, np.newaxis]
    for segment, frame in np.argwhere(is_flat):
        raise ValueError(
            f"the {('thigh', 'shank')[segment]} has no length in the plane of forward "
            f"and up in frame {frame}; check the markers, forward and up."
        )
    if lengths.max() > 10 * lengths.min():
        raise ValueError(
            f"mean thigh length is {lengths[0]:.4g} but mean shank length "
            f"{lengths[1]:.4g}; pass all three markers in the same unit."
        )
    return lengths


def _warn_of_headstand(angles: Array, reach: Array, up: Any) -> None:
    """Warn if most frames show a leg that is upside down, or folded."""
    n_inverted = np.count_nonzero(reach[:, 1] > MIN_HEADSTAND)
    if 2 * n_inverted > len(reach):
        given = np.eye(3)[up] if np.ndim(up) == 0 else _as_floats(up, "up")
        opposite = ", ".join(f"{component:.15g}" for component in 0.0 - given)
        warn(
            f"the leg stands on its head in {n_inverted} of {len(reach)} frames: its "
            f"ankle is high above its hip. If up={up!r} points down, pass "
            f"up=[{opposite}]; else pass hip, knee and ankle in their order."
        )
    n_folded = np.count_nonzero(np.abs(angles[:, 1]) > np.radians(MAX_KNEE_FLEXION))
    if 2 * n_folded > len(angles):
        warn(
            f"the knee is bent by more than {MAX_KNEE_FLEXION:g} degrees in {n_folded} "
            f"of {len(angles)} frames, as if two markers were swapped. Pass hip, knee "
            f"and ankle in their order, and check forward and up={up!r}."
        )
