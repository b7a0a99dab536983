"""Selection of separated centres among samples, by kd-trees."""

from functools import partial
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from sklearn.utils import gen_batches

from ._utils._typing import Array, Indices, Mask
from ._utils._validation import MAX_MAGNITUDE, MIN_MAGNITUDE, check_magnitude

# Rows that are compared at a time, so that temporary arrays stay in the cache.
CHUNK_ROWS = 2**14
# Up to so many rows, all their distances cost less than a tree.
MAX_ROWS_WITHOUT_TREE = 64


def select_centers(
    X: Array,
    separation: float,
    order: str,
    max_centers: int | None,
    known: Array,
    trees: list[KDTree],
) -> tuple[Indices, Indices, float, float, list[KDTree]]:
    """Select centres among the samples of one batch, given those of earlier batches.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples of the batch.
    separation : float
        A sample becomes a centre if it is farther than this from all earlier centres.
    order : {"sequential", "farthest"}
        The order in which samples become centres; "farthest" takes no earlier centres.
    max_centers : int or None
        The largest number of centres, `known` included.
    known : ndarray of shape (n_known, n_features)
        The centres from earlier batches.
    trees : list of KDTree
        The trees that the call for the last batch returned. They are built anew from
        `known` if the list is empty.

    Returns
    -------
    rows : ndarray of shape (n_added,)
        The rows of the new centres, in the order of selection.
    labels : ndarray of shape (n_samples,)
        The number of the centre nearest to each sample, known centres first.
    separation_distance : float
        Half the smallest distance between a new centre and any other centre.
    fill_distance : float
        The largest distance of a sample from its nearest centre.
    trees : list of KDTree
        Trees of all centres, for the next batch.

    Raises
    ------
    ValueError
        If the squares of the samples leave the range of a double.
    """
    # Beside states of ordinary size, tiny values may be rounded to zero.
    smallest = 0.0 if known.any() else MIN_MAGNITUDE
    if not smallest <= np.abs(X).max() <= MAX_MAGNITUDE:
        check_magnitude(X, smallest)
    trees = trees or [KDTree(known)]
    distances, labels = nearest_centers(X, trees)
    if order == "sequential":
        most = len(X) if max_centers is None else max_centers - len(known)
        uncovered = np.flatnonzero(~_covered(X, distances, trees, separation))
        rows = _separated(X, uncovered, separation, most)
    else:
        rows = farthest_centers(X, separation, max_centers)
    if len(rows) == 0:
        return rows, labels, np.inf, _largest_distance(X, known, labels), trees
    added = KDTree(X[rows])
    gaps = np.full(added.n, np.inf)
    if added.n > 1:
        _, neighbors = added.query(added.data, k=2)
        gaps = _distances(added.data, added.data[np.asarray(neighbors)[:, 1]])
    if len(known):
        gaps = np.minimum(gaps, _distances(added.data, known[labels[rows]]))
    to_added, label = nearest_centers(X, [added])
    labels = np.where(to_added < distances, len(known) + label, labels)
    fill = _largest_distance(X, np.vstack([known, added.data]), labels)
    # Trees of a similar size are merged, so that there are few trees, and each centre
    # is moved to a new tree only a few times: one tree, rebuilt for every small batch,
    # would cost more than the selection itself. Trees smaller than a batch are merged,
    # too.
    while trees and trees[-1].n < max(2 * added.n, len(X)):
        *trees, last = trees
        added = KDTree(np.vstack([last.data, added.data]))
    return rows, labels, float(gaps.min()) / 2, fill, [*trees, added]


def sequential_centers(X: Array, separation: float) -> Indices:
    """Select centres in the order of the rows (Algorithm 1 of the paper).

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples.
    separation : float
        A row is selected if it is farther than this from all rows selected before.

    Returns
    -------
    indices : ndarray of shape (n_centers,)
        The selected rows, in rising order.
    """
    return _separated(X, np.arange(len(X)), float(separation), len(X))


