"""Fitted pipelines and searches, taken apart."""

from typing import Any

from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted


def unwrap(estimator: Any) -> tuple[Any, Any]:
    """Split a fitted estimator into its last step and the steps before it.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator, a pipeline, or a search of either.

    Returns
    -------
    final : estimator instance
        The last step of a pipeline, or the estimator itself.
    front : Pipeline or None
        The steps before it, if any.
    """
    steps: list[tuple[str, Any]] = []
    while isinstance(estimator, Pipeline) or hasattr(estimator, "best_estimator_"):
        if hasattr(estimator, "best_estimator_"):
            estimator = estimator.best_estimator_
            continue
        steps += estimator.steps[:-1]
        estimator = estimator[-1]
    return estimator, Pipeline(steps) if steps else None


def find_operator(estimator: Any) -> tuple[Any, Any]:
    """Split a fitted estimator that can forecast as `unwrap` does; refuse others.

    Parameters
    ----------
    estimator : estimator instance
        A fitted KernelEDMD, a pipeline that ends in one, or a search of either.

    Returns
    -------
    operator : KernelEDMD
        The last step of a pipeline, or the estimator itself.
    front : Pipeline or None
        The steps before it, if any.

    Raises
    ------
    NotFittedError
        If the estimator is not fitted.
    TypeError
        If it has no method `forecast`.
    """
    operator, front = unwrap(estimator)
    if hasattr(operator, "forecast"):
        check_is_fitted(operator)
        return operator, front
    if isinstance(operator, BaseEstimator):
        check_is_fitted(operator)  # a search that is not has no best estimator
    hint = "use a KernelEDMD, or a pipeline that ends in one"
    if hasattr(operator, "transformer_"):  # of targets
        hint = "use its regressor_, whose outputs its transformer_ transforms back"
    elif hasattr(operator, "cv_results_"):
        hint = "search with refit=True"
    raise TypeError(f"{type(operator).__name__} has no method forecast; {hint}.")


def transformed(front: Any, X: Any) -> Any:
    """Apply the steps before the last one.

    Parameters
    ----------
    front : Pipeline or None
        The steps, if any.
    X : array-like of shape (n_samples, n_features)
        The states.

    Returns
    -------
    X : array-like
        The states as the last step receives them.
    """
    return X if front is None else front.transform(X)
