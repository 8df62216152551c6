"""A model of all pixels: a star that moves and breathes, its neighbors, and a background."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag, cho_factor, cho_solve

from scope_models.pixelmodel._splines import SplineGrid

__all__ = [
    "MEDIAN_SQUARE",
    "Priors",
    "Shape",
    "Track",
    "between",
    "changed_light",
    "improve_shape",
    "measure_floor",
    "misfit",
    "neighbor_images",
    "render",
    "residuals",
    "solve_states",
    "solve_track",
    "without_level",
]

#: Prior: standard deviations of the PRF about the first guess, in units of that made so many times
#: as broad, and of its peak; of the pixels' gains, and of a neighbor's place (px) and flux
#: (relative). Official PRFs of TESS (camera 2, CCD 3) differ from sums of Gaussians by three times
#: as much or less: 0.1 of the peak in the core, 0.03 at 2.5 px and 0.001 at 5 px.
_PRF, _BROAD, _PRF_LEAST, _GAIN, _PLACE, _FLUX = 0.03, 2.0, 1e-4, 0.015, 0.1, 0.3
#: Prior: the PRF's deviation is a Gaussian process of a scale (px) along both axes, but for a part
#: of its variance. That of these PRFs is correlated by 0.93 over 0.5 px and by 0.7 over 1 px.
_SMOOTH, _ROUGH = 1.0, 1e-2
#: Tolerance: the median of the squares of a normal variable of unit variance.
MEDIAN_SQUARE = 0.455
#: Prior: the PRF's sum over pixels is about 1, wherever in a pixel the star is: places along an
#: axis, and standard deviation.
_PHASES, _SUM = 8, 2e-4
#: Tolerance: its mean in the darkest part of the pixels is background by definition, and 0.
_DARK, _LEVEL = 0.1, 2e-6
#: Tolerance: largest steps of a position (px) and a width in one iteration.
_LARGEST_STEP, _LARGEST_BREATH = 0.3, 0.02


@dataclass(frozen=True)
class Shape:
    """
    Image of the stars, in what all cadences share.

    Parameters
    ----------
    grid : SplineGrid
        Splines of the PRF.
    coefficients : ndarray
        Of the splines, ``(size, size)``, rows first; the PRF's sum over pixels is about 1.
    prior_mean : ndarray
        Coefficients of the first guess, of the same shape.
    gains : ndarray
        Relative response of each pixel, ``(ny, nx)``.
    neighbors : ndarray
        Flux (e-/s) and distance (px, column and row) from the target, ``(m, 3)``.
    first_neighbors : ndarray
        The same as first measured, about which there are priors.
    dark : ndarray
        The PRF's mean in the darkest pixels as a row of the coefficients.
    """

    grid: SplineGrid
    coefficients: np.ndarray
    prior_mean: np.ndarray
    gains: np.ndarray
    neighbors: np.ndarray
    first_neighbors: np.ndarray
    dark: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Track:
    """
    State of each cadence, arrays ``(n,)``.

    Parameters
    ----------
    flux : ndarray
        Flux of the target in units of the PRF, e-/s.
    x, y : ndarray
        Column and row of the target in pixels.
    width : ndarray
        Relative change of the PRF's width.
    background : ndarray
        Background in e-/s per pixel.
    """

    flux: np.ndarray
    x: np.ndarray
    y: np.ndarray
    width: np.ndarray
    background: np.ndarray

    def __getitem__(self, which):
        return Track(*(values[which] for values in self.stacked.T))

    @property
    def stacked(self):
        """Columns flux, x, y, width, background; ``(n, 5)``."""
        return np.stack([self.flux, self.x, self.y, self.width, self.background], axis=1)


@dataclass(frozen=True)
class Priors:
    """
    Gaussian priors of the states: means like a `Track`, and standard deviations.

    Parameters
    ----------
    mean : ndarray
        ``(n, 5)`` or with the changes of neighbors, columns as in `Track.stacked`.
    sigma : ndarray
        Standard deviations; infinite where there is no prior.
    """

    mean: np.ndarray
    sigma: np.ndarray

    def __getitem__(self, which):
        return Priors(self.mean[which], self.sigma[which])


def _star(shape, x, y, width, slopes):
    """Return one star's images ``(n, ny, nx)`` without gains, and slopes by x, y and width."""
    ny, nx = shape.gains.shape
    grid, scale = shape.grid, 1 / (1 + width)[:, None]
    u, v = (np.arange(nx) - x[:, None]) * scale, (np.arange(ny) - y[:, None]) * scale
    columns, rows = grid.values(u), grid.values(v)
    half = shape.coefficients @ columns.transpose(0, 2, 1)
    area = (scale**2)[:, :, None]
    image = (rows @ half) * area
    if not slopes:
        return image, None
    by_x = -(rows @ (shape.coefficients @ grid.slopes(u).transpose(0, 2, 1))) * area
    by_y = -(grid.slopes(v) @ half) * area
    by_width = -(2 * image - u[:, None, :] * by_x - v[:, :, None] * by_y)
    return image, (by_x, by_y, by_width)


