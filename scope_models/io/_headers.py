"""Headers and data as they are in FITS files, above all in target pixel files.

astropy's checks of each card would take ten times as long.
"""

import datetime as dt
import io
import math
import warnings
from collections import namedtuple
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.time import Time

from scope_models._version import __version__
from scope_models.io._opening import checksum_of

__all__ = [
    "CHECKSUM_COMMENT", "COLLECTED", "OPTIMAL", "Block", "calendar_dates", "card_texts",
    "column_cards", "make_headers", "pixel_block", "tan_projection", "wcs_keywords", "write_blocks",
]  # fmt: skip

CHECKSUM_COMMENT = "checksum of the FITS standard"
_BLOCK = 2880
_NO_CHECKSUM = "0" * 16
_FORMS = {"i4": "J", "f4": "E", "f8": "D"}
# Characters between digits and letters, which a checksum must not have.
_EXCLUDED = {*range(0x3A, 0x41), *range(0x5B, 0x61)}
# The first cards of each kind of HDU, as astropy writes them.
_PRIMARY, _IMAGE, _TABLE = (
    [(card.keyword, card.value, card.comment) for card in hdu.header.cards]
    for hdu in (fits.PrimaryHDU(), fits.ImageHDU(np.zeros((1, 1))), fits.BinTableHDU())
)
#: Bits of the pixels that are collected, and of those in the optimal aperture.
COLLECTED, OPTIMAL = 1, 2
_LAYOUTS = Path(__file__).with_name("layouts.hdr")
# Keywords on coordinates of an image and, without their numbers, of a column.
_WCS = {"CTYPE": "CTYP", "CRPIX": "CRPX", "CRVAL": "CRVL", "CUNIT": "CUNI", "CDELT": "CDLT"}
_PHYSICAL = ("CTYPE", "CUNIT", "CRVAL", "CDELT", "CRPIX")
_MATRIX = ("PC1_1", "PC1_2", "PC2_1", "PC2_2")
_PROTECTED = ("SIMPLE", "BITPIX", "EXTEND", "NEXTEND", "EXTNAME", "EXTVER", "CHECKSUM", "DATASUM")
_CARDS = {
    "OBJECT": "name", "CHANNEL": "full_channel", "CAMERA": "camera", "CCD": "ccd",
    "QUARTER": "quarter", "CAMPAIGN": "campaign", "SECTOR": "sector", "INT_TIME": "int_time",
    "READTIME": "read_time", "FRAMETIM": "frame_time", "NUM_FRM": "n_frames", "NREADOUT": "reads",
}  # fmt: skip
_MAX_CARD_INTEGER = 2**63 - 1  # larger seeds are written as text, for readers with 64-bit integers
_ROLLING_BAND_DURATIONS = 5
_DTYPES = {"D": ">f8", "E": ">f4", "J": ">i4"}


