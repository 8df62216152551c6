r"""Focus: the width of the PSF changes in time.

All distances from the star's position scale with the relative width w, and the flux stays:
:math:`p_w(x, y) = p(x_0 + (x - x_0) / w, y_0 + (y - y_0) / w) / w^2`.
"""

from dataclasses import dataclass

import numpy as np

from scope_models._arrays import plain_array, plain_number, plain_time
from scope_models._checks import checked_number
from scope_models._values import frozen
from scope_models.effects._effect import Drawn, Effect

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

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain.

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

    amplitude: float = 0.0
    period: float = 1.0
    phase: float = 0.0
    thermal: float = 0.0
    thermal_time: float = 1.0
    events: np.ndarray = ()
    series: np.ndarray | None = None

    def __post_init__(self):
        put = object.__setattr__
        for name in ("amplitude", "phase", "thermal"):
            put(self, name, checked_number(name, getattr(self, name), any_sign=True))
        for name in ("period", "thermal_time"):
            value = plain_number(getattr(self, name), "day", name)
            put(self, name, checked_number(name, value, positive=True))
        for name, plain, kind in (("events", plain_time, None), ("series", plain_array, "")):
            if getattr(self, name) is not None:
                values = plain(getattr(self, name), kind, name)
                if values.ndim != 1 or not np.all(np.isfinite(values)):
                    raise ValueError(f"`{name}` must be a finite one-dimensional array")
                put(self, name, frozen(values))
        if abs(self.amplitude) >= 1:
            raise ValueError(f"`amplitude` must be below 1, got {self.amplitude}")

    def draw(self, conditions, generator):
        """Return the relative width of each cadence."""
        time = conditions.time
        width = 1 + self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        for event in self.events:
            since = np.maximum(time - event, 0.0)
            width += self.thermal * np.exp(-since / self.thermal_time) * (time >= event)
        if self.series is not None:
            if self.series.shape != time.shape:
                raise ValueError(
                    f"`series` must give one width for each of the {len(time)} cadences, "
                    f"got {len(self.series)}"
                )
            width *= self.series
        if not np.all(width > 0):
            raise ValueError(f"the width of the PSF must be positive, got {width.min():g}")
        return Drawn({"FOCUS": width})

    def width(self, drawn, conditions):
        """Return the relative width of each cadence."""
        return drawn.columns["FOCUS"]
