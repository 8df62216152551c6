"""Light-curve files of corrected stars, and the command that writes them."""

import re

import lightkurve
import numpy as np
import pytest
from astropy.io import fits
from astropy.timeseries import TimeSeries

from scope_models.cli import main
from scope_models.correctors import PLDCorrector, detrend_file


@pytest.fixture(scope="module")
def tpf_file(star, tmp_path_factory):
    path = tmp_path_factory.mktemp("tpf") / "star.fits"
    hdus = fits.HDUList([hdu.copy() for hdu in star.tpf.hdu])
    hdus[1].data["FLUX"][7] = np.nan
    hdus.writeto(path)
    return path


def test_lightkurve_reads_the_file(tpf_file, tmp_path):
    output, figure = tmp_path / "lc.fits", tmp_path / "lc.png"
    corrector = detrend_file(tpf_file, output, figure=figure, order=1)
    assert figure.stat().st_size > 10_000
    with fits.open(output, memmap=False, checksum=True) as hdus:
        assert hdus[1].header["BJDREFI"] == 2454833
        assert hdus[0].header["PLDORDER"] == 1
        assert hdus[0].header["PLDNFIT"] == corrector.result.n_used
        assert hdus[0].header["CDPP"] < hdus[0].header["RAWCDPP"]
        assert hdus[0].header["DATE-OBS"].startswith("2014-11")
        np.testing.assert_array_equal(hdus["APERTURE"].data & 2 > 0, corrector.aperture_mask)
        lc = lightkurve.read(hdus)
    corrected = corrector.corrected_lc
    assert type(lc) is type(corrected)
    np.testing.assert_array_equal(lc.time.value, corrected.time.value)
    np.testing.assert_allclose(lc.flux.value, corrected.flux.value, rtol=1e-6)
    np.testing.assert_allclose(lc.flux_err.value, corrected.flux_err.value, rtol=1e-6)
    np.testing.assert_array_equal(lc.cadenceno, corrected.cadenceno)
    raw = np.asarray(lc["raw_flux"].value, dtype=float)
    np.testing.assert_allclose(raw, corrector.original_lc.flux.value, rtol=1e-6)
    assert lc.flux.unit == corrected.flux.unit
    assert lc.meta["TARGETID"] == 7


@pytest.mark.filterwarnings("ignore::astropy.units.UnitsWarning")
def test_astropy_reads_the_file(tpf_file, tmp_path):
    corrector = detrend_file(tpf_file, tmp_path / "lc.fits", order=1)
    series = TimeSeries.read(tmp_path / "lc.fits", format="kepler.fits")
    corrected = corrector.corrected_lc
    np.testing.assert_allclose((series.time - corrected.time).sec, 0, atol=1e-4)
    np.testing.assert_allclose(series["flux"].value, corrected.flux.value, rtol=1e-6)


def test_path_gives_what_the_object_gives(tpf_file):
    tpf = lightkurve.read(tpf_file)
    expected = PLDCorrector(tpf).correct(order=1)
    tpf.hdu.close()
    corrected = PLDCorrector(tpf_file).correct(order=1)
    np.testing.assert_array_equal(corrected.flux, expected.flux)
    np.testing.assert_array_equal(corrected.cadenceno, expected.cadenceno)


def test_tess_file(shared_data, tmp_path):
    source = shared_data / "tess_tpf" / "tesssip_tpf1.fits"
    corrector = detrend_file(source, tmp_path / "lc.fits", order=1)
    with fits.open(tmp_path / "lc.fits", memmap=False) as hdus:
        lc = lightkurve.read(hdus)
    assert type(lc).__name__ == "TessLightCurve"
    np.testing.assert_allclose(lc.flux.value, corrector.corrected_lc.flux.value, rtol=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
        "tess_tpf/tesssip_tpf1.fits",
    ],
)
def test_cards_that_stay_true_are_kept(shared_data, tmp_path, name):
    source = tmp_path / "tpf.fits"
    with fits.open(shared_data / name) as hdus:
        hdus[1].data = hdus[1].data[:300]
        hdus.writeto(source, checksum=True)
    detrend_file(source, tmp_path / "lc.fits", order=1)
    with fits.open(source) as before, fits.open(tmp_path / "lc.fits") as after:
        for i, keywords in enumerate(
            [
                "OBJECT INSTRUME TELESCOP MISSION CHANNEL CAMPAIGN KEPMAG TESSMAG SECTOR CCD PMRA",
                "OBJECT TIMESYS TIMEREF INT_TIME NUM_FRM TIMEDEL GAIN READNOIA TIMEPIXR DEADC",
                "CRVAL1 CRVAL2 PC1_1 CRVAL1P CRVAL2P",
            ]
        ):
            for keyword in set(keywords.split()) & set(before[i].header):
                assert after[i].header[keyword] == before[i].header[keyword], keyword
        assert after["APERTURE"].header["NPIXSAP"] == (after["APERTURE"].data & 2 > 0).sum()
        collected = before["APERTURE"].data & ~2
        np.testing.assert_array_equal(after["APERTURE"].data & ~2, collected)
        for gone in ("CDPP6_0", "CROWDSAP", "EXPOSURE", "1CRV5P", "TDIM5"):
            assert gone not in after[1].header
        time = after[1].data["TIME"]
        known = time[np.isfinite(time)]
        header = after[1].header
        half = header["TIMEDEL"] / 2
        assert header["TSTART"] == pytest.approx(known[0] - half, abs=1e-9)
        assert header["TSTOP"] == pytest.approx(known[-1] + half, abs=1e-9)
        after.verify("exception")
        assert all({"CHECKSUM", "DATASUM"} <= set(hdu.header) for hdu in after)


