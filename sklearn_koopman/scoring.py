"""Scores of forecasts over several steps, for cross-validation by trajectories."""

from __future__ import annotations

import sys
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Real
from types import FrameType
from typing import Any

import numpy as np
from sklearn.utils import check_array, check_consistent_length, gen_batches
from sklearn.utils.metadata_routing import MetadataRequest

from ._utils._frames import index_level
from ._utils._labels import order_of_labels
from ._utils._pipeline import find_operator, transformed, unwrap
from ._utils._recordings import read_recordings
from ._utils._typing import Array, Indices, Mask
from ._utils._validation import (
    as_floats,
    check_flag,
    check_integer,
    check_number,
    check_sample_weight,
    refuse_masked,
)
from ._utils._warnings import ExtrapolationWarning
from .trajectories import match_successors, successor_rows

__all__ = [
    "ForecastScorer",
    "HorizonErrorScorer",
    "RecordingErrorScorer",
    "ValidTimeScorer",
    "make_forecast_scorer",
    "make_horizon_scorer",
    "make_valid_time_scorer",
]

# Largest number of forecast outputs that are held at once: 32 MB.
MAX_ENTRIES = 2**22


def make_forecast_scorer(
    n_steps: int,
    *,
    discount: float = 1.0,
    relift: bool = False,
    error_score: str | float = np.nan,
) -> HorizonErrorScorer:
    """Make a scorer of the error of forecasts over a horizon.

    The score is minus the root mean square error of the forecasts, in the unit of the
    outputs. The mean runs over the steps up to `n_steps`, over all outputs, and over
    all starts: the rows that are followed by `n_steps` rows on their trajectory.

    .. math:: -\\Big(\\frac{\\sum_{s=1}^{S} \\gamma^{s-1} \\, e_s^2}
        {\\sum_{s=1}^{S} \\gamma^{s-1}}\\Big)^{1/2}

    where :math:`e_s^2` is the mean square error after s steps and :math:`\\gamma` the
    discount.

    Parameters
    ----------
    n_steps : int
        The horizon S, in steps.
    discount : float, default=1.0
        Weight of each step relative to the one before, above 0 and at most 1.
    relift : bool, default=False
        Whether to relift forecasts: after each step, the operator is applied anew to
        the forecast state. Passed to :meth:`KernelEDMD.forecast`.
    error_score : "raise" or float, default=nan
        The score if a forecast diverges beyond the range of a double; "raise" raises a
        ValueError instead. Forecasts that diverge to finite numbers are scored as they
        are.

    Returns
    -------
    scorer : HorizonErrorScorer
        A callable ``scorer(estimator, X, y=None, sample_index=None)`` for a fitted
        :class:`~sklearn_koopman.KernelEDMD` or a pipeline that ends in one. Pass it as
        `scoring` to :class:`~sklearn.model_selection.GridSearchCV` and the like.
        Without `y` the outputs are the states, as the pipeline transforms them.

    Raises
    ------
    ValueError
        If a parameter is outside its range. The scorer raises one if it cannot find out
        which rows follow each other, or if no row is followed by `n_steps` others.

    See Also
    --------
    make_valid_time_scorer : Counts the steps until the error passes a tolerance.

    Notes
    -----
    Forecasts are compared with the outputs of later rows, so the scorer needs to know
    which of the held-out rows follow each other. It uses the first of these sources:

    1. `sample_index`. In a search it is given to ``fit``, and reaches the scorer if
       metadata routing is enabled.
    2. The level "sample_index" of the index of `X`, else of `y`: the data frames of
       :func:`trajectory_pairs` need no metadata routing.
    3. `y`, if its columns are adjacent columns of the states. A row is followed by the
       row whose state has these values, provided that there is only one.
    4. The order of the rows, if the estimator was fitted to one trajectory in that
       order. Labels of a data frame, such as frame numbers, show the holes in it.

    Otherwise it raises an error, in a search, too, whatever its `error_score`. A score
    takes the time of the forecasts from all starts. At most 4 million forecast outputs
    are held in memory at once.

    Examples
    --------
    >>> from sklearn.model_selection import GridSearchCV
    >>> from sklearn_koopman import KernelEDMD, TrajectoryKFold, make_forecast_scorer
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> pendulum = make_pendulum(40, initial=[[0, 1.0], [0, 1.5], [0, 2.0]])
    >>> search = GridSearchCV(
    ...     KernelEDMD(trend="linear", n_modes=0),
    ...     {"beta": [0.1, 10.0]},
    ...     scoring=make_forecast_scorer(20),
    ...     cv=TrajectoryKFold(3),
    ... )
    >>> search = search.fit(
    ...     pendulum.X, pendulum.X_next, groups=pendulum.groups,
    ...     sample_index=pendulum.sample_index,
    ... )
    >>> search.best_params_
    {'beta': 10.0}
    """
    check_integer(n_steps, "n_steps", 1)
    check_number(discount, "discount", positive=True)
    if discount > 1:
        raise ValueError(f"discount must be at most 1, got {discount!r}.")
    check_flag(relift, "relift")
    number: Any = error_score
    if number != "raise" and (isinstance(number, bool) or not isinstance(number, Real)):
        raise ValueError(f"error_score must be 'raise' or a number, got {number!r}.")
    return HorizonErrorScorer(n_steps, relift, float(discount), error_score)


