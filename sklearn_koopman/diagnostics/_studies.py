"""Studies of convergence and conditioning on the user's data."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.linalg import LinAlgWarning
from scipy.stats import linregress, t
from sklearn.base import clone
from sklearn.gaussian_process.kernels import Kernel, WhiteKernel
from sklearn.utils import Bunch, check_array, check_consistent_length

from .._selection import sequential_centers
from .._utils._pipeline import transformed, unwrap
from .._utils._typing import Array, Mask
from .._utils._validation import check_number, check_positive, refuse_masked
from .._utils._warnings import warn
from ..centers import SeparatedCenterSelector
from ..kernels import as_kernel
from ._conditioning import condition_number, digits_lost, extreme_eigenvalues
from ._geometry import fill_distance, intrinsic_dimension, measure, separation_distance
from ._rates import sobolev_rates

# Errors below this, relative to the outputs, are taken for rounding errors.
ROUNDING_ERROR = 1e-12
# So are errors below this that no longer fall from one fill distance to the next.
STALLED_ERROR = 1e-8


def convergence_study(
    estimator: Any,
    X: Any,
    y: Any,
    separations: Any,
    X_test: Any,
    y_test: Any,
    *,
    metric: str = "euclidean",
    dimension: float | None = None,
    confidence: float = 0.95,
) -> Bunch:
    """Measure how fast the error falls with the fill distance of the centres.

    The estimator is fitted once for each separation, and its errors on the test data
    are compared with the rate that the theory guarantees.

    Parameters
    ----------
    estimator : estimator
        A :class:`~sklearn_koopman.KoopmanKernelRegressor`, or a pipeline that ends in
        one. Its `centers` are a selector with a parameter `separation`, or None, which
        means :class:`~sklearn_koopman.SeparatedCenterSelector`. It is not changed.
    X : array-like of shape (n_samples, n_features)
        The states to choose the centres from.
    y : array-like of shape (n_samples,) or (n_samples, n_outputs)
        Their outputs one step later.
    separations : array-like of shape (n_separations,)
        The separations: smallest distances that centres keep from each other, in the
        units of the states that the kernel is applied to.
    X_test : array-like of shape (n_test, n_features)
        States on the same manifold, other than centres.
    y_test : array-like of shape (n_test,) or (n_test, n_outputs)
        Their outputs.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        Fill and separation distances through the space, or along the manifold (see
        :func:`fill_distance`). For small distances the slopes are the same.
    dimension : float, default=None
        Dimension of the manifold, for the guaranteed rate. None for the estimate of
        :func:`intrinsic_dimension` for `X`, rounded to a whole number.
    confidence : float, default=0.95
        The level of the confidence intervals of the slopes.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        separation, n_centers, fill_distance, separation_distance, sup_error, \
