"""First guesses of a scene: where the star is, what it looks like, and which others there are.

Other stars are found in the images, or given by the user.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.stats import mad_std
from scipy.optimize import lsq_linear

from scope_models.exceptions import DetrendingWarning
from scope_models.io.pixels import star_places, target_place
from scope_models.pixelmodel._scene import Shape, Track, render
from scope_models.pixelmodel._smoothing import CLIP
from scope_models.pixelmodel._splines import make_grid

__all__ = [
    "NEAREST",
    "KnownNeighbors",
    "NoLightError",
    "centroids",
    "find_neighbors",
    "first_shape",
    "first_track",
    "fit_gaussians",
    "separate",
]

#: Tolerance: widths of the Gaussians whose sum is the first guess, in units of the star's.
_WIDTHS = (0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
#: Tolerance: standard deviation of the window of the centroids (px), and pixels of the first guess.
_WINDOW, _MOST_PIXELS = 1.5, 20000
_NO_LIGHT = "the pixels of `tpf` hold no light of the target"


class NoLightError(ValueError):
    """No profile with positive flux describes the pixels of the target."""


def centroids(images, x, y, steps=6):
    """Return centers of light in a Gaussian window that moves along.

    Parameters
    ----------
    images : ndarray
        ``(n, ny, nx)``, without background.
    x, y : ndarray
        Where to begin, ``(n,)``.
    steps : int
        Number of times that the window moves.
    """
    ny, nx = images.shape[1:]
    images = np.clip(images, 0, None)
    for _ in range(steps):
        u, v = np.arange(nx) - x[:, None], np.arange(ny) - y[:, None]
        across, along = np.exp(-0.5 * (u / _WINDOW) ** 2), np.exp(-0.5 * (v / _WINDOW) ** 2)
        weighted = images * along[:, :, None] * across[:, None, :]
        total = np.maximum(weighted.sum(axis=(1, 2)), 1e-30)
        x = x + np.clip(np.einsum("nij,nj->n", weighted, u) / total, -1, 1)
        y = y + np.clip(np.einsum("nij,ni->n", weighted, v) / total, -1, 1)
        x, y = np.clip(x, -0.5, nx - 0.5), np.clip(y, -0.5, ny - 0.5)
    return x, y


def first_track(images, pos_corr, peak):
    """Return positions, and whether POS_CORR describes the motion.

    POS_CORR is used along with the images if the images' centers follow it.

    Parameters
    ----------
    images : ndarray
        ``(n, ny, nx)``, without background; 0 where there is none.
    pos_corr : ndarray or None
        ``(n, 2)``; NaN where unknown.
    peak : tuple of float
        Column and row of the target in a typical cadence.

    Raises
    ------
    NoLightError
        If there is no light in any image.
    """
    n, seen = len(images), images.any(axis=(1, 2))
    if not seen.any():
        raise NoLightError(_NO_LIGHT)
    column, row = np.full(n, float(peak[0])), np.full(n, float(peak[1]))
    offset = np.zeros((n, 2))
    if pos_corr is not None:
        known = np.isfinite(pos_corr).all(axis=1)
        if known.mean() > 0.5:
            offset[known] = pos_corr[known] - np.median(pos_corr[known], axis=0)
            x, y = centroids(images, column + offset[:, 0], row + offset[:, 1])
            places, both = np.stack([x, y], axis=1), known & seen
            if _followed(places[both], offset[both]) > 0.5:
                place = np.median((places - offset)[both], axis=0)
                return (place + offset).T, known
    places = np.stack(centroids(images, column, row), axis=1)
    # without images: what POS_CORR explains of the centers, and the rest as before and after
    columns = np.column_stack([np.ones(n), offset])
    explained = columns @ np.linalg.lstsq(columns[seen], places[seen], rcond=None)[0]
    index = np.arange(n)
    for one, part in zip(places.T, explained.T, strict=True):
        rest = np.interp(index, index[seen], (one - part)[seen])
        one[~seen] = (part + rest)[~seen]
    return places.T, np.zeros(n, dtype=bool)


def _followed(centers, offset):
    """Return the share of the centers' motion, but for their noise, that offsets are."""
    rest = centers - offset
    noise = np.sum(mad_std(np.diff(rest, 2, axis=0), axis=0) ** 2) / 6
    moved, left = (max(values.var(axis=0).sum() - noise, 0.0) for values in (centers, rest))
    return 1 - left / max(moved, 1e-30)


