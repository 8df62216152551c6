"""Tests of the corrector that models all pixels, on stars of known truth."""

import copy
import tracemalloc
import warnings

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table

from scope_models import Detector, Motion, Star, simulate
from scope_models.benchmark import make_sky, score
from scope_models.correctors import PLDCorrector, SceneCorrector
from scope_models.correctors._flux_model import FluxModel
from scope_models.exceptions import DetrendingWarning, LostLightWarning
from scope_models.io import read_pixels
from scope_models.io.pixels import target_place


@pytest.fixture(scope="module")
def neighbor():
    """Return an RR Lyrae star with a neighbor 1 mag fainter, and its correction."""
    sky = make_sky("k2-1x-rr-lyrae-neighbor", 11, n_cadences=300)
    corrector = SceneCorrector(sky.to_tpf())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        corrector.correct()
    return sky, corrector


@pytest.fixture(scope="module")
def constant():
    """Return a constant star, and its correction."""
    sky = make_sky("k2-1x-constant", 12, n_cadences=300)
    corrector = SceneCorrector(sky.to_tpf())
    corrector.correct()
    return sky, corrector


def test_neighbor_is_found_where_it_is(neighbor):
    sky, corrector = neighbor
    found = corrector.result.neighbors
    light = np.nanmean(sky.neighbor_light, axis=0)
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    assert len(found) == 1
    assert found["x"][0].value == pytest.approx((light * u).sum() / light.sum(), abs=0.3)
    assert found["y"][0].value == pytest.approx((light * v).sum() / light.sum(), abs=0.3)
    assert found["flux"][0].value == pytest.approx(light.sum(), rel=0.1)


def test_crowding_of_an_aperture(neighbor):
    sky, corrector = neighbor
    box = np.zeros(sky.aperture.shape, dtype=bool)
    y, x = (round(np.median(v)) for v in (sky.y, sky.x))
    box[y - 2 : y + 3, x - 2 : x + 3] = True
    own, other = (light[:, box].sum() for light in (sky.star_light, sky.neighbor_light))
    assert corrector.crowding(box) == pytest.approx(own / (own + other), abs=0.02)


def test_variable_star_is_kept(neighbor):
    sky, corrector = neighbor
    found = score(corrector.corrected_lc, sky)
    assert found.amplitude == pytest.approx(1, abs=0.01)
    raw = score(corrector.original_lc, sky)
    assert found.full < 0.2 * raw.full


def test_constant_star_is_at_the_noise(constant):
    sky, corrector = constant
    found = score(corrector.corrected_lc, sky)
    assert found.full < 3
    assert found.high_passed < 2
    assert 0.6 < found.pull < 1.5


def test_result_is_one_line(constant):
    text = repr(constant[1].result)
    assert text.startswith("<SceneResult: window ")
    assert "\n" not in text
    assert constant[1].result.crowding == pytest.approx(1, abs=0.02)
    assert constant[1].result.transit_survival > 0.7


@pytest.mark.slow
def test_transit_that_was_put_into_the_pixels():
    sky = make_sky("k2-1x-transits-neighbor", 13, n_cadences=500)
    corrector = SceneCorrector(sky.to_tpf())
    keep = np.isin(sky.cadenceno, np.asarray(corrector.tpf.cadenceno))
    corrector.correct(transit_mask=(sky.transit < 1)[keep])
    scale, error = corrector.fit_transit(sky.transit[keep])
    assert scale == pytest.approx(1, abs=max(4 * error, 0.02))
    assert error < 0.05
    corrector.correct(transit_model=sky.transit[keep])
    assert corrector.result.transit_scale == pytest.approx(scale, abs=0.02)


@pytest.mark.slow
def test_same_call_gives_the_same(constant):
    sky, corrector = constant
    again = SceneCorrector(sky.to_tpf()).correct()
    np.testing.assert_array_equal(again.flux.value, corrector.corrected_lc.flux.value)


