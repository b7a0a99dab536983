"""Radial kernels with known native spaces, as scikit-learn kernels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.polynomial.polynomial import polyder, polysub, polyval
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.gaussian_process.kernels import (
    Hyperparameter,
    Kernel,
    NormalizedKernelMixin,
    StationaryKernelMixin,
)

from ._utils._typing import Array
from ._utils._validation import check_choice, check_integer, check_number

__all__ = [
    "KERNELS",
    "Gaussian",
    "InverseMultiquadric",
    "MaternSobolev",
    "RadialKernel",
    "Wendland",
]

Bounds: TypeAlias = tuple[float, float] | str

# Largest coordinate of a state in units of beta. Up to there the cube of a distance,
# the highest power in any profile, stays within the range of a double.
MAX_SCALED_COORDINATE = 1e70


class RadialKernel(StationaryKernelMixin, NormalizedKernelMixin, Kernel):
    """Base class of kernels k(x, y) = phi(||x - y|| / beta) with phi(0) = 1.

    The function phi is the profile of the kernel. The function k(., c) of the first
    argument, with a centre c, is a kernel section; estimates are sums of sections. The
    native space of a kernel (its reproducing kernel Hilbert space) holds these sums
    and their limits in the native norm, in which the inner product of the sections at
    x and y is k(x, y).

    A kernel of one's own is a subclass with the methods :meth:`profile`,
    :meth:`log_gradient` and :meth:`sobolev_order`. phi must be positive definite in
    the dimension of the states, with phi(0) = 1. A kernel that vanishes from some
    distance on overrides :attr:`support_radius`, too: large Gram matrices are then
    sparse. Further parameters are stored by `__init__` under their own names, as in
    every scikit-learn estimator. Kernels add, multiply, clone and tune as those of
    :mod:`sklearn.gaussian_process.kernels` do.

    Parameters
    ----------
    beta : float, default=1.0
        Scale of the kernel, in the unit of the states.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    MaternSobolev : Kernels whose native spaces are Sobolev spaces.
    Wendland : Kernels of compact support.

    Notes
    -----
    A matrix of n times M kernel values in d dimensions costs O(n M d) time, and memory
    for the n M values.

    Examples
    --------
    The rational quadratic kernel 1 / (1 + r^2):

    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanKernelRegressor
    >>> from sklearn_koopman.kernels import RadialKernel
    >>> class Cauchy(RadialKernel):
    ...     def profile(self, r, n_features, out=None):
    ...         return 1 / (1 + r**2)
    ...
    ...     def log_gradient(self, r, n_features):
    ...         return 2 * r**2 / (1 + r**2) ** 2
    ...
    ...     def sobolev_order(self, n_features):
    ...         return np.inf
    >>> X = np.linspace(0, 3, 7)[:, np.newaxis]
    >>> model = KoopmanKernelRegressor(Cauchy(beta=2.0)).fit(X, np.sin(X[:, 0]))
    >>> model.kernel_
    Cauchy(beta=2)
    >>> model.predict([[1.7]]).round(3)
    array([0.991])
    """

    def __init__(self, beta: float = 1.0, beta_bounds: Bounds = (1e-5, 1e5)) -> None:
        self.beta = beta
        self.beta_bounds = beta_bounds

    @property
    def hyperparameter_beta(self) -> Hyperparameter:
        """The scale as a hyperparameter, optimised on a logarithmic axis."""
        return Hyperparameter("beta", "numeric", self.beta_bounds)

    @property
    def support_radius(self) -> float:
        """Distance from which on the kernel is zero, in the unit of the states.

        Infinite here; kernels of compact support return a multiple of `beta`.
        """
        return np.inf

    @abstractmethod
    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        """Evaluate phi.

        Parameters
        ----------
        r : ndarray
            Distances in units of `beta`, of any shape, from 0 to about 1e70. Only where
            `out` is given may they be overwritten, to save a temporary array.
        n_features : int
            Dimension of the space that the distances come from.
        out : ndarray of the shape of `r`, default=None
            Where the values may be written, to save a new array. A subclass can ignore
            it.

        Returns
        -------
        phi : ndarray of the shape of `r`
            The values phi(r); `out` itself, or a new array.
        """

    @abstractmethod
    def log_gradient(self, r: Array, n_features: int) -> Array:
        """Evaluate the derivative of the kernel with respect to log(beta).

        `GaussianProcessRegressor` uses it to optimise `beta`; the estimators of this
        package do not.

        Parameters
        ----------
        r : ndarray
            Distances in units of `beta`; not to be overwritten.
        n_features : int
            Dimension of the space that the distances come from.

        Returns
        -------
        gradient : ndarray of the shape of `r`
            The values -r phi'(r).
        """

    @abstractmethod
    def sobolev_order(self, n_features: int) -> float:
        """Return the order tau of the Sobolev space that the native space equals.

        The Fourier transform of the kernel in R^d decays like
        ``(1 + |w|^2) ** -tau``. On a manifold of dimension m in R^d the order is
        ``tau - (d - m) / 2`` ([1]_). Expected rates of convergence follow from it.

        Parameters
        ----------
        n_features : int
            Dimension d of the ambient space.

        Returns
        -------
        tau : float
            The order; infinite if the decay is faster than any power.

        References
        ----------
        .. [1] E. Fuselier and G. B. Wright, "Scattered data interpolation on embedded
           submanifolds with restricted positive definite kernels: Sobolev error
           estimates", SIAM Journal on Numerical Analysis 50, 2012.
        """

    def __call__(
        self, X: ArrayLike, Y: ArrayLike | None = None, eval_gradient: bool = False
    ) -> Any:
        """Return the kernel matrix k(X, Y), and optionally its gradient.

        Parameters
        ----------
        X : array-like of shape (n_samples_X, n_features)
            Left argument of the kernel.
        Y : array-like of shape (n_samples_Y, n_features), default=None
            Right argument of the kernel; `X` if None.
        eval_gradient : bool, default=False
            Whether to return the gradient with respect to log(beta) as well. Only
            with `Y` None.

        Returns
        -------
        K : ndarray of shape (n_samples_X, n_samples_Y)
            The kernel matrix.
        K_gradient : ndarray of shape (n_samples_X, n_samples_X, n_dims)
            The gradient, only if `eval_gradient`; n_dims is 0 if `beta` is fixed.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if states exceed 1e70 times `beta`; if
            the gradient is asked for with `Y`.
        """
        if eval_gradient and Y is not None:
            raise ValueError("The gradient is only defined for Y=None.")
        check_beta(self.beta)
        given = [np.array(x, dtype=float, ndmin=2) for x in (X, Y) if x is not None]
        scaled = scale_states(self, *given)
        n_features = scaled[0].shape[1]
        r = cdist(scaled[0], scaled[-1])
        K = self.profile(r, n_features)
        if not eval_gradient:
            return K
        if self.hyperparameter_beta.fixed:
            return K, np.empty((*K.shape, 0))
        return K, self.log_gradient(r, n_features)[:, :, np.newaxis]

    def __repr__(self) -> str:
        """Show the scale and, where there are any, the further parameters."""
        parameters = self.get_params()
        del parameters["beta_bounds"]
        shown = ", ".join(
            f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value!r}"
            for name, value in parameters.items()
        )
        return f"{type(self).__name__}({shown})"


class MaternSobolev(RadialKernel):
    """Matern kernel, whose native space is a Sobolev space.

    With :math:`z = \\sqrt{2 \\nu}\\, \\|x - y\\| / \\beta`,

    .. math:: k(x, y) = p_\\nu(z)\\, e^{-z}, \\quad
        p_{1/2} = 1, \\; p_{3/2} = 1 + z, \\; p_{5/2} = 1 + z + z^2/3, \\;
        p_{7/2} = 1 + z + 2 z^2 / 5 + z^3 / 15 .

    Parameters
    ----------
    beta : float, default=1.0
        Scale of the kernel, in the unit of the states.
    nu : {0.5, 1.5, 2.5, 3.5}, default=1.5
        Smoothness: the native space in R^d (see :class:`RadialKernel`) is the Sobolev
        space of order nu + d/2.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    Wendland : Kernels of compact support.
    sklearn.gaussian_process.kernels.Matern : The same function for any `nu`,
        through Bessel functions where there is no closed form.

    Notes
    -----
    The formula printed in [1]_, Section 4.1, has the *squared* distance in place
    of the distance. That function is not positive definite (its Fourier transform
    takes both signs), so interpolation with it can fail. The formula above is the
    Matern function, to which the theory of the paper applies.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    Examples
    --------
    >>> from sklearn_koopman.kernels import MaternSobolev
    >>> kernel = MaternSobolev(beta=2.0, nu=1.5)
    >>> kernel([[0.0, 0.0]], [[2.0, 0.0]]).round(4)
    array([[0.4834]])
    >>> kernel.sobolev_order(n_features=2)
    2.5
    """

    # Coefficients of the polynomial p in rising powers of z.
    _POLYNOMIALS = {
        0.5: [1.0],
        1.5: [1.0, 1.0],
        2.5: [1.0, 1.0, 1 / 3],
        3.5: [1.0, 1.0, 2 / 5, 1 / 15],
    }

    def __init__(
        self, beta: float = 1.0, nu: float = 1.5, beta_bounds: Bounds = (1e-5, 1e5)
    ) -> None:
        super().__init__(beta, beta_bounds)
        self.nu = nu

    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        p = _look_up(self._POLYNOMIALS, self.nu, "nu")
        r, out = _writable(r, out)
        r *= np.sqrt(2 * self.nu)
        _evaluate_polynomial(p, r, out)
        out *= np.exp(np.negative(r, out=r), out=r)
        return out

    def log_gradient(self, r: Array, n_features: int) -> Array:
        # With respect to log(beta), p(z) exp(-z) has the derivative z (p - p') exp(-z).
        p = _look_up(self._POLYNOMIALS, self.nu, "nu")
        z = np.sqrt(2 * self.nu) * r
        return z * polyval(z, polysub(p, polyder(p))) * np.exp(-z)

    def sobolev_order(self, n_features: int) -> float:
        _look_up(self._POLYNOMIALS, self.nu, "nu")
        return self.nu + n_features / 2


class Wendland(RadialKernel):
    """Wendland kernel, a piecewise polynomial of compact support.

    With :math:`r = \\|x - y\\| / \\beta` and :math:`l = \\lfloor D/2 \\rfloor + k + 1`
    for smoothness :math:`2k` and dimension :math:`D`,

    .. math:: k(x, y) = \\phi_{D,k}(r) = (1 - r)_+^{l+k}\\, q_{l,k}(r)

    with :math:`q_{l,0} = 1`, :math:`q_{l,1} = (l+1) r + 1`,
    :math:`q_{l,2} = [(l^2+4l+3) r^2 + (3l+6) r + 3] / 3` and
    :math:`q_{l,3} = [(l^3+9l^2+23l+15) r^3 + (6l^2+36l+45) r^2 + (15l+45) r + 15]/15`
    ([1]_, Corollary 9.14 there; normalised to :math:`\\phi(0) = 1`).

    Parameters
    ----------
    beta : float, default=1.0
        Scale, which is the radius of the support, in the unit of the states.
    smoothness : {0, 2, 4, 6}, default=2
        How many times the function is continuously differentiable: 2 means C^2.
    dimension : int, default=None
        Largest dimension D in which the function has to be positive definite. None
        means the number of features, at least 3. Data with more than D features are
        refused.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    MaternSobolev : Kernels of full support with the same Sobolev orders.

    Notes
    -----
    The three polynomials printed in [2]_, Section 4.1, are those of D = 2 and D = 3
    (the second up to the factor 3). They are positive definite only for up to three
    features. The polynomials here depend on D and are positive definite in any
    dimension. The function falls more steeply for larger D, so raise `beta` with D.

    The native space in R^d, d <= D, is the Sobolev space of order (d + 1)/2 + k. For
    `smoothness` 0 with d < 3 it is contained in that space.

    References
    ----------
    .. [1] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapter 9.
    .. [2] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    Examples
    --------
    >>> from sklearn_koopman.kernels import Wendland
    >>> kernel = Wendland(beta=2.0, smoothness=2)
    >>> kernel([[0.0, 0.0]], [[1.0, 0.0], [2.0, 0.0]])
    array([[0.1875, 0.    ]])
    >>> kernel.support_radius
    2.0
    """

    # Coefficients of q in rising powers of r, up to a factor. Each of them is a
    # polynomial in l, whose own coefficients are in rising powers of l.
    _POLYNOMIALS = {
        0: [[1]],
        2: [[1], [1, 1]],
        4: [[3], [6, 3], [3, 4, 1]],
        6: [[15], [45, 15], [45, 36, 6], [15, 23, 9, 1]],
    }

    def __init__(
        self,
        beta: float = 1.0,
        smoothness: int = 2,
        dimension: int | None = None,
        beta_bounds: Bounds = (1e-5, 1e5),
    ) -> None:
        super().__init__(beta, beta_bounds)
        self.smoothness = smoothness
        self.dimension = dimension

    @property
    def support_radius(self) -> float:
        """Distance from which on the kernel is zero: `beta`."""
        return self.beta

    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        power, q = self._polynomial(n_features)
        r, out = _writable(r, out)
        np.minimum(r, 1.0, out=r)
        _evaluate_polynomial(q, r, out)
        np.subtract(1.0, r, out=r)
        # By repeated squaring: NumPy's power of floats is many times slower.
        while True:
            power, odd = divmod(power, 2)
            if odd:
                out *= r
            if not power:
                return out
            r *= r

    def log_gradient(self, r: Array, n_features: int) -> Array:
        power, q = self._polynomial(n_features)
        inside = np.minimum(r, 1.0)
        slope = polyval(inside, polyder(q))
        falling = power * polyval(inside, q) - (1 - inside) * slope
        return inside * (1 - inside) ** (power - 1) * falling * (r < 1)

    def sobolev_order(self, n_features: int) -> float:
        self._polynomial(n_features)
        return (n_features + 1) / 2 + self.smoothness // 2

    def _polynomial(self, n_features: int) -> tuple[int, list[float]]:
        """Return the exponent l + k and the coefficients of q."""
        table = _look_up(self._POLYNOMIALS, self.smoothness, "smoothness")
        dimension = max(n_features, 3) if self.dimension is None else self.dimension
        check_integer(dimension, "dimension", 1)
        if dimension < n_features:
            raise ValueError(
                f"dimension={dimension} of a Wendland kernel is too small for "
                f"{n_features} features; set it to at least {n_features}, or to None."
            )
        k = self.smoothness // 2
        exponent = dimension // 2 + k + 1
        q = [sum(c * exponent**i for i, c in enumerate(powers)) for powers in table]
        return exponent + k, [coefficient / q[0] for coefficient in q]


class Gaussian(RadialKernel):  # numpydoc ignore=PR02
    """Gaussian kernel.

    .. math:: k(x, y) = \\exp(-\\|x - y\\|^2 / (2 \\beta^2)),

    the limit of :class:`MaternSobolev` for nu to infinity.

    Parameters
    ----------
    beta : float, default=1.0
        Scale of the kernel, in the unit of the states.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    sklearn.gaussian_process.kernels.RBF : The same function, with one scale a
        feature if wanted.

    Notes
    -----
    The native space (see :class:`RadialKernel`) lies in every Sobolev space. In return,
    the Gram matrix is the worst conditioned of all kernels here: its smallest
    eigenvalue falls exponentially as the centres move closer together ([1]_).

    References
    ----------
    .. [1] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapters 6 and 12.

    Examples
    --------
    >>> from sklearn_koopman.kernels import Gaussian
    >>> Gaussian(beta=1.0)([[0.0]], [[1.0]]).round(4)
    array([[0.6065]])
    """

    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        r, out = _writable(r, out)
        r *= r
        r *= -0.5
        return np.exp(r, out=out)

    def log_gradient(self, r: Array, n_features: int) -> Array:
        return r**2 * np.exp(-0.5 * r**2)

    def sobolev_order(self, n_features: int) -> float:
        return np.inf


class InverseMultiquadric(RadialKernel):  # numpydoc ignore=PR02
    """Inverse multiquadric kernel.

    .. math:: k(x, y) = (1 + \\|x - y\\|^2 / \\beta^2)^{-1/2} .

    Parameters
    ----------
    beta : float, default=1.0
        Scale of the kernel, in the unit of the states.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    sklearn.gaussian_process.kernels.RationalQuadratic : The same function for its
        `alpha` of 0.5.

    Notes
    -----
    The function is positive definite in every dimension. It decays slowly, so that
    estimates fall back to zero only gradually away from the centres. Its Fourier
    transform decays exponentially, and hence the native space (see
    :class:`RadialKernel`) lies in every Sobolev space ([1]_).

    References
    ----------
    .. [1] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapters 6 and 12.

    Examples
    --------
    >>> from sklearn_koopman.kernels import InverseMultiquadric
    >>> InverseMultiquadric(beta=1.0)([[0.0]], [[1.0]]).round(4)
    array([[0.7071]])
    """

    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        r, out = _writable(r, out)
        r *= r
        r += 1.0
        np.sqrt(r, out=r)
        return np.divide(1.0, r, out=out)

    def log_gradient(self, r: Array, n_features: int) -> Array:
        return r**2 / (1 + r**2) ** 1.5

    def sobolev_order(self, n_features: int) -> float:
        return np.inf


KERNELS: dict[str, Callable[..., RadialKernel]] = {
    "matern12": partial(MaternSobolev, nu=0.5),
    "matern32": partial(MaternSobolev, nu=1.5),
    "matern52": partial(MaternSobolev, nu=2.5),
    "wendland_c0": partial(Wendland, smoothness=0),
    "wendland_c2": partial(Wendland, smoothness=2),
    "wendland_c4": partial(Wendland, smoothness=4),
    "wendland_c6": partial(Wendland, smoothness=6),
    "gaussian": Gaussian,
    "inverse_multiquadric": InverseMultiquadric,
}
"""The kernels that estimators accept by name; each takes `beta`, by default 1."""


def as_kernel(
    kernel: Any,
    beta: float | str | None,
    n_features: int | None,
    spread: float | None = None,
) -> Kernel:
    """Return a new kernel object for the parameters `kernel` and `beta`.

    Parameters
    ----------
    kernel : str or Kernel
        A name in :data:`KERNELS`, or any kernel of scikit-learn's kind.
    beta : float, "scale" or None
        Replaces the scale of a kernel of this module; None leaves it. "scale" stands
        for `spread` where the kernel is given by name, and else for None.
    n_features : int or None
        Dimension for the Wendland kernels that leave theirs open; None where only
        distances are known, which means 3.
    spread : float, default=None
        How far the states spread; None where they are not known.

    Returns
    -------
    kernel : Kernel
        With `beta` and `dimension` set.

    Raises
    ------
    ValueError
        If `kernel` is no kernel, `beta` is no positive number, or `beta` is given for a
        kernel of another module; if `beta` stands for a spread that is not known.
    """
    is_named = isinstance(kernel, str) and kernel in KERNELS
    if is_named:
        kernel = KERNELS[kernel]()
    elif isinstance(kernel, Kernel):
        kernel = clone(kernel)
    else:
        raise ValueError(
            f"kernel must be one of {', '.join(KERNELS)}, or a kernel object of this "
            f"package or of sklearn.gaussian_process.kernels, got {kernel!r}."
        )
    if isinstance(beta, str):
        if beta != "scale":
            raise ValueError(
                f"beta must be a finite positive number, 'scale' or None, got {beta!r}."
            )
        if is_named and spread is None:
            raise ValueError(
                "beta='scale' is the spread of the states, which are not known here; "
                "set beta to a number in their unit, such as the square root of the "
                "sum of the variances of the features."
            )
        beta = spread if is_named else None
    if beta is not None:
        if not isinstance(kernel, RadialKernel):
            names = ", ".join(f"kernel__{h.name}" for h in kernel.hyperparameters)
            raise ValueError(
                f"beta={beta!r} scales the kernels of sklearn_koopman only; with "
                f"kernel={kernel!r} set beta='scale' or beta=None and tune {names}."
            )
        kernel.beta = beta
    for part in (kernel, *kernel.get_params().values()):
        if isinstance(part, Wendland) and part.dimension is None:
            part.dimension = max(n_features or 3, 3)
        if isinstance(part, RadialKernel):
            check_beta(part.beta)
    return kernel


def is_isotropic(kernel: Kernel) -> bool:
    """Tell whether a kernel is a function of the distance.

    Parameters
    ----------
    kernel : Kernel
        Any kernel of scikit-learn's kind.

    Returns
    -------
    is_isotropic : bool
        False for kernels that are not stationary or have a scale for each feature.
    """
    if not kernel.is_stationary():
        return False
    try:
        kernel(np.zeros((1, 1)), np.zeros((1, 1)))
    except ValueError:  # one scale for each of several features
        return False
    return True


def check_beta(beta: Any) -> None:
    """Refuse a scale that is no finite positive number.

    Parameters
    ----------
    beta : object
        The scale.
    """
    # This runs for every kernel matrix. Floats, the usual case, need no further look.
    if not (isinstance(beta, float) and 0 < beta < np.inf):
        check_number(beta, "beta", positive=True)


def scale_states(kernel: RadialKernel, *states: Array) -> list[Array]:
    """Divide states, or distances of states, by the scale of a kernel.

    States are scaled before their differences are squared. Then neither huge nor tiny
    units overflow, and equal rows stay at distance exactly zero.

    Parameters
    ----------
    kernel : RadialKernel
        The kernel; its `beta` has been checked.
    *states : ndarrays
        States or distances.

    Returns
    -------
    scaled : list of ndarrays
        New arrays, the states in units of `beta`.

    Raises
    ------
    ValueError
        If an entry exceeds 1e70 times beta: a profile could overflow at such distances.
    """
    largest = float(max(max(X.max(initial=0), -X.min(initial=0)) for X in states))
    if largest / float(kernel.beta) > MAX_SCALED_COORDINATE:
        raise ValueError(
            f"X has values up to {largest:.3g}, above {MAX_SCALED_COORDINATE} times "
            f"beta={kernel.beta:.3g}; rescale the states, or raise beta."
        )
    return [X / kernel.beta for X in states]


def radial_values(kernel: RadialKernel, r: Array, n_features: int, out: Array) -> None:
    """Write the values of a radial kernel at scaled distances.

    Parameters
    ----------
    kernel : RadialKernel
        The kernel.
    r : ndarray
        Distances of states from :func:`scale_states`, which are overwritten.
    n_features : int
        Dimension of the space that the distances come from.
    out : ndarray of the shape of `r`
        Where to write the values.
    """
    values = kernel.profile(r, n_features, out)
    if values is not out:  # the profile of a subclass may ignore `out`
        out[...] = values


def _writable(r: Array, out: Array | None) -> tuple[Array, Array]:
    """Return an array of distances to write to, and one for the values."""
    if out is None:
        return np.array(r, dtype=np.float64), np.empty(np.shape(r))
    return r, out


def _evaluate_polynomial(coefficients: list[float], x: Array, out: Array) -> None:
    """Evaluate in place the polynomial with these coefficients in rising powers."""
    out[...] = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        out *= x
        out += coefficient


def _look_up(table: dict[Any, Any], value: Any, name: str) -> Any:
    if not isinstance(value, Real) or value not in table:
        check_choice(value, name, table)
    return table[value]
