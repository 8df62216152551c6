"""The design matrix: which groups of regressors there are, and their columns."""

from dataclasses import dataclass, field

import numpy as np

from scope_models.correctors._features import (
    Regressors,
    center,
    contrast_columns,
    power_columns,
    principal_columns,
    shared_columns,
)
from scope_models.correctors._pixels import aperture_pixels
from scope_models.correctors._saturation import find_row_centers, without_saturation
from scope_models.io import read_pixels
from scope_models.pixelmodel._columns import full_columns
from scope_models.pixelmodel._smoothing import Smoother, quantile
from scope_models.pixelmodel._star import IMAGE_ERROR

__all__ = [
    "DesignOptions",
    "background_columns",
    "focus_columns",
    "level_column",
    "make_regressors",
    "misfit_columns",
    "other_columns",
    "outside_column",
]

#: Tolerance: columns are dropped when coefficients of one could not change chi-squared by this, or
#: those of 30, which real stars have, by about one; and their largest number.
_TOLERANCE, _MAX_RANK = 1e-3, 300
#: Prior: products with pixels so far apart have common coefficients (px); number of components of
#: files of other stars.
_REACH = 2
_OTHER_COMPONENTS = 10
#: Prior: relative change of the PSF's width that is the unit of the focus.
_FOCUS_UNIT = 2e-3


@dataclass(frozen=True)
class DesignOptions:
    """Options of the design matrix."""

    order: int  # highest number of factors
    saturation: float | None = None  # flux of a full pixel, e-/s
    breaks: tuple = ()  # times at which a new segment begins
    extra: dict = field(default_factory=dict)  # further groups: columns by name, NaN where unknown
    most: int | None = None  # largest number of columns per order
    mask: np.ndarray | None = None  # whose fractions are regressors; None: the aperture
    predicted: bool = False  # whether fractions are, whose coefficients have expected sizes


def make_regressors(pixels, use, options):
    """Make the groups of regressors for the usable cadences, centered on those in ``use``.

    ``use`` are cadences in the fit, of the usable ones of ``pixels``; no others are read.
    """
    usable = pixels.usable
    total, most = pixels.total[usable], options.most
    mask = pixels.aperture if options.mask is None else options.mask
    images = np.where(mask, np.nan_to_num(pixels.flux[usable]), 0.0)
    full = full_columns(images, use, options.saturation)
    if full.any():
        centers = find_row_centers(images, mask, use, options.saturation)
        images = without_saturation(images, full, centers, mask)
    images /= total[:, None, None]
    fractions = images[:, mask]
    noise = float(np.median((pixels.total_err[usable] / total)[use] ** 2))
    least = _TOLERANCE * noise / use.sum()
    first = principal_columns(center(fractions, use), use, least)[:, :most]
    parts = {"order 1": first}
    for n in range(2, options.order + 1):
        groups = {f"order {n}": power_columns(fractions, n, use, least, _MAX_RANK)[0]}
        if n == 2:
            groups["shared"] = shared_columns(images, _REACH)
            if options.predicted:  # responses within pixels have much in common
                groups = {"order 2": np.concatenate([*groups.values()], axis=1)}
        for name, products in groups.items():
            columns = principal_columns(center(products, use), use, least)
            parts[name] = columns[:, :most]
    if options.breaks:
        parts["segments"] = contrast_columns(first, pixels.time[usable], options.breaks, use)
    for name, columns in options.extra.items():
        parts[name] = _completed(columns[usable], use, least)
    return Regressors.join(parts)


def _completed(columns, use, least):
    """Principal components of columns that may have gaps; a gap is filled with the mean."""
    known = np.isfinite(columns).all(axis=1)
    fit = use & known
    if not fit.any():
        return np.empty((len(columns), 0))
    centered = np.where(known[:, None], columns - columns[fit].mean(axis=0), 0.0)
    return principal_columns(centered, fit, least)


def _components(flux, total, fit=None):
    """Return the principal components of pixels over the sum."""
    relative = flux / total[:, None]
    fit = np.ones(len(relative), dtype=bool) if fit is None else fit
    return principal_columns(center(relative, fit), fit, 0.0)


