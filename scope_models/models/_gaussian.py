# Licensed under a 3-clause BSD style license - see LICENSE
r"""
Exact integrals over pixels of a bivariate normal density times a polynomial.

Everything here is a pure function of arrays: no models, no units. A pixel is the unit square
around an integer (or any other) centre, and the polynomial is in ``(u, v)``, the offset from
that centre, so that each pixel sees the same polynomial.

The bivariate normal density is a sum of separable terms (Mehler's expansion, Abramowitz and
Stegun 22.9.3 with 26.2.31)

.. math:: f = \frac{1}{\sigma_x \sigma_y} \sum_k \rho^k h_k(z_x) h_k(z_y), \qquad
          h_k(z) = \frac{He_k(z)}{\sqrt{k!}} \varphi(z),

where He_k are the probabilists' Hermite polynomials and ``z = (x - x_0) / sigma``. Each term
integrates in closed form along each axis. With rho = 0 the first term is all. Because
``dh_k/dz = -sqrt(k + 1) h_{k+1}``, derivatives with respect to position and width are integrals
of the same family. Where ``|rho|`` is so large that the series is long, a tensor Gauss-Legendre
rule whose node count follows from the width of the density takes its place.

The integrals along an axis are entire functions of the position. For many positions of one
density they are evaluated at Chebyshev nodes and interpolated, with as many nodes as bring the
last coefficients below the rounding error.
"""

from functools import cache

import numpy as np
from scipy.special import erf

__all__ = ["axis_integrals", "gauss_legendre", "gaussian_derivatives", "gaussian_pixels"]

# The series and the node counts are cut where the rest is below this part of the total flux.
_TOLERANCE = 1e-11
# Last Chebyshev coefficients, as part of the total flux, at which an interpolation is accepted.
_CHEBYSHEV_TOLERANCE = 1e-14
# Beyond this many standard deviations a Gaussian holds less than 1e-16 of its flux.
_REACH = 8.5
# Largest growth of rounding errors, in units of epsilon, that the closed form may have.
_MAX_GROWTH = 1e5
# Elements of the largest temporary array: small enough to stay in the processor's cache.
_CHUNK = 1 << 16
# Positions that are interpolated together: fresh large arrays cost more than what is in them.
_SHORT = 1024


@cache
def gauss_legendre(n):
    """
    Nodes and weights of the Gauss-Legendre rule on a pixel.

    Parameters
    ----------
    n : int
        Number of nodes.

    Returns
    -------
    nodes, weights : `~numpy.ndarray`
        Nodes in (-1/2, 1/2) and weights that sum to 1, both of shape ``(n,)``, read-only.
    """
    nodes, weights = np.polynomial.legendre.leggauss(n)
    nodes, weights = nodes / 2, weights / 2
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def gaussian_nodes(scale, degree):
    """
    Node count per pixel and axis that integrates a Gaussian to about 1e-13 of its flux.

    Parameters
    ----------
    scale : float
        Smallest width of the density (standard deviation), in pixels.
    degree : int
        Degree of the polynomial that multiplies it.

    Returns
    -------
    n : int
        Number of Gauss-Legendre nodes.
    """
    return int(np.ceil(5 + 2.1 / scale)) + (degree + 1) // 2


# ---------------------------------------------------------------------------------------------
# One axis
# ---------------------------------------------------------------------------------------------
def _hermite_functions(z, n):
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


def _derivatives_of(coefficients):
    """Coefficients of a polynomial and of all its derivatives, the constant last."""
    rows = [coefficients.tolist()]
    while len(rows[-1]) > 1:
        rows.append([n * c for n, c in enumerate(rows[-1])][1:])
    return rows


def _horner(coefficients, x):
    """Value of a polynomial; for a few numbers this is faster than array code."""
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * x + coefficient
    return value


def _monomial_integrals(cumulative, low, high, mu, sigma, degree):
    """
    ``M_n``, the integral of u^n times the normal density, for n up to degree.

    Integration by parts gives ``M_n = mu M_{n-1} + (n-1) sigma^2 M_{n-2} - sigma [u^{n-1} h_0]``.
    """
    moments = [cumulative]
    for n in range(1, degree + 1):
        boundary = high - low if n % 2 else high + low
        moment = mu * moments[n - 1] - (0.5 ** (n - 1) * sigma) * boundary
        if n > 1:
            moment += ((n - 1) * sigma**2) * moments[n - 2]
        moments.append(moment)
    return moments


