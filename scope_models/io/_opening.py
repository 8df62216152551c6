"""Opening FITS files that may be damaged, cut off or made to harm."""

import gzip
import io
import re
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from astropy import config

from scope_models.exceptions import DamagedFileWarning
from scope_models.io._blocks import checksum_of

__all__ = ["Conf", "RefusedError", "conf", "naming", "open_fits"]

_BLOCK = 2880
_END = b"END".ljust(80)
_ONES = 2**32 - 1
_CHUNK = 1 << 22
_GZIP = b"\x1f\x8b"
_MOST_HEADER_BLOCKS = 1000  # 36,000 cards
_MOST_COLUMNS = 999  # of the FITS standard
# Compressed files may always become so large: noise-free simulations compress very well.
_SMALL = 64 << 20
_BITPIX = {8, 16, 32, 64, -32, -64}
# Bytes of an element of a column.
_WIDTHS = dict(zip("LXBIJKAEDCMPQ", (1, 0.125, 1, 2, 4, 8, 1, 4, 8, 8, 16, 8, 16), strict=True))


class _Item(config.ConfigItem):
    rootname = "scope_models"


class Conf(config.ConfigNamespace):
    """Limits of `scope_models.io`, in the manner of `astropy.config`.

    They are set by assignment, by ``with conf.set_temp(name, value):``, or in the section ``[io]``
    of the file ``scope_models.cfg`` in astropy's configuration folder.

    Attributes
    ----------
    max_bytes : int
        Largest size of a FITS file that is read, in bytes after decompression.
    max_ratio : int
        Largest factor by which a compressed file may grow beyond 64 MiB.

    Examples
    --------
    >>> from scope_models.io import conf
    >>> with conf.set_temp("max_bytes", 4 * 2**30):
    ...     conf.max_bytes
    4294967296
    """

    rootname = "scope_models"

    max_bytes = _Item(
        1 << 30,
        "Largest size of a FITS file that is read, in bytes after decompression.",
        module="scope_models.io",
    )
    max_ratio = _Item(
        200,
        "Largest factor by which a compressed file may grow beyond 64 MiB.",
        module="scope_models.io",
    )


conf = Conf()


class RefusedError(ValueError):
    """A file lacks the requested data, or is damaged; the message names it."""


@contextmanager
def open_fits(path):
    """Open a FITS file to read, with one kind of error for whatever is wrong with it.

    The file is read into memory, HDU by HDU, and each header's claims are checked before what it
    claims is read: no file makes more memory needed than the limits in `scope_models.io.conf`
    allow. The HDUs stay usable after the context.

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

    content, n_hdus = _read_whole(Path(path))
    try:
        with fits.open(io.BytesIO(content), memmap=False) as hdus:
            _check_number(hdus, n_hdus, path)
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


def _check_number(hdus, n_hdus, path):
    """Refuse a file of which astropy does not read every HDU."""
    if len(hdus) != n_hdus:
        raise RefusedError(f"{path} has {n_hdus} HDUs, of which {len(hdus)} are readable")


def _unreadable(path, error):
    reason = " ".join(str(error).split()) or type(error).__name__
    return ValueError(f"{path} is no readable FITS file, or truncated: {reason}")


def _read_whole(path):
    """Return the checked bytes of a FITS file, and the number of its HDUs."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, not a FITS file")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        raise OSError(f"{path} is no regular file")
    size = path.stat().st_size
    if size == 0:
        raise ValueError(f"{path} is empty")
    with path.open("rb") as file:
        stream, limit = file, conf.max_bytes
        if file.read(len(_GZIP)) == _GZIP:
            stream, limit = gzip.GzipFile(fileobj=file), max(_SMALL, conf.max_ratio * size)
        file.seek(0)
        walk = _Walk(stream, path, min(limit, conf.max_bytes))
        try:
            content = walk.content()
        except RefusedError as error:
            raise ValueError(str(error)) from None
        except Exception as error:  # of gzip, or of astropy at a card that is none
            raise _unreadable(path, error) from error
    if walk.mismatches:
        warnings.warn(
            f"{path}: {' and '.join(walk.mismatches)} "
            f"do{'es' * (len(walk.mismatches) == 1)} not match: the file was damaged, "
            "or changed after it was written",
            DamagedFileWarning,
            stacklevel=5,
        )
    return content


