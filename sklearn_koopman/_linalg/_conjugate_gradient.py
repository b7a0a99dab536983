"""Conjugate gradients for symmetric positive definite systems, and preconditioners.

Systems are given by their product with several columns at once, restricted to the
orthogonal complement of a few columns P where there are any: that is how a polynomial
tail is solved for together with the kernel part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman.kernels import RadialKernel

Product = Callable[[Array], Array]

# Entries of the small matrices that are factored at once.
BATCH = 2**21
# Part of a vector that rounding leaves where the whole lies along given directions.
ROUNDING = 1e-14


@dataclass(frozen=True)
class Converged:
    """What conjugate gradients have reached."""

    x: Array
    n_iter: int
    residual: float  # the largest relative one, of the system itself


def conjugate_gradients(
    product: Product,
    b: Array,
    precondition: Product,
    P: Array,
    tol: float,
    max_iter: int,
) -> Converged:
    """Solve A x = b in the complement of P, to a relative residual in every column.

    The residual that is carried along drifts from that of the system: it is computed
    anew when it is small enough, and the iteration started again where it is not.
    """

    def project(v: Array) -> Array:
        return complement(P, v)

    # In units of the largest values: the squares of others may not fit in a double.
    unit = np.abs(b).max(axis=0, initial=0.0)
    unit[unit == 0] = 1.0
    b = beyond_rounding(b / unit, P)
    size = np.linalg.norm(b, axis=0)
    x = np.zeros_like(b)
    residual, best = b, np.full(b.shape[1], np.inf)
    n_iter = 0
    while True:
        error = np.linalg.norm(residual, axis=0)
        # Columns that a restart improved by less than half are as good as they get.
        open_ = np.flatnonzero((error > tol * size) & (error < best / 2))
        best = error
        if not len(open_) or n_iter >= max_iter:
            reached = np.divide(error, size, out=np.zeros_like(error), where=size > 0)
            return Converged(x * unit, n_iter, float(reached.max(initial=0.0)))
        step, taken = _descend(
            lambda v: project(product(v)),
            residual[:, open_],
            lambda v: project(precondition(project(v))),
            tol * size[open_],
            max_iter - n_iter,
        )
        n_iter += taken
        moved = x.copy()
        moved[:, open_] += step
        left = b - project(product(moved))
        # On a matrix that rounding makes indefinite, more steps make it worse.
        better = np.linalg.norm(left, axis=0) < error
        x = np.where(better, moved, x)
        residual = np.where(better, left, residual)


def complement(P: Array, v: Array) -> Array:
    """Return v less its part along the orthonormal columns of P.

    Twice: what rounding leaves the first time may be all of a small remainder.
    """
    if P.shape[1]:
        v = v - P @ (P.T @ v)
        v = v - P @ (P.T @ v)
    return v


def beyond_rounding(v: Array, P: Array) -> Array:
    """Return the same, with zero for columns of which only rounding is left."""
    left = complement(P, v)
    size, whole = (np.abs(x).max(axis=0, initial=0.0) for x in (left, v))
    return np.where(size > ROUNDING * whole, left, 0.0)


def _descend(
    product: Product, b: Array, precondition: Product, target: Array, max_iter: int
) -> tuple[Array, int]:
    """Run conjugate gradients from zero until each column has met its target."""
    x = np.zeros_like(b)
    columns = np.arange(b.shape[1])
    r = b.copy()
    z = precondition(r)
    p = z.copy()
    rz = np.einsum("ij,ij->j", r, z)
    for n_iter in range(1, max_iter + 1):
        q = product(p)
        curvature = np.einsum("ij,ij->j", p, q)
        # Rounding ends the descent where the system has nothing more to tell.
        sound = (curvature > 0) & (rz > 0) & np.isfinite(curvature)
        step = np.divide(rz, curvature, out=np.zeros_like(rz), where=sound)
        x[:, columns] += step * p
        r -= step * q
        going = sound & (np.linalg.norm(r, axis=0) > target[columns])
        if not going.any():
            return x, n_iter
        if not going.all():
            columns, r, p, rz = columns[going], r[:, going], p[:, going], rz[going]
        z = precondition(r)
        before, rz = rz, np.einsum("ij,ij->j", r, z)
        p = z + rz / before * p
    return x, max_iter


def neighbor_preconditioner(
    kernel: object, points: Array, diagonal: Array, n_neighbors: int
) -> csr_array:
    """Return a sparse W with W^T W approximating the inverse of the Gram matrix.

    In an order from coarse to fine every centre is conditioned on its nearest
    predecessors (Vecchia 1988). With the matrix of these centres K_i, row i of W is
    K_i^-1 e_i, divided by the root of its last entry: of all matrices with these
    entries, W makes the Kullback-Leibler divergence of the two Gaussian distributions
    the smallest (Schaefer, Katzfuss and Owhadi 2021). For kernels of finite
    smoothness, centres farther away tell next to nothing.
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
    size = max(BATCH // (k + 1) ** 2, 1)
    for start in range(k, n, size):
        own = np.arange(start, min(start + size, n))
        members = np.column_stack([neighbors[own - k], own])
        rows.append(np.repeat(own, k + 1))
        columns.append(members.ravel())
        values.append(_conditional(kernel, x[members], d[members]).ravel())
    indices = (np.concatenate(rows), order[np.concatenate(columns)])
    return csr_array((np.concatenate(values), indices), shape=(n, n))


def _conditional(kernel: object, x: Array, diagonal: Array) -> Array:
    """Return rows of the inverse Cholesky factor, for stacks of few centres each."""
    n, size, n_features = x.shape
    if isinstance(kernel, RadialKernel):
        x = x / kernel.beta
        difference = x[:, :, np.newaxis] - x[:, np.newaxis]
        r = np.sqrt(np.einsum("nijk,nijk->nij", difference, difference))
        K = kernel.profile(r, n_features)
    else:
        K = np.stack([kernel(own) for own in x])  # type: ignore[operator]
    entries = np.arange(size)
    K[:, entries, entries] = diagonal
    unit = np.zeros((n, size, 1))
    unit[:, -1] = 1.0
    row = np.zeros((n, size))
    todo = np.arange(n)
    # A preconditioner may differ a little from the matrix: better that than none for
    # centres that rounding does not tell apart.
    for jitter in (0.0, 1e-12, 1e-8, 1e-4):
        K[todo[:, np.newaxis], entries, entries] += jitter * diagonal[todo]
        try:
            found = np.linalg.solve(K[todo], unit[todo])[:, :, 0]
        except np.linalg.LinAlgError:
            continue
        variance = 1 / np.where(found[:, -1] > 0, found[:, -1], np.nan)
        good = np.isfinite(found).all(axis=1) & (variance > 1e-14 * diagonal[todo, -1])
        row[todo[good]] = found[good] * np.sqrt(variance[good])[:, np.newaxis]
        todo = todo[~good]
        if not len(todo):
            return row
    row[todo, -1] = 1 / np.sqrt(diagonal[todo, -1])
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


def low_rank_inverse(F: Array, shift: float) -> Product:
    """Return v -> (F F^T + shift I)^-1 v."""
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