@dataclass(frozen=True)
class Rendered:
    """
    Images ``(n, ny, nx)``, with gains.

    Parameters
    ----------
    star : ndarray
        Image of the target of unit flux.
    others : ndarray
        Neighbors in e-/s.
    slopes : tuple of ndarray or None
        Derivatives of all stars' light by x, y and width, in e-/s.
    """

    star: np.ndarray
    others: np.ndarray
    slopes: tuple | None = None


def render(shape, track, *, slopes=False):
    """Return the images of the target and of its neighbors."""
    star, by_star = _star(shape, track.x, track.y, track.width, slopes)
    total = None
    if slopes:
        total = [track.flux[:, None, None] * s for s in by_star]
    others = np.zeros_like(star)
    for flux, dx, dy in shape.neighbors:
        image, by_other = _star(shape, track.x + dx, track.y + dy, track.width, slopes)
        others += flux * image
        if slopes:
            total = [s + flux * slope for s, slope in zip(total, by_other, strict=True)]
    b = shape.gains
    if slopes:
        total = tuple(b * s for s in total)
    return Rendered(b * star, b * others, total)


def _linearized(shape, track, flux):
    """Return residual ``(n, p)``, derivatives by the state ``(n, p, 5)``, and the stars' light."""
    images = render(shape, track, slopes=True)
    n = len(flux)
    light = track.flux[:, None, None] * images.star + images.others
    residual = flux - light - track.background[:, None, None]
    parts = (images.star, *images.slopes, np.ones_like(light))
    jacobian = np.stack([p.reshape(n, -1) for p in parts], axis=2)
    return residual.reshape(n, -1), jacobian, light.reshape(n, -1)


def _weights(variance, light, floor):
    """Inverse variance of noise and model errors; pixels without data have infinite variance."""
    return 1 / (variance.reshape(light.shape) + (floor * light) ** 2)


def residuals(shape, track, flux):
    """Return what the model leaves of the pixels, and the stars' light, ``(n, ny, nx)``."""
    images = render(shape, track)
    light = track.flux[:, None, None] * images.star + images.others
    return flux - light - track.background[:, None, None], light


def neighbor_images(shape, track, change):
    """Return the light of each neighbor whose flux changes by ``(n, m)``, a list of images."""
    images = _unit_images(shape, track, change.shape[1])
    fluxes = (shape.neighbors[:, 0] + change).T
    return [flux[:, None, None] * image for flux, image in zip(fluxes, images, strict=True)]


def changed_light(shape, track, change):
    """Return the light of changes of the neighbors' fluxes, ``(n, m)``, in all pixels."""
    return _sum_of(_unit_images(shape, track, change.shape[1]), change)


def _sum_of(images, change):
    return sum(c[:, None, None] * image for c, image in zip(change.T, images, strict=True))


