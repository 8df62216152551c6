"""The messy test sky: its rendering, its truth and its scores."""

import numpy as np
import pytest
from astropy.stats import mad_std
from scipy.integrate import dblquad

from scope_models.benchmark import REGIMES, SkyRegime, make_sky, score
from scope_models.benchmark.files import score_light_curve
from scope_models.benchmark.sky import bleed, make_psf, make_response, render
from scope_models.effects._noise import red_noise
from scope_models.scene.motion import K2Roll


@pytest.fixture(scope="module")
def sky():
    return make_sky("k2-1x-transits-1pct", seed=3, n_cadences=400)


def test_pixels_are_integrals_of_the_psf():
    rng = np.random.default_rng(1)
    psf = make_psf(rng, 0.55)
    flat = make_response(rng, (9, 9), drop=0.0, scatter=0.0)
    image = render(flat, psf, np.array([4.3]), np.array([3.8]), np.array([1.0]))[0]
    total = dblquad(psf, -8.5, 8.5, -8.5, 8.5, epsabs=1e-6)[0]
    for row, column in ((4, 4), (4, 5), (2, 6)):
        expected = dblquad(
            lambda x, y: psf(x - 4.3, y - 3.8), row - 0.5, row + 0.5, column - 0.5, column + 0.5
        )[0]
        # Wings beyond the periodic field are folded back: 1e-5 of the light.
        np.testing.assert_allclose(image[row, column], expected / total, rtol=1e-3, atol=1e-5)


def test_even_response_conserves_light_under_motion():
    rng = np.random.default_rng(2)
    flat = make_response(rng, (13, 13), drop=0.0, scatter=0.0)
    steps = np.linspace(-0.5, 0.5, 11)
    images = render(flat, make_psf(rng, 0.4), 6 + steps, 6 - steps, np.ones(11))
    assert np.ptp(images.sum(axis=(1, 2))) < 1e-4  # what the wings lose at the stamp's edge


def test_response_changes_the_light_of_a_moving_star():
    rng = np.random.default_rng(2)
    response = make_response(rng, (13, 13), drop=0.1, scatter=0.01)
    steps = np.linspace(-0.5, 0.5, 11)
    images = render(response, make_psf(rng, 0.5), 6 + steps, 6 + steps, np.ones(11))
    assert 3e-4 < images.sum(axis=(1, 2)).std() < 2e-2


def test_wider_psf_has_larger_second_moment():
    rng = np.random.default_rng(4)
    flat = make_response(rng, (15, 15), drop=0.0, scatter=0.0)
    images = render(flat, make_psf(rng, 0.5), *np.full((2, 2), 7.0), np.array([1.0, 1.005]))
    near = np.abs(np.arange(15) - 7) <= 3
    cut = images[:, near][:, :, near]
    u = (np.arange(15) - 7)[near]
    second = np.einsum("nij,j->n", cut, u**2) / cut.sum(axis=(1, 2))
    assert second[1] > second[0]


def test_bleeding_conserves_charge_and_stays_in_the_column():
    image = np.zeros((1, 15, 3))
    image[0, 7, 1] = 5.5
    spilled = bleed(image, 1.0)
    np.testing.assert_allclose(spilled.sum(), 5.5, rtol=1e-6)
    assert spilled.max() <= 1 + 1e-5
    assert spilled[0, :, [0, 2]].max() == 0
    np.testing.assert_allclose(spilled[0], spilled[0, ::-1], atol=1e-12)


def test_same_seed_gives_same_star(sky):
    again = make_sky("k2-1x-transits-1pct", seed=3, n_cadences=400)
    np.testing.assert_array_equal(again.flux, sky.flux)
    assert not np.array_equal(again.x, make_sky(sky.regime, seed=4, n_cadences=400).x)


def test_noise_is_as_stated(sky):
    light = sky.star_light + sky.neighbor_light + sky.background_light
    deviation = (sky.flux - light)[np.isfinite(sky.time)] / sky.flux_err[np.isfinite(sky.time)]
    np.testing.assert_allclose(mad_std(deviation), 1, rtol=0.01)
    assert abs(np.median(deviation)) < 0.02


def test_file_is_what_lightkurve_reads(sky):
    tpf = sky.to_tpf()
    assert tpf.mission == "K2"
    np.testing.assert_array_equal(tpf.pipeline_mask, sky.aperture)
    rows = np.asarray(tpf.cadenceno) - 1
    np.testing.assert_array_equal(tpf.flux.value, sky.flux[rows])
    assert len(rows) < 400  # gaps and flagged cadences
    moved = tpf.pos_corr1 - (sky.x - np.median(sky.x))[rows]
    assert 0.002 < np.median(np.abs(moved - np.median(moved))) < 0.01