rms_error, condition_number : ndarray of shape (n_separations,)
            The table, in the order of `separations`. Distances are in the units of the
            states that the kernel is applied to (behind the steps of a pipeline). The
            fill distance is the one with respect to all states given. Errors of several
            outputs are lengths of vectors, in the unit of the outputs. The condition
            number is that of the matrix of the linear system, `alpha` included.
        used : ndarray of shape (n_separations,), bool
            Which lines the slopes are fitted to. A line is left out if it has the same
            centres as the line before, if centres were dropped for numerical
            dependence, or if its error is at the level of rounding: below 1e-12 of the
            outputs, or below 1e-8 of them without any finer line that has half of the
            smallest error so far.
        slope, rms_slope : float
            Slopes of the logarithms of the errors over the logarithm of the fill
            distance, by least squares; NaN from fewer than two lines.
        slope_interval, rms_slope_interval : ndarray of shape (2,)
            Their confidence intervals, for independent normal scatter about a straight
            line; NaN from two lines.
        guaranteed_slope : float
            The exponent of the sup error that :func:`sobolev_rates` guarantees. NaN
            where the theorem does not apply, and for least squares, ``alpha > 0`` or a
            kernel with a noise term.
        rates : :class:`~sklearn.utils.Bunch`
            The result of :func:`sobolev_rates`.
        dimension, confidence : float
            The dimension and the confidence that were used.
        kernel : str
            The representation of the kernel.

    Raises
    ------
    ValueError
        If the estimator has no `centers` that separations apply to, or other
        parameters are out of range.

    Warns
    -----
    UserWarning
        As for :func:`fill_distance`, at most once.
    Warning
        Every warning of the fits, once, other than that centres were dropped, which
        `used` shows.

    See Also
    --------
    conditioning_study : The price of small separations.
    sklearn_koopman.plotting.ConvergenceDisplay : Draws the study.

    Notes
    -----
    Choose separations that give from about 12 centres up to about half of the samples.
    The asymptotic slope is not visible if the centres are farther apart than `beta`.

    The cost is one fit for each separation, and the eigenvalues of its Gram matrix:
    O(M^3) time and O(M^2) memory for M centres.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman import KoopmanKernelRegressor
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.diagnostics import convergence_study
    >>> train = make_pendulum(2000)
    >>> test = make_pendulum(1000, initial=train.X_next[-1])  # the same orbit, later
    >>> study = convergence_study(
    ...     KoopmanKernelRegressor("matern32", beta=2.0),
    ...     *(train.X, train.y, np.geomspace(0.5, 0.02, 7), test.X, test.y),
    ... )
    >>> study.guaranteed_slope
    1.5
    >>> bool(3.5 < study.slope < 4.3)  # the output is smoother than it has to be
    True
    """
    refuse_masked(X=X, y=y, X_test=X_test, y_test=y_test)
    truth, learned = _outputs(y_test, X_test), _outputs(y, X)
    if truth.shape[1:] != learned.shape[1:]:
        raise ValueError(
            f"y_test has the shape {truth.shape} and y {learned.shape}; give both the "
            "same outputs."
        )
    separations = check_positive(separations, "separations")
    _check_confidence(confidence)
    settings = _separation_setting(estimator)
    rates: Any = None
    centers: Any = None
    messages: dict[str, Any] = {}
    lines: list[dict[str, Any]] = []
    for separation in separations:
        model = clone(estimator).set_params(**settings(separation))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            model.fit(X, y)
            error = _lengths(np.reshape(model.predict(X_test), truth.shape) - truth)
            final, front = unwrap(model)
            if not hasattr(final, "centers_"):
                raise ValueError(
                    "estimator must be a KoopmanKernelRegressor, or end in one, fitted "
                    f"to states and not to distances, got {final!r}."
                )
            states, test = (np.asarray(transformed(front, x)) for x in (X, X_test))
            if rates is None:  # a wrong dimension should not cost all fits
                dimension = _whole_dimension(states) if dimension is None else dimension
                rates = sobolev_rates(final.kernel_, states.shape[1], dimension)
            reference = np.vstack([states, test])
            previous, centers = centers, final.centers_
            distances = measure(centers, reference, metric, trajectory=states)
        messages |= {str(warning.message): warning.category for warning in caught}
        is_sound = not any(issubclass(w.category, LinAlgWarning) for w in caught)
        is_exact = final.method == "interpolation"
        nugget = final.alpha if is_exact else 0.0
        line = {
            "separation": separation,
            "n_centers": len(centers),
            "fill_distance": distances.fill_distance(),
            "separation_distance": distances.separation_distance(),
            "sup_error": float(error.max()),
            "rms_error": float(np.sqrt(np.mean(error**2))),
            "condition_number": condition_number(final.kernel_, centers, alpha=nugget),
            "used": is_sound and not np.array_equal(previous, centers),
        }
        lines.append(line)
    for message, category in messages.items():
        if not issubclass(category, LinAlgWarning):
            warn(message, category)
    table = {name: np.array([line[name] for line in lines]) for name in lines[0]}
    used = table["used"]
    size = float(np.abs(truth).max())
    used &= above_rounding(table["fill_distance"], table["sup_error"], size)
    noisy = [isinstance(k, WhiteKernel) for k in final.kernel_.get_params().values()]
    is_exact = is_exact and final.alpha == 0 and not any(noisy)
    fits: dict[str, Any] = {}
    for name, errors in (("slope", "sup_error"), ("rms_slope", "rms_error")):
        fits[name], fits[f"{name}_interval"] = _slope(
            table["fill_distance"][used], table[errors][used], confidence
        )
    return Bunch(
        **table,
        **fits,
        guaranteed_slope=rates.sup_exponent if is_exact else np.nan,
        rates=rates,
        dimension=dimension,
        confidence=confidence,
        kernel=repr(final.kernel_),
    )


def conditioning_study(
    kernels: Sequence[Any],
    betas: Any,
    X: Any,
    separations: Any,
    *,
    dimension: float | None = None,
    confidence: float = 0.95,
) -> Bunch:
    """Measure the condition of Gram matrices for several kernels, scales, separations.

    Centres are chosen by Algorithm 1 of [1]_, one after the other in the order of the
    samples. Figures 5 and 6 of [1]_ show such studies.

    Parameters
    ----------
    kernels : str, Kernel or sequence of them
        The kernels.
    betas : array-like of shape (n_betas,)
        Their scales.
    X : array-like of shape (n_samples, n_features)
        The states to choose the centres from.
    separations : array-like of shape (n_separations,)
        The separations: smallest distances that centres keep from each other.
    dimension : float, default=None
        Dimension of the manifold, for the expected slopes. None for the estimate of
        :func:`intrinsic_dimension` for `X`, rounded to a whole number.
    confidence : float, default=0.95
        The level of the confidence intervals of the slopes.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        kernel : list of str
            The names of the kernels, or their representations.
        beta : ndarray of shape (n_betas,)
            The scales.
        separation, n_centers, fill_distance, separation_distance : ndarray of shape \
