"""The Koopman operator itself: its matrix, its spectrum and its forecasts."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import check_array, check_X_y
from sklearn.utils.validation import check_is_fitted, validate_data

from ._dynamics._forecast import apply_powers, relift_states, sum_modes
from ._dynamics._operator import block_diagonal, fit_operator, interpolate_operator
from ._dynamics._spectrum import decompose, pack_weights, unpack
from ._dynamics._successors import check_successors, find_successors
from ._linalg._fit import Fit, make_nugget, warn_of_weights
from ._linalg._systems import (
    METHODS,
    SOLVERS,
    DirectSystem,
    interpolate_every_row,
    restore_system,
)
from ._matrices._polynomial import DEGREES
from ._matrices._sections import KernelExpansion, KernelSections
from ._utils._frames import index_level
from ._utils._pipeline import find_operator, transformed
from ._utils._rows import distinct_rows, drop_absent, group_means, spread
from ._utils._storage import StoresCentersOnce
from ._utils._typing import Array, Complex, Indices, Mask
from ._utils._validation import (
    check_flag,
    check_integer,
    check_magnitude,
    check_number,
    check_parameters,
    check_sample_weight,
    refuse_masked,
)
from ._utils._warnings import warn
from .centers import SeparatedCenterSelector, choose_centers
from .kernels import as_kernel

__all__ = ["KernelEDMD", "forecast"]

# Modes are summed in the place of powers only if the reciprocal condition number of the
# eigenvectors is at least this, so that both agree to about 1e-9.
MIN_RCOND_OF_EIGENVECTORS = 1e-7
# A forecast this many times larger than all outputs of the training data has diverged.
DIVERGED = 1e3


class KernelEDMD(StoresCentersOnce, MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Kernel estimate of the Koopman operator, with its spectrum and its forecasts.

    States follow an unknown map, x_{k+1} = f(x_k). The Koopman operator of the map
    takes a function g of the state to

    .. math:: (U_f g)(x) = g(f(x)).

    It is linear for every f. Its powers look many steps ahead. Its eigenfunctions are
    multiplied by their eigenvalue in every step, so that they separate a motion into
    growth rates and frequencies.

    This is extended dynamic mode decomposition (EDMD, [3]_) with a dictionary of
    kernel sections: functions k(., xi_i) of a kernel k, one for each of M centres
    xi_i, and the polynomials of a `trend`. The operator is estimated on the span of
    the dictionary, as

    - the operator :math:`U_f^M g = \\Pi_M((\\Pi_M g) \\circ f)` of [1]_, by
      interpolation at the centres Xi. With K = k(Xi, Xi) and K+ = k(f(Xi), Xi), one
      step multiplies the coefficients of the sections by :math:`K^{-1} K^+`. Or as
    - EDMD proper, by least squares over all pairs of a state and its successor. With
      as many pairs as centres both are the same ([1]_, theorem on the EDMD algorithm).

    The method known as kernel EDMD ([4]_) is another one. It has a dictionary that is
    given by a kernel, but is never evaluated, and it works on the span of the snapshots
    in that feature space: its matrices are those of all pairs, its modes belong to the
    snapshots, and there are no centres to choose. Here the dictionary is the sections
    themselves, at few centres.

    Outputs y = G(x) are predicted one step ahead by the interpolant, or the fit, of the
    pairs of a state and the output one step later. This is :math:`\\Pi_M (U_f G)`, the
    estimate of :class:`KoopmanKernelRegressor`. It is more accurate than :math:`U_f^M
    G`, which approximates G first. The powers of the operator take it further.

    Parameters
    ----------
    kernel : str or Kernel, default="matern32"
        As for :class:`KoopmanKernelRegressor`.
    beta : float, "scale" or None, default="scale"
        Scale of the kernel in the unit of the states. A kernel object keeps its own
        scale unless a number is given. For a name, "scale" means the spread of the
        states that have a successor: the square root of the sum of the variances of
        the columns of `X`. Forecasts of outputs are then the same in every unit of the
        states. Wendland kernels, which are zero beyond `beta`, need some 10 times as
        much. None means 1 for a name.
    centers : None, array-like of shape (n_centers, n_features) or estimator, \
default=None
        Where the kernel sections are centred, among the rows that have a successor: at
        every distinct one, at given states, or at those that a clone of a selector such
        as :class:`SeparatedCenterSelector` chooses among them.
    method : {"interpolation", "least_squares"}, default="interpolation"
        Whether the operator is made from the successors of the centres, which have to
        be rows of `X`, or from those of all rows. Take least squares for noisy states.
    alpha : float, default=0.0
        Weight of the squared native norm against the squared residuals, as for
        :class:`KoopmanKernelRegressor`.
    trend : {None, "constant", "linear"}, default=None
        Polynomials that join the sections. With "linear" the constant and the state
        itself are in the dictionary, so that a linear map is found exactly (from more
        centres than features).
    n_modes : int, default=None
        How many eigenfunctions make up the model.

        - None: all. The whole operator is kept as a matrix.
        - a number: the most trustworthy ones, which are the first in the order of
          `eigenvalues_`. One more is kept where a conjugate pair would be divided.
          Predictions and forecasts are those of the reduced model, which is small.
        - 0: the whole operator without its spectrum, which takes most of the time of a
          fit with many centres. For forecasts, and for searches by
          `make_forecast_scorer`.
    solver : {"auto", "pivoted_cholesky", "cholesky"}, default="auto"
        What happens where the Gram matrix, a dense one, is not numerically positive
        definite. "auto" and "pivoted_cholesky": centres that are numerically dependent
        on others are dropped, with a warning; `rank_` is the number of the others.
        "cholesky": an error.
    n_jobs : int, default=None
        Number of threads for predictions. None means 1 unless in a
        :obj:`joblib.parallel_config` context, -1 means all processors.

    Attributes
    ----------
    koopman_matrix_ : ndarray of shape (rank_, rank_)
        The operator in coordinates of the functions :math:`L^{-1} k(\\Xi, x)` with the
        Cholesky factor of the Gram matrix, :math:`K = L L^T` (with `alpha` on its
        diagonal for interpolation, and where every row is a centre). They are
        orthonormal in the native space if alpha is 0. Without a trend, interpolation
        gives :math:`L^T (K^{-1} K^+) L^{-T}`, which is similar to the matrix that acts
        on coefficients, but as well conditioned as the operator is. With `n_modes`, the
        block-diagonal matrix that acts on the real and imaginary parts of the
        eigenfunctions kept.
    eigenvalues_ : ndarray of shape (n_modes,), complex
        In the order of rising ``residuals_ / abs(eigenvalues_)``, the most trustworthy
        first; conjugate pairs side by side, the one with positive imaginary part first.
    residuals_ : ndarray of shape (n_modes,)
        How far each eigenpair is from one of the true operator, in mean square over the
        data [2]_, without a unit: the root of

        .. math:: \\frac{\\sum_i |\\phi(f(x_i)) - \\lambda \\phi(x_i)|^2}
            {\\sum_i |\\phi(x_i)|^2}

        For least squares at chosen centres the sums run over all pairs; take many
        times as many pairs as centres. For interpolation the sums run over the rows
        that are not centres, because the residual is zero at the centres. If there are
        fewer such distinct pairs than centres, it is replaced by a leave-one-out
        estimate: the error of :math:`\\phi` at each left-out centre times
        :math:`\\sqrt{1 + |\\lambda|^2}`. Eigenvalues whose residual is not small are
        spurious. (For random f the residual of a true one is not small, either: it is
        the root of ``1 - abs(lambda) ** 2`` in a stationary process.)
    modes_ : ndarray of shape (n_modes,) or (n_modes, n_outputs), complex
        Koopman modes, in the unit of the outputs: the expansion of the outputs G in
        eigenfunctions, so that ``(eigenfunctions(X) * eigenvalues_ ** s) @ modes_`` is
        the forecast for s >= 1 steps, if the operator has a full set of eigenfunctions.
        Modes are zero where the eigenvalue is zero up to rounding; what such
        eigenfunctions contribute to the first step is missing then.
    rank_ : int
        The number of functions that the operator acts on: the centres that are not
        numerically dependent on others.
    rcond_ : float
        Estimate of the reciprocal condition number of the Gram matrix.
    signal_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs one step ahead, in their unit, if the kernel
        is the covariance of a Gaussian process; as for
        :class:`KoopmanKernelRegressor`.
    noise_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs about their estimate one step ahead, in their
        unit, from the rows that have a successor.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres, in the unit of the states.
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres; None for centres given from elsewhere.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, if `X` has string names.

    See Also
    --------
    KoopmanKernelRegressor : One step ahead only, without the operator.
    forecast : Forecasts through a pipeline.
    make_forecast_scorer : Scores forecasts in cross-validation.

    Notes
    -----
    The interpolant of G itself at the successors f(Xi) has the coefficients
    :math:`k(f(\\Xi), f(\\Xi))^{-1} u` for the outputs u of the centres ([1]_, theorem
    on the pullback space); ``KoopmanKernelRegressor().fit(X_next, y)`` computes it. If
    it is the inner projection of :math:`U_f^M G`, with the values u at the successors,
    the outer projection has the coefficients :math:`K^{-1} u`: those of the prediction
    here.

    Equal states with different successors belong to a random map, whose operator takes
    the mean over its outcomes. Least squares does so, as does interpolation at a centre
    that equals several rows.

    A pair with the `sample_weight` w counts as w equal pairs: its squared residuals are
    multiplied by w, in `residuals_`, too. At centres, `alpha` over w is on the diagonal
    of the Gram matrix of an interpolant.

    With M centres and n pairs, a fit takes O(M^3) time, of which the eigenvalues take
    most (about 25 M^3), O(n M^2) more for least squares, and the memory of some M x M
    matrices. A forecast of s steps takes O(M^2) a step, and O(n M) for every output. A
    pickle holds the operator and its eigenfunctions, two M x M matrices; the Cholesky
    factor is computed anew when it is first needed after loading.

    A pipeline passes on no method `forecast`. With a scaler in front, call the function
    :func:`forecast`, which scales the states first: ``forecast(pipeline, X, n_steps)``.

    With metadata routing enabled, `X_next` and `sample_index` are passed on by
    pipelines and searches without a call of `set_fit_request`, which `sample_weight`
    needs. A scaler in front transforms `X_next` only if asked to: ``Pipeline(steps,
    transform_input=["X_next"])``. `sample_index` needs no such care. Data frames of
    :func:`trajectory_pairs` need neither parameter, nor metadata routing, if `y` is one
    of them, or if no scaler turns `X` into an array. Elsewhere pass `sample_index`: see
    `fit`.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.
    .. [2] M. J. Colbrook and A. Townsend, "Rigorous data-driven computation of
       spectral properties of Koopman operators for dynamical systems",
       Communications on Pure and Applied Mathematics 77, 2024.
    .. [3] M. O. Williams, I. G. Kevrekidis and C. W. Rowley, "A data-driven
       approximation of the Koopman operator: extending dynamic mode decomposition",
       Journal of Nonlinear Science 25, 2015.
    .. [4] M. O. Williams, C. W. Rowley and I. G. Kevrekidis, "A kernel-based method for
       data-driven Koopman spectral analysis", Journal of Computational Dynamics 2,
       2015.

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

    Through the scaler of a pipeline:

    >>> from sklearn.pipeline import make_pipeline
    >>> from sklearn.preprocessing import StandardScaler
    >>> from sklearn_koopman import forecast
    >>> pipeline = make_pipeline(StandardScaler(), model)
    >>> pipeline = pipeline.fit(pendulum.X, pendulum.y)
    >>> forecast(pipeline, pendulum.X[:2], n_steps=100).shape
    (2, 100)
    """

    # Requested by default under metadata routing, without set_fit_request.
    __metadata_request__fit = {"X_next": True, "sample_index": True}

    def __init__(
        self,
        kernel: Any = "matern32",
        *,
        beta: float | str | None = "scale",
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
        sample_weight: Any = None,
    ) -> Self:
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
            The place of each row on the clock of its trajectory, an integer: row j
            succeeds row i if ``sample_index[j] == sample_index[i] + 1``. With both, as
            when a scorer needs the second one, `X_next` is used, and must agree. With
            neither, see the Notes.
        sample_weight : array-like of shape (n_samples,), default=None
            How much the pair of each row and its successor counts, as if it occurred
            so many times: numbers of at least 0. A row of weight 0 is absent. It is no
            successor of another row either, but its place in the order remains empty.
            None means 1 for every row.

        Returns
        -------
        self : KernelEDMD
            The fitted operator.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if weights are negative, or all of
            them zero; if `X_next` and `sample_index` contradict each other; if the rows
            contradict their order, where only that tells which rows follow each other;
            if the index of a data frame repeats, has no label for some row, or is
            irregular; if no row has a successor; if a centre is no row with a successor
            where interpolation needs it; if no solution is found, as with
            ``solver="cholesky"`` and a Gram matrix that is not positive definite; if
            least squares has a linear trend that rows determine, but the centres do
            not.

        Warns
        -----
        UserWarning
            If the scale of `X_next` plainly differs from that of `X`, as it does when a
            scaler transforms `X` only; if the rows are one trajectory in their order,
            and hold angles that wrap.
        LinAlgWarning
            If dependent centres were dropped, and that may matter.

        Notes
        -----
        Which rows follow each other is told by the first of these:

        1. `X_next`.
        2. `sample_index`.
        3. The level "sample_index" of the index of `X`, else of `y`, as in the data
           frames of :func:`trajectory_pairs`. Behind a step that drops the index of
           `X`, that of `y` serves.
        4. Any other index of `X`, else of `y`: its labels are a clock. Rows follow each
           other if their labels are one usual step apart, so that holes are no steps.
           The usual step of whole numbers is the smallest.
        5. The order of the rows, which are one trajectory then.

        The last two know nothing of steps of several rows, nor the last one of several
        trajectories and of blocks that were left out. So columns of `y`, and delayed
        copies in the states, are compared with the states of up to 128 rows later. Any
        scale and offset may lie between them, as behind a scaler. An error is raised if
        they contradict the order. Other rows are trusted: a lag shows only if `y` has
        columns of the states, and several trajectories only in these or in delayed
        copies. So pass `sample_index` wherever there is no index, in particular behind
        a scaler, which drops that of `X`.
        """
        refuse_masked(X=X, y=y, X_next=X_next, sample_index=sample_index)
        given, given_y = X, y
        X, y = self._check_data(X, y)
        self._check_parameters()
        if X_next is not None:
            X_next = check_successors(given, X_next)
        if X_next is None and sample_index is None:
            sample_index = index_level("sample_index", given, given_y)
        consecutive = X_next is None and sample_index is None
        row_weights = check_sample_weight(sample_weight, len(X))
        data = given, given_y
        here, X_next = find_successors(X, X_next, sample_index, data, row_weights)
        outputs = X_next if y is None else y.reshape(len(y), -1)
        if y is not None:
            check_magnitude(outputs, smallest=0.0, name="y")
        n_outputs = outputs.shape[1]
        targets = X_next if y is None else np.hstack([outputs[here], X_next])
        # Outputs of states without a successor: least squares has a use for them.
        n_present = len(X) if row_weights is None else np.count_nonzero(row_weights)
        takes_more = self.method == "least_squares" and y is not None
        more = takes_more and bool(len(here) < n_present)
        pair_weights = None if row_weights is None else row_weights[here]
        scale = spread(X[here], pair_weights)
        every_row = self.centers is None and not more
        try:
            found = self._estimate(
                X[here], X_next, targets, pair_weights, scale, every_row=every_row
            )
        except ValueError as error:
            if len(here) == len(X) or "row" not in str(error):
                raise
            raise ValueError(
                f"{error} (Rows are counted among the {len(here)} with a successor.)"
            ) from error
        system, matrix, coordinates = found.system, found.matrix, found.coordinates
        if more:
            row_weights, _, states, outputs = drop_absent(row_weights, X, outputs)
            coordinates[:, :n_outputs] = system.fit_coordinates(
                states, outputs, self.alpha, self.n_jobs, row_weights
            )
        pairs = X[here], X_next, found.counted
        spectrum = decompose(
            system, matrix, coordinates, *pairs, self.alpha, self.n_modes, pair_weights
        )
        lam, phi, residuals, weights, rcond_of_eigenvectors = spectrum
        is_reduced = 0 < len(lam) < len(matrix)
        if is_reduced:
            functions = phi.combine(pack_weights(weights, lam))
        else:
            functions = system.expand(coordinates)
        rcond = system.rcond()
        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, skip_check_array=True)
        self.kernel_ = system.sections.kernel
        assert isinstance(system.sections, KernelSections)
        self.centers_ = system.sections.centers
        self.center_indices_ = None if found.rows is None else here[found.rows]
        self.rcond_ = rcond
        self.rank_ = len(matrix)
        self._consecutive = consecutive
        self._spread = scale
        self._output_shape = (X if y is None else y).shape[1:]
        degrees = max(len(system.kept) - system.trend_rank, 1)
        signal_std = found.fit.seminorm / np.sqrt(degrees)
        noise_std = found.fit.noise_std
        if noise_std is None:
            noise_std = signal_std * np.sqrt(self.alpha)
        shape = self._output_shape
        self.signal_std_ = signal_std[:n_outputs].reshape(shape)[()]
        self.noise_std_ = noise_std[:n_outputs].reshape(shape)[()]
        self._nugget = system.nugget
        self._system = system
        largest = np.abs(outputs if more else targets[:, :n_outputs]).max(axis=0)
        self._limit = DIVERGED * np.maximum(largest, 1e-6 * largest.max())
        self.koopman_matrix_ = block_diagonal(lam) if is_reduced else matrix
        self._start = None if is_reduced else coordinates[:, :n_outputs]
        self.residuals_, self._rcond_of_eigenvectors = residuals, rcond_of_eigenvectors
        self._dual_coef, self._trend_coef = functions.dual_coef, functions.trend_coef
        self._phi_dual_coef, self._phi_trend_coef = phi.dual_coef, phi.trend_coef
        self.eigenvalues_, self._weights = lam, weights[:, :n_outputs]
        # The weights expand the outputs one step on: eigenvalue times mode.
        size = np.abs(lam)
        zero = size <= len(matrix) * np.finfo(float).eps * size.max(initial=0.0)
        modes = self._weights / np.where(zero, np.inf, lam)[:, np.newaxis]
        self.modes_ = modes.reshape(len(lam), *shape)
        return self

    def predict(self, X: Any, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Predict the outputs one step after each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        return_std : bool, default=False
            Whether to return the standard deviation as well.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The estimate of G(f(x)): of the next states, if `fit` was given no `y`.
        y_std : ndarray of the shape of `y`
            Standard deviation of the outputs, as
            :meth:`KoopmanKernelRegressor.predict` defines it; only if `return_std`. It
            belongs to the whole model, also with `n_modes`.

        Raises
        ------
        ValueError
            With `return_std`, if a loaded Gram matrix cannot be factored on this
            machine.

        Warns
        -----
        ExtrapolationWarning
            If a state is far from all training data, as in
            :meth:`KoopmanKernelRegressor.predict`.

        Notes
        -----
        O(n M) time for n states and M centres, and O(n M^2) more with `return_std`.
        """
        X = self._validated(X)
        y = self._predict(X).reshape(len(X), *self._output_shape)
        if not return_std:
            return y
        P = self.power_function(X).reshape((-1,) + (1,) * len(self._output_shape))
        return y, np.hypot(self.signal_std_ * P, self.noise_std_)

    def power_function(self, X: Any) -> Array:
        """Evaluate the power function, which bounds the error of interpolation.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        power : ndarray of shape (n_samples,)
            As :meth:`KoopmanKernelRegressor.power_function` gives it, in the unit of
            the square root of the kernel.
        """
        return self._fitted_system().power(self._validated(X), self.n_jobs)

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
            - True: by relifting. The learned map of states takes each state to the
              next one, and the outputs follow from that, so that every step starts
              from a state again. The forecast stays near the states of the training
              data, but may settle on another orbit.

        Returns
        -------
        y : ndarray of shape (n_samples, n_steps) or (n_samples, n_steps, n_outputs)
            ``y[:, s]`` estimates the outputs s + 1 steps later; ``y[:, 0]`` is
            ``predict(X)``. NaN from the step on at which a diverging forecast, or the
            states on its way, become too large for numbers.

        Warns
        -----
        ExtrapolationWarning
            If a state to start from is far from all training data, for example because
            it has not passed the scaler in front of the model.
        RuntimeWarning
            If a forecast diverges: becomes a thousand times larger than all outputs
            of the training data.
        """
        check_is_fitted(self)
        check_integer(n_steps, "n_steps", 1)
        check_flag(relift, "relift")
        X = self._validated(X)
        n_outputs = len(self._limit)
        y = np.full((len(X), n_steps, n_outputs), np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            if relift:
                targets = self._expansion(self._dual_coef, self._trend_coef)
                relift_states(X, y, targets, self.n_jobs)
            else:
                y[:, 0] = self._predict(X)
            if relift or n_steps == 1:
                pass
            elif self._start is None or self._modes_are_cheaper(len(X), n_steps):
                phi = self._expansion(self._phi_dual_coef, self._phi_trend_coef)
                sum_modes(X, y, phi, self.eigenvalues_, self._weights, self.n_jobs)
            else:
                operator, expand = self.koopman_matrix_, self._fitted_system().expand
                apply_powers(X, y, operator, self._start, expand, self.n_jobs)
            y[~np.isfinite(y)] = np.nan
            # A start far outside is no divergence, if the forecast comes back.
            limit = np.where(self._limit > 0, self._limit, np.inf)
            fine = np.abs(y) <= np.maximum(limit, np.abs(y[:, :1]))
        diverged = ~fine.all(axis=2)
        if diverged.any():
            warn(
                f"{diverged.any(axis=1).sum()} of {len(X)} forecasts diverge, the "
                f"first at step {diverged.any(axis=0).argmax() + 1}: they exceed the "
                f"training data {DIVERGED:g} times. Set relift={not relift}, or fit "
                "with method='least_squares', alpha > 0 or fewer n_modes.",
                RuntimeWarning,
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

        Warns
        -----
        ExtrapolationWarning
            If a state is far from all training data.
        """
        X = self._validated(X)
        self._check_has_spectrum()
        phi = self._expansion(self._phi_dual_coef, self._phi_trend_coef)
        return unpack(phi.predict(X, self.n_jobs), self.eigenvalues_)

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
        """Leave out the matrices of the system, which follow from the rest."""
        state = dict(super().__getstate__())
        state.pop("_system", None)
        return state

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = False
        return tags

    def _check_data(self, X: Any, y: Any) -> tuple[Array, Array | None]:
        if y is None:
            return check_array(X, dtype=np.float64, estimator=self), None
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        return X, np.asarray(y, dtype=np.float64)

    def _check_parameters(self) -> None:
        if isinstance(self.centers, str):
            raise ValueError(
                f"centers must be None, an array or a selector, got {self.centers!r}; "
                "the operator needs the states themselves, not distances."
            )
        choices = {"method": METHODS, "trend": DEGREES, "solver": SOLVERS}
        check_parameters(self, non_negative=("alpha",), **choices)
        if self.n_modes is not None:
            check_integer(self.n_modes, "n_modes", 0)

    def _estimate(
        self,
        X: Array,
        X_next: Array,
        targets: Array,
        weights: Array | None,
        scale: float,
        *,
        every_row: bool,
    ) -> _Operator:
        """Estimate the operator, and the targets one step ahead, from pairs."""
        kernel = as_kernel(self.kernel, self.beta, X.shape[1], scale)
        degree = DEGREES[self.trend]
        # The operator is a dense matrix, and needs a dense factor.
        solver = "pivoted_cholesky" if self.solver == "auto" else self.solver
        interpolates = every_row or self.method == "interpolation"
        if not interpolates:
            centers = (
                SeparatedCenterSelector(0) if self.centers is None else self.centers
            )
            points, rows = choose_centers(
                centers, X, targets, weights, among_rows=False
            )
            extent = np.stack([X.min(axis=0), X.max(axis=0)])
            nugget = np.zeros(len(points))
            sections = KernelSections(kernel, points)
            system = DirectSystem(sections, nugget, degree, solver, extent)
            matrix, coordinates, fit = fit_operator(
                system, X, X_next, targets, self.alpha, self.n_jobs, weights
            )
            warn_of_weights(weights, fit.effective_dof)
            if rows is not None:
                rows = rows[system.kept]
            # With every state a centre, a fit has no other rows than an interpolant.
            counted = np.full(len(X), self.centers is not None)
            return _Operator(system, fit, matrix, coordinates, rows, counted)
        rows, group, _ = distinct_rows(X)
        means = np.hstack([X_next, targets])
        # Where equal states have different successors, the map is random, and its
        # operator takes the mean.
        if len(rows) < len(X):
            means = group_means(means, group, weights)[group]
        mean_next, mean_targets = np.split(means, [X_next.shape[1]], axis=1)
        if not every_row:
            _, chosen = choose_centers(
                self.centers, X, targets, weights, among_rows=True
            )
            assert chosen is not None  # since they are among the rows
            rows = chosen
        sections = KernelSections(kernel, X[rows])
        at_rows = np.bincount(group, weights)[group[rows]].astype(np.float64)
        nugget = make_nugget(self.alpha, at_rows, sections.diagonal(sections.points))
        system = DirectSystem(sections, nugget, degree, solver)
        if self.method == "interpolation":
            fit = system.interpolate(mean_targets[rows])
        else:
            data = mean_targets[rows], X, targets
            fit = interpolate_every_row(system, *data, self.alpha, self.n_jobs, weights)
        rows = rows[system.kept]
        matrix, coordinates = interpolate_operator(
            system, X_next, targets, rows, group, weights
        )
        # At a centre there is no residual, unless equal states have different
        # successors.
        random = np.abs(X_next - mean_next).max(axis=1) > 1e-9 * np.abs(X_next).max()
        counted = np.isin(group, group[random]) | ~np.isin(group, group[rows])
        return _Operator(system, fit, matrix, coordinates, rows, counted)

    def _modes_are_cheaper(self, n_samples: int, n_steps: int) -> bool:
        """Tell whether summing modes is cheaper than powers, and accurate.

        Modes are evaluated for every row, and then weighted for every output. Powers
        cost D^2 an output, half as much to expand it, and D for every row.
        """
        if len(self.eigenvalues_) == 0:
            return False
        D, columns = len(self.koopman_matrix_), n_steps * len(self._limit)
        accurate = self._rcond_of_eigenvectors >= MIN_RCOND_OF_EIGENVECTORS
        by_modes = n_samples * (D + columns)
        return accurate and by_modes < (D + D / 2 + n_samples) * columns

    def _check_has_spectrum(self) -> None:
        if len(self.eigenvalues_) == 0:
            raise ValueError(
                "n_modes=0 has left the spectrum out; fit with n_modes=None, or with "
                "as many as you need."
            )

    def _validated(self, X: Any) -> Array:
        check_is_fitted(self)
        refuse_masked(X=X)
        return validate_data(self, X, reset=False, dtype=np.float64)

    def _predict(self, X: Array) -> Array:
        outputs = slice(len(self._limit))
        functions = self._expansion(self._dual_coef, self._trend_coef)
        return functions.take(outputs).predict(X, self.n_jobs)

    def _expansion(self, dual_coef: Array, trend_coef: Array) -> KernelExpansion:
        origin = np.zeros(0)
        if len(trend_coef) > 1:
            origin = self.centers_.mean(axis=0)
        sections = KernelSections(self.kernel_, self.centers_)
        return KernelExpansion(sections, dual_coef, origin, trend_coef)

    def _fitted_system(self) -> DirectSystem:
        if not hasattr(self, "_system"):
            degree = None
            if len(self._trend_coef):
                degree = min(len(self._trend_coef) - 1, 1)
            sections = KernelSections(self.kernel_, self.centers_)
            self._system = restore_system(sections, self._nugget, degree)
        return self._system


