"""Estimates that learn batch by batch, and sums over rows that workers share."""

import copy
import pickle
import tracemalloc
import warnings

import joblib
import numpy as np
import pandas as pd
import pytest
from designs import every_pair
from hypothesis import given, settings
from hypothesis import strategies as st
from joblib.parallel import BACKENDS, ThreadingBackend
from numpy.testing import assert_allclose, assert_array_equal
from reference import (
    dense_interpolant,
    dense_least_squares,
    kernel_matrix,
    monomials,
    squared_power,
)
from scipy.linalg import LinAlgWarning, null_space, solve_triangular
from sklearn.base import clone
from sklearn.cluster import KMeans
from sklearn.exceptions import NotFittedError
from sklearn.frozen import FrozenEstimator
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    Matern,
    WhiteKernel,
)

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman._linalg._incremental import (
    MAX_ADDED_PART,
    MAX_BLOCKS,
    GrowingSystem,
)
from sklearn_koopman._linalg._least_squares import NormalEquations, sum_normal_equations
from sklearn_koopman._linalg._systems import DirectSystem
from sklearn_koopman._matrices._polynomial import DEGREES
from sklearn_koopman._matrices._sections import KernelSections
from sklearn_koopman.kernels import as_kernel
from sklearn_koopman.solvers import ConjugateGradient

TRENDS = [None, "constant", "linear"]
GIVEN = np.random.default_rng(5).uniform(size=(12, 2))
FIRST = 30  # rows that are enough to fit twelve centres with

# Settings, and whether outputs of equal rows may differ.
SETTINGS = {
    "exact": ({"beta": 1.0}, False),
    "penalised": ({"beta": 1.0, "alpha": 0.1}, True),
    "all rows": ({"beta": 1.0, "method": "least_squares"}, True),
    "all rows, penalised": (
        {"beta": 1.0, "method": "least_squares", "alpha": 0.3},
        True,
    ),
    "chosen": ({"beta": 1.0, "centers": SeparatedCenterSelector(0.15)}, True),
    "chosen, penalised": (
        {"beta": 1.0, "centers": SeparatedCenterSelector(0.1), "alpha": 0.2},
        True,
    ),
    "few chosen": (
        {"beta": 1.0, "centers": SeparatedCenterSelector(0.1, max_centers=20)},
        True,
    ),
    "fitted": ({"beta": 1.0, "centers": GIVEN, "method": "least_squares"}, True),
    "fitted, penalised": (
        {"beta": 1.0, "centers": GIVEN, "method": "least_squares", "alpha": 0.1},
        True,
    ),
    "fitted, noise in the kernel": (
        {
            "kernel": 1.5 * RBF(0.3) + WhiteKernel(0.05),
            "centers": GIVEN,
            "method": "least_squares",
            "alpha": 0.01,
        },
        True,
    ),
    "noise in the kernel": (
        {"kernel": 1.5 * RBF(0.3) + WhiteKernel(0.05), "alpha": 0.01},
        True,
    ),
    "foreign kernel": (
        {
            "kernel": ConstantKernel(2.0) * RBF([0.3, 0.5]) + WhiteKernel(0.01),
            "centers": SeparatedCenterSelector(0.15),
        },
        True,
    ),
    "compact": ({"kernel": "wendland_c2", "beta": 0.6}, False),
    "strict": ({"solver": "cholesky", "beta": 0.5}, False),
}


