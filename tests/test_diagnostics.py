"""Diagnostics against brute force, closed forms and known limits."""

import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from reference import kernel_matrix
from scipy.spatial.distance import cdist, pdist
from scipy.stats import norm as normal
from scipy.stats import t as student
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.compose import make_column_transformer
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    Exponentiation,
    ExpSineSquared,
    Matern,
    RationalQuadratic,
    WhiteKernel,
)
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, GroupKFold, KFold
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
)
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.diagnostics import (
    calibration_study,
    condition_number,
    conditioning_study,
    convergence_study,
    crowding_study,
    digits_lost,
    fill_distance,
    intrinsic_dimension,
    mesh_ratio,
    separation_distance,
    smallest_eigenvalue,
    sobolev_rates,
)
from sklearn_koopman.diagnostics._conditioning import extreme_eigenvalues
from sklearn_koopman.diagnostics._studies import above_rounding
from sklearn_koopman.kernels import KERNELS, MaternSobolev, Wendland

TURN = 2 * np.pi


def embed(angles):
    """Angles to the circle in R^2, or pairs of angles to the flat torus in R^4."""
    angles = np.reshape(angles, (len(angles), -1))
    return np.hstack([np.cos(angles), np.sin(angles)])


def arcs(angles, others):
    """Distances along the circle or the flat torus."""
    angles, others = (np.reshape(a, (len(a), -1)) for a in (angles, others))
    apart = np.abs(angles[:, np.newaxis] - others) % TURN
    return np.sqrt(np.square(np.minimum(apart, TURN - apart)).sum(axis=2))


def smallest(distances):
    return (distances + np.diag(np.full(len(distances), np.inf))).min()


