r"""Blurring: the width of the PSF changes in time, and the pointing jitters during exposures.

Where the focus changes, all distances from the star's position scale with the relative width w,
and the flux stays: :math:`p_w(x, y) = p(x_0 + (x - x_0) / w, y_0 + (y - y_0) / w) / w^2`.
"""

from dataclasses import dataclass, field

import numpy as np

from scope_models._arrays import plain_time
from scope_models._checks import integer, number
from scope_models.effects._noise import correlated
from scope_models.effects.base import (
    Drawn,
    Effect,
    Exposures,
    checked_series,
    per_cadence,
    series_of,
)

__all__ = ["Focus", "Jitter"]


@dataclass(frozen=True, eq=False, repr=False)
class Focus(Effect):
    r"""The width of the PSF as a sinusoid, a thermal response to events, or a series.

    .. math:: w(t) = s(t) \left[1 + a \sin\left(2 \pi \left(\frac{t}{P} + \phi\right)\right)
              + h \sum_{t_i \le t} e^{-(t - t_i) / \tau}\right]

    Parameters
    ----------
    amplitude : float, optional
        Semi-amplitude a of the relative width. Widths of real K2 stars change by up to about 1 %
        over a campaign.
    period : float or Quantity, optional
        Period P, days.
    phase : float, optional
        Phase :math:`\phi` at time 0, in periods.
    thermal : float, optional
        Relative change h right after each event.
    thermal_time : float or Quantity, optional
        Time :math:`\tau` in which the change after an event decays, days.
    events : array_like or Quantity, optional
        Times :math:`t_i` of the events, as momentum dumps or changes of attitude, days.
    series : array_like, optional
        Relative width s of each cadence; the default is 1.

    Notes
    -----
    The truth has the relative width of each cadence in the column FOCUS.

    Examples
    --------
    >>> from astropy import units as u
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Focus
    >>> breathing = Focus(0.01, period=12 * u.hour)
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(48), effects=[breathing])
    >>> print(observation.truth.columns["FOCUS"].max().round(3))
    1.01
    """

    amplitude: float = number(0.0, any_sign=True, below=1)
    period: float = number(1.0, "day", positive=True)
    phase: float = number(0.0, any_sign=True)
    thermal: float = number(0.0, any_sign=True)
    thermal_time: float = number(1.0, "day", positive=True)
    events: np.ndarray = ()
    series: np.ndarray | None = field(default=None, metadata=per_cadence())

    def __post_init__(self):
        super().__post_init__()
        events = checked_series("events", plain_time(self.events, None, "events"), "day")
        object.__setattr__(self, "events", events)

    def draw(self, conditions, generator):
        time = conditions.time
        width = 1 + self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        for event in self.events:
            since = np.maximum(time - event, 0.0)
            width += self.thermal * np.exp(-since / self.thermal_time) * (time >= event)
        if self.series is not None:
            width *= series_of(self.series, time, "series", "width")
        return Drawn({"FOCUS": width})

    def width(self, drawn, conditions):
        return drawn.columns["FOCUS"]


@dataclass(frozen=True, eq=False, repr=False)
class Jitter(Effect):
    r"""Random motion of the pointing during exposures, white or with a correlation time.

    Along each axis the pointing is a stationary Gauss-Markov process of the variance
    :math:`\sigma^2` and the correlation time :math:`\tau`. Over a cadence of the length T its mean
    has the variance

    .. math:: \sigma_m^2 = 2 \sigma^2 r \left[1 - r \left(1 - e^{-1 / r}\right)\right],
              \qquad r = \tau / T,

    and the rest, :math:`\sigma^2 - \sigma_m^2`, widens the image. The means are drawn with their
    correlations from cadence to cadence. The image is averaged over a normal distribution of
    positions: Gaussian PSFs become wider by its variance, which is exact, others are rendered at
    Gauss-Hermite nodes.

    Parameters
    ----------
    rms : float or Quantity
        Standard deviation :math:`\sigma` along each axis, pixels.
    correlation_time : float or Quantity, optional
        Correlation time :math:`\tau`, s. 0 is white noise at the frame rate.
    nodes : int, optional
        Nodes per axis for PSFs that are not Gaussian. 3 give all moments of the image up to the
        fifth, and render each star at ``nodes**2`` places per cadence.

    Notes
    -----
    The truth has the mean offset of each cadence in the columns JITTER_X and JITTER_Y, and the
    standard deviation within the cadence in JITTER_BLUR, all in pixels. The positions X1, Y1 of
    the stars contain the offsets.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Jitter
    >>> motion = Motion.still(500, cadence=120 / 86400, time_format="btjd")
    >>> truth = simulate(Star(9.0), Detector.tess(), motion, seed=1, effects=[Jitter(0.05)]).truth
    >>> print(truth.columns["JITTER_BLUR"][0].round(3), truth.columns["JITTER_X"].std().round(3))
    0.05 0.006
    """

    rms: float = number(unit="pix")
    correlation_time: float = number(0.0, "s")
    nodes: int = integer(3, 1)

    def draw(self, conditions, generator):
        n, length = len(conditions.time), conditions.cadence_days * 86400
        r = max(self.correlation_time / length, 0.5 / conditions.n_frames)
        kept = np.exp(-1 / r)
        variance = 2 * r * (1 - r * (1 - kept))
        # The mean of a cadence follows from the pointing at its ends, but for a part of its own.
        ends = r * (1 - kept) / (1 + kept)
        own = np.sqrt(max(variance - 2 * ends * r * (1 - kept), 0.0))
        offsets = {}
        for axis in "XY":
            pointing = correlated(generator, n + 1, r)
            mean = ends * (pointing[1:] + pointing[:-1]) + own * generator.standard_normal(n)
            offsets[f"JITTER_{axis}"] = self.rms * mean
        blur = self.rms * np.sqrt(max(1 - variance, 0.0))
        return Drawn(offsets | {"JITTER_BLUR": np.full(n, blur)})

    def exposures(self, drawn, conditions):
        x, y, blur = (drawn.columns[f"JITTER_{name}"][:, np.newaxis] for name in ("X", "Y", "BLUR"))
        return Exposures(x, y, np.ones(1), blur.item(0), self.nodes)
