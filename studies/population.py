"""A population of K2 stars, simulated, beside 71,800 real ones of campaigns 3 to 6.

    python studies/population.py DATA stars.csv [--stars 6000] [--corrected 600]
    python studies/population.py DATA stars.csv --table docs/data/population

DATA is the folder of shared data. A run goes on where it stopped; ``--workers 2`` shares it.
"--table" writes the tables of docs/evaluation_population.rst, which states the distributions that
are drawn from, and which stars are held out; "--everest c01_nPLD.cdpp" takes the table of another
campaign from the EVEREST repository.
"""

from functools import cache, partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from _rows import arguments_of, store_rows, sweep_rows, write_csv
from astropy.stats import mad_std
from astropy.table import Table
from k2_motion import EDGE, K2MotionNoise, choose_aperture
from paper._stars import FARTHEST, draw_star, stamp_around

from scope_models import Detector, Motion, PLDCorrector, Star, simulate
from scope_models.missions import MISSIONS
from scope_models.models import sinusoidal_signal
from scope_models.photometry import cdpp

# Boresights in degrees: campaign pages of the Kepler & K2 Science Center.
BORESIGHTS = {3: (336.6653, -11.0967), 4: (59.0759, 18.6606), 5: (130.1576, 16.8296)}
MOTIONS = [f"poscorr/ktwo{name}_llc.fits" for name in (
    "206103150-c03", "211117077-c04", "211436265-c05", "211495446-c05"
)] + ["k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz"]  # fmt: skip
MAGNITUDES = range(11, 18)
EVERY = 10  # of so many cadences one is enough for the image that chooses the aperture
PARTS = (10, 50, 90)
PIPELINES = ("everest2", "everest2_validation", "everest1", "k2sff", "k2sc")
COLUMNS = ("number", "kp", "distance", "neighbors", "spots", "raw", "raw_file", "corrected",
           "held_out")  # fmt: skip
rows_of = itemgetter(list(COLUMNS))


@cache
def catalog(data):
    """Return the real stars with their noise."""
    path = Path(data) / "k2_pipelines" / "k2_c03-c06_cdpp.csv.gz"
    return Table.read(path, format="ascii.csv", comment="#")


@cache
def real_stars(data):
    """Return the unsaturated stars with a raw light curve."""
    table = catalog(data)
    return table[(table["saturated"] == 0) & (table["raw"] > 0)]


@cache
def real_motion(path):
    """Return a real motion about its median, and the star's distance from the boresight."""
    motion = Motion.from_file(path)
    ra_0, dec_0 = BORESIGHTS[motion.meta["campaign"]]
    east = (motion.meta["ra"] - ra_0) * np.cos(np.radians(dec_0))
    distance = np.hypot(east, motion.meta["dec"] - dec_0)
    good = (motion.quality & MISSIONS["K2"].quality.rejected) == 0
    x, y = (values - np.median(values[good]) for values in (motion.x, motion.y))
    near = np.hypot(x, y) < FARTHEST
    return motion.time, np.where(near, x, 0), np.where(near, y, 0), motion.quality, good, distance


def moved(rng, data):
    """Return a motion somewhere in the field, its good cadences, and the distance."""
    time, x, y, quality, good, known = real_motion(Path(data) / MOTIONS[rng.integers(5)])
    distance, angle = EDGE * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
    turned = distance / known * np.exp(1j * angle) * (x + 1j * y)
    motion = Motion.from_arrays(time, turned.real, turned.imag, quality=quality)
    return motion, motion[good], distance


def spotted(rng):
    """Return the light curve of a star with spots, and whether it has any."""
    has, amplitude = rng.uniform() < 1 / 3, min(0.003 * 10 ** rng.normal(0, 0.3), 0.2)
    period, phases, ratio = 15 * 10 ** rng.normal(0, 0.3), rng.uniform(size=2), rng.uniform()
    first = sinusoidal_signal(amplitude, period, phases[0])
    second = sinusoidal_signal(ratio * amplitude, period / 2, phases[1])
    return (lambda time: first(time) * second(time)) if has else None, has


def neighbors(rng, shape):
    """Return the field stars on a stamp."""
    area = shape[0] * shape[1] * (3.98 / 3600) ** 2
    n = rng.poisson(4000 * area)
    mags = 20 + np.log10(rng.uniform(size=n)) / 0.22
    places = rng.uniform(-0.5, np.array(shape[::-1]) - 0.5, (n, 2))
    return [Star(max(mag, 9.0), *place) for mag, place in zip(mags, places, strict=True)]


def observe(task, *, data, every):
    """Return the row of a star; one in so many is corrected, none for 0."""
    number = task["number"]
    rng = np.random.default_rng([26, number])
    real, low = real_stars(data), MAGNITUDES[number % len(MAGNITUDES)]
    inside = real["kp"][np.floor(real["kp"]) == low]
    mag = float(inside[rng.integers(len(inside))])
    motion, good, distance = moved(rng, data)
    shape, x_0, y_0 = stamp_around(good, 5)
    detector = Detector.k2_calibrated(shape=shape, background=284 * np.exp(rng.normal(0, 0.2)))
    signal, spots = spotted(rng)
    target = draw_star(rng, mag, detector, x_0=x_0, y_0=y_0, shift=0.5, signal=signal)
    others = neighbors(rng, shape)
    observation = simulate([target, *others], detector, motion, seed=number, effects="mission")
    alike = simulate(target, detector.without_sensitivity(), motion[::EVERY], noise=False)
    aperture = choose_aperture(K2MotionNoise(), observation, alike.flux.mean(axis=0))
    pixels = observation.flux[(observation.quality & MISSIONS["K2"].quality.rejected) == 0]
    curves = (pixels[:, mask].sum(axis=1, dtype=float) for mask in (aperture, observation.aperture))
    raw, raw_file = (cdpp(flux, method="everest") for flux in curves)
    corrected = held_out = np.nan
    if every and number // len(MAGNITUDES) % every == 0:
        corrector = PLDCorrector(observation.to_tpf())
        corrected = cdpp(corrector.correct(), method="everest")
        held_out = 1e6 * mad_std(corrector.result.held_out()[0])
    row = (mag, round(distance, 3), len(others), int(spots),
           *(round(float(v), 2) for v in (raw, raw_file, corrected, held_out)))  # fmt: skip
    return dict(zip(COLUMNS[1:], row, strict=True))


