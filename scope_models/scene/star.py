"""A star: its PSF, place, brightness and variability."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.modeling import Model

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import check_fields, checked_model, number
from scope_models._values import Value, frozen
from scope_models.models import PRF
from scope_models.models._description import check_coord

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Star"]


@dataclass(frozen=True, eq=False, repr=False)
class Star(Value):
    """A star on the stamp.

    Parameters
    ----------
    mag : float or Quantity
        Magnitude in the mission's band (Kp or T).
    x_0, y_0 : float, Quantity or None, optional
        Column and row of the reference position on the stamp, pixels from 0; None is its center.
    psf : astropy.modeling.Model or None, optional
        A density with the parameters flux, x_0 and y_0, as photutils' PSFs, or a sum of several,
        scaled to a total flux of 1, with the first component at the star's position. None takes
        the detector's PSF.
    signal : astropy.modeling.Model or callable or array_like or None, optional
        Mean relative flux of each cadence: a one-dimensional model or a function of time (days),
        or one number per cadence. None is constant.
    coord : SkyCoord or None, optional
        Place on the sky, in place of ``x_0`` and ``y_0``; of the target the place that the stamp
        looks at. With a proper motion it needs an ``obstime``, and is moved to the middle of the
        scene's motion.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or outside its domain.

    Examples
    --------
    >>> from scope_models import Star
    >>> Star(12.0, 5.1, 4.9, signal=lambda time: 1 - 0.01 * (time > 1)).relative_flux([0.5, 1.5])
    array([1.  , 0.99])
    """

    mag: float = number(unit=u.mag, any_sign=True)
    x_0: float | None = number(None, u.pix, any_sign=True)
    y_0: float | None = number(None, u.pix, any_sign=True)
    psf: "Model | None" = None
    signal: "Model | Callable | np.ndarray | None" = None
    coord: SkyCoord | None = None

    def __post_init__(self):
        put = object.__setattr__
        check_fields(self)
        put(self, "psf", checked_model("psf", self.psf))
        if self.psf is not None:
            PRF(self.psf)  # fails if it cannot be integrated over pixels
        put(self, "signal", _checked_signal(self.signal))
        if self.coord is not None:
            check_coord(self.coord)

    def relative_flux(self, time):
        """Return the relative flux of each cadence.

        Parameters
        ----------
        time : array_like or Quantity of shape (n,)
            Middle of each cadence, days.

        Returns
        -------
        ndarray of shape (n,)
            1 is the star's magnitude.

        Raises
        ------
        ValueError
            If the signal has another length, or is negative or not finite.
        """
        time = plain_time(time, None, "time")
        if self.signal is None:
            return np.ones(time.shape)
        signal = self.signal(time) if callable(self.signal) else self.signal
        signal = np.array(plain_array(signal, u.one, "signal"))
        if signal.shape != time.shape:
            wanted = f"one number for each of the {len(time)} cadences"
            raise ValueError(f"`signal` must give {wanted}, got the shape {signal.shape}")
        return _check_values(signal)


def _checked_signal(signal):
    """Return a signal of an allowed kind; arrays are copied, checked and made read-only."""
    if isinstance(signal, Model):
        if (signal.n_inputs, signal.n_outputs) != (1, 1):
            raise TypeError(f"`signal` must be a model of time alone, got {signal!r}")
        return signal.copy()
    if signal is None or callable(signal):
        return signal
    try:
        values = np.array(plain_array(signal, u.one, "signal"))
    except TypeError:
        values = np.array(0.0)
    if values.ndim != 1:
        wanted = "a model, a function of time, a one-dimensional array or None"
        raise TypeError(f"`signal` must be {wanted}, got {signal!r}")
    return frozen(_check_values(values))


def _check_values(signal):
    if not np.all(np.isfinite(signal)):
        raise ValueError("`signal` must be finite in every cadence")
    if np.any(signal < 0):
        raise ValueError(f"`signal` must not be negative, got {signal.min()}")
    return signal
