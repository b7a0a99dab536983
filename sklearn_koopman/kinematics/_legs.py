"""Joint angles of a leg, and its length."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._utils._typing import Array, Mask
from .._utils._validation import as_floats
from .._utils._warnings import warn

# No knee bends farther for long; with two markers swapped, a leg that is bent by less
# than a right angle seems to.
MAX_KNEE_FLEXION = 135.0
# Seen from the side, most of a leg is in the plane, also of one that is spread.
MIN_IN_PLANE = 0.7
# An ankle above the hip by more than this part of the leg is upside down: one that
# lies, even on a cushion, is not, and one that cycles or runs is most of the time.
MIN_HEADSTAND = 0.5


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

    The markers are projected onto the sagittal plane spanned by `forward` and `up`,
    unless they are planar themselves, as those of one camera are. The two angles are
    the states of the walking example of [1]_ and the ankle is its output.

    Parameters
    ----------
    hip : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the hip marker, such as the greater trochanter. NaN where it is
        lost.
    knee : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the knee marker, in the same frames, axes and unit.
    ankle : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the ankle marker, in the same frames, axes and unit.
    forward : int or array-like of shape (3,) or (2,)
        Direction of walking: the number of a column, from 0, or a vector of any
        length, for instance ``[-1, 0, 0]`` for somebody who walks against the first
        axis.
    up : int or array-like of shape (3,) or (2,)
        The vertical, given in the same way; orthogonal to `forward` within 1e-6. In an
        image, whose rows are counted from the top, it is ``[0, -1]``.
    normalize : bool, default=False
        Whether the ankle is divided by the length of this leg, which is
        :func:`leg_length`. It makes the outputs of one person comparable with those of
        another. Multiply predictions by the length of that other's leg.

    Returns
    -------
    angles : ndarray of shape (n_frames, 2)
        Hip flexion and knee flexion in radians, both in (-pi, pi].

        * Hip flexion is the angle of the thigh against the downward vertical:
          positive with the knee in front of the hip.
        * Knee flexion is the angle of the thigh less the angle of the shank: 0 for a
          straight leg, positive with the heel drawn towards the buttock.

        Both are NaN in frames in which a marker holds NaN.
    ankle : ndarray of shape (n_frames, 2)
        Ankle minus hip along `forward` and `up`, in the unit of the markers, or as a
        fraction of the length of the leg if `normalize` is set. NaN in the same frames.

    Raises
    ------
    ValueError
        If the markers differ in shape, or have another one; if one holds infinity or
        is masked; if NaN leaves no frame; if a segment has no length in the plane; if
        thigh and shank differ more than tenfold in length, as they do when units are
        mixed; if `forward` or `up` is no direction, or they are not orthogonal.

    Warns
    -----
    UserWarning
        If in more than half of the frames the leg stands on its head: its ankle is
        above its hip by more than half of the length of the leg, as with `up` pointing
        down, or hip and ankle swapped. If in more than half of the frames the knee is
        bent by more than 135 degrees, either way, as with any other two markers
        swapped. If in more than half of the frames less than 0.7 of the length of the
        leg lies in the plane, as with the wrong axes. A leg that lies on a bench does
        not warn, so that a horizontal `up` in the plane is not found out.

    See Also
    --------
    fill_gaps : Fills short gaps in the markers.
    leg_length : The length that `normalize` divides by.
    sklearn_koopman.datasets.load_markers : Reads markers from a file.
    sklearn_koopman.trajectories.trajectory_pairs : Pairs angles and ankle positions;
        with ``gaps="split"`` it cuts them at NaN.

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
    positions, seen = _check_markers(hip=hip, knee=knee, ankle=ankle)
    n_axes = positions.shape[-1]
    axes = np.column_stack(
        [_direction(forward, "forward", n_axes), _direction(up, "up", n_axes)]
    )
    if abs(axes[:, 0] @ axes[:, 1]) > 1e-6:
        raise ValueError(
            f"forward={forward!r} and up={up!r} are not orthogonal; subtract from one "
            "its part along the other, or use two different columns."
        )
    segments = np.diff(positions, axis=0)
    planar = segments @ axes
    length = _check_segments(segments, planar, seen, "in the plane of forward and up ")
    _warn_of_plane(positions, planar, forward, up)
    # In a complex plane whose real axis points straight down.
    thigh, shank = -planar[..., 1] + 1j * planar[..., 0]
    # The sum turns -0.0 into 0.0: a shank folded onto the thigh is at pi, not -pi.
    bend = thigh * shank.conj() + 0.0
    angles = np.column_stack([np.angle(thigh), np.angle(bend)])
    reach = (positions[2] - positions[0]) @ axes
    _warn_of_headstand(angles, reach / length, axes[:, 1], up)
    if normalize:
        reach = reach / length
    return _spread(angles, seen), _spread(reach, seen)


def leg_length(hip: ArrayLike, knee: ArrayLike, ankle: ArrayLike) -> float:
    """Length of one leg: the mean length of its thigh plus that of its shank.

    This is what :func:`leg_angles` divides the ankle by with ``normalize=True``. A
    normalised ankle times the length of a leg is in the unit of its markers again. So
    a model of some persons predicts another one, whose leg is as long as this says.

    Parameters
    ----------
    hip : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the hip marker.
    knee : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the knee marker, in the same frames, axes and unit.
    ankle : array-like of shape (n_frames, 3) or (n_frames, 2)
        Positions of the ankle marker, in the same frames, axes and unit.

    Returns
    -------
    length : float
        Mean distance of knee and hip, plus mean distance of ankle and knee, over all
        frames without NaN, in the unit of the markers.

    Raises
    ------
    ValueError
        If the markers differ in shape, or have another one; if one holds infinity or
        is masked; if NaN leaves no frame; if a segment has no length in some frame; if
        thigh and shank differ more than tenfold in length, as they do when units are
        mixed.

    See Also
    --------
    leg_angles : Joint angles, and the ankle in units of this length.

    Examples
    --------
    >>> from sklearn_koopman.kinematics import leg_angles, leg_length
    >>> leg = {"hip": [[0, 900]], "knee": [[0, 500]], "ankle": [[240, 180]]}
    >>> leg_length(**leg)
    800.0
    >>> _, ankle = leg_angles(**leg, forward=0, up=1, normalize=True)
    >>> ankle
    array([[ 0.3, -0.9]])
    >>> ankle * leg_length(**leg)
    array([[ 240., -720.]])
    """
    positions, seen = _check_markers(hip=hip, knee=knee, ankle=ankle)
    segments = np.diff(positions, axis=0)
    return _check_segments(segments, segments, seen)


def _check_markers(**markers: Any) -> tuple[Array, Mask]:
    """Validate markers.

    Returns
    -------
    positions : ndarray of shape (3, n_seen, 2 or 3)
        The markers in the frames in which none of them holds NaN; all are finite.
    seen : ndarray of shape (n_frames,)
        Whether a frame is one of them.
    """
    positions = {name: as_floats(marker, name) for name, marker in markers.items()}
    shapes = {name: position.shape for name, position in positions.items()}
    shape = shapes["hip"]
    if {*shapes.values()} != {shape} or shape[1:] not in ((2,), (3,)) or not shape[0]:
        raise ValueError(
            f"the markers have the shapes {shapes}; give all three of them one shape, "
            "(n_frames, 3) or (n_frames, 2), one row of coordinates for each frame."
        )
    for name, position in positions.items():
        is_bad = np.isinf(position) | np.ma.getmaskarray(np.ma.asarray(markers[name]))
        bad = np.flatnonzero(is_bad.any(axis=1))
        if len(bad):
            raise ValueError(
                f"{name} holds infinity or is masked in {len(bad)} of {shape[0]} "
                f"frames, first in frame {bad[0]}; write NaN there, or fill short gaps "
                "by kinematics.fill_gaps."
            )
    stacked = np.array([*positions.values()])
    lost = np.isnan(stacked).any(axis=2)
    seen = ~lost.any(axis=0)
    if not seen.any():
        counts = dict(zip(positions, lost.sum(axis=1).tolist(), strict=True))
        raise ValueError(
            f"no frame of {shape[0]} shows all markers: NaN in {counts} frames; pass "
            "markers that are seen together."
        )
    return stacked[:, seen], seen


def _spread(values: Array, seen: Mask) -> Array:
    """Return values of the frames that are seen, and NaN in the others."""
    spread = np.full((len(seen), *values.shape[1:]), np.nan)
    spread[seen] = values
    return spread


def _direction(value: Any, name: str, n_axes: int) -> Array:
    """Return a unit vector from the number of a column or a vector."""
    is_column = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if is_column and 0 <= value < n_axes:
        return np.eye(n_axes)[int(value)]
    vector = as_floats(value, name)
    length = np.linalg.norm(vector)
    if vector.shape != (n_axes,) or not 0 < length < np.inf:
        numbers = {2: "0 or 1", 3: "0, 1 or 2"}[n_axes]
        raise ValueError(
            f"{name}={value!r} is no direction; pass the number of a column "
            f"({numbers}) or a finite vector of {n_axes} components other than zero."
        )
    return np.asarray(vector / length)


def _check_segments(
    segments: Array, planar: Array, seen: Mask, where: str = ""
) -> float:
    """Return the mean lengths of thigh and shank, added; refuse implausible ones."""
    lengths = np.linalg.norm(segments, axis=-1).mean(axis=-1)
    is_flat = np.linalg.norm(planar, axis=-1) <= 1e-9 * lengths[:, np.newaxis]
    for segment, frame in np.argwhere(is_flat):
        name = ("thigh", "shank")[segment]
        checks = "the markers, forward and up" if where else "the markers"
        raise ValueError(
            f"the {name} has no length {where}in frame {np.flatnonzero(seen)[frame]}; "
            f"check {checks}."
        )
    if lengths.max() > 10 * lengths.min():
        raise ValueError(
            f"mean thigh length is {lengths[0]:.4g} but mean shank length "
            f"{lengths[1]:.4g}; pass all three markers in the same unit."
        )
    return float(lengths.sum())


def _warn_of_plane(positions: Array, planar: Array, forward: Any, up: Any) -> None:
    """Warn if most of the leg lies outside of the plane of forward and up."""
    segments = np.diff(positions, axis=0)
    in_plane, whole = (
        np.linalg.norm(x, axis=2).sum(axis=0) for x in (planar, segments)
    )
    part = float(np.median(in_plane / whole))
    if part < MIN_IN_PLANE:
        drop = (positions[0] - positions[2]).mean(axis=0)
        axis = int(np.abs(drop).argmax())
        upward = str(axis)
        if drop[axis] < 0:
            upward = str((-np.eye(len(drop), dtype=int)[axis]).tolist())
        warn(
            f"{1 - part:.0%} of the length of the leg lie outside of the plane of "
            f"forward={forward!r} and up={up!r}, as with the wrong axes. The hip is "
            f"above the ankle along axis {axis}: pass up={upward}, and forward "
            "accordingly."
        )


def _warn_of_headstand(angles: Array, reach: Array, axis: Array, up: Any) -> None:
    """Warn if most frames show a leg that is upside down, or folded."""
    n_inverted = np.count_nonzero(reach[:, 1] > MIN_HEADSTAND)
    if 2 * n_inverted > len(reach):
        given = axis if np.ndim(up) == 0 else as_floats(up, "up")
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
