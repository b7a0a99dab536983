"""Held-out predictions of least squares without refitting: functions of arrays.

With the features V of all rows, scaled so that V^T V is the hat matrix H, rows O that
are left out have the residuals (I - H_OO)^-1 (y - V^T V y)_O.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk
from scipy.linalg.lapack import dpocon, dposv, dsyevd
from sklearn.utils import gen_batches

from sklearn_koopman._linalg._cholesky import cholesky, solve_triangular
from sklearn_koopman._linalg._leave_out import (
    EIGEN,
    EPSILON,
    RESOLVED,
    UNDETERMINED,
    Fold,
    Refit,
    cheapest,
    completed,
)
from sklearn_koopman._utils._typing import Array

# A hat matrix that leaves fewer digits than this is not used.
DIGITS = 1e-9
# A product of matrices takes half the time that its operations take elsewhere.
PRODUCT = 0.5
# Normal matrices that are held at once.
HELD = 4


@dataclass(frozen=True)
class Regression:
    """The features of least squares in the native basis of the centres."""

    A: Array  # (M, n_samples), less its part along Q
    T: Array  # (n_terms, n_samples)
    Q: Array  # (M, q)
    y: Array
    rcond: float  # of the Gram matrix of the centres

    @cached_property
    def along(self) -> float:
        """A number of the size of the features, to stand where they have no part."""
        return float(np.einsum("ij,ij->", self.A, self.A)) / len(self.A) or 1.0

    def regular(self, N: Array, alpha: float) -> Array:
        """Add alpha and the part along Q to a normal matrix; its lower triangle."""
        F = np.array(N, order="F")
        if self.Q.shape[1]:
            F = dgemm(self.along, self.Q, self.Q, 1.0, F, trans_b=1, overwrite_c=1)
        F[np.diag_indices(len(F))] += alpha
        return F

    def factored(self, N: Array, alpha: float) -> Array:
        """Return the Cholesky factor of the normal matrix.

        Raises
        ------
        LinAlgError
            If the rows do not determine the coefficients.
        """
        F = self.regular(N, alpha)
        norm = float(np.trace(F))
        lower, info = cholesky(F, lower=True, clean=True)
        limit = min(1e-13, 1e-6 * self.rcond)
        if info or dpocon(lower, norm, uplo="L")[0] < limit:
            raise np.linalg.LinAlgError(
                "the training rows do not determine the coefficients"
            )
        return lower


def regression_route(
    n_centers: int, folds: Sequence[Fold], n_samples: int, n_alphas: int
) -> str:
    """Choose the cheapest way to the held-out values, by its number of operations.

    "folds" factors the normal matrix of each fold, "cholesky" has the hat matrix from
    a factor for every alpha, and "eigen" from one decomposition.
    """
    M, n = float(n_centers), float(n_samples)
    out = np.array([len(fold.out) for fold in folds], dtype=float)
    some = out[out > 1]
    local = PRODUCT * M * np.square(some).sum() + (some**3).sum() / 3
    products = PRODUCT * n * M**2
    return cheapest(
        folds=-(-len(folds) // HELD) * products + n_alphas * len(folds) * M**3 / 3,
        cholesky=products + n_alphas * (M**3 / 3 + n * M**2 + local),
        eigen=3 * products + EIGEN * M**3 / 3 + n_alphas * (2 * n * M + local),
    )


def regressed(
    problem: Regression,
    folds: Sequence[Fold],
    alphas: Sequence[float],
    refit: Callable[[float], Refit],
) -> list[Array | ValueError]:
    """Predict the test rows of all folds for every alpha, or say what prevents it."""
    M, n = problem.A.shape
    route = regression_route(M, folds, n, len(alphas))
    bounds = np.cumsum([0, *(len(fold.test) for fold in folds)])
    tests = [slice(a, b) for a, b in pairwise(bounds)]
    shape = (len(alphas), bounds[-1], problem.y.shape[1])
    values = np.empty(shape)
    if route == "folds":
        left = _by_normal_matrices(problem, folds, tests, alphas, values)
    else:
        left = _by_hat_matrix(problem, folds, tests, alphas, values, route)
    none = [None] * len(alphas)
    return completed(values, none, [*map(np.array, left)], tests, alphas, refit)


def _by_normal_matrices(
    problem: Regression,
    folds: Sequence[Fold],
    tests: Sequence[slice],
    alphas: Sequence[float],
    values: Array,
) -> list[list[int]]:
    """Predict from the normal matrix of every fold; return where that fails."""
    n = len(problem.y)
    features = np.asfortranarray(np.vstack([problem.A, problem.T, problem.y.T]))
    left: list[list[int]] = [[] for _ in alphas]
    for some in gen_batches(len(folds), HELD):
        chosen = range(some.start, some.stop)
        used = np.ones((len(chosen), n), dtype=bool)
        for row, i in zip(used, chosen, strict=True):
            row[folds[i].out] = False
        # Rows that the same folds use enter their matrices together: nothing is
        # subtracted, which would cancel where a fold holds most of a direction.
        patterns, kind = np.unique(used, axis=1, return_inverse=True)
        normal = [np.zeros((len(features),) * 2, order="F") for _ in chosen]
        for k, pattern in enumerate(patterns.T):
            if pattern.any():
                rows = np.flatnonzero(kind.reshape(-1) == k)
                G = dsyrk(1.0, features[:, rows], lower=1)
                for N in (N for N, own in zip(normal, pattern, strict=True) if own):
                    N += G
        for i, N in zip(chosen, normal, strict=True):
            A, T = problem.A[:, folds[i].test], problem.T[:, folds[i].test]
            for j, alpha in enumerate(alphas):
                try:
                    z, b = _normal_solution(problem, N, alpha)
                except np.linalg.LinAlgError:
                    left[j].append(i)
                else:
                    values[j, tests[i]] = A.T @ z + T.T @ b
    return left


def _normal_solution(
    problem: Regression, N: Array, alpha: float
) -> tuple[Array, Array]:
    M, n_terms = len(problem.A), len(problem.T)
    lower = problem.factored(N[:M, :M], alpha)
    half = solve_triangular(lower, N[M:, :M].T)
    AT, Ay = half[:, :n_terms], half[:, n_terms:]
    corner = N[M : M + n_terms, M : M + n_terms]
    axes = _trend_axes(np.tril(corner) + np.tril(corner, -1).T, AT)
    b = axes @ (axes.T @ (N[M + n_terms :, M : M + n_terms].T - AT.T @ Ay))
    z = solve_triangular(lower, Ay - AT @ b, transpose=True)
    return z - problem.Q @ (problem.Q.T @ z), b


def _trend_axes(TT: Array, AT: Array) -> Array:
    """Return a root of the inverse of TT - AT^T AT.

    Raises
    ------
    LinAlgError
        If the rows do not tell some polynomials from the others.
    """
    length = np.sqrt(TT.diagonal())
    unit = np.divide(1.0, length, out=np.zeros(len(TT)), where=length > 0)
    size, axes = np.linalg.eigh(unit[:, np.newaxis] * (TT - AT.T @ AT) * unit)
    told = size > 1e-14
    if told.sum() < (length > 0).sum():
        raise np.linalg.LinAlgError("the training rows do not determine the trend")
    return unit[:, np.newaxis] * axes[:, told] / np.sqrt(size[told])


def _by_hat_matrix(
    problem: Regression,
    folds: Sequence[Fold],
    tests: Sequence[slice],
    alphas: Sequence[float],
    values: Array,
    route: str,
) -> list[list[int]]:
    """Predict from the hat matrix of all rows; return where that fails."""
    y = problem.y
    N = dsyrk(1.0, problem.A, lower=1)
    spectrum = _spectrum(problem, N) if route == "eigen" else None
    single = [i for i, f in enumerate(folds) if len(f.out) == 1 and not f.overlaps]
    several = [i for i, f in enumerate(folds) if len(f.out) != 1 and not f.overlaps]
    # The row that each test of a single row is, and its place among all tests.
    rows = np.array([folds[i].test[0] for i in single], dtype=np.intp)
    at = np.array([tests[i].start for i in single], dtype=np.intp)
    left = []
    for alpha, held_out in zip(alphas, values, strict=True):
        left.append([i for i, fold in enumerate(folds) if fold.overlaps])
        try:
            V, rcond = _features(problem, N, alpha, spectrum)
        except np.linalg.LinAlgError:
            left[-1] = list(range(len(folds)))
            continue
        residual = y - dgemm(1.0, V, dgemm(1.0, V, y), trans_a=1)
        least = max(EPSILON / (np.sqrt(rcond) * DIGITS), UNDETERMINED)
        rest = 1 - np.einsum("ij,ij->i", V.T, V.T)[rows]
        left[-1] += [i for i, own in zip(single, rest, strict=True) if not own > least]
        with np.errstate(divide="ignore", invalid="ignore"):
            held_out[at] = y[rows] - residual[rows] / rest[:, np.newaxis]
        for i in several:
            out, test = folds[i].out, folds[i].test
            rest = dsyrk(-1.0, V[:, out], trans=1, lower=1)
            rest[np.diag_indices(len(rest))] += 1.0
            lower, e, info = dposv(rest, residual[out], lower=1, overwrite_a=1)
            # The norm of I - H is at most one.
            if info or not dpocon(lower, 1.0, uplo="L")[0] > least:
                left[-1].append(i)
                continue
            held_out[tests[i]] = y[test] - e[np.searchsorted(out, test)]
    return left


def _spectrum(problem: Regression, N: Array) -> tuple[Array, Array]:
    """Return the eigenvalues of the normal matrix, and the features along its axes."""
    size, axes, info = dsyevd(problem.regular(N, 0.0), lower=1, overwrite_a=1)
    if info != 0:
        size = np.zeros(len(N))  # not used then
    return size, dgemm(1.0, axes, problem.A, trans_a=1)


def _features(
    problem: Regression, N: Array, alpha: float, spectrum: tuple[Array, Array] | None
) -> tuple[Array, float]:
    """Return V, whose V^T V is the hat matrix, and how near to singular N is.

    Raises
    ------
    LinAlgError
        If the rows do not determine the estimate.
    """
    T = problem.T
    if spectrum is not None and spectrum[0][0] + alpha > RESOLVED * spectrum[0][-1]:
        shifted = spectrum[0] + alpha
        V = spectrum[1] / np.sqrt(shifted)[:, np.newaxis]
        rcond = shifted[0] / shifted[-1]
    else:
        lower = problem.factored(N, alpha)
        V = solve_triangular(lower, problem.A)
        rcond = (lower.diagonal().min() / lower.diagonal().max()) ** 2
    if len(T):
        AT = dgemm(1.0, V, T, trans_b=1)
        axes = _trend_axes(T @ T.T, AT)
        V = np.vstack([V, axes.T @ (T - dgemm(1.0, AT, V, trans_a=1))])
    return np.asfortranarray(V), float(rcond)
