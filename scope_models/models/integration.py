"""Integration of models over pixels: the one place where a density becomes a flux."""

import math
import warnings
from functools import partial, reduce
from operator import add

import numpy as np
from astropy import units as u
from astropy.modeling import Model
from numpy.polynomial import Polynomial

from scope_models._arrays import plain_array, without_unit
from scope_models._checks import checked_choice, checked_shape
from scope_models.exceptions import IntegrationWarning
from scope_models.models._gaussian import gauss_legendre
from scope_models.models._terms import expand, is_pixel_integrated, leaves
from scope_models.models.sensitivity import collected

__all__ = ["integrate_pixels"]

# Standard deviations of the diffusion beyond which no charge of a pixel comes from.
_DIFFUSION_REACH = 7.0
# Change between two rules, as part of an image's flux, at which a pixel has converged.
_TOLERANCE = 1e-11
# Growth of the number of nodes from rule to rule, and the number that leads to a subdivision.
_GROWTH = 1.5
_MOST_NODES = 48
# Pixels are cut into quarters at most this often.
_DEPTH = 8
# Evaluations of the integrand held in memory at a time.
_CHUNK = 1 << 18


class PixelPoints:
    """Pixel centers, which broadcast, and the grid of columns and rows that they lie on."""

    def __init__(self, x, y):
        try:
            x, y = np.broadcast_arrays(plain_array(x, u.pixel, "x"), plain_array(y, u.pixel, "y"))
        except ValueError as error:
            shapes = f"{np.shape(x)} and {np.shape(y)}"
            raise ValueError(f"`x` and `y` must broadcast, got shapes {shapes}") from error
        if x.size == 0:
            raise ValueError("`x` and `y` must hold at least one pixel")
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
            raise ValueError("`x` and `y` must be finite")
        self.shape = x.shape
        self.x, self.y = x.ravel(), y.ravel()
        self.columns, self._column = np.unique(self.x, return_inverse=True)
        self.rows, self._row = np.unique(self.y, return_inverse=True)
        size = self.columns.size * self.rows.size
        # Points that are scattered rather than on a grid are better done one by one.
        self.on_grid = size <= 4 * self.x.size
        place = self._row * self.columns.size + self._column
        self.whole = size == self.x.size and bool(np.all(place == np.arange(size)))

    @classmethod
    def from_shape(cls, shape):
        """All pixels of an image of shape (ny, nx)."""
        points = cls.__new__(cls)
        points.shape = ny, nx = checked_shape(shape)
        points.columns, points.rows = np.arange(nx, dtype=float), np.arange(ny, dtype=float)
        points.x, points.y = np.tile(points.columns, ny), np.repeat(points.rows, nx)
        points.on_grid = points.whole = True
        return points

    def repeated(self, lead):
        """Columns and rows of the points for each of ``lead`` images, and the image's number."""
        n = math.prod(lead)
        return np.tile(self.x, n), np.tile(self.y, n), np.repeat(np.arange(n), self.x.size)

    def gather(self, images):
        """Values at the points from images on the grid, ``(..., ny, nx) -> (..., *shape)``."""
        if not self.whole:
            images = images[..., self._row, self._column]
            return images.reshape((*images.shape[:-1], *self.shape))
        return images.reshape((*images.shape[:-2], *self.shape))

    def apply(self, form, polynomials, **options):
        """Apply a `ClosedForm` with the options of its integrals: ``(..., *shape)``."""
        engine = partial(form.pixels, **options)
        if self.on_grid:
            return self.gather(engine(self.columns, self.rows, *form.parameters, *polynomials))
        # One pixel at the origin, with the star where it is as seen from each point.
        lead = np.broadcast_shapes(*map(np.shape, form.parameters))
        x_0, y_0, *others = (np.broadcast_to(p, lead)[..., np.newaxis] for p in form.parameters)
        origin = np.zeros(1)
        seen = x_0 - self.x, y_0 - self.y
        images = engine(origin, origin, *seen, *others, *polynomials)[..., 0, 0]
        return images.reshape((*images.shape[:-1], *self.shape))


def _spread(number, points):
    """Give numbers of shape (n,) the trailing axes of the points."""
    return np.reshape(number, np.shape(number) + (1,) * len(points.shape))


