"""Cross-validation of the candidates of a search: functions of arrays.

What all candidates share (centres, folds, distances) is computed once; a candidate is
a kernel with its scale, and has predictions for every weight alpha.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpocon
from scipy.spatial.distance import cdist
from scipy.stats import rankdata
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import gen_batches

from sklearn_koopman._linalg import _direct
from sklearn_koopman._linalg._cholesky import solve_triangular
from sklearn_koopman._linalg._least_squares import SUSPECT
from sklearn_koopman._linalg._leave_out import (
    Fold,
    Interpolation,
    Samples,
    factor,
    interpolated,
)
from sklearn_koopman._linalg._leave_out_least_squares import Regression, regressed
from sklearn_koopman._matrices._polynomial import PolynomialTrend, polynomial
from sklearn_koopman._matrices._sections import TILE, KernelSections, matrix
from sklearn_koopman._utils._rows import distinct_rows, group_means
from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman.centers import choose_centers
from sklearn_koopman.kernels import FAR, RadialKernel

# Held-out predictions, or why there are none.
Outcome = Array | ValueError


@dataclass(frozen=True)
class Search:
    """What the candidates have in common."""

    X: Array
    y: Array
    points: Array  # the centres
    table: Array  # the centres, then all other rows
    label: Indices  # which centre each row is; -1 if none
    place: Indices  # which row of the table each row is
    merged: bool  # equal rows are one centre, with their mean output
    interpolates: bool
    degree: int | None
    drop_dependent: bool
    folds: list[Fold]
    conflict: ValueError | None  # that equal rows have different outputs

    @classmethod
    def of(
        cls,
        X: Array,
        y: Array,
        centers: Any,
        folds: list[Fold],
        *,
        interpolates: bool,
        degree: int | None,
        drop_dependent: bool,
    ) -> Search:
        """Choose the centres, and find out which rows they are."""
        exact, interpolates = interpolates, interpolates or centers is None
        points = X
        if centers is not None:
            points, _ = choose_centers(centers, X, y, among_rows=interpolates)
        first, group, _ = distinct_rows(np.vstack([points, X]))
        points = points[first[first < len(points)]]
        group = group[-len(X) :]
        label = np.where(group < len(points), group, -1)
        others = np.flatnonzero(label < 0)
        place = label.copy()
        place[others] = len(points) + np.arange(len(others))
        table = np.vstack([points, X[others]])
        merged = centers is None
        conflict = _conflict(y, label) if merged and exact else None
        return cls(
            X,
            y,
            points,
            table,
            label,
            place,
            merged,
            interpolates,
            degree,
            drop_dependent,
            folds,
            conflict,
        )

    def train(self, fold: Fold) -> Indices:
        """Return the training rows of a fold."""
        if fold.order is not None:
            return fold.order
        used = np.ones(len(self.X), dtype=bool)
        used[fold.out] = False
        return np.flatnonzero(used)

    def distances(self) -> tuple[Array, float]:
        """Return the distances of the table to the centres, and their unit."""
        # Scaled before differences are squared, so that no unit overflows.
        unit = float(np.abs(self.table).max()) or 1.0
        return cdist(self.table / unit, self.points / unit), unit

    def predictions(
        self,
        kernel: Any,
        alphas: Sequence[float],
        distances: tuple[Array, float] | None,
    ) -> list[Outcome]:
        """Predict the test rows of all folds, joined, for every alpha."""
        if isinstance(kernel, RadialKernel) and distances is not None:
            K = _radial(kernel, *distances, self.points.shape[1])
        else:
            K = matrix(KernelSections(kernel, self.points), self.table)
        everything = np.arange(len(self.points))
        outcomes: list[Outcome] = []
        for alpha, held_out in zip(
            alphas, self._held_out(kernel, K, everything, alphas), strict=True
        ):
            outcome = held_out
            if alpha == 0 and self.conflict is not None:
                outcome = self.conflict
            elif isinstance(outcome, ValueError):
                try:
                    outcome = self._on_independent(kernel, K, alpha)
                except ValueError as error:
                    outcome = error
            if not isinstance(outcome, ValueError) and not np.isfinite(outcome).all():
                outcome = ValueError("the predictions are not finite")
            outcomes.append(outcome)
        return outcomes

    def _held_out(
        self, kernel: Any, K: Array, kept: Indices, alphas: Sequence[float]
    ) -> list[Outcome]:
        """Predict from closed forms with the centres kept."""
        try:
            if self.interpolates:
                return self._interpolated(kernel, K, kept, alphas)
            return self._regressed(kernel, K, kept, alphas)
        except np.linalg.LinAlgError as error:
            return [error] * len(alphas)

    def _on_independent(self, kernel: Any, K: Array, alpha: float) -> Array:
        """Predict with the centres that the regressor keeps, or from its own refits."""
        rule = self._rule(np.arange(len(self.X)), np.arange(len(self.points)), alpha)
        solution, _ = self._solved(kernel, *rule)
        if len(solution.kept) < len(self.points):
            [outcome] = self._held_out(kernel, K, solution.kept, [alpha])
            if not isinstance(outcome, ValueError):
                return outcome
        refit = self._refit(kernel, solution.kept, alpha)
        return np.concatenate([refit(i) for i in range(len(self.folds))])

    def _interpolated(
        self, kernel: Any, K: Array, kept: Indices, alphas: Sequence[float]
    ) -> list[Outcome]:
        samples = self._samples(kept)
        u, weight = samples.outputs(len(kept))
        P = np.empty((len(self.table), 0))
        if self.degree is not None:
            tail = PolynomialTrend.on(self.points[kept], self.degree, self.points[kept])
            P = polynomial(self.table, tail.origin, tail.seen)
        problem = Interpolation(
            K if len(kept) == K.shape[1] else np.take(K, kept, axis=1),
            kept,
            self._excess(kernel, K, kept),
            weight,
            P,
            u,
        )
        changes = samples.changes(len(kept), self.folds)
        return interpolated(
            problem, changes, alphas, lambda alpha: self._refit(kernel, kept, alpha)
        )

    def _regressed(
        self, kernel: Any, K: Array, kept: Indices, alphas: Sequence[float]
    ) -> list[Outcome]:
        if len(kept) < K.shape[1]:
            K = np.take(K, kept, axis=1)
        lower = factor(K[kept], self._excess(kernel, K, kept))
        norm = float(np.abs(K[kept]).sum(axis=0).max())
        rcond = float(dpocon(lower, norm, uplo="L")[0])
        if rcond < SUSPECT and len(kept) == len(self.points):
            raise np.linalg.LinAlgError("the Gram matrix is nearly singular")
        A = np.array(K[self.place].T, order="F")
        A = solve_triangular(lower, A, overwrite=True)
        T, Q = np.empty((0, len(self.X))), np.empty((len(kept), 0))
        if self.degree is not None:
            centers = self.points[kept]
            tail = PolynomialTrend.on(centers, self.degree, self.X)
            P = polynomial(centers, tail.origin, tail.seen)
            Q, R = np.linalg.qr(solve_triangular(lower, P))
            A -= Q @ (Q.T @ A)
            seen = polynomial(self.X, tail.origin, tail.seen)
            unseen = polynomial(self.X, tail.origin, tail.unseen)
            T = np.vstack([np.linalg.solve(R.T, seen.T), unseen.T])
        problem = Regression(A, T, Q, self.y, rcond)
        return regressed(
            problem, self.folds, alphas, lambda alpha: self._refit(kernel, kept, alpha)
        )

    def _samples(self, kept: Indices) -> Samples:
        label = np.full(len(self.points) + 1, -1)
        label[kept] = np.arange(len(kept))
        return Samples(label[self.label], self.place, self.y, self.merged)

    def _excess(self, kernel: Any, K: Array, kept: Indices) -> Array:
        """Return what a noise term of the kernel adds to the diagonal."""
        sections = KernelSections(kernel, self.points[kept])
        smooth = K[kept, np.arange(len(kept)) if K.shape[1] == len(kept) else kept]
        return np.asarray(sections.diagonal(self.points[kept]) - smooth)

    def _refit(
        self, kernel: Any, kept: Indices, alpha: float
    ) -> Callable[[int], Array]:
        """Return a function that predicts the test rows of a fold from a refit."""

        def predicted(i: int) -> Array:
            fold = self.folds[i]
            rule = self._rule(self.train(fold), kept, alpha)
            solution, _ = self._solved(kernel, *rule)
            return _direct.evaluate(
                solution.basis.sections,
                solution.basis.tail,
                self.X[fold.test],
                solution.dual,
                solution.trend,
            )

        return predicted

    def _rule(
        self, rows: Indices, kept: Indices, alpha: float
    ) -> tuple[Array, Array, _direct.Rule, Array]:
        """Return the centres, their nugget, and the rule that some rows make."""
        if not self.interpolates:
            points = self.points[kept]
            if alpha == 0 and len(rows) < len(points):
                raise ValueError(
                    f"{len(rows)} training rows do not determine the coefficients of "
                    f"{len(points)} centres"
                )
            rule = _direct.regression(self.X[rows], self.y[rows], alpha, None)
            return points, np.zeros(len(points)), rule, self.X[rows]
        samples = self._samples(kept)
        samples = Samples(samples.label[rows], rows, self.y[rows], self.merged)
        kept = kept[np.isin(np.arange(len(kept)), samples.label)]
        samples = Samples(
            self._samples(kept).label[rows], rows, self.y[rows], self.merged
        )
        points = self.points[kept]
        u, weight = samples.outputs(len(kept))
        return points, alpha * weight, _direct.interpolation(points, u), points

    def _solved(
        self, kernel: Any, points: Array, nugget: Array, rule: Any, extent: Array
    ) -> tuple[_direct.Solution[Any], float]:
        return _direct.solve(
            KernelSections(kernel, points),
            points,
            nugget,
            rule,
            self.degree,
            extent,
            drop_dependent=self.drop_dependent,
        )


def _conflict(y: Array, label: Indices) -> ValueError | None:
    """Return the error of interpolating equal rows whose outputs differ."""
    deviation = np.abs(y - group_means(y, label)[label]).max(axis=1)
    worst = int(deviation.argmax())
    if deviation[worst] <= 1e-10 * np.abs(y).max():
        return None
    equal = np.flatnonzero(label == label[worst])
    other = equal[np.abs(y[equal] - y[equal[0]]).max(axis=1).argmax()]
    return ValueError(
        f"rows {equal[0]} and {other} of X are equal but their outputs differ: with "
        "alpha=0 no function interpolates both"
    )


def _radial(
    kernel: RadialKernel, distances: Array, unit: float, n_features: int
) -> Array:
    """Evaluate a radial kernel at distances, a few rows at a time in the cache."""
    K = np.empty_like(distances)
    for rows in gen_batches(len(K), max(TILE // K.shape[1], 1)):
        r = distances[rows] * (unit / kernel.beta)
        np.minimum(r, FAR, out=r)
        values = kernel.profile(r, n_features, K[rows])
        if values.base is not K:  # one that a subclass has made
            K[rows] = values
    return K


class HeldOut(RegressorMixin, BaseEstimator):
    """Predicts what it is given: scorers ask an estimator."""

    def fit(self, X: Any, y: Any = None) -> HeldOut:
        return self

    def predict(self, X: Any) -> Any:
        return X


def scores_of_folds(scorer: Any, folds: list[Fold], held_out: Array, y: Array) -> Array:
    """Score the predictions of each fold, which are joined in `held_out`."""
    ends = np.cumsum([len(fold.test) for fold in folds])
    parts = np.split(held_out, ends[:-1])
    scores = [
        scorer(HeldOut(), part.reshape((len(part), *y.shape[1:])), y[fold.test])
        for part, fold in zip(parts, folds, strict=True)
    ]
    return np.array(scores, dtype=np.float64)


def tabulated(
    params: list[dict[str, Any]], outcomes: list[Outcome], *, pooled: bool
) -> tuple[dict[str, Any], list[str]]:
    """Tabulate the scores as GridSearchCV does, and name candidates without any."""
    n_splits = max(
        (len(one) for one in outcomes if not isinstance(one, ValueError)), default=0
    )
    scores = np.full((len(params), max(n_splits, 1)), np.nan)
    for row, outcome in zip(scores, outcomes, strict=True):
        if not isinstance(outcome, ValueError):
            row[:] = outcome
    mean = scores.mean(axis=1)
    failed = [
        f"{one}: {why}"
        for one, why in zip(params, outcomes, strict=True)
        if isinstance(why, ValueError)
    ]
    if np.isnan(mean).all():
        reason = failed[0] if failed else "the scores themselves are nan"
        raise ValueError(
            f"None of {len(params)} candidates has a score; {reason}. Choose fewer "
            "centres, lower betas, raise alphas, or take larger folds."
        )
    results: dict[str, Any] = {"params": params}
    for name in ("alpha", "beta", "kernel"):
        values = np.empty(len(params), dtype=object)
        values[:] = [one[name] for one in params]
        if all(isinstance(value, float | int) for value in values):
            values = values.astype(np.float64)
        results[f"param_{name}"] = np.ma.MaskedArray(values, mask=False)
    if not pooled:
        for i, column in enumerate(scores.T):
            results[f"split{i}_test_score"] = column.copy()
    results["mean_test_score"] = mean
    results["std_test_score"] = scores.std(axis=1)
    worst = np.nan_to_num(mean, nan=np.nanmin(mean) - 1)
    results["rank_test_score"] = rankdata(-worst, method="min").astype(np.int32)
    return results, failed
