"""The displays: what they draw, by the data of the artists."""

import inspect
import re
import subprocess
import sys
from functools import cache
from itertools import pairwise

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import LogNorm, same_color
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.decomposition import PCA
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils import Bunch

from sklearn_koopman import (
    KernelEDMD,
    KoopmanForecaster,
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    plotting,
    trajectory_pairs,
)
from sklearn_koopman.datasets import make_pendulum, make_walking
from sklearn_koopman.kernels import MaternSobolev, Wendland
from sklearn_koopman.plotting import (
    AnalogDisplay,
    CenterSelectionDisplay,
    ConditioningDisplay,
    ConvergenceDisplay,
    ForecastDisplay,
    HorizonErrorDisplay,
    SpectrumDisplay,
    SurfaceDisplay,
)
from sklearn_koopman.plotting._inputs import kernel_name

OKABE_ITO = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def pendulum():
    return make_pendulum(n_samples=100)


@pytest.fixture(scope="module")
def model(pendulum):
    model = KoopmanKernelRegressor(
        "wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.4)
    )
    return model.fit(pendulum.X, pendulum.y)


@pytest.fixture(scope="module")
def operator(pendulum):
    model = KernelEDMD("wendland_c4", beta=4.0, centers=SeparatedCenterSelector(0.4))
    return model.fit(pendulum.X, pendulum.y, X_next=pendulum.X_next)


@pytest.fixture(scope="module")
def walking():
    return make_walking(speeds=[1.2], n_strides=3, rate=60.0, random_state=0)


def convergence(slope=3.0, guaranteed=1.5, kernel="MaternSobolev(beta=2, nu=1.5)"):
    """A study of errors along a straight line, but for the two that are not used."""
    h = np.array([0.1, 0.8, 0.4, 0.2, 0.05, 0.025])
    error = 0.5 * h**slope
    error[4:] = 1e-3, 0.0
    return Bunch(
        separation=h,
        fill_distance=h,
        separation_distance=h / 2,
        n_centers=np.arange(6),
        sup_error=error,
        rms_error=error / 3,
        condition_number=1 / h,
        used=np.array([True] * 4 + [False] * 2),
        slope=slope,
        slope_interval=(slope - 0.1, slope + 0.1),
        rms_slope=slope + 1,
        rms_slope_interval=np.array([slope + 0.8, slope + 1.2]),
        guaranteed_slope=guaranteed,
        rates=Bunch(tau=2.5, s=2.0, sup_exponent=1.5, rms_exponent=guaranteed + 0.5),
        kernel=kernel,
        confidence=0.9,
    )


def conditioning():
    """A study of two kernels and two scales; the last kernel is singular in between."""
    q = np.array([0.4, 0.1, 0.2])
    power = np.array([[4.0, 4.0], [6.0, 6.0]])
    number = np.array([[1.0, 10], [1, 10]])[:, :, None] * q ** -power[:, :, None]
    number[1, 1, 2] = np.inf
    return Bunch(
        kernel=["matern32", "Wendland(beta=1, smoothness=4, dimension=3)"],
        beta=np.array([1.0, 2.5]),
        separation=2 * q,
        n_centers=np.array([3, 12, 6]),
        fill_distance=q,
        separation_distance=q,
        condition_number=number,
        smallest_eigenvalue=1 / number,
        digits_lost=np.log10(number),
        slope=-power,
        slope_interval=np.stack([-power - 0.2, -power + 0.2], axis=-1),
        expected_slope=np.array([-4.0, -np.inf]),
        confidence=0.95,
    )


def crowding():
    gap = np.array([0.1, 0.01])
    q = np.array([gap / 2, gap / 2, [0.02, 0.005]])
    smallest = np.array([3.0, 2.0, 1.0])[:, None] * q**2
    return Bunch(
        kernel="Wendland(beta=2, smoothness=2, dimension=3)",
        separation=np.array([1.0, 0.5, 0.25]),
        n_centers=np.array([7, 15, 37]),
        fill_distance=np.array([0.9, 0.4, 0.21]),
        gap=gap,
        separation_distance=q,
        smallest_eigenvalue=smallest,
        condition_number=30 / smallest,
    )


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def data_of(line):
    return np.column_stack([line.get_xdata(), line.get_ydata()])


def slope_of(line):
    (x0, *_, x1), (y0, *_, y1) = line.get_data()
    return np.log(y1 / y0) / np.log(x1 / x0)


def recorded_surfaces(ax):
    """Let the axes note what their surfaces are drawn from."""
    drawn, plot_surface = [], ax.plot_surface

    def record(*grids, **kwargs):
        drawn.append((grids, kwargs))
        return plot_surface(*grids, **kwargs)

    ax.plot_surface = record
    return drawn


def axes_3d():
    return plt.subplots(subplot_kw={"projection": "3d"})[1]


@cache
def forecaster():
    """A forecaster of four strides, and one recording of them."""
    walking = make_walking(speeds=[1.0, 1.2], n_strides=4, rate=50.0, random_state=0)
    settings = {"targets": [0], "horizons": [3, 6], "delays": 2, "baseline": "analogs"}
    fitted = KoopmanForecaster(LinearRegression(), **settings)
    return fitted.fit(walking.trajectories), walking.trajectories[0]


# --- Every display ------------------------------------------------------------------


def draw(name, model, operator, pendulum, **kwargs):
    """Draw a display by its class method."""
    X, y = pendulum.X, pendulum.y
    return {
        "SurfaceDisplay": lambda: SurfaceDisplay.from_estimator(
            model, X, y, function=lambda x: pendulum.G(pendulum.f(x)), **kwargs
        ),
        "ConvergenceDisplay": lambda: ConvergenceDisplay.from_study(
            convergence(), **kwargs
        ),
        "ConditioningDisplay": lambda: ConditioningDisplay.from_study(
            conditioning(), **kwargs
        ),
        "CenterSelectionDisplay": lambda: CenterSelectionDisplay.from_estimator(
            model, X, **kwargs
        ),
        "AnalogDisplay": lambda: AnalogDisplay.from_estimator(*forecaster(), **kwargs),
        "HorizonErrorDisplay": lambda: HorizonErrorDisplay.from_estimator(
            forecaster()[0], **kwargs
        ),
        "ForecastDisplay": lambda: ForecastDisplay.from_estimator(
            model, X, y, lag=1, band="std", **kwargs
        ),
        "SpectrumDisplay": lambda: SpectrumDisplay.from_estimator(operator, **kwargs),
    }[name]()


@pytest.mark.parametrize("name", plotting.__all__)
def test_given_axes(name, model, operator, pendulum):
    """Drawing goes where it should, and leaves the figure its size."""
    three = {"projection": "3d"} if name == "SurfaceDisplay" else None
    fig, axes = plt.subplots(1, 2, figsize=(5.5, 2.5), subplot_kw=three)
    display = draw(name, model, operator, pendulum, ax=axes[1])
    assert display.ax_ is axes[1]
    assert display.figure_ is fig
    assert not axes[0].lines
    assert not axes[0].collections
    assert_array_equal(fig.get_size_inches(), [5.5, 2.5])
    assert plt.get_fignums() == [fig.number]


