"""Figures of the effects of sky, telescope and detector."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models import BivariateGaussianPSF, Detector, Motion, Star, simulate
from scope_models.effects import (
    BrighterFatter,
    ChargeTransferInefficiency,
    CosmicRays,
    Extinction,
    Focus,
    Jitter,
    RollingBands,
    ScatteredLight,
    Scintillation,
    Seeing,
    SensitivityDropouts,
    Throughput,
)
from scope_models.effects.charge import rejected_shift


def make_focus_figure():
    """Return the figure of a width that breathes, and of the flux in two apertures."""
    motion = Motion.still(600)
    focus = Focus(0.01, period=2.0, thermal=0.02, thermal_time=1.0, events=[motion.time[300]])
    detector = Detector.k2_calibrated()
    observation = simulate(Star(12.0), detector, motion, seed=1, noise=False, effects=focus)
    flux, time = observation.flux, motion.time - motion.time[0]
    figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
    top.plot(time, observation.truth.columns["FOCUS"])
    top.set(title="Width of a PSF that breathes", ylabel="Relative width")
    for half, label in ((1, "3 x 3 pixels"), (3, "7 x 7 pixels")):
        light = flux[:, 5 - half : 6 + half, 5 - half : 6 + half].sum(axis=(1, 2), dtype=float)
        bottom.plot(time, 1e6 * (light / np.median(light) - 1), label=label)
    bottom.set(title="Flux of a star at rest", xlabel="Time (d)", ylabel="Relative flux (ppm)")
    bottom.legend(title="Aperture", loc="lower left")
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
    top.set(title="Subtracted background of a TESS pixel", ylabel="Background (e$^-$ s$^{-1}$)")
    bottom.plot(time, observation.flux[:, 0, 0], ".", markersize=2)
    bottom.set(
        title="Background left in the pixel", xlabel="Time (d)", ylabel="Flux (e$^-$ s$^{-1}$)"
    )
    return figure


def make_jitter_figure():
    """Return the figure of what jitter moves and blurs."""
    motion = Motion.still(4000, cadence=120 / 86400)
    detector = Detector.tess(shape=(9, 9), well_depth=None)
    times = np.geomspace(2, 5000, 8)
    drawn = []
    for seed, time in enumerate(times):
        jitter = Jitter(0.05, correlation_time=time)
        columns = simulate(
            Star(10.0), detector, motion, seed=seed, noise=False, effects=jitter
        ).truth.columns
        drawn.append((columns["JITTER_X"].std(), columns["JITTER_BLUR"][0]))
    means, blurs = np.transpose(drawn)
    fine = np.geomspace(2, 5000, 200) / 120
    variance = 2 * fine * (1 - fine * (1 - np.exp(-1 / fine)))
    figure, axes = plt.subplots(layout="constrained")
    axes.semilogx(120 * fine, 0.05 * np.sqrt(variance), label="motion between cadences")
    axes.plot(times, means, "o", color="C0")
    axes.plot(120 * fine, 0.05 * np.sqrt(1 - variance), "--", label="blur within a cadence")
    axes.plot(times, blurs, "s", color="C1")
    axes.set_title("Jitter of 0.05 pixel (points: simulated, lines: formula)")
    axes.set(xlabel="Correlation time (s)", ylabel="Standard deviation (pixel)")
    axes.legend(loc="center right")
    return figure


def make_response_figure():
    """Return the figure of changes of the response in time."""
    motion = Motion.still(600)
    effects = (
        Throughput(0.001, period=2.0),
        SensitivityDropouts(rate=0.01, depth=0.1, recovery=0.6, recovery_time=0.5),
    )
    figure, panels = plt.subplots(2, sharex=True, layout="constrained")
    titles = "Periodic throughput", "Sudden dropouts of single pixels"
    for axes, effect, title in zip(panels, effects, titles, strict=True):
        observation = simulate(
            Star(12.0), Detector.k2_calibrated(), motion, seed=3, noise=False, effects=effect
        )
        light = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
        axes.plot(motion.time - motion.time[0], light / light[0])
        axes.set(title=title, ylabel="Relative flux")
    axes.set_xlabel("Time (d)")
    return figure


def make_rays_figure():
    """Return the figure of cosmic rays and of their rejection."""
    detector = Detector.kepler(shape=(40, 40))
    scene = Star(12.0), detector, Motion.still(1)
    charge = [
        simulate(*scene, seed=2, noise=False, effects=effects).flux[0] * detector.exposure_time
        for effects in ([CosmicRays()], [])
    ]
    figure, (left, right) = plt.subplots(1, 2, layout="constrained", figsize=(9, 4))
    image = left.imshow(charge[0] - charge[1], origin="lower", vmax=4000)
    figure.colorbar(image, label="Charge (e$^-$)", shrink=0.85)
    left.set(title="One long cadence", xlabel="Column (pixel)", ylabel="Row (pixel)")
    d = np.linspace(0, 12, 200)
    right.plot(d, rejected_shift(d))
    right.set_title("Highest and lowest of ten reads dropped")
    right.set(xlabel=r"Charge of a hit ($\sigma$)", ylabel=r"Charge that is left ($\sigma$)")
    return figure


def make_charge_figure():
    """Return the figure of the brighter-fatter effect."""
    figure, (left, right) = plt.subplots(1, 2, layout="constrained", figsize=(9, 4))
    detector = Detector.kepler(n_frames=1, background=0.0).without_sensitivity()
    x, effect = np.arange(11) - 5, BrighterFatter()
    peaks, growth = [], []
    for mag in np.linspace(10.9, 15, 12):
        observation = simulate(
            Star(mag), detector, Motion.still(1), noise=False, effects=effect, seed=1
        )
        images = observation.flux[0].astype(float), observation.model()[0]
        widths = [np.sqrt((image * x**2).sum() / image.sum() - 1 / 12) for image in images]
        peaks.append(images[1].max() * detector.exposure_time)
        growth.append(100 * (widths[0] / widths[1] - 1))
    left.plot(peaks, growth, "o-")
    left.set(title="Star", xlabel="Charge of the brightest pixel (e$^-$)")
    left.set_ylabel("Growth of the width (%)")
    levels, ratios = np.linspace(1e4, 1e6, 12), []
    for level in levels:
        flat = detector.replace(
            shape=(60, 60), background=level / detector.int_time, well_depth=None
        )
        flux = simulate(
            Star(40.0), flat, Motion.still(20), noise="background", effects=effect, seed=5
        ).flux[:, 1:-1, 1:-1]
        ratios.append(flux.var() * detector.exposure_time**2 / level)
    right.plot(levels, ratios, "o", label="simulated")
    k = effect.coefficient * levels / effect.full_well
    right.plot(levels, (1 - 4 * k) ** 2 + 4 * k**2, label="formula")
    right.set(title="Flat field", xlabel="Charge of a pixel (e$^-$)")
    right.set_ylabel("Variance / photon variance")
    right.legend()
    return figure


def make_ground_figure():
    """Return the figure of the noise per minute against the aperture of the telescope."""
    apertures, column = np.array([0.4, 0.95, 2.0, 3.5, 8.0]), 1.3
    options = {"airmass": column, "n_frames": 10, "int_time": 6.0, "read_time": 0.0}
    options |= {"well_depth": None, "altitude": 2788.0}
    wide = BivariateGaussianPSF(1.0, 0, 0, 3.4, 3.4)
    kinds = {
        "seeing of 1 arcsec": (Seeing(airmass=column), {}),
        "diffuser of 8 arcsec": (
            Seeing(0.0025),
            {"shape": (29, 29), "pixel_scale": 1.0, "psf": wide},
        ),
    }
    figure, axes = plt.subplots(layout="constrained")
    for name, (seeing, changes) in kinds.items():
        noise = []
        for aperture in apertures:
            effects = Extinction(0.07, column), Scintillation(aperture, 2788.0, column), seeing
            detector = Detector.ground(aperture, **options, **changes, effects=effects)
            motion = Motion.ground(300, aperture=aperture, pixel_scale=detector.pixel_scale)
            flux = simulate(Star(11.0), detector, motion, seed=1).flux.sum(axis=(1, 2), dtype=float)
            noise.append(1e6 * flux.std() / flux.mean())
        axes.loglog(apertures, noise, "o", label=f"simulated, {name}")
    fine = np.geomspace(0.3, 10, 100)
    formula = [1e6 * Scintillation(d, 2788.0, column).rms(60.0) for d in fine]
    axes.plot(fine, formula, label="scintillation")
    for level in (300, 1000):
        label = "limits of Saunders et al." if level == 300 else None
        axes.axhline(level, color="gray", linestyle=":", label=label)
    axes.set_xlabel("Aperture of the telescope (m)")
    axes.set_ylabel("Noise per minute (ppm)")
    axes.legend()
    return figure


def make_readout_figure():
    """Return the figure of trails behind a bright pixel, and of rolling bands."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
    for epsilon in (1e-5, 1e-4, 1e-3):
        column = np.zeros((1, 9, 1))
        column[0, 2] = 1.0
        ChargeTransferInefficiency(epsilon, 0.0).readout(None, None, None, column)
        left.semilogy(
            np.arange(-2, 7), np.maximum(column[0, :, 0], 1e-9), "o-", label=f"{epsilon:g}"
        )
    left.set_ylim(1e-8, 1e3)  # room for the legend
    left.set(title="Charge transfer", xlabel="Rows behind the bright pixel")
    left.set_ylabel("Fraction of the charge")
    left.legend(title="Inefficiency")
    detector, motion = Detector.k2(shape=(60, 5), background=0.0), Motion.still(300)
    bands = simulate(
        Star(40.0), detector, motion, seed=10, noise=False, effects=RollingBands(rate=0.2)
    )
    days = motion.time - motion.time[0]
    shown = right.pcolormesh(days, np.arange(60), bands.flux[:, :, 0].T, cmap="RdBu_r")
    right.set(title="Rolling bands in an empty stamp", xlabel="Time (d)", ylabel="Row (pixel)")
    figure.colorbar(shown, ax=right, label="Flux (e$^-$ s$^{-1}$)")
    return figure
