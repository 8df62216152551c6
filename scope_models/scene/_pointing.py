"""Pointing of telescopes in space and on the ground, and made-up ones for tests of correctors."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from scipy.signal import lfilter

from scope_models._checks import check_fields, number
from scope_models._values import Value
from scope_models.missions import MISSIONS

__all__ = [
    "ARCSEC_PER_RADIAN",
    "DAYS_PER_YEAR",
    "SPEED_OF_LIGHT",
    "FailingWheels",
    "GroundTracking",
    "KeplerPointing",
    "Pointing",
    "RandomWalk",
    "TESSPointing",
    "correlated",
    "due",
]

ARCSEC_PER_RADIAN = 180 * 3600 / np.pi
SPEED_OF_LIGHT = 299792.458  # km/s
DAYS_PER_YEAR = 365.25
_LOWEST = 1e-300


@dataclass(frozen=True)
class Pointing(Value):
    """Base of the generators of motions; every parameter may be a quantity."""

    def __post_init__(self):
        check_fields(self)

    def times(self, n_cadences, cadence):
        """Return the times of cadences.

        Parameters
        ----------
        n_cadences : int
            Number of cadences.
        cadence : float
            Time between cadences, days.

        Returns
        -------
        ndarray, shape (n_cadences,)
            Times since the beginning, days.
        """
        return cadence * np.arange(n_cadences)

    def track(self, time, streams):
        """Return where the star goes, and the flagged cadences.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, days.
        streams : callable
            A function of a name that returns a random generator at its beginning.

        Returns
        -------
        x, y : ndarray, shape (n,)
            Offsets, px.
        flags : dict of str to ndarray of bool
            Cadences by the meaning of their quality bit.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models.effects.noise import stream
        >>> from scope_models.scene.motion import KeplerPointing
        >>> x, y, flags = KeplerPointing().track(np.arange(9) / 48, lambda name: stream(1, name))
        >>> list(flags)
        ['desaturation']
        """
        raise NotImplementedError


def due(time, interval, generator):
    """Return the first cadence at or after each occasion of what recurs at an interval, in days."""
    phase = generator.random() * interval
    number = np.floor((time - time[0] + phase) / interval)
    return np.diff(number, prepend=number[0]) > 0


def correlated(generator, n, correlation):
    """Return normal noise of unit variance whose correlation decays by e in a number of samples."""
    kept = np.exp(-1 / correlation) if correlation > 0 else 0.0
    white = generator.standard_normal(n)
    white[1:] *= np.sqrt(1 - kept**2)
    return lfilter([1.0], [1.0, -kept], white)


@dataclass(frozen=True)
class KeplerPointing(Pointing):
    r"""The pointing of Kepler, and a star at some distance from the boresight.

    The field is stretched by velocity aberration, :math:`s(t) = (v / c) \cos\beta \cos(2 \pi t /
    \mathrm{yr} + \phi)` at the ecliptic latitude :math:`\beta`, so that a star at :math:`(X, Y)`
    drifts by :math:`s (X, Y)` less the mean. To this come slow red noise, the heaters' cycle and
    white jitter. Numbers without another source are measured on POS_CORR of Kepler-62 in quarter
    5, whose range of 0.122 x 0.090 px the default place and phase reproduce.

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
        Amplitude of the heaters' cycle along columns, px, and its period, hours. No line between
        2 and 9 h is stronger than 3e-5 px.
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
        """Return where the star goes, and the cadences with a momentum dump."""
        step = time[1] - time[0] if len(time) > 1 else 1.0
        angle = 2 * np.pi * time / DAYS_PER_YEAR + np.radians(self.phase)
        speed = self.orbital_speed * np.cos(np.radians(self.latitude))
        stretch = speed / SPEED_OF_LIGHT * (np.cos(angle) - np.cos(angle).mean())
        moved = []
        for axis, degrees in zip("xy", self.field, strict=True):
            slow = correlated(streams(f"drift {axis}"), len(time), self.drift_time / step)
            white = streams(f"jitter {axis}").standard_normal(len(time))
            arm = 3600 * degrees / MISSIONS["Kepler"].pixel_scale
            moved.append(stretch * arm + self.drift * slow + self.jitter * white)
        moved[0] += self.heater * np.sin(2 * np.pi * 24 * time / self.heater_period)
        return (*moved, {"desaturation": due(time, self.dump_interval, streams("dumps"))})


_REFERENCE = 120 / 86400  # cadence at which the jitter is measured, days


