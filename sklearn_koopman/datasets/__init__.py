"""Motion to try things on: simulated pendulum and leg, and files of markers."""

from ._angles import load_angles
from ._markers import load_markers
from ._movement import markers_from_movement
from ._pendulum import make_pendulum
from ._trials import load_trials
from ._walking import make_walking

__all__ = [
    "load_angles",
    "load_markers",
    "load_trials",
    "make_pendulum",
    "make_walking",
    "markers_from_movement",
]
