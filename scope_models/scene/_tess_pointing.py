"""The pointing of TESS: two orbits, velocity aberration, jitter and momentum dumps."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.missions import MISSIONS
from scope_models.scene._k2_roll import DAYS_PER_YEAR, SPEED_OF_LIGHT
from scope_models.scene._pointing import Pointing, correlated, due

__all__ = ["TESSPointing"]

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
