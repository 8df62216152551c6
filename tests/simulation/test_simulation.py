"""The simulator against quadrature, moments, and checks of seeds, speed and memory."""

import tracemalloc

import numpy as np
import pytest
from astropy.modeling.models import Const1D, Const2D
from photutils.psf import MoffatPSF
from scipy.integrate import dblquad
from scipy.stats import norm

from scope_models import Detector, Motion, Scene, Star, simulate
from scope_models.effects import BrighterFatter, DarkCurrent
from scope_models.effects._noise import NOISE_TERMS
from scope_models.exceptions import LostLightWarning, ScopeModelsWarning
from scope_models.models import BivariateGaussianPSF, SensitivityPolynomial, moffat_psf
from scope_models.models._series import ImageSeries

PLAIN = Detector.k2(well_depth=None).without_sensitivity()


def ramp(n, slope_x=0.01, slope_y=0.0):
    """Return a motion along a straight line, one pixel step per cadence."""
    steps = np.arange(n)
    return Motion(time=0.0204 * steps, x=slope_x * steps, y=slope_y * steps)


def test_expected_flux_against_quadrature():
    sigma_x, sigma_y, rho = 0.6, 0.45, 0.4
    response = np.random.default_rng(1).uniform(0.9, 1.1, (7, 9))
    detector = Detector.k2(shape=(7, 9), interpixel=response)
    star = Star(12.0, 4.2, 2.9, BivariateGaussianPSF(1, 0, 0, sigma_x, sigma_y, rho))
    motion = Motion(time=[0.0, 1.0], x=[0.0, 0.3], y=[0.0, -0.2])
    model = simulate(star, detector, motion, noise=False).model()

    def density(y, x, x_0, y_0, column, row):
        z_x, z_y = (x - x_0) / sigma_x, (y - y_0) / sigma_y
        value = np.exp(-(z_x**2 - 2 * rho * z_x * z_y + z_y**2) / (2 * (1 - rho**2)))
        value /= 2 * np.pi * sigma_x * sigma_y * np.sqrt(1 - rho**2)
        return value * (1 - 0.05 * (x - column) ** 2) * (1 - 0.05 * (y - row) ** 2)

    for cadence, (x_0, y_0) in enumerate([(4.2, 2.9), (4.5, 2.7)]):
        for row, column in [(3, 4), (2, 5), (4, 2)]:
            edges = (column - 0.5, column + 0.5, row - 0.5, row + 0.5)
            exact = dblquad(density, *edges, args=(x_0, y_0, column, row), epsabs=1e-12)[0]
            exact *= 1.74e5 * response[row, column]
            assert model[cadence, row, column] == pytest.approx(exact, abs=1e-9 * 1.74e5)


def test_centroid_and_width():
    detector = PLAIN.replace(shape=(15, 15))
    psf = BivariateGaussianPSF(sigma_x=0.7, sigma_y=0.9)
    star = Star(12.0, 7.2, 6.6, psf)
    observation = simulate(star, detector, ramp(50, 0.01, -0.02), noise=False)
    model, truth = observation.model(), observation.truth
    y, x = np.mgrid[:15, :15]
    total = model.sum(axis=(1, 2))
    np.testing.assert_allclose(total, 1.74e5, rtol=1e-9)
    # The centroid of pixels is that of the light but for terms in exp(-2 (pi sigma)^2) < 1e-4.
    mean_x, mean_y = ((model * q).sum(axis=(1, 2)) / total for q in (x, y))
    np.testing.assert_allclose(mean_x, truth.x[0], atol=1e-4)
    np.testing.assert_allclose(mean_y, truth.y[0], atol=1e-4)
    # A pixel adds the variance of a box, 1/12.
    variance = (model * (x - mean_x[:, None, None]) ** 2).sum(axis=(1, 2)) / total
    np.testing.assert_allclose(variance, 0.7**2 + 1 / 12, rtol=2e-3)


def test_default_position_is_the_centre():
    model = simulate(Star(12.0), PLAIN.replace(shape=(6, 9)), Motion.still(1), noise=False).model()
    np.testing.assert_allclose(model, model[:, ::-1, ::-1], rtol=1e-9, atol=1e-9)


