"""Kernel sections of centres, their matrices, and functions that are sums of them.

A kernel section is the function k(., xi) of one centre xi. Kernel matrices are
evaluated tile by tile. A tile and its working memory stay in the cache, and are the
same arrays throughout: the operating system would otherwise map new ones for every
tile, which takes longer than the kernel.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from joblib import effective_n_jobs
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed

from .._utils._parallel import by_rows, one_thread
from .._utils._typing import Array, Indices
from .._utils._warnings import ExtrapolationWarning, warn
from ..kernels import MAX_SCALED_COORDINATE, RadialKernel, radial_values, scale_states
from . import _sparse
from ._polynomial import polynomial

# Writes k(X[rows], Xi[columns]) to an array of that shape.
Tiles = Callable[[slice, slice, Array], None]

# A tile has 256 kB, and its distances as much again.
TILE_ENTRIES = 2**15
TILE_ROWS = 64
# With a smaller share of entries that are not zero, a sparse product is faster.
SPARSE_DENSITY = 0.01
# Rows of a sparse matrix that are held at once.
SPARSE_ROWS = 2**14
# With fewer entries, the 0.1 ms that limiting BLAS to one thread takes do not pay.
ENTRIES_TO_LIMIT_THREADS = 2**19
# With more features, matrix products give the distances faster than differences do.
MAX_FEATURES_FOR_DIFFERENCES = 4
# Products lose the digits of small distances. Squared distances below this part of the
# squared size of the states are computed anew.
NEAR = 1e-6
# Products are not used for states with larger coordinates, or with larger squared
# distances from their mean, in units of beta.
MAX_SIZE_FOR_PRODUCTS = 1e3
# A centre has a say at a state if their kernel sections have at least this correlation.
# Where none has, the squared power function is about 1 % or less below its prior value.
MIN_CORRELATION = 0.1
# One centre in so many is asked first: they reach most rows.
CENTERS_PER_PILOT = 512


class Sections(Protocol):
    """The kernel sections of M centres."""

    @property
    def kernel(self) -> Any:
        """The kernel."""

    @property
    def size(self) -> int:
        """The number M of centres."""

    @property
    def points(self) -> Array:
        """The centres, as rows at which the sections can be evaluated."""

    def take(self, kept: Indices) -> Self:
        """Return the sections of some of the centres."""

    def diagonal(self, X: Array) -> Array:
        """Return k(x, x) for every row."""

    def smooth_diagonal(self, X: Array) -> Array:
        """Return k(x, x) without the noise terms of the kernel."""

    def tiles(self, X: Array, exact: bool = True) -> Tiles:
        """Return a function that fills tiles of k(X, Xi).

        `exact` asks for the last digits, as factorisations need them.
        """


class KernelSections(NamedTuple):
    """Sections of centres that are given by their coordinates."""

    kernel: Any
    centers: Array

    @property
    def size(self) -> int:
        return len(self.centers)

    @property
    def points(self) -> Array:
        return self.centers

    def take(self, kept: Indices) -> Self:
        return type(self)(self.kernel, self.centers[kept])

    def diagonal(self, X: Array) -> Array:
        return self.kernel.diag(X)

    def smooth_diagonal(self, X: Array) -> Array:
        if isinstance(self.kernel, RadialKernel):
            return np.ones(len(X))
        parts = [
            np.diagonal(self.kernel(X[rows], X[rows]))
            for rows in gen_batches(len(X), 64)
        ]
        return np.concatenate(parts)

    def tiles(self, X: Array, exact: bool = True) -> Tiles:
        kernel, centers = self.kernel, self.centers
        if isinstance(kernel, RadialKernel):
            return _radial_tiles(kernel, X, centers, exact)

        def fill(rows: slice, columns: slice, out: Array) -> None:
            out[...] = kernel(X[rows], centers[columns])

        return fill


class PrecomputedSections(NamedTuple):
    """Sections of a kernel of the distance, where rows hold distances to the centres.

    `columns` are the places of the centres in a row. `points` are the rows of the
    centres themselves; without them nothing can be factored.
    """

    kernel: Any
    columns: Indices
    points: Array

    @property
    def size(self) -> int:
        return len(self.columns)

    def take(self, kept: Indices) -> Self:
        return type(self)(self.kernel, self.columns[kept], self.points[kept])

    def diagonal(self, X: Array) -> Array:
        return np.repeat(self.kernel.diag(np.zeros((1, 1))), len(X))

    def smooth_diagonal(self, X: Array) -> Array:
        origin = np.zeros((1, 1))
        return np.repeat(self.kernel(origin, origin)[0], len(X))

    def tiles(self, X: Array, exact: bool = True) -> Tiles:
        origin = np.zeros((1, 1))

        def fill(rows: slice, columns: slice, out: Array) -> None:
            distances = X[rows][:, self.columns[columns]]
            # On a line, a point is given by its distance from the origin.
            values = self.kernel(distances.reshape(-1, 1), origin)
            out[...] = values.reshape(out.shape)

        return fill


class KernelExpansion(NamedTuple):
    """The function f(x) = k(x, Xi) dual_coef + (1, x - origin) trend_coef.

    Columns of the coefficients belong to outputs. `trend_coef` has no rows where there
    is no trend, and one for a constant.
    """

    sections: Sections
    dual_coef: Array  # (M, n_outputs)
    origin: Array
    trend_coef: Array  # (n_terms, n_outputs)

    def __call__(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the function at the rows of X; O(n M) operations."""
        return self._with_trend(product(self.sections, X, self.dual_coef, n_jobs), X)

    def predict(self, X: Array, n_jobs: int | None = None) -> Array:
        """Evaluate the function, and warn of rows at which no centre has a say."""
        values = product(self.sections, X, self.dual_coef, n_jobs, tell_reached=True)
        values, reached = values[:, :-1].copy(), values[:, -1]
        if not reached.all():
            some = "Some" if reached.any() else "All"
            warn(
                f"{some} states of X are so far from the training data that no centre "
                "has a say there: predictions are close to the trend, or to 0. Give X "
                "the units and the scaling of the training data, or raise beta.",
                ExtrapolationWarning,
            )
        return self._with_trend(values, X)

    def _with_trend(self, values: Array, X: Array) -> Array:
        if len(self.trend_coef):
            values += polynomial(X, self.origin, self.trend_coef)
        return values

    def combine(self, weights: Array) -> Self:
        """Return linear combinations of the outputs."""
        return self._replace(
            dual_coef=self.dual_coef @ weights, trend_coef=self.trend_coef @ weights
        )

    def take(self, outputs: Indices | slice) -> Self:
        """Return the function of some of the outputs."""
        return self._replace(
            dual_coef=self.dual_coef[:, outputs], trend_coef=self.trend_coef[:, outputs]
        )


