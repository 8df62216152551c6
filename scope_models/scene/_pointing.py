"""Pointing of telescopes in space and on the ground, and made-up ones for tests of correctors."""

from dataclasses import asdict, dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models._arrays import PER_PIXEL, TIME_ZEROS, plain_time
from scope_models._checks import check_fields, checked_choice, checked_integer, number
from scope_models._values import Value
from scope_models.effects._noise import correlated, fresh_seed, stream
from scope_models.missions import MISSIONS

__all__ = [
    "FailingWheels", "GroundTracking", "K2Campaign18", "K2FinalCampaign", "K2Roll",
    "KeplerPointing", "Pointing", "RandomWalk", "TESSPointing", "cadence_means", "first_time",
    "generate",
]  # fmt: skip

_ARCSEC_PER_RADIAN = 180 * 3600 / np.pi
_SPEED_OF_LIGHT = 299792.458  # km/s
_DAYS_PER_YEAR = 365.25


@dataclass(frozen=True)
class Pointing(Value):
    """Base of the generators of motions; every parameter may be a quantity."""

    #: Prefix of the names of its random streams; by default the name of the class.
    stream_name: ClassVar[str] = ""

    def __post_init__(self):
        check_fields(self)

    def times(self, n_cadences, cadence):
        """Return the times, days since the beginning, of cadences of a length in days."""
        return cadence * np.arange(n_cadences)

    def track(self, time, streams):
        """Return offsets x and y, px, at times in days, and cadences to flag by names of bits.

        ``streams`` is a function of a name that returns a random generator at its beginning.
        """
        raise NotImplementedError


def first_time(start, time_format):
    checked_choice("time_format", time_format, TIME_ZEROS)
    days = plain_time(start, time_format, "start")
    if days.ndim or not np.isfinite(days):
        raise ValueError(f"`start` must be one finite time, got {start!r}")
    return float(days)


def generate(pointing, n_cadences, days, start, seed, mission, **options):
    """Return the fields of the motion of a pointing, with this time between cadences."""
    name, zero = type(pointing).__name__, mission.time_format
    seed = fresh_seed() if seed is None else checked_integer("seed", seed, 0)
    streams = f"{pointing.stream_name or name} "
    time = pointing.times(checked_integer("n_cadences", n_cadences, 1), days)
    x, y, flags = pointing.track(time, lambda part: stream(seed, streams + part), **options)
    quality = np.zeros(len(time), dtype=np.int32)
    for meaning, cadences in flags.items():
        quality[cadences] |= getattr(mission.quality, meaning)
    meta = {"mission": mission.name, "generator": {"name": name, **asdict(pointing)}, "seed": seed}
    time = first_time(start, zero) + time
    return {"time": time, "x": x, "y": y, "quality": quality, "time_format": zero, "meta": meta}


def _due(time, interval, generator):
    """Return the first cadence at or after each recurrence of an event, in days."""
    number = np.floor((time - time[0] + generator.random() * interval) / interval)
    return np.diff(number, prepend=number[0]) > 0


