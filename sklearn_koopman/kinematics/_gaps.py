"""Recordings without gaps, and angles without jumps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from .._utils._clocks import HOLE, count_recordings, find_index, find_steps, read_labels
from .._utils._typing import Array, Indices, Mask
from .._utils._validation import as_floats, check_integer, check_number
from .._utils._wraps import find_wraps, warn_of_wraps


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
    leg_angles : Joint angles from markers; NaN in the gaps.
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
    values = np.array(as_floats(recording, "recording"), order="C")
    _check_recording(recording, values)
    columns = values.reshape(len(values), -1)  # a view
    was_lost = np.isnan(columns)
    for column in np.flatnonzero(was_lost.any(axis=0)):
        _fill_column(columns[:, column], max_gap)
    is_filled = was_lost & ~np.isnan(columns)
    _warn_of_wraps(recording, columns, was_lost, is_filled)
    return _like(recording, values), np.flatnonzero(is_filled.any(axis=1))


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
    RotationEncoder : Cosine and sine of angles that turn on and on.
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
    values = np.array(as_floats(angles, "angles"), order="C")
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
