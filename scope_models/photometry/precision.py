"""Combined differential photometric precision (CDPP), in the two conventions in use."""

import astropy.units as u
import numpy as np
from astropy.stats import mad_std, sigma_clip
from astropy.time import Time
from scipy.interpolate import interp1d
from scipy.signal import savgol_filter

from scope_models._arrays import plain_array
from scope_models._checks import checked_choice, checked_integer, checked_number
from scope_models.missions import MISSIONS

__all__ = ["cdpp"]

#: Kepler and K2 long cadence (header keyword TIMEDEL), the default cadence of a bare array.
LONG_CADENCE = MISSIONS["Kepler"].cadence_days("long") * u.day

#: Length of the Savitzky-Golay filter of each convention, in long cadences.
_FILTER_CADENCES = {"lightkurve": 101, "everest": 49}
_FILTER_ORDER = 2
_SMOOTH = 50


def cdpp(lc_or_flux, duration=6.5, method="lightkurve", *, cadence=None, filter_window=None):
    r"""Estimate the noise on the time scale of a transit.

    Two conventions are in use and differ by up to an order of magnitude on
    pointing systematics, so compare like with like:

    ``"lightkurve"``
        `lightkurve.LightCurve.estimate_cdpp`: the flux is divided by an iteratively 3-sigma clipped
        Savitzky-Golay trend (order 2, 101 cadences; gaps longer than 5 cadences split it), clipped
        at 5 sigma, and the result is the standard deviation of its running mean. Same number as
        lightkurve.
    ``"everest"``
        The EVEREST catalogs: a Savitzky-Golay trend (order 2, 49 cadences) is subtracted, points
        farther than 5 (scaled) median absolute deviations from a 50-cadence smooth are dropped, and
        the result is the median, over all running windows of :math:`n` cadences, of the window's
        standard deviation divided by :math:`\sqrt{n}`.

    White noise of 100 ppm per long cadence has a 6.5-hour CDPP of nominally
    :math:`100 / \sqrt{13} = 27.7` ppm; the first convention gives 23.1 (the filter removes some),
    the second 25.7 (the standard deviation of 13 points is biased, and some is removed too).

    Parameters
    ----------
    lc_or_flux : `~lightkurve.LightCurve`, `~astropy.units.Quantity` or array_like
        A light curve (anything with ``time`` and ``flux``), or fluxes of
        shape ``(n_cadences,)`` or ``(n_series, n_cadences)`` in any unit.
        Cadences with a flux or time that is not finite are left out.
    duration : float or `~astropy.units.Quantity`, optional
        Time scale in hours; rounded to a whole number of cadences.
    method : {"lightkurve", "everest"}, optional
        The convention.
    cadence : float or `~astropy.units.Quantity`, optional
        Time between cadences in days. By default the median of the light
        curve's time steps; for arrays the Kepler long cadence, 0.0204336 d.
    filter_window : int, optional
        Length of the Savitzky-Golay filter in cadences, odd. By default the
        time spanned by 101 ("lightkurve") or 49 ("everest") long cadences.

    Returns
    -------
    float or `~numpy.ndarray`
        CDPP in parts per million; an array of shape ``(n_series,)`` for two-dimensional input.

    Raises
    ------
    ValueError
        If an argument is outside its domain, fewer finite cadences than two
        durations are left, or the median flux is not positive.

    References
    ----------
    Gilliland et al. 2011, ApJS 197, 6; Luger et al. 2016, AJ 152, 100.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.photometry import cdpp
    >>> flux = np.random.default_rng(1).normal(1, 100e-6, size=(50, 3000))
    >>> print(f"{np.mean(cdpp(flux)):.0f} {np.mean(cdpp(flux, method='everest')):.0f}")
    23 26
    """
    checked_choice("method", method, _FILTER_CADENCES)
    time, flux, days = _series(lc_or_flux, cadence)
    hours = checked_number("duration", duration, u.hour, positive=True)
    width = round(hours / 24 / days)
    if width < 1:
        raise ValueError(f"`duration` must be at least half a cadence, got {duration}")
    if filter_window is None:
        length = _FILTER_CADENCES[method] * LONG_CADENCE.to_value(u.day) / days
        filter_window = max(2 * int(length // 2) + 1, _FILTER_ORDER + 1)
    elif checked_integer("filter_window", filter_window, _FILTER_ORDER + 1) % 2 != 1:
        raise ValueError(f"`filter_window` must be odd and at least 3, got {filter_window}")
    estimator = _lightkurve_cdpp if method == "lightkurve" else _everest_cdpp
    result = [_estimate(estimator, time, f, width, filter_window) for f in np.atleast_2d(flux)]
    return result[0] if flux.ndim == 1 else np.array(result)


def noise_of(lc_or_flux, method="lightkurve"):
    """Return the CDPP of a light curve, NaN if it is too short."""
    try:
        return cdpp(lc_or_flux, method=method)
    except ValueError:
        return np.nan


def _series(lc_or_flux, cadence):
    """Return times, fluxes and the time between cadences as plain floats, masked values as NaN."""
    if hasattr(lc_or_flux, "flux") and hasattr(lc_or_flux, "time"):
        time = lc_or_flux.time
        time = plain_array(time.value if isinstance(time, Time) else time, u.day, "time")
        flux = plain_array(lc_or_flux.flux, None, "flux")
    else:
        time, flux = None, plain_array(lc_or_flux, None, "lc_or_flux")
        cadence = LONG_CADENCE if cadence is None else cadence
    if flux.ndim not in (1, 2):
        raise ValueError(f"`lc_or_flux` must have one or two dimensions, got shape {flux.shape}")
    if cadence is None:
        steps = np.diff(time[np.isfinite(time)])
        if not (len(steps) and np.median(steps) > 0):
            raise ValueError("`cadence` cannot be derived from the times, which must increase")
        cadence = np.median(steps)
    days = checked_number("cadence", cadence, u.day, positive=True)
    return np.arange(flux.shape[-1]) * days if time is None else time, flux, days


def _estimate(estimator, time, flux, width, filter_window):
    good = np.isfinite(flux) & np.isfinite(time)
    if good.sum() < 2 * width:
        wanted = f"at least {2 * width} finite cadences"
        raise ValueError(f"`lc_or_flux` must have {wanted}, got {good.sum()}")
    median = np.median(flux[good])
    if not median > 0:
        raise ValueError(f"the median of `lc_or_flux` must be positive, got {median}")
    return float(1e6 * estimator(time[good], flux[good] / median, width, filter_window))


def _lightkurve_cdpp(time, flux, width, filter_window):
    flat = flux / _clipped_trend(time, flux, filter_window)
    flat = sigma_clip(flat, sigma=5.0, maxiters=5, masked=False)
    total = np.cumsum(np.insert(flat / np.median(flat) - 1, 0, 0.0))
    return np.std(total[width:] - total[:-width]) / width


def _clipped_trend(time, flux, filter_window, sigma=3.0, iterations=3, longest_gap=5):
    """Savitzky-Golay trend through the points that are not outliers from it."""
    kept = np.flatnonzero(np.abs(flux - np.median(flux)) <= sigma * np.std(flux))
    for _ in range(iterations):
        t, f = time[kept], flux[kept]
        steps = np.diff(t)
        cuts = np.flatnonzero(steps > longest_gap * np.median(steps)) + 1
        smooth = np.empty_like(f)
        for part in np.split(np.arange(len(t)), cuts):
            if len(part) < max(filter_window, longest_gap):
                smooth[part] = np.median(f[part])
            else:
                smooth[part] = savgol_filter(f[part], filter_window, _FILTER_ORDER)
        near = np.abs(f - smooth) < sigma * np.std(f - smooth) + 1e-14
        kept, smooth = kept[near], smooth[near]
    return interp1d(time[kept], smooth, fill_value="extrapolate", assume_sorted=True)(time)


def _everest_cdpp(_time, flux, width, filter_window):
    if len(flux) >= filter_window:
        flux = flux - savgol_filter(flux, filter_window, _FILTER_ORDER)
    residual = flux
    if len(flux) >= _SMOOTH:  # with a Hann window, the series continued by point reflection
        window = np.hanning(_SMOOTH)
        padded = np.pad(flux, _SMOOTH, mode="reflect", reflect_type="odd")
        smooth = np.convolve(padded, window / window.sum(), mode="same")
        residual = flux - smooth[_SMOOTH:-_SMOOTH]
    flux = flux[np.abs(residual - np.median(residual)) <= 5 * mad_std(residual)]
    if len(flux) < width:
        raise ValueError("`lc_or_flux` has too few cadences left after clipping")
    windows = np.lib.stride_tricks.sliding_window_view(flux, width)
    return np.median(np.std(windows, axis=1)) / np.sqrt(width)