def samples(n=110, repeats=True, noise=True, n_outputs=2):
    """Rows, of which some are equal to others, and their outputs."""
    rng = np.random.default_rng(n)
    X = rng.uniform(size=(n, 2))
    if repeats:
        again = rng.integers(0, n, size=n // 6)
        X[rng.integers(0, n, size=n // 6)] = X[again]
    y = np.column_stack([np.sin(4 * X[:, 0]) + X[:, 1], 3 - X[:, 0] * X[:, 1]])
    if noise:
        y += 0.1 * rng.normal(size=y.shape)
    return X, y[:, 0] if n_outputs is None else y[:, :n_outputs]


def grown(model, X, y, cuts):
    for rows, outputs in zip(np.split(X, cuts), np.split(y, cuts), strict=True):
        assert model.partial_fit(rows, outputs) is model
    return model


def assert_same(model, expected, X, rtol=1e-8):
    """Compare all that an estimate states."""
    y, std = expected.predict(X, return_std=True)
    size = abs(y).max()
    got, got_std = model.predict(X, return_std=True)
    assert got.shape == y.shape
    assert_allclose(got, y, rtol=0, atol=rtol * size)
    # noise_std_ of least squares is a difference of sums.
    limit = 1e-9 * np.max(expected.signal_std_) ** 2 + 1e-15 * size**2
    assert_allclose(got_std**2, std**2, rtol=1e-6, atol=limit)
    assert_allclose(model.noise_std_, expected.noise_std_, rtol=1e-6, atol=3e-8 * size)
    assert_allclose(model.signal_std_, expected.signal_std_, rtol=1e-7)
    assert np.shape(model.signal_std_) == np.shape(expected.signal_std_)
    assert_allclose(
        model.dual_coef_,
        expected.dual_coef_,
        rtol=0,
        atol=rtol * abs(expected.dual_coef_).max(),
    )
    assert_array_equal(model.centers_, expected.centers_)
    if expected.center_indices_ is None:
        assert model.center_indices_ is None
    else:
        assert_array_equal(model.center_indices_, expected.center_indices_)
    assert hasattr(model, "trend_coef_") == hasattr(expected, "trend_coef_")
    if hasattr(expected, "trend_coef_"):
        assert_allclose(
            model.trend_coef_, expected.trend_coef_, rtol=0, atol=10 * rtol * size
        )
    power = expected.power_function(X)
    assert_allclose(model.power_function(X) ** 2, power**2, atol=1e-9)
    assert model.solver_ == expected.solver_
    assert model.n_features_in_ == expected.n_features_in_
    assert repr(model.kernel_) == repr(expected.kernel_)


def assert_hidden(model, X, y, message):
    """Where an estimate cannot grow it has no partial_fit, and says why."""
    assert not hasattr(model, "partial_fit")
    with pytest.raises(AttributeError, match="has no attribute 'partial_fit'") as error:
        model.partial_fit(X, y)
    assert message in str(error.value.__cause__)


@every_pair(name=SETTINGS, trend=TRENDS, n_outputs=[None, 1, 2])
def test_batches_equal_one_fit(name, trend, n_outputs):
    parameters, noise = SETTINGS[name]
    X, y = samples(noise=noise, n_outputs=n_outputs)
    model = KoopmanKernelRegressor(trend=trend).set_params(**parameters)
    # A batch of one row, one that brings nothing new, and a long one.
    X, y = np.vstack([X, X[:7]]), np.concatenate([y, y[:7]])
    expected = clone(model).fit(X, y)
    cuts = [FIRST, FIRST + 1, 60, 110]
    assert_same(grown(model, X, y, cuts), expected, np.vstack([X, X + 0.03]))


@settings(max_examples=4, deadline=None)
@given(data=st.data())
@pytest.mark.parametrize("name", SETTINGS)
def test_any_division_equals_one_fit(name, data):
    parameters, noise = SETTINGS[name]
    X, y = samples(80, noise=noise)
    fitted = parameters.get("method") == "least_squares" and name.startswith("fitted")
    least = FIRST if fitted else 1
    cuts = sorted(data.draw(st.sets(st.integers(least, 79), max_size=12), "cuts"))
    trend = data.draw(st.sampled_from(TRENDS), "trend")
    model = KoopmanKernelRegressor(trend=trend).set_params(**parameters)
    expected = clone(model).fit(X, y)
    assert_same(grown(model, X, y, cuts), expected, X)


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("alpha", [0.0, 0.2])
def test_grown_interpolant_solves_the_printed_system(trend, alpha):
    X, y = samples(60, repeats=False)
    model = KoopmanKernelRegressor(beta=0.5, alpha=alpha, trend=trend)
    grown(model, X, y, [1, 2, 10, 35])
    K = kernel_matrix("matern32", X, X, 0.5) + alpha * np.eye(60)
    P = monomials(X, trend, X.mean(axis=0))
    c, b = dense_interpolant(K, P, y)
    assert_allclose(model.dual_coef_, c, rtol=1e-8, atol=1e-8)
    if trend is not None:
        assert_allclose(model.trend_coef_, b, rtol=1e-8, atol=1e-9)
    amplitude = np.sqrt(np.einsum("ij,ij->j", y, c) / (60 - P.shape[1]))
    assert_allclose(model.signal_std_, amplitude, rtol=1e-9)
    assert_allclose(model.noise_std_, amplitude * np.sqrt(alpha), rtol=1e-9)
    # The power function, by the same system for every row.
    T = X[:20] + 0.02
    k, p = kernel_matrix("matern32", X, T, 0.5), monomials(T, trend, X.mean(axis=0))
    squared = squared_power(K, P, k, p)
    assert_allclose(model.power_function(T) ** 2, squared, atol=1e-10)


@every_pair(n_centers=[12, 150], trend=TRENDS, alpha=[0.0, 0.3])
def test_accumulated_regression_is_the_dense_one(trend, alpha, n_centers):
    X, y = samples(n_centers + 150)
    centers = np.random.default_rng(1).uniform(size=(n_centers, 2))
    model = KoopmanKernelRegressor(
        beta=0.3, alpha=alpha, trend=trend, centers=centers, method="least_squares"
    )
    grown(model, X, y, [n_centers + 80, n_centers + 81])
    K = kernel_matrix("matern32", centers, centers, 0.3)
    A = kernel_matrix("matern32", X, centers, 0.3)
    origin = centers.mean(axis=0)
    P = monomials(X, trend, origin)
    solve = dense_least_squares(K, monomials(centers, trend, origin), A, P, alpha)
    coefficients = solve @ y
    hat = np.hstack([A, P]) @ solve
    assert_allclose(model.predict(X), hat @ y, atol=1e-8)
    c = model.dual_coef_
    assert_allclose(c, coefficients[:n_centers], atol=1e-6 * abs(c).max())
    if trend is not None:
        assert_allclose(model.trend_coef_, coefficients[n_centers:], atol=1e-7)
    squares = ((y - hat @ y) ** 2).sum(axis=0)
    noise = np.sqrt(squares / (len(X) - np.trace(hat)))
    assert_allclose(model.noise_std_, noise, rtol=1e-7)
    norm = np.sqrt(np.einsum("ij,ij->j", c, K @ c))
    degrees = n_centers - P.shape[1]
    assert_allclose(model.signal_std_, norm / np.sqrt(degrees), rtol=1e-6)


def test_memory_does_not_grow_with_the_rows():
    X, y = samples(2000)
    model = KoopmanKernelRegressor(centers=GIVEN, method="least_squares")
    sizes = []
    for rows in np.split(np.arange(2000), 10):
        model.partial_fit(X[rows], y[rows])
        sizes.append(len(pickle.dumps(vars(model))))
    assert max(sizes) - min(sizes) < 100
    # What is pickled is the estimate alone.
    assert len(pickle.dumps(model)) < sizes[-1] / 2


def test_equal_rows_count_with_their_mean_and_their_number():
    # One state, with the outputs 1, 2 and 6; k(x, x) = 1, so c = mean / (1 + 1 / 3).
    model = KoopmanKernelRegressor(beta=1.0, alpha=1.0)
    for value in (1.0, 2.0, 6.0):
        model.partial_fit([[0.5]], [value])
    assert_allclose(model.dual_coef_, [3 / (1 + 1 / 3)])
    assert_array_equal(model.center_indices_, [0])
    # Without a penalty, what they scatter by is the noise: 14 = 4 + 1 + 9 over 2.
    model = KoopmanKernelRegressor(beta=1.0, method="least_squares")
    for value in (1.0, 2.0, 6.0):
        model.partial_fit([[0.5]], [value])
    assert_allclose(model.predict([[0.5]]), [3.0])
    assert_allclose(model.noise_std_, np.sqrt(14 / 2))


def test_equal_rows_that_contradict_each_other():
    X, y = samples(40, repeats=False)
    model = grown(KoopmanKernelRegressor(), X, y, [10])
    before = model.predict(X, return_std=True)
    again = np.vstack([[[2.0, 2.0]], X[[13]]])
    message = "rows 13 and 41 of X are equal but their outputs differ"
    with pytest.raises(ValueError, match=message):
        model.partial_fit(again, np.vstack([[[0.0, 0.0]], y[[13]] + 0.1]))
    with pytest.raises(ValueError, match=message):
        KoopmanKernelRegressor().fit(
            np.vstack([X, again]), np.vstack([y, [[0.0, 0.0]], y[[13]] + 0.1])
        )
    assert_array_equal(model.predict(X, return_std=True), before)
    model.partial_fit(again, np.vstack([[[0.0, 0.0]], y[[13]]]))
    assert_array_equal(model.center_indices_, np.arange(41))


@pytest.mark.parametrize("trend", [None, "linear"])
def test_hundreds_of_batches(trend):
    X, y = samples(260, repeats=False)
    cuts = np.arange(100, 260)
    model = KoopmanKernelRegressor(beta=0.4, trend=trend)
    expected = clone(model).fit(X, y)
    assert_same(grown(model, X, y, cuts), expected, X + 0.01)


def direct_system(X, trend=None, nugget=0.0, kernel="matern32", beta=0.5, extent=None):
    sections = KernelSections(as_kernel(kernel, beta, X.shape[1]), X)
    nuggets = np.full(len(X), nugget)
    return DirectSystem(sections, nuggets, DEGREES[trend], "cholesky", extent)


def extended(system, X, u, nugget=0.0):
    sections = KernelSections(system.sections.kernel, X)
    return system.extended(sections, np.full(len(X), nugget), u)


@pytest.mark.parametrize("n_first", [100, 300])
def test_blocks_of_a_factor(n_first):
    """They are joined after a quarter more rows, or after 64 times."""
    n = n_first + 70
    X, u = samples(n, repeats=False)
    K = kernel_matrix("matern32", X, X, 0.2)
    L = np.linalg.cholesky(K)
    digits = np.finfo(float).eps * np.linalg.cond(K)  # that are lost at the most
    system = direct_system(X[:n_first], beta=0.2)
    first = system.lower
    first[np.triu_indices(n_first, 1)] = 7e7  # what is there has no meaning
    grown = GrowingSystem(system, u[:n_first])
    n_blocks = []
    for stop in range(n_first + 1, n + 1):
        grown = extended(grown, X[:stop], u[:stop])
        n_blocks.append(len(grown.blocks))
        if n_blocks[-1] == 1 + len(n_blocks):  # none was joined: the first is the same
            assert np.shares_memory(grown.blocks[0], first)
        if stop % 10 == 0:
            own = L[:stop, :stop]
            forward = solve_triangular(own, u[:stop], lower=True)
            limit = digits * abs(forward).max()
            assert_allclose(grown.coordinates(u[:stop]), forward, atol=limit)
            c = np.linalg.solve(K[:stop, :stop], u[:stop])
            found = grown.interpolate(u[:stop]).expansion.dual_coef
            assert_allclose(found, c, atol=digits * abs(c).max())
    # n_blocks[i] counts the first block and i + 1 others.
    most = min(int(MAX_ADDED_PART * n_first), MAX_BLOCKS - 1)
    assert n_blocks[:most] == list(range(2, most + 2))
    assert n_blocks[most] == 1
    found = np.tril(grown.lower)
    assert_allclose(found, L, atol=digits)
    assert_allclose(found @ found.T, K, atol=1e-13)
    assert len(grown.blocks) == 1
    assert grown.lower is grown.lower


@pytest.mark.parametrize("trend", TRENDS)
def test_systems_that_grow_from_one_go_on_independently(trend):
    """They share what was before, and change nothing of it."""
    X, u = samples(90, repeats=False)
    system = direct_system(X[:40], trend, nugget=0.01)
    start = GrowingSystem(system, u[:40])
    lower, blocks = system.lower.copy(), start.blocks
    both = [np.r_[0:40, 40:65], np.r_[0:40, 65:90]]
    once = [extended(start, X[rows[:50]], u[rows[:50]], 0.01) for rows in both]
    twice = [
        extended(one, X[rows], u[rows], 0.01)
        for one, rows in zip(once, both, strict=True)
    ]
    _ = once[0].lower  # in one piece
    # Other values at the earlier centres are not those of the other systems.
    other = extended(once[0], X[both[0][:50]], u[both[0][:50]] + 1.0, 0.01)
    cases = [(start, both[0][:40], 0.0), (other, both[0][:50], 1.0)]
    for i in (0, 1):
        cases += [(once[i], both[i][:50], 0.0), (twice[i], both[i], 0.0)]
    for found, rows, shift in cases:
        K = kernel_matrix("matern32", X[rows], X[rows], 0.5)
        K += 0.01 * np.eye(len(rows))
        P = monomials(X[rows], trend, X[rows].mean(axis=0))
        c, b = dense_interpolant(K, P, u[rows] + shift)
        expansion = found.interpolate(found.u).expansion
        assert_allclose(expansion.dual_coef, c, atol=1e-9 * abs(c).max())
        if trend is not None:
            assert_allclose(expansion.trend_coef, b, atol=1e-9 * abs(u).max())
        # Values other than its own.
        assert_allclose(
            found.interpolate(u[rows]).expansion.dual_coef,
            dense_interpolant(K, P, u[rows])[0],
            atol=1e-9 * abs(c).max(),
        )
    assert start.blocks is blocks
    assert len(blocks) == 1
    assert_array_equal(np.tril(system.lower), np.tril(lower))


def test_growth_refuses_other_weights_of_earlier_centres():
    X, u = samples(30, repeats=False)
    start = GrowingSystem(direct_system(X[:20], nugget=0.1), u[:20])
    with pytest.raises(np.linalg.LinAlgError, match="weights have changed"):
        extended(start, X, u, nugget=0.05)


class CountedMatern(Matern):
    """Counts the entries that are evaluated."""

    entries = 0

    def __call__(self, X, Y=None, eval_gradient=False):
        CountedMatern.entries += len(X) * len(X if Y is None else Y)
        return super().__call__(X, Y, eval_gradient)


class CountedRBF(RBF):
    """Counts the entries that are evaluated."""

    entries = 0

    def __call__(self, X, Y=None, eval_gradient=False):
        CountedRBF.entries += len(X) * len(X if Y is None else Y)
        return super().__call__(X, Y, eval_gradient)


@pytest.mark.parametrize("trend", TRENDS)
def test_batch_evaluates_its_own_part_of_the_matrix(trend):
    X, y = samples(120, repeats=False)
    model = KoopmanKernelRegressor(CountedMatern(0.5, nu=1.5), trend=trend)
    model.fit(X[:100], y[:100])
    for start, stop in ((100, 105), (105, 106), (106, 120)):
        CountedMatern.entries = 0
        model.partial_fit(X[start:stop], y[start:stop])
        assert CountedMatern.entries == (stop - start) * stop
    assert_allclose(model.predict(X), y, atol=1e-8)


def test_verification_includes_the_penalty():
    """What is verified is not what the outputs are, but what they are less alpha c."""
    X, y = samples(120, repeats=False)
    model = KoopmanKernelRegressor(CountedRBF(0.5), alpha=1e-7)
    expected = clone(model).fit(X, y)
    model.fit(X[:100], y[:100])
    for start, stop in ((100, 105), (105, 120)):
        CountedRBF.entries = 0
        model.partial_fit(X[start:stop], y[start:stop])
        added = (stop - start) * stop
        # Verified at every centre, and not made anew.
        assert CountedRBF.entries == added + stop**2
    assert expected.rcond_ < 1e-8
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-5)


@pytest.mark.parametrize("parameters", [{"alpha": 1e-3}, {"trend": "linear"}, {}])
def test_rcond_after_growth_is_an_upper_bound(parameters):
    X, y = samples(80, repeats=False)
    model = KoopmanKernelRegressor(beta=0.5, **parameters)
    grown(model, X, y, [20, 50])
    K = kernel_matrix("matern32", X, X, 0.5) + model.alpha * np.eye(80)
    assert 1 / np.linalg.cond(K, 1) < model.rcond_ < 1
    # It is that of all centres.
    few = grown(clone(model), X[:50], y[:50], [20])
    assert model.rcond_ <= few.rcond_
    assert pickle.loads(pickle.dumps(model)).rcond_ == model.rcond_
    assert few.partial_fit(X[50:], y[50:]).rcond_ == model.rcond_
    # It starts from the number of the first batch, not from a rough estimate of it.
    first = clone(model).partial_fit(X[:79], y[:79]).rcond_
    assert_allclose(grown(clone(model), X, y, [79]).rcond_, first, rtol=1e-9)


def test_noise_term_of_the_kernel_is_on_the_diagonal_of_added_centres():
    X, y = samples(60, repeats=False)
    kernel = ConstantKernel(1.5) * RBF(0.3) + WhiteKernel(0.05)
    model = KoopmanKernelRegressor(kernel, alpha=0.02, trend="constant")
    grown(model, X, y, [1, 20, 21])
    K = 1.5 * kernel_matrix("gaussian", X, X, 0.3)
    c, b = dense_interpolant(K + 0.07 * np.eye(60), np.ones((60, 1)), y)
    assert_allclose(model.dual_coef_, c, atol=1e-9 * abs(c).max())
    assert_allclose(model.predict(X), K @ c + b, atol=1e-9)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("trend", TRENDS)
def test_dependent_centres_are_left_out(method, trend):
    rng = np.random.default_rng(4)
    X = rng.uniform(size=(120, 1))
    y = np.sin(5 * X[:, 0])
    model = KoopmanKernelRegressor("gaussian", beta=0.4, trend=trend, method=method)
    with pytest.warns(LinAlgWarning, match="centres that depend on the others"):
        grown(model, X, y, [8, 30, 31])
    assert 8 <= len(model.centers_) < 60
    assert_array_equal(X[model.center_indices_], model.centers_)
    assert_allclose(model.predict(X), y, atol=2e-3)
    assert model.rcond_ > 1e-17
    # The standard deviation is that of an estimate anew at the centres that are left.
    kept = clone(model).fit(model.centers_, y[model.center_indices_])
    assert_allclose(
        model.power_function(X) ** 2, kept.power_function(X) ** 2, atol=1e-8
    )


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("loaded", [False, True])
def test_growth_goes_on_after_centres_were_left_out(method, trend, loaded):
    """By rows that are known, that were left out, and that are new."""
    rng = np.random.default_rng(4)
    X = rng.uniform(size=(60, 1))
    y = np.sin(5 * X[:, 0])
    model = KoopmanKernelRegressor("gaussian", beta=0.4, trend=trend, method=method)
    with pytest.warns(LinAlgWarning):
        model.partial_fit(X, y)
    kept = model.center_indices_
    assert len(kept) < 30
    if loaded:
        model = pickle.loads(pickle.dumps(model))
    power = model.power_function(X)
    model.partial_fit(X[kept[2:5]], y[kept[2:5]])
    assert_array_equal(model.center_indices_, kept)
    assert_allclose(model.predict(X[kept]), y[kept], atol=2e-6)
    assert_allclose(model.power_function(X) ** 2, power**2, atol=1e-8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        left_out = np.setdiff1d(np.arange(60), kept)[:5]
        model.partial_fit(X[left_out], y[left_out])
        assert_allclose(model.predict(X), y, atol=2e-3)
        far = np.array([[3.0], [4.0]])
        model.partial_fit(far, far[:, 0])
    assert_array_equal(model.center_indices_[-2:], [68, 69])
    assert_allclose(model.predict(far), far[:, 0], atol=1e-5)
    assert_allclose(model.predict(X), y, atol=2e-3)


@pytest.mark.parametrize("kernel", ["wendland_c2", "wendland_c4"])
def test_added_centre_of_a_suspect_factor_is_verified(kernel):
    """Among a thousand, of which not all are verified, and next to one of them.

    Only four others are within the range of the kernel.
    """
    X = np.linspace(0, 100, 1000)[:, np.newaxis]
    y = np.sin(X[:, 0])
    for gap in (1e-7, 1e-8):
        model = KoopmanKernelRegressor(kernel, beta=0.25).fit(X, y)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            model.partial_fit(X[[500]] + gap, y[[500]] + 1.0)
        kept = np.append(y, y[500] + 1.0)[model.center_indices_]
        assert_allclose(model.predict(model.centers_), kept, atol=2e-6)
    assert len(model.centers_) == 1000


def test_suspect_growth_is_verified():
    """Rounding makes the coefficients useless before the factorisation fails."""
    X = np.linspace(0, 1, 60)[:, np.newaxis]
    y = np.sin(9 * X[:, 0]) + 0.1 * np.random.default_rng(0).normal(size=60)
    order = np.concatenate([np.arange(o, 60, 8) for o in (0, 4, 2, 6, 1, 3, 5, 7)])
    for beta in (0.05, 0.1):
        model = KoopmanKernelRegressor("gaussian", beta=beta)
        for rows in np.array_split(order, 8):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", LinAlgWarning)
                model.partial_fit(X[rows], y[rows])
            kept = y[order[model.center_indices_]]
            # Solutions are accepted up to 1e-6, with rounding errors of their own.
            size = np.abs(model.dual_coef_).sum()
            atol = 2e-6 + 2 * len(kept) * np.finfo(float).eps * size
            assert atol < 1e-3
            assert_allclose(model.predict(model.centers_), kept, atol=atol)


def test_strict_solver_refuses_dependent_centres():
    X = np.linspace(0, 1, 15)[:, np.newaxis]
    model = KoopmanKernelRegressor("gaussian", beta=0.5, solver="cholesky")
    model.partial_fit(X[::2], X[::2, 0])
    before = model.predict(X)
    with pytest.raises(ValueError, match="No estimate for kernel=Gaussian"):
        model.partial_fit(X[1::2], X[1::2, 0])
    assert_array_equal(model.predict(X), before)
    with pytest.raises(ValueError, match="No estimate for kernel=Gaussian"):
        KoopmanKernelRegressor(
            "gaussian", beta=2.0, solver="cholesky", centers=X, method="least_squares"
        ).partial_fit(X, X[:, 0])


def test_selector_forgets_a_batch_that_failed():
    X = np.linspace(0, 1, 15)[:, np.newaxis]
    model = KoopmanKernelRegressor(
        "gaussian", beta=0.5, solver="cholesky", centers=SeparatedCenterSelector(0.01)
    )
    first, more = X[::2], np.array([[3.0], [5.0]])
    expected = clone(model).fit(np.vstack([first, more]), np.vstack([first, more]))
    model.partial_fit(first, first)
    with pytest.raises(ValueError, match="No estimate for kernel=Gaussian"):
        model.partial_fit(X[1::2], X[1::2])
    model.partial_fit(more, more)
    assert_array_equal(model.center_indices_, np.arange(10))
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-6)


@pytest.mark.parametrize("alpha", [1e-3, 1e-2])
@pytest.mark.parametrize("trend", TRENDS)
def test_least_squares_leaves_out_dependent_centres(alpha, trend):
    X, y = samples(200)
    X = X[:, :1]
    model = KoopmanKernelRegressor(
        "gaussian",
        beta=1.0,
        centers=np.linspace(0, 1, 30)[:, np.newaxis],
        method="least_squares",
        alpha=alpha,
        trend=trend,
    )
    expected = clone(model).fit(X, y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        grown(model, X, y, [100])
    assert len(model.centers_) == len(model.dual_coef_) < 30
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-6)
    assert_allclose(model.noise_std_, expected.noise_std_, rtol=1e-5)


def test_selector_of_dependent_centres_keeps_their_rows():
    X = np.linspace(0, 1, 60)[:, np.newaxis]
    y = np.sin(5 * X)
    model = KoopmanKernelRegressor(
        "gaussian", beta=1.0, centers=SeparatedCenterSelector(0.03)
    )
    with pytest.warns(LinAlgWarning):
        grown(model, X, y, [20, 40])
    assert len(model.centers_) < 25
    assert_array_equal(model.centers_, X[model.center_indices_])
    assert_allclose(model.predict(model.centers_), y[model.center_indices_], atol=2e-6)
    assert_allclose(model.predict(X), y, atol=1e-3)


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("alpha", [0.0, 0.1])
def test_feature_that_begins_to_vary(trend, alpha):
    X, y = samples(60, repeats=False)
    # Not at random on the line: pairs that nearly coincide would cost all digits.
    X[:25] = np.column_stack([np.linspace(0, 1, 25), np.full(25, 0.5)])
    model = KoopmanKernelRegressor(beta=1.0, trend=trend, alpha=alpha)
    expected = clone(model).fit(X, y)
    T = np.vstack([X, X + np.array([0.0, 0.4])])
    assert_same(grown(model, X, y, [1, 20]), expected, T)


@pytest.mark.parametrize("middle", [0.5, 0.6])
@pytest.mark.parametrize("alpha", [0.01, 0.1])
def test_feature_that_begins_to_vary_after_the_first_batch_of_least_squares(
    alpha, middle
):
    """At the mean of the centres, or beside it."""
    rng = np.random.default_rng(8)
    X = rng.uniform(size=(80, 2))
    X[:40, 1] = middle
    y = X[:, :1] ** 2 + 3 * X[:, 1:]
    centers = np.stack(np.meshgrid([0.0, 0.3, 0.6, 0.9], [0.25, 0.5, 0.75]), axis=-1)
    centers = centers.reshape(12, 2)
    model = KoopmanKernelRegressor(
        beta=0.5, centers=centers, method="least_squares", trend="linear", alpha=alpha
    )
    expected = clone(model).fit(X, y)
    T = np.vstack([X, X + np.array([0.0, 0.8])])
    assert_same(grown(model, X, y, [30, 40]), expected, T)


def test_batch_that_varies_where_the_centres_do_not_is_refused():
    rng = np.random.default_rng(8)
    X = rng.uniform(size=(80, 2))
    X[:60, 1] = 0.5
    y = X[:, 0] ** 2 + 3 * X[:, 1]
    centers = np.column_stack([np.linspace(0, 1, 6), np.full(6, 0.5)])
    model = KoopmanKernelRegressor(
        beta=0.5, centers=centers, method="least_squares", trend="linear"
    )
    for learn in (clone(model).fit, clone(model).partial_fit):
        with pytest.raises(ValueError, match="do not determine a linear function"):
            learn(X, y)
    expected = clone(model).fit(X[:60], y[:60])
    model.partial_fit(X[:30], y[:30])
    state = pickle.dumps(vars(model))
    with pytest.raises(ValueError, match="do not determine a linear function"):
        model.partial_fit(X[60:], y[60:])
    assert pickle.dumps(vars(model)) == state  # bit for bit
    assert_same(model.partial_fit(X[30:60], y[30:60]), expected, X[:60])


def test_trend_that_the_centres_do_not_determine_is_refused():
    rng = np.random.default_rng(3)
    X = rng.uniform(size=(60, 2))
    y = 2.0 - 7.0 * X[:, 1]
    in_a_row = np.column_stack([np.linspace(0, 1, 5), np.zeros(5)])
    model = KoopmanKernelRegressor(
        beta=1.0, method="least_squares", trend="linear", alpha=0.1
    )
    for centers in (in_a_row, X[:2]):
        model = clone(model).set_params(centers=centers)
        message = f"the {len(centers)} independent centres do not determine a linear"
        with pytest.raises(ValueError, match=message):
            model.partial_fit(X, y)
        with pytest.raises(NotFittedError):
            model.predict(X)
    # Rows in the plane of the centres ask for nothing that these do not determine.
    model.set_params(centers=in_a_row)
    flat = X * [1.0, 0.0]
    expected = clone(model).fit(flat, y)
    assert_same(grown(model, flat, y, [20, 21]), expected, flat)


def test_far_from_the_first_row():
    X, y = samples(60, repeats=False)
    X = np.vstack([[0.0, 0.0], 1e5 + X])
    y = np.vstack([[0.0, 0.0], y])
    model = KoopmanKernelRegressor(trend="linear", beta=0.5)
    expected = clone(model).fit(X, y)
    grown(model, X, y, [1, 5, 30])
    assert_allclose(
        # The coordinates have errors of 1e-11, and the coefficients are hundreds.
        model.predict(X[1:] + 0.1),
        expected.predict(X[1:] + 0.1),
        atol=1e-7,
    )


@pytest.mark.parametrize("trend", TRENDS)
def test_too_few_rows_for_the_centres(trend):
    X, y = samples(100, repeats=False)
    model = KoopmanKernelRegressor(
        centers=GIVEN, method="least_squares", trend=trend, beta=0.3
    )
    with pytest.raises(ValueError, match=r"method='least_squares' with alpha=0"):
        model.partial_fit(X[:11], y[:11])
    with pytest.raises(NotFittedError):
        model.predict(X)
    assert vars(model) == vars(clone(model)) | {"centers": model.centers}
    # It did not count.
    expected = clone(model).fit(X[11:], y[11:])
    assert_same(grown(model, X[11:], y[11:], [50]), expected, X)
    # With a penalty few will do.
    model = clone(model).set_params(alpha=0.5)
    expected = clone(model).fit(X[:11], y[:11])
    assert_same(grown(model, X[:11], y[:11], [1, 4]), expected, X)


@pytest.mark.parametrize(
    "parameters",
    [
        {"beta": 1.0},
        {"beta": 1.0, "centers": SeparatedCenterSelector(0.1)},
        {"beta": 1.0, "centers": GIVEN, "method": "least_squares"},
    ],
)
def test_bad_batches_leave_the_estimate_as_it_was(parameters):
    X, y = samples(90, noise=False)
    names = pd.DataFrame(X, columns=["angle", "speed"])
    model = KoopmanKernelRegressor(trend="linear").set_params(**parameters)
    expected = clone(model).fit(names, y)
    bad = [
        (X[:0], y[:0], "0 sample"),
        (np.where(X > 0.5, np.nan, X), y, "NaN"),
        (X, np.where(y > 0.5, np.inf, y), "infinity"),
        (X[:, :1], y, "1 features"),
        (X[:, [0, 1, 0]], y, "3 features"),
        (X, y[:, 0], "y has shape"),
        (X, y[:, :1], "y has shape"),
        (X, y[:5], "inconsistent numbers of samples"),
        (names.rename(columns={"angle": "other"}), y, "feature names"),
        (X, np.full(y.shape, "a"), None),
        (X, 1e200 * y, "rescale y"),
        (X, 1e-200 * y, "rescale y"),
    ]
    for i, part in enumerate(np.array_split(np.arange(90), 3)):
        model.partial_fit(names.iloc[part], y[part])
        state = pickle.dumps(vars(model))
        for rows, outputs, message in bad:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "X does not have valid feature names")
                with pytest.raises(ValueError, match=message):
                    model.partial_fit(rows, outputs)
        assert pickle.dumps(vars(model)) == state, i
    assert_same(model, expected, names)
    assert_array_equal(model.feature_names_in_, ["angle", "speed"])


def test_bad_first_batch_leaves_nothing():
    X, y = samples(40, noise=False)
    for parameters in ({}, {"centers": GIVEN, "method": "least_squares"}):
        model = KoopmanKernelRegressor(**parameters)
        before = set(vars(model))
        with pytest.raises(ValueError, match="NaN"):
            model.partial_fit(np.full_like(X, np.nan), y)
        for size in (1e200, 1e-200):
            with pytest.raises(ValueError, match="rescale y"):
                model.partial_fit(X, size * y)
        with pytest.raises(ValueError, match="alpha must be"):
            clone(model).set_params(alpha=-1).partial_fit(X, y)
        assert set(vars(model)) == before


@pytest.mark.parametrize(
    "parameters", [{}, pytest.param({"centers": GIVEN, "method": "least_squares"})]
)
def test_bad_names_of_the_first_batch_leave_nothing(parameters):
    X, y = samples(40, noise=False)
    model = KoopmanKernelRegressor(**parameters)
    before = set(vars(model))
    with pytest.raises(TypeError, match="string"):
        model.partial_fit(pd.DataFrame(X, columns=["a", 1]), y)
    assert set(vars(model)) == before


def test_fit_starts_anew():
    X, y = samples(90)
    for name, (parameters, _) in SETTINGS.items():
        if name in ("exact", "compact", "strict"):
            continue
        model = KoopmanKernelRegressor(trend="linear").set_params(**parameters)
        expected = clone(model).fit(X[40:], y[40:, 0])
        grown(model, X[:40], y[:40], [30]).fit(X[40:], y[40:, 0])
        assert_same(model, expected, X)
        if name.startswith("fitted"):
            assert_hidden(model, X, y[:, 0], "from the first batch on")
            assert_same(model, expected, X)
        else:
            whole = clone(model).fit(np.vstack([X[40:], X[:40]]), np.roll(y[:, 0], 50))
            assert_same(model.partial_fit(X[:40], y[:40, 0]), whole, X)


@every_pair(
    name=SETTINGS,
    travel=[lambda m: pickle.loads(pickle.dumps(m)), copy.copy, copy.deepcopy],
    trend=TRENDS,
)
def test_pickle_and_go_on(name, travel, trend):
    parameters, noise = SETTINGS[name]
    X, y = samples(90, noise=noise)
    model = KoopmanKernelRegressor(trend=trend).set_params(**parameters)
    expected = clone(model).fit(X, y)
    grown(model, X[:60], y[:60], [35])
    loaded = travel(model)
    assert_allclose(loaded.predict(X), model.predict(X), rtol=1e-12)
    if name.startswith("fitted"):
        assert_hidden(loaded, X[60:], y[60:], "nor a copy or pickle keeps")
        # The copy did not take anything from the original.
        assert_same(grown(model, X[60:], y[60:], [10]), expected, X)
    else:
        loaded = travel(loaded.partial_fit(X[60:70], y[60:70]))
        assert_same(loaded.partial_fit(X[70:], y[70:]), expected, X)
        assert_same(grown(model, X[60:], y[60:], [10]), expected, X)


@pytest.mark.parametrize("name", ["exact", "penalised", "all rows", "chosen"])
@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy])
def test_copies_go_on_independently(name, duplicate):
    parameters, noise = SETTINGS[name]
    X, y = samples(120, repeats=False, noise=noise)
    one = KoopmanKernelRegressor(trend="linear").set_params(**parameters)
    grown(one, X[:40], y[:40], [20, 30])
    two = duplicate(one)
    left, right = np.r_[0:80], np.r_[0:40, 80:120]
    for i in range(4):  # in turns
        a, b = slice(40 + 10 * i, 50 + 10 * i), slice(80 + 10 * i, 90 + 10 * i)
        one.partial_fit(X[a], y[a])
        two.partial_fit(X[b], y[b])
    assert_same(one, clone(one).fit(X[left], y[left]), X)
    assert_same(two, clone(one).fit(X[right], y[right]), X)


