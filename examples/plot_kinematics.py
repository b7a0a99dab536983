"""
=====================================================
The ankle as a function of two angles of the leg
=====================================================

Figures 8 and 9 of the paper: from the flexion of hip and knee of a walking person to
the two coordinates of the ankle relative to the hip, one sample later, with the Matern
kernel of order 3/2 at beta = 2 and most samples as centres. The surfaces are the
estimate, which returns the output at every centre. The stick figures show what the
angles are; the sketch of Figure 8 is not drawn.

By default this reads the overground trial of a healthy adult that the package
`gaitkit` carries (subject 1 of Fukuchi, Fukuchi and Duarte 2018, CC BY 4.0), its right
leg and its left leg. Without `gaitkit`, or with ``--synthetic``, the walking is that of
`make_walking`, which nobody walked. Your own recording, an .npz file of the arrays
`hip`, `knee` and `ankle` (positions in mm of shape (n_frames, 3) along X forward and Y
up), `trial` (the number of the trial of each frame) and `rate` (frames per second),
goes the same way::

    python examples/plot_kinematics.py --data walking.npz --samples 5000

What differs from the printed paper, and why:

- "0.5 radians" cannot have been the separation: it would leave a handful of centres,
  the number is printed. On a selection of the paper's treadmill recordings a separation
  of 0.0018032 rad gives its M = 4249 of 5000 samples.
- The first 5000 of those samples end one trial and begin another. The last sample of a
  trial has no successor, and the first of the next one is none: trials are paired each
  on its own. That costs a row a trial and here leaves 4998 pairs, with these 4249
  centres. (Unpaired, the end of the first trial would be another centre.)
- The Matern kernel is the true one; the formula in the paper has the squared distance
  and is not positive definite.
- The paper shows the fit. Here is also what it is worth: errors on motion that was left
  out, a part of each trial or a whole one. Real gait passes the same two angles in
  different ways, and no surface above them can be right: the estimate returns all
  outputs at its centres, and on a trial that it has not seen it is about as good as to
  leave the ankle where it is, or much worse. With the past in the state (two delayed
  copies of the angles) it does better.
- Of the two outputs the paper finds the height nearly constant next to the forward
  coordinate; the ranges are printed.

The paper is N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
for Estimation of Animal Motions over Unknown Submanifolds", arXiv:2203.05646, 2022.
"""

import argparse
from importlib.util import find_spec

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc
from sklearn.base import clone

