"""Integrals over pixels along one axis: normal densities, Hermite functions and polynomials.

The functions are ``h_k(z) = He_k(z) phi(z) / sqrt(k!)`` with the probabilists' Hermite polynomials,
of which ``dh_k/dz = -sqrt(k + 1) h_{k+1}``; used in `scope_models.models._gaussian`.
"""

from functools import cache, lru_cache

import numpy as np
from scipy.special import erf

from scope_models._values import frozen

__all__ = [
    "FEW", "ROWS", "AxisPanels", "axis_direct", "axis_table", "gauss_legendre", "gaussian_nodes",
    "hermite_functions",
]  # fmt: skip

# Largest growth of rounding errors, in units of epsilon, that the closed form may have.
_MAX_GROWTH = 1e5
# Chebyshev coefficients, as part of the total flux, below which an interpolation is cut.
_CHEBYSHEV_TOLERANCE = 1e-14
# So few positions are never interpolated: each is then independent of the others to the last bit.
FEW = 100
# Rows per matrix product of a panel: with equal shapes, products are equal to the last bit.
ROWS = 16
# Width of a panel in pixels: most motions stay in the panel about the star's place.
_SPAN = 1.5
# Width of a panel in the logarithm of the density's width.
_STEP = 0.125
# Nodes beyond which a panel takes longer than its positions: of densities below 0.006 pixels.
_MOST_NODES = 1000


