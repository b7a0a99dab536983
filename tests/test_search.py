"""Pipelines, grid searches and metadata routing, as users combine them."""

import numpy as np
import pytest
import sklearn
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
)
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.kernels import Gaussian, MaternSobolev

# Some states here are far from few centres on purpose.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")

METHODS = ["interpolation", "least_squares"]


@pytest.fixture(scope="module")
def pendulums():
    start = np.column_stack([np.zeros(5), np.linspace(0.5, 2.2, 5)])
    return make_pendulum(n_samples=50, initial=start, noise=0.01, random_state=0)


def inside(**options):
    return Pipeline(
        [
            ("scale", StandardScaler()),
            (
                "koopman",
                KoopmanKernelRegressor(
                    centers=SeparatedCenterSelector(0.1),
                    alpha=1e-4,
                    beta=1.0,
                    **options,
                ),
            ),
        ]
    )


def in_front(**options):
    return Pipeline(
        [
            ("scale", StandardScaler()),
            ("centers", SeparatedCenterSelector(0.1)),
            (
                "koopman",
                KoopmanKernelRegressor(
                    centers="precomputed", alpha=1e-4, beta=1.0, **options
                ),
            ),
        ]
    )


@pytest.mark.parametrize("order", ["sequential", "farthest"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kernel", ["matern32", "wendland_c4", "inverse_multiquadric"])
def test_both_spellings_predict_the_same(pendulums, kernel, method, order):
    one, two = (make(kernel=kernel, method=method) for make in (inside, in_front))
    one.set_params(koopman__centers__order=order)
    two.set_params(centers__order=order)
    one.fit(pendulums.X, pendulums.y)
    two.fit(pendulums.X, pendulums.y)
    new = make_pendulum(n_samples=50, initial=(0.3, 1.7)).X
    assert_allclose(one.predict(new), two.predict(new), rtol=0, atol=1e-10)


@pytest.mark.parametrize("routing", [pytest.param(False, marks=pytest.mark.slow), True])
def test_grid_search_leaves_out_trajectories(pendulums, routing):
    grid = {
        "centers__separation": [0.1, 0.4],
        "koopman__kernel": ["matern32", "wendland_c4"],
        "koopman__beta": [2.0, 6.0],
    }
    nested = {
        "koopman__" + name.removeprefix("koopman__"): values
        for name, values in grid.items()
    }
    with sklearn.config_context(enable_metadata_routing=routing):
        searches = [
            GridSearchCV(
                estimator,
                parameters,
                cv=TrajectoryKFold(5),
                scoring="neg_root_mean_squared_error",
                n_jobs=2,
            ).fit(pendulums.X, pendulums.y, groups=pendulums.groups)
            for estimator, parameters in ((inside(), nested), (in_front(), grid))
        ]
    scores = [
        {
            tuple(parameters[name] for name in sorted(parameters)): score
            for parameters, score in zip(
                search.cv_results_["params"],
                search.cv_results_["mean_test_score"],
                strict=True,
            )
        }
        for search in searches
    ]
    # beta, separation, kernel in the one; separation, beta, kernel in the other.
    for (beta, separation, kernel), score in scores[0].items():
        assert_allclose(score, scores[1][separation, beta, kernel], rtol=1e-8)
    # One candidate, by hand, leaving out one trajectory after the other.
    best = clone(inside()).set_params(**searches[0].best_params_)
    errors = []
    for trajectory in range(5):
        left_out = pendulums.groups == trajectory
        best.fit(pendulums.X[~left_out], pendulums.y[~left_out])
        residual = best.predict(pendulums.X[left_out]) - pendulums.y[left_out]
        errors.append(np.sqrt(np.mean(residual**2)))
    assert_allclose(-searches[0].best_score_, np.mean(errors), rtol=1e-9)


def test_kernel_objects_and_their_scales_are_searched(pendulums):
    search = GridSearchCV(
        KoopmanKernelRegressor(centers=SeparatedCenterSelector(0.1), alpha=1e-3),
        [
            {"kernel": [MaternSobolev(nu=2.5)], "kernel__beta": [0.01, 2.0]},
            {"kernel": [Gaussian()], "beta": [0.01]},
        ],
        cv=TrajectoryKFold(5),
    ).fit(pendulums.X, pendulums.y, groups=pendulums.groups)
    assert search.best_params_["kernel__beta"] == 2.0
    assert search.best_estimator_.kernel_ == MaternSobolev(2.0, 2.5)


def test_centers_of_both_kinds_in_one_search(pendulums):
    """`centers__separation` needs a selector in the same entry of the grid."""
    search = GridSearchCV(
        KoopmanKernelRegressor(alpha=1e-3, beta=2.0),
        [
            {"centers": [None]},
            {"centers": [SeparatedCenterSelector()], "centers__separation": [0.1, 0.9]},
        ],
        cv=TrajectoryKFold(5),
    ).fit(pendulums.X, pendulums.y, groups=pendulums.groups)
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()
    assert len(set(search.cv_results_["mean_test_score"])) == 3


def test_shuffled_rows_flatter(pendulums):
    """Which is why there is TrajectoryKFold."""
    model = KoopmanKernelRegressor("matern52", beta=3.0)
    exact = make_pendulum(n_samples=50, initial=pendulums.X[::50])

    def error(cv, groups):
        return -cross_val_score(
            model,
            exact.X,
            exact.y,
            cv=list(cv.split(exact.X, exact.y, groups)),
            scoring="neg_root_mean_squared_error",
        ).mean()

    shuffled = error(KFold(5, shuffle=True, random_state=0), None)
    assert error(TrajectoryKFold(5), exact.groups) > 10 * shuffled


def test_cross_validation_refits_the_selector_on_each_fold(pendulums):
    """The centres of a fold are rows of that fold, whatever was fitted before."""
    model = in_front().fit(pendulums.X, pendulums.y)
    before = model["centers"].center_indices_.copy()
    scores = cross_val_score(
        model, pendulums.X, pendulums.y, groups=pendulums.groups, cv=TrajectoryKFold(5)
    )
    assert (scores > 0.8).all()
    assert_array_equal(model["centers"].center_indices_, before)
