"""Matrices of Koopman operators on the span of kernel sections.

Everything is in coordinates of a direct system, whose functions are orthonormal in the
native space of the kernel. There the matrix of the operator is as well conditioned as
the operator itself, while the matrix K^-1 K+ that acts on coefficients of the kernel
sections inherits the condition number of K.
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg.blas import dgemm
from sklearn.utils import gen_batches

from .._linalg._fit import (
    Fit,
    check_rows_suffice,
    check_trend_determined,
    estimate_noise,
    negligible_tolerance,
)
from .._linalg._least_squares import least_squares
from .._linalg._systems import DirectSystem
from .._utils._rows import total_weight
from .._utils._typing import Array, Complex, Indices

# Coordinates beyond this belong to a diverging forecast, and soon overflow.
MAX_COORDINATE = 1e100
# Entries of the arrays that are held at once.
ENTRIES_PER_BLOCK = 2**22


def interpolate_operator(
    system: DirectSystem,
    X_next: Array,
    targets: Array,
    rows: Indices,
    group: Indices,
    weights: Array | None = None,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> tuple[Array, Array]:
    """Interpolate the images of the basis under the operator, and targets, at centres.

    Parameters
    ----------
    system : DirectSystem
        The system of the centres.
    X_next : ndarray of shape (n_pairs, n_features)
        The successors of all rows.
    targets : ndarray of shape (n_pairs, n_targets)
        Functions one step ahead, by their values.
    rows : ndarray of shape (M,)
        The rows that are centres.
    group : ndarray of shape (n_pairs,)
        The number of the group of each row: the images are means over groups.
    weights : ndarray of shape (n_pairs,), default=None
        The weights of the rows in these means.
    block_entries : int
        Entries of the arrays that are held at once.

    Returns
    -------
    matrix : ndarray of shape (M, M)
        The operator.
    coordinates : ndarray of shape (M, n_targets)
        Those of the targets.
    """
    M = len(rows)
    center = np.full(group.max() + 1, -1)
    center[group[rows]] = np.arange(M)
    own_center = center[group[rows]]
    alone = np.bincount(group)[group[rows]].sum() == M
    sources = np.unique(rows) if alone else np.flatnonzero(center[group] >= 0)
    values = np.zeros((M, M + targets.shape[1]))
    for batch in gen_batches(len(sources), max(block_entries // M, M)):
        own = sources[batch]
        images = np.hstack([system.functions(X_next[own]).T, targets[own]])
        if weights is not None and not alone:
            images *= weights[own, np.newaxis]
        np.add.at(values, center[group[own]], images)
    if not alone:
        values /= np.bincount(group, weights)[group[rows]][:, np.newaxis]
    if (own_center != np.arange(M)).any():  # equal centres
        values = values[own_center]
    coordinates = system.coordinates(values)
    return coordinates[:, :M], coordinates[:, M:]


def fit_operator(
    system: DirectSystem,
    X: Array,
    X_next: Array,
    targets: Array,
    alpha: float,
    n_jobs: int | None,
    weights: Array | None = None,
) -> tuple[Array, Array, Fit]:
    """Fit the images of the basis under the operator, and targets, on all rows.

    Returns
    -------
    matrix : ndarray of shape (M, M)
        The operator.
    coordinates : ndarray of shape (M, n_targets)
        Those of the targets.
    fit : Fit
        The fit of the targets.
    """
    check_rows_suffice(len(X), system.offered.size, alpha)

    def attempt() -> tuple[Array, Array, Fit]:
        check_trend_determined(system.degree, X, system.sections.points)
        M = len(system.kept)

        def images(rows: slice) -> Array:
            return np.hstack([system.functions(X_next[rows]).T, targets[rows]])

        n_images = M + targets.shape[1]
        # Not in shares of the rows, whose images would all be held at once.
        z, b, dof = least_squares(system, X, images, n_images, alpha, weights=weights)
        fit = system.fit_at(X, z[:, M:], b[:, M:], dof)
        noise_std = estimate_noise(fit.expansion, X, targets, dof, n_jobs, weights)
        fit = fit._replace(noise_std=noise_std)
        coordinates = z + system.Q @ b
        return coordinates[:, :M], coordinates[:, M:], fit

    negligible = negligible_tolerance(total_weight(X, weights), alpha)
    return system.until_sound(attempt, negligible)


def generate_powers(matrix: Array, v: Array) -> Iterator[Array]:
    """Generate A v, A^2 v, ... until they leave the range of numbers."""
    while True:
        with np.errstate(over="ignore", invalid="ignore"):
            v = dgemm(1.0, matrix, v)
        if not np.abs(v).max(initial=0.0) < MAX_COORDINATE:
            return
        yield v


def block_diagonal(eigenvalues: Complex) -> Array:
    """Return the matrix of the operator on the packed eigenfunctions themselves.

    A real eigenvalue stands on the diagonal. A pair a + ib, a - ib makes the block
    ((a, b), (-b, a)), since phi o f = (a + ib) phi means that Re phi o f = a Re phi -
    b Im phi and Im phi o f = b Re phi + a Im phi.
    """
    matrix = np.diag(eigenvalues.real)
    first = np.flatnonzero(eigenvalues.imag > 0)
    matrix[first, first + 1] = eigenvalues.imag[first]
    matrix[first + 1, first] = -eigenvalues.imag[first]
    return matrix
