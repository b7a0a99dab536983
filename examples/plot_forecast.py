"""
=====================================
Forecast an ankle for a whole second
=====================================

Where will the ankle be over the next second? The states are hip and knee flexion and
the position of the ankle relative to the hip, each with delayed copies. A `KernelEDMD`
advances them by a tenth of a second, ten times over. It is tried on a whole trial that
was neither fitted nor searched on, at a speed between those of the others, against two
forecasts that need no model:

- persistence: the ankle stays where it is;
- repetition: the ankle does what it did one stride ago. The duration of a stride comes
  from the past of the same trial, and is adjusted so that the last fifth of a second
  fits best. Since people walk much the same from stride to stride, this is good.

By default the trials are SYNTHETIC, those of `make_walking`, which are easier to
forecast than recorded ones. From a few recorded trials at other speeds, the model may
win for some tenths of a second only; the printed text says where it does not.

Your own recording, an .npz file of the arrays `hip`, `knee` and `ankle` (positions in
mm of shape (n_frames, 3) along X forward and Y up), `trial` (the number of the trial of
each frame) and `rate` (frames per second), goes the same way::

    python examples/plot_forecast.py --data walking.npz --held-out 3
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np
import sklearn
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    KernelEDMD,
    SeparatedCenterSelector,
    TrajectoryKFold,
    forecast,
    make_forecast_scorer,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials, make_walking
from sklearn_koopman.kinematics import leg_angles

STEP, N_STEPS = 0.1, 10  # seconds, and how many of them
REPORTED = [1, 2, 3, 5, 7, 10]  # steps in the table
PAST = 4.0  # seconds before the first forecast, for the duration of a stride
STYLES = {
    name: {"label": name, "marker": marker, "color": color, "mfc": face, "ms": 6}
    for name, marker, color, face in (
        ("this model", "o", "#D55E00", "#D55E00"),
        ("repetition", "s", "#0072B2", "none"),
        ("persistence", "^", "0.45", "0.45"),
    )
}


def read_arguments(arguments=None):
    parser = argparse.ArgumentParser(description="Forecast an ankle for a second.")
    parser.add_argument("--data", help=".npz file of hip, knee, ankle, trial and rate")
    parser.add_argument(
        "--held-out",
        type=int,
        help="number of the trial to forecast, from 1 (default: the middle one)",
    )
    parser.add_argument(
        "--figure", default="forecast.png", help="where to save (default: %(default)s)"
    )
    return parser.parse_args(arguments)


def read_trials(path):
    """Return angles and ankle positions of each trial, and the frame rate."""
    if path is None:
        walking = make_walking(7, n_strides=12, random_state=0)
        speeds = ", ".join(f"{speed:.2f}" for speed in walking.speeds)
        print(f"SYNTHETIC walking, nothing measured, at {speeds} m/s")
        return walking.trajectories, walking.outputs, walking.rate
    data = load_trials(path)
    legs = [leg_angles(**leg, forward=0, up=1) for leg in data.markers]
    return [angles for angles, _ in legs], [ankle for _, ankle in legs], data.rate


def stride_before(ankle, now, rate):
    """Return the duration of a stride, in frames, from the past alone."""
    past = ankle[now + 1 - round(PAST * rate) : now + 1]
    past = past - past.mean(axis=0)
    autocorrelation = sum(np.correlate(x, x, mode="full")[len(x) - 1 :] for x in past.T)
    opposite = np.argmax(autocorrelation < 0)  # the leg is on the other side
    rough = opposite + np.argmax(autocorrelation[opposite:])
    recent = now - np.arange(round(0.2 * rate))
    durations = np.arange(round(0.85 * rough), round(1.15 * rough) + 1)
    mismatch = [((ankle[recent - d] - ankle[recent]) ** 2).sum() for d in durations]
    return durations[np.argmin(mismatch)]


def repetition(ankle, now, frames, rate):
    """Return the ankle in each of the coming frames as one stride ago."""
    duration = stride_before(ankle, now, rate)
    return ankle[now - duration + 1 + (frames - 1) % duration]


def rms(error):
    """Root mean square length of vectors, over all axes but the step's."""
    return np.sqrt((error**2).sum(axis=-1).mean(axis=0))


