"""Systems of equations with the Gram matrix of the centres, direct or iterative.

A system is made once for its centres, and then finds interpolants, least-squares fits
and the power function. :class:`DirectSystem` has a Cholesky factor, and
:class:`~sklearn_koopman._linalg._iterative.IterativeSystem` only products with the
matrix. :class:`~sklearn_koopman._linalg._incremental.GrowingSystem` is a direct one
that takes further centres.

Errors follow one rule. A `LinAlgError` means that there are too few digits: a direct
system then tries again with fewer centres, or a growing one is factored anew. Any other
`ValueError` is for the user.

A direct system works in an orthonormal basis of the native space. With the Gram matrix
K = L L^T, the vector a(x) = L^-1 k(Xi, x) holds the values of that basis at x. The
function a(x)^T w has the native norm |w| and the coefficients L^-T w on the kernel
sections. So interpolation is w = L^-1 u, and least squares is an ordinary ridge
regression on a(x), whose matrix has the square root of the condition number that the
kernel sections themselves would give it.
"""

import os
from collections.abc import Callable
from typing import Protocol, TypeVar, cast

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpocon, dtrtri
from sklearn.base import clone

from .._matrices._polynomial import PolynomialTrend
from .._matrices._sections import (
    KernelExpansion,
    KernelSections,
    Sections,
    gram_matrix,
    matrix,
    sparse_tree,
)
from .._utils._parallel import by_rows
from .._utils._rows import total_weight
from .._utils._typing import Array, Indices
from ..solvers import ConjugateGradient
from ._cholesky import RCOND_TO_VERIFY, factorize, independent_centers, rows_per_block
from ._fit import (
    REMEDY,
    Fit,
    check_rows_suffice,
    check_trend_determined,
    estimate_noise,
    negligible_tolerance,
    no_estimate,
    relative_error,
    warn_dropped,
)
from ._iterative import IterativeSystem
from ._least_squares import least_squares

T = TypeVar("T")

METHODS = ("interpolation", "least_squares")
SOLVERS = ("auto", "pivoted_cholesky", "cholesky")
# Largest error, relative to the values to be met, that passes the verification. Large
# coefficients of alternating sign cost smooth kernels this much without harm, while
# leaving out more centres would cost them more.
ACCURACY = 1e-6
# Rows at which a least-squares fit is verified.
VERIFIED_ROWS = 64
# Up to so many centres a dense matrix is a matter of a second, ...
DENSE_CENTERS = 5000
# ... and it may take this part of the memory, with what is needed beside it.
DENSE_MEMORY = 0.5
DENSE_OVERHEAD = 1.3


