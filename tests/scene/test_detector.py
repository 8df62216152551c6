"""The detector: numbers of the presets, checks, and what follows from the fields."""

import dataclasses
import pickle

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.modeling.models import Const1D, Gaussian2D
from photutils.psf import GaussianPSF, MoffatPSF
from scipy.stats import kstest, norm, uniform

from scope_models import Detector, Motion, Star, read_detector, simulate
from scope_models.effects import Gaps
from scope_models.missions import Cadence
from scope_models.models import PRF, BivariateGaussianPSF, SensitivityPolynomial
from scope_models.scene import presets, register_preset

CUSTOM = {"shape": (5, 7), "zero_point": 1e5, "zero_point_mag": 10.0, "int_time": 2.0}
PRESETS = {"kepler": Detector.kepler, "k2": Detector.k2, "tess": Detector.tess}


def test_psf_of_tess_puts_the_light_where_a_real_star_has_it(shared_data):
    with fits.open(shared_data / "tess_tpf/tesssip_tpf1.fits") as hdus:
        fraction, aperture = hdus[1].header["FLFRCSAP"], (hdus[2].data & 2) > 0
    # the star's position in the mean image
    image = PRF(Detector.tess().psf).render(aperture.shape, x_0=5.4, y_0=4.87)
    assert image[aperture].sum() == pytest.approx(fraction, abs=0.02)


@pytest.mark.parametrize(
    "detector, name",
    [
        (Detector.kepler(), "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz"),
        (Detector.k2(), "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz"),
        (Detector.tess(), "tess_tpf/tesssip_tpf1.fits"),
    ],
    ids=["kepler", "k2", "tess"],
)
def test_presets_agree_with_archive_files(shared_data, detector, name):
    with fits.open(shared_data / name) as hdus:
        header = hdus[1].header
        background = np.nanmedian(hdus[1].data["FLUX_BKG"])
    assert detector.int_time == pytest.approx(header["INT_TIME"], rel=1e-12)
    assert detector.read_time == pytest.approx(header["READTIME"], rel=1e-12)
    assert detector.frame_time == pytest.approx(header["FRAMETIM"], rel=1e-9)
    assert detector.n_frames == header["NUM_FRM"]
    assert detector.n_reads == header["NREADOUT"]
    assert detector.cadence_days == pytest.approx(header["TIMEDEL"], rel=1e-8)
    # Kepler's EXPOSURE is the time of the series; DEADC is live time over time.
    live = detector.exposure_time / (detector.cadence_days * 86400)
    assert live == pytest.approx(header["DEADC"], rel=1e-8)
    gain = header["GAIN"] if "GAIN" in header else header["GAINA"]
    assert detector.gain == pytest.approx(gain, rel=0.05)
    read_noise = header["READNOIS"] if "READNOIS" in header else header["READNOIA"]
    assert detector.read_noise == pytest.approx(read_noise, rel=0.25)
    black = header["MEANBLCK"] if "MEANBLCK" in header else header["MEANBLCA"]
    assert detector.mean_black == pytest.approx(black, rel=0.05)
    offset = header["LCFXDOFF"] if "LCFXDOFF" in header else header["FXDOFF"]
    assert detector.fixed_offset == offset
    assert detector.background == pytest.approx(background, rel=0.1)


@pytest.mark.parametrize(
    "name, file",
    [
        ("kepler", "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz"),
        ("k2", "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz"),
        ("tess", "tess_tpf/tesssip_tpf1.fits"),
    ],
)
def test_detector_of_an_archive_file(shared_data, name, file):
    with fits.open(shared_data / file) as hdus:
        header, flux, background = hdus[1].header, hdus[1].data["FLUX"], hdus[1].data["FLUX_BKG"]
    detector = Detector.from_tpf(shared_data / file)
    assert detector.shape == flux.shape[1:]
    assert detector.background == pytest.approx(np.nanmedian(background), rel=5e-3)
    assert detector.gain == header.get("GAIN", header.get("GAINA"))
    assert detector.read_noise == header.get("READNOIS", header.get("READNOIA"))
    assert detector.mean_black == header.get("MEANBLCK", header.get("MEANBLCA"))
    assert detector.fixed_offset == header.get("LCFXDOFF", header.get("FXDOFF"))
    assert detector.n_reads == header["NREADOUT"]
    assert detector.psf(0.3, 0.1) == Detector.preset(name).psf(0.3, 0.1)
    assert Detector.from_tpf(shared_data / file, gain=5.0).gain == 5.0