def forecast(model: Any, X: Any, n_steps: int, *, relift: bool = False) -> Array:
    """Forecast outputs by an operator, or by a pipeline that ends in one.

    The earlier steps of a pipeline, such as a scaler, transform the states first.

    Parameters
    ----------
    model : KernelEDMD, Pipeline or search
        A fitted :class:`KernelEDMD`, a pipeline that ends in one, or a search of
        either.
    X : array-like of shape (n_samples, n_features)
        The states to start from, in the units that `model` was fitted to.
    n_steps : int
        How many steps to forecast.
    relift : bool, default=False
        How the forecast goes beyond the first step, by powers of the operator or by
        relifting: see :meth:`KernelEDMD.forecast`.

    Returns
    -------
    y : ndarray of shape (n_samples, n_steps) or (n_samples, n_steps, n_outputs)
        ``y[:, s]`` estimates the outputs s + 1 steps later, in the unit of the outputs
        that `model` was fitted to. If it was fitted to none, they are the states as
        the last step of the pipeline receives them.

    Raises
    ------
    NotFittedError
        If `model` is not fitted.
    TypeError
        If `model` does not end in an operator.

    Warns
    -----
    RuntimeWarning
        If a forecast diverges.

    See Also
    --------
    KernelEDMD.forecast : The forecast of the operator itself, and its cost.
    make_forecast_scorer : Scores forecasts in cross-validation.

    Examples
    --------
    >>> from sklearn.pipeline import make_pipeline
    >>> from sklearn.preprocessing import StandardScaler
    >>> from sklearn_koopman import KernelEDMD, forecast
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> pendulum = make_pendulum(200, step=0.1)
    >>> model = make_pipeline(StandardScaler(), KernelEDMD(trend="linear", n_modes=0))
    >>> model = model.fit(pendulum.X[:150], pendulum.y[:150])
    >>> y = forecast(model, pendulum.X[150:151], n_steps=30)[0]
    >>> bool(abs(y - pendulum.y[150:180]).max() < 0.01)
    True
    """
    operator, front = find_operator(model)
    refuse_masked(X=X)  # the steps in front do not see masks
    y: Array = operator.forecast(transformed(front, X), n_steps, relift=relift)
    return y


class _Operator(NamedTuple):
    """An operator on the span of kernel sections, and how it was found."""

    system: DirectSystem
    fit: Fit  # of the targets
    matrix: Array  # (M, M)
    coordinates: Array  # (M, n_targets)
    rows: Indices | None  # which rows the centres are
    counted: Mask  # (n_pairs,): pairs that show how good eigenfunctions are
