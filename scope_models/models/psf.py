"""Point spread functions: the light of a star before the pixel, as densities."""

from functools import reduce
from operator import add
from typing import ClassVar

import numpy as np
from astropy.modeling import Parameter
from scipy.special import roots_genlaguerre

from scope_models._checks import checked_integer, checked_number
from scope_models.models._gaussian import gaussian_derivatives, gaussian_pixels
from scope_models.models._parameters import Domain, StarModel, gaussian_box
from scope_models.models._terms import ClosedForm, pixels_of

__all__ = ["BivariateGaussianPSF", "moffat_psf"]

_WIDTH = {"default": 0.5, "bounds": (float(np.finfo(np.float32).tiny), None)}
_RHO = (-1 + 1e-9, 1 - 1e-9)  # bounds of a correlation
# Components of a Moffat PSF with less of its flux are left out.
_LEAST_FRACTION = 1e-5


class BivariateGaussianPSF(StarModel):
    r"""Bivariate normal density times a flux.

    .. math::

        P(x, y) = \frac{F}{2 \pi \sigma_x \sigma_y \sqrt{1 - \rho^2}}
        \exp\left[-\frac{z_x^2 - 2 \rho z_x z_y + z_y^2}{2 (1 - \rho^2)}\right],
        \qquad z_x = \frac{x - x_0}{\sigma_x}, \quad z_y = \frac{y - y_0}{\sigma_y}.

    The density is the light before the pixel; `~scope_models.integrate_pixels` and
    `~scope_models.PRF` integrate it. A sum of several is a PSF of several components whose total
    flux is the sum of theirs. Equation 3 of Saunders et al. (2019) has an extra factor 1/2 on the
    two squared terms in print, with which it neither integrates to its amplitude nor is positive
    definite for :math:`|\rho| \ge 1/2`; this is the standard density.

    Parameters
    ----------
    flux : float or `~astropy.units.Quantity`
        Integral of the density over the plane, usually in electrons per second.
    x_0, y_0 : float or `~astropy.units.Quantity`
        Position of the star in pixels; x is the column, y the row.
    sigma_x, sigma_y : float or `~astropy.units.Quantity`
        Standard deviations along the axes in pixels. Angles are for the ``psf`` of a
        `~scope_models.Detector`, which has a pixel scale.
    rho : float
        Correlation coefficient.
    **kwargs
        Keywords of `~astropy.modeling.Model`, such as ``fixed``, ``bounds`` and ``name``.

    Raises
    ------
    ValueError
        If a parameter is not finite, sigma_x or sigma_y is not positive, or ``|rho| >= 1``.

    Notes
    -----
    Parameters of shape ``(n,)`` make `~scope_models.integrate_pixels` return ``n`` images.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", equation 3 (corrected).

    Examples
    --------
    >>> from scope_models import BivariateGaussianPSF
    >>> psf = BivariateGaussianPSF(flux=1000, sigma_x=0.5, sigma_y=0.4, rho=0.2)
    >>> print(f"{psf(0, 0):.1f}")
    812.2
    """

    sigma_x = Parameter(description="Standard deviation along x (pixel)", **_WIDTH)
    sigma_y = Parameter(description="Standard deviation along y (pixel)", **_WIDTH)
    rho = Parameter(description="Correlation coefficient", default=0.0, bounds=_RHO)
    sigma_x.validator(Domain("sigma_x", "positive"))
    sigma_y.validator(Domain("sigma_y", "positive"))
    rho.validator(Domain("rho", "from -1 to 1"))

    #: Kinds of the parameters in a fit.
    parameter_kinds: ClassVar = {"sigma_x": "width", "sigma_y": "width", "rho": "correlation"}

    def __init__(self, flux=1.0, x_0=0.0, y_0=0.0, sigma_x=0.5, sigma_y=0.5, rho=0.0, **kwargs):
        super().__init__(flux, x_0, y_0, sigma_x, sigma_y, rho, **kwargs)

    @staticmethod
    def evaluate(x, y, flux, x_0, y_0, sigma_x, sigma_y, rho):
        """Density at the positions, in units of flux per square pixel; NaN if it is singular."""
        rho = np.where(np.abs(rho) < 1, rho, np.nan)
        z_x = (x - x_0) / sigma_x
        z_y = (y - y_0) / sigma_y
        rest = 1 - rho**2
        norm = flux / (2 * np.pi * sigma_x * sigma_y * np.sqrt(rest))
        return norm * np.exp(-0.5 * ((z_x - rho * z_y) ** 2 / rest + z_y**2))

    @staticmethod
    def fit_deriv(x, y, flux, x_0, y_0, sigma_x, sigma_y, rho):
        """Derivatives of the density with respect to the parameters, in their order."""
        z_x = (x - x_0) / sigma_x
        z_y = (y - y_0) / sigma_y
        rest = 1 - rho**2
        unit = BivariateGaussianPSF.evaluate(x, y, 1.0, x_0, y_0, sigma_x, sigma_y, rho)
        density = flux * unit
        slope_x = (z_x - rho * z_y) / rest
        slope_y = (z_y - rho * z_x) / rest
        distance = z_x * slope_x + z_y * slope_y
        return [
            unit,
            density * slope_x / sigma_x,
            density * slope_y / sigma_y,
            density * (z_x * slope_x - 1) / sigma_x,
            density * (z_y * slope_y - 1) / sigma_y,
            density * (rho + z_x * z_y - rho * distance) / rest,
        ]

    @staticmethod
    def closed_form(values):
        """Return the integrals over pixels in closed form, for `integrate_pixels`."""
        names = ("x_0", "y_0", "sigma_x", "sigma_y")
        parameters = (*(pixels_of(values[name]) for name in names), values["rho"])
        engines = gaussian_pixels, gaussian_derivatives
        return ClosedForm(values["flux"], parameters, *engines, (*names, "rho"))

    def bounding_box(self, factor=6.5):
        """Rectangle outside which less than 2e-10 of the flux lies: 6.5 standard deviations."""
        return gaussian_box(self, factor)


