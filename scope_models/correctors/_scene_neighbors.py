"""Other stars in the stamp: found in the images, or given by the user."""

from dataclasses import replace

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import Table

from scope_models._arrays import plain_array
from scope_models.correctors._scene_model import render

__all__ = ["find_neighbors", "offsets_of"]

#: Least distance from the target (px), and largest number of neighbors.
_NEAREST, _MOST = 1.4, 6
#: What the model leaves counts as a star if it is so many times its error, so many times
#: the target's light there, and so large a part of the target's flux.
_SIGMA, _OVER_STAR, _LEAST = 6.0, 0.7, 4e-3
#: Steps (px) of the derivative by a neighbor's place, and of the place itself.
_STEP, _LARGEST_MOVE = 0.05, 0.3


def offsets_of(neighbors, tpf, column, row):
    """
    Return the distances of given neighbors from the target in pixels, ``(m, 2)``.

    Parameters
    ----------
    neighbors : array_like, Table or SkyCoord
        Columns and rows in the stamp ``(m, 2)``, a table with columns ``x`` and ``y``, or
        places on the sky.
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`
        Whose coordinates convert places on the sky.
    column, row : float
        The target's place in the stamp.
    """
    if isinstance(neighbors, SkyCoord):
        places = np.stack(tpf.wcs.world_to_pixel(np.atleast_1d(neighbors)), axis=1)
    elif isinstance(neighbors, Table):
        missing = {"x", "y"} - set(neighbors.colnames)
        if missing:
            raise ValueError(f"`neighbors` must have the columns x and y, got {neighbors.colnames}")
        names = ("x", "y")
        places = np.stack([plain_array(neighbors[n], u.pix, "neighbors") for n in names], axis=1)
    else:
        places = plain_array(neighbors, u.pix, "neighbors").reshape(-1, *np.shape(neighbors)[1:])
    if not places.size:
        return np.empty((0, 2))
    if places.ndim != 2 or places.shape[1] != 2:
        raise ValueError(f"`neighbors` must have shape (m, 2), got {np.shape(neighbors)}")
    if not np.isfinite(places).all():
        raise ValueError("`neighbors` must be finite places")
    offsets = places - [column, row]
    if np.any(np.hypot(*offsets.T) < 0.3):
        raise ValueError("`neighbors` must not be the target itself: one is within 0.3 px of it")
    return offsets


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


def find_neighbors(shape, track, flux, variance, offsets, refit):
    """
    Return the shape with stars beside the target.

    Parameters
    ----------
    shape, track
        A first model without neighbors.
    flux, variance : ndarray
        Pixels ``(n, ny, nx)``; infinite variance where there are no data.
    offsets : ndarray or None
        Distances of given neighbors, ``(m, 2)``; None: one after the other is found where the
        model leaves light that looks like a star's.
    refit : callable
        Takes pixels without the neighbors' light, and returns a new first model of the target.
    """
    if offsets is not None:
        found = np.column_stack([np.zeros(len(offsets)), offsets])
        if len(found):
            shape, track, found = _settled(shape, track, flux, variance, found, refit, move=False)
        return replace(shape, neighbors=found, first_neighbors=found), track
    found = np.empty((0, 3))
    while len(found) < _MOST:
        new = _brightest_rest(shape, track, flux, variance, found)
        if new is None:
            break
        tried = np.concatenate([found, [new]])
        trial = _settled(shape, track, flux, variance, tried, refit, move=True)
        if not _separate(trial[2], np.median(trial[1].flux)):
            break
        shape, track, found = trial
    return replace(shape, neighbors=found, first_neighbors=found), track


def _settled(shape, track, flux, variance, found, refit, *, move):
    """Measure the neighbors and the target's first model by turns."""
    for _ in range(4):
        found = _measured(shape, track, flux, variance, found, move=move)
        old = track
        shape, track = refit(flux - _light_of(shape, track, found))
        moved = [np.median(track.x - old.x), np.median(track.y - old.y)]
        found = found - [0.0, *moved]
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
