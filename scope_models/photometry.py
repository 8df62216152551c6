"""Aperture masks, the fractions of light they hold, and the noise of light curves (CDPP).

Masks are boolean with shape ``(ny, nx)``, as lightkurve takes them; images are in e-/s, or
quantities that convert.
"""

import astropy.units as u
import numpy as np
from astropy.stats import mad_std, sigma_clip
from astropy.time import Time
from scipy.interpolate import interp1d
from scipy.signal import savgol_filter

from scope_models._arrays import PER_PIXEL, plain_array
from scope_models._checks import (
    checked_choice,
    checked_integer,
    checked_mask,
    checked_number,
    checked_shape,
)
from scope_models.missions import MISSIONS

__all__ = [
    "aperture_flux", "cdpp", "circular_aperture", "contamination_aperture", "crowding",
    "flux_fraction", "moving_aperture", "signal_to_noise_aperture", "threshold_aperture",
]  # fmt: skip

_RATE = u.electron / u.s
_NO_WEIGHT = 1e-3
#: Long cadence of Kepler and K2 (TIMEDEL), days.
LONG_CADENCE = MISSIONS["Kepler"].cadence_days("long")
#: Length of the filter of each convention of the CDPP, in long cadences.
_FILTER_CADENCES = {"lightkurve": 101, "everest": 49}
_FILTER_ORDER = 2
_SMOOTH = 50


def threshold_aperture(target, threshold=None):
    """Select the pixels in which the target exceeds a threshold at some cadence.

    This is the paper's aperture: it holds the star wherever the motion takes it.

    Parameters
    ----------
    target : array_like
        Noise-free image ``(ny, nx)`` or cube ``(n_cadences, ny, nx)`` of the target alone, e-/s.
    threshold : float, optional
        Lowest flux per pixel in e-/s; by default 0.1 % of the brightest pixel of the whole cube.

    Returns
    -------
    `~numpy.ndarray`
        Boolean mask ``(ny, nx)``.

    Raises
    ------
    ValueError
        If no pixel exceeds the threshold.

    Examples
    --------
    >>> from scope_models.photometry import threshold_aperture
    >>> threshold_aperture([[0, 3], [50, 100]], threshold=10)
    array([[False, False],
           [ True,  True]])
    """
    brightest = _images(target, "target").max(axis=0)
    if threshold is None:
        threshold = 1e-3 * brightest.max()
    else:
        threshold = checked_number("threshold", threshold, _RATE, positive=True)
    return _not_empty(brightest > threshold, f"no pixel exceeds `threshold` of {threshold:g} e-/s")


def signal_to_noise_aperture(
    target, exposure_time, *, neighbors=None, background=0.0, read_noise=0.0, n_frames=1
):
    """Grow the aperture of the highest signal-to-noise ratio.

    The pixel that raises the ratio of the sum most is added until none does [1]_. The variance of
    a pixel is that of the photons of target, neighbors and background, and of all reads.

    Parameters
    ----------
    target : array_like
        Noise-free image ``(ny, nx)`` or cube ``(n_cadences, ny, nx)`` of the target alone, e-/s;
        a cube is averaged over cadences.
    exposure_time : float
        Exposure of a cadence in seconds.
    neighbors : array_like, optional
        The same of all other stars.
    background : float or array_like, optional
        Background in e-/s per pixel, scalar or ``(ny, nx)``.
    read_noise : float, optional
        Read noise in e- per read.
    n_frames : int, optional
        Number of reads co-added in a cadence.

    Returns
    -------
    `~numpy.ndarray`
        Boolean mask ``(ny, nx)``.

    Raises
    ------
    ValueError
        If an argument is out of its domain or the target has no light.

    References
    ----------
    .. [1] Bryson et al. 2010, Proc. SPIE 7740, 77401D.

    Examples
    --------
    >>> from scope_models.photometry import signal_to_noise_aperture
    >>> signal_to_noise_aperture([[0, 10], [10, 1000]], 100.0, background=1000)
    array([[False, False],
           [False,  True]])
    """
    signal = _images(target, "target").mean(axis=0)
    exposure_time = checked_number("exposure_time", exposure_time, u.s, positive=True)
    read_noise = checked_number("read_noise", read_noise, u.electron)
    background = plain_array(background, _RATE, "background", equivalencies=PER_PIXEL)
    n_frames = checked_integer("n_frames", n_frames, 1)
    if not np.all(background >= 0):
        raise ValueError("`background` must not be negative")
    flux = signal + background
    if neighbors is not None:
        flux = flux + _images(neighbors, "neighbors", signal.shape).mean(axis=0)
    mask = grown_aperture(signal, flux, exposure_time, read_noise, n_frames)
    return _not_empty(mask, "`target` has no light")


