"""Systems without a dense Gram matrix: sparse ones, and products evaluated anew.

A system with the Gram matrix is solved by conjugate gradients in the complement of the
polynomials of the trend. Their coefficients follow from what remains of the values.
"""

from functools import partial

import numpy as np
from scipy.linalg.lapack import dtrtri
from scipy.sparse import csr_array
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_random_state, gen_batches

from .._matrices import _sparse
from .._matrices._polynomial import PolynomialTrend
from .._matrices._sections import (
    KernelExpansion,
    KernelSections,
    gram_matrix,
    gram_product,
    matrix,
    product,
    sparse_matrix,
    sparse_tree,
)
from .._utils._rows import total_weight
from .._utils._typing import Array, Indices
from .._utils._warnings import warn
from ..solvers import ConjugateGradient
from ._cholesky import cholesky
from ._conjugate_gradient import (
    CGResult,
    Product,
    beyond_rounding,
    complement,
    conjugate_gradients,
)
from ._fit import (
    REMEDY,
    Fit,
    check_rows_suffice,
    check_trend_determined,
    estimate_noise,
    no_estimate,
)
from ._preconditioners import (
    banded_solver,
    bandwidth,
    low_rank_inverse,
    neighbor_preconditioner,
    pivoted_factor,
)

MORE_ITERATIONS = "Raise max_iter, rank, n_neighbors or tol of the solver."
# Up to this density, a matrix that is multiplied with many times is held as a sparse
# one.
MAX_DENSITY_TO_HOLD = 0.1
# Operations up to which a banded factorisation is worth while.
MAX_BANDED_OPERATIONS = 2e10
# Columns of the matrix stand for all of it if this part of the nugget is left of the
# diagonal.
NYSTROEM_REMAINDER = 0.1
# Neighbours that a centre is conditioned on.
N_NEIGHBORS = 30
N_NEIGHBORS_COMPACT = 10
# Rows of the power function that are solved for at once.
POWER_ROWS = 256
# Random vectors that estimate the trace of the matrix from outputs to fitted values.
N_PROBE_VECTORS = 16
# Polynomials, orthonormal on the centres, are not determined by rows on which they are
# shorter than this part of the longest.
MIN_RELATIVE_LENGTH = 1e-7
# Up to so many centres, the normal equations are whitened by a dense factor.
MAX_CENTERS_TO_WHITEN_DENSELY = 5000


