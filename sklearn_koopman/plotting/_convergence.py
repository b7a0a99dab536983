"""Display of studies of convergence: how errors fall with more centres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from .._utils._typing import Array, Mask
from .._utils._validation import check_choice
from ..diagnostics import convergence_study
from ._display import CurveDisplay, Keywords, merge_style, slope_text, with_unit
from ._inputs import check_study, kernel_name

ERRORS = {"sup_error": "largest error", "rms_error": "root mean square error"}
# The guaranteed slope is drawn above the errors, at this multiple of the nearest one.
HEIGHT = 1.5


@dataclass(kw_only=True, eq=False, repr=False)
class ConvergenceDisplay(CurveDisplay):  # numpydoc ignore=PR02
    """Error of an estimate against the fill distance of its centres.

    The fill distance is the largest distance of a sample from its nearest centre. On
    logarithmic axes the order of convergence is a slope. The dashed line has the slope
    that theory guarantees for the kernel. The theory gives no height, so the line is
    drawn a little above the errors. Hollow points are left out of the fit, in most
    cases because they are at the level of rounding errors.

    Create a display by :meth:`from_study` or :meth:`from_estimator`. All parameters are
    stored as attributes. Several displays on the same axes get different colours and
    markers.

    Parameters
    ----------
    fill_distance : ndarray of shape (n_separations,)
        The fill distances, in the unit of the states.
    error : ndarray of shape (n_separations,)
        The errors, in the unit of the outputs. Errors that are zero or not finite are
        not drawn.
    used : ndarray of shape (n_separations,), default=None
        Whether the slope is fitted to each error. None for all.
    slope : float, default=nan
        The slope of log `error` against log `fill_distance`.
    slope_interval : tuple of two float, default=(nan, nan)
        The confidence interval of the slope.
    guaranteed_slope : float, default=nan
        The order that theory guarantees: infinite if the error falls faster than any
        power, NaN if nothing is guaranteed.
    confidence : float, default=0.95
        The level of the confidence interval.
    quantity : {"sup_error", "rms_error"}, default="sup_error"
        Whether the error is the largest one or the root mean square.
    name : str, default=None
        The name of the curve in the legend.
    state_unit, output_unit : str, default=None
        Units for the labels of the axes.

    Attributes
    ----------
    line_ : matplotlib Line2D
        The errors that the slope is fitted to.
    unused_ : matplotlib Line2D or None
        The other errors, hollow.
    bound_ : matplotlib Line2D or None
        The guaranteed slope, dashed.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

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

    fill_distance: Array
    error: Array
    used: Mask | None = None
    slope: float = np.nan
    slope_interval: Sequence[float] = (np.nan, np.nan)
    guaranteed_slope: float = np.nan
    confidence: float = 0.95
    quantity: str = "sup_error"
    name: str | None = None
    state_unit: str | None = None
    output_unit: str | None = None

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
        **artist_kw: Any,
    ) -> Self:
        """Plot a convergence study.

        Parameters
        ----------
        study : :class:`~sklearn.utils.Bunch`
            The result of :func:`sklearn_koopman.diagnostics.convergence_study`.
        quantity : {"sup_error", "rms_error"}, default="sup_error"
            Which error to show.
        name : str, default=None
            The name of the curve in the legend. None for the name of the kernel.
        state_unit, output_unit : str, default=None
            Units for the labels of the axes.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `line_kw` and `bound_kw` of :meth:`plot`.

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
        prefix = "" if quantity == "sup_error" else "rms_"
        guaranteed = study["guaranteed_slope"]
        if prefix and not np.isnan(guaranteed):
            guaranteed = study["rates"]["rms_exponent"]
        shared = {key: study[key] for key in ("fill_distance", "used", "confidence")}
        return cls(
            **shared,
            error=study[quantity],
            slope=study[f"{prefix}slope"],
            slope_interval=study[f"{prefix}slope_interval"],
            guaranteed_slope=guaranteed,
            quantity=quantity,
            name=kernel_name(study["kernel"]) if name is None else name,
            state_unit=state_unit,
            output_unit=output_unit,
        ).plot(ax, **artist_kw)

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
        dimension: float | None = None,
        confidence: float = 0.95,
        **display_kw: Any,
    ) -> Self:
        """Make a convergence study and plot it.

        Parameters
        ----------
        estimator : KoopmanKernelRegressor
            The model to fit at every separation.
        X, y, separations, X_test, y_test : array-like
            As for :func:`sklearn_koopman.diagnostics.convergence_study`.
        dimension : float, default=None
            Dimension of the manifold; None to estimate it.
        confidence : float, default=0.95
            The level of the confidence interval of the slope.
        **display_kw : dict
            Further parameters of :meth:`from_study`.

        Returns
        -------
        display : ConvergenceDisplay
            The display.

        Raises
        ------
        ValueError
            As :func:`sklearn_koopman.diagnostics.convergence_study`.
        """
        study = convergence_study(
            estimator,
            *(X, y, separations, X_test, y_test),
            dimension=dimension,
            confidence=confidence,
        )
        return cls.from_study(study, **display_kw)

    def plot(
        self, ax: Any = None, *, line_kw: Keywords = None, bound_kw: Keywords = None
    ) -> Self:
        """Draw the errors and the guaranteed slope.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, bound_kw : dict, default=None
            Keyword arguments for the line of the errors and for the guaranteed slope.

        Returns
        -------
        display : ConvergenceDisplay
            The display itself.
        """
        check_choice(self.quantity, "quantity", ERRORS)
        ax = self._set_axes(ax)
        h, error = np.asarray(self.fill_distance), np.asarray(self.error)
        used = np.full(len(h), True) if self.used is None else np.asarray(self.used)
        style = self._next_style(self._label(), line_kw)
        self.line_ = self._draw_curve(h[used], error[used], style)
        hollow = {"linestyle": "none", "markerfacecolor": "none", "label": "_unused"}
        self.unused_ = self.bound_ = None
        if not used.all():
            self.unused_ = self._draw_curve(h[~used], error[~used], style | hollow)
        drawn = self.line_ if len(self.line_.get_xdata()) else self.unused_
        slope = self.guaranteed_slope
        if drawn is not None and np.isfinite(slope):
            x, y = drawn.get_data()
            height, ends = HEIGHT * (y / x**slope).max(), x[[0, -1]]
            style = {"color": self.line_.get_color(), "linestyle": "--", "linewidth": 1}
            style = merge_style(style | {"label": "_guaranteed"}, bound_kw)
            (self.bound_,) = ax.loglog(ends, height * ends**slope, **style)
        title = f"slope ± {self.confidence:.0%} interval"
        labels = {line.get_label() for line in ax.lines}
        title += ", dashed: guaranteed" * ("_guaranteed" in labels)
        title += ", hollow: not fitted" * ("_unused" in labels)
        xlabel = with_unit("fill distance", self.state_unit)
        self._finish(title, xlabel, with_unit(ERRORS[self.quantity], self.output_unit))
        return self

    def _label(self) -> str:
        name = "" if self.name is None else f"{self.name}: "
        power = self.guaranteed_slope
        text = slope_text(self.slope, self.slope_interval, "guaranteed", power)
        return name + text + " (no guarantee)" * bool(np.isnan(power))
