"""Normal equations of least squares over the functions of a native basis.

With the values A of a(x), less their part along Q, and T of all polynomials on the
rows, they are

    [A A^T + alpha I   A T^T] [z]   [A y]
    [    T A^T         T T^T] [b] = [T y]

of which z is eliminated. Their sums over rows can be extended and added up.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from joblib import effective_n_jobs
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpocon, dpotri, dpotrs
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed

from sklearn_koopman._linalg._cholesky import NativeBasis, block_rows, cholesky
from sklearn_koopman._utils._typing import Array

# The outputs of a slice of the rows, so that many need not be held at once.
Outputs = Callable[[slice], Array]

# The loop stays with SciPy's BLAS: NumPy's wheels bring one of their own, and the idle
# threads of either slow down the other several times.

# Below this reciprocal condition number of the basis, its solutions are not trusted.
SUSPECT = 1e-10
# Products for which it is worth while to start workers: below, BLAS has threads.
PARALLEL_WORK = 1e11


@dataclass
class NormalEquations:
    """Sums over rows.

    The blocks of A A^T above its diagonal blocks lie in the upper triangle of an
    array, which may be the Cholesky factor of the basis: it leaves it unused, so that
    memory stays at one M x M matrix.
    """

    upper: Array  # (M, M) in Fortran order
    corners: list[Array]  # the diagonal blocks
    Ay: Array
    AT: Array
    Ty: Array
    TT: Array
    yy: Array  # (n_outputs,): sums of squares
    diagonal: float  # sum of k(x, x)

    @classmethod
    def empty(cls, basis: NativeBasis, upper: Array, n_outputs: int) -> NormalEquations:
        """Return the sums over no rows."""
        M = len(upper)
        n_terms = 0 if basis.tail is None else len(basis.tail.seen)
        for panel in _panels(M):
            upper[: panel.start, panel] = 0.0
        return cls(
            upper,
            [np.zeros((panel.stop - panel.start,) * 2) for panel in _panels(M)],
            np.zeros((M, n_outputs)),
            np.zeros((M, n_terms)),
            np.zeros((n_terms, n_outputs)),
            np.zeros((n_terms, n_terms)),
            np.zeros(n_outputs),
            0.0,
        )

    def copy(self) -> NormalEquations:
        """Return a copy that shares nothing."""
        return deepcopy(self)

    def widen(self, n_terms: int) -> None:
        """Take in polynomials that were zero on all rows."""
        self.AT = np.pad(self.AT, ((0, 0), (0, n_terms)))
        self.Ty = np.pad(self.Ty, ((0, n_terms), (0, 0)))
        self.TT = np.pad(self.TT, (0, n_terms))

    def add(self, basis: NativeBasis, X: Array, y: Outputs) -> None:
        """Add rows."""
        panels = _panels(len(self.upper))
        for rows in gen_batches(len(X), block_rows(len(self.upper))):
            a, t = basis.design(X[rows])
            values = y(rows)
            self.Ay += dgemm(1.0, a, values)
            if len(t):
                self.AT += dgemm(1.0, a, t, trans_b=1)
                self.Ty += dgemm(1.0, t, values)
                self.TT += dgemm(1.0, t, t, trans_b=1)
            for panel, corner in zip(panels, self.corners, strict=True):
                product = dgemm(1.0, a[: panel.stop], a[panel], trans_b=1)
                self.upper[: panel.start, panel] += product[: panel.start]
                corner += product[panel.start :]
            self.yy += np.einsum("ij,ij->j", values, values)
            self.diagonal += float(basis.sections.diagonal(X[rows]).sum())

    def merge(self, other: NormalEquations) -> None:
        """Add the sums over other rows."""
        for panel in _panels(len(self.upper)):
            self.upper[: panel.start, panel] += other.upper[: panel.start, panel]
        for corner, more in zip(self.corners, other.corners, strict=True):
            corner += more
        for name in ("Ay", "AT", "Ty", "TT", "yy"):
            sums = getattr(self, name)
            sums += getattr(other, name)
        self.diagonal += other.diagonal

    def solve(
        self, basis: NativeBasis, alpha: float, F: Array
    ) -> tuple[Array, Array, float]:
        """Return the solution, with F as working memory.

        Its lower triangle stays as it is. Where F is `upper`, the sums are lost.

        Returns
        -------
        z : ndarray of shape (M, n_outputs)
            Coordinates of the kernel part.
        b : ndarray of shape (n_terms, n_outputs)
            Coordinates of the polynomials: those the centres see, then the others.
        freedom : float
            Trace of the matrix that takes y to the fitted values.
        """
        M, q = len(F), basis.Q.shape[1]
        Ay, AT, Ty, TT = self.Ay, self.AT, self.Ty, self.TT
        n_terms = len(TT)
        lower_diagonal = F.diagonal().copy()
        # Along Q there is nothing but rounding: a number of the size that the rest may
        # have, by |a(x)|^2 <= k(x, x), makes that part of the matrix regular.
        along_Q = self.diagonal / M or 1.0
        trace = sum(float(np.trace(corner)) for corner in self.corners)
        for panel, corner in zip(_panels(M), self.corners, strict=True):
            if F is not self.upper:
                F[: panel.start, panel] = self.upper[: panel.start, panel]
            block = corner.copy()
            if q:
                product = along_Q * basis.Q[: panel.stop] @ basis.Q[panel].T
                F[: panel.start, panel] += product[: panel.start]
                block += product[panel.start :]
            block[np.diag_indices_from(block)] += alpha
            F[panel, panel] = np.triu(block) + np.tril(F[panel, panel], -1)

        _, info = cholesky(F, lower=False)
        norm = trace + q * along_Q + M * alpha
        rcond = 0.0 if info else float(dpocon(F, norm, uplo="U")[0])
        if info or rcond < min(1e-13, 1e-6 * basis.rcond):
            np.fill_diagonal(F, lower_diagonal)
            if basis.rcond < SUSPECT:
                raise np.linalg.LinAlgError(
                    "the normal matrix is not positive definite"
                )
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
        np.fill_diagonal(F, lower_diagonal)
        return z, b, freedom

    def residual_norms(self, z: Array, b: Array) -> Array:
        """Return |y - A^T z - T^T b| for every output.

        The digits of the squares that it is a difference of limit it to about 1e-8 of
        the outputs.
        """
        fitted = np.zeros_like(z)
        for panel, corner in zip(_panels(len(z)), self.corners, strict=True):
            block = self.upper[: panel.start, panel]
            fitted[: panel.start] += block @ z[panel]
            fitted[panel] += block.T @ z[: panel.start] + corner @ z[panel]
        squared = self.yy - np.einsum("ij,ij->j", z, 2 * self.Ay - fitted)
        rest = 2 * (self.Ty - self.AT.T @ z) - self.TT @ b
        squared -= np.einsum("ij,ij->j", b, rest)
        return np.sqrt(np.maximum(squared, 0.0))


def too_few_rows(n_rows: int, n_centers: int) -> ValueError:
    """Return the error of least squares without a penalty on so few rows."""
    return ValueError(
        f"method='least_squares' with alpha=0 needs at least as many rows as centres, "
        f"got {n_rows} rows and {n_centers} centres; set alpha > 0 or choose fewer "
        "centres."
    )


def least_squares(
    basis: NativeBasis,
    X: Array,
    y: Outputs,
    n_outputs: int,
    alpha: float,
    n_jobs: int | None = None,
) -> tuple[Array, Array, float]:
    """Minimise |y - g(X)|^2 + alpha |g|_H^2; see `NormalEquations.solve`."""
    F = basis.lower
    equations = normal_equations(basis, F, X, y, n_outputs, n_jobs)
    return equations.solve(basis, alpha, F)


def normal_equations(
    basis: NativeBasis,
    upper: Array,
    X: Array,
    y: Outputs,
    n_outputs: int,
    n_jobs: int | None = None,
) -> NormalEquations:
    """Sum up all rows; by joblib's workers, a share of the rows each, if asked."""
    equations = NormalEquations.empty(basis, upper, n_outputs)
    n_workers = effective_n_jobs(n_jobs)
    if n_workers == 1 or len(X) * len(upper) ** 2 < PARALLEL_WORK:
        equations.add(basis, X, y)
        return equations
    try:
        parallel = Parallel(n_jobs=n_jobs, return_as="generator")
    except ValueError:  # not every backend returns its results one by one
        parallel = Parallel(n_jobs=n_jobs)
    parts = parallel(
        delayed(_share)(basis, X[rows], y(rows))
        for rows in gen_batches(len(X), -(-len(X) // n_workers))
    )
    for part in parts:
        equations.merge(part)
    return equations


def _share(basis: NativeBasis, X: Array, y: Array) -> NormalEquations:
    upper = np.empty(basis.lower.shape, order="F")
    equations = NormalEquations.empty(basis, upper, y.shape[1])
    equations.add(basis, X, y.__getitem__)
    return equations


def _panels(M: int) -> list[slice]:
    return list(gen_batches(M, max(64, M // 32)))