class IterativeSystem:
    """A Gram matrix that is only multiplied with, and its preconditioner."""

    def __init__(
        self,
        sections: KernelSections,
        nugget: Array,
        degree: int | None,
        solver: ConjugateGradient,
        extent: Array | None = None,
        n_jobs: int | None = None,
        max_banded_operations: float = MAX_BANDED_OPERATIONS,
    ) -> None:
        centers = sections.centers
        self.sections = sections
        self.kept: Indices = np.arange(len(centers))
        self.nugget, self.degree = nugget, degree
        self.solver = solver
        diagonal = sections.diagonal(centers) + nugget
        self.excess: Array = diagonal - sections.smooth_diagonal(centers)
        # Orthonormal values at the centres of the polynomials that they determine.
        self.trend: PolynomialTrend | None = None
        self.Q = np.empty((len(centers), 0))
        if degree is not None:
            self.trend = PolynomialTrend.at(centers, degree, extent)
            self.Q = self.trend.values(centers)
        self.trend_rank = self.Q.shape[1]
        self.product: Product = self._multiply(n_jobs)
        # W^T W is close to the inverse of the matrix.
        self.W: csr_array | None = None
        self.precondition: Product
        kind = solver.preconditioner
        tree = sparse_tree(sections, centers, MAX_DENSITY_TO_HOLD)
        if kind == "banded" or tree is not None:
            if not np.isfinite(getattr(sections.kernel, "support_radius", np.inf)):
                raise ValueError(
                    f"kernel={sections.kernel!r} has no compact support, which "
                    "preconditioner='banded' needs: take preconditioner='auto'."
                )
            K = _sparse.gram(sections.kernel, centers, diagonal)
            self.product = K.__matmul__
            if kind in ("auto", "banded"):
                kind = self._factor_band(K, max_banded_operations)
        least = float(self.excess.min())
        if kind == "nystroem" or (kind == "auto" and least > 0):
            F, remainder = self._pivoted_factor()
            if kind == "nystroem" or remainder <= NYSTROEM_REMAINDER * least:
                kind = "nystroem"
                self.precondition = low_rank_inverse(F, self.excess + remainder)
        if kind in ("auto", "neighbors"):
            self.W = self._neighbor_root(diagonal)
            self.precondition = _whiten(self.W)

    def interpolate(self, u: Array, negligible: float = 0.0) -> Fit:
        """Return the function with the values u at the centres.

        Where the diagonal of the matrix has an excess E over the sections, the values
        are u - E c. Nothing is ever dropped, whatever is `negligible`.

        Raises
        ------
        ValueError
            If the iteration diverges.

        Warns
        -----
        ConvergenceWarning
            If the iteration ends above its tolerance.
        """
        found = self._solve(self.product, u, self.precondition)
        trend_coef = np.empty((0, u.shape[1]))
        if self.trend is not None:
            values = self.Q.T @ (u - self.product(found.x))
            trend_coef = self.trend.coefficients @ values
        # c^T K c, since c is orthogonal to the polynomials.
        seminorm = np.sqrt(np.maximum(np.einsum("ij,ij->j", found.x, u), 0.0))
        dof = len(self.kept)
        return self._fit(found, found.x, trend_coef, seminorm, dof)

    def least_squares(
        self,
        X: Array,
        y: Array,
        alpha: float,
        n_jobs: int | None = None,
        weights: Array | None = None,
    ) -> Fit:
        """Return the function g that minimises |y - g(X)|^2 + alpha |g|_H^2.

        With k = k(X, Xi), and T the values of the polynomials, the coefficients c
        minimise

            |y - k c - T b|^2 + alpha c^T K c    with    P^T c = 0.

        The polynomials are taken off y and k by projection. As in FALKON (Rudi,
        Carratino and Rosasco 2017), the rows are taken for spread as the centres are,
        so that the matrix k^T k + alpha K is nearly K (n/M K + alpha). With W^T W
        close to the inverse of K and F F^T close to K, it is preconditioned by

            W^T (n/M H H^T + (alpha + n/M remainder) I)^-1 W,

            H H^T = W F F^T F F^T W^T.

        With weights, y and the rows of k and T are multiplied by their roots, and n is
        the sum of the weights.

        Raises and warns as `interpolate`.
        """
        sections, outputs = self.sections, y
        M, n, n_outputs = sections.size, total_weight(X, weights), y.shape[1]
        check_rows_suffice(len(X), M, alpha)
        check_trend_determined(self.degree, X, sections.centers)
        root = None if weights is None else np.sqrt(weights)[:, np.newaxis]
        T, axes = np.empty((len(X), 0)), np.empty((0, 0))
        if self.trend is not None:
            P = _times(root, self.trend.values(X))
            U, lengths, V = np.linalg.svd(P, full_matrices=False)
            determined = lengths > MIN_RELATIVE_LENGTH * lengths[0]
            T = U[:, determined]
            axes = V[determined].T / lengths[determined]
        tree = sparse_tree(sections, X, MAX_DENSITY_TO_HOLD)
        multiply: Product
        transposed: Product
        if tree is not None:
            k = sparse_matrix(sections, X, tree)
            multiply, transposed = k.__matmul__, k.T.tocsr().__matmul__
        else:
            rows = KernelSections(sections.kernel, X)
            multiply = partial(product, sections, X, n_jobs=n_jobs)
            transposed = partial(product, rows, sections.centers, n_jobs=n_jobs)

        def forward(c: Array) -> Array:
            return _times(root, multiply(c))

        def backward(v: Array) -> Array:
            return transposed(_times(root, v))

        def normal(c: Array) -> Array:
            return backward(complement(T, forward(c))) + alpha * self.product(c)

        W: csr_array | Array | None = self.W
        if tree is None and M <= MAX_CENTERS_TO_WHITEN_DENSELY:
            W = _dense_root(sections)
        elif W is None:
            W = self._neighbor_root(sections.diagonal(sections.centers))
        F, remainder = np.zeros((M, 0)), 1.0
        if tree is None:
            F, remainder = self._pivoted_factor()
        values, vectors = np.linalg.eigh(F.T @ F)
        H = np.sqrt(n / M) * (W @ (F @ (vectors * np.sqrt(np.maximum(values, 0.0)))))
        inner = low_rank_inverse(H, alpha + n / M * remainder)
        # The trace of the matrix H from outputs to fitted values is that of its mean
        # over random vectors v, v^T H v (Hutchinson 1989).
        random = check_random_state(self.solver.random_state)
        n_probes = N_PROBE_VECTORS if alpha > 0 else 0
        signs = random.choice([-1.0, 1.0], size=(len(X), n_probes))
        y = _times(root, y)
        b = backward(beyond_rounding(np.hstack([y, signs]), T))
        found = self._solve(normal, b, _whiten(W, inner))
        dual_coef = np.ascontiguousarray(found.x[:, :n_outputs])
        trend_coef = np.empty((0, n_outputs))
        if self.trend is not None:
            values = axes @ (T.T @ (y - forward(dual_coef)))
            trend_coef = self.trend.coefficients @ values
        kernel_dof = float(M - self.trend_rank)
        if n_probes:
            probes = slice(n_outputs, None)
            trace = np.einsum("ij,ij->", b[:, probes], found.x[:, probes])
            kernel_dof = float(trace) / n_probes
        squared = np.einsum("ij,ij->j", dual_coef, self.product(dual_coef))
        seminorm = np.sqrt(np.maximum(squared, 0.0))
        dof = kernel_dof + T.shape[1]
        fit = self._fit(found, dual_coef, trend_coef, seminorm, dof)
        noise_std = estimate_noise(fit.expansion, X, outputs, dof, n_jobs, weights)
        return fit._replace(noise_std=noise_std)

    def power(
        self, X: Array, n_jobs: int | None = None, batch_rows: int = POWER_ROWS
    ) -> Array:
        """Evaluate the power function, by one system for every row.

        Warns
        -----
        ConvergenceWarning
            If it is too large, for want of iterations.
        """
        batches = gen_batches(len(X), batch_rows)
        parts, results = zip(
            *(self._squared_power(X[rows]) for rows in batches), strict=True
        )
        tol = self.solver.tol
        if not all(found.has_converged(tol) for found in results):
            residual = max(found.residual.max() for found in results)
            warn(
                "The power function is too large, by the square of a relative residual "
                f"of up to {residual:.1e}, above tol={tol:.1e}: conjugate gradients "
                f"did not converge. {MORE_ITERATIONS}",
                ConvergenceWarning,
            )
        return np.sqrt(np.concatenate(parts))

    def _multiply(self, n_jobs: int | None) -> Product:
        def multiply(V: Array) -> Array:
            found = gram_product(self.sections, V, n_jobs)
            return found + self.excess[:, np.newaxis] * V

        return multiply

    def _factor_band(self, K: csr_array, max_operations: float) -> str:
        """Factor a sparse matrix if that is cheap or asked for; what is used instead.

        Raises
        ------
        LinAlgError
            If it was asked for, and the matrix is not positive definite.
        """
        asked = self.solver.preconditioner == "banded"
        order, width = bandwidth(K)
        if not asked and K.shape[0] * width**2 > max_operations:
            return "neighbors"
        try:
            self.precondition = banded_solver(K, order, width)
        except np.linalg.LinAlgError as error:
            if asked:
                kernel, M = self.sections.kernel, self.sections.size
                raise no_estimate(kernel, M, str(error)) from error
            return "neighbors"
        return "banded"

    def _neighbor_root(self, diagonal: Array) -> csr_array:
        n_neighbors = self.solver.n_neighbors
        kernel = self.sections.kernel
        if n_neighbors is None:
            compact = np.isfinite(getattr(kernel, "support_radius", np.inf))
            n_neighbors = N_NEIGHBORS_COMPACT if compact else N_NEIGHBORS
        centers = self.sections.centers
        return neighbor_preconditioner(kernel, centers, diagonal, n_neighbors)

    def _pivoted_factor(self) -> tuple[Array, float]:
        sections = self.sections
        F, remainder = pivoted_factor(
            lambda pivots: matrix(sections.take(pivots), sections.centers),
            sections.smooth_diagonal(sections.centers),
            self.solver.rank,
            check_random_state(self.solver.random_state),
        )
        # Rounding leaves this much where the columns leave nothing.
        return F, remainder + 1e-14 * len(F)

    def _solve(self, multiply: Product, b: Array, precondition: Product) -> CGResult:
        found = self._descend(multiply, b, precondition)
        kernel, M = self.sections.kernel, self.sections.size
        residual, solver = found.residual.max(), self.solver
        if not residual < 1:
            reason = f"conjugate gradients diverge (relative residual {residual:.1e})"
            raise no_estimate(kernel, M, reason)
        if not found.has_converged(solver.tol):
            advice = "The matrix is singular up to rounding."
            if found.n_iter >= solver.max_iter:
                advice = MORE_ITERATIONS
            warn(
                f"Conjugate gradients for kernel={kernel!r} on {M} centres ended after "
                f"{found.n_iter} iterations with a relative residual of "
                f"{residual:.1e}, above tol={solver.tol:.1e}. {advice} {REMEDY}",
                ConvergenceWarning,
            )
        return found

    def _descend(self, multiply: Product, b: Array, precondition: Product) -> CGResult:
        solver = self.solver
        return conjugate_gradients(
            multiply, b, precondition, self.Q, solver.tol, solver.max_iter
        )

    def _fit(
        self,
        found: CGResult,
        dual_coef: Array,
        trend_coef: Array,
        seminorm: Array,
        dof: float,
    ) -> Fit:
        origin = np.zeros(0) if self.trend is None else self.trend.origin
        expansion = KernelExpansion(self.sections, dual_coef, origin, trend_coef)
        residual = float(found.residual.max())
        return Fit(expansion, seminorm, dof, None, found.n_iter, residual)

    def _squared_power(self, X: Array) -> tuple[Array, CGResult]:
        """Evaluate the squared power function, and how well the weights converged.

        Any weights w with P^T w = p(x) give k(x, x) - 2 w^T k(Xi, x) + w^T K w: the
        least of all values for those solved for, and too much, never too little, by
        the square of their error.
        """
        b = matrix(self.sections, X).T
        w = np.zeros_like(b)
        Kw = w
        if self.trend is not None:
            # Polynomials at x by their values at the centres.
            w += self.Q @ self.trend.values(X).T
            Kw = self.product(w)
        at_first = np.einsum("ij,ij->j", w, Kw - 2 * b)
        found = self._descend(self.product, b - Kw, self.precondition)
        w += found.x
        quadratic = np.einsum("ij,ij->j", w, self.product(w) - 2 * b)
        # Weights that have diverged are worse than those at first.
        quadratic = np.fmin(quadratic, at_first)
        return np.maximum(self.sections.diagonal(X) + quadratic, 0.0), found


def _times(root: Array | None, values: Array) -> Array:
    """Multiply rows by the roots of their weights, if they have any."""
    return values if root is None else root * values


def _dense_root(sections: KernelSections) -> Array:
    """Return W with W^T W close to the inverse of the Gram matrix, singular or not."""
    K, _, _ = gram_matrix(sections, np.zeros(sections.size))
    shift = float(K.diagonal().max()) * len(K) * float(np.finfo(np.float64).eps)
    while True:
        F = K.copy(order="F")
        F[np.diag_indices(len(F))] += shift
        try:
            return np.tril(dtrtri(cholesky(F), lower=1)[0])
        except np.linalg.LinAlgError:
            shift *= 100


def _whiten(W: csr_array | Array, inner: Product = lambda v: v) -> Product:
    """Return v -> W^T inner(W v)."""
    WT = W.T if isinstance(W, np.ndarray) else W.T.tocsr()
    return lambda v: WT @ inner(W @ v)
