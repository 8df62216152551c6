"""What all effects have in common, and each one against a truth of its own."""

import astropy.units as u
import numpy as np
import pytest

from scope_models import BivariateGaussianPSF, Detector, Motion, Scene, Star, read_scene, simulate
from scope_models.effects import (
    Argabrightening,
    Background,
    BrighterFatter,
    ChargeTransferInefficiency,
    CosmicRays,
    DarkCurrent,
    Effect,
    Extinction,
    Focus,
    Gaps,
    Jitter,
    NightSky,
    PixelShares,
    RollingBands,
    ScatteredLight,
    Scintillation,
    Seeing,
    SensitivityDropouts,
    Smear,
    Throughput,
    Undershoot,
    mission_effects,
)
from scope_models.effects.charge import rejected_shift
from scope_models.io import read_truth
from scope_models.models import SensitivityPolynomial, TabulatedPRF

PLAIN = Detector.k2(shape=(15, 15), well_depth=None).without_sensitivity()
EFFECTS = {
    "focus": Focus(0.01, period=12 * u.hour, thermal=0.02, thermal_time=0.5, events=[2145.0]),
    "focus series": Focus(series=np.linspace(0.99, 1.01, 60)),
    "background": Background(50.0, drift=10.0, gradient=(0.01, -0.02), residual=0.1),
    "scattered light": ScatteredLight(gradient=(0.01, 0.0)),
    "argabrightening": Argabrightening(rate=5.0),
    "cosmic rays": CosmicRays(),
    "jitter": Jitter(0.02, correlation_time=3 * u.hour),
    "throughput": Throughput(0.01, drift=0.001),
    "dropouts": SensitivityDropouts(rate=0.05, depth=0.1),
    "smear": Smear(residual=0.5),
    "dark current": DarkCurrent(20.0, residual=0.3),
    "brighter-fatter": BrighterFatter(),
    "undershoot": Undershoot(),
    "extinction": Extinction(0.1, np.linspace(1.0, 2.0, 60), scatter=0.05),
    "scintillation": Scintillation(0.2 * u.m, 3 * u.km, 1.5),
    "seeing": Seeing(0.05, 30 * u.min, 1.2),
    "night sky": NightSky(1.5, np.linspace(-20.0, 40.0, 60), 50 * u.deg, 30.0, residual=0.1),
    "charge transfer": ChargeTransferInefficiency(1e-4, 1e-4),
    "rolling bands": RollingBands(rate=3.0),
    "shares": PixelShares(np.full((3, 11, 11), 1e-3), (4, 6), (4, 6), (2144, 2146), 1),
    "left": Background(left=np.linspace(-5.0, 5.0, 60)),
    "gaps": Gaps([(2144.5, 2144.8), (2145.0, 2145.0)]),
}


def scene(*effects, n=60, **fields):
    stars = [Star(12.0), Star(14.0, 7.0, 3.0)]
    return Scene(stars, Detector.k2(), Motion.k2_roll(n), seed=5, effects=effects, **fields)


@pytest.fixture(scope="module")
def no_effects():
    """Return the pixels without an effect."""
    return simulate(scene()).flux


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_is_in_the_file(name, tmp_path, no_effects):
    observation = simulate(scene(EFFECTS[name]))
    path = observation.write(tmp_path / "star.fits")
    assert read_truth(path) == observation.truth
    assert read_scene(path) == observation.scene == scene(EFFECTS[name])
    again = simulate(read_scene(path))
    for cube in ("flux", "flux_err", "flux_bkg", "raw_cnts", "quality"):
        assert np.array_equal(getattr(again, cube), getattr(observation, cube), equal_nan=True)
    assert not np.array_equal(observation.flux, no_effects)


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
        if column in {"TARGET_SHARE", "X1", "Y1", "X2", "Y2"}:  # they follow from all effects
            continue
        same = [v for k, v in every.columns.items() if k.rstrip("_2") == column.rstrip("_2")]
        assert any(np.array_equal(values, v, equal_nan=True) for v in same), column
    assert len(added) == len(every.columns) - len(fewer.columns)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_given_does_not_matter(seed):
    seconds = Jitter(0.05), BrighterFatter(0.05), RollingBands(5.0), CosmicRays(10.0), CosmicRays()
    each = [*EFFECTS.values(), *seconds]  # several of one class, and two that are equal
    shuffled = [each[i] for i in np.random.default_rng(seed).permutation(len(each))]
    some, rest = tuple(shuffled[:4]), shuffled[4:]
    one = simulate(scene(*each))
    other = simulate(scene(*rest).replace(detector=Detector.k2(effects=some)))
    for found, same in zip(one.truth.columns.items(), other.truth.columns.items(), strict=True):
        assert found[0] == same[0]
        assert np.array_equal(found[1], same[1], equal_nan=True)
    for cube in ("flux", "flux_err", "flux_bkg", "raw_cnts", "quality"):
        assert np.array_equal(getattr(one, cube), getattr(other, cube), equal_nan=True)


