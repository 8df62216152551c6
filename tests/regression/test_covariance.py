"""The linear-time covariance against dense matrices."""

import numpy as np
import pytest

from scope_models.regression._covariance import FORGOTTEN, Covariance

AMPLITUDE, PERIOD, WALK = 2.3, 1.7, 0.4


def kernel(t_1, t_2, amplitude=AMPLITUDE, period=PERIOD, walk=WALK):
    """Return the kernel of oscillator and random walk by its defining equation."""
    w = np.sqrt(2) * np.pi / period
    tau = np.abs(t_1[:, None] - t_2)
    oscillator = amplitude * np.exp(-w * tau) * (np.cos(w * tau) + np.sin(w * tau))
    return oscillator + walk * FORGOTTEN * np.exp(-tau / FORGOTTEN)


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
        return Covariance(time, variance, 0.0, PERIOD), np.diag(variance)
    dense = kernel(time, time) + np.diag(variance)
    return Covariance(time, variance, AMPLITUDE, PERIOD, WALK), dense


def test_solve(both, problem):
    found, dense = both
    columns = problem[2]
    z = found.whiten(columns)
    solved = found.solve_whitened(z)
    np.testing.assert_allclose(solved, np.linalg.solve(dense, columns), atol=1e-12)
    np.testing.assert_allclose(z.T @ z, columns.T @ np.linalg.solve(dense, columns), atol=1e-11)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-11)


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
    found = Covariance(time, variance, AMPLITUDE, PERIOD, WALK).predict(alpha, other)
    np.testing.assert_allclose(found, kernel(other, time) @ alpha, atol=1e-11)


def test_gradient(problem):
    time, variance, columns = problem
    root = np.random.default_rng(2).normal(size=(3, 3))

    def value(variance, *logarithms):
        dense = kernel(time, time, *np.exp(logarithms)) + np.diag(variance)
        gram = columns.T @ np.linalg.solve(dense, columns)
        return 0.5 * np.sum(root @ root.T * gram) + 0.5 * np.linalg.slogdet(dense)[1]

    process = Covariance(time, variance, AMPLITUDE, PERIOD, WALK)
    by_variance, *slopes = process.gradient(process.whiten(columns) @ root)
    at, h = np.log([AMPLITUDE, PERIOD, WALK]), 1e-5
    for slope, step in zip(slopes, h * np.eye(3), strict=True):
        numeric = (value(variance, *(at + step)) - value(variance, *(at - step))) / (2 * h)
        assert slope == pytest.approx(numeric, rel=1e-6)
    step = h * np.eye(60)[7]
    numeric = (value(variance + step, *at) - value(variance - step, *at)) / (2 * h)
    assert by_variance[7] == pytest.approx(numeric, rel=1e-6)
