"""Display of an estimate as a surface over two state variables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.utils import check_array
from sklearn.utils.validation import check_is_fitted

from .._utils._pipeline import unwrap
from .._utils._typing import Array
from .._utils._validation import check_integer, check_number
from ._display import BLUE, GREEN, ORANGE, Display, Keywords, cut_surface, merge_style
from ._inputs import locate_centers, predict_like, resolve_names, select_output

# Surfaces are drawn this far beyond the outputs, as a fraction of their range.
MARGIN = 0.25
# Functions may grow large away from the data: these quantiles limit their range.
QUANTILES = (0.01, 0.99)


@dataclass(kw_only=True, eq=False, repr=False)
class SurfaceDisplay(Display):  # numpydoc ignore=PR02
    """Estimate over a plane of states, above the motion that it was learned from.

    The mesh is the estimate of the next output, a function on the whole plane. The
    samples are the motion, each at the height of its output. Only near the samples can
    the estimate be trusted. The centres are shown twice: in the plane of states at the
    bottom, and on the mesh where the estimate interpolates their outputs.

    Create a display by :meth:`from_estimator`. All parameters are stored as attributes.

    Parameters
    ----------
    xx0, xx1 : ndarray of shape (grid_resolution, grid_resolution)
        The states of the grid, as :func:`numpy.meshgrid` returns them.
    estimate : ndarray of shape (grid_resolution, grid_resolution)
        The estimate on the grid, in the unit of the output.
    truth : ndarray of shape (grid_resolution, grid_resolution), default=None
        The true function on the grid, if it is known.
    samples : ndarray of shape (n_samples, 2), default=None
        The states of the motion.
    sample_values : ndarray of shape (n_samples,), default=None
        The outputs of the samples.
    centers : ndarray of shape (n_centers, 2), default=None
        The centres.
    center_values : ndarray of shape (n_centers,), default=None
        The estimate at the centres.
    z_limits : tuple of two float, default=None
        The range of outputs that is drawn. An estimate may grow large away from the
        data, and would flatten everything else. None for the range of all
        `sample_values` and of the middle 98 % of `truth`, extended by a quarter on both
        sides (without either, the range of the middle 98 % of `estimate`). Surfaces
        are clipped where they leave the range, and left out beyond.
    feature_names : sequence of two str, default=None
        Names of the states, with their units. None for "x0" and "x1".
    output_name : str, default=None
        Name of the output, with its unit. None for "output".

    Attributes
    ----------
    estimate_ : matplotlib Poly3DCollection
        The estimate.
    truth_ : matplotlib Poly3DCollection or None
        The true function.
    samples_, centers_, interpolated_ : matplotlib Line3D or None
        The samples, the centres in the plane of states, and the centres on the
        estimate.
    handles_ : list of matplotlib artists
        The entries of the legend, for a legend that several displays share.
    ax_ : matplotlib Axes3D
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    CenterSelectionDisplay : The centres alone, in the plane.
    ForecastDisplay : Estimates over time, of states in any dimension.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.plotting import SurfaceDisplay
    >>> pendulum = make_pendulum(256)
    >>> model = KoopmanKernelRegressor(
    ...     "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ... ).fit(pendulum.X, pendulum.y)
    >>> display = SurfaceDisplay.from_estimator(
    ...     model, pendulum.X, pendulum.y, function=lambda x: pendulum.G(pendulum.f(x))
    ... )
    >>> display.estimate.shape
    (50, 50)
    >>> plt.close(display.figure_)
    """

    xx0: Array
    xx1: Array
    estimate: Array
    truth: Array | None = None
    samples: Array | None = None
    sample_values: Array | None = None
    centers: Array | None = None
    center_values: Array | None = None
    z_limits: tuple[float, float] | None = None
    feature_names: Sequence[str] | None = None
    output_name: str | None = None

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        y: Any = None,
        *,
        function: Callable[[Array], Any] | None = None,
        output: int = 0,
        grid_resolution: int = 50,
        padding: float = 0.1,
        z_limits: tuple[float, float] | None = None,
        feature_names: Sequence[str] | None = None,
        output_name: str | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot the estimate of a fitted model of two state variables.

        Parameters
        ----------
        estimator : estimator instance
            A fitted regressor, or a pipeline or a search of one. Centres are shown for
            those of this package, and for a pipeline if `X` holds the rows that it was
            fitted to.
        X : array-like of shape (n_samples, 2)
            States of the motion; for a pipeline as they enter its first step.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
            Their outputs one step later. None for the values of `function`, or of the
            estimate if there is no `function`.
        function : callable, default=None
            The true function from states of shape (n, 2) to outputs one step later.
        output : int, default=0
            Which of several outputs.
        grid_resolution : int, default=50
            Number of grid points in each direction.
        padding : float, default=0.1
            How far the grid reaches beyond the states on each side, as a fraction of
            their range.
        z_limits : tuple of two float, default=None
            The range of outputs that is drawn. None for the range of the data, extended
            by a quarter on both sides; see :class:`SurfaceDisplay`.
        feature_names : sequence of two str, default=None
            Names of the states, with their units. None for the names seen by `fit`.
        output_name : str, default=None
            Name of the output, with its unit.
        ax : matplotlib Axes3D, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `estimate_kw`, `truth_kw`, `sample_kw`, `center_kw`,
            `interpolated_kw` and `legend` of :meth:`plot`.

        Returns
        -------
        display : SurfaceDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is not fitted; if `X` has not two features; if there is no
            such output; if `y`, or what `function` returns, does not fit; if a
            parameter is outside its range; if `ax` is not three-dimensional.
        """
        check_is_fitted(estimator)
        check_integer(grid_resolution, "grid_resolution", 2)
        check_number(padding, "padding")
        states = check_array(X, dtype=np.float64, input_name="X")
        if states.shape[1] != 2:
            raise ValueError(
                f"X must have two features to draw a surface above them, got "
                f"{states.shape[1]}; take ForecastDisplay for other numbers."
            )
        limits = (0.0, 1.0) if z_limits is None else z_limits
        if np.shape(limits) != (2,) or not -np.inf < limits[0] < limits[1] < np.inf:
            raise ValueError(f"z_limits must be two rising numbers, got {z_limits!r}.")
        centers = locate_centers(estimator, X, states)
        low, high = states.min(axis=0), states.max(axis=0)
        size = np.where(high > low, high - low, np.maximum(np.abs(low), 1))
        axes = np.linspace(low - padding * size, high + padding * size, grid_resolution)
        xx0, xx1 = np.meshgrid(*axes.T)
        grid = np.column_stack([xx0.ravel(), xx1.ravel()])

        estimate = predict_like(estimator, X, grid, output)
        truth = at_centers = None
        if function is not None:
            truth = select_output(function(grid), output, len(grid), "function(X)")
            truth = truth.reshape(xx0.shape)
            y = function(states) if y is None else y
        if centers is not None:
            at_centers = predict_like(estimator, X, centers, output)
        if y is None:
            values = predict_like(estimator, X, states, output)
        else:
            values = select_output(y, output, len(states), "y")
        return cls(
            xx0=xx0,
            xx1=xx1,
            estimate=estimate.reshape(xx0.shape),
            truth=truth,
            samples=states,
            sample_values=values,
            centers=centers,
            center_values=at_centers,
            z_limits=z_limits,
            feature_names=resolve_names(unwrap(estimator)[0], X, feature_names),
            output_name=output_name,
        ).plot(ax, **artist_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        estimate_kw: Keywords = None,
        truth_kw: Keywords = None,
        sample_kw: Keywords = None,
        center_kw: Keywords = None,
        interpolated_kw: Keywords = None,
        legend: bool = True,
    ) -> Self:
        """Draw the surfaces, the samples and the centres.

        Parameters
        ----------
        ax : matplotlib Axes3D, default=None
            The axes to draw on. None for those of a new figure.
        estimate_kw, truth_kw : dict, default=None
            Keyword arguments for ``plot_surface``.
        sample_kw, center_kw, interpolated_kw : dict, default=None
            Keyword arguments for the lines of samples, centres and centres on the
            estimate.
        legend : bool, default=True
            Whether to draw a legend.

        Returns
        -------
        display : SurfaceDisplay
            The display itself.

        Raises
        ------
        ValueError
            If `ax` is not three-dimensional.
        """
        if ax is not None and not hasattr(ax, "plot_surface"):
            raise ValueError(
                "ax must be three-dimensional; make it by "
                "plt.subplots(subplot_kw={'projection': '3d'})."
            )
        ax = self._set_axes(ax, "3d")
        from matplotlib.patches import Patch

        low, high = self.z_limits or self._limits()
        # Translucent surfaces first, and points on top of them: matplotlib would sort
        # whole artists by their mean depth.
        ax.computed_zorder = False
        handles: list[Any] = []

        def _surface(values: Array, label: str, defaults: Any, given: Any) -> Any:
            kw = merge_style(defaults, given, collection=True)
            values = cut_surface(values, low, high)
            drawn = ax.plot_surface(self.xx0, self.xx1, values, **kw)
            color = kw.get("color", kw.get("facecolor"))
            edge = kw.get("edgecolor", "none")
            handles.append(Patch(fc=color, ec=edge, alpha=kw["alpha"], label=label))
            return drawn

        def _points(x: Array, z: Any, defaults: Any, given: Any) -> Any:
            kw = merge_style({"linestyle": "none", "marker": "o"} | defaults, given)
            (drawn,) = ax.plot(*x.T, z, **kw)
            handles.append(drawn)
            return drawn

        self.truth_ = self.samples_ = self.centers_ = self.interpolated_ = None
        if self.truth is not None:
            style = {"color": GREEN, "alpha": 0.35, "linewidth": 0, "zorder": 2}
            style |= {"rcount": len(self.truth), "ccount": len(self.truth)}
            self.truth_ = _surface(self.truth, "true function", style, truth_kw)
        style = {"color": BLUE, "edgecolor": BLUE, "alpha": 0.25, "linewidth": 0.4}
        style |= {"rcount": 25, "ccount": 25, "shade": False, "zorder": 3}
        self.estimate_ = _surface(self.estimate, "estimate", style, estimate_kw)
        if self.samples is not None and self.sample_values is not None:
            style = {"color": "k", "markersize": 1.5, "label": "samples", "zorder": 4}
            self.samples_ = _points(self.samples, self.sample_values, style, sample_kw)
        if self.centers is not None and self.center_values is not None:
            n = len(self.centers)
            size = float(np.clip(30 / np.sqrt(n), 1.2, 5))
            style = {"color": ORANGE, "markersize": size, "zorder": 5}
            on_mesh = style | {"label": "estimate at the centres"}
            values = np.ma.masked_outside(self.center_values, low, high).filled(np.nan)
            self.interpolated_ = _points(self.centers, values, on_mesh, interpolated_kw)
            style |= {"markerfacecolor": "none", "zorder": 1, "label": f"{n} centres"}
            style["markeredgewidth"] = max(size / 6, 0.4)
            self.centers_ = _points(self.centers, np.full(n, low), style, center_kw)
        names = self.feature_names or ("x0", "x1")
        output = self.output_name or "output"
        ax.set(xlabel=names[0], ylabel=names[1], zlabel=output, zlim=(low, high))
        ax.locator_params(nbins=5)
        self.handles_ = handles
        if legend:
            ax.legend(handles=handles, loc="upper left", fontsize="small")
        return self

    def _limits(self) -> tuple[float, float]:
        """Return the range of outputs that is worth drawing."""
        measured = _finite_quantiles(self.sample_values, (0, 1))
        ranges = [*measured, *_finite_quantiles(self.truth, QUANTILES)]
        ranges = ranges or [*_finite_quantiles(self.estimate, QUANTILES)] or [0.0]
        low, high = min(ranges), max(ranges)
        margin = MARGIN * (high - low) or 1.0
        return float(low - margin), float(high + margin)


def _finite_quantiles(values: Array | None, quantiles: tuple[float, float]) -> Array:
    """Return quantiles of the finite values; none if there are no such values."""
    finite = np.empty(0) if values is None else values[np.isfinite(values)]
    return np.quantile(finite, quantiles) if len(finite) else finite
