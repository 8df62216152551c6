"""Searches a light curve for transits, and measures those that it finds."""

from dataclasses import dataclass

import numpy as np
from astropy.stats import mad_std
from astropy.timeseries import BoxLeastSquares
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from scope_models.models import TransitModel

# Days of the running median: several times the longest transit, less than K2's slow drifts.
_FLAT_DAYS = 2.0


@dataclass(frozen=True)
class Found:
    """The strongest periodic box in a light curve: times in days, `t0` the middle of the first box.

    `snr` is the depth over its error.
    """

    period: float
    t0: float
    duration: float
    snr: float

    def in_transit(self, time, widths=0.5):
        """Return which times are within so many durations of the middle of a box."""
        phase = (time - self.t0 + 0.5 * self.period) % self.period - 0.5 * self.period
        return np.abs(phase) < widths * self.duration

    def matches(self, period, t0, duration, span):
        """Return whether all boxes in a time span are within half a transit of true ones."""
        first = (self.t0 - t0 + 0.5 * period) % period - 0.5 * period
        last = first + (self.period - period) * (span // period)
        return bool(max(abs(first), abs(last)) < 0.5 * max(duration, self.duration))


def flattened(time, flux, masked=None):
    """Return a light curve over its running median, which does not see masked cadences."""
    seen = np.isfinite(flux) if masked is None else np.isfinite(flux) & ~masked
    width = int(_FLAT_DAYS / np.median(np.diff(time))) | 1
    # straight lines across the mask keep the window in the middle
    filled = np.interp(time, time[seen], flux[seen])
    return flux / median_filter(filled, size=min(width, len(filled)), mode="reflect")


def isolated(flux, sigma=6.0):
    """Return which cadences stand out from both neighbors by `sigma`, as no transit does."""
    noise = mad_std(flux)
    return np.abs(flux - median_filter(flux, size=3, mode="mirror")) > sigma * noise


def search_light_curve(lc, shortest, longest):
    """Return finite times and fluxes, and what `search` finds without isolated cadences."""
    good = np.isfinite(lc.flux.value)
    time, flux = lc.time.value[good], lc.flux.value[good]
    flat = flattened(time, flux)
    keep = ~isolated(flat)
    return time, flux, search(time[keep], flat[keep], shortest, longest)


def search(time, flux, shortest, longest):
    """Return the periodic box of the highest signal-to-noise ratio (box least squares).

    Transits last `shortest` to `longest` days, periods are from 1 d to half the time span. See
    Kovacs, G., Zucker, S. & Mazeh, T. 2002, A&A, 391, 369.
    """
    noise = mad_std(flux)
    model = BoxLeastSquares(time, flux, dy=noise)
    durations = np.geomspace(0.7 * shortest, 1.2 * longest, 6)
    periods = model.autoperiod(
        durations, minimum_period=1.0, maximum_period=0.5 * np.ptp(time),
        minimum_n_transit=2, frequency_factor=2.0,
    )  # fmt: skip
    result = model.power(periods, durations, objective="snr", oversample=5)
    best = int(np.argmax(result.power))
    names = ("period", "transit_time", "duration", "depth_snr")
    return Found(*(float(result[name][best]) for name in names))


def fit_shape(time, flux, error, found, exposure_time):
    """Return a transit fitted to what a search has found, its duration and the error of that.

    The transit is central, with the default limb darkening; `error` is the standard deviation of
    the relative fluxes, the duration that from first to fourth contact in days.
    """
    near = found.in_transit(time, widths=1.5)
    time, flux = time[near], flux[near]
    depth = max(1 - np.mean(flux[found.in_transit(time, widths=0.4)]), 1e-6)
    # Period and mid-transit of the first and the last transit, rather than of the first and the
    # period, so that the parameters hardly depend on each other.
    n_periods = max(round((time[-1] - found.t0) / found.period), 1)
    scale = np.array([depth, found.duration, 0.1 * found.duration, 0.1 * found.duration])

    def make(values):
        depth, duration, first, last = scale * values
        period = found.period + (last - first) / n_periods
        return TransitModel.from_depth_duration(
            depth, duration, period, found.t0 + first, exposure_time=exposure_time
        )

    start = np.array([1.0, 1.0, 0.0, 0.0])
    bounds = [0.05, 0.3, -8, -8], [min(20, 0.5 / depth), 3, 8, 8]
    fit = least_squares(lambda values: (make(values)(time) - flux) / error, start, bounds=bounds)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    return make(fit.x), scale[1] * fit.x[1], float(scale[1] * np.sqrt(covariance[1, 1]))
