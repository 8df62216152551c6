"""Objects compared by value: equality, hash, `replace`, copies, one-line text."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from html import escape

import numpy as np
from astropy.modeling import CompoundModel, Model

__all__ = ["Value", "frozen", "html_table", "value_key"]


class Value:
    """Mixin of frozen dataclasses that are equal if their fields with ``compare=True`` are."""

    def __eq__(self, other):
        if type(other) is not type(self):
            return NotImplemented
        return value_key(self) == value_key(other)

    def __hash__(self):
        return hash(value_key(self))

    def __reduce__(self):
        # by the constructor, which makes arrays and mappings read-only again
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.init}
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}
        return partial(type(self), **plain), ()

    def __repr__(self):
        names = [item.name for item in dataclasses.fields(self) if item.repr]
        shown = ", ".join(f"{name}={_shown(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({shown})"

    def replace(self, **changes):
        """Return a copy with other values of some fields; a TypeError if there is no such field."""
        return dataclasses.replace(self, **changes)


def frozen(array):
    """Return a read-only array, a copy if it or its base can be written to."""
    owner = array = np.asarray(array)
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if isinstance(owner, np.ndarray):
        array = array.copy()
        array.flags.writeable = False
    return array


def html_table(title, rows):
    texts = ([escape(str(text)) for text in row] for row in rows.items())
    cells = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in texts)
    return f"<p>{escape(title)}</p><table>{cells}</table>"


def value_key(value):
    """Return a key that is equal, with equal hash, for equal values; functions by identity."""
    if hasattr(value, "colnames"):  # a table
        value = {name: np.asarray(value[name]) for name in value.colnames}
    if isinstance(value, np.ndarray):
        plain = value.view(np.ndarray)
        if plain.dtype.kind in "fiub":
            values = (plain.astype(float) + 0.0).tobytes()  # adding 0 makes -0 equal to 0
        else:
            values = tuple(plain.ravel().tolist())
        return plain.shape, values, str(getattr(value, "unit", ""))
    if isinstance(value, list | tuple):
        return tuple(map(value_key, value))
    if isinstance(value, Mapping):
        return frozenset((key, value_key(item)) for key, item in value.items())
    if isinstance(value, CompoundModel):
        parts = value.op, value.left, value.right
    elif isinstance(value, Model):  # its parameters, tables and options
        values = {name: getattr(value, name) for name in value.param_names}
        own = {k: v for k, v in vars(value).items() if k[0] != "_" and k not in values}
        for name in ("arguments", "psf", "sensitivity"):  # private attributes of some models
            own.setdefault(name, getattr(value, name, None))
        parts = {name: (np.asarray(p.value), str(p.unit)) for name, p in values.items()}, own
    elif hasattr(value, "__dataclass_fields__"):
        parts = [getattr(value, f.name) for f in dataclasses.fields(value) if f.compare]
    elif hasattr(value, "icrs"):  # a SkyCoord
        place, epoch = value.icrs, getattr(value.obstime, "jyear", None)
        moves = ("pm_ra_cosdec", "pm_dec") if "s" in place.data.differentials else ()
        parts = [*(getattr(place, name) for name in ("ra", "dec", *moves)), epoch]
    else:
        return "nan" if isinstance(value, float) and np.isnan(value) else value
    return type(value), value_key(parts)


def _shown(value):
    if hasattr(value, "colnames"):
        return f"<table of {len(value)} rows>"
    if isinstance(value, np.ndarray) and value.size > 4:
        return f"<array of shape {value.shape}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_shown(item)}' for key, item in value.items())}}}"
    return " ".join(repr(value).split())
