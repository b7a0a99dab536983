"""Spectra of Koopman operators: eigenfunctions, their residuals and expansions.

Eigenvectors of a real matrix are kept as LAPACK gives them, "packed" into real columns:
one for a real eigenvalue, and the real and the imaginary part of the first of a
conjugate pair, side by side.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq, qr
from scipy.linalg.lapack import dgecon, dgeev, dgeev_lwork, dgetrf, dgetrs
from sklearn.utils import gen_batches

from .._linalg._fit import make_nugget
from .._linalg._systems import DirectSystem
from .._matrices._sections import KernelExpansion
from .._utils._rows import count_distinct, total_weight, weights_at
from .._utils._typing import Array, Complex, Mask
from ._operator import ENTRIES_PER_BLOCK

# An eigenfunction of mean square one that is smaller at a row counts as zero there.
MIN_EIGENFUNCTION = 1e-8


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
    """Return weights, one a row, that give packed functions the same real sum."""
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


class SpectralDecomposition(NamedTuple):
    """Eigenfunctions of an operator, the most trustworthy first."""

    eigenvalues: Complex  # (n_modes,), the one with positive imaginary part first
    eigenfunctions: KernelExpansion  # packed
    residuals: Array  # (n_modes,)
    weights: Complex  # (n_modes, n_targets): expansion of the targets
    rcond: float  # of the eigenvectors


def decompose(
    system: DirectSystem,
    matrix: Array,
    targets: Array,
    X: Array,
    X_next: Array,
    counted: Mask,
    alpha: float,
    n_modes: int | None,
    weights: Array | None = None,
) -> SpectralDecomposition:
    """Find the eigenfunctions, their residuals, and the expansion of targets.

    Rows count by their `weights`, if they have any.

    If fewer than all eigenfunctions are asked for, the expansion is the best one in
    mean square over the rows. The residuals are measured on the rows that are
    `counted`, those where no interpolation condition makes them vanish, or by leaving
    out one centre at a time if these are fewer than the centres.
    """
    if n_modes == 0:
        none = np.empty((len(matrix), 0))
        shares = np.empty((0, targets.shape[1]), dtype=np.complex128)
        functions = system.expand(none)
        return SpectralDecomposition(shares[:, 0], functions, none[0], shares, 0.0)
    lam, vectors = eigenvectors(matrix)
    shares, rcond = expand_in_eigenvectors(vectors, lam, targets)
    functions = system.expand(vectors)
    # Repeated pairs tell no more than one.
    pairs = np.hstack([X[counted], X_next[counted]])
    few = count_distinct(pairs) < len(system.kept)
    size, counted_size, defect, at_first = measure(
        functions, lam, X, X_next, counted & (not few), weights
    )
    size = np.sqrt(size / total_weight(X, weights))
    if few:
        # Interpolation has made phi(f(x)) - lambda phi(x) vanish at the centres. Apart
        # from them phi itself is uncertain, both at x and at f(x).
        if alpha > 0 and not system.excess.any():
            system = _interpolating(system, X, alpha, weights)
        uncertainty = left_out_error(system, functions.dual_coef, lam)
        residuals = _ratio(uncertainty, size) * np.hypot(1, np.abs(lam))
    else:
        residuals = np.sqrt(_ratio(defect, counted_size))
    # Conjugate eigenvalues tie, and a stable sort leaves them side by side.
    order = np.argsort(_ratio(residuals, np.abs(lam)), kind="stable")
    size[size == 0] = 1.0
    factors = np.ones(len(order), dtype=np.complex128)
    apparent = np.abs(at_first) > MIN_EIGENFUNCTION * size
    factors[apparent] = np.abs(at_first[apparent]) / at_first[apparent]
    factors /= size
    shares = shares / factors[:, np.newaxis]
    functions = _scale(functions, lam, factors)
    n_kept = len(order)
    if n_modes is not None and n_modes < n_kept:
        # A conjugate pair stays together.
        n_kept = n_modes + int(lam[order[n_modes - 1]].imag > 0)
        order = order[:n_kept]
    lam, functions = lam[order], functions.take(order)
    if n_kept < len(matrix):
        shares = best_weights(functions, lam, system.expand(targets), X, weights)
    else:
        shares = shares[order]
    return SpectralDecomposition(lam, functions, residuals[order], shares, rcond)


def eigenvectors(matrix: Array) -> tuple[Complex, Array]:
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


def expand_in_eigenvectors(
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


def measure(
    functions: KernelExpansion,
    eigenvalues: Complex,
    X: Array,
    X_next: Array,
    counted: Mask,
    weights: Array | None = None,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> tuple[Array, Array, Array, Complex]:
    """Measure packed eigenfunctions on pairs of states, which weights may multiply.

    Returns
    -------
    size : ndarray of shape (n_modes,)
        Sum of squares of phi over all rows.
    counted_size : ndarray of shape (n_modes,)
        The same over the rows that count.
    defect : ndarray of shape (n_modes,)
        Sum of squares of phi(x_next) - lambda phi(x) over the rows that count.
    at_first : ndarray of shape (n_modes,)
        Values of phi at the first row.
    """
    lam = eigenvalues
    partner = np.arange(len(lam)) + np.sign(lam.imag).astype(np.intp)
    size, counted_size, defect = np.zeros((3, len(lam)))
    for rows in gen_batches(len(X), max(block_entries // len(lam), 1)):
        now = functions(X[rows])
        if rows.start == 0:
            at_first = unpack(now[:1], lam)[0]
        size += _sum_squares(now, None if weights is None else weights[rows])
        kept = counted[rows]
        if not kept.any():
            continue
        now = now[kept]
        then = functions(X_next[rows][kept])
        # Packed: lambda (a + ib) has the parts Re a - Im b and Re b + Im a.
        then -= now * lam.real
        then += now[:, partner] * lam.imag
        own = None if weights is None else weights[rows][kept]
        defect += _sum_squares(then, own)
        counted_size += _sum_squares(now, own)
    pair = partner != np.arange(len(lam))
    for sums in (size, counted_size, defect):
        sums[pair] += sums[partner][pair]
    return size, counted_size, defect, at_first


def left_out_error(
    system: DirectSystem, dual_coef: Array, eigenvalues: Complex
) -> Array:
    """Return the rms error of eigenfunctions at centres that are left out, one by one.

    In closed form (Rippa 1999). Centres without which no interpolant is determined do
    not count; infinite if there are no others.
    """
    precision = system.left_out_precision()
    determined = np.isfinite(precision)
    if not determined.any():
        return np.full(len(eigenvalues), np.inf)
    errors = dual_coef[determined] / precision[determined, np.newaxis]
    return np.sqrt(np.square(np.abs(unpack(errors, eigenvalues))).mean(axis=0))


def _interpolating(
    system: DirectSystem, X: Array, alpha: float, weights: Array | None
) -> DirectSystem:
    """Return the system of the interpolant that a fit of all rows is.

    With all of them as centres, it has alpha, over the weights, on the diagonal.
    """
    points = system.sections.points
    at_centers = weights_at(points, X, weights)
    at_centers[at_centers == 0] = 1.0
    nugget = make_nugget(alpha, at_centers, system.sections.diagonal(points))
    return DirectSystem(system.sections, nugget, system.degree, "cholesky")


def _sum_squares(values: Array, weights: Array | None) -> Array:
    if weights is None:
        return np.asarray(np.einsum("ij,ij->j", values, values))
    return np.asarray(np.einsum("i,ij,ij->j", weights, values, values))


def best_weights(
    functions: KernelExpansion,
    eigenvalues: Complex,
    targets: KernelExpansion,
    X: Array,
    row_weights: Array | None = None,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> Complex:
    """Return weights of eigenfunctions that approximate targets best over rows."""
    both = functions._replace(
        dual_coef=np.hstack([functions.dual_coef, targets.dual_coef]),
        trend_coef=np.hstack([functions.trend_coef, targets.trend_coef]),
    )
    m, columns = len(eigenvalues), both.dual_coef.shape[1]
    triangle: Array = np.empty((0, columns))
    # Row by row into one triangular factor, since normal equations would square the
    # condition number of eigenfunctions that are nearly parallel.
    for rows in gen_batches(len(X), max(block_entries // columns, columns)):
        values = both(X[rows])
        if row_weights is not None:
            values *= np.sqrt(row_weights[rows, np.newaxis])
        stacked = np.vstack([triangle, values])
        triangle = np.array(qr(stacked, mode="r")[0][:columns])
    weights = lstsq(triangle[:, :m], triangle[:, m:])[0]
    return unpack_weights(weights, eigenvalues)


def _scale(
    functions: KernelExpansion, eigenvalues: Complex, factors: Complex
) -> KernelExpansion:
    """Multiply packed eigenfunctions by numbers, conjugate ones by conjugates."""
    dual_coef, trend_coef = (
        pack(unpack(values, eigenvalues) * factors, eigenvalues)
        for values in (functions.dual_coef, functions.trend_coef)
    )
    return functions._replace(dual_coef=dual_coef, trend_coef=trend_coef)


def _ratio(numerator: Array, denominator: Array) -> Array:
    """Divide, with infinity where the denominator is zero."""
    infinite = np.full(len(numerator), np.inf)
    return np.divide(numerator, denominator, out=infinite, where=denominator > 0)
