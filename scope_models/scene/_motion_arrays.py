"""Checks and repairs of the arrays that a motion is made of."""

import numpy as np

from scope_models._arrays import plain_array, plain_time
from scope_models.io.pixels import LARGEST_OFFSET, usable_positions
from scope_models.missions import MISSIONS, TIME_ZEROS

__all__ = [
    "TIME_FORMATS",
    "as_int32",
    "as_pixels",
    "as_times",
    "check_increasing",
    "check_time_format",
    "repair",
]

TIME_FORMATS = tuple(TIME_ZEROS)
# Flags of the mission that has a time format.
_QUALITY = {mission.time_format: mission.quality for mission in MISSIONS.values()}


def check_time_format(value):
    """Raise an error unless the value is the name of a time format."""
    if value not in TIME_FORMATS:
        raise ValueError(f'`time_format` must be "bkjd" or "btjd", got {value!r}')


def as_pixels(value, name, n, pixel_scale=None):
    """Return a new one-dimensional array of n offsets in pixels."""
    return _checked_shape(
        np.array(plain_array(value, "pix", name, pixel_scale=pixel_scale)), name, n
    )


def as_times(value, name, n, time_format):
    """Return a new one-dimensional array of n times in days."""
    return _checked_shape(np.array(plain_time(value, time_format, name)), name, n)


def as_int32(value, name, n):
    """Return a new one-dimensional int32 array of n integers."""
    array = np.asarray(value)
    if array.dtype.kind not in "iu":
        raise TypeError(f"`{name}` must hold integers, got {array.dtype}")
    limits = np.iinfo(np.int32)
    if array.size and (array.max() > limits.max or array.min() < limits.min):
        raise ValueError(f"`{name}` must fit into 32 bits, got {array.min()} to {array.max()}")
    return _checked_shape(array.astype(np.int32), name, n)


def _checked_shape(array, name, n):
    if array.ndim != 1:
        raise ValueError(f"`{name}` must be one-dimensional, got shape {array.shape}")
    if len(array) != n:
        raise ValueError(f"`{name}` must have the length of `time`, {n}, got {len(array)}")
    return array


def check_increasing(values, name):
    """Raise an error unless the values increase strictly."""
    steps = np.flatnonzero(~(np.diff(values) > 0))
    if len(steps):
        i = steps[0] + 1
        raise ValueError(
            f"`{name}` must increase strictly, got {values[i]} after {values[i - 1]} at index {i}"
        )


def repair(time, x, y, quality, cadenceno, *, time_format, bad, pixel_scale=None):
    """Interpolate, drop or refuse cadences without a usable time or position.

    Parameters
    ----------
    time, x, y : array_like, Quantity or Time, shape (n,)
        Times in days, and offsets in pixels.
    quality, cadenceno : array_like of int, shape (n,), or None
        Quality flags, and cadence numbers.
    time_format : {"bkjd", "btjd"}
        Zero of the times, which decides about the flags to set.
    bad : {"interpolate", "drop", "error"}
        What to do.
    pixel_scale : float, optional
        Arcseconds per pixel, for offsets that are angles.

    Returns
    -------
    time, x, y, quality, cadenceno : ndarray
        New arrays without unusable values.
    n_bad : int
        The number of cadences that had some.
    """
    if bad not in {"interpolate", "drop", "error"}:
        raise ValueError(f'`bad` must be "interpolate", "drop" or "error", got {bad!r}')
    check_time_format(time_format)
    n = np.size(time)
    if n == 0:
        raise ValueError("`time` is empty: a motion must have at least one cadence")
    time = as_times(time, "time", n, time_format)
    x, y = as_pixels(x, "x", n, pixel_scale), as_pixels(y, "y", n, pixel_scale)
    flags = as_int32(np.zeros(n, np.int32) if quality is None else quality, "quality", n)
    number = as_int32(np.arange(1, n + 1) if cadenceno is None else cadenceno, "cadenceno", n)
    check_increasing(number, "cadenceno")

    lost = ~usable_positions(np.column_stack([x, y]))
    timeless = ~np.isfinite(time)
    unusable = lost | timeless
    _check_usable(lost, timeless, bad)
    if bad == "drop":
        time, x, y, flags, number = (v[~unusable] for v in (time, x, y, flags, number))
    else:
        bits = _QUALITY[time_format]
        flags[lost] |= bits.manual_exclude
        flags[timeless] |= bits.no_data or bits.manual_exclude
        x = np.interp(number, number[~lost], x[~lost])
        y = np.interp(number, number[~lost], y[~lost])
        time = _fill_times(time, number, timeless)
    return time, x, y, flags, number, int(unusable.sum())


def _check_usable(lost, timeless, bad):
    if lost.all():
        raise ValueError(
            f"no usable position: all of {len(lost)} are NaN or at least {LARGEST_OFFSET:g} px"
        )
    if timeless.all():
        raise ValueError(f"no usable time: all of {len(timeless)} are NaN")
    unusable = lost | timeless
    if unusable.all():
        raise ValueError("no cadence with both a usable time and a usable position")
    if bad == "error" and unusable.any():
        raise ValueError(
            f"{lost.sum()} positions are NaN or at least {LARGEST_OFFSET:g} px, "
            f"and {timeless.sum()} times are NaN, "
            f"the first of them at index {np.flatnonzero(unusable)[0]}"
        )


def _fill_times(time, number, timeless):
    """Interpolate times in cadence number; beyond the ends they go on at the median pace."""
    if not timeless.any():
        return time
    known, values = number[~timeless].astype(float), time[~timeless]
    check_increasing(values, "time")
    if len(values) == 1:
        raise ValueError("`time` must have at least two usable values to interpolate others")
    pace = np.median(np.diff(values) / np.diff(known))
    filled = np.interp(number, known, values)
    filled += pace * (np.minimum(number - known[0], 0) + np.maximum(number - known[-1], 0))
    return np.where(timeless, filled, time)
