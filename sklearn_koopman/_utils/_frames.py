"""What the rows of DataFrames tell about themselves."""

from typing import Any

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
    """
    for frame in data:
        index: Any = getattr(frame, "index", None)  # a list has a method so named
        if name in getattr(index, "names", ()):
            return index.get_level_values(name).to_numpy()
    return None
