"""Damaged, cut off and hostile FITS files are refused before they cost memory."""

import gzip
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from scope_models.exceptions import DamagedFileWarning
from scope_models.io import conf
from scope_models.io._opening import column_of, first_table, open_fits, read_table

BLOCK = 2880
pytestmark = pytest.mark.filterwarnings(
    "ignore::astropy.utils.exceptions.AstropyUserWarning:astropy.io.fits"
)


def write(path, *, checksum):
    """Write a file of three HDUs that gives their number."""
    rng = np.random.default_rng(1)
    primary = fits.PrimaryHDU()
    primary.header["NEXTEND"] = 2
    table = fits.BinTableHDU(Table({"TIME": np.arange(500.0), "X": rng.normal(size=500)}))
    hdus = fits.HDUList([primary, table, fits.ImageHDU(rng.normal(size=(9, 9)))])
    hdus.writeto(path, checksum=checksum)
    return path


@pytest.fixture
def path(tmp_path):
    return write(tmp_path / "star.fits", checksum=True)


@pytest.fixture
def plain(tmp_path):
    return write(tmp_path / "plain.fits", checksum=False)


def times(path):
    with open_fits(path) as hdus:
        return column_of(first_table(hdus, path), "TIME", path)


def read(path):
    """Read a file, and return the peak of the memory that it needed."""
    tracemalloc.start()
    try:
        return times(path)
    finally:
        read.peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()


def changed(path, old, new):
    """Replace bytes of a file, once, and leave its checksums as they were."""
    content = path.read_bytes()
    assert old in content
    assert len(old) == len(new)
    path.write_bytes(content.replace(old, new, 1))
    return path


def test_whole_file(path):
    assert np.array_equal(read(path), np.arange(500.0))
    with open_fits(path) as hdus:
        image = hdus[2].data
    assert np.array_equal(image, fits.getdata(path, 2))


@pytest.mark.parametrize(
    "end, match",
    [
        (2 * BLOCK, "HDU 1 claims more bytes than the file has"),
        (-1, "HDU 2 claims more bytes than the file has"),
        (BLOCK + 100, "Header size is not multiple of 2880"),
    ],
)
def test_cut_off(path, end, match):
    path.write_bytes(path.read_bytes()[:end])
    with pytest.raises(ValueError, match=rf"star\.fits is not a readable FITS .* {match}"):
        read(path)


def test_extensions_that_are_gone(path):
    """A file can be cut between two of them, but more often a user has left some out."""
    with fits.open(path) as hdus:
        hdus[:2].writeto(path.with_name("less.fits"), checksum=True)
    with pytest.warns(DamagedFileWarning, match=r"NEXTEND \(1 of 2 extensions\) does not match"):
        assert len(read(path.with_name("less.fits"))) == 500


def test_what_follows(path):
    content = path.read_bytes()
    path.write_bytes(content + bytes(5000))
    assert len(read(path)) == 500
    path.write_bytes(content + b"XTENSIOM" + bytes(5000))
    with pytest.raises(ValueError, match="bytes after its last HDU are not an extension"):
        read(path)


@pytest.mark.parametrize("cut", [1, 4, 8, 100])
def test_gzip_cut_off(path, cut):
    packed = path.with_suffix(".fits.gz")
    packed.write_bytes(gzip.compress(path.read_bytes())[:-cut])
    with pytest.raises(ValueError, match=r"not a readable FITS file, or is truncated"):
        read(packed)


def test_gzip_with_wrong_crc(path):
    packed = path.with_suffix(".fits.gz")
    content = bytearray(gzip.compress(path.read_bytes()))
    content[-8] ^= 1
    packed.write_bytes(content)
    with pytest.raises(ValueError, match="CRC check failed"):
        read(packed)


@pytest.mark.parametrize("where, keyword", [(4 * BLOCK + 8, "DATASUM"), (-BLOCK, "DATASUM")])
def test_changed_data(path, where, keyword):
    content = bytearray(path.read_bytes())
    content[where] ^= 1
    path.write_bytes(content)
    with pytest.warns(DamagedFileWarning, match=rf"star\.fits: {keyword} of HDU \d does not match"):
        read(path)


def test_changed_header(path):
    changed(path, b"TTYPE2  = 'X   ", b"TTYPE2  = 'Y   ")
    with pytest.warns(DamagedFileWarning, match=r"star\.fits: CHECKSUM of HDU 1 does not match"):
        read(path)


def test_sums_are_those_of_astropy(shared_data):
    """Archive files have sums of other writers."""
    for name in ("tess_tpf/tesssip_tpf1.fits", "poscorr/ktwo206103150-c03_llc.fits"):
        with open_fits(shared_data / name) as hdus:
            assert any("CHECKSUM" in hdu.header for hdu in hdus), name


