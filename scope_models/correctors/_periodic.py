"""Periodic variability: the frequencies of a star that pulsates, is eclipsed, or rotates fast."""

from dataclasses import replace

import numpy as np
from astropy.stats import mad_std
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import uniform_filter1d

from scope_models.correctors._regression import Hyperparameters

__all__ = ["find_frequencies", "harmonic_columns"]

#: Prior: twice the gain of the likelihood's logarithm that a pair of columns must bring. White
#: noise exceeds it at one of 10^8 frequencies.
_SIGNIFICANT = 40.0
#: Tolerance: frequencies found in one round, and how far apart they are in units of one over the
#: length of the observation: nearer ones share a peak.
_AT_ONCE, _APART = 6, 1.5
_ROUNDS = 20
#: Tolerance: largest step of a frequency, in the same unit.
_LARGEST_SHIFT = 0.2
#: Prior: at most one frequency, which has three parameters, for so many cadences.
_CADENCES_PER_FREQUENCY = 8
#: Prior: period in days of the slow process, which stands for all that is not periodic.
_SLOW = 5.0
#: Branch: cadences that differ from the median of five by so many standard deviations are left out
#: of the search.
_ALONE = 10.0


def harmonic_columns(time, frequencies):
    """Return a cosine and a sine per frequency, ``(n_cadences, 2 n_frequencies)``."""
    phase = 2 * np.pi * np.outer(time, frequencies)
    return np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time), -1)


def find_frequencies(solution, allowed):
    """Return the frequencies of a star's variability, cycles per day, found one after the other.

    In each round all columns are fitted together, and the frequencies that explain most of the
    rest are added. Regressors are among the columns: what they explain is not variability. Of the
    ``solution``, without periodic variability, data and columns are used and not its variances;
    ``allowed`` are cadences that may be used, of all usable ones.
    """
    n_most = allowed.sum() // _CADENCES_PER_FREQUENCY
    found, rest = np.empty(0), solution.y
    for _ in range(_ROUNDS):
        # without cadences far from the ones around them: cosmic rays and other accidents
        windows = sliding_window_view(np.pad(rest[allowed], 2, mode="edge"), 5)
        difference = rest[allowed] - np.median(windows, axis=1)
        use = allowed.copy()
        use[allowed] = np.abs(difference) <= _ALONE * max(mad_std(difference), 1e-300)
        trial = _with_simple_noise(solution.with_frequencies(found, use), rest)
        frequency, gain = _spectrum(trial)
        new = _peaks(frequency, gain, 1 / np.ptp(trial.data.time))
        if not len(new) or len(found) + len(new) > n_most:
            break
        found = np.append(found, [_refined(f, trial) for f in new])
        plain = replace(solution, hyper=trial.hyper)
        found = found + _shifts(found, plain, use)
        rest = plain.with_frequencies(found, use).unexplained
    return _significant(found, replace(solution, hyper=trial.hyper), use)


def _significant(frequencies, trial, use):
    """Leave out frequencies that are not needed beside the others, the weakest first."""
    while len(frequencies):
        fitted = trial.with_frequencies(frequencies, use)
        first = trial.n_regressors + trial.n_trend
        rows = first + np.arange(2 * len(frequencies)).reshape(-1, 2)
        mean = fitted.posterior.mean[rows]
        covariance = fitted.posterior.covariance[rows[:, :, None], rows[:, None, :]]
        gain = np.einsum("ij,ij->i", mean, np.linalg.solve(covariance, mean[:, :, None])[:, :, 0])
        weak = gain < _SIGNIFICANT
        if not weak.any():
            break
        # those that share a peak are weak each, but not together: half of them go at once
        limit = np.median(gain[weak])
        frequencies = frequencies[~(weak & (gain <= limit))]
    return frequencies


def _shifts(frequencies, solution, use):
    """Return one step of Gauss and Newton for each frequency."""
    trial = solution.with_frequencies(frequencies, use)
    k, n = trial.n_regressors, solution.n_trend
    cos, sin = trial.posterior.mean[k + n : k + trial.n_trend].reshape(-1, 2).T
    phase = 2 * np.pi * np.outer(trial.time, frequencies)
    slope = 2 * np.pi * trial.time[:, None] * (sin * np.cos(phase) - cos * np.sin(phase))
    trial = trial.with_flat(slope, use)
    step = trial.posterior.mean[k + trial.n_trend :] / trial.scale[trial.n_trend :]
    limit = _LARGEST_SHIFT / np.ptp(trial.data.time)
    return np.clip(step, -limit, limit)


def _with_simple_noise(solution, rest):
    """Return a fit whose noise and slow process are those of a rest, with weak priors."""
    rest = rest[solution.use]
    jitter = mad_std(np.diff(rest, 2)) / np.sqrt(6)
    variance = np.median(solution.data.variance)
    width = max(round(1 / float(np.median(np.diff(solution.data.time)))), 1)
    slow = max(float(np.var(uniform_filter1d(rest, width))), 0.1 * variance)
    unit = float(np.var(solution.y[solution.use])) / solution.data.sizes
    if solution.data.most is not None:
        unit = np.minimum(unit, solution.data.most)
    hyper = Hyperparameters(max(jitter**2 / variance, 1.0), unit, slow, _SLOW)
    return replace(solution, hyper=hyper)


def _spectrum(solution):
    """Return what a cosine and a sine at each frequency would gain.

    Twice the gain of the log-likelihood is |c^T a|^2 / (c^T Q c) with the inverse covariance Q and
    a = Q y. Here Q is that of noise and slow process alone, which makes the gain smaller where
    regressors explain the same.
    """
    time = solution.data.time
    step = float(np.median(np.diff(time)))
    index = np.round((time - time[0]) / step).astype(int)
    n = 4 * 2 ** int(np.ceil(np.log2(index[-1] + 1)))
    grid = np.zeros(n)
    grid[index] = solution.alpha
    power = np.abs(np.fft.rfft(grid)) ** 2
    frequency = np.fft.rfftfreq(n, step)
    noise = float(np.mean(1 / solution.white_variance[solution.use])) ** -1
    density = solution.hyper.density(frequency) / step + noise
    gain = 2 * power * density / len(time)
    gain[frequency < 2 / (time[-1] - time[0])] = 0.0
    return frequency, gain


def _peaks(frequency, gain, resolution):
    """Return the frequencies of the highest maxima that are significant."""
    inner = gain[1:-1]
    top = np.flatnonzero((inner >= gain[:-2]) & (inner > gain[2:]) & (inner > _SIGNIFICANT)) + 1
    chosen = []
    for k in top[np.argsort(gain[top])[::-1]]:
        if all(abs(frequency[k] - f) > _APART * resolution for f in chosen):
            chosen.append(frequency[k])
        if len(chosen) == _AT_ONCE:
            break
    return chosen


def _refined(frequency, solution):
    """Return the frequency of the maximum near a point of the grid, by parabolas."""
    time, alpha = solution.data.time, solution.alpha
    step = 0.25 / np.ptp(time)
    for _ in range(3):
        trial = frequency + step * np.array([-1, 0, 1])
        low, middle, high = np.abs(np.exp(-2j * np.pi * np.outer(trial, time)) @ alpha) ** 2
        bend = low - 2 * middle + high
        if bend >= 0:
            break
        frequency += step * float(np.clip(0.5 * (low - high) / bend, -1, 1))
        step /= 4
    return frequency
