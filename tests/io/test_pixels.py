"""The door in: pixels of lightkurve's objects and of files are those of astropy's reader."""

import gzip
import pickle

import numpy as np
import pytest
from astropy.io import fits

from scope_models import Detector, Motion, Star, simulate
from scope_models.correctors import detrend_file
from scope_models.io import PixelSeries, read_pixels, read_tpf
from scope_models.io.pixels import usable_positions
from scope_models.io.tpf import write_hdulist
from scope_models.photometry import aperture_flux
from scope_models.simulation import inject

FILES = {
    "K2": "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "Kepler": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
    "TESS": "tess_tpf/tesssip_tpf1.fits",
}
ARRAYS = ("time", "cadenceno", "quality", "flux", "flux_err", "flux_bkg", "pos_corr", "aperture")


@pytest.fixture(scope="module")
def observation():
    return simulate(Star(12.0), Detector.k2(shape=(6, 5)), Motion.k2_roll(40), seed=1)


@pytest.fixture
def hdus(observation):
    return observation.to_tpf().hdu


def rewritten(hdus, path, change):
    """Write a file whose pixel table was changed, without checksums."""
    change(hdus)
    for hdu in hdus:
        for card in ("CHECKSUM", "DATASUM"):
            hdu.header.remove(card, ignore_missing=True)
    hdus.writeto(path)
    return path


def without_column(name):
    def change(hdus):
        columns = [column for column in hdus[1].columns if column.name != name]
        hdus[1] = fits.BinTableHDU.from_columns(columns, hdus[1].header)

    return change


@pytest.mark.parametrize("mission", FILES)
def test_real_files_are_read_as_astropy_reads_them(shared_data, mission):
    series = read_pixels(shared_data / FILES[mission], quality_bitmask="none")
    with fits.open(shared_data / FILES[mission]) as hdus:
        raw, header = hdus[1].data, hdus[0].header
        assert np.array_equal(series.time, raw["TIME"], equal_nan=True)
        assert np.array_equal(series.cadenceno, raw["CADENCENO"])
        assert np.array_equal(series.quality, raw["QUALITY"])
        for name in ("flux", "flux_err", "flux_bkg"):
            assert np.array_equal(getattr(series, name), raw[name.upper()], equal_nan=True)
        assert np.array_equal(series.pos_corr[:, 0], raw["POS_CORR1"], equal_nan=True)
        assert np.array_equal(series.pos_corr[:, 1], raw["POS_CORR2"], equal_nan=True)
        assert np.array_equal(series.aperture, (hdus["APERTURE"].data & 2) > 0)
        assert series.header["OBJECT"] == header["OBJECT"]
        assert series.header["INT_TIME"] == hdus[1].header["INT_TIME"]
    assert series.mission.name == mission
    assert series.time_format == ("btjd" if mission == "TESS" else "bkjd")
    assert all(getattr(series, name).dtype.isnative for name in ARRAYS)


@pytest.mark.parametrize("mission", FILES)
@pytest.mark.parametrize("bitmask", ["default", "none"])
def test_objects_give_what_their_files_give(shared_data, mission, bitmask):
    import lightkurve

    tpf = lightkurve.read(shared_data / FILES[mission], quality_bitmask=bitmask)
    series = read_pixels(tpf)
    assert series == read_pixels(shared_data / FILES[mission], quality_bitmask=bitmask)
    part = read_pixels(tpf[10:60])
    tpf.hdu.close()
    assert part == series[10:60]
    assert np.array_equal(part.cadenceno, series.cadenceno[10:60])


@pytest.mark.parametrize("mission", FILES)
def test_lightkurve_object_of_a_file(shared_data, mission):
    import lightkurve

    ours, theirs = (
        read_tpf(shared_data / FILES[mission]),
        lightkurve.read(shared_data / FILES[mission]),
    )
    assert type(ours) is type(theirs)
    assert read_pixels(ours) == read_pixels(theirs)
    curves = [tpf.to_lightcurve(aperture_mask="all") for tpf in (ours, theirs)]
    theirs.hdu.close()
    assert np.array_equal(curves[0].flux.value, curves[1].flux.value, equal_nan=True)
    assert dict(ours.meta) == dict(theirs.meta)


