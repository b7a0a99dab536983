"""Markers from files of any of the formats."""

import os
from collections.abc import Sequence

from sklearn.utils import Bunch

from ._formats import read_recording
from ._positions import Choices, check_choices, select_positions


def load_markers(
    path: str | os.PathLike[str],
    *,
    markers: Sequence[str] | None = None,
    rate: float | None = None,
    unit: str | None = None,
    gaps: str = "raise",
    zeros: str = "gap",
    min_likelihood: float | None = None,
    individual: str | None = None,
) -> Bunch:
    r"""Read marker positions from a tab-separated or an OpenSim TRC file.

    A file that is named ``*.trc`` or begins with ``PathFileType`` is read as TRC, any
    other file as the tab-separated format of [1]_. Coordinates are returned as they are
    in the file.

    Parameters
    ----------
    path : str or path-like
        The file.
    markers : sequence of str, default=None
        Names of the markers to read; None reads all. Only markers that are read are
        checked for gaps.
    rate : float, default=150.0
        Frames per second of a tab-separated file, which does not state it. Not used
        for TRC files, which state it.
    unit : {"mm", "cm", "m"}, default=None
        Unit of the coordinates. None takes the unit of the TRC header, or "mm" for a
        tab-separated file, and refuses a body that would be smaller than 20 cm or
        larger than 3 m, and that another unit brings nearer to 1 m. The body is that of
        all markers of the file, whichever are read. A unit that is given wins over the
        header, and is not checked.
    gaps : {"raise", "nan"}, default="raise"
        Whether gaps in the markers that are read are refused, or returned as NaN, for
        instance to fill them by :func:`~sklearn_koopman.kinematics.fill_gaps`.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        markers : dict of str to ndarray of shape (n_frames, 3)
            Positions of each marker.
        names : list of str
            The markers, in the order of the file or of `markers`.
        time : ndarray of shape (n_frames,)
            Time [s]: the number of the frame divided by the rate.
        rate : float
            Frames per second.
        unit : str
            Unit of the coordinates.
        filename : str
            The path of the file.
        DESCR : str
            A summary in one line.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is empty or not of either format; if a marker is missing, appears
        twice, or lacks a coordinate; if a marker that is read has gaps, unless `gaps`
        lets them pass; if a line has too few or too many fields, or a field is not a
        number; if frames are missing or out of order; if the rate or the numbers of
        frames and markers contradict the file; if the file names no unit, or one that
        the size of the body contradicts. The message names the file, the line or
        marker, and what to do.

    See Also
    --------
    load_trials : Reads arrays of several trials.
    make_walking : Synthetic markers.
    sklearn_koopman.kinematics.fill_gaps : Fills short gaps.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.

    Notes
    -----
    The tab-separated format has one line of column names,
    ``Time  NAMEX  NAMEY  NAMEZ ...``, and one line a frame. `Time` holds either the
    number of the frame or seconds; seconds may be rounded to milliseconds, and must
    agree with `rate` within 1 %. Frame numbers are whole and advance by one.

    The size of a body is the median over some hundred frames of the largest extent of
    all markers of the file along an axis. A single marker has no size, and is not
    checked.

    A gap is a blank, NaN or infinite coordinate. Some programs write ``0  0  0``
    instead; such zeros cannot be told from a position and are returned as they are.

    References
    ----------
    .. [1] C. A. Fukuchi, R. K. Fukuchi and M. Duarte, "A public dataset of overground
       and treadmill walking kinematics and kinetics in healthy individuals", PeerJ 6,
       e4640, 2018.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from sklearn_koopman.datasets import load_markers
    >>> text = "Time\tHipX\tHipY\tHipZ\tKneeX\tKneeY\tKneeZ\n"
    >>> text += "0\t0.0\t900.0\t80.0\t150.0\t480.0\t80.0\n"
    >>> text += "1\t9.5\t901.2\t80.1\t161.0\t481.5\t79.8\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "trial.txt"
    ...     _ = path.write_text(text)
    ...     trial = load_markers(path, rate=100)
    >>> trial.markers["Knee"]
    array([[150. , 480. ,  80. ],
           [161. , 481.5,  79.8]])
    >>> trial.time, trial.unit
    (array([0.  , 0.01]), 'mm')
    """
    choices = Choices(markers, rate, unit, gaps, zeros, min_likelihood, individual)
    check_choices(choices)
    where = os.fspath(path)
    try:
        return select_positions(read_recording(where), choices, where)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