def _unit_images(shape, track, count):
    return [
        shape.gains * _star(shape, track.x + dx, track.y + dy, track.width, slopes=False)[0]
        for _, dx, dy in shape.neighbors[:count]
    ]


def solve_track(shape, track, flux, variance, priors, floor, steps=3):
    """Return the states of all cadences with constant neighbors; arguments as `solve_states`."""
    constant = np.empty((len(flux), 0))
    return solve_states(shape, track, constant, flux, variance, priors, floor, steps)[0]


def solve_states(shape, track, change, flux, variance, priors, floor, steps=2):
    """
    Fit the state of each cadence with the shape held.

    Parameters
    ----------
    shape, track
        Where to begin.
    change : ndarray
        Change of each neighbor's flux (e-/s), ``(n, m)``, or of none, ``(n, 0)``.
    flux : ndarray
        Pixels ``(n, ny, nx)`` in e-/s, finite everywhere.
    variance : ndarray
        Of their noise; infinite in pixels that are left out.
    priors : Priors
        Of the states and of these changes, ``(n, 5 + m)``.
    floor : float
        Model errors relative to the stars' light.
    steps : int
        Number of Gauss-Newton steps.

    Returns
    -------
    track : Track
        The fitted states.
    change : ndarray
        The fitted changes.
    error : ndarray
        Standard deviations of both, ``(n, 5 + m)``.
    """
    precision = priors.sigma**-2.0
    for _ in range(steps):
        images = _unit_images(shape, track, change.shape[1])
        residual, jacobian, light = _linearized(shape, track, flux - _sum_of(images, change))
        more = [image.reshape(len(flux), -1, 1) for image in images]
        jacobian = np.concatenate([jacobian, *more], axis=2)
        weight = _weights(variance, light, floor)
        weighted = (jacobian * weight[:, :, None]).transpose(0, 2, 1)
        normal = weighted @ jacobian
        right = (weighted @ residual[:, :, None])[:, :, 0]
        state = np.concatenate([track.stacked, change], axis=1)
        right += precision * np.where(np.isfinite(priors.sigma), priors.mean - state, 0.0)
        step, error = _solve(normal, right, precision)
        step[:, 1:3] = np.clip(step[:, 1:3], -_LARGEST_STEP, _LARGEST_STEP)
        step[:, 3] = np.clip(step[:, 3], -_LARGEST_BREATH, _LARGEST_BREATH)
        state = state + step
        track, change = Track(*state[:, :5].T), state[:, 5:]
    return track, change, error


def _solve(normal, right, precision):
    """Solve the small systems, scaled so that their diagonals are 1; return errors too."""
    diagonal = np.einsum("nii->ni", normal) + precision
    root = 1 / np.sqrt(np.maximum(diagonal, 1e-300))
    scaled = normal * root[:, :, None] * root[:, None, :]
    index = np.arange(right.shape[1])
    scaled[:, index, index] = 1 + 1e-10
    inverse = np.linalg.inv(scaled)
    step = root * (inverse @ (root * right)[:, :, None])[:, :, 0]
    return step, root * np.sqrt(np.maximum(np.einsum("nii->ni", inverse), 0.0))


