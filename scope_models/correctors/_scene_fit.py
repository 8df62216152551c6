"""The pixels of a series, and the fit of a scene to all of them."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy.stats import mad_std
from astropy.table import QTable

from scope_models.correctors._flux_model import smooth_series
from scope_models.correctors._pixels import UNKNOWN_NOISE, scatter
from scope_models.correctors._scene_flux import kernel_columns
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
    state_variance,
)
from scope_models.correctors._scene_start import (
    centroids,
    find_neighbors,
    first_shape,
    first_track,
)
from scope_models.exceptions import DetrendingWarning
from scope_models.io.pixels import usable_positions

__all__ = ["FEWEST_CADENCES", "WIDER", "SceneData", "SceneFit", "fit_scene", "full_columns"]

FEWEST_CADENCES = 30
#: Pixels farther from the star than this (px) are left out.
_REACH = 7
#: Cadences that constrain the shape, and number of its Gauss-Newton steps.
_SHAPE_CADENCES, _SHAPE_STEPS = 250, 8
#: Model errors relative to the light that are allowed in the steps of the shape, one after the
#: other; never below a fifth of those that are measured.
_FLOORS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
#: Prior standard deviations of positions (px) with and without POS_CORR, and of widths.
_POSITION, _FREE_POSITION, _WIDTH = 0.05, 0.3, 0.01
#: ... and of widths about their smooth course in the last step; change of width for derivatives.
_HELD, WIDER = 1e-5, 2e-3
#: A pixel is full if it is so in this part of the cadences.
_FULL_PART = 0.01
#: Scale (px) of the functions of position that errors of width and background may follow.
_ERROR_SCALE = 0.8
#: Prior standard deviations of the pixels' gains in the first steps of the shape, and later.
_GAINS = (1e-4, 1e-3, 5e-3, 0.015)
#: After these steps the priors of the PRF are about what has been found: stars at rest need it.
_ANCHORS = (2, 4, 6)
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
        Images of the target at unit flux and typical width, and of the neighbors (e-/s),
        ``(n, ny, nx)``.
    variance : ndarray
        Variance of the pixels' noise, infinite in pixels that are left out.
    wider : ndarray
        Image of the target with a PRF that is wider by `WIDER`.
    background : ndarray
        Smooth course of the background, e-/s per pixel, ``(n,)``.
    full : ndarray of bool
        Pixels of columns in which pixels saturate, ``(ny, nx)``: they are no part of the fit.
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
    wider: np.ndarray
    background: np.ndarray
    full: np.ndarray
    floor: float
    chi_squared: float


def _residual(shape, track, flux):
    images = render(shape, track)
    light = track.flux[:, None, None] * images.star + images.others
    return flux - light - track.background[:, None, None], light, images


def full_columns(flux, variance, well):
    """Mark the columns in which pixels saturate: charge bleeds along them."""
    full = np.zeros(flux.shape[1:], dtype=bool)
    if well is not None:
        often = np.mean((flux > well) & np.isfinite(variance), axis=0) > _FULL_PART
        full[:, often.any(axis=0)] = True
    return full


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


def _held(time, flux, variance, shape, track, priors, floor, full):
    """
    Return the scene with widths on a smooth course in time.

    What of width and background follows the position is an error of the pixels' model: it stays
    out of both.
    """
    good = np.isfinite(variance)
    rest, _, _ = _residual(shape, track, flux)
    chi = float(np.mean(rest[good] ** 2 / variance[good]))
    places = kernel_columns(np.stack([track.x, track.y], axis=1), _ERROR_SCALE)
    days = time - time[0]
    formal = state_variance(shape, track, flux, variance, floor)
    width = smooth_series(days, track.width, formal[:, 3], places)
    mean, sigma = priors.mean.copy(), priors.sigma.copy()
    mean[:, 3], sigma[:, 3] = width, _HELD
    track = solve_track(shape, track, flux, variance, Priors(mean, sigma), floor)
    formal = state_variance(shape, track, flux, variance, floor)
    background = smooth_series(days, track.background, formal[:, 4], places)
    images = render(shape, track)
    typical = np.full(len(flux), np.median(track.width))
    star = render(shape, replace(track, width=typical)).star
    wider = render(shape, replace(track, width=typical + WIDER)).star
    return SceneFit(
        shape, track, star, images.others, variance, wider, background, full, floor, chi
    )  # fmt: skip


def fit_scene(time, flux, variance, pos_corr, peak, *, known=None, well=None, seed=0):
    """
    Fit the scene.

    Parameters
    ----------
    time : ndarray
        Days, ``(n,)``.
    flux, variance : ndarray
        Pixels ``(n, ny, nx)`` in e-/s, finite; infinite variance where there are no data.
    pos_corr : ndarray or None
        ``(n, 2)``.
    peak : tuple of float
        Column and row of the target in a typical cadence.
    known : KnownNeighbors, optional
        Other stars; None: they are found.
    well : float, optional
        Flux in e-/s above which a pixel is full.
    seed : int
        Chooses among pixels for the first guess.
    """
    n = len(flux)
    full = full_columns(flux, variance, well)
    variance = np.where(full, np.inf, variance)
    (x, y), measured = first_track(flux, pos_corr, peak)
    shape, track = first_shape(flux, variance, x, y, np.random.default_rng(seed))
    mean, sigma = track.stacked, np.full((n, 5), np.inf)
    mean[:, 4] = 0.0
    sigma[:, 1:3] = np.where(measured, _POSITION, _FREE_POSITION)[:, None]
    sigma[:, 3] = _WIDTH
    priors, floor = Priors(mean, sigma), _FLOORS[0]

    def refit(images):
        column, row = centroids(images[::10], x[::10], y[::10])
        column, row = x + np.median(column - x[::10]), y + np.median(row - y[::10])
        return first_shape(images, variance, column, row, np.random.default_rng(seed))

    shape, track = find_neighbors(shape, track, flux, variance, known, refit)
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
        if step == 1 and measured.mean() > 0.5:
            errors = part.stacked[:, 1:3] - mean[sub, 1:3]
            tight = np.clip(1.5 * max(mad_std(errors, axis=0)), 0.003, _POSITION)
            sigma[:, 1:3] = np.where(measured, tight, _FREE_POSITION)[:, None]
            priors = Priors(mean, sigma)
        if step in _ANCHORS:
            shape = replace(shape, prior_mean=shape.coefficients)
        if stuck and step >= len(_GAINS):
            break
    floor = max(floor, _FLOORS[-1])
    clean = variance
    for _ in range(3):
        track = solve_track(shape, track, flux, clean, priors, floor)
        clean = _without_hits(shape, track, flux, variance, floor)
    return _held(time, flux, clean, shape, track, priors, floor, full)


@dataclass(frozen=True)
class SceneData:
    """
    The pixels that the scene is fitted to.

    Parameters
    ----------
    all_times : ndarray
        Times of all cadences, days.
    usable : ndarray of bool
        Cadences with time and pixels.
    time, flux, variance, pos_corr : ndarray
        Of the usable cadences and the pixels near the star; infinite variance without data.
    box : tuple of slice
        These pixels in the stamp, rows and columns.
    peak : tuple of float
        Column and row of the target within them.
    aperture : ndarray or None
        The user's aperture, of the same pixels (and cadences).
    well : float or None
        Flux of a full pixel, e-/s, if it is known.
    """

    all_times: np.ndarray
    usable: np.ndarray
    time: np.ndarray
    flux: np.ndarray
    variance: np.ndarray
    pos_corr: np.ndarray | None
    box: tuple
    peak: tuple
    aperture: np.ndarray | None
    well: float | None

    @classmethod
    def from_series(cls, series, aperture):
        """Choose cadences and pixels of a series."""
        finite, flux_err = np.isfinite(series.flux), series.flux_err
        good = finite & np.isfinite(flux_err) & (flux_err > 0)
        if finite.any() and not good.any():
            flux_err = np.broadcast_to(scatter(series.flux), finite.shape)
            good = finite & (flux_err > 0)
            warnings.warn(UNKNOWN_NOISE, DetrendingWarning, stacklevel=3)
        collected = good.any(axis=0)
        if not collected.any():
            raise ValueError("`tpf` has no pixels with data")
        usable = np.isfinite(series.time) & (good[:, collected].mean(axis=1) > 0.5)
        moving = np.ndim(aperture) == 3
        if moving:
            usable &= np.isfinite(aperture).all(axis=(1, 2))
        if usable.sum() < FEWEST_CADENCES:
            raise ValueError(
                f"at least {FEWEST_CADENCES} usable cadences are needed, got {usable.sum()}"
            )
        time = series.time[usable]
        if np.any(np.diff(time) <= 0):
            raise ValueError("the times of `tpf` must increase")
        flux = np.where(good, series.flux, 0.0)[usable]
        variance = np.where(good, np.where(good, flux_err, 1.0) ** 2, np.inf)[usable]
        pos_corr, reach = None, 3.0
        if series.pos_corr is not None:
            known = usable_positions(series.pos_corr)
            pos_corr = np.where(known[:, None], series.pos_corr, np.nan)[usable]
            if known[usable].any():
                reach = float(np.nanmax(np.abs(pos_corr - np.nanmedian(pos_corr, axis=0))))
        mean = np.median(flux, axis=0)
        inside = aperture
        if aperture is None:
            inside = series.aperture
        elif moving:
            inside = np.max(aperture[usable], axis=0) > 0
        row, column = np.unravel_index(np.argmax(np.where(inside, mean, -np.inf)), mean.shape)
        box = tuple(
            slice(max(0, int(k - _REACH - reach)), min(size, int(k + _REACH + reach + 2)))
            for k, size in zip((row, column), mean.shape, strict=True)
        )
        cut = (slice(None), *box)
        peak = (float(column - box[1].start), float(row - box[0].start))
        return cls(
            series.time, usable, time, flux[cut], variance[cut], pos_corr, box, peak,
            aperture[usable][cut] if moving else (None if aperture is None else aperture[box]),
            series.mission and series.mission.full_flux,
        )  # fmt: skip

    @property
    def origin(self):
        """Column and row of the box' first pixel in the stamp."""
        return np.array([self.box[1].start, self.box[0].start], dtype=float)

    @property
    def place(self):
        """Column and row of the target's light in the stamp, in the median image."""
        image = np.median(self.flux, axis=0)[None]
        x, y = centroids(image - np.median(image), *(np.array([k]) for k in self.peak))
        return self.origin + np.array([x[0], y[0]])

    @property
    def noise(self):
        """Typical variance of each pixel; infinite without data."""
        typical = np.median(self.variance, axis=0)
        return np.where(np.isfinite(typical), typical, np.inf)

    def table(self, scene):
        """Return the neighbors of a scene."""
        flux, dx, dy = scene.shape.neighbors.T
        x, y = (float(np.median(v)) for v in (scene.track.x, scene.track.y))
        return QTable(
            [flux, dx + x + self.box[1].start, dy + y + self.box[0].start],
            names=("flux", "x", "y"),
            units=("electron / s", "pix", "pix"),
        )
