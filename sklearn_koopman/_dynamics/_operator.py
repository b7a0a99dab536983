"""Koopman operators on finite spaces of functions: matrices, spectra and powers.

Everything is in coordinates of a `NativeBasis`, whose functions are orthonormal in the native space of the kernel: there the matrix of the
operator is as well conditioned as the operator itself, while the matrix K^-1 K+ that
acts on coefficients of the kernel sections inherits the condition number of K.

Eigenvectors of a real matrix are kept as LAPACK gives them, "packed" into real columns:
one for a real eigenvalue, and the real and the imaginary part of the first of a
conjugate pair, side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import (
    dgecon,
    dgeev,
    dgeev_lwork,
    dgetrf,
    dgetrs,
)
from scipy.optimize import linear_sum_assignment
from sklearn.utils import gen_batches

from sklearn_koopman._linalg._cholesky import NativeBasis, solve_triangular
from sklearn_koopman._linalg._direct import evaluate
from sklearn_koopman._linalg._least_squares import least_squares
from sklearn_koopman._matrices._sections import KernelSections
from sklearn_koopman._regression._error_bound import left_out_precision
from sklearn_koopman._utils._typing import Array, Complex, Indices

# Coordinates beyond this are of a diverging forecast, and soon beyond all numbers.
HUGE = 1e100
# Entries of the arrays that are held at once.
BLOCK = 2**22


@dataclass(frozen=True)
class Eigenfunctions:
    """Eigenfunctions of an operator, by their packed coefficients."""

    eigenvalues: Complex  # (n_modes,), the one with positive imaginary part first
    dual: Array  # (M, n_modes)
    trend: Array  # (n_terms, n_modes)

    def take(self, chosen: Indices) -> Eigenfunctions:
        """Return some of them; conjugate pairs must stay together."""
        return Eigenfunctions(
            self.eigenvalues[chosen], self.dual[:, chosen], self.trend[:, chosen]
        )

    def scale(self, factors: Complex) -> Eigenfunctions:
        """Multiply every eigenfunction by a number, conjugate ones by conjugates."""
        dual, trend = (
            pack(unpack(values, self.eigenvalues) * factors, self.eigenvalues)
            for values in (self.dual, self.trend)
        )
        return Eigenfunctions(self.eigenvalues, dual, trend)


def pack(values: Complex, eigenvalues: Complex) -> Array:
    """Store columns that belong to eigenvalues as real ones."""
    return np.where(eigenvalues.imag < 0, -values.imag, values.real)


def unpack(values: Array, eigenvalues: Complex) -> Complex:
    """Turn packed columns into complex ones."""
    unpacked = values.astype(np.complex128)
    first = np.flatnonzero(eigenvalues.imag > 0)
    unpacked[:, first] += 1j * values[:, first + 1]
    unpacked[:, first + 1] = unpacked[:, first].conj()
    return unpacked


def pack_weights(weights: Complex, eigenvalues: Complex) -> Array:
    """Weights, one a row, that give packed functions the same real sum."""
    lam = eigenvalues[:, np.newaxis]
    return np.where(
        lam.imag == 0,
        weights.real,
        2 * np.where(lam.imag > 0, weights.real, weights.imag),
    )


def unpack_weights(weights: Array, eigenvalues: Complex) -> Complex:
    """Undo `pack_weights`."""
    unpacked = weights.astype(np.complex128)
    first = np.flatnonzero(eigenvalues.imag > 0)
    unpacked[first] -= 1j * weights[first + 1]
    unpacked[first] /= 2
    unpacked[first + 1] = unpacked[first].conj()
    return unpacked


def regressed(
    basis: NativeBasis,
    X: Array,
    values: Callable[[slice], Array],
    n_values: int,
    alpha: float,
) -> Array:
    """Coordinates of the functions fitted to values on all rows by least squares."""
    z, b, _ = least_squares(basis, X, values, n_values, alpha)
    return basis.coordinates(z, b)


def interpolated_operator(
    basis: NativeBasis, X_next: Array, targets: Array, rows: Indices, group: Indices
) -> tuple[Array, Array]:
    """Interpolate what the operator makes of the basis, and the targets, at centres.

    The centres are the given `rows`, and take the mean over all rows of their group.
    Returns the matrix of the operator and the coordinates of the targets.
    """
    M = len(rows)
    lot = np.full(group.max() + 1, -1)
    lot[group[rows]] = np.arange(M)
    counts = np.bincount(group)[group[rows]]
    sources = rows if counts.sum() == M else np.flatnonzero(lot[group] >= 0)
    values = np.zeros((M, M + targets.shape[1]))
    for batch in gen_batches(len(sources), max(BLOCK // M, M)):
        batch_rows = sources[batch]
        functions = basis.functions(X_next[batch_rows])[:M].T
        np.add.at(
            values, lot[group[batch_rows]], np.hstack([functions, targets[batch_rows]])
        )
    values /= counts[:, np.newaxis]
    image = solve_triangular(basis.lower, values)
    return image[:, :M], image[:, M:]


def regressed_operator(
    basis: NativeBasis, X: Array, X_next: Array, targets: Array, alpha: float
) -> tuple[Array, Array]:
    """Fit what the operator makes of the basis, and the targets, on all rows."""
    n = len(basis.lower) + (0 if basis.tail is None else basis.tail.unseen.shape[1])

    def values(rows: slice) -> Array:
        return np.hstack([basis.functions(X_next[rows]).T, targets[rows]])

    image = regressed(basis, X, values, n + targets.shape[1], alpha)
    return image[:, :n], image[:, n:]


def spectrum(matrix: Array) -> tuple[Complex, Array]:
    """Return the eigenvalues of a real matrix and its packed eigenvectors.

    They have unit length, and their entry of largest modulus is positive.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("the operator is not finite")
    size, _ = dgeev_lwork(len(matrix), compute_vl=0)
    real, imaginary, _, vectors, info = dgeev(matrix, compute_vl=0, lwork=int(size))
    if info != 0:
        raise np.linalg.LinAlgError("the eigenvalues of the operator did not converge")
    eigenvalues = real + 1j * imaginary
    unpacked = unpack(vectors, eigenvalues)
    largest = unpacked[np.abs(unpacked).argmax(axis=0), np.arange(len(matrix))]
    return eigenvalues, pack(unpacked * (np.abs(largest) / largest), eigenvalues)


