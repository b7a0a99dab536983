"""Kernel estimate of the Koopman operator acting on the outputs."""

from __future__ import annotations

import warnings
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgWarning
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_X_y
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman import _bounds, _large, _solvers
from sklearn_koopman._iterative import Converged
from sklearn_koopman._large import ImplicitBasis
from sklearn_koopman._native import NativeBasis, Tail
from sklearn_koopman._sections import DistanceSections, KernelSections, Sections
from sklearn_koopman._streaming import (
    GrowingInterpolant,
    GrowingRegression,
    merge_equal_rows,
)
from sklearn_koopman._validation import check_number
from sklearn_koopman.centers import (
    SeparatedCenterSelector,
    check_distances,
    choose_centers,
    rows_at_distance_zero,
)
from sklearn_koopman.kernels import as_kernel
from sklearn_koopman.solvers import ConjugateGradient, check_solver

__all__ = ["KoopmanKernelRegressor"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DEGREES = {None: None, "constant": 0, "linear": 1}


class KoopmanKernelRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Kernel estimate of the Koopman operator acting on measured outputs.

    States follow an unknown map, x_{k+1} = f(x_k), on an unknown manifold; outputs
    y = G(x) are measured. Given rows x_k with the outputs G(f(x_k)) one step (one
    `lag`) later, this estimates the function

    .. math:: (U_f G)(x) = G(f(x))

    in the span of the sections k(., xi_i) of a kernel at M centres xi_i. With one
    `kernel` known on the whole space of states, no knowledge of the manifold is
    needed.

    Parameters
    ----------
    kernel : str or Kernel, default="matern32"
        One of "matern12", "matern32", "matern52", "wendland_c0", "wendland_c2",
        "wendland_c4", "wendland_c6", "gaussian" and "inverse_multiquadric", or a
        kernel object of :mod:`sklearn_koopman.kernels` or
        :mod:`sklearn.gaussian_process.kernels`, whose parameters can be tuned as
        ``kernel__beta`` and the like.
    beta : float, default=None
        Scale of the kernel in the unit of the states, k(x, c) = phi(||x - c|| /
        beta). None leaves that of the kernel object, and means 1 for a name.
    centers : None, array-like of shape (n_centers, n_features), estimator or \
"precomputed", default=None
        Where the kernel sections are centred.

        - None: at every distinct row of `X`.
        - array: at these states.
        - estimator: at the `cluster_centers_` of a clone fitted to `X`, such as
          :class:`SeparatedCenterSelector`; its parameters can be tuned as
          ``centers__separation``.
        - "precomputed": `X` holds the distances of each state to every centre, as
          ``SeparatedCenterSelector.transform`` gives them. They do not tell the
          number of features: beyond three, give a Wendland kernel its `dimension`.
    method : {"interpolation", "least_squares"}, default="interpolation"
        Which outputs the estimate is made from.

        - "interpolation": those of the centres, which have to be rows of `X` (the
          first of equal rows counts; [1]_). Exact on noise-free data.
        - "least_squares": those of all rows. Averages over noise, and over what the
          states do not determine.

        Where every row is a centre the two are the same.
    alpha : float, default=0.0
        Weight of the squared native-space norm against the squared residuals. 0
        interpolates, or leaves the least-squares problem unpenalised.
    trend : {None, "constant", "linear"}, default=None
        Polynomial tail that is solved for together with the kernel part, and that
        predictions return to away from the centres. "linear" suits outputs that
        change little in one step and are part of the state.
    solver : {"auto", "pivoted_cholesky", "cholesky"} or ConjugateGradient, \
default="auto"
        How the system of the Gram matrix is solved.

        - "pivoted_cholesky": by a dense Cholesky factor. Where the matrix is not
          numerically positive definite, a pivoted factorisation leaves out the
          centres that depend on others, with a warning unless `alpha` makes them
          irrelevant to least squares.
        - "cholesky": the same, with an error in place of leaving out centres.
        - :class:`~sklearn_koopman.solvers.ConjugateGradient`: iteratively, without a
          dense matrix, for many centres.
        - "auto": "pivoted_cholesky", but `ConjugateGradient()` where a dense matrix
          would take more than half of the memory of the machine, or where there are
          more than 5,000 centres and less than 1 % of its entries are not zero.
    n_jobs : int, default=None
        Number of threads for predictions and for the products of
        `ConjugateGradient`. None means 1 unless in a :obj:`joblib.parallel_config`
        context, -1 means all processors.

    Attributes
    ----------
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres; None for centres given from elsewhere,
        which least squares takes.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres. Not present with ``centers="precomputed"``.
    dual_coef_ : ndarray of shape (n_centers,) or (n_centers, n_outputs)
        Coefficients of the kernel sections.
    trend_coef_ : ndarray of shape (1 + n_features,) or (1 + n_features, n_outputs)
        Coefficients of the tail: of 1, then of each feature less its mean over the
        centres. Only with a `trend`; for ``trend="constant"`` just the constant.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    amplitude_ : float or ndarray of shape (n_outputs,)
        Scale of the outputs in terms of the kernel. For interpolation
        ``sqrt(u^T (K + alpha I)^-1 u / M)`` with M the number of centres: the
        standard deviation at which the kernel, as the covariance of a Gaussian
        process, makes the outputs most likely (restricted maximum likelihood, with M
        less the rank of the trend, if there is one). For least squares the native
        norm of the estimate over sqrt(M) instead, which is smaller, the stronger
        `alpha` shrinks it.
    noise_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs about the estimate. ``amplitude_ *
        sqrt(alpha)`` for interpolation, and where every row is a centre; otherwise
        the root of the sum of squared residuals over the number of rows less the
        effective number of parameters.
    solver_ : str or ConjugateGradient
        What `solver` came to: "pivoted_cholesky", "cholesky" or the conjugate
        gradients.
    n_iter_ : int
        Number of iterations. Only with conjugate gradients.
    residual_ : float
        Largest residual of any output relative to the values to be met, computed anew
        at the end. Only with conjugate gradients.
    rcond_ : float
        Estimate of the reciprocal condition number of the matrix that was factored:
        K, with `alpha` on its diagonal for interpolation. About ``-log10(rcond_)`` of
        16 digits are lost in the coefficients, fewer in the predictions: where many
        are lost, the estimate is accepted if it reproduces the values that it should
        have to 1e-6 of their size. Not with conjugate gradients.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, where `X` had string names.

    See Also
    --------
    SeparatedCenterSelector : Chooses centres along trajectories.
    sklearn_koopman.trajectories.trajectory_pairs : Makes `X` and `y` of trajectories.
    sklearn.gaussian_process.GaussianProcessRegressor : Fits the scale of the kernel
        by maximum likelihood, with every row a centre.

    Notes
    -----
    With K = k(Xi, Xi) and u the outputs of the centres, interpolation has the
    coefficients c = (K + alpha I)^-1 u. For alpha = 0 this is the projection of U_f G
    onto the span of the sections ([1]_, Section 3.4). Algorithm 1 there prints the
    coefficients of the interpolant h of the pairs (f(xi_i), u_i), an estimate of G;
    h(f(x)) has the same values u_i at the centres, so that its projection is this
    estimate as well. Least squares minimises

    .. math:: \\sum_i |y_i - g(x_i)|^2 + \\alpha \\|g\\|_H^2

    over the same span: the empirical risk minimiser, which is what EDMD with the
    sections as its dictionary predicts ([1]_, end of Section 3.4). It is solved in a
    basis that is orthonormal in H.

    With a tail p(x) b the coefficients satisfy P(Xi)^T c = 0, as usual for
    conditionally positive definite kernels; equal rows count as one centre with their
    mean output, and with `alpha` over their number on the diagonal of K.

    Memory is one M x M matrix; the Cholesky factor is kept for `power_function`, but
    not pickled, and computed anew when first needed after loading (which takes the
    centres, so that after ``centers="precomputed"`` it cannot be).

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".
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

    def __init__(
        self,
        kernel: Any = "matern32",
        *,
        beta: float | None = None,
        centers: Any = None,
        method: str = "interpolation",
        alpha: float = 0.0,
        trend: str | None = None,
        solver: str = "auto",
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

    def fit(self, X: Any, y: Any) -> KoopmanKernelRegressor:
        """Choose the centres and compute the coefficients.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.

        Returns
        -------
        self : KoopmanKernelRegressor
            The fitted estimate.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if a centre is no row of `X` where
            its output is needed; if equal rows have different outputs where every
            row is to be interpolated; if least squares with ``alpha=0`` has fewer
            rows than centres; if ``solver="cholesky"`` meets a Gram matrix that is
            not positive definite.

        Warns
        -----
        LinAlgWarning
            If dependent centres were left out, and that may matter.
        """
        given = X
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        self._check_parameters()
        n_features = None if self._precomputed else X.shape[1]
        kernel = as_kernel(self.kernel, self.beta, n_features)
        outputs = y.reshape(len(y), -1)
        sections: Sections
        u, nugget, scatter = None, None, np.zeros(outputs.shape[1])
        if self._precomputed:
            if not _is_isotropic(kernel):
                raise ValueError(
                    f"kernel={kernel!r} does not depend on distances alone, which "
                    "centers='precomputed' needs; pass the states and a selector."
                )
            rows: Indices | None = rows_at_distance_zero(X)
            points = X[rows]
            sections = DistanceSections(kernel, np.arange(X.shape[1]))
        elif self.centers is None:
            # Least squares over the sections of all rows is interpolation with alpha.
            rows, u, counts, scatter = merge_equal_rows(
                X, outputs, np.ones(len(X)), self._exact, np.arange(len(X))
            )
            points, nugget = X[rows], self.alpha / counts
            sections = KernelSections(kernel, points)
        else:
            points, rows = choose_centers(
                self.centers, X, y, among_rows=self.method == "interpolation"
            )
            sections = KernelSections(kernel, points)
        if self.method == "interpolation" and u is None:
            assert rows is not None
            u, nugget = outputs[rows], np.full(len(points), self.alpha)
            counts = np.ones(len(points))
        if nugget is None:
            nugget = np.zeros(len(points))
        solver, solution, found = self._solve(sections, points, nugget, X, outputs, u)
        residual = None
        if self.method == "least_squares" and not nugget.any():
            residual = _solvers.residual_norms(solution, X, outputs, self.n_jobs)
        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, y, skip_check_array=True)
        self._forget()
        self._store(solution, rows, nugget, y.shape[1:], len(X), residual)
        self.solver_ = solver
        if found is not None:
            self.n_iter_, self.residual_ = found.n_iter, found.residual
        if u is not None:
            self._values, self._scatter = u[solution.kept], scatter
            self._counts = counts[solution.kept]
        return self

    def partial_fit(self, X: Any, y: Any) -> KoopmanKernelRegressor:
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
        self : KoopmanKernelRegressor
            The estimate from all rows so far.

        Raises
        ------
        ValueError
            As in `fit`; for centres and solvers that cannot grow; for outputs of
            another shape than before; for least squares at chosen centres after
            `fit` or after loading from a pickle, neither of which keeps its sums.

        Notes
        -----
        Least squares with a selector keeps the rows, and starts anew when a batch
        brings new centres. To stream through recordings that are larger than memory,
        find the centres first, by `SeparatedCenterSelector.partial_fit`, and give them
        as an array.

        After centres have been added, `rcond_` is an upper bound by the pivots of the
        factor. Where they come close to being dependent, all are factored anew, and
        left out as in `fit`. `noise_` of least squares is a difference of sums, and not
        told where it is below about 1e-8 of the outputs.
        """
        started = hasattr(self, "dual_coef_")
        given = X
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        self._check_parameters()
        self._check_growth()
        if started:
            validate_data(self, given, y, reset=False, skip_check_array=True)
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
        self._add_rows(X, y, started)
        validate_data(self, given, y, reset=not started, skip_check_array=True)
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
            Standard deviation of the outputs, ``sqrt((amplitude_ * P) ** 2 + noise_
            ** 2)`` with the power function P; only if `return_std`. This takes the
            outputs for a sample of a Gaussian process with this kernel and
            independent noise. It is too wide where they are smoother than that, and
            too narrow on a trajectory that differs from those of the training data.

        Raises
        ------
        ValueError
            If `X` has another number of columns than in `fit`, or negative distances;
            with `return_std`, if the model was fitted to distances and loaded from a
            pickle.
        """
        check_is_fitted(self)
        X = self._validated(X)
        y = self._evaluate(X).reshape((len(X), *self.dual_coef_.shape[1:]))
        if not return_std:
            return y
        P = self._fitted_basis().power(X, self.n_jobs)
        P = P.reshape((-1,) + (1,) * (self.dual_coef_.ndim - 1))
        return y, np.hypot(self.amplitude_ * P, self.noise_)

    def power_function(self, X: Any) -> Array:
        """Evaluate the power function, which bounds the error of interpolation.

        .. math:: P(x)^2 = k(x, x) - k(x, \\Xi)\\, K^{-1} k(\\Xi, x)

        is the squared distance of k(., x) from the span of the sections, so that
        ``|g(x) - estimate(x)| <= P(x) ||g||_H`` for every g in the native space H of
        the kernel ([2]_ of the class, Theorem 11.4). With a `trend` it is that of the
        span with the polynomials. Where ``alpha > 0`` is on the diagonal of K, for
        interpolation and where every row is a centre, it is there here, too.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.

        Returns
        -------
        power : ndarray of shape (n_samples,)
            Zero at the centres (up to the square root of the rounding error, if alpha
            is 0 and the kernel has no noise term), and at most sqrt(k(x, x)) without
            a `trend`.

        Raises
        ------
        ValueError
            If the model was fitted to distances and loaded from a pickle.
        """
        check_is_fitted(self)
        return self._fitted_basis().power(self._validated(X), self.n_jobs)

    def error_bound(self, X: Any, norm: Any = None) -> Array:
        """Bound the error of the prediction at each state.

        .. math:: |(U_f G)(x) - \\text{estimate}(x)| \\le P(x)\\, \\|U_f G\\|_H

        with the power function P ([2]_ of the class, Theorem 11.4), for outputs
        without noise of functions in the native space H of the kernel. With a `trend`
        any polynomial may be taken off the function before its norm.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, or their distances to the centres with
            ``centers="precomputed"``.
        norm : float or array-like of shape (n_outputs,), default=None
            The native norm of U_f G. With a number that is known the bound is rigorous
            (up to rounding). None estimates it from the data: from the norm of the
            interpolant, which never exceeds it, and from how much that grew with the
            second half of the centres. The estimate is too small for functions that
            are not in the native space (take a rougher kernel), that have detail
            which falls between the centres, or with too few centres to see the norm
            settle; the bound fails with it. For smooth outputs it is far too large:
            their error falls with a higher order than the power function.

        Returns
        -------
        bound : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The bound, in the unit of the outputs. It includes the rounding error of
            the squared power function, 1e-13 of the kernel. Infinite where a linear
            trend goes in directions that the centres do not tell.

        Raises
        ------
        ValueError
            If the estimate is one of least squares, which has no such bound, or was
            solved by conjugate gradients; if
            `norm` is no finite number for each output, 0 or above; if it is left out
            where the centres are not known, or too few for an estimate; if the model
            was fitted to distances and loaded from a pickle.

        Warns
        -----
        UserWarning
            If states are off the manifold: where the power function is larger than at
            any centre that is left out of the others (centres that lie apart do not
            count) or infinite, or where, without a trend, no centre tells anything.

        Notes
        -----
        Behind the other steps of a pipeline this is ``pipeline[-1].error_bound(
        pipeline[:-1].transform(X))``. The first call takes the time and the memory of
        another factorisation.
        """
        check_is_fitted(self)
        if not self._interpolates:
            raise ValueError(
                "error_bound is that of interpolation; method='least_squares' at "
                "chosen centres averages over rows that no function of the span meets, "
                "and has none. Take predict(X, return_std=True), or "
                "method='interpolation'."
            )
        if isinstance(self.solver_, ConjugateGradient):
            raise ValueError(
                "error_bound takes a dense Cholesky factor, but this model was solved "
                "by conjugate gradients; multiply power_function(X) by the native norm "
                "instead, or fit with solver='cholesky'."
            )
        X = self._validated(X)
        basis = self._native_basis()
        norms = self._native_norms(norm)
        diagonal = basis.sections.smooth_diagonal(X)
        variance = _bounds.variance(basis, X, diagonal, self.n_jobs)
        if basis.tail is not None:
            variance[basis.tail.beyond(X)] = np.inf
        self._warn_off_manifold(basis, variance, diagonal)
        P = np.sqrt(variance + _bounds.ROUNDING * diagonal)
        with np.errstate(invalid="ignore"):
            bound = np.outer(P, norms)
        bound[np.isinf(P)] = np.inf
        return bound.reshape((len(X), *self.dual_coef_.shape[1:]))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is large, or long to compute, and follows from the rest."""
        state = dict(super().__getstate__())
        for name in ("_basis", "_norm", "_reach", "_growth", "_batches", "_selector"):
            state.pop(name, None)
        return state

    @property
    def _exact(self) -> bool:
        """Whether equal rows with different outputs are an error."""
        return self.method == "interpolation" and self.alpha == 0

    @property
    def _precomputed(self) -> bool:
        return isinstance(self.centers, str) and self.centers == "precomputed"

    def _check_parameters(self) -> None:
        check_number(self.alpha, "alpha")
        choices_of: dict[str, tuple[str | None, ...]] = {
            "method": ("interpolation", "least_squares"),
            "trend": tuple(DEGREES),
            "solver": ("auto", "pivoted_cholesky", "cholesky"),
        }
        if isinstance(self.solver, ConjugateGradient):
            check_solver(self.solver)
            if self._precomputed:
                raise ValueError(
                    "solver=ConjugateGradient() needs the states, but "
                    "centers='precomputed' gives distances only; pass the states and "
                    "centers=SeparatedCenterSelector()."
                )
            del choices_of["solver"]
        for name, choices in choices_of.items():
            value = getattr(self, name)
            if not (value is None or isinstance(value, str)) or value not in choices:
                raise ValueError(
                    f"{name} must be one of {', '.join(map(repr, choices))}, "
                    f"got {value!r}."
                )
        if self._precomputed and self.trend == "linear":
            raise ValueError(
                "trend='linear' needs the states, but centers='precomputed' gives "
                "distances only; pass the states and centers=SeparatedCenterSelector()."
            )

    def _solve(
        self,
        sections: Sections,
        points: Array,
        nugget: Array,
        X: Array,
        y: Array,
        u: Array | None,
    ) -> tuple[str | ConjugateGradient, _solvers.Solution[Any], Converged | None]:
        """Interpolate u at the centres, or fit y where there is none."""
        kernel: Any = sections.kernel
        solver: str | ConjugateGradient = self.solver
        if u is None and self.alpha == 0 and len(X) < len(points):
            raise ValueError(
                f"method='least_squares' with alpha=0 needs at least as many rows "
                f"as centres, got {len(X)} rows and {len(points)} centres; set "
                "alpha > 0 or choose fewer centres."
            )
        if not isinstance(solver, str):
            solver = clone(solver)
        elif solver == "auto":
            large = _large.is_large(sections, points)
            solver = ConjugateGradient() if large else "pivoted_cholesky"
        degree = DEGREES[self.trend]
        extent = X if u is None else points
        solution: _solvers.Solution[Any]
        found, tolerance = None, 0.0
        try:
            if isinstance(solver, ConjugateGradient):
                assert isinstance(sections, KernelSections)
                tail = None if degree is None else Tail.on(points, degree, extent)
                basis = ImplicitBasis.of(sections, nugget, tail, solver, self.n_jobs)
                solution, found = (
                    _large.regress(basis, X, y, self.alpha, self.n_jobs)
                    if u is None
                    else _large.interpolate(basis, u)
                )
            else:
                solution, tolerance = _solvers.solve(
                    sections,
                    points,
                    nugget,
                    _solvers.regression(X, y, self.alpha, self.n_jobs)
                    if u is None
                    else _solvers.interpolation(points, u),
                    degree,
                    extent,
                    drop_dependent=solver == "pivoted_cholesky",
                )
        except _solvers.UnsuitableKernelError as error:
            raise ValueError(
                f"kernel={kernel!r} {error}; rescale them, or take another kernel."
            ) from error
        except np.linalg.LinAlgError as error:
            raise ValueError(
                f"No estimate for kernel={kernel!r} on {len(points)} centres: {error}. "
                f"{_REMEDY}"
            ) from error
        # By |<r, e>| <= sqrt(n) |r| sup|e|, a section that the others reproduce to
        # sqrt(tolerance) moves a regularised fit by about n tolerance / alpha of its
        # residuals at the most: nothing to act upon.
        negligible = len(X) * tolerance <= 1e-5 * self.alpha
        if not (self.method == "least_squares" and negligible):
            self._warn_left_out(kernel, len(points), len(solution.kept))
        if isinstance(solver, ConjugateGradient) and found is not None:
            self._warn_not_converged(kernel, len(points), solver, found)
        return solver, solution, found

    @staticmethod
    def _warn_left_out(kernel: Any, n_centers: int, n_kept: int) -> None:
        if n_kept < n_centers:
            warnings.warn(
                f"The Gram matrix of kernel={kernel!r} on {n_centers} centres is "
                f"numerically singular; {n_centers - n_kept} centres that depend on "
                f"the others were left out. {_REMEDY}",
                LinAlgWarning,
                stacklevel=4,
            )

    @staticmethod
    def _warn_not_converged(
        kernel: Any, n_centers: int, solver: ConjugateGradient, found: Converged
    ) -> None:
        if found.residual > solver.tol:
            warnings.warn(
                f"Conjugate gradients for kernel={kernel!r} on {n_centers} centres "
                f"ended after {found.n_iter} iterations with a relative residual of "
                f"{found.residual:.1e}, above tol={solver.tol:.1e}. Raise max_iter, "
                f"rank, n_neighbors or tol of the solver. {_REMEDY}",
                ConvergenceWarning,
                stacklevel=4,
            )

    def _check_growth(self) -> None:
        """Refuse what `partial_fit` cannot extend."""
        solver = getattr(self, "solver_", self.solver)
        if isinstance(solver, ConjugateGradient):
            raise ValueError(
                "partial_fit extends a Cholesky factor, which conjugate gradients do "
                "not have; fit with solver='pivoted_cholesky' from the first batch on."
            )
        chooses = isinstance(self.centers, SeparatedCenterSelector)
        given = not (self.centers is None or chooses or hasattr(self.centers, "fit"))
        if self._precomputed or not (
            self.centers is None
            or chooses
            or (given and self.method == "least_squares")
        ):
            raise ValueError(
                "partial_fit adds centres with centers=None or a "
                "SeparatedCenterSelector, and rows with method='least_squares' and an "
                f"array of centres, got centers={type(self.centers).__name__} and "
                f"method={self.method!r}."
            )
        if hasattr(self, "_settings") and self._settings != self._current_settings():
            raise ValueError(
                "Parameters were changed since the first batch; set them back, or call "
                "fit to start anew."
            )

    def _current_settings(self) -> tuple[Any, ...]:
        kernel = as_kernel(self.kernel, self.beta, None)
        return repr(kernel), self.method, self.alpha, self.trend

    def _add_centers(self, X: Array, y: Array) -> None:
        """Extend an interpolant by the rows that become centres."""
        assert self.center_indices_ is not None
        outputs, M = y.reshape(len(y), -1), len(self.centers_)
        numbers = np.append(self.center_indices_, self._n_seen + np.arange(len(X)))
        scatter = self._scatter
        if self.centers is None:
            rows, u, counts, more = merge_equal_rows(
                np.vstack([self.centers_, X]),
                np.vstack([self._values, outputs]),
                np.append(self._counts, np.ones(len(X))),
                self._exact,
                numbers,
            )
            nugget, scatter = self.alpha / counts, scatter + more
            selector = None
        else:
            selector, new = self._grown_selector(X)
            rows = np.append(np.arange(M), M + new)
            u = np.vstack([self._values, outputs[new]])
            counts = np.ones(len(u))
            nugget = np.full(len(u), self.alpha)
        points = np.vstack([self.centers_, X])[rows]
        sections = KernelSections(self.kernel_, points)
        solution: _solvers.Solution[Any]
        try:
            if not np.array_equal(nugget[:M], self._nugget):
                raise np.linalg.LinAlgError("the weights of old centres have changed")
            growth = getattr(self, "_basis", None)
            if not isinstance(growth, GrowingInterpolant):
                growth = GrowingInterpolant.of(
                    self._native_basis(), self.centers_, self._values
                )
            if len(points) > M:
                growth.extend(sections, points[M:], nugget[M:], u[M:])
            if not np.array_equal(u[:M], self._values):
                growth.v = growth.factor.forward(u)
            solution = growth.solution(u)
        except np.linalg.LinAlgError:
            _, solution, _ = self._solve(sections, points, nugget, points, u, u)
        residual = None
        if self.method == "least_squares" and not nugget.any():
            residual = np.sqrt(scatter)
        n_seen = self._n_seen + len(X)
        shape = self.dual_coef_.shape[1:]
        self._store(solution, numbers[rows], nugget, shape, n_seen, residual)
        self._values, self._scatter = u[solution.kept], scatter
        self._counts = counts[solution.kept]
        if selector is not None:
            self._selector = selector

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
        selector = copy(selector).partial_fit(X)
        return selector, selector.center_indices_[n_known:] - n_seen

    def _add_rows(self, X: Array, y: Array, started: bool) -> None:
        """Add rows to least squares at chosen centres."""
        if started and not hasattr(self, "_growth"):
            raise ValueError(
                "partial_fit of least squares at chosen centres continues from the "
                "sums of earlier batches, which neither fit nor a pickle keeps; call "
                "partial_fit from the first batch on."
            )
        outputs = y.reshape(len(y), -1)
        growth, selector, rows = getattr(self, "_growth", None), None, None
        batches = [(X, outputs)]
        if isinstance(self.centers, SeparatedCenterSelector):
            selector, new = self._grown_selector(X)
            batches = [*getattr(self, "_batches", []), *batches]
            rows = selector.center_indices_
            points = selector.cluster_centers_
            if len(new):
                growth = None
        if growth is None:
            if selector is None:
                points, _ = choose_centers(self.centers, X, y, among_rows=False)
            growth = self._new_growth(X, points, outputs.shape[1])
            for batch in batches:
                growth.add(*batch)
        else:
            growth.add(X, outputs)
        try:
            solution, residual = growth.solution(self.alpha, X)
        except np.linalg.LinAlgError as error:
            raise ValueError(f"No estimate: {error}. {_REMEDY}") from error
        if rows is not None:
            rows = rows[growth.kept]
        nugget = np.zeros(len(solution.dual))
        self._store(solution, rows, nugget, y.shape[1:], growth.n_rows, residual)
        self.solver_ = "cholesky" if self.solver == "cholesky" else "pivoted_cholesky"
        self._growth = growth
        if selector is not None:
            self._selector, self._batches = selector, batches

    def _new_growth(self, X: Array, points: Array, n_outputs: int) -> GrowingRegression:
        """Factor the Gram matrix at centres that rows are going to be fitted with."""
        kernel = as_kernel(self.kernel, self.beta, X.shape[1])
        try:
            basis, kept = _solvers.independent_basis(
                KernelSections(kernel, points),
                points,
                DEGREES[self.trend],
                X,
                drop_dependent=self.solver != "cholesky",
            )
        except _solvers.UnsuitableKernelError as error:
            raise ValueError(
                f"kernel={kernel!r} {error}; rescale them, or take another kernel."
            ) from error
        except np.linalg.LinAlgError as error:
            raise ValueError(
                f"No estimate for kernel={kernel!r} on {len(points)} centres: {error}. "
                f"{_REMEDY}"
            ) from error
        self._warn_left_out(kernel, len(points), len(kept))
        return GrowingRegression.of(basis, kept, n_outputs)

    def _forget(self) -> None:
        """Remove what an earlier fit has left."""
        for name in ("_growth", "_selector", "_batches", "_values", "n_iter_"):
            self.__dict__.pop(name, None)
        self.__dict__.pop("residual_", None)

    def _store(
        self,
        solution: _solvers.Solution[Any],
        rows: Indices | None,
        nugget: Array,
        shape: tuple[int, ...],
        n_rows: int,
        residual: Array | None,
    ) -> None:
        """Store an estimate for outputs of this shape, with the residual norms."""
        basis, kept = solution.basis, solution.kept

        def shaped(values: Array) -> Any:
            return values.reshape((*values.shape[:-1], *shape))[()]

        for stale in ("centers_", "trend_coef_", "rcond_", "_norm", "_reach"):
            self.__dict__.pop(stale, None)
        self.kernel_ = basis.sections.kernel
        self.center_indices_ = None if rows is None else rows[kept]
        self.dual_coef_ = shaped(solution.dual)
        if not isinstance(basis, ImplicitBasis):
            self.rcond_ = basis.rcond
        self._sections = basis.sections
        if isinstance(self._sections, KernelSections):
            self.centers_ = self._sections.centers
        self._nugget = nugget[kept]
        self._tail = basis.tail
        if basis.tail is not None:
            self.trend_coef_ = shaped(solution.trend)
        self._basis = basis
        degrees = max(len(kept) - basis.Q.shape[1], 1)
        amplitude = solution.seminorm / np.sqrt(degrees)
        noise = amplitude * np.sqrt(self.alpha)
        spare = n_rows - solution.freedom
        if residual is not None and spare > 1e-6 * n_rows:
            noise = residual / np.sqrt(spare)
        self.amplitude_ = shaped(amplitude)
        self.noise_ = shaped(noise)
        self._n_seen = n_rows
        self._settings = self._current_settings()

    def _evaluate(self, X: Array) -> Array:
        dual = self.dual_coef_.reshape(len(self.dual_coef_), -1)
        trend = getattr(self, "trend_coef_", self.dual_coef_[:0])
        trend = trend.reshape(len(trend), dual.shape[1])
        return _solvers.evaluate(
            self._sections, self._tail, X, dual, trend, self.n_jobs
        )

    def _validated(self, X: Any) -> Array:
        X = validate_data(self, X, reset=False, dtype=np.float64)
        if isinstance(self._sections, DistanceSections):
            check_distances(X)
        return X

    def _native_norms(self, norm: Any) -> Array:
        """Return the native norm of each output: as given, or estimated."""
        n_outputs = int(np.prod(self.dual_coef_.shape[1:]))
        if norm is not None:
            norms = np.atleast_1d(np.asarray(norm, dtype=object))
            if norms.ndim > 1 or norms.size not in (1, n_outputs):
                raise ValueError(
                    f"norm must be a number, or one for each of {n_outputs} outputs, "
                    f"got an array of shape {norms.shape}."
                )
            for value in norms:
                check_number(value, "norm")
            return np.broadcast_to(norms.astype(np.float64), n_outputs)
        if not hasattr(self, "_norm"):
            basis = self._native_basis()
            degrees = len(self.dual_coef_) - basis.Q.shape[1]
            if not hasattr(self, "centers_"):
                raise ValueError(
                    "The native norm cannot be estimated with centers='precomputed', "
                    "from distances to the centres alone; give norm, or fit on the "
                    "states with centers=SeparatedCenterSelector()."
                )
            if degrees < 2:
                raise ValueError(
                    f"The native norm cannot be estimated from {len(self.dual_coef_)} "
                    f"centres with trend={self.trend!r}; give norm, or take more "
                    "centres."
                )
            dual = self.dual_coef_.reshape(-1, n_outputs)
            self._norm = _bounds.native_norm(
                self._sections,
                self.centers_,
                self._nugget,
                self._tail,
                self._evaluate(self.centers_) + basis.excess[:, np.newaxis] * dual,
                np.ravel(self.amplitude_) * np.sqrt(degrees),
            )
        return self._norm

    def _warn_off_manifold(
        self, basis: NativeBasis, variance: Array, diagonal: Array
    ) -> None:
        if not hasattr(self, "_reach"):
            points = getattr(self, "centers_", np.zeros((len(basis.lower), 1)))
            self._reach = _bounds.reach(basis, points)
        off = np.sqrt(variance) > self._reach * (1 + 1e-6)
        off |= np.isinf(variance)
        if basis.tail is None:
            off |= variance > (1 - 1e-6) * diagonal
        if off.any():
            if np.isfinite(self._reach):
                limit = f"at most {self._reach:.2g} at centres left out of the others"
            elif len(basis.lower) == 1:
                limit = "there is one centre only"
            else:
                limit = "no centre tells anything of the others, either: raise beta"
            warnings.warn(
                f"{off.sum()} of {len(off)} states are off the manifold of the "
                f"centres: the power function is up to {np.sqrt(variance.max()):.2g} "
                f"there ({limit}). Predictions are extrapolation there; learn from "
                "samples that cover such states, or leave them out.",
                UserWarning,
                stacklevel=3,
            )

    def _native_basis(self) -> NativeBasis:
        basis = self._fitted_basis()
        assert isinstance(basis, NativeBasis)
        return basis

    def _fitted_basis(self) -> NativeBasis | ImplicitBasis:
        if hasattr(self, "_basis"):
            if isinstance(self._basis, GrowingInterpolant):
                return self._basis.native()
            return self._basis
        if not isinstance(self._sections, KernelSections):
            raise ValueError(
                "With centers='precomputed' the distances between the centres are "
                "not pickled, so that a loaded model has no power function or "
                "standard deviation; fit again, or fit on the states with "
                "centers=SeparatedCenterSelector()."
            )
        try:
            if isinstance(self.solver_, ConjugateGradient):
                self._basis = ImplicitBasis.of(
                    self._sections, self._nugget, self._tail, self.solver_, self.n_jobs
                )
            else:
                self._basis = NativeBasis.of(
                    self._sections, self.centers_, self._nugget, self._tail
                )
        except np.linalg.LinAlgError as error:
            raise ValueError(
                "The Gram matrix, not pickled, was barely positive definite where "
                "the model was fitted, and is not on this machine: predictions are "
                f"all that is left. Fit again, here. {_REMEDY}"
            ) from error
        return self._basis


_REMEDY = (
    "Choose centres with a larger separation, lower beta, raise alpha, or take a less "
    "smooth kernel."
)


def _is_isotropic(kernel: Any) -> bool:
    """Tell whether the kernel may be evaluated on a line, as a function of distance."""
    if not kernel.is_stationary():
        return False
    try:
        kernel(np.zeros((1, 1)), np.zeros((1, 1)))
    except ValueError:  # one scale for each of several features
        return False
    return True
