"""The pixels of a fit, its stars, and its starting values."""

import warnings
from dataclasses import dataclass
from functools import partial, reduce
from operator import add

import numpy as np
from astropy import units as u
from astropy.stats import mad_std
from scipy.ndimage import maximum_filter

from scope_models import models
from scope_models._arrays import plain_array
from scope_models.exceptions import FitWarning
from scope_models.fitting._problem import State, median_image
from scope_models.io.pixels import (
    PixelSeries,
    star_places,
    target_among,
    target_place,
    usable_positions,
)
from scope_models.pixelmodel._smooth import COORDINATES, nearness

__all__ = [
    "APART", "PixelData", "centroids", "continued_state", "find_stars", "is_faint", "linear_start",
    "located", "make_prf", "make_rich_prfs", "read_data", "read_places", "solved", "starting_state",
    "with_response",
]  # fmt: skip

# Maxima of the median image are stars above this part of the brightest pixel and so many errors;
# most of them: time goes with their square.
_LEAST_PART, _LEAST_SIGNIFICANCE, _MOST_FOUND = 0.05, 10.0, 11
# Pixels: maxima so near a star are its own; a given star so near the target, whose coordinates may
# be of another epoch, is it; one so far outside of the stamp has no light in it.
APART, _ITSELF, _FARTHEST = 1.5, 0.5, 5.0
_SIGMAS, _FRACTIONS = (0.5, 1.1, 2.0), (0.7, 0.25, 0.05)
# The empirical term: part of the flux, width of its first function (0.7 to 0.8 describe the real
# stars of the documentation best), and order in `make_rich_prfs`.
_EMPIRICAL_FRACTION, _EMPIRICAL_SIGMA, _RICH_ORDER = 0.02, 0.75, 6
# First positions are of pixels above this part of the brightest one, so many pixels around it, and
# where this percentile over the cadences is bright.
_BRIGHT, _NEAR, _OFTEN = 0.1, 2, 98
# Stars fainter than this part of the target are constant by default.
_FAINT = 0.1


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PixelData(PixelSeries):
    """Pixels and cadences that a fit uses, NaN where not; POS_CORR interpolated where unusable."""

    light: np.ndarray  # flux with saturated pixels
    pos_err: np.ndarray | None  # (n, 2), infinite where POS_CORR is interpolated
    pixels: np.ndarray  # (ny, nx), bool: those with data

    @property
    def shape(self):
        return self.pixels.shape


def read_data(series, flux_err, limit, moved, n_free):
    """Take the usable data of a `PixelSeries`, with positions ``moved`` and their errors."""
    flux = np.array(series.flux)
    if not np.isfinite(flux).any():
        raise ValueError("`flux` has no finite value")
    given = series.flux_err if flux_err is None else flux_err
    error = plain_array(given, u.electron / u.s, "flux_err")
    try:
        error = np.broadcast_to(error, flux.shape)
    except ValueError:
        message = f"`flux_err` must broadcast to {flux.shape}, got shape {error.shape}"
        raise ValueError(message) from None
    _drop_bad_errors(flux, error)
    light = flux.copy()
    _drop_saturated(flux, limit)
    good = np.isfinite(flux)
    cadences = np.isfinite(series.time) & (good.sum(axis=(1, 2)) > n_free)
    if not cadences.any() or good.any(axis=0).sum() <= n_free:
        raise ValueError("`tpf` has no cadence with enough pixels to fit")
    flux, error = flux[cadences], np.where(good, error, np.nan)[cadences]
    if not (median_image(flux) > 0).any():
        raise ValueError("no usable pixel of `tpf` has a positive median: there is no star to fit")
    pos_corr, pos_err = (value if value is None else value[cadences] for value in moved)
    usable = False if pos_corr is None else usable_positions(pos_corr)
    if np.sum(usable) < 3:
        pos_corr = pos_err = None
    else:  # straight lines over unusable cadences
        x, at = np.arange(len(usable)), np.flatnonzero(usable)
        pos_corr = np.column_stack([np.interp(x, at, column[at]) for column in pos_corr.T])
        if pos_err is not None:
            pos_err = np.where(usable[:, None], pos_err, np.inf)
    return PixelData(**vars(series[cadences]) | {
        "flux": flux, "flux_err": error, "light": light[cadences], "pos_corr": pos_corr,
        "pos_err": pos_err, "pixels": np.isfinite(flux).any(axis=0),
    })  # fmt: skip


