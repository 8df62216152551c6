"""Files: those to read may be damaged or made to harm, those written are there as a whole."""

import gzip
import io
import os
import platform
import secrets
import shutil
import warnings
import zlib
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from astropy.io import fits
from astropy.io.ascii import InconsistentTableError
from astropy.io.registry import IORegistryError
from astropy.table import Table

from scope_models._arrays import native, plain_tree
from scope_models._checks import one_line
from scope_models.exceptions import DamagedFileWarning
from scope_models.missions import TIME_ZEROS, Mission

__all__ = [
    "MOST", "NO_FACTS", "RefusedError", "atomic_path", "cards_of", "check_output", "checksum_of",
    "column_of", "conf", "facts_of", "first_table", "identity", "making", "naming", "open_fits",
    "read_positions", "read_table", "remove_temporaries", "time_format_of",
]  # fmt: skip

#: Limits of files that are read: ``max_bytes``, bytes after decompression, and ``max_ratio``, the
#: factor by which a compressed file may grow beyond 64 MiB.
conf = SimpleNamespace(max_bytes=1 << 30, max_ratio=200)

# Compressed files may always become so large: noise-free simulations compress very well.
_SMALL = 64 << 20
MOST = 999  # axes and columns of the FITS standard
_ONES = 2**32 - 1
_PREFIX = ".scope-models-"
_MACHINE = f"{zlib.crc32(platform.node().encode()):08x}"  # numbers of processes are its own
_POSITIONS = ("TIME", "POS_CORR1", "POS_CORR2")
_TIME_FORMATS = {zero: name for name, zero in TIME_ZEROS.items()}
NO_FACTS = {"", "COMMENT", "HISTORY", "CHECKSUM", "DATASUM", "SIMPLE", "XTENSION", "BITPIX"}
NO_FACTS |= {"EXTEND", "PCOUNT", "GCOUNT", "TFIELDS"}
_FACTS = {name: name.upper() for name in ("object", "campaign", "quarter", "sector", "channel")}
_FACTS |= {"camera": "CAMERA", "ccd": "CCD", "ra": "RA_OBJ", "dec": "DEC_OBJ"}


class RefusedError(ValueError):
    """A file lacks the requested data, or is damaged; the message names it."""


@contextmanager
def open_fits(path):
    """Open a FITS file; any damage is a ValueError that names it, a wrong checksum a warning.

    It is in memory, each header checked before its data are read: the HDUs stay usable.
    """
    content = _content(Path(path))
    try:
        _check_axes(content, 0)
        with fits.open(io.BytesIO(content), memmap=False) as hdus:
            _check(hdus, content, path)
            yield hdus
    except RefusedError as error:
        raise ValueError(str(error)) from None
    except Exception as error:  # astropy raises anything when it reads damaged bytes
        raise ValueError(_unreadable(path, error)) from error


@contextmanager
def naming(path):
    """Let errors begin with the name of a file."""
    try:
        yield
    except ValueError as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path}: {error}") from error


@contextmanager
def making(path, what):
    """Raise any error of what is made of a file as one that names it."""
    try:
        yield
    except Exception as error:
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise RefusedError(f"{path} holds no {what} that can be made: {reason}") from error


def _unreadable(path, reason):
    reason = one_line(reason) or type(reason).__name__  # bytes of a damaged header can be in it
    return f"{path} is not a readable FITS file, or is truncated: {reason}"


def _content(path):
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, not a FITS file")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        raise OSError(f"{path} is not a regular file")
    size, limit = path.stat().st_size, conf.max_bytes
    if size == 0:
        raise ValueError(f"{path} is empty")
    if size > limit:
        raise _too_large(path, limit)
    with path.open("rb") as stream:
        if not stream.peek(2).startswith(b"\x1f\x8b"):
            return stream.read()
        limit = min(limit, max(_SMALL, conf.max_ratio * size))
        content = io.BytesIO()
        try:
            with gzip.GzipFile(fileobj=stream) as unpacked:
                while content.tell() <= limit and (piece := unpacked.read(1 << 20)):
                    content.write(piece)
        except Exception as error:  # of gzip
            raise ValueError(_unreadable(path, error)) from error
    if content.tell() > limit:
        raise _too_large(path, limit)
    return content.getvalue()


def _too_large(path, limit):
    settings = "scope_models.io.conf.max_bytes, max_ratio"
    return ValueError(f"{path} is too large: the limit is {limit:,} bytes ({settings})")


