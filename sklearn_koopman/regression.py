"""Kernel estimate of the Koopman operator acting on the outputs."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import check_X_y
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted, validate_data

from ._linalg._fit import make_nugget, warn_of_weights
from ._linalg._systems import (
    METHODS,
    SOLVERS,
    DirectSystem,
    System,
    interpolate_every_row,
    make_system,
    restore_system,
)
from ._matrices._polynomial import DEGREES
from ._matrices._sections import (
    KernelExpansion,
    KernelSections,
    PrecomputedSections,
    Sections,
)
from ._regression._centers import resolve_centers
from ._regression._error_bound import (
    check_norms,
    error_bound,
    left_out_reach,
    native_norm,
)
from ._regression._estimate import Estimate, keep_averages
from ._regression._partial_fit import (
    Batch,
    add_centers,
    add_rows,
    check_batch,
    check_can_grow,
    start_by_fit,
    start_least_squares,
)
from ._utils._rows import AveragedOutputs, drop_absent, spread, total_weight
from ._utils._storage import StoresCentersOnce
from ._utils._typing import Array, Indices
from ._utils._validation import (
    MAX_MAGNITUDE,
    MIN_MAGNITUDE,
    check_distances,
    check_magnitude,
    check_parameters,
    refuse_masked,
)
from .kernels import as_kernel
from .solvers import ConjugateGradient, check_solver

__all__ = ["KoopmanKernelRegressor"]


class KoopmanKernelRegressor(
    StoresCentersOnce, MultiOutputMixin, RegressorMixin, BaseEstimator
):
    """Kernel estimate of the Koopman operator acting on measured outputs.

    States follow an unknown map, x_{k+1} = f(x_k), on an unknown manifold. Outputs
    y = G(x) of the states are measured. From rows x_k and the outputs G(f(x_k)) one
    step later, this estimates the function

    .. math:: (U_f G)(x) = G(f(x))

    where U_f is the Koopman operator of f. The estimate is a sum of kernel sections:
    functions k(., xi_i) of a kernel k, one for each of M centres xi_i ([1]_). The
    kernel is one on the whole space of states, so that the manifold need not be known.

    Four terms recur. The Gram matrix holds the values of the kernel between centres.
    The native space of the kernel is its reproducing kernel Hilbert space, with the
    native norm. The power function at a state is the distance, in this norm, of the
    section there from the span of the sections of the centres: it is zero at the
    centres and grows away from them. The trend is a polynomial beside the sections.

    Parameters
    ----------
    kernel : str or Kernel, default="matern32"
        A name: "matern12", "matern32", "matern52", "wendland_c0", "wendland_c2",
        "wendland_c4", "wendland_c6", "gaussian" or "inverse_multiquadric". Or a
        kernel object of :mod:`sklearn_koopman.kernels` or
        :mod:`sklearn.gaussian_process.kernels`, whose parameters can be tuned as
        ``kernel__beta`` and the like.
    beta : float, "scale" or None, default="scale"
        Scale of the kernel in the unit of the states: k(x, c) = phi(||x - c|| / beta).
        A kernel object keeps its own scale unless a number is given. For a name,
        "scale" means the spread of the states: the square root of the sum of the
        variances of the columns of `X`, which is their root mean square distance from
        their mean. Predictions are then the same in every unit of the states. Wendland
        kernels, which are zero beyond `beta`, need some 10 times as much. None means 1
        for a name. With ``centers="precomputed"`` a name needs a number.
    centers : None, array-like of shape (n_centers, n_features), estimator or \
"precomputed", default=None
        Where the kernel sections are centred.

        - None: at every distinct row of `X`.
        - array: at these states.
        - estimator: at the `cluster_centers_` of a clone that is fitted to `X`, such
          as :class:`SeparatedCenterSelector`. Its parameters can be tuned as
          ``centers__separation`` and the like.
        - "precomputed": `X` holds the distances of each state to every centre, as
          ``SeparatedCenterSelector.transform`` returns them. The number of features
          does not follow from distances: for more than three features, set the
          `dimension` of a Wendland kernel.
    method : {"interpolation", "least_squares"}, default="interpolation"
        Which outputs the estimate is made from.

        - "interpolation": those of the centres, which have to be rows of `X` ([1]_).
          Of equal rows, the mean output counts. Exact for outputs without noise.
        - "least_squares": those of all rows. Averages over noise, and over what the
          states do not determine.

        If every row is a centre, both are the same.
    alpha : float, default=0.0
        Weight of the squared native norm of the estimate against the squared
        residuals. 0 means no penalty.
    trend : {None, "constant", "linear"}, default=None
        A polynomial that is solved for together with the kernel sections. Far from
        the centres, predictions are close to it. Take "linear" for outputs that change
        little in one step and are part of the state.
    solver : {"auto", "pivoted_cholesky", "cholesky"} or ConjugateGradient, \
