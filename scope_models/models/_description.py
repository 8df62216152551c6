"""Models as JSON values, and back."""

import importlib
import math
import operator
import zlib
from base64 import b64decode, b64encode
from itertools import chain

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.modeling import CompoundModel, Model
from astropy.time import Time

from scope_models._arrays import is_angle, plain_array
from scope_models.models.integration import value_of
from scope_models.models.psf import SensitivityPolynomial

__all__ = [
    "check_coord", "class_named", "describe_coord", "describe_model", "make_coord",
    "make_model", "model_in_pixels", "packed", "sky_place", "unpacked",
]  # fmt: skip

_OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul}
# Where the names of models in files are looked up, in this order.
_MODULES = ("scope_models.models", "scope_models.models.signals")
_MODULES += ("astropy.modeling.models", "photutils.psf")
_LARGEST_ARRAY = 1 << 26  # bytes of an array in a file, unpacked
_PLACE = {"ra": u.deg, "dec": u.deg}
_MOVES = dict.fromkeys(("pm_ra_cosdec", "pm_dec"), u.mas / u.yr)


def describe_model(model):
    """Return a model as names of classes and values of parameters."""
    if model is None:
        return None
    if isinstance(model, CompoundModel):
        left, right = describe_model(model.left), describe_model(model.right)
        return {"operator": model.op, "left": left, "right": right}
    values = {}
    for name in model.param_names:
        parameter = getattr(model, name)
        value = values[name] = np.asarray(parameter.value).tolist()
        if parameter.unit is not None:
            values[name] = {"value": value, "unit": str(parameter.unit)}
    values |= {k: packed(v) for k, v in getattr(model, "arguments", {}).items()}
    if isinstance(model, SensitivityPolynomial):
        names = ("x_coefficients", "y_coefficients")
        values = {name: list(getattr(model, name)) for name in names}
    return {"class": type(model).__name__, "parameters": values}


def make_model(described):
    if described is None:
        return None
    if "operator" in described:
        combine = _OPERATORS[described["operator"]]
        return combine(make_model(described["left"]), make_model(described["right"]))
    kind = class_named(described["class"], Model, _MODULES, "a model")
    return kind(**{name: unpacked(value) for name, value in described["parameters"].items()})


def describe_coord(coord):
    place = coord.icrs
    units = _PLACE | (_MOVES if "s" in place.data.differentials else {})
    described = {name: getattr(place, name).to_value(unit).item() for name, unit in units.items()}
    if coord.obstime is not None:
        described["epoch"] = coord.obstime.jyear.item()
    return described


def make_coord(described):
    if described is None:
        return None
    units = (_PLACE | _MOVES).items()
    values = {name: described[name] * unit for name, unit in units if name in described}
    epoch = described.get("epoch")
    return SkyCoord(**values, obstime=None if epoch is None else Time(epoch, format="jyear"))


def check_coord(coord):
    """Check that a coordinate is one place, with an epoch if it moves."""
    if not isinstance(coord, SkyCoord) or not coord.isscalar:
        raise TypeError(f"`coord` must be one SkyCoord, got {coord!r}")
    try:
        place = coord.icrs
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"`coord` must convert to ICRS, got {coord!r}: {error}") from error
    if not np.isfinite(place.ra.deg + place.dec.deg):
        raise ValueError(f"`coord` must be finite, got {coord!r}")
    if "s" in coord.data.differentials and coord.obstime is None:
        raise ValueError("`coord` must have an `obstime`, because it has a proper motion")


def sky_place(coord, year):
    """Return right ascension and declination in a Julian year, ICRS, deg."""
    place = coord.icrs
    if "s" in place.data.differentials:
        since = (year - coord.obstime.jyear) * u.yr
        place = place.spherical_offsets_by(place.pm_ra_cosdec * since, place.pm_dec * since)
    return place.ra.deg.item(), place.dec.deg.item()


def packed(value):
    """Return an array as text; other values are unchanged."""
    if not isinstance(value, np.ndarray):
        return value
    values = np.ascontiguousarray(value, dtype="<f8")
    return {"array": b64encode(zlib.compress(values.tobytes())).decode(), "shape": values.shape}


def unpacked(value):
    """Return the array of a text and the quantity of a unit; other values are unchanged."""
    if not isinstance(value, dict):
        return value
    if value.keys() == {"value", "unit"}:
        return value["value"] * u.Unit(value["unit"])
    if value.keys() != {"array", "shape"}:
        raise ValueError(f"a table must have `value` and `unit`, got {', '.join(value)}")
    shape = tuple(map(int, value["shape"]))
    size = 8 * math.prod(shape)
    if not 0 <= size <= _LARGEST_ARRAY:
        raise ValueError(f"an array must have up to {_LARGEST_ARRAY:,} bytes, got {size:,}")
    # Never unpack more than the shape holds.
    content = zlib.decompressobj().decompress(b64decode(value["array"]), size + 1)
    if len(content) != size:
        raise ValueError(f"an array does not have the {size:,} bytes of its shape {shape}")
    return np.frombuffer(content, dtype="<f8").reshape(shape)


def model_in_pixels(model, pixel_scale):
    """Return a model whose widths and positions are pixels, where they were angles."""
    if model is None:
        return None
    if isinstance(model, CompoundModel):
        parts = [model_in_pixels(part, pixel_scale) for part in (model.left, model.right)]
        if parts[0] is model.left and parts[1] is model.right:
            return model
        return _OPERATORS[model.op](*parts)
    values = {name: value_of(getattr(model, name)) for name in model.param_names}
    units = {name: getattr(v, "unit", None) for name, v in values.items() if name != "theta"}
    if not any(map(is_angle, units.values())):
        return model
    for name, unit in units.items():
        if is_angle(unit) or unit == u.pix:
            values[name] = plain_array(values[name], u.pix, name, pixel_scale=pixel_scale)
    return type(model)(**values, name=model.name, fixed=model.fixed, bounds=model.bounds)


def class_named(name, base, modules, what):
    """Return the class of a public name, of which the last part counts; nothing is imported by it.

    Classes of ``modules`` go first, then subclasses of the ``base``, called ``what``, of the user.
    """
    short = str(name).rpartition(".")[2]
    public = (getattr(importlib.import_module(module), short, None) for module in modules)
    for kind in chain(public, reversed(_subclasses(base))):
        if isinstance(kind, type) and issubclass(kind, base) and kind.__name__ == short:
            return kind
    raise ValueError(f"{name!r} is not the name of {what} of {', '.join(modules)}, or of your own")


def _subclasses(kind):
    own = kind.__subclasses__()
    return own + [further for derived in own for further in _subclasses(derived)]