def test_stars_add_up():
    stars = [Star(12.0), Star(14.0, 8.0, 2.0), Star(11.0, 2.2, 7.9, signal=Const1D(0.5))]
    motion = Motion.k2_roll(20)
    together = simulate(stars, PLAIN, motion, noise=False).model()
    alone = sum(simulate(star, PLAIN, motion, noise=False).model() for star in stars)
    np.testing.assert_allclose(together, alone, rtol=1e-13)


def test_light_curve_is_the_relative_flux():
    signal = 1 + 0.5 * np.sin(np.arange(40.0))
    observation = simulate(Star(12.0, signal=signal), PLAIN, ramp(40), noise=False)
    light_curve = observation.flux.sum(axis=(1, 2), dtype=float)
    np.testing.assert_allclose(light_curve, 1.74e5 * signal, rtol=1e-6)
    assert np.array_equal(observation.truth.relative_flux[0], signal)


def test_any_density_is_a_psf():
    moffat = MoffatPSF(flux=3.0, x_0=5.0, y_0=1.0, alpha=1.0, beta=3.0)
    detector = PLAIN.replace(shape=(61, 61))
    model = simulate(Star(12.0, psf=moffat), detector, Motion.still(1), noise=False).model()[0]
    # Beyond 30 px of a Moffat with beta = 3 lie about (1 + 900)^-2 of its light.
    assert model.sum() == pytest.approx(1.74e5, rel=3e-6)
    assert np.unravel_index(model.argmax(), model.shape) == (30, 30)


def test_positions_within_the_psf_are_relative():
    core, wings = BivariateGaussianPSF(3.0, 0.0, 0.0), BivariateGaussianPSF(1.0, 0.4, 0.0)
    detector = PLAIN.replace(psf=core + wings)
    model = simulate(Star(12.0), detector, Motion.still(1), noise=False).model()[0]
    shifted = detector.replace(
        psf=BivariateGaussianPSF(6.0, 9.0, 9.0) + BivariateGaussianPSF(2.0, 9.4, 9.0)
    )
    again = simulate(Star(12.0), shifted, Motion.still(1), noise=False).model()[0]
    assert model.sum() == pytest.approx(1.74e5, rel=1e-9)
    np.testing.assert_allclose(again, model, atol=1e-9 * 1.74e5)
    # The first component is at the star's position; a quarter of the light is 0.4 px beside it.
    x_mean = (model * np.arange(11)).sum() / model.sum()
    assert x_mean == pytest.approx(5.1, abs=1e-2)


def test_motion_within_a_cadence():
    # A straight line of 1 px per cadence: the image is smeared by a box, variance 1/12 px^2.
    detector = PLAIN.replace(shape=(9, 41))
    motion = Motion.still(21, cadence=detector.cadence_days)
    motion = Motion(time=motion.time, x=np.arange(-10.0, 11.0), y=np.zeros(21))
    psf = BivariateGaussianPSF(sigma_x=0.8, sigma_y=0.8)
    observation = simulate(Star(12.0, psf=psf), detector, motion, noise=False, n_sub=50)
    image = observation.model()[10]
    x = np.arange(41) - 20.0
    profile = image.sum(axis=0) / image.sum()
    assert (profile * x).sum() == pytest.approx(0, abs=1e-9)
    # 50 steps instead of a continuous line take 1/2500 off the box's variance.
    expected = 0.8**2 + 1 / 12 + (1 - 1 / 2500) / 12
    assert (profile * x**2).sum() == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(observation.truth.x[0, 1:-1], 20 + motion.x[1:-1], atol=1e-12)
    still = simulate(Star(12.0), PLAIN, Motion.still(3), noise=False)
    same = simulate(Star(12.0), PLAIN, Motion.still(3), noise=False, n_sub=4)
    np.testing.assert_allclose(same.model(), still.model(), rtol=1e-13)


