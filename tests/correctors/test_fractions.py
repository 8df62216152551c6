"""Predicted and measured pixel fractions, the aperture, and warnings about a fit."""

from dataclasses import replace

import numpy as np
import pytest
import tess
from astropy.stats import mad_std
from lightkurve import KeplerTargetPixelFile

from scope_models import Detector, Motion, Star, TransitModel, simulate
from scope_models.benchmark import make_sky, score
from scope_models.correctors import PLDCorrector, _model
from scope_models.correctors._model import PLDModel, Settings
from scope_models.effects import Seeing
from scope_models.exceptions import DetrendingWarning
from scope_models.io import read_pixels, read_tpf
from scope_models.models import sinusoidal_signal
from scope_models.pixelmodel import _source
from scope_models.pixelmodel._pixels import aperture_pixels, background_plane, own_pixels
from scope_models.pixelmodel._source import can_predict


@pytest.fixture(scope="module")
def crowded():
    """Return an RR Lyrae star with a constant neighbor, 1 mag fainter at 3 px."""
    return make_sky("k2-1x-rr-lyrae-neighbor", seed=0, n_cadences=400)


def test_measured_fractions_erase_it_and_warn(crowded):
    corrector = PLDCorrector(crowded.to_tpf(), "all")
    crowded_too = pytest.warns(DetrendingWarning, match="of other stars")
    follows = pytest.warns(DetrendingWarning, match=r"measured fractions explain changes of \d+ %")
    with follows, crowded_too:
        lc = corrector.correct(fractions="measured")
    assert abs(score(lc, crowded).amplitude) < 0.01  # 5e-5
    true = (crowded.neighbor_light / (crowded.neighbor_light + crowded.star_light)).mean()
    assert 0.5 * true < 1 - corrector.result.crowding < 0.4
    assert "of other stars" in str(corrector.result)


def test_predicted_fractions_hold_no_noise(star):
    """Fractions from the same place agree, and the fitted noise is at most that of FLUX_ERR."""
    series = read_pixels(star.tpf)
    pixels = aperture_pixels(series, np.ones((9, 9), dtype=bool))
    cadences = np.ones(len(series), dtype=bool)
    predicted, measured = (
        PLDModel.from_pixels(pixels, Settings(fractions=f), series, cadences)
        for f in ("predicted", "measured")
    )
    rough = [
        np.diff((m.pixels.flux / m.pixels.total[:, None, None])[::12, 4, 4]).std()
        for m in (predicted, measured)
    ]
    assert rough[0] < rough[1]
    fitted = predicted.fit(cadences, ~cadences)
    assert 0.5 < fitted.noise_scale < 1.05  # 0.61: that of the best weights


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.LostLightWarning")
@pytest.mark.parametrize("seed", [6, 7])
def test_seeing_of_the_ground(seed):
    """The width is another one in each exposure, and the second star drifts by 8 px."""
    detector = Detector.ground(shape=(17, 17), effects=(Seeing(),))
    motion = Motion.ground(240, seed=seed)
    corrector = PLDCorrector(simulate(Star(14.5, 8, 8), detector, motion, seed=seed).to_tpf())
    lc = corrector.correct()
    good = ~corrector.outlier_mask
    assert corrector.model.clean is None  # 240 cadences show no images of 100 places
    assert good.sum() >= 237
    flux, error = lc.flux.value[good], lc.flux_err.value[good]
    assert np.std(flux) < 1.2 * np.median(error)


def test_a_focus_that_hardly_changes_takes_no_slow_variability():
    """Its noise resembles the star's 9 days by chance."""
    detector, motion = Detector.k2(shape=(9, 9)), 2 * Motion.k2_roll(700)
    variability = sinusoidal_signal(0.002, period=9.0)
    planet = TransitModel.from_depth_duration(
        0.001, 0.25, 4.2, motion.time[0] + 1.3, exposure_time=detector.cadence_days
    )
    star = Star(12.5, signal=planet * variability)
    corrector = PLDCorrector(simulate(star, detector, motion, seed=1).to_tpf())
    lc = corrector.correct(transit_mask=planet(corrector.original_lc.time.value) < 1)
    assert corrector.model.clean is not None
    ratio = lc.flux.value / (planet * variability)(lc.time.value)
    assert np.nanstd(ratio) / np.nanmedian(ratio) < 1.4e-4  # 1.05e-4; the noise has 9e-5


