"""The displays of a forecaster, and what it tells about one forecast."""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import same_color
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from sklearn_koopman import Analogs, KoopmanForecaster, KoopmanKernelRegressor
from sklearn_koopman.datasets import make_walking
from sklearn_koopman.plotting import AnalogDisplay, ForecastDisplay, HorizonErrorDisplay

BLUE, ORANGE = "#0072B2", "#D55E00"
COLUMNS = ["hip", "knee", "forward", "up"]
HORIZONS = [20, 5, 10]  # in no order
RISING = [1, 2, 0]


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def walks():
    """Eight persons, who walk four strides each."""
    walking = make_walking(
        n_persons=8, speeds=[1.2], n_strides=4, rate=50.0, random_state=0
    )
    pairs = zip(walking.trajectories, walking.outputs, strict=True)
    return [pd.DataFrame(np.hstack(pair), columns=COLUMNS) for pair in pairs]


def make_forecaster(**kwargs):
    settings = {"targets": ["forward", "up"], "horizons": HORIZONS, "delays": (0, 2)}
    return KoopmanForecaster(LinearRegression(), **{**settings, **kwargs})


@pytest.fixture(scope="module")
def forecaster(walks):
    """Not calibrated, with analogs at all horizons."""
    return make_forecaster(baseline="analogs").fit(walks[:4])


@pytest.fixture(scope="module")
def calibrated(walks):
    """On three persons, who support 75 %."""
    fitted = make_forecaster(baseline="analogs").fit(walks[:4])
    return fitted.conformalize(walks[4:7])


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def band_of(display):
    """The lower and upper ends of a band, from its corners."""
    (path,) = display.band_.get_paths()
    corners = path.vertices
    times = np.unique(corners[:, 0])
    return times, np.array(
        [
            [corners[corners[:, 0] == t, 1].min(), corners[corners[:, 0] == t, 1].max()]
            for t in times
        ]
    )


# --- What a forecast is made of -------------------------------------------------------


def test_explain(forecaster, walks):
    """Of the row that was asked for, all that the forecaster says of it."""
    recording = walks[7]
    parts = forecaster.explain(recording, start=150)
    assert parts.start == 150
    assert_array_equal(parts.outputs, recording[["forward", "up"]])
    assert_allclose(parts.forecast, forecaster.predict([recording])[0][150])
    assert_allclose(parts.baseline, forecaster.predict_baseline([recording])[0][150])
    assert parts.window == 10
    for number, horizon in enumerate(HORIZONS):
        used = parts.weights[number] > 0
        rows, weights = parts.analogs[number, used], parts.weights[number, used]
        assert len(rows) > 1
        assert_array_equal(parts.analogs[number, ~used], -1)
        assert_allclose(weights.sum(), 1)
        assert (rows <= 150 - max(horizon, 20)).all()
        followed = parts.outputs[rows + horizon]
        assert_allclose(weights @ followed, parts.baseline[number])
        # The nearest is the one with the most similar window.
        scaled = recording.to_numpy() / forecaster.column_scale_
        ends = np.arange(9, 150 - max(horizon, 20) + 1)
        windows = np.stack([scaled[end - 9 : end + 1] for end in ends])
        distances = ((windows - scaled[141:151]) ** 2).mean(axis=(1, 2))
        assert rows[0] == ends[distances.argmin()]


def test_explain_starts_where_all_has_come(forecaster, walks):
    recording = walks[7]
    n_rows = len(recording)
    assert forecaster.explain(recording).start == n_rows - 1 - max(HORIZONS)
    gap = recording.copy()
    gap.iloc[-20] = np.nan
    assert forecaster.explain(gap).start == n_rows - 20 - 1 - max(HORIZONS)
    # Nothing has come at all horizons: the last row that has a past.
    assert forecaster.explain(recording[:15]).start == 14
    for short in (recording[:2], gap[-20:-18]):
        with pytest.raises(ValueError, match="recording has no forecast, as the past"):
            forecaster.explain(short)


