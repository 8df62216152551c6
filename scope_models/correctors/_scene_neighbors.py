"""Other stars in the stamp: found in the images, or given by the user."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy.coordinates import SkyCoord

from scope_models.correctors._scene_model import render
from scope_models.correctors._scene_start import NoLightError
from scope_models.exceptions import DetrendingWarning
from scope_models.io.pixels import star_places, target_place

__all__ = ["KnownNeighbors", "find_neighbors"]

#: Given neighbors closer to the target (px) are the target, and those farther outside of the
#: pixels have no light in them.
_TARGET_ITSELF, _FARTHEST = 0.3, 5.0

#: Least distance from the target (px), and largest number of neighbors.
_NEAREST, _MOST = 1.4, 6
#: What the model leaves counts as a star if it is so many times its error, so many times
#: the target's light there, and so large a part of the target's flux.
_SIGMA, _OVER_STAR, _LEAST = 6.0, 0.7, 4e-3
#: Steps (px) of the derivative by a neighbor's place, and of the place itself.
_STEP, _LARGEST_MOVE = 0.05, 0.3


@dataclass(frozen=True)
class KnownNeighbors:
    """
    Places of neighbors that the user gives, in the box of pixels that is modeled.

    Parameters
    ----------
    places : ndarray
        Columns and rows in a typical cadence, ``(m, 2)``.
    target : ndarray or None
        Column and row where the same coordinates place the target: distances from it do not
        depend on the pointing. None: the target is where the images show it.
    """

    places: np.ndarray
    target: np.ndarray | None

    @classmethod
    def read(cls, neighbors, series, origin, peak):
        """
        Read the user's argument.

        Parameters
        ----------
        neighbors : array_like, Table or SkyCoord
            As in `~scope_models.io.pixels.star_places`.
        series : PixelSeries
            The pixels.
        origin, peak : ndarray
            Column and row of the box' first pixel in the stamp, and of the target in the stamp.
        """
        places = star_places("neighbors", neighbors, series)
        names = {name.lower() for name in getattr(neighbors, "colnames", ("x", "y"))}
        on_sky = isinstance(neighbors, SkyCoord) or not {"x", "y"} <= names
        target = target_place(series) if on_sky else None
        distance = np.hypot(*(places - (peak if target is None else target)).T)
        if np.any(distance < _TARGET_ITSELF):
            raise ValueError(
                "`neighbors` must not hold the target itself: one is within "
                f"{_TARGET_ITSELF} px of it"
            )
        ny, nx = series.flux.shape[1:]
        shift = 0.0 if target is None else peak - target  # of the pointing
        outside = np.abs(places + shift - [(nx - 1) / 2, (ny - 1) / 2]) - [nx / 2, ny / 2]
        far = outside.max(axis=1, initial=-np.inf) > _FARTHEST
        if far.any():
            message = f"{far.sum()} of `neighbors` are far outside of the pixels and are left out"
            warnings.warn(message, DetrendingWarning, stacklevel=4)
        return cls(places[~far] - origin, None if target is None else target - origin)

    def offsets(self, track):
        """Return the distances from the target, ``(m, 2)``."""
        seen = [np.median(track.x), np.median(track.y)]
        return self.places - (seen if self.target is None else self.target)


def _stacked(values, variance, track):
    """Average images in the frame of the star, on whole pixels: mean, its error, centers."""
    n, ny, nx = values.shape
    u_ = np.broadcast_to((np.arange(nx) - track.x[:, None])[:, None, :], values.shape)
    v_ = np.broadcast_to((np.arange(ny) - track.y[:, None])[:, :, None], values.shape)
    reach = int(np.ceil(max(np.abs(u_).max(), np.abs(v_).max()))) + 1
    size = 2 * reach + 1
    good = np.isfinite(variance)
    index = (np.rint(v_ + reach) * size + np.rint(u_ + reach)).astype(int)[good]

    def total(weights):
        return np.bincount(index, weights, minlength=size * size).reshape(size, size)

    count = np.maximum(total(np.ones(good.sum())), 1e-9)
    few = count < 0.05 * n
    mean = np.where(few, 0.0, total(values[good]) / count)
    error = np.sqrt(total(variance[good])) / count
    place = [np.where(few, np.inf, total(w[good]) / count) for w in (u_, v_)]
    return mean, np.where(few, np.inf, error), place


def find_neighbors(shape, track, flux, variance, known, refit):
    """
    Return the shape with stars beside the target.

    Parameters
    ----------
    shape, track
        A first model without neighbors.
    flux, variance : ndarray
        Pixels ``(n, ny, nx)``; infinite variance where there are no data.
    known : KnownNeighbors or None
        Given neighbors; None: one after the other is found where the model leaves light that
        looks like a star's.
    refit : callable
        Takes pixels without the neighbors' light, and returns a new first model of the target.
    """
    if known is not None:
        found = np.column_stack([np.zeros(len(known.places)), known.offsets(track)])
        if len(found):
            settled = _settled(shape, track, flux, variance, found, refit, known)
            if settled is None:
                raise ValueError(
                    "the scene with the given `neighbors` does not describe the pixels; "
                    "PLDCorrector needs no model of the scene"
                )
            shape, track, found = settled
        return replace(shape, neighbors=found, first_neighbors=found), track
    found = np.empty((0, 3))
    while len(found) < _MOST:
        new = _brightest_rest(shape, track, flux, variance, found)
        if new is None:
            break
        tried = np.concatenate([found, [new]])
        trial = _settled(shape, track, flux, variance, tried, refit)
        if trial is None or not _separate(trial[2], np.median(trial[1].flux)):
            break
        shape, track, found = trial
    return replace(shape, neighbors=found, first_neighbors=found), track


def _settled(shape, track, flux, variance, found, refit, known=None):
    """Measure the neighbors and the target's first model by turns; None if that diverges."""
    for _ in range(4):
        found = _measured(shape, track, flux, variance, found, move=known is None)
        old = track
        try:
            shape, track = refit(flux - _light_of(shape, track, found))
        except NoLightError:
            return None
        if known is None:
            moved = [np.median(track.x - old.x), np.median(track.y - old.y)]
            found = found - [0.0, *moved]
        else:
            found[:, 1:] = known.offsets(track)
    return shape, track, found