def make_valid_time_scorer(
    n_steps: int, tolerance: float, *, relift: bool = False
) -> ValidTimeScorer:
    """Make a scorer that counts the steps until the error passes a tolerance.

    The error of a forecast is the Euclidean distance of predicted and true outputs. The
    score is the number of steps before the error first exceeds `tolerance`, or
    `n_steps` if it never does. It is averaged over the rows that are followed by
    `n_steps` rows on their trajectory.

    Parameters
    ----------
    n_steps : int
        The largest number of steps that is counted.
    tolerance : float
        The largest error that counts as valid, in the unit of the outputs.
    relift : bool, default=False
        Whether to relift forecasts: after each step, the operator is applied anew to
        the forecast state. Passed to :meth:`KernelEDMD.forecast`.

    Returns
    -------
    scorer : ValidTimeScorer
        A callable like that of :func:`make_forecast_scorer`, which needs to know in the
        same way which rows follow each other.

    Raises
    ------
    ValueError
        If a parameter is outside its range. The scorer raises one if it cannot find out
        which rows follow each other, or if no row is followed by `n_steps` others.

    See Also
    --------
    make_forecast_scorer : The error over a horizon.

    Examples
    --------
    >>> from sklearn_koopman import KernelEDMD, make_valid_time_scorer
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> pendulum = make_pendulum(300)
    >>> model = KernelEDMD("wendland_c4", beta=4.0).fit(pendulum.X[:90])
    >>> make_valid_time_scorer(100, tolerance=0.01)(model, pendulum.X)
    100.0
    """
    check_integer(n_steps, "n_steps", 1)
    check_number(tolerance, "tolerance", positive=True)
    check_flag(relift, "relift")
    return ValidTimeScorer(n_steps, relift, float(tolerance))


def make_horizon_scorer(
    start: int, *, horizon: int | None = None
) -> RecordingErrorScorer:
    """Make a scorer of the errors of a forecaster of whole recordings.

    The score is minus the root mean square error, in the unit of the outputs. The mean
    runs over the rows from `start` on whose outputs came, then over outputs and
    horizons, which count alike.

    New in version 0.1.

    Parameters
    ----------
    start : int
        The first row of a recording that is scored; after a gap, rows count anew. The
        largest delay of all candidates of a search, at least: longer pasts have fewer
        forecasts, and candidates are compared on the same rows. More, to leave out the
        beginning of recordings, where there are no analogs yet.
    horizon : int, default=None
        The one of the forecaster's `horizons` that is scored; None takes all.

    Returns
    -------
    scorer : RecordingErrorScorer
        A callable ``scorer(estimator, X, y=None, sample_weight=None)`` for a fitted
        :class:`~sklearn_koopman.KoopmanForecaster`, or a pipeline or search that ends
        in one. Pass it as `scoring` to :class:`~sklearn.model_selection.GridSearchCV`
        and the like. `sample_weight` is one number a recording. It reaches the scorer
        if metadata routing is enabled.

    Raises
    ------
    ValueError
        If a parameter is outside its range. The scorer raises one if a row from `start`
        on has no forecast, which the message says how to mend; if no row can be scored
        at some horizon; and where :meth:`KoopmanForecaster.errors` raises. Searches
        give such a candidate their `error_score`, and warn.

    See Also
    --------
    sklearn_koopman.KoopmanForecaster : What is scored; its own score is R².

    Examples
    --------
    Choose the delays by persons left out, 0.1 s ahead:

    >>> import numpy as np
    >>> from sklearn.linear_model import Ridge
    >>> from sklearn.model_selection import GridSearchCV, GroupKFold
    >>> from sklearn_koopman import KoopmanForecaster, make_horizon_scorer
    >>> from sklearn_koopman.datasets import make_walking
    >>> walks = make_walking(6, n_strides=3, rate=50, random_state=0)
    >>> X = [np.hstack(pair) for pair in zip(walks.trajectories, walks.outputs)]
    >>> search = GridSearchCV(
    ...     KoopmanForecaster(Ridge(), targets=[2, 3], horizons=[5, 10], baseline=None),
    ...     {"delays": [(0,), (0, 2, 4), (0, 5, 10)]},
    ...     scoring=make_horizon_scorer(10, horizon=5),
    ...     cv=GroupKFold(3),
    ... )
    >>> search.fit(X, groups=[0, 0, 1, 1, 2, 2]).best_params_
    {'delays': (0, 2, 4)}
    """
    check_integer(start, "start", 0)
    if horizon is not None:
        check_integer(horizon, "horizon", 1)
    return RecordingErrorScorer(start, horizon)


