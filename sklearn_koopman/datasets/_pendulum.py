"""The discrete pendulum of the paper's first example."""

from functools import partial
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import Bunch, check_array, check_random_state, check_scalar

from sklearn_koopman.trajectories import trajectory_pairs

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
    r"""Simulate the pendulum of the paper, with its true map and output function.

    A discrete system with known answers: `f` is the Stoermer-Verlet recursion itself
    and not an approximation of it, so that an estimate may be compared with
    ``G(f(x))`` down to rounding.

    Parameters
    ----------
    n_samples : int, default=256
        Number of rows of `X` from each trajectory; one state more is simulated.
    initial : array-like of shape (2,) or (n_trajectories, 2), or "random"
        The (momentum, position) where each trajectory starts, by default (0, 2).
        With "random" the starts are librations of random amplitude and phase:
        pendulums that swing through at most 2.5 rad to either side and never turn
        over.
    n_trajectories : int, default=None
        Number of random starts, with ``initial="random"`` only; None means one.
    step : float, default=0.1
        Time step of the recursion. It is stable up to steps of about 2.
    noise : float, default=0.0
        Standard deviation of Gaussian noise on the measured outputs.
    state_noise : float, default=0.0
        Standard deviation of Gaussian noise on the measured states. Every state is
        measured once: `X_next` of a row and `X` of the following row are equal. The
        motion itself, and the outputs, are those of the undisturbed states.
    random_state : int, RandomState instance or None, default=None
        Seed of random starts and noise. The starts depend neither on `noise` nor on
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
            Trajectory and place on it, as
            :func:`~sklearn_koopman.trajectories.trajectory_pairs` gives them.
        trajectories : list of ndarray of shape (n_samples + 1, 2)
            The measured states by trajectory.
        outputs : list of ndarray of shape (n_samples + 1,)
            The measured outputs by trajectory.
        f, G : callable
            One step of the system and the output, free of noise, for states of shape
            (2,) or (n, 2). Both can be pickled.
        DESCR : str
            What the data are.

    Raises
    ------
    ValueError
        If a number is out of range, if `initial` is neither "random" nor of a shape
        given above, or if `n_trajectories` accompanies given starts.

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
    symplectic and reversible; its orbits lie on closed curves next to those of
    constant energy :math:`(x^{(1)})^2 / 2 - \cos x^{(2)}`, off by
    :math:`O(h^2)`. Another step size therefore means other curves: compare estimates
    on orbits of the same step only.

    Random starts have amplitude :math:`a` uniform on [0.5, 2.5] and phase
    :math:`\varphi` uniform on :math:`[0, 2\pi)`: position :math:`a \cos\varphi` and,
    of the sign of :math:`-\sin\varphi`, momentum
    :math:`\pm\sqrt{2 (\cos x^{(2)} - \cos a)}`.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".

    .. [2] Hairer, Lubich and Wanner (2006), "Geometric Numerical Integration",
       Example I.1.4. Springer.

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
    check_scalar(n_samples, "n_samples", Integral, min_val=1)
    if not 0 < step < np.inf:
        raise ValueError(f"step={step} must be positive and finite; the paper has 0.1.")
    for name, value in (("noise", noise), ("state_noise", state_noise)):
        if not 0 <= value < np.inf:
            raise ValueError(
                f"{name}={value} is no standard deviation; pass a finite number of at "
                "least 0."
            )
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
    return Bunch(
        **trajectory_pairs(trajectories, measured),
        trajectories=trajectories,
        outputs=measured,
        f=f,
        G=_output,
        DESCR=_DESCR,
    )


def _stormer_verlet(state: ArrayLike, *, step: float) -> NDArray[np.float64]:
    """Advance states (..., 2) of momentum and position by one step."""
    momentum, position = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    half = momentum - step / 2 * np.sin(position)
    position = position + step * half
    return np.stack([half - step / 2 * np.sin(position), position], axis=-1)


def _output(state: ArrayLike) -> NDArray[np.float64]:
    """Output G of the paper for states (..., 2) of momentum and position."""
    momentum, position = np.moveaxis(np.asarray(state, dtype=np.float64), -1, 0)
    return np.asarray(1.5 - np.sin(position) + momentum**2 / 9)


def _starts(
    initial: Any, n_trajectories: int | None, rng: np.random.RandomState
) -> NDArray[np.float64]:
    """Return the (n_trajectories, 2) states where the trajectories begin."""
    if not isinstance(initial, str):
        if n_trajectories is not None:
            raise ValueError(
                f"n_trajectories={n_trajectories} goes with initial='random' only; "
                "leave it out, one trajectory begins at each row of initial."
            )
        start = check_array(
            np.atleast_2d(initial), dtype=np.float64, input_name="initial"
        )
        if start.shape[1] != 2:
            raise ValueError(
                f"initial has shape {np.shape(initial)}; pass (momentum, position), "
                "or an array of shape (n_trajectories, 2)."
            )
        return np.asarray(start)
    if initial != "random":
        raise ValueError(
            f"initial={initial!r}; pass 'random', (momentum, position), or an array "
            "of shape (n_trajectories, 2)."
        )
    size = 1 if n_trajectories is None else n_trajectories
    check_scalar(size, "n_trajectories", Integral, min_val=1)
    amplitude = rng.uniform(0.5, 2.5, size)
    phase = rng.uniform(0, 2 * np.pi, size)
    position = amplitude * np.cos(phase)
    # Rounding may leave the difference below zero at a turning point.
    kinetic = np.maximum(np.cos(position) - np.cos(amplitude), 0)
    momentum = -np.sign(np.sin(phase)) * np.sqrt(2 * kinetic)
    return np.column_stack([momentum, position])
