"""The cards of a target pixel file, in the order of the archive's files."""

import warnings

import numpy as np

from scope_models._version import __version__
from scope_models.io._labels import LABELS

__all__ = ["aperture_cards", "column_cards", "primary_cards", "time_cards"]

_MAX_CARD_INTEGER = 2**63 - 1  # larger seeds are written as text, for readers with 64-bit integers


def primary_cards(metadata, span):
    """Return the cards of the primary header.

    Parameters
    ----------
    metadata : TPFMetadata
        The facts.
    span : dict
        What `time_cards` returns; TESS files have some of it here too.

    Returns
    -------
    list of tuple
        Keyword, value and comment.
    """
    tess = metadata.mission == "TESS"
    cards = [
        ("EXTNAME", "PRIMARY", "name of extension"),
        ("EXTVER", 1, "version of extension"),
        ("SIMDATA", True, "the data are simulated"),
        ("ORIGIN", "scope_models", "what made the file"),
        ("DATE", metadata.creation_date, "day on which the file was made"),
        *([span[key] for key in ("TSTART", "TSTOP", "DATE-OBS", "DATE-END")] if tess else []),
        ("CREATOR", f"scope_models {__version__} TargetPixelFile", "program"),
        ("PROCVER", f"scope_models {__version__}", "software version"),
        ("FILEVER", metadata.layout.file_version, "archive format that the file follows"),
        ("TIMVERSN", "OGIP/93-003", "conventions of the time cards"),
        ("TELESCOP", metadata.layout.telescope, "telescope"),
        ("INSTRUME", metadata.layout.instrument, "detector"),
    ]
    cards += _tess_target(metadata) if tess else _kepler_target(metadata)
    seed = metadata.seed
    if seed is not None and seed > _MAX_CARD_INTEGER:
        seed = str(seed)
    return [*cards, ("SEED", seed, "seed of the simulation")]


def _place(metadata):
    ra, dec = metadata.position
    return [
        ("RADESYS", "ICRS", "frame of celestial coordinates"),
        ("RA_OBJ", ra, "[deg] right ascension"),
        ("DEC_OBJ", dec, "[deg] declination"),
        ("EQUINOX", 2000.0, "equinox of celestial coordinates"),
    ]


def _unknown(keywords):
    """Return cards without a value for what a simulated star does not have."""
    return [(keyword, None, LABELS[keyword]) for keyword in keywords.split()]


def _kepler_target(metadata):
    """Return the cards of Kepler and K2 that tell target, place and observation."""
    kepler = metadata.mission == "Kepler"
    module, output = metadata.module_and_output
    quarter = metadata.quarter
    run = [("CAMPAIGN", metadata.campaign, "observing campaign")]
    if kepler:
        season = None if quarter is None else (quarter + 2) % 4
        run = [
            ("QUARTER", quarter, "observing quarter"),
            ("SEASON", season, "roll orientation of the quarter"),
        ]
    return [
        ("OBJECT", metadata.name, "name of the target"),
        ("KEPLERID", metadata.target_id, "number of the target"),
        ("CHANNEL", metadata.full_channel, "CCD channel"),
        *(_unknown("SKYGROUP") if kepler else []),
        ("MODULE", module, "CCD module"),
        ("OUTPUT", output, "CCD output"),
        *run,
        *_unknown("DATA_REL"),
        ("OBSMODE", f"{_cadence(metadata)} cadence", "observing mode"),
        ("MISSION", metadata.mission, "mission"),
        *_unknown("TTABLEID"),
        *_place(metadata),
        *_unknown("PMRA PMDEC PMTOTAL PARALLAX GLON GLAT GMAG RMAG IMAG ZMAG"),
        *(_unknown("D51MAG") if kepler else []),
        *_unknown("JMAG HMAG KMAG"),
        ("KEPMAG", metadata.magnitude, "[mag] Kepler magnitude Kp"),
        *_unknown("GRCOLOR JKCOLOR GKCOLOR TEFF LOGG FEH EBMINUSV AV RADIUS TMINDEX"),
        *(_unknown("SCPID") if kepler else []),
    ]


