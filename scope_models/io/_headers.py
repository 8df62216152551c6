"""The headers and the pixel table of a target pixel file, and checks of their values."""

import datetime as dt
import warnings
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.time import Time

from scope_models._arrays import plain_array, plain_time
from scope_models._checks import checked_int32
from scope_models._version import __version__
from scope_models.io._blocks import card_texts

__all__ = [
    "COLLECTED", "OPTIMAL", "PixelColumn", "calendar_dates", "checked_columns", "make_headers",
    "pixel_column_cards", "pixel_columns", "table_rows", "tan_projection", "wcs_keywords",
]  # fmt: skip

#: Bits of the pixels that are collected, and of those in the optimal aperture.
COLLECTED, OPTIMAL = 1, 2
_LAYOUTS = Path(__file__).with_name("layouts")
# Names of cards on the coordinates of an image, and of those of a column without their numbers.
_WCS = {"CTYPE": "CTYP", "CRPIX": "CRPX", "CRVAL": "CRVL", "CUNIT": "CUNI", "CDELT": "CDLT"}
_MATRIX = ("PC1_1", "PC1_2", "PC2_1", "PC2_2")
_PROTECTED = ("SIMPLE", "BITPIX", "EXTEND", "NEXTEND", "EXTNAME", "EXTVER", "CHECKSUM", "DATASUM")
_CARDS = {
    "OBJECT": "name", "CHANNEL": "full_channel", "CAMERA": "camera", "CCD": "ccd",
    "QUARTER": "quarter", "CAMPAIGN": "campaign", "SECTOR": "sector", "INT_TIME": "int_time",
    "READTIME": "read_time", "FRAMETIM": "frame_time", "NUM_FRM": "n_frames", "NREADOUT": "reads",
}  # fmt: skip
_MAX_CARD_INTEGER = 2**63 - 1  # larger seeds are written as text, for readers with 64-bit integers
_ROLLING_BAND_DURATIONS = 5
_CUBES = "flux", "flux_err", "flux_bkg", "flux_bkg_err", "cosmic_rays"
_UNITS = dict.fromkeys(_CUBES, "electron / s")
_UNITS |= {"timecorr": "d", "pos_corr1": "pix", "pos_corr2": "pix"}
_DTYPES = {"D": np.dtype(">f8"), "E": np.dtype(">f4"), "J": np.dtype(">i4")}


@dataclass(frozen=True)
class PixelColumn:
    name: str
    kind: str
    title: str
    unit: str | None = None
    display: str = ""
    null: int | None = None
    is_pixels: bool = False

    def image_shape(self, shape):
        """Return the shape of a cell's value, () for a number."""
        if self.name == "RB_LEVEL":
            return shape[0], _ROLLING_BAND_DURATIONS
        return tuple(shape) if self.is_pixels else ()


