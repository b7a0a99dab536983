"""Growth of a fitted regressor by a batch of rows: functions of its state."""

import warnings
from typing import Any, NamedTuple

import numpy as np
from sklearn.base import clone

from .._linalg._fit import (
    REMEDY,
    Fit,
    check_rows_suffice,
    make_nugget,
    negligible_tolerance,
    scale_residuals,
    warn_of_weights,
)
from .._linalg._incremental import GrowingLeastSquares, GrowingSystem
from .._linalg._systems import DirectSystem
from .._matrices._polynomial import DEGREES
from .._matrices._sections import KernelSections, Sections
from .._utils._rows import (
    AveragedOutputs,
    average_at,
    average_equal_rows,
    spread,
    total_weight,
    warn_without_spread,
)
from .._utils._typing import Array, Indices
from ..centers import FEW_CENTERS, SeparatedCenterSelector, resolve_separation
from ..kernels import as_kernel
from ..solvers import ConjugateGradient
from ._estimate import Estimate, keep_averages


def check_can_grow(model: Any) -> bool:
    """Refuse regressors that cannot learn from further batches."""
    if isinstance(getattr(model, "solver_", model.solver), ConjugateGradient):
        raise ValueError(
            "partial_fit extends a Cholesky factor, which conjugate gradients do not "
            "have; fit with solver='pivoted_cholesky' from the first batch on."
        )
    centers, averages = model.centers, model.method == "least_squares"
    selects = isinstance(centers, SeparatedCenterSelector)
    if selects and averages:
        raise ValueError(
            "partial_fit with method='least_squares' needs centres that are known "
            "before the first batch. Select them first, by "
            "SeparatedCenterSelector.partial_fit over all batches, and give its "
            "cluster_centers_ as centers."
        )
    given = not hasattr(centers, "fit") and not isinstance(centers, str)
    sequential = selects and hasattr(centers, "partial_fit")
    if not (centers is None or sequential or (given and averages)):
        raise ValueError(
            "partial_fit adds centres with centers=None or a "
            "SeparatedCenterSelector(order='sequential'), and rows with "
            "method='least_squares' and an array of centres, got "
            f"centers={centers!r} and method={model.method!r}."
        )
    at_centers = averages and centers is not None
    if at_centers and hasattr(model, "dual_coef_") and not hasattr(model, "_growth"):
        raise ValueError(
            "partial_fit of least squares at chosen centres continues from the sums "
            "of earlier batches, which neither fit nor a copy or pickle keeps; call "
            "partial_fit from the first batch on."
        )
    return True


def check_batch(model: Any, system: DirectSystem, y: Array) -> None:
    """Refuse outputs and parameters that are not those of the first batch."""
    shape, known = model.dual_coef_.shape[1:], system.offered
    if y.shape[1:] != shape:
        raise ValueError(
            f"y has shape {y.shape}, but earlier batches had outputs of shape {shape}; "
            "give the same outputs in every batch."
        )
    n_features, scale = known.points.shape[1], _first_spread(model, known.points)
    kernel = as_kernel(model.kernel, model.beta, n_features, scale)
    same = kernel == known.kernel and DEGREES[model.trend] == system.degree
    if model.method == "interpolation" or model.centers is None:
        same = same and hasattr(model, "_averages")
    else:
        same = same and np.array_equal(model.centers, known.points)
    if not same:
        raise ValueError(
            "Parameters were changed since the first batch; set them back, or call fit "
            "to start anew."
        )


class Batch(NamedTuple):
    """Rows that count, of one call of partial_fit.

    Attributes
    ----------
    X : ndarray of shape (n_samples, n_features)
        The states.
    y : ndarray of shape (n_samples, n_outputs)
        Their outputs.
    weights : ndarray of shape (n_samples,) or None
        Their weights, if they have any.
    numbers : ndarray of shape (n_samples,)
        Their numbers, counted through all batches.
    """

    X: Array
    y: Array
    weights: Array | None
    numbers: Indices


