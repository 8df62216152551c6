"""Medians of the stars of a cell of a grid."""

import numpy as np

__all__ = ["cell_medians", "percentiles", "values_of"]


def values_of(table, name):
    """Return a column as floats, NaN where there is no value or no column."""
    if name not in table.colnames:
        return np.full(len(table), np.nan)
    return np.ma.filled(np.ma.asarray(table[name], dtype=float), np.nan)


def percentiles(values):
    """Return the median, 16th and 84th percentile of the values that are finite, or NaN."""
    values = values[np.isfinite(values)]
    if not len(values):
        return [np.nan] * 3
    return [float(value) for value in np.percentile(values, [50, 16, 84])]


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
        cell[name], *ends = percentiles(values_of(rows, name))
        if name in with_percentiles:
            cell[f"{name}_low"], cell[f"{name}_high"] = ends
    return cell
