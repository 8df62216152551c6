"""Light of other stars in an aperture: what does not vary with the star.

The images of a variable star's pixels are those of all light, and of what varies. Their difference
is the constant light, up to a multiple of the star's image, and up to a shift of it: positions that
were fitted may follow the star's brightness a little. Both are fixed in the star's bright pixels,
which hold hardly more than the wing of a neighbor.
"""

import numpy as np

from scope_models.correctors._position import REWEIGHTS, along_position

__all__ = ["constant_light"]

#: Branch: the star's bright pixels have this part of the brightest one's light.
_BRIGHT = 0.1
#: Prior: relative error of images, and (px) of what fitted positions follow the relative
#: brightness.
_IMAGE_ERROR, _SHIFT = 0.003, 0.01
#: Tolerance: passes of robust fits.
_PASSES = 3
#: Tolerance: width (px) of the rings of the star's profile.
_RING = 0.5


def constant_light(image, own, slopes, position, grid, inside, use):
    """Return the constant light in an aperture, a part of the light in each cadence ``(n,)``.

    ``image`` and ``own`` are images of all light, whose sum over the aperture is 1, and of what
    varies, ``(n, n_pixels)``; ``slopes`` are derivatives of the image by columns and rows. It is
    learned from the cadences in ``use``; ``inside`` are the pixels of the aperture.
    """
    mean, *columns = (values[use].mean(axis=0) for values in (image, own, *slopes))
    bright = inside & (columns[0] > _BRIGHT * columns[0][inside].max())
    coefficients, root, wing = _own_part(mean, np.column_stack(columns), bright, grid)
    a = np.stack([own, *slopes], axis=2)[:, bright] * root[:, None]
    hessian, right = a.transpose(0, 2, 1) @ a, ((image - wing)[:, None, bright] * root) @ a
    hessian[:, [1, 2], [1, 2]] += _SHIFT**-2
    right[:, 0, 1:] += coefficients[1:] / _SHIFT**2
    part = np.linalg.solve(hessian, right.transpose(0, 2, 1))[:, 0, 0]
    light = image[:, inside].sum(axis=1) - part * own[:, inside].sum(axis=1)
    return along_position(light, position, use)


def _own_part(mean, columns, bright, grid):
    """Fit an image by the star's and its slopes in bright pixels, beside the wing of a neighbor.

    Returns the coefficients, the square roots of the weights of the bright pixels, and the wing.
    """
    star, wing = columns[:, 0], np.zeros_like(mean)
    for _ in range(_PASSES):
        error = np.hypot(_IMAGE_ERROR * star, wing)[bright]
        weight = np.ones(bright.sum())
        for _ in range(REWEIGHTS):
            root = np.sqrt(weight) / error
            fit = columns[bright] * root[:, None], (mean - wing)[bright] * root
            coefficients = np.linalg.lstsq(*fit, rcond=None)[0]
            rest = mean - wing - columns @ coefficients
            weight = 1 / (1 + (rest[bright] / error) ** 2)
        wing = _wing(rest + wing, star, grid)
    return coefficients, root, wing


def _wing(other, star, grid):
    """Return the image of the brightest neighbor: the star's radial profile at its place."""
    around = np.abs(grid - grid[np.argmax(other)]).max(axis=1) <= 1
    light = np.where(around, np.maximum(other, 0), 0)
    if not light.any():
        return light
    core = np.where(star > 0.05 * star.max(), star, 0)
    radius, distance = (
        np.hypot(*(grid - weight @ grid / weight.sum()).T) for weight in (core, light)
    )
    ring = (radius / _RING).astype(int)
    rings = np.unique(ring)
    size = np.log(np.maximum(star, 1e-5 * star.max()))
    profile, place = ([np.median(values[ring == k]) for k in rings] for values in (size, radius))
    image = np.exp(np.interp(distance, place, profile))
    return image * (light @ image) / (image[around] @ image[around])
