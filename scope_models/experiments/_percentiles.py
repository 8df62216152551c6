"""Percentiles of the noise of our stars beside those of real ones."""

import numpy as np

from scope_models.experiments.reference import PERCENTILES

__all__ = ["compared", "holds"]

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
