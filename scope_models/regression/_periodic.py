"""Variability that is no slow process: waves of stars that pulsate or rotate, short changes."""

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from astropy.stats import mad_std
from scipy import ndimage
from scipy.optimize import minimize
from scipy.signal import find_peaks
from scipy.stats import t as student_t

from scope_models.pixelmodel._smooth import ROUNDS
from scope_models.pixelmodel._star import SMALL_STEP
from scope_models.regression._variances import SLOWEST, TOLERANCE, Hyperparameters, Posterior

__all__ = ["FAST", "find_rotation", "find_waves", "short_changes", "with_edges"]

#: Branch: cycles per day: a star without any frequency above this has long-term variability alone.
FAST = 1.0

#: Prior: twice the gain of the likelihood's logarithm that a pair of columns must bring. White
#: noise exceeds it at one of 10^8 frequencies.
_SIGNIFICANT = 40.0
#: Tolerance: frequencies found in one round, and how far apart they are in units of one over the
#: length of the observation: nearer ones share a peak.
_AT_ONCE, _APART = 6, 1.5
#: Tolerance: a series is sought of which a wave is a harmonic up to this one.
_STRONGEST = 5
#: Tolerance: standard deviation of frequencies that are found, in the same unit, far less than the
#: distance of two peaks: of multiples from another one, and the prior of a step, a quarter of it
#: after each one that led nowhere.
_SHIFT = 0.2
#: Prior: at most one frequency, which has three parameters, for so many cadences.
_CADENCES_PER_FREQUENCY = 8
#: Branch: cadences that differ from the median of five by so many standard deviations are left out
#: of the search.
_ALONE = 10.0
#: Prior: turns in which a rotation drifts, of short (1 to 4) to long (15) lifetimes of spots (Basri
#: et al. 2022, arXiv:2110.13284); harmonics: an equatorial spot has a twelfth of the first beyond.
_TURNS, _HARMONICS = (2.0, 10.0), 3
#: Tolerance: standard deviations of frequencies about a harmonic (0.3 % are beyond), and after
#: which it may repeat itself.
_REACH = 3.0
#: Prior: changes last 1.5 to 12 h, as most transits: means of so many days, in runs of so many.
_MEAN, _RUNS = 0.0625, (1, 2, 3, 4, 6, 8)
#: Tolerance: number of runs of a light curve that deviate as much by chance.
_CHANCE = 0.1