(n_separations,)
            The separations, and the numbers and Euclidean distances of the centres.
        condition_number, smallest_eigenvalue, digits_lost : ndarray of shape \
(n_kernels, n_betas, n_separations)
            Of the Gram matrices. A condition number is infinite if the smallest
            eigenvalue is not above rounding error.
        slope : ndarray of shape (n_kernels, n_betas)
            Slopes of the logarithm of the condition number over the logarithm of the
            separation distance. They are fitted to the finer half of the finite
            condition numbers (three at least), because the order shows only where
            balls of radius `beta` hold many centres. NaN if there are fewer than three.
        slope_interval : ndarray of shape (n_kernels, n_betas, 2)
            Their confidence intervals, for independent normal scatter about a straight
            line.
        expected_slope : ndarray of shape (n_kernels,)
            The order ``-2 s`` of quasi-uniform centres (:func:`sobolev_rates`).
        dimension, confidence : float
            The dimension and the confidence that were used.

    Raises
    ------
    ValueError
        If a parameter is out of range, or a kernel takes no `beta`.

    See Also
    --------
    crowding_study : Two centres close together, the others as they were.
    sklearn_koopman.plotting.ConditioningDisplay : Draws the study.

    Notes
    -----
    The cost is that of the eigenvalues of one Gram matrix for each kernel, scale and
    separation: O(M^3) time and O(M^2) memory for M centres.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022, Section 4.1.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.diagnostics import conditioning_study
    >>> study = conditioning_study(
    ...     *(["wendland_c2", "wendland_c4"], [4.0]),
    ...     *(make_pendulum(4000).X, np.geomspace(0.3, 0.03, 6)),
    ... )
    >>> study.expected_slope
    array([-4., -6.])
    >>> bool((abs(study.slope[:, 0] - study.expected_slope) < 0.5).all())
    True
    """
    refuse_masked(X=X)
    X = check_array(X, dtype=np.float64, input_name="X")
    betas = check_positive(betas, "betas")
    separations = check_positive(separations, "separations")
    kernels = [kernels] if isinstance(kernels, str | Kernel) else list(kernels)
    _check_confidence(confidence)
    if not kernels:
        raise ValueError("kernels is empty; give a name or a kernel at least.")
    dimension = _whole_dimension(X) if dimension is None else dimension
    rates = [sobolev_rates(kernel, X.shape[1], dimension) for kernel in kernels]
    chosen, about = _choose(X, separations)
    q = np.array([separation_distance(centers) for centers in chosen])
    shape = (len(kernels), len(betas))
    condition, smallest = np.empty((2, *shape, len(separations)))
    slope, interval = np.empty(shape), np.empty((*shape, 2))
    for i, j in np.ndindex(shape):
        smallest[i, j], condition[i, j] = _conditions(kernels[i], betas[j], chosen)
        finite = np.flatnonzero(np.isfinite(condition[i, j]) & np.isfinite(q))
        finite = finite[np.argsort(q[finite])]
        finest = finite[: max(-(-len(finite) // 2), 3)]
        fit = _slope(q[finest], condition[i, j, finest], confidence, fewest=3)
        slope[i, j], interval[i, j] = fit
    return Bunch(
        kernel=[k if isinstance(k, str) else repr(k) for k in kernels],
        beta=betas,
        **about,
        separation_distance=q,
        condition_number=condition,
        smallest_eigenvalue=smallest,
        digits_lost=digits_lost(condition),
        slope=slope,
        slope_interval=interval,
        expected_slope=np.array([rate.condition_exponent for rate in rates]),
        dimension=dimension,
        confidence=confidence,
    )


def crowding_study(
    kernel: Any, X: Any, separations: Any, gaps: Any, *, beta: float | None = None
) -> Bunch:
    """Measure the smallest eigenvalue of a Gram matrix with one pair of close centres.

    Centres are chosen for a separation by Algorithm 1 of [1]_. One more centre is
    added, at a small gap from the first centre towards the sample nearest to it. The
    fill distance hardly changes, while the smallest eigenvalue falls with the gap
    (Figure 7 of [1]_).

    Parameters
    ----------
    kernel : str or Kernel
        The kernel.
    X : array-like of shape (n_samples, n_features)
        The states to choose the centres from.
    separations : array-like of shape (n_separations,)
        The separations of the other centres.
    gaps : array-like of shape (n_gaps,)
        Distances of the additional centre from the first one, in the unit of the
        states.
    beta : float, default=None
        Scale of the kernel.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        kernel : str
            The representation of the kernel.
        separation, n_centers, fill_distance : ndarray of shape (n_separations,)
            Of the centres without the additional one.
        gap : ndarray of shape (n_gaps,)
            The gaps.
        separation_distance, smallest_eigenvalue, condition_number : ndarray of shape \
