"""What displays take from estimators and data, and the checks of it."""

import re
import warnings
from collections.abc import Mapping, Sequence
from inspect import signature
from typing import Any

import numpy as np
from sklearn.utils.validation import check_is_fitted

from .._utils._frames import index_level
from .._utils._pipeline import unwrap
from .._utils._typing import Array, Indices
from .._utils._validation import check_integer, check_number
from .._utils._warnings import ExtrapolationWarning
from ..trajectories import match_successors, successor_rows

# Patterns of the names and the representations of kernels, and their common names.
COMMON_NAMES = {
    r"matern12|MaternSobolev\([^()]*nu=0\.5[^()]*\)": "Matern-1/2",
    r"matern32|MaternSobolev\([^()]*nu=1\.5[^()]*\)": "Matern-3/2",
    r"matern52|MaternSobolev\([^()]*nu=2\.5[^()]*\)": "Matern-5/2",
    r"(?:wendland_c|Wendland\([^()]*smoothness=)(\d)(?:[^()]*\))?": r"Wendland C\1",
    r"gaussian|Gaussian\([^()]*\)": "Gaussian",
    r"inverse_multiquadric|InverseMultiquadric\([^()]*\)": "inverse multiquadric",
}


def find_centers(estimator: Any) -> Array | None:
    """Return the centres of a fitted model or selector, if they are states.

    Parameters
    ----------
    estimator : estimator instance
        A fitted model or selector.

    Returns
    -------
    centers : ndarray of shape (n_centers, n_features) or None
        The centres; None if there are none that are states.
    """
    centers = getattr(estimator, "cluster_centers_", None)
    centers = getattr(estimator, "centers_", centers)
    return None if centers is None else np.asarray(centers, dtype=np.float64)


def locate_centers(estimator: Any, given: Any, X: Array) -> Array | None:
    """Find the centres of an estimator, in the units of the states.

    The centres of a pipeline are rows of the states that it was fitted to. Whether
    these are given here is verified, so that no step has to be inverted.

    Parameters
    ----------
    estimator : estimator instance
        A fitted estimator.
    given : array-like of shape (n_samples, n_features)
        The states, in the container that the estimator was fitted to.
    X : ndarray of shape (n_samples, n_features)
        The same states in an array.

    Returns
    -------
    centers : ndarray of shape (n_centers, n_features) or None
        The centres, if they are known.
    """
    final, scaler = unwrap(estimator)
    centers = find_centers(final)
    if scaler is None:
        return centers
    rows = getattr(final, "center_indices_", None)
    if rows is None or rows.max() >= len(X):
        return None
    transformed = np.asarray(scaler.transform(given))[rows]
    if centers is None:  # fitted to distances, which are zero at the centres
        return X[rows] if (transformed.min(axis=1) == 0).all() else None
    tolerance = 1e-9 * np.abs(centers).max()
    same = np.allclose(transformed, centers, rtol=0, atol=tolerance)
    return X[rows] if same else None


def predict_like(estimator: Any, given: Any, states: Array, output: int) -> Array:
    """Predict one output from an array, in the container of the given states.

    Parameters
    ----------
    estimator : estimator instance
        A fitted model, pipeline or search.
    given : array-like of shape (n_samples, n_features)
        The states that the user gave.
    states : ndarray of shape (n, n_features)
        The states to predict from.
    output : int
        Which of several outputs.

    Returns
    -------
    predicted : ndarray of shape (n,)
        The predictions.
    """
    like: Any = states
    if hasattr(given, "columns"):
        names = {"columns" if hasattr(given, "iloc") else "schema": list(given.columns)}
        like = type(given)(states, **names)  # of pandas, or of polars
    with warnings.catch_warnings():
        # A picture shows where the data are.
        warnings.simplefilter("ignore", ExtrapolationWarning)
        predicted = estimator.predict(like)
    return select_output(predicted, output, len(states), "the prediction")