def improve_shape(shape, track, flux, variance, priors, floor, gain=_GAIN):
    """
    Make one Gauss-Newton step of the shape, with the states of all cadences eliminated.

    The step takes into account that position, flux, width and background follow: with the
    states held, the shape would converge slowly. Arguments as in `solve_states`.
    """
    grid = shape.grid
    residual, jacobian, light = _linearized(shape, track, flux)
    root = np.sqrt(_weights(variance, light, floor))
    columns = _shape_columns(shape, track, light).multiply(root.ravel()[:, None]).tocsr()
    # the states, with their priors as further data
    own = jacobian * root[:, :, None]
    strength = np.where(np.isfinite(priors.sigma), 1 / priors.sigma, 0.0)
    stacked = np.concatenate([own, strength[:, :, None] * np.eye(5)], axis=1)
    scale = np.maximum(np.sqrt(np.sum(stacked**2, axis=1, keepdims=True)), 1e-300)
    q, _ = np.linalg.qr(stacked / scale)
    pull = strength * np.where(np.isfinite(priors.sigma), priors.mean - track.stacked, 0.0)
    data = np.concatenate([residual * root, pull], axis=1)
    inner = (q.transpose(0, 2, 1) @ data[:, :, None])[:, :, 0]
    q = q[:, : own.shape[1]]
    projected = _block_rows(q) @ columns
    projected = projected.toarray()
    normal = (columns.T @ columns).toarray() - projected.T @ projected
    left = data[:, : own.shape[1]].ravel()
    right = columns.T @ left - projected.T @ inner.ravel()
    away, precision = _shape_prior(shape, gain)
    normal += precision
    right -= precision @ away
    matrix, values = _about_prf(shape)
    k = grid.size**2
    normal[:k, :k] += matrix.T @ matrix
    right[:k] += matrix.T @ (values - matrix @ shape.coefficients.ravel())
    unit = 1 / np.sqrt(np.diag(normal))
    step = unit * cho_solve(cho_factor(normal * unit[:, None] * unit + 1e-10 * np.eye(len(unit))),
                            unit * right)  # fmt: skip
    p = k + shape.gains.size
    return replace(
        shape,
        coefficients=shape.coefficients + step[:k].reshape(grid.size, grid.size),
        gains=shape.gains + step[k:p].reshape(shape.gains.shape),
        neighbors=shape.neighbors + step[p:].reshape(-1, 3),
    )


def _shape_prior(shape, gain):
    """Return what all that cadences share is away from its mean by, and the prior's precision."""
    first, m, centers = shape.prior_mean, shape.first_neighbors, shape.grid.centers
    half = shape.grid.values(centers / _BROAD)
    prf = (_PRF * np.abs(half @ first @ half.T) + _PRF_LEAST * first.max()).ravel()
    around = np.stack([_FLUX * m[:, 0], *np.full((2, len(m)), _PLACE)], axis=1)
    along = (1 - _ROUGH) * np.exp(-0.5 * ((centers[:, None] - centers) / _SMOOTH) ** 2)
    along = np.linalg.inv(along + _ROUGH * np.eye(len(centers)))
    others = np.append(np.full(shape.gains.size, gain), around)
    away = [shape.coefficients - first, shape.gains - 1, shape.neighbors - m]
    precision = block_diag(np.kron(along, along) / np.outer(prf, prf), np.diag(others**-2.0))
    return np.concatenate([part.ravel() for part in away]), precision


def _sums_over_pixels(grid):
    """Return the matrix from the coefficients to the PRF's sum over pixels at places in the pixel.

    Images do not constrain this sum, which the flux may be divided by: only a prior does.
    """
    phases = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    last = int(np.floor(grid.knots[-1] - 0.5))
    pixels = np.arange(-last, last + 1)
    along = grid.values(pixels[:, None] - phases).sum(axis=0)
    return np.einsum("ai,bj->abij", along, along).reshape(_PHASES**2, -1)


def _about_prf(shape):
    """Return rows of the coefficients and their expected values, over standard deviations."""
    sums = _sums_over_pixels(shape.grid)
    rows = np.vstack([sums / _SUM, np.broadcast_to(shape.dark, sums[:1].shape) / _LEVEL])
    return rows, np.append(np.full(len(sums), 1 / _SUM), 0.0)


def without_level(shape, track):
    """Return a shape whose PRF is 0 on average in the darkest pixels, and stays so."""
    one = np.ones(len(track.x))
    columns = _spline_columns(shape, one, track.x, track.y, track.width)
    mean = columns.toarray().reshape(len(one), shape.gains.size, -1).mean(axis=0)
    image = mean @ shape.coefficients.ravel()
    dark = mean[image <= np.quantile(image, _DARK)].mean(axis=0)
    left = shape.coefficients - dark @ shape.coefficients.ravel()  # splines add up to 1
    size = np.mean(_sums_over_pixels(shape.grid) @ left.ravel())
    others = shape.neighbors * [size, 1, 1]
    return replace(
        shape, coefficients=left / size, prior_mean=left / size, neighbors=others,
        first_neighbors=others, dark=dark,
    )  # fmt: skip


