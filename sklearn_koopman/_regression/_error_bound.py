"""What bounds the error of an interpolant: pure functions of a native basis."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dtrtri

from sklearn_koopman._linalg._cholesky import NativeBasis
from sklearn_koopman._linalg._direct import interpolation
from sklearn_koopman._matrices._polynomial import PolynomialTrend
from sklearn_koopman._matrices._sections import Sections
from sklearn_koopman._selection import farthest_centers
from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_number

# What rounding leaves undecided of the squared power function, over that of the kernel.
ROUNDING = 1e-13
# Centres of which the others determine less than this part lie apart from them.
APART = 0.1


def variance(
    basis: NativeBasis, X: Array, smooth: Array, n_jobs: int | None = None
) -> Array:
    """Evaluate the squared power function with the smooth diagonal of a kernel."""
    noise = basis.sections.diagonal(X) - smooth
    return np.asarray(np.maximum(basis.power(X, n_jobs) ** 2 - noise, 0.0))


def left_out_precision(basis: NativeBasis) -> Array:
    """Diagonal of the matrix that takes values at the centres to coefficients.

    That is the inverse of K, or of K bordered by the polynomials. The interpolant
    that is made without centre i misses the value there by the i-th coefficient over
    the i-th entry, and the squared power function of the other centres is there one
    over the i-th entry (Rippa 1999). NaN where they determine no interpolant.
    """
    inverse, _ = dtrtri(basis.lower, lower=1)
    for column in range(1, len(inverse)):
        inverse[:column, column] = 0.0  # has no meaning, as in the factor
    diagonal = np.einsum("ij,ij->j", inverse, inverse)
    along = dgemm(1.0, basis.Q, inverse, trans_a=1)
    left = diagonal - np.einsum("ij,ij->j", along, along)
    return np.where(left > 1e-10 * diagonal, left, np.nan)


def reach(basis: NativeBasis, centers: Array) -> float:
    """Return the largest power function at a centre that is left out of the others.

    On the manifold, states are nearer to the centres than these are to each other:
    where the power function is larger, a state is off it. Centres that lie apart from
    all others tell nothing of that; infinite if all of them do.
    """
    squared = 1 / left_out_precision(basis) - basis.excess
    limit = (1 - APART) * basis.sections.smooth_diagonal(centers)
    return (
        float(np.sqrt(max(squared[squared <= limit].max(initial=0.0), 0.0))) or np.inf
    )


def native_norm(
    sections: Sections,
    centers: Array,
    nugget: Array,
    tail: PolynomialTrend | None,
    values: Array,
    seminorm: Array,
) -> Array:
    """Estimate the native norm of functions from that of their interpolants.

    The norm of the interpolant rises to that of the function as centres are added. In
    the order farthest first, the second half of the centres halves the volume between
    them. The part of the squared norm that it adds counts twice here: exact if every
    further halving added half as much, and too little for rougher functions.
    """
    half = farthest_centers(centers, 0.0, -(-len(centers) // 2))
    if tail is not None:
        degree = 0 if len(tail.seen) == 1 else 1
        tail = PolynomialTrend.on(centers[half], degree, centers)
    basis = NativeBasis.of(sections.take(half), centers[half], nugget[half], tail)
    coarse = interpolation(centers, values)(basis, half).seminorm
    part = np.divide(coarse, seminorm, out=np.ones_like(seminorm), where=seminorm > 0)
    return np.asarray(seminorm * np.sqrt(2 - np.minimum(part, 1.0) ** 2))


def given_norms(norm: Any, n_outputs: int) -> Array:
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


def warn_off_manifold(
    basis: NativeBasis, variance: Array, diagonal: Array, reach: float
) -> None:
    """Warn of states at which the power function exceeds the reach of the centres."""
    off = np.sqrt(variance) > reach * (1 + 1e-6)
    off |= np.isinf(variance)
    if basis.tail is None:
        off |= variance > (1 - 1e-6) * diagonal
    if not off.any():
        return
    if np.isfinite(reach):
        limit = f"at most {reach:.2g} at centres left out of the others"
    elif len(basis.lower) == 1:
        limit = "there is one centre only"
    else:
        limit = "no centre tells anything of the others, either: raise beta"
    warnings.warn(
        f"{off.sum()} of {len(off)} states are off the manifold of the centres: the "
        f"power function is up to {np.sqrt(variance.max()):.2g} there ({limit}). "
        "Predictions are extrapolation there; learn from samples that cover such "
        "states, or leave them out.",
        UserWarning,
        stacklevel=3,
    )
