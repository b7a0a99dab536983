"""Koopman operators from motion data, as scikit-learn estimators."""

from sklearn_koopman.centers import SeparatedCenterSelector
from sklearn_koopman.edmd import KernelEDMD
from sklearn_koopman.regression import KoopmanKernelRegressor
from sklearn_koopman.scoring import make_forecast_scorer, make_valid_time_scorer
from sklearn_koopman.search import KoopmanKernelRegressorCV
from sklearn_koopman.trajectories import TrajectoryKFold, trajectory_pairs

__all__ = [
    "KernelEDMD",
    "KoopmanKernelRegressor",
    "KoopmanKernelRegressorCV",
    "SeparatedCenterSelector",
    "TrajectoryKFold",
    "make_forecast_scorer",
    "make_valid_time_scorer",
    "trajectory_pairs",
]

__version__ = "0.1.0"
