"""The pixels of a star that a model is fitted to, sums of full columns, where the fit begins."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from scope_models.pixelmodel._smooth import (
    ENOUGH,
    FEWEST_DARK,
    MOST,
    NO_WEIGHT,
    REWEIGHTS,
    TRANSIT,
    Features,
    Flow,
    Smoother,
    dark_plane,
    polynomials,
    quantile,
)

__all__ = [
    "FEWEST", "POSITION_PRIOR", "Columns", "find_row_centers", "full_columns", "full_pixels",
    "make_stamp", "rows_of_star", "without_saturation",
]  # fmt: skip

#: Prior: standard deviation of a position about POS_CORR (px).
POSITION_PRIOR = 0.02
#: Prior: scale (px) of the images as functions of position, and of their changes.
_SCALE, _COARSE_SCALE = 0.8, 1.0
#: Tolerance: what is left of kernels at most.
_TOLERANCE, _COARSE_TOLERANCE = 1e-9, 1e-4
#: Prior: degree of the waves along the rows in cadences with rolling bands.
_BANDS = 4
#: Tolerance: width (px) of the rings of the star's profile.
_RING = 0.5
#: Branch: POS_CORR that is known in less of the cadences is not used.
_KNOWN = 0.2
#: Branch: part of the light in the aperture above which the level of dark pixels is background.
_BACKGROUND = 0.05
#: Branch: what is seen in fewer cadences may be an accident.
FEWEST = 3
#: Prior: standard deviation in pixels of the Gaussian that stands for the star along a full column:
#: Kepler's PRF has 0.45 of its light in one pixel, as one of 0.5 px (Kepler telescope page); wings
#: make it wider.
_DRAWN_WIDTH = 0.6
#: Branch: a column constrains the row if it holds this share of the light, with twice it fully:
#: the center of less is that of the background.
_SMALLEST_SHARE = 5e-3


def full_pixels(images, use, saturation):
    """Return which pixels exceed the flux of a full one, if known, in some cadences in use."""
    return np.sum(images[use] > (saturation or np.inf), axis=0) >= FEWEST


def full_columns(images, use, saturation):
    """Return which columns of images have full pixels."""
    return full_pixels(images, use, saturation).any(axis=0)


class Columns:
    """Pixels, of which those of each full column are one sum: only this follows the star.

    The charge of a full pixel bleeds along its column: the pixel stays full when the star dims, so
    that its share of the light follows the dimming, but the column's sum does not depend on it. The
    ``grid`` has column and row of each pixel, ``(n_pixels, 2)``, ``places`` their means in each
    sum, ``(n_sums, 2)``; ``full`` are pixels of full columns, ``single`` sums of one other pixel.
    """

    def __init__(self, grid, full):
        self.grid, self._full = grid, full
        column = np.where(full, -1 - grid[:, 0], np.arange(len(grid)))
        _, first, self._member, size = np.unique(column, True, True, True)
        self.single = ~full[first]
        self.places = self.summed(grid.T).T / size[:, None]

    def summed(self, values):
        """Return the sums of values ``(..., n_pixels)``, ``(..., n_sums)``."""
        if self.single.all():
            return values
        return values @ (self._member[:, None] == np.arange(len(self.single))).astype(float)

    def drawn(self, values, images=None):
        """Return sums ``(n, n_sums)`` in all pixels.

        Full columns have the profile of the others in images, by default these values.
        """
        if self.single.all():
            return values
        _, rows = np.unique(self.grid[:, 1], return_inverse=True)
        other = (rows[:, None] == np.arange(rows.max() + 1)) & ~self._full[:, None]
        images = (values if images is None else images)[:, self._member]
        values = values[:, self._member]
        profile = np.maximum(images @ other, 1e-300)[:, rows]
        return values * np.where(self._full, profile / self.summed(profile)[:, self._member], 1.0)


def without_saturation(images, full, centers, aperture):
    """Return images in which full columns do not depend on the star's brightness.

    The full columns, ``(nx,)``, are replaced by images of these alone: a Gaussian along the column
    about the row of their ``centers``, ``(n_cadences, nx)``, as bright as the column. The
    ``images``, ``(n_cadences, ny, nx)``, become zero outside of the ``aperture``.
    """
    images = np.where(aperture, images, 0.0)
    rows = np.arange(images.shape[1])
    low = (rows[:, None] - 0.5 - centers[:, None, full]) / _DRAWN_WIDTH
    profile = ndtr(low + 1 / _DRAWN_WIDTH) - ndtr(low)
    profile = np.where(aperture[:, full], np.maximum(profile, 1e-300), 0.0)
    profile /= profile.sum(axis=1, keepdims=True)
    images[:, :, full] = profile * images[:, :, full].sum(axis=1, keepdims=True)
    return images


def find_row_centers(images, aperture, use, saturation):
    """Return the row of the center of light of each column, ``(n_cadences, nx)``.

    That of a column without full pixels is the star's row y and the tilt h of its image, y + h(d),
    a piecewise linear function of the column's distance d from the star: without it the row would
    jump when the star comes to other columns. One linear least-squares fit finds y and h, which the
    cadences in ``use`` determine; the ``saturation`` is the flux of a full pixel.
    """
    images = np.where(aperture, images, 0.0)
    rows, columns = np.arange(images.shape[1]), np.arange(images.shape[2])
    sums = images.sum(axis=1)
    share = sums / np.maximum(sums.sum(axis=1, keepdims=True), 1e-300)
    center = np.einsum("ijk,j->ik", images, rows) / np.where(sums > 0, sums, np.inf)
    weight = np.clip(share / _SMALLEST_SHARE - 1, 0, 1) * (images.max(axis=1) < saturation)
    distance = columns - (share @ columns)[:, None]
    knots = np.arange(-len(columns), len(columns) + 1)
    tilt = np.clip(1 - np.abs(distance[..., None] - knots), 0, None)
    # without such columns, the center of all light is the row, and there is no tilt
    total = weight.sum(axis=1, keepdims=True) + NO_WEIGHT
    row = np.sum((weight + NO_WEIGHT * share) * center, axis=1, keepdims=True) / total
    # the equations of the tilt alone: at any tilt, the best row is the mean of what it leaves
    mean = np.einsum("ij,ijk->ik", weight, tilt) / total
    normal = np.einsum("ij,ija,ijb->ab", weight[use], tilt[use], tilt[use], optimize=True)
    normal += NO_WEIGHT * np.eye(len(knots)) - (total * mean)[use].T @ mean[use]
    right = np.einsum("ij,ijk->k", (weight * (center - row))[use], tilt[use])
    h = np.linalg.solve(normal, right)
    return row + tilt @ h - (mean @ h)[:, None]


def rows_of_star(centers, position, variable, use):
    """Return centers of light ``(n_cadences, nx)`` without what follows a star that varies.

    Beside another star they do so, to the second order of the star's ``variable`` part, and by
    functions of its position, ``(n_cadences, 2)``. These are learned from the cadences in ``use``.
    """
    places, v = polynomials(position), variable[:, None]
    varies = np.concatenate([v * places, v**2 * places], axis=1)
    causes = np.concatenate([varies, places], axis=1)
    follows = np.linalg.lstsq(causes[use], centers[use], rcond=None)[0]
    return centers - varies @ follows[: varies.shape[1]]


@dataclass(frozen=True, eq=False)
class Stamp:
    """Pixels of a star, in units of its flux, and all that a fit takes as given."""

    time: np.ndarray  # days, (n,)
    light: np.ndarray  # (n, n_pixels)
    noise: np.ndarray  # variance, (n, n_pixels)
    unit: float  # e-/s
    grid: np.ndarray  # column and row of each pixel, (n_pixels, 2)
    aperture: np.ndarray  # pixels whose sum is the light, (n_pixels,)
    use: np.ndarray  # cadences from which everything that they share is learned, (n,)
    banded: np.ndarray  # cadences with rolling bands, (n,)
    planes: np.ndarray  # level, slopes and waves of the background, (n_pixels, k)
    base: np.ndarray  # typical background in these, (k,)
    waves: np.ndarray  # standard deviation of the waves in each cadence, (n,)
    center: np.ndarray  # typical column and row of the star
    expected: np.ndarray  # position relative to the center as POS_CORR has it, px, (n, 2)
    known: np.ndarray  # cadences with POS_CORR, (n,)
    scale: np.ndarray  # standard deviation of an image before the fit, (n_pixels,)
    features: Features  # functions of position for the images,
    coarse: Features  # and for their changes
    flow: Flow
    smoothed: Smoother
    columns: Columns
    terms: np.ndarray  # those of the background in all pixels, (n_all, k)

    def functions(self, position):
        """Return kernels of position, and the functions for images and for their changes."""
        return *self.features(position), self.coarse(position)[1]


@dataclass(frozen=True, eq=False)
class States:
    """What differs from cadence to cadence, and which pixels count."""

    brightness: np.ndarray  # (n,)
    position: np.ndarray  # relative to the center, px, (n, 2)
    focus: np.ndarray  # relative change of the PSF's width, (n,)
    variable: np.ndarray  # strong variability of the star, 0 if there is none, (n,)
    plane: np.ndarray  # coefficients of the background, (n, k)
    level: np.ndarray  # what its level has beyond them, (n,)
    variance: np.ndarray  # about the model, (n, n_pixels)
    good: np.ndarray  # pixels without cosmic rays, (n, n_pixels)
    noisy: np.ndarray  # factor of the noise of a cadence, (n, 1)

    @property
    def courses(self):
        """Brightness, both positions and focus, ``(4, n)``."""
        return np.array([self.brightness, *self.position.T, self.focus])


def make_stamp(time, flux, flux_err, position, grid, aperture, use=None, banded=None, full=None):
    """Return a `Stamp`, with arguments as `fit_star` has them, and the first `States`."""
    n, n_pixels = flux.shape
    full = np.zeros(n_pixels, dtype=bool) if full is None else full
    use = np.ones(n, dtype=bool) if use is None else use
    banded = np.zeros(n, dtype=bool) if banded is None else banded
    typical = quantile(flux[use].T)
    offset = (grid - grid.mean(axis=0)) / np.maximum(np.ptp(grid, axis=0), 1)
    planes = np.column_stack([np.ones(n_pixels), offset])
    columns = Columns(grid, full)
    n_dark = len(columns.single) // 4
    n_terms = 3 if n_dark >= FEWEST_DARK else 1  # few pixels show no slope
    slope = dark_plane(typical, planes)[:n_terms]
    if banded.any():
        rows = 2 * (grid[:, 1] - grid[:, 1].min()) / max(np.ptp(grid[:, 1]), 1) - 1
        waves = np.polynomial.legendre.legvander(rows, _BANDS)[:, 2:]
        planes = np.column_stack([planes, waves])
    terms, planes, grid = planes, columns.summed(planes.T).T, columns.places
    flow = Flow(columns, aperture)
    flux, flux_err = columns.summed(flux), np.sqrt(columns.summed(flux_err**2))
    aperture, typical = columns.summed(aperture.astype(float)) > 0, columns.summed(typical)
    dark = np.argsort(typical - planes[:, :n_terms] @ slope)[: max(3, n_dark)]
    # unless that may be the star's wings
    level = quantile(typical[dark])
    base = np.zeros(planes.shape[1])
    if level * planes[aperture, 0].sum() > _BACKGROUND * typical[aperture].sum():
        base[0] = level
    plane = np.zeros((n, len(base))) + base
    plane[:, :n_terms] += _planes((flux - typical)[:, dark], planes[dark, :n_terms])
    total = (flux - plane @ planes.T)[:, aperture].sum(axis=1)
    unit = quantile(total[use])
    light, plane, noise = flux / unit, plane / unit, (flux_err / unit) ** 2
    own = light - plane @ planes.T
    smoothed = Smoother(time, use)
    waves = np.zeros(n)
    if banded.any():
        waves = _wave_sizes((flux - typical)[:, dark] / unit, banded, use, smoothed.step)
    inside = own[:, aperture], grid[aperture], columns.single[aperture]
    center, expected, known = _expected(*inside, position, total / unit, use, 1 + np.ptp(grid))
    grid = np.where(columns.single[:, None], grid, [1, 0] * grid + [0, 1] * center)
    away = grid - center - expected[use, None]
    scale = _most_light(own[use], 3 * np.sqrt(quantile(noise[use].T)), away)
    stamp = Stamp(
        time, light, noise, unit, grid, aperture, use, banded, planes, base / unit, waves,
        center, expected, known, scale,
        Features(expected[use], _SCALE, _TOLERANCE),
        Features(expected[use], _COARSE_SCALE, _COARSE_TOLERANCE),
        flow, smoothed, columns, terms,
    )  # fmt: skip
    zero, good, one = np.zeros(n), np.ones(light.shape, dtype=bool), np.ones((n, 1))
    return stamp, States(total / unit, expected, zero, zero, plane, zero, noise, good, one)


def _planes(change, terms):
    """Return coefficients of changes of pixels, in some of which may be a star or a cosmic ray."""
    found = np.zeros((len(change), terms.shape[1]))
    found[:, 0] = quantile(change)
    for _ in range(REWEIGHTS):
        rest = np.abs(change - found @ terms.T)
        weight = 1 / (1 + (rest / np.maximum(3 * quantile(rest)[:, None], 1e-300)) ** 2)
        gram = np.einsum("np,pi,pj->nij", weight, terms, terms, optimize=True)
        gram += 1e-9 * gram[:, :1, :1] * np.eye(terms.shape[1])  # one column shows no slope across
        found = np.linalg.solve(gram, ((weight * change) @ terms)[:, :, None])[:, :, 0]
    return found


def _wave_sizes(change, banded, use, step):
    """Return how strong waves are: what dark pixels have beyond noise, in episodes with flags."""
    spread = (1.4826 * quantile(np.abs(change - quantile(change)[:, None]))) ** 2
    excess = spread - quantile(spread[use])
    excess = ndimage.median_filter(excess, max(round(TRANSIT / step), 1))
    episodes, _ = ndimage.label(banded | (excess > 0))
    excess[~np.isin(episodes, episodes[banded])] = 0.0
    return np.sqrt(np.maximum(excess, 0.0))


def _expected(light, grid, single, position, total, use, size):
    """Return the typical place of the star, positions relative to it, and where POS_CORR is known.

    Elsewhere, or where it is wrong by more than the ``size`` of the stamp (px), positions are
    centroids in its scale.
    """
    centroid = light @ grid / total[:, None]
    if 0 < single.sum() < len(single):  # full columns do not show the row
        centroid[:, 1] = light[:, single] @ grid[single, 1] / light[:, single].sum(axis=1)
    center = quantile(centroid[use].T)
    centroid = centroid - center
    known = np.isfinite(position).all(axis=1)
    offset = np.where(known[:, None], position, 0.0)
    fit = known & use
    middle = quantile(offset[fit].T) if fit.any() else np.zeros(2)
    known &= np.abs(offset - middle).max(axis=1) < size
    fit &= known
    if fit.sum() < _KNOWN * use.sum() or np.ptp(offset[fit], axis=0).max() == 0:
        return center, centroid, np.ones(len(known), dtype=bool)
    columns = np.column_stack([centroid, np.ones(len(centroid))])
    expected = offset - quantile(offset[fit].T)
    slope = np.linalg.lstsq(columns[fit], expected[fit], rcond=None)[0]
    # where the star was seen: without light there is no centroid
    near = np.clip(columns @ slope, expected[fit].min(axis=0), expected[fit].max(axis=0))
    return center, np.where(known[:, None], expected, near), known


def _most_light(light, least, away):
    """Return what each pixel may hold: most of its light, or more by the star's profile.

    Few cadences show what pixels hold at rare places; pixels as near the star do.
    """
    distance = np.hypot(*away.T)
    few = slice(None, None, max(len(light) // ENOUGH, 1))
    rings = np.floor(distance[:, few] / _RING)
    numbers, values = np.unique(rings), light[few].T
    profile = [max(quantile(values[rings == k], MOST), least.min()) for k in numbers]
    places = _RING * (numbers + 0.5)
    profile = np.log(np.maximum.accumulate(profile[::-1])[::-1])
    expected = np.exp(np.interp(distance.min(axis=1), places, profile))
    return np.maximum(np.maximum(quantile(light.T, MOST), expected), least)
