"""
========================================
What the scale of a kernel does
========================================

Figure 3 of the paper: the same 37 centres of a pendulum, the same Matern-3/2 kernel, at
the scales beta = 5, 1, 0.5 and 0.2. All four estimates return the outputs at the
centres. Between the centres a small scale is of little use: with beta below the
distance of neighbouring centres the estimate is a row of spikes that fall to zero, even
on the orbit. With a large scale the estimate is smooth on the orbit and plausible some
way off, but digits are lost: the condition number of the Gram matrix rises by five
powers of ten.

The paper shows the surfaces only. The table has the errors on the samples that are no
centres and over the rectangle around the orbit, the condition number of the Gram
matrix, how many of 16 digits the coefficients lose by it, and the norm of the estimate
in the native space of its kernel (the function space that the kernel defines), which
bounds the error. Among the four scales the norm is smallest at beta = 1. It is larger
for the spikes at the small scales, and for the large scale, where the kernel is flatter
than the output.

What differs from the printed paper: the start of the pendulum is not given there
((momentum, position) = (0, 2) with centres 0.23 apart gives its M = 37), and its Matern
formula has the squared distance, which is not positive definite. This is the true
kernel. With the square, beta would be a squared length, so that the printed panels are
those of other scales.

The paper is N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
for Estimation of Animal Motions over Unknown Submanifolds", arXiv:2203.05646, 2022.
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.diagnostics import condition_number, digits_lost
from sklearn_koopman.plotting import SurfaceDisplay

BETAS = (5.0, 1.0, 0.5, 0.2)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description="Estimates for a pendulum by Matern kernels of four scales."
    )
    parser.add_argument(
        "--figure", default="beta.png", help="where to save (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    pendulum = make_pendulum(256)
    models = {
        beta: KoopmanKernelRegressor(
            "matern32", beta=beta, centers=SeparatedCenterSelector(0.23)
        ).fit(pendulum.X, pendulum.y)
        for beta in BETAS
    }
    displays = plot(models, pendulum, options.figure)

    rows = models[1.0].center_indices_
    others = np.setdiff1d(np.arange(len(pendulum.X)), rows)
    print(f"Matern-3/2, M = {len(rows)} centres of {len(pendulum.X)} samples")
    print(
        "          largest error on    largest and mean error  condition  digits"
        "  native\n"
        "   beta      other samples        over the rectangle     number    lost"
        "    norm"
    )
    for beta, model in models.items():
        on = np.abs(model.predict(pendulum.X[others]) - pendulum.y[others]).max()
        off = np.abs(displays[beta].estimate - displays[beta].truth)
        K = model.kernel_(model.centers_)
        norm = np.sqrt(model.dual_coef_ @ K @ model.dual_coef_)
        condition = condition_number(model.kernel_, model.centers_)
        print(
            f"{beta:7g} {on:18.1e} {off.max():16.2f} {off.mean():8.2f} "
            f"{condition:10.1e} {digits_lost(condition):7.1f} {norm:7.2f}"
        )
    print(
        "differs from the print: the start of the pendulum, not given there; the true "
        "Matern kernel, without the square of the distance"
    )
    print(f"figure saved as {options.figure}")


def plot(models, pendulum, figure):
    fig, axes = plt.subplots(
        2, 2, figsize=(8.5, 7.6), subplot_kw={"projection": "3d"}, layout="constrained"
    )
    # The layout does not know of the labels of vertical axes; leave room on the right.
    fig.get_layout_engine().set(rect=(0, 0, 0.98, 1))
    displays = {}
    for ax, letter, (beta, model) in zip(
        axes.flat, "abcd", models.items(), strict=True
    ):
        displays[beta] = SurfaceDisplay.from_estimator(
            model,
            pendulum.X,
            pendulum.y,
            function=lambda X: pendulum.G(pendulum.f(X)),
            z_limits=(-0.6, 3.2),
            feature_names=["momentum [rad/s]", "position [rad]"],
            output_name="next output",
            ax=ax,
            legend=False,
        )
        ax.set_title(f"({letter}) β = {beta:g}", y=0.95)
        ax.view_init(elev=24, azim=-52)
        ax.set_box_aspect((1, 1, 0.75), zoom=0.93)
    fig.legend(
        handles=next(iter(displays.values())).handles_,
        loc="outside lower center",
        ncols=5,
        frameon=False,
    )
    fig.savefig(figure, dpi=120)
    plt.close(fig)
    return displays


if __name__ == "__main__":
    main()