def test_explain_refuses(forecaster, walks):
    with pytest.raises(NotFittedError):
        make_forecaster().explain(walks[0])
    with pytest.raises(ValueError, match="one array or DataFrame, got list; pass one"):
        forecaster.explain(walks)
    with pytest.raises(ValueError, match="start=1 has no forecast"):
        forecaster.explain(walks[0], start=1)
    last = len(walks[0]) - 1
    with pytest.raises(ValueError, match=f"is no row; choose one from 0 to {last}"):
        forecaster.explain(walks[0], start=last + 1)
    with pytest.raises(ValueError, match="start must be an integer of at least 0"):
        forecaster.explain(walks[0], start=-1)
    with pytest.raises(ValueError, match="fit was not given y"):
        forecaster.explain(walks[0], walks[0])


def test_explain_without_analogs(walks):
    """Where others are the baseline, none are named."""
    last = make_forecaster(baseline="last").fit(walks[:3])
    parts = last.explain(walks[7], start=100)
    assert_array_equal(parts.analogs, -1)
    assert_array_equal(parts.weights, 0)
    now = walks[7].to_numpy()[100, 2:]
    assert_array_equal(parts.baseline, np.tile(now, (3, 1)))


def test_outputs_that_are_not_in_the_state(walks):
    """Predictions took the columns of X for outputs, and failed on their number."""
    X = [walk[["hip", "knee"]] for walk in walks]
    y = [walk["forward"] + walk["up"] for walk in walks]
    fitted = make_forecaster(targets=None).fit(X[:4], y[:4])
    (predicted,) = fitted.predict(X[7:])
    assert predicted.shape == (len(X[7]), 3, 1)
    # By hand: the estimator gets the two angles and those of two rows before.
    past = np.hstack([X[7][2:], X[7][:-2]])
    by_hand = fitted.estimators_["direct"].predict(past)
    scale = fitted.correction_scales_["direct"][:, 0]
    assert_allclose(predicted[2:, :, 0], scale * by_hand)
    parts = fitted.explain(X[7], y[7], start=50)
    assert_array_equal(parts.outputs[:, 0], y[7])
    assert_allclose(parts.forecast, predicted[50])
    assert np.isnan(parts.baseline).all()


def test_compare(forecaster, walks):
    """All on the same rows: those with analogs, and with outputs at all horizons."""
    found = forecaster.compare(walks[6:])
    assert list(found) == ["forecast", "analogs"]
    forecasts = np.concatenate(forecaster.predict(walks[6:]))
    baseline = np.concatenate(forecaster.predict_baseline(walks[6:]))
    truth = np.full_like(forecasts, np.nan)
    first = 0
    for walk in walks[6:]:
        outputs = walk[["forward", "up"]].to_numpy()
        for number, horizon in enumerate(HORIZONS):
            rows = slice(first, first + len(walk) - horizon)
            truth[rows, number] = outputs[horizon:]
        first += len(walk)
    rows = np.isfinite(baseline + truth).all(axis=(1, 2))
    assert 0 < rows.sum() < np.isfinite(forecasts + truth).all(axis=(1, 2)).sum()
    for name, said in {"forecast": forecasts, "analogs": baseline}.items():
        error = (said - truth)[rows]
        assert_allclose(found[name], np.sqrt((error**2).mean(axis=0)))


def test_compare_tells_of_all_that_were_tried(walks):
    auto = make_forecaster().fit(walks[:4])
    found = auto.compare(walks[6:])
    assert list(found) == ["forecast", "last", "linear", "analogs"]
    # The past of short recordings holds no analogs.
    short = [walk[:40] for walk in walks[6:]]
    found = auto.compare(short)
    assert list(found) == ["forecast", "last", "linear"]
    errors = []
    for walk in short:
        ankle = walk[["forward", "up"]].to_numpy()
        errors.append(ankle[2:20] - ankle[7:25])  # the past is two rows
    by_hand = np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))
    assert_allclose(found["last"][HORIZONS.index(5)], by_hand)
    with pytest.raises(ValueError, match="no row has a forecast, and outputs at all h"):
        auto.compare([walk[:20] for walk in walks])
    with pytest.raises(NotFittedError):
        clone(auto).compare(walks)


