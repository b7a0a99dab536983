"""A synthetic two-link leg that walks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from sklearn.utils import Bunch, check_random_state

from .._utils._typing import Array
from .._utils._validation import check_integer, check_number, check_positive

_DESCR = """\
SYNTHETIC walking of a planar two-link leg
------------------------------------------
Not measured on anybody: Fourier series of the gait phase in the shape of hip and knee
flexion of human walking, with stride-to-stride variation. There is no dynamics, no
contact with the ground, no noise and no movement of skin, and the leg stays in the
sagittal plane. Draw conclusions about walking from recorded motion only.
"""

_SEGMENTS = np.array([420.0, 430.0])  # thigh and shank, mm
# Degrees at 1.3 m/s: the mean, then cosine and sine of each multiple of the phase.
# Heel strike is at phase 0.
_HIP = np.array([13.9, 20.1, -1.9, -3.3, -2.6, -0.4, 1.2])
_KNEE = np.array([22.5, -2.2, -18.4, -14.8, 7.0, 0.2, 5.1, -0.2, 0.7])
# Relative standard deviations from stride to stride: duration, hip, knee.
_VARIATION = np.array([0.02, 0.04, 0.03])
_PERSISTENCE = 0.5  # correlation of one stride with the next
# Relative standard deviations between persons: segments; duration of a stride, hip,
# knee. Long thighs go with long shanks.
_LENGTH, _MANNER = 0.05, np.array([0.05, 0.10, 0.10])
_PROPORTION = 0.8  # correlation of thigh and shank


def make_walking(
    n_trials: int | None = None,
    *,
    n_persons: int | None = None,
    n_strides: int = 10,
    speeds: ArrayLike | None = None,
    rate: float = 150.0,
    variability: float = 1.0,
    random_state: int | np.random.RandomState | None = None,
) -> Bunch:
    r"""Generate SYNTHETIC walking trials of a planar two-link leg.

    **Nothing here is measured.** Hip and knee follow Fourier series in the shape of
    human walking; cadence and amplitude grow with speed, and durations and amplitudes
    vary from stride to stride. The trials serve for examples and tests that need
    several trajectories of unequal length with known outputs. They are easier to
    predict than recorded gait, and allow no conclusions about it.

    Parameters
    ----------
    n_trials : int, default=None
        Number of trials of each person; None means one for each of `speeds`, or 4.
    n_persons : int, default=None
        Number of persons, who differ in the lengths of thigh and shank, in cadence and
        in the excursions of hip and knee. Each walks at all of `speeds`, so that
        persons are exchangeable. None means one person who is not drawn: the mean of
        all.
    n_strides : int, default=10
        Number of strides in a trial, from heel strike to heel strike.
    speeds : array-like of shape (n_trials,), default=None
        Walking speeds [m/s]; by default evenly spaced from 0.6 to 1.5.
    rate : float, default=150.0
        Samples per second.
    variability : float, default=1.0
        Multiplies the variation from stride to stride; 0 gives a periodic motion.
        At 1 the standard deviations are 2 % in duration, 4 % in the excursion of the
        hip and 3 % in that of the knee.
    random_state : int, RandomState instance or None, default=None
        Seed of the persons and of the variation. The same seed gives the same motion at
        every `rate`.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes, trials of the first person first, and n_trials the number
        of all,

        trajectories : list of n_trials ndarray of shape (n_frames, 2)
            Hip flexion and knee flexion [rad], in the signs of
            :func:`~sklearn_koopman.kinematics.leg_angles`. Slow trials are longer.
        outputs : list of n_trials ndarray of shape (n_frames, 2)
            Ankle minus hip along (forward, up) [mm].
        markers : list of n_trials dict
            "hip", "knee" and "ankle": positions [mm] of shape (n_frames, 3) along
            X forward, Y up and Z right, of a right leg that walks through the room.
        phases : list of n_trials ndarray of shape (n_frames,)
            The gait phase, in strides from the first heel strike.
        speeds : ndarray of shape (n_trials,)
            The walking speeds [m/s].
        persons : ndarray of shape (n_trials,)
            Who walks, a number from 0.
        segments : ndarray of shape (n_persons, 2)
            Lengths of thigh and shank [mm].
        rate : float
            Samples per second.
        DESCR : str
            A description of the data.

    Raises
    ------
    ValueError
        If a number is out of range, or `n_trials` and `speeds` disagree.

    See Also
    --------
    load_markers : Reads recorded motion.
    sklearn_koopman.kinematics.leg_angles : Angles and outputs from the markers.
    sklearn_koopman.trajectories.trajectory_pairs : Pairs states and outputs.

    Notes
    -----
    With the gait phase :math:`\varphi` (one unit a stride) and the speed :math:`v`

    .. math::
        \theta^{(1)} &= h_0 + A_1 (v / 1.3)^{0.3} \sum_{k=1}^{3}
            (h_{2k-1} \cos 2\pi k\varphi + h_{2k} \sin 2\pi k\varphi), \\
        \theta^{(2)} &= A_2 (v / 1.3)^{0.2} \Bigl( g_0 + \sum_{k=1}^{4}
            (g_{2k-1} \cos 2\pi k\varphi + g_{2k} \sin 2\pi k\varphi) \Bigr),

    with :math:`0.93 \sqrt{v / 1.3}` strides a second. The series reach about +32 and
    -10 degrees at the hip, and 19 degrees in stance and 61 in swing at the knee, at
    1.3 m/s. The logarithms of durations and of the amplitudes :math:`A_1, A_2` are
    stationary AR(1) sequences over the strides; phase and amplitudes in between are
    monotone cubic interpolants, so that the angles have continuous derivatives. The
    outputs are the planar forward kinematics of a thigh of 420 mm and a shank of
    430 mm.

    Persons multiply these lengths, the duration of a stride, :math:`A_1` and
    :math:`A_2` by factors of their own, which hold for all their trials. Their
    logarithms are normal, with standard deviations of 5 % for both lengths, of which
    the correlation is 0.8, 5 % for the duration, and 10 % for either excursion. The
    hip is higher by as much as the leg is longer.

    The exponents, the cadence and the variation are of the size found in the
    treadmill trials of subject 1 of [1]_; no curve is fitted to them. The differences
    between persons are round numbers, of the order of those between healthy adults;
    they are not estimates.

    References
    ----------
    .. [1] C. A. Fukuchi, R. K. Fukuchi and M. Duarte, "A public dataset of overground
       and treadmill walking kinematics and kinetics in healthy individuals", PeerJ 6,
       e4640, 2018.

    Examples
    --------
    >>> from sklearn_koopman.datasets import make_walking
    >>> from sklearn_koopman.trajectories import trajectory_pairs
    >>> walking = make_walking(speeds=[0.8, 1.2], n_strides=5, random_state=0)
    >>> [len(angles) for angles in walking.trajectories]
    [1069, 857]
    >>> pairs = trajectory_pairs(walking.trajectories, walking.outputs, delays=2)
    >>> pairs.X.shape, pairs.y.shape
    ((1922, 4), (1922, 2))

    Three persons, who walk at two speeds each:

    >>> walking = make_walking(speeds=[0.8, 1.2], n_persons=3, random_state=0)
    >>> walking.persons
    array([0, 0, 1, 1, 2, 2])
    >>> walking.segments.shape
    (3, 2)
    """
    check_integer(n_strides, "n_strides", 1)
    if n_trials is not None:
        check_integer(n_trials, "n_trials", 1)
    if n_persons is not None:
        check_integer(n_persons, "n_persons", 1)
    check_number(rate, "rate", positive=True)
    check_number(variability, "variability")
    if speeds is None:
        speeds = np.linspace(0.6, 1.5, 4 if n_trials is None else n_trials)
    pace = check_positive(speeds, "speeds")
    if n_trials not in (None, len(pace)):
        raise ValueError(
            f"n_trials={n_trials} but speeds holds {len(pace)}; leave n_trials out, "
            "there is one trial for each speed."
        )
    rng = check_random_state(random_state)
    if n_persons is None:
        segments, manners = _SEGMENTS[np.newaxis], np.ones((1, len(_VARIATION)))
    else:
        segments, manners = _draw_persons(n_persons, rng)
    persons = np.repeat(np.arange(len(segments)), len(pace))
    all_speeds = np.tile(pace, len(segments))
    trials = []
    for person, speed in zip(persons, all_speeds, strict=True):
        # One value a stride boundary; the duration after the last one is not used.
        scatter = _ar1(n_strides + 1, len(_VARIATION), rng)
        scales = manners[person] * np.exp(variability * _VARIATION * scatter)
        trials.append(_trial(speed, rate, scales, segments[person]))
    trajectories, outputs, markers, phases = map(list, zip(*trials, strict=True))
    return Bunch(
        trajectories=trajectories,
        outputs=outputs,
        markers=markers,
        phases=phases,
        speeds=all_speeds,
        persons=persons,
        segments=segments,
        rate=float(rate),
        DESCR=_DESCR,
    )


def _draw_persons(n_persons: int, rng: np.random.RandomState) -> tuple[Array, Array]:
    """Draw lengths of segments, and factors of what varies from stride to stride."""
    size, shape = rng.standard_normal((2, n_persons))
    shank = _PROPORTION * size + np.sqrt(1 - _PROPORTION**2) * shape
    segments = _SEGMENTS * np.exp(_LENGTH * np.column_stack([size, shank]))
    scatter = rng.standard_normal((n_persons, len(_MANNER)))
    return segments, np.exp(_MANNER * scatter)


def _trial(
    speed: float, rate: float, scales: Array, segments: Array
) -> tuple[Array, Array, dict[str, Array], Array]:
    """Return angles, ankle relative to the hip, markers in the room, and phase."""
    duration = scales[:-1, 0] / (0.93 * np.sqrt(speed / 1.3))
    strikes = np.concatenate([[0.0], np.cumsum(duration)])
    time = np.arange(np.floor(strikes[-1] * rate) + 1) / rate
    knots = np.column_stack([np.arange(len(strikes)), scales[:, 1:]])
    # Monotone, so that the phase never runs backwards.
    phase, swing, bend = PchipInterpolator(strikes, knots)(time).T
    swing = swing * (speed / 1.3) ** 0.3
    bend = bend * (speed / 1.3) ** 0.2
    hip_flexion = np.radians(_HIP[0] + swing * (_fourier(_HIP, phase) - _HIP[0]))
    knee_flexion = np.radians(bend * _fourier(_KNEE, phase))

    thigh, shank = segments
    knee = thigh * _below(hip_flexion)
    ankle = knee + shank * _below(hip_flexion - knee_flexion)
    # The trunk is highest in mid-stance of either leg and sways once a stride.
    sway = 20 * np.cos(np.outer(phase - 0.3, [4 * np.pi, 2 * np.pi]))
    hip = np.column_stack(
        [1000 * speed * time, sway + np.array([30 + thigh + shank, 100])]
    )
    offsets = {"hip": np.zeros_like(knee), "knee": knee, "ankle": ankle}
    markers = {k: hip + np.pad(x, [(0, 0), (0, 1)]) for k, x in offsets.items()}
    return np.column_stack([hip_flexion, knee_flexion]), ankle, markers, phase


def _ar1(n_strides: int, n_series: int, rng: np.random.RandomState) -> Array:
    """Draw stationary AR(1) series of unit variance as columns."""
    values = rng.standard_normal((n_strides, n_series))
    for stride in range(1, n_strides):
        values[stride] *= np.sqrt(1 - _PERSISTENCE**2)
        values[stride] += _PERSISTENCE * values[stride - 1]
    return values


def _fourier(coefficients: Array, phase: Array) -> Array:
    """Evaluate a real Fourier series of period 1."""
    mean, cosines, sines = coefficients[0], coefficients[1::2], coefficients[2::2]
    waves = np.outer(phase, 2 * np.pi * np.arange(1, len(sines) + 1))
    return mean + np.cos(waves) @ cosines + np.sin(waves) @ sines


def _below(angle: Array) -> Array:
    """Unit vectors (forward, up) at an angle against the downward vertical."""
    return np.column_stack([np.sin(angle), -np.cos(angle)])
