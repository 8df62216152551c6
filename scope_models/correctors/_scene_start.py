"""First guesses of a scene: where the star is, what it looks like, and which others there are."""

import numpy as np
from scipy.optimize import lsq_linear

from scope_models.correctors._scene_model import Shape, Track
from scope_models.correctors._splines import make_grid

__all__ = ["NoLightError", "centroids", "first_shape", "first_track", "fit_gaussians"]

#: Widths of the Gaussians whose sum is the first guess, in units of the star's.
_WIDTHS = (0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
#: Standard deviation of the window of the centroids (px).
_WINDOW = 1.5
_MOST_PIXELS = 20000


class NoLightError(ValueError):
    """No profile with positive flux describes the pixels of the target."""


def centroids(images, x, y, steps=6):
    """
    Return centers of light in a Gaussian window that moves along.

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
    """
    Return positions, and whether POS_CORR describes the motion.

    POS_CORR is used along with the images if the images' centers follow it.

    Parameters
    ----------
    images : ndarray
        ``(n, ny, nx)``, without background.
    pos_corr : ndarray or None
        ``(n, 2)``; NaN where unknown.
    peak : tuple of float
        Column and row of the target in a typical cadence.
    """
    n = len(images)
    column, row = np.full(n, float(peak[0])), np.full(n, float(peak[1]))
    if pos_corr is not None:
        known = np.isfinite(pos_corr).all(axis=1)
        if known.mean() > 0.5:
            middle = np.median(pos_corr[known], axis=0)
            offset = np.where(known[:, None], pos_corr - middle, 0.0)
            x, y = centroids(images, column + offset[:, 0], row + offset[:, 1])
            follows = _correlation(x[known], offset[known, 0], y[known], offset[known, 1])
            if follows > 0.5:
                seen = np.stack([x, y], axis=1)
                place = np.median((seen - offset)[known], axis=0)
                return (place + offset).T, known
    x, y = centroids(images, column, row)
    return np.stack([x, y]), np.zeros(n, dtype=bool)


def _correlation(x, a, y, b):
    """Share of the centers' motion that follows the offsets, of both axes together."""
    x, a, y, b = (values - values.mean() for values in (x, a, y, b))
    whole = np.sum(x**2) + np.sum(y**2)
    slope = (np.sum(x * a) + np.sum(y * b)) / max(np.sum(a**2) + np.sum(b**2), 1e-30)
    rest = np.sum((x - slope * a) ** 2) + np.sum((y - slope * b) ** 2)
    return 1 - rest / max(whole, 1e-30)


def fit_gaussians(u, v, values, weight):
    """
    Fit a non-negative sum of Gaussians of one shape and several widths, and a constant.

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
    """
    window = np.exp(-0.5 * (u**2 + v**2) / _WINDOW**2) * np.clip(values, 0, None)
    moments = np.array([[np.sum(window * a * b) for a in (u, v)] for b in (u, v)]) / window.sum()
    inverse = np.linalg.inv(moments) - np.eye(2) / _WINDOW**2
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
    """
    Return the first guess of the PRF, on splines, from all cadences' pixels.

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
        raise NoLightError("the pixels hold no light of the target; use PLDCorrector")
    coefficients = grid.interpolate(image / sum_of)
    none = np.empty((0, 3))
    shape = Shape(grid, coefficients, coefficients, np.ones((ny, nx)), none, none)
    zero = np.zeros(n)
    return shape, Track(total * sum_of, np.array(x), np.array(y), zero, zero)
