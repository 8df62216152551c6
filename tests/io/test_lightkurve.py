"""lightkurve opens our target pixel files as its own and works on them."""

import warnings

import matplotlib as mpl
import numpy as np
import pytest
from astropy.io import fits

from scope_models.correctors import PLDCorrector
from scope_models.io import TPFMetadata, read_pixels, read_truth, write_tpf
from scope_models.io.tpf import make_tpf_hdulist

FRAMES = {"int_time": 6.019802903270, "read_time": 0.518948526144, "n_frames": 270}
FIELDS = {
    "Kepler": {**FRAMES, "pixel_scale": 3.98, "quarter": 5, "channel": 20},
    "K2": {**FRAMES, "pixel_scale": 3.98, "campaign": 5, "channel": 48},
    "TESS": {
        "int_time": 1.98,
        "read_time": 0.02,
        "n_frames": 60,
        "n_readouts": 48,
        "pixel_scale": 21.0,
        "sector": 15,
        "camera": 2,
        "ccd": 3,
    },
}
PERIOD, DEPTH = 2.5, 0.01


def star(mission):
    """Return a Gaussian star with transits that rolls as K2's stars do."""
    rng = np.random.default_rng(5)
    n = 700
    metadata = TPFMetadata(
        mission=mission, target_id=42, column=740, row=796, magnitude=12.0, **FIELDS[mission]
    )
    number = np.arange(n)
    days = number * 0.0204
    roll = 0.5 * ((number % 12) / 12 - 0.5) + rng.normal(0, 0.01, n)
    x = 5.0 + roll
    y = 5.0 - 0.6 * roll + 0.15 * np.sin(days / 3)
    relative = np.where((days % PERIOD) < 0.2, 1 - DEPTH, 1.0) + 0.002 * np.sin(days / 2)
    rows, columns = np.mgrid[:11, :11]
    distance2 = (columns - x[:, None, None]) ** 2 + (rows - y[:, None, None]) ** 2
    shape = np.exp(-distance2 / 1.62) / (1.62 * np.pi)
    # Pixels respond differently, so that motion makes noise for the correctors to take out.
    expected = 1.74e5 * relative[:, None, None] * shape * rng.normal(1, 0.01, (11, 11))
    error = np.sqrt((expected + 250) / 1600 + 0.8)
    quality = np.zeros(n, dtype=int)
    quality[200] = 32  # desaturation: lightkurve drops it for each mission
    time = 2000.0 + days
    time[300] = np.nan
    flux = rng.normal(expected, error)
    flux[300] = error[300] = np.nan
    return {
        "metadata": metadata,
        "time": time,
        "cadenceno": 100 + number,
        "raw_cnts": None,
        "flux": flux,
        "flux_err": error,
        "flux_bkg": 250.0,
        "flux_bkg_err": 0.1,
        "quality": quality,
        "pos_corr1": x - 5.0,
        "pos_corr2": y - 5.0,
        "aperture": np.hypot(columns - 5, rows - 5) < 3.2,
        "truth_columns": {"X": x, "Y": y, "FLUX": relative},
        "truth_maps": {"INTERPIX": rng.normal(1, 0.01, (11, 11))},
        "scene": {"mag": 12.0},
    }


@pytest.fixture(scope="module", params=list(FIELDS))
def mission(request):
    return request.param


@pytest.fixture(scope="module")
def contents(mission):
    return star(mission)


@pytest.fixture(scope="module")
def lightkurve():
    # lightkurve warns at import that its optional PRF fitter is absent.
    mpl.use("agg")
    return pytest.importorskip("lightkurve")


@pytest.fixture(scope="module")
def path(contents, tmp_path_factory):
    return write_tpf(tmp_path_factory.mktemp("tpf") / "star.fits", **contents)


@pytest.fixture
def tpf(path, lightkurve):
    pixels = lightkurve.read(path)
    yield pixels
    pixels.hdu.close()


@pytest.fixture
def light_curve(tpf):
    return tpf.to_lightcurve()


