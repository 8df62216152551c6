"""The pointing of Kepler: velocity aberration over a quarter, slow red noise and momentum dumps."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.missions import MISSIONS
from scope_models.scene._k2_roll import DAYS_PER_YEAR, SPEED_OF_LIGHT
from scope_models.scene._pointing import Pointing, correlated, due

__all__ = ["KeplerPointing"]


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
