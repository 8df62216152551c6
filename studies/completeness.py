"""Completeness of transits put into a real target pixel file, by period and depth.

    python studies/completeness.py --file FILE.fits.gz --directory completeness [--workers 2]

The star's light is that of a fit (`fit_tpf` on every tenth cadence gives its share). Each trial
injects a planet at a random phase into the pixels, corrects them with PLDCorrector, which gets
no mask, and searches with box least squares; it is recovered if the box has a signal-to-noise
ratio of 7.1 or more and lies on the transits. The page shows its results.ecsv with a stamp.
"""

from functools import cache

import numpy as np
from paper._search import search_light_curve
from paper._study import grid, parameters, study_of

from scope_models import Detector, PLDCorrector, TransitModel, fit_tpf, inject
from scope_models.batch import star_rng
from scope_models.io import read_pixels, read_tpf

DURATION, THRESHOLD = 0.2, 7.1


@parameters
class Completeness:
    file: str = ""
    seed: int = 1
    periods: tuple[float, ...] = (1.5, 3.0, 6.0, 12.0, 24.0)  # days
    depths: tuple[float, ...] = (500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16000.0)  # ppm
    trials: int = 2


tasks = grid("p{period:g}-d{depth:g}-{trial}", trial="trials", depth="depths", period="periods")


@cache
def star(file):
    """Return the target pixel file, and the share of the star in all pixels."""
    tpf = read_tpf(file)
    total = np.nansum(read_pixels(tpf[::10]).flux, axis=(1, 2))
    return tpf, float(np.clip(np.median(fit_tpf(tpf[::10]).flux) / np.median(total), 0, 1))


def measure(study, task):
    """Return whether a planet is found, its signal-to-noise ratio, and the period that is found."""
    (tpf, share), rng = star(study.file), star_rng(study.seed, task["key"])
    start = tpf.time.value[0] + rng.uniform(0, task["period"])
    planet = TransitModel.from_depth_duration(
        1e-6 * task["depth"], DURATION, task["period"], start,
        exposure_time=Detector.from_tpf(read_pixels(tpf)).cadence_days,
    )  # fmt: skip
    lc = PLDCorrector(inject(tpf, planet, share, seed=int(rng.integers(2**31)))).correct()
    time, _, found = search_light_curve(lc, 0.8 * DURATION, 1.2 * DURATION)
    matches = found.matches(task["period"], start, DURATION, np.ptp(time))
    return {
        "recovered": bool(matches and found.snr >= THRESHOLD),
        "snr": found.snr, "found_period": found.period, "share": share,
    }  # fmt: skip


main = study_of("completeness", Completeness, tasks, measure)

if __name__ == "__main__":
    main()
