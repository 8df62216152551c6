"""The design matrix: which groups of regressors there are, and their columns."""

from dataclasses import dataclass, field
from numbers import Real
from os import PathLike

import numpy as np
from scipy.linalg import helmert, solve_triangular

from scope_models._arrays import plain_array
from scope_models.correctors._pixels import aperture_pixels
from scope_models.io import read_pixels
from scope_models.pixelmodel._columns import find_row_centers, full_columns, without_saturation
from scope_models.pixelmodel._position import pivoted_cholesky
from scope_models.pixelmodel._smoothing import Smoother, quantile
from scope_models.pixelmodel._star import IMAGE_ERROR

__all__ = [
    "DesignOptions", "Regressors", "at_rows", "clean_columns", "given_columns", "level_column",
    "make_regressors",
]  # fmt: skip

#: Tolerance: columns are dropped when coefficients of one could not change chi-squared by this, or
#: those of 30, which real stars have, by about one; and their largest number.
_TOLERANCE, _MAX_RANK = 1e-3, 300
#: Prior: products with pixels so far apart have common coefficients (px); number of components of
#: files of other stars.
_REACH = 2
_OTHER_COMPONENTS = 10
#: Prior: relative change of the PSF's width that is the unit of the focus.
_FOCUS_UNIT = 2e-3
#: Tolerance: largest number of cadences of which the pivots of a factor are chosen.
_CANDIDATES = 4000


@dataclass(frozen=True)
class Regressors:
    """Columns that share a prior variance within each named group."""

    columns: np.ndarray  # (n_cadences, n_columns)
    groups: np.ndarray  # group of each column, an index into ``names``
    names: tuple

    @classmethod
    def join(cls, parts):
        """Join groups, from names to columns ``(n_cadences, m)``, without the empty ones."""
        sizes = np.array([columns.shape[1] for columns in parts.values()])
        names = tuple(name for name, size in zip(parts, sizes, strict=True) if size)
        groups = np.repeat(np.arange(len(names)), sizes[sizes > 0])
        return cls(np.concatenate(list(parts.values()), axis=1), groups, names)


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
    first = principal_columns(fractions, use, least)[:, :most]
    parts = {"order 1": first}
    for n in range(2, options.order + 1):
        groups = {f"order {n}": power_columns(fractions, n, use, least, _MAX_RANK)}
        if n == 2:
            groups["shared"] = shared_columns(images, _REACH)
            if options.predicted:  # responses within pixels have much in common
                groups = {"order 2": np.concatenate([*groups.values()], axis=1)}
        for name, products in groups.items():
            parts[name] = principal_columns(products, use, least)[:, :most]
    if options.breaks:
        parts["segments"] = contrast_columns(first, pixels.time[usable], options.breaks, use)
    for name, columns in options.extra.items():
        parts[name] = principal_columns(columns[usable], use, least)
    return Regressors.join(parts)


def given_columns(pixels, options, cadenceno, use):
    """Return groups of columns by name that a user wants, as `PLDCorrector.correct` takes them."""
    given, groups = options.regressors, {}
    several = isinstance(given, list | tuple) and not any(isinstance(one, Real) for one in given)
    background, others, columns = options.background_aperture_mask is not None, [], []
    for one in given if several else [given]:
        if isinstance(one, str) and one == "background":
            background = True
        elif hasattr(one, "flux") or isinstance(one, (str, PathLike)):
            others.append(_fractions_of(one, cadenceno))
        else:
            columns.append(_columns_of(one, cadenceno))
    if background:
        groups["background"] = _background_columns(pixels, options, use)
    if others:
        groups["other_targets"] = np.concatenate(others, axis=1)
    if columns:
        columns = np.concatenate(columns, axis=1)
        spread = np.nanstd(columns, axis=0)
        groups["regressors"] = columns[:, spread > 0] / spread[spread > 0]
    return groups


def _background_columns(pixels, options, use):
    """Return the principal components of pixels over the flux, by default all outside."""
    usable, outside = pixels.usable, options.background_aperture_mask
    outside = ~pixels.aperture if outside is None else outside
    outside = outside & np.isfinite(pixels.flux[usable]).all(axis=0)
    if not outside.any():
        raise ValueError("the background needs pixels with data outside of `aperture_mask`")
    relative = pixels.flux[usable][:, outside] / pixels.total[usable, None]
    found = principal_columns(relative, use[usable], 0.0)
    return at_rows(found[:, : options.background], usable)


