"""The sum-of-products form of a compound model, and which products integrate in closed form."""

import math
from dataclasses import dataclass

import numpy as np
from astropy import units as u
from astropy.modeling import CompoundModel
from astropy.modeling.models import Const2D, Gaussian2D

from scope_models._arrays import is_angle, plain_array
from scope_models.models._gaussian import gaussian_pixels
from scope_models.models._parameters import value_of
from scope_models.models.sensitivity import DiffusionSensitivity, SensitivityPolynomial

__all__ = [
    "ClosedForm", "Factor", "Term", "closed_form", "expand", "is_pixel_integrated", "leaves",
    "one_number", "pixels_of",
]  # fmt: skip

# Full width at half maximum of a normal density, in standard deviations.
_FWHM = 2 * np.sqrt(2 * np.log(2))
# photutils' Gaussians, and the names of their widths.
_GAUSSIANS = {"GaussianPSF": ("x_fwhm", "y_fwhm"), "CircularGaussianPSF": ("fwhm", "fwhm")}
# photutils' models whose values are fluxes of pixels; its names for densities end in PSF.
_INTEGRATED_NAMES = {"ImagePSF", "GriddedPSFModel", "EPSFModel", "FittableImageModel"}
# Parameters that set the width of a density, and their ratio to a standard deviation.
_WIDTHS = dict.fromkeys(("sigma", "sigma_x", "sigma_y", "x_stddev", "y_stddev"), 1.0)
_WIDTHS |= dict.fromkeys(("fwhm", "x_fwhm", "y_fwhm"), _FWHM)
_WIDTHS |= {"gamma": 1.0, "alpha": 1.0, "radius": 3.0, "r_eff": 1.0}
_SCALE_OF_OTHERS = 0.3


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Integral of a density over pixels without quadrature.

    A model has one by a method ``closed_form(values)``; so have the Gaussians of astropy and
    photutils. ``pixels(x, y, *parameters, along_x, along_y)``, with columns, rows and the
    polynomial response along the axes, returns images ``(..., ny, nx)`` of unit flux; with
    ``derivatives=True`` the same and those by ``names``, if there are any, on a new first axis.
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
        tilt = rho * narrowed
        by_sigma_x = by_wide * sigma_x / wide + by_tilt * tilt * (1 / sigma_x - sigma_x / wide**2)
        by_sigma_y = by_tall * sigma_y / tall + by_tilt * tilt * (1 / sigma_y - sigma_y / tall**2)
        by_variance = by_wide / wide + by_tall / tall - by_tilt * tilt * (1 / wide**2 + 1 / tall**2)
        parts = [image, by_x, by_y, by_sigma_x, by_sigma_y, by_tilt * narrowed, by_variance / 2]
        return np.stack(np.broadcast_arrays(*parts))

    return ClosedForm(form.flux, parameters, pixels, form.names and (*form.names, "variance"))


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
    """A model with the numbers ``(n,)`` or quantities, by parameter, to evaluate it with."""

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
        """Number of values per parameter: () for one, (n,) for n."""
        return np.broadcast_shapes(*(np.shape(v) for v in self.values.values()))

    @property
    def scale(self):
        """Smallest width in pixels, as far as the parameters' names show it."""
        known = [(_WIDTHS[name], value) for name, value in self.values.items() if name in _WIDTHS]
        widths = [np.min(np.abs(pixels_of(value))) / ratio for ratio, value in known]
        if not widths:
            return _SCALE_OF_OTHERS
        rho = np.max(np.abs(self.values.get("rho", 0.0)))
        return max(float(min(widths) * np.sqrt(1 - rho**2)), 1e-3)

    def evaluate(self, x, y, index):
        """Value of the model at positions ``(m, ...)`` in pixels.

        ``index`` chooses the value of each parameter that belongs to each of the m entries. A unit
        is that of the density times square pixels.
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
        """Standard deviation along each axis with which charge diffuses, pixels; 0 for none."""
        sigmas = [f.values["sigma_d"] for f in self.sensitivities if "sigma_d" in f.values]
        return math.hypot(*(np.ravel(pixels_of(s))[0] for s in sigmas))

    def polynomials(self):
        """Coefficients along x and along y of the product of all sensitivities."""
        along_x, along_y = np.ones(1), np.ones(1)
        for factor in self.sensitivities:
            if "sigma_d" in factor.values:
                continue
            numbers = {name: float(value) for name, value in factor.values.items()}
            along_x = np.convolve(along_x, [v for name, v in numbers.items() if name[1] == "x"])
            along_y = np.convolve(along_y, [v for name, v in numbers.items() if name[1] == "y"])
        return along_x, along_y


def is_pixel_integrated(model):
    """Whether a model's values are fluxes of pixels, as of a PRF or an image of photutils."""
    own = getattr(model, "pixel_integrated", None)
    if own is not None:
        return own
    names = {base.__name__ for base in type(model).__mro__}
    known = names & _INTEGRATED_NAMES or type(model).__name__.endswith("PRF")
    return _is_photutils(model) and bool(known)


def leaves(model):
    """The models that a compound is made of, from left to right."""
    if isinstance(model, CompoundModel):
        return leaves(model.left) + leaves(model.right)
    return [model]


def expand(model):
    """The terms whose sum a model is; operators but ``+``, ``-`` and ``*`` are left whole."""
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
    if isinstance(model, (SensitivityPolynomial, DiffusionSensitivity)):
        return [Term(sensitivities=(Factor.of(model),))]
    # A PRF that is nothing but a table stands for it.
    table = getattr(model, "table", None)
    return [Term(densities=(Factor.of(model if table is None else table),))]
