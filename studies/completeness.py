"""Completeness of transits put into a real target pixel file, by period and depth.

    python studies/completeness.py FILE.fits.gz --output docs/data/completeness.ecsv [--trials 4]

The star's light is that of a fit (`fit_tpf` on every tenth cadence gives its share). Each trial
injects a planet at a random phase into the pixels, corrects them with PLDCorrector, which gets
no mask, and searches with box least squares; it is recovered if the box has a signal-to-noise
ratio of 7.1 or more and lies on the transits. Cells that the output has are not computed again.
"""

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
from astropy.table import Table, vstack
from paper._search import search_light_curve

from scope_models import Detector, PLDCorrector, TransitModel, __version__, fit_tpf, inject
from scope_models.io import read_pixels, read_tpf

PERIODS = (1.5, 3.0, 6.0, 12.0, 24.0)  # days
DEPTHS = (500, 1000, 2000, 4000, 8000, 16000)  # ppm
DURATION, THRESHOLD = 0.2, 7.1


def recovered(tpf, share, period, depth, seed):
    """Return whether a planet is found, its signal-to-noise ratio, and the period that is found."""
    start = tpf.time.value[0] + np.random.default_rng(seed).uniform(0, period)
    exposure = Detector.from_tpf(read_pixels(tpf)).cadence_days
    planet = TransitModel.from_depth_duration(
        1e-6 * depth, DURATION, period, start, exposure_time=exposure
    )
    lc = PLDCorrector(inject(tpf, planet, share, seed=seed)).correct()
    times, _, found = search_light_curve(lc, 0.8 * DURATION, 1.2 * DURATION)
    matches = found.matches(period, start, DURATION, np.ptp(times))
    return bool(matches and found.snr >= THRESHOLD), found.snr, found.period


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=4)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    tpf = read_tpf(options.file)
    fit = fit_tpf(tpf[::10])
    total = np.nansum(read_pixels(tpf[::10]).flux, axis=(1, 2))
    share = float(np.clip(np.median(fit.flux) / np.median(total), 0, 1))
    print(f"share of the star in all pixels: {share:.3f}")
    table = Table.read(options.output) if options.output.exists() else None
    done = set() if table is None else {tuple(row) for row in table["period", "depth", "trial"]}
    for trial in range(options.trials):
        for depth in DEPTHS:
            for period in PERIODS:
                if (period, depth, trial) in done:
                    continue
                seed = 1000 * trial + len(PERIODS) * DEPTHS.index(depth) + PERIODS.index(period)
                found = recovered(tpf, share, period, depth, seed)
                row = Table(
                    rows=[(period, depth, trial, *found)],
                    names=("period", "depth", "trial", "recovered", "snr", "found_period"),
                )
                table = row if table is None else vstack([table, row])
                table.meta = {
                    "date": time.strftime("%Y-%m-%d"),
                    "version": __version__,
                    "command": f"python studies/completeness.py {Path(options.file).name}",
                    "share": share,
                }
                table.write(options.output, overwrite=True)


if __name__ == "__main__":
    main()
