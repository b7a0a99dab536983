"""Fitted pipelines and searches, taken apart."""

from typing import Any

from sklearn.pipeline import Pipeline


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
