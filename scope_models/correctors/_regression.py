"""Bayesian linear regression with one prior variance per group of columns."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri, dtrtrs
from scipy.optimize import minimize

from scope_models.correctors._long_term import LongTerm, Noise

__all__ = [
    "Data",
    "Hyperparameters",
    "Posterior",
    "fit_columns",
    "fit_hyperparameters",
    "log_likelihood",
]

#: Twice as many cadences are averaged before the search: what is slow and how strong each group
#: is shows in the means.
_ENOUGH = 4000
#: A search ends when a step improves the likelihood's logarithm by about so much.
_PRECISION = 1e-3
#: Steps of a search at most, and of those that only tell which start is the best.
_STEPS, _FEW_STEPS = 60, 10
#: Bound of the period in days: what is faster than a transit is not a trend.
_SHORTEST_PERIOD = 0.5
#: Variances of a group's part that are tried against others, in units of the data's.
_SCAN = (1e-3, 0.03, 1.0, 30.0, 300.0)
#: Where the search begins: the process' variance, and that of each group's part of the model,
#: in units of the data's; and the process' period in days.
_STARTS = ((None, 1.0, 5.0), (0.3, 0.1, 2.0), (1.0, 1.0, 5.0))
#: The largest variance of a group's part, in the same unit. More is not needed, and less
#: well conditioned.
_LARGEST = 1e3
#: The prior variance of the columns with flat priors, in the same unit.
_FLAT = 1e4


@dataclass(frozen=True)
class Data:
    """
    What is regressed on what.

    Parameters
    ----------
    time : ndarray
        Increasing times in days, from zero.
    y : ndarray
        Data, near zero.
    variance : ndarray
        Variance of their white noise.
    columns : ndarray
        ``(n, r)``; the first ones belong to the groups, the last ``n_flat`` have flat priors.
    groups : ndarray of int
        Group of each column that has one.
    n_flat : int
        Number of columns with flat priors, whose largest elements are 1.
    """

    time: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    columns: np.ndarray
    groups: np.ndarray
    n_flat: int

    @property
    def n_groups(self):
        return int(self.groups.max(initial=-1)) + 1

    @cached_property
    def stacked(self):
        return np.concatenate([self.columns, self.y[:, None]], axis=1)

    @cached_property
    def spread(self):
        """Variance of the data, or that of their noise if that is larger."""
        return max(float(np.var(self.y)), float(np.median(self.variance)))

    @cached_property
    def sizes(self):
        """Mean square of the rows of each group: the variance it adds per prior variance."""
        square = np.mean(self.columns[:, : len(self.groups)] ** 2, axis=0)
        return np.bincount(self.groups, square, minlength=self.n_groups)

    def averaged(self, width):
        """Return the means of so many cadences each, one after the other."""
        starts = np.arange(0, len(self.y) - width + 1, width)

        def mean(values):
            return np.add.reduceat(values[: len(starts) * width], starts, axis=0) / width

        return replace(
            self,
            time=mean(self.time),
            y=mean(self.y),
            variance=mean(self.variance) / width,
            columns=mean(self.columns),
        )


@dataclass(frozen=True)
class Hyperparameters:
    """
    Variances and time scales.

    Parameters
    ----------
    noise_scale : float
        Factor of the white noise's variance.
    variances : ndarray
        Prior variance of each group.
    amplitude, period : float
        Variance and undamped period (days) of the long-term process; amplitude None: none.
    """

    noise_scale: float
    variances: np.ndarray
    amplitude: float | None
    period: float

    def process(self, time, variance):
        """Return the covariance of everything but the columns."""
        if self.amplitude is None:
            return Noise(self.noise_scale * variance)
        return LongTerm(time, self.noise_scale * variance, self.amplitude, self.period)

    def prior(self, data):
        """Return the prior variance of each column."""
        prior = np.full(data.columns.shape[1], _FLAT * data.spread)
        prior[: len(data.groups)] = self.variances[data.groups]
        return prior


class Posterior:
    """
    Coefficients of the columns given a Gram matrix.

    Parameters
    ----------
    gram : ndarray
        ``[X y].T @ inv(K) @ [X y]`` with the covariance ``K`` of noise and long-term process.
    prior : ndarray
        Prior variance of each column.
    """

    def __init__(self, gram, prior):
        root = np.sqrt(prior)
        m = root[:, None] * gram[:-1, :-1] * root
        m.flat[:: len(root) + 1] += 1
        # The matrix is symmetric: its transpose is in the order that LAPACK wants.
        lower, failed = dpotrf(m.T, lower=1, clean=1, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the columns' covariance is not positive definite")
        self._gram, self._root, self._lower = gram, root, lower
        self._projected = dtrtrs(lower, root * gram[:-1, -1], lower=1)[0]
        self.log_determinant = 2 * np.sum(np.log(np.diag(lower)))
        #: y^T Q y with the inverse Q of the covariance of everything
        self.quadratic = gram[-1, -1] - self._projected @ self._projected

    @cached_property
    def mean(self):
        """Mean of the coefficients."""
        return self._root * dtrtrs(self._lower, self._projected, lower=1, trans=1)[0]

    @cached_property
    def shrinkage(self):
        """Variance of each coefficient in units of its prior's."""
        inverse = dtrtri(self._lower, lower=1)[0]
        return np.einsum("ij,ij->j", inverse, inverse)

    @cached_property
    def covariance(self):
        """Covariance of the coefficients."""
        inverse = dpotri(self._lower, lower=1)[0]
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        return self._root[:, None] * inverse * self._root

    @cached_property
    def residual(self):
        """What the mean leaves of y: its square, weighted with the inverse of K."""
        gram, mean = self._gram, self.mean
        return gram[-1, -1] - 2 * gram[:-1, -1] @ mean + mean @ gram[:-1, :-1] @ mean


