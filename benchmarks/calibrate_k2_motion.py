"""Fit the response of K2's pixels to the noise of moving stars before de-trending.

    OMP_NUM_THREADS=1 python benchmarks/calibrate_k2_motion.py [--stars N] [--output FOLDER]

Stars all over the field of view of K2 campaign 3, and anywhere on a pixel, move as
`Motion.k2_roll` says. Their noise is that of photons, background and read noise, which study
``no-motion`` has tested, and of the motion, which depends on a_2 (response 1 + a_2 u^2 along each
axis), on the standard deviation of b, on the wings of the PSF, and on the aperture: the pixels in
which the star has more than a threshold. The percentiles 10, 25, 50, 75, 90 at Kp 12 to 14.5 are
compared with those of 5,900 unsaturated stars of campaign 3.

The cost is the sum of the squares of the logarithms of the ratios over their errors: that of the
reference by its number of stars, and 10 % for what the model lacks. Percentiles are computed on a
coarse grid of a_2 and b, and interpolated. Errors of the fit come from resampling our stars and the
reference. Writes k2_calibration.ecsv: for each wings, a_2 and standard deviation of b the lowest
cost over the apertures. Takes about 20 minutes on one core.
"""

import argparse
from pathlib import Path

import numpy as np
from astropy.table import Table
from scipy.interpolate import RectBivariateSpline

from scope_models import Detector
from scope_models.experiments._response import RollingStars, winged_psf
from scope_models.experiments.k2_motion import field_motion
from scope_models.experiments.populations import draw_star
from scope_models.experiments.reference import PERCENTILES, read_reference

MAGNITUDES = (12.0, 12.5, 13.0, 13.5, 14.0, 14.5)
WINGS = (0.1, 0.15, 0.2, 0.3)
A_2 = np.array([-2.0, -1.6, -1.2, -0.8, -0.4, 0.0])
SCATTER = np.array([0, 0.004, 0.008, 0.012, 0.016, 0.02, 0.024])
THRESHOLDS = (60.0, 80.0, 100.0, 125.0)
FINE_A_2, FINE_SCATTER = np.linspace(-2, 0, 41), np.linspace(0, 0.024, 49)
WEIGHTS = np.array([0.5, 1.0, 2.0, 1.0, 0.5])
# Errors of percentiles of a normal distribution, in standard deviations times the root of n.
SPREAD = np.array([1.71, 1.36, 1.25, 1.36, 1.71])
LOG_SCATTER = 0.85  # of the noise of real stars of one magnitude
MODEL_ERROR = 0.1
RESAMPLES = 60
CHUNK = 50  # stars in memory


def reference():
    """Return the logarithms of campaign 3's percentiles, and their errors."""
    table = read_reference("k2_c03_raw")
    rows = [table[table["mag"] == mag][0] for mag in MAGNITUDES]
    values = np.array([[row[name] for name in PERCENTILES] for row in rows])
    counts = np.array([row["n"] for row in rows])
    return np.log(values), LOG_SCATTER * SPREAD / np.sqrt(counts[:, np.newaxis])


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


def noise_of_grid(wings, options):
    """Return the noise of all stars: (thresholds, a_2, scatter, magnitudes, stars)."""
    detector = Detector.k2(shape=(13, 13), psf=winged_psf(wings))
    apertures = [lambda image, t=t: image > t for t in THRESHOLDS]
    shape = (len(THRESHOLDS), len(A_2), len(SCATTER), len(MAGNITUDES), options.stars)
    grid = np.empty(shape, dtype=np.float32)
    for first in range(0, options.stars, CHUNK):
        numbers = range(first, min(first + CHUNK, options.stars))
        stars = RollingStars(detector, field_stars(detector, numbers, options), MAGNITUDES,
                             apertures)  # fmt: skip
        for row, i, j in np.ndindex(shape[:3]):
            grid[row, i, j, :, numbers.start : numbers.stop] = stars.noise(A_2[i], SCATTER[j], row)
    return grid


