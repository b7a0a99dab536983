"""Cross-validated choice of the kernel, its scale and the weight of the penalty."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from itertools import product
from typing import Any, Self

import numpy as np
from joblib import effective_n_jobs
from scipy.linalg import LinAlgWarning
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.exceptions import FitFailedWarning
from sklearn.frozen import FrozenEstimator
from sklearn.gaussian_process.kernels import Kernel
from sklearn.metrics import check_scoring
from sklearn.model_selection import LeaveOneOut, check_cv
from sklearn.utils import check_X_y
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted

from ._linalg._fit import check_trend_determined
from ._linalg._systems import METHODS, SOLVERS
from ._matrices._polynomial import DEGREES
from ._regression._candidates import (
    IdentityRegressor,
    Problem,
    Split,
    negative_squared_errors,
    score_kernel,
    tabulate,
)
from ._utils._parallel import one_thread
from ._utils._rows import distinct_rows, drop_absent, spread
from ._utils._storage import StoresCentersOnce
from ._utils._typing import Array, Indices
from ._utils._validation import check_number, check_parameters, refuse_masked
from ._utils._warnings import ExtrapolationWarning, warn
from .centers import choose_centers, fit_selector
from .kernels import RadialKernel, as_kernel
from .regression import KoopmanKernelRegressor

__all__ = ["KoopmanKernelRegressorCV"]

# The scales that kernels given by name are tried with, in units of the spread.
MULTIPLES = (0.3, 1.0, 3.0, 10.0)


class KoopmanKernelRegressorCV(
    StoresCentersOnce, MultiOutputMixin, RegressorMixin, BaseEstimator
):
    """Kernel estimate of the Koopman operator with built-in cross-validation.

    This estimator chooses the kernel, its scale `beta` and the weight `alpha` of a
    :class:`KoopmanKernelRegressor` by the errors of its predictions of held-out rows,
    and fits the winner to all rows. The scores are those of a
    :class:`~sklearn.model_selection.GridSearchCV` with the same centres, but the
    held-out predictions come from a closed form: one factorisation for each kernel,
    scale and weight serves all folds.

    Parameters
    ----------
    kernels : sequence of str or Kernel, default=("matern32",)
        The kernels to choose from. Each is a `kernel` of
        :class:`KoopmanKernelRegressor`.
    betas : sequence of (float, "scale" or None), default=None
        The scales to choose from, in the unit of the states. "scale" and None mean
        what they do for the `beta` of :class:`KoopmanKernelRegressor`; the spread is
        that of all rows. By default each kernel given by name is tried with 0.3, 1, 3
        and 10 times the spread of the states (the square root of the sum of the
        variances of the columns of `X`), and each kernel object with its own scale.
        Kernels that are not of :mod:`sklearn_koopman.kernels` take no numbers.
    alphas : sequence of float, default=(0.0,)
        The weights of the squared native norm (the norm of the function space that
        belongs to the kernel) to choose from.
    centers : None, array-like of shape (n_centers, n_features) or estimator, \
