"""Kernel matrices, and sums that are made of them tile by tile."""

import numpy as np
import pytest
from designs import every_pair
from reference import kernel_matrix
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

from sklearn_koopman import KoopmanKernelRegressor
from sklearn_koopman._matrices._sections import (
    KernelExpansion,
    KernelSections,
    PrecomputedSections,
    gram_matrix,
    gram_product,
    matrix,
    product,
    sparse_matrix,
    sparse_tree,
)
from sklearn_koopman._matrices._sparse import kd_tree
from sklearn_koopman.kernels import KERNELS, MaternSobolev, RadialKernel, Wendland

# Size of the states, their offset, and beta: of each kind of distance there are some.
PLACES = {
    "unit": (1.0, 0.0, 1.0),
    "wide kernel": (1.0, 0.0, 30.0),
    "narrow kernel": (1.0, 0.0, 0.25),
    "narrower, beyond products": (1.0, 0.0, 0.05),
    "offset": (1.0, 30.0, 1.0),
    "far offset": (1.0, 1e8, 1.0),
    "far offset of wide kernel": (1.0, 1e8, 2.0**20),
    "small": (1e-3, 10.0, 1.0),
    "tiny": (1e-100, 0.0, 1e-100),
    "huge": (1e100, 0.0, 1e100),
    "tiny kernel": (1.0, 0.0, 1e-60),
    "huge kernel": (1.0, 0.0, 1e100),
    "huge beside the kernel": (1e60, 0.0, 1.0),
}


@every_pair(name=KERNELS, place=PLACES, n_features=[4, 5, 12])
def test_products_are_as_accurate_as_differences(name, place, n_features):
    size, offset, beta = PLACES[place]
    rng = np.random.default_rng(0)
    centers = offset + size * rng.normal(size=(70, n_features))
    X = np.vstack(
        [
            centers[:20],
            centers[:10] + 1e-9 * size,
            centers[:20] + 1e-3 * size * rng.normal(size=(20, n_features)),
            offset + size * rng.normal(size=(30, n_features)),
        ]
    )
    dual = rng.normal(size=(70, 2))
    sections = KernelSections(KERNELS[name](beta=beta), centers)
    expected = kernel_matrix(name, X, centers, beta) @ dual
    found = product(sections, X, dual)
    assert np.abs(found - expected).max() < 1e-12
    assert np.abs(matrix(sections, X) @ dual - expected).max() < 1e-12
    by_row = np.vstack([product(sections, row[np.newaxis], dual) for row in X])
    assert np.abs(by_row - found).max() < 1e-12


def test_distances_at_which_products_lose_their_digits():
    # matern12 falls linearly, so that the error of the distance is that of the kernel.
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(1, 8))
    direction /= np.linalg.norm(direction)
    centers = np.vstack([rng.normal(size=(1, 8)), 10 * rng.normal(size=(30, 8))])
    steps = np.logspace(-16, 0, 200)[:, np.newaxis]
    X = centers[:1] + steps * direction
    dual = np.zeros((31, 1))
    dual[0] = 1.0
    found = product(KernelSections(MaternSobolev(1.0, 0.5), centers), X, dual)
    expected = kernel_matrix("matern12", X, centers[:1], 1.0)
    assert np.abs(found - expected).max() < 1e-11
    # Equal rows are at distance zero exactly.
    same = product(KernelSections(MaternSobolev(1e-3, 0.5), centers), centers, dual)
    assert same[0, 0] == 1.0


def test_a_distant_row_spoils_no_digits_of_others():
    rng = np.random.default_rng(2)
    centers = rng.normal(size=(50, 6))
    X = np.vstack([centers[:5] + 1e-5, np.full((1, 6), 20.0)])
    dual = rng.normal(size=(50, 1))
    sections = KernelSections(MaternSobolev(1.0, 0.5), centers)
    expected = kernel_matrix("matern12", X, centers) @ dual
    assert np.abs(product(sections, X, dual) - expected).max() < 1e-12
    assert np.abs(product(sections, X[:5], dual) - expected[:5]).max() < 1e-12


def test_near_rows_in_every_tile():
    rng = np.random.default_rng(21)
    centers = rng.normal(size=(700, 6))
    X = np.tile(centers[rng.permutation(700)], (2, 1))
    X[700:] += 1e-5 * rng.normal(size=(700, 6))
    dual = rng.normal(size=(700, 1))
    sections = KernelSections(MaternSobolev(1.0, 0.5), centers)
    expected = kernel_matrix("matern12", X, centers) @ dual
    np.testing.assert_allclose(product(sections, X, dual), expected, rtol=0, atol=1e-11)


def test_clusters_whose_squares_hide_distances():
    rng = np.random.default_rng(22)
    centers = rng.normal(size=(200, 12))
    centers[100:] += 900.0
    X = centers[::7] + rng.normal(size=(29, 12))
    dual = rng.normal(size=(200, 1))
    sections = KernelSections(KERNELS["inverse_multiquadric"](), centers)
    expected = kernel_matrix("inverse_multiquadric", X, centers, 1.0) @ dual
    found = product(sections, X, dual)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n_features", [2, 6])
