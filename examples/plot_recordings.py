"""
====================================================
From recordings of persons to a forecast with a band
====================================================

Where will the ankle of a person be over the next second, who has never been seen
before, and how sure is that? A sample is a whole recording: hip and knee flexion and
the position of the ankle relative to the hip, from several persons, each at two speeds.

- `fit` learns from eight persons. The baseline of a forecast is what followed the
  moments of the recording's own past that are most like the present one. A correction
  to it is learned across persons. What is left out says how much of it to believe.
- `conformalize` makes bands of the errors on eleven other persons. The unit is the
  person. Eleven units support a coverage of up to 11 / 12.
- The last person has taught nothing, and shows the forecast.

The figure has the forecast and its band from one moment, the moments of the past that
it is made of, and the errors of all moments of the last person, beside those of
forecasts that need no learning.

The recordings are SYNTHETIC, those of `make_walking`, which are easier to forecast than
measured ones. For your own, put a list of arrays or DataFrames in place of `X`, one for
each recording, all at one rate, and the person of each in place of `persons`.
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np

from sklearn_koopman import KoopmanForecaster
from sklearn_koopman.datasets import make_walking
from sklearn_koopman.plotting import AnalogDisplay, ForecastDisplay, HorizonErrorDisplay

RATE = 50.0  # samples per second
HORIZONS = range(5, 51, 5)  # 0.1 to 1 s
N_LEARNED, N_CALIBRATED = 8, 11  # persons
COVERAGE = 0.9


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description="Forecast the ankle of a person never seen, with a band."
    )
    parser.add_argument(
        "--figure",
        default="recordings.png",
        help="where to save (default: %(default)s)",
    )
    options = parser.parse_args(arguments)

    walking = make_walking(
        n_persons=N_LEARNED + N_CALIBRATED + 1,
        speeds=[0.9, 1.3],
        n_strides=6,
        rate=RATE,
        random_state=0,
    )
    persons = walking.persons
    X = [
        np.hstack(pair)
        for pair in zip(walking.trajectories, walking.outputs, strict=True)
    ]

    def take(first, after):
        """Return the recordings of some persons, and who they are."""
        chosen = np.flatnonzero((persons >= first) & (persons < after))
        return [X[i] for i in chosen], persons[chosen]

    learned, _ = take(0, N_LEARNED)
    calibrated, groups = take(N_LEARNED, N_LEARNED + N_CALIBRATED)
    unseen, _ = take(N_LEARNED + N_CALIBRATED, persons.max() + 1)

    forecaster = KoopmanForecaster(
        targets=[2, 3], horizons=HORIZONS, delays=(0, 2, 4, 6)
    )
    forecaster.fit(learned).conformalize(calibrated, groups=groups)
    print(
        f"{walking.DESCR.splitlines()[0]}, {RATE:g} Hz: {len(learned)} recordings of "
        f"{N_LEARNED} persons to learn from, {len(calibrated)} of {N_CALIBRATED} to "
        f"calibrate, {len(unseen)} of one never seen"
    )
    print(f"baselines: {', '.join(sorted({*forecaster.baselines_}))}")
    weights = ", ".join(f"{weight:.2f}" for weight in forecaster.horizon_weights_)
    print(f"of the correction is believed, by the horizon: {weights}")

    # Where will the ankle be? From the last row of each recording:
    ankle, band = forecaster.forecast_interval(unseen, coverage=COVERAGE)
    print(f"\n{COVERAGE:.0%} bands after the last row, forward of the hip [mm]:")
    for number, horizon in enumerate(HORIZONS):
        cells = "".join(
            f"{ankle[i, number, 0]:8.0f} ({low:.0f} to {high:.0f})"
            for i, (low, high) in enumerate(band[:, number, 0])
        )
        print(f"{horizon / RATE:5.1f} s {cells}")

    # How often do such bands hold, and how large are the errors?
    errors = forecaster.compare(unseen)
    print("\nroot mean square error forward and up together, in mm, by the horizon:")
    for name, error in errors.items():
        cells = "".join(f"{e:8.1f}" for e in np.linalg.norm(error, axis=1))
        print(f"{name:10}{cells}")
    _, bands = forecaster.predict_interval(unseen, coverage=COVERAGE)
    sizes = np.abs(np.concatenate(forecaster.errors(unseen)))
    half_widths = np.ptp(np.concatenate(bands), axis=-1) / 2
    held = (sizes <= half_widths)[np.isfinite(sizes)].mean()
    print(f"of the outputs that came, the bands hold {held:.0%}")

    plot(forecaster, unseen, options.figure)
    print(f"figure saved as {options.figure}")


def plot(forecaster, unseen, figure):
    fig, axes = plt.subplot_mosaic(
        [["forecast", "errors"], ["analogs", "analogs"]],
        figsize=(11, 8),
        layout="constrained",
    )
    shared = {"dt": 1 / RATE, "unit": "mm"}
    named = {"output_name": "ankle forward of hip", **shared}
    ForecastDisplay.from_estimator(
        forecaster, unseen[0], coverage=COVERAGE, ax=axes["forecast"], **named
    )
    HorizonErrorDisplay.from_estimator(
        forecaster,
        unseen,
        output=None,
        output_name="the ankle",
        ax=axes["errors"],
        **shared,
    )
    AnalogDisplay.from_estimator(forecaster, unseen[0], ax=axes["analogs"], **named)
    axes["forecast"].set_title("From one moment")
    axes["errors"].set_title("From all moments")
    axes["analogs"].set_title("What the last forecast is made of")
    fig.suptitle("SYNTHETIC walking of a person never seen: the ankle within a second")
    fig.savefig(figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
