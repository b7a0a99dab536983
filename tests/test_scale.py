"""Default scales: those of the data, whatever the unit and the origin of the states."""

import pickle
import warnings
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.frozen import FrozenEstimator
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman._utils._rows import CHUNK_ROWS, spread
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.diagnostics import convergence_study
from sklearn_koopman.kernels import Gaussian, MaternSobolev, as_kernel
from sklearn_koopman.plotting import CenterSelectionDisplay

METHODS = ["interpolation", "least_squares"]
# Factors and shifts in units of the former spread. A shift by s costs s times 1e-16 of
# the differences between states.
UNITS = [(1e-6, 0.0), (57.3, 0.0), (1e6, 0.0), (1.0, 1e3), (57.3, -20.0)]


@pytest.fixture(scope="module")
def pendulum():
    return make_pendulum(200, step=0.1)


@pytest.fixture(scope="module")
def elsewhere(pendulum):
    return make_pendulum(50, step=0.1, initial=pendulum.X_next[-1]).X


def moved(X, unit):
    factor, shift = unit
    return factor * (X + shift * spread(X))


# --- The measure ----------------------------------------------------------------------


def test_spread_is_the_root_of_the_summed_variances():
    X = np.random.default_rng(0).normal(3, [1, 2, 5], size=(2 * CHUNK_ROWS + 7, 3))
    assert_allclose(spread(X), np.sqrt(X.var(axis=0).sum()), rtol=1e-13)
    from_mean = np.linalg.norm(X - X.mean(axis=0), axis=1)
    assert_allclose(spread(X), np.sqrt(np.mean(from_mean**2)), rtol=1e-13)
    assert spread(np.array([[0.0], [2.0], [4.0], [6.0]])) == np.sqrt(5)
    assert spread(np.asfortranarray(X)) == spread(X)
    assert type(spread(X)) is float


def test_weights_of_the_spread_count_rows():
    rng = np.random.default_rng(1)
    X, weight = rng.normal(size=(60, 2)), rng.integers(1, 4, 60)
    repeated = np.repeat(X, weight, axis=0)
    assert_allclose(spread(X, weight), spread(repeated), rtol=1e-13)
    assert_allclose(spread(X, 0.1 * weight), spread(repeated), rtol=1e-13)


@pytest.mark.parametrize("row", [[0.1, 1 / 3], [0.0, 0.0], [1e9 + 0.1, -1e-9]])
def test_equal_rows_have_the_spread_one(row):
    assert spread(np.array([row])) == 1.0
    assert spread(np.array([row] * 7)) == 1.0


def test_spread_of_the_largest_numbers_is_a_number():
    X = np.array([[-1.5e308], [1.5e308]])
    assert spread(X) == 1.5e308


def test_spread_keeps_its_digits_beside_an_offset_and_in_any_unit():
    X = np.random.default_rng(2).integers(-50, 50, size=(300, 2)).astype(float)
    assert_allclose(spread(X + 2.0**40), spread(X), rtol=1e-12)
    for unit in (2.0**-500, 2.0**500):
        assert spread(unit * X) == unit * spread(X)


# --- What "scale" means ---------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_beta_of_a_name_is_the_spread_and_a_kernel_keeps_its_own(pendulum, method):
    X, y = pendulum.X, pendulum.y
    options = {"method": method, "alpha": 1e-3, "centers": X[::5]}
    model = KoopmanKernelRegressor("wendland_c2", **options).fit(X, y)
    assert_allclose(model.kernel_.beta, np.sqrt(X.var(axis=0).sum()), rtol=1e-13)
    same = KoopmanKernelRegressor("wendland_c2", beta=spread(X), **options).fit(X, y)
    assert_array_equal(model.predict(X), same.predict(X))
    for beta in ("scale", None):
        options["beta"] = beta
        own = KoopmanKernelRegressor(MaternSobolev(0.7), **options).fit(X, y)
        assert own.kernel_.beta == 0.7
        foreign = KoopmanKernelRegressor(RBF(0.7) + WhiteKernel(0.1), **options)
        assert foreign.fit(X, y).kernel_ == RBF(0.7) + WhiteKernel(0.1)
    plain = KoopmanKernelRegressor("gaussian", **options).fit(X, y)
    assert plain.kernel_ == Gaussian(1.0)  # as ever for None