def match(eigenvalues: Complex, others: Complex) -> Indices:
    """Find given eigenvalues among others that are the same up to rounding."""
    wanted, offered = (np.flatnonzero(e.imag >= 0) for e in (eigenvalues, others))
    if len(wanted) != len(offered):
        raise np.linalg.LinAlgError(
            "this machine finds other eigenvalues than the one that the model was "
            "fitted on; fit again, or with n_modes, which stores the eigenfunctions"
        )
    distance = np.abs(eigenvalues[wanted, np.newaxis] - others[offered])
    found = offered[linear_sum_assignment(distance)[1]]
    order = np.empty(len(eigenvalues), dtype=np.intp)
    order[wanted] = found
    first = eigenvalues[wanted].imag > 0
    order[wanted[first] + 1] = found[first] + 1
    return order


def expansion(
    vectors: Array, eigenvalues: Complex, targets: Array
) -> tuple[Complex, float]:
    """Expand targets, one a column, in eigenvectors given by their packed columns.

    Returns
    -------
    weights : ndarray of shape (n_modes, n_targets)
        Of smallest norm among the best ones, where the eigenvectors are dependent, as
        those of a defective operator are.
    rcond : float
        Estimate of the reciprocal condition number of the eigenvectors.
    """
    lu, pivots, _ = dgetrf(vectors)
    rcond, _ = dgecon(lu, np.linalg.norm(vectors, 1))
    dependent = 10 * len(vectors) * np.finfo(float).eps
    if rcond > dependent:
        weights, _ = dgetrs(lu, pivots, targets)
    else:
        weights = lstsq(vectors, targets, cond=dependent, lapack_driver="gelsy")[0]
    return unpack_weights(weights, eigenvalues), float(rcond)


