"""Objects that are compared by what they hold: equality, hash, `replace`, copies, one-line text."""

import dataclasses
from collections.abc import Mapping
from functools import singledispatch
from html import escape

import numpy as np
from astropy.modeling import CompoundModel, Model

__all__ = ["Value", "frozen", "html_table", "value_key"]

_PROPER_MOTION = ("pm_ra_cosdec", "pm_dec")


class Value:
    """Mixin of frozen dataclasses that are what their fields are.

    Arrays among the fields are read-only; fields with ``compare=False`` do not count.
    """

    def __eq__(self, other):
        if type(other) is not type(self):
            return NotImplemented
        return value_key(self) == value_key(other)

    def __hash__(self):
        return hash(value_key(self))

    def __reduce__(self):
        # by the constructor, which makes arrays and mappings read-only again
        names = [item.name for item in dataclasses.fields(self) if item.init]
        values = {name: getattr(self, name) for name in names}
        plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}
        return _made, (type(self), plain)

    def __repr__(self):
        shown = (
            f"{item.name}={_shown(getattr(self, item.name))}"
            for item in dataclasses.fields(self)
            if item.repr
        )
        return f"{type(self).__name__}({', '.join(shown)})"

    def replace(self, **changes):
        """Return a copy with other values of some fields.

        Parameters
        ----------
        **changes
            Fields and their new values.

        Returns
        -------
        object
            The copy, of the same class.

        Raises
        ------
        TypeError
            If there is no such field.
        """
        return dataclasses.replace(self, **changes)


def frozen(array):
    """Return a read-only array: a copy if this one, or what it is a view of, can be written to."""
    array = owner = np.asarray(array)
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            array = array.copy()
            array.flags.writeable = False
            return array
        owner = owner.base
    return array


def html_table(title, rows):
    """Return a title and a table of names and values as HTML."""
    cells = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(str(value))}</td></tr>"
        for name, value in rows.items()
    )
    return f"<p>{escape(title)}</p><table>{cells}</table>"


@singledispatch
def value_key(value):
    """Return what is equal, and hashes alike, for equal values; functions by identity."""
    if hasattr(value, "__dataclass_fields__"):
        names = [item.name for item in dataclasses.fields(value) if item.compare]
        return type(value), *(value_key(getattr(value, name)) for name in names)
    if hasattr(value, "colnames"):  # a table
        return value_key({name: np.asarray(value[name]) for name in value.colnames})
    if hasattr(value, "icrs"):  # a SkyCoord
        place = value.icrs
        names = ("ra", "dec", *(_PROPER_MOTION if "s" in place.data.differentials else ()))
        epoch = None if value.obstime is None else value.obstime.jyear
        return value_key([*(getattr(place, name) for name in names), epoch])
    return "nan" if isinstance(value, float) and np.isnan(value) else value


@value_key.register(list | tuple)
def _(value):
    return tuple(value_key(item) for item in value)


@value_key.register
def _(value: Mapping):
    return frozenset((key, value_key(item)) for key, item in value.items())


@value_key.register
def _(value: np.ndarray):
    plain = value.view(np.ndarray)
    if plain.dtype.kind in "fiub":
        values = (plain.astype(float) + 0.0).tobytes()  # adding 0 makes -0 equal to 0
    else:
        values = tuple(plain.ravel().tolist())
    return plain.shape, values, str(getattr(value, "unit", ""))


@value_key.register
def _(value: CompoundModel):
    return value.op, value_key(value.left), value_key(value.right)


@value_key.register
def _(value: Model):
    """Return the class of a model, its parameters, and its tables and options."""
    parameters = {name: getattr(value, name) for name in value.param_names}
    own = {k: v for k, v in vars(value).items() if k[0] != "_" and k not in parameters}
    for name in ("arguments", "psf", "sensitivity"):  # what some models keep in private attributes
        own.setdefault(name, getattr(value, name, None))
    values = {name: (np.asarray(p.value), str(p.unit)) for name, p in parameters.items()}
    return type(value), value_key(values), value_key(own)


def _made(kind, values):
    return kind(**values)


def _shown(value):
    """Return text of one line."""
    if hasattr(value, "colnames"):
        return f"<table of {len(value)} rows>"
    if isinstance(value, np.ndarray) and value.size > 4:
        return f"<array of shape {value.shape}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_shown(item)}' for key, item in value.items())}}}"
    return " ".join(repr(value).split())