def test_fractions_is_checked(star):
    with pytest.raises(ValueError, match=r"`fractions` must be one of predicted, .*got 'guessed'"):
        PLDCorrector(star.tpf).correct(fractions="guessed")


def test_cadences_without_a_factor_are_as_uncertain_as_their_flux(star):
    """Over-subtracted pixels: their sum is next to nothing, the fractions are in the hundreds."""
    hdus = star.tpf.hdu.__class__([hdu.copy() for hdu in star.tpf.hdu])
    flux = star.tpf.flux.value.copy()
    mask = np.zeros((9, 9), dtype=bool)
    mask[3:6, 3:6] = True
    flux[50, 3:6, 3:6] = -3e4
    flux[50, 4, 4] = 8 * 3e4 + 5
    hdus[1].data["FLUX"][:] = flux
    corrector = PLDCorrector(KeplerTargetPixelFile(hdus), mask)
    with pytest.warns(DetrendingWarning, match="1 of 400 cadences get the typical correction"):
        lc = corrector.correct(order=1, fractions="measured")
    assert np.isfinite(lc.flux.value).all()
    assert np.flatnonzero(lc.flux_err.value >= lc.flux.value).tolist() == [50]
    assert np.nanmax(lc.flux.value) < 1.01 * np.nanmedian(lc.flux.value)  # 1.0002


def test_a_fit_without_half_of_the_cadences_is_an_error(star, monkeypatch):
    original = _model.fit

    def few(*arguments, **options):
        solution = original(*arguments, **options)
        return replace(solution, use=solution.use & (np.arange(400) % 5 < 2))

    monkeypatch.setattr(_model, "fit", few)
    with pytest.raises(ValueError, match=r"240 of 400 cadences deviate from any model.*`sigma`"):
        PLDCorrector(star.tpf).correct()


def test_background_plane():
    rows, columns = np.indices((9, 9))
    truth = 5.0 + 0.3 * rows - 0.2 * columns
    star = 1e4 * np.exp(-0.8 * ((rows - 4) ** 2 + (columns - 4) ** 2))
    np.testing.assert_allclose(background_plane(truth + star), truth, atol=0.3)


def test_own_pixels_end_at_the_valley():
    rows, columns = np.indices((7, 13))
    one = np.exp(-0.5 * ((rows - 3) ** 2 + (columns - 3) ** 2))
    other = 2 * np.exp(-0.5 * ((rows - 3) ** 2 + (columns - 9) ** 2))
    own = own_pixels(one + other, np.ravel_multi_index((3, 3), (7, 13)))
    assert own[:, :5].all()
    assert not own[:, 7:].any()
    # a full column has many maxima, but it is one star
    full = np.where(columns == 3, 1.0 + 0.05 * (rows % 2), one)
    assert own_pixels(full, np.ravel_multi_index((3, 3), (7, 13)))[:, 3].all()


def test_masked_cadences_do_not_change_the_others(star):
    """Neither through the images, nor positions, focus, background and noise."""
    mask = np.arange(400) % 40 < 35
    hdus = star.tpf.hdu.__class__([hdu.copy() for hdu in star.tpf.hdu])
    damaged = star.tpf.flux.value * (1 + 0.2 * np.indices((9, 9))[0])
    hdus[1].data["FLUX"][~mask] = damaged[~mask]
    aperture = np.ones((9, 9), dtype=bool)
    found = []
    for tpf in (star.tpf, KeplerTargetPixelFile(hdus)):
        corrector = PLDCorrector(tpf, aperture)
        found.append(corrector.correct(cadence_mask=mask).flux.value)
        assert corrector.model.clean is not None
    np.testing.assert_allclose(found[1][mask], found[0][mask], rtol=1e-9)
    assert not np.allclose(found[1][~mask], found[0][~mask], rtol=1e-3)


@pytest.mark.slow
def test_transits_in_a_crowded_field_are_no_change_of_focus():
    """The light of neighbors does not dim with the star: its images seem to widen."""
    study = tess.TESSNoise(magnitudes=(12.0,), neighbors=(10,))
    (task,) = tess.tasks(study)
    assert tess.measure(study, task)["pld_survival"] > 0.8


