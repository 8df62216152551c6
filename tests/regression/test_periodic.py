"""Periodic variability: frequencies against the ones that data were made of."""

from functools import partial

import numpy as np
import pytest

from scope_models.benchmark import REGIMES, make_sky, score
from scope_models.correctors import PLDCorrector, PLDOptions
from scope_models.exceptions import DetrendingWarning
from scope_models.regression._columns import Regressors
from scope_models.regression._periodic import _Rotation, _Waves, find_rotation, find_waves
from scope_models.regression._solution import Solution, fit
from scope_models.regression._variances import Hyperparameters

TIME = 0.0204 * np.arange(900)
TRUE = np.array([1.834, 3.668, 8.21])


def make_solution(y, noise=1e-4):
    """Return a fit with one sawtooth of 6 hours as regressor, at given variances."""
    n = len(y)
    saw = (np.arange(n) % 12 - 5.5)[:, None] / 12
    hyper = Hyperparameters(1.0, np.array([1.0]), 1e-6, 5.0)
    regressors = Regressors(saw, np.zeros(1, dtype=int), ("a",))
    flat = np.ones((n, 1))
    return Solution(
        TIME[:n],
        y,
        np.full(n, noise**2),
        np.ones(n, bool),
        np.zeros(n, bool),
        regressors,
        flat,
        hyper,
    )


def signal(amplitudes, noise, seed=0):
    rng = np.random.default_rng(seed)
    waves = np.cos(2 * np.pi * np.outer(TIME, TRUE) + rng.uniform(0, 6, len(TRUE)))
    saw = 0.01 * (np.arange(len(TIME)) % 12 - 5.5) / 12
    slow = 0.003 * np.sin(TIME / 3)
    return waves @ amplitudes + saw + slow + rng.normal(0, noise, len(TIME))


def test_frequencies_are_found():
    """To an error of sqrt(6 / n) sigma / (pi T A), Montgomery and O'Donoghue 1999."""
    amplitudes, noise = np.array([0.02, 0.005, 0.001]), 1e-4
    solution = make_solution(signal(amplitudes, noise))
    found = np.sort(find_waves(solution, solution.use).frequencies)
    assert len(found) == 3
    error = np.sqrt(6 / len(TIME)) * noise / (np.pi * np.ptp(TIME) * amplitudes)
    assert np.all(np.abs(found - TRUE) < 5 * error)


def test_slow_rotation_is_found():
    """A wave of 3.1 d, which a smooth process would explain as well, and its harmonic."""
    rng = np.random.default_rng(3)
    y = 0.01 * np.sin(2 * np.pi * TIME / 3.1) + 0.004 * np.cos(4 * np.pi * TIME / 3.1)
    solution = make_solution(y + rng.normal(0, 1e-4, len(TIME)))
    found = np.sort(find_waves(solution, solution.use).frequencies)
    np.testing.assert_allclose(found, [1 / 3.1, 2 / 3.1], rtol=1e-3)


def test_a_rotation_is_a_process_of_its_covariance():
    """Sums of its columns' products, beside the wave times the decay of its coherence."""
    rotation = _Rotation.at(base=0.3, turns=2.5, count=2, length=np.ptp(TIME))
    columns, lag = rotation.columns(TIME), TIME[:, None] - TIME
    waves = np.cos(2 * np.pi * 0.3 * lag) + np.cos(4 * np.pi * 0.3 * lag)
    expected = waves * np.exp(-0.5 * (lag / (2.5 / 0.3)) ** 2)
    np.testing.assert_allclose(columns @ columns.T, expected, atol=0.03)


def test_spots_that_drift_are_likelier_as_a_rotation():
    """Waves of constant amplitudes need more frequencies for the same."""
    rng = np.random.default_rng(1)
    true = _Rotation.at(base=0.4, turns=3.0, count=2, length=np.ptp(TIME))
    columns = true.columns(TIME)
    y = 0.01 * columns @ rng.normal(size=columns.shape[1]) + rng.normal(0, 1e-4, len(TIME))
    solution = make_solution(y)
    rotation = find_rotation(solution, solution.with_waves(true, solution.use).unexplained)
    assert rotation.frequencies.mean() / 1.5 == pytest.approx(0.4, abs=0.02)  # 2 harmonics
    waves, use = find_waves(solution, solution.use), solution.use
    value, other = (
        solution.with_waves(each, use).log_likelihood - each.improbability(use.sum())
        for each in (rotation, waves)
    )
    assert value > other + 10