def test_equal_effects_have_random_numbers_of_their_own():
    tables = simulate(scene(CosmicRays(), CosmicRays())).truth.tables
    assert not np.array_equal(tables["COSMICRAYS"]["X"][:5], tables["COSMICRAYS_2"]["X"][:5])


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
        center = (model * q).sum(axis=(1, 2)) / total
        variance = (model * (q - center[:, None, None]) ** 2).sum(axis=(1, 2)) / total
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
    assert not observation.quality.any()
    flagging = ScatteredLight(1000.0, perigee=1330.0, flag_above=0.1 * u.electron / u.ms)
    flagged = simulate(Star(10.0), Detector.tess(), motion, effects=flagging)
    strong = flagged.truth.columns["SCATTEREDLIGHT"] > 100
    assert np.array_equal(flagged.quality, np.where(strong, 4096, 0))


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
        (lambda: Focus(series=[1.0, -1.0]), ValueError, "width of the PSF must be finite and at"),
        (lambda: Focus(series=[1.0]), ValueError, "one width for each of the 2 cadences, got 1"),
        (lambda: Focus(1.0), ValueError, "`amplitude` must be below 1, got 1"),
        (lambda: Focus(0.1, period=0), ValueError, "`period` must be positive"),
        (lambda: Focus(0.1, period=3 * u.m), ValueError, "`period` must be in d"),
        (lambda: Focus(series=[np.nan, 1]), ValueError, "`series` must be a finite"),
        (lambda: Background(-1.0), ValueError, "`level` must not be negative"),
        (lambda: Background(1.0, gradient=(1, 0)), ValueError, "`gradient` makes the light"),
        (lambda: Background(1.0, drift=-1e6), ValueError, "`drift` makes the background negative"),
        (lambda: Background(1.0 * u.m), ValueError, "`level` must be in"),
        (lambda: Background(np.nan), ValueError, "`level` must be finite"),
        (lambda: Background(1.0, residual="all"), TypeError, "`residual` must be"),
        (lambda: Argabrightening(rate=-1), ValueError, "`rate` must not be negative"),
        (lambda: Argabrightening(brightness=-1), ValueError, "`brightness` must not be negative"),
        (lambda: ScatteredLight(peak=-1), ValueError, "`peak` must not be negative"),
        (lambda: ScatteredLight(time_scale=0), ValueError, "`time_scale` must be positive"),
        (lambda: ScatteredLight(perigee=np.inf), ValueError, "`perigee` must be finite"),
        (lambda: ScatteredLight(flag_above=-1), ValueError, "`flag_above` must not be negative"),
        (lambda: ScatteredLight(orbit=0), ValueError, "`orbit` must be positive"),
        (lambda: CosmicRays(rate=-1), ValueError, "`rate` must not be negative"),
        (lambda: CosmicRays(electrons=0), ValueError, "`electrons` must be positive"),
        (lambda: CosmicRays(rate=1 / u.s), ValueError, "`rate` must be in"),
        (lambda: CosmicRays(pixel_size=0), ValueError, "`pixel_size` must be positive"),
        (lambda: CosmicRays(rate=1e9), ValueError, r"`rate` makes .* events; at most 1e\+08 are"),
        (lambda: RollingBands(rate=1e12), ValueError, "`rate` makes .* events; at most"),
        (lambda: SensitivityDropouts(rate=1e9), ValueError, "`rate` makes .* events; at most"),
        (lambda: CosmicRays(depth=-1), ValueError, "`depth` must be positive"),
        (lambda: CosmicRays(longest=0), ValueError, "`longest` must be positive"),
        (lambda: CosmicRays(rejection=1), TypeError, "`rejection` must be True or False"),
        (lambda: Jitter(-0.1), ValueError, "`rms` must not be negative"),
        (lambda: Jitter(0.1, -1.0), ValueError, "`correlation_time` must not be negative"),
        (lambda: Jitter(1 * u.arcsec), ValueError, "`rms` must be in pix"),
        (lambda: Jitter(0.1, nodes=0), ValueError, "`nodes` must be at least 1"),
        (lambda: Throughput(1.5, 9e9, 0.75), ValueError, "response must not be negative"),
        (lambda: Throughput(series=[1.0]), ValueError, "one factor for each of the 2 cadences"),
        (lambda: Throughput(period=0), ValueError, "`period` must be positive"),
        (lambda: Throughput(series=[1.0, np.nan]), ValueError, "`series` must be a finite"),
        (lambda: SensitivityDropouts(rate=-1), ValueError, "`rate` must not be negative"),
        (lambda: SensitivityDropouts(recovery=2), ValueError, "`recovery` must not be above 1"),
        (lambda: SensitivityDropouts(recovery_time=0), ValueError, "`recovery_time` must be pos"),
        (lambda: SensitivityDropouts(depth=2), ValueError, "`depth` must not be above 1"),
        (lambda: Smear(rows=0), ValueError, "`rows` must be at least 1"),
        (lambda: DarkCurrent(-1), ValueError, "`level` must not be negative"),
        (lambda: DarkCurrent(scatter=-1), ValueError, "`scatter` must not be negative"),
        (lambda: BrighterFatter(-1), ValueError, "`coefficient` must not be negative"),
        (lambda: Undershoot(-1), ValueError, "`amplitude` must not be negative"),
        (lambda: ChargeTransferInefficiency(0.1), ValueError, "`parallel` must be below 0.1"),
        (lambda: ChargeTransferInefficiency(serial=-1), ValueError, "`serial` must not be neg"),
        (lambda: ChargeTransferInefficiency(rows=0), ValueError, "`rows` must be at least 1"),
        (lambda: ChargeTransferInefficiency(columns=1.5), TypeError, "`columns` must be an int"),
        (lambda: RollingBands(rate=-1), ValueError, "`rate` must not be negative"),
        (lambda: RollingBands(amplitude=-1), ValueError, "`amplitude` must not be negative"),
        (lambda: RollingBands(duration=0), ValueError, "`duration` must be positive"),
        (lambda: RollingBands(spacing=0 * u.pix), ValueError, "`spacing` must be positive"),
        (lambda: RollingBands(speed=np.nan), ValueError, "`speed` must be finite"),
        (lambda: BrighterFatter(full_well=0), ValueError, "`full_well` must be positive"),
        (lambda: Undershoot(decay=0), ValueError, "`decay` must be positive"),
        (lambda: Gaps([(2, 1)]), ValueError, "`intervals` must not end before they begin"),
        (lambda: Gaps([(1, np.nan)]), ValueError, "`intervals` must be finite and of the shape"),
        (lambda: Gaps([1, 2]), ValueError, "`intervals` must be finite and of the shape"),
        (lambda: "focus", TypeError, "`effects` must hold Effect objects, got 'f'"),
        (lambda: 7, TypeError, "`effects` must be Effect or a sequence of them, got 7"),
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


