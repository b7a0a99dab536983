"""Forecasts that need no learning, to which a correction is learned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._utils._typing import Array, Indices, Mask
from .._utils._validation import check_choice
from ._analogs import SIMILAR, Analogs, AnalogSet, find_analogs
from ._tracks import Track

DIRECT, LAST, LINEAR, ANALOGS, CUSTOM = "direct", "last", "linear", "analogs", "custom"
BASELINES = (LAST, LINEAR, ANALOGS, CUSTOM)

# What "auto" chooses from.
CANDIDATES = (DIRECT, LAST, LINEAR, ANALOGS)


class Baseline(NamedTuple):
    """What a baseline says of some rows of one recording.

    Attributes
    ----------
    forecasts : ndarray of shape (n_rows, n_horizons, n_outputs)
        NaN where the baseline has none.
    features : ndarray of shape (n_rows, n_features)
        What a correction is learned from, besides the past of the rows.
    """

    forecasts: Array
    features: Array


@dataclass(frozen=True)
class Baselines:
    """What the baselines need to know.

    Attributes
    ----------
    horizons : ndarray of shape (n_horizons,)
        How many rows ahead.
    analogs : Analogs
        What counts as similar, with numbers for all parameters but `max_past`.
    scale : ndarray of shape (n_columns,)
        The unit of each column, in which windows are compared.
    function : callable or None
        A baseline of the user.
    """

    horizons: Indices
    analogs: Analogs
    scale: Array
    function: Callable[..., Any] | None

    def say(
        self, name: str, recording: Any, track: Track, past: Array, rows: Indices
    ) -> Baseline:
        """Return what a baseline says of some rows.

        Parameters
        ----------
        name : str
            The baseline.
        recording : array-like of shape (n_all_rows, n_columns)
            The recording as it was given.
        track : Track
            The recording.
        past : ndarray of shape (n_all_rows, n_embedded)
            The embedded states.
        rows : ndarray of shape (n_rows,)
            Which rows.
        """
        if name == ANALOGS:
            return self._analogs(track, past, rows)
        now = track.outputs[rows, np.newaxis]
        shape = (len(rows), len(self.horizons), now.shape[2])
        if name == DIRECT:  # the correction is all of the forecast
            forecasts = np.zeros(shape)
        elif name == LAST:
            forecasts = np.broadcast_to(now, shape)
        elif name == LINEAR:
            before = track.outputs[np.maximum(rows - 1, 0), np.newaxis]
            is_start = np.isin(rows, [piece.start for piece in track.pieces])
            step = np.where(is_start[:, np.newaxis, np.newaxis], np.nan, now - before)
            forecasts = now + self.horizons[:, np.newaxis] * step
        else:
            forecasts = self._custom(recording, track)[rows]
        return Baseline(forecasts, np.empty((len(rows), 0)))

    def find(self, track: Track, rows: Indices) -> AnalogSet:
        """Find the analogs of some rows, first a set that serves all horizons."""
        analogs = self.analogs
        follows = np.concatenate([[0], self.horizons])
        return find_analogs(
            track.states,
            track.piece,
            rows,
            np.maximum(follows, np.intp(analogs.exclusion or 0)),
            follows,
            scale=self.scale,
            max_distance=SIMILAR,
            **analogs.get_params(),
        )

    def _analogs(self, track: Track, past: Array, rows: Indices) -> Baseline:
        """Forecast what followed the windows that are most similar to the present.

        The features are the deviations of the embedded states from the weighted mean of
        those of the analogs.
        """
        found, horizons = self.find(track, rows), self.horizons
        has_analogs: Mask = found.weights.sum(axis=2) > 0
        forecasts = np.stack(
            [
                _mean(track.outputs, found.places[:, i] + horizon, found.weights[:, i])
                for i, horizon in enumerate(horizons, 1)
            ],
            axis=1,
        )
        forecasts[~has_analogs[:, 1:]] = np.nan
        deviation = past[rows] - _mean(past, found.places[:, 0], found.weights[:, 0])
        deviation[~has_analogs[:, 0]] = np.nan
        return Baseline(forecasts, deviation)

    def _custom(self, recording: Any, track: Track) -> Array:
        """Return what a function of the user says of all rows of a recording."""
        assert self.function is not None
        forecasts = np.asarray(self.function(recording, self.horizons.copy()), float)
        shape = (len(track.states), len(self.horizons), track.outputs.shape[1])
        if forecasts.shape != shape:
            raise ValueError(
                f"baseline returned an array of shape {forecasts.shape} for a "
                f"recording of {shape[0]} rows; return (n_rows, n_horizons, "
                f"n_outputs), which is {shape}."
            )
        return forecasts


def _mean(values: Array, places: Indices, weights: Array) -> Array:
    """Return weighted means of some rows; those of weight 0 need not be there."""
    rows = values[np.clip(places, 0, len(values) - 1)]
    weights = weights[:, :, np.newaxis]
    return np.where(weights > 0, weights * rows, 0.0).sum(axis=1)


def find_candidates(
    baseline: Any, has_outputs: bool, has_powers: bool
) -> tuple[str, ...]:
    """Return the names of the baselines to try.

    Parameters
    ----------
    baseline : str, Analogs, callable or None
        The parameter.
    has_outputs : bool
        Whether the outputs are no columns of the recordings.
    has_powers : bool
        Whether the estimator is an operator, which forecasts by its powers.
    """
    if isinstance(baseline, Analogs):
        names: tuple[str, ...] = (ANALOGS,)
    elif callable(baseline) and not isinstance(baseline, type):
        names = (CUSTOM,)
    else:
        check_choice(baseline, "baseline", (None, "auto", LAST, LINEAR, ANALOGS))
        names = (DIRECT,) if baseline is None else (str(baseline),)
    if names == ("auto",):
        return (DIRECT,) if has_outputs or has_powers else CANDIDATES
    if names != (DIRECT,) and (has_outputs or has_powers):
        reason = "y holds them" if has_outputs else "an operator forecasts by itself"
        raise ValueError(
            f"baseline={baseline!r} needs an estimator of corrections, and outputs "
            f"that are columns of X, but {reason}; leave baseline out."
        )
    return names
