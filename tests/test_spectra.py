"""Spectra of the operator against closed forms, quadrature and long simulations.

Reached accuracies, where they are not plain statistics: a whitened operator carries
rounding errors of about eps / sqrt(rcond_), times the condition of the eigenvalue, and
the tolerances for exact dictionaries are that with a factor for the condition.
"""

import math
import warnings
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from designs import every_pair
from numpy.polynomial.hermite_e import hermegauss, hermeval
from numpy.testing import assert_allclose
from reference import dense_interpolant, kernel_matrix, monomials
from scipy import linalg
from sklearn.gaussian_process.kernels import DotProduct

from sklearn_koopman import KernelEDMD, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

METHODS = ["interpolation", "least_squares"]


def nearest(model, wanted):
    """Places of the eigenvalues nearest to the wanted ones, and their distances."""
    distance = np.abs(model.eigenvalues_ - np.asarray(wanted)[:, np.newaxis])
    return distance.argmin(axis=1), distance.min(axis=1)


def assert_in_order(model):
    """The most trustworthy come first, and conjugates are side by side."""
    lam, residuals = model.eigenvalues_, model.residuals_
    distrust = residuals / np.abs(lam)
    assert (np.diff(distrust) >= -1e-14 * distrust[1:]).all()
    first = np.flatnonzero(lam.imag > 0)
    assert (lam.imag < 0).sum() == len(first)
    assert (lam[first + 1] == lam[first].conj()).all()
    assert (residuals[first + 1] == residuals[first]).all()


def root_mean_square(values):
    return np.sqrt(np.square(np.abs(values)).mean(axis=0))


# --- Linear and affine maps ----------------------------------------------------------


def linear_maps():
    rng = np.random.default_rng(7)
    maps = {}
    for d in (1, 2, 3, 6):
        F = rng.standard_normal((d, d))
        maps[f"stable{d}"] = F * 0.9 / np.abs(np.linalg.eigvals(F)).max()
    V = rng.standard_normal((3, 3))
    maps["real"] = V @ np.diag([0.95, 0.6, -0.4]) @ np.linalg.inv(V)
    F = rng.standard_normal((3, 3))
    maps["unstable"] = F * 1.05 / np.abs(np.linalg.eigvals(F)).max()
    return maps


LINEAR = linear_maps()


def pairs_of(F, fixed_point, kind):
    """States round the fixed point: scattered pairs, or 30 trajectories of 4 rows.

    Without its fixed point in the domain the spectrum of an affine map would be
    continuous: |x - x*|^a is smooth away from x*, and has the eigenvalue lambda^a.
    """
    rng = np.random.default_rng(len(F))
    starts = rng.uniform(-2, 2, (120 if kind == "scattered" else 30, len(F)))
    if kind == "scattered":
        return starts + fixed_point, {"X_next": starts @ F.T + fixed_point}
    rows = np.stack([starts @ np.linalg.matrix_power(F.T, s) for s in range(4)], axis=1)
    clock = 5 * np.arange(30)[:, np.newaxis] + np.arange(4)
    X = rows.reshape(-1, len(F)) + fixed_point
    return X, {"sample_index": clock.ravel()}


# Separated centres bear smooth kernels. The others are as near to each other as they
# happen to be, and would not.
KERNELS = {
    "all": [("matern32", 1.0), ("wendland_c2", 2.0)],
    "selector": [("gaussian", 0.3), ("wendland_c4", 2.0)],
    "array": [("matern32", 1.0), ("wendland_c2", 2.0)],
}


def centers_of(X, form):
    if form == "selector":
        return SeparatedCenterSelector(0.3)
    # Three of four rows, as the last of a trajectory has no successor.
    return None if form == "all" else X[np.arange(120) % 4 != 3][:60]


def rounding_of_matrix(model):
    """Return the size of rounding errors in the whitened matrix of M rows.

    Its entries have errors of eps / sqrt(rcond_), as its largest eigenvalues are of
    size one. The factor of 10 M stands for the sums in products and the QR algorithm.
    """
    error = np.finfo(float).eps / np.sqrt(model.rcond_)
    return 10 * len(model.koopman_matrix_) * error


