"""Derive the tables of the noise of Kepler and K2 stars from the full catalogs.

    python studies/paper/derive_reference.py FOLDER [--output FOLDER]

The first folder holds kepler_cdpp.fits.gz and k2_c03_cdpp.fits.gz: the 6-hour CDPP of 78,519 Kepler
targets, and of 14,151 targets of K2 campaign 3, from the repository of the EVEREST project. The
tables are written to ``data`` beside this file by default.
"""

import argparse
from pathlib import Path

import numpy as np
from _reference import PERCENTILES, REFERENCES, bin_noise
from astropy.table import Table, vstack

CENTERS = np.arange(9.0, 18.1, 0.5)
FEWEST = 25
SOURCE = (
    "EVEREST project (Luger et al. 2016, AJ 152, 100; Luger et al. 2018, AJ 156, 99), "
    "MIT license, {}"
)
WHAT = {
    "kepler": "light curves of the Kepler pipeline, prime mission",
    "k2_c03_raw": "K2 campaign 3, aperture photometry before de-trending",
    "k2_c03_everest": "K2 campaign 3, de-trended by EVEREST 2",
}
CATALOGS = {
    "kepler": "kepler.cdpp",
    "k2_c03_raw": "statistics of campaign 3",
    "k2_c03_everest": "statistics of campaign 3",
}


def derive(folder):
    """Return the tables by name."""
    kepler = Table.read(folder / "kepler_cdpp.fits.gz")
    k2 = Table.read(folder / "k2_c03_cdpp.fits.gz")
    saturated = np.asarray(k2["SATURATED"]) == 1
    groups = {"unsaturated": ~saturated, "saturated": saturated, "all": np.ones_like(saturated)}
    tables = {"kepler": binned(kepler, "CDPP6H", {"all": np.ones(len(kepler), dtype=bool)})}
    for name, column in (("k2_c03_raw", "RAW_CDPP"), ("k2_c03_everest", "EVEREST_CDPP")):
        tables[name] = binned(k2, column, groups)
    for name in REFERENCES:
        tables[name].meta |= {
            "noise": f"6-h CDPP, convention of EVEREST: {WHAT[name]}",
            "source": SOURCE.format(CATALOGS[name]),
            "bins": f"0.5 mag wide, lower edge included; those with {FEWEST} stars or more",
            "made by": "studies/paper/derive_reference.py",
        }
    return tables


def binned(catalog, column, groups):
    """Return the percentiles of each group of stars in bins of magnitude."""
    parts = []
    for name, members in groups.items():
        stars = catalog[members]
        part = bin_noise(stars["KP"], stars[column], CENTERS, fewest=FEWEST)
        part.add_column([name] * len(part), name="stars", index=0)
        parts.append(part)
    table = vstack(parts)
    for name in PERCENTILES:
        table[name] = np.round(table[name], 2)
        table[name].unit = "ppm"
    table["mag"].unit = "mag"
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "data")
    options = parser.parse_args()
    for name, table in derive(options.folder).items():
        path = options.output / f"{name}.ecsv"
        table.write(path, format="ascii.ecsv", overwrite=True)
        print(f"{path}: {len(table)} rows")


if __name__ == "__main__":
    main()
