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
from scipy.linalg.lapack import dpocon, dpotrf, dpotri, dpotrs, dpstrf, dtrtrs
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# The loop of least squares stays with SciPy's BLAS: NumPy's wheels bring one of their
# own, and the idle threads of either slow down the other several times.

# Entries of a tile of a kernel matrix: 128 kB, so that the few arrays that evaluating
# a kernel takes stay in the cache, and are not mapped anew by the operating system
# (which makes larger ones two to three times as slow).
TILE = 2**14
# Below this reciprocal condition number a solution is verified before it is used.
SUSPECT = 1e-10
# Below this one the factorisation succeeded by chance, and its last rows mean nothing.
SINGULAR = 1e-17
# Largest error, relative to the values to be met, that passes the verification. Large
# coefficients of alternating sign cost smooth kernels this much without harm, while
# leaving out more centres would cost them more.
ACCURACY = 1e-6


class UnsuitableKernelError(ValueError):
    """The kernel has no Gram matrix that an estimate could be made with."""


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
    """Polynomials of degree 0 or 1, sorted by what the centres tell of them.

    As coefficients of the monomials, which are 1, and x - origin for degree 1: `seen`
    holds q polynomials that are orthonormal on the centres, `unseen` those that vanish
    there, as some do where the centres are few or a feature is constant on them.
    """

    origin: Array
    seen: Array  # (n_terms, q)
    unseen: Array  # (n_terms, n_terms - q)

    @classmethod
    def on(cls, centers: Array, degree: int, rows: Array) -> Tail:
        n_centers, n_features = centers.shape
        if degree == 0:
            seen = np.full((1, 1), 1 / np.sqrt(n_centers))
            return cls(np.zeros(n_features), seen, np.empty((1, 0)))
        origin = centers.mean(axis=0)
        scale = np.abs(rows - origin).max(axis=0)
        # What rounding leaves of a constant feature is no direction to extrapolate in.
        varies = scale > 1e-13 * np.abs(origin)
        inverse = np.divide(1.0, scale, out=np.zeros(n_features), where=varies)
        monomials = np.hstack([np.ones((n_centers, 1)), (centers - origin) * inverse])
        # All directions, also those that few centres do not see.
        few = n_centers <= n_features
        _, singular, directions = np.linalg.svd(monomials, full_matrices=few)
        rank = int((singular > 1e-10 * singular[0]).sum())
        coefficients = np.vstack(
            [directions.T[:1], directions.T[1:] * inverse[:, None]]
        )
        return cls(
            origin, coefficients[:, :rank] / singular[:rank], coefficients[:, rank:]
        )

    def beyond(self, X: Array) -> NDArray[np.bool_]:
        """Tell in which rows polynomials that the centres do not see are not zero."""
        coefficients = np.hstack([self.seen, self.unseen])[1:]
        n = len(coefficients)
        # Features in which the centres agree have none.
        constant = np.asarray(np.abs(coefficients).sum(axis=1) == 0)
        origin = self.origin[:n]
        away = np.abs(X[:, :n] - origin)
        moved = away[:, constant] > 1e-12 * np.abs(origin[constant])
        left = np.abs(polynomial(X, self.origin, self.unseen))
        size = 1 + away @ np.abs(self.unseen[1:])
        return np.asarray(moved.any(axis=1) | (left > 1e-9 * size).any(axis=1))


def polynomial(X: Array, origin: Array, coefficients: Array) -> Array:
    """Evaluate polynomials given by their coefficients of 1 and x - origin."""
    if len(coefficients) == 1:
        return np.repeat(coefficients, len(X), axis=0)
    return coefficients[0] + (X - origin) @ coefficients[1:]


