"""Estimates in the span of the kernel sections: pure functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm, dnrm2
from scipy.linalg.lapack import dpocon, dpotrf, dpotri, dpotrs, dpstrf
from sklearn.utils import gen_batches

from sklearn_koopman._native import (
    NativeBasis,
    Tail,
    block_rows,
    polynomial,
    solve_triangular,
)
from sklearn_koopman._sections import Sections, gram_matrix, product

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# The loop of least squares stays with SciPy's BLAS: NumPy's wheels bring one of their
# own, and the idle threads of either slow down the other several times.

# Below this reciprocal condition number a solution is verified before it is used.
SUSPECT = 1e-10
# Largest error, relative to the values to be met, that passes the verification. Large
# coefficients of alternating sign cost smooth kernels this much without harm, while
# leaving out more centres would cost them more.
ACCURACY = 1e-6


class UnsuitableKernelError(ValueError):
    """The kernel has no Gram matrix that an estimate could be made with."""


AnyBasis = TypeVar("AnyBasis")  # of dense matrices, or without them


@dataclass(frozen=True)
class Solution(Generic[AnyBasis]):
    """Coefficients of an estimate and the basis that they were computed in."""

    basis: AnyBasis
    kept: Indices  # which of the centres offered carry the estimate
    dual: Array  # (M, n_outputs)
    trend: Array  # (n_terms, n_outputs), of the monomials of the tail
    seminorm: Array  # (n_outputs,): native norm of the estimate, trend not counted
    freedom: float  # effective number of parameters
    error: float  # how far it is from the values it should have, where that is suspect


Rule = Callable[[NativeBasis, Indices], Solution[NativeBasis]]


def interpolation(points: Array, u: Array) -> Rule:
    """Rule that interpolates u at the centres; meets u - E c with an excess E."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution[NativeBasis]:
        v = solve_triangular(basis.lower, u[kept])
        b = basis.Q.T @ v
        z = v - basis.Q @ b
        dual, trend = basis.coefficients(z, b)
        error = 0.0
        if basis.rcond < SUSPECT:
            reached = evaluate(basis.sections, basis.tail, points[kept], dual, trend)
            reached += basis.excess[:, np.newaxis] * dual
            error = _relative_error(reached, u[kept])
        return Solution(
            basis, kept, dual, trend, column_norms(z), len(basis.lower), error
        )

    return solve