@dataclass(frozen=True)
class TESSPointing(Pointing):
    r"""The pointing of TESS over a sector, and a star at some distance from the boresight.

    The field is stretched by velocity aberration, :math:`s(t) = (v / c) \sin(2 \pi (t - t_m) /
    \mathrm{yr})` about the middle :math:`t_m` of the sector, when the spacecraft looks across its
    orbit. Successive cadences are anticorrelated, as the control loop makes them: the jitter is
    :math:`\epsilon_i - b \epsilon_{i-1}`. It is measured on POS_CORR of TIC 273589987 (sector 15,
    120 s): 0.0027 and 0.0051 px with a correlation of -0.31 from one cadence to the next; for
    other cadences it falls with the square root of the length.

    Parameters
    ----------
    field : tuple of float or Quantity
        Distance from the boresight along columns and rows, deg.
    orbital_speed : float or Quantity
        Speed of the Earth, km/s.
    jitter : tuple of float or Quantity
        Standard deviation of the jitter along columns and rows, px, in 120 s.
    blue : float
        The factor b; 0.35 gives the correlation of -0.31, 0 white noise.
    drift, drift_time : float or Quantity
        Standard deviation of red noise per axis, px, and its correlation time, days; assumed.
    dump_interval : float or Quantity
        Time between momentum dumps, days: 2.5 in sector 1, 3.125 in sector 8, 3.375 in sector 13
        (TESS data release notes).
    dump_offset : float or Quantity
        Standard deviation of the offset in the flagged cadence of a dump, px; assumed.
    orbit_time, gap_time : float or Quantity
        Length of the observations of an orbit, and of the gap between the orbits, days: 13.2 and
        1.13 in sector 1 (TESS data release notes).

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
        """Return the times of cadences, with the gap after each orbit."""
        number = np.arange(n_cadences)
        per_orbit = max(1, round(self.orbit_time / cadence))
        return cadence * number + self.gap_time * (number // per_orbit)

    def track(self, time, streams, cadence=_REFERENCE):
        """Return where the star goes, and the cadences with a momentum dump."""
        n, middle = len(time), self.orbit_time + self.gap_time / 2
        turn = 2 * np.pi * (time - middle) / DAYS_PER_YEAR
        stretch = self.orbital_speed / SPEED_OF_LIGHT * np.sin(turn)
        dumps = due(time, self.dump_interval, streams("dumps"))
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

    In each night the star is put on its place again to within ``pointing``, and then drifts. Wind
    and image motion have the power spectrum :math:`f^{-5/3}` between the length of the night and
    two cadences. The image motion has the variance :math:`0.18 (\lambda / D)^{1/3} (\lambda /
    r_0)^{5/3}` per axis [1]_ with :math:`r_0 = 0.98 \lambda / \mathrm{seeing}`, as in
    instantaneous exposures: longer ones average some of it. Other numbers are assumed.

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
    >>> print(f"{GroundTracking(aperture=1.0, seeing=1.0).image_motion:.3f}")
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
        """Return the times of cadences, with a gap after each night."""
        per_night = max(1, int(self.night / 24 / cadence))
        number = np.arange(n_cadences)
        return number // per_night + cadence * (number % per_night)

    def track(self, time, streams):
        """Return where the star goes."""
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
    frequency = np.arange(len(spectrum), dtype=float)
    weights = np.where(frequency > 0, np.maximum(frequency, 1.0) ** (-5 / 6), 0.0)
    # Each frequency stands for two, but the highest of an even number.
    power = 2 * np.sum(weights**2) - (weights[-1] ** 2 if n % 2 == 0 else 0.0)
    return np.fft.irfft(spectrum * weights, n) * np.sqrt(n / max(power, _LOWEST))


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
        """Return where the star goes."""
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
        Standard deviation of a jump per axis at the end of the first day, px; it grows with the
        square root of time.
    jump_interval : float or Quantity
        Mean time between jumps, days. Their cadences are flagged as of coarse pointing.

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
        """Return where the star goes, and the cadences with a jump."""
        x, y, _ = RandomWalk(spread=self.spread).track(time, streams)
        direction = 2 * np.pi * streams("direction").random()
        steps = np.diff(time, prepend=time[0])
        jumps = streams("jumps").random(len(time)) < -np.expm1(-steps / self.jump_interval)
        sizes = streams("sizes").standard_normal((len(time), 2))
        sizes *= self.jump * np.sqrt(time)[:, np.newaxis]
        jumped = np.cumsum(np.where(jumps[:, np.newaxis], sizes, 0.0), axis=0)
        x = x + self.drift * np.cos(direction) * time + jumped[:, 0]
        y = y + self.drift * np.sin(direction) * time + jumped[:, 1]
        return x, y, {"coarse_point": jumps}