def percentiles(values, rng):
    """Return the 10th, 50th and 90th percentile and their errors by resampling."""
    picks = np.asarray(values)[rng.integers(len(values), size=(400, len(values)))]
    return np.percentile(values, PARTS), np.percentile(picks, PARTS, axis=1).std(1)


def compared(ours, theirs, rng):
    """Return percentiles of real and simulated noise, and the ratios with their errors."""
    (here, error), (there, _) = (percentiles(values, rng) for values in (ours, theirs))
    ratio, spread = here / there, error / there
    agrees = (np.abs(ratio - 1) < 0.15) | (np.abs(ratio - 1) < 2 * spread)
    cells = [f"{r:.2f} ± {s:.2f}{'' if a else ' (!)'}"
             for r, s, a in zip(ratio, spread, agrees, strict=True)]  # fmt: skip
    return [*np.rint(there).astype(int), *np.rint(here).astype(int), *cells]


def write_tables(stars, real, target, everest=None):
    """Write percentiles of raw light curves, and medians of corrected ones."""
    rng, raw, corrected = np.random.default_rng(0), [], []
    for low in MAGNITUDES:
        ours, theirs = (table[np.floor(table["kp"]) == low] for table in (stars, real))
        held = theirs[theirs["campaign"] > 3]
        noisy, kept = held["raw"] > np.percentile(held["raw"], PARTS[2]), held["everest2"] > 0
        tail = [np.median(held["everest2"][kept & part]) for part in (noisy, ~noisy)]
        raw.append([f"{low}-{low + 1}", len(ours), *compared(ours["raw"], held["raw"], rng),
                    round(np.median(ours["raw_file"])), f"{tail[0] / tail[1]:.2f}"])  # fmt: skip
        done = ours[np.isfinite(ours["corrected"])]
        if len(done):
            found = [[part[1] for part in percentiles(done[name], rng)]
                     for name in ("corrected", "held_out")]  # fmt: skip
            known = [held[n][held[n] > 0] for n in PIPELINES]
            corrected.append([f"{low}-{low + 1}", len(done),
                              *(f"{median:.1f} ± {error:.1f}" for median, error in found),
                              *(f"{np.median(values):.1f}" for values in known)])  # fmt: skip
    names = ["Kp", "stars", "real 10 %", "50 %", "90 %", "simulated 10 %", "50 % ", "90 % ",
             "ratio at 10 %", "at 50 %", "at 90 %", "file's aperture", "EVEREST 2"]  # fmt: skip
    others = ["Kp", "stars", "simulated, PLDCorrector", "its held-out windows", "EVEREST 2",
              "its validation", "EVEREST 1", "K2SFF", "K2SC"]  # fmt: skip
    for suffix, head, rows in (("raw", names, raw), ("corrected", others, corrected)):
        write_csv(f"{target}_{suffix}.csv", [head, *rows])
    write_campaigns(stars, real, target)
    if everest:
        kp, noise, full = np.genfromtxt(everest, skip_header=2, usecols=(1, 2, 8)).T
        good, bins = (full == 0) & (noise > 0), (np.floor(kp), np.floor(stars["kp"]))
        rows = [[row[0], np.sum(good & (bins[0] == low)),
                 *compared(stars["raw"][bins[1] == low], noise[good & (bins[0] == low)], rng)]
                for low, row in zip(MAGNITUDES, raw, strict=True)]  # fmt: skip
        write_csv(f"{target}_everest.csv", [names[:11], *rows])


def write_campaigns(stars, real, target):
    """Write percentiles of the noise before and after K2SFF, by campaign."""
    campaigns, rows = np.unique(real["campaign"]), []
    for low in MAGNITUDES:
        ours, theirs = (table[np.floor(table["kp"]) == low] for table in (stars, real))
        parts = [theirs[theirs["campaign"] == number] for number in campaigns]
        noise = [part[name][part[name] > 0] for name in ("raw", "k2sff") for part in parts]
        found = np.array([np.percentile(one, PARTS) for one in (ours["raw"], *noise)]).T
        for part, values in zip(PARTS, found, strict=True):
            rows.append([f"{low}-{low + 1}", f"{part} %", *np.rint(values).astype(int)])
    names = [f"{name} {number}" for name in ("raw, campaign", "K2SFF,") for number in campaigns]
    write_csv(f"{target}_campaigns.csv", [["Kp", "percentile", "raw, simulated", *names], *rows])


def main(argv=None):
    options = arguments_of(__doc__, argv, 6000, corrected=600, everest="")
    if options.table:
        table = store_rows(options.file, f"{options.table}.ecsv", rows_of)
        return write_tables(table, real_stars(options.data), options.table, options.everest)
    every = max(1, options.stars // options.corrected) if options.corrected > 0 else 0
    return sweep_rows(
        options, partial(observe, data=options.data, every=every), options.stars, rows_of
    )


if __name__ == "__main__":
    main()
