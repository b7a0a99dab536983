"""Estimates without a dense Gram matrix: sparse ones, and products evaluated anew.

A system with the Gram matrix is solved by conjugate gradients in the complement of the
polynomials of the tail, whose coefficients follow from what is left of the values.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.sparse import csr_array
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_random_state, gen_batches

from sklearn_koopman._linalg._cholesky import cholesky
from sklearn_koopman._linalg._conjugate_gradient import (
    Converged,
    Product,
    beyond_rounding,
    complement,
    conjugate_gradients,
    low_rank_inverse,
    neighbor_preconditioner,
    pivoted_factor,
)
from sklearn_koopman._linalg._direct import Solution, UnsuitableKernelError
from sklearn_koopman._matrices import _sparse
from sklearn_koopman._matrices._polynomial import PolynomialTrend, polynomial
from sklearn_koopman._matrices._sections import (
    KernelSections,
    Sections,
    gram_matrix,
    gram_product,
    is_sparse,
    matrix,
    product,
    sparse_matrix,
)
from sklearn_koopman._utils._typing import Array
from sklearn_koopman.solvers import ConjugateGradient

# Up to so many centres a dense matrix is a matter of a second, ...
DENSE_CENTERS = 5000
# ... and it may take this part of the memory.
DENSE_MEMORY = 0.5
# Up to this density, a matrix that is multiplied with many times is kept as a sparse
# one.
KEPT = 0.1
# Operations for which a banded factorisation is worth while.
BANDED_WORK = 2e10
# What is left of the diagonal, relative to the nugget, for which few columns of the
# matrix stand for all.
FEW_COLUMNS = 0.1
# Neighbours that a centre is conditioned on.
NEIGHBORS = 30
COMPACT_NEIGHBORS = 10
# Rows of the power function that are solved for at once.
POWER_ROWS = 256
# Random vectors for the trace of the matrix that takes outputs to fitted values.
PROBES = 16


def is_large(sections: Sections, points: Array) -> bool:
    """Tell whether a dense Gram matrix would take too much memory, or mostly zeros."""
    n = len(points)
    fits = 1.3 * 8 * n**2 <= DENSE_MEMORY * _physical_memory()
    if not isinstance(sections, KernelSections) or (fits and n <= DENSE_CENTERS):
        return False
    return not fits or is_sparse(sections, points)


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):  # not on this operating system
        return 8 * 2.0**30


@dataclass(frozen=True)
class ImplicitBasis:
    """The span of the sections, with a solver for systems with the Gram matrix."""

    sections: KernelSections
    excess: Array
    tail: PolynomialTrend | None
    Q: Array  # (M, q): orthonormal values at the centres of the polynomials seen there
    product: Product
    precondition: Product
    W: csr_array | None  # W^T W is close to the inverse of the matrix
    solver: ConjugateGradient

    @classmethod
    def of(
        cls,
        sections: KernelSections,
        nugget: Array,
        tail: PolynomialTrend | None,
        solver: ConjugateGradient,
        n_jobs: int | None = None,
    ) -> ImplicitBasis:
        """Prepare the product with the Gram matrix and its preconditioner.

        Raises
        ------
        LinAlgError
            If the matrix is found not to be positive definite.
        UnsuitableKernelError
            If the preconditioner is not one for this kernel.
        """
        centers = sections.centers
        diagonal = sections.diagonal(centers) + nugget
        excess = diagonal - sections.smooth_diagonal(centers)
        P = np.empty((len(centers), 0))
        if tail is not None:
            P = polynomial(centers, tail.origin, tail.seen)
        kind = solver.preconditioner
        multiply: Product
        precondition: Product
        W = None
        if is_sparse(sections, centers, KEPT) or kind == "banded":
            if not sections.is_compact:
                raise UnsuitableKernelError(
                    "has no compact support, which preconditioner='banded' needs: "
                    "take preconditioner='auto'"
                )
            K = _sparse.gram(sections.kernel, sections.tree, centers, diagonal)
            multiply = K.__matmul__
            if kind in ("auto", "banded"):
                order, width = _sparse.bandwidth(K)
                cheap = len(centers) * width**2 <= BANDED_WORK
                kind = "banded" if cheap or kind == "banded" else "neighbors"
            if kind == "banded":
                try:
                    precondition = _sparse.banded_solver(K, order, width)
                except np.linalg.LinAlgError:
                    if solver.preconditioner == "banded":
                        raise
                    kind = "neighbors"
        else:

            def multiply(V: Array) -> Array:
                found = gram_product(sections, centers, V, n_jobs)
                return found + excess[:, np.newaxis] * V

        # Few columns stand for all of a smooth kernel, in comparison with the nugget.
        shift = float(excess.mean())
        if kind == "nystroem" or (kind == "auto" and shift > 0):
            F, left = _few_columns(sections, solver)
            if kind == "nystroem" or left <= FEW_COLUMNS * shift:
                kind = "nystroem"
                precondition = low_rank_inverse(F, shift + left)
        if kind in ("auto", "neighbors"):
            W = neighbor_preconditioner(
                sections.kernel, centers, diagonal, _n_neighbors(sections, solver)
            )
            precondition = _squared(W)
        return cls(sections, excess, tail, P, multiply, precondition, W, solver)

    def solve(self, u: Array) -> Converged:
        """Return the coefficients c with u - K c a polynomial and Q^T c = 0."""
        found = self._descend(u)
        _check(found)
        return found

    def _descend(self, u: Array) -> Converged:
        return conjugate_gradients(
            self.product,
            u,
            self.precondition,
            self.Q,
            self.solver.tol,
            self.solver.max_iter,
        )

    def variance(self, X: Array) -> tuple[Array, float]:
        """Evaluate the squared power function, and the residual of the weights.

        Any weights w with P^T w = p(x) give k(x, x) - 2 w^T k(Xi, x) + w^T K w: the
        least of all values for those solved for, and too much, never too little, by
        the square of their error.
        """
        b = matrix(self.sections, X).T
        w = np.zeros_like(b)
        if self.tail is not None:
            # Polynomials at x by their values at the centres.
            w += self.Q @ polynomial(X, self.tail.origin, self.tail.seen).T
        Kw = self.product(w) if self.tail is not None else w
        at_first = np.einsum("ij,ij->j", w, Kw - 2 * b)
        found = self._descend(b - Kw)
        w += found.x
        quadratic = np.einsum("ij,ij->j", w, self.product(w) - 2 * b)
        # Weights that have diverged say less than those before.
        quadratic = np.fmin(quadratic, at_first)
        variance = np.maximum(self.sections.diagonal(X) + quadratic, 0.0)
        return variance, found.residual

    def power(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the power function.

        Warns
        -----
        ConvergenceWarning
            If it is too large, for want of iterations.
        """
        batches = gen_batches(len(X), POWER_ROWS)
        parts, residuals = zip(
            *(self.variance(X[rows]) for rows in batches), strict=True
        )
        if not max(residuals) <= self.solver.tol:
            warnings.warn(
                "The power function is too large, by the square of a relative residual "
                f"of up to {max(residuals):.1e}, above tol={self.solver.tol:.1e}: "
                "conjugate gradients did not converge for all states. Raise max_iter, "
                "rank, n_neighbors or tol of the solver.",
                ConvergenceWarning,
                stacklevel=3,
            )
        return np.sqrt(np.concatenate(parts))

    def trend(self, values: Array) -> Array:
        """Return the coefficients of the monomials, given values at the centres."""
        if self.tail is None:
            return np.empty((0, values.shape[1]))
        return self.tail.seen @ (self.Q.T @ values)