def _fractions_of(source, cadenceno):
    """Return the first principal components of the pixel fractions of a file of another star."""
    series = read_pixels(source)
    pixels = aperture_pixels(series, None)
    usable = pixels.usable & pixels.lit
    relative = pixels.flux[usable][:, pixels.aperture] / pixels.total[usable, None]
    columns = principal_columns(relative, np.ones(len(relative), dtype=bool), 0.0)
    columns = columns[:, :_OTHER_COMPONENTS]
    return _matched(columns, series.cadenceno[usable], cadenceno, "files in `regressors`")


def _columns_of(regressor, cadenceno):
    """Return columns of a user's own, NaN where they are unknown.

    Basis vectors are matched by their cadence numbers; arrays, design matrices and collections of
    them must have a row per cadence.
    """
    if hasattr(regressor, "cbv_indices"):
        vectors = [regressor[f"VECTOR_{k}"] for k in regressor.cbv_indices]
        vectors = np.stack([plain_array(one, "", "regressors") for one in vectors], axis=1)
        vectors[np.asarray(regressor["GAP"], dtype=bool)] = np.nan
        return _matched(vectors, np.asarray(regressor["CADENCENO"]), cadenceno, "`regressors`")
    values = regressor.values if hasattr(regressor, "prior_sigma") else regressor
    columns = plain_array(values, "", "regressors")
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or len(columns) != len(cadenceno):
        raise ValueError(f"`regressors` must have {len(cadenceno)} rows, got shape {columns.shape}")
    return columns


def _matched(columns, number, cadenceno, name):
    """Return columns with a row per cadence, by cadence numbers; NaN where there is none."""
    _, here, there = np.intersect1d(cadenceno, number, return_indices=True)
    if not len(here):
        raise ValueError(f"{name} must share cadences with the target, got none")
    matched = np.full((len(cadenceno), columns.shape[1]), np.nan)
    matched[here] = columns[there]
    return matched


def clean_columns(clean, share, usable, use):
    """Return groups of columns from a `StarModel`.

    The focus, and its products with the position in units of its size, have a unit of their own: in
    units of its size, a focus that hardly changes would explain the star's variability. The
    logarithm of the part of the star's light that the aperture holds follows, and what pixels show
    beyond their predicted fractions, the background beyond its own, and what weights of least
    squares, which follow a star that moves, make of it. Where the star's ``share`` of the light,
    ``(ny, nx)``, is known to differ from pixel to pixel, the fractions follow a star that dims, by
    the difference of its image and that of all light, and with coefficients of about one the flux
    does. Units make this no more than an image's error.
    """
    size = np.maximum([part[use[usable]].std(axis=0) for part in clean.position.T], 1e-12)
    focus = clean.focus[:, None] / _FOCUS_UNIT
    image, share = clean.still.mean(axis=0), share[*clean.grid.T[::-1]]
    change = np.linalg.norm(image * share / (image @ share) - image)
    misfit = np.column_stack([clean.misfit, clean.level, clean.weighted])
    groups = {
        "focus": np.concatenate([focus, focus * clean.position / size], axis=1),
        "aperture": -np.log(np.maximum(1 + clean.outside, 0.1))[:, None],
        "misfit": misfit * IMAGE_ERROR / np.hypot(IMAGE_ERROR, change),
    }
    return {name: at_rows(columns, usable) for name, columns in groups.items()}


def at_rows(values, rows):
    """Return values with NaN, or False, in the places of other rows of a mask."""
    fill = False if values.dtype == bool else np.nan
    whole = np.full((len(rows), *values.shape[1:]), fill)
    whole[rows] = values
    return whole


