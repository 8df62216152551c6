"""Pixel-level de-correlation of stars from the ground, beside differential photometry.

    python studies/paper/ground.py --workers 2

A telescope with seeing, extinction, thin clouds and scintillation follows a field for some nights.
Apertures follow the stars; the sum of three comparison stars is the reference of differential
photometry. PLD gets the target's pixels as they are, and divided by the reference.
"""

import numpy as np
from _correctors import amplitude, quiet
from _figures import plot_maps
from _study import cells, grid, medians, parameters, study_of
from lightkurve import TessTargetPixelFile
from photutils.aperture import CircularAperture

from scope_models import Detector, Motion, PLDCorrector, Star, TransitModel, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.effects import DarkCurrent, Extinction, Scintillation, Seeing
from scope_models.io.tpf import make_tpf_hdulist
from scope_models.models import moffat_psf

# Target and comparison stars, far from each other; the cut for PLD is about the target.
SHAPE, TARGET, HALF = (57, 57), (28.0, 28.0), 8
COMPARISONS = ((11.0, 11.0), (45.0, 11.0), (11.0, 45.0))
RADIUS = 6.0  # px, 2.4 FWHM of the median seeing
NIGHT, CADENCE, EXPOSURE = 6.0, 180.0, 60.0  # h, s, s
ALTITUDE, EXTINCTION, CLOUDS = 2400.0, 0.07, 0.02
MEANS = 10  # cadences of the means: 30 minutes
DEPTH, DURATION = 0.01, 0.1
METHODS = {
    "raw": "Aperture alone",
    "raw_pld": "PLD alone",
    "differential": "Differential photometry",
    "differential_pld": "PLD on differential pixels",
}
SURVIVALS = tuple(f"{name}_survival" for name in METHODS if name.startswith("differential"))
UNITS = dict.fromkeys(("floor", *METHODS), "ppm")


@parameters
class GroundPLD:
    seed: int = 1
    flats: tuple[float, ...] = (0.002, 0.01)  # scatter of the pixels' response after flat-fielding
    drifts: tuple[float, ...] = (0.03, 0.15)  # of the tracking, arcsec/h
    aperture: float = 1.0  # diameter of the telescope, m
    mag: float = 14.5  # R of the target; the comparison stars are 0.3 mag brighter
    stars: int = 3  # fields per cell
    cadences: int = 360  # exposures of 60 s, 120 in a night


tasks = grid("flat{flat:g}-drift{drift:g}-{index}", index="stars", flat="flats", drift="drifts")


def observe(study, task, signal=None):
    """Return the pixels of a field with a signal of the target; all cells have the same weather."""
    field = f"field{task['index']}"
    seed = star_seed(study.seed, field, "noise")
    motion = Motion.ground(
        study.cadences, cadence=CADENCE, night=NIGHT, drift=task["drift"],
        aperture=study.aperture, seed=seed,
    )  # fmt: skip
    # The stars cross the zenith in the middle of each night.
    days = motion.time - motion.time[0]
    hours = 24 * (days - np.floor(days + 1e-9))
    airmass = 1 / np.cos(np.radians(14 * (hours - NIGHT / 2)))
    effects = (
        Extinction(EXTINCTION, airmass, scatter=CLOUDS, correlation_time=0.05),
        Scintillation(study.aperture, ALTITUDE, airmass),
        Seeing(airmass=airmass),
        DarkCurrent(0.1),
    )
    detector = Detector.ground(
        study.aperture, shape=SHAPE, int_time=EXPOSURE, read_time=CADENCE - EXPOSURE,
        interpixel_scatter=task["flat"], effects=effects, psf=moffat_psf(2.5, n_components=5),
    )  # fmt: skip
    shifts = star_rng(study.seed, field).uniform(-0.5, 0.5, (4, 2))
    places = np.array([TARGET, *COMPARISONS]) + shifts
    stars = [Star(study.mag - 0.3 * (i > 0), *place) for i, place in enumerate(places)]
    stars[0] = stars[0].replace(signal=signal)
    return simulate(stars, detector, motion, seed=seed)


