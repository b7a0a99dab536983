"""Scores of forecasts over several steps, for cross-validation by trajectories."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from sklearn.pipeline import Pipeline
from sklearn.utils import check_array, check_consistent_length, gen_batches
from sklearn.utils.metadata_routing import MetadataRequest

from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman._utils._validation import check_flag, check_integer, check_number
from sklearn_koopman.trajectories import successor_rows

__all__ = ["make_forecast_scorer", "make_valid_time_scorer"]


# Entries of the forecasts that are held at once.
BLOCK = 2**22


def make_forecast_scorer(
    n_steps: int,
    *,
    discount: float = 1.0,
    relift: bool = False,
    error_score: str | float = np.nan,
) -> ForecastScorer:
    """Make a scorer of the error of forecasts over a horizon.

    The score is minus the root mean square error of the outputs, over all steps up to
    `n_steps`, all rows that are followed by so many on a trajectory, and all outputs:

    .. math:: -\\Big(\\frac{\\sum_{s=1}^{S} \\gamma^{s-1} \\, e_s^2}
        {\\sum_{s=1}^{S} \\gamma^{s-1}}\\Big)^{1/2}

    with the mean square error :math:`e_s^2` after s steps and the discount
    :math:`\\gamma`.

    Parameters
    ----------
    n_steps : int
        The horizon S, in steps.
    discount : float, default=1.0
        Weight of each step relative to the one before, above 0 and at most 1.
    relift : bool, default=False
        Passed to :meth:`KernelEDMD.forecast`.
    error_score : "raise" or float, default=nan
        The score if a forecast leaves the range of numbers, or an error. Forecasts that
        diverge but are still numbers have the score that follows from them.

    Returns
    -------
    scorer : callable
        To be called as ``scorer(estimator, X, y=None, sample_index=None)`` with a
        fitted :class:`~sklearn_koopman.KernelEDMD` or a pipeline that ends in one, or
        given as `scoring` to :class:`~sklearn.model_selection.GridSearchCV` and the
        like. Without `y` the outputs are the states, as transformed by the pipeline.

    Raises
    ------
    ValueError
        If a parameter is outside its range; from the scorer, if it cannot know which
        rows follow each other, or no row is followed by enough others.

    See Also
    --------
    make_valid_time_scorer : Counts the steps until the error passes a tolerance.

    Notes
    -----
    The scorer has to know which of the held-out rows follow each other. With metadata
    routing enabled, ``sample_index`` given to the ``fit`` of the search reaches both
    the estimator and the scorer, and tells. Without, it can tell if `y` holds some of
    the columns of the states: a row is followed by the one with these values, as long
    as no other has the same. Otherwise the held-out rows are one trajectory in the
    order of time if those of the training data were, with neither `X_next` nor
    `sample_index`, and an error if not.

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
        raise ValueError(
            f"error_score must be 'raise' or a number, got {error_score!r}."
        )
    return HorizonErrorScorer(n_steps, relift, float(discount), error_score)


