"""Telescopes on the ground: atmosphere, night sky and the detector preset."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body
from astropy.time import Time
from astropy.utils import iers
from photutils.psf import MoffatPSF

from scope_models import BivariateGaussianPSF, Detector, Motion, Star, read_scene, simulate
from scope_models.effects import (
    Extinction,
    NightSky,
    Scintillation,
    Seeing,
    airmass,
    moon_geometry,
)
from scope_models.io import read_pixels
from scope_models.models import moffat_psf

# Some stamps are small, to be fast.
pytestmark = pytest.mark.filterwarnings("ignore:the star at .* loses up to")
PARANAL = EarthLocation.from_geodetic(-70.40, -24.63, 2635)
STAR = SkyCoord("01h00m00s -40d00m00s")
BARE = Detector.ground(effects=(), shape=(3, 3), interpixel_scatter=0.0, well_depth=None)


@pytest.mark.parametrize(
    ("aperture", "altitude", "exposure", "column"),
    [
        (0.5, 2200, 30, 1.0),
        (1.0, 2635, 60, 1.5),
        (2.2, 4200, 10, 1.2),
        (3.5, 2788, 60, 1.0),
        (8.2, 0, 1, 2.0),
    ],
)
def test_scintillation_has_the_variance_of_its_formula(aperture, altitude, exposure, column):
    effect = Scintillation(aperture, altitude, column)
    detector = BARE.replace(int_time=exposure)
    stars = [Star(12.0), Star(12.0, 1.2, 0.5)]
    truth = simulate(stars, detector, Motion.still(6000), seed=4, noise=False, effects=effect).truth
    factor = truth.columns["SCINTILLATION"]
    # Osborn et al. (2015), equation 7, from the zenith angle
    cosine = 1 / column
    expected = 1e-5 * 1.56**2 * aperture ** (-4 / 3) / exposure * cosine**-3
    expected *= np.exp(-2 * altitude / 8000)
    np.testing.assert_allclose(factor.var(axis=0), expected, rtol=0.07)
    np.testing.assert_allclose(factor.mean(axis=0), 1, atol=5 * np.sqrt(expected / 6000))
    assert abs(np.corrcoef(factor.T)[0, 1]) < 0.05
    assert effect.rms(exposure * u.s) ** 2 == pytest.approx(expected)


def test_scintillation_of_a_star_does_not_depend_on_the_others_or_the_length():
    def factors(stars, n):
        effect = Scintillation()
        observation = simulate(stars, BARE, Motion.still(n), seed=4, noise=False, effects=effect)
        return observation, observation.truth.columns["SCINTILLATION"]

    one, alone = factors([Star(12.0)], 50)
    _, both = factors([Star(12.0), Star(40.0)], 30)
    np.testing.assert_array_equal(alone[:30, 0], both[:, 0])
    light = one.model().sum(axis=(1, 2))
    np.testing.assert_allclose(light / light[0], alone[:, 0] / alone[0, 0], rtol=1e-9)


def test_extinction_is_recovered_from_the_airmass():
    column = np.linspace(1.0, 2.5, 40)
    effect = Extinction(0.23 * u.mag, column)
    scene = Star(11.0, signal=np.linspace(1, 1.1, 40)), BARE, Motion.still(40)
    observation = simulate(*scene, seed=1, noise=False, effects=effect)
    light = observation.model().sum(axis=(1, 2)) / np.linspace(1, 1.1, 40)
    slope, above = np.polyfit(column, -2.5 * np.log10(light), 1)
    assert slope == pytest.approx(0.23, abs=1e-9)
    plain = simulate(*scene, seed=1, noise=False).model()[0].sum()
    assert 10 ** (-0.4 * above) == pytest.approx(plain)
    np.testing.assert_array_equal(observation.truth.columns["AIRMASS"], column)
    np.testing.assert_array_equal(observation.flux_bkg, simulate(*scene, noise=False).flux_bkg)


def test_clouds_are_red_and_common_to_all_stars():
    effect = Extinction(0.0, scatter=0.1, correlation_time=0.05)
    motion = Motion.ground(4000, cadence=300.0)
    stars = [Star(12.0), Star(12.0, 0, 0)]
    truth = simulate(stars, BARE, motion, seed=3, noise=False, effects=effect).truth
    change = -2.5 * np.log10(truth.columns["EXTINCTION"])
    assert change.std() == pytest.approx(0.1, rel=0.1)
    near = np.diff(motion.time) < 0.01
    kept = np.mean(change[1:][near] * change[:-1][near]) / change.var()
    assert kept == pytest.approx(np.exp(-300 / 86400 / 0.05), abs=0.03)


def test_seeing_widens_the_image():
    column = np.array([1.0, 1.5, 2.0])
    detector = Detector.ground(effects=(), shape=(41, 41), interpixel_scatter=0.0, well_depth=None)
    scene = Star(10.0), detector, Motion.still(3)
    seeing = Seeing(0.1, airmass=column)
    observation = simulate(*scene, seed=2, noise=False, effects=seeing)
    width = observation.truth.columns["SEEING"]
    images = observation.model()
    x = np.arange(41) - 20
    variance = (images * x**2).sum(axis=(1, 2)) / images.sum(axis=(1, 2)) - 1 / 12
    own = sum(part.flux * part.sigma_x**2 for part in detector.psf)
    np.testing.assert_allclose(variance, own * width**2, rtol=2e-3)
    calm = simulate(*scene, effects=Seeing(0.0, airmass=column)).truth.columns["SEEING"]
    np.testing.assert_allclose(calm, column**0.6)
    long = Motion.ground(3000)
    noise = np.log(
        simulate(Star(12.0), BARE, long, seed=1, effects=Seeing(0.1)).truth.columns["SEEING"]
    )
    assert noise.std() == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("psf", [BivariateGaussianPSF(), BivariateGaussianPSF(rho=0.9)])
def test_light_of_any_seeing(psf):
    detector = Detector.ground(
        effects=(), psf=psf, shape=(9, 9), interpixel_scatter=0.0, well_depth=None
    )
    scene = Star(12.0, 4.2, 4.1), detector, Motion.still(300)
    observation = simulate(*scene, seed=1, noise=False, effects=Seeing(1.7))
    width = observation.truth.columns["SEEING"]
    light = observation.model() / detector.flux_from_mag(12.0)
    assert width.min() < 0.005
    assert width.max() > 60
    narrow, wide = width < 0.1, width > 20
    np.testing.assert_allclose(light[narrow, 4, 4], 1, atol=1e-3)
    density = psf(0, 0) / width[wide] ** 2
    np.testing.assert_allclose(light[wide, 4, 4], density, rtol=5e-3)
    with pytest.raises(ValueError, match=r"relative width of the PSF must be .* at least 0.001"):
        simulate(*scene, seed=1, effects=Seeing(7.0))


def test_a_narrow_star_that_moves_within_its_pixel():
    detector = BARE.replace(psf=BivariateGaussianPSF(sigma_x=1e-6, sigma_y=1e-6))
    motion = Motion(np.arange(300.0), np.linspace(-0.4, 0.4, 300), np.zeros(300))
    light = simulate(Star(12.0), detector, motion, noise=False).model()[:, 1, 1]
    np.testing.assert_allclose(light, detector.flux_from_mag(12.0), rtol=1e-12)


@pytest.mark.filterwarnings("ignore:overflow")
def test_light_that_is_not_finite():
    with pytest.raises(ValueError, match=r"the relative light that passes .* must be finite"):
        simulate(Star(12.0), BARE, Motion.still(9), seed=1, effects=Extinction(scatter=1e9))


@pytest.mark.parametrize("beta", [3.5, 4.765])
def test_moffat_psf_against_photutils(beta):
    psf, exact = moffat_psf(2.5 * u.pix, beta), MoffatPSF(alpha=1, beta=beta)
    exact.alpha = 2.5 / (2 * np.sqrt(2 ** (1 / beta) - 1))
    r = np.linspace(0, 3.75, 50)
    np.testing.assert_allclose(psf(r, 0 * r), exact(r, 0 * r), rtol=2e-2, atol=2e-6)
    r = np.linspace(0, 2.5, 50)
    np.testing.assert_allclose(psf(r, 0 * r), exact(r, 0 * r), rtol=3e-4)
    for radius, error in ((2.5, 1e-5), (7.5, 5e-3)):
        part = sum(c.flux * (1 - np.exp(-(radius**2) / (2 * c.sigma_x**2))) for c in psf)
        whole = 1 - (1 + (radius / exact.alpha) ** 2) ** (1 - beta)
        assert part == pytest.approx(whole, abs=error)


def test_airmass_against_astropy():
    time = 1400.5 + np.linspace(0, 0.2, 6)
    with iers.conf.set_temp("auto_download", False):
        times = Time(2457000, time, format="jd", scale="tdb")
        altitude = STAR.transform_to(AltAz(obstime=times, location=PARANAL)).alt.deg
        moon = get_body("moon", times, PARANAL)
        moon_altitude = moon.transform_to(AltAz(obstime=times, location=PARANAL)).alt.deg
        separation = moon.separation(STAR, origin_mismatch="ignore").deg
    zenith = np.radians(90 - altitude)
    np.testing.assert_allclose(airmass(times, STAR, PARANAL), 1 / np.cos(zenith), rtol=4e-3)
    found = moon_geometry(time, STAR, PARANAL)
    np.testing.assert_allclose(found["moon_altitude"], moon_altitude, atol=0.03)
    np.testing.assert_allclose(found["moon_separation"], separation, atol=0.03)


def test_phase_of_the_moon():
    # Full on 2018-09-25 at 2:52, new on 2018-10-09 at 3:47, last quarter on 2018-10-02 (UTC)
    dates = Time(["2018-09-25T02:52", "2018-10-09T03:47", "2018-10-02T09:45"])
    phase = moon_geometry(dates, STAR, PARANAL)["moon_phase"]
    assert phase[0] < 6
    assert phase[1] > 174
    assert phase[2] == pytest.approx(90, abs=1)


def test_moonlight_against_the_formula():
    night = NightSky(1.4, moon_altitude=35, moon_separation=50, moon_phase=20, extinction=0.172)
    detector = BARE.replace(background=10.0)
    scene = Star(30.0), detector, Motion.still(2)
    observation = simulate(*scene, noise=False, effects=night)
    # Krisciunas & Schaefer (1991), equations 1, 2, 3, 15, 20 and 21
    intensity = 10 ** (-0.4 * (3.84 + 0.026 * 20 + 4e-9 * 20**4))
    scattering = 10**5.36 * (1.06 + np.cos(np.radians(50)) ** 2) + 10 ** (6.15 - 50 / 40)
    path = (1 - 0.96 * np.sin(np.radians(55)) ** 2) ** -0.5
    moon = scattering * intensity * 10 ** (-0.4 * 0.172 * path) * (1 - 10 ** (-0.4 * 0.172 * 1.4))
    zenith = 34.08 * np.exp(20.7233 - 0.92104 * 21.6)
    dark = zenith * 10 ** (-0.4 * 0.172 * 0.4) * 1.4
    expected = 10 * (moon + dark) / zenith
    np.testing.assert_allclose(observation.flux_bkg, expected, rtol=1e-5)
    assert 5 < expected / 10 < 40  # the sky near the full Moon is two to four magnitudes brighter
    below = simulate(*scene, noise=False, effects=NightSky(moon_altitude=-1.0, moon_phase=0.0))
    np.testing.assert_allclose(below.flux_bkg, 10)


def test_detector_counts_the_photons_of_the_band():
    # About 1000 photons per s, cm2 and angstrom of V = 0; V is 890 angstrom wide.
    detector = Detector.ground(2.0, band="V", throughput=0.5)
    expected = 0.5 * 1000 * 890 * np.pi * 100**2
    assert detector.flux_from_mag(0.0) == pytest.approx(expected, rel=0.03)
    sky = Detector.ground(2.0, band="V", throughput=0.5, pixel_scale=0.8 * u.arcsec).background
    assert sky == pytest.approx(4 * detector.background)
    assert detector.background == pytest.approx(detector.flux_from_mag(21.6) * 0.4**2)
    assert Detector.ground(seeing=2.0).psf[0].sigma_x == 2 * Detector.ground().psf[0].sigma_x
    assert Detector.preset("ground") == Detector.ground()
    assert Detector.ground(100 * u.cm, 2.4 * u.km) == Detector.ground()


def test_lightkurve_opens_a_file_from_the_ground(tmp_path, request):
    lightkurve = pytest.importorskip("lightkurve")
    motion = Motion.ground(30, cadence=3600.0, night=5.0)
    detector = Detector.ground(airmass=np.linspace(1, 2, 30))
    observation = simulate(Star(12.0), detector, motion, seed=1)
    path = observation.write(tmp_path / "night.fits")
    tpf = lightkurve.read(path)
    request.addfinalizer(tpf.hdu.close)
    np.testing.assert_allclose(tpf.time.value, motion.time)
    assert np.diff(tpf.time.value).max() > 0.7  # the days between the nights
    np.testing.assert_array_equal(tpf.flux.value, observation.flux)
    assert len(tpf.to_lightcurve(aperture_mask="pipeline")) == 30
    series = read_pixels(path)
    assert (series.mission.name, series.header["TELESCOP"]) == ("Ground", "TESS")
    assert series.header["INSTRUME"] == "ground-based telescope"
    assert read_scene(path) == observation.scene
    np.testing.assert_array_equal(simulate(read_scene(path)).flux, observation.flux)


def test_extinction_is_not_light_outside_the_aperture():
    detector = Detector.ground(effects=(), interpixel_scatter=0.0)
    scene = Star(15.0), detector, Motion.still(20, time_format="btjd")
    plain, dim = (
        simulate(*scene, seed=1, effects=effects) for effects in ((), Extinction(0.5, airmass=2.0))
    )
    files = [each.to_tpf(aperture_mask=plain.aperture) for each in (plain, dim)]
    fractions = [tpf.hdu[1].header["FLFRCSAP"] for tpf in files]
    assert fractions[0] == pytest.approx(fractions[1], rel=1e-6)
    assert 0.7 < fractions[0] < 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Scintillation(-1.0), "`aperture` must be positive"),
        (lambda: Scintillation(1 * u.s), "`aperture` must be in m"),
        (lambda: Scintillation(airmass=0.5), "`airmass` must be 1 or more"),
        (lambda: Scintillation().rms(0.0), "`exposure` must be positive"),
        (lambda: Extinction(-0.1), "`coefficient` must not be negative"),
        (lambda: Extinction(airmass=[1, np.nan]), "`airmass` must be 1 or more"),
        (lambda: Extinction(correlation_time=0), "`correlation_time` must be positive"),
        (lambda: Seeing(scatter=np.inf), "`scatter` must be finite"),
        (lambda: NightSky(moon_altitude=100.0), "`moon_altitude` must be between -90 and 90"),
        (lambda: NightSky(moon_phase=np.nan), "`moon_phase` must be between 0 and 180"),
        (lambda: Detector.ground(band="K"), "`band` must be one of V, R, I"),
        (lambda: Detector.ground(0.0), "`aperture` must be positive"),
        (lambda: Detector.ground(effects=[1]), "`effects` must hold Effect objects"),
        (lambda: moffat_psf(2.0, 1.0), "`beta` must be above 1"),
        (lambda: airmass([1400.0], "star", PARANAL), "`coord` must be a SkyCoord"),
        (lambda: airmass([1400.0], SkyCoord(10, 60, unit="deg", frame="altaz"), PARANAL),
         "`coord` must be on the sky, as ICRS, or have obstime and location"),
        (lambda: airmass([1400.0], STAR, "here"), "`location` must be an EarthLocation"),
        (lambda: airmass([1400.0], STAR.directional_offset_by(0, 130 * u.deg), PARANAL),
         "`coord` must be above the horizon"),
        (lambda: simulate(Star(12.0), BARE, Motion.still(3), effects=Seeing(airmass=[1, 2])),
         "`airmass` must give one number for each of the 3 cadences, got 2"),
    ],
)  # fmt: skip
def test_bad_input(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()
