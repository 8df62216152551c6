"""Parameters of models: made per instance, and checked where they enter."""

import numpy as np
from astropy import units as u
from astropy.modeling import Fittable2DModel, Parameter
from astropy.units import UnitsError

from scope_models._arrays import is_angle, plain_array, without_unit

__all__ = [
    "StarModel", "check_domain", "check_model_parameters", "gaussian_box", "make_coefficients",
    "make_parameters", "numbers_of", "value_of",
]  # fmt: skip


class StarModel(Fittable2DModel):
    """A star: its flux and position, and their units."""

    flux = Parameter(default=1.0, description="Flux of the star")
    x_0 = Parameter(default=0.0, description="Column of the star (pixel)")
    y_0 = Parameter(default=0.0, description="Row of the star (pixel)")

    #: Whether values are fluxes of pixels, not a density.
    pixel_integrated = False

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        check_model_parameters(self)
        self._check_units()

    def _check_units(self):
        """Raise unless lengths are pixels or angles, and others but the flux have no unit."""
        for name in self.param_names[1:]:
            parameter, is_length = getattr(self, name), name in self._lengths
            if parameter.unit is not None and not (is_length and is_angle(parameter.unit)):
                plain_array(parameter.quantity, u.pix if is_length else u.one, name)

    @property
    def _lengths(self):
        """Parameters in the unit of x and y."""
        kinds = getattr(self, "parameter_kinds", {})
        return ("x_0", "y_0", *(n for n, kind in kinds.items() if kind in {"width", "offset"}))

    @property
    def input_units(self):
        """Units of x and y, or None."""
        unit = self.x_0.input_unit
        return unit and {self.inputs[0]: unit, self.inputs[1]: self.y_0.input_unit}

    def _parameter_units_for_data_units(self, inputs_unit, outputs_unit):
        unit, other = (inputs_unit[name] for name in self.inputs)
        if unit != other:
            raise UnitsError("units of x and y must be the same")
        flux = outputs_unit[self.outputs[0]] * (1 if self.pixel_integrated else unit**2)
        return {"flux": flux, **dict.fromkeys(self._lengths, unit)}


def make_parameters(model, parameters):
    """Give a model own parameters before its ``__init__``."""
    for parameter in parameters:
        parameter.model = model
        model.__dict__[parameter.name] = parameter
    names = (parameter.name for parameter in parameters)
    model.param_names = tuple(dict.fromkeys((*model.param_names, *names)))


def make_coefficients(model, order, function):
    """Give a model the coefficients ``c_k_m`` up to an order k + m; return all (k, m)."""
    places = [(n - m, m) for n in range(1, order + 1) for m in range(n + 1)]
    text = f"Coefficient of {function}_{{}} {function}_{{}}"
    coefficients = [
        Parameter(f"c_{k}_{m}", default=0.0, description=text.format(k, m)) for k, m in places
    ]
    make_parameters(model, coefficients)
    return places


def value_of(parameter):
    return parameter.value if parameter.unit is None else parameter.quantity


def numbers_of(model):
    return {name: float(np.ravel(getattr(model, name).value)[0]) for name in model.param_names}


def gaussian_box(model, factor):
    """Rectangle of a half-width of so many sigma_x and sigma_y."""
    d_x, d_y = factor * model.sigma_x, factor * model.sigma_y
    return ((model.y_0 - d_y, model.y_0 + d_y), (model.x_0 - d_x, model.x_0 + d_x))


_TESTS = {
    "finite": np.isfinite,
    "positive": lambda value: np.isfinite(value) & (value > 0),
    "inside (-1, 1)": lambda value: np.abs(value) < 1,
    "from -1 to 1": lambda value: np.abs(value) <= 1,
    "at least 0": lambda value: np.isfinite(value) & (value >= 0),
    "at least 0 and below 1": lambda value: (value >= 0) & (value < 1),
}


def check_domain(name, condition, _model, value):
    """Raise where a value of a parameter lies outside its domain; the model is not used."""
    value = np.asarray(without_unit(value), dtype=float)
    wrong = ~_TESTS[condition](value)
    if np.any(wrong):
        raise ValueError(f"`{name}` must be {condition}, got {value[wrong].flat[0]}")


def check_model_parameters(model):
    """Raise where a parameter of a model is not finite or outside its domain."""
    for name in model.param_names:
        parameter = getattr(model, name)
        check_domain(name, "finite", model, parameter.value)
        parameter.validate(parameter.value)
        # photutils sets all parameters to 1 for a moment.
        if getattr(model, "parameter_kinds", {}).get(name) == "correlation":
            check_domain(name, "inside (-1, 1)", model, parameter.value)