def measure(study, task):
    """Return the noise of a target, without any filter in time.

    Standard deviation of means of 30 minutes in ppm: of the aperture alone ("raw"), of the aperture
    over the comparison stars ("differential"), the same after PLD ("_pld"), and of the
    noise that differential photometry cannot avoid ("floor"); "_survival", the part of the
    depth of transits of 1 % that is left, by which the noise is divided.
    """
    observation = observe(study, task)
    time = observation.time
    orbit = DEPTH, DURATION, 0.9, time[0] + 0.125
    planet = TransitModel.from_depth_duration(*orbit, exposure_time=EXPOSURE / 86400)
    still, dimmed = photometry(observation), photometry(observe(study, task, planet))
    row = {"floor": floor(observation)} | {name: noise(still[name]) for name in METHODS}
    for name in METHODS:
        if f"{name}_survival" in SURVIVALS:
            survival = amplitude(dimmed[name] - still[name], planet(time) - 1)
            row |= {f"{name}_survival": survival, name: row[name] / abs(survival)}
    return row


def photometry(observation):
    """Return the relative flux of the target by each method, less 1."""
    sums = moving_sums(observation, observation.flux)
    reference = sums[1:].sum(axis=0)
    reference /= np.median(reference)
    found = {"raw": sums[0], "differential": sums[0] / reference}
    cut = np.s_[:, *(slice(round(at) - HALF, round(at) + HALF + 1) for at in TARGET[::-1])]
    for name, divisor in (("raw_pld", np.ones_like(reference)), ("differential_pld", reference)):
        cubes = observation.flux[cut], observation.flux_err[cut]
        flux, error = (cube / divisor[:, np.newaxis, np.newaxis] for cube in cubes)
        hdus = make_tpf_hdulist(
            metadata="Ground", time=observation.time, flux=flux, flux_err=error,
            pos_corr1=observation.motion.x, pos_corr2=observation.motion.y,
        )  # fmt: skip
        with quiet():
            corrected = PLDCorrector(TessTargetPixelFile(hdus, quality_bitmask="none")).correct()
        found[name] = np.full(len(reference), np.nan)
        used = np.searchsorted(observation.time, corrected.time.value - 1e-6)
        found[name][used] = corrected.flux.value
    return {name: flux / np.nanmedian(flux) - 1 for name, flux in found.items()}


def moving_sums(observation, cube):
    """Return the flux of all stars in apertures that follow them, shape (n_stars, n_cadences)."""
    places = np.transpose([observation.truth.x, observation.truth.y], (2, 1, 0))
    masks = (CircularAperture(each, RADIUS).to_mask() for each in places)
    return np.array([
        [mask.multiply(image).sum() for mask in group]
        for group, image in zip(masks, cube.astype(float), strict=True)
    ]).T  # fmt: skip


def floor(observation):
    """Return the noise that differential photometry cannot avoid, ppm in 30 minutes."""
    factor = observation.truth.columns["SCINTILLATION"].T
    light = moving_sums(observation, observation.model())
    variance = moving_sums(observation, observation.flux_err**2) / light**2
    variance += factor.var(axis=1)[:, None]
    # The reference is the sum of stars of about the same brightness.
    total = np.mean(variance[0] + variance[1:].mean(axis=0) / len(COMPARISONS))
    return float(1e6 * np.sqrt(total / MEANS))


def noise(change):
    """Return the standard deviation of means of cadences, ppm."""
    means = change[: len(change) // MEANS * MEANS].reshape(-1, MEANS)
    kept = means[np.isfinite(means).sum(axis=1) > MEANS / 2]
    return float(1e6 * np.std(np.nanmean(kept, axis=1)))


def summarize(_, table):
    """Return medians, and "ratio", that of PLD on differential pixels to that without.

    The ratio is the median over the fields, "ratio_error" its standard error.
    """
    cell, table = ("flat", "drift"), table.copy()
    table["ratio"] = np.array(table["differential_pld"] / table["differential"])
    summary = medians(table, cell, ("floor", *METHODS, *SURVIVALS, "ratio"))
    ratios = [np.array(part["ratio"]) for _, part in cells(table, cell)]
    # 1.25 sigma / sqrt(n): the standard error of a median of normal numbers.
    summary["ratio_error"] = [
        1.2533 * np.std(ratio, ddof=1) / np.sqrt(len(ratio)) if len(ratio) > 1 else np.nan
        for ratio in ratios
    ]
    return summary


def draw(_, __, summary):
    """Draw maps of the noise of each method."""
    return plot_maps(
        summary, {label: name for name, label in METHODS.items()},
        ("flat", "Response between pixels"), ("drift", "Drift (arcsec/h)"),
        label="Noise in 30 min (ppm)", text=".0f",
    )  # fmt: skip


main = study_of("ground", GroundPLD, tasks, measure, summarize, draw, UNITS)

if __name__ == "__main__":
    main()
