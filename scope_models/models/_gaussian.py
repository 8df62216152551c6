r"""Exact integrals over pixels of a bivariate normal density times a polynomial.

Everything here is a pure function of arrays: no models, no units. A pixel is the unit square
around an integer (or any other) center, and the polynomial is in ``(u, v)``, the offset from
that center, so that each pixel sees the same polynomial.

The bivariate normal density is a sum of separable terms (Mehler's expansion, Abramowitz and
Stegun 22.9.3 with 26.2.31)

.. math:: f = \frac{1}{\sigma_x \sigma_y} \sum_k \rho^k h_k(z_x) h_k(z_y),

where ``z = (x - x_0) / sigma``, with the functions of `scope_models.models._axis`. Each term
integrates in closed form along each axis. With rho = 0 the first term is all. Derivatives with
respect to position and width are integrals of the same family. Where ``|rho|`` is so large that the
series is long, a Gauss-Legendre rule along x, whose node count follows from the width of the
density, of closed forms along y takes its place.
"""

from functools import partial

import numpy as np

from scope_models.models._axis import axis_direct, axis_table, gauss_legendre, gaussian_nodes

__all__ = [
    "REACH", "contract", "flattened", "gaussian_pixels", "n_terms", "series_step", "slope_pairs",
    "uses_series",
]  # fmt: skip

# The series is cut where the rest is below this part of the total flux.
_TOLERANCE = 1e-11
# Beyond this many standard deviations a Gaussian holds less than 1e-16 of its flux.
REACH = 8.5
# Elements of temporary arrays: few enough for them to stay in the processor's cache.
_LINE_CHUNK = 1 << 16
_SERIES_CHUNK = 1 << 15
# Fewest and most densities in a step of the series: fewer are not worth its overhead, and fresh
# large arrays cost more than the computation in them.
_FEWEST, _MOST = 32, 1024
# Scale of a density, in the size of a panel, down to which a rule has one panel.
_PANEL = 0.1
# Terms of the series that cost as much as a node of the line rule.
_NODE_COST = 12


