"""Motion to try things on: simulated pendulum and leg, and files of markers."""

from sklearn_koopman.datasets._markers import load_markers
from sklearn_koopman.datasets._pendulum import make_pendulum
from sklearn_koopman.datasets._trials import load_trials
from sklearn_koopman.datasets._walking import make_walking

__all__ = ["load_markers", "load_trials", "make_pendulum", "make_walking"]