def _root_of_product(v: Array, w: Array) -> Array:
    """Return the root of v^T w for every column, whatever the unit of both."""
    a, b = (np.abs(x).max(axis=0, initial=0.0) for x in (v, w))
    a[a == 0], b[b == 0] = 1.0, 1.0
    inner = np.einsum("ij,ij->j", v / a, w / b)
    return np.sqrt(np.maximum(inner, 0.0)) * np.sqrt(a) * np.sqrt(b)


def _check(found: Converged) -> None:
    if not found.residual < 1:
        raise np.linalg.LinAlgError(
            f"conjugate gradients diverge (relative residual {found.residual:.1e})"
        )


def _few_columns(
    sections: KernelSections, solver: ConjugateGradient
) -> tuple[Array, float]:
    F, left = pivoted_factor(
        lambda pivots: matrix(sections.take(pivots), sections.centers),
        sections.smooth_diagonal(sections.centers),
        solver.rank,
        check_random_state(solver.random_state),
    )
    # Rounding leaves this much where the columns say that nothing is left.
    return F, left + 1e-14 * len(F)


def _dense_root(sections: KernelSections) -> Array:
    """Return W with W^T W close to the inverse of the Gram matrix, singular or not."""
    centers = sections.centers
    K, _, _ = gram_matrix(sections, centers, np.zeros(len(centers)))
    size = float(K.diagonal().max()) * len(K) * float(np.finfo(np.float64).eps)
    info = 1
    while info != 0:
        F = K.copy(order="F")
        F[np.diag_indices(len(F))] += size
        lower, info = cholesky(F, lower=True)
        size *= 100
    return np.tril(dtrtri(lower, lower=1)[0])


def _squared(W: csr_array | Array, inner: Product = lambda v: v) -> Product:
    """Return v -> W^T inner(W v)."""
    WT = W.T if isinstance(W, np.ndarray) else W.T.tocsr()
    return lambda v: WT @ inner(W @ v)


def _n_neighbors(sections: KernelSections, solver: ConjugateGradient) -> int:
    if solver.n_neighbors is not None:
        return solver.n_neighbors
    return COMPACT_NEIGHBORS if sections.is_compact else NEIGHBORS