(n_separations, n_gaps)
            With the additional centre.
        slope : ndarray of shape (n_separations,)
            Slopes of the logarithm of the smallest eigenvalue over the logarithm of the
            separation distance, as far as the close pair has the smallest distance of
            all. NaN for fewer than two gaps.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    See Also
    --------
    conditioning_study : All centres closer together.

    Notes
    -----
    The power 2 tau - d of the lower bound (:func:`smallest_eigenvalue`) is attained by
    many centres close together. For a single pair at a distance r the smallest
    eigenvalue is at most 1 - phi(r), where phi is the profile of the kernel. That falls
    like r for kernels with a cusp at zero, and like r^2 for all smoother ones. The
    other centres lower it by a factor.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022, Section 4.1.

    Examples
    --------
    >>> from sklearn_koopman.datasets import make_pendulum
    >>> from sklearn_koopman.diagnostics import crowding_study
    >>> study = crowding_study(
    ...     "matern12", make_pendulum().X, [0.5, 0.23], [0.02, 0.01], beta=1.0
    ... )
    >>> study.n_centers
    array([19, 37])
    >>> study.slope.round(1)  # the kernel has a cusp
    array([1., 1.])
    """
    refuse_masked(X=X)
    X = check_array(X, dtype=np.float64, input_name="X", ensure_min_samples=2)
    separations = check_positive(separations, "separations")
    gaps = check_positive(gaps, "gaps")
    distances = _lengths(X - X[0])
    if not distances.any():
        raise ValueError("X holds a single state, so that there is no direction.")
    nearest = np.where(distances > 0, distances, np.inf).argmin()
    direction = (X[nearest] - X[0]) / distances[nearest]
    chosen, about = _choose(X, separations)
    shape = (len(separations), len(gaps))
    q, smallest, condition, slope = (*np.empty((3, *shape)), np.empty(shape[0]))
    for i, centers in enumerate(chosen):
        crowded = [np.vstack([centers, X[0] + gap * direction]) for gap in gaps]
        q[i] = [separation_distance(points) for points in crowded]
        smallest[i], condition[i] = _conditions(kernel, beta, crowded)
        decisive = (smallest[i] > 0) & np.isclose(q[i], gaps / 2, rtol=1e-6, atol=0)
        slope[i], _ = _slope(q[i, decisive], smallest[i, decisive], 0.95)
    return Bunch(
        kernel=repr(as_kernel(kernel, beta, X.shape[1])),
        **about,
        gap=gaps,
        separation_distance=q,
        smallest_eigenvalue=smallest,
        condition_number=condition,
        slope=slope,
    )


def _choose(X: Array, separations: Array) -> tuple[list[Array], dict[str, Array]]:
    """Choose centres for each separation, and describe them for a study."""
    chosen = [X[sequential_centers(X, separation)] for separation in separations]
    return chosen, {
        "separation": separations,
        "n_centers": np.array([len(centers) for centers in chosen]),
        "fill_distance": np.array([fill_distance(centers, X) for centers in chosen]),
    }


def _conditions(kernel: Any, beta: Any, chosen: list[Array]) -> tuple[Array, Array]:
    """Return smallest eigenvalues and condition numbers for several sets of centres."""
    extremes = [extreme_eigenvalues(kernel, centers, beta) for centers in chosen]
    smallest, largest = np.transpose(extremes)
    infinite = np.full(len(chosen), np.inf)
    return smallest, np.divide(largest, smallest, out=infinite, where=smallest > 0)


def _check_confidence(confidence: Any) -> None:
    check_number(confidence, "confidence", positive=True)
    if confidence >= 1:
        raise ValueError(f"confidence must be below 1, got {confidence!r}.")


def _whole_dimension(X: Array) -> int:
    return int(np.clip(np.rint(intrinsic_dimension(X)[0]), 1, X.shape[1]))


def _slope(
    x: Array, y: Array, confidence: float, fewest: int = 2
) -> tuple[float, Array]:
    """Fit a straight line to logarithms; return its slope and the slope's interval."""
    if len(x) < fewest or np.ptp(x) == 0:
        return np.nan, np.full(2, np.nan)
    line = linregress(np.log(x), np.log(y))
    # Two points leave no degree of freedom, for which `ppf` is NaN.
    width = t.ppf((1 + confidence) / 2, len(x) - 2) * line.stderr
    return float(line.slope), line.slope + width * np.array([-1.0, 1.0])


