"""Condition of Gram matrices, and the digits that it costs."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.linalg import cholesky, eigvalsh
from scipy.linalg.blas import dsymv
from scipy.linalg.lapack import dpotrs
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh
from sklearn.utils import check_array

from .._matrices._sections import KernelSections, gram_matrix
from .._utils._typing import Array
from .._utils._validation import check_number, refuse_masked
from ..kernels import as_kernel


def condition_number(
    kernel: Any, centers: Any, *, beta: float | None = None, alpha: float = 0.0
) -> float:
    """Compute the condition number of the Gram matrix of a kernel at centres.

    The Gram matrix K holds the kernel of all pairs of centres :math:`\\Xi`. Its
    condition number is the ratio of its largest and its smallest eigenvalue:

    .. math:: \\operatorname{cond}(K) = \\lambda_{\\max}(K) / \\lambda_{\\min}(K),
        \\quad K = k(\\Xi, \\Xi) + \\alpha I

    Parameters
    ----------
    kernel : str or Kernel
        As for :class:`~sklearn_koopman.KoopmanKernelRegressor`. The `kernel_` and the
        `centers_` of a fitted one can be given here.
    centers : array-like of shape (n_centers, n_features)
        The centres.
    beta : float, default=None
        Scale of the kernel. None keeps the scale of a kernel object, and means 1 for a
        name, since centres do not tell the spread of the data.
    alpha : float, default=0.0
        The number that is added to the diagonal.

    Returns
    -------
    condition_number : float
        The ratio of the eigenvalues; infinite if the smallest one is not above
        rounding error.

    Raises
    ------
    ValueError
        If a parameter is outside its range.

    See Also
    --------
    digits_lost : What the number means for the coefficients.
    conditioning_study : The numbers of several kernels, scales and separations.

    Notes
    -----
    For up to 1,500 centres all eigenvalues are computed. For more, the largest
    eigenvalues of the matrix and of its inverse are found to three digits or better by
    the Lanczos method, with a Cholesky factor for the inverse. Where that fails, all
    eigenvalues are computed, which takes several times as long. The time is
    O(n_centers^3), the memory one or two matrices of n_centers^2 numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.diagnostics import condition_number
    >>> centers = np.linspace(0, 1, 10).reshape(-1, 1)
    >>> smooth = condition_number("matern52", centers)
    >>> rough = condition_number("matern12", centers)
    >>> bool(smooth > 1000 * rough)
    True
    """
    smallest, largest = extreme_eigenvalues(kernel, centers, beta, alpha)
    return largest / smallest if smallest > 0 else np.inf


def smallest_eigenvalue(
    kernel: Any, centers: Any, *, beta: float | None = None, alpha: float = 0.0
) -> float:
    """Compute the smallest eigenvalue of the Gram matrix of a kernel at centres.

    For a kernel of Sobolev order tau in R^d (:func:`sobolev_rates`) the eigenvalue is
    bounded from below by a constant times the power ``2 tau - d`` of the separation
    distance ([1]_). On an m-dimensional manifold in R^d the power is the same, because
    the order there is s = tau - (d - m) / 2, so that ``2 s - m = 2 tau - d``.

    Parameters
    ----------
    kernel : str or Kernel
        As for :func:`condition_number`.
    centers : array-like of shape (n_centers, n_features)
        The centres.
    beta : float, default=None
        Scale of the kernel.
    alpha : float, default=0.0
        The number that is added to the diagonal.

    Returns
    -------
    smallest_eigenvalue : float
        The eigenvalue, in the unit of the kernel. Zero if it is below rounding error,
        which is ``eps * sqrt(n_centers)`` times the largest eigenvalue. Negative if
        the kernel is not positive definite.

    Raises
    ------
    ValueError
        If a parameter is outside its range.

    References
    ----------
    .. [1] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapter 12.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import smallest_eigenvalue
    >>> round(smallest_eigenvalue("gaussian", [[0.0], [1.0]]), 4)  # 1 - exp(-1/2)
    0.3935
    """
    return extreme_eigenvalues(kernel, centers, beta, alpha)[0]


def digits_lost(condition_number: Any) -> Any:
    """Compute how many of 16 digits the coefficients lose by a Gram matrix.

    If a matrix K and values have relative errors e, then the coefficients computed from
    them have relative errors of up to cond(K) times e ([1]_, bound on the numerical
    stability). So the coefficients have log10 cond(K) digits less than the data.
    Predictions lose fewer digits, because the errors of the coefficients largely cancel
    in them.

    Parameters
    ----------
    condition_number : float or array-like
        One or several condition numbers.

    Returns
    -------
    digits : float or ndarray
        The decimal digits lost, from 0 to 16; at 16 no digit is left.

    Raises
    ------
    ValueError
        If a number is below 1.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022, Section 4.1.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import digits_lost
    >>> round(digits_lost(1e6), 10)
    6.0
    """
    numbers = np.asarray(condition_number, dtype=np.float64)
    if not (numbers >= 1).all():
        raise ValueError(f"condition_number must be >= 1, got {condition_number!r}.")
    digits = np.minimum(np.log10(numbers), -np.log10(np.finfo(np.float64).eps))
    return digits if digits.ndim else float(digits)


def extreme_eigenvalues(
    kernel: Any,
    centers: Any,
    beta: float | None = None,
    alpha: float = 0.0,
    *,
    max_dense: int = 1500,
) -> tuple[float, float]:
    """Compute the smallest and the largest eigenvalue of a Gram matrix.

    Parameters
    ----------
    kernel : str or Kernel
        As for :func:`condition_number`.
    centers : array-like of shape (n_centers, n_features)
        The centres.
    beta : float, default=None
        Scale of the kernel.
    alpha : float, default=0.0
        The number that is added to the diagonal.
    max_dense : int, default=1500
        Up to this many centres all eigenvalues are computed.

    Returns
    -------
    smallest : float
        The smallest eigenvalue; zero if it is below rounding error.
    largest : float
        The largest eigenvalue.
    """
    check_number(alpha, "alpha")
    refuse_masked(centers=centers)
    points = check_array(centers, dtype=np.float64, input_name="centers")
    n = len(points)
    resolved = as_kernel(kernel, beta, points.shape[1])
    K, _, norm = gram_matrix(KernelSections(resolved, points), np.full(n, alpha))
    if not np.isfinite(norm):
        raise ValueError(
            f"kernel={resolved!r} has values that are not finite on these centres; "
            "rescale them, or take another kernel."
        )
    smallest, largest = _extremes(K, max_dense)
    rounding = float(np.finfo(np.float64).eps * np.sqrt(n)) * largest
    return smallest if abs(smallest) > rounding else 0.0, largest


def _extremes(K: Array, max_dense: int) -> tuple[float, float]:
    """Return the extreme eigenvalues of a matrix given by its lower triangle."""
    n = len(K)
    # Not for matrices without a Cholesky factor, or where Lanczos does not converge.
    if n > max_dense:
        with suppress(np.linalg.LinAlgError, ArpackNoConvergence):
            largest = _largest(lambda x: dsymv(1.0, K, x, lower=1), n)
            factor = cholesky(K, lower=True, check_finite=False)
            inverse = _largest(lambda x: dpotrs(factor, x, lower=1)[0].ravel(), n)
            return 1 / inverse, largest
    values = eigvalsh(K, check_finite=False)
    return float(values[0]), float(values[-1])


def _largest(product: Callable[[Array], Array], n: int) -> float:
    """Return the largest eigenvalue of a matrix by the Lanczos method."""
    operator = LinearOperator((n, n), lambda x: product(x.ravel()), dtype=np.float64)
    # Any start but an eigenvector will do; a fixed one makes results repeatable. The
    # tolerance is that of the eigenvector: the eigenvalue is far more accurate.
    start = np.random.RandomState(0).standard_normal(n)
    options: dict[str, Any] = {"k": 1, "which": "LA", "v0": start}
    options |= {"maxiter": 50, "tol": 1e-3, "return_eigenvectors": False}
    return float(eigsh(operator, **options)[0])
