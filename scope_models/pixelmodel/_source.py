"""The star's own light in the pixels, apart from that of other stars, and its fractions."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from scope_models.exceptions import DetrendingWarning
from scope_models.photometry import aperture_flux
from scope_models.pixelmodel._pixels import (
    OTHER_STAR,
    Pixels,
    at_one_place,
    at_rows,
    background_plane,
    own_pixels,
    typical_image,
)
from scope_models.pixelmodel._smooth import ROUNDS
from scope_models.pixelmodel._stamp import (
    POSITION_PRIOR,
    find_row_centers,
    rows_of_star,
    without_saturation,
)
from scope_models.pixelmodel._star import IMAGE_ERROR, fit_star

__all__ = [
    "NEAREST", "PLACE", "SHARE_ERROR", "Source", "can_predict", "center_of_light", "star_share",
    "stars_of", "with_predicted_fractions",
]  # fmt: skip

#: Prior: relative error of profiles, of PRFs and of images. Official PRFs of TESS (camera 2, CCD 3)
#: differ from sums of Gaussians by 0.1 of the peak in the core, 0.03 at 2.5 px and 0.001 at 5 px.
SHARE_ERROR = 0.03
#: Branch: least distance of separate stars (px), and largest number of stars.
NEAREST, _MOST = 1.4, 7
#: Branch: what stars leave is another one if it is so many times their light there.
_OVER_STAR = 0.7
#: Tolerance: number of places that are tried for another star.
_MOST_PLACES = 12
#: Prior: standard deviation of a place about the first guess, px.
PLACE = 0.3
#: Tolerance: widths of the Gaussians whose sum is the profile, in units of the star's, and standard
#: deviation of the window in which that is measured (px).
_WIDTHS, _WINDOW = (0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0), 1.5
#: Tolerance: bounds of one over the width, 1/px.
_SHARPNESS = (1 / 2.0, 1 / 0.3)
#: Branch: as many pixels as a cadence has unknowns show none of them: brightness, place, width and
#: background.
_STATES = 5


@dataclass(frozen=True)
class Source:
    """What a star's light is learned from."""

    pixels: Pixels  # as measured
    series: object  # their file
    cadence_mask: np.ndarray  # cadences from which images are learned

    @cached_property
    def _image(self):
        """Typical image less background, its background, and the star's share in each pixel."""
        pixels, places = self.pixels, self.series.pos_corr
        typical = typical_image(pixels.flux[pixels.usable])
        plane = background_plane(typical)
        image, share = np.nan_to_num(typical - plane), np.ones(typical.shape)
        still, full = image, self.series.mission and self.series.mission.full_flux
        if places is not None and np.isfinite(places[pixels.usable]).any():
            still = at_one_place(pixels.flux[pixels.usable], places[pixels.usable])
            still = np.nan_to_num(still - plane)
        alone = pixels.own.all()
        if alone and full is not None and still.max() >= full:
            return image, plane, share  # charge that has bled looks like a star
        try:
            if alone:
                stars = _blend_of(still, pixels.core)
            else:
                stars = stars_of(still, pixels.core, ~pixels.own)
            if len(stars) > 1:
                share = star_share(image, stars)
        except NoLightError:
            pass
        return image, plane, share

    @property
    def share(self):
        """The star's share of the light in each pixel."""
        return self._image[2]

    @cached_property
    def other_light(self):
        """Part of the aperture's light that is other stars', as the typical image shows it."""
        image, _, share = self._image
        inside = self.pixels.aperture
        return float(np.clip(1 - (image * share)[inside].sum() / image[inside].sum(), 0.0, 1.0))

    def light(self, clean):
        """Return all stars' light in each pixel, e-/s."""
        light = self.pixels.flux - self._image[1]
        if clean is not None:
            use, (columns, rows) = np.flatnonzero(self.pixels.usable)[:, None], clean.grid.T
            light[use, rows, columns] = self.pixels.flux[use, rows, columns] - clean.background
        return light

    @property
    def contrast_error(self):
        """The uncertain part of the light that was not taken off, or may be none."""
        if self.pixels.neighbors is None:
            return self.other_light
        return float(np.hypot(self.other_light, SHARE_ERROR * (1 / self.pixels.crowding - 1)))

    def dimmed(self, signal, clean):
        """Return the pixels with the star's light times a signal ``(n_cadences,)``."""
        pixels = self.pixels
        flux = pixels.flux + self.light(clean) * self.share * (signal - 1)[:, None, None]
        total, _ = aperture_flux(flux, pixels.inside, pixels.flux_err)
        usable = pixels.usable & (np.nan_to_num(total) > 0)
        return replace(pixels, flux=flux, total=total, usable=usable)