def test_beta_of_an_operator_is_the_spread_of_rows_with_a_successor():
    X = make_pendulum(61, step=0.1).X
    index = np.arange(61)
    index[40:] += 5
    X[40] += 50  # has a successor
    X[60] += 1e3  # has none
    here = np.delete(np.arange(60), 39)
    model = KernelEDMD("matern12", centers=X[:30:3], method="least_squares", n_modes=0)
    model.fit(X, sample_index=index)
    assert_allclose(model.kernel_.beta, spread(X[here]), rtol=1e-12)
    own = clone(model).set_params(kernel=Gaussian(2.0)).fit(X, sample_index=index)
    assert own.kernel_.beta == 2.0
    clone(model).set_params(kernel=RBF(2.0)).fit(X, sample_index=index)


def test_distances_do_not_tell_the_scale(pendulum):
    distances = SeparatedCenterSelector(0.6).fit_transform(pendulum.X)
    model = KoopmanKernelRegressor(centers="precomputed", method="least_squares")
    with pytest.raises(ValueError, match=r"beta='scale' .* not known here; set beta"):
        model.fit(distances, pendulum.y)
    for options in ({"beta": 1.5}, {"beta": None}, {"kernel": Gaussian(1.5)}):
        clone(model).set_params(**options).fit(distances, pendulum.y)


@pytest.mark.parametrize("estimator", [KoopmanKernelRegressor, KernelEDMD])
@pytest.mark.parametrize("kernel", ["matern32", Gaussian(), RBF()])
@pytest.mark.parametrize("beta", ["auto", "Scale", "1.0", ""])
def test_other_words_are_refused(pendulum, estimator, kernel, beta):
    model = estimator(kernel, beta=beta)
    with pytest.raises(ValueError, match=f"^beta must be .*'scale'.* got '{beta}'"):
        model.fit(pendulum.X, pendulum.X_next)
    search = KoopmanKernelRegressorCV([kernel], [beta])
    with pytest.raises(ValueError, match=f"^beta must be .*'scale'.* got '{beta}'"):
        search.fit(pendulum.X, pendulum.y)


@pytest.mark.parametrize("separation", ["auto", "", None, -1.0, np.nan, [0.1]])
def test_other_separations_are_refused(pendulum, separation):
    selector = SeparatedCenterSelector(separation)
    with pytest.raises(ValueError, match="separation must be a finite non-n"):
        selector.fit(pendulum.X)


def test_scale_needs_states_in_functions_that_get_none():
    with pytest.raises(ValueError, match="set beta to a number"):
        as_kernel("matern32", "scale", 2)
    assert as_kernel(Gaussian(3.0), "scale", 2).beta == 3.0


@pytest.mark.parametrize("order", ["sequential", "farthest"])
def test_default_separation_is_a_tenth_of_the_spread(order):
    X = make_pendulum(256, step=0.1).X
    selector = SeparatedCenterSelector(order=order).fit(X)
    assert_allclose(selector.separation_, 0.1 * np.sqrt(X.var(axis=0).sum()))
    same = SeparatedCenterSelector(selector.separation_, order=order).fit(X)
    assert_array_equal(selector.center_indices_, same.center_indices_)
    # The paper keeps 37 with 0.23.
    assert 30 < len(selector.center_indices_) < 60
    assert SeparatedCenterSelector(0.23).fit(X).separation_ == 0.23
    # fit takes the spread anew.
    assert_allclose(selector.fit(3 * X).separation_, 3 * same.separation_)


def test_walking_with_delays_gets_hundreds_of_centres(walking):
    pairs = trajectory_pairs(*walking, lag=15, delays=3, delay_step=5)
    for X in (pairs.X, np.degrees(pairs.X), StandardScaler().fit_transform(pairs.X)):
        assert 300 < len(SeparatedCenterSelector().fit(X).center_indices_) < 420