def integrate_density(term, points, evaluate=None):
    """Integrate the product of a term's factors, without its scale, over pixels by quadrature.

    ``evaluate(x, y, index)`` may take the place of the product of the densities. The images have
    the shape ``(..., *points.shape)``.
    """
    along_x, along_y = term.polynomials()
    lead = np.broadcast_shapes(*(factor.size for factor in term.densities), ())
    x, y, image = points.repeated(lead)
    # Charge diffuses into a pixel from those around it.
    sigma = term.diffusion
    reach = int(np.ceil(_DIFFUSION_REACH * sigma))
    near = np.arange(-reach, reach + 1)
    dx, dy = (np.repeat(d.ravel(), x.size) for d in np.meshgrid(near, near))
    x, y, image = (np.tile(values, near.size**2) for values in (x, y, image))
    x, y, units = x + dx, y + dy, []
    parts = [evaluate] if evaluate else [factor.evaluate for factor in term.densities]

    def integrand(u_at, v_at, index):
        shape = (-1, 1, 1)
        inside = np.broadcast_shapes(u_at.shape, v_at.shape)
        x_at = np.broadcast_to(x[index].reshape(shape) + u_at, inside)
        y_at = np.broadcast_to(y[index].reshape(shape) + v_at, inside)
        value = math.prod(part(x_at, y_at, image[index]) for part in parts)
        units.append(getattr(value, "unit", None))
        value = without_unit(value) * np.polynomial.polynomial.polyval(u_at, along_x)
        value = value * np.polynomial.polynomial.polyval(v_at, along_y)
        if not sigma:
            return value
        along_x_at = collected(u_at + dx[index].reshape(shape), sigma)[0]
        return value * along_x_at * collected(v_at + dy[index].reshape(shape), sigma)[0]

    scale = min((factor.scale for factor in term.densities), default=1.0)
    n = min(int(np.ceil(5 + 2.1 / min(scale, sigma or scale))), _MOST_NODES)
    squares = integrand, np.arange(image.size), np.zeros(image.size), np.zeros(image.size), 1.0, n
    totals = _rule(*squares)
    tolerance = _TOLERANCE * np.bincount(image, np.abs(totals))[image]
    integrals = _refined(*squares, totals, tolerance)
    integrals = integrals.reshape(near.size**2, *lead, *points.shape).sum(axis=0)
    return integrals if units[-1] is None else integrals * units[-1]


def integrate_term(term, points, method="auto"):
    """Integrate one term by a method of `integrate_pixels`: ``(..., *points.shape)``."""
    if not term.densities:
        means = [Polynomial(row).integ(lbnd=-0.5)(0.5) for row in term.polynomials()]
        return _spread(term.scale, points) * np.full(points.shape, np.prod(means))
    if any(is_pixel_integrated(factor.model) for factor in term.densities):
        return _spread(term.scale, points) * _already_integrated(term, points)
    form = None if method == "quadrature" else term.closed_form()
    if form is not None:
        images = points.apply(form, term.polynomials())
        factor = _spread(term.scale * form.flux, points)
        fits = np.broadcast_shapes(images.shape, np.shape(factor)) == images.shape
        in_place = fits and not isinstance(factor, u.Quantity)
        return np.multiply(images, factor, out=images if in_place else None)
    if method == "analytic":
        names = " * ".join(type(factor.model).__name__ for factor in term.densities)
        raise ValueError(f"no closed form for the integral of {names}: use method='auto'")
    return _spread(term.scale, points) * integrate_density(term, points)


def _already_integrated(term, points):
    """Values of a pixel-integrated model at the pixels' centers."""
    names = " * ".join(type(factor.model).__name__ for factor in term.densities)
    along_x, along_y = (np.trim_zeros(row, "b") for row in term.polynomials())
    if len(term.densities) > 1 or along_x.size > 1 or along_y.size > 1:
        raise ValueError(
            f"{names} is already integrated over pixels: multiplied by anything that varies "
            "within a pixel it has no meaning, because the product has to be integrated jointly. "
            "Use the density instead (BivariateGaussianPSF, GaussianPSF, MoffatPSF, ...)"
        )
    (factor,) = term.densities
    values = factor.evaluate(*points.repeated(factor.size))
    if isinstance(values, u.Quantity) and values.unit.is_equivalent(u.pixel**2):
        values = values / u.pixel**2
    response = np.sum(along_x) * np.sum(along_y)
    return response * values.reshape(*factor.size, *points.shape)


