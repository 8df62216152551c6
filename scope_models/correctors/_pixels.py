"""The pixels of a target pixel file, as arrays that can be trusted."""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from scope_models.exceptions import DetrendingWarning

__all__ = ["Pixels", "aperture_pixels", "choose_aperture", "credible_flux"]

#: Share of the star's light that a pixel must hold to belong to the default aperture.
_SMALLEST_SHARE = 1e-3
#: ... in this part of the cadences, and in so many at least: light that a rare excursion carries
#: out of the aperture would be lost
_BRIGHT_PART, _FEWEST = 0.002, 3
#: ... and at least so many standard deviations of its noise, which pure noise passes in
#: less than one of 10^5 cadences.
_SIGNIFICANCE = 4.5
#: A correction that changes the flux by a larger factor than this, against the others, is none.
_LARGEST_CORRECTION = 30.0


@dataclass(frozen=True)
class Pixels:
    """
    Pixels of an aperture and which cadences can be used.

    Parameters
    ----------
    time : ndarray
        Days, ``(n_cadences,)``; NaN where unknown.
    flux, flux_err : ndarray
        Pixel fluxes and their errors in e-/s, ``(n_cadences, ny, nx)``.
    aperture : ndarray of bool
        Pixels that are summed, ``(ny, nx)``.
    total, total_err : ndarray
        Sum over the aperture and its error, ``(n_cadences,)``.
    usable : ndarray of bool
        Cadences with finite time, finite pixels and a positive sum.
    """

    time: np.ndarray
    flux: np.ndarray
    flux_err: np.ndarray
    aperture: np.ndarray
    total: np.ndarray
    total_err: np.ndarray
    usable: np.ndarray


def choose_aperture(flux, flux_err, pipeline=None):
    """
    Choose the pixels that the star lights up, wherever it moves.

    Pixel level decorrelation weighs pixels by their light, so that a large aperture costs
    little, whereas light that leaves a small one with the star's motion cannot be known.

    Parameters
    ----------
    flux, flux_err : ndarray
        ``(n_cadences, ny, nx)``.
    pipeline : ndarray of bool, optional
        Pixels in which the target is searched.
    """
    if len(flux) < _FEWEST:
        raise ValueError(f"`tpf` has {len(flux)} cadences: at least {_FEWEST} are needed")
    finite = np.isfinite(flux).all(axis=(1, 2))
    if finite.sum() < 3:
        seen = np.isfinite(flux).mean(axis=0) > 0.5
        finite = np.isfinite(flux[:, seen]).all(axis=1) if seen.any() else finite
        if finite.sum() < 3:
            raise ValueError("`tpf` has no pixels with data: no aperture can be chosen")
    values = np.where(np.isfinite(flux[finite]), flux[finite], 0.0)
    count = max(_FEWEST, round(_BRIGHT_PART * len(values)))
    bright = np.partition(values, len(values) - count, axis=0)[-count]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # pixels without errors
        noise = np.nan_to_num(np.nanmedian(flux_err[finite], axis=0))
    mean = np.median(values, axis=0)
    light = np.median(np.where(mean > _SIGNIFICANCE * noise / 3, values, 0).sum(axis=(1, 2)))
    lit = bright > np.maximum(_SIGNIFICANCE * noise, _SMALLEST_SHARE * light)
    labels, _ = ndimage.label(lit)
    near = np.ones_like(lit) if pipeline is None or not pipeline.any() else pipeline
    if not (lit & near).any():
        near = np.ones_like(lit)
    if not (lit & near).any():
        raise ValueError("no pixel of `tpf` is above its noise: no aperture can be chosen")
    peak = np.argmax(np.where(lit & near, mean, -np.inf))
    return labels == labels.flat[peak]


