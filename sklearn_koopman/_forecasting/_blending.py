"""How much of a correction is believed, and which baseline, at each horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from sklearn.metrics import r2_score

from .._utils._typing import Array, Mask
from ._baselines import ANALOGS, DIRECT, LAST

# A baseline that says nothing of more rows than this is chosen for no horizon.
MAX_SILENT = 0.9
# A column whose spread is smaller than this part of its values is constant.
ROUNDING = 1e-12


class LeftOut(NamedTuple):
    """Forecasts of rows by fits that these rows were left out of.

    Attributes
    ----------
    baseline : ndarray of shape (n_rows, n_horizons, n_outputs)
        What the baseline says, NaN where it says nothing.
    correction : ndarray of shape (n_rows, n_horizons, n_outputs)
        What was learned on top of it.
    """

    baseline: Array
    correction: Array


class Blend(NamedTuple):
    """What is forecast at each horizon.

    Attributes
    ----------
    names : ndarray of str of shape (n_horizons,)
        The baseline.
    weights : ndarray of shape (n_horizons,)
        What the correction is multiplied by.
    scale : ndarray of shape (n_horizons, n_outputs)
        The root mean square of the errors of the rows that were left out.
    errors : dict of str to ndarray of shape (n_horizons, n_outputs)
        The same for each baseline, alone ("last") and corrected ("last, corrected").
    """

    names: Array
    weights: Array
    scale: Array
    errors: dict[str, Array]


def blend(left_out: Mapping[str, LeftOut], truth: Array, unit: Array) -> Blend:
    """Choose the baseline and the weight of the correction for each horizon.

    Both by least squares on rows that were left out, those that all baselines speak of,
    but for baselines that say too little.

    Parameters
    ----------
    left_out : dict of str to LeftOut
        The forecasts, by the name of the baseline.
    truth : ndarray of shape (n_rows, n_horizons, n_outputs)
        What came.
    unit : ndarray of shape (n_outputs,)
        The unit of each output.

    Returns
    -------
    blend : Blend
        The choice.
    """
    is_known = {
        name: _is_known(forecasts.baseline + forecasts.correction)
        for name, forecasts in left_out.items()
    }
    is_known, rows = _find_common(is_known)
    if not rows.any():
        raise ValueError(
            "no row could be left out: the recordings are too short, or too few; pass "
            "more of them, or lower horizons and delays."
        )
    errors, corrected, weights = {}, [], []
    for name, known in is_known.items():
        baseline, correction = left_out[name]
        weight = _weigh(name, (truth - baseline)[known], correction[known], unit)
        forecasts = baseline[rows] + weight[:, np.newaxis] * correction[rows]
        corrected.append(rms(forecasts - truth[rows]))
        weights.append(weight)
        if name == DIRECT:
            errors[name] = corrected[-1]
        else:
            errors[name] = rms(baseline[rows] - truth[rows])
            errors[f"{name}, corrected"] = corrected[-1]
    best = np.argmin([((error / unit) ** 2).sum(axis=1) for error in corrected], axis=0)
    horizons = np.arange(truth.shape[1])
    return Blend(
        np.array(list(is_known))[best],
        np.array(weights)[best, horizons],
        np.array(corrected)[best, horizons],
        errors,
    )


class StandIns(NamedTuple):
    """What is forecast where there is no analog.

    Attributes
    ----------
    names : ndarray of str of shape (n_horizons,)
        The baseline.
    weights : ndarray of shape (n_horizons,)
        What the correction is multiplied by.
    scale : ndarray of shape (n_horizons, n_outputs)
        The root mean square of their errors.
    """

    names: Array
    weights: Array
    scale: Array


def find_stand_ins(
    left_out: Mapping[str, LeftOut], truth: Array, current: Array, unit: Array
) -> StandIns:
    """Choose what is best where there is no analog.

    Parameters
    ----------
    left_out : dict of str to LeftOut
        The forecasts of all rows. Without other baselines than analogs, the outputs
        remain as they are.
    truth : ndarray of shape (n_rows, n_horizons, n_outputs)
        What came.
    current : ndarray of shape (n_rows, 1, n_outputs)
        The outputs in the rows themselves.
    unit : ndarray of shape (n_outputs,)
        The unit of each output.
    """
    n_horizons = truth.shape[1]
    names, weights = [LAST], [np.zeros(n_horizons)]
    errors = [rms(truth - current)]
    for name, (baseline, correction) in left_out.items():
        known = _is_known(baseline + correction)
        if name == ANALOGS or not known.any():
            continue
        weight = _weigh(name, (truth - baseline)[known], correction[known], unit)
        names.append(name)
        weights.append(weight)
        forecasts = baseline + weight[:, np.newaxis] * correction
        errors.append(rms((truth - forecasts)[known]))
    best = np.argmin([((error / unit) ** 2).sum(axis=1) for error in errors], axis=0)
    horizons = np.arange(n_horizons)
    return StandIns(
        np.array(names)[best],
        np.array(weights)[best, horizons],
        np.array(errors)[best, horizons],
    )


def compare(said: Mapping[str, Array], truth: Array) -> dict[str, Array]:
    """Return root mean square errors over the rows that all forecasts speak of.

    Parameters
    ----------
    said : dict of str to ndarray of shape (n_rows, n_horizons, n_outputs)
        The forecasts, NaN where there is none. Those that say too little are left out.
    truth : ndarray of shape (n_rows, n_horizons, n_outputs)
        What came, NaN where that is not known.

    Returns
    -------
    errors : dict of str to ndarray of shape (n_horizons, n_outputs)
        The errors of each forecast.
    """
    is_known = {name: _is_known(each + truth) for name, each in said.items()}
    is_known, rows = _find_common(is_known)
    if not rows.any():
        raise ValueError(
            "no row has a forecast, and outputs at all horizons; pass longer "
            "recordings, or lower horizons and delays."
        )
    return {name: rms(said[name][rows] - truth[rows]) for name in is_known}


def _is_known(values: Array) -> Mask:
    """Return which rows are known at all horizons."""
    return np.asarray(np.isfinite(values).all(axis=(1, 2)))


def _find_common(is_known: dict[str, Mask]) -> tuple[dict[str, Mask], Mask]:
    """Drop forecasts that say too little; return the others, and their common rows."""
    least = (1 - MAX_SILENT) * max(known.sum() for known in is_known.values())
    is_known = {name: known for name, known in is_known.items() if known.sum() >= least}
    return is_known, np.logical_and.reduce(list(is_known.values()))


def _weigh(name: str, wanted: Array, offered: Array, unit: Array) -> Array:
    """Return what to multiply an offered correction by at each horizon, in [0, 1].

    Without a baseline the correction is all of the forecast.
    """
    if name == DIRECT:
        return np.ones(wanted.shape[1])
    wanted, offered = wanted / unit, offered / unit
    power, product = (offered**2).sum(axis=(0, 2)), (offered * wanted).sum(axis=(0, 2))
    return np.clip(product / np.where(power > 0, power, 1.0), 0.0, 1.0)


def rms(errors: Array) -> Array:
    """Return the root mean square of each column."""
    return np.sqrt(np.mean(errors**2, axis=0))


def spread(arrays: Sequence[Array]) -> Array:
    """Return the standard deviation of each column, 1 where it is constant.

    Rows that hold NaN do not count.
    """
    rows = np.vstack(arrays)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        return np.ones(rows.shape[1])
    deviation = rows.std(axis=0)
    # The mean of equal numbers may differ from them by rounding.
    is_constant = deviation <= ROUNDING * np.abs(rows).max(axis=0)
    return np.where(is_constant, 1.0, deviation)


def positive(values: Array) -> Array:
    """Return what can be divided by."""
    return np.where(values > 0, values, 1.0)


def mean_r2(forecasts: Array, truth: Array, weights: Array) -> float:
    """Return R², averaged over horizons and outputs.

    Parameters
    ----------
    forecasts : ndarray of shape (n_rows, n_horizons, n_outputs)
        NaN where there is none.
    truth : ndarray of shape (n_rows, n_horizons, n_outputs)
        What came, NaN where that is not known.
    weights : ndarray of shape (n_rows,)
        The weight of each row.

    Returns
    -------
    score : float
        Over the rows of positive weight that have both.
    """
    is_scored = (
        np.isfinite(forecasts + truth) & (weights > 0)[:, np.newaxis, np.newaxis]
    )
    if np.count_nonzero(is_scored, axis=0).min() < 2:
        raise ValueError(
            "at some horizon no two rows have both a forecast and outputs that came; "
            "score longer recordings, or with positive weights."
        )
    scores = []
    for horizon, output in np.ndindex(truth.shape[1:]):
        rows = is_scored[:, horizon, output]
        pair = truth[rows, horizon, output], forecasts[rows, horizon, output]
        scores.append(r2_score(*pair, sample_weight=weights[rows]))
    return float(np.mean(scores))
