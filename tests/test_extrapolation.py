"""Warnings about predictions at states that are far from all training data."""

import warnings

import numpy as np
import pytest
from scipy.optimize import brentq
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    WhiteKernel,
)
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    ExtrapolationWarning,
    KernelEDMD,
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman.datasets import make_walking
from sklearn_koopman.kernels import KERNELS

WARNING = "far from the training data"


def does_warn(predict, *args, **parameters):
    """Tell whether a call warns, once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        predict(*args, **parameters)
    assert {w.category for w in caught} <= {ExtrapolationWarning}
    assert len(caught) <= 1
    return bool(caught)


@pytest.fixture(scope="module")
def walking():
    """Angles in radians one speed at a time, and the ankle in mm."""
    return make_walking(n_trials=3, n_strides=4, random_state=0)


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_limit_is_one_percent_of_the_squared_power_function(name):
    """With one centre P(x)^2 = 1 - phi(r)^2, so that 1 % are lost at phi(r) = 0.1."""
    model = KoopmanKernelRegressor(name, beta=2.0).fit([[0.0]], [1.0])
    limit = brentq(lambda x: model.power_function([[x]])[0] ** 2 - 0.99, 0.1, 100.0)
    assert not does_warn(model.predict, [[0.999 * limit]])
    assert does_warn(model.predict, [[1.001 * limit]])


@pytest.mark.parametrize("name", ["matern32", "wendland_c2", "gaussian"])
def test_far_states_have_the_power_function_of_no_data(name):
    """States are warned about exactly if no centre has a correlation of 0.1."""
    rng = np.random.default_rng(0)
    X = rng.uniform(size=(300, 2))
    model = KoopmanKernelRegressor(name, beta=0.2, alpha=1e-3).fit(X, X)
    states = rng.uniform(-1.0, 2.0, size=(200, 2))
    correlations = model.kernel_(states, X).max(axis=1)
    for state, correlation in zip(states, correlations, strict=True):
        assert does_warn(model.predict, state[np.newaxis]) == (correlation < 0.1)
    far = states[correlations < 0.01]
    assert len(far) > 10
    assert model.power_function(far).min() ** 2 > 0.99


@pytest.mark.parametrize("n_jobs", [1, 2])
@pytest.mark.parametrize("n_rows", [1, 70, 5000])
def test_one_far_state_among_many_is_found(n_rows, n_jobs):
    """Wherever it stands, with few rows and with many, whichever centre is near."""
    rng = np.random.default_rng(1)
    X = np.sort(rng.uniform(0, 100, size=1000))[:, np.newaxis]
    model = KoopmanKernelRegressor(beta=0.5, alpha=1e-6, n_jobs=n_jobs).fit(X, X[:, 0])
    states = rng.choice(X, n_rows)
    assert not does_warn(model.predict, states)
    states[rng.integers(n_rows)] = 110.0
    assert does_warn(model.predict, states)


@pytest.mark.parametrize(
    "n_centers", [127, 129, pytest.param(2600, marks=pytest.mark.slow)]
)
def test_any_number_of_centres_tells_far_states(n_centers):
    """Some centres are asked first, in blocks that must fit their working memory."""
    X = np.linspace(0, 1, n_centers)[:, np.newaxis]
    model = KoopmanKernelRegressor(beta=0.1, centers=X, method="least_squares")
    model.set_params(alpha=1e-3).fit(X, X[:, 0])
    states = np.linspace(0, 1, 4000)[:, np.newaxis]
    assert not does_warn(model.predict, states)
    assert does_warn(model.predict, np.vstack([states, [[1.5]]]))


def test_sparse_matrices_tell_far_states():
    """Products with a compact kernel are sparse, and know the rows without a centre."""
    X = np.linspace(0, 1, 2000)[:, np.newaxis]
    model = KoopmanKernelRegressor("wendland_c2", beta=0.003, alpha=1e-6)
    model.fit(X, X[:, 0])
    states = np.linspace(0, 1, 500)[:, np.newaxis]
    assert not does_warn(model.predict, states)
    assert does_warn(model.predict, np.vstack([states, [[1.003]]]))


def test_distances_tell_far_states():
    """With precomputed distances the rows themselves say how far the centres are."""
    X = np.linspace(0, 1, 50)[:, np.newaxis]
    model = make_pipeline(
        SeparatedCenterSelector(0.1),
        KoopmanKernelRegressor(beta=0.2, centers="precomputed"),
    ).fit(X, X[:, 0])
    assert not does_warn(model.predict, X)
    assert does_warn(model.predict, X + 1.5)


def test_foreign_kernels_tell_far_states():
    """Amplitude and noise do not count; a kernel without an end has no far states."""
    X = np.linspace(0, 1, 20)[:, np.newaxis]
    stationary = 1e4 * RBF(0.1) + WhiteKernel(0.1)
    model = KoopmanKernelRegressor(stationary).fit(X, X[:, 0])
    assert not does_warn(model.predict, X)
    assert does_warn(model.predict, X + 2)
    linear = KoopmanKernelRegressor(
        DotProduct() + ConstantKernel(),
        method="least_squares",
        centers=X[[0, -1]],
        alpha=1.0,
    ).fit(X, X[:, 0])
    assert not does_warn(linear.predict, 100 * X)
    through_zero = KoopmanKernelRegressor(
        DotProduct(0.0), method="least_squares", centers=X[[1, -1]], alpha=1.0
    ).fit(X, X[:, 0])
    assert not does_warn(through_zero.predict, X)  # k(0, 0) is 0


def test_degrees_given_to_a_model_of_radians(walking):
    """Before, an ankle at -1e-13 mm instead of -800 came out without a word."""
    angles, ankles = walking.trajectories, walking.outputs
    pairs = trajectory_pairs(angles[:2], ankles[:2])
    fresh = trajectory_pairs(angles[2], ankles[2])
    model = KoopmanKernelRegressor(
        beta=1.0,
        centers=SeparatedCenterSelector(0.02),
        method="least_squares",
        alpha=1e-3,
    ).fit(pairs.X, pairs.y)
    assert not does_warn(model.predict, fresh.X)
    assert not does_warn(model.predict, fresh.X, return_std=True)
    degrees = np.degrees(fresh.X[np.abs(fresh.X).min(axis=1) > 0.1])
    with pytest.warns(ExtrapolationWarning, match=f"All states .* {WARNING}"):
        y = model.predict(degrees)
    assert np.abs(y).max() < 1.0
    assert does_warn(model.predict, degrees, return_std=True)


def test_states_that_no_scaler_has_seen(walking):
    """The last step of a pipeline, given the states of the first."""
    pairs = trajectory_pairs(walking.trajectories, walking.outputs)
    states = pairs.X + 10.0  # an offset that the scaler takes away
    pipeline = make_pipeline(
        StandardScaler(),
        KernelEDMD(
            beta=2.0,
            centers=SeparatedCenterSelector(0.2),
            method="least_squares",
            alpha=1e-3,
        ),
    ).fit(states, pairs.y, kerneledmd__sample_index=pairs.sample_index)
    scaled, edmd = pipeline[:-1].transform(states), pipeline[-1]
    assert not does_warn(pipeline.predict, states)
    for relift in (False, True):
        assert not does_warn(edmd.forecast, scaled[:5], 3, relift=relift)
        assert does_warn(edmd.forecast, states[:5], 3, relift=relift)
    assert does_warn(edmd.predict, states)
    assert not does_warn(edmd.eigenfunctions, scaled)
    assert does_warn(edmd.eigenfunctions, states)


def test_search_is_silent_and_its_winner_warns(walking):
    """A scale that reaches no held-out row shows in its score."""
    pairs = trajectory_pairs(walking.trajectories, walking.outputs, delays=2)
    search = KoopmanKernelRegressorCV(
        betas=[1e-4, 1.0],
        alphas=[1e-3],
        centers=SeparatedCenterSelector(0.1),
        method="least_squares",
        cv=TrajectoryKFold(3),
    )
    assert not does_warn(search.fit, pairs.X, pairs.y, groups=pairs.groups)
    assert search.best_beta_ == 1.0
    assert not does_warn(search.predict, pairs.X)
    assert does_warn(search.predict, np.degrees(pairs.X))
