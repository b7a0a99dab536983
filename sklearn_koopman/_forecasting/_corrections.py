"""Fits of the estimators that a forecaster is given, and their predictions."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn import config_context
from sklearn.base import clone
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import has_fit_parameter

from .._utils._pipeline import find_operator, transformed
from .._utils._typing import Array, Indices
from .._utils._warnings import ExtrapolationWarning


class Rows(NamedTuple):
    """Rows to learn from.

    Attributes
    ----------
    features : ndarray of shape (n_rows, n_features)
        The states with their past, and more.
    values : ndarray of shape (n_rows, n_values)
        What is learned.
    groups : ndarray of shape (n_rows,)
        The number of the recording of each row.
    sample_index : ndarray of shape (n_rows,)
        The place of each row on its recording, for operators.
    """

    features: Array
    values: Array
    groups: Indices
    sample_index: Indices

    @property
    def n_values(self) -> int:
        """The number of values of a row."""
        return self.values.shape[1]

    def take(self, rows: Any) -> Rows:
        """Return some of the rows."""
        return Rows(*(part[rows] for part in self))


class Ahead(NamedTuple):
    """What is predicted of each row.

    Attributes
    ----------
    steps : ndarray of shape (n_horizons,)
        The horizons, in steps of an operator; else only their number counts.
    n_outputs : int
        The number of outputs at each of them.
    """

    steps: Indices
    n_outputs: int


def last_step(estimator: Any) -> tuple[str, Any]:
    """Return the last step of nested pipelines, and the prefix of its parameters."""
    prefix = ""
    while isinstance(estimator, Pipeline):
        name, estimator = estimator.steps[-1]
        prefix += f"{name}__"
    return prefix, estimator


def is_operator(estimator: Any) -> bool:
    """Whether an estimator forecasts by the powers of an operator."""
    return hasattr(last_step(estimator)[1], "forecast")


def refuse_searches_of_operators(estimator: Any) -> None:
    """Refuse what could not give an operator the places of the rows."""
    final = last_step(estimator)[1]
    if is_operator(getattr(final, "estimator", None)):
        raise ValueError(
            f"estimator is a {type(final).__name__} of an operator; pass the operator "
            "itself, and search over its parameters with the forecaster inside."
        )


def is_search(estimator: Any) -> bool:
    """Whether `fit` takes groups, for the splitter of a search."""
    # scikit-learn's searches take them among their **params.
    return hasattr(estimator, "refit") or has_fit_parameter(estimator, "groups")


def learn(
    estimator: Any, rows: Rows, splits: Sequence[tuple[Indices, Indices]], ahead: Ahead
) -> tuple[Any, Array]:
    """Fit an estimator, and predict all rows by fits that they were left out of.

    A search chooses once, on all rows.

    Parameters
    ----------
    estimator : estimator instance
        What is fitted; it is cloned.
    rows : Rows
        What it learns. Rows that hold NaN are left out.
    splits : sequence of (train, test)
        The rows of each fit.
    ahead : Ahead
        What is predicted.

    Returns
    -------
    fitted : estimator instance
        The fit to all rows.
    left_out : ndarray of shape (n_rows, n_horizons, n_outputs)
        The predictions, NaN in rows that hold NaN.
    """
    everything = np.hstack([rows.features, rows.values])
    is_usable = np.asarray(np.isfinite(everything).all(axis=1))
    fitted = fit_rows(estimator, rows.take(is_usable))
    fixed = fix_choices(fitted)
    left_out = np.full((len(rows.features), len(ahead.steps), ahead.n_outputs), np.nan)
    for train, test in splits:
        train, test = train[is_usable[train]], test[is_usable[test]]
        if len(train) and len(test):
            model = fit_rows(fixed, rows.take(train))
            left_out[test] = predict_rows(model, rows.features[test], ahead)
    return fitted, left_out


def fit_rows(estimator: Any, rows: Rows) -> Any:
    """Fit a clone of an estimator; it gets the recordings if it can use them.

    Searches get them as groups, and operators the places of the rows.
    """
    prefix, final = last_step(estimator)
    parameters: dict[str, Any] = {}
    if is_operator(estimator):
        parameters[f"{prefix}sample_index"] = rows.sample_index
    elif is_search(final) and len(np.unique(rows.groups)) > 1:
        parameters[f"{prefix}groups"] = rows.groups
    values = rows.values[:, 0] if rows.n_values == 1 else rows.values
    # The names of parameters are those of pipelines, with or without routing.
    with config_context(enable_metadata_routing=False), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The groups parameter is ignored")
        return clone(estimator).fit(rows.features, values, **parameters)


def fix_choices(fitted: Any) -> Any:
    """Return an unfitted estimator that has what a fitted search has chosen."""
    if isinstance(fitted, Pipeline):
        *front, (name, final) = fitted.steps
        steps = [(label, clone(step)) for label, step in front]
        return Pipeline([*steps, (name, fix_choices(final))])
    best = clone(getattr(fitted, "best_estimator_", fitted))
    if getattr(fitted, "method", None) == "interpolation":
        # The centres of the best one are rows of all recordings, not of a fold.
        best.set_params(centers=clone(fitted.centers, safe=False))
    return best


def predict_rows(fitted: Any, features: Array, ahead: Ahead) -> Array:
    """Return predictions of shape (n_rows, n_horizons, n_outputs)."""
    shape = (len(features), len(ahead.steps), ahead.n_outputs)
    with warnings.catch_warnings():
        # Estimators know scaled rows only; forecasters compare recordings with those
        # of the fit.
        warnings.simplefilter("ignore", ExtrapolationWarning)
        if not is_operator(fitted):
            return np.asarray(fitted.predict(features), np.float64).reshape(shape)
        operator, front = find_operator(fitted)
        steps = operator.forecast(transformed(front, features), int(ahead.steps.max()))
    return np.asarray(steps.reshape(len(features), -1, ahead.n_outputs))[
        :, ahead.steps - 1
    ]