def test_clone_forgets_the_batches():
    X, y = samples(60)
    for parameters in ({"alpha": 0.1}, {"centers": GIVEN, "method": "least_squares"}):
        model = KoopmanKernelRegressor(**parameters).partial_fit(X, y)
        other = clone(model)
        assert not hasattr(other, "dual_coef_")
        expected = clone(model).fit(X[::-1], y[::-1])
        assert_same(other.partial_fit(X[::-1], y[::-1]), expected, X)


@pytest.mark.parametrize("start", ["fit", "partial_fit"])
@pytest.mark.parametrize("n_outputs", [None, 2])
@pytest.mark.parametrize("name", ["exact", "all rows", "penalised", "chosen", "fitted"])
def test_batches_are_not_kept_by_reference(name, n_outputs, start):
    parameters, noise = SETTINGS[name]
    # Without equal rows, too: means of outputs would be new arrays.
    X, y = samples(80, repeats=False, noise=noise, n_outputs=n_outputs)
    model = KoopmanKernelRegressor().set_params(**parameters)
    expected = clone(model).fit(X, y)
    if name == "fitted":
        start = "partial_fit"
    for learn, part in ((start, slice(40)), ("partial_fit", slice(40, 80))):
        rows, outputs = X[part].copy(), y[part].copy()
        getattr(model, learn)(rows, outputs)
        rows[...] = np.random.default_rng(0).normal(size=rows.shape)
        outputs[...] = -9.0
    assert_same(model, expected, X)