def test_file_is_recognized(tpf, path, mission, lightkurve):
    expected = "TessTargetPixelFile" if mission == "TESS" else "KeplerTargetPixelFile"
    with fits.open(path) as hdus:
        assert lightkurve.io.detect_filetype(hdus) == expected
    assert type(tpf).__name__ == expected
    assert tpf.mission == mission
    assert tpf.targetid == 42


def test_values_are_read(tpf, contents, mission):
    good = np.ones(700, dtype=bool)
    good[[200, 300]] = False
    assert np.array_equal(tpf.quality_mask, good)
    assert tpf.time.format == ("btjd" if mission == "TESS" else "bkjd")
    assert tpf.time.scale == "tdb"
    assert np.array_equal(tpf.time.value, contents["time"][good])
    assert np.array_equal(tpf.cadenceno, contents["cadenceno"][good])
    assert tpf.flux.unit == tpf.flux_err.unit == "electron / s"
    assert np.array_equal(tpf.flux.value, contents["flux"][good].astype("f4"))
    assert np.array_equal(tpf.flux_err.value, contents["flux_err"][good].astype("f4"))
    assert np.all(tpf.flux_bkg.value == 250)
    assert (tpf.column, tpf.row) == (740, 796)
    assert np.array_equal(tpf.pipeline_mask, contents["aperture"])
    assert np.array_equal(tpf.pos_corr1, contents["pos_corr1"][good].astype("f4"))


def test_header_facts(tpf, mission):
    assert tpf.get_keyword("TEFF") is None
    if mission == "TESS":
        assert (tpf.sector, tpf.camera, tpf.ccd) == (15, 2, 3)
    else:
        assert tpf.obsmode == "long cadence"
        assert (tpf.channel, tpf.module, tpf.output) in {(48, 14, 4), (20, 7, 4)}
        assert (tpf.quarter, tpf.campaign) == ((5, None) if mission == "Kepler" else (None, 5))


def test_in_memory(contents, mission, lightkurve):
    kind = lightkurve.TessTargetPixelFile if mission == "TESS" else lightkurve.KeplerTargetPixelFile
    tpf = kind(make_tpf_hdulist(**contents))
    assert tpf.shape == (698, 11, 11)
    assert len(tpf[10:20].to_lightcurve()) == 10


def test_coordinates(tpf, contents):
    ra, dec = contents["metadata"].position
    x, y = tpf.wcs.wcs_world2pix([[ra, dec]], 0)[0]
    assert (x, y) == pytest.approx((5.0, 5.0), abs=1e-6)
    all_ra, all_dec = tpf.get_coordinates()
    assert all_ra.shape == tpf.shape
    # The sky that the central pixel looks at moves with POS_CORR.
    still = np.argmin(np.hypot(tpf.pos_corr1, tpf.pos_corr2))
    offset = np.hypot(tpf.pos_corr1[still], tpf.pos_corr2[still])
    step = contents["metadata"].pixel_scale / 3600
    distance = np.hypot((all_ra - ra) * np.cos(np.radians(dec)), all_dec - dec)[still, 5, 5]
    assert distance == pytest.approx(offset * step, rel=1e-3)


def test_centroids_follow_truth(tpf):
    truth = read_truth(tpf).at_cadences(tpf.cadenceno)
    column, row = (centroid.value for centroid in tpf.estimate_centroids())
    assert np.corrcoef(column, tpf.pos_corr1)[0, 1] > 0.99
    assert np.corrcoef(row, tpf.pos_corr2)[0, 1] > 0.99
    assert np.corrcoef(column, truth["X"])[0, 1] > 0.99
    assert np.corrcoef(row, truth["Y"])[0, 1] > 0.99
    # lightkurve counts columns and rows of the detector from the first pixel of the stamp.
    assert np.median(column - truth["X"]) == pytest.approx(740, abs=0.05)
    assert np.median(row - truth["Y"]) == pytest.approx(796, abs=0.05)


def test_plots(tpf):
    from matplotlib import pyplot as plt

    for ax in (tpf.plot(), tpf.to_lightcurve().plot()):
        assert ax.get_xlabel()
        plt.close(ax.figure)


