"""Estimates at given centres: which solver, and what it says if it fails."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
from scipy.linalg import LinAlgWarning
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning

from sklearn_koopman._linalg import _direct, _iterative
from sklearn_koopman._linalg._cholesky import NativeBasis
from sklearn_koopman._linalg._conjugate_gradient import Converged
from sklearn_koopman._linalg._direct import Solution
from sklearn_koopman._linalg._incremental import GrowingRegression
from sklearn_koopman._linalg._least_squares import too_few_rows
from sklearn_koopman._matrices._polynomial import PolynomialTrend
from sklearn_koopman._matrices._sections import KernelSections, Sections
from sklearn_koopman._utils._typing import Array, Indices
from sklearn_koopman.solvers import ConjugateGradient

REMEDY = (
    "Choose centres with a larger separation, lower beta, raise alpha, or take a less "
    "smooth kernel."
)


@dataclass(frozen=True)
class Estimate:
    """An estimate, and how it was found."""

    solution: Solution[Any]
    solver: str | ConjugateGradient
    converged: Converged | None  # only with conjugate gradients


def interpolated(
    sections: Sections,
    points: Array,
    nugget: Array,
    u: Array,
    degree: int | None,
    solver: str | ConjugateGradient,
    n_jobs: int | None,
    negligible: float = 0.0,
) -> Estimate:
    """Interpolate u at the centres.

    A `negligible` part of a section may be left out without a warning.

    Raises
    ------
    ValueError
        If there is no such estimate.

    Warns
    -----
    LinAlgWarning
        If dependent centres were left out.
    ConvergenceWarning
        If conjugate gradients did not come to their tolerance.
    """
    solver = _chosen(solver, sections, points)
    with _explained(sections.kernel, len(points)):
        if isinstance(solver, ConjugateGradient):
            basis = _implicit(sections, points, nugget, degree, points, solver, n_jobs)
            solution, converged = _iterative.interpolate(basis, u)
            _warn_not_converged(sections.kernel, len(points), solver, converged)
            return Estimate(solution, solver, converged)
        found, tolerance = _direct.solve(
            sections,
            points,
            nugget,
            _direct.interpolation(points, u),
            degree,
            points,
            drop_dependent=solver == "pivoted_cholesky",
        )
    if tolerance > negligible:
        _warn_left_out(sections.kernel, len(points), len(found.kept))
    return Estimate(found, solver, None)


def regressed(
    sections: Sections,
    points: Array,
    X: Array,
    y: Array,
    alpha: float,
    degree: int | None,
    solver: str | ConjugateGradient,
    n_jobs: int | None,
) -> Estimate:
    """Fit y on all rows by least squares; raises and warns as `interpolated`."""
    if alpha == 0 and len(X) < len(points):
        raise too_few_rows(len(X), len(points))
    solver = _chosen(solver, sections, points)
    nugget = np.zeros(len(points))
    with _explained(sections.kernel, len(points)):
        if isinstance(solver, ConjugateGradient):
            basis = _implicit(sections, points, nugget, degree, X, solver, n_jobs)
            solution, converged = _iterative.regress(basis, X, y, alpha, n_jobs)
            _warn_not_converged(sections.kernel, len(points), solver, converged)
            return Estimate(solution, solver, converged)
        found, tolerance = _direct.solve(
            sections,
            points,
            nugget,
            _direct.regression(X, y, alpha, n_jobs),
            degree,
            X,
            drop_dependent=solver == "pivoted_cholesky",
        )
    if tolerance > negligible_tolerance(len(X), alpha):
        _warn_left_out(sections.kernel, len(points), len(found.kept))
    return Estimate(found, solver, None)


def accumulated(
    sections: Sections,
    points: Array,
    batches: list[tuple[Array, Array]],
    alpha: float,
    degree: int | None,
    solver: str,
) -> tuple[GrowingRegression, Solution[NativeBasis], Array]:
    """Fit all batches by least squares, so that more can be added.

    Returns
    -------
    growth : GrowingRegression
        The sums.
    solution : Solution
        The estimate.
    residual : ndarray of shape (n_outputs,)
        The norms of its residuals.
    """
    X = np.vstack([rows for rows, _ in batches])
    if alpha == 0 and len(X) < len(points):
        raise too_few_rows(len(X), len(points))
    results: list[tuple[GrowingRegression, Array]] = []

    def rule(basis: NativeBasis, kept: Indices) -> Solution[NativeBasis]:
        growth = GrowingRegression.of(basis, kept, batches[0][1].shape[1])
        for batch in batches:
            growth.add(*batch)
        solution, residual = growth.solution(alpha, X)
        results.append((growth, residual))
        return solution

    with _explained(sections.kernel, len(points)):
        solution, tolerance = _direct.solve(
            sections,
            points,
            np.zeros(len(points)),
            rule,
            degree,
            X,
            drop_dependent=solver != "cholesky",
        )
    growth, residual = results[-1]
    if tolerance > negligible_tolerance(len(X), alpha):
        _warn_left_out(sections.kernel, len(points), len(growth.kept))
    return growth, solution, residual


def negligible_tolerance(n_rows: int, alpha: float) -> float:
    """Return up to which tolerance leaving out centres does not matter to a fit.

    By |<r, e>| <= sqrt(n) |r| sup|e|, a section that the others reproduce to
    sqrt(tolerance) moves a regularised fit by about n tolerance / alpha of its
    residuals at the most.
    """
    return 1e-5 * alpha / n_rows


def _chosen(
    solver: str | ConjugateGradient, sections: Sections, points: Array
) -> str | ConjugateGradient:
    if isinstance(solver, ConjugateGradient):
        return clone(solver)
    if solver != "auto":
        return solver
    large = _iterative.is_large(sections, points)
    return ConjugateGradient() if large else "pivoted_cholesky"


def _implicit(
    sections: Sections,
    points: Array,
    nugget: Array,
    degree: int | None,
    rows: Array,
    solver: ConjugateGradient,
    n_jobs: int | None,
) -> _iterative.ImplicitBasis:
    assert isinstance(sections, KernelSections)
    tail = None if degree is None else PolynomialTrend.on(points, degree, rows)
    return _iterative.ImplicitBasis.of(sections, nugget, tail, solver, n_jobs)


@contextmanager
def _explained(kernel: Any, n_centers: int) -> Iterator[None]:
    """Say in errors of the linear algebra which kernel they are about."""
    try:
        yield
    except _direct.UnsuitableKernelError as error:
        raise ValueError(f"kernel={kernel!r} {error}.") from error
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"No estimate for kernel={kernel!r} on {n_centers} centres: {error}. "
            f"{REMEDY}"
        ) from error


def _frames_in_here() -> int:
    """Return the stacklevel of the line that called this package."""
    frame: FrameType | None = sys._getframe()
    level = 0
    while frame is not None and frame.f_globals["__name__"].startswith(__package__):
        frame, level = frame.f_back, level + 1
    return level


def _warn_left_out(kernel: Any, n_centers: int, n_kept: int) -> None:
    """Warn that centres were left out, if any were."""
    if n_kept < n_centers:
        warnings.warn(
            f"The Gram matrix of kernel={kernel!r} on {n_centers} centres is "
            f"numerically singular; {n_centers - n_kept} centres that depend on "
            f"the others were left out. {REMEDY}",
            LinAlgWarning,
            stacklevel=_frames_in_here(),
        )


def _warn_not_converged(
    kernel: Any, n_centers: int, solver: ConjugateGradient, found: Converged
) -> None:
    if found.residual > solver.tol:
        advice = (
            "Raise max_iter, rank, n_neighbors or tol of the solver."
            if found.n_iter >= solver.max_iter
            else "More of them did not help, as rounding allows no less: raise tol."
        )
        warnings.warn(
            f"Conjugate gradients for kernel={kernel!r} on {n_centers} centres ended "
            f"after {found.n_iter} iterations with a relative residual of "
            f"{found.residual:.1e}, above tol={solver.tol:.1e}. {advice} {REMEDY}",
            ConvergenceWarning,
            stacklevel=_frames_in_here(),
        )