@dataclass(frozen=True)
class _Waves:
    """Harmonics of one frequency, and others; ``fit`` returns a `Solution` with such columns."""

    others: tuple = ()
    base: float = 0.0
    count: int = 0

    @property
    def frequencies(self):
        return np.append(self.base * np.arange(1, self.count + 1), self.others)

    def columns(self, time):
        """Return a cosine and a sine per frequency.

        Amplitudes of harmonics of a light curve with jumps fall as 1/k, and exposures average them.
        """
        k = np.arange(1, self.count + 1)
        turns = np.exp(2j * np.pi * np.outer(time, np.append(self.others, self.base)))
        waves = np.repeat(turns[:, -1:], self.count + len(self.others), axis=1)
        waves[:, self.count :] = turns[:, :-1]
        series = waves[:, : self.count]
        np.cumprod(series, axis=1, out=series)
        series *= np.sinc(k * self.base * np.median(np.diff(time))) / k
        return waves.view(float)

    def improbability(self, n):
        """Return minus the log-prior of frequencies, of which n cadences resolve n / 2."""
        return (len(self.others) + (self.count > 0)) * np.log(n / 2)

    def settled(self, fit):
        """Return it after steps of Gauss and Newton, shorter ones where needed."""
        waves, size = self, _SHIFT
        for _ in range(ROUNDS):
            moved, steps = waves._shifted(fit(waves), size)
            if fit(moved).log_likelihood > fit(waves).log_likelihood:
                waves = moved
            else:
                size /= 4
            if np.max(steps, initial=0.0) < SMALL_STEP:
                break
        return waves

    def _rows(self, fitted):
        """Return its first flat column in a fit, and the one after the last."""
        return fitted.n_trend - 2 * len(self.frequencies), fitted.n_trend

    def _shifted(self, fitted, size):
        """Return it after one step from a fit, whose prior has a size; and steps over errors."""
        count, k, (first, last) = self.count, fitted.n_regressors, self._rows(fitted)
        amplitudes, waves = fitted.posterior.mean[k + first : k + last], fitted.flat[:, first:last]
        slope = waves[:, ::2] * amplitudes[1::2] - waves[:, 1::2] * amplitudes[::2]
        slope *= 2 * np.pi * fitted.time[:, None]
        sizes = np.ones(len(self.others))
        if count:
            series = slope[:, :count] @ np.arange(1, count + 1)
            slope, sizes = np.column_stack([series, slope[:, count:]]), np.append(count, sizes)
        slope = slope[fitted.use]
        right, precision = slope.T @ fitted.alpha, fitted.products(slope)
        precision.flat[:: len(sizes) + 1] += (sizes * np.ptp(fitted.data.time) / size) ** 2
        covariance = np.linalg.inv(precision)
        step = covariance @ right
        base = self.base + step[0] if count else 0.0
        steps = np.abs(step) / np.sqrt(np.diag(covariance))
        others = np.add(self.others, step[int(count > 0) :])
        return _Waves(tuple(others), base, count), steps

    def gains(self, fit):
        """Return what each frequency gains beside the others: twice the log-likelihood."""
        fitted = fit(self)
        rows = fitted.n_regressors + np.arange(*self._rows(fitted)).reshape(-1, 2)
        mean = fitted.posterior.mean[rows]
        covariance = fitted.posterior.covariance[rows[:, :, None], rows[:, None, :]]
        return np.einsum("ij,ij->i", mean, np.linalg.solve(covariance, mean[:, :, None])[:, :, 0])

    def last(self, gains):
        """Return the number of the last harmonic that is needed."""
        return int(np.flatnonzero(gains[: self.count] >= _SIGNIFICANT).max(initial=-1)) + 1

    def completed(self, fit, most):
        """Return it with as many harmonics as are needed, at most so many."""
        waves, count = self, 0
        while count < min(2 * waves.count, most):
            count = min(2 * waves.count, most)
            waves = replace(waves, count=count).settled(fit)
            waves = replace(waves, count=waves.last(waves.gains(fit)))
        return waves

    def significant(self, fit):
        """Return it without frequencies that are not needed; of a series, the last ones go."""
        waves = self
        while len(waves.frequencies):
            gain = waves.gains(fit)
            count, gain = waves.last(gain), gain[waves.count :]
            weak = gain < _SIGNIFICANT
            if count == waves.count and not weak.any():
                break
            # those that share a peak are weak alone: half of them go at once
            limit = np.median(gain[weak]) if weak.any() else 0.0
            others = np.array(waves.others)[~(weak & (gain <= limit))]
            waves = _Waves(tuple(others), waves.base, count)
        return waves


@dataclass(frozen=True)
class _Rotation:
    """Harmonics of one frequency that drift, as those of spots: a Gaussian process.

    The covariance of a wave times exp(-tau^2 / 2 c^2) is that of waves whose frequencies have a
    normal distribution about its own, of the standard deviation 1 / (2 pi c).
    """

    frequencies: np.ndarray
    amplitudes: np.ndarray

    @classmethod
    def at(cls, base, turns, count, length):
        """Return that of some harmonics, which drift within turns, for a ``length`` of data."""
        coherence = turns / base
        step = 1 / (length + _REACH * coherence)
        n = int(np.ceil(_REACH / (2 * np.pi * coherence * step)))
        beside = step * np.arange(-n, n + 1)
        amplitudes = np.exp(-((np.pi * coherence * beside) ** 2))
        frequencies = base * np.arange(1, count + 1)[:, None] + beside
        return cls(frequencies.ravel(), np.tile(amplitudes / np.linalg.norm(amplitudes), count))

    def columns(self, time):
        """Return a cosine and a sine per frequency; those of a harmonic add to a size of one."""
        return (self.amplitudes * np.exp(2j * np.pi * np.outer(time, self.frequencies))).view(float)

    @staticmethod
    def improbability(n):
        """Return minus the log-prior of a frequency and of its distribution."""
        return 2 * np.log(n / 2)