# --- Forecasts from one row -----------------------------------------------------------


def test_forecast_of_a_recording(calibrated, walks):
    recording, start = walks[7], 120
    display = ForecastDisplay.from_estimator(
        calibrated, recording, start=start, coverage=0.7, dt=0.02, unit="mm"
    )
    times = np.array([0.1, 0.2, 0.4])
    predicted, bands = calibrated.predict_interval([recording], coverage=0.7)
    baseline = calibrated.predict_baseline([recording])[0][start, RISING, 0]
    for line, values in (
        (display.prediction_, predicted[0][start, RISING, 0]),
        (display.baseline_, baseline),
    ):
        assert_allclose(line.get_xdata(), times)
        assert_allclose(line.get_ydata(), values)
    drawn_times, ends = band_of(display)
    assert_allclose(drawn_times, times)
    assert_allclose(ends, bands[0][start, RISING, 0])
    # What came, and as much before it.
    assert_allclose(display.truth_.get_xdata(), 0.02 * np.arange(-20, 21))
    assert_array_equal(display.truth_.get_ydata(), recording["forward"][100:141])
    assert_array_equal(display.now_.get_xdata(), 0)
    assert display.ax_.get_xlabel() == "time [s]"
    assert display.ax_.get_ylabel() == "forward [mm]"
    assert legend_of(display.ax_) == ["measured", "analogs", "forecast", "70 % band"]


def test_style_of_a_forecast(calibrated, walks):
    display = ForecastDisplay.from_estimator(calibrated, walks[7], coverage=0.5)
    assert same_color(display.truth_.get_color(), "k")
    assert same_color(display.prediction_.get_color(), ORANGE)
    assert display.prediction_.get_linestyle() == "--"
    assert same_color(display.baseline_.get_color(), "0.5")
    assert display.baseline_.get_linestyle() == ":"
    assert same_color(display.band_.get_facecolor()[0, :3], BLUE)
    assert display.band_.get_alpha() == 0.25
    styled = ForecastDisplay.from_estimator(
        calibrated, walks[7], coverage=0.5, baseline_kw={"lw": 3}, name="mine"
    )
    assert styled.baseline_.get_linewidth() == 3
    assert "mine" in legend_of(styled.ax_)


def test_output_by_name_or_number(forecaster, walks):
    show = ForecastDisplay.from_estimator
    by_name = show(forecaster, walks[7], output="up")
    by_number = show(forecaster, walks[7], output=1)
    assert_allclose(by_name.y_pred, by_number.y_pred)
    last = len(walks[7]) - 1
    assert_array_equal(by_name.y_true, walks[7]["up"][last - 40 :])
    assert by_name.ax_.get_ylabel() == "up"
    assert by_name.ax_.get_xlabel() == "time [samples]"
    assert show(forecaster, walks[7], output_name="here").ax_.get_ylabel() == "here"
    for wrong in ("hip", 2, -1, True, None):
        with pytest.raises(ValueError, match=r"not among the outputs \['forward', 'up"):
            show(forecaster, walks[7], output=wrong)


def test_forecast_beyond_the_end(forecaster, walks):
    """From the last row nothing has come."""
    recording = walks[7]
    display = ForecastDisplay.from_estimator(
        forecaster, recording, start=len(recording) - 1
    )
    assert_allclose(display.y_pred, forecaster.forecast([recording])[0, RISING, 0])
    assert_array_equal(display.true_time, np.arange(-20, 1))
    assert_array_equal(display.y_true, recording["forward"][-21:])


def test_bands_are_drawn_where_there_are_any(forecaster, calibrated, walks):
    show = ForecastDisplay.from_estimator
    assert show(forecaster, walks[7]).band_ is None
    assert show(calibrated, walks[7], coverage=None).band_ is None
    with pytest.raises(ValueError, match="9"):  # units, which 90 % needs
        show(calibrated, walks[7])
    joint = show(calibrated, walks[7], coverage=0.7, simultaneous=True)
    _, intervals = calibrated.predict_interval(
        [walks[7]], coverage=0.7, simultaneous=True
    )
    start = len(walks[7]) - 21
    assert_allclose(joint.interval, intervals[0][start, RISING, 0])
    assert legend_of(joint.ax_)[-1] == "70 % joint band"


