"""Percentiles and claims of the results of many stars, alone and beside those of real stars."""

import numpy as np

from scope_models._arrays import values_of
from scope_models.experiments.reference import PERCENTILES

__all__ = [
    "cells",
    "checked_claims",
    "compared",
    "holds",
    "on_grid",
    "percentiles",
    "values_of",
]

_RESAMPLES = 400


def cells(table, names):
    """Yield each combination of values of columns that there is, sorted, with its rows."""
    found = {}
    for number, cell in enumerate(zip(*(table[name] for name in names), strict=True)):
        found.setdefault(cell, []).append(number)
    for cell in sorted(found):
        yield dict(zip(names, cell, strict=True)), table[found[cell]]


def compared(prefix, noise, reference, mag, names, *, known="kepler"):
    """Return percentiles of noise at a magnitude with errors, and their ratios to the reference.

    The errors are the standard deviation under resampling of the stars; ``names`` are those of
    `PERCENTILES`, ``prefix`` and ``known`` what our columns and the reference's are named after.
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
    """Return "holds" or "does not hold": whether all ratios deviate from 1 by that at most."""
    near = np.all(np.abs(np.asarray(ratios, dtype=float) - 1) <= tolerance)
    return "holds" if near else "does not hold"


def checked_claims(claims):
    """Return the verdicts on claims that are ratios to a limit, and the largest ratio of each.

    A claim holds if its ratios are at most 1; it is not checked if there is none, or one is NaN.
    """
    verdicts, checked = {}, {}
    for claim, values in claims.items():
        ratios = np.atleast_1d(np.asarray(values, dtype=float))
        if not ratios.size or np.isnan(ratios).any():
            verdicts[claim] = "not checked"
            continue
        verdicts[claim] = "holds" if ratios.max() <= 1 else "does not hold"
        checked[claim] = float(ratios.max())
    return verdicts, checked


def percentiles(values):
    """Return the 16th, 50th and 84th percentile of the values that are finite, or NaN."""
    values = values[np.isfinite(values)]
    if not len(values):
        return [np.nan] * 3
    return [float(value) for value in np.percentile(values, [16, 50, 84])]


def on_grid(summary, rows, columns, name):
    """Return a column as a map over two others, each given by its name and its values."""
    values = np.full((len(rows[1]), len(columns[1])), np.nan)
    for row in summary:
        values[rows[1].index(row[rows[0]]), columns[1].index(row[columns[0]])] = row[name]
    return values
