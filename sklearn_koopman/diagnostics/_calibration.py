"""Whether stated standard deviations hold."""

from __future__ import annotations

from inspect import signature
from numbers import Integral
from typing import Any

import numpy as np
from scipy.special import ndtri
from sklearn.base import clone
from sklearn.model_selection import check_cv
from sklearn.utils import Bunch, indexable

from sklearn_koopman._utils._pipeline import transformed, unwrap
from sklearn_koopman._utils._validation import check_positive
from sklearn_koopman.trajectories import TrajectoryKFold


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
        `predict` has `return_std`, or a pipeline that ends in one, or a search of
        either, which gets `groups` as well. It is not changed.
    X : array-like of shape (n_samples, n_features)
        The states.
    y : array-like of shape (n_samples,) or (n_samples, n_outputs)
        Their outputs one step later.
    groups : array-like of shape (n_samples,), default=None
        The trajectory of each row, so that whole ones are left out.
    cv : int, cross-validation generator or iterable, default=None
        How rows are left out. A number is that of the folds of
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
            How many of the held-out outputs, as a fraction, lie in the intervals.
        fold_coverage : ndarray of shape (n_folds, n_levels)
            The same for each fold.
        ratio : float
            Root mean square of errors over their stated standard deviations: 1 if
            these are right, and what to multiply them by if not.
        fold_ratio : ndarray of shape (n_folds,)
            The same for each fold.

    Raises
    ------
    ValueError
        If the estimator states no standard deviations, or levels are not between 0
        and 1.

    Notes
    -----
    Rows along a trajectory are alike: a fold that stands for another subject or speed
    tells more than thousands of rows, and the spread of `fold_ratio` how little is
    known from few folds.

    Examples
    --------
    Pendulums swing more smoothly than the kernel makes believe; the deviations are too
    wide:

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
    X, y, groups = indexable(X, y, groups)
    levels = check_positive(levels, "levels")
    if levels.max() >= 1:
        raise ValueError(f"levels must lie between 0 and 1, got {levels.max():g}.")
    if cv is None:
        cv = 5 if groups is None else min(5, len(np.unique(groups)))
    if isinstance(cv, Integral):
        if cv < 2:
            raise ValueError(
                f"cv={cv} leaves nothing to learn from; give groups of two "
                "trajectories at least, or a splitter that leaves out parts of one."
            )
        cv = TrajectoryKFold(int(cv))
    limits = ndtri((1 + levels) / 2)
    y = np.asarray(y, dtype=np.float64)
    scaled = []  # errors over standard deviations, an array a fold
    for train, test in check_cv(cv).split(X, y, groups):
        model = clone(estimator)
        inner = {}
        if groups is not None and hasattr(model, "refit"):
            inner["groups"] = np.asarray(groups)[train]
        model.fit(_rows(X, train), y[train], **inner)
        final, front = unwrap(model)
        if "return_std" not in signature(final.predict).parameters:
            raise ValueError(
                f"{type(final).__name__}.predict has no return_std; calibration is "
                "that of stated standard deviations."
            )
        states = transformed(front, _rows(X, test))
        mean, std = final.predict(states, return_std=True)
        missed = np.abs(y[test] - np.reshape(mean, y[test].shape)).reshape(-1, 1)
        std = np.reshape(std, (-1, 1))
        # No error is within any standard deviation, zero included.
        with np.errstate(divide="ignore"):
            scaled.append(np.divide(missed, std, out=0 * missed, where=missed > 0))
    together = np.concatenate(scaled)
    return Bunch(
        level=levels,
        coverage=(together <= limits).mean(axis=0),
        fold_coverage=np.array([(z <= limits).mean(axis=0) for z in scaled]),
        ratio=float(np.sqrt(np.mean(together**2))),
        fold_ratio=np.array([np.sqrt(np.mean(z**2)) for z in scaled]),
    )


def _rows(X: Any, rows: Any) -> Any:
    return X.iloc[rows] if hasattr(X, "iloc") else np.asarray(X)[rows]
