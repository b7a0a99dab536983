"""Conjugate gradients for symmetric positive definite systems.

Systems are given by their product with several columns at once, restricted to the
orthogonal complement of a few columns P where there are any: that is how a polynomial
trend is solved for together with the kernel part.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._utils._typing import Array

Product = Callable[[Array], Array]

# Part of a vector that rounding leaves where the whole lies along given directions.
ROUNDING = 1e-14
# Steps of the power method, from a random vector. After q of them the norm of an n x n
# matrix is known to a factor of about n^(1 / 2q): 4 for a hundred thousand rows.
POWER_STEPS = 4
# Hence the factor between the estimate of a rounding error and what is allowed for it.
ROUNDING_SAFETY = 4
# A residual above this is a failure, also where rounding is the reason: the matrix is
# then singular for all practical purposes.
MAX_ROUNDING = 1e-6


@dataclass(frozen=True)
class CGResult:
    """What conjugate gradients have reached, for every column."""

    x: Array
    n_iter: int
    residual: Array  # (n_columns,): relative, of the system itself
    rounding: Array  # (n_columns,): the part of the residual that may be rounding

    def has_converged(self, tol: float) -> bool:
        """Tell whether no residual is above tol by more than rounding, or 1e-6."""
        allowed = tol + np.minimum(self.rounding, MAX_ROUNDING)
        return bool((self.residual <= allowed).all())


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

    # In units of the largest values: the squares of others may not fit in a double.
    unit = np.abs(b).max(axis=0, initial=0.0)
    unit[unit == 0] = 1.0
    b = beyond_rounding(b / unit, P)
    size = np.linalg.norm(b, axis=0)
    x = np.zeros_like(b)
    residual, best = b, np.full(b.shape[1], np.inf)
    n_iter = 0
    while True:
        error = np.linalg.norm(residual, axis=0)
        # Columns that a restart improved by less than half are as good as they get.
        unmet = np.flatnonzero((error > tol * size) & (error < best / 2))
        best = error
        if not len(unmet) or n_iter >= max_iter:
            size[size == 0] = 1.0
            rounding = np.zeros_like(size)
            if (error > tol * size).any():
                rounding = _rounding_of_product(product, x) / size
            return CGResult(x * unit, n_iter, error / size, rounding)
        step, taken = _descend(
            lambda v: project(product(v)),
            residual[:, unmet],
            lambda v: project(precondition(project(v))),
            tol * size[unmet],
            max_iter - n_iter,
        )
        n_iter += taken
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
) -> tuple[Array, int]:
    """Run conjugate gradients from zero until each column has met its target.

    The number of iterations is returned as well.
    """
    x = np.zeros_like(b)
    columns = np.arange(b.shape[1])
    r = b.copy()
    z = precondition(r)
    p = z.copy()
    rz = np.einsum("ij,ij->j", r, z)
    for n_iter in range(1, max_iter + 1):
        q = product(p)
        curvature = np.einsum("ij,ij->j", p, q)
        # Rounding ends the descent where the residual is all rounding.
        sound = (curvature > 0) & (rz > 0) & np.isfinite(curvature)
        step = np.divide(rz, curvature, out=np.zeros_like(rz), where=sound)
        x[:, columns] += step * p
        r -= step * q
        unfinished = sound & (np.linalg.norm(r, axis=0) > target[columns])
        if not unfinished.any():
            return x, n_iter
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
    return x, max_iter


def _rounding_of_product(product: Product, x: Array) -> Array:
    """Estimate the length of the rounding error of A x, for every column.

    It is about sqrt(n) epsilon |A| |x|, as errors of n terms add up like random ones.
    """
    v = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(x), 1))
    for _ in range(POWER_STEPS):
        v = product(v / (np.linalg.norm(v) or 1.0))
    unit = np.sqrt(len(x)) * np.finfo(x.dtype).eps * np.linalg.norm(v)
    return np.asarray(ROUNDING_SAFETY * unit * np.linalg.norm(x, axis=0))
