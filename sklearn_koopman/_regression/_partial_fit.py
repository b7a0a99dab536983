"""Estimates that learn from one batch of rows after the other."""

from __future__ import annotations

from abc import abstractmethod
from copy import copy
from dataclasses import replace
from typing import Any, Self

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_X_y
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import validate_data

from sklearn_koopman._linalg._cholesky import NativeBasis
from sklearn_koopman._linalg._direct import Solution, evaluate
from sklearn_koopman._linalg._incremental import GrowingFactor, GrowingInterpolant
from sklearn_koopman._linalg._select import REMEDY, accumulated, interpolated
from sklearn_koopman._matrices._polynomial import DEGREES
from sklearn_koopman._matrices._sections import KernelSections
from sklearn_koopman._utils._rows import AveragedOutputs
from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman.centers import SeparatedCenterSelector, choose_centers
from sklearn_koopman.kernels import as_kernel
from sklearn_koopman.solvers import ConjugateGradient


def _check_growth(model: GrowthMixin) -> bool:
    """Refuse what cannot grow."""
    if isinstance(getattr(model, "solver_", model.solver), ConjugateGradient):
        raise ValueError(
            "partial_fit extends a Cholesky factor, which conjugate gradients do not "
            "have; fit with solver='pivoted_cholesky' from the first batch on."
        )
    centers, averages = model.centers, model.method == "least_squares"
    chooses = isinstance(centers, SeparatedCenterSelector)
    given = not chooses and not hasattr(centers, "fit") and not isinstance(centers, str)
    if not (
        centers is None
        or (chooses and hasattr(centers, "partial_fit"))
        or (given and averages)
    ):
        raise ValueError(
            "partial_fit adds centres with centers=None or a "
            "SeparatedCenterSelector(order='sequential'), and rows with "
            "method='least_squares' and an array of centres, got "
            f"centers={centers!r} and method={model.method!r}."
        )
    started = hasattr(model, "dual_coef_")
    if averages and centers is not None and started and not hasattr(model, "_growth"):
        raise ValueError(
            "partial_fit of least squares at chosen centres continues from the sums "
            "of earlier batches, which neither fit nor a copy or pickle keeps; call "
            "partial_fit from the first batch on."
        )
    return True


def _equal(a: Any, b: Any) -> bool:
    """Tell whether parameters are equal, to the last digit."""
    if type(a) is not type(b):
        return False
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_equal, a, b))
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if hasattr(a, "get_params") and not isinstance(a, type):
        a, b = a.get_params(deep=False), b.get_params(deep=False)
        return all(_equal(a[name], b[name]) for name in a)
    return bool(a == b)


