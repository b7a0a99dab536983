"""How centres and samples lie on the manifold that they come from."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.special import digamma
from sklearn.utils import check_array, check_random_state, gen_batches

from sklearn_koopman._utils._rows import distinct_rows
from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman._utils._validation import check_integer, check_magnitude

# Rows whose neighbours are sought at a time.
BATCH = 2**16
# The distances to this neighbour and that of twice its order tell the dimension.
NEIGHBOR = 4


def fill_distance(
    centers: Any,
    reference: Any,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute how far a point of the manifold can be from the nearest centre.

    .. math:: h = \\max_{x \\in Q} \\min_i d(x, \\xi_i)

    for reference points in the place of the unknown manifold Q. The error of an
    interpolant falls with a power of it ([1]_, theorem on the approximation of the
    Koopman operator); :func:`sobolev_rates` tells which.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features)
        The centres.
    reference : array-like of shape (n_samples, n_features)
        Samples that cover the manifold, many times as many as centres. Trajectories
        in the order of time.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        Distances through the space around the manifold, or along it. For "geodesic"
        they are lengths of shortest paths in a neighbourhood graph of the samples,
        which do not jump over the gap between two branches of the manifold, as long
        as the gap is wider than the neighbourhoods.
    n_neighbors : int, default=None
        Number of neighbours in the graph, for "geodesic" only. More of them make paths
        straighter, and jump over wider gaps. None takes a 20th of the points of the
        graph, but at least 6 and at most 20: paths are then too short by some 0.1 %
        on curves, which they cut, and too long by 1 or 2 % on surfaces.

    Returns
    -------
    fill_distance : float
        The distance, in the unit of the states.

    Raises
    ------
    ValueError
        If the arrays do not fit together, or if the neighbourhood graph has parts
        without a centre.

    Warns
    -----
    UserWarning
        If the paths of ``metric="geodesic"`` follow a trajectory, whose passages lie
        closer together than the centres.

    See Also
    --------
    separation_distance : Half the smallest distance of two centres.
    sklearn_koopman.SeparatedCenterSelector : Chooses centres by both.

    Notes
    -----
    Euclidean distances come from a kd-tree of the centres, and shortest paths from
    Dijkstra's algorithm, from all centres at once.

    On a finely sampled trajectory the nearest neighbours are the samples just before
    and after, and paths follow the trajectory: right, if it is the manifold, but not
    where it winds around a surface. Only its user knows; where it matters a warning
    tells at which separation to thin it.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds".

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
    centers, reference = _checked_points(centers, reference)
    if _is_geodesic(metric, n_neighbors):
        return _neighborhoods(centers, reference, n_neighbors).fill_distance()
    return _fill_distance(centers, reference)


def separation_distance(
    centers: Any,
    reference: Any = None,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute the radius of the largest disjoint balls around the centres.

    .. math:: q = \\tfrac{1}{2} \\min_{i \\ne j} d(\\xi_i, \\xi_j)

    The smallest eigenvalue of the Gram matrix falls with a power of it
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
        Half the smallest distance of two centres; zero if two are equal, infinite for
        a single one, and for centres without a path between any two of them.

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
    if _is_geodesic(metric, n_neighbors):
        if reference is None:
            raise ValueError(
                "metric='geodesic' needs reference: samples that cover the manifold, "
                "which the paths between the centres follow."
            )
        centers, reference = _checked_points(centers, reference)
        return _neighborhoods(centers, reference, n_neighbors).separation_distance()
    return _separation_distance(_checked(centers, "centers"))


def mesh_ratio(
    centers: Any,
    reference: Any,
    *,
    metric: str = "euclidean",
    n_neighbors: int | None = None,
) -> float:
    """Compute the fill distance over the separation distance.

    Centres with a small ratio are quasi-uniform: they make the most of the fill
    distance that their conditioning pays for. Those of
    :class:`~sklearn_koopman.SeparatedCenterSelector`, without `max_centers`, have a
    ratio of at most 2 in Euclidean distances, with respect to the samples that they
    were chosen among.

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
        which is infinitely separated.

    Raises
    ------
    ValueError
        As for :func:`fill_distance`.

    Examples
    --------
    >>> from sklearn_koopman.diagnostics import mesh_ratio
    >>> mesh_ratio([[0.0], [2.0]], [[0.0], [0.5], [2.0], [4.0]])
    2.0
    """
    centers, reference = _checked_points(centers, reference)
    if _is_geodesic(metric, n_neighbors):
        graph = _neighborhoods(centers, reference, n_neighbors)
        fill, separation = graph.fill_distance(), graph.separation_distance()
    else:
        fill = _fill_distance(centers, reference)
        separation = _separation_distance(centers)
    return fill / separation if separation > 0 else np.inf


def intrinsic_dimension(
    X: Any,
    *,
    n_points: int | None = None,
    random_state: int | np.random.RandomState | None = 0,
) -> tuple[float, float]:
    """Estimate the dimension of the manifold that samples lie on.

    The number of samples in a ball grows with the power m of its radius, so that the
    distances r_n and r_2n of the n-th and the 2n-th neighbour tell the dimension m
    ([1]_). With n = 4,

    .. math:: \\hat m = \\frac{\\psi(2n) - \\psi(n)}
        {\\operatorname{mean} \\log (r_{2n} / r_n)},

    where the digamma function :math:`\\psi` makes :math:`1 / \\hat m` exact on average
    for independent samples (where the density hardly varies from r_n to r_2n).

    On a finely sampled trajectory all near neighbours are the samples just before and
    after, and every such estimate says 1. Therefore it is made on random subsets of
    the samples, with steps along the trajectory as long as the distance at which the
    motion comes back to where it was, or longer.

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        The states: of trajectories in the order of time, one after the other, or
        independent samples in any order.
    n_points : int, default=None
        Number of points of each of up to four random subsets, which sets the scale:
        with fewer of them, larger balls are looked at. None takes the smallest of a
        quarter of the samples (half of them, below 160), ``5 sqrt(n_samples)``, and as
        many as make the step between them two times the median distance at which the
        motion returns.
    random_state : int, RandomState instance or None, default=0
        Seed of the subsets.

    Returns
    -------
    dimension : float
        The estimate. It is not rounded.
    standard_error : float
        The root of the sum of two squares: of ``dimension`` over the root of the
        number of points used (twice the statistical error of independent ratios, of
        which there are fewer than points, since balls overlap); and of the change of
        the estimate from subsets to half as large ones, which shows where curvature
        or noise matter.

    Raises
    ------
    ValueError
        If `X` has fewer than 36 distinct rows, or `n_points` is out of range.

    Notes
    -----
    A dimension is a matter of scale: noise of the measurement fills all dimensions
    below its own size. Lower `n_points` looks beyond it. Features should have
    comparable units.

    Near a boundary balls are cut off, which lowers the estimate: by some 5 % for a
    square and 10 % for a cube, which is more than the standard error. Many independent
    samples deserve more `n_points` than the default, which suits trajectories.

    A motion that does not come back, as a single stride, is a curve, whatever
    manifold it would fill in time.

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
    smallest = 2 * (2 * NEIGHBOR + 1)
    if len(X) < 2 * smallest:
        raise ValueError(
            f"X has {len(X)} distinct rows; the intrinsic dimension needs at least "
            f"{2 * smallest}, and is worth little with fewer than some hundred."
        )
    if n_points is None:
        fewest = 4 if len(X) >= 160 else 2
        shares = [fewest, np.sqrt(len(X)) / 5, _return_in_steps(X)]
        n_points = max(int(len(X) / max(shares)), smallest)
    check_integer(n_points, "n_points", smallest)
    if n_points > len(X):
        raise ValueError(
            f"n_points={n_points} is more than the {len(X)} distinct rows of X."
        )
    order = check_random_state(random_state).permutation(len(X))
    dimension, n_used = _ratio_dimension(X, order, n_points)
    coarser, _ = _ratio_dimension(X, order, n_points // 2)
    return dimension, float(np.hypot(dimension / np.sqrt(n_used), dimension - coarser))


def _ratio_dimension(X: Array, order: Indices, n_points: int) -> tuple[float, int]:
    """Estimate the dimension from disjoint subsets of so many points."""
    logs = []
    for first in range(0, min(4 * n_points, len(X) - n_points + 1), n_points):
        points = X[order[first : first + n_points]]
        near, _ = _nearest(KDTree(points), points, [NEIGHBOR + 1, 2 * NEIGHBOR + 1])
        logs.append(np.log(near[:, 1] / near[:, 0]))
    ratios = np.concatenate(logs)
    mean = float(ratios.mean())
    if mean == 0:
        return np.inf, len(ratios)
    return float(digamma(2 * NEIGHBOR) - digamma(NEIGHBOR)) / mean, len(ratios)


def _return_distances(X: Array, n_rows: int = 100) -> Array:
    """Find how near the motion comes back to some of the rows, in the order of time.

    It comes back to x when, after it has been at a distance of 2 r at least, it is at
    a distance of r. Infinite for those that it does not come back to.
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


def _fill_distance(centers: Array, reference: Array) -> float:
    tree, farthest = KDTree(centers), 0.0
    for rows in gen_batches(len(reference), BATCH):
        farthest = max(farthest, float(_nearest(tree, reference[rows], 1)[0].max()))
    return farthest


def _separation_distance(centers: Array) -> float:
    if len(centers) < 2:
        return np.inf
    distances, _ = _nearest(KDTree(centers), centers, [2])
    return float(distances.min()) / 2


def _neighborhoods(centers: Array, reference: Array, n_neighbors: int | None) -> _Graph:
    """Build the graph, and warn where neighbours are only those in time."""
    graph = _Graph(centers, reference, n_neighbors)
    if message := graph.follows(reference, _fill_distance(centers, reference)):
        warnings.warn(message, UserWarning, stacklevel=3)
    return graph


def fill_and_separation(
    centers: Array, states: Array, others: Array, metric: str
) -> tuple[float, float, str]:
    """Compute both distances at once.

    Parameters
    ----------
    centers : ndarray of shape (n_centers, n_features)
        The centres.
    states : ndarray of shape (n_samples, n_features)
        States in the order of time.
    others : ndarray of shape (n_others, n_features)
        Further states on the manifold.
    metric : {"euclidean", "geodesic"}
        As for :func:`fill_distance`.

    Returns
    -------
    fill : float
        The fill distance with respect to all states.
    separation : float
        The separation distance.
    message : str
        What to warn of, if anything.
    """
    reference = np.vstack([states, others])
    fill = _fill_distance(centers, reference)
    if not _is_geodesic(metric, None):
        return fill, _separation_distance(centers), ""
    graph = _Graph(centers, reference, None)
    message = graph.follows(states, fill)
    return graph.fill_distance(), graph.separation_distance(), message


class _Graph:
    """Shortest paths from the centres in a neighbourhood graph of all points."""

    def __init__(
        self, centers: Array, reference: Array, n_neighbors: int | None
    ) -> None:
        nodes = np.vstack([centers, reference])
        nodes = nodes[distinct_rows(nodes)[0]]
        n_centers = len(distinct_rows(centers)[0])  # they remain the first ones
        self.equal_centers = n_centers < len(centers)
        if n_neighbors is None:
            n_neighbors = int(np.clip(len(nodes) // 20, 6, 20))
        self.n_neighbors = min(n_neighbors, len(nodes) - 1)
        # The nearest one of all is the point itself.
        near = list(range(2, self.n_neighbors + 2))
        length, end = _nearest(KDTree(nodes), nodes, near)
        self.longest = length.max(axis=1, initial=0.0)
        self.begin = np.repeat(np.arange(len(nodes)), self.n_neighbors)
        self.end, self.length = end.ravel(), length.ravel()
        edges = csr_matrix(
            (self.length, (self.begin, self.end)), shape=(len(nodes),) * 2
        )
        self.distance, _, self.source = dijkstra(
            edges,
            directed=False,
            indices=np.arange(n_centers),
            min_only=True,
            return_predecessors=True,
        )

    def fill_distance(self) -> float:
        lost = int(np.isinf(self.distance).sum())
        if lost:
            raise ValueError(
                f"{lost} of {len(self.distance)} points have no path to a centre along "
                f"{self.n_neighbors} neighbours each: they lie on a part of the "
                "manifold without centres, or the samples are unevenly spread. Add "
                "centres or samples there, raise n_neighbors, or thin the reference "
                "by SeparatedCenterSelector."
            )
        return float(self.distance.max())

    def follows(self, trajectory: Array, fill: float) -> str:
        """Say so if paths follow a trajectory, between passages nearby."""
        apart = float(np.median(_return_distances(trajectory)))
        # Twice: neighbourhoods have to reach well into the next passage.
        if not np.median(self.longest) < 2 * apart < 2 * fill:
            return ""
        return (
            f"The {self.n_neighbors} neighbours of most points are mostly the samples "
            f"just before and after, while the motion returns at a distance of "
            f"{apart:.2g}: paths follow the trajectory. If its passages lie on a "
            "surface rather than on a curve, thin the reference: "
            f"reference[SeparatedCenterSelector({apart:.2g}).fit(reference)."
            "center_indices_]."
        )

    def separation_distance(self) -> float:
        if self.equal_centers:
            return 0.0
        # The shortest path between two centres crosses once from the points nearest
        # to the one to those nearest to the other.
        crossing = self.source[self.begin] != self.source[self.end]
        begin, end = self.begin[crossing], self.end[crossing]
        ways = self.distance[begin] + self.length[crossing] + self.distance[end]
        return float(ways.min(initial=np.inf)) / 2


def _nearest(tree: KDTree, X: Array, which: int | list[int]) -> tuple[Array, Indices]:
    """Return the distances and numbers of some of the nearest points of a tree."""
    if which == []:
        return np.empty((len(X), 0)), np.empty((len(X), 0), dtype=np.intp)
    distances, indices = tree.query(X, k=[which] if isinstance(which, int) else which)
    return np.asarray(distances, dtype=np.float64), np.asarray(indices, dtype=np.intp)


def _is_geodesic(metric: Any, n_neighbors: int | None) -> bool:
    if not isinstance(metric, str) or metric not in ("euclidean", "geodesic"):
        raise ValueError(f"metric must be 'euclidean' or 'geodesic', got {metric!r}.")
    if n_neighbors is not None:
        check_integer(n_neighbors, "n_neighbors", 1)
        if metric == "euclidean":
            raise ValueError("n_neighbors is for metric='geodesic' only.")
    return metric == "geodesic"


def _checked(X: Any, name: str) -> Array:
    X = check_array(X, dtype=np.float64, input_name=name)
    check_magnitude(X, name=name)
    return np.asarray(X, dtype=np.float64)


def _checked_points(centers: Any, reference: Any) -> tuple[Array, Array]:
    centers, reference = _checked(centers, "centers"), _checked(reference, "reference")
    if centers.shape[1] != reference.shape[1]:
        raise ValueError(
            f"centers has {centers.shape[1]} features, but reference has "
            f"{reference.shape[1]}; they must be states of the same kind (and scale)."
        )
    return centers, reference
