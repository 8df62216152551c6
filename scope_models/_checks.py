"""Checks of arguments that several modules share."""

from contextlib import contextmanager
from dataclasses import MISSING, field, fields
from numbers import Integral

import numpy as np
from astropy.modeling import Model

from scope_models._arrays import plain_number

__all__ = [
    "check_fields", "checked_cadences", "checked_choice", "checked_int32", "checked_integer",
    "checked_mask", "checked_matrix", "checked_model", "checked_number", "checked_pair",
    "checked_shape", "checked_weights", "integer", "number", "on_stamp", "one_line", "solvable",
]  # fmt: skip


@contextmanager
def solvable():
    """Raise failures of linear algebra as an error of the file."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"the pixels of `tpf` do not constrain all fitted parameters ({error}): check "
            "FLUX_ERR and the aperture, or fit fewer parameters"
        ) from error


def checked_model(name, model):
    """Return a copy of a model of two inputs and one output, or None."""
    if model is None:
        return None
    if not isinstance(model, Model) or (model.n_inputs, model.n_outputs) != (2, 1):
        raise TypeError(f"`{name}` must be a two-dimensional astropy model or None, got {model!r}")
    return model.copy()


def checked_number(
    name, value, unit="", *, positive=False, any_sign=False, at_most=np.inf, below=np.inf, **options
):
    """Return a finite float in a unit; ``options`` are those of `plain_number`."""
    value = plain_number(value, unit, name, **options)
    if not np.isfinite(value):
        raise ValueError(f"`{name}` must be finite, got {value}")
    if positive and value <= 0:
        raise ValueError(f"`{name}` must be positive, got {value}")
    if value < 0 and not any_sign:
        raise ValueError(f"`{name}` must not be negative, got {value}")
    if abs(value) > at_most:
        wanted = f"be within -{at_most} to {at_most}" if value < 0 else f"not be above {at_most}"
        raise ValueError(f"`{name}` must {wanted}, got {value}")
    if abs(value) >= below:
        raise ValueError(f"`{name}` must be below {below}, got {value}")
    return value


def number(default=MISSING, unit="", **options):
    """Return a field of a dataclass, a number or pair, that `check_fields` brings to its unit."""
    check = checked_pair if isinstance(default, tuple) else checked_number
    return field(default=default, metadata={"check": check, "unit": unit, **options})


def integer(default, smallest, largest=None):
    """Return a field of a dataclass, an integer, that `check_fields` checks."""
    metadata = {"check": checked_integer, "smallest": smallest, "largest": largest}
    return field(default=default, metadata=metadata)


def check_fields(instance):
    """Check each `number` and `integer` of a dataclass; None stays as a default."""
    for item in fields(instance):
        value, options = getattr(instance, item.name), dict(item.metadata)
        if options and not (value is None and item.default is None):
            check = options.pop("check")
            object.__setattr__(instance, item.name, check(item.name, value, **options))


def checked_choice(name, value, choices):
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"`{name}` must be one of {', '.join(choices)}, got {value!r}")
    return value


def checked_integer(name, value, smallest, largest=None):
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"`{name}` must be an integer, got {value!r}")
    if value < smallest:
        raise ValueError(f"`{name}` must be at least {smallest}, got {value}")
    if largest is not None and value > largest:
        raise ValueError(f"`{name}` must be at most {largest}, got {value}")
    return int(value)


def checked_int32(name, values, shape=None):
    array, limits = np.asarray(values), np.iinfo(np.int32)
    if array.dtype.kind not in "iu":
        raise TypeError(f"`{name}` must hold integers, got {array.dtype}")
    if array.size and (array.min() < limits.min or array.max() > limits.max):
        raise ValueError(f"`{name}` must fit into 32 bits, got {array.min()} to {array.max()}")
    if shape is not None and array.shape != shape:
        raise ValueError(f"`{name}` must have the shape {shape}, got {array.shape}")
    return array.astype(np.int32, copy=False)


def checked_pair(name, pair, unit="", **options):
    try:
        column, row = pair
    except (TypeError, ValueError) as error:
        raise type(error)(f"`{name}` must be (column, row), got {pair!r}") from None
    options |= {"any_sign": True}
    return tuple(checked_number(name, value, unit, **options) for value in (column, row))


def checked_mask(name, mask, shape):
    """Return a boolean mask of a shape with a pixel in it."""
    mask = np.asarray(mask)
    is_mask = mask.dtype.kind == "b" or (mask.dtype.kind in "iu" and np.isin(mask, (0, 1)).all())
    if not is_mask or mask.shape != tuple(shape):
        wanted = f"a boolean mask of shape {tuple(shape)}"
        raise ValueError(f"`{name}` must be {wanted}, got {mask.dtype} {mask.shape}")
    if not mask.any():
        raise ValueError(f"`{name}` has no pixels")
    return mask.astype(bool)


def checked_matrix(name, matrix):
    try:
        a, b, c, d = (checked_number(name, value, any_sign=True) for value in matrix)
    except (TypeError, ValueError) as error:
        raise type(error)(f"`{name}` must be four finite numbers, got {matrix!r}") from None
    if a * d == b * c:
        raise ValueError(f"`{name}` must be invertible, got {matrix!r}")
    return a, b, c, d


def checked_weights(name, weights, shape):
    """Return the weights of pixels; NaN where a cadence cannot be used."""
    weights = np.asarray(weights)
    if weights.dtype.kind not in "biuf" or weights.shape != tuple(shape):
        wanted = f"weights of shape {tuple(shape)}"
        raise ValueError(f"`{name}` must be {wanted}, got {weights.dtype} {weights.shape}")
    weights = weights.astype(float)
    if np.any(weights < 0) or np.any(np.isinf(weights)) or not np.any(weights > 0):
        raise ValueError(f"`{name}` must be finite, not negative, and above zero somewhere")
    return weights


def checked_shape(shape):
    try:
        ny, nx = shape
    except (TypeError, ValueError):
        raise TypeError(f"`shape` must be two integers (ny, nx), got {shape!r}") from None
    return checked_integer("shape", ny, 1), checked_integer("shape", nx, 1)


def on_stamp(place, shape):
    """Return whether a column and row are within the pixels of a shape (ny, nx)."""
    return all(-0.5 <= p <= n - 0.5 for p, n in zip(place, shape[::-1], strict=True))


def checked_cadences(name, mask, n, *, default):
    """Return a boolean mask of n cadences; None stands for the default."""
    if mask is None:
        return np.full(n, default)
    mask = np.asarray(mask)
    if mask.dtype != bool:
        raise TypeError(f"`{name}` must be boolean, got {mask.dtype}")
    if mask.shape != (n,):
        raise ValueError(f"`{name}` must have shape ({n},), got {mask.shape}")
    return mask.copy()


def one_line(text):
    """Return a text in one line, with escapes of characters that do not print."""
    shown = " ".join(str(text).split())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in shown)