def _drop_bad_errors(flux, error):
    bad = np.isfinite(flux) & ~(np.isfinite(error) & (error > 0))
    if bad.sum() == np.isfinite(flux).sum():
        message = "`flux_err` must be positive: the file has no errors; pass them as flux_err=..."
        raise ValueError(message)
    if bad.any():
        message = f"{bad.sum()} pixel values without a positive error are left out"
        warnings.warn(message, FitWarning, stacklevel=5)
    flux[bad] = np.nan


def _drop_saturated(flux, limit):
    """Leave out columns with full wells, along which the light runs."""
    full = flux > limit
    columns = np.flatnonzero(full.mean(axis=0).max(axis=0) > 0.01)
    if columns.size:
        listed = ", ".join(map(str, columns))
        message = f"columns {listed} hold saturated pixels and are left out"
        warnings.warn(message, FitWarning, stacklevel=5)
        flux[:, :, columns] = np.nan
    flux[full] = np.nan
    if not np.isfinite(flux).any():
        raise ValueError("all columns of `tpf` hold saturated pixels or none: nothing to fit")


def read_places(stars, neighbors, series, *, several):
    """Per file, the arguments of `located` that follow the data."""
    if stars is not None and neighbors is not None:
        raise ValueError("give either `stars` or `neighbors`, not both")
    name, given = ("stars", stars) if neighbors is None else ("neighbors", neighbors)
    if given is None:
        none = np.zeros((0, 2))
        return [(_by_coordinates(one, find_stars(one.flux)), none, 0.0) for one in series]
    if not several or isinstance(given, str):
        given = [given] * len(series)
    if len(given) != len(series):
        raise ValueError(f"`{name}` must be positions for each of {len(series)} files")
    return [*map(partial(_read_places, name), given, series)]


def _by_coordinates(series, peaks):
    """Return the bright maximum of the aperture near the coordinates, None if it is the first.

    These may err by 1 px, and are wrong without a maximum within twice that.
    """
    place, (columns, rows) = target_place(series), peaks.T.astype(int)
    light = median_image(series.flux)[rows, columns]
    if (inside := series.aperture[rows, columns]).any():
        light = np.where(inside, light, 0.0)
    if place is not None:
        away = (peaks - place).T
        if np.hypot(*away).min(initial=np.inf) < 2 * COORDINATES:
            light = light * nearness(*away)
    best = np.argmax(light) if len(peaks) else 0  # the first is the brightest
    return peaks[best] if best else None


def _read_places(name, places, series):
    target, own = None, APART
    if isinstance(places, str):
        if places != "find":
            raise ValueError(f'`{name}` must be positions or "find", got {places!r}')
        found = find_stars(series.flux)
        target = _by_coordinates(series, found)
        if target is not None:
            found = np.vstack([target, found[(found != target).any(axis=1)]])
        kept = np.arange(len(found)) < _MOST_FOUND
        message = (
            f"the {_MOST_FOUND} brightest of {len(found)} maxima of the median image are "
            f"fitted; `{name}` takes the positions of more"
        )
    else:
        found, own = star_places(name, places, series), _ITSELF
        size = np.array(series.flux.shape[:0:-1])  # columns, rows
        kept = (np.abs(found - (size - 1) / 2) - size / 2 <= _FARTHEST).all(axis=1)
        if name == "stars":
            kept[:1] = True  # the target, which is checked against the pixels
        elif (on_sky := target_among(places, series)) is not None:
            itself = np.hypot(*(found - on_sky).T) <= _ITSELF
            found, kept = found[~itself], kept[~itself]
            peaks = find_stars(series.flux)
            target = next(iter(peaks[np.hypot(*(peaks - on_sky).T) <= APART]), None)
        message = f"{(~kept).sum()} of `{name}` are far outside of the pixels and are left out"
    if not kept.all():
        warnings.warn(message, FitWarning, stacklevel=4)
    if name == "neighbors":
        return target, found[kept], own
    if not kept.any():
        raise ValueError("`stars` must have at least the target")
    return found[0], found[1:][kept[1:]], -np.inf


