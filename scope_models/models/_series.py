"""Images of one star in all cadences of a series."""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from scope_models._arrays import without_unit
from scope_models.models._gaussian import (
    FEW,
    REACH,
    ROWS,
    AxisPanels,
    contract,
    gaussian_pixels,
    n_terms,
    series_step,
    uses_series,
)
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

# Positions at once, so few that they are not interpolated.
_BATCH = FEW - 4
# Standard deviations beyond which a Gaussian holds less than 1e-13 of its flux.
_DARK = 7.5


class ImageSeries:
    """Images of a star of unit flux at the positions of a series.

    Gaussians are interpolated between places that depend on the reference position ``at`` alone:
    the same position and width give the same pixels to the last bit, however the series is split.

    The first component of the PSF is put at the star's position. Positions and factors on the
    width, or their extremes, choose the `window` that the star lights. With a ``blur``, px, images
    of sums of Gaussians are convolved with a normal distribution of the position along each axis.
    """

    def __init__(self, psf, sensitivity, shape, x, y, widths=None, blur=0.0, at=(0, 0)):
        self._psf, self._stamp = psf, shape
        parts = _components(psf, sensitivity)
        self.window = _window(parts, shape, x, y, 1.0 if widths is None else np.max(widths), blur)
        # Of all but the dark part of the light.
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
        scale, images = 1.0 if widths is None else widths, None
        for fraction, (dx, dy), engine in self._parts:
            image = _rendered(engine, self._shape, x + scale * dx, y + scale * dy, widths)
            if fraction != 1.0:
                image *= fraction
            images = image if images is None else np.add(images, image, out=images)
        return np.zeros((len(x), *self._shape)) if images is None else images

    def lost(self, x, y):
        """Largest part of the light off the stamp, at the extremes on axes and diagonals."""
        ny, nx = self._stamp
        ends = x.min() + 0.5, nx - 0.5 - x.max(), y.min() + 0.5, ny - 0.5 - y.max()
        if min(ends) > self._reach:
            return 0.0
        few = sorted({i for u in (x, y, x + y, x - y) for i in (u.argmin(), u.argmax())})
        images = unit_images(self._psf, self._stamp, x[few], y[few])
        return min(max(1.0 - float(images.sum(axis=(1, 2)).min()), 0.0), 1.0)


def is_gaussian(psf, sensitivity):
    """Whether PSF times sensitivity can be blurred: it is bivariate normal times polynomials."""
    return all(part[-1] is not None for part in _components(psf, sensitivity))


def unit_images(psf, shape, x, y):
    """Images ``(m, ny, nx)`` of unit flux at a few positions ``(m,)``, each integrated directly."""
    columns, rows = (np.arange(n, dtype=float) for n in shape[::-1])
    images = np.zeros((len(x), *shape))
    for fraction, (dx, dy), term, _ in _components(psf):
        images += fraction * _rendered(_directly(term, columns, rows), shape, x + dx, y + dy)
    return images


def _rendered(engine, shape, x, y, widths=None):
    """Return the images of an engine: how many go in one step, and the function that fills them."""
    (step, fill), images = engine, np.empty((x.size, *shape))
    for start in range(0, x.size, step):
        part = slice(start, start + step)
        fill(x[part], y[part], None if widths is None else widths[part], images[part])
    return images


def _components(psf, sensitivity=None):
    """Return fraction, offset, unit product and Gaussian of each component and response."""
    terms = [term for term in expand(psf) if np.any(term.scale)]
    responses = [Term()] if sensitivity is None else expand(sensitivity)
    values = [{n: without_unit(v) for n, v in t.densities[0].values.items()} for t in terms]
    fluxes = [term.scale * own["flux"] for term, own in zip(terms, values, strict=True)]
    components = []
    for term, own, flux in zip(terms, values, fluxes, strict=True):
        model = term.densities[0].model
        offset = [float(own[name] - values[0][name]) for name in ("x_0", "y_0")]
        factor = Factor(model, own | {"flux": 1.0, "x_0": 0.0, "y_0": 0.0})
        unit = Term(1.0, (factor,), term.sensitivities)
        for response in [Term()] if is_pixel_integrated(model) else responses:
            fraction, product = float(response.scale * flux / sum(fluxes)), unit * response
            components.append((fraction, offset, product, _normal(product)))
    return components


def _normal(term):
    """Return sigma_x, sigma_y and rho of a bivariate normal density, None of any other."""
    form = term.closed_form()
    if form is not None:  # diffusion is added after the change of focus
        form = closed_form(term.densities[0].model, term.densities[0].values)
    if form is None or form.pixels is not gaussian_pixels:
        return None
    return tuple(float(value) for value in form.parameters[2:])


