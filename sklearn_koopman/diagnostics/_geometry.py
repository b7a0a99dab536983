"""How centres and samples lie on the manifold that they come from."""

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import digamma
from sklearn.utils import check_array, check_random_state

from .._utils._rows import distinct_rows
from .._utils._typing import Array, Indices
from .._utils._validation import (
    check_choice,
    check_integer,
    check_magnitude,
    refuse_masked,
)
from .._utils._warnings import warn

# The dimension is estimated from the distances to this neighbour and to the one of
# twice its order.
NEIGHBOR_ORDER = 4


def fill_distance(
    centers: Any,
    reference: Any,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute the largest distance of a point of the manifold from its nearest centre.

    .. math:: h = \\max_{x \\in Q} \\min_i d(x, \\xi_i)

    The manifold Q is unknown, so the maximum is taken over reference points on it. The
    error of an interpolant falls with a power of the fill distance ([1]_, theorem on
    the approximation of the Koopman operator). :func:`sobolev_rates` returns that
    power.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features)
        The centres.
    reference : array-like of shape (n_samples, n_features)
        Samples that cover the manifold, many times as many as centres. Trajectories
        in the order of time.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        Distances through the space around the manifold, or along the manifold. For
        "geodesic" distances are lengths of shortest paths in a graph, in which every
        sample is connected with its neighbours. Such paths do not jump over the gap
        between two branches of the manifold if the gap is wider than the distances of
        neighbours.
    n_neighbors : int, default=None
        Number of neighbours in the graph, for "geodesic" only. With more neighbours
        paths are straighter, but jump over wider gaps. None takes a 20th of the points
        of the graph, but at least 6 and at most 20. Paths are then too short by some
        0.1 % on curves, because they cut corners, and too long by 1 or 2 % on surfaces.

    Returns
    -------
    fill_distance : float
        The distance, in the unit of the states.

    Raises
    ------
    ValueError
        If the arrays do not fit together, or if the graph has parts without a centre.

    Warns
    -----
    UserWarning
        If `metric` is "geodesic" and neighbours are mostly the samples just before and
        after on a trajectory, although the trajectory passes by again closer than the
        distance of the centres.

    See Also
    --------
    separation_distance : Half the smallest distance of two centres.
    sklearn_koopman.SeparatedCenterSelector : Chooses centres by both.

    Notes
    -----
    Euclidean distances are found by a kd-tree of the centres, in some
    O(n_samples log n_centers) for few features. Shortest paths are found by Dijkstra's
    algorithm from all centres at once, in O(n log n) for n points of the graph with a
    fixed number of neighbours. Memory is O(n_samples).

    On a finely sampled trajectory the nearest neighbours of a sample are the samples
    just before and after it, and paths follow the trajectory. That is right if the
    manifold is the trajectory, but not if the trajectory winds around a surface. The
    samples alone do not show which is the case. Where the difference matters, a
    warning states the separation at which to thin the trajectory.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.diagnostics import fill_distance
    >>> angle = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle)])
    >>> centers = circle[::250]
    >>> round(fill_distance(centers, circle), 3)  # a chord
    0.765
    >>> round(fill_distance(centers, circle, metric="geodesic"), 3)  # pi / 4
    0.785
    """
    return measure(centers, reference, metric, n_neighbors).fill_distance()


def separation_distance(
    centers: Any,
    reference: Any = None,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute half the smallest distance of two centres.

    .. math:: q = \\tfrac{1}{2} \\min_{i \\ne j} d(\\xi_i, \\xi_j)

    Balls of this radius around the centres do not overlap. The smallest eigenvalue of
    the Gram matrix falls with a power of the separation distance
    (:func:`conditioning_study`).

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features)
        The centres.
    reference : array-like of shape (n_samples, n_features), default=None
        Samples that cover the manifold, for ``metric="geodesic"`` only.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        As for :func:`fill_distance`.
    n_neighbors : int, default=None
        As for :func:`fill_distance`.

    Returns
    -------
    separation_distance : float
        The distance, in the unit of the states: zero if two centres are equal, infinite
        for a single centre, and for centres without a path between any two of them.

    Raises
    ------
    ValueError
        If the arrays do not fit together.

    Warns
    -----
    UserWarning
        As for :func:`fill_distance`.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import separation_distance
    >>> separation_distance([[0.0, 0.0], [3.0, 4.0], [9.0, 9.0]])
    2.5
    """
    if metric == "geodesic" and reference is None:
        raise ValueError(
            "metric='geodesic' needs reference, got None; give samples that cover the "
            "manifold: the paths between the centres follow them."
        )
    if metric == "euclidean":
        reference = centers
    return measure(centers, reference, metric, n_neighbors).separation_distance()