def aperture_pixels(series, aperture):
    """
    Return the pixels of an aperture of a target pixel file.

    Parameters
    ----------
    series : PixelSeries
        The pixels.
    aperture : ndarray of bool or None
        Pixels to sum; None: chosen.

    Raises
    ------
    TypeError, ValueError
        If the aperture is no mask of pixels with data, or the sums are not positive.
    """
    time, flux, flux_err = series.time, series.flux, series.flux_err
    if aperture is None:
        aperture = choose_aperture(flux, flux_err, series.aperture)
    else:
        aperture = _checked_aperture(aperture, flux)
    inside = flux[:, aperture]
    finite = np.isfinite(time) & np.isfinite(inside).all(axis=1)
    with np.errstate(invalid="ignore"):
        total = inside.sum(axis=1)
        total_err = np.sqrt(np.sum(flux_err[:, aperture] ** 2, axis=1))
    positive = finite & (np.nan_to_num(total) > 0)
    if positive.sum() <= finite.sum() / 2:
        raise ValueError("the sum over `aperture_mask` must be positive in most cadences")
    if positive.sum() < finite.sum():
        _warn(f"{finite.sum() - positive.sum()} cadences without a positive flux are left out")
    total_err = _filled_errors(total, total_err, positive)
    return Pixels(time, flux, flux_err, aperture, total, total_err, positive)


def _checked_aperture(aperture, flux):
    aperture = np.asarray(aperture)
    if aperture.dtype != bool:
        raise TypeError(f"`aperture_mask` must be boolean, got {aperture.dtype}")
    if aperture.shape != flux.shape[1:]:
        raise ValueError(f"`aperture_mask` must have shape {flux.shape[1:]}, got {aperture.shape}")
    if not aperture.any():
        raise ValueError("`aperture_mask` must hold at least one pixel, got none")
    empty = aperture & ~np.isfinite(flux).any(axis=0)
    if (empty == aperture).all():
        raise ValueError("`aperture_mask` holds only pixels without data (NaN)")
    if empty.any():
        _warn(f"{empty.sum()} pixels of `aperture_mask` without data (NaN) are left out")
    return aperture & ~empty


def _filled_errors(total, total_err, usable):
    """Replace errors that are zero or not finite."""
    good = usable & np.isfinite(total_err) & (total_err > 0)
    bad = usable & ~good
    if not bad.any():
        return total_err
    if good.any():
        value = np.median(total_err[good])
        _warn(f"{bad.sum()} cadences without a valid FLUX_ERR get the median error of the others")
    else:
        second = np.diff(total[usable], 2)
        value = 1.4826 * np.median(np.abs(second)) / np.sqrt(6)
        value = max(value, 1e-6 * np.median(total[usable]))
        _warn("FLUX_ERR has no valid values: the noise is taken from the scatter of the flux")
    return np.where(good, total_err, value)


def credible_flux(flux, flux_err, total, outliers):
    """
    Return a corrected flux that is finite or NaN, and its errors.

    Where the light in the aperture is nearly nothing, pixel fractions are large, and a model of
    them can be anything.

    Parameters
    ----------
    flux, flux_err : ndarray
        Corrected flux and its error, ``(n_cadences,)``.
    total : ndarray
        The flux before, NaN where it cannot be used.
    outliers : ndarray of bool
        Cadences that were left out of the fit as outliers.
    """
    usable = np.isfinite(total)
    with np.errstate(all="ignore"):
        ratio = np.asarray(flux) / total
        good = usable & np.isfinite(ratio) & (ratio > 0) & np.isfinite(flux_err)
        if good.any():
            good &= np.abs(np.log(ratio / np.median(ratio[good]))) < np.log(_LARGEST_CORRECTION)
    if lost := int(usable.sum() - good.sum()):
        _warn(f"{lost} of {usable.sum()} cadences are NaN: their correction is no number, or large")
    if outliers.sum() > usable.sum() / 2:
        _warn(f"{outliers.sum()} of {usable.sum()} cadences were left out of the fit as outliers")
    return np.where(good, flux, np.nan), np.where(good, flux_err, np.nan)


def _warn(message):
    warnings.warn(message, DetrendingWarning, stacklevel=5)
