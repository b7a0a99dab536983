"""Linear algebra of kernel estimates: pure functions and values over arrays.

The functions of H_M, the span of the kernel sections of M centres (with a polynomial
tail, if there is one), are handled in an orthonormal basis of their native space.
With the Gram matrix K = L L^T, the vector a(x) = L^-1 k(Xi, x) holds the values of
that basis at x. The function a(x)^T w has the native norm |w| and the coefficients
L^-T w on the kernel sections. So interpolation is w = L^-1 u, and least squares over
H_M is an ordinary ridge regression on a(x), whose matrix has the square root of the
condition number that the kernel sections themselves would give it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from joblib import effective_n_jobs
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm, dnrm2
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs, dpstrf, dtrtrs
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Loops over blocks use SciPy's BLAS throughout: NumPy's wheels bring one of their own,
# and the idle threads of either slow down the other several times.

# Entries of a tile of a kernel matrix: half a megabyte, so that the few arrays that
# evaluating a kernel takes stay in the cache.
TILE = 2**16
# Below this reciprocal condition number a solution is verified before it is used.
SUSPECT = 1e-10
# Largest error, relative to the values to be met, that passes the verification. Large
# coefficients of alternating sign cost smooth kernels this much without harm, while
# leaving out more centres would cost them more.
ACCURACY = 1e-6


class Sections(Protocol):
    """The kernel sections of M centres, as a function from rows to (rows, M)."""

    def __call__(self, X: Array) -> Array: ...

    def take(self, kept: Indices) -> Sections:
        """Return the sections of some of the centres."""

    def diagonal(self, X: Array) -> Array:
        """Return k(x, x) for every row."""


@dataclass(frozen=True)
class KernelSections:
    """Kernel sections of centres given by their coordinates."""

    kernel: Any
    centers: Array

    def __call__(self, X: Array) -> Array:
        return self.kernel(X, self.centers)

    def take(self, kept: Indices) -> KernelSections:
        return KernelSections(self.kernel, self.centers[kept])

    def diagonal(self, X: Array) -> Array:
        return self.kernel.diag(X)


@dataclass(frozen=True)
class DistanceSections:
    """Sections of an isotropic kernel, where rows hold distances to the centres."""

    kernel: Any
    columns: Indices

    def __call__(self, X: Array) -> Array:
        distances = X[:, self.columns]
        # On a line, the distance from the origin is all that there is to a point.
        values = self.kernel(distances.reshape(-1, 1), np.zeros((1, 1)))
        return values.reshape(distances.shape)

    def take(self, kept: Indices) -> DistanceSections:
        return DistanceSections(self.kernel, self.columns[kept])

    def diagonal(self, X: Array) -> Array:
        return np.repeat(self.kernel.diag(np.zeros((1, 1))), len(X))


@dataclass(frozen=True)
class Tail:
    """Polynomials of degree 0 or 1 that are orthonormal on the centres.

    Their number q is the rank of the polynomials there: smaller than the number of
    monomials where a feature is constant or the centres are few.
    """

    origin: Array
    transform: Array  # (1 + n_features, q), from the monomials 1 and x - origin

    @classmethod
    def on(cls, centers: Array, degree: int) -> Tail:
        n_centers, n_features = centers.shape
        if degree == 0:
            transform = np.zeros((1 + n_features, 1))
            transform[0] = 1 / np.sqrt(n_centers)
            return cls(np.zeros(n_features), transform)
        origin = centers.mean(axis=0)
        scale = np.abs(centers - origin).max(axis=0)
        # What rounding leaves of a constant feature is no direction to extrapolate in.
        constant = scale <= 1e-13 * np.abs(origin)
        inverse = np.divide(1.0, scale, out=np.zeros(n_features), where=~constant)
        monomials = np.hstack([np.ones((n_centers, 1)), (centers - origin) * inverse])
        _, singular, directions = np.linalg.svd(monomials, full_matrices=False)
        rank = int((singular > 1e-10 * singular[0]).sum())
        transform = directions[:rank].T / singular[:rank]
        transform[1:] *= inverse[:, np.newaxis]
        return cls(origin, transform)

    def __call__(self, X: Array) -> Array:
        """Evaluate the polynomials: (rows, q)."""
        if not self.transform[1:].any():
            return np.tile(self.transform[0], (len(X), 1))
        return self.transform[0] + (X - self.origin) @ self.transform[1:]


@dataclass(frozen=True)
class NativeBasis:
    """Orthonormal basis of H_M, or of H_M with a polynomial tail.

    With the polynomials P and L^-1 P(Xi) = Q R, coordinates w split into the
    polynomial R^-1 Q^T w and the part orthogonal to Q, which belongs to the kernel
    sections and alone counts in the native seminorm. The coefficients of the sections
    are then orthogonal to the polynomials on the centres.
    """

    sections: Sections
    lower: Array  # in Fortran order; its strict upper triangle has no meaning
    rcond: float
    tail: Tail | None
    Q: Array  # (M, q), with q = 0 where there is no tail
    R: Array

    @classmethod
    def of(
        cls, sections: Sections, points: Array, nugget: Array, tail: Tail | None
    ) -> NativeBasis:
        """Factor the Gram matrix at the centres plus a diagonal `nugget`."""
        K, norm = gram_matrix(sections, points, nugget)
        lower, info = dpotrf(K, lower=1, clean=0, overwrite_a=1)
        if info != 0:
            raise np.linalg.LinAlgError("the Gram matrix is not positive definite")
        rcond = float(dpocon(lower, norm, uplo="L")[0])
        P = np.empty((len(points), 0)) if tail is None else tail(points)
        Z: Array = _solve_triangular(lower, P) if tail else P
        Q, R = np.linalg.qr(Z)
        return cls(sections, lower, rcond, tail, Q, R)

    def components(self, X: Array) -> tuple[Array, Array]:
        """Return a(x) and R^-T p(x) - Q^T a(x): (M, rows) and (q, rows)."""
        a = _solve_triangular(
            self.lower, matrix(self.sections, X, len(self.lower)).T, overwrite=True
        )
        if self.tail is None:
            return a, np.empty((0, len(X)))
        p = np.linalg.solve(self.R.T, self.tail(X).T)
        return a, np.subtract(p, dgemm(1.0, self.Q, a, trans_a=1), dtype=np.float64)

    def features(self, X: Array) -> Array:
        """Evaluate the basis functions: (M, rows)."""
        a, excess = self.components(X)
        return dgemm(1.0, self.Q, excess, 1.0, a, overwrite_c=1) if self.tail else a

    def variance(self, X: Array) -> Array:
        """Evaluate the squared power function."""
        a, excess = self.components(X)
        explained = np.einsum("ij,ij->j", a, a) - np.einsum("ij,ij->j", excess, excess)
        return np.maximum(self.sections.diagonal(X) - explained, 0.0)

    def seminorm_part(self, w: Array) -> Array:
        """Project coordinates onto the part that belongs to the kernel sections."""
        return w - self.Q @ (self.Q.T @ w)

    def coefficients(self, w: Array) -> tuple[Array, Array]:
        """Turn coordinates into coefficients of the sections and of the tail."""
        dual = _solve_triangular(self.lower, self.seminorm_part(w), transpose=True)
        trend = np.linalg.solve(self.R, self.Q.T @ w)
        return dual, trend.astype(np.float64, copy=False)

    def least_squares(self, X: Array, y: Array, alpha: float) -> Array:
        """Return the coordinates that minimise |y - g(X)|^2 + alpha |g|_H^2.

        The normal matrix is accumulated and factored in the triangle that the
        Cholesky factor leaves unused: memory stays at one M x M matrix.
        """
        F, M = self.lower, len(self.lower)
        panels = list(gen_batches(M, max(64, M // 32)))
        corners = [np.zeros((panel.stop - panel.start,) * 2) for panel in panels]
        target = np.zeros((M, y.shape[1]))
        for panel in panels:
            F[: panel.start, panel] = 0.0
        for rows in gen_batches(len(X), max(128, M // 16)):
            a = self.features(X[rows])
            target += dgemm(1.0, a, y[rows])
            for panel, corner in zip(panels, corners, strict=True):
                product = dgemm(1.0, a[: panel.stop], a[panel], trans_b=1)
                F[: panel.start, panel] += product[: panel.start]
                corner += product[panel.start :]
        diagonal = F.diagonal().copy()
        for panel, corner in zip(panels, corners, strict=True):
            # alpha (I - Q Q^T): the polynomial part goes unpenalised.
            product = self.Q[: panel.stop] @ self.Q[panel].T
            F[: panel.start, panel] -= alpha * product[: panel.start]
            corner -= alpha * product[panel.start :]
            corner[np.diag_indices_from(corner)] += alpha
            F[panel, panel] = np.triu(corner) + np.tril(F[panel, panel], -1)
        _, info = dpotrf(F, lower=0, clean=0, overwrite_a=1)
        if info != 0:
            raise np.linalg.LinAlgError("the samples do not determine the estimate")
        w, _ = dpotrs(F, target, lower=0)
        np.fill_diagonal(F, diagonal)
        return w


@dataclass(frozen=True)
class Solution:
    """Coefficients of an estimate and the basis that they were computed in."""

    basis: NativeBasis
    kept: Indices  # which of the centres offered carry the estimate
    dual: Array  # (M, n_outputs)
    trend: Array  # (q, n_outputs)
    seminorm: Array  # (n_outputs,): native norm of the estimate, trend not counted
    error: float  # how far it is from the values it should have, where that is suspect


Rule = Callable[[NativeBasis, Indices], Solution]


def interpolation(points: Array, u: Array, nugget: Array) -> Rule:
    """Rule that interpolates u at the centres; with a nugget N, meets u - N c there."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution:
        w = _solve_triangular(basis.lower, u[kept])
        rows, extra = points[kept], nugget[kept, np.newaxis]
        return _verified(basis, kept, w, rows, lambda dual: u[kept] - extra * dual)

    return solve