def _separation_setting(estimator: Any) -> Callable[[float], dict[str, Any]]:
    """Return the function from a separation to the parameters that set it."""
    if hasattr(estimator, "refit"):
        raise ValueError(
            f"estimator={estimator!r} is a search, which would choose anew for each "
            "separation; fit it first, and give its best_estimator_."
        )
    values = estimator.get_params()
    nested = [name for name in values if f"__{name}".endswith("__centers__separation")]
    centers = [name for name in values if f"__{name}".endswith("__centers")]
    unset = [name for name in centers if values[name] is None]
    if len(nested) == 1:
        return lambda separation: {nested[0]: separation}
    if len(unset) == 1:
        return lambda separation: {unset[0]: SeparatedCenterSelector(separation)}
    raise ValueError(
        "estimator must have one parameter `centers` that is None or a selector with "
        f"a parameter `separation`, got {estimator!r}."
    )


def _outputs(y: Any, X: Any) -> Array:
    check_consistent_length(X, y)
    return np.asarray(check_array(y, ensure_2d=False, dtype=np.float64, input_name="y"))


def _lengths(vectors: Array) -> Array:
    """Return the lengths of rows; their absolute values if they are numbers."""
    return np.linalg.norm(vectors.reshape(len(vectors), -1), axis=1)


def above_rounding(h: Array, error: Array, size: float) -> Mask:
    """Decide which errors are above the level of rounding.

    Parameters
    ----------
    h : ndarray of shape (n_lines,)
        The fill distances.
    error : ndarray of shape (n_lines,)
        The errors.
    size : float
        The size of the outputs.

    Returns
    -------
    above : ndarray of shape (n_lines,), bool
        False for errors below 1e-12 of the size, and for errors below 1e-8 of it if
        neither they nor an error at a smaller fill distance are at most half of the
        smallest error at the larger fill distances.
    """
    order = np.argsort(-h, kind="stable")
    ordered = error[order]
    best_before = np.minimum.accumulate(np.append(np.inf, ordered))[:-1]
    best_after = np.minimum.accumulate(ordered[::-1])[::-1]  # this one included
    stalled = np.empty(len(h), dtype=bool)
    stalled[order] = (ordered < STALLED_ERROR * size) & (best_after > best_before / 2)
    return (error > ROUNDING_ERROR * size) & ~stalled
