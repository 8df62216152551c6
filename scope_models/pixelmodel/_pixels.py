"""The pixels of a target pixel file, as arrays that can be trusted."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy.stats import mad_std
from scipy import ndimage

from scope_models._checks import checked_weights
from scope_models.exceptions import DetrendingWarning
from scope_models.io.pixels import target_place, usable_positions
from scope_models.photometry import aperture_flux, cdpp
from scope_models.pixelmodel._smooth import (
    CLIP,
    COORDINATES,
    DARK_PART,
    FEWEST_DARK,
    TRANSIT,
    dark_plane,
    nearness,
    precise_aperture,
    quantile,
)
from scope_models.pixelmodel._stamp import FEWEST, full_columns, full_pixels
from scope_models.pixelmodel._star import IMAGE_ERROR

__all__ = [
    "LARGEST_CORRECTION", "NOISIER", "OTHER_STAR", "REACH", "WORSE", "Pixels", "aperture_pixels",
    "at_one_place", "at_rows", "credible_flux", "noise_ratios", "scatter",
    "typical_image", "warn_of_pipeline", "without_background",
]  # fmt: skip

#: Branch: a pixel that holds light of the star in this part of the cadences may belong to the
#: default aperture: light that a rare excursion carries out of it would be lost.
_BRIGHT_PART = 0.002
#: Branch: a correction that changes the flux by a larger factor than this is none.
LARGEST_CORRECTION = 30.0
#: Warning: a correction adds noise if the 6.5-h noise is over that of the raw flux by this factor.
WORSE = 1.1
NOISIER = (
    "the corrected light curve scatters more than the sum over the aperture, or there is no light "
    "above the noise: do not use it"
)
#: Tolerance: pixels farther from the aperture than this (px) are left out: tables of the PRFs of
#: Kepler and TESS end 5.5 to 7.5 px from the star.
REACH = 7
#: Branch: pixels around the lit ones that may belong to the aperture too.
_MARGIN = 2
#: Branch: light between two peaks of one star, in units of the fainter one, and along columns,
#: where the charge of full pixels goes.
_SAME_STAR, _SAME_COLUMN = 0.85, 0.7
#: Branch: light of other stars counts from this part of the star's on, in pixels of that of its
#: brightest one.
OTHER_STAR = 0.02


@dataclass(frozen=True)
class Pixels:
    """Pixels of an aperture and which cadences can be used."""

    time: np.ndarray  # days, (n_cadences,); NaN where unknown
    flux: np.ndarray  # e-/s, (n_cadences, ny, nx)
    flux_err: np.ndarray
    aperture: np.ndarray  # pixels that are summed, (ny, nx)
    total: np.ndarray  # sum over them, (n_cadences,)
    total_err: np.ndarray
    usable: np.ndarray  # cadences with finite time, finite pixels and a positive sum
    weights: np.ndarray | None  # of a moving aperture, as flux; None: all pixels count alike
    own: np.ndarray  # pixels that are not those of other stars, (ny, nx)
    crowding: float  # the target's share of the aperture's light: all but that of such pixels
    lit: np.ndarray  # cadences that show the star; from the others nothing is learned
    banded: np.ndarray  # cadences with rolling bands
    # pixels of the aperture among which the brightest one is the target's: those that are in the
    # pipeline's too, if there are any, and of the star at the file's coordinates
    core: np.ndarray
    place: np.ndarray | None  # column and row of the target by these, if that is in the aperture
    neighbors: object = None  # a `NeighborLight`: other stars whose light was taken off

    @property
    def near(self):
        """Slices of the rows and columns that may show the star: those around the aperture."""
        sides = (np.flatnonzero(self.aperture.any(axis=k)) for k in (1, 0))
        return tuple(slice(max(side[0] - REACH, 0), side[-1] + REACH + 1) for side in sides)

    def full_columns(self, use, saturation):
        """Return which columns of the aperture are full, ``(nx,)``, at ``saturation``, e-/s."""
        measured = self.flux if self.neighbors is None else self.flux + self.neighbors.light
        return full_columns(np.where(self.aperture, measured, 0.0), use, saturation)

    def bled(self, use, saturation):
        """Return full pixels and those next to them along columns."""
        return ndimage.binary_dilation(full_pixels(self.flux, use, saturation), np.ones((3, 1)))

    def loses_charge(self, use, saturation):
        """Return whether full pixels are above or below the aperture: it lacks what has bled."""
        beside = ndimage.binary_dilation(self.aperture, np.ones((3, 1))) & ~self.aperture
        return bool(full_columns(np.where(beside, self.flux, 0.0), use, saturation).any())

    def quiet(self, use):
        """Return the cadences in use without rolling bands, unless these are in most."""
        quiet = use & ~self.banded
        return quiet if quiet.sum() > use.sum() / 2 else use

    @property
    def inside(self):
        """Weight of each pixel in the sum."""
        return self.aperture if self.weights is None else self.weights

    @property
    def weighted(self):
        """The same, with pixels multiplied with their weights: their fractions are measured."""
        return self if self.weights is None else replace(self, flux=self.flux * self.weights)


def at_rows(values, rows):
    """Return values with NaN, or False, in the places of other rows of a mask."""
    fill = False if values.dtype == bool else np.nan
    whole = np.full((len(rows), *values.shape[1:]), fill)
    whole[rows] = values
    return whole


def choose_aperture(series, place):
    """Choose the aperture of a file whose sum is expected to be most precise.

    Candidates are the pixels that the star lights up wherever it moves, without those of other
    stars. Of these the ones are summed that make the noise of 6.5 h and the light lost with the
    star's motion least; all without POS_CORR. Columns with full pixels are whole: charge bleeds as
    far as it must. The target is in the pipeline's pixels, near its ``place`` if that is known.
    """
    given, pos_corr = series.flux, series.pos_corr
    if len(given) < FEWEST:
        raise ValueError(f"`tpf` has {len(given)} cadences: at least {FEWEST} are needed")
    flux = without_background(given)
    finite = np.isfinite(flux).all(axis=(1, 2))
    if finite.sum() < 3:
        seen = np.isfinite(flux).mean(axis=0) > 0.5
        finite = np.isfinite(flux[:, seen]).all(axis=1) if seen.any() else finite
        if finite.sum() < 3:
            few = "fewer than 3 cadences of `tpf` have data in all pixels"
            few = few if np.isfinite(given).any() else "`tpf` has no pixels with data"
            raise ValueError(f"{few}: no aperture can be chosen, give `aperture_mask`")
    values = np.where(np.isfinite(flux[finite]), flux[finite], 0.0)
    count = max(FEWEST, round(_BRIGHT_PART * len(values)))
    bright = np.partition(values, len(values) - count, axis=0)[-count]
    noise = np.nan_to_num(typical_image(series.flux_err[finite]))
    mean = np.median(values, axis=0)
    light = np.median(np.where(mean > CLIP * noise / 3, values, 0).sum(axis=(1, 2)))
    lit = bright > np.maximum(CLIP * noise, IMAGE_ERROR * light)
    labels, _ = ndimage.label(lit)
    near = lit & series.aperture if (lit & series.aperture).any() else lit
    if not near.any():
        message = "no pixel of `tpf` is above its noise: no aperture can be chosen"
        raise ValueError(f"{message}, give `aperture_mask`")
    target = _target_pixels(mean, near, place)
    peak = np.argmax(np.where(target, mean, -np.inf))
    others = lit & ~own_pixels(mean, peak) & (mean > CLIP * noise / 3)
    own = (labels == labels.flat[peak]) & ~others
    best = own
    if pos_corr is not None:
        around = ndimage.binary_dilation(own, np.ones((3, 3)), _MARGIN)
        near = own | ~ndimage.binary_dilation(others, np.ones((3, 3)))
        best = _most_precise(series.replace(flux=flux), own, around & near)
    saturation = series.mission and series.mission.full_flux
    full = full_columns(np.where(best, given, 0.0), finite, saturation)
    return best | full & ~others & np.isfinite(given[finite]).all(axis=0)


def _target_pixels(image, near, place):
    """Return those of some pixels from which the light rises to the target's peak.

    Where they do not hold its place by the file's coordinates, the target is the brightest star.
    """
    if not _hold(near, place):
        return near
    rows, columns = np.indices(image.shape)
    light = np.clip(image, 0, None) * nearness(columns - place[0], rows - place[1])
    peak = np.argmax(np.where(near, light, -1.0))
    return near & own_pixels(image, peak)


def _hold(pixels, place):
    """Return whether the target's place is in pixels, or may be by the coordinates' error."""
    if place is None:
        return False
    rows, columns = np.nonzero(pixels)
    distance = np.hypot(columns - place[0], rows - place[1])
    return distance.min(initial=np.inf) < 2 * COORDINATES


def at_one_place(values, pos_corr):
    """Return the median of the images in which the star is nearest to its median place."""
    distance = np.hypot(*(pos_corr - np.nanmedian(pos_corr, axis=0)).T)
    near = np.argsort(np.where(np.isfinite(distance), distance, np.inf))
    return np.median(values[near[: max(FEWEST, len(values) // 20)]], axis=0)


def typical_image(flux):
    """Return the median image, NaN where there are no data."""
    if np.isfinite(flux).all():
        return quantile(np.moveaxis(flux, 0, -1))
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # pixels without data
        return np.nanmedian(flux, axis=0)


def without_background(flux):
    """Subtract a plane from each image: that of the typical one, and what its dark pixels add."""
    typical = typical_image(flux)
    known = np.isfinite(typical)
    if not known.any():
        return flux
    dark = known & (typical <= np.quantile(typical[known], DARK_PART))
    terms = _plane_terms(flux.shape[1:])
    if dark.sum() < FEWEST_DARK:
        terms = terms[:, :, :1]
    change = flux[:, dark] - typical[dark]
    more = np.where(np.isfinite(change), change, 0.0) @ np.linalg.pinv(terms[dark]).T
    return flux - background_plane(typical) - np.moveaxis(terms @ more.T, 2, 0)


def _most_precise(series, own, candidates):
    """Return the best part of the candidates, or the lit pixels if most positions are missing."""
    flux, pos_corr = series.flux, series.pos_corr
    lit = np.isfinite(flux[:, own]).all(axis=1)
    use = usable_positions(pos_corr) & lit & np.isfinite(series.time)
    candidates = candidates & np.isfinite(flux[use]).all(axis=0)
    variance = series.flux_err[use][:, candidates] ** 2
    if use.sum() <= max(lit.sum() / 2, 1) or not (variance > 0).all():
        return own
    best = np.zeros_like(own)
    count = max(round(TRANSIT / quantile(np.diff(series.time[use]))), 1)
    best[candidates] = precise_aperture(flux[use][:, candidates], variance, pos_corr[use], count)
    return best


def own_pixels(image, peak):
    """Return the pixels from which the light rises to a star's peak and not to another star's.

    Peaks between which the light drops little are one star's; ``peak`` is a flat index.
    """
    values = np.where(np.isfinite(image), image, -np.inf)
    padded = np.pad(values, 1, constant_values=-np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(*image.shape, 9)
    step = np.argmax(windows, axis=2)
    rows, columns = np.indices(image.shape)
    higher = ((rows + step // 3 - 1) * image.shape[1] + columns + step % 3 - 1).ravel()
    for _ in range(int(np.log2(image.size)) + 1):
        higher = higher[higher]
    mine = [higher[peak]]
    for other in np.unique(higher):
        beside = abs(peak % image.shape[1] - other % image.shape[1]) > 1
        part = _SAME_STAR if beside else _SAME_COLUMN
        labels, _ = ndimage.label(values >= part * min(values.flat[peak], values.flat[other]))
        if labels.flat[peak] == labels.flat[other] > 0:
            mine.append(other)
    return np.isin(higher, mine).reshape(image.shape)


def _plane_terms(shape):
    rows, columns = np.indices(shape)
    return np.stack([np.ones(shape), rows - rows.mean(), columns - columns.mean()], axis=2)


def background_plane(image):
    """Return the background of a median image: a plane through its darkest pixels."""
    terms, known = _plane_terms(image.shape), np.isfinite(image)
    return terms @ dark_plane(image[known], terms[known])


def aperture_pixels(series, aperture, place=None):
    """Return `Pixels` of a `PixelSeries`; the aperture is a mask, weights by cadence, or None.

    The ``place`` of the star, column and row, is by default that of the file's coordinates.
    """
    time, flux, flux_err = series.time, series.flux, series.flux_err
    weights, chosen = None, aperture is None
    bands = series.mission.quality.rolling_band if series.mission else 0
    banded = (series.quality & bands) != 0
    banded &= banded.mean() < 0.5
    place = target_place(series) if place is None else place
    if aperture is None:
        dark = ~banded  # rolling bands light up pixels without stars
        aperture = choose_aperture(series[dark], place)
    elif np.ndim(aperture) == 3:
        weights = checked_weights("aperture_mask", aperture, flux.shape)
        aperture = _checked_aperture(np.nanmax(weights, axis=0) > 0, flux)
    else:
        aperture = _checked_aperture(aperture, flux)
    total, total_err = aperture_flux(flux, aperture if weights is None else weights, flux_err)
    finite = np.isfinite(time) & np.isfinite(total) & np.isfinite(flux[:, aperture]).all(axis=1)
    positive = finite & (np.nan_to_num(total) > 0)
    if positive.sum() <= finite.sum() / 2:
        raise ValueError("the sum over `aperture_mask` must be positive in most cadences")
    if positive.sum() < finite.sum():
        _warn(f"{finite.sum() - positive.sum()} cadences without a positive flux are left out")
    total_err = _filled_errors(total, total_err, positive)
    typical = np.median(total[positive])
    if series.pos_corr is not None and np.isfinite(series.pos_corr).all(axis=1).any():
        distance = np.abs(series.pos_corr - np.nanmedian(series.pos_corr, axis=0)).max(axis=1)
        away = positive & (np.nan_to_num(distance) > max(flux.shape[1:])) & (2 * total < typical)
        if away.any():
            _warn(f"{away.sum()} cadences are left out: POS_CORR and light are off the stamp")
        positive &= ~away
    noise = CLIP * total_err
    lit = positive & ((total > noise) | (total > typical - noise))
    places = None if series.pos_corr is None else series.pos_corr[positive]
    core = aperture & series.aperture if (aperture & series.aperture).any() else aperture
    own, crowding, core = _own_light(flux[positive], aperture, core, places, place)
    pixels = Pixels(
        time, flux, flux_err, aperture, total, total_err, positive, weights, own, crowding, lit,
        banded, core, place if _hold(aperture, place) else None,
    )  # fmt: skip
    if chosen:
        _compare_pipeline(series, pixels)
    return pixels


_REMEDY = 'compare `aperture_mask="pipeline"`'


def _other_aperture(series, pixels):
    """Return the pipeline's aperture without other stars, if it is one and not that of pixels."""
    other = series.aperture & (pixels.own | pixels.aperture)
    differs = other.any() and not other.all() and (other != pixels.aperture).any()
    return other if differs else None


