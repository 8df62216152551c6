"""Observations as target pixel files and light curves, read by lightkurve."""

import pickle

import numpy as np
import pytest
from astropy.io import fits
from lightkurve import (
    KeplerLightCurve,
    KeplerTargetPixelFile,
    TessLightCurve,
    TessTargetPixelFile,
)
from matplotlib import pyplot as plt

from scope_models import Detector, Motion, Star, simulate
from scope_models.exceptions import LostLightWarning
from scope_models.io import Truth, read_truth
from scope_models.models import BivariateGaussianPSF

DETECTORS = {"kepler": Detector.kepler(), "k2": Detector.k2(), "tess": Detector.tess()}


@pytest.fixture(scope="module")
def observation():
    stars = [Star(12.0), Star(14.0, 8.5, 2.0)]
    return simulate(stars, Detector.k2(), Motion.k2_roll(60), seed=3)


@pytest.mark.parametrize("name", DETECTORS)
def test_to_tpf_and_light_curve(name):
    detector = DETECTORS[name]
    time_format = "btjd" if name == "tess" else "bkjd"
    motion = Motion.still(30, start=2000.0, cadence=detector.cadence_days, time_format=time_format)
    observation = simulate(Star(11.0), detector, motion, seed=1)
    tpf = observation.to_tpf(metadata={"target_id": 1234})
    assert isinstance(tpf, TessTargetPixelFile if name == "tess" else KeplerTargetPixelFile)
    assert tpf.time.format == time_format
    np.testing.assert_allclose(tpf.time.value, motion.time, rtol=0, atol=1e-9)
    assert np.array_equal(tpf.flux.value, observation.flux)
    assert np.array_equal(tpf.flux_err.value, observation.flux_err)
    assert np.array_equal(tpf.flux_bkg.value, observation.flux_bkg)
    assert tpf.targetid == 1234
    assert np.array_equal(tpf.pipeline_mask, observation.aperture)
    light_curve = observation.to_lightcurve()
    assert isinstance(light_curve, TessLightCurve if name == "tess" else KeplerLightCurve)
    expected = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
    np.testing.assert_allclose(light_curve.flux.value, expected, rtol=1e-6)
    variance = (observation.flux_err[:, observation.aperture].astype(float) ** 2).sum(axis=1)
    np.testing.assert_allclose(light_curve.flux_err.value, np.sqrt(variance), rtol=1e-6)
    mask = np.zeros(detector.shape, dtype=bool)
    mask[5, 4:6] = True
    pair = observation.to_lightcurve(mask).flux.value
    np.testing.assert_allclose(pair, observation.flux[:, 5, 4:6].sum(axis=1), rtol=1e-6)


def test_times_are_those_of_the_mission():
    motion = Motion.still(5, start=2500.0)
    observation = simulate(Star(11.0), Detector.tess(), motion, seed=1)
    # BKJD is BJD - 2454833, BTJD is BJD - 2457000.
    expected = motion.time + 2454833 - 2457000
    np.testing.assert_allclose(observation.to_tpf().time.value, expected, rtol=0, atol=1e-9)
    assert np.array_equal(observation.time, motion.time)


@pytest.mark.parametrize(
    "detector, motion, message",
    [
        (Detector.tess(), Motion.still(50), r"begins at -22\.9 d \(BTJD\) with a cadence every 29"),
        (Detector.k2(), Motion.still(9, cadence=2 / 1440), "has one every 29.42 min"),
    ],
)
def test_times_that_the_detector_cannot_have(detector, motion, message, tmp_path):
    observation = simulate(Star(12.0), detector, motion, seed=1)
    with pytest.raises(ValueError, match=message) as error:
        observation.write(tmp_path / "star.fits")
    advice = str(error.value).split("those of ")[1].replace("(n,", "(5,")
    right = eval(advice, {"Motion": Motion})  # noqa: S307 - our own text
    tpf = simulate(Star(12.0), detector, right, seed=1).to_tpf(quality_bitmask="none")
    np.testing.assert_allclose(np.diff(tpf.time.value), detector.cadence_days, rtol=1e-5)
    assert tpf.time.value[0] > 100


def test_quality_and_cadence_numbers_are_those_of_the_motion():
    motion = Motion(
        time=np.arange(4.0),
        x=np.zeros(4),
        y=np.zeros(4),
        quality=[0, 1048576, 0, 1],
        cadenceno=[10, 11, 13, 14],
    )
    observation = simulate(Star(12.0), Detector.k2(), motion, seed=1)
    tpf = observation.to_tpf(quality_bitmask="none")
    assert tpf.quality.tolist() == [0, 1048576, 0, 1]
    assert tpf.cadenceno.tolist() == [10, 11, 13, 14]
    assert observation.to_tpf().cadenceno.tolist() == [10, 13]


def test_aperture_holds_the_target(observation):
    assert observation.aperture[5, 5]
    assert not observation.aperture[2, 8]
    assert 5 <= observation.aperture.sum() <= 30
    with pytest.warns(LostLightWarning):
        dark = simulate(Star(12.0, -50.0, 5.0), Detector.k2(), Motion.still(3), seed=1)
    assert dark.aperture.all()
    assert dark.to_tpf().flux.shape == (3, 11, 11)