def test_bands_about_other_forecasts(walks):
    """Those of models that have left out units are not symmetric."""
    fitted = make_forecaster(baseline="last").fit_conformalize(walks[:6])
    # An index of floats, by which slices would go, and one that does not start at 0.
    recording = walks[7].set_index(np.arange(len(walks[7])) / 50 + 1)
    display = ForecastDisplay.from_estimator(fitted, recording, coverage=0.6)
    _, intervals = fitted.predict_interval([recording], coverage=0.6)
    expected = intervals[0][len(recording) - 21, RISING, 0]
    _, ends = band_of(display)
    assert_allclose(ends, expected)
    middle = expected.mean(axis=1)
    assert (np.abs(middle - display.y_pred) > 1e-6 * np.abs(middle)).any()
    assert "last" in legend_of(display.ax_)


def test_a_single_horizon(walks):
    """A band of one forecast has a width, and the past can be seen."""
    fitted = make_forecaster(horizons=[1], baseline="last").fit(walks[:4])
    fitted.conformalize(walks[4:7])
    display = ForecastDisplay.from_estimator(fitted, walks[7], coverage=0.5)
    times, ends = band_of(display)
    assert_allclose(times, [1 - 0.21, 1 + 0.21])
    assert_array_equal(ends[0], ends[1])
    assert_array_equal(ends[0], display.interval[0])
    assert_array_equal(display.true_time, np.arange(-20, 2))


def test_baselines_that_differ(walks):
    """Each horizon has its own, and forecasts without one are gaps."""
    fitted = make_forecaster().fit(walks[:4])
    fitted.baselines_ = np.array(["analogs", "direct", "last"])
    fitted.estimators_ = dict.fromkeys(fitted.baselines_)
    explained = {"start": 9, "outputs": np.zeros((40, 2)), "forecast": np.ones((3, 2))}
    baseline = np.array([[1.0, 1], [np.nan, np.nan], [2, 2]])

    class Told(KoopmanForecaster):
        def explain(self, recording, y=None, *, start=None):
            from sklearn.utils import Bunch

            return Bunch(**explained, baseline=baseline)

    fitted.__class__ = Told
    display = ForecastDisplay.from_estimator(fitted, walks[7])
    assert_array_equal(display.baseline_.get_ydata(), [np.nan, 2, 1])
    assert legend_of(display.ax_) == ["measured", "baseline", "forecast"]
    baseline[:] = np.nan
    display = ForecastDisplay.from_estimator(fitted, walks[7])
    assert display.baseline_ is None
    assert legend_of(display.ax_) == ["measured", "forecast"]


def test_outputs_of_their_own(walks):
    X, y = [w[["hip", "knee"]] for w in walks], [w[["up"]] for w in walks]
    fitted = make_forecaster(targets=None).fit(X[:4], y[:4])
    display = ForecastDisplay.from_estimator(fitted, X[7], y[7], start=60)
    assert_array_equal(display.y_true, y[7]["up"][40:81])
    assert display.ax_.get_ylabel() == "up"
    assert display.baseline_ is None
    with pytest.raises(ValueError, match="fit was given y"):
        ForecastDisplay.from_estimator(fitted, X[7])


def test_two_forecasters_on_the_same_axes(forecaster, walks):
    """They share what was measured, and a baseline that is the same."""
    first = ForecastDisplay.from_estimator(forecaster, walks[7], name="one")
    other = make_forecaster(baseline=Analogs(n_analogs=1)).fit(walks[:4])
    again, second = (
        ForecastDisplay.from_estimator(each, walks[7], name=name, ax=first.ax_)
        for name, each in (("again", forecaster), ("two", other))
    )
    assert again.truth_ is second.truth_ is first.truth_
    assert again.baseline_ is first.baseline_
    assert second.baseline_ is not first.baseline_
    colors = {d.prediction_.get_color() for d in (first, again, second)}
    assert len(colors) == 3


