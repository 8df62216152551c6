"""Fit the response of K2's pixels to the noise of moving stars before de-trending.

    OMP_NUM_THREADS=1 python studies/paper/calibrate_k2_motion.py [--stars N] [--output FOLDER]

Stars all over the field of view of K2 campaign 3, and anywhere on a pixel, move as
`Motion.k2_roll`. The noise of the motion depends on a_2 (response 1 + a_2 u^2 along each axis), the
standard deviation of b, the wings of the PSF, and the aperture. Stars at Kp 10 and 10.5, all
saturated, have large apertures, which lose nothing: they measure the response. The apertures of
unsaturated stars at Kp 12 to 14.5 are the pixels in which the star has more than T e-/s and the
part p of its flux together. Five percentiles of both groups are fitted together.

The cost is the sum of the squared logarithms of the ratios over their errors: that of the reference
by its number of stars, and 10 % for what the model lacks. The contours are the fit's errors.
Writes k2_calibration.ecsv: for each wings, a_2 and standard deviation of b the lowest cost over T
and p. Takes about 10 minutes on one core.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np
from _reference import PERCENTILES, read_reference
from _response import RollingStars, winged_psf
from _stars import draw_star
from astropy.table import Table
from k2_motion import field_motion
from scipy.interpolate import RectBivariateSpline

from scope_models import Detector

# Magnitude and kind of the stars, and whether their aperture holds all light.
BINS = (
    (10.0, "saturated"), (10.5, "saturated"), (12.0, "unsaturated"), (12.5, "unsaturated"),
    (13.0, "unsaturated"), (13.5, "unsaturated"), (14.0, "unsaturated"), (14.5, "unsaturated"),
)  # fmt: skip
WINGS = (0.1, 0.2, 0.15)
A_2 = np.array([-2.0, -1.6, -1.2, -0.8, -0.4, 0.0])
SCATTER = np.array([0, 0.004, 0.008, 0.012, 0.016, 0.02])
FINE_A_2, FINE_SCATTER = np.linspace(-2, 0, 41), np.linspace(0, 0.02, 41)
# Parts of a star's flux that a pixel of the aperture must have.
PARTS = np.geomspace(1e-4, 4e-2, 12)
# T in e-/s and p of the apertures.
LAWS = tuple(product((25.0, 32.0, 40.0, 50.0, 63.0, 80.0), (0.0, 5e-4, 7e-4, 1e-3, 1.4e-3, 2e-3)))
WEIGHTS = np.array([0.5, 1.0, 2.0, 1.0, 0.5])
# Errors of percentiles of a normal distribution, in standard deviations times the root of n.
SPREAD = np.array([1.71, 1.36, 1.25, 1.36, 1.71])
# Columns of the table, and their decimals.
COLUMNS = {"wings": 2, "a_2": 2, "scatter": 4, "threshold": 0, "part": 4, "cost": 1,
           "worst_median": 3}  # fmt: skip
LOG_SCATTER = 0.85  # of the noise of real stars of one magnitude
MODEL_ERROR = 0.1
CHUNK = 30  # stars in memory


def field_stars(detector, numbers, options):
    """Return stars all over the field of view, as `RollingStars` takes them."""
    stars = []
    for number in numbers:
        rng = np.random.default_rng([options.seed, number])
        place = (number + 0.5) / options.stars
        seed = int(rng.integers(2**31))
        motion = field_motion(seed, options.cadences, place=place, rng=rng)
        stars.append((draw_star(rng, 12.0, detector, shift=0.5), motion, rng))
    return stars


def noise_by_part(wings, options):
    """Return the logarithm of the noise by motion, and that of white noise.

    Their shapes are (a_2, scatter, parts, stars) and (bins, parts, stars).
    """
    detector = Detector.k2(shape=(13, 13), psf=winged_psf(wings))
    systematics = np.empty((len(A_2), len(SCATTER), len(PARTS), options.stars))
    white = np.empty((len(BINS), len(PARTS), options.stars))
    for first in range(0, options.stars, CHUNK):
        numbers = range(first, min(first + CHUNK, options.stars))
        stars = RollingStars(detector, field_stars(detector, numbers, options), PARTS)
        part = slice(numbers.start, numbers.stop)
        for i, j in np.ndindex(systematics.shape[:2]):
            systematics[i, j, :, part] = stars.systematics(A_2[i], SCATTER[j])
        for number, (mag, _) in enumerate(BINS):
            white[number, :, part] = stars.white(detector, mag)
    return np.log(systematics), np.log(white)


def at_part(values, law, mag):
    """Return values (parts, ...) in the aperture of a law for a magnitude; the first for None."""
    if law is None:
        return values[0]
    threshold, part = law
    part = part + threshold / Detector.k2().flux_from_mag(mag)
    place = np.interp(np.log(part), np.log(PARTS), np.arange(len(PARTS)))
    low = min(int(place), len(PARTS) - 2)
    return (low + 1 - place) * values[low] + (place - low) * values[low + 1]


def percentiles(systematics, white):
    """Return logarithms of percentiles: (laws, a_2, scatter, bins, percentiles), finely."""
    shape = (len(LAWS), len(FINE_A_2), len(FINE_SCATTER), len(BINS), len(PERCENTILES))
    fine = np.empty(shape, dtype=np.float32)
    wanted = list(PERCENTILES.values())
    parts = np.moveaxis(systematics, 2, 0)
    for row, law in enumerate(LAWS):
        laws = [None if kind == "saturated" else law for _, kind in BINS]
        noise = np.array([
            np.hypot(*(np.exp(at_part(v, law, mag)) for v in (parts, own)))
            for own, law, (mag, _) in zip(white, laws, BINS, strict=True)
        ])  # fmt: skip
        coarse = np.log(np.percentile(noise, wanted, axis=-1))  # (percentiles, bins, a_2, scatter)
        for name, number in np.ndindex(coarse.shape[:2]):
            spline = RectBivariateSpline(A_2, SCATTER, coarse[name, number], s=0.002)
            fine[row, :, :, number, name] = spline(FINE_A_2, FINE_SCATTER)
    return fine


def costs(ours, known, error):
    """Return the cost of each point, and the largest deviation of a median."""
    ratio = ours - known
    cost = np.sum(WEIGHTS * ratio**2 / (error**2 + MODEL_ERROR**2), axis=(-2, -1))
    return cost, np.abs(np.expm1(ratio[..., 2])).max(axis=-1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", type=int, default=1000)
    parser.add_argument("--cadences", type=int, default=3300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wings", type=float, nargs="+", default=WINGS)
    parser.add_argument("--output", type=Path, default=Path())
    options = parser.parse_args()
    rows = [one[one["mag"] == mag][0] for mag, kind in BINS
            for one in [read_reference("k2_c03_raw", kind)]]  # fmt: skip
    known = np.log([[row[name] for name in PERCENTILES] for row in rows])
    error = LOG_SCATTER * SPREAD / np.sqrt([[row["n"]] for row in rows])
    table = Table(names=list(COLUMNS))
    table.meta = {"made by": "studies/paper/calibrate_k2_motion.py", "stars": options.stars,
                  "cadences": options.cadences, "seed": options.seed}  # fmt: skip
    for wings in options.wings:
        noise = noise_by_part(wings, options)
        cost, worst = costs(percentiles(*noise), known, error)
        for i, j in np.ndindex(cost.shape[1:]):
            row = int(np.argmin(cost[:, i, j]))
            found = *LAWS[row], cost[row, i, j], worst[row, i, j]
            values = wings, FINE_A_2[i], FINE_SCATTER[j], *found
            table.add_row([round(v, n) for v, n in zip(values, COLUMNS.values(), strict=True)])
        print(table[table["wings"] == wings][np.argmin(cost.min(axis=0))])
        table.write(options.output / "k2_calibration.ecsv", format="ascii.ecsv", overwrite=True)


if __name__ == "__main__":
    main()
