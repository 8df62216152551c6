"""Integration of models over pixels."""

import math
import warnings
from dataclasses import dataclass
from functools import partial, reduce
from operator import add

import numpy as np
from astropy import units as u
from astropy.modeling import CompoundModel, Model
from astropy.modeling.models import Const2D, Gaussian2D
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval
from scipy.special import erf

from scope_models._arrays import is_angle, plain_array, without_unit
from scope_models._checks import checked_choice, checked_shape
from scope_models.exceptions import IntegrationWarning
from scope_models.models._gaussian import gauss_legendre, gaussian_nodes, gaussian_pixels

__all__ = ["integrate_pixels"]

# Full width at half maximum of a normal density, in standard deviations.
_FWHM = 2 * np.sqrt(2 * np.log(2))
# photutils' Gaussians, and the names of their widths.
_GAUSSIANS = {"GaussianPSF": ("x_fwhm", "y_fwhm"), "CircularGaussianPSF": ("fwhm", "fwhm")}
# photutils' models whose values are fluxes of pixels, besides its PRFs.
_INTEGRATED_NAMES = {"ImagePSF", "GriddedPSFModel", "EPSFModel", "FittableImageModel"}
# Parameters that set the width of a density, and their ratio to a standard deviation.
_WIDTHS = dict.fromkeys(("sigma", "sigma_x", "sigma_y", "x_stddev", "y_stddev"), 1.0)
_WIDTHS |= dict.fromkeys(("fwhm", "x_fwhm", "y_fwhm"), _FWHM)
_WIDTHS |= {"gamma": 1.0, "alpha": 1.0, "radius": 3.0, "r_eff": 1.0}
_SCALE_OF_OTHERS = 0.3
# Pixels, in place of no diffusion: squares of quotients are finite.
_LEAST_DIFFUSION = 1e-100
# Standard deviations of the diffusion beyond which no charge of a pixel comes from.
_DIFFUSION_REACH = 7.0
# Change between two rules, as part of an image's flux, of pixels that have converged.
_TOLERANCE = 1e-11
# Growth of the number of nodes from rule to rule, and the number that cuts a pixel.
_GROWTH = 1.5
_MOST_NODES = 48
# Pixels are cut into quarters at most this often.
_DEPTH = 8
# Evaluations of the integrand held in memory at a time.
_CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Integral of a density over pixels without quadrature: of a model's ``closed_form(values)``.

    ``pixels(x, y, *parameters, along_x, along_y)``, with columns, rows and the polynomial response
    along the axes, returns images ``(..., ny, nx)`` of unit flux; with ``derivatives=True`` the
    same and those by ``names``, if there are any, on a new first axis.
    """

    flux: object  # integral over the plane
    parameters: tuple  # numbers or arrays in pixels, x_0 and y_0 first
    pixels: object
    names: tuple = ()  # parameters of the model


def closed_form(model, values):
    """Return the `ClosedForm` of a density at values of its parameters, or None."""
    if hasattr(model, "closed_form"):
        return model.closed_form(values)
    theta = values.get("theta", 0.0)
    if isinstance(model, Gaussian2D):
        names, unit = ("x_mean", "y_mean", "x_stddev", "y_stddev"), u.rad
        x_0, y_0, long, wide = (pixels_of(values[name]) for name in names)
        flux = values["amplitude"] * (2 * np.pi * long * wide)
        if isinstance(values["x_mean"], u.Quantity):
            flux = flux * values["x_mean"].unit ** 2
    elif _is_photutils(model) and type(model).__name__ in _GAUSSIANS:
        names, unit = ("x_0", "y_0", *_GAUSSIANS[type(model).__name__]), u.deg
        x_0, y_0, long, wide = (pixels_of(values[name]) for name in names)
        flux, long, wide = values["flux"], long / _FWHM, wide / _FWHM
    else:
        return None
    angle = u.Quantity(theta, unit).to_value(u.rad)
    cos, sin = np.cos(angle), np.sin(angle)
    sigma_x, sigma_y = np.hypot(long * cos, wide * sin), np.hypot(long * sin, wide * cos)
    rho = (long**2 - wide**2) * sin * cos / (sigma_x * sigma_y)
    return ClosedForm(flux, (x_0, y_0, sigma_x, sigma_y, rho), gaussian_pixels)


def _diffused(form, variance):
    """Convolve a closed form with a circular Gaussian; the last slope is by variance."""
    if form.pixels is not gaussian_pixels:
        return None
    x_0, y_0, sigma_x, sigma_y, rho = form.parameters
    wide, tall = np.sqrt(sigma_x**2 + variance), np.sqrt(sigma_y**2 + variance)
    narrowed = sigma_x * sigma_y / (wide * tall)
    parameters = (x_0, y_0, wide, tall, rho * narrowed)

    def pixels(*arguments, derivatives=False):
        if not derivatives:
            return form.pixels(*arguments)
        image, by_x, by_y, by_wide, by_tall, by_tilt = form.pixels(*arguments, derivatives=True)
        turned = by_tilt * rho * narrowed
        by_sigma_x = by_wide * sigma_x / wide + turned * (1 / sigma_x - sigma_x / wide**2)
        by_sigma_y = by_tall * sigma_y / tall + turned * (1 / sigma_y - sigma_y / tall**2)
        by_variance = by_wide / wide + by_tall / tall - turned * (1 / wide**2 + 1 / tall**2)
        parts = [image, by_x, by_y, by_sigma_x, by_sigma_y, by_tilt * narrowed, by_variance / 2]
        return np.stack(np.broadcast_arrays(*parts))

    return ClosedForm(form.flux, parameters, pixels, form.names and (*form.names, "variance"))


def value_of(parameter):
    return parameter.value if parameter.unit is None else parameter.quantity


def numbers_of(model):
    return {name: float(np.ravel(getattr(model, name).value)[0]) for name in model.param_names}


def pixels_of(value):
    return value.to_value(u.pixel) if isinstance(value, u.Quantity) else value


def one_number(name, value):
    """Return the one value of an array that holds the same number everywhere."""
    value = np.reshape(value, -1)
    if value.size > 1 and np.ptp(value):
        raise ValueError(f"`{name}` must be one number, got {np.unique(value).size} values")
    return value[0]


def _is_photutils(model):
    return any(base.__module__.startswith("photutils.") for base in type(model).__mro__)


@dataclass(frozen=True, eq=False)
class Factor:
    """A model with the numbers ``(n,)`` or quantities of its parameters."""

    model: object
    values: dict

    @classmethod
    def of(cls, model):
        names = model.param_names if isinstance(model, CompoundModel) else ()
        if any(np.ndim(getattr(model, name).value) for name in names):
            raise ValueError(
                f"parameters with more than one value work in sums and products of models, "
                f"not in the operator '{model.op}'"
            )
        values = {}
        for name in model.param_names:
            parameter = getattr(model, name)
            if name != "theta" and is_angle(parameter.unit):
                plain_array(parameter.quantity, u.pix, name)  # refuses angles by name
            values[name] = value_of(parameter)
        return cls(model, values)

    @property
    def size(self):
        """Number of values per parameter: () or (n,)."""
        return np.broadcast_shapes(*(np.shape(v) for v in self.values.values()))

    @property
    def scale(self):
        """Smallest width in pixels, as far as parameters' names show it."""
        known = [(_WIDTHS[name], value) for name, value in self.values.items() if name in _WIDTHS]
        widths = [np.min(np.abs(pixels_of(value))) / ratio for ratio, value in known]
        if not widths:
            return _SCALE_OF_OTHERS
        rho = np.max(np.abs(self.values.get("rho", 0.0)))
        return max(float(min(widths) * np.sqrt(1 - rho**2)), 1e-3)

    def evaluate(self, x, y, index):
        """Value at positions ``(m, ...)`` in pixels, for the m values of parameters at ``index``.

        A unit is that of the density times square pixels.
        """
        shape = (-1,) + (1,) * (np.ndim(x) - 1)
        values = [v if np.ndim(v) == 0 else v[index].reshape(shape) for v in self.values.values()]
        units = self.model.input_units
        if units and any(units.values()):
            x, y = x * u.pixel, y * u.pixel
        result = self.model.evaluate(x, y, *values)
        if isinstance(result, u.Quantity) and isinstance(x, u.Quantity):
            result = result * u.pixel**2
        return result


