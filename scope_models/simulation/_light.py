"""The light of the stars of a scene, before any noise."""

from dataclasses import dataclass

import numpy as np

from scope_models.effects.saturation import bleed
from scope_models.models._axis import ROWS
from scope_models.models._series import ImageSeries, unit_images

__all__ = [
    "StarLight",
    "StarSums",
    "fill_wells",
    "gather",
    "lost_fractions",
    "pieces",
    "share_of_target",
    "star_lights",
]

# Pixels and exposures per piece of work: few enough for arrays to stay in the processor's cache.
_PIECE = 1 << 15
# A pixel with less than this part of a star's light is dark. Interpolation errs by less.
_DARK = 1e-13


@dataclass(frozen=True, eq=False)
class StarLight:
    """One star of a scene: where its light falls in each cadence, and how much of it.

    Parameters
    ----------
    x, y : ndarray of shape (n_cadences, n_sub)
        Position in each exposure, pixels.
    flux : float
        Flux at the star's magnitude, e-/s, before the response of the pixels.
    relative_flux : ndarray of shape (n_cadences,)
        Flux of each cadence, 1 at the star's magnitude.
    series : ImageSeries
        Renders the star at unit flux.
    """

    x: np.ndarray
    y: np.ndarray
    flux: float
    relative_flux: np.ndarray
    series: ImageSeries

    @property
    def window(self):
        """Rows and columns that the star lights, a tuple of two slices."""
        return self.series.window

    def images(self, cadences):
        """Return the star's flux in some cadences, e-/s, without interpixel map.

        Parameters
        ----------
        cadences : slice or ndarray of int
            The cadences.

        Returns
        -------
        ndarray of shape (m, ...)
            Images of the `window`, means over the exposures of a cadence.
        """
        x, y = self.x[cadences], self.y[cadences]
        images = self.series(x.ravel(), y.ravel())
        images[images < _DARK] = 0.0
        if x.shape[1] > 1:
            images = images.reshape(*x.shape, *images.shape[1:]).mean(axis=1)
        images *= (self.flux * self.relative_flux[cadences])[:, np.newaxis, np.newaxis]
        return images


def star_lights(scene):
    """Return the light of each star of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    list of StarLight
        One for each star.

    Raises
    ------
    ValueError
        If a star has no PSF, or a signal of another length.
    """
    detector, time = scene.detector, scene.motion.time
    x, y = _offsets(scene)
    lights = []
    for star, (x_0, y_0) in zip(scene.stars, scene.positions, strict=True):
        place = x + x_0, y + y_0
        series = ImageSeries(_psf(star, detector), detector.sensitivity, detector.shape, *place)
        flux = detector.flux_from_mag(star.mag)
        lights.append(StarLight(*place, flux, star.relative_flux(time), series))
    return lights


def lost_fractions(scene):
    """Return the largest part of each star's light that the motion takes off the stamp.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    ndarray of shape (n_stars,)
        Between 0 and 1.
    """
    x, y = scene.motion.x, scene.motion.y
    # Farthest along the axes and along the diagonals.
    extremes = np.unique([f(u) for u in (x, y, x + y, x - y) for f in (np.argmin, np.argmax)])
    lost = []
    for star, (x_0, y_0) in zip(scene.stars, scene.positions, strict=True):
        place = x_0 + x[extremes], y_0 + y[extremes]
        images = unit_images(_psf(star, scene.detector), scene.detector.shape, *place)
        lost.append(1.0 - images.sum(axis=(1, 2)).min())
    return np.clip(lost, 0.0, 1.0)


def _offsets(scene):
    """Return the motion in each exposure, two arrays of shape (n_cadences, n_sub)."""
    motion = scene.motion
    if scene.n_sub == 1:
        return motion.x[:, np.newaxis], motion.y[:, np.newaxis]
    parts = (np.arange(scene.n_sub) + 0.5) / scene.n_sub - 0.5
    times = motion.time[:, np.newaxis] + parts * scene.detector.cadence_days
    return np.interp(times, motion.time, motion.x), np.interp(times, motion.time, motion.y)