def _axis_closed_form(pixels, center, sigma, coefficients, n_orders):
    """
    Closed form of `axis_integrals`, by parts from the pixel's edges.

    ``sqrt(k) X_k[p] = -[p h_{k-1}] + sigma X_{k-1}[p']``, repeated until p or k is used up.
    """
    offset = pixels[:, np.newaxis] - center
    z = np.stack([offset - 0.5, offset + 0.5]) / sigma
    table = _hermite_functions(z, max(n_orders - 1, 1))
    cumulative = erf(z * np.sqrt(0.5))
    rows = _derivatives_of(coefficients)
    moments = _monomial_integrals(
        (cumulative[1] - cumulative[0]) / 2, *table[0], -offset, sigma, len(rows) - 1
    )
    integrals = np.zeros((n_orders, *offset.shape))
    factor = np.ones((n_orders, 1, sigma.size))
    for j, row in enumerate(rows[:n_orders]):
        # Orders above j still have boundary terms, order j is an integral over h_0.
        for n, coefficient in enumerate(row):
            if coefficient:
                integrals[j] += factor[j] * coefficient * moments[n]
        k = np.arange(j + 1, n_orders)[:, np.newaxis, np.newaxis]
        factor[j + 1 :] /= np.sqrt(k - j)
        if j == n_orders - 1:
            break
        low, high = _horner(row, -0.5), _horner(row, 0.5)
        part = table[: n_orders - 1 - j]
        integrals[j + 1 :] -= factor[j + 1 :] * (high * part[:, 1] - low * part[:, 0])
        factor[j + 1 :] *= sigma
    return integrals


def _axis_quadrature(pixels, center, sigma, coefficients, n_orders):
    """Gauss-Legendre form of `axis_integrals`, for wide densities and high degrees."""
    # The oscillation of h_k near its centre shortens the scale.
    scale = np.min(sigma) / np.sqrt(1 + 0.3 * n_orders)
    nodes, weights = gauss_legendre(gaussian_nodes(scale, coefficients.size - 1))
    weights = weights * np.polynomial.polynomial.polyval(nodes, coefficients)
    z = ((pixels[:, np.newaxis] + nodes)[..., np.newaxis] - center) / sigma
    return np.einsum("kpqm,q->kpm", _hermite_functions(z, n_orders), weights) / sigma


def _axis_direct(pixels, center, sigma, coefficients, n_orders):
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


def _axis_interpolated(pixels, center, sigma, coefficients, n_orders, weights):
    """`_axis_direct` by interpolation in the position, or None where that does not pay."""
    low, high = np.min(center), np.max(center)
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-6)
    cycles = 7.7 / sigma[0] * half
    n = int(cycles + 5 * np.cbrt(cycles) + 8 + 0.5 * n_orders)
    if 4 * n > center.size:
        return None
    nodes, matrix = _chebyshev_rule(n)
    values = _axis_direct(pixels, middle + half * nodes, sigma, coefficients, n_orders)
    expansion = matrix @ values.reshape(n, -1)
    tail = np.abs(expansion[-2:]).reshape(2, n_orders, -1) * weights[:, np.newaxis]
    if np.max(tail) > _CHEBYSHEV_TOLERANCE:
        return None
    scaled = (center - middle) / half
    table = np.empty((center.size, expansion.shape[1]))
    for start in range(0, center.size, _SHORT):
        part = slice(start, start + _SHORT)
        np.matmul(_chebyshev_vandermonde(scaled[part], n).T, expansion, out=table[part])
    return table.reshape(-1, n_orders, pixels.size)


