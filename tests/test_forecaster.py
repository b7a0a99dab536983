"""What the forecaster promises: errors on recorded walking, and bands that hold."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV

from sklearn_koopman import Analogs, ExtrapolationWarning, KernelEDMD, KoopmanForecaster
from sklearn_koopman.datasets import make_walking

HORIZONS = np.array([15, 30, 45, 75, 112, 150])
COVERAGES = (0.8, 0.9, 0.95)


def draw_persons(n_persons, seed, n_strides=6):
    """Return recordings of angles and ankle, one a person, at 50 Hz."""
    walks = make_walking(
        1, n_persons=n_persons, n_strides=n_strides, rate=50, random_state=seed
    )
    pairs = zip(walks.trajectories, walks.outputs, strict=True)
    return [np.hstack(pair) for pair in pairs]


def make_forecaster(**parameters):
    """Return a forecaster of persons that is fast to fit."""
    return KoopmanForecaster(
        Ridge(),
        **{
            "targets": [2, 3],
            "horizons": [5, 15],
            "delays": (0, 2, 4),
            "baseline": "analogs",
            **parameters,
        },
    )


@pytest.fixture(scope="module")
def persons():
    return draw_persons(32, 0)


@pytest.fixture(scope="module")
def fitted(persons):
    return make_forecaster().fit(persons[:8])


# --- errors -------------------------------------------------------------------------


@pytest.mark.slow
# The fastest of the trials is far from the others at times.
@pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")
def test_errors_of_recorded_walking(walking):
    """A trial left out at a time, by the defaults; rows preceded by two strides."""
    walks = [np.hstack(pair) for pair in zip(*walking, strict=True)]
    squares = []
    for number, walk in enumerate(walks):
        model = KoopmanForecaster(targets=[2, 3], horizons=HORIZONS.tolist())
        model.fit([other for i, other in enumerate(walks) if i != number])
        rows = np.arange(335, len(walk) - 150)
        (forecasts,) = model.predict([walk])
        came = walk[rows[:, np.newaxis] + HORIZONS, 2:]
        squares.append(((forecasts[rows] - came) ** 2).sum(axis=2))
    errors = np.sqrt(np.concatenate(squares).mean(axis=0))  # mm
    assert (errors < 1.05 * np.array([7.3, 12.5, 16.3, 22.6, 31.4, 38.0])).all()


@pytest.mark.slow
def test_what_has_no_period_is_left_to_the_baseline():
    """On random walks nothing is better than the last value."""
    rng = np.random.default_rng(0)
    walks = [np.cumsum(rng.normal(size=(500, 2)), axis=0) for _ in range(26)]
    model = KoopmanForecaster(horizons=[1, 5, 20]).fit(walks[:6])
    assert_array_equal(model.baselines_, ["last"] * 3)
    errors = model.compare(walks[6:])
    assert (errors["forecast"] < 1.03 * errors["last"]).all()
    # The error of a random walk grows as the root of the horizon. Some 900 independent
    # stretches of 20 steps tell it to 2 %.
    assert_allclose(errors["last"].mean(axis=1), np.sqrt([1, 5, 20]), rtol=0.1)


def test_a_correction_is_as_large_as_helps():
    # A ramp with noise: the last value lags by the slope, which can be learned.
    rng = np.random.default_rng(0)
    ramps = [
        np.column_stack([0.5 * np.arange(300.0), rng.normal(size=300)])
        for _ in range(4)
    ]
    model = make_forecaster(targets=[0], horizons=[2, 4], baseline="last").fit(ramps)
    assert_allclose(model.horizon_weights_, 1, atol=1e-3)
    (forecasts,) = model.predict(ramps[:1])
    assert_allclose(forecasts[20, :, 0], [11, 12], rtol=1e-3)
    # Noise of which nothing can be learned: no correction is believed.
    noise = [rng.normal(size=(300, 1)).cumsum(axis=0) for _ in range(4)]
    model = make_forecaster(targets=[0], horizons=[2, 4], baseline="last").fit(noise)
    assert (model.horizon_weights_ < 0.7).all()


# --- where there is no analog -------------------------------------------------------


def test_last_values_stand_in_for_analogs(persons, fitted):
    walk = persons[9]
    (forecasts,), (baseline,) = fitted.predict([walk]), fitted.predict_baseline([walk])
    is_lost = np.isnan(baseline).all(axis=2)
    early = np.arange(4, 40)  # within the first stride
    assert is_lost[early].all()
    assert np.isnan(forecasts[:4]).all()
    assert_array_equal(
        forecasts[early], np.repeat(walk[early, np.newaxis, 2:], 2, axis=1)
    )
    assert not is_lost[-100:].any()
    # They have a scale of their own, so that bands are wider there.
    fitted.conformalize(persons[10:30])
    _, (band,) = fitted.predict_interval([walk])
    width = band[..., 1] - band[..., 0]
    ratio = fitted.stand_in_scale_ / fitted.error_scale_
    assert_allclose(width[early[0]] / width[-1], ratio, rtol=1e-9)
    assert (ratio > 5).all()


def test_the_best_of_the_others_stands_in(persons):
    model = make_forecaster(baseline="auto").fit(persons[:8])
    assert_array_equal(model.baselines_, ["analogs"] * 2)
    (name,) = {*model.stand_ins_.tolist()}
    assert name != "last"
    baseline = None if name == "direct" else name
    alone = make_forecaster(baseline=baseline).fit(persons[:8])
    assert_allclose(model.stand_in_weights_, alone.horizon_weights_, rtol=1e-9)
    walk = persons[9]
    early = np.arange(4, 40)
    assert_allclose(
        model.predict([walk])[0][early], alone.predict([walk])[0][early], rtol=1e-9
    )


def test_recordings_in_other_units_warn(persons, fitted):
    walk = persons[9] * [1, 1, 0.001, 0.001]
    message = r"column 3 of X\[1\] is at -0\.\d+ on average, those of fit were at -8"
    with pytest.warns(ExtrapolationWarning, match=message):
        fitted.forecast([persons[9], walk])


def test_settings_are_those_of_the_fit(persons):
    analogs, walk = Analogs(window=12), persons[9]
    model = make_forecaster(baseline=analogs).fit(persons[:8])
    (before,) = model.predict([walk])
    analogs.window = 5
    model.set_params(
        horizons=[1, 2, 3],
        delays=7,
        embedding="differences",
        targets=[0],
        baseline="last",
    )
    assert_array_equal(model.predict([walk])[0], before)


def with_column(walks, constant):
    return [np.column_stack([walk, np.full(len(walk), constant)]) for walk in walks]


@pytest.mark.parametrize("constant", [0.1, 70.3])
def test_the_value_of_a_constant_column_changes_nothing(persons, constant):
    """The mean of equal numbers is not always that number."""
    walks, ones = (with_column(persons[:10], value) for value in (constant, 1.0))
    model, plain = (make_forecaster().fit(each[:8]) for each in (walks, ones))
    assert model.column_scale_[4] == 1.0
    parts, others = model.explain(walks[9]), plain.explain(ones[9])
    assert_array_equal(parts.analogs, others.analogs)
    assert_allclose(parts.weights, others.weights, rtol=1e-6)
    assert_allclose(parts.forecast, others.forecast, rtol=1e-6)


@pytest.mark.parametrize("constant", [0.1, 70.3])
def test_the_default_estimator_takes_a_constant_column(constant):
    rng = np.random.default_rng(0)
    waves = []
    for phase in rng.uniform(0, 6, 3):
        wave = np.sin(0.2 * np.arange(60) + phase)
        waves.append(np.column_stack([wave, np.full(60, constant)]))
    model = KoopmanForecaster(targets=[0], horizons=[3], delays=(0, 2), baseline=None)
    assert model.fit(waves).score(waves) > 0.99


def test_what_cannot_be_used_is_refused(persons, fitted):
    with pytest.raises(ValueError, match=r"X\[2\] have no row with a forecast and"):
        fitted.conformalize([*persons[10:12], persons[12][:8]])
    search = GridSearchCV(KernelEDMD(), {"beta": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"GridSearchCV of an operator; pass the op"):
        make_forecaster(baseline=None).set_params(estimator=search).fit(persons[:4])
    pd = pytest.importorskip("pandas", reason="outputs with an index")
    frames = [pd.DataFrame(walk) for walk in persons[:3]]
    outputs = [frame[[2]] for frame in frames]
    outputs[1] = outputs[1].iloc[::-1]
    model = make_forecaster(targets=None, baseline=None)
    with pytest.raises(ValueError, match=r"y\[1\] and X\[1\] have different indices"):
        model.fit(frames, outputs)


# --- bands --------------------------------------------------------------------------


def share_covered(model, walks, coverage, simultaneous):
    """Return the mean over recordings of the share of errors that a band holds."""
    predicted, bands = model.predict_interval(
        walks, coverage=coverage, simultaneous=simultaneous
    )
    shares = []
    for forecasts, band, error in zip(
        predicted, bands, model.errors(walks), strict=True
    ):
        came = forecasts - error
        inside = (band[..., 0] <= came) & (came <= band[..., 1])
        known = np.isfinite(error)
        if simultaneous:
            rows = known.all(axis=(1, 2))
            shares.append(inside[rows].all(axis=(1, 2)).mean())
        else:
            shares.append(inside[known].mean())
    return np.mean(shares)


@pytest.mark.slow
@pytest.mark.parametrize("simultaneous", [False, True])
def test_bands_cover_what_they_promise(simultaneous):
    """New persons, in the mean over draws of those who calibrate and those to come."""
    shares = []
    for seed in range(25):
        walks = draw_persons(50, 100 + seed)
        model = make_forecaster().fit(walks[:10]).conformalize(walks[10:30])
        shares.append(
            [share_covered(model, walks[30:], c, simultaneous) for c in COVERAGES]
        )
    mean, error = np.mean(shares, axis=0), np.std(shares, axis=0) / np.sqrt(25)
    # Four standard errors: a true promise fails for one seed in 30,000.
    assert (mean + 4 * error > COVERAGES).all()
    assert (mean > np.array(COVERAGES) - 0.02).all()
    assert (mean < 0.99).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["plus", "minmax"])
def test_bands_of_persons_left_out_cover(method):
    shares = []
    for seed in range(6):
        walks = draw_persons(24, 200 + seed)
        model = make_forecaster().fit_conformalize(walks[:12], method=method)
        shares.append(share_covered(model, walks[12:], 0.9, False))
    assert 0.85 < np.mean(shares) < 1


def test_a_band_is_the_quantile_of_the_errors_at_its_horizon(persons, fitted):
    calibration = persons[10:20]
    fitted.conformalize(calibration, method="mixture")
    forecast, band = fitted.forecast_interval([persons[9]], coverage=0.8)
    half_width = (band[0, ..., 1] - band[0, ..., 0]) / 2
    assert_allclose(band[0].mean(axis=2), forecast[0], rtol=1e-12)
    errors = fitted.errors(calibration)
    marked = fitted.predict_baseline(calibration)
    for horizon, output in np.ndindex(2, 2):
        points = []
        for error, baseline in zip(errors, marked, strict=True):
            size = np.abs(error[:, horizon, output])
            is_lost = np.isnan(baseline[:, horizon, output])
            size = size / np.where(
                is_lost,
                fitted.stand_in_scale_[horizon, output],
                fitted.error_scale_[horizon, output],
            )
            size = size[np.isfinite(size)]
            points += [(value, 1 / len(size) / 11) for value in size]
        values, masses = np.array(sorted(points)).T
        quantile = values[np.searchsorted(np.cumsum(masses), 0.8 - 1e-12)]
        expected = quantile * fitted.error_scale_[horizon, output]
        assert_allclose(half_width[horizon, output], expected, rtol=1e-9)


def test_groups_are_the_units(persons, fitted):
    pairs = np.repeat(np.arange(10), 2)
    fitted.conformalize(persons[10:30], groups=pairs)
    assert fitted.calibration_.n_units == 10
    fitted.predict_interval(persons[:1], coverage=0.9)
    with pytest.raises(ValueError, match=r"coverage=0.95 needs 19 units .* 10 have"):
        fitted.predict_interval(persons[:1], coverage=0.95)
    with pytest.raises(ValueError, match=r"groups holds 3 labels for 20 recordings"):
        fitted.conformalize(persons[10:30], groups=[1, 2, 3])


@pytest.mark.slow
def test_methods_without_new_persons(persons):
    walks, walk = persons[:10], persons[20:21]
    model = make_forecaster().fit_conformalize(walks, method="plus")
    assert len(model.fold_estimators_) == model.calibration_.n_units == 10
    (plain,) = make_forecaster().fit(walks).predict(walk)
    (forecasts,), (plus,) = model.predict_interval(walk)
    assert_array_equal(forecasts, plain)
    (_,), (minmax,) = model.fit_conformalize(walks, method="minmax").predict_interval(
        walk
    )
    rows = np.isfinite(plain).all(axis=(1, 2))
    tolerance = 1e-9 * np.abs(plain[rows]).max()
    assert (minmax[rows][..., 0] <= plus[rows][..., 0] + tolerance).all()
    assert (minmax[rows][..., 1] >= plus[rows][..., 1] - tolerance).all()
    folds = model.fit_conformalize(walks, cv=5)
    assert len(folds.fold_estimators_) == 5
    assert_array_equal(np.sort(np.bincount(folds.calibration_.models)), [2] * 5)
    pooled = model.fit_conformalize(walks[:4], method="pooled")
    assert pooled.calibration_.guarantee == "none"
    assert not hasattr(pooled, "fold_estimators_")
    (_,), (band,) = pooled.predict_interval(walk, coverage=0.9)
    assert np.isfinite(band[rows]).all()
    with pytest.raises(ValueError, match=r"one unit, none can be left out"):
        model.fit_conformalize(walks, groups=[0] * 10)
    # A fit undoes the calibration.
    model.fit(walks)
    assert not hasattr(model, "calibration_")
    with pytest.raises(ValueError, match=r"not calibrated: call conformalize"):
        model.predict_interval(walk)


def test_parameters_of_analogs_reach_them(persons):
    model = make_forecaster(baseline=Analogs(n_analogs=1, window=5)).fit(persons[:6])
    parts = model.explain(persons[9])
    assert parts.window == 5
    assert parts.analogs.shape == (2, 1)
    walk, (row,) = persons[9], parts.analogs[0]
    assert_allclose(parts.baseline[0], walk[row + 5, 2:], rtol=1e-12)
    assert parts.start - row >= 10  # twice the window
