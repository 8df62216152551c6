"""Where a fit starts, and what it holds fixed."""

import numpy as np

from scope_models.fitting._problem import State
from scope_models.models import (
    PRF,
    BivariateGaussianPSF,
    GaussHermitePSF,
    SensitivityPolynomial,
)
from scope_models.models._derivatives import coefficient_names

__all__ = ["bounds_of", "free_names", "linear_start", "make_prf", "starting_state"]

_SIGMAS, _FRACTIONS = (0.5, 1.1, 2.0), (0.7, 0.25, 0.05)
# The empirical term: part of the flux, and width of its first function. From 0.7 to 0.8 the real
# stars of the documentation are described best.
_EMPIRICAL_FRACTION, _EMPIRICAL_SIGMA = 0.02, 0.75
# Narrower PSFs are the same to a pixel; tighter correlations only cost time.
_LEAST_SIGMA, _LARGEST_RHO, _LARGEST_OFFSET = 0.1, 0.95, 2.0
# Pixels that are brighter than this part of the brightest one give the first positions.
_BRIGHT = 0.1
# ... within so many pixels of it, and where so high a percentile over the cadences is bright.
_NEAR, _OFTEN = 2, 98


def make_prf(psf, sensitivity, empirical):
    """
    The model of a star.

    Parameters
    ----------
    psf : int or Model
        Number of Gaussian components, a density or sum of densities, or a PRF.
    sensitivity : SensitivityPolynomial or None
        Response within a pixel.
    empirical : int
        Order of the empirical term; 0 for none.

    Returns
    -------
    PRF
        With the fixed parameters of the fit.
    """
    if isinstance(psf, PRF):
        if sensitivity is not None or empirical:
            raise ValueError("`sensitivity` and `empirical` must be left out if `psf` is a PRF")
        prf = psf.copy()
        _hold_constants(prf)
        return prf
    if sensitivity is not None and not isinstance(sensitivity, SensitivityPolynomial):
        raise TypeError(
            f"`sensitivity` must be a SensitivityPolynomial or None, got {sensitivity!r}"
        )
    compound, number = (_gaussians(psf), True) if isinstance(psf, int) else (psf, False)
    n_components = len(PRF(compound)._components)  # noqa: SLF001
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
    """Fix the constants of the sensitivity: they are the flux."""
    for name, (_, power) in coefficient_names(prf).items():
        if power == 0:
            getattr(prf, name).fixed = True


def free_names(prf):
    """Parameters of a PRF that all cadences share and that are not fixed."""
    return tuple(
        name
        for name in prf.param_names
        if name not in {"flux", "x_0", "y_0"} and not getattr(prf, name).fixed
    )


def bounds_of(prf, names, n_others, shape):
    """
    Lower and upper bounds of the shared parameters; the others have none.

    A component that is wider than half the stamp is nothing but background.
    """
    lower, upper = np.full(len(names) + n_others, -np.inf), np.full(len(names) + n_others, np.inf)
    coefficients = coefficient_names(prf)
    for i, name in enumerate(names):
        low, high = getattr(prf, name).bounds
        lower[i] = -np.inf if low is None else low
        upper[i] = np.inf if high is None else high
        if name.startswith("sigma"):
            lower[i] = max(lower[i], _LEAST_SIGMA)
            upper[i] = min(upper[i], max(shape) / 2)
        elif name.startswith("rho"):
            lower[i], upper[i] = max(lower[i], -_LARGEST_RHO), min(upper[i], _LARGEST_RHO)
        elif name in coefficients:
            # At a pixel's edge no term takes away all of the response, or doubles it.
            largest = 2.0 ** coefficients[name][1]
            lower[i], upper[i] = max(lower[i], -largest), min(upper[i], largest)
        elif "offset" in name:
            lower[i], upper[i] = max(lower[i], -_LARGEST_OFFSET), min(upper[i], _LARGEST_OFFSET)
    return lower, upper


def starting_state(problem):
    """
    Positions from centroids, fluxes from linear fits, the rest from the model.

    Parameters
    ----------
    problem : Problem
        What is fitted.

    Returns
    -------
    State
        The start.
    """
    xy = _centroids(problem.data)
    affine = np.zeros(0)
    if problem.data.pos_corr is not None and problem.positions != "free":
        offsets = problem.data.pos_corr - np.median(problem.data.pos_corr, axis=0)
        basis = np.column_stack([np.ones(len(offsets)), offsets])
        fitted = _robust_map(basis, xy)
        if problem.positions == "start":
            xy = basis @ fitted
        elif problem.n_affine:
            affine = fitted.T.ravel()
            xy = basis @ fitted
    shared = [getattr(problem.prf, name).value for name in problem.names]
    constant = [0.0] if problem.background == "constant" else []
    shared = np.array([*map(float, shared), *affine, *constant])
    n, k = len(xy), len(problem.columns)
    cadence = np.zeros((n, k))
    if not problem.path:
        cadence[:, :2] = xy
    state = State(shared, np.zeros(problem.n_pixels), cadence)
    return State(shared, state.interpixel, linear_start(problem, state))


def _centroids(data):
    """First moments over the bright pixels around the brightest of each cadence, ``(n, 2)``."""
    seen = np.isfinite(data.light).any(axis=0)
    image = np.where(seen, np.nanmedian(np.where(seen, data.light, 0), axis=0), 0.0)
    if image.max() <= 0:
        raise ValueError("no pixel of `tpf` has a positive median flux: there is no star to fit")
    flux = np.where(np.isfinite(data.light), data.light, image)
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


def _robust_map(basis, xy):
    """Affine map by least squares without the outliers, ``(3, 2)``."""
    good = np.ones(len(xy), dtype=bool)
    for _ in range(5):
        fitted = np.linalg.lstsq(basis[good], xy[good], rcond=None)[0]
        distance = np.hypot(*(xy - basis @ fitted).T)
        good = distance <= 4 * 1.4826 * np.median(distance) + 1e-6
    return fitted


def linear_start(problem, state):
    """
    Find the fluxes and backgrounds, in which the model is linear.

    Parameters
    ----------
    problem : Problem
        What is fitted.
    state : State
        The other parameters.

    Returns
    -------
    cadence : ndarray of shape (n, k)
        Parameters of all cadences.
    """
    cadence = state.cadence.copy()
    both = problem.background == "cadence"
    for part in problem.chunks():
        x, y = problem.xy(state)[part].T
        prf_values = problem.values(state)
        image = _render(problem, prf_values, x, y)
        weight = problem.weight[part]
        columns = [image, np.ones_like(image)] if both else [image]
        design = np.stack(columns, axis=-1) * weight[..., None]
        normal = design.transpose(0, 2, 1) @ design
        normal += 1e-12 * normal.max(axis=(1, 2), keepdims=True) * np.eye(len(columns))
        right = np.einsum("npk,np->nk", design, weight * problem.flux[part])
        cadence[part, -len(columns) :] = np.linalg.solve(normal, right[..., None])[..., 0]
    return cadence


def _render(problem, values, x, y):
    prf = problem.prf.copy()
    for name, value in values.items():
        setattr(prf, name, value)
    images = prf.render(problem.data.shape, flux=np.ones(len(x)), x_0=x, y_0=y)
    return images[:, problem.data.pixels]