def axis_integrals(pixels, center, sigma, coefficients, n_orders=1, rho=0.0):
    """
    Integrals along one axis of a polynomial times the functions ``h_k``.

    ``X_k = integral of p(u) h_k((x - center) / sigma) / sigma`` over each pixel, where u is
    measured from the pixel's centre.

    Parameters
    ----------
    pixels : `~numpy.ndarray`
        Pixel centres, shape ``(n,)``.
    center, sigma : `~numpy.ndarray`
        Positions and widths of the densities in pixels, shape ``(m,)``; sigma may be ``(1,)``.
    coefficients : `~numpy.ndarray`
        Coefficients of p, the constant first.
    n_orders : int
        Number of orders k, from 0.
    rho : float
        Largest correlation coefficient: order k needs to be exact to ``1 / |rho|^(k/2)`` only.

    Returns
    -------
    integrals : `~numpy.ndarray`
        Shape ``(m, n_orders, n)``.
    """
    if sigma.size == 1 and center.size > 100:
        weights = np.abs(rho) ** (0.5 * np.arange(n_orders))
        table = _axis_interpolated(pixels, center, sigma, coefficients, n_orders, weights)
        if table is not None:
            return table
    return _axis_direct(pixels, center, sigma, coefficients, n_orders)


# ---------------------------------------------------------------------------------------------
# Two axes
# ---------------------------------------------------------------------------------------------
def _n_terms(rho):
    """Number of terms of Mehler's expansion for the tolerance."""
    largest = np.max(np.abs(rho))
    if largest == 0:
        return 1
    return int(np.ceil(np.log(_TOLERANCE) / np.log(largest))) + 1


def _narrowest(sigma_x, sigma_y, rho):
    """Smallest conditional width of the densities."""
    smallest = min(np.min(sigma_x), np.min(sigma_y))
    return smallest * np.sqrt(1 - np.max(np.abs(rho)) ** 2)


def _uses_series(sigma_x, sigma_y, rho, degree):
    """Whether the series is cheaper than the tensor quadrature (costs as measured)."""
    return _n_terms(rho) <= gaussian_nodes(_narrowest(sigma_x, sigma_y, rho), degree) ** 2


def _contract(y_table, x_table, rho, out):
    """``sum_k rho^k Y_k X_k`` as images: ``(m, k, ny)``, ``(m, k, nx)`` -> ``(m, ny, nx)``."""
    n_terms = x_table.shape[1]
    if n_terms == 1:
        np.einsum("my,mx->myx", y_table[:, 0], x_table[:, 0], out=out)
    else:
        weighted = y_table * (rho[:, np.newaxis] ** np.arange(n_terms))[..., np.newaxis]
        np.matmul(weighted.transpose(0, 2, 1), x_table, out=out)


def _series_image(x, y, parameters, x_coefficients, y_coefficients, out):
    x_0, y_0, sigma_x, sigma_y, rho = parameters
    options = {"n_orders": _n_terms(rho), "rho": np.max(np.abs(rho))}
    y_table = axis_integrals(y, y_0, sigma_y, y_coefficients, **options)
    x_table = axis_integrals(x, x_0, sigma_x, x_coefficients, **options)
    _contract(y_table, x_table, rho, out[0])


def _moved(table, sigma):
    """Derivative of all orders but the last two with respect to the position."""
    order = np.arange(1.0, table.shape[1] - 1)[:, np.newaxis]
    return np.sqrt(order) * table[:, 1:-1] / sigma[:, np.newaxis, np.newaxis]


def _widened(table, sigma):
    """Derivative of all orders but the last two with respect to the width."""
    order = np.arange(table.shape[1] - 2.0)[:, np.newaxis]
    change = order * table[:, :-2] + np.sqrt((order + 1) * (order + 2)) * table[:, 2:]
    return change / sigma[:, np.newaxis, np.newaxis]


def _series_derivatives(x, y, parameters, x_coefficients, y_coefficients, out):
    x_0, y_0, sigma_x, sigma_y, rho = parameters
    n = _n_terms(rho)
    options = {"n_orders": n + 2, "rho": np.max(np.abs(rho))}
    y_table = axis_integrals(y, y_0, sigma_y, y_coefficients, **options)
    x_table = axis_integrals(x, x_0, sigma_x, x_coefficients, **options)
    base_x, base_y = x_table[:, :n], y_table[:, :n]
    order = np.arange(1.0, n + 1)[:, np.newaxis]
    pairs = [
        (base_y, base_x),
        (base_y, _moved(x_table, sigma_x)),
        (_moved(y_table, sigma_y), base_x),
        (base_y, _widened(x_table, sigma_x)),
        (_widened(y_table, sigma_y), base_x),
        (order * y_table[:, 1:-1], x_table[:, 1:-1]),
    ]
    for pair, image in zip(pairs, out, strict=True):
        _contract(*pair, rho, image)


