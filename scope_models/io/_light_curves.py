"""Files of light curves, which keep the header cards of the pixels that stay true.

Names, keywords and columns of a collection are those of MAST: "File Naming Convention", "Common
Metadata" and "Light-curve Metadata" of https://outerspace.stsci.edu/display/MASTDOCS.
"""

import datetime as dt
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.time import Time

from scope_models._version import __version__
from scope_models.io._headers import COLLECTED, OPTIMAL, calendar_dates
from scope_models.io._opening import NO_FACTS
from scope_models.io.pixels import read_pixels
from scope_models.missions import Mission

__all__ = [
    "Collection", "archive_hdulist", "ccd_label", "ccd_name", "make_light_curve_hdulist", "sha256",
]  # fmt: skip

# Cards on columns, images and their coordinates.
_OF_COLUMNS = re.compile(r"\d|WC|T(TYPE|FORM|UNIT|DISP|DIM|NULL|SCAL|ZERO)\d|NAXIS")
# Cards on the pixels' file, the pipeline's aperture, or cadences that may have been left out.
_NO_LONGER_TRUE = NO_FACTS | {
    *("NEXTEND", "EXTNAME", "EXTVER", "INHERIT", "FILEVER", "TIMVERSN", "ORIGIN", "DATE"),
    *("CREATOR", "PROCVER", "EXPOSURE", "LIVETIME", "NPIXSAP", "NPIXMISS"),
    *("CDPP3_0", "CDPP6_0", "CDPP12_0", "CDPP0_5", "CDPP1_0", "CDPP2_0", "CROWDSAP", "FLFRCSAP"),
    *("TSTART", "TSTOP", "TELAPSE", "DATE-OBS", "DATE-END", "LC_START", "LC_END"),
}
#: Instrument and filter in names. For instruments without an acronym, the convention takes a tag:
#: phot, as in the collection TESS-SPOC.
_INSTRUMENTS = {"TESS": ("phot", "tess")}
_KEPLER = "kepler", "kepler"
_RUNS = {"CAMPAIGN": "c{:02d}", "QUARTER": "q{:02d}", "SECTOR": "s{:04d}"}
_ID, _VERSION = re.compile(r"[a-z][a-z0-9-]{0,18}[a-z0-9]"), re.compile(r"\d{1,2}(\.\d{1,2}){0,2}")
_LONGEST_TARGET, _LONGEST_NAME = 30, 90  # names of a target with its run, and of a file


def make_light_curve_hdulist(tpf, columns, *, aperture, cards=()):
    """Return the FITS file of a light curve, which lightkurve reads, of its target pixel file.

    The first of the columns is TIME, in days; ``cards`` (with comments) go into the primary header.
    """
    series = read_pixels(tpf)
    if series.mission is None:
        raise ValueError("`tpf` names no known mission in MISSION or TELESCOP")
    primary = fits.PrimaryHDU()
    new = [
        ("NEXTEND", 2, "number of standard extensions"),
        ("EXTNAME", "PRIMARY", "name of extension"),
        ("ORIGIN", "Unofficial data product", "institution responsible for this file"),
        ("DATE", dt.datetime.now(dt.UTC).date().isoformat(), "file creation date"),
        # lightkurve finds the kind of a file by this word.
        ("CREATOR", "scope_models LightCurve", "program that made this file"),
        ("PROCVER", f"scope_models {__version__}", "software version"),
    ]
    primary.header.extend([*new, *_kept(tpf.hdu[0].header)], end=True)
    primary.header.update([("TELESCOP", series.mission.telescope, "telescope"), *cards])
    table = fits.BinTableHDU.from_columns(columns, name="LIGHTCURVE", ver=1)
    table.header["TUNIT1"] = (f"BJD - {series.mission.time_zero:.0f}", "days, barycentric (TDB)")
    table.header.extend(_kept(tpf.hdu[1].header), end=True)
    table.header["BJDREFI"] = (int(series.mission.time_zero), "reference of TIME, integer part")
    table.header["BJDREFF"] = (0.0, "reference of TIME, fraction of the day")
    span = _span(columns[0].array, series)
    table.header.extend(span, end=True)
    primary.header.extend([card for card in span if card[0].startswith("DATE-")], end=True)
    return fits.HDUList([primary, table, _aperture_hdu(tpf, np.asarray(aperture))])


