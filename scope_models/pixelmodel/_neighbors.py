"""The light of a star's neighbors, by a model of all pixels near it."""

import numpy as np
from astropy.stats import mad_std

from scope_models.pixelmodel._position import nearness
from scope_models.pixelmodel._scene import (
    MEDIAN_SQUARE,
    Priors,
    between,
    changed_light,
    improve_shape,
    measure_floor,
    misfit,
    neighbor_images,
    residuals,
    solve_states,
    solve_track,
    without_level,
)
from scope_models.pixelmodel._smoothing import CLIP, Smoother
from scope_models.pixelmodel._start import (
    NEAREST,
    KnownNeighbors,
    NoLightError,
    centroids,
    find_neighbors,
    first_shape,
    first_track,
    separate,
)

__all__ = ["fit_neighbors"]

#: Tolerance: cadences that constrain the shape, and largest number of its steps.
_SHAPE_CADENCES, _SHAPE_STEPS = 250, 40
#: Tolerance: model errors relative to the light that are allowed in the steps of the shape, one
#: after the other; never below a fifth of those that are measured.
_FLOORS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
#: Prior: standard deviations of positions (px) with and without POS_CORR, and of widths.
_POSITION, _FREE_POSITION, _WIDTH = 0.05, 0.3, 0.01
#: Prior: ... and of widths about their smooth course.
_HELD = 1e-5
#: Prior: standard deviations of the pixels' gains in the first steps of the shape, and later.
_GAINS = (1e-4, 1e-3, 5e-3, 0.015)
#: Branch: outliers in less than this part of the cadences are cosmic rays.
_MOST_HITS = 0.05


def fit_neighbors(time, flux, variance, pos_corr, peak, use, known, others, only=False, place=None):
    """
    Return shape, track, and the neighbors' light; None without any.

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
    others : ndarray of bool
        Pixels that are of other stars.
    only : bool
        Whether other stars are found in these pixels alone.
    place : ndarray or None
        Column and row of the target by the file's coordinates: if another one of the stars that are
        found is there, that is the target.

    Raises
    ------
    NoLightError
        If the model describes other stars than the one at the peak and those that were found.
    """
    n, pixels = len(flux), (flux[use], variance[use])
    # a first guess without the light around known neighbors, or in pixels of others
    theirs = others | known.nearer(peak, flux.shape[1:]) if known else others
    (x, y), measured = first_track(np.where(theirs, 0.0, flux), pos_corr, peak)
    refit = _first_models(pixels[1], x[use], y[use], theirs, follow=not measured.any())
    shape, track = refit(pixels[0])
    places = others if only else np.ones_like(others)
    shape, track = find_neighbors(shape, track, *pixels, known, refit, places)
    if not len(shape.neighbors):
        return None
    other = None if place is None else _another_target(shape, track, place)
    if other:
        peak, known = other
        return fit_neighbors(time, flux, variance, pos_corr, peak, use, known, others)
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
    steady = flux[sub]
    part = solve_track(shape, part, steady, noise, priors[sub], schedule)
    for step in range(_SHAPE_STEPS):
        gain = _GAINS[min(step, len(_GAINS) - 1)]
        shape, part, stuck = _step(shape, part, (steady, noise, priors[sub], schedule), gain)
        change = _varying(shape, part, flux[sub], noise, priors[sub], schedule, ...)[1]
        steady = flux[sub] - changed_light(shape, part, change - np.median(change, axis=0))
        floor = measure_floor(shape, part, steady, variance[sub])
        schedule = max(_FLOORS[min(step + 1, len(_FLOORS) - 1)], floor / 5)
        if step >= 1:
            noise = _without_hits(shape, part, steady, variance[sub], floor)
        if step == 1 and measured.mean() > 0.5:
            errors = part.stacked[:, 1:3] - start[sub, 1:3]
            tight = np.clip(1.5 * max(mad_std(errors, axis=0)), 0.003, _POSITION)
            sigma[:, 1:3] = np.where(measured, tight, _FREE_POSITION)[:, None]
        if stuck and step > len(_GAINS):
            break
    apart = separate(shape.neighbors, 0.0)
    if known is None and not apart.all():  # the others were bumps of the PRF, or parts of these
        stars = np.median(part.stacked[:, 1:3], axis=0) + shape.neighbors[apart, 1:]
        return fit_neighbors(
            time, flux, variance, pos_corr, peak, use, KnownNeighbors(stars, None), others
        )
    floor = max(floor, _FLOORS[-1])
    track = solve_track(shape, type(track)(*start.T), flux, variance, priors, floor)
    clean = _without_hits(shape, track, flux, variance, floor)
    if np.hypot(*(np.median(track.stacked[use, 1:3], axis=0) - peak)) > NEAREST:
        raise NoLightError("the model has left the target")
    track, change = _with_smooth_widths(time, shape, track, flux, clean, priors, floor, use)
    return shape, track, np.array(neighbor_images(shape, track, change))