class _TensorRule:
    """The density at the nodes of a tensor Gauss-Legendre rule, and its weighted sums."""

    def __init__(self, x, y, parameters, degree):
        x_0, y_0, sigma_x, sigma_y, rho = (p[:, np.newaxis, np.newaxis] for p in parameters)
        n = gaussian_nodes(_narrowest(sigma_x, sigma_y, rho), degree)
        self.nodes, self.weights = gauss_legendre(n)
        self.z_x = (x[:, np.newaxis] + self.nodes - x_0) / sigma_x
        self.z_y = (y[:, np.newaxis] + self.nodes - y_0) / sigma_y
        z_x = self.z_x.reshape(len(self.z_x), 1, -1)
        z_y = self.z_y.reshape(len(self.z_y), -1, 1)
        density = z_x - rho * z_y
        density *= density
        density *= -0.5 / (1 - rho**2)
        density -= 0.5 * z_y**2
        np.exp(density, out=density)
        density *= 1 / (2 * np.pi * sigma_x * sigma_y * np.sqrt(1 - rho**2))
        self.density = density.reshape(-1, y.size, n, x.size, n)

    def along(self, coefficients):
        """Weights times the polynomial, per node."""
        return self.weights * np.polynomial.polynomial.polyval(self.nodes, coefficients)

    def integrate(self, x_weights, y_weights, x_power=0, y_power=0):
        """Integral of the density times weights times ``z_x^x_power z_y^y_power``."""
        right = x_weights * self.z_x**x_power
        left = y_weights * self.z_y**y_power
        # First over the x nodes, then over the y nodes: (m, ny, K, nx, K) -> (m, ny, nx).
        rows = np.einsum("mykxq,mxq->mykx", self.density, right)
        return np.einsum("mykx,myk->myx", rows, left)


def _tensor_image(x, y, parameters, x_coefficients, y_coefficients, out):
    degree = max(x_coefficients.size, y_coefficients.size) - 1
    rule = _TensorRule(x, y, parameters, degree)
    out[0] = rule.integrate(rule.along(x_coefficients), rule.along(y_coefficients))


def _tensor_derivatives(x, y, parameters, x_coefficients, y_coefficients, out):
    _, _, sigma_x, sigma_y, rho = (p[:, np.newaxis, np.newaxis] for p in parameters)
    degree = max(x_coefficients.size, y_coefficients.size) + 1
    rule = _TensorRule(x, y, parameters, degree)
    along_x, along_y = rule.along(x_coefficients), rule.along(y_coefficients)
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    z = {power: rule.integrate(along_x, along_y, *power) for power in powers}
    rest = 1 - rho**2
    distance = (z[2, 0] - 2 * rho * z[1, 1] + z[0, 2]) / rest
    images = [
        z[0, 0],
        (z[1, 0] - rho * z[0, 1]) / (rest * sigma_x),
        (z[0, 1] - rho * z[1, 0]) / (rest * sigma_y),
        ((z[2, 0] - rho * z[1, 1]) / rest - z[0, 0]) / sigma_x,
        ((z[0, 2] - rho * z[1, 1]) / rest - z[0, 0]) / sigma_y,
        (rho * z[0, 0] + z[1, 1] - rho * distance) / rest,
    ]
    out[...] = images


def _reached(pixels, center, sigma):
    """Slice of the pixels that any of the densities reaches."""
    if np.any(np.diff(pixels) <= 0):
        return slice(0, pixels.size)
    reach = _REACH * np.max(sigma) + 0.5
    start, stop = np.searchsorted(pixels, [np.min(center) - reach, np.max(center) + reach])
    return slice(int(start), int(stop))


