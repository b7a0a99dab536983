"""Kernels against closed forms, spectra, finite differences and scikit-learn's own."""

from fractions import Fraction
from functools import partial
from math import comb

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.distance import cdist
from scipy.special import gamma, kv
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor, kernels
from sklearn.gaussian_process.kernels import ConstantKernel, WhiteKernel

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.kernels import (
    KERNELS,
    Gaussian,
    InverseMultiquadric,
    MaternSobolev,
    RadialKernel,
    Wendland,
    as_kernel,
)
from sklearn_koopman.solvers import ConjugateGradient

ALL = {**KERNELS, "matern72": partial(MaternSobolev, nu=3.5)}
every_kernel = pytest.mark.parametrize("make", ALL.values(), ids=ALL)


def values(kernel, r, n_features=1):
    """The kernel between the origin and points at distances r on the first axis."""
    points = np.zeros((len(r), n_features))
    points[:, 0] = r
    return kernel(np.zeros((1, n_features)), points)[0]


# --- closed forms -------------------------------------------------------------------


@pytest.mark.parametrize("beta", [0.3, 1.0, 7.0])
@pytest.mark.parametrize("nu", [0.5, 1.5, 2.5, 3.5])
def test_matern_is_the_bessel_form(nu, beta):
    r = np.geomspace(1e-2, 30, 200)
    z = np.sqrt(2 * nu) * r
    expected = 2 ** (1 - nu) / gamma(nu) * z**nu * kv(nu, z)
    assert_allclose(values(MaternSobolev(beta, nu), beta * r), expected, rtol=1e-12)


def test_matern_32_by_hand():
    # z = sqrt(3) * 2 / 2, with the distance and not its square.
    expected = (1 + np.sqrt(3)) * np.exp(-np.sqrt(3))
    assert_allclose(values(MaternSobolev(2.0), [2.0]), expected, rtol=1e-15)


def wendland_by_integration(dimension, k, r):
    """phi_{D,k} = I^k phi_{l,0}, (I phi)(r) = int_r^1 t phi(t) dt, in fractions."""
    order = dimension // 2 + k + 1
    phi = [Fraction((-1) ** i * comb(order, i)) for i in range(order + 1)]
    for _ in range(k):
        phi = [Fraction(0)] * 2 + [-c / (i + 2) for i, c in enumerate(phi)]
        phi[0] = -sum(phi)
    return float(sum(c * r**i for i, c in enumerate(phi)) / phi[0])


@pytest.mark.parametrize("dimension", [1, 2, 3, 4, 5, 10, 20, 31])
@pytest.mark.parametrize("smoothness", [0, 2, 4, 6])
def test_wendland_is_the_integrated_power(smoothness, dimension):
    r = [Fraction(i, 32) for i in range(33)]
    expected = [wendland_by_integration(dimension, smoothness // 2, x) for x in r]
    kernel = Wendland(2.0, smoothness, dimension=dimension)
    distances = 2 * np.array(r, dtype=float)
    actual = values(kernel, distances, dimension)
    assert_allclose(actual, expected, rtol=1e-13, atol=0)
    # Not the data but the dimension, where it is given, selects the polynomial.
    assert_array_equal(values(kernel, distances), actual)
    # Where it is not, the data do, from three features on.
    by_data = values(Wendland(2.0, smoothness), distances, max(dimension, 2))
    by_hand = Wendland(2.0, smoothness, dimension=max(dimension, 3))
    assert_array_equal(by_data, values(by_hand, distances))


# Section 4.1 of the paper, k_2^CS divided by 3, and Wendland's for smoothness 0.
PRINTED = {
    0: lambda r: (1 - r) ** 2,
    2: lambda r: (1 - r) ** 4 * (4 * r + 1),
    4: lambda r: (1 - r) ** 6 * (35 * r**2 + 18 * r + 3) / 3,
    6: lambda r: (1 - r) ** 8 * (32 * r**3 + 25 * r**2 + 8 * r + 1),
}


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("smoothness", PRINTED)
def test_wendland_is_the_paper_s_in_two_and_three_dimensions(smoothness, dimension):
    r = np.linspace(0, 1, 101)
    actual = values(Wendland(1.0, smoothness), r, dimension)
    assert_allclose(actual, PRINTED[smoothness](r), rtol=1e-13, atol=1e-30)


@pytest.mark.parametrize("beta", [0.2, 3.0])
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Gaussian, kernels.RBF),
        (InverseMultiquadric, partial(kernels.RationalQuadratic, alpha=0.5)),
        *(
            (partial(MaternSobolev, nu=nu), partial(kernels.Matern, nu=nu))
            for nu in (0.5, 1.5, 2.5, 3.5)
        ),
    ],
)
def test_equal_to_scikit_learn(ours, theirs, beta):
    rng = np.random.default_rng(0)
    X, Y = rng.normal(size=(30, 4)), rng.normal(size=(20, 4))
    ours, theirs = ours(beta=beta), theirs(length_scale=beta)
    assert_allclose(ours(X, Y), theirs(X, Y), rtol=1e-10, atol=1e-15)
    assert_allclose(ours(X), theirs(X), rtol=1e-10, atol=1e-15)