def lift(points, seed=0):
    """Rotate points into R^10."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((10, 10)))
    return np.pad(points, ((0, 0), (0, 10 - points.shape[1]))) @ Q


# --- Fill and separation distance ----------------------------------------------------


@pytest.mark.parametrize("d", range(1, 7))
def test_distances_are_those_of_brute_force(d):
    rng = np.random.default_rng(d)
    centers, reference = rng.standard_normal((40, d)), rng.standard_normal((700, d))
    fill = cdist(reference, centers).min(axis=1).max()
    separation = pdist(centers).min() / 2
    assert fill_distance(centers, reference) == pytest.approx(fill, rel=1e-12)
    assert separation_distance(centers) == pytest.approx(separation, rel=1e-12)
    assert mesh_ratio(centers, reference) == pytest.approx(fill / separation, rel=1e-12)
    # Each centre may be anywhere; the farther half of the story is the reference's.
    outside = np.vstack([centers, np.full((1, d), 1e3)])
    assert fill_distance(outside, reference) == pytest.approx(fill, rel=1e-12)
    one = cdist(reference, centers[:1]).max()
    assert fill_distance(centers[:1], reference) == pytest.approx(one, rel=1e-12)


def test_fill_distance_goes_through_all_batches():
    reference = np.zeros((200_000, 1))
    for row in (0, 65_535, 65_536, 199_999):
        moved = reference.copy()
        moved[row] = 3.0
        assert fill_distance([[0.5], [-1.0]], moved) == 2.5


@pytest.mark.parametrize("metric", ["euclidean", "geodesic"])
def test_distances_of_equal_and_single_centres(metric):
    reference = np.arange(10.0).reshape(-1, 1)
    options = {"metric": metric}
    assert separation_distance([[3.0], [1.0], [3.0]], reference, **options) == 0
    assert mesh_ratio([[3.0], [3.0]], reference, **options) == np.inf
    assert fill_distance([[3.0], [3.0]], reference, **options) == 6
    assert separation_distance([[3.0]], reference, **options) == np.inf
    assert mesh_ratio([[3.0]], reference, **options) == 0
    assert fill_distance([[3.0]], [[3.0]], **options) == 0
    assert fill_distance([[3, 4]], [[0, 0]], **options) == 5  # integers


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_distances_have_the_unit_of_the_states(scale):
    rng = np.random.default_rng(0)
    reference = rng.standard_normal((400, 2))
    reference /= np.hypot(*reference.T)[:, np.newaxis]
    for metric in ("euclidean", "geodesic"):
        for function in (fill_distance, separation_distance):
            value = function(reference[:9], reference, metric=metric)
            scaled = function(scale * reference[:9], scale * reference, metric=metric)
            assert scaled == pytest.approx(scale * value, rel=1e-9)


@pytest.mark.parametrize("order", ["sequential", "farthest"])
@pytest.mark.parametrize("d", [1, 2, 4])
def test_the_selector_agrees_and_is_quasi_uniform(order, d):
    rng = np.random.default_rng(d)
    X = np.cumsum(rng.standard_normal((1500, d)), axis=0) / 10
    for separation in (0.2, 0.5):
        selector = SeparatedCenterSelector(separation, order=order).fit(X)
        centers = selector.cluster_centers_
        fill, gap = fill_distance(centers, X), separation_distance(centers)
        assert fill == pytest.approx(selector.fill_distance_, rel=1e-12)
        assert gap == pytest.approx(selector.separation_distance_, rel=1e-12)
        assert fill <= separation < 2 * gap
        assert 0.5 < mesh_ratio(centers, X) <= 2


def test_distances_take_frames_and_lists():
    rng = np.random.default_rng(1)
    centers, reference = rng.standard_normal((8, 3)), rng.standard_normal((200, 3))
    fill = fill_distance(centers, reference)
    assert fill_distance(pd.DataFrame(centers), pd.DataFrame(reference)) == fill
    assert fill_distance(centers.tolist(), reference.tolist()) == fill


def test_distances_refuse_what_they_cannot_measure():
    X = np.random.default_rng(0).standard_normal((30, 2))
    for function in (fill_distance, mesh_ratio):
        with pytest.raises(ValueError, match=r"2 features, but reference has 3"):
            function(X, np.ones((5, 3)))
        with pytest.raises(
            ValueError, match="metric must be one of 'euclidean', 'geodesic'"
        ):
            function(X, X, metric="manhattan")
        with pytest.raises(ValueError, match="geodesic' only"):
            function(X, X, n_neighbors=5)
        for n_neighbors in (0, -1, 2.0, True, "many"):
            with pytest.raises(ValueError, match="n_neighbors must be an integer"):
                function(X, X, metric="geodesic", n_neighbors=n_neighbors)
        with pytest.raises(ValueError, match="reference contains NaN"):
            function(X, np.full((5, 2), np.nan))
        with pytest.raises(ValueError, match=r"rescale centers"):
            function(X * 1e160, X)
    with pytest.raises(ValueError, match="needs reference"):
        separation_distance(X, metric="geodesic")
    with pytest.raises(ValueError, match="centers contains NaN"):
        separation_distance([[np.nan], [0.0]])


# --- Along the manifold --------------------------------------------------------------

ROTATION = TURN * (np.sqrt(5) - 1) / 2


@pytest.mark.parametrize(
    "angles",
    [
        np.linspace(0, TURN, 60, endpoint=False),
        np.linspace(0, TURN, 1000, endpoint=False),
        pytest.param(
            np.linspace(0, TURN, 5000, endpoint=False), marks=pytest.mark.slow
        ),
        np.random.default_rng(0).permutation(np.linspace(0, TURN, 999)),
        np.random.default_rng(1).uniform(0, TURN, 200),
        pytest.param(
            np.random.default_rng(2).uniform(0, TURN, 3000), marks=pytest.mark.slow
        ),
        ROTATION * np.arange(1000),
        0.1 * np.arange(1000),  # 16 turns
        0.01 * np.arange(940),  # one turn and a half
        0.01 * np.arange(5000),
        0.001 * np.arange(5000),  # four fifths of one turn: an arc
    ],
    ids=[
        "ordered 60",
        "ordered 1000",
        "ordered 5000",
        "shuffled",
        "random 200",
        "random 3000",
        "rotation",
        "turns",
        "one turn and a half",
        "finely sampled turns",
        "arc",
    ],
)
@pytest.mark.parametrize("separation", [1.5, 0.4])
def test_geodesic_distances_on_the_circle_are_arcs(angles, separation):
    X = embed(angles)
    rows = SeparatedCenterSelector(separation).fit(X).center_indices_
    open_ended = np.ptp(angles) < 6
    away = arcs(angles, angles[rows])
    between = arcs(angles[rows], angles[rows])
    if open_ended:  # no way through the gap
        away = np.abs(np.subtract.outer(angles, angles[rows]))
        between = away[rows]
    fill, gap = away.min(axis=1).max(), smallest(between) / 2
    options = {"metric": "geodesic"}
    assert fill_distance(X[rows], X, **options) == pytest.approx(fill, rel=0.02)
    assert separation_distance(X[rows], X, **options) == pytest.approx(gap, rel=0.02)
    assert mesh_ratio(X[rows], X, **options) == pytest.approx(fill / gap, rel=0.03)
    # Chords are shorter, as they should be.
    chord = 2 * np.sin(min(fill, np.pi) / 2)
    if not open_ended:
        assert fill_distance(X[rows], X) == pytest.approx(chord, rel=1e-9)


@pytest.mark.parametrize(
    "n_samples", [1000, pytest.param(5000, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("shuffled", [False, True])
def test_geodesic_does_not_jump_the_gap_of_a_c(n_samples, shuffled):
    angles = np.linspace(0.1, TURN - 0.1, n_samples)
    ends = embed(angles[[0, -1]])
    if shuffled:
        angles = np.random.default_rng(0).permutation(angles)
    C, length = embed(angles), TURN - 0.2
    options = {"metric": "geodesic"}
    assert fill_distance(ends[:1], C) < 2.01
    assert fill_distance(ends[:1], C, **options) == pytest.approx(length, rel=0.01)
    assert separation_distance(ends) == pytest.approx(np.sin(0.1))
    assert separation_distance(ends, C, **options) == pytest.approx(
        length / 2, rel=0.01
    )
    # With neighbourhoods as wide as the gap it does, as documented.
    wide = n_samples // 8
    assert fill_distance(ends[:1], C, **options, n_neighbors=wide) < 0.6 * length


def test_geodesic_follows_a_helix_around_the_turns():
    time = np.linspace(0, 4 * TURN, 4000)
    helix = np.column_stack([embed(time), 0.2 * time])
    length = 4 * TURN * np.hypot(1, 0.2)
    options = {"metric": "geodesic"}
    assert fill_distance(helix[:1], helix) < 0.25 * length
    assert fill_distance(helix[:1], helix, **options) == pytest.approx(length, rel=0.01)
    two = helix[[0, 1000]]  # one turn apart
    assert separation_distance(two, helix, **options) == pytest.approx(
        length / 8, rel=0.01
    )


def test_geodesic_on_the_flat_torus_of_independent_samples():
    rng = np.random.default_rng(3)
    for n_samples, n_centers in ((1500, 5), (4000, 12), (4000, 40)):
        angles = rng.uniform(0, TURN, (n_samples, 2))
        centers, X = embed(angles[:n_centers]), embed(angles)
        fill = arcs(angles, angles[:n_centers]).min(axis=1).max()
        assert fill_distance(centers, X) < 0.96 * fill
        assert fill_distance(centers, X, metric="geodesic") == pytest.approx(
            fill, rel=0.03
        )
        gap = smallest(arcs(angles[:n_centers], angles[:n_centers])) / 2
        assert separation_distance(centers, X, metric="geodesic") == pytest.approx(
            gap, rel=0.05
        )


@pytest.mark.parametrize("frequency", [np.sqrt(2), (1 + np.sqrt(5)) / 2])
@pytest.mark.parametrize(("n_samples", "step"), [(2000, 0.1), (5000, 0.05)])
def test_geodesic_on_the_flat_torus_of_a_winding_trajectory(n_samples, step, frequency):
    angles = step * np.arange(n_samples)[:, np.newaxis] * [1, frequency]
    rows = np.random.default_rng(4).choice(n_samples, 12, replace=False)
    fill = arcs(angles, angles[rows]).min(axis=1).max()
    X = embed(angles)
    assert fill_distance(X[rows], X) < 0.95 * fill
    assert fill_distance(X[rows], X, metric="geodesic") == pytest.approx(fill, rel=0.05)


def test_geodesic_warns_where_paths_follow_the_trajectory_and_says_what_to_do():
    angles = 0.01 * np.arange(5000)[:, np.newaxis] * [1, np.sqrt(2)]
    rows = np.random.default_rng(5).choice(5000, 12, replace=False)
    X = embed(angles)
    fill = arcs(angles, angles[rows]).min(axis=1).max()
    with pytest.warns(UserWarning, match="paths follow the trajectory") as caught:
        followed = fill_distance(X[rows], X, metric="geodesic")
    assert followed > 2 * fill
    separation = float(re.findall(r"Selector\(([\d.]+)\)", str(caught[0].message))[0])
    thinned = X[SeparatedCenterSelector(separation).fit(X).center_indices_]
    assert 100 < len(thinned) < 1000
    found = fill_distance(X[rows], thinned, metric="geodesic")
    assert found == pytest.approx(fill, rel=0.05)


def test_geodesic_needs_a_centre_on_every_part():
    angles = np.linspace(0, TURN, 300, endpoint=False)
    X = np.vstack([embed(angles), embed(angles) + np.array([10.0, 0.0])])
    options = {"metric": "geodesic"}
    with pytest.raises(ValueError, match=r"300 of 600 points have no path"):
        fill_distance(X[:1], X, **options)
    both = X[[0, 400]]
    assert fill_distance(both, X, **options) == pytest.approx(np.pi, rel=0.01)
    assert separation_distance(both, X, **options) == np.inf
    assert separation_distance(both, X) == pytest.approx(cdist(*both[:, None]) / 2)


def test_geodesic_reaches_points_that_are_nobodys_neighbour():
    """Each of them has neighbours, though."""
    X = np.append(np.linspace(0, 1, 101), [3.0, -4.0]).reshape(-1, 1)
    options = {"metric": "geodesic", "n_neighbors": 6}
    assert fill_distance([[0.5]], X, **options) == pytest.approx(4.5)
    assert fill_distance([[-4.0]], X, **options) == pytest.approx(7.0)
    ends = [[-4.0], [3.0]]
    assert separation_distance(ends, X, **options) == pytest.approx(3.5)


def test_geodesic_with_all_neighbours_is_euclidean():
    rng = np.random.default_rng(6)
    X = rng.standard_normal((80, 3))
    options = {"metric": "geodesic", "n_neighbors": 10**6}
    assert fill_distance(X[:5], X, **options) == pytest.approx(fill_distance(X[:5], X))
    assert separation_distance(X[:5], X, **options) == pytest.approx(
        separation_distance(X[:5])
    )
    # Centres need not be among the reference, nor the reference distinct.
    away = rng.standard_normal((5, 3))
    assert fill_distance(away, np.repeat(X, 3, axis=0), **options) == pytest.approx(
        fill_distance(away, X)
    )


# --- Intrinsic dimension -------------------------------------------------------------


def covered(estimates, dimension):
    """How far off estimates are, in standard errors."""
    value, error = np.transpose(estimates)
    return np.abs(value - dimension) / error


@pytest.mark.parametrize("step", [0.3, 0.1, 0.05, 0.02])
@pytest.mark.parametrize("n_samples", [256, 2000])
def test_the_pendulum_moves_on_a_curve(n_samples, step):
    """From one coarse turn and many to a part of one, finely sampled."""
    X = make_pendulum(n_samples, step=step).X
    estimate = intrinsic_dimension(X)
    assert covered([estimate], 1) < 2.5
    assert abs(estimate[0] - 1) < 0.2
    assert estimate[1] < 0.25


@pytest.mark.slow
def test_error_bars_cover_on_a_torus_in_ten_dimensions():
    rng = np.random.default_rng(0)
    estimates = np.array(
        [
            intrinsic_dimension(lift(embed(rng.uniform(0, TURN, (n_samples, 2)))))
            for n_samples in [2000] * 15 + [500] * 15
        ]
    )
    assert (covered(estimates, 2) < 2.5).all()
    assert estimates[:15, 0].mean() == pytest.approx(2, abs=0.1)
    assert estimates[:, 1].max() < 0.4
    # They are not much wider than they have to be.
    assert estimates[:15, 1].mean() < 4 * estimates[:15, 0].std()


@pytest.mark.parametrize("frequency", [np.sqrt(2), (1 + np.sqrt(5)) / 2])
@pytest.mark.parametrize(
    ("n_samples", "step"), [(1000, 0.2), (2000, 0.05), (5000, 0.02), (10_000, 0.01)]
)
def test_a_winding_trajectory_fills_the_torus(n_samples, step, frequency):
    angles = step * np.arange(n_samples)[:, np.newaxis] * [1, frequency]
    X = lift(embed(angles))
    estimate = intrinsic_dimension(X)
    assert covered([estimate], 2) < 2.5
    assert abs(estimate[0] - 2) < 0.3
    assert estimate[1] < 0.2


@pytest.mark.parametrize(("n_samples", "step"), [(5000, 0.005), (10_000, 0.003)])
def test_neighbours_in_time_do_not_make_a_torus_a_curve(n_samples, step):
    """A hundred samples and more lie on one passage before the next one is as near."""
    angles = step * np.arange(n_samples)[:, np.newaxis] * [1, np.sqrt(2)]
    estimate = intrinsic_dimension(lift(embed(angles)))
    assert abs(estimate[0] - 2) < 0.3
    assert covered([estimate], 2) < 2.5


def test_dimension_of_curves_lines_and_a_three_torus():
    rng = np.random.default_rng(1)
    # The constant is exact where the density does not vary.
    circles = [intrinsic_dimension(embed(rng.uniform(0, 9, 600))) for _ in range(40)]
    assert np.mean(circles, axis=0)[0] == pytest.approx(1, abs=0.03)
    assert (covered(circles, 1) < 2.5).all()
    line = intrinsic_dimension(np.arange(500).reshape(-1, 1))
    assert covered([line], 1) < 2.5
    torus = intrinsic_dimension(lift(embed(rng.uniform(0, TURN, (4000, 3)))))
    assert torus[0] == pytest.approx(3, abs=0.4)
    assert covered([torus], 3) < 3


def test_dimension_does_not_depend_on_units_or_axes():
    rng = np.random.default_rng(2)
    X = embed(rng.uniform(0, TURN, (400, 2)))
    estimate = intrinsic_dimension(X)
    for moved in (1e-8 * X, 1e8 * X, X + 5.0, lift(X), np.repeat(X, 3, axis=0)):
        assert_allclose(intrinsic_dimension(moved), estimate, rtol=1e-6)
    assert intrinsic_dimension(pd.DataFrame(X)) == estimate


def test_dimension_is_reproducible():
    X = np.random.default_rng(3).standard_normal((300, 3))
    assert intrinsic_dimension(X) == intrinsic_dimension(X)
    seeded = intrinsic_dimension(X, random_state=1)
    assert seeded != intrinsic_dimension(X)
    assert seeded == intrinsic_dimension(X, random_state=np.random.RandomState(1))
    assert abs(seeded[0] - intrinsic_dimension(X)[0]) < 1


def test_dimension_is_a_matter_of_scale():
    """Noise fills all dimensions below its size, and few points look beyond it."""
    rng = np.random.default_rng(4)
    X = lift(embed(rng.uniform(0, TURN, 2000)))
    X += 0.01 * rng.standard_normal(X.shape)
    fine = intrinsic_dimension(X, n_points=2000)
    coarse = intrinsic_dimension(X, n_points=50)
    assert fine[0] > 4
    assert covered([coarse], 1) < 2.5
    assert coarse[0] < 1.4
    # That it is one, the standard error says.
    assert fine[1] > 1


def test_dimension_refuses_what_is_too_little():
    X = np.random.default_rng(5).standard_normal((100, 2))
    for few in (X[:35], np.repeat(X[:35], 9, axis=0), np.ones((500, 2))):
        with pytest.raises(ValueError, match=r"distinct rows, .* dimension needs 36;"):
            intrinsic_dimension(few)
    assert np.isfinite(intrinsic_dimension(X[:36])).all()
    for n_points in (17, 18.0, True):
        with pytest.raises(ValueError, match="n_points must be an integer of at least"):
            intrinsic_dimension(X, n_points=n_points)
    with pytest.raises(ValueError, match="n_points=101 is more than the 100"):
        intrinsic_dimension(X, n_points=101)
    with pytest.raises(ValueError, match="X contains NaN"):
        intrinsic_dimension(np.full((100, 2), np.nan))


# --- Conditioning --------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.0, 0.3])
@pytest.mark.parametrize(
    "kernel",
    [
        *KERNELS,
        Matern(0.5, nu=2.5),
        2.0 * RBF(0.2) + WhiteKernel(0.1),
        ConstantKernel(3.0) + Matern([0.5, 0.1], nu=0.5),
    ],
    ids=str,
)
def test_eigenvalues_are_those_of_the_gram_matrix(kernel, alpha):
    X = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    beta, resolved = None, kernel
    if isinstance(kernel, str):
        beta = 0.2 if kernel == "gaussian" else 0.5
        resolved = KERNELS[kernel](beta=beta)
    K = resolved(X) + alpha * np.eye(50)
    options = {"beta": beta, "alpha": alpha}
    number = condition_number(kernel, X, **options)
    assert number == pytest.approx(np.linalg.cond(K), rel=1e-8)
    assert smallest_eigenvalue(kernel, X, **options) == pytest.approx(
        np.linalg.eigvalsh(K)[0], rel=1e-8
    )


@pytest.mark.parametrize("alpha", [0.0, 0.5])
@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_eigenvalues_of_two_points(alpha, scale):
    """They are 1 + alpha plus and minus phi(r)."""
    points = [[0.0], [scale]]
    options = {"beta": 2 * scale, "alpha": alpha}
    phi = np.exp(-1 / 8)
    assert smallest_eigenvalue("gaussian", points, **options) == pytest.approx(
        1 + alpha - phi
    )
    assert condition_number("gaussian", points, **options) == pytest.approx(
        (1 + alpha + phi) / (1 + alpha - phi)
    )
    assert condition_number("gaussian", points[:1], **options) == 1


def test_eigenvalues_of_a_fitted_model():
    data = make_pendulum()
    model = KoopmanKernelRegressor(
        "wendland_c2", beta=3.0, centers=SeparatedCenterSelector(0.23)
    ).fit(data.X, data.y)
    number = condition_number(model.kernel_, model.centers_)
    assert number == pytest.approx(np.linalg.cond(model.kernel_(model.centers_)))
    # The reciprocal condition number of the fit is another, in the 1-norm.
    assert 1 / (37 * model.rcond_) < number < 37 / model.rcond_


@pytest.mark.parametrize("alpha", [0.0, 0.01])
@pytest.mark.parametrize(
    ("kernel", "beta"),
    [
        ("matern12", 1.0),
        ("matern32", 0.5),
        ("wendland_c0", 1.0),
        ("wendland_c2", 1.0),
        ("wendland_c4", 0.3),
        ("wendland_c6", 0.05),
    ],
)
def test_lanczos_agrees_with_the_dense_eigenvalues(kernel, beta, alpha):
    X = np.random.default_rng(1).uniform(-1, 1, (300, 2))
    values = np.linalg.eigvalsh(KERNELS[kernel](beta=beta)(X) + alpha * np.eye(300))
    found = extreme_eigenvalues(kernel, X, beta, alpha, max_dense=20)
    assert_allclose(found, values[[0, -1]], rtol=1e-3)
    assert extreme_eigenvalues(kernel, X, beta, alpha, max_dense=20) == found


@pytest.mark.slow
def test_large_matrices_have_the_condition_number_of_their_eigenvalues():
    """Above the number of centres up to which all eigenvalues are computed."""
    X = np.random.default_rng(1).uniform(-1, 1, (1600, 2))
    values = np.linalg.eigvalsh(KERNELS["wendland_c2"](beta=0.3)(X))
    least = smallest_eigenvalue("wendland_c2", X, beta=0.3)
    assert least == pytest.approx(values[0], rel=2e-3)
    number = condition_number("wendland_c2", X, beta=0.3)
    assert number == pytest.approx(values[-1] / values[0], rel=2e-3)


@pytest.mark.parametrize("max_dense", [20, 1500])
def test_singular_matrices_have_no_eigenvalue_but_zero(max_dense):
    grid = np.linspace(0, 1, 100).reshape(-1, 1)
    twice = np.repeat(grid[:30], 2, axis=0)
    for kernel, points in (
        ("matern12", twice),
        ("gaussian", grid),
        (DotProduct(1.0), grid),
        (ConstantKernel(2.0), grid),
    ):
        assert extreme_eigenvalues(kernel, points, max_dense=max_dense)[0] == 0
        assert condition_number(kernel, points) == np.inf
    least, _ = extreme_eigenvalues("matern12", twice, alpha=0.1, max_dense=max_dense)
    assert least == pytest.approx(0.1)


@pytest.mark.parametrize("max_dense", [20, 1500])
def test_kernels_that_are_not_positive_definite_show(max_dense):
    X = np.random.default_rng(0).standard_normal((40, 3))  # of period in one dimension
    kernel = ExpSineSquared()
    least = np.linalg.eigvalsh(kernel(X))[0]
    assert least < -1
    found, _ = extreme_eigenvalues(kernel, X, max_dense=max_dense)
    assert found == pytest.approx(least, rel=1e-10)
    assert condition_number(kernel, X) == np.inf


@pytest.mark.parametrize(
    ("kernel", "n", "d", "beta", "alpha"),
    [("wendland_c2", 400, 1, 0.016, 0.0), ("gaussian", 400, 2, 0.3, 1e-3)],
)
def test_clustered_eigenvalues_are_found(kernel, n, d, beta, alpha):
    """Flat spectra, and many eigenvalues at alpha: Lanczos vectors hardly converge."""
    X = np.random.default_rng(0).uniform(-1, 1, (n, d))
    X = np.linspace(0, 1, n).reshape(-1, 1) if d == 1 else X
    values = np.linalg.eigvalsh(KERNELS[kernel](beta=beta)(X) + alpha * np.eye(n))
    found = extreme_eigenvalues(kernel, X, beta, alpha, max_dense=20)
    assert_allclose(found, values[[0, -1]], rtol=1e-3)


def test_digits_are_logarithms_of_condition_numbers():
    assert digits_lost(1e6) == pytest.approx(6)
    assert digits_lost(1) == 0
    assert_allclose(digits_lost([[1e3, 1e12]]), [[3, 12]])
    most = -np.log10(np.finfo(float).eps)
    assert_allclose(digits_lost([1e15, 1e17, np.inf]), [15, most, most])
    for number in (0.5, np.nan, [10, -1]):
        with pytest.raises(ValueError, match="condition_number must be >= 1"):
            digits_lost(number)


def test_digits_lost_is_what_a_solution_loses():
    """The perturbation bound, attained by the eigenvectors of the extremes."""
    X = np.linspace(0, 1, 12).reshape(-1, 1)
    K = KERNELS["matern52"](beta=0.5)(X)
    _, vectors = np.linalg.eigh(K)
    u, e = vectors[:, -1], 1e-6 * vectors[:, 0]
    c, moved = np.linalg.solve(K, u), np.linalg.solve(K, u + e)
    loss = np.linalg.norm(moved - c) / np.linalg.norm(c) / 1e-6
    digits = digits_lost(condition_number("matern52", X, beta=0.5))
    assert digits == pytest.approx(np.log10(loss), abs=1e-3)
    assert digits > 4


def test_conditioning_refuses_bad_input():
    X = [[0.0], [1.0]]
    for function in (condition_number, smallest_eigenvalue):
        for alpha in (-1, np.nan, "small"):
            with pytest.raises(ValueError, match="alpha must be a finite"):
                function("gaussian", X, alpha=alpha)
        with pytest.raises(ValueError, match="kernel must be one of"):
            function("gauss", X)
        with pytest.raises(ValueError, match="beta must be a finite positive"):
            function("gaussian", X, beta=0)
        with pytest.raises(ValueError, match="beta=2 scales the kernels of"):
            function(RBF(), X, beta=2)
        with pytest.raises(ValueError, match="centers contains NaN"):
            function("gaussian", [[np.nan], [1.0]])


# --- Rates ---------------------------------------------------------------------------

ORDERS = {
    "matern12": lambda d: 0.5 + d / 2,
    "matern32": lambda d: 1.5 + d / 2,
    "matern52": lambda d: 2.5 + d / 2,
    "wendland_c0": lambda d: (d + 1) / 2,
    "wendland_c2": lambda d: (d + 1) / 2 + 1,
    "wendland_c4": lambda d: (d + 1) / 2 + 2,
    "wendland_c6": lambda d: (d + 1) / 2 + 3,
    "gaussian": lambda d: np.inf,
    "inverse_multiquadric": lambda d: np.inf,
}


@pytest.mark.parametrize("kernel", KERNELS)
def test_rates_are_those_of_the_theorems(kernel):
    for d, m in ((1, 1), (2, 1), (2, 2), (3, 2), (10, 1), (6, 2.5)):
        rates = sobolev_rates(kernel, d, m)
        tau = ORDERS[kernel](d)
        s = tau - (d - m) / 2
        assert rates.tau == tau
        assert rates.s == s
        assert rates.applies is (s > m / 2)
        assert rates.sup_exponent == s - m / 2
        assert rates.rms_exponent == s
        assert rates.condition_exponent == -2 * s
        power = "any power" if np.isinf(s) else f"sup error O(h^{s - m / 2:g})"
        assert power in rates.statement


@pytest.mark.parametrize(("tau", "d", "m"), [(1, 2, 2), (1.2, 3, 2), (2, 4, 1)])
def test_no_rate_where_the_order_is_too_low(tau, d, m):
    rates = sobolev_rates(tau, d, m)
    assert rates.s == pytest.approx(tau - (d - m) / 2)
    assert not rates.applies
    assert np.isnan([rates.sup_exponent, rates.rms_exponent]).all()
    assert "no rate is guaranteed" in rates.statement
    higher = sobolev_rates(tau + 0.6, d, m)
    assert higher.sup_exponent == pytest.approx(tau + 0.6 - d / 2)


def test_orders_of_composed_kernels_are_those_of_their_roughest_part():
    rough, smooth = MaternSobolev(nu=1.5), Wendland(smoothness=6)
    for kernel, tau in (
        (rough + smooth, 2.5),
        (rough * smooth, 2.5),
        (smooth * RBF(), 4.5),
        (4.0 * smooth, 4.5),
        (smooth + 1.0, 4.5),
        (Exponentiation(rough, 2), 2.5),
        (Matern(nu=2.5) * RationalQuadratic(), 3.5),
        (Matern(nu=np.inf), np.inf),
    ):
        assert sobolev_rates(kernel, 2, 1).tau == tau


def test_rates_are_not_invented():
    for kernel in (DotProduct(), ExpSineSquared(), RBF() + DotProduct()):
        rates = sobolev_rates(kernel, 2, 1)
        assert not rates.applies
        assert np.isnan([rates.tau, rates.s, rates.sup_exponent]).all()
        assert np.isnan([rates.rms_exponent, rates.condition_exponent]).all()
        assert "give the order tau" in rates.statement
    with pytest.raises(ValueError, match="dimension=3 is more than n_features=2"):
        sobolev_rates("matern32", 2, 3)
    for dimension in (0, -1, np.nan, "one"):
        with pytest.raises(ValueError, match="dimension must be a finite positive"):
            sobolev_rates("matern32", 2, dimension)
    for n_features in (0, 2.0):
        with pytest.raises(ValueError, match="n_features must be an integer"):
            sobolev_rates("matern32", n_features, 1)
    for tau in (-1, 0, np.nan, True):
        with pytest.raises(ValueError, match="kernel must be a finite positive"):
            sobolev_rates(tau, 2, 1)


# --- Convergence study ---------------------------------------------------------------

SEPARATIONS = np.geomspace(0.5, 0.02, 8)


@pytest.fixture(scope="module")
def orbit():
    return make_pendulum(3000)


@pytest.fixture(scope="module")
def later(orbit):
    """The same discrete orbit, later."""
    return make_pendulum(1000, initial=orbit.X_next[-1])


def study(estimator, orbit, later, separations=SEPARATIONS, **options):
    arrays = (orbit.X, orbit.y, separations, later.X, later.y)
    return convergence_study(estimator, *arrays, **{"dimension": 1, **options})


@pytest.mark.parametrize(
    ("kernel", "beta", "s", "tolerance"),
    [
        ("matern12", 2.0, 1, 0.3),
        ("matern32", 2.0, 2, 0.4),
        pytest.param("matern52", 2.0, 3, 0.6, marks=pytest.mark.slow),
        pytest.param("wendland_c0", 4.0, 1, 0.3, marks=pytest.mark.slow),
        pytest.param("wendland_c2", 4.0, 2, 0.4, marks=pytest.mark.slow),
        ("wendland_c4", 4.0, 3, 0.6),
        pytest.param("wendland_c6", 4.0, 4, 0.8, marks=pytest.mark.slow),
    ],
)
def test_slopes_on_the_pendulum_are_twice_the_order(
    orbit, later, kernel, beta, s, tolerance
):
    found = study(KoopmanKernelRegressor(kernel, beta=beta), orbit, later)
    assert found.guaranteed_slope == s - 0.5
    assert found.slope_interval[0] >= found.guaranteed_slope
    assert found.slope == pytest.approx(2 * s, abs=tolerance)
    assert found.rms_slope == pytest.approx(2 * s, abs=tolerance)
    assert found.used.sum() >= 6
    assert (found.rms_error <= found.sup_error).all()


def test_a_line_of_the_study_is_what_one_computes_by_hand(orbit, later):
    found = study(KoopmanKernelRegressor("matern32", beta=2.0), orbit, later)
    chosen = [0]
    for row in range(len(orbit.X)):  # Algorithm 1, for the fourth separation
        if cdist(orbit.X[row : row + 1], orbit.X[chosen]).min() > SEPARATIONS[3]:
            chosen.append(row)
    centers = orbit.X[chosen]

    def k(X):
        return kernel_matrix("matern32", X, centers, 2.0)

    error = k(later.X) @ np.linalg.solve(k(centers), orbit.y[chosen]) - later.y
    everywhere = np.vstack([orbit.X, later.X])
    line = {
        "separation": SEPARATIONS[3],
        "n_centers": len(chosen),
        "fill_distance": cdist(everywhere, centers).min(axis=1).max(),
        "separation_distance": pdist(centers).min() / 2,
        "sup_error": np.abs(error).max(),
        "rms_error": np.sqrt(np.mean(error**2)),
        "condition_number": np.linalg.cond(k(centers)),
    }
    for name, value in line.items():
        assert found[name][3] == pytest.approx(value, rel=1e-6), name
        assert len(found[name]) == len(SEPARATIONS)


def test_fill_distance_counts_the_states_of_the_test(orbit, later):
    half = orbit.X[:, 1] > 0
    found = convergence_study(
        KoopmanKernelRegressor(),
        *(orbit.X[half], orbit.y[half], [0.5, 0.3]),
        *(later.X, later.y),
        dimension=1,
    )
    for separation, fill in zip([0.5, 0.3], found.fill_distance, strict=True):
        centers = SeparatedCenterSelector(separation).fit(orbit.X[half])
        away = cdist(later.X, centers.cluster_centers_).min(axis=1).max()
        assert away > 1.5
        assert fill == pytest.approx(away)


def test_slopes_are_those_of_ordinary_least_squares(orbit, later):
    model = KoopmanKernelRegressor("wendland_c2", beta=4.0)
    widths = []
    for confidence in (0.5, 0.95, 0.99):
        found = study(model, orbit, later, confidence=confidence)
        for prefix, errors in (("", found.sup_error), ("rms_", found.rms_error)):
            x, y = np.log(found.fill_distance), np.log(errors)
            A = np.column_stack([np.ones(len(x)), x])
            (_, slope), (squares,), *_ = np.linalg.lstsq(A, y, rcond=None)
            n = len(x) - 2
            error = np.sqrt(squares / n * np.linalg.inv(A.T @ A)[1, 1])
            reach = student.ppf(0.5 + confidence / 2, n) * error
            assert found[f"{prefix}slope"] == pytest.approx(slope)
            assert_allclose(
                found[f"{prefix}slope_interval"], [slope - reach, slope + reach]
            )
        assert found.slope_interval[0] < found.slope < found.slope_interval[1]
        widths.append(np.ptp(found.slope_interval))
    assert widths[0] < widths[1] < widths[2]


def test_lines_at_the_rounding_floor_are_not_used(orbit, later):
    found = study(KoopmanKernelRegressor("wendland_c6", beta=4.0), orbit, later)
    floor = 1e-12 * np.abs(later.y).max()
    assert_array_equal(found.used, found.sup_error > floor)
    assert not found.used.all()
    assert found.slope > 7


def test_lines_with_equal_or_dropped_centres_are_not_used(orbit, later):
    separations = [0.3, 0.299999, 0.1, 0.1]
    found = study(KoopmanKernelRegressor(), orbit, later, separations)
    assert_array_equal(found.used, [True, False, True, False])
    again = study(KoopmanKernelRegressor(), orbit, later, [0.3, 0.1])
    assert found.slope == pytest.approx(again.slope)
    assert np.isnan(again.slope_interval).all()  # two points are on every line
    # A warning of left out centres becomes a line that is not used.
    found = study(KoopmanKernelRegressor("gaussian"), orbit, later)
    assert found.guaranteed_slope == np.inf
    dropped = found.n_centers < [
        len(SeparatedCenterSelector(s).fit(orbit.X).cluster_centers_)
        for s in SEPARATIONS
    ]
    assert_array_equal(found.used, ~dropped)
    assert 2 <= found.used.sum() < len(SEPARATIONS)
    alone = study(KoopmanKernelRegressor(), orbit, later, [0.3])
    assert np.isnan(alone.slope)
    assert np.isnan(alone.rms_slope_interval).all()


def test_distances_of_a_pipeline_are_those_that_the_kernel_sees(orbit, later):
    pipeline = make_pipeline(
        StandardScaler(), KoopmanKernelRegressor("matern32", beta=1.5)
    )
    found = study(pipeline, orbit, later)
    scaler = StandardScaler().fit(orbit.X)
    direct = convergence_study(
        KoopmanKernelRegressor("matern32", beta=1.5),
        *(scaler.transform(orbit.X), orbit.y, SEPARATIONS),
        *(scaler.transform(later.X), later.y),
        dimension=1,
    )
    for name in ("n_centers", "fill_distance", "sup_error", "slope", "slope_interval"):
        assert_allclose(found[name], direct[name], rtol=1e-9)
    assert found.kernel == "MaternSobolev(beta=1.5, nu=1.5)"


def test_study_leaves_the_estimator_as_it_was(orbit, later):
    model = KoopmanKernelRegressor("matern32", centers=SeparatedCenterSelector(7.0))
    pipeline = make_pipeline(StandardScaler(), model)
    for estimator in (model, pipeline):
        before = repr(clone(estimator))
        study(estimator, orbit, later, [0.4, 0.2])
        assert repr(estimator) == before
        assert not hasattr(model, "dual_coef_")
    assert model.centers.separation == 7.0


def test_errors_of_several_outputs_are_lengths(orbit, later):
    def with_outputs(data, factors):
        return type(data)(X=data.X, y=np.outer(data.y, factors))

    model = KoopmanKernelRegressor("matern32", beta=2.0)
    one = study(model, orbit, later)
    for factors in ([1.0], [3.0, 4.0]):
        found = study(model, with_outputs(orbit, factors), with_outputs(later, factors))
        length = np.linalg.norm(factors)
        assert_allclose(found.sup_error, length * one.sup_error, rtol=1e-6)
        assert_allclose(found.rms_error, length * one.rms_error, rtol=1e-6)
        assert found.slope == pytest.approx(one.slope, rel=1e-6)


def test_guarantee_is_for_interpolation(orbit, later):
    few = [0.4, 0.2]
    assert study(KoopmanKernelRegressor(), orbit, later, few).guaranteed_slope == 1.5
    for options in ({"alpha": 1e-6}, {"method": "least_squares"}):
        found = study(KoopmanKernelRegressor(**options), orbit, later, few)
        assert np.isnan(found.guaranteed_slope)
        assert found.rates.sup_exponent == 1.5
    found = study(KoopmanKernelRegressor("matern12"), orbit, later, few, dimension=2)
    assert found.guaranteed_slope == 0.5
    assert found.rates.s == 1.5


def test_dimension_is_measured_where_it_is_not_given(orbit, later):
    found = study(KoopmanKernelRegressor(), orbit, later, [0.4, 0.2], dimension=None)
    assert found.dimension == 1
    angles = np.random.default_rng(0).uniform(0, TURN, (2000, 2))
    X, y = embed(angles), np.sin(angles[:, 0])
    model = KoopmanKernelRegressor("matern32")
    torus = convergence_study(model, X, y, [1.0, 0.7], X[:50] + 1e-3, y[:50])
    assert torus.dimension == 2
    assert torus.guaranteed_slope == 1.5  # s = 3.5 - (4 - 2) / 2 = 2.5, less m / 2
    with pytest.raises(ValueError, match=r"30 distinct rows.*or the dimension itself"):
        convergence_study(model, X[:30], y[:30], [1.0, 0.7], X, y)


def test_convergence_study_refuses_bad_input(orbit, later):
    for estimator in (
        LinearRegression(),
        KoopmanKernelRegressor(centers="precomputed"),
        KoopmanKernelRegressor(centers=orbit.X[:9]),
    ):
        with pytest.raises(ValueError, match="estimator must have one parameter"):
            study(estimator, orbit, later)
    behind = Pipeline(
        [
            ("centers", SeparatedCenterSelector()),
            ("koopman", KoopmanKernelRegressor(beta=1.0, centers="precomputed")),
        ]
    )
    with pytest.raises(ValueError, match="fitted to states and not to distances"):
        study(behind, orbit, later, [0.4])
    model = KoopmanKernelRegressor()
    for separations in ([0.1, -0.2], [0.0], [np.nan], [[0.1, 0.2]], []):
        with pytest.raises(ValueError, match="separations must be a list of positive"):
            study(model, orbit, later, separations)
    for confidence in (0, 1, 2, np.nan):
        with pytest.raises(ValueError, match="confidence must be"):
            study(model, orbit, later, confidence=confidence)
    with pytest.raises(ValueError, match="dimension=3 is more than n_features=2"):
        study(model, orbit, later, [0.4, 0.2], dimension=3)
    # A column and a plain array would be broadcast against each other.
    for X_test, y_test, message in (
        (later.X, later.y[:, np.newaxis], "y_test has the shape"),
        (later.X, np.column_stack([later.y, later.y]), "y_test has the shape"),
        (later.X, later.y[1:], "inconsistent numbers of samples"),
        (later.X[:, :1], later.y, "X has 1 features"),
    ):
        with pytest.raises(ValueError, match=message):
            convergence_study(model, orbit.X, orbit.y, [0.4], X_test, y_test)


# --- Conditioning and crowding studies -----------------------------------------------


def test_condition_numbers_rise_with_twice_the_order(orbit):
    """Figures 5 and 6: the scale moves the lines, but does not tilt them."""
    kernels = ["matern12", "matern32", "matern52"]
    kernels += ["wendland_c0", "wendland_c2", "wendland_c4"]
    separations = np.geomspace(0.2, 0.025, 8)
    found = conditioning_study(kernels, [2.0, 4.0], orbit.X, separations, dimension=1)
    assert_array_equal(found.expected_slope, [-2, -4, -6, -2, -4, -6])
    assert_allclose(found.slope, found.expected_slope[:, np.newaxis] * [1, 1], rtol=0.1)
    assert_allclose(found.slope[:, 0], found.slope[:, 1], rtol=0.01)
    # The smallest eigenvalue depends on q / beta only, to the power 2 s - m.
    wider = found.smallest_eigenvalue[:, 0] / found.smallest_eigenvalue[:, 1]
    orders = np.array([1, 3, 5, 1, 3, 5])[:, np.newaxis]
    assert_allclose(wider, np.broadcast_to(2.0**orders, wider.shape), rtol=0.05)
    assert found.kernel == kernels


def test_a_cell_of_the_study_is_what_one_computes_by_hand(orbit):
    separations = [0.5, 0.3, 0.2, 0.1]
    kernels = [MaternSobolev(nu=0.5), Wendland(smoothness=2)]
    found = conditioning_study(kernels, [1.0, 3.0], orbit.X, separations, dimension=1)
    for k, separation in enumerate(separations):
        selector = SeparatedCenterSelector(separation).fit(orbit.X)
        centers = selector.cluster_centers_
        assert found.n_centers[k] == len(centers)
        assert found.fill_distance[k] == pytest.approx(selector.fill_distance_)
        q = pdist(centers).min() / 2
        assert found.separation_distance[k] == pytest.approx(q)
        r = cdist(centers, centers)
        for i, K in enumerate((np.exp(-r / 3), np.maximum(1 - r / 3, 0) ** 4)):
            K = K * (1 + 4 * r / 3) if i else K
            assert found.condition_number[i, 1, k] == pytest.approx(np.linalg.cond(K))
            value = np.linalg.eigvalsh(K)[0]
            assert found.smallest_eigenvalue[i, 1, k] == pytest.approx(value)
    assert_allclose(found.digits_lost, np.log10(found.condition_number))
    # The finer half, three at least: the last three.
    finest = np.log(found.separation_distance[1:])
    slope = np.polyfit(finest, np.log(found.condition_number[0, 0, 1:]), 1)[0]
    assert found.slope[0, 0] == pytest.approx(slope)
    low, high = found.slope_interval[0, 0]
    assert low < slope < high
    assert (low + high) / 2 == pytest.approx(slope)


def test_infinite_condition_numbers_do_not_count(orbit):
    separations = np.geomspace(0.5, 0.02, 9)
    found = conditioning_study("gaussian", 1.0, orbit.X, separations, dimension=1)
    infinite = np.isinf(found.condition_number[0, 0])
    assert 3 <= infinite.sum() < 9
    assert_array_equal(found.smallest_eigenvalue[0, 0] == 0, infinite)
    assert_allclose(found.digits_lost[0, 0, infinite], 15.65, atol=0.01)
    assert found.expected_slope == -np.inf
    assert np.isnan(
        conditioning_study("matern12", 1.0, orbit.X, [0.3, 0.2], dimension=1).slope
    )
    # One centre is as far from any other as can be.
    found = conditioning_study(
        "matern12", 1.0, orbit.X, [50.0, 0.2, 0.1, 0.05], dimension=1
    )
    assert_array_equal(found.n_centers[:1], [1])
    assert found.condition_number[0, 0, 0] == 1
    assert found.slope == pytest.approx(-2, abs=0.1)


def test_conditioning_study_refuses_bad_input(orbit):
    good = {"kernels": ["matern12"], "betas": [1.0], "separations": [0.3, 0.2]}
    for name, value, message in (
        ("kernels", [], "kernels is empty"),
        ("kernels", ["matern"], "kernel must be one of"),
        ("kernels", [RBF()], "scales the kernels of sklearn_koopman only"),
        ("betas", [0.0], "betas must be a list of positive"),
        ("separations", [-1.0], "separations must be a list of positive"),
        ("dimension", 3, "dimension=3 is more than"),
        ("confidence", 1.0, "confidence must be"),
        ("confidence", np.nan, "confidence must be"),
    ):
        with pytest.raises(ValueError, match=message):
            conditioning_study(X=orbit.X, **{"dimension": 1, **good, name: value})
    with pytest.raises(ValueError, match="or the dimension itself"):
        conditioning_study(X=orbit.X[:30], **good)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_crowded_pair_costs_the_gap_or_its_square(orbit, kernel):
    gaps = np.geomspace(0.01, 0.001, 5)
    found = crowding_study(kernel, orbit.X, [0.5, 0.23], gaps, beta=0.5)
    order = 1 if kernel in ("matern12", "wendland_c0") else 2
    for i, separation in enumerate((0.5, 0.23)):
        selector = SeparatedCenterSelector(separation).fit(orbit.X)
        assert found.n_centers[i] == len(selector.cluster_centers_)
        assert found.fill_distance[i] == pytest.approx(selector.fill_distance_)
        assert_allclose(found.separation_distance[i], gaps / 2)
        slope = np.polyfit(np.log(gaps), np.log(found.smallest_eigenvalue[i]), 1)[0]
        assert slope == pytest.approx(order, abs=0.05)
        rising = np.polyfit(np.log(gaps), np.log(found.condition_number[i]), 1)[0]
        assert rising == pytest.approx(-slope, abs=0.01)


def test_a_crowded_pair_that_sees_no_other_centre(orbit):
    """The eigenvalues are 1 plus and minus phi(gap), and 1."""
    gaps = np.array([0.05, 0.01])
    found = crowding_study("wendland_c2", orbit.X, [0.5], gaps, beta=0.4)
    r = gaps / 0.4
    phi = (1 - r) ** 4 * (4 * r + 1)
    assert_allclose(found.smallest_eigenvalue[0], 1 - phi, rtol=1e-9)
    assert_allclose(found.condition_number[0], (1 + phi) / (1 - phi), rtol=1e-9)


def test_crowding_study_refuses_bad_input(orbit):
    for X in (np.ones((5, 2)), np.zeros((5, 2))):
        with pytest.raises(ValueError, match="no direction"):
            crowding_study("matern12", X, [0.5], [0.1])
    with pytest.raises(ValueError, match="gaps must be a list of positive"):
        crowding_study("matern12", orbit.X, [0.5], [0.0])
    with pytest.raises(ValueError, match="separations must be a list of positive"):
        crowding_study("matern12", orbit.X, [-0.5], [0.1])


# --- Calibration ---------------------------------------------------------------------


class Stated(RegressorMixin, BaseEstimator):
    """Predict the first feature, with the second as its standard deviation."""

    seen = []

    def __init__(self, factor=1.0):
        self.factor = factor

    def fit(self, X, y):
        self.seen.append(set(X[:, -1]))
        self.shape_ = np.shape(y)[1:]
        return self

    def predict(self, X, return_std=False):
        mean, std = (
            np.multiply.outer(column, np.ones(self.shape_))
            for column in (X[:, 0], self.factor * X[:, 1])
        )
        return (mean, std) if return_std else mean


def test_calibration_of_a_gaussian_process_is_right():
    """Samples of the process itself, as many as give the ratio to a few percent."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0, 4, (300, 2))
    factor = np.linalg.cholesky(
        9 * MaternSobolev(1.0, nu=1.5)(X) + 0.04 * np.eye(len(X))
    )
    y = factor @ rng.standard_normal((300, 40))
    model = KoopmanKernelRegressor("matern32", beta=1.0, alpha=0.04 / 9)
    groups = np.repeat(np.arange(10), 30)
    found = calibration_study(model, X, y, groups=groups)
    assert found.ratio == pytest.approx(1, abs=0.03)
    assert_allclose(found.coverage, found.level, atol=0.02)
    assert_allclose(found.fold_ratio, 1, atol=0.1)
    assert found.fold_coverage.shape == (5, 5)
    # A process of another amplitude and noise is off by a factor that is known.
    theirs = GaussianProcessRegressor(
        2.25 * Matern(1.0, nu=1.5) + WhiteKernel(0.01), alpha=0.0, optimizer=None
    )
    doubled = calibration_study(theirs, X, y, groups=groups)
    assert doubled.ratio == pytest.approx(2, abs=0.06)