def _tess_target(metadata):
    """Return the cards of TESS that tell target, place and observation."""
    return [
        *_unknown("DATA_REL"),
        ("OBJECT", metadata.name, "name of the target"),
        ("TICID", metadata.target_id, "number of the target"),
        ("SECTOR", metadata.sector, "observing sector"),
        ("CAMERA", metadata.camera, "camera"),
        ("CCD", metadata.ccd, "CCD of the camera"),
        *_unknown("PXTABLE"),
        *_place(metadata),
        *_unknown("PMRA PMDEC PMTOTAL"),
        ("TESSMAG", metadata.magnitude, "[mag] TESS magnitude T"),
        *_unknown("TEFF LOGG MH RADIUS TICVER"),
        ("CRMITEN", metadata.reads < metadata.n_frames, "mitigation of cosmic rays on board"),
        *_unknown("CRBLKSZ"),
        ("CRSPOC", False, "no later cleaning of cosmic rays"),
    ]


def _cadence(metadata):
    return "long" if metadata.is_long_cadence else "short"


def column_cards(number, column, metadata, shape):
    """Return the cards of one column of the pixel table.

    Parameters
    ----------
    number : int
        Number of the column, from 1.
    column : PixelColumn
        The column.
    metadata : TPFMetadata
        The facts.
    shape : tuple of int
        Rows and columns of the stamp.

    Returns
    -------
    list of tuple
        Keyword, value and comment.
    """
    n = number
    cards = [
        (f"TTYPE{n}", column.name, f"column title: {column.title}"),
        (f"TFORM{n}", column.form(shape), "column format"),
    ]
    if column.unit:
        cards.append((f"TUNIT{n}", column.unit, "column unit"))
    cards.append((f"TDISP{n}", column.display, "column display format"))
    if column.image_shape(shape):
        rows, columns = column.image_shape(shape)
        cards.append((f"TDIM{n}", f"({columns},{rows})", "column dimensions"))
    if column.null is not None:
        cards.append((f"TNULL{n}", column.null, "value of pixels without data"))
    return [*cards, *_column_wcs(n, metadata, shape)] if column.is_pixels else cards


def _column_wcs(n, metadata, shape):
    """Return the cards of detector and sky coordinates of a column of images."""
    sky = _tan_projection(metadata, shape)
    cards = [
        (f"WCSN{n}P", "PHYSICAL", "name of the detector coordinates"),
        (f"WCAX{n}P", 2, "axes of the detector coordinates"),
        (f"1CTY{n}P", "RAWX", "axis 1: CCD column"),
        (f"2CTY{n}P", "RAWY", "axis 2: CCD row"),
        (f"1CUN{n}P", "PIXEL", "unit of axis 1"),
        (f"2CUN{n}P", "PIXEL", "unit of axis 2"),
        (f"1CRV{n}P", metadata.column, "CCD column of the first pixel"),
        (f"2CRV{n}P", metadata.row, "CCD row of the first pixel"),
        (f"1CDL{n}P", 1.0, "step of axis 1"),
        (f"2CDL{n}P", 1.0, "step of axis 2"),
        (f"1CRP{n}P", 1, "first pixel of axis 1"),
        (f"2CRP{n}P", 1, "first pixel of axis 2"),
        (f"WCAX{n}", 2, "axes of the sky coordinates"),
    ]
    short = {"CTYPE": "CTYP", "CRPIX": "CRPX", "CRVAL": "CRVL", "CUNIT": "CUNI", "CDELT": "CDLT"}
    for keyword, (value, comment) in sky.items():
        if keyword.startswith("PC"):
            cards.append((f"{keyword[2]}{keyword[4]}PC{n}", value, comment))
        else:
            cards.append((f"{keyword[5]}{short[keyword[:5]]}{n}", value, comment))
    return cards


def _tan_projection(metadata, shape):
    """Return keyword: (value, comment) of the gnomonic projection about the target."""
    ny, nx = shape
    x_0 = (nx - 1) / 2 if metadata.x_0 is None else metadata.x_0
    y_0 = (ny - 1) / 2 if metadata.y_0 is None else metadata.y_0
    ra, dec = metadata.position
    scale = metadata.pixel_scale / 3600.0
    cosine, sine = (f(np.radians(metadata.orientation)).item() for f in (np.cos, np.sin))
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
        "PC1_1": (cosine, "rotation matrix, cos(orientation)"),
        "PC1_2": (0.0 - sine, "rotation matrix, -sin(orientation)"),
        "PC2_1": (sine, "rotation matrix, sin(orientation)"),
        "PC2_2": (cosine, "rotation matrix, cos(orientation)"),
    }