@pytest.mark.slow
def test_walking_is_predicted_with_defaults_in_any_unit(walking):
    """Root mean square of the ankle's error 100 ms ahead, at speeds left out, in mm."""
    pairs = trajectory_pairs(*walking, lag=15, delays=3, delay_step=5)
    scaled = make_pipeline(
        StandardScaler(),
        KoopmanKernelRegressor(
            centers=SeparatedCenterSelector(), method="least_squares", alpha=1e-3
        ),
    )
    errors = []
    for model, X in (
        (scaled, pairs.X),
        (scaled[-1], pairs.X),
        (scaled[-1], np.degrees(pairs.X)),
    ):
        error = np.empty_like(pairs.y)
        for train, test in TrajectoryKFold(4).split(X, pairs.y, pairs.groups):
            model.fit(X[train], pairs.y[train])
            error[test] = model.predict(X[test]) - pairs.y[test]
        errors.append(np.sqrt((error**2).sum(axis=1).mean()))
    assert max(errors) < 12
    assert_allclose(errors[2], errors[1], rtol=1e-6)


# --- Neither the unit nor the origin of the states matters ----------------------------


@pytest.mark.parametrize("unit", UNITS, ids=str)
def test_centres_are_the_same(pendulum, unit):
    X = np.random.default_rng(0).normal(size=(500, 3))
    for order in ("sequential", "farthest"):
        plain = SeparatedCenterSelector(order=order).fit(X)
        found = SeparatedCenterSelector(order=order).fit(moved(X, unit))
        assert_array_equal(found.center_indices_, plain.center_indices_)
        assert_allclose(found.separation_, unit[0] * plain.separation_, rtol=1e-11)