def test_errors_of_positions():
    exact, wrong, none = (
        make_sky("k2-10x-lost", 2, n_cadences=1500, positions=kind)
        for kind in ("exact", "wrong", "none")
    )
    np.testing.assert_array_equal(exact.flux, wrong.flux)
    here = np.isfinite(exact.x)
    fine = here & (wrong.quality == 0)
    assert np.abs(exact.pos_corr1[~here]).min() > 100
    offset = exact.x - np.nanmedian(exact.x)
    assert np.ptp((exact.pos_corr1 - offset)[here]) < 1e-12
    error = (wrong.pos_corr1 - exact.pos_corr1)[fine]
    design = np.column_stack([np.ones(fine.sum()), offset[fine]])
    slope = np.linalg.lstsq(design, error, rcond=None)[0][1]
    assert abs(slope) == pytest.approx(0.01, abs=0.001)
    rest = error - slope * offset[fine]
    assert np.diff(rest).std() / np.sqrt(2) == pytest.approx(0.003, rel=0.1)
    assert 0.002 < rest.std() < 0.015
    assert np.isnan(none.pos_corr1).all()
    assert make_sky("jitter-spots-3d", n_cadences=100).positions == "none"
    with pytest.raises(ValueError, match="`positions` must be one of wrong, exact, none"):
        make_sky("k2-1x-lost", positions="true")


def test_another_draw_of_noise_changes_nothing_else(sky):
    other = make_sky(sky.regime, sky.seed, n_cadences=400, noise_seed=1)
    for name in (
        "time",
        "quality",
        "pos_corr1",
        "x",
        "width",
        "true_flux",
        "aperture",
        "star_light",
    ):
        np.testing.assert_array_equal(getattr(other, name), getattr(sky, name))
    difference = (other.flux - sky.flux) / sky.noise
    assert np.nanstd(difference) == pytest.approx(np.sqrt(2), rel=0.02)


def test_a_star_without_its_transits_shares_everything_else(sky, study):
    without = make_sky(sky.regime.replace(depth=0.0), sky.seed, n_cadences=400)
    np.testing.assert_array_equal(without.true_flux, sky.true_flux / sky.transit)
    for name in ("pos_corr1", "x", "width", "aperture", "neighbor_light", "sky"):
        np.testing.assert_array_equal(getattr(without, name), getattr(sky, name))
    outside = (sky.transit == 1) & np.isfinite(sky.time)
    np.testing.assert_array_equal(without.flux[outside], sky.flux[outside])
    rows = np.isfinite(sky.time)
    raw, alone = (one.flux[:, sky.aperture].sum(axis=1) for one in (sky, without))
    kept = study["depth_difference"](raw, alone, sky.true_flux, sky.transit)
    share = (sky.star_light / (sky.star_light + sky.background_light))[rows][:, sky.aperture]
    assert kept == pytest.approx(np.average(share), abs=0.008)


def test_light_is_averaged_over_exposures():
    """The amplitude of a sine is the sinc of its phase within an exposure."""
    regime = SkyRegime("fast", star="sine", period=0.12, amplitude=0.1)
    flux = make_sky(regime, seed=1, n_cadences=600).true_flux - 1
    x = np.pi * regime.cadence / regime.period
    assert np.sqrt(2) * flux.std() == pytest.approx(0.1 * np.sin(x) / x, rel=2e-3)  # of 0.95


def test_leaks_are_found_with_their_errors(study, one_thread):  # noqa: ARG001
    leak_slopes = study["leak_slopes"]
    # A known slope in slow noise: the pulls of many draws are those of a Gaussian.
    rng = np.random.default_rng(7)
    time = K2Roll.cadence * np.arange(1300)
    nuisances = [np.sin(2 * np.pi * time / 10), red_noise(rng, time, 3.0), time]
    pulls = []
    for _ in range(60):
        slow = 3e-4 * red_noise(rng, time, 2.0) + 1e-3 * rng.normal(size=len(time))
        slopes, errors = leak_slopes(time, slow + 2e-4 * nuisances[1], nuisances)
        pulls.append((slopes - [0, 2e-4, 0]) / errors)
    pulls = np.array(pulls)
    assert 0.8 < np.sqrt(np.mean(pulls**2)) < 1.3
    assert np.mean(np.abs(pulls) < 2) > 0.88
    strong = leak_slopes(time, 1e-3 * nuisances[0] + 1e-5 * rng.normal(size=1300), nuisances)
    np.testing.assert_allclose(strong[0][0], 1e-3, rtol=0.01)
    assert strong[0][0] > 50 * strong[1][0]
    still = leak_slopes(time, nuisances[0], [nuisances[0], np.ones(1300)])
    assert np.isnan(still[:, 1]).all()


