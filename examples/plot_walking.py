"""
==========================================
Predict an ankle from the angles of a leg
==========================================

Where will the ankle be in a tenth of a second? The states are the hip and knee
flexion of a walking person, the output is the position of the ankle relative to the
hip. Scale, separation and kernel of the estimate are searched for by leaving out parts
of the recordings, and the model is then tried on a part that the search never saw.

By default this reads the overground trial of a healthy adult that the package
`gaitkit` carries (subject 1 of Fukuchi, Fukuchi and Duarte 2018, CC BY 4.0). Your own
files go the same way, in any format of `load_markers`. The markers are found by their
names where these are usual ones, and the axes by how a leg stands and bends::

    python examples/plot_walking.py --data trial.trc
    python examples/plot_walking.py --data *.c3d --hip RGT --knee RKNE --ankle RANK
    python examples/plot_walking.py --data a1.csv a2.csv b1.csv --person A A B --rate 60

It prints the markers, axes and gaps of each leg, and asks for what it cannot tell.

What is left out is the last stride of one file, the last one of several files, or the
last one of several persons. Persons differ in size: their ankles are then learned as
parts of the length of the leg, and predictions are multiplied by the length again.
"""

import argparse
import re

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
from sklearn_koopman.kinematics import fill_gaps, leg_angles, leg_length

JOINTS = ("hip", "knee", "ankle")
SIDES = ("r(ight)?", "l(eft)?")
# Usual names of the markers without the side.
USUAL = {
    "hip": "gtr?|hip|hjc|(greater_?)?trochanter",
    "knee": "knee?|kjc|lfc|lateral_?knee",
    "ankle": "ankl?e?|ajc|lm|lateral_?ankle",
}
MAX_GAP = 0.1  # seconds
MAX_FOLDS = 6
IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "px": 1.0}
AXES = ("x", "y", "z", "-x", "-y", "-z")
SAME_LEG = 1.05  # the longest over the shortest length measured of one person's leg


