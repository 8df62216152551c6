"""Light of other stars in a star's pixels, by a model of all of them."""

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from astropy.stats import mad_std
from astropy.table import QTable

from scope_models.correctors._position import polynomials
from scope_models.correctors._scene_model import (
    MEDIAN_SQUARE,
    Priors,
    between,
    improve_shape,
    measure_floor,
    misfit,
    neighbor_images,
    residuals,
    solve_states,
    solve_track,
    without_level,
)
from scope_models.correctors._scene_start import (
    NEAREST,
    KnownNeighbors,
    NoLightError,
    centroids,
    find_neighbors,
    first_shape,
    first_track,
    in_places,
)
from scope_models.correctors._smoothing import Smoother
from scope_models.io.pixels import read_neighbors, usable_positions

__all__ = ["NeighborLight", "given_neighbors", "light_of_neighbors", "without_neighbors"]

#: Tolerance: pixels farther from the star than this (px) are left out.
_REACH = 7
#: Tolerance: cadences that constrain the shape, and number of its Gauss-Newton steps.
_SHAPE_CADENCES, _SHAPE_STEPS = 250, 8
#: Tolerance: model errors relative to the light that are allowed in the steps of the shape, one
#: after the other; never below a fifth of those that are measured.
_FLOORS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
#: Prior: standard deviations of positions (px) with and without POS_CORR, and of widths.
_POSITION, _FREE_POSITION, _WIDTH = 0.05, 0.3, 0.01
#: Prior: ... and of widths about their smooth course.
_HELD = 1e-5
#: Prior: standard deviations of the pixels' gains in the first steps of the shape, and later.
_GAINS = (1e-4, 1e-3, 5e-3, 0.015)
#: Tolerance: after these steps the priors of the PRF are about what has been found: stars at rest
#: need it.
_ANCHORS = (2, 4, 6)
#: Branch: pixels that deviate by more standard deviations are left out, in less than this part of
#: the cadences.
_SIGMA, _MOST_HITS = 6.0, 0.05
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
    """Return the typical image, and row and column of the brightest pixel in the aperture."""
    image = np.median(np.nan_to_num(pixels.flux[pixels.usable]), axis=0)
    inside = np.where(pixels.aperture, image, -np.inf)
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
    pos_corr, reach = None, 3.0
    if series.pos_corr is not None:
        known = usable_positions(series.pos_corr)
        pos_corr = np.where(known[:, None], series.pos_corr, np.nan)[usable]
        if known[usable].any():
            reach = float(np.nanmax(np.abs(pos_corr - np.nanmedian(pos_corr, axis=0))))
    apart = neighbors is None and _holds_constant_light(pixels, usable, pos_corr)
    if neighbors is None and not apart and pixels.own.all():
        return None
    typical, peak = _peak(pixels)
    box = tuple(
        slice(max(0, int(k - _REACH - reach)), min(size, int(k + _REACH + reach + 2)))
        for k, size in zip(peak, typical.shape, strict=True)
    )
    flux, error = pixels.flux[usable][:, *box], pixels.flux_err[usable][:, *box]
    good = np.isfinite(flux) & (error > 0)
    good[pixels.banded[usable]] = False
    flux, variance = np.where(good, flux, 0.0), np.where(good, error, np.inf) ** 2
    origin = np.array([box[1].start, box[0].start])
    peak = np.array(peak[::-1]) - origin
    known = neighbors.within(origin) if given else None
    peaks = ~pixels.own[box]
    places = peaks if neighbors is None and not apart else None
    try:
        found = _fit(pixels.time[usable], flux, variance, pos_corr, peak, use, known, places)
    except (NoLightError, np.linalg.LinAlgError):
        if not given:
            return None
        message = "the target and the given `neighbors` do not describe the pixels"
        raise ValueError(message) from None
    if found is None:
        return None
    shape, track, others, steady = found
    keep = np.ones(len(others), dtype=bool)
    if apart:
        keep = steady | in_places(peaks, track[use], *shape.neighbors[:, 1:].T)
    others, stars = others[keep].sum(axis=0), shape.neighbors[keep]
    inside = pixels.aperture[box]
    part = np.median(others[:, inside].sum(axis=1) / pixels.total[usable])
    # pixels from which the light rises to the target's peak are mostly its own
    if not keep.any() or not (given or 0 <= part <= 0.5):
        return None
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


