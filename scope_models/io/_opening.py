"""Opening FITS files that may be damaged, cut off or made to harm."""

import gzip
import io
import warnings
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from scope_models._checks import one_line
from scope_models.exceptions import DamagedFileWarning

__all__ = ["RefusedError", "checksum_of", "conf", "naming", "open_fits"]

#: Limits of files that are read: ``max_bytes``, bytes after decompression, and ``max_ratio``, the
#: factor by which a compressed file may grow beyond 64 MiB.
conf = SimpleNamespace(max_bytes=1 << 30, max_ratio=200)

_GZIP = b"\x1f\x8b"
_CHUNK = 1 << 20
# Compressed files may always become so large: noise-free simulations compress very well.
_SMALL = 64 << 20
_MOST = 999  # axes and columns of the FITS standard
_ONES = 2**32 - 1


class RefusedError(ValueError):
    """A file lacks the requested data, or is damaged; the message names it."""


@contextmanager
def open_fits(path):
    """Open a FITS file to read, with one kind of error for whatever is wrong with it.

    The file is read into memory, up to the limits in `scope_models.io.conf`, and each header's
    claims are checked before its data are read. The HDUs stay usable after the context.

    Parameters
    ----------
    path : str or path-like
        The file, which may be compressed by gzip.

    Yields
    ------
    astropy.io.fits.HDUList
        The file. Do no more than read from it within the context, which has the same errors.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    IsADirectoryError
        If it is a folder.
    OSError
        If it cannot be opened.
    ValueError
        If it is empty, truncated, larger than the limits, or no FITS file.

    Warns
    -----
    DamagedFileWarning
        If a checksum in the file does not match.

    Examples
    --------
    >>> from scope_models.io.reading import open_fits
    >>> with open_fits("absent.fits") as hdus:
    ...     pass
    Traceback (most recent call last):
    FileNotFoundError: no such file: absent.fits
    """
    # Not imported with the package: it takes a quarter of the time that the package has for that.
    from astropy.io import fits

    content = _content(Path(path))
    try:
        _check_axes(content, 0, path)
        with fits.open(io.BytesIO(content), memmap=False) as hdus:
            _check(hdus, content, path)
            yield hdus
    except RefusedError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # astropy raises anything when it reads damaged bytes
        raise _unreadable(path, error) from error


@contextmanager
def naming(path):
    """Let errors of what is done with a file begin with its name."""
    try:
        yield
    except ValueError as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path}: {error}") from error


def _unreadable(path, error):
    reason = one_line(error) or type(error).__name__  # bytes of a damaged header can be in it
    return ValueError(f"{path} is no readable FITS file, or truncated: {reason}")


def _content(path):
    """Return the bytes of a file, decompressed."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, not a FITS file")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        raise OSError(f"{path} is no regular file")
    size, limit = path.stat().st_size, conf.max_bytes
    if size == 0:
        raise ValueError(f"{path} is empty")
    with path.open("rb") as stream:
        packed = stream.read(len(_GZIP)) == _GZIP
        stream.seek(0)
        if not packed:
            if size > limit:
                raise _too_large(path, limit)
            return stream.read()
        limit = min(limit, max(_SMALL, conf.max_ratio * size))
        try:
            content = _unpacked(stream, limit)
        except Exception as error:  # of gzip
            raise _unreadable(path, error) from error
    if content is None:
        raise _too_large(path, limit)
    return content


def _unpacked(stream, limit):
    """Return what a compressed stream holds; None if it is more than the limit."""
    pieces, left = [], limit
    with gzip.GzipFile(fileobj=stream) as unpacked:
        while piece := unpacked.read(_CHUNK):
            pieces.append(piece)
            left -= len(piece)
            if left < 0:
                return None
    return b"".join(pieces)


def _too_large(path, limit):
    settings = "scope_models.io.conf.max_bytes, max_ratio"
    return ValueError(f"{path} is too large: the limit is {limit:,} bytes ({settings})")


def _check(hdus, content, path):
    """Refuse HDUs that claim more than the file holds, and warn of sums that do not match."""
    from astropy.io import fits

    mismatches, end, number = [], 0, 0
    while content[end : end + 9] in {b"SIMPLE  =", b"XTENSION="}:
        _check_axes(content, end, path)
        hdu = hdus[number]  # read now
        place = hdu.fileinfo()
        start, end = place["hdrLoc"], place["datLoc"] + place["datSpan"]
        kinds = (fits.PrimaryHDU, fits.ImageHDU, fits.BinTableHDU, fits.TableHDU)
        if not isinstance(hdu, kinds):
            raise _refused(path, f"HDU {number} is no image or table")
        if end > len(content) or place["datSpan"] < 0:
            raise _refused(path, f"HDU {number} claims more bytes than the file has")
        if isinstance(hdu, fits.BinTableHDU | fits.TableHDU):
            _check_columns(hdu, path)
        for keyword, begin in (("DATASUM", place["datLoc"]), ("CHECKSUM", start)):
            text = str(hdu.header.get(keyword, "")).strip()
            wanted = 0 if keyword == "CHECKSUM" else int(text) if text.isdigit() else -1
            found = checksum_of(np.frombuffer(content, np.uint8, end - begin, begin))
            if text and found % _ONES != wanted % _ONES:
                mismatches.append(f"{keyword} of HDU {number}")
                break
        number += 1
    if content[end:].strip(b"\0 "):
        raise _refused(path, "what follows its last HDU is no extension")
    claimed = hdus[0].header.get("NEXTEND")
    if isinstance(claimed, int) and len(hdus) - 1 < claimed:
        raise _refused(path, f"it has {len(hdus) - 1} of {claimed} extensions")
    if mismatches:
        warnings.warn(
            f"{path}: {' and '.join(mismatches)} do{'es' * (len(mismatches) == 1)} not match: the "
            "file was damaged, or changed after it was written",
            DamagedFileWarning,
            stacklevel=5,
        )


def _check_axes(content, start, path):
    """Refuse a header of more axes than FITS has, of which astropy would make a list."""
    from astropy.io import fits

    stream = io.BytesIO(content)
    stream.seek(start)
    axes = fits.Header.fromfile(stream).get("NAXIS")
    if isinstance(axes, int) and axes > _MOST:
        raise _refused(path, f"NAXIS is {axes}")


def _check_columns(hdu, path):
    """Refuse a table whose columns do not fit its rows."""
    n_columns = hdu.header["TFIELDS"]
    if isinstance(n_columns, bool) or not 0 <= n_columns <= _MOST:
        raise _refused(path, f"TFIELDS is {n_columns}")
    width = hdu.columns.dtype.itemsize
    if width > hdu.header["NAXIS1"]:
        raise _refused(
            path, f"the columns of a table have {width:,} bytes, its rows {hdu.header['NAXIS1']:,}"
        )
    for number in range(1, n_columns + 1):
        if not isinstance(hdu.header.get(f"TTYPE{number}"), str):
            raise _refused(path, f"TTYPE{number} is absent or no text")


def _refused(path, reason):
    return RefusedError(f"{path} is no readable FITS file, or truncated: {reason}")


def checksum_of(data, start=0):
    """Return the ones' complement sum of bytes in 32-bit numbers."""
    rest = len(data) % 4
    total = start + int(data[: len(data) - rest].view(">u4").sum(dtype=np.uint64))
    total += int.from_bytes(data[len(data) - rest :].tobytes().ljust(4, b"\0"), "big")
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total
