"""A discrete pendulum with a known map and a known output."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn import config_context
from sklearn.utils import Bunch, check_array, check_random_state

from .._utils._typing import Array
from .._utils._validation import check_integer, check_number
from ..trajectories import trajectory_pairs

_DESCR = """\
Pendulum of unit mass and length, simulated
-------------------------------------------
States (momentum, position) of the Stoermer-Verlet recursion, and the output
1.5 - sin(position) + momentum ** 2 / 9 of Powell et al., Section 4.1. Without noise
y = G(f(X)) and X_next = f(X) for the maps f and G given here.
"""


def make_pendulum(
    n_samples: int = 256,
    *,
    initial: ArrayLike = (0.0, 2.0),
    n_trajectories: int | None = None,
    step: float = 0.1,
    noise: float = 0.0,
    state_noise: float = 0.0,
    random_state: int | np.random.RandomState | None = None,
) -> Bunch:
    r"""Simulate a pendulum, with its true map and output function.

    It is the first example of [1]_ (Section 4.1).
    The system is discrete, and its true functions are known: `f` is the Stoermer-Verlet
    recursion itself and not an approximation of it, so that an estimate can be compared
    with ``G(f(x))`` down to rounding errors.

    Parameters
    ----------
    n_samples : int, default=256
        Number of rows of `X` from each trajectory. One more state is simulated.
    initial : array-like of shape (2,) or (n_trajectories, 2), or "random"
        The (momentum, position) where each trajectory starts, by default (0, 2).
        With "random" the pendulums have random amplitude and phase, and swing through
        at most 2.5 rad to either side.
    n_trajectories : int, default=None
        Number of random starts, with ``initial="random"`` only; None means one.
    step : float, default=0.1
        Time step of the recursion [s]. It is stable up to steps of about 2.
    noise : float, default=0.0
        Standard deviation of Gaussian noise on the measured outputs.
    state_noise : float, default=0.0
        Standard deviation of Gaussian noise on the measured states. Every state is
        measured once: `X_next` of a row and `X` of the following row are equal. The
        motion itself, and the outputs, are those of the undisturbed states.
    random_state : int, RandomState instance or None, default=None
        Seed of random starts and noise. The starts do not depend on `noise` or
        `state_noise`.

    Returns
    -------
    :class:`~sklearn.utils.Bunch`
        With the attributes

        X : ndarray of shape (n_trajectories * n_samples, 2)
            The measured states (momentum, position).
        y : ndarray of shape (n_trajectories * n_samples,)
            The measured outputs one step later, ``G(f(X))`` without noise.
        X_next : ndarray of shape (n_trajectories * n_samples, 2)
            The measured states one step later, ``f(X)`` without noise.
        groups, sample_index : ndarray of shape (n_trajectories * n_samples,)
            Trajectory of each row, and place on it, as returned by
            :func:`~sklearn_koopman.trajectories.trajectory_pairs`.
        time, frame : ndarray of shape (n_trajectories * n_samples,)
            The number of the sample of each row, as returned there.
        feature_names : list of str
            The names of the columns, as returned there.
        trajectories : list of ndarray of shape (n_samples + 1, 2)
            The measured states by trajectory.
        outputs : list of ndarray of shape (n_samples + 1,)
            The measured outputs by trajectory.
        f, G : callable
            One step of the system and the output, without noise, for states of shape
            (2,) or (n, 2). Both can be pickled.
        DESCR : str
            A description of the data.

    Raises
    ------
    ValueError
        If a number is out of range, if `initial` is neither "random" nor of a shape
        given above, or if `n_trajectories` is set although `initial` is given.

    See Also
    --------
    make_walking : A leg instead of a pendulum.
    sklearn_koopman.trajectories.trajectory_pairs : Makes the rows from trajectories.

    Notes
    -----
    With momentum :math:`x^{(1)}`, position :math:`x^{(2)}` and step :math:`h` the
    recursion of [1]_, Section 4.1, after [2]_, is

    .. math::
        x^{(1)}_{i+1/2} &= x^{(1)}_i - \tfrac{h}{2} \sin x^{(2)}_i, \\
        x^{(2)}_{i+1} &= x^{(2)}_i + h \, x^{(1)}_{i+1/2}, \\
        x^{(1)}_{i+1} &= x^{(1)}_{i+1/2} - \tfrac{h}{2} \sin x^{(2)}_{i+1},

    and the output is :math:`G(x) = 1.5 - \sin x^{(2)} + (x^{(1)})^2 / 9`. The map is
    symplectic and reversible. Its orbits lie on closed curves, which differ by
    :math:`O(h^2)` from curves of constant energy
    :math:`(x^{(1)})^2 / 2 - \cos x^{(2)}`. The curves depend on the step size, so
    compare estimates only on orbits of the same step size.

    Random starts have amplitude :math:`a` uniform on [0.5, 2.5] and phase
    :math:`\varphi` uniform on :math:`[0, 2\pi)`: position :math:`a \cos\varphi` and,
    of the sign of :math:`-\sin\varphi`, momentum
    :math:`\pm\sqrt{2 (\cos x^{(2)} - \cos a)}`.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    .. [2] E. Hairer, C. Lubich and G. Wanner, "Geometric Numerical Integration",
       Example I.1.4, Springer, 2006.

    Examples
    --------
    The orbit of the paper:

    >>> import numpy as np
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> data = make_pendulum()
    >>> data.X.shape, data.y.shape
    ((256, 2), (256,))
    >>> bool(np.allclose(data.y, data.G(data.f(data.X)), rtol=0, atol=1e-14))
    True

    Scattered states instead of orbits are many trajectories of one sample each:

    >>> scattered = make_pendulum(
    ...     n_samples=1, initial="random", n_trajectories=500, random_state=0
    ... )
    >>> scattered.X.shape
    (500, 2)
    """
    check_integer(n_samples, "n_samples", 1)
    check_number(step, "step", positive=True)
    check_number(noise, "noise")
    check_number(state_noise, "state_noise")
    rng = check_random_state(random_state)
    start = _starts(initial, n_trajectories, rng)

    f = partial(_stormer_verlet, step=float(step))
    states = np.empty((n_samples + 1, *start.shape))
    states[0] = start
    for i in range(n_samples):
        states[i + 1] = f(states[i])
    outputs = _output(states) + noise * rng.standard_normal(states.shape[:2])
    states += state_noise * rng.standard_normal(states.shape)

    trajectories, measured = list(states.swapaxes(0, 1)), list(outputs.T)
    with config_context(transform_output="default"):  # arrays, as f and G take them
        pairs = trajectory_pairs(trajectories, measured)
    return Bunch(
        **pairs,
        trajectories=trajectories,
        outputs=measured,
        f=f,
        G=_output,
        DESCR=_DESCR,
    )


def _stormer_verlet(state: ArrayLike, *, step: float) -> Array:
    """Advance states (..., 2) of momentum and position by one step."""
    momentum, position = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    half = momentum - step / 2 * np.sin(position)
    position = position + step * half
    return np.stack([half - step / 2 * np.sin(position), position], axis=-1)


def _output(state: ArrayLike) -> Array:
    """Output G of the paper for states (..., 2) of momentum and position."""
    momentum, position = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    return np.asarray(1.5 - np.sin(position) + momentum**2 / 9)


def _starts(
    initial: Any, n_trajectories: int | None, rng: np.random.RandomState
) -> Array:
    """Return the (n_trajectories, 2) states where the trajectories begin."""
    if isinstance(initial, str) and initial == "random":
        size = 1 if n_trajectories is None else n_trajectories
        check_integer(size, "n_trajectories", 1)
        amplitude = rng.uniform(0.5, 2.5, size)
        phase = rng.uniform(0, 2 * np.pi, size)
        position = amplitude * np.cos(phase)
        # Rounding may leave the difference below zero at a turning point.
        kinetic = np.maximum(np.cos(position) - np.cos(amplitude), 0)
        momentum = -np.sign(np.sin(phase)) * np.sqrt(2 * kinetic)
        return np.column_stack([momentum, position])
    if isinstance(initial, str) or np.shape(initial)[-1:] != (2,):
        raise ValueError(
            f"initial={initial!r}; pass 'random', (momentum, position), or an array of "
            "shape (n_trajectories, 2)."
        )
    if n_trajectories is not None:
        raise ValueError(
            f"n_trajectories={n_trajectories} goes with initial='random' only; leave "
            "it out, one trajectory begins at each row of initial."
        )
    return check_array(np.atleast_2d(initial), dtype=np.float64, input_name="initial")
