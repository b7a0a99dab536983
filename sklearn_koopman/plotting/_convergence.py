"""Display of studies of convergence: how errors fall with more centres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sklearn_koopman._utils._typing import Array
from sklearn_koopman.plotting._inputs import check_choice, check_study, kernel_name
from sklearn_koopman.plotting._style import (
    axes_for,
    drawable,
    finish_curves,
    line_style,
    next_style,
    slope_text,
    with_unit,
)

__all__ = ["ConvergenceDisplay"]


ERRORS = {"sup_error": "largest error", "rms_error": "root mean square error"}
ABOVE = 1.5  # the guarantee is drawn this many times above the errors


class ConvergenceDisplay:
    """Error of an estimate against the fill distance of its centres.

    On logarithmic axes the order of convergence is a slope. The dashed line has the
    slope that theory guarantees for the kernel, and lies a little above the errors: the
    theory tells its slope, not its height. Hollow points are not in the fit, mostly as
    they are at the level of rounding errors.

    It is recommended to create it by :meth:`from_study` or :meth:`from_estimator`. All
    parameters are stored as attributes. Several displays on the same axes get colours
    and markers of their own.

    Parameters
    ----------
    fill_distance : ndarray of shape (n_separations,)
        The fill distances.
    error : ndarray of shape (n_separations,)
        The errors. Those which are zero or not finite are not drawn.
    used : ndarray of shape (n_separations,), default=None
        Whether each is in the fit of the slope. None for all.
    slope : float, default=nan
        The slope of log `error` against log `fill_distance`.
    slope_interval : tuple of two float, default=(nan, nan)
        Its confidence interval.
    guaranteed_slope : float, default=nan
        The order that theory guarantees: infinite if the error falls faster than any
        power, NaN if it guarantees nothing.
    confidence : float, default=0.95
        That of the interval.
    quantity : {"sup_error", "rms_error"}, default="sup_error"
        Which error it is.
    name : str, default=None
        What it is the error of.
    state_unit, output_unit : str, default=None
        Units for the labels of the axes.

    Attributes
    ----------
    line_ : matplotlib Line2D
        The errors that the slope is fitted to.
    unused_ : matplotlib Line2D or None
        The others, hollow.
    bound_ : matplotlib Line2D or None
        The guaranteed slope, dashed.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure that they are in.

    See Also
    --------
    ConditioningDisplay : The price of more centres.
    sklearn_koopman.diagnostics.convergence_study : Computes what is shown.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from sklearn_koopman.plotting import ConvergenceDisplay
    >>> h = np.array([0.4, 0.2, 0.1])
    >>> display = ConvergenceDisplay(
    ...     fill_distance=h, error=h**3, slope=3.0, guaranteed_slope=1.5, name="mine"
    ... ).plot()
    >>> display.line_.get_label()
    'mine: 3.00 (guaranteed 1.5)'
    >>> plt.close(display.figure_)
    """

    def __init__(
        self,
        *,
        fill_distance: Array,
        error: Array,
        used: NDArray[np.bool_] | None = None,
        slope: float = np.nan,
        slope_interval: Sequence[float] = (np.nan, np.nan),
        guaranteed_slope: float = np.nan,
        confidence: float = 0.95,
        quantity: str = "sup_error",
        name: str | None = None,
        state_unit: str | None = None,
        output_unit: str | None = None,
    ) -> None:
        self.fill_distance = fill_distance
        self.error = error
        self.used = used
        self.slope = slope
        self.slope_interval = slope_interval
        self.guaranteed_slope = guaranteed_slope
        self.confidence = confidence
        self.quantity = quantity
        self.name = name
        self.state_unit = state_unit
        self.output_unit = output_unit

    @classmethod
    def from_study(
        cls,
        study: Mapping[str, Any],
        *,
        quantity: str = "sup_error",
        name: str | None = None,
        state_unit: str | None = None,
        output_unit: str | None = None,
        ax: Any = None,
        line_kw: Mapping[str, Any] | None = None,
        bound_kw: Mapping[str, Any] | None = None,
    ) -> ConvergenceDisplay:
        """Plot a convergence study.

        Parameters
        ----------
        study : :class:`~sklearn.utils.Bunch`
            What :func:`sklearn_koopman.diagnostics.convergence_study` returned.
        quantity : {"sup_error", "rms_error"}, default="sup_error"
            Which error to show.
        name : str, default=None
            What to call it in the legend. None for the kernel.
        state_unit, output_unit : str, default=None
            Units for the labels of the axes.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, bound_kw : dict, default=None
            Keyword arguments for the lines of the errors and of the guarantee.

        Returns
        -------
        display : ConvergenceDisplay
            The display.

        Raises
        ------
        ValueError
            If `study` is no convergence study, or there is no such `quantity`.
        """
        check_choice(quantity, "quantity", ERRORS)
        check_study(study, "convergence_study", "sup_error")
        sup = quantity == "sup_error"
        guaranteed = study["guaranteed_slope"]
        if not sup and not np.isnan(guaranteed):
            guaranteed = study["rates"]["rms_exponent"]
        return cls(
            fill_distance=study["fill_distance"],
            error=study[quantity],
            used=study["used"],
            slope=study["slope" if sup else "rms_slope"],
            slope_interval=study["slope_interval" if sup else "rms_slope_interval"],
            guaranteed_slope=guaranteed,
            confidence=study["confidence"],
            quantity=quantity,
            name=kernel_name(study["kernel"]) if name is None else name,
            state_unit=state_unit,
            output_unit=output_unit,
        ).plot(ax, line_kw=line_kw, bound_kw=bound_kw)

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        y: Any,
        separations: Any,
        X_test: Any,
        y_test: Any,
        *,
        dimension: int | None = None,
        confidence: float = 0.95,
        **display_kw: Any,
    ) -> ConvergenceDisplay:
        """Make a convergence study and plot it.

        Parameters
        ----------
        estimator : KoopmanKernelRegressor
            The model to fit at every separation.
        X, y, separations, X_test, y_test : array-like
            As for :func:`sklearn_koopman.diagnostics.convergence_study`.
        dimension : int, default=None
            Dimension of the manifold; None to estimate it.
        confidence : float, default=0.95
            That of the interval of the slope.
        **display_kw : dict
            What :meth:`from_study` takes.

        Returns
        -------
        display : ConvergenceDisplay
            The display.
        """
        from sklearn_koopman.diagnostics import convergence_study

        study = convergence_study(
            estimator,
            *(X, y, separations, X_test, y_test),
            dimension=dimension,
            confidence=confidence,
        )
        return cls.from_study(study, **display_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        line_kw: Mapping[str, Any] | None = None,
        bound_kw: Mapping[str, Any] | None = None,
    ) -> ConvergenceDisplay:
        """Draw the errors and the guaranteed slope.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, bound_kw : dict, default=None
            Keyword arguments for the lines of the errors and of the guarantee.

        Returns
        -------
        display : ConvergenceDisplay
            The display itself.
        """
        check_choice(self.quantity, "quantity", ERRORS)
        ax = axes_for(ax)
        _, color, marker = next_style(ax)
        h, error = np.asarray(self.fill_distance), np.asarray(self.error)
        used = np.full(len(h), True) if self.used is None else np.asarray(self.used)
        shown = drawable(h, error)
        order = np.argsort(h, kind="stable")
        fitted, rest = order[(shown & used)[order]], order[(shown & ~used)[order]]
        style = {"color": color, "marker": marker, "markersize": 5, "linewidth": 1.2}
        style = line_style({**style, "label": self._label()}, line_kw)
        (self.line_,) = ax.loglog(h[fitted], error[fitted], **style)
        self.unused_ = self.bound_ = None
        if len(rest):
            hollow = {"linestyle": "none", "markerfacecolor": "none"}
            hollow["label"] = "_unused"
            (self.unused_,) = ax.loglog(h[rest], error[rest], **{**style, **hollow})
        anchored = fitted if len(fitted) else rest
        if np.isfinite(self.guaranteed_slope) and len(anchored):
            ends = h[anchored[[0, -1]]]
            ratio = error[anchored] / h[anchored] ** self.guaranteed_slope
            style = {"linestyle": "--", "linewidth": 1, "label": "_guaranteed"}
            (self.bound_,) = ax.loglog(
                ends,
                ABOVE * ratio.max() * ends**self.guaranteed_slope,
                **line_style({**style, "color": self.line_.get_color()}, bound_kw),
            )
        ax.set(
            xlabel=with_unit("fill distance", self.state_unit),
            ylabel=with_unit(ERRORS[self.quantity], self.output_unit),
        )
        title = f"slope ± {self.confidence:.0%} interval"
        labels = {line.get_label() for line in ax.lines}
        title += ", dashed: guaranteed" * ("_guaranteed" in labels)
        title += ", hollow: not fitted" * ("_unused" in labels)
        finish_curves(ax, title)
        self.ax_ = ax
        self.figure_ = ax.figure
        return self

    def _label(self) -> str:
        guaranteed = f"guaranteed {self.guaranteed_slope:.3g}"
        if np.isinf(self.guaranteed_slope):
            guaranteed = "guaranteed: any power"
        elif np.isnan(self.guaranteed_slope):
            guaranteed = "no guarantee"
        name = "" if self.name is None else f"{self.name}: "
        return f"{name}{slope_text(self.slope, self.slope_interval)} ({guaranteed})"
