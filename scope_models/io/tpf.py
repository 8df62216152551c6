"""Target pixel files with truth, in the layouts of Kepler, K2 and TESS."""

import gzip
import inspect
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from scope_models._docstrings import documented
from scope_models.io._atomic import atomic_path
from scope_models.io._blocks import CHECKSUM_COMMENT, Block, card_texts, write_blocks
from scope_models.io._columns import checked_columns, pixel_columns, table_rows
from scope_models.io._headers import make_headers, pixel_column_cards
from scope_models.io._metadata import TPFMetadata
from scope_models.io._opening import open_fits
from scope_models.io._truth import truth_blocks, truth_of

__all__ = ["TPFMetadata", "make_tpf_hdulist", "read_truth", "write_hdulist", "write_tpf"]

_COSMIC_RAYS = "TARGET COSMIC RAY"
_COLLECTED, _OPTIMAL = 1, 2
_COMPRESSION = 6


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
        Facts for the headers; its mission chooses the layout. The name of a mission stands for
        target number 1 and the mission's usual cadence.
    time : array_like, Quantity or Time, shape (n,)
        Barycentric times of mid-cadence, days (BKJD or BTJD); NaN where there is none.
    flux, flux_err : array_like or Quantity, shape (n, ny, nx)
        Flux less background and its standard deviation, e-/s; NaN where there is none. The
        standard deviation may be anything that broadcasts to the shape.
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
        Cosmic rays that were taken out, e-/s; NaN where there were none.
    aperture : array_like of bool or int, shape (ny, nx), optional
        The optimal aperture; or bits, 1 for collected and 2 for optimal. By default every pixel is
        collected and none is chosen.
    truth_columns : dict of str to array_like of shape (n, ...), optional
        True values at each cadence, for the TRUTH table.
    truth_maps : dict of str to array_like of shape (ny, nx), optional
        Images, each one an extension of its name.
    scene : dict, optional
        What can be text in JSON, for the SCENE table.
    truth_tables : dict of str to astropy.table.Table, optional
        Lists of any length, each one an extension of its name.
    simulated : bool, optional
        What the cards SIMDATA of the file are.

    Returns
    -------
    astropy.io.fits.HDUList
        The file, which lightkurve's ``KeplerTargetPixelFile`` and ``TessTargetPixelFile`` take
        as it is. It shares no memory with the arguments.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If shapes do not agree, or values are outside their domain.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.io import TPFMetadata
    >>> from scope_models.io.tpf import make_tpf_hdulist
    >>> metadata = TPFMetadata(mission="K2", target_id=7)
    >>> flux = np.ones((3, 5, 4))
    >>> hdus = make_tpf_hdulist(
    ...     metadata=metadata, time=[1.0, 1.02, 1.04], flux=flux, flux_err=0.1 * flux,
    ...     truth_columns={"X": [2.0, 2.1, 2.2]})
    >>> [hdu.name for hdu in hdus]
    ['PRIMARY', 'TARGETTABLES', 'APERTURE', 'TRUTH']
    """
    blocks = _tpf_blocks(**locals())
    from astropy.io import fits

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
        What to write. Its headers get the checksums, too.
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
    hdus, name = getattr(source, "hdu", source), "the target pixel file"
    if isinstance(hdus, str | PathLike):
        name = source
        with open_fits(source) as opened:
            truth = truth_of(opened)
    else:
        truth = truth_of(hdus)
    if truth is None:
        raise ValueError(f"{name} holds no truth: it has no TRUTH table with CADENCENO")
    return truth


def _tpf_blocks(
    *, metadata, aperture, truth_columns, truth_maps, scene, truth_tables, simulated, **columns
):
    """Return the blocks of a target pixel file; the arguments are those of `make_tpf_hdulist`."""
    if isinstance(metadata, str):
        metadata = TPFMetadata(mission=metadata, target_id=1)
    if not isinstance(metadata, TPFMetadata):
        wanted = "a TPFMetadata or the name of a mission"
        raise TypeError(f"`metadata` must be {wanted}, got {metadata!r}")
    n_cadences = len(np.atleast_1d(columns["time"]))
    if columns["cadenceno"] is None:
        columns["cadenceno"] = np.arange(1, n_cadences + 1)
    if columns["quality"] is None:
        columns["quality"] = np.zeros(n_cadences, dtype=np.int32)
    values = checked_columns(metadata, columns)
    aperture = _aperture_bits(aperture, values["FLUX"].shape[1:])
    used = np.isfinite(values["TIME"]) & np.isfinite(values["FLUX"]).any(axis=(1, 2))
    timecorr = values.get("TIMECORR", np.full(n_cadences, np.nan))
    counted = int(used.sum())
    primary, table, image = make_headers(metadata, values["TIME"], timecorr, counted, aperture)
    layout, shape = pixel_columns(metadata), values["FLUX"].shape
    definitions = pixel_column_cards(layout, metadata, shape[1:])
    rows = table_rows(layout, values, shape)
    blocks = [Block.table(rows, [*definitions, *table]), Block.image(aperture, image)]
    if "COSMIC_RAYS" in metadata.layout.absent_columns:
        blocks.append(_cosmic_ray_hdu(metadata, values))
    truth = truth_columns, truth_maps, scene, truth_tables
    if any(part is not None for part in truth):
        blocks.extend(truth_blocks(values["CADENCENO"], *truth))
    blocks.insert(0, Block.primary(primary, len(blocks)))
    return blocks if simulated else [_not_simulated(block) for block in blocks]


def _not_simulated(block):
    """Return a block whose header does not say that its data are simulated."""
    simulated, other = (True, "the data are simulated"), (False, "the data are not simulated")
    if isinstance(block, Block):
        old, new = card_texts([("SIMDATA", *simulated), ("SIMDATA", *other)])
        return replace(block, cards=block.cards.replace(old, new))
    if "SIMDATA" in block.header:
        block.header["SIMDATA"] = other
    return block


def _cosmic_ray_hdu(metadata, values):
    """Return the list of cosmic rays of files that have no column of them."""
    from astropy.io import fits

    rays = values.get("COSMIC_RAYS", np.full((1, 1, 1), np.nan))
    cadence, row, column = np.nonzero(np.isfinite(rays))
    hdu = fits.BinTableHDU.from_columns(
        [
            fits.Column("CADENCENO", "J", array=values["CADENCENO"][cadence], disp="I10"),
            fits.Column("RAWX", "I", "pixel", array=metadata.column + column, disp="I4"),
            fits.Column("RAWY", "I", "pixel", array=metadata.row + row, disp="I4"),
            fits.Column("COSMIC_RAY", "E", "e-/s", array=rays[cadence, row, column], disp="E14.7"),
        ],
        name=_COSMIC_RAYS,
    )
    hdu.header.insert("EXTNAME", ("INHERIT", True, "the primary header holds here too"))
    hdu.header["EXTVER"] = (1, "version of extension")
    hdu.header["SIMDATA"] = (True, "the data are simulated")
    return hdu


def _aperture_bits(aperture, shape):
    if aperture is None:
        return np.full(shape, _COLLECTED, dtype=np.int32)
    aperture = np.asarray(aperture)
    if aperture.shape != shape:
        raise ValueError(f"`aperture` must have the shape {shape}, got {aperture.shape}")
    if aperture.dtype.kind == "b":
        return np.where(aperture, _COLLECTED | _OPTIMAL, _COLLECTED).astype(np.int32)
    if aperture.dtype.kind not in "iu":
        raise TypeError(f"`aperture` must be of booleans or integers, got {aperture.dtype}")
    if aperture.min() < 0:
        raise ValueError(f"`aperture` must not be negative, got {aperture.min()}")
    return aperture.astype(np.int32)


def _write(path, write, *, overwrite):
    """Open a stream to a file that is there as a whole or not at all, and write to it."""
    with atomic_path(path, overwrite=overwrite) as temporary, temporary.open("wb") as stream:
        if temporary.suffix.lower() == ".gz":
            # No name and no time in it: the same contents give the same file.
            with gzip.GzipFile("", "wb", _COMPRESSION, stream, mtime=0) as compressed:
                write(compressed)
        else:
            write(stream)
    return Path(path)
