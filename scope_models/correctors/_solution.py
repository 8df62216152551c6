"""The fit of a light curve: hyper-parameters, outliers, and what follows from them."""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from scope_models.correctors._periodic import (
    FAST,
    find_rotation,
    find_waves,
    short_changes,
    with_edges,
)
from scope_models.correctors._regression import (
    FLAT,
    Data,
    Hyperparameters,
    Posterior,
    fit_hyperparameters,
)

__all__ = ["NOISE_ERROR", "NothingToCorrectError", "Solution", "fit"]

#: Tolerance: factor of the variance of cadences that have next to no weight.
_NO_WEIGHT = 1e6
#: Tolerance: largest number of fits of the hyper-parameters after outliers were found.
_REFITS = 2
#: Prior: standard deviation of the logarithm of the noise's variance in units of FLUX_ERR's, which
#: that of real dark pixels exceeds by up to 1.17 twice: more is nothing that white noise explains.
NOISE_ERROR = 0.16

#: Prior: standard deviations of coefficients that are expected of predicted fractions: 1 % between
#: the responses of pixels (Kepler Instrument Handbook), a few percent within them, some 1e-4 of the
#: light at the aperture's edge; what each pixel shows beyond them counts in a weighted sum, or not.
#: The data may change each by a factor of a few.
_EXPECTED = {
    "order 1": 0.012,
    "order 2": 0.02,
    "segments": 1e-4,
    "focus": 1e-5,
    "aperture": 1.0,
    "misfit": 1.0,
}
#: Prior: ... of measured ones.
_MEASURED = {"level": 1.0}
#: Prior: those of the focus have a limit. The fractions hold what it does to pixels of different
#: response; within pixels a width that changes by 1 % changes the response by 5e-4 at most. What
#: seems to be a focus may be a dimming of the star beside constant light. So may a level of the
#: background or the misfit of a pixel, which count once.
_MOST = {"focus": 1e-4, "level": 1.0, "misfit": 1.0}


class NothingToCorrectError(ValueError):
    """No regressor varies."""


