"""Light of other stars in a star's pixels, by a model of all of them."""

import warnings
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from os import PathLike
from pathlib import Path

import numpy as np
from astropy.table import QTable

from scope_models.correctors._pixels import at_one_place, typical_image, without_background
from scope_models.correctors._stars import NEAREST, SHARE_ERROR, center_of_light, stars_of
from scope_models.exceptions import DetrendingWarning
from scope_models.fitting import FitOptions, fit_tpf
from scope_models.io.pixels import read_neighbors, star_places, target_among, usable_positions
from scope_models.models import PRF, BivariateGaussianPSF, GaussHermitePSF
from scope_models.pixelmodel._position import nearness, polynomials
from scope_models.pixelmodel._stamp import POSITION_PRIOR

__all__ = ["NeighborLight", "given_neighbors", "light_of_neighbors", "without_neighbors"]

#: Branch: given neighbors closer to the target (px) are the target, and those farther outside of
#: the pixels have no light in them.
_TARGET_ITSELF, _FARTHEST = 0.3, 5.0
#: Branch: standard deviation from which on a star varies: what its position is uncertain by
#: (0.02 px) times the change of the aperture's light with position (0.05 per px).
_VARIES = 0.02 * 0.05
#: Branch: standard deviations of what counts as seen, by a jackknife of so many parts of the time.
_SEEN, _PARTS = 3.0, 10
#: Prior: the PSF is two Gaussians of these parts of the light and widths (px), to begin with, and
#: an empirical term of this order and width, whose coefficients have standard deviations of ten
#: times this part: with them the light of a neighbor 2 px away is right to 0.7 % of the star's for
#: official PRFs of TESS (camera 2, CCD 3), to 5 % without.
_GAUSSIANS, _ORDER, _EMPIRICAL = ((0.7, 0.5), (0.3, 1.1)), 6, (6e-4, 0.75)
#: Tolerance: cadences that show the PSF, and steps of each stage of its fit at most.
_FEW, _STEPS = 100, 15


@dataclass(frozen=True, eq=False)
class NeighborLight:
    """Other stars of a stamp.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Flux (e-/s), column and row in the stamp (px) of each, ``flux, x, y``.
    light : ndarray
        Their light in each pixel, e-/s, ``(n_cadences, ny, nx)``.
    positions : ndarray
        Column and row of the target in the stamp, ``(n_cadences, 2)``, px; NaN where unknown.
    """

    table: QTable
    light: np.ndarray
    positions: np.ndarray


def without_neighbors(pixels, series, found):
    """Return pixels and file without the light of other stars; with positions if it has none."""
    flux = pixels.flux - found.light
    inside = pixels.aperture if pixels.weights is None else pixels.weights
    light = np.sum(found.light * inside, axis=(1, 2))
    total = pixels.total - light
    usable = pixels.usable & (np.nan_to_num(total) > 0)
    lit = pixels.lit & usable & (np.nan_to_num(total) > SHARE_ERROR * light)
    share = float(np.median((total / pixels.total)[usable])) if usable.any() else 1.0
    pixels = replace(
        pixels, flux=flux, total=total, usable=usable, lit=lit,
        own=np.ones_like(pixels.aperture), crowding=min(share, 1.0), neighbors=found,
    )  # fmt: skip
    positions = series.pos_corr
    if positions is None or not usable_positions(positions).any():
        positions = found.positions - np.nanmedian(found.positions, axis=0)
    return pixels, series.replace(flux=flux, pos_corr=positions)


def given_neighbors(neighbors, series, pixels):
    """Return "find", or the places of a user's neighbors: a file, or as `star_places` takes them.

    Those on the sky are as far from the target in the pixels as the coordinates place them.
    """
    if isinstance(neighbors, str | PathLike):
        if neighbors == "find":
            return neighbors
        if not Path(neighbors).is_file():
            accepted = '"find", positions, a table, or the file of a table'
            raise ValueError(f"`neighbors` must be {accepted}, got {str(neighbors)!r}")
        neighbors = read_neighbors(neighbors, series)
    places, target = star_places("neighbors", neighbors, series), target_among(neighbors, series)
    image = typical_image(without_background(pixels.flux[pixels.usable]))
    star = center_of_light(np.nan_to_num(image), pixels.core)
    if target is not None:
        places = places + star - target
    if np.any(np.hypot(*(places - star).T) < _TARGET_ITSELF):
        raise ValueError(
            f"`neighbors` must not hold the target itself: one is within {_TARGET_ITSELF} px of it"
        )
    size = np.array(pixels.core.shape[::-1])
    far = (np.abs(places - (size - 1) / 2) - size / 2 > _FARTHEST).any(axis=1)
    if far.any():
        message = f"{far.sum()} of `neighbors` are far outside of the pixels and are left out"
        warnings.warn(message, DetrendingWarning, stacklevel=3)
    return places[~far]


