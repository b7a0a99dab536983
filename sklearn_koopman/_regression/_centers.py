"""The centres of a regressor among its rows, and the outputs there."""

from typing import Any

import numpy as np

from .._matrices._sections import KernelSections, PrecomputedSections, Sections
from .._utils._rows import (
    AveragedOutputs,
    average_at,
    average_at_distance_zero,
    average_equal_rows,
)
from .._utils._typing import Array, Indices
from ..centers import choose_centers, rows_at_distance_zero
from ..kernels import is_isotropic


def resolve_centers(
    model: Any, kernel: Any, X: Array, y: Array, weights: Array | None, numbers: Indices
) -> tuple[Sections, Indices | None, AveragedOutputs | None]:
    """Return the sections of the centres, their rows, and the outputs there.

    Parameters
    ----------
    model : KoopmanKernelRegressor
        For its parameters.
    kernel : Kernel
        The kernel of the sections.
    X, y : ndarray of shape (n_samples, ...)
        The data.
    weights : ndarray of shape (n_samples,) or None
        The weights of the rows, if they have any.
    numbers : ndarray of shape (n_samples,)
        The numbers of the rows, for errors.

    Returns
    -------
    sections : Sections
        The kernel sections.
    rows : ndarray of shape (n_centers,) or None
        The rows that are centres, if that is known.
    averages : AveragedOutputs or None
        The means over the rows that equal each centre. None where outputs of the
        centres are not interpolated.

    Raises
    ------
    ValueError
        If there are no such centres, or if equal rows contradict each other.
    """
    interpolates = model.method == "interpolation"
    averages = AveragedOutputs.of(y.reshape(len(y), -1), weights)
    if model.centers is None:
        # Later batches need them, whatever becomes of y.
        averages = averages._replace(means=averages.means.copy())
        exact = interpolates and model.alpha == 0
        rows, averages = average_equal_rows(X, averages, exact, numbers)
        return KernelSections(kernel, X[rows]), rows, averages
    if isinstance(model.centers, str) and model.centers == "precomputed":
        if not is_isotropic(kernel):
            raise ValueError(
                f"kernel={kernel!r} does not depend on distances alone, which "
                "centers='precomputed' needs; pass the states and a selector."
            )
        rows = rows_at_distance_zero(X)
        sections = PrecomputedSections(kernel, np.arange(X.shape[1]), X[rows])
        if not interpolates:
            return sections, rows, None
        return sections, rows, average_at_distance_zero(rows, X, averages)
    points, found = choose_centers(
        model.centers, X, y, weights, among_rows=interpolates
    )
    if not interpolates:
        return KernelSections(kernel, points), found, None
    return KernelSections(kernel, points), found, average_at(points, X, averages)