def test_input_is_never_replaced(tpf_file, tmp_path):
    before = tpf_file.read_bytes()
    link = tmp_path / "link.fits"
    link.symlink_to(tpf_file)
    for options in ({"output": tpf_file}, {"output": link}):
        with pytest.raises(ValueError, match=r"it is the input .*star\.fits"):
            detrend_file(tpf_file, overwrite=True, order=1, **options)
    for figure in (link, tmp_path / "lc.fits"):
        with pytest.raises(ValueError, match="it is the input"):
            detrend_file(tpf_file, tmp_path / "lc.fits", figure=figure, overwrite=True, order=1)
    assert tpf_file.read_bytes() == before


def test_figure_is_checked_before_any_work(tpf_file, tmp_path):
    for name in ("lc.xyz", "figure"):
        with pytest.raises(ValueError, match=rf"cannot write .*{name}: the formats of figures are"):
            detrend_file(tpf_file, tmp_path / "lc.fits", figure=tmp_path / name)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        detrend_file(tpf_file, tmp_path / "lc.fits", figure=tmp_path / "absent" / "lc.png")
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_kept(tpf_file, tmp_path):
    output = tmp_path / "lc.fits"
    output.write_text("mine")
    with pytest.raises(FileExistsError, match="exists already"):
        detrend_file(tpf_file, output, order=1)
    assert output.read_text() == "mine"
    detrend_file(tpf_file, output, order=1, overwrite=True)
    assert output.read_bytes().startswith(b"SIMPLE")


def test_files_that_are_none(tmp_path):
    with pytest.raises(FileNotFoundError, match="absent"):
        detrend_file(tmp_path / "absent.fits", tmp_path / "lc.fits")
    text = tmp_path / "text.fits"
    text.write_text("no FITS at all")
    with pytest.raises((OSError, ValueError), match="text"):
        detrend_file(text, tmp_path / "lc.fits")
    image = tmp_path / "image.fits"
    fits.PrimaryHDU(np.zeros((3, 3))).writeto(image)
    with pytest.raises(ValueError, match="not a target pixel file"):
        detrend_file(image, tmp_path / "lc.fits")
    assert {path.name for path in tmp_path.iterdir()} == {"text.fits", "image.fits"}


def test_what_the_correction_refuses_names_the_file(tpf_file, tmp_path):
    with fits.open(tpf_file) as hdus:
        hdus[1].data["FLUX"][...] = 0
        hdus.writeto(tmp_path / "dark.fits", checksum=True)
    with pytest.raises(ValueError, match=r"dark\.fits: no pixel of `tpf` is above its noise"):
        detrend_file(tmp_path / "dark.fits", tmp_path / "lc.fits")


def test_command(tpf_file, tmp_path, capsys):
    output = tmp_path / "lc.fits"
    arguments = ["detrend", str(tpf_file), "--order", "2", "--output", str(output)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    lc = lightkurve.read(output)
    shown = re.search(r"-> ([\d.]+) ppm \(6\.5 h, as lightkurve's", printed)[1]
    assert float(shown) == pytest.approx(lc.estimate_cdpp().value, abs=0.1)  # of 32-bit fluxes
    assert "survives" not in printed
    assert "PLDSURV" not in lc.meta
    assert (tmp_path / "lc.png").exists()
    assert main(arguments) == 2
    assert "exists already" in capsys.readouterr().err
    arguments += ["--overwrite", "--trend", "quadratic", "--remove-trend", "--survival"]
    assert main(arguments) == 0
    survival = lightkurve.read(output).meta["PLDSURV"]
    assert f"; {survival:.3f} +- " in capsys.readouterr().out


def test_command_with_bad_input(tpf_file, tmp_path, capsys):
    output = ["--output", str(tmp_path / "lc.fits")]
    assert main(["detrend", str(tmp_path / "absent.fits"), *output]) == 2
    assert "absent.fits" in capsys.readouterr().err
    assert main(["detrend", str(tpf_file), "--order", "0", *output]) == 2
    error = capsys.readouterr().err
    assert "`order` must be at least 1, got 0" in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
