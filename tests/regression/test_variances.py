"""Likelihood and predictions against dense linear algebra."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from scope_models.correctors._model import Settings
from scope_models.regression import _variances
from scope_models.regression._columns import Regressors
from scope_models.regression._solution import Solution, fit
from scope_models.regression._variances import (
    FORGOTTEN,
    Data,
    Hyperparameters,
    fit_hyperparameters,
)

pytestmark = pytest.mark.usefixtures("one_thread")

N = 90


def log_likelihood(data, hyper):
    return _variances.log_likelihood(data, hyper)[0]


def flat_variance(data):
    """Flat means a standard deviation of some thirty times the data's."""
    weights = data.variance / (data.variance + data.doubt)
    square = (data.y - np.average(data.y, weights=weights)) ** 2
    return 1e3 * max(np.average(square, weights=weights), np.median(data.variance))


def dense_covariance(data, hyper):
    """Return the covariance of the data, from its definition."""
    dense = np.diag(hyper.noise_scale * data.variance + data.doubt)
    w = np.sqrt(2) * np.pi / hyper.period
    tau = np.abs(data.time[:, None] - data.time)
    dense += hyper.amplitude * np.exp(-w * tau) * (np.cos(w * tau) + np.sin(w * tau))
    dense += hyper.walk * FORGOTTEN * np.exp(-tau / FORGOTTEN)
    prior = np.append(hyper.variances[data.groups], np.full(data.n_flat, flat_variance(data)))
    return dense + data.columns * prior @ data.columns.T


@pytest.fixture
def data():
    rng = np.random.default_rng(5)
    time = np.sort(rng.uniform(0, 9, N))
    time[0] = 0
    columns = np.concatenate([rng.normal(size=(N, 7)), np.ones((N, 1))], axis=1)
    groups = np.array([0, 0, 0, 0, 1, 1, 1])
    y = columns[:, :4] @ rng.normal(0, 2, 4) + rng.normal(0, 1, N)
    return Data(time, y, rng.uniform(0.5, 1.5, N), columns, groups, 1)


@pytest.fixture(params=["gp", "none"])
def hyper(request):
    amplitude, walk = (0.7, 0.3) if request.param == "gp" else (0.0, 0.0)
    return Hyperparameters(1.3, np.array([3.0, 0.2]), amplitude, 2.5, walk)


def shifted(hyper, index, step):
    """Move the logarithm of one hyper-parameter."""
    factor = np.exp(step)
    if index == 0:
        return replace(hyper, noise_scale=hyper.noise_scale * factor)
    if index <= 2:
        variances = hyper.variances.copy()
        variances[index - 1] *= factor
        return replace(hyper, variances=variances)
    name = ("amplitude", "period", "walk")[index - 3]
    return replace(hyper, **{name: getattr(hyper, name) * factor})


def test_log_likelihood(data, hyper):
    expected = multivariate_normal(cov=dense_covariance(data, hyper)).logpdf(data.y)
    assert log_likelihood(data, hyper) == pytest.approx(expected, rel=1e-10)


def test_log_likelihood_gradient(data, hyper):
    _, slope = _variances.log_likelihood(data, hyper)
    assert len(slope) == 6
    for k, found in enumerate(slope):
        up, down = (log_likelihood(data, shifted(hyper, k, h)) for h in (1e-5, -1e-5))
        assert found == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-6)


def test_slopes_of_the_hyperprior(data):
    """Of parameters beyond their limits, and on both sides of what is expected."""
    data = replace(data, expected=np.array([1.0, np.nan]), most=2.0, noise_errors=(0.16, 0.3))
    for hyper in (
        Hyperparameters(0.8, np.array([3.0, 0.5]), 0.7, 11.0),
        Hyperparameters(1.3, np.array([0.2, 2.5]), 0.7, 2.5),
    ):
        found = data.improbability(hyper.noise_scale, hyper.variances, hyper.period)[1]
        assert (found[-1] > 0) == (hyper.period > 5)
        for slope, k in zip(found, (0, 1, 2, 4), strict=True):
            up, down = (shifted(hyper, k, h).improbability(data) for h in (1e-5, -1e-5))
            assert slope == pytest.approx((up - down) / 2e-5, rel=1e-4, abs=1e-6)


