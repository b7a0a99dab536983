"""Looking into fitted pipelines and searches."""

from __future__ import annotations

from typing import Any

from sklearn.pipeline import Pipeline


def unwrap(estimator: Any) -> tuple[Any, Any]:
    """Split a fitted estimator into its last step and what comes before.

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
    estimator = getattr(estimator, "best_estimator_", estimator)
    if not isinstance(estimator, Pipeline):
        return estimator, None
    return estimator[-1], estimator[:-1] if len(estimator) > 1 else None


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
        What the last step sees.
    """
    return X if front is None else front.transform(X)