@dataclass(frozen=True)
class ForecastScorer(ABC):
    """Base class of scorers that compare forecasts with what followed.

    Attributes
    ----------
    n_steps : int
        The number of steps that are forecast.
    relift : bool
        Passed to :meth:`KernelEDMD.forecast`.

    See Also
    --------
    make_forecast_scorer : Makes a scorer of the error over a horizon.
    make_valid_time_scorer : Makes a scorer that counts valid steps.
    """

    n_steps: int
    relift: bool

    def __call__(
        self, estimator: Any, X: Any, y: Any = None, sample_index: Any = None
    ) -> float:
        """Score a fitted estimator on held-out rows.

        Parameters
        ----------
        estimator : KernelEDMD or Pipeline
            The fitted estimator.
        X : array-like of shape (n_samples, n_features)
            The states.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
            The outputs one step after each row; by default the states.
        sample_index : array-like of shape (n_samples,), default=None
            The place of each row on its trajectory, as
            :func:`~sklearn_koopman.trajectory_pairs` returns it.

        Returns
        -------
        score : float
            The score; greater is better.

        Raises
        ------
        TypeError
            If the estimator has no method `forecast`.
        ValueError
            If it is not known which rows follow each other, if no row is followed by
            `n_steps` others, or if `y` has another number of outputs than the forecast.
        """
        refuse_masked(X=X, y=y, sample_index=sample_index)
        check_consistent_length(X, y, sample_index)
        operator, front = find_operator(estimator)
        try:
            following = _following_rows(operator, X, y, sample_index)
        except ValueError as error:
            if _is_hidden_from_user():
                return error  # type: ignore[return-value]
            raise
        X = transformed(front, X)
        outputs = check_array(X if y is None else y, dtype=np.float64, ensure_2d=False)
        outputs = outputs.reshape(len(following), -1)
        # Given outputs of a row are those one step after it, states those of the row.
        steps = _rows_ahead(following, self.n_steps, 1 if y is None else 0)
        starts = np.flatnonzero(steps[:, -1] >= 0)
        if len(starts) == 0:
            raise ValueError(
                f"None of the {len(steps)} held-out rows is followed by n_steps="
                f"{self.n_steps} rows; lower n_steps, or hold out whole trajectories."
            )
        squared = self._squared_errors(operator, X, outputs, starts, steps[starts])
        with np.errstate(over="ignore", invalid="ignore"):
            return self._score(squared, outputs.shape[1])

    def get_metadata_routing(self) -> MetadataRequest:
        """Request `sample_index`, from which the successors of rows follow.

        Returns
        -------
        routing : MetadataRequest
            The request.
        """
        request = MetadataRequest(owner=self)
        request.score.add_request(param="sample_index", alias=True)
        return request

    def _squared_errors(
        self, operator: Any, X: Any, outputs: Array, starts: Indices, steps: Indices
    ) -> Array:
        """Return squared errors of the forecasts, of shape (n_starts, n_steps)."""
        n_outputs = outputs.shape[1]
        take = X.iloc if hasattr(X, "iloc") else np.asarray(X)  # frames have names
        errors = []
        n_rows = max(MAX_ENTRIES // (self.n_steps * n_outputs), 1)
        for batch in gen_batches(len(starts), n_rows):
            with warnings.catch_warnings():
                # Divergence, and starts far from the data, show in the score.
                warnings.simplefilter("ignore", RuntimeWarning)
                warnings.simplefilter("ignore", ExtrapolationWarning)
                y_pred = operator.forecast(
                    take[starts[batch]], self.n_steps, relift=self.relift
                )
            y_pred = y_pred.reshape(*steps[batch].shape, -1)
            if y_pred.shape[2] != n_outputs:
                raise ValueError(
                    f"y has {n_outputs} outputs, but the estimator forecasts "
                    f"{y_pred.shape[2]}; pass outputs like those of its fit."
                )
            with np.errstate(over="ignore", invalid="ignore"):
                errors.append(np.square(y_pred - outputs[steps[batch]]).sum(axis=2))
        return np.concatenate(errors)

    @abstractmethod
    def _score(self, squared: Array, n_outputs: int) -> float:
        """Return the score for squared distances of shape (n_starts, n_steps)."""


@dataclass(frozen=True)
class HorizonErrorScorer(ForecastScorer):
    """Scorer of the error over a horizon; see :func:`make_forecast_scorer`.

    Attributes
    ----------
    n_steps : int
        The horizon, in steps.
    relift : bool
        Passed to :meth:`KernelEDMD.forecast`.
    discount : float
        Weight of each step relative to the one before.
    error_score : "raise" or float
        The score if a forecast diverges beyond the range of a double.

    See Also
    --------
    make_forecast_scorer : Makes one, with checks of the parameters.
    """

    discount: float
    error_score: str | float

    def _score(self, squared: Array, n_outputs: int) -> float:
        weights = self.discount ** np.arange(self.n_steps)
        mean = np.average(squared.mean(axis=0), weights=weights)
        if np.isfinite(mean):
            return -float(np.sqrt(mean / n_outputs))
        if isinstance(self.error_score, str):
            raise ValueError(
                f"A forecast of n_steps={self.n_steps} has left the range of numbers; "
                "lower n_steps, or set error_score to a number."
            )
        return float(self.error_score)


@dataclass(frozen=True)
class ValidTimeScorer(ForecastScorer):
    """Scorer that counts valid steps; see :func:`make_valid_time_scorer`.

    Attributes
    ----------
    n_steps : int
        The largest number of steps that is counted.
    relift : bool
        Passed to :meth:`KernelEDMD.forecast`.
    tolerance : float
        The largest error that counts as valid, in the unit of the outputs.

    See Also
    --------
    make_valid_time_scorer : Makes one, with checks of the parameters.
    """

    tolerance: float

    def _score(self, squared: Array, n_outputs: int) -> float:
        # Comparisons with NaN are false: forecasts that end count as errors.
        within = squared <= self.tolerance**2
        return float(np.logical_and.accumulate(within, axis=1).sum(axis=1).mean())


@dataclass(frozen=True)
class RecordingErrorScorer:
    """Scorer of forecasts of whole recordings; see :func:`make_horizon_scorer`.

    Attributes
    ----------
    start : int
        The first row of a recording, or after a gap, that is scored.
    horizon : int or None
        The horizon, in samples; None stands for all.

    See Also
    --------
    make_horizon_scorer : Makes one, with checks of the parameters.
    """

    start: int
    horizon: int | None

    def __call__(
        self, estimator: Any, X: Any, y: Any = None, sample_weight: Any = None
    ) -> float:
        """Score a fitted forecaster on recordings that were held out.

        Parameters
        ----------
        estimator : KoopmanForecaster or Pipeline
            The fitted estimator.
        X : list of array-like of shape (n_rows, n_features)
            The recordings.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.
        sample_weight : array-like of shape (n_recordings,), default=None
            The weight of each recording; each of its rows has it.

        Returns
        -------
        score : float
            The score; greater is better.

        Raises
        ------
        TypeError
            If the estimator is no forecaster of recordings.
        ValueError
            If a row has no forecast, if no row can be scored at some horizon, or where
            :meth:`KoopmanForecaster.errors` raises.
        """
        forecaster, front = unwrap(estimator)
        if not hasattr(forecaster, "errors"):
            raise TypeError(
                f"{type(forecaster).__name__} has no method errors; score a "
                "KoopmanForecaster, or a pipeline or fitted search that ends in one."
            )
        X = transformed(front, X)
        errors = forecaster.errors(X, y)
        weights = check_sample_weight(sample_weight, len(errors))
        if weights is None:
            weights = np.ones(len(errors))
        columns, horizons = self._find_horizons(forecaster.horizons_)
        squares = np.concatenate(self._score_rows(X, y, errors, columns, horizons)) ** 2
        of_rows = np.repeat(weights, [len(each) for each in errors])[:, None, None]
        mass = np.sum(of_rows * np.isfinite(squares), axis=0)
        if np.min(mass) == 0:
            horizon = horizons[np.min(mass, axis=1).argmin()]
            raise ValueError(
                f"no row from start={self.start} on has outputs that came {horizon} "
                "rows later; lower start, or score longer recordings."
            )
        return -float(np.sqrt(np.mean(np.nansum(of_rows * squares, axis=0) / mass)))

    def get_metadata_routing(self) -> MetadataRequest:
        """Request `sample_weight`, one number a recording.

        Returns
        -------
        routing : MetadataRequest
            The request.
        """
        request = MetadataRequest(owner=self)
        request.score.add_request(param="sample_weight", alias=True)
        return request

    def _find_horizons(self, horizons: Any) -> tuple[Indices, Indices]:
        """Return the places of the horizons that are scored, and themselves."""
        known = np.asarray(horizons)
        columns = np.arange(len(known))
        if self.horizon is not None:
            columns = np.flatnonzero(known == self.horizon)
            if not len(columns):
                raise ValueError(
                    f"horizon={self.horizon} is none of the forecaster's horizons, "
                    f"{known.tolist()}; name one of them."
                )
        return columns, known[columns]

    def _score_rows(
        self, X: Any, y: Any, errors: list[Array], columns: Indices, horizons: Indices
    ) -> list[Array]:
        """Return errors, NaN where none is scored; refuse them in scored rows."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the forecaster has read them, too
            read = read_recordings(X, None, gaps="split", rates=None, resample=None)
        scored = []
        for number, (recording, each) in enumerate(
            zip(read.recordings, errors, strict=True)
        ):
            place, came = _find_outcomes(recording.pieces, len(each), horizons)
            came = np.repeat(came[:, :, np.newaxis], each.shape[2], axis=2)
            if y is not None:
                outputs = as_floats(y[number], f"y[{number}]").reshape(len(each), -1)
                for column, horizon in enumerate(horizons):
                    ahead = np.isfinite(outputs[horizon:])
                    came[: len(ahead), column] &= ahead
            came &= (place >= self.start)[:, np.newaxis, np.newaxis]
            is_refused = (came & np.isnan(each[:, columns])).any(axis=(1, 2))
            if is_refused.any():
                raise ValueError(
                    f"start={self.start} scores rows of X[{number}] that have no "
                    f"forecast, the first is row {is_refused.argmax()}; set start to "
                    f"{place[is_refused].max() + 1} or more, which scores all "
                    "candidates on the same rows."
                )
            scored.append(np.where(came, each[:, columns], np.nan))
        return scored


def _find_outcomes(
    pieces: list[slice], n_rows: int, horizons: Indices
) -> tuple[Indices, Mask]:
    """Find each row's place in its piece, and which horizons come before its end."""
    place, left = np.full(n_rows, -1), np.full(n_rows, -1)
    for rows in pieces:
        place[rows] = np.arange(rows.stop - rows.start)
        left[rows] = place[rows][::-1]
    return place, left[:, np.newaxis] >= horizons


def _following_rows(operator: Any, X: Any, y: Any, sample_index: Any) -> Indices:
    """Return the row that follows each row, or -1 if there is none."""
    links = None
    n = np.shape(X)[0]
    if sample_index is None:
        sample_index = index_level("sample_index", X, y)
    if sample_index is not None:
        links = successor_rows(sample_index)
    elif y is not None:
        links = match_successors(X, y)
    if links is None and getattr(operator, "_consecutive", False):
        clock = order_of_labels(X, y)
        links = successor_rows(np.arange(n) if clock is None else clock)
    if links is None:
        raise ValueError(
            "It is not known which of the held-out rows follow each other; pass "
            "sample_index=pairs.sample_index, in a search to its fit (params of "
            "cross_validate) after sklearn.set_config(enable_metadata_routing=True), "
            "or pass the data frames of trajectory_pairs."
        )
    following = np.full(n, -1)
    following[links[0]] = links[1]
    return following


def _rows_ahead(following: Indices, n_steps: int, first: int) -> Indices:
    """Return the rows that are `first` and more steps after each row, or -1."""
    ahead = [np.arange(len(following))]
    for _ in range(first + n_steps - 1):
        ahead.append(np.where(ahead[-1] < 0, -1, following[ahead[-1]]))
    return np.column_stack(ahead[first:])


def _is_hidden_from_user() -> bool:
    """Tell whether an error of the scorer would become a score of nan in a search.

    Searches of scikit-learn take every exception for the failure of one candidate. They
    refuse a result that is no number, though, in an error that prints it. So they are
    given the exception where no candidate can succeed.
    """
    frame: FrameType | None = sys._getframe(2)
    for _ in range(2):  # a scorer of several metrics may be in between
        if frame is None:
            return False
        if frame.f_globals.get("__name__") == "sklearn.model_selection._validation":
            return frame.f_code.co_name == "_score"  # others do not take exceptions
        frame = frame.f_back
    return False
