"""Forecasts of walking: errors by horizon, bands, and what a forecast costs.

The errors are those of the ankle on trials left out one at a time, root mean squares of
the distance in mm, over rows that have been preceded by two strides. Beside them stand
the baselines alone, and pairs of rows by hand. The times are those of one process on
recordings of different length.

Run ``python benchmarks/forecaster.py``; the recorded walking is looked for in
``../shared/data``, or in the folder that SKLEARN_KOOPMAN_DATA names.
"""

import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warnings

import numpy as np
from sklearn.base import clone

from sklearn_koopman import (
    Analogs,
    ExtrapolationWarning,
    KoopmanForecaster,
    trajectory_pairs,
)
from sklearn_koopman.datasets import load_trials, make_walking
from sklearn_koopman.kinematics import leg_angles

DATA = Path(__file__).parents[1] / os.environ.get(
    "SKLEARN_KOOPMAN_DATA", "../shared/data"
)
HORIZONS = np.array([15, 30, 45, 75, 112, 150])  # at 150 Hz
FIRST_ROW = 335
COVERAGES = (0.8, 0.9, 0.95)


def read_walking():
    """Return hip and knee angles and the ankle in mm, a recording a trial."""
    trials = load_trials(DATA / "walking_wbds01_T01-T04_left.npz").markers
    return [np.hstack(leg_angles(**markers, forward=0, up=1)) for markers in trials]


def rms_by_horizon(forecasts, walks):
    """Return the root mean square distance in mm of all scored rows."""
    errors = []
    for number, horizon in enumerate(HORIZONS):
        parts = []
        for forecast, walk in zip(forecasts, walks, strict=True):
            rows = np.arange(FIRST_ROW, len(walk) - HORIZONS.max())
            parts.append(forecast[rows, number] - walk[rows + horizon, 2:])
        errors.append(np.sqrt((np.concatenate(parts) ** 2).sum(axis=1).mean()))
    return errors


def compare_errors(walks):
    print("ankle, trials left out one at a time, rms in mm")
    print(f"{'':24s}" + "".join(f"{h / 150:7.2f} s" for h in HORIZONS))
    candidates = {
        "auto": {},
        "direct": {"baseline": None},
        "last, corrected": {"baseline": "last"},
        "linear, corrected": {"baseline": "linear"},
        "analogs, corrected": {"baseline": "analogs"},
        "analogs of 20 samples": {"baseline": Analogs(window=20, exclusion=40)},
    }
    for name, parameters in candidates.items():
        forecasts, alone = [], []
        for left_out in range(len(walks)):
            model = KoopmanForecaster(
                targets=[2, 3], horizons=HORIZONS.tolist(), **parameters
            )
            model.fit([w for i, w in enumerate(walks) if i != left_out])
            forecasts += model.predict([walks[left_out]])
            alone += model.predict_baseline([walks[left_out]])
        rows = {name: forecasts}
        if name not in ("auto", "direct"):
            rows[name.replace(", corrected", "") + ", alone"] = alone
        for label, each in rows.items():
            errors = rms_by_horizon(each, walks)
            print(f"{label:24s}" + "".join(f"{e:9.1f}" for e in errors), flush=True)


def count_covered(model, walks, coverage, simultaneous):
    """Return the share of errors that a band holds, a mean over recordings."""
    forecasts, bands = model.predict_interval(
        walks, coverage=coverage, simultaneous=simultaneous
    )
    shares = []
    for forecast, band, error in zip(
        forecasts, bands, model.errors(walks), strict=True
    ):
        truth = (forecast - error)[..., np.newaxis]
        inside = (band[..., :1] <= truth) & (truth <= band[..., 1:])
        known = np.isfinite(error)
        if simultaneous:
            rows = known.all(axis=(1, 2))
            shares.append(inside[rows].all(axis=(1, 2, 3)).mean())
        else:
            shares.append(inside[..., 0][known].mean())
    return np.mean(shares)


def compare_coverage(n_draws=20):
    print(f"\ncoverage for 20 new persons, 20 to calibrate, mean of {n_draws} draws")
    print(f"{'method':10s}{'':14s}" + "".join(f"{c:8.2f}" for c in COVERAGES))
    shares = {}
    for seed in range(n_draws):
        walking = make_walking(1, n_persons=50, n_strides=6, rate=50, random_state=seed)
        walks = [
            np.hstack(pair)
            for pair in zip(walking.trajectories, walking.outputs, strict=True)
        ]
        model = KoopmanForecaster(
            targets=[2, 3], horizons=[5, 15], delays=(0, 2, 4), baseline="analogs"
        ).fit(walks[:10])
        for method in ("draws", "mixture"):
            model.conformalize(walks[10:30], method=method)
            for simultaneous in (False, True):
                shares.setdefault((method, simultaneous), []).append(
                    [
                        count_covered(model, walks[30:], coverage, simultaneous)
                        for coverage in COVERAGES
                    ]
                )
    for (method, simultaneous), each in shares.items():
        kind = "simultaneous" if simultaneous else "pointwise"
        means = np.mean(each, axis=0)
        print(f"{method:10s}{kind:14s}" + "".join(f"{m:8.3f}" for m in means))


def seconds(function, n_runs=3):
    """Return the least time of some runs."""
    times = []
    for _ in range(n_runs):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def compare_times(walks):
    print("\nthe same by hand: one estimator, all horizons as its outputs (T01 to T03)")
    model = KoopmanForecaster(targets=[2, 3], horizons=HORIZONS.tolist(), baseline=None)
    print(f"fit, baseline=None {seconds(lambda: model.fit(walks[:3]), 1):8.2f} s")
    pairs = trajectory_pairs(walks[:3], lag=int(HORIZONS.max()), delays=(0, 5, 10))
    y = np.concatenate(
        [
            np.hstack([w[10 + h : len(w) - HORIZONS.max() + h, 2:] for h in HORIZONS])
            for w in walks[:3]
        ]
    )
    by_hand = clone(model.estimators_["direct"])
    fit = seconds(
        lambda: by_hand.fit(pairs.X, y, koopmankernelregressorcv__groups=pairs.groups),
        1,
    )
    print(
        f"fit by hand        {fit:8.2f} s (no weights, no errors of what is left out)"
    )
    auto = KoopmanForecaster(targets=[2, 3], horizons=HORIZONS.tolist())
    print(f"fit, auto          {seconds(lambda: auto.fit(walks[:3]), 1):8.2f} s")

    print("\nrows of past   predict [s]   last row [ms]   by hand [ms]   max_past [s]")
    long = np.vstack([walks[0]] * 32)
    limited = clone(auto).set_params(baseline=Analogs(max_past=3000)).fit(walks[:3])
    row = pairs.X[-1:]
    for n_rows in (1_000, 3_000, 10_000, 30_000, 100_000):
        recording = [long[:n_rows]]
        whole = seconds(lambda r=recording: auto.predict(r), 1)
        last = seconds(lambda r=recording: auto.forecast(r))
        one = seconds(lambda: by_hand.predict(row))
        bounded = seconds(lambda r=recording: limited.predict(r), 1)
        print(
            f"{n_rows:12,d}{whole:14.2f}{1e3 * last:16.2f}{1e3 * one:15.2f}"
            f"{bounded:20.2f}",
            flush=True,
        )


if __name__ == "__main__":
    warnings.simplefilter("ignore", ExtrapolationWarning)
    walks = read_walking()
    compare_errors(walks)
    compare_times(walks)
    compare_coverage()
