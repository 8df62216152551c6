"""The roll of K2 about its boresight: pure functions of numbers, arrays and random generators.

Angles are in arcseconds and times in hours, measured from the beginning of the first cadence.
"""

import math
from dataclasses import dataclass, fields
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL
from scope_models._checks import checked_number, checked_pair
from scope_models._values import Value
from scope_models.missions import MISSIONS

__all__ = [
    "K2Roll",
    "aberration_scale",
    "cadence_means",
    "fire_thrusters",
    "red_noise",
    "solar_rate",
]

ARCSEC_PER_RADIAN = 180 * 3600 / math.pi
SPEED_OF_LIGHT = 299792.458  # km/s
DAYS_PER_YEAR = 365.25
# Length of a firing in hours: about 7 % of all extend over two long cadences.
FIRING = 2 / 60
# Noise that is older than this many correlation times is forgotten (exp(-20) = 2e-9).
_MEMORY = 20
_UNITS = {
    "solar_rate": u.arcsec / u.hour,
    "reversal": u.day,
    "reversal_interval": u.day,
    "rate_growth": u.hour**-1,
    "rate_scatter": u.one,
    "reset_interval": u.hour,
    "reset_jitter": u.hour,
    "deadband": u.arcsec,
    "reset_scatter": u.arcsec,
    "roll_jitter": u.arcsec,
    "roll_jitter_time": u.hour,
    "pointing_jitter": u.arcsec,
    "orbital_speed": u.km / u.s,
    "campaign": u.day,
    "pixel_scale": u.arcsec,
}