def light_of_neighbors(pixels, series, cadence_mask, neighbors=None):
    """Fit a PSF at the places of the target and its neighbors to the pixels near it.

    Parameters
    ----------
    pixels : Pixels
        Pixels and aperture.
    series : PixelSeries
        Their file.
    cadence_mask : ndarray of bool
        Cadences from which the stars' image and places are learned.
    neighbors : ndarray or "find", optional
        Columns and rows of other stars, ``(k, 2)``. None: those with peaks of their own are found,
        and those whose light does not follow the star's, for the bumps of a PRF look like neighbors
        of up to 20 % of a star's light (official PRFs of TESS, camera 2, CCD 3); "find": all.

    Returns
    -------
    NeighborLight or None
        None if there are none.

    Raises
    ------
    ValueError
        If given neighbors do not describe the pixels of the file.
    """
    given, usable = not isinstance(neighbors, str | None), pixels.usable
    use = pixels.quiet(cadence_mask & pixels.lit & usable)
    use &= pixels.total > np.median(pixels.total[use]) / 2  # the rest of an eclipse may be others'
    pos_corr = series.pos_corr
    if pos_corr is not None:
        known = usable_positions(pos_corr)
        pos_corr = np.where(known[:, None], pos_corr, np.nan) if known[use].any() else None
    flux = np.full(pixels.flux.shape, np.nan)
    flux[usable] = without_background(pixels.flux[usable])
    everywhere = isinstance(neighbors, str)
    if neighbors is None:
        light = flux[usable][:, pixels.aperture]
        everywhere = _holds_constant_light(light, None if pos_corr is None else pos_corr[usable])
    if not (given or everywhere) and pixels.own.all():
        return None
    far = np.ones(flux.shape[1:], dtype=bool)
    far[pixels.near] = False
    flux[:, far] = np.nan
    near = series.replace(flux=flux, flux_err=pixels.flux_err, pos_corr=pos_corr)
    image = typical_image(flux[use]) if pos_corr is None else at_one_place(flux[use], pos_corr[use])
    image = np.nan_to_num(image)
    try:
        if given:
            stars = np.vstack([center_of_light(image, pixels.core), neighbors])
        else:
            stars = _found(image, pixels, everywhere)
        few = np.flatnonzero(use)
        found = _separated(near[few[:: -(-len(few) // _FEW)]], stars, given=given)
        if found is None:
            return None
        prf, stars, fluxes = found
        fit = _fit(near[usable], stars, prf)
    except (ValueError, np.linalg.LinAlgError):
        if not given:
            return None
        message = "the target and the given `neighbors` do not describe the pixels"
        raise ValueError(message) from None
    fitted = usable & np.isin(series.cadenceno, fit.cadenceno)
    light, positions = np.zeros(flux.shape), np.full((len(flux), 2), np.nan)
    positions[fitted] = np.column_stack([fit.x, fit.y])
    for one, (dx, dy) in zip(fluxes, stars[1:] - stars[0], strict=True):
        light[fitted] += one * prf.unit_images(fit.shape, fit.x + dx, fit.y + dy)
    places, units = stars[1:] + _center_of(prf), ("electron / s", "pix", "pix")
    table = QTable([fluxes, *places.T], names=("flux", "x", "y"), units=units)
    return NeighborLight(table, light, positions)


def _found(image, pixels, everywhere):
    """Return the places of the stars in an image, the target first, ``(k, 2)``.

    That is the star at the file's coordinates.
    """
    stars = stars_of(image, pixels.core, everywhere | ~pixels.own)
    if pixels.place is not None:
        columns, rows = np.rint(stars).astype(int).T
        seen = image[np.clip(rows, 0, len(image) - 1), np.clip(columns, 0, image.shape[1] - 1)]
        target = np.argmax(seen * nearness(*(stars - pixels.place).T))
        stars = np.vstack([stars[target], np.delete(stars, target, axis=0)])
    return stars


def _separated(series, stars, *, given):
    """Return a PRF whose shape is fixed, the places of all stars, and fluxes of the neighbors.

    Neighbors that are not ``given`` and end up at another star or without light were bumps of the
    PSF. None is returned if there are no others.
    """
    while len(stars) > 1:
        fit = _fit(series, stars, _first_prf())
        both = fit, *fit.neighbors
        stars = np.array([np.median([star.x, star.y], axis=1) for star in both])
        fluxes = np.array([np.median(star.flux) for star in both])
        kept = (np.hypot(*(stars - stars[0]).T) > NEAREST) & (fluxes > 0) | given
        kept[0] = True
        if kept.all():
            prf = fit.model.copy()
            for name in prf.param_names:
                getattr(prf, name).fixed = True
            return prf, stars, np.maximum(fluxes[1:], 0.0)
        stars = stars[kept]
    return None


def _center_of(prf):
    """Return the center of light of a PRF, relative to its place."""
    image = prf.unit_images((41, 41), [20.0], [20.0])[0]
    rows, columns = np.indices(image.shape)
    return np.array([np.sum(image * columns), np.sum(image * rows)]) / image.sum() - 20


def _first_prf():
    """Return the PRF from which a fit begins."""
    psf = reduce(add, (BivariateGaussianPSF(part, 0, 0, s, s) for part, s in _GAUSSIANS))
    part, width = _EMPIRICAL
    prf = PRF(psf + GaussHermitePSF(part, 0, 0, width, width, order=_ORDER))
    for name in ("sigma_x_2", "sigma_y_2", "flux_fraction_2"):
        getattr(prf, name).fixed = True
    for name in ("x_offset_1", "y_offset_1"):
        getattr(prf, name).fixed = False
    return prf


def _fit(series, stars, prf):
    """Fit a PRF to stars, of which all but the first are of constant flux."""
    moves = series.pos_corr is not None and np.nanstd(series.pos_corr, axis=0).all()
    options = FitOptions(
        neighbor_flux="constant", saturation=False, position_error=POSITION_PRIOR, max_steps=_STEPS
    )
    with warnings.catch_warnings(action="ignore"):
        return fit_tpf(
            series, prf, stars=stars, positions="prior" if moves else "free", response="psf",
            interpixel=0.0, options=options, progress=False,
        )  # fmt: skip


def _holds_constant_light(light, pos_corr):
    """Return whether a star varies, and pixels of its aperture, ``(n, m)``, hold constant light.

    A star's pixels are its light times functions of position. Centroids follow constant light, so
    that only POS_CORR counts. The star varies if that is more than errors of POS_CORR make.
    """
    light = np.nan_to_num(light)
    total = light.sum(axis=1)
    light, total = light / np.median(total), total / np.median(total)
    functions = np.ones((len(total), 1))
    if pos_corr is not None and np.isfinite(pos_corr).all(axis=1).mean() > 0.5:
        known = np.isfinite(pos_corr).all(axis=1)
        total, light = total[known], light[known]
        offset = pos_corr[known] - np.median(pos_corr[known], axis=0)
        functions = polynomials(offset / max(np.abs(offset).max(), 1e-9))
    columns = np.column_stack([np.ones(len(total)), functions * total[:, None]])
    if len(total) < _PARTS * columns.shape[1]:
        return False
    rest = total - functions @ np.linalg.lstsq(functions, total, rcond=None)[0]
    if np.var(rest) - np.mean(np.diff(rest) ** 2) / 2 < _VARIES**2:
        return False
    parts = np.array_split(np.arange(len(columns)), _PARTS)
    gram = np.array([columns[k].T @ columns[k] for k in parts])
    right = np.array([columns[k].T @ light[k] for k in parts])
    ridge = 1e-10 * np.diag(np.maximum(np.diag(gram.sum(axis=0)), 1e-300))
    constant = np.linalg.solve(gram.sum(axis=0) + ridge, right.sum(axis=0))[0]
    without = np.linalg.solve(gram.sum(axis=0) - gram + ridge, right.sum(axis=0) - right)[:, 0]
    error = np.sqrt((1 - 1 / _PARTS) * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    return bool((np.abs(constant) > _SEEN * error).any())
