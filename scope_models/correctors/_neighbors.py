"""Light of other stars in a star's pixels, by a model of all of them."""

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from astropy.table import QTable

from scope_models.correctors._pixels import without_background
from scope_models.io.pixels import read_neighbors, usable_positions
from scope_models.pixelmodel._neighbors import fit_neighbors
from scope_models.pixelmodel._position import polynomials
from scope_models.pixelmodel._start import KnownNeighbors, NoLightError, centroids

__all__ = ["NeighborLight", "given_neighbors", "light_of_neighbors", "without_neighbors"]

#: Branch: standard deviation from which on a star varies: what its position is uncertain by
#: (0.02 px) times the change of the aperture's light with position (0.05 per px).
_VARIES = 0.02 * 0.05
#: Branch: standard deviations of what counts as seen, by a jackknife of so many parts of the time.
_SEEN, _PARTS = 3.0, 10


@dataclass(frozen=True, eq=False)
class NeighborLight:
    """Other stars of a stamp.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Flux (e-/s), column and row in the stamp (px) of each, ``flux, x, y``.
    light : ndarray
        Their light in each pixel, e-/s, ``(n_cadences, ny, nx)``.
    positions : ndarray
        Column and row of the target in the stamp, ``(n_cadences, 2)``, px; NaN where unknown.
    """

    table: QTable
    light: np.ndarray
    positions: np.ndarray


def without_neighbors(pixels, series, found):
    """Return pixels and file without the light of other stars; with positions if it has none."""
    flux = pixels.flux - found.light
    inside = pixels.aperture if pixels.weights is None else pixels.weights
    light = np.sum(found.light * inside, axis=(1, 2))
    total = pixels.total - light
    usable = pixels.usable & (np.nan_to_num(total) > 0)
    share = float(np.median((total / pixels.total)[usable])) if usable.any() else 1.0
    pixels = replace(
        pixels, flux=flux, total=total, usable=usable, lit=pixels.lit & usable,
        own=np.ones_like(pixels.aperture), crowding=min(share, 1.0), neighbors=found,
    )  # fmt: skip
    positions = series.pos_corr
    if positions is None or not usable_positions(positions).any():
        positions = found.positions - np.nanmedian(found.positions, axis=0)
    return pixels, series.replace(flux=flux, pos_corr=positions)


def given_neighbors(neighbors, series, pixels):
    """Return "find", or the neighbors of a user: a file, or as `star_places` takes them."""
    if isinstance(neighbors, str | PathLike):
        if neighbors == "find":
            return neighbors
        if not Path(neighbors).is_file():
            accepted = '"find", positions, a table, or the file of a table'
            raise ValueError(f"`neighbors` must be {accepted}, got {str(neighbors)!r}")
        neighbors = read_neighbors(neighbors, series)
    image, peak = _peak(pixels)
    start = (np.array([float(k)]) for k in peak[::-1])
    place = np.ravel(centroids(image[None] - np.median(image), *start))
    return KnownNeighbors.read(neighbors, series, place)


def _peak(pixels):
    """Return the typical image, and row and column of the target's brightest pixel."""
    image = np.median(np.nan_to_num(pixels.flux[pixels.usable]), axis=0)
    inside = np.where(pixels.core, image, -np.inf)
    return image, np.unravel_index(np.argmax(inside), image.shape)


