"""How the past enters: copies or differences, and at which offsets.

Recorded walking of one person at four speeds, and a walking fly. One estimator serves
all rows of the table, so that they differ by the embedding alone: standardised states,
least squares on the 400 centres that are farthest from each other, a linear trend, and
beta and alpha from a small grid. As in walking.py, they are chosen on the folds that
judge them. A speed is left out at a time; "slow to fast" learns from the slowest alone
and predicts the fastest; of the fly's one recording, the second half is left out, or a
fifth at a time (the first is unlike the others, and makes up most of that error).
Prints root-mean-square errors beside those of an earlier estimator, whose settings and
folds on the fly were not recorded.

    python benchmarks/past.py path/to/walking_wbds01_T01-T04_left.npz

The fly's file is looked for beside that of the walking.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from scipy.linalg import LinAlgWarning
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressorCV,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials
from sklearn_koopman.kinematics import leg_angles

FEW, MANY, CLOSE = (0, 5, 10), (0, 1, 2, 5, 10), (0, 1, 2)
COPIES, DIFFERENCES = "copies", "differences"


def error(pairs, cv, groups=None):
    """Return the error of the best candidate, in the unit of the outputs."""
    search = KoopmanKernelRegressorCV(
        betas=[10.0, 25.0, 60.0],
        alphas=[1e-4, 1e-2, 1.0],
        centers=SeparatedCenterSelector(1e-6, order="farthest", max_centers=400),
        method="least_squares",
        trend="linear",
        scoring="neg_mean_squared_error",
        cv=cv,
    )
    states = StandardScaler().fit_transform(pairs.X)
    search.fit(states, pairs.y, groups=groups)
    return np.sqrt(-search.best_score_ * pairs.y.shape[1])


def show(title, pairs, cv, asked, unit, groups=None):
    before = f"{asked:8.3f}" if asked else " " * 8
    print(f"  {title:48s}{before}{error(pairs, cv, groups):8.3f} {unit}", flush=True)


def walking(path):
    legs = [leg_angles(**leg, forward=0, up=1) for leg in load_trials(path).markers]
    angles, ankles = (list(part) for part in zip(*legs, strict=True))
    for question, lag, in_state, rows in (
        (
            "one step ahead, outputs in the state",
            1,
            True,
            [
                (COPIES, FEW, 0.89),
                (COPIES, MANY, 0.76),
                (DIFFERENCES, FEW, None),
                (DIFFERENCES, MANY, None),
            ],
        ),
        (
            "100 ms ahead, outputs in the state",
            15,
            True,
            [
                (COPIES, FEW, 8.6),
                (DIFFERENCES, FEW, 7.1),
                (COPIES, MANY, None),
                (DIFFERENCES, MANY, None),
            ],
        ),
        (
            "one step ahead, angles alone",
            1,
            False,
            [
                (COPIES, FEW, None),
                (DIFFERENCES, FEW, None),
                (COPIES, CLOSE, None),
                (DIFFERENCES, CLOSE, None),
                (COPIES, MANY, None),
                (DIFFERENCES, MANY, None),
            ],
        ),
    ):
        print(f"{question}, a speed left out")
        for embedding, delays, asked in rows:
            pairs = trajectory_pairs(
                angles,
                ankles,
                lag=lag,
                delays=delays,
                embedding=embedding,
                outputs_in_state=in_state,
            )
            cv = TrajectoryKFold(4)
            show(f"{embedding} at {delays}", pairs, cv, asked, "mm", pairs.groups)
    print("one step ahead, outputs in the state, slow to fast")
    for embedding, delays, asked in (
        (COPIES, FEW, 1.77),
        (DIFFERENCES, FEW, None),
        (COPIES, MANY, None),
        (DIFFERENCES, MANY, 1.05),
    ):
        pairs = trajectory_pairs(
            angles, ankles, delays=delays, embedding=embedding, outputs_in_state=True
        )
        slow, fast = (np.flatnonzero(pairs.groups == trial) for trial in (0, 3))
        show(f"{embedding} at {delays}", pairs, [(slow, fast)], asked, "mm")


def fly(path):
    archive = np.load(path)
    claw = archive["keypoints"][:, -1]
    print("fly, one step ahead, outputs in the state")
    for embedding, delays, asked in (
        (COPIES, FEW, 0.069),
        (COPIES, MANY, 0.007),
        (DIFFERENCES, FEW, None),
        (DIFFERENCES, MANY, None),
    ):
        pairs = trajectory_pairs(
            archive["angles"],
            claw,
            delays=delays,
            embedding=embedding,
            outputs_in_state=True,
        )
        gap = 1 + delays[-1]
        first, second = np.array_split(np.arange(len(pairs.X)), 2)
        name = f"{embedding} at {delays}"
        show(f"{name}, second half", pairs, [(first[:-gap], second)], asked, "")
        show(f"{name}, fifths", pairs, TrajectoryKFold(5, gap=gap), None, "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", help="archive with hip, knee, ankle (mm) and trial")
    options = parser.parse_args()
    # Dropped centres are part of the search here, not news.
    warnings.simplefilter("ignore", LinAlgWarning)
    print(f"  {'':48s}{'before':>8s}{'found':>8s}")
    walking(options.data)
    file = Path(options.data).with_name("fly_front_leg_left.npz")
    if file.is_file():
        fly(file)


if __name__ == "__main__":
    main()
