"""Cross-validated choice of the kernel and its scale, without refitting."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from joblib import effective_n_jobs
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.exceptions import FitFailedWarning
from sklearn.frozen import FrozenEstimator
from sklearn.metrics import check_scoring
from sklearn.model_selection import LeaveOneOut, check_cv
from sklearn.utils import check_X_y
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman._linalg._leave_out import Fold
from sklearn_koopman._matrices._polynomial import DEGREES
from sklearn_koopman._regression._candidates import (
    HeldOut,
    Outcome,
    Search,
    scores_of_folds,
    tabulated,
)
from sklearn_koopman._utils._parallel import one_thread
from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_number
from sklearn_koopman.kernels import RadialKernel, as_kernel
from sklearn_koopman.regression import KoopmanKernelRegressor

__all__ = ["KoopmanKernelRegressorCV"]


class KoopmanKernelRegressorCV(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Kernel estimate of the Koopman operator with built-in cross-validation.

    Chooses the kernel, its scale `beta` and the weight `alpha` of a
    :class:`KoopmanKernelRegressor` by predictions of held-out rows, and refits the
    winner to all rows. The predictions are those of refits, but come from closed
    forms: one matrix serves all values of `alpha`, and one factorisation many folds.

    Parameters
    ----------
    kernels : sequence of str or Kernel, default=("matern32",)
        The kernels to choose from, each as `kernel` of
        :class:`KoopmanKernelRegressor`.
    betas : sequence of float or None, default=(0.1, 1.0, 10.0)
        The scales to choose from. None, alone or in the list, leaves that of the
        kernel object, as kernels from elsewhere need.
    alphas : sequence of float, default=(0.0,)
        The weights of the squared native-space norm to choose from.
    centers : None, array-like of shape (n_centers, n_features) or estimator, \
default=None
        Where the kernel sections are centred, as in
        :class:`KoopmanKernelRegressor`. An estimator is fitted once, to all rows, and
        its centres are those of every fold (for interpolation: those of them that are
        training rows).
    method : {"interpolation", "least_squares"}, default="interpolation"
        Which outputs the estimate is made from.
    trend : {None, "constant", "linear"}, default=None
        Polynomial tail that is solved for together with the kernel part.
    solver : {"auto", "pivoted_cholesky", "cholesky"}, default="auto"
        What happens where the Gram matrix is not numerically positive definite:
        dependent centres are left out, of all folds, or the candidate fails.
    scoring : str or callable, default=None
        How held-out predictions are scored; larger is better. A name or a scorer of
        scikit-learn, which gets an estimator that returns the predictions. None means
        the negative mean squared error for leave-one-out, and otherwise R^2, averaged
        over the outputs.
    cv : int, cross-validation splitter or iterable, default=None
        How rows are held out.

        - None: one by one, and all predictions are scored together. Rows next to each
          other on a trajectory tell each other's outputs: this flatters a model unless
          rows are independent.
        - int: that many folds of consecutive rows.
        - a splitter, such as :class:`~sklearn_koopman.TrajectoryKFold`, or an
          iterable of pairs of training and test rows. Every fold is scored, and the
          scores averaged.
    n_jobs : int, default=None
        Number of threads: for kernels and scales in `fit`, each with a matrix of its
        own and with BLAS held to one thread, and for predictions. Where SciPy's LAPACK
        keeps other threads waiting, None is the faster for `fit`: it means 1, and
        BLAS with its own threads, unless in a :obj:`joblib.parallel_config` context.
        -1 means all processors.

    Attributes
    ----------
    best_kernel_ : str or Kernel
        The kernel chosen, as given in `kernels`.
    best_beta_ : float or None
        The scale chosen, as given in `betas`.
    best_alpha_ : float
        The weight chosen.
    best_score_ : float
        Its score: of all rows for leave-one-out, otherwise the mean over the folds.
    best_index_ : int
        Its place in `cv_results_`.
    best_estimator_ : KoopmanKernelRegressor
        The winner, fitted to all rows.
    cv_results_ : dict of ndarrays
        The scores of all candidates in the format of
        :class:`~sklearn.model_selection.GridSearchCV`, for example for a
        `pandas.DataFrame`: "params", "param_kernel", "param_beta", "param_alpha",
        "mean_test_score", "std_test_score", "rank_test_score", and
        "split0_test_score" and so on except for leave-one-out. NaN where a candidate
        has no estimate.
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres, as in `best_estimator_`; None for centres
        given from elsewhere.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres.
    dual_coef_ : ndarray of shape (n_centers,) or (n_centers, n_outputs)
        Coefficients of the kernel sections.
    trend_coef_ : ndarray of shape (1 + n_features,) or (1 + n_features, n_outputs)
        Coefficients of the tail. Only with a `trend`.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    signal_std_ : float or ndarray of shape (n_outputs,)
        Scale of the outputs in terms of the kernel.
    noise_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs about the estimate.
    rcond_ : float
        Estimate of the reciprocal condition number of the matrix that was factored.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, where `X` had string names.

    See Also
    --------
    KoopmanKernelRegressor : The estimate itself; its attributes are described there.
    sklearn_koopman.TrajectoryKFold : Holds out whole trajectories, or blocks of one.
    sklearn.linear_model.RidgeCV : The same for linear models.

    Notes
    -----
    For interpolation with A = (K + alpha I)^-1, bordered by the trend if there is
    one, the residuals of the rows S of a fold that are centres are

    .. math:: u_S - \\hat u_S = (A_{SS})^{-1} (A u)_S

    ([1]_ for single rows; [4]_, Section 5.4.2): they come from columns of the inverse
    of the Cholesky factor. For least squares with the hat matrix H they are

    .. math:: y_S - \\hat y_S = (I - H_{SS})^{-1} (y - H y)_S,

    Allen's PRESS [3]_, which [2]_ compares with its rotation-invariant form. The hat
    matrix comes from one factorisation for every alpha, or one eigendecomposition for
    all. For few large folds it takes fewer operations to factor what every fold
    leaves of the matrix; `fit` counts them and does what is cheaper. Where rounding
    would spoil a closed form, that fold is refitted.

    The centres are those of all rows, where a search with refits would choose them
    anew among the training rows of each fold: their choice sees the states of
    held-out rows, but no outputs. For interpolation a selector's centres leave gaps
    where a fold takes some of them away, which other training rows would have filled:
    scores are then lower than those of refits that choose anew. Equal rows count as
    in :class:`KoopmanKernelRegressor`, and a fold may take some of them away.

    With M centres and n rows, memory is two matrices of max(n, M) x M (distances and
    kernel; just M x M for interpolation where every row is a centre) and a few of
    M x M; for least squares two more of n x M. Each thread has its own, other than
    the distances.

    References
    ----------
    .. [1] S. Rippa, "An algorithm for selecting a good value for the parameter c in
       radial basis function interpolation", Advances in Computational Mathematics 11,
       1999.
    .. [2] G. H. Golub, M. Heath and G. Wahba, "Generalized cross-validation as a
       method for choosing a good ridge parameter", Technometrics 21, 1979.
    .. [3] D. M. Allen, "The relationship between variable selection and data
       augmentation and a method for prediction", Technometrics 16, 1974.
    .. [4] C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine
       Learning", MIT Press, 2006.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanKernelRegressorCV, TrajectoryKFold
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> start = np.column_stack([np.zeros(5), np.linspace(0.5, 2.0, 5)])
    >>> pendulum = make_pendulum(n_samples=60, initial=start)
    >>> model = KoopmanKernelRegressorCV(
    ...     kernels=["matern32", "wendland_c4"],
    ...     betas=[0.5, 2.0, 8.0],
    ...     cv=TrajectoryKFold(5),
    ... ).fit(pendulum.X, pendulum.y, groups=pendulum.groups)
    >>> model.best_kernel_, model.best_beta_
    ('wendland_c4', 8.0)
    """

    # Asks for `groups` under metadata routing without a set_fit_request.
    __metadata_request__fit = {"groups": True}

    def __init__(
        self,
        kernels: Sequence[Any] = ("matern32",),
        betas: Sequence[float | None] | None = (0.1, 1.0, 10.0),
        alphas: Sequence[float] = (0.0,),
        *,
        centers: Any = None,
        method: str = "interpolation",
        trend: str | None = None,
        solver: str = "auto",
        scoring: Any = None,
        cv: Any = None,
        n_jobs: int | None = None,
    ) -> None:
        self.kernels = kernels
        self.betas = betas
        self.alphas = alphas
        self.centers = centers
        self.method = method
        self.trend = trend
        self.solver = solver
        self.scoring = scoring
        self.cv = cv
        self.n_jobs = n_jobs

    def fit(self, X: Any, y: Any, groups: Any = None) -> KoopmanKernelRegressorCV:
        """Choose kernel, scale and weight, and fit the estimate to all rows.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.
        groups : array-like of shape (n_samples,), default=None
            The trajectory of each row, for splitters that ask for it.

        Returns
        -------
        self : KoopmanKernelRegressorCV
            The fitted estimate.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if a fold has no training row, no
            test row or, for interpolation, no centre; if no candidate has a score.

        Warns
        -----
        FitFailedWarning
            If some candidates have no estimate on all folds.
        LinAlgWarning
            If the winner has lost dependent centres, and that may matter.
        """
        given = X
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        self._check_parameters()
        kernels, betas = list(self.kernels), self._betas()
        alphas = [float(alpha) for alpha in self.alphas]
        candidates = [
            as_kernel(kernel, beta, X.shape[1])
            for kernel, beta in product(kernels, betas)
        ]
        scorer = check_scoring(HeldOut(), scoring=self.scoring)
        folds = self._folds(X, y, groups)
        centers = self.centers
        if hasattr(centers, "fit") and not isinstance(centers, type):
            # Fitted once: the winner has the centres that it was chosen with.
            centers = FrozenEstimator(clone(centers).fit(X, y))
        outputs = y.reshape(len(y), -1)
        search = Search.of(
            X,
            outputs,
            centers,
            folds,
            interpolates=self.method == "interpolation",
            degree=DEGREES[self.trend],
            drop_dependent=self.solver != "cholesky",
        )
        if search.interpolates:
            self._check_folds(search)
        radial = any(isinstance(kernel, RadialKernel) for kernel in candidates)
        distances = search.distances() if radial else None

        run = partial(self._scored, search, scorer, y, alphas, distances)
        if effective_n_jobs(self.n_jobs) == 1:
            scored = [run(kernel) for kernel in candidates]
        else:
            with one_thread():
                scored = Parallel(n_jobs=self.n_jobs, prefer="threads")(
                    delayed(run)(kernel) for kernel in candidates
                )
        params, outcomes = [], []
        # In the order of GridSearchCV, so that it chooses among equals as that does.
        for (a, alpha), (b, beta), (k, kernel) in product(
            enumerate(alphas), enumerate(betas), enumerate(kernels)
        ):
            params.append({"alpha": alpha, "beta": beta, "kernel": kernel})
            outcomes.append(scored[k * len(betas) + b][a])
        results, failed = tabulated(params, outcomes, pooled=self.cv is None)
        if failed:
            warnings.warn(
                f"{len(failed)} of {len(params)} candidates have no estimate on all "
                f"folds and the score nan: {'; '.join(failed)}",
                FitFailedWarning,
                stacklevel=2,
            )
        best = int(results["rank_test_score"].argmin())
        estimator = KoopmanKernelRegressor(
            **params[best],
            centers=centers,
            method=self.method,
            trend=self.trend,
            solver=self.solver,
            n_jobs=self.n_jobs,
        ).fit(given, y)
        # Attributes are set last: a fit that fails leaves the estimator as it was.
        validate_data(self, given, y, skip_check_array=True)
        self.__dict__.pop("trend_coef_", None)
        self.cv_results_ = results
        self.best_index_ = best
        self.best_kernel_ = params[best]["kernel"]
        self.best_beta_ = params[best]["beta"]
        self.best_alpha_ = params[best]["alpha"]
        self.best_score_ = float(results["mean_test_score"][best])
        self.best_estimator_ = estimator
        for name in _COPIED:
            if hasattr(estimator, name):
                setattr(self, name, getattr(estimator, name))
        return self

    def predict(self, X: Any, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Predict the outputs one step after each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        return_std : bool, default=False
            Whether to return a standard deviation with each prediction.

        Returns
        -------
        y : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            The predicted outputs.
        std : ndarray of the shape of `y`
            Standard deviation of the outputs, as
            :meth:`KoopmanKernelRegressor.predict` gives it; only if `return_std`.
        """
        X = self._validated(X)
        return self.best_estimator_.predict(X, return_std=return_std)

    def power_function(self, X: Any) -> Array:
        """Evaluate the power function, which bounds the error of interpolation.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        power : ndarray of shape (n_samples,)
            As :meth:`KoopmanKernelRegressor.power_function` gives it.
        """
        X = self._validated(X)
        return self.best_estimator_.power_function(X)

    def error_bound(self, X: Any, norm: Any = None) -> Array:
        """Bound the error of the prediction at each state.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        norm : float or array-like of shape (n_outputs,), default=None
            The native norm of the outputs as functions of the state one step before;
            None estimates it.

        Returns
        -------
        bound : ndarray of shape (n_samples,) or (n_samples, n_outputs)
            As :meth:`KoopmanKernelRegressor.error_bound` gives it.
        """
        X = self._validated(X)
        return self.best_estimator_.error_bound(X, norm)

    def _validated(self, X: Any) -> Array:
        check_is_fitted(self)
        return validate_data(self, X, reset=False, dtype=np.float64)

    def _betas(self) -> list[float | None]:
        return [None] if self.betas is None else list(self.betas)

    def _check_parameters(self) -> None:
        if isinstance(self.centers, str):
            raise ValueError(
                f"centers must be None, an array or a selector, got {self.centers!r}; "
                "the folds need the states themselves, not distances."
            )
        for name in ("kernels", "betas", "alphas"):
            values = getattr(self, name)
            if name == "betas" and values is None:
                continue
            if isinstance(values, str) or not isinstance(values, Iterable):
                raise ValueError(f"{name} must be a list of values, got {values!r}.")
            if not len(list(values)):
                raise ValueError(
                    f"{name} must hold at least one value, got {values!r}."
                )
        for alpha in self.alphas:
            check_number(alpha, "alphas")
        for beta in self._betas():
            if beta is not None:
                check_number(beta, "betas", positive=True)
        # The other parameters are those of the regressor, which checks them.
        KoopmanKernelRegressor(
            method=self.method, trend=self.trend, solver=self.solver
        )._check_parameters()

    def _folds(self, X: Array, y: Array, groups: Any) -> list[Fold]:
        if self.cv is None:
            if len(X) < 2:
                raise ValueError(
                    "cv=None leaves one row out after the other, which needs at least "
                    f"2, but n_samples = {len(X)}; use KoopmanKernelRegressor."
                )
            splits = LeaveOneOut().split(X)
        else:
            splits = check_cv(self.cv, y, classifier=False).split(X, y, groups)
        folds = []
        every = np.arange(len(X))
        for i, (train, test) in enumerate(splits):
            fold = Fold.of(every[train], every[test], len(X))
            n_train = len(X) - len(fold.out)
            if not n_train or not len(fold.test):
                raise ValueError(
                    f"cv={self.cv!r} gives fold {i} {n_train} training rows and "
                    f"{len(fold.test)} test rows; each needs at least one."
                )
            if n_train < len(every[train]):
                raise ValueError(
                    f"cv={self.cv!r} repeats rows in the training part of fold {i}; "
                    "name every row at most once."
                )
            folds.append(fold)
        if not folds:
            raise ValueError(f"cv={self.cv!r} gives no folds.")
        return folds

    def _scored(
        self,
        search: Search,
        scorer: Any,
        y: Array,
        alphas: list[float],
        distances: tuple[Array, float] | None,
        kernel: Any,
    ) -> list[Outcome]:
        """Return the scores of a kernel for every alpha, or why there are none."""
        outcomes = search.predictions(kernel, alphas, distances)
        for i, held_out in enumerate(outcomes):
            if isinstance(held_out, ValueError):
                continue
            if self.cv is not None:
                outcomes[i] = scores_of_folds(scorer, search.folds, held_out, y)
            elif self.scoring is None:
                outcomes[i] = -np.square(held_out - search.y).mean(axis=1)
            else:
                every = np.arange(len(y))
                outcomes[i] = scores_of_folds(scorer, [Fold(every, every)], held_out, y)
        return outcomes

    def _check_folds(self, search: Search) -> None:
        for i, fold in enumerate(search.folds):
            if not (search.label[search.train(fold)] >= 0).any():
                raise ValueError(
                    f"cv={self.cv!r} leaves no centre among the training rows of fold "
                    f"{i}; choose more centres than {len(search.points)}, or smaller "
                    "folds."
                )


_COPIED = (
    "kernel_",
    "center_indices_",
    "centers_",
    "dual_coef_",
    "trend_coef_",
    "signal_std_",
    "noise_std_",
    "rcond_",
)
