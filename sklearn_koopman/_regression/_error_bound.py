"""Bounds of the error of an interpolant, from its power function and native norm."""

from typing import Any

import numpy as np

from .._linalg._systems import DirectSystem
from .._matrices._polynomial import is_undetermined
from .._selection import farthest_centers
from .._utils._typing import Array
from .._utils._validation import check_number
from .._utils._warnings import warn

# Rounding error of the squared power function, relative to the kernel.
ROUNDING = 1e-13
# A centre is isolated if the other centres reproduce less than this part of its
# section.
ISOLATED = 0.1


def error_bound(
    system: DirectSystem, X: Array, norms: Array, reach: float, n_jobs: int | None
) -> Array:
    """Return power function times native norm; of shape (n_rows, n_outputs).

    Warns
    -----
    UserWarning
        If rows are far from the centres.
    """
    diagonal = system.sections.smooth_diagonal(X)
    noise = system.sections.diagonal(X) - diagonal
    variance = np.maximum(system.power(X, n_jobs) ** 2 - noise, 0.0)
    if system.degree == 1:
        variance[is_undetermined(X, system.sections.points)] = np.inf
    _warn_far_from_centers(system, variance, diagonal, reach)
    P = np.sqrt(variance + ROUNDING * diagonal)
    with np.errstate(invalid="ignore"):
        bound = np.outer(P, norms)
    bound[np.isinf(P)] = np.inf
    return bound


def left_out_reach(system: DirectSystem) -> float:
    """Return the largest power function at a centre that is left out of the others.

    On the manifold, states are nearer to the centres than these are to each other. A
    state with a larger power function is off the manifold. Isolated centres do not
    count; infinite if all are isolated.
    """
    squared = 1 / system.left_out_precision() - system.excess
    limit = (1 - ISOLATED) * system.sections.smooth_diagonal(system.sections.points)
    largest = float(squared[squared <= limit].max(initial=0.0))
    return np.sqrt(largest) if largest > 0 else np.inf


def native_norm(system: DirectSystem, u: Array, seminorm: Array) -> Array:
    """Estimate the native norm of functions from that of their interpolants.

    The norm of the interpolant rises to that of the function as centres are added. In
    the order farthest first, the second half of the centres halves the volume between
    them. The part of the squared norm that it adds counts twice here. That is exact if
    every further halving adds half as much, and too small for rougher functions.
    """
    centers = system.sections.points
    half = farthest_centers(centers, 0.0, -(-len(centers) // 2))
    extent = np.stack([centers.min(axis=0), centers.max(axis=0)])
    sections, nugget = system.sections.take(half), system.nugget[half]
    coarse = DirectSystem(sections, nugget, system.degree, "cholesky", extent)
    found = coarse.interpolate(u[half]).seminorm
    part = np.divide(found, seminorm, out=np.ones_like(seminorm), where=seminorm > 0)
    return np.asarray(seminorm * np.sqrt(2 - np.minimum(part, 1.0) ** 2))


def check_norms(norm: Any, n_outputs: int) -> Array:
    """Return one norm for each output; refuse anything but numbers of 0 or above."""
    norms = np.atleast_1d(np.asarray(norm, dtype=object))
    if norms.ndim > 1 or norms.size not in (1, n_outputs):
        raise ValueError(
            f"norm must be a number, or one for each of {n_outputs} outputs, got an "
            f"array of shape {norms.shape}."
        )
    for value in norms:
        check_number(value, "norm")
    return np.broadcast_to(norms.astype(np.float64), n_outputs)


def _warn_far_from_centers(
    system: DirectSystem, variance: Array, diagonal: Array, reach: float
) -> None:
    far = np.sqrt(variance) > reach * (1 + 1e-6)
    far |= np.isinf(variance)
    if system.trend is None:
        far |= variance > (1 - 1e-6) * diagonal
    if not far.any():
        return
    if np.isfinite(reach):
        limit = f"at most {reach:.2g} at centres left out of the others"
    elif len(system.kept) == 1:
        limit = "there is one centre only"
    else:
        limit = "the centres are isolated from each other: raise beta"
    warn(
        f"{far.sum()} of {len(far)} states are off the manifold of the centres: the "
        f"power function is up to {np.sqrt(variance.max()):.2g} there ({limit}). "
        "Predictions are extrapolation there; learn from samples that cover such "
        "states, or leave them out."
    )
