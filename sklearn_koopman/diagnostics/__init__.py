"""How good an estimate can be, and is: geometry, conditioning, rates, calibration."""

from ._calibration import calibration_study
from ._conditioning import condition_number, digits_lost, smallest_eigenvalue
from ._geometry import (
    fill_distance,
    intrinsic_dimension,
    mesh_ratio,
    separation_distance,
)
from ._rates import sobolev_rates
from ._studies import conditioning_study, convergence_study, crowding_study

__all__ = [
    "calibration_study",
    "condition_number",
    "conditioning_study",
    "convergence_study",
    "crowding_study",
    "digits_lost",
    "fill_distance",
    "intrinsic_dimension",
    "mesh_ratio",
    "separation_distance",
    "smallest_eigenvalue",
    "sobolev_rates",
]
