"""The stars of an image: one profile at several places."""

import numpy as np
from scipy.optimize import lsq_linear

from scope_models.correctors._pixels import OTHER_STAR, own_pixels
from scope_models.pixelmodel._star import IMAGE_ERROR

__all__ = [
    "NEAREST", "SHARE_ERROR", "NoLightError", "blend_of", "center_of_light", "star_share",
    "stars_of",
]  # fmt: skip

#: Prior: relative error of profile and image.
SHARE_ERROR = 0.03
#: Branch: least distance of separate stars (px), and largest number of stars.
NEAREST, _MOST = 1.4, 7
#: Branch: what stars leave is another one if it is so many times their light there.
_OVER_STAR = 0.7
#: Tolerance: number of places that are tried for another star.
_MOST_PLACES = 12
#: Tolerance: times that the light is shared out, and steps of places (px): of the derivative, the
#: standard deviation of one, and the last one.
_ROUNDS, _STEP, _MOVE, _SETTLED = 20, 0.05, 0.3, 0.02
#: Tolerance: widths of the Gaussians whose sum is the profile, in units of the star's, and standard
#: deviation of the window in which that is measured (px).
_WIDTHS, _WINDOW = (0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0), 1.5


class NoLightError(ValueError):
    """No profile with positive flux describes the pixels of the target."""


def stars_of(image, core, elsewhere):
    """Return the places of the stars in an image without background, that in the core first.

    Stars have peaks of their own, or hold most of the light ``elsewhere``. Returned is an array
    ``(k, 2)``, columns and rows.
    """
    places = [center_of_light(image, star) for star in _with_peaks(image, core)]
    light, places, _ = _fit(image, places)
    while len(places) < _MOST:
        light = light.sum(axis=0)
        rest = np.where(elsewhere & _away(image, places), image - light, 0.0)
        star = (rest > _OVER_STAR * light) & (rest > OTHER_STAR * image.max())
        if not star.any():
            break
        place = np.unravel_index(np.argmax(rest * star), image.shape)[::-1]
        light, moved, _ = _fit(image, np.vstack([places, place]))
        row, column = np.clip(np.rint(moved[-1, ::-1]).astype(int) + 1, 0, np.add(image.shape, 1))
        if not np.pad(elsewhere, 1)[row, column]:
            break
        places = moved
    return places


def blend_of(image, core):
    """Return the same, where another star has no peak of its own.

    A second star is there if one profile, which may be elliptical but is the same on both sides,
    does not describe the image within its error, and two of them leave less than half.
    """
    places = np.array([center_of_light(image, core)])
    misfit = _fit(image, places)[2]
    least = np.mean(misfit**2)
    if least < 1:
        return places
    pair, least = places, least / 2
    bright = _away(image, places) & (image > OTHER_STAR * image.max())
    order = np.argsort(np.where(bright, -misfit, np.inf), axis=None)
    for other in order[: min(bright.sum(), _MOST_PLACES)]:
        trial = np.vstack([places, np.unravel_index(other, image.shape)[::-1]])
        try:
            misfit = _fit(image, trial, move=False)[2]
        except NoLightError:
            continue
        if np.mean(misfit**2) < least:
            pair, least = trial, np.mean(misfit**2)
    return pair


def _away(image, places):
    """Return the pixels that are apart from all places."""
    rows, columns = np.indices(image.shape)
    return np.all([np.hypot(columns - x, rows - y) > NEAREST for x, y in places], axis=0)


def star_share(image, places):
    """Return the first star's share of the light in each pixel of such an image."""
    light, *_ = _fit(image, places, move=False)
    return light[0] / np.maximum(light.sum(axis=0), 1e-12 * light.sum())


def _with_peaks(image, core):
    """Return the pixels of each star with a peak of its own, that in the core first."""
    peak = int(np.argmax(np.where(core, image, -np.inf)))
    stars = [own_pixels(image, peak)]
    left = ~stars[0]
    while left.any():
        other = int(np.argmax(np.where(left, image, -np.inf)))
        if image.flat[other] < OTHER_STAR * image.flat[peak]:
            break
        stars.append(own_pixels(image, other) & left)
        left &= ~stars[-1]
    return stars


def center_of_light(image, star):
    """Return column and row of the center of light of the 3 x 3 pixels about a star's peak."""
    image = np.where(star, image, 0.0)
    row, column = np.unravel_index(np.argmax(image), image.shape)
    rows, columns = np.indices(image.shape)
    near = (np.abs(rows - row) <= 1) & (np.abs(columns - column) <= 1)
    weight = np.where(near, np.maximum(image, 0.0), 0.0)
    return np.array([np.sum(weight * columns), np.sum(weight * rows)]) / weight.sum()