@dataclass(frozen=True)
class K2Roll(Value):
    r"""The roll of K2 about its boresight, and a star at some distance from that.

    Sunlight rolls the field; about every six hours thrusters put the roll angle :math:`\theta`
    back to about zero if it has left a deadband [1]_. After a reset at :math:`t_k` the rate is

    .. math::

        \dot\theta = R \sin\left(\pi \frac{t_r - t}{T_r}\right)
        (1 + g_k) \left(1 + \kappa (t - t_k)\right),

    and within each six hours the angle is the quadratic in time with this rate and its
    derivative. The sense of roll reverses at :math:`t_r`, and every :math:`T_r` from then on,
    when the Sun crosses the direction of balance. A star at :math:`(X, Y)` from the boresight is
    displaced by :math:`(s X - \theta Y, s Y + \theta X)`, where the stretch by velocity
    aberration, :math:`s = (v / c) \cos(2 \pi (t - T / 2) / \mathrm{yr})` less its mean over a
    campaign of length :math:`T`, is a slow drift. Positions are means over each cadence, so
    that a star is somewhere between the two sides while thrusters fire.

    All parameters but ``rate_scatter`` may be quantities.
    The defaults describe EPIC 205998445 (campaign 3). They are measured on the POS_CORR columns of
    stars in campaigns 3, 4, 5 and 18, where the distance from the boresight times one roll angle
    reproduces every star of a campaign. Momentum dumps every two days are not modeled.

    Parameters
    ----------
    field : tuple of float
        Distance :math:`(X, Y)` of the star from the boresight along columns and rows in degrees.
    solar_rate : float
        Amplitude :math:`R` of the roll rate in arcsec/h, from columns to rows before the first
        reversal (measured: 2.1 to 6.1, in the first weeks of campaign 3: 3.3).
    reversal, reversal_interval : float
        Time :math:`t_r` of the first reversal from the beginning, and the time :math:`T_r` from one
        reversal to the next, in days (measured in campaign 3: 9.3 and 36).
    rate_growth : float
        Relative growth :math:`\kappa` of the rate since the last reset per hour (measured:
        0.027 to 0.046).
    rate_scatter : float
        Standard deviation of :math:`g_k` (measured: 0.13 to 0.19).
    reset_interval, reset_jitter : float
        Time between occasions to fire, 12 long cadences, and its standard deviation in hours.
    deadband : float
        Largest roll angle without a firing in arcsec (measured: 3 to 14).
    reset_scatter : float
        Standard deviation of the roll angle after a firing in arcsec (measured: 7.9 to 8.4).
    roll_jitter, roll_jitter_time : float
        Standard deviation of the residual roll in arcsec, and its correlation time in hours
        (measured: 0.25 to 0.31 arcsec about the quadratics).
    pointing_jitter : float
        Standard deviation of the residual pointing per axis in arcsec (measured: 0.0030 to 0.0044).
    orbital_speed : float
        Speed :math:`v` in km/s; negative where the field lies ahead, 0 for no aberration.
    campaign : float
        Length :math:`T` of a campaign in days.
    pixel_scale : float
        Size of a pixel in arcsec.

    Raises
    ------
    ValueError
        If a number is not finite, or negative where that means nothing, or zero for the pixel
        scale or a time other than the first reversal's and the jitters'.
    TypeError
        If ``field`` is not a pair of numbers, or another parameter is not a number.

    References
    ----------
    .. [1] Howell, S. B. et al. 2014, PASP, 126, 398; Van Cleve, J. E. et al. 2016, PASP, 128,
       075002 (arXiv:1512.06162).

    Examples
    --------
    >>> from scope_models.scene.motion import K2Roll
    >>> K2Roll(solar_rate=3.0).solar_rate
    3.0
    >>> K2Roll(deadband=-1.0)
    Traceback (most recent call last):
    ValueError: `deadband` must not be negative, got -1.0
    """

    field: tuple = (-4.59, 1.35)
    solar_rate: float = 3.0
    reversal: float = 9.4
    reversal_interval: float = 35.0
    rate_growth: float = 0.028
    rate_scatter: float = 0.15
    reset_interval: float = 5.885
    reset_jitter: float = 0.12
    deadband: float = 12.0
    reset_scatter: float = 8.0
    roll_jitter: float = 0.33
    roll_jitter_time: float = 1.5
    pointing_jitter: float = 0.0036
    orbital_speed: float = 29.8
    campaign: float = 80.0
    pixel_scale: float = 3.98

    # Length of a long cadence in days, with the digits of TIMEDEL in headers. Not a parameter: the
    # jitters are measured at this cadence.
    cadence: ClassVar[float] = round(MISSIONS["K2"].cadence_days("long"), 14)

    def __post_init__(self):
        pair = self.field
        if not isinstance(pair, tuple | list | np.ndarray) or len(pair) != 2:
            raise TypeError(f"`field` must be a pair of numbers in degrees, got {pair!r}")
        object.__setattr__(self, "field", checked_pair("field", pair, u.deg))
        for item in fields(self)[1:]:
            name = item.name
            value = checked_number(
                name,
                getattr(self, name),
                _UNITS[name],
                equivalencies=PER_PIXEL if name == "pixel_scale" else (),
                positive=name in {"reversal_interval", "reset_interval", "campaign", "pixel_scale"},
                any_sign=name in {"solar_rate", "reversal", "orbital_speed"},
            )
            object.__setattr__(self, name, value)

    def track(self, n_cadences, streams):
        """Return where the star goes, and when thrusters fire.

        Parameters
        ----------
        n_cadences : int
            Number of cadences.
        streams : callable
            A function of a name that returns a random generator at its beginning.

        Returns
        -------
        x, y : ndarray, shape (n_cadences,)
            Offsets in pixels, each the mean over a cadence.
        firing : ndarray of bool, shape (n_cadences,)
            Cadences with a firing of thrusters.

        Examples
        --------
        >>> from scope_models.scene.motion import K2Roll
        >>> from scope_models.effects.noise import stream
        >>> x, y, firing = K2Roll().track(500, lambda name: stream(1, name))
        >>> len(x)
        500
        """
        hours = 24 * self.cadence
        edges = hours * np.arange(n_cadences + 1)
        roll, fired = self._sawtooth(edges, streams("thrusters"))
        noise = red_noise(streams("roll"), n_cadences, self.roll_jitter_time / hours)
        angle = (roll + self.roll_jitter * noise) / ARCSEC_PER_RADIAN
        arm_x, arm_y = (3600 * degrees / self.pixel_scale for degrees in self.field)
        middle = (edges[:-1] + hours / 2) / 24
        stretch = aberration_scale(middle, self.orbital_speed, self.campaign)
        residual = streams("pointing").standard_normal((n_cadences, 2))
        residual *= self.pointing_jitter / self.pixel_scale
        x = stretch * arm_x - angle * arm_y + residual[:, 0]
        y = stretch * arm_y + angle * arm_x + residual[:, 1]
        firing = np.zeros(n_cadences, dtype=bool)
        for moment in (fired, fired + FIRING):
            index = np.floor(moment / hours).astype(int)
            firing[index[(index >= 0) & (index < n_cadences)]] = True
        return x, y, firing

    def _sawtooth(self, edges, generator):
        """Return the mean roll angle per cadence in arcsec, and the times of firings in hours."""
        interval = self.reset_interval
        first = generator.random() * interval
        # Row after row, so that a longer series begins like a shorter one.
        deviates = generator.standard_normal((3 + int(edges[-1] / interval), 3))
        moved = np.clip(self.reset_jitter * deviates[:, 0], -0.45 * interval, 0.45 * interval)
        times = first + interval * (np.arange(len(deviates)) - 1) + moved
        times[0] = min(times[0], 0.0)
        rate, acceleration = solar_rate(
            times, self.solar_rate, 24 * self.reversal, 24 * self.reversal_interval
        )
        state, fired = fire_thrusters(
            times,
            rate,
            acceleration,
            self.reset_scatter * deviates[:, 1],
            1 + self.rate_scatter * deviates[:, 2],
            deadband=self.deadband,
            growth=self.rate_growth,
        )
        return cadence_means(times, state, edges), times[fired]