default=None
        The centres of the kernel sections (the functions k(., center)), as in
        :class:`KoopmanKernelRegressor`. An estimator is fitted once, to all rows, and
        every fold uses its centres. Interpolation needs the outputs of its centres,
        and therefore uses those centres that are training rows of the fold.
    method : {"interpolation", "least_squares"}, default="interpolation"
        Whether the estimate interpolates the outputs at the centres or fits the
        outputs of all rows.
    trend : {None, "constant", "linear"}, default=None
        Polynomial that is estimated together with the kernel part.
    solver : {"auto", "pivoted_cholesky", "cholesky"}, default="auto"
        What happens where the matrix of the centres is not numerically positive
        definite. "cholesky" lets the candidate fail. The others leave out centres
        that are linearly dependent on the others; all folds then use the centres
        that an estimate from all rows would keep. Held-out predictions always come
        from dense matrices; only the winner is fitted with `solver` as it is.
    scoring : str or callable, default=None
        How held-out predictions are scored; larger is better. A name or a scorer of
        scikit-learn. The scorer gets an estimator that returns the held-out
        predictions, and the weights of the rows if it, or its metric, has the parameter
        `sample_weight` (whatever it requests under metadata routing); others score all
        rows alike. None means the negative mean squared error for leave-one-out, in
        the squared unit of the outputs, and otherwise R^2, averaged over the outputs.
    cv : int, cross-validation splitter or iterable, default=None
        How rows are held out.

        - None: one row at a time (leave-one-out). The predictions of all rows are
          scored together. Neighbours on a trajectory have similar outputs, so that
          these scores are too good unless the rows are independent.
        - int: that many folds of consecutive rows.
        - a splitter, such as :class:`~sklearn_koopman.TrajectoryKFold`, or an
          iterable of pairs of training and test rows. Every fold is scored, and the
          scores are averaged.
    n_jobs : int, default=None
        Number of threads. `fit` distributes the kernels and scales among them, each
        with matrices of its own, and limits BLAS to one thread; `predict` distributes
        the rows. None means 1 unless in a :obj:`joblib.parallel_config` context, and
        leaves BLAS its own threads, which is faster in `fit` where SciPy's LAPACK
        uses a lock. -1 means all processors.

    Attributes
    ----------
    best_kernel_ : str or Kernel
        The chosen kernel, as given in `kernels`.
    best_beta_ : float or None
        The chosen scale in the unit of the states, a number also for "scale". None if
        so given in `betas`, or if the kernel has no scale of its own, such as a sum.
    best_alpha_ : float
        The chosen weight.
    best_score_ : float
        The score of the winner: of all rows for leave-one-out, and otherwise the mean
        over the folds.
    best_index_ : int
        The place of the winner in the arrays of `cv_results_`.
    best_estimator_ : KoopmanKernelRegressor
        The winner, fitted to all rows.
    cv_results_ : dict of ndarrays
        The scores of all candidates in the format of
        :class:`~sklearn.model_selection.GridSearchCV`, for example for a
        `pandas.DataFrame`: "params", "param_kernel", "param_beta" (like
        `best_beta_`), "param_alpha", "mean_test_score", "std_test_score",
        "rank_test_score", and "split0_test_score" and so on except for leave-one-out.
        The score of a candidate without an estimate is nan.
    center_indices_ : ndarray of shape (n_centers,) or None
        The rows of `X` that are centres, as in `best_estimator_`; None if the centres
        are not known to be rows.
    centers_ : ndarray of shape (n_centers, n_features)
        The centres, in the unit of the states.
    dual_coef_ : ndarray of shape (n_centers,) or (n_centers, n_outputs)
        Coefficients of the kernel sections, in the unit of the outputs.
    trend_coef_ : ndarray of shape (1 + n_features,) or (1 + n_features, n_outputs)
        Coefficients of the polynomial. Only with a `trend`; only the constant for
        ``trend="constant"``.
    kernel_ : Kernel
        The kernel, with its scale and dimension.
    signal_std_ : float or ndarray of shape (n_outputs,)
        Scale of the outputs in terms of the kernel, in the unit of the outputs.
    noise_std_ : float or ndarray of shape (n_outputs,)
        Standard deviation of the outputs about the estimate, in their unit.
    rcond_ : float
        Estimate of the reciprocal condition number of the matrix that the winner has
        factored. Not with conjugate gradients.
    solver_ : str or ConjugateGradient
        How the winner was solved. `n_iter_` and `solver_residual_` of conjugate
        gradients are there, too.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, if `X` had names that are strings.

    See Also
    --------
    KoopmanKernelRegressor : The estimate itself; its attributes are described there.
    sklearn_koopman.TrajectoryKFold : Holds out whole trajectories, or blocks of one.
    sklearn.linear_model.RidgeCV : The same for linear models, with leave-one-out.

    Notes
    -----
    *Interpolation.* Let K be the matrix of the kernel at the centres, u their outputs
    and A = (K + alpha I)^-1; with a trend, A is the upper left block of the inverse
    of the matrix that is bordered by the polynomials. The residuals of the centres S
    in a fold, predicted by the other centres, are

    .. math:: u_S - \\hat u_S = (A_{SS})^{-1} (A u)_S

    ([1]_ for single rows; [4]_, Section 5.4.2). The Cholesky factor of K + alpha I is
    inverted once for each alpha, and gives A_SS for all folds.

    *Least squares.* The basis functions are orthonormal in the native space of the
    kernel. With their values F on all rows and the penalty matrix E, the normal
    matrix is F F^T + E and the hat matrix, which takes outputs to fitted values, is
    H = F^T (F F^T + E)^-1 F. A fold is predicted from the smaller of two systems. If
    it leaves out more than M / 4 rows, the normal matrix of the other rows is summed
    up and factored. Otherwise the residuals of the rows S that it leaves out are

    .. math:: y_S - \\hat y_S = (I - H_{SS})^{-1} (y - H y)_S,

    Allen's PRESS [3]_, which [2]_ compares with its rotation-invariant form.

    *Weights.* With the `sample_weight` w of the rows, `alpha` over w is on the diagonal
    of K, and for least squares the columns of F and the outputs are multiplied by the
    roots of w. Leave-one-out holds out a row with all of its weight.

    *Refits.* A fold is predicted by a refit of the regressor where the closed form
    does not apply or is not accurate enough: if some of several equal rows that are
    one centre are held out, if least squares tests a row that it has learned from, if
    the training rows do not determine the trend or the coefficients, or if rounding
    may change more than 1e-9 of the residuals of a fold (of a small one, for least
    squares).

    *Centres.* A selector is fitted once to all rows, so the centres depend on the
    states (not the outputs) of the held-out rows. For interpolation, a fold drops the
    centres that it holds out; the scores are therefore slightly lower than those of a
    `GridSearchCV`, which selects new centres in each fold. If the matrix of the
    centres is numerically singular, the closed form uses the centres that the
    regressor keeps on all rows. A refit might keep others, and its score differ.

    *Costs.* With M centres and n rows, interpolation takes O(M^3) time for each
    kernel, scale and alpha, and O(M |S|^2) for each fold. Least squares takes
    O(n M^2) time for each kernel and scale; each alpha adds O(M^3) for every fold
    that leaves out more than M / 4 rows, and O(n M^2) for all others together. A
    refit takes the time of a fit. Memory is one matrix of n x M (M x M for
    interpolation where every row is a centre) and up to five of M x M, or up to 16 for
    least squares with large folds that overlap; least squares takes two more of
    n x M. Each thread has its own.

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
        betas: Sequence[float | str | None] | None = None,
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

    def fit(
        self, X: Any, y: Any, groups: Any = None, *, sample_weight: Any = None
    ) -> Self:
        """Choose kernel, scale and weight, and fit the estimate to all rows.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each row.
        groups : array-like of shape (n_samples,), default=None
            The trajectory of each row, for splitters that ask for it.
        sample_weight : array-like of shape (n_samples,), default=None
            How much each row counts, as in :class:`KoopmanKernelRegressor`, in the
            estimates of the folds and in the scores. Rows of weight 0 are absent from
            the folds, which are made of all rows. None means 1 for every row.

        Returns
        -------
        self : KoopmanKernelRegressorCV
            The fitted estimate.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if weights are negative, or all of
            them zero; if a fold has no training row, no test row or, for
            interpolation, no centre; if no candidate has a score.

        Warns
        -----
        FitFailedWarning
            If some candidates have no estimate on all folds.
        LinAlgWarning
            If the winner has lost dependent centres, and that may matter.
        ConvergenceWarning
            If conjugate gradients, which ``solver="auto"`` takes for a winner with
            many centres, have not reached their tolerance.
        """
        given, given_y = X, y
        refuse_masked(X=X, y=y)
        X, y = check_X_y(
            X, y, multi_output=True, y_numeric=True, dtype=np.float64, estimator=self
        )
        y = np.asarray(y, dtype=np.float64)
        grid = self._grid()
        # A DataFrame as it was given: its index may tell the trials.
        rows = given if hasattr(given, "iloc") else X
        targets = given_y if hasattr(given_y, "iloc") else y
        every_y = y
        weights, numbers, X, y = drop_absent(sample_weight, X, y)
        splits = self._splits(rows, targets, groups, numbers)
        pairs, kernels = self._kernels(grid, X, weights)
        scorer = check_scoring(IdentityRegressor(), scoring=self.scoring or "r2")
        by_row = self.cv is None and self.scoring is None
        if by_row:
            scorer = negative_squared_errors
        centers, points = self.centers, X
        if hasattr(centers, "fit") and not isinstance(centers, type):
            # Fitted once: the winner has the centres that it was chosen with.
            centers = FrozenEstimator(fit_selector(centers, X, y, weights))
        if centers is not None:
            among_rows = self.method == "interpolation"
            points, _ = choose_centers(centers, X, y, among_rows=among_rows)
        points = points[distinct_rows(points)[0]]
        if self.method == "least_squares" and centers is not None:
            check_trend_determined(DEGREES[self.trend], X, points)
        regressor = KoopmanKernelRegressor(
            method=self.method, trend=self.trend, solver=self.solver
        )
        problem = Problem(X, y, points, splits, regressor, centers is None, weights)
        for i, fold in enumerate(problem.folds if problem.interpolates else ()):
            if len(fold.out) == len(points):
                raise ValueError(
                    f"cv={self.cv!r} holds out all centres in fold {i}; choose more "
                    f"centres than {len(points)}, or smaller folds."
                )
        share = problem, grid["alpha"], scorer, self.cv is None
        with warnings.catch_warnings():
            # Refits may lose dependent centres, or digits to weights; the winner warns
            # if it does. Held-out rows that a kernel does not reach show in its score.
            warnings.filterwarnings("ignore", "sample_weight")
            warnings.simplefilter("ignore", LinAlgWarning)
            warnings.simplefilter("ignore", ExtrapolationWarning)
            many = effective_n_jobs(self.n_jobs) > 1
            with one_thread() if many else nullcontext():
                scored = Parallel(n_jobs=self.n_jobs, prefer="threads")(
                    delayed(score_kernel)(kernel, *share) for kernel in kernels
                )
        # In the order of GridSearchCV if scales are given: ties are decided as there.
        params = [
            {"alpha": alpha, "beta": beta, "kernel": kernel}
            for alpha in grid["alpha"]
            for beta, kernel in pairs
        ]
        outcomes = [own[a] for a in range(len(grid["alpha"])) for own in scored]
        results, failed = tabulate(
            params, outcomes, self.cv is not None, weights if by_row else None
        )
        if failed:
            warn(
                f"{len(failed)} of {len(params)} candidates have no estimate on all "
                f"folds and the score nan: {'; '.join(failed)}",
                FitFailedWarning,
            )
        best = int(results["rank_test_score"].argmin())
        regressor.set_params(**params[best], centers=centers, n_jobs=self.n_jobs)
        estimator = regressor.fit(given, every_y, sample_weight)
        # Attributes are set last: a fit that fails leaves the estimator as it was.
        kept = {k: v for k, v in vars(self).items() if not k.endswith("_")}
        fitted = {k: v for k, v in vars(estimator).items() if k.endswith("_")}
        self.__dict__ = kept | fitted
        self.cv_results_ = results
        self.best_index_ = best
        self.best_kernel_ = params[best]["kernel"]
        self.best_beta_ = params[best]["beta"]
        self.best_alpha_ = params[best]["alpha"]
        self.best_score_ = float(results["mean_test_score"][best])
        self.best_estimator_ = estimator
        return self

    @property
    def rcond_(self) -> float:
        """Reciprocal condition number of the matrix that the winner has factored.

        Returns
        -------
        rcond : float
            As `best_estimator_` gives it; none with conjugate gradients.
        """
        return float(self.best_estimator_.rcond_)

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

        Warns
        -----
        ExtrapolationWarning
            If a state is far from all training data.
        """
        check_is_fitted(self)
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
        check_is_fitted(self)
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
        check_is_fitted(self)
        return self.best_estimator_.error_bound(X, norm)

    def _grid(self) -> dict[str, list[Any]]:
        """Check the parameters, and return those to choose from."""
        if isinstance(self.centers, str):
            raise ValueError(
                f"centers must be None, an array or a selector, got {self.centers!r}; "
                "the folds need the states themselves, not distances."
            )
        grid: dict[str, Any] = {"alpha": self.alphas, "kernel": self.kernels}
        if self.betas is not None:
            grid["beta"] = self.betas
        for name, values in grid.items():
            is_list = isinstance(values, Iterable) and not isinstance(values, str)
            grid[name] = list(values) if is_list else []
            if not grid[name]:
                raise ValueError(f"{name}s must be a non-empty list, got {values!r}.")
        for alpha in grid["alpha"]:
            check_number(alpha, "alphas")
        grid["alpha"] = [float(alpha) for alpha in grid["alpha"]]
        check_parameters(self, method=METHODS, trend=DEGREES, solver=SOLVERS)
        return grid

    def _kernels(
        self, grid: dict[str, list[Any]], X: Array, weights: Array | None
    ) -> tuple[list[tuple[Any, Any]], list[Kernel]]:
        """Return the scale and the given kernel of each candidate, and both in one."""
        scale = spread(X, weights)
        if self.betas is None:
            multiples = [multiple * scale for multiple in MULTIPLES]
            pairs: list[tuple[Any, Any]] = [
                (beta, kernel)
                for kernel in grid["kernel"]
                for beta in (multiples if isinstance(kernel, str) else ["scale"])
            ]
        else:
            pairs = list(product(grid["beta"], grid["kernel"]))
        kernels = [as_kernel(kernel, beta, X.shape[1], scale) for beta, kernel in pairs]
        for i, own in enumerate(kernels):
            if pairs[i][0] == "scale":  # results hold numbers
                beta = own.beta if isinstance(own, RadialKernel) else None
                pairs[i] = beta, pairs[i][1]
        return pairs, kernels

    def _splits(self, X: Any, y: Any, groups: Any, present: Indices) -> list[Split]:
        """Divide all rows, and number those of the folds among the present ones."""
        cv = LeaveOneOut() if self.cv is None else self.cv
        splits: list[Split] = []
        place = np.full(len(X), -1)
        place[present] = np.arange(len(present))
        for train, test in check_cv(cv, y).split(X, y, groups):
            train, test = (rows[rows >= 0] for rows in (place[train], place[test]))
            if self.cv is None and not len(test):
                continue
            out = np.delete(np.arange(len(present)), train)
            n_train = len(present) - len(out)
            if not n_train or not len(test) or n_train < len(train):
                absent = " (rows of weight 0 are absent)"
                raise ValueError(
                    f"Fold {len(splits)} of cv={self.cv!r} has {len(test)} test rows "
                    f"and {len(train)} training rows, of which {n_train} are distinct"
                    f"{absent if len(present) < len(X) else ''}; a fold needs both, "
                    "and no training row twice."
                )
            splits.append(Split(out, test))
        if not splits:
            raise ValueError(f"cv={self.cv!r} gives no folds.")
        return splits
