"""What bad input gets: an error with parameter, value and remedy, or a known result."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.cluster import DBSCAN, KMeans
from sklearn.exceptions import NotFittedError
from sklearn.gaussian_process.kernels import RBF, DotProduct
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.kernels import Wendland

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

RNG = np.random.default_rng(0)
X = RNG.standard_normal((30, 2))
Y = RNG.standard_normal(30)
NAN = np.where(np.arange(60).reshape(30, 2) == 7, np.nan, X)
INF = np.where(np.arange(60).reshape(30, 2) == 7, np.inf, X)
TWICE = np.vstack([X, X[4:6]])
DISTANCES = np.linalg.norm(X[:, None] - X, axis=2)

# Parameters, X, y, and what the message must hold: parameter, value and remedy.
REFUSED = {
    "beta zero": ({"beta": 0}, X, Y, ["beta", "positive", "got 0"]),
    "beta negative": ({"beta": -1.5}, X, Y, ["beta", "positive", "got -1.5"]),
    "beta nan": ({"beta": np.nan}, X, Y, ["beta", "finite", "got nan"]),
    "beta infinite": ({"beta": np.inf}, X, Y, ["beta", "finite", "got inf"]),
    "beta text": ({"beta": "wide"}, X, Y, ["beta", "number", "got 'wide'"]),
    "beta with a foreign kernel": (
        {"kernel": RBF(2.0), "beta": 3.0},
        X,
        Y,
        ["beta=3.0", "RBF(length_scale=2)", "beta=None", "kernel__length_scale"],
    ),
    "beta with a sum": (
        {"kernel": RBF() + RBF(), "beta": 3.0},
        X,
        Y,
        ["beta=3.0", "RBF(length_scale=1) + RBF(", "beta=None", "k2__length_scale"],
    ),
    "alpha negative": ({"alpha": -1e-3}, X, Y, ["alpha", "non-negative", "-0.001"]),
    "alpha true": ({"alpha": True}, X, Y, ["alpha", "number", "got True"]),
    "Wendland in too many dimensions": (
        {"kernel": Wendland(dimension=1)},
        X,
        Y,
        ["dimension=1", "2 features", "at least 2"],
    ),
    "Wendland in no dimension": (
        {"kernel": Wendland(dimension=2.5)},
        X,
        Y,
        ["dimension", "integer", "got 2.5"],
    ),
    "alpha nan": ({"alpha": np.nan}, X, Y, ["alpha", "finite", "got nan"]),
    "alpha of a list": ({"alpha": [1.0]}, X, Y, ["alpha", "number", "got [1.0]"]),
    "kernel unknown": (
        {"kernel": "matern"},
        X,
        Y,
        ["kernel", "got 'matern'", "matern32", "gaussian"],
    ),
    "kernel of no kind": ({"kernel": 3}, X, Y, ["kernel", "got 3", "matern32"]),
    "method unknown": ({"method": "lstsq"}, X, Y, ["method", "'lstsq'", "least_sq"]),
    "trend unknown": ({"trend": "cubic"}, X, Y, ["trend", "'cubic'", "'linear'"]),
    "solver unknown": ({"solver": "cg"}, X, Y, ["solver", "'cg'", "'cholesky'"]),
    "centers unknown": (
        {"centers": "kmeans"},
        X,
        Y,
        ["centers", "'kmeans'", "'precomputed'", "selector"],
    ),
    "centers as a class": (
        {"centers": KMeans},
        X,
        Y,
        ["centers", "KMeans", "an instance"],
    ),
    "centers of another dimension": (
        {"centers": np.zeros((3, 5))},
        X,
        Y,
        ["centers has 5 features", "X has 2"],
    ),
    "centers with nan": ({"centers": NAN[:9]}, X, Y, ["centers contains NaN"]),
    "centers without cluster_centers_": (
        {"centers": DBSCAN()},
        X,
        Y,
        ["centers=DBSCAN()", "cluster_centers_", "SeparatedCenterSelector"],
    ),
    "interpolation off the rows": (
        {"centers": X[:4] + 0.1},
        X,
        Y,
        ["4 of 4 centres", "centers=ndarray", "method='least_squares'"],
    ),
    "interpolation on KMeans": (
        {"centers": KMeans(4, n_init=1, random_state=0)},
        X,
        Y,
        ["centers=KMeans", "of 4 centres", "method='least_squares'"],
    ),
    "least squares with too few rows": (
        {"centers": X, "method": "least_squares"},
        X[:20],
        Y[:20],
        ["method='least_squares'", "20 rows", "30 centres", "alpha > 0"],
    ),
    "conflicting outputs of equal rows": (
        {},
        TWICE,
        np.append(Y, [Y[4], Y[5] + 1]),
        ["rows 5 and 31", "alpha > 0", "least_squares", "delays"],
    ),
    "selector's separation negative": (
        {"centers": SeparatedCenterSelector(-0.1)},
        X,
        Y,
        ["separation", "non-negative", "got -0.1"],
    ),
    "precomputed without zeros": (
        {"centers": "precomputed", "beta": 1.0},
        DISTANCES[5:],
        Y[5:],
        ["centers='precomputed'", "5 of 30", "SeparatedCenterSelector"],
    ),
    "precomputed with negative entries": (
        {"centers": "precomputed", "beta": 1.0},
        X,
        Y,
        ["X holds", "centers='precomputed'", "distances", "transform"],
    ),
    "precomputed with linear trend": (
        {"centers": "precomputed", "trend": "linear"},
        DISTANCES,
        Y,
        ["trend='linear'", "centers='precomputed'", "SeparatedCenterSelector"],
    ),
    "precomputed with a kernel of more than distances": (
        {"centers": "precomputed", "kernel": DotProduct()},
        DISTANCES,
        Y,
        ["kernel=DotProduct", "distances", "centers='precomputed'"],
    ),
    "precomputed with a scale for each feature": (
        {"centers": "precomputed", "kernel": RBF([1.0, 2.0])},
        DISTANCES,
        Y,
        ["kernel=RBF", "distances", "centers='precomputed'"],
    ),
    "X with nan": ({}, NAN, Y, ["Input X contains NaN"]),
    "X infinite": ({}, INF, Y, ["Input X contains infinity"]),
    "y with nan": ({}, X, np.append(Y[1:], np.nan), ["Input y contains NaN"]),
    "X of one dimension": ({}, X[:, 0], Y, ["Expected 2D array", "reshape"]),
    "X of three dimensions": ({}, X[None], Y, ["dim 3"]),
    "lengths that differ": ({}, X, Y[:29], ["inconsistent", "[30, 29]"]),
    "no rows": ({}, X[:0], Y[:0], ["0 sample(s)"]),
    "no features": ({}, X[:, :0], Y, ["0 feature(s)"]),
    "text": ({}, np.full((30, 2), "a"), Y, ["could not convert string to float"]),
    "complex": ({}, X * 1j, Y, ["Complex data not supported"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    parameters, states, outputs, said = REFUSED[case]
    model = KoopmanKernelRegressor(**parameters)
    with pytest.raises(ValueError) as error:
        model.fit(states, outputs)
    for part in said:
        assert part in str(error.value)
    # Nothing is half-fitted.
    assert not [name for name in vars(model) if name.endswith("_")]
    with pytest.raises(NotFittedError):
        model.predict(states)


def test_a_fit_that_fails_leaves_the_former_one():
    model = KoopmanKernelRegressor().fit(X, Y)
    with pytest.raises(ValueError, match="beta"):
        model.set_params(beta=-1.0).fit(X[:, :1], Y)
    assert_allclose(model.predict(X), Y, atol=1e-10)
    selector = SeparatedCenterSelector().fit(X)
    with pytest.raises(ValueError, match="separation"):
        selector.set_params(separation=-1.0).fit(X[:, :1])
    assert selector.transform(X).shape == (30, len(selector.center_indices_))


@pytest.mark.parametrize("factor", [1e-200, 1e-30, 1e30, 1e200])
def test_any_unit_of_the_states(factor):
    """beta in the same unit gives the same estimate."""
    model = KoopmanKernelRegressor(beta=factor, trend="linear").fit(factor * X, Y)
    usual = KoopmanKernelRegressor(beta=1.0, trend="linear").fit(X, Y)
    new = X[:5] + 0.3
    assert_allclose(model.predict(factor * new), usual.predict(new), rtol=1e-6)
    assert_allclose(
        model.power_function(factor * new), usual.power_function(new), rtol=1e-6
    )


@pytest.mark.parametrize("factor", [1e-100, 1e-30, 1e30, 1e100])
def test_any_unit_of_the_outputs(factor):
    options = {"trend": "linear", "method": "least_squares"}
    centers = SeparatedCenterSelector(0.5)
    model = KoopmanKernelRegressor(centers=centers, **options).fit(X, factor * Y)
    usual = KoopmanKernelRegressor(centers=centers, **options).fit(X, Y)
    for scaled, plain in zip(
        model.predict(X + 0.3, return_std=True),
        usual.predict(X + 0.3, return_std=True),
        strict=True,
    ):
        assert_allclose(scaled / factor, plain)


@pytest.mark.parametrize("method", ["interpolation", "least_squares"])
@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_one_sample(method, trend):
    model = KoopmanKernelRegressor(method=method, trend=trend).fit([[1.0, 2.0]], [5.0])
    assert_allclose(model.predict([[1.0, 2.0]]), [5.0])
    far = {None: 0.0, "constant": 5.0, "linear": 5.0}[trend]
    assert_allclose(model.predict([[1e3, 0.0]]), [far], atol=1e-12)


@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_more_features_than_samples(trend):
    wide = RNG.standard_normal((5, 40))
    model = KoopmanKernelRegressor("wendland_c2", beta=20.0, trend=trend)
    assert_allclose(model.fit(wide, Y[:5]).predict(wide), Y[:5], atol=1e-10)


@pytest.mark.parametrize("trend", [None, "constant", "linear"])
def test_constant_features_change_nothing(trend):
    more = np.column_stack([X, np.full(30, 3.3), np.zeros(30)])
    model = KoopmanKernelRegressor(trend=trend).fit(more, Y)
    usual = KoopmanKernelRegressor(trend=trend).fit(X, Y)
    assert_allclose(
        model.predict(more + np.array([0.3, 0.3, 0, 0])), usual.predict(X + 0.3)
    )


def test_constant_output():
    model = KoopmanKernelRegressor(trend="constant").fit(X, np.full(30, 4.0))
    mean, std = model.predict(X + 5.0, return_std=True)
    assert_allclose(mean, 4.0)
    assert_allclose(std, 0.0, atol=1e-12)
    zero = KoopmanKernelRegressor().fit(X, np.zeros(30))
    assert_array_equal(zero.predict(X + 0.1), np.zeros(30))


def test_all_rows_equal():
    same = np.ones((10, 2))
    model = KoopmanKernelRegressor(alpha=0.1).fit(same, np.arange(10.0))
    assert len(model.centers_) == 1
    assert_allclose(model.predict(same[:1]), 45 / 10.1)


def test_equal_rows_with_equal_outputs_are_one_centre():
    model = KoopmanKernelRegressor().fit(TWICE, np.append(Y, Y[4:6]))
    assert_array_equal(model.center_indices_, np.arange(30))
    assert_allclose(model.predict(X), Y, atol=1e-10)


def test_least_squares_with_fewer_rows_than_centres_and_alpha():
    """The representer in the span: unique, and close to the outputs."""
    model = KoopmanKernelRegressor(centers=X, method="least_squares", alpha=1e-8)
    assert_allclose(model.fit(X[:20], Y[:20]).predict(X[:20]), Y[:20], atol=1e-4)


def test_integers_booleans_and_lists_are_numbers():
    grid = [[0, 0], [1, 0], [0, 1], [1, 1]]
    model = KoopmanKernelRegressor(beta=1).fit(grid, [False, True, True, False])
    assert_allclose(model.predict(grid), [0, 1, 1, 0], atol=1e-12)


def test_float32_is_computed_in_double():
    single = X.astype(np.float32)
    model = KoopmanKernelRegressor().fit(single, Y)
    assert model.centers_.dtype == model.dual_coef_.dtype == np.float64
    double = KoopmanKernelRegressor().fit(single.astype(np.float64), Y)
    assert_array_equal(model.predict(single), double.predict(single))


@pytest.mark.parametrize(
    ("centers", "message"),
    [
        (None, "X has 3 features, but KoopmanKernelRegressor is expecting 2"),
        ("precomputed", "X has 3 features, but KoopmanKernelRegressor is expecting 30"),
    ],
)
def test_prediction_of_another_dimension(centers, message):
    states = X if centers is None else DISTANCES
    model = KoopmanKernelRegressor(beta=1.0, centers=centers).fit(states, Y)
    for method in (model.predict, model.power_function):
        with pytest.raises(ValueError, match=message):
            method(np.zeros((1, 3)))


def test_prediction_from_negative_distances():
    model = KoopmanKernelRegressor(beta=1.0, centers="precomputed").fit(DISTANCES, Y)
    with pytest.raises(ValueError, match=r"X holds -1.*distances"):
        model.predict(DISTANCES - 1)


def test_a_row_dropped_behind_the_selector_is_named():
    """Distances from one fold, rows from another: a usual slip."""
    pipeline = make_pipeline(
        StandardScaler(),
        SeparatedCenterSelector(0.1),
        KoopmanKernelRegressor(beta=1.0, centers="precomputed"),
    ).fit(X, Y)
    distances = pipeline[:-1].transform(X)
    with pytest.raises(ValueError, match=re.escape("Rows left out after the selector")):
        KoopmanKernelRegressor(beta=1.0, centers="precomputed").fit(
            distances[1:], Y[1:]
        )
