"""The joint model of all pixels and cadences: residuals, normal equations, priors."""

from dataclasses import dataclass, field

import numpy as np

from scope_models.models._derivatives import unit_derivatives
from scope_models.models.integration import PixelPoints

__all__ = ["NormalEquations", "Problem", "State"]

# Cadences whose derivatives are held at once.
_CHUNK = 256
# Mean squared residual from which the errors are scaled, and change of scale that is none.
_UNTRUE, _SAME = 1.5, 0.02
# Median of the square of a standard normal deviate.
_MEDIAN_SQUARE = 0.4549364


@dataclass(frozen=True, eq=False)
class State:
    """
    Values of all free parameters.

    Parameters
    ----------
    shared : ndarray of shape (s,)
        Free parameters of the PRF, then the affine map of the path, then a constant background.
    interpixel : ndarray of shape (p,)
        Response of each fitted pixel less 1.
    cadence : ndarray of shape (n, k)
        Per cadence: x and y (unless a path gives them), flux, background (if free).
    """

    shared: np.ndarray
    interpixel: np.ndarray
    cadence: np.ndarray


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """
    Second-order expansion of half the cost: ``cost/2 - g d + d H d / 2``.

    Parameters
    ----------
    cost : float
        Chi-squared, with the loss, and the priors.
    shared, shared_gradient : ndarray of shape (m, m), (m,)
        Block of shared parameters and interpixel map.
    mixed : ndarray of shape (n, k, m)
        Cadence by shared.
    cadence, cadence_gradient : ndarray of shape (n, k, k), (n, k)
        Blocks of the cadences.
    """

    cost: float
    shared: np.ndarray
    shared_gradient: np.ndarray
    mixed: np.ndarray
    cadence: np.ndarray
    cadence_gradient: np.ndarray


