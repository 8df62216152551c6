"""The pointing of spacecraft: Kepler, TESS, and the last campaigns of K2."""

from dataclasses import dataclass, fields
from typing import ClassVar

import astropy.units as u
import numpy as np
from scipy.signal import lfilter

from scope_models._checks import checked_number, checked_pair
from scope_models._values import Value
from scope_models.missions import MISSIONS
from scope_models.scene._k2_roll import (
    ARCSEC_PER_RADIAN,
    DAYS_PER_YEAR,
    SPEED_OF_LIGHT,
    K2Roll,
)

__all__ = [
    "K2Campaign18",
    "K2FinalCampaign",
    "KeplerPointing",
    "Pointing",
    "TESSPointing",
    "correlated",
    "due",
]


@dataclass(frozen=True)
class Pointing(Value):
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

    units: ClassVar[dict] = {"excursion": u.pix, "field": u.deg}
    #: Number of the first long cadence, and of all.
    cadences: ClassVar[tuple] = (161969, 2490)
    #: Time of the first cadence, BKJD (EPIC 211983544).
    start: ClassVar[float] = 3418.5463

    excursion: float = 4.5
    field: tuple = (0.45, 3.16)

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
        >>> from scope_models.scene.motion import K2Campaign18
        >>> x, y, flags = K2Campaign18().track(np.arange(700) / 48.9, lambda name: stream(1, name))
        >>> int(flags["coarse_point"].sum())
        15
        """
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

    units: ClassVar[dict] = {
        "off_target_time": u.day,
        "nominal_time": u.day,
        "erratic_length": u.day,
        "off_target": u.pix,
        "erratic": u.pix,
        "erratic_time": u.hour,
        "erratic_roll": u.arcsec,
        "field": u.deg,
    }
    #: Number of the first long cadence, and of all.
    cadences: ClassVar[tuple] = (167333, 1291)
    #: Time of the first cadence, BKJD: 2018-08-30 15:17 UTC (K2 data release notes).
    start: ClassVar[float] = 3528.1377

    off_target_time: float = 8.375
    nominal_time: float = 7.25
    erratic_length: float = 7.84
    off_target: float = 6.0
    erratic: float = 2.0
    erratic_time: float = 12.0
    erratic_roll: float = 30.0
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
