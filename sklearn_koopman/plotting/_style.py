"""What all displays share: the import of matplotlib, colours, scales and labels."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from sklearn_koopman._utils._typing import Array

# Okabe and Ito's colours, which people with any colour vision can tell apart.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BLUE, ORANGE, GREEN, *_ = COLORS
# One more than colours, so that both together repeat after 42 curves only.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# Room for a row of legend entries above the curves, as a fraction of their range.
HEADROOM = 0.15


def import_pyplot() -> Any:
    """Import matplotlib, or say how to install it.

    Returns
    -------
    pyplot : module
        The module matplotlib.pyplot.
    """
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise ImportError(
            "Drawing needs matplotlib, which is not installed; install it by "
            'pip install "sklearn-koopman[plot]".'
        ) from error
    return plt


def axes_for(ax: Any, projection: str | None = None) -> Any:
    """Return axes to draw on.

    Parameters
    ----------
    ax : matplotlib Axes or None
        Those that were given, if any.
    projection : str, default=None
        The projection of new ones.

    Returns
    -------
    ax : matplotlib Axes
        Those given, or the axes of a new figure.
    """
    plt = import_pyplot()
    if ax is None:
        _, ax = plt.subplots(
            layout="constrained", subplot_kw={"projection": projection}
        )
    return ax


def merged(
    artist: str, defaults: Mapping[str, Any], given: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Let given keyword arguments replace defaults, under whichever alias.

    Parameters
    ----------
    artist : str
        Module and class of the artist, as in "lines.Line2D", in the place of the
        class, since importing this module must not import matplotlib.
    defaults : dict
        The keyword arguments of this package, under their full names.
    given : dict or None
        Those of the caller.

    Returns
    -------
    merged : dict
        Both, under their full names.
    """
    from matplotlib.cbook import normalize_kwargs

    module, name = artist.split(".")
    kind = getattr(import_module(f"matplotlib.{module}"), name)
    return {**defaults, **normalize_kwargs(dict(given or {}), kind)}


def line_style(defaults: Mapping[str, Any], given: Mapping[str, Any] | None) -> Any:
    """Let given keyword arguments of a line replace defaults.

    Parameters
    ----------
    defaults : dict
        The keyword arguments of this package, under their full names.
    given : dict or None
        Those of the caller.

    Returns
    -------
    merged : dict
        Both, under their full names.
    """
    return merged("lines.Line2D", defaults, given)


def next_style(ax: Any, uncounted: Collection[str] = ()) -> tuple[int, str, str]:
    """Choose how to draw the next curve on axes.

    Parameters
    ----------
    ax : matplotlib Axes
        The axes.
    uncounted : collection of str, default=()
        Labels of lines that are no curves. Lines without a label are none, either.

    Returns
    -------
    number : int
        The number of curves that are there.
    color, marker : str
        Those after theirs.
    """
    labels = [str(line.get_label()) for line in ax.lines]
    n = sum(not x.startswith("_") and x not in uncounted for x in labels)
    return n, COLORS[n % len(COLORS)], MARKERS[n % len(MARKERS)]


def with_unit(name: str, unit: str | None) -> str:
    """Make the label of an axis.

    Parameters
    ----------
    name : str
        What it shows.
    unit : str or None
        In which unit.

    Returns
    -------
    label : str
        Both.
    """
    return name if unit is None else f"{name} [{unit}]"


def slope_text(slope: float, interval: Sequence[float]) -> str:
    """Write a slope with half the width of its interval.

    Parameters
    ----------
    slope : float
        The slope.
    interval : sequence of two float
        Its confidence interval.

    Returns
    -------
    text : str
        Both, as far as they are finite.
    """
    if not np.isfinite(slope):
        return "no slope"
    half = (interval[1] - interval[0]) / 2
    error = f" ± {half:.2f}" if np.isfinite(half) else ""
    return f"{slope:.2f}{error}".replace("-", "\N{MINUS SIGN}")


def drawable(x: Array, y: Array) -> NDArray[np.bool_]:
    """Tell which points logarithmic axes can show.

    Parameters
    ----------
    x, y : ndarray of shape (n_points,)
        The points.

    Returns
    -------
    drawable : ndarray of shape (n_points,), bool
        Those of finite and positive coordinates.
    """
    return (x > 0) & (y > 0) & np.isfinite(x) & np.isfinite(y)


def finish_curves(ax: Any, title: str | None) -> None:
    """Add a legend, and a logarithmic horizontal axis whose labels do not overlap.

    Parameters
    ----------
    ax : matplotlib Axes
        The axes.
    title : str or None
        That of the legend.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = ax.get_xlim()
    axis = ax.xaxis
    axis.set_minor_formatter(NullFormatter())
    if high < 100 * low:  # up to two powers of ten: label what is between, too
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    n_curves = next_style(ax)[0]
    size = "small" if n_curves <= 4 else "x-small"
    ax.legend(title=title, fontsize=size, title_fontsize=size, alignment="left")


def limit_view(ax: Any, truth: Array) -> None:
    """Set the range of the vertical axis, not far beyond that of the truth.

    Parameters
    ----------
    ax : matplotlib Axes
        The axes, with everything drawn.
    truth : ndarray
        Values, beyond the least and the largest of which the axis shows as much again
        at the most.
    """
    truth = truth[np.isfinite(truth)]
    if not len(truth):
        return
    size = float(np.ptp(truth) or np.abs(truth).max() or 1.0)
    low, high = ax.dataLim.intervaly
    low, high = max(low, truth.min() - size), min(high, truth.max() + size)
    margin = 0.05 * ((high - low) or size)
    ax.set_ylim(low - margin, high + margin + HEADROOM * (high - low))


def cut_surface(values: Array, low: float, high: float) -> Array:
    """Clip a surface where it leaves a range, so that it ends there.

    Parameters
    ----------
    values : ndarray of shape (n_rows, n_columns)
        The surface over a grid.
    low, high : float
        The range.

    Returns
    -------
    cut : ndarray of shape (n_rows, n_columns)
        The values in the range; next to them `low` or `high`; NaN beyond.
    """
    inside = (values >= low) & (values <= high)
    reached = binary_dilation(inside, np.ones((3, 3), dtype=bool))
    return np.where(reached, np.clip(values, low, high), np.nan)
