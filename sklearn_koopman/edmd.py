"""The Koopman operator itself: its matrix, its spectrum and its forecasts."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import check_array, check_X_y, gen_batches
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman._dynamics import _operator, _successors
from sklearn_koopman._linalg import _direct
from sklearn_koopman._utils._rows import distinct_rows, group_means
from sklearn_koopman._utils._typing import Array, Complex
from sklearn_koopman._utils._validation import (
    check_flag,
    check_integer,
    check_magnitude,
    check_number,
)
from sklearn_koopman.centers import SeparatedCenterSelector
from sklearn_koopman.regression import KoopmanKernelRegressor

__all__ = ["KernelEDMD"]


# Modes are summed in the place of powers only if the reciprocal condition number of the
# eigenvectors is at least this, so that both agree to about 1e-9.
WELL_CONDITIONED = 1e-7
# What happens where the Gram matrix is not positive definite.
SOLVERS = ("auto", "pivoted_cholesky", "cholesky")
# A forecast this many times larger than all outputs of the training data has diverged.
DIVERGED = 1e3


class KernelEDMD(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Kernel estimate of the Koopman operator, with its spectrum and its forecasts.

    States follow an unknown map, x_{k+1} = f(x_k). The Koopman operator of the map
    takes a function g of the state to

    .. math:: (U_f g)(x) = g(f(x)).

    It is linear whatever f is, its powers look many steps ahead, and its eigenfunctions
    evolve by a factor a step, so that they separate a motion into growth rates and
    frequencies. This estimates it on the span of the sections k(., xi_i) of a kernel at
    M centres xi_i (and the polynomials of a `trend`), as

    - the operator :math:`U_f^M g = \\Pi_M((\\Pi_M g) \\circ f)` of [1]_ by
      interpolation at the centres: with K = k(Xi, Xi) and K+ = k(f(Xi), Xi), one step
      multiplies the coefficients of the sections by :math:`K^{-1} K^+`; or as
    - extended dynamic mode decomposition (EDMD) with these functions as dictionary, by
      least squares over all pairs of a state and its successor. With as many pairs as
      centres both are the same, which is [1]_'s theorem on the EDMD algorithm.

    Outputs y = G(x) are predicted from the interpolant, or the fit, of the pairs of a
    state and the output one step later. This is :math:`\\Pi_M (U_f G)`, the estimate of
    :class:`KoopmanKernelRegressor`, and more accurate than :math:`U_f^M G`, which
    approximates G first. The powers of the operator take it further.

    Parameters
    ----------
    kernel : str or Kernel, default="matern32"
        As for :class:`KoopmanKernelRegressor`.
    beta : float, default=None
        Scale of the kernel in the unit of the states. None leaves that of the kernel
        object, and means 1 for a name.
    centers : None, array-like of shape (n_centers, n_features) or estimator, \
default=None
        Where the kernel sections are centred, among the rows that have a successor: at
        every distinct one, at given states, or at those that a clone of a selector such
        as :class:`SeparatedCenterSelector` chooses of them.
    method : {"interpolation", "least_squares"}, default="interpolation"
        Whether the operator is made from the successors of the centres, which have to
        be rows of `X`, or from those of all rows. Take least squares for noisy states.
    alpha : float, default=0.0
        Weight of the squared native-space norm against the squared residuals.
    trend : {None, "constant", "linear"}, default=None
        Polynomials that join the sections. With "linear" the constant and the state
        itself are in the dictionary, so that a linear map is found exactly (by
        interpolation, from more centres than features).
    n_modes : int, default=None
        How many eigenfunctions make up the model.

        - None: all. The whole operator is kept, and pickled, as a matrix.
        - a number: the most trustworthy ones (in the order of `eigenvalues_`), and one
          more where that would tear a conjugate pair. Predictions and forecasts are
          those of the reduced model, which is small.
        - 0: the whole operator without its spectrum, which takes most of the time of a
          fit with many centres; for forecasts, and for searches by
          `make_forecast_scorer`.
    solver : {"auto", "pivoted_cholesky", "cholesky"}, default="auto"
        What happens where the Gram matrix, a dense one, is not numerically positive
        definite. "auto" and "pivoted_cholesky": a pivoted Cholesky factorisation leaves
        out the centres that depend on others, with a warning; `rank_` tells what is
        left. "cholesky": an error.
    n_jobs : int, default=None
        Number of threads for predictions. None means 1 unless in a
        :obj:`joblib.parallel_backend` context, -1 means all processors.

    Attributes
    ----------
    koopman_matrix_ : ndarray of shape (rank_, rank_)
        The operator in coordinates: those of the functions :math:`L^{-1} k(\\Xi, x)`
        with the Cholesky factor of the Gram matrix, :math:`K = L L^T` (with `alpha` on
        its diagonal for interpolation, and where every row is a centre), which are
        orthonormal in the native space if alpha is 0. Without a trend it is :math:`L^T
        (K^{-1} K^+) L^{-T}` for interpolation, similar to the matrix that acts on
        coefficients but as well conditioned as the operator is. With `n_modes`, the
        block-diagonal matrix that acts on the real and imaginary parts of the
        eigenfunctions kept.
    eigenvalues_ : ndarray of shape (n_modes,), complex
        In the order of rising ``residuals_ / abs(eigenvalues_)``, the most trustworthy
        first; conjugate pairs side by side, the one with positive imaginary part first.
    residuals_ : ndarray of shape (n_modes,)
        How far each eigenpair is from one of the true operator, in mean square over the
        data [2]_: the root of

        .. math:: \\frac{\\sum_i |\\phi(f(x_i)) - \\lambda \\phi(x_i)|^2}
            {\\sum_i |\\phi(x_i)|^2}

        For least squares at chosen centres the sums are over all pairs; take many
        times as many as centres. An interpolant has no such error at its centres: there
        they are over the other rows. Where these are fewer than the centres, as when
        every row is one, the residual is estimated instead: as the error of
        :math:`\\phi` at centres that are left out, one at a time (in closed form),
        times :math:`\\sqrt{1 + |\\lambda|^2}`, for both terms. Eigenvalues whose
        residual is not small are spurious. (For random f the residual of a true one is
        not small, either: it is the root of ``1 - abs(lambda) ** 2`` in a stationary
        process.)
    modes_ : ndarray of shape (n_modes,) or (n_modes, n_outputs), complex
        Koopman modes: the expansion of the outputs G in eigenfunctions, so that
        ``(eigenfunctions(X) * eigenvalues_ ** s) @ modes_`` is the forecast for s >= 1
        steps, if the operator has a full set of eigenfunctions. Modes are zero where
        the eigenvalue is zero up to rounding; what such eigenfunctions contribute to
        the first step is missing then.
    rank_ : int
        The number of functions that the operator acts on: the centres that are not
        numerically dependent on others and, for least squares, the polynomials that
        they do not determine.
    rcond_ : float
        Estimate of the reciprocal condition number of the Gram matrix.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres.
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres; None for centres given from elsewhere.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    regressor_ : KoopmanKernelRegressor
        The estimate one step ahead of the outputs, if any were given, and behind them
        of the states: for its power function and standard deviation. It is made from
        the rows that have a successor, and whole: where least squares has more rows for
        `y`, or with `n_modes`, its predictions are others than those of this estimator.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, where `X` had string names.

    See Also
    --------
    KoopmanKernelRegressor : One step ahead only, without the operator.
    make_forecast_scorer : Scores forecasts in cross-validation.

    Notes
    -----
    The interpolant of G itself at the successors f(Xi) has the coefficients
    :math:`k(f(\\Xi), f(\\Xi))^{-1} u` for the outputs u of the centres ([1]_, theorem
    on the pullback space); ``KoopmanKernelRegressor().fit(X_next, y)`` gives it. If it
    is the inner projection of :math:`U_f^M G`, with the values u at the successors, the
    outer one has the coefficients :math:`K^{-1} u`: those of the prediction here.

    Equal states with different successors belong to a random map, whose operator takes
    the mean over its outcomes. Least squares does so, as does interpolation where every
    row is a centre; with a selector, or given centres, it takes the first of equal
    rows.

    A pipeline passes on no method `forecast`: with a scaler in front, call
    ``pipeline[-1].forecast(pipeline[:-1].transform(X), n_steps)``.

    With metadata routing enabled, `X_next` and `sample_index` are passed on by
    pipelines and searches without a call of `set_fit_request`. A scaler in front
    transforms `X_next` only if told to: ``Pipeline(steps,
    transform_input=["X_next"])``; `sample_index` needs no such care.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".
    .. [2] M. J. Colbrook and A. Townsend, "Rigorous data-driven computation of
       spectral properties of Koopman operators for dynamical systems",
       Communications on Pure and Applied Mathematics 77, 2024.
    .. [3] M. O. Williams, I. G. Kevrekidis and C. W. Rowley, "A data-driven
       approximation of the Koopman operator: extending dynamic mode decomposition",
       Journal of Nonlinear Science 25, 2015.

    Examples
    --------
    A pendulum swings with one frequency and its harmonics:

    >>> from sklearn_koopman import KernelEDMD, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> pendulum = make_pendulum(n_samples=256, step=0.1)
    >>> model = KernelEDMD(
    ...     kernel="wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ... ).fit(pendulum.X, X_next=pendulum.X_next)
    >>> growth_rates, frequencies = model.continuous_eigenvalues(dt=0.1)
    >>> frequencies[:5].round(4)
    array([ 0.    ,  0.1198, -0.1198,  0.2396, -0.2396])
    >>> bool(model.residuals_[:5].max() < 1e-3)
    True
    >>> model.forecast(pendulum.X[:2], n_steps=100).shape
    (2, 100, 2)
    """

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
            The outputs one step after each row. By default the successor states (but
            `score` needs them). Least squares uses them all, those of rows without a
            successor, too; interpolation those of the centres.
        X_next : array-like of shape (n_samples, n_features), default=None
            The state one step after each row, on the scale of `X`.
        sample_index : array-like of shape (n_samples,), default=None
            Integers that tell the rows' successors, if these are among the rows: row
            j succeeds row i if ``sample_index[j] == sample_index[i] + 1``. With
            neither `X_next` nor `sample_index`, the rows are one trajectory in the
            order of time (so that cross-validation which leaves out a block of one
            trajectory needs either: the rows before and after it do not follow each
            other). With both, when a scorer needs the second one, `X_next` is used,
            and has to agree.

        Returns
        -------
        self : KernelEDMD
            The fitted operator.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if `X_next` and `sample_index`
            contradict each other; if no row has a successor; if a centre is no row
            with a successor where interpolation needs it; if ``solver="cholesky"``
            meets a Gram matrix that is not positive definite.

        Warns
        -----
        UserWarning
            If `X_next` plainly lives on another scale than `X`: if the successors of
            rows in the order of time are later rows that have been scaled or shifted,
            or if all features differ by a factor of 30.
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
        if not isinstance(self.solver, str) or self.solver not in SOLVERS:
            raise ValueError(
                f"solver must be one of {', '.join(map(repr, SOLVERS))}, got "
                f"{self.solver!r}."
            )
        if self.n_modes is not None:
            check_integer(self.n_modes, "n_modes", 0)
        consecutive = X_next is None and sample_index is None
        if X_next is not None:
            X_next = _successors.check_successors(given, X_next)
        here, X_next = _successors.find_successors(X, X_next, sample_index)
        outputs = X_next if y is None else y.reshape(len(y), -1)
        check_magnitude(outputs, smallest=0.0, name="y")
        targets = X_next if y is None else np.hstack([outputs[here], X_next])
        # Outputs of states without a successor: least squares has a use for them.
        more = y is not None and self.method == "least_squares" and len(here) < len(X)
        try:
            regressor, matrix, coordinates, counted = self._estimate(
                X[here], X_next, targets, every_row=self.centers is None and not more
            )
        except ValueError as error:
            if len(here) == len(X) or "row" not in str(error):
                raise
            raise ValueError(
                f"{error} (Rows are counted among the {len(here)} with a successor.)"
            ) from error
        if more:
            coordinates[:, : outputs.shape[1]] = _operator.regressed(
                regressor._native_basis(),
                X,
                outputs.__getitem__,
                outputs.shape[1],
                self.alpha,
            )
        analysis = None
        if self.n_modes != 0:
            analysis = _operator.analyse(
                regressor._native_basis(),
                matrix,
                coordinates,
                X[here],
                X_next,
                counted,
                self.alpha,
                self.n_modes,
            )

        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, skip_check_array=True)
        self.regressor_ = regressor
        self.kernel_ = regressor.kernel_
        self.centers_ = regressor.centers_
        self.center_indices_ = regressor.center_indices_
        if self.center_indices_ is not None:
            self.center_indices_ = here[self.center_indices_]
        self.rcond_ = regressor.rcond_
        self.rank_ = len(matrix)
        self._consecutive = consecutive
        self._output_shape = (X if y is None else y).shape[1:]
        largest = np.abs(outputs if more else targets[:, : outputs.shape[1]]).max(
            axis=0
        )
        self._limit = DIVERGED * np.maximum(largest, 1e-6 * largest.max())
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
            ``predict(X)``. NaN from where a diverging forecast cannot be followed any
            further: its numbers, or the states that it leads to, are too large.

        Warns
        -----
        RuntimeWarning
            If a forecast diverges: becomes a thousand times larger than all outputs
            of the training data.
        """
        check_is_fitted(self)
        check_integer(n_steps, "n_steps", 1)
        check_flag(relift, "relift")
        X = validate_data(self, X, reset=False, dtype=np.float64)
        y = np.full((len(X), n_steps, len(self._limit)), np.nan)
        y[:, 0] = self._predict(X)
        with np.errstate(over="ignore", invalid="ignore"):
            if n_steps == 1:
                pass
            elif relift:
                self._relift(X, y)
            elif self._by_eigenvalues(len(X), n_steps):
                self._sum_modes(X, y)
            else:
                self._apply_powers(X, y)
            y[~np.isfinite(y)] = np.nan
            # A start far outside is no divergence, if the forecast comes back.
            limit = np.where(self._limit > 0, self._limit, np.inf)
            fine = np.abs(y) <= np.maximum(limit, np.abs(y[:, :1]))
        diverged = ~fine.all(axis=2)
        if diverged.any():
            warnings.warn(
                f"{diverged.any(axis=1).sum()} of {len(X)} forecasts diverge, the "
                f"first at step {diverged.any(axis=0).argmax() + 1}: they exceed the "
                f"training data {DIVERGED:g} times. Forecast fewer steps, set "
                f"relift={not relift}, or fit with method='least_squares', alpha > 0 "
                "or fewer n_modes.",
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
            training rows that have a successor, and real and positive at the first of
            them, where they do not vanish there.

        Raises
        ------
        ValueError
            If the model was fitted with ``n_modes=0``.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        found = self._eigenbasis()
        values = self._evaluate(X, found.dual, found.trend)
        return _operator.unpack(values, found.eigenvalues)

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

        Raises
        ------
        ValueError
            If `dt` is not positive, or the model was fitted with ``n_modes=0``.
        """
        check_is_fitted(self)
        check_number(dt, "dt", positive=True)
        self._check_has_spectrum()
        with np.errstate(divide="ignore"):
            growth_rates = np.log(np.abs(self.eigenvalues_)) / dt
        return growth_rates, np.angle(self.eigenvalues_) / (2 * np.pi * dt)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the eigenfunctions where they follow from the whole operator."""
        state = dict(super().__getstate__())
        if state.get("_start") is not None:
            state.pop("_eigenfunctions", None)
            state.pop("_weights", None)
        elif "_start" in state:
            state.pop("koopman_matrix_")
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the matrix of a reduced model, which its eigenvalues tell."""
        super().__setstate__(state)
        if state.get("_start", 0) is None:
            self.koopman_matrix_ = _operator.block_diagonal(state["eigenvalues_"])

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = False
        return tags

    def _estimate(
        self, X: Array, X_next: Array, targets: Array, *, every_row: bool
    ) -> tuple[KoopmanKernelRegressor, Array, Array, NDArray[np.bool_]]:
        """Estimate the operator and the targets one step ahead from pairs.

        Returns
        -------
        regressor : KoopmanKernelRegressor
            The estimate of the targets, whose basis the following refers to.
        matrix : ndarray of shape (dimension, dimension)
            The operator.
        coordinates : ndarray of shape (dimension, n_targets)
            Those of the targets.
        counted : ndarray of shape (n_pairs,), bool
            The pairs that tell how good eigenfunctions are.
        """
        centers = self.centers
        if centers is None and not every_row:
            centers = SeparatedCenterSelector(0.0)
        regressor = KoopmanKernelRegressor(
            self.kernel,
            beta=self.beta,
            centers=centers,
            method=self.method,
            alpha=self.alpha,
            trend=self.trend,
            # The operator is a dense matrix, and needs a dense factor.
            solver="pivoted_cholesky" if self.solver == "auto" else self.solver,
            n_jobs=self.n_jobs,
        )
        interpolates = every_row or self.method == "interpolation"
        if interpolates:
            _, group, _ = distinct_rows(X)
            mean = group_means(np.hstack([X_next, targets]), group)[group]
            mean_next, mean_targets = np.split(mean, [X_next.shape[1]], axis=1)
            if every_row:
                # Where equal states have different successors, the map is random, and
                # its operator takes the mean.
                targets = mean_targets
        regressor.fit(X, targets)
        basis = regressor._native_basis()
        if not interpolates:
            matrix, coordinates = _operator.regressed_operator(
                basis, X, X_next, targets, self.alpha
            )
            # With every state a centre, a fit tells no more than an interpolant.
            counted = np.full(len(X), self.centers is not None)
            return regressor, matrix, coordinates, counted
        rows = np.asarray(regressor.center_indices_)
        lots = group if every_row else np.arange(len(X))
        matrix, coordinates = _operator.interpolated_operator(
            basis, X_next, targets, rows, lots
        )
        # At a centre nothing is left to see, but where equal states have different
        # successors.
        random = np.abs(X_next - mean_next).max(axis=1) > 1e-9 * np.abs(X_next).max()
        counted = np.isin(group, group[random]) | ~np.isin(group, group[rows])
        return regressor, matrix, coordinates, counted

    def _store(
        self,
        matrix: Array,
        coordinates: Array,
        analysis: _operator.Analysis | None,
    ) -> None:
        """Store the operator, or what `n_modes` leaves of it."""
        for stale in ("_eigenfunctions", "_weights", "_factors", "_rcond_eigenvectors"):
            self.__dict__.pop(stale, None)
        n_outputs = len(self._limit)
        self.koopman_matrix_ = matrix
        self._start: Array | None = coordinates
        self._dual, self._trend = self.regressor_._native_basis().expand(coordinates)
        if analysis is None:
            self.eigenvalues_ = np.empty(0, dtype=np.complex128)
            self.residuals_ = np.empty(0)
            self.modes_ = np.empty((0, *self._output_shape), dtype=np.complex128)
            return
        found = analysis.eigenfunctions
        lam = found.eigenvalues
        if len(lam) < len(matrix):
            packed = _operator.pack_weights(analysis.weights, lam)
            self.koopman_matrix_ = _operator.block_diagonal(lam)
            self._start = None
            self._dual, self._trend = found.dual @ packed, found.trend @ packed
        self._eigenfunctions = found
        self._weights = analysis.weights[:, :n_outputs]
        self._factors = analysis.factors
        self._rcond_eigenvectors = analysis.rcond
        self.eigenvalues_ = lam
        self.residuals_ = analysis.residuals
        # The weights expand the outputs one step on, those of eigenvalue times mode.
        zero = np.abs(lam) <= len(matrix) * np.finfo(float).eps * np.abs(lam).max()
        modes = self._weights / np.where(zero, np.inf, lam)[:, np.newaxis]
        self.modes_ = modes.reshape(len(lam), *self._output_shape)

    def _eigenbasis(self) -> _operator.Eigenfunctions:
        """Return the eigenfunctions, found anew if they were not pickled."""
        self._check_has_spectrum()
        if not hasattr(self, "_eigenfunctions"):
            assert self._start is not None
            basis = self.regressor_._native_basis()
            eigenvalues, vectors = _operator.spectrum(self.koopman_matrix_)
            order = _operator.match(self.eigenvalues_, eigenvalues)
            found = _operator.Eigenfunctions(eigenvalues, *basis.expand(vectors))
            # Another machine may find other vectors for a multiple eigenvalue, so that
            # weights have to be found along with them.
            weights, _ = _operator.expansion(vectors, eigenvalues, self._start)
            weights = weights[:, : len(self._limit)][order]
            self._weights = weights / self._factors[:, np.newaxis]
            self._eigenfunctions = found.take(order).scale(self._factors)
        return self._eigenfunctions

    def _check_has_spectrum(self) -> None:
        if len(self.eigenvalues_) == 0:
            raise ValueError(
                "n_modes=0 has left the spectrum out; fit with n_modes=None, or with "
                "as many as you need."
            )

    def _by_eigenvalues(self, n_samples: int, n_steps: int) -> bool:
        """Tell whether to sum modes: if that is all there is, or cheap and accurate."""
        if self._start is None:
            return True
        if len(self.eigenvalues_) == 0 or self._rcond_eigenvectors < WELL_CONDITIONED:
            return False
        D, columns = len(self.koopman_matrix_), n_steps * len(self._limit)
        by_eigenvalues = n_samples * (D + columns)
        if not hasattr(self, "_eigenfunctions"):  # after loading
            by_eigenvalues += 25 * D**2
        return by_eigenvalues < (D + D / 2 + n_samples) * columns

    def _sum_modes(self, X: Array, y: Array) -> None:
        found = self._eigenbasis()
        lam = found.eigenvalues
        for rows in gen_batches(len(X), max(_operator.BLOCK // len(lam), 1)):
            phi = self._evaluate(X[rows], found.dual, found.trend)
            for steps in self._later_steps(y[rows]):
                powers = lam[:, np.newaxis] ** np.arange(steps.start, steps.stop)
                weights = powers[:, :, np.newaxis] * self._weights[:, np.newaxis]
                packed = _operator.pack_weights(weights.reshape(len(lam), -1), lam)
                y[rows, steps] = (phi @ packed).reshape(len(phi), -1, y.shape[2])

    def _apply_powers(self, X: Array, y: Array) -> None:
        assert self._start is not None
        basis = self.regressor_._native_basis()
        start = self._start[:, : y.shape[2]]
        images = _operator.powers(self.koopman_matrix_, start)
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
            if len(alive) == 0:
                return
            values = self._evaluate(X, self._dual, self._trend)
            y[alive, step] = values[:, : y.shape[2]]
            X = values[:, -n_features:]

    def _later_steps(self, y: Array) -> Iterator[slice]:
        """Divide the steps after the first so that a block stays in memory."""
        n_rows = max(len(y), len(self._dual))
        size = max(_operator.BLOCK // (n_rows * y.shape[2]), 1)
        for start in range(1, y.shape[1], size):
            yield slice(start, min(start + size, y.shape[1]))

    def _predict(self, X: Array) -> Array:
        return self._evaluate(X, self._dual, self._trend)[:, : len(self._limit)]

    def _evaluate(self, X: Array, dual: Array, trend: Array) -> Array:
        regressor = self.regressor_
        return _direct.evaluate(
            regressor._sections, regressor._tail, X, dual, trend, self.n_jobs
        )
