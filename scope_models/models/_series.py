"""Images of one star in all cadences of a series: each depends on its own position alone."""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from scope_models._arrays import without_unit
from scope_models.models import _gaussian
from scope_models.models._gaussian import FEW, ROWS, AxisPanels
from scope_models.models.integration import (
    Factor,
    PixelPoints,
    Term,
    closed_form,
    expand,
    integrate_density,
    integrate_term,
    is_pixel_integrated,
)

__all__ = ["ImageSeries", "is_gaussian", "unit_images"]

# Up to this number of positions are integrated one by one, more are interpolated.
_BATCH = FEW - 4
# Standard deviations beyond which a normal density holds less than 1e-13 of its light.
_DARK = 7.5


class ImageSeries:
    """Images of a star of unit flux at the positions of a series.

    Gaussians are interpolated between places that depend on the reference position ``at`` alone:
    the same position and width give the same pixels to the last bit, however the series is split.

    The first component of the PSF is put at the star's position; one that is integrated over pixels
    contains the sensitivity. Positions and factors on the width, or their extremes, choose the
    `window` that the star lights. With a ``blur``, px, images of sums of Gaussians are convolved
    with a normal distribution of the star's position along each axis.
    """

    def __init__(self, psf, sensitivity, shape, x, y, widths=None, blur=0.0, at=(0, 0)):
        widest = 1.0 if widths is None else np.max(widths)
        self._psf, self._stamp = psf, shape
        parts = _with_response(psf, sensitivity)
        self.window = _window(parts, shape, x, y, widest, blur)
        # How far from the star all but the dark part of its light is.
        self._reach = max(
            math.inf
            if gaussian is None
            else max(map(abs, offset)) + _DARK * math.hypot(max(gaussian[:2]), term.diffusion)
            for _, offset, term, gaussian in parts
        )
        rows, columns = (np.arange(s.start, s.stop, dtype=float) for s in self.window)
        grid = columns, rows, blur, np.rint(at)
        self._shape = rows.size, columns.size
        lit = () if 0 in self._shape else parts
        self._parts = [(part, offset, _engine(*form, *grid)) for part, offset, *form in lit]

    def __call__(self, x, y, widths=None):
        """Images ``(m, ...)`` of the `window` at positions and factors on the width ``(m,)``."""
        if not self._parts:
            return np.zeros((len(x), *self._shape))
        scale, images = 1.0 if widths is None else widths, None
        for fraction, (dx, dy), engine in self._parts:
            image = engine(x + scale * dx, y + scale * dy, widths)
            if fraction != 1.0:
                image *= fraction
            images = image if images is None else np.add(images, image, out=images)
        return images

    def lost(self, x, y):
        """Largest part of the light off the stamp: where it is farthest on axes and diagonals."""
        ny, nx = self._stamp
        ends = x.min() + 0.5, nx - 0.5 - x.max(), y.min() + 0.5, ny - 0.5 - y.max()
        if min(ends) > self._reach:
            return 0.0
        few = sorted({i for u in (x, y, x + y, x - y) for i in (u.argmin(), u.argmax())})
        images = unit_images(self._psf, self._stamp, x[few], y[few])
        return min(max(1.0 - float(images.sum(axis=(1, 2)).min()), 0.0), 1.0)


def is_gaussian(psf, sensitivity):
    """Whether PSF times sensitivity is bivariate normal times polynomials, which can be blurred."""
    return all(part[-1] is not None for part in _with_response(psf, sensitivity))


def unit_images(psf, shape, x, y):
    """Images ``(m, ny, nx)`` of unit flux at a few positions ``(m,)``, each integrated directly."""
    columns, rows = (np.arange(n, dtype=float) for n in shape[::-1])
    images = np.zeros((len(x), *shape))
    for fraction, (dx, dy), term in _components(psf):
        images += fraction * _directly(term, columns, rows)(x + dx, y + dy, None)
    return images


def _components(psf):
    """Return fraction of the flux, offset from the star and unit term of each component."""
    terms = [term for term in expand(psf) if np.any(term.scale)]
    first = terms[0].densities[0].values
    total = sum(term.scale * without_unit(term.densities[0].values["flux"]) for term in terms)
    components = []
    for term in terms:
        values = {name: without_unit(v) for name, v in term.densities[0].values.items()}
        fraction = float(term.scale * values["flux"] / total)
        offset = [float(values[n] - without_unit(first[n])) for n in ("x_0", "y_0")]
        values |= {"flux": 1.0, "x_0": 0.0, "y_0": 0.0}
        unit = Term(1.0, (Factor(term.densities[0].model, values),), term.sensitivities)
        components.append((fraction, offset, unit))
    return components


def _with_response(psf, sensitivity):
    """Return fraction, offset, unit product and the Gaussian of each component and response."""
    responses = [Term()] if sensitivity is None else expand(sensitivity)
    parts = []
    for fraction, offset, unit in _components(psf):
        whole = is_pixel_integrated(unit.densities[0].model)
        terms = [unit] if whole else [unit * response for response in responses]
        parts += [(fraction * float(term.scale), offset, term, _normal(term)) for term in terms]
    return parts


def _normal(term):
    """Return sigma_x, sigma_y and rho of a bivariate normal density, None of any other."""
    form = term.closed_form()
    if form is not None:  # diffusion is added after the change of focus
        form = closed_form(term.densities[0].model, term.densities[0].values)
    if form is None or form.pixels is not _gaussian.gaussian_pixels:
        return None
    return tuple(float(value) for value in form.parameters[2:])