@pytest.mark.parametrize("n_outputs", [None, 1, 3])
def test_ratio_and_coverage_are_those_of_the_errors(n_outputs):
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.standard_normal(200), rng.uniform(0.5, 2, 200)])
    X = np.column_stack([X, np.arange(200)])
    shape = (200,) if n_outputs is None else (200, n_outputs)
    z = 1.5 * rng.standard_normal(shape)
    y = (X[:, :1] + X[:, 1:2] * z.reshape(200, -1)).reshape(shape)
    levels = [0.5, 0.9, 0.683]
    for factor in (1.0, 2.0, 0.01):
        found = calibration_study(Stated(factor), X, y, cv=KFold(4), levels=levels)
        scaled = np.abs(z) / factor
        assert found.ratio == pytest.approx(np.sqrt(np.mean(scaled**2)))
        parts = scaled.reshape(4, -1)
        assert_allclose(found.fold_ratio, np.sqrt(np.mean(parts**2, axis=1)))
        assert_array_equal(found.level, levels)
        for i, level in enumerate(levels):
            inside = normal.cdf(parts) - normal.cdf(-parts) <= level
            assert_allclose(found.fold_coverage[:, i], inside.mean(axis=1))
            assert found.coverage[i] == pytest.approx(inside.mean())


def test_whole_trajectories_are_left_out():
    rng = np.random.default_rng(2)
    groups = rng.permutation(np.repeat(np.arange(7), 20))
    X = np.column_stack([np.zeros(140), np.ones(140), groups])
    for cv, n_folds in ((None, 5), (GroupKFold(3), 3)):
        Stated.seen.clear()
        found = calibration_study(Stated(), X, 1.0 * groups, groups=groups, cv=cv)
        left_out = [set(range(7)) - kept for kept in Stated.seen]
        assert len(found.fold_ratio) == len(left_out) == n_folds
        assert sorted(g for part in left_out for g in part) == list(range(7))
        expected = [np.sqrt(np.mean(np.square(list(part)))) for part in left_out]
        assert_allclose(found.fold_ratio, expected)
    # Two trajectories make two folds.
    found = calibration_study(Stated(), X, 1.0 * groups, groups=groups > 2)
    assert len(found.fold_ratio) == 2
    # Without groups, contiguous blocks of one trajectory.
    X[:, 2] = np.arange(140)
    Stated.seen.clear()
    calibration_study(Stated(), X, np.zeros(140))
    for kept in Stated.seen:
        rows = sorted(set(range(140)) - kept)
        assert rows == list(range(rows[0], rows[0] + len(rows)))