def test_forecasters_in_searches_and_pipelines(forecaster, walks):
    """Steps before a forecaster get a list, too."""
    search = GridSearchCV(
        make_forecaster(), {"baseline": ["analogs", "last"]}, cv=2
    ).fit(walks[:4])
    assert search.best_params_ == {"baseline": "analogs"}
    for draw in (ForecastDisplay, AnalogDisplay):
        mine = draw.from_estimator(search, walks[7], start=100)
        other = draw.from_estimator(forecaster, walks[7], start=100)
        assert_allclose(
            getattr(mine, "y_pred", mine.ax_.lines[-1].get_ydata()),
            getattr(other, "y_pred", other.ax_.lines[-1].get_ydata()),
        )
    doubled = make_pipeline(
        FunctionTransformer(lambda X: [2 * x for x in X]),
        make_forecaster(baseline="analogs"),
    ).fit(walks[:4])
    display = ForecastDisplay.from_estimator(doubled, walks[7], start=100)
    assert_array_equal(display.y_true, 2 * walks[7]["forward"][80:121])
    display = AnalogDisplay.from_estimator(doubled, walks[7], start=100)
    assert_array_equal(display.outputs, 2 * walks[7]["forward"])
    display = HorizonErrorDisplay.from_estimator(doubled, walks[6:])
    expected = HorizonErrorDisplay.from_estimator(forecaster, walks[6:])
    assert_allclose(display.errors["analogs"], 2 * expected.errors["analogs"])


def test_forecasts_of_recordings_refuse(forecaster, walks):
    show = ForecastDisplay.from_estimator
    for wrong in (
        {"n_steps": 3},
        {"lag": 1},
        {"band": "std"},
        {"norm": 1.0},
        {"relift": True},
    ):
        (name,) = wrong
        with pytest.raises(ValueError, match=f"{name} is for other models.*horizons="):
            show(forecaster, walks[7], **wrong)
    with pytest.raises(NotFittedError):
        show(make_forecaster(), walks[7])
    with pytest.raises(ValueError, match="one array or DataFrame, got list"):
        show(forecaster, walks)
    with pytest.raises(ValueError, match="dt must be a finite positive"):
        show(forecaster, walks[7], dt=0)
    model = KoopmanKernelRegressor().fit(walks[0][:20], walks[0]["up"][:20])
    with pytest.raises(ValueError, match="y must be the outputs one step after"):
        show(model, walks[0])


# --- Errors by horizon ----------------------------------------------------------------


def test_errors_of_what_was_left_out(forecaster):
    display = HorizonErrorDisplay.from_estimator(forecaster, dt=0.02, unit="mm")
    left_out = forecaster.left_out_errors_
    assert list(display.errors) == ["forecast", "analogs", "analogs, corrected"]
    assert_allclose(display.horizons, [0.1, 0.2, 0.4])
    for name, line in zip(display.errors, display.lines_, strict=True):
        source = left_out["analogs, corrected" if name == "forecast" else name]
        assert_allclose(line.get_xdata(), [0.1, 0.2, 0.4])
        assert_allclose(line.get_ydata(), source[RISING, 0])
    assert legend_of(display.ax_) == list(display.errors)
    assert display.ax_.get_xlabel() == "horizon [s]"
    assert display.ax_.get_ylabel() == "rms error of forward [mm]"
    assert display.ax_.get_yscale() == "log"


def test_the_forecast_is_what_was_chosen(walks):
    """At each horizon, also where nothing is the baseline."""
    fitted = make_forecaster().fit(walks[:4])
    fitted.baselines_ = np.array(["linear", "direct", "last"])
    display = HorizonErrorDisplay.from_estimator(fitted, output="up")
    left_out = fitted.left_out_errors_
    assert_allclose(
        display.errors["forecast"],
        [
            left_out["direct"][1, 1],
            left_out["last, corrected"][2, 1],
            left_out["linear, corrected"][0, 1],
        ],
    )
    assert len({line.get_label() for line in display.lines_}) == 8