class NoLightError(ValueError):
    """No profile with positive flux describes the pixels of the target."""


def stars_of(image, core, elsewhere):
    """Return columns and rows of stars in an image without background, that in the core first.

    Stars have peaks of their own, or hold most of the light ``elsewhere``.
    """
    places = [center_of_light(image, star) for star in _with_peaks(image, core)]
    light, places, _ = _fit(image, places)
    while len(places) < _MOST:
        light = light.sum(axis=0)
        rest = np.where(elsewhere & _away(image, places), image - light, 0.0)
        star = (rest > _OVER_STAR * light) & (rest > OTHER_STAR * image.max())
        if not star.any():
            break
        place = np.unravel_index(np.argmax(rest * star), image.shape)[::-1]
        light, moved, _ = _fit(image, np.vstack([places, place]))
        row, column = np.clip(np.rint(moved[-1, ::-1]).astype(int) + 1, 0, np.add(image.shape, 1))
        if not np.pad(elsewhere, 1)[row, column]:
            break
        places = moved
    return places


def _blend_of(image, core):
    """Return the same, where another star has no peak of its own.

    It is there if one profile, which may be elliptical but is the same on both sides, does not
    describe the image within its error, and two of them leave less than half.
    """
    places = np.array([center_of_light(image, core)])
    misfit = _fit(image, places)[2]
    least = np.mean(misfit**2)
    if least < 1:
        return places
    pair, least = places, least / 2
    bright = _away(image, places) & (image > OTHER_STAR * image.max())
    order = np.argsort(np.where(bright, -misfit, np.inf), axis=None)
    for other in order[: min(bright.sum(), _MOST_PLACES)]:
        trial = np.vstack([places, np.unravel_index(other, image.shape)[::-1]])
        try:
            misfit = _fit(image, trial, move=False)[2]
        except NoLightError:
            continue
        if np.mean(misfit**2) < least:
            pair, least = trial, np.mean(misfit**2)
    return pair


def _away(image, places):
    """Return the pixels that are apart from all places."""
    rows, columns = np.indices(image.shape)
    return np.all([np.hypot(columns - x, rows - y) > NEAREST for x, y in places], axis=0)


def star_share(image, places):
    """Return the first star's share of the light in each pixel of such an image."""
    light, *_ = _fit(image, places, move=False)
    return light[0] / np.maximum(light.sum(axis=0), 1e-12 * light.sum())


def _with_peaks(image, core):
    """Return the pixels of each star with a peak of its own, that in the core first."""
    peak = int(np.argmax(np.where(core, image, -np.inf)))
    stars = [own_pixels(image, peak)]
    left = ~stars[0]
    while left.any():
        other = int(np.argmax(np.where(left, image, -np.inf)))
        if image.flat[other] < OTHER_STAR * image.flat[peak]:
            break
        stars.append(own_pixels(image, other) & left)
        left &= ~stars[-1]
    return stars


def center_of_light(image, star):
    """Return column and row of the center of light of 3 x 3 pixels about a star's peak."""
    image = np.where(star, image, 0.0)
    row, column = np.unravel_index(np.argmax(image), image.shape)
    rows, columns = np.indices(image.shape)
    near = (np.abs(rows - row) <= 1) & (np.abs(columns - column) <= 1)
    weight = np.where(near, np.maximum(image, 0.0), 0.0)
    return np.array([np.sum(weight * columns), np.sum(weight * rows)]) / weight.sum()