def _check(hdus, content, path):
    """Refuse HDUs that claim more than the file holds; warn of what else does not match."""
    mismatches, end, number = [], 0, 0
    while content[end : end + 9] in {b"SIMPLE  =", b"XTENSION="}:
        _check_axes(content, end)
        hdu = hdus[number]  # read now
        place = hdu.fileinfo()
        start, end = place["hdrLoc"], place["datLoc"] + place["datSpan"]
        if not isinstance(hdu, fits.PrimaryHDU | fits.ImageHDU | fits.BinTableHDU | fits.TableHDU):
            raise TypeError(f"HDU {number} is neither an image nor a table")
        if end > len(content) or place["datSpan"] < 0:
            raise ValueError(f"HDU {number} claims more bytes than the file has")
        if isinstance(hdu, fits.BinTableHDU | fits.TableHDU):
            _check_columns(hdu)
        for keyword, begin in (("DATASUM", place["datLoc"]), ("CHECKSUM", start)):
            text = str(hdu.header.get(keyword, "")).strip()
            wanted = 0 if keyword == "CHECKSUM" else int(text) if text.isdigit() else -1
            found = checksum_of(memoryview(content)[begin:end])
            if text and found % _ONES != wanted % _ONES:
                mismatches.append(f"{keyword} of HDU {number}")
                break
        number += 1
    if content[end:].strip(b"\0 "):
        raise ValueError("bytes after its last HDU are not an extension")
    claimed = hdus[0].header.get("NEXTEND")
    if isinstance(claimed, int) and len(hdus) - 1 < claimed:
        mismatches.append(f"NEXTEND ({len(hdus) - 1} of {claimed} extensions)")
    if mismatches:
        found = f"{' and '.join(mismatches)} do{'es' * (len(mismatches) == 1)} not match"
        message = f"{path}: {found}: the file was damaged, or changed after it was written"
        warnings.warn(message, DamagedFileWarning, stacklevel=5)


def _check_axes(content, start):
    """Refuse more axes than FITS allows, before astropy lists them."""
    stream = io.BytesIO(content)
    stream.seek(start)
    axes = fits.Header.fromfile(stream).get("NAXIS")
    if isinstance(axes, int) and axes > MOST:
        raise ValueError(f"NAXIS is {axes}")


def _check_columns(hdu):
    n_columns = hdu.header["TFIELDS"]
    if isinstance(n_columns, bool) or not 0 <= n_columns <= MOST:
        raise ValueError(f"TFIELDS is {n_columns}")
    width, length = hdu.columns.dtype.itemsize, hdu.header["NAXIS1"]
    if width > length:
        raise ValueError(f"the columns of a table have {width:,} bytes, its rows {length:,}")
    for number in range(1, n_columns + 1):
        if not isinstance(hdu.header.get(f"TTYPE{number}"), str):
            raise TypeError(f"TTYPE{number} is absent or not text")


def checksum_of(data, start=0):
    """Return the ones' complement sum of bytes in 32-bit numbers."""
    if len(data) % 4:
        data = bytes(data) + bytes(-len(data) % 4)
    total = start + int(np.frombuffer(data, ">u4").sum(dtype=np.uint64))
    while total >> 32:
        total = (total & 0xFFFFFFFF) + (total >> 32)
    return total


def read_positions(path):
    """Return arguments of `Motion.from_arrays`, unchecked, of a file; None for what it lacks."""
    with open_fits(path) as hdus:
        table = first_table(hdus, path)
        present = [name.upper() for name in table.columns.names]
        missing = [name for name in _POSITIONS if name not in present]
        if missing:
            lacks, has = " or ".join(missing), ", ".join(present) or "none"
            raise RefusedError(f"{path} has no column {lacks} in its first table; it has {has}")
        wanted = (*_POSITIONS, "QUALITY", "SAP_QUALITY", "CADENCENO")
        columns = {name: column_of(table, name, path) for name in wanted if name in present}
        if len(table.data) == 0:
            raise RefusedError(f"{path} has no rows in its first table")
        header = cards_of(hdus[0].header, table.header)
    time, x, y = (columns[name] for name in _POSITIONS)
    number = columns.get("CADENCENO")
    if number is not None and not number.any():  # TESScut's files have only zeros
        number = np.arange(1, len(number) + 1)
    with naming(path):
        time_format = time_format_of(header)
    return {
        "time": time, "x": x, "y": y, "quality": columns.get("QUALITY", columns.get("SAP_QUALITY")),
        "cadenceno": number, "time_format": time_format,
        "meta": {**facts_of(header), "filename": Path(path).name},
    }  # fmt: skip


def read_table(path):
    try:
        table = Table.read(path)
    except (IORegistryError, InconsistentTableError, UnicodeDecodeError) as error:
        message = f"{path} is not a table that astropy can read, such as .csv, .ecsv or .fits"
        raise ValueError(message) from error
    for name in table.colnames[:1]:  # spreadsheets begin files in UTF-8 with a mark
        table.rename_column(name, name.removeprefix("\ufeff"))
    return table


