"""Tests of the corrector that models all pixels, on stars of known truth."""

import warnings

import numpy as np
import pytest
from astropy.table import Table

from scope_models.correctors import SceneCorrector
from scope_models.exceptions import DetrendingWarning
from scope_models.experiments.skies import make_sky, score


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


def test_given_neighbors(neighbor):
    sky, corrector = neighbor
    found = corrector.result.neighbors
    place = [[found["x"][0].value, found["y"][0].value]]
    tpf = sky.to_tpf()
    for given in (place, Table(np.array(place), names=("x", "y"))):
        assert SceneCorrector(tpf, neighbors=given)._offsets.shape == (1, 2)
    assert SceneCorrector(tpf, neighbors=[])._offsets.shape == (0, 2)


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
        ({"neighbors": [[1.0, 2.0, 3.0]]}, r"`neighbors` must have shape \(m, 2\)"),
        ({"neighbors": [[np.nan, 2.0]]}, "`neighbors` must be finite"),
        ({"neighbors": Table({"a": [1.0]})}, "`neighbors` must have the columns x and y"),
    ],
)
def test_bad_arguments(constant, arguments, match):
    with pytest.raises(ValueError, match=match):
        SceneCorrector(constant[0].to_tpf(), **arguments)


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