@pytest.mark.parametrize("name", plotting.__all__)
def test_own_axes(name, model, operator, pendulum):
    """Drawn anew from what is stored: on a figure of its own, the same picture."""
    display = draw(name, model, operator, pendulum)
    assert display.figure_.get_layout_engine() is not None
    stored = {k: v for k, v in vars(display).items() if not k.endswith("_")}
    again = type(display)(**stored)
    assert not hasattr(again, "ax_")
    assert again.plot() is again
    assert again.figure_ is not display.figure_
    assert len(plt.get_fignums()) == 2
    for kind in ("lines", "collections"):
        assert len(getattr(again.ax_, kind)) == len(getattr(display.ax_, kind))
    assert again.ax_.lines
    for mine, other in zip(again.ax_.lines, display.ax_.lines, strict=True):
        assert_array_equal(data_of(mine), data_of(other))
    assert again.ax_.get_xlabel() == display.ax_.get_xlabel() != ""
    assert again.ax_.get_ylabel() == display.ax_.get_ylabel() != ""
    again.figure_.canvas.draw()


@pytest.mark.parametrize("name", plotting.__all__)
def test_all_parameters_are_documented(name):
    """Of data classes the linter of docstrings does not find them."""
    display = getattr(plotting, name)
    documented = inspect.getdoc(display).split("\nAttributes\n")[0]
    found = re.findall(r"^([a-z_0-9, ]+) : ", documented, re.MULTILINE)
    names = [name for line in found for name in line.split(", ")]
    assert names == list(inspect.signature(display).parameters)


@pytest.mark.parametrize(
    ("name", "artist", "parameter"),
    [
        ("SurfaceDisplay", "samples_", "sample_kw"),
        ("SurfaceDisplay", "centers_", "center_kw"),
        ("SurfaceDisplay", "interpolated_", "interpolated_kw"),
        ("SurfaceDisplay", "estimate_", "estimate_kw"),
        ("SurfaceDisplay", "truth_", "truth_kw"),
        ("ConvergenceDisplay", "line_", "line_kw"),
        ("ConvergenceDisplay", "bound_", "bound_kw"),
        ("ConditioningDisplay", "lines_", "line_kw"),
        ("ConditioningDisplay", "lost_", "lost_kw"),
        ("CenterSelectionDisplay", "samples_", "sample_kw"),
        ("CenterSelectionDisplay", "centers_", "center_kw"),
        ("CenterSelectionDisplay", "circles_", "circle_kw"),
        ("ForecastDisplay", "truth_", "truth_kw"),
        ("ForecastDisplay", "prediction_", "prediction_kw"),
        ("ForecastDisplay", "band_", "band_kw"),
        ("AnalogDisplay", "line_", "line_kw"),
        ("AnalogDisplay", "windows_", "window_kw"),
        ("AnalogDisplay", "forecast_", "forecast_kw"),
        ("AnalogDisplay", "truth_", "truth_kw"),
        ("HorizonErrorDisplay", "lines_", "line_kw"),
        ("SpectrumDisplay", "scatter_", "scatter_kw"),
        ("SpectrumDisplay", "circle_", "circle_kw"),
    ],
)
def test_keyword_arguments_reach_artists(
    name, artist, parameter, model, operator, pendulum
):
    """Under their short names, too, against defaults under the long ones."""
    given = {parameter: {"lw": 3.25, "alpha": 0.125}}
    display = draw(name, model, operator, pendulum, **given)
    drawn = getattr(display, artist)
    for one in drawn if isinstance(drawn, list) else [drawn]:
        assert_allclose(one.get_linewidth(), 3.25)
        assert one.get_alpha() == 0.125
    others = {k: v for k, v in vars(display).items() if k.endswith("_") and k != artist}
    others.pop("unused_", None)  # in the manner of those that are used
    for other in others.values():
        if hasattr(other, "get_linewidth"):
            assert not np.any(np.asarray(other.get_linewidth()) == 3.25)


@pytest.mark.slow
def test_nothing_else_imports_matplotlib():
    code = """
import sys
sys.modules["matplotlib"] = None
import sklearn_koopman
from sklearn_koopman import KoopmanKernelRegressor, plotting
from sklearn_koopman.datasets import make_pendulum
for name in plotting.__all__:
    assert getattr(plotting, name).__name__ == name
data = make_pendulum(20)
model = KoopmanKernelRegressor().fit(data.X, data.y)
try:
    plotting.SurfaceDisplay.from_estimator(model, data.X, data.y)
except ImportError as error:
    print(error)
"""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert 'pip install "sklearn-koopman[plot]"' in result.stdout


# --- Surfaces -----------------------------------------------------------------------


class Explosion(RegressorMixin, BaseEstimator):
    """Harmless near the unit circle, and enormous off it."""

    def fit(self, X, y=None):
        self.fitted_ = True
        return self

    def predict(self, X):
        radius = np.hypot(*np.asarray(X).T)
        return np.asarray(X)[:, 0] + 1e6 * (radius**2 - 1)


def test_surface_is_the_estimate_and_the_truth(model, pendulum):
    ax = axes_3d()
    surfaces = recorded_surfaces(ax)
    display = SurfaceDisplay.from_estimator(
        model,
        pendulum.X,
        pendulum.y,
        function=lambda x: pendulum.G(pendulum.f(x)),
        grid_resolution=21,
        padding=0.2,
        z_limits=(-50.0, 50.0),
        ax=ax,
    )
    low, high = pendulum.X.min(axis=0), pendulum.X.max(axis=0)
    for axis, grid in enumerate([display.xx0, display.xx1]):
        assert grid.shape == (21, 21)
        size = high[axis] - low[axis]
        assert_allclose(grid.min(), low[axis] - 0.2 * size)
        assert_allclose(grid.max(), high[axis] + 0.2 * size)
    ((truth, _), (estimate, _)) = surfaces
    states = np.column_stack([display.xx0.ravel(), display.xx1.ravel()])
    assert_array_equal(truth[0].ravel(), states[:, 0])
    assert_array_equal(truth[1].ravel(), states[:, 1])
    assert_allclose(truth[2].ravel(), pendulum.G(pendulum.f(states)), rtol=1e-12)
    assert_array_equal(estimate[2].ravel(), model.predict(states))


def test_surface_shows_samples_and_centers(model, pendulum):
    display = SurfaceDisplay.from_estimator(
        model,
        pendulum.X,
        pendulum.y,
        feature_names=["p", "q"],
        output_name="height [m]",
    )
    x0, x1, z = display.samples_.get_data_3d()
    assert_array_equal(np.column_stack([x0, x1]), pendulum.X)
    assert_array_equal(z, pendulum.y)
    rows = model.center_indices_
    x0, x1, z = display.interpolated_.get_data_3d()
    assert_array_equal(np.column_stack([x0, x1]), pendulum.X[rows])
    assert_allclose(z, pendulum.y[rows], atol=1e-9)  # interpolated
    x0, x1, z = display.centers_.get_data_3d()
    assert_array_equal(np.column_stack([x0, x1]), pendulum.X[rows])
    assert_array_equal(z, display.ax_.get_zlim()[0])  # the floor
    assert display.truth_ is None
    ax = display.ax_
    labels = ax.get_xlabel(), ax.get_ylabel(), ax.get_zlabel()
    assert labels == ("p", "q", "height [m]")
    assert legend_of(ax) == [
        "estimate",
        "samples",
        "estimate at the centres",
        f"{len(rows)} centres",
    ]
    # Points are drawn on top of the mesh.
    assert display.samples_.get_zorder() > display.estimate_.get_zorder()
    assert not ax.computed_zorder


