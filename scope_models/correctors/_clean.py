r"""Pixel fractions that neither the star's brightness nor photon noise can move.

Measured fractions of a pixel follow the star when there is other light in the aperture, and they
hold the same photon noise as the flux that they are to explain. Here the fractions are predicted.
In cadence t the light of pixel p is

.. math::

    F_p(t) = a_t \left[G_p(x_t) + w_t W_p(x_t)\right] - v_t N_p(x_t) + c_{tp},

with the brightness a, the position x, the focus w and the background c (a plane) of the cadence,
and smooth functions of position G, W and N of each pixel. Over the aperture G adds up to 1, W and N
to nothing. N is the difference between the constant light and the star's in the image; it counts
only where the star itself varies strongly (v). Pixels and cadences are fitted in turn; the light is
then a least-squares estimate with the errors of noise and of this model.
"""

import numpy as np
from scipy import ndimage

from scope_models.correctors._constant_light import constant_light
from scope_models.correctors._position import (
    FEWEST_DARK,
    REWEIGHTS,
    Features,
    Widening,
    dark_plane,
)
from scope_models.correctors._smoothing import CLIP, NO_WEIGHT, TRANSIT, Smoother, quantile
from scope_models.correctors._states import CleanPixels

__all__ = ["clean_pixels"]

#: Prior: scale (px) of the response functions of position, and of those of focus and constant
#: light.
_SCALE, _COARSE_SCALE = 0.8, 1.0
#: Tolerance: what is left of kernels at most, and the largest number of functions.
_TOLERANCE, _COARSE_TOLERANCE = 1e-9, 1e-4
_MAX_RANK, _COARSE_RANK = 200, 25
#: Tolerance: number of iterations, and for stars whose constant light is learned.
_ITERATIONS, _MORE_ITERATIONS = 7, 12
#: Tolerance: the fit ends after so many iterations if the median steps of brightness, both
#: positions and focus are less than these parts of their errors, and the star does not vary
#: strongly.
_FEWEST_ITERATIONS, _SMALL_STEPS = 4, (0.15, 0.15, 0.15, 0.2)
#: Tolerance: and once images may change slowly.
_REFINEMENTS = 3
#: Branch: iterations after which the focus has an image of its own, and constant light counts.
_FOCUS_FROM = 2
#: Prior: standard deviations: position about POS_CORR (px), relative width.
_POSITION_PRIOR, _FOCUS_PRIOR = 0.02, 0.02
#: Branch: POS_CORR that deviates by more is wrong (px).
_ABSURD = 12.0
#: Branch: time in days, and standard deviation of changes of the star within it above which
#: constant light can be learned.
_FAST, _STRONG = 0.25, 0.02
#: Prior: relative change of the light in the aperture with position, for telling it from
#: variability.
_RESPONSE_PRIOR = 0.05
#: Prior: degree of the waves along the rows in cadences with rolling bands.
_BANDS = 4
#: Tolerance: width (px) of the rings of the star's profile, and cadences that it is taken from.
_RING, _ENOUGH = 0.5, 500
#: Branch: part of the light in the aperture above which the level of dark pixels is background.
_BACKGROUND = 0.05
#: Branch: cosmic rays exceed so many standard deviations.
_HIT = 4.5
#: Branch: part of a pixel's light by which the functions of position may miss where the star moves
#: far: cosmic rays exceed it, too. Largest ratio of light to noise in a pixel from which on this
#: and ``CLIP`` hold; of fainter stars cosmic rays are a larger part of the light than such errors.
_MISFIT, _BRIGHT = 0.05, 5000.0
#: Prior: images change with time as polynomials of one degree in so many days; tolerance: with so
#: many columns.
_DAYS_PER_DEGREE, _MOST_SLOW = 10.0, 60
#: Branch: constant light in the aperture, relative, below which it does not count; and the
#: iteration at which that is decided.
_FAINT, _DECIDED = 0.004, 5
#: Branch: width in days of the kernel beyond which outliers of the focus are dips, and none of the
#: focus.
_SLOW = 0.05


