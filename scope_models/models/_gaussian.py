r"""Exact integrals over pixels of a bivariate normal density times a polynomial.

A pixel is the unit square around any center, and the polynomial is in ``(u, v)``, the offset from
that center, so that each pixel sees the same polynomial.

The bivariate normal density is a sum of separable terms (Mehler's expansion, Abramowitz and
Stegun 22.9.3 with 26.2.31)

.. math:: f = \frac{1}{\sigma_x \sigma_y} \sum_k \rho^k h_k(z_x) h_k(z_y),

where ``z = (x - x_0) / sigma`` and ``h_k(z) = He_k(z) phi(z) / sqrt(k!)`` with the probabilists'
Hermite polynomials, of which ``dh_k/dz = -sqrt(k + 1) h_{k+1}``. Each term integrates in closed
form along each axis. Derivatives by position and width are integrals of the same family. Where
``|rho|`` is so large that the series is long, a Gauss-Legendre rule along x of closed forms along y
takes its place.
"""

from functools import cache, lru_cache, partial

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.special import erf

from scope_models._values import frozen

__all__ = [
    "FEW", "REACH", "ROWS", "AxisPanels", "contract", "flattened", "gauss_legendre",
    "gaussian_pixels", "hermite_functions", "n_terms", "separable_images", "series_step",
    "slope_pairs", "uses_series",
]  # fmt: skip

# Rest, as part of the flux, below which the series of terms is cut.
_TOLERANCE = 1e-11
# Beyond this many standard deviations a Gaussian holds less than 1e-16 of its flux.
REACH = 8.5
# Largest growth of rounding errors, in units of epsilon, of the closed form.
_MAX_GROWTH = 1e5
# Chebyshev coefficients, as part of the flux, below which a series is cut.
_CHEBYSHEV_TOLERANCE = 1e-14
# So few positions are never interpolated: each is independent of the others to the last bit.
FEW = 100
# Rows per matrix product of a panel: with equal shapes, products are equal to the last bit.
ROWS = 16
# Width of a panel in pixels, in which most motions stay.
_SPAN = 1.5
# Width of a panel in the logarithm of the density's width.
_STEP = 0.125
# Nodes beyond which a panel takes longer than its positions.
_MOST_NODES = 1000
# Elements of temporary arrays: few enough for them to stay in the processor's cache.
_LINE_CHUNK = 1 << 16
_SERIES_CHUNK = 1 << 15
# Fewest and most densities in a step: overhead and fresh large arrays take time.
_FEWEST, _MOST = 32, 1024
# Scale of a density, in the size of a panel, down to which the line rule has one panel.
_PANEL = 0.1
# Terms of the series that cost as much as a node of the line rule.
_NODE_COST = 12


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
    """Closed form of `_axis_direct`, by Horner's rule for the polynomial in u.

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


def _axis_direct(pixels, center, sigma, coefficients, n_orders):
    """The integrals of `AxisPanels` at each position, shape ``(m, n_orders, n)``.

    Wide densities and high degrees have a Gauss-Legendre rule in place of the closed form.
    """
    if (6 * np.max(sigma)) ** (coefficients.size - 1) <= _MAX_GROWTH:
        integrals = _axis_closed_form(pixels, center, sigma, coefficients, n_orders)
    else:
        # The oscillation of h_k near its center shortens the scale.
        scale = np.min(sigma) / np.sqrt(1 + 0.3 * n_orders)
        nodes, weights = gauss_legendre(gaussian_nodes(scale, coefficients.size - 1))
        z = ((pixels[:, np.newaxis] + nodes)[..., np.newaxis] - center) / sigma
        weights = weights * polyval(nodes, coefficients)
        integrals = np.einsum("kpqm,q->kpm", hermite_functions(z, n_orders), weights) / sigma
    return integrals.transpose(2, 0, 1)


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

    ``X_k = integral of p(u) h_k((x - center) / sigma) / sigma`` over pixels of given centers. Order
    k needs to be exact to ``1 / |rho|^(k/2)`` only, with the largest correlation coefficient rho.

    They are interpolated within panels of a ``span`` in position, of which one has the ``middle``,
    pixels, and of a step in the width: the integrals at a position are the same, to the last bit,
    independent of the others.
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
            wide = _chebyshev_vandermonde(padded.imag, sizes[1])[:, np.newaxis]
            basis = (wide * basis).reshape(-1, rows)
        blocks = basis.reshape(-1, rows // ROWS, ROWS).transpose(1, 2, 0)
        return (blocks @ expansion).reshape(rows, -1)[: at.size]

    def _direct(self, at):
        """Integrals at places ``(m,)``, from the middle of all panels, ``(m, n_orders * n)``."""
        pixels, coefficients, n_orders = self._arguments
        center, sigma = self._middle + self._span * at.real, self._sigma * np.exp(_STEP * at.imag)
        return _axis_direct(pixels, center, sigma, coefficients, n_orders).reshape(at.size, -1)

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
        sizes = np.abs(expansion).reshape(m, n, n_orders, -1).max(axis=3) @ self._needed
        # Numbers of coefficients up to the last that matters, one at least.
        keep = [max(np.flatnonzero(sizes.max(axis=i) > 1), default=0) + 1 for i in (0, 1)]
        # A longer series would add to the last ones.
        if keep[0] > n - 2 or (m > 1 and keep[1] > m - 2):
            return None, None
        expansion = expansion[: keep[1], : keep[0]]
        return expansion.reshape(keep[0] * keep[1], -1), keep


def axis_table(pixels, center, sigma, coefficients, n_orders=1, rho=0.0):
    """Return the function of a slice of positions that gives the integrals."""
    low, high = center.min(), center.max()
    if sigma.size == 1 and center.size > FEW * (1 + high - low):
        place = (low + high) / 2, 1.001 * (high - low) + 1e-6
        panels = AxisPanels(pixels, sigma[0], coefficients, n_orders, rho, *place)
        return lambda part: panels(center[part])

    def table(part):
        width = sigma if sigma.size == 1 else sigma[part]
        return _axis_direct(pixels, center[part], width, coefficients, n_orders)

    return table


def n_terms(rho):
    """Number of terms of Mehler's expansion."""
    largest = np.max(np.abs(rho))
    return 1 if largest == 0 else int(np.ceil(np.log(_TOLERANCE) / np.log(largest))) + 1