@dataclass(frozen=True, eq=False)
class Term:
    """A product: a scale that is constant over the pixels, densities, and sensitivities."""

    scale: object = 1.0
    densities: tuple = ()
    sensitivities: tuple = ()  # SensitivityPolynomial and DiffusionSensitivity

    def __mul__(self, other):
        densities = self.densities + other.densities
        return Term(self.scale * other.scale, densities, self.sensitivities + other.sensitivities)

    def closed_form(self):
        """The closed form of the product, or None."""
        if len(self.densities) != 1:
            return None
        form = closed_form(self.densities[0].model, self.densities[0].values)
        if form is None or not self.diffusion:
            return form
        flat = all(np.trim_zeros(row, "b").size <= 1 for row in self.polynomials())
        return _diffused(form, self.diffusion**2) if flat else None

    @property
    def diffusion(self):
        """Standard deviation along each axis with which charge diffuses, pixels."""
        sigmas = [f.values["sigma_d"] for f in self.sensitivities if "sigma_d" in f.values]
        return math.hypot(*(np.ravel(pixels_of(s))[0] for s in sigmas))

    def polynomials(self):
        """Coefficients along x and along y of the product of all sensitivities."""
        factors = [f.values.items() for f in self.sensitivities if "sigma_d" not in f.values]
        products = []
        for axis in "xy":
            rows = ([float(v) for name, v in values if name[1] == axis] for values in factors)
            products.append(reduce(np.convolve, rows, np.ones(1)))
        return products