def _fit(image, places, *, move=True):
    """Fit stars of one profile, first learned next to the first star, and if they ``move`` places.

    Return their light ``(k, ny, nx)``, places, and what they leave of the image, in standard
    deviations.
    """
    rows, columns = np.indices(image.shape)
    places = np.array(places, dtype=float)
    near = np.argmin([np.hypot(columns - x, rows - y) for x, y in places], axis=0) == 0
    total = image[near].sum()
    if not total > 0:
        raise NoLightError("the pixels of `tpf` hold no light of the target")
    own = np.where(near, image, 0.0)
    error = SHARE_ERROR * np.abs(image) + IMAGE_ERROR * total

    def solved(parts, values, precision=()):
        """Return the coefficients of parts of the image, ``(k, ny, nx)``, with their priors."""
        matrix, k = (parts / error).reshape(len(parts), -1), len(parts)
        gram = matrix @ matrix.T + np.diag([*precision, *[1e-12] * (k - len(precision))])
        return np.linalg.solve(gram, matrix @ (values / error).ravel())

    flux = np.zeros(len(places))
    for _ in range(ROUNDS):
        x, y = places[0]
        profile = _profile((columns - x)[near], (rows - y)[near], own[near] / total)

        def stars(dx=0.0, dy=0.0, profile=profile, places=places):
            return np.array([profile(columns - x - dx, rows - y - dy) for x, y in places])

        light, last = stars(), flux
        flux = np.maximum(solved(light, image), 0.0)
        light *= flux[:, None, None]
        rest = image - light.sum(axis=0)
        change = np.abs(flux - last).max() / max(flux.max(), 1e-12 * total)
        if move and len(places) > 1:
            h = POSITION_PRIOR
            slopes = [stars(h) - stars(-h), stars(0, h) - stars(0, -h)]
            slopes = np.concatenate(np.array(slopes) * flux[:, None, None] / (2 * h))
            step = solved(np.concatenate([slopes, light]), rest, [PLACE**-2] * len(slopes))
            step = np.clip(step[: len(slopes)].reshape(2, -1).T, -PLACE, PLACE)
            places += step
            # its pixels show the profile
            places[0] = np.clip(places[0], -1, image.shape[::-1])
            change = max(change, np.abs(step).max())
        if len(places) == 1 or change < POSITION_PRIOR:
            break
        near = np.ones_like(near)
        own = image * light[0] / np.maximum(light.sum(axis=0), 1e-12 * total)
    return light, places, rest / error


def _profile(u, v, values):
    """Fit a non-negative sum of Gaussians of one shape, and a constant for the background's rest.

    Values are light over a star's flux, at distances from it (px); return the function of these,
    without the constant.
    """
    window = np.exp(-0.5 * (u**2 + v**2) / _WINDOW**2) * np.clip(values, 0, None)
    if not window.sum() > 0:
        raise NoLightError("the pixels of `tpf` hold no light of the target")
    moments = np.array([[np.sum(window * a * b) for a in (u, v)] for b in (u, v)]) / window.sum()
    # strips of one row or column have no extent across
    inverse = np.linalg.inv(moments + 1e-6 * np.eye(2)) - np.eye(2) / _WINDOW**2
    eigen, vectors = np.linalg.eigh(inverse)
    inverse = (vectors * np.clip(eigen, *np.square(_SHARPNESS))) @ vectors.T
    area = 2 * np.pi / np.sqrt(np.linalg.det(inverse))

    def gaussians(u, v):
        square = inverse[0, 0] * u**2 + 2 * inverse[0, 1] * u * v + inverse[1, 1] * v**2
        return np.stack([np.exp(-0.5 * square / s**2) / (area * s**2) for s in _WIDTHS], axis=-1)

    weight = 1 / (SHARE_ERROR * np.abs(values) + IMAGE_ERROR)
    columns = np.column_stack([gaussians(u, v), np.ones(len(u))]) * weight[:, None]
    q, r = np.linalg.qr(columns)
    bounds = (np.append(np.zeros(len(_WIDTHS)), -np.inf), np.inf)
    found = lsq_linear(r, q.T @ (values * weight), bounds, method="bvls").x[:-1]
    return lambda u, v: gaussians(u, v) @ found


