"""What `peers.py` measures: one generator for each task and peer.

A generator first sets up and warms up at a small size, and yields; the code up to its
second yield is what is timed, and whose memory is measured. Third it yields the answer,
an array that is compared with that of the other peers (None for nothing to compare),
and notes for the table. A note `times` multiplies the seconds: for extrapolation.
"""

import itertools
from functools import partial

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu, spsolve
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials
from sklearn_koopman.kernels import KERNELS
from sklearn_koopman.kinematics import leg_angles

RADII = 3.0, 1.0  # of the torus
AREA = 4 * np.pi**2 * RADII[0] * RADII[1]
GOLDEN = (np.sqrt(5) - 1) / 2


def lattice(n, offset=0.0, seed=0):
    """Points of the unit square, about 1 / sqrt(n) apart, in random order."""
    i = np.random.default_rng(seed).permutation(n)
    return np.column_stack([(i + 0.5) / n, (i * GOLDEN + offset) % 1])


def torus(u, v):
    """Points of a torus, which is a 2-D manifold in 3-D."""
    ring = RADII[0] + RADII[1] * np.cos(v)
    return np.column_stack([ring * np.cos(u), ring * np.sin(u), RADII[1] * np.sin(v)])


def winding(start, stop):
    """Samples of a trajectory that winds around the torus and fills it."""
    k = np.arange(start, stop)
    return torus(0.05 * k, 0.05 * np.sqrt(2) * k)


def smooth(X):
    """Two outputs."""
    return np.column_stack([np.sin(3 * X).mean(axis=1), np.cos(X).prod(axis=1)])


def miss(reached, wanted):
    """Largest error relative to the values, for a note."""
    return f"{np.abs(reached - wanted).max() / np.abs(wanted).max():.1e}"


# 1. select