# --- positive definiteness ----------------------------------------------------------


def point_sets(dimension):
    rng = np.random.default_rng(dimension)
    yield rng.normal(size=(90, dimension))
    # A lattice, the set that shows the gaps of a Fourier transform best.
    side = 9 if dimension == 2 else 4 if dimension == 3 else 2
    digits = np.arange(min(side**dimension, 128))[:, None]
    yield 1.0 * (digits // side ** np.arange(dimension) % side)


@every_kernel
@pytest.mark.parametrize("dimension", [2, 3, 5, 10, 20])
def test_positive_definite(make, dimension):
    for X in point_sets(dimension):
        typical = np.median(cdist(X, X))
        for beta in (0.3 * typical, typical, 1.5 * typical, 4 * typical):
            K = make(beta=beta)(X)
            assert np.linalg.eigvalsh(K)[0] > -1e-14 * len(K)


def krawtchouk(d, w, j):
    terms = (comb(j, i) * comb(d - j, w - i) for i in range(w + 1))
    return sum((-1) ** i * term for i, term in enumerate(terms))


def hypercube_spectrum(phi):
    """Eigenvalues of the kernel matrix of {0, h}^d, where phi[w] = phi(h sqrt(w)).

    The matrix depends on the number of differing coordinates only; Krawtchouk
    polynomials diagonalise it, in any dimension.
    """
    ways = range(len(phi))
    return np.array([[krawtchouk(ways[-1], w, j) for w in ways] for j in ways]) @ phi


@pytest.mark.parametrize(
    ("smoothness", "dimension", "side"),
    [(0, 10, 0.48), (2, 16, 0.59), (4, 20, 0.53), (6, 25, 0.49)],
)
def test_printed_polynomials_fail_beyond_three_dimensions(smoothness, dimension, side):
    r = side * np.sqrt(np.arange(dimension + 1))
    printed = hypercube_spectrum(PRINTED[smoothness](np.minimum(r, 1)))
    assert printed.min() < -0.004 * printed.max()
    for beta in (1.0, 2.0, 5.0, 12.0):
        ours = hypercube_spectrum(values(Wendland(beta, smoothness), r, dimension))
        assert ours.min() > -1e-15 * ours.max()
    assert hypercube_spectrum(values(Wendland(1.0, smoothness), r, dimension)).min() > 0


def test_spectrum_of_a_hypercube():
    # The formula above against the matrix itself.
    X = 0.3 * (np.arange(64)[:, None] // 2 ** np.arange(6) % 2)
    expected = np.repeat(
        hypercube_spectrum(values(Wendland(), 0.3 * np.sqrt(np.arange(7)), 6)),
        [comb(6, j) for j in range(7)],
    )
    actual = np.linalg.eigvalsh(Wendland()(X))
    assert_allclose(actual, np.sort(expected), rtol=1e-10)


@pytest.mark.parametrize("beta", [0.5, 1.0, 2.0])
def test_matern_of_the_paper_is_not_positive_definite(beta):
    # Section 4.1 prints the squared distance.
    X = make_pendulum().X
    centers = SeparatedCenterSelector(0.15).fit(X).cluster_centers_
    z = np.sqrt(3) * cdist(centers, centers) ** 2 / beta
    assert np.linalg.eigvalsh((1 + z) * np.exp(-z))[0] < -0.4
    assert np.linalg.eigvalsh(MaternSobolev(beta)(centers))[0] > 2e-4


@pytest.mark.parametrize("smoothness", [0, 2, 4, 6])
def test_wendland_refuses_more_features_than_its_dimension(smoothness):
    message = r"dimension=3.* 10 features.*at least 10"
    kernel = Wendland(smoothness=smoothness, dimension=3)
    with pytest.raises(ValueError, match=message):
        kernel(np.eye(10))
    with pytest.raises(ValueError, match=message):
        kernel(np.eye(10), eval_gradient=True)
    with pytest.raises(ValueError, match=message):
        kernel.sobolev_order(10)


# --- native spaces ------------------------------------------------------------------


def fourier_transform(kernel, w, end):
    """Radial transform in R^3 up to a factor, by composite Gauss quadrature."""
    node, weight = np.polynomial.legendre.leggauss(16)
    edges = np.linspace(0, end, 1201)
    half = np.diff(edges)[:, None] / 2
    r = (edges[:-1, None] + half * (1 + node)).ravel()
    integrand = (half * weight).ravel() * r * values(kernel, r, 3)
    return np.sin(w[:, None] * r) @ integrand / w


@pytest.mark.parametrize(
    ("kernel", "end"),
    [
        (MaternSobolev(nu=0.5), 45),
        (MaternSobolev(nu=1.5), 30),
        (Wendland(smoothness=0), 1),
        (Wendland(smoothness=2), 1),
        (Wendland(smoothness=2, dimension=5), 1),
    ],
    ids=repr,
)
def test_sobolev_order_is_the_decay_of_the_fourier_transform(kernel, end):
    w = np.linspace(30, 150, 400)
    transform = fourier_transform(kernel, w, end)
    assert transform.min() > 0  # Bochner
    slope, _ = np.polyfit(np.log(w), np.log(transform), 1)
    assert_allclose(slope, -2 * kernel.sobolev_order(3), rtol=0.01)


def test_transform_of_matern_is_an_inverse_power():
    w = np.linspace(0.1, 15, 25)
    for nu in (0.5, 1.5, 2.5, 3.5):
        kernel = MaternSobolev(nu=nu)
        transform = fourier_transform(kernel, w, 70)
        expected = (1 + w**2 / (2 * nu)) ** -kernel.sobolev_order(3)
        scale = transform[0] / expected[0]
        assert_allclose(transform, scale * expected, rtol=1e-7)


@pytest.mark.parametrize("d", [1, 2, 3, 7])
def test_sobolev_order(d):
    for nu in (0.5, 1.5, 2.5, 3.5):
        assert MaternSobolev(nu=nu).sobolev_order(d) == nu + d / 2
    for k in range(4):
        assert Wendland(smoothness=2 * k).sobolev_order(d) == (d + 1) / 2 + k
    assert Gaussian().sobolev_order(d) == InverseMultiquadric().sobolev_order(d)
    assert Gaussian().sobolev_order(d) == np.inf


@every_kernel
def test_support_radius(make):
    kernel = make(beta=2.5)
    radius = kernel.support_radius
    if isinstance(kernel, Wendland):
        assert radius == 2.5
        assert_array_equal(values(kernel, [2.5, 2.6, 1e9], 3), 0)
        assert values(kernel, [0.99 * radius], 3) > 0
    else:
        assert radius == np.inf
        assert values(kernel, [30.0], 3) > 0


# --- matrices -----------------------------------------------------------------------


@every_kernel
def test_symmetric_with_ones_on_the_diagonal(make):
    X = np.random.default_rng(0).normal(100, 1, (40, 3))
    X[7] = X[3]
    kernel = make(beta=1.3)
    K = kernel(X)
    assert_array_equal(K, K.T)
    assert_array_equal(K, kernel(X, X))
    assert_array_equal(np.diag(K), 1)
    assert_array_equal(kernel.diag(X), 1)
    assert K[7, 3] == 1
    assert K[7, 4] < 1
    assert kernel.is_stationary()


@every_kernel
def test_value_is_a_function_of_the_distance_over_beta(make):
    rng = np.random.default_rng(1)
    X, Y = rng.normal(size=(15, 3)), rng.normal(size=(10, 3))
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    expected = make()(X, Y)
    assert np.ptp(expected) > 0.1
    # Coordinates below ten make errors of 1e-15 in the distances, and no kernel is
    # steeper than three.
    moved = make()(X @ rotation + 5, Y @ rotation + 5)
    assert_allclose(moved, expected, rtol=0, atol=1e-13)
    # Powers of two scale without rounding, also where the squares leave the doubles.
    for scale in (2.0, 2.0**-600, 2.0**600):
        assert_array_equal(make(beta=scale)(X * scale, Y * scale), expected)


@every_kernel
def test_input_is_not_written_to(make):
    X = np.random.default_rng(2).normal(size=(6, 2))
    before = X.copy()
    make(beta=1.0)(X, eval_gradient=True)
    make(beta=1.0)(X, X)
    assert_array_equal(X, before)


@every_kernel
def test_huge_and_tiny_distances(make):
    X = np.array([[0.0, 0], [1, 0], [0, -1], [1, 1]])
    K, gradient = make()(1e70 * X, eval_gradient=True)
    assert_allclose(K, np.eye(4), rtol=0, atol=1e-69)
    assert_allclose(gradient, 0, rtol=0, atol=1e-69)
    K, gradient = make()(1e-200 * X, eval_gradient=True)
    assert_array_equal(K, 1)
    assert_array_equal(gradient, 0)
    assert_array_equal(make()(1e70 * X, 1e-200 * X)[0], 1)


@pytest.mark.parametrize("beta", [1.0, 1e-300, np.float64(1e-300)])
def test_states_whose_profile_could_overflow_are_refused(beta):
    kernel = MaternSobolev(beta)
    for sign in (1.0, -1.0):
        X = sign * np.array([[0.0, 0.0], [1.1e70 * beta, 0.0]])
        message = r"up to .*1e\+70 times beta=.*rescale the states.*or raise beta"
        with pytest.raises(ValueError, match=message):
            kernel(X)
        with pytest.raises(ValueError, match=message):
            kernel(0 * X, X)
    with pytest.raises(ValueError, match=r"up to 1e\+200"):
        kernel([[1e200, 0.0]])


# --- gradients and hyperparameters --------------------------------------------------


def central_difference(kernel, X, step=1e-5):
    return np.stack(
        [
            (
                kernel.clone_with_theta(kernel.theta + step * unit)(X)
                - kernel.clone_with_theta(kernel.theta - step * unit)(X)
            )
            / (2 * step)
            for unit in np.eye(kernel.n_dims)
        ],
        axis=-1,
    )


@every_kernel
@pytest.mark.parametrize("n_features", [1, 2, 3, 8])
def test_gradient_is_the_finite_difference(make, n_features):
    X = np.random.default_rng(n_features).normal(size=(14, n_features))
    X[5] = X[4]
    X[6] += 1e3
    kernel = make(beta=2.1 * np.sqrt(n_features))
    K, gradient = kernel(X, eval_gradient=True)
    assert_array_equal(K, kernel(X))
    assert gradient.shape == (14, 14, 1)
    assert np.abs(gradient).max() > 0.1
    assert_allclose(gradient, central_difference(kernel, X), rtol=0, atol=2e-9)
    assert_array_equal(gradient[[4, 5, 4], [4, 5, 5]], 0)


@pytest.mark.parametrize("smoothness", [2, 4, 6])
def test_gradient_vanishes_at_and_outside_the_support(smoothness):
    X = np.array([[0.0], [2.0], [4.0], [4.5]])
    K, gradient = Wendland(2.0, smoothness)(X, eval_gradient=True)
    outside = cdist(X, X) >= 2
    assert_array_equal(K[outside], 0)
    assert_array_equal(gradient[outside], 0)
    assert gradient[2, 3, 0] > 0


@every_kernel
def test_fixed_beta_has_no_gradient(make):
    kernel = make(beta=0.7, beta_bounds="fixed")
    X = np.arange(10.0).reshape(5, 2)
    K, gradient = kernel(X, eval_gradient=True)
    assert gradient.shape == (5, 5, 0)
    assert kernel.theta.size == kernel.n_dims == 0
    assert_array_equal(K, make(beta=0.7)(X))


@every_kernel
def test_theta_round_trip(make):
    kernel = make(beta=0.7, beta_bounds=(0.01, 50))
    assert_allclose(kernel.theta, [np.log(0.7)], rtol=1e-15)
    assert_allclose(kernel.bounds, np.log([[0.01, 50]]), rtol=1e-15)
    other = kernel.clone_with_theta([np.log(3)])
    assert_allclose(other.beta, 3, rtol=1e-15)
    assert kernel.beta == 0.7
    same = {name: value for name, value in other.get_params().items() if name != "beta"}
    assert same.items() <= kernel.get_params().items()
    assert other != kernel
    assert clone(kernel) == kernel


def test_kernels_with_other_parameters_differ():
    assert MaternSobolev(nu=0.5) != MaternSobolev(nu=1.5)
    assert Wendland(smoothness=2) != Wendland(smoothness=4)
    assert Wendland(dimension=3) != Wendland(dimension=4)
    assert Gaussian() != InverseMultiquadric()


def test_composed_kernels():
    X = np.random.default_rng(3).normal(size=(12, 2))
    W, M, G = Wendland(3.0, 4), MaternSobolev(0.8, 2.5), Gaussian(1.7)
    kernel = 2.0 * W + M * G**2 + WhiteKernel(0.1)
    expected = 2 * W(X) + M(X) * G(X) ** 2 + 0.1 * np.eye(12)
    K, gradient = kernel(X, eval_gradient=True)
    assert_allclose(K, expected, rtol=1e-14)
    assert_allclose(kernel.diag(X), 3.1, rtol=1e-14)
    assert gradient.shape == (12, 12, 5)
    assert_allclose(gradient, central_difference(kernel, X), rtol=0, atol=2e-9)
    assert clone(kernel) == kernel
    again = clone(kernel).set_params(k1__k1__k2__beta=5.0)
    assert_allclose(again(X), expected - 2 * W(X) + 2 * Wendland(5.0, 4)(X), rtol=1e-13)
    again = again.clone_with_theta(np.log([2, 3, 0.8, 1.7, 0.1]))
    assert_allclose(again(X), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("kernel", "shown"),
    [
        (MaternSobolev(0.5, 2.5), "MaternSobolev(beta=0.5, nu=2.5)"),
        (Gaussian(1 / 3), "Gaussian(beta=0.333333)"),
        (InverseMultiquadric(2.0), "InverseMultiquadric(beta=2)"),
        (
            2.0**2 * Wendland(3.0, 4, dimension=5),
            "2**2 * Wendland(beta=3, smoothness=4, dimension=5)",
        ),
    ],
)
def test_repr(kernel, shown):
    assert repr(kernel) == shown


# --- Gaussian processes -------------------------------------------------------------


# A line search that stops at the rounding of the likelihood warns.
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@every_kernel
def test_gaussian_process_optimises_the_scale(make):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (50, 2))
    y = np.sin(2 * X[:, 0]) + X[:, 1] ** 2 / 4 + 0.03 * rng.normal(size=50)
    kernel = ConstantKernel(1.0) * make(beta=0.4)
    gp = GaussianProcessRegressor(kernel, alpha=1e-3).fit(X, y)
    start, end = gp.kernel.theta, gp.kernel_.theta
    assert gp.log_marginal_likelihood(end) > gp.log_marginal_likelihood(start) + 5

    # At a generic point, and nearly zero at the optimum.
    theta = start + np.array([0.3, 0.5])
    _, gradient = gp.log_marginal_likelihood(theta, eval_gradient=True)
    numeric = [
        (
            gp.log_marginal_likelihood(theta + 1e-5 * unit)
            - gp.log_marginal_likelihood(theta - 1e-5 * unit)
        )
        / 2e-5
        for unit in np.eye(2)
    ]
    assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-5)
    _, gradient = gp.log_marginal_likelihood(end, eval_gradient=True)
    assert np.abs(gradient).max() < 0.05


