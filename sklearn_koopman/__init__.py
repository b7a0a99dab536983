"""Koopman operators from motion data, as scikit-learn estimators."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._utils._warnings import ExtrapolationWarning
from .centers import SeparatedCenterSelector
from .edmd import KernelEDMD, forecast
from .forecaster import Analogs, KoopmanForecaster
from .regression import KoopmanKernelRegressor
from .scoring import make_forecast_scorer, make_horizon_scorer, make_valid_time_scorer
from .search import KoopmanKernelRegressorCV
from .trajectories import (
    TrajectoryKFold,
    current_states,
    join_recordings,
    trajectory_pairs,
)

if TYPE_CHECKING:
    from . import datasets, diagnostics, kinematics, plotting

__all__ = [
    "Analogs",
    "ExtrapolationWarning",
    "KernelEDMD",
    "KoopmanForecaster",
    "KoopmanKernelRegressor",
    "KoopmanKernelRegressorCV",
    "SeparatedCenterSelector",
    "TrajectoryKFold",
    "current_states",
    "datasets",
    "diagnostics",
    "forecast",
    "join_recordings",
    "kinematics",
    "make_forecast_scorer",
    "make_horizon_scorer",
    "make_valid_time_scorer",
    "plotting",
    "trajectory_pairs",
]

__version__ = "0.1.0"

_LAZY = frozenset({"datasets", "diagnostics", "kinematics", "plotting"})

# Hidden from type checkers, which would take any name for an attribute.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Import a module when it is first used."""
        if name in _LAZY:
            # Python has a lock for each module, so that threads wait for each other.
            return import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
