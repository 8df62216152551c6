"""Light of other stars in a star's pixels, by a model of all of them."""

import warnings
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np
from astropy.table import QTable

from scope_models.exceptions import DetrendingWarning
from scope_models.fitting import FitOptions, fit_tpf
from scope_models.fitting._start import make_prf
from scope_models.io.pixels import read_neighbors, star_places, target_among, usable_positions
from scope_models.models import PRF
from scope_models.pixelmodel._pixels import (
    REACH,
    at_one_place,
    typical_image,
    without_background,
)
from scope_models.pixelmodel._smooth import BLOCK, CLIP, nearness, polynomials
from scope_models.pixelmodel._source import (
    NEAREST,
    PLACE,
    SHARE_ERROR,
    center_of_light,
    stars_of,
)
from scope_models.pixelmodel._stamp import POSITION_PRIOR, Columns, without_saturation
from scope_models.pixelmodel._star import MISFIT, RESPONSE_PRIOR

__all__ = [
    "WIDTH", "Crowd", "CrowdPixels", "NeighborLight", "given_neighbors", "learn",
    "light_of_neighbors", "track", "without_neighbors",
]  # fmt: skip

#: Tolerance: parts of the time of a jackknife.
_PARTS = 10
#: Tolerance: cadences that show the PRF.
_FEW = 100
#: Prior: errors of the PRF are in units of the first guess made so many times as broad.
_BROAD = 2.0
#: Prior: width and places (px) of the Gaussians. The process has sqrt(2) times this scale, for
#: those PRFs are correlated by 0.93 over 0.5 px and by 0.7 over 1 px.
_SIGMA, _CENTERS = 0.5**0.5, np.arange(-4, 4.5, 0.5)
#: Prior: standard deviations of a neighbor's flux about the first guess, and of widths, relative.
_FLUX, WIDTH = 0.3, 0.01
#: Tolerance: least flux of a neighbor over the star's at the start.
_FAINTEST = 1e-4
#: Tolerance: number of steps; a sixth one changes shares of the light by 1e-4.
_STEPS = 5


@dataclass(frozen=True, eq=False)
class NeighborLight:
    """Other stars of a stamp."""

    table: QTable  # flux (e-/s), column and row in the stamp (px) of each, ``flux, x, y``
    light: np.ndarray  # in each pixel, e-/s, (n_cadences, ny, nx)
    positions: np.ndarray  # column and row of the target, (n_cadences, 2), px; NaN where unknown


def without_neighbors(pixels, series, found):
    """Return pixels and file without the light of other stars; with positions if it has none."""
    flux = pixels.flux - found.light
    light = np.sum(found.light * pixels.inside, axis=(1, 2))
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

    Those on the sky are as far from the target in the pixels as by the coordinates.
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
    if np.any(np.hypot(*(places - star).T) < PLACE):
        raise ValueError(
            f"`neighbors` must not hold the target itself: one is within {PLACE} px of it"
        )
    size = np.array(pixels.core.shape[::-1])
    far = (np.abs(places - (size - 1) / 2) - size / 2 > REACH).any(axis=1)
    if far.any():
        message = f"{far.sum()} of `neighbors` are far outside of the pixels and are left out"
        warnings.warn(message, DetrendingWarning, stacklevel=3)
    return places[~far]


