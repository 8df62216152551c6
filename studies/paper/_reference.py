"""Noise of real stars of Kepler and K2 by magnitude, and comparisons with it.

``derive_reference.py`` makes the tables from the catalogs of the EVEREST project: the 6-hour CDPP
in ppm, in EVEREST's convention, with the source in ``meta``. They are "kepler", light curves of
Kepler's pipeline, and "k2_c03_raw" and "k2_c03_everest", K2 campaign 3, de-trended by EVEREST 2.
"""

from functools import cache
from pathlib import Path

import numpy as np
from astropy.table import Table

#: Percentiles in the tables, by the name of their column.
PERCENTILES = {"p10": 10, "p25": 25, "median": 50, "p75": 75, "p90": 90}
_read = cache(Table.read)


def read_reference(name, stars="unsaturated"):
    """Return the columns mag, n and those of `PERCENTILES` of a table.

    `stars` is "unsaturated", "saturated" or "all"; the Kepler table has "all" in every case.
    """
    table = _read(Path(__file__).parent / "data" / f"{name}.ecsv")
    chosen = table[table["stars"] == (stars if stars in table["stars"] else "all")]
    chosen.remove_column("stars")
    return chosen


def reference_noise(name, mag, column="median", stars="unsaturated"):
    """Return the noise of real stars at any magnitude: its logarithm is linear between the bins."""
    table = read_reference(name, stars)
    low, high = table["mag"].min(), table["mag"].max()
    if np.min(mag) < low or np.max(mag) > high:
        raise ValueError(f"`mag` must be within {low:g} and {high:g}, got {mag}")
    return np.exp(np.interp(mag, table["mag"], np.log(table[column])))


def noise_band(name, label, mag=None):
    """Return the noise of real stars as `plot_cdpp` takes it, by default in all bins."""
    mag = np.array(read_reference(name, "all")["mag"] if mag is None else mag)
    columns = {"median": "median", "low": "p10", "high": "p90"}
    band = {key: reference_noise(name, mag, column, "all") for key, column in columns.items()}
    labels = {"label": f"{label}, median", "band_label": f"{label}, 10 % to 90 %"}
    return band | labels | {"mag": mag}


def compared(prefix, noise, reference, mag, names, *, known="kepler"):
    """Return percentiles of noise at a magnitude with errors, and their ratios to the reference.

    The errors are the standard deviation under resampling of the stars; ``names`` are those of
    `PERCENTILES`, ``prefix`` and ``known`` what our columns and the reference's are named after.
    """
    noise, row = np.asarray(noise, dtype=float), {}
    picks = np.random.default_rng(0).integers(len(noise), size=(400, len(noise)))
    for name in names:
        ours = float(np.percentile(noise, PERCENTILES[name]))
        error = np.std(np.percentile(noise[picks], PERCENTILES[name], axis=1))
        theirs = float(np.append(reference[name][reference["mag"] == mag], np.nan)[0])
        row |= {
            f"{prefix}_{name}": ours, f"{prefix}_{name}_error": float(error),
            f"{known}_{name}": theirs, f"{prefix}_{name}_ratio": ours / theirs,
        }  # fmt: skip
    return row