@pytest.mark.parametrize("terms", [*NOISE_TERMS, ("photon", "background", "read"), NOISE_TERMS])
def test_mean_and_variance_of_noise(terms):
    n = 4000
    detector = Detector.k2(shape=(5, 5))
    observation = simulate(Star(11.3), detector, Motion.still(n), seed=2, noise=terms)
    deviation = (observation.flux - observation.model()).astype(float)
    # Single precision rounds the brightest pixels, 1e5 e-/s, by 0.005 e-/s.
    error = observation.flux_err.astype(float)
    lit = error[0] > 0.05
    assert lit.any()
    # 25 pixels; 4.5 standard errors of the mean, and of the variance of normal deviates. Counts
    # of a few electrons have a larger fourth moment, 3 + 1 / mean.
    mean = deviation.mean(axis=0)[lit] / (error[0][lit] / np.sqrt(n))
    assert np.abs(mean).max() < 4.5
    variance = deviation.var(axis=0)[lit] / error[0][lit] ** 2
    assert np.abs(variance - 1).max() < 4.5 * np.sqrt(2.1 / n)
    assert np.all(observation.flux_err == observation.flux_err[0])


def test_variances_are_those_of_the_terms():
    detector = Detector.k2()
    arguments = (Star(12.0), detector, Motion.still(1))
    errors = {
        term: simulate(*arguments, seed=1, noise=term).flux_err[0].astype(float)
        for term in NOISE_TERMS
    }
    exposure = 270 * 6.019802903270
    model = simulate(*arguments, seed=1).model()[0]
    response = detector.interpixel_map(1)
    np.testing.assert_allclose(errors["photon"], np.sqrt(model / exposure), rtol=1e-6, atol=4e-8)
    expected = np.sqrt(284 * response / exposure)
    np.testing.assert_allclose(errors["background"], expected, rtol=1e-6)
    np.testing.assert_allclose(errors["read"], np.sqrt(270) * 90 / exposure, rtol=1e-6)
    expected = np.sqrt(270 / 12) * 110 / exposure
    np.testing.assert_allclose(errors["quantization"], expected, rtol=1e-6)
    every = simulate(*arguments, seed=1, noise=NOISE_TERMS).flux_err[0]
    np.testing.assert_allclose(every**2, sum(e**2 for e in errors.values()), rtol=1e-6)
    # Without noise, only the rounding to single precision is left.
    quiet = simulate(*arguments, seed=1, noise=False)
    rounding = np.abs(quiet.flux - quiet.model())
    assert np.all(quiet.flux_err > 0)
    assert np.all(rounding < 2 * quiet.flux_err)


def test_background_is_subtracted_and_reported():
    observation = simulate(Star(30.0), Detector.k2(), Motion.still(2000), seed=5)
    response = observation.truth.interpixel
    np.testing.assert_allclose(observation.flux_bkg[7], 284 * response, rtol=1e-6)
    mean = observation.flux.mean(axis=(0, 1, 2), dtype=float)
    assert abs(mean) < 4.5 * observation.flux_err.mean() / np.sqrt(observation.flux.size)
    assert not observation.flux_bkg_err.any()
    assert observation.flux_bkg_err.shape == observation.flux.shape


@pytest.mark.parametrize("noise", [False, True, NOISE_TERMS])
@pytest.mark.parametrize("detector", [Detector.k2(), Detector.tess()], ids=["k2", "tess"])
def test_raw_counts_belong_to_the_flux(detector, noise):
    observation = simulate(Star(10.0), detector, Motion.still(20), seed=4, noise=noise)
    per_count = detector.gain / detector.exposure_time
    raw = (observation.raw_cnts - detector.fixed_offset) * per_count - observation.flux_bkg
    # Half a count, and single precision.
    tolerance = 0.01 if "quantization" in observation.truth.noise else 0.5 * per_count + 0.01
    assert observation.raw_cnts.dtype == np.int32
    np.testing.assert_allclose(raw, observation.flux, atol=tolerance)


