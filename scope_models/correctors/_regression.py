"""Bayesian linear regression with one prior variance per group of columns, the most likely one."""

from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri, dtrtrs
from scipy.optimize import minimize

from scope_models.correctors._covariance import FORGOTTEN, Covariance, Noise

__all__ = [
    "FLAT", "SLOWEST", "Data", "Hyperparameters", "Posterior", "fit_hyperparameters",
    "log_likelihood",
]  # fmt: skip

#: Prior: variance of the columns with flat priors, in units of the data's.
FLAT = 1e4
#: Prior: standard deviation of the logarithm of a group's prior variance about what is expected.
_SPREAD = 2.0
#: Prior: and about its limit, beyond it.
_EXCESS = 0.1
#: Tolerance: twice as many cadences are averaged before the search: what is slow and how strong
#: each group is shows in the means.
_ENOUGH = 1500
#: Tolerance: a search ends when a step improves the likelihood's logarithm by about so much.
_PRECISION = 1e-3
#: Tolerance: steps of a search at most.
_STEPS = 60
#: Tolerance: largest number of rounds; they end when one improves the logarithm by less.
_ROUNDS, _TOLERANCE = 5, 0.05
#: Prior: bounds of the period in days. What is faster than a transit is not a trend. With a longer
#: period a straight line would cost little, and the star's would undo that of a slow drift.
_SHORTEST_PERIOD, SLOWEST = 0.5, 5.0
#: Tolerance: the largest variance of a group's part of the model, in units of the data's. More is
#: not needed, and less well conditioned.
_LARGEST = 1e3
#: Tolerance: least factor of the white noise's variance.
_LEAST_NOISE = 1e-4
_value = attrgetter("value")


@dataclass(frozen=True)
class Data:
    """Data and regressors."""

    time: np.ndarray  # increasing, days from zero
    y: np.ndarray  # near zero
    variance: np.ndarray  # of the white noise
    columns: np.ndarray  # (n, r): those of groups, then ``n_flat`` with flat priors
    groups: np.ndarray  # group of each column that has one
    n_flat: int  # columns with flat priors, whose largest elements are 1
    expected: np.ndarray | None = None  # prior variance of each group, NaN for none
    most: np.ndarray | None = None  # largest prior variance of each group, with ``expected``
    noise_error: float = np.inf  # standard deviation of the logarithm of the white noise's factor

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

    def improbability(self, noise_scale, variances):
        """Return minus the logarithm of the hyperprior, and its slopes by those of its arguments.

        The first slope is that by the noise.
        """
        noise = np.log(noise_scale) / self.noise_error
        if self.expected is None:
            ratio = excess = np.zeros(self.n_groups)
        else:
            ratio = np.nan_to_num(np.log(variances / self.expected)) / _SPREAD
            excess = np.maximum(np.log(variances / self.most), 0.0) / _EXCESS
        slopes = np.append(noise / self.noise_error, ratio / _SPREAD + excess / _EXCESS)
        return 0.5 * (noise**2 + ratio @ ratio + excess @ excess), slopes

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
    """Variances and time scales."""

    noise_scale: float  # factor of the white noise's variance
    variances: np.ndarray  # prior variance of each group
    amplitude: float | None  # variance of the long-term process; None: there is none
    period: float  # its undamped period, days
    walk: float = 0.0  # half of the variance of the random walk's steps in a day

    def process(self, time, variance):
        """Return the covariance of everything but the columns."""
        if self.amplitude is None:
            return Noise(self.noise_scale * variance)
        scaled = self.noise_scale * variance
        return Covariance(time, scaled, self.amplitude, self.period, self.walk)

    def density(self, frequency):
        """Return the power spectral density of the long-term process (per cycle per day)."""
        if self.amplitude is None:
            return np.zeros_like(frequency)
        power = self.amplitude * self.period / (1 + (frequency * self.period) ** 4)
        walk = 2 * self.walk / np.maximum(2 * np.pi * frequency, 1 / FORGOTTEN) ** 2
        return np.sqrt(2) / np.pi * power + walk

    def prior(self, data):
        """Return the prior variance of each column."""
        prior = np.full(data.columns.shape[1], FLAT * data.spread)
        prior[: len(data.groups)] = self.variances[data.groups]
        return prior


