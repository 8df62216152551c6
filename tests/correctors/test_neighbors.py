"""Tests of neighbors whose light the corrector takes off, on stars of known truth."""

import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from scope_models import Detector, Motion, Scene, Star, simulate
from scope_models.benchmark import SkyRegime, make_sky, score
from scope_models.correctors import PLDCorrector
from scope_models.exceptions import DetrendingWarning, LostLightWarning
from scope_models.io import read_pixels
from scope_models.io.pixels import target_place
from scope_models.models import PRF
from scope_models.pixelmodel import _source


def corrected(sky, *arguments, **options):
    """Return a corrector after its default call."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        corrector = PLDCorrector(sky.to_tpf(), *arguments, **options)
        corrector.correct()
    return corrector


def true_share(sky, corrector):
    """Return the star's part of the light in the corrector's aperture."""
    lights = sky.star_light, sky.neighbor_light
    own, others = (np.nansum(light[:, corrector.aperture_mask]) for light in lights)
    return own / (own + others)


@pytest.fixture(scope="module")
def neighbor():
    """Return an RR Lyrae star with a neighbor 1 mag fainter, and its correction."""
    sky = make_sky("k2-1x-rr-lyrae-neighbor", 11, n_cadences=300)
    return sky, corrected(sky)


@pytest.fixture(scope="module")
def constant():
    """Return a constant star, and its correction."""
    sky = make_sky("k2-1x-constant", 12, n_cadences=250)
    return sky, corrected(sky)


def test_neighbor_is_found_where_it_is(neighbor):
    sky, corrector = neighbor
    found = corrector.result.neighbors
    light = np.nanmean(sky.neighbor_light, axis=0)
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    assert len(found) == 1
    assert found["x"][0].value == pytest.approx((light * u).sum() / light.sum(), abs=0.15)
    assert found["y"][0].value == pytest.approx((light * v).sum() / light.sum(), abs=0.15)
    assert found["flux"][0].value == pytest.approx(light.sum(), rel=0.03)


@pytest.mark.parametrize("seed", [2045, 7004])
def test_a_neighbor_without_a_peak_is_where_constant_light_is(seed):
    """Spots of 0.6 % would be taken off with the images' misfit, which follows the star."""
    sky = make_sky("tess-spots-3d-neighbor-close", seed, n_cadences=1500)
    corrector = corrected(sky)
    light = sky.neighbor_light.sum(axis=(1, 2)).mean()
    assert corrector.result.neighbors["flux"].value == pytest.approx([light], rel=0.03)
    flux, rows = corrector.corrected_lc.flux.value, np.isin(sky.cadenceno, corrector.tpf.cadenceno)
    slope, level = np.polyfit(sky.true_flux[rows], flux / np.nanmedian(flux), 1)
    assert slope / (slope + level) == pytest.approx(1, abs=0.01)


def test_positions_are_those_of_the_target(neighbor):
    sky, corrector = neighbor
    keep = np.isin(sky.cadenceno, np.asarray(corrector.tpf.cadenceno))
    change = corrector.result.positions - np.stack([sky.x, sky.y], axis=1)[keep]
    assert np.nanstd(change, axis=0).max() < 0.008  # 0.0034


def test_light_that_is_taken_off(neighbor):
    sky, corrector = neighbor
    assert corrector.model.clean is not None
    own, other = (
        np.nanmedian(light[:, corrector.aperture_mask].sum(axis=1))
        for light in (sky.star_light, sky.neighbor_light)
    )
    assert corrector.result.crowding == pytest.approx(own / (own + other), abs=1e-3)  # 1e-4
    assert corrector.result.contamination == pytest.approx(other / (own + other), abs=1e-3)


def test_variable_star_is_kept(neighbor):
    sky, corrector = neighbor
    found = score(corrector.corrected_lc, sky)
    assert found.amplitude == pytest.approx(1, abs=0.002)  # 3e-4
    assert found.full < 0.02 * score(corrector.original_lc, sky).full