def _compare_pipeline(series, pixels):
    """Warn if the pipeline's aperture has other light than the chosen one, of the same star."""
    other, aperture = _other_aperture(series, pixels), pixels.aperture
    if other is None:
        return
    image = np.nan_to_num(typical_image(series.flux[pixels.usable]))
    inside, whole = np.sum(image[other & aperture]), np.sum(image[other])
    if inside < whole / 2:
        part = 100 * max(inside / whole, 0)
        _warn(f"the aperture holds {part:.0f} % of the light in the pipeline's: {_REMEDY}")
    elif not other.flat[np.argmax(np.where(aperture, image, -np.inf))]:
        _warn(f"the brightest star in the aperture is outside of the pipeline's: {_REMEDY}")


def warn_of_pipeline(series, pixels, flux, share):
    """Warn if a corrected flux has more noise than the raw sum over the pipeline's aperture.

    The ``share`` is the part of the light in the aperture that was not taken off.
    """
    other, good = _other_aperture(series, pixels), np.isfinite(flux)
    if other is None:
        return
    its = np.nansum(series.flux[good][:, other], axis=1)
    sizes = [share * _jumps(flux[good]), _jumps(its)]
    # absolute values of normal ones scatter by sqrt(pi / 2 - 1) of their mean
    if sizes[1] > 0 and sizes[0] / sizes[1] > 1 + CLIP * np.sqrt((np.pi - 2) / len(its)):
        part = sizes[0] / sizes[1]
        _warn(f"the light curve has {part:.1f} times the noise of the pipeline's: {_REMEDY}")