@pytest.mark.slow
def test_windows_that_the_model_has_not_seen(constant):
    corrector = constant[1]
    residual, error, used = corrector.held_out(7)
    assert used.shape == (7 * len(residual),)
    assert np.isfinite(corrector.corrected_lc.flux.value[used]).all()
    assert not corrector.outlier_mask[used].any()
    assert 0.5 < np.sqrt(np.mean((residual / error) ** 2)) < 2


def test_trend_can_be_removed(neighbor):
    sky, corrector = neighbor
    place = corrector.result.neighbors
    corrector = SceneCorrector(sky.to_tpf(), neighbors=place)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        flat = corrector.correct(restore_trend=False)
    good = np.isfinite(flat.flux.value)
    assert np.std(flat.flux.value[good]) < 0.02 * np.median(flat.flux.value[good])


@pytest.mark.slow
def test_without_positions_and_with_a_users_aperture(constant):
    sky, corrector = constant
    tpf = sky.to_tpf()
    tpf.hdu[1].data["POS_CORR1"][:] = np.nan
    tpf.hdu[1].data["POS_CORR2"][:] = np.nan
    mask = np.ones(tpf.shape[1:], dtype=bool)
    other = SceneCorrector(tpf, aperture_mask=mask)
    found = score(other.correct(), sky)
    assert other.result.window == "aperture"
    assert found.full < 0.5 * score(corrector.original_lc, sky).full


def test_given_neighbors_are_where_they_are_given(neighbor):
    sky, corrector = neighbor
    found = corrector.result.neighbors
    x, y = found["x"][0].value, found["y"][0].value
    track = corrector.scene.track
    tpf = sky.to_tpf()
    for given in ([[x, y]], Table([[x], [y]], names=("x", "y"))):
        known = SceneCorrector(tpf, neighbors=given)._known
        expected = [[x - np.median(track.x), y - np.median(track.y)]]
        np.testing.assert_allclose(known.offsets(track), expected, atol=1e-9)
    assert SceneCorrector(tpf, neighbors=[])._known.places.shape == (0, 2)


def test_neighbors_on_the_sky(constant):
    """lightkurve's own reading of the file's coordinates is the truth."""
    tpf = constant[0].to_tpf()
    place = tpf.wcs.world_to_pixel(SkyCoord(tpf.ra, tpf.dec, unit="deg"))
    other = tpf.wcs.pixel_to_world(place[0] + 3.0, place[1] - 2.0)
    table = Table({"ra": [other.ra.deg], "dec": [other.dec.deg]})
    track = constant[1].scene.track
    for given in (other, SkyCoord([other]).galactic, table):
        known = SceneCorrector(tpf, neighbors=given)._known
        np.testing.assert_allclose(known.offsets(track), [[3.0, -2.0]], atol=1e-4)
    with pytest.raises(ValueError, match="must not hold the target itself"):
        SceneCorrector(tpf, neighbors=SkyCoord(tpf.ra, tpf.dec, unit="deg"))


def test_neighbors_that_cannot_matter_warn(constant):
    with pytest.warns(DetrendingWarning, match="1 of `neighbors` are far outside"):
        corrector = SceneCorrector(constant[0].to_tpf(), neighbors=[[3.0, 1.0], [40.0, 2.0]])
    assert len(corrector._known.places) == 1


def test_coordinates_of_a_real_file(shared_data):
    name = "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz"
    series = read_pixels(shared_data / name)
    image = np.nanmedian(series.flux, axis=0)
    rows, columns = np.indices(image.shape)
    center = [np.sum(image * k) / image.sum() for k in (columns, rows)]
    np.testing.assert_allclose(target_place(series), center, atol=0.5)


