# Licensed under a 3-clause BSD style license - see LICENSE
"""Images of one star in all cadences of a series: each depends on its own position alone."""

import numpy as np

from scope_models._arrays import without_unit
from scope_models.models._axis import FEW, ROWS, AxisPanels
from scope_models.models._gaussian import (
    contract,
    gaussian_pixels,
    n_terms,
    reached,
    series_step,
    uses_series,
)
from scope_models.models._terms import Factor, Term, expand, is_pixel_integrated
from scope_models.models.integration import PixelPoints, integrate_density, integrate_term

__all__ = ["ImageSeries", "is_gaussian", "unit_images"]

# Positions of one call of what interpolates long series: so few are integrated one by one.
_BATCH = FEW - 4


class ImageSeries:
    """
    Images of a star of unit flux at the positions of a series.

    Gaussians are interpolated between places that do not depend on the series: the same position
    and width give the same pixels to the last bit, in whatever pieces the series is rendered.

    Parameters
    ----------
    psf : `~astropy.modeling.Model`
        A density with the parameters flux, x_0 and y_0, or a sum of several. It is scaled to unit
        flux, and its first component is put at the star's position.
    sensitivity : `~astropy.modeling.Model` or None
        Response within the pixels. A PSF that is integrated over pixels already contains it, and
        is not multiplied by it.
    shape : tuple of int
        Shape (ny, nx) of the stamp.
    x, y : `~numpy.ndarray`
        All positions of the series, or their extremes, which choose the `window`.
    widths : `~numpy.ndarray`, optional
        All factors on the width of the PSF, or their extremes.
    blur : float, optional
        Standard deviation along each axis, px, of a normal distribution of the star's position
        with which images are convolved; of sums of Gaussians only.

    Attributes
    ----------
    window : tuple of slice
        Rows and columns that the star lights.
    """

    def __init__(self, psf, sensitivity, shape, x, y, widths=None, blur=0.0):
        widest = 1.0 if widths is None else np.max(widths)
        parts = _parts(psf, sensitivity)
        self.window = _window(parts, shape, x, y, widest, blur)
        rows, columns = (np.arange(s.start, s.stop, dtype=float) for s in self.window)
        self._parts = [
            (fraction, offset, _engine(term, columns, rows, blur))
            for fraction, offset, term in parts
        ]
        self._shape = rows.size, columns.size

    def __call__(self, x, y, widths=None):
        """Images ``(m, ...)`` of the `window` at positions and factors on the width ``(m,)``."""
        images = np.zeros((len(x), *self._shape))
        if not images.size:
            return images
        scale = 1.0 if widths is None else widths
        for number, (fraction, (dx, dy), engine) in enumerate(self._parts):
            image = engine(x + scale * dx, y + scale * dy, widths)
            image *= fraction
            images = image if number == 0 else np.add(images, image, out=images)
        return images


def is_gaussian(psf, sensitivity):
    """Whether PSF times sensitivity is bivariate normal times polynomials, which can be blurred."""
    return all(_gaussian(term) is not None for _, _, term in _parts(psf, sensitivity))


def unit_images(psf, shape, x, y):
    """Images ``(m, ny, nx)`` of unit flux at a few positions ``(m,)``, each integrated directly."""
    columns, rows = (np.arange(n, dtype=float) for n in shape[::-1])
    images = np.zeros((len(x), *shape))
    for fraction, (dx, dy), term in _parts(psf, None):
        images += fraction * _directly(term, columns, rows)(x + dx, y + dy, None)
    return images


def _parts(psf, sensitivity):
    """Return fraction of the flux, offset from the star and unit product of each component."""
    terms = [term for term in expand(psf) if np.any(term.scale)]
    first = terms[0].densities[0].values
    total = sum(term.scale * without_unit(term.densities[0].values["flux"]) for term in terms)
    responses = [Term()] if sensitivity is None else expand(sensitivity)
    parts = []
    for term in terms:
        values = {name: without_unit(v) for name, v in term.densities[0].values.items()}
        fraction = float(term.scale * values["flux"] / total)
        offset = [float(values[n] - without_unit(first[n])) for n in ("x_0", "y_0")]
        model = term.densities[0].model
        values |= {"flux": 1.0, "x_0": 0.0, "y_0": 0.0}
        unit = Term(densities=(Factor(model, values),), sensitivities=term.sensitivities)
        several = [Term()] if is_pixel_integrated(model) else responses
        parts.extend((fraction, offset, unit * response) for response in several)
    return parts


def _gaussian(term):
    """Return sigma_x, sigma_y and rho of a bivariate normal density, None of any other."""
    if term.closed_form() is None:
        return None
    form = term.undiffused().closed_form()  # the diffusion is added after the change of focus
    if form.pixels is not gaussian_pixels:
        return None
    return tuple(float(value) for value in form.parameters[2:])


