"""Converters to and from ASDF, an entry point of asdf: models, detectors, motions, scenes."""

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
from asdf.extension import Converter, Extension
from asdf_astropy.converters.transform.core import TransformConverterBase, parameter_to_value
from astropy.modeling import Model

from scope_models import effects, models
from scope_models.models import PRF, SensitivityPolynomial, TransitModel
from scope_models.models.variability import SineSignal, TabulatedSignal
from scope_models.scene.detector import Detector
from scope_models.scene.motion import Motion
from scope_models.scene.scene import Scene
from scope_models.scene.star import Star

__all__ = ["extensions"]

_URI = "asdf://scope-models"


def _classes(module, base):
    """Return the public classes of a module, by name."""
    found = {name: getattr(module, name) for name in module.__all__}
    return {name: k for name, k in found.items() if isinstance(k, type) and issubclass(k, base)}


_MODELS = _classes(models, Model)
_MODELS |= {kind.__name__: kind for kind in (SineSignal, TabulatedSignal)}
_VALUES = {kind.__name__: kind for kind in (Detector, Motion, Scene, Star)}
_VALUES |= _classes(effects, effects.Effect)
del _VALUES["Effect"]


class _ModelConverter(TransformConverterBase):
    """Models of the package; asdf-astropy combines them and keeps bounds, names and the like."""

    tags = (f"{_URI}/tags/model-1.0.0",)
    types = tuple(_MODELS.values())

    def to_yaml_tree_transform(self, model, tag, ctx):  # noqa: ARG002
        values = {name: parameter_to_value(getattr(model, name)) for name in model.param_names}
        if isinstance(model, PRF):
            product = model.psf if model.sensitivity is None else model.psf * model.sensitivity
            values = {name: values[name] for name in ("flux", "x_0", "y_0")} | {"compound": product}
        elif isinstance(model, SensitivityPolynomial):
            names = ("x_coefficients", "y_coefficients")
            values = {name: list(getattr(model, name)) for name in names}
        elif isinstance(model, TransitModel):
            values["exposure_time"] = model.exposure_time
        arguments = values | getattr(model, "arguments", {})
        return {"class": type(model).__name__, "arguments": _for_yaml(arguments)}

    def from_yaml_tree_transform(self, node, tag, ctx):  # noqa: ARG002
        return _MODELS[node["class"]](**node["arguments"])


class _ValueConverter(Converter):
    """Stars, detectors, motions, scenes and effects: their fields."""

    tags = (f"{_URI}/tags/value-1.0.0",)
    types = tuple(_VALUES.values())

    def to_yaml_tree(self, obj, tag, ctx):  # noqa: ARG002
        if isinstance(obj, Star) and callable(obj.signal) and not isinstance(obj.signal, Model):
            raise TypeError("`signal` of a star must be a model or an array to be stored as ASDF")
        names = [item.name for item in fields(obj)]
        return {"class": type(obj).__name__} | _for_yaml({n: getattr(obj, n) for n in names})

    def from_yaml_tree(self, node, tag, ctx):  # noqa: ARG002
        values = dict(node)
        return _VALUES[values.pop("class")](**values)


def _for_yaml(value):
    """Return a value whose containers are those that ASDF has."""
    if isinstance(value, Mapping):
        return {name: _for_yaml(item) for name, item in value.items()}
    if isinstance(value, frozenset):
        return sorted(value)
    if isinstance(value, list | tuple):
        return [_for_yaml(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


class _Extension(Extension):
    extension_uri = f"{_URI}/extensions/scope_models-1.0.0"
    converters = (_ModelConverter(), _ValueConverter())
    tags = tuple(tag for converter in converters for tag in converter.tags)


def extensions():
    """Return the extensions for asdf.

    Returns
    -------
    list of asdf.extension.Extension
        One extension.
    """
    return [_Extension()]