def total_charge(shape, n, effect, seed=1):
    """Return the charge of cosmic rays on a stamp without light, (n, ny, nx), and their truth."""
    detector = Detector.k2(shape=shape, background=0.0).without_sensitivity()
    observation = simulate(
        Star(40.0), detector, Motion.still(n), noise=False, effects=effect, seed=seed
    )
    seconds = detector.exposure_time
    return (observation.flux.astype(float) - observation.model()) * seconds, observation.truth


def test_cosmic_rays_have_their_rate_charge_and_tracks():
    rays = CosmicRays(rate=5 / u.cm**2 / u.s, longest=5.0)
    charge, truth = total_charge((21, 21), 400, rays)
    # Every ray that crosses the stamp is on it somewhere: by area, the mean charge is the rate's.
    expected = 5 * (27e-4) ** 2 * 270 * 6.019802903270 * 2500
    events = truth.tables["COSMICRAYS"]
    n = 5 * (27e-4) ** 2 * 270 * 6.019802903270 * 21**2 * 400
    assert len(events) == pytest.approx(n, rel=0.2)
    assert charge.mean() == pytest.approx(expected, rel=5 * 1.5 / np.sqrt(n))
    # Isotropic: half of the tracks is steeper than 45 degrees, tan < 1.
    inside = (np.abs(events["X"] - 10) < 10) & (np.abs(events["Y"] - 10) < 10)
    length = np.asarray(events["LENGTH"])[inside] * 27 / 15
    assert np.mean(length < 1) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(inside.sum()))
    assert np.mean(length < 2) == pytest.approx(0.8, abs=4 * 0.4 / np.sqrt(inside.sum()))
    # About 6 % of pixels per long cadence are hit.
    assert 0.05 < np.mean(charge > 1) < 0.15


def test_charge_of_a_track_lies_on_it():
    charge, truth = total_charge((21, 21), 60, CosmicRays(rate=0.3), seed=4)
    events = truth.tables["COSMICRAYS"]
    cadences, counts = np.unique(events["CADENCE"], return_counts=True)
    alone = [c for c, k in zip(cadences, counts, strict=True) if k == 1]
    checked = 0
    for cadence in alone:
        event = events[np.asarray(events["CADENCE"]) == cadence][0]
        end = event["X"] + event["LENGTH"] * np.cos(event["ANGLE"])
        top = event["Y"] + event["LENGTH"] * np.sin(event["ANGLE"])
        row, column = np.nonzero(charge[cadence] > 1)
        assert column.min() >= np.rint(min(event["X"], end)) - 1e-9
        assert column.max() <= np.rint(max(event["X"], end)) + 1e-9
        if all(-0.5 < q < 20.5 for q in (event["X"], end, event["Y"], top)):
            assert charge[cadence].sum() == pytest.approx(event["ELECTRONS"], rel=1e-3)
            assert row.max() - row.min() <= np.ceil(event["LENGTH"])
            checked += 1
    assert checked > 5


