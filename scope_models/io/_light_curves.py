"""The door out for light curves: files that keep the header cards of the pixels that stay true."""

import datetime as dt
import re

import numpy as np

from scope_models._version import __version__
from scope_models.io._headers import calendar_dates
from scope_models.io.pixels import read_pixels

__all__ = ["make_light_curve_hdulist"]

_COLLECTED, _OPTIMAL = 1, 2
# What describes columns, images and their coordinates in the pixels' headers.
_OF_COLUMNS = re.compile(r"\d|WC|T(TYPE|FORM|UNIT|DISP|DIM|NULL|SCAL|ZERO)\d|NAXIS")
_OF_SIZES = re.compile("NAXIS")
# What describes the pixels' file, the pipeline's aperture, or cadences that may have been left out.
_NO_LONGER_TRUE = {
    *("SIMPLE", "XTENSION", "BITPIX", "EXTEND", "NEXTEND", "PCOUNT", "GCOUNT", "TFIELDS"),
    *("EXTNAME", "EXTVER", "INHERIT", "CHECKSUM", "DATASUM", "FILEVER", "TIMVERSN"),
    *("ORIGIN", "DATE", "CREATOR", "PROCVER", "", "COMMENT", "HISTORY"),
    *("CDPP3_0", "CDPP6_0", "CDPP12_0", "CDPP0_5", "CDPP1_0", "CDPP2_0", "CROWDSAP", "FLFRCSAP"),
    *("TSTART", "TSTOP", "TELAPSE", "DATE-OBS", "DATE-END", "LC_START", "LC_END"),
    *("EXPOSURE", "LIVETIME", "NPIXSAP", "NPIXMISS"),
}


def make_light_curve_hdulist(tpf, columns, *, aperture, cards=()):
    """Return the FITS file of a light curve of lightkurve's target pixel file.

    Cards of the target pixel file that stay true (the star, the detector, the zero of time,
    exposures) are kept, with their comments; those of its columns, its aperture and its span of
    time are not. lightkurve reads the file as a ``KeplerLightCurve`` or ``TessLightCurve``. The
    first of the columns is TIME, in days; ``aperture`` are the pixels that were summed, and
    ``cards``, keywords with values and comments, are added to the primary header.
    """
    from astropy.io import fits

    series = read_pixels(tpf)
    if series.mission is None:
        raise ValueError("`tpf` names no known mission in MISSION or TELESCOP")
    sources = [hdu.header for hdu in tpf.hdu[:3]]
    primary = fits.PrimaryHDU()
    primary.header["NEXTEND"] = (2, "number of standard extensions")
    primary.header["EXTNAME"] = ("PRIMARY", "name of extension")
    new = [
        ("ORIGIN", "Unofficial data product", "institution responsible for this file"),
        ("DATE", dt.datetime.now(dt.UTC).date().isoformat(), "file creation date"),
        # lightkurve finds the kind of a file by this word.
        ("CREATOR", "scope_models LightCurve", "program that made this file"),
        ("PROCVER", f"scope_models {__version__}", "software version"),
    ]
    primary.header.extend(new, end=True)
    primary.header.extend(_kept(sources[0]), end=True)
    primary.header["TELESCOP"] = (series.mission.telescope, "telescope")
    for keyword, value, comment in cards:
        primary.header[keyword] = (value, comment)
    table = fits.BinTableHDU.from_columns(columns, name="LIGHTCURVE")
    table.header["TUNIT1"] = (f"BJD - {series.mission.time_zero:.0f}", "days, barycentric (TDB)")
    table.header.extend(_kept(sources[1]), end=True)
    table.header["BJDREFI"] = (int(series.mission.time_zero), "reference of TIME, integer part")
    table.header["BJDREFF"] = (0.0, "reference of TIME, fraction of the day")
    span = _span(columns[0].array, series)
    table.header.extend(span, end=True)
    primary.header.extend([card for card in span if card[0].startswith("DATE-")], end=True)
    return fits.HDUList([primary, table, _aperture_hdu(tpf, sources, np.asarray(aperture))])


def _kept(header, left_out=_OF_COLUMNS):
    """Return the cards of a header that stay true."""
    cards = (card for card in header.cards if card.keyword not in _NO_LONGER_TRUE)
    return [card for card in cards if not left_out.match(card.keyword)]


def _span(time, series):
    """Return the cards of the span of time of the cadences that are left."""
    known = np.asarray(time, dtype=float)
    known = known[np.isfinite(known)]
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


def _aperture_hdu(tpf, sources, aperture):
    """Return the aperture: bit 1 for pixels that are collected, bit 2 for those that are summed."""
    from astropy.io import fits

    bits = np.full(aperture.shape, _COLLECTED, dtype=np.int32)
    if len(sources) > 2:
        given = np.asarray(tpf.hdu[2].data)
        if given.dtype.kind in "iu" and given.shape == bits.shape:
            bits = given.astype(np.int32) & ~_OPTIMAL
    hdu = fits.ImageHDU(bits | np.where(aperture, _OPTIMAL, 0).astype(np.int32), name="APERTURE")
    if len(sources) > 2:
        hdu.header.extend(_kept(sources[2], _OF_SIZES), end=True)  # with its coordinates
    hdu.header["NPIXSAP"] = (int(aperture.sum()), "pixels in the aperture of the light curve")
    return hdu
