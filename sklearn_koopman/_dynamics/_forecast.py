"""Forecasts of several steps: by eigenvalues, by powers, and by relifting.

Each function fills an array y of shape (n_samples, n_steps, n_outputs), and leaves NaN
where a diverging forecast ends. The first two expect the first step there already.
"""

from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
from sklearn.utils import gen_batches

from .._matrices._sections import KernelExpansion
from .._utils._typing import Array, Complex
from ._operator import ENTRIES_PER_BLOCK, generate_powers
from ._spectrum import pack_weights

# States this many times larger than all centres are not followed any further.
MAX_GROWTH = 1e50


def sum_modes(
    X: Array,
    y: Array,
    eigenfunctions: KernelExpansion,
    eigenvalues: Complex,
    weights: Complex,
    n_jobs: int | None = None,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> None:
    """Forecast by the eigenvalues of packed eigenfunctions.

    O(n M m) operations for m modes, and O(m) for every later output.
    """
    lam = eigenvalues[:, np.newaxis]
    for rows in gen_batches(len(X), max(block_entries // len(lam), 1)):
        phi = eigenfunctions(X[rows], n_jobs)
        for steps in _later_steps(y[rows], len(lam), block_entries):
            powers = lam ** np.arange(steps.start, steps.stop)
            outputs = powers[:, :, np.newaxis] * weights[:, np.newaxis]
            packed = pack_weights(outputs.reshape(len(lam), -1), eigenvalues)
            y[rows, steps] = (phi @ packed).reshape(len(phi), -1, y.shape[2])


def apply_powers(
    X: Array,
    y: Array,
    matrix: Array,
    coordinates: Array,
    expand: Callable[[Array], KernelExpansion],
    n_jobs: int | None = None,
    block_entries: int = ENTRIES_PER_BLOCK,
) -> None:
    """Forecast by powers of the operator, from the coordinates of the outputs.

    O(M^2) operations a step and O(M) for every output.
    """
    images = generate_powers(matrix, coordinates)
    for steps in _later_steps(y, len(matrix), block_entries):
        found = list(islice(images, steps.stop - steps.start))
        if not found:
            return
        values = expand(np.hstack(found))(X, n_jobs)
        reached = slice(steps.start, steps.start + len(found))
        y[:, reached] = values.reshape(len(X), -1, y.shape[2])


def relift_states(
    X: Array, y: Array, targets: KernelExpansion, n_jobs: int | None = None
) -> None:
    """Forecast by the learned map of states, whose columns follow those of outputs.

    Starts that are far from the training data are warned about.
    """
    n_features, n_outputs = X.shape[1], y.shape[2]
    limit = MAX_GROWTH * (np.abs(targets.sections.points).max() or 1.0)
    alive = np.arange(len(X))
    for step in range(y.shape[1]):
        if step:
            near = np.abs(X).max(axis=1) < limit
            alive, X = alive[near], X[near]
        if len(alive) == 0:
            return
        # Later steps go where the learned map goes, whether or not data are there.
        values = (targets if step else targets.predict)(X, n_jobs)
        y[alive, step] = values[:, :n_outputs]
        X = values[:, -n_features:]


def _later_steps(y: Array, n_functions: int, block_entries: int) -> Iterator[slice]:
    """Divide the steps after the first so that a block stays in memory."""
    n_rows = max(len(y), n_functions)
    size = max(block_entries // (n_rows * y.shape[2]), 1)
    for start in range(1, y.shape[1], size):
        yield slice(start, min(start + size, y.shape[1]))
