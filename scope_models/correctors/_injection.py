"""Dimmings of the star's own light, put into the pixels that a corrector has read."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scope_models._arrays import plain_array
from scope_models._checks import checked_number
from scope_models._threads import one_thread
from scope_models.correctors._pixels import (
    Pixels,
    at_one_place,
    background_plane,
    typical_image,
)
from scope_models.correctors._stars import SHARE_ERROR, NoLightError, blend_of, star_share, stars_of
from scope_models.exceptions import DetrendingWarning
from scope_models.photometry import aperture_flux

__all__ = [
    "Source", "box_signal", "checked_depth", "depth_ratio", "fitted_depth", "no_survival",
    "transit_column", "warn_of_unmasked",
]  # fmt: skip

#: Warning: part of a transit outside of the mask above which its depth is not trusted.
_UNMASKED = 0.1
#: Tolerance: boxes are at least so many times their width apart, and there are so many at most.
_APART, _MOST_BOXES = 8, 8


@dataclass(frozen=True)
class Source:
    """What a `PLDModel` was made of."""

    pixels: Pixels  # as measured
    series: object  # their file
    cadence_mask: np.ndarray  # cadences from which images are learned

    @cached_property
    def _image(self):
        """Typical image less background, its background, and the star's share in each pixel."""
        pixels, places = self.pixels, self.series.pos_corr
        typical = typical_image(pixels.flux[pixels.usable])
        plane = background_plane(typical)
        image, share = np.nan_to_num(typical - plane), np.ones(typical.shape)
        still, full = image, self.series.mission and self.series.mission.full_flux
        if places is not None and np.isfinite(places[pixels.usable]).any():
            still = at_one_place(pixels.flux[pixels.usable], places[pixels.usable])
            still = np.nan_to_num(still - plane)
        alone = pixels.own.all()
        if alone and full is not None and still.max() >= full:
            return image, plane, share  # charge that has bled looks like a star
        try:
            if alone:
                stars = blend_of(still, pixels.core)
            else:
                stars = stars_of(still, pixels.core, ~pixels.own)
            if len(stars) > 1:
                share = star_share(image, stars)
        except NoLightError:
            pass
        return image, plane, share

    @property
    def share(self):
        """The star's share of the light in each pixel."""
        return self._image[2]

    @cached_property
    def other_light(self):
        """Part of the aperture's light that is other stars', as the typical image shows it."""
        image, _, share = self._image
        inside = self.pixels.aperture
        return float(np.clip(1 - (image * share)[inside].sum() / image[inside].sum(), 0.0, 1.0))

    def light(self, clean):
        """Return all stars' light in each pixel, e-/s."""
        light = self.pixels.flux - self._image[1]
        if clean is not None:
            use, (columns, rows) = np.flatnonzero(self.pixels.usable)[:, None], clean.grid.T
            light[use, rows, columns] = self.pixels.flux[use, rows, columns] - clean.background
        return light

    @property
    def contrast_error(self):
        """The uncertain part of the light that was not taken off, or may be none."""
        if self.pixels.neighbors is None:
            return self.other_light
        return float(np.hypot(self.other_light, SHARE_ERROR * (1 / self.pixels.crowding - 1)))

    def dimmed(self, signal, clean):
        """Return the same with the star's light multiplied with a signal ``(n_cadences,)``."""
        pixels = self.pixels
        own = self.light(clean) * self._image[2]
        flux = pixels.flux + own * (signal - 1)[:, None, None]
        total, _ = aperture_flux(flux, pixels.inside, pixels.flux_err)
        usable = pixels.usable & (np.nan_to_num(total) > 0)
        return replace(self, pixels=replace(pixels, flux=flux, total=total, usable=usable))


