"""The columns of the pixel table, and checks of their values."""

from dataclasses import dataclass, replace

import numpy as np

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import checked_int32

__all__ = ["PixelColumn", "checked_columns", "pixel_columns", "table_rows"]

_ROLLING_BAND_DURATIONS = 5
_UNITS = {"timecorr": "d", "pos_corr1": "pix", "pos_corr2": "pix"}
_CUBES = "flux_err", "flux_bkg", "flux_bkg_err", "cosmic_rays"
_UNITS |= dict.fromkeys(("flux", *_CUBES), "electron / s")
_DTYPES = {"D": np.dtype(">f8"), "E": np.dtype(">f4"), "J": np.dtype(">i4")}


@dataclass(frozen=True)
class PixelColumn:
    name: str
    kind: str
    title: str
    unit: str = ""
    display: str = ""
    null: int | None = None
    is_pixels: bool = False

    def image_shape(self, shape):
        """Return the shape of a cell's value, () for a number."""
        if self.name == "RB_LEVEL":
            return shape[0], _ROLLING_BAND_DURATIONS
        return tuple(shape) if self.is_pixels else ()


_TIME = PixelColumn("TIME", "D", "times of mid-cadence")
_COLUMNS = (
    _TIME,
    PixelColumn("TIMECORR", "E", "barycentric minus spacecraft time", "d"),
    PixelColumn("CADENCENO", "J", "number of the cadence", display="I10"),
    PixelColumn("RAW_CNTS", "J", "raw counts", "count", "I8", -1, is_pixels=True),
    PixelColumn("FLUX", "E", "flux less background", "e-/s", is_pixels=True),
    PixelColumn("FLUX_ERR", "E", "standard deviation of it", "e-/s", is_pixels=True),
    PixelColumn("FLUX_BKG", "E", "background", "e-/s", is_pixels=True),
    PixelColumn("FLUX_BKG_ERR", "E", "its uncertainty", "e-/s", is_pixels=True),
    PixelColumn("COSMIC_RAYS", "E", "cosmic rays", "e-/s", is_pixels=True),
    PixelColumn("QUALITY", "J", "quality flags"),
    PixelColumn("POS_CORR1", "E", "offset in columns", "pixel"),
    PixelColumn("POS_CORR2", "E", "offset in rows", "pixel"),
    PixelColumn("RB_LEVEL", "E", "rolling bands, none sought", "sigma"),
)


def pixel_columns(metadata):
    layout = metadata.layout
    displays = dict(zip("DE", layout.displays[:2], strict=True)) | {"J": layout.displays[2]}
    columns = []
    for column in _COLUMNS:
        if column.name in layout.absent_columns:
            continue
        display = column.display or displays[column.kind]
        unit = layout.time_unit if column is _TIME else column.unit
        columns.append(replace(column, display=display, unit=unit))
    return tuple(columns)


def table_rows(columns, values, shape):
    """Return the pixel table as in the file, NaN or the null value in columns without values."""
    n_cadences, *stamp = shape
    fields = [(item.name, _DTYPES[item.kind], item.image_shape(stamp)) for item in columns]
    rows = np.empty(n_cadences, dtype=fields)
    as_bytes = rows.view(np.uint8).reshape(n_cadences, -1)
    for column in columns:
        given = values.get(column.name)
        field, start = rows.dtype.fields[column.name]
        if given is None:
            rows[column.name] = np.nan if column.null is None else column.null
        elif given.ndim == 3:
            # One swap of bytes in one piece, then rows of bytes: 5 times faster than by field.
            swapped = np.ascontiguousarray(given, dtype=field.base)
            cells = swapped.view(np.uint8).reshape(n_cadences, -1)
            as_bytes[:, start : start + field.itemsize] = cells
        else:
            rows[column.name] = given
    return rows


def checked_columns(metadata, values):
    """Return the arrays that are there, by the names in the file, checked against each other."""
    # Only times, quantities and masked values have these; plain arrays are not copied.
    special = ("unit", "mask", "jd1")
    values = {
        name: plain_array(value, _UNITS[name], name)
        if name in _UNITS and any(hasattr(value, attribute) for attribute in special)
        else value
        for name, value in values.items()
    }
    flux = np.asarray(values["flux"])
    if flux.ndim != 3 or 0 in flux.shape:
        raise ValueError(f"`flux` must have the shape (n_cadences, ny, nx), got {flux.shape}")
    checked = _checked_times(metadata, values, flux.shape[:1])
    checked["FLUX"] = _floats("flux", flux, flux.shape)
    for name in _CUBES:
        if values[name] is not None:
            checked[name.upper()] = _floats(name, values[name], flux.shape, broadcast=True)
    for name in ("pos_corr1", "pos_corr2", "timecorr"):
        if values[name] is not None:
            checked[name.upper()] = _floats(name, values[name], flux.shape[:1])
    error, background_error = checked["FLUX_ERR"], checked["FLUX_BKG_ERR"]
    if np.any(error <= 0):
        raise ValueError(f"`flux_err` must be positive, got {np.nanmin(error)}")
    if np.any(np.isnan(error) & ~np.isnan(checked["FLUX"])):
        raise ValueError("`flux_err` must not be NaN where `flux` is not")
    if np.any(background_error < 0):
        raise ValueError(f"`flux_bkg_err` must not be negative, got {np.nanmin(background_error)}")
    if values["raw_cnts"] is not None:
        checked["RAW_CNTS"] = _integers("raw_cnts", values["raw_cnts"], flux.shape)
        if checked["RAW_CNTS"].min() < -1:
            raise ValueError("`raw_cnts` must not be negative, except -1 where there are no data")
    return checked


def _checked_times(metadata, values, shape):
    """Return times, cadence numbers and quality flags: no data where Kepler and K2 have no time."""
    time = plain_time(values["time"], metadata.layout.time_format, "time")
    time = _floats("time", time, shape)
    known = time[np.isfinite(time)]
    if known.size == 0:
        raise ValueError("`time` must have a finite value")
    if np.any(np.diff(known) <= 0):
        raise ValueError("`time` must increase from cadence to cadence")
    number = _integers("cadenceno", values["cadenceno"], shape)
    if number[0] < 1 or np.any(np.diff(number) <= 0):
        raise ValueError(f"`cadenceno` must increase from at least 1, got {number[0]} first")
    quality = _integers("quality", values["quality"], shape)
    if quality.min() < 0:
        raise ValueError(f"`quality` must not be negative, got {quality.min()}")
    no_data = np.where(np.isnan(time), metadata.layout.quality.no_data, 0).astype(np.int32)
    return {"TIME": time, "CADENCENO": number, "QUALITY": quality | no_data}


def _floats(name, values, shape, *, broadcast=False):
    """Return an array of floats of a shape, without infinities."""
    array = np.asarray(values)
    if array.dtype.kind not in "iufb":
        raise TypeError(f"`{name}` must be an array of numbers, got {array.dtype}")
    if broadcast:
        try:
            array = np.broadcast_to(array, shape)
        except ValueError:
            raise ValueError(f"`{name}` must fit the shape {shape}, got {array.shape}") from None
    if array.shape != shape:
        raise ValueError(f"`{name}` must have the shape {shape}, got {array.shape}")
    if array.dtype.kind != "f":
        return array.astype(float)
    if np.any(np.abs(array) > np.finfo(np.float32).max):
        raise ValueError(f"`{name}` must not be infinite, and fit into single precision")
    return array


def _integers(name, values, shape):
    array = checked_int32(name, values)
    if array.shape != shape:
        raise ValueError(f"`{name}` must have the shape {shape}, got {array.shape}")
    return array
