"""Display of predictions and forecasts over time."""

from __future__ import annotations

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
from ._display import COLORS, Display, Keywords, count_curves, merge_style, with_unit
from ._inputs import predict_one_step, rows_per_step, select_output, times_of

TRUTH = "measured"
SAMPLES, SECONDS = "time [samples]", "time [s]"
# Room for a row of legend entries above the curves, as a fraction of their range.
HEADROOM = 0.15


@dataclass(kw_only=True, eq=False, repr=False)
class ForecastDisplay(Display):  # numpydoc ignore=PR02
    """Measured and predicted output over time, with a band of uncertainty.

    Create a display by :meth:`from_predictions` or :meth:`from_estimator`. All
    parameters are stored as attributes. Several displays on the same axes, of several
    models, share the line of the measured output.

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
    bound_label : str, default="bound"
        The name of the band in the legend.
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
    band_ : matplotlib PolyCollection or None
        The band.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
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
    bound_label: str = "bound"
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
        y: Any,
        *,
        n_steps: int | None = None,
        start: int = 0,
        lag: int | None = None,
        relift: bool = False,
        band: str | None = None,
        norm: Any = None,
        dt: float | None = None,
        **display_kw: Any,
    ) -> Self:
        """Plot the predictions of a fitted model along a trajectory.

        Parameters
        ----------
        estimator : estimator instance
            A fitted regressor; for forecasts a :class:`~sklearn_koopman.KernelEDMD`. Or
            a pipeline or a search of one.
        X : array-like of shape (n_samples, n_features)
            The states of one trajectory, in the order of time.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            The outputs one step after each of them.
        n_steps : int, default=None
            None to predict one step ahead of every row from `start` on; a number to
            forecast so many steps from the row `start` alone.
        start : int, default=0
            The row to begin with, from which the time is counted.
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
        dt : float, default=None
            The time between rows in seconds. None to count samples.
        **display_kw : dict
            The parameters of :meth:`from_predictions` except `bound` and `time`.

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
            tells it.
        """
        check_is_fitted(estimator)
        check_integer(start, "start", 0)
        check_flag(relift, "relift")
        check_choice(band, "band", (None, "std", "bound"))
        if dt is not None:
            check_number(dt, "dt", positive=True)
        check_consistent_length(X, y)
        final, scaler = unwrap(estimator)
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

    def plot(
        self,
        ax: Any = None,
        *,
        truth_kw: Keywords = None,
        prediction_kw: Keywords = None,
        band_kw: Keywords = None,
    ) -> Self:
        """Draw the measured output, the prediction and the band.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        truth_kw, prediction_kw : dict, default=None
            Keyword arguments for the lines.
        band_kw : dict, default=None
            Keyword arguments for ``fill_between``.

        Returns
        -------
        display : ForecastDisplay
            The display itself.
        """
        ax = self._set_axes(ax)
        style = merge_style({"color": "k", "linewidth": 1.5, "label": TRUTH}, truth_kw)
        label = style["label"]
        data = self.time, self.y_true
        named = [x for x in ax.lines if x.get_label() == label]
        drawn = [x for x in named if np.array_equal(x.get_data(), data, equal_nan=True)]
        color = COLORS[(count_curves(ax, [label]) + 1) % len(COLORS)]  # no blue first
        self.truth_ = (drawn or ax.plot(*data, **style))[0]
        style = {"color": color, "linestyle": "--", "linewidth": 1.5}
        style = merge_style(style | {"label": self.name}, prediction_kw)
        (self.prediction_,) = ax.plot(self.time, self.y_pred, **style)
        self.band_ = None
        if self.bound is not None:
            style = {"facecolor": self.prediction_.get_color(), "alpha": 0.25}
            style |= {"linewidth": 0, "zorder": 1.5, "label": self.bound_label}
            style = merge_style(style, band_kw, collection=True)
            low, high = self.y_pred - self.bound, self.y_pred + self.bound
            self.band_ = ax.fill_between(self.time, low, high, **style)
        _limit_view(ax, self.y_true)
        ax.set(xlabel=self.time_label, ylabel=with_unit(self.output_name, self.unit))
        ax.legend(loc="upper center", ncols=4, fontsize="small")
        return self


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