def test_threshold_mask(tpf):
    mask = tpf.create_threshold_mask()
    assert mask[5, 5]
    assert 5 < mask.sum() < 60


def test_light_curve(light_curve, contents, mission):
    assert type(light_curve).__name__ == (
        "TessLightCurve" if mission == "TESS" else "KeplerLightCurve"
    )
    expected = contents["flux"][0][contents["aperture"]].sum()
    assert light_curve.flux[0].value == pytest.approx(expected, rel=1e-6)
    error = np.sqrt((contents["flux_err"][0][contents["aperture"]] ** 2).sum())
    assert light_curve.flux_err[0].value == pytest.approx(error, rel=1e-6)
    assert light_curve.meta["LABEL"] == "SIM 42"
    assert light_curve.estimate_cdpp().value > 0


def test_slices_keep_truth(tpf):
    part = tpf[50:150]
    assert part.shape == (100, 11, 11)
    assert np.array_equal(part.cadenceno, tpf.cadenceno[50:150])
    assert (part.column, part.row) == (740, 796)
    truth = read_truth(part)
    assert len(truth.table) == 700
    assert np.array_equal(truth.at_cadences(part.cadenceno)["X"], truth.table["X"][50:150])
    assert truth.maps["INTERPIX"].shape == (11, 11)


def test_cutout(tpf):
    cut = tpf.cutout()
    assert cut.shape == (698, 5, 5)
    corner = (cut.column - 740, cut.row - 796)
    assert corner == (2, 2)
    assert np.array_equal(cut.flux.value, tpf.flux.value[:, 2:7, 2:7])
    assert len(cut.to_lightcurve(aperture_mask="all")) == 698
    assert len(PLDCorrector(cut, aperture_mask="all").original_lc) == 698
    assert read_pixels(cut).header["1CRV5P"] == 742


def test_round_trip(tpf, tmp_path, lightkurve):
    tpf.to_fits(str(tmp_path / "copy.fits"))
    with fits.open(tmp_path / "copy.fits", checksum=True) as hdus:
        hdus.verify("exception")
        assert hdus[1].verify_checksum() == 1
    copy = lightkurve.read(tmp_path / "copy.fits")
    assert np.array_equal(copy.flux.value, tpf.flux.value)
    assert copy.hdu[1].header == tpf.hdu[1].header
    assert np.array_equal(read_truth(copy).table, read_truth(tpf).table)
    copy.hdu.close()


def test_sff(light_curve, lightkurve, mission):
    with warnings.catch_warnings():
        if mission == "TESS":
            warnings.filterwarnings("ignore", message="The SFF correction method is not suitable")
        corrected = lightkurve.correctors.SFFCorrector(light_curve).correct()
    assert len(corrected) == len(light_curve)
    assert np.all(np.isfinite(corrected.flux.value))


def test_pld(tpf, light_curve, lightkurve, mission):
    corrected = lightkurve.correctors.PLDCorrector(tpf).correct()
    assert len(corrected) == len(light_curve)
    assert np.all(np.isfinite(corrected.flux.value))
    if mission == "K2":  # the defaults for the others are of a lower order
        assert corrected.estimate_cdpp() < light_curve.estimate_cdpp()
    assert isinstance(tpf.to_corrector("pld"), lightkurve.correctors.PLDCorrector)


def test_flatten_and_bls(light_curve):
    flat = light_curve.flatten()
    assert np.median(flat.flux.value) == pytest.approx(1.0, abs=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        periodogram = light_curve.flatten(301).to_periodogram(method="bls")
    assert periodogram.period_at_max_power.value > 0


def test_default_aperture_is_the_threshold_mask(contents, mission, lightkurve):
    kind = lightkurve.TessTargetPixelFile if mission == "TESS" else lightkurve.KeplerTargetPixelFile
    tpf = kind(make_tpf_hdulist(**(contents | {"aperture": None})))
    light_curve = tpf.to_lightcurve()
    expected = tpf.flux.value[:, tpf.create_threshold_mask()].sum(axis=1)
    assert light_curve.flux.value == pytest.approx(expected, rel=1e-5)
