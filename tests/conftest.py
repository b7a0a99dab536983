import os
from pathlib import Path

# Before NumPy and SciPy are imported. Without the first, scikit-learn skips its array
# API check. With the second, threads of OpenBLAS sleep after a few cycles without work:
# they wait actively for some 20 ms otherwise, which makes work with the many small
# matrices here several times slower wherever something else needs the processor.
os.environ["SCIPY_ARRAY_API"] = "1"
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

import numpy as np
import pytest

from sklearn_koopman.kinematics import leg_angles


@pytest.fixture(scope="session")
def walking():
    """Angles and ankle positions (mm) of the four treadmill trials, one a speed."""
    folder = Path(__file__).parents[1] / os.environ.get(
        "SKLEARN_KOOPMAN_DATA", "../shared/data"
    )
    path = folder / "walking_wbds01_T01-T04_left.npz"
    if not path.exists():
        pytest.skip("recorded walking is not part of the package; its folder is absent")
    data = np.load(path)
    angles, ankles = [], []
    for trial in np.unique(data["trial"]):
        rows = data["trial"] == trial
        markers = {joint: data[joint][rows] for joint in ("hip", "knee", "ankle")}
        state, ankle = leg_angles(**markers, forward=0, up=1)
        angles.append(state)
        ankles.append(ankle)
    return angles, ankles