def grown_aperture(signal, flux, exposure_time, read_noise, n_frames):
    """Return the mask of `signal_to_noise_aperture` of arrays ``(ny, nx)`` and numbers."""
    variance = flux / exposure_time + n_frames * (read_noise / exposure_time) ** 2
    mask = np.zeros(signal.shape, dtype=bool)
    lit, total, total_variance, best = np.flatnonzero(signal > 0), 0.0, 0.0, 0.0
    signal, variance = signal.ravel()[lit], variance.ravel()[lit]
    for _ in lit:
        ratio = (total + signal) / np.sqrt(total_variance + variance)
        index = ratio.argmax()
        if ratio[index] <= best:
            break
        best = ratio[index]
        mask.flat[lit[index]] = True
        total += signal[index]
        total_variance += variance[index]
        signal[index] = -np.inf
    return mask


def contamination_aperture(target, neighbors, *, min_fraction=0.5, threshold=None):
    """Select the target's pixels that neighbors do not dominate.

    Parameters
    ----------
    target : array_like
        Noise-free image ``(ny, nx)`` or cube ``(n_cadences, ny, nx)`` of the target alone, e-/s.
    neighbors : array_like
        The same of all other stars.
    min_fraction : float, optional
        Lowest share of the target in a pixel's mean starlight, from 0 to 1.
    threshold : float, optional
        As in `threshold_aperture`, applied first.

    Returns
    -------
    `~numpy.ndarray`
        Boolean mask ``(ny, nx)``.

    Raises
    ------
    ValueError
        If neighbors dominate every pixel of the target.

    Examples
    --------
    >>> from scope_models.photometry import contamination_aperture
    >>> contamination_aperture([[20, 100, 20]], [[0, 10, 80]])
    array([[ True,  True, False]])
    """
    light = _images(target, "target").mean(axis=0)
    other = _images(neighbors, "neighbors", light.shape).mean(axis=0)
    min_fraction = checked_number("min_fraction", min_fraction, at_most=1)
    mask = threshold_aperture(target, threshold) & (light >= min_fraction * (light + other))
    return _not_empty(mask, "neighbors dominate every pixel of the target")


def circular_aperture(shape, x_0, y_0, radius, *, min_overlap=0.5):
    """Select the pixels that lie mostly within a circle.

    Parameters
    ----------
    shape : tuple of int
        Shape ``(ny, nx)`` of the mask.
    x_0, y_0, radius : float
        Center (column, row) and radius in pixels.
    min_overlap : float, optional
        Lowest fraction of a pixel's area within the circle, above 0 and at most 1.

    Returns
    -------
    `~numpy.ndarray`
        Boolean mask ``(ny, nx)``.

    Raises
    ------
    ValueError
        If an argument is out of its domain or no pixel is selected.

    Examples
    --------
    >>> from scope_models.photometry import circular_aperture
    >>> circular_aperture((3, 3), 1, 1, 1.2).astype(int)
    array([[0, 1, 0],
           [1, 1, 1],
           [0, 1, 0]])
    """
    from photutils.aperture import CircularAperture  # slow to import

    shape = checked_shape(shape)
    x_0 = checked_number("x_0", x_0, u.pix, any_sign=True)
    y_0 = checked_number("y_0", y_0, u.pix, any_sign=True)
    radius = checked_number("radius", radius, u.pix, positive=True)
    min_overlap = checked_number("min_overlap", min_overlap, positive=True, at_most=1)
    overlap = CircularAperture((x_0, y_0), radius).to_mask(method="exact").to_image(shape)
    if overlap is None:
        overlap = np.zeros(shape)
    where = f"no pixel of {shape} lies within `radius` {radius} of ({x_0}, {y_0})"
    return _not_empty(overlap > min_overlap * (1 - 1e-12), where)