@pytest.mark.parametrize(
    ("regime", "neighbors", "n"),
    [
        ("k2-1x-neighbor-variable", None, 300),
        pytest.param("rest-eclipses-30pct-neighbor", "find", 500, marks=pytest.mark.slow),
    ],
)
def test_neighbors_that_vary_and_stars_at_rest(regime, neighbors, n):
    sky = make_sky(regime, 21, n_cadences=n)
    found = score(corrected(sky, neighbors=neighbors).corrected_lc, sky)
    assert found.full < 4
    if sky.regime.star == "eclipsing":
        assert found.amplitude == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    "regime", ["jitter-eclipses-30pct-neighbor", "rest-eclipses-2pct-neighbor"]
)
def test_constant_light_in_the_wings_of_an_eclipsing_star(regime):
    """The neighbors have no peaks of their own: the eclipses show them."""
    sky = make_sky(regime, 23, n_cadences=400)
    corrector = corrected(sky)
    assert len(corrector.result.neighbors) == 1
    found = score(corrector.corrected_lc, sky)
    assert found.amplitude == pytest.approx(1, abs=0.01)
    assert 0.5 < found.pull < 1.5
    part = f"{100 * corrector.result.contamination:.1f} %"
    assert part in str(corrector.result)
    assert "taken off" not in " ".join(corrector.result.remarks())  # depths are right within 1 %


@pytest.mark.parametrize(("magnitudes", "distance"), [(-0.05, 2.5), (-0.3, 3.0)])
def test_a_neighbor_that_is_brighter(magnitudes, distance):
    """The target is in the file's aperture, which does not hold the neighbor's peak."""
    neighbors = ((magnitudes, distance, 0.0),)
    variability = {"star": "rr_lyrae", "period": 0.55, "amplitude": 0.3}
    sky = make_sky(SkyRegime("bright", neighbors=neighbors, **variability), 33, n_cadences=300)
    light = np.nanmedian(sky.star_light, axis=0)
    sky = replace(sky, aperture=light > 0.03 * light.max())
    corrector = corrected(sky)
    assert corrector.result.crowding == pytest.approx(true_share(sky, corrector), abs=0.005)
    found, raw = (score(lc, sky) for lc in (corrector.corrected_lc, corrector.original_lc))
    assert found.amplitude == pytest.approx(1, abs=0.003)  # 0.0014
    assert found.full < 0.03 * raw.full


@pytest.mark.parametrize("aperture", [None, "pipeline"])
@pytest.mark.parametrize(("magnitudes", "distance"), [(-0.5, 2.0), (-1.5, 3.0)])
def test_the_target_is_the_star_at_the_coordinates(magnitudes, distance, aperture):
    """Its neighbor is in the file's aperture, and if it is near there is no dip between."""
    neighbors = ((magnitudes, distance, 0.0),)
    variability = {"star": "rr_lyrae", "period": 0.55, "amplitude": 0.3}
    regime = SkyRegime("bright", magnitude=14.5, neighbors=neighbors, **variability)
    sky = make_sky(regime, 38, n_cadences=300)
    light = np.nanmedian(sky.star_light + sky.neighbor_light, axis=0)
    sky = replace(sky, aperture=light > 0.01 * light.max())
    corrector = corrected(sky, aperture)
    assert corrector.result.crowding == pytest.approx(true_share(sky, corrector), abs=0.005)
    found, raw = (score(lc, sky) for lc in (corrector.corrected_lc, corrector.original_lc))
    assert found.amplitude == pytest.approx(1, abs=0.003)  # 0.0014
    assert found.full < 0.2 * raw.full
    error = corrector.result.contrast_error
    remark = f"depths and amplitudes are uncertain by {100 * error:.0f} %"
    assert (remark in " ".join(corrector.result.remarks())) == (error > 0.02)
    assert error > 0.02 or aperture is None


