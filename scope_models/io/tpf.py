"""Target pixel files with truth, in the layouts of Kepler, K2 and TESS."""

import datetime as dt
import gzip
import inspect
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from os import PathLike
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits

from scope_models._arrays import DIGITAL, PER_PIXEL, plain_array, plain_time
from scope_models._checks import check_fields, checked_int32, checked_matrix, integer, number
from scope_models._docstrings import documented
from scope_models._values import Value
from scope_models.io._headers import (
    CHECKSUM_COMMENT,
    COLLECTED,
    OPTIMAL,
    Block,
    make_headers,
    pixel_block,
    write_blocks,
)
from scope_models.io._opening import atomic_path, open_fits
from scope_models.io._truth import truth_blocks, truth_of
from scope_models.missions import MISSIONS

__all__ = ["TPFMetadata", "make_tpf_hdulist", "read_truth", "write_hdulist", "write_tpf"]

_COMPRESSION = 4  # 0.6 of the time of gzip's default, 6, for 3 % larger files
_LONG_CADENCE = 0.01  # days: between the 58.8 s and the 29.4 min of the Kepler photometer
_MODULES = (2, 3, 4, *range(6, 21), 22, 23, 24)  # those at the corners are fine-guidance sensors
# Fields that a mission and a detector, or only a detector, have by the same name.
_OF_MISSION = ("pixel_scale", "int_time", "read_time")
_OF_DETECTOR = ("mission", "n_frames", "gain", "read_noise", "mean_black", "fixed_offset")
_CUBES = "flux", "flux_err", "flux_bkg", "flux_bkg_err", "cosmic_rays"
_UNITS = dict.fromkeys(_CUBES, "electron / s")
_UNITS |= {"timecorr": "d", "pos_corr1": "pix", "pos_corr2": "pix"}


