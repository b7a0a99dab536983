"""Display of the samples and the centres chosen among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.frozen import FrozenEstimator
from sklearn.utils import check_array
from sklearn.utils.validation import check_is_fitted

from .._utils._pipeline import unwrap
from .._utils._typing import Array
from ..centers import resolve_separation
from ..diagnostics import fill_distance, separation_distance
from ._display import BLUE, Display, Keywords, merge_style
from ._inputs import find_centers, resolve_names

# Up to this many samples matplotlib looks for the best place of the legend.
MAX_SAMPLES_TO_AVOID = 2000


@dataclass(kw_only=True, eq=False, repr=False)
class CenterSelectionDisplay(Display):  # numpydoc ignore=PR02
    """Samples, the centres among them, and the separation of the centres.

    Create a display by :meth:`from_estimator`. All parameters are stored as attributes.

    Parameters
    ----------
    samples : ndarray of shape (n_samples, n_features)
        The samples.
    centers : ndarray of shape (n_centers, n_features)
        The centres.
    separation : float, default=None
        The distance that centres keep from each other, drawn as the radius of circles:
        no centre lies in the circle of another one. None or 0 for no circles. With more
        than two features no circles are drawn either, because samples inside of a
        circle need not be near its centre.
    separation_distance : float, default=None
        Half the smallest distance of two centres.
    fill_distance : float, default=None
        The largest distance of a sample from its nearest centre.
    features : tuple of two int, default=(0, 1)
        The features on the axes.
    feature_names : sequence of str, default=None
        Names of all features, with their units. None for "x0", "x1" and so on.

    Attributes
    ----------
    samples_ : matplotlib Line2D
        The samples.
    centers_ : matplotlib Line2D
        The centres.
    circles_ : matplotlib PatchCollection or None
        The circles, in the unit of the states.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    sklearn_koopman.SeparatedCenterSelector : Selects centres.
    SurfaceDisplay : The function that is estimated from the centres.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_koopman import SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.plotting import CenterSelectionDisplay
    >>> X = make_pendulum(256).X
    >>> selector = SeparatedCenterSelector(0.23).fit(X)
    >>> display = CenterSelectionDisplay.from_estimator(
    ...     selector, X, feature_names=["momentum [rad/s]", "position [rad]"]
    ... )
    >>> display.ax_.get_title().splitlines()[0]
    '37 centres of 256 samples'
    >>> plt.close(display.figure_)
    """

    samples: Array
    centers: Array
    separation: float | None = None
    separation_distance: float | None = None
    fill_distance: float | None = None
    features: Sequence[int] = (0, 1)
    feature_names: Sequence[str] | None = None

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        *,
        features: Sequence[int] = (0, 1),
        feature_names: Sequence[str] | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot the centres of a fitted selector or model.

        Parameters
        ----------
        estimator : estimator instance
            A fitted :class:`~sklearn_koopman.SeparatedCenterSelector`,
            :class:`~sklearn_koopman.KoopmanKernelRegressor` or
            :class:`~sklearn_koopman.KernelEDMD`, or another with `cluster_centers_`.
        X : array-like of shape (n_samples, n_features)
            The samples that it was fitted to, or others.
        features : tuple of two int, default=(0, 1)
            The features on the axes.
        feature_names : sequence of str, default=None
            Names of all features, with their units. None for the names seen by `fit`.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `sample_kw`, `center_kw` and `circle_kw` of :meth:`plot`.

        Returns
        -------
        display : CenterSelectionDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is not fitted, is a pipeline or has no centres of its own;
            if `X` has other features; if `features` are not two of them.
        """
        check_is_fitted(estimator)
        final, scaler = unwrap(estimator)
        if scaler is not None:
            raise ValueError(
                "estimator is a Pipeline, whose centres are on another scale than X; "
                "pass estimator[-1] and estimator[:-1].transform(X)."
            )
        centers = find_centers(final)
        if centers is None:
            raise ValueError(
                f"estimator={final!r} has no centres that are states; pass a selector "
                "or a model that is fitted to the states."
            )
        samples = check_array(X, dtype=np.float64, input_name="X")
        if samples.shape[1] != centers.shape[1]:
            raise ValueError(
                f"X has {samples.shape[1]} features, but the centres have "
                f"{centers.shape[1]}; pass the states that the estimator was fitted to."
            )
        known = range(samples.shape[1])
        if np.shape(features) != (2,) or len({*features} & {*known}) != 2:
            raise ValueError(
                f"features must be two different columns of X, from 0 to {known[-1]}, "
                f"got {features!r}."
            )
        return cls(
            samples=samples,
            centers=centers,
            separation=_used_separation(final),
            separation_distance=separation_distance(centers),
            fill_distance=fill_distance(centers, samples),
            features=features,
            feature_names=resolve_names(final, X, feature_names),
        ).plot(ax, **artist_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        sample_kw: Keywords = None,
        center_kw: Keywords = None,
        circle_kw: Keywords = None,
    ) -> Self:
        """Draw samples, centres and circles.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        sample_kw, center_kw : dict, default=None
            Keyword arguments for the lines of samples and centres.
        circle_kw : dict, default=None
            Keyword arguments for the collection of circles.

        Returns
        -------
        display : CenterSelectionDisplay
            The display itself.
        """
        ax = self._set_axes(ax)
        from matplotlib.collections import PatchCollection
        from matplotlib.lines import Line2D
        from matplotlib.patches import Circle

        columns = list(self.features)
        samples, centers = self.samples[:, columns], self.centers[:, columns]
        n_samples, n_centers = len(samples), len(centers)
        # Thousands of points leave no room for large dots.
        size = float(np.clip(60 / np.sqrt(n_centers), 2, 5.5))
        sample_size = float(np.clip(100 / np.sqrt(n_samples), 1, 3))
        dots: dict[str, Any] = {"linestyle": "none", "marker": "o"}
        style = dots | {"color": "0.7", "markersize": sample_size, "label": "samples"}
        (self.samples_,) = ax.plot(*samples.T, **merge_style(style, sample_kw))
        style = dots | {"color": BLUE, "markersize": size, "label": "centres"}
        (self.centers_,) = ax.plot(*centers.T, **merge_style(style, center_kw))
        handles = [self.samples_, self.centers_]
        self.circles_ = None
        is_plane = self.centers.shape[1] == 2
        if self.separation and is_plane:
            style = {"facecolor": "none", "edgecolor": BLUE, "linewidth": size / 8}
            style |= {"alpha": 0.6, "zorder": 1.5}
            style = merge_style(style, circle_kw, collection=True)
            circles = [Circle(center, self.separation) for center in centers]
            self.circles_ = PatchCollection(circles, **style)
            ax.add_collection(self.circles_)
            # A collection of patches has no entry in a legend of its own.
            style = dots | {"markersize": 9, "markerfacecolor": "none"}
            style["markeredgecolor"] = self.circles_.get_edgecolor()[0]
            label = f"separation {self.separation:.3g}"
            handles.append(Line2D([], [], label=label, **style))
        if is_plane:
            ax.set_aspect("equal", adjustable="datalim")
        names = self.feature_names or [f"x{i}" for i in range(self.centers.shape[1])]
        distances = {"separation": self.separation_distance, "fill": self.fill_distance}
        parts = [f"{k} distance {v:.3g}" for k, v in distances.items() if v is not None]
        title = f"{n_centers} centres of {n_samples} samples"
        title += "\n" * bool(parts) + ", ".join(parts)
        ax.set(xlabel=names[columns[0]], ylabel=names[columns[1]], title=title)
        is_quick = n_samples <= MAX_SAMPLES_TO_AVOID
        ax.legend(handles=handles, loc="best" if is_quick else "upper right")
        return self


def _used_separation(final: Any) -> float | None:
    """Return the separation of the centres of a fitted model or selector, if any."""
    centers = final.get_params().get("centers", final)
    separation = getattr(centers, "separation", None)
    if separation is None:
        return None
    # A model clones its selector, unless that is frozen, and fits it to its own states.
    fitted = centers if isinstance(centers, FrozenEstimator) else final
    return resolve_separation(separation, getattr(fitted, "_spread", None))
