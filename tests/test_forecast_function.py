"""Forecasts through pipelines and searches."""

import numpy as np
import pandas as pd
import pytest
from sklearn.compose import TransformedTargetRegressor
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler

from sklearn_koopman import ExtrapolationWarning, KernelEDMD, TrajectoryKFold, forecast
from sklearn_koopman.datasets import make_pendulum


@pytest.fixture(scope="module")
def states():
    """In degrees and degrees per second."""
    return np.degrees(make_pendulum(200, step=0.1).trajectories[0])


@pytest.fixture(scope="module")
def edmd():
    return KernelEDMD("wendland_c4", beta=4.0, n_modes=20)


@pytest.mark.parametrize("relift", [False, True])
@pytest.mark.parametrize("with_outputs", [False, True])
def test_pipeline(states, edmd, with_outputs, relift):
    """It gives what the steps give one by one, and what the motion does."""
    X, X_next = states[:-1], states[1:]
    y = X_next[:, 1] if with_outputs else None
    pipeline = make_pipeline(StandardScaler(), MinMaxScaler((-1, 1)), edmd).fit(X, y)
    found = forecast(pipeline, X[3:5], 30, relift=relift)
    inside = pipeline[1].transform(pipeline[0].transform(X))
    wanted = pipeline[-1].forecast(inside[3:5], 30, relift=relift)
    np.testing.assert_array_equal(found, wanted)
    if with_outputs:
        assert np.abs(found[0] - y[3:33]).max() < 0.5  # of 128 degrees
        with pytest.warns(ExtrapolationWarning):
            unscaled = pipeline[-1].forecast(X[3:4], 30)[0]
        assert np.abs(unscaled - y[3:33]).max() > 50
    else:
        assert np.abs(found[0] - inside[4:34]).max() < 0.01


def test_bare_operator_nested_pipeline_and_search(states, edmd):
    frame = pd.DataFrame(states[:-1], columns=["q", "v"])
    y = states[1:]
    bare = edmd.fit(frame, y)
    np.testing.assert_array_equal(
        forecast(bare, frame[:2], 9), bare.forecast(frame[:2], 9)
    )
    inner = make_pipeline(MinMaxScaler(), KernelEDMD(n_modes=0))
    nested = make_pipeline(StandardScaler(), inner).fit(frame, y)
    flat = make_pipeline(StandardScaler(), *[step for _, step in inner.steps])
    np.testing.assert_array_equal(
        forecast(nested, frame[:2], 9), forecast(flat.fit(frame, y), frame[:2], 9)
    )
    search = GridSearchCV(flat, {"kerneledmd__beta": [0.5, 2.0]}, cv=TrajectoryKFold(2))
    search.fit(frame, y)
    wanted = forecast(search.best_estimator_, frame[:2], 9)
    np.testing.assert_array_equal(forecast(search, frame[:2], 9), wanted)


def test_models_that_do_not_forecast(states, edmd):
    X, y = states[:-1], states[1:]
    pipeline = make_pipeline(StandardScaler(), KernelEDMD(n_modes=0))
    search = GridSearchCV(pipeline, {"kerneledmd__beta": [1.0]}, cv=2)
    for model in (KernelEDMD(), pipeline, search):
        with pytest.raises(NotFittedError):
            forecast(model, X, 3)
    with pytest.raises(TypeError, match=r"GridSearchCV .*; search with refit=True"):
        forecast(search.set_params(refit=False).fit(X, y), X, 3)
    with pytest.raises(
        TypeError, match=r"LinearRegression has no .*; use a KernelEDMD"
    ):
        forecast(make_pipeline(LinearRegression()).fit(X, y), X, 3)
    with pytest.raises(
        TypeError, match=r"str has no method forecast; use a KernelEDMD"
    ):
        forecast("model", X, 3)
    wrapped = TransformedTargetRegressor(pipeline, transformer=StandardScaler())
    with pytest.raises(NotFittedError):
        forecast(wrapped, X, 3)
    wrapped.fit(X, y)
    with pytest.raises(
        TypeError, match=r"Regressor has no .*; use its regressor_, whose"
    ):
        forecast(wrapped, X, 3)
    back = wrapped.transformer_.inverse_transform
    y_pred = back(forecast(wrapped.regressor_, X[:1], 3)[0])
    np.testing.assert_allclose(y_pred, y[:3], atol=2.0)
    with pytest.raises(ValueError, match="n_steps must be an integer of at least 1"):
        forecast(wrapped.regressor_, X, 0)