def test_a_target_that_drowns_in_a_neighbor():
    """The chosen aperture holds 2 % of its light: no correction of that is one."""
    neighbors = ((-1.5, 3.0, 0.0),)
    variability = {"star": "rr_lyrae", "period": 0.55, "amplitude": 0.3}
    regime = SkyRegime("bright", magnitude=14.5, neighbors=neighbors, **variability)
    sky = make_sky(regime, 54, n_cadences=300)
    light = np.nanmedian(sky.star_light + sky.neighbor_light, axis=0)
    sky = replace(sky, aperture=light > 0.01 * light.max())
    corrector = PLDCorrector(sky.to_tpf())
    assert true_share(sky, corrector) < 0.02
    with pytest.warns(DetrendingWarning, match="hardly any light of the star at the file's"):
        lc = corrector.correct()
    assert corrector.result.neighbors is None
    assert np.nanstd(lc.flux.value) < 0.02 * np.nanmedian(lc.flux.value)


@pytest.mark.parametrize(
    ("hdu", "key", "value"),
    [(0, "RA_OBJ", None), (0, "RA_OBJ", "unknown"), (0, "RA_OBJ", 200.0), (1, "1CRPX5", "x"),
     (1, "1CDLT5", 0.0)],
)  # fmt: skip
def test_coordinates_that_are_no_place_in_the_pixels(hdu, key, value):
    """The target is the brightest star."""
    sky = make_sky(SkyRegime("two", neighbors=((1.0, 3.0, 0.0),)), 35, n_cadences=250)
    tpf = sky.to_tpf()
    given = PLDCorrector(tpf).aperture_mask
    tpf.hdu[hdu].header[key] = value
    np.testing.assert_array_equal(PLDCorrector(tpf).aperture_mask, given)


@pytest.mark.parametrize(("order", "seed"), [(1, 213), (-1, 212)])
def test_neighbors_of_which_one_is_brighter_and_one_varies(order, seed):
    neighbors = ((2.3, 3.0, 0.2), (-1.4, 3.5, 0.0))[::order]
    regime = SkyRegime("two", magnitude=15.0, depth=0.01, neighbors=neighbors)
    sky = make_sky(regime, seed, n_cadences=400)
    light = np.nanmedian(sky.star_light, axis=0)
    sky = replace(sky, aperture=light > 0.03 * light.max())
    corrector = corrected(sky)
    assert corrector.result.crowding == pytest.approx(true_share(sky, corrector), abs=0.005)
    found, raw = (score(lc, sky) for lc in (corrector.corrected_lc, corrector.original_lc))
    assert found.depth == pytest.approx(1, abs=0.05)
    assert found.full < 0.05 * raw.full


@pytest.mark.parametrize("seed", [12, 13])
def test_cadences_with_rolling_bands_beside_a_neighbor(seed):
    """Their pixels say nothing of the motion, which goes on."""
    sky = make_sky("k2-1x-rr-lyrae-neighbor", seed, n_cadences=300)
    tpf = sky.to_tpf()
    banded = (np.arange(300) >= 100) & (np.arange(300) < 160)
    tpf.hdu[1].data["QUALITY"][banded] |= 131072
    lc = PLDCorrector(tpf).correct()
    kept = np.isin(sky.cadenceno, lc.cadenceno)
    change = lc.flux.value / sky.true_flux[kept]
    change = change / np.nanmedian(change) - 1
    assert np.nanstd(change[banded[kept]]) < 8 * np.nanstd(change[~banded[kept]])


@pytest.mark.parametrize(
    ("mission", "star"), [("K2", "rr_lyrae"), ("K2", "eclipsing"), ("TESS", "rr_lyrae")]
)
def test_a_blended_star_keeps_its_variability(mission, star):
    """A neighbor within the PSF cannot be subtracted: that the light is diluted is stated."""
    tess = {"mission": "TESS", "motion": "tess", "magnitude": 9.0, "focus": 0.001}
    variability = {"star": star, "period": 0.55 if star == "rr_lyrae" else 2.3, "amplitude": 0.2}
    options = variability | (tess if mission == "TESS" else {})
    sky = make_sky(SkyRegime("blend", neighbors=((1, 1.1, 0.0),), **options), 31, n_cadences=600)
    corrector = corrected(sky)
    remarks = " ".join(corrector.result.remarks())
    assert "of other stars: depths and amplitudes are too small" in remarks
    own, others = (
        light[:, corrector.aperture_mask].sum() for light in (sky.star_light, sky.neighbor_light)
    )
    share = own / (own + others)
    assert score(corrector.corrected_lc, sky).amplitude == pytest.approx(share, abs=0.005)
    assert share < corrector.result.crowding < 0.95


