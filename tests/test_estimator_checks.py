"""scikit-learn's own checks, with none expected to fail."""

import pytest
from scipy.spatial.distance import cdist
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.utils.estimator_checks import (
    check_dataframe_column_names_consistency,
    check_get_feature_names_out_error,
    check_global_output_transform_pandas,
    check_set_output_transform,
    check_set_output_transform_pandas,
    check_transformer_get_feature_names_out,
    check_transformer_get_feature_names_out_pandas,
    parametrize_with_checks,
)
from sklearn.utils.validation import check_is_fitted, validate_data

from sklearn_koopman import (
    KernelEDMD,
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
)
from sklearn_koopman.kernels import KERNELS, Wendland

SELECTORS = [
    SeparatedCenterSelector(),
    SeparatedCenterSelector(0.5),
    SeparatedCenterSelector(order="farthest"),
    SeparatedCenterSelector(0.0, order="farthest", max_centers=3),
]
CENTERS = [
    None,
    SeparatedCenterSelector(0.1),
    SeparatedCenterSelector(1.0),
    SeparatedCenterSelector(0.0, order="farthest", max_centers=150),
]


class OnDistances(RegressorMixin, BaseEstimator):
    """Computes the distances to its training rows for ``centers="precomputed"``."""

    def __init__(self, method="interpolation", trend=None):
        self.method = method
        self.trend = trend

    def fit(self, X, y):
        X, y = validate_data(self, X, y, y_numeric=True, dtype=float)
        self.rows_ = SeparatedCenterSelector(0.0).fit(X).cluster_centers_
        self.model_ = KoopmanKernelRegressor(
            centers="precomputed", method=self.method, trend=self.trend, alpha=0.01
        ).fit(cdist(X, self.rows_), y)
        return self

    def predict(self, X):
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=float)
        return self.model_.predict(cdist(X, self.rows_))


REGRESSORS = [
    *(
        OnDistances(method, trend)
        for method in ("interpolation", "least_squares")
        for trend in (None, "constant")
    ),
    *(
        KoopmanKernelRegressor(centers=centers, method=method, trend=trend)
        for centers in CENTERS
        for method in ("interpolation", "least_squares")
        for trend in (None, "constant", "linear")
    ),
    *(KoopmanKernelRegressor(kernel, beta=0.3) for kernel in KERNELS),
    KoopmanKernelRegressor(Wendland(5.0, 4), n_jobs=2),
    KoopmanKernelRegressor(1.0 * RBF() + WhiteKernel(0.1)),
    KoopmanKernelRegressor(solver="cholesky"),
]

OPERATORS = [
    *(
        KernelEDMD(centers=centers, method=method, trend=trend)
        for centers in (None, SeparatedCenterSelector(0.1))
        for method in ("interpolation", "least_squares")
        for trend in (None, "constant", "linear")
    ),
    KernelEDMD(centers=SeparatedCenterSelector(1.0), method="least_squares"),
    KernelEDMD("wendland_c4", beta=5.0, n_modes=0, n_jobs=2),
    KernelEDMD(beta=0.1, n_modes=150),
]


@parametrize_with_checks([*SELECTORS, *REGRESSORS, *OPERATORS])
def test_scikit_learn_check(estimator, check):
    check(estimator)


@pytest.mark.parametrize(
    "estimator", [SELECTORS[0], REGRESSORS[4], REGRESSORS[9], OPERATORS[0]]
)
def test_column_names(estimator):
    check_dataframe_column_names_consistency("name", estimator)


# The checks mix frames and arrays on purpose.
@pytest.mark.filterwarnings("ignore:X .* feature names")
@pytest.mark.parametrize(
    "check",
    [
        check_transformer_get_feature_names_out,
        check_transformer_get_feature_names_out_pandas,
        check_get_feature_names_out_error,
        check_set_output_transform,
        check_set_output_transform_pandas,
        check_global_output_transform_pandas,
    ],
)
@pytest.mark.parametrize("estimator", SELECTORS[:3])
def test_transformer_check(estimator, check):
    check("name", estimator)
