"""Bayesian linear regression with one prior variance per group of columns."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dtrtri, dtrtrs

from scope_models.correctors._covariance import Covariance, Noise

__all__ = ["FLAT", "Data", "Hyperparameters", "Posterior", "gram_matrix", "log_likelihood"]

#: The prior variance of the columns with flat priors, in units of the data's.
FLAT = 1e4
_SQRT_2 = np.sqrt(2)
#: Standard deviation of the logarithm of a group's prior variance about what is expected.
_SPREAD = 2.0
#: ... and about its limit, beyond it.
_EXCESS = 0.1


@dataclass(frozen=True)
class Data:
    """
    Data and regressors.

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
    expected : ndarray, optional
        Prior variance of each group that is expected, NaN where nothing is.
    most : ndarray, optional
        Largest prior variance of each group, with `expected`.
    least_noise : float, optional
        Least factor of the white noise's variance.
    """

    time: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    columns: np.ndarray
    groups: np.ndarray
    n_flat: int
    expected: np.ndarray | None = None
    most: np.ndarray | None = None
    least_noise: float = 1e-4

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

    def improbability(self, variances):
        """Return minus the logarithm of the hyperprior of variances, and its slopes by theirs."""
        if self.expected is None:
            return 0.0, np.zeros(self.n_groups)
        ratio = np.nan_to_num(np.log(variances / self.expected)) / _SPREAD
        excess = np.maximum(np.log(variances / self.most), 0.0) / _EXCESS
        return 0.5 * (ratio @ ratio + excess @ excess), ratio / _SPREAD + excess / _EXCESS

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
        return Covariance(time, self.noise_scale * variance, [self.amplitude], [self.period])

    def density(self, frequency):
        """Return the power spectral density of the long-term process (per cycle per day)."""
        if self.amplitude is None:
            return np.zeros_like(frequency)
        return _SQRT_2 / np.pi * self.amplitude * self.period / (1 + (frequency * self.period) ** 4)

    def prior(self, data):
        """Return the prior variance of each column."""
        prior = np.full(data.columns.shape[1], FLAT * data.spread)
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
        # The matrix is symmetric: its transpose is in the order that LAPACK takes.
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


def gram_matrix(process, stacked):
    """Return ``[X y].T @ inv(K) @ [X y]`` with the covariance ``K`` of a process.

    Parameters
    ----------
    process : Covariance or Noise
        Noise and long-term variability.
    stacked : ndarray
        The columns and the data.
    """
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
    z = process.whiten(stacked)
    posterior = Posterior(z.T @ z, prior)
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
        variance_bar = 0.5 - np.einsum("ij,ij->i", z @ bar, z)
        return value, -np.array([variance_bar.sum(), *groups])
    variance_bar, *process_bar = process.gradient(stacked, z, bar)
    scale = hyper.noise_scale * np.sum(variance_bar * data.variance)
    return value, -np.array([scale, *groups, *process_bar])
