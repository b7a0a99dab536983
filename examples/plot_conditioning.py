"""
===================================================
What it costs to put centres close together
===================================================

Figures 5 to 7 of the paper. More centres make the estimate better
(`plot_convergence.py`) and the Gram matrix worse. For centres at roughly equal
distances its condition number rises like the separation distance to the power -2 s,
where s is the order of the kernel on the manifold: smoother kernels pay more (Figure
5). The scale of a kernel shifts the curve and leaves its slope (Figure 6).

Figures 5 and 6 of the paper have 2 to 64 centres from 256 samples, the grey part of the
panels here. That is too few for the slopes. As long as the supports of radius beta = 1
hold a few centres only, the matrix is nearly the identity. The curves of the three
Wendland kernels even cross: in the order of their smoothness, as the paper reports
them, they come at the end of that range only (or for a larger beta, which the print
does not give). From 4000 samples of the same orbit the table measures where the slopes
settle. They still scatter by some 0.3 with the range of separations, since the centres
of a greedy selection are not equally spaced.

Figure 7 keeps the fill distance and crowds one pair of centres. The paper sets a lower
bound of the smallest eigenvalue beside it, the separation to the power 2 k + 1 for a
Wendland kernel of smoothness 2 k, which is 3 for C2, 5 for C4 and 7 for C6. The
eigenvalue itself falls like the square of the distance for all three. The bound is for
the worst case, in which all centres are that close together. Two at the distance r,
with the others far away, have the matrix with 1 on its diagonal and phi(r) beside it,
whose smallest eigenvalue is 1 - phi(r): proportional to r^2 for a profile that is
smooth at zero, and to r for one with a cusp, such as C0. The slope of C0 is therefore
that of its bound.

What differs from the printed paper: the Matern kernel here is the true one. The formula
in the paper has the squared distance, and its matrix is not positive definite: some
eigenvalues are negative, and the condition number has no meaning. The paper does not
state where the pendulum starts (here at (momentum, position) = (0, 2)), the scales in
Figure 6 (here those of Figure 3), and kernel and scale in Figure 7 (here C2 and
beta = 4, with three others in the table). At beta = 1 the first three curves of Figure
7 would lie on top of each other, because no other support reaches the crowded pair.

The paper is N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
for Estimation of Animal Motions over Unknown Submanifolds", arXiv:2203.05646, 2022.
"""

import argparse

import matplotlib

matplotlib.use("Agg")  # the figure is saved, not shown

import matplotlib.pyplot as plt
import numpy as np

from sklearn_koopman.datasets import make_pendulum
from sklearn_koopman.diagnostics import conditioning_study, crowding_study
from sklearn_koopman.plotting import ConditioningDisplay