def facts_of(header):
    """Return mission, star and detector in the header of an archive file."""
    mission = header.get("MISSION") or header.get("TELESCOP")
    facts = {"mission": mission} | {name: header.get(card) for name, card in _FACTS.items()}
    return {k: v for k, v in facts.items() if isinstance(v, str | int | float) and v != ""}


def time_format_of(header):
    """Return the format of the times by BJDREFI, else by the mission; None if there is neither."""
    reference = header.get("BJDREFI")
    if isinstance(reference, int | float):
        day = reference + (header.get("BJDREFF") or 0)
        if day not in _TIME_FORMATS:
            raise ValueError(f"`BJDREFI` must be 2454833 or 2457000, got {day}")
        return _TIME_FORMATS[day]
    mission = Mission.from_header(header)
    return mission and mission.time_format


def first_table(hdus, path):
    table = next((hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU)), None)
    if table is None:
        raise RefusedError(f"{path} has no binary table")
    return table


def column_of(table, name, path, ndim=1):
    """Return a column of numbers or images, native; floats are float64, infinite pixels NaN."""
    values = np.asarray(table.data[name])
    if values.ndim != ndim or values.dtype.kind not in "iuf":
        what = {1: "one number", 3: "an image of numbers"}[ndim]
        raise RefusedError(f"column {name} of {path} must hold {what} per row")
    values = values.astype(np.float64) if ndim == 3 or values.dtype.kind == "f" else native(values)
    if ndim == 3:
        values[np.isinf(values)] = np.nan
    return values


def cards_of(*headers):
    """Return the facts in headers, the last of which prevail; None for blank cards."""
    facts = {}
    for header in headers:
        # lightkurve's cutouts have numpy's numbers.
        for key, value in plain_tree(dict(header.items())).items():
            if key in NO_FACTS or key.startswith("NAXIS"):
                continue
            known = isinstance(value, (str, bool, int, float, complex))
            facts[key] = value if known else facts.get(key)
    return facts


@contextmanager
def atomic_path(path, *, overwrite=False):
    """Give a hidden path beside ``path``, and move the file into place at the end, in one step.

    When the body raises, it is removed and ``path`` stays as it was. Without ``overwrite``, a file
    that appears meanwhile is kept, too. Errors are an OSError that names the file.
    """
    target = check_output(path, overwrite=overwrite)
    _remove_orphans(target.parent)
    name = f"{_PREFIX}{_MACHINE}-{os.getpid()}-{secrets.token_hex(8)}"
    temporary = target.with_name(name + "".join(target.suffixes[-2:]))
    try:
        yield temporary
        if not overwrite:
            _take_name(path, temporary, target)
        elif target.exists():
            shutil.copymode(target, temporary)
        temporary.replace(target)
    except OSError as error:
        if error.filename not in (None, temporary, str(temporary)):
            raise
        raise type(error)(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


@cache  # a folder may have many files: once is enough
def _remove_orphans(folder):
    """Remove what processes of this machine that were killed have left in a folder."""
    found = folder.glob(f"{_PREFIX}{_MACHINE}-*") if os.name == "posix" else ()  # has signal 0
    for path in found:
        with suppress(OSError):
            try:
                os.kill(int(path.name.split("-")[3]), 0)
            except ProcessLookupError:
                path.unlink()


def remove_temporaries(folder):
    """Remove what killed processes have left, where that is possible."""
    for path in Path(folder).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            path.unlink()


def check_output(path, *, overwrite=False, inputs=()):
    """Return the real place of a file to write; `atomic_path` raises the same errors."""
    target = Path(os.path.realpath(path))
    for source in inputs:
        if identity(source) == identity(target):
            raise ValueError(f"cannot write {path}: it is the input {source}")
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {target.parent}")
    if target.exists() and not target.is_file():
        raise OSError(f"cannot write {path}: it is not a regular file")
    if target.exists() and not overwrite:
        raise _exists(path)
    if not os.access(target.parent, os.W_OK):
        raise PermissionError(f"cannot write {path}: Permission denied in folder {target.parent}")
    return target


def identity(path):
    """Return a key common to all links to a file."""
    try:
        state = Path(path).stat()
    except OSError:
        return os.path.realpath(path)
    return state.st_dev, state.st_ino


def _take_name(path, temporary, target):
    """Give a name, which must be free, to the temporary file, or to an empty one."""
    try:
        try:
            os.link(temporary, target)
        except FileExistsError:
            raise
        except OSError:  # the file system has no hard links
            target.touch(exist_ok=False)
    except FileExistsError:
        raise _exists(path) from None


def _exists(path):
    return FileExistsError(f"{path} exists already; pass overwrite=True to replace it")