def percentiles(grid):
    """Return logarithms of percentiles on the fine grid: (thresholds, a_2, scatter, ...)."""
    coarse = np.moveaxis(np.log(np.percentile(grid, list(PERCENTILES.values()), axis=-1)), 0, -1)
    fine = np.empty((len(coarse), len(FINE_A_2), len(FINE_SCATTER), *coarse.shape[3:]))
    for place in np.ndindex(len(coarse), *coarse.shape[3:]):
        row, mag, name = place
        spline = RectBivariateSpline(A_2, SCATTER, coarse[row, :, :, mag, name], s=0.002)
        fine[row, :, :, mag, name] = spline(FINE_A_2, FINE_SCATTER)
    return fine


def costs(ours, known, error):
    """Return the cost of each point of the grid, and the largest deviation of a median."""
    ratio = ours - known
    cost = np.sum(WEIGHTS * ratio**2 / (error**2 + MODEL_ERROR**2), axis=(-2, -1))
    return cost, np.abs(np.expm1(ratio[..., 2])).max(axis=-1)


def resampled(grid, known, error, rng):
    """Return cost, a_2, scatter and threshold of the best fit to resampled stars and reference."""
    picks = rng.integers(grid.shape[-1], size=grid.shape[-1])
    shaken = known + error * rng.standard_normal(known.shape)
    cost, _ = costs(percentiles(grid[..., picks]), shaken, error)
    row, i, j = np.unravel_index(np.argmin(cost), cost.shape)
    return cost.min(), FINE_A_2[i], FINE_SCATTER[j], THRESHOLDS[row]


def report(wings, grid, known, error, rng):
    """Print the best fit, and return the rows of the table."""
    ours = percentiles(grid)
    cost, worst = costs(ours, known, error)
    row, i, j = np.unravel_index(np.argmin(cost), cost.shape)
    print(f"wings {wings}: cost {cost.min():.1f}, a_2 {FINE_A_2[i]:.2f}, scatter "
          f"{FINE_SCATTER[j]:.4f}, threshold {THRESHOLDS[row]:.0f} e-/s, medians within "
          f"{100 * worst[row, i, j]:.0f} %")  # fmt: skip
    fits = np.array([resampled(grid, known, error, rng) for _ in range(RESAMPLES)])
    low, middle, high = np.percentile(fits, [16, 50, 84], axis=0)
    for name, *values in zip(("cost", "a_2", "scatter", "threshold"), middle, low, high,
                             strict=True):  # fmt: skip
        print("    resampled {}: {:.4g} ({:.4g} to {:.4g})".format(name, *values))
    print(f"    percentiles {', '.join(PERCENTILES)} over the reference, Kp {MAGNITUDES}")
    print(np.exp(ours[row, i, j] - known).round(2), flush=True)
    rows = []
    for i, j in np.ndindex(cost.shape[1:]):
        row = int(np.argmin(cost[:, i, j]))
        rows.append((wings, FINE_A_2[i], FINE_SCATTER[j], THRESHOLDS[row], cost[row, i, j],
                     worst[row, i, j]))  # fmt: skip
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", type=int, default=800)
    parser.add_argument("--cadences", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wings", type=float, nargs="+", default=WINGS)
    parser.add_argument("--output", type=Path, default=Path())
    options = parser.parse_args()
    known, error = reference()
    rng = np.random.default_rng(options.seed)
    rows = []
    for wings in options.wings:
        rows += report(wings, noise_of_grid(wings, options), known, error, rng)
        names = ("wings", "a_2", "scatter", "threshold", "cost", "worst_median")
        table = Table(rows=rows, names=names)
        for name, digits in zip(names, (".2f", ".2f", ".4f", ".0f", ".1f", ".3f"), strict=True):
            table[name] = [float(format(value, digits)) for value in table[name]]
        table.meta = {"made by": "benchmarks/calibrate_k2_motion.py", "stars": options.stars,
                      "cadences": options.cadences, "seed": options.seed}  # fmt: skip
        table.write(options.output / "k2_calibration.ecsv", format="ascii.ecsv", overwrite=True)


if __name__ == "__main__":
    main()
