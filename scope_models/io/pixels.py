"""The one way from a target pixel file, in memory or on disk, to arrays."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Integral
from os import PathLike
from types import MappingProxyType, SimpleNamespace

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS, FITSFixedWarning

from scope_models._arrays import plain_array, plain_time, without_unit
from scope_models._checks import one_line
from scope_models._values import Value, frozen
from scope_models.io import _opening
from scope_models.io._headers import OPTIMAL, wcs_keywords
from scope_models.io._opening import RefusedError
from scope_models.missions import TIME_ZEROS, Mission

__all__ = ["PixelSeries", "read_pixels", "read_tpf", "usable_positions"]

_OF_LIGHTKURVE = ("TIME", "CADENCENO", "FLUX", "FLUX_ERR", "QUALITY")
#: Larger offsets mark missing positions: archive files have -83 to -1023 px.
LARGEST_OFFSET = 50.0


@dataclass(frozen=True, eq=False, repr=False)
class PixelSeries(Value):
    """The pixels of a star, as a target pixel file holds them.

    `read_pixels` makes it. The arrays are read-only. ``series[a:b]`` and ``series[mask]`` choose
    cadences.

    Parameters
    ----------
    time : ndarray of shape (n,)
        Days since the mission's zero of time (BKJD or BTJD); NaN where there is none.
    cadenceno : ndarray of int, shape (n,)
        Numbers of the cadences; 1, 2, ... n where the file has none, or only zeros.
    quality : ndarray of int, shape (n,)
        Quality flags.
    flux, flux_err : ndarray of shape (n, ny, nx)
        Flux less background and its standard deviation, e-/s; NaN where there is none or infinity.
    flux_bkg : ndarray of shape (n, ny, nx) or None
        Background that was subtracted, e-/s; None if the file has none.
    pos_corr : ndarray of shape (n, 2) or None
        POS_CORR1 and POS_CORR2, column and row offset, pixels, absurd values too (see
        `usable_positions`); None if the file has none.
    aperture : ndarray of bool, shape (ny, nx)
        The optimal aperture of the file; all pixels if the file has none.
    header : mapping
        Cards of the primary header, overridden by the table's; None for blank cards.
    mission : Mission or None
        The mission; None if the headers name none.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, read_pixels, simulate
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
    >>> series = read_pixels(observation.write("star.fits"))
    >>> series
    <PixelSeries K2: 50 cadences of 11 x 11 pixels, BKJD 2144.1028 to 2145.1040>
    >>> series == read_pixels("star.fits")
    True
    >>> len(series[10:])
    40
    """

    time: np.ndarray
    cadenceno: np.ndarray
    quality: np.ndarray
    flux: np.ndarray
    flux_err: np.ndarray
    flux_bkg: np.ndarray | None
    pos_corr: np.ndarray | None
    aperture: np.ndarray
    header: Mapping
    mission: Mission | None

    def __post_init__(self):
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, frozen(value))
        object.__setattr__(self, "header", MappingProxyType(dict(self.header)))

    def __repr__(self):
        n, ny, nx = self.flux.shape
        name = self.mission.name if self.mission else "of no known mission"
        known, span = self.time[np.isfinite(self.time)], "no times"
        if known.size:
            span = f"{self.time_format.upper()} {known[0]:.4f} to {known[-1]:.4f}"
        return f"<PixelSeries {name}: {n} cadences of {ny} x {nx} pixels, {span}>"

    def __len__(self):
        return len(self.time)

    def __getitem__(self, cadences):
        if isinstance(cadences, Integral):
            raise TypeError(f"cadences are chosen by slices or masks, got {cadences!r}")
        # All arrays but the masks of pixels have a value for each cadence.
        arrays = {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return self.replace(**{k: v[cadences] for k, v in arrays.items() if v.dtype != bool})

    @property
    def time_format(self):
        """Zero of the times, "bkjd" or "btjd"; "bkjd" if the headers name none."""
        return _opening.time_format_of(self.header) or "bkjd"

    def without_flagged(self, quality_bitmask="default"):
        """Leave out cadences by their quality flags, as lightkurve does.

        Parameters
        ----------
        quality_bitmask : {"default", "none"} or int, optional
            Cadences with any of these bits are left out: "default" stands for the mission's
            `~scope_models.missions.QualityBits.rejected`. TESS cadences without a time go too.

        Returns
        -------
        PixelSeries
            The cadences that are left.

        Raises
        ------
        ValueError
            If no cadence is left, or the choice is unknown.
        """
        named = {"none": 0, "default": self.mission.quality.rejected if self.mission else 0}
        bits = named.get(quality_bitmask) if isinstance(quality_bitmask, str) else quality_bitmask
        is_integer = isinstance(bits, Integral) and not isinstance(bits, bool)
        if not is_integer:
            wanted = '"default", "none" or an integer'
            raise ValueError(f"`quality_bitmask` must be {wanted}, got {quality_bitmask!r}")
        keep = (self.quality & int(bits)) == 0
        if bits and self.mission is not None and not self.mission.quality.no_data:
            keep &= np.isfinite(self.time)
        if not keep.any():
            raise ValueError(f"all {len(self)} cadences have quality flags of {bits}")
        return self if keep.all() else self[keep]


def read_pixels(source, *, quality_bitmask=None):
    """Read the pixels of a target pixel file.

    Parameters
    ----------
    source : lightkurve.TargetPixelFile, str, path-like, astropy.io.fits.HDUList or PixelSeries
        A target pixel file of Kepler, K2, TESS, TESScut or a simulation: the object, with its
        cadences, or a file, .fits or .fits.gz.
    quality_bitmask : {"none", "default"} or int, optional
        Quality flags whose cadences are left out: see `PixelSeries.without_flagged`. By default
        "default" for the path of a file, as ``lightkurve.read`` does, and "none" for objects.

    Returns
    -------
    PixelSeries
        The pixels.

    Raises
    ------
    TypeError
        If the source is not a target pixel file.
    OSError
        If the file cannot be opened.
    ValueError
        If the file, which the message names, is damaged or too large, lacks a column, has no usable
        time or no cadence, or its times do not increase.

    Warns
    -----
    DamagedFileWarning
        If a checksum in the file does not match.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, read_pixels, simulate
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
    >>> series = read_pixels(observation.write("star.fits"))
    >>> series.flux.shape, series.header["OBJECT"], series.mission.name
    ((50, 11, 11), 'SIM 1', 'K2')
    """
    name = "`tpf`"
    if isinstance(source, PixelSeries):
        series = source
    elif isinstance(source, str | PathLike):
        name = source
        with _opening.open_fits(source) as hdus:
            series = _of_hdus(hdus, source)
    elif isinstance(source, fits.HDUList):
        series = _of_hdus(source, name)
    elif _has_file(source):
        series = _of_hdus(source.hdu, name)[source.quality_mask]
    else:
        raise _no_tpf(source)
    if series is not source:
        _check_times(series, name)
    if quality_bitmask is None:
        quality_bitmask = "default" if isinstance(source, str | PathLike) else "none"
    with _opening.naming(name):
        return series.without_flagged(quality_bitmask)


def read_tpf(source, *, quality_bitmask="default"):
    """Read a target pixel file as lightkurve's object, after the checks of `read_pixels`.

    No file stays open.

    Parameters
    ----------
    source : str, path-like or lightkurve.TargetPixelFile
        The file, .fits or .fits.gz; an object is returned as it is.
    quality_bitmask : {"default", "none"} or int, optional
        Quality flags whose cadences are left out, as in ``lightkurve.read``.

    Returns
    -------
    lightkurve.TargetPixelFile
        A ``KeplerTargetPixelFile`` or a ``TessTargetPixelFile``.

    Raises
    ------
    TypeError
        If the source is a `PixelSeries`, which has no light curves.
    OSError, ValueError
        As `read_pixels`, or if the headers name no mission.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.io import read_tpf
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.still(50), seed=1)
    >>> read_tpf(observation.write("star.fits")).flux.shape
    (50, 11, 11)
    """
    if not isinstance(source, str | PathLike):
        if not _has_file(source):
            raise _no_tpf(source)
        _check_place(_opening.cards_of(source.hdu[1].header), "`tpf`")
        return source
    import lightkurve

    with _opening.open_fits(source) as hdus:
        series = _of_hdus(hdus, source)
        columns = {name.upper() for name in _opening.first_table(hdus, source).columns.names}
        whole = fits.HDUList([hdu for hdu in hdus if hdu.data is None or len(hdu.data) >= 0])
    _check_times(series, source)
    if series.mission is None:
        raise ValueError(f"{source} names no known mission in MISSION or TELESCOP")
    for name in _OF_LIGHTKURVE:
        if name not in columns:
            raise ValueError(f"lightkurve cannot read {source}: it has no column {name}")
    _check_place(series.header, source)
    with _opening.naming(source):
        series.without_flagged(quality_bitmask)
    kind = getattr(lightkurve, series.mission.tpf_class)
    try:
        return kind(whole, quality_bitmask=quality_bitmask)
    except Exception as error:  # lightkurve expects more columns than `read_pixels` needs
        raise ValueError(f"lightkurve cannot read {source}: {one_line(error)}") from error


def usable_positions(pos_corr):
    """Return where positions are offsets of a star: archive files hold others where there is none.

    Parameters
    ----------
    pos_corr : array_like of shape (n, 2)
        Column and row offset, pixels.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where both are less than 50 px.

    Examples
    --------
    >>> from scope_models.io.pixels import usable_positions
    >>> usable_positions([[0.1, -0.2], [0.1, -548.1]])
    array([ True, False])
    """
    with np.errstate(invalid="ignore"):
        return (np.abs(plain_array(pos_corr, "pix", "pos_corr")) < LARGEST_OFFSET).all(axis=1)


def _of_hdus(hdus, name):
    def column(key, default=None, ndim=1):
        return _opening.column_of(table, columns[key], name, ndim) if key in columns else default

    try:
        table = _opening.first_table(hdus, name)
        columns = {key.upper(): key for key in table.columns.names}
        flux = column("FLUX", ndim=3)
    except RefusedError as error:
        raise RefusedError(f"{name} is not a target pixel file: {error}") from None
    if flux is None:
        raise RefusedError(f"{name} is not a target pixel file: it has no column FLUX")
    n, stamp = len(flux), flux.shape[1:]
    if flux.size == 0:
        raise RefusedError(f"{name} has no pixels: FLUX has the shape {flux.shape}")
    pos_corr = [column(f"POS_CORR{axis}") for axis in (1, 2)]
    header = _opening.cards_of(hdus[0].header, table.header)
    bits = hdus[2].data if len(hdus) > 2 else None  # where lightkurve finds the aperture
    has_aperture = bits is not None and np.asarray(bits).dtype.kind in "iu"
    values = {
        "time": np.asarray(column("TIME", np.full(n, np.nan)), dtype=float),
        "cadenceno": column("CADENCENO", np.zeros(n, dtype=int)),
        "quality": column("QUALITY", np.zeros(n, dtype=int)), "flux": flux,
        "flux_err": column("FLUX_ERR", np.full(flux.shape, np.nan), ndim=3),
        "flux_bkg": column("FLUX_BKG", ndim=3),
        "pos_corr": None if any(c is None for c in pos_corr) else np.column_stack(pos_corr),
        "aperture": (np.asarray(bits) & OPTIMAL) > 0 if has_aperture else np.ones(stamp, bool),
    }  # fmt: skip
    for key, shape in {"flux_err": flux.shape, "flux_bkg": flux.shape, "aperture": stamp}.items():
        if (array := values[key]) is not None and array.shape != shape:
            raise RefusedError(f"{name}: {key} must have the shape {shape}, got {array.shape}")
    for key in ("cadenceno", "quality"):
        if values[key].dtype.kind not in "iub":
            raise RefusedError(f"{name}: {key} must hold integers, got {values[key].dtype}")
        values[key] = values[key].astype(np.int64)
    if not values["cadenceno"].any():
        values["cadenceno"] = np.arange(1, n + 1)
    for array in values.values():
        if array is not None and array.base is None:
            array.flags.writeable = False  # made here: needs no copy
    return PixelSeries(**values, header=header, mission=Mission.from_header(header))


def _check_times(series, name):
    known = series.time[np.isfinite(series.time)]
    if not known.size:
        raise ValueError(f"{name} has no usable time: all of {len(series)} are NaN")
    steps = np.flatnonzero(~(np.diff(known) > 0))
    if steps.size:
        before, after = known[steps[0] : steps[0] + 2]
        remedy = "sort the cadences, as `tpf[np.argsort(tpf.time.value)]`, and leave out doubles"
        raise ValueError(f"the times of {name} must increase, got {after} after {before}: {remedy}")
    with _opening.naming(name):
        _ = series.time_format


def _has_file(tpf):
    """Return whether an object is a target pixel file of lightkurve."""
    return hasattr(type(tpf), "pipeline_mask") and hasattr(tpf, "quality_mask")


def _no_tpf(source):
    got = type(source).__name__
    if isinstance(source, PixelSeries):
        got = "a PixelSeries: read the file with `read_tpf`"
    wanted = "a target pixel file of lightkurve, Kepler's or TESS's, or the path of one"
    return TypeError(f"`tpf` must be {wanted}, got {got}")


def _check_place(header, name):
    """Refuse a place on the detector with which lightkurve cannot count."""
    for key in ("1CRV5P", "2CRV5P"):
        value = header.get(key, 0)
        if not (isinstance(value, int | float) and abs(value) < 1 << 31):
            raise ValueError(f"{name}: {key} must be a detector column or row, got {value!r}")


def positions_of(source):
    """Return the positions of lightkurve's object, as `read_positions` does."""
    found = source
    if _has_file(source):
        series = read_pixels(source)
        x, y = (None, None) if series.pos_corr is None else series.pos_corr.T
        found = SimpleNamespace(**vars(series), meta=series.header, pos_corr1=x, pos_corr2=y)
    names = ("time", "pos_corr1", "pos_corr2", "quality", "cadenceno")
    time, x, y, *flags = (getattr(found, name, None) for name in names)
    if any(column is None for column in (time, x, y)):
        kind = type(source).__name__
        message = f"`tpf` must have time, POS_CORR1 and POS_CORR2, but {kind} lacks them"
        raise TypeError(f"{message}; `Motion.from_file` reads files")
    x, y = (plain_array(column, "pix", "pos_corr") for column in (x, y))
    quality, number = (None if v is None else np.asarray(without_unit(v)) for v in flags)
    header = _opening.cards_of(getattr(found, "meta", None) or {})
    form = getattr(time, "format", None)
    if "BJDREFI" not in header and form in TIME_ZEROS:
        header["BJDREFI"] = int(TIME_ZEROS[form])
    time_format = _opening.time_format_of(header) or "bkjd"
    if not isinstance(time, Time) or form not in TIME_ZEROS or np.any(time.mask):
        time = plain_time(time, time_format, "time of tpf")
    return {
        "time": np.array(without_unit(time), dtype=float).reshape(-1), "x": x, "y": y,
        "quality": quality, "cadenceno": number, "time_format": time_format,
        "meta": _opening.facts_of(header),
    }  # fmt: skip