class Posterior:
    """Coefficients of the columns, with prior variances ``prior``, given a Gram matrix.

    ``gram`` is ``[X y].T @ inv(K) @ [X y]`` with the covariance ``K`` of noise and long-term
    process.
    """

    def __init__(self, gram, prior):
        root = np.sqrt(prior)
        m = root[:, None] * gram[:-1, :-1] * root
        m.flat[:: len(root) + 1] += 1
        # The matrix is symmetric: its transpose is in the order that LAPACK takes.
        lower, failed = dpotrf(m.T, lower=1, clean=1, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError("the columns' covariance is not positive definite")
        self._gram, self._root, self._lower = gram, root, lower
        self._projected = dtrtrs(lower, root * gram[:-1, -1], lower=1)[0]
        self.log_determinant = 2 * np.sum(np.log(np.diag(lower)))
        #: y^T Q y with the inverse Q of the covariance of everything
        self.quadratic = gram[-1, -1] - self._projected @ self._projected

    def log_likelihood(self, process, n):
        """Return the logarithm of the marginal likelihood of ``n`` data, of noise and process."""
        value = self.quadratic + self.log_determinant + process.log_determinant
        return -0.5 * float(value + n * np.log(2 * np.pi))

    def left(self, products):
        """Return what the columns leave of the Gram matrix of others, but for these themselves.

        ``products`` are the Gram matrix's of the columns with the others, ``(k, m)``.
        """
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


def log_likelihood(data, hyper, *, gradient=False):
    """Return the logarithm of the marginal likelihood.

    With ``gradient`` its derivatives by the logarithms of noise scale, variances, amplitude,
    period and walk follow, the last three with a long-term process only.
    """
    process = hyper.process(data.time, data.variance)
    stacked = data.stacked
    prior = hyper.prior(data)
    z = process.whiten(stacked)
    posterior = Posterior(z.T @ z, prior)
    value = posterior.log_likelihood(process, len(data.y))
    if not gradient:
        return value
    used = 1 - posterior.shrinkage - posterior.mean**2 / prior
    groups = 0.5 * np.bincount(data.groups, used[: len(data.groups)], minlength=data.n_groups)
    left = np.column_stack([posterior.spread(z[:, :-1]), z[:, :-1] @ posterior.mean - z[:, -1]])
    if hyper.amplitude is None:
        variance_bar = 0.5 - 0.5 * np.einsum("ij,ij->i", left, left)
        return value, -np.array([variance_bar.sum(), *groups])
    variance_bar, *process_bar = process.gradient(left)
    scale = hyper.noise_scale * np.sum(variance_bar * data.variance)
    return value, -np.array([scale, *groups, *process_bar])


@dataclass(frozen=True)
class _Trial:
    """Hyper-parameters, with what the likelihood takes from noise and process there."""

    data: Data
    hyper: Hyperparameters
    gram: np.ndarray
    log_determinant: float

    @classmethod
    def at(cls, data, hyper):
        process = hyper.process(data.time, data.variance)
        z = process.whiten(data.stacked)
        return cls(data, hyper, z.T @ z, process.log_determinant)

    def changed(self, variances, factor=1.0):
        """Return it with other variances, and with noise and process multiplied with a factor."""
        hyper = replace(
            self.hyper,
            noise_scale=self.hyper.noise_scale * factor,
            variances=variances,
            amplitude=None if self.hyper.amplitude is None else self.hyper.amplitude * factor,
            walk=self.hyper.walk * factor,
        )
        more = len(self.data.y) * np.log(factor)
        return _Trial(self.data, hyper, self.gram / factor, self.log_determinant + more)

    @cached_property
    def value(self):
        """Logarithm of the likelihood times the hyperprior, but for a constant; -inf: it fails."""
        try:
            posterior = Posterior(self.gram, self.hyper.prior(self.data))
        except np.linalg.LinAlgError:
            return -np.inf
        value = posterior.quadratic + posterior.log_determinant + self.log_determinant
        hyper = self.hyper
        return -0.5 * value - self.data.improbability(hyper.noise_scale, hyper.variances)[0]


def _fit_scales(trial):
    """Maximize over the variances and a factor of noise and long-term process alike."""
    data, hyper, n = trial.data, trial.hyper, len(trial.data.y)

    def objective(theta):
        scale = np.exp(theta[0])
        prior = replace(hyper, variances=np.exp(theta[1:])).prior(data)
        try:
            posterior = Posterior(trial.gram / scale, prior)
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(theta)
        value = 0.5 * (posterior.quadratic + posterior.log_determinant + n * theta[0])
        used = 1 - posterior.shrinkage
        by_group = (used - posterior.mean**2 / prior)[: len(data.groups)]
        slope = 0.5 * np.bincount(data.groups, by_group, minlength=data.n_groups)
        unlikely, rise = data.improbability(hyper.noise_scale * scale, np.exp(theta[1:]))
        slope = np.array([0.5 * (n - used.sum() - posterior.residual), *slope])
        return value + unlikely, slope + rise

    unit = np.log(data.spread / data.sizes)
    least = np.log(_LEAST_NOISE / hyper.noise_scale)
    bounds = [(least, 12.0), *zip(unit - 30, unit + np.log(_LARGEST), strict=True)]
    factor, *variances = _minimize(objective, [1.0, *hyper.variances], bounds, n)
    return trial.changed(np.array(variances), factor)


def _minimize(objective, start, bounds, n):
    """Minimize over positive parameters, and return these.

    The first one is the noise, which ``n`` data determine much better than the others: its unit is
    smaller.
    """
    unit = np.ones(len(start))
    unit[0] = (n / 2) ** -0.25

    def scaled(theta):
        value, slope = objective(theta * unit)
        return value, slope * unit

    start = np.log(np.clip(start, *np.exp(np.transpose(bounds)))) / unit
    bounds = np.array(bounds) / unit[:, None]
    options = {"maxiter": _STEPS, "ftol": _PRECISION / n}
    result = minimize(scaled, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return [float(value) for value in np.exp(result.x * unit)]


def _compressed(gram, data, hyper, smallest=1e-2):
    """Return the problem with the prior's variance absorbed into few columns of one group."""
    root = np.sqrt(hyper.prior(data))[: len(data.groups)]
    k = len(root)
    values, vectors = np.linalg.eigh(root[:, None] * gram[:k, :k] * root)
    vectors = vectors[:, values >= min(smallest, values[-1])]  # one column at least
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
        tried = Hyperparameters(scale, np.array([variance]), *process)
        try:
            value, slope = log_likelihood(data, tried, gradient=True)
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(theta)
        unlikely, rise = whole.improbability(scale, hyper.variances * variance)
        slope[:2] -= rise[0], rise[1:].sum()
        return unlikely - value, -slope[: len(theta)]

    size = tuple(np.log([1e-5 * np.median(data.variance), _LARGEST * data.spread]))
    period = tuple(np.log([_SHORTEST_PERIOD, SLOWEST]))
    bounds = [(np.log(_LEAST_NOISE), 16.0), (-8.0, 8.0), size, period, size]
    start = [hyper.noise_scale, 1.0, hyper.amplitude, hyper.period, hyper.walk]
    n = len(start) if hyper.walk else len(start) - 1
    scale, variance, *process = _minimize(objective, start[:n], bounds[:n], len(data.y))
    best = Hyperparameters(scale, hyper.variances * variance, *process)
    return _Trial.at(whole, best)


def fit_hyperparameters(data, start=None, *, trend=True):
    """Maximize the marginal likelihood.

    The columns' parameters are improved at fixed process, where only a small matrix enters,
    and the process' with the columns compressed, by turns. Whether a slow change is variability or
    systematics can make two maxima, so that there are two starts unless one is given, or, if
    ``trend`` is False, one without a process. Of very many cadences, means are searched first.
    """
    width = len(data.y) // _ENOUGH
    if width > 1:
        hyper = fit_hyperparameters(data.averaged(width), start, trend=trend)
        return _fit_scales(_Trial.at(data, hyper)).hyper
    best = _best_start(data, trend) if start is None else _Trial.at(data, start)
    for k in range(_ROUNDS):
        value = best.value
        best = max(best, _fit_scales(best), key=_value)
        if best.hyper.amplitude is None or (k > 0 and best.value < value + _TOLERANCE):
            break  # nor would the process change
        best = max(best, _fit_process(best), key=_value)
        if best.value < value + _TOLERANCE:
            break
    return best.hyper


def _best_start(data, trend):
    """Return the better of two starts: the columns as large as the data, or the slow process.

    The other one is as small as the noise, or there is no process.
    """
    sizes = float(np.median(data.variance)), data.spread
    pairs = (sizes, sizes[::-1]) if trend else ((None, data.spread),)
    starts = (Hyperparameters(1.0, part / data.sizes, size, SLOWEST) for size, part in pairs)
    return max((_fit_scales(_Trial.at(data, start)) for start in starts), key=_value)
