"""Held-out predictions in closed form, without an estimate for each fold.

Interpolation. The centres have the matrix K + D, whose diagonal D holds the noise and
the weight alpha, the values P of q polynomials, and the outputs u. The coefficients of
the kernel sections are c = A u, where A is the upper left block of the inverse of
[K + D, P; P^T, 0]. Without the centres S of a fold they are

    c' = c - A[:, S] e,    e = A[S, S]^-1 c[S],

and the other centres predict u[S] - e at those of the fold (block inversion).

Least squares. F of shape (M, n) holds the values of M basis functions on all n rows.
With the penalty E of their coefficients, the normal matrix is N = F F^T + E and the
hat matrix H = F^T N^-1 F. Where rows have weights, F and y are multiplied by their
roots. A fold without the rows S has the same predictions from two
systems, of which the smaller one is solved: that of F F^T and F y summed up over the
other rows, of size M, or that of the residuals r = y - H y, of the size of S:

    y[S] - prediction[S] = (I - H[S, S])^-1 r[S].
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import compress

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dgemm, dsyrk
from scipy.linalg.lapack import dpocon, dposv, dpotrs, dtrtri

from .._utils._typing import Array, Indices
from ._cholesky import (
    MIN_RCOND,
    RCOND_TO_VERIFY,
    cholesky,
    exact_rcond,
    pivot_rcond,
    probe_rcond,
)
from ._fit import make_nugget

# Largest error of the interpolant at the centres, relative to the outputs.
MAX_MISFIT = 1e-6
# Rounding adds up to 1e-9 to the residuals of a fold, relative to them, if the
# reciprocal condition number of its system is this.
MIN_FOLD_RCOND = float(np.finfo(np.float64).eps) / 1e-9
# A normal matrix below this reciprocal condition number is left to the regressor, which
# refuses it, or drops centres, at a tenth of this.
MIN_NORMAL_RCOND = 1e-12
# Normal matrices of folds that are in memory at a time.
FOLDS_AT_ONCE = 4


@dataclass(frozen=True)
class Fold:
    """What a fold leaves out, and where it is tested, as numbers of rows.

    For interpolation these are rows of the kernel matrix, of which the first M belong
    to the centres; for least squares they are rows of the data.
    """

    out: Indices  # in rising order
    test: Indices
    needs_refit: bool = False  # the closed form does not apply

    @cached_property
    def places(self) -> Indices:
        """Where in `out` each test row is; -1 if it is not there."""
        is_out = np.isin(self.test, self.out)
        return np.where(is_out, np.searchsorted(self.out, self.test), -1)


# The predictions of each fold; None where the closed form does not apply, or where it
# is not accurate enough.
Predictions = list[Array | None]


def leave_out_interpolation(
    K: Array,
    noise: Array,
    P: Array,
    weight: Array,
    u: Array,
    folds: Sequence[Fold],
    alphas: Sequence[float],
) -> list[Predictions | ValueError]:
    """Predict the test rows of all folds by interpolation, for every alpha.

    Parameters
    ----------
    K : ndarray of shape (n_rows, M)
        Kernel matrix of all rows and the centres, which are the first M rows.
    noise, weight : ndarray of shape (M,)
        D is `noise` + `make_nugget` of alpha and `weight`.
    P : ndarray of shape (n_rows, q)
        Polynomials, orthonormal on the centres.
    u : ndarray of shape (M, n_outputs)
        Outputs of the centres.
    folds : sequence of Fold
        `out` are centres.
    alphas : sequence of float
        Weights.

    Returns
    -------
    outcomes : list of Predictions or ValueError
        An error for each alpha whose matrix is singular.
    """
    outcomes: list[Predictions | ValueError] = []
    for alpha in alphas:
        try:
            nugget = make_nugget(alpha, weight, K.diagonal() + noise)
            outcomes.append(_interpolate(K, noise + nugget, P, u, folds))
        except np.linalg.LinAlgError as error:
            outcomes.append(error)
    return outcomes


def _interpolate(
    K: Array, diagonal: Array, P: Array, u: Array, folds: Sequence[Fold]
) -> Predictions:
    M = len(u)
    # A = W^T W with the inverse W of the Cholesky factor, less its part along P.
    lower = _factor(K[:M], MIN_RCOND, diagonal)
    W, _ = dtrtri(lower, lower=1, overwrite_c=1)
    size = np.einsum("ij,ij->j", W, W)
    B = np.empty((0, M))  # takes outputs to the coefficients of the polynomials
    if P.shape[1]:
        along, R = np.linalg.qr(dgemm(1.0, W, P[:M]))
        B = dgemm(1.0, along, W, trans_a=1)
        W = dgemm(-1.0, along, B, 1.0, W, overwrite_c=1)
        B = np.linalg.solve(R, B)
    c, b = dgemm(1.0, W, dgemm(1.0, W, u), trans_a=1), B @ u
    # NumPy has a BLAS of its own, whose threads slow down those of SciPy's.
    fitted = dgemm(1.0, K.T, c, trans_a=1) + P @ b
    misfit = np.abs(fitted[:M] + diagonal[:, np.newaxis] * c - u).max()
    if not misfit <= MAX_MISFIT * (np.abs(u).max() or 1.0):
        raise np.linalg.LinAlgError("the interpolant misses its values")

    predictions: Predictions = [None] * len(folds)
    partial = []  # folds whose test rows are not all among the centres left out
    for i, fold in enumerate(folds):
        S = fold.out
        if fold.needs_refit:
            continue
        if not len(S):
            predictions[i] = fitted[fold.test]
            continue
        WS = W[:, S]
        A = dsyrk(1.0, WS, trans=1, lower=1)
        with suppress(np.linalg.LinAlgError):
            e = _solve(A, c[S], size[S], MIN_FOLD_RCOND)
            if (fold.places >= 0).all():
                predictions[i] = (u[S] - e)[fold.places]
            else:
                partial.append((i, e, WS @ e))
    if partial:
        images = np.hstack([image for *_, image in partial])
        changes = np.split(dgemm(1.0, W, images, trans_a=1), len(partial), axis=1)
        for (i, e, _), change in zip(partial, changes, strict=True):
            S, test, places = folds[i].out, folds[i].test, folds[i].places
            values = fitted[test] - dgemm(1.0, K[test].T, change, trans_a=1)
            values -= P[test] @ (B[:, S] @ e)
            values[places >= 0] = (u[S] - e)[places[places >= 0]]
            predictions[i] = values
    return predictions


def leave_out_least_squares(
    K: Array,
    noise: Array,
    P: Array,
    rows: Indices,
    y: Array,
    folds: Sequence[Fold],
    alphas: Sequence[float],
    *,
    is_verified: bool,
    weights: Array | None = None,
) -> list[Predictions]:
    """Predict the test rows of all folds by least squares, for every alpha.

    Parameters
    ----------
    K, noise, P
        As for interpolation.
    rows : ndarray of shape (n_samples,)
        Which row of `K` and `P` each row of the data is.
    y : ndarray of shape (n_samples, n_outputs)
        Outputs.
    folds : sequence of Fold
        `out` are rows of the data, and have to hold the test rows.
    alphas : sequence of float
        Weights.
    is_verified : bool
        Whether an estimate with these centres is known to be accurate although their
        matrix is nearly singular.
    weights : ndarray of shape (n_samples,), default=None
        Positive weights of the squared residuals.

    Returns
    -------
    predictions : list of Predictions
        For every alpha.

    Raises
    ------
    LinAlgError
        If the matrix of the centres is singular, or nearly so and not verified.
    """
    M = K.shape[1]
    # Functions that are orthonormal in the native space; those along Q have no penalty.
    min_rcond = MIN_RCOND if is_verified else RCOND_TO_VERIFY
    lower = _factor(K[:M], min_rcond, noise)
    F = solve_triangular(
        lower, K[rows].T, lower=True, overwrite_b=True, check_finite=False
    )
    Q, R = np.linalg.qr(solve_triangular(lower, P[:M], lower=True))
    if P.shape[1]:
        t = np.linalg.solve(R.T, P[rows].T) - dgemm(1.0, Q, F, trans_a=1)
        F = dgemm(1.0, Q, t, 1.0, F, overwrite_c=1)
    penalty = np.eye(M) - Q @ Q.T
    root = None
    if weights is not None:
        root = np.sqrt(weights)[:, np.newaxis]
        F *= root.T
        y = root * y

    predictions: list[Predictions] = [[None] * len(folds) for _ in alphas]
    usable = [i for i, fold in enumerate(folds) if (fold.places >= 0).all()]
    large = [i for i in usable if 4 * len(folds[i].out) > M]
    small = [i for i in usable if 4 * len(folds[i].out) <= M]
    for start in range(0, len(large), FOLDS_AT_ONCE):
        chosen = large[start : start + FOLDS_AT_ONCE]
        sums = _sum_other_rows(F, y, [folds[i].out for i in chosen])
        for i, N in zip(chosen, sums, strict=True):
            for own, alpha in zip(predictions, alphas, strict=True):
                with suppress(np.linalg.LinAlgError):
                    L = _factor(N[:M, :M].T + alpha * penalty, MIN_NORMAL_RCOND)
                    z, _ = dpotrs(L, N[M:, :M].T, lower=1)
                    own[i] = dgemm(1.0, F[:, folds[i].test], z, trans_a=1)
    if small:
        N = dsyrk(1.0, F, lower=1).T
        for own, alpha in zip(predictions, alphas, strict=True):
            with suppress(np.linalg.LinAlgError):
                L = _factor(N + alpha * penalty, MIN_NORMAL_RCOND)
                # H = V^T V
                V = solve_triangular(L, F, lower=True, check_finite=False)
                residual = y - dgemm(1.0, V, dgemm(1.0, V, y), trans_a=1)
                rcond = pivot_rcond(L.diagonal())
                min_rcond = MIN_FOLD_RCOND / np.sqrt(rcond)
                for i in small:
                    S = folds[i].out
                    rest = np.eye(len(S)) - dsyrk(1.0, V[:, S], trans=1, lower=1)
                    with suppress(np.linalg.LinAlgError):
                        e = _solve(rest, residual[S], np.ones(len(S)), min_rcond)
                        own[i] = (y[S] - e)[folds[i].places]
    if root is not None:
        for own in predictions:
            for fold, values in zip(folds, own, strict=True):
                if values is not None:
                    values /= root[fold.test]
    return predictions


def _sum_other_rows(F: Array, y: Array, outs: Sequence[Indices]) -> Iterator[Array]:
    """Yield the lower triangle of [F; y^T] [F; y^T]^T without some rows of the data.

    Rows that the same folds use are summed up together. Nothing is subtracted, which
    would cancel digits where a fold holds most of a function.
    """
    features = np.asfortranarray(np.vstack([F, y.T]))
    is_used = np.ones((len(outs), len(y)), dtype=bool)
    for row, out in zip(is_used, outs, strict=True):
        row[out] = False
    patterns, kind = np.unique(is_used, axis=1, return_inverse=True)
    members = kind.reshape(-1) == np.arange(patterns.shape[1])[:, np.newaxis]
    parts = [dsyrk(1.0, features[:, rows], lower=1) for rows in members]
    for used in patterns:
        yield reduce(np.add, compress(parts, used))


def _factor(A: Array, min_rcond: float, diagonal: Array | float = 0.0) -> Array:
    """Return the Cholesky factor of A + diagonal, from the upper triangle of A.

    Raises
    ------
    LinAlgError
        If its reciprocal condition number is too small.
    """
    F = np.triu(A).T  # in Fortran order, and zero above the diagonal
    F[np.diag_indices(len(F))] += diagonal
    trace = float(np.trace(F))
    lower = cholesky(F)
    rcond = probe_rcond(lower, trace)
    if rcond < RCOND_TO_VERIFY:
        size = np.abs(np.triu(A))
        norm = (size.sum(axis=0) + size.sum(axis=1) + np.abs(diagonal)).max()
        rcond = exact_rcond(lower, norm)
    if rcond < min_rcond:
        raise np.linalg.LinAlgError("the matrix is numerically singular")
    return lower


def _solve(A: Array, rhs: Array, size: Array, min_rcond: float) -> Array:
    """Solve the small system of a fold, in units in which `size` is 1.

    Raises
    ------
    LinAlgError
        If its reciprocal condition number is too small.
    """
    if len(A) == 1 and A[0, 0] > min_rcond * size[0]:
        return rhs / A  # many folds are single rows, for which LAPACK takes long
    unit = 1 / np.sqrt(size)[:, np.newaxis]
    A *= unit * unit.T
    magnitude = np.abs(A)
    norm = float((magnitude.sum(axis=0) + magnitude.sum(axis=1)).max())
    lower, x, info = dposv(A, unit * rhs, lower=1, overwrite_a=1)
    # A system far below its unit has lost digits when it was made.
    if info or not dpocon(lower, max(norm, 1.0), uplo="L")[0] > min_rcond:
        raise np.linalg.LinAlgError("the system of the fold is nearly singular")
    return unit * x