def _gram(process, stacked):
    z = process.whiten(stacked)
    return z.T @ z


def log_likelihood(data, hyper, *, gradient=False):
    """
    Logarithm of the marginal likelihood.

    Parameters
    ----------
    data : Data
        The problem.
    hyper : Hyperparameters
        Where to evaluate it.
    gradient : bool, optional
        Whether to return the derivatives by the logarithms of noise scale,
        variances, amplitude and period (the last two with a long-term
        process only).
    """
    process = hyper.process(data.time, data.variance)
    stacked = data.stacked
    prior = hyper.prior(data)
    posterior = Posterior(_gram(process, stacked), prior)
    n = len(data.y)
    value = -0.5 * (posterior.quadratic + posterior.log_determinant)
    value -= 0.5 * (process.log_determinant + n * np.log(2 * np.pi))
    if not gradient:
        return value
    mean = posterior.mean
    bar = np.empty((len(mean) + 1, len(mean) + 1))
    bar[:-1, :-1] = 0.5 * (np.outer(mean, mean) + posterior.covariance)
    bar[-1, :-1] = bar[:-1, -1] = -0.5 * mean
    bar[-1, -1] = 0.5
    used = 1 - posterior.shrinkage - mean**2 / prior
    groups = 0.5 * np.bincount(data.groups, used[: len(data.groups)], minlength=data.n_groups)
    if hyper.amplitude is None:
        z = process.whiten(stacked)
        variance_bar = 0.5 - np.einsum("ij,ij->i", z @ bar, z)
        return value, -np.array([variance_bar.sum(), *groups])
    variance_bar, *process_bar = process.gradient(stacked, bar)
    scale = hyper.noise_scale * np.sum(variance_bar * data.variance)
    return value, -np.array([scale, *groups, *process_bar])


def _fit_scales(gram, data, hyper, n_steps):
    """Maximise over the variances and a factor of noise and long-term process alike."""
    n, n_groups = len(data.y), data.n_groups

    def objective(theta):
        scale = np.exp(theta[0])
        prior = replace(hyper, variances=np.exp(theta[1:])).prior(data)
        try:
            posterior = Posterior(gram / scale, prior)
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(theta)
        value = 0.5 * (posterior.quadratic + posterior.log_determinant + n * theta[0])
        used = 1 - posterior.shrinkage
        by_group = used - posterior.mean**2 / prior
        slope = 0.5 * np.bincount(data.groups, by_group[: len(data.groups)], minlength=n_groups)
        return value, np.array([0.5 * (n - used.sum() - posterior.residual), *slope])

    unit = np.log(data.spread / data.sizes)
    bounds = [(-12.0, 12.0), *zip(unit - 30, unit + np.log(_LARGEST), strict=True)]
    factor, *variances = _minimize(objective, [1.0, *hyper.variances], bounds, n, n_steps)
    return replace(
        hyper,
        noise_scale=hyper.noise_scale * factor,
        variances=np.array(variances),
        amplitude=None if hyper.amplitude is None else hyper.amplitude * factor,
    ), factor


def _minimize(objective, start, bounds, n, n_steps=_STEPS):
    """Minimise over positive parameters, and return these."""
    start = np.clip(np.log(start), *np.transpose(bounds))
    options = {"maxiter": n_steps, "ftol": _PRECISION / n}
    result = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return [float(value) for value in np.exp(result.x)]


def _compressed(gram, data, hyper, smallest=1e-2):
    """Return the problem with the prior's variance absorbed into few columns of one group."""
    root = np.sqrt(hyper.prior(data))[: len(data.groups)]
    k = len(root)
    values, vectors = np.linalg.eigh(root[:, None] * gram[:k, :k] * root)
    vectors = vectors[:, values > min(smallest, values[-1])]
    columns = data.columns[:, :k] @ (root[:, None] * vectors)
    return replace(
        data,
        columns=np.concatenate([columns, data.columns[:, k:]], axis=1),
        groups=np.zeros(columns.shape[1], dtype=int),
    )


