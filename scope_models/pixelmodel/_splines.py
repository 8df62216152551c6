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
    def _splines(self):
        return BSpline(self.knots, np.eye(self.size), _DEGREE)

    @cached_property
    def _slopes(self):
        return self._splines.derivative()

    def values(self, u):
        """Return the splines at places of any shape, ``(..., size)``."""
        return self._splines(self._inside(u))

    def slopes(self, u):
        """Return the splines' derivatives at places of any shape, ``(..., size)``."""
        return self._slopes(self._inside(u))

    def few(self, u):
        """Return the four splines that differ from zero at each place: values and indices."""
        matrix = BSpline.design_matrix(self._inside(u).ravel(), self.knots, _DEGREE)
        shape = (*u.shape, _DEGREE + 1)
        return matrix.data.reshape(shape), matrix.indices.reshape(shape)

    def _inside(self, u):
        return np.clip(u, self.knots[0], self.knots[-1])

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
