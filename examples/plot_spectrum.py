"""
===================================
The Koopman spectrum of a pendulum
===================================

A pendulum swings with one frequency and its harmonics, so the Koopman operator of its
motion has the eigenvalues exp(2 pi i k nu h) on the unit circle, for the fundamental
frequency nu and the time step h. How well does an estimate from 25 seconds of motion
and a few dozen centres find them, and which of its eigenvalues can be trusted? The
residual of each eigenpair answers that without the true eigenvalues. The phase of the
first eigenfunction that oscillates is the phase of the swing: it grows at a constant
rate, while the pendulum itself is slow where it turns round.
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np

from sklearn_koopman import KernelEDMD, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.plotting import SpectrumDisplay

STEP = 0.1  # seconds


def frequency_of_long_run(n_steps=50_000):
    """Count swings by the times at which the pendulum passes the bottom."""
    position = make_pendulum(n_samples=n_steps, step=STEP).X[:, 1]
    before = np.flatnonzero((position[:-1] < 0) & (position[1:] >= 0))
    fraction = position[before] / (position[before] - position[before + 1])
    times = STEP * (before + fraction)
    return (len(times) - 1) / (times[-1] - times[0])


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description="Koopman eigenvalues of a pendulum, and how far to trust them."
    )
    parser.add_argument("--samples", type=int, default=256, help="default: %(default)s")
    parser.add_argument(
        "--separation",
        type=float,
        default=0.23,
        help="separation of the centres (default: %(default)s)",
    )
    parser.add_argument("--figure", default="spectrum.png", help="where to save")
    options = parser.parse_args(arguments)

    pendulum = make_pendulum(n_samples=options.samples, step=STEP)
    model = KernelEDMD(
        kernel="wendland_c4",
        beta=4.0,
        centers=SeparatedCenterSelector(options.separation),
    ).fit(pendulum.X, X_next=pendulum.X_next)
    growth_rates, frequencies = model.continuous_eigenvalues(STEP)
    truth = frequency_of_long_run()
    print(
        f"{len(pendulum.X)} samples, {model.rank_} centres; "
        f"a long run swings with {truth:.6f} Hz"
    )
    print("frequency [Hz]  of the fundamental  growth rate [1/s]  residual")
    for growth, frequency, residual in zip(
        growth_rates, frequencies, model.residuals_, strict=True
    ):
        if frequency >= 0 and residual < 0.01:
            print(
                f"{frequency:14.6f}  {frequency / truth:18.5f}  {growth:17.1e}  "
                f"{residual:8.1e}"
            )
    first = np.flatnonzero(model.eigenvalues_.imag > 0)[0]
    print(
        f"fundamental frequency: {frequencies[first]:.6f} Hz, "
        f"off by {100 * abs(frequencies[first] / truth - 1):.4f} %"
    )
    trusted = int((model.residuals_ < 0.01).sum())
    print(f"{trusted} of {model.rank_} eigenvalues have a residual below 0.01")
    plot(model, pendulum, first, truth, options.figure)
    print(f"figure saved as {options.figure}")


def plot(model, pendulum, first, truth, figure):
    fig, (circle, decay, orbit) = plt.subplots(
        1, 3, figsize=(13.5, 4.2), layout="constrained", width_ratios=[1.15, 1, 1.2]
    )
    SpectrumDisplay.from_estimator(model, ax=circle)

    frequencies = model.continuous_eigenvalues(STEP)[1]
    upper = frequencies >= 0
    decay.semilogy(
        frequencies[upper] / truth,
        model.residuals_[upper],
        "o",
        color="#0072B2",
        ms=5,
        mec="white",
        mew=0.5,
    )
    decay.set(
        xlabel="frequency / that of a long run",
        ylabel="residual",
        title="Harmonics and their residuals",
    )
    decay.xaxis.set_major_locator(plt.MaxNLocator(integer=True))
    decay.grid(axis="x", color="0.92")
    decay.set_axisbelow(True)

    phase = np.angle(model.eigenfunctions(pendulum.X)[:, first])
    momentum, position = pendulum.X.T
    dots = orbit.scatter(
        position,
        momentum,
        c=np.degrees(phase) % 360,
        cmap="twilight",
        s=14,
        vmin=0,
        vmax=360,
    )
    orbit.plot(
        *model.centers_[:, ::-1].T,
        "o",
        mfc="none",
        mec="k",
        ms=7,
        mew=0.8,
        label="centres",
    )
    colorbar = fig.colorbar(dots, ax=orbit, label="phase of the eigenfunction [deg]")
    colorbar.set_ticks([0, 90, 180, 270, 360])
    orbit.set(
        xlabel="position [rad]",
        ylabel="momentum [rad/s]",
        title=f"The first that oscillates, {abs(frequencies[first]):.4f} Hz",
        aspect="equal",
    )
    orbit.legend(frameon=False, loc="center")
    fig.savefig(figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