def read_arguments(arguments=None):
    parser = argparse.ArgumentParser(
        description="Predict where the ankle will be, from hip and knee flexion."
    )
    parser.add_argument("--data", nargs="+", help="files of markers, of any format")
    parser.add_argument("--person", nargs="+", help="who walks, a name for each file")
    parser.add_argument(
        "--rate",
        type=float,
        nargs="+",
        help="frames per second, if not in the files: of all of them, or of each",
    )
    parser.add_argument("--unit", choices=["mm", "cm", "m"], help="unit of the markers")
    parser.add_argument("--individual", help="who is read, if files hold several")
    parser.add_argument(
        "--min-likelihood", type=float, help="smallest likelihood of a position"
    )
    for joint in JOINTS:
        parser.add_argument(
            f"--{joint}", nargs="+", help=f"{joint} markers in the files, one a leg"
        )
    for name, what in (("forward", "axis of walking"), ("up", "axis that points up")):
        parser.add_argument(
            f"--{name}",
            choices=AXES,
            help=f"{what}, as in --{name}=-x (default: found)",
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
        help="into how many pieces to cut the recording of each leg; about a stride "
        "each is best (default: %(default)s)",
    )
    parser.add_argument(
        "--figure", default="walking.png", help="where to save (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    n_files = len(options.data or [])
    if options.person and len(options.person) != n_files:
        parser.error("name one --person for each file of --data")
    if options.rate and len(options.rate) not in (1, n_files):
        parser.error("give one --rate, or one for each file of --data")
    if options.pieces < 1:
        parser.error("cut each recording into at least one of --pieces")
    given = [getattr(options, joint) or [] for joint in JOINTS]
    legs = [{*leg} for leg in zip(*given, strict=False)]
    if len({*map(len, given)}) > 1 or any(len(leg) < len(JOINTS) for leg in legs):
        parser.error("name another --hip, --knee and --ankle for each leg")
    return options


def read_trials(options):
    """Return the name, the markers, the frame rate and the unit of each file."""
    if options.data:
        rates = options.rate or [None]
        trials = [
            load_markers(
                file,
                rate=rate,
                unit=options.unit,
                gaps="nan",
                min_likelihood=options.min_likelihood,
                individual=options.individual,
            )
            for file, rate in zip(
                options.data, rates * (len(options.data) // len(rates)), strict=True
            )
        ]
        return [
            (trial.filename, trial.markers, trial.rate, trial.unit) for trial in trials
        ]
    import gaitkit

    trial = gaitkit.load_example("healthy")
    print(f"{trial['description']} ({trial['source']})")
    frames = [frame["landmark_positions"] for frame in trial["angle_frames"]]
    markers = {name: np.array([frame[name] for frame in frames]) for name in frames[0]}
    return [("gaitkit", markers, float(trial["fps"]), "mm")]


def find_joints(names, options):
    """Return the names of the hip, knee and ankle of each leg; ask if they hide."""
    if options.hip:
        return list(zip(options.hip, options.knee, options.ankle, strict=True))
    legs, known = [], {joint: [] for joint in JOINTS}
    for side in (*SIDES, ""):
        leg = [
            [n for n in names if re.fullmatch(pattern, n, re.IGNORECASE)]
            for usual in USUAL.values()
            for pattern in [f"{side}[ ._-]?({usual})|({usual})[ ._-]?{side}"]
        ]
        if all(len(found) == 1 for found in leg):
            legs.append([name for found in leg for name in found])
        for joint, found in zip(JOINTS, leg, strict=True):
            known[joint] += found
    if not legs:
        likely = [f"{joint} {' or '.join(x) or '?'}" for joint, x in known.items()]
        raise SystemExit(
            "Which markers are hip, knee and ankle? Name them by --hip, --knee and "
            f"--ankle, one for each leg. There are {', '.join(names)}. Known by their "
            f"names: {', '.join(likely)}."
        )
    return legs


def find_axes(hip, ankle, options):
    """Return the names of the directions forward (or backward) and up."""
    leg = np.nanmean(hip - ankle, axis=0)
    highest = np.abs(leg).argmax()  # a hip is above its ankle
    up = options.up or ("-" if leg[highest] < 0 else "") + "xyz"[highest]
    swing = np.nanstd(hip - ankle, axis=0) * (direction(up, len(leg)) == 0)
    return options.forward or "xyz"[swing.argmax()], up


def direction(axis, n_axes):
    """Return the vector of an axis, such as that of -x."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1 if axis[0] == "-" else 1
    return vector[:n_axes]


def read_legs(options):
    """Return the recordings of the legs, the files, and the unit of the ankles.

    A recording has angles, ankle, the length of the leg, the number of the file, and
    the rate.
    """
    legs = []
    trials = read_trials(options)
    if len({unit == "px" for *_, unit in trials}) > 1:
        raise SystemExit("Some files are in pixels, others are not; take one kind.")
    for number, (file, markers, rate, unit) in enumerate(trials):
        for names in find_joints([*markers], options):
            for name in names:
                if name not in markers or np.isnan(markers[name]).all():
                    fate = "is lost in all frames" if name in markers else "is none"
                    raise SystemExit(
                        f"{file}: {name} {fate} of {', '.join(markers)}; name others."
                    )
            leg = {n: IN_MM[unit] * markers[n] for n in names}
            filled, frames = fill_gaps(leg, max_gap=max(round(MAX_GAP * rate), 1))
            hip, _, ankle = joints = [*filled.values()]
            forward, up = find_axes(hip, ankle, options)
            axes = {"forward": direction(forward, hip.shape[1])}
            axes["up"] = direction(up, hip.shape[1])
            angles, ankle = leg_angles(*joints, **axes)
            if not options.forward and np.nanmedian(angles[:, 1]) < 0:
                # Knees bend backward: it was the other way.
                angles, ankle, forward = -angles, ankle * [-1, 1], f"-{forward}"
            n_lost = np.isnan(angles[:, 0]).sum()
            print(
                f"{file}: {', '.join(names)}; forward {forward}, up {up}; of "
                f"{len(angles)} frames {len(frames)} filled, {n_lost} cut out"
            )
            legs.append((angles, ankle, leg_length(*joints), number, rate))
    return legs, [file for file, *_ in trials], "px" if unit == "px" else "mm"


def rms(error):
    """Root mean square length of vectors."""
    return np.sqrt((error**2).sum(axis=1).mean())


def main(arguments=None):
    options = read_arguments(arguments)
    legs, files, unit = read_legs(options)
    n_files = len(files)
    persons = options.person or ["one"] * n_files
    has_persons = len(set(persons)) > 1
    sizes = [np.mean([leg[2] for leg in legs if leg[3] == n]) for n in range(n_files)]
    if not options.person and max(sizes) > SAME_LEG * min(sizes):
        print(
            f"The legs of the files are {min(sizes):.0f} to {max(sizes):.0f} {unit} "
            "long. If they are of several persons, name who walks in each by --person."
        )
    kind = "person" if has_persons else "trial" if n_files > 1 else "stride"
    rate = min(leg[-1] for leg in legs)
    lag = max(round(options.ahead * rate), 1)

    # Each piece of each leg is a trajectory of its own: no pair reaches from one into
    # the next. The last person, file or piece is kept for the test.
    angles, ankles, lengths, rates, units = [], [], [], [], []
    for state, ankle, length, number, of_leg in legs:
        for piece, rows in enumerate(
            np.array_split(np.arange(len(state)), options.pieces)
        ):
            angles.append(state[rows])
            ankles.append(ankle[rows] / (length if has_persons else 1.0))
            lengths.append(length if has_persons else 1.0)
            rates.append(of_leg)
            units.append(
                persons[number] if has_persons else number if n_files > 1 else piece
            )

    # Two angles are the same in swing and in stance; their past distinguishes these.
    step = max(round(rate / 30), 1)
    settings = {
        "lag": lag,
        "delays": 3,
        "delay_step": step,
        "gaps": "split",
        "rates": rates,
        "resample": rate if len(set(rates)) > 1 else None,
    }
    pairs = trajectory_pairs(angles, ankles, **settings)
    last = {"person": persons[-1], "trial": files[-1], "stride": "the last of each leg"}
    print(f"held out, {kind}: {last[kind]}")
    is_test = np.array([unit == units[-1] for unit in units])
    test = is_test[pairs.groups]
    train = ~test
    print(
        f"{len(angles)} trajectories of {len(legs)} legs at {rate:g} Hz; "
        f"{train.sum()} pairs to learn from, {test.sum()} to test; "
        f"the ankle {1000 * lag / rate:.0f} ms ahead"
    )
    # The search leaves out one person, file or piece at a time, of those that remain.
    numbers = np.unique(units, return_inverse=True)[1]
    left_out = numbers[pairs.groups[train]]
    if len(np.unique(left_out)) < 2:
        left_out = pairs.groups[train]
    if len(np.unique(left_out)) < 2:
        raise SystemExit("Too little is left to learn from; pass more --pieces.")

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
        cv=TrajectoryKFold(min(len(np.unique(left_out)), MAX_FOLDS)),
        n_jobs=2,
        verbose=1,
    )
    search.fit(pairs.X[train], pairs.y[train], groups=left_out)
    best = search.best_estimator_["koopman"]
    print(
        f"best: {best.kernel_!r} on {len(best.centers_)} centres, "
        f"separation {best.centers.separation:g} (scaled)"
    )

    # The first trajectory that was held out, and all of them, in the unit of the file.
    size = np.array(lengths)[pairs.groups, np.newaxis]
    now = size * trajectory_pairs(ankles, **settings).X[:, :2]
    came = size * pairs.y
    predicted = size[test] * search.predict(pairs.X[test])
    error, stays = rms(predicted - came[test]), rms(now[test] - came[test])
    print(f"held-out error, persistence:  {stays:7.2f} {unit} (the ankle stays)")
    print(f"held-out error, this model:   {error:7.2f} {unit}")
    title = (kind, f"rms {error:.1f} {unit} (persistence {stays:.1f} {unit})")
    plot(pairs, test, size, now, search, lag / rate, title, unit, options.figure)
    print(f"figure saved as {options.figure}")


def plot(pairs, test, size, now, search, ahead, title, unit, figure):
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
    mean, std, came = (size[first] * part for part in (mean, std, pairs.y[first]))
    time = pairs.time[first] + ahead
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
        ax.plot(time, came[:, axis], color="k", label="measured")
        ax.plot(time, mean[:, axis], "--", color="#D55E00", label="predicted")
        ax.set(xlabel="time [s]", ylabel=f"ankle {name} of hip [{unit}]")
    panels[0].set_title(f"Held-out {title[0]}, {1000 * ahead:.0f} ms ahead")
    panels[1].set_title(title[1])
    panels[1].set_ylabel(f"ankle above hip [{unit}]")
    handles, labels = panels[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower right", ncols=4, frameon=False)
    fig.savefig(figure, dpi=120)
    plt.close(fig)


def spell(error):
    """Return the message of an error, with the parameters as options of this script."""
    names = "rate|unit|individual|min_likelihood"
    text = re.sub(rf"\b({names})=", r"--\1 ", str(error))
    text = re.sub(rf"(pass|and|leave) ({names})\b", r"\1 --\2", text)
    return text.replace("--min_", "--min-")


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError, ImportError) as error:
        raise SystemExit(spell(error)) from None
