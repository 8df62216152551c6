"""Smooth functions of a star's position and of time, and what motion and width change."""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.distance import cdist

__all__ = [
    "BLOCK", "CLIP", "COORDINATES", "DARK_PART", "ENOUGH", "FEWEST_DARK", "MOST", "NO_WEIGHT",
    "REWEIGHTS", "ROUNDS", "TRANSIT", "Features", "Flow", "Smoother", "dark_plane", "nearness",
    "pivoted_cholesky", "polynomials", "precise_aperture", "quantile",
]  # fmt: skip

#: Prior: degree of the polynomials of position by which light changes.
_DEGREE = 3
#: Tolerance: images that a mean is taken of.
ENOUGH = 500
#: Tolerance: quantile of the largest values but accidents.
MOST = 0.98
#: Tolerance: largest number of rounds of a search that converges.
ROUNDS = 20
#: Tolerance: changes of weights of robust fits.
REWEIGHTS = 10
#: Prior: part of the variance of lost light that is expected to remain: a tenth of the amplitude.
_LOST = 0.01
#: Branch: the background is first sought in this part of the pixels, in so many at least for a
#: slope.
DARK_PART, FEWEST_DARK = 0.3, 8
#: Prior: error of the target's place by the file's coordinates, px: twice that of eleven real ones.
COORDINATES = 1.0
#: Tolerance: cadences whose arrays a processor's cache holds.
BLOCK = 128
#: Tolerance: weight of cadences that do not count.
NO_WEIGHT = 1e-6
#: Tolerance: widths in cadences of the kernels that are tried to smooth the focus and the
#: background.
_WIDTHS = (1.5, 3.0, 6.0, 12.0, 24.0, 48.0)
#: Tolerance: widths after which kernels end; least error in units of the typical one.
_END, _LEAST_ERROR = 3.5, 0.3
#: Branch: outliers exceed so many standard deviations, as noise does in one of 300,000 pixels.
CLIP = 4.5
#: Prior: duration in days of a transit of a habitable planet, of which CDPP is the noise
#: (Christiansen et al. 2012).
TRANSIT = 6.5 / 24