def light_of_neighbors(pixels, series, cadence_mask, neighbors, saturation):
    """Fit a PSF at the places of the target and its neighbors to the pixels near it.

    It is learned from the cadences of a mask. Neighbors are columns and rows, ``(k, 2)``, or None:
    those with peaks of their own are found, and those whose light does not follow the star's, for
    bumps of a PRF look like neighbors of up to 20 % of a star's light; "find": all. Where charge
    bleeds, only the sum along a column is the stars'. Return a `NeighborLight`, or None.
    """
    given, usable = not isinstance(neighbors, str | None), pixels.usable
    use = pixels.quiet(cadence_mask & pixels.lit & usable)
    use &= pixels.total > np.median(pixels.total[use]) / 2  # the rest of an eclipse may be others'
    pos_corr = series.pos_corr
    if pos_corr is not None:
        known = usable_positions(pos_corr)
        pos_corr = np.where(known[:, None], pos_corr, np.nan) if known[use].any() else None
    flux = np.full(pixels.flux.shape, np.nan)
    bled = pixels.bled(use, saturation)
    flux[usable] = _drawn(without_background(pixels.flux[usable]), bled)
    columns = Columns(np.argwhere(pixels.aperture)[:, ::-1], bled[pixels.aperture])
    inside, known = flux[usable][:, pixels.aperture], None if pos_corr is None else pos_corr[usable]
    inside = columns.summed(inside)
    constant = _constant_light(inside, known) if neighbors is None else np.zeros(inside.shape[1])
    everywhere = isinstance(neighbors, str) or np.abs(constant).max() > CLIP
    if not (given or everywhere) and pixels.own.all():
        return None
    image = np.nan_to_num(
        typical_image(flux[use]) if pos_corr is None else at_one_place(flux[use], pos_corr[use])
    )
    box = pixels.near
    far = np.ones(image.shape, dtype=bool)
    far[box] = False
    flux[:, far], image[far] = np.nan, 0.0
    few = np.flatnonzero(use)[:: -(-use.sum() // _FEW)]
    try:
        if given:
            stars = np.vstack([center_of_light(image, pixels.core), neighbors])
        else:
            seen = columns.places[constant >= max(constant.max(), CLIP)]
            stars = _found(image, pixels, everywhere, seen)
        series = series.replace(flux=flux, flux_err=pixels.flux_err, pos_corr=pos_corr)
        fit, places, fluxes = _first_fit(series[few], stars, given=given)
        data = _with_priors(fit, series, few, box)
        fluxes = np.maximum(fluxes[1:], _FAINTEST * fluxes[0])
        first = Crowd.first(fit.model, data.flux.shape[1:], fluxes, places[1:] - places[0])
        crowd = learn(first, data[few])
        states, others = track(crowd, data[usable])
    except (ValueError, np.linalg.LinAlgError):
        if not given:
            return None
        message = "the target and the given `neighbors` do not describe the pixels"
        raise ValueError(message) from None
    light, positions = np.zeros(flux.shape), np.full((len(flux), 2), np.nan)
    light[usable, *box] = others
    positions[usable] = states[:, 1:3] + [box[1].start, box[0].start]
    if neighbors is None and pixels.own.all():  # what is taken off must be the light that was seen
        left = _constant_light(inside - columns.summed(light[usable][:, pixels.aperture]), known)
        if np.sum(left**2) > np.sum(constant**2):
            return None
    total, center = crowd.sum_and_center()
    places = np.median(positions[use], axis=0) + crowd.away + center
    units = ("electron / s", "pix", "pix")
    table = QTable([total * crowd.fluxes, *places.T], names=("flux", "x", "y"), units=units)
    return NeighborLight(table, light, positions)


def _drawn(flux, bled):
    """Return images in which bled charge is a star about its center of light in each column."""
    light = np.where(bled, np.nan_to_num(flux), 0.0)
    rows, sums = np.arange(len(bled)), light.sum(axis=1)
    centers = rows @ light / np.where(sums > 0, sums, np.inf)
    return np.where(bled, without_saturation(light, bled.any(axis=0), centers, bled), flux)


def _with_priors(fit, series, few, box):
    """Return the pixels of a box, with what a fit to a few cadences expects of all.

    Positions follow POS_CORR, or else centers of light.
    """
    flux, error = series.flux[:, *box], series.flux_err[:, *box]
    good = np.isfinite(flux) & (error > 0)
    flux, error = np.where(good, flux, 0.0), np.where(good, error, np.inf)
    offset = series.pos_corr
    if offset is None:
        light = np.maximum(flux, 0.0)
        total = np.maximum(light.sum(axis=(1, 2)), 1e-300)
        sums = (light.sum(axis=axis) @ np.arange(light.shape[3 - axis]) for axis in (1, 2))
        offset = np.stack(list(sums), axis=1) / total[:, None]
    offset = np.where(np.isfinite(offset), offset, np.nanmedian(offset[few], axis=0))
    columns = np.column_stack([np.ones(len(offset)), offset])
    seen = few[np.isin(series.time[few], fit.time)]
    places = np.column_stack([fit.x, fit.y]) - [box[1].start, box[0].start]
    typical = np.median(fit.flux)
    expected = np.zeros((len(flux), 5))
    expected[:, 0] = typical
    expected[:, 1:3] = columns @ np.linalg.lstsq(columns[seen], places, rcond=None)[0]
    place = PLACE if series.pos_corr is None else POSITION_PRIOR
    sigma = np.broadcast_to([typical, place, place, WIDTH, typical], expected.shape)
    return CrowdPixels(flux, error, expected, sigma)


def _found(image, pixels, everywhere, seen):
    """Return the places of stars in an image, first that at the file's coordinates, ``(k, 2)``.

    If there is one only, another is where constant light has been ``seen``.
    """
    stars = stars_of(image, pixels.core, everywhere | ~pixels.own)
    stars = np.vstack([stars, seen[: len(stars) == 1]])
    if pixels.place is not None:
        columns, rows = np.rint(stars).astype(int).T
        seen = image[np.clip(rows, 0, len(image) - 1), np.clip(columns, 0, image.shape[1] - 1)]
        target = np.argmax(seen * nearness(*(stars - pixels.place).T))
        stars = np.vstack([stars[target], np.delete(stars, target, axis=0)])
    return stars


def _first_fit(series, stars, *, given):
    """Fit two Gaussians at the places of all stars; return the fit, places and fluxes.

    Neighbors that are not ``given`` and end up at another star or without light were bumps of the
    PSF. All but the first star are of constant flux.
    """
    moves = series.pos_corr is not None and np.nanstd(series.pos_corr, axis=0).all()
    options = FitOptions(neighbor_flux="constant", saturation=False, position_error=POSITION_PRIOR)
    psf = make_prf(2, None, 0).psf  # concentric ones: free offsets would describe a pair
    while len(stars) > 1:
        with warnings.catch_warnings(action="ignore"):
            fit = fit_tpf(
                series, psf, stars=stars, positions="prior" if moves else "free", response="psf",
                interpixel=0.0, options=options, progress=False,
            )  # fmt: skip
        places = np.array([np.median([star.x, star.y], axis=1) for star in (fit, *fit.neighbors)])
        fluxes = np.array([np.median(star.flux) for star in (fit, *fit.neighbors)])
        kept = (np.hypot(*(places - places[0]).T) > NEAREST) & (fluxes > 0) | given
        kept[0] = True
        if kept.all():
            return fit, places, fluxes
        stars = places[kept]
    raise ValueError("there is only one star")


def _constant_light(light, pos_corr):
    """Return the constant light in pixels of an aperture, ``(n, m)``, over its error, ``(m,)``.

    A star's pixels are its light times functions of POS_CORR, for centroids follow constant light.
    Stars that vary by no more than errors of POS_CORR make show none.
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
    none = np.zeros(light.shape[1])
    if len(total) < _PARTS * columns.shape[1]:
        return none
    rest = total - functions @ np.linalg.lstsq(functions, total, rcond=None)[0]
    least = POSITION_PRIOR * RESPONSE_PRIOR  # what positions are uncertain by makes it vary
    if np.var(rest) - np.mean(np.diff(rest) ** 2) / 2 < least**2:
        return none
    parts = np.array_split(np.arange(len(columns)), _PARTS)
    gram = np.array([columns[k].T @ columns[k] for k in parts])
    right = np.array([columns[k].T @ light[k] for k in parts])
    ridge = 1e-10 * np.diag(np.maximum(np.diag(gram.sum(axis=0)), 1e-300))
    constant = np.linalg.solve(gram.sum(axis=0) + ridge, right.sum(axis=0))[0]
    without = np.linalg.solve(gram.sum(axis=0) - gram + ridge, right.sum(axis=0) - right)[:, 0]
    error = np.sqrt((1 - 1 / _PARTS) * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    return constant / np.maximum(error, 1e-300)


@dataclass(frozen=True)
class CrowdPixels:
    """Pixels and priors of cadences."""

    flux: np.ndarray  # (n, ny, nx)
    error: np.ndarray  # infinite where there are no data
    expected: np.ndarray  # flux, column, row, width and background, (n, 5)
    sigma: np.ndarray  # their standard deviations

    def __getitem__(self, which):
        return CrowdPixels(*(values[which] for values in vars(self).values()))


@dataclass(frozen=True)
class Crowd:
    r"""What all cadences share: one PRF of a star and its neighbors, learned from all of them.

    .. math::

        F_p(t) = b_p \sum_k a_k P(p - x_t - d_k; w_t) + c_t, \quad P = P_0 + \sum_j \pi_j \phi_j

    with a first guess :math:`P_0`, Gaussians :math:`\phi` whose sum is a Gaussian process, gains b
    of the pixels, fluxes a and distances d of the stars, of which only the target varies, and
    position x, relative width w and background c of each cadence. Gauss-Newton steps improve what
    all cadences share, with the states of the cadences eliminated.
    """

    prf: PRF  # first guess
    change: np.ndarray  # coefficients of the Gaussians, rows and columns
    gains: np.ndarray  # (ny, nx)
    fluxes: np.ndarray  # of the neighbors, (k,)
    away: np.ndarray  # their distances from the target, columns and rows, (k, 2)

    @classmethod
    def first(cls, prf, shape, fluxes, away):
        """Return the first guess."""
        return cls(prf, np.zeros((len(_CENTERS),) * 2), np.ones(shape), fluxes, away)

    def images(self, x, y, width):
        """Return images of unit flux ``(n, ny, nx)`` and their derivatives by the arguments."""
        image, by = self.prf.unit_images(self.gains.shape, x, y, derivatives=True)
        (columns, by_column), (rows, by_row) = self.waves(x, y)
        along = self.change @ columns.transpose(0, 2, 1)
        image = image + rows @ along
        by_x = by["x_0"] - rows @ (self.change @ by_column.transpose(0, 2, 1))
        by_y = by["y_0"] - by_row @ along
        u, v = (np.arange(image.shape[axis]) - at[:, None] for axis, at in ((2, x), (1, y)))
        wider = u[:, None, :] * by_x + v[:, :, None] * by_y - 2 * image
        return image + width[:, None, None] * wider, (by_x, by_y, wider)

    def waves(self, x, y):
        """Return factors of the Gaussians along columns and rows ``(n, size, m)``, and slopes."""
        for size, center in zip(self.gains.shape[::-1], (x, y), strict=True):
            away = (np.arange(size) - center[:, None])[:, :, None] - _CENTERS
            values = np.exp(-0.5 * (away / _SIGMA) ** 2)
            yield values, -away / _SIGMA**2 * values

    def stars(self, states):
        """Yield flux with gains, column and row, image and derivatives of all stars."""
        flux, x, y, width, _ = states.T
        for one, (dx, dy) in zip([flux, *self.fluxes], [(0, 0), *self.away], strict=True):
            light = np.broadcast_to(one, x.shape)[:, None, None] * self.gains
            yield light, x + dx, y + dy, *self.images(x + dx, y + dy, width)

    def sum_and_center(self):
        """Return the PRF's sum over pixels, and its center of light relative to its place, px."""
        wide, at = replace(self, gains=np.ones((41, 41))), np.array([20.0])
        image = wide.images(at, at, np.zeros(1))[0][0]
        center = np.array([np.sum(image.sum(axis=axis) * np.arange(41)) for axis in (0, 1)])
        return image.sum(), center / image.sum() - 20

    def others(self, states):
        """Return the light of the neighbors, ``(n, ny, nx)``."""
        _, *neighbors = self.stars(states)
        return sum(light * image for light, _, _, image, _ in neighbors)

    @property
    def values(self):
        """All parameters but the gains, ``(m,)``."""
        return np.concatenate([self.change.ravel(), self.fluxes, self.away.ravel()])

    def with_values(self, values, gains):
        """Return the same with other parameters."""
        m, k = self.change.size, len(self.fluxes)
        change, fluxes, away = np.split(values, [m, m + k])
        shaped = change.reshape(self.change.shape), gains, fluxes, away.reshape(k, 2)
        return Crowd(self.prf, *shaped)

    def sizes(self):
        """Return prior standard deviations of the parameters but the gains."""
        x, y = np.meshgrid(_CENTERS / _BROAD, _CENTERS / _BROAD)
        # rounding may be negative
        size = SHARE_ERROR * np.abs(self.prf.unit_images((1, 1), -x.ravel(), -y.ravel()).ravel())
        size *= np.diff(_CENTERS)[0] / (_SIGMA * np.sqrt(np.pi))  # squares of many add up
        return np.concatenate([size, _FLUX * self.fluxes, np.full(self.away.size, PLACE)])


def _cadences(crowd, states, pixels):
    """Return what pixels show of the states of cadences, all of unit variance.

    These are weights and residuals of the pixels, an orthonormal basis of the states' effects on
    pixels and priors with its factor, and what of the residuals is in it, ``(n, 5)``.
    """
    n, stars = len(states), list(crowd.stars(states))
    image = crowd.gains * stars[0][3]
    light = sum(flux * one for flux, _, _, one, _ in stars)
    slopes = sum(flux * np.array(by) for flux, _, _, _, by in stars)
    rest = pixels.flux - light - states[:, 4, None, None]
    # the model errs by a part of the light; what is far off counts little, as cosmic rays
    seen = light > CLIP * pixels.error
    part = ((1.4826 * rest[seen]) ** 2 - pixels.error[seen] ** 2) / light[seen] ** 2
    part = max(np.median(part), 0.0) if part.size else 0.0
    root = 1 / np.sqrt(pixels.error**2 + part * light**2 + (rest / CLIP) ** 2)
    effects = np.stack([image, *slopes, np.ones_like(image)], axis=-1) * root[..., None]
    priors = np.eye(5) / pixels.sigma[:, None]
    basis, factor = np.linalg.qr(np.concatenate([effects.reshape(n, -1, 5), priors], axis=1))
    rest, away = (rest * root).reshape(n, -1), (pixels.expected - states) / pixels.sigma
    seen = basis.transpose(0, 2, 1) @ np.concatenate([rest, away], axis=1)[..., None]
    return root.reshape(n, -1), rest, basis, factor, seen[..., 0]


def _moved(states, factor, seen):
    """Return states after a step."""
    step = np.linalg.solve(factor, seen[..., None])[..., 0]
    step[:, 1:3] = np.clip(step[:, 1:3], -PLACE, PLACE)
    return states + step


def learn(first, pixels):
    """Return a crowd that describes the pixels of some cadences."""
    crowd, states, m = first, pixels.expected, first.change.size
    sizes = np.append(first.sizes(), np.full(first.gains.size, MISFIT))
    whole = np.where(np.arange(len(sizes)) < m, sizes, 0.0)  # of the PRF, which stays
    for _ in range(_STEPS):
        root, rest, basis, factor, seen = _cadences(crowd, states, pixels)
        (n, p), (effects, light) = root.shape, _effects(crowd, states)
        effects, light = effects * root[..., None], light * root
        # gains act on one pixel each
        own = basis[:, :p].transpose(0, 2, 1)
        inside = np.concatenate([own @ effects, own * light[:, None]], axis=2).reshape(5 * n, -1)
        flat = effects.reshape(n * p, -1)
        cross = np.einsum("npm,np->mp", effects, light)
        gram = np.block([[flat.T @ flat, cross], [cross.T, np.diag(np.sum(light**2, axis=0))]])
        right = np.append(flat.T @ rest.ravel(), np.sum(light * rest, axis=0))
        away = np.append(crowd.values - first.values, crowd.gains.ravel() - 1)
        gram = (gram - inside.T @ inside) * sizes[:, None] * sizes + np.eye(len(sizes))
        right = sizes * (right - inside.T @ seen.ravel()) - away / np.maximum(sizes, 1e-300)
        gram = np.block([[gram, whole[:, None]], [whole, 0.0]])
        step = sizes * np.linalg.solve(gram, np.append(right, 0.0))[:-1]
        states = _moved(states, factor, seen - (inside @ step).reshape(n, 5))
        gains = crowd.gains + step[-p:].reshape(crowd.gains.shape)
        crowd = crowd.with_values(crowd.values + step[:-p], gains)
    mean = np.average(gains.ravel(), weights=np.abs(light).mean(axis=0))
    return replace(crowd, gains=gains / mean, fluxes=mean * crowd.fluxes)


def _effects(crowd, states):
    """Return effects of the parameters on all pixels ``(n, n_pixels, m)``, and the light."""
    n, waves, total, fluxes, places = len(states), 0.0, 0.0, [], []
    for light, x, y, image, by in crowd.stars(states):
        (columns, _), (rows, _) = crowd.waves(x, y)
        one = rows[:, :, None, :, None] * columns[:, None, :, None, :]
        waves = waves + light[..., None, None] * one
        total = total + light * image
        fluxes.append(crowd.gains * image)
        places += [light * by[0], light * by[1]]
    others = np.stack([*fluxes[1:], *places[2:]], axis=-1)
    effects = np.concatenate([waves.reshape(*others.shape[:3], -1), others], axis=3)
    return effects.reshape(n, -1, effects.shape[3]), (total / crowd.gains).reshape(n, -1)


def track(crowd, pixels):
    """Return states of all cadences, and the light of the neighbors in all pixels."""
    states, light = pixels.expected.copy(), np.empty(pixels.flux.shape)
    for start in range(0, len(states), BLOCK):
        part = slice(start, start + BLOCK)
        for _ in range(_STEPS):
            *_, factor, seen = _cadences(crowd, states[part], pixels[part])
            states[part] = _moved(states[part], factor, seen)
        light[part] = crowd.others(states[part])
    return states, light