class Block:
    """The header of an HDU as one text, and its image, its table or None.

    ``cards`` follow those that begin each header; those of a table define its columns.
    """

    def __init__(self, cards, data=None):
        if data is None:
            start, sizes = _PRIMARY, {}
        elif data.dtype.names is None:
            bits = data.dtype.itemsize * (-8 if data.dtype.kind == "f" else 8)
            start, sizes = _IMAGE, {"BITPIX": bits, "NAXIS1": data.shape[1], "NAXIS2": len(data)}
        else:
            sizes = {"NAXIS1": data.dtype.itemsize, "NAXIS2": len(data), "TFIELDS": len(data.dtype)}
            start = _TABLE
        first = [(name, sizes.get(name, value), comment) for name, value, comment in start]
        self.cards = "".join(card_texts([*first, *cards]))
        self.data = data

    def hdu(self):
        """Return the HDU, which shares its memory with the block."""
        header = fits.Header.fromstring(self.cards)
        if self.data is None:
            return fits.PrimaryHDU(header=header)
        if self.data.dtype.names is None:
            return fits.ImageHDU(self.data, header)
        hdu = fits.BinTableHDU()
        hdu.data = self.data
        # The columns find their arrays in the table. References of their own would close a ring
        # through the arrays' bases, which Python's collector of garbage does not see.
        hdu.columns.__dict__.pop("_arrays", None)
        for i, column in enumerate(hdu.columns, 1):
            for attribute, keyword in (("disp", "TDISP"), ("unit", "TUNIT"), ("null", "TNULL")):
                if f"{keyword}{i}" in header:
                    setattr(column, attribute, header[f"{keyword}{i}"])
            column.__dict__.pop("array", None)
        hdu.header = header
        return hdu

    def write(self, stream):
        """Write header, checksums and data to a binary stream."""
        data = np.empty(0, np.uint8)
        if self.data is not None:
            data = np.ascontiguousarray(self.data, self.data.dtype.newbyteorder(">"))
            data = data.reshape(-1).view(np.uint8)
        total = checksum_of(data)
        text = self.cards + _card("CHECKSUM", _NO_CHECKSUM, CHECKSUM_COMMENT)
        text += _card("DATASUM", str(total), CHECKSUM_COMMENT)
        text = (text + "END").encode("ascii")
        text += b" " * (-len(text) % _BLOCK)
        checksum = _encoded(checksum_of(text, total) ^ 0xFFFFFFFF)
        stream.write(text.replace(f"'{_NO_CHECKSUM}'".encode(), f"'{checksum}'".encode()))
        stream.write(data.data)
        stream.write(bytes(-len(data) % _BLOCK))


def write_blocks(blocks, stream):
    """Write blocks and HDUs to a binary stream."""
    for block in blocks:
        if isinstance(block, Block):
            block.write(stream)
            continue
        block.add_checksum(when=CHECKSUM_COMMENT)
        whole = io.BytesIO()
        fits.HDUList([fits.PrimaryHDU(), block]).writeto(whole)
        stream.write(whole.getbuffer()[_BLOCK:])


def card_texts(cards):
    """Return the texts of cards, which are texts or (keyword, value, comment)."""
    return [card if isinstance(card, str) else _card(*card) for card in cards]


def _card(keyword, value, comment):
    """Return the text of a card; astropy makes all but the plainest."""
    if isinstance(value, str):
        text = f"'{value:8}'".ljust(20)
        plain = value != "" and "'" not in value and value.isascii() and value.isprintable()
    elif isinstance(value, bool):
        text, plain = f"{'FT'[value]:>20}", True
    else:
        text = f"{value!s:>20}".replace("e", "E")
        plain = len(text) == 20 and isinstance(value, int | float) and math.isfinite(value)
    card = f"{keyword:8}= {text}" + (f" / {comment}" if comment else "")
    if plain and len(card) <= 80:
        return f"{card:80}"
    return str(fits.Card(keyword, value, comment))


def column_cards(rows, titles):
    """Return the cards that define columns, with titles of some."""
    cards = []
    for i, name in enumerate(rows.dtype.names, 1):
        field = rows.dtype[name]
        title = f"column title: {titles[name]}" if name in titles else ""
        kind, size = field.base.str[1:], math.prod(field.shape)
        number = f"{size if size > 1 else ''}{_FORMS.get(kind)}"
        form = f"{field.itemsize}A" if kind[0] == "S" else number
        cards += [(f"TTYPE{i}", name, title), (f"TFORM{i}", form, "")]
        if field.shape:
            cards.append((f"TDIM{i}", f"({','.join(map(str, field.shape[::-1]))})", ""))
    return cards


def _encoded(value):
    """Return a 32-bit number as the 16 letters and digits of the card CHECKSUM."""
    letters = [0] * 16
    for i, byte in enumerate(value.to_bytes(4, "big")):
        quarter, rest = divmod(byte, 4)
        four = [0x30 + quarter + rest, *[0x30 + quarter] * 3]
        for j in (0, 2):
            while not _EXCLUDED.isdisjoint(four[j : j + 2]):
                four[j] += 1
                four[j + 1] -= 1
        letters[i::4] = four
    return bytes(letters[-1:] + letters[:-1]).decode("ascii")


