"""scikit-learn's own checks."""

from itertools import cycle

import pytest
from designs import covering
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

from sklearn_koopman import KernelEDMD, KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.kernels import KERNELS, Wendland
from sklearn_koopman.kinematics import RotationEncoder


class OnDistances(RegressorMixin, BaseEstimator):
    """Computes the distances to its training rows for ``centers="precomputed"``."""

    def __init__(self, method="interpolation", trend=None):
        self.method = method
        self.trend = trend

    def fit(self, X, y):
        X, y = validate_data(self, X, y, y_numeric=True, dtype=float)
        self.rows_ = SeparatedCenterSelector(0.0).fit(X).cluster_centers_
        self.model_ = KoopmanKernelRegressor(
            beta=1.0,
            centers="precomputed",
            method=self.method,
            trend=self.trend,
            alpha=0.01,
        ).fit(cdist(X, self.rows_), y)
        return self

    def predict(self, X):
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=float)
        return self.model_.predict(cdist(X, self.rows_))


# Narrow kernels keep all matrices regular, but do not reach all states of the checks.
# The data of the checks are neither scaled nor angles.
pytestmark = pytest.mark.filterwarnings(
    "ignore::sklearn_koopman.ExtrapolationWarning", "ignore:angles of X reach"
)

SELECTORS = [
    SeparatedCenterSelector(),
    SeparatedCenterSelector(0.5),
    SeparatedCenterSelector(0.0, order="farthest", max_centers=3),
]
# Quaternions are of length 1, which the data of the checks are not.
ENCODERS = [
    RotationEncoder(),
    RotationEncoder([0], unit="degrees"),
    RotationEncoder([]),
    RotationEncoder(rotation_vectors=[0, 1, 2]),
]
# Every option of every estimator once. The checks are of the interface, which depends
# on the forms that fitted attributes have, and hardly on numbers.
REGRESSORS = [
    KoopmanKernelRegressor(),
    KoopmanKernelRegressor(
        "matern12",
        beta=0.3,
        centers=SeparatedCenterSelector(0.1),
        method="least_squares",
        trend="constant",
    ),
    KoopmanKernelRegressor(
        Wendland(5.0, 4), centers=SeparatedCenterSelector(0.5), trend="linear", n_jobs=2
    ),
    KoopmanKernelRegressor(
        "inverse_multiquadric",
        beta=0.3,
        centers=SeparatedCenterSelector(0.0, order="farthest", max_centers=150),
        method="least_squares",
        trend="linear",
    ),
    KoopmanKernelRegressor(1.0 * RBF() + WhiteKernel(0.1), trend="constant"),
    KoopmanKernelRegressor("gaussian", beta=0.3, solver="cholesky"),
    OnDistances("least_squares", "constant"),
]
OPERATORS = [
    KernelEDMD(),
    KernelEDMD(
        centers=SeparatedCenterSelector(0.1),
        method="least_squares",
        trend="linear",
        n_modes=150,
    ),
    KernelEDMD("wendland_c4", beta=20.0, trend="constant", n_modes=0, n_jobs=2),
]

# Every pair of centres, method and trend, and with them every kernel.
CENTERS = [
    None,
    SeparatedCenterSelector(0.1),
    SeparatedCenterSelector(),
    SeparatedCenterSelector(0.0, order="farthest", max_centers=150),
]
METHODS = ["interpolation", "least_squares"]
TRENDS = [None, "constant", "linear"]
PAIRS = [
    SeparatedCenterSelector(0.5),
    SeparatedCenterSelector(order="farthest"),
    OnDistances(),
    *(
        KoopmanKernelRegressor(
            kernel, beta=0.3, centers=centers, method=method, trend=trend
        )
        for kernel, (centers, method, trend) in zip(
            cycle(KERNELS),
            covering(centers=CENTERS, method=METHODS, trend=TRENDS),
            strict=False,
        )
    ),
    *(
        KernelEDMD(centers=centers, method=method, trend=trend)
        for centers, method, trend in covering(
            centers=CENTERS[:2], method=METHODS, trend=TRENDS
        )
    ),
]


def expected_failed_checks(estimator):
    """Name the check that compares weights with repeated rows in another order.

    Without successors, the order of the rows is that of time for an operator.
    """
    if not isinstance(estimator, KernelEDMD):
        return {}
    return {"check_sample_weight_equivalence_on_dense_data": "the order matters"}


@parametrize_with_checks(
    [*SELECTORS, *ENCODERS[:3], *REGRESSORS, *OPERATORS],
    expected_failed_checks=expected_failed_checks,
)
def test_scikit_learn_check(estimator, check):
    check(estimator)


@pytest.mark.slow
@parametrize_with_checks(PAIRS, expected_failed_checks=expected_failed_checks)
def test_scikit_learn_check_of_pairs_of_options(estimator, check):
    check(estimator)


@pytest.mark.parametrize(
    "estimator", [SELECTORS[0], ENCODERS[0], REGRESSORS[1], REGRESSORS[6], OPERATORS[0]]
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
@pytest.mark.parametrize("estimator", [*SELECTORS, *ENCODERS])
def test_transformer_check(estimator, check):
    check("name", estimator)