@pytest.mark.parametrize(
    "truth", [MaternSobolev(0.8), Wendland(2.5, 2), Gaussian(0.5)], ids=repr
)
def test_gaussian_process_recovers_the_scale(truth):
    rng = np.random.default_rng(5)
    X = rng.uniform(0, 5, (100, 2))
    y = np.linalg.cholesky(truth(X) + 1e-3 * np.eye(100)) @ rng.normal(size=(100, 4))
    bounds = (truth.beta / 10, truth.beta * 10)
    for start in (0.5, 2.0):
        kernel = clone(truth)
        kernel.set_params(beta=start * truth.beta, beta_bounds=bounds)
        gp = GaussianProcessRegressor(kernel, alpha=1e-3).fit(X, y)
        assert_allclose(gp.kernel_.beta, truth.beta, rtol=0.1)


# --- bad parameters -----------------------------------------------------------------


@every_kernel
def test_bad_beta(make):
    for beta in (0, -1.5, np.nan, np.inf, "1", None):
        message = rf"^beta must be .*positive.*got {beta!r}\."
        with pytest.raises(ValueError, match=message):
            make(beta=beta)(np.eye(2))


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        (MaternSobolev(nu=1), r"^nu must be one of 0.5, 1.5, 2.5, 3.5, got 1\."),
        (MaternSobolev(nu=np.inf), r"^nu must be .*got inf\."),
        (MaternSobolev(nu="3/2"), r"^nu must be .*got '3/2'\."),
        (MaternSobolev(nu=[1.5]), r"^nu must be .*got \[1.5\]\."),
        (Wendland(smoothness=1), r"^smoothness must be one of 0, 2, 4, 6, got 1\."),
        (Wendland(smoothness=8), r"^smoothness must be .*got 8\."),
        (Wendland(smoothness="c2"), r"^smoothness must be .*got 'c2'\."),
        (Wendland(dimension=1), r"dimension=1.* 2 features"),
        (Wendland(dimension=0), r"dimension must be .* got 0"),
    ],
)
def test_bad_shape_parameters(kernel, message):
    with pytest.raises(ValueError, match=message):
        kernel(np.eye(2))
    with pytest.raises(ValueError, match=message):
        kernel(np.eye(2), eval_gradient=True)


