"""Selection of separated kernel centres among samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from sklearn.base import (
    BaseEstimator,
    ClassNamePrefixFeaturesOutMixin,
    TransformerMixin,
    clone,
)
from sklearn.utils import check_array
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted, has_fit_parameter, validate_data

from ._selection import nearest_centers, select_centers
from ._utils._rows import distinct_rows, spread, warn_without_spread
from ._utils._typing import Array, Indices
from ._utils._validation import (
    check_distances,
    check_integer,
    check_magnitude,
    check_number,
    check_parameters,
    refuse_masked,
)
from ._utils._warnings import warn

__all__ = ["SeparatedCenterSelector"]

ORDERS = ("sequential", "farthest")
# The default separation in units of the spread. A closed curve of one loop gets some
# 40 centres, walking with delays some hundreds.
SEPARATION_PER_SPREAD = 0.1
# Part of a warning.
FEW_CENTERS = "leaves too few centres"


def _selects_in_batches(selector: Any) -> bool:
    if isinstance(selector.order, str) and selector.order == "farthest":
        raise AttributeError(
            "order='farthest' has no partial_fit, since it compares all samples; use "
            "order='sequential', or fit on all samples."
        )
    return True


class SeparatedCenterSelector(
    ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator
):
    """Select samples that keep a minimal distance from each other as centres.

    A kernel estimate is a sum of kernel sections k(., c), one for each centre c. Its
    error falls with the fill distance, the largest distance of a sample from its
    nearest centre, so the centres have to cover the motion. The smallest eigenvalue of
    the Gram matrix falls with the separation distance, half the smallest distance
    between two centres, so the centres have to lie apart. The selector goes through the
    samples and selects each one that is farther than `separation` from all centres
    before. Any two centres are then farther than `separation` apart, and no sample is
    farther than `separation` from its nearest centre.

    Parameters
    ----------
    separation : float or "scale", default="scale"
        The distance eta of [1]_, in the unit of the states: any two centres are farther
        apart. With 0 every distinct sample is a centre. "scale" is 0.1 times the
        spread of the states: the square root of the sum of the variances of the
        columns of `X`, which is their root mean square distance from their mean. The
        centres are then the same in every unit of the states. `partial_fit` takes the
        spread of the first batch that needs it for all later ones.
    order : {"sequential", "farthest"}, default="sequential"
        The order in which samples become centres.

        - "sequential": the order of the rows (Algorithm 1 of [1]_). The first row is
          always a centre.
        - "farthest": the first row, then always the sample that is farthest from the
          centres so far ([2]_), the first of them if several are equally far. The
          first m centres are those of ``max_centers=m``, and their fill distance is at
          most twice that of the best m centres.
    max_centers : int, default=None
        Largest number of centres. If it ends the selection, some samples may be farther
        than `separation` from all centres: see `fill_distance_`.

    Attributes
    ----------
    center_indices_ : ndarray of shape (n_centers,)
        The rows of the centres in the data given to `fit`, in the order of selection.
        After `partial_fit`, rows are counted through all batches.
    cluster_centers_ : ndarray of shape (n_centers, n_features)
        The centres.
    separation_ : float
        The separation used, in the unit of the states.
    labels_ : ndarray of shape (n_samples,)
        The number of the nearest centre of each sample, one of them if several are
        equally near. After `partial_fit`, for the samples of the last batch.
    separation_distance_ : float
        Half the smallest distance between two centres, in the unit of the states;
        infinite for one centre.
    fill_distance_ : float
        The largest distance of a sample from its nearest centre, in the unit of the
        states. After `partial_fit` an upper bound of that distance: the samples of a
        batch are compared with the centres known then, and later centres may be nearer.
    n_samples_seen_ : int
        Number of samples given to `fit` and to the calls of `partial_fit` after it.
    n_features_in_ : int
        Number of features seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the features, where `X` had string names.

    See Also
    --------
    sklearn_koopman.KoopmanKernelRegressor : Takes a selector as its `centers`.

    Notes
    -----
    Distances are Euclidean: put a scaler in front where the features have different
    units. Samples are compared with kd-trees of the centres before them. For motion on
    a manifold of low dimension, `fit` takes about O(n log n) time for n samples,
    whatever the number of features; in many dimensions it approaches O(n M) for M
    centres. Memory is proportional to the samples, and with `partial_fit` to one batch
    and the centres. `transform` takes O(n M) time and memory, `predict` about O(n log
    M) time.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.
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
        separation: float | str = "scale",
        *,
        order: str = "sequential",
        max_centers: int | None = None,
    ) -> None:
        self.separation = separation
        self.order = order
        self.max_centers = max_centers

    def fit(self, X: Any, y: Any = None) -> Self:
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
            If a parameter is outside its range, if `X` is no finite 2-D array, or if
            its values are too large or too small to be squared.

        Warns
        -----
        UserWarning
            If the separation leaves one centre of samples that differ, or the default
            two, as it does where some samples are far from all others.
        """
        self._extend(X, {})
        n_centers, is_default = len(self.cluster_centers_), self.separation == "scale"
        few = n_centers <= (2 if is_default else 1) and self.max_centers != n_centers
        if few and self.fill_distance_ > 0:
            scale = spread(self._check_states(X))
            remedy = "leave out samples that are far from all others, or set a number"
            if not is_default:
                number = resolve_separation("scale", scale)
                remedy = f"set separation='scale', which is {number:.3g} here"
            warn(
                f"separation={self.separation_:.3g} {FEW_CENTERS}, {n_centers} for "
                f"{self.n_samples_seen_} samples, whose spread is {scale:.3g}; "
                f"{remedy}."
            )
        return self

    @available_if(_selects_in_batches)
    def partial_fit(self, X: Any, y: Any = None) -> Self:
        """Select further centres from the next batch of samples.

        The centres are those of one `fit` to all batches in a row, whatever the size of
        the batches. Memory holds the centres and one batch only.

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

        Warns
        -----
        UserWarning
            If ``separation="scale"``, and all rows of the first batch are equal.

        Notes
        -----
        Parameters that were changed since the last batch apply to this batch and later
        ones. Centres that were selected before remain. With ``separation="scale"`` the
        first batch should spread as all states will: its spread counts, and the
        centres are those of one `fit` with ``separation=separation_``.

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
        is_first = not hasattr(self, "n_samples_seen_")
        self._extend(X, vars(self))
        if is_first and self._spread is not None:
            warn_without_spread(self, X)
        return self

    def _extend(self, given: Any, fitted: Mapping[str, Any]) -> Self:
        """Select from a batch of samples, given the attributes after earlier ones."""
        refuse_masked(X=given)
        is_first = "n_samples_seen_" not in fitted
        # Attributes are set last: a fit that fails leaves the selector as it was.
        checker = clone(self) if is_first else self
        X = validate_data(checker, given, reset=is_first, dtype=np.float64, order="C")
        check_parameters(self, order=ORDERS)
        scale = fitted.get("_spread")  # of the first batch that needs it
        if scale is None and isinstance(self.separation, str):
            scale = spread(X)
        separation = resolve_separation(self.separation, scale)
        if self.max_centers is not None:
            check_integer(self.max_centers, "max_centers", 1)
        known = fitted.get("cluster_centers_", np.empty((0, X.shape[1])))
        trees = fitted.get("_trees", [])  # absent from a pickle
        rows, self.labels_, gap, fill, self._trees = select_centers(
            X, separation, self.order, self.max_centers, known, trees
        )
        self.separation_, self._spread = separation, scale
        if is_first:
            validate_data(self, given, skip_check_array=True)
        n_seen = fitted.get("n_samples_seen_", 0)
        indices = fitted.get("center_indices_", np.empty(0, dtype=np.intp))
        self.center_indices_ = np.concatenate([indices, n_seen + rows])
        self.cluster_centers_ = np.vstack([known, X[rows]])
        self.separation_distance_ = min(fitted.get("separation_distance_", np.inf), gap)
        self.fill_distance_ = max(fitted.get("fill_distance_", 0.0), fill)
        self.n_samples_seen_ = n_seen + len(X)
        return self

    def fit_predict(self, X: Any, y: Any = None) -> Indices:
        """Select the centres, and find the nearest one of each sample.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.
        y : object, default=None
            Not used.

        Returns
        -------
        labels : ndarray of shape (n_samples,)
            The number of the nearest centre: `labels_`.
        """
        return self.fit(X).labels_

    def transform(self, X: Any) -> Array:
        """Compute the distances to the centres.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The states.

        Returns
        -------
        distances : ndarray of shape (n_samples, n_centers)
            Euclidean distances in the unit of the states, exactly zero between a centre
            and itself.

        Raises
        ------
        ValueError
            If `X` is no finite 2-D array with the features of the fit, or if its values
            are too large to be squared.
        """
        return cdist(self._check_states(X), self.cluster_centers_)

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

        Raises
        ------
        ValueError
            As in :meth:`transform`.
        """
        X = self._check_states(X)
        return nearest_centers(X, [KDTree(self.cluster_centers_)])[1]

    def _check_states(self, X: Any) -> Array:
        check_is_fitted(self)
        refuse_masked(X=X)
        X = np.asarray(validate_data(self, X, reset=False, dtype=np.float64))
        check_magnitude(X, smallest=0)
        return X

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the trees, which follow from the centres."""
        state = super().__getstate__()
        return {name: state[name] for name in state if name != "_trees"}

    @property
    def _n_features_out(self) -> int:
        return len(self.cluster_centers_)


