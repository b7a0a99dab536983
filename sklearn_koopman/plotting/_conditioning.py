"""Display of studies of conditioning: what more, or closer, centres cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

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

__all__ = ["ConditioningDisplay"]


CONDITIONS = {
    "condition_number": "condition number",
    "smallest_eigenvalue": "smallest eigenvalue",
}
ALL_LOST = "all 16 digits lost"


class ConditioningDisplay:
    """Condition of Gram matrices against the separation distance of their centres.

    It is recommended to create it by :meth:`from_study` or :meth:`from_kernels`. All
    parameters are stored as attributes.

    Parameters
    ----------
    separation_distance : ndarray of shape (n_curves, n_points)
        Half the smallest distances of two centres.
    values : ndarray of shape (n_curves, n_points)
        Condition numbers or smallest eigenvalues. Those which are not finite, or not
        positive, are left out.
    labels : sequence of str
        What the curves are.
    quantity : {"condition_number", "smallest_eigenvalue"}, default="condition_number"
        Which of them.
    legend_title : str, default=None
        What all curves have in common.
    state_unit : str, default=None
        Unit for the label of the axis.

    Attributes
    ----------
    lines_ : list of matplotlib Line2D
        The curves.
    lost_ : matplotlib Line2D or None
        Where a condition number reaches the reciprocal of the relative rounding error,
        if there are such, or nearly.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure that they are in.

    See Also
    --------
    ConvergenceDisplay : What more centres gain.
    sklearn_koopman.diagnostics.conditioning_study : Computes what is shown.
    sklearn_koopman.diagnostics.crowding_study : The same for one crowded pair.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> import numpy as np
    >>> from sklearn_koopman.plotting import ConditioningDisplay
    >>> q = np.array([[0.4, 0.2, 0.1]])
    >>> display = ConditioningDisplay(
    ...     separation_distance=q, values=q**-5, labels=["mine"]
    ... ).plot()
    >>> display.ax_.get_ylabel()
    'condition number'
    >>> plt.close(display.figure_)
    """

    def __init__(
        self,
        *,
        separation_distance: Array,
        values: Array,
        labels: Sequence[str],
        quantity: str = "condition_number",
        legend_title: str | None = None,
        state_unit: str | None = None,
    ) -> None:
        self.separation_distance = separation_distance
        self.values = values
        self.labels = labels
        self.quantity = quantity
        self.legend_title = legend_title
        self.state_unit = state_unit

    @classmethod
    def from_study(
        cls,
        study: Mapping[str, Any],
        *,
        quantity: str | None = None,
        state_unit: str | None = None,
        ax: Any = None,
        line_kw: Mapping[str, Any] | None = None,
        lost_kw: Mapping[str, Any] | None = None,
    ) -> ConditioningDisplay:
        """Plot a study of conditioning or of crowding.

        Parameters
        ----------
        study : :class:`~sklearn.utils.Bunch`
            What :func:`sklearn_koopman.diagnostics.conditioning_study` or
            :func:`sklearn_koopman.diagnostics.crowding_study` returned.
        quantity : {"condition_number", "smallest_eigenvalue"}, default=None
            What to show. None for the condition number, and for the smallest eigenvalue
            of a study of crowding.
        state_unit : str, default=None
            Unit for the label of the axis.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, lost_kw : dict, default=None
            Keyword arguments for the curves, and for the line of no digits.

        Returns
        -------
        display : ConditioningDisplay
            The display.

        Raises
        ------
        ValueError
            If `study` is neither, or there is no such `quantity`.
        """
        check_study(
            study, "conditioning_study or crowding_study", "smallest_eigenvalue"
        )
        crowding = "gap" in study
        if quantity is None:
            quantity = "smallest_eigenvalue" if crowding else "condition_number"
        check_choice(quantity, "quantity", CONDITIONS)
        values = np.asarray(study[quantity])
        values = values.reshape(-1, values.shape[-1])
        if crowding:
            title: str | None = kernel_name(study["kernel"])
            labels = [
                f"M = {n}, fill distance {h:.2g}"
                for n, h in zip(study["n_centers"], study["fill_distance"], strict=True)
            ]
        else:
            slopes = quantity == "condition_number"
            title = None
            if slopes:
                title = f"slope ± {study.get('confidence', 0.95):.0%} interval"
            labels = [
                f"{kernel_name(kernel)}, β = {beta:g}"
                + f": {_observed_and_expected(study, i, j)}" * slopes
                for i, kernel in enumerate(study["kernel"])
                for j, beta in enumerate(study["beta"])
            ]
        return cls(
            separation_distance=np.broadcast_to(
                study["separation_distance"], values.shape
            ),
            values=values,
            labels=labels,
            quantity=quantity,
            legend_title=title,
            state_unit=state_unit,
        ).plot(ax, line_kw=line_kw, lost_kw=lost_kw)

    @classmethod
    def from_kernels(
        cls,
        kernels: Any,
        betas: Any,
        X: Any,
        separations: Any,
        *,
        dimension: int | None = None,
        confidence: float = 0.95,
        **display_kw: Any,
    ) -> ConditioningDisplay:
        """Make a study of conditioning and plot it.

        Parameters
        ----------
        kernels, betas, X, separations : array-like
            As for :func:`sklearn_koopman.diagnostics.conditioning_study`.
        dimension : int, default=None
            Dimension of the manifold; None to estimate it.
        confidence : float, default=0.95
            That of the interval of the slopes.
        **display_kw : dict
            What :meth:`from_study` takes.

        Returns
        -------
        display : ConditioningDisplay
            The display.
        """
        from sklearn_koopman.diagnostics import conditioning_study

        study = conditioning_study(
            kernels, betas, X, separations, dimension=dimension, confidence=confidence
        )
        return cls.from_study(study, **display_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        line_kw: Mapping[str, Any] | None = None,
        lost_kw: Mapping[str, Any] | None = None,
    ) -> ConditioningDisplay:
        """Draw the curves.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, lost_kw : dict, default=None
            Keyword arguments for the curves, and for the line of no digits.

        Returns
        -------
        display : ConditioningDisplay
            The display itself.
        """
        check_choice(self.quantity, "quantity", CONDITIONS)
        ax = axes_for(ax)
        self.lines_ = []
        for q, values, label in zip(
            self.separation_distance, self.values, self.labels, strict=True
        ):
            _, color, marker = next_style(ax, [ALL_LOST])
            order = np.argsort(q, kind="stable")
            order = order[drawable(q, values)[order]]
            style = {"color": color, "marker": marker, "markersize": 5}
            style |= {"linewidth": 1.2, "label": label}
            self.lines_ += ax.loglog(
                q[order], values[order], **line_style(style, line_kw)
            )
        self.lost_ = None
        limit = 1 / np.finfo(np.float64).eps
        if self.quantity == "condition_number" and np.max(self.values) > limit / 1e3:
            drawn = [line for line in ax.lines if line.get_label() == ALL_LOST]
            style = {"color": "0.3", "linestyle": ":", "linewidth": 1}
            style = line_style(style | {"label": ALL_LOST}, lost_kw)
            self.lost_ = drawn[0] if drawn else ax.axhline(limit, **style)
        ax.set(
            xlabel=with_unit("separation distance", self.state_unit),
            ylabel=CONDITIONS[self.quantity],
        )
        finish_curves(ax, self.legend_title)
        self.ax_ = ax
        self.figure_ = ax.figure
        return self


def _observed_and_expected(study: Mapping[str, Any], i: int, j: int) -> str:
    """Write the slope of a condition number beside the one to be expected."""
    slope = slope_text(study["slope"][i][j], study["slope_interval"][i][j])
    expected = study["expected_slope"][i]
    if np.isnan(expected):
        return slope
    if np.isinf(expected):
        return f"{slope} (expected: any power)"
    return f"{slope} (expected {expected:.3g})".replace("-", "\N{MINUS SIGN}")
