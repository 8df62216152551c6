"""The pixels of a fit, its stars, and its starting values."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy import units as u
from scipy.ndimage import maximum_filter

from scope_models._arrays import plain_array
from scope_models.exceptions import FitWarning
from scope_models.fitting._problem import State
from scope_models.io.pixels import read_pixels, star_places, usable_positions
from scope_models.models import (
    PRF,
    BivariateGaussianPSF,
    CorrectedPRF,
    DiffusionSensitivity,
    GaussHermitePSF,
    SensitivityPolynomial,
    TabulatedPRF,
)
from scope_models.scene.detector import Detector

__all__ = [
    "APART",
    "PixelData",
    "centroids",
    "detector_of",
    "find_stars",
    "is_faint",
    "linear_start",
    "make_prf",
    "make_rich_prf",
    "read_data",
    "star_positions",
    "starting_state",
]

# A local maximum of the median image is a star if it is brighter than this part of the brightest
# pixel, and than so many errors of the median image.
_LEAST_PART, _LEAST_SIGNIFICANCE = 0.05, 10.0
# Most stars that are found: time goes with their square.
_MOST_FOUND = 11
# Maxima so near a star are its own, pixels.
APART = 1.5
# Given stars farther outside of the pixels have no light in them, pixels.
_FARTHEST = 5.0
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


@dataclass(frozen=True, eq=False)
class PixelData:
    """Pixels and cadences of a target pixel file that a fit uses."""

    time: np.ndarray  # (n,), days
    cadenceno: np.ndarray
    quality: np.ndarray
    flux: np.ndarray  # (n, ny, nx), e-/s; NaN where not used
    flux_err: np.ndarray
    pixels: np.ndarray  # (ny, nx), bool: those with data
    pos_corr: np.ndarray | None  # (n, 2), interpolated where it is unusable; None if absent
    time_format: str
    light: np.ndarray  # flux with that of saturated pixels, for the first guess of the positions

    @property
    def shape(self):
        """Shape of an image."""
        return self.pixels.shape

    def __getitem__(self, cadences):
        """Return the data of some cadences."""
        names = ("time", "cadenceno", "quality", "flux", "flux_err", "pos_corr", "light")
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v if v is None else v[cadences] for k, v in values.items()})


def read_data(series, flux_err, detector, n_free, *, saturation):
    """Take from a `PixelSeries` what can be fitted; a cadence needs more than ``n_free`` pixels."""
    flux = np.array(series.flux)
    if not np.isfinite(flux).any():
        raise ValueError("`flux` has no finite value")
    error = series.flux_err
    if flux_err is not None:
        error = plain_array(flux_err, u.electron / u.s, "flux_err")
    try:
        error = np.array(np.broadcast_to(error, flux.shape))
    except ValueError:
        raise ValueError(
            f"`flux_err` must broadcast to {flux.shape}, got shape {error.shape}"
        ) from None
    _drop_bad_errors(flux, error)
    light = flux.copy()
    if saturation:
        _drop_saturated(flux, detector)
    good = np.isfinite(flux) & np.isfinite(error)
    pixels = good.any(axis=0)
    cadences = np.isfinite(series.time) & (good.sum(axis=(1, 2)) > n_free)
    if not cadences.any() or pixels.sum() <= n_free:
        raise ValueError("`tpf` has no cadence with enough pixels to fit")
    flux, error = np.where(good, flux, np.nan)[cadences], np.where(good, error, np.nan)[cadences]
    seen = np.isfinite(flux).any(axis=0)
    if not (np.nanmedian(flux[:, seen], axis=0) > 0).any():
        raise ValueError("no usable pixel of `tpf` has a positive median: there is no star to fit")
    series = series[cadences]
    return PixelData(
        time=series.time,
        cadenceno=series.cadenceno,
        quality=series.quality,
        flux=flux,
        flux_err=error,
        pixels=seen,
        pos_corr=_pos_corr(series.pos_corr),
        time_format=series.time_format,
        light=light[cadences],
    )


def _drop_bad_errors(flux, error):
    """Leave out pixels without a positive error."""
    with np.errstate(invalid="ignore"):
        bad = np.isfinite(flux) & ~(np.isfinite(error) & (error > 0))
    if not bad.any():
        return
    if bad.sum() == np.isfinite(flux).sum():
        raise ValueError(
            "`flux_err` must be positive: the file has no errors; pass them as flux_err=..."
        )
    warnings.warn(
        f"{bad.sum()} pixel values without a positive error are left out", FitWarning, stacklevel=4
    )
    flux[bad] = np.nan


def _drop_saturated(flux, detector):
    """Leave out the columns of pixels whose wells are full: the light runs along them."""
    limit = detector.full_flux
    with np.errstate(invalid="ignore"):
        full = flux > limit
    columns = np.flatnonzero(full.mean(axis=0).max(axis=0) > 0.01)
    if columns.size:
        warnings.warn(
            f"columns {', '.join(map(str, columns))} hold saturated pixels and are left out",
            FitWarning,
            stacklevel=4,
        )
        flux[:, :, columns] = np.nan
    flux[full] = np.nan
    if not np.isfinite(flux).any():
        raise ValueError("all columns of `tpf` hold saturated pixels or none: nothing to fit")


def _pos_corr(offsets):
    """POS_CORR with straight lines over unusable cadences, or None."""
    if offsets is None:
        return None
    good = usable_positions(offsets)
    if good.sum() < 3:
        return None
    number = np.arange(len(offsets))
    return np.column_stack([np.interp(number, number[good], column[good]) for column in offsets.T])


def detector_of(tpf):
    """The preset with the exposure, gain, read noise and background of a target pixel file."""
    series = read_pixels(tpf)
    changes = {} if series.mission else {"mission": "Kepler"}
    return Detector.from_tpf(series, psf=None, sensitivity=None, **changes)


def star_positions(name, places, series):
    """Return columns and rows of stars in a stamp, ``(k, 2)``, of `star_places` or "find"."""
    if isinstance(places, str):
        if places != "find":
            raise ValueError(f'`{name}` must be positions or "find", got {places!r}')
        found = find_stars(series.flux)
        if len(found) > _MOST_FOUND:
            message = (
                f"the {_MOST_FOUND} brightest of {len(found)} maxima of the median image are "
                f"fitted; `{name}` takes the positions of more"
            )
            warnings.warn(message, FitWarning, stacklevel=4)
        return found[:_MOST_FOUND]
    found = star_places(name, places, series)
    size = np.array(series.flux.shape[:0:-1])  # columns, rows
    far = (np.abs(found - (size - 1) / 2) - size / 2).max(axis=1, initial=-np.inf) > _FARTHEST
    if name == "stars":
        far[:1] = False  # the target, which is checked against the pixels
    if far.any():
        message = f"{far.sum()} of `{name}` are far outside of the pixels and are left out"
        warnings.warn(message, FitWarning, stacklevel=4)
    return found[~far]


def find_stars(flux):
    """Return columns and rows ``(k, 2)`` of the maxima of the median image, the brightest first."""
    good = np.isfinite(flux)
    flux = np.where(good, flux, np.nan)
    seen = good.any(axis=0)
    image, error = np.full(seen.shape, -np.inf), np.ones(seen.shape)
    image[seen] = np.nanmedian(flux[:, seen], axis=0)
    scatter = np.nanmedian(np.abs(flux[:, seen] - image[seen]), axis=0)
    error[seen] = 1.4826 * scatter / np.sqrt(np.maximum(good[:, seen].sum(axis=0), 1))
    image = image - np.median(image[seen])
    ring = np.ones((3, 3), dtype=bool)
    ring[1, 1] = False
    around = maximum_filter(image, footprint=ring, mode="constant", cval=-np.inf)
    peak = seen & (image > around)
    peak &= (image > _LEAST_PART * image[seen].max()) & (image > _LEAST_SIGNIFICANCE * error)
    rows, columns = np.nonzero(peak)
    order = np.argsort(-image[rows, columns])
    return np.column_stack([columns, rows])[order].astype(float)


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
