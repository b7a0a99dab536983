"""Whether stated standard deviations hold on real walking that was left out.

Treadmill walking of one person at four speeds, the ankle 100 ms ahead. Stretches of the
recordings are left out whose speed was learned from, then each whole speed. Prints the
ratio of errors to their standard deviations, and the coverage of 95 % intervals.

    python benchmarks/calibration.py path/to/walking_wbds01_T01-T04_left.npz
"""

import sys

import numpy as np
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials
from sklearn_koopman.diagnostics import calibration_study
from sklearn_koopman.kinematics import leg_angles

STRETCH = 400  # rows, some two strides


def main(path):
    legs = [leg_angles(**leg, forward=0, up=1) for leg in load_trials(path).markers]
    angles, ankles = zip(*legs, strict=True)
    pairs = trajectory_pairs(list(angles), list(ankles), lag=15, delays=3, delay_step=5)
    model = make_pipeline(
        StandardScaler(),
        KoopmanKernelRegressor(
            beta=10.0,
            centers=SeparatedCenterSelector(0.3),
            method="least_squares",
            alpha=1e-3,
        ),
    )
    starts = np.flatnonzero(np.diff(pairs.groups, prepend=-1))
    place = np.arange(len(pairs.X)) - starts[pairs.groups]
    stretches = 1000 * pairs.groups + place // STRETCH
    for name, groups, n_folds in (
        ("stretches of known speeds", stretches, 6),
        ("whole speeds", pairs.groups, len(legs)),
    ):
        study = calibration_study(
            model,
            *(pairs.X, pairs.y),
            groups=groups,
            cv=TrajectoryKFold(n_folds),
            levels=[0.95],
        )
        folds = ", ".join(f"{ratio:.2f}" for ratio in study.fold_ratio)
        print(
            f"{name + ' left out:':36} error / deviation {study.ratio:.2f} "
            f"(by fold {folds}), {study.coverage[0]:.1%} in 95 % intervals"
        )


if __name__ == "__main__":
    main(sys.argv[1])
