"""Changes of the response in time: of all pixels, of single pixels, and cadences without data."""

from dataclasses import dataclass, field

import numpy as np

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import number
from scope_models._values import frozen
from scope_models.effects.base import Drawn, Effect, number_of_events, per_cadence, series_of

__all__ = ["Gaps", "SensitivityDropouts", "Throughput"]


@dataclass(frozen=True, eq=False, repr=False)
class Throughput(Effect):
    r"""Response of all pixels that changes in time, as with the temperature.

    .. math:: s(t) = s_0(t) \left[1 + a \sin\left(2 \pi \left(\frac{t}{P} + \phi\right)\right)
              + d\,(t - t_m)\right]

    with the middle :math:`t_m` of the series. All light has the factor, background included.

    Parameters
    ----------
    amplitude : float, optional
        Relative semi-amplitude a.
    period : float or Quantity, optional
        Period P, days.
    phase : float, optional
        Phase :math:`\phi` at time 0, in periods.
    drift : float or Quantity, optional
        Relative change d per day.
    series : array_like, optional
        Factor :math:`s_0` of each cadence, such as a temperature times its coefficient, plus 1.

    Notes
    -----
    The truth has the factor of each cadence in the column THROUGHPUT.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Throughput
    >>> scene = Star(12.0), Detector.k2(), Motion.still(5)
    >>> observation = simulate(*scene, noise=False, effects=[Throughput(drift=-0.01)])
    >>> total = observation.flux.sum(axis=(1, 2))
    >>> print((total / total[2]).round(6))
    [1.000409 1.000204 1.       0.999796 0.999591]
    """

    amplitude: float = number(0.0, any_sign=True)
    period: float = number(1.0, "day", positive=True)
    phase: float = number(0.0, any_sign=True)
    drift: float = number(0.0, "1 / day", any_sign=True)
    series: np.ndarray | None = field(default=None, metadata=per_cadence())

    def draw(self, conditions, generator):
        time = conditions.time
        factor = 1 + self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        factor += self.drift * (time - (time[0] + time[-1]) / 2)
        if self.series is not None:
            factor *= series_of(self.series, time, "series", "factor")
        if np.any(factor < 0):
            raise ValueError(f"the response must not be negative, got {factor.min():g}")
        return Drawn({"THROUGHPUT": factor})

    def response(self, drawn, conditions, part):
        return drawn.columns["THROUGHPUT"][part, np.newaxis, np.newaxis]


@dataclass(frozen=True, eq=False, repr=False)
class SensitivityDropouts(Effect):
    r"""Sudden losses of single pixels' sensitivity that recover in part.

    After a dropout of the depth d at :math:`t_0`, the pixel's response has the factor

    .. math:: 1 - d \left[1 - k + k\, e^{-(t - t_0) / \tau}\right] .

    Parameters
    ----------
    rate : float or Quantity, optional
        Mean number of dropouts per pixel and day; the default is assumed.
    depth : float, optional
        Mean depth; depths are distributed exponentially, and at most 1. The default is assumed.
    recovery : float, optional
        Part k of the depth that recovers.
    recovery_time : float or Quantity, optional
        Time :math:`\tau` of the recovery, days.

    Notes
    -----
    The truth has the list SENSITIVITYDROPOUTS with CADENCE (from 0), ROW, COLUMN and DEPTH.
    Cadences in which a dropout happens have the mission's quality bit, where it has one.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import SensitivityDropouts
    >>> scene = Star(12.0), Detector.k2(), Motion.still(500)
    >>> observation = simulate(*scene, seed=1, effects=[SensitivityDropouts(rate=0.005)])
    >>> events = observation.truth.tables["SENSITIVITYDROPOUTS"]
    >>> bool((observation.quality[events["CADENCE"]] == 1024).all())
    True
    """

    rate: float = number(1e-4, "1 / day")
    depth: float = number(0.005, at_most=1)
    recovery: float = number(0.5, at_most=1)
    recovery_time: float = number(0.1, "day", positive=True)

    def draw(self, conditions, generator):
        (ny, nx), n_cadences = conditions.shape, len(conditions.time)
        n = number_of_events(generator, self.rate * ny * nx * n_cadences * conditions.cadence_days)
        events = {
            "CADENCE": np.sort(generator.integers(n_cadences, size=n)),
            "ROW": generator.integers(ny, size=n),
            "COLUMN": generator.integers(nx, size=n),
            "DEPTH": np.minimum(self.depth * generator.standard_exponential(n), 1.0),
        }
        return Drawn(tables={"SENSITIVITYDROPOUTS": events})

    def response(self, drawn, conditions, part):
        time, events = conditions.time[part], drawn.tables["SENSITIVITYDROPOUTS"]
        factor = np.ones((len(time), *conditions.shape))
        for cadence, row, column, depth in zip(*events.values(), strict=True):
            since = np.maximum(time - conditions.time[cadence], 0.0)
            lasting = 1 - self.recovery + self.recovery * np.exp(-since / self.recovery_time)
            factor[:, row, column] *= 1 - depth * lasting * (time >= conditions.time[cadence])
        return factor

    def quality(self, drawn, conditions):
        flags, events = np.zeros(len(conditions.time), int), drawn.tables["SENSITIVITYDROPOUTS"]
        flags[events["CADENCE"]] = conditions.bit("sensitivity_dropout")
        return flags


@dataclass(frozen=True, eq=False, repr=False)
class Gaps(Effect):
    """Intervals in which nothing is recorded.

    Flux and errors of their cadences are NaN, raw counts are -1, and the mission's quality bit
    for cadences without data is set; where there is none, as with TESS, that for exclusion.

    Parameters
    ----------
    intervals : array_like or Quantity, shape (n, 2)
        Begin and end of each gap, days in the format of the motion.

    Notes
    -----
    The truth has 1 in the column GAPS for each cadence without data, else 0. Positions and light
    are known in a gap, too.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import Gaps
    >>> motion = Motion.still(10)
    >>> gap = Gaps([(motion.time[2], motion.time[4])])
    >>> observation = simulate(Star(12.0), Detector.k2(), motion, effects=[gap])
    >>> observation.quality
    array([    0,     0, 65536, 65536, 65536,     0,     0,     0,     0,
               0], dtype=int32)
    """

    intervals: np.ndarray

    def __post_init__(self):
        intervals = plain_array(self.intervals, "day", "intervals")
        if intervals.ndim != 2 or intervals.shape[1] != 2 or not np.all(np.isfinite(intervals)):
            shape = intervals.shape
            raise ValueError(f"`intervals` must be finite and of the shape (n, 2), got {shape}")
        plain_time(intervals[:, 0], None, "intervals")  # no Julian dates; an end may be far away
        if np.any(intervals[:, 1] < intervals[:, 0]):
            raise ValueError("`intervals` must not end before they begin")
        object.__setattr__(self, "intervals", frozen(intervals))

    def draw(self, conditions, generator):
        time = conditions.time[:, np.newaxis]
        inside = (time >= self.intervals[:, 0]) & (time <= self.intervals[:, 1])
        return Drawn({"GAPS": inside.any(axis=1).astype(float)})

    def missing(self, drawn, conditions):
        return drawn.columns["GAPS"] > 0

    def quality(self, drawn, conditions):
        bit = conditions.bit("no_data") or conditions.bit("manual_exclude")
        return bit * self.missing(drawn, conditions)
