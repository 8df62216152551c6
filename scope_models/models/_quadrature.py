# Licensed under a 3-clause BSD style license - see LICENSE
"""Adaptive tensor Gauss-Legendre quadrature over pixels, for integrands without a closed form."""

import warnings

import numpy as np

from scope_models.exceptions import IntegrationWarning
from scope_models.models._axis import gauss_legendre

__all__ = ["integrate_adaptively"]

# Change between two rules, as part of an image's flux, at which a pixel has converged.
_TOLERANCE = 1e-11
# Growth of the number of nodes from rule to rule, and the number that leads to a subdivision.
_GROWTH = 1.5
_MOST_NODES = 48
# Pixels are cut into quarters at most this often.
_DEPTH = 8
# Evaluations of the integrand held in memory at a time.
_CHUNK = 1 << 18


def _rule(integrand, index, corner_u, corner_v, size, n):
    """Integrals over squares of one size by a rule of n times n nodes."""
    nodes, weights = gauss_legendre(n)
    result = None
    step = max(1, _CHUNK // n**2)
    for start in range(0, index.size, step):
        part = slice(start, start + step)
        u = (corner_u[part, np.newaxis] + size * nodes)[:, np.newaxis, :]
        v = (corner_v[part, np.newaxis] + size * nodes)[:, :, np.newaxis]
        values = np.broadcast_to(integrand(u, v, index[part]), (u.shape[0], n, n))
        sums = (values @ weights) @ weights
        if result is None:
            result = np.empty(index.size)
        result[part] = sums
    return result * size**2


def integrate_adaptively(integrand, groups, scale):
    """
    Integrate a function over unit squares, with more nodes where it asks for them.

    Every square is integrated by two rules; where they differ by more than 1e-11 of the sum of
    its group, the number of nodes grows by half, and beyond 48 per axis the square is cut into
    quarters.

    Parameters
    ----------
    integrand : callable
        ``integrand(u, v, index)`` with offsets u of shape ``(m, 1, k)`` and v of shape
        ``(m, k, 1)`` from the centers of the squares ``index``, shape ``(m,)``.
    groups : `~numpy.ndarray` of int
        Which image each square belongs to, shape ``(n,)``.
    scale : float
        Smallest width of the integrand in pixels, which sets the first number of nodes.

    Returns
    -------
    integrals : `~numpy.ndarray`
        Shape ``(n,)``.

    Warns
    -----
    IntegrationWarning
        Where a square has not converged in the end.
    """
    n = min(int(np.ceil(5 + 2.1 / scale)), _MOST_NODES)
    index = np.arange(groups.size)
    center = np.zeros(groups.size)
    totals = _rule(integrand, index, center, center, 1.0, n)
    tolerance = _TOLERANCE * np.bincount(groups, np.abs(totals))[groups]
    return _refined(integrand, index, center, center, 1.0, n, totals, tolerance, 0)


def _refined(integrand, index, corner_u, corner_v, size, n, values, tolerance, depth):
    """Improve the values of squares until their rules agree."""
    values = values.copy()
    active = np.arange(index.size)
    while active.size and n < _MOST_NODES:
        # From odd to even and back: two even rules agree on a step near their common center.
        n += int(n * _GROWTH - n) // 2 * 2 + 1
        better = _rule(integrand, index[active], corner_u[active], corner_v[active], size, n)
        change = np.abs(better - values[active])
        values[active] = better
        active = active[~(change <= tolerance[active])]
    if active.size == 0:
        return values
    if depth == _DEPTH or not np.all(np.isfinite(values[active])):
        warnings.warn(
            f"the integral over {np.unique(index[active]).size} pixels has not converged: "
            "the model is not smooth there",
            IntegrationWarning,
            stacklevel=5,
        )
        return values
    first = max(8, _MOST_NODES // 4)
    values[active] = 0
    for du in (-0.25, 0.25):
        for dv in (-0.25, 0.25):
            u, v = corner_u[active] + du * size, corner_v[active] + dv * size
            quarter = _rule(integrand, index[active], u, v, size / 2, first)
            values[active] += _refined(
                integrand,
                index[active],
                u,
                v,
                size / 2,
                first,
                quarter,
                tolerance[active] / 2,
                depth + 1,
            )
    return values