@pytest.mark.parametrize("unit", UNITS, ids=str)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("trend", [None, "linear"])
def test_predictions_are_the_same(pendulum, elsewhere, method, unit, trend):
    X, y = pendulum.X, pendulum.y
    X_new = moved(np.vstack([X, elsewhere]), unit)[len(X) :]
    factor, shift = unit
    X_new = factor * (elsewhere + shift * spread(X))
    model = KoopmanKernelRegressor(
        centers=SeparatedCenterSelector(),
        method=method,
        alpha=1e-6 if method == "least_squares" else 0.0,
        trend=trend,
    )
    expected, std = model.fit(X, y).predict(elsewhere, return_std=True)
    got, got_std = model.fit(moved(X, unit), y).predict(X_new, return_std=True)
    # Rounded states differ by 1e-16 (1 + shift); the Gram matrix loses digits, too.
    atol = 1e-14 * (1 + abs(shift)) / model.rcond_**0.5
    assert atol < 1e-7
    assert_allclose(got, expected, rtol=0, atol=atol)
    assert_allclose(got_std, std, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("unit", UNITS, ids=str)
@pytest.mark.parametrize("method", METHODS)
def test_operators_are_the_same(pendulum, unit, method):
    X, y = pendulum.X, pendulum.y
    model = KernelEDMD(centers=SeparatedCenterSelector(), method=method)
    model.fit(X[:-1], y[:-1], X_next=X[1:])
    Z = moved(X, unit)
    shifted = clone(model).fit(Z[:-1], y[:-1], X_next=Z[1:])
    # The last row has no successor, and so no say.
    assert_allclose(shifted.kernel_.beta, unit[0] * model.kernel_.beta, rtol=1e-11)
    assert_allclose(
        shifted.forecast(Z[:5], 20), model.forecast(X[:5], 20), rtol=0, atol=1e-6
    )
    # Of repeated eigenvalues the order is open.
    assert_allclose(
        np.sort(np.abs(shifted.eigenvalues_))[-9:],
        np.sort(np.abs(model.eigenvalues_))[-9:],
        atol=1e-6,
    )


@pytest.mark.parametrize("unit", UNITS, ids=str)
@pytest.mark.parametrize("method", METHODS)
def test_searches_are_the_same(pendulum, unit, method):
    X, y = pendulum.X, pendulum.y
    search = KoopmanKernelRegressorCV(
        ["matern32", "wendland_c4"],
        alphas=[1e-6, 1e-3],
        centers=SeparatedCenterSelector(),
        method=method,
        cv=KFold(4),
    ).fit(X, y)
    found = clone(search).fit(moved(X, unit), y)
    assert found.best_index_ == search.best_index_
    assert_allclose(
        found.cv_results_["mean_test_score"],
        search.cv_results_["mean_test_score"],
        rtol=1e-6,
    )
    assert_allclose(found.best_beta_, unit[0] * search.best_beta_, rtol=1e-11)
    assert_allclose(found.predict(moved(X, unit)), search.predict(X), atol=1e-8)


# --- Searches -------------------------------------------------------------------------


def test_default_betas_are_multiples_for_names_and_one_for_each_kernel(pendulum):
    X, y = pendulum.X, pendulum.y
    kernels = ["matern32", Gaussian(0.7), "wendland_c2", RBF(0.7) + WhiteKernel(0.1)]
    model = KoopmanKernelRegressorCV(kernels, alphas=[0.1, 1.0], cv=3).fit(X, y)
    multiples = list(np.array([0.3, 1.0, 3.0, 10.0]) * spread(X))
    assert_allclose(
        np.array([one["beta"] for one in model.cv_results_["params"]], dtype=float),
        2 * [*multiples, 0.7, *multiples, np.nan],
    )
    names = [one["kernel"] for one in model.cv_results_["params"]]
    assert names == 2 * [*4 * kernels[:1], kernels[1], *4 * kernels[2:3], kernels[3]]
    assert_array_equal(
        [one["alpha"] for one in model.cv_results_["params"]], 10 * [0.1] + 10 * [1.0]
    )
    # The scores are those of regressors with these numbers.
    regressor = KoopmanKernelRegressor()
    for own, score in zip(
        model.cv_results_["params"], model.cv_results_["mean_test_score"], strict=True
    ):
        scores = []
        for train, test in KFold(3).split(X):
            fitted = clone(regressor).set_params(**own).fit(X[train], y[train])
            scores.append(fitted.score(X[test], y[test]))
        assert_allclose(score, np.mean(scores), rtol=1e-7, atol=1e-9)
    assert model.best_beta_ == model.cv_results_["params"][model.best_index_]["beta"]
    assert model.kernel_ == model.best_estimator_.kernel_


def test_a_list_of_betas_may_name_the_scale(pendulum):
    X, y = pendulum.X, pendulum.y
    model = KoopmanKernelRegressorCV(
        ["matern32", Gaussian(0.7), RBF(0.7)], ["scale", None], [0.1], cv=3
    ).fit(X, y)
    found = [one["beta"] for one in model.cv_results_["params"]]
    assert found == [spread(X), 0.7, None, None, None, None]
    one = KoopmanKernelRegressorCV(betas=["scale"], alphas=[0.1], cv=3).fit(X, y)
    assert one.best_beta_ == one.kernel_.beta == spread(X)
    assert list(one.cv_results_["param_beta"]) == [spread(X)]


def test_grid_searches_take_numbers_and_scale_side_by_side(pendulum):
    X, y = pendulum.X, pendulum.y
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector(), alpha=1e-6)
    grid = {"beta": ["scale", 1.0, None], "centers__separation": ["scale", 0.2]}
    search = GridSearchCV(model, grid, cv=KFold(4)).fit(X, y)
    scores = search.cv_results_["mean_test_score"]
    assert np.isfinite(scores).all()
    assert_array_equal(scores[2:4], scores[4:])  # None is 1
    assert len(set(scores)) == 4
    study = convergence_study(model, X, y, [0.4, 0.2], X, y, dimension=1)
    assert (np.diff(study.n_centers) > 0).all()


def test_displays_draw_the_separation_used(pendulum):
    matplotlib.use("Agg")
    X, y = pendulum.X, pendulum.y
    selector = SeparatedCenterSelector()
    frozen = FrozenEstimator(SeparatedCenterSelector().fit(2 * X))
    options = {"method": "least_squares", "alpha": 1e-3}
    for model, states in (
        (selector, X),
        (KoopmanKernelRegressor(centers=selector), X),
        (KernelEDMD(centers=selector, n_modes=0), X[:-1]),
        (KoopmanKernelRegressorCV(centers=selector, cv=3), X),
        (KoopmanKernelRegressor(centers=frozen, **options), 2 * X),
    ):
        display = CenterSelectionDisplay.from_estimator(model.fit(X, y), X)
        assert_allclose(display.separation, 0.1 * spread(states))
        assert display.circles_ is not None
        plt.close(display.figure_)


# --- Batches --------------------------------------------------------------------------


