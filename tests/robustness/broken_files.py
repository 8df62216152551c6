"""Malformed FITS files, and what the readers make of them.

``python tests/robustness/broken_files.py`` prints the table of the page on robustness.
"""

import gzip
import io
import signal
import sys
import tempfile
import warnings
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

try:
    import resource
except ImportError:  # Windows
    resource = None

import numpy as np
from astropy.io import fits
from astropy.utils.exceptions import AstropyWarning

from scope_models import Detector, Motion, Scene, Star, read_scene, read_truth, simulate
from scope_models.exceptions import DamagedFileWarning, LostLightWarning
from scope_models.fitting import TPFFit
from scope_models.io import read_pixels, read_tpf
from scope_models.io._light_curves import make_light_curve_hdulist
from scope_models.io._opening import read_positions

LARGEST_MEMORY = 200e6  # bytes that a call may add to the process; the files have up to 0.3 MB
LONGEST_TIME = 20  # seconds per call
BLOCK = 2880


@dataclass(frozen=True)
class Variant:
    """A malformed file: its kind, and whether a reader may take it without a word.

    ``damaged`` files are bytes that differ from those that were written. The others are well-formed
    files with odd contents, which a reader may take.
    """

    kind: str
    name: str
    content: bytes
    damaged: bool = True


LAYOUTS = ("k2", "kepler", "tess", "light curve", "scene")


@cache
def template(layout):
    """Return the bytes of a small file of a layout, with checksums."""
    preset = layout if layout in {"k2", "kepler", "tess"} else "k2"
    motion = Motion.k2_roll(30, seed=1)
    detector = Detector.preset(preset, shape=(5, 5))
    time_format = "btjd" if preset == "tess" else "bkjd"
    motion = Motion(motion.time, motion.x, motion.y, time_format=time_format)
    scene = Scene(Star(12.0), detector, motion, seed=1)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", LostLightWarning)  # the stamp is small
        path = Path(folder) / "star.fits"
        if layout == "scene":
            return scene.write(path).read_bytes()
        simulate(scene).write(path)
        if layout == preset:
            return path.read_bytes()
        tpf = read_tpf(path)
    series = read_pixels(tpf)
    values = {"TIME": series.time, "FLUX": series.flux.sum(axis=(1, 2))}
    values |= {"POS_CORR1": series.pos_corr[:, 0], "POS_CORR2": series.pos_corr[:, 1]}
    columns = [fits.Column(name, "D", array=np.array(v)) for name, v in values.items()]
    return written(make_light_curve_hdulist(tpf, columns, aperture=series.aperture))


def written(hdus):
    stream = io.BytesIO()
    fits.HDUList(hdus).writeto(stream, checksum=True)
    return stream.getvalue()


def variants(*layouts):
    """Yield malformed files of some layouts, by default of all, and files that are none."""
    for layout in layouts or LAYOUTS:
        content, rng = template(layout), np.random.default_rng(LAYOUTS.index(layout))
        for maker in (_cut, _flipped, _packed, _claims, _cards, _values, _structure):
            for kind, name, changed, damaged in maker(content, rng):
                yield Variant(kind, f"{layout}: {name}", changed, damaged)
    if not layouts:
        yield from no_fits()


def _cut(content, rng):
    borders = [BLOCK * i for i in (1, 2, 5)] + [len(content) - BLOCK, len(content) - 1]
    for end in [0, 1, 79, *borders, *rng.integers(1, len(content), 14)]:
        yield "cut off", f"after {end} bytes", content[: int(end)], True


def _headers(content):
    """Return the offsets of the blocks of headers."""
    hdus = fits.open(io.BytesIO(content))
    places = [(info["hdrLoc"], info["datLoc"]) for info in (hdu.fileinfo() for hdu in hdus)]
    hdus.close()
    return places


def _flipped(content, rng):
    places = _headers(content)
    for _ in range(25):
        start, end = places[rng.integers(len(places))]
        yield "bit in a header", *_with_flip(content, int(rng.integers(start, end)), rng)
    starts = [*(start for start, _ in places[1:]), len(content)]
    data = [(end, start) for (_, end), start in zip(places, starts, strict=True) if start > end]
    for _ in range(12):
        start, end = data[rng.integers(len(data))]
        yield "bit in the data", *_with_flip(content, int(rng.integers(start, end)), rng)


def _with_flip(content, where, rng):
    changed = bytearray(content)
    changed[where] ^= 1 << int(rng.integers(8))
    return f"at byte {where}", bytes(changed), True


