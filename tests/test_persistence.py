"""Files of fitted models: they hold public classes and arrays, and they last."""

import pickle
import pickletools
from pathlib import Path

import joblib
import numpy as np
import pytest
from fixtures.make_models import evaluate, fit_models

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
)
from sklearn_koopman.datasets import make_pendulum

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

VERSIONS = sorted(p for p in (Path(__file__).parent / "fixtures").glob("*.*.*"))
NAMES = sorted(path.stem for path in VERSIONS[-1].glob("*.pkl"))


@pytest.fixture(scope="module")
def fitted():
    return fit_models()


def states_for(name, models, X):
    return models["selector"].transform(X) if name.endswith("precomputed") else X


def is_private(name):
    package, *_ = name.split(".")
    return package == "sklearn_koopman" and any(
        part.startswith("_") for part in name.split(".")
    )


def named_classes(data):
    """Names of all classes and functions in a pickle."""
    return {
        argument.replace(" ", ".")
        for operation, argument, _ in pickletools.genops(data)
        if operation.name == "GLOBAL"
    }


# What earlier versions have stored is loaded, and does what it did.


def test_every_kind_of_model_is_stored(fitted):
    assert sorted(fitted[0]) == NAMES


@pytest.mark.parametrize("folder", VERSIONS, ids=lambda path: path.name)
def test_stored_models_do_what_they_did(folder):
    expected = np.load(folder / "expected.npz")
    paths = sorted(folder.glob("*.pkl"))
    models = {path.stem: pickle.loads(path.read_bytes()) for path in paths}
    for name, model in models.items():
        X = states_for(name, models, expected["X"])
        for key, values in evaluate(name, model, X).items():
            np.testing.assert_allclose(
                *(values, expected[f"{name}.{key}"]),
                # Stored coefficients are as large as the matrix is ill-conditioned.
                rtol=1e-3 if key == "rcond" else 1e-7,
                atol=1e-9,
                err_msg=f"{name}: {key}",
            )


# What this version stores.


@pytest.mark.parametrize("name", NAMES)
def test_no_private_class_is_in_a_pickle(fitted, name):
    names = named_classes(pickle.dumps(fitted[0][name], protocol=2))
    assert any(one.startswith("sklearn_koopman.") for one in names)
    assert not [one for one in names if is_private(one)]


@pytest.mark.parametrize("name", NAMES)
def test_skops_asks_for_no_private_name(fitted, name):
    skops = pytest.importorskip("skops.io")
    model = fitted[0][name]
    data = skops.dumps(model)
    untrusted = skops.get_untrusted_types(data=data)
    public = ("sklearn_koopman.", "sklearn.gaussian_process.kernels.")
    assert not [one for one in untrusted if is_private(one)]
    assert all(one.startswith(public) for one in untrusted)
    loaded = skops.loads(data, trusted=untrusted)
    X = states_for(name, fitted[0], fitted[1])
    for key, values in evaluate(name, loaded, X).items():
        expected = evaluate(name, model, X)[key]
        np.testing.assert_allclose(values, expected, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_loaded_models_can_be_stored_again(fitted, name, tmp_path):
    model = fitted[0][name]
    X = states_for(name, fitted[0], fitted[1])
    expected = evaluate(name, model, X)
    for _ in range(2):
        joblib.dump(model, tmp_path / "model.joblib")
        model = joblib.load(tmp_path / "model.joblib")
        for key, values in evaluate(name, model, X).items():
            np.testing.assert_allclose(values, expected[key], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("kind", ["regressor", "edmd", "search"])
def test_given_centres_are_stored_once(kind):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(700, 60)), rng.normal(size=700)
    options = {"centers": X[:300], "method": "least_squares"}
    model = {
        "regressor": KoopmanKernelRegressor(alpha=1.0, **options),
        "edmd": KernelEDMD(alpha=1.0, n_modes=2, **options),
        "search": KoopmanKernelRegressorCV(
            betas=[9.0], alphas=[1.0, 2.0], cv=3, **options
        ),
    }[kind]
    more = {"X_next": 0.9 * X} if kind == "edmd" else {}
    model.fit(X, y, **more)
    size = 300 * 60 * 8
    # Beside the centres, an operator has coefficients of all features.
    rest = (60 + 10) * 300 * 8 if kind == "edmd" else 0
    assert size < len(pickle.dumps(model)) < 1.15 * size + rest
    loaded = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(loaded.centers_, X[:300])
    # The parameter is the user's, who may write to it.
    expected = model.predict(X[:5])
    loaded.centers[:] = 0.0
    np.testing.assert_array_equal(loaded.centers_, X[:300])
    np.testing.assert_array_equal(loaded.predict(X[:5]), expected)


def test_arrays_of_a_search_are_stored_once(fitted):
    model = fitted[0]["regressor_cv"]
    whole, best = (len(pickle.dumps(one)) for one in (model, model.best_estimator_))
    assert whole < best + 3000  # the table of scores


def test_condition_number_survives_storage():
    pendulum = make_pendulum(80)
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector(0.3))
    model.fit(pendulum.X, pendulum.y)
    loaded = pickle.loads(pickle.dumps(model))
    assert "_system" not in vars(loaded)
    assert loaded.rcond_ == model.rcond_
    assert "_system" not in vars(loaded)  # it took no new factorisation


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.float64])
def test_centres_keep_their_precision(dtype):
    """Single precision would lose what differences of large coordinates hold."""
    rng = np.random.default_rng(1)
    X = (1000 + rng.integers(-40, 40, (200, 2)) / 64).astype(dtype)
    X = np.unique(X, axis=0)
    y = np.sin(X[:, 0])
    model = KoopmanKernelRegressor(
        beta=0.05, centers=X[::4], method="least_squares", alpha=1e-8, trend="linear"
    )
    if dtype is np.int64:
        model.set_params(trend=None, beta=1.0)
    model.fit(X, y)
    loaded = pickle.loads(pickle.dumps(model))
    assert loaded.centers_.dtype == np.float64
    np.testing.assert_array_equal(loaded.predict(X), model.predict(X))