@pytest.mark.parametrize("trend", TRENDS)
def test_bounds_and_threads_after_growth(trend):
    X, y = samples(100, repeats=False, noise=False)
    model = KoopmanKernelRegressor("matern52", beta=0.2, trend=trend, n_jobs=2)
    expected = clone(model).set_params(n_jobs=None).fit(X, y)
    T = X[:40] + 0.005
    grown(model, X[:70], y[:70], [20])
    model.error_bound(T)  # what it keeps must not outlive the next batch
    first = model.power_function(T)
    grown(model, X[70:], y[70:], [3])
    assert (model.power_function(T) <= first + 1e-7).all()
    assert_same(model, expected, T, rtol=1e-6)
    assert_allclose(
        model.error_bound(T, norm=2.0), expected.error_bound(T, norm=2.0), rtol=1e-3
    )
    assert_allclose(model.error_bound(T), expected.error_bound(T), rtol=1e-3)
    exact = clone(expected).fit(X, y).error_bound(T, norm=[1.0, 3.0])
    assert_allclose(model.error_bound(T, norm=[1.0, 3.0]), exact, rtol=1e-3)


def test_bounds_know_the_penalty_of_added_centres():
    X, y = samples(60, repeats=False, noise=False)
    model = KoopmanKernelRegressor(beta=0.4, alpha=0.5)
    expected = clone(model).fit(X, y).error_bound(X + 0.01)
    bound = grown(model, X, y, [5, 20]).error_bound(X + 0.01)
    assert_allclose(bound, expected, rtol=1e-6)


