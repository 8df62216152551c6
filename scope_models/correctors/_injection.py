"""Dimmings of the star's own light, put into the pixels that a corrector has read."""

from dataclasses import dataclass, replace

import numpy as np

from scope_models.correctors._pixels import Pixels, background_plane, own_pixels
from scope_models.correctors._scene_start import fit_gaussians
from scope_models.photometry import aperture_flux

__all__ = ["Source", "box_signal"]

#: Peaks below this part of the star's are no neighbors.
_FAINTEST = 0.02
#: Relative errors of profile and image when the light is shared out, and their absolute ones in
#: units of the star's light.
_MISFIT, _LEVEL = 0.03, 1e-3
_ROUNDS = 6
#: The irrational number whose multiples spread boxes evenly, at places without a period.
_GOLDEN = (np.sqrt(5) - 1) / 2
#: Boxes are at least so many times their width apart, and there are so many at most.
_APART, _MOST_BOXES = 8, 8


@dataclass(frozen=True)
class Source:
    """What a `PLDModel` was made of."""

    pixels: Pixels  # as measured
    series: object  # their file
    cadence_mask: np.ndarray | None  # cadences from which images are learned

    def star_light(self, clean):
        """
        Return the star's own light in each pixel, e-/s, and its part of the aperture's light.

        The measured light less background, times the star's share in a typical image: neighbors
        have the star's profile.
        """
        pixels, use = self.pixels, self.pixels.usable
        typical = np.nanmedian(pixels.flux[use], axis=0)
        plane = background_plane(typical)
        light = pixels.flux - plane
        if clean is not None:
            known = np.isfinite(pixels.flux[use]).all(axis=0)
            cube = light[use]
            cube[:, known] = pixels.flux[use][:, known] - clean.background
            light[use] = cube
        share = _star_share(np.nan_to_num(typical - plane), pixels.aperture)
        own = light * share
        weights = pixels.aperture if pixels.weights is None else pixels.weights[use]
        whole, mine = (np.nansum(values[use] * weights) for values in (light, own))
        constant = 0.0 if clean is None else clean.constant
        left = 1 - constant * use.sum() / whole  # of the light, when constant light is taken off
        return own, float(np.clip(mine / whole / left, 0.0, 1.0))

    def dimmed(self, signal, clean):
        """Return the same with the star's light multiplied with a signal ``(n_cadences,)``."""
        pixels = self.pixels
        flux = pixels.flux + self.star_light(clean)[0] * (signal - 1)[:, None, None]
        weights = pixels.aperture if pixels.weights is None else pixels.weights
        total, _ = aperture_flux(flux, weights, pixels.flux_err)
        return replace(self, pixels=replace(pixels, flux=flux, total=total))


def _star_share(image, aperture):
    """Return the star's share in each pixel of an image without background."""
    peak = int(np.argmax(np.where(aperture, image, -np.inf)))
    stars = [own_pixels(image, peak)]
    left = ~stars[0]
    while left.any():
        other = int(np.argmax(np.where(left, image, -np.inf)))
        if image.flat[other] < _FAINTEST * image.flat[peak]:
            break
        stars.append(own_pixels(image, other) & left)
        left &= ~stars[-1]
    if len(stars) == 1:
        return np.ones(image.shape)
    rows, columns = np.indices(image.shape)
    places = [_center(np.where(star, image, 0.0)) for star in stars]
    distances = [(columns - x, rows - y) for x, y in places]
    near = stars[0]
    total = image[near].sum()
    own = np.where(near, image, 0.0)
    error = 1 / (_MISFIT * np.abs(image) + _LEVEL * total).ravel()
    for _ in range(_ROUNDS):
        values = own[near] / total
        u, v = (d[near] for d in distances[0])
        profile = fit_gaussians(u, v, values, 1 / (_MISFIT * np.abs(values) + _LEVEL))
        light = np.stack([profile(*d).ravel() for d in distances], axis=1)
        found = np.linalg.lstsq(light * error[:, None], image.ravel() * error, rcond=None)[0]
        light *= np.maximum(found, 0.0)
        share = (light[:, 0] / np.maximum(light.sum(axis=1), 1e-12 * total)).reshape(image.shape)
        own = image * share
        near = np.ones_like(near)
    return share


def _center(image):
    """Return column and row of the center of light of the 3 x 3 pixels about the peak."""
    row, column = np.unravel_index(np.argmax(image), image.shape)
    rows, columns = np.indices(image.shape)
    near = (np.abs(rows - row) <= 1) & (np.abs(columns - column) <= 1)
    weight = np.where(near, np.maximum(image, 0.0), 0.0)
    return (weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()


def box_signal(used, width, depth):
    """Return boxes of ``width`` of the used cadences, at places without a period."""
    rows = np.flatnonzero(used)
    number = int(np.clip(len(rows) // (_APART * width), 1, _MOST_BOXES))
    signal = np.ones(len(used))
    room = len(rows) / number - width
    for k in range(number):
        first = int(k * len(rows) / number + max(room, 0) * ((k + 1) * _GOLDEN % 1))
        signal[rows[first : first + width]] -= depth
    return signal
