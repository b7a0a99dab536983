"""Forecasts of whole recordings, from their own past and from what others taught."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.feature_selection import VarianceThreshold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import Bunch, Tags
from sklearn.utils.validation import check_is_fitted

from ._forecasting._analogs import Analogs
from ._forecasting._bands import (
    bands_about,
    bands_of_models,
    refuse_empty,
    usable_scores,
)
from ._forecasting._baselines import ANALOGS, BASELINES, Baselines, find_candidates
from ._forecasting._blending import compare, mean_r2, positive, spread
from ._forecasting._calibration import GUARANTEES
from ._forecasting._corrections import is_operator, refuse_searches_of_operators
from ._forecasting._mixture import Mixture
from ._forecasting._tracks import (
    Seen,
    Track,
    as_list,
    check_horizons,
    pick_start,
    read_tracks,
)
from ._forecasting._training import Design, train
from ._forecasting._units import as_units, split_units, take
from ._utils._embedding import EMBEDDINGS, check_offsets
from ._utils._typing import Array, Indices
from ._utils._validation import check_choice, check_flag, check_sample_weight
from ._utils._warnings import ExtrapolationWarning, warn
from .centers import SeparatedCenterSelector
from .search import KoopmanKernelRegressorCV
from .trajectories import TrajectoryKFold

__all__ = ["Analogs", "KoopmanForecaster"]

MAX_FOLDS = 5
# Standard deviations from the mean of training to the mean of a recording that has
# other units, or another origin.
FAR = 10.0
# Of the estimator that None stands for.
N_CENTERS = 300
ALPHAS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)


class KoopmanForecaster(RegressorMixin, BaseEstimator):
    r"""Forecast recordings from their own past and from what others taught.

    **A sample is a whole recording**: `X` is a list of arrays or DataFrames, one for
    each trial. A forecast is made of two parts. A *baseline* says what needs no
    learning, such as what followed the moments of the recording's own past that are
    most like the present one (:class:`Analogs`). On top of it a *correction* is learned
    across recordings, by a kernel estimate of the Koopman operator or by any regressor,
    from the state, its past and its deviation from those moments. Errors of recordings
    that were left out choose the baseline, say how much of the correction to believe,
    and make bands that hold.

    New in version 0.1.

    Parameters
    ----------
    estimator : estimator instance, default=None
        What learns the correction: a regressor or pipeline that takes several outputs.
        All horizons are outputs of one fit. None means a scaler and a
        :class:`~sklearn_koopman.KoopmanKernelRegressorCV` with up to 300 centres and a
        linear trend, which chooses its scale and weight by recordings left out. A
        :class:`~sklearn_koopman.KernelEDMD`, or a pipeline that ends in one, forecasts
        by the powers of its operator, without a baseline.
    targets : sequence of str or int, default=None
        The columns of `X` that are forecast, by name or number; None means all. They
        are part of the past, too.
    horizons : sequence of int, default=(1,)
        How many samples ahead, in any order.
    delays : int or sequence of int, default=(0, 5, 10)
        The past that a state holds: the ages of its copies in samples, from 0 on; or
        their number.
    embedding : {"copies", "differences"}, default="copies"
        Copies of earlier samples, or their divided differences, as in
        :func:`~sklearn_koopman.trajectory_pairs`.
    baseline : str, Analogs, callable or None, default="auto"
        To what the correction is learned.

        - None: to nothing; the estimator forecasts by itself.
        - "last": the outputs remain as they are.
        - "linear": they go on as in the last step.
        - "analogs", or :class:`Analogs` with parameters: what followed the windows of
          this recording that are most similar to the present one.
        - a callable of (recording, horizons) that returns an array of shape (n_rows,
          n_horizons, n_outputs), NaN where it has none, each row from rows up to it.
        - "auto": the best of the first four at each horizon. One that speaks of less
          than a tenth of the rows is not chosen. With `y`, or with an operator, None.
    n_jobs : int, default=None
        Number of jobs that fit the baselines of "auto". None means 1 unless in a
        :obj:`joblib.parallel_config` context.

    Attributes
    ----------
    baselines_ : ndarray of str of shape (n_horizons,)
        The baseline at each horizon; "direct" stands for None, "custom" for a callable.
    horizon_weights_ : ndarray of shape (n_horizons,)
        What the correction is multiplied by, between 0 and 1.
    estimators_ : dict of str to estimator
        The fitted estimator of each baseline that is used.
    correction_scales_ : dict of str to ndarray of shape (n_horizons, n_outputs)
        The root mean square of what each of them has learned, in the units of the
        outputs. Estimators see it divided by this.
    left_out_errors_ : dict of str to ndarray of shape (n_horizons, n_outputs)
        Root mean square errors of recordings left out, in the units of the outputs: of
        each baseline alone ("analogs") and corrected ("analogs, corrected").
    error_scale_ : ndarray of shape (n_horizons, n_outputs)
        The same of what is forecast; bands are multiples of it.
    stand_ins_ : ndarray of str of shape (n_horizons,)
        The baseline that stands in where there is no analog: "last"; with "auto" the
        best of the others.
    stand_in_weights_ : ndarray of shape (n_horizons,)
        What its correction is multiplied by; 0 for the last outputs as they are.
    stand_in_scale_ : ndarray of shape (n_horizons, n_outputs)
        The root mean square errors of that.
    horizons_ : ndarray of int of shape (n_horizons,)
        The horizons.
    offsets_ : ndarray of int of shape (n_offsets,)
        The ages of the samples of a state.
    embedding_ : str
        How they are embedded.
    analogs_ : Analogs
        What counts as an analog, with numbers for `window` and `exclusion`.
    targets_ : ndarray of int of shape (n_outputs,)
        The columns that are forecast; none if `fit` was given `y`.
    column_mean_ : ndarray of shape (n_features_in_,)
        The mean of each column in training.
    column_scale_ : ndarray of shape (n_features_in_,)
        The standard deviation of each column in training.
    calibration_ : :class:`~sklearn.utils.Bunch`
        Only after :meth:`conformalize` or :meth:`fit_conformalize`: `method`,
        `guarantee` (what is promised of the rows of a new unit), `n_units`, and the
        errors in units of their scale, `scores`, with the number of the unit of each
        row, `units`, and of the model that left out each unit, `models`; and the
        `quantiles` that were computed so far.
    fold_estimators_ : list of KoopmanForecaster
        Only after :meth:`fit_conformalize`: the models that have left out units.
    takes_outputs_ : bool
        Whether `fit` was given `y`.
    rate_ : float or None
        Samples a second, where an index of time stamps tells them.
    n_outputs_ : int
        Number of outputs.
    output_names_ : ndarray of str of shape (n_outputs_,)
        Their names, numbered ones where the data have none.
    n_features_in_ : int
        Number of columns seen during `fit`.
    feature_names_in_ : ndarray of str of shape (n_features_in_,)
        Their names, where recordings are DataFrames that have some.

    See Also
    --------
    Analogs : The baseline from a recording's own past.
    sklearn_koopman.trajectories.join_recordings : Joins earlier trials to a recording.
    sklearn_koopman.make_horizon_scorer : Scores in a search.
    sklearn_koopman.trajectory_pairs : Rows for regressors, one horizon at a time.

    Notes
    -----
    With the baseline :math:`b_h`, the correction :math:`c_h` and the weight
    :math:`w_h`, the forecast of the outputs h samples after row k is

    .. math:: \hat y_{k+h} = b_h(x_{\le k}) + w_h\, c_h(x_k, x_{k-d_1}, \ldots),
       \quad 0 \le w_h \le 1.

    :math:`c_h` is fitted to :math:`y_{k+h} - b_h`, divided by its root mean square, of
    all rows that have a past and outputs at all horizons. Then recordings are left out,
    in up to five folds (blocks of rows of a single recording), and the weights and the
    baseline of each horizon are those of the smallest squared error, in units of the
    outputs' standard deviations. A search, such as the one that None stands for,
    chooses once, on all recordings.

    Rows that hold NaN, masked values, or follow a hole in an index are gaps. No past,
    no target and nothing that followed an analog reaches across one.

    Nothing of the future enters: the forecast of row k depends on rows up to k alone.

    The cost of `fit` is that of six fits of the estimator for each baseline, and of the
    analogs of all rows, which takes O(T^2) for T rows without `max_past`.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    .. [2] R. Alexander and D. Giannakis, "Operator-theoretic framework for forecasting
       nonlinear time series with kernel analog techniques", Physica D 409, 2020.

    .. [3] Y. Lee, R. F. Barber and R. Willett, "Distribution-free inference with
       hierarchical data", arXiv:2306.06342, 2023.

    .. [4] R. F. Barber, E. J. Candes, A. Ramdas and R. J. Tibshirani, "Predictive
       inference with the jackknife+", Annals of Statistics 49, 2021.

    Examples
    --------
    Where will the ankle be in 0.1 and 0.3 s? Eight persons to learn from, ten to
    calibrate a band, and one who goes on walking:

    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanForecaster
    >>> from sklearn_koopman.datasets import make_walking
    >>> walks = make_walking(1, n_persons=19, n_strides=6, rate=50, random_state=0)
    >>> X = [np.hstack(pair) for pair in zip(walks.trajectories, walks.outputs)]
    >>> forecaster = KoopmanForecaster(
    ...     targets=[2, 3], horizons=[5, 15], delays=(0, 2, 4), baseline="analogs"
    ... )
    >>> forecaster = forecaster.fit(X[:8]).conformalize(X[8:18])
    >>> ankle, band = forecaster.forecast_interval([X[18][:200]], coverage=0.9)
    >>> ankle.shape, band.shape
    ((1, 2, 2), (1, 2, 2, 2))
    """

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
        """Learn the correction, and choose baselines and weights by what is left out.

        A calibration of bands is undone.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings, evenly sampled at one rate, in any units; arrays,
            DataFrames, or both. NaN and masked values are gaps.
        y : list of array-like of shape (n_rows,) or (n_rows, n_outputs), default=None
            Outputs that are measured in training only, and are not part of the past;
            None takes the `targets`. They stand in the rows in which they were
            measured, **not shifted**: the `y` of
            :class:`~sklearn_koopman.KoopmanKernelRegressor` is one step later than its
            row, here the forecaster looks ahead by itself.

        Returns
        -------
        self : KoopmanForecaster
            The fitted forecaster.

        Raises
        ------
        ValueError
            If `X` is no list of recordings with the same columns and rate, or `y` does
            not belong to it; if recordings have no row with a past and with outputs at
            all horizons, which the message names; if both `y` and `targets` are given,
            or `y` and a baseline; if a parameter is outside its range.

        Warns
        -----
        UserWarning
            If angles wrap. Encode them by
            :class:`~sklearn_koopman.kinematics.RotationEncoder`.
        """
        check_choice(self.embedding, "embedding", EMBEDDINGS)
        offsets = check_offsets(self.delays, None)
        horizons = check_horizons(self.horizons)
        refuse_searches_of_operators(self.estimator)
        has_powers = is_operator(self.estimator)
        names = find_candidates(self.baseline, y is not None, has_powers)
        read = read_tracks(X, y, self.targets)
        scale = spread([track.states for track in read.tracks])
        given = self.baseline if isinstance(self.baseline, Analogs) else Analogs()
        analogs = given.resolve(offsets)
        design = self._design(offsets, self.embedding, horizons, analogs, scale)
        table = design.tabulate(as_list(X, "X"), read.tracks)
        learned = train(
            names,
            design,
            table,
            partial(_make_estimator, self.estimator, design.reach),
            _make_folds(table.groups, design.reach),
            spread([track.outputs for track in read.tracks]),
            self.n_jobs,
        )
        for name in ("calibration_", "fold_estimators_", "feature_names_in_"):
            self.__dict__.pop(name, None)
        self.estimators_ = learned.estimators
        self.correction_scales_ = learned.scales
        self.baselines_ = learned.blend.names
        self.horizon_weights_ = learned.blend.weights
        self.left_out_errors_ = learned.blend.errors
        self.error_scale_ = positive(learned.blend.scale)
        self.stand_ins_ = learned.stand_ins.names
        self.stand_in_weights_ = learned.stand_ins.weights
        self.stand_in_scale_ = positive(learned.stand_ins.scale)
        self.horizons_ = horizons
        self.offsets_ = offsets
        self.embedding_ = self.embedding
        self.analogs_ = analogs
        self.targets_ = read.columns
        self.column_mean_ = np.nanmean(
            np.vstack([track.states for track in read.tracks]), axis=0
        )
        self.column_scale_ = scale
        self.n_outputs_ = table.truth.shape[2]
        self.output_names_ = np.array(read.output_names, dtype=object)
        self.n_features_in_ = len(read.names)
        self.takes_outputs_ = y is not None
        self.rate_ = read.rate
        if read.has_names:
            self.feature_names_in_ = np.array(read.names, dtype=object)
        return self

    def predict(self, X: Any) -> list[Array]:
        """Forecast from every row of each recording.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings. None of them needs a fit.

        Returns
        -------
        forecasts : list of ndarray of shape (n_rows, n_horizons, n_outputs)
            Entry k, h is the forecast for row ``k + horizons[h]``, made from rows up to
            k alone, also beyond the end of the recording. NaN in rows whose past is too
            short or holds a gap. Where the past holds no analog yet, the last outputs
            stand in, uncorrected; with "auto" the best of the other baselines.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`.

        Warns
        -----
        ExtrapolationWarning
            If a column is on average 10 standard deviations or more from its mean in
            `fit`, as in other units; or if the estimator warns so.
        """
        return [forecasts for forecasts, _ in self._predict(X)]

    def predict_baseline(self, X: Any) -> list[Array]:
        """Return what the baselines alone say of every row.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.

        Returns
        -------
        forecasts : list of ndarray of shape (n_rows, n_horizons, n_outputs)
            NaN in rows without a forecast, at horizons without a baseline, and where
            the past holds no analog yet, so that something else stands in.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`.
        """
        mixture = self._mixture()
        return [
            mixture.say_chosen(recording, track, np.arange(len(track.states)))
            for recording, track in self._read(X)
        ]

    def forecast(self, X: Any) -> Array:
        """Forecast from the last row of each recording, as :meth:`predict` does.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings up to the present.

        Returns
        -------
        forecasts : ndarray of shape (n_recordings, n_horizons, n_outputs)
            NaN where the past of the last row is too short or holds a gap.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`.

        Warns
        -----
        UserWarning
            If a recording has no forecast.
        """
        forecasts = np.concatenate([f for f, _ in self._predict(X, last_only=True)])
        self._warn_of_none(forecasts)
        return forecasts

    def errors(self, X: Any, y: Any = None) -> list[Array]:
        """Return the errors of the forecasts, predicted less measured.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.

        Returns
        -------
        errors : list of ndarray of shape (n_rows, n_horizons, n_outputs)
            In the units of the outputs. NaN in rows without a forecast, or where the
            recording has ended or a gap comes before the horizon.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`.
        """
        forecasts = self.predict(X)
        truth = self._following(X, y)
        return [f - came for f, came in zip(forecasts, truth, strict=True)]

    def compare(self, X: Any, y: Any = None) -> dict[str, Array]:
        """Return the errors of the forecasts beside those of each baseline alone.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.

        Returns
        -------
        errors : dict of str to ndarray of shape (n_horizons, n_outputs)
            Root mean square errors in the units of the outputs, of the "forecast" and
            of the baselines that `fit` has tried, over the rows that all speak of and
            whose outputs have come at all horizons. A baseline that speaks of less than
            a tenth of the rows is left out.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`, or have no such rows.
        """
        mixture = self._mixture()
        truth = np.concatenate(self._following(X, y))
        said = {"forecast": np.concatenate(self.predict(X))}
        read = self._read(X)
        for name in BASELINES:
            if name in self.left_out_errors_:
                parts = [
                    mixture.say(name, recording, track, np.arange(len(track.states)))
                    for recording, track in read
                ]
                said[name] = np.concatenate(parts)
        return compare(said, truth)

    def explain(
        self, recording: Any, y: Any = None, *, start: int | None = None
    ) -> Bunch:
        """Return what the forecast from one row is made of.

        Parameters
        ----------
        recording : array-like of shape (n_rows, n_features)
            One recording.
        y : array-like of shape (n_rows,) or (n_rows, n_outputs), default=None
            The outputs, if `fit` was given some.
        start : int, default=None
            The row to forecast from. None for the last one whose outputs have come at
            all horizons; for the last one that has a forecast if there is none.

        Returns
        -------
        parts : :class:`~sklearn.utils.Bunch`
            With the attributes

            start : int
                The row.
            outputs : ndarray of shape (n_rows, n_outputs)
                The outputs of the whole recording.
            forecast : ndarray of shape (n_horizons, n_outputs)
                As :meth:`predict` returns it.
            baseline : ndarray of shape (n_horizons, n_outputs)
                As :meth:`predict_baseline` returns it.
            window : int
                The number of rows up to the present one that are compared to the past.
            analogs : ndarray of int of shape (n_horizons, n_analogs)
                The rows that are most similar, the nearest first; -1 where there are
                fewer, or at horizons with another baseline.
            weights : ndarray of shape (n_horizons, n_analogs)
                Their weights, which sum to 1, or are 0 where there is no analog.

        Raises
        ------
        ValueError
            If the recording is not like those of `fit`, or has no forecast there.
        """
        check_is_fitted(self)
        if isinstance(recording, list | tuple | dict):
            raise ValueError(
                "recording must be one array or DataFrame, got "
                f"{type(recording).__name__}; pass one of its items."
            )
        outputs = None if y is None else [y]
        (came,) = self._following([recording], outputs)
        ((_, track),) = self._read([recording], outputs)
        mixture = self._mixture()
        design = mixture.design
        past = track.embedded(design.offsets, design.embedding)
        start = pick_start(past, came, start)
        rows = np.array([start])
        found = design.baselines.find(track, rows)
        has_analogs = (self.baselines_ == ANALOGS)[:, np.newaxis]
        return Bunch(
            start=start,
            outputs=track.outputs,
            forecast=mixture.forecast(recording, track, rows)[0][0],
            baseline=mixture.say_chosen(recording, track, rows)[0],
            window=design.baselines.analogs.window,
            analogs=np.where(has_analogs, found.places[0, 1:], -1),
            weights=np.where(has_analogs, found.weights[0, 1:], 0.0),
        )

    def score(self, X: Any, y: Any = None, sample_weight: Any = None) -> float:
        """Return R², averaged over horizons and outputs.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.
        sample_weight : array-like of shape (n_recordings,), default=None
            The weight of each recording; each of its rows has it.

        Returns
        -------
        score : float
            Over all rows that have a forecast and whose outputs have come; 1 is
            perfect, and a forecast of the mean has 0.

        Raises
        ------
        ValueError
            If no rows can be scored at some horizon.
        """
        with warnings.catch_warnings():
            # Recordings left out may well be far from the others.
            warnings.simplefilter("ignore", ExtrapolationWarning)
            forecasts = self.predict(X)
        truth = self._following(X, y)
        weights = check_sample_weight(sample_weight, len(forecasts))
        if weights is None:
            weights = np.ones(len(forecasts))
        of_rows = np.repeat(weights, [len(each) for each in forecasts])
        return mean_r2(np.concatenate(forecasts), np.concatenate(truth), of_rows)

    def conformalize(
        self, X: Any, y: Any = None, *, groups: Any = None, method: str = "draws"
    ) -> Self:
        """Calibrate bands on recordings that `fit` has not seen.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            Recordings to calibrate on.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.
        groups : array-like of shape (n_recordings,), default=None
            The unit, such as a person, that each recording belongs to. None takes each
            recording as a unit. K units support a coverage of at most K / (K + 1).
        method : {"draws", "mixture"}, default="draws"
            How wide the bands are, in terms of the errors divided by `error_scale_`.

            - "mixture": as the quantile of the mixture in which each unit has the mass
              1 / (K + 1), spread over its rows, and infinity has 1 / (K + 1) [3]_. At
              least the coverage is covered, whatever the errors; up to 1 / (K + 1)
              more.
            - "draws": as the expected quantile of one error of each unit, drawn at
              random. Each draw covers at least what is asked, and so does their mean
              if larger errors are rarer, over the range of these quantiles. It is
              narrower, and covers 1 or 2 % more than is asked in most cases; less than
              is asked where errors have a second hump, as those of a bad forecast of
              an oscillation.

        Returns
        -------
        self : KoopmanForecaster
            The forecaster, with `calibration_`.

        Raises
        ------
        ValueError
            If the recordings are not like those of `fit`, or `groups` does not have one
            label for each.

        Notes
        -----
        The coverage is the expected share of the rows of a new unit whose outputs lie
        in the band. It is promised for units that are **exchangeable** with those that
        calibrate: drawn alike, so that any order of them would be as likely. Persons
        drawn from one population are; a speed beyond all learned is not, and neither
        are other trials of a person if the new recording is of another one.
        """
        check_is_fitted(self)
        check_choice(method, "method", ("draws", "mixture"))
        parts = self._scores(X, y)
        refuse_empty(parts)
        units = as_units(groups, len(parts))
        self.__dict__.pop("fold_estimators_", None)
        self.calibration_ = Bunch(
            method=method,
            guarantee=GUARANTEES[method],
            scores=np.concatenate(parts),
            units=np.repeat(units, [len(part) for part in parts]),
            n_units=len(np.unique(units)),
            quantiles={},
        )
        return self

    def fit_conformalize(
        self,
        X: Any,
        y: Any = None,
        *,
        groups: Any = None,
        cv: Any = None,
        method: str = "plus",
    ) -> Self:
        """Fit, and calibrate bands on the same recordings, leaving out each in turn.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        y : list of array-like, default=None
            Outputs that are measured in training only.
        groups : array-like of shape (n_recordings,), default=None
            The unit, such as a person, that each recording belongs to. None takes each
            recording as a unit.
        cv : int or splitter, default=None
            How units are left out: one at a time, in so many folds, or as a splitter of
            recordings by groups says.
        method : {"plus", "minmax", "pooled"}, default="plus"
            - "plus": jackknife+ [4]_. For a coverage of 1 - alpha, at least 1 - 2 alpha
              are promised, and 1 - alpha are usual. A band need not hold the forecast.
            - "minmax": jackknife-minmax, wider; at least 1 - alpha.
            - "pooled": the quantile of the errors of all rows left out, about the
              forecasts. Nothing is promised; for a handful of trials, which support no
              coverage of 90 %.

        Returns
        -------
        self : KoopmanForecaster
            The forecaster, with `calibration_`; but for "pooled" also with
            `fold_estimators_`. Each of them makes its own choices.

        Raises
        ------
        ValueError
            As in :meth:`fit`, if there are less than two units, or if `cv` leaves out a
            unit twice, or parts of one.
        """
        check_choice(method, "method", ("plus", "minmax", "pooled"))
        recordings = as_list(X, "X")
        units = as_units(groups, len(recordings))
        folds = split_units(units, cv)
        models, scores = [], [np.empty(0)] * len(recordings)
        model_of = np.zeros(len(np.unique(units)), dtype=np.intp)
        for number, (kept, test) in enumerate(folds):
            model = clone(self).fit(*take(recordings, y, kept))
            with warnings.catch_warnings():
                # A person left out may well be far from the others.
                warnings.simplefilter("ignore", ExtrapolationWarning)
                parts = model._scores(*take(recordings, y, test))
            for place, part in zip(test, parts, strict=True):
                scores[place] = part
            models.append(model)
            model_of[units[test]] = number
        refuse_empty(scores)
        self.fit(X, y)
        if method != "pooled":
            self.fold_estimators_ = models
        self.calibration_ = Bunch(
            method=method,
            guarantee=GUARANTEES[method],
            scores=np.concatenate(scores),
            units=np.repeat(units, [len(part) for part in scores]),
            n_units=len(model_of),
            models=model_of,
            quantiles={},
        )
        return self

    def predict_interval(
        self, X: Any, *, coverage: float = 0.9, simultaneous: bool = False
    ) -> tuple[list[Array], list[Array]]:
        """Forecast from every row, with bands that hold.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        coverage : float, default=0.9
            The share of rows, expected of a new unit, whose outputs are in the band.
        simultaneous : bool, default=False
            Whether a row counts as covered only if all horizons and outputs are, or
            each for itself.

        Returns
        -------
        forecasts : list of ndarray of shape (n_rows, n_horizons, n_outputs)
            As :meth:`predict` returns them.
        intervals : list of ndarray of shape (n_rows, n_horizons, n_outputs, 2)
            Lower and upper ends, in the units of the outputs.

        Raises
        ------
        ValueError
            If bands are not calibrated, or fewer units have calibrated them than
            `coverage` needs: 9 for 90 %, 19 for 95 %.
        """
        predicted, bands = [], []
        for forecasts, band in self._bands(X, coverage, simultaneous):
            predicted.append(forecasts)
            bands.append(band)
        return predicted, bands

    def forecast_interval(
        self, X: Any, *, coverage: float = 0.9, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """Forecast from the last row of each recording, with bands that hold.

        Parameters
        ----------
        X : list of array-like of shape (n_rows, n_features)
            The recordings up to the present.
        coverage : float, default=0.9
            As in :meth:`predict_interval`.
        simultaneous : bool, default=False
            As in :meth:`predict_interval`.

        Returns
        -------
        forecasts : ndarray of shape (n_recordings, n_horizons, n_outputs)
            As :meth:`forecast` returns them.
        intervals : ndarray of shape (n_recordings, n_horizons, n_outputs, 2)
            Lower and upper ends, in the units of the outputs.

        Raises
        ------
        ValueError
            As in :meth:`predict_interval`.

        Warns
        -----
        UserWarning
            If a recording has no forecast.
        """
        pairs = list(self._bands(X, coverage, simultaneous, last_only=True))
        forecasts, bands = map(np.concatenate, zip(*pairs, strict=True))
        self._warn_of_none(forecasts)
        return forecasts, bands

    def __sklearn_tags__(self) -> Tags:
        """Tell that a sample is a recording, and that y is not needed."""
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        tags.input_tags.allow_nan = True
        tags.target_tags.required = False
        tags.target_tags.multi_output = True
        return tags

    def _predict(
        self, X: Any, *, last_only: bool = False
    ) -> Iterator[tuple[Array, Array]]:
        """Yield the forecasts of each recording, and the scale of their errors."""
        mixture, read = self._mixture(), self._read(X)
        self._warn_of_far([track for _, track in read])
        for recording, track in read:
            rows = np.arange(len(track.states))[-1 if last_only else 0 :]
            yield mixture.forecast(recording, track, rows)

    def _mixture(self) -> Mixture:
        """Return what was learned and chosen."""
        check_is_fitted(self)
        return Mixture(
            self._design(
                self.offsets_,
                self.embedding_,
                self.horizons_,
                self.analogs_,
                self.column_scale_,
            ),
            self.estimators_,
            self.correction_scales_,
            self.baselines_,
            self.horizon_weights_,
            self.error_scale_,
            self.stand_ins_,
            self.stand_in_weights_,
            self.stand_in_scale_,
        )

    def _scores(self, X: Any, y: Any) -> list[Array]:
        """Return the sizes of the errors of each recording, in units of their scale."""
        pairs, truth = self._predict(X), self._following(X, y)
        return [
            np.abs(forecasts - came) / scale
            for (forecasts, scale), came in zip(pairs, truth, strict=True)
        ]

    def _bands(
        self, X: Any, coverage: float, simultaneous: bool, *, last_only: bool = False
    ) -> Iterator[tuple[Array, Array]]:
        """Return the forecasts and the intervals of each recording."""
        check_is_fitted(self)
        check_flag(simultaneous, "simultaneous")
        if not hasattr(self, "calibration_"):
            raise ValueError(
                "bands are not calibrated: call conformalize with recordings that fit "
                "has not seen, or fit_conformalize instead of fit, which undoes a "
                "calibration."
            )
        made = self.calibration_
        scores = usable_scores(made, coverage, simultaneous)
        pairs = self._predict(X, last_only=last_only)
        if not hasattr(self, "fold_estimators_"):
            return bands_about(pairs, made, scores, coverage)
        by_model = [
            model._predict(X, last_only=last_only) for model in self.fold_estimators_
        ]
        return bands_of_models(pairs, by_model, made, scores, coverage)

    def _following(self, X: Any, y: Any) -> list[Array]:
        """Return what came at each horizon, NaN where that is not known."""
        if (y is not None) != self.takes_outputs_:
            had = "was" if self.takes_outputs_ else "was not"
            raise ValueError(
                f"fit {had} given y; pass the outputs here in the same way."
            )
        horizons = self.horizons_
        return [track.following(horizons) for _, track in self._read(X, y)]

    def _read(self, X: Any, y: Any = None) -> list[tuple[Any, Track]]:
        """Read recordings, which are to have the columns of those of `fit`."""
        names = getattr(self, "feature_names_in_", None)
        seen = Seen(
            [f"x{number}" for number in range(self.n_features_in_)]
            if names is None
            else names.tolist(),
            names is not None,
            self.rate_,
            self.n_outputs_ if self.takes_outputs_ else None,
        )
        targets = None if self.takes_outputs_ else self.targets_.tolist()
        tracks = read_tracks(X, y, targets, seen).tracks
        return list(zip(as_list(X, "X"), tracks, strict=True))

    def _warn_of_none(self, forecasts: Array) -> None:
        """Warn of recordings whose last row has no forecast."""
        empty = np.flatnonzero(np.isnan(forecasts).all(axis=(1, 2)))
        if len(empty):
            n_rows = self.offsets_[-1] + 1
            warn(
                f"{len(empty)} of {len(forecasts)} recordings have no forecast, the "
                f"first is X[{empty[0]}]: their last {n_rows} rows hold a gap, or are "
                "fewer. Fill short gaps by kinematics.fill_gaps, or end recordings "
                "before a gap."
            )

    def _warn_of_far(self, tracks: Sequence[Track]) -> None:
        """Warn of columns that are nowhere near those of the fit."""
        for number, track in enumerate(tracks):
            states = track.states[track.piece >= 0]
            if not len(states):
                continue
            distance = np.abs(states.mean(axis=0) - self.column_mean_)
            column = int((distance / self.column_scale_).argmax())
            if distance[column] > FAR * self.column_scale_[column]:
                names = getattr(self, "feature_names_in_", range(len(distance)))
                warn(
                    f"column {names[column]!r} of X[{number}] is at "
                    f"{states[:, column].mean():.4g} on average, those of fit were at "
                    f"{self.column_mean_[column]:.4g}, with a standard deviation of "
                    f"{self.column_scale_[column]:.4g}. Give X the units of the "
                    "recordings of fit.",
                    ExtrapolationWarning,
                )
                return

    def _design(
        self,
        offsets: Indices,
        embedding: str,
        horizons: Indices,
        analogs: Analogs,
        scale: Array,
    ) -> Design:
        """Return how rows are made."""
        function = self.baseline if callable(self.baseline) else None
        return Design(offsets, embedding, Baselines(horizons, analogs, scale, function))


def _make_folds(groups: Indices, gap: int) -> TrajectoryKFold:
    """Return folds that leave out recordings, or blocks of a single one."""
    n_recordings = len(np.unique(groups))
    if n_recordings > 1:
        return TrajectoryKFold(min(n_recordings, MAX_FOLDS))
    return TrajectoryKFold(MAX_FOLDS, gap=gap)


def _make_estimator(estimator: Any, gap: int, groups: Indices) -> Any:
    """Return the estimator of a forecaster, for rows of these recordings."""
    if estimator is not None:
        return estimator
    return make_pipeline(
        VarianceThreshold(),  # what is constant would not be told from the intercept
        StandardScaler(),
        KoopmanKernelRegressorCV(
            kernels=("matern52",),
            alphas=ALPHAS,
            centers=SeparatedCenterSelector(0, order="farthest", max_centers=N_CENTERS),
            method="least_squares",
            trend="linear",
            cv=_make_folds(groups, gap),
        ),
    )
