"""Store what the page on fits shows: ``python docs/data/store_fits.py FOLDER``.

FOLDER has the archive files. Written are, beside this file, the default fit of each file, and pulls
of simulated scenes of one, two and five stars.
"""

import sys
import time
import warnings
from pathlib import Path

import numpy as np
from _stamp import stamp
from astropy.table import Table

from scope_models import fit_tpf
from scope_models.exceptions import FitWarning

FOLDER = Path(__file__).parent
SCENES, STARS = 20, (1, 2, 5)
GROUPS = {"shared": "PSF and response", "star": "other stars' places", "cadence": "cadences"}


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
    for name, table in (("fits_scenes", scenes()), ("fits_files", fits(paths))):
        stamp(table, "python docs/data/store_fits.py FOLDER")
        table.write(FOLDER / f"{name}.ecsv", overwrite=True)


if __name__ == "__main__":
    main(sys.argv[1])