def test_aperture_cards(observation, tmp_path):
    path = observation.write(tmp_path / "star.fits")
    with fits.open(path) as hdus:
        header = hdus[1].header
        aperture = (hdus["APERTURE"].data & 2) > 0
    scene = {"detector": observation.detector, "motion": observation.motion, "seed": 3}
    target = simulate(observation.stars[0], noise=False, **scene).model()
    every = observation.model()
    crowding = target[:, aperture].sum() / every[:, aperture].sum()
    assert header["CROWDSAP"] == pytest.approx(crowding, abs=1e-12)
    fraction = target[:, aperture].sum(axis=1).mean() / 1.74e5
    assert header["FLFRCSAP"] == pytest.approx(fraction, abs=1e-12)


def test_aperture_cards_are_of_all_cadences_and_stay_with_extra_cards():
    dims = np.where(np.arange(400) % 7 == 3, 0.2, 1.0)  # no regular choice of cadences sees this
    stars = [Star(12.0, signal=dims), Star(13.0, 6.5, 5.0)]
    observation = simulate(stars, Detector.k2(), Motion.k2_roll(400), seed=3)
    tpf = observation.to_tpf(metadata={"extra_cards": {"TEFF": 5000}}, quality_bitmask="none")
    cubes = [simulate(s, Detector.k2(), observation.motion, seed=3).model() for s in stars]
    own, other = (cube[:, observation.aperture].sum() for cube in cubes)
    header = tpf.hdu[1].header
    assert header["CROWDSAP"] == pytest.approx(own / (own + other), abs=1e-12)
    assert header["FLFRCSAP"] == pytest.approx(own / (1.74e5 * dims.sum()), abs=1e-12)
    assert tpf.hdu[0].header["TEFF"] == 5000


@pytest.mark.parametrize(
    "mask, message",
    [
        (np.zeros((11, 11), dtype=bool), "`aperture_mask` has no pixels"),
        (np.ones((3, 3), dtype=bool), r"boolean mask of shape \(11, 11\), got bool \(3, 3\)"),
        (np.full((11, 11), 0.5), r"boolean mask of shape \(11, 11\), got float64"),
    ],
)
def test_bad_apertures(observation, mask, message, tmp_path):
    calls = (
        observation.to_lightcurve,
        observation.target_share,
        lambda mask: observation.to_tpf(aperture_mask=mask),
        lambda mask: observation.write(tmp_path / "star.fits", aperture_mask=mask),
    )
    for call in calls:
        with pytest.raises(ValueError, match=message):
            call(mask)
    assert not list(tmp_path.iterdir())


def test_apertures_by_name_and_of_integers(observation):
    ours = observation.to_lightcurve(observation.aperture.astype(int))
    assert np.array_equal(ours.flux, observation.to_lightcurve("pipeline").flux)
    with pytest.raises(ValueError, match="`aperture_mask` must be one of pipeline, threshold, def"):
        observation.to_lightcurve("thresh")


def test_write_and_read(observation, tmp_path):
    path = observation.write(tmp_path / "star.fits", metadata={"object_name": "a star"})
    assert path == tmp_path / "star.fits"
    with fits.open(path, memmap=False) as hdus:
        hdus.verify("exception")
        tpf = KeplerTargetPixelFile(hdus, quality_bitmask="none")
        assert np.array_equal(tpf.flux.value, observation.flux)
        assert tpf.get_header()["OBJECT"] == "a star"
        assert np.array_equal(hdus[1].data["RAW_CNTS"], observation.raw_cnts)
        header = hdus[1].header
        # The counts belong to the flux, by the facts in the header.
        exposure = header["INT_TIME"] * header["NUM_FRM"]
        electrons = (hdus[1].data["RAW_CNTS"] - header["LCFXDOFF"]) * header["GAIN"]
        flux = electrons / exposure - hdus[1].data["FLUX_BKG"]
        np.testing.assert_allclose(flux, observation.flux, atol=0.6 * header["GAIN"] / exposure)
    truth = read_truth(path)
    assert np.array_equal(truth.table["X1"], observation.truth.x[0])
    assert np.array_equal(truth.table["Y2"], observation.truth.y[1])
    assert np.array_equal(truth.maps["INTERPIXEL"], observation.truth.interpixel)


def test_no_offset_and_no_background(tmp_path):
    """A converter gives no negative counts, and -1 stands for no data."""
    detector = Detector.k2(background=0.0, fixed_offset=0, shape=(7, 7))
    dark = simulate(Star(16.0), detector, Motion.k2_roll(20), seed=1)
    assert dark.flux.min() < 0
    assert dark.raw_cnts.min() == 0
    raw = fits.getdata(dark.write(tmp_path / "star.fits"))["RAW_CNTS"]
    assert np.array_equal(raw, dark.raw_cnts)