WENDLAND = {f"wendland_c{k}": f"Wendland C{k}" for k in (2, 4, 6)}
BETAS = (5.0, 1.0, 0.5, 0.2)
FEW = np.geomspace(3.5, 0.135, 12)  # the separations of the paper's 2 to 64 centres
MANY = np.geomspace(0.1, 0.015, 12)
CROWDED = (1.35, 0.8, 0.5, 0.23)  # 7 to 37 centres
GAPS = np.geomspace(0.1, 0.002, 8)
CROWDED_BETA = 4.0


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description="Condition numbers and smallest eigenvalues of Gram matrices."
    )
    parser.add_argument(
        "--figure",
        default="conditioning.png",
        help="where to save (default: %(default)s)",
    )
    options = parser.parse_args(arguments)

    paper, fine = make_pendulum(256).X, make_pendulum(4000).X
    smoothness, scales = (
        [
            conditioning_study(kernels, betas, X, separations, dimension=1)
            for X, separations in ((paper, FEW), (fine, MANY))
        ]
        for kernels, betas in ((list(WENDLAND), [1.0]), (["matern32"], BETAS))
    )
    few, many = smoothness
    print(
        f"slope of log condition number over log separation distance,\n"
        f"few: the finer half of {few.n_centers[0]} to {few.n_centers[-1]} centres of "
        f"{len(paper)} samples, as in the paper;\n"
        f"many: that of {many.n_centers[0]} to {many.n_centers[-1]} centres of "
        f"{len(fine)} samples of the same orbit\n"
        "                              few           many    expected -2 s  "
        "condition number of many"
    )
    for (few, many), names in (
        (smoothness, list(WENDLAND.values())),
        (scales, ["Matern-3/2"]),
    ):
        for i, name in enumerate(names):
            for j, beta in enumerate(many.beta):
                slopes = "  ".join(
                    f"{study.slope[i, j]:6.2f} ± "
                    f"{np.ptp(study.slope_interval[i, j]) / 2:4.2f}"
                    for study in (few, many)
                )
                low, high = many.condition_number[i, j, [0, -1]]
                print(
                    f"{name}, beta = {beta:<4g}  {slopes} "
                    f"{many.expected_slope[i]:11.0f}       {low:9.1e} to {high:.1e}"
                )

    numbers = smoothness[0].condition_number[:, 0]
    ordered = (np.diff(numbers, axis=0) > 0).all(axis=0)
    print(
        "M of the few where C2, C4 and C6 come in this order: "
        + ", ".join(str(n) for n in smoothness[0].n_centers[ordered])
    )

    crowding = {
        k: crowding_study(f"wendland_c{k}", paper, CROWDED, GAPS, beta=CROWDED_BETA)
        for k in (0, 2, 4, 6)
    }
    counts = crowding[2].n_centers
    print(
        "\nslope of log smallest eigenvalue over log separation distance, one crowded "
        f"pair, beta = {CROWDED_BETA:g}\n"
        f"{'kernel':12}{''.join(f'  M = {n:<4d}' for n in counts)}"
        "  exponent of the bound"
    )
    for k, study in crowding.items():
        cells = "".join(f"{slope:8.2f}  " for slope in study.slope)
        print(f"Wendland C{k} {cells} {k + 1:14d}")
    print(
        "differs from the print: the true Matern kernel, without the square of the "
        "distance; slopes measured, with more centres too; the scale in Figure 7"
    )
    plot(smoothness, scales, crowding[2], options.figure)
    print(f"figure saved as {options.figure}")


def joined(studies, names, ax):
    """Draw few and many centres as one curve, the range of the paper in grey."""
    few, many = studies
    q = np.concatenate([study.separation_distance for study in studies])
    numbers = np.concatenate([study.condition_number for study in studies], axis=-1)
    numbers = numbers.reshape(len(names), -1)
    slopes = [f"{slope:.2f}" for slope in many.slope.ravel()]
    expected = ", ".join(f"{slope:.0f}" for slope in many.expected_slope)
    minus = "\N{MINUS SIGN}"
    ConditioningDisplay(
        separation_distance=np.broadcast_to(q, numbers.shape),
        values=numbers,
        labels=[
            f"{name}: {slope}".replace("-", minus)
            for name, slope in zip(names, slopes, strict=True)
        ],
        legend_title=f"slope, expected {expected}".replace("-", minus),
    ).plot(ax)
    q = few.separation_distance
    ax.axvspan(q.min(), q.max(), color="0.92", zorder=0, lw=0)
    ax.text(
        *(np.sqrt(q.min() * q.max()), 0.01),
        f"M = {few.n_centers[0]} to {few.n_centers[-1]}\nin the paper",
        ha="center",
        fontsize="small",
    )
    ax.set_ylim(0.003, 3e14)


def plot(smoothness, scales, crowding, figure):
    fig, axes = plt.subplots(1, 3, figsize=(10.8, 4.4), layout="constrained")
    joined(smoothness, list(WENDLAND.values()), axes[0])
    axes[0].set_title("Figure 5: smoothness, β = 1")
    joined(scales, [f"β = {beta:g}" for beta in BETAS], axes[1])
    axes[1].set(title="Figure 6: Matern-3/2, scales", ylabel=None)
    ConditioningDisplay.from_study(crowding, ax=axes[2])
    axes[2].set_title(f"Figure 7: a crowded pair, β = {CROWDED_BETA:g}")
    fig.savefig(figure, dpi=120)
    plt.close(fig)


if __name__ == "__main__":
    main()
