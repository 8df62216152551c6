# Licensed under a 3-clause BSD style license - see LICENSE
"""Parameters of models: made per instance, and checked where they enter."""

from dataclasses import dataclass

import numpy as np
from astropy import units as u
from astropy.modeling import Parameter

from scope_models._arrays import is_angle, plain_array, without_unit

__all__ = [
    "Domain",
    "InstanceParameters",
    "check_model_parameters",
    "check_psf_units",
    "described",
    "one_number",
]


class InstanceParameters:
    """Mixin of models whose number of parameters depends on their arguments.

    It stands before the astropy class among the bases. A subclass calls `make_parameters` before
    ``super().__init__``.
    """

    # Filled in by each instance.
    _param_names = ()

    def make_parameters(self, parameters):
        """Give this instance its own parameters, after those of its class."""
        self._param_names = (*self._param_names, *(p.name for p in parameters))
        for parameter in parameters:
            parameter.model = self
            self.__dict__[parameter.name] = parameter

    @property
    def param_names(self):
        """Names of the parameters, in their order (tuple of str)."""
        return self._param_names


def described(name, description, **constraints):
    """Return a parameter of default 0 with a description."""
    return Parameter(name, default=0.0, description=description, **constraints)


_TESTS = {
    "finite": np.isfinite,
    "positive": lambda value: np.isfinite(value) & (value > 0),
    "inside (-1, 1)": lambda value: np.abs(value) < 1,
    "at least 0": lambda value: np.isfinite(value) & (value >= 0),
    "at least 0 and below 1": lambda value: (value >= 0) & (value < 1),
}


@dataclass(frozen=True)
class Domain:
    """Validator of a parameter; a class, so that models that hold it can be pickled."""

    name: str
    condition: str

    def __call__(self, model, value):  # noqa: ARG002
        """Raise where a value lies outside the domain; the model is not used."""
        value = np.asarray(without_unit(value), dtype=float)
        wrong = ~_TESTS[self.condition](value)
        if np.any(wrong):
            raise ValueError(f"`{self.name}` must be {self.condition}, got {value[wrong].flat[0]}")


def check_model_parameters(model):
    """Raise where a parameter of a model is not finite or outside its domain."""
    for name in model.param_names:
        parameter = getattr(model, name)
        Domain(name, "finite")(model, parameter.value)
        parameter.validate(parameter.value)


def check_psf_units(model):
    """Raise where a parameter of a PSF has a unit that it cannot have.

    Positions and widths are pixels or angles, the flux has any unit, all else none.
    """
    for name in model.param_names:
        unit = getattr(model, name).unit
        if unit is None or name == "flux":
            continue
        lengths = name in {"x_0", "y_0", "sigma_x", "sigma_y"}
        if not (lengths and is_angle(unit)):
            plain_array(getattr(model, name).quantity, u.pix if lengths else u.one, name)


def one_number(name, value):
    """Return the one value of an array that holds the same number everywhere."""
    value = np.reshape(value, -1)
    if value.size > 1 and np.ptp(value):
        raise ValueError(f"`{name}` must be one number, got {np.unique(value).size} values")
    return value[0]