def moving_aperture(shape, x, y, radius, *, edge=0.35):
    r"""Make an aperture that follows a star, with a soft edge.

    The weight of a pixel whose center is at the distance d from the star is

    .. math::

        w = \frac{1}{2} \left[1 - \tanh\frac{d - r}{2 e}\right];

    weights below 0.001 are 0.

    Parameters
    ----------
    shape : tuple of int
        Shape ``(ny, nx)`` of the images.
    x, y : array_like
        Column and row of the star, pixels, ``(n_cadences,)``; where they are NaN, weights are.
    radius : float or array_like
        Radius r in pixels, one or one per cadence: the aperture may grow.
    edge : float, optional
        Scale e of the edge in pixels.

    Returns
    -------
    `~numpy.ndarray`
        Weights between 0 and 1, ``(n_cadences, ny, nx)``.

    Raises
    ------
    TypeError, ValueError
        If an argument is out of its domain.

    Examples
    --------
    >>> from scope_models.photometry import moving_aperture
    >>> moving_aperture((1, 4), [0.0, 2.0], [0.0, 0.0], radius=1.5, edge=0.1).round()
    array([[[1., 1., 0., 0.]],
    <BLANKLINE>
           [[0., 1., 1., 1.]]])
    """
    ny, nx = checked_shape(shape)
    x, y = plain_array(x, u.pix, "x"), plain_array(y, u.pix, "y")
    x, y = np.broadcast_arrays(*np.atleast_1d(x, y))
    edge = checked_number("edge", edge, u.pix, positive=True)
    radius = plain_array(radius, u.pix, "radius")
    if x.ndim != 1 or radius.shape not in ((), x.shape):
        raise ValueError(f"`x`, `y` and `radius` must have one number per cadence, got {x.shape}")
    if not np.all(radius > 0):
        raise ValueError("`radius` must be positive")
    across, along = np.arange(nx) - x[:, None], np.arange(ny) - y[:, None]
    distance = np.hypot(across[:, None, :], along[:, :, None])
    weights = 0.5 * (1 - np.tanh((distance - np.reshape(radius, (-1, 1, 1))) / (2 * edge)))
    return np.where(weights < _NO_WEIGHT, 0.0, weights)


def aperture_flux(flux, aperture, flux_err=None):
    """Sum the pixels of a fixed or moving aperture.

    Parameters
    ----------
    flux : array_like
        Pixels ``(n_cadences, ny, nx)``, e-/s.
    aperture : array_like
        Mask ``(ny, nx)``, or weights ``(n_cadences, ny, nx)`` as of `moving_aperture`.
    flux_err : array_like, optional
        Their errors.

    Returns
    -------
    total : `~numpy.ndarray`
        Sum of the pixels times their weights, ``(n_cadences,)``; NaN where a pixel or weight is.
        Pixels of weight 0 do not count.
    total_err : `~numpy.ndarray`
        Its error; only with `flux_err`.

    Raises
    ------
    ValueError
        If the shapes do not agree.

    Examples
    --------
    >>> from scope_models.photometry import aperture_flux
    >>> aperture_flux([[[1.0, 2.0]], [[3.0, 4.0]]], [[[1.0, 0.5]], [[0.5, 1.0]]])
    array([2. , 5.5])
    """
    flux = plain_array(flux, _RATE, "flux")
    aperture = np.asarray(aperture)
    if flux.ndim != 3:
        raise ValueError(f"`flux` must have the shape (n_cadences, ny, nx), got {flux.shape}")
    if aperture.shape not in (flux.shape, flux.shape[1:]):
        wanted = f"{flux.shape[1:]} or {flux.shape}"
        raise ValueError(f"`aperture` must have shape {wanted}, got {aperture.shape}")

    def weighted(cube):
        if aperture.dtype == bool and aperture.ndim == 2:
            return cube[:, aperture]
        return np.where(aperture == 0, 0.0, aperture * cube).reshape(len(cube), -1)

    with np.errstate(invalid="ignore"):
        total = np.sum(weighted(flux), axis=1)
        if flux_err is None:
            return total
        error = plain_array(flux_err, _RATE, "flux_err")
        if error.shape not in {(), flux.shape}:
            raise ValueError(f"`flux_err` must have shape {flux.shape}, got {error.shape}")
        errors = weighted(np.broadcast_to(error, flux.shape))
        return total, np.sqrt(np.sum(errors**2, axis=1))


