"""Polynomial trends: constants and linear functions beside the kernel sections."""

from typing import NamedTuple, Self

import numpy as np

from .._utils._typing import Array, Mask

DEGREES: dict[str | None, int | None] = {None: None, "constant": 0, "linear": 1}

# A feature counts as constant if it varies by less than this part of its mean: such a
# variation is rounding, and no direction to extrapolate in.
CONSTANT = 1e-13
# Singular values of the monomials at the centres below this part of the largest one
# count as zero.
DEPENDENT = 1e-10


class PolynomialTrend(NamedTuple):
    """Polynomials that are orthonormal on the centres.

    Their coefficients belong to the monomials, which are 1 and, for a linear trend,
    x - origin.
    """

    origin: Array
    coefficients: Array  # (n_terms, q)

    @classmethod
    def at(cls, centers: Array, degree: int, extent: Array | None = None) -> Self:
        """Return the polynomials that the centres determine.

        Features without an extent, from their smallest to their largest value, are
        constant and left out. By default the extent is that of the centres.
        """
        n_centers, n_features = centers.shape
        if degree == 0:
            constant = np.full((1, 1), 1 / np.sqrt(n_centers))
            return cls(np.zeros(n_features), constant)
        origin = centers.mean(axis=0)
        scale = np.abs((centers if extent is None else extent) - origin).max(axis=0)
        varies = scale > CONSTANT * np.abs(origin)
        inverse = np.divide(1.0, scale, out=np.zeros(n_features), where=varies)
        monomials = np.hstack([np.ones((n_centers, 1)), (centers - origin) * inverse])
        _, singular, directions = np.linalg.svd(monomials, full_matrices=False)
        rank = int((singular > DEPENDENT * singular[0]).sum())
        inverse = np.append(1.0, inverse)
        coefficients = directions[:rank].T * inverse[:, np.newaxis] / singular[:rank]
        return cls(origin, coefficients)

    def values(self, X: Array) -> Array:
        """Evaluate the polynomials; of shape (n_rows, q)."""
        return polynomial(X, self.origin, self.coefficients)


def polynomial(X: Array, origin: Array, coefficients: Array) -> Array:
    """Evaluate polynomials given by their coefficients of 1 and x - origin."""
    if len(coefficients) == 1:
        return np.repeat(coefficients, len(X), axis=0)
    return coefficients[0] + (X - origin) @ coefficients[1:]


def is_undetermined(X: Array, centers: Array) -> Mask:
    """Tell at which rows some linear function that vanishes on the centres does not."""
    origin = centers.mean(axis=0)
    scale = np.abs(centers - origin).max(axis=0)
    constant = scale <= CONSTANT * np.abs(origin)
    moved = np.abs(X - origin)[:, constant] > 10 * CONSTANT * np.abs(origin[constant])
    P, p = (
        np.hstack([np.ones((len(x), 1)), (x - origin)[:, ~constant] / scale[~constant]])
        for x in (centers, X)
    )
    directions = np.linalg.svd(P, full_matrices=False)
    rank = int((DEPENDENT * directions.S[0] < directions.S).sum())
    V = directions.Vh[:rank]
    left = np.abs(p - p @ V.T @ V).max(axis=1)
    return moved.any(axis=1) | (left > 1e-9 * np.abs(p).sum(axis=1))