from sklearn_koopman import (
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials, make_walking
from sklearn_koopman.diagnostics import digits_lost
from sklearn_koopman.kinematics import leg_angles
from sklearn_koopman.plotting import SurfaceDisplay

JOINTS = ("hip", "knee", "ankle")
OUTPUTS = ("forward of the hip", "above the hip")
BETA = 2.0


def read_arguments(arguments=None):
    parser = argparse.ArgumentParser(
        description="Two coordinates of an ankle from two angles of the leg."
    )
    parser.add_argument("--data", help=".npz file of hip, knee, ankle, trial and rate")
    parser.add_argument(
        "--synthetic", action="store_true", help="take synthetic walking"
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=5000,
        help="how many samples of the file to take (default: %(default)s)",
    )
    parser.add_argument(
        "--separation",
        type=float,
        default=0.0018032,
        help="separation of the centres in rad (default: %(default)s)",
    )
    parser.add_argument(
        "--figure",
        default="kinematics.png",
        help="where to save (default: %(default)s)",
    )
    return parser.parse_args(arguments)


def read_legs(options):
    """Return a name, the markers of each leg or trial in mm, and the frame rate."""
    if options.data is not None:
        data = load_trials(options.data)
        legs, left = [], options.samples
        for markers in data.markers:
            if left > 0:
                legs.append({joint: markers[joint][:left] for joint in JOINTS})
                left -= len(markers[JOINTS[0]])
        return "Recorded walking", legs, data.rate
    if options.synthetic or find_spec("gaitkit") is None:
        walking = make_walking(2, n_strides=4, random_state=0)
        return "SYNTHETIC walking, nothing measured", walking.markers, walking.rate
    import gaitkit

    trial = gaitkit.load_example("healthy")
    print(f"{trial['description']} ({trial['source']})")
    frames = [frame["landmark_positions"] for frame in trial["angle_frames"]]
    legs = [
        {joint: np.array([f[f"{side}_{joint}"] for f in frames]) for joint in JOINTS}
        for side in ("right", "left")
    ]
    return "Recorded overground walking", legs, float(trial["fps"])


def rms(error):
    """Root mean square length of vectors."""
    return np.sqrt((error**2).sum(axis=1).mean())


def main(arguments=None):
    options = read_arguments(arguments)
    name, legs, rate = read_legs(options)
    angles, ankles = zip(
        *(leg_angles(**leg, forward=0, up=1) for leg in legs), strict=True
    )
    pairs = trajectory_pairs(angles, ankles)  # never from one trial into the next
    model = KoopmanKernelRegressor(
        "matern32", beta=BETA, centers=SeparatedCenterSelector(options.separation)
    ).fit(pairs.X, pairs.y)
    as_printed = SeparatedCenterSelector(0.5).fit(pairs.X)
    condition = 1 / model.rcond_  # estimated, in the 1-norm
    print(
        f"{name}: {sum(map(len, angles))} samples of {len(legs)} "
        f"{'trials or legs' if len(legs) > 1 else 'trial'} at "
        f"{rate:g} Hz, {len(pairs.X)} pairs\n"
        f"separation {options.separation:g} rad: M = {len(model.centers_)} centres; "
        f"0.5 rad as printed: {len(as_printed.center_indices_)}\n"
        f"condition number about {condition:.1e}: {digits_lost(condition):.1f} "
        "of 16 digits lost"
    )
    for axis, output in enumerate(OUTPUTS):
        low, high = pairs.y[:, axis].min(), pairs.y[:, axis].max()
        print(
            f"ankle {output}: {low:.0f} to {high:.0f} mm, a range of {high - low:.0f}"
        )

    fitted = np.zeros(len(pairs.X), dtype=bool)
    fitted[model.center_indices_] = True
    residual = model.predict(pairs.X) - pairs.y
    now = trajectory_pairs(ankles).X
    print(
        f"\nroot mean square error in mm, {1000 / rate:.1f} ms ahead:\n"
        f"at the centres                               {rms(residual[fitted]):8.1e}"
    )
    if not fitted.all():
        print(
            f"at the {(~fitted).sum():4d} samples that are no centres     "
            f"{rms(residual[~fitted]):10.2f}"
        )
    header = "left out:                                last third"
    print(header + "  last trial" * (len(legs) > 1))
    delayed = trajectory_pairs(angles, ankles, delays=3, delay_step=5)
    rows = [("the ankle stays", held_out(pairs, lambda train: now))]
    for label, data in (
        ("these two angles", pairs),
        ("with two delayed copies", delayed),
    ):
        rows.append((label, held_out(data, predictor(model, data))))
    for label, errors in rows:
        print(f"{label:37}" + "".join(f"{error:12.2f}" for error in errors))
    print(
        "differs from the print: the separation, the true Matern kernel, no pair "
        "across trials, errors on motion left out"
    )
    plot(model, pairs, legs, name, rate, options.figure)
    print(f"figure saved as {options.figure}")


def predictor(model, data):
    """Return the function that fits the rows given and predicts all."""
    return lambda train: clone(model).fit(data.X[train], data.y[train]).predict(data.X)


def held_out(data, predict):
    """Leave out the last third of each trial, then, of several, all of the last."""
    last_third = np.zeros(len(data.X), dtype=bool)
    for group in np.unique(data.groups):
        rows = np.flatnonzero(data.groups == group)
        last_third[rows[-(len(rows) // 3) :]] = True
    tests = [last_third]
    if data.groups.any():
        tests.append(data.groups == data.groups.max())
    return [rms((predict(~test) - data.y)[test]) for test in tests]


def plot(model, pairs, legs, name, rate, figure):
    fig = plt.figure(figsize=(11, 4.9), layout="constrained")
    # The layout does not know of the labels of vertical axes; leave them room.
    fig.get_layout_engine().set(wspace=0.1)
    grid = fig.add_gridspec(1, 3, width_ratios=[0.6, 1, 1])
    draw_leg(fig.add_subplot(grid[0]), legs[0], rate)
    for axis, output in enumerate(OUTPUTS):
        ax = fig.add_subplot(grid[1 + axis], projection="3d")
        display = SurfaceDisplay.from_estimator(
            model,
            pairs.X,
            pairs.y,
            output=axis,
            feature_names=["hip flexion [rad]", "knee flexion [rad]"],
            output_name="ankle [mm]",
            ax=ax,
            legend=False,
        )
        ax.set_title(f"Ankle {output}", y=1.01)
        ax.view_init(elev=32, azim=-125)
        ax.set_box_aspect((1, 1, 0.75), zoom=1.06)
        ax.locator_params(axis="x", nbins=4)
        ax.zaxis.labelpad = 6
    fig.legend(
        handles=display.handles_,
        loc="outside lower right",
        ncols=4,
        markerscale=2,
        frameon=False,
    )
    fig.suptitle(f"{name}: Matern-3/2, β = {BETA:g}, M = {len(model.centers_)}")
    fig.savefig(figure, dpi=120)
    plt.close(fig)


def draw_leg(ax, leg, rate):
    """Draw hip, knee and ankle in the first second, and the two angles once."""
    frames = np.arange(0, min(rate, len(leg["hip"]) - 1), rate / 10).astype(int)
    knee, ankle = ((leg[joint] - leg["hip"])[:, :2] for joint in ("knee", "ankle"))
    for frame in frames:
        ax.plot(
            *np.array([[0, 0], knee[frame], ankle[frame]]).T,
            color=plt.colormaps["viridis"](frame / frames[-1]),
            marker="o",
            ms=3,
            lw=1.2,
        )
    # The angles, at the instant when the knee is farthest forward.
    shown = frames[knee[frames, 0].argmax()]
    thigh, shank = knee[shown], ankle[shown] - knee[shown]
    direction = [np.degrees(np.arctan2(v[1], v[0])) for v in (thigh, shank)]
    black = {"color": "k", "ls": ":", "lw": 1}
    ax.plot([0, 0], [0, -250], **black)
    ax.plot(*np.array([thigh, 1.5 * thigh]).T, **black)
    for center, low, high, text in (
        ((0, 0), -90, direction[0], "hip"),
        (thigh, direction[1], direction[0], "knee"),
    ):
        ax.add_patch(Arc(center, 300, 300, theta1=low, theta2=high, color="k"))
        middle = np.radians((low + high) / 2)
        place = center + 185 * np.array([np.cos(middle), np.sin(middle)])
        white = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.5}
        ax.text(*place, text, fontsize="small", va="center", bbox=white)
    colors = plt.cm.ScalarMappable(plt.Normalize(0, frames[-1] / rate), "viridis")
    ax.figure.colorbar(colors, ax=ax, label="time [s]", location="bottom", shrink=0.8)
    ax.set(
        xlabel="forward of the hip [mm]", ylabel="above the hip [mm]", aspect="equal"
    )


if __name__ == "__main__":
    main()
