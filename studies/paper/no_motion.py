r"""Benchmark 1 of the paper: noise of stars that do not move, beside that of Kepler.

    python studies/paper/no_motion.py --workers 4
    python studies/paper/no_motion.py --fit

Photons, background and read noise are those of `Detector.kepler`. To these comes a *floor*, white
noise in proportion to the flux that all stars have, and in a second light curve of each star its
own variability, red noise of a CDPP that is log-normal for dwarfs and, in another way, for giants.
The part of giants is :math:`f_g e^{-\gamma (Kp - 11.5)}`. The seven fitted numbers follow from the
five percentiles of Kepler's table in the nine bins from Kp 11.5 to 15.5, with variability, and from
its 10th percentiles with detector noise alone ("--fit"); compare Gilliland, R. L. et al. 2011, ApJS
197, 6.
"""

import sys
from dataclasses import replace

import numpy as np
from _figures import make_panels, plot_cdpp
from _reference import PERCENTILES, compared, noise_band, read_reference
from _stars import draw_star
from _study import cells, grid, parameters, study_of
from astropy.table import Table
from scipy.optimize import minimize
from scipy.special import ndtri

from scope_models import Detector, Motion, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.models import stochastic_signal
from scope_models.photometry import cdpp
from scope_models.plotting._style import styled

PARTS = "photon", "background", "read"
UNITS = {"kp": "mag"} | dict.fromkeys(("detector_cdpp", "cdpp", "variability", *PARTS), "ppm")
WIDTH = 13  # cadences in the 6.5 hours of a CDPP
BRIGHT = 11.5  # magnitude at which `giant_fraction` holds
# Steps of an evenly spaced sequence in two dimensions: inverse powers of the plastic number.
STEPS = np.array([0.7548776662466927, 0.5698402909980532])


# Two values to start from of each number that is fitted, and weights of the percentiles.
STARTS = {
    "floor": (8, 5), "dwarf_cdpp": (25, 30), "dwarf_scatter": (0.7, 0.5), "giant_cdpp": (170, 150),
    "giant_scatter": (0.35, 0.4), "giant_fraction": (0.41, 0.41), "giant_decline": (0.39, 0.39),
}  # fmt: skip
DETECTOR_WEIGHT, WEIGHTS = 2.0, np.array([1.0, 1.0, 2.0, 1.0, 0.5])


@parameters
class NoMotion:
    seed: int = 1
    magnitudes: tuple[float, ...] = tuple(float(mag) for mag in np.arange(11.5, 15.6, 0.5))
    stars: int = 100  # per bin; magnitudes and variability are spread evenly over them
    width: float = 0.5  # of the bins, as those of the reference
    cadences: int = 1000
    floor: float = 8.7  # CDPP, ppm: the standard deviation per cadence over the root of 13
    dwarf_cdpp: float = 23.5  # median of the CDPP (lightkurve's convention) of dwarfs, ppm
    dwarf_scatter: float = 0.79  # standard deviation of its natural logarithm
    giant_cdpp: float = 209.0
    giant_scatter: float = 0.38
    giant_fraction: float = 0.43  # at Kp 11.5
    giant_decline: float = 0.28  # per magnitude


tasks = grid("kp{mag:g}-{index}", mag="magnitudes", index="stars")


def even(study, task):
    """Return two numbers within 0 and 1 that are evenly spread over the stars of a bin."""
    shift = star_rng(study.seed, f"kp{task['mag']:g}", "shift").uniform(size=2)
    return np.clip((shift + task["index"] * STEPS) % 1.0, 1e-4, 1 - 1e-4)


def quiet_star(study, task):
    """Return a star with the floor and without variability."""
    mag = task["mag"] + study.width * (even(study, task)[0] - 0.5)
    white = star_rng(study.seed, task["key"], "floor").standard_normal(study.cadences)
    signal = 1 + 1e-6 * study.floor * WIDTH**0.5 * white
    return draw_star(star_rng(study.seed, task["key"]), mag, Detector.kepler(), signal=signal)


def variability(study, mag, place):
    """Return the CDPP of stars' variability in ppm, and whether they are giants; 0 < place < 1."""
    part = study.giant_fraction * np.exp(-study.giant_decline * (mag - BRIGHT))
    part = np.clip(part, 1e-9, 1 - 1e-9)
    giant = place < part
    deviate = ndtri(np.where(giant, place / part, (place - part) / (1.0 - part)).clip(1e-9))
    giants = study.giant_cdpp * np.exp(study.giant_scatter * deviate)
    return np.where(giant, giants, study.dwarf_cdpp * np.exp(study.dwarf_scatter * deviate)), giant


def measure(study, task):
    """Return the noise of a star with its variability, and of the same star without it.

    CDPP with variability and with detector noise alone; the parts of photons, background and read
    noise; and what was drawn.
    """
    motion, still = Motion.still(study.cadences), quiet_star(study, task)
    level, giant = (v.item() for v in variability(study, still.mag, even(study, task)[1]))
    red = stochastic_signal(motion.time, level, seed=star_rng(study.seed, task["key"], "red"))
    star = still.replace(signal=still.signal * red(motion.time))
    seed = star_seed(study.seed, task["key"], "pixels")
    observation = simulate(star, Detector.kepler(), motion, seed=seed)
    quiet = simulate(observation.scene.replace(stars=[still]))
    aperture = observation.aperture
    row = {"kp": star.mag, "giant": giant, "variability": level, "n_pixels": int(aperture.sum())}
    for prefix, source in (("", observation), ("detector_", quiet)):
        flux = source.flux[:, aperture].sum(axis=1, dtype=float)
        row[f"{prefix}cdpp"] = cdpp(flux, method="everest")
    return row | noise_parts(quiet, aperture)