def moffat_psf(fwhm, beta=4.765, n_components=8):
    r"""Return a Moffat PSF as a sum of Gaussians, which are fast to integrate.

    A Moffat function is a mixture of Gaussians of all widths,

    .. math::

        \left(1 + \frac{r^2}{\alpha^2}\right)^{-\beta} =
        \frac{1}{\Gamma(\beta)} \int_0^\infty t^{\beta - 1} e^{-t (1 + r^2 / \alpha^2)}\, dt ,
        \qquad \mathrm{FWHM} = 2 \alpha \sqrt{2^{1 / \beta} - 1} ,

    and Gauss-Laguerre quadrature makes a sum of it. Of the default ``beta``, eight components
    have the flux within one FWHM of the star to 1e-5, and 0.1 percent of all flux in another
    place, most of it beyond three FWHM. ``photutils.psf.MoffatPSF`` is the exact function.

    Parameters
    ----------
    fwhm : float or `~astropy.units.Quantity`
        Full width at half maximum in pixels.
    beta : float, optional
        Exponent, above 1. The default is that of turbulence (Trujillo et al. 2001); real images
        often have 2.5 to 4.
    n_components : int, optional
        Nodes of the quadrature; those with less than 1e-5 of the flux are left out.

    Returns
    -------
    psf : `~astropy.modeling.Model`
        Sum of `~scope_models.BivariateGaussianPSF`, of flux 1.

    Raises
    ------
    ValueError
        If the width is not positive or ``beta`` not above 1.

    References
    ----------
    Trujillo, I. et al. 2001, MNRAS 328, 977.

    Examples
    --------
    >>> from scope_models.models import moffat_psf
    >>> psf = moffat_psf(2.5)
    >>> print(f"{psf(1.25, 0) / psf(0, 0):.4f}")
    0.5000
    """
    fwhm = checked_number("fwhm", fwhm, "pix", positive=True)
    beta = checked_number("beta", beta)
    if beta <= 1:
        raise ValueError(f"`beta` must be above 1, got {beta}")
    nodes, weights = roots_genlaguerre(checked_integer("n_components", n_components, 1), beta - 2)
    alpha = fwhm / (2 * np.sqrt(2 ** (1 / beta) - 1))
    kept = weights >= _LEAST_FRACTION * weights.sum()
    fractions = (weights[kept] / weights[kept].sum()).tolist()
    sigmas = (alpha / np.sqrt(2 * nodes[kept])).tolist()
    pairs = zip(fractions, sigmas, strict=True)
    return reduce(add, (BivariateGaussianPSF(part, 0, 0, sigma, sigma) for part, sigma in pairs))
