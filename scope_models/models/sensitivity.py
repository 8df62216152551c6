"""Sensitivity: the response of pixels, as a function of the position within them."""

from typing import ClassVar

import numpy as np
from astropy import units as u
from astropy.modeling import Fittable2DModel, Parameter
from numpy.polynomial.polynomial import polyval
from scipy.special import erf

from scope_models._arrays import plain_array
from scope_models.models._parameters import Domain, check_model_parameters, make_parameters

__all__ = ["DiffusionSensitivity", "SensitivityPolynomial"]

# Pixels, in place of none: so small that each pixel is a box, and squares of quotients are finite.
_LEAST_DIFFUSION = 1e-100


def collected(offset, sigma):
    """Part of the charge that a pixel collects along one axis, and its derivative by sigma.

    The charge is set free at an offset from the pixel's center and diffuses by sigma, pixels.
    """
    offset, sigma = np.asarray(offset, dtype=float), max(sigma, _LEAST_DIFFUSION)
    scaled = np.stack([offset + 0.5, offset - 0.5]) / (np.sqrt(2) * sigma)
    part = 0.5 * (erf(scaled[0]) - erf(scaled[1]))
    slope = scaled * np.exp(-(scaled**2)) / (np.sqrt(np.pi) * sigma)
    return part, slope[1] - slope[0]


def _offset(position):
    """Offset from the center of the pixel that holds the position, in [-1/2, 1/2)."""
    position = plain_array(position, u.pix, "position")
    return position - np.floor(position + 0.5)


def _checked(name, coefficients):
    coefficients = plain_array(coefficients, u.one, name)
    if coefficients.ndim != 1 or coefficients.size == 0:
        shape = coefficients.shape
        raise ValueError(f"`{name}` must be a sequence of at least one number, got shape {shape}")
    return coefficients


class SensitivityPolynomial(Fittable2DModel):
    r"""Response within each pixel: a polynomial in x times a polynomial in y.

    .. math:: s(x, y) = \sum_n a_{x,n} u^n \; \sum_m a_{y,m} v^m,

    where (u, v), each in [-1/2, 1/2), is the offset of (x, y) from the center of the pixel that
    holds it, so that every pixel has the same response. This is equation 2 of Saunders et al.
    (2019) without the factor :math:`b_i` of the pixel, which is the interpixel map of a
    `~scope_models.Detector`.

    Parameters
    ----------
    x_coefficients, y_coefficients : sequence of float, optional
        Coefficients along the column and along the row, the constants first; any number, one at
        least. They become the parameters ``ax0, ax1, ...`` and ``ay0, ay1, ...``. The defaults,
        the paper's, lose 2.48 % from the center to the corner of a pixel.
    **kwargs
        Keywords of `~astropy.modeling.Model`, such as ``fixed``, ``bounds`` and ``name``.

    Raises
    ------
    ValueError
        If a coefficient is not finite, or there is none.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", equation 2.

    Examples
    --------
    >>> from scope_models import SensitivityPolynomial
    >>> sensitivity = SensitivityPolynomial()
    >>> print(f"{sensitivity(3, 7):.4f} {sensitivity(2.5, 7.5):.4f}")
    1.0000 0.9752
    >>> sensitivity.param_names
    ('ax0', 'ax1', 'ax2', 'ay0', 'ay1', 'ay2')
    """

    def __init__(self, x_coefficients=(1, 0, -0.05), y_coefficients=(1, 0, -0.05), **kwargs):
        x_coefficients = _checked("x_coefficients", x_coefficients)
        y_coefficients = _checked("y_coefficients", y_coefficients)
        self._n_x = x_coefficients.size
        values = {f"ax{n}": value for n, value in enumerate(x_coefficients)}
        values |= {f"ay{n}": value for n, value in enumerate(y_coefficients)}
        offsets = {"x": "u", "y": "v"}
        make_parameters(self, {n: f"Coefficient of {offsets[n[1]]}^{n[2:]}" for n in values})
        super().__init__(**values, **kwargs)
        check_model_parameters(self)

    @property
    def x_coefficients(self):
        """Coefficients along x, the constant first (tuple of float)."""
        return tuple(float(getattr(self, n).value) for n in self.param_names[: self._n_x])

    @property
    def y_coefficients(self):
        """Coefficients along y, the constant first (tuple of float)."""
        return tuple(float(getattr(self, n).value) for n in self.param_names[self._n_x :])

    @property
    def powers(self):
        """Axis ("x" or "y") and power of the coefficients by name (dict of str to tuple)."""
        return {name: (name[1], int(name[2:])) for name in self.param_names}

    def evaluate(self, x, y, *coefficients):
        """Response at the positions, dimensionless."""
        along_x = polyval(_offset(x), coefficients[: self._n_x], tensor=False)
        return along_x * polyval(_offset(y), coefficients[self._n_x :], tensor=False)

    def fit_deriv(self, x, y, *coefficients):
        """Derivatives of the response with respect to the coefficients, in their order."""
        u, v = _offset(x), _offset(y)
        along_x = polyval(u, coefficients[: self._n_x], tensor=False)
        along_y = polyval(v, coefficients[self._n_x :], tensor=False)
        n_y = len(coefficients) - self._n_x
        return [u**n * along_y for n in range(self._n_x)] + [along_x * v**n for n in range(n_y)]

    def _parameter_units_for_data_units(self, _inputs_unit, _outputs_unit):
        return {}