def test_deviations_of_zero_are_right_only_without_errors():
    X = np.column_stack([np.zeros(40), np.zeros(40), np.arange(40)])
    exact = calibration_study(Stated(), X, np.zeros(40))
    assert exact.ratio == 0
    assert_array_equal(exact.coverage, np.ones(5))
    y = np.zeros(40)
    y[:10] = 1e-9
    missed = calibration_study(Stated(), X, y)
    assert missed.ratio == np.inf
    assert_allclose(missed.coverage, 0.75)
    # An interpolant of constant outputs states what it delivers.
    data = make_pendulum(100)
    zero = calibration_study(KoopmanKernelRegressor(), data.X, np.zeros(100))
    assert zero.ratio == 0


def test_calibration_of_pipelines_and_lists():
    data = make_pendulum(
        40, initial="random", n_trajectories=8, noise=0.02, random_state=0
    )
    model = KoopmanKernelRegressor(
        beta=2.0,
        centers=SeparatedCenterSelector(0.4),
        method="least_squares",
        alpha=1e-3,
    )
    pipeline = make_pipeline(StandardScaler(), model)
    found = calibration_study(pipeline, data.X, data.y, groups=data.groups)
    lists = [a.tolist() for a in (data.X, data.y, data.groups)]
    again = calibration_study(pipeline, *lists[:2], groups=lists[2])
    assert found.ratio == again.ratio
    # By hand, for the fold that leaves out the last trajectories.
    cv = [(np.flatnonzero(data.groups < 6), np.flatnonzero(data.groups >= 6))]
    found = calibration_study(pipeline, data.X, data.y, cv=cv)
    train, test = cv[0]
    scaler = StandardScaler().fit(data.X[train])
    fitted = clone(model).fit(scaler.transform(data.X[train]), data.y[train])
    mean, std = fitted.predict(scaler.transform(data.X[test]), return_std=True)
    z = (data.y[test] - mean) / std
    assert found.ratio == pytest.approx(np.sqrt(np.mean(z**2)))
    assert not hasattr(model, "dual_coef_")


