"""Shares of a star's light in each pixel that differ from the PSF."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from scope_models._arrays import plain_array
from scope_models._checks import integer, number
from scope_models._values import frozen
from scope_models.effects.base import Effect

__all__ = ["PixelShares"]

# Highest degree in position of terms that change in time.
_SLOW_DEGREE = 3


@dataclass(frozen=True, eq=False, repr=False)
class PixelShares(Effect):
    r"""Shares of a star's light in each pixel beyond its PSF: smooth in position and slow time.

    .. math:: S_p(x, y, t) = P_p(x, y) + \sum_{ijk} c_{p,ijk}\, L_i(u)\, L_j(v)\, L_k(w)

    with the PSF's (and sensitivity's) share P of unit flux, Legendre polynomials L, and the
    star's position and the time scaled to -1..1 as u, v and w. `fit_tpf(..., response="pixels")
    <scope_models.fit_tpf>` measures them. Outside the ranges the last term is that of the
    nearest place or time in them.

    Parameters
    ----------
    coefficients : array_like of shape (k, ny, nx)
        Coefficients c, in the order of `terms`.
    x_range, y_range : tuple of float, optional
        Least and largest column and row of the star, pixels of the stamp.
    time_range : tuple of float, optional
        First and last time, days.
    degree, time_degree : int, optional
        Largest i + j, and largest k; terms with k > 0 have i + j of 3 at most.
    star : int, optional
        Number of the star in the scene.

    Notes
    -----
    A share that would be negative is zero in a simulation.

    Examples
    --------
    One percent of the star's light is in the first pixel instead of the middle one:

    >>> import numpy as np
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.effects import PixelShares
    >>> moved = np.zeros((1, 11, 11))
    >>> moved[0, 0, 0], moved[0, 5, 5] = 0.01, -0.01
    >>> shares = PixelShares(moved)
    >>> scene = Star(12.0), Detector.k2(), Motion.still(3)
    >>> with_it, without = (simulate(*scene, seed=1, noise=False, effects=e) for e in (shares, ()))
    >>> print(((with_it.flux - without.flux)[0, 0, 0] / 1.74e5).round(3))
    0.01
    """

    coefficients: np.ndarray
    x_range: tuple[float, float] = number((0.0, 1.0), "pix")
    y_range: tuple[float, float] = number((0.0, 1.0), "pix")
    time_range: tuple[float, float] = number((0.0, 1.0), "day")
    degree: int = integer(0, 0)
    time_degree: int = integer(0, 0)
    star: int = integer(0, 0)

    def __post_init__(self):
        super().__post_init__()
        values = plain_array(self.coefficients, "", "coefficients")
        for name in ("x_range", "y_range", "time_range"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"`{name}` must increase, got {(low, high)}")
        if values.ndim != 3 or len(values) != len(self.terms) or not np.isfinite(values).all():
            wanted = f"finite, of shape ({len(self.terms)}, ny, nx)"
            raise ValueError(f"`coefficients` must be {wanted}, got {values.shape}")
        object.__setattr__(self, "coefficients", frozen(values))

    @property
    def terms(self):
        """Degrees i, j, k of the terms, shape ``(k, 3)``."""
        return polynomial_terms(self.degree, self.time_degree)

    def changes(self, x, y, time):
        """Return the difference between the shares and the PSF's.

        Parameters
        ----------
        x, y : array_like of shape (n,)
            Column and row of the star, pixels.
        time : array_like of shape (n,)
            Days.

        Returns
        -------
        ndarray of shape (n, ny, nx)
            Parts of the star's flux.
        """
        pairs = (x, self.x_range), (y, self.y_range), (time, self.time_range)
        scaled = (scaled_to(*pair) for pair in pairs)
        return np.tensordot(polynomials(self.terms, *scaled)[0], self.coefficients, axes=1)

    def shares(self, drawn, conditions, star):
        if star != self.star:
            return None
        own, wanted = self.coefficients.shape[1:], tuple(conditions.shape)
        if own != wanted:
            raise ValueError(f"`coefficients` must be for {wanted} pixels, got {own}")
        return lambda x, y, part: self.changes(x, y, conditions.time[part])


def polynomial_terms(degree, time_degree):
    """Return the degrees i, j, k of the terms, lowest first, ``(k, 3)``."""
    terms = []
    for k in range(time_degree + 1):
        for n in range((min(degree, _SLOW_DEGREE) if k else degree) + 1):
            terms += [(i, n - i, k) for i in range(n + 1)]
    return np.array(terms)


def scaled_to(values, limits):
    """Return values scaled to -1..1 between limits, and the nearest of these outside."""
    low, high = limits
    return np.clip(2 * (np.asarray(values, dtype=float) - low) / (high - low) - 1, -1.0, 1.0)


def polynomials(terms, u, v, w):
    """Return the products of Legendre polynomials, and their derivatives by u and v, ``(n, k)``."""
    degrees = terms.max(axis=0)
    tables = [legendre.legvander(x, n) for x, n in zip((u, v, w), degrees, strict=True)]
    columns, rows, times = (t[:, terms[:, axis]] for axis, t in enumerate(tables))
    by_u, by_v = (
        (tables[axis][:, : max(n, 1)] @ legendre.legder(np.eye(n + 1)))[:, terms[:, axis]]
        for axis, n in enumerate(degrees[:2])
    )
    return columns * rows * times, by_u * rows * times, columns * by_v * times