_PixelColumn = namedtuple(
    "_PixelColumn",
    "name kind title unit display null is_pixels",
    defaults=(None, "", None, False),
)
_COLUMNS = (
    _PixelColumn("TIME", "D", "times of mid-cadence"),
    _PixelColumn("TIMECORR", "E", "barycentric minus spacecraft time", "d"),
    _PixelColumn("CADENCENO", "J", "number of the cadence", display="I10"),
    _PixelColumn("RAW_CNTS", "J", "raw counts", "count", "I8", -1, is_pixels=True),
    _PixelColumn("FLUX", "E", "flux less background", "e-/s", is_pixels=True),
    _PixelColumn("FLUX_ERR", "E", "standard deviation of it", "e-/s", is_pixels=True),
    _PixelColumn("FLUX_BKG", "E", "background", "e-/s", is_pixels=True),
    _PixelColumn("FLUX_BKG_ERR", "E", "its uncertainty", "e-/s", is_pixels=True),
    _PixelColumn("COSMIC_RAYS", "E", "cosmic rays", "e-/s", is_pixels=True),
    _PixelColumn("QUALITY", "J", "quality flags"),
    _PixelColumn("POS_CORR1", "E", "offset in columns", "pixel"),
    _PixelColumn("POS_CORR2", "E", "offset in rows", "pixel"),
    _PixelColumn("RB_LEVEL", "E", "rolling bands, none sought", "sigma"),
)


def make_headers(metadata, values, aperture, simdata):
    """Return texts of the cards of file, pixel table (without its columns) and aperture."""
    optimal, collected = aperture & OPTIMAL > 0, aperture & COLLECTED > 0
    facts = {
        **_facts(metadata), **_span(metadata, values), **tan_projection(metadata, aperture.shape),
        "CRVAL1P": metadata.column, "CRVAL2P": metadata.row, "NPIXSAP": int(optimal.sum()),
        "NPIXMISS": int((optimal & ~collected).sum()),
    }  # fmt: skip
    names = {} if metadata.is_long_cadence else {"LC_START": "SC_START", "LC_END": "SC_END"}
    unknown = None in (metadata.camera, metadata.ccd)
    names["TMOFST"] = None if unknown else f"TMOFST{metadata.camera}{metadata.ccd}"
    headers = []
    for cards in _template(metadata.layout.template):
        filled = []
        for keyword, text, comment in cards:
            name, value = names.get(keyword, keyword), facts.get(keyword)
            if keyword == "SIMDATA":
                filled.append(simdata)
            elif name is not None:
                card = f"{name:8}{text[8:]}" if value is None else (name, value, comment)
                filled.append(card)
        headers.append(card_texts(filled))
    if metadata.layout.template != metadata.mission.lower():
        comment = "kind of telescope; the layout is another's"
        headers[0] += card_texts([("MISSION", metadata.mission, comment)])
    _fill(headers, metadata.extra_cards)
    return headers


@cache
def _template(name):
    """Return keyword, text and comment of the cards of each header of a layout.

    Comments in the file name the layouts that have the next cards.
    """
    headers, those = [[]], ()
    for card in fits.Header.fromtextfile(_LAYOUTS).cards:
        if card.keyword == "COMMENT":
            those = card.value.split()
        elif name in those and card.keyword == "XTENSION":
            headers.append([])
        elif name in those:
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


def _span(metadata, values):
    """Return the cards on the times, days; cadences of the exposure have a time and any flux."""
    zero, delta, live = metadata.layout.time_zero, metadata.cadence_days, metadata.duty_cycle
    time, timed = values["TIME"], np.isfinite(values["TIME"])
    used = np.sum(timed & np.isfinite(values["FLUX"]).any(axis=(1, 2)))
    ends = np.flatnonzero(timed)[[0, -1]]
    start, stop = time[ends] + [-delta / 2, delta / 2]
    dates = calendar_dates(zero, (start, stop))
    spacecraft = (time - values.get("TIMECORR", np.nan))[ends] + (zero - 2400000.5)
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