@dataclass(frozen=True, eq=False, kw_only=True)
class TPFMetadata(Value):
    """Facts for the headers of a target pixel file.

    `of` takes those of a detector. What is None and has no default becomes a card without a value.

    Parameters
    ----------
    mission : {"Kepler", "K2", "TESS", "Ground"}
        The layout of the file.
    target_id : int
        KEPLERID or TICID, at least 1.
    pixel_scale : float or Quantity, optional
        Size of a pixel on the sky, arcsec; by default the mission's.
    int_time, read_time : float or Quantity, optional
        Exposure and read-out time of one frame, s; by default the mission's.
    n_frames : int, optional
        Frames per cadence; by default those of the mission's usual cadence.
    object_name : str, optional
        OBJECT; by default "SIM" and the number.
    ra, dec : float or Quantity, optional
        Position, deg; by default the middle of a field (for TESS the north ecliptic pole).
    x_0, y_0 : float or Quantity, optional
        The pixel of the stamp, from 0, that looks at ``ra`` and ``dec``; by default the middle.
    orientation : float or Quantity, optional
        Position angle of growing rows, deg from north to east. At 0, columns grow to the west.
    matrix : tuple of float, optional
        PC1_1, PC1_2, PC2_1 and PC2_2 of the projection, in place of ``orientation``: what a step
        along columns and rows is to the west and to the north.
    magnitude : float or Quantity, optional
        KEPMAG or TESSMAG.
    quarter, campaign, sector : int, optional
        When it was observed; only the mission's may be given.
    channel, module, output : int, optional
        Where on the Kepler photometer; a channel implies its module and output, and conversely.
    camera, ccd : int, optional
        Where on TESS.
    column, row : int, optional
        Detector column and row of the first pixel of the stamp.
    n_readouts : int, optional
        Frames that are summed up; by default ``n_frames``.
    time_delta : float or Quantity, optional
        Length of a cadence, days; by default that of the frames.
    gain : float or Quantity, optional
        Electrons per count.
    read_noise : float or Quantity, optional
        Standard deviation of one read, electrons.
    mean_black, fixed_offset : int, optional
        Black level of one read, and number added to RAW_CNTS, counts.
    seed : int, optional
        Seed of the simulation, for the card SEED.
    date : datetime.date, optional
        Day on which the file is made; by default today, UTC.
    extra_cards : mapping, optional
        Further cards: keyword to value, or to value and comment. Those that the layout has without
        a value (TEFF, CROWDSAP, ...) are filled, others are added to the primary header.

    Raises
    ------
    TypeError
        If a field is of the wrong kind.
    ValueError
        If a field is outside its domain, or belongs to another mission.

    Examples
    --------
    >>> from scope_models.io import TPFMetadata
    >>> metadata = TPFMetadata(mission="K2", target_id=7, channel=48)
    >>> metadata.name, metadata.module_and_output, round(metadata.cadence_days, 4)
    ('SIM 7', (14, 4), 0.0204)
    """

    mission: str
    target_id: int = integer(MISSING, 1)
    pixel_scale: float | None = number(None, u.arcsec, positive=True, equivalencies=PER_PIXEL)
    int_time: float | None = number(None, u.s, positive=True)
    read_time: float | None = number(None, u.s)
    n_frames: int | None = integer(None, 1)
    object_name: str | None = None
    ra: float | None = number(None, u.deg, any_sign=True)
    dec: float | None = number(None, u.deg, any_sign=True, at_most=90)
    x_0: float | None = number(None, u.pix, any_sign=True)
    y_0: float | None = number(None, u.pix, any_sign=True)
    orientation: float = number(0.0, u.deg, any_sign=True)
    matrix: tuple[float, ...] | None = field(default=None, metadata={"check": checked_matrix})
    magnitude: float | None = number(None, u.mag, any_sign=True)
    quarter: int | None = integer(None, 0)
    campaign: int | None = integer(None, 0)
    sector: int | None = integer(None, 1)
    channel: int | None = integer(None, 1, 4 * len(_MODULES))
    module: int | None = integer(None, 1)
    output: int | None = integer(None, 1, 4)
    camera: int | None = integer(None, 1, 4)
    ccd: int | None = integer(None, 1, 4)
    column: int = integer(500, 0)
    row: int = integer(500, 0)
    n_readouts: int | None = integer(None, 1)
    time_delta: float | None = number(None, u.day, positive=True)
    gain: float | None = number(None, u.electron / u.adu, positive=True, equivalencies=DIGITAL)
    read_noise: float | None = number(None, u.electron)
    mean_black: int | None = integer(None, 0)
    fixed_offset: int | None = integer(None, 0)
    seed: int | None = integer(None, 0)
    date: dt.date | None = None
    extra_cards: Mapping = field(default_factory=dict)

    def __post_init__(self):
        names = {name.lower(): name for name in MISSIONS}
        object.__setattr__(self, "mission", names.get(str(self.mission).lower(), self.mission))
        if self.mission not in MISSIONS:
            known = ", ".join(map(repr, MISSIONS))
            raise ValueError(f"`mission` must be one of {known}, got {self.mission!r}")
        usual = {name: getattr(self.layout, name) for name in _OF_MISSION}
        for name, value in (usual | {"n_frames": self.layout.cadence().n_frames}).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        check_fields(self)
        if self.n_readouts is not None and self.n_readouts > self.n_frames:
            given = f"{self.n_readouts} of {self.n_frames}"
            raise ValueError(f"`n_readouts` must not exceed `n_frames`, got {given}")
        if not isinstance(self.name, str) or not self.name.isascii():
            raise TypeError(f"`object_name` must be ASCII text, got {self.name!r}")
        if self.date is not None and not isinstance(self.date, dt.date):
            raise TypeError(f"`date` must be a datetime.date, got {self.date!r}")
        if not isinstance(self.extra_cards, Mapping):
            raise TypeError(f"`extra_cards` must be a mapping, got {self.extra_cards!r}")
        self._check_place()

    def _check_place(self):
        runs, places = ("quarter", "campaign", "sector"), ("channel", "module", "output")
        for name in (*runs, *places, "camera", "ccd"):
            given = getattr(self, name)
            if given is not None and name not in {self.layout.run, *self.layout.places}:
                raise ValueError(f"`{name}` must not be given for {self.mission}, got {given}")
        if self.module is not None and self.module not in _MODULES:
            raise ValueError(f"`module` must be one of {_MODULES}, got {self.module}")
        for name, implied in zip(("module", "output"), self.module_and_output, strict=True):
            given = getattr(self, name)
            if given is not None and given != implied:
                wanted = f"{implied} for channel {self.channel}"
                raise ValueError(f"`{name}` must be {wanted}, got {given}")

    @classmethod
    def of(cls, detector, **facts):
        """Return the facts of a detector's files.

        Parameters
        ----------
        detector : Detector
            The detector, of a mission with target pixel files.
        **facts
            Fields of `TPFMetadata`: the target's, and any that differ from the detector's.

        Returns
        -------
        TPFMetadata
            The facts.

        Raises
        ------
        TypeError
            If a field is misspelled or of the wrong kind.
        ValueError
            If a field is outside its domain, or belongs to another mission.

        Examples
        --------
        >>> from scope_models import Detector
        >>> from scope_models.io import TPFMetadata
        >>> TPFMetadata.of(Detector.tess(), target_id=7).reads
        48
        """
        own = {name: getattr(detector, name) for name in (*_OF_MISSION, *_OF_DETECTOR)}
        return cls(**(own | {"n_readouts": detector.n_reads} | facts))

    @property
    def layout(self):
        """The mission, which fixes the features of its files."""
        return MISSIONS[self.mission]

    @property
    def name(self):
        """The name of the target."""
        return f"SIM {self.target_id}" if self.object_name is None else self.object_name

    @property
    def position(self):
        """Right ascension (0 to 360) and declination, deg."""
        default_ra, default_dec = self.layout.field_center
        ra = default_ra if self.ra is None else self.ra % 360.0
        return ra, default_dec if self.dec is None else self.dec

    @property
    def module_and_output(self):
        """Module and output of the channel, or those given."""
        if self.channel is None:
            return self.module, self.output
        return _MODULES[(self.channel - 1) // 4], (self.channel - 1) % 4 + 1

    @property
    def full_channel(self):
        """The channel, given or derived from module and output."""
        if self.channel is None and self.module is not None and self.output is not None:
            return 4 * _MODULES.index(self.module) + self.output
        return self.channel

    @property
    def frame_time(self):
        """Length of a frame, s."""
        return self.int_time + self.read_time

    @property
    def reads(self):
        """Number of frames in the sum."""
        return self.n_frames if self.n_readouts is None else self.n_readouts

    @property
    def cadence_days(self):
        """Length of a cadence, days."""
        if self.time_delta is not None:
            return self.time_delta
        return self.n_frames * self.frame_time / 86400

    @property
    def is_long_cadence(self):
        """Whether Kepler calls this a long cadence."""
        return self.cadence_days > _LONG_CADENCE

    @property
    def duty_cycle(self):
        """Part of a cadence in which light is gathered (DEADC)."""
        return self.int_time / self.frame_time * self.reads / self.n_frames


def make_tpf_hdulist(
    *, metadata, time, flux, flux_err, cadenceno=None, raw_cnts=None, flux_bkg=0.0,
    flux_bkg_err=0.0, quality=None, pos_corr1=None, pos_corr2=None, timecorr=None,
    cosmic_rays=None, aperture=None, truth_columns=None, truth_maps=None, scene=None,
    truth_tables=None, simulated=True,
):  # fmt: skip
    """Make a target pixel file in memory.

    Parameters
    ----------
    metadata : TPFMetadata or {"Kepler", "K2", "TESS", "Ground"}
        Facts for the headers. The name of a mission stands for target number 1 and its usual
        cadence.
    time : array_like, Quantity or Time, shape (n,)
        Barycentric times of mid-cadence, days (BKJD or BTJD); NaN where there is none.
    flux, flux_err : array_like or Quantity, shape (n, ny, nx)
        Flux less background and its standard deviation, which broadcasts to it, e-/s; NaN where
        there is none.
    cadenceno : array_like of int, shape (n,), optional
        Numbers of the cadences, growing, from 1 at least; by default 1 to n.
    raw_cnts : array_like of int, shape (n, ny, nx), optional
        Counts as read; -1 or None where there are none.
    flux_bkg, flux_bkg_err : array_like or Quantity, broadcast to (n, ny, nx), optional
        Background that was subtracted and its uncertainty, e-/s.
    quality : array_like of int, shape (n,), optional
        Quality flags, 0 by default. Kepler and K2 get bit 65536 wherever time is NaN.
    pos_corr1, pos_corr2 : array_like, shape (n,), optional
        Offsets of the star along columns (x) and rows (y), pixels; NaN, the default, where unknown.
    timecorr : array_like, shape (n,), optional
        Barycentric minus spacecraft time, days; NaN by default.
    cosmic_rays : array_like, shape (n, ny, nx), optional
        Cosmic rays that were taken out, e-/s; NaN for none.
    aperture : array_like of bool or int, shape (ny, nx), optional
        The optimal aperture; or bits, 1 for collected and 2 for optimal. By default all are 1.
    truth_columns, truth_maps, scene, truth_tables : dict, optional
        Columns without CADENCENO, maps, scene and tables of a `~scope_models.io.Truth`.
    simulated : bool, optional
        What the cards SIMDATA of the file are.

    Returns
    -------
    astropy.io.fits.HDUList
        The file, which lightkurve's ``KeplerTargetPixelFile`` and ``TessTargetPixelFile`` take. It
        shares no memory with the arguments.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If shapes do not agree, or values are outside their domain.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.io.tpf import TPFMetadata, make_tpf_hdulist
    >>> metadata = TPFMetadata(mission="K2", target_id=7)
    >>> flux = np.ones((3, 5, 4))
    >>> hdus = make_tpf_hdulist(
    ...     metadata=metadata, time=[1.0, 1.02, 1.04], flux=flux, flux_err=0.1 * flux,
    ...     truth_columns={"X": [2.0, 2.1, 2.2]})
    >>> [hdu.name for hdu in hdus]
    ['PRIMARY', 'TARGETTABLES', 'APERTURE', 'TRUTH']
    """
    blocks = _tpf_blocks(**locals())
    return fits.HDUList([block.hdu() if isinstance(block, Block) else block for block in blocks])


@documented()
def write_tpf(path, *, overwrite=False, **contents):
    """Write a target pixel file, as a whole or not at all.

    Parameters
    ----------
    {path}
    **contents
        The arguments of `make_tpf_hdulist`.

    {written}
    TypeError, ValueError
        As `make_tpf_hdulist` does.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.io import read_tpf, write_tpf
    >>> time = 2230.0 + 0.0204 * np.arange(100)
    >>> path = write_tpf(
    ...     "mine.fits", metadata="K2", time=time, flux=np.ones((100, 7, 5)), flux_err=0.1)
    >>> read_tpf(path).shape
    (100, 7, 5)
    """
    arguments = inspect.signature(make_tpf_hdulist).bind(**contents)
    arguments.apply_defaults()
    blocks = _tpf_blocks(**arguments.arguments)
    return _write(path, lambda stream: write_blocks(blocks, stream), overwrite=overwrite)


@documented()
def write_hdulist(hdulist, path, *, overwrite=False):
    """Write a FITS file with checksums, as a whole or not at all.

    Parameters
    ----------
    hdulist : astropy.io.fits.HDUList
        The file. Its headers get the checksums, too.
    {write}

    Examples
    --------
    >>> from astropy.io import fits
    >>> from scope_models.io.tpf import write_hdulist
    >>> write_hdulist(fits.HDUList([fits.PrimaryHDU()]), "absent/star.fits")
    Traceback (most recent call last):
    FileNotFoundError: cannot write absent/star.fits: there is no folder ...absent
    """
    hdulist[0].header["NEXTEND"] = (len(hdulist) - 1, "number of extensions")
    for hdu in hdulist:
        hdu.add_checksum(when=CHECKSUM_COMMENT)
    return _write(path, hdulist.writeto, overwrite=overwrite)


def read_truth(source):
    """Read the truth behind the pixels of a simulated target pixel file.

    Parameters
    ----------
    source : str, path-like, astropy.io.fits.HDUList or lightkurve.TargetPixelFile
        The target pixel file. After slicing in lightkurve, the truth is still that of all
        cadences: `~scope_models.io.Truth.at_cadences` chooses.

    Returns
    -------
    Truth
        The truth, exactly as it went in.

    Raises
    ------
    FileNotFoundError, IsADirectoryError
        If there is no such file, or it is a folder.
    ValueError
        If it is truncated, no FITS file, or holds no truth.

    Examples
    --------
    >>> from scope_models.io import read_truth
    >>> read_truth("absent.fits")
    Traceback (most recent call last):
    FileNotFoundError: no such file: absent.fits
    """
    if isinstance(source, str | PathLike):
        with open_fits(source) as hdus:
            truth, name = truth_of(hdus), source
    else:
        truth, name = truth_of(getattr(source, "hdu", source)), "the target pixel file"
    if truth is None:
        raise ValueError(f"{name} holds no truth: it has no TRUTH table with CADENCENO")
    return truth


def _tpf_blocks(
    *, metadata, aperture, truth_columns, truth_maps, scene, truth_tables, simulated, **columns
):
    """Return the blocks of the file of `make_tpf_hdulist`."""
    if isinstance(metadata, str):
        metadata = TPFMetadata(mission=metadata, target_id=1)
    if not isinstance(metadata, TPFMetadata):
        wanted = "a TPFMetadata or the name of a mission"
        raise TypeError(f"`metadata` must be {wanted}, got {metadata!r}")
    values = _checked_columns(metadata.layout, columns)
    aperture = _aperture_bits(aperture, values["FLUX"].shape[1:])
    simdata = "SIMDATA", simulated, f"the data are {'' if simulated else 'not '}simulated"
    primary, table, image = make_headers(metadata, values, aperture, simdata)
    blocks = [pixel_block(metadata, values, table, image), Block(image, aperture)]
    if "COSMIC_RAYS" in metadata.layout.absent_columns:
        blocks.append(_cosmic_ray_hdu(metadata, values, simdata))
    truth = truth_columns, truth_maps, scene, truth_tables
    if any(part is not None for part in truth):
        blocks.extend(truth_blocks(values["CADENCENO"], *truth))
    return [Block([("NEXTEND", len(blocks), "number of extensions"), *primary]), *blocks]


def _cosmic_ray_hdu(metadata, values, simdata):
    """Return the list of cosmic rays of files without a column of them."""
    rays = values.get("COSMIC_RAYS", np.full((1, 1, 1), np.nan))
    cadence, row, column = np.nonzero(np.isfinite(rays))
    columns = [
        fits.Column("CADENCENO", "J", array=values["CADENCENO"][cadence], disp="I10"),
        fits.Column("RAWX", "I", "pixel", array=metadata.column + column, disp="I4"),
        fits.Column("RAWY", "I", "pixel", array=metadata.row + row, disp="I4"),
        fits.Column("COSMIC_RAY", "E", "e-/s", array=rays[cadence, row, column], disp="E14.7"),
    ]
    hdu = fits.BinTableHDU.from_columns(columns, name="TARGET COSMIC RAY")
    hdu.header.insert("EXTNAME", ("INHERIT", True, "the primary header holds here too"))
    hdu.header["EXTVER"] = (1, "version of extension")
    hdu.header.append(simdata)
    return hdu


def _checked_columns(mission, values):
    """Return the arrays by their names in the file, checked against each other."""
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
    """Return times, numbers and quality flags of cadences."""
    time = _floats("time", plain_time(values["time"], mission.time_format, "time"), shape)
    known = time[np.isfinite(time)]
    if known.size == 0:
        raise ValueError("`time` must have a finite value")
    if np.any(np.diff(known) <= 0):
        raise ValueError("`time` must increase from cadence to cadence")
    number = np.arange(1, shape[0] + 1) if values["cadenceno"] is None else values["cadenceno"]
    number = checked_int32("cadenceno", number, shape)
    if number[0] < 1 or np.any(np.diff(number) <= 0):
        raise ValueError(f"`cadenceno` must increase from at least 1, got {number[0]} first")
    quality = np.zeros(shape, np.int32) if values["quality"] is None else values["quality"]
    quality = checked_int32("quality", quality, shape)
    if quality.min() < 0:
        raise ValueError(f"`quality` must not be negative, got {quality.min()}")
    no_data = np.where(np.isnan(time), mission.quality.no_data, 0).astype(np.int32)
    return {"TIME": time, "CADENCENO": number, "QUALITY": quality | no_data}


def _floats(name, values, shape, *, broadcast=False):
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


def _aperture_bits(aperture, shape):
    aperture = np.zeros(shape, dtype=bool) if aperture is None else np.asarray(aperture)
    if aperture.shape != shape:
        raise ValueError(f"`aperture` must have the shape {shape}, got {aperture.shape}")
    if aperture.dtype.kind == "b":
        return COLLECTED | np.where(aperture, OPTIMAL, 0).astype(np.int32)
    if aperture.dtype.kind not in "iu":
        raise TypeError(f"`aperture` must be of booleans or integers, got {aperture.dtype}")
    if aperture.min() < 0:
        raise ValueError(f"`aperture` must not be negative, got {aperture.min()}")
    return aperture.astype(np.int32)


def _write(path, write, *, overwrite):
    if not Path(path).name.lower().endswith((".fits", ".fits.gz")):
        raise ValueError(f"`path` must end in .fits or .fits.gz, got {path}")
    with atomic_path(path, overwrite=overwrite) as temporary, temporary.open("wb") as stream:
        if temporary.suffix.lower() == ".gz":
            # Without name and time, so that the same contents give the same file.
            with gzip.GzipFile("", "wb", _COMPRESSION, stream, mtime=0) as compressed:
                write(compressed)
        else:
            write(stream)
    return Path(path)