def _jumps(flux):
    """Return the mean change of a flux from cadence to cadence, relative; 0 without light."""
    level = np.median(flux)
    return np.mean(np.abs(np.diff(flux, 2))) / level if level > 0 and len(flux) > 2 else 0.0


def _own_light(flux, aperture, core, pos_corr, place):
    """Return the star's pixels, their part of the aperture's light, and those of its peak."""
    typical = typical_image(flux)
    image = np.nan_to_num(typical - background_plane(typical))
    core = _target_pixels(image, core, place)
    peak = np.argmax(np.where(core, image, -np.inf))
    others = ~own_pixels(image, peak) & (image > OTHER_STAR * image.flat[peak])
    if others.any() and pos_corr is not None and np.isfinite(pos_corr).any():
        still = np.nan_to_num(at_one_place(flux, pos_corr))  # one that moves far has two peaks
        first = np.argmax(np.where(core, still, -np.inf))
        others &= ~own_pixels(still, first) & (still > OTHER_STAR * still.flat[first])
    return ~others, 1 - float(image[aperture & others].sum() / image[aperture].sum()), core


def _checked_aperture(aperture, flux):
    aperture = np.asarray(aperture)
    if aperture.dtype != bool:
        raise TypeError(f"`aperture_mask` must be boolean, got {aperture.dtype}")
    if aperture.shape != flux.shape[1:]:
        raise ValueError(f"`aperture_mask` must have shape {flux.shape[1:]}, got {aperture.shape}")
    if not aperture.any():
        raise ValueError("`aperture_mask` must hold at least one pixel, got none")
    empty = aperture & ~np.isfinite(flux).any(axis=0)
    if (empty == aperture).all():
        raise ValueError("`aperture_mask` holds only pixels without data (NaN)")
    if empty.any():
        _warn(f"{empty.sum()} pixels of `aperture_mask` without data (NaN) are left out")
    return aperture & ~empty