@cache
def gauss_legendre(n):
    """Nodes in (-1/2, 1/2) and weights of sum 1 of the Gauss-Legendre rule of n nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return frozen(nodes / 2), frozen(weights / 2)


def gaussian_nodes(scale, degree):
    """Nodes per pixel that integrate a Gaussian of this sigma times a polynomial to about 1e-13."""
    return int(np.ceil(5 + 2.1 / scale)) + (degree + 1) // 2


def hermite_functions(z, n):
    """``h_0 .. h_{n-1}`` at z, stacked on a new first axis."""
    table = np.empty((n, *z.shape))
    table[0] = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    if n > 1:
        np.multiply(z, table[0], out=table[1])
    for k in range(1, n - 1):
        np.multiply(z, table[k], out=table[k + 1])
        table[k + 1] -= np.sqrt(k) * table[k - 1]
        table[k + 1] *= 1 / np.sqrt(k + 1)
    return table


def _axis_closed_form(pixels, center, sigma, coefficients, n_orders):
    """Closed form of `axis_direct`, by Horner's rule for the polynomial in u.

    With ``mu = center - pixel``, ``u h_k = mu h_k + sigma (sqrt(k+1) h_{k+1} + sqrt(k) h_{k-1})``.
    """
    mu = center - pixels[:, np.newaxis]
    z = np.stack([-0.5 - mu, 0.5 - mu]) / sigma
    n = n_orders + coefficients.size - 1
    root = np.sqrt(np.arange(1.0, n))[:, np.newaxis, np.newaxis]
    plain = np.empty((n, *mu.shape))  # integrals of the functions alone
    low, high = erf(z * np.sqrt(0.5))
    plain[0] = (high - low) / 2
    if n > 1:
        table = hermite_functions(z, n - 1)
        plain[1:] = (table[:, 0] - table[:, 1]) / root
    step = sigma * root
    integrals = coefficients[-1] * plain
    for coefficient in coefficients[-2::-1]:
        below = integrals[:-1]
        times_u = mu * below
        times_u += step[: len(below)] * integrals[1:]
        times_u[1:] += step[: len(below) - 1] * below[:-1]
        integrals = times_u + coefficient * plain[: len(below)]
    return integrals


def _axis_quadrature(pixels, center, sigma, coefficients, n_orders):
    """Gauss-Legendre form of `axis_direct`, for wide densities and high degrees."""
    # The oscillation of h_k near its center shortens the scale.
    scale = np.min(sigma) / np.sqrt(1 + 0.3 * n_orders)
    nodes, weights = gauss_legendre(gaussian_nodes(scale, coefficients.size - 1))
    weights = weights * np.polynomial.polynomial.polyval(nodes, coefficients)
    z = ((pixels[:, np.newaxis] + nodes)[..., np.newaxis] - center) / sigma
    return np.einsum("kpqm,q->kpm", hermite_functions(z, n_orders), weights) / sigma


def axis_direct(pixels, center, sigma, coefficients, n_orders):
    """The integrals at each position, shape ``(m, n_orders, n)``."""
    grows = (6 * np.max(sigma)) ** (coefficients.size - 1) > _MAX_GROWTH
    method = _axis_quadrature if grows else _axis_closed_form
    return method(pixels, center, sigma, coefficients, n_orders).transpose(2, 0, 1)


@cache
def _chebyshev_rule(n):
    """Chebyshev nodes of the first kind, and the matrix from values there to coefficients."""
    angle = np.pi * (np.arange(n) + 0.5) / n
    matrix = np.cos(np.arange(n)[:, np.newaxis] * angle) * (2 / n)
    matrix[0] /= 2
    return np.cos(angle), matrix


def _chebyshev_vandermonde(x, n):
    """``T_0 .. T_{n-1}`` at x, shape ``(n, m)``, by ``T_{k+j} = 2 T_k T_j - T_{k-j}``."""
    table = np.empty((max(n, 2), x.size))
    table[0] = 1
    table[1] = x
    k = 1
    while k + 1 < n:
        stop = min(2 * k, n - 1)
        part = table[k + 1 : stop + 1]
        np.multiply(table[1 : stop - k + 1], 2 * table[k], out=part)
        part -= table[k - 1 :: -1][: stop - k]
        k = stop
    return table[:n]


# The panels of the arguments: stars of the same PSF share them.
_known_panels = lru_cache(maxsize=32)(lambda *_: {})


class AxisPanels:
    """Integrals along one axis of a polynomial times the functions ``h_k``, by position and width.

    ``X_k = integral of p(u) h_k((x - center) / sigma) / sigma`` over pixels of given centers, where
    u is measured from the pixel's center, and p has the coefficients, the constant first. Order k
    needs to be exact to ``1 / |rho|^(k/2)`` only, with the largest correlation coefficient rho.

    They are interpolated within panels of a ``span`` in position, of which one has the ``middle``,
    pixels, and an eighth in the logarithm of the width: in given panels the integrals at a position
    are the same, to the last bit, independent of the other positions. Axes of equal arguments share
    their `panels`.
    """

    def __init__(self, pixels, sigma, coefficients, n_orders, rho=0.0, middle=0.0, span=_SPAN):
        self._arguments = pixels, coefficients, n_orders
        self._sigma, self._middle, self._span = sigma, middle, span
        self._needed = np.abs(rho) ** (0.5 * np.arange(n_orders)) / _CHEBYSHEV_TOLERANCE
        arrays = pixels.tobytes(), coefficients.tobytes()
        self.panels = _known_panels(*arrays, sigma, n_orders, rho, middle, span)

    def __call__(self, center, scale=None):
        """Integrals ``(m, n_orders, n)`` at positions and factors on the width ``(m,)``."""
        pixels, _, n_orders = self._arguments
        at = (center - self._middle) / self._span
        if scale is not None:
            at = at + 1j * (np.log(scale) / _STEP)
        keys = np.rint(at)
        at -= keys
        if (keys == keys[0]).all():
            return self._panel(keys[0], at).reshape(-1, n_orders, pixels.size)
        integrals = np.empty((center.size, n_orders * pixels.size))
        for key in np.unique(keys):
            chosen = keys == key
            integrals[chosen] = self._panel(key, at[chosen])
        return integrals.reshape(-1, n_orders, pixels.size)

    def _panel(self, key, at):
        """Integrals in a panel, ``(m, n_orders * n)``: places in spans, widths imaginary."""
        known = key, at.dtype.kind  # a panel at one width is another one
        if known not in self.panels:
            self.panels[known] = self._expand(key)
        expansion, sizes = self.panels[known]
        if expansion is None:
            return self._direct(key + at)
        rows = -(-at.size // ROWS) * ROWS
        padded = np.zeros(rows, at.dtype)
        np.multiply(at, 2, out=padded[: at.size])
        basis = _chebyshev_vandermonde(padded.real, sizes[0])
        if at.dtype.kind == "c":
            wide = _chebyshev_vandermonde(padded.imag, sizes[1])[: sizes[1], np.newaxis]
            basis = (wide * basis[: sizes[0]]).reshape(-1, rows)
        blocks = basis[: len(expansion)].reshape(-1, rows // ROWS, ROWS).transpose(1, 2, 0)
        return (blocks @ expansion).reshape(rows, -1)[: at.size]

    def _direct(self, at):
        """Integrals at places ``(m,)``, from the middle of all panels, ``(m, n_orders * n)``."""
        pixels, coefficients, n_orders = self._arguments
        center, sigma = self._middle + self._span * at.real, self._sigma * np.exp(_STEP * at.imag)
        return axis_direct(pixels, center, sigma, coefficients, n_orders).reshape(at.size, -1)

    def _expand(self, key):
        """Chebyshev coefficients of a panel in position and width, or None, and their numbers."""
        n_orders, m = self._needed.size, 1
        scale = self._span / (self._sigma * np.exp(_STEP * key.imag))
        if key.dtype.kind == "c":
            m, scale = 13 + n_orders // 2, scale * np.exp(_STEP / 2)
        cycles = 3.85 * scale
        n = cycles + 5 * np.cbrt(cycles) + 8 + 0.5 * n_orders
        if n > _MOST_NODES:
            return None, None
        n = int(n)
        nodes, along = _chebyshev_rule(n)
        widths, across = _chebyshev_rule(m)
        at = key + (np.tile(nodes, m) + 1j * np.repeat(widths, n)) / 2
        expansion = np.tensordot(across, along @ self._direct(at).reshape(m, n, -1), axes=1)
        # The last coefficients in either direction are those that a longer series would add to.
        sizes = np.abs(expansion).reshape(m, n, n_orders, -1).max(axis=3) @ self._needed
        # Numbers of coefficients up to the last that matters, one at least.
        keep = [max(np.flatnonzero(sizes.max(axis=i) > 1), default=0) + 1 for i in (0, 1)]
        if keep[0] > n - 2 or (m > 1 and keep[1] > m - 2):
            return None, None
        expansion = expansion[: keep[1], : keep[0]]
        return expansion.reshape(keep[0] * keep[1], -1), keep


def axis_table(pixels, center, sigma, coefficients, n_orders=1, rho=0.0):
    """Return the function of a slice of positions that gives integrals ``(m, n_orders, n)``."""
    low, high = center.min(), center.max()
    if sigma.size == 1 and center.size > FEW * (1 + high - low):
        place = (low + high) / 2, 1.001 * (high - low) + 1e-6
        panels = AxisPanels(pixels, sigma[0], coefficients, n_orders, rho, *place)
        return lambda part: panels(center[part])

    def table(part):
        width = sigma if sigma.size == 1 else sigma[part]
        return axis_direct(pixels, center[part], width, coefficients, n_orders)

    return table
