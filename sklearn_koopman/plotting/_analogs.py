"""Display of the earlier moments that a forecast is made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from .._utils._typing import Array, Indices
from .._utils._validation import check_number
from ._display import BLUE, ORANGE, Display, Keywords, merge_style, with_unit
from ._inputs import find_forecaster, find_output

# Opacity of an analog of weight 0; the largest weight is opaque.
FAINTEST = 0.2
# Room for the legend above the curves, as a fraction of their range.
HEADROOM = 0.3


@dataclass(kw_only=True, eq=False, repr=False)
class AnalogDisplay(Display):  # numpydoc ignore=PR02
    """The analogs of one moment of a recording, and what followed them.

    Analogs are the earlier moments of the recording that are most like the present one.
    The heavier they weigh, the less transparent they are. The mean of what followed
    them is the baseline of the forecast.

    Create a display by :meth:`from_estimator`. All parameters are stored as attributes.

    Parameters
    ----------
    outputs : ndarray of shape (n_rows,)
        One output; NaN where it is not known.
    start : int
        The row to forecast from.
    window : int
        The number of rows, up to an analog, that are compared to those up to `start`.
    horizon : int
        How many rows ahead the forecast is.
    analogs : ndarray of shape (n_analogs,)
        The rows that are analogs.
    weights : ndarray of shape (n_analogs,)
        Their weights, which sum to 1.
    forecast : float
        The forecast.
    baseline : float
        The weighted mean of what followed the analogs.
    dt : float, default=None
        The time between rows in seconds. None to count samples.
    output_name : str, default="output"
        Name of the output.
    unit : str, default=None
        Unit of the output.

    Attributes
    ----------
    line_ : matplotlib Line2D
        The output.
    now_ : matplotlib Line2D
        The time of the forecast.
    present_ : matplotlib Line2D
        The present window.
    windows_ : matplotlib LineCollection
        The windows of the analogs.
    followers_ : matplotlib LineCollection
        What followed each of them, up to the horizon.
    ends_ : matplotlib PathCollection
        The output of each of them at the horizon.
    baseline_ : matplotlib Line2D
        The mean of these.
    forecast_ : matplotlib Line2D
        The forecast.
    truth_ : matplotlib Line2D or None
        What came, if that is known.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    ForecastDisplay : The forecasts from one row, at all horizons.
    sklearn_koopman.Analogs : Says which moments are alike.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanForecaster
    >>> from sklearn_koopman.plotting import AnalogDisplay
    >>> swings = [np.sin(np.pi * np.arange(200.0) / 20)[:, np.newaxis]] * 2
    >>> forecaster = KoopmanForecaster(horizons=[5], delays=2, baseline="analogs")
    >>> display = AnalogDisplay.from_estimator(forecaster.fit(swings), swings[0])
    >>> display.start, display.analogs
    (194, array([154, 114,  74,  34]))
    >>> plt.close(display.figure_)
    """

    outputs: Array
    start: int
    window: int
    horizon: int
    analogs: Indices
    weights: Array
    forecast: float
    baseline: float
    dt: float | None = None
    output_name: str = "output"
    unit: str | None = None

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        recording: Any,
        *,
        start: int | None = None,
        horizon: int | None = None,
        output: int | str = 0,
        dt: float | None = None,
        output_name: str | None = None,
        unit: str | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot the analogs of one row of a recording.

        Parameters
        ----------
        estimator : KoopmanForecaster
            The fitted forecaster, or a search of one, whose baseline are analogs.
        recording : array-like of shape (n_rows, n_features)
            One recording.
        start : int, default=None
            The row to forecast from. None for the last one whose outputs have come at
            all horizons.
        horizon : int, default=None
            One of the forecaster's horizons, in samples. None for the largest with
            analogs.
        output : int or str, default=0
            Which output, by its number or name.
        dt : float, default=None
            The time between rows in seconds. None to count samples.
        output_name : str, default=None
            The name of the output in the picture. None for its own.
        unit : str, default=None
            The unit of the output.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `line_kw`, `window_kw`, `forecast_kw` and `truth_kw` of
            :meth:`plot`.

        Returns
        -------
        display : AnalogDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is no fitted forecaster, or has no analogs there; if a
            parameter is outside its range; if the recording is not like those of `fit`.
        """
        forecaster, front = find_forecaster(estimator)
        if dt is not None:
            check_number(dt, "dt", positive=True)
        column, known_as = find_output(forecaster, output)
        number = _find_horizon(forecaster, horizon)
        if front is not None:
            recording = front.transform([recording])[0]
        parts = forecaster.explain(recording, start=start)
        found = parts.weights[number] > 0
        horizon = int(forecaster.horizons_[number])
        if not found.any():
            raise ValueError(
                f"row {parts.start} has no analogs {horizon} rows ahead: nothing like "
                "it came before. Choose a later start, or join earlier recordings to "
                "this one by trajectories.join_recordings."
            )
        return cls(
            outputs=parts.outputs[:, column],
            start=parts.start,
            window=parts.window,
            horizon=horizon,
            analogs=parts.analogs[number, found],
            weights=parts.weights[number, found],
            forecast=float(parts.forecast[number, column]),
            baseline=float(parts.baseline[number, column]),
            dt=dt,
            output_name=known_as if output_name is None else output_name,
            unit=unit,
        ).plot(ax, **artist_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        line_kw: Keywords = None,
        window_kw: Keywords = None,
        forecast_kw: Keywords = None,
        truth_kw: Keywords = None,
    ) -> Self:
        """Draw the recording, the analogs, the forecast and what came.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw : dict, default=None
            Keyword arguments for the line of the recording.
        window_kw : dict, default=None
            Keyword arguments for the collection of the windows.
        forecast_kw, truth_kw : dict, default=None
            Keyword arguments for the points of the forecast and of what came.

        Returns
        -------
        display : AnalogDisplay
            The display itself.
        """
        ax = self._set_axes(ax)
        from matplotlib.collections import LineCollection
        from matplotlib.colors import to_rgba_array

        step = 1 if self.dt is None else self.dt
        ahead, window = np.arange(self.horizon + 1), np.arange(1 - self.window, 1)
        end = self.start + self.horizon
        opacity = np.interp(self.weights, [0, self.weights.max()], [FAINTEST, 1])
        shades = to_rgba_array([BLUE] * len(opacity), opacity)

        self.now_ = ax.axvline(self.start * step, color="0.8", linewidth=1, zorder=0)
        style: dict[str, Any] = {"color": "k", "linewidth": 0.8, "label": "measured"}
        rows = np.arange(len(self.outputs))
        (self.line_,) = ax.plot(*self._points(rows).T, **merge_style(style, line_kw))
        style = {"color": "k", "linewidth": 4, "label": "present window"}
        style |= {"solid_capstyle": "butt"}
        (self.present_,) = ax.plot(*self._points(self.start + window).T, **style)
        style = {"colors": shades, "linewidth": 4, "label": "analogs, by weight"}
        style = merge_style(style, window_kw, collection=True)
        windows = self._points(self.analogs[:, np.newaxis] + window)
        self.windows_ = ax.add_collection(LineCollection(windows, **style))
        style = {"colors": shades, "linewidth": 1.5, "label": "what followed them"}
        followed = self._points(self.analogs[:, np.newaxis] + ahead)
        self.followers_ = ax.add_collection(LineCollection(followed, **style))
        ends = self._points(self.analogs + self.horizon)
        self.ends_ = ax.scatter(*ends.T, s=16, color=shades, zorder=2.5)
        point: dict[str, Any] = {"linestyle": "", "zorder": 3}
        style = {"marker": "_", "markersize": 16, "markeredgewidth": 2, "color": BLUE}
        style |= {"label": "their mean"}
        (self.baseline_,) = ax.plot(end * step, self.baseline, **point, **style)
        self.truth_ = None
        if np.isfinite(self.outputs[end : end + 1]).any():
            style = {"marker": "o", "markersize": 9, "markerfacecolor": "none"}
            style |= {**point, "color": "k", "label": "what came"}
            style = merge_style(style, truth_kw)
            (self.truth_,) = ax.plot(end * step, self.outputs[end], **style)
        style = {**point, "marker": "D", "markersize": 5, "color": ORANGE}
        style = merge_style(style | {"label": "forecast"}, forecast_kw)
        (self.forecast_,) = ax.plot(end * step, self.forecast, **style)
        low, high = ax.dataLim.intervaly
        ax.set_ylim(low - 0.05 * (high - low), high + HEADROOM * (high - low))
        time_label = "time [samples]" if self.dt is None else "time [s]"
        ax.set(xlabel=time_label, ylabel=with_unit(self.output_name, self.unit))
        ax.legend(loc="upper center", ncols=4, fontsize="small")
        return self

    def _points(self, rows: Indices) -> Any:
        """Return the times and outputs of some rows."""
        step = 1 if self.dt is None else self.dt
        return np.stack([rows * step, self.outputs[rows]], axis=-1)


def _find_horizon(forecaster: Any, horizon: int | None) -> int:
    """Return the number of a horizon whose baseline are analogs."""
    horizons = np.asarray(forecaster.horizons_)
    usable = horizons[forecaster.baselines_ == "analogs"]
    if not len(usable):
        raise ValueError(
            f"the baselines are {', '.join({*forecaster.baselines_})}, so that no "
            "forecast is made of analogs; fit with baseline='analogs' to see them."
        )
    horizon = usable.max() if horizon is None else horizon
    if horizon not in usable:
        raise ValueError(
            f"horizon={horizon!r} is none of the horizons with analogs, which are "
            f"{usable.tolist()}."
        )
    return int(np.flatnonzero(horizons == horizon)[0])