def test_detector_of_a_simulated_file_is_the_detector(tmp_path):
    even = {"interpixel_scatter": 0.0}
    detector = Detector.tess("20 s", shape=(7, 5), gain=5.5, background=100.0, **even)
    observation = simulate(Star(10.0), detector, Motion.still(3, time_format="btjd"), seed=1)
    path = observation.write(tmp_path / "star.fits")
    assert Detector.from_tpf(path, **even) == detector
    assert Detector.from_tpf(observation.to_tpf(), **even) == detector
    with fits.open(path, mode="update") as hdus:
        for hdu in hdus[:2]:
            hdu.header["TELESCOP"] = "other"
    with pytest.raises(ValueError, match="must have MISSION or TELESCOP in its header"):
        Detector.from_tpf(path)
    assert Detector.from_tpf(path, mission="TESS").gain == 5.5


def test_presets_by_name():
    assert Detector.preset("k2") == Detector.preset("K2") == Detector.k2()
    assert Detector.preset("kepler", "short") == Detector.kepler("short")
    assert Detector.tess() == Detector.tess("120 s") == Detector.tess(2 * u.min)
    assert Detector.preset("k2_calibrated", gain=3.0) == Detector.k2_calibrated(gain=3.0)
    with pytest.raises(ValueError, match=r"`name` must be one of kepler, k2, .*got 'roman'"):
        Detector.preset("roman")


def test_a_new_preset_is_one_call(tmp_path, monkeypatch):
    monkeypatch.setitem(presets._REGISTERED, "wide", None)  # taken out at the end
    fields = {"shape": (9, 9), "zero_point": 2e4, "zero_point_mag": 10.0, "int_time": 4.0}
    fast, slow = Cadence("fast", 5), Cadence("slow", 150, live_fraction=0.8)
    register_preset("wide", mission="wide", cadences=[fast, slow], **fields)
    assert Detector.preset("wide").n_frames == 5
    assert Detector.preset("wide", 10 * u.min, gain=2.0).exposure_time == pytest.approx(480)
    path = tmp_path / "wide.toml"
    path.write_text('preset = "wide"\ncadence = "slow"\n', encoding="utf-8")
    assert read_detector(path) == Detector.preset("wide", "slow")
    with pytest.raises(ValueError, match=r"`cadence` must be one of 'fast' .* got 'short'"):
        Detector.preset("wide", "short")
    with pytest.raises(ValueError, match="`name` must not be one of kepler, k2"):
        register_preset("k2", mission="K2")
    with pytest.raises(ValueError, match="`name` must be text in lower case, got 'Wide'"):
        register_preset("Wide", **fields)


def test_detectors_are_values():
    detector = Detector.k2()
    assert detector == Detector.k2()
    assert hash(detector) == hash(Detector.k2())
    assert detector != Detector.kepler()
    assert detector != detector.replace(sensitivity=SensitivityPolynomial((1, 0, -0.06)))
    assert detector != detector.replace(psf=BivariateGaussianPSF(sigma_x=0.51))
    given = detector.replace(interpixel=np.ones((11, 11)))
    assert given == detector.replace(interpixel=np.ones((11, 11)))
    assert given != detector
    assert detector != "K2"
    assert pickle.loads(pickle.dumps(detector)) == detector  # noqa: S301


def test_fields_with_units():
    detector = Detector(
        shape=(5, 7), zero_point=1e5 / u.s * u.electron, zero_point_mag=10 * u.mag,
        int_time=2000 * u.ms, read_time=0.1 * u.s, pixel_scale=4 * u.arcsec / u.pix,
        gain=110 * u.electron / u.ct, read_noise=100 * u.electron, well_depth=1e6 * u.electron,
        background=60 * u.electron / u.min / u.pix,
    )  # fmt: skip
    assert detector == Detector(
        **CUSTOM, read_time=0.1, pixel_scale=4.0, gain=110.0, read_noise=100.0, well_depth=1e6,
        background=1.0,
    )  # fmt: skip
    assert Detector.k2().flux_from_mag([12, 14.5] * u.mag)[1] == pytest.approx(1.74e4)
    with pytest.raises(ValueError, match=r"`read_noise` must be in electron, .* got s"):
        Detector.k2(read_noise=3 * u.s)


def test_full_flux_leaves_the_background_out():
    detector = Detector.k2(background=100.0)
    assert detector.full_flux == pytest.approx(0.877 * 1.08e6 / 6.0198029 - 100.0)
    assert detector.replace(well_depth=None).full_flux == np.inf


def test_short_cadence():
    long, short = Detector.kepler(), Detector.kepler(cadence="short")
    assert (long.n_frames, short.n_frames) == (270, 9)
    assert long.exposure_time == pytest.approx(1625.347, abs=1e-3)
    assert short.exposure_time == pytest.approx(long.exposure_time / 30, rel=1e-12)
    assert short.cadence_days * 86400 == pytest.approx(58.8488, abs=1e-4)
    assert (long.fixed_offset, short.fixed_offset) == (419400, 219400)


