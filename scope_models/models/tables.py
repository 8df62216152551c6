"""PSFs and PRFs in tables, which splines interpolate, and grids of them."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from astropy import units as u
from numpy.polynomial import chebyshev
from numpy.polynomial.polynomial import polyder, polyval
from scipy.interpolate import BSpline, LinearNDInterpolator, RectBivariateSpline

from scope_models._arrays import plain_array, plain_number
from scope_models._checks import checked_integer, checked_number
from scope_models._docstrings import documented
from scope_models._values import Value, frozen
from scope_models.models._gaussian import flattened
from scope_models.models.integration import ClosedForm, numbers_of, pixels_of, value_of
from scope_models.models.psf import StarModel, make_coefficients

__all__ = ["CorrectedPRF", "PRFGrid", "TabulatedPRF", "TabulatedPSF"]

# Errors of a Gaussian PRF of sigma 0.5 px at 9 samples per pixel: 0.005 ppm, 1.2 ppm for degree 3.
_DEGREE = 5
# Positions that are integrated at once.
_BATCH = 128
# Rounding errors at the edge of a table, pixels.
_EDGE = 1e-9
# Farther outside the places of a grid nothing is extrapolated, pixels.
_FAR = 100.0


class _Surface:
    """A smooth spline through the samples of a table, 0 outside; shared by copies."""

    def __init__(self, samples, oversampling, origin):
        self.samples, self.oversampling, self.origin = samples, oversampling, origin
        self.samples.flags.writeable = False
        along = zip(samples.shape[::-1], origin, oversampling[::-1], strict=True)
        # Of the samples from the star, pixels.
        self.offsets = tuple((np.arange(n) - start) / step for n, start, step in along)

    def __deepcopy__(self, memo):
        return self

    def __reduce__(self):
        return _Surface, (self.samples, self.oversampling, self.origin)

    @cached_property
    def spline(self):
        """The spline of offsets along y and x."""
        return RectBivariateSpline(*self.offsets[::-1], self.samples, kx=_DEGREE, ky=_DEGREE)

    def value(self, dx, dy, *, along_x=0, along_y=0):
        """Value or derivative at offsets from the star in pixels."""
        inside = True
        for at, offsets in zip((dx, dy), self.offsets, strict=True):
            inside = inside & (at >= offsets[0] - _EDGE) & (at <= offsets[-1] + _EDGE)
        return np.where(inside, self.spline(dy, dx, dx=along_y, dy=along_x, grid=False), 0.0)

    def integrals(self, x, y, x_0, y_0, along_x, along_y, *, derivatives=False):
        """Integrals over pixels times polynomials, exact: ``(..., ny, nx)``, or 3 of them."""
        shape, (x_0, y_0) = flattened((x_0, y_0))
        knots_y, knots_x, coefficients = self.spline.tck
        coefficients = coefficients.reshape(self.samples.shape)
        orders = ((0, 0), (0, 1), (1, 0)) if derivatives else ((0, 0),)  # along y and x
        images = np.empty((len(orders), x_0.size, y.size, x.size))
        for start in range(0, x_0.size, _BATCH):
            part = slice(start, start + _BATCH)
            for image, (by_y, by_x) in zip(images, orders, strict=True):
                left = _basis_integrals(knots_y, y - y_0[part, np.newaxis], along_y, by_y)
                right = _basis_integrals(knots_x, x - x_0[part, np.newaxis], along_x, by_x)
                image[part] = left @ coefficients @ right.transpose(0, 2, 1)
        images[1:] *= -1  # offsets fall where the position grows
        images = images.reshape((len(images), *shape, y.size, x.size))
        return images if derivatives else images[0]


def _basis_integrals(knots, pixels, polynomial, order):
    """Integrals of a spline's basis, or its derivatives, times a polynomial over pixels.

    By parts, over pixels of centers ``(m, n)`` from the star: ``(m, n, k)``.
    """
    polynomial, integrals = np.atleast_1d(polynomial), 0.0
    edges = np.clip(np.stack([pixels - 0.5, pixels + 0.5]), knots[0], knots[-1])
    basis = BSpline(knots, np.eye(knots.size - _DEGREE - 1), _DEGREE)
    for n in range(polynomial.size):
        factor = polyval(edges - pixels, polyder(polynomial, n))
        low, high = factor[..., np.newaxis] * basis.antiderivative(n + 1 - order)(edges)
        integrals = integrals + (-1) ** n * (high - low)
    return integrals


class _Table(StarModel):
    """A table of a density or of fluxes of pixels."""

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

    @property
    def array(self):
        """The samples, read-only (ndarray of shape (ny, nx))."""
        return self._surface.samples

    @property
    def oversampling(self):
        """Samples per pixel along y and x (tuple of float)."""
        return self._surface.oversampling

    @property
    def origin(self):
        """Sample, counted from 0, where the star is, along x and y (tuple of float)."""
        return self._surface.origin

    @property
    def uncertainty(self):
        """Standard deviations of the samples (ndarray of shape (ny, nx)) or None."""
        return None if self._error is None else self._error.samples

    @property
    def reach(self):
        """How far the table goes from the star along x and y, pixels (two pairs of float)."""
        return tuple((along[0], along[-1]) for along in self._surface.offsets)

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        names = ("array", "oversampling", "origin", "uncertainty")
        return {name: getattr(self, name) for name in names}

    def unit_derivatives(self, dx, dy):
        """Return the table of unit flux and its derivatives by x_0 and y_0, at offsets (px)."""
        value = self._surface.value
        return value(dx, dy), -value(dx, dy, along_x=1), -value(dx, dy, along_y=1)

    def evaluate(self, x, y, flux, x_0, y_0):
        """Flux in the pixels, or density in units of flux per square pixel."""
        return flux * self._surface.value(*_distances(x, y, x_0, y_0))

    def fit_deriv(self, x, y, flux, x_0, y_0, *others):
        """Derivatives with respect to the parameters, in their order."""
        unit, *parts = self.unit_derivatives(*_distances(x, y, x_0, y_0), *others)
        return [unit, *(flux * part for part in parts)]

    def bounding_box(self):
        """Rectangle that the table covers, ``((y_low, y_high), (x_low, x_high))``."""
        box = []
        for center, ends in zip((self.y_0, self.x_0), self.reach[::-1], strict=True):
            unit = 1.0 if center.unit is None else u.pixel
            box.append(tuple(value_of(center) + end * unit for end in ends))
        return tuple(box)


def _distances(x, y, x_0, y_0):
    """Offsets from the star along x and y, pixels, where any may have the unit or not."""
    x, y, x_0, y_0 = (np.asarray(pixels_of(v), dtype=float) for v in (x, y, x_0, y_0))
    return x - x_0, y - y_0


def _checked_samples(name, array):
    array = np.array(plain_array(array, "", name), order="C")
    if array.ndim != 2 or min(array.shape) <= _DEGREE:
        raise ValueError(f"`{name}` must have two axes of at least 6 samples, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite")
    return array


_STAR = """
oversampling : float or tuple of float, optional
    Samples per pixel, one number or (y, x).
