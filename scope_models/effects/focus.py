r"""Focus: the width of the PSF changes in time.

All distances from the star's position scale with the relative width w, and the flux stays:
:math:`p_w(x, y) = p(x_0 + (x - x_0) / w, y_0 + (y - y_0) / w) / w^2`.
"""

from dataclasses import dataclass

import numpy as np

from scope_models._arrays import plain_time
from scope_models._checks import number
from scope_models.effects.base import Drawn, Effect, checked_series, series_of

__all__ = ["Focus"]


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

    amplitude: float = number(0.0, any_sign=True)
    period: float = number(1.0, "day", positive=True)
    phase: float = number(0.0, any_sign=True)
    thermal: float = number(0.0, any_sign=True)
    thermal_time: float = number(1.0, "day", positive=True)
    events: np.ndarray = ()
    series: np.ndarray | None = None

    by_cadence = ("series",)

    def __post_init__(self):
        super().__post_init__()
        if self.events is not None:
            object.__setattr__(self, "events", plain_time(self.events, None, "events"))
        checked_series(self, "events", "day")
        checked_series(self, "series")
        if abs(self.amplitude) >= 1:
            raise ValueError(f"`amplitude` must be below 1, got {self.amplitude}")

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
