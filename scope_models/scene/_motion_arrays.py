"""The arrays of a motion: checks, repairs and statistics."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import checked_choice, checked_int32
from scope_models._values import Value
from scope_models.io._light_curves import ccd_name
from scope_models.io.pixels import LARGEST_OFFSET, place_of, usable_positions
from scope_models.missions import MISSIONS, TIME_ZEROS

__all__ = [
    "MotionStatistics", "as_pixels", "check_increasing", "checked_arrays", "largest_distance",
    "offsets_at", "repair",
]  # fmt: skip

# Flags of the mission that has a time format.
_QUALITY = {mission.time_format: mission.quality for mission in MISSIONS.values()}


def as_pixels(value, name, n, pixel_scale=None):
    """Return a new one-dimensional array of n offsets in pixels."""
    array = plain_array(value, "pix", name, pixel_scale=pixel_scale)
    return _checked_shape(np.array(array), name, n)


def checked_arrays(time, x, y, quality, cadenceno, time_format, pixel_scale=None):
    """Return new arrays of days, pixels, flags and growing numbers, all of one length."""
    checked_choice("time_format", time_format, TIME_ZEROS)
    time = np.array(plain_time(time, time_format, "time"))
    if time.size == 0:
        raise ValueError("`time` is empty: a motion must have at least one cadence")
    n = len(_checked_shape(time, "time", time.size))
    x, y = as_pixels(x, "x", n, pixel_scale), as_pixels(y, "y", n, pixel_scale)
    quality = np.zeros(n, np.int32) if quality is None else quality
    number = np.arange(1, n + 1) if cadenceno is None else cadenceno
    quality = _checked_shape(np.array(checked_int32("quality", quality)), "quality", n)
    number = _checked_shape(np.array(checked_int32("cadenceno", number)), "cadenceno", n)
    check_increasing(number, "cadenceno")
    return time, x, y, quality, number


def _checked_shape(array, name, n):
    if array.ndim != 1:
        raise ValueError(f"`{name}` must be one-dimensional, got shape {array.shape}")
    if len(array) != n:
        raise ValueError(f"`{name}` must have the length of `time`, {n}, got {len(array)}")
    return array


def check_increasing(values, name):
    steps = np.flatnonzero(~(np.diff(values) > 0))
    if len(steps):
        i = steps[0] + 1
        found = f"{values[i]} after {values[i - 1]} at index {i}"
        raise ValueError(f"`{name}` must increase strictly, got {found}")


def repair(time, x, y, quality, cadenceno, time_format, bad, pixel_scale):
    """Interpolate, drop or refuse unusable cadences, as `Motion.from_arrays`; count them."""
    checked_choice("bad", bad, ("interpolate", "drop", "error"))
    given = time, x, y, quality, cadenceno, time_format, pixel_scale
    time, x, y, flags, number = checked_arrays(*given)
    lost = ~usable_positions(np.column_stack([x, y]))
    timeless = ~np.isfinite(time)
    unusable = lost | timeless
    limit = f"NaN or at least {LARGEST_OFFSET:g} px"
    for noun, wrong, reason in (("position", lost, limit), ("time", timeless, "NaN")):
        if wrong.all():
            raise ValueError(f"no usable {noun}: all of {len(time)} are {reason}")
    if unusable.all():
        raise ValueError("no cadence with both a usable time and a usable position")
    if bad == "error" and unusable.any():
        raise ValueError(
            f"{lost.sum()} positions are {limit}, and {timeless.sum()} times are NaN, "
            f"the first of them at index {np.flatnonzero(unusable)[0]}"
        )
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


def offsets_at(motion, time, time_format, cards, shape):
    """Return what `Motion.offsets` does, at times in days, for the cards and shape of a stamp."""
    if time_format != motion.time_format:
        times = f"{motion.time_format.upper()}, those of the file {time_format.upper()}"
        raise ValueError(f"the times of the motion are {times}")
    if (ccd := motion.meta.get("ccd")) and (other := ccd_name(cards)) not in {"", ccd}:
        raise ValueError(f"the motion belongs to {ccd}, the file to {other}")
    time = np.where(np.isfinite(time), time, np.inf)
    middles = (motion.time[1:] + motion.time[:-1]) / 2
    at = np.searchsorted(middles, time)
    steps = np.diff(motion.time)
    step = np.median(steps) if len(steps) else MISSIONS["K2"].cadence_days("long")
    known = np.abs(time - motion.time[at]) < step / 2
    if not known.any():
        raise ValueError("the motion has none of the cadences of the file")
    place = place_of(cards, shape)
    moved = motion.at(*place) if place is not None and hasattr(motion, "at") else motion
    pairs = [(moved.x, moved.y), (moved.x_err, moved.y_err)]
    return tuple(None if x is None else np.where(known, [x[at], y[at]], np.nan).T for x, y in pairs)


@dataclass(frozen=True)
class MotionStatistics(Value):
    """The row of a motion in a table of motions.

    Attributes
    ----------
    mean, std, maximum : ~astropy.units.Quantity
        Mean, standard deviation and maximum of the distance from the reference position, in pixels.
    extent : ~astropy.units.Quantity
        Largest distance between any two positions, in pixels.
    pixel_scale : ~astropy.units.Quantity
        Size of a pixel.
    n_cadences : int
        Number of cadences.

    Examples
    --------
    >>> from scope_models import Motion
    >>> Motion([0, 1], [0.0, 0.3], [0.0, 0.4]).statistics().to_table().colnames
    ['mean', 'std', 'maximum', 'extent', 'pixel_scale', 'n_cadences']
    """

    mean: u.Quantity
    std: u.Quantity
    maximum: u.Quantity
    extent: u.Quantity
    pixel_scale: u.Quantity
    n_cadences: int

    def __str__(self):
        unit = "px" if self.mean.unit == u.pix else str(self.mean.unit)
        return (
            f"{self.mean.value:.3f} +- {self.std.value:.3f} {unit}, "
            f"max {self.maximum.value:.3f} {unit}, extent {self.extent.value:.2f} {unit}"
        )

    def in_arcsec(self):
        """Return the same statistics as angles.

        Returns
        -------
        MotionStatistics
            The statistics with mean, std, maximum and extent in arcsec.
        """
        names, scale = ("mean", "std", "maximum", "extent"), u.pixel_scale(self.pixel_scale)
        return self.replace(**{name: getattr(self, name).to(u.arcsec, scale) for name in names})

    def to_table(self):
        """Return the statistics as a table of one row, to be stacked with others.

        Returns
        -------
        astropy.table.QTable
            One column with its unit for each of the attributes.
        """
        return QTable([vars(self)])


def largest_distance(x, y):
    """Return the largest distance between any two points, both corners of the hull."""
    # Not imported with the package: it takes a third of the time that the package has for that.
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    points = np.column_stack([x, y])
    points = points - points.mean(axis=0)
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        # All points lie on a line, or there are fewer than three.
        along = points @ np.linalg.svd(points, full_matrices=False)[2][0]
        return float(np.ptp(along))
    return float(pdist(hull).max())
