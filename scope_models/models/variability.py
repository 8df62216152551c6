"""Variability of stars: sinusoids, arrays and red noise of a stated CDPP, with mean 1."""

import astropy.units as u
import numpy as np
from astropy.modeling.models import Const1D, Sine1D, Tabular1D
from celerite2 import GaussianProcess, terms
from scipy.signal import savgol_coeffs

from scope_models._arrays import plain_array, plain_number, plain_time
from scope_models._checks import checked_number
from scope_models.missions import MISSIONS

__all__ = ["sinusoidal_signal", "stochastic_signal", "tabulated_signal"]

_PPM = u.Unit(1e-6)


class _OfTime:
    """Mixin of signals: times with a unit become days, and other units are refused."""

    def evaluate(self, x, *parameters):
        return super().evaluate(plain_array(x, u.day, "time"), *parameters)


class SineSignal(_OfTime, Sine1D):
    """A sine of the time in days."""


class TabulatedSignal(_OfTime, Tabular1D):
    """A table of the time in days."""

    @property
    def arguments(self):
        """Arguments that make an equal signal."""
        return {"points": self.points[0], "lookup_table": self.lookup_table}


#: Savitzky-Golay filter of lightkurve's CDPP: span in days (101 Kepler long cadences) and order.
_FILTER_DAYS, _FILTER_ORDER = 101 * MISSIONS["Kepler"].cadence_days("long"), 2


def sinusoidal_signal(amplitude, period, phase=0.0):
    r"""Make a sinusoidal signal, :math:`1 + A \sin 2\pi (t / P + \phi)`.

    Parameters
    ----------
    amplitude : float
        Relative semi-amplitude :math:`A`, between 0 and 1.
    period : float or `~astropy.units.Quantity`
        Period :math:`P` in days.
    phase : float or `~astropy.units.Quantity`, optional
        Phase :math:`\phi` at time 0 in cycles.

    Returns
    -------
    `~astropy.modeling.CompoundModel`
        ``Const1D + Sine1D``, which astropy fits and multiplies.

    Raises
    ------
    ValueError
        If an argument is outside its domain.

    Examples
    --------
    >>> from scope_models.models import sinusoidal_signal
    >>> print(sinusoidal_signal(0.01, period=4)(1.0))
    1.01
    """
    amplitude = plain_number(amplitude, u.one, "amplitude")
    period = checked_number("period", period, u.day, positive=True)
    phase = plain_number(phase, u.cycle, "phase")
    if not 0 <= amplitude < 1:
        raise ValueError(f"`amplitude` must be at least 0 and below 1, got {amplitude}")
    return Const1D(1.0) + SineSignal(amplitude, 1 / period, phase)


def tabulated_signal(time, flux):
    """Make a signal of given values, linear between them.

    Parameters
    ----------
    time : array_like or `~astropy.units.Quantity`
        Times ``(n,)`` in days, increasing.
    flux : array_like or `~astropy.units.Quantity`
        Relative flux ``(n,)`` at these times, not negative.

    Returns
    -------
    `~astropy.modeling.models.Tabular1D`
        The signal. Outside `time` the first and the last value hold.

    Raises
    ------
    ValueError
        If the arrays do not match or hold values outside their domain.

    Examples
    --------
    >>> from scope_models.models import tabulated_signal
    >>> print(tabulated_signal([0, 1, 2], [1, 0.9, 1])([0.5, 1, 5]))
    [0.95 0.9  1.  ]
    """
    time, flux = plain_time(time, None, "time"), plain_array(flux, u.one, "flux")
    _require_times(time)
    if flux.shape != time.shape:
        raise ValueError(f"`flux` must have the shape {time.shape} of `time`, got {flux.shape}")
    if not (np.isfinite(flux).all() and flux.min() >= 0):
        raise ValueError("`flux` must be finite and not negative")
    # one more point on either side, so far away that no time lies beyond it
    points = np.concatenate([[-1e12], time, [1e12]])
    table = np.concatenate([flux[:1], flux, flux[-1:]])
    return TabulatedSignal(points, table, method="linear")