def level_column(pixels, use):
    """Return the light of a background that changes, over the flux, of the aperture.

    Its level is the median of the pixels outside that the star lights least, wherever it is,
    without the light that follows the flux.
    """
    usable, flux, fit = pixels.usable, pixels.flux[pixels.usable], use[pixels.usable]
    outside = ~pixels.aperture & np.isfinite(flux).all(axis=0)
    column = np.zeros((len(usable), 1))
    if outside.any():
        relative = pixels.total[usable] / np.median(pixels.total[usable][fit])
        light = flux[:, outside]
        most = quantile(light[fit].T, 0.98)
        dark = light[:, most <= np.median(most)]
        level = np.median(dark - np.median(dark[fit], axis=0) * relative[:, None], axis=1)
        level, _ = Smoother(pixels.time[usable], fit)(level, np.ones(len(level)))
        inside = np.broadcast_to(pixels.inside, pixels.flux.shape)[usable].sum(axis=(1, 2))
        column[usable, 0] = level * inside / pixels.total[usable]
    return column


def principal_columns(columns, use, tolerance):
    """Rotate columns to principal components, and drop those that are too small to matter.

    The rotation is orthogonal: a common prior variance means the same before and after. The
    cadences in ``use`` define means and components; those whose mean square is below ``tolerance``
    go. A gap is filled with the mean.
    """
    known = np.isfinite(columns).all(axis=1)
    use = use & known
    if not use.any():
        return np.empty((len(columns), 0))
    columns = np.where(known[:, None], columns - columns[use].mean(axis=0), 0.0)
    values, vectors = np.linalg.eigh(columns[use].T @ columns[use] / use.sum())
    keep = values > max(tolerance, 1e-14 * values[-1])
    return columns @ vectors[:, keep][:, ::-1]


def power_columns(fractions, order, use, tolerance, max_rank):
    r"""Return all products of ``order`` fractions ``(n_cadences, n_pixels)``, as few columns.

    The products, each weighted with the square root of its number of orderings, span the kernel
    :math:`(p_i \cdot p_j)^n`. A pivoted Cholesky factor of that kernel gives the same regression
    without forming them. Cadences in ``use`` may become pivots; of very many, evenly spaced ones.
    The factor ends at ``max_rank`` columns, or when the mean of what is left of the kernel's
    diagonal over these cadences is below ``tolerance``.
    """
    points = fractions[use]
    points = points[:: -(-len(points) // _CANDIDATES)]
    diagonal = np.einsum("ij,ij->i", points, points) ** order
    precision = len(points) * np.finfo(float).eps * diagonal.max()

    def ends(rest):
        return rest.mean() < tolerance or rest.max() <= precision

    def column(k):
        return (points @ points[k]) ** order

    pivots, rows = pivoted_cholesky(diagonal, column, ends, min(max_rank, len(points)))
    kernel = (points[pivots] @ fractions.T) ** order
    factor = rows[:, pivots].T
    return solve_triangular(factor, kernel, lower=True, overwrite_b=True, check_finite=False).T


def shared_columns(images, reach):
    r"""Return products of two fractions, summed over all pixels.

    When all pixels have the same intra-pixel response, products with the same offset have the same
    coefficient: only the sums :math:`\sum_l p_l p_{l+d}` count, for all offsets :math:`d` up to
    ``reach`` pixels along either axis. The ``images`` of the fractions, ``(n_cadences, ny, nx)``,
    are zero outside of the aperture.
    """
    ny, nx = images.shape[1:]
    padded = np.pad(images, ((0, 0), (0, reach), (reach, reach)))
    columns = []
    for dy in range(reach + 1):
        for dx in range(-reach if dy else 0, reach + 1):
            shifted = padded[:, dy : dy + ny, reach + dx : reach + dx + nx]
            columns.append(np.einsum("ijk,ijk->i", images, shifted))
    return np.stack(columns, axis=1)


def contrast_columns(columns, time, breaks, use):
    """Return copies of the columns that differ between the segments and are the same in none.

    A common part of the coefficients is left to the columns themselves: of k segments, k - 1
    orthonormal contrasts remain.
    """
    segment = np.searchsorted(np.asarray(breaks), time, side="right")
    present = np.unique(segment[use])
    member = (segment[:, None] == present).astype(float)
    contrasts = member @ helmert(len(present)).T
    return (contrasts[:, :, None] * columns[:, None, :]).reshape(len(columns), -1)