def _filled_errors(total, total_err, usable):
    """Replace errors that are zero or not finite."""
    good = usable & np.isfinite(total_err) & (total_err > 0)
    bad = usable & ~good
    if not bad.any():
        return total_err
    if good.any():
        value = np.median(total_err[good])
        _warn(f"{bad.sum()} cadences without a valid FLUX_ERR get the median error of the others")
    else:
        value = scatter(total[usable])
        _warn("FLUX_ERR has no valid values: the noise is taken from the scatter of the flux")
    return np.where(good, total_err, value)


def credible_flux(flux, flux_err, total, outliers):
    """Return a corrected flux that is finite or NaN, and its errors.

    Where the light in the aperture is nearly nothing, pixel fractions are large, and a model of
    them can be anything: such cadences get the typical correction, and an error as large as their
    flux. ``total`` is the flux before, NaN where it cannot be used.
    """
    usable = np.isfinite(total)
    with np.errstate(all="ignore"):
        ratio = np.asarray(flux) / total
        good = usable & np.isfinite(ratio) & (ratio > 0) & np.isfinite(flux_err)
        typical = np.median(ratio[good]) if good.any() else 1.0
        good &= np.abs(np.log(ratio / typical)) < np.log(LARGEST_CORRECTION)
    if lost := int(usable.sum() - good.sum()):
        _warn(
            f"{lost} of {usable.sum()} cadences get the typical correction, and errors as large "
            "as their flux: their own correction is not finite, or too large"
        )
    if outliers.sum() > usable.sum() / 2:
        _warn(f"{outliers.sum()} of {usable.sum()} cadences were left out of the fit as outliers")
    typical = typical * total
    return np.where(good, flux, typical), np.where(good, flux_err, np.abs(typical))


def noise_ratios(raw, corrected):
    """Return the relative noise of 6.5 h over that of the raw flux, in both conventions.

    In short series it is that of a quarter; without light above the noise it is infinite.
    """
    both = np.isfinite(raw.flux.value) & np.isfinite(corrected.flux.value)
    curves = raw[both], corrected[both]
    if both.sum() < 4 or any(np.median(v) <= scatter(v) for v in (lc.flux.value for lc in curves)):
        return np.full(2, np.inf)
    quarter = both.sum() // 4 * 24 * np.median(np.diff(curves[0].time.value))
    noise = [
        [cdpp(lc, min(24 * TRANSIT, quarter), method) for method in ("lightkurve", "everest")]
        for lc in curves
    ]
    return np.divide(noise[1], noise[0])


def scatter(flux):
    """Return the standard deviation of fast noise, per pixel or of a series ``(n_cadences,)``."""
    value = mad_std(np.diff(flux, 2, axis=0), axis=0, ignore_nan=True) / np.sqrt(6)
    return np.maximum(value, 1e-6 * np.nanmedian(flux, axis=0))


def _warn(message):
    warnings.warn(message, DetrendingWarning, stacklevel=5)
