"""From marker positions to gap-free recordings, joint angles and rotations."""

from ._gaps import fill_gaps, unwrap_angles
from ._legs import leg_angles

__all__ = ["fill_gaps", "leg_angles", "unwrap_angles"]
