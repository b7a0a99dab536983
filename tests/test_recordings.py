"""Recordings as they are: gaps, clocks, rates, wraps, frames and the past."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from sklearn_koopman._utils._frames import index_level
from sklearn_koopman._utils._validation import refuse_masked

# --- what other parts call ----------------------------------------------------------


def test_masked_values_are_refused_and_counted():
    masked = np.ma.masked_greater(np.arange(6.0).reshape(3, 2), 3)
    with pytest.raises(ValueError, match=r"^X holds 2 masked values; .*split"):
        refuse_masked(X=masked)
    with pytest.raises(ValueError, match=r"^y holds 2 masked"):
        refuse_masked(X=np.ones(3), y=list(masked))
    with pytest.raises(ValueError, match=r"^X_next holds 1 masked"):
        refuse_masked(X_next=np.ma.array([1, 2], mask=[True, False]), y=None)
    refuse_masked(X=np.ma.array([1.0, 2]), y=[[1.0], [2.0]], sample_index=None)


def test_levels_of_an_index():
    index = pd.MultiIndex.from_tuples(
        [(7, 3), (7, 4), (9, 8)], names=["trial", "sample_index"]
    )
    frame = pd.DataFrame({"hip": [1.0, 2, 3]}, index=index)
    assert_array_equal(index_level("trial", frame), [7, 7, 9])
    other = [[1.0], [2.0], [3.0]], np.ones(3), None, pd.Series([1.0, 2, 3])
    assert_array_equal(index_level("sample_index", *other, frame["hip"]), [3, 4, 8])
    assert_array_equal(index_level("sample_index", frame.loc[7]), [3, 4])
    assert index_level("frame", frame, *other) is None
    first = frame.set_axis(index.set_levels([5, 6], level=0))
    assert_array_equal(index_level("trial", first, frame), [5, 5, 6])
