"""Noise of real stars of Kepler and K2 by magnitude: small tables in the package.

``studies/derive_reference.py`` makes them from the catalogs of the EVEREST project.
"""

from functools import cache
from importlib import resources

import astropy.units as u
import numpy as np
from astropy.table import Table

from scope_models._arrays import plain_array, plain_number
from scope_models._checks import checked_choice, checked_number

__all__ = ["PERCENTILES", "REFERENCES", "bin_noise", "read_reference", "reference_noise"]

#: Percentiles in the tables, by the name of their column.
PERCENTILES = {"p10": 10, "p25": 25, "median": 50, "p75": 75, "p90": 90}
#: Names of the tables.
REFERENCES = ("kepler", "k2_c03_raw", "k2_c03_everest")


def bin_noise(mag, cdpp, centers, width=0.5, *, fewest=1):
    """Return percentiles of the noise of stars in bins of magnitude.

    Parameters
    ----------
    mag, cdpp : array_like, shape (n,)
        Magnitude and noise of each star.
    centers : array_like
        Middles of the bins. A bin holds its lower edge and not its upper one.
    width : float, optional
        Width of the bins in magnitudes.
    fewest : int, optional
        Bins with fewer stars are left out.

    Returns
    -------
    astropy.table.Table
        Columns mag, n (number of stars) and those of `PERCENTILES`.

    Examples
    --------
    >>> from scope_models.experiments.reference import bin_noise
    >>> table = bin_noise([12.0, 12.1, 12.2, 12.25], [10.0, 20.0, 30.0, 99.0], [12.0, 12.5])
    >>> table["n"].tolist(), table["median"].tolist()
    ([3, 1], [20.0, 99.0])
    """
    mag, centers = plain_array(mag, u.mag, "mag"), plain_array(centers, u.mag, "centers")
    cdpp, width = plain_array(cdpp, 1e-6, "cdpp"), plain_number(width, u.mag, "width")
    rows = []
    for center in centers:
        inside = (mag >= center - width / 2) & (mag < center + width / 2)
        if inside.sum() >= fewest:
            values = np.percentile(cdpp[inside], list(PERCENTILES.values()))
            rows.append((float(center), int(inside.sum()), *values))
    names = ("mag", "n", *PERCENTILES)
    return Table(rows=rows, names=names, dtype=(float, int, *[float] * len(PERCENTILES)))


@cache
def _read(name):
    """Return a table of the package, read once."""
    checked_choice("name", name, REFERENCES)
    file = resources.files("scope_models.experiments") / "data" / f"{name}.ecsv"
    return Table.read(file.read_text(encoding="utf-8").splitlines(), format="ascii.ecsv")


def read_reference(name, stars="unsaturated"):
    """Read the noise of real stars by magnitude.

    Parameters
    ----------
    name : {"kepler", "k2_c03_raw", "k2_c03_everest"}
        Light curves of Kepler's pipeline; of K2 campaign 3, raw, and de-trended by EVEREST 2.
    stars : {"unsaturated", "saturated", "all"}, optional
        Which stars of K2. The Kepler table makes no difference, and has "all" in every case.

    Returns
    -------
    astropy.table.Table
        Columns mag, n (number of stars in the bin of 0.5 mag about it), p10, p25, median, p75 and
        p90: 6-hour CDPP in ppm, in EVEREST's convention. ``meta`` has the source.

    Raises
    ------
    ValueError
        If ``name`` or ``stars`` is none of these.

    Examples
    --------
    >>> from scope_models.experiments.reference import read_reference
    >>> table = read_reference("kepler")
    >>> row = table[table["mag"] == 12.0][0]
    >>> print(row["n"], row["p10"], row["median"])
    2549 17.24 25.58
    """
    table = _read(name)
    kinds = sorted(set(table["stars"]))
    if stars not in {"unsaturated", "saturated", "all"}:
        raise ValueError(f"`stars` must be unsaturated, saturated or all, got {stars!r}")
    chosen = table[table["stars"] == (stars if stars in kinds else "all")]
    chosen.remove_column("stars")
    return chosen


def reference_noise(name, mag, column="median", stars="unsaturated"):
    """Return the noise of real stars at any magnitude.

    Parameters
    ----------
    name : {"kepler", "k2_c03_raw", "k2_c03_everest"}
        As for `read_reference`.
    mag : float or array_like
        Magnitude: within the range of the table.
    column : {"p10", "p25", "median", "p75", "p90"}, optional
        Which percentile.
    stars : {"unsaturated", "saturated", "all"}, optional
        As for `read_reference`.

    Returns
    -------
    float or ndarray
        6-hour CDPP in ppm, in EVEREST's convention; its logarithm is linear between the bins.

    Raises
    ------
    ValueError
        If an argument is outside its domain.

    Examples
    --------
    >>> from scope_models.experiments.reference import reference_noise
    >>> print(round(reference_noise("k2_c03_raw", 12.0), 1))
    189.3
    """
    checked_choice("column", column, PERCENTILES)
    table = read_reference(name, stars)
    values = np.array([checked_number("mag", m, any_sign=True) for m in np.ravel(mag)])
    low, high = table["mag"].min(), table["mag"].max()
    if values.min() < low or values.max() > high:
        raise ValueError(f"`mag` must be within {low:g} and {high:g}, got {mag}")
    noise = np.exp(np.interp(values, table["mag"], np.log(table[column])))
    return float(noise[0]) if np.ndim(mag) == 0 else noise.reshape(np.shape(mag))