def light_of_neighbors(pixels, series, cadence_mask, neighbors=None):
    """Fit the target and its neighbors to the pixels near it.

    Parameters
    ----------
    pixels : Pixels
        Pixels and aperture.
    series : PixelSeries
        Their file.
    cadence_mask : ndarray of bool
        Cadences from which the stars' image and places are learned.
    neighbors : KnownNeighbors or "find", optional
        Other stars. None: those with peaks of their own are found, and those whose light does not
        follow the star's, for the bumps of a PRF look like neighbors of up to 20 % of a star's
        light (official PRFs of TESS, camera 2, CCD 3); "find": all.

    Returns
    -------
    NeighborLight or None
        None if there are none.

    Raises
    ------
    ValueError
        If given neighbors do not fit the file, or do not describe its pixels.
    """
    given = isinstance(neighbors, KnownNeighbors)
    usable = np.flatnonzero(pixels.usable)
    use = pixels.quiet(cadence_mask & pixels.lit)[usable]
    total = pixels.total[usable]
    use &= total > np.median(total[use]) / 2  # what is left in eclipses may be of others
    pos_corr = None
    if series.pos_corr is not None:
        known = usable_positions(series.pos_corr)
        pos_corr = np.where(known[:, None], series.pos_corr, np.nan)[usable]
    light = without_background(pixels.flux[usable])
    apart = neighbors is None and _holds_constant_light(light[:, pixels.aperture], pos_corr)
    if neighbors is None and not apart and pixels.own.all():
        return None
    typical, peak = _peak(pixels)
    box = pixels.near
    flux, error = light[:, *box], pixels.flux_err[usable][:, *box]
    good = np.isfinite(flux) & (error > 0)
    good[pixels.banded[usable]] = False
    flux, variance = np.where(good, flux, 0.0), np.where(good, error, np.inf) ** 2
    origin = np.array([box[1].start, box[0].start])
    peak = np.array(peak[::-1]) - origin
    place = None if given or pixels.place is None else pixels.place - origin
    known = neighbors.within(origin) if given else None
    only = neighbors is None and not apart
    try:
        data = pixels.time[usable], flux, variance, pos_corr
        found = fit_neighbors(*data, peak, use, known, ~pixels.own[box], only, place)
    except (NoLightError, np.linalg.LinAlgError):
        if not given:
            return None
        message = "the target and the given `neighbors` do not describe the pixels"
        raise ValueError(message) from None
    inside = pixels.aperture[box]
    if found is None or not (
        given or _is_credible(found, peak, flux, use, inside, inside & pixels.own[box])
    ):
        return None
    shape, track, others = found
    others, stars = others.sum(axis=0), shape.neighbors
    light = np.zeros(pixels.flux.shape)
    part = np.zeros((len(usable), *typical.shape))
    part[:, *box] = others
    light[usable] = part
    positions = np.full((len(pixels.time), 2), np.nan)
    positions[usable] = origin + track.stacked[:, 1:3]
    places = stars[:, 1:] + np.median(positions[usable][use], axis=0)
    units = ("electron / s", "pix", "pix")
    table = QTable([stars[:, 0], *places.T], names=("flux", "x", "y"), units=units)
    return NeighborLight(table, light, positions)


def _is_credible(found, peak, flux, use, inside, own):
    """Return whether the light of found neighbors may be taken off.

    Without it the light in the aperture does not vary more than with it, and others have no more
    than half of the pixels from which the light rises to the target's peak, if that is its own.
    """
    shape, track, others = found
    others, flux = others.sum(axis=0)[use], flux[use]
    whole, left = (values[:, inside].sum(axis=1) for values in (flux, flux - others))
    if left.std() > np.sqrt(2) * whole.std():
        return False
    away = np.median(track.stacked[:, 1:3], axis=0) - peak
    nearer = np.hypot(*(shape.neighbors[:, 1:] + away).T) < np.hypot(*away)
    return bool(nearer.any() or 0 <= others[:, own].sum() <= flux[:, own].sum() / 2)


def _holds_constant_light(light, pos_corr):
    """Return whether a star varies, and pixels of its aperture, ``(n, m)``, hold constant light.

    A star's pixels are its light times functions of position. Centroids follow constant light, so
    that only POS_CORR counts. The star varies if that is more than errors of POS_CORR make.
    """
    light = np.nan_to_num(light)
    total = light.sum(axis=1)
    light, total = light / np.median(total), total / np.median(total)
    functions = np.ones((len(total), 1))
    if pos_corr is not None and np.isfinite(pos_corr).all(axis=1).mean() > 0.5:
        known = np.isfinite(pos_corr).all(axis=1)
        total, light = total[known], light[known]
        offset = pos_corr[known] - np.median(pos_corr[known], axis=0)
        functions = polynomials(offset / max(np.abs(offset).max(), 1e-9))
    columns = np.column_stack([np.ones(len(total)), functions * total[:, None]])
    if len(total) < _PARTS * columns.shape[1]:
        return False
    rest = total - functions @ np.linalg.lstsq(functions, total, rcond=None)[0]
    if np.var(rest) - np.mean(np.diff(rest) ** 2) / 2 < _VARIES**2:
        return False
    parts = np.array_split(np.arange(len(columns)), _PARTS)
    gram = np.array([columns[k].T @ columns[k] for k in parts])
    right = np.array([columns[k].T @ light[k] for k in parts])
    ridge = 1e-10 * np.diag(np.maximum(np.diag(gram.sum(axis=0)), 1e-300))
    constant = np.linalg.solve(gram.sum(axis=0) + ridge, right.sum(axis=0))[0]
    without = np.linalg.solve(gram.sum(axis=0) - gram + ridge, right.sum(axis=0) - right)[:, 0]
    error = np.sqrt((1 - 1 / _PARTS) * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    return bool((np.abs(constant) > _SEEN * error).any())
