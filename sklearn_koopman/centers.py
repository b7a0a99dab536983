"""Selection of separated kernel centres among samples."""

from __future__ import annotations

from functools import partial
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
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman._validation import check_integer, check_magnitude, check_number

__all__ = ["SeparatedCenterSelector"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


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
        they were selected.
    cluster_centers_ : ndarray of shape (n_centers, n_features)
        The centres.
    labels_ : ndarray of shape (n_samples,)
        The nearest centre of each sample, or one of them.
    separation_distance_ : float
        Half the smallest distance between two centres; infinite for one centre.
    fill_distance_ : float
        The largest distance of a sample from its nearest centre.
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
    units. A kd-tree covers the ball of every new centre, so that low-dimensional
    motion costs about n log n however many features describe it; memory is linear.

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
        given = X
        X = check_array(X, dtype=np.float64, estimator=self, input_name="X")
        check_magnitude(X)
        check_number(self.separation, "separation")
        if self.max_centers is not None:
            check_integer(self.max_centers, "max_centers", 1)
        orders = ("sequential", "farthest")
        if not isinstance(self.order, str) or self.order not in orders:
            raise ValueError(
                f"order must be 'sequential' or 'farthest', got {self.order!r}."
            )
        sequential = self.order == "sequential"
        select = sequential_centers if sequential else farthest_centers
        indices = select(X, self.separation, self.max_centers)
        centers = X[indices]
        labels = _nearest(X, centers)
        # Attributes are set last: a fit that fails leaves the selector as it was.
        validate_data(self, given, skip_check_array=True)
        self.center_indices_ = indices
        self.cluster_centers_ = centers
        self.labels_ = labels
        self.separation_distance_ = _smallest_distance(centers) / 2
        self.fill_distance_ = float(_distances(X, centers[labels]).max())
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
        return _nearest(X, self.cluster_centers_)

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
    tree, order = _sorted_tree(X)
    uncovered = np.ones(len(X), dtype=bool)
    indices: list[int] = []
    row = 0
    while len(indices) < most:
        indices.append(row)
        near, distances = _ball(tree, X[row], separation)
        uncovered[order[near[distances <= separation]]] = False
        # The next sample not covered is the next centre: those before it are not.
        row += int(uncovered[row:].argmax())
        if not uncovered[row]:
            break
    return np.array(indices, dtype=np.intp)


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


def distinct_rows(X: Array) -> tuple[Indices, Indices, Indices]:
    """Find equal rows.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
        The rows.

    Returns
    -------
    first : ndarray of shape (n_distinct,)
        The first of each lot of equal rows, in rising order.
    group : ndarray of shape (n_samples,)
        Which of them each row equals.
    counts : ndarray of shape (n_distinct,)
        How many rows equal each of them.
    """
    _, first, group, counts = np.unique(
        X, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    # In the order of the rows, not in that of their values.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[group.reshape(-1)], counts[order]


def group_means(values: Array, group: Indices) -> Array:
    """Average the rows of each group.

    Parameters
    ----------
    values : ndarray of shape (n_samples, n_columns)
        The rows.
    group : ndarray of shape (n_samples,)
        The number of the group that each row belongs to, as `distinct_rows` gives it.

    Returns
    -------
    means : ndarray of shape (n_groups, n_columns)
        The mean of each group.
    """
    counts = np.bincount(group)
    means = np.zeros((len(counts), values.shape[1]))
    np.add.at(means, group, values)
    means /= counts[:, np.newaxis]
    return means


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


def check_distances(X: Array) -> None:
    """Refuse what cannot be distances.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_centers)
        The supposed distances.
    """
    if X.min() < 0:
        raise ValueError(
            f"X holds {X.min():.3g}: with centers='precomputed' its entries are "
            "distances to the centres, as SeparatedCenterSelector.transform gives them."
        )


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


def _nearest(X: Array, centers: Array) -> Indices:
    """Return which centre is nearest to each sample."""
    _, labels = KDTree(centers).query(X)
    return np.asarray(labels, dtype=np.intp)


def _distances(X: Array, x: Array) -> Array:
    difference = X - x
    difference *= difference
    return np.sqrt(difference.sum(axis=1))


def _smallest_distance(X: Array) -> float:
    if len(X) < 2:
        return np.inf
    _, neighbors = KDTree(X).query(X, k=2)
    return float(_distances(X, X[np.asarray(neighbors)[:, 1]]).min())
