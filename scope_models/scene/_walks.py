"""Motions for tests of correctors: a random walk, and reaction wheels that fail."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.scene._pointing import Pointing

__all__ = ["FailingWheels", "RandomWalk"]


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

    units: ClassVar[dict] = {"spread": u.pix}

    spread: float = 0.1

    def track(self, time, streams):
        """Return where the star goes.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, days.
        streams : callable
            A function of a name that returns a random generator at its beginning.

        Returns
        -------
        x, y : ndarray, shape (n,)
            Offsets, px; 0 in the first cadence.
        flags : dict
            Empty: no cadence is flagged.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models.effects.noise import stream
        >>> from scope_models.scene.motion import RandomWalk
        >>> x, y, _ = RandomWalk().track(np.arange(3.0), lambda name: stream(1, name))
        >>> float(x[0])
        0.0
        """
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

    units: ClassVar[dict] = {
        "drift": u.pix / u.day,
        "spread": u.pix,
        "jump": u.pix,
        "jump_interval": u.day,
    }

    drift: float = 0.02
    spread: float = 0.05
    jump: float = 0.1
    jump_interval: float = 2.0

    def track(self, time, streams):
        """Return where the star goes, and the cadences with a jump.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, days.
        streams : callable
            A function of a name that returns a random generator at its beginning.

        Returns
        -------
        x, y : ndarray, shape (n,)
            Offsets, px; 0 in the first cadence.
        flags : dict of str to ndarray of bool
            Cadences by the meaning of their quality bit.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models.effects.noise import stream
        >>> from scope_models.scene.motion import FailingWheels
        >>> x, y, flags = FailingWheels().track(np.arange(3.0), lambda name: stream(1, name))
        >>> list(flags)
        ['coarse_point']
        """
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
