"""How far stated standard deviations agree with errors."""

from inspect import signature
from numbers import Integral
from typing import Any

import numpy as np
from scipy.special import ndtri
from sklearn.base import clone
from sklearn.model_selection import check_cv
from sklearn.utils import Bunch, indexable

from .._utils._pipeline import transformed, unwrap
from .._utils._typing import Array
from .._utils._validation import check_integer, check_positive, refuse_masked
from ..trajectories import TrajectoryKFold, find_trials


def calibration_study(
    estimator: Any,
    X: Any,
    y: Any,
    *,
    groups: Any = None,
    cv: Any = None,
    levels: Any = (0.5, 0.68, 0.9, 0.95, 0.99),
) -> Bunch:
    """Measure whether the stated standard deviations hold on held-out trajectories.

    Parameters
    ----------
    estimator : estimator
        A :class:`~sklearn_koopman.KoopmanKernelRegressor`, or any other whose
        `predict` has the parameter `return_std`; or a pipeline that ends in one; or a
        search of either, to which `groups` are passed. It is not changed.
    X : array-like of shape (n_samples, n_features)
        The states.
    y : array-like of shape (n_samples,) or (n_samples, n_outputs)
        Their outputs one step later.
    groups : array-like of shape (n_samples,), default=None
        The trajectory of each row, so that whole trajectories are left out. None takes
        the level "trial" of the index of X, else of y, where `cv` is None or an int.
    cv : int, cross-validation generator or iterable, default=None
        How rows are left out. An integer is the number of folds of
        :class:`~sklearn_koopman.TrajectoryKFold`; None means up to five.
    levels : array-like of shape (n_levels,)
        Probabilities of the central intervals of a normal distribution.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        level : ndarray of shape (n_levels,)
            The probabilities.
        coverage : ndarray of shape (n_levels,)
            The fraction of the held-out outputs that lie in the intervals.
        fold_coverage : ndarray of shape (n_folds, n_levels)
            The same for each fold.
        ratio : float
            Root mean square of the errors divided by their stated standard deviations.
            It is 1 if the deviations are right. Otherwise it is the factor by which to
            multiply the deviations.
        fold_ratio : ndarray of shape (n_folds,)
            The same for each fold.

    Raises
    ------
    ValueError
        If the estimator states no standard deviations, or levels are not between 0
        and 1.

    Notes
    -----
    Rows along a trajectory are similar, so that the number of folds matters more than
    the number of rows. Let each fold be another subject or speed. If `fold_ratio`
    varies much from fold to fold, then `ratio` is uncertain.

    The cost is one fit for each fold.

    Examples
    --------
    The motion of pendulums is smoother than a typical function of this kernel, so that
    the stated deviations are too large:

    >>> from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.diagnostics import calibration_study
    >>> pendulums = make_pendulum(
    ...     100, initial="random", n_trajectories=20, noise=0.01, random_state=0
    ... )
    >>> model = KoopmanKernelRegressor(
    ...     beta=5.0,
    ...     centers=SeparatedCenterSelector(0.4),
    ...     method="least_squares",
    ...     alpha=1e-4,
    ... )
    >>> study = calibration_study(
    ...     model, pendulums.X, pendulums.y, groups=pendulums.groups
    ... )
    >>> round(study.ratio, 1)
    0.7
    """
    refuse_masked(X=X, y=y)
    X, y, groups = indexable(X, y, groups)
    levels = check_positive(levels, "levels")
    if levels.max() >= 1:
        raise ValueError(f"levels must lie between 0 and 1, got {levels.max():g}.")
    if groups is None and (cv is None or isinstance(cv, Integral)):
        groups = find_trials(X, y)
    if cv is None:
        cv = 5 if groups is None else min(5, len(np.unique(groups)))
    if isinstance(cv, Integral):
        check_integer(cv, "cv (at most the number of trajectories)", 2)
        cv = TrajectoryKFold(int(cv))
    limits = ndtri((1 + levels) / 2)
    y = np.asarray(y, dtype=np.float64)
    scaled = []  # errors over standard deviations, an array a fold
    for train, test in check_cv(cv).split(X, y, groups):
        model = clone(estimator)
        is_search = groups is not None and hasattr(model, "refit")
        inner = {"groups": np.asarray(groups)[train]} if is_search else {}
        model.fit(_rows(X, train), y[train], **inner)
        final, front = unwrap(model)
        if "return_std" not in signature(final.predict).parameters:
            raise ValueError(
                f"{type(final).__name__}.predict has no return_std; pass an estimator "
                "that states standard deviations."
            )
        states = transformed(front, _rows(X, test))
        mean, std = (np.reshape(v, -1) for v in final.predict(states, return_std=True))
        missed = np.abs(y[test].ravel() - mean)
        # No error is right for any standard deviation, zero included.
        with np.errstate(divide="ignore"):
            scaled.append(np.divide(missed, std, out=0 * missed, where=missed > 0))
    coverage, ratio = _agreement(np.concatenate(scaled), limits)
    folds = [_agreement(fold, limits) for fold in scaled]
    return Bunch(
        level=levels,
        coverage=coverage,
        fold_coverage=np.array([fold[0] for fold in folds]),
        ratio=ratio,
        fold_ratio=np.array([fold[1] for fold in folds]),
    )


def _agreement(scaled: Array, limits: Array) -> tuple[Array, float]:
    """Return the coverage at the limits and the root mean square of scaled errors."""
    covered = np.less_equal.outer(scaled, limits).mean(axis=0)
    return covered, float(np.sqrt(np.mean(scaled**2)))


def _rows(X: Any, rows: Any) -> Any:
    return X.iloc[rows] if hasattr(X, "iloc") else np.asarray(X)[rows]