def _another_target(shape, track, place):
    """Return the place of a neighbor that is the target by its coordinates, and the other stars.

    None if the target is that.
    """
    stars = np.pad(shape.neighbors, ((1, 0), (0, 0)))
    stars[0, 0] = np.median(track.flux)
    stars[:, 1:] += np.median(track.stacked[:, 1:3], axis=0)
    best = np.argmax(stars[:, 0] * nearness(*(stars[:, 1:] - place).T))
    if not best:
        return None
    target, stars = stars[best, 1:], np.delete(stars, best, axis=0)
    apart = separate(stars - [0.0, *target], 0.0)
    return target, KnownNeighbors(stars[apart, 1:], None)


def _first_models(variance, x, y, others, *, follow):
    """Return a function that makes a first model of the target from images.

    It leaves out pixels, those of others in any case, and takes positions to be near x and y but
    for a shift, or to ``follow`` the images.
    """
    some = slice(None, None, 1 if follow else 10)

    def make(images, left_out=False):
        left_out = left_out | others
        moved = centroids(np.where(left_out, 0.0, images)[some], x[some], y[some])
        if not follow:
            moved = [a + np.median(b - a[some]) for a, b in zip((x, y), moved, strict=True)]
        own = np.where(left_out, np.inf, variance)
        return first_shape(images, own, *moved, np.random.default_rng(0))

    return make


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
    hit = deviation > CLIP
    often = hit.mean(axis=0) > _MOST_HITS  # here the model errs
    return np.where(hit & ~often, np.inf, variance)


def _with_smooth_widths(time, shape, track, flux, variance, priors, floor, use):
    """Fit states and changes as `_varying`, of which the widths follow a smooth course."""
    mean, sigma = priors.mean.copy(), priors.sigma.copy()
    sigma[:, 3] = np.inf
    track, _, error = _varying(shape, track, flux, variance, Priors(mean, sigma), floor, use)
    mean[:, 3], sigma[:, 3] = Smoother(time, use)(track.width, error[:, 3])[0], _HELD
    return _varying(shape, track, flux, variance, Priors(mean, sigma), floor, use)[:2]


def _varying(shape, track, flux, variance, priors, floor, use):
    """Fit the states, and changes of the neighbors' fluxes, as `solve_states`.

    The variance of each neighbor's flux is what its values have beyond their errors, so that a
    constant one stays constant.
    """
    change = np.zeros((len(flux), len(shape.neighbors)))
    mean = np.concatenate([priors.mean, change], axis=1)
    sigma = np.concatenate([priors.sigma, np.full_like(change, np.inf)], axis=1)
    data = flux, variance
    track, change, error = solve_states(shape, track, change, *data, Priors(mean, sigma), floor)
    middle = np.median(change[use], axis=0)
    noise = np.median(error[use, 5:] ** 2, axis=0)
    size = np.median((change[use] - middle) ** 2, axis=0) / MEDIAN_SQUARE
    mean[:, 5:] = middle
    sigma[:, 5:] = np.sqrt(np.maximum(size - noise, 1e-6 * noise))
    return solve_states(shape, track, change, *data, Priors(mean, sigma), floor)