def test_rejection_of_the_highest_and_lowest_of_ten():
    rng = np.random.default_rng(1)
    for d in (0.0, 0.5, 2.0, 5.0, 40.0):
        reads = rng.standard_normal((200000, 10))
        reads[:, 0] += d
        trimmed = reads.sum(axis=1) - reads.max(axis=1) - reads.min(axis=1)
        error = trimmed.std() / np.sqrt(len(trimmed))
        assert rejected_shift(d) == pytest.approx(trimmed.mean(), abs=4 * error)
    detector = Detector.tess(background=0.0).without_sensitivity()
    motion = Motion.still(500, cadence=120 / 86400)
    kept, rejected = (
        simulate(
            Star(40.0),
            detector,
            motion,
            noise=False,
            seed=1,
            effects=CosmicRays(pixel_size=15.0, rejection=flag),
        ).flux
        * detector.exposure_time
        for flag in (False, True)
    )
    # What is left of a ray is at most 1.49 of the noise of a read, 10 electrons.
    assert kept.max() > 1000
    assert 10 < rejected.max() < 14.9


def test_jitter_moves_the_mean_and_widens_the_image():
    cadence = 120.0
    motion = Motion.still(2000, cadence=cadence / 86400)
    detector = Detector.tess(shape=(15, 15), well_depth=None).without_sensitivity()
    psf = BivariateGaussianPSF(sigma_x=0.9, sigma_y=0.9)
    for tau in (0.0, 30.0, 500.0):
        jitter = Jitter(0.2, correlation_time=tau * u.s)
        observation = simulate(
            Star(8.0, psf=psf), detector, motion, noise=False, effects=jitter, seed=2
        )
        x, blur = (observation.truth.columns[k] for k in ("JITTER_X", "JITTER_BLUR"))
        # The same process, step by step at 1/50 of a cadence.
        fine = np.zeros(50 * 2000) if tau else None
        if tau:
            kept = np.exp(-cadence / 50 / tau)
            steps = np.random.default_rng(3).standard_normal(50 * 2000)
            value = 0.0
            for i, step in enumerate(steps):
                value = kept * value + np.sqrt(1 - kept**2) * step
                fine[i] = 0.2 * value
            means = fine.reshape(2000, 50).mean(axis=1)
            effective = 2000 / (1 + 2 * tau / cadence)
            assert x.std() == pytest.approx(means.std(), rel=6 / np.sqrt(effective))
            lag = np.corrcoef(x[1:], x[:-1])[0, 1]
            expected = np.corrcoef(means[1:], means[:-1])[0, 1]
            assert lag == pytest.approx(expected, abs=6 / np.sqrt(effective))
            inner = fine.reshape(2000, 50).var(axis=1).mean()
            assert blur[0] ** 2 == pytest.approx(inner, rel=0.05)
        else:
            assert x.std() == pytest.approx(0.2 / np.sqrt(60), rel=0.06)
        np.testing.assert_allclose(observation.truth.x[0], 7 + x, atol=1e-12)
        model = observation.model()[:200]
        columns = np.arange(15)
        total = model.sum(axis=(1, 2))
        mean = (model * columns).sum(axis=(1, 2)) / total
        np.testing.assert_allclose(mean, observation.truth.x[0, :200], atol=2e-3)
        variance = (model * (columns - mean[:, None, None]) ** 2).sum(axis=(1, 2)) / total
        np.testing.assert_allclose(variance - 1 / 12, 0.9**2 + blur[0] ** 2, rtol=5e-3)


def test_jitter_is_a_convolution():
    sigma, blur = 0.8, 0.1
    detector = Detector.k2(shape=(11, 11)).without_sensitivity()
    star = Star(12.0, psf=BivariateGaussianPSF(sigma_x=sigma, sigma_y=sigma))
    jitter = Jitter(blur, nodes=5)
    observation = simulate(star, detector, Motion.still(1), noise=False, effects=jitter, seed=2)
    (x,), (y,) = (observation.truth.columns[f"JITTER_{axis}"] for axis in "XY")
    s = float(np.hypot(sigma, observation.truth.columns["JITTER_BLUR"][0]))
    wide = Star(12.0, 5 + x, 5 + y, psf=BivariateGaussianPSF(sigma_x=s, sigma_y=s))
    alone = simulate(wide, detector, Motion.still(1), noise=False).model()
    np.testing.assert_allclose(observation.model(), alone, atol=1e-12 * 1.74e5)