def _step(shape, track, data, gain):
    """Improve shape and states, by less than a whole Gauss-Newton step if that is too much."""
    before = misfit(shape, track, *data, gain)
    whole = improve_shape(shape, track, *data, gain)
    for part in (1.0, 0.4, 0.15):
        trial = between(shape, whole, part)
        moved = solve_track(trial, track, *data, steps=2)
        after = misfit(trial, moved, *data, gain)
        if after < before:
            return trial, moved, after > 0.99 * before
    return shape, track, True


def _without_hits(shape, track, flux, variance, floor):
    """Return the variances, infinite in the few pixels that deviate, as cosmic rays do."""
    rest, light = residuals(shape, track, flux)
    deviation = np.abs(rest) / np.sqrt(variance + (4 * floor * light) ** 2)
    hit = deviation > _SIGMA
    often = hit.mean(axis=0) > _MOST_HITS  # here the model errs
    return np.where(hit & ~often, np.inf, variance)


def _fit(time, flux, variance, pos_corr, peak, use, known, places):
    """
    Return shape, track, the neighbors' light, and which do not follow the star; None without any.

    Parameters
    ----------
    time : ndarray
        Days, ``(n,)``.
    flux, variance : ndarray
        Pixels ``(n, ny, nx)`` in e-/s, finite; infinite variance where there are no data.
    pos_corr : ndarray or None
        ``(n, 2)``.
    peak : ndarray
        Column and row of the target in a typical cadence.
    use : ndarray of bool
        Cadences from which the shape is learned.
    known : KnownNeighbors or None
        Other stars; None: they are found.
    places : ndarray of bool or None
        Pixels in which they may be.

    Raises
    ------
    NoLightError
        If the model describes another star than the one at the peak.
    """
    n, rng = len(flux), np.random.default_rng(0)
    pixels = flux[use], variance[use]
    # a first guess without the light around known neighbors
    theirs = False if known is None else known.nearer(peak, flux.shape[1:])
    (x, y), measured = first_track(np.where(theirs, 0.0, flux), pos_corr, peak)
    own = np.where(theirs, np.inf, pixels[1])
    shape, track = first_shape(pixels[0], own, x[use], y[use], rng)

    def refit(images):
        some = images[::10], x[use][::10], y[use][::10]
        shifts = (np.median(c - s) for c, s in zip(centroids(*some), some[1:], strict=True))
        column, row = (s[use] + shift for s, shift in zip((x, y), shifts, strict=True))
        return first_shape(images, variance[use], column, row, np.random.default_rng(0))

    shape, track = find_neighbors(shape, track, *pixels, known, refit, places)
    if not len(shape.neighbors):
        return None
    shift = np.median(track.stacked[:, 1:3] - np.column_stack([x, y])[use], axis=0)
    start = np.zeros((n, 5))
    start[:, 0] = np.median(track.flux)
    start[:, 1:3] = np.column_stack([x, y]) + shift
    sigma = np.full((n, 5), np.inf)
    sigma[:, 1:3] = np.where(measured, _POSITION, _FREE_POSITION)[:, None]
    sigma[:, 3] = _WIDTH
    sub = np.flatnonzero(use)
    sub = sub[np.unique(np.linspace(0, len(sub) - 1, _SHAPE_CADENCES).astype(int))]
    noise, schedule = variance[sub], _FLOORS[0]
    priors = Priors(start, sigma)
    part = type(track)(*start[sub].T)
    shape = without_level(shape, part[::10])
    part = solve_track(shape, part, flux[sub], noise, priors[sub], schedule)
    for step in range(_SHAPE_STEPS):
        gain = _GAINS[min(step, len(_GAINS) - 1)]
        shape, part, stuck = _step(shape, part, (flux[sub], noise, priors[sub], schedule), gain)
        floor = measure_floor(shape, part, flux[sub], variance[sub])
        schedule = max(_FLOORS[min(step + 1, len(_FLOORS) - 1)], floor / 5)
        if step >= 1:
            noise = _without_hits(shape, part, flux[sub], variance[sub], floor)
        if step == 1 and measured.mean() > 0.5:
            errors = part.stacked[:, 1:3] - start[sub, 1:3]
            tight = np.clip(1.5 * max(mad_std(errors, axis=0)), 0.003, _POSITION)
            sigma[:, 1:3] = np.where(measured, tight, _FREE_POSITION)[:, None]
        if step in _ANCHORS:
            shape = replace(shape, prior_mean=shape.coefficients)
        if stuck and step >= len(_GAINS):
            break
    floor = max(floor, _FLOORS[-1])
    track = solve_track(shape, type(track)(*start.T), flux, variance, priors, floor)
    clean = _without_hits(shape, track, flux, variance, floor)
    if np.hypot(*(np.median(track.stacked[use, 1:3], axis=0) - peak)) > NEAREST:
        raise NoLightError("the model has left the target")
    track, change, steady = _varying(time, shape, track, flux, clean, priors, floor, use)
    return shape, track, np.array(neighbor_images(shape, track, change)), steady