def is_pixel_integrated(model):
    """Whether a model's values are fluxes of pixels."""
    own = getattr(model, "pixel_integrated", None)
    if own is not None:
        return own
    names = {base.__name__ for base in type(model).__mro__}
    known = names & _INTEGRATED_NAMES or type(model).__name__.endswith("PRF")
    return _is_photutils(model) and bool(known)


def expand(model):
    """The terms whose sum a model is; other operators are left whole."""
    if isinstance(model, CompoundModel):
        if model.op == "+":
            return expand(model.left) + expand(model.right)
        if model.op == "-":
            return expand(model.left) + [Term(scale=-1.0) * t for t in expand(model.right)]
        if model.op == "*":
            left, right = expand(model.left), expand(model.right)
            return [a * b for a in left for b in right]
    if isinstance(model, Const2D):
        return [Term(scale=value_of(model.amplitude))]
    if hasattr(model, "powers"):  # a sensitivity
        return [Term(sensitivities=(Factor.of(model),))]
    # A PRF that is nothing but a table stands for it.
    table = getattr(model, "table", None)
    return [Term(densities=(Factor.of(model if table is None else table),))]


class PixelPoints:
    """Pixel centers, which broadcast, and the grid that they lie on."""

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
        self.shape, self.x, self.y = x.shape, x.ravel(), y.ravel()
        self.columns, column = np.unique(self.x, return_inverse=True)
        self.rows, row = np.unique(self.y, return_inverse=True)
        size = self.columns.size * self.rows.size
        # Scattered points are better done one by one.
        self.on_grid = size <= 4 * self.x.size
        place = row * self.columns.size + column
        whole = size == place.size and np.all(place == np.arange(size))
        self.place = slice(None) if whole else place

    @classmethod
    def from_shape(cls, shape):
        """All pixels of an image of shape (ny, nx)."""
        points = cls.__new__(cls)
        points.shape = ny, nx = checked_shape(shape)
        points.columns, points.rows = np.arange(nx, dtype=float), np.arange(ny, dtype=float)
        points.x, points.y = np.tile(points.columns, ny), np.repeat(points.rows, nx)
        points.on_grid, points.place = True, slice(None)
        return points

    def repeated(self, lead):
        """Columns, rows and the image's number, for each of ``lead`` images."""
        n = math.prod(lead)
        return np.tile(self.x, n), np.tile(self.y, n), np.repeat(np.arange(n), self.x.size)

    def apply(self, form, polynomials, **options):
        """Apply a `ClosedForm` with the options of its integrals: ``(..., *shape)``."""
        engine = partial(form.pixels, **options)
        if self.on_grid:
            images = engine(self.columns, self.rows, *form.parameters, *polynomials)
            images = images.reshape((*images.shape[:-2], -1))[..., self.place]
        else:
            # One pixel at the origin, with the star where it is as seen from each point.
            lead = np.broadcast_shapes(*map(np.shape, form.parameters))
            x_0, y_0, *others = (np.broadcast_to(p, lead)[..., np.newaxis] for p in form.parameters)
            origin, seen = np.zeros(1), (x_0 - self.x, y_0 - self.y)
            images = engine(origin, origin, *seen, *others, *polynomials)[..., 0, 0]
        return images.reshape((*images.shape[:-1], *self.shape))


