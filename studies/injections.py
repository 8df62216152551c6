"""Transits put into pixels and measured after the correction, as EVEREST 2 did in campaign 6.

    python studies/injections.py DATA stars.csv [--stars 60] [--cadences 1700]
    python studies/injections.py DATA real.csv --real 20
    python studies/injections.py DATA stars.csv --with real.csv --table docs/data/injections

DATA is the folder of shared data. A run goes on where it stopped; ``--workers 2`` shares it. As in
``everest/inject.py``, all light of each pixel is multiplied by a transit of 0.1 d with a period of
3 to 10 d; the depth is found by least squares beside a cubic for each transit in windows of five
durations; the control has the transits in the light curve that was corrected without them.
Simulated stars have the magnitudes of stars of the table, and are those of ``population.py``
otherwise; "--real" puts as many planets into each of two real files.
"""

from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
from _rows import FILES, arguments_of, store_rows, sweep_rows, write_csv
from astropy.stats import mad_std
from astropy.table import Table
from paper._stars import draw_star, stamp_around
from population import catalog, moved, neighbors, percentiles, spotted

from scope_models import Detector, PLDCorrector, TransitModel, inject, simulate
from scope_models.io import read_tpf

DURATION, WINDOW, ORDER, DEPTHS = 0.1, 5, 3, (1e-2, 1e-3, 1e-4)
RUNS = ("control", "unmasked", "masked")
COLUMNS = ("epic", "kp", "depth", *RUNS)
EXPOSURE = 29.4 / 1440


@cache
def injected_stars(data):
    """Return what EVEREST found, and its stars with their magnitudes."""
    path, known = Path(data) / "k2_pipelines" / "everest_c06_injection.txt.gz", catalog(data)
    names = ("epic", "depth", "control", "unmasked", "masked_control", "masked")
    found = Table.read(path, format="ascii.no_header", names=names, data_start=2)
    return found, known[np.isin(known["epic"], found["epic"]) & (known["saturated"] == 0)]


def recovered(time, flux, transits):
    """Return the depth of transits by least squares beside a cubic for each.

    `transits` is a `TransitModel`; the depth is in units of the light outside.
    """
    good = np.isfinite(flux)
    time, flux = time[good], flux[good] / np.median(flux[good])
    shape = (transits(time) - 1) / transits.depth
    number = np.rint((time - transits.t0.value) / transits.period.value)
    since = time - transits.t0.value - number * transits.period.value
    near = np.abs(since) < WINDOW * DURATION / 2
    columns = [shape[near]]
    for one in np.unique(number[near & (shape < 0)]):
        columns += [np.where(number == one, since**n, 0.0)[near] for n in range(ORDER + 1)]
    used = np.isin(number[near], number[near & (shape < 0)])
    return np.linalg.lstsq(np.transpose(columns)[used], flux[near][used], rcond=None)[0][0]


def measure(tpf, epic, kp, rng):
    """Return what is recovered of each depth, by run and depth."""
    start, period = tpf.time.value[0], rng.uniform(3, 10)
    start += period * rng.uniform()
    clean, seed = PLDCorrector(tpf).correct(), int(rng.integers(2**31))
    row, time = {"epic": epic, "kp": kp}, clean.time.value
    for depth in DEPTHS:
        planet = TransitModel.from_depth_duration(
            depth, DURATION, period, start, exposure_time=EXPOSURE
        )
        corrector, light = PLDCorrector(inject(tpf, planet, 1.0, seed=seed)), planet(time)
        masks = np.zeros(len(time), dtype=bool), light < 1
        curves = [clean.flux.value * light] + [
            corrector.correct(transit_mask=mask).flux.value for mask in masks
        ]
        for run, flux in zip(RUNS, curves, strict=True):
            row[f"{run} {depth:g}"] = float(f"{recovered(time, flux, planet):.4e}")
    return row


def rows_of(table):
    """Return a row for each star and depth."""
    return Table(names=COLUMNS, rows=[
        (row["epic"], row["kp"], depth, *(row[f"{run} {depth:g}"] for run in RUNS))
        for row in table for depth in DEPTHS
    ])  # fmt: skip


def simulated(task, *, data, cadences):
    """Return the row of a simulated star."""
    number = task["number"]
    rng, stars = np.random.default_rng([28, number]), injected_stars(data)[1]
    star = stars[rng.integers(len(stars))]
    motion, good, _ = moved(rng, data)
    motion, good = motion[:cadences], good[:cadences]
    shape, x_0, y_0 = stamp_around(good, 5)
    detector = Detector.k2_calibrated(shape=shape)
    place = {"x_0": x_0, "y_0": y_0, "shift": 0.5}
    target = draw_star(rng, star["kp"], detector, **place, signal=spotted(rng)[0])
    scene = [target, *neighbors(rng, shape)]
    observation = simulate(scene, detector, motion, seed=number, effects="mission")
    return measure(observation.to_tpf(), int(star["epic"]), float(star["kp"]), rng)


def real(task, *, data):
    """Return the row of a planet in a real file."""
    name = sorted(FILES)[task["number"] % 2]
    tpf = read_tpf(Path(data) / FILES[name])
    rng = np.random.default_rng([29, task["number"]])
    return measure(tpf, int(name.split()[1]), tpf.get_keyword("kepmag"), rng)


def write_table(target, data, *tables):
    """Write medians and scatters of recovered over true depths, and 1 + (run - control) / depth."""
    everest, _ = injected_stars(data)
    same = everest[np.isin(everest["epic"], tables[0]["epic"])]
    names = ("EVEREST 2, all", "EVEREST 2, same stars", "simulated stars", "two real stars")
    rows = [["depth", "light curves", "number", *RUNS, "unmasked, paired", "masked, paired"]]
    sets = list(zip(names, (everest, same, *tables), strict=False))
    for depth, (name, table) in product(DEPTHS, sets):
        part = table[np.isclose(table["depth"], depth)]
        ratios = [np.asarray(part[run]) / depth for run in RUNS]
        masked = part["masked_control" if "masked_control" in part.colnames else "control"]
        pairs = [1 + ratios[1] - ratios[0], 1 + ratios[2] - np.asarray(masked) / depth]
        medians = [[n[1] for n in percentiles(p, np.random.default_rng(1))] for p in pairs]
        rows.append([f"{depth:g}", name, len(part),
                     *(f"{np.median(r):.3f} ± {mad_std(r):.3f}" for r in ratios),
                     *(f"{value:.4f} ± {error:.4f}" for value, error in medians)])  # fmt: skip
    write_csv(f"{target}.csv", rows)


def main(argv=None):
    real_files = {"type": int, "help": "planets in each real file"}
    others = {"dest": "other", "type": Path, "help": "rows of real files"}
    more = {"cadences": 1700, "real": real_files, "with": others}
    options = arguments_of(__doc__, argv, 60, **more)
    if options.table:
        files = {"": options.file, "_real": options.other}
        tables = [store_rows(path, f"{options.table}{end}.ecsv", rows_of)
                  for end, path in files.items() if path]  # fmt: skip
        return write_table(options.table, options.data, *tables)
    if options.real:
        return sweep_rows(options, partial(real, data=options.data), 2 * options.real, rows_of)
    measure = partial(simulated, data=options.data, cadences=options.cadences)
    return sweep_rows(options, measure, options.stars, rows_of)


if __name__ == "__main__":
    main()
