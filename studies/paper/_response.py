r"""Noise of many moving stars as a cheap function of the pixels' response.

The flux of an aperture is linear in the deviations of b and, for the response
:math:`(1 + a_2 u^2)(1 + a_2 v^2)` of the paper's Eq. 2, in :math:`1, a_2, a_2^2`:

.. math:: f(t) = \sum_{k=0}^{2} a_2^k \left(A_k(t) + \beta B_k(t)\right), \qquad
          A_k = \sum_i M_{k,i}, \quad B_k = \sum_i \xi_i M_{k,i},

with the moments :math:`M_{k,i}` of the PSF over pixel i and :math:`b_i = 1 + \beta \xi_i`. The
six series of a star are computed once; the noise for any :math:`(a_2, \beta)` costs a sum.
"""

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter
from scipy.special import erf, erfinv

from scope_models.models import PRF, BivariateGaussianPSF, SensitivityPolynomial

# Kepler's PRF: part of the light in the brightest pixel, and the diameter that holds 95 % of it.
# Medians over the field, Kepler telescope page.
_BRIGHTEST = 0.45
_DIAMETER = 4.2
_WIDTH, _WINDOW = 13, 49
_SQUARE = (0.0, 0.0, 1.0)
# White noise of 1 per cadence is so much in EVEREST's convention: measured.
_WHITE = 0.257


def winged_psf(fraction):
    """Return two round Gaussians, core and wings, with Kepler's concentration.

    `fraction` is the part of the light in the wings, from 0.06 to 0.6.
    """
    if not 0.06 <= fraction <= 0.6:
        raise ValueError(f"`fraction` must be within 0.06 and 0.6, got {fraction}")
    square, outside = (_DIAMETER / 2) ** 2, 0.05
    for _ in range(100):  # the core matters little outside the circle, so that this converges
        wings = np.sqrt(square / (2 * np.log(fraction / outside)))
        central = erf(0.5 / (np.sqrt(2) * wings)) ** 2  # part of the wings in the brightest pixel
        rest = (_BRIGHTEST - fraction * central) / (1 - fraction)
        core = 0.5 / (np.sqrt(2) * erfinv(np.sqrt(rest)))
        outside = 0.05 - (1 - fraction) * np.exp(-square / (2 * core**2))
    return BivariateGaussianPSF(
        1 - fraction, sigma_x=float(core), sigma_y=float(core)
    ) + BivariateGaussianPSF(fraction, sigma_x=float(wings), sigma_y=float(wings))


def everest_noise(flux):
    """Return the CDPP (ppm) of light curves, (..., n_cadences), as EVEREST's without clipping."""
    flux = flux / np.median(flux, axis=-1, keepdims=True)
    residual = flux - savgol_filter(flux, _WINDOW, 2, axis=-1)
    mean, square = (uniform_filter1d(values, _WIDTH) for values in (residual, residual**2))
    spread = np.sqrt(np.maximum(square - mean**2, 0.0))[..., _WIDTH // 2 : -(_WIDTH // 2)]
    return 1e6 * np.median(spread, axis=-1) / _WIDTH**0.5


class RollingStars:
    """Moving stars, and the six series of each in apertures of several sizes.

    An aperture holds the pixels in which the star has more than a part of its flux, one of
    `thresholds`, on average. `stars` are a Star, a Motion and a generator for the map of b each.
    `fraction` and `n_pixels`, (n_thresholds, n_stars), are the part of a star's light in the
    aperture, and its pixels.
    """

    def __init__(self, detector, stars, thresholds):
        shape = (len(thresholds), len(stars))
        self.fraction, self.n_pixels = np.empty(shape), np.empty(shape)
        self._series = np.empty((*shape, 6, len(stars[0][1])), dtype=np.float32)
        for number, (star, motion, rng) in enumerate(stars):
            moments = self._moments(detector, star, motion)
            deviations = rng.standard_normal(detector.shape)
            image = moments[0].mean(axis=0)
            for place in ((row, number) for row in range(len(thresholds))):
                mask = image > thresholds[place[0]]
                inside = moments[:, :, mask]
                sums = inside.sum(axis=2)
                scale = sums[0].mean()  # series are near 1, so that single precision does
                self._series[place][:3] = sums / scale
                self._series[place][3:] = inside @ deviations[mask] / scale
                self.fraction[place], self.n_pixels[place] = scale, mask.sum()

    @staticmethod
    def _moments(detector, star, motion):
        """Return the moments M_0, M_1, M_2 over pixels, shape (3, n, ny, nx)."""
        place = {"x_0": star.x_0 + motion.x, "y_0": star.y_0 + motion.y}

        def moment(*rows):
            prf = PRF(star.psf * SensitivityPolynomial(*rows))
            return prf.render(detector.shape, flux=np.ones(len(motion)), **place)

        first = moment(_SQUARE, (1.0,)) + moment((1.0,), _SQUARE)
        return np.array([moment((1.0,), (1.0,)), first, moment(_SQUARE, _SQUARE)])

    def systematics(self, a_2, scatter):
        """Return the noise by motion alone for a_2 and the standard deviation of b, CDPP in ppm."""
        factors = np.array([1, a_2, a_2**2])
        factors = np.concatenate([factors, scatter * factors])
        return everest_noise(np.einsum("c,mnct->mnt", factors, self._series))

    def white(self, detector, mag):
        """Return the noise of photons, background and reads of stars of a magnitude, ppm."""
        exposure = detector.exposure_time
        electrons = self.fraction * detector.flux_from_mag(mag) * exposure
        per_pixel = detector.background * exposure + detector.cadence_read_noise**2
        return 1e6 * _WHITE * np.sqrt(electrons + self.n_pixels * per_pixel) / electrons