def test_same_seed_same_pixels_however_the_work_is_done():
    motion = 5 * Motion.k2_roll(300)
    stars = [Star(10.0), Star(13.0, 6.0, 4.0, BivariateGaussianPSF(sigma_x=0.8, rho=0.5))]
    reference = simulate(stars, Detector.k2(), motion, seed=9)
    for chunk_size in (1, 7, 64, 299, 1000):
        again = simulate(stars, Detector.k2(), motion, seed=9, chunk_size=chunk_size)
        for name in ("flux", "flux_err", "raw_cnts"):
            assert np.array_equal(getattr(again, name), getattr(reference, name)), chunk_size
    for n in (1, 63, 100, 271):
        shorter = simulate(stars, Detector.k2(), motion[:n], seed=9)
        assert np.array_equal(shorter.flux, reference.flux[:n])
    other = simulate(stars, Detector.k2(), motion, seed=10)
    assert not np.array_equal(other.flux, reference.flux)


@pytest.mark.parametrize("term", NOISE_TERMS[:3])
def test_switching_terms_leaves_the_others(term):
    arguments = ([Star(12.0)], Detector.k2(), Motion.k2_roll(10))
    others = set(NOISE_TERMS[:3]) - {term}
    without = simulate(*arguments, seed=3, noise=others)
    alone = simulate(*arguments, seed=3, noise=term)
    every = simulate(*arguments, seed=3, noise=True)
    sums = without.flux.astype(float) + alone.flux - alone.model()
    # Single precision of 1e5 e-/s.
    np.testing.assert_allclose(every.flux, sums, atol=0.05)


def test_transit_changes_only_its_star():
    transit = np.ones(50)
    transit[20:30] = 0.99
    neighbor = Star(12.0, 9.0, 9.0, BivariateGaussianPSF(sigma_x=0.3, sigma_y=0.3))
    target = neighbor.replace(x_0=2.0, y_0=2.0)
    motion = Motion.still(50)
    flat = simulate([target, neighbor], Detector.k2(), motion, seed=1)
    deep = simulate([target.replace(signal=transit), neighbor], Detector.k2(), motion, seed=1)
    changed = np.any(flat.flux != deep.flux, axis=0)
    assert changed[2, 2]
    assert not changed[6:, :].any()
    assert not changed[:, 6:].any()
    assert np.array_equal(np.flatnonzero((flat.flux != deep.flux)[:, 2, 2]), np.arange(20, 30))


def test_no_seed_is_recorded_and_new():
    arguments = (Star(12.0), Detector.k2(), Motion.still(5))
    first, second = simulate(*arguments), simulate(*arguments)
    assert first.truth.seed != second.truth.seed
    again = simulate(*arguments, seed=first.truth.seed)
    assert np.array_equal(again.flux, first.flux)
    assert np.array_equal(again.truth.interpixel, first.truth.interpixel)


def test_saturated_charge_is_conserved_in_its_columns():
    detector = PLAIN.replace(shape=(101, 11), well_depth=1.08e6)
    motion = Motion.k2_roll(30)
    stars = [Star(8.5), Star(13.0, 1.0, 50.0)]
    bled = simulate(stars, detector, motion, noise=False).model()
    free = simulate(stars, PLAIN.replace(shape=(101, 11)), motion, noise=False).model()
    depth = (1.08e6 / detector.int_time) - 284
    assert free.max() > 5 * depth
    assert bled.max() == pytest.approx(depth, rel=1e-12)
    np.testing.assert_allclose(bled.sum(axis=1), free.sum(axis=1), rtol=1e-12)
    # Columns of the faint star are as they were.
    assert np.array_equal(bled[:, :, :2], free[:, :, :2])
    still = simulate(stars[0], detector, Motion.still(1), noise=False).model()[0]
    np.testing.assert_allclose(still, still[::-1], rtol=0, atol=1e-9 * depth)