def test_same_from_every_source(observation, tmp_path):
    path = observation.write(tmp_path / "star.fits")
    packed = tmp_path / "star.fits.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    series = read_pixels(path, quality_bitmask="none")
    assert len(series) == 40
    assert series.without_flagged() == read_pixels(path) == read_pixels(packed)
    assert read_pixels(path) == read_pixels(str(path)) == read_pixels(series.without_flagged())
    assert isinstance(series, PixelSeries)
    with fits.open(path) as hdus:
        assert read_pixels(hdus) == series
    assert np.array_equal(series.flux, observation.flux.astype(np.float32))
    assert pickle.loads(pickle.dumps(series)) == series  # noqa: S301


def test_values_cannot_be_changed(observation):
    series = read_pixels(observation.to_tpf())
    with pytest.raises(ValueError, match="read-only"):
        series.flux[0] = 0
    with pytest.raises(TypeError, match="does not support item assignment"):
        series.header["OBJECT"] = "other"
    assert series != series.replace(flux=series.flux + 1)
    assert series != series[1:]
    assert series != "series"
    with pytest.raises(TypeError, match="by slices or masks, got 3"):
        series[3]


def test_replaced_arrays_are_copies(observation):
    """A change of what was given, or of its base, changes no value."""
    series, flux = read_pixels(observation.to_tpf()), np.ones((40, 6, 5))
    series = series[:1].replace(flux=flux[:1])
    flux[:] = 2
    assert (series.flux == 1).all()


def test_text_without_a_finite_time(observation):
    series = read_pixels(observation.to_tpf())
    series = series.replace(time=np.full(len(series), np.nan))
    assert "no times" in repr(series)


def test_quality_bits(observation):
    series = read_pixels(observation.to_tpf())
    n = len(series)
    flagged = series.replace(quality=np.where(np.arange(n) < 5, 32, 0))
    assert len(flagged.without_flagged()) == n - 5
    assert len(flagged.without_flagged(32)) == n - 5
    assert len(flagged.without_flagged("none")) == n
    with pytest.raises(ValueError, match=r'`quality_bitmask` must be "default", "none" or an int'):
        flagged.without_flagged("hard")
    with pytest.raises(ValueError, match=f"all {n} cadences have quality flags of 1"):
        series.replace(quality=np.ones(n, dtype=int)).without_flagged(1)


def test_blank_cards_of_the_table_hide_nothing(hdus):
    """As TELESCOP in the files of lightkurve's TargetPixelFileFactory."""
    hdus[1].header["TELESCOP"] = hdus[1].header["RA_OBJ"] = None
    del hdus[0].header["MISSION"]
    series = read_pixels(hdus)
    assert series.mission.name == "Kepler"
    assert series.header["RA_OBJ"] == hdus[0].header["RA_OBJ"]
    assert series.header["CAMPAIGN"] is None


def test_cadences_without_numbers_are_counted(hdus):
    def zeros(hdus):
        hdus[1].data["CADENCENO"][:] = 0

    zeros(hdus)
    series = read_pixels(hdus)
    assert np.array_equal(series.cadenceno, np.arange(1, 41))
    import lightkurve

    tpf = lightkurve.KeplerTargetPixelFile(hdus, quality_bitmask="none")
    assert read_pixels(tpf) == series


def test_one_cadence(observation, tmp_path):
    tpf = observation.to_tpf()
    path = tmp_path / "one.fits"
    tpf[:1].hdu.writeto(path)
    assert len(read_pixels(path)) == len(read_pixels(tpf[:1])) == 1


def test_absent_columns(hdus):
    for name in ("POS_CORR1", "FLUX_BKG", "CADENCENO"):
        without_column(name)(hdus)
    series = read_pixels(hdus)
    assert series.pos_corr is None
    assert series.flux_bkg is None
    assert np.array_equal(series.cadenceno, np.arange(1, 41))