def test_calibration_refuses_bad_input():
    data = make_pendulum(60)
    with pytest.raises(
        ValueError, match=r"LinearRegression\.predict has no return_std"
    ):
        calibration_study(LinearRegression(), data.X, data.y)
    for levels in ([1.0], [0.5, 2.0], [0.0], [], [[0.5]]):
        with pytest.raises(ValueError, match="levels must"):
            calibration_study(Stated(), data.X, data.y, levels=levels)
    with pytest.raises(ValueError, match="inconsistent numbers of samples"):
        calibration_study(Stated(), data.X, data.y[:9])


# --- What users bring ----------------------------------------------------------------


def winding(n_samples, step):
    """Wind around a torus."""
    angles = step * np.arange(n_samples)[:, np.newaxis] * [1, np.sqrt(2)]
    return np.hstack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("function", [fill_distance, separation_distance, mesh_ratio])
def test_paths_that_follow_a_trajectory_are_pointed_out(function):
    X = winding(5000, 0.015)
    with pytest.warns(UserWarning, match="paths follow the trajectory") as caught:
        function(X[::400], X, metric="geodesic")
    assert caught[0].filename == __file__  # the line of the user


def test_data_frames_reach_the_columns_that_a_pipeline_names(orbit, later):
    names = ["momentum", "position"]
    frame, frame_later = (
        pd.DataFrame(data.X, columns=names) for data in (orbit, later)
    )
    scaler = make_column_transformer((StandardScaler(), names))
    model = make_pipeline(scaler, KoopmanKernelRegressor(beta=2.0))
    separations = [0.5, 0.3, 0.2]
    named = convergence_study(
        model, frame, orbit.y, separations, frame_later, later.y, dimension=1
    )
    plain = convergence_study(
        make_pipeline(StandardScaler(), KoopmanKernelRegressor(beta=2.0)),
        *(orbit.X, orbit.y, separations, later.X, later.y),
        dimension=1,
    )
    # Scaled by two classes, that is with errors of their own in the last place.
    assert_allclose(named.sup_error, plain.sup_error, rtol=0, atol=1e-12)
    assert_allclose(named.fill_distance, plain.fill_distance, rtol=1e-12)
    held_out = [
        calibration_study(clone(m), x[::10], orbit.y[::10])
        for m, x in ((model, frame), (model, frame.astype(object)))
    ]
    assert held_out[0].ratio == pytest.approx(held_out[1].ratio)


