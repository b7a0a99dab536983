"""Radial kernels with known native spaces, as scikit-learn kernels."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.gaussian_process.kernels import (
    Hyperparameter,
    Kernel,
    NormalizedKernelMixin,
    StationaryKernelMixin,
)

from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_integer, check_number

__all__ = [
    "KERNELS",
    "Gaussian",
    "InverseMultiquadric",
    "MaternSobolev",
    "Wendland",
]

T = TypeVar("T")

# Beyond this many scales every profile has decayed, and its polynomial factors still
# fit in a double: inf * 0 = nan would follow from distances that overflow.
FAR = 1e75


class RadialKernel(
    StationaryKernelMixin, NormalizedKernelMixin, Kernel, metaclass=ABCMeta
):
    """Base class of kernels k(x, y) = phi(||x - y|| / beta) with phi(0) = 1.

    A subclass gives :meth:`profile`, the function phi, and :meth:`log_gradient`.
    The kernels add, multiply, clone and tune as all kernels of
    :mod:`sklearn.gaussian_process.kernels` do.

    Parameters
    ----------
    beta : float, default=1.0
        Scale of the kernel, in the unit of the states.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.
    """

    def __init__(
        self, beta: float = 1.0, beta_bounds: tuple[float, float] | str = (1e-5, 1e5)
    ) -> None:
        self.beta = beta
        self.beta_bounds = beta_bounds

    @property
    def hyperparameter_beta(self) -> Hyperparameter:
        """The scale as a hyperparameter, optimised on a logarithmic axis."""
        return Hyperparameter("beta", "numeric", self.beta_bounds)

    @property
    def support_radius(self) -> float:
        """Distance from which on the kernel is zero; infinite unless compact."""
        return np.inf

    @abstractmethod
    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        """Evaluate phi.

        Parameters
        ----------
        r : ndarray
            Distances in units of `beta`. Overwritten where `out` is given, so that no
            further array is needed.
        n_features : int
            Dimension of the space that the distances come from.
        out : ndarray of the shape of `r`, default=None
            Where to write the values.

        Returns
        -------
        phi : ndarray of the shape of `r`
            The values phi(r).
        """

    @abstractmethod
    def log_gradient(self, r: Array, n_features: int) -> Array:
        """Evaluate the derivative of the kernel with respect to log(beta).

        Parameters
        ----------
        r : ndarray
            Distances in units of `beta`; not written to.
        n_features : int
            Dimension of the space that the distances come from.

        Returns
        -------
        gradient : ndarray of the shape of `r`
            The values -r phi'(r).
        """

    @abstractmethod
    def sobolev_order(self, n_features: int) -> float:
        """Order tau of the Sobolev space that the native space equals.

        The Fourier transform of the kernel in R^d decays like
        ``(1 + |w|^2) ** -tau``. Restricted to a manifold of dimension m in R^d, the
        order is ``tau - (d - m) / 2`` (the paper's theorem on restrictions, from
        Fuselier and Wright).

        Parameters
        ----------
        n_features : int
            Dimension d of the ambient space.

        Returns
        -------
        tau : float
            The order; infinite if the decay is faster than any power.
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
        """
        if eval_gradient and Y is not None:
            raise ValueError("The gradient is only defined for Y=None.")
        X = np.atleast_2d(np.asarray(X, dtype=np.float64))
        r = self._scaled_distances(X, Y)
        n_features = X.shape[1]
        K = self.profile(r, n_features)
        if not eval_gradient:
            return K
        if self.hyperparameter_beta.fixed:
            return K, np.empty((*K.shape, 0))
        return K, self.log_gradient(r, n_features)[:, :, np.newaxis]

    def __repr__(self) -> str:
        """Show the scale and, where there are any, the further parameters."""
        shown = ", ".join(
            f"{name}={value:.6g}"
            if isinstance(value, float | np.floating)
            else f"{name}={value!r}"
            for name, value in self.get_params().items()
            if name != "beta_bounds"
        )
        return f"{type(self).__name__}({shown})"

    def _scaled_distances(self, X: Array, Y: ArrayLike | None) -> Array:
        check_number(self.beta, "beta", positive=True)
        # Scaled before the differences are squared: neither huge nor tiny units
        # overflow, and equal rows stay at distance exactly zero.
        X = X / self.beta
        Y = X if Y is None else np.atleast_2d(np.asarray(Y, dtype=float)) / self.beta
        r = cdist(X, Y)
        return np.minimum(r, FAR, out=r)


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
        Smoothness: the native space in R^d is the Sobolev space of order
        nu + d/2.
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
    takes both signs): interpolation with it can fail. This is the Matern function
    that the theory of the paper is about.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".

    Examples
    --------
    >>> from sklearn_koopman.kernels import MaternSobolev
    >>> kernel = MaternSobolev(beta=2.0, nu=1.5)
    >>> kernel([[0.0, 0.0]], [[2.0, 0.0]]).round(4)
    array([[0.4834]])
    >>> kernel.sobolev_order(n_features=2)
    2.5
    """

    # Coefficients of the polynomial factor p, and of p - p', in powers of z: the
    # derivative of p(z) exp(-z) with respect to log(beta) is z (p - p') exp(-z).
    _POLYNOMIALS: dict[float, tuple[tuple[float, ...], tuple[float, ...]]] = {
        0.5: ((1.0,), (1.0,)),
        1.5: ((1.0, 1.0), (0.0, 1.0)),
        2.5: ((1.0, 1.0, 1 / 3), (0.0, 1 / 3, 1 / 3)),
        3.5: ((1.0, 1.0, 2 / 5, 1 / 15), (0.0, 1 / 5, 1 / 5, 1 / 15)),
    }

    def __init__(
        self,
        beta: float = 1.0,
        nu: float = 1.5,
        beta_bounds: tuple[float, float] | str = (1e-5, 1e5),
    ) -> None:
        super().__init__(beta, beta_bounds)
        self.nu = nu

    def profile(self, r: Array, n_features: int, out: Array | None = None) -> Array:
        value, _ = self._polynomials()
        r, out = _arrays(r, out)
        r *= np.sqrt(2 * self.nu)
        _horner(value, r, out)
        np.negative(r, out=r)
        np.exp(r, out=r)
        out *= r
        return out

    def log_gradient(self, r: Array, n_features: int) -> Array:
        _, difference = self._polynomials()
        z = np.sqrt(2 * self.nu) * r
        return z * _horner(difference, z) * np.exp(-z)

    def sobolev_order(self, n_features: int) -> float:
        self._polynomials()
        return self.nu + n_features / 2

    def _polynomials(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return _lookup(self._POLYNOMIALS, self.nu, "nu")


class Wendland(RadialKernel):
    """Wendland kernel: compact support, piecewise polynomial.

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
        takes that of the data, and 3 for fewer features. The data may have fewer
        features than D, not more.
    beta_bounds : pair of floats or "fixed", default=(1e-5, 1e5)
        Bounds of `beta` where it is optimised, as in `GaussianProcessRegressor`.

    See Also
    --------
    MaternSobolev : Kernels of full support with the same Sobolev orders.

    Notes
    -----
    The three polynomials printed in [2]_, Section 4.1, are those of D = 2 and D = 3
    (the second up to the factor 3), and positive definite only for up to three
    features. The polynomials here depend on D and hold in any dimension, at the
    price of a function that falls the steeper, the larger D is: widen `beta` with D.

    The native space in R^d, d <= D, is the Sobolev space of order (d + 1)/2 + k. For
    `smoothness` 0 with d < 3 it is contained in that space.

    References
    ----------
    .. [1] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapter 9.
    .. [2] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".

    Examples
    --------
    >>> from sklearn_koopman.kernels import Wendland
    >>> kernel = Wendland(beta=2.0, smoothness=2)
    >>> kernel([[0.0, 0.0]], [[1.0, 0.0], [2.0, 0.0]])
    array([[0.1875, 0.    ]])
    >>> kernel.support_radius
    2.0
    """

    # Half the smoothness, and the coefficients of q in powers of r, as functions of l.
    _POLYNOMIALS: dict[int, tuple[int, Callable[[int], tuple[float, ...]]]] = {
        0: (0, lambda n: (1.0,)),
        2: (1, lambda n: (1.0, n + 1.0)),
        4: (2, lambda n: (1.0, n + 2.0, (n**2 + 4 * n + 3) / 3)),
        6: (
            3,
            lambda n: (
                1.0,
                n + 3.0,
                (6 * n**2 + 36 * n + 45) / 15,
                (n**3 + 9 * n**2 + 23 * n + 15) / 15,
            ),
        ),
    }

    def __init__(
        self,
        beta: float = 1.0,
        smoothness: int = 2,
        dimension: int | None = None,
        beta_bounds: tuple[float, float] | str = (1e-5, 1e5),
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
        r, out = _arrays(r, out)
        np.minimum(r, 1.0, out=r)
        _horner(q, r, out)
        np.subtract(1.0, r, out=r)
        # By squaring: NumPy's own power of floats is many times as slow.
        while True:
            power, odd = divmod(power, 2)
            if odd:
                out *= r
            if not power:
                return out
            r *= r

    def log_gradient(self, r: Array, n_features: int) -> Array:
        power, q = self._polynomial(n_features)
        slope = tuple(i * c for i, c in enumerate(q))[1:]
        inside = np.minimum(r, 1.0)
        falling = power * _horner(q, inside) - (1 - inside) * _horner(slope, inside)
        return inside * (1 - inside) ** (power - 1) * falling * (r < 1)

    def sobolev_order(self, n_features: int) -> float:
        self._polynomial(n_features)
        return (n_features + 1) / 2 + self.smoothness // 2

    def _polynomial(self, n_features: int) -> tuple[int, tuple[float, ...]]:
        """Return the exponent l + k and the coefficients of q."""
        k, coefficients = _lookup(self._POLYNOMIALS, self.smoothness, "smoothness")
        dimension = max(n_features, 3) if self.dimension is None else self.dimension
        check_integer(dimension, "dimension", 1)
        if dimension < n_features:
            raise ValueError(
                f"Wendland(dimension={dimension}) is not positive definite on "
                f"{n_features} features; set dimension to at least {n_features}, or "
                "to None to take that of the data."
            )
        exponent = dimension // 2 + k + 1
        return exponent + k, coefficients(exponent)


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
    The native space lies in every Sobolev space; the price is the worst conditioning
    of all kernels here. The smallest eigenvalue of the Gram matrix falls
    exponentially with the separation of the centres ([1]_).

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
        r, out = _arrays(r, out)
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
    Positive definite in every dimension, with slow decay: estimates fall back to
    zero only gradually away from the centres. Its Fourier transform decays
    exponentially, so that the native space lies in every Sobolev space ([1]_).

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
        r, out = _arrays(r, out)
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
"""The kernels that estimators know by name; each takes `beta`, which defaults to 1."""


def as_kernel(kernel: Any, beta: float | None, n_features: int | None) -> Kernel:
    """Return the kernel that an estimator's parameters mean, as a copy of its own.

    Parameters
    ----------
    kernel : str or Kernel
        A name in :data:`KERNELS`, or any kernel of scikit-learn's kind.
    beta : float or None
        Replaces the scale of a kernel of this module; None leaves it.
    n_features : int or None
        Dimension for the Wendland kernels that leave theirs open; None where only
        distances are known, which means 3.

    Returns
    -------
    kernel : Kernel
        With `beta` and `dimension` set.
    """
    if isinstance(kernel, str):
        kernel = _lookup(KERNELS, kernel, "kernel")()
    elif isinstance(kernel, Kernel):
        kernel = clone(kernel)
    else:
        raise ValueError(
            f"kernel must be one of {', '.join(KERNELS)}, or a kernel object of "
            f"sklearn_koopman.kernels or sklearn.gaussian_process.kernels, "
            f"got {kernel!r}."
        )
    if beta is not None:
        if not isinstance(kernel, RadialKernel):
            names = ", ".join(f"kernel__{h.name}" for h in kernel.hyperparameters)
            raise ValueError(
                f"beta={beta!r} scales the kernels of sklearn_koopman only; with "
                f"kernel={kernel!r} set beta=None and tune the parameters of the "
                f"kernel itself: {names}."
            )
        kernel.beta = beta
    for part in (kernel, *kernel.get_params().values()):
        if isinstance(part, Wendland) and part.dimension is None:
            part.dimension = max(n_features or 3, 3)
        if isinstance(part, RadialKernel):
            check_number(part.beta, "beta", positive=True)
    return kernel


def _arrays(r: Array, out: Array | None) -> tuple[Array, Array]:
    """Return an array of distances to write to, and one for the values."""
    if out is None:
        return np.array(r, dtype=np.float64), np.empty(np.shape(r))
    return r, out


def _horner(
    coefficients: tuple[float, ...], x: Array, out: Array | None = None
) -> Array:
    """Evaluate the polynomial with these coefficients in rising powers of x."""
    value = np.empty_like(x) if out is None else out
    value[...] = coefficients[-1] if coefficients else 0.0
    for coefficient in coefficients[-2::-1]:
        value *= x
        value += coefficient
    return value


def _lookup(table: dict[Any, T], value: Any, name: str) -> T:
    try:
        return table[value]
    except (KeyError, TypeError):
        choices = ", ".join(str(choice) for choice in table)
        raise ValueError(f"{name} must be one of {choices}, got {value!r}.") from None