def noise_parts(observation, aperture):
    """Return the nominal 6.5-h noise of photons, background and reads in an aperture, ppm.

    It is the standard deviation per cadence over the root of 13.
    """
    detector = observation.detector
    exposure = detector.exposure_time
    electrons = float(np.median(observation.flux[:, aperture].sum(axis=1, dtype=float))) * exposure
    pixels = aperture.sum()
    sky, reads = detector.background * exposure, detector.cadence_read_noise**2
    variances = np.array([electrons, pixels * sky, pixels * reads])
    noise = 1e6 / electrons / WIDTH**0.5 * np.sqrt(variances)
    return dict(zip(PARTS, noise.tolist(), strict=True))


def summarize(_, table):
    """Return our percentiles per bin beside Kepler's, with errors by resampling of the stars.

    Percentiles of detector noise alone ("detector_") and with variability ("star_"), and ratios.
    """
    reference = read_reference("kepler")
    rows = []
    for cell, stars in cells(table, ("mag",)):
        mag, row = cell["mag"], cell | {"stars": len(stars)}
        row |= compared("detector", stars["detector_cdpp"], reference, mag, ("p10", "median"))
        row |= compared("star", stars["cdpp"], reference, mag, PERCENTILES)
        rows.append(row | {name: float(np.median(stars[name])) for name in (*PARTS, "n_pixels")})
    return Table(rows=rows)


@styled
def draw(_, stars, summary):
    """Draw our noise over Kepler's, and the ratios."""
    size = 0, 6.4, 0, 3.4
    figure, (top, bottom) = make_panels(2, 1, size, sharex=True, height_ratios=(2.4, 1))
    plot_cdpp({}, noise_band("kepler", "Kepler"), legend=False, ax=top)
    for name, part, known, marker, color, percentile, label in (
        ("cdpp", "star", "median", "s", "#d95f02", "median", "with variability"),
        ("detector_cdpp", "detector", "p10", "o", "#2c5aa0", "10 %", "detector noise alone"),
    ):
        top.plot(np.array(stars["kp"]), np.array(stars[name]), ".", color=color, ms=3, alpha=0.6,
                 label=f"ours, {label}")  # fmt: skip
        error = summary[f"{part}_{known}_error"] / summary[f"kepler_{known}"]
        bottom.errorbar(
            np.array(summary["mag"]), np.array(summary[f"{part}_{known}_ratio"]), np.array(error),
            fmt=marker, color=color, ms=5, mec="k", mew=0.4, capsize=2, lw=1,
            label=f"{percentile}, {label}",
        )  # fmt: skip
    top.set(xlabel="", xlim=(min(stars["kp"]) - 0.2, max(stars["kp"]) + 0.2),
            ylim=(0.6 * min(stars["detector_cdpp"]), 3 * max(stars["cdpp"])))  # fmt: skip
    top.legend(fontsize="small", loc="upper left", ncols=2)
    bottom.axhspan(0.9, 1.1, color="0.88", lw=0, zorder=0)
    bottom.axhline(1, color="0.5", lw=0.8, zorder=0)
    bottom.set(xlabel="Magnitude (Kp)", ylabel="Ours / Kepler", ylim=(0.7, 1.3))
    bottom.legend(fontsize="small", loc="upper right")
    return figure


main = study_of("no-motion", NoMotion, tasks, measure, summarize, draw, UNITS)


def fit(n_stars=300, cadences=1000):
    """Print the fitted numbers: logarithms of percentiles are compared.

    The noise of a star is the root of the sum of the squares of its white and red noise, of which
    those of one ppm are drawn once.
    """
    study, units = NoMotion(stars=n_stars, cadences=100, floor=0.0), []
    stars = Table([
        task | measure(study, task) | {"place": even(study, task)[1]} for task in tasks(study)
    ])  # fmt: skip
    quiet = np.sqrt(WIDTH * sum(np.array(stars[name]) ** 2 for name in PARTS))
    for number in range(n_stars):
        rng, time = np.random.default_rng([number, 1]), np.arange(cadences) * 0.0204336
        white = 1 + 1e-5 * rng.standard_normal(cadences)
        red = stochastic_signal(time, 10.0, seed=rng)(time)
        units.append(cdpp(np.array([white, red]), method="everest") / 10)
    white, red = np.tile(np.transpose(units), len(study.magnitudes))
    table = read_reference("kepler")
    rows = [table[table["mag"] == mag][0] for mag in study.magnitudes]
    kepler = np.array([[row[name] for name in PERCENTILES] for row in rows])

    def differences(values, part):
        new = replace(study, **dict(zip(STARTS, values, strict=True)))
        level = part * variability(new, np.array(stars["kp"]), np.array(stars["place"]))[0]
        noise = np.hypot(white * np.hypot(quiet, new.floor * WIDTH**0.5), red * level)
        bins = [noise[stars["mag"] == mag] for mag in study.magnitudes]
        ours = [np.percentile(each, list(PERCENTILES.values())) for each in bins]
        return np.log(ours / kepler)

    def cost(values):
        if min(values) < 0:
            return np.inf
        detector, all_noise = differences(values, 0)[:, 0], differences(values, 1)
        return DETECTOR_WEIGHT * np.sum(detector**2) + np.sum(WEIGHTS * all_noise**2)

    options = {"maxiter": 4000, "maxfev": 4000}
    for start in zip(*STARTS.values(), strict=True):
        found = minimize(cost, start, method="Nelder-Mead", options=options)
        print(f"cost {found.fun:.4f}:", dict(zip(STARTS, found.x.round(3).tolist(), strict=True)))


if __name__ == "__main__":
    fit() if "--fit" in sys.argv else main()
