"""Integrals over pixels with fifty digits, and the errors of the package's against them.

    python studies/fifty_digits.py truth tests/data/fifty_digits.ecsv
    python studies/fifty_digits.py errors docs/data/fifty_digits.ecsv

"truth" writes integrals of correlated Gaussians times polynomials, and derivatives, at hard places;
"errors" the error against the number of terms, nodes, panels, Chebyshev coefficients and samples,
and that of the hard places, which ``docs/figures/fifty_digits.py`` draws. Both need mpmath.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import mpmath as mp
import numpy as np
from _rows import stamp
from astropy.table import Table
from mpmath.calculus.quadrature import GaussLegendre

from scope_models import BivariateGaussianPSF, TabulatedPSF, integrate_pixels
from scope_models.models import _gaussian

mp.mp.dps, STEP = 50, mp.mpf("1e-16")
RULE = GaussLegendre(mp.mp)
X_ROW, Y_ROW = (1.0, 0.1, -0.05, 0.2), (1.0, -0.2, -0.75)
NAMES = ("x_0", "y_0", "sigma_x", "sigma_y", "rho")
PLACES = ((3.0, 3.0), (3.5, 3.125), (3.5, 3.5), (3.4990234375, 2.5))
# Half the width of a panel in standard deviations, and where densities end.
HALF, REACH = 0.75, 15


def along_y(mean, sigma, row):
    """Return the integral over (-1/2, 1/2) of a polynomial times a normal density."""
    edges = [-mp.mpf(1) / 2, mp.mpf(1) / 2]
    low, high = ((edge - mean) / sigma for edge in edges)
    if low > 0:  # where the complement has the digits
        low, high = -high, -low
    density = [mp.npdf((edge - mean) / sigma) for edge in edges]
    moments = [mp.ncdf(high) - mp.ncdf(low)]
    for n in range(1, len(row)):
        boundary = edges[1] ** (n - 1) * density[1] - edges[0] ** (n - 1) * density[0]
        before = (n - 1) * sigma**2 * moments[n - 2] if n > 1 else 0
        moments.append(mean * moments[-1] + before - sigma * boundary)
    return mp.fdot(row, moments)


def exact(column, line, x_0, y_0, sigma_x, sigma_y, rho, x_row=X_ROW, y_row=Y_ROW):
    """Return the integral of a unit Gaussian times the polynomials over a pixel."""
    x, y = x_0 - column, y_0 - line
    width, slope = sigma_y * mp.sqrt(1 - rho**2), rho * sigma_y / sigma_x
    low = max(-mp.mpf(1) / 2, x - REACH * sigma_x)
    high = min(mp.mpf(1) / 2, x + REACH * sigma_x)
    cuts = [x + 2 * HALF * k * sigma_x for k in range(-REACH, REACH)]
    if rho:  # along y the density crosses the edges of the pixel there
        step = 2 * HALF * width / abs(slope)
        for edge in (-mp.mpf(1) / 2, mp.mpf(1) / 2):
            cuts += [x + (edge - y) / slope + k * step for k in range(-REACH, REACH)]
    cuts = [low, *sorted(cut for cut in cuts if low < cut < high), high]
    total = mp.mpf(0)
    for ends in (pair for pair in pairwise(cuts) if pair[0] < pair[1]):
        for u, weight in RULE.get_nodes(*ends, degree=4, prec=mp.mp.prec):  # 24 nodes
            part = along_y(y + slope * (u - x), width, y_row) * mp.npdf((u - x) / sigma_x)
            total += weight * mp.fdot(x_row, [u**n for n in range(len(x_row))]) * part / sigma_x
    return total


def slopes(pixel, values):
    """Return the derivatives by the parameters: central differences of 1e-16, exact to 1e-30."""
    found = []
    for k, value in enumerate(values):
        ends = [exact(*pixel, *values[:k], value + s, *values[k + 1 :]) for s in (-STEP, STEP)]
        found.append((ends[1] - ends[0]) / (2 * STEP))
    return found


def write_truth(path):
    rows = []
    for number, sigma in enumerate((0.02, 0.1, 0.3, 0.5, 1.0, 3.0)):
        for k, rho in enumerate((0.0, 0.01, 0.5, 0.9, 0.99, -0.9999)):
            x_0, y_0 = PLACES[(number + k) % len(PLACES)]
            values = [mp.mpf(v) for v in (x_0, y_0, sigma, (1, 2.5)[k % 2] * sigma, rho)]
            for pixel in ((3, 3), (4, 4), (2, 3 + round(2 * sigma))):
                numbers = [exact(*pixel, *values)]
                hard = pixel == (3, 3) and sigma in {0.1, 0.5, 3.0}
                numbers += slopes(pixel, values) if hard else []
                text = " ".join(mp.nstr(n, 25) for n in numbers)
                rows.append((*pixel, *map(float, values), text))
    names = ("column", "row", *NAMES, "integral_and_slopes")
    Table(rows=rows, names=names).write(path, overwrite=True)


def largest_error(engine, values, truth):
    """Return the largest error of an engine of the package; `truth` is by (column, row)."""
    pixels, image = np.arange(7.0), np.zeros((1, 1, 7, 7))
    rows = np.array(X_ROW), np.array(Y_ROW)
    engine(pixels, pixels, [np.array([value]) for value in values], rows, image)
    return max(abs(float(image[0, 0, j, i] - v)) for (i, j), v in truth.items())


def gaussian_errors():
    """Yield errors of the series and of the line rule, as their orders grow."""
    kept = _gaussian.n_terms, _gaussian.gaussian_nodes
    cases = [("terms", 0.5, rho) for rho in (0.2, 0.5, 0.8)]
    cases += [("nodes", sigma, 0.9) for sigma in (0.3, 0.7, 1.5)]
    for kind, sigma, rho in cases:
        values = 3.3, 3.4, sigma, sigma, rho
        truth = {p: exact(*p, *map(mp.mpf, values)) for p in ((3, 3), (4, 4), (3, 4))}
        chosen = kept[0](rho) if kind == "terms" else kept[1](sigma * np.sqrt(1 - rho**2), 3)
        engine = _gaussian._series_images if kind == "terms" else _gaussian._line_images  # noqa: SLF001
        for order in sorted({*range(2, 2 * chosen, max(1, chosen // 12)), chosen}):
            _gaussian.n_terms = _gaussian.gaussian_nodes = lambda *_, order=order: order
            error = largest_error(engine, values, truth)
            yield kind, (rho if kind == "terms" else sigma), order, error, chosen
        _gaussian.n_terms, _gaussian.gaussian_nodes = kept
    for sigma in (0.15, 0.5, 1.5):
        yield from axis_errors(sigma)


def panel_errors():
    """Yield errors of the line rule at the corner of a pixel, as its panels get more."""
    kept, nodes_of = _gaussian._PANEL, _gaussian.gaussian_nodes  # noqa: SLF001
    for sigma, rho in ((0.1, 0.9), (0.02, 0.5), (0.3, 0.9999)):
        values = 3.5, 3.5, sigma, sigma, rho
        truth = {p: exact(*p, *map(mp.mpf, values)) for p in ((3, 3), (4, 4), (3, 4), (5, 5))}
        scale = sigma * np.sqrt(1 - rho**2)
        chosen = int(np.ceil(kept / scale))
        nodes = nodes_of(scale * chosen, 3)
        _gaussian.gaussian_nodes = lambda *_, nodes=nodes: nodes
        for number in sorted({*range(1, 2 * chosen, max(1, chosen // 12)), chosen}):
            _gaussian._PANEL = (number - 0.5) * scale  # noqa: SLF001
            error = largest_error(_gaussian._line_images, values, truth)  # noqa: SLF001
            yield "panels", float(f"{scale:.2g}"), number, error, chosen
        _gaussian._PANEL, _gaussian.gaussian_nodes = kept, nodes_of  # noqa: SLF001


def place_errors():
    """Yield the largest error at the hard places against the width, for each correlation."""
    path = Path(__file__).parents[1] / "tests" / "data" / "fifty_digits.ecsv"
    pixels, errors = np.arange(12.0), {}
    for row in Table.read(path):
        values = [float(row[name]) for name in NAMES]
        image = _gaussian.gaussian_pixels(pixels, pixels, *values, X_ROW, Y_ROW)
        truth = float(row["integral_and_slopes"].split()[0])
        key = abs(row["rho"]), row["sigma_x"]
        errors[key] = max(errors.get(key, 0), abs(image[row["row"], row["column"]] - truth))
    for (rho, sigma), error in errors.items():
        yield "places", rho, sigma, error, 0


def axis_errors(sigma):
    """Yield errors of the integrals along an axis as a Chebyshev series of the position grows."""
    pixels, row = np.arange(7.0), np.array(X_ROW)
    panels = _gaussian.AxisPanels(pixels, sigma, row, 1)
    at = np.array([2.2500001, 2.41, 2.9, 3.39, 3.7499999])
    truth = [[float(along_y(mp.mpf(x) - p, mp.mpf(sigma), X_ROW)) for p in range(7)] for x in at]
    panels(at)
    ((key, (expansion, sizes)),) = panels.panels.items()
    for order in sorted({*range(2, sizes[0], 2), sizes[0]}):
        panels.panels[key] = expansion[:order], [order, 1]
        yield "coefficients", sigma, order, np.abs(panels(at)[:, 0] - truth).max(), sizes[0]
    panels.panels[key] = expansion, sizes


def table_errors():
    """Yield errors of tabulated Gaussians against the samples per pixel."""
    for sigma in (0.3, 0.5, 1.0):
        values = [mp.mpf(v) for v in (3.3, 3.4, sigma, sigma, 0.3)]
        truth = {p: exact(*p, *values, (1,), (1,)) for p in ((3, 3), (4, 4), (3, 4))}
        for samples in (3, 5, 7, 9, 13, 19, 27):
            half = np.ceil(8 * sigma) * samples
            y, x = np.mgrid[-half : half + 1, -half : half + 1] / samples
            density = BivariateGaussianPSF(1, 0, 0, sigma, sigma, 0.3)(x, y)
            model = TabulatedPSF(density, samples, 1, 3.3, 3.4)
            image = integrate_pixels(model, (7, 7))
            error = max(abs(float(image[j, i] - v)) for (i, j), v in truth.items())
            yield "samples", sigma, samples, error, 9


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("truth", "errors"))
    parser.add_argument("path")
    options = parser.parse_args()
    if options.kind == "truth":
        return write_truth(options.path)
    names = ("kind", "case", "order", "error", "chosen")
    rows = [*gaussian_errors(), *panel_errors(), *table_errors(), *place_errors()]
    table = Table(rows=rows, names=names)
    stamp(table, "python studies/fifty_digits.py errors docs/data/fifty_digits.ecsv")
    return table.write(options.path, overwrite=True)


if __name__ == "__main__":
    main()
