"""Forecasts of rows: baselines and corrections, as they were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._utils._typing import Array, Indices
from ._baselines import ANALOGS, DIRECT
from ._corrections import Ahead, is_operator, predict_rows
from ._tracks import Track
from ._training import Design, horizon_step


@dataclass(frozen=True)
class Mixture:
    """What a fitted forecaster says of the rows of a recording.

    Attributes
    ----------
    design : Design
        How rows are made.
    estimators : dict of str to estimator
        What has learned the correction to each baseline.
    correction_scales : dict of str to ndarray of shape (n_horizons, n_outputs)
        What their predictions are multiplied by.
    baselines : ndarray of str of shape (n_horizons,)
        The baseline at each horizon.
    weights : ndarray of shape (n_horizons,)
        The weight of the correction.
    error_scale : ndarray of shape (n_horizons, n_outputs)
        The scale of the errors.
    stand_ins : ndarray of str of shape (n_horizons,)
        The baseline that stands in where there is no analog.
    stand_in_weights : ndarray of shape (n_horizons,)
        The weight of its correction.
    stand_in_scale : ndarray of shape (n_horizons, n_outputs)
        The scale of its errors.
    """

    design: Design
    estimators: Mapping[str, Any]
    correction_scales: Mapping[str, Array]
    baselines: Array
    weights: Array
    error_scale: Array
    stand_ins: Array
    stand_in_weights: Array
    stand_in_scale: Array

    def forecast(
        self, recording: Any, track: Track, rows: Indices
    ) -> tuple[Array, Array]:
        """Return the forecasts of some rows, and the scale of their errors.

        Both of shape (n_rows, n_horizons, n_outputs). Forecasts are NaN in rows without
        a past.
        """
        past = track.embedded(self.design.offsets, self.design.embedding)
        is_known = np.isfinite(past[rows]).all(axis=1)
        known = rows[is_known]
        forecasts = np.full((len(rows), *self.error_scale.shape), np.nan)
        scale = np.broadcast_to(self.error_scale, forecasts.shape).copy()
        said = forecasts[is_known]
        for name in np.unique(self.baselines):
            at = self.baselines == name
            said[:, at] = self._corrected(
                name, self.weights, recording, track, past, known
            )[:, at]
        # Where there is no analog yet, something else stands in.
        of_analogs = np.array([name == ANALOGS for name in self.baselines])
        is_lost = np.isnan(said) & of_analogs[:, np.newaxis]
        lost = np.flatnonzero(is_lost.any(axis=(1, 2)))
        if len(lost):
            instead = np.repeat(
                track.outputs[known[lost], np.newaxis], len(self.baselines), axis=1
            )
            for name in np.unique(self.stand_ins):
                if name in self.estimators:
                    at = self.stand_ins == name
                    instead[:, at] = self._corrected(
                        name, self.stand_in_weights, recording, track, past, known[lost]
                    )[:, at]
            said[lost] = np.where(is_lost[lost], instead, said[lost])
            scale[is_known] = np.where(is_lost, self.stand_in_scale, scale[is_known])
        forecasts[is_known] = said
        return forecasts, scale

    def say_chosen(self, recording: Any, track: Track, rows: Indices) -> Array:
        """Return what the baselines of each horizon say of some rows, NaN for none."""
        forecasts = np.full((len(rows), *self.error_scale.shape), np.nan)
        for name in {*self.baselines.tolist()} - {DIRECT}:
            at = self.baselines == name
            forecasts[:, at] = self.say(name, recording, track, rows)[:, at]
        return forecasts

    def say(self, name: str, recording: Any, track: Track, rows: Indices) -> Array:
        """Return what one baseline says of some rows, NaN in those without a past."""
        past = track.embedded(self.design.offsets, self.design.embedding)
        is_known = np.isfinite(past[rows]).all(axis=1)
        forecasts = np.full((len(rows), *self.error_scale.shape), np.nan)
        said = self.design.baselines.say(name, recording, track, past, rows[is_known])
        forecasts[is_known] = said.forecasts
        return forecasts

    def _corrected(
        self,
        name: str,
        weights: Array,
        recording: Any,
        track: Track,
        past: Array,
        rows: Indices,
    ) -> Array:
        """Return what a baseline says, with so much of the correction."""
        fitted, horizons = self.estimators[name], self.design.baselines.horizons
        said = self.design.baselines.say(name, recording, track, past, rows)
        features = np.hstack([past[rows], said.features])
        usable = np.flatnonzero(np.isfinite(features).all(axis=1))
        forecasts = np.full(said.forecasts.shape, np.nan)
        if len(usable):
            step = horizon_step(horizons) if is_operator(fitted) else 1
            ahead = Ahead(horizons // step, self.error_scale.shape[1])
            correction = predict_rows(fitted, features[usable], ahead)
            correction = self.correction_scales[name] * correction
            forecasts[usable] = (
                said.forecasts[usable] + weights[:, np.newaxis] * correction
            )
        return forecasts