def test_jitter_of_tilted_and_other_densities_that_breathe():
    from photutils.psf import MoffatPSF

    widths = np.array([0.9, 1.2])
    effects = Jitter(0.15, nodes=5), Focus(series=widths)
    motion = Motion.still(2)
    detector = Detector.k2(shape=(7, 7), interpixel_scatter=0.0)
    psfs = (
        BivariateGaussianPSF(sigma_x=0.8, sigma_y=0.6, rho=0.4),
        BivariateGaussianPSF(sigma_x=0.8, sigma_y=0.6, rho=0.97),
        MoffatPSF(alpha=1.5, beta=4.0),
    )
    for psf in psfs:
        scene = Scene(Star(12.0, psf=psf), detector, motion, seed=1, noise=False, effects=effects)
        observation = simulate(scene)
        x, y, blur = (observation.truth.columns[f"JITTER_{k}"] for k in ("X", "Y", "BLUR"))
        # The same normal distribution of positions, by a grid of its own.
        at = np.linspace(-5, 5, 11)
        weights = np.exp(-(at**2) / 2)
        weights = np.outer(weights, weights).ravel() / weights.sum() ** 2
        dx, dy = (blur[0] * grid.ravel() for grid in np.meshgrid(at, at))
        for cadence, width in enumerate(widths):
            path = Motion(np.arange(dx.size), x[cadence] + dx, y[cadence] + dy)
            images = simulate(
                Star(12.0, psf=psf), detector, path, seed=1, noise=False,
                effects=Focus(series=np.full(dx.size, width)),
            ).model()  # fmt: skip
            mean = np.tensordot(weights, images, axes=1)
            np.testing.assert_allclose(observation.model()[cadence], mean, atol=2e-6 * 1.74e5)


def test_throughput_is_the_ratio_of_cadences():
    series = np.array([1.0, 0.9, 1.1])
    effect = Throughput(0.01, period=0.3, drift=0.02 / u.day, series=series)
    motion = Motion.still(3, cadence=0.1)
    observation = simulate(Star(12.0), Detector.k2(), motion, noise=False, effects=effect, seed=1)
    t = motion.time
    expected = 1 + 0.01 * np.sin(2 * np.pi * t / 0.3) + 0.02 * (t - t[1])
    total = observation.model().sum(axis=(1, 2))
    np.testing.assert_allclose(total / total[1], expected * series / (0.9 * expected[1]), rtol=1e-9)
    np.testing.assert_allclose(
        observation.flux_bkg.mean(axis=(1, 2)) / observation.flux_bkg[1].mean(),
        expected * series / (0.9 * expected[1]),
        rtol=1e-6,
    )


def test_dropouts_recover_in_part():
    effect = SensitivityDropouts(rate=0.02, depth=0.1, recovery=0.6, recovery_time=6 * u.hour)
    detector, motion = Detector.k2(), Motion.still(400)
    with_dropouts, without = (
        simulate(Star(12.0), detector, motion, noise=False, effects=effects, seed=7)
        for effects in (effect, ())
    )
    events = with_dropouts.truth.tables["SENSITIVITYDROPOUTS"]
    expected = 0.02 * 121 * 400 * detector.cadence_days
    assert abs(len(events) - expected) < 4 * np.sqrt(expected)
    lit = without.model() > 1
    ratio = np.where(lit, with_dropouts.model() / np.where(lit, without.model(), 1), 1)
    for event in events:
        others = (events["ROW"] == event["ROW"]) & (events["COLUMN"] == event["COLUMN"])
        pixel = ratio[:, event["ROW"], event["COLUMN"]]
        if others.sum() > 1 or not lit[:, event["ROW"], event["COLUMN"]].all():
            continue
        start = event["CADENCE"]
        assert np.all(pixel[:start] == 1)
        assert pixel[start] == pytest.approx(1 - event["DEPTH"])
        lasting = 1 - 0.6 + 0.6 * np.exp(-(motion.time - motion.time[start]) / 0.25)
        np.testing.assert_allclose(pixel[start:], 1 - event["DEPTH"] * lasting[start:])
        assert with_dropouts.quality[start] & 1024


def test_gaps_have_no_data():
    motion = Motion.still(20, start=2500.0)
    gaps = Gaps([(motion.time[3], motion.time[5]), (motion.time[19], 9e4)])
    missing = np.isin(np.arange(20), [3, 4, 5, 19])
    for detector, bit in ((Detector.k2(), 65536), (Detector.tess(), 128)):
        observation = simulate(Star(12.0), detector, motion, effects=gaps, seed=1)
        assert np.array_equal(np.isnan(observation.flux).all(axis=(1, 2)), missing)
        assert np.array_equal(np.isnan(observation.flux_err).any(axis=(1, 2)), missing)
        assert np.all((observation.raw_cnts == -1).all(axis=(1, 2)) == missing)
        assert np.array_equal(observation.quality, np.where(missing, bit, 0))
        plain = simulate(Star(12.0), detector, motion, seed=1)
        assert np.array_equal(observation.flux[~missing], plain.flux[~missing])
        tpf = observation.to_tpf(quality_bitmask="none")
        assert np.array_equal(np.isnan(tpf.flux.value).all(axis=(1, 2)), missing)
        assert len(observation.to_tpf()) == 16