def regression(X: Array, y: Array, alpha: float) -> Rule:
    """Rule that fits y on all rows of X by least squares."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution[NativeBasis]:
        z, b, freedom = least_squares(basis, X, y.__getitem__, y.shape[1], alpha)
        dual, trend = basis.coefficients(z, b)
        error = 0.0
        if basis.rcond < SUSPECT:
            rows = X[:: max(len(X) // 64, 1)]
            a, t = basis.design(rows)
            reached = evaluate(basis.sections, basis.tail, rows, dual, trend)
            error = _relative_error(reached, a.T @ z + t.T @ b)
        return Solution(basis, kept, dual, trend, column_norms(z), freedom, error)

    return solve


def least_squares(
    basis: NativeBasis,
    X: Array,
    y: Callable[[slice], Array],
    n_outputs: int,
    alpha: float,
) -> tuple[Array, Array, float]:
    """Minimise |y - g(X)|^2 + alpha |g|_H^2 over the functions of the basis.

    `y` gives the values for a slice of the rows, so that many need not be held at
    once. With the values A of a(x), less their part along Q, and T of all polynomials
    on the rows, the normal equations are

        [A A^T + alpha I   A T^T] [z]   [A y]
        [    T A^T         T T^T] [b] = [T y]

    of which z is eliminated. A A^T is accumulated and factored in the triangle that
    the Cholesky factor of the basis leaves unused: memory stays at one M x M matrix.

    Returns
    -------
    z : ndarray of shape (M, n_outputs)
        Coordinates of the kernel part.
    b : ndarray of shape (n_terms, n_outputs)
        Coordinates of the polynomials: those the centres see, then the others.
    freedom : float
        Trace of the matrix that takes y to the fitted values.
    """
    F, M, q = basis.lower, len(basis.lower), basis.Q.shape[1]
    factor_diagonal = F.diagonal().copy()
    panels = list(gen_batches(M, max(64, M // 32)))
    corners = [np.zeros((panel.stop - panel.start,) * 2) for panel in panels]
    for panel in panels:
        F[: panel.start, panel] = 0.0
    n_terms = 0 if basis.tail is None else len(basis.tail.seen)
    Ay, AT = np.zeros((M, n_outputs)), np.zeros((M, n_terms))
    Ty, TT = np.zeros((n_terms, n_outputs)), np.zeros((n_terms, n_terms))
    for rows in gen_batches(len(X), block_rows(M)):
        a, t = basis.design(X[rows])
        values = y(rows)
        Ay += dgemm(1.0, a, values)
        if n_terms:
            AT += dgemm(1.0, a, t, trans_b=1)
            Ty += dgemm(1.0, t, values)
            TT += dgemm(1.0, t, t, trans_b=1)
        for panel, corner in zip(panels, corners, strict=True):
            product = dgemm(1.0, a[: panel.stop], a[panel], trans_b=1)
            F[: panel.start, panel] += product[: panel.start]
            corner += product[panel.start :]
    trace = sum(float(np.trace(corner)) for corner in corners)
    # Along Q there is nothing but rounding: a number of the size that the rest may
    # have, by |a(x)|^2 <= k(x, x), makes that part of the matrix regular.
    along_Q = float(basis.sections.diagonal(X).sum()) / M or 1.0
    for panel, corner in zip(panels, corners, strict=True):
        if q:
            product = along_Q * basis.Q[: panel.stop] @ basis.Q[panel].T
            F[: panel.start, panel] += product[: panel.start]
            corner += product[panel.start :]
        corner[np.diag_indices_from(corner)] += alpha
        F[panel, panel] = np.triu(corner) + np.tril(F[panel, panel], -1)

    _, info = dpotrf(F, lower=0, clean=0, overwrite_a=1)
    rcond = (
        0.0 if info else float(dpocon(F, trace + q * along_Q + M * alpha, uplo="U")[0])
    )
    if info or rcond < min(1e-13, 1e-6 * basis.rcond):
        if basis.rcond < SUSPECT:
            raise np.linalg.LinAlgError("the normal matrix is not positive definite")
        raise ValueError(
            f"method='least_squares' with alpha={alpha}: the rows of X do not "
            f"determine the coefficients of {M} centres; set alpha > 0, or choose "
            "fewer centres, nearer to the rows."
        )
    solved, _ = dpotrs(F, np.hstack([AT, Ay]), lower=0)
    N_AT, N_Ay = solved[:, :n_terms], solved[:, n_terms:]
    # In units in which every polynomial has length one on the rows. Those that the
    # rows do not tell from the kernel part, or at all, are left at zero.
    length = np.sqrt(TT.diagonal())
    unit = np.divide(1.0, length, out=np.zeros(n_terms), where=length > 0)
    size, axes = np.linalg.eigh(unit[:, np.newaxis] * (TT - AT.T @ N_AT) * unit)
    told = size > 1e-14
    axes = unit[:, np.newaxis] * axes[:, told]
    inverse = axes / size[told] @ axes.T
    b = inverse @ (Ty - AT.T @ N_Ay)
    z = N_Ay - N_AT @ b
    z -= basis.Q @ (basis.Q.T @ z)

    freedom = float(told.sum() + M - q)
    if alpha > 0:
        dpotri(F, lower=0, overwrite_c=1)
        shrunk = F.diagonal().sum() - q / (alpha + along_Q)
        shrunk += np.sum(inverse * (N_AT.T @ N_AT))
        freedom -= float(alpha * shrunk)
    np.fill_diagonal(F, factor_diagonal)
    return z, b, freedom


def solve(
    sections: Sections,
    points: Array,
    nugget: Array,
    rule: Rule,
    degree: int | None,
    rows: Array,
    *,
    drop_dependent: bool,
) -> tuple[Solution[NativeBasis], float]:
    """Apply a rule in the native basis of the centres.

    `rows` tell which features vary, for the tail. Where the Gram matrix is not
    positive definite, or the solution misses the values that it should have, centres
    whose sections the others reproduce are left out: `kept` tells which ones are not.
    The second value returned is the square of the power function, relative to the
    kernel, at which a section counts as reproduced. It is raised until that suffices,
    and 0 if no centre had to go.

    Raises
    ------
    LinAlgError
        If no solution is found, or none without dropping and `drop_dependent` is off.
    UnsuitableKernelError
        If dropping centres cannot help.
    """
    kept = np.arange(len(points))
    tolerance = 0.0
    while True:
        offered = sections.take(kept)
        tail = None if degree is None else Tail.on(points[kept], degree, rows)
        try:
            basis = NativeBasis.of(offered, points[kept], nugget[kept], tail)
            solution = rule(basis, kept)
            if solution.error <= ACCURACY:
                return solution, tolerance
            reason = f"the solution misses its values by {solution.error:.1e}"
            del solution, basis
        except np.linalg.LinAlgError as error:
            reason = str(error)
        # Pivots are accurate to several units of rounding, and rarely to fewer.
        tolerance = max(8 * tolerance, 64 * float(np.finfo(np.float64).eps))
        if not drop_dependent or tolerance > 1:
            raise np.linalg.LinAlgError(reason)
        kept = independent_centers(sections, points, nugget, tolerance)


def independent_centers(
    sections: Sections, points: Array, nugget: Array, tolerance: float
) -> Indices:
    """Return the centres that a pivoted Cholesky factorisation keeps, in order."""
    K, _, norm = gram_matrix(sections, points, nugget)
    if not np.isfinite(norm):
        raise UnsuitableKernelError("has values that are not finite on these states")
    diagonal = K.diagonal().copy()
    largest = float(diagonal.max())
    F, pivots, rank, _ = dpstrf(K, tol=tolerance * largest, lower=1, overwrite_a=1)
    rank = max(rank, 1)
    order = pivots - 1
    # What the centres kept leave of the others is zero up to rounding, or else the
    # matrix has negative eigenvalues that no choice of centres mends.
    left = diagonal[order[rank:]] - np.square(F[rank:, :rank]).sum(axis=1)
    limit = max(tolerance, 1e-10) * largest
    if largest <= 0 or (len(left) and np.abs(left).max() > limit):
        raise UnsuitableKernelError("is not positive definite on these states")
    return np.sort(order[:rank]).astype(np.intp)


def column_norms(A: Array) -> Array:
    """Return the Euclidean norms of the columns, whatever their unit."""
    return np.array([dnrm2(column) for column in A.T])


def _relative_error(reached: Array, wanted: Array) -> float:
    return float(np.abs(reached - wanted).max() / (np.abs(wanted).max() or 1.0))


def evaluate(
    sections: Sections,
    tail: Tail | None,
    X: Array,
    dual: Array,
    trend: Array,
    n_jobs: int | None = None,
) -> Array:
    """Evaluate k(X, Xi) @ dual and add the polynomials."""
    values = product(sections, X, dual, n_jobs)
    if tail is not None:
        values += polynomial(X, tail.origin, trend)
    return values
