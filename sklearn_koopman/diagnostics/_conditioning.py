"""How many digits a Gram matrix costs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.linalg import cholesky, eigvalsh
from scipy.linalg.blas import dsymv
from scipy.linalg.lapack import dpotrs
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh
from sklearn.utils import check_array

from sklearn_koopman._matrices._sections import KernelSections, gram_matrix
from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_number
from sklearn_koopman.kernels import as_kernel

# Up to this many centres all eigenvalues are computed.
DENSE = 1500


def condition_number(
    kernel: Any,
    centers: Any,
    *,
    beta: float | None = None,
    alpha: float = 0.0,
) -> float:
    """Compute the condition number of the Gram matrix of a kernel at centres.

    .. math:: \\operatorname{cond}(K) = \\lambda_{\\max}(K) / \\lambda_{\\min}(K),
        \\quad K = k(\\Xi, \\Xi) + \\alpha I

    Parameters
    ----------
    kernel : str or Kernel
        As for :class:`~sklearn_koopman.KoopmanKernelRegressor`, whose `kernel_` and
        `centers_` can be given here once it is fitted.
    centers : array-like of shape (n_centers, n_features)
        The centres.
    beta : float, default=None
        Scale of the kernel; None leaves that of the kernel object, and means 1 for a
        name.
    alpha : float, default=0.0
        What is added to the diagonal.

    Returns
    -------
    condition_number : float
        The ratio of the eigenvalues; infinite where the smallest one is not positive,
        or double precision does not tell it from zero.

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
    From all eigenvalues of up to 1,500 centres; of more, to three digits or better, by
    the Lanczos method for the largest one and for that of the inverse, through a
    Cholesky factor. Where that fails, by a reduction to tridiagonal form, which takes
    several times as long.

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
    kernel: Any,
    centers: Any,
    *,
    beta: float | None = None,
    alpha: float = 0.0,
) -> float:
    """Compute the smallest eigenvalue of the Gram matrix of a kernel at centres.

    For a kernel of Sobolev order tau in R^d it is bounded below by a constant times
    the power ``2 tau - d`` of the separation distance ([1]_), on an m-dimensional
    manifold in R^d as well: the order there, s = tau - (d - m) / 2, gives the same
    power ``2 s - m``.

    Parameters
    ----------
    kernel : str or Kernel
        As for :func:`condition_number`.
    centers : array-like of shape (n_centers, n_features)
        The centres.
    beta : float, default=None
        Scale of the kernel.
    alpha : float, default=0.0
        What is added to the diagonal.

    Returns
    -------
    smallest_eigenvalue : float
        The eigenvalue; zero where double precision does not tell it from zero, which
        is below ``eps * sqrt(n_centers)`` times the largest one. Negative if the
        kernel is not positive definite.

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
    """Tell how many of the 16 digits of the coefficients a Gram matrix costs.

    Coefficients computed from a matrix and values with relative errors e are off by up
    to cond(K) times e ([1]_, bound on the numerical stability): log10 of the condition
    number is how many digits the coefficients have less than the data. Predictions
    lose fewer, since the errors of the coefficients largely cancel.

    Parameters
    ----------
    condition_number : array-like
        The condition number, or many.

    Returns
    -------
    digits : float or ndarray
        Between 0 and 16, which is none left.

    Raises
    ------
    ValueError
        If a number is below 1.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds", Section 4.1.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import digits_lost
    >>> round(digits_lost(1e6), 10)
    6.0
    """
    numbers = np.asarray(condition_number, dtype=np.float64)
    if not (numbers >= 1).all():
        raise ValueError(
            f"condition_number must be 1 or more, got {condition_number!r}."
        )
    digits = np.minimum(np.log10(numbers), -np.log10(np.finfo(np.float64).eps))
    return digits if digits.ndim else float(digits)


def extreme_eigenvalues(
    kernel: Any, centers: Any, beta: float | None = None, alpha: float = 0.0
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
        What is added to the diagonal.

    Returns
    -------
    smallest : float
        The smallest eigenvalue; zero where rounding does not tell it from zero.
    largest : float
        The largest.
    """
    check_number(alpha, "alpha")
    points = check_array(centers, dtype=np.float64, input_name="centers")
    resolved = as_kernel(kernel, beta, points.shape[1])
    K, _, norm = gram_matrix(
        KernelSections(resolved, points), points, np.full(len(points), alpha)
    )
    if not np.isfinite(norm):
        raise ValueError(
            f"kernel={resolved!r} has values that are not finite on these centres; "
            "rescale them, or take another kernel."
        )
    return _extremes(K)


def _extremes(K: Array) -> tuple[float, float]:
    """Return the extreme eigenvalues of a matrix given by its lower triangle."""
    n = len(K)
    if n <= DENSE:
        values = eigvalsh(K, check_finite=False)
        return _told(float(values[0]), float(values[-1]), n)
    largest = _largest(lambda x: dsymv(1.0, K, x, lower=1), n)
    if largest is None:
        largest = float(
            eigvalsh(K, subset_by_index=[n - 1, n - 1], check_finite=False)[0]
        )
    inverse = None
    with suppress(np.linalg.LinAlgError):
        factor = cholesky(K, lower=True, check_finite=False)
        inverse = _largest(lambda x: dpotrs(factor, x, lower=1)[0].ravel(), n)
    if inverse is None:  # not positive definite, or without an end to its spectrum
        smallest = float(eigvalsh(K, subset_by_index=[0, 0], check_finite=False)[0])
    else:
        smallest = 1 / inverse
    return _told(smallest, largest, n)


def _told(smallest: float, largest: float, n: int) -> tuple[float, float]:
    """Take the smallest eigenvalue for zero where rounding does not tell it from it."""
    unit = float(np.finfo(np.float64).eps * np.sqrt(n))
    return smallest if abs(smallest) > unit * largest else 0.0, largest


def _largest(product: Callable[[Array], Array], n: int) -> float | None:
    """Return the largest eigenvalue by the Lanczos method; None if it is not found."""
    operator = LinearOperator(
        (n, n), matvec=lambda x: product(x.ravel()), dtype=np.float64
    )
    # Any start but an eigenvector will do; a fixed one makes results repeatable. The
    # error of an eigenvalue is far below the tolerance, which is that of its vector.
    start = np.random.RandomState(0).standard_normal(n)
    try:
        found = eigsh(
            operator,
            k=1,
            which="LA",
            v0=start,
            maxiter=50,
            tol=1e-3,
            return_eigenvectors=False,
        )
    except ArpackNoConvergence:
        return None
    return float(found[0])