def fit_gaussians(u, v, values, weight):
    """Fit a non-negative sum of Gaussians of one shape and several widths, and a constant.

    Parameters
    ----------
    u, v : ndarray
        Distance from the star in pixels, ``(m,)``.
    values : ndarray
        Light over the star's flux.
    weight : ndarray
        Weight of each.

    Returns
    -------
    callable
        The sum at given distances.

    Raises
    ------
    NoLightError
        If no value near the star is positive.
    """
    window = np.exp(-0.5 * (u**2 + v**2) / _WINDOW**2) * np.clip(values, 0, None)
    if not window.sum() > 0:
        raise NoLightError(_NO_LIGHT)
    moments = np.array([[np.sum(window * a * b) for a in (u, v)] for b in (u, v)]) / window.sum()
    # strips of one row or column have no extent across
    inverse = np.linalg.inv(moments + 1e-6 * np.eye(2)) - np.eye(2) / _WINDOW**2
    eigen, vectors = np.linalg.eigh(inverse)
    eigen = np.clip(eigen, 1 / 2.0**2, 1 / 0.3**2)
    covariance = (vectors / eigen) @ vectors.T

    def profiles(u, v):
        out = []
        for s in _WIDTHS:
            c = np.linalg.inv(covariance * s**2)
            square = c[0, 0] * u**2 + 2 * c[0, 1] * u * v + c[1, 1] * v**2
            out.append(np.exp(-0.5 * square) * np.sqrt(np.linalg.det(c)) / (2 * np.pi))
        return np.stack(out, axis=-1)

    # the constant takes what is left of the background
    columns = np.column_stack([profiles(u, v), np.ones(len(u))]) * weight[:, None]
    q, r = np.linalg.qr(columns)
    bounds = (np.append(np.zeros(len(_WIDTHS)), -np.inf), np.inf)
    found = lsq_linear(r, q.T @ (values * weight), bounds, method="bvls").x[:-1]
    return lambda u, v: profiles(u, v) @ found


def first_shape(flux, variance, x, y, rng):
    """Return the first guess of the PRF, on splines, from all cadences' pixels.

    Parameters
    ----------
    flux, variance : ndarray
        ``(n, ny, nx)``; infinite variance where pixels are left out.
    x, y : ndarray
        Positions ``(n,)``.
    rng : `~numpy.random.Generator`
        Chooses the pixels.

    Returns
    -------
    shape : Shape
        Without neighbors.
    track : Track
        With a rough flux.

    Raises
    ------
    NoLightError
        If no positive profile describes the pixels.
    """
    n, ny, nx = flux.shape
    u = np.broadcast_to((np.arange(nx) - x[:, None])[:, None, :], flux.shape)
    v = np.broadcast_to((np.arange(ny) - y[:, None])[:, :, None], flux.shape)
    near = np.hypot(u, v) < 2.5
    total = np.maximum(np.sum(np.where(near, flux, 0.0), axis=(1, 2)), 1e-3)
    good = np.flatnonzero(np.isfinite(variance).ravel())
    if len(good) > _MOST_PIXELS:
        good = rng.choice(good, _MOST_PIXELS, replace=False)
    scale = np.broadcast_to(total[:, None, None], flux.shape).ravel()[good]
    u, v, values = u.ravel()[good], v.ravel()[good], flux.ravel()[good] / scale
    noise = np.sqrt(variance.ravel()[good]) / scale
    weight = 1 / np.hypot(noise, 0.05 * np.abs(values) + 1e-4)
    for _ in range(3):  # light above the model is that of other stars
        profile = fit_gaussians(u, v, values, weight)
        excess = values - profile(u, v)
        other = (excess > 5 * noise) & (excess > profile(u, v)) & (np.hypot(u, v) > 1.5)
        weight = np.where(other, 0.1 * weight, weight)
    reach = max(np.abs(x[:, None] - [0, nx - 1]).max(), np.abs(y[:, None] - [0, ny - 1]).max())
    grid = make_grid(float(reach) + 0.5)
    c = grid.centers
    image = profile(*(a.astype(float) for a in np.meshgrid(c, c)))
    sum_of = np.sum(profile(*np.meshgrid(np.arange(-12.0, 13), np.arange(-12.0, 13))))
    if not sum_of > 0:
        raise NoLightError(_NO_LIGHT)
    coefficients = grid.interpolate(image / sum_of)
    none = np.empty((0, 3))
    shape = Shape(grid, coefficients, coefficients, np.ones((ny, nx)), none, none)
    zero = np.zeros(n)
    return shape, Track(total * sum_of, np.array(x), np.array(y), zero, zero)


#: Branch: given neighbors closer to the target (px) are the target, and those farther outside of
#: the pixels have no light in them.
_TARGET_ITSELF, _FARTHEST = 0.3, 5.0

#: Branch: least distance from the target (px), and largest number of neighbors.
NEAREST, _MOST = 1.4, 6
#: Branch: what the model leaves counts as a star if it is an outlier, so many times the target's
#: light there, and so large a part of the target's flux.
_OVER_STAR, _LEAST = 0.7, 4e-3
#: Tolerance: steps (px) of the derivative by a neighbor's place, and of the place itself.
_STEP, _LARGEST_MOVE = 0.05, 0.3
#: Tolerance: most turns of a first fit, and change of fluxes (relative to the brightest neighbor)
#: and of places (px) in the last one.
_MOST_TURNS, _SETTLED = 20, 0.03