@pytest.mark.parametrize("mag", [8.5, 9.5])
def test_the_aperture_of_a_saturated_star_holds_what_bleeds(mag):
    detector = Detector.k2(shape=(61, 11), interpixel_scatter=0.0)
    stars = [Star(mag, 3.0, 30.0), Star(mag, 8.0, 30.0)]  # the other one bleeds as much
    observation = simulate(stars, detector, Motion.k2_roll(40), seed=1)
    bled = simulate(stars[0], detector, Motion.k2_roll(40), noise=False).model().mean(axis=0)
    inside = observation.aperture
    full = bled > 0.99 * bled.max()
    assert full[:, 3].sum() > 4
    assert inside[full].all()
    assert bled[inside].sum() > 0.99 * bled.sum()
    assert not inside[:, 8].any()


def test_saturated_pixels_do_not_depend_on_the_chunks():
    arguments = (Star(11.0), Detector.k2(), 5 * Motion.k2_roll(100))
    one, many = (simulate(*arguments, seed=1, chunk_size=size) for size in (100, 3))
    saturated = one.model().max(axis=(1, 2)) > 0.999 * (1.08e6 / 6.02 - 284)
    assert 10 < saturated.sum() < 90
    assert np.array_equal(one.flux, many.flux)


@pytest.mark.parametrize(
    "x_0, y_0, lost", [(-0.5, 5.0, 0.5), (5.0, 10.5, 0.5), (-30.0, 5.0, 1.0), (0.0, 5.0, None)]
)
def test_lost_light_is_a_warning(x_0, y_0, lost):
    expected = norm.cdf(-0.5, scale=0.5) if lost is None else lost
    with pytest.warns(LostLightWarning, match=f"loses up to {100 * expected:.1f} % of its light"):
        observation = simulate(Star(12.0, x_0, y_0), PLAIN, Motion.still(5), noise=False)
    assert observation.truth.lost_fraction[0] == pytest.approx(expected, abs=1e-9)
    total = observation.model()[0].sum() / 1.74e5
    assert total == pytest.approx(1 - expected, abs=1e-9)
    assert issubclass(LostLightWarning, ScopeModelsWarning)


def test_lost_light_of_a_star_that_moves_off():
    with pytest.warns(LostLightWarning, match=r"x_0 = 5, y_0 = 5 loses up to 97\.7 %"):
        observation = simulate(Star(12.0), PLAIN, ramp(14, 0.5), noise=False)
    assert observation.truth.lost_fraction[0] == pytest.approx(norm.cdf(2), abs=1e-9)


def test_charge_that_bleeds_off_the_stamp_is_a_warning():
    star, motion = Star(7.0), Motion.still(3)
    wells = PLAIN.replace(well_depth=1e5)
    with pytest.warns(LostLightWarning, match=r"up to \d+\.\d % of the charge") as record:
        observation = simulate(star, wells, motion, noise=False)
    kept = observation.model().sum(axis=(1, 2)).min()
    whole = simulate(star, PLAIN, motion, noise=False).model().sum(axis=(1, 2)).max()
    assert f"up to {100 * (1 - kept / whole):.1f} %" in str(record[0].message)


def test_model_is_kept_or_computed():
    arguments = ([Star(10.0), Star(13.0, 3.0, 3.0)], Detector.k2(), Motion.k2_roll(300))
    kept = simulate(*arguments, seed=1, keep_model=True)
    assert simulate(*arguments, seed=1).truth.model is None
    assert kept.model() is kept.truth.model
    assert np.array_equal(kept.truth.model, simulate(*arguments, seed=1).model())


def test_truth():
    motion = Motion.k2_roll(30)
    stars = [Star(12.0), Star(14.5, 3.0, 7.0)]
    truth = simulate(stars, Detector.k2(), motion, seed=6, noise="read", n_sub=1).truth
    np.testing.assert_allclose(truth.x, [5 + motion.x, 3 + motion.x], rtol=1e-15)
    np.testing.assert_allclose(truth.y, [5 + motion.y, 7 + motion.y], rtol=1e-15)
    np.testing.assert_allclose(truth.flux, [1.74e5, 1.74e4])
    assert np.array_equal(truth.relative_flux, np.ones((2, 30)))
    assert (truth.seed, truth.noise, truth.n_sub) == (6, {"read"}, 1)
    assert repr(truth) == "<Truth of 2 stars, seed 6, noise: read>"
    with pytest.raises(ValueError, match="read-only"):
        truth.x[0, 0] = 1.0


