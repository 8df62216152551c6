"""Robust smooth courses in time."""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

__all__ = ["CLIP", "NO_WEIGHT", "TRANSIT", "Smoother", "quantile"]

#: Tolerance: weight of cadences that do not count.
NO_WEIGHT = 1e-6
#: Tolerance: widths in cadences of the kernels that are tried to smooth the focus and the
#: background.
_WIDTHS = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
#: Tolerance: kernels of this width and wider ones are convolved by Fourier transforms.
_WIDE = 12.0
#: Branch: outliers exceed so many standard deviations, as noise does in one of 300,000 pixels.
CLIP = 4.5
#: Prior: duration in days of a transit of a habitable planet, of which CDPP is the noise
#: (Christiansen et al. 2012).
TRANSIT = 6.5 / 24


class Smoother:
    """Robust local lines in time, with Gaussian kernels whose widths are in cadences."""

    def __init__(self, time, use):
        self.time, self.use = time, use
        self.step = quantile(np.diff(time))
        steps = np.diff(np.rint((time - time[0]) / self.step))
        # beyond the widest kernel, a longer gap is the same
        steps = np.minimum(steps, 8 * _WIDTHS[-1])
        self._index = np.concatenate([[0], np.cumsum(steps)]).astype(int)
        self._kernels, self._best = {}, {}

    def __call__(self, values, error, name=""):
        """Smooth with the width of the least median leave-one-out error; return course and error.

        The course is drawn to its mean by Wiener's factor, its variance over the sum of this and of
        the variance of its noise: noise has no course. Cadences that are not in use take the values
        of those around them. Widths are tried from the next narrower one on than was best for the
        series of a name the last time. Values that are far from any course beside their errors, as
        seeing is, are their own course: noise that is small beside them leaks nowhere.
        """
        use = self.use
        typical, own = quantile(error[use]), (values, error)
        start = np.where(use, (typical / np.maximum(error, 0.3 * typical)) ** 2, NO_WEIGHT)
        values = np.where(use, values, np.interp(self.time, self.time[use], values[use]))
        least, weight = np.inf, start
        for k in range(max(self._best.get(name, 0) - 1, 0), len(_WIDTHS)):
            smooth, size, weight, part = self.lines(values, start, _WIDTHS[k], weight)
            if size < least:
                least, best, self._best[name] = size, (smooth, part), k
        smooth, part = best
        if 1.4826 * quantile(np.abs(values - smooth)[use]) > CLIP * typical:
            return own
        unit = (1.4826 * least) ** 2
        noise = unit * part
        # where all cadences around are outliers there is no course
        left = np.minimum(noise, unit)[use].mean()
        mean, signal = smooth[use].mean(), max(smooth[use].var() - left, 0.0)
        course = mean + signal / np.maximum(signal + noise, 1e-300) * (smooth - mean)
        return course, np.sqrt(noise)

    def without_dips(self, values, start, width):
        """Return values, and robust local lines of a width in place of outliers."""
        smooth, size = self.lines(values, start, width)[:2]
        return np.where(np.abs(values - smooth) > CLIP * 1.4826 * size, smooth, values)

    def lines(self, values, start, width, weight=None):
        """Return robust local linear fits, the median of leave-one-out errors, weights, and noise.

        The weights are those of the start, but for outliers; the search may begin with others. The
        noise is the variance of the fits over that of values of weight one.
        """
        weight = start if weight is None else weight
        for _ in range(3):
            s0, s1, s2, m0, m1 = self._moments(weight, weight * values, width)
            determinant = s0 * s2 - s1**2
            determinant = np.where(determinant > 1e-12 * s0 * s2, determinant, np.inf)
            smooth = (s2 * m0 - s1 * m1) / determinant
            rest = np.abs(values - smooth) / np.maximum(1 - weight * s2 / determinant, 1e-3)
            size = quantile(rest[self.use])
            before, weight = weight, np.where(rest > CLIP * 1.4826 * size, NO_WEIGHT, 1.0) * start
            if (weight == before).all():
                break
        # squares of a Gaussian's weights add up to the largest one over the root of two
        return smooth, size, weight, s2 / determinant / np.sqrt(2)

    def _moments(self, weight, data, width):
        """Return moments of the weights about each cadence, to order 2, and of the data, to 1."""
        grid = np.zeros((2, self._index[-1] + 1))
        grid[:, self._index] = weight, data
        half = int(3.5 * width) + 1
        size = next_fast_len(self._index[-1] + 1 + half, real=True)
        if width not in self._kernels:
            d = np.arange(-half, half + 1.0)
            kernels = np.exp(-0.5 * (d / width) ** 2) * np.array([d**0, -d, d * d])
            self._kernels[width] = rfft(kernels, size) if width >= _WIDE else kernels
        kernels = self._kernels[width]
        if width < _WIDE:
            pairs = [(grid[0], k) for k in kernels] + [(grid[1], k) for k in kernels[:2]]
            moments = np.array([np.convolve(values, k)[half:-half] for values, k in pairs])
        else:
            whole = rfft(grid, size)
            moments = irfft(whole[[0, 0, 0, 1, 1]] * kernels[[0, 1, 2, 0, 1]], size)[:, half:]
        return moments[:, self._index]


def quantile(values, part=0.5):
    """Return a quantile along the last axis of finite values, faster than NumPy's."""
    place = part * (values.shape[-1] - 1)
    k = int(place)
    ordered = np.partition(np.ascontiguousarray(values), k)
    low = ordered[..., k]
    return low if place == k else low + (place - k) * (ordered[..., k + 1 :].min(axis=-1) - low)
