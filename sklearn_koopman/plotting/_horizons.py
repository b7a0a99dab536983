"""Display of the errors of a forecaster at all horizons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from .._utils._pipeline import transformed
from .._utils._typing import Array
from .._utils._validation import check_number
from ._display import (
    BLUE,
    COLORS,
    GREEN,
    ORANGE,
    Display,
    Keywords,
    merge_style,
    with_unit,
)
from ._inputs import find_forecaster, find_output, sorted_horizons

FORECAST, CORRECTED = "forecast", ", corrected"
# Room above the curves for each row of the legend, as a fraction of their range.
HEADROOM = 0.09
# What is tried has the same colour alone and corrected.
BASELINE_COLORS = {
    "direct": COLORS[3],
    "last": "0.5",
    "linear": GREEN,
    "analogs": BLUE,
    "custom": COLORS[4],
}


@dataclass(kw_only=True, eq=False, repr=False)
class HorizonErrorDisplay(Display):  # numpydoc ignore=PR02
    """Root mean square errors of forecasts and of their baselines, by the horizon.

    Dotted lines are baselines alone, thin ones their corrections, or forecasts without
    a baseline ("direct"), which `fit` has tried. The forecast is the best of those at
    each horizon.

    Create a display by :meth:`from_estimator`. All parameters are stored as attributes.

    Parameters
    ----------
    horizons : ndarray of shape (n_horizons,)
        How far ahead, rising.
    errors : dict of str to ndarray of shape (n_horizons,)
        The errors: of the "forecast", of baselines ("analogs") and of their corrections
        ("analogs, corrected").
    horizon_label : str, default="horizon [samples]"
        Label of the horizontal axis.
    output_name : str, default="output"
        What the errors are errors of.
    unit : str, default=None
        Its unit.

    Attributes
    ----------
    lines_ : list of matplotlib Line2D
        The errors, in the same order. Those that are zero cannot be shown.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    ForecastDisplay : The forecasts from one row.
    sklearn_koopman.KoopmanForecaster : Makes the forecasts.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanForecaster
    >>> from sklearn_koopman.plotting import HorizonErrorDisplay
    >>> swings = [np.sin(0.1 * np.arange(100.0) + start) for start in range(3)]
    >>> forecaster = KoopmanForecaster(horizons=[5, 10], delays=2, baseline="last")
    >>> forecaster = forecaster.fit([swing[:, np.newaxis] for swing in swings])
    >>> display = HorizonErrorDisplay.from_estimator(forecaster, dt=0.01)
    >>> list(display.errors)
    ['forecast', 'last', 'last, corrected']
    >>> plt.close(display.figure_)
    """

    horizons: Array
    errors: Mapping[str, Array]
    horizon_label: str = "horizon [samples]"
    output_name: str = "output"
    unit: str | None = None

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any = None,
        y: Any = None,
        *,
        output: int | str | None = 0,
        dt: float | None = None,
        output_name: str | None = None,
        unit: str | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot the errors of a fitted forecaster.

        Parameters
        ----------
        estimator : KoopmanForecaster
            The fitted forecaster, or a search of one.
        X : list of array-like of shape (n_rows, n_features), default=None
            Recordings to forecast. None for the errors of those that were left out in
            `fit`, which chose the forecast among those that are shown.
        y : list of array-like, default=None
            The outputs, if `fit` was given some.
        output : int, str or None, default=0
            Which output, by its number or name. None for the length of the error over
            all outputs, which need one unit then.
        dt : float, default=None
            The time between rows in seconds. None to count samples.
        output_name : str, default=None
            What to call the output. None for its name.
        unit : str, default=None
            The unit of the output.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameter `line_kw` of :meth:`plot`.

        Returns
        -------
        display : HorizonErrorDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is no fitted forecaster; if a parameter is outside its
            range; if the recordings are not like those of `fit`, or too short.
        """
        forecaster, front = find_forecaster(estimator)
        if dt is not None:
            check_number(dt, "dt", positive=True)
        if output is None:
            column, known_as = slice(None), "outputs"
        else:
            number, known_as = find_output(forecaster, output)
            column = slice(number, number + 1)
        if X is None and y is None:
            errors = {FORECAST: _left_out(forecaster)} | forecaster.left_out_errors_
        else:
            errors = forecaster.compare(transformed(front, X), y)
        order, horizons = sorted_horizons(forecaster)
        return cls(
            horizons=np.multiply(horizons, dt or 1, dtype=np.float64),
            errors={
                name: np.linalg.norm(each[order, column], axis=1)
                for name, each in errors.items()
            },
            horizon_label="horizon [samples]" if dt is None else "horizon [s]",
            output_name=known_as if output_name is None else output_name,
            unit=unit,
        ).plot(ax, **artist_kw)

    def plot(self, ax: Any = None, *, line_kw: Keywords = None) -> Self:
        """Draw the errors.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw : dict, default=None
            Keyword arguments for the lines.

        Returns
        -------
        display : HorizonErrorDisplay
            The display itself.
        """
        ax = self._set_axes(ax)
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        self.lines_ = []
        for name, values in self.errors.items():
            style = merge_style({**_style(name), "label": name}, line_kw)
            shown = np.where(values > 0, values, np.nan)
            self.lines_ += ax.plot(self.horizons, shown, **style)
        label = with_unit(f"rms error of {self.output_name}", self.unit)
        ax.set(xlabel=self.horizon_label, ylabel=label, yscale="log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.grid(color="0.9")
        n_columns = 4 if len(self.errors) <= 4 else 3  # corrections have long names
        n_rows = -(-len(self.errors) // n_columns)
        low, high = ax.dataLim.intervaly
        if 0 < low < high:
            span = high / low
            ax.set_ylim(low / span**0.05, high * span ** (0.05 + HEADROOM * n_rows))
        ax.legend(loc="upper center", ncols=n_columns, fontsize="small")
        return self


def _left_out(forecaster: Any) -> Array:
    """Return the errors of what was chosen at each horizon."""
    errors = forecaster.left_out_errors_
    chosen = [
        errors.get(f"{n}{CORRECTED}", errors.get(n)) for n in forecaster.baselines_
    ]
    return np.array([each[row] for row, each in enumerate(chosen)])


def _style(name: str) -> dict[str, Any]:
    """Return how to draw the errors of a forecast, a baseline or a correction."""
    if name == FORECAST:
        style = {"color": ORANGE, "linestyle": "--", "linewidth": 2, "zorder": 3}
        return style | {"marker": "o", "markersize": 6}
    color = BASELINE_COLORS[name.removesuffix(CORRECTED)]
    style = {"color": color, "markersize": 4, "linewidth": 1.2}
    if name.endswith(CORRECTED) or name == "direct":
        return style | {"marker": "s"}
    return style | {"marker": "o", "linestyle": ":", "markerfacecolor": "none"}