def stochastic_signal(time, cdpp, *, timescale=0.25, quality=0.5**0.5, duration=6.5, seed=None):
    r"""Draw red noise, such as granulation, whose CDPP has a stated expected value.

    The noise is a Gaussian process of a damped, stochastically driven harmonic oscillator
    (celerite2's ``SHOTerm`` [1]_): with the default quality :math:`1/\sqrt{2}` its power is flat at
    low frequency and falls as the fourth power of the frequency, as granulation's does. It is
    scaled so that the root mean square of lightkurve's CDPP is `cdpp`: the variance of its running
    mean after the Savitzky-Golay filter follows from the covariance. The estimator's clipping and
    the edges of the filter raise its mean by up to 3 %.

    Parameters
    ----------
    time : array_like or `~astropy.units.Quantity`
        Times ``(n,)`` in days, increasing, at which it is drawn; linear in
        between, so give times as dense as the noise needs.
    cdpp : float or `~astropy.units.Quantity`
        Expected CDPP in ppm, in lightkurve's convention.
    timescale : float or `~astropy.units.Quantity`, optional
        Period of the oscillator in days.
    quality : float, optional
        Quality factor of the oscillator; well above 1 for quasi-periodic variability.
    duration : float or `~astropy.units.Quantity`, optional
        Time scale of the CDPP in hours.
    seed : int or `~numpy.random.Generator`, optional
        Seed of the draw.

    Returns
    -------
    `~astropy.modeling.models.Tabular1D`
        The signal; a new draw for every seed.

    Raises
    ------
    ValueError
        If an argument is outside its domain.

    References
    ----------
    .. [1] Foreman-Mackey et al. 2017, AJ 154, 220.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import stochastic_signal
    >>> from scope_models.photometry import cdpp
    >>> time = np.arange(4000) * 0.0204336
    >>> print(f"{cdpp(stochastic_signal(time, cdpp=50, seed=1)(time)):.0f}")
    51
    """
    time = plain_time(time, None, "time")
    _require_times(time)
    cdpp = checked_number("cdpp", cdpp, _PPM, positive=True)
    timescale = checked_number("timescale", timescale, u.day, positive=True)
    quality = checked_number("quality", quality, positive=True)
    duration = checked_number("duration", duration, u.hour, positive=True)
    kernel = terms.SHOTerm(sigma=1.0, w0=2 * np.pi / timescale, Q=quality)
    sigma = 1e-6 * cdpp / _unit_cdpp(kernel, np.median(np.diff(time)), duration)
    process = GaussianProcess(kernel)
    process.compute(time, diag=np.full(len(time), 1e-12))
    noise = process.dot_tril(np.random.default_rng(seed).standard_normal(len(time)))
    return tabulated_signal(time, 1 + sigma * noise)


def _unit_cdpp(kernel, cadence, duration):
    """Root mean square of the filtered running mean of a process, by its covariance."""
    width = max(1, round(duration / 24 / cadence))
    length = max(3, 2 * int(_FILTER_DAYS / cadence // 2) + 1)
    high_pass = -savgol_coeffs(length, _FILTER_ORDER)
    high_pass[length // 2] += 1
    weights = np.convolve(high_pass, np.full(width, 1 / width))
    products = np.correlate(weights, weights, mode="full")[len(weights) - 1 :]
    covariance = kernel.get_value(cadence * np.arange(len(weights)))
    return np.sqrt(products[0] * covariance[0] + 2 * products[1:] @ covariance[1:])


def _require_times(time):
    if time.ndim != 1 or len(time) < 2 or not (np.diff(time) > 0).all():
        raise ValueError("`time` must be one-dimensional and increasing, with at least two values")