def find_rotation(solution, rest):
    """Return the most likely `_Rotation` of slow variability, beside the noise of a rest.

    The strongest slow wave is its first harmonic or the second one.
    """
    bare = _with_simple_noise(solution, rest)
    data, length = bare.data, np.ptp(bare.data.time)
    frequency, gain = _spectrum(bare)
    cycles = max(length * frequency[np.argmax(gain * (frequency < FAST))], 2.0)

    def rotation(theta, k, count):
        return _Rotation.at(theta[0] / k / length, np.exp(theta[1]), count, length)

    def misfit(theta, *kind):
        columns = rotation(theta, *kind).columns(data.time)
        products = bare.products(np.column_stack([columns, data.y]))
        posterior = Posterior(products, np.full(columns.shape[1], data.spread))
        return posterior.quadratic + posterior.log_determinant

    bounds = (cycles - _APART, cycles + _APART), tuple(np.log(_TURNS))
    start, method = np.mean(bounds, axis=1), "Nelder-Mead"
    kinds = [(k, count) for k in (1, 2) for count in range(k, _HARMONICS + 1)]
    kind = min(kinds, key=lambda each: misfit(start, *each))
    best = minimize(misfit, start, kind, method=method, bounds=bounds, tol=2 * TOLERANCE)
    return rotation(best.x, *kind)


def find_waves(solution, allowed):
    """Return the `_Waves` of a star's variability, found one after the other.

    In each round all columns are fitted together, regressors too, and the frequencies that explain
    most of the rest are added. If harmonics of one frequency are more likely, as of eclipses, these
    take their place.
    """
    n_most = allowed.sum() // _CADENCES_PER_FREQUENCY
    waves, rest = _Waves(), solution.y
    for _ in range(ROUNDS):
        # without cadences far from the ones around them: cosmic rays and other accidents
        difference = rest[allowed] - ndimage.median_filter(rest[allowed], 5, mode="nearest")
        use = allowed.copy()
        use[allowed] = np.abs(difference) <= _ALONE * max(mad_std(difference), 1e-300)
        trial = _with_simple_noise(solution.with_waves(waves, use), rest)
        frequency, gain = _spectrum(trial)
        apart = _APART / np.ptp(trial.data.time) / frequency[1]
        peaks, _ = find_peaks(gain, _SIGNIFICANT, distance=apart)
        new = frequency[peaks[np.argsort(gain[peaks])[: -_AT_ONCE - 1 : -1]]]
        if not len(new) or len(waves.frequencies) + len(new) > n_most:
            break
        fit = _fitter(solution, trial)
        waves = replace(waves, others=(*waves.others, *new)).settled(fit)
        waves = _with_series(waves, fit, n_most)
        rest = fit(waves).unexplained
    return waves.significant(_fitter(solution, trial))


def _fitter(solution, trial):
    """Return the function from waves to their fits with the variances and cadences of a trial."""
    plain = replace(solution, hyper=trial.hyper)
    # a step compares two; a fit of many waves takes 100 MB
    return lru_cache(maxsize=2)(partial(plain.with_waves, use=trial.use))


def _with_series(waves, fit, n_most):
    """Return the waves, or harmonics of one frequency and what is left if they are more likely.

    Most of the waves are multiples of the frequency, by less chance than of others. Of two nearly
    equal eclipses in a period even multiples are the strongest: if as many multiples of half of it
    gain much more, or odd ones are needed, it is half.
    """
    time = fit(waves).data.time
    length = np.ptp(time)
    near = _SHIFT / length

    def multiples(frequencies, base):
        number = np.round(frequencies / base)
        return (number > 0) & (np.abs(frequencies - base * number) < near)

    pool = np.append(waves.others, np.full(min(waves.count, 1), waves.base))
    bases = np.unique(pool[:, None] / np.arange(1, _STRONGEST + 1))
    bases = bases[bases > 2 / length]
    if not len(bases):
        return waves
    found = np.array([multiples(pool, base).sum() for base in bases])
    best = np.argmax(found * np.log(bases / (2 * near)))
    if found[best] < max(2, len(pool) / 2):
        return waves
    base, frequencies = bases[best], waves.frequencies
    others = tuple(frequencies[~multiples(frequencies, base)])
    last = round(frequencies[multiples(frequencies, base)].max() / base)
    series = _Waves(others, base, last)
    # later its odd multiples are peaks of their own
    may_be_half = not waves.count and base > 4 / length
    if may_be_half:
        double = replace(series, count=min(2 * last, n_most)).settled(fit)
        half = replace(double, base=double.base / 2)
        gain = 2 * (fit(half).log_likelihood - fit(double).log_likelihood)
        if gain > half.count * _SIGNIFICANT:  # and nothing else needs to be tried
            series, may_be_half = half, False
    series = series.completed(fit, n_most)
    found = [waves, series]
    if may_be_half:
        half = replace(series, base=series.base / 2, count=min(2 * series.count, n_most))
        if np.max(half.gains(fit)[: half.count : 2], initial=0.0) >= _SIGNIFICANT:
            found.append(replace(half, count=series.count).completed(fit, n_most))
    return max(found, key=lambda each: fit(each).log_likelihood - each.improbability(len(time)))


