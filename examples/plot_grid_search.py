"""
=====================================================
Search centres, kernel and scale by whole trajectories
=====================================================

Several pendulums, released from different heights, and measured with noise. Which
separation of the centres, which kernel and which scale predict a pendulum that was
never seen? `GridSearchCV` finds out by leaving out whole trajectories. The centres are
chosen inside the regressor, or by a step of the pipeline in front of it: both spellings
give the same predictions. At the end the model is saved and loaded again.
"""

import argparse
import tempfile
import warnings
from pathlib import Path

import joblib
import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_koopman import (
    ExtrapolationWarning,
    KoopmanKernelRegressor,
    SeparatedCenterSelector,
    TrajectoryKFold,
)
from sklearn_koopman.datasets import make_pendulum

SEPARATIONS = [0.1, 0.2, 0.4, 0.8]
KERNELS = ["matern32", "wendland_c4", "gaussian"]
BETAS = [1.0, 3.0, 10.0]


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[2])
    parser.add_argument("--figure", default="grid_search.png", help="where to save")
    options = parser.parse_args(arguments)

    release = np.column_stack([np.zeros(8), np.linspace(0.6, 2.4, 8)])
    train = make_pendulum(n_samples=60, initial=release, noise=0.02, random_state=0)
    unseen = make_pendulum(n_samples=60, initial=[[0.0, 1.1], [0.0, 2.2]])

    # Some candidates do not reach every state left out. That shows in their score.
    warnings.simplefilter("ignore", ExtrapolationWarning)

    # First spelling: the regressor holds the selector.
    inside = GridSearchCV(
        Pipeline(
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
        ),
        {
            "koopman__centers__separation": SEPARATIONS,
            "koopman__kernel": KERNELS,
            "koopman__beta": BETAS,
        },
        cv=TrajectoryKFold(4),
        scoring="neg_root_mean_squared_error",
        n_jobs=2,
        verbose=1,
    ).fit(train.X, train.y, groups=train.groups)

    # Second spelling: the selector is a step and passes distances on.
    in_front = GridSearchCV(
        Pipeline(
            [
                ("scale", StandardScaler()),
                ("centers", SeparatedCenterSelector()),
                (
                    "koopman",
                    KoopmanKernelRegressor(
                        centers="precomputed", method="least_squares", alpha=1e-3
                    ),
                ),
            ]
        ),
        {
            "centers__separation": SEPARATIONS,
            "koopman__kernel": KERNELS,
            "koopman__beta": BETAS,
        },
        cv=TrajectoryKFold(4),
        scoring="neg_root_mean_squared_error",
        n_jobs=2,
        verbose=1,
    ).fit(train.X, train.y, groups=train.groups)

    difference = np.abs(inside.predict(unseen.X) - in_front.predict(unseen.X)).max()
    print(
        "best:", {name.split("__", 1)[1]: v for name, v in inside.best_params_.items()}
    )
    print(f"largest difference of the two spellings: {difference:.1e}")

    def rms(prediction):
        return np.sqrt(np.mean((prediction - unseen.y) ** 2))

    print(f"error left out:         {-inside.best_score_:.4f} (noise 0.02)")
    print(f"error on new pendulums: {rms(inside.predict(unseen.X)):.4f} (no noise)")

    # What shuffled rows would have said about the same model.
    shuffled = GridSearchCV(
        inside.estimator,
        {name: [value] for name, value in inside.best_params_.items()},
        cv=KFold(4, shuffle=True, random_state=0),
        scoring="neg_root_mean_squared_error",
    ).fit(train.X, train.y)
    print(f"error by shuffled rows: {-shuffled.best_score_:.4f}")

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.joblib"
        joblib.dump(inside.best_estimator_, path)
        size = path.stat().st_size
        loaded = joblib.load(path)
    same = np.array_equal(loaded.predict(unseen.X), inside.predict(unseen.X))
    print(f"saved {size / 1000:.0f} kB, loaded, predicts the same: {same}")

    plot(inside, options.figure)
    print(f"figure saved as {options.figure}")


def plot(search, figure):
    results = search.cv_results_
    fig, axes = plt.subplots(
        1, len(KERNELS), figsize=(11, 3.6), sharey=True, layout="constrained"
    )
    for ax, kernel in zip(axes, KERNELS, strict=True):
        for beta, marker in zip(BETAS, "os^", strict=True):
            chosen = (results["param_koopman__kernel"] == kernel) & (
                results["param_koopman__beta"] == beta
            )
            ax.plot(
                results["param_koopman__centers__separation"][chosen].astype(float),
                -results["mean_test_score"][chosen],
                marker=marker,
                label=f"beta = {beta:g}",
            )
        ax.axhline(0.02, color="0.6", ls=":", label="noise of the outputs")
        ax.set(xscale="log", yscale="log", title=kernel, xlabel="separation (scaled)")
        ax.set_xticks(SEPARATIONS, [f"{s:g}" for s in SEPARATIONS])
        ax.minorticks_off()
    axes[0].set_ylabel("rms error, trajectories left out")
    ticks = [0.02, 0.03, 0.05, 0.1, 0.2, 0.5]
    axes[0].set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes[-1].legend(frameon=False)
    fig.savefig(figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
