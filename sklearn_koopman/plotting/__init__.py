"""Displays of estimates, studies, centres, forecasts and spectra.

Every display computes in a class method such as `from_estimator`, stores the results,
and draws them in `plot`, on given axes or in a new figure. Only drawing needs
matplotlib: ``pip install "sklearn-koopman[plot]"``.
"""

from ._analogs import AnalogDisplay
from ._centers import CenterSelectionDisplay
from ._conditioning import ConditioningDisplay
from ._convergence import ConvergenceDisplay
from ._forecast import ForecastDisplay
from ._horizons import HorizonErrorDisplay
from ._spectrum import SpectrumDisplay
from ._surface import SurfaceDisplay

__all__ = [
    "AnalogDisplay",
    "CenterSelectionDisplay",
    "ConditioningDisplay",
    "ConvergenceDisplay",
    "ForecastDisplay",
    "HorizonErrorDisplay",
    "SpectrumDisplay",
    "SurfaceDisplay",
]