def _shape_columns(shape, track, light):
    """Return the derivatives of all pixels by coefficients, gains and neighbors, sparse."""
    n, p = light.shape
    parts = [_spline_columns(shape, track.flux, track.x, track.y, track.width)]
    by_neighbor = []
    for flux, dx, dy in shape.neighbors:
        x, y = track.x + dx, track.y + dy
        parts[0] = parts[0] + _spline_columns(shape, np.full(n, flux), x, y, track.width)
        image, (by_x, by_y, _) = _star(shape, x, y, track.width, slopes=True)
        by_neighbor += [shape.gains * image, flux * shape.gains * by_x, flux * shape.gains * by_y]
    gains = sparse.csr_array(
        ((light / shape.gains.ravel()).ravel(), np.tile(np.arange(p), n), np.arange(n * p + 1)),
        shape=(n * p, p),
    )
    parts.append(gains)
    if by_neighbor:
        parts.append(sparse.csr_array(np.stack([b.ravel() for b in by_neighbor], axis=1)))
    return sparse.hstack(parts, format="csr")


def _spline_columns(shape, flux, x, y, width):
    ny, nx = shape.gains.shape
    grid, scale, n = shape.grid, 1 / (1 + width)[:, None], len(x)
    column, i = grid.few((np.arange(nx) - x[:, None]) * scale)
    row, j = grid.few((np.arange(ny) - y[:, None]) * scale)
    values = row[:, :, None, :, None] * column[:, None, :, None, :]
    factor = (flux[:, None] * scale**2)[:, :, None] * shape.gains
    values = values * factor[..., None, None]
    index = grid.size * j[:, :, None, :, None].astype(np.int64) + i[:, None, :, None, :]
    rows = n * ny * nx
    return sparse.csr_array(
        (values.ravel(), index.ravel(), 16 * np.arange(rows + 1)), shape=(rows, grid.size**2)
    )


def _block_rows(q):
    """Return the transposed blocks ``(n, p, k)`` as one sparse block-diagonal matrix."""
    n, p, k = q.shape
    columns = np.broadcast_to(np.arange(n * p).reshape(n, 1, p), (n, k, p))
    return sparse.csr_array(
        (q.transpose(0, 2, 1).ravel(), columns.ravel(), p * np.arange(n * k + 1)),
        shape=(n * k, n * p),
    )


def misfit(shape, track, flux, variance, priors, floor, gain):
    """Return what the fit minimizes: squares of residuals and of deviations from the priors."""
    rest, _ = residuals(shape, track, flux)
    value = np.sum(rest**2 / (variance + (floor * np.abs(flux)) ** 2))
    value += np.nansum(((track.stacked - priors.mean) / priors.sigma) ** 2)
    away, precision = _shape_prior(shape, gain)
    matrix, values = _about_prf(shape)
    value += np.sum((matrix @ shape.coefficients.ravel() - values) ** 2)
    return float(value + away @ precision @ away)


def between(old, new, part):
    """Return the shape a part of the way from an old to a new one."""
    return replace(new, **{
        name: getattr(old, name) + part * (getattr(new, name) - getattr(old, name))
        for name in ("coefficients", "gains", "neighbors")
    })  # fmt: skip


def measure_floor(shape, track, flux, variance):
    """Return the typical error of the model relative to the light, from the bright pixels."""
    residual, light = residuals(shape, track, flux)
    bright = (light > 0.05 * track.flux[:, None, None]) & np.isfinite(variance)
    if not bright.any():
        return 0.0
    excess = np.median(
        (residual[bright] ** 2 / MEDIAN_SQUARE - variance[bright]) / light[bright] ** 2
    )
    return float(np.sqrt(max(excess, 0.0)))
