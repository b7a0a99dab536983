"""Studies of convergence and conditioning on the user's data."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgWarning
from scipy.stats import linregress, t
from sklearn.base import clone
from sklearn.gaussian_process.kernels import Kernel, WhiteKernel
from sklearn.utils import Bunch, check_array, check_consistent_length

from sklearn_koopman._selection import sequential_centers
from sklearn_koopman._utils._pipeline import transformed, unwrap
from sklearn_koopman._utils._typing import Array
from sklearn_koopman._utils._validation import check_number, check_positive
from sklearn_koopman.centers import SeparatedCenterSelector
from sklearn_koopman.diagnostics._conditioning import (
    condition_number,
    digits_lost,
    extreme_eigenvalues,
)
from sklearn_koopman.diagnostics._geometry import (
    fill_and_separation,
    fill_distance,
    intrinsic_dimension,
    separation_distance,
)
from sklearn_koopman.diagnostics._rates import sobolev_rates
from sklearn_koopman.kernels import as_kernel

# Errors below this, relative to the outputs, are rounding rather than approximation;
ROUNDING = 1e-12
# and so are those below this that no longer fall.
STALLING = 1e-8


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
        The separations.
    X_test : array-like of shape (n_test, n_features)
        States on the same manifold that are no centres.
    y_test : array-like of shape (n_test,) or (n_test, n_outputs)
        Their outputs.
    metric : {"euclidean", "geodesic"}, default="euclidean"
        Fill and separation distances through the space, or along the manifold (see
        :func:`fill_distance`). For small ones the slopes are the same.
    dimension : float, default=None
        Dimension of the manifold, for the guaranteed rate. None rounds that which
        :func:`intrinsic_dimension` gives for `X` to a whole number.
    confidence : float, default=0.95
        Level of the intervals of the slopes.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        separation, n_centers, fill_distance, separation_distance, sup_error, \
rms_error, condition_number : ndarray of shape (n_separations,)
            The table, in the order of `separations`. Distances are in the units that
            the kernel sees (behind the steps of a pipeline); the fill distance is that
            with respect to all states given. Errors of several outputs are lengths of
            vectors. The matrix is the one that is solved with, `alpha` included.
        used : ndarray of shape (n_separations,), bool
            Which lines the slopes are fitted to: those with other centres than the
            line before, no centre dropped for numerical dependence, and an error above
            rounding. That is above 1e-12 of the outputs and, once below 1e-8 of them,
            yet to fall to half of the least error so far.
        slope, rms_slope : float
            Slopes of the logarithms of the errors over that of the fill distance, by
            least squares; NaN from fewer than two lines.
        slope_interval, rms_slope_interval : ndarray of shape (2,)
            Their intervals of confidence, for scatter about a straight line.
        guaranteed_slope : float
            The exponent of the sup error that :func:`sobolev_rates` guarantees; NaN
            where it does not apply, which is also the case for least squares,
            ``alpha > 0`` or a kernel with a noise term.
        rates : :class:`~sklearn.utils.Bunch`
            All that :func:`sobolev_rates` says.
        dimension, confidence : float
            As used.
        kernel : str
            The kernel.

    Raises
    ------
    ValueError
        If the estimator has no `centers` that separations apply to, or other
        parameters are out of range.

    See Also
    --------
    conditioning_study : The price of small separations.
    sklearn_koopman.plotting.ConvergenceDisplay : Draws the study.

    Notes
    -----
    Take separations from a dozen centres on to as fine as the samples allow: the
    asymptotic slope shows neither with centres farther apart than `beta`, nor with
    nearly all samples as centres.

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
    truth, learned = _outputs(y_test, X_test), _outputs(y, X)
    if truth.shape[1:] != learned.shape[1:]:
        raise ValueError(
            f"y_test has the shape {truth.shape}, which does not fit that of y, "
            f"{learned.shape}."
        )
    separations = check_positive(separations, "separations")
    _check_confidence(confidence)
    parameter = _separation_parameter(estimator)
    rates: Any = None
    warned = False
    lines: list[dict[str, Any]] = []
    previous: Any = None
    for separation in separations:
        model = clone(estimator).set_params(**parameter(separation))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            model.fit(X, y)
        dropped = False
        for warning in caught:
            if issubclass(warning.category, LinAlgWarning):
                dropped = True
            else:
                warnings.warn(warning.message, warning.category, stacklevel=2)
        final, front = unwrap(model)
        if not hasattr(final, "centers_"):
            raise ValueError(
                "estimator must be a KoopmanKernelRegressor, or a pipeline that ends "
                f"in one, that is fitted to states and not to distances, got {final!r}."
            )
        error = _lengths(np.reshape(model.predict(X_test), truth.shape) - truth)
        states, test = (np.asarray(transformed(front, x)) for x in (X, X_test))
        if rates is None:  # what is wrong with them should not cost all fits
            if dimension is None:
                dimension = _whole_dimension(states)
            rates = sobolev_rates(final.kernel_, states.shape[1], dimension)
        exact = final.method == "interpolation"
        centers, nugget = final.centers_, final.alpha if exact else 0.0
        fill, apart, message = fill_and_separation(centers, states, test, metric)
        if message and not warned:
            warnings.warn(message, UserWarning, stacklevel=2)
            warned = True
        again = previous is not None and np.array_equal(previous, centers)
        previous = centers
        lines.append(
            {
                "separation": separation,
                "n_centers": len(centers),
                "fill_distance": fill,
                "separation_distance": apart,
                "sup_error": float(error.max()),
                "rms_error": float(np.sqrt(np.mean(error**2))),
                "condition_number": condition_number(
                    final.kernel_, centers, alpha=nugget
                ),
                "used": not (dropped or again),
            }
        )
    table = {name: np.array([line[name] for line in lines]) for name in lines[0]}
    used = table["used"]
    used &= _above_rounding(
        table["fill_distance"], table["sup_error"], float(np.abs(truth).max())
    )
    noisy = [isinstance(k, WhiteKernel) for k in final.kernel_.get_params().values()]
    exact = exact and final.alpha == 0 and not any(noisy)
    fits: dict[str, Any] = {}
    for name, errors in (("slope", "sup_error"), ("rms_slope", "rms_error")):
        fits[name], fits[f"{name}_interval"] = _slope(
            table["fill_distance"][used], table[errors][used], confidence
        )
    return Bunch(
        **table,
        **fits,
        guaranteed_slope=rates.sup_exponent if exact else np.nan,
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
    """Measure what small separations cost in digits, for several kernels and scales.

    Centres are chosen by Algorithm 1 of [1]_ (whose Figures 5 and 6 these are).

    Parameters
    ----------
    kernels : str, Kernel or sequence of them
        The kernels.
    betas : array-like of shape (n_betas,)
        Their scales.
    X : array-like of shape (n_samples, n_features)
        The states to choose the centres from.
    separations : array-like of shape (n_separations,)
        The separations.
    dimension : float, default=None
        Dimension of the manifold, for the expected slopes. None rounds that which
        :func:`intrinsic_dimension` gives for `X` to a whole number.
    confidence : float, default=0.95
        Level of the intervals of the slopes.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        kernel : list of str
            The kernels' names, or what they are.
        beta : ndarray of shape (n_betas,)
            The scales.
        separation, n_centers, fill_distance, separation_distance : ndarray of shape \