class Features:
    """Functions of position whose combinations are a Gaussian process of a scale (pivoted)."""

    def __init__(self, position, scale, tolerance):
        few = position[:: max(1, len(position) // 600)]

        def column(k):
            return _kernel(few, few[k : k + 1], scale)[:, 0]

        def ends(rest):
            return rest.max() < tolerance

        self._scale = scale
        self._pivots = few[pivoted_cholesky(np.ones(len(few)), column, ends, len(few))[0]]
        kernel = self.kernel(self._pivots)
        kernel.flat[:: len(kernel) + 1] += 1e-10
        self._lower = cholesky(kernel, lower=True)

    def kernel(self, position):
        """Return the kernels of the pivots, of which the functions are combinations."""
        return _kernel(position, self._pivots, self._scale)

    def __call__(self, position):
        """Return the kernels and the functions at positions, ``(n, rank)``."""
        kernel = self.kernel(position)
        return kernel, solve_triangular(self._lower, kernel.T, lower=True).T

    def weights(self, coefficients):
        """Return weights of the kernels that make combinations of the functions."""
        return solve_triangular(self._lower, coefficients, lower=True, trans=1)

    def slope_weights(self, weights):
        """Return those of derivatives along x and y, plus multiples of the combinations."""
        return [pivot[:, None] / self._scale**2 * weights for pivot in self._pivots.T]


def pivoted_cholesky(diagonal, column, ends, most):
    """Return the pivots of a kernel, and as many rows of its factor, ``(n_pivots, n)``.

    ``column`` returns that of a pivot, ``ends`` whether the diagonal's rest is small enough.
    """
    rest, rows, pivots = diagonal, np.zeros((most, len(diagonal))), []
    while len(pivots) < most and not ends(rest):
        k, pivot = len(pivots), int(np.argmax(rest))
        rows[k] = (column(pivot) - rows[:k, pivot] @ rows[:k]) / np.sqrt(rest[pivot])
        rest = np.maximum(rest - rows[k] ** 2, 0.0)
        pivots.append(pivot)
    return pivots, rows[: len(pivots)]


def _at_edge(four):
    edge = (7 * (four[1] + four[2]) - four[0] - four[3]) / 12
    return np.maximum(edge, np.sqrt(np.maximum(four[1] * four[2], 0)))


def _kernel(a, b, scale):
    return np.exp(-0.5 * cdist(a, b, "sqeuclidean") / scale**2)


class Flow:
    """What flows through the edges of pixels as the star moves, or as its PSF widens.

    The light at an edge is that of the cubic polynomial whose integrals over the four nearest
    pixels are right, and in the wings, where that is less, the geometric mean of both pixels.
    Beside the stamp light falls as at its edge. The pixels are those of `Columns`, of which full
    ones are drawn; the sum over the aperture stays as it is.
    """

    def __init__(self, columns, aperture):
        self.columns, self.grid, self.aperture = columns, columns.grid, aperture
        grid = columns.grid
        places = {tuple(place): k for k, place in enumerate(grid)}
        moved = [[grid + i * axis for i in range(-2, 3)] for axis in np.eye(2, dtype=int)]
        self._beside = np.array([[[places.get(tuple(p), -1) for p in m] for m in k] for k in moved])

    def moved(self, images):
        """Return the changes of images ``(n, n_pixels)`` along both axes, over the motion in px."""
        parts = [
            [self._without_sum(light, low - high) for low, high in edges]
            for _, light, edges in self._blocks(images)
        ]
        return [np.concatenate(along) for along in zip(*parts, strict=True)]

    def wider(self, images, center):
        """Return the change of a PSF at centers ``(n, 2)`` that widens by a part, over this."""
        return np.concatenate([self._without_sum(*both) for both in self._wider(images, center)])

    def lost(self, images, center):
        """Return what flows out of the stamp, ``(n,)``."""
        return -np.concatenate([wider.sum(axis=0) for _, wider in self._wider(images, center)])

    def _without_sum(self, light, change):
        return self.columns.summed((change - light * (self.aperture @ change)).T)

    def _wider(self, images, center):
        """Yield blocks of images and of what flows into pixels, ``(n_pixels, n_block)``."""
        for part, light, edges in self._blocks(images):
            wider = np.zeros_like(light)
            for axis, (low, high) in enumerate(edges):
                far = self.grid[:, axis, None] - center[part, axis]
                wider += (far - 0.5) * low - (far + 0.5) * high
            yield light, wider

    def _blocks(self, images):
        """Yield cadences, images, and the light at the lower and upper edges along both axes."""
        for first in range(0, len(images), BLOCK):
            part = slice(first, first + BLOCK)
            light = self.columns.drawn(images[part]).T
            near = [self._near(light, axis) for axis in (0, 1)]
            yield part, light, [(_at_edge(five[:4]), _at_edge(five[1:])) for five in near]

    def _near(self, light, axis):
        """Return two pixels before and after each along an axis, ``(5, n_pixels, n_block)``."""
        near = light[self._beside[axis]]
        near[self._beside[axis] < 0] = 0.0
        for k, inner in ((1, 1), (0, 1), (3, -1), (4, -1)):
            absent = self._beside[axis][k] < 0
            edge, before = near[k + inner][absent], near[k + 2 * inner][absent]
            falls = np.clip(edge / np.where(before > 0, before, np.inf), 0, 1)
            near[k][absent] = edge * falls
        return near


def polynomials(position):
    """Return all products of powers of both coordinates up to degree 3, the constant first."""
    x, y = position.T
    powers = [(i, n - i) for n in range(_DEGREE + 1) for i in range(n + 1)]
    return np.column_stack([x**i * y**j for i, j in powers])


def dark_plane(image, terms):
    """Return the coefficients of a plane through the darkest pixels.

    The ``terms`` are one and two coordinates of each, ``(n_pixels, 3)``.
    """
    dark = image <= np.quantile(image, DARK_PART)
    if dark.sum() < FEWEST_DARK:
        return np.array([np.median(image[dark]), 0.0, 0.0])
    return np.linalg.lstsq(terms[dark], image[dark], rcond=None)[0]


def precise_aperture(light, variance, position, count):
    """Choose the pixels ``(n_pixels,)`` whose sum is expected to be most precise.

    Pixels are added by their ratio of light to noise as long as the noise of ``count`` cadences,
    6.5 h, and what the aperture loses as the star moves, relative to all pixels, become less.
    """
    variance = quantile(variance.T)
    order = np.argsort(-quantile(light.T, MOST) / variance)
    inside = np.cumsum(light[:, order], axis=1)
    level = quantile(inside.T)
    noise = np.cumsum(variance[order])
    columns = polynomials(position / np.maximum(np.abs(position).max(axis=0), 1e-9))
    columns = np.linalg.qr(columns)[0][:, 1:]
    part = ((columns.T @ (inside / inside[:, -1:])) ** 2).sum(axis=0) / len(light) * level**2
    lost = np.maximum(part - columns.shape[1] * noise / len(light), 0)
    scatter = (_LOST * lost + noise / count) / np.where(level > 0, level, np.inf) ** 2
    fewest = min(3, len(order) - 1)  # but one
    mask = np.zeros(len(order), dtype=bool)
    mask[order[: fewest + np.argmin(scatter[fewest:]) + 1]] = True
    return mask


def nearness(dx, dy):
    """Return a relative probability of distances (px) from the place by the file's coordinates."""
    return (1 + (dx**2 + dy**2) / COORDINATES**2) ** -2.0


class Smoother:
    """Robust local lines in time, with Gaussian kernels whose widths are in cadences."""

    def __init__(self, time, use):
        self.time, self.use = time, use
        self.step = quantile(np.diff(time))
        steps = np.diff(np.rint((time - time[0]) / self.step))
        # beyond the widest kernel, a longer gap is the same
        steps = np.minimum(steps, 2 * int(_END * _WIDTHS[-1]) + 2)
        self._index = np.concatenate([[0], np.cumsum(steps)]).astype(int)
        self._kernels, self._best = {}, {}

    def __call__(self, values, error, name=""):
        """Smooth with the width of the least median leave-one-out error; return course and error.

        The course is drawn to its mean by Wiener's factor, its variance over the sum of this and of
        the variance of its noise: noise has no course. Cadences that are not in use take the values
        of those around them. Widths are tried from the next narrower one on than was best for a
        name the last time. Values far from any course, as seeing's, are their own.
        """
        use = self.use
        typical, own = quantile(error[use]), (values, error)
        start = np.where(use, (typical / np.maximum(error, _LEAST_ERROR * typical)) ** 2, NO_WEIGHT)
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
            rest = np.abs(values - smooth) / np.maximum(1 - weight * s2 / determinant, NO_WEIGHT)
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
        half = int(_END * width) + 1
        size = next_fast_len(self._index[-1] + 1 + half, real=True)
        if width not in self._kernels:
            d = np.arange(-half, half + 1.0)
            kernels = np.exp(-0.5 * (d / width) ** 2) * np.array([d**0, -d, d * d])
            self._kernels[width] = rfft(kernels, size)
        whole, kernels = rfft(grid, size)[[0, 0, 0, 1, 1]], self._kernels[width][[0, 1, 2, 0, 1]]
        return irfft(whole * kernels, size)[:, half:][:, self._index]


def quantile(values, part=0.5):
    """Return a quantile along the last axis of finite values, faster than NumPy's."""
    place = part * (values.shape[-1] - 1)
    k = int(place)
    ordered = np.partition(np.ascontiguousarray(values), k)
    low = ordered[..., k]
    return low if place == k else low + (place - k) * (ordered[..., k + 1 :].min(axis=-1) - low)
