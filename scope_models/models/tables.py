"""Tabulated PSFs and PRFs, which splines interpolate and integrate, and corrections of them."""

from functools import cache, cached_property
from operator import attrgetter

import numpy as np
from astropy import units as u
from numpy.polynomial import chebyshev
from scipy.interpolate import BSpline, RectBivariateSpline

from scope_models._arrays import plain_array
from scope_models._checks import checked_integer, checked_number
from scope_models._docstrings import documented
from scope_models.models._gaussian import flattened, gauss_legendre
from scope_models.models._parameters import StarModel, make_coefficients, numbers_of, value_of
from scope_models.models.integration import ClosedForm, pixels_of

__all__ = ["CorrectedPRF", "TabulatedPRF", "TabulatedPSF"]

# A Gaussian PRF of sigma 0.5 px at 9 samples per pixel is interpolated to 0.005 ppm of its flux by
# degree 5, to 1.2 ppm by degree 3 and to 700 ppm by degree 1 (rms in 3 x 3 px).
_DEGREE = 5
# Positions whose integrals along an axis are held at once.
_BATCH = 128
# Rounding errors at the edge of a table, in samples.
_EDGE = 1e-9


class _Surface:
    """A smooth spline through the samples of a table, 0 outside; shared by copies."""

    def __init__(self, samples, oversampling, origin):
        self.samples, self.oversampling, self.origin = samples, oversampling, origin
        self.samples.flags.writeable = False

    def __deepcopy__(self, memo):
        return self

    def __reduce__(self):
        return _Surface, (np.array(self.samples), self.oversampling, self.origin)

    @cached_property
    def spline(self):
        """The spline in samples along y and x."""
        along = map(np.arange, self.samples.shape)
        return RectBivariateSpline(*along, self.samples, kx=_DEGREE, ky=_DEGREE)

    def value(self, dx, dy, *, along_x=0, along_y=0):
        """Value or derivative at offsets from the star in pixels."""
        sample_x = self.origin[0] + self.oversampling[1] * np.asarray(dx, dtype=float)
        sample_y = self.origin[1] + self.oversampling[0] * np.asarray(dy, dtype=float)
        sample_x, sample_y = np.broadcast_arrays(sample_x, sample_y)
        values = self.spline.ev(sample_y.ravel(), sample_x.ravel(), dx=along_y, dy=along_x)
        values *= self.oversampling[1] ** along_x * self.oversampling[0] ** along_y
        ny, nx = self.samples.shape
        inside = (sample_x >= -_EDGE) & (sample_x <= nx - 1 + _EDGE)
        inside &= (sample_y >= -_EDGE) & (sample_y <= ny - 1 + _EDGE)
        return np.where(inside, values.reshape(sample_x.shape), 0.0)

    def integrals(self, x, y, x_0, y_0, along_x, along_y, *, derivatives=False):
        """Integrals over pixels times polynomials: ``(..., ny, nx)``, or 3 of them.

        Gauss-Legendre rules are exact for the polynomials between the samples.
        """
        shape, (x_0, y_0) = flattened((x_0, y_0))
        knots_y, knots_x, _ = self.spline.tck
        orders = ((0, 0), (0, 1), (1, 0)) if derivatives else ((0, 0),)  # along y and x
        splines = [self.spline.partial_derivative(*order) for order in orders]
        images = np.empty((len(orders), x_0.size, y.size, x.size))
        (step_y, step_x), (size_y, size_x) = self.oversampling, self.samples.shape
        for start in range(0, x_0.size, _BATCH):
            part = slice(start, start + _BATCH)
            table_x = _axis_rule(x, x_0[part], self.origin[0], step_x, size_x, along_x, knots_x)
            table_y = _axis_rule(y, y_0[part], self.origin[1], step_y, size_y, along_y, knots_y)
            for image, (by_y, by_x), spline in zip(images, orders, splines, strict=True):
                left, right = table_y(by_y), table_x(by_x)
                matrix = spline.tck[2].reshape(left.shape[2], right.shape[2])
                image[part] = left @ matrix @ right.transpose(0, 2, 1)
        if derivatives:
            images[1] *= -step_x
            images[2] *= -step_y
        images = images.reshape((len(images), *shape, y.size, x.size))
        return images if derivatives else images[0]