def test_gradient_needs_one_argument():
    with pytest.raises(ValueError, match="Y=None"):
        Gaussian()(np.eye(2), np.eye(2), eval_gradient=True)


# --- names --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "kernel"),
    [
        ("matern12", MaternSobolev(nu=0.5)),
        ("matern32", MaternSobolev(nu=1.5)),
        ("matern52", MaternSobolev(nu=2.5)),
        ("wendland_c0", Wendland(smoothness=0, dimension=4)),
        ("wendland_c2", Wendland(smoothness=2, dimension=4)),
        ("wendland_c4", Wendland(smoothness=4, dimension=4)),
        ("wendland_c6", Wendland(smoothness=6, dimension=4)),
        ("gaussian", Gaussian()),
        ("inverse_multiquadric", InverseMultiquadric()),
    ],
)
def test_as_kernel_by_name(name, kernel):
    assert as_kernel(name, None, 4) == kernel
    assert as_kernel(name, 0.3, 4) == clone(kernel).set_params(beta=0.3)


def test_every_name_is_tested():
    mark = next(m for m in test_as_kernel_by_name.pytestmark if m.name == "parametrize")
    assert [name for name, _ in mark.args[1]] == list(KERNELS)


def test_as_kernel_copies():
    given = Wendland(2.0, 4)
    kernel = as_kernel(given, 5.0, 7)
    assert kernel == Wendland(5.0, 4, dimension=7)
    assert given == Wendland(2.0, 4)
    assert as_kernel(given, None, 7).beta == 2.0
    foreign = kernels.RBF(3.0)
    assert as_kernel(foreign, None, 2) == foreign
    assert as_kernel(foreign, None, 2) is not foreign


