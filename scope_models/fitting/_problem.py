"""The joint model of all pixels and cadences: residuals, normal equations, priors."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from scope_models._checks import check_fields, checked_choice, checked_number, integer, number
from scope_models._values import Value
from scope_models.fitting._parameters import FitParameter, fit_parameters
from scope_models.models._parameters import numbers_of

__all__ = [
    "FitOptions",
    "FitStar",
    "Limits",
    "NormalEquations",
    "Problem",
    "Settings",
    "State",
    "numbered",
]

# Cadences whose derivatives are held at once.
_CHUNK = 256
# Mean squared residual from which the errors are scaled, and change of scale that is none.
_UNTRUE, _SAME = 1.5, 0.02
# ... and standard deviations of the light-weighted mean that are chance.
_CHANCE = 3.0
# Median of the square of a standard normal deviate.
_MEDIAN_SQUARE = 0.4549364
# Standard deviation of the relative change of the PSF's width before the fit.
_FOCUS_PRIOR = 0.05
# Standard deviation of the scale of the motion about that of POS_CORR.
_SCALE_PRIOR = 0.02
_LARGEST_MOVE = 0.3
# Standard deviation of the motion in a file about that in the first one, relative.
_MAP_PRIOR = 0.3
# How far another star may be from its first guess, pixels.
_STAR_MOVE = 1.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FitOptions(Value):
    """
    Options of `~scope_models.fit_tpf` that few fits need.

    Parameters
    ----------
    background : {"cadence", "constant", "none"}, optional
        Background left in the pixels.
    focus : float or `~astropy.units.Quantity`, optional
        Shortest time, days, in which the width of the PSF changes: all distances from the star
        scale with a cubic spline of time, with a prior of 5 %, to first order in the change.
        None: the width is constant.
    loss : {"linear", "soft_l1"}, optional
        Least squares, or a loss that grows only linearly with residuals above ``loss_scale``,
        for data with cosmic rays.
    loss_scale : float, optional
        In standard deviations.
    max_steps : int, optional
        Largest number of steps of each stage.
    neighbor_flux : {"auto", "cadence", "constant"}, optional
        Whether the other stars have a flux in each cadence, or one for all of them; "auto": one
        for stars fainter than a tenth of the target.
    position_error : float or `~astropy.units.Quantity`, optional
        Standard deviation of the positions about the path, pixels, for ``positions="prior"``.
    saturation : bool, optional
        Whether columns with pixels near the depth of their wells are left out.

    Raises
    ------
    TypeError
        If a value is of the wrong kind.
    ValueError
        If a value is outside its domain.

    Examples
    --------
    >>> from scope_models.fitting import FitOptions
    >>> FitOptions(loss="soft_l1").loss_scale
    3.0
    """

    background: str = "cadence"
    focus: float | None = number(None, "d", positive=True)
    loss: str = "linear"
    loss_scale: float = number(3.0, positive=True)
    max_steps: int = integer(200, 1)
    neighbor_flux: str = "auto"
    position_error: float = number(0.01, "pix", positive=True)
    saturation: bool = True

    def __post_init__(self):
        check_fields(self)
        checked_choice("background", self.background, ("cadence", "constant", "none"))
        checked_choice("loss", self.loss, ("linear", "soft_l1"))
        checked_choice("neighbor_flux", self.neighbor_flux, ("auto", "cadence", "constant"))

    @property
    def soft(self):
        """Scale of the robust loss, or None."""
        return self.loss_scale if self.loss == "soft_l1" else None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Settings(FitOptions):
    """All options of a fit, as `~scope_models.fit_tpf` describes them."""

    empirical: int = integer(0, 0)
    interpixel: float = 0.01  # 0 fixes the response at 1, infinity is no prior
    positions: str = "start"
    scale_error: float = _SCALE_PRIOR  # of the path about that of POS_CORR

    def __post_init__(self):
        super().__post_init__()
        checked_choice("positions", self.positions, ("free", "start", "prior", "path"))
        if self.interpixel != np.inf:
            object.__setattr__(self, "interpixel", checked_number("interpixel", self.interpixel))


@dataclass(frozen=True)
class FitStar:
    """A star of a fit: its first guess in pixels of its stamp, less that of the first star."""

    x: float = 0.0
    y: float = 0.0
    stamp: int = 0  # which file it is in
    constant: bool = False  # whether its flux is the same in all cadences


@dataclass(frozen=True, eq=False)
class State:
    """Values of all free parameters."""

    shared: np.ndarray  # (s,): what `Problem.parameters` lists
    interpixel: np.ndarray  # (p,): response of each fitted pixel less 1
    cadence: np.ndarray  # (n, k): what `Problem.columns` names


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of a step, as numbers."""

    lower: np.ndarray  # (s,): bounds of the shared parameters
    upper: np.ndarray
    largest_step: np.ndarray  # (s,)
    relative: np.ndarray  # (s,), bool: whether that is a part of their values
    gauge: np.ndarray | None  # (p,): weights of the pixels whose mean response is held at 1
    cadence_lower: np.ndarray  # (k,): bounds and largest steps of the parameters of a cadence
    cadence_upper: np.ndarray
    cadence_step: np.ndarray

    def reach(self, shared):
        """How far the shared parameters may move from where they are, ``(s,)``."""
        return self.largest_step * np.where(self.relative, np.abs(shared), 1.0)