def _packed(content, rng):
    packed = gzip.compress(content, mtime=0)
    for cut in (1, 4, 8, 9, len(packed) // 2, len(packed) - 12):
        yield "gzip", f"cut by {cut}", packed[:-cut], True
    wrong = bytearray(packed)
    wrong[-6] ^= 1
    yield "gzip", "wrong CRC", bytes(wrong), True
    for where in rng.integers(10, len(packed) - 8, 3):
        wrong = bytearray(packed)
        wrong[where] ^= 8
        yield "gzip", f"bit at {where}", bytes(wrong), True
    yield "gzip", "garbage after it", packed + b"garbage", True
    yield "gzip", "zeros after it", packed + gzip.compress(bytes(1 << 23)), True


def _card(keyword, value):
    return f"{keyword:8s}= {value:>20s}".ljust(80).encode()


CLAIMS = ("-1", "0", "3", "2147483648", "1099511627776", "9223372036854775807", "T", "1.5", "")


def _claims(content, rng):
    """Replace numbers that say how large the parts of the file are."""
    for hdu, (start, end) in enumerate(_headers(content)[:2]):
        header = content[start:end]
        for keyword in ("BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "PCOUNT", "GCOUNT", "TFIELDS"):
            where = header.find(f"{keyword:8s}=".encode())
            if where < 0:
                continue
            old = header[where : where + 80]
            for value in rng.choice(CLAIMS, 5, replace=False):
                new = _card(keyword, str(value))
                if old[:30] != new[:30]:
                    changed = content[: start + where] + new + content[start + where + 80 :]
                    yield "size in a header", f"{keyword} = {value} in HDU {hdu}", changed, True


def _cards(content, _):
    """Remove or replace cards, and write the file again."""
    for keyword in (
        "TTYPE1",
        "TFORM1",
        "TFORM5",
        "TDIM5",
        "TTYPE5",
        "TUNIT5",
        "BJDREFI",
        "EXTNAME",
    ):
        changed = content.replace(f"{keyword:8s}=".encode(), f"{'X' + keyword[1:]:8s}=".encode())
        if changed != content:
            yield "card", f"without {keyword}", changed, True
    for hdu, keyword, value in (
        *((1, "BJDREFI", value) for value in (2400000, "soon", 2454833.5, True)),
        *((0, "TELESCOP", value) for value in ("", "HST", 5)),
        *((0, "MISSION", value) for value in ("", "unknown")),
        (1, "TNULL3", 5),
        (1, "TSCAL5", 1e300),
        (1, "TZERO5", 1e300),
        (1, "TDIM5", "(5,7)"),
        (1, "TDIM5", "(-5,-5)"),
        (1, "TDIM5", "(99999999,99999999)"),
        (1, "THEAP", 10**12),
        (1, "TFORM1", "PD(99999999)"),
        (1, "TFORM1", "QD"),
        (1, "TUNIT5", "m / kg"),
    ):
        with fits.open(io.BytesIO(content)) as hdus:
            hdus[hdu].header[keyword] = value
            raw = hdus[hdu].header.tostring().encode()
            start, end = _headers(content)[hdu]
            yield "card", f"{keyword} = {value}", content[:start] + raw + content[end:], True


def _changed_columns(content, change):
    """Return a well-formed file with other columns in its first table."""
    with fits.open(io.BytesIO(content)) as hdus:
        columns = {column.name: np.array(hdus[1].data[column.name]) for column in hdus[1].columns}
        units = {column.name: column.unit for column in hdus[1].columns}
        change(columns)
        made = []
        for name, values in columns.items():
            count = int(np.prod(values.shape[1:], dtype=int)) or 1
            form = {"f8": "D", "f4": "E", "i4": "J", "i2": "I", "b1": "L", "i8": "K", "u1": "B"}
            kind = values.dtype.str[1:]
            kind = (
                f"{count * values.dtype.itemsize}A" if kind[0] in "SU" else f"{count}{form[kind]}"
            )
            dim = "(" + ",".join(map(str, values.shape[:0:-1])) + ")" if values.ndim > 2 else None
            made.append(fits.Column(name, kind, array=values, dim=dim, unit=units.get(name)))
        header = hdus[1].header.copy()
        for keyword in list(header):
            if keyword.startswith(("TTYPE", "TFORM", "TDIM", "TUNIT", "TDISP", "TNULL", "NAXIS")):
                del header[keyword]
        hdus[1] = fits.BinTableHDU.from_columns(made, header=header)
        return written(hdus)


def _values(content, _):
    def fill(name, value):
        def change(columns):
            if name in columns:
                columns[name] = np.full_like(columns[name], value)

        return change

    def drop(name):
        return lambda columns: columns.pop(name, None)

    def order(make):
        return lambda columns: columns.update(TIME=make(columns["TIME"]))

    def retype(name, kind):
        def change(columns):
            if name in columns:
                columns[name] = columns[name].astype(kind)

        return change

    changes = {
        **{f"without {n}": drop(n) for n in ("TIME", "FLUX", "FLUX_ERR", "QUALITY", "POS_CORR1")},
        **{f"without {n}": drop(n) for n in ("CADENCENO", "FLUX_BKG", "RAW_CNTS")},
        **{f"TIME {v}": fill("TIME", v) for v in (np.nan, np.inf, 0.0, 1e300)},
        **{f"FLUX {v}": fill("FLUX", v) for v in (np.nan, np.inf, -np.inf, 0.0, -1e30, 1e30)},
        **{f"FLUX_ERR {v}": fill("FLUX_ERR", v) for v in (np.nan, 0.0, -1.0, np.inf)},
        **{f"POS_CORR1 {v}": fill("POS_CORR1", v) for v in (np.nan, 1e30, np.inf)},
        **{f"CADENCENO {v}": fill("CADENCENO", v) for v in (0, 7, -1)},
        **{f"QUALITY {v}": fill("QUALITY", v) for v in (-1, 2**31 - 1)},
        "TIME reversed": order(lambda time: time[::-1]),
        "TIME twice": order(lambda time: np.repeat(time, 2)[: len(time)]),
        "TIME with NaN": order(lambda time: np.where(np.arange(len(time)) % 3, time, np.nan)),
        "TIME as text": retype("TIME", "S8"),
        "FLUX as text": retype("FLUX", "S8"),
        "FLUX as integers": retype("FLUX", "i4"),
        "CADENCENO as floats": retype("CADENCENO", "f8"),
        "QUALITY as floats": retype("QUALITY", "f4"),
        "QUALITY as text": retype("QUALITY", "S4"),
        "FLUX one number per row": lambda c: c.update(FLUX=np.ones(len(c["TIME"]))),
        "no rows": lambda c: c.update({name: values[:0] for name, values in c.items()}),
        "one row": lambda c: c.update({name: values[:1] for name, values in c.items()}),
    }
    for name, change in changes.items():
        try:
            changed = _changed_columns(content, change)
        except (KeyError, ValueError):
            continue  # this layout has no such column
        yield "odd values", name, changed, False


def _structure(content, _):
    with fits.open(io.BytesIO(content)) as hdus:
        whole = list(hdus)
        for i in range(1, len(whole)):
            left = [hdu for j, hdu in enumerate(whole) if j != i]
            yield "extensions", f"without {whole[i].name}", written(left), True
        yield "extensions", "in reverse", written([whole[0], *whole[:0:-1]]), False
        yield "extensions", "twice", written([*whole, *whole[1:]]), False
    start, _end = _headers(content)[1]
    yield "extensions", "without its primary HDU", content[start:], True
    yield "extensions", "zeros within", content[:start] + bytes(BLOCK) + content[start:], True
    yield "extensions", "text after it", content + b"text" * 1000, True
    lost = content.replace(b"END".ljust(80), b"ENE".ljust(80), 1)
    yield "extensions", "header without END", lost, True


def no_fits():
    """Yield files that are no FITS files."""
    text = b"<html><body>404 Not Found</body></html>\n"
    for name, content in {
        "empty": b"",
        "text": text,
        "long text": text * 1000,
        "zip": b"PK\x03\x04" + bytes(5000),
        "PNG": b"\x89PNG\r\n\x1a\n" + bytes(5000),
        "bzip2": b"BZh91AY&SY" + bytes(5000),
        "zeros": bytes(100_000),
        "blanks": b" " * 100_000,
        "gzip of nothing": gzip.compress(b""),
        "gzip of zeros": gzip.compress(bytes(200 << 20), 9),
        "gzip of gzip": gzip.compress(gzip.compress(text)),
        "gzip header": b"\x1f\x8b",
        "pickle": b"\x80\x04\x95" + bytes(100),
    }.items():
        yield Variant("no FITS file", name, content)
    size = 300 << 20
    header = fits.PrimaryHDU().header
    header["NAXIS"], header["BITPIX"] = 1, 8
    header.insert("NAXIS", ("NAXIS1", size), after=True)
    bomb = gzip.compress(header.tostring().encode() + bytes(size), 9)
    yield Variant("no FITS file", "bomb: an image of zeros", bomb)


READERS = {
    "read_pixels": read_pixels,
    "read_tpf": read_tpf,
    "read_positions": read_positions,
    "Motion.from_file": Motion.from_file,
    "read_truth": read_truth,
    "read_scene": read_scene,
    "TPFFit.read": TPFFit.read,
}
OUTCOMES = ("refused", "warned", "read", "differs", "failed")


@contextmanager
def _limits():
    """Raise an error if a call takes too long, on systems with signals."""

    def stop(*_):
        raise AssertionError(f"took more than {LONGEST_TIME} s")

    if not hasattr(signal, "SIGALRM"):
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_TIME)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcome(reader, variant, folder, truth=None):
    """Return what a reader makes of a file: a word of OUTCOMES and its message.

    "refused": a ValueError or OSError of one line that names the file; "warned": read, with a
    DamagedFileWarning; "read": read, with the values of the whole file, or a file that is well
    formed; "differs": read with other values, without a warning; "failed": anything else.
    """
    path = folder / "broken.fits"
    path.write_bytes(variant.content)
    before = _peak()
    try:
        with warnings.catch_warnings(record=True) as caught, _limits():
            warnings.simplefilter("always")
            value = READERS[reader](path)
    except (ValueError, OSError) as error:
        message = str(error)
        good = "broken.fits" in message and "\n" not in message
        return ("refused", message) if good else ("failed", f"{type(error).__name__}: {message}")
    except Exception as error:  # noqa: BLE001 (what the readers must not raise)
        return "failed", f"{type(error).__name__}: {error}"
    finally:
        added = _peak() - before
        assert added < LARGEST_MEMORY, f"{variant.name}: {reader} took {added:,} bytes"
    if any(issubclass(item.category, DamagedFileWarning) for item in caught):
        return "warned", str(caught[0].message)
    others = [w for w in caught if not issubclass(w.category, AstropyWarning)]
    if others:
        return "warned", str(others[0].message)
    if variant.damaged and truth is not None and not same(value, truth):
        return "differs", ""
    return "read", ""


def _peak():
    """Return the largest memory that the process ever had, bytes."""
    if resource is None:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def same(one, other):
    """Return whether what two files gave is the same, but for headers."""
    if hasattr(one, "hdu"):
        return same(read_pixels(one), read_pixels(other))
    if hasattr(one, "at_cadences"):
        return one == other
    if isinstance(one, dict):  # positions: beside the columns are facts and the name of the file
        one, other = SimpleNamespace(**one), SimpleNamespace(**other)
    names = ("time", "flux", "flux_err", "quality", "cadenceno", "pos_corr", "x", "y")
    if not any(hasattr(one, name) for name in names):
        return repr(one) == repr(other)
    return all(
        _equal(getattr(one, name), getattr(other, name)) for name in names if hasattr(one, name)
    )


def _equal(one, other):
    if one is None or other is None:
        return one is other
    one, other = (np.asarray(array, dtype=float) for array in (one, other))
    return np.array_equal(one, other, equal_nan=True)


def survey(chosen, folder):
    """Return what every reader makes of some files: (variant, reader, outcome, message)."""
    for variant in chosen:
        layout = variant.name.partition(":")[0]
        for reader in READERS:
            truth = whole(layout, reader) if layout in LAYOUTS else None
            word, message = outcome(reader, variant, folder, truth)
            yield variant, reader, word, message


@cache
def whole(layout, reader):
    """Return what a reader makes of the undamaged file; None if it is not for this reader."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.fits"
        path.write_bytes(template(layout))
        try:
            return READERS[reader](path)
        except ValueError:
            return None


def main():
    """Print the table of outcomes by kind, and what was neither refused nor warned of."""
    counts, listed, n_files = {}, [], Counter()
    with tempfile.TemporaryDirectory() as folder:
        for variant, reader, word, message in survey(variants(*sys.argv[1:]), Path(folder)):
            n_files[variant.kind] += reader == "read_pixels"
            counts.setdefault(variant.kind, Counter())[word] += 1
            if word in {"differs", "failed"}:
                listed.append(f"{word}: {reader}: {variant.name}: {message}")
    lines = [f"{'files':>24s}{'number':>8s}" + "".join(f"{word:>9s}" for word in OUTCOMES)]
    for kind, counter in counts.items():
        row = "".join(f"{counter[word]:9d}" for word in OUTCOMES)
        lines.append(f"{kind:>24s}{n_files[kind]:8d}{row}")
    lines.append(f"{'all':>24s}{sum(n_files.values()):8d}")
    sys.stdout.write("\n".join([*lines, *listed, ""]))


if __name__ == "__main__":
    sys.exit(main())