def farthest_centers(X: Array, separation: float, max_centers: int | None) -> Indices:
    """Select the first row, then always the row farthest from the centres so far.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples.
    separation : float
        Selection ends when no sample is farther than this from the centres.
    max_centers : int or None
        Stop after this many centres.

    Returns
    -------
    indices : ndarray of shape (n_centers,)
        The selected rows, in the order of selection.
    """
    n_samples = len(X)
    most = max_centers or n_samples
    # Splits at the median would take quadratic time on repeated samples.
    build_tree = partial(KDTree, balanced_tree=False, compact_nodes=False)
    order = np.asarray(build_tree(X).indices)
    tree = build_tree(X[order])
    # In the order of the tree, samples near each other in space are near each other
    # in memory. A new centre therefore changes the distances of few blocks, and the
    # farthest sample is found from the largest distance of each block.
    size = max(int(np.sqrt(n_samples)), 1)
    n_blocks = -(-n_samples // size)
    distance = np.full(n_blocks * size, -np.inf)
    distance[:n_samples] = _distances(tree.data, X[0])
    blocks = distance.reshape(n_blocks, size)
    farthest = blocks.max(axis=1)
    indices = [0]
    while len(indices) < most and (radius := farthest.max()) > separation:
        where = np.flatnonzero(farthest == radius)
        block, offset = np.nonzero(blocks[where] == radius)
        row = int(order[where[block] * size + offset].min())
        indices.append(row)
        # Samples beyond `radius` are nearer to an earlier centre. The tree rounds
        # distances in another way; the margin makes it find all others.
        ball: Any = tree.query_ball_point(X[row], radius * (1 + 1e-9))
        near = np.array(ball, dtype=np.intp)
        distance[near] = np.minimum(distance[near], _distances(tree.data[near], X[row]))
        touched = np.zeros(n_blocks, dtype=bool)
        touched[near // size] = True
        farthest[touched] = blocks[touched].max(axis=1)
    return np.array(indices, dtype=np.intp)


def nearest_centers(X: Array, trees: list[KDTree]) -> tuple[Array, Indices]:
    """Find the nearest centre of each sample.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples.
    trees : list of KDTree
        Trees of consecutive centres.

    Returns
    -------
    distances : ndarray of shape (n_samples,)
        The distance to the nearest centre; infinite if there is no centre.
    labels : ndarray of shape (n_samples,)
        The number of that centre.
    """
    distances = np.full(len(X), np.inf)
    labels = np.zeros(len(X), dtype=np.intp)
    first = 0
    for tree in trees:
        found, label = tree.query(X, distance_upper_bound=distances.max())
        nearer = found < distances
        distances[nearer] = np.asarray(found)[nearer]
        labels[nearer] = first + np.asarray(label)[nearer]
        first += tree.n
    return distances, labels


def _separated(X: Array, rows: Indices, separation: float, most: int) -> Indices:
    """Select at most so many separated centres among some rows, in their order.

    The centres of the first half of the rows are selected first. One query of their
    tree then finds the rows of the second half that they cover, usually nearly all of
    them. So few rows are left to select from, and each row is compared with few trees.
    """
    if len(rows) <= MAX_ROWS_WITHOUT_TREE:
        points = X[rows]
        near = _distances(points[:, np.newaxis], points) <= separation
        covered = np.zeros(len(rows), dtype=bool)
        kept: list[int] = []
        for i in range(len(rows)):
            if not covered[i] and len(kept) < most:
                kept.append(i)
                covered |= near[i]
        return rows[kept]
    half = len(rows) // 2
    first = _separated(X, rows[:half], separation, most)
    if len(first) >= most:
        return first
    tree = KDTree(X[first])
    _, beyond = _margin(separation)
    uncovered = []
    for start in range(half, len(rows), CHUNK_ROWS):
        chunk = rows[start : start + CHUNK_ROWS]
        points = X[chunk]
        distances, _ = tree.query(points, distance_upper_bound=beyond)
        covered = _covered(points, np.asarray(distances), [tree], separation)
        uncovered.append(chunk[~covered])
    rest = np.concatenate(uncovered)
    return np.concatenate([first, _separated(X, rest, separation, most - len(first))])


def _covered(
    X: Array, distances: Array, trees: list[KDTree], separation: float
) -> Mask:
    """Return a mask of the samples within the separation of a centre in the trees.

    `distances` are those to the nearest centre as a tree computes them. They decide,
    except near the separation, where a tree may round to the other side: there the
    distances to all centres nearby are computed in the same way for every tree.
    """
    within, beyond = _margin(separation)
    covered = distances <= within
    close = np.flatnonzero(~covered & (distances <= beyond))
    for tree, start in product(trees, range(0, len(close), CHUNK_ROWS)):
        rows = close[start : start + CHUNK_ROWS]
        found: Any = tree.query_ball_point(X[rows], beyond, return_sorted=False)
        rows = np.repeat(rows, [len(centers) for centers in found])
        centers = np.concatenate(found).astype(np.intp)
        hit = _distances(X[rows], tree.data[centers]) <= separation
        covered[rows[hit]] = True
    return covered


def _margin(separation: float) -> tuple[float, float]:
    """Return the distances below and above which a tree's rounding cannot matter.

    The absolute part allows for squares below the range of a double.
    """
    within = separation * (1 - 1e-9) - 1e-150
    return max(within, 0.0), separation * (1 + 1e-9) + 1e-150


def _distances(X: Array, x: Array) -> Array:
    difference = X - x
    difference *= difference
    return np.sqrt(difference.sum(axis=-1))


def _largest_distance(X: Array, centers: Array, labels: Indices) -> float:
    return max(
        float(_distances(X[rows], centers[labels[rows]]).max())
        for rows in gen_batches(len(X), CHUNK_ROWS)
    )
