"""Derive the tables of the noise of Kepler and K2 stars from the full catalogs.

    python studies/paper/derive_reference.py FOLDER [--output FOLDER]

The first folder holds kepler_cdpp.fits.gz and k2_c03_cdpp.fits.gz: the 6-hour CDPP of 78,519 Kepler
targets, and of 14,151 targets of K2 campaign 3, from the repository of the EVEREST project. The
tables are written to ``data`` beside this file by default.
"""

import argparse
from pathlib import Path

import numpy as np
from _reference import PERCENTILES
from astropy.table import Table

CENTERS = np.arange(9.0, 18.1, 0.5)
FEWEST = 25
SOURCE = (
    "EVEREST project (Luger et al. 2016, AJ 152, 100; Luger et al. 2018, AJ 156, 99), "
    "MIT license, {}"
)
K2 = "k2_c03_cdpp.fits.gz", "statistics of campaign 3"
#: File of the catalog, its name, column of the noise, and light curves, by the name of the table.
TABLES = {
    "kepler": ("kepler_cdpp.fits.gz", "kepler.cdpp", "CDPP6H",
               "light curves of the Kepler pipeline, prime mission"),
    "k2_c03_raw": (*K2, "RAW_CDPP", "K2 campaign 3, aperture photometry before de-trending"),
    "k2_c03_everest": (*K2, "EVEREST_CDPP", "K2 campaign 3, de-trended by EVEREST 2"),
}  # fmt: skip


def binned(catalog, column):
    """Return percentiles of each group of stars in bins, which hold their lower edge only."""
    groups, rows = {"all": np.ones(len(catalog), dtype=bool)}, []
    if "SATURATED" in catalog.colnames:
        saturated = np.asarray(catalog["SATURATED"]) == 1
        groups = {"unsaturated": ~saturated, "saturated": saturated} | groups
    for name, members in groups.items():
        mag, noise = (np.asarray(catalog[key], dtype=float)[members] for key in ("KP", column))
        for center in CENTERS:
            inside = noise[(mag >= center - 0.25) & (mag < center + 0.25)]
            if len(inside) >= FEWEST:
                values = np.percentile(inside, list(PERCENTILES.values())).round(2)
                rows.append((name, center, len(inside), *values))
    units = {"mag": "mag"} | dict.fromkeys(PERCENTILES, "ppm")
    return Table(rows=rows, names=("stars", "mag", "n", *PERCENTILES), units=units)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "data")
    options = parser.parse_args()
    for name, (file, catalog, column, curves) in TABLES.items():
        table = binned(Table.read(options.folder / file), column)
        table.meta = {
            "noise": f"6-h CDPP, convention of EVEREST: {curves}",
            "source": SOURCE.format(catalog),
            "bins": f"0.5 mag wide, lower edge included; those with {FEWEST} stars or more",
            "made by": "studies/paper/derive_reference.py",
        }
        path = options.output / f"{name}.ecsv"
        table.write(path, format="ascii.ecsv", overwrite=True)
        print(f"{path}: {len(table)} rows")


if __name__ == "__main__":
    main()
