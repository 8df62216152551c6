"""Gaps: cadences without data."""

from dataclasses import dataclass

import numpy as np

from scope_models._arrays import plain_array, plain_time
from scope_models._values import frozen
from scope_models.effects.base import Drawn, Effect

__all__ = ["Gaps"]


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
        return np.where(drawn.columns["GAPS"] > 0, bit, 0)