(n_separations,)
            The centres, in Euclidean distances.
        condition_number, smallest_eigenvalue, digits_lost : ndarray of shape \
(n_kernels, n_betas, n_separations)
            Of the Gram matrices; see :func:`condition_number` for what is infinite.
        slope : ndarray of shape (n_kernels, n_betas)
            Slopes of the logarithm of the condition number over that of the
            separation distance, from the finer half of the finite ones (three at
            least), since the order shows only where balls of radius `beta` hold many
            centres. NaN if there are fewer than three.
        slope_interval : ndarray of shape (n_kernels, n_betas, 2)
            Their intervals of confidence, for scatter about a straight line.
        expected_slope : ndarray of shape (n_kernels,)
            The order ``-2 s`` of quasi-uniform centres (:func:`sobolev_rates`).
        dimension, confidence : float
            As used.

    Raises
    ------
    ValueError
        If a parameter is out of range, or a kernel takes no `beta`.

    See Also
    --------
    crowding_study : Two centres close together, the others as they were.
    sklearn_koopman.plotting.ConditioningDisplay : Draws the study.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds", Section 4.1.

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
    X = check_array(X, dtype=np.float64, input_name="X")
    betas = check_positive(betas, "betas")
    separations = check_positive(separations, "separations")
    kernels = [kernels] if isinstance(kernels, str | Kernel) else list(kernels)
    _check_confidence(confidence)
    if not kernels:
        raise ValueError("kernels is empty; give a name or a kernel at least.")
    if dimension is None:
        dimension = _whole_dimension(X)
    expected = [
        sobolev_rates(kernel, X.shape[1], dimension).condition_exponent
        for kernel in kernels
    ]
    chosen = [X[sequential_centers(X, separation)] for separation in separations]
    q = np.array([separation_distance(centers) for centers in chosen])
    shape = (len(kernels), len(betas), len(separations))
    smallest, largest = np.empty(shape), np.empty(shape)
    for i, kernel in enumerate(kernels):
        for j, beta in enumerate(betas):
            for k, centers in enumerate(chosen):
                smallest[i, j, k], largest[i, j, k] = extreme_eigenvalues(
                    kernel, centers, beta
                )
    condition = _ratio(largest, smallest)
    slope, interval = np.empty(shape[:2]), np.empty((*shape[:2], 2))
    for i in range(len(kernels)):
        for j in range(len(betas)):
            finite = np.flatnonzero(np.isfinite(condition[i, j]) & np.isfinite(q))
            finite = finite[np.argsort(q[finite])]
            finest = finite[: max(-(-len(finite) // 2), 3)]
            slope[i, j], interval[i, j] = _slope(
                q[finest], condition[i, j, finest], confidence, fewest=3
            )
    return Bunch(
        kernel=[k if isinstance(k, str) else repr(k) for k in kernels],
        beta=betas,
        separation=separations,
        n_centers=np.array([len(centers) for centers in chosen]),
        fill_distance=np.array([fill_distance(centers, X) for centers in chosen]),
        separation_distance=q,
        condition_number=condition,
        smallest_eigenvalue=smallest,
        digits_lost=digits_lost(condition),
        slope=slope,
        slope_interval=interval,
        expected_slope=np.array(expected),
        dimension=dimension,
        confidence=confidence,
    )


def crowding_study(
    kernel: Any,
    X: Any,
    separations: Any,
    gaps: Any,
    *,
    beta: float | None = None,
) -> Bunch:
    """Measure what one pair of crowded centres costs, at a fixed fill distance.

    To the centres chosen for a separation by Algorithm 1 of [1]_ one more is added, at
    a small gap from the first centre towards the sample nearest to it. The fill
    distance hardly changes; the smallest eigenvalue falls with the gap (Figure 7
    of [1]_).

    Parameters
    ----------
    kernel : str or Kernel
        The kernel.
    X : array-like of shape (n_samples, n_features)
        The states to choose the centres from.
    separations : array-like of shape (n_separations,)
        The separations, each of which gives a fill distance.
    gaps : array-like of shape (n_gaps,)
        Distances of the additional centre from the first one.
    beta : float, default=None
        Scale of the kernel.

    Returns
    -------
    study : :class:`~sklearn.utils.Bunch`
        With the attributes

        kernel : str
            The kernel's name, or what it is.
        separation, n_centers, fill_distance : ndarray of shape (n_separations,)
            Of the centres before one is added.
        gap : ndarray of shape (n_gaps,)
            The gaps.
        separation_distance, smallest_eigenvalue, condition_number : ndarray of shape \
(n_separations, n_gaps)
            With the additional centre.
        slope : ndarray of shape (n_separations,)
            Slopes of the logarithm of the smallest eigenvalue over that of the
            separation distance, where the additional centre decides on it.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    See Also
    --------
    conditioning_study : All centres closer together.

    Notes
    -----
    The power 2 tau - d of the lower bound (:func:`smallest_eigenvalue`) is that of
    many centres close together. A single pair at a distance r leaves at most the
    eigenvalue 1 - phi(r), which falls like r for kernels that have a cusp, and like
    r^2 for all that are smoother; the other centres lower it by a factor.

    References
    ----------
    .. [1] Powell, Liu, Guo, Parachuri and Kurdila, "Koopman Methods for Estimation
       of Animal Motions over Unknown Submanifolds", Section 4.1.

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
    X = check_array(X, dtype=np.float64, input_name="X", ensure_min_samples=2)
    separations, gaps = (
        check_positive(separations, "separations"),
        check_positive(gaps, "gaps"),
    )
    distances = _lengths(X - X[0])
    if not distances.any():
        raise ValueError("X holds a single state, so that there is no direction.")
    nearest = np.where(distances > 0, distances, np.inf).argmin()
    direction = (X[nearest] - X[0]) / distances[nearest]
    shape = (len(separations), len(gaps))
    q, smallest, largest = np.empty(shape), np.empty(shape), np.empty(shape)
    n_centers, fill = [], []
    for i, separation in enumerate(separations):
        centers = X[sequential_centers(X, separation)]
        n_centers.append(len(centers))
        fill.append(fill_distance(centers, X))
        for j, gap in enumerate(gaps):
            crowded = np.vstack([centers, X[0] + gap * direction])
            q[i, j] = separation_distance(crowded)
            smallest[i, j], largest[i, j] = extreme_eigenvalues(kernel, crowded, beta)
    decisive = (smallest > 0) & np.isclose(q, gaps / 2, rtol=1e-6, atol=0)
    slope = [
        _slope(q_i[use], smallest_i[use], 0.95)[0]
        for q_i, smallest_i, use in zip(q, smallest, decisive, strict=True)
    ]
    return Bunch(
        kernel=repr(as_kernel(kernel, beta, X.shape[1])),
        separation=separations,
        n_centers=np.array(n_centers),
        fill_distance=np.array(fill),
        gap=gaps,
        separation_distance=q,
        smallest_eigenvalue=smallest,
        condition_number=_ratio(largest, smallest),
        slope=np.array(slope),
    )


def _check_confidence(confidence: Any) -> None:
    check_number(confidence, "confidence", positive=True)
    if confidence >= 1:
        raise ValueError(f"confidence must be below 1, got {confidence!r}.")


def _ratio(largest: Array, smallest: Array) -> Array:
    infinite = np.full(smallest.shape, np.inf)
    return np.divide(largest, smallest, out=infinite, where=smallest > 0)


def _whole_dimension(X: Array) -> int:
    try:
        estimate, _ = intrinsic_dimension(X)
    except ValueError as error:
        raise ValueError(f"{error} Give the dimension.") from error
    return int(np.clip(np.rint(estimate), 1, X.shape[1]))


def _slope(
    x: Array, y: Array, confidence: float, fewest: int = 2
) -> tuple[float, Array]:
    """Fit a straight line to logarithms; return its slope and the interval of it."""
    nothing = np.full(2, np.nan)
    if len(x) < fewest or np.ptp(x) == 0:
        return np.nan, nothing
    line = linregress(np.log(x), np.log(y))
    if len(x) == 2:
        return float(line.slope), nothing
    width = t.ppf((1 + confidence) / 2, len(x) - 2) * line.stderr
    return float(line.slope), line.slope + width * np.array([-1.0, 1.0])


def _separation_parameter(estimator: Any) -> Any:
    """Return the function from a separation to the parameters that set it."""
    if hasattr(estimator, "refit"):
        raise ValueError(
            "estimator must not be a search, which would choose anew for each "
            "separation; fit it first, and give its best_estimator_."
        )
    parameters = estimator.get_params()
    names = [
        name
        for name in parameters
        if name.split("__")[-2:] == ["centers", "separation"]
    ]
    if len(names) == 1:
        return lambda separation: {names[0]: separation}
    names = [
        name
        for name, value in parameters.items()
        if name.split("__")[-1] == "centers" and value is None
    ]
    if len(names) == 1:
        return lambda separation: {names[0]: SeparatedCenterSelector(separation)}
    raise ValueError(
        "estimator must have one parameter `centers` that is None or a selector with "
        f"a parameter `separation`, got {estimator!r}."
    )


def _outputs(y: Any, X: Any) -> Array:
    check_consistent_length(X, y)
    y = check_array(y, ensure_2d=False, dtype=np.float64, input_name="y")
    return np.asarray(y, dtype=np.float64)


def _lengths(vectors: Array) -> Array:
    """Return the lengths of rows; their absolute values if they are numbers."""
    return np.linalg.norm(vectors.reshape(len(vectors), -1), axis=1)


def _above_rounding(h: Array, error: Array, size: float) -> NDArray[np.bool_]:
    """Tell which errors are those of the approximation."""
    order = np.argsort(-h, kind="stable")
    sorted_ = error[order]
    before = np.minimum.accumulate(np.append(np.inf, sorted_))[:-1]
    yet_to_come = np.minimum.accumulate(sorted_[::-1])[::-1]
    stalled = np.empty(len(h), dtype=bool)
    stalled[order] = (sorted_ < STALLING * size) & (yet_to_come > before / 2)
    return (error > ROUNDING * size) & ~stalled
