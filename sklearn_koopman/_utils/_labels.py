"""The order in time of rows that are labelled by data frames."""

from typing import Any

import numpy as np

from ._clocks import HOLE, count_recordings, find_index, find_steps, read_labels
from ._typing import Indices

REMEDY = (
    "Give recordings to trajectory_pairs as a list of data frames, and fit to its "
    "frames; or fit with sample_index=pairs.sample_index. Only if every row is one "
    "step after the row before it, with lag=1 and without gaps, sample_index=range(n) "
    "of all n rows serves as well, also where cross-validation leaves out blocks."
)


def order_of_labels(*data: Any) -> Indices | None:
    """Return the place of each row on the clock that labels are.

    Two rows follow each other if their labels are one usual step apart.

    Parameters
    ----------
    *data : object
        DataFrames, Series, or anything else, which has no labels.

    Returns
    -------
    clock : ndarray of shape (n_rows,), or None
        Integers as of `sample_index`, by the labels of the first DataFrame or Series.
        None if there is none, or if its labels are neither numbers nor times.

    Raises
    ------
    ValueError
        If labels repeat, are missing or irregular, or tell several recordings apart.
    """
    index = find_index(*data)
    if index is None:
        return None
    n_recordings = count_recordings(index)
    if n_recordings > 1:
        _refuse(f"holds {n_recordings} recordings")
    labels = read_labels(index, "the rows")
    if labels is None:
        return None
    clock = np.zeros(len(labels), dtype=np.intp)
    if len(labels) < 2:
        return clock
    order = np.argsort(labels, kind="stable")
    repeated = np.flatnonzero(np.diff(labels[order]) == 0)
    if len(repeated):
        i, j = order[repeated[0] : repeated[0] + 2]
        _refuse(f"has the label {index[i]} in rows {i} and {j}")
    remedy = (
        "interpolate by trajectory_pairs(..., resample=), or pass sample_index instead"
    )
    steps, _ = find_steps(labels[order], "the rows", remedy)
    clock[order[1:]] = np.cumsum(np.where(steps <= HOLE, 1, 2))
    return clock


def _refuse(finding: str) -> None:
    raise ValueError(
        f"The index of the rows {finding}, as if several recordings had been joined. "
        f"{REMEDY}"
    )
