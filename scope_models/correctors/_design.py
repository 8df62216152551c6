"""The design matrix: which groups of regressors there are, and their columns."""

from dataclasses import dataclass

import numpy as np

from scope_models.correctors._features import (
    Regressors,
    centre,
    power_columns,
    principal_columns,
    shared_columns,
)
from scope_models.correctors._saturation import without_saturation

__all__ = ["DesignOptions", "make_regressors"]

#: Columns are dropped when they could not change the flux by this part of its noise's variance
#: with coefficients of one; of higher orders, whose coefficients may be larger, earlier.
_TOLERANCE, _HIGHER_TOLERANCE = 1e-2, 1e-3
_SHARED_TOLERANCE = 1e-6
_MAX_RANK = 300
_REACH = 2


@dataclass(frozen=True)
class DesignOptions:
    """
    What goes into the design matrix beside the fractions' products.

    Parameters
    ----------
    order : int
        Highest number of factors.
    saturation : float or None
        Flux in e-/s above which a pixel counts as saturated.
    breaks : tuple of float
        Times at which a new segment begins.
    extra : dict
        Further groups, from names to columns ``(n_cadences, m)``, NaN where unknown.
    """

    order: int
    saturation: float | None
    breaks: tuple
    extra: dict


def make_regressors(pixels, use, options):
    """
    Make the groups of regressors.

    Parameters
    ----------
    pixels : Pixels
        Pixels; only usable cadences are read.
    use : ndarray of bool
        Cadences in the fit, of the usable ones.
    options : DesignOptions
        What to make.

    Returns
    -------
    Regressors
        Columns for the usable cadences, centred on the cadences in use.
    """
    usable = pixels.usable
    total = pixels.total[usable]
    photons = float(np.median((pixels.total_err[usable] ** 2 / total)[use]))
    images = without_saturation(
        pixels.flux[usable], pixels.aperture, use, options.saturation, photons
    )
    images /= total[:, None, None]
    fractions = images[:, pixels.aperture]
    noise = float(np.median((pixels.total_err[usable] / total)[use] ** 2))
    first = principal_columns(centre(fractions, use), use, _TOLERANCE * noise)
    parts = {"order 1": first}
    for n in range(2, options.order + 1):
        columns, _ = power_columns(fractions, n, use, _TOLERANCE * noise, _MAX_RANK)
        columns = centre(columns, use)
        parts[f"order {n}"] = principal_columns(columns, use, _HIGHER_TOLERANCE * noise)
        if n == 2:
            shared = centre(shared_columns(images, n, _REACH), use)
            parts["order 2, shared"] = principal_columns(shared, use, _SHARED_TOLERANCE * noise)
    if options.breaks:
        parts["segments"] = _contrasts(first, pixels.time[usable], options.breaks, use)
    for name, columns in options.extra.items():
        parts[name] = _completed(columns[usable], use, noise)
    return Regressors.join(parts)


def _contrasts(columns, time, breaks, use):
    """
    Return copies of the columns that differ between the segments and are the same in none.

    A common part of the coefficients is left to the columns themselves: of k segments, k - 1
    orthonormal contrasts remain.
    """
    segment = np.searchsorted(np.asarray(breaks), time, side="right")
    present = np.unique(segment[use])
    member = (segment[:, None] == present).astype(float)
    contrasts = member @ _orthonormal_contrasts(len(present))
    return (contrasts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)


def _orthonormal_contrasts(k):
    """Return k - 1 orthonormal columns whose elements add up to zero (Helmert's)."""
    contrasts = np.triu(np.ones((k, k - 1)))
    contrasts[1:][np.diag_indices(k - 1)] = -np.arange(1, k)
    return contrasts / np.sqrt(np.arange(1, k) * np.arange(2, k + 1))


def _completed(columns, use, noise):
    """Principal components of columns that may have gaps; a gap is filled with the mean."""
    known = np.isfinite(columns).all(axis=1)
    fit = use & known
    if not fit.any():
        return np.empty((len(columns), 0))
    centred = np.where(known[:, None], columns - columns[fit].mean(axis=0), 0.0)
    return principal_columns(centred, fit, _TOLERANCE * noise)
