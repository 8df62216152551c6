"""Starting values of a fit, and its fixed parameters."""

import numpy as np

from scope_models.fitting._problem import State
from scope_models.models import (
    PRF,
    BivariateGaussianPSF,
    CorrectedPRF,
    DiffusionSensitivity,
    GaussHermitePSF,
    SensitivityPolynomial,
    TabulatedPRF,
)

__all__ = ["centroids", "is_faint", "linear_start", "make_prf", "make_rich_prf", "starting_state"]

_SIGMAS, _FRACTIONS = (0.5, 1.1, 2.0), (0.7, 0.25, 0.05)
# The empirical term: part of the flux, and width of its first function. From 0.7 to 0.8 the real
# stars of the documentation are described best.
_EMPIRICAL_FRACTION, _EMPIRICAL_SIGMA = 0.02, 0.75
# Its order in the model of `make_rich_prf`.
_RICH_ORDER = 6
# Pixels that are brighter than this part of the brightest one give the first positions.
_BRIGHT = 0.1
# ... within so many pixels of it, and where so high a percentile over the cadences is bright.
_NEAR, _OFTEN = 2, 98
# Stars fainter than this part of the target are constant by default.
_FAINT = 0.1


def make_prf(psf, sensitivity, empirical):
    """The model of a star, with the fixed parameters of the fit.

    ``psf`` is a number of Gaussian components, a density or a sum of densities, or a PRF;
    ``empirical`` is the order of the empirical term, or of the correction of a table, 0 for none.
    """
    if isinstance(psf, (PRF, TabulatedPRF)):
        return _given_prf(psf if isinstance(psf, PRF) else PRF(psf), sensitivity, empirical)
    responses = (SensitivityPolynomial, DiffusionSensitivity, type(None))
    if not isinstance(sensitivity, responses):
        raise TypeError(
            "`sensitivity` must be a SensitivityPolynomial, a DiffusionSensitivity or None, got "
            f"{sensitivity!r}"
        )
    compound, number = (_gaussians(psf), True) if isinstance(psf, int) else (psf, False)
    n_components = PRF(compound).n_components
    if empirical:
        sigma = _EMPIRICAL_SIGMA
        surface = GaussHermitePSF(_EMPIRICAL_FRACTION, 0, 0, sigma, sigma, order=empirical)
        compound = compound + surface
    prf = PRF(compound if sensitivity is None else compound * sensitivity, flux=1, x_0=0, y_0=0)
    if sensitivity is not None:
        for name in sensitivity.param_names:
            getattr(prf, name).fixed = bool(getattr(sensitivity, name).fixed)
    _hold_constants(prf)
    if empirical:
        # A change of either is a change of the coefficients, in which the model is linear.
        for name in ("flux_fraction", "sigma_x", "sigma_y"):
            getattr(prf, f"{name}_{n_components}").fixed = True
    if number:
        for k in range(1, n_components):
            for name in (f"x_offset_{k}", f"y_offset_{k}"):
                getattr(prf, name).fixed = False
    return prf


def _given_prf(prf, sensitivity, order):
    """A PRF of the caller, if it is a table times a smooth correction of that order."""
    if sensitivity is not None:
        raise ValueError("`sensitivity` must be left out if `psf` is a PRF")
    table = prf.table
    if order and table is None:
        raise ValueError("`empirical` must be left out if `psf` is a PRF that is no table")
    if order:
        values = (getattr(table, name).value for name in ("flux", "x_0", "y_0"))
        where = {"origin": table.origin, "uncertainty": table.uncertainty}
        prf = PRF(CorrectedPRF(table.array, table.oversampling, *values, order=order, **where))
    prf = prf.copy()
    _hold_constants(prf)
    return prf


def make_rich_prf(sensitivity):
    """The model of a star whose PSF is no sum of Gaussians: one Gaussian, and an empirical term.

    The Gaussian is fixed, so that all but the positions is linear: nothing ends at a bound.
    """
    sigma, fixed = _SIGMAS[0], dict.fromkeys(("sigma_x", "sigma_y", "rho"), True)
    psf = BivariateGaussianPSF(1 - _EMPIRICAL_FRACTION, 0, 0, sigma, sigma, fixed=fixed)
    return make_prf(psf, sensitivity, _RICH_ORDER)


def _gaussians(number):
    """A sum of Gaussians."""
    if isinstance(number, bool) or not 1 <= number <= len(_SIGMAS):
        raise ValueError(f"`psf` must be 1, 2 or 3 components or a model, got {number!r}")
    total = None
    for sigma, fraction in list(zip(_SIGMAS, _FRACTIONS, strict=True))[:number]:
        model = BivariateGaussianPSF(fraction, 0, 0, sigma, sigma)
        total = model if total is None else total + model
    return total


def _hold_constants(prf):
    """
    Fix what pixels do not constrain.

    The constants of the sensitivity are the flux, and diffusion is a wider Gaussian.
    """
    kinds = prf.parameter_kinds
    for name, (_, power) in prf.response_powers.items():
        if power == 0:
            getattr(prf, name).fixed = True
    if any(kind == "width" and not getattr(prf, name).fixed for name, kind in kinds.items()):
        for name, kind in kinds.items():
            if kind == "diffusion":
                getattr(prf, name).fixed = True


