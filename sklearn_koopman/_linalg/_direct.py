"""Estimates in the span of the kernel sections: pure functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.linalg.blas import dnrm2
from scipy.linalg.lapack import dpstrf
from sklearn.utils import gen_batches

from sklearn_koopman._linalg._cholesky import NativeBasis, solve_triangular
from sklearn_koopman._linalg._least_squares import SUSPECT, least_squares
from sklearn_koopman._matrices._polynomial import PolynomialTrend, polynomial
from sklearn_koopman._matrices._sections import Sections, gram_matrix, product
from sklearn_koopman._utils._typing import Array, Indices

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
            error = relative_error(reached, u[kept])
        return Solution(
            basis, kept, dual, trend, column_norms(z), len(basis.lower), error
        )

    return solve


def regression(X: Array, y: Array, alpha: float, n_jobs: int | None) -> Rule:
    """Rule that fits y on all rows of X by least squares."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution[NativeBasis]:
        z, b, freedom = least_squares(
            basis, X, y.__getitem__, y.shape[1], alpha, n_jobs
        )
        return fitted(basis, kept, X, z, b, freedom)

    return solve


def fitted(
    basis: NativeBasis, kept: Indices, X: Array, z: Array, b: Array, freedom: float
) -> Solution[NativeBasis]:
    """Return the estimate with these coordinates, verified on some of the rows."""
    dual, trend = basis.coefficients(z, b)
    error = 0.0
    if basis.rcond < SUSPECT:
        rows = X[:: max(len(X) // 64, 1)]
        a, t = basis.design(rows)
        reached = evaluate(basis.sections, basis.tail, rows, dual, trend)
        error = relative_error(reached, a.T @ z + t.T @ b)
    return Solution(basis, kept, dual, trend, column_norms(z), freedom, error)


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
        tail = (
            None if degree is None else PolynomialTrend.on(points[kept], degree, rows)
        )
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
        raise UnsuitableKernelError(
            "has values that are not finite on these states; rescale them, or take "
            "another kernel"
        )
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
        raise UnsuitableKernelError(
            "is not positive definite on these states; rescale them, or take another "
            "kernel"
        )
    return np.sort(order[:rank]).astype(np.intp)


def column_norms(A: Array) -> Array:
    """Return the Euclidean norms of the columns, whatever their unit."""
    return np.array([dnrm2(column) for column in A.T])


def relative_error(reached: Array, wanted: Array) -> float:
    return float(np.abs(reached - wanted).max() / (np.abs(wanted).max() or 1.0))


def evaluate(
    sections: Sections,
    tail: PolynomialTrend | None,
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


def residual_norms(
    solution: Solution[Any], X: Array, y: Array, n_jobs: int | None
) -> Array:
    """Return the norms of the residuals of every output, many rows at a time."""
    basis, norms = solution.basis, np.zeros(y.shape[1])
    for rows in gen_batches(len(X), 2**13):
        fitted = evaluate(
            basis.sections, basis.tail, X[rows], solution.dual, solution.trend, n_jobs
        )
        norms = np.hypot(norms, column_norms(y[rows] - fitted))
    return norms