def _spread(number, points):
    """Give numbers ``(n,)`` the trailing axes of the points."""
    return np.reshape(number, np.shape(number) + (1,) * len(points.shape))


def integrate_density(term, points, evaluate=None):
    """Integrate a term without its scale by quadrature: ``(..., *points.shape)``.

    ``evaluate(x, y, index)`` may take the place of the product of the densities.
    """
    along_x, along_y = term.polynomials()
    lead = np.broadcast_shapes(*(factor.size for factor in term.densities), ())
    # Charge diffuses into a pixel from those around it.
    sigma = term.diffusion
    reach = int(np.ceil(_DIFFUSION_REACH * sigma))
    near = np.arange(-reach, reach + 1)
    x, y, image = (np.tile(values, near.size**2) for values in points.repeated(lead))
    dx, dy = (np.repeat(d, x.size // near.size**2) for d in np.meshgrid(near, near))
    x, y, units = x + dx, y + dy, []
    parts = [evaluate] if evaluate else [factor.evaluate for factor in term.densities]

    def integrand(u_at, v_at, index):
        shape = (-1, 1, 1)
        inside = np.broadcast_shapes(u_at.shape, v_at.shape)
        x_at = np.broadcast_to(x[index].reshape(shape) + u_at, inside)
        y_at = np.broadcast_to(y[index].reshape(shape) + v_at, inside)
        value = math.prod(part(x_at, y_at, image[index]) for part in parts)
        units.append(getattr(value, "unit", None))
        value = without_unit(value) * polyval(u_at, along_x) * polyval(v_at, along_y)
        if not sigma:
            return value
        along_x_at = collected(u_at + dx[index].reshape(shape), sigma)[0]
        return value * along_x_at * collected(v_at + dy[index].reshape(shape), sigma)[0]

    scale = min((factor.scale for factor in term.densities), default=1.0)
    n = min(gaussian_nodes(min(scale, sigma or scale), 0), _MOST_NODES)
    integrals = _converged(integrand, image, n)
    integrals = integrals.reshape(near.size**2, *lead, *points.shape).sum(axis=0)
    return integrals if units[-1] is None else integrals * units[-1]


def integrate_term(term, points, method="auto"):
    """Integrate one term by a method of `integrate_pixels`: ``(..., *points.shape)``."""
    names = " * ".join(type(factor.model).__name__ for factor in term.densities)
    if not term.densities:
        means = [Polynomial(row).integ(lbnd=-0.5)(0.5) for row in term.polynomials()]
        images = np.full(points.shape, np.prod(means))
    elif any(is_pixel_integrated(factor.model) for factor in term.densities):
        images = _already_integrated(term, points, names)
    elif method != "quadrature" and (form := term.closed_form()) is not None:
        images = points.apply(form, term.polynomials())
        factor = _spread(term.scale * form.flux, points)
        fits = np.broadcast_shapes(images.shape, np.shape(factor)) == images.shape
        in_place = fits and not isinstance(factor, u.Quantity)
        return np.multiply(images, factor, out=images if in_place else None)
    elif method == "analytic":
        raise ValueError(f"no closed form for the integral of {names}: use method='auto'")
    else:
        images = integrate_density(term, points)
    return _spread(term.scale, points) * images


def collected(offset, sigma):
    """Part of the charge at an offset that a pixel collects along an axis; its slope by sigma."""
    offset, sigma = np.asarray(offset, dtype=float), max(sigma, _LEAST_DIFFUSION)
    scaled = np.stack([offset + 0.5, offset - 0.5]) / (np.sqrt(2) * sigma)
    part = 0.5 * (erf(scaled[0]) - erf(scaled[1]))
    slope = scaled * np.exp(-(scaled**2)) / (np.sqrt(np.pi) * sigma)
    return part, slope[1] - slope[0]


def _already_integrated(term, points, names):
    """Values of a pixel-integrated model at the pixels' centers."""
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
    integrals.

    A Gaussian (`~scope_models.BivariateGaussianPSF`,
    `~astropy.modeling.functional_models.Gaussian2D`, photutils' GaussianPSF and
    CircularGaussianPSF) times any number of sensitivities is integrated in closed form, to about
    1e-12 of its flux. Everything else is integrated by Gauss-Legendre rules with a number of
    nodes that grows until two rules agree to 1e-11 of the flux in the image.

    Parameters
    ----------
    model : `~astropy.modeling.Model`
        Model of two inputs and one output. Fluxes of pixels (`~scope_models.PRF`, photutils' PRFs)
        are evaluated at the pixels' centers. Parameters of shape ``(n,)`` give ``n`` images.
    shape : tuple of int, optional
        Shape (ny, nx) of an image whose pixels are all integrated.
    x, y : array_like, optional
        Columns and rows of the pixels instead, which broadcast; off the integers, of unit squares
        with the response of a pixel centered there.
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
        If the model has other inputs or outputs, both or neither of shape and (x, y) are given,
        fluxes of pixels are multiplied by something that varies within a pixel, or "analytic" finds
        no closed form.

    Warns
    -----
    IntegrationWarning
        Where the quadrature has not converged.

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
            if not isinstance(factor.model, CompoundModel):
                continue
            whole = list(filter(is_pixel_integrated, factor.model.traverse_postorder()))
            if whole:
                raise ValueError(
                    f"{type(whole[0]).__name__} is already integrated over pixels and works in "
                    f"sums and times constants only, not in the operator '{factor.model.op}'"
                )
    return reduce(add, (integrate_term(term, points, method) for term in terms))


def _rule(integrand, index, center_u, center_v, size, n):
    """Integrals over squares of one size by a rule of n times n nodes."""
    nodes, weights = gauss_legendre(n)
    result = np.empty(index.size)
    step = max(1, _CHUNK // n**2)
    for start in range(0, index.size, step):
        part = slice(start, start + step)
        u = (center_u[part, np.newaxis] + size * nodes)[:, np.newaxis, :]
        v = (center_v[part, np.newaxis] + size * nodes)[:, :, np.newaxis]
        values = np.broadcast_to(integrand(u, v, index[part]), (u.shape[0], n, n))
        result[part] = (values @ weights) @ weights
    return result * size**2


def _converged(integrand, image, n):
    """Integrals of ``integrand(u, v, index)`` over pixels of images of these numbers ``(m,)``.

    The offsets from the centers of the pixels ``index`` ``(k,)`` are u, ``(k, 1, n)``, and v,
    ``(k, n, 1)``. Where two rules differ by more than the tolerance, the number of nodes grows by
    half, and beyond 48 per axis the square is cut into quarters.
    """
    index, size, integrals = np.arange(image.size), 1.0, np.zeros(image.size)
    center_u, center_v = np.zeros((2, image.size))
    for depth in range(_DEPTH + 1):
        values = _rule(integrand, index, center_u, center_v, size, n)
        if depth == 0:
            tolerance = _TOLERANCE * np.bincount(image, np.abs(values))[image]
        active = np.arange(index.size)
        while active.size and n < _MOST_NODES:
            # From odd to even and back: two even rules agree on a step near their common center.
            n += int(n * _GROWTH - n) // 2 * 2 + 1
            better = _rule(integrand, index[active], center_u[active], center_v[active], size, n)
            change = np.abs(better - values[active])
            values[active] = better
            active = active[~(change <= tolerance[active])]
        cut = active.size and depth < _DEPTH and np.isfinite(values[active]).all()
        if cut:
            values[active] = 0
        integrals += np.bincount(index, values, integrals.size)
        if not cut:
            break
        index, tolerance = np.tile(index[active], 4), np.tile(tolerance[active] / 2, 4)
        center_u, center_v = (
            np.concatenate([center[active] + sign * size / 4 for sign in signs])
            for center, signs in ((center_u, (-1, -1, 1, 1)), (center_v, (-1, 1, -1, 1)))
        )
        size, n = size / 2, max(8, _MOST_NODES // 4)
    if active.size:
        which = f"the integral over {np.unique(index[active]).size} pixels"
        message = f"{which} has not converged: the model is not smooth there"
        warnings.warn(message, IntegrationWarning, stacklevel=6)
    return integrals