def _fit(image, places, *, move=True):
    """Fit stars of one profile to an image without background.

    The profile is first learned from the pixels next to the first star; of several stars the places
    are fitted, too, if they may ``move``. Returned are their light ``(k, ny, nx)``, their places,
    and what they leave of the image, in standard deviations.
    """
    rows, columns = np.indices(image.shape)
    places = np.array(places, dtype=float)
    near = np.argmin([np.hypot(columns - x, rows - y) for x, y in places], axis=0) == 0
    total = image[near].sum()
    if not total > 0:
        raise NoLightError("the pixels of `tpf` hold no light near the target")
    own = np.where(near, image, 0.0)
    error = SHARE_ERROR * np.abs(image) + IMAGE_ERROR * total

    def solved(parts, values, precision=()):
        """Return the coefficients of parts of the image, ``(k, ny, nx)``, with their priors."""
        matrix, k = (parts / error).reshape(len(parts), -1), len(parts)
        gram = matrix @ matrix.T + np.diag([*precision, *[1e-12] * (k - len(precision))])
        return np.linalg.solve(gram, matrix @ (values / error).ravel())

    flux = np.zeros(len(places))
    for _ in range(_ROUNDS):
        x, y = places[0]
        profile = _profile((columns - x)[near], (rows - y)[near], own[near] / total)

        def stars(dx=0.0, dy=0.0, profile=profile, places=places):
            return np.array([profile(columns - x - dx, rows - y - dy) for x, y in places])

        light, last = stars(), flux
        flux = np.maximum(solved(light, image), 0.0)
        light *= flux[:, None, None]
        rest, change = image - light.sum(axis=0), np.abs(flux - last).max() / flux.max()
        if move and len(places) > 1:
            slopes = [stars(_STEP) - stars(-_STEP), stars(0, _STEP) - stars(0, -_STEP)]
            slopes = np.concatenate(np.array(slopes) * flux[:, None, None] / (2 * _STEP))
            step = solved(np.concatenate([slopes, light]), rest, [_MOVE**-2] * len(slopes))
            step = np.clip(step[: len(slopes)].reshape(2, -1).T, -_MOVE, _MOVE)
            places, change = places + step, max(change, np.abs(step).max())
        if len(places) == 1 or change < _SETTLED:
            break
        near = np.ones_like(near)
        own = image * light[0] / np.maximum(light.sum(axis=0), 1e-12 * total)
    return light, places, rest / error


def _profile(u, v, values):
    """Fit a non-negative sum of Gaussians of one shape and several widths, and a constant.

    Values are light over a star's flux, at distances from it (px); returned is the function of
    these, without the constant, which takes what is left of the background.
    """
    window = np.exp(-0.5 * (u**2 + v**2) / _WINDOW**2) * np.clip(values, 0, None)
    if not window.sum() > 0:
        raise NoLightError("the pixels of `tpf` hold no light of the target")
    moments = np.array([[np.sum(window * a * b) for a in (u, v)] for b in (u, v)]) / window.sum()
    # strips of one row or column have no extent across
    inverse = np.linalg.inv(moments + 1e-6 * np.eye(2)) - np.eye(2) / _WINDOW**2
    eigen, vectors = np.linalg.eigh(inverse)
    inverse = (vectors * np.clip(eigen, 1 / 2.0**2, 1 / 0.3**2)) @ vectors.T
    area = 2 * np.pi / np.sqrt(np.linalg.det(inverse))

    def gaussians(u, v):
        square = inverse[0, 0] * u**2 + 2 * inverse[0, 1] * u * v + inverse[1, 1] * v**2
        return np.stack([np.exp(-0.5 * square / s**2) / (area * s**2) for s in _WIDTHS], axis=-1)

    weight = 1 / (SHARE_ERROR * np.abs(values) + IMAGE_ERROR)
    columns = np.column_stack([gaussians(u, v), np.ones(len(u))]) * weight[:, None]
    q, r = np.linalg.qr(columns)
    bounds = (np.append(np.zeros(len(_WIDTHS)), -np.inf), np.inf)
    found = lsq_linear(r, q.T @ (values * weight), bounds, method="bvls").x[:-1]
    return lambda u, v: gaussians(u, v) @ found