def predict_one_step(
    estimator: Any, X: Any, band: str | None, norm: Any = None
) -> tuple[Any, Any, str]:
    """Predict one step ahead; return half the width of a band and its name, too.

    Parameters
    ----------
    estimator : estimator instance
        A fitted model.
    X : array-like of shape (n_samples, n_features)
        The states.
    band : {"std", "bound"} or None
        What the band around the predictions shows.
    norm : float or array-like, default=None
        Native norm of the true function, for the error bound.

    Returns
    -------
    predicted : ndarray of shape (n_samples,) or (n_samples, n_outputs)
        The predictions.
    bound : ndarray or None
        Half the width of the band.
    label : str
        The name of the band in the legend.

    Raises
    ------
    ValueError
        If the estimator does not have what the band needs.
    """
    if band is None:
        return estimator.predict(X), None, "bound"
    if band == "bound" and hasattr(estimator, "error_bound"):
        return estimator.predict(X), estimator.error_bound(X, norm), "error bound"
    if band == "std" and "return_std" in signature(estimator.predict).parameters:
        predicted, std = estimator.predict(X, return_std=True)
        return predicted, 2 * std, "±2 standard deviations"
    needed = "error_bound(X)" if band == "bound" else "predict(X, return_std=True)"
    raise ValueError(
        f"band={band!r} needs {needed}, which {type(estimator).__name__} does not "
        "have; pass a KoopmanKernelRegressor, or band=None."
    )


def rows_per_step(final: Any, X: Any, y: Any) -> int:
    """Find out how many rows of one trajectory make a step of a model.

    Parameters
    ----------
    final : estimator instance
        The fitted model, or the last step of a pipeline.
    X : array-like of shape (n_samples, n_features)
        The states.
    y : array-like of shape (n_samples,) or (n_samples, n_outputs)
        The outputs one step after each of them.

    Returns
    -------
    lag : int
        The number of rows from each row to the one that follows it.

    Raises
    ------
    ValueError
        If neither an index, nor the outputs, nor the fit of the model tell.
    """
    clock = index_level("sample_index", X, y)
    links = match_successors(X, y) if clock is None else successor_rows(clock)
    if links is not None and len(links[0]):
        lag = int(links[1][0] - links[0][0])
        if lag > 0 and (links[1] - links[0] == lag).all():
            return lag
    elif clock is None and getattr(final, "_consecutive", False):
        return 1
    raise ValueError(
        "It is not known how many rows make one step; pass lag, that of "
        "trajectory_pairs (1 if the next row is the next step)."
    )


def resolve_names(
    estimator: Any, X: Any, given: Sequence[str] | None
) -> Sequence[str] | None:
    """Return the given names of features, or those of a data frame, or of `fit`.

    Parameters
    ----------
    estimator : estimator instance
        A fitted model or selector.
    X : array-like of shape (n_samples, n_features)
        The states.
    given : sequence of str or None
        The names that the user gave.

    Returns
    -------
    names : sequence of str or None
        The names; None if there are none.

    Raises
    ------
    ValueError
        If there is not one name for each feature.
    """
    names = given
    if names is None:
        found = getattr(X, "columns", getattr(estimator, "feature_names_in_", None))
        names = None if found is None else [str(name) for name in found]
    n_features = np.shape(X)[1]
    if names is not None and (isinstance(names, str) or len(names) != n_features):
        raise ValueError(
            f"feature_names must hold {n_features} names, those of all features of X, "
            f"got {names!r}."
        )
    return names


def is_forecaster(estimator: Any) -> bool:
    """Return whether an estimator forecasts whole recordings.

    Parameters
    ----------
    estimator : estimator instance
        Any estimator.

    Returns
    -------
    answer : bool
        Whether it does.
    """
    return hasattr(estimator, "explain")


def find_forecaster(estimator: Any) -> tuple[Any, Any]:
    """Split a fitted forecaster as `unwrap` does; refuse others.

    Parameters
    ----------
    estimator : estimator instance
        A fitted KoopmanForecaster, a pipeline that ends in one, or a search of either.

    Returns
    -------
    forecaster : KoopmanForecaster
        The last step of a pipeline, or the estimator itself.
    front : Pipeline or None
        The steps before it, if any.

    Raises
    ------
    ValueError
        If it is no fitted forecaster.
    """
    check_is_fitted(estimator)
    forecaster, front = unwrap(estimator)
    if not is_forecaster(forecaster):
        raise ValueError(
            f"estimator must be a KoopmanForecaster, got {type(forecaster).__name__}."
        )
    return forecaster, front