def test_a_random_walk_has_no_frequencies():
    rng = np.random.default_rng(4)
    y = np.cumsum(rng.normal(0, 3e-4, len(TIME))) + rng.normal(0, 1e-4, len(TIME))
    solution = make_solution(y)
    assert not len(find_waves(solution, solution.use).frequencies)


def test_eclipses_are_harmonics_of_one_frequency():
    """Dips of 2 h each 1.31 d, every other one deeper, and a fast mode: no gap in the series."""
    period, rng = 1.31, np.random.default_rng(2)
    y = np.zeros(len(TIME))
    for depth, start in ((0.02, 0.0), (0.012, 0.5)):
        phase = ((TIME / period - start + 0.5) % 1 - 0.5) * period
        y -= depth * np.exp(-0.5 * (phase / 0.04) ** 2)
    y += 0.002 * np.cos(2 * np.pi * 8.21 * TIME) + rng.normal(0, 1e-4, len(TIME))
    solution = make_solution(y)
    found = find_waves(solution, solution.use).frequencies
    np.testing.assert_allclose(found[:12], np.arange(1, 13) / period, rtol=1e-4)
    np.testing.assert_allclose(np.diff(found[:12]), found[0], rtol=1e-9)
    assert np.abs(found[12:] - 8.21).min() < 1e-3


def test_the_last_step_of_a_series_is_less_than_its_error():
    """Ingress and egress of an eclipse are so steep that a small error of the period counts."""
    phase = (TIME / 2.3 + 0.5) % 1 - 0.5
    y = -0.25 * np.clip(1.3 - np.abs(phase) / 0.02, 0, 1)
    solution = make_solution(y + np.random.default_rng(5).normal(0, 1e-4, len(TIME)))
    fit = partial(solution.with_waves, use=solution.use)
    waves = _Waves(base=1.00002 / 2.3, count=50).settled(fit)
    steps = waves._shifted(fit(waves), 0.2)[1]
    assert steps.max() < 1
    assert abs(2.3 * waves.base - 1) < 1e-5


def test_a_second_eclipse_that_is_less_deep_doubles_the_period():
    """Steep eclipses: those of half of the period have the strongest harmonics."""
    y = np.random.default_rng(5).normal(0, 1e-4, len(TIME))
    for depth, start in ((0.25, 0.3), (0.15, 0.8)):
        phase = (TIME / 2.3 - start + 0.5) % 1 - 0.5
        y -= depth * np.clip(1.3 - np.abs(phase) / 0.02, 0, 1)
    solution = make_solution(y)
    found = find_waves(solution, solution.use)
    assert found.base == pytest.approx(1 / 2.3, rel=1e-4)
    rest = solution.with_waves(found, solution.use).unexplained
    assert np.sqrt(np.mean(rest**2)) < 2e-3


def test_steps_of_frequencies_that_share_peaks_lead_upward():
    """A rotation of 0.5 d whose spots change: a band of frequencies, none of them resolved."""
    rng = np.random.default_rng(0)
    size, turn = (np.cumsum(rng.normal(0, 1, len(TIME))) / 30 for _ in range(2))
    y = 0.01 * (size * np.cos(4 * np.pi * TIME) + turn * np.sin(4 * np.pi * TIME))
    solution = make_solution(y + rng.normal(0, 1e-4, len(TIME)))
    waves = _Waves(tuple(np.arange(1.5, 2.5, 1 / np.ptp(TIME))))
    fit = partial(solution.with_waves, use=solution.use)
    assert fit(waves.settled(fit)).log_likelihood > fit(waves).log_likelihood + 1000


def test_noise_roll_and_slow_change_have_no_frequencies():
    for seed in range(5):
        solution = make_solution(signal(np.zeros(3), 1e-4, seed))
        assert len(find_waves(solution, solution.use).frequencies) == 0


def test_single_outliers_do_not_hide_a_pulsation():
    y = signal(np.array([0.002, 0, 0]), 1e-4)
    y[[100, 333, 620]] += [0.3, -0.1, 0.2]
    solution = make_solution(y)
    assert find_waves(solution, solution.use).frequencies == pytest.approx([TRUE[0]], abs=1e-4)


def test_fast_modes_are_no_multiples_of_one():
    """Four modes of a delta Scuti star, of which one alone is below half of the fastest."""
    modes, rng = np.array([12.183, 13.395, 13.788, 14.207]), np.random.default_rng(4)
    waves = np.cos(2 * np.pi * np.outer(TIME, modes) + rng.uniform(0, 6, 4))
    y = waves @ [0.003, 0.002, 0.004, 0.003] + rng.normal(0, 1e-4, len(TIME))
    solution = make_solution(y)
    found = np.sort(find_waves(solution, solution.use).frequencies)
    np.testing.assert_allclose(found, modes, atol=1e-3)


