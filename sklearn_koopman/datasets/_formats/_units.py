"""Units of positions, checked by the size of a body."""

import numpy as np

from ..._utils._typing import Array
from ._recording import PIXELS

IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# As files spell them out; the British end in -metre.
SPELLED_OUT = {"millimeters": "mm", "centimeters": "cm", "meters": "m"}
SPELLED_OUT |= {name.removesuffix("s"): unit for name, unit in SPELLED_OUT.items()}
# Units that are not returned: their names, the unit to ask for instead, and the factor.
INCHES, FEET = ("inches", "mm", 25.4), ("feet", "mm", 304.8)
DECIMETERS, MICROMETERS = ("decimetres", "mm", 100.0), ("micrometres", "mm", 0.001)
OTHERS = {
    **dict.fromkeys(("in", "inch", "inches", '"'), INCHES),
    **dict.fromkeys(("ft", "foot", "feet"), FEET),
    **dict.fromkeys(("dm", "decimeter", "decimeters"), DECIMETERS),
    **dict.fromkeys(
        ("um", "\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"), MICROMETERS
    ),
    **dict.fromkeys(("micrometer", "micrometers"), MICROMETERS),
}
# Markers of a body that are closer together than this, in mm, or farther apart, have
# the unit that brings them nearest to the usual size.
MIN_BODY_SIZE, USUAL_BODY_SIZE, MAX_BODY_SIZE = 200.0, 1000.0, 3000.0


def spell(claimed: str) -> str:
    """Return the short name of the unit that a file claims."""
    name = claimed.lower().replace("metre", "meter")
    unit = SPELLED_OUT.get(name, name)
    if unit in OTHERS:
        other, unit, factor = OTHERS[unit]
        raise ValueError(
            f"the file is in {other}: pass unit={unit!r}, and multiply the positions "
            f"by {factor:g}."
        )
    if unit not in (*IN_MM, PIXELS):
        raise ValueError(
            f"the file gives {claimed!r} as its unit, not 'mm', 'cm' or 'm'; pass "
            "unit, which wins over the file."
        )
    return unit


def check_size(unit: str, cloud: Array) -> None:
    """Refuse a unit of a file in which the body has another size.

    The cloud has the shape (n_markers, n_frames, n_axes). Pixels have no size.
    """
    if unit == PIXELS:
        return
    # Unlike max and min, these ignore NaN.
    extents = np.fmax.reduce(cloud) - np.fmin.reduce(cloud)
    sizes = np.fmax.reduce(extents, axis=1)
    sizes = sizes[sizes > 0]  # frames with several markers
    if not len(sizes):
        return
    size = float(np.median(sizes))
    is_usual = MIN_BODY_SIZE <= size * IN_MM[unit] <= MAX_BODY_SIZE
    likely = min(IN_MM, key=lambda u: abs(np.log(size * IN_MM[u] / USUAL_BODY_SIZE)))
    if not is_usual and likely != unit:
        raise ValueError(
            f"the markers of a frame are {size:.3g} apart, like {likely} instead of "
            f"{unit}; pass unit={likely!r}, or unit={unit!r} if the file is right."
        )