@dataclass(frozen=True)
class KeplerPointing(Pointing):
    r"""The pointing of Kepler, and a star at some distance from the boresight.

    Velocity aberration stretches the field by :math:`s(t) = (v / c) \cos\beta \cos(2 \pi t /
    \mathrm{yr} + \phi)` at the ecliptic latitude :math:`\beta`: a star at :math:`(X, Y)` drifts by
    :math:`s (X, Y)` less the mean. To this come red noise, the heaters' cycle and white jitter.
    Numbers without another source are measured on POS_CORR of Kepler-62 in quarter 5.

    Parameters
    ----------
    field : tuple of float or Quantity
        Distance from the boresight along columns and rows, deg.
    orbital_speed : float or Quantity
        Speed of the spacecraft, km/s.
    latitude : float or Quantity
        Ecliptic latitude of the field, deg; 65 is that of Kepler's field.
    phase : float or Quantity
        Phase of the orbit at the beginning, deg.
    drift, drift_time : float or Quantity
        Standard deviation of the red noise per axis, px, and its correlation time, days.
    heater, heater_period : float or Quantity
        Amplitude of the heaters' cycle along columns, px, and its period, hours.
    jitter : float or Quantity
        Standard deviation of the white noise of a long cadence per axis, px.
    dump_interval : float or Quantity
        Time between momentum dumps, days (measured: 2.98); their cadences are flagged.

    Examples
    --------
    >>> from scope_models.scene.motion import KeplerPointing
    >>> KeplerPointing(jitter=0.001).jitter
    0.001
    """

    field: tuple = number((2.2, 1.6), u.deg)
    orbital_speed: float = number(29.8, u.km / u.s)
    latitude: float = number(65.0, u.deg, any_sign=True)
    phase: float = number(45.0, u.deg, any_sign=True)
    drift: float = number(0.0013, u.pix)
    drift_time: float = number(6.0, u.day, positive=True)
    heater: float = number(2.5e-5, u.pix)
    heater_period: float = number(5.0, u.hour, positive=True)
    jitter: float = number(0.0002, u.pix)
    dump_interval: float = number(2.98, u.day, positive=True)

    def track(self, time, streams):
        step = time[1] - time[0] if len(time) > 1 else 1.0
        angle = 2 * np.pi * time / _DAYS_PER_YEAR + np.radians(self.phase)
        speed = self.orbital_speed * np.cos(np.radians(self.latitude))
        stretch = speed / _SPEED_OF_LIGHT * (np.cos(angle) - np.cos(angle).mean())
        moved = []
        for axis, degrees in zip("xy", self.field, strict=True):
            slow = correlated(streams(f"drift {axis}"), len(time), self.drift_time / step)
            white = streams(f"jitter {axis}").standard_normal(len(time))
            arm = 3600 * degrees / MISSIONS["Kepler"].pixel_scale
            moved.append(stretch * arm + self.drift * slow + self.jitter * white)
        moved[0] += self.heater * np.sin(2 * np.pi * 24 * time / self.heater_period)
        return (*moved, {"desaturation": _due(time, self.dump_interval, streams("dumps"))})


_REFERENCE = 120 / 86400  # cadence at which the jitter is measured, days


