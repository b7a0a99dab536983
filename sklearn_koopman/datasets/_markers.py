"""Markers from files of any of the formats."""

import os
from collections.abc import Sequence

from sklearn.utils import Bunch

from ._formats import read_recording
from ._formats._positions import Choices, check_choices, select_positions
from ._formats._text import File


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
    r"""Read the positions of markers from a file.

    The format is recognised from the file: C3D; TRC, as OpenSim and others write it;
    the TSV of Qualisys; the CSV of Vicon; the text of Visual3D; the CSV of DeepLabCut
    and Lightning Pose; and the tab-separated format of [1]_. Coordinates are returned
    as they are in the file.

    Parameters
    ----------
    path : str or path-like
        The file.
    markers : sequence of str, default=None
        Names of the markers to read, with or without the person in front, as in
        ``"S01:Hip"``; None reads all. Only markers that are read are checked for gaps.
    rate : float, default=None
        Frames per second. None takes what the file says, by a number in its head or by
        stamps in seconds. It is needed for the files of Visual3D and DeepLabCut, and
        for tab-separated ones with numbers of frames. A rate that is given wins over
        the head, and must agree with stamps in seconds within 1 %.
    unit : {"mm", "cm", "m", "px"}, default=None
        Unit of the coordinates. None takes the unit that the file says, or "mm" for the
        formats of Qualisys and of [1]_, and "px" for DeepLabCut. A body is refused that
        would be smaller than 20 cm or larger than 3 m, and that another unit brings
        nearer to 1 m. The body is that of all markers of the file, whichever are read.
        A unit that is given wins over the file, and is not checked. Only poses in a
        video are in "px".
    gaps : {"raise", "nan"}, default="raise"
        Whether gaps in the markers that are read are refused, or returned as NaN, for
        instance to fill them by :func:`~sklearn_koopman.kinematics.fill_gaps`.
    zeros : {"gap", "keep"}, default="gap"
        Whether a marker that stands at exactly 0, 0, 0 is lost, as many programs write
        it, or is really there. The same holds where all coordinates are one number of
        nines, at least four of them, such as 9999 or -99999.
    min_likelihood : float, default=None
        The smallest likelihood of a position that is kept; what is below is a gap. None
        keeps all but those below zero. Only for files that hold likelihoods.
    individual : str, default=None
        The person or animal to read, where the file holds several. It is the name in
        the head of a file of DeepLabCut, or what stands before the colon in names such
        as ``"S01:Hip"``.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        markers : dict of str to ndarray of shape (n_frames, 3) or (n_frames, 2)
            Positions of each marker; two columns where it is planar. Its name is the
            one that it was asked for by, or the one without the person.
        names : list of str
            The markers, in the order of the file or of `markers`.
        time : ndarray of shape (n_frames,)
            Time [s]: the stamp of the file if it is in seconds, put on the grid of the
            rate; else the number of the frame divided by the rate. The first frame of a
            recording is at 0, whether its program counts from 0 or from 1; numbers in
            the tab-separated format count from 0.
        rate : float
            Frames per second.
        unit : str
            Unit of the coordinates.
        likelihood : dict of str to ndarray of shape (n_frames,)
            Likelihood of each position. Only if the file holds any.
        individuals : list of str
            The individuals of the file. Only if it names any.
        filename : str
            The path of the file.
        DESCR : str
            A summary in one line.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        If the file is C3D and the library ezc3d is not installed.
    ValueError
        If the file is empty or of another format; the message then says which one it
        looks like, and the lines that bring it in. If a marker or an individual is
        missing, or is not the only one of its name; if a marker lacks a coordinate, or
        has gaps and `gaps` does not let them pass; if a line has too few or too many
        fields, or a field is not a number; if frames are missing or out of order, or
        their steps vary; if rate and stamps contradict each other; if neither the file
        nor the call tells the rate or the unit, or the size of the body contradicts the
        unit. The message names the file, the line or marker, and what to do.

    Warns
    -----
    UserWarning
        If the head of the file counts other frames or markers than it holds; if `rate`
        differs from the rate of the head by more than 1 %, and no stamps in seconds
        decide.

    See Also
    --------
    load_angles : Reads joint angles.
    load_trials : Reads arrays of several trials.
    markers_from_movement : Takes the poses that the package movement reads.
    make_walking : Synthetic markers.
    sklearn_koopman.kinematics.fill_gaps : Fills short gaps.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.

    Notes
    -----
    Text may be in UTF-8, UTF-16 or the Western code page, with any ends of lines, and
    with decimal points or commas. A line without any number is a comment. A gap is a
    blank, NaN or infinite coordinate, a residual (C3D) or likelihood below zero, and a
    position at exactly 0, 0, 0 or at nines.

    C3D needs the library ezc3d, ``pip install ezc3d``, which the extra ``[c3d]`` of
    this package brings. Only points are read; angles, forces, moments and powers,
    which models store among them, are not.

    The tab-separated format has one line of column names,
    ``Time  NAMEX  NAMEY  NAMEZ ...``, and one line a frame. `Time` holds either the
    number of the frame or seconds; seconds may be rounded to milliseconds. Numbers of
    frames are whole and advance by one.

    The size of a body is the median over some hundred frames of the largest extent of
    all markers of the file along an axis. A single marker has no size, and is not
    checked, nor are pixels.

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
    file, where = File.read(path), os.fsdecode(path)
    try:
        return select_positions(read_recording(file), choices, where)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