def uses_series(sigma_x, rho, degree):
    """Whether the series is cheaper than the line rule (costs as measured)."""
    n = n_terms(rho)
    return n == 1 or n <= _NODE_COST * _line_nodes(sigma_x, rho, degree)[0].size


def _line_nodes(sigma_x, rho, degree):
    """Nodes within a pixel, and their weights."""
    scale = np.min(sigma_x) * np.sqrt(1 - np.max(np.abs(rho)) ** 2)
    n_panels = int(np.ceil(_PANEL / scale))
    nodes, weights = gauss_legendre(gaussian_nodes(scale * n_panels, degree))
    panels = (np.arange(n_panels) + 0.5) / n_panels - 0.5
    nodes = (panels[:, np.newaxis] + nodes / n_panels).ravel()
    return nodes, np.tile(weights / n_panels, n_panels)


def contract(y_table, x_table, out):
    """``sum_k Y_k X_k`` as images: ``(m, k, ny)``, ``(m, k, nx)`` -> ``(m, ny, nx)``."""
    if x_table.shape[1] == 1:
        np.einsum("my,mx->myx", y_table[:, 0], x_table[:, 0], out=out)
    else:
        np.matmul(y_table.transpose(0, 2, 1), x_table, out=out)


def series_step(n_terms, x, y):
    """Number of densities whose tables fit into the cache together."""
    return min(max(_SERIES_CHUNK // (n_terms * max(x.size, y.size)), _FEWEST), _MOST)


def slope_pairs(x_table, y_table, sigma_x, sigma_y, weigh):
    """Tables along y and x whose products are an image, and its slopes by position and widths.

    ``weigh`` multiplies a table along y by the coefficients. Tables hold two orders more.
    """
    order = np.arange(x_table.shape[-2] - 2.0)[:, np.newaxis]

    def changes(table, sigma):
        """Return all orders but two, and their slopes by position and width."""
        base, up, two_up = table[..., :-2, :], table[..., 1:-1, :], table[..., 2:, :]
        moved = np.sqrt(order + 1) * up / sigma
        widened = order * base + np.sqrt((order + 1) * (order + 2)) * two_up
        return base, moved, widened / sigma

    x, x_moved, x_widened = changes(x_table, sigma_x)
    y, y_moved, y_widened = map(weigh, changes(y_table, sigma_y))
    return [(y, x), (y, x_moved), (y_moved, x), (y, x_widened), (y_widened, x)]


def separable_images(x, y, parameters, coefficients, n_orders, weigh, further, out, rho=0.0):
    """Fill in sums of products of integrals along both axes: one image, or with its slopes.

    ``weigh(part, table)`` multiplies tables along y by the coefficients of a slice of densities;
    slopes of ``further(part, x_table, y_table)`` follow those by positions and widths.
    """
    x_0, y_0, *widths = parameters
    n = n_orders if len(out) == 1 else n_orders + 2
    x_axis = axis_table(x, x_0, widths[0], coefficients[0], n, rho)
    y_axis = axis_table(y, y_0, widths[1], coefficients[1], n, rho)
    step = series_step(n_orders, x, y)
    for start in range(0, out.shape[1], step):
        part = slice(start, start + step)
        x_table, y_table = x_axis(part), y_axis(part)
        if len(out) == 1:
            contract(weigh(part, y_table), x_table, out[0, part])
            continue
        wide = (s if s.size == 1 else s[part, np.newaxis, np.newaxis] for s in widths)
        pairs = slope_pairs(x_table, y_table, *wide, partial(weigh, part))
        pairs += further(part, x_table, y_table)
        for pair, image in zip(pairs, out, strict=True):
            contract(*pair, image[part])


def _series_images(x, y, parameters, coefficients, out):
    """Add up the terms of Mehler's expansion: one image, or six."""
    *places_and_widths, rho = parameters
    orders = np.arange(n_terms(rho))[:, np.newaxis]
    powers = rho[:, np.newaxis, np.newaxis] ** orders

    def weigh(part, table):
        return (powers if len(powers) == 1 else powers[part]) * table

    def by_rho(part, x_table, y_table):
        return [((orders + 1) * weigh(part, y_table[:, 1:-1]), x_table[:, 1:-1])]

    separable_images(
        x, y, places_and_widths, coefficients, orders.size, weigh, by_rho, out, np.max(np.abs(rho))
    )


def _line_images(x, y, parameters, coefficients, out):
    """Apply a Gauss-Legendre rule along x to closed forms along y: one image, or six.

    There the density along y is normal, with the mean ``y_0 + rho sigma_y z_x`` and the width
    ``sigma_y sqrt(1 - rho^2)``.
    """
    x_0, y_0, sigma_x, sigma_y, rho = (p[:, np.newaxis] for p in parameters)
    nodes, weights = _line_nodes(sigma_x, rho, coefficients[0].size - 1)
    weights = weights * polyval(nodes, coefficients[0])
    z = ((x[:, np.newaxis] + nodes).ravel() - x_0) / sigma_x
    middle = y_0 + rho * sigma_y * z
    width = np.broadcast_to(sigma_y * np.sqrt(1 - rho**2), middle.shape)
    n_orders, shape = 1 if len(out) == 1 else 3, (-1, x.size, nodes.size)
    table = _axis_direct(y, middle.ravel(), width.ravel(), coefficients[1], n_orders)
    table = table.reshape(*shape, n_orders, y.size)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) / sigma_x
    density *= np.tile(weights, x.size)

    def rule(order, power):
        """Return sums of order X_k along y times ``z_x^power``, as images."""
        inner = (density * z**power).reshape(shape)
        return np.einsum("mxq,mxqy->myx", inner, table[..., order, :])

    image = out[0] = rule(0, 0)
    if len(out) == 1:
        return
    sigma_x, sigma_y, rho = (p[..., np.newaxis] for p in (sigma_x, sigma_y, rho))
    rest, slope = np.sqrt(1 - rho**2), rho * sigma_y
    # Derivatives by mean and width along y, times powers of z_x.
    by_mean = [rule(1, power) / (sigma_y * rest) for power in range(2)]
    by_width = np.sqrt(2) * rule(2, 0) / (sigma_y * rest)
    out[1:] = [
        (rule(0, 1) - slope * by_mean[0]) / sigma_x,
        by_mean[0],
        (rule(0, 2) - image - slope * by_mean[1]) / sigma_x,
        rho * by_mean[1] + rest * by_width,
        sigma_y * (by_mean[1] - rho / rest * by_width),
    ]


def _reached(pixels, center, sigma):
    """Slice of the pixels, in rising order, that any of the densities reaches."""
    reach = REACH * sigma.max() + 0.5
    return slice(*pixels.searchsorted([center.min() - reach, center.max() + reach]))


def flattened(parameters):
    """The common shape of parameters, and each as ``(n,)``; one number but a position stays one."""
    parameters = [np.asarray(p, dtype=float) for p in parameters]
    shape = np.broadcast_shapes(*(p.shape for p in parameters))
    places = [np.broadcast_to(p, shape) for p in parameters[:2]]
    others = [p if p.size == 1 else np.broadcast_to(p, shape) for p in parameters[2:]]
    return shape, [p.reshape(-1) for p in places + others]


def gaussian_pixels(
    x, y, x_0, y_0, sigma_x, sigma_y, rho, along_x=(1,), along_y=(1,), *, derivatives=False
):
    """Integrate normal densities ``(...)`` times a polynomial over pixels: ``(..., ny, nx)``.

    ``x`` and ``y`` are the centers of the pixel columns ``(nx,)`` and rows ``(ny,)``; ``along_x``
    and ``along_y`` the coefficients of the polynomials in u and v, the constants first. With
    ``derivatives`` those by x_0, y_0, sigma_x, sigma_y and rho follow: ``(6, ..., ny, nx)``.
    """
    shape, flat = flattened((x_0, y_0, sigma_x, sigma_y, rho))
    n = flat[0].size
    coefficients = [np.atleast_1d(np.asarray(c, dtype=float)) for c in (along_x, along_y)]
    degree = max(c.size for c in coefficients) - 1
    singular = np.abs(flat[4]) >= 1
    flat[4] = np.where(singular, 0.0, flat[4])
    engine, step = _series_images, max(n, 1)
    if not uses_series(flat[2], flat[4], degree):
        n_nodes = x.size * y.size * _line_nodes(flat[2], flat[4], degree)[0].size
        engine, step = _line_images, max(1, _LINE_CHUNK // n_nodes)
    images = np.zeros((6 if derivatives else 1, n, y.size, x.size))
    for start in range(0, n, step):
        part = slice(start, start + step)
        values = [p if p.size == 1 else p[part] for p in flat]
        columns = _reached(x, values[0], values[2])
        rows = _reached(y, values[1], values[3])
        if columns.start < columns.stop and rows.start < rows.stop:
            engine(x[columns], y[rows], values, coefficients, images[:, part, rows, columns])
    images[:, np.broadcast_to(singular, n)] = np.nan
    images = images.reshape(len(images), *shape, y.size, x.size)
    return images if derivatives else images[0]