def integrate_pixels(model, shape=None, *, x=None, y=None, method="auto"):
    r"""Integrate a model over pixels.

    .. math:: f_{ij} = \int_{i-1/2}^{i+1/2} \int_{j-1/2}^{j+1/2} m(x, y)\, dy\, dx

    for any two-dimensional model or compound m. Products are integrated jointly: the integral of
    a PSF times a sensitivity (equation 1 of Saunders et al. 2019) is not the product of their
    integrals, which ignores the response within a pixel.

    Sums are taken apart, constants come out, and a Gaussian (`~scope_models.BivariateGaussianPSF`,
    `~astropy.modeling.functional_models.Gaussian2D`, photutils' GaussianPSF and
    CircularGaussianPSF) times any number of sensitivities is integrated in closed form, to about
    1e-12 of its flux. Everything else is integrated by Gauss-Legendre rules with a number of
    nodes that grows until two rules agree to 1e-11 of the flux in the image. The image is never
    oversampled.

    Parameters
    ----------
    model : `~astropy.modeling.Model`
        Model of two inputs and one output. Models whose values are fluxes of pixels already
        (`~scope_models.PRF`, photutils' PRFs) are evaluated at the pixels' centers. Parameters of
        shape ``(n,)`` give ``n`` images.
    shape : tuple of int, optional
        Shape (ny, nx) of an image whose pixels are all integrated.
    x, y : array_like, optional
        Columns and rows of the pixels instead, which broadcast. A number that is not an integer
        stands for the unit square around it, with the response of a pixel centered there.
    method : {"auto", "analytic", "quadrature"}, optional
        "analytic" raises where there is no closed form, "quadrature" uses none.

    Returns
    -------
    flux : `~numpy.ndarray` or `~astropy.units.Quantity`
        Flux per pixel, of shape ``shape`` or the common shape of x and y, after ``(n,)`` where
        parameters have that shape.

    Raises
    ------
    TypeError
        If model is not a model, or shape not two integers.
    ValueError
        If the model has other inputs or outputs, both or neither of shape and (x, y) are given, a
        pixel-integrated model is multiplied by something that varies within a pixel, or there is
        no closed form for ``method="analytic"``.

    Warns
    -----
    IntegrationWarning
        Where the quadrature has not converged because the model is not smooth.

    Examples
    --------
    >>> from scope_models import BivariateGaussianPSF, SensitivityPolynomial, integrate_pixels
    >>> core, wings = BivariateGaussianPSF(0.8), BivariateGaussianPSF(0.2, sigma_x=1.2, sigma_y=1.2)
    >>> model = (core + wings) * SensitivityPolynomial()
    >>> image = integrate_pixels(model, x=[-1, 0, 1], y=[0, 0, 0])
    >>> print(image.round(4))
    [0.1001 0.3908 0.1001]
    """
    if not isinstance(model, Model):
        raise TypeError(f"`model` must be an astropy model, got {type(model).__name__}")
    if model.n_inputs != 2 or model.n_outputs != 1 or len(model) != 1:
        raise ValueError(
            "`model` must have two inputs, one output and no model set axis, got "
            f"{model.n_inputs} inputs, {model.n_outputs} outputs, {len(model)} models"
        )
    checked_choice("method", method, ("auto", "analytic", "quadrature"))
    if (shape is None) == (x is None and y is None) or (x is None) != (y is None):
        raise ValueError("give either `shape`, or both `x` and `y`")
    points = PixelPoints(x, y) if shape is None else PixelPoints.from_shape(shape)
    terms = expand(model)
    for term in terms:
        for factor in term.densities:
            whole = [leaf for leaf in leaves(factor.model) if is_pixel_integrated(leaf)]
            if whole and whole[0] is not factor.model:
                raise ValueError(
                    f"{type(whole[0]).__name__} is already integrated over pixels and works in "
                    f"sums and times constants only, not in the operator '{factor.model.op}'"
                )
    return reduce(add, (integrate_term(term, points, method) for term in terms))


def _rule(integrand, index, corner_u, corner_v, size, n):
    """Integrals over squares of one size by a rule of n times n nodes."""
    nodes, weights = gauss_legendre(n)
    result = np.empty(index.size)
    step = max(1, _CHUNK // n**2)
    for start in range(0, index.size, step):
        part = slice(start, start + step)
        u = (corner_u[part, np.newaxis] + size * nodes)[:, np.newaxis, :]
        v = (corner_v[part, np.newaxis] + size * nodes)[:, :, np.newaxis]
        values = np.broadcast_to(integrand(u, v, index[part]), (u.shape[0], n, n))
        result[part] = (values @ weights) @ weights
    return result * size**2


def _refined(integrand, index, corner_u, corner_v, size, n, values, tolerance, depth=0):
    """Improve the integrals of ``integrand(u, v, index)`` over squares until their rules agree.

    The offsets from the centers of the squares ``index`` ``(m,)`` are u, ``(m, 1, k)``, and v,
    ``(m, k, 1)``. Every square is integrated by two rules; where they differ by more than the
    tolerance, the number of nodes grows by half, and beyond 48 per axis the square is cut into
    quarters. Squares that have not converged warn.
    """
    values = values.copy()
    active = np.arange(index.size)
    while active.size and n < _MOST_NODES:
        # From odd to even and back: two even rules agree on a step near their common center.
        n += int(n * _GROWTH - n) // 2 * 2 + 1
        better = _rule(integrand, index[active], corner_u[active], corner_v[active], size, n)
        change = np.abs(better - values[active])
        values[active] = better
        active = active[~(change <= tolerance[active])]
    if active.size == 0:
        return values
    if depth == _DEPTH or not np.all(np.isfinite(values[active])):
        which = f"the integral over {np.unique(index[active]).size} pixels"
        message = f"{which} has not converged: the model is not smooth there"
        warnings.warn(message, IntegrationWarning, stacklevel=5)
        return values
    first = max(8, _MOST_NODES // 4)
    values[active] = 0
    for du in (-0.25, 0.25):
        for dv in (-0.25, 0.25):
            u, v = corner_u[active] + du * size, corner_v[active] + dv * size
            inside = index[active], u, v, size / 2, first
            quarter = _rule(integrand, *inside)
            accuracy = quarter, tolerance[active] / 2, depth + 1
            values[active] += _refined(integrand, *inside, *accuracy)
    return values
