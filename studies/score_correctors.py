"""Light curves of the benchmark by many correctors, and the table of their scores.

    scope-models benchmark --output-dir sky --stars 42
    python studies/score_correctors.py sky curves [--methods raw,truth,pld] [--stars 42]
    scope-models score curves/pld/*.fits

Each corrector has its default call, in the aperture of the file where it takes one, and nothing is
masked. Light curves that exist are kept. "cbv": eight principal components of the light curves of
30 simulated constant stars that move as the file's POS_CORR, fitted by lightkurve's
RegressionCorrector. "truth": the true flux with the expected noise of the file's aperture.
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table
from paper._correctors import quiet

from scope_models import Detector, Motion, PLDCorrector, Star, simulate
from scope_models._arrays import values_of
from scope_models.benchmark import benchmark_star, score_light_curves, summarize_scores
from scope_models.io import read_tpf

ENSEMBLE, COMPONENTS = 30, 8


def raw(tpf, number):  # noqa: ARG001
    return tpf.to_lightcurve(aperture_mask="pipeline")


def truth(tpf, number):
    sky, lc = benchmark_star(number), tpf.to_lightcurve(aperture_mask="pipeline")
    rows = np.asarray(lc.cadenceno) - 1
    noise = sky.floor()
    drawn = 1 + noise * np.random.default_rng(number).standard_normal(len(rows))
    lc.flux = 1e4 * sky.true_flux[rows] * drawn * lc.flux.unit
    lc.flux_err = 1e4 * noise * sky.true_flux[rows] * lc.flux.unit
    return lc


def lightkurve_pld(tpf, number, order):  # noqa: ARG001
    from lightkurve.correctors import PLDCorrector as Corrector

    return Corrector(tpf, aperture_mask="pipeline").correct(pld_order=order)


def positions(tpf):
    """Return POS_CORR with straight lines in place of absurd values."""
    from scope_models.io import usable_positions

    offsets = np.stack([tpf.pos_corr1, tpf.pos_corr2], axis=1).astype(float)
    good = usable_positions(offsets)
    rows = np.arange(len(good))
    return [np.interp(rows, rows[good], column[good]) for column in offsets.T]


def sff(tpf, number):  # noqa: ARG001
    from lightkurve.correctors import SFFCorrector

    x, y = positions(tpf)
    lc = tpf.to_lightcurve(aperture_mask="pipeline").remove_nans()
    rows = np.isin(tpf.cadenceno, lc.cadenceno)
    return SFFCorrector(lc).correct(centroid_col=x[rows], centroid_row=y[rows], windows=10)


def cbv(tpf, number):
    from lightkurve.correctors import DesignMatrix, RegressionCorrector

    lc = tpf.to_lightcurve(aperture_mask="pipeline").remove_nans()
    rows = np.isin(tpf.cadenceno, lc.cadenceno)
    x, y = (offset[rows] for offset in positions(tpf))
    motion = Motion.from_arrays(lc.time.value, x, y, time_format=lc.time.format)
    detector, rng = Detector.k2_calibrated(shape=(11, 11)), np.random.default_rng(number)
    curves = []
    for one in range(ENSEMBLE):
        star = Star(12.0, *(5 + rng.uniform(-0.5, 0.5, 2)))
        observation = simulate(star, detector, motion, seed=one, noise=False)
        flux = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
        curves.append(flux / flux.mean() - 1)
    basis = np.linalg.svd(np.array(curves), full_matrices=False)[2][:COMPONENTS]
    matrix = DesignMatrix(basis.T, name="cbv").append_constant()
    return RegressionCorrector(lc).correct(matrix)


METHODS = {
    "truth": truth,
    "raw": raw,
    **{f"lk-pld{order}": partial(lightkurve_pld, order=order) for order in (1, 2, 3)},
    "lk-sff": sff,
    "cbv": cbv,
    "pld": lambda tpf, number: PLDCorrector(tpf).correct(),  # noqa: ARG005
    "alone": lambda tpf, number: PLDCorrector(tpf, neighbors=[]).correct(),  # noqa: ARG005
}


def correct(source, target, method):
    """Write the light curve of a file; one that cannot be corrected is NaN everywhere."""
    number = int(source.name[3:6])
    tpf = read_tpf(source)
    begin = time.perf_counter()
    try:
        lc = METHODS[method](tpf, number)
        columns = [values_of(lc, name) for name in ("flux", "flux_err")]
        numbers = np.asarray(lc["cadenceno"], dtype=int)
    except (ValueError, np.linalg.LinAlgError) as error:
        print(f"# {source.name} {method}: {error}", file=sys.stderr)
        numbers = np.asarray(tpf.cadenceno, dtype=int)
        columns = np.full((2, len(numbers)), np.nan)
    table = Table([numbers, *columns], names=("CADENCENO", "FLUX", "FLUX_ERR"))
    table.meta["SECONDS"] = time.perf_counter() - begin
    table.write(target, overwrite=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sky", type=Path)
    parser.add_argument("curves", type=Path)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--stars", type=int, default=200)
    options = parser.parse_args()
    methods = options.methods.split(",")
    sources = sorted(options.sky.glob("sky*.fits"))[: options.stars]
    for source in sources:
        for method in methods:
            target = options.curves / method / source.name
            if not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                with quiet():
                    correct(source, target, method)
    paths = [options.curves / method / source.name for source in sources for method in methods]
    table = score_light_curves(paths)
    table["method"] = [path.parent.name for path in paths]
    table["seconds"] = [Table.read(path).meta["SECONDS"] for path in paths]
    table.write(options.curves / "scores.ecsv", overwrite=True)
    for method in methods:
        mine = table[table["method"] == method]
        row = summarize_scores(mine)[-1]
        values = " ".join(f"{row[name]:9.3g}" for name in row.colnames[2:])
        print(f"{method:10} {len(mine):5d} {values} {np.median(mine['seconds']):6.2f} s")


if __name__ == "__main__":
    main()
