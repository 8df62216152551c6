"""Models as what JSON can hold, and back."""

import importlib
import math
import operator
import sys
import zlib
from base64 import b64decode, b64encode

import numpy as np
from astropy import units as u
from astropy.modeling import CompoundModel, Model

from scope_models._arrays import is_angle, plain_array
from scope_models.models._parameters import value_of
from scope_models.models.sensitivity import SensitivityPolynomial

__all__ = [
    "check_coord",
    "describe_coord",
    "describe_model",
    "find_class",
    "make_coord",
    "make_model",
    "model_in_pixels",
    "packed",
    "sky_place",
    "unpacked",
]

_OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul}
# Modules that reading a file may import; others must have been imported before.
_TRUSTED = {"scope_models", "astropy", "photutils"}
_LARGEST_ARRAY = 1 << 26  # bytes of an array in a file, unpacked


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
    if hasattr(model, "arguments"):
        described["parameters"] |= {k: packed(v) for k, v in model.arguments.items()}
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
    kind = find_class(described, Model, "a model")
    return kind(**{name: unpacked(value) for name, value in described["parameters"].items()})


def describe_coord(coord):
    """Return a place on the sky as its ICRS coordinates, proper motion and epoch."""
    if coord is None:
        return None
    place = coord.icrs
    described = {"ra": place.ra.deg.item(), "dec": place.dec.deg.item()}
    if "s" in place.data.differentials:
        for name in ("pm_ra_cosdec", "pm_dec"):
            described[name] = getattr(place, name).to_value(u.mas / u.yr).item()
    if coord.obstime is not None:
        described["epoch"] = coord.obstime.jyear.item()
    return described


def make_coord(described):
    """Return the place on the sky of a description."""
    if described is None:
        return None
    from astropy.coordinates import SkyCoord
    from astropy.time import Time

    units = {"ra": u.deg, "dec": u.deg, "pm_ra_cosdec": u.mas / u.yr, "pm_dec": u.mas / u.yr}
    values = {name: described[name] * unit for name, unit in units.items() if name in described}
    epoch = described.get("epoch")
    return SkyCoord(**values, obstime=None if epoch is None else Time(epoch, format="jyear"))


def check_coord(coord):
    """Check that a coordinate is one place on the sky, with an epoch if it moves."""
    from astropy.coordinates import SkyCoord

    if not isinstance(coord, SkyCoord) or not coord.isscalar:
        raise TypeError(f"`coord` must be one SkyCoord, got {coord!r}")
    if not np.isfinite(coord.icrs.ra.deg + coord.icrs.dec.deg):
        raise ValueError(f"`coord` must be finite, got {coord!r}")
    if "s" in coord.data.differentials and coord.obstime is None:
        raise ValueError("`coord` must have an `obstime`, for it has a proper motion")


def sky_place(coord, year):
    """Return right ascension and declination in a Julian year, ICRS, deg."""
    place = coord.icrs
    if "s" in place.data.differentials:
        since = (year - coord.obstime.jyear) * u.yr
        place = place.spherical_offsets_by(place.pm_ra_cosdec * since, place.pm_dec * since)
    return place.ra.deg.item(), place.dec.deg.item()


def packed(value):
    """Return an array as text, and anything else as it is."""
    if not isinstance(value, np.ndarray):
        return value
    values = np.ascontiguousarray(value, dtype="<f8")
    return {"array": b64encode(zlib.compress(values.tobytes())).decode(), "shape": values.shape}


def unpacked(value):
    """Return the array of a text, and anything else as it is."""
    if not isinstance(value, dict):
        return value
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
    parameters = {name: getattr(model, name) for name in model.param_names}
    if not any(is_angle(p.unit) and name != "theta" for name, p in parameters.items()):
        return model
    values = {}
    for name, p in parameters.items():
        values[name] = value_of(p)
        if name != "theta" and (is_angle(p.unit) or p.unit == u.pix):
            values[name] = plain_array(p.quantity, u.pix, name, pixel_scale=pixel_scale)
    return type(model)(**values, name=model.name, fixed=model.fixed, bounds=model.bounds)


def find_class(described, base, what):
    """Return the class of a description; ``what`` is what messages call its base."""
    module = described["module"]
    if module not in sys.modules and module.partition(".")[0] not in _TRUSTED:
        raise ValueError(f"import {module} before reading a scene with its {described['class']}")
    kind = importlib.import_module(module)
    for part in described["class"].split("."):
        kind = getattr(kind, part, None)
    if not (isinstance(kind, type) and issubclass(kind, base)):
        raise TypeError(f"{module}.{described['class']} is not {what}")
    return kind
