# Licensed under a 3-clause BSD style license - see LICENSE
"""Models as what JSON can hold, and back."""

import importlib
import operator
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np
from astropy.modeling import CompoundModel, Model

from scope_models.models.sensitivity import SensitivityPolynomial

__all__ = ["describe_model", "equal_values", "make_model"]

_OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul}
# Modules that reading a file may import; others must have been imported before.
_TRUSTED = {"scope_models", "astropy", "photutils"}


def describe_model(model):
    """Return a model as the names of its classes and the values of its parameters."""
    if model is None:
        return None
    if isinstance(model, CompoundModel):
        left, right = describe_model(model.left), describe_model(model.right)
        return {"operator": model.op, "left": left, "right": right}
    described = {
        "module": type(model).__module__,
        "class": type(model).__qualname__,
        "parameters": {
            name: np.asarray(getattr(model, name).value).tolist() for name in model.param_names
        },
    }
    if isinstance(model, SensitivityPolynomial):
        described["parameters"] = {
            "x_coefficients": list(model.x_coefficients),
            "y_coefficients": list(model.y_coefficients),
        }
    return described


def make_model(described):
    """Return the model of a description."""
    if described is None:
        return None
    if "operator" in described:
        combine = _OPERATORS[described["operator"]]
        return combine(make_model(described["left"]), make_model(described["right"]))
    module = described["module"]
    if module not in sys.modules and module.partition(".")[0] not in _TRUSTED:
        raise ValueError(f"import {module} before reading a scene with its {described['class']}")
    kind = importlib.import_module(module)
    for part in described["class"].split("."):
        kind = getattr(kind, part, None)
    if not (isinstance(kind, type) and issubclass(kind, Model)):
        raise TypeError(f"{module}.{described['class']} is not a model")
    return kind(**described["parameters"])


def equal_values(one, other):
    """Return whether two values are equal: arrays, models, mappings and dataclasses of them.

    Functions are equal only if they are the same object.
    """
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        one, other = np.asarray(one), np.asarray(other)
        return one.dtype.kind == other.dtype.kind and np.array_equal(one, other)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(equal_values, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(equal_values(one[k], other[k]) for k in one)
    if type(one) is type(other) and isinstance(one, Model):
        return describe_model(one) == describe_model(other)
    if type(one) is type(other) and is_dataclass(one):
        names = [item.name for item in fields(one)]
        return all(equal_values(getattr(one, name), getattr(other, name)) for name in names)
    return bool(one == other)