def sorted_horizons(forecaster: Any) -> tuple[Indices, Indices]:
    """Return the horizons of a forecaster in rising order.

    Parameters
    ----------
    forecaster : KoopmanForecaster
        The forecaster.

    Returns
    -------
    order : ndarray of shape (n_horizons,)
        The number of each among the horizons as they were given.
    horizons : ndarray of shape (n_horizons,)
        The horizons.
    """
    horizons = np.asarray(forecaster.horizons_)
    order = np.argsort(horizons)
    return order, horizons[order]


def find_output(forecaster: Any, output: int | str) -> tuple[int, str]:
    """Return the number and the name of an output of a forecaster.

    Parameters
    ----------
    forecaster : KoopmanForecaster
        The fitted forecaster.
    output : int or str
        The number or the name.

    Returns
    -------
    number : int
        Its number among the outputs.
    name : str
        Its name.

    Raises
    ------
    ValueError
        If there is no such output.
    """
    names = [str(name) for name in forecaster.output_names_]
    if isinstance(output, str) and output in names:
        output = names.index(output)
    is_number = isinstance(output, int | np.integer) and not isinstance(output, bool)
    if not is_number or int(output) not in range(len(names)):
        raise ValueError(
            f"output={output!r} is not among the outputs {names}; give one of them, or "
            f"a number from 0 to {len(names) - 1}."
        )
    return int(output), names[int(output)]


def kernel_name(kernel: str) -> str:
    """Return the common name of a kernel, or what was given if it has none.

    Parameters
    ----------
    kernel : str
        The name or the representation of a kernel.

    Returns
    -------
    name : str
        Its common name; `kernel` if there is none.
    """
    for pattern, name in COMMON_NAMES.items():
        if found := re.fullmatch(pattern, kernel):
            return found.expand(name)
    return kernel


def select_output(values: Any, output: int, n_rows: int, name: str) -> Array:
    """Return one column of the outputs that an error calls by a name.

    Parameters
    ----------
    values : array-like of shape (n_rows,) or (n_rows, n_outputs)
        The outputs.
    output : int
        Which of them.
    n_rows : int
        The number of rows that there must be.
    name : str
        The name of the values, for errors.

    Returns
    -------
    selected : ndarray of shape (n_rows,)
        The output.

    Raises
    ------
    ValueError
        If the shape is another, or there is no such output.
    """
    check_integer(output, "output", 0)
    values = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)
    if values.ndim not in (1, 2) or len(values) != n_rows:
        raise ValueError(
            f"{name} must have the shape ({n_rows},) or ({n_rows}, n_outputs), "
            f"got {values.shape}."
        )
    values = values.reshape(n_rows, -1)
    if output >= values.shape[1]:
        raise ValueError(
            f"output={output} is not among the {values.shape[1]} outputs of {name}; "
            f"give a number from 0 to {values.shape[1] - 1}."
        )
    return values[:, output]


def times_of(n_times: int, time: Any, dt: float | None) -> Array:
    """Return the given times of outputs, or multiples of `dt` (or of 1).

    Parameters
    ----------
    n_times : int
        The number of outputs.
    time : array-like of shape (n_times,) or None
        The times that the user gave.
    dt : float or None
        The time between two outputs. None for 1.

    Returns
    -------
    times : ndarray of shape (n_times,)
        The times.

    Raises
    ------
    ValueError
        If both are given, or a value is not valid.
    """
    if dt is not None:
        check_number(dt, "dt", positive=True)
    if time is None:
        return (1.0 if dt is None else dt) * np.arange(1.0, n_times + 1)
    times = np.asarray(time, dtype=np.float64)
    if dt is not None or times.shape != (n_times,):
        raise ValueError(
            f"time must have one entry for each of {n_times} outputs, and excludes dt; "
            f"got the shape {times.shape} and dt={dt!r}."
        )
    return times


def check_study(study: Any, function: str, field: str) -> None:
    """Refuse what is not the study that a function makes, which holds a field.

    Parameters
    ----------
    study : object
        What should be a study.
    function : str
        The functions that compute such studies.
    field : str
        What only such studies hold.

    Raises
    ------
    ValueError
        If it is no such study.
    """
    if not isinstance(study, Mapping) or field not in study:
        held = f" of {', '.join(study)}" if isinstance(study, Mapping) else ""
        raise ValueError(
            f"study must be what {function} returned, got {type(study).__name__}{held}."
        )