def star_places(name, places, series):
    """Return columns and rows ``(k, 2)`` of stars in the stamp of a `PixelSeries`.

    ``places`` are these, a SkyCoord, or a table with the columns x and y, or ra and dec.
    """
    columns = {str(key).lower(): key for key in getattr(places, "columns", ())}
    if {"x", "y"} <= set(columns):
        given = {f"{name}[{key!r}]": places[columns[key]] for key in "xy"}
        places = np.column_stack([plain_array(v, u.pixel, key) for key, v in given.items()])
    elif {"ra", "dec"} <= set(columns):
        ra, dec = (plain_array(places[columns[key]], u.deg, name) for key in ("ra", "dec"))
        places = SkyCoord(ra, dec, unit=u.deg)
    elif columns:
        raise ValueError(f"`{name}` must have the columns x and y, or ra and dec")
    if isinstance(places, SkyCoord):
        places = np.column_stack(_wcs(series).world_to_pixel(places.reshape(-1)))
    positions = np.atleast_2d(plain_array(places, u.pixel, name))
    if positions.size == 0:
        return np.zeros((0, 2))
    if positions.ndim != 2 or positions.shape[1] != 2 or not np.isfinite(positions).all():
        wanted = "finite positions of shape (k, 2)"
        raise ValueError(f"`{name}` must be {wanted}, got shape {positions.shape}")
    return positions