def _kept(header, left_out=_OF_COLUMNS.match):
    cards = (card for card in header.cards if card.keyword not in _NO_LONGER_TRUE)
    return [card for card in cards if not left_out(card.keyword)]


def _span(time, series):
    known = time[np.isfinite(time)]
    if not known.size:
        raise ValueError("`columns` must begin with TIME, with a finite time")
    delta = series.header.get("TIMEDEL")
    half = delta / 2 if isinstance(delta, float) and delta > 0 else 0.0
    first, last = float(known[0] - half), float(known[-1] + half)
    dates = calendar_dates(series.mission.time_zero, (first, last))
    return [
        ("TSTART", first, "first cadence in this file begins, days as TIME"),
        ("TSTOP", last, "last cadence in this file ends, days as TIME"),
        ("TELAPSE", last - first, "[d] TSTOP - TSTART"),
        ("DATE-OBS", dates[0], "TSTART as UTC date at the barycenter"),
        ("DATE-END", dates[1], "TSTOP as UTC date at the barycenter"),
    ]


def _aperture_hdu(tpf, aperture):
    """Return the aperture as bits of pixels that are collected, and that are summed."""
    bits, cards = np.full(aperture.shape, COLLECTED, dtype=np.int32), []
    if len(tpf.hdu) > 2:
        given = np.asarray(tpf.hdu[2].data)
        if given.dtype.kind in "iu" and given.shape == bits.shape:
            bits = given.astype(np.int32) & ~OPTIMAL
        cards = _kept(tpf.hdu[2].header, re.compile("NAXIS").match)  # with its coordinates
    hdu = fits.ImageHDU(bits | np.where(aperture, OPTIMAL, 0).astype(np.int32), name="APERTURE")
    hdu.header.extend(cards, end=True)
    hdu.header["NPIXSAP"] = (int(aperture.sum()), "pixels in the aperture of the light curve")
    return hdu


@dataclass(frozen=True)
class Collection:
    """A collection of light curves in an archive."""

    id: str
    lead: str  # full name of who leads the project
    version: str
    title: str = ""  # by default the identifier
    doi: str = ""  # digital object identifier, which the archive gives

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, str) or not re.fullmatch(r"[ -~]{0,68}", value):
                wanted = "text of at most 68 ASCII characters"
                raise ValueError(f"`hlsp_{name}` must be {wanted}, got {value!r}")
        if not _ID.fullmatch(self.id.lower()):
            wanted = "2 to 20 letters, digits and hyphens, beginning with a letter"
            raise ValueError(f"`hlsp_id` must be {wanted}, got {self.id!r}")
        if not self.lead.strip():
            raise ValueError("`hlsp_lead` must name the leader of the project")
        if not _VERSION.fullmatch(self.version):
            raise ValueError(f"`hlsp_version` must be a version as 1.0, got {self.version!r}")

    def name(self, cards):
        """Return the name of a star's file from the cards of its target pixel file."""
        mission, (run, _) = Mission.from_header(cards), ccd_label(cards)
        target = re.sub(r"\s+", "", str(cards.get("OBJECT") or "")).lower()
        target = re.sub(r"[^a-z0-9+.-]+", "-", target).strip("+.-")
        if mission is None or not target:
            raise ValueError("the headers must name the mission and the target (OBJECT)")
        instrument, band = _INSTRUMENTS.get(mission.name, _KEPLER)
        place = f"{target}-{run}" if run else target
        name = f"hlsp_{self.id}_{mission.name}_{instrument}_{place}_{band}_v{self.version}_lc.fits"
        if len(place) > _LONGEST_TARGET or len(name) > _LONGEST_NAME:
            raise ValueError(f"the name of the target is too long for an archive: {place}")
        return name.lower()


def ccd_label(cards):
    """Return campaign, quarter or sector, and channel or camera and CCD; empty if unknown.

    The first is as it is in file names, "c05", "q12" or "s0015".
    """
    numbers = ((form, cards.get(keyword)) for keyword, form in _RUNS.items())
    runs = (form.format(n) for form, n in numbers if isinstance(n, int) and n >= 0)
    channel = cards.get("CHANNEL")
    if channel is None and "CCD" in cards:
        channel = f"{cards.get('CAMERA')}-{cards['CCD']}"
    return next(runs, ""), "" if channel is None else str(channel)


