"""The designs that thin out the products of settings cover what they promise."""

from itertools import combinations, product

import pytest
from designs import covering, every_pair

SIZES = [(2, 2), (9, 13, 3), (3, 4, 3), (2, 2, 2, 2), (11, 3, 2, 2), (6, 2, 2, 3, 1)]


def factors_of(sizes):
    return {f"f{i}": [object() for _ in range(n)] for i, n in enumerate(sizes)}


@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_every_pair_occurs_in_few_rows(sizes):
    factors = factors_of(sizes)
    rows = covering(**factors)
    for (i, choices), (j, others) in combinations(enumerate(factors.values()), 2):
        occurring = {(row[i], row[j]) for row in rows}
        assert occurring == set(product(choices, others))
    # No design has fewer rows than there are pairs of the two longest factors.
    *_, second, first = sorted(sizes)
    assert first * second <= len(rows) <= 1.5 * first * second + 2
    assert len(set(rows)) == len(rows)


def test_design_is_the_same_every_time():
    factors = factors_of((5, 4, 3))
    assert covering(**factors) == covering(**factors)


def test_values_need_no_hash_and_no_comparison():
    rows = covering(a=[[1], [1]], b=[{}, {}], c="xy")
    assert {row[2] for row in rows} == {"x", "y"}
    assert len(rows) == 4


@pytest.mark.parametrize(
    ("factors", "rows"),
    [({}, []), ({"a": [1, 2]}, [(1,), (2,)]), ({"a": [1, 2], "b": []}, [])],
)
def test_less_than_two_factors(factors, rows):
    assert covering(**factors) == rows


@every_pair(letter={"a": 1, "b": 2}, number=[1, 2])
def test_mark_passes_the_settings_by_name(letter, number):
    assert letter in "ab"
    assert number in (1, 2)
