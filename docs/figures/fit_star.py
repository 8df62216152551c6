"""Fit the pixels of a real K2 star, and simulate its twin."""

import warnings
from pathlib import Path

import numpy as np

from scope_models import Detector, Motion, Star, fit_tpf, simulate
from scope_models.exceptions import FitWarning
from scope_models.io import read_tpf
from scope_models.plotting import plot_twin

# From the folder of this file, in which the documentation's build runs it.
PATH = Path("../../../shared/data/k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz")
EVERY = 6  # of the cadences, for time's sake


def fit_star(path=PATH):
    """Return the fit of the archive file; without it, that of a simulated star."""
    if path.exists():
        tpf = read_tpf(path)[::EVERY]
    else:
        tpf = simulate(Star(15.0), Detector.k2(shape=(6, 6)), 2 * Motion.k2_roll(300), seed=1)
        tpf = tpf.to_tpf()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FitWarning)  # the text describes them
        return fit_tpf(tpf)


def make_figure(path=PATH):
    """Return the figure of the fit."""
    return fit_star(path).plot()["data"].figure


def make_twin(path=PATH):
    """Return the figure of the star, without the fitted background, and of its twin."""
    fit = fit_star(path)
    observation = simulate(*fit.scene(), seed=1)
    light = fit.observed - fit.background[:, None, None], observation.flux
    residuals = fit.residual, observation.flux - observation.model()
    image = np.nanmedian(fit.observed, axis=0)
    every, brightest = np.isfinite(image), image > 0.5 * np.nanmax(image)
    curves = []
    for cube in light:
        sums = [np.nansum(cube[:, pixels], axis=1, dtype=float) for pixels in (every, brightest)]
        curves.append([values / np.median(values) for values in sums])
    images = [np.nanstd(cube / fit.observed_err, axis=0) for cube in residuals]
    axes = plot_twin(fit.time, *curves, images, time_label="Time (BKJD)")
    axes["raw"].set_title("All pixels")
    axes["corrected"].set_title("Brightest pixels")
    return axes["raw"].figure
