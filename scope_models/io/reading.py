"""Columns of archive files: Kepler, K2 and TESS target pixel and light-curve files.

Only arrays and header cards leave this module. Whatever is wrong with a file ends in one
`ValueError` (or `FileNotFoundError`, `IsADirectoryError`) that names the file.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scope_models._arrays import native
from scope_models._values import Value
from scope_models.io._opening import RefusedError, naming, open_fits
from scope_models.missions import TIME_ZEROS, Mission

__all__ = [
    "PositionColumns",
    "TableColumns",
    "facts_of",
    "open_fits",
    "read_columns",
    "read_positions",
    "time_format_of",
]

_TIME_FORMATS = {zero: name for name, zero in TIME_ZEROS.items()}
_NO_FACTS = {"", "COMMENT", "HISTORY", "CHECKSUM", "DATASUM", "SIMPLE", "XTENSION", "BITPIX"}
_NO_FACTS |= {"EXTEND", "PCOUNT", "GCOUNT", "TFIELDS"}
_FACTS = {
    "mission": ("MISSION", "TELESCOP"),
    "object": ("OBJECT",),
    "campaign": ("CAMPAIGN",),
    "quarter": ("QUARTER",),
    "sector": ("SECTOR",),
    "channel": ("CHANNEL",),
    "camera": ("CAMERA",),
    "ccd": ("CCD",),
    "ra": ("RA_OBJ",),
    "dec": ("DEC_OBJ",),
}


@dataclass(frozen=True, eq=False, repr=False)
class TableColumns(Value):
    """Some columns of the first binary table of a FITS file.

    Attributes
    ----------
    columns : dict of str to ndarray
        The requested columns that exist, by upper-case name; floats are float64 and
        integers keep their type, all in native byte order.
    header : dict
        Cards of the primary header, overridden by those of the table.
    path : pathlib.Path
        The file.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.io.reading import read_columns
    >>> Table({"TIME": [0.0, 0.5]}).write("times.fits")
    >>> read_columns("times.fits", ["TIME"]).columns
    {'TIME': array([0. , 0.5])}
    """

    columns: dict
    header: dict
    path: Path


@dataclass(frozen=True, eq=False, repr=False)
class PositionColumns(Value):
    """Positions of a star from an archive file: unchecked values.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times in days; NaN where there is none.
    pos_corr1, pos_corr2 : ndarray, shape (n,)
        Column and row offset in pixels; NaN or absurd where unknown.
    quality : ndarray, shape (n,), or None
        QUALITY or SAP_QUALITY, if the file has it.
    cadenceno : ndarray, shape (n,), or None
        CADENCENO, if the file has it; 1, 2, ... n where it has only zeros.
    time_format : {"bkjd", "btjd"} or None
        The header's zero of time; None if it has none.
    meta : dict
        The header's description of the source: any of mission, object, campaign, quarter, sector,
        channel, camera, ccd, ra and dec, and the name of the file as filename.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.io.reading import read_positions
    >>> columns = {"TIME": [0.0, 0.5], "POS_CORR1": [0.0, 0.1], "POS_CORR2": [0.0, 800.0]}
    >>> Table(columns).write("positions.fits")
    >>> read_positions("positions.fits").pos_corr2
    array([  0., 800.])
    """

    time: np.ndarray
    pos_corr1: np.ndarray
    pos_corr2: np.ndarray
    quality: np.ndarray | None
    cadenceno: np.ndarray | None
    time_format: str | None
    meta: dict


def read_columns(path, required, optional=()):
    """Read one-dimensional columns of numbers from the first binary table of a FITS file.

    Parameters
    ----------
    path : str or path-like
        The file, which may be compressed by gzip.
    required : iterable of str
        Names of columns that must be there; upper and lower case are the same.
    optional : iterable of str, optional
        Names of columns to read if they are there.

    Returns
    -------
    TableColumns
        The columns, and the header.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
        If there is no such file, or it is a folder.
    ValueError
        If it cannot be read as a FITS file, has no binary table, lacks a required column, has
        no rows, or if a column does not hold one number per row.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.io.reading import read_columns
    >>> Table({"TIME": [1.0, 2.0]}).write("times.fits")
    >>> read_columns("times.fits", ["TIME"]).columns
    {'TIME': array([1., 2.])}
    >>> read_columns("times.fits", ["POS_CORR1"])
    Traceback (most recent call last):
    ValueError: times.fits has no column POS_CORR1 in its first table; it has TIME
    """
    with open_fits(path) as hdus:
        table = first_table(hdus, path)
        present = [name.upper() for name in table.columns.names]
        missing = [name for name in required if name.upper() not in present]
        if missing:
            raise RefusedError(
                f"{path} has no column {' or '.join(missing)} in its first table; "
                f"it has {', '.join(present) or 'none'}"
            )
        names = [name.upper() for name in (*required, *optional) if name.upper() in present]
        columns = {name: column_of(table, name, path) for name in names}
        if len(table.data) == 0:
            raise RefusedError(f"{path} has no rows in its first table")
        header = cards_of(hdus[0].header, table.header)
    return TableColumns(columns, header, Path(path))


def read_positions(path):
    """Read time, POS_CORR1, POS_CORR2, quality and cadence numbers from an archive file.

    Kepler, K2 and TESS target pixel files and light-curve files, .fits or .fits.gz, or any FITS
    file whose first table has TIME, POS_CORR1 and POS_CORR2.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    PositionColumns
        The columns as they are, and the header's description.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
        If there is no such file, or it is a folder.
    ValueError
        If it cannot be read as a FITS file, or lacks a column, or has no rows.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from scope_models.io.reading import read_positions
    >>> Table({"TIME": [1.0], "POS_CORR1": [0.25], "POS_CORR2": [-0.5]}).write("motion.fits")
    >>> positions = read_positions("motion.fits")
    >>> float(positions.pos_corr1[0]), positions.meta
    (0.25, {'filename': 'motion.fits'})
    """
    table = read_columns(
        path, ("TIME", "POS_CORR1", "POS_CORR2"), ("QUALITY", "SAP_QUALITY", "CADENCENO")
    )
    columns, header = table.columns, table.header
    number = columns.get("CADENCENO")
    if number is not None and not number.any():  # TESScut's files have only zeros
        number = np.arange(1, len(number) + 1)
    with naming(path):
        time_format = time_format_of(header)
    return PositionColumns(
        columns["TIME"].astype(float),
        columns["POS_CORR1"].astype(float),
        columns["POS_CORR2"].astype(float),
        columns.get("QUALITY", columns.get("SAP_QUALITY")),
        number,
        time_format,
        {**facts_of(header), "filename": table.path.name},
    )


def facts_of(header):
    """Return the source described by the header of an archive file.

    Parameters
    ----------
    header : mapping
        The cards.

    Returns
    -------
    dict
        Any of mission, object, campaign, quarter, sector, channel, camera, ccd, ra and dec.

    Examples
    --------
    >>> from scope_models.io.reading import facts_of
    >>> facts_of({"TELESCOP": "TESS", "SECTOR": 15, "CAMERA": None})
    {'mission': 'TESS', 'sector': 15}
    """
    facts = {}
    for fact, cards in _FACTS.items():
        # A blank card has a value of its own class, which is neither text nor a number.
        values = [header.get(card) for card in cards]
        values = [value for value in values if isinstance(value, str | int | float) and value != ""]
        if values:
            facts[fact] = values[0]
    return facts


def time_format_of(header):
    """Return the format of the times of an archive file.

    Parameters
    ----------
    header : mapping
        Cards of the header: BJDREFI, else the mission, decide.

    Returns
    -------
    {"bkjd", "btjd"} or None
        BJD - 2454833 (Kepler, K2), BJD - 2457000 (TESS), or None if the header has none.

    Raises
    ------
    ValueError
        If BJDREFI is another day.

    Examples
    --------
    >>> from scope_models.io.reading import time_format_of
    >>> time_format_of({"BJDREFI": 2457000})
    'btjd'
    """
    reference = header.get("BJDREFI")
    if isinstance(reference, int | float):
        day = reference + (header.get("BJDREFF") or 0)
        if day not in _TIME_FORMATS:
            raise ValueError(f"`BJDREFI` must be 2454833 or 2457000, got {day}")
        return _TIME_FORMATS[day]
    mission = Mission.from_header(header)
    return mission and mission.time_format


def first_table(hdus, path):
    """Return the first binary table of a file."""
    from astropy.io import fits

    table = next((hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU)), None)
    if table is None:
        raise RefusedError(f"{path} has no binary table")
    return table


def column_of(table, name, path, ndim=1):
    """Return a column of numbers, or of images, in native byte order, floats as float64."""
    values = np.asarray(table.data[name])
    if values.ndim != ndim or values.dtype.kind not in "iuf":
        what = {1: "one number", 3: "an image of numbers"}[ndim]
        raise RefusedError(f"column {name} of {path} must hold {what} per row")
    if values.dtype.kind == "f" or ndim == 3:
        return values.astype(np.float64)
    return native(values)


def cards_of(*headers):
    """Return the cards of headers as a dict; later headers go before earlier ones.

    None stands for a blank card. Comments, checksums and sizes of the file's parts are left out.
    """
    simple = (str, bool, int, float, complex)
    return {
        key: value if isinstance(value, simple) else None
        for header in headers
        for key, value in header.items()
        if key not in _NO_FACTS and not key.startswith("NAXIS")
    }