@pytest.mark.parametrize(("neighbors", "amplitude"), [(None, 0.0), (None, 0.005), ("find", 0.0)])
def test_bumps_of_a_real_prf(shared_data, neighbors, amplitude):
    """They follow the star, but look like other stars if these need no peak."""
    folder = shared_data / "tess_prf"
    detector = Detector.tess(shape=(9, 9), psf=PRF.from_tess(folder, 2, 3, 557, 513))
    star = Star(10, 4.2, 3.9, signal=1 + amplitude * np.sin(np.arange(230) / 20))
    tpf = simulate(star, detector, Motion.tess(230, seed=3), seed=3).to_tpf()
    corrector = PLDCorrector(tpf, neighbors=neighbors)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        corrector.correct()
    assert (corrector.result.neighbors is None) == (neighbors is None)


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
@pytest.mark.parametrize("place", [(557, 513), (45, 1)])
def test_eclipses_beside_a_neighbor_with_a_real_prf(shared_data, place):
    """Official PRFs are no sums of Gaussians of one shape."""
    psf = PRF.from_tess(shared_data / "tess_prf", 2, 3, *place)
    eclipsed = np.arange(600) // 7 % 9 == 0
    stars = Star(10, 5.1, 4.9, signal=1 - 0.3 * eclipsed), Star(11, 7.3, 6.2)
    scene = Scene(stars, Detector.tess(shape=(11, 11), psf=psf), Motion.tess(600, seed=1))
    tpf = simulate(scene, seed=1).to_tpf()
    flux = PLDCorrector(tpf, neighbors=[[7.3, 6.2]]).correct().flux.value
    eclipsed = eclipsed[np.asarray(tpf.cadenceno) - 1]
    depth = 1 - np.nanmedian(flux[eclipsed]) / np.nanmedian(flux[~eclipsed])
    assert depth == pytest.approx(0.3, rel=0.005)
    rest = np.diff(flux[~eclipsed])
    assert np.nanstd(rest) < 2e-3 * np.nanmedian(flux)


def test_a_star_alone_is_corrected_as_without_a_search(constant):
    sky, corrector = constant
    assert corrector.result.neighbors is None
    alone = corrected(sky, neighbors=[])
    np.testing.assert_array_equal(alone.corrected_lc.flux.value, corrector.corrected_lc.flux.value)


def test_transits_are_not_diluted():
    """The difference of two files with the same noise is the transit, of the star's own flux."""
    sky = make_sky("k2-1x-neighbor-close", 13, n_cadences=250)
    dimming = np.where(np.abs(np.arange(250) % 125 - 70) < 6, 0.02, 0.0)
    tpf = sky.to_tpf()
    rows = np.isin(np.asarray(tpf.hdu[1].data["CADENCENO"]), sky.cadenceno)
    light = np.zeros(tpf.hdu[1].data["FLUX"].shape)
    light[rows] = np.nan_to_num(sky.star_light) * dimming[:, None, None]
    curves = [corrected(sky).corrected_lc]
    tpf.hdu[1].data["FLUX"][:] -= light.astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        corrector = PLDCorrector(tpf)
        curves.append(corrector.correct())
    keep = np.isin(sky.cadenceno, np.asarray(corrector.tpf.cadenceno))
    change = curves[0].flux.value - curves[1].flux.value
    own = np.nanmedian(sky.star_light[:, corrector.aperture_mask].sum(axis=1))
    inside = dimming[keep] > 0
    depth = np.nanmedian(change[inside]) - np.nanmedian(change[~inside])
    assert depth / own == pytest.approx(0.02, rel=0.04)


def test_a_sloping_background_is_no_neighbor():
    sky = make_sky("k2-1x-background", 2015, n_cadences=1500)
    corrector = corrected(sky)
    assert corrector.result.neighbors is None
    assert score(corrector.corrected_lc, sky).amplitude == pytest.approx(1, abs=0.005)