def test_batches_of_a_selector_keep_the_first_separation(pendulum):
    X = pendulum.X
    selector = SeparatedCenterSelector()
    for rows in np.split(X, [60, 61, 120]):
        selector.partial_fit(rows)
        assert selector.separation_ == 0.1 * spread(X[:60])
    same = SeparatedCenterSelector(selector.separation_).fit(X)
    assert_array_equal(selector.center_indices_, same.center_indices_)
    # A number and back: the scale is still that of the first batch that needed it.
    selector.set_params(separation=0.01).partial_fit(X)
    assert selector.separation_ == 0.01
    selector.set_params(separation="scale").partial_fit(X)
    assert selector.separation_ == 0.1 * spread(X[:60])
    loaded = pickle.loads(pickle.dumps(selector)).partial_fit(X)
    assert loaded.separation_ == 0.1 * spread(X[:60])


SETTINGS = {
    "every row": {},
    "every row, least squares": {"method": "least_squares", "alpha": 0.1},
    "selected": {"centers": SeparatedCenterSelector()},
    "given": {
        "centers": make_pendulum(200, step=0.1).X[::10],
        "method": "least_squares",
        "alpha": 1e-3,
    },
}


@pytest.mark.parametrize("name", SETTINGS)
def test_batches_of_a_regressor_keep_the_first_scales(pendulum, name):
    X, y = pendulum.X, pendulum.y
    first = spread(X[:70])
    model = KoopmanKernelRegressor("wendland_c2", **SETTINGS[name])
    for rows in np.split(np.arange(200), [70, 71, 140]):
        model.partial_fit(X[rows], y[rows])
        assert model.kernel_.beta == first
    fixed = clone(model).set_params(beta=first)
    if name == "selected":
        fixed.set_params(centers__separation=0.1 * first)
    expected = clone(fixed).fit(X, y)
    assert_array_equal(model.centers_, expected.centers_)
    assert_allclose(model.predict(X), expected.predict(X), atol=1e-7)
    # fit begins anew, and further batches keep what it has found.
    assert_allclose(model.fit(X[50:], y[50:]).kernel_.beta, spread(X[50:]))
    if name != "given":
        model.partial_fit(X[:50], y[:50])
        assert_allclose(model.kernel_.beta, spread(X[50:]))
    with pytest.raises((ValueError, AttributeError)):
        model.set_params(beta=0.5).partial_fit(X[:9], y[:9])


def test_a_copy_goes_on_with_the_first_scales(pendulum):
    X, y = pendulum.X, pendulum.y
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector())
    model.partial_fit(X[:70], y[:70])
    loaded = pickle.loads(pickle.dumps(model)).partial_fit(X[70:], y[70:])
    model.partial_fit(X[70:], y[70:])
    assert_array_equal(loaded.center_indices_, model.center_indices_)
    assert loaded.kernel_.beta == model.kernel_.beta == spread(X[:70])


def test_a_first_batch_without_spread_warns():
    X, y = np.array([[2.0, 1.0]] * 3), np.zeros(3)
    with pytest.warns(UserWarning, match=r"first batch are equal.*separation='scale'"):
        SeparatedCenterSelector().partial_fit(X)
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector())
    with pytest.warns(UserWarning, match=r"centers__separation='scale' and beta='sc"):
        model.partial_fit(X, y)
    given = KoopmanKernelRegressor(centers=X[:1], method="least_squares", alpha=1.0)
    with pytest.warns(UserWarning, match=r"equal, so that beta='scale' takes 1"):
        given.partial_fit(X, y)
    # Not where numbers are given, and not in `fit`, which has seen all there is.
    SeparatedCenterSelector(0.1).partial_fit(X)
    KoopmanKernelRegressor(Gaussian(2.0)).partial_fit(X, y)
    KoopmanKernelRegressor(beta=None).partial_fit(X, y)
    assert model.fit(X, y).kernel_.beta == 1.0
    assert SeparatedCenterSelector().fit(X).separation_ == 0.1


# --- One centre -----------------------------------------------------------------------