def clean_pixels(
    time,
    flux,
    flux_err,
    position,
    grid,
    aperture,
    *,
    use=None,
    banded=None,
    changing=False,
    state=None,
):
    """Predict the pixel fractions of a star.

    Parameters
    ----------
    time : ndarray
        Days, ``(n,)``.
    flux, flux_err : ndarray
        All pixels with data, ``(n, n_pixels)``, e-/s.
    position : ndarray
        POS_CORR ``(n, 2)``, columns and rows, px; NaN where unknown.
    grid : ndarray
        Column and row of each pixel ``(n_pixels, 2)``.
    aperture : ndarray of bool
        Pixels that are summed.
    use : ndarray of bool, optional
        Cadences from which everything that they share is learned, ``(n,)``; by default all.
    banded : ndarray of bool, optional
        Cadences with waves in the background along the rows, ``(n,)``; by default none.
    changing : bool, optional
        Whether the images change slowly with time, and the background fluctuates.
    state : dict, optional
        Keeps what has been fitted, from which another call for the same pixels goes on.

    Returns
    -------
    CleanPixels
        The result.
    """
    state = {} if state is None else state
    if not state:
        use = np.ones(len(flux), dtype=bool) if use is None else use
        banded = np.zeros(len(flux), dtype=bool) if banded is None else banded
        state["fitted"] = _State(time, flux, flux_err, position, grid, aperture, use, banded)
        state["fitted"].converge()
    fitted = state["fitted"]
    images = fitted.refine() if changing else fitted.images()
    kept = fitted.kept(images)
    return fitted.result(*fitted.light(flux_err, images, kept), images, kept)