def n_terms(rho):
    """Number of terms of Mehler's expansion for the tolerance."""
    largest = np.max(np.abs(rho))
    if largest == 0:
        return 1
    return int(np.ceil(np.log(_TOLERANCE) / np.log(largest))) + 1


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
    return min(max(_SERIES_CHUNK // (n_terms * max(x.size, y.size, 1)), _FEWEST), _MOST)


def _moved(table, sigma):
    """Derivative of all orders but the last two, on the axis before the last, by the position."""
    order = np.arange(1.0, table.shape[-2] - 1)[:, np.newaxis]
    return np.sqrt(order) * table[..., 1:-1, :] / sigma


def _widened(table, sigma):
    """Derivative of all orders but the last two with respect to the width."""
    order = np.arange(table.shape[-2] - 2.0)[:, np.newaxis]
    change = order * table[..., :-2, :] + np.sqrt((order + 1) * (order + 2)) * table[..., 2:, :]
    return change / sigma


def slope_pairs(x_table, y_table, sigma_x, sigma_y, weigh):
    """Tables along y and x whose products are an image, and its slopes by position and widths.

    ``weigh`` multiplies a table along y by the coefficients. The tables hold two orders more.
    """
    base_x, base_y = x_table[..., :-2, :], weigh(y_table[..., :-2, :])
    return [
        (base_y, base_x),
        (base_y, _moved(x_table, sigma_x)),
        (weigh(_moved(y_table, sigma_y)), base_x),
        (base_y, _widened(x_table, sigma_x)),
        (weigh(_widened(y_table, sigma_y)), base_x),
    ]


def _series_images(x, y, parameters, coefficients, out):
    """Add up the terms of Mehler's expansion: one image, or six."""
    x_0, y_0, sigma_x, sigma_y, rho = parameters
    n, largest, slopes = n_terms(rho), np.max(np.abs(rho)), len(out) > 1
    n_orders = n + 2 if slopes else n
    x_axis = axis_table(x, x_0, sigma_x, coefficients[0], n_orders, largest)
    y_axis = axis_table(y, y_0, sigma_y, coefficients[1], n_orders, largest)
    powers = rho[:, np.newaxis, np.newaxis] ** np.arange(n)[:, np.newaxis]
    order = np.arange(1.0, n + 1)[:, np.newaxis]
    step = series_step(n, x, y)
    for start in range(0, out.shape[1], step):
        part = slice(start, start + step)
        x_table, y_table = x_axis(part), y_axis(part)
        weight = powers if len(powers) == 1 else powers[part]
        if not slopes:
            y_table *= weight
            contract(y_table, x_table, out[0, part])
            continue
        widths = (s if s.size == 1 else s[part, np.newaxis, np.newaxis] for s in (sigma_x, sigma_y))
        pairs = slope_pairs(x_table, y_table, *widths, partial(np.multiply, weight))
        pairs.append((weight * order * y_table[:, 1:-1], x_table[:, 1:-1]))
        for pair, image in zip(pairs, out, strict=True):
            contract(*pair, image[part])


def _line_images(x, y, parameters, coefficients, out):
    """Apply a Gauss-Legendre rule along x to closed forms along y: one image, or six.

    There the density along y is normal, with the mean ``y_0 + rho sigma_y z_x`` and the width
    ``sigma_y sqrt(1 - rho^2)``. Narrow densities have several panels in a pixel.
    """
    x_0, y_0, sigma_x, sigma_y, rho = (p[:, np.newaxis] for p in parameters)
    nodes, weights = _line_nodes(sigma_x, rho, coefficients[0].size - 1)
    weights = weights * np.polynomial.polynomial.polyval(nodes, coefficients[0])
    z = ((x[:, np.newaxis] + nodes).ravel() - x_0) / sigma_x
    middle = y_0 + rho * sigma_y * z
    width = np.broadcast_to(sigma_y * np.sqrt(1 - rho**2), middle.shape)
    n_orders, shape = 1 if len(out) == 1 else 3, (-1, x.size, nodes.size)
    table = axis_direct(y, middle.ravel(), width.ravel(), coefficients[1], n_orders)
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
    by_mean = [rule(1, power) / (sigma_y * rest) for power in range(3)]
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
    start, stop = pixels.searchsorted([center.min() - reach, center.max() + reach])
    return slice(int(start), int(stop))


def flattened(parameters):
    """The common shape of parameters, and each as ``(n,)``; one number stays one, for speed.

    The first two are positions, which are always ``(n,)``.
    """
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
    ``derivatives`` those by x_0, y_0, sigma_x, sigma_y and rho follow: ``(6, ..., ny, nx)``. The
    cheaper of two engines, series and line rule, renders the pixels within reach.
    """
    shape, flat = flattened((x_0, y_0, sigma_x, sigma_y, rho))
    n = flat[0].size
    coefficients = [np.atleast_1d(np.asarray(c, dtype=float)) for c in (along_x, along_y)]
    degree = max(c.size for c in coefficients) - 1
    singular = np.abs(flat[4]) >= 1
    flat[4] = np.where(singular, 0.0, flat[4])
    series = uses_series(flat[2], flat[4], degree)
    step = max(n, 1)
    if not series:
        n_nodes = x.size * y.size * _line_nodes(flat[2], flat[4], degree)[0].size
        step = max(1, _LINE_CHUNK // n_nodes)
    images = np.zeros((6 if derivatives else 1, n, y.size, x.size))
    for start in range(0, n, step):
        part = slice(start, start + step)
        values = [p if p.size == 1 else p[part] for p in flat]
        columns = _reached(x, values[0], values[2])
        rows = _reached(y, values[1], values[3])
        if columns.start < columns.stop and rows.start < rows.stop:
            out = images[:, part, rows, columns]
            images_of = _series_images if series else _line_images
            images_of(x[columns], y[rows], values, coefficients, out)
    images[:, np.broadcast_to(singular, n)] = np.nan
    images = images.reshape(len(images), *shape, y.size, x.size)
    return images if derivatives else images[0]
