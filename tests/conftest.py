import os
from pathlib import Path

# Before NumPy and SciPy are imported. Without the first, scikit-learn skips its array
# API check. Threads of OpenBLAS do not pay for the many small matrices here. Where they
# are asked for, they sleep after a few cycles without work: they wait actively for some
# 20 ms otherwise, which is several times slower where others need the processor.
os.environ["SCIPY_ARRAY_API"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

import pytest

from sklearn_koopman.datasets import load_trials
from sklearn_koopman.kinematics import leg_angles

# Recorded motion is not part of the package.
DATA = Path(__file__).parents[1] / os.environ.get(
    "SKLEARN_KOOPMAN_DATA", "../shared/data"
)


@pytest.fixture(scope="session")
def data_file():
    """Return the path of a file of recorded motion, or skip without its folder."""

    def find(name):
        if not (DATA / name).is_file():
            pytest.skip(f"no {name}; set SKLEARN_KOOPMAN_DATA to its folder")
        return DATA / name

    return find


@pytest.fixture(scope="session")
def walking_file(data_file):
    """Four treadmill trials, one a speed."""
    return data_file("walking_wbds01_T01-T04_left.npz")


@pytest.fixture(scope="session")
def walking(walking_file):
    """Angles and ankle positions (mm) of the four trials."""
    trials = load_trials(walking_file).markers
    legs = [leg_angles(**markers, forward=0, up=1) for markers in trials]
    return [angles for angles, _ in legs], [ankle for _, ankle in legs]
