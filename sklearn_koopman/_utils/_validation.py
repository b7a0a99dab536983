"""Checks of parameters and data that scikit-learn's public helpers do not cover."""

from collections.abc import Collection
from numbers import Integral, Real
from typing import Any

import numpy as np
from sklearn.utils import check_array

from ._typing import Array

# Numbers between these have squares within the range of a double.
MIN_MAGNITUDE, MAX_MAGNITUDE = 1e-150, 1e150


def as_floats(value: Any, name: str) -> Array:
    """Convert to floats, masked values to NaN; name the parameter that cannot be."""
    try:
        if hasattr(value, "iloc"):  # NumPy does not convert pandas' missing values
            value = value.astype(np.float64)
        return np.ma.filled(np.ma.asarray(value, dtype=np.float64), np.nan)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}.") from error


def check_number(value: Any, name: str, *, positive: bool = False) -> None:
    """Refuse anything but a finite number of at least zero, or above zero."""
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not is_number or not (0 < value < np.inf or (value == 0 and not positive)):
        kind = "positive" if positive else "non-negative"
        raise ValueError(f"{name} must be a finite {kind} number, got {value!r}.")


def check_integer(value: Any, name: str, minimum: int) -> None:
    """Refuse anything but an integer of at least a minimum."""
    is_integer = isinstance(value, Integral) and not isinstance(value, bool)
    if is_integer and value >= minimum:
        return
    raise ValueError(f"{name} must be an integer of at least {minimum}, got {value!r}.")


def check_positive(values: Any, name: str) -> Array:
    """Return numbers as an array; refuse any that is not finite and positive."""
    numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    good = (numbers > 0) & (numbers < np.inf)
    if numbers.ndim == 1 and numbers.size and good.all():
        return numbers
    raise ValueError(
        f"{name} must be a list of positive, finite numbers, got {values!r}."
    )


def check_names(names: Any, parameter: str) -> None:
    """Refuse anything but None and a collection of names."""
    is_list = isinstance(names, Collection) and not isinstance(names, str | bytes)
    if names is not None and not (is_list and len(names)):
        raise ValueError(f"{parameter}={names!r}; pass a list of names, or None.")


def check_flag(value: Any, name: str) -> None:
    """Refuse anything but True and False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, got {value!r}.")


def check_choice(value: Any, name: str, choices: Collection[Any]) -> None:
    """Refuse anything but one of these values."""
    # Arrays and the like compare to arrays, which are neither true nor false.
    if not (value is None or isinstance(value, str | Real)) or value not in choices:
        raise ValueError(
            f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}."
        )


def check_parameters(
    estimator: Any, *, non_negative: Collection[str] = (), **choices: Collection[Any]
) -> None:
    """Refuse parameters that are no non-negative number, or none of their choices."""
    for name in non_negative:
        check_number(getattr(estimator, name), name)
    for name, values in choices.items():
        check_choice(getattr(estimator, name), name, values)


def check_sample_weight(sample_weight: Any, n_rows: int) -> Array | None:
    """Return weights as an array, or None; refuse any but one a row, of 0 or above."""
    if sample_weight is None:
        return None
    refuse_masked(sample_weight=sample_weight)
    weights: Array = check_array(
        sample_weight,
        dtype=np.float64,
        ensure_2d=False,
        allow_nd=True,
        ensure_min_samples=0,
        input_name="sample_weight",
    )
    if weights.shape != (n_rows,):
        raise ValueError(
            f"sample_weight has shape {weights.shape}, but X has {n_rows} rows; pass "
            "one weight a row."
        )
    smallest, largest = weights.min(), weights.max()
    if smallest < 0 or not 0 < largest <= MAX_MAGNITUDE:
        raise ValueError(
            f"sample_weight must hold numbers from 0 to {MAX_MAGNITUDE:g}, not only "
            f"zeros, got values from {smallest:.3g} to {largest:.3g}."
        )
    return weights


def check_columns(data: Any, name: str, other: Any, other_name: str) -> None:
    """Refuse frames whose columns have other names, or another order."""
    columns, others = (getattr(frame, "columns", None) for frame in (data, other))
    if columns is not None and others is not None and list(columns) != list(others):
        raise ValueError(
            f"{name} has the columns {list(columns)}, but {other_name} has "
            f"{list(others)}; bring them into one order."
        )


def refuse_masked(**data: Any) -> None:
    """Refuse arrays with masked values, which a conversion would make values again."""
    for name, value in data.items():
        parts = value if isinstance(value, list | tuple) else [value]
        count = sum(
            np.count_nonzero(np.ma.getmaskarray(part))
            for part in parts
            if isinstance(part, np.ma.MaskedArray)
        )
        if count:
            raise ValueError(
                f"{name} holds {count} masked values; fill them, drop their rows, or "
                "pair recordings by trajectory_pairs(gaps='split'), which leaves them "
                "out."
            )


def check_magnitude(X: Array, smallest: float = MIN_MAGNITUDE, name: str = "X") -> None:
    """Refuse states whose squared distances leave the range of a double."""
    largest = max(X.max(), -X.min())  # without a copy of all values
    if largest > MAX_MAGNITUDE or 0 < largest < smallest:
        raise ValueError(
            f"{name} has values up to {largest:.3g}, whose squares double precision "
            f"cannot hold; rescale {name}, by StandardScaler for example."
        )


def check_distances(X: Array) -> None:
    """Refuse negative entries of what should be distances to the centres."""
    if X.min() < 0:
        raise ValueError(
            f"X holds {X.min():.3g}, but with centers='precomputed' its entries are "
            "distances; pass the result of SeparatedCenterSelector.transform."
        )