def make_valid_time_scorer(
    n_steps: int, tolerance: float, *, relift: bool = False
) -> ForecastScorer:
    """Make a scorer that counts the steps until the error passes a tolerance.

    The score is the number of steps before the error of a forecast, the Euclidean
    distance of predicted and true outputs, first exceeds `tolerance`: `n_steps` if it
    never does. It is averaged over all rows that are followed by so many on a
    trajectory.

    Parameters
    ----------
    n_steps : int
        The most steps that are counted.
    tolerance : float
        The largest error that is tolerated, in the unit of the outputs.
    relift : bool, default=False
        Passed to :meth:`KernelEDMD.forecast`.

    Returns
    -------
    scorer : callable
        To be used as that of :func:`make_forecast_scorer`.

    Raises
    ------
    ValueError
        If a parameter is outside its range; from the scorer, if it cannot know which
        rows follow each other, or no row is followed by enough others.

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


@dataclass(frozen=True, repr=False)
class ForecastScorer:
    """Compares forecasts with what followed; see :func:`make_forecast_scorer`."""

    n_steps: int
    relift: bool

    _name: ClassVar[str]

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
            The outputs one step after each row.
        sample_index : array-like of shape (n_samples,), default=None
            The place of each row on its trajectory's clock.

        Returns
        -------
        score : float
            Greater is better.
        """
        check_consistent_length(X, y, sample_index)
        operator = estimator[-1] if isinstance(estimator, Pipeline) else estimator
        if not hasattr(operator, "forecast"):
            raise TypeError(
                f"{type(operator).__name__} has no method forecast; score a "
                "KernelEDMD, or a pipeline that ends in one."
            )
        following = self._links(operator, X, y, sample_index)
        if isinstance(estimator, Pipeline) and len(estimator) > 1:
            X = estimator[:-1].transform(X)
        # Row i holds the outputs of the steps after i: its own, if y is given.
        n = len(following)
        chain = [np.arange(n)]
        for _ in range(self.n_steps if y is None else self.n_steps - 1):
            chain.append(np.where(chain[-1] < 0, -1, following[chain[-1]]))
        steps = np.column_stack(chain[1:] if y is None else chain)
        starts = np.flatnonzero(steps[:, -1] >= 0)
        if len(starts) == 0:
            raise ValueError(
                f"n_steps={self.n_steps}: none of the {n} held-out rows is "
                "followed by so many on its trajectory; lower n_steps, or leave out "
                "whole trajectories (TrajectoryKFold)."
            )
        outputs = check_array(X if y is None else y, dtype=np.float64, ensure_2d=False)
        outputs = outputs.reshape(n, -1)
        # A frame stays one, for the names of its columns.
        take = X.iloc if hasattr(X, "iloc") else np.asarray(X)
        size = max(BLOCK // (self.n_steps * outputs.shape[1]), 1)
        errors = []
        for batch in gen_batches(len(starts), size):
            rows = starts[batch]
            with warnings.catch_warnings():
                # What has diverged shows in the score.
                warnings.simplefilter("ignore", RuntimeWarning)
                y_pred = operator.forecast(take[rows], self.n_steps, relift=self.relift)
            y_pred = y_pred.reshape(len(rows), self.n_steps, -1)
            if y_pred.shape[2] != outputs.shape[1]:
                raise ValueError(
                    f"y has {outputs.shape[1]} outputs, but the estimator forecasts "
                    f"{y_pred.shape[2]}; score it with outputs like those of its fit."
                )
            with np.errstate(over="ignore", invalid="ignore"):
                difference = y_pred - outputs[steps[rows]]
                errors.append(np.square(difference).sum(axis=2))
        with np.errstate(over="ignore", invalid="ignore"):
            return self._score(np.concatenate(errors), outputs.shape[1])

    def __repr__(self) -> str:
        parameters = (f"{f.name}={getattr(self, f.name)!r}" for f in fields(self))
        return f"{self._name}({', '.join(parameters)})"

    def get_metadata_routing(self) -> MetadataRequest:
        """Ask for `sample_index`, which tells what rows follow each other.

        Returns
        -------
        routing : MetadataRequest
            The request.
        """
        request = MetadataRequest(owner=self)
        request.score.add_request(param="sample_index", alias=True)
        return request

    def _links(self, operator: Any, X: Any, y: Any, sample_index: Any) -> Indices:
        """Return which row follows each row, -1 for none."""
        n = np.shape(X)[0]
        following = np.full(n, -1)
        if sample_index is not None:
            rows, successors = successor_rows(sample_index)
            following[rows] = successors
            return following
        seen = _following(X, y)
        if seen is not None:
            return seen
        if not getattr(operator, "_consecutive", False):
            raise ValueError(
                "The scorer does not know which of the held-out rows follow each "
                "other: pass sample_index to it; in a search, to fit, with "
                "sklearn.set_config(enable_metadata_routing=True)."
            )
        following[:-1] = np.arange(1, n)
        return following

    def _score(self, squared: Array, n_outputs: int) -> float:
        """Turn squared distances of shape (n_starts, n_steps) into a score."""
        raise NotImplementedError


@dataclass(frozen=True, repr=False)
class HorizonErrorScorer(ForecastScorer):
    discount: float
    error_score: str | float

    _name = "make_forecast_scorer"

    def _score(self, squared: Array, n_outputs: int) -> float:
        weights = self.discount ** np.arange(self.n_steps)
        mean = np.average(squared.mean(axis=0), weights=weights)
        if not np.isfinite(mean):
            if isinstance(self.error_score, str):
                raise ValueError(
                    f"A forecast of n_steps={self.n_steps} has left the range of "
                    "numbers; lower n_steps, or set error_score to a number."
                )
            return float(self.error_score)
        return -float(np.sqrt(mean / n_outputs))


@dataclass(frozen=True, repr=False)
class ValidTimeScorer(ForecastScorer):
    tolerance: float

    _name = "make_valid_time_scorer"

    def _score(self, squared: Array, n_outputs: int) -> float:
        # NaN is no error that is tolerated.
        within = squared <= self.tolerance**2
        return float(np.logical_and.accumulate(within, axis=1).sum(axis=1).mean())


def _following(X: Any, y: Any) -> Indices | None:
    """Find the rows whose states hold the outputs of each row, -1 for none.

    None if outputs are no states, or those of several rows.
    """
    states = np.asarray(X)
    if y is None or states.dtype.kind not in "iuf":
        return None
    outputs = np.asarray(y).reshape(len(states), -1)
    width = outputs.shape[1]
    best, best_share = None, 0.0
    for first in range(states.shape[1] - width + 1):
        found, ambiguous = _rows_of(outputs, states[:, first : first + width])
        share = float(np.mean(found >= 0))
        if ambiguous < 0.01 and share > max(0.5, best_share):
            best, best_share = found, share
    return best


def _rows_of(values: Array, states: Array) -> tuple[Indices, float]:
    """Find the row of states that each row of values equals, -1 for none or several.

    The share of the latter is returned as well. The coarser precision counts.
    """
    precision = np.result_type(np.float32)
    if values.dtype != precision and states.dtype != precision:
        precision = np.result_type(values, states)
    n = len(states)
    _, first, group = np.unique(
        np.vstack([states, values]).astype(precision),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    group = group.reshape(-1)
    times = np.bincount(group[:n], minlength=len(first))[group[n:]]
    found = np.where(times == 1, first[group[n:]], -1)
    return found.astype(np.intp), float(np.mean(times > 1))