def test_gram_product_of_any_number_of_centres(n_features):
    rng = np.random.default_rng(3)
    for n in [1, 2, 3, 31, 43, 50, 62, 63, 64, 65, 100, 113, 127, 128, 129, 200, 300]:
        points, V = rng.normal(size=(n, n_features)), rng.normal(size=(n, 2))
        sections = KernelSections(MaternSobolev(2.0), points)
        expected = kernel_matrix("matern32", points, points, 2.0) @ V
        for n_jobs in (1, 2, 7):
            found = gram_product(sections, V, n_jobs)
            assert np.abs(found - expected).max() < 1e-12 * n


def test_gram_product_of_foreign_kernel_leaves_out_noise():
    rng = np.random.default_rng(4)
    points, V = rng.normal(size=(300, 2)), rng.normal(size=(300, 1))
    sections = KernelSections(RBF(0.7) + WhiteKernel(0.5), points)
    expected = kernel_matrix("gaussian", points, points, 0.7) @ V
    found = gram_product(sections, V)
    assert np.abs(found - expected).max() < 1e-11


@pytest.mark.parametrize("kernel", [MaternSobolev(0.8), RBF(0.8) + WhiteKernel(0.5)])
@pytest.mark.parametrize("n", [1, 63, 64, 65, 600])
def test_gram_matrix(kernel, n):
    points = np.random.default_rng(5).normal(size=(n, 3))
    nugget = np.linspace(0.1, 0.2, n)
    K, excess, norm = gram_matrix(KernelSections(kernel, points), nugget)
    expected = kernel(points) + np.diag(nugget)
    np.testing.assert_allclose(np.tril(K), np.tril(expected), rtol=1e-12, atol=1e-14)
    noise = 0.5 if isinstance(kernel, MaternSobolev) is False else 0.0
    np.testing.assert_allclose(excess, nugget + noise, rtol=1e-12)
    assert norm == pytest.approx(np.linalg.norm(expected, 1), rel=1e-12)


def test_product_does_not_depend_on_threads():
    rng = np.random.default_rng(6)
    for n_features in (2, 7):
        centers, X = (
            rng.normal(size=(90, n_features)),
            rng.normal(size=(4000, n_features)),
        )
        dual = rng.normal(size=(90, 3))
        sections = KernelSections(MaternSobolev(2.0, 2.5), centers)
        alone = product(sections, X, dual, 1)
        np.testing.assert_allclose(
            product(sections, X, dual, 3), alone, rtol=0, atol=1e-13
        )
        expected = kernel_matrix("matern52", X[::97], centers, 2.0) @ dual
        np.testing.assert_allclose(alone[::97], expected, rtol=0, atol=1e-12)


class Cosine(RadialKernel):
    """A kernel of a user, with a profile that makes its own array."""

    def profile(self, r, n_features, out=None):
        return np.cos(np.minimum(r, np.pi)) + 1.0 - n_features / 100

    def log_gradient(self, r, n_features):
        return r * np.sin(r)

    def sobolev_order(self, n_features):
        return 1.0


