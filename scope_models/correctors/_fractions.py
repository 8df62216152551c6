"""Pixel fractions of the star's light that are predicted by the model of its pixels."""

import warnings
from dataclasses import replace

import numpy as np

from scope_models.correctors._saturation import find_row_centers, rows_of_star, without_saturation
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._star import fit_star

__all__ = ["can_predict", "with_predicted_fractions"]

#: Branch: as many pixels as a cadence has unknowns show none of them: brightness, place, width and
#: background.
_STATES = 5


def can_predict(pixels, saturation, use):
    """Whether the pixel fractions can be predicted, learned from the cadences in ``use``.

    Not with few pixels, of which full columns, at ``saturation``, e-/s, are one each, without
    FLUX_ERR, nor for a moving aperture over full columns.
    """
    flux, error = pixels.flux[use][:, pixels.aperture], pixels.flux_err[use]
    full = pixels.full_columns(use, saturation)
    seen = _seen(pixels)
    n_pixels = (seen & full).any(axis=0).sum() + (seen & ~full).sum()
    if n_pixels <= _STATES or (pixels.weights is not None and full.any()):
        return False
    return np.ptp(flux, axis=0).max() > 0 and bool((error > 0).any())


def _seen(pixels):
    """Return the pixels with data that may show the star."""
    seen = np.zeros_like(pixels.aperture)
    seen[pixels.near] = True
    return seen & np.isfinite(pixels.flux[pixels.usable]).all(axis=0)


def with_predicted_fractions(pixels, pos_corr, cadence_mask=None, saturation=None):
    """Return the star's light with predicted pixel fractions in place of the measured pixels.

    Images are learned from the cadences of ``cadence_mask``, by default all. The ``total`` of the
    returned pixels is the light without background, their ``flux`` the predicted fractions at
    constant focus times this. Second comes the `StarModel`; None, with the pixels as they were, if
    it is singular or not one of light, or if there are too few cadences.
    """
    use = pixels.usable.copy()
    learned = use if cadence_mask is None else use & cadence_mask
    full = pixels.full_columns(learned, saturation)
    own = ~full if pixels.own is None else pixels.own & ~full  # others do not vary with this one
    known = _seen(pixels) & (pixels.aperture | own)
    rows, columns = np.nonzero(known)
    if pos_corr is None:
        pos_corr = np.full((len(use), 2), np.nan)
    error = pixels.flux_err[use][:, known]
    error = np.where(error > 0, error, np.nan)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # pixels without errors
        typical = np.nanmedian(error, axis=0)
    typical[np.isnan(typical)] = np.nanmedian(typical)
    error = np.where(np.isnan(error), typical, error)
    try:
        with np.errstate(all="ignore"):  # of a model that fails
            clean = fit_star(
                pixels.time[use],
                pixels.flux[use][:, known],
                error,
                pos_corr[use],
                np.stack([columns, rows], axis=1),
                pixels.aperture[known],
                use=pixels.quiet(learned)[use],
                banded=pixels.banded[use],
                full=full[columns],
            )
    except (np.linalg.LinAlgError, ValueError):  # singular, or no number
        clean = None
    if clean is None or not np.median(clean.light[learned[use]]) > 0:  # or no number
        message = (
            "the model of the pixels fails, or the star has too many places for so few cadences: "
            "measured fractions are taken"
        )
        warnings.warn(message, DetrendingWarning, stacklevel=4)
        return pixels, None
    light, light_error = clean.light, clean.light_error
    if pixels.weights is not None:
        light, light_error = _light_in_window(pixels, clean, use, known)
    flux = np.zeros_like(pixels.flux)
    cube = np.zeros((use.sum(), *known.shape))
    cube[:, known] = clean.still * light[:, None]
    if full.any():
        inside, learned = pixels.aperture & known, learned[use]
        centers = find_row_centers(np.nan_to_num(pixels.flux[use]), inside, learned, saturation)
        varies = clean.position, clean.variable, learned
        cube = without_saturation(cube, full, rows_of_star(centers, *varies), inside)
        if pixels.neighbors is not None:  # what is left of their light follows the star
            weighted = rows_of_star(clean.weighted[:, None], *varies)[:, 0]
            clean = replace(clean, misfit=rows_of_star(clean.misfit, *varies), weighted=weighted)
    flux[use] = cube
    total, total_err = np.full((2, len(use)), np.nan)
    total[use], total_err[use] = light, light_error
    usable = use & (np.nan_to_num(total) > 0)
    changes = {"flux": flux, "total": total, "total_err": total_err, "usable": usable}
    return replace(pixels, **changes), clean


def _light_in_window(pixels, clean, use, known):
    """Return the star's light from the part that a moving aperture holds, and its error."""
    weights = pixels.weights[use][:, known] * pixels.aperture[known]
    held = np.sum(weights * clean.shares, axis=1)
    measured = pixels.flux[use][:, known] - clean.background
    predicted = clean.shares * clean.light[:, None]
    light = np.sum(weights * np.where(clean.repaired, predicted, measured), axis=1) / held
    variance = np.sum((weights * pixels.flux_err[use][:, known]) ** 2, axis=1)
    return light, np.sqrt(variance) / held
