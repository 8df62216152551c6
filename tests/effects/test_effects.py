"""What all effects have in common, and each one against a truth of its own."""

import astropy.units as u
import numpy as np
import pytest

from scope_models import BivariateGaussianPSF, Detector, Motion, Scene, Star, read_scene, simulate
from scope_models.effects import Argabrightening, Background, Effect, Focus, ScatteredLight
from scope_models.io import read_truth
from scope_models.models import SensitivityPolynomial, TabulatedPRF

PLAIN = Detector.k2(shape=(15, 15), well_depth=None).without_sensitivity()
EFFECTS = {
    "focus": Focus(0.01, period=12 * u.hour, thermal=0.02, thermal_time=0.5, events=[2145.0]),
    "focus series": Focus(series=np.linspace(0.99, 1.01, 60)),
    "background": Background(50.0, drift=10.0, gradient=(0.01, -0.02), residual=0.1),
    "scattered light": ScatteredLight(gradient=(0.01, 0.0)),
    "argabrightening": Argabrightening(rate=5.0),
}


def scene(*effects, n=60, **fields):
    stars = [Star(12.0), Star(14.0, 7.0, 3.0)]
    return Scene(stars, Detector.k2(), Motion.k2_roll(n), seed=5, effects=effects, **fields)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_is_in_the_file(name, tmp_path):
    observation = simulate(scene(EFFECTS[name]))
    path = observation.write(tmp_path / "star.fits")
    assert read_truth(path) == observation.truth
    assert read_scene(path) == observation.scene == scene(EFFECTS[name])
    again = simulate(read_scene(path))
    for cube in ("flux", "flux_err", "flux_bkg", "raw_cnts", "quality"):
        assert np.array_equal(getattr(again, cube), getattr(observation, cube), equal_nan=True)
    assert not np.array_equal(observation.flux, simulate(scene()).flux)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_work_may_be_cut_anywhere(name):
    one, many = (simulate(scene(EFFECTS[name]), chunk_size=size) for size in (64, 16))
    for cube in ("flux", "flux_bkg", "raw_cnts"):
        assert np.array_equal(getattr(one, cube), getattr(many, cube), equal_nan=True)


@pytest.mark.parametrize("name", EFFECTS)
def test_switching_one_off_leaves_the_truth_of_the_others(name):
    others = [effect for other, effect in EFFECTS.items() if other != name]
    every = simulate(scene(EFFECTS[name], *others)).truth
    fewer = simulate(scene(*others)).truth
    added = set(every.columns) - set(fewer.columns)
    for column, values in fewer.columns.items():
        if column == "TARGET_SHARE":  # follows from all that the light meets
            continue
        same = [v for k, v in every.columns.items() if k.rstrip("_2") == column.rstrip("_2")]
        assert any(np.array_equal(values, v, equal_nan=True) for v in same), column
    assert len(added) == len(every.columns) - len(fewer.columns)


def test_focus_widens_the_image_and_keeps_the_flux():
    w = np.array([0.95, 1.0, 1.05, 1.3])
    psf = BivariateGaussianPSF(0.7, sigma_x=0.9, sigma_y=0.8, rho=0.3)
    psf += BivariateGaussianPSF(0.3, 0.4, 0.0, 1.1, 1.1)
    star = Star(12.0, psf=psf)
    model = simulate(star, PLAIN, Motion.still(4), noise=False, effects=Focus(series=w)).model()
    total = model.sum(axis=(1, 2))
    np.testing.assert_allclose(total, 1.74e5, rtol=1e-6)
    y, x = np.mgrid[:15, :15]
    mean = (model * x).sum(axis=(1, 2)) / total
    # The second component's offset grows with the width; the first stays at the star.
    np.testing.assert_allclose(mean, 7 + 0.3 * 0.4 * w, atol=1e-3)
    for q, variances in ((x, (0.9**2, 1.1**2)), (y, (0.8**2, 1.1**2))):
        centre = (model * q).sum(axis=(1, 2)) / total
        variance = (model * (q - centre[:, None, None]) ** 2).sum(axis=(1, 2)) / total
        own = 0.7 * variances[0] + 0.3 * variances[1] + (0.21 * 0.4**2 if q is x else 0.0)
        np.testing.assert_allclose(variance - 1 / 12, own * w**2, rtol=3e-3)


def test_focus_of_a_moffat_against_its_own_width():
    from photutils.psf import MoffatPSF

    detector = PLAIN.replace(sensitivity=SensitivityPolynomial((1, 0, -0.5)))
    psf = MoffatPSF(alpha=1.2, beta=3.0)
    focus = Focus(series=np.array([1.0, 1.1]))
    model = simulate(Star(12.0, psf=psf), detector, Motion.still(2), noise=False, effects=focus)
    wide = Star(12.0, psf=MoffatPSF(alpha=1.1 * 1.2, beta=3.0))
    alone = simulate(wide, detector, Motion.still(1), noise=False)
    np.testing.assert_allclose(model.model()[1], alone.model()[0], rtol=1e-8, atol=1e-6)


def test_focus_in_time():
    time = Motion.still(200).time
    width = simulate(scene(Focus(0.02, period=1.5, phase=0.25), n=200)).truth.columns["FOCUS"]
    spectrum = np.exp(2j * np.pi * time[:, None] / np.array([1.5, 0.4]))
    assert abs(2 * ((width - 1) @ spectrum[:, 0]).real / 200) > 0.01
    events = Focus(thermal=0.03, thermal_time=6 * u.hour, events=[time[50]])
    width = simulate(scene(events, n=200)).truth.columns["FOCUS"]
    assert np.all(width[:50] == 1)
    assert width[50] == pytest.approx(1.03)
    np.testing.assert_allclose(np.diff(np.log(width[50:] - 1)), -4 * (time[1] - time[0]))


