"""Bayesian linear regression in linear time, with one prior variance per group of columns."""

from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri, dtrtrs
from scipy.optimize import minimize

from scope_models.regression._covariance import FORGOTTEN, Covariance

__all__ = [
    "FLAT", "SLOWEST", "TOLERANCE", "Data", "Hyperparameters", "Posterior", "fit_hyperparameters",
    "log_likelihood",
]  # fmt: skip

#: Prior: variance of the columns with flat priors, in units of the data's, and the largest one of a
#: group's part of the model; the noise's factor is at least one over this.
FLAT = 1e3
#: Prior: standard deviation of the logarithm of a group's prior variance about what is expected.
_SPREAD = 2.0
#: Prior: and about its limit, beyond it, as that of the period.
_EXCESS = 0.1
#: Tolerance: twice as many cadences are averaged before the search.
_ENOUGH = 1500
#: Tolerance: a search ends when a step improves the likelihood's logarithm by about so much.
_PRECISION = 1e-3
#: Tolerance: logarithm of no variance; least signal over noise (squared) of columns in the search
#: for the process.
_NOTHING, _SMALLEST = -30.0, 1e-2
#: Tolerance: steps of a search at most.
_STEPS = 60
#: Tolerance: largest number of rounds; they end when one improves the logarithm by less.
_ROUNDS, TOLERANCE = 5, 0.05
#: Prior: least period in days, and that above which longer ones must be more likely. What is faster
#: than a transit is no trend; what is as slow as a drift would undo it.
_SHORTEST_PERIOD, SLOWEST = 0.5, 5.0
_value = attrgetter("value")


@dataclass(frozen=True)
class Data:
    """Data and regressors."""

    time: np.ndarray  # increasing, days from zero
    y: np.ndarray  # near zero
    variance: np.ndarray  # of the white noise, which has a factor
    columns: np.ndarray  # (n, r): those of groups, then ``n_flat`` with flat priors
    groups: np.ndarray  # group of each column that has one
    n_flat: int  # columns with flat priors, whose largest elements are 1
    expected: np.ndarray | float = np.nan  # prior variance of each group, NaN for none
    most: np.ndarray | float = 1e18  # largest prior variance of each group
    noise_errors: tuple = (np.inf, np.inf)  # of the logarithm of its factor, below one and above
    doubt: np.ndarray | float = 0.0  # variance that adds to the noise as it is

    @property
    def n_groups(self):
        return int(self.groups.max(initial=-1)) + 1

    @cached_property
    def stacked(self):
        return np.concatenate([self.columns, self.y[:, None]], axis=1)

    @cached_property
    def spread(self):
        """Weighted variance of the data, or that of their noise if that is larger."""
        mean = np.average(self.y, weights=self.counts)
        square = np.average((self.y - mean) ** 2, weights=self.counts)
        return max(float(square), float(np.median(self.variance)))

    @cached_property
    def counts(self):
        """What each datum counts for the noise."""
        return self.variance / (self.variance + self.doubt)

    @cached_property
    def sizes(self):
        """Mean square of the rows of each group: the variance it adds per prior variance."""
        square = np.mean(self.columns[:, : len(self.groups)] ** 2, axis=0)
        return np.bincount(self.groups, square, minlength=self.n_groups)

    def improbability(self, noise_scale, variances, period):
        """Return minus the logarithm of the hyperprior, and slopes by those of its arguments."""
        error = self.noise_errors[int(noise_scale > 1)]
        noise, longer = np.log(noise_scale) / error, max(np.log(period / SLOWEST), 0.0) / _EXCESS
        ratio = np.nan_to_num(np.log(variances / self.expected)) / _SPREAD
        excess = np.maximum(np.log(variances / self.most), 0.0) / _EXCESS
        slopes = [noise / error, *ratio / _SPREAD + excess / _EXCESS, longer / _EXCESS]
        parts = np.array([noise, longer, *ratio, *excess])
        return 0.5 * parts @ parts, np.array(slopes)

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
            doubt=mean(np.broadcast_to(self.doubt, self.y.shape)) / width,
            columns=mean(self.columns),
        )


@dataclass(frozen=True)
class Hyperparameters:
    """Variances and time scales."""

    noise_scale: float  # factor of the white noise's variance
    variances: np.ndarray  # prior variance of each group
    amplitude: float  # variance of the long-term process; 0: there is none
    period: float  # its undamped period, days
    walk: float = 0.0  # half of the variance of the random walk's steps in a day

    def process(self, data):
        """Return the covariance of everything but the columns."""
        noise = self.noise_scale * data.variance + data.doubt
        return Covariance(data.time, noise, self.amplitude, self.period, self.walk)

    def improbability(self, data):
        """Return minus the logarithm of the hyperprior."""
        return data.improbability(self.noise_scale, self.variances, self.period)[0]

    def density(self, frequency):
        """Return the power spectral density of the long-term process (per cycle per day)."""
        power = self.amplitude * self.period / (1 + (frequency * self.period) ** 4)
        walk = 2 * self.walk / np.maximum(2 * np.pi * frequency, 1 / FORGOTTEN) ** 2
        return np.sqrt(2) / np.pi * power + walk

    def prior(self, data):
        """Return the prior variance of each column."""
        prior = np.full(data.columns.shape[1], FLAT * data.spread)
        prior[: len(data.groups)] = self.variances[data.groups]
        return prior