def test_error_bound_is_not_for_least_squares_that_grows():
    X, y = samples(60)
    model = KoopmanKernelRegressor(centers=GIVEN, method="least_squares")
    with pytest.raises(ValueError, match="error_bound needs an interpolant"):
        model.partial_fit(X, y).error_bound(X)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"solver": ConjugateGradient()}, "conjugate gradients do not have"),
        ({"centers": "precomputed"}, "centers='precomputed'"),
        ({"centers": KMeans(3)}, "centers=KMeans"),
        (
            {"centers": FrozenEstimator(SeparatedCenterSelector().fit(GIVEN))},
            "centers=FrozenEstimator",
        ),
    ],
)
def test_what_cannot_grow_says_so(parameters, message, method):
    X, y = samples(30)
    model = KoopmanKernelRegressor(method=method, alpha=0.1).set_params(**parameters)
    assert_hidden(model, X, y, message)
    assert not hasattr(model, "dual_coef_")


def test_given_centres_of_interpolation_cannot_grow():
    model = KoopmanKernelRegressor(centers=GIVEN)
    assert_hidden(model, GIVEN, GIVEN, "and method='interpolation'")


def test_farthest_centres_cannot_grow():
    X, y = samples(30)
    selector = SeparatedCenterSelector(0.2, order="farthest")
    assert_hidden(KoopmanKernelRegressor(centers=selector), X, y, "order='sequential'")


