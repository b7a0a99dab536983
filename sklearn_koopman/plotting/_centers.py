"""Display of the samples and the centres chosen among them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sklearn.utils import check_array
from sklearn.utils.validation import check_is_fitted

from sklearn_koopman._utils._pipeline import unwrap
from sklearn_koopman._utils._typing import Array
from sklearn_koopman.diagnostics import fill_distance, separation_distance
from sklearn_koopman.plotting._inputs import (
    known_centers,
    names_of_features,
)
from sklearn_koopman.plotting._style import BLUE, axes_for, line_style, merged

__all__ = ["CenterSelectionDisplay"]


class CenterSelectionDisplay:
    """Samples, the centres among them, and the distance that centres keep.

    It is recommended to create it by :meth:`from_estimator`. All parameters are stored
    as attributes.

    Parameters
    ----------
    samples : ndarray of shape (n_samples, n_features)
        The samples.
    centers : ndarray of shape (n_centers, n_features)
        The centres.
    separation : float, default=None
        Radius of the circles: no centre lies in the circle of another. None or 0 for
        none. With more than two features none are drawn, either, since points inside
        of a circle would not be near its centre.
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
        The figure that they are in.

    See Also
    --------
    sklearn_koopman.SeparatedCenterSelector : Selects centres.
    SurfaceDisplay : What is estimated from them.

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

    def __init__(
        self,
        *,
        samples: Array,
        centers: Array,
        separation: float | None = None,
        separation_distance: float | None = None,
        fill_distance: float | None = None,
        features: Sequence[int] = (0, 1),
        feature_names: Sequence[str] | None = None,
    ) -> None:
        self.samples = samples
        self.centers = centers
        self.separation = separation
        self.separation_distance = separation_distance
        self.fill_distance = fill_distance
        self.features = features
        self.feature_names = feature_names

    @classmethod
    def from_estimator(
        cls,
        estimator: Any,
        X: Any,
        *,
        features: Sequence[int] = (0, 1),
        feature_names: Sequence[str] | None = None,
        ax: Any = None,
        sample_kw: Mapping[str, Any] | None = None,
        center_kw: Mapping[str, Any] | None = None,
        circle_kw: Mapping[str, Any] | None = None,
    ) -> CenterSelectionDisplay:
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
            Names of all features, with their units. By default those seen by `fit`.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        sample_kw, center_kw : dict, default=None
            Keyword arguments for the lines of samples and centres.
        circle_kw : dict, default=None
            Keyword arguments for the collection of circles.

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
                "estimator is a Pipeline, whose centres live on another scale than X; "
                "pass estimator[-1] and estimator[:-1].transform(X)."
            )
        centers = known_centers(final)
        if centers is None:
            raise ValueError(
                f"estimator={final!r} has no centres that are states; pass a fitted "
                "SeparatedCenterSelector, or a model fitted to the states."
            )
        given = X
        X = check_array(X, dtype=np.float64, input_name="X")
        if X.shape[1] != centers.shape[1]:
            raise ValueError(
                f"X has {X.shape[1]} features, but the centres have "
                f"{centers.shape[1]}; pass the states that the estimator was fitted to."
            )
        names = names_of_features(final, given, feature_names)
        _check_features(features, X.shape[1])
        selector = (
            final if hasattr(final, "separation") else final.get_params().get("centers")
        )
        return cls(
            samples=X,
            centers=centers,
            separation=getattr(selector, "separation", None),
            separation_distance=separation_distance(centers),
            fill_distance=fill_distance(centers, X),
            features=features,
            feature_names=names,
        ).plot(ax, sample_kw=sample_kw, center_kw=center_kw, circle_kw=circle_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        sample_kw: Mapping[str, Any] | None = None,
        center_kw: Mapping[str, Any] | None = None,
        circle_kw: Mapping[str, Any] | None = None,
    ) -> CenterSelectionDisplay:
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
        ax = axes_for(ax)
        from matplotlib.collections import PatchCollection
        from matplotlib.lines import Line2D
        from matplotlib.patches import Circle

        columns = list(self.features)
        centers = self.centers[:, columns]
        # Thousands of points leave no room for large dots.
        size = float(np.clip(60 / np.sqrt(len(centers)), 2, 5.5))
        sample_size = float(np.clip(100 / np.sqrt(len(self.samples)), 1, 3))
        dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "label": "samples"}
        (self.samples_,) = ax.plot(
            *self.samples[:, columns].T,
            **line_style(dots | {"color": "0.7", "markersize": sample_size}, sample_kw),
        )
        dots["label"] = "centres"
        (self.centers_,) = ax.plot(
            *centers.T,
            **line_style(dots | {"color": BLUE, "markersize": size}, center_kw),
        )
        handles = [self.samples_, self.centers_]
        self.circles_ = None
        if self.separation and self.centers.shape[1] == 2:
            defaults = {
                "facecolor": "none",
                "edgecolor": BLUE,
                "linewidth": size / 8,
                "alpha": 0.6,
                "zorder": 1.5,
            }
            circles: Any = PatchCollection(
                [Circle((x, y), self.separation) for x, y in centers],
                **merged("collections.PatchCollection", defaults, circle_kw),
            )
            ax.add_collection(circles)
            self.circles_ = circles
            # A collection of patches has no entry in a legend of its own.
            handles.append(
                Line2D(
                    *([], []),
                    linestyle="none",
                    marker="o",
                    markersize=9,
                    markerfacecolor="none",
                    markeredgecolor=circles.get_edgecolor()[0],
                    label=f"separation {self.separation:.3g}",
                )
            )
        if self.centers.shape[1] == 2:
            ax.set_aspect("equal", adjustable="datalim")
        names = self.feature_names or [f"x{i}" for i in range(self.centers.shape[1])]
        title = f"{len(centers)} centres of {len(self.samples)} samples"
        found = {
            "separation distance": self.separation_distance,
            "fill distance": self.fill_distance,
        }
        details = [f"{k} {v:.3g}" for k, v in found.items() if v is not None]
        if details:
            title += "\n" + ", ".join(details)
        ax.set(xlabel=names[columns[0]], ylabel=names[columns[1]], title=title)
        # To look for the best place takes long among many points.
        few = len(self.samples) <= 2000
        ax.legend(handles=handles, loc="best" if few else "upper right")
        self.ax_ = ax
        self.figure_ = ax.figure
        return self


def _check_features(features: Any, n_features: int) -> None:
    """Refuse anything but two different numbers of features."""
    try:
        pair = [int(i) for i in features]
        fine = pair == list(features) and len(set(pair)) == len(pair) == 2
    except (TypeError, ValueError):
        fine = False
    if not fine or min(pair) < 0 or max(pair) >= n_features:
        raise ValueError(
            f"features must be two different columns of X, from 0 to "
            f"{n_features - 1}, got {features!r}."
        )