@dataclass(frozen=True)
class NativeBasis:
    """Orthonormal basis of H_M, with or without a polynomial tail.

    With the polynomials p that the centres see, and L^-1 P(Xi) = Q R, an estimate is
    a(x)^T z + t(x)^T b with t(x) = R^-T p(x) and z orthogonal to Q: then the
    coefficients L^-T z of the sections are orthogonal to the polynomials on the
    centres, and |z| is the native seminorm.
    """

    sections: Sections
    lower: Array  # in Fortran order; its strict upper triangle has no meaning
    excess: Array  # what the diagonal of the matrix has over that of the sections
    rcond: float
    tail: Tail | None
    Q: Array  # (M, q), with q = 0 where there is no tail
    R: Array

    @classmethod
    def of(
        cls, sections: Sections, points: Array, nugget: Array, tail: Tail | None
    ) -> NativeBasis:
        """Factor the Gram matrix at the centres plus a diagonal `nugget`."""
        K, excess, norm = gram_matrix(sections, points, nugget)
        lower, info = dpotrf(K, lower=1, clean=0, overwrite_a=1)
        if info != 0:
            raise np.linalg.LinAlgError("the Gram matrix is not positive definite")
        rcond = float(dpocon(lower, norm, uplo="L")[0])
        if rcond < SINGULAR:
            raise np.linalg.LinAlgError("the Gram matrix is numerically singular")
        P = np.empty((len(points), 0))
        if tail is not None:
            P = polynomial(points, tail.origin, tail.seen)
            P = solve_triangular(lower, P)
        Q, R = np.linalg.qr(P)
        return cls(sections, lower, excess, rcond, tail, Q, R)

    def values(self, X: Array) -> tuple[Array, Array]:
        """Evaluate a(x), of shape (M, rows), and t(x), of shape (q, rows)."""
        K = matrix(self.sections, X, len(self.lower))
        a = solve_triangular(self.lower, K.T, overwrite=True)
        if self.tail is None:
            return a, np.empty((0, len(X)))
        p = polynomial(X, self.tail.origin, self.tail.seen)
        return a, np.asarray(np.linalg.solve(self.R.T, p.T), dtype=np.float64)

    def variance(self, X: Array) -> Array:
        """Evaluate the squared power function."""
        a, t = self.values(X)
        variance = self.sections.diagonal(X) - np.einsum("ij,ij->j", a, a)
        if self.tail is not None:
            t -= dgemm(1.0, self.Q, a, trans_a=1)
            variance += np.einsum("ij,ij->j", t, t)
        return np.maximum(variance, 0.0)

    def functions(self, X: Array) -> Array:
        """Evaluate a basis of all estimates, of shape (dimension, rows).

        It is a(x) with the polynomials in the place of its part along Q, which makes
        L^-1 u the coordinates of the interpolant of u; then the polynomials that the
        centres do not see.
        """
        a, t = _design(self, X)
        q = self.Q.shape[1]
        return np.vstack([dgemm(1.0, self.Q, t[:q], 1.0, a), t[q:]]) if q else a

    def coordinates(self, z: Array, b: Array) -> Array:
        """Turn the coordinates z and b into those in the basis of `functions`."""
        q = self.Q.shape[1]
        return np.vstack([z + self.Q @ b[:q], b[q:]])

    def expand(self, v: Array) -> tuple[Array, Array]:
        """Turn coordinates into coefficients of the sections and of the monomials."""
        M = len(self.lower)
        b = self.Q.T @ v[:M]
        return self.coefficients(v[:M] - self.Q @ b, np.vstack([b, v[M:]]))

    def coefficients(self, z: Array, b: Array) -> tuple[Array, Array]:
        """Turn coordinates into coefficients of the sections and of the monomials.

        Entries of b beyond q belong to the polynomials that the centres do not see.
        """
        dual = solve_triangular(self.lower, z, transpose=True)
        if not np.isfinite(dual).all():
            raise np.linalg.LinAlgError("the coefficients are not finite")
        if self.tail is None:
            return dual, np.empty((0, z.shape[1]))
        q = len(self.R)
        trend = self.tail.seen @ np.linalg.solve(self.R, b[:q])
        return dual, trend + self.tail.unseen[:, : len(b) - q] @ b[q:]


@dataclass(frozen=True)
class Solution:
    """Coefficients of an estimate and the basis that they were computed in."""

    basis: NativeBasis
    kept: Indices  # which of the centres offered carry the estimate
    dual: Array  # (M, n_outputs)
    trend: Array  # (n_terms, n_outputs), of the monomials of the tail
    seminorm: Array  # (n_outputs,): native norm of the estimate, trend not counted
    freedom: float  # effective number of parameters
    error: float  # how far it is from the values it should have, where that is suspect


Rule = Callable[[NativeBasis, Indices], Solution]


