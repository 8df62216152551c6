"""The one place where quantities, times and masked values become arrays."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from astropy import units as u
from astropy.time import Time, TimeDelta

__all__ = [
    "DIGITAL", "LARGEST_DAY", "PER_PIXEL", "TIME_ZEROS", "is_angle", "native", "plain_array",
    "plain_number", "plain_time", "plain_tree", "values_of", "without_unit",
]  # fmt: skip

#: Barycentric Julian date (TDB) of the zero of each time format.
TIME_ZEROS = MappingProxyType({"bkjd": 2454833.0, "btjd": 2457000.0})
#: Times beyond this are Julian dates, modified or not, which no mission's times reach.
LARGEST_DAY = 2e4
_CASTING = {"O": "unsafe", "f": "same_kind", "i": "same_kind", "u": "same_kind"}
#: Equivalencies of quantities that are given per pixel.
PER_PIXEL = ((u.arcsec / u.pix, u.arcsec), (u.electron / u.s / u.pix, u.electron / u.s))
#: Equivalencies of the names of a digital number (DN).
DIGITAL = tuple((other, u.adu) for other in (u.ct, u.DN))
DIGITAL += tuple((u.electron / other, u.electron / u.adu) for other in (u.ct, u.DN))


def native(array):
    """Return a new array in the machine's byte order."""
    array = np.asarray(array)
    return np.array(array, dtype=array.dtype.newbyteorder("="))


def _unmasked(value):
    """Return an array with its unit, and NaN in the place of masked values."""
    mask = getattr(value, "mask", None)
    if mask is None or callable(mask):  # a method of pandas' series
        return value
    plain = np.ma.getdata(getattr(value, "unmasked", value))
    unit = getattr(value, "unit", None) or getattr(plain, "unit", None)
    plain = without_unit(plain)
    if np.any(mask):
        plain = np.where(mask, np.nan, np.asarray(plain, dtype=float))
    return plain if unit is None else plain << unit


def plain_array(value, unit, name, *, pixel_scale=None, equivalencies=()):
    """Return an argument in its documented unit, as an array of floats; masked values become NaN.

    Plain numbers are in ``unit`` already: "" for none, None for any. With a ``pixel_scale`` in
    arcseconds, angles convert to pixels and back. Errors name the argument: TypeError without
    numbers, ValueError if the unit does not convert.
    """
    any_unit, unit = unit is None, u.Unit("" if unit is None else unit)
    if isinstance(value, Time):
        raise TypeError(f"`{name}` must be numbers, got a Time{_hint(unit)}")
    value = value.to(u.day) if isinstance(value, TimeDelta) else _unmasked(value)
    if _holds_quantities(value):
        try:
            value = _joined(value)
        except (TypeError, u.UnitConversionError) as error:
            raise TypeError(f"`{name}` mixes units: {error}") from error
    found = getattr(value, "unit", None)
    if isinstance(found, u.FunctionUnitBase) and found.physical_unit != u.one:
        raise ValueError(f"`{name}` must be in {_text(unit)}, or convert to it, got {found}")
    try:
        if found is None:
            array = np.asarray(value)
            # astype would read text and dates as numbers
            return array.astype(np.float64, casting=_CASTING.get(array.dtype.kind, "safe"))
        quantity = u.Quantity(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"`{name}` must hold numbers, got {value!r}{_hint(unit)}") from error
    if pixel_scale is not None:
        equivalencies = [*equivalencies, *u.pixel_scale(float(pixel_scale) * u.arcsec / u.pix)]
    if any_unit:
        return quantity.value
    try:
        return quantity.to_value(unit, equivalencies=list(equivalencies))
    except u.UnitConversionError:
        got = str(quantity.unit)
        if pixel_scale is None and is_angle(quantity.unit) and unit == u.pix:
            got += "; there is no pixel scale here to convert an angle with"
        message = f"`{name}` must be in {_text(unit)}, or convert to it, got {got}"
        raise ValueError(message) from None


def plain_number(value, unit, name, **options):
    """Return one value of an argument as a float; ``options`` are those of `plain_array`."""
    if value is None or isinstance(value, (bool, np.bool_, str)):
        raise TypeError(f"`{name}` must be a number, got {value!r}{_hint(unit)}")
    array = plain_array(value, unit, name, **options)
    if array.ndim:
        raise TypeError(f"`{name}` must be one number, got {value!r}{_hint(unit)}")
    return float(array)


def plain_time(value, time_format, name):
    """Return times as days from the zero of "bkjd" or "btjd"; None refuses a Time.

    Plain numbers that are Julian dates are refused.
    """
    if isinstance(value, (list, tuple)) and any(isinstance(item, Time) for item in value):
        value = Time(value)
    if isinstance(value, Time):
        if time_format is None:
            raise TypeError(f"`{name}` must be in days since an epoch of your own, got a Time")
        zero = Time(TIME_ZEROS[time_format], format="jd", scale="tdb")
        return np.where(value.mask, np.nan, (value.unmasked.tdb - zero).to_value(u.day))
    days = plain_array(value, u.day, name)
    if np.any(np.isfinite(days) & (days > LARGEST_DAY)):
        zero = TIME_ZEROS.get(time_format)
        wanted = f"BJD - {zero:.0f} in days" if zero else "days since a mission's zero of time"
        raise ValueError(
            f"`{name}` must be {wanted}, got {np.nanmax(days):.1f}, as in Julian dates, which "
            "astropy.time.Time converts"
        )
    return days


def without_unit(value):
    """Return the value of a quantity; other values are unchanged."""
    return getattr(value, "value", value)


def plain_tree(value, other=None):
    """Return nested values as Python's own; ``other`` converts what JSON cannot hold."""
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (str, int, float)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain_tree(item, other) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain_tree(item, other) for item in value]
    return value if other is None else other(value)


def values_of(table, name):
    """Return a column as floats, NaN where there is no value or no column."""
    if name not in table.colnames:
        return np.full(len(table), np.nan)
    return np.ma.filled(np.ma.asarray(table[name].value, dtype=float), np.nan)


def is_angle(unit):
    return unit is not None and unit.is_equivalent(u.rad)


def _text(unit):
    return unit.to_string() or "a number without a unit"


def _hint(unit):
    text = u.Unit(unit).to_string()
    return f" (unit: {text})" if text else ""


def _holds_quantities(value):
    return isinstance(value, (list, tuple)) and any(
        isinstance(item, u.Quantity) or _holds_quantities(item) for item in value
    )


def _joined(values):
    return u.Quantity([_joined(v) if isinstance(v, (list, tuple)) else v for v in values])
