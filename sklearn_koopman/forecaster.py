"""Forecasts of whole recordings, from their own past and from what others taught."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.metrics import r2_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import Tags
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted

from ._forecasting._analogs import Analogs
from ._forecasting._baselines import ANALOGS, CUSTOM, DIRECT, LAST, LINEAR, Baselines
from ._forecasting._blending import blend
from ._forecasting._corrections import Ahead, is_operator, predict_rows
from ._forecasting._tracks import Track, Tracks, as_list, read_tracks
from ._forecasting._training import Design, fit_candidate, horizon_step
from ._utils._embedding import EMBEDDINGS, check_offsets
from ._utils._typing import Array, Indices
from ._utils._validation import check_choice, check_sample_weight
from ._utils._warnings import warn
from .centers import SeparatedCenterSelector
from .search import KoopmanKernelRegressorCV
from .trajectories import TrajectoryKFold

__all__ = ["Analogs", "KoopmanForecaster"]

CANDIDATES = (DIRECT, LAST, LINEAR, ANALOGS)
MAX_FOLDS = 5
# Of the estimator that None stands for.
N_CENTERS = 400
ALPHAS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)


class KoopmanForecaster(RegressorMixin, BaseEstimator):
    """TODO"""

    def __init__(
        self,
        estimator: Any = None,
        *,
        targets: Sequence[str] | Sequence[int] | None = None,
        horizons: Sequence[int] = (1,),
        delays: int | Sequence[int] = (0, 5, 10),
        embedding: str = "copies",
        baseline: str | Analogs | Callable[..., Array] | None = "auto",
        n_jobs: int | None = None,
    ) -> None:
        self.estimator = estimator
        self.targets = targets
        self.horizons = horizons
        self.delays = delays
        self.embedding = embedding
        self.baseline = baseline
        self.n_jobs = n_jobs

    def fit(self, X: Any, y: Any = None) -> Self:
        """TODO"""
        offsets, horizons = self._check_parameters()
        names = self._candidates(has_outputs=y is not None)
        read = read_tracks(X, y, self.targets)
        scale = _spread([track.states for track in read.tracks])
        design = self._design(scale)
        table = design.tabulate(as_list(X, "X"), read.tracks)
        folds = _make_folds(len(read.tracks), design.reach)
        groups = table.groups if len(read.tracks) > 1 else None
        splits = list(folds.split(table.truth, groups=groups))
        estimator = self.estimator
        if estimator is None:
            estimator = _default_estimator(folds)
        candidates = dict(
            zip(
                names,
                Parallel(self.n_jobs)(
                    delayed(fit_candidate)(name, design, table, estimator, splits)
                    for name in names
                ),
                strict=True,
            )
        )
        unit = _spread([track.outputs for track in read.tracks])
        left_out = {name: each.left_out for name, each in candidates.items()}
        mixture = blend(left_out, table.truth, unit)
        chosen = sorted({*mixture.names.tolist()})
        self.estimators_ = {name: candidates[name].fitted for name in chosen}
        self.correction_scales_ = {name: candidates[name].scale for name in chosen}
        self.baselines_ = mixture.names
        self.horizon_weights_ = mixture.weights
        self.error_scale_ = mixture.scale
        self.left_out_errors_ = mixture.errors
        self.column_scale_ = scale
        self.n_outputs_ = table.truth.shape[2]
        self.n_features_in_ = len(read.names)
        if read.has_names:
            self.feature_names_in_ = np.array(read.names, dtype=object)
        elif hasattr(self, "feature_names_in_"):
            del self.feature_names_in_
        return self

    def predict(self, X: Any) -> list[Array]:
        """TODO"""
        check_is_fitted(self)
        design, read = self._design(self.column_scale_), self._read(X)
        return [
            self._predict(design, recording, track, np.arange(len(track.states)))
            for recording, track in zip(as_list(X, "X"), read.tracks, strict=True)
        ]

    def predict_baseline(self, X: Any) -> list[Array]:
        """TODO"""
        check_is_fitted(self)
        design, read = self._design(self.column_scale_), self._read(X)
        said = []
        for recording, track in zip(as_list(X, "X"), read.tracks, strict=True):
            rows = np.arange(len(track.states))
            past = track.embedded(design.offsets, design.embedding)
            forecasts = np.full(
                (len(rows), len(self.baselines_), self.n_outputs_), np.nan
            )
            for name in self.estimators_:
                if name != DIRECT:
                    at = self.baselines_ == name
                    baseline = design.baselines.say(name, recording, track, past, rows)
                    forecasts[:, at] = baseline.forecasts[:, at]
            said.append(forecasts)
        return said

    def forecast(self, X: Any) -> Array:
        """TODO"""
        check_is_fitted(self)
        design, read = self._design(self.column_scale_), self._read(X)
        forecasts = np.concatenate(
            [
                self._predict(
                    design, recording, track, np.array([len(track.states) - 1])
                )
                for recording, track in zip(as_list(X, "X"), read.tracks, strict=True)
            ]
        )
        empty = np.flatnonzero(np.isnan(forecasts).all(axis=(1, 2)))
        if len(empty):
            warn(
                f"{len(empty)} of {len(forecasts)} recordings have no forecast, the "
                f"first is X[{empty[0]}]: their last {design.offsets[-1] + 1} rows hold "
                "a gap, or are too few. Fill short gaps by kinematics.fill_gaps, or "
                "end the recording before the gap."
            )
        return forecasts

    def score(self, X: Any, y: Any = None, sample_weight: Any = None) -> float:
        """TODO"""
        predictions = self.predict(X)
        truth = self._following(X, y)
        weights = check_sample_weight(sample_weight, len(predictions))
        if weights is None:
            weights = np.ones(len(predictions))
        of_rows = np.repeat(weights, [len(each) for each in predictions])
        forecasts, came = np.concatenate(predictions), np.concatenate(truth)
        scores = []
        for at in np.ndindex(forecasts.shape[1:]):
            predicted, true = forecasts[(slice(None), *at)], came[(slice(None), *at)]
            rows = np.isfinite(predicted) & np.isfinite(true) & (of_rows > 0)
            if np.count_nonzero(rows) < 2:
                raise ValueError(
                    f"no two rows have a forecast for horizon {self._horizons()[at[0]]} "
                    "and an output that came; pass longer recordings."
                )
            scores.append(
                r2_score(true[rows], predicted[rows], sample_weight=of_rows[rows])
            )
        return float(np.mean(scores))

    def __sklearn_tags__(self) -> Tags:
        """Tell that a sample is a recording, and that y is not needed."""
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.allow_nan = True
        tags.target_tags.required = False
        tags.target_tags.multi_output = True
        return tags

    def _predict(
        self, design: Design, recording: Any, track: Track, rows: Indices
    ) -> Array:
        """Return the forecasts of some rows of a recording."""
        past = track.embedded(design.offsets, design.embedding)
        horizons = design.baselines.horizons
        forecasts = np.full((len(rows), len(horizons), self.n_outputs_), np.nan)
        for name, fitted in self.estimators_.items():
            said = design.baselines.say(name, recording, track, past, rows)
            features = np.hstack([past[rows], said.features])
            known = np.isfinite(features).all(axis=1)
            each = said.forecasts.copy()
            each[~known] = np.nan
            if known.any():
                step = horizon_step(horizons) if is_operator(fitted) else 1
                ahead = Ahead(horizons // step, self.n_outputs_)
                correction = predict_rows(fitted, features[known], ahead)
                correction *= self.correction_scales_[name]
                each[known] += self.horizon_weights_[:, np.newaxis] * correction
            if name == ANALOGS:  # no analog yet: all remains as it is
                last = track.outputs[rows, np.newaxis]
                each = np.where(np.isnan(each), last, each)
            at = self.baselines_ == name
            forecasts[:, at] = each[:, at]
        forecasts[~np.isfinite(past[rows]).all(axis=1)] = np.nan
        return forecasts

    def _following(self, X: Any, y: Any) -> list[Array]:
        """Return what came, by row and horizon, NaN where that is not known."""
        if (y is None) == (self._has_outputs()):
            ...
        read = self._read(X, y)
        return [track.following(self._horizons()) for track in read.tracks]

    def _read(self, X: Any, y: Any = None) -> Tracks:
        """Read recordings that are to be like those of the fit."""
        read = read_tracks(X, y, self.targets)
        return read

    def _design(self, scale: Array) -> Design:
        """Return how rows are made."""
        offsets, horizons = check_offsets(self.delays, None), self._horizons()
        given = self.baseline if isinstance(self.baseline, Analogs) else Analogs()
        function = self.baseline if callable(self.baseline) else None
        baselines = Baselines(horizons, given.resolve(offsets), scale, function)
        return Design(offsets, self.embedding, baselines)

    def _horizons(self) -> Indices:
        return np.asarray(self.horizons, dtype=np.intp)

    def _check_parameters(self) -> tuple[Indices, Indices]:
        """Validate parameters; return the offsets of the past and the horizons."""
        check_choice(self.embedding, "embedding", EMBEDDINGS)
        offsets = check_offsets(self.delays, None)
        horizons = np.asarray(self.horizons)
        is_list = horizons.ndim == 1 and horizons.dtype.kind in "iu" and len(horizons)
        if (
            not is_list
            or horizons.min() < 1
            or len({*horizons.tolist()}) < len(horizons)
        ):
            raise ValueError(
                "horizons must be a list of different positive numbers of samples, such "
                f"as (15, 30), got {self.horizons!r}."
            )
        return offsets, horizons

    def _candidates(self, *, has_outputs: bool) -> tuple[str, ...]:
        """Return the names of the baselines to try."""
        baseline = self.baseline
        is_free = baseline is None or (isinstance(baseline, str) and baseline == "auto")
        if has_outputs or (self.estimator is not None and is_operator(self.estimator)):
            if not is_free:
                reason = "y is given" if has_outputs else "estimator is an operator"
                raise ValueError(
                    f"baseline={baseline!r} needs the outputs among the columns of X, "
                    f"and an estimator of corrections, but {reason}; leave baseline out."
                )
            return (DIRECT,)
        if baseline is None:
            return (DIRECT,)
        if isinstance(baseline, Analogs):
            return (ANALOGS,)
        if callable(baseline):
            return (CUSTOM,)
        check_choice(baseline, "baseline", (None, "auto", LAST, LINEAR, ANALOGS))
        return CANDIDATES if baseline == "auto" else (str(baseline),)


def _spread(arrays: Sequence[Array]) -> Array:
    """Return the standard deviation of each column, 1 where it is 0."""
    spread = np.nanstd(np.vstack(arrays), axis=0)
    return np.where(spread > 0, spread, 1.0)


def _make_folds(n_recordings: int, gap: int) -> TrajectoryKFold:
    """Return folds that leave out recordings, or blocks of a single one."""
    if n_recordings > 1:
        return TrajectoryKFold(min(n_recordings, MAX_FOLDS))
    return TrajectoryKFold(MAX_FOLDS, gap=gap)


def _default_estimator(folds: TrajectoryKFold) -> Any:
    """Return what estimator=None stands for."""
    return make_pipeline(
        StandardScaler(),
        KoopmanKernelRegressorCV(
            kernels=("matern52",),
            alphas=ALPHAS,
            centers=SeparatedCenterSelector(0, order="farthest", max_centers=N_CENTERS),
            method="least_squares",
            trend="linear",
            cv=folds,
        ),
    )