@pytest.mark.parametrize("n_features", [2, 6])
def test_profile_may_ignore_out(n_features):
    rng = np.random.default_rng(7)
    centers, X = rng.normal(size=(100, n_features)), rng.normal(size=(700, n_features))
    sections = KernelSections(Cosine(3.0), centers)
    r = np.linalg.norm(X[:, np.newaxis] - centers, axis=-1) / 3.0
    expected = np.cos(np.minimum(r, np.pi)) + 1.0 - n_features / 100
    np.testing.assert_allclose(matrix(sections, X), expected, rtol=1e-12, atol=1e-13)
    dual = rng.normal(size=(100, 1))
    np.testing.assert_allclose(
        product(sections, X, dual), expected @ dual, rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("name", KERNELS)
def test_profile_with_and_without_out(name):
    kernel = KERNELS[name]()
    r = np.array([[0.0, 1e-9, 0.3], [0.999, 1.0, 2.5]])
    before = r.copy()
    fresh = kernel.profile(r, 3)
    np.testing.assert_array_equal(r, before)
    out = np.full_like(r, np.nan)
    assert kernel.profile(r.copy(), 3, out) is out
    np.testing.assert_array_equal(out, fresh)
    origin = np.zeros((1, 3))
    at = np.zeros((6, 3))
    at[:, 0] = before.ravel()
    expected = kernel_matrix(name, at, origin, 1.0).ravel()
    np.testing.assert_allclose(fresh.ravel(), expected, rtol=1e-14)


def test_distances_beyond_the_range_of_doubles_are_refused():
    # Up to there the polynomial factors fit in a double: no inf * 0.
    for name in KERNELS:
        near = KernelSections(KERNELS[name](beta=1e-50), np.array([[0.0], [1e19]]))
        K = matrix(near, near.centers)
        np.testing.assert_array_equal(np.diag(K), [1.0, 1.0])
        assert np.abs(K[0, 1]) < 1e-60
        far = KernelSections(KERNELS[name](beta=1e-50), np.array([[0.0], [1e21]]))
        for evaluate in (
            matrix,
            lambda sections, X: gram_matrix(sections, np.zeros(2)),
        ):
            with pytest.raises(ValueError, match=r"rescale the states.* raise beta"):
                evaluate(far, far.centers)


@pytest.mark.parametrize("n_features", [1, 2, 3, 4, 7, 10])
@pytest.mark.parametrize("smoothness", [0, 2, 4, 6])
def test_sparse_matrix_in_any_dimension(n_features, smoothness):
    rng = np.random.default_rng(8)
    centers = rng.uniform(size=(200, n_features))
    X = np.vstack([centers[:30], rng.uniform(-0.2, 1.2, size=(70, n_features))])
    beta = 0.35 * np.sqrt(n_features)
    sections = KernelSections(Wendland(beta, smoothness, max(n_features, 3)), centers)
    expected = kernel_matrix(f"wendland_c{smoothness}", X, centers, beta)
    tree = kd_tree(sections.kernel, centers)
    found = sparse_matrix(sections, X, tree)
    assert found.nnz < expected.size
    np.testing.assert_allclose(found.toarray(), expected, rtol=1e-11, atol=1e-15)


def test_prediction_takes_the_sparse_way_where_little_is_not_zero():
    rng = np.random.default_rng(9)
    # More rows than a sparse matrix holds at once.
    centers, X = rng.uniform(size=(3000, 2)), rng.uniform(size=(20_000, 2))
    dual = rng.normal(size=(3000, 2))
    narrow = KernelSections(Wendland(0.02, 2, 3), centers)
    wide = KernelSections(Wendland(0.5, 2, 3), centers)
    assert sparse_tree(narrow, X) is not None
    assert sparse_tree(wide, X) is None
    assert sparse_tree(narrow.take(np.arange(10)), X) is None
    assert sparse_tree(narrow, X[:3]) is None  # a tree would take longer
    assert sparse_tree(KernelSections(MaternSobolev(0.01), centers), X) is None
    distances = PrecomputedSections(Wendland(0.02), np.arange(3000), X[:3000])
    assert sparse_tree(distances, X) is None
    for sections, rows in ((narrow, X), (wide, X[:700])):
        beta = sections.kernel.beta
        shown = slice(None, None, len(rows) // 60)
        expected = kernel_matrix("wendland_c2", rows[shown], centers, beta) @ dual
        for n_jobs in (None, 2):
            found = product(sections, rows, dual, n_jobs)
            assert found.shape == (len(rows), 2)
            assert np.abs(found[shown] - expected).max() < 1e-12


def test_expansion_adds_the_trend():
    rng = np.random.default_rng(12)
    centers, X = rng.normal(size=(40, 3)), rng.normal(size=(70, 3))
    dual, trend = rng.normal(size=(40, 4)), rng.normal(size=(4, 4))
    origin = centers.mean(axis=0)
    sections = KernelSections(MaternSobolev(2.0), centers)
    kernel_part = kernel_matrix("matern32", X, centers, 2.0) @ dual
    for terms in (0, 1, 4):
        f = KernelExpansion(sections, dual, origin, trend[:terms])
        monomials = np.hstack([np.ones((70, 1)), X - origin])[:, :terms]
        expected = kernel_part + monomials @ trend[:terms]
        np.testing.assert_allclose(f(X), expected, atol=1e-12)
        np.testing.assert_allclose(f.take([2, 0])(X), expected[:, [2, 0]], atol=1e-12)
        weights = rng.normal(size=(4, 2))
        combined = f.combine(weights)(X)
        np.testing.assert_allclose(combined, expected @ weights, atol=1e-11)


def test_states_out_of_reach_of_all_centres():
    rng = np.random.default_rng(10)
    sections = KernelSections(Wendland(0.02, 2, 3), rng.uniform(size=(3000, 2)))
    X = np.full((100, 2), 50.0)
    assert sparse_tree(sections, X) is not None
    found = product(sections, X, np.ones((3000, 1)))
    np.testing.assert_array_equal(found, np.zeros((100, 1)))


def test_integer_and_fortran_ordered_states():
    rng = np.random.default_rng(11)
    X = rng.integers(0, 9, size=(120, 6))
    y = rng.normal(size=120)
    model = KoopmanKernelRegressor(beta=5.0, alpha=0.1).fit(X, y)
    expected = model.predict(X.astype(float))
    np.testing.assert_array_equal(model.predict(X), expected)
    fortran = np.asfortranarray(X.astype(float))
    np.testing.assert_allclose(model.predict(fortran), expected, atol=1e-12)