class Posterior:
    """Coefficients of the columns with a prior variance each.

    The Gram matrix is ``[X y].T @ inv(K) @ [X y]`` with the covariance ``K`` of noise and long-term
    process.
    """

    def __init__(self, gram, prior):
        root = np.sqrt(prior)
        m = root[:, None] * gram[:-1, :-1] * root
        m.flat[:: len(root) + 1] += 1 + np.finfo(float).eps * np.trace(m)  # its rounding errors
        # The matrix is symmetric: its transpose is in the order that LAPACK takes.
        lower, failed = dpotrf(m.T, lower=1, clean=1, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the covariance is not positive definite")
        self._gram, self._root, self._lower = gram, root, lower
        self._projected = dtrtrs(lower, root * gram[:-1, -1], lower=1)[0]
        self.log_determinant = 2 * np.sum(np.log(np.diag(lower)))
        #: y^T Q y with the inverse Q of the covariance of everything
        self.quadratic = gram[-1, -1] - self._projected @ self._projected

    def log_likelihood(self, process, n):
        """Return the logarithm of the marginal likelihood of ``n`` data."""
        value = self.quadratic + self.log_determinant + process.log_determinant
        return -0.5 * float(value + n * np.log(2 * np.pi))

    def left(self, products):
        """Return what the columns take off the Gram matrix of others, from products with these."""
        part = dtrtrs(self._lower, self._root[:, None] * products, lower=1)[0]
        return -part.T @ part

    def spread(self, columns):
        """Return the columns times a root of the coefficients' covariance."""
        return dtrtrs(self._lower, (columns * self._root).T, lower=1, overwrite_b=1)[0].T

    def variance(self, columns):
        """Return the variance of what the columns contribute to each datum."""
        part = self.spread(columns)
        return np.einsum("ij,ij->i", part, part)

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


def log_likelihood(data, hyper):
    """Return the logarithm of the marginal likelihood, and its slopes by the hyper-parameters'."""
    process, prior = hyper.process(data), hyper.prior(data)
    z = process.whiten(data.stacked)
    posterior = Posterior(z.T @ z, prior)
    used = 1 - posterior.shrinkage - posterior.mean**2 / prior
    groups = 0.5 * np.bincount(data.groups, used[: len(data.groups)], minlength=data.n_groups)
    left = np.column_stack([posterior.spread(z[:, :-1]), z[:, :-1] @ posterior.mean - z[:, -1]])
    variance_bar, *process_bar = process.gradient(left)
    scale = hyper.noise_scale * np.sum(variance_bar * data.variance)
    slopes = -np.array([scale, *groups, *process_bar])
    return posterior.log_likelihood(process, len(data.y)), slopes


@dataclass(frozen=True)
class _Trial:
    """Hyper-parameters, and what the likelihood takes from noise and process there."""

    data: Data
    hyper: Hyperparameters
    gram: np.ndarray
    log_determinant: float

    @classmethod
    def at(cls, data, hyper):
        process = hyper.process(data)
        z = process.whiten(data.stacked)
        return cls(data, hyper, z.T @ z, process.log_determinant)

    @cached_property
    def value(self):
        """Logarithm of likelihood times hyperprior, but for a constant; -inf: it fails."""
        try:
            posterior = Posterior(self.gram, self.hyper.prior(self.data))
        except np.linalg.LinAlgError:
            return -np.inf
        value = posterior.quadratic + posterior.log_determinant + self.log_determinant
        return -0.5 * value - self.hyper.improbability(self.data)


def _fit_scales(trial):
    """Maximize over the variances and a factor of noise and long-term process alike.

    The doubt has the same factor here, but counts for it as little as it should.
    """
    data, hyper, n = trial.data, trial.hyper, trial.data.counts.sum()

    def objective(theta):
        scale = np.exp(theta[0])
        prior = replace(hyper, variances=np.exp(theta[1:])).prior(data)
        posterior = Posterior(trial.gram / scale, prior)
        value = 0.5 * (posterior.quadratic + posterior.log_determinant + n * theta[0])
        used = 1 - posterior.shrinkage
        by_group = (used - posterior.mean**2 / prior)[: len(data.groups)]
        slope = 0.5 * np.bincount(data.groups, by_group, minlength=data.n_groups)
        noise = hyper.noise_scale * scale
        unlikely, rise = data.improbability(noise, np.exp(theta[1:]), hyper.period)
        slope = np.array([0.5 * (n - used.sum() - posterior.residual), *slope])
        return value + unlikely, slope + rise[:-1]

    unit = np.log(data.spread / data.sizes)
    least = -np.log(FLAT * hyper.noise_scale)
    bounds = [(least, np.inf), *zip(unit + _NOTHING, unit + np.log(FLAT), strict=True)]
    factor, *variances = _minimize(objective, [1.0, *hyper.variances], bounds, n)
    noise, amplitude, walk = factor * np.array([hyper.noise_scale, hyper.amplitude, hyper.walk])
    best = Hyperparameters(noise, np.array(variances), amplitude, hyper.period, walk)
    return _Trial.at(data, best)


def _minimize(objective, start, bounds, n):
    """Minimize over positive parameters, and return these.

    The first one has no upper bound: if all had two, the first step would lead to them.
    """
    start = np.log(np.clip(start, *np.exp(np.transpose(bounds))))
    options = {"maxiter": _STEPS, "ftol": _PRECISION / n}

    def tried(theta):
        try:
            with np.errstate(all="ignore"):  # of overflows
                value, slope = objective(theta)
        except np.linalg.LinAlgError:
            value = np.inf
        return (value, slope) if np.isfinite(value) else (np.inf, np.zeros_like(theta))

    result = minimize(tried, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return [float(value) for value in np.exp(result.x)]


def _compressed(gram, data, hyper):
    """Return the problem with the prior's variance absorbed into few columns of one group."""
    root = np.sqrt(hyper.prior(data))[: len(data.groups)]
    k = len(root)
    values, vectors = np.linalg.eigh(root[:, None] * gram[:k, :k] * root)
    vectors = vectors[:, values >= min(_SMALLEST, values[-1])]  # one column at least
    columns = data.columns[:, :k] @ (root[:, None] * vectors)
    return replace(
        data,
        columns=np.concatenate([columns, data.columns[:, k:]], axis=1),
        groups=np.zeros(columns.shape[1], dtype=int),
    )


def _fit_process(trial):
    """Maximize over noise, long-term process and a factor of all prior variances."""
    whole, hyper = trial.data, trial.hyper
    data = _compressed(trial.gram, whole, hyper)

    def objective(theta):
        scale, variance, *process = np.exp(theta)
        value, slope = log_likelihood(data, Hyperparameters(scale, variance[None], *process))
        unlikely, rise = whole.improbability(scale, hyper.variances * variance, process[1])
        slope[[0, 1, 3]] -= rise[0], rise[1:-1].sum(), rise[-1]
        return unlikely - value, -slope[: len(theta)]

    size = tuple(np.log([np.median(data.variance) / FLAT, FLAT * data.spread]))
    period = np.log(_SHORTEST_PERIOD), np.inf
    bounds = [(-np.log(FLAT), np.inf), (-np.inf, np.inf), size, period, size]
    start = [hyper.noise_scale, 1.0, hyper.amplitude, hyper.period, hyper.walk]
    n = len(start) if hyper.walk else len(start) - 1
    scale, variance, *process = _minimize(objective, start[:n], bounds[:n], len(data.y))
    best = Hyperparameters(scale, hyper.variances * variance, *process)
    return _Trial.at(whole, best)


def fit_hyperparameters(data, start=None, *, trend=True):
    """Maximize the marginal likelihood.

    The columns' parameters are improved at fixed process, and the process' with the columns
    compressed, by turns. Without a ``start`` there are two, for a slow change may be variability or
    systematics: columns or slow process are as large as the data, the others as small as the noise.
    """
    width = len(data.y) // _ENOUGH
    if width > 1:
        hyper = fit_hyperparameters(data.averaged(width), start, trend=trend)
        return _fit_scales(_Trial.at(data, hyper)).hyper
    if start is not None:
        best = _Trial.at(data, start)
    else:
        sizes = float(np.median(data.variance)), data.spread
        period = np.sqrt(_SHORTEST_PERIOD * SLOWEST)
        pairs = (sizes, sizes[::-1]) if trend else ((0.0, data.spread),)
        starts = (Hyperparameters(1.0, part / data.sizes, size, period) for size, part in pairs)
        best = max((_fit_scales(_Trial.at(data, start)) for start in starts), key=_value)
    for k in range(_ROUNDS):
        value = best.value
        best = max(best, _fit_scales(best), key=_value)
        if not best.hyper.amplitude or (k > 0 and best.value < value + TOLERANCE):
            break  # nor would the process change
        best = max(best, _fit_process(best), key=_value)
        if best.value < value + TOLERANCE:
            break
    return best.hyper