class System(Protocol):
    """The Gram matrix of the centres, ready to be solved with."""

    kept: Indices  # which of the centres offered have been kept
    nugget: Array  # what their diagonal has in addition
    trend: PolynomialTrend | None
    trend_rank: int  # number of polynomials that the centres determine

    @property
    def sections(self) -> Sections:
        """The kernel sections of the centres that are kept."""

    @property
    def solver(self) -> str | ConjugateGradient:
        """The solver that is used."""

    def interpolate(self, u: Array, negligible: float = 0.0) -> Fit:
        """Return the function with the values u at the centres."""

    def least_squares(
        self,
        X: Array,
        y: Array,
        alpha: float,
        n_jobs: int | None = None,
        weights: Array | None = None,
    ) -> Fit:
        """Return the function g that minimises |y - g(X)|^2 + alpha |g|_H^2.

        With weights of the rows, the squares are multiplied by them.
        """

    def power(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the power function."""


def make_system(
    sections: Sections,
    nugget: Array,
    degree: int | None,
    solver: str | ConjugateGradient,
    *,
    extent: Array | None = None,
    n_jobs: int | None = None,
) -> System:
    """Make a direct or an iterative system, as the parameter `solver` asks.

    Parameters
    ----------
    sections : Sections
        The kernel sections of the centres.
    nugget : ndarray of shape (M,)
        What is added to the diagonal of the Gram matrix.
    degree : int or None
        Degree of the polynomial trend.
    solver : str or ConjugateGradient
        The parameter of the estimators.
    extent : ndarray of shape (2, n_features), default=None
        Smallest and largest values of the features, which show what varies, for a
        trend; those of the centres if None.
    n_jobs : int, default=None
        Threads for products with a matrix that is not held.

    Returns
    -------
    system : System
        A direct or an iterative system.

    Raises
    ------
    ValueError
        If there is no solution, or if the solver cannot be used for this kernel.
    """
    if solver == "auto":
        dense = is_dense_affordable(sections)
        solver = "pivoted_cholesky" if dense else ConjugateGradient()
    if isinstance(solver, ConjugateGradient):
        assert isinstance(sections, KernelSections)
        return IterativeSystem(sections, nugget, degree, clone(solver), extent, n_jobs)
    return DirectSystem(sections, nugget, degree, solver, extent)


def interpolate_every_row(
    system: System,
    u: Array,
    X: Array,
    y: Array,
    alpha: float,
    n_jobs: int | None,
    weights: Array | None = None,
) -> Fit:
    """Return the least-squares fit of all rows if every row is a centre.

    By the representer theorem its coefficients are (K + alpha I)^-1 u: it is the
    interpolant of the outputs u, means of equal rows, with alpha on the diagonal, over
    the weight of the rows.
    """
    fit = system.interpolate(u, negligible_tolerance(total_weight(X, weights), alpha))
    if alpha > 0:
        return fit
    dof = fit.effective_dof
    noise_std = estimate_noise(fit.expansion, X, y, dof, n_jobs, weights)
    return fit._replace(noise_std=noise_std)


def restore_system(
    sections: Sections,
    nugget: Array,
    degree: int | None,
    solver: str = "pivoted_cholesky",
) -> "DirectSystem":
    """Make the system of a fitted estimator anew, which a pickle does not hold."""
    try:
        # Centres that were dropped are not among these, and no other may be now.
        system = DirectSystem(sections, nugget, degree, "cholesky")
        system.solver = solver
        return system
    except ValueError as error:
        raise ValueError(
            "The Gram matrix, not pickled, was barely positive definite where the "
            "model was fitted, and is not on this machine: predictions are all that "
            f"is left. Fit again, here. {REMEDY}"
        ) from error


def is_dense_affordable(
    sections: Sections, memory: float | None = None, dense_centers: int = DENSE_CENTERS
) -> bool:
    """Tell whether a dense Gram matrix fits into memory and is not mostly zero."""
    if not isinstance(sections, KernelSections):
        return True
    M = len(sections.centers)
    memory = physical_memory() if memory is None else memory
    fits = DENSE_MEMORY * memory >= DENSE_OVERHEAD * 8 * M**2
    if fits and dense_centers >= M:
        return True
    return fits and sparse_tree(sections, sections.centers) is None


def physical_memory() -> float:
    """Return the memory of the machine in bytes, or a guess."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):  # not on this operating system
        return 8 * 2.0**30


class DirectSystem:
    """A Gram matrix with its Cholesky factor, in an orthonormal basis.

    With polynomials p that are orthonormal on the centres, and L^-1 P(Xi) = Q R, an
    estimate is a(x)^T z + t(x)^T b with t(x) = R^-T p(x) and z orthogonal to Q. Then
    the coefficients L^-T z of the sections are orthogonal to the polynomials on the
    centres, and |z| is the native seminorm.

    Where the Gram matrix is not positive definite, or a solution misses the values
    that it should have, and the solver is "pivoted_cholesky", centres whose sections
    the others reproduce are dropped. `tolerance` is the squared power function,
    relative to the kernel, at which a section counts as reproduced. It is raised until
    that suffices, and 0 where no centre had to go.
    """

    def __init__(
        self,
        sections: Sections,
        nugget: Array,
        degree: int | None,
        solver: str,
        extent: Array | None = None,
    ) -> None:
        self.offered = sections
        self.offered_nugget = nugget
        self.degree = degree
        self.solver = solver
        self.extent = extent
        self.tolerance = 0.0
        self.kept = np.arange(len(nugget))
        _, reason = _attempt(self._factor)
        if reason:
            self._drop_dependent(reason)

    def interpolate(self, u: Array, negligible: float = 0.0) -> Fit:
        """Return the function with the values u at the centres.

        Where the diagonal of the matrix has an excess E over the sections, the values
        are u - E c. Parts of a section up to the tolerance `negligible` are dropped
        without a warning. O(M^2) operations for every output.

        Raises
        ------
        ValueError
            If the function misses its values, and dropping centres does not help.

        Warns
        -----
        LinAlgWarning
            If dependent centres were dropped.
        """

        def attempt() -> Fit:
            v = self._forward(u[self.kept])
            b = self.Q.T @ v
            z = v - self.Q @ b
            expansion = self._expand(z, b)
            if self.is_suspect:
                reached = expansion(self.sections.points)
                reached += self.excess[:, np.newaxis] * expansion.dual_coef
                self._verify(relative_error(reached, u[self.kept]))
            return Fit(expansion, np.linalg.norm(z, axis=0), len(self.kept))

        return self.until_sound(attempt, negligible)

    def least_squares(
        self,
        X: Array,
        y: Array,
        alpha: float,
        n_jobs: int | None = None,
        weights: Array | None = None,
    ) -> Fit:
        """Return the function g that minimises |y - g(X)|^2 + alpha |g|_H^2.

        With weights of the rows, the squares are multiplied by them. Raises and warns
        as `interpolate`; O(n M^2) operations.
        """
        check_rows_suffice(len(X), self.offered.size, alpha)

        def attempt() -> Fit:
            check_trend_determined(self.degree, X, self.sections.points)
            solution = least_squares(
                self, X, y.__getitem__, y.shape[1], alpha, n_jobs, weights
            )
            return self.fit_at(X, *solution)

        negligible = negligible_tolerance(total_weight(X, weights), alpha)
        fit = self.until_sound(attempt, negligible)
        dof = fit.effective_dof
        noise = estimate_noise(fit.expansion, X, y, dof, n_jobs, weights)
        return fit._replace(noise_std=noise)

    def fit_at(self, X: Array, z: Array, b: Array, dof: float) -> Fit:
        """Return the fit with these coordinates, verified at some of the rows.

        Raises
        ------
        LinAlgError
            If it misses its values.
        """
        expansion = self._expand(z, b)
        if self.is_suspect:
            rows = X[:: max(len(X) // VERIFIED_ROWS, 1)]
            a, t = self.design(rows)
            self._verify(relative_error(expansion(rows), a.T @ z + t.T @ b))
        return Fit(expansion, np.linalg.norm(z, axis=0), dof)

    def fit_coordinates(
        self,
        X: Array,
        y: Array,
        alpha: float,
        n_jobs: int | None = None,
        weights: Array | None = None,
    ) -> Array:
        """Return coordinates, as those of `functions`, of a least-squares fit."""
        z, b, _ = least_squares(
            self, X, y.__getitem__, y.shape[1], alpha, n_jobs, weights
        )
        return z + self.Q @ b

    def power(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the power function; O(M^2) operations for every row."""
        n_rows = rows_per_block(len(self.kept))
        return np.sqrt(by_rows(self._squared_power, X, n_rows, n_jobs))

    def design(self, X: Array) -> tuple[Array, Array]:
        """Evaluate a(x) less its part along Q, (M, rows), and t(x), (q, rows)."""
        a, t = self._values(X)
        if self.trend_rank:
            along = dgemm(1.0, self.Q, a, trans_a=1)
            a = dgemm(-1.0, self.Q, along, 1.0, a, overwrite_c=1)
        return a, t

    def functions(self, X: Array) -> Array:
        """Evaluate a basis of all estimates, of shape (M, rows).

        It is a(x) with the polynomials in the place of its part along Q, which makes
        L^-1 u the coordinates of the interpolant of u.
        """
        a, t = self.design(X)
        return dgemm(1.0, self.Q, t, 1.0, a) if self.trend_rank else a

    def coordinates(self, u: Array) -> Array:
        """Return the coordinates L^-1 u of interpolants in the basis of `functions`."""
        return self._forward(u)

    def expand(self, coordinates: Array) -> KernelExpansion:
        """Return the functions with these coordinates in the basis of `functions`."""
        b = self.Q.T @ coordinates
        return self._expand(coordinates - self.Q @ b, b)

    def left_out_precision(self) -> Array:
        """Return the diagonal of the matrix that takes values to coefficients.

        That is the inverse of K, or of K bordered by the polynomials. The interpolant
        that is made without centre i misses the value there by the i-th coefficient
        over the i-th entry, and the squared power function of the other centres is
        there one over the i-th entry (Rippa 1999). NaN where the other centres
        determine no interpolant. O(M^3) operations and one M x M array.
        """
        inverse, _ = dtrtri(self.lower, lower=1)
        for column in range(1, len(inverse)):
            inverse[:column, column] = 0.0  # has no meaning, as in the factor
        diagonal = np.einsum("ij,ij->j", inverse, inverse)
        along = dgemm(1.0, self.Q, inverse, trans_a=1)
        remainder = diagonal - np.einsum("ij,ij->j", along, along)
        return np.where(remainder > 1e-10 * diagonal, remainder, np.nan)

    def rcond(self) -> float:
        """Estimate the reciprocal condition number of the matrix, in O(M^2)."""
        return float(dpocon(self.lower, self.norm, uplo="L")[0])

    @property
    def is_suspect(self) -> bool:
        """Whether the matrix is so near to singular that solutions are verified."""
        return self.rough_rcond < RCOND_TO_VERIFY

    def until_sound(self, attempt: Callable[[], T], negligible: float) -> T:
        """Attempt something with fewer and fewer centres, until it succeeds."""
        result, reason = _attempt(attempt)
        while reason:
            self._drop_dependent(reason)
            result, reason = _attempt(attempt)
        if self.tolerance > negligible and len(self.kept) < len(self.offered_nugget):
            warn_dropped(self.offered.kernel, self.offered.size, len(self.kept))
        return cast(T, result)

    def _factor(self) -> None:
        """Factor the matrix of the centres that are kept.

        Raises
        ------
        LinAlgError
            If the matrix is not numerically positive definite.
        """
        every = len(self.kept) == len(self.offered_nugget)
        self.sections = self.offered if every else self.offered.take(self.kept)
        self.nugget = self.offered_nugget[self.kept]
        K, self.excess, self.norm = gram_matrix(self.sections, self.nugget)
        # Least squares adds up its normal matrix in the upper triangle, which is free.
        self.lower, self.rough_rcond = factorize(K, self.norm)
        self.trend, P = None, np.empty((len(self.kept), 0))
        if self.degree is not None:
            points = self.sections.points
            self.trend = PolynomialTrend.at(points, self.degree, self.extent)
            P = self._forward(self.trend.values(points))
        self.Q, self.R = np.linalg.qr(P)
        self.trend_rank = self.Q.shape[1]

    def _drop_dependent(self, reason: str) -> None:
        """Drop centres until the matrix can be factored, with a higher tolerance.

        Raises
        ------
        ValueError
            If the solver is not to drop any, or if that does not help.
        """
        kernel, M = self.offered.kernel, self.offered.size
        self.lower = np.empty((0, 0))  # one matrix at a time
        while reason:
            # Pivots are accurate to several units of rounding, and rarely to fewer.
            smallest = 64 * float(np.finfo(np.float64).eps)
            self.tolerance = max(8 * self.tolerance, smallest)
            if self.solver != "pivoted_cholesky" or self.tolerance > 1:
                raise no_estimate(kernel, M, reason)
            self.kept = independent_centers(
                self.offered, self.offered_nugget, self.tolerance
            )
            _, reason = _attempt(self._factor)

    def _verify(self, error: float) -> None:
        if not error <= ACCURACY:
            raise np.linalg.LinAlgError(
                f"the solution misses its values by {error:.1e}"
            )

    def _values(self, X: Array) -> tuple[Array, Array]:
        """Evaluate a(x), of shape (M, rows), and t(x), of shape (q, rows)."""
        K = matrix(self.sections, X)
        a = self._forward(K.T, overwrite=True)
        if self.trend is None:
            return a, np.empty((0, len(X)))
        p = self.trend.values(X)
        return a, np.asarray(np.linalg.solve(self.R.T, p.T), dtype=np.float64)

    def _squared_power(self, X: Array) -> Array:
        # k(x, x) - |a|^2 + |t - Q^T a|^2
        a, t = self._values(X)
        variance = self.sections.diagonal(X) - np.einsum("ij,ij->j", a, a)
        if self.trend_rank:
            t -= dgemm(1.0, self.Q, a, trans_a=1)
            variance += np.einsum("ij,ij->j", t, t)
        return np.maximum(variance, 0.0)

    def _expand(self, z: Array, b: Array) -> KernelExpansion:
        """Turn coordinates z, orthogonal to Q, and b into coefficients."""
        dual_coef = self._backward(z)
        if not np.isfinite(dual_coef).all():
            raise np.linalg.LinAlgError("the coefficients are not finite")
        if self.trend is None:
            none = np.empty((0, z.shape[1]))
            return KernelExpansion(self.sections, dual_coef, np.zeros(0), none)
        trend_coef = self.trend.coefficients @ np.linalg.solve(self.R, b)
        return KernelExpansion(self.sections, dual_coef, self.trend.origin, trend_coef)

    def _forward(self, b: Array, overwrite: bool = False) -> Array:
        """Return L^-1 b."""
        return solve_triangular(
            self.lower, b, lower=True, overwrite_b=overwrite, check_finite=False
        )

    def _backward(self, v: Array) -> Array:
        """Return L^-T v."""
        return solve_triangular(self.lower, v, lower=True, trans=1, check_finite=False)


def _attempt(function: Callable[[], T]) -> tuple[T | None, str]:
    """Return a result, or why there is none.

    The error itself is let go, since it holds the arrays of the failed attempt.
    """
    try:
        return function(), ""
    except np.linalg.LinAlgError as error:
        return None, str(error)