def box_signal(used, width, depth):
    """Return boxes of ``width`` of the used cadences, at places without a period.

    Multiples of the golden ratio spread them evenly.
    """
    rows = np.flatnonzero(used)
    number = int(np.clip(len(rows) // (_APART * width), 1, _MOST_BOXES))
    signal, golden = np.ones(len(used)), (np.sqrt(5) - 1) / 2
    room = len(rows) / number - width
    for k in range(number):
        first = int(k * len(rows) / number + max(room, 0) * ((k + 1) * golden % 1))
        signal[rows[first : first + width]] -= depth
    return signal


@one_thread
def fitted_depth(fitted, column):
    """Return amplitude and error of a transit at fixed regressors, with all cadences in it."""
    usable, solution = fitted.model.pixels.usable, fitted.solution
    column, use = column[usable], solution.use | fitted.transit_mask[usable]
    solution = solution.with_flat(column, use | fitted.cadence_mask[usable] & column.any(axis=1))
    return solution.without_outliers(fitted.model.options).flat_coefficient(-1)


def depth_ratio(signal, flux, error):
    """Return the depth of events in a flux over that in a signal, with a line about each event.

    Both are relative, the signal less 1. Second comes the standard deviation of the ratio as the
    scatter about the signal gives it, or that between the events, if it is more; NaN without
    events. Errors weight the cadences.
    """
    edges = np.flatnonzero(np.diff(signal != 0, prepend=False, append=False)).reshape(-1, 2)
    parts = [np.empty((0, 2))]
    for start, end in edges:
        near = slice(max(2 * start - end, 0), 2 * end - start)
        both = np.column_stack([flux, signal])[near] / error[near, None]
        line = np.vander(np.arange(len(both)), 2) / error[near, None]
        parts.append(both - line @ np.linalg.lstsq(line, both)[0])
    seen, expected = np.concatenate(parts).T
    power, free = expected @ expected, len(seen) - 2 * len(edges) - 1
    if not power > 0 or free < 1:
        return np.nan, np.nan
    ratio = seen @ expected / power
    rest = seen - ratio * expected
    within = np.sum(rest**2) / free / power
    ends = np.cumsum([len(part) for part in parts])[:-1]
    events = np.array([part.sum() for part in np.split(rest * expected, ends)]) / power
    between = np.sum(events**2) * len(edges) / max(len(edges) - 1, 1)
    return float(ratio), float(np.sqrt(max(within, between)))


def checked_depth(depth):
    """Return a depth between 0 and 1."""
    depth = checked_number("depth", depth, positive=True)
    if depth >= 1:
        raise ValueError(f"`depth` must be less than 1, got {depth}")
    return depth


def transit_column(model, time):
    """Return the logarithm of a transit model at all cadences, ``(n, 1)``, 0 without a time.

    The model is relative flux, or what returns it for times in days. Where that is constant at all
    cadences, a warning is given and the shape is ``(n, 0)``.
    """
    known = np.isfinite(time)
    if callable(model):
        values = np.ones(len(time))
        values[known] = model(time[known])
    else:
        values = plain_array(model, "", "transit_model")
    if values.shape != time.shape:
        raise ValueError(f"`transit_model` must have shape {time.shape}, got {values.shape}")
    if not np.isfinite(values[known]).all() or np.any(values[known] <= 0):
        raise ValueError("`transit_model` must be positive and finite: it is a relative flux")
    column = np.log(np.where(known, values, 1.0))
    varies = np.ptp(column[known]) > 0
    if callable(model) and not varies:
        message = "`transit_model` is constant at all cadences: its event lies in a gap"
        warnings.warn(message, DetrendingWarning, stacklevel=4)
        return np.zeros((len(time), 0))
    if not varies:
        raise ValueError("`transit_model` must vary with time, got a constant")
    return column[:, None]


def no_survival(reason):
    """Return NaN twice, with a warning that has the reason."""
    warnings.warn(f"the transit survival is NaN: {reason}", DetrendingWarning, stacklevel=4)
    return np.nan, np.nan


def warn_of_unmasked(column, free):
    """Warn if a fit of free cadences took a transit for variability, systematics or outliers."""
    event = np.abs(column - np.median(column))
    if event[free].sum() > _UNMASKED * event.sum():
        message = (
            "the transits were neither masked nor fitted jointly: part of their depth may be "
            "in the variability or the systematics; `correct` with `transit_mask=` or "
            "`transit_model=` first"
        )
        warnings.warn(message, DetrendingWarning, stacklevel=4)