def test_smear_is_that_of_the_column():
    stars = [Star(10.0, 3.0, 2.0), Star(11.0, 7.0, 8.0)]
    detector = Detector.k2(well_depth=None)
    arguments = stars, detector, Motion.still(2)
    observation = simulate(*arguments, noise=False, seed=1, effects=Smear(residual=0.25))
    plain = simulate(*arguments, noise=False, seed=1)
    smear = 0.518948526144 / 1070 / 6.019802903270 * plain.model().sum(axis=1, keepdims=True)
    smear = np.broadcast_to(smear, plain.flux.shape)
    np.testing.assert_allclose(observation.flux - plain.flux, 0.25 * smear, atol=0.02)
    np.testing.assert_allclose(
        observation.flux_bkg - plain.flux_bkg, 0.75 * smear, atol=1e-3, rtol=1e-5
    )
    assert smear.max() > 20


def test_dark_current_is_seen_in_the_dark():
    effect = DarkCurrent(50 * u.electron / u.s, scatter=0.2, residual=0.5)
    detector = Detector.k2(shape=(40, 40), background=0.0).without_sensitivity()
    arguments = Star(40.0), detector, Motion.still(50)
    observation = simulate(*arguments, noise=False, seed=1, effects=effect)
    dark = observation.truth.maps["DARKCURRENT"]
    assert dark.mean() == pytest.approx(50, abs=4 * 10 / 40)
    assert dark.std() == pytest.approx(10, rel=4 / np.sqrt(2 * 1600))
    np.testing.assert_allclose(observation.flux[0], 0.5 * (dark - 50), atol=1e-4)
    noisy = simulate(*arguments, noise="background", seed=1, effects=effect)
    variance = (noisy.flux - observation.flux).var(axis=0, ddof=1)
    ratio = variance / (dark / detector.exposure_time)
    assert ratio.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / 49 / 1600))


def test_brighter_stars_are_wider():
    detector = PLAIN.replace(background=0.0, n_frames=1, gain=1.0)
    effect = BrighterFatter(0.05, full_well=1e5)
    growth, peaks = [], []
    for mag in (13.5, 12.5, 11.5):
        star = Star(mag, psf=BivariateGaussianPSF(sigma_x=0.9, sigma_y=0.9))
        observation = simulate(star, detector, Motion.still(1), noise=False, effects=effect)
        seconds = detector.exposure_time
        charge, thin = observation.flux[0].astype(float) * seconds, observation.model()[0] * seconds
        assert charge.sum() == pytest.approx(thin.sum(), rel=1e-6)
        x = np.arange(15) - 7
        moments = [(image * x**2).sum() / image.sum() for image in (charge, thin)]
        expected = 0.05 / 1e5 * (thin**2).sum() / thin.sum()
        assert moments[0] - moments[1] == pytest.approx(expected, rel=1e-3)
        growth.append(np.sqrt(moments[0] / moments[1]) - 1)
        peaks.append(thin.max())
    # The slope of the width against the peak is constant.
    np.testing.assert_allclose(np.divide(growth, peaks) * peaks[0] / growth[0], 1, rtol=0.02)


def test_photon_transfer_is_concave():
    k, well = 0.05, 1e5
    for level in (1e3, 2e4, 5e4):
        sky = level / (1.0)
        detector = Detector(
            shape=(60, 60),
            zero_point=1.0,
            zero_point_mag=0.0,
            int_time=1.0,
            background=sky,
            psf=BivariateGaussianPSF(),
        )
        effect = BrighterFatter(k, full_well=well)
        flux = simulate(
            Star(40.0), detector, Motion.still(50), noise="background", effects=effect, seed=1
        ).flux[:, 2:-2, 2:-2]
        shift = k * level / well
        expected = level * ((1 - 4 * shift) ** 2 + 4 * shift**2)
        assert flux.var() == pytest.approx(expected, rel=6 / np.sqrt(flux.size / 2))


def test_undershoot_of_one_pixel_and_of_a_flat_field():
    effect = Undershoot(0.004, decay=4.0)
    charge = np.zeros((1, 2, 12))
    charge[0, 0, 3] = 1e5
    charge[0, 1] = 500.0
    effect.readout(None, None, slice(0, 1), charge)
    assert np.all(charge[0, 1] == 500)
    assert charge[0, 0, 3] == 1e5
    np.testing.assert_allclose(charge[0, 0, 4:], -400 * np.exp(-np.arange(8) / 4))
    assert not charge[0, 0, :3].any()