def resolve_separation(separation: Any, spread: float | None) -> float:
    """Return the number that the parameter `separation` stands for.

    Parameters
    ----------
    separation : float or "scale"
        The parameter.
    spread : float or None
        How far the states spread; only "scale" needs it.

    Returns
    -------
    separation : float
        The separation in the unit of the states.

    Raises
    ------
    ValueError
        If it is neither "scale" nor a non-negative number.
    """
    if isinstance(separation, str):
        if separation != "scale":
            raise ValueError(
                "separation must be a finite non-negative number or 'scale', got "
                f"{separation!r}."
            )
        assert spread is not None
        return SEPARATION_PER_SPREAD * spread
    check_number(separation, "separation")
    return float(separation)


def fit_selector(selector: Any, X: Array, y: Any, weights: Array | None = None) -> Any:
    """Fit a clone of a selector, with the weights of the rows if they matter to it.

    Parameters
    ----------
    selector : estimator
        The selector, which stays as it is.
    X : ndarray of shape (n_samples, n_features)
        The samples.
    y : ndarray
        The outputs.
    weights : ndarray of shape (n_samples,), default=None
        The weights, all of them positive.

    Returns
    -------
    selector : estimator
        The clone.
    """
    selector = clone(selector)
    if weights is not None and has_fit_parameter(selector, "sample_weight"):
        return selector.fit(X, y, sample_weight=weights)
    if weights is not None and isinstance(selector, SeparatedCenterSelector):
        # Nothing else than its default scale depends on them.
        scale = spread(X, weights)
        selector.separation = resolve_separation(selector.separation, scale)
    return selector.fit(X, y)