def rounding_of_eigenvalues(model, wanted):
    """Return what rounding may move the eigenvalues near the wanted ones by.

    Errors of the matrix move a simple eigenvalue by their size times its condition
    number, the reciprocal cosine between its left and its right eigenvector. Errors of
    eigenfunctions and forecasts are proportional to this, too.
    """
    values, left, right = linalg.eig(model.koopman_matrix_, left=True)
    places = np.abs(values - np.asarray(wanted)[:, np.newaxis]).argmin(axis=1)
    condition = 1 / np.abs((left.conj() * right).sum(axis=0))[places]
    return condition.max() * rounding_of_matrix(model)


@every_pair(
    name=LINEAR, method=METHODS, kind=["scattered", "trajectories"], form=KERNELS
)
def test_affine_map_is_found_exactly(name, method, kind, form):
    """The polynomials are invariant, so that only rounding is left, also far ahead."""
    F = LINEAR[name]
    d = len(F)
    fixed_point = np.linspace(0.3, -0.2, d)
    X, successors = pairs_of(F, fixed_point, kind)
    start = np.random.default_rng(1).uniform(-2, 2, (5, d))
    exact = np.stack(
        [start @ np.linalg.matrix_power(F.T, s) for s in range(1, 61)], axis=1
    )
    for kernel, beta in KERNELS[form]:
        model = KernelEDMD(
            kernel,
            beta=beta,
            centers=centers_of(X, form),
            method=method,
            trend="linear",
        ).fit(X, **successors)
        exact_values = np.r_[1, np.linalg.eigvals(F)]
        places, distances = nearest(model, exact_values)
        # At the worst rcond_ among these, 4e-10, eps / sqrt(rcond_) is 1e-11.
        tolerance = min(rounding_of_eigenvalues(model, exact_values), 1e-10)
        assert distances.max() < tolerance
        assert model.residuals_[places].max() < tolerance
        forecast = model.forecast(start + fixed_point, n_steps=60) - fixed_point
        assert np.abs(forecast - exact).max() < tolerance * np.abs(exact).max()
        assert_in_order(model)


@pytest.mark.parametrize("kind", ["scattered", "trajectories"])
@pytest.mark.parametrize("method", METHODS)
def test_defective_map_splits_its_eigenvalue_by_the_root_of_rounding(method, kind):
    """As any algorithm does; the sum of both, and the forecast, are exact."""
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((2, 2)))[0]
    F = turn @ np.array([[0.8, 1.0], [0.0, 0.8]]) @ turn.T
    X, successors = pairs_of(F, np.zeros(2), kind)
    model = KernelEDMD(
        "wendland_c4",
        beta=2.0,
        centers=SeparatedCenterSelector(0.3),
        method=method,
        trend="linear",
    ).fit(X, **successors)
    # Both copies: those of smallest residual among the eigenvalues near 0.8.
    near = np.flatnonzero(np.abs(model.eigenvalues_ - 0.8) < 1e-6)
    assert len(near) == 2
    # The mean of both moves by the error of the matrix times the norm of the spectral
    # projector, which is a few here.
    tolerance = 10 * rounding_of_matrix(model)
    assert tolerance < 1e-10
    assert_allclose(model.eigenvalues_[near].mean(), 0.8, rtol=0, atol=tolerance)
    assert model.residuals_[near].max() < tolerance
    start = np.random.default_rng(1).uniform(-2, 2, (5, 2))
    exact = np.stack(
        [start @ np.linalg.matrix_power(F.T, s) for s in range(1, 61)], axis=1
    )
    # The error of each step grows by |F^s| afterwards, which is below 2.5.
    steps = model.forecast(start, n_steps=60)
    assert_allclose(steps, exact, rtol=0, atol=60 * 2.5 * tolerance)


ROTATING = np.array([[0.9, -0.3], [0.2, 0.7]])