@dataclass(frozen=True)
class KnownNeighbors:
    """Places of neighbors that the user gives.

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
    def read(cls, neighbors, series, peak):
        """Read the user's argument.

        Parameters
        ----------
        neighbors : array_like, Table or SkyCoord
            As in `~scope_models.io.pixels.star_places`.
        series : PixelSeries
            The pixels.
        peak : ndarray
            Column and row of the target's light in the stamp.
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
        return cls(places[~far], target)

    def __len__(self):
        return len(self.places)

    def within(self, origin):
        """Return the same in a box of pixels with its first column and row."""
        return type(self)(
            self.places - origin, None if self.target is None else self.target - origin
        )

    def nearer(self, star, shape):
        """Return which pixels are nearer to a neighbor than to the target, ``(ny, nx)``."""
        rows, columns = np.indices(shape)
        away = self.places - (star if self.target is None else self.target)
        own, *others = (np.hypot(columns - x, rows - y) for x, y in [star, *(star + away)])
        return np.min(others, axis=0, initial=np.inf) < own

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


def find_neighbors(shape, track, flux, variance, known, refit, places):
    """Return the shape with stars beside the target.

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
    places : ndarray of bool
        Pixels in which neighbors may be, ``(ny, nx)``.
    """
    if known is not None:
        found = np.column_stack([np.zeros(len(known.places)), known.offsets(track)])
        found = _measured(shape, track, flux, variance, found, move=False)
        return replace(shape, neighbors=found, first_neighbors=found), track
    found = np.empty((0, 3))
    while len(found) < _MOST:
        new = _brightest_rest(shape, track, flux, variance, found, places)
        if new is None:
            break
        tried = np.concatenate([found, [new]])
        trial = _settled(shape, track, flux, variance, tried, refit)
        if trial is None or not separate(trial[2], _LEAST * np.median(trial[1].flux)).all():
            break
        if not _in_places(places, trial[1], *trial[2][:, 1:].T).all():
            break
        shape, track, found = trial
    return replace(shape, neighbors=found, first_neighbors=found), track


def _settled(shape, track, flux, variance, found, refit):
    """Measure the neighbors and the target's first model by turns; None if that does not settle.

    Meanwhile pixels nearer to a neighbor are left out of the first model.
    """
    star = np.array([np.median(track.x), np.median(track.y)])
    theirs = KnownNeighbors(star + found[:, 1:], None).nearer(star, flux.shape[1:])
    change, images = np.full(found.shape, 1e6), flux  # larger than any change
    for _ in range(_MOST_TURNS):
        old = track
        try:
            shape, track = refit(images, theirs)
        except NoLightError:
            return None
        found = found - [0.0, np.median(track.x - old.x), np.median(track.y - old.y)]
        if np.abs(change).max() < _SETTLED:
            return *refit(images), found
        before, found = found, _measured(shape, track, flux, variance, found, move=True)
        last, change = change, (found - before) / [*np.max(found[:, :1], axis=0), 1.0, 1.0]
        # less at a time where it oscillates
        back = np.clip(-np.vdot(change, last) / np.vdot(last, last), 0, 1)
        left = flux - _light_of(shape, track, found)
        images = images + (left - images) / (1 + back)
    return None


def separate(found, least):
    """Return which neighbors are as bright as this, and apart from the target and brighter ones."""
    apart = np.zeros(len(found), dtype=bool)
    for k in np.argsort(-found[:, 0]):
        stars = np.concatenate([[[0.0, 0.0]], found[apart, 1:]])
        distance = np.hypot(*(found[k, 1:] - stars).T).min()
        apart[k] = found[k, 0] > least and distance > NEAREST
    return apart


def _light_of(shape, track, neighbors):
    return render(replace(shape, neighbors=neighbors), track).others


def _brightest_rest(shape, track, flux, variance, found, places):
    """Return flux and distance of the brightest star that the model leaves, or None."""
    typical = float(np.median(track.flux))
    images = render(replace(shape, neighbors=found), track)
    star = track.flux[:, None, None] * images.star
    rest, error, (du, dv) = _stacked(flux - star - images.others, variance, track)
    light, _, _ = _stacked(star + images.others, variance, track)
    rest = rest - np.median(rest[np.isfinite(error)])
    good = rest > np.maximum(_OVER_STAR * light, CLIP * error)
    good &= (rest > _LEAST * typical * shape.coefficients.max()) & (np.hypot(du, dv) > NEAREST)
    for _, dx, dy in found:
        good &= np.hypot(du - dx, dv - dy) > NEAREST
    good &= _in_places(places, track, du, dv)
    if not good.any():
        return None
    j, i = np.unravel_index(np.argmax(np.where(good, rest, -np.inf)), rest.shape)
    box = np.s_[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
    near = np.isfinite(error[box])
    weight = np.where(near, np.clip(rest[box], 0, None), 0.0)
    place = [np.sum(weight * np.where(near, d[box], 0.0)) / weight.sum() for d in (du, dv)]
    return np.array([weight.sum(), *place])


def _in_places(places, track, du, dv):
    """Return whether distances from the target are in pixels in which neighbors may be."""
    inside = np.pad(places, 1)  # but not on the border
    center = (np.median(track.y) + dv, np.median(track.x) + du)
    index = (np.rint(np.nan_to_num(c, posinf=-1)) for c in center)
    return inside[
        tuple(np.clip(i, -1, k).astype(int) + 1 for i, k in zip(index, places.shape, strict=True))
    ]


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
