"""Delay embedding: from the samples of one recording to rows that hold their past."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ._typing import Array, Indices
from ._validation import check_integer

EMBEDDINGS = ("copies", "differences")


def check_offsets(delays: Any, delay_step: Any) -> Indices:
    """Return the offsets of a number of copies and their distance, or of a list.

    Parameters
    ----------
    delays : int, or array-like of int
        The number of copies, or the offsets themselves.
    delay_step : int or None
        The distance of two copies in samples; None with a list, or for 1.

    Returns
    -------
    offsets : ndarray of shape (n_offsets,)
        The age of each copy in samples, from 0 on, rising.

    Raises
    ------
    ValueError
        If these are no such offsets, or a list comes with a `delay_step`.
    """
    if isinstance(delays, str | bytes) or not isinstance(delays, Iterable):
        check_integer(delays, "delays", 1)
        if delay_step is not None:
            check_integer(delay_step, "delay_step", 1)
        return np.arange(int(delays)) * (1 if delay_step is None else delay_step)
    offsets = np.asarray(delays)
    is_list = offsets.ndim == 1 and offsets.dtype.kind in "iu" and len(offsets) > 0
    if not is_list or offsets[0] != 0 or (np.diff(offsets.astype(np.int64)) < 1).any():
        raise ValueError(
            "delays must be an integer, or offsets in samples that begin with 0 and "
            f"rise, such as (0, 1, 5), got {delays!r}."
        )
    if delay_step is not None:
        raise ValueError(
            f"delay_step={delay_step!r} has no meaning beside the offsets "
            f"delays={delays!r}; leave it out."
        )
    return offsets.astype(np.intp)


def embed(values: Array, offsets: Indices, embedding: str) -> Array:
    """Return the past of every sample that has one, as a row.

    Parameters
    ----------
    values : ndarray of shape (n_samples, n_features)
        Consecutive samples.
    offsets : ndarray of shape (n_offsets,)
        The age of each copy in samples, as `check_offsets` returns it.
    embedding : {"copies", "differences"}
        Copies of the samples, or Newton's divided differences over the offsets, per
        sample: of order j over the newest j + 1 copies.

    Returns
    -------
    rows : ndarray of shape (n_samples - offsets[-1], n_offsets * n_features)
        Row i belongs to sample ``i + offsets[-1]``. All columns of the newest copy (or
        of order 0) come first. No rows if there are too few samples.
    """
    reach = offsets[-1]
    n_rows = max(len(values) - reach, 0)
    blocks = np.stack([values[reach - o : reach - o + n_rows] for o in offsets])
    if embedding == "differences":
        times = -offsets.astype(np.float64)
        for order in range(1, len(offsets)):
            # Entry j then spans the copies j - order, ..., j.
            spans = times[order:] - times[:-order]
            steps = np.diff(blocks[order - 1 :], axis=0)
            blocks[order:] = steps / spans[:, np.newaxis, np.newaxis]
    return np.hstack(list(blocks))


def embedded_names(names: list[str], offsets: Indices, embedding: str) -> list[str]:
    """Name the columns of embedded rows: "hip", "hip_t-5", or "hip", "hip_d1".

    Parameters
    ----------
    names : list of str
        The names of the columns of the samples.
    offsets : ndarray of shape (n_offsets,)
        The age of each copy in samples.
    embedding : {"copies", "differences"}
        What the rows hold.

    Returns
    -------
    embedded : list of str
        The names in the order of the columns of `embed`. The newest copy has no suffix.
    """
    if embedding == "copies":
        suffixes = [f"_t-{offset}" for offset in offsets[1:]]
    else:
        suffixes = [f"_d{order}" for order in range(1, len(offsets))]
    return [name + suffix for suffix in ["", *suffixes] for name in names]