def test_calibration_of_a_search_and_of_columns():
    data = make_pendulum(
        40, initial="random", n_trajectories=6, noise=0.01, random_state=0
    )
    model = KoopmanKernelRegressor(beta=3.0, alpha=1e-3)
    search = GridSearchCV(model, {"alpha": [1e-3]}, cv=GroupKFold(2))
    direct = calibration_study(model, data.X, data.y, groups=data.groups)
    searched = calibration_study(search, data.X, data.y, groups=data.groups)
    assert searched.ratio == pytest.approx(direct.ratio)
    # Gaussian processes return plain arrays for a column of outputs.
    process = GaussianProcessRegressor(RBF(2.0), alpha=1e-4, optimizer=None)
    flat = calibration_study(process, data.X, data.y, groups=data.groups)
    column = data.y[:, np.newaxis]
    assert calibration_study(
        process, data.X, column, groups=data.groups
    ).ratio == pytest.approx(flat.ratio)


def test_numbers_of_folds_keep_trajectories_whole():
    data = make_pendulum(30, initial="random", n_trajectories=6, random_state=0)
    model = KoopmanKernelRegressor(beta=3.0, alpha=1e-3)
    by_number = calibration_study(model, data.X, data.y, groups=data.groups, cv=3)
    by_splitter = calibration_study(
        model, data.X, data.y, groups=data.groups, cv=TrajectoryKFold(3)
    )
    assert_array_equal(by_number.fold_ratio, by_splitter.fold_ratio)
    with pytest.raises(ValueError, match=r"^cv .* at least 2, got 1"):
        calibration_study(model, data.X, data.y, groups=np.zeros(180))
    with pytest.raises(ValueError, match="has no return_std"):
        calibration_study(LinearRegression(), data.X, data.y)


