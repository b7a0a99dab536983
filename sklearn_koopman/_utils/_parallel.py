"""Threads: those of this package, and those of BLAS."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from joblib import effective_n_jobs
from sklearn.utils import gen_batches
from sklearn.utils.parallel import Parallel, delayed
from threadpoolctl import ThreadpoolController

from ._typing import Array

_controller = cache(ThreadpoolController)


def by_rows(
    function: Callable[[Array], Array], X: Array, n_rows: int, n_jobs: int | None
) -> Array:
    """Apply a function to blocks of rows, on threads if asked, and join the results."""
    blocks = [X[rows] for rows in gen_batches(len(X), n_rows)]
    if len(blocks) == 1 or effective_n_jobs(n_jobs) == 1:
        return np.concatenate([function(block) for block in blocks])
    with one_thread():
        parts = Parallel(n_jobs, prefer="threads")(map(delayed(function), blocks))
    return np.concatenate(parts)


def one_thread() -> Any:
    """Hold BLAS to one thread: several in each of several threads slow each other."""
    return _controller().limit(limits=1, user_api="blas")