def starting_state(problem):
    """Positions from centroids, fluxes from linear fits, the rest from the model."""
    xy = centroids(problem.data, problem.target)
    positions = problem.options.positions
    shared = np.array([p.start for p in problem.parameters])
    if problem.data.pos_corr is not None and positions != "free":
        fitted = _robust_map(problem.basis, xy)
        if problem.n_affine:
            shared[problem.n_shape : problem.n_shape + 6] = fitted.T.ravel()
        xy = problem.basis @ fitted
    shared = np.clip(shared, problem.limits.lower, problem.limits.upper)
    cadence = np.zeros((len(xy), len(problem.columns)))
    if not problem.path:
        cadence[:, :2] = xy
    return linear_start(problem, State(shared, np.zeros(problem.n_pixels), cadence))


def centroids(data, place=None):
    """First moments over the bright pixels around the brightest of each cadence, ``(n, 2)``.

    With the place of a star, column and row, the brightest pixels near it are its own.
    """
    seen = np.isfinite(data.light).any(axis=0)
    image = np.where(seen, np.nanmedian(np.where(seen, data.light, 0), axis=0), 0.0)
    if image.max() <= 0:
        raise ValueError("no pixel of `tpf` has a positive median flux: there is no star to fit")
    if place is not None:
        row, column = np.indices(image.shape)
        away = np.hypot(column - place[0], row - place[1]) > _NEAR
        if away.all():
            raise ValueError(f"no pixel is within {_NEAR} px of the star at {tuple(place)}")
        image = np.where(away, 0.0, image)
    flux = np.where(np.isfinite(data.light), data.light, image)
    if place is not None:
        flux = np.where(away, 0.0, flux)
    # Where the star ever is for some time; a cosmic ray is elsewhere, most often.
    often = np.percentile(flux, _OFTEN, axis=0)
    flux = np.where(often > _BRIGHT * often.max(), flux, -np.inf).reshape(len(flux), -1)
    rows, columns = (index.ravel() for index in np.indices(image.shape))
    peak = flux.argmax(axis=1)
    near = np.abs(rows - rows[peak, None]) <= _NEAR
    near &= np.abs(columns - columns[peak, None]) <= _NEAR
    light = np.where(near, np.maximum(flux - _BRIGHT * flux.max(axis=1, keepdims=True), 0.0), 0.0)
    total = light.sum(axis=1)
    light[total <= 0] = np.maximum(image.ravel(), 0.0)
    light /= light.sum(axis=1, keepdims=True)
    return np.column_stack([light @ columns, light @ rows])


def is_faint(data, target, other):
    """Whether the light around a star is less than a tenth of that around the target."""
    image = np.nanmedian(np.where(np.isfinite(data.light).any(axis=0), data.light, 0.0), axis=0)
    row, column = np.indices(image.shape)
    near = [image[np.hypot(column - x, row - y) <= 1.0].max(initial=0) for x, y in (target, other)]
    return near[1] < _FAINT * near[0]


def _robust_map(basis, xy):
    """Affine map by least squares without the outliers, ``(3, 2)``."""
    good = np.ones(len(xy), dtype=bool)
    for _ in range(5):
        fitted = np.linalg.lstsq(basis[good], xy[good], rcond=None)[0]
        distance = np.hypot(*(xy - basis @ fitted).T)
        good = distance <= 4 * 1.4826 * np.median(distance) + 1e-6
    return fitted


def linear_start(problem, state):
    """Find the fluxes and backgrounds, in which the model is linear, with the rest of a state.

    The flux of a constant star is the median of what it would be in each cadence.
    """
    shared, cadence = state.shared.copy(), state.cadence.copy()
    both = problem.options.background == "cadence"
    values = np.zeros((len(problem.flux), len(problem.stars) + len(problem.stamps) * both))
    for part in problem.chunks():
        design = np.zeros((*problem.flux[part].shape, values.shape[1]))
        for k, star in enumerate(problem.stars):
            design[:, problem.slices[star.stamp], k] = problem.unit_images(state, part, k)
        for i, pixels in enumerate(problem.slices if both else ()):
            design[:, pixels, len(problem.stars) + i] = 1.0
        weight = problem.weight[part]
        design *= weight[..., None]
        normal = design.transpose(0, 2, 1) @ design
        largest = normal.max(axis=(1, 2), keepdims=True)
        normal += 1e-12 * np.maximum(largest, 1e-300) * np.eye(values.shape[1])
        right = np.einsum("npk,np->nk", design, weight * problem.flux[part])
        values[part] = np.linalg.solve(normal, right[..., None])[..., 0]
    for k, star in enumerate(problem.stars):
        if star.constant:
            shared[problem.index.fluxes[k]] = np.median(values[:, k])
        else:
            cadence[:, problem.index.fluxes[k]] = values[:, k]
    if both:
        cadence[:, -len(problem.stamps) :] = values[:, len(problem.stars) :]
    return State(shared, state.interpixel, cadence)