@dataclass(frozen=True)
class _Columns:
    """Where the parameters of stars and files are, as numbers."""

    maps: tuple  # of each file: first of the four shared parameters of its motion
    places: tuple  # of each star: first of the two shared parameters of its position
    fluxes: tuple  # of each star: among the shared parameters if it is constant, else a column
    backgrounds: tuple  # of each file: a column, or among the shared parameters; none if it is 0
    focus: int  # first of the shared parameters of the focus


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
    """Data and model of a fit."""

    stamps: tuple  # PixelData of each file, in the same cadences
    prf: object  # its parameters hold starts, bounds and fixed values
    options: Settings
    stars: tuple = (FitStar(),)  # the first one without offsets
    error_scale: float = 1.0  # factor of all errors in the fit
    misfit: float = 1.0  # ... of the errors that are quoted, from the pixels with light
    target: np.ndarray | None = None  # position of the first star, if given
    span: tuple | None = None  # first and last time that the focus covers, days
    center: tuple = (0.0, 0.0)  # where the first star is in the linear map to other files

    # --- data -----------------------------------------------------------------------------
    @property
    def data(self):
        """The pixels of the first file."""
        return self.stamps[0]

    def _joined(self, name):
        """The fitted pixels of all files, shape ``(n, p)``; NaN where there are no data."""
        return np.concatenate([getattr(s, name)[:, s.pixels] for s in self.stamps], axis=1)

    @cached_property
    def flux(self):
        """Fluxes of the fitted pixels, shape ``(n, p)``, 0 where there are none."""
        flux = self._joined("flux")
        return np.where(np.isfinite(flux), flux, 0.0)

    @cached_property
    def _given_weight(self):
        good = np.isfinite(self._joined("flux"))
        return np.where(good, 1 / np.where(good, self._joined("flux_err"), 1.0), 0.0)

    @cached_property
    def weight(self):
        """Inverse errors of the fitted pixels, shape ``(n, p)``, 0 where there are no data."""
        return self._given_weight / self.error_scale

    @cached_property
    def slices(self):
        """Which of the fitted pixels belong to each file."""
        ends = [0, *np.cumsum([s.pixels.sum() for s in self.stamps]).tolist()]
        return [slice(start, end) for start, end in pairwise(ends)]

    @property
    def n_data(self):
        """Number of pixel values."""
        return int(np.count_nonzero(self._given_weight))

    @property
    def n_free(self):
        """Number of free parameters."""
        return self.n_shared + self.n_pixels + len(self.flux) * len(self.columns)

    @cached_property
    def basis(self):
        """What the path is linear in, shape ``(n, 3)``."""
        offsets = self.data.pos_corr - np.median(self.data.pos_corr, axis=0)
        return np.column_stack([np.ones(len(offsets)), offsets])

    @cached_property
    def focus_basis(self):
        """Cubic splines of time of which the relative width is a sum, shape ``(n, k)``."""
        if self.options.focus is None:
            return np.zeros((len(self.flux), 0))
        first, last = self.span
        n_parts = max(1, int((last - first) / self.options.focus))
        inner = np.linspace(first, last, n_parts + 1)
        knots = np.concatenate([[first] * 3, inner, [last] * 3])
        return BSpline.design_matrix(self.data.time, knots, 3).toarray()

    def focus(self, state):
        """Relative width of the PSF less 1, shape ``(n,)``."""
        return self.focus_basis @ state.shared[self.index.focus :]

    def thinned(self, every):
        """Return the problem with a part of the cadences."""
        return replace(self, stamps=tuple(s[::every] for s in self.stamps))

    # --- parameters -----------------------------------------------------------------------
    @property
    def path(self):
        """Whether the positions are an affine map of POS_CORR."""
        return self.options.positions == "path"

    @property
    def n_affine(self):
        """Number of parameters of the path."""
        return 6 if self.options.positions in {"path", "prior"} else 0

    @property
    def n_pixels(self):
        """Number of pixels with a response of their own."""
        return self.slices[-1].stop if self.options.interpixel else 0

    @cached_property
    def parameters(self):
        """The shared parameters, in their order."""
        shape = np.max([s.shape for s in self.stamps], axis=0) if self.stamps else (1, 1)
        result = list(fit_parameters(self.prf, shape))
        for i, axis in enumerate("xy" if self.n_affine else ()):
            scale = {"kind": "slope", "prior": self.options.scale_error}
            result += [
                FitParameter(f"{axis}_const", "position"),
                *(FitParameter(f"{axis}_by_corr{j + 1}", **scale, center=i == j) for j in (0, 1)),
            ]
        for i in range(1, len(self.stamps)):
            result += [
                FitParameter(name, "slope", prior=_MAP_PRIOR, center=one, start=one)
                for name, one in zip(_map_names(i), (1.0, 0.0, 0.0, 1.0), strict=True)
            ]
        for k, star in enumerate(self.stars[1:], start=1):
            for axis, start in (("x", star.x), ("y", star.y)):
                reach = start - _STAR_MOVE, start + _STAR_MOVE, _LARGEST_MOVE
                result.append(FitParameter(f"{axis}_star_{k}", "position", *reach, start=start))
        result += [
            FitParameter(f"flux_star_{k}", "flux")
            for k, star in enumerate(self.stars)
            if star.constant
        ]
        if self.options.background == "constant":
            result += [
                FitParameter(numbered("background", i), "flux") for i in range(len(self.stamps))
            ]
        if self.options.focus is not None:
            number = self.focus_basis.shape[1]
            result += [
                FitParameter(f"focus_{i}", "focus", prior=_FOCUS_PRIOR) for i in range(number)
            ]
        return tuple(result)

    @cached_property
    def names(self):
        """Names of the shared parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def n_shared(self):
        """Number of shared parameters."""
        return len(self.parameters)

    @cached_property
    def n_shape(self):
        """Number of free parameters of the PRF, which come first."""
        return len(fit_parameters(self.prf, (1, 1)))

    @cached_property
    def columns(self):
        """Names of the parameters of a cadence."""
        position = () if self.path else ("x", "y")
        fluxes = (numbered("flux", k) for k, s in enumerate(self.stars) if not s.constant)
        number = max(len(self.stamps), 1) if self.options.background == "cadence" else 0
        return (*position, *fluxes, *(numbered("background", i) for i in range(number)))

    @cached_property
    def index(self):
        """Numbers of the parameters, `_Columns`."""
        shared = {name: i for i, name in enumerate(self.names)}
        of_cadence = {name: i for i, name in enumerate(self.columns)}
        number, stars = range(len(self.stamps)), range(len(self.stars))
        fluxes = [
            shared[f"flux_star_{k}"] if self.stars[k].constant else of_cadence[numbered("flux", k)]
            for k in stars
        ]
        where = {"cadence": of_cadence, "constant": shared}.get(self.options.background)
        return _Columns(
            maps=tuple(shared[_map_names(i)[0]] if i else None for i in number),
            places=tuple(shared[f"x_star_{k}"] if k else None for k in stars),
            fluxes=tuple(fluxes),
            backgrounds=tuple(where[numbered("background", i)] for i in number) if where else (),
            focus=self.n_shared - self.focus_basis.shape[1],
        )

    @cached_property
    def _priors(self):
        """Precision before the fit and mean of the shared parameters, ``(2, s)``."""
        return np.array([(p.prior**-2, p.center) for p in self.parameters]).reshape(-1, 2).T

    @cached_property
    def limits(self):
        """Limits of a step."""
        low, high, step = (np.full(len(self.columns), v) for v in (-np.inf, np.inf, np.inf))
        if not self.path:
            ny, nx = self.data.shape
            low[:2], high[:2], step[:2] = -1.0, (nx, ny), _LARGEST_MOVE
        shared = [
            np.array([getattr(p, name) for p in self.parameters], dtype=kind)
            for name, kind in (("lower", float), ("upper", float), ("largest_step", float),
                               ("relative", bool))
        ]  # fmt: skip
        return Limits(*shared, self._light_parts if self.n_pixels else None, low, high, step)

    @cached_property
    def _light_parts(self):
        """Parts of the light in the fitted pixels, of sum 1, shape ``(p,)``."""
        flux = self._joined("flux")
        seen = np.isfinite(flux).any(axis=0)
        light = np.zeros(len(seen))
        light[seen] = np.maximum(np.nanmedian(flux[:, seen], axis=0), 0.0)
        light = light if light.any() else seen.astype(float)
        return light / light.sum()

    def rescaled(self, state):
        """Return the problem with errors scaled to the residuals where the model is not true."""
        squares = (self._given_weight * (self.flux - self.model(state))) ** 2
        squares[self._given_weight == 0] = np.nan
        # Medians: neither cosmic rays nor single bad pixels count.
        seen = np.any(self._given_weight, axis=0)
        typical = np.median(np.nanmedian(squares[:, seen], axis=0)) / _MEDIAN_SQUARE
        # Most parameters hang on the pixels with light, most pixels have none.
        light = self._light_parts
        n_light = 1 / np.sum(light**2)
        lit = np.sum(light * ~np.isnan(squares), axis=1)
        weighted = np.nansum(squares * light, axis=1)[lit > 0] / lit[lit > 0]
        bright = np.median(weighted) / (1 - 2 / (9 * n_light)) ** 3
        by_chance = _CHANCE * np.sqrt(2 / (n_light * len(squares)))
        lost = self.n_data / max(self.n_data - self.n_free, 1)
        typical, bright = lost * typical, lost * bright
        untrue = typical > _UNTRUE or bright > _UNTRUE + by_chance
        misfit = scale = float(np.sqrt(max(typical, bright))) if untrue else 1.0
        if self.options.soft:
            # In units of larger errors, cosmic rays in the pixels without light are no outliers.
            scale = float(np.sqrt(typical)) if typical > _UNTRUE else 1.0
        if max(abs(scale / self.error_scale - 1), abs(misfit / self.misfit - 1)) > _SAME:
            return replace(self, error_scale=scale, misfit=misfit)
        return self

    def quoted(self):
        """Return the problem with the errors that are quoted, and the same weights of outliers."""
        soft = self.options.loss_scale * self.error_scale / self.misfit
        options = replace(self.options, loss_scale=soft)
        return replace(self, error_scale=self.misfit, options=options)

    # --- parts of a state -----------------------------------------------------------------
    def values(self, state):
        """Values of the free parameters of the PRF."""
        free = state.shared[: self.n_shape]
        return dict(zip(self.names[: self.n_shape], map(float, free), strict=True))

    def affine(self, state):
        """The affine map of the path, shape ``(2, 3)``."""
        return state.shared[self.n_shape : self.n_shape + 6].reshape(2, 3)

    def _map(self, state, stamp):
        """How a file moves with the first one, shape ``(2, 2)``."""
        if not stamp:
            return np.eye(2)
        start = self.index.maps[stamp]
        return state.shared[start : start + 4].reshape(2, 2)

    def xy(self, state, star=0):
        """Positions of a star in its stamp, shape ``(n, 2)``."""
        first = self.basis @ self.affine(state).T if self.path else state.cadence[:, :2]
        if star == 0:
            return first
        moved = (first - self.center) @ self._map(state, self.stars[star].stamp).T + self.center
        start = self.index.places[star]
        return moved + state.shared[start : start + 2]

    def position_terms(self, state, star):
        """Yield the parameters that move a star, and how.

        Each is ``(axis, of_cadence, index, derivative)``: 0 for x or 1 for y; whether the parameter
        belongs to each cadence, or is shared; its number; the derivative of the position, ``(n,)``.
        """
        stamp, one = self.stars[star].stamp, np.ones(len(self.flux))
        matrix = self._map(state, stamp)
        for axis in (0, 1):
            for of, slope in enumerate(matrix[axis]):
                if slope and self.path:
                    for i in range(3):
                        yield axis, False, self.n_shape + 3 * of + i, slope * self.basis[:, i]
                elif slope:
                    yield axis, True, of, slope * one
            if stamp:
                first = self.index.maps[stamp] + 2 * axis
                moved = self.xy(state) - self.center
                yield axis, False, first, moved[:, 0]
                yield axis, False, first + 1, moved[:, 1]
            if star:
                yield axis, False, self.index.places[star] + axis, one

    def fluxes(self, state, star=0):
        """Fluxes of a star, shape ``(n,)``."""
        column = self.index.fluxes[star]
        if self.stars[star].constant:
            return np.full(len(state.cadence), state.shared[column])
        return state.cadence[:, column]

    def path_of(self, state, star):
        """Positions and fluxes of a star by name, ``(n,)``."""
        x, y = self.xy(state, star).T
        return {"x": x, "y": y, "flux": self.fluxes(state, star)}

    def backgrounds(self, state, stamp=0):
        """Backgrounds of a file, shape ``(n,)``."""
        if self.options.background == "cadence":
            return state.cadence[:, self.index.backgrounds[stamp]]
        constant = self.options.background == "constant"
        value = state.shared[self.index.backgrounds[stamp]] if constant else 0.0
        return np.full(len(state.cadence), value)

    # --- model ----------------------------------------------------------------------------
    def chunks(self):
        """Slices of cadences."""
        n = len(self.flux)
        return [slice(start, min(start + _CHUNK, n)) for start in range(0, n, _CHUNK)]

    def unit_images(self, state, part, star=0, *, derivatives=False):
        """Images of unit flux at the fitted pixels of the star's stamp, ``(m, p)``.

        With their derivatives: those by column and row, by the shape of the PSF, and by the focus.
        """
        stamp = self.stamps[self.stars[star].stamp]
        x, y = self.xy(state, star)[part].T
        widens = self.options.focus is not None
        values = self.values(state)
        result = self.prf.unit_images(
            stamp.shape, x, y, values=values, derivatives=derivatives or widens
        )
        if not (derivatives or widens):
            return result[:, stamp.pixels]
        image, by = result
        if widens:
            by["focus"] = self._widened(by, values)
            image = image + self.focus(state)[part, None, None] * by["focus"]
        if not derivatives:
            return image[:, stamp.pixels]
        needed = ("x_0", "y_0", *self.names[: self.n_shape], *(("focus",) if widens else ()))
        return image[:, stamp.pixels], [by[name][:, stamp.pixels] for name in needed]

    def _widened(self, derivatives, values):
        """Derivative of images by the relative width: all distances from the star scale."""
        kinds = self.prf.parameter_kinds
        scaled = [name for name, kind in kinds.items() if kind in {"width", "offset"}]
        numbers = numbers_of(self.prf) | values
        return sum(numbers[name] * derivatives[name] for name in scaled)

    def model(self, state):
        """Model of the fitted pixels, shape ``(n, p)``."""
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
        n, k, m = len(self.flux), len(self.columns), self.n_shared + self.n_pixels
        shared, gradient = np.zeros((m, m)), np.zeros(m)
        mixed, block, block_gradient = np.zeros((n, k, m)), np.zeros((n, k, k)), np.zeros((n, k))
        cost, soft, s = 0.0, self.options.soft, self.n_shared
        for part in self.chunks():
            residual, by_shared, by_pixel, by_cadence = self._linearize(state, part)
            weight = self.weight[part]
            residual *= weight
            if soft is None:
                cost += np.sum(residual**2)
            else:
                scaled = (residual / soft) ** 2
                cost += 2 * soft**2 * np.sum(np.sqrt(1 + scaled) - 1)
                factor = (1 + scaled) ** -0.25
                residual *= factor
                weight = weight * factor
            by_shared *= weight[..., None]
            by_cadence *= weight[..., None]
            flat = by_shared.reshape(residual.size, s)
            shared[:s, :s] += flat.T @ flat
            gradient[:s] += residual.ravel() @ flat
            block[part] = by_cadence.transpose(0, 2, 1) @ by_cadence
            block_gradient[part] = np.einsum("npk,np->nk", by_cadence, residual)
            mixed[part, :, :s] = by_cadence.transpose(0, 2, 1) @ by_shared
            if self.n_pixels:
                by_pixel *= weight
                shared[:s, s:] += np.einsum("nps,np->sp", by_shared, by_pixel)
                shared[range(s, m), range(s, m)] += np.sum(by_pixel**2, axis=0)
                gradient[s:] += np.sum(by_pixel * residual, axis=0)
                mixed[part, :, s:] = (by_cadence * by_pixel[..., None]).transpose(0, 2, 1)
        shared[s:, :s] = shared[:s, s:].T
        cost += self._add_priors(state, shared, gradient)
        if self.options.positions == "prior":
            cost += self._add_path(state, shared, gradient, mixed, block, block_gradient)
        return NormalEquations(cost, shared, gradient, mixed, block, block_gradient)

    def _linearize(self, state, part):
        """Residuals and derivatives of the model in a slice of cadences."""
        size = self.flux[part].shape
        by_shared = np.zeros((*size, self.n_shared))
        by_cadence = np.zeros((*size, len(self.columns)))
        light = np.zeros(size)
        response = 1 + (state.interpixel if self.n_pixels else np.zeros(size[1]))
        for k, star in enumerate(self.stars):
            pixels = self.slices[star.stamp]
            light[:, pixels] += self._add_star(
                state, part, k, response[pixels], by_shared[:, pixels], by_cadence[:, pixels]
            )
        residual = self.flux[part] - response * light
        for i, pixels in enumerate(self.slices):
            residual[:, pixels] -= self.backgrounds(state, i)[part, None]
            if self.index.backgrounds:
                by = by_cadence if self.options.background == "cadence" else by_shared
                by[:, pixels, self.index.backgrounds[i]] = 1.0
        return residual, by_shared, light, by_cadence

    def _add_star(self, state, part, k, response, by_shared, by_cadence):
        """Add the derivatives of a star to those of its pixels; return its light."""
        image, derivatives = self.unit_images(state, part, k, derivatives=True)
        flux = self.fluxes(state, k)[part, None]
        scale = response * flux
        for i in range(self.n_shape):
            by_shared[..., i] += scale * derivatives[2 + i]
        moved = scale * derivatives[0], scale * derivatives[1]
        for axis, of_cadence, i, derivative in self.position_terms(state, k):
            by_parameter = by_cadence if of_cadence else by_shared
            by_parameter[..., i] += derivative[part, None] * moved[axis]
        if self.options.focus is not None:
            basis = self.focus_basis[part, np.newaxis]
            by_shared[..., self.index.focus :] += (scale * derivatives[-1])[..., np.newaxis] * basis
        by_flux = by_shared if self.stars[k].constant else by_cadence
        by_flux[..., self.index.fluxes[k]] = response * image
        return flux * image

    def _add_priors(self, state, shared, gradient):
        """Add the priors of the shared parameters to an expansion; return their cost."""
        s, p = self.n_shared, self.n_pixels
        precision, center = self._priors
        deviation = state.shared - center
        shared[range(s), range(s)] += precision
        gradient[:s] -= precision * deviation
        cost = precision @ deviation**2
        if p and np.isfinite(self.options.interpixel):
            # The prior does not constrain a common factor of all pixels: that is the flux.
            deviation = state.interpixel - state.interpixel.mean()
            precision = self.options.interpixel**-2
            cost += precision * np.sum(deviation**2)
            shared[s:, s:] += precision * (np.eye(p) - 1 / p)
            gradient[s:] -= precision * deviation
        return cost

    def _add_path(self, state, shared, gradient, mixed, block, block_gradient):
        """Add the prior of the positions about the path to an expansion; return its cost."""
        precision, start = self.options.position_error**-2, self.n_shape
        deviation = state.cadence[:, :2] - self.basis @ self.affine(state).T
        for axis in (0, 1):
            i = slice(start + 3 * axis, start + 3 * axis + 3)
            block[:, axis, axis] += precision
            block_gradient[:, axis] -= precision * deviation[:, axis]
            mixed[:, axis, i] -= precision * self.basis
            shared[i, i] += precision * self.basis.T @ self.basis
            gradient[i] += precision * deviation[:, axis] @ self.basis
        return precision * np.sum(deviation**2)


def numbered(name, k):
    """Name of what belongs to star or file k; that of the first one has no number."""
    return f"{name}_{k}" if k else name


def _map_names(stamp):
    """Names of the parameters that map the motion of the first file to that of another."""
    return [f"{axis}_by_{of}_{stamp}" for axis in "xy" for of in "xy"]