flux : float or `~astropy.units.Quantity`, optional
    Flux of the star.
x_0, y_0 : float or `~astropy.units.Quantity`, optional
    Position of the star in pixels.
"""
_REST = f"""{_STAR}
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
        Density of a star of unit flux, per square pixel: the sum of the samples is the product of
        the oversamplings. Nothing is renormalized.
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
        """Return the integrals over pixels in closed form."""
        names = ("x_0", "y_0")
        place = tuple(pixels_of(values[name]) for name in names)
        return ClosedForm(values["flux"], place, self._surface.integrals, names)


@documented(rest=_REST)
class TabulatedPRF(_Table):
    """Flux of a pixel as a function of its offset from the star, given by samples.

    A spline of degree 5 through the samples, 0 outside. The values hold the response of the pixels:
    they are never multiplied by a sensitivity.

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
        """Return the uncertainty of the fluxes in an image, correlated between neighbors.

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
        value = self._error.value(x - self.x_0.value, y - self.y_0.value)
        return float(self.flux.value) * np.maximum(value, 0.0)

    @classmethod
    def from_photutils(cls, model):
        """Make a table of an image model of photutils.

        Parameters
        ----------
        model : `~photutils.psf.ImagePSF`
            The model.

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
        flux, x_0, y_0 = self.parameters[:3].tolist()
        options = {"origin": self.origin, "oversampling": size}
        return ImagePSF(np.array(self._fluxes), flux=flux, x_0=x_0, y_0=y_0, **options)


def integer_oversampling(oversampling):
    if any(value != round(value) for value in oversampling):
        raise ValueError(f"photutils needs an integer `oversampling`, got {oversampling}")
    return tuple(round(value) for value in oversampling)


@documented(star=_STAR)
class CorrectedPRF(TabulatedPRF):
    r"""A table of a PRF times a smooth function of the offset from the star.

    .. math:: f(d_x, d_y) = T(d_x, d_y) \Big[1 + \sum_{0 < k + m \le n} c_{k,m}
              \big(T_k(t_x)\, T_m(t_y) - \overline{T_k T_m}\big)\Big],
              \qquad t = \frac{d}{\sqrt{d^2 + r^2}},

    with Chebyshev polynomials. The mean over the table, weighted by it, is taken off each term, so
    that the sum of the table does not change.

    Parameters
    ----------
    array : array_like of shape (ny, nx)
        Flux of a pixel at each offset, as for `~scope_models.models.TabulatedPRF`.
    {star}
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
        As for `~scope_models.models.TabulatedPRF`.

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
        self._orders = k, m = np.transpose(make_coefficients(self, order, "T"))
        super().__init__(array, oversampling, flux, x_0, y_0, **kwargs)
        (along_x, _), (along_y, _) = map(self._along, self._surface.offsets)
        self._means = (along_y.T @ self.array @ along_x / self.array.sum())[m, k]

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        return super().arguments | {"order": self.order, "radius": self.radius}

    @property
    def parameter_kinds(self):
        """Kinds of the parameters in a fit (dict of str)."""
        return dict.fromkeys(self.param_names[3:], "correction")

    def _along(self, d):
        """Polynomials of the bounded coordinate, and their derivatives by the offset."""
        square = d**2 + self.radius**2
        table = chebyshev.chebvander(d / np.sqrt(square), self.order)
        slopes = table[..., :-1] @ chebyshev.chebder(np.eye(self.order + 1))
        return table, slopes * (self.radius**2 * square**-1.5)[..., np.newaxis]

    def unit_derivatives(self, dx, dy, *coefficients):
        """Return fluxes of unit flux and derivatives by x_0, y_0 and coefficients, at offsets."""
        dx, dy = np.broadcast_arrays(plain_array(dx, "pix", "dx"), plain_array(dy, "pix", "dy"))
        table, table_x, table_y = super().unit_derivatives(dx, dy)
        (along_x, slope_x), (along_y, slope_y) = map(self._along, (dx, dy))
        k, m = self._orders
        terms = along_x[..., k] * along_y[..., m] - self._means
        coefficients = np.stack(np.broadcast_arrays(*coefficients), axis=-1)

        def added_up(values):
            return np.sum(coefficients * values, axis=-1)

        factor = 1.0 + added_up(terms)
        by_x = table_x * factor - table * added_up(slope_x[..., k] * along_y[..., m])
        by_y = table_y * factor - table * added_up(along_x[..., k] * slope_y[..., m])
        return [table * factor, by_x, by_y, *(table * np.moveaxis(terms, -1, 0))]

    def evaluate(self, x, y, flux, x_0, y_0, *coefficients):
        """Flux in the pixels."""
        return flux * self.unit_derivatives(*_distances(x, y, x_0, y_0), *coefficients)[0]

    def corrected_table(self):
        """Return a plain table of the corrected PRF.

        Returns
        -------
        table : TabulatedPRF
            The table.
        """
        values = self.parameters[:3]
        return TabulatedPRF(self._fluxes, self.oversampling, *values, origin=self.origin)

    @property
    def _fluxes(self):
        dx, dy = self._surface.offsets
        return self.unit_derivatives(dx, dy[:, np.newaxis], *self.parameters[3:])[0]


