"""The fit of a light curve: hyper-parameters, outliers, and what follows from them."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from scope_models.pixelmodel._smooth import NO_WEIGHT
from scope_models.regression._periodic import (
    FAST,
    find_rotation,
    find_waves,
    short_changes,
    with_edges,
)
from scope_models.regression._variances import (
    FLAT,
    Data,
    Hyperparameters,
    Posterior,
    fit_hyperparameters,
)

__all__ = ["DEFAULT", "NothingToCorrectError", "Solution", "fit"]

#: Tolerance: largest number of fits of the hyper-parameters after outliers were found.
_REFITS = 2
#: Prior: standard deviation of the logarithm of the noise's variance in units of FLUX_ERR's, which
#: that of real dark pixels exceeds by up to 1.17 twice: more is nothing that white noise explains,
#: and less than the photons' there is not.
_NOISE_ERROR = 0.16

#: Prior: standard deviations of coefficients that are expected of predicted fractions: 1 % between
#: the responses of pixels (Kepler Instrument Handbook), a few percent within them, some 1e-4 of the
#: light at the aperture's edge; what each pixel shows beyond them counts in a weighted sum, or not.
_EXPECTED = {
    "order 1": 0.012,
    "order 2": 0.02,
    "segments": 1e-4,
    "focus": 0.005,
    "aperture": 1.0,
    "misfit": 1.0,
}
#: Prior: ... of measured ones.
_MEASURED = {"level": 1.0}
#: Prior: those of the focus have a limit. The fractions hold what it does to pixels of different
#: response; within pixels a width that changes by 1 % changes the response by 5e-4 at most. What
#: seems to be a focus may be a dimming of the star beside constant light. So may a level of the
#: background or the misfit of a pixel, which count once.
_MOST = {"focus": 0.05, "level": 1.0, "misfit": 1.0}


class NothingToCorrectError(ValueError):
    """No regressor varies."""


class Options(NamedTuple):
    """Those of `fit`: kind of trend and its number of columns, outliers."""

    trend: str = "gp"
    n_trend: int = 1
    sigma: float = 5.0
    max_clips: int = 5


DEFAULT = Options()


@dataclass(frozen=True)
class Solution:
    """A fitted model of the logarithm of the flux."""

    time: np.ndarray  # (n,), days from the first cadence in use, of all usable ones
    y: np.ndarray  # logarithm of the relative flux
    variance: np.ndarray
    use: np.ndarray  # cadences in the fit
    doubt: np.ndarray  # variance of short changes, which adds to the noise in the fit
    regressors: object  # for all usable cadences
    flat: np.ndarray  # columns with flat priors (n, m): variability, short changes, transit
    hyper: Hyperparameters
    n_trend: int = 1  # flat columns that are constant and variability
    frequencies: tuple = ()  # of the last columns of the variability, a cosine and a sine each, 1/d
    n_short: int = 0  # the next flat columns are short changes
    improbability: float = 0.0  # minus the logarithm of the prior of their parameters
    predicted: bool = False  # whether the fractions are
    scale: float = 1.0  # what the transit was divided by

    @cached_property
    def data(self):
        use, names = self.use, self.regressors.names
        known = _EXPECTED if self.predicted else _MEASURED
        # measured fractions explain noise, a random walk resembles it
        below = _NOISE_ERROR if self.predicted else np.inf
        walks = self.hyper and self.hyper.walk
        return Data(
            self.time[use],
            self.y[use],
            self.variance[use],
            np.concatenate([self.regressors.columns[use], self.flat[use]], axis=1),
            self.regressors.groups,
            self.flat.shape[1],
            expected=np.square([known.get(name, np.nan) for name in names]),
            most=np.square([_MOST.get(name, 1e9) for name in names]),
            noise_errors=(below, below if walks else np.inf),
            doubt=self.doubt[use],
        )

    @cached_property
    def process(self):
        return self.hyper.process(self.data)

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
        """Columns multiplied with the inverse covariance of noise and trend."""
        return self.process.solve_whitened(self.whitened[:, :-1])

    @cached_property
    def alpha(self):
        """What remains of the data, multiplied with the same inverse."""
        rest = self.whitened[:, -1] - self.whitened[:, :-1] @ self.posterior.mean
        return self.process.solve_whitened(rest[:, None])[:, 0]

    @cached_property
    def systematics(self):
        return self.regressors.columns @ self.posterior.mean[: self.n_regressors]

    def systematics_covariance(self, rows):
        """Return the covariance of systematics at rows of the usable cadences."""
        x, k = self.regressors.columns[rows], self.n_regressors
        return x @ self.posterior.covariance[:k, :k] @ x.T

    @cached_property
    def systematics_variance(self):
        x, k = self.regressors.columns, self.n_regressors
        return np.einsum("ij,ij->i", x @ self.posterior.covariance[:k, :k], x)

    def products(self, columns):
        """Return C^T Q C of columns C with the inverse covariance Q of everything."""
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
        trend = self._flat_part(1, self._first_periodic) + self._slow
        return trend - trend[self.use].mean()

    @cached_property
    def _slow(self):
        """The long-term process."""
        return self.process.predict(self.alpha, self.time)

    @cached_property
    def periodic(self):
        """The periodic variability, without its mean."""
        periodic = self._flat_part(self._first_periodic, self.n_trend)
        return periodic - periodic[self.use].mean()

    @cached_property
    def white_variance(self):
        return self.hyper.noise_scale * self.variance

    @property
    def fit_variance(self):
        """That of the fit, which is not sure of short changes."""
        return self.white_variance + self.doubt

    @property
    def short(self):
        """Cadences of short changes, which hardly count in the fit."""
        return self.doubt > 0

    @property
    def counted(self):
        """All others in the fit."""
        return self.use & ~self.short

    @property
    def centered(self):
        """The same with a mean of zero."""
        return replace(self, y=self.y - self.y[self.counted].mean())

    def held_out(self, width, cadences):
        """Predict each window of some cadences, at least all in use, from all others in use.

        Return measured less predicted, ``(n_windows, width)``, and the expected covariance.
        """
        whole = self._with_weights(cadences)
        starts = np.arange(len(whole.alpha) // width) * width
        windows = starts[:, None] + np.arange(width)
        x, inverse = whole.solved[windows], whole.process.inverse_blocks(starts, width)
        inverse -= (x @ whole.posterior.covariance) @ x.transpose(0, 2, 1)
        covariance = np.linalg.inv(inverse)
        rest = (covariance @ whole.alpha[windows, None])[:, :, 0]
        more = (whole.fit_variance - self.white_variance)[cadences]
        np.einsum("ijj->ij", covariance)[:] -= more[windows]
        return rest, covariance

    @property
    def precision(self):
        """Diagonal of the inverse covariance of everything, for the cadences in use."""
        return self.process.inverse_diagonal() - self.posterior.variance(self.solved)

    @property
    def pulls(self):
        """What the model leaves at all usable cadences, in errors of noise and systematics."""
        rest = self.unexplained - self._slow
        return rest / np.sqrt(self.white_variance + self.systematics_variance)

    def deviations(self, cadences):
        """Return deviations of cadences, at least all in use, from predictions of others in use.

        They are in standard deviations.
        """
        whole = self._with_weights(cadences)
        expected = 1 / np.maximum(whole.precision, 1e-300)
        white = self.white_variance[cadences]
        variance = np.maximum(expected - (whole.fit_variance[cadences] - white), white)
        return whole.alpha * expected / np.sqrt(variance)

    def _with_weights(self, cadences):
        """Return the same model of more cadences, of which those not in use have no weight."""
        if (cadences == self.use).all():
            return self
        variance = np.where(self.use, self.variance, self.variance / NO_WEIGHT)
        return replace(self, variance=variance, use=cadences)

    def without_outliers(self, options):
        """Leave out outliers at fixed hyper-parameters, as long as half of the cadences remain."""
        solution = self
        for _ in range(options.max_clips):
            deviations = np.abs(solution.deviations(solution.use))
            spread = 1.4826 * np.median(deviations)  # outliers have raised the fitted noise
            kept = (deviations < options.sigma * spread) | solution.short[solution.use]
            if kept.all() or kept.sum() < 0.5 * self.use.sum():
                break
            use = solution.use.copy()
            use[np.flatnonzero(use)[~kept]] = False
            solution = replace(solution, use=use)
        return solution

    def with_returned(self, allowed, options):
        """Take back allowed cadences that seemed to be outliers beside others, nearest first."""
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

    def variance_left(self, *, trend):
        """Variance of the data without systematics, and without the ``trend`` if that is true.

        The model follows some of the noise.
        """
        if trend:
            whole = self._with_weights(np.ones_like(self.use))
            followed = np.clip(1 - whole.fit_variance * whole.precision, 0.0, None)
            variance = whole.fit_variance * followed
        else:
            variance, followed = self.systematics_variance, np.zeros(len(self.use))
            columns, k = self.regressors.columns[self.use], self.n_regressors
            covariance = self.posterior.covariance[:k]
            followed[self.use] = np.einsum("ij,ij->i", columns @ covariance, self.solved)
        return variance + self.white_variance * (1 - 2 * followed)

    @property
    def unexplained(self):
        """What is no systematics, trend or transit, at all usable cadences."""
        last, begin = self.flat.shape[1], self.n_trend
        explained = self._flat_part(0, begin) + self._flat_part(begin + self.n_short, last)
        return self.y - self.systematics - explained

    def with_flat(self, column, use):
        """Return the same model with another transit column and other cadences."""
        scale = np.abs(column).max()
        flat = np.concatenate([self.flat[:, : self.n_trend], column / scale], axis=1)
        doubt = np.where(column.any(axis=1), 0.0, self.doubt)
        return replace(self, flat=flat, scale=scale, use=use, doubt=doubt, n_short=0)

    def with_short(self, columns):
        """Return the same model with columns of short changes."""
        return self._with_more(columns, n_short=columns.shape[1])

    def with_doubt(self):
        """Return the model, not fitted, with short changes of unknown course in place of columns.

        The mean of each has its size as standard deviation: its cadences count where systematics
        would be more uncertain than that.
        """
        first, last = self.n_trend, self.n_trend + self.n_short
        size = with_edges(self.time, np.abs(self._flat_part(first, last)))
        labels, _ = ndimage.label(size)
        doubt = np.bincount(labels)[labels] * size**2
        flat = np.delete(self.flat, slice(first, last), axis=1)
        return replace(self, flat=flat, n_short=0, doubt=doubt).centered

    def with_waves(self, waves, use):
        """Return the same model with periodic variability and other cadences."""
        columns = waves.columns(self.time)
        return self._with_more(
            columns,
            use=use,
            n_trend=self.n_trend + columns.shape[1],
            frequencies=(*self.frequencies, *map(float, waves.frequencies)),
            improbability=waves.improbability(use.sum()),
        )

    def _with_more(self, columns, **changes):
        """Return the same model with more columns after the trend's, as large as the data's."""
        columns, n = columns / np.sqrt(FLAT), self.n_trend
        flat = np.concatenate([self.flat[:, :n], columns, self.flat[:, n:]], axis=1)
        return replace(self, flat=flat, **changes)

    def transit_coefficient(self):
        """Return the coefficient of the last column, a transit's, and its standard deviation."""
        error = np.sqrt(self.posterior.covariance[-1, -1])
        return float(self.posterior.mean[-1] / self.scale), float(error / self.scale)

    def group_variances(self):
        """Return, per group, the variance of its part of the model in the cadences in use."""
        parts = self.regressors.columns[self.use] * self.posterior.mean[: self.n_regressors]
        member = self.regressors.groups[:, None] == np.arange(self.data.n_groups)
        return np.var(parts @ member, axis=0)

    def effective_parameters(self):
        """Return, per group, the number of parameters that the data determine."""
        used = 1 - self.posterior.shrinkage[: self.n_regressors]
        return np.bincount(self.regressors.groups, used)


