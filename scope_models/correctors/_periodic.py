"""Periodic variability: the frequencies of a star that pulsates, is eclipsed, or rotates fast."""

from dataclasses import replace

import numpy as np
from astropy.stats import mad_std
from astropy.timeseries import BoxLeastSquares
from scipy.ndimage import uniform_filter1d

from scope_models.correctors._regression import (
    FLAT,
    Hyperparameters,
    fit_columns,
    log_likelihood,
)

__all__ = ["find_frequencies", "harmonic_columns", "is_periodic"]

#: Twice the gain of the likelihood's logarithm that a pair of columns must bring. White noise
#: exceeds it at one of 10^8 frequencies.
_SIGNIFICANT = 40.0
#: Frequencies found in one round are at least this part of the strongest one's gain, ...
_PART, _AT_ONCE = 0.03, 6
#: ... and so far apart in units of one over the length of the observation.
_APART = 1.5
_ROUNDS = 20
#: Once there are so many, no more are sought if the logarithm of the likelihood is less by so much
#: than with the long-term process alone: the star varies at all frequencies. Beside them the
#: process may be weaker.
_ENOUGH_TO_JUDGE, _WORSE = 12, 100.0
_PARTS = (1.0, 0.01)
#: Largest step of a frequency, in the same unit.
_LARGEST_SHIFT = 0.2
#: At most one frequency for so many cadences, and so many.
_CADENCES_PER_FREQUENCY, _MOST = 15, 60
#: Where so much of the frequencies up to this part of the fastest that cadences resolve, and
#: beyond, are multiples of one, eclipses are sharp: all multiples are taken, ...
_MULTIPLES, _SHARP = 0.7, 0.5
#: ... up to this part of the fastest, for so many cadences at most one, and so many.
_LAST, _CADENCES_PER_MULTIPLE, _MOST_MULTIPLES = 1.5, 12, 100
#: ... or the part of them that is most likely.
_FRACTIONS = (1.0, 0.6, 0.35)
#: Where equal boxes of so many cadences, and for so much of a period at most, leave less than this
#: part of the variance, they are eclipses. They leave more than 0.65 of a sinusoid.
_DURATIONS, _PART_OF_ORBIT, _LEFT = np.array([2, 4, 8, 16]), 0.15, 0.6
#: Periods that are tried for one duration at most: with gaps of months there would be millions.
_MOST_PERIODS = 50_000
#: Period in days of the slow process, which stands for all that is not periodic.
_SLOW = 5.0
#: Cadences that differ from the median of five by so many standard deviations stand alone.
_ALONE = 10.0
#: A star is looked at for periods too if this part of its cadences seem to be outliers.
_MANY_OUTLIERS = 0.03
#: Multiples of one frequency that leave so many times the variance of others are none.
_MUCH_MORE = 3.0


def harmonic_columns(time, frequencies):
    """Return a cosine and a sine per frequency, ``(n_cadences, 2 n_frequencies)``."""
    phase = 2 * np.pi * np.outer(time, frequencies)
    return np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(time), -1)


def is_periodic(solution, allowed):
    """Whether periodic variability is left in a fit, or it has left many allowed cadences out."""
    if (allowed & ~solution.use).sum() > _MANY_OUTLIERS * allowed.sum():
        return True
    _, gain = _spectrum(solution)
    return bool(gain.max(initial=0.0) > _SIGNIFICANT)


