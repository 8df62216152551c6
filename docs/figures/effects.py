"""Figures of the effects of sky, telescope and detector."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models import Detector, Motion, Star, simulate
from scope_models.effects import Focus, ScatteredLight


def make_focus_figure():
    """Return the figure of a width that breathes, and of the flux in two apertures."""
    motion = Motion.still(600)
    focus = Focus(0.01, period=2.0, thermal=0.02, thermal_time=1.0, events=[motion.time[300]])
    detector = Detector.k2_calibrated()
    observation = simulate(Star(12.0), detector, motion, seed=1, noise=False, effects=focus)
    flux, time = observation.flux, motion.time - motion.time[0]
    figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
    top.plot(time, observation.truth.columns["FOCUS"])
    top.set_ylabel("Relative width")
    for half, label in ((1, "3 x 3 pixels"), (3, "7 x 7 pixels")):
        light = flux[:, 5 - half : 6 + half, 5 - half : 6 + half].sum(axis=(1, 2), dtype=float)
        bottom.plot(time, 1e6 * (light / np.median(light) - 1), label=label)
    bottom.set_xlabel("Time (d)")
    bottom.set_ylabel("Relative flux (ppm)")
    bottom.legend()
    return figure


def make_background_figure():
    """Return the figure of the light of Earth and Moon over a TESS sector."""
    motion = Motion.still(1300, cadence=1800 / 86400, start=1325.3, time_format="btjd")
    detector = Detector.tess(cadence=1800)
    light = ScatteredLight(residual=0.01)
    observation = simulate(Star(14.0), detector, motion, seed=1, effects=light)
    time = motion.time - motion.time[0]
    figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
    top.plot(time, observation.flux_bkg[:, 0, 0])
    top.set_ylabel("Background (e$^-$ s$^{-1}$)")
    bottom.plot(time, observation.flux[:, 0, 0], ".", markersize=2)
    bottom.set_xlabel("Time (d)")
    bottom.set_ylabel("Flux of a dark pixel\n(e$^-$ s$^{-1}$)")
    return figure