@pytest.mark.parametrize(
    "old, new, match",
    [
        (b"TFIELDS =                    2", b"TFIELDS =            999999999", "TFIELDS is 9999"),
        (b"TFIELDS =                    2", b"TFIELDS =                    T", "TFIELDS is True"),
        (
            b"NAXIS2  =                  500",
            b"NAXIS2  =        1099511627776",
            "HDU 1 claims more bytes",
        ),
        (
            b"NAXIS2  =                  500",
            b"NAXIS2  =                   -5",
            "bytes after its last HDU",
        ),
        (b"NAXIS2  =                  500", b"NAXIX2  =                  500", "NAXIS2"),
        (b"TFORM1  = 'D       '", b"TFORM1  = '9999999D'", "have 80,000,000 bytes"),
        (b"TFORM2  = 'D       '", b"TFORM2  = '999999D '", "columns of a table have 8,000,000"),
        (b"TFORM2  = 'D       '", b"TFORM2  = 'y       '", "Format 'y' is not recognized"),
        (b"TTYPE1  = ", b"TTYPF1  = ", "field names must be strings"),
        (b"NAXIS   =                    0", b"NAXIS   =        1099511627776", "NAXIS is 10995"),
        (b"NAXIS   =                    2", b"NAXIS   =        1099511627776", "NAXIS is 10995"),
        (b"SIMPLE  =", b"PK\x03\x04    =", "No SIMPLE card found"),
        (b"XTENSION= 'BINTABLE", b"XTENSION= 'IMAGE   ", "has no binary table"),
    ],
)
def test_claims_of_headers(plain, old, new, match):
    changed(plain, old, new)
    with pytest.raises(ValueError, match=rf"plain\.fits.*{match}"):
        read(plain)
    assert read.peak < 2e6


def test_header_without_end(path):
    path.write_bytes(path.read_bytes()[:BLOCK].replace(b"END     ", b"ENT     ") * 1100)
    with pytest.raises(ValueError, match="Header missing END card"):
        read(path)


def bomb(path, size):
    """Write a compressed file that claims and holds an image of zeros."""
    header = fits.PrimaryHDU().header
    header["BITPIX"], header["NAXIS"] = 8, 1
    header.insert("NAXIS", ("NAXIS1", size), after=True)
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    with path.open("wb") as stream:
        stream.write(packer.compress(header.tostring().encode()))
        zeros = bytes(1 << 20)
        for _ in range(size >> 20):
            stream.write(packer.compress(zeros))
        stream.write(packer.compress(bytes(size % (1 << 20))))
        stream.write(packer.flush())
    return path


def test_decompressed_size(tmp_path, monkeypatch):
    path = bomb(tmp_path / "bomb.fits.gz", 36_000 * BLOCK)
    assert path.stat().st_size < 2e5
    with pytest.raises(ValueError, match=r"bomb\.fits\.gz is too large: the limit is 67,"):
        read(path)
    assert read.peak < 8e7
    monkeypatch.setattr(conf, "max_ratio", 2000)
    with pytest.raises(ValueError, match="has no binary table"):
        read(path)
    monkeypatch.setattr(conf, "max_bytes", 10**8)
    with pytest.raises(ValueError, match="the limit is 100,000,000"):
        read(path)


def test_size_of_a_plain_file(path, monkeypatch):
    monkeypatch.setattr(conf, "max_bytes", 10_000)
    with pytest.raises(ValueError, match=r"star\.fits is too large: the limit is 10,000 bytes"):
        read(path)


def test_hidden_bomb(path):
    packed = path.with_suffix(".fits.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()) + gzip.compress(bytes(100 << 20)))
    with pytest.raises(ValueError, match="is too large: the limit is 67,108,864 bytes"):
        read(packed)
    assert read.peak < 8e7


def test_threads_read_the_same_file(path):
    """Nothing that another thread looks at changes its size."""
    path.write_bytes(path.read_bytes() + bytes(BLOCK))
    with ThreadPoolExecutor(8) as pool:
        for time in pool.map(times, [path] * 64):
            assert np.array_equal(time, np.arange(500.0))


def test_tables_of_spreadsheets(tmp_path):
    """They begin with a byte-order mark, and end lines as Windows does."""
    (tmp_path / "stars.csv").write_bytes("\ufeffmag,name\r\n12.5,a b\r\n".encode())
    table = read_table(tmp_path / "stars.csv")
    assert table.colnames == ["mag", "name"]
    assert list(table[0]) == [12.5, "a b"]