def _axis_rule(pixels, center, origin, oversampling, size, polynomial, knots):
    """Return the function that integrates the basis of a derivative's order, times a polynomial.

    Over the pixels along an axis, exactly: shape ``(m, n, k)``.
    """
    nodes, weights = gauss_legendre((_DEGREE + len(np.atleast_1d(polynomial)) + 1) // 2 + 1)
    low = origin + oversampling * (pixels - 0.5 - center[:, np.newaxis])  # edges in samples
    inner = np.floor(low)[..., np.newaxis] + np.arange(1, int(np.ceil(oversampling)) + 1)
    high = low + oversampling
    first, last = low[..., np.newaxis], high[..., np.newaxis]
    edges = np.concatenate([first, np.minimum(inner, last), last], axis=-1)
    edges = np.clip(edges, 0, size - 1)[..., np.newaxis]
    step = np.diff(edges, axis=-2)
    at = edges[..., :-1, :] + step * (nodes + 0.5)
    within = (at - low[..., np.newaxis, np.newaxis]) / oversampling - 0.5
    weight = step * weights / oversampling
    weight = weight * np.polynomial.polynomial.polyval(within, np.atleast_1d(polynomial))
    at, weight = np.clip(at, 0, size - 1).ravel(), weight.ravel()

    @cache
    def integrals(order):
        degree = _DEGREE - order
        table = BSpline.design_matrix(at, knots[order : len(knots) - order], degree)
        k = table.shape[1]
        row = np.repeat(np.arange(low.size), at.size // low.size * (degree + 1))
        weights = np.repeat(weight, degree + 1) * table.data
        sums = np.bincount(row * k + table.indices, weights, minlength=low.size * k)
        return sums.reshape(*low.shape, k)

    return integrals


class _Table(StarModel):
    """What tables of densities and of fluxes of pixels have in common."""

    def __init__(
        self, array, oversampling=1, flux=1.0, x_0=0.0, y_0=0.0, *, origin=None, uncertainty=None,
        **kwargs,
    ):  # fmt: skip
        samples = _checked_samples("array", array)
        steps = np.broadcast_to(plain_array(oversampling, "", "oversampling"), (2,))
        if not (np.isfinite(steps).all() and (steps > 0).all()):
            raise ValueError(f"`oversampling` must be positive, got {oversampling!r}")
        middle = [(n - 1) / 2 for n in samples.shape[::-1]]
        place = plain_array(middle if origin is None else origin, "", "origin")
        if place.shape != (2,) or not np.isfinite(place).all():
            raise ValueError(f"`origin` must be (x, y) in samples, got {origin!r}")
        self._surface = _Surface(samples, tuple(steps.tolist()), tuple(place.tolist()))
        self._error = None
        if uncertainty is not None:
            error = _checked_samples("uncertainty", uncertainty)
            if error.shape != samples.shape or (error < 0).any():
                wanted = f"not negative and of shape {samples.shape}"
                raise ValueError(f"`uncertainty` must be {wanted}, got shape {error.shape}")
            self._error = _Surface(error, self._surface.oversampling, self._surface.origin)
        super().__init__(flux=flux, x_0=x_0, y_0=y_0, **kwargs)

    array = property(
        attrgetter("_surface.samples"), doc="The samples, read-only (ndarray of shape (ny, nx))."
    )
    oversampling = property(
        attrgetter("_surface.oversampling"), doc="Samples per pixel along y and x (tuple of float)."
    )
    origin = property(
        attrgetter("_surface.origin"),
        doc="Sample, counted from 0, where the star is, along x and y (tuple of float).",
    )

    @property
    def uncertainty(self):
        """Standard deviations of the samples (ndarray of shape (ny, nx)) or None."""
        return None if self._error is None else self._error.samples

    @property
    def reach(self):
        """How far the table goes from the star along x and y, pixels (two pairs of float)."""
        return tuple((along[0], along[-1]) for along in self._offsets())

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        names = ("array", "oversampling", "origin", "uncertainty")
        return {name: getattr(self, name) for name in names}

    def _offsets(self):
        """Offsets of the samples from the star along x and y, pixels."""
        return tuple(
            (np.arange(self.array.shape[1 - axis]) - self.origin[axis]) / step
            for axis, step in enumerate(self.oversampling[::-1])
        )

    def unit_derivatives(self, dx, dy):
        """Return the table of unit flux and its derivatives by x_0 and y_0, at offsets (px)."""
        value = self._surface.value
        return value(dx, dy), -value(dx, dy, along_x=1), -value(dx, dy, along_y=1)

    def evaluate(self, x, y, flux, x_0, y_0):
        """Flux in the pixels, or density in units of flux per square pixel."""
        return flux * self._surface.value(_number(x) - _number(x_0), _number(y) - _number(y_0))

    def fit_deriv(self, x, y, flux, x_0, y_0, *others):
        """Derivatives with respect to the parameters, in their order."""
        offsets = _number(x) - _number(x_0), _number(y) - _number(y_0)
        unit, *parts = self.unit_derivatives(*offsets, *others)
        return [unit, *(flux * part for part in parts)]

    def bounding_box(self):
        """Rectangle that the table covers, ``((y_low, y_high), (x_low, x_high))``."""
        box = []
        for axis, center in ((1, self.y_0), (0, self.x_0)):
            low, high = self.reach[axis]
            unit, value = 1.0 if center.unit is None else u.pixel, value_of(center)
            box.append((value + low * unit, value + high * unit))
        return tuple(box)


def _number(value):
    return np.asarray(pixels_of(value), dtype=float)


def _checked_samples(name, array):
    array = np.array(plain_array(array, "", name), order="C")
    if array.ndim != 2 or min(array.shape) <= _DEGREE:
        raise ValueError(f"`{name}` must have two axes of at least 6 samples, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite")
    return array


_REST = """
oversampling : float or tuple of float, optional
    Samples per pixel, one number or (y, x).
flux : float or `~astropy.units.Quantity`, optional
    Flux of the star.
x_0, y_0 : float or `~astropy.units.Quantity`, optional
    Position of the star in pixels.
origin : tuple of float, optional
    Sample (x, y), counted from 0, where the star is; by default the middle.
uncertainty : array_like of shape (ny, nx), optional
    Standard deviations of the samples.
**kwargs
    Keywords of `~astropy.modeling.Model`, such as ``fixed`` and ``bounds``.

Raises
------
ValueError
    If the array is not finite, has fewer than 6 samples along an axis, or an argument does
    not belong to it.
"""


@documented(rest=_REST)
class TabulatedPSF(_Table):
    r"""A density that is given by samples: a spline of degree 5 through them, 0 outside.

    Its integrals over pixels, also of its product with a sensitivity, are exact for the spline.

    Parameters
    ----------
    array : array_like of shape (ny, nx)
        Density of a star of unit flux, per square pixel. Nothing is renormalized: for a total
        flux of 1 the sum of the samples is the product of the oversamplings.
    {rest}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import BivariateGaussianPSF, TabulatedPSF, integrate_pixels
    >>> y, x = np.mgrid[-6:6.01:0.1, -6:6.01:0.1]
    >>> psf = TabulatedPSF(BivariateGaussianPSF()(x, y), oversampling=10)
    >>> print(integrate_pixels(psf, x=[-1, 0, 1], y=[0, 0, 0]).round(4))
    [0.1074 0.4661 0.1074]
    """

    def evaluate(self, x, y, flux, x_0, y_0):
        """Density at the positions, in units of flux per square pixel."""
        density = super().evaluate(x, y, flux, x_0, y_0)
        return density / u.pixel**2 if isinstance(x, u.Quantity) else density

    def closed_form(self, values):
        """Return the integrals over pixels, exact for the spline, for `integrate_pixels`."""
        names = ("x_0", "y_0")
        place = tuple(pixels_of(values[name]) for name in names)
        return ClosedForm(values["flux"], place, self._surface.integrals, names)


@documented(rest=_REST)
class TabulatedPRF(_Table):
    """Flux of a pixel as a function of its offset from the star, given by samples.

    A spline of degree 5 through the samples, 0 outside. The values hold the response of the pixels:
    they are never multiplied by a sensitivity. `~scope_models.PRF` makes images of it.

    Parameters
    ----------
    array : array_like of shape (ny, nx)
        Flux of a pixel at each offset, for a star of unit flux. Nothing is renormalized.
    {rest}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import PRF, BivariateGaussianPSF, TabulatedPRF
    >>> y, x = np.mgrid[-45:46, -45:46] / 9
    >>> table = TabulatedPRF(PRF(BivariateGaussianPSF())(x, y), oversampling=9)
    >>> image = PRF(table).render((5, 5), flux=100, x_0=2.1, y_0=2)
    >>> print(image[2].round(2))
    [ 0.05  7.81 45.95 14.29  0.17]
    """

    pixel_integrated = True
    _fluxes = _Table.array  # of a star of unit flux

    def uncertainty_image(self, shape):
        """Return the uncertainty of the fluxes in an image that the table brings with it.

        It is interpolated between the samples' standard deviations; errors of neighboring
        samples and pixels are correlated.

        Parameters
        ----------
        shape : tuple of int
            Shape (ny, nx) of the image.

        Returns
        -------
        uncertainty : `~numpy.ndarray`
            For the flux and position of the model, without a unit.

        Raises
        ------
        ValueError
            If the table has no uncertainty.
        """
        if self._error is None:
            raise ValueError("the table has no uncertainty")
        y, x = np.indices(shape)
        value = self._error.value(x - _number(self.x_0.value), y - _number(self.y_0.value))
        return float(self.flux.value) * np.maximum(value, 0.0)

    @classmethod
    def from_photutils(cls, model):
        """Make a table of an image model of photutils.

        Parameters
        ----------
        model : `~photutils.psf.ImagePSF`
            The model; for a `~photutils.psf.GriddedPSFModel` see `PRFGrid.from_photutils`.

        Returns
        -------
        table : TabulatedPRF
            With its flux and position.

        Raises
        ------
        TypeError
            If the model is another one.
        """
        from photutils.psf import ImagePSF

        if not isinstance(model, ImagePSF):
            raise TypeError(f"`model` must be an ImagePSF, got {type(model).__name__}")
        return cls(model.data, model.oversampling, **numbers_of(model), origin=model.origin)

    def to_photutils(self):
        """Return the table as a model of photutils, whose splines have the degree 3.

        Returns
        -------
        model : `~photutils.psf.ImagePSF`
            With the same flux and position.

        Raises
        ------
        ValueError
            If the oversampling is not an integer.
        """
        from photutils.psf import ImagePSF

        size = integer_oversampling(self.oversampling)
        values = dict(zip(("flux", "x_0", "y_0"), self.parameters.tolist(), strict=False))
        return ImagePSF(np.array(self._fluxes), **values, origin=self.origin, oversampling=size)


def integer_oversampling(oversampling):
    """Return the oversampling as integers, which photutils needs."""
    if any(value != round(value) for value in oversampling):
        raise ValueError(f"photutils needs an integer `oversampling`, got {oversampling}")
    return tuple(round(value) for value in oversampling)


class CorrectedPRF(TabulatedPRF):
    r"""A table of a PRF times a smooth function of the offset from the star.

    .. math:: f(d_x, d_y) = T(d_x, d_y) \Big[1 + \sum_{0 < k + m \le n} c_{k,m}
              \big(T_k(t_x)\, T_m(t_y) - \overline{T_k T_m}\big)\Big],
              \qquad t = \frac{d}{\sqrt{d^2 + r^2}},

    with Chebyshev polynomials. The mean over the table, weighted by it, is taken off each term, so
    that the sum of the table, and with it the meaning of the flux, does not change.

    Parameters
    ----------
    array : array_like of shape (ny, nx)
        Flux of a pixel at each offset, as for `~scope_models.models.TabulatedPRF`.
    oversampling : float or tuple of float, optional
        Samples per pixel, one number or (y, x).
    flux : float or `~astropy.units.Quantity`, optional
        Flux of the star.
    x_0, y_0 : float or `~astropy.units.Quantity`, optional
        Position of the star in pixels.
    order : int, optional
        Largest sum n of the orders k and m.
    radius : float or `~astropy.units.Quantity`, optional
        Offset r, pixels, beyond which the correction changes little.
    **kwargs
        Coefficients ``c_k_m``, 0 by default, and the other arguments of
        `~scope_models.models.TabulatedPRF`.

    Raises
    ------
    ValueError
        If an argument is outside its domain, as for `~scope_models.models.TabulatedPRF`.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import PRF, BivariateGaussianPSF, CorrectedPRF
    >>> y, x = np.mgrid[-45:46, -45:46] / 9
    >>> samples = PRF(BivariateGaussianPSF())(x, y)
    >>> wider = CorrectedPRF(samples, 9, order=2, c_2_0=0.1, c_0_2=0.1)
    >>> image = PRF(wider).render((9, 9), flux=100, x_0=4, y_0=4)
    >>> print(f"{image[4, 4]:.1f} {image[4, 5]:.1f} {image.sum():.1f}")
    45.3 10.9 99.8
    """

    def __init__(
        self, array, oversampling=1, flux=1.0, x_0=0.0, y_0=0.0, *, order=2, radius=2.0, **kwargs
    ):
        self.order = order = checked_integer("order", order, 1)
        self.radius = checked_number("radius", radius, "pix", positive=True)
        self._places = make_coefficients(self, order, "T")
        super().__init__(array, oversampling, flux, x_0, y_0, **kwargs)
        along_x, along_y = (chebyshev.chebvander(self._t(d)[0], order) for d in self._offsets())
        means = along_y.T @ self.array @ along_x / self.array.sum()
        self._means = np.array([means[m, k] for k, m in self._places])

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        return super().arguments | {"order": self.order, "radius": self.radius}

    @property
    def parameter_kinds(self):
        """Kinds of the parameters in a fit (dict of str)."""
        return dict.fromkeys(self.param_names[3:], "correction")

    def _t(self, d):
        """The bounded coordinate and its derivative."""
        square = d**2 + self.radius**2
        return d / np.sqrt(square), self.radius**2 * square**-1.5

    def unit_derivatives(self, dx, dy, *coefficients):
        """Return fluxes of unit flux and derivatives by x_0, y_0 and coefficients, at offsets."""
        dx, dy = np.broadcast_arrays(plain_array(dx, "pix", "dx"), plain_array(dy, "pix", "dy"))
        table, table_x, table_y = super().unit_derivatives(dx, dy)
        values, slopes, matrix = [], [], chebyshev.chebder(np.eye(self.order + 1))
        for t, slope in map(self._t, (dx, dy)):
            values.append(chebyshev.chebvander(t, self.order))
            lower = chebyshev.chebvander(t, self.order - 1)
            slopes.append((lower @ matrix) * slope[..., np.newaxis])
        factor, factor_x, factor_y, by_coefficient = 1.0, 0.0, 0.0, []
        for (k, m), mean, c in zip(self._places, self._means, coefficients, strict=True):
            term = values[0][..., k] * values[1][..., m] - mean
            by_coefficient.append(table * term)
            factor = factor + c * term
            factor_x = factor_x + c * slopes[0][..., k] * values[1][..., m]
            factor_y = factor_y + c * values[0][..., k] * slopes[1][..., m]
        by_x, by_y = table_x * factor - table * factor_x, table_y * factor - table * factor_y
        return [table * factor, by_x, by_y, *by_coefficient]

    def evaluate(self, x, y, flux, x_0, y_0, *coefficients):
        """Flux in the pixels."""
        offsets = _number(x) - _number(x_0), _number(y) - _number(y_0)
        return flux * self.unit_derivatives(*offsets, *coefficients)[0]

    def corrected_table(self):
        """Return a plain table of the corrected PRF.

        Returns
        -------
        table : TabulatedPRF
            With the correction in its samples.
        """
        values = self.parameters[:3]
        return TabulatedPRF(self._fluxes, self.oversampling, *values, origin=self.origin)

    @property
    def _fluxes(self):
        dx, dy = self._offsets()
        return self.unit_derivatives(dx, dy[:, np.newaxis], *self.parameters[3:])[0]