def _extension(metadata, name):
    """Return the cards with which the pixel table and the aperture begin."""
    return [
        ("INHERIT", True, "the primary header holds here too"),
        ("EXTNAME", name, "name of extension"),
        ("EXTVER", 1, "version of extension"),
        ("SIMDATA", True, "the data are simulated"),
        ("TELESCOP", metadata.layout.telescope, "telescope"),
        ("INSTRUME", metadata.layout.instrument, "detector"),
        ("OBJECT", metadata.name, "name of the target"),
        (metadata.layout.id_keyword, metadata.target_id, "number of the target"),
        *_place(metadata),
    ]


def time_cards(metadata, time, timecorr, used):
    """Return the cards of the pixel table that follow its columns.

    Parameters
    ----------
    metadata : TPFMetadata
        The facts.
    time : ndarray, shape (n,)
        Times of mid-cadence, days, NaN where there is none.
    timecorr : ndarray, shape (n,)
        Barycentric minus spacecraft time, days, NaN where unknown.
    used : int
        Number of cadences with a time and any flux.

    Returns
    -------
    dict of str to tuple
        Keyword to keyword, value and comment, in order.
    """
    layout, delta = metadata.layout, metadata.cadence_days
    timed = np.flatnonzero(np.isfinite(time))[[0, -1]]
    start, stop = time[timed[0]] - delta / 2, time[timed[1]] + delta / 2
    live = metadata.duty_cycle
    dates = _calendar_dates(layout.time_zero, (start, stop))
    cards = [
        *_extension(metadata, layout.table_name),
        ("EXPOSURE", used * delta * live, "[d] time on source"),
        ("TIMEREF", "SOLARSYSTEM", "times are barycentric"),
        ("TASSIGN", "SPACECRAFT", "where times are assigned"),
        ("TIMESYS", "TDB", "barycentric dynamical time"),
        ("BJDREFI", int(layout.time_zero), "day from which times are counted"),
        ("BJDREFF", 0.0, "fraction of that day"),
        ("TIMEUNIT", "d", "unit of TIME, TSTART and TSTOP"),
        ("TELAPSE", stop - start, "[d] TSTOP - TSTART"),
        ("LIVETIME", (stop - start) * live, "[d] TELAPSE times DEADC"),
        ("TSTART", start, "start of the first cadence"),
        ("TSTOP", stop, "end of the last cadence"),
        *(_cadence_span(metadata, (time - timecorr)[timed]) if layout.run != "sector" else []),
        ("DEADC", live, "part of the time that gathers light"),
        ("TIMEPIXR", 0.5, "times are those of mid-cadence"),
        *_unknown("TIERRELA"),
        *(_unknown("TIERABSO") if layout.run != "sector" else []),
        ("INT_TIME", metadata.int_time, "[s] exposure of a frame"),
        ("READTIME", metadata.read_time, "[s] read-out of a frame"),
        ("FRAMETIM", metadata.frame_time, "[s] INT_TIME + READTIME"),
        ("NUM_FRM", metadata.n_frames, "frames per cadence"),
        ("TIMEDEL", delta, "[d] length of a cadence"),
        ("DATE-OBS", dates[0], "TSTART as UTC calendar date"),
        ("DATE-END", dates[1], "TSTOP as UTC calendar date"),
        ("BACKAPP", True, "background is subtracted"),
        ("DEADAPP", True, "fluxes are per second of exposure"),
        ("VIGNAPP", False, "no vignetting, no correction"),
        *(_tess_detector(metadata) if layout.run == "sector" else _kepler_detector(metadata)),
    ]
    return {card[0]: card for card in cards}


def _calendar_dates(reference, days):
    """Return UTC calendar dates of barycentric times."""
    from astropy.time import Time

    with warnings.catch_warnings():
        # Leap seconds of years to come are not known: the date is then off by a second or so.
        warnings.filterwarnings("ignore", message=".*dubious year")
        times = Time(np.full(2, float(reference)), np.array(days), format="jd", scale="tdb")
        return times.utc.isot.tolist()