def test_calibration_takes_the_undershoot_off_the_flux_but_not_off_the_counts():
    scene = Star(10.5), Detector.k2(shape=(9, 9)), Motion.still(2)
    options = {"noise": False, "seed": 1}
    plain = simulate(*scene, **options)
    for residual in (0.0, 0.25, 1.0):
        seen = simulate(*scene, effects=Undershoot(residual=residual), **options)
        change = seen.flux.astype(float) - plain.flux
        lost = (seen.raw_cnts - plain.raw_cnts) * scene[1].gain / scene[1].exposure_time
        assert lost.min() < -500
        np.testing.assert_allclose(change, residual * lost, atol=0.5)
    two = [Undershoot(0.1, 2.0), Undershoot(0.02, 9.0)]
    np.testing.assert_allclose(
        simulate(*scene, effects=two, **options).flux, plain.flux, rtol=1e-5, atol=1e-6
    )


def test_charge_that_transfers_leave_behind():
    epsilon, rows = 0.02, 30
    charge = np.zeros((1, 9, 1))
    charge[0, 2:5, 0] = 1e4, 2e4, 500.0
    late = charge.copy()
    ChargeTransferInefficiency(epsilon, 0.0, rows=rows).readout(None, None, None, late)
    # Clock by clock: every packet leaves a part behind, and what passes the end is read.
    wells, read = np.concatenate([np.zeros(rows), charge[0, :, 0]]), []
    for _ in range(rows + 60):
        kept = epsilon * wells
        wells = np.append(wells[1:] - kept[1:], 0.0) + kept
        read.append(wells[0])
        wells[0] = 0.0
    expected = np.array(read)[rows - 1 : rows + 8]
    np.testing.assert_allclose(late[0, :, 0], expected, atol=1e-9 * charge.max())
    # First-pixel response, and conservation: the trail of few transfers stays on the stamp.
    assert late[0, 2, 0] == pytest.approx(1e4 * (1 - epsilon) ** (rows + 2))
    long = np.zeros((2, 40, 40))
    long[:, 2, 3] = 1e5
    ChargeTransferInefficiency(1e-3, 2e-3).readout(None, None, None, long)
    np.testing.assert_allclose(long.sum(axis=(1, 2)), 1e5, rtol=1e-13)
    assert long[0, 2, 3] == pytest.approx(1e5 * (1 - 1e-3) ** 514 * (1 - 2e-3) ** 553)
    flat = np.full((1, 5, 6), 700.0)
    ChargeTransferInefficiency(1e-2, 1e-2).readout(None, None, None, flat)
    assert np.all(flat == 700)


def test_bands_roll_over_the_rows():
    effect = RollingBands(rate=0.1, amplitude=4.0, spacing=9 * u.pix, speed=30 * u.pix / u.day)
    arguments = Star(40.0), Detector.k2(shape=(36, 5)), Motion.still(700)
    banded, plain = (
        simulate(*arguments, seed=10, noise=False, effects=effects) for effects in (effect, ())
    )
    bands = (banded.flux.astype(float) - plain.flux).astype(float)
    assert np.ptp(bands, axis=2).max() < 1e-4
    # Four bands are on the stamp: their Fourier coefficient has their amplitude and phase.
    wave = 2 * np.tensordot(bands[..., 0], np.exp(-2j * np.pi * np.arange(36) / 9), axes=1) / 36
    size = banded.truth.columns["ROLLINGBANDS"]
    np.testing.assert_allclose(np.abs(wave), size, atol=1e-4)
    episodes = banded.truth.tables["ROLLINGBANDS"]
    assert len(episodes) == 1
    first = np.argmin(np.abs(banded.time - episodes["TIME"][0]))
    turn = np.diff(np.unwrap(np.angle(wave[first - 5 : first + 5])))
    days = np.diff(banded.time)[0]
    np.testing.assert_allclose(turn, -2 * np.pi * 30 / 9 * days, rtol=0.02)
    assert np.array_equal(banded.quality, np.where(size > 2, 131072, 0))
    assert 0 < (size > 2).sum() < 700


def test_detected_charge_fills_wells():
    arguments = Star(9.0), Detector.k2(shape=(41, 9)).without_sensitivity(), Motion.still(400)
    observation = simulate(*arguments, noise=("photon", "background"), seed=4)
    flux, model = observation.flux.astype(float), observation.model()
    depth = 1.08e6 / 6.019802903270 - 284
    full = model[0] > 0.999999 * depth
    ends = np.roll(full, 1, axis=0) ^ np.roll(full, -1, axis=0)
    assert full.sum() > 5
    # Full pixels are still but for the subtracted background; all photon noise is at the ends.
    assert np.ptp(flux[:, full], axis=0).max() < 1e-6 * depth
    column = flux[:, :, 4].sum(axis=1)
    expected = np.sqrt((model[0, :, 4].sum() + 41 * 284) / observation.detector.exposure_time)
    assert column.std() == pytest.approx(expected, rel=4 / np.sqrt(800))
    assert flux[:, ends].std(axis=0).max() > 0.3 * expected
    assert np.all(observation.flux_err[0, full] > 1)


