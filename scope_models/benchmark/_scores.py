"""Scores of a light curve with known truth: pure functions of arrays."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from scope_models.scene.motion import K2Roll

__all__ = ["SkyScore", "binned", "outliers", "score_light_curve", "score_places", "slope"]

_BIN = 13 * K2Roll.cadence  # days, 6.5 h
_WINDOW = 3.0  # days
_MOST_CLIPPED = 0.02
_FEWEST = 100
_PHASES = 8  # bins of a pixel along an axis
_NEAR = 0.15  # px from the border of two pixels
_SIDE = 8  # cadences on either side of a border, at least


@dataclass(frozen=True)
class SkyScore:
    """Score of a light curve, but for a constant factor, against the star's true flux.

    Attributes
    ----------
    full : float
        Standard deviation of 6.5-h bins of corrected over true flux, in units of the floor.
    high_passed : float
        The same after a running mean of 3 d has been subtracted.
    amplitude : float
        Part of the star's variability that is kept: slope of the corrected flux on the true one,
        outside of transits; NaN for constant stars.
    depth : float
        Part of the transits' depth that is kept, below a line around each; NaN without transits.
    pull : float
        Root mean square of the cadences' deviations from the truth over the quoted errors.
    kept, floor : float
        Part of the cadences that have a corrected flux; and expected photon, background and read
        noise of a 6.5-h bin, ppm.

    Examples
    --------
    >>> from scope_models.benchmark import make_sky, score
    >>> sky = make_sky("k2-1x-delta-scuti", seed=2, n_cadences=300)
    >>> lc = sky.to_tpf().to_lightcurve(aperture_mask="pipeline")
    >>> bool(0.9 < score(lc, sky).amplitude < 1.1)
    True
    """

    full: float
    high_passed: float
    amplitude: float
    depth: float
    pull: float
    kept: float
    floor: float


def score_light_curve(time, flux, error, truth, transit, noise):
    """Return the `SkyScore` of a light curve; all but `time`, in days, is relative."""
    good = np.isfinite(flux) & np.isfinite(error)
    kept = float(good.mean())
    floor = noise / np.sqrt(_per_bin(time))
    time, flux, error, truth, transit = (a[good] for a in (time, flux, error, truth, transit))
    if good.sum() < _FEWEST or not np.median(flux) > 0:
        return SkyScore(np.inf, np.inf, *[float("nan")] * 3, kept, 1e6 * floor)
    ratio = flux / truth
    level = np.median(ratio)
    deviation = ratio / level - 1
    fine = ~outliers(deviation)
    pull = np.sqrt(np.mean((deviation * truth * level / error)[fine] ** 2))
    smooth = deviation[fine] - _running_mean(time[fine], deviation[fine])
    outside = fine & (transit == 1)
    varies = outside.any() and truth[outside].std() >= 1e-5
    return SkyScore(
        full=_scatter(time[fine], deviation[fine]) / floor,
        high_passed=_scatter(time[fine], smooth) / floor,
        amplitude=slope(flux[outside], truth[outside]) if varies else float("nan"),
        depth=_depth(time[fine], flux[fine], truth[fine], transit[fine]),
        pull=float(pull), kept=kept, floor=1e6 * floor,
    )  # fmt: skip


def score_places(time, flux, truth, x, y):
    """Return how much a light curve depends on the star's place within the pixel, in ppm.

    "bias" is the standard deviation of the part of the flux that is a sum of functions of the
    fractions of x and y; "step" the root mean square of the steps where the star crosses from pixel
    to pixel, NaN if it crosses none. The expected noise is taken off both.
    """
    good = np.isfinite(flux * truth * x * y)
    time, flux, truth, x, y = (a[good] for a in (time, flux, truth, x, y))
    if good.sum() < _FEWEST or not np.median(flux) > 0:
        return float("nan"), float("nan")
    deviation = flux / truth / np.median(flux / truth) - 1
    deviation = deviation - _running_mean(time, deviation)
    fine = ~outliers(deviation)
    deviation, places = deviation[fine], (x[fine], y[fine])
    bins = [((a + 0.5) % 1 * _PHASES).astype(int) for a in places]
    columns = np.concatenate([np.eye(_PHASES)[number] for number in bins], axis=1)
    found, _, rank, _ = np.linalg.lstsq(columns, deviation, rcond=None)
    fitted = columns @ found
    noise = np.sum((deviation - fitted) ** 2) / (len(deviation) - rank)
    bias = np.sqrt(max(fitted.var() - noise * (rank - 1) / len(deviation), 0.0))
    steps = [step for place in places for step in _steps(deviation, place)]
    if not steps:
        return 1e6 * float(bias), float("nan")
    sizes, errors, cadences = np.transpose(steps)
    mean = np.average(sizes**2 - errors**2, weights=cadences)
    return 1e6 * float(bias), 1e6 * float(np.sqrt(max(mean, 0.0)))


def _steps(values, place):
    """Yield the step at each border of pixels, beside a parabola, its error and the cadences."""
    border = np.floor(place)
    distance = place - border - 0.5
    near = np.abs(distance) < _NEAR
    for one in np.unique(border[near]):
        mine = near & (border == one)
        beyond = distance[mine] > 0
        if min(beyond.sum(), (~beyond).sum()) < _SIDE:
            continue
        columns = np.stack([beyond, *distance[mine] ** np.arange(3)[:, None]], axis=1)
        inverse = np.linalg.pinv(columns.T @ columns)
        found = inverse @ columns.T @ values[mine]
        rest = values[mine] - columns @ found
        yield found[0], np.sqrt(inverse[0, 0] * (rest @ rest) / (len(rest) - 4)), len(rest)


def outliers(values):
    """Return cadences far from their neighbors' median, 2 % at most: cosmic rays and the like."""
    size = np.abs(values - median_filter(values, 7, mode="nearest"))
    limit = max(6 * 1.4826 * np.median(size), np.quantile(size, 1 - _MOST_CLIPPED))
    return size > limit


