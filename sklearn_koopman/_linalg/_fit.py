"""What a system returns, and what it says where there is no estimate."""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgWarning
from sklearn.utils import gen_batches

from .._matrices._polynomial import is_undetermined
from .._matrices._sections import KernelExpansion
from .._utils._rows import total_weight
from .._utils._typing import Array
from .._utils._warnings import warn

REMEDY = (
    "Choose centres with a larger separation, lower beta, raise alpha, or take a less "
    "smooth kernel."
)
# Outputs whose nugget is this many times larger than the kernel have no say. A still
# larger one would only hide how well conditioned the rest of the matrix is.
MAX_NUGGET = 1e10
# Least squares needs this part of the rows beyond the number of its parameters for an
# estimate of the noise.
MIN_SPARE_PART = 1e-6
# Weights of least squares that differ by a larger factor leave few digits of the rest.
MAX_WEIGHT_RATIO = 1e8


class Fit(NamedTuple):
    """An estimate, and how it was found."""

    expansion: KernelExpansion
    seminorm: Array  # (n_outputs,): native norm of the estimate without its trend
    effective_dof: float  # trace of the matrix from outputs to fitted values
    noise_std: Array | None = None  # (n_outputs,): if it follows from residuals
    n_iter: int | None = None  # of an iterative system
    residual: float | None = None  # likewise: the largest one, relative


def make_nugget(alpha: float, weights: Array, diagonal: Array) -> Array:
    """Return what outputs with these weights add to the diagonal of a Gram matrix."""
    with np.errstate(over="ignore"):  # capped below
        nugget = alpha / weights
    return np.minimum(nugget, MAX_NUGGET * max(float(diagonal.max()), alpha))


def estimate_noise(
    expansion: KernelExpansion,
    X: Array,
    y: Array,
    dof: float,
    n_jobs: int | None,
    weights: Array | None = None,
) -> Array | None:
    """Return the standard deviation of every output about a fit of all rows."""
    squares = np.zeros(y.shape[1])
    for rows in gen_batches(len(X), 2**13):
        own = np.square(y[rows] - expansion(X[rows], n_jobs))
        squares += own.sum(axis=0) if weights is None else weights[rows] @ own
    return scale_residuals(np.sqrt(squares), total_weight(X, weights), dof)


def scale_residuals(norms: Array, n_rows: float, dof: float) -> Array | None:
    """Turn norms of residuals into standard deviations, if there are rows to spare.

    Weights count as numbers of rows.
    """
    spare = n_rows - dof
    return norms / np.sqrt(spare) if spare > MIN_SPARE_PART * n_rows else None


def warn_of_weights(weights: Array | None, dof: float) -> None:
    """Warn of weights that leave least squares no measure of noise, or few digits."""
    if weights is None:
        return
    total = weights.sum()
    if total <= dof < len(weights):
        warn(
            f"sample_weight sums to {total:.3g}, no more than the {dof:.3g} effective "
            "parameters, so that noise_std_ is not known; divide the weights by their "
            "mean."
        )
    smallest, largest = weights.min(), weights.max()
    if largest > MAX_WEIGHT_RATIO * smallest:
        warn(
            f"sample_weight goes from {smallest:.3g} to {largest:.3g}, so that least "
            f"squares loses {np.log10(largest) - np.log10(smallest):.0f} digits; set "
            "the smallest weights to 0, or bring them closer together."
        )


def relative_error(reached: Array, wanted: Array) -> float:
    """Return the largest error over the largest value."""
    return float(np.abs(reached - wanted).max() / (np.abs(wanted).max() or 1.0))


def negligible_tolerance(n_rows: float, alpha: float) -> float:
    """Return the tolerance up to which dropping centres does not matter to a fit.

    By |<r, e>| <= sqrt(n) |r| sup|e|, a section that the others reproduce to
    sqrt(tolerance) moves a regularised fit by about n tolerance / alpha of its
    residuals at the most.
    """
    return 1e-5 * alpha / n_rows


def no_estimate(kernel: Any, n_centers: int, reason: str) -> ValueError:
    """Return the error of a Gram matrix that no solution was found with."""
    return ValueError(
        f"No estimate for kernel={kernel!r} on {n_centers} centres: {reason}. {REMEDY}"
    )


def check_rows_suffice(n_rows: int, n_centers: int, alpha: float) -> None:
    """Refuse least squares without a penalty on fewer rows than centres."""
    if alpha == 0 and n_rows < n_centers:
        raise ValueError(
            f"method='least_squares' with alpha=0 needs at least as many rows as "
            f"centres, got {n_rows} rows and {n_centers} centres; set alpha > 0 or "
            "choose fewer centres."
        )


def check_trend_determined(degree: int | None, X: Array, centers: Array) -> None:
    """Refuse least squares with a linear trend that rows determine, but centres do not.

    It would have to vanish there.
    """
    if degree == 1 and any(
        is_undetermined(X[rows], centers).any() for rows in gen_batches(len(X), 2**13)
    ):
        raise ValueError(
            f"trend='linear' with method='least_squares': the {len(centers)} "
            "independent centres do not determine a linear function of the features of "
            "X. Choose more centres than features, not all in one plane, or take "
            "trend='constant'."
        )


def warn_dropped(kernel: Any, n_centers: int, n_kept: int) -> None:
    """Warn that dependent centres were dropped."""
    warn(
        f"The Gram matrix of kernel={kernel!r} on {n_centers} centres is numerically "
        f"singular; {n_centers - n_kept} centres that depend on the others were left "
        f"out. {REMEDY}",
        LinAlgWarning,
    )