class _State:
    """The model and its parameters while they are fitted; fluxes in units of the star's."""

    def __init__(self, time, flux, flux_err, position, grid, aperture, use, banded):
        n, n_pixels = flux.shape
        self.time, self.grid, self.aperture, self.use = time, grid, aperture, use
        self.banded = banded
        typical = quantile(flux[use].T)
        offset = (grid - grid.mean(axis=0)) / np.maximum(np.ptp(grid, axis=0), 1)
        self.planes = np.column_stack([np.ones(n_pixels), offset])
        n_terms = 3 if n_pixels // 4 >= FEWEST_DARK else 1  # few pixels show no slope
        slope = dark_plane(typical, self.planes)[:n_terms]
        above = typical - self.planes[:, :n_terms] @ slope
        self.dark = dark = np.argsort(above)[: max(3, n_pixels // 4)]
        if banded.any():
            rows = 2 * (grid[:, 1] - grid[:, 1].min()) / max(np.ptp(grid[:, 1]), 1) - 1
            waves = np.polynomial.legendre.legvander(rows, _BANDS)[:, 2:]
            self.planes = np.column_stack([self.planes, waves])
        # unless that may be the star's wings
        level = quantile(typical[dark])
        much = level * aperture.sum() > _BACKGROUND * typical[aperture].sum()
        self.base = np.zeros(self.planes.shape[1])
        self.base[0] = level if much else 0.0
        planes = np.zeros((n, len(self.base))) + self.base
        planes[:, :n_terms] += _planes((flux - typical)[:, dark], self.planes[dark, :n_terms])
        total = (flux - planes @ self.planes.T)[:, aperture].sum(axis=1)
        self.unit = quantile(total[use])
        self.y, self.plane = flux / self.unit, planes / self.unit
        self.base = self.base / self.unit
        self.brightness = total / self.unit
        # waves are as strong as what dark pixels have beyond noise, in episodes with flags
        self.waves = np.zeros(n)
        if banded.any():
            change = (flux - typical)[:, dark] / self.unit
            spread = (1.4826 * quantile(np.abs(change - quantile(change)[:, None]))) ** 2
            excess = spread - quantile(spread[use])
            width = max(round(TRANSIT / quantile(np.diff(time))), 1)
            excess = ndimage.median_filter(excess, width)
            episodes, _ = ndimage.label(banded | (excess > 0))
            excess[~np.isin(episodes, episodes[banded])] = 0.0
            self.waves = np.sqrt(np.maximum(excess, 0.0))
        self.noise = (quantile(flux_err[use].T) / self.unit) ** 2
        self.variance = self.noise
        self.widened = Widening(grid, aperture)
        self.good = np.ones((n, n_pixels), dtype=bool)
        self.focus, self.variable = np.zeros((2, n))
        self.slow, self.fluctuation, self.changing = np.zeros((n, 0)), 0.0, False
        self._start_positions(position, total)
        self.scale = self._most_light()
        self.smoothed, self._last = Smoother(time, use), None
        self._place = np.where(self.known, _POSITION_PRIOR**-2, 1e-2)
        self.features = Features(self.z[use], _SCALE, _TOLERANCE, _MAX_RANK)
        self.coarse = Features(self.z[use], _COARSE_SCALE, _COARSE_TOLERANCE, _COARSE_RANK)

    @property
    def varies(self):
        """Whether the star varied strongly in this iteration or the one before."""
        return self.variable.any() or self._constant is not None

    @property
    def background(self):
        """Background of each pixel and cadence."""
        return self.plane @ self.planes.T

    def _start_positions(self, position, total):
        """Begin at POS_CORR, and where that is unknown or absurd at centroids in its scale."""
        light = (self.y - self.background)[:, self.aperture]
        centroid = light @ self.grid[self.aperture] * (self.unit / total)[:, None]
        self.center = quantile(centroid[self.use].T)
        centroid = centroid - self.center
        known = np.isfinite(position).all(axis=1)
        offset = np.where(known[:, None], position, 0.0)
        fit = known & self.use
        middle = quantile(offset[fit].T) if fit.any() else np.zeros(2)
        known &= np.abs(offset - middle).max(axis=1) < _ABSURD
        fit &= known
        if fit.sum() < 0.2 * self.use.sum() or np.ptp(offset[fit], axis=0).max() == 0:
            self.known = np.ones(len(known), dtype=bool)
            self.z = self.expected = centroid
            return
        columns = np.column_stack([centroid, np.ones(len(centroid))])
        expected = offset - quantile(offset[fit].T)
        slope = np.linalg.lstsq(columns[fit], expected[fit], rcond=None)[0]
        self.known = known
        # where the star was seen: without light there is no centroid
        near = np.clip(columns @ slope, expected[fit].min(axis=0), expected[fit].max(axis=0))
        self.expected = np.where(known[:, None], expected, near)
        self.z = self.expected.copy()

    def _most_light(self):
        """Return what each pixel may hold: most of its light, or more by the star's profile.

        Few cadences show what pixels hold at rare places; pixels as near the star do.
        """
        light, least = (self.y - self.background)[self.use], 3 * np.sqrt(self.noise)
        distance = np.hypot(*(self.grid - self.center - self.z[self.use, None]).T)
        few = slice(None, None, max(len(light) // _ENOUGH, 1))
        rings = (distance[:, few] / _RING).astype(int)
        inside = [light[few].T[rings == k] for k in range(rings.max() + 1)]
        profile = [max(quantile(values, 0.98), least.min()) for values in inside if values.size]
        places = _RING * (np.unique(rings) + 0.5)
        profile = np.log(np.maximum.accumulate(profile[::-1])[::-1])
        expected = np.exp(np.interp(distance.min(axis=1), places, profile))
        return np.maximum(np.maximum(quantile(light.T, 0.98), expected), least)

    def converge(self):
        """Fit pixels and cadences by turns."""
        for iteration in range(_MORE_ITERATIONS):
            if iteration >= _ITERATIONS and not self.variable.any():
                break
            self.fit_pixels(iteration)
            converged = self.fit_cadences(iteration)
            if converged and iteration >= _FEWEST_ITERATIONS - 1 and not self.varies:
                break

    def fit_pixels(self, iteration):
        """Fit the functions of position of all pixels at once: ridge regression."""
        _, basis, coarse = self._functions()
        a, v, w = self.brightness[:, None], self.variable[:, None], self.focus[:, None]
        parts = [a * basis]
        if iteration >= _FOCUS_FROM:
            parts.append(2 * a * w * coarse)  # the prior's standard deviation is 2
            parts.append(a * self.slow)
        strong = v.any()
        if strong:
            parts.append(-v * coarse)
        columns = np.concatenate(parts, axis=1)
        columns[~(self.use & self.good.all(axis=1))] = 0
        values, vectors = np.linalg.eigh(columns.T @ columns)
        right = vectors.T @ (columns.T @ (self.y - self.background))
        ridge = self.variance / self.scale**2
        coefficients = vectors @ (right / (np.maximum(values, 0)[:, None] + ridge))
        rank, few = basis.shape[1], coarse.shape[1]
        self._main, self._focus, self._constant = coefficients[:rank], None, None
        if iteration >= _FOCUS_FROM:
            self._focus = 2 * coefficients[rank : rank + few]
            rows = slice(rank + few, rank + few + self.slow.shape[1])
            self._slow = coefficients[rows]
            self._rescale(vectors[rows] ** 2 @ (ridge / (np.maximum(values, 0)[:, None] + ridge)))
        if strong:
            self._constant = coefficients[-few:]

    def _rescale(self, posterior):
        """Give slow changes their most likely variance (MacKay 1992).

        ``posterior`` is their variance in units of the prior's, ``(n_columns, n_pixels)``.
        """
        if self._slow.size:
            size = np.sqrt(np.sum((self._slow / self.scale) ** 2) / np.sum(1 - posterior))
            self.slow, self._slow = self.slow * size, self._slow / size

    def _functions(self):
        """Return kernels, functions and coarse functions of the positions, which are kept."""
        if self._last is None or self._last[0] is not self.z:
            self._last = self.z, *self.features(self.z), self.coarse(self.z)[1]
        return self._last[1:]

    def images(self):
        """Return G, the whole image, its derivatives by x, y and w, and N or nothing.

        Sums are as stated. The image has the focus and slow changes of each cadence, once these
        have images of their own.
        """
        inside, weights = self.aperture, self.features.weights(self._main)
        kernel, _, coarse = self._functions()
        total = (kernel @ weights[:, inside].sum(axis=1))[:, None]
        kernel = kernel / total
        image = kernel @ weights

        def without_sum(columns, coefficients):
            """Return images whose sum over the aperture is taken off in the shape of the star."""
            values = columns @ coefficients
            values -= (columns @ coefficients[:, inside].sum(axis=1))[:, None] * image
            return values

        # multiples of the image drop out with the sums
        slopes = [without_sum(kernel, moved) for moved in self.features.slope_weights(weights)]
        constant = 0.0
        if self._focus is None:
            # A PSF that widens about the star's center.
            far = self.grid - self.center - self.z[:, None]
            focus = far[:, :, 0] * slopes[0] + far[:, :, 1] * slopes[1] - 2 * image
            focus -= image * (focus @ inside)[:, None]
        else:
            focus = without_sum(coarse / total, self._focus)
            if self._constant is not None:
                constant = without_sum(coarse, self._constant)
        whole = image.copy()
        if self._focus is not None:
            whole += self.focus[:, None] * focus + without_sum(self.slow / total, self._slow)
        return image, whole, [*slopes, focus], constant

    def _normalize(self, image, slopes):
        """Give the focus the unit of a relative width, and its image the light of the wings.

        Where pixels are dark a wider PSF is like more background: the level of its image there is
        that of the widening.
        """
        use, outside = self.use, ~self.aperture
        away = self.center + self.z[use]
        wider, fitted = self.widened(image[use], away), slopes[2][use].mean(axis=0)
        signal = [(values**2 / self.variance).sum() + 1e-12 for values in (fitted, wider)]
        size = np.sqrt(signal[0] / signal[1])
        self.focus = self.focus * size
        self._focus, slopes[2] = self._focus / size, slopes[2] / size
        if outside.any():
            wing = quantile((wider - fitted / size)[outside])
            columns = self._last[-1]
            one = np.linalg.lstsq(columns[use], np.ones(use.sum()), rcond=None)[0]
            self._focus = self._focus + wing * one[:, None]
            slopes[2] += wing * (1 - self.aperture.sum() * image)

    def fit_cadences(self, iteration):
        """Improve brightness, background, position and focus of each cadence: one linear step.

        Return whether the step was small.
        """
        before = np.stack([self.brightness, *self.z.T, self.focus])
        still, image, slopes, constant = self.images()
        if self._focus is not None:
            self._normalize(still, slopes)
        before[3] = self.focus
        rest = self._rest(image, constant)
        spread = 1.4826 * quantile(np.abs(rest[self.use].T))
        self.variance = np.maximum(self.noise, spread**2)
        if iteration > 0:
            hot = self._hot(rest, image, slopes)
            seen = np.pad(hot & self.use[:, None], ((1, 1), (0, 0)))
            self.good = ~hot | seen[:-2] | seen[2:]  # cosmic rays are in one cadence only
        hessian, right = self._normal_equations([image, *slopes], rest)
        level = np.abs(self.plane[self.use, 0] - self.base[0])
        tilt = max(1.4826 * quantile(level) + abs(self.base[0]), 1e-9)
        tilt = np.maximum(self.waves, tilt)
        # a cadence may have outliers in all pixels: steps are of the size of the star's light
        priors = [
            (0, 1.0, 0.0),
            (4, 1.0, 0.0),
            (1, self._place, (self.expected - self.z)[:, 0]),
            (2, self._place, (self.expected - self.z)[:, 1]),
            (3, _FOCUS_PRIOR**-2, -self.focus),
            (5, tilt**-2, self.base[1] - self.plane[:, 1]),
            (6, tilt**-2, self.base[2] - self.plane[:, 2]),
        ]
        flat = np.maximum(self.waves, 1e-9) ** -2.0
        priors += [(4 + k, flat, -self.plane[:, k]) for k in range(3, len(self.base))]
        for k, weight, distance in priors:
            hessian[k, k] += weight
            right[k] += weight * distance
        step, error = _solved(hessian, right)
        self.brightness = self.brightness + np.clip(step[0], -0.3, 0.3)
        self.z = self.z + np.clip(step[1:3], -0.1, 0.1).T
        self._set_background(self.plane + step[4:].T, error[4:].T, iteration)
        self._set_variable(iteration)
        self._anchor()
        # what positions and brightness explain is no focus
        use, center = self.use, self.z[self.use].mean(axis=0)
        columns = np.column_stack([np.ones(len(use)), self.z - center, self.variable])
        focus = self.focus + np.clip(step[3], -0.02, 0.02)
        # ... beyond what positions are uncertain by
        ridge = use.sum() * np.diag([0, _POSITION_PRIOR, _POSITION_PRIOR, 0]) ** 2
        gram = columns[use].T @ columns[use] + ridge + 1e-9 * use.sum() * np.eye(4)
        focus -= columns @ np.linalg.solve(gram, columns[use].T @ focus[use])
        late = iteration >= _FOCUS_FROM
        self.focus = self.smoothed(focus, error[3], "focus") if late else focus
        moved = np.abs(np.stack([self.brightness, *self.z.T, self.focus]) - before) / error[:4]
        return bool((quantile(moved[:, self.use]) < _SMALL_STEPS).all())

    def _hot(self, rest, image, slopes):
        """Return pixels far above the model.

        In faint stars' pixels, brightness and position follow a cosmic ray in part: less is left.
        """
        sigma, bright = np.sqrt(self.variance), self.bright
        if bright < 1:
            columns = np.stack([part.mean(axis=0) for part in (image, *slopes[:2])], axis=1)
            columns /= sigma[:, None]
            hessian = columns.T @ columns + np.diag([0, _POSITION_PRIOR**-2, _POSITION_PRIOR**-2])
            leverage = np.einsum("ij,ji->i", columns, np.linalg.solve(hessian, columns.T))
            sigma = sigma * np.sqrt(1 - leverage)
        excess = rest - (_HIT + bright * (CLIP - _HIT)) * sigma
        hot = excess > 0
        hot[hot] = excess[hot] > bright * _MISFIT * np.abs(image[hot])
        return hot

    def _rest(self, image, constant):
        """Return what images and background leave of the light."""
        rest = self.y - self.background
        rest -= self.brightness[:, None] * image
        if self._constant is not None:
            rest += self.variable[:, None] * constant
        return rest

    def _normal_equations(self, images, rest):
        """Return the Hessian and the right side of each cadence's least squares, ``(k, k, n)``.

        The images are those of brightness, position, and focus. They are overwritten.
        """
        root, damaged = 1 / np.sqrt(self.variance), np.nonzero(~self.good)
        for values in (*images, rest):
            np.multiply(values, root, out=values)
            values[damaged] = 0
        planes = self.planes * root[:, None]
        first, k = len(images), len(images) + planes.shape[1]
        hessian, right = np.zeros((k, k, len(rest))), np.zeros((k, len(rest)))
        for i, values in enumerate(images):
            for j in range(i + 1):
                hessian[i, j] = np.einsum("ij,ij->i", values, images[j])
            hessian[first:, i] = (values @ planes).T
            right[i] = np.einsum("ij,ij->i", values, rest)
        right[first:] = (rest @ planes).T
        hessian[first:, first:] = (planes.T @ planes)[:, :, None]
        for cadence, pixel in zip(*damaged, strict=True):
            hessian[first:, first:, cadence] -= np.outer(planes[pixel], planes[pixel])
        hessian[1:first] *= self.brightness
        hessian[:, 1:first] *= self.brightness
        right[1:first] *= self.brightness
        return hessian, right

    def light(self, flux_err, images, kept):
        """Return the star's light and its error by least squares.

        Of the means of 6.5 h the model misses in each pixel what their variance has beyond noise.
        These errors, as the images, add up to nothing over the aperture: where they dominate, the
        light is the sum, and where noise does, it has optimal weights. The focus is as uncertain
        as it varies, for such weights are much more sensitive to the width than a sum is. With
        images that change, what dark pixels miss is more noise, and so is a fluctuating background.
        Pixels with cosmic rays are replaced, and what the focus moves over the border is put back.
        """
        _, image, slopes, constant = images
        rest = self._rest(image, constant)
        rest[~self.good] = 0.0
        use, mean = self.use, image[self.use].mean(axis=0)
        # FLUX_ERR lacks what dark pixels show
        change = np.diff(rest[use][:, self.dark], axis=0) / np.sqrt(2 * self.noise[self.dark])
        noise = self.noise * max(quantile((1.4826 * quantile(np.abs(change.T))) ** 2), 1.0)
        width = min(max(round(TRANSIT / self.smoothed.step), 1), use.sum() // 10)
        windows = rest[use][: use.sum() // width * width].reshape(-1, width, rest.shape[1])
        missed = windows.mean(axis=1).var(axis=0) - noise / width
        everywhere = max(quantile(missed[self.dark]), 0.0) if self.changing else 0.0
        balance = np.eye(len(mean)) - np.outer(np.where(self.aperture, mean, 0), self.aperture)
        misfit = (balance * np.maximum(missed - everywhere, 0)) @ balance.T
        covariance = np.diag(noise + width * everywhere) + width * misfit
        root = np.linalg.inv(np.linalg.cholesky(covariance)).T
        scale = [1.0, *3 * [self.brightness[:, None]]]
        columns = [a * (part @ root) for a, part in zip(scale, (image, *slopes), strict=True)]
        columns.append(np.broadcast_to(root.sum(axis=0), rest.shape))
        hessian = np.zeros((len(columns), len(columns), len(rest)))
        for i, column in enumerate(columns):
            for j in range(i + 1):  # only the lower triangle is used
                hessian[i, j] = np.einsum("ij,ij->i", column, columns[j])
        hessian[[1, 2], [1, 2]] += self._place
        hessian[3, 3] += 1 / max(np.var(self.focus[use]), 1e-12)
        hessian[4, 4] += 1 / max(self.fluctuation, 1e-12 * self.noise.min())
        first = np.zeros(hessian.shape[1:])
        first[0] = 1
        parts = zip(_solved(hessian, first)[0][:, :, None], columns, strict=True)
        weights = sum(size * column for size, column in parts) @ root.T
        light = self.brightness + np.sum(weights * rest, axis=1)
        variance = np.sum((weights * flux_err / self.unit) ** 2, axis=1)
        variance += self.fluctuation * weights.sum(axis=1) ** 2
        return light * kept, np.sqrt(variance) * kept

    def _set_background(self, plane, errors, iteration):
        """Smooth the background as far as the data are for it; jumps and bands stay."""
        plane = plane - quantile(plane[self.use].T) + self.base
        if iteration >= _FOCUS_FROM:
            for k, (values, error) in enumerate(zip(plane.T[:3], errors.T[:3], strict=True)):
                smooth = self.smoothed(values, error, f"background {k}")
                rest = np.abs(values - smooth)
                typical = 1.4826 * quantile(rest[self.use])
                jumps = rest > CLIP * np.maximum(error, typical)
                values[:] = np.where(jumps | self.banded, values, smooth)
                if k == 0 and self.changing:
                    self.fluctuation = max(typical**2 - quantile(error[self.use]) ** 2, 0.0)
        self.plane = plane

    def _set_variable(self, iteration):
        """Find the star's own variability: what is no function of position in its brightness."""
        if iteration < _FOCUS_FROM:
            return
        columns, use = self._last[2], self.use  # of the positions before this step
        variable = change = self.brightness - 1
        # slow changes may be the star's: the response to position is learned from fast ones
        fast, right = self._change(columns[use]), self._change(change[use])
        for _ in range(3):
            noise = 1.4826 * quantile(np.abs(self._change(variable[use]))) / np.sqrt(2)
            gram = fast.T @ fast + (noise / _RESPONSE_PRIOR) ** 2 * np.eye(fast.shape[1])
            variable = change - columns @ np.linalg.solve(gram, fast.T @ right)
        strong = self._is_strong(variable[use])
        if strong and iteration >= _DECIDED:
            _, image, slopes, constant = self.images()
            light = self._constant_light(image, slopes[:2], constant)
            strong = quantile(light[use]) > _FAINT
        self.variable = variable if strong else np.zeros_like(variable)

    def _is_strong(self, variable):
        """Return whether the star varies much within 6 h, apart from noise and jumps.

        Slower changes are no measure of constant light: focus and drifts are as slow.
        """
        slow = np.mean(self._change(variable) ** 2)
        return slow - np.mean(np.diff(variable) ** 2) > 2 * _STRONG**2

    def _change(self, values):
        """Return the changes of values in the cadences in use within 6 h."""
        lag = round(_FAST / quantile(np.diff(self.time[self.use])))
        lag = int(np.clip(lag, 2, len(values) // 2))  # nights are short
        return values[lag:] - values[:-lag]

    def _anchor(self):
        """Bring positions back to the scale of POS_CORR, without what follows the brightness."""
        known = self.known & self.use
        use = known
        columns = np.column_stack([self.z, np.ones(len(self.z)), self.variable])
        weight = np.diag([4e-4, 4e-4, 0.0, 4e-4])  # toward no change, where POS_CORR has no say
        change = np.zeros((4, 2))
        for _ in range(3):
            gram = columns[use].T @ columns[use] + weight
            gram[2, 2] += 1e-9
            change = np.linalg.solve(gram, columns[use].T @ (self.expected - self.z)[use])
            rest = self.expected - self.z - columns @ change
            use = known & (np.abs(rest).max(axis=1) < 0.1)
        self.z = self.z + columns @ change

    def kept(self, images):
        """Return the light that the aperture would hold at constant focus, over what it holds.

        A wider PSF moves light to the pixels outside, and out of the stamp.
        """
        still, _, slopes, _ = images
        outside = ~self.aperture
        focus = self._lines(self.focus, _SLOW)  # without short dips
        lost = focus * self.widened.lost(still, self.center + self.z)
        whole = np.maximum(1 + still @ outside, 0.1)
        moved = focus * (slopes[2] @ outside)
        return np.maximum(whole + moved, 0.1) / np.maximum(whole - lost, 0.1)

    def result(self, light, error, images, kept):
        """Return a light and the fractions, which are ``kept`` as `kept` has it."""
        still, image, slopes, constant = images
        other, inside = self._constant_light(image, slopes[:2], constant), self.aperture
        focus = self._lines(self.focus, _SLOW)  # without short dips
        return CleanPixels(
            light=self.unit * (light - other),
            light_error=self.unit * error,
            shares=np.where(inside, image, 0.0) / kept[:, None],
            still=np.where(inside, image + (focus - self.focus)[:, None] * slopes[2], 0.0),
            outside=still @ ~inside,
            background=self.unit * self.background,
            position=self.z,
            focus=focus,
            constant=self.unit * quantile(other[self.use]),
            repaired=~self.good,
        )

    def refine(self):
        """Let images change slowly and the background fluctuate, at the focus that was found."""
        coarse, span = self.coarse(self.expected)[1], self.time[-1] - self.time[0]
        degree = min(round(span / _DAYS_PER_DEGREE), _MOST_SLOW // coarse.shape[1])
        x = 2 * (self.time - self.time[0]) / span - 1
        slow = np.polynomial.legendre.legvander(x, degree)[:, 1:]
        self.slow = (slow[:, :, None] * coarse[:, None]).reshape(len(x), -1)
        self.changing, focus = True, self.focus
        for _ in range(_REFINEMENTS):
            self.fit_pixels(_ITERATIONS)
            self.fit_cadences(_ITERATIONS)
            self.focus = focus
        self.fit_pixels(_ITERATIONS)
        return self.images()

    @property
    def bright(self):
        """Light over noise in units of a bright star's, at most 1."""
        signal = (self.scale / np.sqrt(self.variance)).max()
        return min(signal / _BRIGHT, 1.0)

    def _lines(self, values, days):
        """Return values smoothed by a kernel of so many days."""
        weight = np.where(self.use, 1.0, NO_WEIGHT)
        return self.smoothed.lines(values, weight, days / self.smoothed.step)[0]

    def _constant_light(self, image, slopes, constant):
        """Return the constant light in the aperture, if the star's variability shows it."""
        if not self.variable.any():
            return np.zeros(len(image))
        level = (self.brightness - self.variable)[self.use].mean()
        images = image, image - constant, slopes
        return level * constant_light(*images, self.z, self.grid, self.aperture, self.use)


def _planes(change, terms):
    """Return robust coefficients of changes of pixels ``(n, n_pixels)``, ``(n, n_terms)``.

    A star that moves far, or a cosmic ray, is in some of the pixels.
    """
    found = np.zeros((len(change), terms.shape[1]))
    found[:, 0] = quantile(change)
    for _ in range(REWEIGHTS):
        rest = np.abs(change - found @ terms.T)
        weight = 1 / (1 + (rest / np.maximum(3 * quantile(rest)[:, None], 1e-300)) ** 2)
        gram = np.einsum("np,pi,pj->nij", weight, terms, terms, optimize=True)
        found = np.linalg.solve(gram, ((weight * change) @ terms)[:, :, None])[:, :, 0]
    return found


def _solved(hessian, right):
    """Solve many small systems at once by Cholesky factors.

    Parameters are a Hessian ``(k, k, n)``, of which the lower triangle is used, and a right side
    ``(k, n)``. Returned are the solution and its standard deviations, ``(k, n)``.
    """
    inverse = np.zeros_like(hessian)  # of the factor
    for i in range(len(right)):
        row = np.einsum("jkn,kn->jn", inverse[:i, :i], hessian[i, :i])
        pivot = (1 + 1e-9) * hessian[i, i] - np.einsum("jn,jn->n", row, row)
        inverse[i, i] = 1 / np.sqrt(np.maximum(pivot, 1e-30))
        inverse[i, :i] = -inverse[i, i] * np.einsum("jn,jkn->kn", row, inverse[:i, :i])
    solution = np.einsum("jin,jn->in", inverse, np.einsum("ijn,jn->in", inverse, right))
    return solution, np.sqrt(np.einsum("jin,jin->in", inverse, inverse))
