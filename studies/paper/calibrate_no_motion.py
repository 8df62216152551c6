"""Fit what the instrument numbers leave of Kepler's noise: a floor, and the stars' variability.

    OMP_NUM_THREADS=1 python studies/paper/calibrate_no_motion.py [--stars N]

The noise of each star of the study ``no-motion`` is a function of two numbers, white and red noise,
which is tabulated once. The fit compares logarithms: of the 10th percentiles with detector noise
alone, and of all percentiles with variability. Prints the values that
the study has as defaults, and the ratios to Kepler's table.
"""

import argparse

import numpy as np
from _reference import PERCENTILES, read_reference
from no_motion import NoMotion, quiet_star, tasks
from scipy.optimize import minimize
from scipy.special import ndtri

from scope_models import Detector, Motion, simulate
from scope_models.batch import star_seed
from scope_models.models import stochastic_signal
from scope_models.photometry import cdpp

CADENCES = 1000
# Ratio of red noise (CDPP in lightkurve's convention) to white noise (per cadence).
RATIOS = np.concatenate([[0], np.geomspace(0.02, 20, 25)])
# Of the 10th, 25th, 50th, 75th and 90th percentile with variability.
WEIGHTS = np.array([1.0, 1.0, 2.0, 1.0, 0.5])
# Of the 10th percentile with detector noise alone.
DETECTOR_WEIGHT = 2.0
FITTED = (
    "floor", "dwarf_cdpp", "dwarf_scatter", "giant_cdpp", "giant_scatter", "giant_fraction",
    "giant_decline",
)  # fmt: skip


def white_noise(study):
    """Return magnitude and relative white noise per cadence (ppm) of each star, without floor."""
    rows = []
    for task in tasks(study):
        motion, seed = Motion.still(study.cadences), star_seed(study.seed, task["key"], "pixels")
        observation = simulate(quiet_star(study, task), Detector.kepler(), motion, seed=seed)
        aperture = observation.aperture
        error = np.sqrt((observation.flux_err[0, aperture].astype(float) ** 2).sum())
        flux = observation.flux[0, aperture].sum(dtype=float)
        rows.append((task["mag"], observation.stars[0].mag, 1e6 * error / flux))
    return np.array(rows).T


def responses(n):
    """Return the CDPP of unit white noise with red noise of each ratio, for n draws."""
    time = np.arange(CADENCES) * 0.0204336
    table = np.empty((n, len(RATIOS)))
    for i in range(n):
        rng = np.random.default_rng([i, 1])
        white = rng.standard_normal(CADENCES)
        red = 1e6 * (stochastic_signal(time, 1.0, seed=rng)(time) - 1)
        for j, ratio in enumerate(RATIOS):
            table[i, j] = cdpp(1 + 1e-5 * (white + ratio * red), method="everest") / 10
    return table


class Population:
    """The stars of all bins, and their noise for given parameters."""

    def __init__(self, study):
        self.bins, self.mag, self.white = white_noise(study)
        draws = responses(study.stars)
        self.response = np.tile(draws, (len(study.magnitudes), 1))
        # The same evenly spaced probabilities in each bin, in random order.
        rng = np.random.default_rng(2)
        even = (np.arange(study.stars) + 0.5) / study.stars
        shuffled = np.array([[rng.permutation(even), rng.permutation(even)] for _ in
                             study.magnitudes])  # fmt: skip
        self.uniform, self.normal = shuffled[:, 0].ravel(), ndtri(shuffled[:, 1]).ravel()
        self.magnitudes = study.magnitudes

    def noise(self, floor, variability=0.0):
        """Return the CDPP of each star (everest); variability in lightkurve's convention."""
        white = np.hypot(self.white, floor * 13**0.5)
        ratio = np.broadcast_to(variability / white, white.shape)
        place = np.interp(ratio, RATIOS, np.arange(len(RATIOS)))
        low = np.minimum(place.astype(int), len(RATIOS) - 2)
        rows, part = np.arange(len(white)), place - low
        response = self.response[rows, low] * (1 - part) + self.response[rows, low + 1] * part
        # Beyond the table the white noise does not matter.
        return white * response * np.maximum(ratio / RATIOS[-1], 1)

    def variability(self, dwarf, dwarf_scatter, giant, giant_scatter, fraction, decline):
        """Return the CDPP of each star's variability."""
        giants = self.uniform < fraction * np.exp(-decline * (self.mag - 11.5))
        return np.where(
            giants,
            giant * np.exp(giant_scatter * self.normal),
            dwarf * np.exp(dwarf_scatter * self.normal),
        )

    def percentiles(self, noise):
        """Return the percentiles in each bin."""
        wanted = list(PERCENTILES.values())
        return np.array([np.percentile(noise[self.bins == b], wanted) for b in self.magnitudes])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", type=int, default=300, help="stars per bin")
    options = parser.parse_args()
    study = NoMotion(stars=options.stars, cadences=100, floor=0.0)
    population = Population(study)
    table = read_reference("kepler")
    kepler = np.array([list(table[table["mag"] == m][0][list(PERCENTILES)]) for m in
                       study.magnitudes])  # fmt: skip

    def logarithms(parameters):
        floor, *others = parameters
        detector = population.percentiles(population.noise(floor))[:, 0] / kepler[:, 0]
        noise = population.noise(floor, population.variability(*others))
        return np.log(detector), np.log(population.percentiles(noise) / kepler)

    def cost(parameters):
        if min(parameters) < 0:
            return np.inf
        detector, stars = logarithms(parameters)
        return DETECTOR_WEIGHT * np.sum(detector**2) + np.sum(WEIGHTS * stars**2)

    starts = ([8, 25, 0.7, 170, 0.35, 0.41, 0.39], [5, 30, 0.5, 150, 0.4, 0.41, 0.39])
    fits = [minimize(cost, start, method="Nelder-Mead", options={"maxiter": 4000, "maxfev": 4000})
            for start in starts]  # fmt: skip
    for fit in fits:
        values = ", ".join(f"{n} {v:.3g}" for n, v in zip(FITTED, fit.x, strict=True))
        print(f"cost {fit.fun:.4f}: {values}")
    best = min(fits, key=lambda fit: fit.fun).x
    print(f"ratios to Kepler's at Kp {study.magnitudes}")
    for floor in (0.0, best[0]):
        ratios = np.exp(logarithms([floor, *best[1:]])[0])
        print(f"10th percentile, detector noise alone, floor {floor:.1f} ppm: {ratios.round(3)}")
    print(f"{', '.join(PERCENTILES)} with variability\n{np.exp(logarithms(best)[1]).round(3)}")


if __name__ == "__main__":
    main()