@pytest.mark.parametrize("n", [300, 2000, 8000])
@pytest.mark.parametrize("options", [{}, {"keep_model": True}, {"n_sub": 3}])
def test_memory_stays_below_three_times_the_result(n, options):
    motion = Motion.k2_roll(n)
    stars = [Star(12.0), Star(13.0, 3.0, 3.0)]
    simulate(stars, Detector.k2(), motion[:10], seed=1)
    tracemalloc.start()
    observation = simulate(stars, Detector.k2(), motion, seed=1, **options)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    cubes = (observation.flux, observation.flux_err, observation.raw_cnts, observation.truth.model)
    result = sum(cube.nbytes for cube in cubes if cube is not None)
    assert peak < 3 * result


@pytest.mark.parametrize(
    "changes, error, message",
    [
        ({"stars": []}, ValueError, "`stars` must hold at least one star"),
        ({"stars": 12.0}, TypeError, "`stars` must be Star or a sequence of them, got 12.0"),
        ({"stars": [12.0]}, TypeError, "`stars` must hold Star objects, got 12.0"),
        ({"detector": "k2"}, TypeError, "`detector` must be a Detector, got 'k2'"),
        ({"motion": np.zeros(3)}, TypeError, "`motion` must be a Motion, got array"),
        ({"seed": -3}, ValueError, "`seed` must be at least 0, got -3"),
        ({"seed": 0.5}, TypeError, "`seed` must be an integer, got 0.5"),
        ({"noise": ["photons"]}, ValueError, "`noise` must hold names out of"),
        ({"noise": None}, TypeError, "`noise` must be True, False or names"),
        ({"n_sub": 0}, ValueError, "`n_sub` must be at least 1, got 0"),
        ({"n_sub": 1.5}, TypeError, "`n_sub` must be an integer, got 1.5"),
        ({"chunk_size": 0}, ValueError, "`chunk_size` must be at least 1, got 0"),
        (
            {"stars": Star(12.0, signal=np.ones(4))},
            ValueError,
            "`signal` must give one number for each of the 3 cadences",
        ),
        (
            {"detector": PLAIN.replace(psf=None)},
            ValueError,
            "`psf` must be given for the star or for the detector",
        ),
    ],
)
def test_bad_arguments(changes, error, message):
    arguments = {"stars": Star(12.0), "detector": PLAIN, "motion": Motion.still(3)} | changes
    with pytest.raises(error, match=message):
        simulate(**arguments)


def test_a_scene_is_simulated_as_it_is_or_with_changes():
    scene = Scene(Star(12.0), PLAIN, Motion.still(3), seed=4, noise="read")
    observation = simulate(scene)
    assert observation.scene == scene
    assert np.array_equal(observation.flux, simulate(*scene, **scene.options).flux)
    again = simulate(scene, seed=5)
    assert (again.scene.seed, again.scene.noise) == (5, {"read"})
    assert simulate(scene.replace(seed=None)).scene.seed is not None
    with pytest.raises(TypeError, match="a Scene holds detector and motion"):
        simulate(scene, PLAIN, Motion.still(3))
    with pytest.raises(TypeError, match="`detector` must be a Detector, got None"):
        simulate(Star(12.0))


@pytest.fixture
def rendered(monkeypatch):
    """Return a list that counts the images of a star that are rendered."""
    images, render = [0], ImageSeries.__call__

    def count(series, x, *others):
        images[0] += len(x)
        return render(series, x, *others)

    monkeypatch.setattr(ImageSeries, "__call__", count)
    return images