def test_as_kernel_sets_the_dimension_of_wendland():
    # Behind distances alone it is that of the paper's polynomials.
    assert as_kernel("wendland_c2", None, None).dimension == 3
    assert as_kernel(Wendland(dimension=9), None, 2).dimension == 9
    nested = (2.0 * Wendland(3.0) + WhiteKernel()) ** 2 + Wendland(dimension=8)
    parts = as_kernel(nested, None, 5).get_params()
    dimensions = [p.dimension for p in parts.values() if isinstance(p, Wendland)]
    assert sorted(dimensions) == [5, 8]
    assert nested.k1.kernel.k1.k2.dimension is None


@pytest.mark.parametrize(
    ("kernel", "beta", "message"),
    [
        ("matern", None, "^kernel must be one of matern12, .*got 'matern'"),
        (None, None, "^kernel must be one of matern12, .*got None"),
        (MaternSobolev, None, "^kernel must be .*got <class"),
        (np.exp, 1.0, "^kernel must be .*got <ufunc 'exp'>"),
        (kernels.RBF(), 2.0, r"^beta=2.0 .*kernel=RBF.*beta=None"),
        (Gaussian() + WhiteKernel(), 2.0, r"^beta=2.0 .*kernel=Gaussian.*beta=None"),
        ("gaussian", 0, "^beta must be .*got 0"),
        ("matern32", np.nan, "^beta must be .*got nan"),
        ("wendland_c2", "wide", "^beta must be .*got 'wide'"),
        (MaternSobolev(-2.0), None, "^beta must be .*got -2.0"),
        (3.0 * Gaussian(-2.0) + WhiteKernel(), None, "^beta must be .*got -2.0"),
    ],
)
def test_as_kernel_errors(kernel, beta, message):
    with pytest.raises(ValueError, match=message):
        as_kernel(kernel, beta, 2)


