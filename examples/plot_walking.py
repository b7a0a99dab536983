"""
==========================================
Predict an ankle from the angles of a leg
==========================================

Where will the ankle be in a tenth of a second? The states are the hip and knee
flexion of a walking person, the output is the position of the ankle relative to the
hip. Scale, separation and kernel of the estimate are searched for by leaving out one
stride at a time, and the model is then tried on strides that the search never saw.

By default this reads the overground trial of a healthy adult that the package
`gaitkit` carries (subject 1 of Fukuchi, Fukuchi and Duarte 2018, CC BY 4.0). Your own
marker file goes the same way::

    python examples/plot_walking.py --data trial.trc --hip R.GTR --knee R.Knee \
--ankle R.Ankle
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_markers
from sklearn_koopman.kinematics import leg_angles

JOINTS = ("hip", "knee", "ankle")


def read_arguments(arguments=None):
    parser = argparse.ArgumentParser(
        description="Predict where the ankle will be, from hip and knee flexion."
    )
    parser.add_argument("--data", help="marker file: tab-separated text or .trc")
    parser.add_argument(
        "--rate",
        type=float,
        default=150.0,
        help="frames per second of a tab-separated file (default: %(default)s)",
    )
    parser.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the markers")
    for joint, names in (
        ("hip", ["R.GTR", "L.GTR"]),
        ("knee", ["R.Knee", "L.Knee"]),
        ("ankle", ["R.Ankle", "L.Ankle"]),
    ):
        parser.add_argument(
            f"--{joint}",
            nargs="+",
            default=names,
            help=f"{joint} markers in the file, one a leg (default: %(default)s)",
        )
    parser.add_argument(
        "--forward",
        type=int,
        default=0,
        help="column of the direction of walking (default: %(default)s)",
    )
    parser.add_argument(
        "--up",
        type=int,
        default=1,
        help="column of the vertical (default: %(default)s)",
    )
    parser.add_argument(
        "--ahead",
        type=float,
        default=0.1,
        help="how far ahead to predict, in seconds (default: %(default)s)",
    )
    parser.add_argument(
        "--pieces",
        type=int,
        default=3,
        help="into how many pieces to cut the recording of each leg, the last of "
        "which is held out; about a stride each is best (default: %(default)s)",
    )
    parser.add_argument(
        "--figure", default="walking.png", help="where to save (default: %(default)s)"
    )
    return parser.parse_args(arguments)


def read_legs(options):
    """Return the markers of each leg in mm, and the frame rate."""
    if options.data is None:
        import gaitkit

        trial = gaitkit.load_example("healthy")
        print(f"{trial['description']} ({trial['source']})")
        frames = [frame["landmark_positions"] for frame in trial["angle_frames"]]
        legs = [
            {
                joint: np.array([f[f"{side}_{joint}"] for f in frames])
                for joint in JOINTS
            }
            for side in ("right", "left")
        ]
        return legs, float(trial["fps"])
    names = [getattr(options, joint) for joint in JOINTS]
    if len({len(of_joint) for of_joint in names}) > 1:
        raise SystemExit("Name one hip, one knee and one ankle marker for each leg.")
    recording = load_markers(
        options.data,
        markers=[n for of_joint in names for n in of_joint],
        rate=options.rate,
        unit=options.unit,
    )
    in_mm = {"mm": 1.0, "cm": 10.0, "m": 1000.0}[recording.unit]
    legs = [
        {
            joint: in_mm * recording.markers[n]
            for joint, n in zip(JOINTS, leg, strict=True)
        }
        for leg in zip(*names, strict=True)
    ]
    return legs, recording.rate


def rms(error):
    """Root mean square length of vectors."""
    return np.sqrt((error**2).sum(axis=1).mean())


def main(arguments=None):
    options = read_arguments(arguments)
    legs, rate = read_legs(options)
    lag = max(round(options.ahead * rate), 1)

    # Each piece of each leg is a trajectory of its own: no pair reaches from one into
    # the next. The last piece of each leg is kept for the test.
    angles, ankles, held_out = [], [], []
    for leg in legs:
        state, ankle = leg_angles(**leg, forward=options.forward, up=options.up)
        for number, piece in enumerate(
            np.array_split(np.arange(len(state)), options.pieces)
        ):
            angles.append(state[piece])
            ankles.append(ankle[piece])
            held_out.append(number == options.pieces - 1)

    # Two angles are the same in swing and in stance; their past distinguishes these.
    step = max(round(rate / 30), 1)
    pairs = trajectory_pairs(angles, ankles, lag=lag, delays=3, delay_step=step)
    test = np.array(held_out)[pairs.groups]
    train = ~test
    print(
        f"{len(angles)} trajectories of {len(legs)} legs at {rate:g} Hz; "
        f"{train.sum()} pairs to learn from, {test.sum()} to test; "
        f"the ankle {1000 * lag / rate:.0f} ms ahead"
    )

    model = Pipeline(
        [
            ("scale", StandardScaler()),
            (
                "koopman",
                KoopmanKernelRegressor(
                    centers=SeparatedCenterSelector(),
                    method="least_squares",
                    alpha=1e-3,
                ),
            ),
        ]
    )
    search = GridSearchCV(
        model,
        {
            "koopman__centers__separation": [0.1, 0.2, 0.4],
            "koopman__kernel": ["matern32", "matern52", "wendland_c4"],
            "koopman__beta": [3.0, 10.0, 30.0],
        },
        scoring="neg_root_mean_squared_error",
        cv=TrajectoryKFold(len(np.unique(pairs.groups[train]))),
        n_jobs=2,
        verbose=1,
    )
    search.fit(pairs.X[train], pairs.y[train], groups=pairs.groups[train])
    best = search.best_estimator_["koopman"]
    print(
        f"best: {best.kernel_!r} on {len(best.centers_)} centres, "
        f"separation {best.centers.separation:g} (scaled)"
    )

    now = trajectory_pairs(ankles, lag=lag, delays=3, delay_step=step).X[:, :2]
    predicted = search.predict(pairs.X[test])
    error, persistence = rms(predicted - pairs.y[test]), rms(now[test] - pairs.y[test])
    print(f"held-out error, persistence:  {persistence:7.2f} mm (the ankle stays)")
    print(f"held-out error, this model:   {error:7.2f} mm")
    plot(pairs, test, now, search, error, persistence, lag / rate, rate, options.figure)
    print(f"figure saved as {options.figure}")


def plot(pairs, test, now, search, error, persistence, ahead, rate, figure):
    scaler, koopman = search.best_estimator_["scale"], search.best_estimator_["koopman"]
    centers = scaler.inverse_transform(koopman.centers_)
    fig, (left, *panels) = plt.subplots(
        1, 3, figsize=(13, 4), layout="constrained", width_ratios=[1, 1.3, 1.3]
    )
    left.plot(
        *np.degrees(pairs.X[~test, :2]).T, ".", color="0.75", ms=4, label="samples"
    )
    left.plot(
        *np.degrees(centers[:, :2]).T, "o", color="#0072B2", ms=3.5, label="centres"
    )
    left.set(
        xlabel="hip flexion [deg]",
        ylabel="knee flexion [deg]",
        title="States and centres",
    )
    left.legend(frameon=False)

    # The first trajectory that was held out, over time.
    first = pairs.groups == pairs.groups[test].min()
    mean, std = search.best_estimator_.predict(pairs.X[first], return_std=True)
    time = np.arange(first.sum()) / rate + ahead
    for axis, (ax, name) in enumerate(zip(panels, ("forward", "up"), strict=True)):
        ax.fill_between(
            time,
            mean[:, axis] - 2 * std[:, axis],
            mean[:, axis] + 2 * std[:, axis],
            color="#0072B2",
            alpha=0.25,
            lw=0,
            label="±2 standard deviations",
        )
        ax.plot(time, now[first, axis], ":", color="0.5", label="persistence")
        ax.plot(time, pairs.y[first, axis], color="k", label="measured")
        ax.plot(time, mean[:, axis], "--", color="#D55E00", label="predicted")
        ax.set(xlabel="time [s]", ylabel=f"ankle {name} of hip [mm]")
    panels[0].set_title(f"Held-out stride, {1000 * ahead:.0f} ms ahead")
    panels[1].set_title(f"rms {error:.1f} mm (persistence {persistence:.1f} mm)")
    panels[1].set_ylabel("ankle above hip [mm]")
    handles, labels = panels[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower right", ncols=4, frameon=False)
    fig.savefig(figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