def test_image_is_wider_by_its_width():
    rng = np.random.default_rng(4)
    flat = make_response(rng, (15, 15), drop=0.0, scatter=0.0)
    widths = np.array([0.7, 0.999, 1.001, 1.4])
    psf = make_psf(rng, 0.9)
    together = render(flat, psf, *np.full((2, 4), 7.0), widths)
    alone = [render(flat, psf, *np.full((2, 1), 7.0), widths[i : i + 1])[0] for i in range(4)]
    np.testing.assert_allclose(together, alone, atol=1e-6)


def test_true_light_curve_scores_nothing_and_floor_scores_one(sky):
    lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    rows = np.asarray(lc.cadenceno.value) - 1
    noise = np.random.default_rng(5).normal(size=len(rows)) * sky.floor()
    lc.flux = 7.0 * sky.true_flux[rows] * (1 + noise) * lc.flux.unit
    lc.flux_err = 7.0 * sky.true_flux[rows] * sky.floor() * lc.flux.unit
    found = score(lc, sky)
    assert 0.6 < found.high_passed < 1.1
    assert 0.7 < found.full < 1.4
    np.testing.assert_allclose(found.pull, 1, atol=0.1)
    np.testing.assert_allclose(found.depth, 1, atol=0.05)
    assert found.kept == 1


def test_scores_of_a_slow_false_signal_and_of_a_lost_transit():
    time = 0.02 * np.arange(1000)
    transit = np.where((time % 2) < 0.2, 0.99, 1.0)
    variable = 1 + 0.05 * np.sin(2 * np.pi * time / 1.5)
    truth = variable * transit
    noise = 1e-4 * np.random.default_rng(6).normal(size=1000)
    drift = 1 + 0.01 * np.sin(2 * np.pi * time / 15) + noise
    found = score_light_curve(time, truth * drift, 1e-4 * truth, truth, transit, 1e-4)
    assert found.full > 100
    assert found.high_passed < 0.1 * found.full
    assert found.pull > 50
    lost = variable * (0.5 + 0.5 * transit) * (1 + noise)
    found = score_light_curve(time, lost, 1e-4 * truth, truth, transit, 1e-4)
    np.testing.assert_allclose(found.depth, 0.5, atol=0.01)
    erased = 1 + 0.2 * (variable - 1) + noise
    found = score_light_curve(time, erased, 1e-4 * truth, variable, np.ones(1000), 1e-4)
    np.testing.assert_allclose(found.amplitude, 0.2, atol=0.01)
    assert np.isnan(found.depth)


def test_all_nan_light_curve_has_the_worst_score():
    nothing = np.full(200, np.nan)
    found = score_light_curve(np.arange(200.0), nothing, nothing, *np.ones((2, 200)), 1e-4)
    assert found.full == np.inf
    assert found.kept == 0


@pytest.mark.parametrize("part", [0.12, 0.3])
def test_a_light_curve_of_few_cadences(part, study):
    rng = np.random.default_rng(4)
    time, noise = 0.02 * np.arange(3000.0), 1e-4
    flux = 1 + noise * rng.standard_normal(3000)
    flux[rng.random(3000) > part] = np.nan
    one = np.ones(3000)
    found = score_light_curve(time, flux, noise * one, one, one, noise)
    assert found.kept == pytest.approx(part, abs=0.02)
    assert found.pull == pytest.approx(1, abs=0.1)
    if part == 0.12:  # no bin of 6.5 h is half full
        assert found.full == found.high_passed == np.inf
    assert np.isnan(study["leak_slopes"](time, flux, [time])).all() == (part == 0.12)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if number % 3 == 0 else pytest.mark.slow)
        for number, name in enumerate(sorted(REGIMES))
    ],
)
def test_every_regime_makes_a_star(name):
    sky = make_sky(name, seed=1, n_cadences=100)
    assert sky.flux.shape[1:] == REGIMES[name].shape
    assert np.ptp(sky.cadenceno) * REGIMES[name].cadence == pytest.approx(2.0, abs=0.1)
    assert np.isfinite(sky.star_light).all()
    assert np.isnan(sky.x).sum() == REGIMES[name].lost
    assert sky.true_flux.min() > 0
    assert 0 < sky.floor() < 0.02


def test_there_are_at_least_twenty_regimes():
    assert len(REGIMES) >= 20


def test_unknown_regime():
    with pytest.raises(ValueError, match="`regime` must be one of k2-1x-constant"):
        make_sky("no such sky")


def test_too_few_cadences():
    with pytest.raises(ValueError, match="`n_cadences` must be at least 100, got 50"):
        make_sky(SkyRegime("short"), n_cadences=50)


def test_light_curve_without_cadence_numbers(sky):
    lightkurve = pytest.importorskip("lightkurve")
    lc = lightkurve.LightCurve(time=[1.0, 2.0], flux=[1.0, 1.0])
    with pytest.raises(ValueError, match="cadenceno"):
        score(lc, sky)