def test_condition_number_is_that_of_the_matrix_solved_with(orbit, later):
    model = KoopmanKernelRegressor("gaussian", beta=4.0, alpha=1e-3)
    found = convergence_study(
        model, orbit.X, orbit.y, [0.3, 0.1], later.X, later.y, dimension=1
    )
    centers = orbit.X[SeparatedCenterSelector(0.1).fit(orbit.X).center_indices_]
    K = KERNELS["gaussian"](beta=4.0)(centers) + 1e-3 * np.eye(len(centers))
    assert found.condition_number[1] == pytest.approx(np.linalg.cond(K), rel=1e-6)
    assert np.isnan(found.guaranteed_slope)


def test_kernels_of_unknown_order_are_measured(orbit, later):
    rough = KoopmanKernelRegressor(Matern(2.0, nu=1.5) + WhiteKernel(1e-12))
    found = convergence_study(
        rough, orbit.X, orbit.y, [0.4, 0.3, 0.2, 0.1], later.X, later.y, dimension=1
    )
    assert 3 < found.slope < 5
    assert found.rates.s == 2  # noise does not count
    assert np.isnan(found.guaranteed_slope)
    odd = KoopmanKernelRegressor(RBF(2.0) + DotProduct(), alpha=1e-6)
    found = convergence_study(
        odd, orbit.X, orbit.y, [0.4, 0.3, 0.2], later.X, later.y, dimension=1
    )
    assert not found.rates.applies
    assert (found.sup_error > 0).all()