@pytest.mark.parametrize(
    "cadence, n_reads, exposure",
    [(20, 10, 19.8), (120, 48, 95.04), (200, 80, 158.4), (600, 240, 475.2), (1800, 720, 1425.6)],
)
def test_tess_cadences(cadence, n_reads, exposure):
    detector = Detector.tess(cadence=cadence)
    assert detector.cadence_days * 86400 == pytest.approx(cadence, rel=1e-12)
    assert detector.n_reads == n_reads
    assert detector.exposure_time == pytest.approx(exposure, rel=1e-12)


@pytest.mark.parametrize(
    "preset, options, message",
    [
        ("kepler", {"cadence": "medium"}, r"`cadence` must be one of 'long' .*got 'medium'"),
        ("tess", {"cadence": 30}, r"`cadence` must be one of '120 s' .*, '1800 s' .*got 30"),
    ],
)
def test_unknown_cadences(preset, options, message):
    with pytest.raises(ValueError, match=message):
        PRESETS[preset](**options)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_field_can_be_overridden(preset):
    changes = {
        "shape": (4, 6),
        "zero_point": 1e4,
        "zero_point_mag": 9.0,
        "int_time": 1.0,
        "mission": "other",
        "pixel_scale": 2.0,
        "read_time": 0.5,
        "n_frames": 10,
        "live_fraction": 0.5,
        "gain": 3.0,
        "read_noise": 4.0,
        "background": 5.0,
        "well_depth": None,
        "fixed_offset": 7,
        "mean_black": 8,
        "sensitivity": None,
        "interpixel": np.full((4, 6), 0.9),
        "interpixel_scatter": 0.0,
        "interpixel_distribution": "normal",
        "psf": None,
        "effects": (Gaps([(0.0, 1.0)]),),
    }
    assert set(changes) == {item.name for item in dataclasses.fields(Detector)}
    detector = PRESETS[preset](**changes)
    replaced = PRESETS[preset]().replace(**changes)
    for name, value in changes.items():
        assert np.array_equal(getattr(detector, name), value)
        assert np.array_equal(getattr(replaced, name), value)


def test_misspelt_fields_are_errors():
    for make in (Detector.k2, Detector.tess, Detector.k2().replace):
        with pytest.raises(TypeError, match="readnoise"):
            make(readnoise=3.0)


@pytest.mark.parametrize(
    "changes, error, message",
    [
        ({"shape": 5}, TypeError, r"`shape` must be two integers \(ny, nx\), got 5"),
        ({"shape": (5, 0)}, ValueError, "`shape` must be at least 1, got 0"),
        ({"shape": (5.0, 5)}, TypeError, "`shape` must be an integer, got 5.0"),
        ({"zero_point": 0.0}, ValueError, "`zero_point` must be positive, got 0.0"),
        ({"zero_point": "best"}, ValueError, "`zero_point` must be a number or one of"),
        ({"zero_point_mag": np.nan}, ValueError, "`zero_point_mag` must be finite, got nan"),
        ({"int_time": -1.0}, ValueError, "`int_time` must be positive, got -1.0"),
        ({"mission": 3}, TypeError, "`mission` must be a string, got 3"),
        ({"pixel_scale": 0}, ValueError, "`pixel_scale` must be positive, got 0.0"),
        ({"read_time": -0.1}, ValueError, "`read_time` must not be negative, got -0.1"),
        ({"n_frames": 0}, ValueError, "`n_frames` must be at least 1, got 0"),
        ({"n_frames": 2.0}, TypeError, "`n_frames` must be an integer, got 2.0"),
        ({"live_fraction": 1.1}, ValueError, "`live_fraction` must not be above 1, got 1.1"),
        ({"gain": np.inf}, ValueError, "`gain` must be finite, got inf"),
        ({"read_noise": "5"}, TypeError, "`read_noise` must be a number, got '5'"),
        ({"background": -1}, ValueError, "`background` must not be negative, got -1.0"),
        ({"well_depth": 0.0}, ValueError, "`well_depth` must be positive, got 0.0"),
        (
            {"well_depth": 10.0, "background": 6.0},
            ValueError,
            "`well_depth` must exceed the background of a frame, 12 e-, got 10",
        ),
        ({"fixed_offset": -1}, ValueError, "`fixed_offset` must be at least 0, got -1"),
        ({"sensitivity": 1.0}, TypeError, "`sensitivity` must be a two-dimensional astropy model"),
        ({"psf": Const1D()}, TypeError, "`psf` must be a two-dimensional astropy model"),
        ({"psf": Gaussian2D()}, ValueError, "a component needs flux, x_0 and y_0"),
        ({"sensitivity": Gaussian2D()}, ValueError, "must be one density times sensitivities"),
        ({"interpixel": np.ones((7, 5))}, ValueError, r"shape \(5, 7\), got \(7, 5\)"),
        ({"interpixel": np.full((5, 7), np.nan)}, ValueError, "`interpixel` must be finite and"),
        ({"interpixel": np.full((5, 7), -0.1)}, ValueError, "`interpixel` must be finite and"),
        ({"interpixel_scatter": 2.0}, ValueError, "`interpixel_scatter` must not be above 1"),
        (
            {"interpixel_distribution": "flat"},
            ValueError,
            "`interpixel_distribution` must be one of uniform, normal, got 'flat'",
        ),
    ],
)
def test_bad_fields(changes, error, message):
    with pytest.raises(error, match=message):
        Detector(**(CUSTOM | changes))


