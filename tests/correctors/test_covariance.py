"""The linear-time covariance against dense matrices."""

import numpy as np
import pytest

from scope_models.correctors._covariance import Covariance, Noise, RandomWalk

AMPLITUDE, PERIOD = 2.3, 1.7


def kernel(t_1, t_2, amplitude=AMPLITUDE, period=PERIOD):
    """Return the oscillator's kernel by its defining equation."""
    w = np.sqrt(2) * np.pi / period
    tau = np.abs(t_1[:, None] - t_2)
    return amplitude * np.exp(-w * tau) * (np.cos(w * tau) + np.sin(w * tau))


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    time = np.sort(rng.uniform(0, 5, 60))
    variance = rng.uniform(0.5, 1, 60)
    return time, variance, rng.normal(size=(60, 3))


@pytest.fixture(params=["process", "noise"])
def both(request, problem):
    """Return the object under test and the dense matrix."""
    time, variance, _ = problem
    if request.param == "noise":
        return Noise(variance), np.diag(variance)
    return Covariance(time, variance, AMPLITUDE, PERIOD), kernel(time, time) + np.diag(variance)


def test_solve(both, problem):
    found, dense = both
    columns = problem[2]
    np.testing.assert_allclose(found.solve(columns), np.linalg.solve(dense, columns), atol=1e-12)
    z = found.whiten(columns)
    np.testing.assert_allclose(z.T @ z, columns.T @ np.linalg.solve(dense, columns), atol=1e-11)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-11)


def test_random_walk(problem):
    time, variance, columns = problem
    other = np.sort(np.random.default_rng(1).uniform(-1, 6, 20))

    def exponential(t_1, t_2):
        return AMPLITUDE * np.exp(-np.abs(t_1[:, None] - t_2) / PERIOD)

    dense = exponential(time, time) + np.diag(variance)
    found = RandomWalk(time, variance, AMPLITUDE, PERIOD)
    solved = np.linalg.solve(dense, columns)
    np.testing.assert_allclose(found.solve(columns), solved, atol=1e-12)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-11)
    np.testing.assert_allclose(found.inverse_diagonal(), np.diag(np.linalg.inv(dense)), atol=1e-12)
    expected = exponential(other, time) @ solved[:, 0]
    np.testing.assert_allclose(found.predict(solved[:, 0], other), expected, atol=1e-11)


@pytest.mark.parametrize("starts", [[0, 13, 26, 47], [5], [0]])
def test_inverse_blocks(both, starts):
    found, dense = both
    inverse = np.linalg.inv(dense)
    blocks = found.inverse_blocks(np.array(starts), 13)
    for start, block in zip(starts, blocks, strict=True):
        part = slice(start, start + 13)
        np.testing.assert_allclose(block, inverse[part, part], atol=1e-12)


def test_inverse_diagonal(both):
    found, dense = both
    expected = np.diag(np.linalg.inv(dense))
    np.testing.assert_allclose(found.inverse_diagonal(), expected, atol=1e-12)


def test_predict(problem):
    time, variance, columns = problem
    other = np.sort(np.random.default_rng(1).uniform(-1, 6, 20))
    alpha = np.linalg.solve(kernel(time, time) + np.diag(variance), columns[:, 0])
    found = Covariance(time, variance, AMPLITUDE, PERIOD).predict(alpha, other)
    np.testing.assert_allclose(found, kernel(other, time) @ alpha, atol=1e-11)


def test_gradient(problem):
    time, variance, columns = problem
    weights = np.random.default_rng(2).normal(size=(3, 3))
    weights = weights + weights.T

    def value(variance, log_amplitude, log_period):
        dense = kernel(time, time, np.exp(log_amplitude), np.exp(log_period)) + np.diag(variance)
        gram = columns.T @ np.linalg.solve(dense, columns)
        return np.sum(weights * gram) + 0.5 * np.linalg.slogdet(dense)[1]

    process = Covariance(time, variance, AMPLITUDE, PERIOD)
    by_variance, by_amplitude, by_period = process.gradient(
        columns, process.whiten(columns), weights
    )
    a, p, h = np.log(AMPLITUDE), np.log(PERIOD), 1e-5
    numeric = (value(variance, a + h, p) - value(variance, a - h, p)) / (2 * h)
    assert by_amplitude == pytest.approx(numeric, rel=1e-6)
    numeric = (value(variance, a, p + h) - value(variance, a, p - h)) / (2 * h)
    assert by_period == pytest.approx(numeric, rel=1e-6)
    step = h * np.eye(60)[7]
    numeric = (value(variance + step, a, p) - value(variance - step, a, p)) / (2 * h)
    assert by_variance[7] == pytest.approx(numeric, rel=1e-6)