def test_errors_of_recordings(forecaster, walks):
    display = HorizonErrorDisplay.from_estimator(forecaster, walks[6:], output=None)
    found = forecaster.compare(walks[6:])
    for name, error in found.items():
        expected = np.sqrt((error**2).sum(axis=1))[RISING]
        assert_allclose(display.errors[name], expected)
    assert_array_equal(display.horizons, [5, 10, 20])
    assert display.ax_.get_xlabel() == "horizon [samples]"
    assert display.ax_.get_ylabel() == "rms error of outputs"


def test_styles_of_errors(walks):
    """A baseline is dotted alone, and has the same colour corrected."""
    display = HorizonErrorDisplay.from_estimator(make_forecaster().fit(walks[:4]))
    lines = dict(zip(display.errors, display.lines_, strict=True))
    assert same_color(lines["forecast"].get_color(), ORANGE)
    colors = set()
    for name in ("last", "linear", "analogs"):
        alone, corrected = lines[name], lines[f"{name}, corrected"]
        assert alone.get_linestyle() == ":"
        assert corrected.get_linestyle() == "-"
        assert alone.get_color() == corrected.get_color()
        colors.add(alone.get_color())
    assert len(colors | {lines["direct"].get_color()}) == 4


def test_errors_of_zero_are_not_drawn():
    display = HorizonErrorDisplay(
        horizons=np.array([1.0, 2.0]), errors={"forecast": np.array([0.0, 3.0])}
    ).plot()
    assert_array_equal(display.lines_[0].get_ydata(), [np.nan, 3])
    display.figure_.canvas.draw()


def test_a_baseline_of_the_user(walks):
    def stay(recording, horizons):
        ankle = np.asarray(recording)[:, 2:]
        return np.repeat(ankle[:, np.newaxis], len(horizons), axis=1)

    fitted = make_forecaster(baseline=stay).fit(walks[:4])
    errors = HorizonErrorDisplay.from_estimator(fitted).errors
    assert list(errors) == ["forecast", "custom", "custom, corrected"]
    last = make_forecaster(baseline="last").fit(walks[:4])
    expected = HorizonErrorDisplay.from_estimator(last, walks[6:]).errors["last"]
    found = HorizonErrorDisplay.from_estimator(fitted, walks[6:]).errors["custom"]
    assert_allclose(found, expected)


def test_errors_by_horizon_refuse(forecaster, walks):
    show = HorizonErrorDisplay.from_estimator
    model = KoopmanKernelRegressor().fit(walks[0][:20], walks[0]["up"][:20])
    with pytest.raises(ValueError, match="be a KoopmanForecaster, got KoopmanKernelR"):
        show(model)
    with pytest.raises(NotFittedError):
        show(make_forecaster())
    with pytest.raises(ValueError, match="output='hip' is not among"):
        show(forecaster, output="hip")
    with pytest.raises(ValueError, match="dt must be a finite positive"):
        show(forecaster, dt=-1)
    with pytest.raises(ValueError, match="X must be a non-empty list"):
        show(forecaster, walks[0])


# --- Analogs --------------------------------------------------------------------------


