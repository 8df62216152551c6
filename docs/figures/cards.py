"""Small figures for the cards of the front page and of the list of tutorials."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

from scope_models import (
    PRF,
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    TransitModel,
    fit_tpf,
    read_detector,
    simulate,
)
from scope_models.correctors import PLDCorrector
from scope_models.plotting import plot_fold, plot_motion, plot_pixels, plot_sensitivity

SIZE = (4.2, 3.2)


def _axes(**options):
    return plt.subplots(figsize=SIZE, layout="constrained", **options)


def _planet(motion, detector, depth=0.004):
    days = {"duration": 0.25, "period": 3.1, "t0": motion.time[40]}
    return TransitModel.from_depth_duration(depth, exposure_time=detector.cadence_days, **days)


def draw_pixels():
    """Draw a stamp of three stars and the track of the first."""
    stars = [Star(12.0, 4.6, 5.2), Star(13.0, 7.4, 2.6), Star(14.0, 1.7, 7.8)]
    observation = simulate(stars, Detector.k2(), 3 * Motion.k2_roll(400), seed=2)
    _, ax = _axes()
    plot_pixels(observation.flux[0], observation.aperture, title="Pixels, aperture, motion", ax=ax)
    ax.plot(observation.truth.x[0], observation.truth.y[0], color="w", lw=0.6)


def draw_correction():
    """Draw a raw and a corrected light curve with transits."""
    detector, motion = Detector.k2(), 3 * Motion.k2_roll(600)
    star = Star(12.0, signal=_planet(motion, detector))
    corrector = PLDCorrector(simulate(star, detector, motion, seed=3).to_tpf())
    corrected, raw = corrector.correct(), corrector.original_lc
    _, axes = _axes(nrows=2, sharex=True)
    for ax, curve, title in zip(axes, (raw, corrected), ("raw", "corrected"), strict=True):
        ax.plot(curve.time.value, curve.flux.value / np.nanmedian(curve.flux.value), "k.", ms=2)
        ax.set_title(title, loc="left")
        ax.set_ylabel("Relative flux")
        ax.ticklabel_format(useOffset=False)
    axes[1].set_xlabel("Time (BKJD)")


def draw_fit():
    """Draw data and residual of a fit, the residual in units of its noise."""
    observation = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(100), seed=1)
    fit = fit_tpf(observation.to_tpf(), psf=1)
    _, axes = _axes(ncols=2, sharey=True)
    panels = (
        ("data (e-/s)", fit.observed[0]),
        ("residual (sigma)", fit.residual[0] / fit.observed_err[0]),
    )
    for ax, (title, image) in zip(axes, panels, strict=True):
        shown = ax.imshow(image, origin="lower")
        bar = ax.figure.colorbar(shown, ax=ax, location="bottom")
        bar.locator = MaxNLocator(3)
        ax.set(title=title, xlabel="Column (pixel)")
    axes[0].set_ylabel("Row (pixel)")


def draw_transit():
    """Draw a folded transit of a corrected light curve."""
    detector, motion = Detector.k2(), 2 * Motion.k2_roll(600)
    planet = _planet(motion, detector, 0.001)
    star = Star(13.0, signal=planet)
    curve = PLDCorrector(simulate(star, detector, motion, seed=4).to_tpf()).correct()
    time, flux = curve.time.value, curve.flux.value / np.nanmedian(curve.flux.value)
    _, ax = _axes()
    plot_fold(
        time, flux, 3.1, motion.time[40], model=planet(time), window=12, n_bins=24, title="", ax=ax
    )


def draw_prf():
    """Draw the image of a PRF for each place of the star in a pixel."""
    prf = PRF(BivariateGaussianPSF(1.0, 0, 0, 0.5, 0.5) * SensitivityPolynomial())
    rows, columns = np.mgrid[:9, :9]
    prf.x_0, prf.y_0 = 4.3, 3.8
    _, ax = _axes()
    plot_pixels(prf(columns, rows), log=True, title="PRF of a star", ax=ax)


def draw_instrument():
    """Draw the response of the pixels of the instrument of the tutorial."""
    detector = read_detector("../examples/cubesat.toml")
    response = simulate(Star(8.0), detector, Motion.still(2), seed=1).truth.maps["INTERPIXEL"]
    _, ax = _axes()
    plot_sensitivity(response, title="Response of the pixels", ax=ax)


def draw_motion():
    """Draw the motion of a star over the pixels."""
    motion = 5 * Motion.k2_roll(300)
    _, ax = _axes()
    plot_motion(motion.time, 5 + motion.x, 5 + motion.y, time_label="Time (BKJD)", ax=ax)
