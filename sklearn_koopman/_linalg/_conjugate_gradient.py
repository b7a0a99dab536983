"""Conjugate gradients for symmetric positive definite systems.

Systems are given by their product with several columns at once, restricted to the
orthogonal complement of a few columns P where there are any: that is how a polynomial
tail is solved for together with the kernel part.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._utils._typing import Array

Product = Callable[[Array], Array]

# Part of a vector that rounding leaves where the whole lies along given directions.
ROUNDING = 1e-14
# The rounding error of a product of n terms is about sqrt(n) epsilon times its size.
# The norm of the matrix is known from below only, by its largest Rayleigh quotient in
# the iteration: hence the factor.
ROUNDING_SAFETY = 10


@dataclass(frozen=True)
class CGResult:
    """What conjugate gradients have reached."""

    x: Array
    n_iter: int
    residual: float  # the largest relative one, of the system itself
    rounding: float  # the part of a relative residual that may be rounding


def conjugate_gradients(
    product: Product,
    b: Array,
    precondition: Product,
    P: Array,
    tol: float,
    max_iter: int,
) -> CGResult:
    """Solve A x = b in the complement of P, to a relative residual in every column.

    The residual that is carried along drifts from that of the system: it is computed
    anew when it is small enough, and the iteration started again where it is not.
    """

    def project(v: Array) -> Array:
        return complement(P, v)

    b = beyond_rounding(b, P)
    size = np.linalg.norm(b, axis=0)
    x = np.zeros_like(b)
    residual, best = b, np.full(b.shape[1], np.inf)
    n_iter, matrix_norm = 0, 0.0
    while True:
        error = np.linalg.norm(residual, axis=0)
        # Columns that a restart improved by less than half are as good as they get.
        unmet = np.flatnonzero((error > tol * size) & (error < best / 2))
        best = error
        if not len(unmet) or n_iter >= max_iter:
            reached = np.divide(error, size, out=np.zeros_like(error), where=size > 0)
            length = np.linalg.norm(x, axis=0)
            growth = np.divide(length, size, out=np.zeros_like(size), where=size > 0)
            rounding = ROUNDING_SAFETY * np.sqrt(len(b)) * np.finfo(b.dtype).eps
            rounding *= matrix_norm * growth.max(initial=0.0)
            return CGResult(x, n_iter, float(reached.max(initial=0.0)), float(rounding))
        step, taken, quotient = _descend(
            lambda v: project(product(v)),
            residual[:, unmet],
            lambda v: project(precondition(project(v))),
            tol * size[unmet],
            max_iter - n_iter,
        )
        n_iter += taken
        matrix_norm = max(matrix_norm, quotient)
        moved = x.copy()
        moved[:, unmet] += step
        left = b - project(product(moved))
        # On a matrix that rounding makes indefinite, more steps make it worse.
        better = np.linalg.norm(left, axis=0) < error
        x = np.where(better, moved, x)
        residual = np.where(better, left, residual)


def complement(P: Array, v: Array) -> Array:
    """Return v less its part along the orthonormal columns of P.

    Twice: what rounding leaves the first time may be all of a small remainder.
    """
    if P.shape[1]:
        v = v - P @ (P.T @ v)
        v = v - P @ (P.T @ v)
    return v


def beyond_rounding(v: Array, P: Array) -> Array:
    """Return the same, with zero for columns of which only rounding is left."""
    left = complement(P, v)
    size, whole = (np.abs(x).max(axis=0, initial=0.0) for x in (left, v))
    return np.where(size > ROUNDING * whole, left, 0.0)


def _descend(
    product: Product, b: Array, precondition: Product, target: Array, max_iter: int
) -> tuple[Array, int, float]:
    """Run conjugate gradients from zero until each column has met its target.

    The number of iterations and the largest Rayleigh quotient are returned as well.
    """
    quotient = 0.0
    x = np.zeros_like(b)
    columns = np.arange(b.shape[1])
    r = b.copy()
    z = precondition(r)
    p = z.copy()
    rz = np.einsum("ij,ij->j", r, z)
    for n_iter in range(1, max_iter + 1):
        q = product(p)
        curvature = np.einsum("ij,ij->j", p, q)
        lengths = np.einsum("ij,ij->j", p, p)
        quotients = np.divide(
            curvature, lengths, out=np.zeros_like(lengths), where=lengths > 0
        )
        quotient = max(quotient, float(np.nan_to_num(quotients).max()))
        # Rounding ends the descent where the residual is all rounding.
        sound = (curvature > 0) & (rz > 0) & np.isfinite(curvature)
        step = np.divide(rz, curvature, out=np.zeros_like(rz), where=sound)
        x[:, columns] += step * p
        r -= step * q
        unfinished = sound & (np.linalg.norm(r, axis=0) > target[columns])
        if not unfinished.any():
            return x, n_iter, quotient
        if not unfinished.all():
            columns, r, p, rz = (
                columns[unfinished],
                r[:, unfinished],
                p[:, unfinished],
                rz[unfinished],
            )
        z = precondition(r)
        before, rz = rz, np.einsum("ij,ij->j", r, z)
        p = z + rz / before * p
    return x, max_iter, quotient