def test_analogs(forecaster, walks):
    recording = walks[7]
    ankle = recording["up"].to_numpy()
    display = AnalogDisplay.from_estimator(
        forecaster, recording, start=150, horizon=10, output="up", dt=0.02, unit="mm"
    )
    parts = forecaster.explain(recording, start=150)
    number = HORIZONS.index(10)
    used = parts.weights[number] > 0
    rows, weights = parts.analogs[number, used], parts.weights[number, used]
    time = 0.02 * np.arange(len(ankle))
    assert_allclose(display.line_.get_xdata(), time)
    assert_array_equal(display.line_.get_ydata(), ankle)
    assert_allclose(display.now_.get_xdata(), 3.0)
    assert_allclose(display.present_.get_xdata(), time[141:151])
    assert_array_equal(display.present_.get_ydata(), ankle[141:151])
    windows = display.windows_.get_segments()
    followers = display.followers_.get_segments()
    assert len(windows) == len(followers) == len(rows)
    for row, window, follower in zip(rows, windows, followers, strict=True):
        kept = slice(row - 9, row + 1)
        assert_allclose(window, np.c_[time[kept], ankle[kept]])
        kept = slice(row, row + 11)
        assert_allclose(follower, np.c_[time[kept], ankle[kept]])
    assert_allclose(
        display.ends_.get_offsets(), np.c_[time[rows + 10], ankle[rows + 10]]
    )
    for artist in (display.windows_, display.followers_):
        alpha = artist.get_color()[:, 3]
        assert_allclose(alpha, 0.2 + 0.8 * weights / weights.max())
        assert same_color(artist.get_color()[0, :3], BLUE)
    points = {
        display.forecast_: parts.forecast[number, 1],
        display.baseline_: parts.baseline[number, 1],
        display.truth_: ankle[160],
    }
    for point, value in points.items():
        assert_allclose(np.ravel(point.get_data()), [3.2, value])
    assert same_color(display.forecast_.get_color(), ORANGE)
    assert display.ax_.get_xlabel() == "time [s]"
    assert display.ax_.get_ylabel() == "up [mm]"
    assert legend_of(display.ax_) == [
        "measured",
        "present window",
        "analogs, by weight",
        "what followed them",
        "their mean",
        "what came",
        "forecast",
    ]


def test_analogs_of_the_last_row(forecaster, walks):
    """Nothing has come; by default at the largest horizon, in samples."""
    last = len(walks[7]) - 1
    display = AnalogDisplay.from_estimator(forecaster, walks[7], start=last)
    assert display.truth_ is None
    assert display.horizon == 20
    assert_array_equal(np.ravel(display.forecast_.get_xdata()), last + 20)
    assert "what came" not in legend_of(display.ax_)
    assert display.ax_.get_xlabel() == "time [samples]"
    assert display.ax_.get_ylabel() == "forward"
    gap = walks[7].copy()
    gap.iloc[last - 5] = np.nan
    display = AnalogDisplay.from_estimator(forecaster, gap, start=last - 25)
    assert display.truth_ is None


def test_curves_stay_below_the_legend(forecaster, walks):
    auto = make_forecaster().fit(walks[:4])
    for display in (
        AnalogDisplay.from_estimator(forecaster, walks[7]),
        HorizonErrorDisplay.from_estimator(forecaster),
        HorizonErrorDisplay.from_estimator(auto),
    ):
        ax = display.ax_
        display.figure_.canvas.draw()
        box = ax.get_legend().get_window_extent()
        assert ax.bbox.x0 < box.x0 < box.x1 < ax.bbox.x1
        low = ax.transData.inverted().transform(box)[0, 1]
        assert low > max(np.nanmax(line.get_ydata()) for line in ax.lines[1:])


def test_analogs_refuse(forecaster, walks):
    show = AnalogDisplay.from_estimator
    for wrong in (7, 0, "5"):
        with pytest.raises(ValueError, match=r"with analogs, which are \[20, 5, 10\]"):
            show(forecaster, walks[7], horizon=wrong)
    with pytest.raises(
        ValueError, match=r"row 25 has no analogs 5 rows ahead.*join_re"
    ):
        show(forecaster, walks[7], start=25, horizon=5)
    with pytest.raises(ValueError, match="baselines are last, so that no forecast is"):
        show(make_forecaster(baseline="last").fit(walks[:4]), walks[7])
    with pytest.raises(ValueError, match="estimator must be a KoopmanForecaster"):
        show(LinearRegression().fit(walks[0], walks[0]), walks[0])
    with pytest.raises(NotFittedError):
        show(make_forecaster(), walks[7])
    with pytest.raises(ValueError, match="output=2 is not among"):
        show(forecaster, walks[7], output=2)
    with pytest.raises(ValueError, match="dt must be a finite positive"):
        show(forecaster, walks[7], dt="fast")
    with pytest.raises(ValueError, match="start=0 has no forecast"):
        show(forecaster, walks[7], start=0)
