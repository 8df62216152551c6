"""The headers of a target pixel file: a template for each mission, and the computed cards."""

import datetime as dt
import warnings
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from scope_models._version import __version__
from scope_models.io._blocks import card_texts

__all__ = ["calendar_dates", "make_headers", "pixel_column_cards", "tan_projection"]

_LAYOUTS = Path(__file__).with_name("layouts")
_MATRIX = ("PC1_1", "PC1_2", "PC2_1", "PC2_2")
_PROTECTED = ("SIMPLE", "BITPIX", "EXTEND", "NEXTEND", "EXTNAME", "EXTVER", "CHECKSUM", "DATASUM")
_CARDS = {
    "OBJECT": "name", "CHANNEL": "full_channel", "CAMERA": "camera", "CCD": "ccd",
    "QUARTER": "quarter", "CAMPAIGN": "campaign", "SECTOR": "sector", "INT_TIME": "int_time",
    "READTIME": "read_time", "FRAMETIM": "frame_time", "NUM_FRM": "n_frames", "NREADOUT": "reads",
}  # fmt: skip
_MAX_CARD_INTEGER = 2**63 - 1  # larger seeds are written as text, for readers with 64-bit integers


def make_headers(metadata, time, timecorr, used, aperture):
    """Return the cards of file, pixel table (without its columns) and aperture, as texts.

    Times are days, NaN where unknown; ``used`` cadences have a time and any flux.
    """
    optimal, collected = aperture & 2 > 0, aperture & 1 > 0
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
    from astropy.io import fits

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
    from astropy.time import Time

    with warnings.catch_warnings():
        # Leap seconds of years to come are not known: the date is then off by a second or so.
        warnings.filterwarnings("ignore", message=".*dubious year")
        times = Time(np.full(2, zero), np.array(days), format="jd", scale="tdb")
        return tuple(times.utc.isot.tolist())


def pixel_column_cards(columns, metadata, shape):
    """Return keyword, value and comment of the cards of the columns of the pixel table."""
    cards, places = [], []
    for n, column in enumerate(columns, 1):
        cards.append((f"TTYPE{n}", column.name, f"column title: {column.title}"))
        size = column.image_shape(shape)
        form = f"{size[0] * size[1] if size else ''}{column.kind}"
        cards.append((f"TFORM{n}", form, "column format"))
        if column.unit:
            cards.append((f"TUNIT{n}", column.unit, "column unit"))
        if column.null is not None:
            cards.append((f"TNULL{n}", column.null, "value of pixels without data"))
        cards.append((f"TDISP{n}", column.display, "column display format"))
        if size:
            cards.append((f"TDIM{n}", f"({size[1]},{size[0]})", "column dimensions"))
        if column.is_pixels:
            places += _column_wcs(n, metadata, shape)
    return [*cards, *places]


def _column_wcs(n, metadata, shape):
    sky = tan_projection(metadata, shape)
    cards = [
        (f"WCSN{n}P", "PHYSICAL", "name of the detector coordinates"),
        (f"WCAX{n}P", 2, "axes of the detector coordinates"),
        (f"1CTY{n}P", "RAWX", "axis 1: CCD column"), (f"2CTY{n}P", "RAWY", "axis 2: CCD row"),
        (f"1CUN{n}P", "PIXEL", "unit of axis 1"), (f"2CUN{n}P", "PIXEL", "unit of axis 2"),
        (f"1CRV{n}P", metadata.column, "CCD column of the first pixel"),
        (f"2CRV{n}P", metadata.row, "CCD row of the first pixel"),
        (f"1CDL{n}P", 1.0, "step of axis 1"), (f"2CDL{n}P", 1.0, "step of axis 2"),
        (f"1CRP{n}P", 1, "first pixel of axis 1"), (f"2CRP{n}P", 1, "first pixel of axis 2"),
        (f"WCAX{n}", 2, "axes of the sky coordinates"),
    ]  # fmt: skip
    short = {"CTYPE": "CTYP", "CRPIX": "CRPX", "CRVAL": "CRVL", "CUNIT": "CUNI", "CDELT": "CDLT"}
    for keyword, (value, comment) in sky.items():
        if keyword.startswith("PC"):
            cards.append((f"{keyword[2]}{keyword[4]}PC{n}", value, comment))
        else:
            cards.append((f"{keyword[5]}{short[keyword[:5]]}{n}", value, comment))
    return cards


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
    from astropy.io import fits

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
    from astropy.io import fits

    value, comment = given if isinstance(given, tuple) and len(given) == 2 else (given, "")
    if not isinstance(keyword, str) or not 1 <= len(keyword) <= 8:
        raise ValueError(f"`extra_cards` must have keywords of 1 to 8 characters, got {keyword!r}")
    value = value.item() if isinstance(value, np.generic) else value
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            card = fits.Card(keyword.upper(), value, comment)
            card.verify("exception")
            str(card)
    except (ValueError, TypeError, fits.VerifyError, fits.verify.VerifyWarning) as error:
        raise ValueError(f"`extra_cards` cannot hold {keyword}: {error}") from error
    if isinstance(value, str) and "EVEREST" in value.upper() and keyword.upper() == "COMMENT":
        raise ValueError("`extra_cards` must have no COMMENT with EVEREST: readers misread it")
    return card