def focus_columns(clean, usable, use):
    """Return the focus, and its products with the position in units of its size.

    The focus has a unit of its own: in units of its size, one that hardly changes would explain the
    star's variability.
    """
    size = np.maximum([part[use[usable]].std(axis=0) for part in clean.position.T], 1e-12)
    focus = clean.focus[:, None] / _FOCUS_UNIT
    columns = np.full((len(usable), 3), np.nan)
    columns[usable] = np.concatenate([focus, focus * clean.position / size], axis=1)
    return columns


def outside_column(clean, usable):
    """Return the logarithm of the part of the star's light that the aperture holds."""
    column = np.full((len(usable), 1), np.nan)
    column[usable, 0] = -np.log(np.maximum(1 + clean.outside, 0.1))
    return column


def misfit_columns(clean, share, usable):
    """Return what pixels show beyond their predicted fractions, and the background beyond its own.

    The last is what weights of least squares, which follow a star that moves, make of it. Where the
    star's ``share`` of the light, ``(n_pixels,)``, is known to differ from pixel to pixel, the
    fractions follow a star that dims, by the difference of its image and that of all light, and
    with coefficients of about one the flux does. Units make this no more than an image's error.
    """
    image = clean.still.mean(axis=0)
    change = np.linalg.norm(image * share / (image @ share) - image)
    columns = np.full((len(usable), len(image) + 2), np.nan)
    columns[usable] = np.column_stack([clean.misfit, clean.level, clean.weighted])
    return columns * IMAGE_ERROR / np.hypot(IMAGE_ERROR, change)


def background_columns(pixels, n_components, mask, use):
    """Return the principal components of pixels over the flux, by default all outside."""
    usable = pixels.usable
    outside = ~pixels.aperture if mask is None else mask
    outside = outside & np.isfinite(pixels.flux[usable]).all(axis=0)
    if not outside.any():
        raise ValueError("the background needs pixels with data outside of `aperture_mask`")
    rotated = _components(pixels.flux[usable][:, outside], pixels.total[usable], use[usable])
    columns = np.full((len(usable), min(n_components, rotated.shape[1])), np.nan)
    columns[usable] = rotated[:, :n_components]
    return columns


def level_column(pixels, use):
    """Return the light of a background that changes, over the flux, of the aperture.

    Its level is the median of the pixels outside that the star lights least, wherever it is,
    without the light that follows the flux.
    """
    usable, inside = pixels.usable, pixels.aperture
    flux, fit = pixels.flux[usable], use[usable]
    weights = inside if pixels.weights is None else pixels.weights[usable]
    outside = ~inside & np.isfinite(flux).all(axis=0)
    column = np.zeros((len(usable), 1))
    if outside.any():
        relative = pixels.total[usable] / np.median(pixels.total[usable][fit])
        light = flux[:, outside]
        most = quantile(light[fit].T, 0.98)
        dark = light[:, most <= np.median(most)]
        level = np.median(dark - np.median(dark[fit], axis=0) * relative[:, None], axis=1)
        level, _ = Smoother(pixels.time[usable], fit)(level, np.ones(len(level)))
        column[usable, 0] = level * weights.sum(axis=(-2, -1)) / pixels.total[usable]
    return column


def other_columns(cadenceno, others):
    """Return the first principal components of the pixel fractions of other target pixel files."""
    parts = []
    for other in others:
        series = read_pixels(other)
        pixels = aperture_pixels(series, None)
        usable = pixels.usable & pixels.lit
        rotated = _components(pixels.flux[usable][:, pixels.aperture], pixels.total[usable])
        rotated = rotated[:, :_OTHER_COMPONENTS]
        _, here, there = np.intersect1d(cadenceno, series.cadenceno[usable], return_indices=True)
        if not len(here):
            raise ValueError("files in `regressors` must share cadences with the target, got none")
        columns = np.full((len(cadenceno), rotated.shape[1]), np.nan)
        columns[here] = rotated[there]
        parts.append(columns)
    return np.concatenate(parts, axis=1)