def test_a_ghost_in_masked_cadences_is_no_neighbor(constant):
    sky, corrector = constant
    tpf = sky.to_tpf()
    mask = np.ones(len(tpf.time), dtype=bool)
    mask[150:220] = False
    rows, columns = np.indices(tpf.shape[1:])
    y, x = (np.median(v) for v in (sky.y, sky.x))
    ghost = 3e4 * np.exp(-((rows - y - 2) ** 2) - (columns - x + 3) ** 2)
    tpf.hdu[1].data["FLUX"][np.flatnonzero(tpf.quality_mask)[~mask]] += ghost.astype(np.float32)
    again = PLDCorrector(tpf, corrector.aperture_mask)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DetrendingWarning)
        again.correct(cadence_mask=mask)
    assert again.result.neighbors is None


def test_given_neighbors_are_where_they_are_given(neighbor, tmp_path):
    """In pixels, and on the sky by lightkurve's own reading of the file's coordinates."""
    sky, corrector = neighbor
    tpf, found = sky.to_tpf(), corrector.result.neighbors
    place = np.array([[found["x"][0].value, found["y"][0].value]])
    middle = np.nanmedian(corrector.result.positions, axis=0)
    target = SkyCoord(tpf.ra, tpf.dec, unit="deg")
    other = tpf.wcs.pixel_to_world(*(tpf.wcs.world_to_pixel(target) + place[0] - middle))
    path, table = tmp_path / "stars.csv", Table(place, names=("x", "y"))
    table.write(path)
    for given in (place, table, table.to_pandas(), path, str(path)):
        np.testing.assert_allclose(PLDCorrector(tpf, neighbors=given)._neighbors, place, atol=1e-6)
    on_sky = (
        other,
        SkyCoord([other]).galactic,
        Table({"ra": [other.ra.deg], "dec": [other.dec.deg]}),
        QTable({"RA": [other.ra.hourangle] * u.hourangle, "Dec": [other.dec.deg] * u.deg}),
    )
    first, *others = (PLDCorrector(tpf, neighbors=given)._neighbors for given in on_sky)
    np.testing.assert_allclose(others, [first] * 3, atol=0.01)
    np.testing.assert_allclose(first, place, atol=0.3)  # where the fit begins
    again = corrected(sky, neighbors=other).result.neighbors
    np.testing.assert_allclose([again[k][0].value for k in "xy"], place[0], atol=0.15)
    truth = np.nanmean(sky.neighbor_light, axis=0).sum()
    assert again["flux"][0].value == pytest.approx(truth, rel=0.1)
    with pytest.raises(ValueError, match="must not hold the target itself"):
        PLDCorrector(tpf, neighbors=target)


def test_neighbors_that_cannot_matter_warn(constant):
    with pytest.warns(DetrendingWarning, match="1 of `neighbors` are far outside"):
        PLDCorrector(constant[0].to_tpf(), neighbors=[[3.0, 1.0], [40.0, 2.0]])


def test_coordinates_of_a_real_file(shared_data):
    name = "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz"
    series = read_pixels(shared_data / name)
    image = np.nanmedian(series.flux, axis=0)
    rows, columns = np.indices(image.shape)
    center = [np.sum(image * k) / image.sum() for k in (columns, rows)]
    np.testing.assert_allclose(target_place(series), center, atol=0.5)


def test_neighbors_of_full_pixels_stay_with_a_warning():
    sky = make_sky("k2-1x-kp10-saturated", 1, n_cadences=100)
    tpf = sky.to_tpf()
    moving = np.zeros(tpf.shape)
    moving[:, :, 4:6] = 1.0
    corrector = PLDCorrector(tpf, moving, neighbors=[[2.0, 2.0]])
    with (
        warnings.catch_warnings(),
        pytest.warns(DetrendingWarning, match="the light of other stars stays in the flux"),
    ):
        corrector.correct()
    assert corrector.result.neighbors is None


