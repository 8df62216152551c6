"""The expected electrons of the stars, before any noise."""

import numpy as np

from scope_models.effects.saturation import bleed
from scope_models.models import PRF

__all__ = ["Light"]

# Pixels and exposures per piece of work: few enough for arrays to stay in the processor's cache.
_PIECE = 1 << 15
# Positions per call of the renderer. So few are integrated one by one: an interpolation between
# them would make a pixel depend, in its last digits, on which cadences are rendered together.
_BATCH = 96
# A pixel with less than this part of a star's light is dark. The renderer's own limit is lower,
# and depends on which cadences are rendered together.
_DARK = 1e-15


class Light:
    """The electrons that the pixels are expected to gather in each cadence.

    Parameters
    ----------
    stars : sequence of Star
        The stars.
    detector : Detector
        The detector.
    motion : Motion
        The motion that the stars share.
    seed : int
        The seed, for the interpixel map.
    n_sub : int
        Exposures within a cadence over which the motion is averaged.
    """

    def __init__(self, stars, detector, motion, seed, n_sub):
        self.detector = detector
        self.motion = motion
        self.n_sub = n_sub
        self.interpixel = detector.interpixel_map(seed)
        self.electrons_per_flux = self.interpixel * detector.exposure_time
        self.background = detector.background * self.electrons_per_flux
        self.positions = [_position(star, detector.shape) for star in stars]
        self.fluxes = [detector.flux_from_mag(star.mag) for star in stars]
        self.largest_spill = 0.0
        self.relative_flux = np.array([star.relative_flux(motion.time) for star in stars])
        self._psfs = [_psf(star, detector) for star in stars]
        response = detector.sensitivity
        self._prfs = [PRF(psf if response is None else psf * response) for psf in self._psfs]

    def offsets(self, cadences):
        """Return the motion of a slice of cadences, two arrays of shape (m, n_sub)."""
        motion = self.motion
        if self.n_sub == 1:
            return motion.x[cadences, None], motion.y[cadences, None]
        parts = (np.arange(self.n_sub) + 0.5) / self.n_sub - 0.5
        times = motion.time[cadences, None] + parts * self.detector.cadence_days
        return np.interp(times, motion.time, motion.x), np.interp(times, motion.time, motion.y)

    def star(self, number, cadences):
        """Return the flux of one star (e-/s) in a slice of cadences, without interpixel map."""
        x, y = self.offsets(cadences)
        x_0, y_0 = self.positions[number]
        x, y = (x + x_0).ravel(), (y + y_0).ravel()
        flux = np.repeat(self.fluxes[number] * self.relative_flux[number, cadences], self.n_sub)
        images = np.empty((len(x), *self.detector.shape))
        for start in range(0, len(x), _BATCH):
            part = slice(start, start + _BATCH)
            images[part] = self._prfs[number].render(
                self.detector.shape, flux=flux[part], x_0=x[part], y_0=y[part]
            )
        np.copyto(images, 0.0, where=images < _DARK * flux[:, np.newaxis, np.newaxis])
        if self.n_sub == 1:
            return images
        return images.reshape(-1, self.n_sub, *self.detector.shape).mean(axis=1)

    def electrons(self, cadences):
        """Return the electrons of all stars in a slice of cadences, after saturation."""
        electrons = self.star(0, cadences)
        for number in range(1, len(self.fluxes)):
            electrons += self.star(number, cadences)
        electrons *= self.electrons_per_flux
        if self.detector.well_depth is None:
            return electrons
        depth = self.detector.well_depth * self.detector.n_reads
        charge = electrons.sum(axis=(1, 2))
        bleed(electrons, depth, self.background)
        kept = electrons.sum(axis=(1, 2))
        spilled = 1.0 - np.divide(kept, charge, out=np.ones_like(kept), where=charge > 0)
        self.largest_spill = max(self.largest_spill, float(spilled.max()))
        return electrons

    def pieces(self, size=None):
        """Return the slices of cadences that together are all of them."""
        n = len(self.motion)
        if size is None:
            # A piece needs about 70 bytes per pixel and the result 12: a fifth of the cadences
            # at most keeps the memory below three times the result.
            size = min(_PIECE // self.interpixel.size, n // 5) // self.n_sub
            size = max(size - size % _BATCH if size > _BATCH else size, 1)
        return [slice(start, start + size) for start in range(0, n, size)]

    def lost_fractions(self):
        """Return the largest part of each star's light that the motion takes off the stamp."""
        x, y = self.motion.x, self.motion.y
        # Farthest along the axes and along the diagonals.
        extremes = np.unique([f(u) for u in (x, y, x + y, x - y) for f in (np.argmin, np.argmax)])
        inside = [
            PRF(psf).render(
                self.detector.shape,
                flux=np.ones(len(extremes)),
                x_0=x_0 + x[extremes],
                y_0=y_0 + y[extremes],
            )
            for psf, (x_0, y_0) in zip(self._psfs, self.positions, strict=True)
        ]
        least = np.array([images.sum(axis=(1, 2)).min() for images in inside])
        return np.clip(1.0 - least, 0.0, 1.0)


def _position(star, shape):
    """Return the reference position of a star; the centre of the stamp by default."""
    ny, nx = shape
    x_0 = (nx - 1) / 2 if star.x_0 is None else star.x_0
    y_0 = (ny - 1) / 2 if star.y_0 is None else star.y_0
    return x_0, y_0


def _psf(star, detector):
    """Return the PSF of a star."""
    psf = detector.psf if star.psf is None else star.psf
    if psf is None:
        raise ValueError("`psf` must be given for the star or for the detector")
    return psf