def _scatter(time, values):
    """Return the standard deviation of the means of 13 cadences, infinite without any."""
    _, means, count = binned(time, values)
    if not len(count):
        return np.inf
    # Bins with fewer cadences are noisier: the floor is that of full ones.
    return float(np.sqrt(np.average((means - means.mean()) ** 2, weights=count)))


def _per_bin(time):
    return max(round(_BIN / np.diff(time).min()), 1) if len(time) > 1 else 1


def binned(time, values):
    """Return times, means ``(..., m)`` and numbers of cadences of 6.5-h bins, half full or more."""
    size = _per_bin(time)
    number = ((time - time[0]) / np.diff(time).min() + 0.5).astype(int) // size
    count = np.bincount(number)
    full = count > size / 2
    sums = [np.bincount(number, one) for one in (time, *np.atleast_2d(values))]
    time, *means = np.array(sums)[:, full] / count[full]
    return time, np.reshape(means, (*np.shape(values)[:-1], -1)), count[full]


def _running_mean(time, values):
    """Return the mean of all values within 1.5 d."""
    first = np.searchsorted(time, time - _WINDOW / 2)
    last = np.searchsorted(time, time + _WINDOW / 2)
    total = np.concatenate([[0], np.cumsum(values)])
    return (total[last] - total[first]) / (last - first)


def slope(flux, truth):
    """Return the relative change of the flux over that of the truth."""
    change, level = np.polyfit(truth, flux, 1)
    return float(change / (change * truth.mean() + level) * truth.mean())


def _depth(time, flux, truth, transit):
    """Return the depth in units of the true one, with a line around each transit."""
    inside = transit < 1
    if not inside.any():
        return float("nan")
    flux = flux / (truth / transit)
    flux = flux / np.median(flux)
    starts = np.flatnonzero(np.diff(inside.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(inside.astype(int), append=0) == -1)
    upper = lower = 0.0
    for start, end in zip(starts, ends, strict=True):
        half = time[end] - time[start]
        near = (time > time[start] - half) & (time < time[end] + half)
        line = np.vander(time[near] - time[start], 2)
        if near.sum() < 6:
            continue
        both = np.column_stack([flux[near], transit[near] - 1])
        rest = both - line @ np.linalg.lstsq(line, both, rcond=None)[0]
        upper += rest[:, 0] @ rest[:, 1]
        lower += rest[:, 1] @ rest[:, 1]
    return float(upper / lower) if lower > 0 else float("nan")