def located(data, target, others, own):
    """Return where the target is sought, None for the brightest light; its center; other stars.

    Those within ``own`` pixels are the target; but a given star at the brightest light is another
    one if there is light of no given star.
    """
    center = np.median(centroids(data, target, others), axis=0)
    itself = np.hypot(*(others - center).T) <= own
    if target is None and own < APART and itself.any():
        peaks = find_stars(data.light)
        apart = (np.hypot(*(peaks[:, None] - others).T) > APART).all(axis=0)
        if apart.any():
            return located(data, peaks[apart][0], others, own)
    return target, center, others[~itself]


def find_stars(flux):
    good = np.isfinite(flux)
    if not good.any():
        return np.zeros((0, 2))
    seen, image, error = good.any(axis=0), median_image(flux), np.ones(flux.shape[1:])
    scatter = mad_std(np.where(good, flux, np.nan)[:, seen], axis=0, ignore_nan=True)
    error[seen] = scatter / np.sqrt(good.sum(axis=0)[seen])
    image = np.where(seen, image - np.median(image[seen]), -np.inf)
    ring = np.ones((3, 3), dtype=bool)
    ring[1, 1] = False
    peak = seen & (image > maximum_filter(image, footprint=ring, mode="constant", cval=-np.inf))
    peak &= (image > _LEAST_PART * image[seen].max()) & (image > _LEAST_SIGNIFICANCE * error)
    rows, columns = np.nonzero(peak)
    order = np.argsort(-image[rows, columns])
    return np.column_stack([columns, rows])[order].astype(float)


def make_prf(psf, sensitivity, empirical):
    if isinstance(psf, (models.PRF, models.TabulatedPRF)):
        return _given_prf(psf, sensitivity, empirical)
    known = models.SensitivityPolynomial, models.DiffusionSensitivity, type(None)
    if not isinstance(sensitivity, known):
        wanted = "a SensitivityPolynomial, a DiffusionSensitivity or None"
        raise TypeError(f"`sensitivity` must be {wanted}, got {sensitivity!r}")
    fixed = {}
    if isinstance(psf, int):
        if isinstance(psf, bool) or not 1 <= psf <= len(_SIGMAS):
            raise ValueError(f"`psf` must be 1, 2 or 3 components or a model, got {psf!r}")
        fixed |= {f"{axis}_offset_{k}": False for axis in "xy" for k in range(1, psf)}
        parts = [*zip(_FRACTIONS, _SIGMAS, strict=True)][:psf]
        psf = reduce(add, (models.BivariateGaussianPSF(part, 0, 0, s, s) for part, s in parts))
    if empirical:
        # A change of its flux or width is one of the coefficients, which are linear.
        number, sigma = models.PRF(psf).n_components, _EMPIRICAL_SIGMA
        psf = psf + models.GaussHermitePSF(_EMPIRICAL_FRACTION, 0, 0, sigma, sigma, order=empirical)
        fixed |= {f"{name}_{number}": True for name in ("flux_fraction", "sigma_x", "sigma_y")}
    prf = models.PRF(psf if sensitivity is None else psf * sensitivity, flux=1, x_0=0, y_0=0)
    if sensitivity is not None:
        fixed |= {name: bool(value) for name, value in sensitivity.fixed.items()}
    return _with_fixed(prf, fixed)


