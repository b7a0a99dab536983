"""Covering designs: few rows of settings in which every pair of settings occurs.

A test that depends on five settings of three values has 243 cases. Nearly all errors
show in one setting, or in two settings together, and every pair of values of two
settings occurs in about a dozen of these cases.
"""

from itertools import combinations

import pytest


def covering(**factors):
    """Return rows, one value for each factor, such that each pair of values occurs.

    A value counts by its place in the list of its factor, so that it needs neither a
    hash nor a comparison. Each row begins with a pair that has not occurred yet, and
    takes for every other factor the value that adds most new pairs; of equally good
    ones it takes that which occurred least, and then the first. There is no random
    number in it.
    """
    values = [list(choices) for choices in factors.values()]
    if len(values) < 2:
        return [tuple(row) for row in zip(*values, strict=True)]
    uses = [[0] * len(choices) for choices in values]
    # In order, and with the order kept: a dictionary serves as an ordered set.
    missing = {
        (i, a, j, b): None
        for i, j in combinations(range(len(values)), 2)
        for a in range(len(values[i]))
        for b in range(len(values[j]))
    }
    rows = []
    while missing:
        i, a, j, b = next(iter(missing))
        row = {i: a, j: b}
        for k in range(len(values)):
            if k not in row:
                row[k] = min(
                    range(len(values[k])),
                    key=lambda c: (-_gain(missing, row, k, c), uses[k][c], c),
                )
        for k, c in row.items():
            uses[k][c] += 1
        for pair in combinations(sorted(row.items()), 2):
            missing.pop(pair[0] + pair[1], None)
        rows.append(tuple(values[k][row[k]] for k in range(len(values))))
    return rows


def _gain(missing, row, k, c):
    """Count the new pairs of value c of factor k with the values in the row."""
    return sum(
        ((k, c, m, d) if k < m else (m, d, k, c)) in missing for m, d in row.items()
    )


def every_pair(**factors):
    """Return the mark that parametrizes a test by a covering design of the factors.

    Dictionaries give their keys.
    """
    return pytest.mark.parametrize(tuple(factors), covering(**factors))
