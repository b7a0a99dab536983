"""Systems that grow with their data: block updates of the Cholesky factor."""

from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.blas import dgemm

from .._matrices._polynomial import PolynomialTrend
from .._matrices._sections import KernelSections, gram_matrix, matrix
from .._utils._rows import total_weight
from .._utils._typing import Array
from ._cholesky import MIN_RCOND, exact_rcond, pivot_rcond
from ._fit import Fit, check_trend_determined, relative_error, scale_residuals
from ._least_squares import NormalEquations
from ._systems import DirectSystem

# Blocks of a factor are joined if there are more, or if the added rows are more than
# this part of the first ones.
MAX_BLOCKS = 64
MAX_ADDED_PART = 0.25
# The pivots of a factor may bound the condition number this many times too low.
PIVOT_OPTIMISM = 1e4
# Centres at which a suspect interpolant is verified, besides those that changed.
VERIFIED_CENTERS = 128


class GrowingSystem(DirectSystem):
    """A direct system that takes further centres.

    The Cholesky factor is a list of blocks of rows, in Fortran order and of shape
    (rows, columns up to their last), so that added rows need no copy of the others.
    The values u and the monomials at the centres stay transformed by the inverse of
    the factor, which added rows do not change.
    """

    def __init__(self, system: DirectSystem, u: Array) -> None:
        vars(self).update(vars(system))
        # What was dropped before is forgotten.
        self.offered, self.offered_nugget = self.sections, self.nugget
        self.kept = np.arange(self.sections.size)
        self.changed = self.kept[:0]
        self.n_first = system.sections.size
        self.blocks = [self.__dict__.pop("lower")]
        self.origin = self.sections.points[0].copy()
        self.u = u
        self.transformed_u = self._forward(u)
        self.transformed_monomials = self._forward(
            self._monomials(self.sections.points)
        )

    @property
    def lower(self) -> Array:  # type: ignore[override]
        """The factor in one piece; what is above its diagonal has no meaning."""
        if len(self.blocks) > 1:
            M = self.blocks[-1].shape[1]
            L = np.empty((M, M), order="F")
            for block in self.blocks:
                start, stop = block.shape[1] - len(block), block.shape[1]
                L[start:stop, :stop] = block
            self.blocks = [L]
        return self.blocks[0]

    def extended(self, sections: KernelSections, nugget: Array, u: Array) -> Self:
        """Return the system with added centres, the last ones of the sections.

        `nugget` and `u` are those of all centres; the nugget of the earlier ones must
        not have changed. O(k M^2) operations for k centres.

        Raises
        ------
        LinAlgError
            If the matrix has too few digits for that. This system stays as it is.
        """
        grown = copy(self)
        grown.blocks = list(self.blocks)
        M = self.sections.size
        same = np.array_equal(sections.centers[:M], self.sections.points)
        if not (same and np.array_equal(nugget[:M], self.nugget)):
            raise np.linalg.LinAlgError("earlier centres or weights have changed")
        if sections.size > M:
            grown._add_centers(sections, nugget, u)
        differs = (u[:M] != self.u).any(axis=1)
        if differs.any():
            grown.transformed_u = grown._forward(u)
        grown.u = u
        grown.changed = np.append(np.flatnonzero(differs), np.arange(M, len(u)))
        return grown

    def interpolate(self, u: Array, negligible: float = 0.0) -> Fit:
        """Return the function with the values u at the centres.

        Raises
        ------
        LinAlgError
            If the function misses its values.
        """
        v = self.transformed_u if u is self.u else self._forward(u)
        b = self.Q.T @ v
        z = v - self.Q @ b
        expansion = self._expand(z, b)
        if self.is_suspect:
            rows = np.arange(0, len(u), max(len(u) // VERIFIED_CENTERS, 1))
            # Errors are largest where sections nearly cancel: at what was added.
            rows = np.union1d(rows, self.changed)
            reached = expansion(self.sections.points[rows])
            reached += self.excess[rows, np.newaxis] * expansion.dual_coef[rows]
            self._verify(relative_error(reached, u[rows]))
        return Fit(expansion, np.linalg.norm(z, axis=0), len(z))

    def rcond(self) -> float:
        """Bound the reciprocal condition number from above, in O(M^2).

        It is hardly larger than that of the first centres alone, or than the pivots
        allow.
        """
        first = self.lower[: self.n_first, : self.n_first]
        pivots = self.lower.diagonal()
        return min(exact_rcond(first, self.norm), pivot_rcond(pivots))

    def _add_centers(self, sections: KernelSections, nugget: Array, u: Array) -> None:
        M = self.sections.size
        new = np.arange(M, sections.size)
        added_sections = sections.take(new)
        corner, excess, _ = gram_matrix(added_sections, nugget[new])
        added = self._forward(matrix(self.sections, added_sections.centers).T)
        remainder = dgemm(-1.0, added, added, 1.0, corner, trans_a=1)
        lower = cholesky(remainder, lower=True, overwrite_a=True, check_finite=False)
        diagonals = [block[:, -len(block) :].diagonal() for block in self.blocks]
        pivots = np.concatenate([*diagonals, lower.diagonal()])
        bound = pivot_rcond(pivots)
        self.rough_rcond = min(self.rough_rcond, bound / PIVOT_OPTIMISM)
        if not bound > MIN_RCOND:
            raise np.linalg.LinAlgError("the Gram matrix is not positive definite")

        def continued(before: Array, values: Array) -> Array:
            rest = values - dgemm(1.0, added, before, trans_a=1)
            after = solve_triangular(lower, rest, lower=True, check_finite=False)
            return np.vstack([before, after])

        self.transformed_u = continued(self.transformed_u, u[new])
        monomials = self._monomials(added_sections.centers)
        self.transformed_monomials = continued(self.transformed_monomials, monomials)
        self.blocks.append(np.asfortranarray(np.hstack([added.T, lower])))
        self.sections = self.offered = sections
        self.kept = np.arange(sections.size)
        self.nugget = self.offered_nugget = nugget
        self.excess = np.append(self.excess, excess)
        n_added = sum(len(block) for block in self.blocks[1:])
        few = n_added <= MAX_ADDED_PART * len(self.blocks[0])
        if not few or len(self.blocks) > MAX_BLOCKS:
            _ = self.lower
        self.Q = np.empty((len(pivots), 0))
        if self.degree is not None:
            self.trend = PolynomialTrend.at(sections.centers, self.degree)
            # The same polynomials in the monomials about the first origin.
            coefficients = self.trend.coefficients.copy()
            if self.degree == 1:
                coefficients[0] += (self.origin - self.trend.origin) @ coefficients[1:]
            self.Q, self.R = np.linalg.qr(self.transformed_monomials @ coefficients)
        self.trend_rank = self.Q.shape[1]

    def _monomials(self, points: Array) -> Array:
        if self.degree is None:
            return np.empty((len(points), 0))
        ones = np.ones((len(points), 1))
        return ones if self.degree == 0 else np.hstack([ones, points - self.origin])

    def _forward(self, b: Array, overwrite: bool = False) -> Array:
        x = np.array(b, order="F")
        for block in self.blocks:
            start, stop = block.shape[1] - len(block), block.shape[1]
            rest = x[start:stop]
            if start:
                rest = dgemm(-1.0, block[:, :start], x[:start], 1.0, rest)
            x[start:stop] = solve_triangular(
                block[:, start:], rest, lower=True, check_finite=False
            )
        return x

    def _backward(self, v: Array) -> Array:
        x = np.array(v, order="F")
        for block in reversed(self.blocks):
            start, stop = block.shape[1] - len(block), block.shape[1]
            own = solve_triangular(
                block[:, start:], x[start:stop], lower=True, trans=1, check_finite=False
            )
            x[start:stop] = own
            if start:
                x[:start] -= dgemm(1.0, block[:, :start], own, trans_a=1)
        return x


@dataclass
class GrowingLeastSquares:
    """Least squares at fixed centres over rows that are added up."""

    system: DirectSystem
    equations: NormalEquations
    weight: float  # of all rows; their number if they have none

    @classmethod
    def over(
        cls, system: DirectSystem, X: Array, y: Array, weights: Array | None = None
    ) -> Self:
        """Start with the first rows."""
        equations = NormalEquations.empty(system, system.lower, y.shape[1])
        check_trend_determined(system.degree, X, system.sections.points)
        equations.add(system, X, y.__getitem__, weights)
        return cls(system, equations, total_weight(X, weights))

    def add(
        self, X: Array, y: Array, alpha: float, weights: Array | None = None
    ) -> Fit:
        """Add rows and return `fit`; if there is none, the rows do not count."""
        check_trend_determined(self.system.degree, X, self.system.sections.points)
        weight, before = self.weight, self.equations.copy()
        try:
            self.equations.add(self.system, X, y.__getitem__, weights)
            self.weight += total_weight(X, weights)
            return self.fit(X, alpha)
        except BaseException:  # of a kernel, or an interruption, too
            np.copyto(self.equations.upper, before.upper)
            before.upper = self.equations.upper
            self.weight, self.equations = weight, before
            raise

    def fit(self, X: Array, alpha: float) -> Fit:
        """Return the fit, verified at these rows.

        Raises
        ------
        LinAlgError
            If rounding leaves too few digits.
        """
        system = self.system
        F = np.empty_like(system.lower)
        z, b, dof = self.equations.solve(system, alpha, F)
        norms = self.equations.residual_norms(z, b)
        noise_std = scale_residuals(norms, self.weight, dof)
        return system.fit_at(X, z, b, dof)._replace(noise_std=noise_std)