@pytest.mark.parametrize("apart", [True, False])
def test_a_neighbor_with_a_peak_beside_a_full_star_is_a_warning(apart):
    neighbors = ((1.0, 4.0, 0.0),) if apart else ()
    regime = SkyRegime("full", mission="K2", magnitude=10.5, neighbors=neighbors)
    corrector = PLDCorrector(make_sky(regime, 3, n_cadences=300).to_tpf())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        corrector.correct()
    warned = any("the light of other stars stays" in str(w.message) for w in caught)
    assert warned == apart


def test_light_beside_full_pixels_is_taken_off():
    """Charge that has bled is no other star, nor constant."""
    regime = SkyRegime(
        "full", magnitude=10.0, shape=(15, 11), neighbors=((2.0, 2.0, 0.0),), star="rr_lyrae",
        period=0.55, amplitude=0.3,
    )  # fmt: skip
    sky = make_sky(regime, 2, n_cadences=250)
    corrector = corrected(sky)
    share = true_share(sky, corrector)
    assert share < 0.9
    assert 1 - corrector.result.contamination == pytest.approx(share, abs=0.01)
    assert score(corrector.corrected_lc, sky).amplitude == pytest.approx(1, abs=0.01)


def test_no_neighbors_are_no_warning():
    sky = make_sky("k2-1x-kp10-saturated", 1, n_cadences=100)
    corrector = PLDCorrector(sky.to_tpf(), neighbors=[])
    corrector.correct()
    assert corrector.result.neighbors is None


@pytest.mark.parametrize(
    ("neighbors", "match"),
    [
        ([[1.0, 2.0, 3.0]], r"`neighbors` must be finite positions of shape \(k, 2\)"),
        ([[np.nan, 2.0]], "`neighbors` must be finite"),
        ("all", "`neighbors` must be \"find\", .* or the file of a table, got 'all'"),
        (Table({"a": [1.0]}), "`neighbors` must have the columns x and y"),
    ],
)
def test_bad_neighbors(constant, neighbors, match):
    with pytest.raises(ValueError, match=match):
        PLDCorrector(constant[0].to_tpf(), neighbors=neighbors)


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
@pytest.mark.parametrize(
    ("shape", "x", "y"), [((1, 9), 12, 0), ((3, 3), 1, 5), ((9, 9), 12, 4), ((5, 5), -3, 2)]
)
def test_stars_off_the_stamp(shape, x, y):
    """Refused, or with a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostLightWarning)
        observation = simulate(
            Star(12, x, y), Detector.k2(shape=shape), Motion.k2_roll(120, seed=1), seed=1
        )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            PLDCorrector(observation.to_tpf()).correct()
        except ValueError as error:
            assert "no pixel of `tpf` is above its noise" in str(error)  # noqa: PT017
            return
    assert any("without a positive flux are left out" in str(w.message) for w in caught)


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.DetrendingWarning")
def test_memory_of_fast_cadences_with_a_gap_of_300_days(fake_star):
    tpf = fake_star(90, 12, 1).tpf
    time = 2144.0 + np.arange(90) / 1440
    time[45:] += 300
    tpf.hdu[1].data["TIME"][:] = time
    tracemalloc.start()
    PLDCorrector(tpf).correct()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e8


def test_a_star_off_the_stamp_may_have_no_light():
    """All light is far from it, and none of a star at its place: no warning of a division."""
    image = np.zeros((6, 6))
    image[5], image[:3] = 10.0, -1.0
    light, places, misfit = _source._fit(image, [[2.6, -2.6]])
    assert not light.any()
    assert places.tolist() == [[2.6, -2.6]]
    assert np.isfinite(misfit).all()


def test_the_star_whose_profile_is_learned_stays_at_the_stamp():
    """It has no other pixels to show the profile; without a limit it left by 4 px."""
    rows, columns = np.indices((9, 4))
    stars = (-0.3, 7.8, 6.0, 0.8), (1.4, 1.9, 4.0, 0.85), (0.3, 4.3, 0.8, 0.85)
    image = sum(
        flux * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / sigma**2)
        for x, y, flux, sigma in stars
    )
    _, places, _ = _source._fit(image, [[0.0, 8.0], [1.0, 2.0]])
    assert np.hypot(*(places[0] - stars[0][:2])) < 1.5
    assert places[1] == pytest.approx(stars[1][:2], abs=1.0)
