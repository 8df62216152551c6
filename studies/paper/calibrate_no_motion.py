"""Fit what the instrument numbers leave of Kepler's noise: a floor, and the stars' variability.

    OMP_NUM_THREADS=1 python studies/paper/calibrate_no_motion.py [--stars N]

The noise of each star of the study ``no-motion`` is a function of two numbers, white and red noise,
which is tabulated once. The fit compares logarithms: of the 10th percentiles with detector noise
alone, and of all percentiles with variability. Prints the values that
the study has as defaults, and the ratios to Kepler's table.
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

CADENCES = 1000
# Ratio of red noise (CDPP in lightkurve's convention) to white noise (per cadence).
RATIOS = np.concatenate([[0], np.geomspace(0.02, 20, 25)])
# Of the 10th percentile with detector noise alone, and of the percentiles with variability.
DETECTOR_WEIGHT, WEIGHTS = 2.0, np.array([1.0, 1.0, 2.0, 1.0, 0.5])
# Two values to start from of each parameter.
STARTS = {
    "floor": (8, 5), "dwarf_cdpp": (25, 30), "dwarf_scatter": (0.7, 0.5), "giant_cdpp": (170, 150),
    "giant_scatter": (0.35, 0.4), "giant_fraction": (0.41, 0.41), "giant_decline": (0.39, 0.39),
}  # fmt: skip


def responses(n):
    """Return the CDPP of unit white noise with red noise of each ratio, for n draws."""
    time = np.arange(CADENCES) * 0.0204336
    table = np.empty((n, len(RATIOS)))
    for i in range(n):
        rng = np.random.default_rng([i, 1])
        white = rng.standard_normal(CADENCES)
        red = 1e6 * (stochastic_signal(time, 1.0, seed=rng)(time) - 1)
        curves = 1 + 1e-5 * (white + RATIOS[:, np.newaxis] * red)
        table[i] = cdpp(curves, method="everest") / 10
    return table


def percentiles(study, stars, level):
    """Return the percentiles of the noise of stars in each bin, given that of variability."""
    white = np.hypot(stars["white"], study.floor * 13**0.5)
    ratio = level / white
    place = np.interp(ratio, RATIOS, np.arange(len(RATIOS)))
    low = np.minimum(place.astype(int), len(RATIOS) - 2)
    rows, part = np.arange(len(white)), place - low
    response = stars["response"]
    response = response[rows, low] * (1 - part) + response[rows, low + 1] * part
    # Beyond the table the white noise does not matter.
    noise = white * response * np.maximum(ratio / RATIOS[-1], 1)
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
    stars["response"] = np.tile(responses(options.stars), (len(study.magnitudes), 1))
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
    print(f"cost {fit.fun:.4f}: {values}\nratios to Kepler's at Kp {study.magnitudes}")
    for floor in (0.0, fit.x[0]):
        found = ratios([floor, *fit.x[1:]])[0][:, 0].round(3)
        print(f"10th percentile, detector noise alone, floor {floor:.1f} ppm: {found}")
    print(f"{', '.join(PERCENTILES)} with variability\n{ratios(fit.x)[1].round(3)}")


if __name__ == "__main__":
    main()
