"""Joint angles from files of OpenSim."""

import os
import re
from collections.abc import Sequence

import numpy as np
from sklearn.utils import Bunch

from .._utils._typing import Array
from .._utils._validation import check_choice, check_names
from .._utils._warnings import warn
from .._utils._wraps import find_degrees
from ._formats._clock import read_clock
from ._formats._storage import read_storage
from ._formats._text import File

RADIANS = {"degrees": np.pi / 180, "radians": 1.0}
# OpenSim's names of what is no angle: translations, speeds, positions and forces by
# their axes, muscles, actuators, errors.
NO_ANGLE = re.compile(
    r"(^|_)t[xyz](/value)?$|_u$|/speed$|_[vpfm][xyz]$|(?-i:_[XYZ]$)|_in_ground_"
    r"|force|torque|moment|activation|fiber_length|reserve|error",
    re.IGNORECASE,
)


def load_angles(
    path: str | os.PathLike[str],
    *,
    angles: Sequence[str] | None = None,
    unit: str | None = None,
) -> Bunch:
    r"""Read joint angles from a file of OpenSim, ``.mot`` or ``.sto``.

    Parameters
    ----------
    path : str or path-like
        The file.
    angles : sequence of str, default=None
        Names of the columns to read. None reads all but those that OpenSim names as
        something else: translations (``pelvis_tx``), positions, speeds, forces,
        torques, moments, reserves, errors, activations and lengths of fibres.
    unit : {"degrees", "radians"}, default=None
        Unit of the angles in the file. None takes what the file says by ``inDegrees``.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        angles : ndarray of shape (n_frames, n_angles)
            The angles in radians, whatever the unit of the file. NaN where the file
            holds no finite number.
        names : list of str
            The names of the angles, in the order of the file or of `angles`.
        left_out : list of str
            The names of the other columns.
        time : ndarray of shape (n_frames,)
            Time [s], as the file states it, evenly spaced.
        rate : float
            Frames per second, from the stamps of time.
        filename : str
            The path of the file.
        DESCR : str
            A summary in one line.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is no storage of OpenSim or has no frames; if its first line says
        that it holds something else, such as speeds or moment arms; if it does not say
        its unit, and `unit` does not either; if a column is missing, appears twice, or
        is no angle by its name; if a line has too few or too many fields, or a field is
        no number; if the stamps of time do not advance evenly. The message names the
        file, the line or column, and what to do.

    Warns
    -----
    UserWarning
        If the file says that its angles are in radians, but one of them exceeds 4 pi;
        if the number of its lines is not the one that its head claims.

    See Also
    --------
    load_markers : Reads positions of markers.
    sklearn_koopman.kinematics.RotationEncoder : Turns angles that wrap into cosines and
        sines.
    sklearn_koopman.kinematics.unwrap_angles : Removes the jumps of angles that wrap.

    Notes
    -----
    The rate is the number of steps over the time that they take. A whole rate is taken
    where it agrees with all stamps as they are rounded, such as 60 for steps of
    0.016667 s. Simulations of OpenSim write uneven steps: resample them there, or
    export them at a fixed rate.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from sklearn_koopman.datasets import load_angles
    >>> text = "Coordinates\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\nendheader\n"
    >>> text += "time\thip_flexion_r\tpelvis_tx\n0.00\t20.0\t0.1\n0.01\t21.0\t0.1\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "walk.mot"
    ...     _ = path.write_text(text)
    ...     walk = load_angles(path)
    >>> walk.names, walk.left_out, walk.rate
    (['hip_flexion_r'], ['pelvis_tx'], 100.0)
    >>> np.degrees(walk.angles)
    array([[20.], [21.]])
    """
    check_choice(unit, "unit", (None, *RADIANS))
    check_names(angles, "angles")
    file, where = File.read(path), os.fsdecode(path)
    try:
        recording, names, unit_of_file = read_storage(file)
        chosen = _select(names, angles)
        values = recording.table.read([1 + names.index(name) for name in chosen])
        values[~np.isfinite(values)] = np.nan
        time, rate = read_clock(recording, None)
        if np.isnan(rate):
            raise ValueError("the file holds one frame; a recording has several.")
        if unit is None and unit_of_file is None:
            raise ValueError(
                "the file does not say whether its angles are in degrees (a line "
                "inDegrees=yes or no is missing); pass unit='degrees' or "
                "unit='radians'."
            )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    if unit is None and unit_of_file == "radians":
        _warn_of_degrees(where, chosen, values)
    return Bunch(
        angles=values * RADIANS[unit or str(unit_of_file)],
        names=chosen,
        left_out=[name for name in names if name not in chosen],
        time=time,
        rate=rate,
        filename=where,
        DESCR=f"{len(chosen)} angles in {len(time)} frames at {rate:g} Hz, in "
        f"radians, read from {where}",
    )


def _select(names: list[str], angles: Sequence[str] | None) -> list[str]:
    """Return the names of the columns to read."""
    if angles is None:
        angles = [name for name in names if not NO_ANGLE.search(name)]
        if not angles:
            raise ValueError(
                f"the names of the columns are not those of angles, but {names[:4]}; "
                "read them by numpy or pandas."
            )
    for name in angles:
        if names.count(name) != 1:
            raise ValueError(
                f"{names.count(name)} columns are called {name!r}; the file holds "
                f"{names}."
            )
        if NO_ANGLE.search(name):
            raise ValueError(
                f"{name!r} is no angle by its name; read it by numpy or pandas."
            )
    return list(dict.fromkeys(angles))


def _warn_of_degrees(where: str, names: list[str], values: Array) -> None:
    """Warn if what the file calls radians is too large for a joint."""
    found = find_degrees(values)
    if found:
        column, largest = found
        warn(
            f"{where} says that its angles are in radians, but {names[column]!r} "
            f"reaches {largest:g}. If they are in degrees, pass unit='degrees', else "
            "unit='radians'."
        )