@pytest.mark.parametrize("method", METHODS)
def test_polynomial_kernel_has_exactly_the_products_of_eigenvalues(method):
    """Its native space is the cubic polynomials, which a linear map leaves invariant.

    Their ten eigenfunctions are the products of the two linear ones.
    """
    X = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    model = KernelEDMD(DotProduct(1.0) ** 3, centers=X[:10], method=method)
    model.fit(X, X_next=X @ ROTATING.T)
    lam, left = np.linalg.eig(ROTATING.T)
    X_new = np.random.default_rng(1).uniform(-1, 1, (50, 2))
    linear_now = X_new @ left
    factors = [
        list(chosen)
        for degree in range(4)
        for chosen in combinations_with_replacement(range(2), degree)
    ]
    assert len(model.eigenvalues_) == len(factors) == 10
    products = [lam[chosen].prod() for chosen in factors]
    places, distances = nearest(model, products)
    assert sorted(places) == list(range(10))
    tolerance = rounding_of_eigenvalues(model, products)
    assert tolerance < 1e-9
    assert distances.max() < tolerance
    assert model.residuals_.max() < tolerance
    phi = model.eigenfunctions(X_new)[:, places]
    exact = np.column_stack([linear_now[:, chosen].prod(axis=1) for chosen in factors])
    exact *= (exact.conj() * phi).sum(axis=0) / np.square(np.abs(exact)).sum(axis=0)
    # Eigenfunctions turn by the error over the gap to the next eigenvalue.
    gap = np.min(np.abs(np.subtract.outer(products, products) + 9 * np.eye(10)))
    assert_allclose(phi, exact, rtol=0, atol=10 * tolerance / gap)
    assert_in_order(model)


@pytest.mark.parametrize(
    ("method", "accuracy"), [("interpolation", 3e-5), ("least_squares", 3e-3)]
)
def test_radial_kernel_approximates_the_products_of_eigenvalues(method, accuracy):
    """Quadratic functions are approximated only, above all near the boundary.

    Interpolation has the better eigenvalues with as many centres as rows, and its
    residual, the error off the centres, is far above the error of the eigenvalue.
    """
    X = np.random.default_rng(0).uniform(-1, 1, (200, 2))
    centers = None if method == "interpolation" else X[:100]
    model = KernelEDMD(
        "wendland_c6", beta=6.0, centers=centers, method=method, trend="linear"
    ).fit(X, X_next=X @ ROTATING.T)
    lam = np.linalg.eigvals(ROTATING)
    places, distances = nearest(model, [lam[0] ** 2, lam[0] * lam[1], lam[1] ** 2])
    assert distances.max() < accuracy
    assert model.residuals_[places].max() < 5e-4
    assert (places < 20).all()
    assert_in_order(model)


def test_a_regular_grid_of_states_is_no_trajectory_on_another_scale():
    """Its rows do not follow each other, so that an affine map is no sign of units."""
    X = np.linspace(-1, 1, 21)[:, np.newaxis]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = KernelEDMD(trend="linear").fit(X, X_next=0.8 * X)
    assert nearest(model, [1.0, 0.8])[1].max() < 1e-12


# --- Rotation of the circle ----------------------------------------------------------

OMEGA = 2 * np.pi * (np.sqrt(5) - 1) / 2 * 0.3


def on_circle(theta):
    return np.column_stack([np.cos(theta), np.sin(theta)])


