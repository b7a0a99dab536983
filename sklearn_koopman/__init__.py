"""Koopman operators from motion data, as scikit-learn estimators."""

from sklearn_koopman.centers import SeparatedCenterSelector
from sklearn_koopman.regression import KoopmanKernelRegressor
from sklearn_koopman.trajectories import TrajectoryKFold, trajectory_pairs

__all__ = [
    "KoopmanKernelRegressor",
    "SeparatedCenterSelector",
    "TrajectoryKFold",
    "trajectory_pairs",
]

__version__ = "0.1.0"
