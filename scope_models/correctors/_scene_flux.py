"""Flux of a star in a window that follows it, and what its systematics may depend on."""

from dataclasses import dataclass

import numpy as np
from astropy.stats import mad_std
from scipy.ndimage import gaussian_filter1d

from scope_models.photometry import moving_aperture

__all__ = [
    "LIMITS",
    "WindowFlux",
    "clean_background",
    "kernel_columns",
    "make_columns",
    "window_flux",
    "window_weights",
]

#: Width of a window's soft edge (px).
_EDGE = 0.2
#: A pixel has a column of its own if its share of the window's light is above this at some time.
_SMALLEST_SHARE = 2e-4
#: Scales (px) of the smooth functions of position.
_SCALES = {"position": 0.8, "fine position": 0.25}
_MOST_COLUMNS = 90
#: Scale (days) above which changes of the width are slow.
_SLOW_WIDTH = 0.5
#: The response to position changes within so many days: a polynomial of time of these degrees.
_SLOW, _DEGREES = 12.0, (2, 8)
#: Variance of the smooth background over that of a cadence's own.
_SMOOTHED = 0.08
#: Prior standard deviations of the coefficients of each group: least, typical and largest. They are
#: parts of what the scene predicts, errors of the pixels' gains, functions of position in relative
#: flux, and changes of slopes with time per pixel.
LIMITS = {
    "model": (0.0, 0.3, 1.0),
    "pixels": (0.0, 0.004, 0.015),
    "position": (0.0, 3e-4, 0.01),
    "fine position": (0.0, 1e-4, 3e-3),
    "place in pixel": (0.0, 1e-4, 3e-3),
    "width": (0.2, 0.5, 1.0),
    "fast width": (0.2, 0.5, 1.0),
    "width and position": (0.0, 0.1, 0.5),
    "slow position": (0.0, 3e-4, 0.005),
}


@dataclass(frozen=True)
class WindowFlux:
    """
    Flux in a window.

    Parameters
    ----------
    flux, variance : ndarray
        Flux (e-/s) and the variance of its noise, ``(n,)``.
    model : ndarray
        What the scene predicts for a star of unit flux, ``(n,)``.
    shares : ndarray
        Share of each pixel in the predicted light of the window, ``(n, ny, nx)``.
    """

    flux: np.ndarray
    variance: np.ndarray
    model: np.ndarray
    shares: np.ndarray


def window_flux(flux, variance, fit, weights, background, background_variance):
    """
    Sum the star's light with weights.

    Pixels that are left out are replaced by what the scene predicts.

    Parameters
    ----------
    flux, variance : ndarray
        Pixels ``(n, ny, nx)``, e-/s, and variance of their noise.
    fit : SceneFit
        The scene.
    weights : ndarray
        ``(n, ny, nx)``.
    background, background_variance : ndarray
        Background per pixel that is taken off, and its variance, ``(n,)``.
    """
    star = fit.track.flux[:, None, None] * fit.star
    good = np.isfinite(fit.variance) | (fit.full & np.isfinite(variance))
    own = np.where(good, flux - fit.others - background[:, None, None], star)
    total = np.sum(weights * own, axis=(1, 2))
    noise = np.where(good, variance, 0.0)
    variance = np.sum(weights**2 * noise, axis=(1, 2))
    variance += np.sum(weights, axis=(1, 2)) ** 2 * background_variance
    shares = weights * fit.star
    model = np.sum(shares, axis=(1, 2))
    return WindowFlux(total, variance, model, shares / model[:, None, None])