def test_flux_from_mag():
    detector = Detector.k2()
    assert detector.flux_from_mag(12.0) == pytest.approx(1.74e5)
    np.testing.assert_allclose(detector.flux_from_mag([9.5, 14.5]), [1.74e6, 1.74e4])
    assert Detector.k2(zero_point="focal plane").flux_from_mag(12) == pytest.approx(2.141e5)
    # T = 10 gives 1.5e4 e-/s.
    assert Detector.tess().flux_from_mag(10.0) == pytest.approx(1.5e4, rel=1e-3)
    with pytest.raises(ValueError, match="`mag` must be finite, got nan"):
        detector.flux_from_mag(np.nan)
    with pytest.raises(ValueError, match=r"`mag` is too small: .* e-/s at -500"):
        detector.flux_from_mag(-500)


def test_presets_have_the_sensitivity_of_the_paper():
    for detector in (Detector.kepler(), Detector.k2(), Detector.tess()):
        assert detector.sensitivity.x_coefficients == (1, 0, -0.05)
        assert detector.sensitivity.y_coefficients == (1, 0, -0.05)
        assert detector.interpixel_scatter == 0.01


def test_interpixel_map_is_drawn_from_the_seed():
    detector = Detector.k2(shape=(60, 50))
    response = detector.interpixel_map(3)
    assert np.array_equal(response, detector.interpixel_map(3))
    assert not np.array_equal(response, detector.interpixel_map(4))
    assert kstest(response.ravel(), uniform(0.99, 0.02).cdf).pvalue > 1e-3
    normal = detector.replace(interpixel_distribution="normal").interpixel_map(3)
    assert kstest(normal.ravel(), norm(1, 0.01).cdf).pvalue > 1e-3


def test_given_interpixel_map():
    response = np.linspace(0.5, 1.5, 35).reshape(5, 7)
    detector = Detector(**CUSTOM, interpixel=response)
    assert np.array_equal(detector.interpixel_map(1), response)
    response[0, 0] = 0.0
    assert detector.interpixel[0, 0] == 0.5
    with pytest.raises(ValueError, match="read-only"):
        detector.interpixel[0, 0] = 0.0


def test_without_sensitivity():
    detector = Detector.k2(interpixel=np.full((11, 11), 0.9)).without_sensitivity()
    assert detector.sensitivity is None
    assert np.array_equal(detector.interpixel_map(1), np.ones((11, 11)))


def test_frozen_and_independent_of_its_arguments():
    psf = BivariateGaussianPSF(sigma_x=0.5)
    sensitivity = SensitivityPolynomial()
    detector = Detector(**CUSTOM, psf=psf, sensitivity=sensitivity)
    psf.sigma_x = 2.0
    sensitivity.ax2 = 0.0
    assert detector.psf.sigma_x == 0.5
    assert detector.sensitivity.ax2 == -0.05
    with pytest.raises(dataclasses.FrozenInstanceError):
        detector.gain = 2.0


def test_other_models_are_allowed():
    psf = MoffatPSF(alpha=1.0) + GaussianPSF(x_fwhm=2.0)
    response = SensitivityPolynomial() * SensitivityPolynomial((1, 0.1), (1,))
    detector = Detector(**CUSTOM, psf=psf, sensitivity=response)
    assert detector.psf.n_submodels == detector.sensitivity.n_submodels == 2


def test_repr_names_what_matters():
    text = repr(Detector.tess())
    for part in ("TESS", "11 x 11 px", "21 arcsec", "60 frames", "read noise 10 e-"):
        assert part in text


def test_a_file_of_a_telescope_on_the_ground(tmp_path):
    detector = Detector.ground(2.0, altitude=2635.0, airmass=1.3)
    assert read_detector(detector.write(tmp_path / "ground.fits")) == detector
    path = tmp_path / "own.toml"
    path.write_text('preset = "k2"\n[[effects]]\neffect = "Unheard"\n', encoding="utf-8")
    with pytest.raises(ValueError, match="'Unheard' is not the name of an effect"):
        read_detector(path)