def _cadence_span(metadata, spacecraft_time):
    """Return LC_START and LC_END (SC_START, SC_END), which need a known TIMECORR."""
    prefix = "LC" if metadata.is_long_cadence else "SC"
    mjd = spacecraft_time + (metadata.layout.time_zero - 2400000.5)
    first, last = (value.item() if np.isfinite(value) else None for value in mjd)
    return [
        (f"{prefix}_START", first, "middle of the first cadence, MJD"),
        (f"{prefix}_END", last, "middle of the last cadence, MJD"),
    ]


def _kepler_detector(metadata):
    offsets = {"LCFXDOFF": None, "SCFXDOFF": None}
    offsets["LCFXDOFF" if metadata.is_long_cadence else "SCFXDOFF"] = metadata.fixed_offset
    return [
        ("GAIN", metadata.gain, "[electrons/count] gain"),
        ("READNOIS", metadata.read_noise, "[electrons] noise of one read"),
        ("NREADOUT", metadata.reads, "reads per cadence"),
        *_unknown("TIMSLICE"),
        ("MEANBLCK", metadata.mean_black, "[count] black level of one read"),
        ("LCFXDOFF", offsets["LCFXDOFF"], "[count] offset of RAW_CNTS, long cadence"),
        ("SCFXDOFF", offsets["SCFXDOFF"], "[count] offset of RAW_CNTS, short cadence"),
        *_unknown("CDPP3_0 CDPP6_0 CDPP12_0 CROWDSAP FLFRCSAP"),
        *(
            _unknown("DBCOLCO DBTHRES RBTDUR1 RBTDUR2 RBTDUR3 RBTDUR4 RBTDUR5 BLKALGO")
            if metadata.mission == "K2"
            else []
        ),
    ]


def _tess_detector(metadata):
    outputs = "ABCD"
    place = (metadata.camera, metadata.ccd)
    return [
        *((f"GAIN{x}", metadata.gain, f"[electrons/count] gain, output {x}") for x in outputs),
        *((f"READNOI{x}", metadata.read_noise, f"[electrons] noise, output {x}") for x in outputs),
        ("NREADOUT", metadata.reads, "reads per cadence"),
        ("FXDOFF", metadata.fixed_offset, "[count] offset of RAW_CNTS"),
        *_unknown("CDPP0_5 CDPP1_0 CDPP2_0 CROWDSAP FLFRCSAP"),
        *([] if None in place else [("TMOFST{}{}".format(*place), None, "[s] read-out delay")]),
        *((f"MEANBLC{x}", metadata.mean_black, f"[count] black level, {x}") for x in outputs),
    ]


def aperture_cards(metadata, aperture):
    """Return the cards of the aperture.

    Parameters
    ----------
    metadata : TPFMetadata
        The facts.
    aperture : ndarray of int, shape (ny, nx)
        Bit 1 for pixels that are collected, bit 2 for those of the optimal aperture.

    Returns
    -------
    list of tuple
        Keyword, value and comment.
    """
    optimal, collected = aperture & 2 > 0, aperture & 1 > 0
    sky = _tan_projection(metadata, aperture.shape)
    return [
        *_extension(metadata, "APERTURE"),
        ("WCSAXES", 2, "axes of the sky coordinates"),
        *((keyword, *value) for keyword, value in sky.items()),
        ("WCSNAMEP", "PHYSICAL", "name of the detector coordinates"),
        ("WCSAXESP", 2, "axes of the detector coordinates"),
        ("CTYPE1P", "RAWX", "axis 1: CCD column"),
        ("CUNIT1P", "PIXEL", "unit of axis 1"),
        ("CRPIX1P", 1, "first pixel of axis 1"),
        ("CRVAL1P", metadata.column, "CCD column of the first pixel"),
        ("CDELT1P", 1.0, "step of axis 1"),
        ("CTYPE2P", "RAWY", "axis 2: CCD row"),
        ("CUNIT2P", "PIXEL", "unit of axis 2"),
        ("CRPIX2P", 1, "first pixel of axis 2"),
        ("CRVAL2P", metadata.row, "CCD row of the first pixel"),
        ("CDELT2P", 1.0, "step of axis 2"),
        ("NPIXSAP", int(optimal.sum()), "pixels in the optimal aperture"),
        ("NPIXMISS", int((optimal & ~collected).sum()), "pixels of it that are not collected"),
    ]
