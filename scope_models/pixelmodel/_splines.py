"""A PRF as a tensor product of cubic splines: values and slopes at many places at once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

__all__ = ["SplineGrid", "make_grid"]

#: Tolerance: degree of the splines.
_DEGREE = 3
#: Tolerance: knots are so far apart (px) within so many pixels of the star.
_SPACINGS = ((1.5, 0.25), (3.0, 0.5), (6.0, 1.0))
#: Tolerance: and so far apart farther out.
_FAR_SPACING = 2.0


@dataclass(frozen=True)
class SplineGrid:
    """Knots of a cubic spline along one axis.

    Parameters
    ----------
    knots : ndarray
        Increasing places in pixels; the outermost are four times the same.
    """

    knots: np.ndarray

    @property
    def size(self):
        """Number of splines."""
        return len(self.knots) - _DEGREE - 1

    @cached_property
    def centers(self):
        """Mean of the inner knots of each spline, where it is about largest."""
        return np.array([self.knots[i + 1 : i + 4].mean() for i in range(self.size)])

    @cached_property
    def _to_slope(self):
        """Matrix from the splines' coefficients to those of the derivative."""
        t, k = self.knots, _DEGREE
        matrix = np.zeros((self.size - 1, self.size))
        for i in range(self.size - 1):
            matrix[i, i + 1] = k / (t[i + k + 1] - t[i + 1])
            matrix[i, i] = -matrix[i, i + 1]
        return matrix

    def values(self, u):
        """Return the splines at places of any shape, ``(..., size)``."""
        return self._sparse(u, self.knots, _DEGREE).toarray().reshape(*u.shape, self.size)

    def slopes(self, u):
        """Return the splines' derivatives at places of any shape, ``(..., size)``."""
        lower = self._sparse(u, self.knots[1:-1], _DEGREE - 1) @ self._to_slope
        return np.asarray(lower).reshape(*u.shape, self.size)

    def few(self, u):
        """Return the four splines that differ from zero at each place: values and indices."""
        matrix = self._sparse(u, self.knots, _DEGREE)
        shape = (*u.shape, _DEGREE + 1)
        return matrix.data.reshape(shape), matrix.indices.reshape(shape)

    def _sparse(self, u, knots, degree):
        inside = np.clip(u.ravel(), self.knots[0], self.knots[-1])
        return BSpline.design_matrix(inside, knots, degree)

    def interpolate(self, image):
        """Return the coefficients ``(size, size)`` of an image at `centers` (rows, columns)."""
        inverse = np.linalg.inv(self.values(self.centers))
        return inverse @ image @ inverse.T


def make_grid(reach):
    """Return knots that are dense at the star and sparse in its wings.

    Parameters
    ----------
    reach : float
        Largest distance along an axis from the star to a pixel.
    """
    edges, last = [0.0], 0.0
    for end, step in (*_SPACINGS, (np.inf, _FAR_SPACING)):
        count = int(np.ceil((min(end, reach) - last) / step - 1e-9))
        edges += [last + step * (i + 1) for i in range(max(count, 0))]
        last = edges[-1]
        if last >= reach:
            break
    right = np.array(edges)
    inner = np.concatenate([-right[:0:-1], right])
    return SplineGrid(np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3]))