@dataclass(eq=False)
class Problem:
    """
    What is fitted to what.

    Parameters
    ----------
    data : PixelData
        The pixels.
    prf : PRF
        The model; its parameters hold the fixed values.
    names : tuple of str
        Free parameters of the PRF.
    background : {"cadence", "constant", "none"}
        Background left in the pixels.
    positions : {"free", "prior", "path"}
        What ties positions to POS_CORR.
    position_error : float
        Standard deviation about the path for "prior", pixels.
    interpixel_error : float
        Standard deviation of the response between pixels; 0 fixes it at 1.
    ridge : dict of str to float
        Standard deviations about 0 of parameters of the PRF.
    soft : float or None
        Residual, in standard deviations, from which the loss grows only linearly.
    """

    data: object
    prf: object
    names: tuple
    background: str
    positions: str
    position_error: float
    interpixel_error: float
    ridge: dict
    soft: float | None
    flux: np.ndarray = field(init=False)
    weight: np.ndarray = field(init=False)

    def __post_init__(self):
        inside = self.data.pixels
        flux, error = self.data.flux[:, inside], self.data.flux_err[:, inside]
        good = np.isfinite(flux)
        self.flux = np.where(good, flux, 0.0)
        self.weight = np.where(good, 1 / np.where(good, error, 1.0), 0.0)
        self.error_scale = 1.0
        self.path = self.positions == "path"
        self.n_affine = 6 if self.positions in {"path", "prior"} else 0
        self.n_pixels = int(inside.sum()) if self.interpixel_error else 0
        self.n_shared = len(self.names) + self.n_affine + (self.background == "constant")
        self.fixed = {
            n: float(np.ravel(getattr(self.prf, n).value)[0]) for n in self.prf.param_names
        }
        if self.n_affine:
            offsets = self.data.pos_corr - np.median(self.data.pos_corr, axis=0)
            self.basis = np.column_stack([np.ones(len(offsets)), offsets])

    @property
    def columns(self):
        """Names of the parameters of a cadence."""
        position = () if self.path else ("x", "y")
        return (*position, "flux", *(("background",) if self.background == "cadence" else ()))

    @property
    def n_data(self):
        """Number of pixel values."""
        return int(np.count_nonzero(self.weight))

    def rescale(self, state):
        """Scale the errors to the residuals where the model is not true; whether they changed."""
        residual = self.error_scale * self.weight * (self.flux - self.model(state))
        residual[self.weight == 0] = np.nan
        # Medians: neither cosmic rays nor single bad pixels count.
        typical = np.median(np.nanmedian(residual**2, axis=0)) / _MEDIAN_SQUARE
        n_free = self.n_shared + self.n_pixels + state.cadence.size
        typical *= self.n_data / max(self.n_data - n_free, 1)
        scale = float(np.sqrt(typical)) if typical > _UNTRUE else 1.0
        changed = abs(scale / self.error_scale - 1) > _SAME
        self.weight = self.weight * (self.error_scale / scale)
        self.error_scale = scale
        return changed

    # --- parts of a state -----------------------------------------------------------------
    def values(self, state):
        """Values of the parameters of the PRF."""
        free = state.shared[: len(self.names)]
        return self.fixed | dict(zip(self.names, map(float, free), strict=True))

    def affine(self, state):
        """The affine map of the path, shape ``(2, 3)``."""
        start = len(self.names)
        return state.shared[start : start + 6].reshape(2, 3)

    def xy(self, state):
        """Positions, shape ``(n, 2)``."""
        return self.basis @ self.affine(state).T if self.path else state.cadence[:, :2]

    def fluxes(self, state):
        """Fluxes, shape ``(n,)``."""
        return state.cadence[:, self.columns.index("flux")]

    def backgrounds(self, state):
        """Backgrounds, shape ``(n,)``."""
        if self.background == "cadence":
            return state.cadence[:, -1]
        constant = state.shared[-1] if self.background == "constant" else 0.0
        return np.full(len(state.cadence), constant)

    # --- model ----------------------------------------------------------------------------
    def chunks(self):
        """Slices of cadences."""
        n = len(self.flux)
        return [slice(start, min(start + _CHUNK, n)) for start in range(0, n, _CHUNK)]

    def unit_images(self, state, part):
        """Images of unit flux at the fitted pixels and their derivatives, ``(m, p)``."""
        x, y = self.xy(state)[part].T
        values = self.values(state) | {"x_0": x, "y_0": y}
        image, derivatives = unit_derivatives(
            self.prf, PixelPoints.from_shape(self.data.shape), values
        )
        inside = self.data.pixels
        needed = (*self.names, "x_0", "y_0")
        return image[:, inside], {name: derivatives[name][:, inside] for name in needed}

    def model(self, state):
        """Model of the fitted pixels, shape ``(n, p)``."""
        model = np.empty(self.flux.shape)
        response = 1 + (state.interpixel if self.n_pixels else 0.0)
        prf = self.prf.copy()
        for name, value in self.values(state).items():
            setattr(prf, name, value)
        flux, background = self.fluxes(state), self.backgrounds(state)
        for part in self.chunks():
            x, y = self.xy(state)[part].T
            images = prf.render(self.data.shape, flux=flux[part], x_0=x, y_0=y)
            model[part] = response * images[:, self.data.pixels] + background[part, None]
        return model

    def expand(self, state):
        """
        Cost and its normal equations.

        Parameters
        ----------
        state : State
            Where to expand.

        Returns
        -------
        NormalEquations
            The expansion.
        """
        n, k, m = len(self.flux), len(self.columns), self.n_shared + self.n_pixels
        shared, gradient = np.zeros((m, m)), np.zeros(m)
        mixed, block, block_gradient = np.zeros((n, k, m)), np.zeros((n, k, k)), np.zeros((n, k))
        cost = 0.0
        for part in self.chunks():
            residual, by_shared, by_pixel, by_cadence = self._linearise(state, part)
            weight = self.weight[part]
            residual *= weight
            if self.soft is None:
                cost += np.sum(residual**2)
            else:
                scaled = (residual / self.soft) ** 2
                cost += 2 * self.soft**2 * np.sum(np.sqrt(1 + scaled) - 1)
                factor = (1 + scaled) ** -0.25
                residual *= factor
                weight = weight * factor
            by_shared *= weight[..., None]
            by_cadence *= weight[..., None]
            flat, s = by_shared.reshape(-1, self.n_shared), self.n_shared
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
        shared[self.n_shared :, : self.n_shared] = shared[: self.n_shared, self.n_shared :].T
        equations = NormalEquations(cost, shared, gradient, mixed, block, block_gradient)
        return self._with_priors(state, equations)

    def _linearise(self, state, part):
        """Residuals and derivatives of the model in a slice of cadences."""
        image, derivatives = self.unit_images(state, part)
        flux = self.fluxes(state)[part, None]
        response = 1 + (state.interpixel if self.n_pixels else 0.0)
        residual = self.flux[part] - response * flux * image
        residual -= self.backgrounds(state)[part, None]
        scale = response * flux
        by_shared = np.empty((*image.shape, self.n_shared))
        for i, name in enumerate(self.names):
            np.multiply(scale, derivatives[name], out=by_shared[..., i])
        moved = [scale * derivatives[name] for name in ("x_0", "y_0")]
        start = len(self.names)
        if self.path:
            for axis in (0, 1):
                for i in range(3):
                    basis = self.basis[part, i, None]
                    by_shared[..., start + 3 * axis + i] = basis * moved[axis]
        elif self.n_affine:
            by_shared[..., start : start + 6] = 0.0
        if self.background == "constant":
            by_shared[..., -1] = 1.0
        columns = [] if self.path else moved
        columns = [*columns, response * image]
        if self.background == "cadence":
            columns.append(np.ones_like(image))
        return residual, by_shared, flux * image, np.stack(columns, axis=-1)

    def _with_priors(self, state, equations):
        """Add the priors to an expansion."""
        cost, shared, gradient = equations.cost, equations.shared, equations.shared_gradient
        for name, width in self.ridge.items():
            i = self.names.index(name)
            cost += (state.shared[i] / width) ** 2
            shared[i, i] += width**-2
            gradient[i] -= state.shared[i] / width**2
        if self.n_pixels and np.isfinite(self.interpixel_error):
            # Of a common factor of all pixels the prior knows nothing: that is the flux.
            deviation = state.interpixel - state.interpixel.mean()
            precision = self.interpixel_error**-2
            cost += precision * np.sum(deviation**2)
            s, p = self.n_shared, self.n_pixels
            shared[s:, s:] += precision * (np.eye(p) - 1 / p)
            gradient[s:] -= precision * deviation
        if self.positions == "prior":
            cost += self._position_prior(state, equations)
        return NormalEquations(
            cost, shared, gradient, equations.mixed, equations.cadence, equations.cadence_gradient
        )

    def _position_prior(self, state, equations):
        """Add the prior of the positions about the path; return its cost."""
        precision, start = self.position_error**-2, len(self.names)
        deviation = state.cadence[:, :2] - self.basis @ self.affine(state).T
        for axis in (0, 1):
            i = slice(start + 3 * axis, start + 3 * axis + 3)
            equations.cadence[:, axis, axis] += precision
            equations.cadence_gradient[:, axis] -= precision * deviation[:, axis]
            equations.mixed[:, axis, i] -= precision * self.basis
            equations.shared[i, i] += precision * self.basis.T @ self.basis
            equations.shared_gradient[i] += precision * deviation[:, axis] @ self.basis
        return precision * np.sum(deviation**2)
