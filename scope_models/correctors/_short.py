"""Short changes of a star that belong to no process: transits, eclipses, flares, bumps."""

from dataclasses import replace

import numpy as np
from astropy.stats import mad_std
from scipy import ndimage
from scipy.stats import t as student_t

from scope_models.correctors._regression import SLOWEST, Posterior

__all__ = ["short_changes", "with_edges"]

#: Prior: changes last 1.5 to 12 h, as most transits: means of so many days, in runs of so many.
_MEAN, _RUNS = 0.0625, (1, 2, 3, 4, 6, 8)
#: Tolerance: number of runs of a light curve that deviate as much by chance.
_CHANCE = 0.1
#: Tolerance: largest number of searches, each for those that deviate by this part of the largest
#: deviation: a deep transit bends the process around it.
_ROUNDS, _PART = 20, 0.5


def short_changes(solution):
    """Return columns ``(n_cadences, n_changes)`` that are 1 in runs whose mean deviates.

    What all other cadences predict has regressors and a slow process, which follows no transit. The
    unit is the typical deviation of runs of the same length, of which there are few long ones: by
    chance, deviations follow Student's t.
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
    """Return cadences of short changes with those around them, where the changes may begin."""
    return ndimage.binary_dilation(short, iterations=_width(time))


def _width(time):
    """Return the number of cadences of a mean."""
    return max(round(_MEAN / float(np.median(np.diff(time)))), 1)


def _runs(data, mean, hyper):
    """Return the first means of runs that deviate, and those after the last, ``(n_runs, 2)``."""
    n, rest = len(data.y), data.y - data.columns @ mean
    amplitude = min(hyper.amplitude, max(mad_std(rest) ** 2, np.median(data.variance)))
    hyper = replace(hyper, amplitude=amplitude, period=SLOWEST, walk=0.0)
    process = hyper.process(data.time, data.variance)
    inverse = [process.inverse_blocks(np.arange(n - k + 1), k).sum(axis=(1, 2)) for k in _RUNS]
    free, runs = np.ones(n, dtype=bool), np.empty((0, 2), dtype=int)
    limits = [student_t.isf(_CHANCE / 2 / sum(map(len, inverse)), n / k) for k in _RUNS]
    for _ in range(_ROUNDS):
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
        least = _PART * max(deviating, default=(0.0,))[0]
        for size, *run in sorted(deviating, reverse=True):
            if size > least and free[slice(*run)].all():
                free[slice(*run)] = False
                new.append(run)
        if not new:
            break
        runs = np.concatenate([runs, new])
    return runs
