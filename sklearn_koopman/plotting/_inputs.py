"""What displays take from estimators and data, and the checks of it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sklearn_koopman._utils._pipeline import unwrap
from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_integer, check_number


def known_centers(estimator: Any) -> Array | None:
    """Return the centres of a model or a selector.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.

    Returns
    -------
    centers : ndarray of shape (n_centers, n_features) or None
        The centres, if it has any that are states.
    """
    for name in ("centers_", "cluster_centers_"):
        if hasattr(estimator, name):
            return np.asarray(getattr(estimator, name), dtype=np.float64)
    return None


def locate_centers(estimator: Any, given: Any, X: Array) -> Array | None:
    """Find the centres of an estimator, in the units of the states.

    Those of a pipeline are rows of the states, if these are what it was fitted to,
    which is verified: then no step has to be inverted.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.
    given : array-like of shape (n_samples, n_features)
        The states, in the container that the estimator has seen.
    X : ndarray of shape (n_samples, n_features)
        The same in an array.

    Returns
    -------
    centers : ndarray of shape (n_centers, n_features) or None
        The centres, if they are known.
    """
    final, scaler = unwrap(estimator)
    centers = known_centers(final)
    if scaler is None:
        return centers
    rows = getattr(final, "center_indices_", None)
    if rows is None or rows.max() >= len(X):
        return None
    seen = np.asarray(scaler.transform(given))[rows]
    if centers is None:  # fitted to distances, which are zero at the centres
        return X[rows] if (seen.min(axis=1) == 0).all() else None
    same = np.allclose(seen, centers, rtol=0, atol=1e-9 * np.abs(centers).max())
    return X[rows] if same else None


def predict_like(estimator: Any, given: Any, states: Array, output: int) -> Array:
    """Predict an output from states, in a container such as `fit` has seen.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.
    given : array-like
        Other states; the columns of a data frame are taken over.
    states : ndarray of shape (n_samples, n_features)
        The states.
    output : int
        Which of several outputs.

    Returns
    -------
    y : ndarray of shape (n_samples,)
        The prediction.
    """
    like: Any = states
    if hasattr(given, "columns"):
        names = {"columns" if hasattr(given, "iloc") else "schema": list(given.columns)}
        like = type(given)(states, **names)  # of pandas, or of polars
    return column(estimator.predict(like), output, len(states), "the prediction")


def one_step(
    estimator: Any, X: Any, band: str | None, norm: Any = None
) -> tuple[Any, Any, str]:
    """Predict one step ahead, with a band.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.
    X : array-like of shape (n_samples, n_features)
        The states.
    band : {"std", "bound"} or None
        What the band is.
    norm : float or array-like of shape (n_outputs,), default=None
        The native norm that the bound is made from.

    Returns
    -------
    y : ndarray
        The prediction.
    bound : ndarray or None
        Half the width of the band.
    label : str
        Its name.
    """
    kind = type(estimator).__name__
    if band == "std":
        if "return_std" not in inspect.signature(estimator.predict).parameters:
            raise ValueError(
                f"band='std' needs an estimator with predict(X, return_std=True), "
                f"which {kind} is not; pass a KoopmanKernelRegressor, or band=None."
            )
        predicted, std = estimator.predict(X, return_std=True)
        return predicted, 2 * std, "±2 standard deviations"
    if band == "bound":
        if not hasattr(estimator, "error_bound"):
            raise ValueError(
                f"band='bound' needs an estimator with error_bound(X), which {kind} "
                "is not; pass a KoopmanKernelRegressor, or band=None."
            )
        return estimator.predict(X), estimator.error_bound(X, norm), "error bound"
    return estimator.predict(X), None, "bound"


def names_of_features(
    estimator: Any, X: Any, given: Sequence[str] | None
) -> Sequence[str] | None:
    """Return the names of the features.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.
    X : array-like of shape (n_samples, n_features)
        The states.
    given : sequence of str or None
        Names that take precedence.

    Returns
    -------
    names : sequence of str or None
        Those given, those of a data frame or those seen by `fit`.
    """
    names = given
    if names is None:
        found = getattr(X, "columns", getattr(estimator, "feature_names_in_", None))
        names = None if found is None else [str(name) for name in found]
    n_features = np.shape(X)[1]
    if names is not None and (isinstance(names, str) or len(names) != n_features):
        raise ValueError(
            f"feature_names must hold {n_features} names, one for each feature of X, "
            f"got {names!r}."
        )
    return names


def kernel_name(kernel: str) -> str:
    """Return what a kernel of this package is commonly called.

    Parameters
    ----------
    kernel : str
        Its name, or its representation.

    Returns
    -------
    name : str
        A short name without the scale, or what was given.
    """
    if found := re.fullmatch(r"matern([135])2", kernel):
        return f"Matern-{found[1]}/2"
    if found := re.fullmatch(r"MaternSobolev\([^()]*nu=([0-2])\.5[^()]*\)", kernel):
        return f"Matern-{2 * int(found[1]) + 1}/2"
    if found := re.fullmatch(
        r"wendland_c(\d)|Wendland\([^()]*smoothness=(\d)[^()]*\)", kernel
    ):
        return f"Wendland C{found[1] or found[2]}"
    if re.fullmatch(r"gaussian|Gaussian\([^()]*\)", kernel):
        return "Gaussian"
    if re.fullmatch(r"inverse_multiquadric|InverseMultiquadric\([^()]*\)", kernel):
        return "inverse multiquadric"
    return kernel


def column(values: Any, output: int, n_rows: int, name: str) -> Array:
    """Return one of several outputs.

    Parameters
    ----------
    values : array-like of shape (n_rows,) or (n_rows, n_outputs)
        The outputs.
    output : int
        Which of them.
    n_rows : int
        How many rows there should be.
    name : str
        What to call them in an error.

    Returns
    -------
    column : ndarray of shape (n_rows,)
        The output.
    """
    check_integer(output, "output", 0)
    values = np.asarray(values, dtype=np.float64)
    if values.ndim not in (1, 2) or len(values) != n_rows:
        raise ValueError(
            f"{name} must have the shape ({n_rows},) or ({n_rows}, n_outputs), "
            f"got {values.shape}."
        )
    values = values.reshape(n_rows, -1)
    if output >= values.shape[1]:
        raise ValueError(
            f"output={output} is not among the outputs of {name}, which are "
            f"{values.shape[1]}; give a number from 0 to {values.shape[1] - 1}."
        )
    return values[:, output]


def times_of(n_times: int, time: Any, dt: float | None) -> Array:
    """Return the times of outputs, given or counted.

    Parameters
    ----------
    n_times : int
        The number of outputs.
    time : array-like of shape (n_times,) or None
        Their times.
    dt : float or None
        The time between them.

    Returns
    -------
    time : ndarray of shape (n_times,)
        The times given, or multiples of `dt` (or of 1) from the first on.
    """
    if dt is not None:
        check_number(dt, "dt", positive=True)
    if time is None:
        return (1.0 if dt is None else dt) * np.arange(1.0, n_times + 1)
    if dt is not None:
        raise ValueError(f"time and dt={dt!r} exclude each other; give one of them.")
    time = np.asarray(time, dtype=np.float64)
    if time.shape != (n_times,):
        raise ValueError(
            f"time must have one entry for each of {n_times} outputs, got the shape "
            f"{time.shape}."
        )
    return time


def check_limits(limits: Any) -> None:
    """Refuse limits that are no two rising numbers.

    Parameters
    ----------
    limits : object
        The supposed limits, or None.
    """
    if limits is None:
        return
    pair = np.asarray(limits, dtype=np.float64)
    if pair.shape != (2,) or not np.isfinite(pair).all() or pair[0] >= pair[1]:
        raise ValueError(f"z_limits must be two rising numbers, got {limits!r}.")


def check_choice(value: Any, name: str, choices: Mapping[str, str]) -> None:
    """Refuse anything but one of some names.

    Parameters
    ----------
    value : object
        The supposed choice.
    name : str
        The parameter.
    choices : mapping of str
        The choices.
    """
    if not isinstance(value, str) or value not in choices:
        raise ValueError(
            f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}."
        )


def check_study(study: Any, function: str, field: str) -> None:
    """Refuse what is not the kind of study that a display shows.

    Parameters
    ----------
    study : object
        The supposed study.
    function : str
        What would have made it.
    field : str
        One that only such studies have.
    """
    if not isinstance(study, Mapping) or field not in study:
        held = f" of {', '.join(study)}" if isinstance(study, Mapping) else ""
        raise ValueError(
            f"study must be what {function} returned, got {type(study).__name__}{held}."
        )
