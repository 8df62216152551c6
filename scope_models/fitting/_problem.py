"""The joint model of all pixels and cadences: residuals, normal equations, priors."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag, null_space

from scope_models._checks import check_fields, checked_choice, checked_number, integer, number
from scope_models._values import Value
from scope_models.models.integration import numbers_of

__all__ = [
    "LARGEST_MOVE", "MEDIAN_SQUARE", "UNTRUE", "FitOptions", "FitStar", "NormalEquations",
    "Problem", "Settings", "State", "fit_parameters", "median_image",
]  # fmt: skip

# Cadences whose derivatives are held at once.
_CHUNK = 256
# Mean squared residual from which errors are scaled, change of scale that is none, and chance, in
# standard deviations of the mean.
UNTRUE, _SAME, _CHANCE = 1.5, 0.02, 3.0
# Median of the square of a standard normal deviate.
MEDIAN_SQUARE = 0.4549364
# Relative standard deviations before the fit: of the PSF's width, and of the motion about that of
# POS_CORR and of the first file.
_FOCUS_PRIOR, _SCALE_PRIOR, _MAP_PRIOR = 0.05, 0.02, 0.3
# Standard deviation of positions that are a map of POS_CORR, pixels: a tenth of the photon noise of
# a centroid at Kp 9 (0.6 px / sqrt(4e9 electrons)).
_PATH_ERROR = 1e-6
# Largest step of a position or shape, and way of a star from its first guess beside the first star,
# whose guesses err by 1 px each, pixels.
LARGEST_MOVE, _STAR_MOVE = 0.3, 2**0.5
# Narrower PSFs are the same to a pixel, tighter correlations only cost time, and charge that
# diffuses farther is not collected in pixels.
_LEAST_WIDTH = 0.1
_LIMITS = {"correlation": (-0.95, 0.95), "diffusion": (0.0, 1.0), "offset": (-2.0, 2.0)}
# Standard deviations of coefficients of an empirical term, whose first is 1, and of a correction.
_PRIORS = {"coefficient": 10.0, "correction": 0.1}


def _choice(*choices):
    return field(default=choices[0], metadata={"check": checked_choice, "choices": choices})


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FitOptions(Value):
    """Options of `~scope_models.fit_tpf` that few fits need.

    Parameters
    ----------
    background : {"cadence", "constant", "none"}, optional
        Background left in the pixels.
    focus : float or `~astropy.units.Quantity`, optional
        Shortest time, days, in which the width of the PSF changes: all distances from the star
        scale, to first order, with a cubic spline of time of mean 1 and with a prior of 5 %. None:
        the width is constant.
    loss : {"linear", "soft_l1"}, optional
        Least squares, or linear growth above ``loss_scale``, for data with cosmic rays.
    loss_scale : float, optional
        In standard deviations.
    max_steps : int, optional
        Largest number of steps of each stage.
    neighbor_flux : {"auto", "cadence", "constant"}, optional
        Whether other stars have a flux in each cadence, or one for all; "auto": one below a tenth
        of the target.
    position_error : float or `~astropy.units.Quantity`, optional
        Standard deviation about the path, pixels, for ``positions="prior"``.
    saturation : bool, optional
        Whether columns with pixels near the depth of their wells are left out.

    Raises
    ------
    TypeError, ValueError
        If a value is of the wrong kind, or outside its domain.

    Examples
    --------
    >>> from scope_models.fitting import FitOptions
    >>> FitOptions(loss="soft_l1").loss_scale
    3.0
    """

    background: str = _choice("cadence", "constant", "none")
    focus: float | None = number(None, "d", positive=True)
    loss: str = _choice("linear", "soft_l1")
    loss_scale: float = number(3.0, positive=True)
    max_steps: int = integer(200, 1)
    neighbor_flux: str = _choice("auto", "cadence", "constant")
    position_error: float = number(0.01, "pix", positive=True)
    saturation: bool = True

    def __post_init__(self):
        check_fields(self)
        if not isinstance(self.saturation, bool | np.bool_):
            raise TypeError(f"`saturation` must be True or False, got {self.saturation!r}")


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Settings(FitOptions):
    empirical: int = integer(0, 0)
    interpixel: float  # 0 fixes the response at 1, infinity means no prior
    positions: str = _choice("free", "start", "prior", "path")
    scale_error: float = _SCALE_PRIOR  # of the path

    def __post_init__(self):
        super().__post_init__()
        if self.interpixel != np.inf:
            object.__setattr__(self, "interpixel", checked_number("interpixel", self.interpixel))


@dataclass(frozen=True)
class FitParameter:
    name: str
    kind: str  # as in `PRF.parameter_kinds`, or position, slope, flux, focus
    lower: float = -np.inf
    upper: float = np.inf
    largest_step: float = np.inf
    relative: bool = False  # whether that is a part of its value
    prior: float = np.inf  # standard deviation before the fit
    center: float = 0.0  # ... and mean
    start: float = 0.0


def fit_parameters(prf, shape):
    """Return the free shared parameters of a PRF on an image, without flux and position.

    Kinds narrow bounds: a component wider than half the stamp is background, and no term of a
    response takes away all of it at a pixel's edge, or doubles it.
    """
    numbers, result = numbers_of(prf), []
    for name in prf.param_names[3:]:
        parameter, kind = getattr(prf, name), prf.parameter_kinds.get(name, "other")
        if parameter.fixed:
            continue
        lower, upper = _LIMITS.get(kind, (-np.inf, np.inf))
        if kind == "width":
            lower, upper = _LEAST_WIDTH, max(shape) / 2
        elif kind == "response":
            upper = 2.0 ** prf.response_powers[name][1]
            lower = -upper
        low, high = parameter.bounds
        lower = lower if low is None else max(low, lower)
        upper = upper if high is None else min(high, upper)
        relative = kind == "width" or (kind == "other" and lower > 0)
        moves = relative or kind in {"correlation", "fraction", "offset", "diffusion"}
        step, prior = LARGEST_MOVE if moves else np.inf, _PRIORS.get(kind, np.inf)
        given = lower, upper, step, relative, prior
        result.append(FitParameter(name, kind, *given, start=numbers[name]))
    return tuple(result)


@dataclass(frozen=True)
class FitStar:
    """A star of a fit: its first guess in pixels of its stamp, less that of the first star."""

    x: float
    y: float
    stamp: int  # which file it is in
    constant: bool = False  # whether its flux is the same in all cadences


@dataclass(frozen=True, eq=False)
class State:
    shared: np.ndarray  # (s,): what `Problem.parameters` lists
    interpixel: np.ndarray  # (p,): response of each fitted pixel less 1
    cadence: np.ndarray  # (n, k): what `Problem.columns` names

    def column(self, number):
        """Values by cadence, ``(n,)``, of a number of `Problem.numbers`."""
        n, k = self.cadence.shape
        return self.cadence[:, number] if number < k else np.full(n, self.shared[number - k])


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Second-order expansion of half the cost: ``cost/2 - g d + d H d / 2``."""

    cost: float  # chi-squared, with the loss, and the priors
    shared: np.ndarray  # (m, m): block of shared parameters and interpixel map
    shared_gradient: np.ndarray
    mixed: np.ndarray  # (n, k, m): cadence by shared
    cadence: np.ndarray  # (n, k, k): blocks of the cadences
    cadence_gradient: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem:
    stamps: tuple  # PixelData of each file, in the same cadences
    prf: object  # its parameters hold starts, bounds and fixed values
    options: Settings
    stars: tuple  # the first one without offsets
    span: tuple  # first and last time of the focus, days
    center: tuple  # where the linear map to other files has the first star
    places: tuple  # of the first star, None for the brightest, and of others in its file
    error_scale: float = 1.0  # factor of all errors in the fit
    misfit: float = 1.0  # ... of the errors that are quoted

    @property
    def data(self):
        return self.stamps[0]

    def _joined(self, name):
        """The fitted pixels of all files, ``(n, p)``; NaN where there are no data."""
        return np.concatenate([getattr(s, name)[:, s.pixels] for s in self.stamps], axis=1)

    @cached_property
    def flux(self):
        """Fluxes of the fitted pixels, ``(n, p)``, 0 where there are none."""
        return np.nan_to_num(self._joined("flux"))

    @cached_property
    def _given_weight(self):
        return np.nan_to_num(1 / self._joined("flux_err"))

    @cached_property
    def weight(self):
        return self._given_weight / self.error_scale

    @cached_property
    def slices(self):
        ends = [0, *np.cumsum([s.pixels.sum() for s in self.stamps]).tolist()]
        return [slice(start, end) for start, end in pairwise(ends)]

    @property
    def n_data(self):
        return int(np.count_nonzero(self._given_weight))

    @property
    def n_free(self):
        n_own = len(self.columns) - 2 * (self.options.positions == "path")
        return self.n_shared + max(self.n_pixels - 1, 0) + len(self.flux) * n_own

    @property
    def dof(self):
        return max(self.n_data - self.n_free, 1)

    @cached_property
    def basis(self):
        """What the path is linear in, ``(n, 3)``."""
        offsets = self.data.pos_corr - np.median(self.data.pos_corr, axis=0)
        return np.column_stack([np.ones(len(offsets)), offsets])

    @cached_property
    def focus_basis(self):
        """Cubic splines of time that add up to the relative width, ``(n, k)``."""
        if self.options.focus is None:
            return np.zeros((len(self.flux), 0))
        first, last = self.span
        inner = np.linspace(first, last, max(1, int((last - first) / self.options.focus)) + 1)
        knots = np.concatenate([[first] * 3, inner, [last] * 3])
        return BSpline.design_matrix(self.data.time, knots, 3).toarray()

    @cached_property
    def free_shared(self):
        """Directions of the shared parameters that keep the mean of the focus, the last ones."""
        n, mean = self.focus_basis.shape[1], self.focus_basis.mean(axis=0)
        return block_diag(np.eye(self.n_shared - n), null_space(mean[None]) if n else np.eye(0))

    def focus(self, state):
        """Relative width of the PSF less 1, ``(n,)``."""
        return self.focus_basis @ state.shared[self.n_shared - self.focus_basis.shape[1] :]

    @property
    def position_error(self):
        """Error of positions by POS_CORR, pixels: a number, by cadence and axis, or None."""
        if self.data.pos_err is not None:
            return np.maximum(self.data.pos_err, _PATH_ERROR)
        errors = {"path": _PATH_ERROR, "prior": self.options.position_error}
        return errors.get(self.options.positions)

    @property
    def n_pixels(self):
        return self.slices[-1].stop if self.options.interpixel else 0

    @cached_property
    def _of_shape(self):
        return fit_parameters(self.prf, np.max([s.shape for s in self.stamps], axis=0))

    @property
    def affine(self):
        return slice(len(self._of_shape), len(self._of_shape) + 6)

    @cached_property
    def parameters(self):
        result = [*self._of_shape]
        for i, axis in enumerate("xy" if self.position_error is not None else ()):
            result.append(FitParameter(f"{axis}_const", "position"))
            for j in (0, 1):
                prior = {"prior": self.options.scale_error, "center": float(i == j)}
                result.append(FitParameter(f"{axis}_by_corr{j + 1}", "slope", **prior))
        for i in range(1, len(self.stamps)):
            for axis, of in ("xx", "xy", "yx", "yy"):
                prior = {"prior": _MAP_PRIOR, "center": axis == of, "start": float(axis == of)}
                result.append(FitParameter(f"{axis}_by_{of}_{i}", "slope", **prior))
        for k, star in enumerate(self.stars[1:], start=1):
            for axis, start in (("x", star.x), ("y", star.y)):
                reach = start - _STAR_MOVE, start + _STAR_MOVE, LARGEST_MOVE
                result.append(FitParameter(f"{axis}_star_{k}", "position", *reach, start=start))
        names = [_flux_of(k) for k, star in enumerate(self.stars) if star.constant]
        if self.options.background == "constant":
            names += map(_background_of, range(len(self.stamps)))
        result += [FitParameter(name, "flux") for name in names]
        n_focus = self.focus_basis.shape[1]
        result += [FitParameter(f"focus_{i}", "focus", prior=_FOCUS_PRIOR) for i in range(n_focus)]
        return tuple(result)

    @property
    def n_shared(self):
        return len(self.parameters)

    @cached_property
    def columns(self):
        fluxes = (_flux_of(k) for k, star in enumerate(self.stars) if not star.constant)
        number = len(self.stamps) if self.options.background == "cadence" else 0
        return ("x", "y", *fluxes, *map(_background_of, range(number)))

    @cached_property
    def numbers(self):
        """Numbers of the parameters by name: those of a cadence come first, then shared ones."""
        names = (*self.columns, *(p.name for p in self.parameters))
        return {name: i for i, name in enumerate(names)}

    def flux_number(self, star):
        return self.numbers[_flux_of(star)]

    def background_number(self, stamp):
        """Number of a file's background, None without one."""
        return self.numbers.get(_background_of(stamp))

    @cached_property
    def bounds(self):
        return np.array([(p.lower, p.upper) for p in self.parameters]).reshape(-1, 2).T

    def at_bounds(self, state):
        return (state.shared <= self.bounds[0]) | (state.shared >= self.bounds[1])

    @cached_property
    def free_response(self):
        """Directions of the response between pixels that keep its mean, ``(p, p - 1)``."""
        return null_space(self._light_parts[None]) if self.n_pixels else np.zeros((0, 0))

    @cached_property
    def _light_parts(self):
        """Parts of the light in the fitted pixels, of sum 1, ``(p,)``."""
        light = np.maximum(median_image(self._joined("flux")), 0.0)
        light = light if light.any() else np.ones(len(light))
        return light / light.sum()

    def rescaled(self, state):
        """Return the problem with errors scaled to the residuals where the model is not true."""
        squares = (self._given_weight * (self.flux - self.model(state))) ** 2
        squares[self._given_weight == 0] = np.nan
        # Medians: neither cosmic rays nor single bad pixels count.
        seen = np.any(self._given_weight, axis=0)
        typical = np.median(np.nanmedian(squares[:, seen], axis=0)) / MEDIAN_SQUARE
        # Most parameters hang on the pixels with light, most pixels have none.
        light = self._light_parts
        n_light = 1 / np.sum(light**2)
        lit = np.sum(light * ~np.isnan(squares), axis=1)
        weighted = np.nansum(squares * light, axis=1)[lit > 0] / lit[lit > 0]
        bright = np.median(weighted) / (1 - 2 / (9 * n_light)) ** 3
        by_chance = _CHANCE * np.sqrt(2 / (n_light * len(squares)))
        lost = self.n_data / self.dof
        typical, bright = lost * typical, lost * bright
        untrue = typical > UNTRUE or bright > UNTRUE + by_chance
        misfit = scale = float(np.sqrt(max(typical, bright))) if untrue else 1.0
        if self.options.loss == "soft_l1":
            # With larger errors cosmic rays in dark pixels would not be outliers.
            scale = float(np.sqrt(typical)) if typical > UNTRUE else 1.0
        same = max(abs(scale / self.error_scale - 1), abs(misfit / self.misfit - 1)) <= _SAME
        return self if same else replace(self, error_scale=scale, misfit=misfit)

    def values(self, state):
        return {p.name: float(v) for p, v in zip(self._of_shape, state.shared, strict=False)}

    def _map(self, state, stamp):
        """How a file moves with the first one, ``(2, 2)``."""
        if not stamp:
            return np.eye(2)
        first = self.numbers[f"x_by_x_{stamp}"] - len(self.columns)
        return state.shared[first : first + 4].reshape(2, 2)

    def xy(self, state, star=0):
        """Positions of a star in its stamp, ``(n, 2)``."""
        if star == 0:
            return state.cadence[:, :2]
        moved = (state.cadence[:, :2] - self.center) @ self._map(state, self.stars[star].stamp).T
        first = self.numbers[f"x_star_{star}"] - len(self.columns)
        return moved + self.center + state.shared[first : first + 2]

    def position_terms(self, state, star):
        """Yield what moves a star: axis, number of a parameter, and derivative, ``(n,)``."""
        stamp, one = self.stars[star].stamp, np.ones(len(self.flux))
        moved = self.xy(state) - self.center
        for axis, (name, slopes) in enumerate(zip("xy", self._map(state, stamp), strict=True)):
            for of in (0, 1):
                if slopes[of]:
                    yield axis, of, slopes[of] * one
                if stamp:
                    yield axis, self.numbers[f"{name}_by_{'xy'[of]}_{stamp}"], moved[:, of]
            if star:
                yield axis, self.numbers[f"{name}_star_{star}"], one

    def fluxes(self, state, star=0):
        return state.column(self.flux_number(star))

    def backgrounds(self, state, stamp):
        number = self.background_number(stamp)
        return np.zeros(len(state.cadence)) if number is None else state.column(number)

    def chunks(self):
        return [slice(i, i + _CHUNK) for i in range(0, len(self.flux), _CHUNK)]

    def unit_images(self, state, part, star=0, *, derivatives=False):
        """Unit images of a star, ``(m, p)``, and derivatives by place, shape and focus."""
        stamp = self.stamps[self.stars[star].stamp]
        x, y = self.xy(state, star)[part].T
        widens = self.options.focus is not None
        values, more = self.values(state), derivatives or widens
        result = self.prf.unit_images(stamp.shape, x, y, values=values, derivatives=more)
        image, by = result if more else (result, {})
        if widens:  # all distances from the star scale
            numbers, kinds = numbers_of(self.prf) | values, self.prf.parameter_kinds
            scaled = [name for name, kind in kinds.items() if kind in {"width", "offset"}]
            by["focus"] = sum(numbers[name] * by[name] for name in scaled)
            image = image + self.focus(state)[part, None, None] * by["focus"]
        image = image[:, stamp.pixels]
        needed = ("x_0", "y_0", *values, *(("focus",) if widens else ()))
        return (image, [by[name][:, stamp.pixels] for name in needed]) if derivatives else image

    def model(self, state):
        model = np.zeros(self.flux.shape)
        for part in self.chunks():
            for k, star in enumerate(self.stars):
                flux = self.fluxes(state, k)[part, None]
                model[part, self.slices[star.stamp]] += flux * self.unit_images(state, part, k)
        if self.n_pixels:
            model *= 1 + state.interpixel
        for i, pixels in enumerate(self.slices):
            model[:, pixels] += self.backgrounds(state, i)[:, None]
        return model

    def expand(self, state):
        """Cost and its normal equations at a state."""
        n, k, s, m = *state.cadence.shape, self.n_shared, self.n_shared + self.n_pixels
        shared, gradient = np.zeros((m, m)), np.zeros(m)
        mixed, block, block_gradient = np.zeros((n, k, m)), np.zeros((n, k, k)), np.zeros((n, k))
        cost, soft = self._add_priors(state, shared, gradient), self.options.loss_scale

        def add(part, residual, design):
            own, of_all = design[:k].transpose(1, 0, 2), design[k:].reshape(s, residual.size)
            product = own @ design.transpose(1, 2, 0)
            block[part] += product[..., :k]
            mixed[part, :, :s] += product[..., k:]
            block_gradient[part] += (own @ residual[..., None])[..., 0]
            shared[:s, :s] += of_all @ of_all.T
            gradient[:s] += of_all @ residual.ravel()

        for part in self.chunks():
            residual, design, light = self._linearize(state, part)
            weight = self.weight[part]
            residual *= weight
            squares = residual**2
            if self.options.loss == "soft_l1":
                scaled = 1 + squares / soft**2
                squares = 2 * soft**2 * (np.sqrt(scaled) - 1)
                residual *= (factor := scaled**-0.25)
                weight = weight * factor
            cost += np.sum(squares)
            design *= weight
            add(part, residual, design)
            if self.n_pixels:
                light *= weight
                shared[:s, s:] += np.einsum("snp,np->sp", design[k:], light)
                shared[range(s, m), range(s, m)] += np.sum(light**2, axis=0)
                gradient[s:] += np.sum(light * residual, axis=0)
                mixed[part, :, s:] = (design[:k] * light).transpose(1, 0, 2)
        if (error := self.position_error) is not None:
            path = self.basis @ state.shared[self.affine].reshape(2, 3).T
            residual, design = path - state.cadence[:, :2], np.zeros((k + s, n, 2))
            for axis in (0, 1):
                first = k + self.affine.start + 3 * axis
                design[axis, :, axis], design[first : first + 3, :, axis] = 1, -self.basis.T
            cost += np.sum((residual / error) ** 2)
            add(slice(None), residual / error, design / error)
        shared[s:, :s] = shared[:s, s:].T
        return NormalEquations(cost, shared, gradient, mixed, block, block_gradient)

    def _linearize(self, state, part):
        """Residuals ``(m, p)``, derivatives of the model by all parameters, light of the stars."""
        residual, k = self.flux[part].copy(), len(self.columns)
        design = np.zeros((k + self.n_shared, *residual.shape))
        light = np.zeros_like(residual)
        response = 1 + (state.interpixel if self.n_pixels else np.zeros(residual.shape[1]))
        for j, star in enumerate(self.stars):
            pixels = self.slices[star.stamp]
            image, slopes = self.unit_images(state, part, j, derivatives=True)
            by, flux = design[:, :, pixels], self.fluxes(state, j)[part, None]
            light[:, pixels] += flux * image
            scale = response[pixels] * flux
            slopes = [scale * slope for slope in slopes]
            for i, slope in enumerate(slopes[2 : 2 + self.affine.start], start=k):
                by[i] += slope
            for axis, i, derivative in self.position_terms(state, j):
                by[i] += derivative[part, None] * slopes[axis]
            for i, spline in enumerate(self.focus_basis[part].T[::-1], start=1):
                by[-i] += slopes[-1] * spline[:, None]
            by[self.flux_number(j)] = response[pixels] * image
        residual -= response * light
        for i, pixels in enumerate(self.slices):
            residual[:, pixels] -= self.backgrounds(state, i)[part, None]
            if (number := self.background_number(i)) is not None:
                design[number, :, pixels] = 1.0
        return residual, design, light

    def _add_priors(self, state, shared, gradient):
        """Add priors of the shared parameters to an expansion; return their cost."""
        s, p = self.n_shared, self.n_pixels
        precision = np.array([q.prior**-2 for q in self.parameters])
        deviation = state.shared - np.array([q.center for q in self.parameters])
        shared[range(s), range(s)] += precision
        gradient[:s] -= precision * deviation
        cost = precision @ deviation**2
        if p and np.isfinite(self.options.interpixel):
            # A common factor of all pixels is the flux.
            deviation = state.interpixel - state.interpixel.mean()
            precision = self.options.interpixel**-2
            cost += precision * np.sum(deviation**2)
            shared[s:, s:] += precision * (np.eye(p) - 1 / p)
            gradient[s:] -= precision * deviation
        return cost


def median_image(cube):
    """Return the median of finite values over the first axis; 0 where there are none."""
    finite = np.isfinite(cube)
    seen, image = finite.any(axis=0), np.zeros(cube.shape[1:])
    image[seen] = np.nanmedian(np.where(finite, cube, np.nan)[:, seen], axis=0)
    return image


def _flux_of(star):
    return f"flux_star_{star}" if star else "flux"


def _background_of(file):
    return f"background_{file}" if file else "background"