default="auto"
        How the system of equations with the Gram matrix K = k(Xi, Xi) of the centres
        Xi is solved.

        - "pivoted_cholesky": by a dense Cholesky factor. If the matrix is not
          numerically positive definite, centres that are numerically dependent on
          others are dropped by a pivoted Cholesky factorisation, with a warning unless
          `alpha` is so large that they do not matter to least squares.
        - "cholesky": by a dense Cholesky factor, with an error instead of dropping
          centres.
        - :class:`~sklearn_koopman.solvers.ConjugateGradient`: iteratively, without a
          dense matrix, for many centres.
        - "auto": `ConjugateGradient()` if a dense matrix would take more than half of
          the memory of the machine, or if there are more than 5,000 centres and less
          than 1 % of its entries are not zero. Otherwise "pivoted_cholesky".
    n_jobs : int, default=None
        Number of threads for predictions and for the matrix products of
        `ConjugateGradient`. None means 1 unless in a :obj:`joblib.parallel_config`
        context, -1 means all processors.

    Attributes
    ----------
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres. None for least squares at centres that are
        not chosen among the rows.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres, in the unit of the states. Not present with
        ``centers="precomputed"``.
    dual_coef_ : ndarray of shape (n_centers,) or (n_centers, n_outputs)
        Coefficients of the kernel sections, in the unit of the outputs.
    trend_coef_ : ndarray of shape (1 + n_features,) or (1 + n_features, n_outputs)
        Coefficients of the trend: of 1, then of each feature less its mean over the
        centres. With ``trend="constant"`` the first one only. Not present without a
        `trend`.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    signal_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs in the unit of the outputs, if the kernel is
        the covariance of a Gaussian process. For interpolation it is the most likely
        one, ``sqrt(u^T (K + alpha I)^-1 u / M)`` for the outputs u of M centres (with
        a trend by restricted maximum likelihood: M less the number of polynomials).
        For least squares it is the native norm of the estimate over sqrt(M), which is
        the smaller, the larger `alpha` is.
    noise_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs about the estimate, in the unit of the
        outputs. For interpolation, and if every row is a centre, ``signal_std_ *
        sqrt(alpha)``. Otherwise the root of the sum of squared residuals over the
        number of rows less the effective number of parameters; the latter is
        estimated by `ConjugateGradient`, so that `noise_std_` is good to about 1 %.
        If hardly any rows are spare, it is ``signal_std_ * sqrt(alpha)`` as well.
        Weights count as numbers of rows: it is that of a row of weight one.
    solver_ : str or ConjugateGradient
        The solver used: "pivoted_cholesky", "cholesky" or a `ConjugateGradient`.
    n_iter_ : int
        Number of iterations. Only with conjugate gradients.
    solver_residual_ : float
        Largest residual of the system of equations, relative to its right-hand side.
        It is computed anew at the end, for all outputs and, for least squares, for the
        random vectors that estimate the effective number of parameters. Only with
        conjugate gradients.
    rcond_ : float
        Estimate of the reciprocal condition number, in the 1-norm, of the matrix that
        was factored: K, with `alpha` on its diagonal for interpolation. The
        coefficients lose about ``-log10(rcond_)`` of 16 digits, the predictions fewer.
        It is computed when it is first asked for, in O(M^2); after `partial_fit` has
        added centres it is an upper bound. Not present with conjugate gradients.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, if `X` has string names.

    See Also
    --------
    KoopmanKernelRegressorCV : Chooses kernel, `beta` and `alpha` by cross-validation.
    KernelEDMD : Estimates the whole operator, for forecasts of many steps.
    SeparatedCenterSelector : Chooses centres along trajectories.
    sklearn_koopman.trajectories.trajectory_pairs : Makes `X` and `y` of trajectories.
    sklearn.gaussian_process.GaussianProcessRegressor : Fits the scale of the kernel
        by maximum likelihood, with every row a centre.

    Notes
    -----
    Interpolation has the coefficients c = (K + alpha I)^-1 u, with the Gram matrix K
    and the outputs u of the centres. For alpha = 0 the estimate is the projection of
    U_f G onto the span of the sections ([1]_, Section 3.4). Algorithm 1 of [1]_ prints
    the coefficients of another function: the interpolant h of the pairs (f(xi_i),
    u_i), which estimates G. The function h(f(x)) has the values u_i at the centres,
    too, so that its projection is the same estimate.

    Least squares minimises

    .. math:: \\sum_i |y_i - g(x_i)|^2 + \\alpha \\|g\\|_H^2

    over the functions g in the span of the sections, with the native norm. This
    empirical risk minimiser is what EDMD with the sections as its dictionary predicts
    ([1]_, end of Section 3.4). It is solved in a basis that is orthonormal in the
    native space.

    With a trend p(x)^T b, the coefficients of the sections satisfy P^T c = 0 for the
    values P of the polynomials at the centres ([2]_, Chapter 8). Equal rows count as
    one centre with their mean output, and with `alpha` over their number on the
    diagonal of K.

    A row with the `sample_weight` w counts as w equal rows. Its squared residual is
    multiplied by w; where it is a centre whose output is interpolated, `alpha` over w
    is on the diagonal of K. So only the ratio of weights and `alpha` matters to
    predictions, and with ``alpha=0`` weights matter to interpolation in the means over
    equal rows alone. For `noise_std_`, give weights that are no numbers of rows the
    mean 1. For errors of standard deviations s, the best weights are proportional to
    1 / s^2.

    With M centres and n rows of d features, a fit by a Cholesky factor takes O(M^3 / 3)
    time, for least squares O(n M^2) more, and the memory of one M x M matrix.
    Predictions take O(n M d), and O(n M^2) more with `return_std`. `fit` keeps the
    Cholesky factor for `power_function`, `return_std` and `partial_fit`. A pickle does
    not hold it: a loaded model computes it anew when it is first needed. With
    ``centers="precomputed"`` that is not possible, since the centres are unknown.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.
    .. [2] H. Wendland, "Scattered Data Approximation", Cambridge University Press,
       2004, Chapters 8, 11 and 13.

    Examples
    --------
    >>> from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> pendulum = make_pendulum(n_samples=256)
    >>> model = KoopmanKernelRegressor(
    ...     kernel="wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ... ).fit(pendulum.X, pendulum.y)
    >>> len(model.centers_)
    37
    >>> error = abs(model.predict(pendulum.X) - pendulum.y).max()
    >>> bool(error < 1e-3)
    True
    """

    centers_: Array
    dual_coef_: Array
    _averages: tuple[Array, Array, Array]
    _n_rows: int
    _weight: float

    def __init__(
        self,
        kernel: Any = "matern32",
        *,
        beta: float | str | None = "scale",
        centers: Any = None,
        method: str = "interpolation",
        alpha: float = 0.0,
        trend: str | None = None,
        solver: str | ConjugateGradient = "auto",
        n_jobs: int | None = None,
    ) -> None:
        self.kernel = kernel
        self.beta = beta
        self.centers = centers
        self.method = method
        self.alpha = alpha
        self.trend = trend
        self.solver = solver
        self.n_jobs = n_jobs

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> Self:
        """Choose the centres and compute the coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.
        sample_weight : array-like of shape (n_samples,), default=None
            How much each row counts, as if it occurred so many times: numbers of at
            least 0. A row of weight 0 is absent. None means 1 for every row.

        Returns
        -------
        self : KoopmanKernelRegressor
            The fitted estimate.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if weights are negative, or all of
            them zero; if a centre is no row of `X` where its output is needed; if equal
            rows have different outputs where every row is interpolated; if least
            squares with ``alpha=0`` has fewer rows than centres, or rows that do not
            determine the coefficients; if least squares has a linear trend that rows
            determine, but the centres do not; if no solution is found, as with
            ``solver="cholesky"`` and a Gram matrix that is not positive definite, or
            with conjugate gradients that diverge.

        Warns
        -----
        LinAlgWarning
            If dependent centres were dropped, and that may matter.
        ConvergenceWarning
            If conjugate gradients ended above their tolerance, by more than rounding.
        """
        given = X
        X, y = self._check_data(X, y)
        self._check_parameters()
        n_rows = len(X)
        weights, numbers, X, y = drop_absent(sample_weight, X, y)
        scale = None if self._is_precomputed else spread(X, weights)
        sections, rows, averages = self._resolve_centers(X, y, weights, numbers, scale)
        outputs, degree = y.reshape(len(y), -1), DEGREES[self.trend]
        if averages is not None:
            diagonal = sections.diagonal(sections.points)
            nugget = make_nugget(self.alpha, averages.counts, diagonal)
            system = make_system(
                sections, nugget, degree, self.solver, n_jobs=self.n_jobs
            )
            if self.method == "interpolation":
                fit = system.interpolate(averages.means)
            else:
                data = averages.means, X, outputs
                fit = interpolate_every_row(
                    system, *data, self.alpha, self.n_jobs, weights
                )
            if len(system.kept) < len(nugget):
                averages = keep_averages(averages, fit, system.kept, sections.points)
        else:
            nugget = np.zeros(sections.size)
            extent = np.stack([X.min(axis=0), X.max(axis=0)])
            system = make_system(
                sections, nugget, degree, self.solver, extent=extent, n_jobs=self.n_jobs
            )
            fit = system.least_squares(X, outputs, self.alpha, self.n_jobs, weights)
            warn_of_weights(weights, fit.effective_dof)
        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, y, skip_check_array=True)
        kept = None if rows is None else numbers[rows[system.kept]]
        estimate = Estimate(system, fit, kept, averages)
        self._store(estimate, y.shape[1:], n_rows, total_weight(X, weights))
        self._spread = scale
        return self

    @available_if(check_can_grow)
    def partial_fit(self, X: Any, y: Any, sample_weight: Any = None) -> Self:
        """Learn from a further batch of rows, as if all had been given to one `fit`.

        Interpolation adds the rows that become centres to the Cholesky factor: with
        ``centers=None`` all rows that are new, with a :class:`SeparatedCenterSelector`
        those farther than its separation from all centres so far. Least squares at
        given centres adds the rows to its normal equations, so that memory does not
        grow with their number.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.
        sample_weight : array-like of shape (n_samples,), default=None
            How much each row counts, as in `fit`.

        Returns
        -------
        self : KoopmanKernelRegressor
            The estimate from all rows so far.

        Raises
        ------
        ValueError
            As in `fit`, or for outputs of another shape than before. The estimate then
            stays as it was.
        AttributeError
            For centres and solvers that cannot grow: conjugate gradients; least
            squares with a selector (find the centres first, by
            `SeparatedCenterSelector.partial_fit`, and give them as an array); least
            squares at given centres after `fit`, or in a copy or after loading, none
            of which keeps the sums.

        Warns
        -----
        LinAlgWarning
            If dependent centres were dropped, and that may matter.
        UserWarning
            If all rows of the first batch are equal, where its spread is needed.

        Notes
        -----
        The spread of the first batch is that which ``beta="scale"`` and a selector's
        ``separation="scale"`` mean in all later ones, so it should hold the motion in
        its full extent. The parameters must be those of the first batch, but `alpha`
        and a selector may change: then all is factored anew, as it is if a row equals
        an earlier centre and `alpha` is not 0. k new centres take O(k M^2) time, and n
        rows of least squares O(n M^2).

        If new centres make the Gram matrix nearly singular, it is factored anew and
        dependent centres are dropped as in `fit`. Which ones depends on the order of
        the batches. For least squares, `noise_std_` is accurate only down to about
        1e-8 of the size of the outputs.
        """
        started = hasattr(self, "dual_coef_")
        if not started and self._interpolates_centers:
            return start_by_fit(self, X, y, sample_weight)
        given = X
        if started:
            validate_data(self, given, reset=False, skip_check_array=True)
        X, y = self._check_data(X, y)
        self._check_parameters()
        if started:
            check_batch(self, self._direct_system(), y)
        n_given = len(X)
        weights, numbers, X, y = drop_absent(sample_weight, X, y)
        before = getattr(self, "_n_rows", 0)
        batch = Batch(X, y.reshape(len(y), -1), weights, before + numbers)
        weight = getattr(self, "_weight", before) + total_weight(X, weights)
        growth = getattr(self, "_growth", None)
        if self._interpolates_centers:
            system, averages = self._direct_system(), AveragedOutputs(*self._averages)
            estimate = add_centers(system, averages, self, batch, weight)
        elif growth is not None:
            estimate = add_rows(growth, self.alpha, batch)
        else:
            scale = spread(X, weights)
            sections, _, _ = self._resolve_centers(X, y, weights, numbers, scale)
            growth, estimate = start_least_squares(sections, self, batch)
        # Attributes are set last: a batch that fails is not counted.
        if not started:
            validate_data(self, given, y, skip_check_array=True)
            self._spread = scale
        self._store(estimate, y.shape[1:], before + n_given, weight)
        if growth is not None:
            self._growth = growth
        return self

    def predict(self, X: Any, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Predict the outputs one step after each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.
        return_std : bool, default=False
            Whether to return the standard deviation as well.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The estimate of G(f(x)).
        y_std : ndarray of the shape of `y`
            Standard deviation of the outputs, ``sqrt((signal_std_ * P) ** 2 +
            noise_std_ ** 2)`` with the power function P. Only if `return_std`. The
            outputs are taken for a sample of a Gaussian process with this kernel and
            independent noise. The standard deviation is too large for outputs that are
            smoother than the kernel, and too small on trajectories unlike those of the
            training data.

        Raises
        ------
        ValueError
            If `X` has another number of columns than in `fit`, or negative distances.
            With `return_std`, if the model was fitted to distances and loaded from a
            pickle, or if a loaded Gram matrix cannot be factored on this machine.

        Warns
        -----
        ExtrapolationWarning
            If a state is so far from the training data that its section has no
            correlation of 0.1 with that of any centre. No single centre then lowers the
            squared power function by more than 1 % of its value without data.
        ConvergenceWarning
            With `return_std`, if conjugate gradients do not converge for all states.
        """
        check_is_fitted(self)
        X = self._validated(X)
        shape = (len(X), *self.dual_coef_.shape[1:])
        y = self._expansion().predict(X, self.n_jobs).reshape(shape)
        if not return_std:
            return y
        P = self._fitted_system().power(X, self.n_jobs)
        P = P.reshape((-1,) + (1,) * (self.dual_coef_.ndim - 1))
        return y, np.hypot(self.signal_std_ * P, self.noise_std_)

    def power_function(self, X: Any) -> Array:
        """Evaluate the power function, which bounds the error of interpolation.

        .. math:: P(x)^2 = k(x, x) - k(x, \\Xi)\\, K^{-1} k(\\Xi, x)

        is the squared distance of the section k(., x) from the span of the sections of
        the centres. Therefore ``|g(x) - estimate(x)| <= P(x) ||g||_H`` for every g in
        the native space H of the kernel ([2]_ of the class, Theorem 11.4). With a
        `trend` the span includes the polynomials. For interpolation, and if every row
        is a centre, K has `alpha` on its diagonal.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.

        Returns
        -------
        power : ndarray of shape (n_samples,)
            The power function, in the unit of the square root of the kernel. It is
            zero at the centres (up to the square root of the rounding error, if alpha
            is 0 and the kernel has no noise term), and at most sqrt(k(x, x)) without a
            `trend`.

        Raises
        ------
        ValueError
            If the model was fitted to distances and loaded from a pickle, or if a
            loaded Gram matrix cannot be factored on this machine.

        Warns
        -----
        ConvergenceWarning
            If conjugate gradients do not converge for all states.

        Notes
        -----
        O(n M^2) time for n states and M centres.
        """
        check_is_fitted(self)
        return self._fitted_system().power(self._validated(X), self.n_jobs)

    def error_bound(self, X: Any, norm: Any = None) -> Array:
        """Bound the error of the prediction at each state.

        .. math:: |(U_f G)(x) - \\text{estimate}(x)| \\le P(x)\\, \\|U_f G\\|_H

        with the power function P ([2]_ of the class, Theorem 11.4). It holds for
        outputs without noise and for functions in the native space H of the kernel.
        With a `trend`, the norm is that of the function less any polynomial.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.
        norm : float or array-like of shape (n_outputs,), default=None
            The native norm of U_f G. If the true norm is given, the bound is rigorous,
            up to rounding. None estimates it from the norm of the interpolant, which
            is never larger, and from how much that grew with the second half of the
            centres. The estimate is too small for functions outside the native space
            (take a rougher kernel), for functions with detail between the centres, and
            with too few centres; the bound can then be too small as well. For smooth
            outputs the bound is far too large: their error falls with a higher order
            than the power function.

        Returns
        -------
        bound : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The bound, in the unit of the outputs. It includes the rounding error of
            the squared power function, 1e-13 of the kernel. Infinite where a linear
            trend is not determined by the centres.

        Raises
        ------
        ValueError
            If the estimate is one of least squares at chosen centres, which has no
            such bound, or was solved by conjugate gradients; if `norm` is no finite
            number of at least 0 for each output; if the norm cannot be estimated,
            because the centres are unknown or too few; if the model was fitted to
            distances and loaded from a pickle.

        Warns
        -----
        UserWarning
            If a state is far from the training data: its power function exceeds the
            largest leave-one-out power function of the centres (isolated centres are
            ignored), or no centre lies within the range of the kernel.

        Notes
        -----
        Behind the other steps of a pipeline this is ``pipeline[-1].error_bound(
        pipeline[:-1].transform(X))``. The first call takes the time and the memory of
        another factorisation, later ones O(n M^2).
        """
        check_is_fitted(self)
        if not hasattr(self, "_averages"):
            raise ValueError(
                "error_bound needs an interpolant, but method='least_squares' at "
                "chosen centres averages over rows. Take predict(X, return_std=True), "
                "or method='interpolation'."
            )
        if isinstance(self.solver_, ConjugateGradient):
            raise ValueError(
                "error_bound needs a Cholesky factor, which conjugate gradients do not "
                "make; multiply power_function(X) by the native norm instead, or fit "
                "with solver='cholesky'."
            )
        X = self._validated(X)
        system = self._direct_system()
        if norm is None:
            norms = self._estimated_norms(system)
        else:
            norms = check_norms(norm, int(np.prod(self.dual_coef_.shape[1:])))
        if not hasattr(self, "_reach"):
            self._reach = left_out_reach(system)
        bound = error_bound(system, X, norms, self._reach, self.n_jobs)
        return bound.reshape((len(X), *self.dual_coef_.shape[1:]))

    @property
    def rcond_(self) -> float:
        """Reciprocal condition number of the Gram matrix; see the class.

        Returns
        -------
        rcond : float
            The estimate, computed once.
        """
        if "_rcond" not in vars(self):
            system = getattr(self, "_system", None)
            if not isinstance(system, DirectSystem):
                raise AttributeError("rcond_ needs a fit by a Cholesky factor.")
            self._rcond = system.rcond()
        return self._rcond

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the matrices, which follow from the rest."""
        if isinstance(getattr(self, "_system", None), DirectSystem):
            _ = self.rcond_  # it would take the matrices
        state = dict(super().__getstate__())
        for name in _NOT_PICKLED:
            state.pop(name, None)
        return state

    @property
    def _is_precomputed(self) -> bool:
        return isinstance(self.centers, str) and self.centers == "precomputed"

    @property
    def _interpolates_centers(self) -> bool:
        # Least squares over the sections of all rows is interpolation with alpha.
        return self.method == "interpolation" or self.centers is None

    def _check_data(self, X: Any, y: Any) -> tuple[Array, Array]:
        refuse_masked(X=X, y=y)
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        if not MIN_MAGNITUDE <= np.abs(y).max() <= MAX_MAGNITUDE:
            check_magnitude(y, name="y")
        return X, y

    def _check_parameters(self) -> None:
        choices: dict[str, Any] = {"method": METHODS, "trend": DEGREES}
        iterative = isinstance(self.solver, ConjugateGradient)
        if isinstance(self.solver, ConjugateGradient):
            check_solver(self.solver)
        else:
            choices["solver"] = SOLVERS
        check_parameters(self, non_negative=("alpha",), **choices)
        if self._is_precomputed and (iterative or self.trend == "linear"):
            name = "solver=ConjugateGradient()" if iterative else "trend='linear'"
            raise ValueError(
                f"{name} needs the states, but centers='precomputed' gives distances "
                "only; pass the states and centers=SeparatedCenterSelector()."
            )

    def _resolve_centers(
        self,
        X: Array,
        y: Array,
        weights: Array | None,
        numbers: Indices,
        scale: float | None,
    ) -> tuple[Sections, Indices | None, AveragedOutputs | None]:
        """Return the sections of the centres, their rows, and the outputs there."""
        n_features = None if self._is_precomputed else X.shape[1]
        kernel = as_kernel(self.kernel, self.beta, n_features, scale)
        return resolve_centers(self, kernel, X, y, weights, numbers)

    def _store(
        self, estimate: Estimate, shape: tuple[int, ...], n_rows: int, weight: float
    ) -> None:
        """Store an estimate for outputs of this shape, from rows of this weight."""

        def shaped(values: Array) -> Any:
            return values.reshape((*values.shape[:-1], *shape))[()]

        for stale in _STALE:
            self.__dict__.pop(stale, None)
        system, fit, rows, averages = estimate
        sections = system.sections
        self.kernel_ = sections.kernel
        self.solver_ = system.solver
        self.center_indices_ = rows
        if isinstance(sections, PrecomputedSections):
            self._columns = sections.columns
        elif isinstance(sections, KernelSections):
            self.centers_ = sections.centers
        self.dual_coef_ = shaped(fit.expansion.dual_coef)
        if system.trend is not None:
            self.trend_coef_ = shaped(fit.expansion.trend_coef)
        if fit.n_iter is not None:
            self.n_iter_, self.solver_residual_ = fit.n_iter, fit.residual
        degrees = len(system.kept) - system.trend_rank
        signal_std = fit.seminorm / np.sqrt(max(degrees, 1))
        noise_std = fit.noise_std
        if noise_std is None:
            noise_std = signal_std * np.sqrt(self.alpha)
        self.signal_std_, self.noise_std_ = shaped(signal_std), shaped(noise_std)
        self._n_rows, self._weight = n_rows, weight
        self._nugget = system.nugget
        if averages is not None:
            self._averages = (*averages,)
        self._system = system

    def _sections(self) -> Sections:
        if hasattr(self, "centers_"):
            return KernelSections(self.kernel_, self.centers_)
        return PrecomputedSections(self.kernel_, self._columns, np.empty((0, 0)))

    def _expansion(self) -> KernelExpansion:
        dual_coef = self.dual_coef_.reshape(len(self.dual_coef_), -1)
        trend_coef = getattr(self, "trend_coef_", dual_coef[:0])
        trend_coef = trend_coef.reshape(len(trend_coef), dual_coef.shape[1])
        origin = np.zeros(0)
        if len(trend_coef) > 1:
            origin = self.centers_.mean(axis=0)
        return KernelExpansion(self._sections(), dual_coef, origin, trend_coef)

    def _validated(self, X: Any) -> Array:
        refuse_masked(X=X)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        if not hasattr(self, "centers_"):
            check_distances(X)
        return X

    def _estimated_norms(self, system: DirectSystem) -> Array:
        """Return an estimate of the native norm of each output."""
        if hasattr(self, "_norms"):
            return self._norms
        M = len(self.dual_coef_)
        if not hasattr(self, "centers_"):
            raise ValueError(
                "The native norm cannot be estimated from centers='precomputed'; give "
                "norm, or fit on the states with centers=SeparatedCenterSelector()."
            )
        degrees = M - system.trend_rank
        if degrees < 2:
            raise ValueError(
                f"The native norm cannot be estimated from {M} centres with "
                f"trend={self.trend!r}; give norm, or take more centres."
            )
        seminorm = np.ravel(self.signal_std_) * np.sqrt(degrees)
        self._norms: Array = native_norm(system, self._averages[0], seminorm)
        return self._norms

    def _direct_system(self) -> DirectSystem:
        system = self._fitted_system()
        assert isinstance(system, DirectSystem)
        return system

    def _fitted_system(self) -> System:
        """Return the system of the estimate, made anew after loading."""
        if hasattr(self, "_system"):
            return self._system
        if not hasattr(self, "centers_"):
            raise ValueError(
                "With centers='precomputed', a loaded model has no power function or "
                "standard deviation, because the distances between the centres are "
                "not pickled; fit again, or fit on the states."
            )
        degree = None
        if hasattr(self, "trend_coef_"):
            degree = min(len(self.trend_coef_) - 1, 1)
        sections, solver = self._sections(), self.solver_
        if isinstance(solver, ConjugateGradient):
            self._system = make_system(
                sections, self._nugget, degree, solver, n_jobs=self.n_jobs
            )
        else:
            self._system = restore_system(sections, self._nugget, degree, solver)
        return self._system


# What follows from the rest, and is large or takes long to compute.
_NOT_PICKLED = ("_system", "_growth", "_norms", "_reach")
# What an earlier fit may leave.
_STALE = (
    *_NOT_PICKLED,
    "_rcond",
    "_columns",
    "_averages",
    "centers_",
    "trend_coef_",
    "n_iter_",
    "solver_residual_",
)
