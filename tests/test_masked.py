"""Masked values, which every conversion to an array makes values again."""

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    diagnostics,
    forecast,
    make_forecast_scorer,
)
from sklearn_koopman.datasets import make_pendulum

X = make_pendulum(40).trajectories[0]
BEFORE, AFTER, INDEX = X[:-1], X[1:], np.arange(41)
REGRESSOR = KoopmanKernelRegressor().fit(BEFORE, AFTER)
BATCHES = KoopmanKernelRegressor(centers=SeparatedCenterSelector(0.2))
SEARCH = KoopmanKernelRegressorCV(betas=[1.0, 2.0]).fit(BEFORE, AFTER)
EDMD = KernelEDMD(n_modes=3).fit(X)
PIPELINE = make_pipeline(StandardScaler(), KernelEDMD(n_modes=0)).fit(X)
SELECTOR = SeparatedCenterSelector(0.5).fit(X)
SCORER = make_forecast_scorer(3)


def batch(x, y):
    return BATCHES.fit(BEFORE, AFTER).partial_fit(x, y)


# The parameter, what it is given, and where.
TAKEN = {
    "EDMD": ("X", X, KernelEDMD(n_modes=0).fit),
    "EDMD, outputs": ("y", AFTER, lambda y: EDMD.fit(BEFORE, y)),
    "EDMD, successors": ("X_next", AFTER, lambda x: EDMD.fit(BEFORE, X_next=x)),
    "EDMD, clock": ("sample_index", INDEX, lambda i: EDMD.fit(X, sample_index=i)),
    "EDMD, centres": (
        "centers",
        X[:9],
        lambda c: KernelEDMD(centers=c, n_modes=0).fit(X),
    ),
    "EDMD.predict": ("X", X, EDMD.predict),
    "EDMD.forecast": ("X", X, lambda x: EDMD.forecast(x, 2)),
    "EDMD.eigenfunctions": ("X", X, EDMD.eigenfunctions),
    "EDMD.power_function": ("X", X, EDMD.power_function),
    "EDMD.score": ("X", BEFORE, lambda x: EDMD.score(x, AFTER)),
    "forecast": ("X", X, lambda x: forecast(PIPELINE, x, 2)),
    "scorer": ("X", X, lambda x: SCORER(PIPELINE, x)),
    "scorer, outputs": ("y", AFTER, lambda y: SCORER(EDMD, BEFORE, y)),
    "scorer, clock": ("sample_index", INDEX, lambda i: SCORER(EDMD, X, None, i)),
    "regressor": ("X", BEFORE, lambda x: KoopmanKernelRegressor().fit(x, AFTER)),
    "regressor, outputs": (
        "y",
        AFTER,
        lambda y: KoopmanKernelRegressor().fit(BEFORE, y),
    ),
    "regressor, centres": (
        "centers",
        BEFORE[:9],
        lambda c: KoopmanKernelRegressor(centers=c).fit(BEFORE, AFTER),
    ),
    "first batch": (
        "X",
        BEFORE,
        lambda x: KoopmanKernelRegressor().partial_fit(x, AFTER),
    ),
    "batch": ("X", 2 + BEFORE, lambda x: batch(x, AFTER)),
    "batch, outputs": ("y", AFTER, lambda y: batch(2 + BEFORE, y)),
    "regressor.predict": ("X", X, REGRESSOR.predict),
    "regressor.power_function": ("X", X, REGRESSOR.power_function),
    "regressor.error_bound": ("X", X, REGRESSOR.error_bound),
    "search": ("X", BEFORE, lambda x: SEARCH.fit(x, AFTER)),
    "search, outputs": ("y", AFTER, lambda y: SEARCH.fit(BEFORE, y)),
    "search.predict": ("X", X, SEARCH.predict),
    "selector": ("X", X, SeparatedCenterSelector(0.5).fit),
    "selector.fit_predict": ("X", X, SeparatedCenterSelector(0.5).fit_predict),
    "selector.partial_fit": ("X", X, SeparatedCenterSelector(0.5).partial_fit),
    "selector.transform": ("X", X, SELECTOR.transform),
    "selector.predict": ("X", X, SELECTOR.predict),
    "calibration_study": (
        "X",
        BEFORE,
        lambda x: diagnostics.calibration_study(REGRESSOR, x, AFTER, cv=2),
    ),
    "condition_number": (
        "centers",
        X[:9],
        lambda x: diagnostics.condition_number("matern32", x),
    ),
    "smallest_eigenvalue": (
        "centers",
        X[:9],
        lambda x: diagnostics.smallest_eigenvalue("matern32", x),
    ),
    "conditioning_study": (
        "X",
        X,
        lambda x: diagnostics.conditioning_study("matern32", [1.0], x, [0.3, 0.5]),
    ),
    "convergence_study": (
        "y_test",
        AFTER,
        lambda y: diagnostics.convergence_study(
            KoopmanKernelRegressor(), BEFORE, AFTER, [0.4, 0.8], BEFORE, y
        ),
    ),
    "crowding_study": (
        "X",
        X,
        lambda x: diagnostics.crowding_study("matern32", x, [0.5], [0.1]),
    ),
    "fill_distance": ("reference", X, lambda x: diagnostics.fill_distance(X[:9], x)),
    "separation_distance": (
        "centers",
        X,
        lambda x: diagnostics.separation_distance(x, X),
    ),
    "mesh_ratio": ("reference", X, lambda x: diagnostics.mesh_ratio(X[:9], x)),
    "intrinsic_dimension": ("X", X, diagnostics.intrinsic_dimension),
}


@pytest.mark.parametrize(("name", "values", "take"), TAKEN.values(), ids=TAKEN)
@pytest.mark.filterwarnings("ignore::UserWarning")  # of small studies
def test_masked_values_are_refused(name, values, take):
    masked = np.ma.array(values, copy=True)
    take(masked)  # nothing is masked
    masked[3:5] = np.ma.masked
    masked.data[3] = 9000
    count = 2 * (1 if masked.ndim == 1 else masked.shape[1])
    with pytest.raises(ValueError, match=f"{name} holds {count} masked values; fill"):
        take(masked)
