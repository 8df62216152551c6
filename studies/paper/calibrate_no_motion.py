"""Fit what the instrument numbers leave of Kepler's noise: a floor, and the stars' variability.

    OMP_NUM_THREADS=1 python studies/paper/calibrate_no_motion.py [--stars N]

The noise of each star of the study ``no-motion`` is the root of the sum of the squares of white and
red noise. The fit compares logarithms: of the 10th percentiles with detector noise alone, and of
all percentiles with variability. Prints the values that the study has as defaults.
"""

import argparse
from dataclasses import replace

import numpy as np
from _reference import PERCENTILES, read_reference
from astropy.table import Table
from no_motion import NoMotion, even, measure, tasks, variability
from scipy.optimize import minimize

from scope_models.models import stochastic_signal
from scope_models.photometry import cdpp

# Of the 10th percentile with detector noise alone, and of the percentiles with variability.
DETECTOR_WEIGHT, WEIGHTS = 2.0, np.array([1.0, 1.0, 2.0, 1.0, 0.5])
# Two values to start from of each parameter.
STARTS = {
    "floor": (8, 5), "dwarf_cdpp": (25, 30), "dwarf_scatter": (0.7, 0.5), "giant_cdpp": (170, 150),
    "giant_scatter": (0.35, 0.4), "giant_fraction": (0.41, 0.41), "giant_decline": (0.39, 0.39),
}  # fmt: skip


def responses(n, cadences=1000):
    """Return the CDPP of unit white noise and of unit red noise, for n draws each."""
    time, found = np.arange(cadences) * 0.0204336, []
    for i in range(n):
        rng = np.random.default_rng([i, 1])
        white = 1 + 1e-5 * rng.standard_normal(cadences)
        red = stochastic_signal(time, 10.0, seed=rng)(time)
        found.append(cdpp(np.array([white, red]), method="everest") / 10)
    return np.transpose(found)


def percentiles(study, stars, level):
    """Return the percentiles of the noise of stars in each bin, given that of variability."""
    white = np.hypot(stars["white"], study.floor * 13**0.5)
    noise = np.hypot(stars["white_response"] * white, stars["red_response"] * level)
    bins = [noise[stars["mag"] == mag] for mag in study.magnitudes]
    return np.array([np.percentile(each, list(PERCENTILES.values())) for each in bins])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", type=int, default=300, help="stars per bin")
    options = parser.parse_args()
    study = NoMotion(stars=options.stars, cadences=100, floor=0.0)
    stars = Table([
        task | measure(study, task) | {"place": even(study, task)[1]} for task in tasks(study)
    ])  # fmt: skip
    parts = [stars[name] for name in ("photon", "background", "read")]
    stars["white"] = np.sqrt(13 * np.sum(np.square(parts), axis=0))
    for name, each in zip(("white", "red"), responses(options.stars), strict=True):
        stars[f"{name}_response"] = np.tile(each, len(study.magnitudes))
    stars = {name: np.array(stars[name]) for name in stars.colnames}
    table = read_reference("kepler")
    kepler = np.array([list(table[table["mag"] == m][0][list(PERCENTILES)]) for m in
                       study.magnitudes])  # fmt: skip

    def ratios(values):
        new = replace(study, **dict(zip(STARTS, values, strict=True)))
        level = variability(new, stars["kp"], stars["place"])[0]
        return [percentiles(new, stars, part * level) / kepler for part in (0, 1)]

    def cost(values):
        if min(values) < 0:
            return np.inf
        detector, all_noise = np.log(ratios(values))
        return DETECTOR_WEIGHT * np.sum(detector[:, 0] ** 2) + np.sum(WEIGHTS * all_noise**2)

    options = {"maxiter": 4000, "maxfev": 4000}
    starts = zip(*STARTS.values(), strict=True)
    fits = [minimize(cost, start, method="Nelder-Mead", options=options) for start in starts]
    fit = min(fits, key=lambda fit: fit.fun)
    values = ", ".join(f"{name} {value:.3g}" for name, value in zip(STARTS, fit.x, strict=True))
    print(f"cost {fit.fun:.4f}: {values}")


if __name__ == "__main__":
    main()
