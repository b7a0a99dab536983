"""Recorded walking: each treadmill trial, that is each speed, left out in turn."""

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)

DELAYED = {"delays": 3, "delay_step": 5}


def rms(error):
    return np.sqrt((error**2).sum(axis=1).mean())


def left_out(model, pairs):
    error = np.empty_like(pairs.y)
    for train, test in TrajectoryKFold(4).split(pairs.X, groups=pairs.groups):
        model.fit(pairs.X[train], pairs.y[train])
        error[test] = model.predict(pairs.X[test]) - pairs.y[test]
    return rms(error)


def koopman(kernel, beta, alpha, separation=0.2, **options):
    return make_pipeline(
        StandardScaler(),
        KoopmanKernelRegressor(
            kernel,
            beta=beta,
            alpha=alpha,
            centers=SeparatedCenterSelector(separation),
            **options,
        ),
    )


def past(ankles, lag):
    """Ankle now, and one sample before, on the rows that `DELAYED` makes."""
    reach = 10
    now = np.vstack([y[reach:-lag] for y in ankles])
    return now, np.vstack([y[reach - 1 : -lag - 1] for y in ankles])


@pytest.mark.slow
def test_delays_and_least_squares_beat_persistence(walking):
    angles, ankles = walking
    pairs = trajectory_pairs(angles, ankles, **DELAYED)
    now, _ = past(ankles, 1)
    model = koopman("matern52", 10.0, 1e-4, method="least_squares")
    assert rms(now - pairs.y) > 3.5 * left_out(model, pairs)


@pytest.mark.slow
def test_delays_and_least_squares_beat_the_angles_alone(walking):
    """Two angles are no state of a gait: interpolation shows it most."""
    angles, ankles = walking
    alone, delayed = (
        trajectory_pairs(angles, ankles, **embedding) for embedding in ({}, DELAYED)
    )
    interpolation = koopman("matern32", 10.0, 0.0)
    least_squares = koopman("matern52", 10.0, 1e-4, method="least_squares")
    errors = [
        left_out(model, pairs)
        for pairs in (alone, delayed)
        for model in (interpolation, least_squares)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 2.5 * errors[-1]


@pytest.mark.slow
def test_outputs_in_the_state_beat_constant_velocity(walking):
    angles, ankles = walking
    pairs = trajectory_pairs(angles, ankles, outputs_in_state=True, **DELAYED)
    now, before = past(ankles, 1)
    model = koopman("matern32", 4.0, 1e-2, 0.2, method="least_squares", trend="linear")
    assert left_out(model, pairs) < 0.95 * rms(2 * now - before - pairs.y)


@pytest.mark.slow
def test_tenth_of_a_second_ahead_is_learned(walking):
    angles, ankles = walking
    pairs = trajectory_pairs(angles, ankles, lag=15, **DELAYED)
    now, _ = past(ankles, 15)
    model = koopman("gaussian", 2.5, 1e-4, method="least_squares")
    assert rms(now - pairs.y) > 10 * left_out(model, pairs)


@pytest.mark.parametrize(
    "trial", [0, *(pytest.param(trial, marks=pytest.mark.slow) for trial in (1, 2, 3))]
)
def test_operator_finds_the_stride_and_its_harmonics(walking, trial):
    """The rate of strides, known from the autocorrelation of the knee."""
    angles, ankles = (motion[trial] for motion in walking)
    knee = angles[:, 1] - angles[:, 1].mean()
    autocorrelation = np.correlate(knee, knee, mode="full")[len(knee) - 1 :]
    rate = 150 / (60 + autocorrelation[60:400].argmax())
    pairs = trajectory_pairs(angles, ankles, delays=5, delay_step=5)
    model = make_pipeline(
        StandardScaler(),
        KernelEDMD(
            "matern52",
            beta=10.0,
            centers=SeparatedCenterSelector(0.4),
            method="least_squares",
            alpha=1e-3,
        ),
    ).fit(pairs.X, pairs.y, kerneledmd__sample_index=pairs.sample_index)
    growth_rates, frequencies = model[-1].continuous_eigenvalues(1 / 150)
    np.testing.assert_allclose(frequencies[1:6:2], rate * np.arange(1, 4), rtol=0.03)
    assert model[-1].residuals_[:6].max() < 0.04
    # A gait is not quite periodic: it forgets its phase, the harmonics first.
    assert (np.diff(growth_rates[1:6:2]) < 0).all()
    assert -0.1 < growth_rates[1] < 0
