"""Regression of a star's flux on systematics, with variability on several time scales."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from scope_models.correctors._covariance import Covariance

__all__ = [
    "FluxModel",
    "Process",
    "fit_flux",
    "fit_hyper",
    "smooth_series",
    "with_periods",
    "without_outliers",
]

_FLAT = 1e4
#: A period is seen so many times, has so many multiples at most, and each costs about so much.
_FEWEST_CYCLES, _MOST_HARMONICS, _COST = 3.0, 60, 5.0
#: ... and may be so many times the one that the periodogram shows.
_LONGEST = 8
#: A period counts if the logarithm of the evidence grows by so much.
_LEAST_GAIN = 12.0
_MOST_PERIODS = 8
#: Frequencies that are tried at most, from the lowest on: with gaps of months there are millions.
_MOST_FREQUENCIES = 200_000
#: Factor of the variance of cadences that have no weight.
_NO_WEIGHT = 1e6
#: Windows at most that are predicted from all other cadences.
_MOST_WINDOWS = 120
#: Number of times at most that hyper-parameters are fitted again without outliers.
_REFITS = 4
#: The prior of the logarithm of each group's prior variance has this standard deviation about the
#: typical value.
_SPREAD = 1.0
#: Where the search for the hyper-parameters begins: the prior variance of each group in units of
#: the typical one, the variances of the processes in units of the data's; and the processes'
#: periods in days.
_STARTS = ((1.0, (1.0, 0.05)), (30.0, (0.01, 0.001)))
_PERIODS = (5.0, 0.3)


@dataclass(frozen=True)
class Process:
    """
    White noise plus damped oscillators of quality 1/sqrt(2).

    Parameters
    ----------
    noise_scale : float
        Factor of the white noise's variance.
    amplitudes, periods : tuple of float
        Variance and undamped period (days) of each oscillator.
    """

    noise_scale: float
    amplitudes: tuple
    periods: tuple

    def factor(self, time, variance):
        """Return the factorized covariance at increasing times."""
        return Covariance(time, self.noise_scale * variance, self.amplitudes, self.periods)


@dataclass(frozen=True)
class FluxModel:
    """
    Model of the logarithm of a flux: columns with Gaussian priors, a process, and white noise.

    Parameters
    ----------
    time, y, variance : ndarray
        Days, data near zero, and variance of their white noise, ``(n,)``.
    use : ndarray of bool
        Cadences in the fit.
    columns : ndarray
        ``(n, k)``; those of no group have flat priors.
    groups : ndarray of int
        Group of each column, -1 for flat priors.
    names : tuple of str
        Names of the groups.
    prior : ndarray
        Prior variance of each group.
    process : Process
        Noise and variability.
    systematic : tuple of str
        Names of the groups that are systematics: the first ones.
    bounds : tuple of (float, float, float)
        Least, typical and largest prior variance of each of these.
    """

    time: np.ndarray
    y: np.ndarray
    variance: np.ndarray
    use: np.ndarray
    columns: np.ndarray
    groups: np.ndarray
    names: tuple
    prior: np.ndarray
    process: Process
    systematic: tuple = ()
    bounds: tuple = ()

    @cached_property
    def spread(self):
        return max(float(np.var(self.y[self.use])), float(np.median(self.variance[self.use])))

    @cached_property
    def sizes(self):
        square = np.mean(self.columns[self.use] ** 2, axis=0)
        inside = self.groups >= 0
        sums = np.bincount(self.groups[inside], square[inside], minlength=len(self.names))
        return np.maximum(sums, 1e-300)

    def column_prior(self, prior=None):
        prior = self.prior if prior is None else prior
        values = np.append(prior, _FLAT * self.spread)
        return values[self.groups]

    @cached_property
    def factor(self):
        return self.process.factor(self.time[self.use], self.variance[self.use])

    @cached_property
    def gram(self):
        z = self.factor.whiten(np.column_stack([self.columns[self.use], self.y[self.use]]))
        return z.T @ z

    @cached_property
    def _solution(self):
        root = np.sqrt(self.column_prior())
        m = root[:, None] * self.gram[:-1, :-1] * root
        m.flat[:: len(root) + 1] += 1
        lower = np.linalg.cholesky(m)
        half = np.linalg.inv(lower) * root
        return half, half @ self.gram[:-1, -1], 2 * np.sum(np.log(np.diag(lower)))

    @property
    def mean(self):
        half, projected, _ = self._solution
        return half.T @ projected

    @property
    def covariance(self):
        half = self._solution[0]
        return half.T @ half

    @property
    def log_evidence(self):
        _, projected, log_determinant = self._solution
        quadratic = self.gram[-1, -1] - projected @ projected
        n = self.use.sum()
        whole = quadratic + log_determinant + self.factor.log_determinant
        return float(-0.5 * (whole + n * np.log(2 * np.pi)))

    @cached_property
    def alpha(self):
        """Whitened rest of the data in use: ``inv(K) @ (y - columns @ mean)``."""
        rest = (self.y - self.columns @ self.mean)[self.use]
        return self.factor.solve(rest[:, None])[:, 0]

    def part(self, names):
        """Return the sum of some groups' parts of the model, ``(n,)``, and their columns."""
        chosen = np.isin(self.groups, [self.names.index(n) for n in names if n in self.names])
        return self.columns[:, chosen] @ self.mean[chosen], chosen

    def systematics(self):
        """Return the systematics and their variance."""
        part, chosen = self.part(self.systematic)
        x = self.columns[:, chosen]
        covariance = self.covariance[np.ix_(chosen, chosen)]
        return part, np.einsum("ij,jk,ik->i", x, covariance, x)

    def trend(self):
        """Return the mean of the process at all times."""
        return self.factor.predict(self.alpha, self.time)

    def variability(self, *, flat):
        """Return the star's variability: processes, periods and, if wanted, flat columns."""
        inside = self.groups >= len(self.systematic)
        if flat:
            inside |= self.groups == -1
        return self.trend() + self.columns[:, inside] @ self.mean[inside]

    def flat_coefficient(self):
        """Return the coefficient of the last column and its standard deviation."""
        return float(self.mean[-1]), float(np.sqrt(self.covariance[-1, -1]))

    def with_flat(self, column, use):
        """Return the model with one more column with a flat prior, and other cadences."""
        return replace(
            self,
            columns=np.concatenate([self.columns, column], axis=1),
            groups=np.append(self.groups, -1),
            use=use,
        )

    def survival(self, width):
        """Return the part of a box-shaped dip of so many cadences that the systematics leave."""
        _, chosen = self.part(self.systematic)
        n = self.use.sum() // width
        x = self.columns[self.use][: n * width].reshape(n, width, -1)
        solved = self.factor.solve(self.columns[self.use])[: n * width].reshape(n, width, -1)
        moved = solved.sum(axis=1) @ self.covariance[:, chosen]
        return float(1 - np.mean(np.sum(moved * x.mean(axis=1)[:, chosen], axis=1)))

    def held_out(self, width, cadences, most=_MOST_WINDOWS):
        """
        Predict windows of cadences, each from all other cadences in use.

        Parameters
        ----------
        width : int
            Cadences in a window.
        cadences : ndarray of bool
            Cadences in the windows; those not in use are predicted, and have no weight.
        most : int, optional
            Number of windows at most, spread over the series.

        Returns
        -------
        residual, error : ndarray
            Mean of measured minus predicted, and its expected standard deviation, per window.
        used : ndarray
            Indices of their cadences, one window after the other.
        """
        variance = np.where(self.use, self.variance, _NO_WEIGHT * self.variance)
        whole, n = replace(self, variance=variance, use=cadences), cadences.sum()
        starts = np.unique(np.linspace(0, n // width - 1, most).astype(int)) * width
        rows = (starts[:, None] + np.arange(width)).ravel()
        single = np.zeros((n, len(rows)))
        single[rows, np.arange(len(rows))] = 1
        shape = (len(starts), width, len(starts), width)
        inverse = whole.factor.solve(single)[rows].reshape(shape)
        inverse = np.einsum("iaib->iab", inverse)
        x = whole.factor.solve(whole.columns[cadences])[rows].reshape(len(starts), width, -1)
        covariance = np.linalg.inv(inverse - (x @ whole.covariance) @ x.transpose(0, 2, 1))
        alpha = whole.alpha[rows].reshape(len(starts), width, 1)
        residual = (covariance @ alpha)[:, :, 0].mean(axis=1)
        more = self.process.noise_scale * (variance - self.variance)[cadences][rows]
        total = covariance.sum(axis=(1, 2)) - more.reshape(-1, width).sum(axis=1)
        return residual, np.sqrt(total) / width, np.flatnonzero(cadences)[rows]

    def deviations(self):
        """Return rests from the whole model in standard deviations of the white noise, ``(n,)``."""
        rest = self.y - self.columns @ self.mean - self.trend()
        return rest / np.sqrt(self.process.noise_scale * self.variance)


def _fit_groups(model):
    """Maximize the evidence over prior variances and a common factor of the process."""
    gram, n, groups = model.gram, model.use.sum(), model.groups
    inside, k = groups >= 0, len(model.names)
    unit = np.log(model.spread / model.sizes)

    def objective(theta):
        scale = np.exp(theta[0])
        prior = model.column_prior(np.exp(theta[1:]))
        root = np.sqrt(prior)
        m = root[:, None] * gram[:-1, :-1] * root / scale
        m.flat[:: len(root) + 1] += 1
        try:
            lower = np.linalg.cholesky(m)
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(theta)
        half = np.linalg.inv(lower)
        projected = half @ (root * gram[:-1, -1]) / scale
        quadratic = gram[-1, -1] / scale - projected @ projected
        value = quadratic + 2 * np.sum(np.log(np.diag(lower))) + n * theta[0]
        mean = half.T @ projected  # in units of the prior
        used = 1 - np.einsum("ij,ij->j", half, half)
        slope = np.bincount(groups[inside], (used - mean**2)[inside], minlength=k)
        rest = quadratic - mean @ mean
        pull = 2 * (theta[1:] - unit) / _SPREAD**2
        value += np.sum((theta[1:] - unit) ** 2) / _SPREAD**2
        return 0.5 * value, 0.5 * np.array([n - used.sum() - rest, *(slope + pull)])

    bounds = [(-3.0, 3.0), *zip(unit - 25, unit + 7, strict=True)]
    for i, (least, typical, largest) in enumerate(model.bounds):
        bounds[i + 1] = (np.log(least), np.log(largest))
        unit[i] = np.log(typical)
    start = np.clip([0.0, *np.log(model.prior)], *np.transpose(bounds))
    found = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds,
                     options={"maxiter": 60, "ftol": 1e-3 / n}).x  # fmt: skip
    scale = np.exp(found[0])
    process = replace(
        model.process,
        noise_scale=model.process.noise_scale * scale,
        amplitudes=tuple(a * scale for a in model.process.amplitudes),
    )
    return replace(model, prior=np.exp(found[1:]), process=process)


def _compressed(model, smallest=1e-2):
    """Return the same model with few columns, whose priors are 1."""
    root = np.sqrt(model.column_prior())
    values, vectors = np.linalg.eigh(root[:, None] * model.gram[:-1, :-1] * root)
    vectors = vectors[:, values > smallest]
    columns = model.columns[model.use] @ (root[:, None] * vectors)
    return columns, model.time[model.use], model.y[model.use], model.variance[model.use]


def _fit_process(model, shortest):
    """Maximize the evidence over noise and oscillators with the columns compressed."""
    columns, time, y, variance = _compressed(model)
    stacked = np.column_stack([columns, y])
    m = len(model.process.periods)
    span = time[-1] - time[0]

    def unpack(theta):
        theta = np.exp(theta)
        return Process(theta[0], tuple(theta[1 : m + 1]), tuple(theta[m + 1 :]))

    def objective(theta):
        try:
            factor = unpack(theta).factor(time, variance)
            z = factor.whiten(stacked)
            gram = z.T @ z
            lower = np.linalg.cholesky(gram[:-1, :-1] + np.eye(len(gram) - 1))
            projected = np.linalg.solve(lower, gram[:-1, -1])
        except np.linalg.LinAlgError:
            return 1e300
        value = gram[-1, -1] - projected @ projected + 2 * np.sum(np.log(np.diag(lower)))
        return 0.5 * (value + factor.log_determinant)

    low, high = np.log(1e-4 * np.median(variance)), np.log(100 * model.spread)
    longest = np.maximum(shortest, (10 * span, 1.5)[:m])
    periods = list(zip(np.log(shortest), np.log(longest), strict=True))
    bounds = [(np.log(0.8), 12.0), *[(low, high)] * m, *periods]
    start = np.log([model.process.noise_scale, *model.process.amplitudes, *model.process.periods])
    start = np.clip(start, *np.transpose(bounds))
    found = minimize(objective, start, method="L-BFGS-B", bounds=bounds,
                     options={"maxiter": 20, "ftol": 0.02 / len(y), "eps": 1e-3})  # fmt: skip
    return replace(model, process=unpack(found.x))


def fit_hyper(model, shortest=(0.7, 0.06), rounds=4, tolerance=0.3):
    """Improve prior variances and process by turns."""
    value = model.log_evidence
    for _ in range(rounds):
        trial = _fit_process(_fit_groups(model), shortest[: len(model.process.periods)])
        new = trial.log_evidence
        if new > value:
            model = trial
        if new < value + tolerance:
            break
        value = new
    return model


def without_outliers(model, allowed, sigma=5.0, largest=0.3):
    """
    Leave out cadences that deviate from the whole model, never many.

    Parameters
    ----------
    model : FluxModel
        A fitted model.
    allowed : ndarray of bool
        Cadences that may be used.
    sigma : float
        Those that deviate by more standard deviations are left out.
    largest : float
        Largest part that may be.
    """
    for _ in range(4):
        deviations = np.abs(model.deviations())
        # outliers have raised the fitted noise, but it is not below FLUX_ERR
        formal = model.process.noise_scale**-0.5
        spread = max(1.4826 * np.median(deviations[model.use]), min(formal, 1.0))
        use = allowed & (deviations < sigma * spread)
        if (use == model.use).all() or use.sum() < (1 - largest) * allowed.sum():
            break
        model = replace(model, use=use)
    return model


def with_columns(model, name, columns, prior):
    """Return the model with another group of columns, which are variability."""
    return replace(
        model,
        columns=np.concatenate([columns, model.columns], axis=1),
        groups=np.concatenate([np.full(columns.shape[1], len(model.names)), model.groups]),
        names=(*model.names, name),
        prior=np.append(model.prior, prior),
    )


def harmonics(time, frequency, count):
    """Return sines and cosines of a frequency and its multiples, ``(n, 2 count)``."""
    phase = 2 * np.pi * frequency * time[:, None] * np.arange(1, count + 1)
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


class _Candidates:
    """Evidence of further columns at a fixed process and fixed prior variances."""

    def __init__(self, model):
        self.model = model
        use = model.use
        self.z = model.factor.whiten(np.column_stack([model.columns[use], model.y[use]]))
        half, projected, _ = model._solution  # noqa: SLF001 (its own class's neighbor)
        self.half, self.projected = half, projected

    def gain(self, columns):
        """Return the gain in the logarithm of the evidence, and the best prior variance."""
        c = self.model.factor.whiten(columns[self.model.use])
        cross = self.half @ (self.z[:, :-1].T @ c)
        gram = c.T @ c - cross.T @ cross
        right = c.T @ self.z[:, -1] - cross.T @ self.projected
        values, vectors = np.linalg.eigh(gram)
        values, right = np.maximum(values, 1e-12), vectors.T @ right
        size = np.mean((right / values) ** 2)

        def evidence(prior):
            return 0.5 * np.sum(right**2 / (values + 1 / prior) - np.log1p(prior * values))

        return max((evidence(f * size), f * size) for f in (0.1, 0.5, 1.0, 3.0))


def _strongest(model):
    """
    Return the frequency, and number of multiples, that would explain most.

    The periodogram of the whitened rest, in units of what noise and processes leave there, is
    summed over the multiples of each frequency, with a cost for each.
    """
    time = model.time[model.use]
    step, span = np.median(np.diff(time)), time[-1] - time[0]
    index = np.round((time - time[0]) / step).astype(int)
    n = 1 << int(np.ceil(np.log2(8 * (index[-1] + 1))))
    grid = np.zeros(n)
    grid[index] = model.alpha
    frequency = np.fft.rfftfreq(n, step)
    few = np.geomspace(1 / span, 0.5 / step, 40)
    sines = np.concatenate([harmonics(time, f, 1) for f in few], axis=1)
    strength = np.sum(model.factor.whiten(sines) ** 2, axis=0).reshape(-1, 2).mean(axis=1)
    score = 0.5 * np.abs(np.fft.rfft(grid)) ** 2 / np.interp(frequency, few, strength)
    last = 0.95 * 0.5 / step
    score[frequency > last] = 0.0
    tried = np.arange(_FEWEST_CYCLES / span, last, 1 / (16 * span))[:_MOST_FREQUENCIES]
    multiples = np.round(tried[:, None] * np.arange(1, _MOST_HARMONICS + 1) / frequency[1])
    inside = multiples < len(score)
    found = np.where(inside, score[np.where(inside, multiples, 0).astype(int)], 0.0)
    gains = np.cumsum(found - _COST, axis=1)
    best = np.unravel_index(np.argmax(gains), gains.shape)
    return _Wave(tried[best[0]], int(best[1]) + 1, gains[best])


@dataclass(frozen=True)
class _Wave:
    """A period: frequency, number of multiples, gain of evidence and prior variance."""

    frequency: float
    count: int
    gain: float = -np.inf
    prior: float = 0.0


def _refined(candidates, wave, width, steps=3):
    """Improve the frequency of a wave within so many cycles of its highest multiple."""
    time = candidates.model.time
    best = wave
    step = width / (time[-1] - time[0]) / wave.count
    for _ in range(steps):
        center = best.frequency
        for shift in (-1.0, -0.5, 0.0, 0.5, 1.0):
            if shift == 0 and np.isfinite(best.gain):
                continue
            frequency = center + shift * step
            gain, prior = candidates.gain(harmonics(time, frequency, wave.count))
            if gain > best.gain:
                best = _Wave(frequency, wave.count, gain, prior)
        step /= 2.5
    return best


def _periodic(model):
    """Return the wave of the strongest period, or None."""
    rough = _strongest(model)
    if rough.gain < _LEAST_GAIN:
        return None
    candidates = _Candidates(model)
    wave = _refined(candidates, _Wave(rough.frequency, rough.count), 0.5, steps=4)
    if wave.gain < _LEAST_GAIN:
        return None
    span, nyquist = np.ptp(model.time), 0.5 / np.median(np.diff(model.time))
    sharp = []  # all multiples of a longer period, as sharp eclipses have them
    for part in range(1, _LONGEST + 1):
        frequency = wave.frequency / part
        if frequency * span < _FEWEST_CYCLES:
            break
        count = int(np.clip(0.95 * nyquist / frequency, 1, _MOST_HARMONICS))
        gain, prior = candidates.gain(harmonics(model.time, frequency, count))
        sharp.append(_Wave(frequency, count, gain, prior))
    best = max(sharp, key=lambda w: w.gain, default=wave)
    if best.gain > 0.5 * wave.gain:
        best = _refined(candidates, best, 0.5)
    return max(wave, best, key=lambda w: w.gain)


def with_periods(model):
    """
    Add the periods of a variable star, one after the other, as long as the evidence grows.

    Each has sines and cosines of a frequency and of as many multiples as the evidence supports.
    """
    for k in range(_MOST_PERIODS):
        wave = _periodic(model)
        if wave is None:
            break
        columns = harmonics(model.time, wave.frequency, wave.count)
        model = with_columns(model, f"period {k + 1}", columns, wave.prior)
        model = fit_hyper(model, rounds=2 if k == 0 else 1)
    return model


def fit_flux(time, y, variance, groups, allowed, *, limits, flat=None, start=None):
    """
    Fit the logarithm of a flux.

    Parameters
    ----------
    time, y, variance : ndarray
        Days, the logarithm, and the variance of its white noise, ``(n,)``.
    groups : dict of str to ndarray
        Columns of the systematics ``(n, k)`` by group.
    allowed : ndarray of bool
        Cadences that may be used.
    limits : dict of str to tuple of float
        Least, typical and largest prior standard deviation of the coefficients of each group.
    flat : ndarray, optional
        Further columns ``(n, m)`` with flat priors, such as a transit's.
    start : FluxModel, optional
        Fit of the same star with other columns of the same groups: its process and periods are
        where the search begins, and no more periods are sought.
    """
    names = tuple(groups)
    parts, index, bounds = [], [], []
    for k, name in enumerate(names):
        columns = groups[name] - groups[name][allowed].mean(axis=0)
        size = np.sqrt(np.mean(columns[allowed] ** 2, axis=0).sum())
        size = max(size, 1e-12)
        parts.append(columns / size)
        index.append(np.full(columns.shape[1], k))
        bounds.append([(max(limit, 1e-9) * size) ** 2 for limit in limits[name]])
    extra = np.ones((len(y), 1)) if flat is None else np.column_stack([np.ones(len(y)), flat])
    columns = np.concatenate([*parts, extra], axis=1)
    index = np.concatenate([*index, np.full(extra.shape[1], -1)])
    y = y - np.median(y[allowed])
    spread = max(float(np.var(y[allowed])), float(np.median(variance[allowed])))
    least, typical, largest = np.transpose(bounds)
    first = FluxModel(
        time, y, variance, allowed.copy(), columns, index, names, typical,
        Process(1.0, (spread,), (1.0,)), names, tuple(map(tuple, bounds)),
    )  # fmt: skip
    if start is None:
        trials = []
        for part, amplitudes in _STARTS:
            process = Process(1.0, tuple(a * spread for a in amplitudes), _PERIODS)
            prior = np.clip(part * typical, least, largest)
            trials.append(_fit_groups(replace(first, prior=prior, process=process)))
        model = with_periods(fit_hyper(max(trials, key=lambda trial: trial.log_evidence)))
    else:
        model = fit_hyper(_begun(first, start), rounds=2)
    for _ in range(_REFITS):
        cleaned = without_outliers(model, allowed)
        if (cleaned.use == model.use).all():
            break
        model = fit_hyper(cleaned, rounds=2)
    return without_outliers(model, allowed)


def _begun(model, start):
    """Return a model with the process, periods and prior variances of another one's fit."""
    m = len(model.names)
    more = start.groups >= m
    prior = start.prior.copy()
    prior[:m] = np.clip(prior[:m], *np.transpose(model.bounds)[[0, 2]])
    return replace(
        model,
        columns=np.concatenate([start.columns[:, more], model.columns], axis=1),
        groups=np.concatenate([start.groups[more], model.groups]),
        names=start.names,
        prior=prior,
        process=start.process,
        use=start.use & model.use,
    )


def smooth_series(time, values, variance, columns):
    """
    Return the smooth course of a state in time, without what follows the position.

    Parameters
    ----------
    time, values, variance : ndarray
        Days, the measured state and the variance of its noise, ``(n,)``.
    columns : ndarray
        Functions of position ``(n, k)`` that errors of the pixels' model may follow.
    """
    everything = np.ones(len(time), dtype=bool)
    level = np.median(values)
    variance = np.maximum(variance, 1e-6 * np.var(values) + 1e-300)
    spread = max(float(np.var(values)), float(np.median(variance)))
    centered = columns - columns.mean(axis=0)
    size = np.sqrt(np.mean(centered**2, axis=0).sum()) + 1e-12
    groups = np.append(np.zeros(columns.shape[1], dtype=int), -1)
    model = FluxModel(
        time, values - level, variance, everything,
        np.column_stack([centered / size, np.ones(len(time))]), groups, ("position",),
        np.array([0.3 * spread]), Process(1.0, (0.5 * spread, 0.01 * spread), _PERIODS),
        ("position",), ((1e-6 * spread, 0.3 * spread, 100 * spread),),
    )  # fmt: skip
    model = without_outliers(fit_hyper(model, rounds=2), everything)
    return model.variability(flat=True) + level
