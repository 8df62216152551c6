"""Percentiles of the results of many stars, alone and beside those of real stars."""

import numpy as np

from scope_models.experiments.reference import PERCENTILES

__all__ = ["cell_medians", "compared", "holds", "percentiles", "values_of"]

_RESAMPLES = 400


def compared(prefix, noise, reference, mag, names, *, known="kepler"):
    """Return percentiles of the noise with errors, and their ratios to the reference.

    Parameters
    ----------
    prefix : str
        What the columns are named after.
    noise : array_like
        Noise of our stars.
    reference : astropy.table.Table
        Percentiles of real stars by magnitude.
    mag : float
        Magnitude.
    names : sequence of str
        Names out of `PERCENTILES`.
    known : str, optional
        What the columns of the reference are named after.

    Returns
    -------
    dict
        For each name ours, its standard deviation under resampling of the stars, the
        reference and the ratio.
    """
    noise = np.asarray(noise, dtype=float)
    picks = np.random.default_rng(0).integers(len(noise), size=(_RESAMPLES, len(noise)))
    row = {}
    for name in names:
        ours = np.percentile(noise, PERCENTILES[name])
        error = np.std(np.percentile(noise[picks], PERCENTILES[name], axis=1))
        found = reference[name][np.asarray(reference["mag"]) == mag]
        theirs = float(found[0]) if len(found) else np.nan
        row |= {
            f"{prefix}_{name}": float(ours),
            f"{prefix}_{name}_error": float(error),
            f"{known}_{name}": theirs,
            f"{prefix}_{name}_ratio": float(ours / theirs),
        }
    return row


def holds(ratios, tolerance):
    """Return whether all ratios are near 1, in words.

    Parameters
    ----------
    ratios : array_like
        Ratios.
    tolerance : float
        Largest deviation from 1.

    Returns
    -------
    str
        "holds" or "does not hold".
    """
    near = np.all(np.abs(np.asarray(ratios, dtype=float) - 1) <= tolerance)
    return "holds" if near else "does not hold"


def values_of(table, name):
    """Return a column as floats, NaN where there is no value or no column."""
    if name not in table.colnames:
        return np.full(len(table), np.nan)
    return np.ma.filled(np.ma.asarray(table[name], dtype=float), np.nan)


def percentiles(values):
    """Return the 16th, 50th and 84th percentile of the values that are finite, or NaN."""
    values = values[np.isfinite(values)]
    if not len(values):
        return [np.nan] * 3
    return [float(value) for value in np.percentile(values, [16, 50, 84])]


def cell_medians(rows, with_percentiles):
    """
    Return the medians of all columns of the stars of one motion and magnitude.

    Parameters
    ----------
    rows : astropy.table.Table
        Results with the columns "scale" and "mag", which are the same in all rows.
    with_percentiles : sequence of str
        Columns of which the 16th and 84th percentiles are returned too, as NAME_low and NAME_high.

    Returns
    -------
    dict
        The numbers by their names, and the number of "stars".
    """
    cell = {"scale": float(rows["scale"][0]), "mag": float(rows["mag"][0]), "stars": len(rows)}
    for name in rows.colnames:
        if name in {"key", "index", *cell}:
            continue
        low, cell[name], high = percentiles(values_of(rows, name))
        if name in with_percentiles:
            cell[f"{name}_low"], cell[f"{name}_high"] = low, high
    return cell
