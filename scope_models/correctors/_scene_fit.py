"""The fit of a scene to all pixels of a series."""

from dataclasses import dataclass

import numpy as np

from scope_models.correctors._scene_model import (
    Priors,
    Shape,
    Track,
    between,
    improve_shape,
    measure_floor,
    misfit,
    render,
    solve_track,
)
from scope_models.correctors._scene_neighbors import find_neighbors
from scope_models.correctors._scene_start import centroids, first_shape, first_track

__all__ = ["SceneFit", "fit_scene"]

#: Cadences that constrain the shape, and number of its Gauss-Newton steps.
_SHAPE_CADENCES, _SHAPE_STEPS = 250, 8
#: Model errors relative to the light that are allowed in the steps of the shape, one after the
#: other; never below a fifth of those that are measured.
_FLOORS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
#: Prior standard deviations of positions (px) with and without POS_CORR, and of widths.
_POSITION, _FREE_POSITION, _WIDTH = 0.05, 0.3, 0.01
#: Prior standard deviations of the pixels' gains in the first steps of the shape, and later.
_GAINS = (1e-4, 1e-3, 5e-3, 0.015)
#: Pixels that deviate by more standard deviations are left out, in less than this part of the
#: cadences.
_SIGMA, _MOST_HITS = 6.0, 0.05


@dataclass(frozen=True)
class SceneFit:
    """
    A fitted scene.

    Parameters
    ----------
    shape : Shape
        What all cadences share.
    track : Track
        The state of each cadence.
    star, others : ndarray
        Images of the target at unit flux and of the neighbors (e-/s), ``(n, ny, nx)``.
    variance : ndarray
        Variance of the pixels' noise, infinite in pixels that are left out.
    floor : float
        Model errors relative to the stars' light.
    chi_squared : float
        Mean square of the residuals in units of the noise.
    """

    shape: Shape
    track: Track
    star: np.ndarray
    others: np.ndarray
    variance: np.ndarray
    floor: float
    chi_squared: float


def _robust(values):
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _residual(shape, track, flux):
    images = render(shape, track)
    light = track.flux[:, None, None] * images.star + images.others
    return flux - light - track.background[:, None, None], light, images


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
    rest, light, _ = _residual(shape, track, flux)
    deviation = np.abs(rest) / np.sqrt(variance + (4 * floor * light) ** 2)
    hit = deviation > _SIGMA
    often = hit.mean(axis=0) > _MOST_HITS  # here the model errs
    return np.where(hit & ~often, np.inf, variance)


def fit_scene(flux, variance, pos_corr, peak, *, offsets=None, seed=0):
    """
    Fit the scene.

    Parameters
    ----------
    flux, variance : ndarray
        Pixels ``(n, ny, nx)`` in e-/s, finite; infinite variance where there are no data.
    pos_corr : ndarray or None
        ``(n, 2)``.
    peak : tuple of float
        Column and row of the target in a typical cadence.
    offsets : ndarray, optional
        Distances of other stars from the target, px, ``(m, 2)``; None: they are found.
    seed : int
        Chooses among pixels for the first guess.
    """
    n = len(flux)
    (x, y), known = first_track(flux, pos_corr, peak)
    shape, track = first_shape(flux, variance, x, y, np.random.default_rng(seed))
    mean, sigma = track.stacked, np.full((n, 5), np.inf)
    mean[:, 4] = 0.0
    sigma[:, 1:3] = np.where(known, _POSITION, _FREE_POSITION)[:, None]
    sigma[:, 3] = _WIDTH
    priors, floor = Priors(mean, sigma), _FLOORS[0]

    def refit(images):
        column, row = centroids(images[::10], x[::10], y[::10])
        column, row = x + np.median(column - x[::10]), y + np.median(row - y[::10])
        return first_shape(images, variance, column, row, np.random.default_rng(seed))

    shape, track = find_neighbors(shape, track, flux, variance, offsets, refit)
    mean[:, 1:3] = track.stacked[:, 1:3]
    track = solve_track(shape, track, flux, variance, priors, floor)
    sub = np.unique(np.linspace(0, n - 1, _SHAPE_CADENCES).astype(int))
    part, noise, schedule = track[sub], variance[sub], _FLOORS[0]
    for step in range(_SHAPE_STEPS):
        gain = _GAINS[min(step, len(_GAINS) - 1)]
        data = (flux[sub], noise, priors[sub], schedule)
        shape, part, stuck = _step(shape, part, data, gain)
        floor = measure_floor(shape, part, flux[sub], variance[sub])
        schedule = max(_FLOORS[min(step + 1, len(_FLOORS) - 1)], floor / 5)
        if step >= 1:
            noise = _without_hits(shape, part, flux[sub], variance[sub], floor)
        if step == 1 and known.mean() > 0.5:
            errors = part.stacked[:, 1:3] - mean[sub, 1:3]
            tight = np.clip(1.5 * max(_robust(e) for e in errors.T), 0.003, _POSITION)
            sigma[:, 1:3] = np.where(known, tight, _FREE_POSITION)[:, None]
            priors = Priors(mean, sigma)
        if stuck and step >= len(_GAINS):
            break
    floor = max(floor, _FLOORS[-1])
    clean = variance
    for _ in range(3):
        track = solve_track(shape, track, flux, clean, priors, floor)
        clean = _without_hits(shape, track, flux, variance, floor)
    rest, _, images = _residual(shape, track, flux)
    good = np.isfinite(clean)
    chi = float(np.mean(rest[good] ** 2 / clean[good]))
    return SceneFit(shape, track, images.star, images.others, clean, floor, chi)
