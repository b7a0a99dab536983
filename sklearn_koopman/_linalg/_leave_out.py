"""Held-out predictions of interpolation without refitting: functions of arrays.

A fold takes some centres away, and where rows are equal it may change
the outputs and the nugget of others. With a root W of the inverse of K + D, for
example L^-1, less its part along the polynomials, A = W^T W takes outputs to
coefficients. If the outputs of the centres T change by delta and their diagonal by E,
infinite for centres that go, the new coefficients are those of the outputs

    u + g,   g = delta - h,   (E^-1 + A_TT) h = A_T: (u + delta),

with A_TT of columns of W alone, so that no large matrices cancel. At centres that go,
u + g is what the rest predicts there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk
from scipy.linalg.lapack import dpocon, dposv, dsyevd, dtrtri

from sklearn_koopman._linalg._cholesky import SINGULAR, cholesky, solve_triangular
from sklearn_koopman._linalg._direct import ACCURACY
from sklearn_koopman._linalg._least_squares import SUSPECT
from sklearn_koopman._utils._typing import Array, Indices, Mask

# Predicts the test rows of one fold, by its number, from an estimate made anew.
Refit = Callable[[int], Array]

EPSILON = float(np.finfo(np.float64).eps)
# A closed form whose condition number leaves fewer digits than this is not used.
DIGITS = 1e-10
# What is left of the polynomials on the centres that stay, relative to all centres.
UNDETERMINED = 1e-8
# Eigenvalues below this part of the largest one are left to the Cholesky factor.
RESOLVED = 1e-8
# An eigendecomposition takes the time of so many Cholesky factorisations.
EIGEN = 12


@dataclass(frozen=True)
class Fold:
    """Rows that are predicted, and rows that the estimate does without."""

    test: Indices
    out: Indices
    order: Indices | None = None  # the training rows, where not in rising order

    @classmethod
    def of(cls, train: Indices, test: Indices, n_samples: int) -> Fold:
        out = np.ones(n_samples, dtype=bool)
        out[train] = False
        rising = bool((np.diff(train) > 0).all())
        return cls(test, np.flatnonzero(out), None if rising else train)

    @cached_property
    def overlaps(self) -> bool:
        """Tell whether test rows are among the training rows."""
        return not bool(np.isin(self.test, self.out).all())


@dataclass(frozen=True)
class Change:
    """What a fold changes about the centres, and where its test rows lie."""

    test: slice  # in the test rows of all folds, joined
    touched: Indices  # centres, in rising order
    delta: Array  # change of their outputs; zero for those that go
    weight: Array  # change of the diagonal in units of alpha; infinite for those
    at: Indices  # which touched centre each test row is; -1 if none
    place: Indices  # rows of the kernel matrix that hold the test rows

    @cached_property
    def gone(self) -> Mask:
        return np.isinf(self.weight)

    def excess(self, alpha: float) -> Array:
        """Return the change of the diagonal."""
        E = self.weight.copy()
        E[~self.gone] *= alpha
        return E


@dataclass(frozen=True)
class Samples:
    """Outputs of all rows, and which of the centres every row is."""

    label: Indices  # -1 for rows that are no centre
    place: Indices
    y: Array
    merged: bool  # equal rows count by their mean, not by the first of them

    def outputs(self, n_centers: int) -> tuple[Array, Array]:
        """Return the outputs of the centres, and their diagonal in units of alpha."""
        size = np.bincount(self.label[self.label >= 0], minlength=n_centers)
        rows = self._rows(n_centers)
        u = np.array([self._value(own) for own in rows])
        weight = 1 / size if self.merged else np.ones(n_centers)
        return u, weight

    def changes(self, n_centers: int, folds: Sequence[Fold]) -> list[Change]:
        """Work out what each fold changes."""
        u, _ = self.outputs(n_centers)
        members = self._rows(n_centers)
        size = np.array([len(own) for own in members])
        start, changes = 0, []
        for fold in folds:
            lost = np.bincount(self.label[fold.out] + 1, minlength=n_centers + 1)[1:]
            changed = lost > 0
            if fold.order is not None and not self.merged:
                changed |= size > 1  # the first of equal rows may be another one
            touched = np.flatnonzero(changed)
            left = (size - lost)[touched]
            delta = np.zeros((len(touched), self.y.shape[1]))
            weight = np.full(len(touched), np.inf)
            for i in np.flatnonzero(left):
                own = members[touched[i]]
                own = own[~np.isin(own, fold.out)]
                if fold.order is not None:
                    own = fold.order[np.isin(fold.order, own)]
                delta[i] = self._value(own) - u[touched[i]]
                weight[i] = 1 / left[i] - 1 / size[touched[i]] if self.merged else 0.0
            label = self.label[fold.test]
            at = np.searchsorted(touched, label)
            at[~np.isin(label, touched)] = -1
            stop = start + len(fold.test)
            place = self.place[fold.test]
            test = slice(start, stop)
            changes.append(Change(test, touched, delta, weight, at, place))
            start = stop
        return changes

    def _rows(self, n_centers: int) -> list[Indices]:
        order = np.argsort(self.label, kind="stable")
        bounds = np.searchsorted(self.label[order], np.arange(n_centers + 1))
        return [order[a:b] for a, b in pairwise(bounds)]

    def _value(self, rows: Indices) -> Array:
        return self.y[rows].mean(axis=0) if self.merged else self.y[rows[0]]


@dataclass(frozen=True)
class Interpolation:
    """The saddle-point system of the centres, for any weight of the nugget."""

    K: Array  # (n_places, M): sections at the centres and wherever tests are
    centers: Indices  # (M,): rows of K
    excess: Array  # (M,): noise of the kernel, which is on the diagonal only
    weight: Array  # (M,): diagonal in units of alpha
    P: Array  # (n_places, q): polynomials, orthonormal on the centres
    u: Array  # (M, n_outputs)

    def gram(self) -> Array:
        """Return K at the centres: a view if they are all in order."""
        M = self.K.shape[1]
        whole = np.array_equal(self.centers, np.arange(M))
        return self.K[:M] if whole else self.K[self.centers]

    def restricted(self, change: Change) -> Interpolation:
        """Return the problem that a fold leaves, with its test rows for the last."""
        weight, u = self.weight.copy(), self.u.copy()
        weight[change.touched] += change.weight
        u[change.touched] += change.delta
        stay = np.flatnonzero(np.isfinite(weight))
        rows = np.concatenate([self.centers[stay], change.place])
        return Interpolation(
            np.take(self.K[rows], stay, axis=1),  # in C order, as indexing is not
            np.arange(len(stay)),
            self.excess[stay],
            weight[stay],
            self.P[rows],
            u[stay],
        )

    def solve(self, alpha: float) -> tuple[Array, Array]:
        """Return the coefficients of the sections and of the polynomials.

        Raises
        ------
        LinAlgError
            If the matrix is not positive definite, or the outputs are not met.
        """
        K, P = self.gram(), self.P[self.centers]
        diagonal = self.excess + alpha * self.weight
        lower = factor(K, diagonal)
        solved = solve_triangular(lower, np.hstack([self.u, P]))
        n_outputs = self.u.shape[1]
        v, Q, R = solved[:, :n_outputs], *np.linalg.qr(solved[:, n_outputs:])
        b = Q.T @ v
        dual = solve_triangular(lower, v - Q @ b, transpose=True)
        trend = np.linalg.solve(R, b)
        check_solution(K, diagonal, P, dual, trend, self.u)
        return dual, trend

    def evaluate(self, places: Indices | slice, dual: Array, trend: Array) -> Array:
        return times(self.K[places], dual) + self.P[places] @ trend


def times(K: Array, dual: Array) -> Array:
    """Multiply a matrix in C order, with the BLAS that factors the matrices."""
    if not len(K):
        return np.zeros((0, dual.shape[1]))
    return np.asarray(dgemm(1.0, K.T, dual, trans_a=1))


def factor(K: Array, diagonal: Array) -> Array:
    """Return the Cholesky factor of K + diag, clean above its diagonal.

    Raises
    ------
    LinAlgError
        If the matrix is not numerically positive definite.
    """
    F = np.array(K.T, order="F")
    F[np.diag_indices(len(F))] += diagonal
    lower, info = cholesky(F, lower=True, clean=True)
    if info != 0:
        raise np.linalg.LinAlgError("the Gram matrix is not positive definite")
    pivots = lower.diagonal()
    # The pivots bound the condition number from below, at next to no cost.
    if (pivots.min() / pivots.max()) ** 2 < SUSPECT:
        norm = float((np.abs(K).sum(axis=0) + np.abs(diagonal)).max())
        if dpocon(lower, norm, uplo="L")[0] < SINGULAR:
            raise np.linalg.LinAlgError("the Gram matrix is numerically singular")
    return lower


def check_solution(
    K: Array, diagonal: Array, P: Array, dual: Array, trend: Array, u: Array
) -> None:
    """Refuse coefficients that do not give back the outputs they were made from."""
    if not np.isfinite(dual).all():
        raise np.linalg.LinAlgError("the coefficients are not finite")
    missed = times(K, dual) + diagonal[:, np.newaxis] * dual + P @ trend - u
    error = float(np.abs(missed).max()) / (float(np.abs(u).max()) or 1.0)
    if error > ACCURACY:
        raise np.linalg.LinAlgError(f"the solution misses its values by {error:.1e}")


def undetermined(P: Array, centers: Indices, change: Change) -> bool:
    """Tell whether the centres that stay determine fewer polynomials than all do."""
    if not P.shape[1]:
        return False
    lost = P[centers[change.touched[change.gone]]]
    return bool(np.linalg.eigvalsh(lost.T @ lost)[-1] > 1 - UNDETERMINED)


def interpolation_route(
    n_centers: int, changes: Sequence[Change], n_alphas: int
) -> str:
    """Choose the cheapest way to the held-out values, by its number of operations.

    "folds" factors what each fold leaves of the matrix, "cholesky" inverts the factor
    of the whole matrix for every alpha, and "eigen" decomposes it once.
    """
    M = float(n_centers)
    columns = np.array([len(change.touched) for change in changes], dtype=float)
    gone = np.array([change.gone.sum() for change in changes], dtype=float)
    local = 2 * M * np.square(columns[columns > 1]).sum()
    return cheapest(
        folds=n_alphas * ((M - gone) ** 3).sum() / 3,
        cholesky=n_alphas * (2 / 3 * M**3 + local),
        eigen=EIGEN * M**3 / 3 + n_alphas * (2 * M**2 + local),
    )


def interpolated(
    problem: Interpolation,
    changes: Sequence[Change],
    alphas: Sequence[float],
    refit: Callable[[float], Refit],
) -> list[Array | ValueError]:
    """Predict the test rows of all folds for every alpha, or say what prevents it."""
    M = len(problem.u)
    route = interpolation_route(M, changes, len(alphas))
    rank_lost = [undetermined(problem.P, problem.centers, one) for one in changes]
    spectrum = _spectrum(problem) if route == "eigen" else None
    values = np.empty((len(alphas), changes[-1].test.stop, problem.u.shape[1]))
    left = [list(rank_lost) for _ in alphas]
    errors: list[ValueError | None] = [None] * len(alphas)
    if route == "folds":
        for change in (
            one for one, lost in zip(changes, rank_lost, strict=True) if not lost
        ):
            own = problem.restricted(change)
            for j in (j for j, error in enumerate(errors) if error is None):
                try:
                    solution = own.solve(alphas[j])
                except np.linalg.LinAlgError as error:
                    errors[j] = error
                else:
                    places = slice(len(own.u), None)
                    values[j, change.test] = own.evaluate(places, *solution)
    else:
        for j, alpha in enumerate(alphas):
            try:
                _by_root(problem, changes, alpha, spectrum, values[j], left[j])
            except np.linalg.LinAlgError as error:
                errors[j] = error
    tests = [change.test for change in changes]
    unpredicted = [np.flatnonzero(one) for one in left]
    return completed(values, errors, unpredicted, tests, alphas, refit)


def completed(
    values: Array,
    errors: Sequence[ValueError | None],
    left: Sequence[Indices],
    tests: Sequence[slice],
    alphas: Sequence[float],
    refit: Callable[[float], Refit],
) -> list[Array | ValueError]:
    """Refit the folds that have no predictions yet."""
    outcomes: list[Array | ValueError] = []
    for j, alpha in enumerate(alphas):
        error = errors[j]
        try:
            for i in left[j] if error is None else ():
                values[j, tests[i]] = refit(alpha)(i)
        except ValueError as failure:  # of linear algebra, too
            error = failure
        outcomes.append(values[j] if error is None else error)
    return outcomes


@dataclass(frozen=True)
class _Spectrum:
    """Eigenvalues of S K S, and its eigenvectors V with S applied: V^T S."""

    values: Array
    vectors: Array

    def root(self, alpha: float) -> Array | None:
        """Return a root of the inverse of K + alpha S^-2, if the digits suffice."""
        shifted = self.values + alpha
        if shifted[0] < RESOLVED * shifted[-1]:
            return None
        return np.asfortranarray(self.vectors / np.sqrt(shifted)[:, np.newaxis])


def _spectrum(problem: Interpolation) -> _Spectrum:
    scale = 1 / np.sqrt(problem.weight)
    K = np.array(problem.gram().T, order="F")
    K[np.diag_indices(len(K))] += problem.excess
    K *= scale[:, np.newaxis]
    K *= scale
    values, vectors, info = dsyevd(K, lower=1, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError("the eigendecomposition has not converged")
    return _Spectrum(values, vectors.T * scale)


def _by_root(
    problem: Interpolation,
    changes: Sequence[Change],
    alpha: float,
    spectrum: _Spectrum | None,
    values: Array,
    left: list[bool],
) -> None:
    """Fill in what the closed form gives; mark the folds that it does not."""
    u, diagonal = problem.u, problem.excess + alpha * problem.weight
    P = problem.P[problem.centers]
    W = None if spectrum is None else spectrum.root(alpha)
    if W is None:
        W, info = dtrtri(factor(problem.gram(), diagonal), lower=1, overwrite_c=1)
        if info != 0:
            raise np.linalg.LinAlgError("the Gram matrix is singular")
    Q, R = np.linalg.qr(dgemm(1.0, W, P)) if P.shape[1] else (P, np.empty((0, 0)))
    # The part along the polynomials tells the trend, and the rest the coefficients.
    along = dgemm(1.0, Q, W, trans_a=1) if len(R) else np.empty((0, len(u)))
    if len(R):
        W = dgemm(-1.0, Q, along, 1.0, W, overwrite_c=1)
    along = np.linalg.solve(R, along)
    v = dgemm(1.0, W, u)
    c, trend = dgemm(1.0, W, v, trans_a=1), along @ u
    check_solution(problem.gram(), diagonal, P, c, trend, u)

    single, unchanged, others = _sorted_changes(changes, left)
    if single:
        at = np.concatenate([changes[i].touched for i in single])
        delta = np.concatenate([changes[i].delta for i in single])
        E = np.concatenate([changes[i].excess(alpha) for i in single])[:, np.newaxis]
        size = np.einsum("ij,ij->i", W.T, W.T)[at, np.newaxis]
        with np.errstate(divide="ignore"):
            h = (c[at] + size * delta) / (1 / E + size)
        new = np.where(np.isinf(E), 0.0, c[at] + size * (delta - h))
        held_out = u[at] + delta - h - diagonal[at, np.newaxis] * new
        counts = [len(changes[i].place) for i in single]
        values[_positions(changes, single)] = np.repeat(held_out, counts, axis=0)
    if unchanged:
        places = np.concatenate([changes[i].place for i in unchanged])
        values[_positions(changes, unchanged)] = problem.evaluate(places, c, trend)
    moved, columns = [], []
    for i in others:
        change = changes[i]
        solved = _replacement(W, v, change, alpha)
        if solved is None:
            left[i] = True
            continue
        g, image = solved
        new = c[change.touched] + W[:, change.touched].T @ image
        new[change.gone] = 0.0
        held_out = u[change.touched] + g - diagonal[change.touched][:, np.newaxis] * new
        known = change.at >= 0
        values[change.test][known] = held_out[change.at[known]]
        if not known.all():
            moved.append((change, along[:, change.touched] @ g))
            columns.append(image)
    if moved:
        duals = np.split(
            dgemm(1.0, W, np.hstack(columns), trans_a=1), len(moved), axis=1
        )
        for (change, step), dual in zip(moved, duals, strict=True):
            known = change.at >= 0
            values[change.test][~known] = problem.evaluate(
                change.place[~known], c + dual, trend + step
            )


def _sorted_changes(
    changes: Sequence[Change], left: Sequence[bool]
) -> tuple[list[int], list[int], list[int]]:
    """Sort folds by what they touch: one centre that all tests are, none, others."""
    single, unchanged, others = [], [], []
    for i, change in enumerate(changes):
        if left[i]:
            continue
        if not len(change.touched):
            unchanged.append(i)
        elif len(change.touched) == 1 and (change.at == 0).all():
            single.append(i)
        else:
            others.append(i)
    return single, unchanged, others


def _positions(changes: Sequence[Change], chosen: Sequence[int]) -> Indices:
    return np.concatenate(
        [np.arange(changes[i].test.start, changes[i].test.stop) for i in chosen]
    )


def _replacement(
    W: Array, v: Array, change: Change, alpha: float
) -> tuple[Array, Array] | None:
    """Return g, and W g; None where too few digits of it would be right."""
    columns = W[:, change.touched]
    E = change.excess(alpha)
    free = E > 0
    g = change.delta.copy()
    if free.any():
        A = columns[:, free]
        S = dsyrk(1.0, A, trans=1, lower=1)
        S[np.diag_indices(len(S))] += 1 / E[free]
        # In units in which the diagonal is one.
        unit = 1 / np.sqrt(S.diagonal())
        S *= unit[:, np.newaxis] * unit
        size = np.abs(S)
        norm = float((size.sum(axis=0) + size.sum(axis=1)).max())
        wanted = unit[:, np.newaxis] * (A.T @ (v + columns @ g))
        lower, h, info = dposv(S, wanted, lower=1, overwrite_a=1)
        if info or not dpocon(lower, norm, uplo="L")[0] > EPSILON / DIGITS:
            return None
        g[free] -= unit[:, np.newaxis] * h
    return g, columns @ g


def cheapest(**costs: float) -> str:
    return min(costs, key=costs.__getitem__)
