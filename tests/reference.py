"""Dense reference solutions and kernels from their textbook formulas.

They share nothing with the package: no function of it, no block, no factorisation.
"""

import numpy as np
from scipy.linalg import null_space

N_TERMS = {None: lambda d: 0, "constant": lambda d: 1, "linear": lambda d: 1 + d}


def profile(name, r, n_features, exp=np.exp, sqrt=np.sqrt, number=np.longdouble):
    """Return a kernel by name as a function of r, the distance divided by beta.

    In the arithmetic of r: extended precision, or decimal numbers, for which exp, sqrt
    and number are those of `decimal.Decimal`.
    """
    family, _, degree = name.partition("_c")
    if family == "wendland":
        k = int(degree) // 2
        n = number(max(n_features, 3) // 2 + k + 1)
        inside = r <= 1
        r = r * inside + (1 - inside)
        q = {
            0: 1,
            1: (n + 1) * r + 1,
            2: ((n**2 + 4 * n + 3) * r**2 + (3 * n + 6) * r + 3) / 3,
            3: (
                (n**3 + 9 * n**2 + 23 * n + 15) * r**3
                + (6 * n**2 + 36 * n + 45) * r**2
                + (15 * n + 45) * r
                + 15
            )
            / 15,
        }
        return (1 - r) ** (n + k) * q[k]
    if family.startswith("matern"):
        twice_nu = int(family[len("matern") : -1])
        z = r * sqrt(number(twice_nu))
        factor = {1: 1, 3: 1 + z, 5: 1 + z + z**2 / 3}
        return factor[twice_nu] * exp(-z)
    return {
        "gaussian": lambda: exp(-(r**2) / 2),
        "inverse_multiquadric": lambda: 1 / sqrt(1 + r**2),
    }[name]()


def kernel_matrix(name, X, centers, beta=1.0):
    """Return the kernel between rows, computed in extended precision."""
    X, centers = (np.asarray(A, np.longdouble) for A in (X, centers))
    r = np.sqrt(((X[:, np.newaxis] - centers) ** 2).sum(axis=-1))
    values = profile(name, r / np.longdouble(beta), X.shape[1])
    return np.asarray(values, dtype=float)


def monomials(X, trend="linear", origin=0.0):
    """Return the polynomials of a trend at the rows of X: none, 1, or 1 and x."""
    columns = np.column_stack([np.ones(len(X)), X - origin])
    return columns[:, : N_TERMS[trend](X.shape[1])]


def saddle_point_matrix(K, P):
    """Return the matrix of interpolation with polynomials, as books print it."""
    return np.block([[K, P], [P.T, np.zeros((P.shape[1], P.shape[1]))]])


def dense_interpolant(K, P, u):
    """Return the coefficients of the kernel and of the polynomials of an interpolant.

    K has the regularisation on its diagonal.
    """
    right = np.vstack([u, np.zeros((P.shape[1], u.shape[1]))])
    matrix = saddle_point_matrix(K, P)
    solved = np.linalg.solve(matrix.astype(right.dtype), right)
    return solved[: len(K)], solved[len(K) :]


def dense_least_squares(K, P_centers, A, P, alpha):
    """Return the matrix from outputs to coefficients: of the kernel, of polynomials.

    They minimise |y - A c - P b|^2 + alpha c^T K c subject to P_centers^T c = 0, where
    K is the kernel matrix of the centres, and A and P are the kernel and the
    polynomials at all rows.
    """
    N = null_space(P_centers.T) if P_centers.shape[1] else np.eye(len(K))
    root = np.linalg.cholesky(N.T @ K @ N).T
    penalty = np.hstack([np.sqrt(alpha) * root, np.zeros((len(root), P.shape[1]))])
    stacked = np.vstack([np.hstack([A @ N, P]), penalty])
    inverse = np.linalg.pinv(stacked, rcond=1e-14)[:, : len(A)]
    return np.vstack([N @ inverse[: N.shape[1]], inverse[N.shape[1] :]])


def squared_power(K, P, k, p):
    """Return k(x, x) = 1 less what the centres determine of it, at the columns of k.

    K and P belong to the centres, k and p to the new rows. With polynomials it is the
    variance of universal kriging.
    """
    right = np.vstack([k, p.T])
    solved = np.linalg.solve(saddle_point_matrix(K, P), right)
    return 1 - np.einsum("ij,ij->j", right, solved)


def attainable_residual(A, b, P=None):
    """Return the relative residual that rounding allows of A x = b, for every column.

    A product with A has errors of eps |A| |x|, so that no vector near the solution x
    is known to have a residual below eps |A| |x| / |b|. With columns P, the system is
    that in the orthogonal complement of P.
    """
    if P is not None and P.shape[1]:
        N = null_space(P.T)
        A, b = N.T @ A @ N, N.T @ b
    size = np.linalg.norm(b, axis=0)
    if not len(A) or not size.any():
        return 0.0
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, np.finfo(float).eps * values[-1])
    x = (vectors / values) @ (vectors.T @ b)
    ratio = np.linalg.norm(x, axis=0)[size > 0] / size[size > 0]
    return float(np.finfo(float).eps * values[-1] * ratio.max())
