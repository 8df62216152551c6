import gzip

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from scope_models import Motion
from scope_models.io._opening import read_positions, time_format_of

N = 2000


@pytest.fixture
def table():
    rng = np.random.default_rng(1)
    return Table(
        {
            "TIME": np.arange(N) * 0.02,
            "POS_CORR1": rng.normal(size=N).astype(np.float32),
            "POS_CORR2": rng.normal(size=N).astype(np.float32),
            "SAP_QUALITY": rng.integers(0, 3, N).astype(np.int32),
            "CADENCENO": np.arange(50, 50 + N, dtype=np.int32),
        }
    )


@pytest.fixture
def path(table, tmp_path):
    path = tmp_path / "star_llc.fits"
    table.write(path)
    return path


def test_values_types_and_byte_order(path, table):
    positions = read_positions(path)
    for name, column in {
        "time": "TIME",
        "x": "POS_CORR1",
        "y": "POS_CORR2",
        "quality": "SAP_QUALITY",
        "cadenceno": "CADENCENO",
    }.items():
        values = positions[name]
        assert np.array_equal(values, table[column])
        assert values.dtype.isnative
    assert positions["x"].dtype == np.float64
    assert positions["time_format"] is None
    assert positions["meta"] == {"filename": "star_llc.fits"}


def test_gzip_gives_the_same(path):
    packed = path.with_suffix(".fits.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert np.array_equal(read_positions(packed)["y"], read_positions(path)["y"])


def test_quality_wins_over_sap_quality(table, tmp_path):
    table["QUALITY"] = table["SAP_QUALITY"] + 4
    table.write(tmp_path / "both.fits")
    assert np.array_equal(read_positions(tmp_path / "both.fits")["quality"], table["QUALITY"])


def test_cadence_numbers_of_zero_are_counted(table, tmp_path):
    table["CADENCENO"] = 0
    table.write(tmp_path / "zeros.fits")
    assert np.array_equal(read_positions(tmp_path / "zeros.fits")["cadenceno"], np.arange(1, N + 1))
    assert len(Motion.from_file(tmp_path / "zeros.fits")) == N


def test_lower_case_names_are_found(table, tmp_path):
    table.rename_columns(table.colnames, [name.lower() for name in table.colnames])
    table.write(tmp_path / "lower.fits")
    assert np.array_equal(read_positions(tmp_path / "lower.fits")["quality"], table["sap_quality"])


@pytest.mark.parametrize(
    "name, mission, time_format",
    [
        ("k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz", "K2", "bkjd"),
        ("kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz", "Kepler", "bkjd"),
        ("tess_tpf/tesssip_tpf1.fits", "TESS", "btjd"),
        ("poscorr/ktwo206103150-c03_llc.fits", "K2", "bkjd"),
        ("poscorr/epic205998445_c03_poscorr.fits", None, None),
    ],
)
def test_real_files_have_their_raw_columns(shared_data, name, mission, time_format):
    positions = read_positions(shared_data / name)
    with fits.open(shared_data / name) as hdus:
        raw = hdus[1].data
        assert np.array_equal(positions["time"], raw["TIME"], equal_nan=True)
        assert np.array_equal(positions["x"], raw["POS_CORR1"], equal_nan=True)
        assert np.array_equal(positions["y"], raw["POS_CORR2"], equal_nan=True)
        if mission is None:
            assert positions["quality"] is None
            assert positions["cadenceno"] is None
        else:
            quality = "SAP_QUALITY" if "llc" in name else "QUALITY"
            assert np.array_equal(positions["quality"], raw[quality])
            assert np.array_equal(positions["cadenceno"], raw["CADENCENO"])
            assert positions["meta"]["object"] == hdus[0].header["OBJECT"]
    assert positions["meta"].get("mission") == mission
    assert positions["time_format"] == time_format


def test_missing_column_is_named_with_the_file(table, tmp_path):
    path = tmp_path / "no_positions.fits"
    table["TIME", "CADENCENO"].write(path)
    with pytest.raises(
        ValueError, match=r"no_positions\.fits has no column POS_CORR1 or POS_CORR2 .* it has TIME"
    ):
        read_positions(path)


def test_image_without_table(tmp_path):
    fits.writeto(tmp_path / "image.fits", np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"image\.fits has no binary table"):
        read_positions(tmp_path / "image.fits")


def test_absent_file_and_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*absent\.fits"):
        read_positions(tmp_path / "absent.fits")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        read_positions(tmp_path)


@pytest.mark.parametrize(
    "name, content",
    [
        ("text.fits", b"this is no FITS file\n" * 300),
        ("garbage.fits.gz", b"\x1f\x8b" + bytes(range(256)) * 20),
        ("text.fits.gz", gzip.compress(b"this is no FITS file\n" * 300, mtime=0)),
        ("noise.fits", np.random.default_rng(0).bytes(20000)),
        ("short.fits", b"SIMPLE  ="),
    ],
)
def test_no_fits_file(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        ValueError, match=rf"{name} (is not a readable FITS file|has no binary table)"
    ):
        read_positions(tmp_path / name)


def test_empty_file(tmp_path):
    (tmp_path / "empty.fits").touch()
    with pytest.raises(ValueError, match=r"empty\.fits is empty"):
        read_positions(tmp_path / "empty.fits")


@pytest.mark.parametrize("fraction", [0.02, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("packed", [False, True])
def test_truncated_file(path, fraction, packed):
    content = path.read_bytes()
    if packed:
        path = path.with_suffix(".fits.gz")
        content = gzip.compress(content)
    path.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(ValueError, match=r"star_llc\.fits\S* is not a readable FITS file"):
        read_positions(path)


def test_no_rows(table, tmp_path):
    table[:0].write(tmp_path / "rows.fits")
    with pytest.raises(ValueError, match=r"rows\.fits has no rows"):
        read_positions(tmp_path / "rows.fits")


@pytest.mark.parametrize("column", [np.zeros((N, 2)), np.array(["a"] * N)])
def test_column_must_hold_one_number_per_row(table, tmp_path, column):
    table["POS_CORR1"] = column
    table.write(tmp_path / "wide.fits")
    with pytest.raises(ValueError, match=r"column POS_CORR1 of .*wide\.fits must hold one number"):
        read_positions(tmp_path / "wide.fits")


def test_time_format_of_header():
    assert time_format_of({"BJDREFI": 2454833, "BJDREFF": 0.0}) == "bkjd"
    assert time_format_of({"TELESCOP": "TESS"}) == "btjd"
    assert time_format_of({}) is None
    with pytest.raises(ValueError, match="`BJDREFI` must be 2454833 or 2457000, got 2400000"):
        time_format_of({"BJDREFI": 2400000})