def _fit_process(data, hyper):
    """Maximise over noise, long-term process and a factor of all prior variances."""

    def objective(theta):
        scale, variance, amplitude, period = np.exp(theta)
        trial = Hyperparameters(scale, np.array([variance]), amplitude, period)
        try:
            value, slope = log_likelihood(data, trial, gradient=True)
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(theta)
        return -value, -slope

    amplitude = np.log([1e-5 * np.median(data.variance), _LARGEST * data.spread])
    period = np.log([_SHORTEST_PERIOD, 10 * max(float(data.time[-1]), 1.0)])
    bounds = [(-8.0, 16.0), (-8.0, 8.0), tuple(amplitude), tuple(period)]
    start = [hyper.noise_scale, 1.0, hyper.amplitude, hyper.period]
    scale, variance, amplitude, period = _minimize(objective, start, bounds, len(data.y))
    return replace(
        hyper,
        noise_scale=scale,
        variances=hyper.variances * variance,
        amplitude=amplitude,
        period=period,
    )


def fit_columns(data, hyper, n_steps=_STEPS):
    """
    Maximise over the columns' variances and a factor of the noise and the process alike.

    Parameters
    ----------
    data : Data
        The problem.
    hyper : Hyperparameters
        Where to begin.
    n_steps : int, optional
        Largest number of steps.

    Returns
    -------
    hyper : Hyperparameters
        The best.
    gram : ndarray
        The Gram matrix that goes along.
    """
    gram = _gram(hyper.process(data.time, data.variance), data.stacked)
    hyper, factor = _fit_scales(gram, data, hyper, n_steps)
    return hyper, gram / factor


def _improve(data, hyper):
    """Maximise over the columns' parameters, then over those of the process."""
    hyper, gram = fit_columns(data, hyper)
    if hyper.amplitude is None:
        return hyper
    return _fit_process(_compressed(gram, data, hyper), hyper)


def fit_hyperparameters(data, start=None, *, trend=True, tolerance=0.05, n_rounds=5):
    """
    Maximise the marginal likelihood.

    The columns' parameters are improved at fixed process, where only a small matrix enters,
    and the process' with the columns compressed, by turns. Whether a slow change
    is variability or systematics can make two maxima, so that there are several starts. Of very
    many cadences, means are searched first.

    Parameters
    ----------
    data : Data
        The problem.
    start : Hyperparameters, optional
        Where to begin; by default the best of several places.
    trend : bool, optional
        Whether there is a long-term process; only without ``start``.
    tolerance : float, optional
        The search ends when a round improves the logarithm by less.
    n_rounds : int, optional
        Largest number of rounds.
    """
    width = len(data.y) // _ENOUGH
    if width > 1:
        options = {"trend": trend, "tolerance": tolerance, "n_rounds": n_rounds}
        hyper = fit_hyperparameters(data.averaged(width), start, **options)
        return fit_columns(data, hyper)[0]
    hyper = start if start is not None else _best_start(data, trend)
    value = log_likelihood(data, hyper)
    for k in range(n_rounds):
        scan = start is None or k == 0
        trial = _improve(data, _scanned(data, hyper) if scan else hyper)
        improved = log_likelihood(data, trial)
        if improved > value:
            hyper = trial
        if improved < value + tolerance:
            break
        value = improved
    return hyper


def _scanned(data, hyper):
    """
    Try other variances of one group after the other, far from the present ones.

    Groups explain much the same, so that the likelihood has several maxima, and from a variance
    of nothing there is no slope back.
    """
    gram = _gram(hyper.process(data.time, data.variance), data.stacked)
    value = _likelihood_of_columns(gram, data, hyper)
    for g, unit in enumerate(data.spread / data.sizes):
        for factor in _SCAN:
            variances = hyper.variances.copy()
            variances[g] = factor * unit
            trial = replace(hyper, variances=variances)
            tried = _likelihood_of_columns(gram, data, trial)
            if tried > value:
                hyper, value = trial, tried
    return hyper


def _likelihood_of_columns(gram, data, hyper):
    """Return what of the likelihood's logarithm depends on the columns; -inf where it fails."""
    try:
        posterior = Posterior(gram, hyper.prior(data))
    except np.linalg.LinAlgError:
        return -np.inf
    return -0.5 * (posterior.quadratic + posterior.log_determinant)


def _best_start(data, trend):
    """Fit the columns' parameters in several places, and return the most likely one."""
    noise, unit = float(np.median(data.variance)), data.spread / data.sizes
    if not trend:
        return Hyperparameters(1.0, unit, None, 1.0)
    starts = [
        Hyperparameters(1.0, part * unit, 0.1 * noise if a is None else a * data.spread, period)
        for a, part, period in _STARTS
    ]
    fitted = [fit_columns(data, hyper, _FEW_STEPS)[0] for hyper in starts]
    return max(fitted, key=lambda hyper: log_likelihood(data, hyper))
