"""Units (persons or recordings) that are left out together."""

from numbers import Integral
from typing import Any

import numpy as np
from sklearn.model_selection import GroupKFold, LeaveOneGroupOut, check_cv
from sklearn.utils.validation import column_or_1d

from .._utils._typing import Indices


def as_units(groups: Any, n_recordings: int) -> Indices:
    """Return the number of the unit of each recording, from 0."""
    if groups is None:
        return np.arange(n_recordings)
    labels = column_or_1d(groups)
    if len(labels) != n_recordings:
        raise ValueError(
            f"groups holds {len(labels)} labels for {n_recordings} recordings; pass "
            "one for each, such as the person."
        )
    if any(label is None or label != label for label in labels.tolist()):
        raise ValueError("groups holds None or NaN; name the unit of each recording.")
    return np.unique(labels, return_inverse=True)[1]


def split_units(units: Indices, cv: Any) -> list[tuple[Indices, Indices]]:
    """Return the recordings of each fit that leaves out units, and those left out."""
    if len(np.unique(units)) < 2:
        raise ValueError(
            "all recordings are one unit, none can be left out; pass more of them, or "
            "groups with several labels."
        )
    splitter: Any = LeaveOneGroupOut() if cv is None else cv
    if isinstance(cv, Integral):
        splitter = GroupKFold(int(cv))
    folds = list(check_cv(splitter).split(units, groups=units))
    left_out = np.concatenate([np.unique(units[test]) for _, test in folds])
    n_tests = sum(len(test) for _, test in folds)
    if len(left_out) != len(np.unique(units)) or n_tests != len(units):
        raise ValueError(
            f"cv={cv!r} does not leave out each unit once and as a whole; pass None, a "
            "number, or GroupKFold."
        )
    return folds


def take(recordings: list[Any], y: Any, places: Indices) -> tuple[list[Any], Any]:
    """Return some of the recordings, and their outputs if there are any."""
    outputs = None if y is None else [y[place] for place in places]
    return [recordings[place] for place in places], outputs
