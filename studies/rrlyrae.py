"""RR Lyrae stars of K2, simulated with the magnitudes of 100 real ones, and corrected.

    python studies/rrlyrae.py DATA stars.csv [--stars 100] [--cadences 1700]
    python studies/rrlyrae.py DATA stars.csv --table docs/data/rrlyrae

DATA is the folder of shared data. A run goes on where it stopped; ``--workers 2`` shares it. Light
curves are Fourier series in magnitudes; motions are those of the star's campaign. Ratios and phases
of RRab stars are those of EPIC 220198696, fitted to the light curve of campaign 8 in the tests of
autoEAP, with a scatter; amplitudes are those of Kepler's (Nemec et al. 2011, MNRAS 417, 1022). RRc
stars are rounded values of Kepler's (Moskalik et al. 2015, MNRAS 447, 2348). "Properly" is an
amplitude within 3 % and an rms about the truth below 3 % of it; "clean" cadences have no flag of
rolling bands.
"""

from functools import cache, partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from _rows import arguments_of, store_rows, sweep_rows, write_csv
from astropy.table import Table
from paper._correctors import amplitude
from paper._stars import draw_star, stamp_around
from population import catalog, moved

from scope_models import Detector, PLDCorrector, Star, simulate
from scope_models.missions import MISSIONS

LIMIT, FIRST_DAYS = 0.03, {3: 2144, 4: 2229}  # of campaigns, BKJD
COLUMNS = ("epic", "kp", "kind", "period", "neighbor", "raw_amplitude", "raw_rms", "amplitude",
           "rms", "clean_amplitude", "clean_rms")  # fmt: skip
rows_of = itemgetter(list(COLUMNS))
# Periods (d), amplitudes of the fundamental (mag), ratios R_k1, and phases phi_k1 of sines.
SHAPES = {
    "RRab": ((0.45, 0.8), (0.19, 0.40), (0.45, 0.35, 0.23, 0.16, 0.10, 0.06, 0.04),
             (2.32, 4.91, 1.28, 3.95, 0.37, 3.02, 5.56)),
    "RRc": ((0.3, 0.42), (0.17, 0.25), (0.11, 0.08, 0.05), (3.1, 6.0, 2.6)),
}  # fmt: skip


@cache
def real_stars(data):
    """Return EPIC, Kp, campaign (NaN where the tables have none) and judgments of real stars."""
    path, known = Path(data) / "k2_pipelines" / "everest_rrlyrae.tsv", catalog(data)
    names = ("epic", "everest2", "everest1", "k2sff", "k2sc")
    stars = Table.read(path, format="ascii", names=names, comment="#")
    for name in ("kp", "campaign"):
        values = dict(zip(known["epic"], known[name], strict=True))
        stars[name] = [values.get(epic, np.nan) for epic in stars["epic"]]
    return stars


def pulsation(rng, kind):
    """Return the relative flux of a star as a function of time, and its period."""
    periods, amplitudes, ratios, phases = SHAPES[kind]
    period, first, start = rng.uniform(*periods), rng.uniform(*amplitudes), rng.uniform()
    orders = np.arange(1, len(ratios) + 2)
    sizes = first * np.concatenate([[1], ratios * rng.normal(1, 0.05, len(ratios))])
    phases = np.concatenate([[0], phases + rng.normal(0, 0.1) * orders[1:]])

    def flux(time):
        angle = 2 * np.pi * (np.asarray(time)[..., None] / period + start) * orders + phases
        return 10 ** (-0.4 * np.sum(sizes * np.sin(angle), axis=-1))

    mean = flux(np.linspace(0, period, 1001)[:-1]).mean()
    return (lambda time: flux(time) / mean), period


def quality(flux, truth):
    """Return the ratio of amplitudes, and the rms about the truth over its amplitude.

    Both in the same unit; light that is added to all of `flux` does not count.
    """
    return amplitude(flux, truth), np.nanstd(flux - truth) / np.ptp(truth[np.isfinite(flux)])