def read_neighbors(path, series):
    """Return the stars of a catalog that are in the pixels, without the target, as a table."""
    table = _opening.read_table(path)
    places = star_places("neighbors", table, series)
    kept = ((places > -0.5) & (places < np.array(series.flux.shape[:0:-1]) - 0.5)).all(axis=1)
    target = target_among(table, series)
    if target is not None and len(table):  # the star next to its coordinates, within a pixel
        distance = np.hypot(*(places - target).T)
        kept[np.argmin(distance)] &= distance.min() > 1
    return table[kept]


def target_among(places, series):
    """Return the target's column and row for places on the sky; None for others or if unknown."""
    names = {name.lower() for name in getattr(places, "colnames", ("x", "y"))}
    on_sky = isinstance(places, SkyCoord) or not {"x", "y"} <= names
    return target_place(series) if on_sky else None


def target_place(series):
    """Return the target's column and row by its coordinates; None without these."""
    place = [series.header.get(key) for key in ("RA_OBJ", "DEC_OBJ")]
    try:
        with warnings.catch_warnings(action="ignore", category=FITSFixedWarning):
            return star_places("tpf", SkyCoord(*place, unit=u.deg), series)[0]
    except (TypeError, ValueError):  # they, or the WCS, are missing or no numbers
        return None


def place_of(cards, shape):
    """Return column and row of the middle of a stamp on the CCD; None if unknown."""
    column, row = cards.get("1CRV5P"), cards.get("2CRV5P")
    if not (isinstance(column, int | float) and isinstance(row, int | float)):
        return None
    ny, nx = shape
    return column + (nx - 1) / 2, row + (ny - 1) / 2


def _wcs(series):
    keywords = wcs_keywords(5)  # of FLUX
    cards = {name: v for name, key in keywords.items() if (v := series.header.get(key)) is not None}
    if "CRVAL1" not in cards or "CRPIX1" not in cards:
        raise ValueError("the file has no WCS: give positions in pixels")
    return WCS(cards)
