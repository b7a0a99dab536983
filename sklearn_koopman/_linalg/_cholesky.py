"""Orthonormal bases of native spaces.

The functions of H_M, the span of the kernel sections of M centres (with a polynomial
tail, if there is one), are handled in an orthonormal basis of their native space.
With the Gram matrix K = L L^T, the vector a(x) = L^-1 k(Xi, x) holds the values of
that basis at x. The function a(x)^T w has the native norm |w| and the coefficients
L^-T w on the kernel sections. So interpolation is w = L^-1 u, and least squares over
H_M is an ordinary ridge regression on a(x), whose matrix has the square root of the
condition number that the kernel sections themselves would give it.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpocon, dpotrf, dtrtrs

from sklearn_koopman._matrices._polynomial import PolynomialTrend, polynomial
from sklearn_koopman._matrices._sections import Sections, gram_matrix, matrix
from sklearn_koopman._utils._parallel import by_rows, one_thread
from sklearn_koopman._utils._typing import Array

# Below this reciprocal condition number the factorisation succeeded by chance, and its
# last rows mean nothing.
SINGULAR = 1e-17
# From this size on, in bytes, the factorisation by several threads of OpenBLAS ends in
# a segmentation fault (seen with its 32-bit integers in SciPy 1.11 to 1.17).
LARGE = 2**31


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
    tail: PolynomialTrend | None
    Q: Array  # (M, q), with q = 0 where there is no tail
    R: Array

    @classmethod
    def of(
        cls,
        sections: Sections,
        points: Array,
        nugget: Array,
        tail: PolynomialTrend | None,
    ) -> NativeBasis:
        """Factor the Gram matrix at the centres plus a diagonal `nugget`."""
        K, excess, norm = gram_matrix(sections, points, nugget)
        lower, info = cholesky(K, lower=True)
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
        K = matrix(self.sections, X)
        a = solve_triangular(self.lower, K.T, overwrite=True)
        if self.tail is None:
            return a, np.empty((0, len(X)))
        p = polynomial(X, self.tail.origin, self.tail.seen)
        return a, np.asarray(np.linalg.solve(self.R.T, p.T), dtype=np.float64)

    def design(self, X: Array) -> tuple[Array, Array]:
        """Evaluate a(x) less its part along Q, and all polynomials."""
        a, t = self.values(X)
        if self.tail is None:
            return a, t
        along = dgemm(1.0, self.Q, a, trans_a=1)
        a = dgemm(-1.0, self.Q, along, 1.0, a, overwrite_c=1)
        return a, np.vstack([t, polynomial(X, self.tail.origin, self.tail.unseen).T])

    def variance(self, X: Array) -> Array:
        """Evaluate the squared power function."""
        a, t = self.values(X)
        variance = self.sections.diagonal(X) - np.einsum("ij,ij->j", a, a)
        if self.tail is not None:
            t -= dgemm(1.0, self.Q, a, trans_a=1)
            variance += np.einsum("ij,ij->j", t, t)
        return np.maximum(variance, 0.0)

    def power(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the power function."""
        n_rows = block_rows(len(self.lower))
        return np.sqrt(by_rows(self.variance, X, n_rows, n_jobs))

    def functions(self, X: Array) -> Array:
        """Evaluate a basis of all estimates, of shape (dimension, rows).

        It is a(x) with the polynomials in the place of its part along Q, which makes
        L^-1 u the coordinates of the interpolant of u; then the polynomials that the
        centres do not see.
        """
        a, t = self.design(X)
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


def solve_triangular(
    lower: Array, b: Array, *, transpose: bool = False, overwrite: bool = False
) -> Array:
    x, info = dtrtrs(
        lower, b, lower=1, trans=int(transpose), overwrite_b=int(overwrite)
    )
    if info != 0:
        raise np.linalg.LinAlgError("the Gram matrix is singular")
    return x


def cholesky(K: Array, *, lower: bool, clean: bool = False) -> tuple[Array, int]:
    """Factor one triangle of a matrix in place; not zero if that is impossible."""
    with one_thread() if K.nbytes >= LARGE else nullcontext():
        factor, info = dpotrf(K, lower=int(lower), clean=int(clean), overwrite_a=1)
    return factor, info


def block_rows(n_centers: int) -> int:
    """Return how many rows to take at once: a triangular solve reads all the factor."""
    return min(max(2**18 // n_centers, n_centers // 16, 1), 2**13)
