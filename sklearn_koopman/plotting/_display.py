"""What all displays share: axes, colours, styles, scales and labels."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy.ndimage import binary_dilation

from .._utils._typing import Array

# Okabe and Ito's colours, which people with any colour vision can tell apart.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BLUE, ORANGE, GREEN, *_ = COLORS
# One more than colours, so that both together repeat after 42 curves only.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

# Keyword arguments for an artist of matplotlib.
Keywords: TypeAlias = Mapping[str, Any] | None


class Display:
    """Base class of the displays. It keeps the axes that a display is drawn on."""

    ax_: Any
    figure_: Any

    def _set_axes(self, ax: Any, projection: str | None = None) -> Any:
        """Store and return the given axes, or the axes of a new figure."""
        try:
            import matplotlib.pyplot as plt
        except ImportError as error:
            raise ImportError(
                "Drawing needs matplotlib, which is not installed; install it by "
                'pip install "sklearn-koopman[plot]".'
            ) from error
        if ax is None:
            ax = plt.figure(layout="constrained").add_subplot(projection=projection)
        self.ax_, self.figure_ = ax, ax.figure
        return ax


def merge_style(
    defaults: Mapping[str, Any], given: Keywords, *, collection: bool = False
) -> dict[str, Any]:
    """Let keyword arguments of the caller, under any alias, replace the defaults.

    Parameters
    ----------
    defaults : dict
        Keyword arguments of this package, by their full names.
    given : dict or None
        Keyword arguments of the user, by any of their names.
    collection : bool, default=False
        Whether they are for a collection. False for a line.

    Returns
    -------
    style : dict
        Both, those of the user first.
    """
    from matplotlib import cbook, collections, lines

    artist: Any = collections.Collection if collection else lines.Line2D
    return {**defaults, **cbook.normalize_kwargs(dict(given or {}), artist)}


def count_curves(ax: Any, uncounted: Collection[str] = ()) -> int:
    """Count the lines on axes that have a label, other than some labels.

    Parameters
    ----------
    ax : matplotlib Axes
        The axes.
    uncounted : collection of str, default=()
        Labels of curves that do not count.

    Returns
    -------
    n_curves : int
        The number of the curves.
    """
    labels = [str(line.get_label()) for line in ax.lines]
    return sum(not x.startswith("_") and x not in uncounted for x in labels)


class CurveDisplay(Display):
    """Base class of the displays of curves on logarithmic axes."""

    def _next_style(
        self, label: str, given: Keywords, uncounted: Collection[str] = ()
    ) -> dict[str, Any]:
        """Return how to draw the next curve, different from those on the axes."""
        n = count_curves(self.ax_, uncounted)
        color, marker = COLORS[n % len(COLORS)], MARKERS[n % len(MARKERS)]
        style = {"color": color, "marker": marker, "markersize": 5, "linewidth": 1.2}
        return merge_style(style | {"label": label}, given)

    def _draw_curve(self, x: Array, y: Array, style: Mapping[str, Any]) -> Any:
        """Draw the points that the axes can show, from left to right."""
        order = np.argsort(x, kind="stable")
        order = order[((x > 0) & (y > 0) & np.isfinite(x) & np.isfinite(y))[order]]
        (line,) = self.ax_.loglog(x[order], y[order], **style)
        return line

    def _finish(self, title: str | None, xlabel: str, ylabel: str) -> None:
        """Add labels, a legend with a title, and ticks that do not overlap."""
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        low, high = self.ax_.get_xlim()
        axis = self.ax_.xaxis
        axis.set_minor_formatter(NullFormatter())
        if high < 100 * low:  # up to two powers of ten: label what is between, too
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        self.ax_.set(xlabel=xlabel, ylabel=ylabel)
        size = "small" if count_curves(self.ax_) <= 4 else "x-small"
        options = {"fontsize": size, "title_fontsize": size, "alignment": "left"}
        self.ax_.legend(title=title, **options)


def with_unit(name: str, unit: str | None) -> str:
    """Return the label of an axis.

    Parameters
    ----------
    name : str
        The name of a quantity.
    unit : str or None
        Its unit. None for no unit.

    Returns
    -------
    label : str
        The name, and the unit in brackets.
    """
    return name if unit is None else f"{name} [{unit}]"


def slope_text(slope: float, interval: Sequence[float], kind: str, power: float) -> str:
    """Write a slope, half its interval, and the known power of this kind, if any.

    Parameters
    ----------
    slope : float
        The slope that was fitted.
    interval : sequence of two float
        Its confidence interval; NaN for none.
    kind : str
        What the known power is, such as "expected".
    power : float
        The known power; infinite for any power, NaN for none.

    Returns
    -------
    text : str
        The text for a legend.
    """
    half = (interval[1] - interval[0]) / 2
    error = f" ± {half:.2f}" if np.isfinite(half) else ""
    text = f"{slope:.2f}{error}" if np.isfinite(slope) else "no slope"
    if not np.isnan(power):
        text += f" ({kind}: any power)" if np.isinf(power) else f" ({kind} {power:.3g})"
    return text.replace("-", "\N{MINUS SIGN}")


def cut_surface(values: Array, low: float, high: float) -> Array:
    """Clip a surface at the edge of a range, and blank it (NaN) farther out.

    Parameters
    ----------
    values : ndarray of shape (n_rows, n_columns)
        The heights of the surface.
    low : float
        The lower end of the range.
    high : float
        The upper end of the range.

    Returns
    -------
    values : ndarray of shape (n_rows, n_columns)
        The heights that are drawn, NaN elsewhere.
    """
    inside = (values >= low) & (values <= high)
    edge = binary_dilation(inside, np.ones((3, 3), dtype=bool))
    return np.where(edge, np.clip(values, low, high), np.nan)
