"""The design matrix: which groups of regressors there are, and their columns."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from scope_models.correctors._features import (
    Regressors,
    centre,
    power_columns,
    principal_columns,
    shared_columns,
)

__all__ = ["DesignOptions", "make_regressors", "without_saturation"]

#: Columns are dropped when they could not change the flux by this part of its noise's variance
#: with coefficients of one; of higher orders, whose coefficients may be larger, earlier.
_TOLERANCE, _HIGHER_TOLERANCE = 1e-2, 1e-3
_SHARED_TOLERANCE = 1e-6
_MAX_RANK = 300
#: Width in pixels of the Gaussian that stands for a saturated column.
_DRAWN_WIDTH = 0.6
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


def without_saturation(images, aperture, saturation):
    """
    Return images in which saturated columns do not tell how bright the star is.

    A full pixel stays full when the star dims: its share of the light tells of the dimming, and
    must not be a regressor. Charge bleeds up and down alike, so that the sum of each
    column and the row of the centre of light do not depend on it. The columns are replaced by
    images of these alone: a Gaussian along the column about the centre of light, as bright
    as the column.

    Parameters
    ----------
    images : ndarray
        ``(n_cadences, ny, nx)``.
    aperture : ndarray of bool
        ``(ny, nx)``; outside of it the images become zero.
    saturation : float or None
        In the images' unit.
    """
    images = np.where(aperture, images, 0.0)
    if saturation is None:
        return images
    columns = (np.percentile(images, 97, axis=0) > saturation).any(axis=0)
    if columns.any():
        sums = images[:, :, columns].sum(axis=1)
        rows = np.arange(images.shape[1])
        centre_of_light = images[:, :, columns].sum(axis=2) @ rows / sums.sum(axis=1)
        low = (rows - 0.5 - centre_of_light[:, None]) / _DRAWN_WIDTH
        profile = ndtr(low + 1 / _DRAWN_WIDTH) - ndtr(low)
        images[:, :, columns] = profile[:, :, None] * sums[:, None, :]
    return images


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
    images = without_saturation(pixels.flux[usable], pixels.aperture, options.saturation)
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
        parts["segments"] = _by_segment(first, pixels.time[usable], options.breaks, use)
    for name, columns in options.extra.items():
        parts[name] = _completed(columns[usable], use, noise)
    return Regressors.join(parts)


def _by_segment(columns, time, breaks, use):
    """Copies of the columns that differ from zero in one segment each."""
    segment = np.searchsorted(np.asarray(breaks), time, side="right")
    present = np.unique(segment[use])
    copies = [np.where((segment == s)[:, None], columns, 0.0) for s in present]
    return np.concatenate(copies, axis=1)


def _completed(columns, use, noise):
    """Principal components of columns that may have gaps; a gap is filled with the mean."""
    known = np.isfinite(columns).all(axis=1)
    fit = use & known
    if not fit.any():
        return np.empty((len(columns), 0))
    centred = np.where(known[:, None], columns - columns[fit].mean(axis=0), 0.0)
    return principal_columns(centred, fit, _TOLERANCE * noise)
