"""The sum-of-products form of a compound model, which is then integrated."""

import math
from dataclasses import dataclass, replace

import numpy as np
from astropy import units as u
from astropy.modeling import CompoundModel
from astropy.modeling.models import Const2D

from scope_models._arrays import is_angle, plain_array
from scope_models.models._closed_form import FWHM, closed_form, diffused, is_photutils, pixels_of
from scope_models.models._parameters import value_of
from scope_models.models.sensitivity import DiffusionSensitivity, SensitivityPolynomial

__all__ = ["Factor", "Term", "expand", "is_pixel_integrated", "leaves"]

# photutils' models whose values are fluxes of pixels; its names for densities end in PSF.
_INTEGRATED_NAMES = {"ImagePSF", "GriddedPSFModel", "EPSFModel", "FittableImageModel"}
# Parameters that set the width of a density, and their ratio to a standard deviation.
_WIDTHS = dict.fromkeys(("sigma", "sigma_x", "sigma_y", "x_stddev", "y_stddev"), 1.0)
_WIDTHS |= dict.fromkeys(("fwhm", "x_fwhm", "y_fwhm"), FWHM)
_WIDTHS |= {"gamma": 1.0, "alpha": 1.0, "radius": 3.0, "r_eff": 1.0}
_SCALE_OF_OTHERS = 0.3


@dataclass(frozen=True, eq=False)
class Factor:
    """A model with the numbers ``(n,)`` or quantities, by parameter, to evaluate it with."""

    model: object
    values: dict

    @classmethod
    def of(cls, model):
        """The factor that holds a model's present parameters."""
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
            values[name] = np.asarray(parameter.value)
            if parameter.unit is not None:
                values[name] = values[name] * parameter.unit
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
        """The product of two terms is a term."""
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
        return diffused(form, self.diffusion**2) if flat else None

    @property
    def diffusion(self):
        """Standard deviation along each axis with which charge diffuses, pixels; 0 for none."""
        sigmas = [f.values["sigma_d"] for f in self.sensitivities if "sigma_d" in f.values]
        return math.hypot(*(np.ravel(pixels_of(s))[0] for s in sigmas))

    def undiffused(self):
        """The product without diffusion."""
        others = tuple(f for f in self.sensitivities if "sigma_d" not in f.values)
        return replace(self, sensitivities=others)

    def polynomials(self):
        """Coefficients along x and along y of the product of all sensitivities."""
        along_x, along_y = np.ones(1), np.ones(1)
        for factor in self.sensitivities:
            if "sigma_d" in factor.values:
                continue
            names, numbers = list(factor.values), [float(v) for v in factor.values.values()]
            n_x = names.index("ay0")
            along_x = np.convolve(along_x, numbers[:n_x])
            along_y = np.convolve(along_y, numbers[n_x:])
        return along_x, along_y


def is_pixel_integrated(model):
    """Whether a model's values are fluxes of pixels, as of a PRF or an image of photutils."""
    own = getattr(model, "pixel_integrated", None)
    if own is not None:
        return own
    names = {base.__name__ for base in type(model).__mro__}
    known = names & _INTEGRATED_NAMES or type(model).__name__.endswith("PRF")
    return is_photutils(model) and bool(known)


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