def main(arguments=None):
    options = read_arguments(arguments)
    angles, ankles, rate = read_trials(options.data)
    lag = round(STEP * rate)
    pairs = trajectory_pairs(
        angles, ankles, lag=lag, delays=4, delay_step=lag, outputs_in_state=True
    )

    held_out = options.held_out or (len(angles) + 1) // 2
    if not 1 <= held_out <= len(angles):
        raise SystemExit(f"--held-out must be from 1 to {len(angles)}.")
    test = pairs.groups == held_out - 1
    train = ~test
    # Rows that follow each other are nearly equal: a few for each step will do. A
    # divisor of the lag keeps the successors of those that are kept.
    thin = next(n for n in (5, 4, 3, 2, 1) if lag % n == 0)
    kept = np.flatnonzero(train)[::thin]
    print(
        f"{len(angles)} trials at {rate:g} Hz, trial {held_out} held out; "
        f"{len(kept)} pairs of states {1000 * lag / rate:.0f} ms apart to learn from"
    )

    # Routing takes sample_index to the fits and to the scorer, which has to know
    # which of the left-out rows follow each other.
    sklearn.set_config(enable_metadata_routing=True)
    search = GridSearchCV(
        Pipeline(
            [
                ("scale", StandardScaler()),
                (
                    "koopman",
                    KernelEDMD(
                        "gaussian",
                        centers=SeparatedCenterSelector(0.4),
                        method="least_squares",
                        n_modes=0,  # forecasts need no spectrum
                    ),
                ),
            ]
        ),
        {
            "koopman__trend": [None, "linear"],
            "koopman__beta": [2.0, 3.0],
            "koopman__alpha": [1e-3, 1e-2],
        },
        scoring=make_forecast_scorer(N_STEPS, relift=True),
        cv=TrajectoryKFold(3),
        n_jobs=2,
        verbose=1,
    )
    search.fit(
        pairs.X[kept],
        pairs.y[kept],
        groups=pairs.groups[kept],
        sample_index=pairs.sample_index[kept],
    )
    koopman = search.best_estimator_["koopman"]
    print(
        f"best: {koopman.kernel_!r} on {len(koopman.centers_)} centres, "
        f"trend {koopman.trend}, alpha {koopman.alpha:g}"
    )

    # Start wherever there is enough past, and a second to come.
    ankle = ankles[held_out - 1]
    frames = lag * np.arange(1, N_STEPS + 1)
    starts = np.arange(round(PAST * rate), len(ankle) - frames[-1], 5)
    first = len(ankle) - lag - test.sum()  # the frame of the first row
    states = pairs.X[test][starts - first]
    measured = ankle[starts[:, np.newaxis] + frames]
    forecasts = {
        "this model": forecast(search, states, N_STEPS, relift=True),
        "repetition": np.array([repetition(ankle, t, frames, rate) for t in starts]),
        "persistence": np.repeat(ankle[starts][:, np.newaxis], N_STEPS, axis=1),
    }
    errors = {name: guess - measured for name, guess in forecasts.items()}
    powers = forecast(search, states, N_STEPS) - measured

    print(f"\nheld-out error in mm, from {len(starts)} starts:")
    times = "".join(f"{s * lag / rate:8.1f} s" for s in REPORTED)
    print(f"{'':28}{times}   all steps")
    report = {
        "persistence (the ankle stays)": errors["persistence"],
        "repetition of the last stride": errors["repetition"],
        "this model, by powers": powers,
        "this model, relifted": errors["this model"],
    }
    for name, error in report.items():
        curve = rms(error)
        cells = "".join(f"{curve[s - 1]:10.1f}" for s in REPORTED)
        print(f"{name:29}{cells}{np.sqrt((curve**2).mean()):12.1f}")
    worse = rms(errors["this model"]) >= rms(errors["repetition"])
    if worse.any():
        seconds = ", ".join(f"{f / rate:.1f}" for f in frames[worse])
        print(f"the last stride repeated is as good or better at {seconds} s")
    else:
        print("this model is better than the last stride repeated at every step")

    plot(ankle, starts, frames / rate, forecasts, errors, rate, options)
    print(f"figure saved as {options.figure}")


def plot(ankle, starts, ahead, forecasts, errors, rate, options):
    fig, axes = plt.subplot_mosaic(
        [["forward", "error"], ["up", "error"]],
        figsize=(12, 5.6),
        layout="constrained",
        width_ratios=[1.25, 1],
    )
    # One start: that of the median error of model and repetition together.
    both = np.hstack([errors["this model"], errors["repetition"]])
    shown = np.argsort((both**2).sum(axis=(1, 2)))[len(starts) // 2]
    window = np.arange(-round(0.2 * rate), round(ahead[-1] * rate) + 1)
    for axis, name in enumerate(("forward", "up")):
        ax = axes[name]
        ax.axvline(0, color="0.8", lw=1)
        ax.plot(
            window / rate,
            ankle[starts[shown] + window, axis],
            color="k",
            lw=1.5,
            label="actual",
        )
        for label, guess in forecasts.items():
            ax.plot(ahead, guess[shown, :, axis], ls="", **STYLES[label])
    axes["forward"].set(ylabel="ankle forward of hip [mm]", title="A typical start")
    axes["forward"].sharex(axes["up"])
    axes["forward"].tick_params(labelbottom=False)
    axes["up"].set(ylabel="ankle above hip [mm]", xlabel="time from the start [s]")

    ax = axes["error"]
    for label, error in errors.items():
        ax.plot(ahead, rms(error), **STYLES[label])
    ax.set(
        xlabel="time ahead [s]",
        ylabel="root mean square error [mm]",
        yscale="log",
        title=f"Held-out trial, {len(starts)} starts",
    )
    low, high = ax.get_ylim()
    ticks = [t for t in (1, 2, 5, 10, 20, 50, 100, 200, 500) if low < t < high]
    ax.set_yticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.grid(color="0.9")
    # The lines of the error, behind that of the ankle itself.
    handles, labels = axes["error"].get_legend_handles_labels()
    handles.insert(0, axes["up"].lines[1])
    labels.insert(0, "actual")
    fig.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    data = "SYNTHETIC walking" if options.data is None else "Recorded walking"
    fig.suptitle(f"{data}: the ankle over the next second")
    fig.savefig(options.figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