def regression(X: Array, y: Array, alpha: float) -> Rule:
    """Rule that fits y on all rows of X by least squares."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution:
        w = basis.least_squares(X, y, alpha)
        rows = X[:: max(len(X) // 64, 1)]
        return _verified(basis, kept, w, rows, lambda _: basis.features(rows).T @ w)

    return solve


def solve(
    sections: Sections,
    points: Array,
    nugget: Array,
    rule: Rule,
    degree: int | None,
    *,
    drop_dependent: bool,
) -> tuple[Solution, float]:
    """Apply a rule in the native basis of the centres.

    Where the Gram matrix is not positive definite, or the solution misses the values
    that it should have, centres whose sections the others reproduce are left out:
    `kept` tells which ones are not. The second value returned is the square of the
    power function, relative to the kernel, at which a section counts as reproduced. It
    is raised until that suffices, and 0 if no centre had to go.

    Raises
    ------
    LinAlgError
        If no solution is found, or none without dropping and `drop_dependent` is off.
    """
    kept = np.arange(len(points))
    tolerance = 0.0
    while True:
        offered = sections.take(kept)
        tail = None if degree is None else Tail.on(points[kept], degree)
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


def matrix(sections: Sections, X: Array, n_columns: int) -> Array:
    """Evaluate k(X, Xi) tile by tile: evaluating a kernel takes several arrays."""
    K = np.empty((len(X), n_columns))
    for rows in gen_batches(len(X), _tile_rows(n_columns)):
        K[rows] = sections(X[rows])
    return K


def gram_matrix(
    sections: Sections, points: Array, nugget: Array
) -> tuple[Array, float]:
    """Assemble the Gram matrix plus a diagonal in Fortran order, and its 1-norm."""
    n = len(points)
    K = matrix(sections, points, n)
    norm = max(
        float(np.abs(K[rows]).sum(axis=1).max())
        for rows in gen_batches(n, _tile_rows(n))
    )
    # Not what the sections gave: a noise term of the kernel counts here alone.
    K[np.diag_indices(n)] = sections.diagonal(points) + nugget
    return K.T, norm + float(nugget.max())


def independent_centers(
    sections: Sections, points: Array, nugget: Array, tolerance: float
) -> Indices:
    """Return the centres that a pivoted Cholesky factorisation keeps, in order."""
    K, _ = gram_matrix(sections, points, nugget)
    largest = float(K.diagonal().max())
    _, pivots, rank, _ = dpstrf(K, tol=tolerance * largest, lower=1, overwrite_a=1)
    return np.sort(pivots[: max(rank, 1)] - 1).astype(np.intp)


def evaluate(
    sections: Sections, X: Array, dual: Array, n_jobs: int | None = None
) -> Array:
    """Evaluate k(X, Xi) @ dual without holding k(X, Xi)."""
    return _by_rows(
        lambda rows: sections(rows) @ dual, X, _tile_rows(len(dual)), n_jobs
    )


def power(basis: NativeBasis, X: Array, n_jobs: int | None = None) -> Array:
    """Evaluate the power function."""
    # A triangular solve reads the whole factor: more rows a time than in a tile.
    n_rows = max(64, len(basis.lower) // 32)
    return np.sqrt(_by_rows(basis.variance, X, n_rows, n_jobs))


def column_norms(A: Array) -> Array:
    """Return the Euclidean norms of the columns, whatever their unit."""
    return np.array([dnrm2(column) for column in A.T])


def _verified(
    basis: NativeBasis,
    kept: Indices,
    w: Array,
    rows: Array,
    expected: Callable[[Array], Array],
) -> Solution:
    dual, trend = basis.coefficients(w)
    error = 0.0
    if not np.isfinite(dual).all():
        raise np.linalg.LinAlgError("the coefficients are not finite")
    if basis.rcond < SUSPECT:
        values = evaluate(basis.sections, rows, dual)
        if basis.tail:
            values += basis.tail(rows) @ trend
        wanted = expected(dual)
        scale = np.abs(wanted).max() or 1.0
        error = float(np.abs(values - wanted).max() / scale)
    seminorm = column_norms(basis.seminorm_part(w))
    return Solution(basis, kept, dual, trend, seminorm, error)


def _by_rows(
    function: Callable[[Array], Array], X: Array, n_rows: int, n_jobs: int | None
) -> Array:
    """Apply a function to blocks of rows, on threads if asked, and join the results."""
    blocks = gen_batches(len(X), n_rows)
    if effective_n_jobs(n_jobs) == 1:
        return np.concatenate([function(X[rows]) for rows in blocks])
    parts = Parallel(n_jobs=n_jobs, prefer="threads")(
        delayed(function)(X[rows]) for rows in blocks
    )
    return np.concatenate(parts)


def _tile_rows(n_columns: int) -> int:
    return max(TILE // n_columns, 1)


def _solve_triangular(
    lower: Array, b: Array, *, transpose: bool = False, overwrite: bool = False
) -> Array:
    x, info = dtrtrs(
        lower, b, lower=1, trans=int(transpose), overwrite_b=int(overwrite)
    )
    if info != 0:
        raise np.linalg.LinAlgError("the Gram matrix is singular")
    return x