@pytest.mark.parametrize(
    "change, match",
    [
        (without_column("FLUX"), "is not a target pixel file: it has no column FLUX"),
        (without_column("TIME"), "has no usable time: all of 40 are NaN"),
        (lambda hdus: hdus[1].data["TIME"].fill(np.nan), "no usable time: all of 40 are NaN"),
        (lambda hdus: hdus[1].data["TIME"].fill(5.0), r"times of .* must increase, got 5.0 after"),
        (
            lambda hdus: hdus[1].header.set("BJDREFI", 2400000),
            "`BJDREFI` must be 2454833 or 2457000, got 2400000",
        ),
    ],
)
def test_what_is_refused_names_the_file(hdus, tmp_path, change, match):
    path = rewritten(hdus, tmp_path / "star.fits", change)
    with pytest.raises(ValueError, match=match) as caught:
        read_pixels(path)
    assert str(path) in str(caught.value)


def test_pixels_without_a_shape(hdus, tmp_path):
    path = rewritten(hdus, tmp_path / "star.fits", without_column("FLUX_BKG"))
    path.write_bytes(path.read_bytes().replace(b"TDIM5   ", b"XDIM5   "))
    with pytest.raises(ValueError, match=r"FLUX of .*star\.fits must hold an image of numbers"):
        read_pixels(path)


def test_no_target_pixel_file(tmp_path, shared_data):
    with pytest.raises(TypeError, match=r"`tpf` must be a target pixel file .* got int"):
        read_pixels(5)
    with pytest.raises(FileNotFoundError, match=r"absent\.fits"):
        read_pixels(tmp_path / "absent.fits")
    with pytest.raises(
        ValueError, match=r"llc\.fits is not a target pixel file: it has no column FLUX"
    ):
        read_pixels(shared_data / "poscorr" / "ktwo206103150-c03_llc.fits")


def test_light_curve_is_no_target_pixel_file(tmp_path):
    column = fits.Column("FLUX", "E", array=[1.0, 2.0])
    fits.BinTableHDU.from_columns([column]).writeto(tmp_path / "lc.fits")
    with pytest.raises(ValueError, match=r"lc\.fits is not a target pixel file: column FLUX"):
        read_pixels(tmp_path / "lc.fits")


def test_usable_positions():
    offsets = [[0.0, 49.9], [np.nan, 0.0], [0.0, -50.0], [-1000.0, 0.0], [np.inf, 0.0]]
    assert usable_positions(offsets).tolist() == [True, False, False, False, False]


@pytest.mark.filterwarnings("error")
def test_uncollected_pixels_make_no_warning(tmp_path):
    """Kepler files have rows and columns of NaN, cadences without data, and times that are NaN."""
    tpf = simulate(Star(12), Detector.kepler(shape=(7, 8)), Motion.still(60), seed=1).to_tpf()
    data = tpf.hdu[1].data
    for name in ("FLUX", "FLUX_ERR", "FLUX_BKG", "FLUX_BKG_ERR"):
        data[name][:, 0, :] = data[name][:, :, -1] = data[name][5] = np.nan
    data["TIME"][7] = np.nan
    path = tmp_path / "uncollected.fits"
    write_hdulist(tpf.hdu, path)
    series = read_pixels(path)
    assert np.isnan(series.flux[:, 0]).all()
    assert str(len(series)) in repr(series)
    again = inject(read_tpf(path), np.ones(len(read_tpf(path).time)), 1.0, noise=False)
    write_hdulist(again.hdu, tmp_path / "again.fits")
    np.testing.assert_array_equal(read_pixels(tmp_path / "again.fits").flux, series.flux)
    flux, error = aperture_flux(series.flux, series.aperture, series.flux_err)
    inside = series.aperture[1:, :-1]
    np.testing.assert_allclose(flux[0], series.flux[0, 1:, :-1][inside].sum())
    assert error[0] > 0
    assert len(Motion.from_file(path)) == len(series)
    detrend_file(path, tmp_path / "lc.fits", figure=tmp_path / "lc.png")
