"""What a regressor stores after a fit, however the fit was made."""

from typing import NamedTuple

import numpy as np

from .._linalg._fit import Fit
from .._linalg._systems import System
from .._utils._rows import AveragedOutputs
from .._utils._typing import Array, Indices


class Estimate(NamedTuple):
    """A fit, the system that it was made with, and the data behind it."""

    system: System
    fit: Fit
    rows: Indices | None  # which rows the centres are, where that is known
    averages: AveragedOutputs | None  # outputs at the centres, if it interpolates them


def keep_averages(
    averages: AveragedOutputs, fit: Fit, kept: Indices, points: Array
) -> AveragedOutputs:
    """Return the outputs at the centres that are kept.

    The residuals at the centres that were dropped count as scatter.
    """
    dropped = np.setdiff1d(np.arange(len(points)), kept)
    scatter = averages.scatter
    if len(dropped):
        residual = averages.means[dropped] - fit.expansion(points[dropped])
        scatter = scatter + averages.counts[dropped] @ residual**2
    return AveragedOutputs(averages.means[kept], averages.counts[kept], scatter)