class DiffusionSensitivity(Fittable2DModel):
    r"""Response of pixels that share charge: a box convolved with a normal distribution.

    .. math:: s(u, v) = c(u)\, c(v), \qquad
              c(u) = \frac{1}{2}\left[\mathrm{erf}\frac{u + 1/2}{\sqrt{2}\,\sigma_d} -
              \mathrm{erf}\frac{u - 1/2}{\sqrt{2}\,\sigma_d}\right]

    is the part of the charge from the offset (u, v) that a pixel collects. It does not end at the
    pixel's edge: light that falls into a pixel is collected by its neighbors too, and the sum over
    all pixels is 1. No light is lost, and a sum of all pixels does not depend on where the
    star is, however deep the drop of a single pixel's response.

    Parameters
    ----------
    sigma_d : float or `~astropy.units.Quantity`, optional
        Standard deviation of the diffusion along each axis, pixels; 0 for none.
    **kwargs
        Keywords of `~astropy.modeling.Model`, such as ``fixed``, ``bounds`` and ``name``.

    Raises
    ------
    ValueError
        If sigma_d is negative or not finite.

    Notes
    -----
    In a product with a density, integrated over pixels, this response reaches into the pixels
    around: the result is that of the density convolved with the diffusion. A Gaussian becomes a
    wider Gaussian, so that pixels do not separate its width and sigma_d, and
    `~scope_models.fit_tpf` holds sigma_d where a width is free. A
    `~scope_models.SensitivityPolynomial` in the product acts where the light falls, before the
    charge diffuses.

    Evaluated, the model is the part that the pixel which holds (x, y) keeps; `response` is that of
    any pixel.

    Examples
    --------
    >>> from scope_models.models import BivariateGaussianPSF, DiffusionSensitivity, integrate_pixels
    >>> sensitivity = DiffusionSensitivity(0.15)
    >>> print(f"{sensitivity(3, 7):.4f} {sensitivity(2.5, 7):.4f}")
    0.9983 0.4996
    >>> image = integrate_pixels(BivariateGaussianPSF(1, 3, 3) * sensitivity, (7, 7))
    >>> print(f"{image.sum():.6f}")
    1.000000
    """

    sigma_d = Parameter(
        default=0.1, bounds=(0.0, None), description="Standard deviation of the diffusion (pixel)"
    )
    sigma_d.validator(Domain("sigma_d", "at least 0"))

    def __init__(self, sigma_d=sigma_d.default, **kwargs):
        super().__init__(sigma_d=plain_array(sigma_d, u.pix, "sigma_d"), **kwargs)
        check_model_parameters(self)

    #: The response is not a polynomial: it has no powers.
    powers: ClassVar = {}

    #: Kind of the parameter in a fit.
    parameter_kinds: ClassVar = {"sigma_d": "diffusion"}

    def response(self, dx, dy):
        """Part of the charge that a pixel collects.

        Parameters
        ----------
        dx, dy : array_like or `~astropy.units.Quantity`
            Where the charge is set free, from the pixel's center, pixels; anywhere.

        Returns
        -------
        part : `~numpy.ndarray`
            Of the common shape.
        """
        sigma = float(self.sigma_d.value)
        dx, dy = plain_array(dx, u.pix, "dx"), plain_array(dy, u.pix, "dy")
        return collected(dx, sigma)[0] * collected(dy, sigma)[0]

    def evaluate(self, x, y, sigma_d):
        """Part of the charge that stays in the pixel where it is set free."""
        sigma = float(np.ravel(sigma_d)[0])
        return collected(_offset(x), sigma)[0] * collected(_offset(y), sigma)[0]

    def fit_deriv(self, x, y, sigma_d):
        """Derivative of the response with respect to sigma_d, a list of one array."""
        sigma = float(np.ravel(sigma_d)[0])
        along_x, by_x = collected(_offset(x), sigma)
        along_y, by_y = collected(_offset(y), sigma)
        return [along_x * by_y + by_x * along_y]

    def _parameter_units_for_data_units(self, _inputs_unit, _outputs_unit):
        return {}