def trajectory_and_volume(n):
    """Three quarters on the torus, one quarter anywhere in the box around it."""
    size = np.array([sum(RADII), sum(RADII), RADII[1]])
    anywhere = np.random.default_rng(0).uniform(-size, size, (n // 4, 3))
    return np.vstack([winding(0, n - n // 4), anywhere])


def selector(separation, n, deep):
    if not deep:
        return SeparatedCenterSelector(separation)
    from deeptime.clustering import RegularSpace

    return RegularSpace(dmin=separation, max_centers=n)


def centers_of(selected):
    model = selected.fetch_model() if hasattr(selected, "fetch_model") else selected
    return model.cluster_centers if model is not selected else model.cluster_centers_


def select(n, separation, volume=False, deep=False):
    X = trajectory_and_volume(n) if volume else winding(0, n)
    selector(0.5, 1000, deep).fit(X[:1000])
    yield
    selected = selector(separation, n, deep).fit(X)
    yield
    centers = centers_of(selected)
    yield centers, {"centres": f"{len(centers):,}"}


# 2. fit, 3. predict


class Interpolator:
    """SciPy's cubic: among its kernels the one of the order of Matern-3/2 in 2-D."""

    def fit(self, X, y):
        self.rbf_ = RBFInterpolator(X, y, kernel="cubic")

    def predict(self, X):
        return self.rbf_(X)


def make(peer_name, beta, **parameters):
    if peer_name == "KoopmanKernelRegressor":
        return KoopmanKernelRegressor("matern32", beta=beta, **parameters)
    matern = Matern(beta, nu=1.5)
    if peer_name == "GaussianProcessRegressor":
        return GaussianProcessRegressor(matern, optimizer=None, alpha=1e-10)
    if peer_name == "KernelRidge":
        return KernelRidge(kernel=matern, alpha=1e-10)
    return Interpolator()


def fit(peer_name, M, beta):
    X = lattice(M)
    y = smooth(X)
    fresh = lattice(1000, offset=0.3)
    make(peer_name, beta).fit(X[:200], y[:200])
    model = make(peer_name, beta)
    yield
    model.fit(X, y)
    yield
    predicted = model.predict(fresh)
    notes = {"error": miss(predicted, smooth(fresh))}
    if hasattr(model, "rcond_"):
        notes["rcond"] = f"{model.rcond_:.0e}"
    yield predicted, notes


def fit_limit(M):
    X = lattice(M)
    y = np.asfortranarray(smooth(X))

    def solved(X, y):
        K = cdist(X, X)
        np.fill_diagonal(K, 2.0 * len(X))  # positive definite without a kernel
        factor, info = dpotrf(K.T, lower=1, clean=0, overwrite_a=1)
        return dpotrs(factor, y, lower=1)[0], info

    solved(X[:200], y[:200])
    yield
    _, info = solved(X, y)
    yield
    assert info == 0
    yield None, {}


def predict(peer_name, n, M, beta, d=2, **parameters):
    if d == 2:
        X, fresh = lattice(M), lattice(n, offset=0.3)
    else:
        X = np.random.default_rng(0).uniform(size=(M, d))
        fresh = np.random.default_rng(1).uniform(size=(n, d))
    model = make(peer_name, beta, **parameters)
    model.fit(X, smooth(X))
    model.predict(fresh[:200])
    yield
    predicted = model.predict(fresh)
    yield
    # The other peers are compared in two dimensions.
    answer = predicted if d == 2 else None
    yield answer, {"error": miss(predicted, smooth(fresh))}


def predict_limit(n, M):
    distances = np.random.default_rng(0).uniform(0, 5, 2**15)  # a tile in the cache
    tile = np.exp(-distances)
    np.negative(distances, out=distances)
    yield
    for _ in range(n * M // len(tile)):
        np.exp(distances, out=tile)
    yield
    yield None, {}


# 4. search

KERNEL_NAMES = ("matern32", "matern52", "inverse_multiquadric", "gaussian")


def walking(path, n_rows, folds):
    """Delayed angles, the ankle 100 ms ahead, and the fold, evenly thinned out."""
    legs = [leg_angles(**leg, forward=0, up=1) for leg in load_trials(path).markers]
    angles, ankles = zip(*legs, strict=True)
    pairs = trajectory_pairs(list(angles), list(ankles), lag=15, delays=3, delay_step=5)
    n_rows = n_rows or len(pairs.X)
    rows = np.linspace(0, len(pairs.X) - 1, n_rows).astype(int)
    X = StandardScaler().fit_transform(pairs.X[rows])
    groups = pairs.groups[rows]
    if folds == "stride":  # blocks of about that length, 12 a trial
        starts = np.searchsorted(groups, groups)
        lengths = np.bincount(groups)[groups]
        groups = 12 * groups + 12 * (np.arange(len(groups)) - starts) // lengths
    return X, pairs.y[rows], groups


def grid(shape):
    """Names of kernels, scales and weights: so many of each."""
    n_kernels, n_betas, n_alphas = shape
    return (
        KERNEL_NAMES[:n_kernels],
        np.geomspace(1.0, 30.0, n_betas).tolist(),
        np.geomspace(1e-7, 1e-3, n_alphas).tolist(),
    )


def set_up(path, method, n_rows, separation, folds):
    """Data, a few of them to warm up, and parameters, with centres for all alike."""
    X, y, groups = walking(path, n_rows, folds)
    parameters = {"method": method}
    if method == "least_squares":
        selected = SeparatedCenterSelector(separation).fit(X)
        parameters["centers"] = selected.cluster_centers_
    few = np.linspace(0, len(X) - 1, 200).astype(int)
    return (X, y, groups), (X[few], y[few], groups[few]), parameters


def winner(name, beta, alpha):
    return f"{name}, beta={beta:.3g}, alpha={alpha:.0e}"


def search_closed(shape, **problem):
    from sklearn_koopman.search import KoopmanKernelRegressorCV

    (X, y, groups), few, parameters = set_up(**problem)
    kernels, betas, alphas = grid(shape)
    search = KoopmanKernelRegressorCV(
        kernels[:1], betas=betas[:1], alphas=alphas, cv=LeaveOneGroupOut(), **parameters
    )
    clone(search).set_params(centers=None).fit(few[0], few[1], groups=few[2])
    search.set_params(kernels=kernels, betas=betas)
    yield
    search.fit(X, y, groups=groups)
    yield
    best = search.best_kernel_, search.best_beta_, search.best_alpha_
    notes = {"winner": winner(*best), "rows": f"{len(X):,}"}
    notes |= {"centres": f"{len(search.centers_):,}", "folds": len(np.unique(groups))}
    yield closed_scores(search.cv_results_, *grid(shape)), notes


def closed_scores(results, *axes):
    """The scores in the order of the grid, whatever that of the results is."""
    keys = ("param_kernel", "param_beta", "param_alpha", "mean_test_score")
    rows = zip(*(results[key] for key in keys), strict=True)
    scores = {(name, beta, alpha): score for name, beta, alpha, score in rows}
    return np.array([scores[each] for each in itertools.product(*axes)])


def search_refits(peer_name, share, shape, **problem):
    """GridSearchCV, of a random share of the grid if that is below 1."""
    (X, y, groups), few, parameters = set_up(**problem)
    candidates = list(itertools.product(*grid(shape)))
    ours = peer_name == "KoopmanKernelRegressor"
    model = KoopmanKernelRegressor(**parameters) if ours else KernelRidge()

    def search_of(tried):
        entries = [
            {"kernel": [name], "beta": [beta], "alpha": [alpha]}
            if ours
            else {"kernel": [KERNELS[name](beta=beta)], "alpha": [alpha]}
            for name, beta, alpha in (candidates[i] for i in tried)
        ]
        options = {"refit": share == 1, "error_score": "raise"}
        return GridSearchCV(model, entries, cv=LeaveOneGroupOut(), **options)

    n_tried = max(round(share * len(candidates)), 1)
    tried = np.random.default_rng(0).permutation(len(candidates))[:n_tried]
    tried.sort()
    clone(model).fit(few[0], few[1])
    search = search_of(tried)
    yield
    search.fit(X, y, groups=groups)
    yield
    scores = np.full(len(candidates), np.nan)
    scores[tried] = search.cv_results_["mean_test_score"]
    notes = {"winner": winner(*candidates[np.nanargmax(scores)])}
    if share < 1:
        shown = f"{n_tried} of {len(candidates)} candidates"
        notes = {"times": len(candidates) / n_tried, "extrapolated from": shown}
    yield scores, notes


# 5. sparse


def on_torus(n, offset=0.0):
    return torus(*(2 * np.pi * lattice(n, offset).T))


def support(M, neighbors=40):
    """Radius in which a row has so many neighbours."""
    return np.sqrt(neighbors * AREA / (np.pi * M))


def wendland_matrix(X, centers, beta):
    """Sparse matrix of Wendland's C2 function of up to three features."""
    K = KDTree(X).sparse_distance_matrix(KDTree(centers), beta, output_type="ndarray")
    r = np.minimum(K["v"] / beta, 1.0)
    values = (1 - r) ** 4 * (4 * r + 1)
    return csc_array((values, (K["i"], K["j"])), shape=(len(X), len(centers)))


def residual(matrix, X, y, dual):
    """Relative residual of the equations, computed anew on some of the rows."""
    if len(dual) != len(X):
        return f"unknown, {len(X) - len(dual):,} centres dropped"
    rows = np.random.default_rng(2).choice(len(X), min(1000, len(X)), replace=False)
    missed = matrix(X[rows], X) @ dual - y[rows]
    return f"{np.linalg.norm(missed) / np.linalg.norm(y[rows]):.1e}"


def solver_notes(model):
    names = {
        "solver_": "by",
        "n_iter_": "iterations",
        "solver_residual_": "stated residual",
    }
    found = {names[key]: getattr(model, key, None) for key in names}
    return {
        key: f"{value:.2g}"
        if isinstance(value, float)
        else str(value).partition("(")[0]
        for key, value in found.items()
        if value is not None
    }


def sparse_fit(M):
    X, few = on_torus(M), on_torus(1000)
    y = smooth(X)
    beta = support(M)
    KoopmanKernelRegressor("wendland_c2", beta=support(1000)).fit(few, smooth(few))
    yield
    model = KoopmanKernelRegressor("wendland_c2", beta=beta).fit(X, y)
    yield
    left = residual(partial(wendland_matrix, beta=beta), X, y, model.dual_coef_)
    yield model.dual_coef_, {"residual": left, **solver_notes(model)}


def sparse_scipy(M, function):
    """Assembly and LU factors: by default, or in the mode for symmetric matrices."""

    def solved(X, y, beta):
        K = wendland_matrix(X, X, beta)
        if function == "spsolve":
            return spsolve(K, y)
        symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
        return splu(K, options={"SymmetricMode": True}, **symmetric).solve(y)

    X, few = on_torus(M), on_torus(1000)
    y = smooth(X)
    beta = support(M)
    solved(few, smooth(few), support(1000))
    yield
    dual = solved(X, y, beta)
    yield
    left = residual(partial(wendland_matrix, beta=beta), X, y, dual)
    yield dual, {"residual": left}


def sparse_predict(n, M, scipy=False):
    X, fresh = on_torus(M), on_torus(n, offset=0.3)
    beta = support(M)
    model = KoopmanKernelRegressor("wendland_c2", beta=beta).fit(X, smooth(X))

    def evaluated(fresh):
        if scipy:
            return wendland_matrix(fresh, X, beta) @ model.dual_coef_
        return model.predict(fresh)

    evaluated(fresh[:200])
    yield
    predicted = evaluated(fresh)
    yield
    yield predicted, {"error": miss(predicted, smooth(fresh))}


# 6. iterative


def iterative(M, beta, tol=None):
    """By conjugate gradients to a tolerance, or dense where that is None."""
    solver = "cholesky"
    if tol is not None:
        from sklearn_koopman.solvers import ConjugateGradient

        solver = ConjugateGradient(tol=tol)
    X = np.random.default_rng(0).uniform(size=(M, 2))
    y = smooth(X)
    model = KoopmanKernelRegressor("matern32", beta=beta, solver=solver)
    clone(model).fit(X[:300], y[:300])
    yield
    model.fit(X, y)
    yield
    fresh = lattice(1000, offset=0.3)
    predicted = model.predict(fresh)
    left = residual(Matern(beta, nu=1.5), X, y, model.dual_coef_)
    notes = {"residual": left, "error": miss(predicted, smooth(fresh))}
    yield predicted, notes | solver_notes(model)


# 7. stream


def stream(n, batch, separation, whole=False, deep=False):
    """Batches are made when asked for, which takes the same time for every peer."""
    selector(0.5, 1000, deep).fit(winding(0, 1000))
    selected = selector(separation, n, deep)
    starts = range(0, n, batch)
    yield
    if whole:
        selected.fit(np.concatenate([winding(i, i + batch) for i in starts]))
    else:
        for i in starts:
            selected.partial_fit(winding(i, i + batch))
    yield
    centers = centers_of(selected)
    yield centers, {"centres": f"{len(centers):,}"}


def update(M, n_new, beta, refit=False):
    X = lattice(M + n_new)
    y = smooth(X)
    model = KoopmanKernelRegressor("matern32", beta=beta)
    small = clone(model).fit(X[:200], y[:200])
    if not refit:
        small.partial_fit(X[200:220], y[200:220])
        model.fit(X[:M], y[:M])
    yield
    if refit:
        model.fit(X, y)
    else:
        model.partial_fit(X[M:], y[M:])
    yield
    fresh = lattice(1000, offset=0.3)
    predicted = model.predict(fresh)
    yield predicted, {"error": miss(predicted, smooth(fresh))}