def interpolation(points: Array, u: Array) -> Rule:
    """Rule that interpolates u at the centres; meets u - E c with an excess E."""

    def solve(basis: NativeBasis, kept: Indices) -> Solution:
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

    def solve(basis: NativeBasis, kept: Indices) -> Solution:
        z, b, freedom = least_squares(basis, X, y.__getitem__, y.shape[1], alpha)
        dual, trend = basis.coefficients(z, b)
        error = 0.0
        if basis.rcond < SUSPECT:
            rows = X[:: max(len(X) // 64, 1)]
            a, t = _design(basis, rows)
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
    for rows in gen_batches(len(X), _block_rows(M)):
        a, t = _design(basis, X[rows])
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


def _design(basis: NativeBasis, X: Array) -> tuple[Array, Array]:
    """Return a(x) less its part along Q, and the values of all polynomials."""
    a, t = basis.values(X)
    if basis.tail is None:
        return a, t
    along = dgemm(1.0, basis.Q, a, trans_a=1)
    a = dgemm(-1.0, basis.Q, along, 1.0, a, overwrite_c=1)
    return a, np.vstack([t, polynomial(X, basis.tail.origin, basis.tail.unseen).T])


def solve(
    sections: Sections,
    points: Array,
    nugget: Array,
    rule: Rule,
    degree: int | None,
    rows: Array,
    *,
    drop_dependent: bool,
) -> tuple[Solution, float]:
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


def matrix(sections: Sections, X: Array, n_columns: int) -> Array:
    """Evaluate k(X, Xi) tile by tile: evaluating a kernel takes several arrays."""
    K = np.empty((len(X), n_columns))
    for rows in gen_batches(len(X), _tile_rows(n_columns)):
        K[rows] = sections(X[rows])
    return K


def gram_matrix(
    sections: Sections, points: Array, nugget: Array
) -> tuple[Array, Array, float]:
    """Assemble the Gram matrix plus a diagonal in Fortran order.

    Returns
    -------
    K : ndarray of shape (M, M)
        The matrix.
    excess : ndarray of shape (M,)
        What its diagonal has over the sections: the nugget, and a noise term of the
        kernel, which counts here and nowhere else.
    norm : float
        Its 1-norm.
    """
    n = len(points)
    K = matrix(sections, points, n)
    diagonal = sections.diagonal(points) + nugget
    excess = diagonal - K.diagonal()
    K[np.diag_indices(n)] = diagonal
    norms = [
        np.abs(K[rows]).sum(axis=1).max() for rows in gen_batches(n, _tile_rows(n))
    ]
    return K.T, excess, float(np.max(norms))


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


def evaluate(
    sections: Sections,
    tail: Tail | None,
    X: Array,
    dual: Array,
    trend: Array,
    n_jobs: int | None = None,
) -> Array:
    """Evaluate k(X, Xi) @ dual without holding k(X, Xi), and add the polynomials."""
    M, n_columns = dual.shape
    if n_columns < 64:
        values = _by_rows(lambda rows: sections(rows) @ dual, X, _tile_rows(M), n_jobs)
    else:  # the product takes longer than the kernel, and likes more rows
        values = _by_rows(
            lambda rows: matrix(sections, rows, M) @ dual, X, _block_rows(M), n_jobs
        )
    if tail is not None:
        values += polynomial(X, tail.origin, trend)
    return values


def power(basis: NativeBasis, X: Array, n_jobs: int | None = None) -> Array:
    """Evaluate the power function."""
    n_rows = _block_rows(len(basis.lower))
    return np.sqrt(_by_rows(basis.variance, X, n_rows, n_jobs))


def column_norms(A: Array) -> Array:
    """Return the Euclidean norms of the columns, whatever their unit."""
    return np.array([dnrm2(column) for column in A.T])


def _relative_error(reached: Array, wanted: Array) -> float:
    return float(np.abs(reached - wanted).max() / (np.abs(wanted).max() or 1.0))


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


def _block_rows(n_columns: int) -> int:
    # A triangular solve reads the whole factor: more rows a time than in a tile.
    return max(16 * TILE // n_columns, n_columns // 16, 1)


def solve_triangular(
    lower: Array, b: Array, *, transpose: bool = False, overwrite: bool = False
) -> Array:
    x, info = dtrtrs(
        lower, b, lower=1, trans=int(transpose), overwrite_b=int(overwrite)
    )
    if info != 0:
        raise np.linalg.LinAlgError("the Gram matrix is singular")
    return x