def _window(parts, shape, x, y, widest, blur):
    """Return the rows and columns that any component lights at any position."""
    windows = []
    for _, (dx, dy), term in parts:
        gaussian = _gaussian(term)
        if gaussian is None:
            reach = getattr(term.densities[0].model, "reach", None)
            if reach is None:
                return slice(0, shape[0]), slice(0, shape[1])
            windows.append(_table_window(reach, shape, (x, y), (dx, dy), widest + blur))
            continue
        sigma_x, sigma_y, _ = gaussian
        ends = np.array([1.0, widest])
        columns, rows = (
            reached(
                np.arange(n),
                np.add.outer(ends * d, [p.min(), p.max()]),
                np.hypot(widest * sigma, np.hypot(blur, term.diffusion)),
            )
            for n, d, p, sigma in ((shape[1], dx, x, sigma_x), (shape[0], dy, y, sigma_y))
        )
        windows.append((rows.start, rows.stop, columns.start, columns.stop))
    lows, highs = np.min(windows, axis=0), np.max(windows, axis=0)
    return slice(int(lows[0]), int(highs[1])), slice(int(lows[2]), int(highs[3]))


def _table_window(reach, shape, places, offsets, scale):
    """Return the first and last of the rows and columns that a table covers, at least one."""
    found = []
    for n, place, offset, (low, high) in zip(shape[::-1], places, offsets, reach, strict=True):
        first = np.floor(place.min() + scale * (low - abs(offset)) - 0.5)
        last = np.ceil(place.max() + scale * (high + abs(offset)) + 0.5)
        start = int(np.clip(first, 0, n - 1))
        found.append((start, int(np.clip(last + 1, start + 1, n))))
    return (*found[1], *found[0])


def _engine(term, columns, rows, blur):
    """Return the function of positions and widths that renders one component."""
    gaussian = _gaussian(term)
    along = term.polynomials()
    if gaussian is None:
        return _directly(term, columns, rows)
    widened = _Widened(*gaussian, np.hypot(blur, term.diffusion))
    sigma_x, sigma_y, rho = widened()
    if not uses_series(sigma_x, sigma_y, rho, max(c.size for c in along) - 1):
        return _tensor(columns, rows, widened, along)
    n = n_terms(rho)
    orders = np.arange(n)[:, np.newaxis]
    x_axis = AxisPanels(columns, sigma_x, along[0], n, abs(rho))
    y_axis = AxisPanels(rows, sigma_y, along[1], n, abs(rho))
    step = series_step(n, columns, rows) // ROWS * ROWS

    def render(x, y, widths):
        images = np.empty((x.size, rows.size, columns.size))
        for start in range(0, x.size, step):
            part = slice(start, start + step)
            wide, tall, tilt = (None, None, rho) if widths is None else widened.over(widths[part])
            y_table = y_axis(y[part], tall)
            y_table *= np.reshape(tilt, (-1, 1, 1)) ** orders
            contract(y_table, x_axis(x[part], wide), images[part])
        return images

    return render


class _Widened:
    """Widths and correlation of a normal density that focus widens and blur convolves."""

    def __init__(self, sigma_x, sigma_y, rho, blur):
        self._unblurred, self._blur = (sigma_x, sigma_y, rho), blur

    def __call__(self, widths=1.0):
        """Return sigma_x, sigma_y and rho at factors on the width."""
        sigma_x, sigma_y, rho = self._unblurred
        sigmas = widths * sigma_x, widths * sigma_y
        if not self._blur:
            return *sigmas, rho
        wide, tall = (np.hypot(sigma, self._blur) for sigma in sigmas)
        return wide, tall, rho * (sigmas[0] / wide) * (sigmas[1] / tall)

    def over(self, widths):
        """Return the factors on both widths against those at 1, and the correlation."""
        if not self._blur:
            return widths, widths, self._unblurred[2]
        sigma_x, sigma_y, _ = self()
        wide, tall, rho = self(widths)
        return wide / sigma_x, tall / sigma_y, rho


def _tensor(columns, rows, widened, along):
    """Return the renderer of a Gaussian so narrow along one direction that the series is long."""

    def render(x, y, widths):
        images = np.empty((x.size, rows.size, columns.size))
        step = _BATCH if widths is None else 1  # the rule follows from the narrowest of a batch
        for start in range(0, x.size, step):
            part = slice(start, start + step)
            shape = widened() if widths is None else widened(widths[part])
            images[part] = gaussian_pixels(columns, rows, x[part], y[part], *shape, *along)
        return images

    return render


def _directly(term, columns, rows):
    """Return the renderer of any density: few positions at a time, none interpolated."""
    points = PixelPoints.from_shape((rows.size, columns.size))
    (factor,) = term.densities

    def moved(x, y):
        values = factor.values | {"x_0": x, "y_0": y}
        return Term(densities=(Factor(factor.model, values),), sensitivities=term.sensitivities)

    def scaled(x, y, widths):
        """Integrate p((x - x_0) / w) / w^2; the response stays with the pixels."""

        def evaluate(x_at, y_at, index):
            w, x_0, y_0 = (
                values[index].reshape((-1,) + (1,) * (x_at.ndim - 1)) for values in (widths, x, y)
            )
            return factor.evaluate((x_at - x_0) / w, (y_at - y_0) / w, index) / w**2

        zeros = np.zeros(x.size)
        return integrate_density(moved(zeros, zeros), points, evaluate)

    def render(x, y, widths):
        if widths is not None and is_pixel_integrated(factor.model):
            raise ValueError(
                f"the width of {type(factor.model).__name__} cannot change: it is integrated over "
                "pixels already"
            )
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
