"""The Koopman operator itself: its matrix, its spectrum and its forecasts."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import check_array, check_consistent_length, check_X_y, gen_batches
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman import _operators, _solvers
from sklearn_koopman._validation import check_integer, check_number
from sklearn_koopman.centers import distinct_rows
from sklearn_koopman.regression import KoopmanKernelRegressor
from sklearn_koopman.trajectories import successor_rows

__all__ = ["KernelEDMD"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# Modes are summed in the place of powers only if the reciprocal condition number of the
# eigenvectors is at least this, so that both agree to about 1e-9.
WELL_CONDITIONED = 1e-7
# A forecast this many times larger than all outputs of the training data has diverged.
DIVERGED = 1e3


class KernelEDMD(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """TODO"""

    # Rows of metadata that mean one thing only: asked for without set_fit_request.
    __metadata_request__fit = {"X_next": True, "sample_index": True}

    def __init__(
        self,
        kernel: Any = "matern32",
        *,
        beta: float | None = None,
        centers: Any = None,
        method: str = "interpolation",
        alpha: float = 0.0,
        trend: str | None = None,
        n_modes: int | None = None,
        solver: str = "auto",
        n_jobs: int | None = None,
    ) -> None:
        self.kernel = kernel
        self.beta = beta
        self.centers = centers
        self.method = method
        self.alpha = alpha
        self.trend = trend
        self.n_modes = n_modes
        self.solver = solver
        self.n_jobs = n_jobs

    def fit(
        self,
        X: Any,
        y: Any = None,
        *,
        X_next: Any = None,
        sample_index: Any = None,
    ) -> KernelEDMD:
        """Choose the centres, estimate the operator and analyse its spectrum.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
            The outputs one step after each row. By default the successor states.
        X_next : array-like of shape (n_samples, n_features), default=None
            The state one step after each row, on the scale of `X`.
        sample_index : array-like of shape (n_samples,), default=None
            Integers that tell the rows' successors, if these are among the rows: row
            j succeeds row i if ``sample_index[j] == sample_index[i] + 1``. With
            neither `X_next` nor `sample_index`, the rows are one trajectory in the
            order of time.

        Returns
        -------
        self : KernelEDMD
            The fitted operator.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if both `X_next` and `sample_index`
            are given; if no row has a successor; if a centre is no row with a
            successor where interpolation needs it; if equal rows have different
            outputs or successors and ``alpha=0``; if ``solver="cholesky"`` meets a
            Gram matrix that is not positive definite.

        Warns
        -----
        UserWarning
            If `X_next` plainly lives on another scale than `X`.
        LinAlgWarning
            If dependent centres were left out, and that may matter.
        """
        given = X
        if y is None:
            X = check_array(X, dtype=np.float64, estimator=self)
        else:
            X, y = check_X_y(
                X,
                y,
                multi_output=True,
                y_numeric=True,
                dtype=np.float64,
                estimator=self,
            )
            y = np.asarray(y, dtype=np.float64)
        if isinstance(self.centers, str):
            raise ValueError(
                f"centers must be None, an array or a selector, got {self.centers!r}; "
                "the operator needs the states themselves, not distances."
            )
        if self.n_modes is not None:
            check_integer(self.n_modes, "n_modes", 0)
        here, X_next = _pairs(X, X_next, sample_index)
        linked = X[here]
        outputs = X_next if y is None else y.reshape(len(y), -1)
        targets = X_next if y is None else np.hstack([outputs[here], X_next])
        # Outputs of states without a successor: least squares has a use for them.
        more = y is not None and self.method == "least_squares" and len(here) < len(X)

        centers = self.centers
        if more and centers is None:
            centers = linked[distinct_rows(linked)[0]]
        regressor = KoopmanKernelRegressor(
            self.kernel,
            beta=self.beta,
            centers=centers,
            method=self.method,
            alpha=self.alpha,
            trend=self.trend,
            solver=self.solver,
            n_jobs=self.n_jobs,
        )
        try:
            regressor.fit(linked, targets)
        except ValueError as error:
            if len(here) == len(X):
                raise
            raise ValueError(
                f"{error} (Rows are counted among the {len(here)} with a successor.)"
            ) from error

        basis = regressor._native_basis()
        if self.method == "interpolation" or centers is None:
            rows = regressor.center_indices_
            _, group, sizes = distinct_rows(linked)
            # The rows apart from the centres tell how good eigenfunctions are.
            counted = ~np.isin(group, group[rows])
            if centers is None:  # the mean of equal rows counts
                lots = np.split(np.argsort(group, kind="stable"), np.cumsum(sizes)[:-1])
                sources = [lots[i] for i in group[rows]]
            else:
                sources = list(rows[:, np.newaxis])
            matrix, coordinates = _operators.interpolated_operator(
                basis, X_next, targets, sources
            )
        else:
            counted = np.ones(len(linked), dtype=bool)
            matrix, coordinates = _operators.regressed_operator(
                basis, linked, X_next, targets, self.alpha
            )
        if more:
            coordinates[:, : outputs.shape[1]] = _operators.regressed(
                basis, X, outputs.__getitem__, outputs.shape[1], self.alpha
            )
        analysis = None
        if self.n_modes != 0:
            analysis = _operators.analyse(
                basis, matrix, coordinates, linked, X_next, counted, self.n_modes
            )

        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, skip_check_array=True)
        self.regressor_ = regressor
        self.kernel_ = regressor.kernel_
        self.centers_ = regressor.centers_
        rows = regressor.center_indices_
        self.center_indices_ = None if rows is None else here[rows]
        self.rcond_ = regressor.rcond_
        self.rank_ = len(matrix)
        self._output_shape = (X if y is None else y).shape[1:]
        self._limit = DIVERGED * np.abs(outputs).max(axis=0)
        self._store(matrix, coordinates, analysis)
        return self

    def predict(self, X: Any) -> Array:
        """Predict the outputs one step after each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The estimate of G(f(x)): of the next states, if `fit` was given no `y`.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        return self._predict(X).reshape(len(X), *self._output_shape)

    def forecast(self, X: Any, n_steps: int, *, relift: bool = False) -> Array:
        """Forecast the outputs one to `n_steps` steps after each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states to start from.
        n_steps : int
            How many steps to forecast.
        relift : bool, default=False
            How the forecast goes beyond the first step.

            - False: by powers of the operator, which takes O(M^2) a step whatever
              the number of rows, or by its eigenvalues where that is cheaper (few
              rows, many steps) and the eigenvectors are well conditioned.
            - True: by the learned map of states, from each state to the next one
              and then to the output. This bends the forecast back to the states of
              the training data at every step, but may settle on another orbit.

        Returns
        -------
        y : ndarray of shape (n_samples, n_steps) or (n_samples, n_steps, n_outputs)
            ``y[:, s]`` estimates the outputs s + 1 steps later; ``y[:, 0]`` is
            ``predict(X)``. NaN where a forecast has left the range of numbers.

        Warns
        -----
        RuntimeWarning
            If a forecast diverges: becomes a thousand times larger than all outputs
            of the training data.
        """
        check_is_fitted(self)
        check_integer(n_steps, "n_steps", 1)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        y = np.full((len(X), n_steps, len(self._limit)), np.nan)
        y[:, 0] = self._predict(X)
        with np.errstate(over="ignore", invalid="ignore"):
            if relift:
                self._relift(X, y)
            elif self._by_eigenvalues(len(X), n_steps):
                self._sum_modes(X, y)
            else:
                self._apply_powers(X, y)
            fine = np.abs(y) <= np.where(self._limit > 0, self._limit, np.inf)
        diverged = ~fine.all(axis=2)
        if diverged.any():
            warnings.warn(
                f"{diverged.any(axis=1).sum()} of {len(X)} forecasts diverge, the first "
                f"after {diverged.any(axis=0).argmax() + 1} steps: they exceed the "
                f"training data {DIVERGED:g} times. Forecast fewer steps, set "
                "relift=True, or fit with method='least_squares', alpha > 0 or fewer "
                "n_modes.",
                RuntimeWarning,
                stacklevel=2,
            )
        return y.reshape(len(X), n_steps, *self._output_shape)

    def eigenfunctions(self, X: Any) -> Complex:
        """Evaluate the eigenfunctions of the operator.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        phi : ndarray of shape (n_samples, n_modes), complex
            Eigenfunctions in the order of `eigenvalues_`, of mean square one over the
            training data, and real and positive at its first row.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        found = self._found()
        values = self._evaluate(X, found.dual, found.trend)
        return _operators.unpack(values, found.eigenvalues)

    def continuous_eigenvalues(self, dt: float) -> tuple[Array, Array]:
        """Turn the eigenvalues into growth rates and frequencies.

        An eigenfunction with the eigenvalue :math:`\\lambda` evolves like
        :math:`\\lambda^{t / \\Delta t} = e^{(r + 2 \\pi i \\nu) t}`.

        Parameters
        ----------
        dt : float
            Time from a row to its successor, in seconds.

        Returns
        -------
        growth_rates : ndarray of shape (n_modes,)
            ``log(abs(eigenvalues_)) / dt`` in 1/s, negative for decay.
        frequencies : ndarray of shape (n_modes,)
            ``angle(eigenvalues_) / (2 pi dt)`` in Hz, at most half the sampling rate.
        """
        check_is_fitted(self)
        check_number(dt, "dt", positive=True)
        with np.errstate(divide="ignore"):
            growth_rates = np.log(np.abs(self.eigenvalues_)) / dt
        return growth_rates, np.angle(self.eigenvalues_) / (2 * np.pi * dt)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the eigenfunctions where they follow from the whole operator."""
        state = dict(super().__getstate__())
        if state.get("_start") is not None:
            state.pop("_eigenfunctions", None)
        return state

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = False
        return tags

    def _store(
        self,
        matrix: Array,
        coordinates: Array,
        analysis: _operators.Analysis | None,
    ) -> None:
        """Store the operator, or what `n_modes` leaves of it."""
        n_outputs = len(self._limit)
        self.koopman_matrix_ = matrix
        self._start: Array | None = coordinates[:, :n_outputs]
        self._dual, self._trend = self.regressor_._native_basis().expand(coordinates)
        if analysis is None:
            self._eigenfunctions = None
            self.eigenvalues_ = np.empty(0, dtype=np.complex128)
            self.residuals_ = np.empty(0)
            self.modes_ = np.empty((0, *self._output_shape), dtype=np.complex128)
            return
        found = analysis.eigenfunctions
        lam = found.eigenvalues
        if len(lam) < len(matrix):
            packed = _operators.pack_weights(analysis.weights, lam)
            self.koopman_matrix_ = _operators.block_diagonal(lam)
            self._start = None
            self._dual, self._trend = found.dual @ packed, found.trend @ packed
        self._eigenfunctions = found
        self._factors = analysis.factors
        self._rcond_eigenvectors = analysis.rcond
        self.eigenvalues_ = lam
        self.residuals_ = analysis.residuals
        # The expansion of the outputs one step on has lambda times their modes.
        weights = analysis.weights[:, :n_outputs]
        modes = np.zeros_like(weights)
        np.divide(weights, lam[:, np.newaxis], out=modes, where=lam[:, np.newaxis] != 0)
        self.modes_ = modes.reshape(len(lam), *self._output_shape)

    def _found(self) -> _operators.Eigenfunctions:
        """Return the eigenfunctions, found anew if they were not pickled."""
        if not hasattr(self, "_eigenfunctions"):
            basis = self.regressor_._native_basis()
            eigenvalues, vectors = _operators.spectrum(self.koopman_matrix_)
            order = _operators.match(self.eigenvalues_, eigenvalues)
            self._eigenfunctions = (
                _operators.Eigenfunctions(eigenvalues, *basis.expand(vectors))
                .take(order)
                .scale(self._factors)
            )
        return self._eigenfunctions

    def _by_eigenvalues(self, n_samples: int, n_steps: int) -> bool:
        """Tell whether to sum modes: if that is all there is, or cheap and accurate."""
        if self._start is None:
            return True
        if self.n_modes == 0 or self._rcond_eigenvectors < WELL_CONDITIONED:
            return False
        D, columns = len(self.koopman_matrix_), n_steps * len(self._limit)
        powers = (D + D / 2 + n_samples) * columns
        return n_samples * (D + columns) < powers

    def _sum_modes(self, X: Array, y: Array) -> None:
        found = self._found()
        lam, modes = found.eigenvalues, self.modes_.reshape(len(self.modes_), -1)
        for rows in gen_batches(len(X), max(_operators.BLOCK // len(lam), 1)):
            phi = self._evaluate(X[rows], found.dual, found.trend)
            for steps in self._later_steps(y[rows]):
                power = lam[:, np.newaxis] ** np.arange(steps.start + 1, steps.stop + 1)
                weights = power[:, :, np.newaxis] * modes[:, np.newaxis]
                packed = _operators.pack_weights(weights.reshape(len(lam), -1), lam)
                y[rows, steps] = (phi @ packed).reshape(len(phi), -1, y.shape[2])

    def _apply_powers(self, X: Array, y: Array) -> None:
        basis = self.regressor_._native_basis()
        images = _operators.powers(self.koopman_matrix_, self._start)
        for steps in self._later_steps(y):
            coordinates = list(islice(images, steps.stop - steps.start))
            if not coordinates:
                return
            values = self._evaluate(X, *basis.expand(np.hstack(coordinates)))
            reached = slice(steps.start, steps.start + len(coordinates))
            y[:, reached] = values.reshape(len(X), -1, y.shape[2])

    def _relift(self, X: Array, y: Array) -> None:
        n_features = X.shape[1]
        alive = np.arange(len(X))
        for step in range(y.shape[1]):
            if step:
                small = np.abs(X).max(axis=1) < 1e75  # squares are numbers
                alive, X = alive[small], X[small]
            values = self._evaluate(X, self._dual, self._trend)
            y[alive, step] = values[:, : y.shape[2]]
            X = values[:, -n_features:]

    def _later_steps(self, y: Array) -> Iterator[slice]:
        """Divide the steps after the first so that a block stays in memory."""
        n_rows = max(len(y), len(self._dual))
        size = max(_operators.BLOCK // (n_rows * y.shape[2]), 1)
        for steps in gen_batches(y.shape[1] - 1, size):
            yield slice(steps.start + 1, steps.stop + 1)

    def _predict(self, X: Array) -> Array:
        return self._evaluate(X, self._dual, self._trend)[:, : len(self._limit)]

    def _evaluate(self, X: Array, dual: Array, trend: Array) -> Array:
        regressor = self.regressor_
        return _solvers.evaluate(
            regressor._sections, regressor._tail, X, dual, trend, self.n_jobs
        )


def _pairs(X: Array, X_next: Any, sample_index: Any) -> tuple[Indices, Array]:
    """Return the rows that have a successor, and these."""
    if X_next is not None:
        if sample_index is not None:
            raise ValueError(
                "X_next and sample_index both tell the successors; pass one of them."
            )
        X_next = check_array(X_next, dtype=np.float64, input_name="X_next")
        if X_next.shape != X.shape:
            raise ValueError(
                f"X_next has shape {X_next.shape}, but X has {X.shape}; pass the "
                "successor of every row, or sample_index where some have none."
            )
        if _on_another_scale(X, X_next):
            warnings.warn(
                "X_next seems to live on another scale than X, as it does when a "
                "scaler in front transforms X only; then the eigenvalues are wrong. "
                "Enable metadata routing and use Pipeline(..., "
                "transform_input=['X_next']), or pass sample_index instead.",
                UserWarning,
                stacklevel=3,
            )
        return np.arange(len(X)), X_next
    if sample_index is None:
        if len(X) < 2:
            raise ValueError(
                "n_samples=1: one row has no successor; pass a trajectory of at least "
                "two rows, or X_next."
            )
        return np.arange(len(X) - 1), X[1:]
    check_consistent_length(X, sample_index)
    rows, successors = successor_rows(sample_index)
    if len(rows) == 0:
        raise ValueError(
            f"sample_index links none of the n_samples={len(X)} rows: no index is one "
            "higher than another. Pass consecutive integers along each trajectory."
        )
    return rows, X[successors]


def _on_another_scale(X: Array, X_next: Array) -> bool:
    """Tell whether successors plainly are in other units than the states.

    Along a trajectory the successor of a row is the next row. If instead it is an
    affine function of the next row, feature by feature, most of the time and up to
    rounding, then one of them has been scaled. Where rows do not follow each other, only
    a gross difference tells: most successors far outside the range of the states, or
    all of their features a hundred times less spread.
    """
    low, high = X.min(axis=0), X.max(axis=0)
    center, reach = (low + high) / 2, (high - low) / 2
    varies = reach > 1e-9 * np.abs(center)
    if not varies.any():
        return False
    apart = np.abs(X_next - center) > 5 * reach
    spread = np.ptp(X_next, axis=0)
    if (apart & varies).any(axis=1).mean() > 0.5:
        return True
    if len(X) > 9 and (100 * spread < 2 * reach)[varies].all() and spread.any():
        return True
    following, successors = X[1:, varies], X_next[:-1, varies]
    if len(following) < 4:
        return False
    steps, next_steps = np.diff(following, axis=0), np.diff(successors, axis=0)
    moved = np.abs(steps) > 1e-3 * reach[varies]
    for j in range(steps.shape[1]):
        if moved[:, j].sum() < 3:
            continue
        ratios = next_steps[moved[:, j], j] / steps[moved[:, j], j]
        slope = np.median(ratios)
        affine = np.abs(ratios - slope) <= 1e-6 * np.abs(slope)
        shift = np.median(successors[:, j] - following[:, j])
        other = abs(slope - 1) > 1e-3 or abs(shift) > 1e-3 * reach[varies][j]
        if other and affine.mean() > 0.5:
            return True
    return False
