"""Displays of estimates, studies, centres, forecasts and spectra.

Every display computes in a class method such as `from_estimator`, stores the results,
and draws them in `plot`, on given axes or in a new figure. Only drawing needs
matplotlib: ``pip install "sklearn-koopman[plot]"``.
"""

from sklearn_koopman.plotting._centers import CenterSelectionDisplay
from sklearn_koopman.plotting._conditioning import ConditioningDisplay
from sklearn_koopman.plotting._convergence import ConvergenceDisplay
from sklearn_koopman.plotting._forecast import ForecastDisplay
from sklearn_koopman.plotting._spectrum import SpectrumDisplay
from sklearn_koopman.plotting._surface import SurfaceDisplay

__all__ = [
    "CenterSelectionDisplay",
    "ConditioningDisplay",
    "ConvergenceDisplay",
    "ForecastDisplay",
    "SpectrumDisplay",
    "SurfaceDisplay",
]