def _moved(term, x, y):
    """Return a product without its scale at these positions."""
    (factor,) = term.densities
    moved = Factor(factor.model, factor.values | {"x_0": x, "y_0": y})
    return replace(term, scale=1.0, densities=(moved,))


def _window(parts, shape, x, y, widest, blur):
    """Return the rows and columns that any component lights at any position."""
    limits = []  # of each component, about the star along x and y
    for _, offset, term, gaussian in parts:
        far = REACH * math.hypot(blur, term.diffusion)
        if gaussian is not None:
            high = np.hypot(REACH * widest * np.array(gaussian[:2]), far)
            low = -high
        elif hasattr(model := term.densities[0].model, "reach"):
            low, high = widest * np.transpose(model.reach) + [[-far], [far]]
        else:
            return slice(0, shape[0]), slice(0, shape[1])
        shift = widest * np.array(offset)
        limits.append((low + np.minimum(shift, 0), high + np.maximum(shift, 0)))
    low, high = np.min(limits, axis=(0, 1)), np.max(limits, axis=(0, 1))
    starts = np.array([x.min(), y.min()]) + low - 0.5
    stops = np.array([x.max(), y.max()]) + high + 0.5
    ends = np.clip(np.ceil([starts, stops]), 0, shape[::-1]).astype(int)
    return tuple(slice(*pair) for pair in ends.T[::-1].tolist())


def _engine(term, gaussian, columns, rows, blur, middle):
    """Return the engine of a component, for `_rendered`."""
    if gaussian is None:
        return _directly(term, columns, rows)
    along = term.polynomials()
    widened = partial(_widened, *gaussian, np.hypot(blur, term.diffusion))
    sigma_x, sigma_y, rho = widened()
    if not uses_series(sigma_x, rho, max(c.size for c in along) - 1):
        # So narrow along one direction that the series is long.
        def fill_by_lines(x, y, widths, out):
            if widths is None:
                out[:] = gaussian_pixels(columns, rows, x, y, *widened(), *along)
            else:  # the rule follows from the narrowest of a batch
                for i, form in enumerate(map(widened, widths)):
                    out[i] = gaussian_pixels(columns, rows, x[i], y[i], *form, *along)

        return _BATCH, fill_by_lines

    n = n_terms(rho)
    orders = np.arange(n)[:, np.newaxis]
    x_axis = AxisPanels(columns, sigma_x, along[0], n, abs(rho), middle[0])
    y_axis = AxisPanels(rows, sigma_y, along[1], n, abs(rho), middle[1])

    def fill(x, y, widths, out):
        tilt = rho
        if widths is not None:
            wide, tall, tilt = widened(widths)
            x_table, y_table = x_axis(x, wide / sigma_x), y_axis(y, tall / sigma_y)
        elif x_axis.panels is y_axis.panels:  # both axes in one go
            both = x_axis(np.concatenate([x, y]))
            x_table, y_table = both[: x.size], both[x.size :]
        else:
            x_table, y_table = x_axis(x), y_axis(y)
        if n > 1:
            y_table *= np.reshape(tilt, (-1, 1, 1)) ** orders
        contract(y_table, x_table, out)

    return series_step(n, columns, rows) // ROWS * ROWS, fill


def _widened(sigma_x, sigma_y, rho, blur, widths=1.0):
    """Return sigma_x, sigma_y and rho of a density that focus widens and then a blur."""
    narrow, low = widths * sigma_x, widths * sigma_y
    wide, tall = np.hypot(narrow, blur), np.hypot(low, blur)
    return wide, tall, rho * (narrow / wide) * (low / tall)


def _directly(term, columns, rows):
    """Return the engine of any density, which interpolates nothing."""
    points = PixelPoints(columns, rows[:, np.newaxis])
    (factor,) = term.densities

    def fill(x, y, widths, out):
        if widths is None:
            out[:] = integrate_term(_moved(term, x, y), points)
            return
        if is_pixel_integrated(factor.model):
            name = type(factor.model).__name__
            raise ValueError(f"the width of {name} cannot change: it is integrated over pixels")

        def evaluate(x_at, y_at, index):
            """Return p((x - x_0) / w) / w^2; the response stays with the pixels."""
            shape = (-1,) + (1,) * (x_at.ndim - 1)
            w, x_0, y_0 = (values[index].reshape(shape) for values in (widths, x, y))
            return factor.evaluate((x_at - x_0) / w, (y_at - y_0) / w, index) / w**2

        zeros = np.zeros(x.size)
        out[:] = integrate_density(_moved(term, zeros, zeros), points, evaluate)

    return _BATCH, fill