def _window(parts, shape, x, y, widest, blur):
    """Return the rows and columns that any component lights at any position."""
    limits = []  # of each component, about the star along x and y
    for _, offset, term, gaussian in parts:
        far = _gaussian.REACH * math.hypot(blur, term.diffusion)
        if gaussian is not None:
            reaches = [math.hypot(_gaussian.REACH * widest * sigma, far) for sigma in gaussian[:2]]
            reach = [(-r, r) for r in reaches]
        elif hasattr(model := term.densities[0].model, "reach"):
            reach = [(widest * low - far, widest * high + far) for low, high in model.reach]
        else:
            return slice(0, shape[0]), slice(0, shape[1])
        pairs = zip((widest * d for d in offset), reach, strict=True)
        limits.append([(low + min(d, 0.0), high + max(d, 0.0)) for d, (low, high) in pairs])
    window = []
    for n, place, pairs in zip(shape[::-1], (x, y), zip(*limits, strict=True), strict=True):
        lows, highs = zip(*pairs, strict=True)
        ends = place.min() + min(lows) - 0.5, place.max() + max(highs) + 0.5
        window.append(slice(*(min(max(math.ceil(end), 0), n) for end in ends)))
    return tuple(window[::-1])


def _engine(term, gaussian, columns, rows, blur, middle):
    """Return the function of positions and widths that renders one component."""
    if gaussian is None:
        return _directly(term, columns, rows)
    along = term.polynomials()
    widened = partial(_widened, *gaussian, np.hypot(blur, term.diffusion))
    sigma_x, sigma_y, rho = widened()
    if not _gaussian.uses_series(sigma_x, rho, max(c.size for c in along) - 1):
        return _along_lines(columns, rows, widened, along)
    n = _gaussian.n_terms(rho)
    orders = np.arange(n)[:, np.newaxis]
    x_axis = AxisPanels(columns, sigma_x, along[0], n, abs(rho), middle[0])
    y_axis = AxisPanels(rows, sigma_y, along[1], n, abs(rho), middle[1])
    step = _gaussian.series_step(n, columns, rows) // ROWS * ROWS

    def tables(x, y):
        """Return the integrals along both axes, in one go where they are in the same panel."""
        if x_axis.panels is not y_axis.panels:
            return x_axis(x), y_axis(y)
        both = x_axis(np.concatenate([x, y]))
        return both[: x.size], both[x.size :]

    def render(x, y, widths):
        images = np.empty((x.size, rows.size, columns.size))
        for start in range(0, x.size, step):
            part, tilt = slice(start, start + step), rho
            if widths is None:
                x_table, y_table = tables(x[part], y[part])
            else:
                wide, tall, tilt = widened(widths[part])
                x_table = x_axis(x[part], wide / sigma_x)
                y_table = y_axis(y[part], tall / sigma_y)
            if n > 1:
                y_table *= np.reshape(tilt, (-1, 1, 1)) ** orders
            _gaussian.contract(y_table, x_table, images[part])
        return images

    return render


def _widened(sigma_x, sigma_y, rho, blur, widths=1.0):
    """Return sigma_x, sigma_y and rho of a density that focus widens and then a blur."""
    narrow, low = widths * sigma_x, widths * sigma_y
    wide, tall = np.hypot(narrow, blur), np.hypot(low, blur)
    return wide, tall, rho * (narrow / wide) * (low / tall)


def _along_lines(columns, rows, widened, along):
    """Return the renderer of a Gaussian so narrow along one direction that the series is long."""

    def render(x, y, widths):
        images = np.empty((x.size, rows.size, columns.size))
        step = _BATCH if widths is None else 1  # the rule follows from the narrowest of a batch
        for start in range(0, x.size, step):
            part = slice(start, start + step)
            form = widened() if widths is None else widened(widths[part])
            images[part] = _gaussian.gaussian_pixels(columns, rows, x[part], y[part], *form, *along)
        return images

    return render


def _directly(term, columns, rows):
    """Return the renderer of any density: few positions at a time, none interpolated."""
    points = PixelPoints.from_shape((rows.size, columns.size))
    (factor,) = term.densities

    def moved(x, y):
        values = factor.values | {"x_0": x, "y_0": y}
        return replace(term, scale=1.0, densities=(Factor(factor.model, values),))

    def scaled(x, y, widths):
        """Integrate p((x - x_0) / w) / w^2; the response stays with the pixels."""

        def evaluate(x_at, y_at, index):
            shape = (-1,) + (1,) * (x_at.ndim - 1)
            w, x_0, y_0 = (values[index].reshape(shape) for values in (widths, x, y))
            return factor.evaluate((x_at - x_0) / w, (y_at - y_0) / w, index) / w**2

        zeros = np.zeros(x.size)
        return integrate_density(moved(zeros, zeros), points, evaluate)

    def render(x, y, widths):
        if widths is not None and is_pixel_integrated(factor.model):
            name = type(factor.model).__name__
            raise ValueError(f"the width of {name} cannot change: it is integrated over pixels")
        images = np.empty((x.size, rows.size, columns.size))
        x, y = x - columns[0], y - rows[0]
        for start in range(0, x.size, _BATCH):
            part = slice(start, start + _BATCH)
            if widths is None:
                images[part] = integrate_term(moved(x[part], y[part]), points)
            else:
                images[part] = scaled(x[part], y[part], widths[part])
        return images

    return render
