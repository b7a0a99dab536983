"""Matrices of kernels with compact support, by kd-trees of the centres."""

from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import KDTree

from .._utils._typing import Array, Indices
from ..kernels import RadialKernel

# Rows from which the density of a matrix is estimated.
SAMPLED_ROWS = 256
# Entries that are evaluated at once.
ENTRIES_PER_BLOCK = 2**21


def kd_tree(kernel: RadialKernel, points: Array) -> KDTree:
    """Return a tree of points in units of the scale, quick to build."""
    return KDTree(points / kernel.beta, balanced_tree=False, compact_nodes=False)


def _radius(kernel: RadialKernel) -> float:
    return kernel.support_radius / kernel.beta


def density(kernel: RadialKernel, tree: KDTree, X: Array) -> float:
    """Estimate which part of k(X, Xi) is not zero."""
    rows = X[:: -(-len(X) // SAMPLED_ROWS)] / kernel.beta
    counts = tree.query_ball_point(rows, _radius(kernel), return_length=True)
    return float(np.mean(counts)) / tree.n


def gram(
    kernel: RadialKernel,
    points: Array,
    diagonal: Array,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> csr_array:
    """Return the Gram matrix with this diagonal."""
    n = len(points)
    tree = kd_tree(kernel, points)
    pairs = tree.query_pairs(_radius(kernel), output_type="ndarray")
    values = np.empty(len(pairs))
    for start in range(0, len(pairs), block_entries):
        rows = slice(start, start + block_entries)
        values[rows] = _values(kernel, points, points, *pairs[rows].T)
    index: Any = np.int32 if n < 2**31 else np.int64
    i: Any = pairs[:, 0].astype(index)
    j: Any = pairs[:, 1].astype(index)
    del pairs
    upper = coo_array((values, (i, j)), shape=(n, n)).tocsr()
    del values, i, j
    entries: Any = np.arange(n, dtype=index)
    K = upper + upper.T.tocsr()
    return K + coo_array((diagonal, (entries, entries)), shape=(n, n)).tocsr()


def cross(
    kernel: RadialKernel,
    X: Array,
    centers: Array,
    tree: KDTree,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> csr_array:
    """Return k(X, Xi)."""
    near = kd_tree(kernel, X).sparse_distance_matrix(
        tree, _radius(kernel), output_type="ndarray"
    )
    i, j = near["i"], near["j"]
    values = np.empty(len(near))
    for start in range(0, len(near), block_entries):
        rows = slice(start, start + block_entries)
        values[rows] = _values(kernel, X, centers, i[rows], j[rows])
    return coo_array((values, (i, j)), shape=(len(X), len(centers))).tocsr()


def _values(kernel: RadialKernel, X: Array, Y: Array, i: Indices, j: Indices) -> Array:
    difference = (X[i] - Y[j]) / kernel.beta
    r = np.sqrt(np.einsum("ij,ij->i", difference, difference))
    return kernel.profile(r, X.shape[1])