def crowding(target, neighbors, aperture):
    """Share of the target in the starlight of an aperture (CROWDSAP).

    Parameters
    ----------
    target : array_like
        Image ``(ny, nx)`` or cube ``(n_cadences, ny, nx)`` of the target alone, e-/s, without
        background.
    neighbors : array_like or None
        The same of all other stars; None if there are none.
    aperture : array_like of bool
        Mask ``(ny, nx)``.

    Returns
    -------
    float
        Target flux over total flux in the aperture, averaged over cadences, by which signals are
        diluted.

    Examples
    --------
    >>> from scope_models.photometry import crowding
    >>> print(crowding([[90, 10]], [[10, 90]], [[True, False]]))
    0.9
    """
    target = _images(target, "target").mean(axis=0)
    aperture = checked_mask("aperture", aperture, target.shape)
    own = target[aperture].sum()
    if not own > 0:
        raise ValueError("`target` has no light in `aperture`")
    if neighbors is None:
        return 1.0
    other = _images(neighbors, "neighbors", target.shape).mean(axis=0)[aperture].sum()
    return float(own / (own + other))


def flux_fraction(target, aperture, total=None):
    """Share of an aperture in the light of the target (FLFRCSAP).

    Parameters
    ----------
    target : array_like
        Image ``(ny, nx)`` or cube ``(n_cadences, ny, nx)`` of the target alone, e-/s, without
        background.
    aperture : array_like of bool
        Mask ``(ny, nx)``.
    total : float or array_like, optional
        Total flux of the target in e-/s, one number or one per cadence; by default what the image
        holds, which misses light beyond its edges.

    Returns
    -------
    float
        Target flux in the aperture over its total flux, averaged over cadences.

    Examples
    --------
    >>> from scope_models.photometry import flux_fraction
    >>> print(flux_fraction([[90, 10]], [[True, False]], total=120))
    0.75
    """
    target = _images(target, "target").mean(axis=0)
    aperture = checked_mask("aperture", aperture, target.shape)
    total = target.sum() if total is None else plain_array(total, _RATE, "total").mean()
    if not total > 0:
        raise ValueError(f"`total` flux of the target must be positive, got {total}")
    return float(target[aperture].sum() / total)


def _images(images, name, shape=None):
    """Return a cube (n, ny, nx) of finite values; pixels without data hold no light."""
    images = plain_array(images, _RATE, name, equivalencies=PER_PIXEL)
    if images.ndim not in (2, 3) or 0 in images.shape:
        wanted = "(ny, nx) or (n_cadences, ny, nx)"
        raise ValueError(f"`{name}` must have shape {wanted}, got {images.shape}")
    if shape is not None and images.shape[-2:] != shape:
        raise ValueError(f"`{name}` must have {shape} pixels, got {images.shape[-2:]}")
    images = images.reshape(-1, *images.shape[-2:])
    return np.where(np.isfinite(images), images, 0.0)


def _not_empty(mask, message):
    if not mask.any():
        raise ValueError(message)
    return mask