class _Walk:
    """A walk through the HDUs of a stream that checks every card."""

    def __init__(self, stream, path, limit):
        self._stream, self._path, self._limit = stream, path, limit
        self._bytes = bytearray()
        self.mismatches = []

    def content(self):
        """Return the bytes of all HDUs, and their number."""
        n_hdus, extensions = 0, None
        while (block := self._read(_BLOCK)) and not (n_hdus and self._is_padding(block)):
            start = len(self._bytes) - len(block)
            header = self._header(block, first=n_hdus == 0)
            size = self._data_size(header, n_hdus)
            data = len(self._bytes)
            padded = -(-size // _BLOCK) * _BLOCK
            if data + padded > self._limit:
                self._refuse_size(f"HDU {n_hdus} claims {size:,} bytes")
            while (left := data + padded - len(self._bytes)) and self._read(min(left, _CHUNK)):
                pass  # in pieces: a claim needs no memory
            if left:
                found = len(self._bytes) - data
                self._refuse(f"HDU {n_hdus} ends after {found:,} of {padded:,} bytes")
            self._verify(header, start, data, n_hdus)
            if n_hdus == 0:
                extensions = header.get("NEXTEND")
            n_hdus += 1
        if isinstance(extensions, int) and n_hdus - 1 < extensions:
            self._refuse(f"it has {n_hdus - 1} of {extensions} extensions")
        return self._bytes, n_hdus

    def _read(self, size):
        piece = self._stream.read(size)
        self._bytes += piece
        return piece

    def _is_padding(self, block):
        """Return whether the file ends with zeros or blanks; refuse other things after it."""
        if block.startswith(b"XTENSION"):
            return False
        del self._bytes[-len(block) :]
        if block.strip(b"\0 ") or self._stream.read(_CHUNK).strip(b"\0 "):
            self._refuse("what follows its last HDU is no extension")
        if self._stream.read(1):
            self._refuse_size("what follows its last HDU is large")
        return True

    def _header(self, block, *, first):
        """Return the header that begins with a block, and read all of it."""
        from astropy.io import fits

        start = b"SIMPLE  =" if first else b"XTENSION="
        if not block.startswith(start):
            self._refuse(f"it does not begin with {start.decode()!r}")
        begin = len(self._bytes) - len(block)
        for _ in range(_MOST_HEADER_BLOCKS):
            if len(block) < _BLOCK:
                self._refuse("a header has no END card")
            if any(block[i : i + 80] == _END for i in range(0, _BLOCK, 80)):
                break
            block = self._read(_BLOCK)
        else:
            self._refuse(f"a header has more than {36 * _MOST_HEADER_BLOCKS:,} cards")
        return fits.Header.fromstring(bytes(self._bytes[begin:]))

    def _data_size(self, header, number):
        """Return the size of an HDU's data in bytes, after checks of what makes it."""
        axes = range(1, self._integer(header, "NAXIS", 0, 999) + 1)
        bits = self._integer(header, "BITPIX", -64, 64)
        if bits not in _BITPIX:
            self._refuse(f"BITPIX of HDU {number} is {bits}")
        lengths = [self._integer(header, f"NAXIS{axis}", 0) for axis in axes]
        if header.get("GROUPS") is True and lengths[:1] == [0]:
            self._refuse("random groups are not supported")
        count = self._integer(header, "PCOUNT", 0, default=0)
        groups = self._integer(header, "GCOUNT", 0, default=1)
        if str(header.get("XTENSION")).strip() in {"BINTABLE", "TABLE"}:
            self._check_columns(header, lengths)
        elements = int(np.prod(lengths, dtype=object)) if lengths else 0
        return abs(bits) // 8 * groups * (count + elements)

    def _check_columns(self, header, lengths):
        """Check that the columns of a table fit its rows."""
        if len(lengths) != 2:
            self._refuse(f"a table has {len(lengths)} axes")
        n_columns = self._integer(header, "TFIELDS", 0, _MOST_COLUMNS)
        if str(header["XTENSION"]).strip() == "TABLE":
            return
        width = 0
        for number in range(1, n_columns + 1):
            form = header.get(f"TFORM{number}")
            found = re.match(r"\s*(\d*)([LXBIJKAEDCMPQ])", str(form))
            if not found:
                self._refuse(f"TFORM{number} is {form!r}")
            if not isinstance(header.get(f"TTYPE{number}"), str):
                self._refuse(f"TTYPE{number} is absent or no text")
            width += int(found[1] or 1) * _WIDTHS[found[2]]
        if width > lengths[0]:
            self._refuse(f"the columns of a table have {width:,.0f} bytes, its rows {lengths[0]:,}")

    def _integer(self, header, keyword, least, most=None, default=None):
        value = header.get(keyword, default)
        if isinstance(value, bool) or not isinstance(value, int):
            self._refuse(f"{keyword} is {value!r}" if keyword in header else f"{keyword} is absent")
        if value < least or (most is not None and value > most):
            self._refuse(f"{keyword} is {value}")
        return value

    def _verify(self, header, start, data, number):
        """Note which checksums of an HDU do not match."""
        for keyword, begin in (("DATASUM", data), ("CHECKSUM", start)):
            text = str(header.get(keyword, "")).strip()
            if not text:
                continue
            wanted = 0 if keyword == "CHECKSUM" else int(text) if text.isdigit() else -1
            found = checksum_of(np.frombuffer(memoryview(self._bytes)[begin:], np.uint8))
            if found % _ONES != wanted % _ONES:
                self.mismatches.append(f"{keyword} of HDU {number}")
                return

    def _refuse(self, reason):
        raise RefusedError(f"{self._path} is no readable FITS file, or truncated: {reason}")

    def _refuse_size(self, reason):
        raise RefusedError(
            f"{self._path} is too large: {reason}, the limit is {self._limit:,} "
            "(scope_models.io.conf.max_bytes, max_ratio)"
        )