def test_absurd_corrections_become_the_typical_one(constant, monkeypatch):
    corrector = copy.copy(constant[1])
    allowed = np.ones(corrector._data.usable.sum(), dtype=bool)
    removed, variance = corrector._chosen.model.systematics()
    removed[7] = 10.0
    monkeypatch.setattr(FluxModel, "systematics", lambda _: (removed, variance))
    with pytest.warns(DetrendingWarning, match="1 of .* cadences have the typical correction"):
        corrector._finish(allowed, has_transit=False, restore_trend=True)
    lc = corrector.corrected_lc
    lost = (lc.flux_err.value >= lc.flux.value) & corrector._data.usable
    np.testing.assert_array_equal(np.flatnonzero(lost[corrector._data.usable]), [7])


def test_correction_that_adds_noise_warns(constant, monkeypatch):
    corrector = copy.copy(constant[1])
    allowed = np.ones(corrector._data.usable.sum(), dtype=bool)
    _, variance = corrector._chosen.model.systematics()
    walk = np.cumsum(np.random.default_rng(3).normal(0, 0.02, len(variance)))
    monkeypatch.setattr(FluxModel, "systematics", lambda _: (walk, variance))
    corrector._finish(allowed, has_transit=False, restore_trend=True)
    with pytest.warns(DetrendingWarning, match="scatters more than the sum over the aperture"):
        corrector._warn_of_noise()


def test_full_pixels_warn():
    sky = make_sky("k2-1x-kp10-saturated", 1, n_cadences=100)
    corrector = SceneCorrector(sky.to_tpf(), neighbors=[])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lc = corrector.correct()
    assert any("PLDCorrector corrects such stars better" in str(w.message) for w in caught)
    assert any("is that of PLDCorrector: see `fallback`" in str(w.message) for w in caught)
    assert corrector.result.window == "PLD"
    expected = PLDCorrector(sky.to_tpf()).correct()
    np.testing.assert_array_equal(lc.flux.value, expected.flux.value)
    assert len(corrector.held_out()) == 3


@pytest.mark.slow
def test_crowded_window_warns(neighbor):
    sky, _ = neighbor
    tpf = sky.to_tpf()
    corrector = SceneCorrector(tpf, aperture_mask=np.ones(tpf.shape[1:], dtype=bool))
    with pytest.warns(DetrendingWarning, match="other stars give .* % of the window's starlight"):
        corrector.correct()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"aperture_mask": np.ones((2, 2), bool)}, "`aperture_mask` must be a boolean mask"),
        (
            {"neighbors": [[1.0, 2.0, 3.0]]},
            r"`neighbors` must be finite positions of shape \(k, 2\)",
        ),
        ({"neighbors": [[np.nan, 2.0]]}, "`neighbors` must be finite"),
        ({"neighbors": Table({"a": [1.0]})}, "`neighbors` must have the columns x and y"),
    ],
)
def test_bad_arguments(constant, arguments, match):
    with pytest.raises(ValueError, match=match):
        SceneCorrector(constant[0].to_tpf(), **arguments)


def test_flux_is_an_open_choice(constant):
    corrector = SceneCorrector(constant[0].to_tpf())
    corrector.correct(flux="sum")
    assert corrector.result.window in (3.0, 4.0)
    corrector.correct(flux="weighted")
    assert corrector.result.window == "optimal"
    with pytest.raises(ValueError, match="`flux` must be one of"):
        corrector.correct(flux="best")


def test_calls_in_the_wrong_order(constant):
    corrector = SceneCorrector(constant[0].to_tpf())
    for call in (corrector.diagnose, lambda: corrector.fit_transit(np.ones(3))):
        with pytest.raises(ValueError, match="call `correct` first"):
            call()
    with pytest.raises(ValueError, match="at least 30 usable cadences"):
        corrector.correct(cadence_mask=np.zeros(len(corrector.cadence_mask), dtype=bool))


def test_pictures(constant):
    corrector = constant[1]
    assert len(corrector.diagnose()) == 3
    assert len(corrector.diagnose_masks()) == 2


