"""What the rows of DataFrames tell about themselves."""

from typing import Any

import numpy as np

from ._typing import Array


def index_level(name: str, *data: Any) -> Array | None:
    """Return the values of one level of an index.

    Parameters
    ----------
    name : str
        The name of the level, such as "trial" or "sample_index".
    *data : object
        DataFrames, Series, or anything else, which has no index.

    Returns
    -------
    values : ndarray of shape (n_rows,), or None
        The level of the first DataFrame or Series that has it, else None.

    Raises
    ------
    ValueError
        If several have it, and differ; or if it is a column.
    """
    found: Array | None = None
    for frame in data:
        index: Any = getattr(frame, "index", None)  # a list has a method so named
        if name in getattr(frame, "columns", ()):
            raise ValueError(
                f"{name!r} is a column; make it a level of the index again, by "
                "set_index, or drop it."
            )
        if name not in getattr(index, "names", ()):
            continue
        values = index.get_level_values(name).to_numpy()
        if found is not None and not np.array_equal(found, values):
            raise ValueError(
                f"X and y differ in the level {name!r} of their indices; bring their "
                "rows into one order, by y.loc[X.index]."
            )
        found = values
    return found