@pytest.mark.parametrize("order", ["sequential", "farthest"])
def test_least_squares_needs_its_centres_before_the_first_batch(order):
    X, y = samples(60)
    selector = SeparatedCenterSelector(0.25, order=order)
    model = KoopmanKernelRegressor(centers=selector, method="least_squares")
    message = "needs centres that are known before the first batch"
    assert_hidden(model, X, y, message)
    assert_hidden(model.fit(X, y), X, y, message)


@pytest.mark.parametrize("trend", TRENDS)
def test_centres_of_least_squares_can_be_selected_first(trend):
    """As the error advises."""
    X, y = samples(120)
    selector = SeparatedCenterSelector(0.25)
    model = KoopmanKernelRegressor(
        beta=1.0, centers=clone(selector), method="least_squares", trend=trend
    )
    expected = model.fit(X, y)
    for rows in np.split(X, [40, 80]):
        selector.partial_fit(rows)
    model = clone(model).set_params(centers=selector.cluster_centers_)
    grown(model, X, y, [40, 80])
    assert_array_equal(model.centers_, expected.centers_)
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-8)
    assert_allclose(model.noise_std_, expected.noise_std_, rtol=1e-6)


def test_conjugate_gradients_chosen_by_themselves_cannot_grow():
    X = np.linspace(0, 1, 5100)[:, np.newaxis]
    model = KoopmanKernelRegressor("wendland_c0", beta=1e-3).fit(X, X[:, 0])
    assert isinstance(model.solver_, ConjugateGradient)
    assert_hidden(model, X, X[:, 0], "fit with solver='pivoted_cholesky'")


@pytest.mark.slow
def test_growth_stays_with_the_factor_it_began_with():
    """With more centres than conjugate gradients begin at, and equal rows."""
    X = np.linspace(0, 1, 5020)[:, np.newaxis]
    X = np.vstack([X, X[:3]])
    y = np.sin(9 * X[:, 0])
    model = KoopmanKernelRegressor("wendland_c0", beta=1e-3, alpha=0.1)
    expected = clone(model).fit(X, y)
    assert isinstance(expected.solver_, ConjugateGradient)
    model.partial_fit(X[:4990], y[:4990])
    model.partial_fit(X[4990:5010], y[4990:5010])
    model.partial_fit(X[5010:], y[5010:])  # equal rows: all is factored anew
    assert model.solver_ == "pivoted_cholesky"
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-6)


def test_failed_growth_leaves_the_factor_as_it_was():
    X = np.linspace(0, 1, 60)[:, np.newaxis]
    y = np.sin(9 * X[:, 0]) + 0.1 * np.random.default_rng(0).normal(size=60)
    model = KoopmanKernelRegressor("gaussian", beta=0.1, solver="cholesky")
    for start in (0, 4, 2):
        model.partial_fit(X[start::8], y[start::8])
    before = model.power_function(X), model.predict(X)
    with pytest.raises(ValueError, match="No estimate"):
        model.partial_fit(X[6::8], y[6::8])
    assert_allclose(model.predict(X), before[1])
    assert_allclose(model.power_function(X) ** 2, before[0] ** 2, atol=1e-12)


def test_batch_that_cannot_be_solved_does_not_count():
    X, y = samples(60)
    model = KoopmanKernelRegressor(
        DotProduct(0.0), centers=np.eye(2), method="least_squares"
    )
    expected = clone(model).fit(X, y)
    model.partial_fit(X[:30], y[:30])
    state = pickle.dumps(vars(model))
    with pytest.raises(ValueError, match="do not determine"):
        model.partial_fit([[1e9, 0.0]], [[1e9, 0.0]])
    assert pickle.dumps(vars(model)) == state  # bit for bit
    assert_same(model.partial_fit(X[30:], y[30:]), expected, X)


