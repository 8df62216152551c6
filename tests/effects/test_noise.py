"""Noise against exact probabilities, moments and the independence of the streams."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm, poisson

from scope_models import Detector, Motion, Star, simulate
from scope_models.effects._noise import (
    NOISE_TERMS,
    add_quantization,
    fresh_seed,
    noise_terms,
    poisson_counts,
    poisson_quantile,
    stream,
)


def test_streams_are_named_and_reproducible():
    first = stream(7, "photon").standard_normal(1000)
    assert np.array_equal(first, stream(7, "photon").standard_normal(1000))
    # Independent: |r| < 4.5 / sqrt(1000).
    for other in (stream(7, "read"), stream(8, "photon")):
        assert abs(np.corrcoef(first, other.standard_normal(1000))[0, 1]) < 0.14


def test_streams_do_not_depend_on_the_length_of_the_pieces():
    whole = stream(3, "read").standard_normal((100, 5, 7))
    generator = stream(3, "read")
    pieces = [generator.standard_normal((n, 5, 7)) for n in (1, 30, 69)]
    assert np.array_equal(whole, np.concatenate(pieces))


@pytest.mark.parametrize(
    "seed, error, message",
    [
        (-1, ValueError, "`seed` must be at least 0, got -1"),
        (1.5, TypeError, r"`seed` must be an integer, got 1\.5"),
        (True, TypeError, "`seed` must be an integer"),
        ("1", TypeError, "`seed` must be an integer"),
    ],
)
def test_bad_seeds(seed, error, message):
    with pytest.raises(error, match=message):
        stream(seed, "read")


def test_fresh_seeds_differ():
    assert len({fresh_seed() for _ in range(20)}) == 20


@pytest.mark.parametrize(
    "noise, expected",
    [
        (True, {"photon", "background", "read"}),
        (np.True_, {"photon", "background", "read"}),
        (False, set()),
        ((), set()),
        ("photon", {"photon"}),
        (NOISE_TERMS, set(NOISE_TERMS)),
        ({"read": 1}, {"read"}),
    ],
)
def test_noise_terms(noise, expected):
    assert noise_terms(noise) == expected


def test_bad_noise_terms():
    with pytest.raises(ValueError, match=r"`noise` must hold names out of photon.*got shot"):
        noise_terms(["photon", "shot"])
    with pytest.raises(TypeError, match="`noise` must be True, False or names"):
        noise_terms(3)


@pytest.mark.parametrize("mean", [1e-12, 1e-4, 0.1, 3.0, 29.9, 30.0, 100.0, 1e3, 1e5])
def test_quantile_against_exact_inverse(mean):
    deviate = np.linspace(-6, 6, 40001)
    # The survival function keeps the precision of large deviates.
    low, high = deviate[deviate < 0], deviate[deviate >= 0]
    exact = np.append(poisson.ppf(norm.cdf(low), mean), poisson.isf(norm.sf(high), mean))
    counts = poisson_quantile(deviate, mean)
    assert np.all(np.abs(counts - np.maximum(exact, 0)) <= 1)
    wrong = np.average(counts != np.maximum(exact, 0), weights=norm.pdf(deviate))
    assert wrong <= (0 if mean < 30 else 2e-4 * (30 / mean) ** 1.5)


@pytest.mark.parametrize("mean", [0.1, 3.0, 30.0, 150.0, 1e3, 1e6])
def test_poisson_noise_has_the_exact_distribution(mean):
    n = 200_000
    counts = poisson_counts(np.full(n, mean), stream(11, "photon"))
    assert np.array_equal(counts, np.rint(counts))
    # Pearson's chi-squared over bins of nearly equal probability.
    edges = np.unique(poisson.ppf(np.linspace(0, 1, 41)[1:-1], mean))
    probability = np.diff(poisson.cdf(edges, mean), prepend=0, append=1)
    observed = np.bincount(np.searchsorted(edges, counts), minlength=len(edges) + 1)
    statistic = np.sum((observed - n * probability) ** 2 / (n * probability))
    assert 1e-4 < chi2.sf(statistic, len(edges)) < 1 - 1e-4
    # Mean, variance and third central moment, all equal to the mean; 4.5 standard errors.
    assert abs(counts.mean() - mean) < 4.5 * np.sqrt(mean / n)
    assert abs(counts.var() - mean) < 4.5 * np.sqrt((mean + 2 * mean**2) / n)
    third = ((counts - mean) ** 3).mean()
    sixth_moment = mean + 25 * mean**2 + 15 * mean**3
    assert abs(third - mean) < 4.5 * np.sqrt(sixth_moment / n)


def test_poisson_noise_uses_one_deviate_per_pixel():
    means = np.geomspace(1e-12, 1e7, 6 * 35).reshape(6, 5, 7)
    for mean in (means, means[::-1].copy(), np.zeros((6, 5, 7))):
        used, reference = stream(1, "photon"), stream(1, "photon")
        poisson_counts(mean, used)
        reference.standard_normal(mean.shape)
        assert used.standard_normal() == reference.standard_normal()


def test_changed_mean_leaves_other_counts():
    mean = np.geomspace(0.1, 1e6, 1000)
    dimmed = mean.copy()
    dimmed[500] *= 0.5
    difference = poisson_counts(mean, stream(1, "photon")) - poisson_counts(
        dimmed, stream(1, "photon")
    )
    assert np.flatnonzero(difference).tolist() == [500]


def test_no_light_gives_no_counts():
    assert not poisson_counts(np.zeros(100_000), stream(2, "photon")).any()


def test_quantile_broadcasts():
    deviate = stream(5, "x").standard_normal((4, 3, 2))
    mean = np.array([[0.5, 1e3], [20.0, 50.0], [1e-6, 1e6]])
    together = poisson_quantile(deviate, mean)
    single = [[poisson_quantile(deviate[:, j, i], mean[j, i]) for i in range(2)] for j in range(3)]
    assert np.array_equal(together, np.moveaxis(single, -1, 0))


def test_read_noise_is_normal():
    detector = Detector.k2(read_noise=90.0, background=0.0)
    observation = simulate(Star(40.0), detector, Motion.still(800), seed=1, noise="read")
    noise = observation.flux.ravel() * detector.exposure_time
    assert kstest(noise, norm(0, 90 * np.sqrt(270)).cdf).pvalue > 1e-3


@pytest.mark.parametrize("n_reads", [1, 9, 270])
def test_quantization_against_rounding_every_read(n_reads):
    gain, n = 110.0, 4000
    generator = np.random.default_rng(5)
    per_read = generator.uniform(1000, 2000, (n, 1)) + 300 * generator.standard_normal((n, n_reads))
    exact = per_read.sum(axis=1)
    rounded = gain * np.rint(per_read / gain).sum(axis=1)
    ours = add_quantization(exact.copy(), gain, n_reads, stream(1, "quantization"))
    # Whole numbers of the gain.
    assert np.allclose(ours / gain, np.rint(ours / gain), rtol=0, atol=1e-9)
    expected = gain * np.sqrt(n_reads / 12)
    for error in (ours - exact, rounded - exact):
        assert abs(error.mean()) < 4.5 * expected / np.sqrt(n)
        # The standard error of a variance is at most sqrt(2 / n) of it.
        assert abs(error.var() / expected**2 - 1) < 4.5 * np.sqrt(2 / n)