def _with_simple_noise(solution, rest):
    """Return a fit with the noise of a rest, and weak priors; what is slow is a random walk."""
    data, rest = solution.data, rest[solution.use]
    jitter = mad_std(np.diff(rest, 2)) / np.sqrt(6)
    variance = np.median(data.variance)
    width = max(round(1 / float(np.median(np.diff(data.time)))), 1)
    slow = max(float(np.var(ndimage.uniform_filter1d(rest, width))), variance / width)
    unit = np.minimum(float(np.var(data.y)) / data.sizes, data.most)
    walk = slow / float(np.ptp(data.time))
    hyper = Hyperparameters(max(jitter**2 / variance, 1.0), unit, 0.0, 1.0, walk)
    return replace(solution, hyper=hyper)


def _spectrum(solution):
    """Return frequencies, and twice the gain of the log-likelihood by a cosine and a sine at each.

    That is |c^T a|^2 / (c^T Q c) with the inverse covariance Q and a = Q y. Here Q is that of noise
    and slow process alone, which makes the gain smaller where regressors explain the same.
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


def short_changes(solution):
    """Return columns ``(n_cadences, n_changes)`` that are 1 in runs whose mean deviates.

    It does so from what all other cadences predict with regressors and a slow process. The unit is
    the typical deviation of runs of the same length: by chance, deviations follow Student's t.
    """
    time, used = solution.time, solution.data.time
    width = _width(used)
    if len(used) < 2 * width * _RUNS[-1]:
        return np.empty((len(time), 0))
    runs = _runs(solution.data.averaged(width), solution.posterior.mean, solution.hyper)
    begins, ends = used[width * runs[:, 0]], used[width * runs[:, 1] - 1]
    columns = ((time[:, None] >= begins) & (time[:, None] <= ends)).astype(float)
    # half of the cadences in use remain
    lost = with_edges(time, columns.any(axis=1))[solution.use]
    return columns[:, : 0 if lost.mean() > 0.5 else None]


def with_edges(time, short):
    """Return short changes, or their sizes, with cadences around them, where they may begin."""
    return ndimage.maximum_filter(short, 2 * _width(time) + 1)


def _width(time):
    """Return the number of cadences of a mean."""
    return max(round(_MEAN / float(np.median(np.diff(time)))), 1)


def _runs(data, mean, hyper):
    """Return the first means of runs that deviate, and those after the last, ``(n_runs, 2)``."""
    n, rest = len(data.y), data.y - data.columns @ mean
    amplitude = min(hyper.amplitude, max(mad_std(rest) ** 2, np.median(data.variance)))
    hyper = replace(hyper, amplitude=amplitude, period=SLOWEST, walk=0.0)
    process = hyper.process(data)
    inverse = [process.inverse_blocks(np.arange(n - k + 1), k).sum(axis=(1, 2)) for k in _RUNS]
    free, runs = np.ones(n, dtype=bool), np.empty((0, 2), dtype=int)
    limits = [student_t.isf(_CHANCE / 2 / sum(map(len, inverse)), n / k) for k in _RUNS]
    for _ in range(ROUNDS):
        index = np.arange(n)[:, None]
        boxes = (index >= runs[:, 0]) & (index < runs[:, 1])
        trial = replace(data, columns=np.concatenate([data.columns, boxes], axis=1))
        whitened = process.whiten(trial.stacked)
        solved = process.solve_whitened(whitened)
        posterior = Posterior(whitened.T @ whitened, hyper.prior(trial))
        solved[:, -1] -= solved[:, :-1] @ posterior.mean
        sums = np.cumsum(np.pad(solved, ((1, 0), (0, 0))), axis=0)
        deviating, new = [], []
        for k, precision, limit in zip(_RUNS, inverse, limits, strict=True):
            run = sums[k:] - sums[:-k]
            explained = np.einsum("ij,ij->i", run[:, :-1] @ posterior.covariance, run[:, :-1])
            size = np.abs(run[:, -1]) / np.sqrt(np.maximum(precision - explained, 1e-300))
            size /= 1.4826 * np.median(size)
            deviating += [(size[i], i, i + k) for i in np.flatnonzero(size > limit)]
        for _, *run in sorted(deviating, reverse=True):
            if free[slice(*run)].all():
                free[slice(*run)] = False
                new.append(run)
        if not new:
            break
        runs = np.concatenate([runs, new])
    return runs
