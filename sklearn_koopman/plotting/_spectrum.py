"""Display of the spectrum of an operator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.utils.validation import check_is_fitted

from .._utils._pipeline import unwrap
from .._utils._typing import Array, Complex
from .._utils._validation import check_flag
from ._display import Display, Keywords, merge_style

# All smaller residuals have the same colour.
MIN_RESIDUAL = 1e-6


@dataclass(kw_only=True, eq=False, repr=False)
class SpectrumDisplay(Display):  # numpydoc ignore=PR02
    """Eigenvalues of a Koopman operator, and how far to trust them.

    The colour is the residual: how far each eigenpair is from one of the true operator.
    Where eigenvalues overlap, the most trustworthy one is on top.

    Create a display by :meth:`from_estimator`. All parameters are stored as attributes.

    Parameters
    ----------
    eigenvalues : ndarray of shape (n_modes,), complex
        The eigenvalues.
    residuals : ndarray of shape (n_modes,)
        Their residuals. A residual of zero has the colour of the smallest positive
        one; infinity and NaN have the colour of the largest one.

    Attributes
    ----------
    scatter_ : matplotlib PathCollection
        The eigenvalues, from the least to the most trustworthy: in falling order of
        ``residuals / abs(eigenvalues)``.
    circle_ : matplotlib Line2D
        The unit circle, on which motion neither grows nor decays.
    colorbar_ : matplotlib Colorbar or None
        The scale of residuals.
    ax_ : matplotlib Axes
        The axes.
    figure_ : matplotlib Figure
        The figure of the axes.

    See Also
    --------
    ForecastDisplay : What the operator predicts.
    sklearn_koopman.KernelEDMD : Estimates the operator.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_koopman import KernelEDMD, SeparatedCenterSelector
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.plotting import SpectrumDisplay
    >>> pendulum = make_pendulum(256)
    >>> model = KernelEDMD(
    ...     "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.23)
    ... ).fit(pendulum.X, X_next=pendulum.X_next)
    >>> display = SpectrumDisplay.from_estimator(model)
    >>> display.ax_.get_title()
    '37 eigenvalues'
    >>> plt.close(display.figure_)
    """

    eigenvalues: Complex
    residuals: Array

    @classmethod
    def from_estimator(
        cls, estimator: Any, *, ax: Any = None, **artist_kw: Any
    ) -> Self:
        """Plot the spectrum of a fitted operator.

        Parameters
        ----------
        estimator : KernelEDMD
            The fitted operator, or a pipeline or a search of one.
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        **artist_kw : dict
            The parameters `colorbar`, `scatter_kw` and `circle_kw` of :meth:`plot`.

        Returns
        -------
        display : SpectrumDisplay
            The display.

        Raises
        ------
        ValueError
            If the estimator is not fitted, or has no spectrum.
        """
        check_is_fitted(estimator)
        final, _ = unwrap(estimator)
        eigenvalues: Any = getattr(final, "eigenvalues_", ())
        if not hasattr(final, "residuals_") or len(eigenvalues) == 0:
            raise ValueError(
                f"estimator={final!r} has no spectrum; pass a KernelEDMD fitted with "
                "n_modes=None, or with as many modes as you need."
            )
        display = cls(eigenvalues=eigenvalues, residuals=final.residuals_)
        return display.plot(ax, **artist_kw)

    def plot(
        self,
        ax: Any = None,
        *,
        colorbar: bool = True,
        scatter_kw: Keywords = None,
        circle_kw: Keywords = None,
    ) -> Self:
        """Draw the eigenvalues and the unit circle.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            The axes to draw on. None for those of a new figure.
        colorbar : bool, default=True
            Whether to draw the scale of residuals.
        scatter_kw, circle_kw : dict, default=None
            Keyword arguments for ``scatter``, such as a `norm` that several displays
            share, and for the line of the unit circle.

        Returns
        -------
        display : SpectrumDisplay
            The display itself.

        Raises
        ------
        ValueError
            If `colorbar` is not True or False.
        """
        check_flag(colorbar, "colorbar")
        ax = self._set_axes(ax)
        from matplotlib.colors import LogNorm

        residuals = np.asarray(self.residuals, dtype=np.float64)
        ordinary = residuals[np.isfinite(residuals) & (residuals > 0)]
        # An eigenpair whose residual is 1 is worth nothing. The eigenvalue of a trend,
        # which is exact up to rounding, must not make all others look alike.
        low = float(np.clip(ordinary.min(initial=0.1), MIN_RESIDUAL, 0.1))
        largest = ordinary.max(initial=1.0)
        shown = np.where(residuals > 0, np.minimum(residuals, largest), low)
        shown[np.isnan(residuals)] = largest
        with np.errstate(divide="ignore", invalid="ignore"):
            doubt = residuals / np.abs(self.eigenvalues)
        order = np.argsort(np.nan_to_num(doubt, nan=np.inf), kind="stable")[::-1]
        angle = np.linspace(0, 2 * np.pi, 400)
        style = merge_style({"color": "0.8", "linewidth": 1, "zorder": 0}, circle_kw)
        (self.circle_,) = ax.plot(np.cos(angle), np.sin(angle), **style)
        style = {"cmap": "viridis_r", "norm": LogNorm(low, 1.0), "s": 30}
        style |= {"edgecolor": "0.3", "linewidth": 0.4, "c": shown[order]}
        style = merge_style(style, scatter_kw, collection=True)
        values = self.eigenvalues[order]
        self.scatter_ = ax.scatter(values.real, values.imag, **style)
        self.colorbar_ = None
        if colorbar:
            norm = self.scatter_.norm
            ends = 2 * (shown < norm.vmin).any() + (shown > norm.vmax).any()
            extend = ("neither", "max", "min", "both")[ends]
            self.colorbar_ = ax.figure.colorbar(
                self.scatter_, ax=ax, label="residual", extend=extend
            )
        ax.locator_params(nbins=6)
        ax.set(title=f"{len(residuals)} eigenvalues", aspect="equal")
        ax.set_xlabel("real part of the eigenvalue")
        ax.set_ylabel("imaginary part of the eigenvalue")
        return self
