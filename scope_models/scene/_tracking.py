"""Motions of a telescope on the ground, and made-up ones for tests of correctors."""

from dataclasses import dataclass
from typing import ClassVar

import astropy.units as u
import numpy as np

from scope_models.scene._pointing import Pointing

__all__ = [
    "FailingWheels",
    "GroundTracking",
    "RandomWalk",
]

_LOWEST = 1e-300


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

    units: ClassVar[dict] = {
        "aperture": u.m,
        "seeing": u.arcsec,
        "wavelength": u.nm,
        "pixel_scale": u.arcsec,
        "night": u.hour,
        "pointing": u.arcsec,
        "drift": u.arcsec / u.hour,
        "wind": u.arcsec,
    }

    aperture: float = 1.0
    seeing: float = 1.0
    wavelength: float = 600.0
    pixel_scale: float = 0.4
    night: float = 8.0
    pointing: float = 0.5
    drift: float = 0.3
    wind: float = 0.1

    def __post_init__(self):
        super().__post_init__()
        for name in ("aperture", "seeing", "wavelength", "pixel_scale", "night"):
            if getattr(self, name) <= 0:
                raise ValueError(f"`{name}` must be positive, got {getattr(self, name)}")

    @property
    def image_motion(self):
        """Standard deviation of the image motion per axis in a short exposure, arcsec."""
        wave = self.wavelength * 1e-9
        arcsec = np.pi / 180 / 3600
        fried = 0.98 * wave / (self.seeing * arcsec)
        variance = 0.18 * (wave / self.aperture) ** (1 / 3) * (wave / fried) ** (5 / 3)
        return float(np.sqrt(variance) / arcsec)

    def times(self, n_cadences, cadence):
        """Return the times of cadences, with a gap after each night.

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
        >>> from scope_models.scene.motion import GroundTracking
        >>> GroundTracking(night=6.0).times(4, 0.125)
        array([0.   , 0.125, 1.   , 1.125])
        """
        per_night = max(1, int(self.night / 24 / cadence))
        number = np.arange(n_cadences)
        return number // per_night + cadence * (number % per_night)

    def track(self, time, streams):
        """Return where the star goes.

        Parameters
        ----------
        time : ndarray, shape (n,)
            Times since the beginning, days; a new night begins every day.
        streams : callable
            A function of a name that returns a random generator at its beginning.

        Returns
        -------
        x, y : ndarray, shape (n,)
            Offsets, px.
        flags : dict
            Empty: no cadence is flagged.

        Examples
        --------
        >>> import numpy as np
        >>> from scope_models.effects.noise import stream
        >>> from scope_models.scene.motion import GroundTracking
        >>> x, y, _ = GroundTracking().track(np.arange(9) / 1440, lambda name: stream(1, name))
        >>> len(x)
        9
        """
        night = np.floor(time + 1e-9).astype(int)
        shaking = np.hypot(self.wind, self.image_motion)
        moved = []
        for axis in "xy":
            generator = streams(f"ground {axis}")
            offset = np.empty(len(time))
            for number in np.unique(night):
                here = night == number
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