def _given_prf(prf, sensitivity, order):
    prf = prf if isinstance(prf, models.PRF) else models.PRF(prf)
    if sensitivity is not None:
        raise ValueError("`sensitivity` must be left out if `psf` is a PRF")
    table = prf.table
    if order and table is None:
        raise ValueError("`empirical` must be left out if `psf` is a PRF but not a table")
    if order:
        values = (getattr(table, name).value for name in ("flux", "x_0", "y_0"))
        more = {"origin": table.origin, "uncertainty": table.uncertainty, "order": order}
        prf = models.PRF(models.CorrectedPRF(table.array, table.oversampling, *values, **more))
    return _with_fixed(prf.copy(), {})


def make_rich_prfs(sensitivity):
    """Models of a Gaussian and an empirical term.

    Around a Gaussian of another width the term has rings, so that it is free in the first model;
    with the fixed one of the second all but the positions is linear: nothing ends at a bound.
    """
    for held in (False, True):
        sigma, fixed = _SIGMAS[0], dict.fromkeys(("sigma_x", "sigma_y", "rho"), held)
        psf = models.BivariateGaussianPSF(1 - _EMPIRICAL_FRACTION, 0, 0, sigma, sigma, fixed=fixed)
        for name in ("sigma_x", "sigma_y"):  # a wider one would be background
            psf.bounds[name] = (psf.bounds[name][0], _SIGMAS[1])
        yield make_prf(psf, sensitivity, _RICH_ORDER)


def with_response(prf):
    other = models.PRF(prf.psf * models.SensitivityPolynomial([1, 0, 0], [1, 0, 0]))
    for name in prf.param_names:
        getattr(other, name).bounds = getattr(prf, name).bounds
    return _with_fixed(other, dict.fromkeys(other.response_powers, False) | dict(prf.fixed))


def _with_fixed(prf, fixed):
    """Fix parameters of a PRF, constants of its response, and diffusion beside a free width."""
    kinds = prf.parameter_kinds
    held = {name for name, (_, power) in prf.response_powers.items() if power == 0}
    if any(kind == "width" and not getattr(prf, name).fixed for name, kind in kinds.items()):
        held |= {name for name, kind in kinds.items() if kind == "diffusion"}
    for name, value in (fixed | dict.fromkeys(held, True)).items():
        getattr(prf, name).fixed = value
    return prf


def starting_state(problem):
    """Positions from centroids, fluxes from linear fits, the rest from the model."""
    xy, positions = centroids(problem.data, *problem.places), problem.options.positions
    shared = np.array([p.start for p in problem.parameters])
    if problem.data.pos_corr is not None and positions != "free":
        fitted = _path(problem, xy)
        if positions != "start":
            shared[problem.affine] = fitted.T.ravel()
        xy = problem.basis @ fitted
    return _at(problem, xy, np.clip(shared, *problem.bounds), np.zeros(problem.n_pixels))


def continued_state(problem, solution):
    """Return the state of all cadences from the solution for some of them."""
    if problem.data.pos_corr is None or problem.options.positions == "free":
        xy = centroids(problem.data, *problem.places)
    else:
        xy = problem.basis @ _path(solution.problem, solution.state.cadence[:, :2])
    return _at(problem, xy, solution.state.shared, solution.state.interpixel)


def _path(problem, xy):
    """Return positions as a linear function of POS_CORR, without outliers: ``(3, 2)``."""
    good = np.ones(len(xy), dtype=bool)
    for _ in range(5):  # of four standard deviations
        fitted = np.linalg.lstsq(problem.basis[good], xy[good], rcond=None)[0]
        distance = np.hypot(*(xy - problem.basis @ fitted).T)
        good = distance <= 6 * np.median(distance) + 1e-6
    return fitted