def test_a_slow_process_may_have_long_periods():
    """Twelve days are beyond the prior's limit, which strong variability outweighs."""
    found = []
    for amplitude in (1e-2, 1e8):
        truth = Hyperparameters(1.0, np.full(2, 0.1), amplitude, 12.0)
        found.append(fit_hyperparameters(draw(1500, np.random.default_rng(2), truth)).period)
    assert found[0] < 6
    assert 7 < found[1] < 13


def draw(n, rng, hyper):
    """Draw data from the model itself."""
    time = 0.02 * np.arange(n)
    columns = np.concatenate([rng.normal(size=(n, 40)), np.ones((n, 1))], axis=1)
    groups = np.repeat([0, 1], 20)
    data = Data(time, np.zeros(n), np.ones(n), columns, groups, 1)
    covariance = dense_covariance(data, replace(hyper, variances=hyper.variances * 1.0))
    covariance -= flat_variance(data)  # no offset
    return replace(data, y=np.linalg.cholesky(covariance) @ rng.normal(size=n))


def test_fit_finds_what_data_were_drawn_with():
    truth = Hyperparameters(1.4, np.array([4.0, 0.25]), 9.0, 3.0)
    found = []
    for seed in range(6):
        data = draw(500, np.random.default_rng(seed), truth)
        fitted = fit_hyperparameters(data)
        assert log_likelihood(data, fitted) > log_likelihood(data, truth) - 0.3
        found.append([fitted.noise_scale, *fitted.variances, fitted.amplitude, fitted.period])
    logs = np.log(found) - np.log([1.4, 4.0, 0.25, 9.0, 3.0])
    # 500 data, 20 coefficients each, a handful of periods; six draws
    assert np.all(np.abs(logs.mean(axis=0)) < [0.1, 0.4, 0.4, 0.9, 0.4])


def test_averages(data):
    few = data.averaged(4)
    assert len(few.y) == N // 4
    np.testing.assert_allclose(few.y[3], data.y[12:16].mean())
    np.testing.assert_allclose(few.time[-1], data.time[84:88].mean())
    np.testing.assert_allclose(few.variance[0], data.variance[:4].mean() / 4)
    np.testing.assert_allclose(few.columns[1], data.columns[4:8].mean(axis=0))


def test_means_of_many_cadences_find_the_same(monkeypatch):
    """A search in means of four is as likely to a few units of the logarithm."""
    rng = np.random.default_rng(7)
    time, variance = 0.0007 * np.arange(6000), np.ones(6000)
    slow = np.stack([np.sin((k + 1) * time) for k in range(8)], axis=1)
    columns = np.concatenate([slow, np.ones((6000, 1))], axis=1)
    truth = Hyperparameters(1.3, np.array([9.0]), 4.0, 1.0)
    y = slow @ rng.normal(0, 3, 8) + rng.normal(0, 1.3**0.5, 6000)
    y += 2 * np.sin(2 * np.pi * time / 0.9 + 1)
    data = Data(time, y - y.mean(), variance, columns, np.zeros(8, dtype=int), 1)
    values = []
    for enough in (10_000, 1500):
        monkeypatch.setattr(_variances, "_ENOUGH", enough)
        values.append(log_likelihood(data, fit_hyperparameters(data)))
    assert values[1] == pytest.approx(values[0], abs=0.2)
    assert values[1] > log_likelihood(data, truth) - 0.3


def test_compression_keeps_the_likelihood(data, monkeypatch):
    hyper = Hyperparameters(1.3, np.array([3.0, 0.2]), 0.7, 2.5)
    z = hyper.process(data).whiten(data.stacked)
    monkeypatch.setattr(_variances, "_SMALLEST", 1e-12)
    small = _variances._compressed(z.T @ z, data, hyper)
    same = replace(hyper, variances=np.ones(1))
    assert log_likelihood(small, same) == pytest.approx(log_likelihood(data, hyper), rel=1e-12)


