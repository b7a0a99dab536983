"""The order in time of rows that are labelled by data frames."""

from typing import Any

import numpy as np

from ._typing import Indices

# Labels this far into the sorted steps between them tell the usual step. Most steps are
# equal, or nearly so in the case of times; those across holes are longer.
USUAL = 0.1
REMEDY = (
    "Give recordings to trajectory_pairs as a list of data frames, and fit to its "
    "frames; or fit with sample_index=pairs.sample_index. Only if every row is one "
    "step after the row before it, fit with sample_index=range(len(X))."
)


def order_of_labels(*data: Any) -> Indices | None:
    """Return the place of each row on the clock that labels are.

    Two rows follow each other if their labels are about one usual step apart.

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
        If labels repeat or are missing, or if they have several levels.
    """
    for frame in data:
        index: Any = getattr(frame, "index", None)
        if not hasattr(index, "nlevels"):
            continue  # a list has a method of this name
        if index.nlevels > 1:
            _refuse(f"has the levels {list(index.names)}, but not 'sample_index'")
        # Dates are numbers, whatever their time zone.
        labels = np.asarray(index.asi8 if hasattr(index, "asi8") else index)
        if labels.dtype.kind not in "iuf":
            return None
        order = np.argsort(labels, kind="stable")
        steps = np.diff(labels[order].astype(np.float64))
        broken = np.flatnonzero(~(steps > 0))
        if len(broken):
            i, j = order[broken[0] : broken[0] + 2]
            _refuse(f"has the labels {labels[i]} and {labels[j]} in rows {i} and {j}")
        if len(steps) == 0:
            return np.zeros(len(labels), dtype=np.intp)
        follows = np.rint(steps / np.quantile(steps, USUAL, method="lower")) == 1
        clock = np.zeros(len(labels), dtype=np.intp)
        clock[order[1:]] = np.cumsum(np.where(follows, 1, 2))
        return clock
    return None


def _refuse(finding: str) -> None:
    raise ValueError(
        f"The index of the rows {finding}, as if several recordings had been joined. "
        f"{REMEDY}"
    )
