"""Checks of what is passed to `PLDCorrector.correct`, and what becomes of it."""

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from scope_models.correctors._design import DesignOptions
from scope_models.correctors._features import centre, principal_columns
from scope_models.correctors._pixels import read_pixels
from scope_models.correctors._segments import roll_reversals
from scope_models.missions import Mission

__all__ = ["FitOptions", "checked_count", "checked_mask", "design_options", "transit_column"]

_NEIGHBOR_COMPONENTS = 10

_METHODS = ("likelihood", "leave-one-out")
_TRENDS = ("gp", "quadratic")


@dataclass(frozen=True)
class FitOptions:
    """
    How the regression is made.

    Parameters
    ----------
    trend : {"gp", "quadratic"}
        Long-term variability.
    method : {"likelihood", "leave-one-out"}
        What the hyper-parameters maximise.
    sigma : float
        Outliers deviate by more standard deviations.
    max_clips : int
        Largest number of times that outliers are searched.
    """

    trend: str
    method: str
    sigma: float
    max_clips: int

    def __post_init__(self):
        if self.trend not in _TRENDS:
            raise ValueError(f"`trend` must be one of {_TRENDS}, got {self.trend!r}")
        if self.method not in _METHODS:
            raise ValueError(f"`method` must be one of {_METHODS}, got {self.method!r}")
        if not isinstance(self.sigma, Real) or not self.sigma > 0:
            raise ValueError(f"`sigma` must be positive, got {self.sigma!r}")
        checked_count("max_clips", self.max_clips, 0)


def checked_count(name, value, smallest):
    """Return an integer that is not too small."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"`{name}` must be an integer, got {value!r}")
    if value < smallest:
        raise ValueError(f"`{name}` must be at least {smallest}, got {value}")
    return int(value)


def checked_mask(name, mask, n, default):
    """Return a boolean mask of n cadences."""
    if mask is None:
        return np.full(n, default)
    mask = np.asarray(mask)
    if mask.dtype != bool:
        raise TypeError(f"`{name}` must be boolean, got {mask.dtype}")
    if mask.shape != (n,):
        raise ValueError(f"`{name}` must have shape ({n},), got {mask.shape}")
    return mask.copy()


def _checked_breaks(segments, time):
    """Return the times at which segments begin."""
    message = f'`segments` must be "auto", None or a sequence of times, got {segments!r}'
    try:
        breaks = np.sort(np.atleast_1d(np.asarray(segments, dtype=float)).ravel())
    except (TypeError, ValueError):
        raise ValueError(message) from None
    if not np.isfinite(breaks).all():
        raise ValueError(message)
    return tuple(float(b) for b in breaks if time[0] < b <= time[-1])


def design_options(tpf, pixels, order, segments, background, neighbors, saturation):
    """Return what goes into the design matrix, from the arguments of `PLDCorrector.correct`."""
    extra = {}
    if checked_count("background", background, 0):
        extra["background"] = _background_columns(pixels, background)
    if len(neighbors):
        extra["neighbors"] = _neighbor_columns(tpf, neighbors, _NEIGHBOR_COMPONENTS)
    if isinstance(saturation, str):
        if saturation != "auto":
            raise ValueError(f'`saturation` must be "auto", None or e-/s, got {saturation!r}')
        mission = Mission.from_header(tpf.meta)
        saturation = None if mission is None else mission.full_flux
    elif saturation is not None and not saturation > 0:
        raise ValueError(f"`saturation` must be positive, got {saturation}")
    return DesignOptions(order, saturation, _breaks(segments, pixels), extra)


def _breaks(segments, pixels):
    """Return the times at which segments begin, found or given."""
    if segments is None:
        return ()
    time = pixels.time[pixels.usable]
    if not (isinstance(segments, str) and segments == "auto"):
        return _checked_breaks(segments, time)
    fractions = pixels.flux[pixels.usable][:, pixels.aperture]
    fractions = fractions / pixels.total[pixels.usable][:, None]
    everything = np.ones(len(time), dtype=bool)
    tracks = principal_columns(centre(fractions, everything), everything, 0.0)
    return roll_reversals(time, tracks[:, 0]) if tracks.shape[1] else ()


def transit_column(model, time):
    """
    Return the logarithm of a transit model at all cadences, shape ``(n, 1)``.

    Parameters
    ----------
    model : array_like or callable
        Relative flux, or what returns it for times in days.
    time : ndarray
        Times of the cadences.
    """
    known = np.isfinite(time)
    if callable(model):
        values = np.ones(len(time))
        values[known] = model(time[known])
    else:
        values = np.asarray(model, dtype=float)
    if values.shape != time.shape:
        raise ValueError(f"`transit_model` must have shape {time.shape}, got {values.shape}")
    if not np.isfinite(values[known]).all() or np.any(values[known] <= 0):
        raise ValueError("`transit_model` must be positive and finite: it is a relative flux")
    column = np.log(np.where(known, values, 1.0))
    if not np.ptp(column[known]) > 0:
        raise ValueError("`transit_model` must vary with time, got a constant")
    return column[:, None]


def _background_columns(pixels, n_components):
    """Return the principal components of the pixels outside of the aperture over the flux."""
    outside = ~pixels.aperture & np.isfinite(pixels.flux[pixels.usable]).all(axis=0)
    if not outside.any():
        raise ValueError("`background` needs pixels with data outside of `aperture_mask`")
    columns = np.full((len(pixels.time), min(n_components, int(outside.sum()))), np.nan)
    relative = pixels.flux[pixels.usable][:, outside] / pixels.total[pixels.usable][:, None]
    everything = np.ones(len(relative), dtype=bool)
    rotated = principal_columns(centre(relative, everything), everything, 0.0)
    columns = columns[:, : rotated.shape[1]]
    columns[pixels.usable] = rotated[:, : columns.shape[1]]
    return columns


def _neighbor_columns(tpf, neighbors, n_components):
    """Return the first principal components of the pixel fractions of other target pixel files."""
    cadences = np.asarray(tpf.cadenceno)
    parts = []
    for other in neighbors:
        pixels = read_pixels(other, None)
        fractions = pixels.flux[pixels.usable][:, pixels.aperture]
        fractions = fractions / pixels.total[pixels.usable][:, None]
        everything = np.ones(len(fractions), dtype=bool)
        rotated = principal_columns(centre(fractions, everything), everything, 0.0)
        rotated = rotated[:, :n_components]
        _, here, there = np.intersect1d(
            cadences, np.asarray(other.cadenceno)[pixels.usable], return_indices=True
        )
        if not len(here):
            raise ValueError("`neighbors` must share cadences with the target, got none")
        columns = np.full((len(cadences), rotated.shape[1]), np.nan)
        columns[here] = rotated[there]
        parts.append(columns)
    return np.concatenate(parts, axis=1)
