"""Columns with full pixels, of which only the sums follow the star.

The charge of a full pixel bleeds along its column: the pixel stays full when the star dims, so
that its share of the light follows the dimming, but the column's sum does not depend on it.
"""

import numpy as np

__all__ = ["FEWEST", "Columns", "full_columns"]

#: Branch: what is seen in fewer cadences may be an accident.
FEWEST = 3


def full_columns(images, use, saturation):
    """Return which columns of images are full in some of the cadences in use.

    The ``saturation`` is the flux of a full pixel or None.
    """
    if saturation is None:
        return np.zeros(images.shape[2], dtype=bool)
    return (np.sum(images[use] > saturation, axis=0) >= FEWEST).any(axis=0)


class Columns:
    """Pixels, of which those of each full column are one.

    Parameters
    ----------
    grid : ndarray
        Column and row of each pixel, ``(n_pixels, 2)``.
    full : ndarray of bool
        Pixels of full columns, ``(n_pixels,)``.

    Attributes
    ----------
    places : ndarray
        Mean column and row of the pixels of each sum, ``(n_sums, 2)``.
    single : ndarray of bool
        Which sums are of one pixel that is not full, ``(n_sums,)``.
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