def _step(x, y, parameters, degree, series):
    """Number of densities whose temporary arrays fit into the cache together."""
    _, _, sigma_x, sigma_y, rho = parameters
    if series:
        # The interpolation pays for itself over many positions: larger steps for it.
        elements = (x.size + y.size) * _n_terms(rho) / 32
    else:
        elements = x.size * y.size * gaussian_nodes(_narrowest(sigma_x, sigma_y, rho), degree) ** 2
    return max(1, int(_CHUNK / max(elements, 1)))


def _in_chunks(x, y, parameters, coefficients, engines, n_images):
    """Apply the cheaper engine to slices of the densities."""
    shape = np.broadcast_shapes(*(np.shape(p) for p in parameters))
    flat = [np.broadcast_to(p, shape).reshape(-1).astype(float) for p in parameters]
    coefficients = [np.atleast_1d(np.asarray(c, dtype=float)) for c in coefficients]
    degree = max(c.size for c in coefficients) - 1
    series = _uses_series(*flat[2:], degree)
    engine = engines[0] if series else engines[1]
    step = _step(x, y, flat, degree, series)
    # A shape common to all densities stays a single number, which is faster.
    common = [i > 1 and np.size(p) == 1 for i, p in enumerate(parameters)]
    images = np.zeros((n_images, flat[0].size, y.size, x.size))
    for start in range(0, flat[0].size, step):
        part = slice(start, start + step)
        values = [p[:1] if alone else p[part] for p, alone in zip(flat, common, strict=True)]
        columns = _reached(x, values[0], values[2])
        rows = _reached(y, values[1], values[3])
        if columns.start < columns.stop and rows.start < rows.stop:
            out = images[:, part, rows, columns]
            engine(x[columns], y[rows], values, *coefficients, out)
    return images.reshape(n_images, *shape, y.size, x.size)


def gaussian_pixels(
    x, y, x_0, y_0, sigma_x, sigma_y, rho, x_coefficients=(1,), y_coefficients=(1,)
):
    """
    Integrate bivariate normal densities times a polynomial over a grid of pixels.

    Parameters
    ----------
    x, y : `~numpy.ndarray`
        Centres of the pixel columns, shape ``(nx,)``, and rows, shape ``(ny,)``.
    x_0, y_0, sigma_x, sigma_y, rho : float or `~numpy.ndarray`
        Parameters of the densities, of unit integral; they broadcast to a shape ``(...)``.
    x_coefficients, y_coefficients : array_like
        Coefficients of the polynomials in u and v, the constants first.

    Returns
    -------
    images : `~numpy.ndarray`
        Integrals, shape ``(..., ny, nx)``.
    """
    parameters = (x_0, y_0, sigma_x, sigma_y, rho)
    coefficients = (x_coefficients, y_coefficients)
    return _in_chunks(x, y, parameters, coefficients, (_series_image, _tensor_image), 1)[0]


def gaussian_derivatives(
    x, y, x_0, y_0, sigma_x, sigma_y, rho, x_coefficients=(1,), y_coefficients=(1,)
):
    """
    Integrals of `gaussian_pixels` and their derivatives with respect to the five parameters.

    The integrals are linear in the coefficients, whose derivatives are integrals of monomials.

    Parameters
    ----------
    x, y : `~numpy.ndarray`
        Centres of the pixel columns, shape ``(nx,)``, and rows, shape ``(ny,)``.
    x_0, y_0, sigma_x, sigma_y, rho : float or `~numpy.ndarray`
        Parameters of the densities, of unit integral; they broadcast to a shape ``(...)``.
    x_coefficients, y_coefficients : array_like
        Coefficients of the polynomials in u and v, the constants first.

    Returns
    -------
    images : `~numpy.ndarray`
        Shape ``(6, ..., ny, nx)``: the integrals, then their derivatives with respect to x_0,
        y_0, sigma_x, sigma_y and rho.
    """
    parameters = (x_0, y_0, sigma_x, sigma_y, rho)
    coefficients = (x_coefficients, y_coefficients)
    engines = (_series_derivatives, _tensor_derivatives)
    return _in_chunks(x, y, parameters, coefficients, engines, 6)