class Interrupted(RBF):
    """A kernel whose evaluation ends after a number of calls."""

    calls = np.inf
    error = RuntimeError

    def count(self):
        Interrupted.calls -= 1
        if Interrupted.calls < 0:
            raise self.error

    def __call__(self, X, Y=None, eval_gradient=False):
        self.count()
        return super().__call__(X, Y, eval_gradient)

    def diag(self, X):
        self.count()
        return super().diag(X)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize(
    "parameters", [{"centers": GIVEN, "method": "least_squares"}, {"alpha": 0.1}]
)
def test_interrupted_batch_does_not_count(parameters, error, monkeypatch):
    X, y = samples(60)
    model = KoopmanKernelRegressor(Interrupted(0.5), trend="linear", **parameters)
    expected = clone(model).fit(X, y)
    model.partial_fit(X[:30], y[:30])
    state = pickle.dumps(vars(model))
    monkeypatch.setattr(Interrupted, "error", error)
    for calls in range(100):
        monkeypatch.setattr(Interrupted, "calls", calls)
        try:
            model.partial_fit(X[30:], y[30:])
        except error:
            assert pickle.dumps(vars(model)) == state  # bit for bit
        else:
            break
    assert calls > 1
    monkeypatch.setattr(Interrupted, "calls", np.inf)
    assert_same(model, expected, X)


@pytest.mark.parametrize("alpha", [0.0, 1e-12])
def test_ill_conditioned_least_squares_grows_where_it_fits(alpha):
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(400, 1))
    y = np.sin(7 * X[:, 0]) + 0.01 * rng.normal(size=400)
    model = KoopmanKernelRegressor(
        "gaussian",
        beta=0.3,
        centers=np.linspace(0, 1, 20)[:, np.newaxis],
        method="least_squares",
        alpha=alpha,
    )
    with pytest.warns(LinAlgWarning):
        expected = clone(model).fit(X, y)
    with pytest.warns(LinAlgWarning):
        grown(model, X, y, [80, 160, 240, 320])
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-5)


def test_warnings_are_those_of_fit():
    X, y = samples(200)
    parameters = {
        "centers": np.linspace(0, 1, 20)[:, np.newaxis],
        "method": "least_squares",
        "alpha": 0.1,
    }
    model = KoopmanKernelRegressor("gaussian", beta=1.0, **parameters)
    clone(model).fit(X[:, :1], y)  # a penalty makes it irrelevant what is left out
    model.partial_fit(X[:, :1], y)


def test_warning_names_the_line_that_asked():
    X = np.linspace(0, 1, 60)[:, np.newaxis]
    model = KoopmanKernelRegressor("gaussian", beta=1.0).partial_fit(X[:3], X[:3])
    with pytest.warns(LinAlgWarning) as record:
        model.partial_fit(X[3:], X[3:])
    assert [warning.filename for warning in record] == [__file__]


def test_noise_counts_the_rows_whose_centres_were_left_out():
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(60, 1))
    X = np.vstack([X, X + 1e-11])
    y = rng.normal(size=120)
    model = KoopmanKernelRegressor(method="least_squares", beta=0.5)
    with pytest.warns(LinAlgWarning):
        expected = clone(model).fit(X, y)
    with pytest.warns(LinAlgWarning):
        grown(model, X, y, [60])
    assert_allclose(model.noise_std_, expected.noise_std_, rtol=0.1)


# --- sums over rows


def normal_rows(trend, n_centers=150, beta=0.3, kernel="matern32"):
    """Return a system, rows and outputs."""
    rng = np.random.default_rng(2)
    centers = rng.uniform(size=(n_centers, 2))
    X = rng.uniform(size=(400, 2))
    y = rng.normal(size=(400, 2)) + X
    extent = np.stack([X.min(axis=0), X.max(axis=0)])
    return direct_system(centers, trend, 0.0, kernel, beta, extent), X, y


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("alpha", [0.0, 0.5])
def test_normal_equations_are_plain_least_squares(trend, alpha):
    system, X, y = normal_rows(trend)
    M, q = system.Q.shape
    lower = np.tril(system.lower)
    equations = NormalEquations.empty(system, system.lower, 2)
    other = NormalEquations.empty(system, np.full((M, M), 5.0, order="F"), 2)
    equations.add(system, X[:250], y[:250].__getitem__)
    other.add(system, X[250:], y[250:].__getitem__)
    equations.merge(other)
    assert_array_equal(np.tril(system.lower), lower)  # they share an array
    assert_allclose(equations.diagonal, 400.0)
    sums = vars(equations.copy())
    sums["upper"] = np.triu(sums["upper"], 1)
    # Working memory may hold anything; its lower triangle stays.
    F = np.full((M, M), np.nan, order="F")
    F[np.tril_indices(M)] = 3.0
    z, b, dof = equations.solve(system, alpha, F)
    assert (F[np.tril_indices(M)] == 3.0).all()
    after = vars(equations) | {"upper": np.triu(equations.upper, 1)}
    assert sums.keys() == after.keys()
    for name, values in sums.items():
        assert_array_equal(values, after[name], err_msg=name)
    # Densely, by a factor of its own: with z in the complement of the polynomials.
    centers = system.sections.centers
    L = np.linalg.cholesky(kernel_matrix("matern32", centers, centers, 0.3))
    a = solve_triangular(L, kernel_matrix("matern32", X, centers, 0.3).T, lower=True)
    P = solve_triangular(L, monomials(centers, trend), lower=True)
    Z = null_space(P.T) if q else np.eye(M)
    design = np.hstack([a.T @ Z, monomials(X, trend)])
    penalty = np.hstack([np.sqrt(alpha) * np.eye(M - q), np.zeros((M - q, q))])
    inverse = np.linalg.pinv(np.vstack([design, penalty]), rcond=1e-14)[:, :400]
    w = inverse @ y
    size = abs(w).max()
    assert_allclose(z, Z @ w[: M - q], atol=1e-8 * size)
    t = system.design(X)[1]
    assert_allclose(t.T @ b, design[:, M - q :] @ w[M - q :], atol=1e-8 * size)
    assert_allclose(system.Q.T @ z, np.zeros((q, 2)), atol=1e-9 * size)
    assert_allclose(dof, np.trace(design @ inverse), rtol=1e-9)
    residual = np.linalg.norm(y - design @ w, axis=0)
    assert_allclose(equations.residual_norms(z, b), residual, rtol=1e-8)
    # The norms are those of any coordinates, not of the solution only.
    rng = np.random.default_rng(1)
    z, b = rng.normal(size=z.shape), rng.normal(size=b.shape)
    z = Z @ (Z.T @ z)
    residual = np.linalg.norm(y - a.T @ z - t.T @ b, axis=0)
    assert_allclose(equations.residual_norms(z, b), residual, rtol=1e-9)
    # And with the factor's own upper triangle as working memory.
    z, b, dof = equations.solve(system, alpha, system.lower)
    assert_allclose(z, Z @ w[: M - q], atol=1e-8 * size)
    assert_array_equal(np.tril(system.lower), lower)


def test_copied_equations_share_nothing():
    system, X, y = normal_rows("linear", n_centers=12)
    equations = NormalEquations.empty(system, system.lower, 2)
    equations.add(system, X[:300], y[:300].__getitem__)
    duplicate = equations.copy()
    for name, values in vars(equations).items():
        assert not np.shares_memory(values, getattr(duplicate, name)), name
    before = duplicate.copy()
    equations.add(system, X[300:], y[300:].__getitem__)
    for name, values in vars(before).items():
        assert_array_equal(values, getattr(duplicate, name), err_msg=name)


def test_residuals_below_rounding_are_zero():
    system, X, _ = normal_rows(None, n_centers=20)
    y = system.design(X)[0].T[:, :2] * 1e6
    equations = NormalEquations.empty(system, system.lower, 2)
    equations.add(system, X, y.__getitem__)
    F = np.empty_like(system.lower)
    norms = equations.residual_norms(*equations.solve(system, 0.0, F)[:2])
    assert (norms >= 0).all()
    # The root of 400 sums of 400 squares times the unit of rounding.
    assert_allclose(norms / 1e6, 0.0, atol=1e-5)


def test_polynomials_that_the_rows_do_not_tell_are_left_at_zero():
    model = KoopmanKernelRegressor(
        centers=GIVEN, method="least_squares", trend="linear", alpha=0.5
    )
    model.partial_fit(GIVEN[:2], [3.0, 4.0])
    assert_allclose(model.predict(GIVEN[:2]), [3.0, 4.0], rtol=1e-9)
    assert (abs(model.predict(GIVEN)) < 30).all()
    assert (abs(model.trend_coef_) < 30).all()


