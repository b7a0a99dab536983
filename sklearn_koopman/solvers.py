"""Solvers for Gram matrices that are too large to be held."""

from __future__ import annotations

from typing import Any

from sklearn.base import BaseEstimator
from sklearn.utils import check_random_state

from ._utils._validation import check_choice, check_integer, check_number

__all__ = ["ConjugateGradient"]

PRECONDITIONERS = ("auto", "banded", "neighbors", "nystroem")


class ConjugateGradient(BaseEstimator):
    """Preconditioned conjugate gradients, for the `solver` of a regressor.

    The Gram matrix K of the M centres is used only in products with vectors, one for
    each output. For kernels of compact support K is a sparse matrix, found with a
    kd-tree. For other kernels its entries are evaluated anew for every product.

    Parameters
    ----------
    tol : float, default=1e-10
        The iterations end when, for every output, the norm of the residual is at most
        `tol` times the norm of the right-hand side. For least squares this refers to
        the normal equations.
    max_iter : int, default=500
        Largest number of iterations.
    preconditioner : {"auto", "banded", "neighbors", "nystroem"}, default="auto"
        An approximate inverse of the matrix, which reduces the number of iterations.

        - "banded": a Cholesky factor of the sparse matrix, with its rows in reverse
          Cuthill-McKee order. The solution is then direct. For kernels of compact
          support on centres along curves, where the band is narrow.
        - "neighbors": a sparse factor of K^-1 ([1]_, [2]_). The centres are ordered
          from coarse to fine, and each is conditioned on the nearest centres before it.
          For kernels of finite smoothness on manifolds of low dimension.
        - "nystroem": an approximation of K by a few of its columns, chosen by randomly
          pivoted Cholesky factorisation ([3]_). For smooth kernels with ``alpha > 0``.
        - "auto": "banded" if the band is narrow; "nystroem" if `rank` columns leave an
          error of at most a tenth of `alpha`; otherwise "neighbors".
    rank : int, default=500
        Number of columns for "nystroem". Least squares uses as many columns to
        precondition its normal equations, as in FALKON ([4]_), with any
        `preconditioner`.
    n_neighbors : int, default=None
        Number of neighbours for "neighbors". None means 30, and 10 for kernels of
        compact support, whose matrices are better conditioned.
    random_state : int, RandomState instance or None, default=0
        Seed for the choice of the columns, and for the random vectors that estimate the
        effective number of parameters of least squares. Solutions for different seeds
        differ by no more than `tol` allows.

    See Also
    --------
    sklearn_koopman.KoopmanKernelRegressor : Takes it as its `solver`.

    Notes
    -----
    The parameters can be tuned as ``solver__tol`` and the like.

    Memory is M times the number of neighbours within the support, plus M times
    `n_neighbors` or `rank`. One iteration takes O(M) time for kernels of compact
    support, with the number of neighbours as a factor, and O(M^2) for other kernels.
    The fit of a regressor warns with a `ConvergenceWarning` if the residual exceeds
    `tol` by more than rounding, or by more than 1e-6. Rounding is estimated from the
    norms of the matrix, by some steps of the power method, and of the solution: about
    4 sqrt(M) times the machine epsilon times both, over the norm of the right-hand
    side. The power function of a regressor, which `return_std` needs, solves
    one system for each state.

    References
    ----------
    .. [1] A. V. Vecchia, "Estimation and model identification for continuous spatial
       processes", Journal of the Royal Statistical Society B 50, 1988.
    .. [2] F. Schaefer, M. Katzfuss and H. Owhadi, "Sparse Cholesky factorization by
       Kullback-Leibler minimization", SIAM Journal on Scientific Computing 43, 2021.
    .. [3] Y. Chen, E. N. Epperly, J. A. Tropp and R. J. Webber, "Randomly pivoted
       Cholesky", Communications on Pure and Applied Mathematics 78, 2025.
    .. [4] A. Rudi, L. Carratino and L. Rosasco, "FALKON: An optimal large scale kernel
       method", Advances in Neural Information Processing Systems 30, 2017.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanKernelRegressor
    >>> from sklearn_koopman.solvers import ConjugateGradient
    >>> X = np.random.default_rng(0).uniform(size=(2000, 2))
    >>> y = np.sin(4 * X[:, 0]) * X[:, 1]
    >>> model = KoopmanKernelRegressor(solver=ConjugateGradient(tol=1e-12)).fit(X, y)
    >>> dense = KoopmanKernelRegressor(solver="cholesky").fit(X, y)
    >>> bool(abs(model.predict(X + 0.01) - dense.predict(X + 0.01)).max() < 1e-8)
    True
    >>> model.n_iter_ < 30
    True
    """

    def __init__(
        self,
        *,
        tol: float = 1e-10,
        max_iter: int = 500,
        preconditioner: str = "auto",
        rank: int = 500,
        n_neighbors: int | None = None,
        random_state: Any = 0,
    ) -> None:
        self.tol = tol
        self.max_iter = max_iter
        self.preconditioner = preconditioner
        self.rank = rank
        self.n_neighbors = n_neighbors
        self.random_state = random_state


def check_solver(solver: ConjugateGradient) -> None:
    """Refuse parameters outside their range.

    Parameters
    ----------
    solver : ConjugateGradient
        The solver.

    Raises
    ------
    ValueError
        If a parameter is outside its range.
    """
    check_number(solver.tol, "solver.tol", positive=True)
    if solver.tol >= 1:
        raise ValueError(f"solver.tol must be below 1, got {solver.tol!r}.")
    check_integer(solver.max_iter, "solver.max_iter", 1)
    check_integer(solver.rank, "solver.rank", 1)
    if solver.n_neighbors is not None:
        check_integer(solver.n_neighbors, "solver.n_neighbors", 1)
    try:
        check_random_state(solver.random_state)
    except ValueError as error:
        raise ValueError(
            "solver.random_state must be None, an integer from 0 to 2**32 - 1 or a "
            f"RandomState, got {solver.random_state!r}."
        ) from error
    check_choice(solver.preconditioner, "solver.preconditioner", PRECONDITIONERS)