def ccd_name(cards):
    """Return campaign and CCD as text, "c05 CCD 31"; empty if both are unknown."""
    run, ccd = ccd_label(cards)
    return f"{run} CCD {ccd}".strip() if ccd else run


def sha256(path):
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def archive_hdulist(hdus, series, collection, path, cards=()):
    """Turn the file of a light curve into one of a collection; times are TDB.

    ``path`` is the target pixel file; ``cards`` go into the primary header.
    """
    primary, old = hdus[0].header, hdus[1]
    quality, columns = series.mission.quality_column, old.columns
    if quality != "QUALITY":  # lightkurve leaves out flagged cadences of Kepler by the other
        columns = columns + fits.ColDefs([fits.Column("QUALITY", "J", array=old.data[quality])])
    table = fits.BinTableHDU.from_columns(columns, header=old.header, name="LIGHTCURVE")
    table.columns["TIME"].unit = "d"
    shared = [
        *_times(table, series),
        ("RA_TARG", series.header.get("RA_OBJ"), "[deg] right ascension"),
        ("DEC_TARG", series.header.get("DEC_OBJ"), "[deg] declination"),
        ("RADESYS", series.header.get("RADESYS") or "ICRS", "reference frame"),
        ("FILTER", _INSTRUMENTS.get(series.mission.name, _KEPLER)[1].upper(), "name of the filter"),
    ]
    for header in (primary, table.header):
        header.remove("DATE-OBS", ignore_missing=True)
        if header.get("RADESYS", "ICRS") == "ICRS":
            header.remove("EQUINOX", ignore_missing=True)
        header.update(shared)
    primary.update([*_collection_cards(collection, series, path), *cards])
    for header in (primary, table.header, *(hdu.header for hdu in hdus[2:])):
        for card in list(header.cards):  # blank cards say nothing, and fitsverify warns of them
            if card.value is None or isinstance(card.value, fits.card.Undefined):
                del header[card.keyword]
    return fits.HDUList([hdus[0], table, *hdus[2:]])


def _times(table, series):
    first, last = table.header["TSTART"], table.header["TSTOP"]
    days = np.array([first, (first + last) / 2, last])
    times = Time(series.mission.time_zero, days, format="jd", scale="tdb")
    cards = [("TIMESYS", "TDB", "barycentric dynamical time")]
    for name, time in zip(("BEG", "AVG", "END"), times, strict=True):
        cards += [
            (f"DATE-{name}", time.isot, "TDB at the barycenter"),
            (f"MJD-{name.replace('AVG', 'MID')}", float(time.mjd), "[d] TDB at the barycenter"),
        ]
    cards.append(("TELAPSE", last - first, "[d] from the first to the last cadence"))
    exposure = table.header.get("TIMEDEL"), table.header.get("DEADC")
    if None not in exposure:
        seconds = 86400 * exposure[0] * exposure[1] * int(np.isfinite(table.data["FLUX"]).sum())
        cards.append(("XPOSURE", seconds, "[s] of all cadences, without dead time"))
    return cards


def _collection_cards(collection, series, path):
    cards = [
        ("HLSPID", collection.id.upper(), "identifier of the collection"),
        ("HLSPLEAD", collection.lead, "lead of the project"),
        ("HLSPNAME", collection.title or collection.id, "title of the collection"),
        ("HLSPTARG", str(series.header.get("OBJECT")), "target"),
        ("HLSPVER", collection.version, "version of the collection"),
        ("DOI", collection.doi, "digital object identifier"),
        ("LICENSE", "CC BY 4.0", "license of these data"),
        ("LICENURL", "https://creativecommons.org/licenses/by/4.0/", "its text"),
        ("OBSERVAT", series.mission.telescope, "observatory"),
        ("INSTRUME", series.mission.instrument, "instrument"),
        ("MISSION", series.mission.name, "mission"),
        ("TPFFILE", Path(path).name[-60:], "target pixel file"),
        ("TPFSHA", sha256(path), ""),
    ]
    if "scope_models" in str(series.header.get("CREATOR")):
        cards.append(("SIMULATD", True, "simulated pixels"))
    return cards
