"""Effects of the readout: charge that transfers leave behind, and bands that roll over the rows."""

from dataclasses import dataclass

import numpy as np
from scipy.special import xlog1py

from scope_models._checks import integer, number
from scope_models.effects.base import Drawn, Effect, number_of_events

__all__ = ["ChargeTransferInefficiency", "RollingBands"]


@dataclass(frozen=True, eq=False, repr=False)
class ChargeTransferInefficiency(Effect):
    r"""Charge that stays behind when the rows, and then the pixels of a row, are transferred.

    Each clock leaves the part :math:`\epsilon` of a packet in its pixel, where the next packet
    finds it. Of charge that needs N transfers to the output, the part

    .. math:: P_k = \binom{N + k - 1}{k}\, (1 - \epsilon)^N\, \epsilon^k

    arrives k pixels late, in a trail to larger rows and columns. The first bright pixel after dark
    ones loses :math:`1 - (1 - \epsilon)^N`, its *first-pixel response*; all charge is conserved.

    Parameters
    ----------
    parallel, serial : float, optional
        Part :math:`\epsilon` that a transfer of rows, and of the pixels of a row, leaves behind;
        below 0.1. The defaults are assumed.
    rows, columns : int, optional
        Transfers of the stamp's first row and column; each next one needs one more. The default
        is the middle of a CCD of 1024 x 1100 pixels.

    Notes
    -----
    Nothing is random, and ``observation.model()`` is before it. Beyond the edges, the charge is
    taken to be that of the stamp's first row and column; trails that leave the stamp are lost.

    References
    ----------
    Janesick, J. R. 2001, "Scientific Charge-Coupled Devices", SPIE Press, chapter 5.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects import ChargeTransferInefficiency
    >>> row = np.array([[[0.0, 0.0, 1000.0, 0.0, 0.0]]])
    >>> ChargeTransferInefficiency(serial=1e-4, columns=98).readout(None, None, slice(0, 1), row)
    >>> print(row.round(2))
    [[[  0.     0.   990.05   9.9    0.05]]]
    """

    parallel: float = number(1e-5)
    serial: float = number(1e-5)
    rows: int = integer(512, 1)
    columns: int = integer(550, 1)

    def __post_init__(self):
        super().__post_init__()
        for name in ("parallel", "serial"):
            if getattr(self, name) >= 0.1:
                raise ValueError(f"`{name}` must be below 0.1, got {getattr(self, name)}")

    def readout(self, drawn, conditions, part, electrons):
        ny, nx = electrons.shape[1:]
        if self.parallel:
            edge = electrons[:, :1].copy()
            electrons[...] = edge + _late(self.parallel, self.rows, ny) @ (electrons - edge)
        if self.serial:
            edge = electrons[..., :1].copy()
            electrons[...] = edge + (electrons - edge) @ _late(self.serial, self.columns, nx).T


def _late(epsilon, transfers, n):
    """Return the part of pixels' charge (column) that arrives in each pixel (row), ``(n, n)``."""
    k = np.arange(n)
    number = (transfers + k)[:, np.newaxis]
    ratio = np.where(k == 0, 1.0, (number + k - 1) / np.maximum(k, 1) * epsilon)
    parts = np.cumprod(ratio, axis=1) * np.exp(xlog1py(number, -epsilon))
    late = np.zeros((n, n))
    for pixel in k:
        late[pixel:, pixel] = parts[pixel, : n - pixel]
    return late


@dataclass(frozen=True, eq=False, repr=False)
class RollingBands(Effect):
    r"""Episodes of an oscillation of the electronics, seen as bands that roll over the rows.

    The bias of all pixels of a row y changes by

    .. math:: B(y, t) = \sum_i a_i\, e^{-(t - t_i)^2 / 2 d^2}
              \sin\left(2 \pi \left[\frac{y - v (t - t_i)}{\lambda} + \phi_i\right]\right) .

    Parameters
    ----------
    rate : float or Quantity, optional
        Mean number of episodes per day; the default is assumed, as are all others but the
        amplitude.
    amplitude : float or Quantity, optional
        Mean amplitude :math:`a_i`, e-/s per pixel; amplitudes are distributed exponentially. The
        default is 20 ppm of the flux of a star of Kp 12, below which Kepler's bands stay.
    duration : float or Quantity, optional
        Standard deviation d of an episode in time, days.
    spacing : float or Quantity, optional
        Period :math:`\lambda` of the bands, pixels.
    speed : float or Quantity, optional
        Speed v of the bands, pixels per day.

    Notes
    -----
    The truth has the list ROLLINGBANDS with TIME, AMPLITUDE and PHASE (periods) of each episode,
    and the amplitude of each cadence (e-/s) in the column ROLLINGBANDS. Cadences in which it is
    larger than half the mean amplitude have the mission's quality bit, where it has one. Bands
    are not charge: they have no photon noise and are not part of ``observation.model()``.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import RollingBands
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> observation = simulate(*scene, seed=1, effects=[RollingBands(rate=0.3)])
    >>> banded = observation.truth.columns["ROLLINGBANDS"] > 3.5 / 2
    >>> bool((observation.quality[banded] == 131072).all())
    True
    """

    rate: float = number(0.1, "1 / day")
    amplitude: float = number(3.5, "electron / s")
    duration: float = number(0.5, "day", positive=True)
    spacing: float = number(20.0, "pix", positive=True)
    speed: float = number(40.0, "pix / day", any_sign=True)

    place = 2  # the electronics that oscillate are behind the amplifier

    def draw(self, conditions, generator):
        time, days = conditions.time, conditions.cadence_days
        start, length = time[0] - days / 2, time[-1] - time[0] + days
        n = number_of_events(generator, self.rate * length)
        episodes = {
            "TIME": np.sort(start + length * generator.random(n)),
            "AMPLITUDE": self.amplitude * generator.standard_exponential(n),
            "PHASE": generator.random(n),
        }
        size = np.abs(self._waves(episodes, time).sum(axis=0))
        return Drawn({"ROLLINGBANDS": size}, tables={"ROLLINGBANDS": episodes})

    def _waves(self, episodes, time):
        """Return the complex amplitude of each episode at row 0, (n_episodes, n_cadences)."""
        at, amplitude, phase = (values[:, np.newaxis] for values in episodes.values())
        since = time - at
        size = amplitude * np.exp(-((since / self.duration) ** 2) / 2)
        return size * np.exp(2j * np.pi * (phase - self.speed * since / self.spacing))

    def readout(self, drawn, conditions, part, electrons):
        episodes = drawn.tables["ROLLINGBANDS"]
        if not len(episodes["TIME"]):
            return
        wave = self._waves(episodes, conditions.time[part]).sum(axis=0)
        rows = np.exp(2j * np.pi * np.arange(electrons.shape[1]) / self.spacing)
        bands = conditions.exposure_time * np.multiply.outer(wave, rows).imag
        electrons += bands[:, :, np.newaxis]

    def quality(self, drawn, conditions):
        strong = drawn.columns["ROLLINGBANDS"] > self.amplitude / 2
        return np.where(strong, conditions.bit("rolling_band"), 0)