def _separate(found, typical):
    """Return whether all neighbors are bright enough, and apart from the target and each other."""
    places = np.concatenate([[[0.0, 0.0]], found[:, 1:]])
    distance = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    distance[np.diag_indices_from(distance)] = np.inf
    return distance.min() > _NEAREST and found[:, 0].min() > _LEAST * typical


def _light_of(shape, track, neighbors):
    return render(replace(shape, neighbors=neighbors), track).others


def _brightest_rest(shape, track, flux, variance, found):
    """Return flux and distance of the brightest star that the model leaves, or None."""
    typical = float(np.median(track.flux))
    images = render(replace(shape, neighbors=found), track)
    star = track.flux[:, None, None] * images.star
    rest, error, (du, dv) = _stacked(flux - star - images.others, variance, track)
    light, _, _ = _stacked(star + images.others, variance, track)
    rest = rest - np.median(rest[np.isfinite(error)])
    good = rest > np.maximum(_OVER_STAR * light, _SIGMA * error)
    good &= (rest > _LEAST * typical * shape.coefficients.max()) & (np.hypot(du, dv) > _NEAREST)
    for _, dx, dy in found:
        good &= np.hypot(du - dx, dv - dy) > _NEAREST
    if not good.any():
        return None
    j, i = np.unravel_index(np.argmax(np.where(good, rest, -np.inf)), rest.shape)
    box = np.s_[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
    near = np.isfinite(error[box])
    weight = np.where(near, np.clip(rest[box], 0, None), 0.0)
    place = [np.sum(weight * np.where(near, d[box], 0.0)) / weight.sum() for d in (du, dv)]
    return np.array([weight.sum(), *place])


def _measured(shape, track, flux, variance, neighbors, *, move):
    """Fit fluxes, and places if they may move, with the target's flux and a background."""
    step = max(len(flux) // 100, 1)
    part, data = track[::step], flux[::step]
    root = 1 / np.sqrt(variance[::step] + (0.02 * np.abs(data)) ** 2)
    light = part.flux[:, None, None] * render(shape, part).star
    columns = [light, np.ones_like(data)]
    for _, dx, dy in neighbors:
        columns.append(_light_of(shape, part, np.array([[1.0, dx, dy]])))
    for flux_, dx, dy in neighbors if move else ():
        for ax, ay in ((_STEP, 0.0), (0.0, _STEP)):
            ends = [
                _light_of(shape, part, np.array([[flux_, dx + s * ax, dy + s * ay]]))
                for s in (-1, 1)
            ]
            columns.append((ends[1] - ends[0]) / (2 * _STEP))
    matrix = np.stack([(c * root).ravel() for c in columns], axis=1)
    values, *_ = np.linalg.lstsq(matrix, (data * root).ravel(), rcond=None)
    m = len(neighbors)
    fluxes = np.maximum(values[2 : 2 + m], 1e-4 * np.median(track.flux))
    places = neighbors[:, 1:]
    if move:
        places = places + np.clip(values[2 + m :].reshape(m, 2), -_LARGEST_MOVE, _LARGEST_MOVE)
    return np.column_stack([fluxes, places])