def test_surface_that_explodes_does_not_squash_the_rest():
    angle = np.linspace(0, 2 * np.pi, 49)
    X = np.column_stack([np.cos(angle), np.sin(angle)])
    ax = axes_3d()
    surfaces = recorded_surfaces(ax)
    display = SurfaceDisplay.from_estimator(
        Explosion().fit(X), X, X[:, 0], grid_resolution=41, padding=0, ax=ax
    )
    low, high = ax.get_zlim()
    assert_allclose([low, high], [-1.5, 1.5])  # a quarter of the range more
    drawn = surfaces[0][0][2]
    inside = (display.estimate >= low) & (display.estimate <= high)
    assert 0 < inside.sum() < 100
    assert np.abs(display.estimate).max() > 1e5  # stored as it is
    assert_array_equal(drawn[inside], display.estimate[inside])
    assert np.isnan(drawn).sum() > 1000
    outside = drawn[~inside & np.isfinite(drawn)]
    assert len(outside) > 0
    assert set(outside) <= {low, high}


def test_surface_limits():
    """Those of all samples and the middle of the truth, whatever the estimate is."""
    X = np.random.default_rng(0).uniform(-1, 1, (30, 2))
    y = np.linspace(2, 4, 30)
    linear = LinearRegression().fit(X, y)

    def limits(y=y, **kwargs):
        return SurfaceDisplay.from_estimator(linear, X, y, **kwargs).ax_.get_zlim()

    assert_allclose(limits(), (1.5, 4.5))

    def pole(x):
        """Between 0 and 8, but at one point of the grid, the one in the middle."""
        value = 8 * (x[:, 0] > 0.0)
        value = value.astype(float)
        value[len(x) // 2] = 1e9
        return value

    assert_allclose(limits(function=pole), (-2, 10))
    assert_allclose(limits(function=lambda x: np.full(len(x), 3.0)), (1.5, 4.5))
    assert_allclose(limits(z_limits=(0, 7)), (0, 7))
    assert_allclose(limits(np.full(30, 2.0)), (1, 3))  # constant


def test_surface_without_outputs(model, pendulum):
    """The samples lie on the true function, or else on the estimate."""
    X = pendulum.X
    known = SurfaceDisplay.from_estimator(model, X, function=lambda x: x[:, 0] ** 2)
    assert_allclose(known.samples_.get_data_3d()[2], X[:, 0] ** 2)
    unknown = SurfaceDisplay.from_estimator(model, X)
    assert_array_equal(unknown.samples_.get_data_3d()[2], model.predict(X))


def test_surface_of_one_of_several_outputs(pendulum):
    model = KoopmanKernelRegressor("matern32").fit(pendulum.X, pendulum.X_next)
    display = SurfaceDisplay.from_estimator(
        model, pendulum.X, pendulum.X_next, function=pendulum.f, output=1
    )
    states = np.column_stack([display.xx0.ravel(), display.xx1.ravel()])
    assert_allclose(display.estimate.ravel(), model.predict(states)[:, 1])
    assert_array_equal(display.truth.ravel(), pendulum.f(states)[:, 1])
    assert_array_equal(display.samples_.get_data_3d()[2], pendulum.X_next[:, 1])


@pytest.mark.parametrize(
    "before",
    [
        [StandardScaler()],
        [StandardScaler(), PCA(n_components=1)],  # cannot be inverted
        [StandardScaler(), SeparatedCenterSelector(0.5)],
    ],
    ids=["scaler", "projection", "distances"],
)
def test_surface_of_a_pipeline(before, pendulum):
    """In the original units, with the rows of X that are centres."""
    distances = isinstance(before[-1], SeparatedCenterSelector)
    centers = "precomputed" if distances else SeparatedCenterSelector(0.5)
    model = make_pipeline(
        *before,
        KoopmanKernelRegressor(
            beta=1.0, centers=centers, method="least_squares", alpha=1e-6
        ),
    )
    if distances:
        model[-1].set_params(method="interpolation", alpha=0.0)
    X, y = pendulum.X, pendulum.y
    model.fit(X, y)
    display = SurfaceDisplay.from_estimator(model, X, y)
    rows = model[-1].center_indices_
    assert 2 < len(rows) < 60
    assert_array_equal(display.centers, X[rows])
    assert_allclose(display.center_values, model.predict(X)[rows], rtol=1e-12)
    # Of other states it is unknown which are centres.
    other = SurfaceDisplay.from_estimator(model, X[::-1], y[::-1])
    assert other.centers is None
    assert other.centers_ is None
    assert SurfaceDisplay.from_estimator(model, X[:3], y[:3]).centers is None


def test_surface_of_a_search(pendulum):
    search = GridSearchCV(
        make_pipeline(StandardScaler(), KoopmanKernelRegressor()),
        {"koopmankernelregressor__beta": [1.0, 2.0]},
        cv=2,
    ).fit(pendulum.X, pendulum.y)
    display = SurfaceDisplay.from_estimator(search, pendulum.X, pendulum.y)
    rows = search.best_estimator_[-1].center_indices_
    assert_array_equal(display.centers, pendulum.X[rows])


def test_surface_of_a_data_frame(pendulum):
    X = pd.DataFrame(pendulum.X, columns=["momentum", "position"])
    model = KoopmanKernelRegressor(centers=SeparatedCenterSelector(0.4))
    model.fit(X, pendulum.y)
    display = SurfaceDisplay.from_estimator(model, X, pendulum.y)  # without a warning
    assert display.ax_.get_xlabel() == "momentum"
    assert display.ax_.get_ylabel() == "position"
    assert_array_equal(display.centers, model.centers_)


def test_surface_refuses(model, pendulum):
    X, y = pendulum.X, pendulum.y
    show = SurfaceDisplay.from_estimator
    with pytest.raises(NotFittedError):
        show(KoopmanKernelRegressor(), X, y)
    wide = KoopmanKernelRegressor().fit(np.c_[X, X], y)
    with pytest.raises(ValueError, match=r"two features.*got 4"):
        show(wide, np.c_[X, X], y)
    with pytest.raises(ValueError, match=r"output=1 is not among.*from 0 to 0"):
        show(model, X, y, output=1)
    with pytest.raises(ValueError, match="output must be an integer"):
        show(model, X, y, output=-1)
    with pytest.raises(ValueError, match=r"y must have the shape \(100,\)"):
        show(model, X, y[:-1])
    with pytest.raises(ValueError, match=r"function\(X\) must have the shape"):
        show(model, X, y, function=lambda x: x[0])
    with pytest.raises(ValueError, match="grid_resolution must be an integer"):
        show(model, X, y, grid_resolution=1)
    with pytest.raises(ValueError, match="padding must be a finite non-negative"):
        show(model, X, y, padding=-0.1)
    for limits in [(1, 0), (0, np.inf), (1, 2, 3)]:
        with pytest.raises(ValueError, match="z_limits must be two rising numbers"):
            show(model, X, y, z_limits=limits)
    for names in (["p"], "pq"):
        with pytest.raises(ValueError, match="feature_names must hold 2 names"):
            show(model, X, y, feature_names=names)
    with pytest.raises(ValueError, match="ax must be three-dimensional"):
        show(model, X, y, ax=plt.subplots()[1])


# --- Convergence --------------------------------------------------------------------


def test_convergence_of_the_largest_error():
    study = convergence()
    display = ConvergenceDisplay.from_study(study, state_unit="rad", output_unit="m")
    h, error = study.fill_distance, study.sup_error
    order = [0, 3, 2, 1]  # those used, by rising fill distance
    assert_array_equal(data_of(display.line_), np.c_[h, error][order])
    assert_array_equal(data_of(display.unused_), [[0.05, 1e-3]])  # zero has no place
    assert display.unused_.get_markerfacecolor() == "none"
    assert display.unused_.get_color() == display.line_.get_color()
    assert display.unused_.get_linestyle() == "None"
    ax = display.ax_
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_xlabel() == "fill distance [rad]"
    assert ax.get_ylabel() == "largest error [m]"
    assert legend_of(ax) == ["Matern-3/2: 3.00 ± 0.10 (guaranteed 1.5)"]
    title = ax.get_legend().get_title().get_text()
    assert title == "slope ± 90% interval, dashed: guaranteed, hollow: not fitted"


def test_guaranteed_slope_bounds_the_errors():
    display = ConvergenceDisplay.from_study(convergence())
    bound = display.bound_
    assert_allclose(slope_of(bound), 1.5)
    assert bound.get_linestyle() == "--"
    assert bound.get_color() == display.line_.get_color()
    x, y = bound.get_data()
    assert_allclose([x[0], x[-1]], [0.1, 0.8])
    h, error = display.line_.get_data()
    above = y[0] * (h / x[0]) ** 1.5 / error
    assert_allclose(above.min(), 1.5)  # it is nearest at the largest fill distance
    assert above.argmin() == 3
    # Steeper than the errors, it is nearest at the smallest.
    steep = ConvergenceDisplay.from_study(convergence(guaranteed=4.0)).bound_
    assert_allclose(slope_of(steep), 4.0)
    assert_allclose(steep.get_ydata()[0] / error[0], 1.5)


def test_convergence_of_the_mean_square_error():
    study = convergence()
    display = ConvergenceDisplay.from_study(study, quantity="rms_error", name="mine")
    assert_array_equal(display.line_.get_ydata(), study.rms_error[[0, 3, 2, 1]])
    assert_allclose(slope_of(display.bound_), 2.0)
    assert legend_of(display.ax_) == ["mine: 4.00 ± 0.20 (guaranteed 2)"]
    assert display.ax_.get_ylabel() == "root mean square error"


@pytest.mark.parametrize(
    ("guaranteed", "label"),
    [(np.inf, "guaranteed: any power"), (np.nan, "no guarantee")],
)
@pytest.mark.parametrize("quantity", ["sup_error", "rms_error"])
def test_no_line_without_a_finite_guarantee(guaranteed, label, quantity):
    study = convergence(guaranteed=guaranteed)
    study.rates.rms_exponent = np.inf if np.isinf(guaranteed) else 2.0
    display = ConvergenceDisplay.from_study(study, quantity=quantity)
    assert display.bound_ is None
    assert legend_of(display.ax_)[0].endswith(f"({label})")
    assert "dashed" not in display.ax_.get_legend().get_title().get_text()


def test_slope_that_is_unknown():
    study = convergence()
    study.slope, study.slope_interval = np.nan, (np.nan, np.nan)
    study.used[:] = False
    display = ConvergenceDisplay.from_study(study)
    assert legend_of(display.ax_) == ["Matern-3/2: no slope (guaranteed 1.5)"]
    assert len(display.line_.get_xdata()) == 0
    assert len(display.unused_.get_xdata()) == 5
    assert display.bound_.get_ydata()[-1] == pytest.approx(1.5 * 0.5 * 0.8**3)
    study.slope = -2.0  # from two lines there is a slope, but no interval
    label = legend_of(ConvergenceDisplay.from_study(study).ax_)[0]
    assert label == "Matern-3/2: \N{MINUS SIGN}2.00 (guaranteed 1.5)"


def test_overlaid_convergence():
    """As in Figure 4, for several kernels: colours and markers of their own."""
    ax, displays = None, []
    for i in range(8):
        study = convergence(slope=2.0 + i)
        display = ConvergenceDisplay.from_study(study, name=f"kernel {i}", ax=ax)
        ax = display.ax_
        displays.append(display)
    colors = [display.line_.get_color() for display in displays]
    assert colors == OKABE_ITO + OKABE_ITO[:2]
    assert all(d.bound_.get_color() == d.line_.get_color() for d in displays)
    styles = {(d.line_.get_color(), d.line_.get_marker()) for d in displays}
    assert len(styles) == 8
    labels = legend_of(ax)
    assert all(label.startswith(f"kernel {i}: ") for i, label in enumerate(labels))
    assert len(labels) == 8
    # The labels of the axis do not run into each other.
    ax.figure.canvas.draw()
    view = ax.get_window_extent()
    ticks = [
        (t.get_text(), t.get_window_extent()) for t in ax.get_xticklabels(which="both")
    ]
    ticks = [(text, b) for text, b in ticks if text and view.x0 <= b.x0 <= view.x1]
    assert [text for text, _ in ticks] == ["0.05", "0.1", "0.2", "0.5"]
    shown = [(box.x0, box.x1) for _, box in ticks]
    assert all(left[1] < right[0] for left, right in pairwise(shown))


def test_convergence_from_an_estimator(pendulum):
    from sklearn_koopman.diagnostics import convergence_study

    model = KoopmanKernelRegressor("matern32", beta=2.0)
    X, y = pendulum.X, pendulum.y
    args = (model, X[::2], y[::2], [1.0, 0.7, 0.5, 0.35], X[1::2], y[1::2])
    display = ConvergenceDisplay.from_estimator(
        *args, dimension=1, confidence=0.8, quantity="rms_error", state_unit="rad"
    )
    study = convergence_study(*args, dimension=1, confidence=0.8)
    assert_array_equal(np.sort(display.error), np.sort(study.rms_error))
    assert_array_equal(display.slope_interval, study.rms_slope_interval)
    assert_allclose(slope_of(display.bound_), study.rates.rms_exponent)
    assert display.ax_.get_xlabel() == "fill distance [rad]"


def test_convergence_refuses():
    with pytest.raises(ValueError, match="quantity must be one of 'sup_error'"):
        ConvergenceDisplay.from_study(convergence(), quantity="max_error")
    with pytest.raises(
        ValueError, match="what convergence_study returned, got Bunch of"
    ):
        ConvergenceDisplay.from_study(conditioning())
    with pytest.raises(ValueError, match="what convergence_study returned, got list"):
        ConvergenceDisplay.from_study([1.0])


@pytest.mark.parametrize(
    ("kernel", "name"),
    [
        ("matern12", "Matern-1/2"),
        ("MaternSobolev(beta=0.5, nu=2.5)", "Matern-5/2"),
        ("wendland_c6", "Wendland C6"),
        ("Wendland(beta=2, smoothness=0, dimension=3)", "Wendland C0"),
        ("Gaussian(beta=2)", "Gaussian"),
        ("inverse_multiquadric", "inverse multiquadric"),
        ("2**2 * RBF(length_scale=1)", "2**2 * RBF(length_scale=1)"),
    ],
)
def test_names_of_kernels(kernel, name):
    assert kernel_name(kernel) == name


# --- Conditioning -------------------------------------------------------------------


def test_conditioning_curves():
    study = conditioning()
    display = ConditioningDisplay.from_study(study, state_unit="rad")
    assert len(display.lines_) == 4
    for line, numbers in zip(
        display.lines_, study.condition_number.reshape(4, 3), strict=True
    ):
        rising = np.c_[study.separation_distance, numbers][[1, 2, 0]]
        assert_array_equal(data_of(line), rising[np.isfinite(rising[:, 1])])
    assert len(display.lines_[3].get_xdata()) == 2  # infinity is left out
    assert [line.get_color() for line in display.lines_] == OKABE_ITO[:4]
    minus = "\N{MINUS SIGN}"
    assert legend_of(display.ax_)[:4] == [
        f"Matern-3/2, β = 1: {minus}4.00 ± 0.20 (expected {minus}4)",
        f"Matern-3/2, β = 2.5: {minus}4.00 ± 0.20 (expected {minus}4)",
        f"Wendland C4, β = 1: {minus}6.00 ± 0.20 (expected: any power)",
        f"Wendland C4, β = 2.5: {minus}6.00 ± 0.20 (expected: any power)",
    ]
    assert display.ax_.get_xlabel() == "separation distance [rad]"
    assert display.ax_.get_ylabel() == "condition number"


def test_all_digits_lost():
    """A line where they are, if any matrix comes near: drawn once."""
    study = conditioning()
    display = ConditioningDisplay.from_study(study)
    assert_allclose(display.lost_.get_ydata(), 2.0**52)
    assert legend_of(display.ax_)[-1] == "all 16 digits lost"
    again = ConditioningDisplay.from_study(study, ax=display.ax_)
    assert again.lost_ is display.lost_
    assert legend_of(display.ax_).count("all 16 digits lost") == 1
    assert [line.get_color() for line in again.lines_[:2]] == OKABE_ITO[4:]

    study.condition_number[1, 1, 2] = 1e12
    assert ConditioningDisplay.from_study(study).lost_ is None
    study.condition_number[1, 1, 2] = 1e13
    assert ConditioningDisplay.from_study(study).lost_ is not None


def test_smallest_eigenvalues():
    study = conditioning()
    study.smallest_eigenvalue[0, 0, 0] = -1e-17  # a rounding error
    display = ConditioningDisplay.from_study(study, quantity="smallest_eigenvalue")
    assert_array_equal(display.lines_[0].get_xdata(), [0.1, 0.2])
    assert_allclose(display.lines_[1].get_ydata() * 10, [0.1**4, 0.2**4, 0.4**4])
    assert display.lost_ is None
    # The slopes of the study are those of the condition number.
    assert legend_of(display.ax_)[0] == "Matern-3/2, β = 1"
    assert display.ax_.get_ylabel() == "smallest eigenvalue"


def test_crowding():
    study = crowding()
    display = ConditioningDisplay.from_study(study)
    assert display.ax_.get_ylabel() == "smallest eigenvalue"
    for i, line in enumerate(display.lines_):
        expected = np.c_[study.separation_distance[i], study.smallest_eigenvalue[i]]
        assert_array_equal(data_of(line), expected[::-1])
    assert legend_of(display.ax_) == [
        "M = 7, fill distance 0.9",
        "M = 15, fill distance 0.4",
        "M = 37, fill distance 0.21",
    ]
    assert display.ax_.get_legend().get_title().get_text() == "Wendland C2"
    numbers = ConditioningDisplay.from_study(study, quantity="condition_number")
    assert_array_equal(numbers.lines_[2].get_ydata(), study.condition_number[2, ::-1])


def test_conditioning_from_kernels(pendulum):
    from sklearn_koopman.diagnostics import conditioning_study

    args = (["matern32"], [1.0, 2.0], pendulum.X, [1.0, 0.7, 0.5])
    display = ConditioningDisplay.from_kernels(*args, dimension=1, state_unit="rad")
    study = conditioning_study(*args, dimension=1)
    assert_array_equal(display.values, study.condition_number[0])
    assert "expected \N{MINUS SIGN}4)" in legend_of(display.ax_)[1]
    assert display.ax_.get_xlabel() == "separation distance [rad]"


def test_conditioning_refuses():
    with pytest.raises(ValueError, match="quantity must be one of 'condition_number'"):
        ConditioningDisplay.from_study(conditioning(), quantity="digits_lost")
    with pytest.raises(
        ValueError, match="conditioning_study or crowding_study returned"
    ):
        ConditioningDisplay.from_study(convergence())


# --- Centres ------------------------------------------------------------------------


def test_circles_of_the_separation(pendulum):
    X = pendulum.X
    selector = SeparatedCenterSelector(0.4).fit(X)
    display = CenterSelectionDisplay.from_estimator(
        selector, X, feature_names=["p [rad/s]", "q [rad]"]
    )
    centers = selector.cluster_centers_
    assert_array_equal(data_of(display.samples_), X)
    assert_array_equal(data_of(display.centers_), centers)
    boxes = [path.get_extents() for path in display.circles_.get_paths()]
    assert_allclose([(box.width, box.height) for box in boxes], 0.8)
    middles = [(box.p0 + box.p1) / 2 for box in boxes]
    assert_allclose(middles, centers, atol=1e-12)
    # In the unit of the data, round, and all in view.
    display.figure_.canvas.draw()
    assert display.ax_.get_aspect() == 1
    (x0, x1), (y0, y1) = display.ax_.get_xlim(), display.ax_.get_ylim()
    assert x0 < min(box.x0 for box in boxes) < max(box.x1 for box in boxes) < x1
    assert y0 < min(box.y0 for box in boxes) < max(box.y1 for box in boxes) < y1
    assert display.ax_.get_xlabel() == "p [rad/s]"
    assert display.ax_.get_ylabel() == "q [rad]"
    assert legend_of(display.ax_) == ["samples", "centres", "separation 0.4"]
    assert_allclose(display.separation_distance, selector.separation_distance_)
    assert_allclose(display.fill_distance, selector.fill_distance_)
    assert display.ax_.get_title() == (
        f"{len(centers)} centres of 100 samples\n"
        f"separation distance {selector.separation_distance_:.3g}, "
        f"fill distance {selector.fill_distance_:.3g}"
    )


def test_centers_of_models(model, operator, pendulum):
    for fitted in (model, operator):
        display = CenterSelectionDisplay.from_estimator(fitted, pendulum.X)
        assert_array_equal(data_of(display.centers_), fitted.centers_)
        assert len(display.circles_.get_paths()) == len(fitted.centers_)
        assert display.separation == 0.4
    X, y = pendulum.X, pendulum.y
    given = KoopmanKernelRegressor(centers=X[::10]).fit(X, y)
    assert CenterSelectionDisplay.from_estimator(given, X).circles_ is None
    every = SeparatedCenterSelector(0.0).fit(X)
    assert CenterSelectionDisplay.from_estimator(every, X).circles_ is None
    one = SeparatedCenterSelector(max_centers=1).fit(X)
    title = CenterSelectionDisplay.from_estimator(one, X).ax_.get_title()
    assert "1 centres of 100 samples\nseparation distance inf" in title


def test_two_of_several_features(walking):
    """No circles: what is inside of them would not be near."""
    pairs = trajectory_pairs(walking.trajectories, delays=2, delay_step=3)
    X = pd.DataFrame(pairs.X, columns=["hip", "knee", "hip before", "knee before"])
    selector = SeparatedCenterSelector(0.2).fit(X)
    display = CenterSelectionDisplay.from_estimator(selector, X, features=(3, 0))
    assert_array_equal(data_of(display.samples_), pairs.X[:, [3, 0]])
    assert_array_equal(data_of(display.centers_), selector.cluster_centers_[:, [3, 0]])
    assert display.circles_ is None
    assert display.ax_.get_xlabel() == "knee before"
    assert display.ax_.get_ylabel() == "hip"
    assert legend_of(display.ax_) == ["samples", "centres"]
    assert_allclose(display.fill_distance, selector.fill_distance_)


def test_centers_refuse(model, pendulum):
    X, y = pendulum.X, pendulum.y
    show = CenterSelectionDisplay.from_estimator
    with pytest.raises(NotFittedError):
        show(SeparatedCenterSelector(), X)
    pipeline = make_pipeline(StandardScaler(), KoopmanKernelRegressor()).fit(X, y)
    with pytest.raises(ValueError, match=r"Pipeline.*pass estimator\[-1\]"):
        show(pipeline, X)
    assert len(show(pipeline[-1], pipeline[:-1].transform(X)).centers) == len(X)
    with pytest.raises(ValueError, match="has no centres that are states"):
        show(LinearRegression().fit(X, y), X)
    with pytest.raises(ValueError, match="X has 3 features, but the centres have 2"):
        show(model, np.c_[X, y])
    for features in [(0, 2), (0, 0), (0,), (0, 1, 1), (-1, 0), (0, 0.5), "01", None]:
        with pytest.raises(ValueError, match="features must be two different columns"):
            show(model, X, features=features)
    with pytest.raises(ValueError, match="feature_names must hold 2 names"):
        show(model, X, feature_names=["a", "b", "c"])


# --- Forecasts ----------------------------------------------------------------------


def test_predictions():
    y_true = np.array([[1.0, 10], [2, 20], [3, 30]])
    y_pred, bound = y_true + 0.5, np.array([[0.1, 1], [0.2, 2], [0.3, 3]])
    display = ForecastDisplay.from_predictions(
        *(y_true, y_pred),
        bound=bound,
        bound_label="twice the error",
        dt=0.5,
        output=1,
        output_name="ankle",
        unit="mm",
        name="guess",
    )
    time = [0.5, 1.0, 1.5]
    assert_array_equal(data_of(display.truth_), np.c_[time, y_true[:, 1]])
    assert_array_equal(data_of(display.prediction_), np.c_[time, y_pred[:, 1]])
    (path,) = display.band_.get_paths()
    vertices = {tuple(v) for v in path.vertices.round(9)}
    for t, middle, half in zip(time, y_pred[:, 1], bound[:, 1], strict=True):
        assert {(t, middle - half), (t, middle + half)} <= vertices
    assert len(vertices) == 6
    assert same_color(display.prediction_.get_color(), OKABE_ITO[1])
    assert legend_of(display.ax_) == ["measured", "guess", "twice the error"]
    assert display.ax_.get_xlabel() == "time [s]"
    assert display.ax_.get_ylabel() == "ankle [mm]"


def test_times_of_predictions():
    y = np.arange(3.0)
    counted = ForecastDisplay.from_predictions(y, y)
    assert_array_equal(counted.truth_.get_xdata(), [1, 2, 3])
    assert counted.ax_.get_xlabel() == "time [samples]"
    assert counted.ax_.get_ylabel() == "output"
    assert counted.band_ is None
    given = ForecastDisplay.from_predictions(y, y, time=[4, 6, 9])
    assert_array_equal(given.truth_.get_xdata(), [4, 6, 9])
    assert given.ax_.get_xlabel() == "time [s]"
    two = np.c_[y, y + 1]
    several = ForecastDisplay.from_predictions(two, two, bound=y, output=1)
    assert several.ax_.get_ylabel() == "output 1"
    assert_array_equal(several.bound, y)  # one for all outputs


def test_one_step_ahead(model, pendulum):
    X, y = pendulum.X, pendulum.y
    display = ForecastDisplay.from_estimator(
        model, X, y, lag=1, band="std", dt=0.1, start=10
    )
    mean, std = model.predict(X[10:], return_std=True)
    assert_array_equal(display.truth_.get_ydata(), y[10:])
    assert_array_equal(display.prediction_.get_ydata(), mean)
    assert_array_equal(display.bound, 2 * std)
    assert_allclose(display.time, 0.1 * np.arange(1, 91))
    assert legend_of(display.ax_)[2] == "±2 standard deviations"
    plain = ForecastDisplay.from_estimator(model, X, y, lag=3)
    assert plain.band_ is None
    assert_array_equal(plain.time, np.arange(3, 103))  # a step is three rows
    assert plain.ax_.get_xlabel() == "time [samples]"


def test_error_bound(pendulum):
    class Bounded(KoopmanKernelRegressor):
        def error_bound(self, X, norm=None):
            return (2.0 if norm is None else norm) * self.power_function(X)

    X, y = pendulum.X, pendulum.y
    pipeline = make_pipeline(
        StandardScaler(), Bounded("matern32", centers=SeparatedCenterSelector(0.3))
    ).fit(X, y)
    power = pipeline[-1].power_function(pipeline[0].transform(X))
    for norm, factor in ((None, 2.0), (5.0, 5.0)):
        display = ForecastDisplay.from_estimator(
            pipeline, X, y, lag=1, band="bound", norm=norm, bound_label="at the most"
        )
        assert_allclose(display.bound, factor * power)
        assert legend_of(display.ax_)[2] == "at the most"


@pytest.mark.parametrize("relift", [False, True])
def test_forecast(operator, pendulum, relift):
    display = ForecastDisplay.from_estimator(
        operator,
        pendulum.X,
        pendulum.y,
        n_steps=12,
        start=5,
        lag=1,
        relift=relift,
        dt=0.1,
    )
    expected = operator.forecast(pendulum.X[5:6], 12, relift=relift)[0]
    assert_array_equal(display.prediction_.get_ydata(), expected)
    assert_array_equal(display.truth_.get_ydata(), pendulum.y[5:17])
    assert_allclose(display.time, 0.1 * np.arange(1, 13))


def test_forecast_by_steps_of_several_rows(walking):
    """One step is `lag` rows; of a data frame, through a scaler."""
    pairs = trajectory_pairs(walking.trajectories, walking.outputs, lag=4)
    X = pd.DataFrame(pairs.X, columns=["hip", "knee"])
    pipeline = make_pipeline(
        StandardScaler(),
        KernelEDMD("matern32", centers=SeparatedCenterSelector(0.2), n_modes=0),
    )
    pipeline.fit(X, pairs.y, kerneledmd__sample_index=pairs.sample_index)
    display = ForecastDisplay.from_estimator(
        pipeline, X, pairs.y, n_steps=5, start=2, lag=4, dt=0.01, output=1
    )
    assert_array_equal(display.truth_.get_ydata(), pairs.y[[2, 6, 10, 14, 18], 1])
    assert_allclose(display.time, [0.04, 0.08, 0.12, 0.16, 0.2])
    states = pipeline[:-1].transform(X)[2:3]
    expected = pipeline[-1].forecast(states, 5)[0, :, 1]
    assert_array_equal(display.prediction_.get_ydata(), expected)
    # One step ahead these are the predictions.
    first = ForecastDisplay.from_estimator(pipeline, X, pairs.y, lag=4, output=1)
    assert_allclose(first.y_pred, pipeline.predict(X)[:, 1])
    unscaled = pipeline[-1].set_params(centers=None).fit(X, pairs.y)
    named = ForecastDisplay.from_estimator(unscaled, X, pairs.y, n_steps=2)
    assert_array_equal(named.y_pred, unscaled.forecast(X[:1], 2)[0, :, 0])


@pytest.fixture(scope="module")
def strides(walking):
    """Pairs of a step of four rows, and a model of them."""
    pairs = trajectory_pairs(walking.trajectories, walking.outputs, lag=4)
    model = KernelEDMD(
        "matern32", beta=1.0, centers=SeparatedCenterSelector(0.2), n_modes=0
    )
    return pairs, model.fit(pairs.X, pairs.y, sample_index=pairs.sample_index)


def test_a_forecast_does_not_run_into_the_next_trial():
    """What followed in the frame was taken for the truth."""
    wave = np.sin(0.1 * np.arange(100))[:, np.newaxis]
    pairs = trajectory_pairs([pd.DataFrame(wave), pd.DataFrame(wave + 2)], lag=5)
    model = KernelEDMD(alpha=1e-3, n_modes=0).fit(pairs.X, pairs.y)
    show = ForecastDisplay.from_estimator
    display = show(model, pairs.X, pairs.y, n_steps=10, start=45)
    assert_array_equal(display.truth_.get_ydata(), wave[50:100:5, 0])
    with pytest.raises(ValueError, match="row 95 is not a step after row 90"):
        show(model, pairs.X, pairs.y, n_steps=10, start=90)
    with pytest.raises(ValueError, match="row 95 is not a step after row 90"):
        show(model, pairs.X, pairs.y)
    show(model, pairs.X.loc[[1]], pairs.y.loc[[1]])


@pytest.mark.parametrize("of", ["X", "y"])
def test_lag_is_read_off_the_index(strides, of):
    """Without it, the fifth step stood at row 5 instead of 20, beside a wrong truth."""
    pairs, model = strides
    index = pd.MultiIndex.from_arrays(
        [pairs.groups, pairs.sample_index], names=["trial", "sample_index"]
    )
    X, y = pairs.X, pairs.y
    if of == "X":
        X = pd.DataFrame(X, index)
        model = clone(model).fit(X, y)
    else:
        y = pd.DataFrame(y, index)
    show = ForecastDisplay.from_estimator
    display = show(model, X, y, n_steps=5, dt=0.01)
    assert_array_equal(display.truth_.get_ydata(), pairs.y[:20:4, 0])
    assert_allclose(display.time, [0.04, 0.08, 0.12, 0.16, 0.2])
    assert np.abs(display.y_true - display.y_pred).max() < 10  # in mm
    with pytest.raises(ValueError, match="row 1 is not a step after row 0"):
        show(model, X, y, n_steps=5, lag=1)


def test_lag_is_read_off_outputs_that_are_states(strides):
    _, model = strides
    walking = make_walking(speeds=[1.2, 1.5], n_strides=3, rate=60.0, random_state=0)
    pairs = trajectory_pairs(walking.trajectories, lag=4, delays=2)
    other = clone(model).fit(pairs.X, pairs.y, sample_index=pairs.sample_index)
    display = ForecastDisplay.from_estimator(other, pairs.X, pairs.y, n_steps=3)
    assert_array_equal(display.time, [4, 8, 12])
    assert_array_equal(display.truth_.get_ydata(), pairs.X[4:16:4, 0])


def test_lag_is_asked_for_where_nothing_tells(strides, walking):
    pairs, model = strides
    message = "not known how many rows make one step; pass lag, that of traj"
    for n_steps in (None, 5):
        with pytest.raises(ValueError, match=message):
            ForecastDisplay.from_estimator(model, pairs.X, pairs.y, n_steps=n_steps)
    # An index of which no row follows another, or in which steps differ.
    for clock in (2 * np.arange(len(pairs.X)), -np.arange(len(pairs.X))):
        index = pd.Index(clock, name="sample_index")
        with pytest.raises(ValueError, match=message):
            ForecastDisplay.from_estimator(model, pd.DataFrame(pairs.X, index), pairs.y)
    # A model of rows in the order of time takes one row a step.
    pairs = trajectory_pairs(walking.trajectories, walking.outputs)
    simple = clone(model).fit(pairs.X, pairs.y)
    display = ForecastDisplay.from_estimator(simple, pairs.X, pairs.y, n_steps=3)
    assert_array_equal(display.time, [1, 2, 3])


def test_masked_outputs_are_gaps(model, pendulum):
    y = np.ma.array(pendulum.y, copy=True)
    y[3] = np.ma.masked
    show = ForecastDisplay.from_estimator
    display = show(model, pendulum.X, y, lag=1)
    assert_array_equal(np.flatnonzero(np.isnan(display.y_true)), [3])
    masked = np.ma.array(pendulum.X, mask=np.tile(y.mask[:, np.newaxis], 2))
    with pytest.raises(ValueError, match="X holds 2 masked values"):
        show(model, masked, pendulum.y, lag=1)


def test_forecast_that_diverges_does_not_squash_the_rest():
    truth = np.linspace(-1, 1, 5)
    display = ForecastDisplay.from_predictions(truth, [-1.0, 0, 1e3, -1e9, np.nan])
    low, high = display.ax_.get_ylim()
    assert -4 < low <= -3  # two more below, and a margin
    assert 3 <= high < 4.5
    assert_array_equal(display.prediction_.get_ydata()[2:4], [1e3, -1e9])
    loose = ForecastDisplay.from_predictions(truth, truth, bound=np.full(5, 100.0))
    assert loose.ax_.get_ylim() == pytest.approx((low, high))
    near = ForecastDisplay.from_predictions(truth, truth + 0.5)
    low, high = near.ax_.get_ylim()
    assert -1.3 < low < -1
    assert 1.5 < high < 2.3


def test_overlaid_forecasts(operator, pendulum):
    """Two models share the measured line; another truth is another line."""
    X, y = pendulum.X, pendulum.y
    settings = {"n_steps": 20, "lag": 1}
    first = ForecastDisplay.from_estimator(operator, X, y, name="powers", **settings)
    second = ForecastDisplay.from_estimator(
        operator, X, y, relift=True, name="relifted", ax=first.ax_, **settings
    )
    assert second.truth_ is first.truth_
    assert legend_of(first.ax_) == ["measured", "powers", "relifted"]
    colors = [d.prediction_.get_color() for d in (first, second)]
    assert colors == OKABE_ITO[1:3]
    other = ForecastDisplay.from_predictions(y[:20] + 1, y[:20], ax=first.ax_)
    assert other.truth_ is not first.truth_
    gappy = ForecastDisplay.from_predictions([1.0, np.nan, 2.0], [1.0, 1, 2])
    again = ForecastDisplay.from_predictions(
        [1.0, np.nan, 2.0], [2, 2, 2], ax=gappy.ax_
    )
    assert again.truth_ is gappy.truth_


def test_forecasts_refuse(model, operator, pendulum):
    X, y = pendulum.X, pendulum.y
    with pytest.raises(NotFittedError):
        ForecastDisplay.from_estimator(KernelEDMD(), X, y)

    def show(*args, lag=1, **kwargs):
        return ForecastDisplay.from_estimator(*args, lag=lag, **kwargs)

    with pytest.raises(ValueError, match="forecast, which takes a KernelEDMD"):
        show(model, X, y, n_steps=3)
    with pytest.raises(ValueError, match="has no band"):
        show(operator, X, y, n_steps=3, band="std")
    with pytest.raises(
        ValueError, match="band must be one of None, 'std', 'bound', got"
    ):
        show(model, X, y, band="sd")
    with pytest.raises(ValueError, match=r"return_std=True\), which LinearRegression"):
        show(LinearRegression().fit(X, y), X, y, band="std")
    with pytest.raises(ValueError, match=r"error_bound\(X\), which LinearRegression"):
        show(LinearRegression().fit(X, y), X, y, band="bound")
    with pytest.raises(ValueError, match="need 101 rows, got 100"):
        show(operator, X, y, n_steps=51, start=0, lag=2)
    show(operator, X, y, n_steps=50, start=0, lag=2)
    with pytest.raises(ValueError, match=r"start=100.* need 101 rows, got 100"):
        show(model, X, y, start=100)
    with pytest.raises(ValueError, match=r"numbers of samples: \[100, 99\]"):
        show(model, X, y[1:])
    for wrong in ({"start": -1}, {"lag": 0}, {"n_steps": 0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} must be an integer"):
            show(operator, X, y, **wrong)
    with pytest.raises(ValueError, match="dt must be a finite positive"):
        show(model, X, y, dt=0)
    with pytest.raises(ValueError, match="relift must be True or False"):
        show(operator, X, y, n_steps=2, relift=1)

    compare = ForecastDisplay.from_predictions
    with pytest.raises(ValueError, match=r"time .* excludes dt; got .* dt=0.1"):
        compare(y, y, time=y, dt=0.1)
    with pytest.raises(ValueError, match="one entry for each of 100"):
        compare(y, y, time=y[1:])
    with pytest.raises(ValueError, match="dt must be a finite positive"):
        compare(y, y, dt=-1)
    with pytest.raises(ValueError, match="y_true must have the shape"):
        compare(y[1:], y)
    with pytest.raises(ValueError, match="bound must have the shape"):
        compare(y, y, bound=y[1:])
    with pytest.raises(ValueError, match="half the width of the band, got -1"):
        compare(y, y, bound=np.full(100, -1.0))
    with pytest.raises(ValueError, match="output=1 is not among the 1 outputs of y_tr"):
        compare(y, y, output=1)


# --- Spectra ------------------------------------------------------------------------


def test_spectrum_of_the_pendulum(operator):
    display = SpectrumDisplay.from_estimator(operator)
    # In the order of the operator, most trustworthy first, drawn the other way round.
    drawn = display.scatter_.get_offsets()
    assert_array_equal(drawn[:, 0] + 1j * drawn[:, 1], operator.eigenvalues_[::-1])
    assert_array_equal(display.scatter_.get_array(), operator.residuals_[::-1])
    assert isinstance(display.scatter_.norm, LogNorm)
    assert display.scatter_.norm.vmin == operator.residuals_.min()
    assert display.scatter_.norm.vmax == 1
    assert display.scatter_.get_cmap().name == "viridis_r"
    assert_allclose(np.hypot(*display.circle_.get_data()), 1)
    assert display.circle_.get_zorder() < display.scatter_.get_zorder()
    assert display.colorbar_.ax.get_ylabel() == "residual"
    assert display.ax_.get_aspect() == 1
    assert display.ax_.get_title() == f"{len(drawn)} eigenvalues"


def test_most_trustworthy_on_top():
    """By residual over modulus, whatever the order given."""
    eigenvalues = np.array([0.1, 1.0, 0.9j, -0.5])
    residuals = np.array([0.05, 0.2, 0.01, 0.04])
    display = SpectrumDisplay(eigenvalues=eigenvalues, residuals=residuals).plot()
    assert_array_equal(display.scatter_.get_array(), residuals[[0, 1, 3, 2]])
    assert_array_equal(
        display.scatter_.get_offsets(), [[0.1, 0], [1, 0], [-0.5, 0], [0, 0.9]]
    )


def test_extraordinary_residuals():
    eigenvalues = np.array([1.0, 0.5, 0.4, 0.3, 0.0])
    residuals = np.array([0.0, 0.01, np.inf, np.nan, 2.0])
    display = SpectrumDisplay(eigenvalues=eigenvalues, residuals=residuals).plot()
    array = display.scatter_.get_array()
    assert not np.ma.is_masked(array)
    by_place = dict(zip(display.scatter_.get_offsets()[:, 0], array, strict=True))
    assert by_place == {1.0: 0.01, 0.5: 0.01, 0.4: 2.0, 0.3: 2.0, 0.0: 2.0}
    assert_array_equal(display.scatter_.get_offsets()[-2:, 0], [0.5, 1.0])
    display.figure_.canvas.draw()
    assert (display.scatter_.get_facecolor()[:, 3] == 1).all()  # all visible
    assert display.colorbar_.extend == "max"
    for same in (0.0, np.inf, 0.3, 1e-20):
        same = SpectrumDisplay(eigenvalues=eigenvalues, residuals=np.full(5, same))
        same.plot().figure_.canvas.draw()
        assert (same.scatter_.get_facecolor()[:, 3] == 1).all()


def test_one_perfect_eigenvalue_leaves_the_others_their_colors():
    eigenvalues, residuals = np.array([1.0, 0.9, 0.5]), np.array([1e-15, 0.01, 0.5])
    display = SpectrumDisplay(eigenvalues=eigenvalues, residuals=residuals).plot()
    assert display.scatter_.norm.vmin == 1e-6
    assert display.colorbar_.extend == "min"
    assert_array_equal(display.scatter_.get_array(), residuals[::-1])


def test_spectra_on_one_scale(operator):
    norm = LogNorm(1e-4, 1e-1)
    fig, axes = plt.subplots(1, 2)
    display = SpectrumDisplay.from_estimator(
        operator, ax=axes[0], colorbar=False, scatter_kw={"norm": norm}
    )
    assert display.colorbar_ is None
    assert display.scatter_.norm is norm
    assert fig.axes == list(axes)


def test_spectra_refuse(model, pendulum):
    with pytest.raises(NotFittedError):
        SpectrumDisplay.from_estimator(KernelEDMD())
    with pytest.raises(ValueError, match="no spectrum; pass a KernelEDMD"):
        SpectrumDisplay.from_estimator(model)
    without = KernelEDMD(n_modes=0).fit(pendulum.X[:10])
    with pytest.raises(ValueError, match=r"n_modes=0.*no spectrum.*n_modes=None"):
        SpectrumDisplay.from_estimator(without)
    pipeline = make_pipeline(StandardScaler(), KernelEDMD()).fit(pendulum.X[:10])
    assert len(SpectrumDisplay.from_estimator(pipeline).eigenvalues) == 9
    with pytest.raises(ValueError, match="colorbar must be True or False"):
        SpectrumDisplay.from_estimator(pipeline, colorbar="no")


def test_a_band_may_have_one_width():
    y = np.arange(5.0)
    display = ForecastDisplay.from_predictions(y, y, bound=0.5)
    assert_array_equal(display.bound, np.full(5, 0.5))


def test_legends_name_no_part_of_a_composite_kernel():
    kernel = MaternSobolev(2.0, nu=1.5) + Wendland(1.0, smoothness=2)
    assert kernel_name(repr(kernel)) == repr(kernel)
    assert kernel_name(repr(MaternSobolev(2.0, nu=1.5))) == "Matern-3/2"
    assert kernel_name(repr(Wendland(1.0, smoothness=4))) == "Wendland C4"


def test_surfaces_share_a_legend(pendulum):
    model = KoopmanKernelRegressor(beta=2.0).fit(pendulum.X, pendulum.y)
    display = SurfaceDisplay.from_estimator(model, pendulum.X, legend=False)
    assert display.ax_.get_legend() is None
    labels = [handle.get_label() for handle in display.handles_]
    assert labels[0] == "estimate"
    assert labels[-1] == f"{len(model.centers_)} centres"