def test_compression_keeps_a_column_of_tiny_priors(data):
    """Without a column the gradient would be shorter than its parameters."""
    tiny = Hyperparameters(1.3, np.full(2, 1e-12), 0.7, 2.5)
    z = tiny.process(data).whiten(data.stacked)
    small = _variances._compressed(z.T @ z, data, tiny)
    assert small.groups.tolist() == [0]
    same = replace(tiny, variances=np.ones(1))
    _, slope = _variances.log_likelihood(small, same)
    assert slope.shape == (5,)


@pytest.fixture
def solution(data, hyper):
    """Return a solution with given hyper-parameters; one of ten cadences counts less.

    One of ten is not in the fit.
    """
    use, doubt = np.arange(N) % 10 != 3, np.where(np.arange(N) % 10 == 7, 2.0, 0.0)
    regressors = Regressors(data.columns[:, :7], data.groups, ("a", "b"))
    flat = data.columns[:, 7:]
    return Solution(data.time, data.y, data.variance, use, doubt, regressors, flat, hyper)


def test_held_out_windows(solution):
    dense = dense_covariance(solution.data, solution.hyper)
    residual, covariance = solution.held_out(13, solution.use)
    y = solution.data.y
    assert len(residual) == len(y) // 13
    for k in range(len(residual)):
        inside = np.arange(13 * k, 13 * k + 13)
        rest = np.setdiff1d(np.arange(len(y)), inside)
        weights = np.linalg.solve(dense[np.ix_(rest, rest)], dense[np.ix_(rest, inside)])
        np.testing.assert_allclose(residual[k], y[inside] - weights.T @ y[rest], atol=1e-8)
        expected = dense[np.ix_(inside, inside)] - weights.T @ dense[np.ix_(rest, inside)]
        expected -= np.diag(solution.data.doubt[inside])
        np.testing.assert_allclose(covariance[k], expected, atol=1e-8)


def test_model_and_its_variance(solution):
    whole = replace(solution, use=np.ones(N, dtype=bool))
    hyper, use = solution.hyper, solution.use
    noise = np.diag(hyper.noise_scale * whole.variance + whole.doubt)
    latent = dense_covariance(whole.data, hyper) - noise
    noisy = (latent + noise)[np.ix_(use, use)]
    gain = np.linalg.solve(noisy, latent[use]).T
    model = solution.systematics + solution.flat[:, 0] * solution.posterior.mean[-1]
    model = model + solution.process.predict(solution.alpha, solution.time)
    np.testing.assert_allclose(model, gain @ solution.y[use], atol=1e-8)
    x = solution.regressors.columns
    prior = hyper.variances[solution.regressors.groups]
    part = (x * prior) @ x.T
    expected = np.diag(part - part[:, use] @ np.linalg.solve(noisy, part[use]))
    np.testing.assert_allclose(solution.systematics_variance, expected, rtol=1e-7)


@pytest.mark.parametrize("trend", [False, True])
def test_variance_of_what_is_left(solution, trend):
    """Noise and the error of the model, which has followed some of the noise."""
    whole = replace(solution, use=np.ones(N, dtype=bool))
    use, white = solution.use, np.diag(solution.white_variance)
    noise = white + np.diag(solution.doubt)
    latent = dense_covariance(whole.data, solution.hyper) - noise
    x = solution.regressors.columns
    part = latent if trend else x * solution.hyper.variances[solution.regressors.groups] @ x.T
    gain = np.zeros((N, N))
    gain[:, use] = np.linalg.solve((latent + noise)[np.ix_(use, use)], part[use]).T
    one = np.eye(N)
    # what is left less what shall be: noise, and the part less what is predicted of it
    expected = (one - gain) @ white @ (one - gain).T + gain @ np.diag(solution.doubt) @ gain.T
    rest = latent - part
    expected += (one - gain) @ part @ (one - gain).T + gain @ rest @ gain.T
    variance = solution.variance_left(trend=trend)
    np.testing.assert_allclose(variance, np.diag(expected), rtol=1e-4)