def find_frequencies(solution, allowed):
    """
    Find the frequencies of a star's variability, one after the other.

    In each round all columns are fitted together, and the frequencies that explain most of the
    rest are added. Regressors are among the columns: what they explain is not variability.

    Parameters
    ----------
    solution : Solution
        A fit without periodic variability; its data and columns are used, not its variances.
    allowed : ndarray of bool
        Cadences that may be used, of all usable ones.

    Returns
    -------
    ndarray
        Frequencies in cycles per day.
    """
    n_most = min(_MOST, allowed.sum() // _CADENCES_PER_FREQUENCY)
    found, rest, judged = np.empty(0), solution.y, False
    for _ in range(_ROUNDS):
        use = allowed.copy()
        use[allowed] = ~_stands_alone(rest[allowed])
        trial = _with_simple_noise(solution.with_frequencies(found, use), rest)
        frequency, gain = _spectrum(trial)
        new = _peaks(frequency, gain, 1 / np.ptp(trial.data.time))
        if not len(new) or len(found) + len(new) > n_most:
            break
        found = np.append(found, [_refined(f, trial) for f in new])
        if not judged and len(found) >= _ENOUGH_TO_JUDGE:
            judged = True
            if _is_continuous(found, solution, use):
                first = _eclipses(solution, use)
                return np.empty(0) if first is None else _multiples(first, trial, use)
        plain = replace(solution, hyper=trial.hyper)
        found = found + _shifts(found, plain, use)
        rest = plain.with_frequencies(found, use).unexplained
    plain = replace(solution, hyper=trial.hyper)
    found = _significant(found, plain, use)
    first = _fundamental(found, solution) or _eclipses(solution, use)
    if first is None:
        return found
    multiples = _multiples(first, plain, use)

    def left(frequencies):
        return np.var(plain.with_frequencies(frequencies, use).unexplained[use])

    if left(multiples) >= _MUCH_MORE * left(found):
        return found
    trials = [multiples[: round(part * len(multiples))] for part in _FRACTIONS]
    # with all cadences: what few multiples miss are the steepest ones
    return max(
        trials, key=lambda trial: _likelihood(plain, trial, allowed) + len(trial) * np.log(FLAT)
    )


def _is_continuous(frequencies, solution, use):
    """Whether a star varies at all frequencies, so that these are no better than a process."""
    if _divisor(np.sort(frequencies), solution) is not None:
        return False
    alone = _likelihood(solution, (), use)
    return _likelihood(solution, frequencies, use) < alone - _WORSE


def _likelihood(solution, frequencies, use):
    """Return the logarithm of the likelihood with frequencies, and with the process or little."""
    trial, hyper = solution.with_frequencies(frequencies, use), solution.hyper
    parts = [replace(hyper, amplitude=part * hyper.amplitude) for part in _PARTS]
    return max(log_likelihood(trial.data, fit_columns(trial.data, hyper)) for hyper in parts)


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


def _fastest(solution):
    """Return the fastest frequency that the cadences resolve."""
    return 0.5 / float(np.median(np.diff(solution.data.time)))


def _fundamental(frequencies, solution):
    """Return the frequency of which most are multiples up to fast ones, None if there is none."""
    limit = _SHARP * _fastest(solution)
    if frequencies.max(initial=0.0) < limit:
        return None
    return _divisor(np.sort(frequencies[frequencies < limit]), solution)


def _divisor(slow, solution):
    """Return the frequency of which most of some are multiples, None if there is none."""
    near = 0.5 * _APART / np.ptp(solution.data.time)
    for first in np.divide.outer(slow[:_AT_ONCE], (1, 2, 3)).ravel():
        number = np.maximum(np.round(slow / first), 1)
        good = np.abs(slow - number * first) < near
        if good.mean() > _MULTIPLES and len(np.unique(number)) > _MULTIPLES * number.max():
            number, slow = number[good], slow[good]
            return float(number @ slow / (number @ number))
    return None


def _eclipses(solution, use):
    """Return the frequency of the orbit if eclipses explain much of the light, else None."""
    time, y = solution.time[use], solution.y[use]
    step, span = float(np.median(np.diff(time))), np.ptp(time)
    search, best = BoxLeastSquares(time, y), (_LEFT * np.var(y), None)
    for duration in step * _DURATIONS:
        # steps by which the last eclipse moves by less than half of its duration
        last = np.log(_PART_OF_ORBIT / duration)
        count = (last - np.log(2 / span)) / (0.5 * duration / span)
        if 0 < count < _MOST_PERIODS:
            frequency = 2 / span * np.exp(0.5 * duration / span * np.arange(np.ceil(count)))
            power = search.power(1 / frequency, duration, objective="likelihood", oversample=5)
            k = np.argmax(power.power)
            box = search.model(time, power.period[k], duration, power.transit_time[k])
            best = min(best, (np.var(y - box), 0.5 * frequency[k]), key=lambda pair: pair[0])
    return best[1]  # the two eclipses of an orbit may be alike


def _multiples(first, solution, use):
    """Return the multiples of a frequency, which is improved with ever more of them."""
    limit = min(int(_LAST * _fastest(solution) / first), _MOST_MULTIPLES)
    for most in (10, 20, 40):
        number = np.arange(1, min(most, limit) + 1)
        first += float(_shifts(first * number, solution, use, number)[0])
    return first * np.arange(1, min(use.sum() // _CADENCES_PER_MULTIPLE, limit) + 1)


def _shifts(frequencies, solution, use, numbers=None):
    """
    Return one step of Gauss and Newton.

    It is for each frequency, or with ``numbers`` for the one of which they are multiples.
    """
    trial = solution.with_frequencies(frequencies, use)
    k, n = trial.n_regressors, solution.n_trend
    cos, sin = trial.posterior.mean[k + n : k + trial.n_trend].reshape(-1, 2).T
    phase = 2 * np.pi * np.outer(trial.time, frequencies)
    slope = 2 * np.pi * trial.time[:, None] * (sin * np.cos(phase) - cos * np.sin(phase))
    if numbers is not None:
        slope = slope @ numbers[:, None]
    trial = trial.with_flat(slope, use)
    step = trial.posterior.mean[k + trial.n_trend :] / trial.scale[trial.n_trend :]
    limit = _LARGEST_SHIFT / np.ptp(trial.data.time)
    return np.clip(step, -limit, limit)


def _stands_alone(y):
    """Cadences far from the ones around them: cosmic rays and other accidents."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(y, 2, mode="edge"), 5)
    difference = y - np.median(windows, axis=1)
    return np.abs(difference) > _ALONE * max(mad_std(difference), np.finfo(float).tiny)


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
    """
    Return what a cosine and a sine at each frequency would gain.

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
    limit = max(_SIGNIFICANT, _PART * gain.max(initial=0.0))
    inner = gain[1:-1]
    top = np.flatnonzero((inner >= gain[:-2]) & (inner > gain[2:]) & (inner > limit)) + 1
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