def solar_rate(time, rate, reversal, half_period):
    """Return the roll rate that sunlight drives, and its derivative.

    Parameters
    ----------
    time : ndarray
        Times in hours.
    rate : float
        Amplitude of the rate in arcsec/h, positive before the reversal.
    reversal, half_period : float
        Time of the first reversal of the sense, and the time between reversals, in hours.

    Returns
    -------
    ndarray, ndarray
        Rate in arcsec/h, and its derivative in arcsec/h^2.
    """
    frequency = math.pi / half_period
    phase = frequency * (reversal - time)
    return rate * np.sin(phase), -rate * frequency * np.cos(phase)


def fire_thrusters(times, rate, acceleration, offsets, factors, *, deadband, growth):
    r"""Let the roll drift, and reset it at the times when it has left the deadband.

    Between two occasions the angle is :math:`\theta + \omega \tau + \alpha \tau^2 / 2`.

    Parameters
    ----------
    times : ndarray, shape (n,)
        The occasions to fire, increasing, in hours. The roll starts from a reset at the first.
    rate, acceleration : ndarray, shape (n,)
        Rate driven by sunlight and its derivative at these times, in arcsec/h and arcsec/h^2.
    offsets : ndarray, shape (n,)
        Angle after a firing at each of these times, in arcsec.
    factors : ndarray, shape (n,)
        Factor on the rate after a firing at each of these times.
    deadband : float
        The thrusters fire where the angle is larger than this, in arcsec.
    growth : float
        Relative growth of the rate per hour since the last firing.

    Returns
    -------
    ndarray of shape (n, 3), ndarray of shape (n,)
        Angle, rate and acceleration from each of the times on, and where thrusters fired.
    """
    state = np.empty((len(times), 3))
    fired = np.zeros(len(times), dtype=bool)
    angle, last = offsets[0], 0
    for i, time in enumerate(times):
        if abs(angle) > deadband and i > 0:
            fired[i], angle, last = True, offsets[i], i
        grown = 1 + growth * (time - times[last])
        omega = factors[last] * rate[i] * grown
        alpha = factors[last] * (acceleration[i] * grown + growth * rate[i])
        state[i] = angle, omega, alpha
        if i + 1 < len(times):
            step = times[i + 1] - time
            angle += omega * step + alpha * step**2 / 2
    return state, fired


def cadence_means(times, state, edges):
    """Return the mean of a piecewise quadratic angle over each cadence, exactly.

    Parameters
    ----------
    times : ndarray, shape (m,)
        Beginnings of the pieces in hours; the first is at or before the first edge.
    state : ndarray, shape (m, 3)
        Angle, rate and acceleration at the beginning of each piece.
    edges : ndarray, shape (n + 1,)
        Beginnings and ends of the cadences in hours.

    Returns
    -------
    ndarray, shape (n,)
        Mean angle in each cadence in arcsec.
    """

    def integral(piece, tau):
        angle, omega, alpha = state[piece].T
        return tau * (angle + tau * (omega / 2 + tau * alpha / 6))

    complete = integral(np.arange(len(times) - 1), np.diff(times))
    before = np.concatenate([[0.0], np.cumsum(complete)])
    piece = np.searchsorted(times, edges, side="right") - 1
    return np.diff(before[piece] + integral(piece, edges - times[piece])) / np.diff(edges)


def red_noise(generator, n, correlation):
    """Return stationary normal noise of unit variance that forgets itself exponentially.

    Parameters
    ----------
    generator : numpy.random.Generator
        Source of randomness. A longer series begins like a shorter one.
    n : int
        Number of samples.
    correlation : float
        Correlation time in samples; 0 gives white noise.

    Returns
    -------
    ndarray, shape (n,)
        The noise.
    """
    length = math.ceil(_MEMORY * correlation)
    white = generator.standard_normal(n + length)
    if length == 0:
        return white
    kernel = np.exp(-np.arange(length + 1) / correlation)
    return np.convolve(white, kernel / np.sqrt(np.sum(kernel**2)), mode="valid")


def aberration_scale(time, speed, campaign):
    r"""Return the relative stretch of the field by velocity aberration, less its mean.

    A field seen at an angle :math:`\lambda` from the direction opposite to the velocity is larger
    by :math:`(v/c) \cos\lambda`. K2 looks along its orbit in the middle of a campaign, so that
    :math:`\lambda` goes through zero there at the rate of one turn per year.

    Parameters
    ----------
    time : ndarray
        Times in days from the beginning of the campaign.
    speed : float
        Orbital speed in km/s, negative where the field lies ahead.
    campaign : float
        Length of the campaign in days.

    Returns
    -------
    ndarray
        The stretch: a displacement away from the boresight per distance from it.
    """
    turn = 2 * math.pi / DAYS_PER_YEAR
    mean = np.sinc(campaign / DAYS_PER_YEAR)  # of the cosine below over the campaign
    return speed / SPEED_OF_LIGHT * (np.cos(turn * (time - campaign / 2)) - mean)