def test_the_file_gives_back_the_truth(observation, tmp_path):
    truth = read_truth(observation.write(tmp_path / "star.fits"))
    assert type(truth) is type(observation.truth)
    assert truth == observation.truth
    for name in ("x", "y", "relative_flux", "target_share", "flux", "lost_fraction", "interpixel"):
        assert np.array_equal(getattr(truth, name), getattr(observation.truth, name)), name
    assert (truth.seed, truth.noise, truth.n_sub) == (3, {"photon", "background", "read"}, 1)
    assert truth != read_truth(simulate(observation.scene, seed=4).to_tpf())
    assert truth != "truth"
    assert pickle.loads(pickle.dumps(truth)) == truth  # noqa: S301
    with pytest.raises(ValueError, match="the truth has no column X1"):
        _ = Truth({"CADENCENO": [1]}).x


def test_existing_and_unwritable_files(observation, tmp_path):
    path = tmp_path / "star.fits"
    path.write_bytes(b"something else")
    with pytest.raises(OSError, match=r"star\.fits"):
        observation.write(path)
    assert path.read_bytes() == b"something else"
    observation.write(path, overwrite=True)
    with fits.open(path) as hdus:
        assert len(hdus[1].data) == 60
    with pytest.raises(OSError, match="no folder"):
        observation.write(tmp_path / "absent" / "star.fits")


def test_missions_without_target_pixel_files(tmp_path):
    detector = Detector.k2(mission="Other")
    observation = simulate(Star(12.0), detector, Motion.still(3), seed=1)
    with pytest.raises(ValueError, match=r"`mission` must be Kepler, K2 or TESS .* got 'Other'"):
        observation.write(tmp_path / "star.fits")
    assert not list(tmp_path.iterdir())


def test_misspelt_metadata(observation):
    with pytest.raises(TypeError, match="targetid"):
        observation.to_tpf(metadata={"targetid": 3})


def test_repr_and_read_only(observation):
    text = "<Observation K2: 60 cadences of 11 x 11 pixels, 2 stars, seed 3>"
    assert repr(observation) == text
    with pytest.raises(ValueError, match="read-only"):
        observation.flux[0, 0, 0] = 1.0


def test_a_constant_background_is_one_image(observation):
    assert observation.flux_bkg.shape == observation.flux.shape
    assert observation.flux_bkg.strides[0] == 0


def test_centroids_follow_the_motion_of_a_real_file(shared_data, tmp_path):
    motion = Motion.from_file(shared_data / "poscorr" / "ktwo211117077-c04_llc.fits")
    psf = BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.6)
    observation = simulate(Star(12.0, psf=psf), Detector.k2(), motion, seed=1)
    with fits.open(observation.write(tmp_path / "star.fits"), memmap=False) as hdus:
        tpf = KeplerTargetPixelFile(hdus)
        column, row = (q.value for q in tpf.estimate_centroids(aperture_mask="all"))
        assert np.corrcoef(column, tpf.pos_corr1)[0, 1] > 0.99
        assert np.corrcoef(row, tpf.pos_corr2)[0, 1] > 0.99
        truth = read_truth(tpf).at_cadences(tpf.cadenceno)
    assert np.std(column - tpf.column - truth["X1"]) < 0.02
    assert np.mean(column - tpf.column - truth["X1"]) == pytest.approx(0, abs=0.02)
    assert np.mean(row - tpf.row - truth["Y1"]) == pytest.approx(0, abs=0.02)


def test_plot_shows_the_corrected_curve_at_its_cadences(observation):
    curve = observation.to_lightcurve()[10:50:2]
    axes = observation.plot(curve, title="a star")
    _, corrected = axes["light curve"].get_lines()
    drawn = corrected.get_ydata()
    kept = np.isin(observation.cadenceno, curve.cadenceno)
    assert np.array_equal(np.isfinite(drawn), kept)
    np.testing.assert_allclose(drawn[kept], curve.flux.value / np.median(curve.flux.value))
    raw = axes["light curve"].get_lines()[0].get_ydata()
    summed = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
    np.testing.assert_allclose(raw, summed / np.median(summed))
    with pytest.raises(ValueError, match="one value for each of the 60 cadences"):
        observation.plot(np.ones(5))
    curve["cadenceno"] = curve.cadenceno + 1000
    with pytest.raises(ValueError, match="does not have"):
        observation.plot(curve)


def test_animation_has_the_chosen_cadences(observation):
    animation = observation.animate(step=20)
    assert list(animation.new_frame_seq()) == [0, 1, 2]
    html = animation.to_jshtml()
    assert html.count("data:image/png") == 3
    with pytest.raises(ValueError, match="`step` must be at least 1"):
        observation.animate(step=0)


def test_html_and_figure(observation):
    html = observation._repr_html_()
    assert html.startswith("<p>&lt;Observation K2: 60 cadences of 11 x 11 pixels, 2 stars")
    assert "<th>noise</th><td>background, photon, read</td>" in html
    assert f"<td>{observation.aperture.sum()}</td>" in html
    axes = observation.plot()
    raw = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
    drawn = axes["light curve"].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, raw / np.median(raw), rtol=1e-12)
    assert axes["motion"].get_title(loc="left") == "Motion"
    plt.close("all")