def left_out_errors(basis: NativeBasis, dual: Array) -> Array:
    """Errors at each centre of the interpolants made without it, in closed form.

    Centres without which no interpolant is determined are passed over.
    """
    left = left_out_precision(basis)
    determined = np.isfinite(left)
    return np.asarray(dual[determined] / left[determined, np.newaxis])


def measure(
    basis: NativeBasis,
    eigenfunctions: Eigenfunctions,
    X: Array,
    X_next: Array,
    counted: NDArray[np.bool_],
) -> tuple[Array, Array, Array]:
    """Measure eigenfunctions on pairs of states.

    Returns
    -------
    size : ndarray of shape (n_modes,)
        Sum of squares of phi over all rows.
    counted_size : ndarray of shape (n_modes,)
        The same over the rows that count.
    defect : ndarray of shape (n_modes,)
        Sum of squares of phi(x_next) - lambda phi(x) over the rows that count.
    """
    lam = eigenfunctions.eigenvalues
    partner = np.arange(len(lam)) + np.sign(lam.imag).astype(np.intp)
    size, counted_size, defect = np.zeros((3, len(lam)))
    dual, trend = eigenfunctions.dual, eigenfunctions.trend
    for rows in gen_batches(len(X), max(BLOCK // len(lam), 1)):
        now = evaluate(basis.sections, basis.tail, X[rows], dual, trend)
        size += np.einsum("ij,ij->j", now, now)
        kept = counted[rows]
        if not kept.any():
            continue
        now, x = now[kept], X_next[rows][kept]
        then = evaluate(basis.sections, basis.tail, x, dual, trend)
        # Packed: lambda (a + ib) has the parts Re a - Im b and Re b + Im a.
        then -= now * lam.real
        then += now[:, partner] * lam.imag
        defect += np.einsum("ij,ij->j", then, then)
        counted_size += np.einsum("ij,ij->j", now, now)
    pair = partner != np.arange(len(lam))
    for sums in (size, counted_size, defect):
        sums[pair] += sums[partner][pair]
    return size, counted_size, defect


@dataclass(frozen=True)
class Analysis:
    """Eigenfunctions of an operator, the most trustworthy first."""

    eigenfunctions: Eigenfunctions
    factors: Complex  # of each eigenfunction over the one that `spectrum` returns
    residuals: Array  # (n_modes,)
    weights: Complex  # (n_modes, n_targets): expansion of the targets
    rcond: float  # of the eigenvectors


def analyse(
    basis: NativeBasis,
    matrix: Array,
    targets: Array,
    X: Array,
    X_next: Array,
    counted: NDArray[np.bool_],
    alpha: float,
    n_modes: int | None,
) -> Analysis:
    """Find the eigenfunctions, their residuals, and the expansion of targets.

    If fewer than all eigenfunctions are asked for, the expansion is the best one in
    mean square over the rows. The residuals are measured on the rows that are
    `counted`, those where no interpolation condition makes them vanish, or by leaving
    out one centre at a time if these are fewer than the centres.
    """
    eigenvalues, vectors = spectrum(matrix)
    weights, rcond = expansion(vectors, eigenvalues, targets)
    found = Eigenfunctions(eigenvalues, *basis.expand(vectors))
    few = counted.sum() < len(basis.lower)
    counted = counted & (not few)
    size, counted_size, defect = measure(basis, found, X, X_next, counted)
    size = np.sqrt(size / len(X))
    residuals = np.sqrt(_ratio(defect, counted_size))
    if few:
        # Interpolation has made phi(f(x)) - lambda phi(x) vanish at the centres. Apart
        # from them phi itself is uncertain, both at x and at f(x).
        left_out = basis
        if alpha > 0 and not basis.excess.any():  # a fit of all rows, at all of them
            assert isinstance(basis.sections, KernelSections)
            centers = basis.sections.centers
            nugget = np.full(len(centers), alpha)
            left_out = NativeBasis.of(basis.sections, centers, nugget, basis.tail)
        errors = unpack(left_out_errors(left_out, found.dual), eigenvalues)
        uncertainty = np.full(len(size), np.inf)
        if len(errors):
            uncertainty = np.sqrt(np.square(np.abs(errors)).mean(axis=0))
        residuals = _ratio(uncertainty, size) * np.hypot(1, np.abs(eigenvalues))
    # Conjugate eigenvalues tie, and a stable sort leaves them side by side.
    order = np.argsort(_ratio(residuals, np.abs(eigenvalues)), kind="stable")
    at_first = unpack(
        evaluate(basis.sections, basis.tail, X[:1], found.dual, found.trend),
        eigenvalues,
    )[0]
    size[size == 0] = 1.0
    factors = np.ones(len(order), dtype=np.complex128)
    apparent = np.abs(at_first) > 1e-8 * size
    factors[apparent] = np.abs(at_first[apparent]) / at_first[apparent]
    factors /= size
    found, weights = found.scale(factors), weights / factors[:, np.newaxis]
    if n_modes is not None and n_modes < len(order):
        # A conjugate pair stays together.
        order = order[: n_modes + int(eigenvalues[order[n_modes - 1]].imag > 0)]
        weights = best_weights(basis, found.take(order), targets, X)
    else:
        weights = weights[order]
    return Analysis(found.take(order), factors[order], residuals[order], weights, rcond)


def best_weights(
    basis: NativeBasis, eigenfunctions: Eigenfunctions, targets: Array, X: Array
) -> Complex:
    """Weights of eigenfunctions that approximate targets in mean square over rows.

    The targets are functions, given by their coordinates.
    """
    dual, trend = basis.expand(targets)
    dual = np.hstack([eigenfunctions.dual, dual])
    trend = np.hstack([eigenfunctions.trend, trend])
    m, columns = len(eigenfunctions.eigenvalues), dual.shape[1]
    triangle = np.empty((0, columns))
    # Row by row into one triangular factor, since normal equations would square the
    # condition number of eigenfunctions that are nearly parallel.
    for rows in gen_batches(len(X), max(BLOCK // columns, columns)):
        values = evaluate(basis.sections, basis.tail, X[rows], dual, trend)
        triangle = np.asarray(qr(np.vstack([triangle, values]), mode="r")[0])
        triangle = triangle[:columns]
    weights = lstsq(triangle[:, :m], triangle[:, m:])[0]
    return unpack_weights(weights, eigenfunctions.eigenvalues)


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Divide, with infinity where the denominator is zero."""
    infinite = np.full(len(numerator), np.inf)
    return np.divide(numerator, denominator, out=infinite, where=denominator > 0)


def powers(matrix: Array, v: Array) -> Iterator[Array]:
    """Generate A v, A^2 v, ... until they leave the range of numbers."""
    while True:
        with np.errstate(over="ignore", invalid="ignore"):
            v = dgemm(1.0, matrix, v)
        if not np.abs(v).max(initial=0.0) < HUGE:
            return
        yield v


def block_diagonal(eigenvalues: Complex) -> Array:
    """Matrix of the operator on the packed eigenfunctions themselves.

    A real eigenvalue stands on the diagonal; a pair a + ib, a - ib makes the block
    ((a, b), (-b, a)), since phi o f = (a + ib) phi means that Re phi o f = a Re phi -
    b Im phi and Im phi o f = b Re phi + a Im phi.
    """
    matrix = np.diag(eigenvalues.real)
    first = np.flatnonzero(eigenvalues.imag > 0)
    matrix[first, first + 1] = eigenvalues.imag[first]
    matrix[first + 1, first] = -eigenvalues.imag[first]
    return matrix
