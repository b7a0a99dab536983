"""From marker positions to gap-free recordings, joint angles and rotations."""

from ._gaps import fill_gaps, unwrap_angles
from ._legs import leg_angles, leg_length
from ._rotations import RotationEncoder

__all__ = ["RotationEncoder", "fill_gaps", "leg_angles", "leg_length", "unwrap_angles"]