def test_one_centre_of_samples_that_differ_warns(pendulum):
    X, y = pendulum.X, pendulum.y
    message = (
        r"separation=50 leaves too few centres, 1 for \d+ samples, whose spread is "
        r"1\.\d+; set "
        rf"separation='scale', which is {0.1 * spread(X):.3g} here"
    )
    selector = SeparatedCenterSelector(50.0)
    with pytest.warns(UserWarning, match=message) as caught:
        selector.fit(X)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    for model in (
        KoopmanKernelRegressor(centers=selector),
        KernelEDMD(centers=selector),
        KoopmanKernelRegressorCV(centers=selector, method="least_squares"),
    ):
        with pytest.warns(UserWarning, match=message):
            model.fit(X, y)
    # The remedy helps.
    assert len(SeparatedCenterSelector("scale").fit(X).center_indices_) > 30


def test_default_separation_that_one_bad_frame_spoils_warns():
    """Two centres for a circle, and an error of its radius, came without a word."""
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(SeparatedCenterSelector().fit(circle).center_indices_) > 30
    circle[150, 0] = 1000.0
    with pytest.warns(UserWarning, match="2 for 300 samples.*far from all others"):
        SeparatedCenterSelector().fit(circle)


def test_one_centre_that_is_meant_does_not_warn(pendulum):
    X, y = pendulum.X, pendulum.y
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SeparatedCenterSelector(50.0, max_centers=1).fit(X)
        SeparatedCenterSelector(50.0).fit(X[[3, 3, 3]])
        SeparatedCenterSelector(50.0).partial_fit(X)
        model = KoopmanKernelRegressor(centers=SeparatedCenterSelector(1.0))
        model.partial_fit(X[:2], y[:2]).partial_fit(X[2:], y[2:])
    assert len(model.centers_) > 3


# --- As scikit-learn expects ----------------------------------------------------------


def test_defaults_are_words_and_stay_as_given(pendulum):
    for estimator in (KoopmanKernelRegressor(), KernelEDMD()):
        assert estimator.get_params()["beta"] == "scale"
    assert KoopmanKernelRegressorCV().betas is None
    assert SeparatedCenterSelector().separation == "scale"
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector())
    model.fit(pendulum.X, pendulum.y)
    assert model.beta == model.centers.separation == "scale"
    assert not hasattr(model.centers, "separation_")
    again = clone(model).fit(pendulum.X, pendulum.y)
    assert_array_equal(again.predict(pendulum.X), model.predict(pendulum.X))
    assert "separation_" in SeparatedCenterSelector().fit(pendulum.X).__dict__
    for shown in (repr(model), model._repr_html_()):
        assert "KoopmanKernelRegressor" in shown
    assert "beta" in repr(model.set_params(beta=2.0))


def test_models_of_the_first_version_go_on():
    """Their parameters are numbers or None, and they hold no scale."""
    folder = Path(__file__).parent / "fixtures" / "0.1.0"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InconsistentVersionWarning)
        selector = pickle.loads((folder / "selector.pkl").read_bytes())
        model = pickle.loads((folder / "regressor.pkl").read_bytes())
    assert isinstance(selector.separation, float)
    before = selector.cluster_centers_
    X = np.vstack([before, before + 100.0])
    selector.set_params(separation="scale").partial_fit(X)
    assert selector.separation_ == 0.1 * spread(X)
    assert_array_equal(selector.cluster_centers_[: len(before)], before)
    assert not isinstance(model.beta, str)
    y = np.ones((1, *model.dual_coef_.shape[1:]))
    M = len(model.dual_coef_)
    model.partial_fit(model.centers_.max(axis=0, keepdims=True) + 1.0, y)
    assert len(model.dual_coef_) == M + 1
    clone(model).fit(before, np.arange(float(len(before))))


def test_frames_and_arrays_give_the_same_bits(pendulum):
    X, y = pendulum.X, pendulum.y
    frame = pd.DataFrame(X, columns=["momentum", "position"])
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector())
    of_frame = clone(model).fit(frame, y)
    of_array = clone(model).fit(X, y)
    assert of_frame.kernel_.beta == of_array.kernel_.beta
    assert_array_equal(of_frame.center_indices_, of_array.center_indices_)


def test_a_first_batch_of_spread_one_is_no_batch_without_spread():
    """The spread of equal rows counts as 1, but other rows have it, too."""
    X = [[0.0], [2.0]]
    assert SeparatedCenterSelector().partial_fit(X).separation_ == 0.1
    assert KoopmanKernelRegressor().partial_fit(X, [1.0, 2.0]).kernel_.beta == 1.0