def test_frequencies_of_variability_at_all_frequencies_are_less_likely_than_a_process():
    rng = np.random.default_rng(3)
    y = np.empty(len(TIME))
    y[0] = 0.0
    for k in range(1, len(y)):
        y[k] = 0.95 * y[k - 1] + 1e-3 * rng.normal()
    solution = make_solution(y, 3e-4)
    assert len(find_waves(solution, solution.use).frequencies) > 5
    data = TIME, y, solution.variance, solution.use, np.empty((len(y), 0))
    found = fit(lambda use: solution.regressors, *data, PLDOptions())  # noqa: ARG005
    assert found.frequencies == ()


def test_columns_of_waves():
    columns = _Waves((1.0, 2.0)).columns(np.array([0.0, 0.25]))
    np.testing.assert_allclose(columns, [[1, 0, 1, 0], [0, 1, -1, 0]], atol=1e-15)


def test_harmonics_of_jumps():
    """Exposures of a square wave: its Fourier series, each term averaged over an exposure."""
    time = np.arange(1000) / 100
    series = _Waves(base=1.0, count=199).columns(time)[:, 1::4]  # sines of odd harmonics
    fraction = np.mod(time[:, None] + np.linspace(-0.005, 0.005, 1001), 1)
    exposures = np.mean(np.where(fraction < 0.5, 1.0, -1.0), axis=1)
    np.testing.assert_allclose(4 / np.pi * series.sum(axis=1), exposures, atol=0.02)


def test_pulsating_star_keeps_its_cadences():
    """Without a model of its pulsation, 60 % of the cadences of such a star were clipped."""
    sky = make_sky("k2-1x-rr-lyrae", seed=0, n_cadences=500)
    corrector = PLDCorrector(sky.to_tpf())
    lc = corrector.correct()
    result, found = corrector.result, score(lc, sky)
    assert result.n_outliers <= 2
    # times here are from the first cadence on; the frequencies are harmonics of 1 / 0.55 d
    harmonics = np.array(result.frequencies) * 0.55
    assert np.abs(harmonics - np.round(harmonics)).max() < 1e-3
    assert found.amplitude == pytest.approx(1, abs=2e-4)
    assert 0.8 < found.pull < 1.2  # 0.95


def test_periodic_variability_stays_without_trend():
    sky = make_sky("k2-1x-delta-scuti", seed=1, n_cadences=500)
    corrector = PLDCorrector(sky.to_tpf())
    lc = corrector.correct(restore_trend=False)
    assert corrector.result.frequencies
    assert score(lc, sky).amplitude == pytest.approx(1, abs=0.002)  # 5e-4
    assert np.nanstd(corrector.result.periodic) > 1000 * np.nanstd(corrector.result.trend)


@pytest.mark.filterwarnings("ignore:.*outliers|the noise has:UserWarning")
@pytest.mark.parametrize("period", [1.4, pytest.param(2.3, marks=pytest.mark.slow)])
def test_unmasked_eclipses_keep_their_depth(period):
    """What is left of sharp eclipses in 700 cadences differs from star to star: 1.0 to 1.9."""
    regime, full = REGIMES["k2-1x-eclipsing"].replace(period=period), []
    for seed in (5, 6, 7):
        sky = make_sky(regime, seed=seed, n_cadences=700)
        corrector = PLDCorrector(sky.to_tpf())
        found, result = score(corrector.correct(), sky), corrector.result
        assert found.amplitude == pytest.approx(1, abs=0.002)
        # cadences that are taken back as no outliers are none beside each other, either
        assert np.std(result.solution.pulls[result.solution.counted]) < 1.2
        full.append(found.full)
    assert np.median(full) < 1.5


def test_a_random_walk_is_no_noise():
    """Stars whose flux walks by many times the noise from cadence to cadence."""
    pulls, warning = [], "the noise has .* times the variance of FLUX_ERR"
    for seed in range(5, 9):
        sky = make_sky(REGIMES["k2-1x-walk-20d"], seed, n_cadences=800)
        corrector = PLDCorrector(sky.to_tpf())
        with pytest.warns(DetrendingWarning, match=warning):
            lc = corrector.correct()
        assert corrector.result.noise_scale < 2  # 60 without a walk
        pulls.append(score(lc, sky).pull)
    # one star's errors are those of few coefficients: its pull scatters by a quarter
    assert max(pulls) < 1.5
    assert np.sqrt(np.mean(np.square(pulls))) > 0.7  # 0.89
