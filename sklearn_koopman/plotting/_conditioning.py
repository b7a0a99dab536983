"""Display of studies of conditioning: what more, or closer, centres cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Self

import numpy as np

from .._utils._typing import Array
from .._utils._validation import check_choice
from ..diagnostics import conditioning_study
from ._display import CurveDisplay, Keywords, merge_style, slope_text, with_unit
from ._inputs import check_study, kernel_name

QUANTITIES = ("condition_number", "smallest_eigenvalue")
ALL_LOST = "all 16 digits lost"


@dataclass(kw_only=True, eq=False, repr=False)
class ConditioningDisplay(CurveDisplay):  # numpydoc ignore=PR02
    """Condition of Gram matrices against the separation distance of their centres.

    The Gram matrix holds the kernel of all pairs of centres. The separation distance
    is half the smallest distance of two centres.

    Create a display by :meth:`from_study` or :meth:`from_kernels`. All parameters are
    stored as attributes.

    Parameters
    ----------
    separation_distance : ndarray of shape (n_curves, n_points)
        The separation distances, in the unit of the states.
    values : ndarray of shape (n_curves, n_points)
        Condition numbers or smallest eigenvalues. Values that are not finite, or not
        positive, are not drawn.
    labels : sequence of str
        The names of the curves in the legend.
    quantity : {"condition_number", "smallest_eigenvalue"}, default="condition_number"
        Which of the two `values` are.
    legend_title : str, default=None
        What all curves have in common.
    state_unit : str, default=None
        Unit for the label of the axis.

    Attributes
    ----------
    lines_ : list of matplotlib Line2D
        The curves.
    lost_ : matplotlib Line2D or None
        The condition number at which double precision leaves no digit. It is drawn if
        a condition number comes within a factor of 1000 of it.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

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

    separation_distance: Array
    values: Array
    labels: Sequence[str]
    quantity: str = "condition_number"
    legend_title: str | None = None
    state_unit: str | None = None

    @classmethod
    def from_study(
        cls,
        study: Mapping[str, Any],
        *,
        quantity: str | None = None,
        state_unit: str | None = None,
        ax: Any = None,
        **artist_kw: Any,
    ) -> Self:
        """Plot a study of conditioning or of crowding.

        Parameters
        ----------
        study : :class:`~sklearn.utils.Bunch`
            The result of :func:`sklearn_koopman.diagnostics.conditioning_study` or
            :func:`sklearn_koopman.diagnostics.crowding_study`.
        quantity : {"condition_number", "smallest_eigenvalue"}, default=None
            What to show. None for the condition number, and for the smallest eigenvalue
            of a study of crowding.
        state_unit : str, default=None
            Unit for the label of the axis.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `line_kw` and `lost_kw` of :meth:`plot`.

        Returns
        -------
        display : ConditioningDisplay
            The display.

        Raises
        ------
        ValueError
            If `study` is neither, or there is no such `quantity`.
        """
        name = "conditioning_study or crowding_study"
        check_study(study, name, "smallest_eigenvalue")
        crowding = "gap" in study
        quantity = QUANTITIES[crowding] if quantity is None else quantity
        check_choice(quantity, "quantity", QUANTITIES)
        values = np.asarray(study[quantity])
        values = values.reshape(-1, values.shape[-1])
        q = np.broadcast_to(study["separation_distance"], values.shape)
        title: str | None = None
        if crowding:
            title = kernel_name(study["kernel"])
            chosen = zip(study["n_centers"], study["fill_distance"], strict=True)
            labels = [f"M = {n}, fill distance {h:.2g}" for n, h in chosen]
        else:
            curves = product(map(kernel_name, study["kernel"]), study["beta"])
            labels = [f"{kernel}, β = {beta:g}" for kernel, beta in curves]
            if quantity == "condition_number":
                title = f"slope ± {study.get('confidence', 0.95):.0%} interval"
                cells = zip(labels, np.ndindex(*study["slope"].shape), strict=True)
                labels = [f"{label}: {_slopes(study, *ij)}" for label, ij in cells]
        return cls(
            separation_distance=q,
            values=values,
            labels=labels,
            quantity=quantity,
            legend_title=title,
            state_unit=state_unit,
        ).plot(ax, **artist_kw)

    @classmethod
    def from_kernels(
        cls,
        kernels: Any,
        betas: Any,
        X: Any,
        separations: Any,
        *,
        dimension: float | None = None,
        confidence: float = 0.95,
        **display_kw: Any,
    ) -> Self:
        """Make a study of conditioning and plot it.

        Parameters
        ----------
        kernels, betas, X, separations : array-like
            As for :func:`sklearn_koopman.diagnostics.conditioning_study`.
        dimension : float, default=None
            Dimension of the manifold; None to estimate it.
        confidence : float, default=0.95
            The level of the confidence intervals of the slopes.
        **display_kw : dict
            Further parameters of :meth:`from_study`.

        Returns
        -------
        display : ConditioningDisplay
            The display.

        Raises
        ------
        ValueError
            As :func:`sklearn_koopman.diagnostics.conditioning_study`.
        """
        study = conditioning_study(
            kernels, betas, X, separations, dimension=dimension, confidence=confidence
        )
        return cls.from_study(study, **display_kw)

    def plot(
        self, ax: Any = None, *, line_kw: Keywords = None, lost_kw: Keywords = None
    ) -> Self:
        """Draw the curves.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        line_kw, lost_kw : dict, default=None
            Keyword arguments for the curves, and for the line where no digit is left.

        Returns
        -------
        display : ConditioningDisplay
            The display itself.
        """
        check_choice(self.quantity, "quantity", QUANTITIES)
        ax = self._set_axes(ax)
        curves = zip(self.separation_distance, self.values, self.labels, strict=True)
        self.lines_ = [
            self._draw_curve(q, y, self._next_style(label, line_kw, [ALL_LOST]))
            for q, y, label in curves
        ]
        self.lost_ = None
        limit = 1 / np.finfo(np.float64).eps
        if self.quantity == "condition_number" and np.max(self.values) > limit / 1e3:
            drawn = [line for line in ax.lines if line.get_label() == ALL_LOST]
            style = {"color": "0.3", "linestyle": ":", "linewidth": 1}
            style = merge_style({**style, "label": ALL_LOST}, lost_kw)
            self.lost_ = drawn[0] if drawn else ax.axhline(limit, **style)
        xlabel = with_unit("separation distance", self.state_unit)
        self._finish(self.legend_title, xlabel, self.quantity.replace("_", " "))
        return self


def _slopes(study: Mapping[str, Any], i: int, j: int) -> str:
    """Write the slope of a condition number beside the expected one."""
    slope, interval = study["slope"][i][j], study["slope_interval"][i][j]
    return slope_text(slope, interval, "expected", study["expected_slope"][i])