def test_light_of_a_faint_star_that_moves_far_does_not_follow_its_width():
    sky = make_sky("k2-5x-kp15", seed=2001, n_cadences=1500)
    found = score(PLDCorrector(sky.to_tpf()).correct(), sky)
    assert found.full < 1.0  # 0.67; 4.1 with the brightness at the smoothed focus
    assert 0.9 < found.pull < 1.1  # 0.98


def test_light_of_a_faint_star_has_less_noise_than_the_sum():
    corrector = PLDCorrector(make_sky("k2-1x-kp17", seed=6300, n_cadences=800).to_tpf(), "all")
    lc, raw = corrector.correct(), corrector.original_lc
    spread = 1.05 * np.nanmedian(np.abs(np.diff(lc.flux.value / np.nanmedian(lc.flux.value))))
    assert spread < 0.6 * np.nanmedian(raw.flux_err.value / raw.flux.value)  # 0.47


def test_the_weights_of_a_faint_star_follow_its_motion():
    """The sum over all pixels that it crosses has twice the noise of those that it is in."""
    observation = simulate(
        Star(15.5), Detector.k2(shape=(17, 17)), 10 * Motion.k2_roll(1000, seed=1), seed=1
    )
    corrector = PLDCorrector(observation.to_tpf())
    lc, raw = corrector.correct(), corrector.original_lc
    spread = 1.05 * np.nanmedian(np.abs(np.diff(lc.flux.value / np.nanmedian(lc.flux.value))))
    assert spread < 0.75 * np.nanmedian(raw.flux_err.value / raw.flux.value)


def test_a_background_that_fluctuates():
    """From cadence to cadence, alike in all pixels, as in K2's files."""
    hdus = make_sky("k2-1x-kp17", seed=6300, n_cadences=800).to_tpf().hdu
    spread, raw = [], []
    for size in (0.0, 0.5):
        hdus[1].data["FLUX"] += size * np.random.default_rng(1).normal(size=(800, 1, 1))
        corrector = PLDCorrector(KeplerTargetPixelFile(hdus))
        for lc, found in ((corrector.correct(), spread), (corrector.original_lc, raw)):
            found.append(np.nanstd(np.diff(lc.flux.value)) / np.nanmedian(lc.flux.value))
    assert spread[1] < 1.1 * spread[0]
    assert raw[1] > 1.4 * raw[0]


def test_a_short_file_of_a_star_that_jumps_within_exposures():
    """What exceeds the model in the one place is missing in the other, and no cosmic ray."""
    sky = make_sky("k2-5x-neighbor", seed=303, n_cadences=1500, positions=None)
    lc = PLDCorrector(sky.to_tpf(quality_bitmask="none")[:300]).correct()
    flux = lc.flux.value / sky.true_flux[:300]
    assert mad_std(flux, ignore_nan=True) < 1e-4 * np.nanmedian(flux)  # 66 ppm, 3062 without


def test_a_short_file_keeps_the_variability_of_a_star_with_a_neighbor():
    sky = make_sky("k2-1x-rr-lyrae-neighbor", seed=320, n_cadences=150)
    lc = PLDCorrector(sky.to_tpf(quality_bitmask="none")).correct()
    flux = lc.flux.value / sky.true_flux
    assert mad_std(flux, ignore_nan=True) < 2e-4 * np.nanmedian(flux)  # 84 ppm, 13 % if measured


def test_a_model_without_numbers_is_replaced_with_a_warning(star, monkeypatch):
    def failing(*_, **__):
        raise ValueError("array must not contain infs or NaNs")

    monkeypatch.setattr(_source, "fit_star", failing)
    corrector = PLDCorrector(star.tpf)
    with pytest.warns(DetrendingWarning, match="the model of the pixels fails"):
        lc = corrector.correct()
    assert np.isfinite(lc.flux.value).all()
    assert corrector.model.clean is None


@pytest.mark.parametrize(("known", "predicted"), [(5, False), (6, True)])
def test_pixels_without_data_show_nothing(star, known, predicted):
    """A cadence has five unknowns."""
    series = read_pixels(star.tpf)
    order = np.argsort(-np.median(series.flux, axis=0), axis=None)
    flux = series.flux.copy()
    flux[:, *np.unravel_index(order[known:], flux.shape[1:])] = np.nan
    mask = np.zeros(flux.shape[1:], dtype=bool)
    mask.flat[order[:4]] = True
    pixels = aperture_pixels(series.replace(flux=flux), mask)
    assert can_predict(pixels, None, pixels.usable) == predicted


