"""Columns with full pixels, of which only the sums follow the star.

The charge of a full pixel bleeds along its column: the pixel stays full when the star dims, so
that its share of the light follows the dimming, but the column's sum does not depend on it.
"""

import numpy as np
from scipy.special import ndtr

from scope_models.pixelmodel._position import polynomials

__all__ = [
    "FEWEST", "Columns", "find_row_centers", "full_columns", "full_pixels", "rows_of_star",
    "without_saturation",
]  # fmt: skip

#: Branch: what is seen in fewer cadences may be an accident.
FEWEST = 3
#: Prior: standard deviation in pixels of the Gaussian that stands for the star along a full column:
#: Kepler's PRF has 0.45 of its light in one pixel, as one of 0.5 px (Kepler telescope page); wings
#: make it wider.
_DRAWN_WIDTH = 0.6
#: Branch: a column constrains the row if it holds this share of the light, with twice it fully:
#: the center of less is that of the background.
_SMALLEST_SHARE = 5e-3
#: Tolerance: weight of the center of all light, where no column constrains the row, and of no tilt.
_LEAST = 1e-6


def full_pixels(images, use, saturation):
    """Return which pixels exceed that of a full one, if it is known, in some cadences in use."""
    return np.sum(images[use] > (saturation or np.inf), axis=0) >= FEWEST


def full_columns(images, use, saturation):
    """Return which columns of images have full pixels."""
    return full_pixels(images, use, saturation).any(axis=0)


class Columns:
    """Pixels, of which those of each full column are one sum.

    The ``grid`` has column and row of each pixel, ``(n_pixels, 2)``, ``places`` their means in each
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
    total = weight.sum(axis=1, keepdims=True) + _LEAST
    row = np.sum((weight + _LEAST * share) * center, axis=1, keepdims=True) / total
    # the equations of the tilt alone: at any tilt, the best row is the mean of what it leaves
    mean = np.einsum("ij,ijk->ik", weight, tilt) / total
    normal = np.einsum("ij,ija,ijb->ab", weight[use], tilt[use], tilt[use], optimize=True)
    normal += _LEAST * np.eye(len(knots)) - (total * mean)[use].T @ mean[use]
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