@dataclass(frozen=True)
class Solution:
    """A fitted model of the logarithm of the flux."""

    time: np.ndarray  # (n,), days from the first cadence in use, of all usable ones
    y: np.ndarray  # logarithm of the relative flux
    variance: np.ndarray
    use: np.ndarray  # cadences in the fit
    short: np.ndarray  # cadences of short changes, which are left out of it
    regressors: object  # for all usable cadences
    flat: np.ndarray  # columns with flat priors (n, m): constant, trend, transit
    scale: np.ndarray  # what the flat columns were divided by
    hyper: Hyperparameters
    n_trend: int = 1  # flat columns that are constant and variability
    frequencies: tuple = ()  # of the last columns of the variability, a cosine and a sine each, 1/d
    n_short: int = 0  # the next flat columns are short changes
    improbability: float = 0.0  # minus the logarithm of the prior of their parameters
    predicted: bool = False  # whether the fractions are

    @cached_property
    def data(self):
        use = self.use
        return Data(
            self.time[use],
            self.y[use],
            self.variance[use],
            np.concatenate([self.regressors.columns[use], self.flat[use]], axis=1),
            self.regressors.groups,
            self.flat.shape[1],
            **self._expectations,
        )

    @property
    def _expectations(self):
        known = _EXPECTED if self.predicted else _MEASURED
        expected = [known.get(name, np.nan) for name in self.regressors.names]
        most = [_MOST.get(name, 1e9) for name in self.regressors.names]
        found = {"expected": np.square(expected), "most": np.square(most)}
        if self.predicted and self.hyper and self.hyper.walk:  # which noise resembles
            found["noise_error"] = NOISE_ERROR
        return found

    @cached_property
    def process(self):
        return self.hyper.process(self.data.time, self.data.variance)

    @cached_property
    def whitened(self):
        """The columns and the data as `Covariance.whiten` makes them."""
        return self.process.whiten(self.data.stacked)

    @cached_property
    def posterior(self):
        return Posterior(self.whitened.T @ self.whitened, self.hyper.prior(self.data))

    @property
    def n_regressors(self):
        return len(self.regressors.groups)

    @cached_property
    def log_likelihood(self):
        return self.posterior.log_likelihood(self.process, len(self.data.y))

    @cached_property
    def solved(self):
        """The columns multiplied with the inverse covariance of noise and trend."""
        return self.process.solve_whitened(self.whitened[:, :-1])

    @cached_property
    def alpha(self):
        """What remains of the data, multiplied with the same inverse."""
        rest = self.whitened[:, -1] - self.whitened[:, :-1] @ self.posterior.mean
        return self.process.solve_whitened(rest[:, None])[:, 0]

    @cached_property
    def systematics(self):
        k = self.n_regressors
        return self.regressors.columns @ self.posterior.mean[:k]

    @cached_property
    def systematics_variance(self):
        k = self.n_regressors
        x = self.regressors.columns
        return np.einsum("ij,ij->i", x @ self.posterior.covariance[:k, :k], x)

    def products(self, columns):
        """Return C^T Q C of columns with the inverse covariance Q of everything."""
        columns = self.process.whiten(columns)
        return columns.T @ columns + self.posterior.left(self.whitened[:, :-1].T @ columns)

    @property
    def is_fast(self):
        """Whether there is periodic variability: slow waves alone are long-term."""
        return max(self.frequencies, default=0.0) > FAST

    @property
    def _first_periodic(self):
        """First flat column that is not the trend's."""
        return self.n_trend - 2 * len(self.frequencies) * self.is_fast

    def _flat_part(self, first, last):
        """Return what flat columns contribute."""
        k = self.n_regressors
        return self.flat[:, first:last] @ self.posterior.mean[k + first : k + last]

    @cached_property
    def trend(self):
        """The long-term variability, without its mean."""
        trend = self._flat_part(1, self._first_periodic)
        if self.hyper.amplitude is not None:
            trend = trend + self.process.predict(self.alpha, self.time)
        return trend - trend[self.use].mean()

    @cached_property
    def periodic(self):
        """The periodic variability, without its mean."""
        periodic = self._flat_part(self._first_periodic, self.n_trend)
        return periodic - periodic[self.use].mean()

    @cached_property
    def white_variance(self):
        return self.hyper.noise_scale * self.variance

    def corrected_covariance(self, rows):
        """Covariance of the corrected logarithm of the flux at rows of the usable cadences."""
        k = self.n_regressors
        x = self.regressors.columns[rows]
        covariance = x @ self.posterior.covariance[:k, :k] @ x.T
        covariance.flat[:: len(rows) + 1] += self.white_variance[rows]
        return covariance

    def blocks(self, starts, width):
        """Blocks of the inverse covariance of everything, for windows of cadences in use."""
        inverse = self.process.inverse_blocks(starts, width)
        x = self.solved[starts[:, None] + np.arange(width)]
        return inverse - (x @ self.posterior.covariance) @ x.transpose(0, 2, 1)

    def held_out(self, width, cadences=None):
        """Predict each window of ``width`` cadences from all others that are in use.

        The ``cadences`` in the windows, what remains at the end left out, are by default those in
        use, and at least these. Returns measured less predicted, ``(n_windows, width)``, and the
        expected covariance, ``(n_windows, width, width)``.
        """
        cadences = self.use if cadences is None else cadences
        whole = self._with_weights(cadences)
        starts = np.arange(len(whole.alpha) // width) * width
        covariance = np.linalg.inv(whole.blocks(starts, width))
        alpha = whole.alpha[: len(starts) * width].reshape(-1, width, 1)
        rest = (covariance @ alpha)[:, :, 0]
        more = (whole.white_variance - self.white_variance)[cadences][: len(starts) * width]
        np.einsum("ijj->ij", covariance)[:] -= more.reshape(-1, width)
        return rest, covariance

    @property
    def precision(self):
        """Diagonal of the inverse covariance of everything, for the cadences in use."""
        return self.process.inverse_diagonal() - self.posterior.variance(self.solved)

    @property
    def pulls(self):
        """What the model leaves at all usable cadences, in errors of noise and systematics."""
        rest = self.unexplained
        if self.hyper.amplitude is not None:
            rest = rest - self.process.predict(self.alpha, self.time)
        return rest / np.sqrt(self.white_variance + self.systematics_variance)

    def deviations(self, cadences):
        """Return what cadences differ by from predictions of all others that are in use.

        In standard deviations; the cadences are at least those in use.
        """
        whole = self._with_weights(cadences)
        expected = 1 / np.maximum(whole.precision, 1e-300)
        white = self.white_variance[cadences]
        variance = np.maximum(expected - (whole.white_variance[cadences] - white), white)
        return whole.alpha * expected / np.sqrt(variance)

    def _with_weights(self, cadences):
        """Return the same model of more cadences, of which those not in use have no weight."""
        if (cadences == self.use).all():
            return self
        variance = np.where(self.use, self.variance, _NO_WEIGHT * self.variance)
        return replace(self, variance=variance, use=cadences)

    def without_outliers(self, options):
        """Leave out outliers at fixed hyper-parameters, as long as half of the cadences remain."""
        solution = self
        for _ in range(options.max_clips):
            deviations = np.abs(solution.deviations(solution.use))
            spread = 1.4826 * np.median(deviations)  # outliers have raised the fitted noise
            kept = deviations < options.sigma * spread
            if kept.all() or kept.sum() < 0.5 * self.use.sum():
                break
            use = solution.use.copy()
            use[np.flatnonzero(use)[~kept]] = False
            solution = replace(solution, use=use)
        return solution

    def with_returned(self, allowed, options):
        """Take back allowed cadences that only seemed to be outliers beside others.

        Those that are outliers beside each other are left out again, the farther half at a time.
        """
        deviations = np.abs(self.deviations(allowed))
        limit = 1.4826 * options.sigma * np.median(deviations[self.use[allowed]])
        returned = np.zeros_like(allowed)
        returned[allowed] = deviations < limit
        returned &= ~self.use
        while returned.any():
            solution = replace(self, use=self.use | returned)
            deviations = np.abs(solution.deviations(solution.use))[returned[solution.use]]
            if deviations.max() < limit:
                return solution
            returned[returned] = deviations < max(limit, deviations.max() / 2)
        return self

    def latent_variance(self):
        """Variance of the model, systematics and trend together, at all usable cadences."""
        whole = self._with_weights(np.ones_like(self.use))
        white = whole.white_variance
        return np.clip(white - white**2 * whole.precision, 0.0, None)

    @property
    def unexplained(self):
        """What regressors and flat columns leave of the data, at all usable cadences."""
        return self.y - self.systematics - self._flat_part(0, self.flat.shape[1])

    def with_flat(self, column, use):
        """Return the same model with another transit column and other cadences."""
        n, scale = self.n_trend, np.abs(column).max(axis=0)
        flat = np.concatenate([self.flat[:, :n], column / scale], axis=1)
        scale = np.append(self.scale[:n], scale)
        return replace(self, flat=flat, scale=scale, use=use, n_short=0)

    def with_short(self, columns):
        """Return the same model with columns of short changes, as large as the data's."""
        columns = columns / np.sqrt(FLAT)
        return self.with_more(columns, self.use, n_short=columns.shape[1])

    def without_short(self, allowed):
        """Return the model, not fitted, of allowed cadences that are in no short change."""
        columns = slice(self.n_trend, self.n_trend + self.n_short)
        short = with_edges(self.time, self.flat[:, columns].any(axis=1))
        flat, scale = (np.delete(values, columns, axis=-1) for values in (self.flat, self.scale))
        changed = {"flat": flat, "scale": scale, "n_short": 0, "short": short, "hyper": None}
        return replace(self, use=allowed & ~short, **changed)

    def with_waves(self, waves, use):
        """Return the same model with periodic variability, as large as the data's."""
        columns = waves.columns(self.time) / np.sqrt(FLAT)
        frequencies = (*self.frequencies, *map(float, waves.frequencies))
        changes = {"frequencies": frequencies, "improbability": waves.improbability(use.sum())}
        return self.with_more(columns, use, n_trend=self.n_trend + columns.shape[1], **changes)

    def with_more(self, columns, use, **changes):
        """Return the same model with more columns after the trend's, and other cadences."""
        n, ones = self.n_trend, np.ones(columns.shape[1])
        flat = np.concatenate([self.flat[:, :n], columns, self.flat[:, n:]], axis=1)
        scale = np.concatenate([self.scale[:n], ones, self.scale[n:]])
        return replace(self, flat=flat, scale=scale, use=use, **changes)

    def flat_coefficient(self, index):
        """Return the coefficient of a flat column and its standard deviation."""
        index = index + self.flat.shape[1] if index < 0 else index
        k = self.n_regressors + index
        error = np.sqrt(self.posterior.covariance[k, k])
        return float(self.posterior.mean[k] / self.scale[index]), float(error / self.scale[index])

    def group_variances(self):
        """Return, per group, the variance of its part of the model in the cadences in use."""
        groups, mean = self.regressors.groups, self.posterior.mean
        x = self.regressors.columns[self.use]
        parts = [
            x[:, groups == g] @ mean[: len(groups)][groups == g]
            for g in range(groups.max(initial=-1) + 1)
        ]
        return [float(np.var(part)) for part in parts]

    def effective_parameters(self):
        """Return, per group, the number of parameters that the data determine."""
        used = 1 - self.posterior.shrinkage[: self.n_regressors]
        return np.bincount(self.regressors.groups, used)


def fit(make_regressors, time, y, variance, use, flat_columns, options, *, predicted=False):
    """Fit, and leave out outliers until there are none.

    If the star has frequencies, the fit is made again with columns for them, and the more likely
    one is returned. ``make_regressors`` takes the mask of cadences in use, ``use`` are those that
    may be; ``flat_columns``, ``(n, m)``, hold a transit or none.
    """
    regressors = make_regressors(use)
    if not regressors.columns.shape[1]:
        raise NothingToCorrectError("the pixel fractions do not vary")
    time = time - time[use][0]
    flat, scale = _flat_columns(time, flat_columns, options.n_trend)
    y = y - y[use].mean()
    data = time, y, variance, use, np.zeros_like(use)
    first = Solution(*data, regressors, flat, scale, None, options.n_trend, predicted=predicted)

    def likeliest(first):
        """Return a fit, and one with short changes if that is more likely."""
        plain = _without_outliers(first, make_regressors, options)
        if options.trend != "gp" or not options.max_clips:
            return plain
        columns = short_changes(plain)
        if not columns.shape[1]:
            return plain
        other = _without_outliers(first.with_short(columns), make_regressors, options)
        return max(plain, other, key=evidence)

    evidence = partial(_evidence, allowed=use)
    solution = likeliest(first)
    if options.trend == "gp":
        waves = find_waves(solution, use)
        if len(waves.frequencies):
            periodic = likeliest(first.with_waves(waves, use))
            likely = max(solution, periodic, key=evidence)
            if not likely.is_fast:
                rotation = find_rotation(solution, periodic.unexplained)
                rotating = likeliest(first.with_waves(rotation, use))
                likely = max(likely, rotating, key=evidence)
            solution = likely
    if solution.n_short:  # its shape is not learned from
        solution = solution.without_short(use)
        use = solution.use
        solution = _without_outliers(solution, make_regressors, options)
    if options.trend == "gp" and np.log(solution.hyper.noise_scale) > NOISE_ERROR:
        walk = solution.hyper.noise_scale * np.median(variance)
        walking = replace(solution, use=use, hyper=replace(solution.hyper, walk=walk))
        walking = _without_outliers(walking, make_regressors, options)
        solution = max(solution, walking, key=lambda s: _evidence(s, use))
    return solution.with_returned(use, options)


def _without_outliers(solution, make_regressors, options):
    """Fit the hyper-parameters and leave out outliers by turns."""
    for k in range(_REFITS + 1):
        data, hyper = solution.data, solution.hyper
        if hyper is not None and len(hyper.variances) != data.n_groups:
            hyper = None
        hyper = fit_hyperparameters(data, hyper, trend=options.trend == "gp")
        solution = replace(solution, hyper=hyper)
        use = solution.without_outliers(options).use if k < _REFITS else solution.use
        if (use == solution.use).all():
            break
        y = solution.y - solution.y[use].mean()
        solution = replace(solution, use=use, y=y, regressors=make_regressors(use))
    return solution


def _evidence(solution, allowed):
    """Log-likelihood with the outliers, which may be anywhere in the range of the data.

    What noise is beyond FLUX_ERR is a misfit, which a likelihood of white noise takes for too
    little.
    """
    n_outliers = allowed.sum() - solution.use.sum()
    value = solution.log_likelihood - solution.improbability
    value -= n_outliers * np.log(np.ptp(solution.y[allowed]))
    if solution.predicted:
        value -= 0.5 * (np.log(solution.hyper.noise_scale) / NOISE_ERROR) ** 2
    return value


def _flat_columns(time, extra, n_trend):
    x = time / max(time[-1], 1e-9)
    columns = np.stack([x**k for k in range(n_trend)], axis=1)
    columns = np.concatenate([columns, extra], axis=1)
    scale = np.abs(columns).max(axis=0)
    return columns / scale, scale