def mesh_ratio(
    centers: Any,
    reference: Any,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute the fill distance divided by the separation distance.

    Centres with a small ratio are called quasi-uniform: no gap between them is much
    wider than the distance of neighbours. For centres of
    :class:`~sklearn_koopman.SeparatedCenterSelector` without `max_centers` the
    Euclidean ratio is at most 2, with respect to the samples that they were chosen
    from.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features)
        The centres.
    reference : array-like of shape (n_samples, n_features)
        Samples that cover the manifold.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        As for :func:`fill_distance`.
    n_neighbors : int, default=None
        As for :func:`fill_distance`.

    Returns
    -------
    mesh_ratio : float
        The ratio; infinite if two centres are equal, and zero for a single centre,
        whose separation distance is infinite.

    Raises
    ------
    ValueError
        As for :func:`fill_distance`.

    Warns
    -----
    UserWarning
        As for :func:`fill_distance`.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import mesh_ratio
    >>> mesh_ratio([[0.0], [2.0]], [[0.0], [0.5], [2.0], [4.0]])
    2.0
    """
    distances = measure(centers, reference, metric, n_neighbors)
    fill, separation = distances.fill_distance(), distances.separation_distance()
    return fill / separation if separation > 0 else np.inf


def intrinsic_dimension(
    X: Any,
    *,
    n_points: int | None = None,
    random_state: int | np.random.RandomState | None = 0,
) -> tuple[float, float]:
    """Estimate the dimension of the manifold that samples lie on.

    The number of samples in a ball grows with the power m of its radius, where m is the
    dimension. The estimate uses the distances r_n and r_2n of a sample from its n-th
    and its 2n-th neighbour ([1]_). With n = 4,

    .. math:: \\hat m = \\frac{\\psi(2n) - \\psi(n)}
        {\\operatorname{mean} \\log (r_{2n} / r_n)},

    where the digamma function :math:`\\psi` makes :math:`1 / \\hat m` exact on average
    for independent samples whose density hardly varies from r_n to r_2n.

    On a finely sampled trajectory all near neighbours are the samples just before and
    after, so that every such estimate would be 1. Therefore the estimate uses random
    subsets of the samples. The steps of a subset along the trajectory are at least as
    long as the distance at which the motion comes back to where it was.

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        The states: of trajectories in the order of time, one after the other, or
        independent samples in any order.
    n_points : int, default=None
        Number of points of each of up to four random subsets. It sets the scale: with
        fewer points the balls are larger. None takes the smallest of three numbers: a
        quarter of the samples (half, if there are fewer than 160);
        ``5 sqrt(n_samples)``; and the number for which the step between points is twice
        the median distance at which the motion returns.
    random_state : int, RandomState instance or None, default=0
        Seed of the subsets.

    Returns
    -------
    dimension : float
        The estimate. It is not rounded.
    standard_error : float
        The root of the sum of two squares. The first term is ``dimension`` divided by
        the root of the number of points used. It is twice the statistical error that
        independent ratios would have, because balls overlap and so the ratios are not
        independent. The second term is the change of the estimate from the subsets to
        subsets of half the size, which is large where curvature or noise matter.

    Raises
    ------
    ValueError
        If `X` has fewer than 36 distinct rows, or `n_points` is out of range.

    Notes
    -----
    The dimension depends on the scale: noise of the measurement fills all dimensions
    below its own size. With a lower `n_points` the balls are larger than the noise.
    Features should have comparable units.

    Near a boundary balls are cut off, which lowers the estimate by more than the
    standard error: by some 5 % for a square and 10 % for a cube. For many independent
    samples choose a larger `n_points` than the default, which suits trajectories.

    A motion that does not come back, such as a single stride, is a curve, whatever
    manifold it would fill in time.

    The cost is O(n_samples) for the distances at which the motion returns, and
    O(n_points log n_points) for each subset with few features.

    References
    ----------
    .. [1] F. Denti, D. Doimo, A. Laio and A. Mira, "The generalized ratios intrinsic
       dimension estimator", Scientific Reports 12, 2022.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.diagnostics import intrinsic_dimension
    >>> time = 0.05 * np.arange(5000)  # winds around a torus, finely sampled
    >>> angles = np.column_stack([time, np.sqrt(2) * time])
    >>> torus = np.hstack([np.cos(angles), np.sin(angles)])
    >>> dimension, standard_error = intrinsic_dimension(torus)
    >>> abs(dimension - 2) < 2 * standard_error < 0.4
    True
    """
    X = _checked(X, "X")
    X = X[distinct_rows(X)[0]]
    smallest = 2 * (2 * NEIGHBOR_ORDER + 1)
    if len(X) < 2 * smallest:
        raise ValueError(
            f"X has {len(X)} distinct rows, but an estimate of its dimension needs "
            f"{2 * smallest}; give more rows, or the dimension itself to a study."
        )
    if n_points is None:
        fewest = 4 if len(X) >= 160 else 2
        shares = [fewest, np.sqrt(len(X)) / 5, _return_in_steps(X)]
        n_points = max(int(len(X) / max(shares)), smallest)
    check_integer(n_points, "n_points", smallest)
    if n_points > len(X):
        raise ValueError(
            f"n_points={n_points} is more than the {len(X)} distinct rows."
        )
    order = check_random_state(random_state).permutation(len(X))
    dimension, n_used = _ratio_dimension(X, order, n_points)
    coarser, _ = _ratio_dimension(X, order, n_points // 2)
    return dimension, float(np.hypot(dimension / np.sqrt(n_used), dimension - coarser))


def _ratio_dimension(X: Array, order: Indices, n_points: int) -> tuple[float, int]:
    """Estimate the dimension from up to four disjoint subsets."""
    logs = []
    for first in range(0, min(4 * n_points, len(X) - n_points + 1), n_points):
        points = X[order[first : first + n_points]]
        # Each point is the first of its own neighbours.
        orders = [NEIGHBOR_ORDER + 1, 2 * NEIGHBOR_ORDER + 1]
        near = _neighbor_distances(points, points, orders)
        logs.append(np.log(near[:, 1] / near[:, 0]))
    ratios = np.concatenate(logs)
    mean = float(ratios.mean())
    growth = float(digamma(2 * NEIGHBOR_ORDER) - digamma(NEIGHBOR_ORDER))
    return growth / mean if mean else np.inf, len(ratios)


def _return_distances(X: Array, n_rows: int = 100) -> Array:
    """Find how near the motion comes back to some of the rows.

    The motion comes back to x at the distance r if it was at a distance of 2 r or more
    in between. The distance is infinite for a row that it does not come back to.
    """
    returned = []
    for row in np.unique(np.linspace(0, len(X) - 1, n_rows).astype(int)):
        distances = cdist(X, X[row : row + 1]).ravel()
        nearest = np.inf
        for side in (distances[row + 1 :], distances[:row][::-1]):
            back = side[np.maximum.accumulate(side) >= 2 * side]
            nearest = min(nearest, float(back.min(initial=np.inf)))
        returned.append(nearest)
    return np.array(returned)


def _return_in_steps(X: Array) -> float:
    """Express twice the median distance of returns in steps of the trajectory."""
    distance = float(np.median(_return_distances(X)))
    step = float(np.median(np.sqrt(np.square(np.diff(X, axis=0)).sum(axis=1))))
    return 2 * distance / step if np.isfinite(distance) else 0.0


class _Euclidean(NamedTuple):
    """Distances of centres through the space around the manifold."""

    centers: Array
    reference: Array

    def fill_distance(self) -> float:
        """Return the largest distance of a reference point from its nearest centre."""
        return float(_neighbor_distances(self.centers, self.reference, [1]).max())

    def separation_distance(self) -> float:
        """Return half the smallest distance of two centres."""
        # The nearest centre is the centre itself. A single one has no second.
        return float(_neighbor_distances(self.centers, self.centers, [2]).min()) / 2


class _Geodesic:
    """Lengths of shortest paths from the centres in a graph of all points."""

    def __init__(
        self, centers: Array, reference: Array, n_neighbors: int | None
    ) -> None:
        nodes = np.vstack([centers, reference])
        nodes = nodes[distinct_rows(nodes)[0]]
        n_nodes = len(nodes)
        n_centers = len(distinct_rows(centers)[0])  # they remain the first nodes
        self.has_equal_centers = n_centers < len(centers)
        if n_neighbors is None:
            n_neighbors = int(np.clip(n_nodes // 20, 6, 20))
        self.n_neighbors = min(n_neighbors, n_nodes - 1)
        # The nearest node of all is the node itself.
        found: Any = KDTree(nodes).query(nodes, k=[*range(1, self.n_neighbors + 2)])
        length, end = (neighbors[:, 1:] for neighbors in found)
        self.longest = length.max(axis=1, initial=0.0)
        self.begin = np.repeat(np.arange(n_nodes), self.n_neighbors)
        self.end, self.length = end.ravel(), length.ravel()
        edges: Any = csr_matrix((self.length, (self.begin, self.end)), (n_nodes,) * 2)
        self.distance, _, self.source = dijkstra(
            edges, False, np.arange(n_centers), return_predecessors=True, min_only=True
        )

    def fill_distance(self) -> float:
        """Return the length of the longest path from a point to its nearest centre."""
        n_lost = int(np.isinf(self.distance).sum())
        if n_lost:
            raise ValueError(
                f"{n_lost} of {len(self.distance)} points have no path to a centre "
                f"along {self.n_neighbors} neighbours each; add centres or samples, "
                "raise n_neighbors, or thin the reference by SeparatedCenterSelector."
            )
        return float(self.distance.max())

    def separation_distance(self) -> float:
        """Return half the length of the shortest path between two centres."""
        if self.has_equal_centers:
            return 0.0
        # Every node has a nearest centre. The shortest path between two centres has
        # one edge whose ends have different nearest centres.
        crossing = self.source[self.begin] != self.source[self.end]
        begin, end = self.begin[crossing], self.end[crossing]
        paths = self.distance[begin] + self.length[crossing] + self.distance[end]
        return float(paths.min(initial=np.inf)) / 2


def measure(
    centers: Any,
    reference: Any,
    metric: str,
    n_neighbors: int | None = None,
    trajectory: Array | None = None,
) -> _Euclidean | _Geodesic:
    """Prepare the distances of centres; warn where paths follow a trajectory.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features)
        The centres.
    reference : array-like of shape (n_samples, n_features)
        Samples that cover the manifold.
    metric : {"euclidean", "geodesic"}
        As for :func:`fill_distance`.
    n_neighbors : int, default=None
        As for :func:`fill_distance`.
    trajectory : ndarray of shape (n_rows, n_features), default=None
        The part of the reference that is in the order of time. None for all of it.

    Returns
    -------
    distances : _Euclidean or _Geodesic
        With methods that compute the fill and the separation distance.
    """
    check_choice(metric, "metric", ("euclidean", "geodesic"))
    if n_neighbors is not None:
        check_integer(n_neighbors, "n_neighbors", 1)
        if metric == "euclidean":
            raise ValueError("n_neighbors is for metric='geodesic' only.")
    centers, reference = _checked(centers, "centers"), _checked(reference, "reference")
    if centers.shape[1] != reference.shape[1]:
        raise ValueError(
            f"centers has {centers.shape[1]} features, but reference has "
            f"{reference.shape[1]}; give states of the same kind and scale."
        )
    straight = _Euclidean(centers, reference)
    if metric == "euclidean":
        return straight
    paths = _Geodesic(centers, reference, n_neighbors)
    trajectory = reference if trajectory is None else trajectory
    apart = float(np.median(_return_distances(trajectory)))
    # Twice: neighbourhoods have to reach well into the next passage.
    if np.median(paths.longest) < 2 * apart < 2 * straight.fill_distance():
        warn(
            f"The paths follow the trajectory: the {paths.n_neighbors} neighbours of "
            "most points are the samples just before and after. If the motion covers a "
            f"surface, thin the reference by SeparatedCenterSelector({apart:.2g})."
        )
    return paths


def _neighbor_distances(points: Array, X: Array, orders: list[int]) -> Array:
    """Return the distances from rows of X to the points of these orders of nearness."""
    return np.asarray(KDTree(points).query(X, k=orders)[0], dtype=np.float64)


def _checked(X: Any, name: str) -> Array:
    refuse_masked(**{name: X})
    X = check_array(X, dtype=np.float64, input_name=name)
    check_magnitude(X, name=name)
    return np.asarray(X, dtype=np.float64)