class GrowthMixin:
    """Gives a :class:`~sklearn_koopman.KoopmanKernelRegressor` its `partial_fit`."""

    kernel: Any
    beta: float | None
    centers: Any
    method: str
    alpha: float
    trend: str | None
    solver: str | ConjugateGradient
    n_jobs: int | None
    kernel_: Any
    centers_: Array
    center_indices_: Indices | None
    dual_coef_: Array
    _interpolates: bool
    _nugget: Array
    _n_seen: int
    _settings: list[Any]
    _values: AveragedOutputs

    @available_if(_check_growth)
    def partial_fit(self, X: Any, y: Any) -> Self:
        """Learn from further rows, as if all had been given to one `fit`.

        Interpolation adds the rows that become centres, k of them, to the Cholesky
        factor, in O(k M^2) operations: with ``centers=None`` all that are new, with a
        :class:`SeparatedCenterSelector` those farther than its separation from all
        centres so far. Least squares at given centres adds the rows to its normal
        equations, so that memory does not grow with their number.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.

        Returns
        -------
        self : object
            The estimate from all rows so far.

        Raises
        ------
        ValueError
            As in `fit`; for outputs of another shape than before; for parameters that
            were changed since. Nothing is learned from the batch then.
        AttributeError
            For centres and solvers that cannot grow, such as conjugate gradients; for
            least squares at chosen centres after `fit`, or in a copy or after loading
            from a pickle, none of which keeps its sums.

        Notes
        -----
        Least squares with a selector keeps the rows, and starts anew when a batch
        brings new centres. To stream through recordings that are larger than memory,
        find the centres first, by `SeparatedCenterSelector.partial_fit`, and give them
        as an array.

        After centres have been added, `rcond_` is an upper bound by the pivots of the
        factor. Where they come close to being dependent, all are factored anew, and
        left out as in `fit`; which ones then depends on the order, and the estimate is
        that of `fit` only as far as such matrices tell. `noise_std_` of least squares is
        a difference of sums, and not told where it is below about 1e-8 of the outputs.
        """
        started = hasattr(self, "dual_coef_")
        given = X
        if started:
            validate_data(self, given, reset=False, skip_check_array=True)
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        self._check_parameters()
        if started:
            if not _equal(self._settings, self._current_settings()):
                raise ValueError(
                    "Parameters were changed since the first batch; set them back, or "
                    "call fit to start anew."
                )
            if y.shape[1:] != self.dual_coef_.shape[1:]:
                raise ValueError(
                    f"y has shape {y.shape}, but predictions for {len(y)} rows so far "
                    f"have {(len(y), *self.dual_coef_.shape[1:])}; give the same "
                    "outputs in every batch."
                )
        if self.method == "interpolation" or self.centers is None:
            if started:
                self._add_centers(X, y)
            else:
                self.fit(given, y)
            return self
        self._add_rows(given, X, y, started)
        return self

    def _current_settings(self) -> list[Any]:
        """Return copies of the parameters that an estimate depends on."""
        centers = self.centers
        if hasattr(centers, "fit"):
            centers = clone(centers)
        elif centers is not None and not isinstance(centers, str):
            centers = np.array(centers)
        kernel = as_kernel(self.kernel, self.beta, None)
        solver = None if isinstance(self.solver, ConjugateGradient) else self.solver
        return [kernel, centers, self.method, self.alpha, self.trend, solver]

    def _add_centers(self, X: Array, y: Array) -> None:
        """Extend an interpolant by the rows that become centres."""
        assert self.center_indices_ is not None
        outputs, M = y.reshape(len(y), -1), len(self.centers_)
        points = np.vstack([self.centers_, X])
        numbers = np.append(self.center_indices_, self._n_seen + np.arange(len(X)))
        values, selector = self._values.joined(outputs), None
        if self.centers is None:
            rows, values = self._merged(points, values, numbers)
        else:
            selector, new = self._grown_selector(X)
            rows = np.append(np.arange(M), M + new)
            values = values.take(rows)
        points, nugget = points[rows], self.alpha / values.counts
        sections = KernelSections(self.kernel_, points)
        solution: Solution[Any]
        try:
            solution = self._extended(sections, nugget, values.means)
        except np.linalg.LinAlgError:
            solution = interpolated(
                sections,
                points,
                nugget,
                values.means,
                DEGREES[self.trend],
                "cholesky" if self.solver == "cholesky" else "pivoted_cholesky",
                self.n_jobs,
                self._negligible(len(X)),
            ).solution
        values = self._kept_values(values, solution, points)
        residual = None
        if self.method == "least_squares" and not nugget.any():
            residual = np.sqrt(values.scatter)
        n_seen, shape = self._n_seen + len(X), self.dual_coef_.shape[1:]
        self._store(solution, numbers[rows], nugget, shape, n_seen, residual)
        self._values = values
        if selector is not None:
            self._selector = selector

    def _extended(
        self, sections: KernelSections, nugget: Array, u: Array
    ) -> Solution[GrowingInterpolant]:
        """Return the interpolant of u with the last centres added."""
        M = len(self.centers_)
        if not np.array_equal(nugget[:M], self._nugget):
            raise np.linalg.LinAlgError("the weights of centres have changed")
        growth = getattr(self, "_basis", None)
        if not isinstance(growth, GrowingInterpolant):
            basis = self._native_basis()
            growth = GrowingInterpolant.of(basis, self.centers_, self._values.means)
        # A copy, without its arrays: nothing is to be changed if this fails.
        factor = GrowingFactor(list(growth.factor.blocks))
        growth = replace(growth, factor=factor)
        if len(u) > M:
            growth.extend(sections, sections.centers[M:], nugget[M:], u[M:])
        if not np.array_equal(u[:M], self._values.means):
            growth.v = growth.factor.forward(u)
        return growth.solution(u)

    def _grown_selector(self, X: Array) -> tuple[SeparatedCenterSelector, Indices]:
        """Return the selector after further rows, and which of them are new centres."""
        selector = getattr(self, "_selector", None)
        if selector is None:
            selector = clone(self.centers)
            if hasattr(self, "centers_"):
                selector.partial_fit(self.centers_)
        n_seen, n_known = 0, 0
        if hasattr(selector, "center_indices_"):
            n_seen, n_known = selector.n_samples_seen_, len(selector.center_indices_)
        grown = copy(selector)
        vars(grown).update(vars(selector))  # with what a copy leaves out
        selector = grown.partial_fit(X)
        return selector, selector.center_indices_[n_known:] - n_seen

    def _kept_values(
        self, values: AveragedOutputs, solution: Solution[Any], points: Array
    ) -> AveragedOutputs:
        """Return the values at the centres kept; the scatter takes in the others."""
        kept = values.take(solution.kept)
        left_out = np.setdiff1d(np.arange(len(points)), solution.kept)
        if not len(left_out):
            return kept
        basis = solution.basis
        there = evaluate(
            basis.sections, basis.tail, points[left_out], solution.dual, solution.trend
        )
        missed = values.counts[left_out] @ (values.means[left_out] - there) ** 2
        return kept._replace(scatter=kept.scatter + missed)

    def _add_rows(self, given: Any, X: Array, y: Array, started: bool) -> None:
        """Add rows to least squares at chosen centres."""
        outputs = y.reshape(len(y), -1)
        growth, selector = getattr(self, "_growth", None), None
        rows, batches = None, [(X, outputs)]
        if isinstance(self.centers, SeparatedCenterSelector):
            selector, new = self._grown_selector(X)
            # Copies: the next batch may come in the same memory.
            batches = [*getattr(self, "_batches", []), (X.copy(), outputs.copy())]
            rows, points = selector.center_indices_, selector.cluster_centers_
            if len(new):
                growth = None
        elif growth is None:
            points, _ = choose_centers(self.centers, X, y, among_rows=False)
        if growth is None:
            kernel = as_kernel(self.kernel, self.beta, X.shape[1])
            growth, solution, residual = accumulated(
                KernelSections(kernel, points),
                points,
                batches,
                self.alpha,
                DEGREES[self.trend],
                str(self.solver),
            )
        else:
            try:
                solution, residual = growth.learn(X, outputs, self.alpha)
            except np.linalg.LinAlgError as error:
                raise ValueError(
                    f"No estimate with these rows: {error}. {REMEDY}"
                ) from error
        # Attributes are set last: a batch that fails is not counted.
        if not started:
            validate_data(self, given, y, skip_check_array=True)
        if rows is not None:
            rows = rows[growth.kept]
        nugget = np.zeros(len(solution.dual))
        self._store(solution, rows, nugget, y.shape[1:], growth.n_rows, residual)
        self.solver_ = "cholesky" if self.solver == "cholesky" else "pivoted_cholesky"
        self._growth, self._interpolates = growth, False
        if selector is not None:
            self._selector, self._batches = selector, batches

    @abstractmethod
    def fit(self, X: Any, y: Any) -> Self:
        """Start anew."""

    @abstractmethod
    def _check_parameters(self) -> None:
        """Refuse parameters outside their range."""

    @abstractmethod
    def _merged(
        self, X: Array, values: AveragedOutputs, numbers: Indices
    ) -> tuple[Indices, AveragedOutputs]:
        """Average the values of equal rows."""

    @abstractmethod
    def _negligible(self, n_rows: int) -> float:
        """Return which part of a section may be left out without a warning."""

    @abstractmethod
    def _native_basis(self) -> NativeBasis:
        """Return the basis that the estimate was made in."""

    @abstractmethod
    def _store(
        self,
        solution: Solution[Any],
        rows: Indices | None,
        nugget: Array,
        shape: tuple[int, ...],
        n_rows: int,
        residual: Array | None,
    ) -> None:
        """Store an estimate."""
