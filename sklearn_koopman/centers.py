"""Selection of separated kernel centres among samples."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from sklearn.base import (
    BaseEstimator,
    ClassNamePrefixFeaturesOutMixin,
    ClusterMixin,
    TransformerMixin,
    clone,
)
from sklearn.utils import check_array
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman._utils._rows import distinct_rows
from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman._utils._validation import (
    check_distances,
    check_integer,
    check_magnitude,
    check_number,
)

__all__ = ["SeparatedCenterSelector"]


# Rows gone through at a time, so that temporary arrays stay small and in the cache.
CHUNK = 2**14
# Rows few enough to measure all their distances sooner than to build a tree.
FEW = 64


def _takes_batches(selector: SeparatedCenterSelector) -> bool:
    if isinstance(selector.order, str) and selector.order == "farthest":
        raise AttributeError(
            "partial_fit cannot select with order='farthest', which compares all "
            "samples at once; use order='sequential', or fit on all samples."
        )
    return True


class SeparatedCenterSelector(
    ClassNamePrefixFeaturesOutMixin, TransformerMixin, ClusterMixin, BaseEstimator
):
    """Select samples that keep a minimal distance from each other as centres.

    The centres of a kernel estimate have to be dense enough to cover the motion (the
    error falls with their fill distance) and far enough apart to keep the Gram matrix
    well conditioned (its smallest eigenvalue falls with their separation). Walking
    through the samples and keeping every one that is farther than `separation` from
    all kept before achieves both: the kept ones are separated by more than
    `separation`, and no sample lies farther than `separation` from them.

    Parameters
    ----------
    separation : float, default=1.0
        The paper's eta, in the unit of the states: any two centres are farther apart
        than this. 0 keeps every distinct sample.
    order : {"sequential", "farthest"}, default="sequential"
        How the samples are gone through.

        - "sequential": Algorithm 1 of [1]_. In the order of the rows, the first row
          always kept.
        - "farthest": the first row, then always the sample that is farthest from the
          centres so far (the one of lowest index among equally far ones; [2]_). The
          centres are nested: the first m of them are those of ``max_centers=m``, and
          their fill distance is at most twice that of the best m centres.
    max_centers : int, default=None
        Stop after this many centres, which may then leave samples farther than
        `separation` away; `fill_distance_` tells how far.

    Attributes
    ----------
    center_indices_ : ndarray of shape (n_centers,)
        The rows of the centres in the data given to `fit`, in the order in which
        they were selected. With `partial_fit`, counted through all batches.
    cluster_centers_ : ndarray of shape (n_centers, n_features)
        The centres.
    labels_ : ndarray of shape (n_samples,)
        The nearest centre of each sample, or one of them. After `partial_fit`, of the
        samples of the last batch.
    separation_distance_ : float
        Half the smallest distance between two centres; infinite for one centre.
    fill_distance_ : float
        The largest distance of a sample from its nearest centre. After `partial_fit`
        an upper bound of it: the samples of each batch are measured once, to the
        centres known then, though later ones may lie nearer.
    n_samples_seen_ : int
        Number of samples that `fit` and the calls of `partial_fit` after it went
        through.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, where `X` had string names.

    See Also
    --------
    sklearn_koopman.KoopmanKernelRegressor : Takes a selector as its `centers`.

    Notes
    -----
    Distances are Euclidean: put a scaler in front where the states have different
    units. Samples are compared with kd-trees of the centres before them, so that
    low-dimensional motion costs about n log n however many features describe it;
    memory is linear. `partial_fit` keeps the centres and one batch.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds", Algorithm 1.
    .. [2] T. F. Gonzalez, "Clustering to minimize the maximum intercluster
       distance", Theoretical Computer Science 38, 1985.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman import SeparatedCenterSelector
    >>> X = np.array([[0.0], [0.4], [1.0], [1.1], [2.5]])
    >>> selector = SeparatedCenterSelector(separation=0.5).fit(X)
    >>> selector.center_indices_
    array([0, 2, 4])
    >>> selector.labels_
    array([0, 0, 1, 1, 2])
    >>> selector.separation_distance_, selector.fill_distance_
    (0.5, 0.4)

    Batch by batch the centres are the same:

    >>> selector = SeparatedCenterSelector(separation=0.5)
    >>> for batch in (X[:2], X[2:]):
    ...     selector = selector.partial_fit(batch)
    >>> selector.center_indices_
    array([0, 2, 4])
    """

    def __init__(
        self,
        separation: float = 1.0,
        *,
        order: str = "sequential",
        max_centers: int | None = None,
    ) -> None:
        self.separation = separation
        self.order = order
        self.max_centers = max_centers

    def fit(self, X: Any, y: Any = None) -> SeparatedCenterSelector:
        """Select the centres.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states, in the order of time where `order` is "sequential".
        y : object, default=None
            Not used.

        Returns
        -------
        self : SeparatedCenterSelector
            The fitted selector.

        Raises
        ------
        ValueError
            If a parameter is outside its range, or `X` is no finite 2-D array.
        """
        return self._extend(X, {})

    @available_if(_takes_batches)
    def partial_fit(self, X: Any, y: Any = None) -> SeparatedCenterSelector:
        """Go on selecting, with the next batch of samples.

        The centres are those of one `fit` to all batches in a row, however they are
        divided, while memory holds no more than the centres and one batch.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states that follow those of the calls before, of `fit` included.
        y : object, default=None
            Not used.

        Returns
        -------
        self : SeparatedCenterSelector
            The fitted selector.

        Raises
        ------
        AttributeError
            With ``order="farthest"``, which needs all samples at once.
        ValueError
            As in `fit`, or if the features are not those of the calls before.

        Notes
        -----
        Parameters that were set in between hold from this batch on; centres selected
        before remain.

        Examples
        --------
        >>> from sklearn_koopman import SeparatedCenterSelector
        >>> selector = SeparatedCenterSelector(separation=0.5)
        >>> selector.partial_fit([[0.0], [0.4]]).center_indices_
        array([0])
        >>> selector.partial_fit([[1.0], [1.1], [2.5]]).center_indices_
        array([0, 2, 4])
        >>> selector.labels_, selector.n_samples_seen_
        (array([1, 1, 2]), 5)
        """
        return self._extend(X, vars(self))

    def _extend(self, given: Any, fitted: Mapping[str, Any]) -> SeparatedCenterSelector:
        """Select among the samples, given the attributes of a fit to those before."""
        is_first = "n_samples_seen_" not in fitted
        if is_first:
            X = check_array(
                given, dtype=np.float64, order="C", estimator=self, input_name="X"
            )
        else:
            X = validate_data(self, given, reset=False, dtype=np.float64, order="C")
        known = fitted.get("cluster_centers_", np.empty((0, X.shape[1])))
        # Next to known states, small values are differences that may be neglected.
        check_magnitude(X, smallest=0 if known.any() else 1e-150)
        check_number(self.separation, "separation")
        separation = float(self.separation)
        if self.max_centers is not None:
            check_integer(self.max_centers, "max_centers", 1)
        orders = ("sequential", "farthest")
        if not isinstance(self.order, str) or self.order not in orders:
            raise ValueError(
                f"order must be 'sequential' or 'farthest', got {self.order!r}."
            )
        n_seen = fitted.get("n_samples_seen_", 0)
        # Loaded from a pickle, the centres come without their trees.
        trees = fitted.get("_trees") or [KDTree(known)]
        distances, labels = _nearest(X, trees)
        if self.order == "sequential":
            most = n_seen + len(X) if self.max_centers is None else self.max_centers
            candidates = np.flatnonzero(~_covered(X, distances, trees, separation))
            rows = _separated(X, candidates, separation, most - len(known))
        else:
            rows = farthest_centers(X, separation, self.max_centers)
        centers = known
        closest = 2 * fitted.get("separation_distance_", np.inf)
        if len(rows):
            added = KDTree(X[rows])
            centers = np.vstack([known, added.data])
            closest = min(closest, _smallest_distance(added))
            if not is_first:
                gaps = _distances(added.data, known[labels[rows]])
                closest = min(closest, float(gaps.min()))
            to_added, label = _nearest(X, [added])
            labels = np.where(to_added < distances, len(known) + label, labels)
            trees = _merged(trees, added, len(X))
        fill = _largest_distance(X, centers, labels)

        # Attributes are set last: a fit that fails leaves the selector as it was.
        if is_first:
            validate_data(self, given, skip_check_array=True)
        indices = fitted.get("center_indices_", np.empty(0, dtype=np.intp))
        self.center_indices_ = np.concatenate([indices, n_seen + rows])
        self.cluster_centers_ = centers
        self.labels_ = labels
        self.separation_distance_ = closest / 2
        self.fill_distance_ = max(fitted.get("fill_distance_", 0.0), fill)
        self.n_samples_seen_ = n_seen + len(X)
        self._trees = trees
        return self

    def transform(self, X: Any) -> Array:
        """Compute the distances to the centres.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        distances : ndarray of shape (n_samples, n_centers)
            Euclidean distances, exactly zero between a centre and itself.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        check_magnitude(X, smallest=0)
        return cdist(X, self.cluster_centers_)

    def predict(self, X: Any) -> Indices:
        """Find the nearest centre.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        labels : ndarray of shape (n_samples,)
            The number of the nearest centre.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=np.float64)
        check_magnitude(X, smallest=0)
        return _nearest(X, [KDTree(self.cluster_centers_)])[1]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the trees, which follow from the centres."""
        state = dict(super().__getstate__())
        state.pop("_trees", None)
        return state

    @property
    def _n_features_out(self) -> int:
        return len(self.cluster_centers_)


