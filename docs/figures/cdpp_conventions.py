"""Compare the two conventions of the CDPP on systematics and on white noise."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models import Detector, Motion, Star, simulate
from scope_models.photometry import cdpp

METHODS = {"lightkurve": "o-", "everest": "s--"}
FACTORS = np.array([0.5, 1.0, 2.0])


def make_figure():
    """Return the figure."""
    roll, white = {}, {}
    fluxes = []
    for factor in FACTORS:
        detector, motion = Detector.k2(), factor * Motion.k2_roll()
        observation = simulate(Star(12.0), detector, motion, seed=1, noise=False)
        fluxes.append(observation.flux.sum(axis=(1, 2)))
    noise = np.random.default_rng(1).normal(1, 100e-6, (200, 1000))
    for method in METHODS:
        roll[method] = [cdpp(flux, method=method) for flux in fluxes]
        white[method] = cdpp(noise, method=method)
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for method, style in METHODS.items():
        axes[0].loglog(FACTORS, roll[method], style, label=method)
        axes[1].hist(white[method], bins=20, alpha=0.6, label=method)
    axes[0].set_xticks(FACTORS, [f"{factor:g}" for factor in FACTORS])
    axes[0].minorticks_off()
    axes[0].set(xlabel="Factor on K2's motion", ylabel="CDPP (ppm)", title="Systematics alone")
    axes[1].axvline(100 / 13**0.5, color="black", lw=1, label="nominal")
    axes[1].set(xlabel="CDPP (ppm)", ylabel="Number of series", title="White noise alone")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


if __name__ == "__main__":
    make_figure()