@dataclass(frozen=True)
class TESSPointing(Pointing):
    r"""The pointing of TESS over a sector, and a star at some distance from the boresight.

    Velocity aberration stretches the field by :math:`s(t) = (v / c) \sin(2 \pi (t - t_m) /
    \mathrm{yr})` about the middle :math:`t_m` of the sector. The jitter is :math:`\epsilon_i - b
    \epsilon_{i-1}`, measured on POS_CORR of TIC 273589987 (sector 15, 120 s); it falls with the
    square root of the cadence.

    Parameters
    ----------
    field : tuple of float or Quantity
        Distance from the boresight along columns and rows, deg.
    orbital_speed : float or Quantity
        Speed of the spacecraft, km/s.
    jitter : tuple of float or Quantity
        Standard deviation of the jitter along columns and rows, px, in 120 s.
    blue : float
        The factor b; 0 is white noise.
    drift, drift_time : float or Quantity
        Standard deviation of the red noise per axis, px, and its correlation time, days; assumed.
    dump_interval : float or Quantity
        Time between momentum dumps, days (sector 8, TESS data release notes).
    dump_offset : float or Quantity
        Standard deviation of the offset in the flagged cadence of a dump, px; assumed.
    orbit_time, gap_time : float or Quantity
        Length of the observations of an orbit, and of the gap between orbits, days (sector 1, TESS
        data release notes).

    Examples
    --------
    >>> from scope_models.scene.motion import TESSPointing
    >>> TESSPointing(dump_interval=2.5).dump_interval
    2.5
    """

    field: tuple = number((6.0, 6.0), u.deg)
    orbital_speed: float = number(29.8, u.km / u.s)
    jitter: tuple = number((0.0027, 0.0051), u.pix)
    blue: float = number(0.35)
    drift: float = number(0.002, u.pix)
    drift_time: float = number(1.0, u.day, positive=True)
    dump_interval: float = number(3.125, u.day, positive=True)
    dump_offset: float = number(0.1, u.pix)
    orbit_time: float = number(13.2, u.day, positive=True)
    gap_time: float = number(1.13, u.day, positive=True)

    def times(self, n_cadences, cadence):
        number = np.arange(n_cadences)
        per_orbit = max(1, round(self.orbit_time / cadence))
        return cadence * number + self.gap_time * (number // per_orbit)

    def track(self, time, streams, cadence=_REFERENCE):
        n, middle = len(time), self.orbit_time + self.gap_time / 2
        turn = 2 * np.pi * (time - middle) / _DAYS_PER_YEAR
        stretch = self.orbital_speed / _SPEED_OF_LIGHT * np.sin(turn)
        dumps = _due(time, self.dump_interval, streams("dumps"))
        kicks = self.dump_offset * streams("kicks").standard_normal((n, 2))
        moved = []
        for axis, degrees in enumerate(self.field):
            white = streams(f"jitter {'xy'[axis]}").standard_normal(n + 1)
            shaken = (white[1:] - self.blue * white[:-1]) / np.hypot(1, self.blue)
            shaken *= self.jitter[axis] * np.sqrt(_REFERENCE / cadence)
            slow = correlated(streams(f"drift {'xy'[axis]}"), n, self.drift_time / cadence)
            arm = 3600 * degrees / MISSIONS["TESS"].pixel_scale
            moved.append(stretch * arm + self.drift * slow + shaken + dumps * kicks[:, axis])
        return (*moved, {"desaturation": dumps})


@dataclass(frozen=True)
class GroundTracking(Pointing):
    r"""The tracking of a ground-based telescope in nights.

    Each night the star is put on its place again, and then drifts. Wind and image motion have the
    power spectrum :math:`f^{-5/3}` between the night and two cadences. The image motion has the
    variance :math:`0.18 (\lambda / D)^{1/3} (\lambda / r_0)^{5/3}` per axis [1]_ with :math:`r_0 =
    0.98 \lambda / \mathrm{seeing}`, that of short exposures. Other numbers are assumed.

    Parameters
    ----------
    aperture : float or Quantity
        Diameter D of the telescope, m.
    seeing : float or Quantity
        Full width at half maximum of the seeing, arcsec.
    wavelength : float or Quantity
        Wavelength, nm.
    pixel_scale : float or Quantity
        Size of a pixel, arcsec.
    night : float or Quantity
        Length of a night, hours.
    pointing : float or Quantity
        Standard deviation of the position at the beginning of a night per axis, arcsec.
    drift : float or Quantity
        Standard deviation of the rate of the drift of a night per axis, arcsec/h.
    wind : float or Quantity
        Standard deviation of the shaking by wind per axis, arcsec.

    References
    ----------
    .. [1] Sarazin, M. & Roddier, F. 1990, A&A 227, 294.

    Examples
    --------
    >>> from scope_models.scene.motion import GroundTracking
    >>> round(GroundTracking().image_motion, 3)
    0.305
    """

    aperture: float = number(1.0, u.m, positive=True)
    seeing: float = number(1.0, u.arcsec, positive=True)
    wavelength: float = number(600.0, u.nm, positive=True)
    pixel_scale: float = number(0.4, u.arcsec, positive=True)
    night: float = number(8.0, u.hour, positive=True)
    pointing: float = number(0.5, u.arcsec)
    drift: float = number(0.3, u.arcsec / u.hour)
    wind: float = number(0.1, u.arcsec)

    @property
    def image_motion(self):
        """Standard deviation of the image motion per axis in a short exposure, arcsec."""
        wave = self.wavelength * 1e-9
        arcsec = np.pi / 180 / 3600
        fried = 0.98 * wave / (self.seeing * arcsec)
        variance = 0.18 * (wave / self.aperture) ** (1 / 3) * (wave / fried) ** (5 / 3)
        return float(np.sqrt(variance) / arcsec)

    def times(self, n_cadences, cadence):
        per_night = max(1, int(self.night / 24 / cadence))
        number = np.arange(n_cadences)
        return number // per_night + cadence * (number % per_night)

    def track(self, time, streams):
        night = np.floor(time + 1e-9).astype(int)
        shaking = np.hypot(self.wind, self.image_motion)
        moved = []
        for axis in "xy":
            generator = streams(f"ground {axis}")
            offset = np.empty(len(time))
            for date in np.unique(night):
                here = night == date
                start, rate = generator.standard_normal(2)
                hours = 24 * (time[here] - time[here][0])
                offset[here] = self.pointing * start + self.drift * rate * hours
                offset[here] += shaking * _turbulence(generator, here.sum())
            moved.append(offset / self.pixel_scale)
        return (*moved, {})


def _turbulence(generator, n):
    """Return noise of unit variance with the power spectrum f^(-5/3)."""
    spectrum = np.fft.rfft(generator.standard_normal(n))
    weights = np.append(0.0, np.arange(1.0, len(spectrum)) ** (-5 / 6))
    # Each frequency stands for two, but the highest of an even number.
    power = 2 * np.sum(weights**2) - (weights[-1] ** 2 if n % 2 == 0 else 0.0)
    return np.fft.irfft(spectrum * weights, n) * np.sqrt(n / max(power, 1e-300))


@dataclass(frozen=True)
class RandomWalk(Pointing):
    r"""A random walk of the star, :math:`\langle x^2 \rangle = D^2 t` per axis; made up.

    Parameters
    ----------
    spread : float or Quantity
        Standard deviation per axis after one day D, px.

    Examples
    --------
    >>> from scope_models.scene.motion import RandomWalk
    >>> RandomWalk(spread=0.2).spread
    0.2
    """

    spread: float = number(0.1, u.pix)

    def track(self, time, streams):
        steps = self.spread * np.sqrt(np.diff(time, prepend=time[0]))
        walk = steps[:, np.newaxis] * streams("walk").standard_normal((len(time), 2))
        x, y = np.cumsum(walk, axis=0).T
        return x, y, {}


@dataclass(frozen=True)
class FailingWheels(Pointing):
    """A pointing whose wheels lose their grip: a drift, a walk and jumps that grow; made up.

    Parameters
    ----------
    drift : float or Quantity
        Rate of the drift along a random direction, px/d.
    spread : float or Quantity
        Standard deviation of the walk per axis after one day, px.
    jump : float or Quantity
        Standard deviation of a jump per axis after one day, px; it grows with the square root of
        time.
    jump_interval : float or Quantity
        Mean time between jumps, days, which are flagged as of coarse pointing.

    Examples
    --------
    >>> from scope_models.scene.motion import FailingWheels
    >>> FailingWheels(jump=1.0).jump
    1.0
    """

    drift: float = number(0.02, u.pix / u.day)
    spread: float = number(0.05, u.pix)
    jump: float = number(0.1, u.pix)
    jump_interval: float = number(2.0, u.day, positive=True)

    def track(self, time, streams):
        x, y, _ = RandomWalk(spread=self.spread).track(time, streams)
        drift_x, drift_y = _in_random_direction(self.drift, streams)
        steps = np.diff(time, prepend=time[0])
        jumps = streams("jumps").random(len(time)) < -np.expm1(-steps / self.jump_interval)
        sizes = streams("sizes").standard_normal((len(time), 2))
        sizes *= self.jump * np.sqrt(time)[:, np.newaxis]
        jump_x, jump_y = np.cumsum(np.where(jumps[:, np.newaxis], sizes, 0.0), axis=0).T
        x, y = x + drift_x * time + jump_x, y + drift_y * time + jump_y
        return x, y, {"coarse_point": jumps}


def _in_random_direction(size, streams):
    direction = 2 * np.pi * streams("direction").random()
    return size * np.cos(direction), size * np.sin(direction)


# Length of a firing in hours: about 7 % of all extend over two long cadences.
_FIRING = 2 / 60
# Noise that is older than this many correlation times is forgotten (exp(-20) = 2e-9).
_MEMORY = 20


@dataclass(frozen=True)
class K2Roll(Pointing):
    r"""The roll of K2 about its boresight, and a star at some distance from that.

    Sunlight rolls the field; about every six hours thrusters put the roll angle :math:`\theta`
    back to about zero if it has left a deadband [1]_. After a reset at :math:`t_k` the rate is

    .. math::

        \dot\theta = R \sin\left(\pi \frac{t_r - t}{T_r}\right)
        (1 + g_k) \left(1 + \kappa (t - t_k)\right),

    and within each six hours the angle is the quadratic in time with this rate and its
    derivative; :math:`R` doubles at the second reversal :math:`t_r + T_r`. A star at :math:`(X, Y)`
    from the boresight is displaced by :math:`(s X - \theta Y, s Y + \theta X)`, with the stretch by
    velocity aberration :math:`s = (v / c) \cos(2 \pi (t - T / 2) / \mathrm{yr})` less its mean over
    a campaign of length :math:`T`. Positions are means over each cadence.

    The defaults describe EPIC 205998445 (campaign 3); the page on generated K2 motion has the
    numbers that are measured on POS_CORR of stars in campaigns 3, 4, 5 and 18. Whole campaigns have
    a standard deviation along the roll of 0.063 px per degree from the boresight, six real stars
    0.054 to 0.070. Momentum dumps are not modeled.

    Parameters
    ----------
    field : tuple of float or Quantity
        Distance :math:`(X, Y)` from the boresight along columns and rows, deg.
    solar_rate : float or Quantity
        Amplitude :math:`R` of the roll rate until the second reversal, arcsec/h, from columns to
        rows before the first.
    reversal, reversal_interval : float or Quantity
        Time :math:`t_r` of the first reversal of the roll from the beginning, and :math:`T_r` from
        one to the next, days.
    rate_growth : float or Quantity
        Relative growth :math:`\kappa` of the rate since the last reset per hour.
    rate_scatter : float
        Standard deviation of :math:`g_k`.
    reset_interval, reset_jitter : float or Quantity
        Time between occasions to fire, 12 long cadences, and its standard deviation, hours.
    deadband : float or Quantity
        Largest roll angle without a firing, arcsec.
    reset_scatter : float or Quantity
        Standard deviation of the roll angle after a firing, arcsec.
    roll_jitter, roll_jitter_time : float or Quantity
        Standard deviation of the residual roll, arcsec, and its correlation time, hours.
    pointing_jitter : float or Quantity
        Standard deviation of the residual pointing per axis, arcsec.
    orbital_speed : float or Quantity
        Speed :math:`v`, km/s; negative where the field lies ahead, 0 for no aberration.
    campaign : float or Quantity
        Length :math:`T` of a campaign, days.
    pixel_scale : float or Quantity
        Size of a pixel, arcsec.

    Raises
    ------
    TypeError, ValueError
        If a parameter is no number, not finite, or negative or zero where that means nothing.

    References
    ----------
    .. [1] Howell, S. B. et al. 2014, PASP, 126, 398; Van Cleve, J. E. et al. 2016, PASP, 128,
       075002 (arXiv:1512.06162).

    Examples
    --------
    >>> from scope_models.scene.motion import K2Roll
    >>> K2Roll(solar_rate=3.0).solar_rate
    3.0
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

    stream_name: ClassVar[str] = "k2_roll"
    # Length of a long cadence in days, with the digits of TIMEDEL in headers. Not a parameter: the
    # jitters are measured at this cadence.
    cadence: ClassVar[float] = round(MISSIONS["K2"].cadence_days("long"), 14)

    def track(self, time, streams):
        n_cadences = len(time)
        hours = 24 * self.cadence
        edges = hours * np.arange(n_cadences + 1)
        roll, fired = self._sawtooth(edges, streams("thrusters"))
        noise = _red_noise(streams("roll"), n_cadences, self.roll_jitter_time / hours)
        angle = (roll + self.roll_jitter * noise) / _ARCSEC_PER_RADIAN
        arm_x, arm_y = (3600 * degrees / self.pixel_scale for degrees in self.field)
        middle = (edges[:-1] + hours / 2) / 24
        angle_to_motion = 2 * np.pi / _DAYS_PER_YEAR * (middle - self.campaign / 2)
        stretch = np.cos(angle_to_motion) - np.sinc(self.campaign / _DAYS_PER_YEAR)
        stretch *= self.orbital_speed / _SPEED_OF_LIGHT
        jitter = self.pointing_jitter / self.pixel_scale
        jitter_x, jitter_y = jitter * streams("pointing").standard_normal((n_cadences, 2)).T
        x = stretch * arm_x - angle * arm_y + jitter_x
        y = stretch * arm_y + angle * arm_x + jitter_y
        n_fired, _ = np.histogram([fired, fired + _FIRING], edges)
        return x, y, {"thruster_firing": n_fired > 0}

    def _sawtooth(self, edges, generator):
        """Return the mean roll angle per cadence in arcsec, and the times of firings in hours."""
        interval = self.reset_interval
        first = generator.random() * interval
        # Row after row, so that a longer series begins like a shorter one.
        deviates = generator.standard_normal((3 + int(edges[-1] / interval), 3))
        moved = np.clip(self.reset_jitter * deviates[:, 0], -0.45 * interval, 0.45 * interval)
        times = first + interval * (np.arange(len(deviates)) - 1) + moved
        times[0] = min(times[0], 0.0)
        frequency = np.pi / (24 * self.reversal_interval)
        phase = frequency * (24 * self.reversal - times)
        doubled = times > 24 * (self.reversal + self.reversal_interval)
        size = self.solar_rate * np.where(doubled, 2, 1)
        rate, acceleration = size * np.sin(phase), -size * frequency * np.cos(phase)
        offsets = self.reset_scatter * deviates[:, 1]
        factors = 1 + self.rate_scatter * deviates[:, 2]
        state, fired = np.empty((len(times), 3)), []
        angle, last = offsets[0], 0
        for i, (time, step) in enumerate(zip(times, np.diff(times, append=times[-1]), strict=True)):
            if abs(angle) > self.deadband and i > 0:
                angle, last = offsets[i], i
                fired.append(i)
            grown = 1 + self.rate_growth * (time - times[last])
            omega = factors[last] * rate[i] * grown
            alpha = factors[last] * (acceleration[i] * grown + self.rate_growth * rate[i])
            state[i] = angle, omega, alpha
            angle += omega * step + alpha * step**2 / 2
        return cadence_means(times, state, edges), times[fired]


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
    """Return normal noise of unit variance that forgets itself in ``correlation`` samples."""
    length = int(np.ceil(_MEMORY * correlation))
    white = generator.standard_normal(n + length)
    kernel = np.exp(-np.arange(length + 1) / (correlation or 1.0))
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

    In the K2 data release notes 2490 long cadences have less than 1.9 px, but 162613 to 162627 more
    than 4 px; these and the last one are flagged as of coarse pointing. The roll is that of
    `~scope_models.scene.motion.K2Roll` with the rate and reversals of EPIC 211983544.

    Parameters
    ----------
    excursion : float or Quantity
        Displacement of the boresight along a random direction in the flagged cadences, px.
    field : tuple of float or Quantity
        Distance from the boresight along columns and rows, deg; by default that of the star.

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
        numbers = {"solar_rate": 2.1, "reversal": 5.8, "reversal_interval": 37.3}
        roll = K2Roll(field=self.field, rate_growth=0.027, **numbers)
        x, y, flags = roll.track(time, streams)
        number = self.cadences[0] + np.arange(len(time))
        away = ((number >= 162613) & (number <= 162627)) | (number == 164458)
        dx, dy = _in_random_direction(self.excursion, streams)
        flags |= {"coarse_point": away, "desaturation": _due(time, _DUMPS, streams("dumps"))}
        return x + dx * away, y + dy * away, flags


@dataclass(frozen=True)
class K2FinalCampaign(Pointing):
    """The pointing of K2 campaign 19, in which the fuel ran out.

    The K2 data release notes describe 26.4 days (long cadences 167333 to 168623): 8.5 days off
    target; 7 days of nominal pointing with less than 1.5 px; and 11 days of erratic boresight and
    roll, with usable parts up to cadence 168481. The roll of `~scope_models.scene.motion.K2Roll`
    goes on in all of them.

    The first part and cadences after the last usable one are flagged as without fine pointing; the
    first part, and where a star at the edge of the field moves farther than 3 px, for which
    apertures allow, as of coarse pointing.

    Parameters
    ----------
    off_target_time, nominal_time, erratic_length : float or Quantity
        Length of the first and second part, and of that with fine pointing in the last, days, by
        the notes' cadence numbers.
    off_target : float or Quantity
        Displacement of the boresight in the first part, px; assumed.
    erratic, erratic_time : float or Quantity
        Standard deviation of the boresight per axis in the last part, px, and its correlation
        time, hours, both assumed.
    erratic_roll : float or Quantity
        Standard deviation of the additional roll in the last part, arcsec; assumed.
    field : tuple of float or Quantity
        Distance from the boresight along columns and rows, deg.

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
        roll = K2Roll(field=self.field)
        x, y, flags = roll.track(time, streams)
        first = time < self.off_target_time
        nominal_end = self.off_target_time + self.nominal_time
        last = time >= nominal_end
        correlation = self.erratic_time / (24 * K2Roll.cadence)
        roll_size = self.erratic_roll / _ARCSEC_PER_RADIAN
        angle, dx, dy = (
            size * last * correlated(streams(f"erratic {name}"), len(time), correlation)
            for name, size in (("roll", roll_size), ("x", self.erratic), ("y", self.erratic))
        )
        off_x, off_y = _in_random_direction(self.off_target, streams)
        dx, dy = dx + off_x * first, dy + off_y * first
        arm_x, arm_y = (3600 * degrees / roll.pixel_scale for degrees in self.field)
        flags |= {
            "coarse_point": first | (np.hypot(dx, dy) + _EDGE * np.abs(angle) > _HALO),
            "no_fine_point": first | (time >= nominal_end + self.erratic_length),
            "desaturation": _due(time, _DUMPS, streams("dumps")),
        }
        return x + dx - angle * arm_y, y + dy + angle * arm_x, flags
