"""Effects on charge: smear, dark current, brighter-fatter effect, undershoot."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from scope_models._checks import integer, number
from scope_models.effects.base import Drawn, Effect

__all__ = ["BrighterFatter", "DarkCurrent", "Smear", "Undershoot"]


@dataclass(frozen=True, eq=False, repr=False)
class Smear(Effect):
    r"""Light of a column that falls into all its pixels while frames are shifted to the readout.

    Without a shutter every pixel spends the time :math:`t_r / N` under each other pixel of its
    column, with the read-out time :math:`t_r` of a frame and N rows. It gathers the part

    .. math:: f = \frac{t_r}{N\, t_{\mathrm{int}}}

    of the charge of each of them: 8e-5 for Kepler.

    Parameters
    ----------
    rows : int, optional
        Rows N through which the charge of a pixel is shifted; Kepler's CCDs have 1070.
    residual : float, optional
        Part that the calibration leaves in the flux; its photon noise stays in any case.

    Notes
    -----
    Only stars on the stamp smear, for others are not known. Nothing is random, and the truth is
    what the scene holds.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Smear
    >>> scene = Star(12.0), Detector.k2(background=0.0), Motion.still(1)
    >>> observation = simulate(*scene, noise=False, effects=[Smear()])
    >>> print((observation.flux_bkg[0, 0, 5] / observation.flux[0, :, 5].sum()).round(7))
    8.06e-05
    """

    rows: int = integer(1070, 1)
    residual: float = number(0.0, any_sign=True)

    is_light = False  # the response of the pixels is in the charge already

    def pedestal(self, drawn, conditions, part, electrons):
        part_of_column = conditions.read_time / (self.rows * conditions.int_time)
        column = part_of_column * electrons.sum(axis=1, keepdims=True)
        smear = np.broadcast_to(column, electrons.shape)
        return smear, smear * (1 - self.residual)


@dataclass(frozen=True, eq=False, repr=False)
class DarkCurrent(Effect):
    r"""Thermal charge that differs from pixel to pixel.

    Parameters
    ----------
    level : float or Quantity, optional
        Mean dark current, e-/s per pixel.
    scatter : float, optional
        Standard deviation of the pixels' dark current over its mean; negative values become 0.
    residual : float, optional
        Part of the deviations from the mean that the calibration leaves in the flux.

    Notes
    -----
    The truth has the dark current of each pixel (e-/s) in the map DARKCURRENT. The mean is always
    subtracted. The defaults are assumed.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import DarkCurrent
    >>> scene = Star(12.0), Detector.k2(), Motion.still(1)
    >>> truth = simulate(*scene, seed=1, effects=[DarkCurrent(10.0)]).truth
    >>> print(truth.maps["DARKCURRENT"].mean().round(1))
    9.9
    """

    level: float = number(1.0, "electron / s")
    scatter: float = number(0.1)
    residual: float = number(1.0, any_sign=True)

    is_light = False

    def draw(self, conditions, generator):
        deviates = generator.standard_normal(conditions.shape)
        dark = np.maximum(self.level * (1 + self.scatter * deviates), 0.0)
        return Drawn(maps={"DARKCURRENT": dark})

    def pedestal(self, drawn, conditions, part, electrons):
        dark = drawn.maps["DARKCURRENT"]
        subtracted = self.level + (1 - self.residual) * (dark - self.level)
        seconds = conditions.exposure_time
        return dark * seconds, subtracted * seconds


@dataclass(frozen=True, eq=False, repr=False)
class BrighterFatter(Effect):
    r"""Charge that pushes the borders of its pixel inwards: bright stars are wider.

    In each read the charge :math:`q_i` of a pixel repels what arrives; over the border to each of
    its four neighbors j moves

    .. math:: \Delta_{ij} = \frac{k}{2 W} \left(q_i^2 - q_j^2\right) .

    All charge is conserved. The variance of an image grows by
    :math:`k \sum q^2 / (W \sum q)` along each axis: for a Gaussian star of the standard deviation
    :math:`\sigma` whose brightest pixel is full, the width grows by about
    :math:`k / 4 \sigma^2`. In a flat exposure the variance of the pixels grows more slowly than
    their mean.

    Parameters
    ----------
    coefficient : float, optional
        Coefficient k, square pixels. The default makes a star of 0.5 px wider by 2 % at full
        well, as measured on other CCDs (Antilogus et al. 2014, Guyonnet et al. 2015).
    full_well : float or Quantity, optional
        Charge W, electrons; the default is Kepler's median.

    Notes
    -----
    It acts on the charge after photon noise, background included; ``observation.model()`` is
    before it. No charge crosses the edge of the stamp. Nothing is random.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import BrighterFatter
    >>> scene = Star(12.0), Detector.k2(), Motion.still(1)
    >>> fat = simulate(*scene, seed=1, noise=False, effects=[BrighterFatter()])
    >>> thin = fat.model()
    >>> print((fat.flux[0, 5, 5] / thin[0, 5, 5]).round(3), (fat.flux.sum() / thin.sum()).round(6))
    0.983 1.0
    """

    coefficient: float = number(0.02)
    full_well: float = number(1.08e6, "electron", positive=True)

    def charge(self, drawn, conditions, part, electrons):
        factor = self.coefficient / (2 * self.full_well * conditions.n_reads)
        squares = factor * electrons**2
        for axis in (1, 2):
            moved = -np.diff(squares, axis=axis)
            low, high = ([slice(None)] * 3 for _ in range(2))
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            electrons[tuple(low)] -= moved
            electrons[tuple(high)] += moved


@dataclass(frozen=True, eq=False, repr=False)
class Undershoot(Effect):
    r"""Readout electronics that read too little after a bright pixel.

    Along a row, in the order of growing columns, a pixel loses

    .. math:: a \sum_{k \ge 1} e^{-(k - 1) / d}\, (q_{j - k} - q_0)

    with the charge :math:`q_0` of the stamp's first pixel in the row, so that a flat field stays.

    Parameters
    ----------
    amplitude : float, optional
        Part a that the next pixel loses; 0.0039 for Kepler.
    decay : float or Quantity, optional
        Length d in which it decays by e, pixels.
    residual : float, optional
        Part that the calibration leaves in the flux. RAW_CNTS have all of it.

    Notes
    -----
    Nothing is random, and ``observation.model()`` is before it. The calibration inverts the
    equation, as those of the missions do.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects import Undershoot
    >>> row = np.array([[[0.0, 1000.0, 0.0, 0.0]]])
    >>> Undershoot().readout(None, None, slice(0, 1), row)
    >>> print(row.round(2))
    [[[   0.   1000.     -3.9    -3.19]]]
    """

    amplitude: float = number(0.0039)
    decay: float = number(5.0, "pix", positive=True)
    residual: float = number(0.0, any_sign=True)

    place = 1  # the amplifier is behind the transfers

    def readout(self, drawn, conditions, part, electrons):
        self._feed(electrons, -self.amplitude, np.exp(-1 / self.decay))

    def calibrate(self, drawn, conditions, part, electrons):
        before = electrons.copy()
        self._feed(before, self.amplitude, np.exp(-1 / self.decay) + self.amplitude)
        electrons += (1 - self.residual) * (before - electrons)

    @staticmethod
    def _feed(electrons, part, left):
        """Add a part of each pixel to those after it, times ``left`` for each further one."""
        above = electrons - electrons[..., :1]
        electrons += lfilter([0.0, part], [1.0, -left], above, axis=-1)