def test_parameters_and_variances_of_groups(solution):
    used = solution.effective_parameters()
    x = solution.data.columns[:, :7]
    dense = dense_covariance(solution.data, solution.hyper)
    for g in (0, 1):
        member = solution.data.groups == g
        part = solution.hyper.variances[g] * x[:, member] @ x[:, member].T
        assert used[g] == pytest.approx(np.trace(np.linalg.solve(dense, part)), rel=1e-9)
        values = part @ solution.data.columns[:, 0] * 0 + part @ np.linalg.solve(
            dense, solution.data.y
        )
        assert solution.group_variances()[g] == pytest.approx(np.var(values), rel=1e-7)


def test_transit_coefficient(solution):
    column = np.where(np.abs(solution.time - 4) < 0.5, -0.02, 0.0)[:, None]
    solution = replace(solution, n_trend=solution.flat.shape[1])
    found, error = solution.with_flat(column, solution.use).transit_coefficient()
    solution = replace(solution, doubt=np.where(column[:, 0] < 0, 0.0, solution.doubt))
    dense = dense_covariance(solution.data, solution.hyper)
    m = column[solution.use, 0]
    precision = m @ np.linalg.solve(dense, m) + 0.02**2 / flat_variance(solution.data)
    assert error == pytest.approx(precision**-0.5, rel=1e-8)
    expected = m @ np.linalg.solve(dense, solution.data.y) / precision
    assert found == pytest.approx(expected, rel=1e-8)


def test_outliers_are_clipped(data):
    y = data.y.copy()
    y[[11, 50]] += [30, -40]
    columns = data.columns[:, :7]

    def make(use):
        return Regressors(columns - columns[use].mean(axis=0), data.groups, ("a", "b"))

    options = Settings()
    use = np.ones(N, dtype=bool)
    use[60] = False
    solution = fit(make, data.time, y, data.variance, use, np.empty((N, 0)), options)
    assert set(np.flatnonzero(~solution.use)) == {11, 50, 60}
    kept = fit(
        make, data.time, y, data.variance, use, np.empty((N, 0)), replace(options, max_clips=0)
    )
    assert kept.use.sum() == N - 1


def test_search_from_a_strong_process_finds_nothing_better():
    """Dips that repeat fast look like noise to a search that begins with a faint process."""
    rng, n = np.random.default_rng(0), 600
    time = 0.0204 * np.arange(n)
    y = np.log(np.where(np.arange(n) // 7 % 4 == 0, 0.7, 1.0))
    columns = np.column_stack([0.02 * rng.normal(size=(n, 7)), np.ones(n)])
    y = y - y.mean() + 3e-4 * rng.normal(size=n)
    data = Data(time, y, np.full(n, 9e-8), columns, np.zeros(7, dtype=int), 1)
    start = Hyperparameters(1.0, data.spread / data.sizes, data.spread, 5.0)
    strong = log_likelihood(data, fit_hyperparameters(data, start))
    assert log_likelihood(data, fit_hyperparameters(data)) > strong - 0.1


def test_steps_without_a_bound_may_overflow():
    """Where the likelihood rises forever, the search ends before numbers do, without a warning."""

    def objective(theta):
        return -np.log(np.exp(theta)).sum(), np.full_like(theta, -1.0)

    found = _variances._minimize(objective, [1.0, 2.0], [(-5.0, np.inf), (-np.inf, 3.0)], 1e9)
    assert np.isfinite(found).all()
    assert found[1] == pytest.approx(np.exp(3))


def test_a_covariance_that_is_none_is_an_error_of_numpy():
    for variance in (-np.ones(3), np.full(3, np.nan)):
        with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
            _variances.Covariance(np.arange(3.0), variance, 0.1, 5.0)
