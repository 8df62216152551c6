"""The roll of K2 about its boresight, and the pointing of its last campaigns.

Angles are in arcseconds and times in hours, measured from the beginning of the first cadence.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL
from scope_models._checks import check_fields, number
from scope_models._values import Value
from scope_models.missions import MISSIONS
from scope_models.scene._pointing import (
    ARCSEC_PER_RADIAN,
    DAYS_PER_YEAR,
    SPEED_OF_LIGHT,
    Pointing,
    correlated,
    due,
)

__all__ = ["K2Campaign18", "K2FinalCampaign", "K2Roll", "cadence_means"]

# Length of a firing in hours: about 7 % of all extend over two long cadences.
_FIRING = 2 / 60
# Noise that is older than this many correlation times is forgotten (exp(-20) = 2e-9).
_MEMORY = 20


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

    field: tuple = number((-4.59, 1.35), u.deg)
    solar_rate: float = number(3.0, u.arcsec / u.hour, any_sign=True)
    reversal: float = number(9.4, u.day, any_sign=True)
    reversal_interval: float = number(35.0, u.day, positive=True)
    rate_growth: float = number(0.028, u.hour**-1)
    rate_scatter: float = number(0.15)
    reset_interval: float = number(5.885, u.hour, positive=True)
    reset_jitter: float = number(0.12, u.hour)
    deadband: float = number(12.0, u.arcsec)
    reset_scatter: float = number(8.0, u.arcsec)
    roll_jitter: float = number(0.33, u.arcsec)
    roll_jitter_time: float = number(1.5, u.hour)
    pointing_jitter: float = number(0.0036, u.arcsec)
    orbital_speed: float = number(29.8, u.km / u.s, any_sign=True)
    campaign: float = number(80.0, u.day, positive=True)
    pixel_scale: float = number(3.98, u.arcsec, positive=True, equivalencies=PER_PIXEL)

    # Length of a long cadence in days, with the digits of TIMEDEL in headers. Not a parameter: the
    # jitters are measured at this cadence.
    cadence: ClassVar[float] = round(MISSIONS["K2"].cadence_days("long"), 14)

    def __post_init__(self):
        pair = self.field
        if not isinstance(pair, tuple | list | np.ndarray) or len(pair) != 2:
            raise TypeError(f"`field` must be a pair of numbers in degrees, got {pair!r}")
        check_fields(self)

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
        noise = _red_noise(streams("roll"), n_cadences, self.roll_jitter_time / hours)
        angle = (roll + self.roll_jitter * noise) / ARCSEC_PER_RADIAN
        arm_x, arm_y = (3600 * degrees / self.pixel_scale for degrees in self.field)
        middle = (edges[:-1] + hours / 2) / 24
        # The field is larger by (v/c) cos(angle from the direction opposite to the velocity), which
        # goes through zero in the middle of a campaign; less its mean over the campaign.
        angle_to_motion = 2 * math.pi / DAYS_PER_YEAR * (middle - self.campaign / 2)
        stretch = np.cos(angle_to_motion) - np.sinc(self.campaign / DAYS_PER_YEAR)
        stretch *= self.orbital_speed / SPEED_OF_LIGHT
        residual = streams("pointing").standard_normal((n_cadences, 2))
        residual *= self.pointing_jitter / self.pixel_scale
        x = stretch * arm_x - angle * arm_y + residual[:, 0]
        y = stretch * arm_y + angle * arm_x + residual[:, 1]
        firing = np.zeros(n_cadences, dtype=bool)
        for moment in (fired, fired + _FIRING):
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
        frequency = math.pi / (24 * self.reversal_interval)
        phase = frequency * (24 * self.reversal - times)
        state, fired = self._fire_thrusters(
            times,
            self.solar_rate * np.sin(phase),
            -self.solar_rate * frequency * np.cos(phase),
            self.reset_scatter * deviates[:, 1],
            1 + self.rate_scatter * deviates[:, 2],
        )
        return cadence_means(times, state, edges), times[fired]

    def _fire_thrusters(self, times, rate, acceleration, offsets, factors):
        """Let the roll drift from a reset on, and reset it where it has left the deadband.

        Angle, rate and acceleration from each occasion on, ``(n, 3)``, and where thrusters fired.
        """
        state = np.empty((len(times), 3))
        fired = np.zeros(len(times), dtype=bool)
        angle, last = offsets[0], 0
        for i, time in enumerate(times):
            if abs(angle) > self.deadband and i > 0:
                fired[i], angle, last = True, offsets[i], i
            grown = 1 + self.rate_growth * (time - times[last])
            omega = factors[last] * rate[i] * grown
            alpha = factors[last] * (acceleration[i] * grown + self.rate_growth * rate[i])
            state[i] = angle, omega, alpha
            if i + 1 < len(times):
                step = times[i + 1] - time
                angle += omega * step + alpha * step**2 / 2
        return state, fired


def cadence_means(times, state, edges):
    """Return the exact mean over each cadence of an angle that is quadratic in pieces."""

    def integral(piece, tau):
        angle, omega, alpha = state[piece].T
        return tau * (angle + tau * (omega / 2 + tau * alpha / 6))

    complete = integral(np.arange(len(times) - 1), np.diff(times))
    before = np.concatenate([[0.0], np.cumsum(complete)])
    piece = np.searchsorted(times, edges, side="right") - 1
    return np.diff(before[piece] + integral(piece, edges - times[piece])) / np.diff(edges)


def _red_noise(generator, n, correlation):
    """Return normal noise of unit variance that forgets itself in ``correlation`` samples.

    A longer series begins like a shorter one.
    """
    length = math.ceil(_MEMORY * correlation)
    white = generator.standard_normal(n + length)
    if length == 0:
        return white
    kernel = np.exp(-np.arange(length + 1) / correlation)
    return np.convolve(white, kernel / np.sqrt(np.sum(kernel**2)), mode="valid")


# Distance of the edge of the field from the boresight, px (arXiv:1512.06162).
_EDGE = 6278.0
# Displacement that the halos of apertures allow for, px (K2 data release notes).
_HALO = 3.0
# Time between momentum dumps, days: 96 long cadences on the file of EPIC 211983544 (campaign 18).
_DUMPS = 1.9616


@dataclass(frozen=True)
class K2Campaign18(Pointing):
    """The pointing of K2 campaign 18: nominal but for one excursion.

    The K2 data release notes describe a pointing "well within the limits of that seen in other
    K2 campaigns" with less than 1.9 px for 2490 long cadences, but for the cadences 162613 to
    162627 with more than 4 px, and the very last one. Both are flagged as of coarse pointing. The
    roll is that of `~scope_models.scene.motion.K2Roll` with the reversals that the star EPIC
    211983544 has.

    Parameters
    ----------
    excursion : float or Quantity
        Displacement of the boresight along a random direction in the flagged cadences, px.
    field : tuple of float or Quantity
        Distance of the star from the boresight along columns and rows, deg; the default is that
        of EPIC 211983544.

    Examples
    --------
    >>> from scope_models.scene.motion import K2Campaign18
    >>> K2Campaign18(excursion=5.0).excursion
    5.0
    """

    #: Number of the first long cadence, and of all.
    cadences: ClassVar[tuple] = (161969, 2490)
    #: Time of the first cadence, BKJD (EPIC 211983544).
    start: ClassVar[float] = 3418.5463

    excursion: float = number(4.5, u.pix)
    field: tuple = number((0.45, 3.16), u.deg)

    def track(self, time, streams):
        """Return where the star goes, and the flagged cadences."""
        roll = K2Roll(field=self.field, reversal=5.8, reversal_interval=37.3, rate_growth=0.027)
        x, y, firing = roll.track(len(time), streams)
        number = self.cadences[0] + np.arange(len(time))
        away = ((number >= 162613) & (number <= 162627)) | (number == 164458)
        direction = 2 * np.pi * streams("direction").random()
        x += self.excursion * np.cos(direction) * away
        y += self.excursion * np.sin(direction) * away
        dumps = due(time, _DUMPS, streams("dumps"))
        return x, y, {"thruster_firing": firing, "coarse_point": away, "desaturation": dumps}


@dataclass(frozen=True)
class K2FinalCampaign(Pointing):
    """The pointing of K2 campaign 19, in which the fuel ran out.

    The K2 data release notes describe 26.4 days (long cadences 167333 to 168623): 8.5 days in
    which the boresight was off target, so that nearly all stars were outside of their pixels; 7
    days of nominal pointing with less than 1.5 px; and 11 days in which "the boresight and roll
    fluctuated erratically", with usable parts up to cadence 168481. The roll of
    `~scope_models.scene.motion.K2Roll` goes on in all of them. How far boresight and roll went is
    not in the notes, and assumed here.

    Cadences are flagged as without fine pointing in the first part and after the last usable one,
    and as of coarse pointing in the first part and where boresight and erratic roll take a star
    at the edge of the field farther than 3 px, for which the apertures of K2 allow.

    Parameters
    ----------
    off_target_time, nominal_time, erratic_length : float or Quantity
        Length of the first and of the second part, and time from then on with fine pointing,
        days; those of the notes' cadence numbers.
    off_target : float or Quantity
        Displacement of the boresight in the first part, px; assumed.
    erratic, erratic_time : float or Quantity
        Standard deviation of the boresight per axis in the last part, px, and its correlation
        time, hours; assumed.
    erratic_roll : float or Quantity
        Standard deviation of the additional roll in the last part, arcsec; assumed.
    field : tuple of float or Quantity
        Distance of the star from the boresight along columns and rows, deg.

    Examples
    --------
    >>> from scope_models.scene.motion import K2FinalCampaign
    >>> K2FinalCampaign(erratic=5.0).erratic
    5.0
    """

    #: Number of the first long cadence, and of all.
    cadences: ClassVar[tuple] = (167333, 1291)
    #: Time of the first cadence, BKJD: 2018-08-30 15:17 UTC (K2 data release notes).
    start: ClassVar[float] = 3528.1377

    off_target_time: float = number(8.375, u.day, positive=True)
    nominal_time: float = number(7.25, u.day, positive=True)
    erratic_length: float = number(7.84, u.day)
    off_target: float = number(6.0, u.pix)
    erratic: float = number(2.0, u.pix)
    erratic_time: float = number(12.0, u.hour, positive=True)
    erratic_roll: float = number(30.0, u.arcsec)
    field: tuple = number((-4.59, 1.35), u.deg)

    def track(self, time, streams):
        """Return where the star goes, and the flagged cadences."""
        roll = K2Roll(field=self.field)
        x, y, firing = roll.track(len(time), streams)
        first = time < self.off_target_time
        nominal_end = self.off_target_time + self.nominal_time
        last = time >= nominal_end
        correlation = self.erratic_time / (24 * K2Roll.cadence)
        angle, dx, dy = (
            size * last * correlated(streams(name), len(time), correlation)
            for name, size in (
                ("erratic roll", self.erratic_roll / ARCSEC_PER_RADIAN),
                ("erratic x", self.erratic),
                ("erratic y", self.erratic),
            )
        )
        direction = 2 * np.pi * streams("direction").random()
        dx += self.off_target * np.cos(direction) * first
        dy += self.off_target * np.sin(direction) * first
        arm_x, arm_y = (3600 * degrees / roll.pixel_scale for degrees in self.field)
        lost = first | (time >= nominal_end + self.erratic_length)
        flags = {
            "thruster_firing": firing,
            "coarse_point": first | (np.hypot(dx, dy) + _EDGE * np.abs(angle) > _HALO),
            "no_fine_point": lost,
            "desaturation": due(time, _DUMPS, streams("dumps")),
        }
        return x + dx - angle * arm_y, y + dy + angle * arm_x, flags