def test_bins_of_20_s_have_the_rays_of_120_s():
    rays = CosmicRays(rate=5000.0, pixel_size=15.0)
    mean = {}
    for name, n in (("20 s", 180), ("120 s", 30)):
        detector = Detector.tess(cadence=name, background=0.0).without_sensitivity()
        motion = Motion.still(n, cadence=detector.cadence_days, time_format="btjd")
        electrons = simulate(Star(40.0), detector, motion, noise=False, seed=1, effects=rays).flux
        mean[name] = electrons.mean(dtype=float)
    bright = simulate(Star(9.0), detector, motion, noise=False, seed=1)
    fast = Detector.tess(cadence="20 s", background=0.0).without_sensitivity()
    short = Motion.still(6, cadence=fast.cadence_days, time_format="btjd")
    binned = simulate(Star(9.0), fast, short, noise=False, seed=1).flux.mean(axis=0)
    np.testing.assert_allclose(binned, bright.flux[0], rtol=1e-6)
    assert mean["20 s"] == pytest.approx(mean["120 s"], rel=0.05)


@pytest.mark.parametrize(
    ("motion", "detector", "bits"),
    [
        (Motion.k2_roll(400), Detector.k2(), {1048576, 64, 1024, 131072, 65536}),
        (Motion.kepler(400, dump_interval=2.0), Detector.kepler(), {32, 64, 1024, 131072, 65536}),
        (Motion.tess(800, cadence="1800 s"), Detector.tess(cadence="1800 s"), {32, 16, 4096, 128}),
    ],
)
def test_files_have_the_bits_of_the_mission(motion, detector, bits, tmp_path):
    start = motion.time[0]
    effects = [
        Argabrightening(rate=1.0), SensitivityDropouts(rate=0.01), RollingBands(rate=1.0),
        ScatteredLight(flag_above=100.0), Gaps([(start + 1.0, start + 1.1)]),
    ]  # fmt: skip
    observation = simulate(Star(12.0), detector, motion, seed=2, effects=effects)
    found = {1 << k for k in range(31) if np.any(observation.quality & (1 << k))}
    assert found == bits
    tpf = observation.to_tpf(quality_bitmask="none")
    assert np.array_equal(tpf.quality, observation.quality)
    assert read_truth(observation.write(tmp_path / "star.fits")) == observation.truth


def test_a_mission_has_its_own_effects(tmp_path):
    names = {
        "kepler": {"CosmicRays", "Smear", "Undershoot", "RollingBands"},
        "k2": {"Focus", "CosmicRays", "Smear", "Undershoot", "RollingBands"},
        "tess": {"CosmicRays", "ScatteredLight"},
    }
    for name, expected in names.items():
        detector = Detector.preset(name)
        motion = Motion.still(3, start=2500.0)
        mission = Scene(Star(12.0), detector, motion, seed=1, effects="mission")
        assert mission.effects == mission_effects(detector)
        assert {effect.name for effect in mission.effects} == expected
        assert read_scene(simulate(mission).write(tmp_path / f"{name}.fits")) == mission
    assert mission_effects(Detector.tess())[0].rejection
    assert not mission_effects(Detector.tess(cadence=20))[0].rejection
    assert mission_effects(PLAIN.replace(mission="survey")) == ()


def test_effects_without_events(tmp_path):
    effects = [
        CosmicRays(rate=0), SensitivityDropouts(rate=0), Argabrightening(rate=0),
        RollingBands(rate=0), ChargeTransferInefficiency(0, 0),
    ]  # fmt: skip
    observation = simulate(scene(*effects))
    assert np.array_equal(observation.flux, simulate(scene()).flux)
    truth = read_truth(observation.write(tmp_path / "star.fits"))
    assert truth == observation.truth
    assert len(truth.tables["COSMICRAYS"]) == len(truth.tables["SENSITIVITYDROPOUTS"]) == 0


def test_effects_of_a_kind_have_their_own_numbers(tmp_path):
    observation = simulate(scene(*[Argabrightening(rate=9.0)] * 7))
    names = ["ARGABRIGHTENING", *(f"ARGABRIGHTENING_{number}" for number in range(2, 8))]
    first, *others = (observation.truth.columns[name] for name in names)
    assert not any(np.array_equal(first, other) for other in others)
    alone = simulate(scene(Argabrightening(rate=9.0))).truth.columns["ARGABRIGHTENING"]
    assert np.array_equal(first, alone)
    assert read_truth(observation.write(tmp_path / "star.fits")) == observation.truth