@pytest.mark.slow
def test_neighbors_of_a_saturated_star_that_diverge_are_left_out():
    tpf = make_sky("k2-1x-kp9-saturated", 5008).to_tpf()
    with (
        pytest.warns(DetrendingWarning, match="saturate"),
        pytest.warns(DetrendingWarning, match="see `fallback`"),
    ):
        curve = SceneCorrector(tpf).correct()
    assert np.isfinite(curve.flux.value).mean() > 0.9


@pytest.mark.parametrize("n", [40, 300])
def test_hours_of_fast_cadences(n):
    """They are shorter than two transits of 6.5 h."""
    motion = Motion.still(n, start=1400, cadence=120 / 86400, time_format="btjd")
    tpf = simulate(Star(9, 4, 4), Detector.tess(shape=(9, 9)), motion, seed=1).to_tpf()
    lc = SceneCorrector(tpf).correct()
    white = np.median(lc.flux_err.value / lc.flux.value)
    assert np.std(lc.flux.value) / np.median(lc.flux.value) < 1.2 * white


def test_short_series_name_the_cadences_needed(fake_star):
    with pytest.raises(ValueError, match="at least 30 usable cadences are needed, got 29"):
        SceneCorrector(fake_star(29).tpf)


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_without_flux_err(fake_star, value):
    tpf = fake_star(100).tpf
    tpf.hdu[1].data["FLUX_ERR"][:] = value
    with pytest.warns(DetrendingWarning, match="FLUX_ERR has no valid values: .* the scatter"):
        corrector = SceneCorrector(tpf)
    lc = corrector.correct()
    assert np.isfinite(lc.flux.value).all()
    assert lc.estimate_cdpp() < 0.1 * corrector.original_lc.estimate_cdpp()


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
@pytest.mark.parametrize(
    ("shape", "x", "y"), [((1, 9), 12, 0), ((3, 3), 1, 5), ((9, 9), 12, 4), ((5, 5), -3, 2)]
)
def test_stars_off_the_stamp_warn(shape, x, y):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostLightWarning)
        observation = simulate(
            Star(12, x, y), Detector.k2(shape=shape), Motion.k2_roll(200, seed=1), seed=1
        )
    with pytest.warns(DetrendingWarning, match="or there is no light above the noise: do not use"):
        SceneCorrector(observation.to_tpf()).correct()


def test_part_of_the_light_that_is_noisy_warns(constant):
    """In an aperture with little light of the target its own light is noisier than the sum."""
    corrector = copy.copy(constant[1])
    allowed = np.ones(corrector._data.usable.sum(), dtype=bool)
    others = corrector.original_lc.copy()
    others.flux = others.flux + 100 * np.nanmedian(others.flux)
    corrector.original_lc = others
    corrector._finish(allowed, has_transit=False, restore_trend=True)
    with pytest.warns(DetrendingWarning, match="times the relative noise of the sum over the ap"):
        corrector._warn_of_noise()


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_memory_of_fast_cadences_with_a_gap_of_300_days(fake_star):
    tpf = fake_star(90, 12, 1).tpf
    time = 2144.0 + np.arange(90) / 1440
    time[45:] += 300
    tpf.hdu[1].data["TIME"][:] = time
    tracemalloc.start()
    SceneCorrector(tpf).correct()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e8


def test_a_light_curve_of_the_fallback_is_not_warned_of(constant, monkeypatch):
    """The noise is that of the model of the scene, whose light curve is not returned."""
    corrector = copy.copy(constant[1])
    walk = np.cumsum(np.random.default_rng(3).normal(0, 0.02, corrector._data.usable.sum()))
    monkeypatch.setattr(FluxModel, "systematics", lambda _: (walk, np.zeros(len(walk))))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        corrector.correct()
    assert corrector.fallback is not None
    messages = [str(w.message) for w in caught]
    assert any("see `fallback`" in message for message in messages)
    assert not any("do not use it" in message for message in messages)
