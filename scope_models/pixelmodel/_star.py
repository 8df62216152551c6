r"""Pixel fractions that neither the star's brightness nor photon noise can move.

In cadence t the light of pixel p is

.. math::

    F_p(t) = a_t \left[G_p(x_t) + w_t W_p(x_t) + w_t^2 Q_p(x_t)\right] - v_t N_p(x_t) + c_{tp},

with the brightness a, the position x, the relative width w and the background c (a plane) of the
cadence, and smooth functions of position G, W, Q and N of each pixel. Over the aperture G adds up
to 1, the others to nothing. N is the difference between the constant light and the star's in the
image; it counts only where the star itself varies strongly (v). The variance of N is the most
likely one (MacKay 1992, Neural Computation, 4, 415). W is expected to be what flows into the pixels
as the PSF widens. Images and cadences are fitted in turn. The noise of a pixel is that of its light
in each cadence, what the model misses in it, and what is uncertain in the images; cadences in which
pixels fall short of the model by more than this have more, and less weight in the images (Huber's).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.linalg import solveh_banded

from scope_models.pixelmodel._smooth import CLIP, TRANSIT, quantile
from scope_models.pixelmodel._stamp import POSITION_PRIOR, make_stamp

__all__ = [
    "IMAGE_ERROR", "LEAST_LIGHT", "MISFIT", "RESPONSE_PRIOR", "SMALL_STEP", "StarModel", "fit_star",
]  # fmt: skip

#: Prior: error of an image in each pixel, in units of the star's light.
IMAGE_ERROR = 1e-3

#: Prior: standard deviation of the relative width of the PSF, that of seeing at a good site.
_WIDTH_PRIOR = 0.2
#: Prior: standard deviations of changes of an image in units of its own before the fit. A relative
#: width changes the center of a Gaussian PSF by 2, its square by 3; what flows over the pixels'
#: edges is an estimate. The data give that of constant light; this is where it begins.
_CHANGES = {"width": 2.0, "squared": 3.0, "constant": 1.0}
#: Tolerance: number of steps at most. A fit ends if steps are less than this part of their errors,
#: here the median ones of brightness, both positions and width (of its course or a mean of 6.5 h).
_MOST_STEPS, SMALL_STEP = 12, 0.15
#: Tolerance: largest changes in a step of brightness, both positions (px) and width.
_LARGEST = np.array([[0.3], [0.1], [0.1], [_WIDTH_PRIOR]])
#: Tolerance: largest change of the unit of the widths in a step, as a factor.
_UNIT = 2.0
#: Branch: there are no images if a cadence counts in its own, as functions over cadences, for more
#: than all others: what is different in each, as the seeing, would be in them.
_MOST_OWN = 0.5
#: Tolerance: part of the typical light that an aperture holds at least.
LEAST_LIGHT = 0.1
#: Branch: standard deviation of changes of the star within 6.5 h above which constant light can be
#: learned.
_STRONG = 0.02
#: Prior: relative change of the light in the aperture with position, for telling it from
#: variability.
RESPONSE_PRIOR = 0.05
#: Prior: relative error of a pixel's light where no other cadence shows the star, that of responses
#: of pixels (1 %, Kepler Instrument Handbook).
MISFIT = 0.01


@dataclass(frozen=True)
class StarModel:
    """The light of a star without background, and predicted pixel fractions.

    The ``light`` is the sum over the aperture, cosmic rays replaced; what a change of the width
    moves over the border of the aperture is put back. The ``background`` is relative to its median
    where the dark pixels may hold the star's wings.
    """

    light: np.ndarray  # e-/s, (n,)
    light_error: np.ndarray  # standard deviation of its noise, e-/s, (n,)
    shares: np.ndarray  # fractions of this light (n, n_pixels), 0 outside of the aperture
    still: np.ndarray  # those of the light that the aperture holds; they add up to 1
    outside: np.ndarray  # the star's light in its other pixels over that inside, (n,)
    background: np.ndarray  # e-/s, (n, n_pixels)
    position: np.ndarray  # relative to the median, px, (n, 2)
    variable: np.ndarray  # strong variability of the star, 0 if there is none, (n,)
    focus: np.ndarray  # relative change of the PSF's width, (n,)
    constant: float  # part of the light that does not vary with the star, at least
    misfit: np.ndarray  # what pixels show beyond the model, over the light, 0 outside (n, n_pixels)
    level: np.ndarray  # what the background has beyond its smooth course, over the light, (n,)
    weighted: np.ndarray  # what weights of least squares add to the light, over the light, (n,)
    repaired: np.ndarray  # pixels whose light was replaced by the model's, (n, n_pixels)
    slopes: np.ndarray  # mean change of the fractions with column, row and width, (3, n_pixels)
    grid: np.ndarray  # column and row of each pixel, (n_pixels, 2)

    def columns(self, share, use):
        """Return groups of columns that explain the flux, by name, learned from cadences in use.

        Where the star's ``share`` of the light, ``(ny, nx)``, differs from pixel to pixel, the
        misfit follows a star that dims, by the difference of its image and that of all light, and
        with coefficients of about one the flux does. Units make this no more than an image's error.
        """
        share = share[*self.grid.T[::-1]]
        size = np.maximum(self.position[use].std(axis=0), 1e-12)
        # in units of its size, a focus that hardly changes would explain the star's variability
        focus, image = self.focus[:, None], self.still.mean(axis=0)
        change = np.linalg.norm(image * share / (image @ share) - image)
        # beyond predictions; weights of least squares follow a star that moves
        misfit = np.column_stack([self.misfit, self.level, self.weighted])
        return {
            "focus": np.concatenate([focus, focus * self.position / size], axis=1),
            "aperture": -np.log(np.maximum(1 + self.outside, LEAST_LIGHT))[:, None],
            "misfit": misfit * IMAGE_ERROR / np.hypot(IMAGE_ERROR, change),
        }

    def leaks(self):
        """Return the states by name, and what a standard deviation of three adds to fractions."""
        background = np.mean(self.background, axis=1)
        states = {
            "Column (pixel)": self.position[:, 0],
            "Row (pixel)": self.position[:, 1],
            "Relative width": np.round(self.focus - np.median(self.focus), 12),
            "Background (e-/s)": background - np.median(background),
        }
        moving = zip(list(states)[:3], self.slopes, strict=True)
        return states, {name: np.std(states[name]) * slope for name, slope in moving}


@dataclass(frozen=True, eq=False)
class _Shape:
    """Coefficients of the images, which all cadences share."""

    main: np.ndarray  # of the functions of position, (rank, n_pixels)
    changes: dict  # of the coarse functions, by the names of `_CHANGES`; empty at first
    sizes: dict  # their standard deviations, as in `_CHANGES`
    flow: float = 1.0  # the flow that the width's images are expected to be, in units of the focus
    error: np.ndarray | float = 0.0  # of the mean of N, (n_pixels,)
    doubt: np.ndarray | float = 0.0  # variance of the model's light, (n, n_pixels)


@dataclass(frozen=True, eq=False)
class _Images:
    """Images of unit light at the positions of a fit."""

    still: np.ndarray  # at the typical width, (n, n_pixels)
    whole: np.ndarray  # with the width of each cadence
    slopes: list  # derivatives by x, y and width
    constant: np.ndarray | float  # N
    wider: np.ndarray  # what flows into pixels as the PSF widens, (n, n_pixels)


def fit_star(time, flux, flux_err, position, grid, aperture, *, use=None, banded=None,
             full=None):  # fmt: skip
    """Predict the pixel fractions of a star.

    Times are in days, ``flux`` and ``flux_err`` in e-/s, ``(n, n_pixels)``, of pixels with data at
    columns and rows of a ``grid``, ``(n_pixels, 2)``; ``position`` is POS_CORR in px, ``(n, 2)``,
    NaN where unknown. What cadences share is learned from those in ``use``, by default all;
    ``banded`` ones have waves in the background along the rows. Charge has bled in columns that are
    ``full``. Return a `StarModel`; None if there are more places than so few cadences show.
    """
    stamp, states = make_stamp(time, flux, flux_err, position, grid, aperture, use, banded, full)
    _, basis, coarse = stamp.functions(states.position)
    if basis.shape[1] + 2 * coarse.shape[1] > _MOST_OWN * stamp.use.sum():
        return None
    states, shape, images = _by_turns(stamp, states, _Shape(np.empty(0), {}, _CHANGES))
    if states.variable.any() and not _constant_light(stamp, images, shape.error):
        # none is seen, and there is none but for a trace that positions must not follow
        states, shape, images = _by_turns(stamp, states, shape, images, alone=True)
    return _result(stamp, states, images, flux_err, shape.error)


def _by_turns(stamp, states, shape, images=None, *, alone=False):
    """Fit images and cadences by turns, a star ``alone`` without constant light."""
    for _ in range(_MOST_STEPS):
        before, functions = states, stamp.functions(states.position)
        shape = _fit_shape(stamp, states, shape, images, functions, alone=alone)
        images = _images(stamp, states, shape, functions)
        if shape.changes:
            states, shape, images = _with_unit(stamp, states, shape, images)
        states, errors = _fit_states(stamp, states, shape, images, functions)
        moved = np.abs(states.courses - before.courses) / errors
        if shape.changes and (quantile(moved[:, stamp.use]) < SMALL_STEP).all():
            break
    return states, shape, _images(stamp, states, shape, stamp.functions(states.position))


def _fit_shape(stamp, states, shape, images, functions, *, alone=False):
    """Fit the functions of position of all pixels at once: ridge regression.

    Those of the width are expected to be what flows into the pixels as the PSF widens.
    """
    _, basis, coarse = functions
    a, w = states.brightness[:, None], states.focus[:, None]
    rest, parts, sizes = stamp.light - states.plane @ stamp.planes.T, {}, dict(shape.sizes)
    if images is not None:
        rest -= a * w * images.wider
        parts = {"width": a * w * coarse, "squared": a * w**2 * coarse}
    if states.variable.any() and not alone:
        parts["constant"] = -states.variable[:, None] * coarse
    columns = [a * basis, *(sizes[name] * part for name, part in parts.items())]
    first = np.cumsum([0, *(part.shape[1] for part in columns)])
    columns = np.concatenate(columns, axis=1)
    weight = np.minimum(CLIP / states.noisy, 1.0)  # Huber's
    seen = np.where((stamp.use & states.good.all(axis=1))[:, None], weight * columns, 0)
    values, vectors = np.linalg.eigh(seen.T @ columns)
    right = vectors.T @ (seen.T @ rest)
    variance = states.variance[stamp.use].mean(axis=0)
    ridge = variance / stamp.scale**2
    inverse = 1 / (np.maximum(values, 0)[:, None] + ridge)
    coefficients = vectors @ (right * inverse)
    changes, error = {}, 0.0
    for name, start, end in zip(parts, first[1:], first[2:], strict=False):
        rows, size = slice(start, end), sizes[name]
        changes[name] = size * coefficients[rows]
        if name == "constant":  # the width has no unit but that of its prior
            free = np.sum(1 - vectors[rows] ** 2 @ (ridge * inverse))
            square = np.sum((coefficients[rows] / stamp.scale) ** 2)
            sizes[name] = size * np.sqrt((square + 1e-12) / (free + 1e-12))
            mean = size * coarse[stamp.use].mean(axis=0) @ vectors[rows]
            error = np.sqrt(variance * (mean**2 @ inverse))
    doubt = (columns @ vectors) ** 2 @ (variance * inverse)
    return _Shape(coefficients[: first[1]], changes, sizes, error=error, doubt=doubt)


def _images(stamp, states, shape, functions):
    """Return the `_Images` of a shape; sums over the aperture are as stated."""
    inside, weights = stamp.aperture, stamp.features.weights(shape.main)
    kernel, _, coarse = functions
    total = (kernel @ weights[:, inside].sum(axis=1))[:, None]
    kernel = kernel / total
    image, few = kernel @ weights, coarse / total

    def without_sum(columns, coefficients):
        """Return images whose sum over the aperture is taken off in the shape of the star."""
        values = columns @ coefficients
        values -= (columns @ coefficients[:, inside].sum(axis=1))[:, None] * image
        return values

    # multiples of the image drop out with the sums
    slopes = [without_sum(kernel, moved) for moved in stamp.features.slope_weights(weights)]
    whole, changes, constant, w = image.copy(), shape.changes, 0.0, states.focus[:, None]
    if "constant" in changes:
        constant = without_sum(coarse, changes["constant"])
    wider = stamp.flow.wider(image, stamp.center + states.position)
    if "width" in changes:
        by_width = shape.flow * wider + without_sum(few, changes["width"])
        squared = without_sum(few, changes["squared"])
        whole += w * by_width + w**2 * squared
        slopes.append(by_width + 2 * w * squared)
    else:  # motion that is not beyond the errors of POS_CORR shows no slopes
        size = states.position[stamp.use].var(axis=0)
        shown = size / (size + POSITION_PRIOR**2)
        pairs = zip(shown, slopes, stamp.flow.moved(image), strict=True)
        slopes = [part * slope + (1 - part) * flow for part, slope, flow in pairs] + [wider]
    return _Images(image, whole, slopes, constant, wider)


def _with_unit(stamp, states, shape, images):
    """Give the focus the unit of a relative width, of which the flow into the pixels is known."""
    fitted, wider = (each[stamp.use].mean(axis=0) for each in (images.slopes[2], images.wider))
    # in the wings the flow is less certain
    weight = np.abs(wider) / np.sqrt(states.variance[stamp.use].mean(axis=0))
    size = np.sum(weight * fitted * wider) / np.sum(weight * wider**2)
    size, slopes = np.clip(size, 1 / _UNIT, _UNIT), images.slopes
    orders = {"width": 1, "squared": 2}
    changes = {name: part / size ** orders.get(name, 0) for name, part in shape.changes.items()}
    shape = replace(shape, changes=changes, flow=shape.flow / size)
    images = replace(images, slopes=[*slopes[:2], slopes[2] / size])
    return replace(states, focus=size * states.focus), shape, images


def _rest(stamp, states, images):
    """Return what images and background leave of the light."""
    rest = stamp.light - states.plane @ stamp.planes.T + states.variable[:, None] * images.constant
    return rest - states.brightness[:, None] * images.whole


def _fit_states(stamp, states, shape, images, functions):
    """Improve brightness, background, position and focus of each cadence: one linear step.

    The focus has a smooth course. Return the states, and the errors of brightness, positions and
    focus (of its course, at least of a mean of 6.5 h: what is less changes no light).
    """
    late = "width" in shape.changes
    rest, use = _rest(stamp, states, images), stamp.use
    excess = quantile(((1.4826 * rest) ** 2 - stamp.noise)[use].T)
    states = replace(states, variance=stamp.noise + np.maximum(excess, 0.0) + shape.doubt)
    noise = np.sqrt(states.variance)
    if late:
        states, noise = _without_hits(stamp, states, images, rest, noise)
    hessian, right = _normal_equations(stamp, states, images, rest, noise)
    level = np.abs(states.plane[use, 0] - stamp.base[0])
    tilt = max(1.4826 * quantile(level) + abs(stamp.base[0]), 1e-9)
    tilt, flat = np.maximum(stamp.waves, tilt) ** -2.0, np.maximum(stamp.waves, 1e-9) ** -2.0
    # a cadence may have outliers in all pixels: steps are of the size of the star's light
    weight, distance = np.ones_like(right), np.zeros_like(right)
    weight[1:3] = np.where(stamp.known, POSITION_PRIOR, 1 + np.ptp(stamp.grid)) ** -2.0
    distance[1:3] = (stamp.expected - states.position).T
    weight[3], distance[3] = _WIDTH_PRIOR**-2, -states.focus
    weight[5:7], weight[7:] = tilt, flat
    distance[5:] = (stamp.base - states.plane).T[1:]
    hessian[np.diag_indices(len(right))] += weight
    right += weight * distance
    change, factor = _solved(hessian, right)
    change[:4] = np.clip(change[:4], -_LARGEST, _LARGEST)
    error = np.sqrt(np.einsum("jin,jin->in", factor, factor))
    by_focus = np.einsum("jin,jn->in", factor, factor[:, 3]) / error[3] ** 2
    brightness, position = states.brightness + change[0], states.position + change[1:3].T
    plane, variable = states.plane + change[4:].T, states.variable
    if late:
        variable = _variable(stamp, functions[1], brightness)
    position = _on_scale(stamp, position, variable)
    focus = states.focus + change[3]
    found = _without_other_causes(stamp, focus, error[3], position, variable, states)
    focus, smooth = stamp.smoothed(found, error[3], "focus")
    error[3] = np.maximum(smooth, error[3] * np.sqrt(stamp.smoothed.step / TRANSIT))
    shift = np.where(use, by_focus * (focus - found), 0.0)  # elsewhere the course is a guess
    shift[:4] = np.clip(shift[:4], -_LARGEST, _LARGEST)
    brightness += shift[0]
    position += shift[1:3].T
    plane += shift[4:].T
    plane, level = _background(stamp, plane, error[4:].T, late=late)
    states = replace(
        states, brightness=brightness, position=position, focus=focus, variable=variable,
        plane=plane, level=level,
    )  # fmt: skip
    return states, error[:4]


def _without_hits(stamp, states, images, rest, noise):
    """Return the states without cosmic rays, and the noise of each pixel.

    Cosmic rays exceed the model in one cadence only, by more than other pixels fall short of it.
    Where these do so by more than noise can, as in a jump within an exposure, the noise of all
    pixels is as large. Cadences not in use have no influence on others.
    """
    beside = [[1], [0], [1]]
    error = noise + MISFIT * (np.abs(images.whole) + IMAGE_ERROR)
    size, use = rest / error, stamp.use[:, None]
    missing = np.sqrt(np.sum(np.where(size < -CLIP, size, 0.0) ** 2, axis=1, keepdims=True))
    hot = size > np.maximum(missing, CLIP)
    before_or_after = np.where(
        use, ndimage.binary_dilation(hot & use, beside), ndimage.binary_dilation(hot, beside)
    )
    good, poor = ~hot | before_or_after, missing > CLIP
    states = replace(states, good=good, noisy=np.where(poor, missing, 1.0))
    return states, np.where(poor, missing * error, noise)


def _normal_equations(stamp, states, images, rest, noise):
    """Return the Hessian and the right side of each cadence's least squares, ``(k, k, n)``.

    The parameters are brightness, position, focus and the background's.
    """
    root = np.where(states.good, 1 / noise, 0.0)
    parts = [values * root for values in (images.whole, *images.slopes)]
    first, rest = len(parts), rest * root
    parts += [term * root for term in stamp.planes.T]
    hessian = np.zeros((len(parts), len(parts), len(rest)))
    for i, values in enumerate(parts):
        for j in range(i + 1):
            hessian[i, j] = np.einsum("ij,ij->i", values, parts[j])
    right = np.array([np.einsum("ij,ij->i", values, rest) for values in parts])
    hessian[1:first] *= states.brightness
    hessian[:, 1:first] *= states.brightness
    right[1:first] *= states.brightness
    return hessian, right


def _background(stamp, plane, errors, *, late):
    """Return the background, if ``late`` smooth but for jumps and bands, and what was not so."""
    plane = plane - quantile(plane[stamp.use].T) + stamp.base
    level = plane[:, 0].copy()
    if late:
        for k, (values, error) in enumerate(zip(plane.T[:3], errors.T[:3], strict=True)):
            smooth = stamp.smoothed(values, error, f"background {k}")[0]
            rest = np.abs(values - smooth)
            typical = 1.4826 * quantile(rest[stamp.use])
            jumps = rest > CLIP * np.maximum(error, typical)
            values[:] = np.where(jumps | stamp.banded, values, smooth)
    return plane, level - plane[:, 0]


def _variable(stamp, columns, brightness):
    """Return the star's own variability if it is strong: no function of position; else zeros.

    The ``columns`` are functions of position. Slow changes are no measure of constant light, for
    focus and drifts are as slow.
    """
    use = stamp.use
    variable = change = brightness - 1
    lag = round(TRANSIT / quantile(np.diff(stamp.time[use])))
    lag = int(np.clip(lag, 2, use.sum() // 2))  # nights are short

    def changes(values):
        return values[use][lag:] - values[use][:-lag]

    # the response to position is learned from fast changes, for slow ones may be the star's
    fast, right = changes(columns), changes(change)
    for _ in range(3):
        noise = np.mean(changes(variable) ** 2) / 2
        gram = fast.T @ fast + noise / RESPONSE_PRIOR**2 * np.eye(fast.shape[1])
        variable = change - columns @ np.linalg.solve(gram, fast.T @ right)
    jumps = np.mean(np.diff(variable[use]) ** 2)
    strong = np.mean(changes(variable) ** 2) - jumps > 2 * _STRONG**2
    return variable if strong else np.zeros_like(variable)


def _on_scale(stamp, position, variable):
    """Bring positions back to the scale of POS_CORR, without what follows the brightness."""
    known = use = stamp.known & stamp.use
    columns = np.column_stack([position, np.ones(len(position)), variable])
    # toward no change where POS_CORR is unknown
    weight = POSITION_PRIOR**2 * np.diag([1.0, 1.0, 0.0, 1.0])
    change = np.zeros((4, 2))
    for _ in range(3):
        gram = columns[use].T @ columns[use] + weight
        gram[2, 2] += 1e-9
        change = np.linalg.solve(gram, columns[use].T @ (stamp.expected - position)[use])
        rest = stamp.expected - position - columns @ change
        use = known & (np.abs(rest).max(axis=1) < CLIP * POSITION_PRIOR)
    return position + columns @ change


def _without_other_causes(stamp, focus, error, position, variable, states):
    """Return the focus without what positions and brightness explain.

    A width that follows the position may as well be in the images. Of all courses that differ by
    this, the most likely one is taken, of a random walk with the changes that the focus had before
    and noise: a slow drift of both is no reason why the focus should follow the roll.
    """
    use = stamp.use
    count, weight = use.sum(), states.noisy[use, 0] ** -2
    walk = max(np.mean(np.diff(states.focus[use]) ** 2), 1e-300)
    ratio = min(quantile(error[use]) ** 2 / walk, count**2)  # what walks less does not walk
    bands = np.full((2, count), -ratio)
    bands[1] = weight + 2 * ratio
    bands[1, [0, -1]] -= ratio
    columns = weight[:, None] * np.column_stack([position, focus])[use]
    columns -= weight[:, None] * solveh_banded(bands, columns)
    causes = np.linalg.lstsq(position[use].T @ columns[:, :2], position[use].T @ columns[:, 2])[0]
    focus = focus - position @ causes
    columns = np.column_stack([np.ones(len(focus)), variable])
    return focus - columns @ np.linalg.lstsq(columns[use], focus[use], rcond=None)[0]


def _kept(stamp, states, images, focus):
    """Return the light that the aperture would hold at constant focus, over what it holds."""
    outside = ~stamp.aperture
    lost = focus * stamp.flow.lost(images.still, stamp.center + states.position)
    whole = np.maximum(1 + images.still @ outside, LEAST_LIGHT)
    moved = focus * (images.slopes[2] @ outside)
    return np.maximum(whole + moved, LEAST_LIGHT) / np.maximum(whole - lost, LEAST_LIGHT)


def _constant_light(stamp, images, error):
    """Return the least part of the light that is constant.

    N is this part times the difference of its image and the star's. Both add up to 1, so that
    absolute values of the difference add up to 2 at most, less what errors add to them.
    """
    constant = np.broadcast_to(images.constant, images.whole.shape)[stamp.use].mean(axis=0)
    size = np.abs(constant) - np.hypot(IMAGE_ERROR, error)
    return max(float(size[stamp.aperture].sum() / 2), 0.0)


def _result(stamp, states, images, flux_err, image_error):
    """Return the `StarModel` of states and images."""
    inside = stamp.aperture
    drawn = stamp.columns.drawn
    slopes = np.array([slope[stamp.use].mean(axis=0) for slope in images.slopes])
    mean = images.still[stamp.use].mean(axis=0)[None]
    kept = _kept(stamp, states, images, states.focus)
    rest = np.where(states.good & inside, _rest(stamp, states, images), 0.0)
    more = rest.sum(axis=1)
    light = states.brightness + more
    level = states.level * stamp.planes[inside, 0].sum()
    whole = np.where(inside, images.whole, 0.0)
    rest -= more[:, None] * whole
    weights = whole / states.variance
    variance = stamp.columns.summed(flux_err**2)[:, inside].sum(axis=1)
    return StarModel(
        light=stamp.unit * light * kept,
        light_error=np.sqrt(variance) * kept,
        shares=drawn(whole) / kept[:, None],
        still=drawn(whole),
        outside=images.still @ ~inside,
        background=stamp.unit * (states.plane @ stamp.terms.T),
        position=states.position,
        variable=states.variable,
        focus=states.focus,
        constant=_constant_light(stamp, images, image_error),
        misfit=drawn(rest / light[:, None], mean),
        level=level / light,
        weighted=np.sum(weights * rest, axis=1) / np.sum(weights * whole, axis=1) / light,
        repaired=drawn(~states.good, mean) > 0,
        slopes=drawn(np.where(inside, slopes, 0.0), mean),
        grid=stamp.columns.grid,
    )


def _solved(hessian, right):
    """Solve many small systems at once by Cholesky factors.

    Of the Hessian ``(k, k, n)`` the lower triangle is used; the right side is ``(k, n)``. Return
    the solution and the inverse of the lower factor, ``(k, k, n)``.
    """
    inverse = np.zeros_like(hessian)  # of the factor
    for i in range(len(right)):
        row = np.einsum("jkn,kn->jn", inverse[:i, :i], hessian[i, :i])
        pivot = (1 + 1e-9) * hessian[i, i] - np.einsum("jn,jn->n", row, row)
        inverse[i, i] = 1 / np.sqrt(np.maximum(pivot, 1e-30))
        inverse[i, :i] = -inverse[i, i] * np.einsum("jn,jkn->kn", row, inverse[:i, :i])
    return np.einsum("jin,jn->in", inverse, np.einsum("ijn,jn->in", inverse, right)), inverse
