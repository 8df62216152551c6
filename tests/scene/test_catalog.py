"""Scenes of catalogs, and stars with places on the sky."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import MaskedColumn, Table
from astropy.time import Time
from astropy.wcs import WCS

from scope_models import Detector, Motion, Scene, Star, read_scene, simulate
from scope_models.exceptions import CatalogWarning
from scope_models.models import BivariateGaussianPSF, PRFGrid, TabulatedPRF
from scope_models.scene.catalog import star_counts

COORD = SkyCoord(150.0, 10.0, unit="deg")
K2 = Detector.k2(shape=(31, 41))
MOTION = Motion.still(4)
CARDS = {
    "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 150.003, "CRVAL2": 10.002, "CRPIX1": 12.3,
    "CRPIX2": 4.5, "CUNIT1": "deg", "CUNIT2": "deg",
}  # fmt: skip


def sky(angle, *, mirrored, scale=4.02 / 3600):
    """World coordinates with rows that point to a position angle."""
    sine, cosine = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    side = -1 if mirrored else 1
    matrix = scale * np.array([[-side * cosine, sine], [side * sine, cosine]])
    cards = {f"CD{i + 1}_{j + 1}": matrix[i, j] for i in range(2) for j in range(2)}
    return WCS(fits.Header(CARDS | cards))


def field(n, width, seed=1, **columns):
    """A catalog with a target at COORD and other stars in a square of some degrees."""
    offsets = (np.random.default_rng(seed).random((2, n)) - 0.5) * width
    offsets[:, 0] = 0
    places = COORD.spherical_offsets_by(*(offsets * u.deg))
    mags = np.random.default_rng(seed).uniform(12, 17, n)
    return Table({"ra": places.ra, "dec": places.dec, "mag": mags} | columns), places


@pytest.mark.parametrize("orientation", [0.0, 123.0])
def test_the_file_has_the_places_of_the_stars(orientation, tmp_path, request):
    lightkurve = pytest.importorskip("lightkurve")
    table, places = field(40, 0.02)
    scene = Scene.from_catalog(table, COORD, K2, MOTION, orientation=orientation, seed=1)
    path = simulate(scene).write(tmp_path / "field.fits")
    tpf = lightkurve.read(path)
    request.addfinalizer(tpf.hdu.close)
    x, y = tpf.wcs.world_to_pixel(places)
    inside = (np.abs(x - 20) < 20) & (np.abs(y - 15) < 15)
    assert 20 < inside.sum() <= len(scene.stars)
    for place in np.column_stack([x, y])[inside]:
        assert np.hypot(*(scene.positions - place).T).min() < 0.01
    # Against the projection by hand: rows point to the position angle
    ahead = scene.wcs.pixel_to_world(20, 16)
    assert COORD.position_angle(ahead).wrap_at("180d").deg == pytest.approx(orientation, abs=1e-3)
    beside = scene.wcs.pixel_to_world(21, 15)
    turned = COORD.position_angle(beside) - COORD.position_angle(ahead)
    assert turned.wrap_at("180d").deg == pytest.approx(-90, abs=1e-3)
    assert read_scene(path) == scene


@pytest.mark.parametrize(("angle", "mirrored"), [(20.0, False), (-110.0, True)])
def test_world_coordinates_of_a_file(angle, mirrored, tmp_path):
    wcs = sky(angle, mirrored=mirrored)
    table, _ = field(60, 0.03)
    scene = Scene.from_catalog(table, COORD, K2, MOTION, wcs=wcs, target=Star(11.0), seed=1)
    np.testing.assert_allclose(scene.positions[0], wcs.world_to_pixel(COORD), atol=1e-6)
    assert scene.stars[0].mag == 11.0
    x, y = np.mgrid[0:41:10, 0:31:10]
    distance = scene.wcs.pixel_to_world(x, y).separation(wcs.pixel_to_world(x, y))
    assert distance.arcsec.max() < 0.01 * 4
    assert scene.detector.pixel_scale == pytest.approx(4.02, rel=1e-4)
    assert read_scene(scene.write(tmp_path / "scene.fits")) == scene


def test_world_coordinates_of_real_files(shared_data):
    from scope_models.io import read_pixels
    from scope_models.io.pixels import _wcs

    for name in ("k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz", "tess_tpf/tesssip_tpf1.fits"):
        series = read_pixels(shared_data / name)
        wcs = _wcs(series)
        coord = SkyCoord(series.header["RA_OBJ"], series.header["DEC_OBJ"], unit="deg")
        detector = Detector.from_tpf(shared_data / name)
        scene = Scene.from_catalog(None, coord, detector, MOTION, wcs=wcs, target=Star(12.0))
        ny, nx = detector.shape
        x, y = np.mgrid[0:nx, 0:ny]
        distance = scene.wcs.pixel_to_world(x, y).separation(wcs.pixel_to_world(x, y))
        assert distance.arcsec.max() < 0.01 * detector.pixel_scale


def test_proper_motions_move_the_stars():
    motion = Motion.still(3, start=3000.0)  # BKJD: 2017
    year = 2000 + (2454833 + motion.time[1] - 2451545) / 365.25
    columns = {"pmra": [0, 500, np.nan], "pmdec": [0, -200, np.nan], "ref_epoch": [2000.0] * 3}
    table, places = field(3, 0.008, **columns)
    scene = Scene.from_catalog(table, COORD, K2, motion)
    moved = SkyCoord(
        places[1].ra,
        places[1].dec,
        pm_ra_cosdec=0.5 * u.arcsec / u.yr, pm_dec=-0.2 * u.arcsec / u.yr,
        obstime=Time(2000, format="jyear"), distance=10 * u.pc,
    ).apply_space_motion(Time(year, format="jyear"))  # fmt: skip
    expected = scene.wcs.world_to_pixel(moved)
    np.testing.assert_allclose(scene.positions[1], expected, atol=2e-3)
    np.testing.assert_allclose(scene.positions[2], scene.wcs.world_to_pixel(places[2]), atol=1e-6)
    del table["ref_epoch"]
    for epoch in (2000.0, 2000 * u.yr, Time(2000, format="jyear")):
        again = Scene.from_catalog(table, COORD, K2, motion, ref_epoch=epoch)
        np.testing.assert_allclose(again.positions, scene.positions)


def test_stars_outside_are_kept_if_their_light_falls_in():
    wide = K2.replace(shape=(11, 11), psf=BivariateGaussianPSF(1.0, 0, 0, 2.0, 2.0))
    base = Scene(Star(12.0), wide, MOTION, ra=150.0, dec=10.0)
    columns = {}
    for name, x, mag in (("near", -4, 12), ("faint", -4, 27), ("far", -30, 8), ("on", 2, 22)):
        place = base.wcs.pixel_to_world(x, 5)
        columns[name] = (place.ra.deg, place.dec.deg, mag)
    table = Table(rows=list(columns.values()), names=["ra", "dec", "mag"])
    scene = Scene.from_catalog(table, COORD, wide, MOTION, target=Star(12.0))
    np.testing.assert_allclose(scene.positions[1:, 0], [-4, 2], atol=1e-4)
    alone = simulate(scene.replace(stars=scene.stars[:1]), noise=False, seed=1).flux
    both = simulate(scene, noise=False, seed=1).flux
    assert (both - alone)[0, 5, 0] > 1.0
    shifted = Motion.from_arrays(MOTION.time, [0, 0, 0, 24.0], np.zeros(4))
    moving = Scene.from_catalog(table, COORD, wide, shifted, target=Star(12.0))
    assert {star.mag for star in moving.stars} == {12.0, 22.0, 27.0, 8.0}


def test_limits_and_missing_numbers():
    table, _ = field(50, 0.02)
    limited = Scene.from_catalog(table, COORD, K2, MOTION, magnitude_limit=14.5 * u.mag)
    assert max(star.mag for star in limited.stars[1:]) <= 14.5
    table["mag"] = MaskedColumn(table["mag"], mask=np.arange(50) == 3)
    table["ra"][4] = np.nan
    with pytest.warns(CatalogWarning, match="2 of 50 stars of the table have no place"):
        Scene.from_catalog(table, COORD, K2, MOTION)


def test_columns_of_known_catalogs():
    table, _ = field(5, 0.005)
    gaia = Table({"ra": table["ra"], "dec": table["dec"], "phot_g_mean_mag": table["mag"]})
    ours = Scene.from_catalog(table, COORD, K2, MOTION)
    assert Scene.from_catalog(gaia, COORD, K2, MOTION) == ours
    gaia["Kpmag"] = table["mag"] + 1
    assert Scene.from_catalog(gaia, COORD, K2, MOTION).stars[0].mag == ours.stars[0].mag + 1
    named = Scene.from_catalog(gaia, COORD, K2, MOTION, magnitude="phot_g_mean_mag")
    assert named == ours


def test_background_stars_follow_the_counts():
    pole = SkyCoord(0, 90, unit="deg", frame="galactic").icrs
    detector = Detector.tess(shape=(100, 100))
    motion = Motion.still(3, time_format="btjd", start=1400.0)
    found = []
    for seed in range(5):
        scene = Scene.from_catalog(
            None, pole, detector, motion, target=Star(10.0), background_stars=17.0, seed=seed
        )
        on = np.all(np.abs(scene.positions[1:] - 49.5) < 50, axis=1)
        found.append([star.mag for star, here in zip(scene.stars[1:], on, strict=True) if here])
    area = (100 * 21 / 3600) ** 2
    expected = area * (star_counts(17.0, pole) - star_counts(5.0, pole))
    assert np.mean([len(mags) for mags in found]) == pytest.approx(expected, rel=0.15)
    middle = np.median(np.concatenate(found))
    assert star_counts(middle, pole) == pytest.approx(star_counts(17.0, pole) / 2, rel=0.15)


def test_star_counts_against_the_tables_of_the_model():
    # Bahcall & Soneira (1980), table 6: about 15 % is the model's own accuracy.
    pole = SkyCoord(0, 90, unit="deg", frame="galactic")
    side = SkyCoord(90, 50, unit="deg", frame="galactic")
    assert np.all(np.diff(star_counts(np.arange(5, 25), pole)) > 0)
    assert star_counts(15.0, side) > star_counts(15.0, pole)
    plane = SkyCoord(90, 3, unit="deg", frame="galactic")
    assert star_counts(15.0, plane) == star_counts(
        15.0, SkyCoord(90, 20, unit="deg", frame="galactic")
    )


def test_psf_that_varies_over_the_field():
    table, _ = field(90, 0.1)

    def psf(column, _):
        return BivariateGaussianPSF(sigma_x=0.4 + column / 1000, sigma_y=0.5)

    scene = Scene.from_catalog(
        table, COORD, K2.replace(shape=(31, 101)), MOTION, psf=psf, column=100
    )
    widths = {float(star.psf.sigma_x.value) for star in scene.stars[1:]}
    assert widths == {0.4 + (100 + 32) / 1000, 0.4 + (100 + 96) / 1000}
    assert scene.stars[0].psf.sigma_x == 0.4 + 150 / 1000
    one = Scene.from_catalog(table, COORD, K2, MOTION, psf=BivariateGaussianPSF(sigma_x=0.7))
    assert one.detector.psf.sigma_x == 0.7


def test_prf_of_several_places(tmp_path):
    y, x = np.mgrid[-6:6.1:0.25, -6:6.1:0.25]
    tables = [
        TabulatedPRF(np.exp(-(x**2 + y**2) / 2 / s**2) / (2 * np.pi * s**2), 4) for s in (0.8, 1.2)
    ]
    grid = PRFGrid([(0, 0), (1000, 0)], tables)
    table, _ = field(6, 0.01)
    even, motion = K2.without_sensitivity(), Motion.k2_roll(20)
    scene = Scene.from_catalog(table, COORD, even, motion, psf=grid, column=480, row=0, seed=1)
    assert scene.stars[0].psf(0, 0) == pytest.approx(0.5 * tables[0](0, 0) + 0.5 * tables[1](0, 0))
    observation = simulate(scene)
    path = observation.write(tmp_path / "prf.fits")
    assert np.array_equal(simulate(read_scene(path)).flux, observation.flux)
    # Only the pixels that a table covers are computed, and none is missed.
    lone = simulate(scene.replace(stars=scene.stars[:1]), noise=False).model()[0]
    rows, columns = np.mgrid[:31, :41]
    at = scene.positions[0] + [scene.motion.x[0], scene.motion.y[0]]
    direct = scene.stars[0].psf(columns - at[0], rows - at[1])
    np.testing.assert_allclose(lone / lone.sum(), direct / direct.sum(), atol=2e-4)


def test_stars_with_coordinates(tmp_path):
    moving = SkyCoord(
        150.002, 10.003, unit="deg", pm_ra_cosdec=1000 * u.mas / u.yr, pm_dec=0 * u.mas / u.yr,
        obstime=Time(2000, format="jyear"),
    )  # fmt: skip
    stars = [Star(12.0, coord=COORD), Star(14.0, coord=moving), Star(15.0, 3.0, 4.0)]
    scene = Scene(stars, K2, MOTION, orientation=30.0, seed=1)
    assert (scene.ra, scene.dec) == (150.0, 10.0)
    x, y = scene.wcs.world_to_pixel(moving)
    shift = np.hypot(*(scene.positions[1] - [x, y]))
    assert shift == pytest.approx((2454833 + MOTION.time[0] - 2451545) / 365.25 / 3.98, rel=1e-2)
    np.testing.assert_array_equal(scene.positions[[0, 2]], [[20, 15], [3, 4]])
    path = simulate(scene).write(tmp_path / "coord.fits")
    assert read_scene(path) == scene
    assert read_scene(path).stars[1].coord.obstime.jyear == pytest.approx(2000)
    later = Scene(Star(12.0, coord=moving), K2, MOTION)
    later = later.replace(motion=Motion.still(4, start=9000.0))  # BKJD: 33.643 years after 2000
    assert (later.ra - 150.002) * 3600 == pytest.approx(33.643 / np.cos(np.radians(10)), rel=1e-3)
    turned = scene.replace(orientation=120.0)
    assert np.hypot(*(turned.positions[1] - [20, 15])) == pytest.approx(
        np.hypot(*(scene.positions[1] - [20, 15])), rel=1e-5
    )
    assert hash(Star(12.0, coord=COORD)) == hash(
        Star(12.0, coord=SkyCoord(150 * u.deg, 10 * u.deg))
    )


@pytest.mark.slow
def test_a_large_stamp_of_many_stars(tmp_path):
    table, _ = field(500, 100 * 3.98 / 3600)
    scene = Scene.from_catalog(
        table, COORD, Detector.k2(shape=(100, 100)), Motion.k2_roll(100), seed=1
    )
    assert len(scene.stars) == 500
    observation = simulate(scene)
    path = observation.write(tmp_path / "large.fits")
    assert read_scene(path) == scene
    assert observation.truth.x.shape == (500, 100)


def made(table=None, coord=COORD, **options):
    return Scene.from_catalog(table, coord, K2, MOTION, **options)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: made({"ra": [150.0], "mag": [12]}), "`table` must have a column dec, got ra, mag"),
        (lambda: made({"ra": [150.0], "dec": [10.0]}), "`table` must have a column kp or"),
        (lambda: made({"ra": [150.0], "dec": [100.0], "mag": [12]}), "declinations within -90"),
        (lambda: made({"ra": ["a"], "dec": [10.0], "mag": [12]}), r"`table\['ra'\]` must hold num"),
        (lambda: made({"ra": [40.0], "dec": [-20.0], "mag": [12]}), "no star within a pixel .* 11"),
        (lambda: made("stars.csv"), "`table` must be a Table or a mapping of columns, got str"),
        (made, "give the `target`"),
        (lambda: made(coord="150 10", target=Star(12)), "`coord` must be one SkyCoord"),
        (lambda: made(target=12.0), "`target` must be a Star"),
        (lambda: made(target=Star(12), background_stars=12 * u.s), "`background_stars` must be in"),
        (lambda: made(field(1, 0.01, pmra=[1.0], pmdec=[1.0])[0]), "`ref_epoch` must be given"),
        (lambda: made(coord=SkyCoord(40, 0, unit="deg"), target=Star(12),
                      wcs=sky(0, mirrored=False)), "`coord` is far from the field of `wcs`"),
        (lambda: Scene(Star(12), K2, MOTION, matrix=(1, 2)), "`matrix` must be four finite"),
        (lambda: Scene(Star(12), K2, MOTION, matrix=(1, 2, 2, 4)), "`matrix` must be invertible"),
        (lambda: Star(12, coord=SkyCoord([1, 2], [3, 4], unit="deg")), "`coord` must be one Sky"),
        (lambda: Star(12, coord=SkyCoord(1, 2, unit="deg", pm_ra_cosdec=1 * u.mas / u.yr,
                                         pm_dec=1 * u.mas / u.yr)), "must have an `obstime`"),
        (lambda: Star(12, coord=SkyCoord(1, 2, unit="deg", frame="altaz")), "must convert to ICRS"),
        (lambda: Scene(Star(12), K2, MOTION, dec=-91.0), "`dec` must be within -90 to 90, got -91"),
        (lambda: Scene([Star(12), Star(13, 1.0, coord=COORD)], K2, MOTION), "`coord` must not be"),
        (lambda: Scene(Star(12, coord=COORD), K2, MOTION, ra=3.0), "`ra` must not be given for a"),
    ],
)  # fmt: skip
def test_bad_input(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()
