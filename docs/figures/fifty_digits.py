"""Figure of the errors of integrals over pixels against numbers with fifty digits."""

import matplotlib.pyplot as plt
import numpy as np
from astropy.table import Table

PANELS = {
    "terms": ("Terms of Mehler's series", r"$\rho$ ="),
    "nodes": ("Gauss-Legendre nodes along x", r"$\rho$ = 0.9, $\sigma$ ="),
    "panels": ("Panels in a pixel, star at its corner", r"$\sigma \sqrt{1 - \rho^2}$ ="),
    "coefficients": ("Chebyshev coefficients per 1.5 px of motion", r"$\sigma$ ="),
    "samples": ("Samples of a table per pixel", r"$\sigma$ ="),
    "places": (r"$\sigma$ (px), 108 hard places", r"$|\rho|$ ="),
}

TICKS = {
    "terms": [2, 5, 10, 20, 50, 100, 200],
    "panels": [1, 2, 5, 10, 20, 50],
    "samples": [3, 5, 9, 13, 19, 27],
    "places": [0.02, 0.1, 0.3, 1, 3],
}


def make_figure(path="../data/fifty_digits.ecsv"):
    """Return the figure; dots are the numbers that the package takes."""
    table = Table.read(path)
    figure, grid = plt.subplots(2, 3, figsize=(12, 7), sharey=True, layout="constrained")
    for axes, (kind, (label, case_label)) in zip(grid.ravel(), PANELS.items(), strict=True):
        rows = table[table["kind"] == kind]
        for case in np.unique(rows["case"]):
            line = rows[rows["case"] == case]
            error = np.maximum(line["error"], 1e-17)
            (drawn,) = axes.semilogy(line["order"], error, label=f"{case_label} {case:.4g}")
            if kind not in {"samples", "places"}:
                chosen = line["order"] == line["chosen"]
                axes.plot(line["order"][chosen], error[chosen], "o", color=drawn.get_color())
        axes.set_xlabel(label)
        if kind in TICKS:
            axes.set_xscale("log", subs=[])
            axes.set_xticks(TICKS[kind], TICKS[kind])
            axes.minorticks_off()
        axes.legend()
        axes.set_ylim(5e-18, 1)
    figure.suptitle("Dots: order that the package uses")
    for axes in grid[:, 0]:
        axes.set_ylabel("Largest error (fraction of the flux)")
    return figure
