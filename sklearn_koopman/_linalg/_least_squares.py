"""Normal equations of least squares over the functions of a direct system.

With the values A of a(x), less their part along Q, and T of the polynomials on the
rows, they are

    [A A^T + alpha I   A T^T] [z]   [A y]
    [    T A^T         T T^T] [b] = [T y]

of which z is eliminated. Their sums over rows can be extended and added up. Where rows
have weights, A, T and y are multiplied by the roots of these.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from joblib import effective_n_jobs
from scipy.linalg.blas import dgemm, dsymm, dsyrk
from scipy.linalg.lapack import dpotri, dpotrs
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed

from .._matrices._sections import Sections
from .._utils._typing import Array
from ._cholesky import RCOND_TO_VERIFY, cholesky, exact_rcond, rows_per_block

# The outputs of a slice of the rows, so that many need not be held at once.
Outputs = Callable[[slice], Array]

# The loop stays with SciPy's BLAS: NumPy's wheels bring one of their own, and the idle
# threads of either slow down the other several times.

# Operations from which on it is worth while to start workers: below, BLAS has threads.
PARALLEL_OPERATIONS = 1e11
# Normal matrices with a smaller reciprocal condition number count as singular.
MIN_NORMAL_RCOND = 1e-13
# Polynomials of length one, of which less than this part of the squared length is left
# beside the kernel part, are not determined by the rows.
MIN_SQUARED_LENGTH = 1e-14


class OrthonormalBasis(Protocol):
    """What the equations need of a direct system."""

    sections: Sections
    lower: Array
    rough_rcond: float
    Q: Array

    def design(self, X: Array) -> tuple[Array, Array]:
        """Evaluate a(x) less its part along Q, and the polynomials."""


@dataclass
class NormalEquations:
    """Sums over rows.

    A A^T lies above the diagonal of an array that may be the Cholesky factor of the
    basis, which leaves that part unused: so memory stays at one M x M matrix.
    """

    upper: Array  # (M, M) in Fortran order
    squares: Array  # (M,): the diagonal of A A^T
    Ay: Array
    AT: Array
    Ty: Array
    TT: Array
    yy: Array  # (n_outputs,): sums of squares
    diagonal: float  # sum of k(x, x)

    @classmethod
    def empty(cls, basis: OrthonormalBasis, upper: Array, n_outputs: int) -> Self:
        """Return the sums over no rows."""
        M, q = basis.Q.shape
        for column in range(1, M):
            upper[:column, column] = 0.0
        Ay, Ty = np.zeros((M, n_outputs)), np.zeros((q, n_outputs))
        AT, TT = np.zeros((M, q)), np.zeros((q, q))
        return cls(upper, np.zeros(M), Ay, AT, Ty, TT, np.zeros(n_outputs), 0.0)

    def copy(self) -> Self:
        """Return a copy that shares nothing."""
        return deepcopy(self)

    def add(
        self,
        basis: OrthonormalBasis,
        X: Array,
        y: Outputs,
        weights: Array | None = None,
    ) -> None:
        """Add rows."""
        for rows in gen_batches(len(X), rows_per_block(len(self.upper))):
            a, t = basis.design(X[rows])
            values, diagonal = y(rows), basis.sections.diagonal(X[rows])
            if weights is not None:
                root = np.sqrt(weights[rows])
                a *= root
                t *= root
                values = values * root[:, np.newaxis]
                diagonal = diagonal * weights[rows]
            with _diagonal(self.upper, self.squares):
                dsyrk(1.0, a, 1.0, self.upper, overwrite_c=1)
            self.Ay += dgemm(1.0, a, values)
            if len(t):
                self.AT += dgemm(1.0, a, t, trans_b=1)
                self.Ty += dgemm(1.0, t, values)
                self.TT += dgemm(1.0, t, t, trans_b=1)
            self.yy += np.einsum("ij,ij->j", values, values)
            self.diagonal += float(diagonal.sum())

    def merge(self, other: Self) -> None:
        """Add the sums over other rows."""
        for column in range(1, len(self.upper)):
            self.upper[:column, column] += other.upper[:column, column]
        for name in ("squares", "Ay", "AT", "Ty", "TT", "yy", "diagonal"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def solve(
        self, basis: OrthonormalBasis, alpha: float, F: Array
    ) -> tuple[Array, Array, float]:
        """Return the solution, with F as working memory.

        Its lower triangle stays as it is. Where F is `upper`, the sums are lost.

        Returns
        -------
        z : ndarray of shape (M, n_outputs)
            Coordinates of the kernel part.
        b : ndarray of shape (n_terms, n_outputs)
            Coordinates of the polynomials.
        dof : float
            Effective number of parameters: the trace of the matrix that takes y to
            the fitted values.
        """
        with _diagonal(F, self.squares.copy()):
            if F is not self.upper:
                for column in range(1, len(F)):
                    F[:column, column] = self.upper[:column, column]
            return self._solve(basis, alpha, F)

    def _solve(
        self, basis: OrthonormalBasis, alpha: float, N: Array
    ) -> tuple[Array, Array, float]:
        Q, AT, TT = basis.Q, self.AT, self.TT
        M, q = Q.shape
        # Along Q there is nothing but rounding: a number of the size that the rest may
        # have, by |a(x)|^2 <= k(x, x), makes that part of the matrix regular.
        along_Q = self.diagonal / M or 1.0
        if q:
            dsyrk(along_Q, Q, 1.0, N, overwrite_c=1)
        N[np.diag_indices(M)] += alpha
        if not _factor(N, min(MIN_NORMAL_RCOND, 1e-6 * basis.rough_rcond)):
            if basis.rough_rcond < RCOND_TO_VERIFY:
                raise np.linalg.LinAlgError(
                    "the normal matrix is not positive definite"
                )
            raise ValueError(
                f"method='least_squares' with alpha={alpha}: the rows of X do not "
                f"determine the coefficients of {M} centres; set alpha > 0, or choose "
                "fewer centres, nearer to the rows."
            )
        solved, _ = dpotrs(N, np.hstack([AT, self.Ay]), lower=0)
        N_AT, N_Ay = solved[:, :q], solved[:, q:]
        # In units in which every polynomial has length one on the rows. Those that the
        # rows do not distinguish from the kernel part, or at all, are left at zero.
        length = np.sqrt(TT.diagonal())
        unit = np.divide(1.0, length, out=np.zeros(q), where=length > 0)
        lengths, axes = np.linalg.eigh(unit[:, np.newaxis] * (TT - AT.T @ N_AT) * unit)
        determined = lengths > MIN_SQUARED_LENGTH
        axes = unit[:, np.newaxis] * axes[:, determined]
        inverse = axes / lengths[determined] @ axes.T
        b = inverse @ (self.Ty - AT.T @ N_Ay)
        z = N_Ay - N_AT @ b
        z -= Q @ (Q.T @ z)

        dof = float(determined.sum() + M - q)
        if alpha > 0:
            dpotri(N, lower=0, overwrite_c=1)
            shrunk = np.trace(N) - q / (alpha + along_Q)
            shrunk += np.sum(inverse * (N_AT.T @ N_AT))
            dof -= float(alpha * shrunk)
        return z, b, dof

    def residual_norms(self, z: Array, b: Array) -> Array:
        """Return |y - A^T z - T^T b| for every output.

        The digits of the squares that it is a difference of limit it to about 1e-8 of
        the outputs.
        """
        with _diagonal(self.upper, self.squares):
            fitted = dsymm(1.0, self.upper, z)
        squared = self.yy - np.einsum("ij,ij->j", z, 2 * self.Ay - fitted)
        rest = 2 * (self.Ty - self.AT.T @ z) - self.TT @ b
        squared -= np.einsum("ij,ij->j", b, rest)
        return np.sqrt(np.maximum(squared, 0.0))


def least_squares(
    basis: OrthonormalBasis,
    X: Array,
    y: Outputs,
    n_outputs: int,
    alpha: float,
    n_jobs: int | None = None,
    weights: Array | None = None,
) -> tuple[Array, Array, float]:
    """Minimise |y - g(X)|^2 + alpha |g|_H^2; see `NormalEquations.solve`."""
    F = basis.lower
    equations = sum_normal_equations(basis, F, X, y, n_outputs, n_jobs, weights)
    return equations.solve(basis, alpha, F)


def sum_normal_equations(
    basis: OrthonormalBasis,
    upper: Array,
    X: Array,
    y: Outputs,
    n_outputs: int,
    n_jobs: int | None = None,
    weights: Array | None = None,
    parallel_operations: float = PARALLEL_OPERATIONS,
) -> NormalEquations:
    """Sum over all rows; by joblib's workers, a share of the rows each, if asked."""
    equations = NormalEquations.empty(basis, upper, n_outputs)
    n_workers = effective_n_jobs(n_jobs)
    if n_workers == 1 or len(X) * len(basis.Q) ** 2 < parallel_operations:
        equations.add(basis, X, y, weights)
        return equations
    try:
        parallel = Parallel(n_jobs=n_jobs, return_as="generator")
    except ValueError:  # not every backend returns its results one by one
        parallel = Parallel(n_jobs=n_jobs)
    parts = parallel(
        delayed(_sum_share)(
            basis, X[rows], y(rows), None if weights is None else weights[rows]
        )
        for rows in gen_batches(len(X), -(-len(X) // n_workers))
    )
    for part in parts:
        equations.merge(part)
    return equations


def _sum_share(
    basis: OrthonormalBasis, X: Array, y: Array, weights: Array | None
) -> NormalEquations:
    upper = np.empty(basis.lower.shape, order="F")
    equations = NormalEquations.empty(basis, upper, y.shape[1])
    equations.add(basis, X, y.__getitem__, weights)
    return equations


@contextmanager
def _diagonal(F: Array, diagonal: Array) -> Iterator[None]:
    """Give the upper triangle of an array a diagonal apart from that of the lower."""
    lower = F.diagonal().copy()
    np.fill_diagonal(F, diagonal)
    try:
        yield
    finally:
        diagonal[:] = F.diagonal()
        np.fill_diagonal(F, lower)


def _factor(N: Array, min_rcond: float) -> bool:
    """Factor a normal matrix in place, and return whether it is regular."""
    norm = float(np.trace(N))
    try:
        cholesky(N, lower=False)
    except np.linalg.LinAlgError:
        return False
    return exact_rcond(N, norm, lower=False) >= min_rcond