def observe(task, *, data, cadences):
    """Return the row of a star."""
    number = task["number"]
    rng, stars = np.random.default_rng([27, number]), real_stars(data)
    star, known = stars[number], stars[np.isfinite(stars["kp"])]
    star = star if np.isfinite(star["kp"]) else known[rng.integers(len(known))]
    kp, first_day = float(star["kp"]), FIRST_DAYS[star["campaign"]]
    drawn = iter(partial(moved, rng, data), None)  # of all campaigns
    motion = next(one for one, *_ in drawn if round(one.time[0]) == first_day)[:cadences]
    good = (motion.quality & MISSIONS["K2"].quality.rejected) == 0
    shape, x_0, y_0 = stamp_around(motion[good], 5)
    kind = "RRab" if rng.uniform() < 0.75 else "RRc"
    signal, period = pulsation(rng, kind)
    detector = Detector.k2_calibrated(shape=shape)
    target = draw_star(rng, kp, detector, x_0=x_0, y_0=y_0, shift=0.5, signal=signal)
    distance, angle, fainter = rng.uniform(1.5, 5), rng.uniform(0, 2 * np.pi), rng.uniform(0, 3)
    place = np.array([x_0, y_0]) + distance * np.array([np.cos(angle), np.sin(angle)])
    scene = [target] + [Star(kp + fainter, *place)] * (number % 2)
    observation = simulate(scene, detector, motion, seed=number, effects="mission")
    corrector = PLDCorrector(observation.to_tpf())
    corrected = corrector.correct()
    aperture = np.asarray(corrector.aperture_mask, dtype=float)
    alone = observation.scene.replace(stars=[target.replace(signal=None)], effects=())
    light = np.median((simulate(alone, noise=False).flux * aperture).sum(axis=(1, 2))[good])
    kept = np.isin(observation.cadenceno, corrected.cadenceno)  # lightkurve drops flagged cadences
    truth = light * observation.truth.relative_flux[0, kept]
    raw, flux = corrector.original_lc.flux.value, corrected.flux.value
    bands = observation.quality[kept] & MISSIONS["K2"].quality.rolling_band > 0
    found = [quality(one, truth) for one in (raw, flux, np.where(bands, np.nan, flux))]
    row = (int(stars["epic"][number]), round(kp, 3), kind, round(period, 4), number % 2,
           *(round(float(value), 5) for value in np.ravel(found)))  # fmt: skip
    return dict(zip(COLUMNS, row, strict=True))


def write_tables(table, real, target):
    """Write how many stars are corrected properly, and the judgments of real light curves."""
    neighbor, kind, kp = table["neighbor"] == 1, table["kind"], table["kp"]
    parts = {"all": kind != "", "alone": ~neighbor, "with a neighbor": neighbor}
    parts |= {name: kind == name for name in SHAPES}
    parts |= {"Kp below 17": kp < 17, "17 to 18.5": (kp >= 17) & (kp < 18.5), "above": kp >= 18.5}
    rows = []
    for name, part in ((n, p) for n, p in parts.items() if p.any()):
        row = [name, int(part.sum())]
        for prefix in ("raw_", "", "clean_"):
            amplitude, rms = table[f"{prefix}amplitude"][part], table[f"{prefix}rms"][part]
            row.append(int(np.sum((np.abs(amplitude - 1) < LIMIT) & (rms < LIMIT))))
        rows.append([*row, f"{np.median(amplitude):.4f}", f"{np.percentile(rms, 90):.4f}"])
    heads = ["stars", "number", "before correction", "corrected", "without rolling bands",
             "median amplitude", "90 % of the rms are below"]  # fmt: skip
    judged = [[name, int(np.sum(real[name] != 3)), int(np.sum(real[name] == 1))]
              for name in real.colnames[1:5]]  # fmt: skip
    write_csv(f"{target}.csv", [heads, *rows])
    write_csv(f"{target}_judged.csv", [["pipeline", "light curves", "proper by eye"], *judged])


def main(argv=None):
    options = arguments_of(__doc__, argv, 100, cadences=1700)
    if options.table:
        table = store_rows(options.file, f"{options.table}.ecsv", rows_of)
        return write_tables(table, real_stars(options.data), options.table)
    measure = partial(observe, data=options.data, cadences=options.cadences)
    return sweep_rows(options, measure, options.stars, rows_of)


if __name__ == "__main__":
    main()
