"""Rates of convergence that the theory guarantees."""

from numbers import Real
from typing import Any

import numpy as np
from sklearn.gaussian_process import kernels as gp
from sklearn.utils import Bunch

from .._utils._validation import check_integer, check_number
from ..kernels import RadialKernel, as_kernel


def sobolev_rates(kernel: Any, n_features: int, dimension: float) -> Bunch:
    """Return how fast errors fall with the fill distance, according to theory.

    The native space of a kernel is the function space that the kernel defines. For a
    kernel in R^d whose Fourier transform decays like ``(1 + |w|^2) ** -tau`` it is the
    Sobolev space of order tau. Restricted to a manifold Q of dimension m, the kernel
    has the Sobolev space of order ([1]_, theorem on restrictions)

    .. math:: s = \\tau - (d - m) / 2 .

    The fill distance h of centres is the largest distance of a point of Q from its
    nearest centre. For s > m/2, interpolation of functions in that space has the errors
    ([2]_)

    .. math:: \\sup_Q |g - g_M| = O(h^{s - m/2}), \\quad
        \\|g - g_M\\|_{L^2(Q)} = O(h^s),

    and both errors fall by up to a further :math:`h^s` for smoother functions. As the
    separation distance q becomes small, the smallest eigenvalue of the Gram matrix
    falls at most like q^(2s - m), and the condition number of quasi-uniform centres
    rises like q^(-2s).

    Parameters
    ----------
    kernel : str, Kernel or float
        As for :class:`~sklearn_koopman.KoopmanKernelRegressor`; or the order tau
        itself, as a number, for a kernel whose order is not known here.
    n_features : int
        Dimension d of the space of states.
    dimension : float
        Dimension m of the manifold, such as an estimate of
        :func:`intrinsic_dimension`.

    Returns
    -------
    rates : :class:`~sklearn.utils.Bunch`
        With the attributes

        tau, s : float
            The orders in R^d and on the manifold; infinite for kernels that are
            smoother than any Sobolev order, NaN if the order is not known.
        sup_exponent, rms_exponent : float
            The exponents ``s - m / 2`` and ``s`` above; NaN if the theorem does not
            apply.
        condition_exponent : float
            The exponent ``-2 s`` above; NaN if the theorem does not apply.
        applies : bool
            Whether s > m/2, with an order tau that is known.
        statement : str
            The rates in words.

    Raises
    ------
    ValueError
        If there is no such kernel, or the dimensions are out of range.

    See Also
    --------
    convergence_study : Measures the rates on data.

    Notes
    -----
    [1]_ prints the exponent s - m' with an integer m' > m/2. The exponent s - m/2 here
    is the sharper one of [2]_. The observed order may be lower if the outputs are less
    smooth than the theorem assumes, if there are too few centres for the asymptotic
    order, or if errors are at the level of rounding.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.
    .. [2] E. Fuselier and G. B. Wright, "Scattered data interpolation on embedded
       submanifolds with restricted positive definite kernels: Sobolev error
       estimates", SIAM Journal on Numerical Analysis 50, 2012.

    Examples
    --------
    The orbit of a pendulum is a curve in the plane:

    >>> from sklearn_koopman.diagnostics import sobolev_rates
    >>> rates = sobolev_rates("wendland_c4", n_features=2, dimension=1)
    >>> rates.tau, rates.s, rates.sup_exponent
    (3.5, 3.0, 2.5)
    """
    check_integer(n_features, "n_features", 1)
    check_number(dimension, "dimension", positive=True)
    if dimension > n_features:
        raise ValueError(
            f"dimension={dimension} is more than n_features={n_features}; give the "
            "dimension of the manifold, which is at most that of the space around it."
        )
    if isinstance(kernel, Real):
        check_number(kernel, "kernel", positive=True)
        tau = float(kernel)
    else:
        tau = _order(as_kernel(kernel, None, n_features), n_features)
    m = float(dimension)
    s = tau - (n_features - m) / 2
    applies = bool(s > m / 2)
    if np.isnan(tau):
        statement = (
            f"no rate is known, because the Sobolev order of {kernel!r} is not known; "
            "if you know it, give the order tau, a number, as the kernel"
        )
    elif not applies:
        statement = (
            f"no rate is guaranteed: the order on the manifold is s = {s:g}, not above "
            f"m/2 = {m / 2:g}; take a smoother kernel"
        )
    elif np.isinf(s):
        statement = "errors fall faster than any power of the fill distance h"
    else:
        statement = (
            f"sup error O(h^{s - m / 2:g}), rms error O(h^{s:g}) for functions of "
            f"order s = {s:g} on the manifold; smoother ones gain up to h^{s:g} more"
        )
    return Bunch(
        tau=tau,
        s=s,
        sup_exponent=s - m / 2 if applies else np.nan,
        rms_exponent=s if applies else np.nan,
        condition_exponent=-2 * s if applies else np.nan,
        applies=applies,
        statement=statement,
    )


def _order(kernel: gp.Kernel, n_features: int) -> float:
    """Return the Sobolev order of a kernel in R^d; NaN if it is not known."""
    if isinstance(kernel, RadialKernel):
        return kernel.sobolev_order(n_features)
    if isinstance(kernel, gp.Matern):
        return float(kernel.nu) + n_features / 2
    if isinstance(kernel, gp.RBF | gp.RationalQuadratic):
        return np.inf
    if isinstance(kernel, gp.Exponentiation):
        return _order(kernel.kernel, n_features)
    if not isinstance(kernel, gp.Sum | gp.Product):
        return np.nan
    # The native space of a sum is the sum of the spaces. The transform of a product is
    # a convolution, which decays like the slower one. A constant changes the order of
    # neither, and noise does not change that of a sum.
    is_sum = isinstance(kernel, gp.Sum)
    neutral: Any = gp.ConstantKernel | gp.WhiteKernel if is_sum else gp.ConstantKernel
    parts = [k for k in (kernel.k1, kernel.k2) if not isinstance(k, neutral)]
    orders = [_order(part, n_features) for part in parts]
    return float(np.min(orders)) if orders else np.nan  # NaN if one is