def matrix(sections: Sections, X: Array) -> Array:
    """Evaluate k(X, Xi)."""
    K = np.empty((len(X), sections.size))
    fill = sections.tiles(X)
    work = np.empty(TILE_ENTRIES)
    for rows, columns in _grid(len(X), sections.size):
        K[rows, columns] = _filled(fill, rows, columns, work)
    return K


def gram_matrix(sections: Sections, nugget: Array) -> tuple[Array, Array, float]:
    """Assemble the lower triangle of the Gram matrix plus a diagonal.

    Returns
    -------
    K : ndarray of shape (M, M)
        The matrix in Fortran order; what is above its diagonal has no meaning.
    excess : ndarray of shape (M,)
        What its diagonal has over the sections: the nugget, and a noise term of the
        kernel, which counts here and nowhere else.
    norm : float
        Its 1-norm.
    """
    points, n = sections.points, sections.size
    K = np.empty((n, n))
    fill, work = sections.tiles(points), np.empty(TILE_ENTRIES)
    sums = np.zeros(n)
    for rows in _slices(0, n, TILE_ROWS):
        corner = _filled(fill, rows, rows, work)
        K[rows, rows] = corner
        sums[rows] += np.abs(corner, out=corner).sum(axis=1)
        for columns in _slices(rows.stop, n, TILE_ENTRIES // TILE_ROWS):
            tile = _filled(fill, rows, columns, work)
            K[rows, columns] = tile
            np.abs(tile, out=tile)
            sums[rows] += tile.sum(axis=1)
            sums[columns] += tile.sum(axis=0)
    diagonal = sections.diagonal(points) + nugget
    smooth = K.diagonal().copy()
    sums += np.abs(diagonal) - np.abs(smooth)
    K[np.diag_indices(n)] = diagonal
    return K.T, diagonal - smooth, float(sums.max())


def product(
    sections: Sections,
    X: Array,
    dual: Array,
    n_jobs: int | None = None,
    *,
    tell_reached: bool = False,
) -> Array:
    """Evaluate k(X, Xi) @ dual without holding k(X, Xi).

    `tell_reached` appends a column that is 0 where no centre has a say.
    """
    tree = sparse_tree(sections, X)
    if tree is not None:

        def evaluate_sparsely(X: Array) -> Array:
            K = sparse_matrix(sections, X, tree)
            values = K @ dual
            if tell_reached:
                reached = K.max(axis=1).toarray() >= MIN_CORRELATION
                values = np.column_stack([values, reached])
            return values

        return by_rows(evaluate_sparsely, X, SPARSE_ROWS, n_jobs)

    correlate = _correlations(sections, X[:1]) if tell_reached else None

    def evaluate(X: Array) -> Array:
        values = np.zeros((len(X), dual.shape[1]))
        fill, work = sections.tiles(X, exact=False), np.empty(TILE_ENTRIES)
        reached = np.full(len(X), correlate is None)
        if correlate is not None and len(X) > TILE_ROWS:
            few = slice(0, sections.size, CENTERS_PER_PILOT)
            n_few = -(-sections.size // CENTERS_PER_PILOT)
            for rows in _slices(0, len(X), max(TILE_ENTRIES // n_few, 1)):
                tile = np.empty((rows.stop - rows.start, n_few))
                fill(rows, few, tile)
                reached[rows] = correlate(tile, X[rows], few) >= MIN_CORRELATION
        some_left = not reached.all()
        for rows, columns in _grid(len(X), sections.size):
            tile = _filled(fill, rows, columns, work)
            values[rows] += tile @ dual[columns]
            if correlate is not None and some_left and not reached[rows].all():
                largest = correlate(tile, X[rows], columns)
                reached[rows] |= largest >= MIN_CORRELATION
        return values if correlate is None else np.column_stack([values, reached])

    # Scaled copies of the rows are made once a slab, of whole tiles: sums of exact ones
    # do not depend on the number of threads.
    height = _height(sections.size)
    n_tiles = -(-len(X) // (8 * effective_n_jobs(n_jobs) * height))
    n_rows = min(n_tiles, max(2**16 // height, 1)) * height
    if len(X) <= n_rows and len(X) * sections.size < ENTRIES_TO_LIMIT_THREADS:
        return evaluate(X)
    with one_thread():
        return by_rows(evaluate, X, n_rows, n_jobs)


def _correlations(
    sections: Sections, state: Array
) -> Callable[[Array, Array, slice], Array]:
    """Return a function that gives the largest correlation in each row of a tile.

    It takes the tile, the states of its rows and the places of its columns. Any state
    tells the norm that all sections of a stationary kernel have.
    """
    if isinstance(sections.kernel, RadialKernel):  # whose sections have norm 1
        return lambda tile, states, columns: tile.max(axis=1)
    if sections.kernel.is_stationary():
        square = float(sections.smooth_diagonal(state)[0]) or 1.0
        return lambda tile, states, columns: np.abs(tile).max(axis=1) / square
    right = np.sqrt(sections.smooth_diagonal(sections.points))

    def correlate(tile: Array, states: Array, columns: slice) -> Array:
        left = np.sqrt(sections.smooth_diagonal(states))
        # A section of norm 0 has no correlation, and the value 0 is right there.
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation = np.abs(tile) / right[columns] / left[:, np.newaxis]
        return np.nan_to_num(correlation, nan=1.0).max(axis=1)

    return correlate


def sparse_tree(
    sections: Sections, X: Array, density: float = SPARSE_DENSITY
) -> KDTree | None:
    """Return a tree of the centres if a smaller part of k(X, Xi) is not zero.

    For few rows or centres, building the tree takes longer than all of the matrix.
    """
    if not (
        len(X) >= TILE_ROWS
        and sections.size > TILE_ENTRIES // TILE_ROWS
        and isinstance(sections, KernelSections)
        and isinstance(sections.kernel, RadialKernel)
        and np.isfinite(sections.kernel.support_radius)
    ):
        return None
    tree = _sparse.kd_tree(sections.kernel, sections.centers)
    return tree if _sparse.density(sections.kernel, tree, X) < density else None


def sparse_matrix(sections: Sections, X: Array, tree: KDTree) -> csr_array:
    """Evaluate k(X, Xi) where it is not zero."""
    return _sparse.cross(sections.kernel, X, sections.points, tree)


def gram_product(sections: Sections, V: Array, n_jobs: int | None = None) -> Array:
    """Evaluate k(Xi, Xi) @ V without holding the matrix, from one triangle."""
    points, n = sections.points, sections.size
    n_workers = effective_n_jobs(n_jobs)

    def share(first: int) -> Array:
        """Return the sums over every so many rows of tiles."""
        sums = np.zeros_like(V)
        fill, work = sections.tiles(points, exact=False), np.empty(TILE_ENTRIES)
        for start in range(first * TILE_ROWS, n, n_workers * TILE_ROWS):
            rows = slice(start, min(start + TILE_ROWS, n))
            sums[rows] += _filled(fill, rows, rows, work) @ V[rows]
            for columns in _slices(rows.stop, n, TILE_ENTRIES // TILE_ROWS):
                tile = _filled(fill, rows, columns, work)
                sums[rows] += tile @ V[columns]
                sums[columns] += tile.T @ V[rows]
        return sums

    if n_workers == 1:
        with one_thread():
            return share(0)
    with one_thread():
        shares = Parallel(n_jobs=n_jobs, prefer="threads")(
            delayed(share)(first) for first in range(n_workers)
        )
    total = shares[0]
    for more in shares[1:]:
        total += more
    return total


def _grid(n_rows: int, n_columns: int) -> Iterator[tuple[slice, slice]]:
    """Divide a matrix into tiles, row by row."""
    for rows in _slices(0, n_rows, _height(n_columns)):
        for columns in _slices(0, n_columns, TILE_ENTRIES // (rows.stop - rows.start)):
            yield rows, columns


def _height(n_columns: int) -> int:
    return max(TILE_ROWS, TILE_ENTRIES // n_columns)


def _filled(fill: Tiles, rows: slice, columns: slice, work: Array) -> Array:
    n_rows, n_columns = rows.stop - rows.start, columns.stop - columns.start
    tile = work[: n_rows * n_columns].reshape(n_rows, n_columns)
    fill(rows, columns, tile)
    return tile


def _slices(start: int, stop: int, size: int) -> Iterator[slice]:
    for first in range(start, stop, size):
        yield slice(first, min(first + size, stop))


def _radial_tiles(kernel: RadialKernel, X: Array, centers: Array, exact: bool) -> Tiles:
    n_features = centers.shape[1]
    # Scaled before the differences are squared: neither huge nor tiny units overflow,
    # and equal rows stay at distance exactly zero.
    with np.errstate(over="ignore"):
        x, c = X / kernel.beta, centers / kernel.beta
    extent = float(max(np.abs(x).max(initial=0.0), np.abs(c).max(initial=0.0)))
    if extent > MAX_SCALED_COORDINATE:
        scale_states(kernel, X, centers)  # which refuses them
    work = np.empty(TILE_ENTRIES)
    by_products = None
    if (
        not exact
        and n_features > MAX_FEATURES_FOR_DIFFERENCES
        and extent < MAX_SIZE_FOR_PRODUCTS
    ):
        by_products = _distances_by_products(x, c)

    def fill(rows: slice, columns: slice, out: Array) -> None:
        r: Any = work[: out.size].reshape(out.shape)
        if by_products is not None:
            by_products(rows, columns, r)
        else:
            cdist(x[rows], c[columns], out=r)
        radial_values(kernel, r, n_features, out)

    return fill


def _distances_by_products(
    x: Array, c: Array
) -> Callable[[slice, slice, Array], None] | None:
    """Return distances by |x|^2 - 2 x^T c + |c|^2; None where they lose digits.

    The rounding error of the squared distance is that of |x|^2 + |c|^2. About the mean
    of the centres, and in units of the scale, that is small enough for the kernel
    except where a distance is nearly zero, whose root it is that counts.
    """
    mean = c.mean(axis=0)
    left, right = x - mean, c - mean
    left_squared = np.einsum("ij,ij->i", left, left)
    right_squared = np.einsum("ij,ij->i", right, right)
    size = float(left_squared.max(initial=0.0) + right_squared.max())
    if size > MAX_SIZE_FOR_PRODUCTS:
        return None
    left = np.column_stack([-2 * left, left_squared, np.ones(len(x))])
    right = np.vstack([right.T, np.ones(len(c)), right_squared])

    def fill(rows: slice, columns: slice, out: Array) -> None:
        np.matmul(left[rows], right[:, columns], out=out)
        near = np.flatnonzero(out < NEAR * size)
        if len(near):
            i, j = np.divmod(near, out.shape[1])
            difference = x[rows][i] - c[columns][j]
            out.reshape(-1)[near] = np.einsum("ij,ij->i", difference, difference)
        np.sqrt(out, out=out)

    return fill