@pytest.mark.slow
@pytest.mark.parametrize("trend", [None, "linear"])
def test_regression_of_arrays_on_disk(tmp_path, trend):
    n, d = 40_000, 32
    rng = np.random.default_rng(0)
    X = np.memmap(tmp_path / "X", dtype=np.float64, mode="w+", shape=(n, d))
    y = np.memmap(tmp_path / "y", dtype=np.float64, mode="w+", shape=(n, 2))
    X[...] = rng.uniform(size=(n, d))
    y[...] = np.column_stack([X[:, 0] * X[:, 1], np.sin(X[:, 2])])
    X.flush(), y.flush()
    X = np.memmap(tmp_path / "X", dtype=np.float64, mode="r", shape=(n, d))
    y = np.memmap(tmp_path / "y", dtype=np.float64, mode="r", shape=(n, 2))
    model = KoopmanKernelRegressor(
        beta=2.0, centers=X[:40], method="least_squares", trend=trend, alpha=0.1
    )
    expected = clone(model).fit(np.array(X), np.array(y))
    tracemalloc.start()
    try:
        model.fit(X, y)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < X.nbytes
    assert_allclose(model.dual_coef_, expected.dual_coef_, rtol=1e-12)
    assert_allclose(model.noise_std_, expected.noise_std_, rtol=1e-12)
    streamed = clone(model)
    for start in range(0, n, 10_000):
        streamed.partial_fit(X[start : start + 10_000], y[start : start + 10_000])
    T = np.array(X[:100])
    assert_allclose(streamed.predict(T), expected.predict(T), atol=1e-9)
    assert_allclose(streamed.noise_std_, expected.noise_std_, rtol=1e-6)


class Counting(ThreadingBackend):
    """Stands for the backends of clusters; notes the rows that each task is given."""

    tasks = []

    def submit(self, func, callback=None):  # joblib >= 1.5
        self.note(func)
        return super().submit(func, callback)

    def apply_async(self, func, callback=None):
        self.note(func)
        return super().apply_async(func, callback)

    def note(self, calls):
        for _, args, _ in calls.items:
            lengths = [len(value) for value in args if isinstance(value, np.ndarray)]
            Counting.tasks.append(lengths)


class CountingAllAtOnce(Counting):
    """Cannot return its results one by one."""

    supports_return_generator = False


@pytest.fixture
def backends():
    Counting.tasks = []
    registered = {"counting": Counting, "all at once": CountingAllAtOnce}
    for name, backend in registered.items():
        joblib.register_parallel_backend(name, backend)
    yield
    for name in registered:
        del BACKENDS[name]


def summed(n_jobs=None, operations=0.0, X=None, y=None, n_rows=401, n_centers=12):
    """Return the sums over rows, which two or three do not divide evenly."""
    system, _, _ = normal_rows("linear", n_centers, kernel="wendland_c2", beta=1.0)
    if X is None:
        X, y = samples(n_rows)
    outputs = y.__getitem__
    return sum_normal_equations(
        system, system.lower, X, outputs, 2, n_jobs, parallel_operations=operations
    )


def assert_same_sums(found, expected):
    for name, values in vars(expected).items():
        got = getattr(found, name)
        if name == "upper":
            got, values = np.triu(got, 1), np.triu(values, 1)
        atol = 1e-12 * np.max(np.abs(values))
        assert_allclose(got, values, rtol=0, atol=atol, err_msg=name)


@pytest.mark.slow
def test_processes_share_the_rows(tmp_path):
    expected = summed(n_jobs=1)
    assert_same_sums(summed(n_jobs=2), expected)  # by loky
    X, y = samples(401)
    for name, values in (("X", X), ("y", y)):
        np.save(tmp_path / name, values)
    X = np.load(tmp_path / "X.npy", mmap_mode="r")
    y = np.load(tmp_path / "y.npy", mmap_mode="r")
    assert_same_sums(summed(n_jobs=2, X=X, y=y), expected)


@pytest.mark.parametrize("n_jobs", [2, 3])
def test_threads_share_the_rows(n_jobs):
    with joblib.parallel_config("threading", n_jobs=n_jobs):
        assert_same_sums(summed(), summed(n_jobs=1))


@pytest.mark.parametrize("backend", ["counting", "all at once"])
def test_any_backend_gets_shares(backends, backend):
    expected = summed(n_jobs=1)
    operations = 401 * 12**2
    with joblib.parallel_config(backend, n_jobs=3):
        assert_same_sums(summed(operations=operations + 1), expected)
        assert Counting.tasks == []  # too few operations
        assert_same_sums(summed(operations=operations), expected)
    # A worker is given its share, not all rows and a number.
    assert sorted(Counting.tasks) == [[133, 133], [134, 134], [134, 134]]


def test_small_fit_starts_no_workers(backends):
    X, y = samples(401)
    model = KoopmanKernelRegressor(centers=GIVEN, method="least_squares")
    with joblib.parallel_config("counting", n_jobs=3):
        model.fit(X, y)
    assert Counting.tasks == []


@pytest.mark.slow
def test_large_fit_shares_its_rows(backends):
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(16_000, 2))
    centers, coefficients = X[:2600], rng.normal(size=20)
    kernel = as_kernel("wendland_c0", 0.5, 2)
    y = kernel(X, centers[:20]) @ coefficients  # in the span of the sections
    model = KoopmanKernelRegressor(kernel, centers=centers, method="least_squares")
    with joblib.parallel_config("counting", n_jobs=2):
        model.fit(X, y)
    assert [8000, 8000] in Counting.tasks
    assert_allclose(model.predict(X), y, atol=1e-8 * abs(y).max())


def test_rows_fewer_than_workers(backends):
    expected = summed(n_jobs=1, n_rows=6)
    with joblib.parallel_config("counting", n_jobs=20):
        assert_same_sums(summed(n_rows=6), expected)
    assert Counting.tasks == 6 * [[1, 1]]


# Parameters that change between batches.


CHANGES = {
    "kernel": {"kernel": "matern52"},
    "scale": {"beta": 3.0},
    "trend": {"trend": "linear"},
    "method": {"method": "least_squares", "centers": None},
    "centres": {"method": "least_squares", "centers": np.zeros((3, 2))},
}


@pytest.mark.parametrize("change", CHANGES)
def test_changed_parameters_are_refused(change):
    X, y = samples(60)
    centers = (
        X[:10] if change in ("method", "centres") else SeparatedCenterSelector(0.3)
    )
    method = "least_squares" if change in ("method", "centres") else "interpolation"
    model = KoopmanKernelRegressor(beta=1.0, centers=centers, method=method)
    model.partial_fit(X[:30], y[:30])
    before = model.predict(X)
    model.set_params(**CHANGES[change])
    with pytest.raises(ValueError, match="Parameters were changed since the first"):
        model.partial_fit(X[30:], y[30:])
    np.testing.assert_array_equal(model.predict(X), before)


@pytest.mark.parametrize("separation", [0.05, 0.1, 0.15, 0.3])
@pytest.mark.parametrize("alpha", [0.0, 0.01])
def test_another_separation_selects_anew(separation, alpha):
    """A wider one drops earlier centres, which must not stay in the factor."""
    rng = np.random.default_rng(3)
    X = rng.uniform(size=(60, 2))
    y = X @ [1.0, 3.0]
    centers = SeparatedCenterSelector(0.1)
    model = KoopmanKernelRegressor(beta=1.0, centers=centers).fit(X[:20], y[:20])
    model.set_params(centers=SeparatedCenterSelector(separation), alpha=alpha)
    model.partial_fit(X[20:], y[20:])
    chosen = model.center_indices_
    np.testing.assert_array_equal(model.centers_, X[chosen])
    once = KoopmanKernelRegressor(beta=1.0, centers=X[chosen], alpha=alpha).fit(X, y)
    np.testing.assert_allclose(model.predict(X), once.predict(X), atol=1e-8)
