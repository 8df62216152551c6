"""What the generators of motions share: checked parameters with units."""

from dataclasses import dataclass, fields
from typing import ClassVar

import astropy.units as u
import numpy as np
from scipy.signal import lfilter

from scope_models._checks import checked_number, checked_pair

__all__ = ["Pointing", "correlated", "due"]


@dataclass(frozen=True)
class Pointing:
    """Base of the generators of motions; every parameter may be a quantity."""

    #: Units of the parameters; of the unit one where they are not named.
    units: ClassVar[dict] = {}
    #: Parameters that may be negative.
    any_sign: ClassVar[frozenset] = frozenset()

    def __post_init__(self):
        for item in fields(self):
            name, value = item.name, getattr(self, item.name)
            unit = self.units.get(name, u.one)
            if isinstance(item.default, tuple):
                value = checked_pair(name, value, unit)
            else:
                value = checked_number(
                    name, value, unit, any_sign=name in self.any_sign, positive=item.default > 0
                    and name.endswith(("interval", "time", "period")),
                )  # fmt: skip
            object.__setattr__(self, name, value)


def due(time, interval, generator):
    """Return the cadences in which something is due that recurs at an interval.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times in days, increasing.
    interval : float
        The interval in days.
    generator : numpy.random.Generator
        Draws the phase.

    Returns
    -------
    ndarray of bool, shape (n,)
        The first cadence at or after each occasion.
    """
    phase = generator.random() * interval
    number = np.floor((time - time[0] + phase) / interval)
    return np.diff(number, prepend=number[0]) > 0


def correlated(generator, n, correlation):
    """Return stationary normal noise of unit variance with an exponential correlation.

    Parameters
    ----------
    generator : numpy.random.Generator
        Source of randomness. A longer series begins like a shorter one.
    n : int
        Number of samples.
    correlation : float
        Correlation time in samples; 0 gives white noise.

    Returns
    -------
    ndarray, shape (n,)
        The noise.
    """
    kept = np.exp(-1 / correlation) if correlation > 0 else 0.0
    white = generator.standard_normal(n)
    white[1:] *= np.sqrt(1 - kept**2)
    return lfilter([1.0], [1.0, -kept], white)