def fit(make_regressors, time, y, variance, use, transit, options, *, predicted=False):
    """Return the likeliest fit without outliers.

    ``make_regressors`` takes the mask of cadences in use; ``use`` are those that may be,
    ``transit`` has one column or none.
    """
    regressors = make_regressors(use)
    if not regressors.columns.shape[1]:
        raise NothingToCorrectError("the pixel fractions do not vary")
    time = time - time[use][0]
    trend = np.vander(time / max(time[-1], 1e-9), options.n_trend, increasing=True)
    flat = np.concatenate([trend, transit], axis=1)
    scale = np.abs(flat).max(axis=0)
    first = Solution(
        time, y, variance, use, np.zeros(len(y)), regressors, flat / scale, None,
        options.n_trend, predicted=predicted, scale=scale[-1],
    ).centered  # fmt: skip
    fitted = partial(_without_outliers, make_regressors=make_regressors, options=options)
    if options.trend == "gp":
        solution = _with_variability(first, fitted, use, short=options.max_clips > 0)
    else:
        solution = fitted(first)
    return solution.with_returned(use & ~solution.short, options)


def _with_variability(first, fitted, use, *, short):
    """Return the likeliest fit of a Gaussian process, with periodic variability or without.

    Where ``short`` changes are sought, they are so again as long as the fit becomes likelier.
    """
    evidence = partial(_evidence, allowed=use)

    def likeliest(first):
        """Return a fit, with short changes if that is likelier."""
        plain = best = fitted(first)
        while short:
            # among what seem to be outliers, too, but those that are alone
            several = ndimage.binary_opening(use & ~best.use, np.ones(2))
            columns = short_changes(replace(plain, hyper=best.hyper, use=best.use | several))
            trial = fitted(first.with_short(columns)) if columns.shape[1] else plain
            if evidence(trial) <= evidence(best):
                break
            best = trial
        return best

    solution = likeliest(first)
    waves = find_waves(solution, use)
    if len(waves.frequencies):
        waving = first.with_waves(waves, use)
        periodic = likeliest(waving)
        likely = max(solution, periodic, key=evidence)
        if not likely.is_fast:
            rotation = find_rotation(solution, periodic.unexplained)
            rotating = first.with_waves(rotation, use)
            likely = max(likely, likeliest(rotating), key=evidence)
        solution = likely
    if solution.n_short:
        solution = fitted(solution.with_doubt())
    scale = solution.hyper.noise_scale
    if np.log(scale) > _NOISE_ERROR:
        hyper = replace(solution.hyper, walk=scale * np.median(solution.variance))
        walking = fitted(replace(solution, use=use, hyper=hyper))
        solution = max(solution, walking, key=evidence)
    return solution


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
        solution = replace(solution, use=use, regressors=make_regressors(use)).centered
    return solution


def _evidence(solution, allowed):
    """Log-likelihood and hyperprior, with outliers anywhere in the range of the data.

    Noise beyond FLUX_ERR is a misfit, which a likelihood of white noise takes for too little.
    """
    data, n_outliers = solution.data, allowed.sum() - solution.use.sum()
    if solution.predicted:
        data = replace(data, noise_errors=(_NOISE_ERROR, _NOISE_ERROR))
    unlikely = solution.improbability + solution.hyper.improbability(data)
    return solution.log_likelihood - unlikely - n_outliers * np.log(np.ptp(solution.y[allowed]))