def test_background_level_slope_and_residual():
    sky = Background(
        200.0, drift=20 * u.electron / u.s / u.day, gradient=(0.02, -0.01), residual=0.2
    )
    motion = Motion.still(101, cadence=0.1)
    star = Star(40.0)
    arguments = star, Detector.k2().without_sensitivity(), motion
    observation = simulate(*arguments, noise=False, effects=sky)
    y, x = np.mgrid[:11, :11]
    plane = 1 + 0.02 * (x - 5) - 0.01 * (y - 5)
    light = (200 + 20 * (motion.time - motion.time[50]))[:, None, None] * plane
    np.testing.assert_allclose(observation.flux_bkg, 284 + 0.8 * light, rtol=1e-6)
    np.testing.assert_allclose(observation.flux, 0.2 * light, rtol=1e-5, atol=1e-3)
    # Photon noise is that of all the light, what is left in and what is subtracted.
    noisy = simulate(*arguments, noise="background", effects=sky, seed=1)
    expected = np.sqrt((284 + light) / (270 * 6.019802903270))
    np.testing.assert_allclose(noisy.flux_err, expected, rtol=1e-5)
    scatter = (noisy.flux - observation.flux) / expected
    assert scatter.std() == pytest.approx(1, abs=4 / np.sqrt(2 * scatter.size))


def test_scattered_light_peaks_at_every_perigee():
    motion = Motion.still(280, cadence=0.1, start=1325.0, time_format="btjd")
    effect = ScatteredLight(1000.0, time_scale=12 * u.hour, perigee=1330.0)
    observation = simulate(Star(10.0), Detector.tess(), motion, effects=effect)
    light = observation.truth.columns["SCATTEREDLIGHT"]
    peaks = np.flatnonzero((light[1:-1] > light[:-2]) & (light[1:-1] > light[2:])) + 1
    np.testing.assert_allclose(motion.time[peaks], [1330.0, 1343.7], atol=0.051)
    near = np.abs(motion.time - 1330.0) < 3
    expected = 1000 * np.exp(-np.abs(motion.time[near] - 1330.0) / 0.5)
    np.testing.assert_allclose(light[near], expected, atol=1000 * np.exp(-13.7))
    assert light.min() >= 0


def test_flashes_have_their_rate_brightness_and_bit():
    effect = Argabrightening(rate=6.0, brightness=50.0)
    for detector, bit in ((Detector.k2(shape=(7, 7)), 64), (Detector.tess(shape=(7, 7)), 16)):
        observation = simulate(Star(20.0), detector, Motion.still(5000), effects=effect, seed=3)
        light = observation.truth.columns["ARGABRIGHTENING"]
        flash = light > 0
        probability = 1 - np.exp(-6 * detector.cadence_days)
        error = np.sqrt(probability * (1 - probability) / 5000)
        assert abs(flash.mean() - probability) < 4 * error
        assert light[flash].mean() == pytest.approx(50, abs=4 * 50 / np.sqrt(flash.sum()))
        assert np.array_equal(observation.quality, np.where(flash, bit, 0))
        assert not observation.motion.quality.any()


class Nothing(Effect):
    """An effect without parameters."""


@pytest.mark.parametrize(
    "make, error, message",
    [
        (lambda: Focus(series=[1.0, -1.0]), ValueError, "width of the PSF must be positive"),
        (lambda: Focus(series=[1.0]), ValueError, "one width for each of the 2 cadences, got 1"),
        (lambda: Focus(1.0), ValueError, "`amplitude` must be below 1, got 1"),
        (lambda: Focus(0.1, period=0), ValueError, "`period` must be positive"),
        (lambda: Focus(0.1, period=3 * u.m), ValueError, "`period` must be in d"),
        (lambda: Focus(series=[np.nan, 1]), ValueError, "`series` must be a finite"),
        (lambda: Background(-1.0), ValueError, "`level` must not be negative"),
        (lambda: Background(1.0, gradient=(1, 0)), ValueError, "`gradient` makes the light"),
        (lambda: Background(1.0, drift=-1e6), ValueError, "`drift` makes the background negative"),
        (lambda: Background(1.0 * u.m), ValueError, "`level` must be in"),
        (lambda: Argabrightening(rate=-1), ValueError, "`rate` must not be negative"),
        (lambda: ScatteredLight(orbit=0), ValueError, "`orbit` must be positive"),
        (lambda: "focus", TypeError, "`effects` must hold effects, got 'f'"),
        (lambda: 7, TypeError, "`effects` must be effects, got 7"),
    ],
)
def test_bad_effects(make, error, message):
    with pytest.raises(error, match=message):
        simulate(Star(12.0), Detector.k2(), Motion.still(2), effects=make())


def test_an_effect_that_changes_nothing():
    plain, same = simulate(scene()), simulate(scene(Nothing()))
    assert np.array_equal(plain.flux, same.flux)


def test_a_focus_of_tables_is_refused():
    from photutils.psf import ImagePSF

    y, x = np.mgrid[-4:5, -4:5]
    table = TabulatedPRF.from_photutils(ImagePSF(np.exp(-(x**2 + y**2) / 4) / (4 * np.pi)))
    detector = PLAIN.replace(psf=table)
    with pytest.raises(ValueError, match="the width of TabulatedPRF cannot change"):
        simulate(Star(12.0), detector, Motion.still(2), effects=Focus(0.1))