@dataclass(frozen=True, eq=False, repr=False)
class PRFGrid(Value):
    """PRF tables at several places of a detector.

    Parameters
    ----------
    places : array_like of shape (n, 2)
        Column and row of each table.
    tables : tuple of TabulatedPRF
        The tables, all of one shape, oversampling and origin.

    Raises
    ------
    ValueError
        If the tables do not belong together, or have the same place.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import PRFGrid, TabulatedPRF
    >>> places = [(1, 1), (1, 101), (101, 1), (101, 101)]
    >>> y, x = np.mgrid[-5:6, -5:6]
    >>> tables = [TabulatedPRF(np.exp(-(x**2 + y**2) / (2 + c / 100))) for c, r in places]
    >>> table = PRFGrid(places, tables).at(51, 20)
    >>> print(f"{table(1, 0):.4f}")
    0.6627
    """

    places: np.ndarray
    tables: tuple

    def __post_init__(self):
        places = plain_array(self.places, u.pixel, "places")
        tables = tuple(self.tables)
        if places.shape != (len(tables), 2) or not np.isfinite(places).all() or not tables:
            raise ValueError(f"`places` must have the shape ({len(tables)}, 2), got {places.shape}")
        if len(np.unique(places, axis=0)) < len(places):
            raise ValueError("`places` must differ: two tables have the same place")
        if len({(table.array.shape, table.oversampling, table.origin) for table in tables}) > 1:
            raise ValueError("`tables` must have one shape, oversampling and origin")
        object.__setattr__(self, "places", frozen(places))
        object.__setattr__(self, "tables", tables)

    @property
    def _is_rectangular(self):
        columns, rows = map(np.unique, self.places.T)
        return columns.size * rows.size == len(self.tables)

    def weights(self, column, row):
        """Return the weight of each table at a place.

        It is bilinear where the places are a rectangular grid, else linear in triangles; outside
        the places the nearest edge counts.

        Parameters
        ----------
        column, row : float or `~astropy.units.Quantity`
            The place in pixels.

        Returns
        -------
        weights : `~numpy.ndarray`
            Not negative, of sum 1.

        Raises
        ------
        ValueError
            If the place is more than 100 px outside.
        """
        given = {"column": column, "row": row}
        place = np.array([plain_number(value, u.pixel, name) for name, value in given.items()])
        low, high = self.places.min(axis=0), self.places.max(axis=0)
        if not (np.all(place >= low - _FAR) and np.all(place <= high + _FAR)):
            raise ValueError(
                f"`column` and `row` must be near columns {low[0]:g} to {high[0]:g} and rows "
                f"{low[1]:g} to {high[1]:g}, got {place[0]:g} and {place[1]:g}"
            )
        place = np.clip(place, low, high)
        if self._is_rectangular:
            weights = 1.0
            for at, places in zip(place, self.places.T, strict=True):
                nodes, which = np.unique(places, return_inverse=True)
                along = np.array([np.interp(at, nodes, row) for row in np.eye(nodes.size)])
                weights = weights * along[which]
            return weights
        weights = LinearNDInterpolator(self.places, np.eye(len(self.tables)))(place)[0]
        if np.isnan(weights).any():
            raise ValueError(f"column {place[0]:g}, row {place[1]:g} is not between the places")
        return np.maximum(weights, 0.0)

    def at(self, column=None, row=None):
        """Return the table of a place.

        Parameters
        ----------
        column, row : float or `~astropy.units.Quantity`, optional
            The place in pixels; not needed for a single table.

        Returns
        -------
        table : TabulatedPRF
            The mean of the tables with their `weights`.

        Raises
        ------
        ValueError
            If the place is more than 100 px outside, or left out of several.
        """
        first = self.tables[0]
        if column is None and row is None and len(self.tables) == 1:
            return first
        if column is None or row is None:
            raise ValueError("`column` and `row` must be given: there are tables of several places")
        weights = self.weights(column, row)
        used = [(w, t) for w, t in zip(weights, self.tables, strict=True) if w]
        error = None
        if all(table.uncertainty is not None for _, table in used):
            error = np.sqrt(sum((w * table.uncertainty) ** 2 for w, table in used))
        samples = sum(w * table.array for w, table in used)
        return TabulatedPRF(samples, first.oversampling, origin=first.origin, uncertainty=error)

    def to_photutils(self):
        """Return the grid as a model of photutils.

        Returns
        -------
        model : `~photutils.psf.GriddedPSFModel`
            With x_0 and y_0 in the pixels of the places.

        Raises
        ------
        ValueError
            If the places are not a rectangular grid.
        """
        from astropy.nddata import NDData
        from photutils.psf import GriddedPSFModel

        if not self._is_rectangular:
            raise ValueError("photutils needs places on a rectangular grid; use at(column, row)")
        meta = {
            "grid_xypos": [tuple(place) for place in self.places.tolist()],
            "oversampling": integer_oversampling(self.tables[0].oversampling),
        }
        return GriddedPSFModel(NDData(np.array([t.array for t in self.tables]), meta=meta))

    @classmethod
    def from_photutils(cls, model):
        """Make a grid of a model of photutils.

        Parameters
        ----------
        model : `~photutils.psf.GriddedPSFModel`
            The model.

        Returns
        -------
        grid : PRFGrid
            The grid.

        Raises
        ------
        TypeError
            If the model is another one.
        """
        from photutils.psf import GriddedPSFModel

        if not isinstance(model, GriddedPSFModel):
            raise TypeError(f"`model` must be a GriddedPSFModel, got {type(model).__name__}")
        tables = [TabulatedPRF(image, model.oversampling) for image in model.data]
        return cls(model.grid_xypos, tables)

    @classmethod
    def from_tess(cls, path, camera=None, ccd=None):
        """Read the official PRF tables of TESS.

        Parameters
        ----------
        path : str or path-like
            One file, or a folder with the files of one epoch (sectors 1 to 3, or 4 and later).
        camera, ccd : int, optional
            Which CCD; not needed if there is only one.

        Returns
        -------
        grid : PRFGrid
            The tables of the CCD.

        Raises
        ------
        FileNotFoundError
            If there are no such files.
        ValueError
            If the files are of another format, several CCDs, or several epochs.
        """
        path = Path(path)
        files = sorted([*path.glob("*prf*.fits"), *path.glob("*prf*.fits.gz")])
        files = files if path.is_dir() else [path]
        found = [_read_tess(file) for file in files]
        chosen = [row for row in found if camera in (None, row[0][0]) and ccd in (None, row[0][1])]
        if not chosen:
            raise FileNotFoundError(f"{path} has no PRF of camera {camera}, CCD {ccd}")
        ccds, places, tables = zip(*chosen, strict=True)
        if len(set(ccds)) > 1:
            raise ValueError(f"{path} holds several CCDs: give `camera` and `ccd`")
        if len(set(places)) < len(places):
            raise ValueError(f"{path} holds several epochs of a place: give the folder of one")
        return cls(places, tables)

    @classmethod
    def from_kepler(cls, path):
        """Read an official PRF file of Kepler, of one channel.

        Parameters
        ----------
        path : str or path-like
            The file, with five places: the corners and the center.

        Returns
        -------
        grid : PRFGrid
            The tables of the channel.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ValueError
            If it is of another format.
        """
        from astropy.io import fits

        places, tables = [], []
        with fits.open(path) as hdus:
            for hdu in hdus:
                if hdu.is_image and hdu.header.get("NAXIS") == 2:
                    step = _card(hdu.header, "CDELT1P", path), _card(hdu.header, "CDELT2P", path)
                    oversampling = tuple(round(1 / s, 6) for s in step[::-1])
                    tables.append(TabulatedPRF(hdu.data, oversampling))
                    places.append([_card(hdu.header, f"CRVAL{i}P", path) for i in (1, 2)])
        if not tables:
            raise ValueError(f"{path} holds no PRF images")
        return cls(places, tables)


def _card(header, name, path):
    try:
        return float(header[name])
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path} is not a PRF file: it has no card {name}") from None


def _read_tess(path):
    """CCD, place and table of a file."""
    from astropy.io import fits

    with fits.open(path) as hdus:
        header = hdus[0].header
        ccd = int(_card(header, "CAM", path)), int(_card(header, "CCD", path))
        place = _card(header, "CCD_CREF", path), _card(header, "CCD_RREF", path)
        origin = tuple(_card(header, f"CRPIX{i}P", path) - 1 for i in (1, 2))
        error = np.asarray(hdus[1].data, dtype=float) if len(hdus) > 1 else None
        samples = np.asarray(hdus[0].data, dtype=float)
        oversampling = _card(header, "NSAMP", path)
        return ccd, place, TabulatedPRF(samples, oversampling, origin=origin, uncertainty=error)
