"""The last campaign of K2: off target, then nominal, then erratic."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.scene._k2_roll import K2Roll
from scope_models.scene._pointing import Pointing, correlated

__all__ = ["K2FinalCampaign"]


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
