"""The pointing of spacecraft: Kepler, TESS, and the last campaign of K2."""

from dataclasses import dataclass, fields
from typing import ClassVar

import astropy.units as u
import numpy as np
from scipy.signal import lfilter

from scope_models._checks import checked_number, checked_pair
from scope_models.missions import MISSIONS
from scope_models.scene._k2_roll import DAYS_PER_YEAR, SPEED_OF_LIGHT, K2Roll

__all__ = [
    "K2FinalCampaign",
    "KeplerPointing",
    "Pointing",
    "TESSPointing",
    "correlated",
    "due",
]


@dataclass(frozen=True)
class Pointing:
    """Base of the generators of motions; every parameter may be a quantity."""

    #: Units of the parameters; of the unit one where they are not named.
    units: ClassVar[dict] = {}
    #: Parameters that may be negative.
    any_sign: ClassVar[frozenset] = frozenset()

    def __post_init__(self):
        for item in fields(self):
            name, value = item.name, getattr(self, item.name)
            unit = self.units.get(name, u.one)
            if isinstance(item.default, tuple):
                value = checked_pair(name, value, unit)
            else:
                value = checked_number(
                    name, value, unit, any_sign=name in self.any_sign, positive=item.default > 0
                    and name.endswith(("interval", "time", "period")),
                )  # fmt: skip
            object.__setattr__(self, name, value)


def due(time, interval, generator):
    """Return the cadences in which something is due that recurs at an interval.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times in days, increasing.
    interval : float
        The interval in days.
    generator : numpy.random.Generator
        Draws the phase.

    Returns
    -------
    ndarray of bool, shape (n,)
        The first cadence at or after each occasion.
    """
    phase = generator.random() * interval
    number = np.floor((time - time[0] + phase) / interval)
    return np.diff(number, prepend=number[0]) > 0


def correlated(generator, n, correlation):
    """Return stationary normal noise of unit variance with an exponential correlation.

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

    units: ClassVar[dict] = {
        "field": u.deg,
        "orbital_speed": u.km / u.s,
        "latitude": u.deg,
        "phase": u.deg,
        "drift": u.pix,
        "drift_time": u.day,
        "heater": u.pix,
        "heater_period": u.hour,
        "jitter": u.pix,
        "dump_interval": u.day,
    }
    any_sign: ClassVar[frozenset] = frozenset({"latitude", "phase"})

    field: tuple = (2.2, 1.6)
    orbital_speed: float = 29.8
    latitude: float = 65.0
    phase: float = 45.0
    drift: float = 0.0013
    drift_time: float = 6.0
    heater: float = 2.5e-5
    heater_period: float = 5.0
    jitter: float = 0.0002
    dump_interval: float = 2.98

    def track(self, time, streams):
        """Return where the star goes, and the cadences with a momentum dump.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, evenly spaced, days.
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

    units: ClassVar[dict] = {
        "field": u.deg,
        "orbital_speed": u.km / u.s,
        "jitter": u.pix,
        "drift": u.pix,
        "drift_time": u.day,
        "dump_interval": u.day,
        "dump_offset": u.pix,
        "orbit_time": u.day,
        "gap_time": u.day,
    }

    field: tuple = (6.0, 6.0)
    orbital_speed: float = 29.8
    jitter: tuple = (0.0027, 0.0051)
    blue: float = 0.35
    drift: float = 0.002
    drift_time: float = 1.0
    dump_interval: float = 3.125
    dump_offset: float = 0.1
    orbit_time: float = 13.2
    gap_time: float = 1.13

    def times(self, n_cadences, cadence):
        """Return the times of cadences, with the gap after each orbit.

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

        Examples
        --------
        >>> from scope_models.scene.motion import TESSPointing
        >>> TESSPointing(orbit_time=1.0, gap_time=0.5).times(5, 0.5)
        array([0. , 0.5, 1.5, 2. , 3. ])
        """
        number = np.arange(n_cadences)
        per_orbit = max(1, round(self.orbit_time / cadence))
        return cadence * number + self.gap_time * (number // per_orbit)

    def track(self, time, streams, cadence=_REFERENCE):
        """Return where the star goes, and the cadences with a momentum dump.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, days.
        streams : callable
            A function of a name that returns a random generator at its beginning.
        cadence : float, optional
            Time between cadences, days.

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
        >>> from scope_models.scene.motion import TESSPointing
        >>> x, y, flags = TESSPointing().track(np.arange(9) / 720, lambda name: stream(1, name))
        >>> list(flags)
        ['desaturation']
        """
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
class K2FinalCampaign(Pointing):
    """The pointing of K2 campaign 19, in which the fuel ran out.

    The K2 data release notes describe 26.4 days (1291 long cadences): 8.5 days off target, 7 days
    of nominal pointing with less than 1.5 px, and 11 days of erratic pointing. The roll of
    `~scope_models.scene.motion.K2Roll` goes on in all of them. Off target the boresight is
    displaced, and at the end it walks: by how much is not in the notes, and assumed here.

    Parameters
    ----------
    off_target_time, nominal_time : float or Quantity
        Length of the first and of the second part, days.
    off_target : float or Quantity
        Displacement of the boresight in the first part, px; assumed.
    erratic, erratic_time : float or Quantity
        Standard deviation of the boresight per axis in the last part, px, and its correlation
        time, hours; assumed.
    field : tuple of float or Quantity
        Distance of the star from the boresight along columns and rows, deg.

    Examples
    --------
    >>> from scope_models.scene.motion import K2FinalCampaign
    >>> K2FinalCampaign(erratic=5.0).erratic
    5.0
    """

    units: ClassVar[dict] = {
        "off_target_time": u.day,
        "nominal_time": u.day,
        "off_target": u.pix,
        "erratic": u.pix,
        "erratic_time": u.hour,
        "field": u.deg,
    }

    off_target_time: float = 8.5
    nominal_time: float = 7.0
    off_target: float = 6.0
    erratic: float = 2.0
    erratic_time: float = 12.0
    field: tuple = (-4.59, 1.35)

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
        >>> from scope_models.scene.motion import K2FinalCampaign
        >>> x, y, flags = K2FinalCampaign().track(np.arange(9) / 48, lambda name: stream(1, name))
        >>> bool(flags["coarse_point"].all())
        True
        """
        x, y, firing = K2Roll(field=self.field).track(len(time), streams)
        first = time < self.off_target_time
        last = time >= self.off_target_time + self.nominal_time
        direction = 2 * np.pi * streams("direction").random()
        hours = 24 * K2Roll.cadence
        x += self.off_target * np.cos(direction) * first
        y += self.off_target * np.sin(direction) * first
        for name, moved in (("erratic x", x), ("erratic y", y)):
            walk = correlated(streams(name), len(time), self.erratic_time / hours)
            np.add(moved, self.erratic * walk, out=moved, where=last)
        return x, y, {"thruster_firing": firing, "coarse_point": first | last}
