"""Cholesky factorisations of Gram matrices, and what their factors say."""

from contextlib import nullcontext

import numpy as np
from scipy.linalg import lapack

from .._matrices._sections import Sections, gram_matrix
from .._utils._parallel import one_thread
from .._utils._typing import Array, Indices

# A factorisation that succeeds below this reciprocal condition number succeeds by
# chance, and the last rows of its factor mean nothing.
MIN_RCOND = 1e-17
# Below this reciprocal condition number, solutions are verified.
RCOND_TO_VERIFY = 1e-10
# Random vectors in the cheap estimate of the reciprocal condition number.
PROBES = 4
# From this size on, in bytes, the factorisation by several threads of OpenBLAS ends in
# a segmentation fault (seen with its 32-bit integers in SciPy 1.11 to 1.17).
MAX_BYTES_FOR_THREADS = 2**31


def cholesky(K: Array, *, lower: bool = True) -> Array:
    """Factor one triangle of a matrix in place, and leave the other as it is.

    Raises
    ------
    LinAlgError
        If the matrix is not numerically positive definite.
    """
    with one_thread() if K.nbytes >= MAX_BYTES_FOR_THREADS else nullcontext():
        factor, info = lapack.dpotrf(K, lower=int(lower), clean=0, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return factor


def exact_rcond(factor: Array, norm: float, *, lower: bool = True) -> float:
    """Estimate the reciprocal condition number in the 1-norm from a Cholesky factor."""
    return float(lapack.dpocon(factor, norm, uplo="L" if lower else "U")[0])


def factorize(K: Array, norm: float) -> tuple[Array, float]:
    """Factor a Gram matrix with this 1-norm in place, if it is not singular.

    Returns
    -------
    lower : ndarray of shape (M, M)
        The factor.
    rough_rcond : float
        Its reciprocal condition number, from a cheap estimate where that is not below
        `RCOND_TO_VERIFY`.

    Raises
    ------
    LinAlgError
        If the matrix is not numerically positive definite.
    """
    lower = cholesky(K)
    rough_rcond = probe_rcond(lower, norm)
    if rough_rcond < RCOND_TO_VERIFY:
        rough_rcond = exact_rcond(lower, norm)
    if not rough_rcond >= MIN_RCOND:
        raise np.linalg.LinAlgError("the Gram matrix is numerically singular")
    return lower, rough_rcond


def probe_rcond(lower: Array, norm: float) -> float:
    """Estimate the reciprocal condition number from random vectors, in O(M^2).

    For K = L L^T and a standard normal vector r, |K^-1 r|^2 is the squared Frobenius
    norm of K^-1 on average, which is at least the squared 2-norm. The mean of four is
    less than a hundredth of that once in 5,000 draws, a factor of ten in the norm. The
    pivots of L cost nothing, but can be 1e12 times too optimistic.
    """
    probes = np.random.default_rng(0).standard_normal((PROBES, len(lower))).T
    images, _ = lapack.dpotrs(lower, probes, lower=1)
    # Not by NumPy's BLAS, whose idle threads would slow down those of SciPy's.
    squared = np.einsum("ij,ij->", images, images)
    return float(np.sqrt(PROBES / squared) / norm)


def pivot_rcond(pivots: Array) -> float:
    """Bound the reciprocal condition number from above, in O(M)."""
    smallest, largest = float(pivots.min()), float(pivots.max())
    return (smallest / largest) ** 2


def independent_centers(sections: Sections, nugget: Array, tolerance: float) -> Indices:
    """Return the centres that a pivoted Cholesky factorisation keeps, in order.

    Raises
    ------
    ValueError
        If dropping centres cannot help.
    """
    K, _, norm = gram_matrix(sections, nugget)
    if not np.isfinite(norm):
        raise ValueError(
            f"kernel={sections.kernel!r} has values that are not finite on these "
            "states; rescale them, or take another kernel."
        )
    diagonal = K.diagonal().copy()
    largest = float(diagonal.max())
    F, pivots, rank, _ = lapack.dpstrf(
        K, tol=tolerance * largest, lower=1, overwrite_a=1
    )
    rank = max(rank, 1)
    order = pivots - 1
    # What the kept centres leave of the others is zero up to rounding, or else the
    # matrix has negative eigenvalues that no choice of centres mends.
    remainder = diagonal[order[rank:]] - np.square(F[rank:, :rank]).sum(axis=1)
    limit = max(tolerance, 1e-10) * largest
    if largest <= 0 or np.abs(remainder).max(initial=0.0) > limit:
        raise ValueError(
            f"kernel={sections.kernel!r} is not positive definite on these states; "
            "rescale them, or take another kernel."
        )
    return np.sort(order[:rank]).astype(np.intp)


def rows_per_block(n_centers: int) -> int:
    """Return how many rows to take at once: a triangular solve reads all the factor."""
    return min(max(2**18 // n_centers, n_centers // 16, 1), 2**13)