def cdpp(lc_or_flux, duration=6.5, method="lightkurve", *, cadence=None, filter_window=None):
    r"""Estimate the noise on the time scale of a transit.

    Two conventions differ by up to an order of magnitude on pointing systematics:

    ``"lightkurve"``
        `lightkurve.LightCurve.estimate_cdpp`: the flux is divided by an iteratively 3-sigma clipped
        Savitzky-Golay trend (order 2, 101 cadences; split at gaps of more than 5), clipped at
        5 sigma; the result is the standard deviation of its running mean.
    ``"everest"``
        The EVEREST catalogs: a Savitzky-Golay trend (order 2, 49 cadences) is subtracted, points
        farther than 5 scaled median absolute deviations from a 50-cadence smooth are dropped; the
        result is the median of the standard deviations of all windows of :math:`n` cadences, over
        :math:`\sqrt{n}`.

    White noise of 100 ppm per long cadence has a nominal 6.5-hour CDPP of
    :math:`100 / \sqrt{13} = 27.7` ppm; the first convention gives 23.1 (the filter removes some),
    the second 25.7 (the standard deviation of 13 points is biased, too).

    Parameters
    ----------
    lc_or_flux : `~lightkurve.LightCurve`, `~astropy.units.Quantity` or array_like
        A light curve (anything with ``time`` and ``flux``), or fluxes ``(n_cadences,)`` or
        ``(n_series, n_cadences)`` in any unit. Cadences without finite flux and time are left out.
    duration : float or `~astropy.units.Quantity`, optional
        Time scale in hours; rounded to a whole number of cadences.
    method : {"lightkurve", "everest"}, optional
        The convention.
    cadence : float or `~astropy.units.Quantity`, optional
        Time between cadences in days. By default the median of the time steps; for arrays the
        Kepler long cadence, 0.0204336 d.
    filter_window : int, optional
        Length of the filter in cadences, odd. By default the time of 101 or 49 long cadences.

    Returns
    -------
    float or `~numpy.ndarray`
        CDPP in parts per million, ``(n_series,)`` for two-dimensional input.

    Raises
    ------
    ValueError
        If an argument is out of its domain, fewer finite cadences than two durations are left, or
        the median flux is not positive.

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
        length = _FILTER_CADENCES[method] * LONG_CADENCE / days
        filter_window = max(2 * int(length // 2) + 1, _FILTER_ORDER + 1)
    elif checked_integer("filter_window", filter_window, _FILTER_ORDER + 1) % 2 != 1:
        raise ValueError(f"`filter_window` must be odd and at least 3, got {filter_window}")
    estimate = _lightkurve_cdpp if method == "lightkurve" else _everest_cdpp
    found = []
    for values in np.atleast_2d(flux):
        good = np.isfinite(values) & np.isfinite(time)
        if good.sum() < 2 * width:
            wanted = f"at least {2 * width} finite cadences"
            raise ValueError(f"`lc_or_flux` must have {wanted}, got {good.sum()}")
        median = np.median(values[good])
        if not median > 0:
            raise ValueError(f"the median of `lc_or_flux` must be positive, got {median}")
        noise = estimate(time[good], values[good] / median, width, filter_window)
        found.append(float(1e6 * noise))
    return found[0] if flux.ndim == 1 else np.array(found)


def noise_of(lc_or_flux, method="lightkurve"):
    """Return the CDPP of a light curve, NaN if it is too short."""
    try:
        return cdpp(lc_or_flux, method=method)
    except ValueError:
        return np.nan


def _series(lc_or_flux, cadence):
    """Return times, fluxes and the time between cadences as floats."""
    time = None
    if hasattr(lc_or_flux, "flux") and hasattr(lc_or_flux, "time"):
        time = lc_or_flux.time
        time = plain_array(time.value if isinstance(time, Time) else time, u.day, "time")
        flux = plain_array(lc_or_flux.flux, None, "flux")
    else:
        flux = plain_array(lc_or_flux, None, "lc_or_flux")
    if flux.ndim not in (1, 2):
        raise ValueError(f"`lc_or_flux` must have one or two dimensions, got shape {flux.shape}")
    if cadence is None and time is None:
        cadence = LONG_CADENCE
    elif cadence is None:
        steps = np.diff(time[np.isfinite(time)])
        if not (len(steps) and np.median(steps) > 0):
            raise ValueError("`cadence` cannot be derived from the times, which must increase")
        cadence = np.median(steps)
    days = checked_number("cadence", cadence, u.day, positive=True)
    return np.arange(flux.shape[-1]) * days if time is None else time, flux, days


def _lightkurve_cdpp(time, flux, width, filter_window):
    flat = flux / _clipped_trend(time, flux, filter_window)
    flat = sigma_clip(flat, sigma=5.0, maxiters=5, masked=False)
    total = np.cumsum(np.insert(flat / np.median(flat) - 1, 0, 0.0))
    return np.std(total[width:] - total[:-width]) / width


def _clipped_trend(time, flux, filter_window):
    """Savitzky-Golay trend through the points that are not outliers from it."""
    kept = np.flatnonzero(np.abs(flux - np.median(flux)) <= 3 * np.std(flux))
    for _ in range(3):
        steps = np.diff(time[kept])
        cuts = np.flatnonzero(steps > 5 * np.median(steps)) + 1
        smooth = np.concatenate([_smooth(f, filter_window) for f in np.split(flux[kept], cuts)])
        residual = flux[kept] - smooth
        near = np.abs(residual) < 3 * np.std(residual) + 1e-14
        kept, smooth = kept[near], smooth[near]
    return interp1d(time[kept], smooth, fill_value="extrapolate", assume_sorted=True)(time)


def _smooth(flux, filter_window):
    if len(flux) < max(filter_window, 5):
        return np.full_like(flux, np.median(flux))
    return savgol_filter(flux, filter_window, _FILTER_ORDER)


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