def test_every_star_is_rendered_once(rendered, tmp_path):
    stars = [Star(12.0), Star(14.0, 7.0, 3.0)]
    observation = simulate(stars, Detector.k2(), Motion.k2_roll(1000), seed=1, keep_model=True)
    # 64 cadences choose the aperture, 8 extremes show what is lost.
    assert rendered[0] <= 2 * (1000 + 64 + 8)
    observation.write(tmp_path / "star.fits")
    observation.to_tpf()
    observation.model()
    observation.target_share()
    some = np.roll(observation.aperture, 1)
    assert rendered[0] <= 2 * (1000 + 64 + 8)
    # Other pixels need the light of each star in each cadence.
    share = observation.target_share(some)
    target = simulate(stars[0], Detector.k2(), Motion.k2_roll(1000), seed=1).model()
    expected = target[:, some].sum(axis=1) / observation.model()[:, some].sum(axis=1)
    np.testing.assert_allclose(share, expected, rtol=1e-12)


def test_pixels_depend_on_the_position_alone():
    motion = 4 * Motion.k2_roll(300)
    psf = BivariateGaussianPSF(0.8, rho=0.4) + BivariateGaussianPSF(0.2, 0.1, 0.0, 1.2, 1.1)
    arguments = Star(12.0, 4.9, 5.3, psf), Detector.k2(well_depth=None)
    whole = simulate(*arguments, motion, seed=1, noise=False).model()
    for part in (slice(137, 138), slice(100, 190), slice(7, 300, 5)):
        again = simulate(*arguments, motion[part], seed=1, noise=False).model()
        assert np.array_equal(again, whole[part])


def test_misspelt_option_is_an_error():
    with pytest.raises(TypeError, match="sead"):
        simulate(Star(12.0), PLAIN, Motion.still(3), sead=1)


def test_light_is_lost_only_near_the_edge():
    """Against the normal distribution beyond the nearest edge."""
    detector = Detector.k2().without_sensitivity()
    for x_0, expected in ((5.0, 0.0), (1.5, norm.sf(4.0))):  # sigma is 0.5 px
        truth = simulate(Star(12.0, x_0, 5.0), detector, Motion.still(2), seed=1).truth
        assert truth.lost_fraction[0] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("place", [(500.0, 5.0), (-1e4, 1e4), (1e7, 3.0)])
@pytest.mark.parametrize("rho", [0.0, 0.3])
def test_a_star_far_off_the_stamp_adds_no_light(place, rho):
    far = Star(5.0, *place, psf=BivariateGaussianPSF(sigma_x=0.6, sigma_y=0.5, rho=rho))
    scene = Detector.k2(), Motion.k2_roll(50)
    alone = simulate(Star(12.0), *scene, seed=1)
    np.testing.assert_array_equal(simulate([Star(12.0), far], *scene, seed=1).flux, alone.flux)


@pytest.mark.parametrize("n", [1, 50])
def test_pixels_beyond_the_memory_are_refused_before_any_is_made(n):
    scene = Scene(Star(12.0), Detector.k2(shape=(40_000, 40_000)), Motion.still(n), seed=1)
    message = rf"shape \({n}, 40000, 40000\) need [\d,]+ GB of memory, and the machine has \d+ GB"
    with pytest.raises(ValueError, match=message):
        simulate(scene)


@pytest.mark.parametrize("level", [1e30, 1e300])
def test_charge_beyond_single_precision_is_refused(level):
    scene = Star(12.0), Detector.k2(well_depth=None), Motion.still(3)
    with pytest.raises(ValueError, match="the charge of a pixel is beyond single precision"):
        simulate(*scene, seed=1, effects=[DarkCurrent(level), BrighterFatter()])


@pytest.mark.parametrize("psf", [BivariateGaussianPSF(1.0, 0.0, 0.0, 0.6, 0.5, 0.2), moffat_psf(2)])
def test_a_factor_of_the_sensitivity_is_in_the_light(psf):
    response = SensitivityPolynomial()
    light = []
    for each in (response, Const2D(0.5) * response, response + Const2D(0.5) * response):
        detector = Detector.k2(sensitivity=each, psf=psf, background=0.0, interpixel_scatter=0.0)
        observation = simulate(Star(12.0), detector, Motion.still(2), seed=1)
        light.append(np.sum(observation.model()))
    np.testing.assert_allclose(light[1:], [0.5 * light[0], 1.5 * light[0]], rtol=1e-9)
