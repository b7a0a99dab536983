"""Cross-validation of the candidates of a search.

A candidate is a kernel with its scale. It has predictions for every weight alpha: from
a closed form where that applies, and else from refits of the regressor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.stats import rankdata
from sklearn.base import BaseEstimator, RegressorMixin, clone

from .._linalg._leave_out import (
    Fold,
    Predictions,
    leave_out_interpolation,
    leave_out_least_squares,
)
from .._matrices._polynomial import DEGREES, PolynomialTrend
from .._matrices._sections import KernelSections, matrix
from .._utils._rows import distinct_rows, group_means
from .._utils._typing import Array, Indices


class Split(NamedTuple):
    """Rows of a fold. All of its training rows would be a long list for each fold."""

    out: Indices  # rows that are not among the training rows
    test: Indices


@dataclass(frozen=True)
class Problem:
    """What all candidates share: the rows, the centres and the folds."""

    X: Array
    y: Array
    centers: Array  # no two are equal
    splits: list[Split]
    regressor: Any  # not fitted, with the parameters that the candidates share
    every_row: bool  # every row is a centre
    weights: Array | None = None  # of the rows, all positive

    @property
    def interpolates(self) -> bool:
        """Whether outputs of centres are used, and not those of all rows."""
        # Least squares over the sections of all rows is interpolation with alpha.
        return self.every_row or self.regressor.method == "interpolation"

    @cached_property
    def table(self) -> tuple[Array, Indices]:
        """The M centres and the other distinct rows, and which each row of X is."""
        rows = np.vstack([self.centers, self.X])
        first, group, _ = distinct_rows(rows)
        return rows[first], group[len(self.centers) :]

    @cached_property
    def outputs(self) -> tuple[Array, Array]:
        """Outputs of the centres, and the weight of each: the number of its rows."""
        M, place, y = len(self.centers), self.table[1], self.y.reshape(len(self.y), -1)
        means = group_means(y, place, self.weights)[:M]
        return means, np.bincount(place, self.weights)[:M].astype(np.float64)

    @cached_property
    def folds(self) -> list[Fold]:
        """The folds as the closed form takes them."""
        if not self.interpolates:
            return [Fold(out, test) for out, test in self.splits]
        M, place = len(self.centers), self.table[1]
        size = np.bincount(place, minlength=M)[:M]
        folds = []
        for rows, test in self.splits:
            out, lost = np.unique(place[rows], return_counts=True)
            out, lost = out[out < M], lost[out < M]
            # The outputs of centres that stay change if equal rows go.
            is_gone = lost == size[out]
            is_changed = not is_gone.all() or is_gone.sum() == M
            folds.append(Fold(out[is_gone], place[test], is_changed))
        return folds

    def predict(
        self, kernel: Any, alphas: Sequence[float]
    ) -> list[list[Array] | ValueError]:
        """Predict the test rows of all folds, or say why not, for every alpha."""
        outcomes: list[list[Array] | ValueError] = []
        may_conflict = self.every_row and len(self.X) > len(self.centers)
        for alpha, found in zip(alphas, self._leave_out(kernel, alphas), strict=True):
            try:
                if isinstance(found, ValueError) or (alpha == 0 and may_conflict):
                    found = self._leave_out_of_kept(kernel, alpha)
                predictions = [
                    self._refit(kernel, alpha, split) if own is None else own
                    for own, split in zip(found, self.splits, strict=True)
                ]
                if not np.isfinite(np.concatenate(predictions)).all():
                    raise ValueError("the predictions are not finite")
                shape = self.y.shape[1:]
                outcomes.append([own.reshape(-1, *shape) for own in predictions])
            except ValueError as error:
                outcomes.append(error)
        return outcomes

    def _leave_out(
        self, kernel: Any, alphas: Sequence[float], *, is_verified: bool = False
    ) -> Sequence[Predictions | ValueError]:
        """Predict from the closed form."""
        sections = KernelSections(kernel, self.centers)
        table, place = self.table
        K = matrix(sections, table)
        # A noise term of the kernel is on the diagonal only.
        noise = sections.diagonal(self.centers) - K.diagonal()
        P = np.empty((len(K), 0))
        degree = DEGREES[self.regressor.trend]
        try:
            if degree is not None:
                rows = self.centers if self.interpolates else self.X
                extent = np.stack([rows.min(axis=0), rows.max(axis=0)])
                P = PolynomialTrend.at(self.centers, degree, extent).values(table)
            if self.interpolates:
                u, weight = self.outputs
                return leave_out_interpolation(
                    K, noise, P, weight, u, self.folds, alphas
                )
            y = self.y.reshape(len(self.y), -1)
            return leave_out_least_squares(
                *(K, noise, P, place, y, self.folds, alphas),
                is_verified=is_verified,
                weights=self.weights,
            )
        except np.linalg.LinAlgError as error:
            return [error] * len(alphas)

    def _leave_out_of_kept(self, kernel: Any, alpha: float) -> Predictions:
        """Predict from the closed form with the centres that the regressor keeps.

        Raises
        ------
        ValueError
            If the regressor has no estimate on all rows.
        """
        centers = None if self.every_row else self.centers
        model = self._fit(kernel, alpha, centers, np.arange(len(self.X)))
        kept = replace(self, centers=model.centers_)
        [found] = kept._leave_out(kernel, [alpha], is_verified=True)
        return [None] * len(self.splits) if isinstance(found, ValueError) else found

    def _refit(self, kernel: Any, alpha: float, split: Split) -> Array:
        train = np.delete(np.arange(len(self.X)), split.out)
        centers = None if self.every_row else self.centers
        if centers is not None and self.interpolates:
            place = self.table[1][train]
            centers = centers[np.isin(np.arange(len(centers)), place)]
        model = self._fit(kernel, alpha, centers, train)
        return np.reshape(model.predict(self.X[split.test]), (len(split.test), -1))

    def _fit(self, kernel: Any, alpha: float, centers: Any, rows: Indices) -> Any:
        model = clone(self.regressor)
        model.set_params(kernel=kernel, alpha=alpha, centers=centers)
        weights = None if self.weights is None else self.weights[rows]
        return model.fit(self.X[rows], self.y[rows], weights)


class IdentityRegressor(RegressorMixin, BaseEstimator):
    """Predicts its input, so that scorers can be applied to stored predictions."""

    def fit(self, X: Any, y: Any = None) -> Self:
        return self

    def predict(self, X: Any) -> Any:
        return X


def negative_squared_errors(estimator: Any, X: Array, y: Array) -> Array:
    """Score every row by its squared error, averaged over the outputs."""
    return -np.square(X - y).reshape(len(y), -1).mean(axis=1)


def takes_weights(scorer: Any) -> bool:
    """Tell whether a scorer, or the metric that it was made of, takes weights."""
    metric = getattr(scorer, "_score_func", scorer)
    try:
        return "sample_weight" in signature(metric).parameters
    except ValueError:  # of a function without a signature, as some of NumPy
        return False


def score_kernel(
    kernel: Any, problem: Problem, alphas: Sequence[float], scorer: Any, pooled: bool
) -> list[Array | ValueError]:
    """Return the scores of all folds, or why there are none, for every alpha.

    With `pooled`, the folds are single rows, which are scored together.
    """
    outcomes: list[Array | ValueError] = []
    weights = problem.weights if takes_weights(scorer) else None
    for found in problem.predict(kernel, alphas):
        if isinstance(found, ValueError):
            outcomes.append(found)
            continue
        tests: list[Any] = [split.test for split in problem.splits]
        if pooled:
            found, tests = [np.concatenate(found)], [slice(None)]
        scores = []
        for own, rows in zip(found, tests, strict=True):
            options = {} if weights is None else {"sample_weight": weights[rows]}
            scores.append(scorer(IdentityRegressor(), own, problem.y[rows], **options))
        outcomes.append(np.hstack(scores))
    return outcomes


def tabulate(
    params: list[dict[str, Any]],
    outcomes: Sequence[Array | ValueError],
    by_fold: bool,
    weights: Array | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Tabulate the scores as GridSearchCV does, and name candidates without any.

    Weights are those of the scores in their mean and standard deviation.
    """
    failed, rows = [], []
    for candidate, outcome in zip(params, outcomes, strict=True):
        if isinstance(outcome, ValueError):
            failed.append(f"{candidate}: {outcome}")
            outcome = np.array(np.nan)
        rows.append(outcome)
    scores = np.vstack(np.broadcast_arrays(*rows))
    mean = np.average(scores, axis=1, weights=weights)
    if np.isnan(mean).all():
        reason = failed[0] if failed else "the scores themselves are nan"
        raise ValueError(
            f"None of {len(params)} candidates has a score; {reason}. Choose fewer "
            "centres, lower betas, raise alphas, or take larger folds."
        )
    results: dict[str, Any] = {"params": params}
    for name in ("alpha", "beta", "kernel"):
        values = np.array([one[name] for one in params], dtype=object)
        if all(isinstance(value, float | int) for value in values):
            values = values.astype(np.float64)
        results[f"param_{name}"] = np.ma.MaskedArray(values, mask=False)
    if by_fold:
        for i, column in enumerate(scores.T):
            results[f"split{i}_test_score"] = column.copy()
    results["mean_test_score"] = mean
    squares = np.square(scores - mean[:, np.newaxis])
    results["std_test_score"] = np.sqrt(np.average(squares, axis=1, weights=weights))
    worst = np.nan_to_num(mean, nan=np.nanmin(mean) - 1)
    results["rank_test_score"] = rankdata(-worst, method="min").astype(np.int32)
    return results, failed