def pixel_block(metadata, values, cards, image):
    """Return the pixel table: columns without values have NaN or their null value.

    The columns of pixels have the coordinates of the aperture, of which ``image`` are the cards.
    """
    n_cadences, *shape = values["FLUX"].shape
    image = {text[:8].rstrip(): text for text in image}
    if metadata.matrix is not None:  # which is not of an angle
        image |= {name: image[name].partition(",")[0] for name in _MATRIX}
    displays = dict(zip("DEJ", metadata.layout.displays, strict=True))
    columns = [item for item in _COLUMNS if item.name not in metadata.layout.absent_columns]
    fields, defined, places = [], [], []
    for n, column in enumerate(columns, 1):
        size = tuple(shape) if column.is_pixels else ()
        if column.name == "RB_LEVEL":
            size = shape[0], _ROLLING_BAND_DURATIONS
        fields.append((column.name, _DTYPES[column.kind], size))
        unit = metadata.layout.time_unit if column.name == "TIME" else column.unit
        defined += [
            (f"TTYPE{n}", column.name, f"column title: {column.title}"),
            (f"TFORM{n}", f"{math.prod(size) if size else ''}{column.kind}", "column format"),
            (f"TUNIT{n}", unit, "column unit"),
            (f"TNULL{n}", column.null, "value of pixels without data"),
            (f"TDISP{n}", column.display or displays[column.kind], "column display format"),
            (f"TDIM{n}", f"({size[1]},{size[0]})" if size else None, "column dimensions"),
        ]
        if column.is_pixels:
            names = _physical_keywords(n) | wcs_keywords(n)
            places += [f"{own:8}{image[name][8:]:72}" for name, own in names.items()]
    rows = np.empty(n_cadences, dtype=fields)
    for column in columns:
        missing = np.nan if column.null is None else column.null
        rows[column.name] = values.get(column.name, missing)
    defined = [card for card in defined if card[1] is not None]
    return Block([*defined, *places, *cards], rows)


def wcs_keywords(n):
    """Return keywords on the coordinates of column n, by those of an image."""
    axes = {f"{name}{i}": f"{i}{own}{n}" for name, own in _WCS.items() for i in "12"}
    return axes | {name: f"{name[2]}{name[4]}PC{n}" for name in _MATRIX}


def _physical_keywords(n):
    axes = {f"{name}{i}P": f"{i}{_WCS[name][:3]}{n}P" for name in _PHYSICAL for i in "12"}
    return {"WCSNAMEP": f"WCSN{n}P", "WCSAXESP": f"WCAX{n}P", **axes, "WCSAXES": f"WCAX{n}"}


def tan_projection(metadata, shape):
    """Return the values, by keyword, of the gnomonic projection about the target."""
    ny, nx = shape
    x_0 = (nx - 1) / 2 if metadata.x_0 is None else metadata.x_0
    y_0 = (ny - 1) / 2 if metadata.y_0 is None else metadata.y_0
    ra, dec = metadata.position
    scale = metadata.pixel_scale / 3600.0
    matrix = metadata.matrix
    if matrix is None:
        cosine, sine = (f(np.radians(metadata.orientation)).item() for f in (np.cos, np.sin))
        matrix = cosine, 0.0 - sine, sine, cosine
    return {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRPIX1": x_0 + 1.0, "CRPIX2": y_0 + 1.0,
        "CRVAL1": ra, "CRVAL2": dec, "CUNIT1": "deg", "CUNIT2": "deg", "CDELT1": -scale,
        "CDELT2": scale, **dict(zip(_MATRIX, matrix, strict=True)),
    }  # fmt: skip


def _fill(headers, extra_cards):
    """Fill cards without a value, or add cards to the primary header."""
    for keyword, given in extra_cards.items():
        card = _checked_card(keyword, given)
        start = f"{card.keyword:8}"
        places = [(h, i) for h in headers for i, text in enumerate(h) if text.startswith(start)]
        # A text begins with a slash where there is a comment alone.
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