def _at(problem, xy, *shared):
    cadence = np.zeros((len(xy), len(problem.columns)))
    cadence[:, :2] = xy
    return linear_start(problem, State(*shared, cadence))


def centroids(data, place=None, others=()):
    """First moments of bright pixels around the brightest, or near a place, ``(n, 2)``.

    Pixels nearer to one of the ``others``, which may be brighter, are not near the place.
    """
    image = median_image(data.light)
    if image.max() <= 0:
        raise ValueError("no pixel of `tpf` has a positive median flux: there is no star to fit")
    flux = np.where(np.isfinite(data.light), data.light, image)
    rows, columns = (index.ravel() for index in np.indices(image.shape))
    image, flux = image.ravel(), flux.reshape(len(flux), -1)
    if place is not None:
        apart = [other for other in others if np.hypot(*np.subtract(other, place)) > APART]
        away = [np.hypot(columns - x, rows - y) for x, y in (place, *apart)]
        near = away[0] <= _NEAR
        if not near.any():
            at = f"({place[0]:.6g}, {place[1]:.6g})"
            raise ValueError(f"no pixel is within {_NEAR} px of the star at {at}")
        own = near & (away[0] <= np.min(away, axis=0))
        near = own if own.any() else near
        image, flux = image * near, flux * near
    # Where the star is for some time; cosmic rays are elsewhere, most often.
    often = np.percentile(flux, _OFTEN, axis=0)
    flux = np.where(often > _BRIGHT * often.max(), flux, -np.inf)
    peak = flux.argmax(axis=1)
    near = np.abs(rows - rows[peak, None]) <= _NEAR
    near &= np.abs(columns - columns[peak, None]) <= _NEAR
    light = near * np.maximum(flux - _BRIGHT * flux.max(axis=1, keepdims=True), 0.0)
    light[light.sum(axis=1) <= 0] = np.maximum(image, 0.0)
    light /= light.sum(axis=1, keepdims=True)
    return np.column_stack([light @ columns, light @ rows])


def is_faint(data, target, other):
    image = median_image(data.light)
    row, column = np.indices(image.shape)
    near = [image[np.hypot(column - x, row - y) <= 1.0].max(initial=0) for x, y in (target, other)]
    return near[1] < _FAINT * near[0]


def linear_start(problem, state):
    shared, cadence, k = state.shared.copy(), state.cadence.copy(), len(problem.columns)
    files = problem.slices if problem.options.background == "cadence" else ()
    columns = [*map(problem.flux_number, range(len(problem.stars)))]
    columns += map(problem.background_number, range(len(files)))
    values = np.zeros((len(problem.flux), len(columns)))
    for part in problem.chunks():
        design = np.zeros((*problem.flux[part].shape, len(columns)))
        for i, star in enumerate(problem.stars):
            design[:, problem.slices[star.stamp], i] = problem.unit_images(state, part, i)
        for i, pixels in enumerate(files, start=len(problem.stars)):
            design[:, pixels, i] = 1.0
        weight = problem.weight[part]
        design = (design * weight[..., None]).transpose(0, 2, 1)
        right = design @ (weight * problem.flux[part])[..., None]
        values[part] = solved(design @ design.transpose(0, 2, 1), right)[..., 0]
    for value, column in zip(values.T, columns, strict=True):
        if column < k:
            cadence[:, column] = value
        else:  # of a constant star
            shared[column - k] = np.median(value)
    return State(shared, state.interpixel, cadence)


def solved(normal, right):
    """Solve small systems whose diagonals are scaled to 1."""
    index = np.arange(normal.shape[1])
    scale = np.maximum(normal[:, index, index], 1e-300)[..., None] ** -0.5
    matrix = normal * scale * scale.transpose(0, 2, 1)
    matrix[:, index, index] = 1 + 1e-10
    return scale * np.linalg.solve(matrix, scale * right)