def can_predict(pixels, saturation, use):
    """Whether pixel fractions can be predicted, learned from the cadences in ``use``.

    Not with few pixels, of which full columns are one each, without FLUX_ERR, nor for a moving
    aperture over full columns.
    """
    flux, error = pixels.flux[use][:, pixels.aperture], pixels.flux_err[use]
    full = pixels.full_columns(use, saturation)
    seen = _seen(pixels)
    n_pixels = (seen & full).any(axis=0).sum() + (seen & ~full).sum()
    if n_pixels <= _STATES or (pixels.weights is not None and full.any()):
        return False
    return np.ptp(flux, axis=0).max() > 0 and bool((error > 0).any())


def _seen(pixels):
    """Return the pixels with data that may show the star."""
    seen = np.zeros_like(pixels.aperture)
    seen[pixels.near] = True
    return seen & np.isfinite(pixels.flux[pixels.usable]).all(axis=0)


def with_predicted_fractions(pixels, pos_corr, learned, saturation):
    """Return the star's light with predicted pixel fractions in place of the measured pixels.

    Images are ``learned`` from some cadences. The ``total`` of the returned pixels is the light
    without background, their ``flux`` the predicted fractions at constant focus times this. Second
    comes the `StarModel`; None, with the pixels as they were, if it fails.
    """
    use = pixels.usable
    full = pixels.full_columns(learned, saturation)
    # others do not vary with this one
    known = _seen(pixels) & (pixels.aperture | pixels.own & ~full)
    rows, columns = np.nonzero(known)
    if pos_corr is None:
        pos_corr = np.full((len(use), 2), np.nan)
    error = pixels.flux_err[use][:, known]
    error = np.where(error > 0, error, np.nan)
    typical = typical_image(error)
    typical[np.isnan(typical)] = np.nanmedian(typical)
    error = np.where(np.isnan(error), typical, error)
    try:
        with np.errstate(all="ignore"):  # of a model that fails
            clean = fit_star(
                pixels.time[use],
                pixels.flux[use][:, known],
                error,
                pos_corr[use],
                np.stack([columns, rows], axis=1),
                pixels.aperture[known],
                use=pixels.quiet(learned)[use],
                banded=pixels.banded[use],
                full=full[columns],
            )
    except (np.linalg.LinAlgError, ValueError):  # singular, or no number
        clean = None
    if clean is None or not np.median(clean.light[learned[use]]) > 0:  # or no number
        message = (
            "the model of the pixels fails, or the star has too many places for so few cadences: "
            "measured fractions are taken"
        )
        warnings.warn(message, DetrendingWarning, stacklevel=4)
        return pixels, None
    light, light_error = clean.light, clean.light_error
    if pixels.weights is not None:  # from the part that a moving aperture holds
        weights = pixels.weights[use][:, known] * pixels.aperture[known]
        held, measured = np.sum(weights * clean.shares, axis=1), pixels.flux[use][:, known]
        predicted = clean.shares * light[:, None]
        measured = np.where(clean.repaired, predicted, measured - clean.background)
        light = np.sum(weights * measured, axis=1) / held
        variance = np.sum((weights * pixels.flux_err[use][:, known]) ** 2, axis=1)
        light_error = np.sqrt(variance) / held
    flux = np.zeros_like(pixels.flux)
    cube = np.zeros((use.sum(), *known.shape))
    cube[:, known] = clean.still * light[:, None]
    if full.any():
        inside, learned = pixels.aperture & known, learned[use]
        centers = find_row_centers(np.nan_to_num(pixels.flux[use]), inside, learned, saturation)
        varies = clean.position, clean.variable, learned
        cube = without_saturation(cube, full, rows_of_star(centers, *varies), inside)
        if pixels.neighbors is not None:  # what is left of their light follows the star
            weighted = rows_of_star(clean.weighted[:, None], *varies)[:, 0]
            clean = replace(clean, misfit=rows_of_star(clean.misfit, *varies), weighted=weighted)
    flux[use] = cube
    total, total_err = at_rows(light, use), at_rows(light_error, use)
    usable = use & (np.nan_to_num(total) > 0)
    return replace(pixels, flux=flux, total=total, total_err=total_err, usable=usable), clean