class Cauchy(RadialKernel):
    def profile(self, r, n_features, out=None):
        return 1 / (1 + r**2)

    def log_gradient(self, r, n_features):
        return 2 * r**2 / (1 + r**2) ** 2

    def sobolev_order(self, n_features):
        return np.inf


class Hat(RadialKernel):
    """Compact support, with a parameter of its own."""

    def __init__(self, beta=1.0, power=2, beta_bounds=(1e-5, 1e5)):
        super().__init__(beta, beta_bounds)
        self.power = power

    @property
    def support_radius(self):
        return self.beta

    def profile(self, r, n_features, out=None):
        return np.maximum(1 - r, 0) ** self.power

    def log_gradient(self, r, n_features):
        return self.power * r * np.maximum(1 - r, 0) ** (self.power - 1)

    def sobolev_order(self, n_features):
        return (n_features + 1) / 2


@pytest.mark.parametrize("solver", ["auto", ConjugateGradient(tol=1e-13)])
@pytest.mark.parametrize(
    ("own", "same"),
    [
        (Cauchy(1.3), kernels.RationalQuadratic(1.3 / np.sqrt(2), 1.0)),
        (Hat(1.3), Wendland(1.3, 0, dimension=3)),
    ],
)
def test_estimators_take_kernels_of_one_s_own(own, same, solver):
    """Their profiles return new arrays, and leave `out` as it is."""
    rng = np.random.default_rng(5)
    X, y = rng.uniform(size=(60, 3)), rng.normal(size=60)
    for method in ("interpolation", "least_squares"):
        options = {"method": method, "alpha": 0.1, "solver": solver}
        predicted, expected = (
            KoopmanKernelRegressor(kernel, **options).fit(X, y).predict(X + 0.05)
            for kernel in (own, same)
        )
        assert_allclose(predicted, expected, rtol=1e-7, atol=1e-9)


def test_kernels_of_one_s_own():
    """A subclass needs its profile and gradient only."""
    X = np.random.default_rng(4).normal(size=(8, 2))
    kernel = as_kernel(Cauchy(), 2.0, 2)
    _, gradient = kernel(X, eval_gradient=True)
    assert_allclose(kernel(X), kernels.RationalQuadratic(2 / np.sqrt(2), 1.0)(X))
    assert_allclose(gradient, central_difference(kernel, X), rtol=0, atol=2e-9)
    assert repr(kernel) == "Cauchy(beta=2)"