_COLUMNS = (
    PixelColumn("TIME", "D", "times of mid-cadence"),
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


def make_headers(metadata, time, timecorr, used, aperture):
    """Return the cards of file, pixel table (without its columns) and aperture, as texts.

    Times are days, NaN where unknown; ``used`` cadences have a time and any flux.
    """
    optimal, collected = aperture & OPTIMAL > 0, aperture & COLLECTED > 0
    sky = {key: value for key, (value, _) in tan_projection(metadata, aperture.shape).items()}
    values = {
        **_facts(metadata), **_span(metadata, time, timecorr, used), **sky,
        "CRVAL1P": metadata.column, "CRVAL2P": metadata.row, "NPIXSAP": int(optimal.sum()),
        "NPIXMISS": int((optimal & ~collected).sum()),
    }  # fmt: skip
    names = {} if metadata.is_long_cadence else {"LC_START": "SC_START", "LC_END": "SC_END"}
    unknown = None in (metadata.camera, metadata.ccd)
    names["TMOFST"] = None if unknown else f"TMOFST{metadata.camera}{metadata.ccd}"
    headers = []
    for cards in _template(metadata.layout.template):
        filled = (
            (name, values[keyword], comment)
            if values.get(keyword) is not None
            else f"{name:8}{text[8:]}"
            for keyword, text, comment in cards
            if (name := names.get(keyword, keyword)) is not None
        )
        headers.append(card_texts(filled))
    if metadata.layout.template != metadata.mission.lower():
        comment = "kind of telescope; the layout is another's"
        headers[0] += card_texts([("MISSION", metadata.mission, comment)])
    _fill(headers, metadata.extra_cards)
    return headers


@cache
def _template(name):
    """Return keyword, text and comment of the cards of each header of a layout."""
    headers = [[]]
    for card in fits.Header.fromtextfile(_LAYOUTS / f"{name}.hdr").cards:
        if card.keyword == "XTENSION":
            headers.append([])
        else:
            headers[-1].append((card.keyword, str(card), card.comment))
    return headers


def _facts(metadata):
    mission, (ra, dec) = metadata.layout, metadata.position
    module, output = metadata.module_and_output
    quarter, seed = metadata.quarter, metadata.seed
    offsets = ("FXDOFF", "LCFXDOFF" if metadata.is_long_cadence else "SCFXDOFF")
    outputs = ("", *"ABCD")
    return {
        **{keyword: getattr(metadata, name) for keyword, name in _CARDS.items()},
        "DATE": (metadata.date or dt.datetime.now(dt.UTC).date()).isoformat()[:10],
        "CREATOR": f"scope_models {__version__} TargetPixelFile",
        "PROCVER": f"scope_models {__version__}",
        "SEED": str(seed) if seed is not None and seed > _MAX_CARD_INTEGER else seed,
        "TELESCOP": mission.telescope, "INSTRUME": mission.instrument, "MISSION": mission.name,
        mission.id_keyword: metadata.target_id, mission.magnitude_keyword: metadata.magnitude,
        "RA_OBJ": ra, "DEC_OBJ": dec, "MODULE": module, "OUTPUT": output,
        "SEASON": None if quarter is None else (quarter + 2) % 4,
        "OBSMODE": f"{'long' if metadata.is_long_cadence else 'short'} cadence",
        "CRMITEN": metadata.reads < metadata.n_frames,
        **dict.fromkeys(offsets, metadata.fixed_offset),
        **{f"GAIN{x}": metadata.gain for x in outputs},
        **{f"READNOI{x or 'S'}": metadata.read_noise for x in outputs},
        **{f"MEANBLC{x or 'K'}": metadata.mean_black for x in outputs},
    }  # fmt: skip


def _span(metadata, time, timecorr, used):
    zero, delta, live = metadata.layout.time_zero, metadata.cadence_days, metadata.duty_cycle
    timed = np.flatnonzero(np.isfinite(time))[[0, -1]]
    start, stop = time[timed[0]] - delta / 2, time[timed[1]] + delta / 2
    dates = calendar_dates(zero, (start, stop))
    spacecraft = (time - timecorr)[timed] + (zero - 2400000.5)
    first, last = (value.item() if np.isfinite(value) else None for value in spacecraft)
    return {
        "BJDREFI": int(zero), "EXPOSURE": used * delta * live, "TELAPSE": stop - start,
        "LIVETIME": (stop - start) * live, "TSTART": start, "TSTOP": stop, "LC_START": first,
        "LC_END": last, "DEADC": live, "TIMEDEL": delta, "DATE-OBS": dates[0], "DATE-END": dates[1],
    }  # fmt: skip


@lru_cache(maxsize=64)
def calendar_dates(zero, days):
    """Return UTC calendar dates of barycentric times, a tuple: stars of a field have the same."""
    with warnings.catch_warnings():
        # Leap seconds of years to come are not known: the date is then off by a second or so.
        warnings.filterwarnings("ignore", message=".*dubious year")
        times = Time(np.full(2, zero), np.array(days), format="jd", scale="tdb")
        return tuple(times.utc.isot.tolist())


def pixel_column_cards(columns, metadata, shape):
    """Return keyword, value and comment of the cards of the columns of the pixel table."""
    cards, places, sky = [], [], tan_projection(metadata, shape)
    displays = dict(zip("DEJ", metadata.layout.displays, strict=True))
    for n, column in enumerate(columns, 1):
        size = column.image_shape(shape)
        unit = metadata.layout.time_unit if column.name == "TIME" else column.unit
        defined = [
            ("TTYPE", column.name, f"column title: {column.title}"),
            ("TFORM", f"{size[0] * size[1] if size else ''}{column.kind}", "column format"),
            ("TUNIT", unit, "column unit"),
            ("TNULL", column.null, "value of pixels without data"),
            ("TDISP", column.display or displays[column.kind], "column display format"),
            ("TDIM", f"({size[1]},{size[0]})" if size else None, "column dimensions"),
        ]
        cards += [(f"{name}{n}", value, text) for name, value, text in defined if value is not None]
        if column.is_pixels:
            places += _column_wcs(n, metadata, sky)
    return [*cards, *places]


def wcs_keywords(n):
    """Return the keywords on the coordinates of column n, by those of an image."""
    axes = {f"{name}{i}": f"{i}{own}{n}" for name, own in _WCS.items() for i in "12"}
    return axes | {name: f"{name[2]}{name[4]}PC{n}" for name in _MATRIX}


def _column_wcs(n, metadata, sky):
    keywords = wcs_keywords(n)
    return [
        (f"WCSN{n}P", "PHYSICAL", "name of the detector coordinates"),
        (f"WCAX{n}P", 2, "axes of the detector coordinates"),
        (f"1CTY{n}P", "RAWX", "axis 1: CCD column"), (f"2CTY{n}P", "RAWY", "axis 2: CCD row"),
        (f"1CUN{n}P", "PIXEL", "unit of axis 1"), (f"2CUN{n}P", "PIXEL", "unit of axis 2"),
        (f"1CRV{n}P", metadata.column, "CCD column of the first pixel"),
        (f"2CRV{n}P", metadata.row, "CCD row of the first pixel"),
        (f"1CDL{n}P", 1.0, "step of axis 1"), (f"2CDL{n}P", 1.0, "step of axis 2"),
        (f"1CRP{n}P", 1, "first pixel of axis 1"), (f"2CRP{n}P", 1, "first pixel of axis 2"),
        (f"WCAX{n}", 2, "axes of the sky coordinates"),
        *((keywords[name], value, comment) for name, (value, comment) in sky.items()),
    ]  # fmt: skip


def tan_projection(metadata, shape):
    """Return value and comment, by keyword, of the gnomonic projection about the target."""
    ny, nx = shape
    x_0 = (nx - 1) / 2 if metadata.x_0 is None else metadata.x_0
    y_0 = (ny - 1) / 2 if metadata.y_0 is None else metadata.y_0
    ra, dec = metadata.position
    scale = metadata.pixel_scale / 3600.0
    cosine, sine = (f(np.radians(metadata.orientation)).item() for f in (np.cos, np.sin))
    matrix, words = metadata.matrix, ("",) * 4
    if matrix is None:
        matrix = cosine, 0.0 - sine, sine, cosine
        words = (f", {name}(orientation)" for name in ("cos", "-sin", "sin", "cos"))
    return {
        "CTYPE1": ("RA---TAN", "right ascension, gnomonic projection"),
        "CTYPE2": ("DEC--TAN", "declination, gnomonic projection"),
        "CRPIX1": (x_0 + 1.0, "[pixel] reference pixel along axis 1"),
        "CRPIX2": (y_0 + 1.0, "[pixel] reference pixel along axis 2"),
        "CRVAL1": (ra, "[deg] right ascension of that pixel"),
        "CRVAL2": (dec, "[deg] declination of that pixel"),
        "CUNIT1": ("deg", "unit of right ascension"),
        "CUNIT2": ("deg", "unit of declination"),
        "CDELT1": (-scale, "[deg] pixel scale, east to the left"),
        "CDELT2": (scale, "[deg] pixel scale"),
        **{
            name: (value, f"rotation matrix{word}")
            for name, value, word in zip(_MATRIX, matrix, words, strict=True)
        },
    }


def _fill(headers, extra_cards):
    """Fill cards without a value with those of the caller, or add them to the primary header."""
    for keyword, given in extra_cards.items():
        card = _checked_card(keyword, given)
        start = f"{card.keyword:8}"
        places = [(h, i) for h in headers for i, text in enumerate(h) if text.startswith(start)]
        # The text after "=" begins with a slash where there is a comment alone.
        known = any(header[i][10:].strip()[:1] not in ("", "/") for header, i in places)
        if card.keyword in _PROTECTED or known:
            raise ValueError(f"`extra_cards` must not replace {keyword}, which the file sets")
        for header, i in places:
            comment = card.comment or fits.Card.fromstring(header[i]).comment
            header[i] = str(fits.Card(card.keyword, card.value, comment))
        if not places:
            headers[0].append(str(card))


def _checked_card(keyword, given):
    value, comment = given if isinstance(given, tuple) and len(given) == 2 else (given, "")
    if not isinstance(keyword, str) or not 1 <= len(keyword) <= 8:
        raise ValueError(f"`extra_cards` must have keywords of 1 to 8 characters, got {keyword!r}")
    value = value.item() if isinstance(value, np.generic) else value
    try:
        with warnings.catch_warnings(action="error"):
            card = fits.Card(keyword.upper(), value, comment)
            card.verify("exception")
            str(card)
    except (ValueError, TypeError, fits.VerifyError, fits.verify.VerifyWarning) as error:
        raise ValueError(f"`extra_cards` cannot hold {keyword}: {error}") from error
    if isinstance(value, str) and "EVEREST" in value.upper() and keyword.upper() == "COMMENT":
        raise ValueError("`extra_cards` must have no COMMENT with EVEREST: readers misread it")
    return card


def pixel_columns(mission):
    return [column for column in _COLUMNS if column.name not in mission.absent_columns]


def table_rows(columns, values):
    """Return the pixel table as in the file, NaN or the null value in columns without values."""
    n_cadences, *stamp = values["FLUX"].shape
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


def checked_columns(mission, values):
    """Return the arrays that are there, by the names in the file, checked against each other."""
    cube = np.shape(values["flux"])
    if len(cube) != 3 or 0 in cube:
        raise ValueError(f"`flux` must have the shape (n_cadences, ny, nx), got {cube}")
    checked = _checked_times(mission, values, cube[:1])
    for name, unit in _UNITS.items():
        value, shape = values[name], cube if name in _CUBES else cube[:1]
        # Only times, quantities and masked values have these; plain arrays are not copied.
        if any(hasattr(value, attribute) for attribute in ("unit", "mask", "jd1")):
            value = plain_array(value, unit, name)
        if value is not None:
            checked[name.upper()] = _floats(name, value, shape, broadcast=name in _CUBES)
    error, background_error = checked["FLUX_ERR"], checked["FLUX_BKG_ERR"]
    if np.any(error <= 0):
        raise ValueError(f"`flux_err` must be positive, got {np.nanmin(error)}")
    if np.any(np.isnan(error) & ~np.isnan(checked["FLUX"])):
        raise ValueError("`flux_err` must not be NaN where `flux` is not")
    if np.any(background_error < 0):
        raise ValueError(f"`flux_bkg_err` must not be negative, got {np.nanmin(background_error)}")
    if values["raw_cnts"] is not None:
        checked["RAW_CNTS"] = checked_int32("raw_cnts", values["raw_cnts"], cube)
        if checked["RAW_CNTS"].min() < -1:
            raise ValueError("`raw_cnts` must not be negative, except -1 where there are no data")
    return checked


def _checked_times(mission, values, shape):
    """Return times, cadence numbers and quality flags: no data where Kepler and K2 have no time."""
    time = _floats("time", plain_time(values["time"], mission.time_format, "time"), shape)
    known = time[np.isfinite(time)]
    if known.size == 0:
        raise ValueError("`time` must have a finite value")
    if np.any(np.diff(known) <= 0):
        raise ValueError("`time` must increase from cadence to cadence")
    number = checked_int32("cadenceno", values["cadenceno"], shape)
    if number[0] < 1 or np.any(np.diff(number) <= 0):
        raise ValueError(f"`cadenceno` must increase from at least 1, got {number[0]} first")
    quality = checked_int32("quality", values["quality"], shape)
    if quality.min() < 0:
        raise ValueError(f"`quality` must not be negative, got {quality.min()}")
    no_data = np.where(np.isnan(time), mission.quality.no_data, 0).astype(np.int32)
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