def choose_centers(
    centers: Any, X: Array, y: Any, weights: Array | None = None, *, among_rows: bool
) -> tuple[Array, Indices | None]:
    """Return the centres for the parameter `centers` of an estimator.

    Parameters
    ----------
    centers : array-like of shape (n_centers, n_features) or estimator
        The centres, or an estimator whose clone is fitted to find them.
    X : ndarray of shape (n_samples, n_features)
        The samples.
    y : ndarray
        The outputs, which some estimators need.
    weights : ndarray of shape (n_samples,), default=None
        The weights of the rows.
    among_rows : bool
        Whether every centre has to be a row of `X`.

    Returns
    -------
    points : ndarray of shape (n_centers, n_features)
        The centres.
    rows : ndarray of shape (n_centers,) or None
        The first row of `X` that equals each centre; None if that is not known.

    Raises
    ------
    ValueError
        If `centers` is none of these, has other features than `X`, or, with
        `among_rows`, holds a centre that is no row of `X`.
    """
    rows = None
    if isinstance(centers, str | type):
        raise ValueError(
            "centers must be None, an array, a selector (an instance) or "
            f"'precomputed', got {centers!r}."
        )
    if hasattr(centers, "fit"):
        selector = fit_selector(centers, X, y, weights)
        if not hasattr(selector, "cluster_centers_"):
            raise ValueError(
                f"centers={centers!r} has no cluster_centers_ after fit; use "
                "SeparatedCenterSelector, KMeans, or an array of centres."
            )
        points = np.array(selector.cluster_centers_, dtype=np.float64)
        own = getattr(selector, "center_indices_", None)
        # The rows of a frozen selector may be those of other data.
        if own is not None and own.max() < len(X) and np.array_equal(X[own], points):
            rows = own
    else:
        refuse_masked(centers=centers)
        points = check_array(centers, dtype=np.float64, copy=True, input_name="centers")
    if points.shape[1] != X.shape[1]:
        raise ValueError(
            f"centers has {points.shape[1]} features, but X has {X.shape[1]}; pass "
            "centres in the space (and on the scale) of X."
        )
    if rows is None and among_rows:
        first, group, _ = distinct_rows(np.vstack([X, points]))
        rows = first[group[len(X) :]]
        if rows.max() >= len(X):
            raise ValueError(
                f"{(rows >= len(X)).sum()} of {len(points)} centres, from centers="
                f"{type(centers).__name__}, are no rows of X, so their outputs are not "
                "known; set method='least_squares', or use a SeparatedCenterSelector."
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

    Raises
    ------
    ValueError
        If a distance is negative, or a column holds no zero.
    """
    check_distances(distances)
    rows = distances.argmin(axis=0)
    apart = np.flatnonzero(distances[rows, np.arange(distances.shape[1])] != 0)
    if len(apart):
        raise ValueError(
            f"centers='precomputed': {len(apart)} of {distances.shape[1]} columns of X "
            f"(the first is {apart[0]}) hold no zero. Rows left out after the selector "
            "cause this; pass the states, and centers=SeparatedCenterSelector()."
        )
    return rows