def kernel_columns(points, scale, tolerance=1e-4, largest=_MOST_COLUMNS):
    """
    Return columns whose random combinations are a smooth process of position.

    They are the pivoted Cholesky factor of a squared-exponential covariance of unit variance.

    Parameters
    ----------
    points : ndarray
        ``(n, d)``.
    scale : float
        Length scale.
    tolerance : float
        The columns end when the largest variance that is left is below.
    largest : int
        Largest number of columns.
    """
    n = len(points)
    rest, columns = np.ones(n), []
    while rest.max() > tolerance and len(columns) < largest:
        pivot = int(np.argmax(rest))
        row = np.exp(-0.5 * np.sum((points - points[pivot]) ** 2, axis=1) / scale**2)
        for column in columns:
            row = row - column[pivot] * column
        columns.append(row / np.sqrt(row[pivot]))
        rest = np.maximum(rest - columns[-1] ** 2, 0.0)
    return np.stack(columns, axis=1)


def make_columns(time, track, window, by_width):
    """
    Return groups of columns for the logarithm of the flux.

    Parameters
    ----------
    time : ndarray
        Days.
    track : Track
        Positions and widths.
    window : WindowFlux
        The flux.
    by_width : ndarray
        Predicted derivative of the logarithm of the flux by the width, ``(n,)``.

    Returns
    -------
    dict of str to ndarray
        Columns ``(n, k)`` by group, as in `LIMITS`.
    """
    x, y = track.x - np.median(track.x), track.y - np.median(track.y)
    points = np.stack([x, y], axis=1)
    groups = {"model": np.log(window.model / np.median(window.model))[:, None]}
    shares = window.shares.reshape(len(time), -1)
    groups["pixels"] = shares[:, shares.max(axis=0) > _SMALLEST_SHARE]
    for name, scale in _SCALES.items():
        groups[name] = kernel_columns(points, scale)
    waves = [(1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2)]
    phases = [2 * np.pi * (k * track.x + m * track.y) for k, m in waves]
    groups["place in pixel"] = np.stack([f(p) for p in phases for f in (np.cos, np.sin)], axis=1)
    change = (by_width * (track.width - np.median(track.width)))[:, None]
    # the fast part is noisier: it would attenuate the coefficient of the slow one
    slow = gaussian_filter1d(change, _SLOW_WIDTH / np.median(np.diff(time)), axis=0)
    groups["width"], groups["fast width"] = slow, change - slow
    groups["width and position"] = change * points
    span = time[-1] - time[0]
    degree = int(np.clip(round(span / _SLOW), *_DEGREES))
    slow = np.polynomial.legendre.legvander(2 * (time - time[0]) / span - 1, degree)[:, 1:]
    place = np.stack([x, y, x**2, x * y, y**2], axis=1)
    groups["slow position"] = (slow[:, :, None] * place[:, None, :]).reshape(len(time), -1)
    return groups


def clean_background(background, smooth, spike=6.0):
    """
    Return the background to take off, and the variance of its error.

    Parameters
    ----------
    background, smooth : ndarray
        Background of each cadence, and its smooth course, ``(n,)``.
    spike : float
        Cadences that deviate by more standard deviations keep their own.
    """
    rest = background - smooth
    scatter = float(mad_std(rest))
    own = np.abs(rest - np.median(rest)) > spike * scatter
    return np.where(own, background, smooth), np.where(own, 1.0, _SMOOTHED) * scatter**2


def window_weights(fit, noise, window):
    """
    Return the weights of a window, ``(n, ny, nx)``.

    Parameters
    ----------
    fit : SceneFit
        The scene.
    noise : ndarray
        Typical variance of each pixel, ``(ny, nx)``.
    window : float, "optimal" or ndarray
        Radius in pixels, weights in proportion to light over variance, or an aperture: a mask, or
        weights of each cadence.
    """
    if isinstance(window, np.ndarray):
        return np.broadcast_to(window.astype(float), fit.star.shape)
    if window == "optimal":
        weights = np.clip(fit.star, 0, None) / noise
        return weights / weights.max(axis=(1, 2), keepdims=True)
    track = fit.track
    moving = moving_aperture(fit.star.shape[1:], track.x, track.y, window, edge=_EDGE)
    return np.maximum(moving, fit.full)