def interpolate(
    basis: ImplicitBasis, u: Array
) -> tuple[Solution[ImplicitBasis], Converged]:
    """Interpolate u at the centres; meets u - E c with an excess E."""
    found = basis.solve(u)
    dual = found.x
    trend = np.empty((0, u.shape[1]))
    if basis.tail is not None:
        trend = basis.trend(u - basis.product(dual))
    # c^T K c, since c is orthogonal to the polynomials.
    seminorm = _root_of_product(dual, u)
    kept = np.arange(len(dual))
    return Solution(basis, kept, dual, trend, seminorm, len(dual), 0.0), found


def regress(
    basis: ImplicitBasis, X: Array, y: Array, alpha: float, n_jobs: int | None
) -> tuple[Solution[ImplicitBasis], Converged]:
    """Fit y on all rows of X by least squares.

    With k = k(X, Xi), and T the values of the polynomials, the coefficients c minimise

        |y - k c - T b|^2 + alpha c^T K c    with    P^T c = 0.

    The polynomials are taken off y and k by projection. As in FALKON (Rudi, Carratino
    and Rosasco 2017), the rows are taken for spread as the centres are, so that the
    matrix k^T k + alpha K is nearly K (n/M K + alpha): with W^T W close to the inverse
    of K and F F^T close to K, it is preconditioned by

        W^T (n/M H H^T + (alpha + n/M left) I)^-1 W,    H H^T = W F F^T F F^T W^T.
    """
    sections = basis.sections
    centers = sections.centers
    M, n = len(centers), len(X)
    T = np.empty((n, 0))
    if basis.tail is not None:
        terms = np.hstack([basis.tail.seen, basis.tail.unseen])
        T = polynomial(X, basis.tail.origin, terms)
        length = np.sqrt(np.einsum("ij,ij->j", T, T))
        told = length > 0
        unit = np.zeros_like(length)
        unit[told] = 1 / length[told]
        Q, size, axes = np.linalg.svd(T * unit, full_matrices=False)
        axes = unit[:, np.newaxis] * axes[size > 1e-7].T / size[size > 1e-7]
        T = Q[:, size > 1e-7]
    sparse = is_sparse(sections, X, KEPT)
    k: csr_array | None = sparse_matrix(sections, X) if sparse else None
    kT = k.T.tocsr() if k is not None else None

    def forward(c: Array) -> Array:
        return k @ c if k is not None else product(sections, X, c, n_jobs)

    def backward(v: Array) -> Array:
        if kT is not None:
            return kT @ v
        return _transposed_product(sections, X, v)

    def normal(c: Array) -> Array:
        return backward(complement(T, forward(c))) + alpha * basis.product(c)

    W: csr_array | Array | None = basis.W
    if not sparse and M <= DENSE_CENTERS:
        W = _dense_root(sections)
    elif W is None:
        W = neighbor_preconditioner(
            sections.kernel,
            centers,
            sections.diagonal(centers),
            _n_neighbors(sections, basis.solver),
        )
    F, left = np.zeros((M, 0)), 1.0
    if not sparse:
        F, left = _few_columns(sections, basis.solver)
    values, vectors = np.linalg.eigh(F.T @ F)
    H = np.sqrt(n / M) * (W @ (F @ (vectors * np.sqrt(np.maximum(values, 0.0)))))
    inner = low_rank_inverse(H, alpha + n / M * left)
    # The trace of the matrix H that takes y to fitted values is that of its mean over
    # random vectors v, v^T H v (Hutchinson 1989).
    random = check_random_state(basis.solver.random_state)
    signs = random.choice([-1.0, 1.0], size=(n, PROBES if alpha > 0 else 0))
    b = backward(beyond_rounding(np.hstack([y, signs]), T))
    found = conjugate_gradients(
        normal,
        b,
        _squared(W, inner),
        basis.Q,
        basis.solver.tol,
        basis.solver.max_iter,
    )
    _check(found)
    dual = np.ascontiguousarray(found.x[:, : y.shape[1]])
    trend = np.empty((0, y.shape[1]))
    if basis.tail is not None:
        rest = y - forward(dual)
        trend = terms @ (axes @ (T.T @ rest))
    fitted = float(M - basis.Q.shape[1])
    if alpha > 0:
        probes = slice(y.shape[1], None)
        fitted = np.einsum("ij,ij->", b[:, probes], found.x[:, probes]) / PROBES
    freedom = fitted + T.shape[1]
    seminorm = _root_of_product(dual, basis.product(dual))
    solution = Solution(basis, np.arange(M), dual, trend, seminorm, freedom, 0.0)
    return solution, found


def _transposed_product(sections: KernelSections, X: Array, v: Array) -> Array:
    """Evaluate k(X, Xi)^T v: the sections of the rows, at the centres."""
    return product(KernelSections(sections.kernel, X), sections.centers, v)