def _psf(star, detector):
    """Return the PSF of a star."""
    psf = detector.psf if star.psf is None else star.psf
    if psf is None:
        raise ValueError("`psf` must be given for the star or for the detector")
    return psf


@dataclass(eq=False)
class StarSums:
    """Sums over each star's light that are taken while it is rendered.

    Parameters
    ----------
    images : ndarray of shape (n_stars, ny, nx)
        Flux of each star over all cadences, e-/s, with the response of the pixels.
    in_aperture : ndarray of shape (n_stars, n_cadences)
        Flux of each star in the aperture, e-/s.
    """

    images: np.ndarray
    in_aperture: np.ndarray


def gather(scene, lights, interpixel, cadences, sums=None, aperture=None):
    """Return the electrons that the light of all stars makes in a slice of cadences.

    Parameters
    ----------
    scene : Scene
        The scene.
    lights : list of StarLight
        The light of its stars.
    interpixel : ndarray of shape (ny, nx)
        Response of each pixel against the others.
    cadences : slice
        The cadences.
    sums : StarSums, optional
        What is summed up on the way.
    aperture : ndarray of bool, shape (ny, nx), optional
        The aperture of ``sums``.

    Returns
    -------
    ndarray of shape (m, ny, nx)
        Electrons before the wells fill.
    """
    n = len(range(*cadences.indices(len(scene.motion))))
    electrons = np.zeros((n, *scene.detector.shape))
    for number, light in enumerate(lights):
        images, window = light.images(cadences), light.window
        electrons[:, *window] += images
        if sums is not None:
            weights = (interpixel * aperture)[window].ravel()
            flat = images.reshape(n, -1)
            sums.in_aperture[number, cadences] = np.einsum("mp,p->m", flat, weights)
            # One after the other: the sum is the same in pieces of any size.
            images[0] += sums.images[number, *window]
            sums.images[number, *window] = images.sum(axis=0)
    electrons *= interpixel * scene.detector.exposure_time
    return electrons


def fill_wells(scene, electrons, background):
    """Let the charge beyond the depth of the wells bleed, in place.

    Parameters
    ----------
    scene : Scene
        The scene.
    electrons : ndarray of shape (m, ny, nx)
        Electrons of the stars; changed in place.
    background : ndarray
        Electrons of the background, which fill the wells too.

    Returns
    -------
    float
        The largest part of the charge of a cadence that bleeds off the stamp.
    """
    if scene.detector.well_depth is None:
        return 0.0
    depth = scene.detector.well_depth * scene.detector.n_reads
    if electrons.max() <= depth - np.max(background):
        return 0.0
    charge = electrons.sum(axis=(1, 2))
    bleed(electrons, depth, background)
    kept = electrons.sum(axis=(1, 2))
    return float((1.0 - np.divide(kept, charge, out=np.ones_like(kept), where=charge > 0)).max())


def pieces(scene, size=None):
    """Return slices of cadences that together are all of them.

    Parameters
    ----------
    scene : Scene
        The scene.
    size : int, optional
        Cadences per piece; rounded up to a multiple of 16.

    Returns
    -------
    list of slice
        The pieces.
    """
    n = len(scene.motion)
    if size is None:
        # A piece needs about 70 bytes per pixel and the result 12: a fifth of the cadences
        # at most keeps the memory below three times the result.
        size = min(_PIECE // int(np.prod(scene.detector.shape)), n // 5) // scene.n_sub - ROWS + 1
    size = max(-(-size // ROWS), 1) * ROWS
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def share_of_target(light):
    """Return the target's share in the flux of all stars, NaN where there is none.

    Parameters
    ----------
    light : ndarray of shape (n_stars, n_cadences)
        Flux of each star.

    Returns
    -------
    ndarray of shape (n_cadences,)
        Between 0 and 1.
    """
    total = light.sum(axis=0)
    return np.divide(light[0], total, out=np.full(len(total), np.nan), where=total > 0)
