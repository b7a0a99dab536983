"""Polynomial trends: constants and linear functions beside the kernel sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sklearn.utils import gen_batches

from sklearn_koopman._utils._typing import Array, Mask

DEGREES: dict[str | None, int | None] = {None: None, "constant": 0, "linear": 1}


@dataclass(frozen=True)
class PolynomialTrend:
    """Polynomials of degree 0 or 1, sorted by what the centres tell of them.

    As coefficients of the monomials, which are 1, and x - origin for degree 1: `seen`
    holds q polynomials that are orthonormal on the centres, `unseen` those that vanish
    there, as some do where the centres are few or a feature is constant on them.
    """

    origin: Array
    seen: Array  # (n_terms, q)
    unseen: Array  # (n_terms, n_terms - q)

    @classmethod
    def on(cls, centers: Array, degree: int, rows: Array) -> PolynomialTrend:
        n_centers, n_features = centers.shape
        if degree == 0:
            seen = np.full((1, 1), 1 / np.sqrt(n_centers))
            return cls(np.zeros(n_features), seen, np.empty((1, 0)))
        origin = centers.mean(axis=0)
        scale = np.max(
            [
                np.abs(rows[batch] - origin).max(axis=0)
                for batch in gen_batches(len(rows), 2**13)
            ],
            axis=0,
        )
        # What rounding leaves of a constant feature is no direction to extrapolate in.
        varies = scale > 1e-13 * np.abs(origin)
        inverse = np.divide(1.0, scale, out=np.zeros(n_features), where=varies)
        monomials = np.hstack([np.ones((n_centers, 1)), (centers - origin) * inverse])
        # All directions, also those that few centres do not see.
        few = n_centers <= n_features
        _, singular, directions = np.linalg.svd(monomials, full_matrices=few)
        rank = int((singular > 1e-10 * singular[0]).sum())
        coefficients = np.vstack(
            [directions.T[:1], directions.T[1:] * inverse[:, None]]
        )
        return cls(
            origin, coefficients[:, :rank] / singular[:rank], coefficients[:, rank:]
        )

    def beyond(self, X: Array) -> Mask:
        """Tell in which rows polynomials that the centres do not see are not zero."""
        coefficients = np.hstack([self.seen, self.unseen])[1:]
        n = len(coefficients)
        # Features in which the centres agree have none.
        constant = np.asarray(np.abs(coefficients).sum(axis=1) == 0)
        origin = self.origin[:n]
        away = np.abs(X[:, :n] - origin)
        moved = away[:, constant] > 1e-12 * np.abs(origin[constant])
        left = np.abs(polynomial(X, self.origin, self.unseen))
        size = 1 + away @ np.abs(self.unseen[1:])
        return np.asarray(moved.any(axis=1) | (left > 1e-9 * size).any(axis=1))


def polynomial(X: Array, origin: Array, coefficients: Array) -> Array:
    """Evaluate polynomials given by their coefficients of 1 and x - origin."""
    if len(coefficients) == 1:
        return np.repeat(coefficients, len(X), axis=0)
    return coefficients[0] + (X - origin) @ coefficients[1:]
