"""Display of predictions and forecasts over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.utils import check_consistent_length
from sklearn.utils.validation import check_is_fitted

from .._utils._frames import index_level
from .._utils._pipeline import transformed, unwrap
from .._utils._typing import Array, Indices
from .._utils._validation import (
    check_choice,
    check_flag,
    check_integer,
    check_number,
    refuse_masked,
)
from ._display import (
    BLUE,
    COLORS,
    Display,
    Keywords,
    count_curves,
    merge_style,
    with_unit,
)
from ._inputs import (
    find_output,
    is_forecaster,
    predict_one_step,
    rows_per_step,
    select_output,
    sorted_horizons,
    times_of,
)

TRUTH = "measured"
SAMPLES, SECONDS = "time [samples]", "time [s]"
# Rows before a forecast that are shown at least.
MIN_PAST = 20
# Half the width of a single forecast's band, as a fraction of the times.
BAR = 0.01
# More forecasts than these are a curve by themselves.
MAX_MARKERS = 40
# Room for a row of legend entries above the curves, as a fraction of their range.
HEADROOM = 0.15


@dataclass(kw_only=True, eq=False, repr=False)
class ForecastDisplay(Display):  # numpydoc ignore=PR02
    """Measured and predicted output over time, with a band of uncertainty.

    Create a display by :meth:`from_predictions` or :meth:`from_estimator`. All
    parameters are stored as attributes. Several displays on the same axes, of several
    models, share the line of the measured output.

    That of a :class:`~sklearn_koopman.KoopmanForecaster` shows the forecasts from one
    row of a recording at all horizons, what its baseline says, a band if it is
    calibrated, what came before, and what came.

    Parameters
    ----------
    time : ndarray of shape (n_times,)
        The times of the outputs.
    y_true : ndarray of shape (n_times,)
        The measured output.
    y_pred : ndarray of shape (n_times,)
        The predicted output; NaN from where a forecast could not be continued.
    bound : ndarray of shape (n_times,), default=None
        Half the width of a band around the prediction, in the unit of the output.
    interval : ndarray of shape (n_times, 2), default=None
        The lower and upper ends of a band, instead of `bound`.
    bound_label : str, default="bound"
        The name of the band in the legend.
    baseline : ndarray of shape (n_times,), default=None
        What a forecaster's baseline says; NaN where it says nothing.
    baseline_name : str, default="baseline"
        The name of the baseline in the legend.
    true_time : ndarray of shape (n_true_times,), default=None
        The times of `y_true` if they are not those of the predictions, which are then
        made at time 0.
    name : str, default="predicted"
        The name of the prediction in the legend.
    time_label : str, default="time [samples]"
        Label of the horizontal axis.
    output_name : str, default="output"
        Name of the output.
    unit : str, default=None
        Unit of the output.

    Attributes
    ----------
    truth_ : matplotlib Line2D
        The measured output.
    prediction_ : matplotlib Line2D
        The predicted output.
    baseline_ : matplotlib Line2D or None
        What the baseline says.
    band_ : matplotlib PolyCollection or None
        The band.
    now_ : matplotlib Line2D or None
        The time at which a forecaster makes its predictions.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    AnalogDisplay : The moments that a forecast is made of.
    HorizonErrorDisplay : Errors of a forecaster at all horizons.
    SpectrumDisplay : The eigenvalues that a forecast is made of.
    sklearn_koopman.make_forecast_scorer : Scores forecasts from all starts.

    Notes
    -----
    The vertical axis ends at most one range of the measured output beyond that output.
    A forecast that diverges, or a very wide band, then does not flatten the rest.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_koopman import KernelEDMD, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.plotting import ForecastDisplay
    >>> pendulum = make_pendulum(256, step=0.1)
    >>> model = KernelEDMD(
    ...     "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ... ).fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)
    >>> display = ForecastDisplay.from_estimator(
    ...     model, pendulum.X, pendulum.y, n_steps=100, lag=1, dt=0.1
    ... )
    >>> display.time[[0, -1]]
    array([ 0.1, 10. ])
    >>> plt.close(display.figure_)
    """

    time: Array
    y_true: Array
    y_pred: Array
    bound: Array | None = None
    interval: Array | None = None
    bound_label: str = "bound"
    baseline: Array | None = None
    baseline_name: str = "baseline"
    true_time: Array | None = None
    name: str = "predicted"
    time_label: str = SAMPLES
    output_name: str = "output"
    unit: str | None = None

    @classmethod
    def from_predictions(
        cls,
        y_true: Any,
        y_pred: Any,
        *,
        bound: Any = None,
        bound_label: str = "bound",
        time: Any = None,
        dt: float | None = None,
        time_label: str | None = None,
        output: int = 0,
        output_name: str | None = None,
        unit: str | None = None,
        name: str = "predicted",
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot predictions beside the measured output.

        Parameters
        ----------
        y_true : array-like of shape (n_times,) or (n_times, n_outputs)
            The measured outputs, in the order of time.
        y_pred : array-like of shape (n_times,) or (n_times, n_outputs)
            The predicted outputs.
        bound : array-like of shape (n_times,) or (n_times, n_outputs), default=None
            Half the width of a band around the predictions. One column, or one number,
            is taken for all outputs.
        bound_label : str, default="bound"
            The name of the band in the legend.
        time : array-like of shape (n_times,), default=None
            The times of the outputs in seconds.
        dt : float, default=None
            The time between outputs in seconds, instead of `time`. The first output is
            at `dt`, because the output of a row is one step after the row. With
            neither, samples are counted.
        time_label : str, default=None
            Label of the horizontal axis. None for "time [s]" or "time [samples]".
        output : int, default=0
            Which of several outputs.
        output_name : str, default=None
            The name of the output. None for "output", with its number if there are
            several.
        unit : str, default=None
            The unit of the output.
        name : str, default="predicted"
            The name of the prediction in the legend.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `truth_kw`, `prediction_kw` and `band_kw` of :meth:`plot`.

        Returns
        -------
        display : ForecastDisplay
            The display.

        Raises
        ------
        ValueError
            If shapes do not agree; if there is no such output; if `bound` is negative;
            if both `time` and `dt` are given.
        """
        y_true, y_pred = np.asanyarray(y_true), np.asanyarray(y_pred)  # with masks
        n_times = len(y_pred)
        truth = select_output(y_true, output, n_times, "y_true")
        predicted = select_output(y_pred, output, n_times, "y_pred")
        if bound is not None:
            bound = np.asarray(bound, dtype=np.float64)
            bound = np.full(n_times, bound) if bound.ndim == 0 else bound
            column = 0 if bound[:1].size == 1 else output
            bound = select_output(bound, column, n_times, "bound")
            if (bound < 0).any():
                raise ValueError(
                    f"bound must be half the width of the band, got {bound.min():.3g}."
                )
        if output_name is None:
            output_name = "output" if y_true[:1].size == 1 else f"output {output}"
        if time_label is None:
            time_label = SAMPLES if time is None and dt is None else SECONDS
        return cls(
            time=times_of(n_times, time, dt),
            y_true=truth,
            y_pred=predicted,
            bound=bound,
            bound_label=bound_label,
            name=name,
            time_label=time_label,
            output_name=output_name,
            unit=unit,
        ).plot(ax, **artist_kw)

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        y: Any = None,
        *,
        n_steps: int | None = None,
        start: int | None = None,
        lag: int | None = None,
        relift: bool = False,
        band: str | None = None,
        norm: Any = None,
        coverage: float | None = 0.9,
        simultaneous: bool = False,
        dt: float | None = None,
        **display_kw: Any,
    ) -> Self:
        """Plot what a fitted model predicts along a trajectory or a recording.

        Parameters
        ----------
        estimator : estimator instance
            A fitted regressor; for forecasts a :class:`~sklearn_koopman.KernelEDMD`, or
            a pipeline of one. Or a :class:`~sklearn_koopman.KoopmanForecaster`. Or a
            search of any of them.
        X : array-like of shape (n_samples, n_features)
            The states of one trajectory, in the order of time. For a forecaster one
            recording.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
            The outputs one step after each of them. For a forecaster None, or, if its
            `fit` was given outputs, those of the same rows.
        n_steps : int, default=None
            None to predict one step ahead of every row from `start` on; a number to
            forecast so many steps from the row `start` alone.
        start : int, default=None
            The row to begin with, from which the time is counted. None for the first
            one; for a forecaster the last one whose outputs have come at all horizons.
        lag : int, default=None
            How many rows make one step: the `lag` of
            :func:`~sklearn_koopman.trajectory_pairs`. None reads it off the level
            "sample_index" of the index of `X`, else of `y`; off outputs that are
            columns of the states; or takes 1 if `estimator` was fitted to rows in the
            order of time.
        relift : bool, default=False
            Whether a forecast goes from each state to the next one by the learned map
            of states, instead of by powers of the operator. See
            :meth:`sklearn_koopman.KernelEDMD.forecast`.
        band : {"std", "bound"}, default=None
            A band for predictions one step ahead: two standard deviations, or the error
            bound of a :class:`~sklearn_koopman.KoopmanKernelRegressor`.
        norm : float or array-like of shape (n_outputs,), default=None
            The native norm of the outputs, that is their norm in the function space of
            the kernel, for the error bound. None to estimate it.
        coverage : float, default=0.9
            What the band of a calibrated forecaster covers. None for no band.
        simultaneous : bool, default=False
            Whether that band covers all horizons and outputs at once, or each by
            itself.
        dt : float, default=None
            The time between rows in seconds. None to count samples.
        **display_kw : dict
            The parameters of :meth:`from_predictions` except `bound` and `time`. For a
            forecaster `output` may be a name.

        Returns
        -------
        display : ForecastDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is not fitted, or cannot forecast or give the band; if a
            parameter is outside its range, or there are too few rows; if the index
            tells that they are not on one trajectory; if `lag` is None and nothing
            tells it; if a forecaster gets a parameter of other models.
        """
        check_is_fitted(estimator)
        check_flag(relift, "relift")
        check_choice(band, "band", (None, "std", "bound"))
        if dt is not None:
            check_number(dt, "dt", positive=True)
        final, scaler = unwrap(estimator)
        if is_forecaster(final):
            options = {"n_steps": n_steps, "lag": lag, "band": band, "norm": norm}
            given = [name for name in options if options[name] is not None]
            given += ["relift"] * relift
            if given:
                raise ValueError(
                    f"{given[0]} is for other models: a KoopmanForecaster has "
                    f"horizons={final.horizons!r}; leave {', '.join(given)} out."
                )
            ends = {"coverage": coverage, "simultaneous": simultaneous}
            recording = X if scaler is None else scaler.transform([X])[0]
            return cls._from_forecaster(
                final, recording, y, start, dt, ends, **display_kw
            )
        if y is None:
            raise ValueError("y must be the outputs one step after each row, got None.")
        start = 0 if start is None else start
        check_integer(start, "start", 0)
        check_consistent_length(X, y)
        if lag is None:
            lag = rows_per_step(final, X, y)
        check_integer(lag, "lag", 1)
        refuse_masked(X=X)
        index = index_level("sample_index", X, y)
        y = np.asanyarray(y)
        check_integer(1 if n_steps is None else n_steps, "n_steps", 1)
        needed = start + lag * ((n_steps or 1) - 1) + 1
        if len(y) < needed:
            raise ValueError(
                f"start={start}, lag={lag} and n_steps={n_steps} need {needed} rows, "
                f"got {len(y)}; lower start or n_steps, or give more rows."
            )
        if index is not None:
            shown = np.arange(start, len(y) if n_steps is None else needed, lag)
            _check_steps(index, shown)
        states = transformed(scaler, X)
        taken = slice(start, None if n_steps is None else start + 1)
        states = states.iloc[taken] if hasattr(states, "iloc") else states[taken]
        bound, label = None, "bound"
        if n_steps is None:
            truth = y[start:]
            predicted, bound, label = predict_one_step(final, states, band, norm)
            ahead = lag + np.arange(len(truth))
        elif hasattr(final, "forecast") and band is None:
            truth = y[start:needed:lag]
            predicted = final.forecast(states, n_steps, relift=relift)[0]
            ahead = lag * np.arange(1, n_steps + 1)
        else:
            raise ValueError(
                f"n_steps={n_steps} asks for a forecast, which takes a KernelEDMD and "
                f"has no band; got {type(final).__name__} and band={band!r}."
            )
        display_kw.setdefault("bound_label", label)
        display_kw.setdefault("time_label", SAMPLES if dt is None else SECONDS)
        time = ahead * (1 if dt is None else dt)
        return cls.from_predictions(
            truth, predicted, bound=bound, time=time, **display_kw
        )

    @classmethod
    def _from_forecaster(
        cls,
        forecaster: Any,
        recording: Any,
        y: Any,
        start: int | None,
        dt: float | None,
        band: dict[str, Any],
        *,
        output: int | str = 0,
        output_name: str | None = None,
        unit: str | None = None,
        name: str = "forecast",
        bound_label: str | None = None,
        time_label: str | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot the forecasts from one row of a recording."""
        column, known_as = find_output(forecaster, output)
        parts = forecaster.explain(recording, y, start=start)
        order, horizons = sorted_horizons(forecaster)
        past = max(horizons[-1], MIN_PAST)
        rows = slice(max(parts.start - past, 0), parts.start + horizons[-1] + 1)
        truth, step = parts.outputs[rows, column], 1 if dt is None else dt
        interval = None
        if band["coverage"] is not None and hasattr(forecaster, "calibration_"):
            until = recording.iloc if hasattr(recording, "iloc") else recording
            until = [until[: parts.start + 1]]
            _, intervals = forecaster.forecast_interval(until, **band)
            interval = intervals[0, order, column]
            if bound_label is None:
                kind = "joint band" if band["simultaneous"] else "band"
                bound_label = f"{100 * band['coverage']:g} % {kind}"
        baseline = parts.baseline[order, column]
        names = {*forecaster.baselines_[np.isfinite(parts.baseline[:, column])]}
        return cls(
            time=np.multiply(horizons, step, dtype=np.float64),
            y_true=truth,
            y_pred=parts.forecast[order, column],
            interval=interval,
            bound_label=bound_label or "band",
            baseline=baseline if names else None,
            baseline_name=names.pop() if len(names) == 1 else "baseline",
            true_time=(np.arange(len(truth)) + rows.start - parts.start) * step,
            name=name,
            time_label=time_label or (SAMPLES if dt is None else SECONDS),
            output_name=known_as if output_name is None else output_name,
            unit=unit,
        ).plot(ax, **artist_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        truth_kw: Keywords = None,
        prediction_kw: Keywords = None,
        baseline_kw: Keywords = None,
        band_kw: Keywords = None,
    ) -> Self:
        """Draw the measured output, the prediction, its baseline and the band.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        truth_kw, prediction_kw, baseline_kw : dict, default=None
            Keyword arguments for the lines.
        band_kw : dict, default=None
            Keyword arguments for ``fill_between``.

        Returns
        -------
        display : ForecastDisplay
            The display itself.
        """
        ax = self._set_axes(ax)
        self.now_ = None
        if self.true_time is not None:
            self.now_ = ax.axvline(0.0, color="0.8", linewidth=1, zorder=0)
        time = self.time if self.true_time is None else self.true_time
        style = {"color": "k", "linewidth": 1.5, "label": TRUTH}
        self.truth_ = _draw_once(ax, time, self.y_true, merge_style(style, truth_kw))
        shared = [self.truth_.get_label(), self.baseline_name]
        color = COLORS[(count_curves(ax, shared) + 1) % len(COLORS)]  # no blue first
        few = self.true_time is not None and len(self.time) <= MAX_MARKERS
        dots = {"marker": "o" if few else "", "markersize": 4}
        self.baseline_ = None
        if self.baseline is not None:
            style = {"color": "0.5", "linestyle": ":", "linewidth": 1.5, **dots}
            style = merge_style(style | {"label": self.baseline_name}, baseline_kw)
            self.baseline_ = _draw_once(ax, self.time, self.baseline, style)
        style = {"color": color, "linestyle": "--", "linewidth": 1.5, **dots}
        style = merge_style(style | {"label": self.name}, prediction_kw)
        (self.prediction_,) = ax.plot(self.time, self.y_pred, **style)
        self.band_, ends, color = None, self.interval, BLUE
        if self.bound is not None:
            color = self.prediction_.get_color()
            ends = self.y_pred[:, np.newaxis] + np.outer(self.bound, [-1, 1])
        if ends is not None:
            style = {"facecolor": color, "alpha": 0.25}
            style |= {"linewidth": 0, "zorder": 1.5, "label": self.bound_label}
            style = merge_style(style, band_kw, collection=True)
            time = self.time
            if len(time) == 1:  # a bar, as a band would have no width
                half = BAR * np.ptp(ax.dataLim.intervalx)
                time, ends = time + np.array([-half, half]), np.repeat(ends, 2, axis=0)
            self.band_ = ax.fill_between(time, *ends.T, **style)
        _limit_view(ax, self.y_true)
        ax.set(xlabel=self.time_label, ylabel=with_unit(self.output_name, self.unit))
        ax.legend(loc="upper center", ncols=4, fontsize="small")
        return self


def _draw_once(ax: Any, x: Array, y: Array, style: Mapping[str, Any]) -> Any:
    """Return a line, which may be on the axes already."""
    for line in ax.lines:
        drawn = line.get_label() == style["label"]
        if drawn and np.array_equal(line.get_data(), (x, y), equal_nan=True):
            return line
    return ax.plot(x, y, **style)[0]


def _limit_view(ax: Any, truth: Array) -> None:
    """End the vertical axis at most one range of the true values beyond them."""
    truth = truth[np.isfinite(truth)]
    if not len(truth):
        return
    size = float(np.ptp(truth) or np.abs(truth).max() or 1.0)
    low, high = ax.dataLim.intervaly
    low, high = max(low, truth.min() - size), min(high, truth.max() + size)
    margin = 0.05 * ((high - low) or size)
    ax.set_ylim(low - margin, high + margin + HEADROOM * (high - low))


def _check_steps(index: Array, rows: Indices) -> None:
    """Refuse rows of which one is not a step after the one before, by their index."""
    ends = np.flatnonzero(np.diff(index[rows]) != 1)
    if len(ends):
        last, after = rows[ends[0]], rows[ends[0] + 1]
        raise ValueError(
            f"By its index, row {after} is not a step after row {last}: give lag as in "
            "trajectory_pairs, a lower n_steps, or the rows of one trajectory, such as "
            "X.loc[[0]]."
        )
