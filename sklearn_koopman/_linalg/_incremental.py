"""Estimates that grow with their data: block updates of the Cholesky factor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf

from sklearn_koopman._linalg._cholesky import SINGULAR, NativeBasis, solve_triangular
from sklearn_koopman._linalg._direct import (
    ACCURACY,
    Solution,
    column_norms,
    evaluate,
    fitted,
    relative_error,
)
from sklearn_koopman._linalg._least_squares import (
    SUSPECT,
    NormalEquations,
    too_few_rows,
)
from sklearn_koopman._matrices._polynomial import PolynomialTrend
from sklearn_koopman._matrices._sections import Sections, gram_matrix, matrix
from sklearn_koopman._utils._typing import Array, Indices

# A factor is put together when rows have been added so many times, or so many rows in
# relation to those before.
TIMES = 64
GROWN = 0.25
# The bound of the reciprocal condition number by pivots is this much too high.
OPTIMISM = 1e3
# Centres at which a suspect interpolant is verified.
VERIFIED = 128


@dataclass
class GrowingFactor:
    """A Cholesky factor in blocks of rows: added ones need no copy of the others."""

    blocks: list[Array]  # in Fortran order, of shape (rows, columns up to their last)

    def __len__(self) -> int:
        return self.blocks[-1].shape[1]

    def diagonal(self) -> Array:
        """Return its diagonal."""
        return np.concatenate(
            [block[:, -len(block) :].diagonal() for block in self.blocks]
        )

    def forward(self, b: Array) -> Array:
        """Return L^-1 b."""
        x = np.array(b, order="F")
        for block in self.blocks:
            start, stop = block.shape[1] - len(block), block.shape[1]
            rest = x[start:stop]
            if start:
                rest = dgemm(-1.0, block[:, :start], x[:start], 1.0, rest)
            x[start:stop] = solve_triangular(_square(block), rest)
        return x

    def backward(self, v: Array) -> Array:
        """Return L^-T v."""
        x = np.array(v, order="F")
        for block in reversed(self.blocks):
            start, stop = block.shape[1] - len(block), block.shape[1]
            own = solve_triangular(_square(block), x[start:stop], transpose=True)
            x[start:stop] = own
            if start:
                x[:start] -= dgemm(1.0, block[:, :start], own, trans_a=1)
        return x

    def extend(self, added: Array, lower: Array) -> None:
        """Add rows: L^-1 times the columns of the matrix, and their own factor."""
        self.blocks.append(np.asfortranarray(np.hstack([added.T, lower])))
        grown = sum(len(block) for block in self.blocks[1:])
        if grown > GROWN * len(self.blocks[0]) or len(self.blocks) > TIMES:
            self.join()

    def join(self) -> Array:
        """Put the blocks together, and return them as one array.

        What is above its diagonal has no meaning.
        """
        if len(self.blocks) > 1:
            L = np.empty((len(self), len(self)), order="F")
            for block in self.blocks:
                start, stop = block.shape[1] - len(block), block.shape[1]
                L[start:stop, :stop] = block
            self.blocks = [L]
        return self.blocks[0]


def _square(block: Array) -> Array:
    size = len(block)
    return block if block.shape[1] == size else block[:, -size:]


@dataclass
class GrowingInterpolant:
    """An interpolant that takes more centres.

    The values u at the centres and the monomials of the tail stay transformed by the
    inverse of the factor, which added rows do not change.
    """

    sections: Sections
    centers: Array
    excess: Array
    rcond: float  # an upper bound, once centres have been added
    tail: PolynomialTrend | None
    Q: Array
    R: Array
    factor: GrowingFactor
    v: Array  # L^-1 u
    VP: Array  # L^-1 times the monomials 1 and x - origin, without a tail no columns
    origin: Array

    @classmethod
    def of(cls, basis: NativeBasis, centers: Array, u: Array) -> GrowingInterpolant:
        """Continue from the basis of an interpolant of u."""
        factor = GrowingFactor([basis.lower])
        origin = centers[0].copy()
        return cls(
            basis.sections,
            centers,
            basis.excess,
            basis.rcond,
            basis.tail,
            basis.Q,
            basis.R,
            factor,
            factor.forward(u),
            factor.forward(_monomials(basis.tail, centers, origin)),
            origin,
        )

    def native(self) -> NativeBasis:
        """Return the basis with its factor in one piece."""
        return NativeBasis(
            self.sections,
            self.factor.join(),
            self.excess,
            self.rcond,
            self.tail,
            self.Q,
            self.R,
        )

    def extend(
        self, sections: Sections, points: Array, nugget: Array, u: Array
    ) -> None:
        """Add centres, the last ones of the sections, with their values.

        Raises
        ------
        LinAlgError
            If the factor has no digits to spare for that. Nothing is changed then.
        """
        M = len(self.centers)
        new = np.arange(M, M + len(points))
        corner, excess, _ = gram_matrix(sections.take(new), points, nugget)
        added = self.factor.forward(matrix(self.sections, points).T)
        left = dgemm(-1.0, added, added, 1.0, corner, trans_a=1)
        lower, info = dpotrf(left, lower=1, clean=0, overwrite_a=1)
        pivots = np.append(self.factor.diagonal(), lower.diagonal())
        rcond = min(self.rcond, float(pivots.min() / pivots.max()) ** 2)
        if info != 0 or not rcond > SINGULAR:
            raise np.linalg.LinAlgError("the Gram matrix is not positive definite")

        def continued(before: Array, values: Array) -> Array:
            rest = values - dgemm(1.0, added, before, trans_a=1)
            return np.vstack([before, solve_triangular(lower, rest)])

        self.v = continued(self.v, u)
        if self.tail is not None:
            monomials = _monomials(self.tail, points, self.origin)
            self.VP = continued(self.VP, monomials)
        self.factor.extend(added, lower)
        self.sections = sections
        self.centers = np.vstack([self.centers, points])
        self.excess = np.append(self.excess, excess)
        self.rcond = rcond
        if self.tail is not None:
            degree = 0 if len(self.tail.seen) == 1 else 1
            self.tail = PolynomialTrend.on(self.centers, degree, self.centers)
            # The same polynomials in the monomials about the first origin.
            seen = self.tail.seen.copy()
            if degree == 1:
                seen[0] += (self.origin - self.tail.origin) @ seen[1:]
            self.Q, self.R = np.linalg.qr(self.VP @ seen)
        else:
            self.Q = np.empty((len(self.centers), 0))

    def solution(self, u: Array) -> Solution[GrowingInterpolant]:
        """Return the interpolant of u.

        Raises
        ------
        LinAlgError
            If it misses its values.
        """
        b = self.Q.T @ self.v
        z = self.v - self.Q @ b
        dual = self.factor.backward(z)
        trend = np.empty((0, z.shape[1]))
        if self.tail is not None:
            trend = self.tail.seen @ np.linalg.solve(self.R, b)
        if self.rcond < OPTIMISM * SUSPECT:
            some = np.arange(0, len(u), max(len(u) // VERIFIED, 1))
            reached = evaluate(
                self.sections, self.tail, self.centers[some], dual, trend
            )
            reached += self.excess[some, np.newaxis] * dual[some]
            if relative_error(reached, u[some]) > ACCURACY:
                raise np.linalg.LinAlgError("the interpolant misses its values")
        kept = np.arange(len(z))
        return Solution(self, kept, dual, trend, column_norms(z), len(z), 0.0)


def _monomials(tail: PolynomialTrend | None, centers: Array, origin: Array) -> Array:
    if tail is None:
        return np.empty((len(centers), 0))
    ones = np.ones((len(centers), 1))
    return ones if len(tail.seen) == 1 else np.hstack([ones, centers - origin])


@dataclass
class GrowingRegression:
    """Least squares at fixed centres over rows that are added up."""

    basis: NativeBasis
    kept: Indices  # which of the centres offered carry the estimate
    equations: NormalEquations
    n_rows: int

    @classmethod
    def of(cls, basis: NativeBasis, kept: Indices, n_outputs: int) -> GrowingRegression:
        """Start without rows."""
        equations = NormalEquations.empty(basis, basis.lower, n_outputs)
        return cls(basis, kept, equations, 0)

    def add(self, X: Array, y: Array) -> None:
        """Add rows."""
        tail = self.basis.tail
        if tail is not None and len(tail.seen) > 1:
            self._widen(tail, X)
        self.equations.add(self.basis, X, y.__getitem__)
        self.n_rows += len(X)

    def _widen(self, tail: PolynomialTrend, X: Array) -> None:
        """Give features that have been constant until now their polynomials."""
        known = np.hstack([tail.seen, tail.unseen])[1:]
        away = np.abs(X - tail.origin).max(axis=0)
        new = ~known.any(axis=1) & (away > 1e-13 * np.abs(tail.origin))
        if new.any():
            added = np.zeros((len(tail.seen), int(new.sum())))
            added[1 + np.flatnonzero(new), np.arange(new.sum())] = 1 / away[new]
            tail = replace(tail, unseen=np.hstack([tail.unseen, added]))
            self.basis = replace(self.basis, tail=tail)
            self.equations.widen(int(new.sum()))

    def learn(
        self, X: Array, y: Array, alpha: float
    ) -> tuple[Solution[NativeBasis], Array]:
        """Add rows and return `solution`; if there is none, the rows do not count."""
        basis, n_rows, before = self.basis, self.n_rows, self.equations.copy()
        try:
            self.add(X, y)
            return self.solution(alpha, X)
        except ValueError:
            np.copyto(self.equations.upper, before.upper)
            before.upper = self.equations.upper
            self.basis, self.n_rows, self.equations = basis, n_rows, before
            raise

    def solution(self, alpha: float, X: Array) -> tuple[Solution[NativeBasis], Array]:
        """Return the estimate, verified on these rows, and the norms of its residuals.

        Raises
        ------
        LinAlgError
            If rounding leaves too few digits.
        """
        basis = self.basis
        if alpha == 0 and self.n_rows < len(basis.lower):
            raise too_few_rows(self.n_rows, len(basis.lower))
        F = np.empty_like(basis.lower)
        z, b, freedom = self.equations.solve(basis, alpha, F)
        residual = self.equations.residual_norms(z, b)
        solution = fitted(basis, np.arange(len(z)), X, z, b, freedom)
        if solution.error > ACCURACY:
            raise np.linalg.LinAlgError(
                f"the solution misses its values by {solution.error:.1e}"
            )
        return solution, residual
