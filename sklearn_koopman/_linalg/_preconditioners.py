"""Preconditioners of Gram matrices: banded, by neighbours, and of low rank."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import (
    cho_solve_banded,
    cholesky,
    cholesky_banded,
    qr,
    solve_triangular,
)
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import KDTree
from sklearn.gaussian_process.kernels import Kernel

from .._utils._typing import Array, Indices
from ..kernels import RadialKernel
from ._conjugate_gradient import Product

# Entries of the small matrices that are factored at once.
ENTRIES_PER_BATCH = 2**21


def bandwidth(K: csr_array) -> tuple[Indices, int]:
    """Return an order of the rows that gathers K about its diagonal, and the width."""
    order = reverse_cuthill_mckee(K, symmetric_mode=True)
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order))
    rows = np.repeat(place, np.diff(K.indptr))
    return order.astype(np.intp), int(np.abs(rows - place[K.indices]).max(initial=0))


def banded_solver(K: csr_array, order: Indices, width: int) -> Callable[[Array], Array]:
    """Factor K in this order and return the solution of systems with it.

    Raises
    ------
    LinAlgError
        If K is not positive definite.
    """
    n = len(order)
    place = np.empty(n, dtype=np.intp)
    place[order] = np.arange(n)
    rows, columns = np.repeat(place, np.diff(K.indptr)), place[K.indices]
    lower = rows >= columns
    band = np.zeros((width + 1, n), order="F")
    band[rows[lower] - columns[lower], columns[lower]] = K.data[lower]
    factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)

    def solve(b: Array) -> Array:
        x = np.empty_like(b)
        x[order] = cho_solve_banded((factor, True), b[order], check_finite=False)
        return x

    return solve


def neighbor_preconditioner(
    kernel: Kernel,
    points: Array,
    diagonal: Array,
    n_neighbors: int,
    entries_per_batch: int = ENTRIES_PER_BATCH,
) -> csr_array:
    """Return a sparse W with W^T W approximating the inverse of the Gram matrix.

    In an order from coarse to fine every centre is conditioned on its nearest
    predecessors (Vecchia 1988). With the matrix of these centres K_i, row i of W is
    K_i^-1 e_i, divided by the root of its last entry: of all matrices with these
    entries, W makes the Kullback-Leibler divergence of the two Gaussian distributions
    the smallest (Schaefer, Katzfuss and Owhadi 2021). For kernels of finite
    smoothness, centres farther away contribute almost nothing.
    """
    n = len(points)
    # In units of the largest value: a kd-tree finds no neighbour at a distance whose
    # square overflows, and ties where it underflows.
    scaled = points / (np.abs(points).max() or 1.0)
    order = _coarse_to_fine(scaled)
    x, d = points[order], diagonal[order]
    k = min(n_neighbors, n - 1)
    neighbors = _nearest_predecessors(scaled[order], k)
    rows, columns, values = [], [], []
    # The first ones have fewer predecessors.
    for i in range(k):
        members = np.arange(i + 1)
        rows.append(np.full(i + 1, i))
        columns.append(members)
        values.append(_conditional(kernel, x[members][None], d[members][None])[0])
    size = max(entries_per_batch // (k + 1) ** 2, 1)
    for start in range(k, n, size):
        own = np.arange(start, min(start + size, n))
        members = np.column_stack([neighbors[own - k], own])
        rows.append(np.repeat(own, k + 1))
        columns.append(members.ravel())
        values.append(_conditional(kernel, x[members], d[members]).ravel())
    indices = (np.concatenate(rows), order[np.concatenate(columns)])
    return csr_array((np.concatenate(values), indices), shape=(n, n))


def _conditional(kernel: Kernel, x: Array, diagonal: Array) -> Array:
    """Return rows of the inverse Cholesky factor, for stacks of few centres each."""
    n, size, n_features = x.shape
    if isinstance(kernel, RadialKernel):
        x = x / kernel.beta
        difference = x[:, :, np.newaxis] - x[:, np.newaxis]
        r = np.sqrt(np.einsum("nijk,nijk->nij", difference, difference))
        K = kernel.profile(r, n_features)
    else:
        K = np.stack([kernel(own) for own in x])
    entries = np.arange(size)
    K[:, entries, entries] = diagonal
    unit = np.zeros((n, size, 1))
    unit[:, -1] = 1.0
    row = np.zeros((n, size))
    unsolved = np.arange(n)
    # A preconditioner may differ a little from the matrix: better that than none for
    # centres that rounding does not distinguish.
    for jitter in (0.0, 1e-12, 1e-8, 1e-4):
        K[unsolved[:, np.newaxis], entries, entries] += jitter * diagonal[unsolved]
        try:
            found = np.linalg.solve(K[unsolved], unit[unsolved])[:, :, 0]
        except np.linalg.LinAlgError:
            continue
        variance = 1 / np.where(found[:, -1] > 0, found[:, -1], np.nan)
        good = np.isfinite(found).all(axis=1) & (
            variance > 1e-14 * diagonal[unsolved, -1]
        )
        row[unsolved[good]] = found[good] * np.sqrt(variance[good])[:, np.newaxis]
        unsolved = unsolved[~good]
        if not len(unsolved):
            return row
    row[unsolved, -1] = 1 / np.sqrt(diagonal[unsolved, -1])
    return row


def _coarse_to_fine(points: Array) -> Indices:
    """Order points so that the first ones of any number cover all of them.

    The leaves of a kd-tree, one next to the other, in the order of the reversed bits
    of their numbers: as good here as always taking the farthest point, at no cost.
    """
    n = len(points)
    numbers = np.arange(1 << max(n - 1, 1).bit_length())
    backwards = np.zeros_like(numbers)
    for _ in range(max(n - 1, 1).bit_length()):
        backwards = (backwards << 1) | (numbers & 1)
        numbers >>= 1
    backwards = backwards[backwards < n]
    return np.asarray(KDTree(points).indices)[backwards]


def _nearest_predecessors(x: Array, k: int) -> Indices:
    """Return the k nearest of the points before each one, from the k-th on."""
    n = len(x)
    found = np.empty((n - k, k), dtype=np.intp)
    start = k
    while start < n:
        # Of twice as many points, about half of the neighbours are predecessors.
        stop = min(2 * start + 64, n)
        tree = KDTree(x[:stop])
        rows, number = np.arange(start, stop), 2 * k + 2
        while len(rows):
            number = min(number, stop)
            _, near = tree.query(x[rows], k=number)
            near = np.asarray(near).reshape(len(rows), number)
            before = near < rows[:, np.newaxis]
            enough = before.sum(axis=1) >= k
            # The first k predecessors, in the order of their distances.
            position = np.where(before[enough], np.arange(number), number)
            first = np.sort(position, axis=1)[:, :k]
            found[rows[enough] - k] = np.take_along_axis(near[enough], first, axis=1)
            rows, number = rows[~enough], 2 * number
        start = stop
    return found


def pivoted_factor(
    kernel_columns: Callable[[Indices], Array],
    diagonal: Array,
    rank: int,
    random_state: np.random.RandomState,
) -> tuple[Array, float]:
    """Return F with K close to F F^T, and the mean of what its diagonal leaves.

    Randomly pivoted Cholesky factorisation (Chen, Epperly, Tropp and Webber 2023), in
    blocks: pivots are drawn in proportion to what is left of the diagonal.
    """
    n = len(diagonal)
    left = diagonal.copy()
    blocks: list[Array] = []
    found = 0
    while found < min(rank, n) and left.sum() > 1e-14 * diagonal.sum():
        count = min(max(rank // 10, 1), rank - found)
        drawn = random_state.choice(n, size=count, p=left / left.sum())
        pivots = np.unique(drawn)
        columns = kernel_columns(pivots)
        for block in blocks:
            columns -= block @ block[pivots].T
        corner = columns[pivots]
        corner[np.diag_indices_from(corner)] += 1e-14 * diagonal[pivots]
        try:
            factor = cholesky(corner, lower=True, overwrite_a=True)
        except np.linalg.LinAlgError:  # nothing but rounding is left
            break
        block = solve_triangular(factor, columns.T, lower=True, overwrite_b=True).T
        left = np.maximum(left - np.einsum("ij,ij->i", block, block), 0.0)
        left[pivots] = 0.0
        blocks.append(block)
        found += len(pivots)
    F = np.hstack(blocks) if blocks else np.zeros((n, 0))
    return F, float(left.mean())


def low_rank_inverse(F: Array, shift: Array | float) -> Product:
    """Return v -> (F F^T + D)^-1 v for a diagonal D, given by one or all entries."""
    if np.ndim(shift) and np.ptp(shift) > 0:
        root = np.sqrt(shift)[:, np.newaxis]
        inverse = low_rank_inverse(F / root, 1.0)
        return lambda v: inverse(v / root) / root
    shift = float(np.max(shift))
    if not F.shape[1]:
        return lambda v: v / shift
    Q, R = qr(F, mode="economic")
    U, singular, _ = np.linalg.svd(R)
    U = Q @ U
    # Written so that no difference of large numbers is left where the shift is small.
    scale = 1 / (singular**2 + shift) - 1 / shift

    def apply(v: Array) -> Array:
        return U @ (scale[:, np.newaxis] * (U.T @ v)) + v / shift

    return apply