def add_centers(
    system: DirectSystem,
    averages: AveragedOutputs,
    model: Any,
    batch: Batch,
    weight: float,
) -> Estimate:
    """Return an interpolant with the rows of a batch that become centres.

    These are all that are new, or those that the selector of the model adds to the
    centres so far. O(k M^2) operations for k new centres.

    Parameters
    ----------
    system : DirectSystem
        That of the batches before.
    averages : AveragedOutputs
        The outputs at its centres.
    model : KoopmanKernelRegressor
        For its parameters, and the numbers of the rows that are centres.
    batch : Batch
        The rows.
    weight : float
        The sum of the weights of all rows, with those of the batch.

    Returns
    -------
    estimate : Estimate
        The estimate; what was given stays as it is.

    Raises
    ------
    ValueError
        If equal rows contradict each other, or if there is no interpolant.
    """
    known, before = system.sections, averages.means
    points = np.vstack([known.points, batch.X])
    numbers = np.append(model.center_indices_, batch.numbers)
    averages = averages.joined(batch.y, batch.weights)
    fits = model.method == "least_squares"
    if model.centers is None:
        exact = model.alpha == 0 and not fits
        chosen, averages = average_equal_rows(points, averages, exact, numbers)
    else:
        selector = clone(model.centers)
        scale = _first_spread(model, known.points)
        selector.separation = resolve_separation(selector.separation, scale)
        selector.partial_fit(known.points).partial_fit(batch.X)
        chosen = selector.center_indices_
        averages = average_at(points[chosen], points, averages)
    sections = KernelSections(known.kernel, points[chosen])
    diagonal = sections.diagonal(sections.centers)
    nugget, u = make_nugget(model.alpha, averages.counts, diagonal), averages.means
    try:
        growing = system
        if not isinstance(growing, GrowingSystem):
            growing = GrowingSystem(system, before)
        system = growing.extended(sections, nugget, u)
        fit = system.interpolate(u)
    except np.linalg.LinAlgError:  # too few digits are left for an update
        system = DirectSystem(sections, nugget, DEGREES[model.trend], system.solver)
        negligible = negligible_tolerance(weight, model.alpha) if fits else 0.0
        fit = system.interpolate(u, negligible)
    averages = keep_averages(averages, fit, system.kept, sections.centers)
    rows = numbers[chosen][system.kept]
    if fits and model.alpha == 0:
        norms = np.sqrt(averages.scatter)
        noise_std = scale_residuals(norms, weight, fit.effective_dof)
        fit = fit._replace(noise_std=noise_std)
    return Estimate(system, fit, rows, averages)


def start_by_fit(model: Any, X: Any, y: Any, sample_weight: Any) -> Any:
    """Fit an interpolant to the first batch, and return the model.

    A first batch may be so short that it has one centre only.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", f".*{FEW_CENTERS}")
        model.fit(X, y, sample_weight)
    present = slice(None) if sample_weight is None else np.asarray(sample_weight) > 0
    warn_without_spread(model, np.asarray(X)[present])
    return model


def start_least_squares(
    sections: Sections, model: Any, batch: Batch
) -> tuple[GrowingLeastSquares, Estimate]:
    """Return least squares at given centres for the first batch.

    Raises
    ------
    ValueError
        If there is no estimate.
    """
    X, y, weights, _ = batch
    check_rows_suffice(len(X), sections.size, model.alpha)
    nugget, degree = np.zeros(sections.size), DEGREES[model.trend]
    solver = "cholesky" if model.solver == "cholesky" else "pivoted_cholesky"
    # What varies is what does among the centres: the first batch may be too short.
    system = DirectSystem(sections, nugget, degree, solver)

    def start() -> tuple[GrowingLeastSquares, Fit]:
        growth = GrowingLeastSquares.over(system, X, y, weights)
        return growth, growth.fit(X, model.alpha)

    negligible = negligible_tolerance(total_weight(X, weights), model.alpha)
    growth, fit = system.until_sound(start, negligible)
    warn_without_spread(model, X)
    warn_of_weights(weights, fit.effective_dof)
    return growth, Estimate(system, fit, None, None)


def add_rows(growth: GrowingLeastSquares, alpha: float, batch: Batch) -> Estimate:
    """Return least squares with the rows of a further batch.

    O(n M^2) operations for n rows.

    Raises
    ------
    ValueError
        If there is no estimate; the sums are then those of the batches before.
    """
    try:
        fit = growth.add(batch.X, batch.y, alpha, batch.weights)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"No estimate with these rows: {error}. {REMEDY}") from error
    return Estimate(growth.system, fit, None, None)


def _first_spread(model: Any, points: Array) -> float:
    """Return the spread of the first batch, which models of version 0.1 do not hold."""
    return getattr(model, "_spread", None) or spread(points)
