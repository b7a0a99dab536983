"""Archives of the markers of several trials."""

import os
from zipfile import BadZipFile

import numpy as np
from sklearn.utils import Bunch


def load_trials(path: str | os.PathLike[str]) -> Bunch:
    """Read the markers of several trials from an ``.npz`` archive.

    The archive holds the array ``trial`` of shape (n_frames,), which is the number of
    the trial of each frame; the number ``rate``, in frames per second; and one array of
    shape (n_frames, 3) for each marker, with its positions. Other arrays may stand
    beside them and are not read. :func:`numpy.savez` writes such archives.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        markers : list of n_trials dict of str to ndarray of shape (n_frames, 3)
            Positions of each marker in each trial, in the unit of the archive.
        trials : ndarray of shape (n_trials,)
            The numbers of the trials, in rising order.
        rate : float
            Frames per second.
        filename : str
            The path of the file.
        DESCR : str
            A summary in one line.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is no archive of such arrays. The message names what is missing.

    See Also
    --------
    load_markers : Reads one trial from a marker file.
    sklearn_koopman.kinematics.leg_angles : Joint angles from markers.
    sklearn_koopman.trajectories.trajectory_pairs : Pairs states and outputs within
        each trial.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from sklearn_koopman.datasets import load_trials
    >>> positions = np.arange(15.0).reshape(5, 3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "walking.npz"
    ...     np.savez(path, hip=positions, trial=[1, 1, 1, 2, 2], rate=100.0)
    ...     walking = load_trials(path)
    >>> [markers["hip"].shape for markers in walking.markers]
    [(3, 3), (2, 3)]
    """
    where = os.fspath(path)
    try:
        with open(where, "rb") as file, np.load(file) as archive:
            arrays = dict(archive)
    except (ValueError, TypeError, EOFError, BadZipFile) as error:
        raise ValueError(
            f"{where} is not an .npz archive of plain arrays; write it by numpy.savez."
        ) from error
    trial, rate = arrays.get("trial", np.empty(0)), arrays.get("rate", np.empty(0))
    markers = {k: x for k, x in arrays.items() if x.ndim == 2 and x.shape[1] == 3}
    lengths = {len(x) for x in markers.values()}
    is_rate = rate.ndim == 0 and rate.dtype.kind in "iuf" and 0 < rate < np.inf
    if trial.ndim != 1 or lengths != {len(trial)} or not (len(trial) and is_rate):
        found = ", ".join(f"{name!r} {x.shape}" for name, x in arrays.items())
        raise ValueError(
            f"{where} must hold 'trial' of shape (n_frames,), a positive number 'rate' "
            f"and at least one marker of shape (n_frames, 3); it holds {found}."
        )
    numbers = np.unique(trial)
    return Bunch(
        markers=[{k: x[trial == i] for k, x in markers.items()} for i in numbers],
        trials=numbers,
        rate=float(rate),
        filename=where,
        DESCR=f"{len(markers)} markers in {len(numbers)} trials, read from {where}",
    )