def test_an_aperture_is_not_chosen_by_few_positions():
    hdus = make_sky("k2-5x-constant", seed=2028, n_cadences=120).to_tpf(quality_bitmask="none").hdu
    for name in ("POS_CORR1", "POS_CORR2"):
        hdus[1].data[name][1:] = np.nan
    known = PLDCorrector(KeplerTargetPixelFile(hdus, quality_bitmask="none"))
    for name in ("POS_CORR1", "POS_CORR2"):
        hdus[1].data[name][:] = np.nan
    unknown = PLDCorrector(KeplerTargetPixelFile(hdus, quality_bitmask="none"))
    assert (known.aperture_mask == unknown.aperture_mask).all()


def test_predicted_fractions_follow_the_seeing_of_a_bright_star():
    sky = make_sky("ground-seeing", seed=6302, n_cadences=800)
    corrector = PLDCorrector(sky.to_tpf())
    lc = corrector.correct(fractions="predicted")
    change = np.log(lc.flux.value / sky.true_flux[lc.cadenceno - 1])[~corrector.outlier_mask]
    assert np.nanstd(change) < 5e-4  # 3.0e-4
    assert corrector.outlier_mask.sum() < 10


def test_constant_stars_of_a_large_stamp_do_not_weaken_variability():
    """A star of 0.75 of its light 8.3 px away, outside of the aperture."""
    star = Star(12.0, 11.5, 11.5, signal=sinusoidal_signal(0.005, period=2.7))
    stars = [star, Star(12.3, 4.0, 15.0)]
    observation = simulate(stars, Detector.k2(shape=(24, 24)), Motion.k2_roll(500, seed=1), seed=1)
    lc = PLDCorrector(observation.to_tpf()).correct()
    phase = 2 * np.pi * lc.time.value / 2.7
    columns = np.column_stack([np.ones(len(phase)), np.sin(phase), np.cos(phase)])
    level, *waves = np.linalg.lstsq(columns, lc.flux.value, rcond=None)[0]
    assert np.hypot(*waves) / level == pytest.approx(0.005, rel=0.01)  # 0.0046 with its pixels


def test_pixels_without_errors_have_those_of_their_other_cadences(star):
    tpf, none = star.tpf, slice(50, 110)
    hdu = tpf.hdu
    hdulist = type(hdu)([one.copy() for one in hdu])
    hdulist[1].data["FLUX_ERR"][none] = 0.0
    with pytest.warns(DetrendingWarning, match="without a valid FLUX_ERR"):
        corrector = PLDCorrector(KeplerTargetPixelFile(hdulist, quality_bitmask="none"))
    lc = corrector.correct()
    error = lc.flux_err.value
    inside = np.isin(lc.cadenceno, hdulist[1].data["CADENCENO"][none])
    assert np.nanmedian(error[inside]) == pytest.approx(np.nanmedian(error[~inside]), rel=0.1)


def test_light_of_a_real_star_beside_brighter_ones_is_its_own(shared_data):
    """It is 14 % of all light; with the pixels of the others 13 % of a depth survived."""
    corrector = PLDCorrector(read_tpf(shared_data / "kepler_q12_ch4" / "tpf_01.fits.gz"))
    corrector.correct()
    assert corrector.result.transit_survival > 0.85  # 0.91


def test_pixels_of_a_star_that_is_not_the_target():
    """A fit has its place; the target is the brightest star, or that of the coordinates."""
    stars, detector = [Star(12.0, 3.0, 3.0), Star(13.0, 9.0, 8.0)], Detector.k2(shape=(12, 13))
    series = read_pixels(simulate(stars, detector, Motion.k2_roll(100), seed=1).to_tpf())
    series = series.replace(aperture=np.zeros((12, 13), dtype=bool))
    for place, inside, outside in ((None, (3, 3), (8, 9)), ((9.0, 8.0), (8, 9), (3, 3))):
        pixels = aperture_pixels(series, None, place)
        assert pixels.aperture[inside]
        assert not pixels.aperture[outside]
        assert pixels.core[inside]