def _varying(time, shape, track, flux, variance, priors, floor, use):
    """
    Fit the states with smooth widths, and neighbors that may vary; find those that stay constant.

    The variance of each neighbor's flux is what its values have beyond their errors, so that a
    constant one stays constant.
    """
    m = len(shape.neighbors)
    change = np.zeros((len(flux), m))
    mean = np.concatenate([priors.mean, change], axis=1)
    sigma = np.concatenate([priors.sigma, np.full_like(change, np.inf)], axis=1)
    sigma[:, 3] = np.inf
    data = flux, variance
    track, change, error = solve_states(shape, track, change, *data, Priors(mean, sigma), floor)
    mean[:, 3], sigma[:, 3] = Smoother(time, use)(track.width, error[:, 3]), _HELD
    track, change, error = solve_states(shape, track, change, *data, Priors(mean, sigma), floor)
    slope, spread = _followed(shape.neighbors[:, 0] + change, error[:, 5:], track)
    steady = np.abs(slope) + _SEEN * spread < 0.5
    middle = np.median(change[use], axis=0)
    noise = np.median(error[use, 5:] ** 2, axis=0)
    size = np.median((change[use] - middle) ** 2, axis=0) / MEDIAN_SQUARE
    mean[:, 5:] = middle
    sigma[:, 5:] = np.sqrt(np.maximum(size - noise, 1e-6 * noise))
    track, change, error = solve_states(shape, track, change, *data, Priors(mean, sigma), floor)
    # what follows the star is the star's, as far as it is seen
    flux = shape.neighbors[:, 0] + change
    slope, spread = _followed(flux, error[:, 5:], track)
    total = track.flux + flux.sum(axis=1)
    slope *= slope**2 / (slope**2 + spread**2) * np.median(flux, axis=0)
    return track, change - slope * (total / np.median(total) - 1)[:, None], steady


def _jackknifed(columns, values):
    """Return coefficients ``(n_columns, n_values)``, and their errors by leaving parts out."""
    parts = np.array_split(np.arange(len(columns)), _PARTS)
    gram = np.array([columns[k].T @ columns[k] for k in parts])
    right = np.array([columns[k].T @ values[k] for k in parts])
    ridge = 1e-10 * np.diag(np.maximum(np.diag(gram.sum(axis=0)), 1e-300))
    whole = np.linalg.solve(gram.sum(axis=0) + ridge, right.sum(axis=0))
    without = np.linalg.solve(gram.sum(axis=0) - gram + ridge, right.sum(axis=0) - right)
    return whole, np.sqrt((1 - 1 / _PARTS) * np.sum((without - without.mean(axis=0)) ** 2, axis=0))


def _holds_constant_light(pixels, usable, pos_corr):
    """Return whether the star varies, and pixels of its aperture hold light that does not.

    A star's pixels are its light times functions of position. Centroids follow constant light, so
    that only POS_CORR counts. The star varies if that is more than errors of POS_CORR make.
    """
    total = pixels.total[usable] / np.median(pixels.total[usable])
    light = np.nan_to_num(pixels.flux[usable][:, pixels.aperture]) / np.median(pixels.total[usable])
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
    constant, error = (values[0] for values in _jackknifed(columns, light))
    return bool((np.abs(constant) > _SEEN * error).any())


def _followed(flux, error, track):
    """Return by how much neighbors' fluxes vary with all light, both relative, and the errors.

    The light of what is part of the star varies with it. What positions do to both is left out.
    """
    total = track.flux + flux.sum(axis=1)
    offset = track.stacked[:, 1:3] - np.median(track.stacked[:, 1:3], axis=0)
    columns = np.column_stack([total, polynomials(offset / max(np.abs(offset).max(), 1e-9))])
    out = [
        [k[0, 0] for k in _jackknifed(columns / noise[:, None], (values / noise)[:, None])]
        for values, noise in zip(flux.T, error.T, strict=True)
    ]
    return np.transpose(out) * np.median(total) / np.abs(np.median(flux, axis=0))
