"""The last campaigns of K2: 18, as all before it, and 19, in which the fuel ran out."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.scene._k2_roll import ARCSEC_PER_RADIAN, K2Roll
from scope_models.scene._pointing import Pointing, correlated, due

__all__ = ["K2Campaign18", "K2FinalCampaign"]

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