@pytest.mark.parametrize("trend", [None, "linear"])
@pytest.mark.parametrize(
    ("kernel", "beta", "centers", "method", "accuracy"),
    [
        # By what each reaches for k = 0, 1, ..., with a factor of three.
        (
            "wendland_c6",
            4.0,
            None,
            "interpolation",
            [1e-10, 1e-10, 3e-10, 2e-9, 1e-8, 4e-8],
        ),
        (
            "gaussian",
            1.0,
            SeparatedCenterSelector(0.25),
            "interpolation",
            [1e-9, 3e-9, 1e-8, 3e-7, 3e-6, 2e-5],
        ),
        (
            "gaussian",
            1.0,
            SeparatedCenterSelector(0.25),
            "least_squares",
            [3e-10, 1e-9, 3e-9, 3e-8, 3e-7, 3e-6],
        ),
    ],
)
def test_rotation_has_powers_of_one_phase(
    kernel, beta, centers, method, accuracy, trend
):
    """exp(i k omega), with eigenfunctions exp(i k theta).

    These are compared as they are: of mean square one, and positive at the first row,
    where theta is zero.
    """
    model = KernelEDMD(
        kernel, beta=beta, centers=centers, method=method, trend=trend
    ).fit(on_circle(OMEGA * np.arange(81)))
    k = np.arange(len(accuracy))
    places, distances = nearest(model, np.exp(1j * k * OMEGA))
    assert (distances < accuracy).all()
    if trend == "linear":
        assert distances[:2].max() < 1e-13
    # The order is that of the wave numbers: the constant, then pairs. With a linear
    # trend k = 0 and k = 1 are both exact, and rounding orders their residuals.
    exact = 2 if trend == "linear" else 0
    assert ((places + 1) // 2 == k)[exact:].all()
    assert places[:exact].max(initial=0) <= 2
    resolved, unresolved = model.residuals_[places], model.residuals_[-2:]
    assert (resolved < 300 * np.array(accuracy)).all()
    assert resolved[:4].max() < 1e-3 * unresolved.min()
    theta = np.random.default_rng(0).uniform(0, 2 * np.pi, 200)
    phi = model.eigenfunctions(on_circle(theta))[:, places]
    error = np.abs(phi - np.exp(1j * theta[:, np.newaxis] * k)).max(axis=0)
    assert (error < 300 * np.array(accuracy)).all()
    assert_in_order(model)


# --- Random maps ---------------------------------------------------------------------

RHO = 0.8


def hermite(k, x):
    """Hermite polynomials of mean square one under the normal distribution."""
    return hermeval(x, np.eye(k + 1)[k]) / math.sqrt(math.factorial(k))


def ornstein_uhlenbeck_errors(k):
    """Standard errors, times sqrt(n), of the estimates from n independent pairs.

    By perturbation to first order: of the eigenvalue, the residual and the sine of the
    angle between eigenfunctions. Means are by quadrature, exact for polynomials.
    """
    node, weight = hermegauss(40)
    weight = weight / weight.sum()
    x, y = node[:, np.newaxis], RHO * node[:, np.newaxis] + np.sqrt(1 - RHO**2) * node
    mean = weight[:, np.newaxis] * weight
    lam = RHO**k
    defect = hermite(k, y) - lam * hermite(k, x)
    variances = [(mean * (hermite(j, x) * defect) ** 2).sum() for j in range(8)]
    eigenvalue = math.sqrt(variances.pop(k))
    gaps = [RHO**j - lam for j in range(8) if j != k]
    angle = math.sqrt(sum(np.array(variances) / np.square(gaps)))
    residual = 0.0
    if k:
        square = defect**2 - (1 - lam**2) * hermite(k, x) ** 2
        residual = math.sqrt((mean * square**2).sum() / (1 - lam**2)) / 2
    return eigenvalue, residual, angle


def test_ornstein_uhlenbeck_has_powers_of_the_correlation():
    """With Hermite polynomials, and the residual of a true eigenvalue of noise."""
    rng = np.random.default_rng(0)
    n = 150_000
    x = rng.standard_normal((n, 1))
    y = RHO * x + np.sqrt(1 - RHO**2) * rng.standard_normal((n, 1))
    model = KernelEDMD(
        "wendland_c6",
        beta=8.0,
        centers=np.linspace(-3.5, 3.5, 11)[:, np.newaxis],
        method="least_squares",
    ).fit(x, X_next=y)
    assert_in_order(model)
    places, distances = nearest(model, RHO ** np.arange(4))
    assert places.tolist() == [0, 1, 2, 3]
    phi = model.eigenfunctions(x)
    for k in range(4):
        errors = 4 * np.array(ornstein_uhlenbeck_errors(k)) / math.sqrt(n)
        # The dictionary approximates the constant, too: to 1e-3 in the tails.
        errors = np.maximum(errors, [1e-6, 2e-3, 3e-3])
        assert distances[k] < errors[0]
        assert abs(model.residuals_[k] - math.sqrt(1 - RHO ** (2 * k))) < errors[1]
        cosine = abs((phi[:, k] * hermite(k, x[:, 0])).mean())
        cosine /= root_mean_square(phi[:, k]) * root_mean_square(hermite(k, x[:, 0]))
        assert math.sqrt(1 - min(cosine, 1.0) ** 2) < errors[2]


def logistic(x, a):
    return a * x * (1 - x)


def noisy_logistic_spectrum(a, power, n_modes):
    """Leading eigenvalues and their standard errors, times sqrt(n), by quadrature.

    The successor has the density c cos(pi (f(x) - y))^power on [0, 1), the noise of
    Ostruszka et al. (Phys. Lett. A 2000). Gauss-Legendre nodes turn the operator into
    a matrix. An eigenvalue estimated from a stationary trajectory is off by the mean of
    l(x) (v(y) - lambda v(x)), over that of l v, with the eigenfunction v, and l that
    of the adjoint: uncorrelated terms.
    """
    node, weight = np.polynomial.legendre.leggauss(300)
    node, weight = (node + 1) / 2, weight / 2
    density = np.cos(np.pi * (logistic(node, a)[:, np.newaxis] - node)) ** power
    P = density * (2.0**power / math.comb(power, power // 2)) * weight
    assert_allclose(P.sum(axis=1), 1, rtol=1e-12)
    lam, v = np.linalg.eig(P)
    order = np.argsort(-np.abs(lam))[:n_modes]
    lam, v = lam[order], v[:, order]
    left_lam, left = np.linalg.eig(P.T)
    left = left[:, np.abs(left_lam[:, np.newaxis] - lam).argmin(axis=0)]
    stationary = np.abs(left[:, 0] / left[:, 0].sum())
    variance = (P @ np.square(np.abs(v))) - np.square(np.abs(lam * v))
    ratio = np.square(np.abs(left)) / stationary[:, np.newaxis]
    square = (ratio * variance).sum(axis=0) / np.square(np.abs((left * v).sum(axis=0)))
    return lam, np.sqrt(np.maximum(square, 0))


def noisy_logistic_trajectory(a, power, n):
    rng = np.random.default_rng(0)
    noise = rng.uniform(-0.5, 0.5, 20 * n)
    noise = noise[rng.uniform(size=len(noise)) < np.cos(np.pi * noise) ** power]
    rows, x = [], 0.3
    for e in noise[: n + 1].tolist():
        rows.append(x)
        x = (logistic(x, a) + e) % 1.0
    assert len(rows) == n + 1
    return np.array(rows)[:, np.newaxis]


@pytest.mark.parametrize(
    ("a", "n_modes"),
    [
        (3.2, 4),  # near a cycle of period two: real, of either sign
        (4.0, 3),  # chaotic: a complex pair, with eigenfunctions far from normal
    ],
)
def test_noisy_logistic_map_has_the_spectrum_of_its_transfer_operator(a, n_modes):
    n = 40_000
    lam, errors = noisy_logistic_spectrum(a, 100, n_modes)
    X = noisy_logistic_trajectory(a, 100, n)
    model = KernelEDMD(
        "gaussian",
        beta=0.12,
        centers=np.linspace(X.min(), X.max(), 16)[:, np.newaxis],
        method="least_squares",
    ).fit(X)
    places, distances = nearest(model, lam)
    assert sorted(places) == list(range(n_modes))
    # 1e-6: how far the dictionary is from containing the constant.
    assert (distances < 4 * errors / math.sqrt(n) + 1e-6).all()
    assert_in_order(model)


# --- Pendulum ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def orbit():
    """The orbit that the samples are from, by a loop of its own, and its frequency.

    The angle round the rest position advances by a quasi-periodic function of time,
    whose mean, weighted by a smooth bump, converges faster than any power of time:
    100,000 steps and 50,000 steps differ by 1e-15.
    """
    p, q, h = 0.0, 2.0, 0.1
    rows = []
    for _ in range(100_000):
        rows.append((p, q))
        half = p - h / 2 * math.sin(q)
        q += h * half
        p = half - h / 2 * math.sin(q)
    rows = np.array(rows)
    steps = np.diff(np.unwrap(np.arctan2(rows[:, 1], rows[:, 0])))
    time = (np.arange(len(steps)) + 0.5) / len(steps)
    bump = np.exp(-1 / (time * (1 - time)))
    return rows, float(steps @ bump / bump.sum()) / (2 * np.pi * h)


@cache
def samples_of_pendulum(n_samples):
    return make_pendulum(n_samples=n_samples, step=0.1)


def test_orbit_is_the_one_of_the_dataset(orbit):
    rows, frequency = orbit
    assert_allclose(make_pendulum(n_samples=300).X, rows[:300], rtol=0, atol=1e-12)
    # Another way to count: the times of upward crossings, interpolated.
    q = rows[:, 1]
    up = np.flatnonzero((q[:-1] < 0) & (q[1:] >= 0))
    times = 0.1 * (up - q[up] / (q[up + 1] - q[up]))
    assert_allclose((len(up) - 1) / (times[-1] - times[0]), frequency, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("n_samples", "separation", "kernel", "beta", "accuracy"),
    [
        # Of frequencies 1, 2, 3, relative, and of their residuals. The smoother the
        # kernel and the more centres, the better, down to rounding.
        (256, 0.23, "matern32", 2.0, [3e-4, 7e-4, 1e-3, 3e-4, 1e-3, 3e-3]),
        (256, 0.23, "wendland_c4", 4.0, [1e-4, 4e-4, 1e-3, 1e-4, 4e-4, 1e-3]),
        (256, 0.23, "wendland_c6", 4.0, [6e-5, 2e-4, 5e-4, 5e-5, 2e-4, 6e-4]),
        (4000, 0.05, "wendland_c6", 4.0, [1e-10, 3e-10, 1e-9, 3e-10, 1e-9, 3e-9]),
        (4000, 0.03, "wendland_c6", 4.0, [1e-13, 3e-13, 1e-12, 2e-12, 4e-12, 8e-12]),
    ],
)
def test_pendulum_has_its_frequency_and_harmonics(
    orbit, n_samples, separation, kernel, beta, accuracy, method
):
    frequency = orbit[1]
    pendulum = samples_of_pendulum(n_samples)
    model = KernelEDMD(
        kernel, beta=beta, centers=SeparatedCenterSelector(separation), method=method
    ).fit(pendulum.X, X_next=pendulum.X_next)
    if n_samples == 256:
        assert len(model.centers_) == 37
    growth_rates, frequencies = model.continuous_eigenvalues(dt=0.1)
    harmonics = np.arange(1, 4)
    places, _ = nearest(model, np.exp(0.2j * np.pi * frequency * harmonics))
    # One constant and the harmonics with their conjugates come first.
    assert sorted(places) == [1, 3, 5] if n_samples == 256 else max(places) < 8
    relative = np.abs(frequencies[places] / (harmonics * frequency) - 1)
    assert (relative < accuracy[:3]).all()
    residuals = model.residuals_[places]
    assert (residuals < accuracy[3:]).all()
    assert residuals[0] < 1e-3
    # On an invariant curve nothing grows: what does is below the residual of a step.
    assert (np.abs(growth_rates[places]) < residuals / 0.1).all()
    assert_in_order(model)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("n_samples", "separation", "accuracy"), [(256, 0.23, 1e-3), (4000, 0.03, 1e-10)]
)
def test_eigenfunction_of_the_pendulum_is_its_phase(
    orbit, n_samples, separation, accuracy, method
):
    """It turns by omega a step at places never seen, and has modulus one there."""
    rows, frequency = orbit
    pendulum = samples_of_pendulum(n_samples)
    model = KernelEDMD(
        "wendland_c6",
        beta=4.0,
        centers=SeparatedCenterSelector(separation),
        method=method,
    ).fit(pendulum.X, X_next=pendulum.X_next)
    (place,), _ = nearest(model, [np.exp(0.2j * np.pi * frequency)])
    steps = np.arange(50_000, 52_000)
    phi = model.eigenfunctions(rows[steps])[:, place]
    assert np.abs(phi[1:] / phi[:-1] - np.exp(0.2j * np.pi * frequency)).max() < (
        accuracy
    )
    # The first row is where phi is positive: 50,000 steps later it is known where
    # phi is, if the frequency is known to eight digits.
    exact = np.exp(0.2j * np.pi * frequency * steps)
    assert np.abs(phi - exact).max() < 10 * accuracy


# --- Spurious eigenvalues ------------------------------------------------------------


every_noisy_kernel = pytest.mark.parametrize(
    "kernel", ["wendland_c4", pytest.param("matern32", marks=pytest.mark.slow)]
)


@cache
def noisy_rotation(n, separation, kernel):
    """A model of a rotation measured with noise, and its residuals on new pairs.

    The operator keeps the mean square, so that its spectrum is on the unit circle,
    and eigenvalues far from that are spurious.
    """
    rng = np.random.default_rng(1)

    def measured(theta):
        return on_circle(theta) + 0.1 * rng.standard_normal((len(theta), 2))

    centers = separation and SeparatedCenterSelector(separation)
    model = KernelEDMD(kernel, beta=1.5, centers=centers)
    model.fit(measured(OMEGA * np.arange(n + 1)))
    theta = rng.uniform(0, 2 * np.pi, 5000)
    phi = model.eigenfunctions(measured(theta))
    phi_next = model.eigenfunctions(measured(theta + OMEGA))
    defect = phi_next - model.eigenvalues_ * phi
    spurious = np.abs(np.abs(model.eigenvalues_) - 1) > 0.3
    assert spurious.sum() > 10
    return model, spurious, root_mean_square(defect) / root_mean_square(phi)


@every_noisy_kernel
@pytest.mark.parametrize(("n", "separation"), [(2000, 0.2), (300, None)])
def test_noise_makes_spurious_eigenvalues_that_are_not_trusted(kernel, n, separation):
    model, spurious, _ = noisy_rotation(n, separation, kernel)
    assert_in_order(model)
    (place,), (distance,) = nearest(model, [1.0])
    assert place == 0
    assert distance < model.residuals_[0] < 0.02
    distrust = model.residuals_ / np.abs(model.eigenvalues_)
    assert distrust[spurious].min() > 0.9


@every_noisy_kernel
@pytest.mark.parametrize(
    ("n", "separation"), [(2000, 0.2), (300, None)], ids=["selector", "all"]
)
def test_residuals_betray_spurious_eigenvalues(kernel, n, separation):
    """They claim no more than half of what the eigenfunctions miss on new pairs."""
    model, spurious, on_new_pairs = noisy_rotation(n, separation, kernel)
    assert on_new_pairs[spurious].min() > 0.7
    assert (model.residuals_ > 0.5 * on_new_pairs).all()


# --- Definition of the residual ------------------------------------------------------


@pytest.fixture(scope="module")
def twisted():
    """A smooth map of the plane that is not linear, and 90 pairs of it."""
    X = np.random.default_rng(3).uniform(-1, 1, (90, 2))
    X_next = np.column_stack([0.9 * np.sin(X[:, 0] + 0.5 * X[:, 1]), X[:, 0] * 0.8])
    return X, X_next


@pytest.mark.parametrize("alpha", [0.0, 1e-2])
@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_residuals_of_least_squares_are_their_definition(twisted, trend, alpha):
    X, X_next = twisted
    model = KernelEDMD(
        beta=1.5, centers=X[:30], method="least_squares", trend=trend, alpha=alpha
    ).fit(X, X_next=X_next)
    phi, phi_next = model.eigenfunctions(X), model.eigenfunctions(X_next)
    defect = phi_next - model.eigenvalues_ * phi
    expected = root_mean_square(defect) / root_mean_square(phi)
    assert_allclose(model.residuals_, expected, rtol=1e-9, atol=1e-12)
    assert_allclose(root_mean_square(phi), 1, rtol=1e-10)
    assert_in_order(model)


@pytest.mark.parametrize("alpha", [0.0, 1e-2])
@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_residuals_of_interpolation_are_measured_off_the_centres(twisted, trend, alpha):
    X, X_next = twisted
    model = KernelEDMD(
        beta=1.5, centers=SeparatedCenterSelector(0.3), trend=trend, alpha=alpha
    ).fit(X, X_next=X_next)
    others = np.setdiff1d(np.arange(len(X)), model.center_indices_)
    assert len(others) > len(model.centers_) > 10
    phi, phi_next = (model.eigenfunctions(x[others]) for x in (X, X_next))
    defect = phi_next - model.eigenvalues_ * phi
    expected = root_mean_square(defect) / root_mean_square(phi)
    assert_allclose(model.residuals_, expected, rtol=1e-9, atol=1e-12)
    assert_in_order(model)


def dense_estimate(X, values, X_new, trend, alpha):
    """Interpolate, or smooth, by the bordered system with Matern-3/2 of scale 1.5."""
    K = kernel_matrix("matern32", X, X, 1.5) + alpha * np.eye(len(X))
    c, b = dense_interpolant(K, monomials(X, trend), values)
    return kernel_matrix("matern32", X_new, X, 1.5) @ c + monomials(X_new, trend) @ b


def rounding_of_solutions(model):
    """Return the relative error of solutions with the Gram matrix of the model."""
    error = len(model.centers_) * np.finfo(float).eps / model.rcond_
    assert error < 1e-5
    return error


@every_pair(
    trend=[None, "constant", "linear"], alpha=[0.0, 1e-2], few_others=[False, True]
)
def test_residuals_without_other_rows_leave_out_one_centre_at_a_time(
    twisted, trend, alpha, few_others
):
    """An explicit loop over the centres, with dense solves.

    The estimate from the values of phi at the successors is lambda phi. Its error where
    a centre is left out is lambda times the uncertainty of phi, which the residual has
    once for phi and lambda times for phi o f.
    """
    X, X_next = twisted
    centers = X[:60] if few_others else None
    model = KernelEDMD(beta=1.5, centers=centers, trend=trend, alpha=alpha)
    model.fit(X, X_next=X_next)
    Xi = model.centers_
    values = model.eigenfunctions(X_next[model.center_indices_])
    if alpha == 0:
        now = model.eigenfunctions(Xi)
        assert_allclose(values, model.eigenvalues_ * now, rtol=0, atol=1e-9)
    errors = np.empty_like(values)
    for i in range(len(Xi)):
        kept = np.arange(len(Xi)) != i
        estimate = dense_estimate(Xi[kept], values[kept], Xi[i : i + 1], trend, alpha)
        errors[i] = values[i] - estimate[0]
    expected = root_mean_square(errors) / root_mean_square(model.eigenfunctions(X))
    once = model.residuals_ / np.hypot(1, 1 / np.abs(model.eigenvalues_))
    assert_allclose(once, expected, rtol=rounding_of_solutions(model), atol=1e-11)
    assert_in_order(model)


def test_as_many_other_rows_as_centres_are_enough(twisted):
    """Else one centre at a time would be left out."""
    X, X_next = twisted
    model = KernelEDMD(beta=1.5, centers=X[:45]).fit(X, X_next=X_next)
    phi, phi_next = (model.eigenfunctions(x[45:]) for x in (X, X_next))
    expected = root_mean_square(phi_next - model.eigenvalues_ * phi)
    expected /= root_mean_square(phi)
    assert_allclose(model.residuals_, expected, rtol=rounding_of_solutions(model))


def test_nothing_is_known_of_an_interpolant_that_needs_every_centre():
    """Three states in the plane determine a linear trend, and two do not."""
    X = np.random.default_rng(0).uniform(-1, 1, (3, 2))
    model = KernelEDMD(trend="linear").fit(X, X_next=0.5 * X + 0.1)
    assert_allclose(np.sort(model.eigenvalues_.real), [0.5, 0.5, 1.0], atol=1e-12)
    assert np.isinf(model.residuals_).all()


@pytest.mark.parametrize("times", [2, 7])
def test_repeated_pairs_tell_no_more_than_one(twisted, times):
    """The mean of seven equal successors differs from them by rounding."""
    X, X_next = twisted
    once = KernelEDMD(beta=1.5).fit(X, X_next=X_next)
    again = KernelEDMD(beta=1.5)
    again.fit(np.tile(X, (times, 1)), X_next=np.tile(X_next, (times, 1)))
    assert_allclose(again.residuals_, once.residuals_, rtol=1e-6)