def sequential_centers(
    X: Array, separation: float, max_centers: int | None = None
) -> Indices:
    """Select centres in the order of the rows (Algorithm 1 of the paper).

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples.
    separation : float
        A row is kept if its distance to all rows kept before is larger than this.
    max_centers : int, default=None
        Stop after this many centres.

    Returns
    -------
    indices : ndarray of shape (n_centers,)
        The rows kept, in rising order.
    """
    most = len(X) if max_centers is None else max_centers
    return _separated(X, np.arange(len(X)), float(separation), most)


def farthest_centers(
    X: Array, separation: float, max_centers: int | None = None
) -> Indices:
    """Select centres farthest first.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The samples.
    separation : float
        Selection ends when no sample is farther than this from the centres.
    max_centers : int, default=None
        Stop after this many centres.

    Returns
    -------
    indices : ndarray of shape (n_centers,)
        The rows kept, in the order of selection.
    """
    n_samples = len(X)
    most = n_samples if max_centers is None else max_centers
    tree, order = _sorted_tree(X)
    # In the order of the tree, samples near each other in space are near each other
    # in memory. A ball touches few of the blocks whose largest distances are kept, so
    # that the farthest sample is found without a pass over all samples.
    size = max(int(np.sqrt(n_samples)), 1)
    n_blocks = -(-n_samples // size)
    distance = np.full(n_blocks * size, -np.inf)
    distance[:n_samples] = _distances(tree.data, X[0])
    blocks = distance.reshape(n_blocks, size)
    farthest = blocks.max(axis=1)
    indices = [0]
    while len(indices) < most:
        radius = farthest.max()
        if not radius > separation:
            break
        where = np.flatnonzero(farthest == radius)
        block, offset = np.nonzero(blocks[where] == radius)
        row = int(order[where[block] * size + offset].min())
        indices.append(row)
        # Only samples nearer to the new centre than the covering radius can gain.
        near, distances = _ball(tree, X[row], radius)
        distance[near] = np.minimum(distance[near], distances)
        touched = np.zeros(n_blocks, dtype=bool)
        touched[near // size] = True
        farthest[touched] = blocks[touched].max(axis=1)
    return np.array(indices, dtype=np.intp)


def choose_centers(
    centers: Any, X: Array, y: Any, *, among_rows: bool
) -> tuple[Array, Indices | None]:
    """Return the centres that an estimator's parameter `centers` means.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features) or estimator
        The centres, or an estimator whose clone is fitted to find them.
    X : ndarray of shape (n_samples, n_features)
        The samples.
    y : ndarray
        The outputs, for estimators that ask for them.
    among_rows : bool
        Whether every centre has to be a row of `X`.

    Returns
    -------
    points : ndarray of shape (n_centers, n_features)
        The centres.
    rows : ndarray of shape (n_centers,) or None
        The first row of `X` that each centre is; None where that is not known.
    """
    rows = None
    if hasattr(centers, "fit") and not isinstance(centers, type):
        selector = clone(centers).fit(X, y)
        if not hasattr(selector, "cluster_centers_"):
            raise ValueError(
                f"centers={centers!r} has no cluster_centers_ after fit; use "
                "SeparatedCenterSelector, KMeans, or an array of centres."
            )
        points = np.asarray(selector.cluster_centers_, dtype=np.float64)
        rows = getattr(selector, "center_indices_", None)
        # A frozen selector knows rows of the data that it was fitted to.
        if rows is not None and not (
            rows.max() < len(X) and np.array_equal(X[rows], points)
        ):
            rows = None
    elif isinstance(centers, str | type):
        raise ValueError(
            "centers must be None, an array, a selector (an instance) or "
            f"'precomputed', got {centers!r}."
        )
    else:
        points = check_array(centers, dtype=np.float64, copy=True, input_name="centers")
    if points.shape[1] != X.shape[1]:
        raise ValueError(
            f"centers has {points.shape[1]} features, but X has {X.shape[1]}; they "
            "must be states of the same kind (and scale)."
        )
    if rows is None and among_rows:
        first, group, _ = distinct_rows(np.vstack([X, points]))
        rows = first[group[len(X) :]]
        missing = rows >= len(X)
        if missing.any():
            raise ValueError(
                f"{missing.sum()} of {len(points)} centres, given or chosen by "
                f"centers={type(centers).__name__}, are no rows of X, so that their "
                "outputs are unknown; use method='least_squares', or choose the "
                "centres among the rows (SeparatedCenterSelector does)."
            )
    return points, rows


def rows_at_distance_zero(distances: Array) -> Indices:
    """Find the centres among the rows, given the distances of the rows to them.

    Parameters
    ----------
    distances : ndarray of shape (n_samples, n_centers)
        The distances.

    Returns
    -------
    rows : ndarray of shape (n_centers,)
        The first row at distance zero from each centre.
    """
    check_distances(distances)
    rows = distances.argmin(axis=0)
    apart = np.flatnonzero(distances[rows, np.arange(distances.shape[1])] != 0)
    if len(apart):
        raise ValueError(
            f"With centers='precomputed' every centre must be a row of X at distance "
            f"zero from itself, but {len(apart)} of {distances.shape[1]} columns "
            f"(first {apart[0]}) hold no zero. Rows left out after the selector, or "
            "centres such as those of KMeans, cause this; pass the states and "
            "centers=SeparatedCenterSelector() instead."
        )
    return rows


def _sorted_tree(X: Array) -> tuple[KDTree, Indices]:
    """Build a tree of the samples sorted in space, and return it with their order."""
    # Median splits cost a quadratic number of steps on repeated samples.
    build = partial(KDTree, balanced_tree=False, compact_nodes=False)
    order = np.asarray(build(X).indices)
    return build(X[order]), order


def _ball(tree: KDTree, x: Array, radius: float) -> tuple[Indices, Array]:
    """Return the samples of the tree within the radius of x, and their distances.

    The tree compares squared distances. With the margin it returns a few samples just
    beyond the radius, too, and the caller decides by the distances themselves.
    """
    found = tree.query_ball_point(x, radius * (1 + 1e-9), return_sorted=False)
    near = np.array(found, dtype=np.intp)
    return near, _distances(tree.data[near], x)


def _separated(X: Array, rows: Indices, separation: float, most: int) -> Indices:
    """Select at most so many centres among some rows, gone through in their order.

    Once the first half has its centres, one query tells which rows of the second half
    they cover. Nearly all, mostly: hence a row is compared with few trees, and work
    and memory do not grow with the number of rows in a ball.
    """
    if len(rows) <= FEW:
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
    for start in range(half, len(rows), CHUNK):
        chunk = rows[start : start + CHUNK]
        points = X[chunk]
        distances, _ = tree.query(points, distance_upper_bound=beyond)
        covered = _covered(points, np.asarray(distances), [tree], separation)
        uncovered.append(chunk[~covered])
    rest = np.concatenate(uncovered)
    return np.concatenate([first, _separated(X, rest, separation, most - len(first))])


def _covered(
    X: Array, distances: Array, trees: list[KDTree], separation: float
) -> NDArray[np.bool_]:
    """Tell which samples lie within the separation of a centre in the trees.

    The distances to the nearest centre, as trees compute them, decide where rounding
    cannot matter. Elsewhere those of all centres at about the separation do.
    """
    within, beyond = _margin(separation)
    covered = distances <= within
    close = np.flatnonzero(~covered & (distances <= beyond))
    for tree, start in product(trees, range(0, len(close), CHUNK)):
        rows = close[start : start + CHUNK]
        found: Any = tree.query_ball_point(X[rows], beyond, return_sorted=False)
        rows = np.repeat(rows, [len(centers) for centers in found])
        centers = np.concatenate(found).astype(np.intp)
        hit = _distances(X[rows], tree.data[centers]) <= separation
        covered[rows[hit]] = True
    return covered


def _margin(separation: float) -> tuple[float, float]:
    """Return the distances up to, and from which, a tree's rounding cannot matter.

    The absolute part is for squares that leave the range of a double.
    """
    within = separation * (1 - 1e-9) - 1e-150
    return max(within, 0.0), separation * (1 + 1e-9) + 1e-150


def _nearest(X: Array, trees: list[KDTree]) -> tuple[Array, Indices]:
    """Return the distance and the number of the centre nearest to each sample.

    The trees hold the centres in their order. Without any the distance is infinite.
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


def _merged(trees: list[KDTree], added: KDTree, n_samples: int) -> list[KDTree]:
    """Add the tree of new centres to those of the centres before.

    Trees of a similar size are merged. Then there are few, and a centre moves to
    another only a few times: rebuilding one for every small batch would cost more than
    to select. Nor is a tree worth asking that is smaller than the batches are.
    """
    while trees and trees[-1].n < max(2 * added.n, n_samples):
        *trees, last = trees
        added = KDTree(np.vstack([last.data, added.data]))
    return [*trees, added]


def _distances(X: Array, x: Array) -> Array:
    difference = X - x
    difference *= difference
    return np.sqrt(difference.sum(axis=-1))


def _smallest_distance(tree: KDTree) -> float:
    if tree.n < 2:
        return np.inf
    _, neighbors = tree.query(tree.data, k=2)
    return float(_distances(tree.data, tree.data[np.asarray(neighbors)[:, 1]]).min())


def _largest_distance(X: Array, centers: Array, labels: Indices) -> float:
    chunks = (slice(start, start + CHUNK) for start in range(0, len(X), CHUNK))
    return max(
        float(_distances(X[chunk], centers[labels[chunk]]).max()) for chunk in chunks
    )
