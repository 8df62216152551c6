"""Store what the page on fits shows: ``python docs/data/store_fits.py FOLDER``.

FOLDER has the archive files. Written are, beside this file, the default fit of each file, pulls of
simulated scenes of one, two and five stars, and fluxes beside those of the corrector.
"""

import sys
import time
import warnings
from pathlib import Path

import numpy as np
from _stamp import stamp
from astropy.table import Table

from scope_models import PLDCorrector, fit_tpf
from scope_models.benchmark import make_sky
from scope_models.exceptions import DetrendingWarning, FitWarning
from scope_models.photometry import cdpp

FOLDER = Path(__file__).parent
SCENES, STARS = 20, (1, 2, 5)
SKIES = (
    "k2-1x-constant", "k2-1x-kp14", "k2-1x-kp17", "k2-3x-constant", "k2-5x-kp15", "k2-1x-spots-5d",
    "k2-1x-rr-lyrae", "k2-1x-eclipsing", "k2-1x-transits-1pct", "k2-1x-rise-30d",
    "kepler-constant-kp14", "kepler-spots-10d", "tess-constant", "tess-spots-1.5d",
)  # fmt: skip
SEED, CADENCES = 3001, 1500
GROUPS = {"shared": "PSF and response", "star": "other stars' places", "cadence": "cadences"}


def corrected(tpf):
    """Return the default light curve of the corrector."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        return PLDCorrector(tpf).correct()


def noise(curve, cadenceno):
    """Return the CDPP of some cadences in EVEREST's convention, NaN if that needs more."""
    try:
        return float(cdpp(curve[np.isin(curve.cadenceno.value, cadenceno)], method="everest"))
    except ValueError:
        return np.nan


def fluxes():
    """Return a row for each sky: rms of relative fluxes about the truth, the same cadences, ppm."""
    rows = []
    for name in SKIES:
        sky = make_sky(name, SEED, n_cadences=CADENCES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FitWarning)
            fit = fit_tpf(sky.to_tpf(), response="pixels")
        good, curve = ~fit.outliers, corrected(sky.to_tpf())
        used = np.searchsorted(sky.cadenceno, fit.cadenceno[good])
        own = np.searchsorted(curve.cadenceno.value, fit.cadenceno[good])
        truth = sky.true_flux[used] / np.median(sky.true_flux[used])
        light = sky.flux[used][:, sky.aperture].sum(axis=1)
        rows.append(
            {
                "star": name,
                "sum of the aperture": left(light, truth),
                "fit": left(fit.flux[good], truth),
                "as stated": round(1e6 * float(np.median((fit.flux_scatter / fit.flux)[good]))),
                "corrector": left(np.asarray(curve.flux.value, dtype=float)[own], truth),
                "amplitude": kept(fit.flux[good], truth),
            }
        )
        print(rows[-1], flush=True)
    return Table(rows)


def left(flux, truth):
    """Return the rms of a relative flux about the truth, ppm."""
    relative = flux / truth
    return round(1e6 * float(np.nanstd(relative) / np.nanmedian(relative)))


def kept(flux, truth):
    """Return the part of the variability that is in the flux, NaN for constant stars."""
    if np.ptp(truth) == 0:
        return np.nan
    slope, _ = np.polyfit(truth, flux / np.median(flux), 1)
    return round(float(slope), 3)


def fits(paths):
    """Return a row for the default fit of each file."""
    rows = []
    for path in paths:
        begin = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FitWarning)
            fit = fit_tpf(path)
        seconds = time.process_time() - begin
        x, y = fit.path_scale()
        rows.append(
            {
                "file": path.name.partition(".")[0],
                "cadences": len(fit.time),
                "seconds": round(seconds, 1),
                "converged": "yes" if fit.converged else "no",
                "chi-squared": round(float(fit.reduced_chi2), 2),
                "median pixel": round(float(np.nanmedian(fit.chi2_pixels)), 2),
                "held out": round(float(fit.chi2_held_out), 2),
                "motion x": round(float(x), 2),
                "motion y": round(float(y), 2),
                "CDPP (ppm)": round(noise(fit.to_lightcurve(), fit.cadenceno[~fit.outliers]), 1),
                "corrector": round(noise(corrected(path), fit.cadenceno[~fit.outliers]), 1),
            }
        )
        print(rows[-1], flush=True)
    return Table(rows)


def scenes(numbers=STARS):
    """Return pulls and coverage of the errors by number of stars and group of parameters."""
    from fitting import scene_pulls

    rows = []
    for n_stars in numbers:
        found = [scene_pulls(n_stars, seed) for seed in range(SCENES)]
        for group, title in GROUPS.items():
            pulls = np.concatenate([np.ravel(list(row[group].values())) for row in found])
            if pulls.size:
                rows.append(
                    {
                        "stars": n_stars,
                        "parameters": title,
                        "rms pull": round(float(np.sqrt(np.mean(pulls**2))), 2),
                        "within one error": round(float(np.mean(np.abs(pulls) < 1)), 2),
                        "converged": f"{sum(row['converged'] for row in found)} of {SCENES}",
                    }
                )
                print(rows[-1], flush=True)
    return Table(rows)


def main(folder):
    """Write the tables."""
    sys.path.append(str(FOLDER.parents[1] / "studies"))
    folder = Path(folder)
    paths = sorted([*folder.glob("*_tpf/*.fits*"), *folder.glob("kepler_q12_ch4/*.fits*")])
    made = {"fits_scenes": scenes(), "fits_files": fits(paths), "fits_fluxes": fluxes()}
    for name, table in made.items():
        stamp(table, "python docs/data/store_fits.py FOLDER")
        table.write(FOLDER / f"{name}.ecsv", overwrite=True)


if __name__ == "__main__":
    main(sys.argv[1])