def test_slopes_end_where_rounding_begins(orbit, later):
    """A wide smooth kernel stalls far above 1e-12 of the outputs."""
    found = convergence_study(
        KoopmanKernelRegressor("wendland_c6", beta=20.0),
        *(orbit.X, orbit.y, np.geomspace(0.5, 0.02, 10), later.X, later.y),
        dimension=1,
    )
    assert found.slope > 7


@pytest.mark.parametrize(
    ("errors", "above"),
    [
        ([1e-2, 1e-5, 1e-9, 1e-11, 8e-12, 9e-12], [1, 1, 1, 1, 0, 0]),
        ([1e-2, 2e-2, 1e-4, 3e-4], [1, 1, 1, 1]),  # scatter far above rounding
        ([1e-2, 1e-9, 8e-10, 1e-11], [1, 1, 1, 1]),  # a pause, not the end
        ([1e-2, 1e-7, 1e-13, 1e-11], [1, 1, 0, 0]),
    ],
)
def test_rounding_is_where_errors_no_longer_fall(errors, above):
    h = np.geomspace(0.5, 0.01, len(errors))
    backwards = slice(None, None, -1)
    for order in (slice(None), backwards):
        found = above_rounding(h[order], np.array(errors)[order], 1.0)
        assert_array_equal(found, np.array(above, dtype=bool)[order])


def test_fill_distance_along_the_manifold_has_the_same_slope(orbit, later):
    arguments = (orbit.X, orbit.y, np.geomspace(1.2, 0.05, 7), later.X, later.y)
    model = KoopmanKernelRegressor(beta=2.0)
    through = convergence_study(model, *arguments, dimension=1)
    along = convergence_study(model, *arguments, dimension=1, metric="geodesic")
    assert (along.fill_distance > 0.999 * through.fill_distance).all()
    assert along.fill_distance[0] > 1.003 * through.fill_distance[0]  # arcs
    assert along.slope == pytest.approx(through.slope, rel=0.02)


def test_a_single_kernel_needs_no_list(orbit):
    single, listed = (
        conditioning_study(kernels, [2.0], orbit.X, [0.4, 0.2, 0.1], dimension=1)
        for kernels in (MaternSobolev(nu=1.5), [MaternSobolev(nu=1.5)])
    )
    assert_array_equal(single.condition_number, listed.condition_number)


def test_states_too_small_for_squares_are_refused():
    X = 1e-170 * np.random.default_rng(0).standard_normal((100, 2))
    for refused in (
        lambda: intrinsic_dimension(X),
        lambda: fill_distance(X[:5], X),
        lambda: separation_distance(X),
    ):
        with pytest.raises(ValueError, match="rescale"):
            refused()


def test_a_study_points_out_once_that_paths_follow_a_trajectory():
    X = winding(4000, 0.02)
    test = np.arange(len(X)) % 5 == 0
    y = np.sin(X[:, 0])
    with pytest.warns(UserWarning, match="paths follow the trajectory") as caught:
        convergence_study(
            KoopmanKernelRegressor(beta=2.0),
            *(X[~test], y[~test], [0.9, 0.6, 0.5], X[test], y[test]),
            metric="geodesic",
            dimension=2,
        )
    assert [warning.filename for warning in caught] == [__file__]


def test_searches_learn_of_the_groups_and_nest():
    data = make_pendulum(30, initial="random", n_trajectories=6, random_state=0)
    model = KoopmanKernelRegressor(beta=3.0, alpha=1e-3)
    search = GridSearchCV(model, {"alpha": [1e-3]}, cv=GroupKFold(2))
    alone = calibration_study(model, data.X, data.y, groups=data.groups)
    found = calibration_study(search, data.X, data.y, groups=data.groups)
    assert found.ratio == pytest.approx(alone.ratio)
    scaled = make_pipeline(StandardScaler(), StandardScaler(), model)
    nested = make_pipeline(
        StandardScaler(), GridSearchCV(make_pipeline(StandardScaler(), model), {}, cv=2)
    )
    assert calibration_study(nested, data.X, data.y).ratio == pytest.approx(
        calibration_study(scaled, data.X, data.y).ratio
    )
    with pytest.raises(ValueError, match="is a search"):
        convergence_study(search, data.X, data.y, [0.4], data.X, data.y)


def test_constants_and_noise_alone_have_no_order():
    for kernel in (ConstantKernel(), WhiteKernel(), WhiteKernel() * Matern()):
        assert not sobolev_rates(kernel, 2, 1).applies
    for kernel in (ConstantKernel() * Matern(nu=1.5), Matern(nu=1.5) + WhiteKernel()):
        assert sobolev_rates(kernel, 2, 1).sup_exponent == 1.5
