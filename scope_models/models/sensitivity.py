# Licensed under a 3-clause BSD style license - see LICENSE
"""Sensitivity: the response of a pixel, as a function of the position within it."""

import numpy as np
from astropy import units as u
from astropy.modeling import Fittable2DModel

from scope_models._arrays import plain_array
from scope_models.models._instance_parameters import InstanceParameters, described
from scope_models.models._validation import check_model_parameters

__all__ = ["SensitivityPolynomial"]


def _offset(position):
    """Offset from the center of the pixel that holds the position, in [-1/2, 1/2)."""
    position = plain_array(position, u.pix, "position")
    return position - np.floor(position + 0.5)


def _checked(name, coefficients):
    coefficients = plain_array(coefficients, u.one, name)
    if coefficients.ndim != 1 or coefficients.size == 0:
        raise ValueError(
            f"`{name}` must be a sequence of at least one number, got shape {coefficients.shape}"
        )
    return coefficients


class SensitivityPolynomial(InstanceParameters, Fittable2DModel):
    r"""
    Response within each pixel: a polynomial in x times a polynomial in y.

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
        self.make_parameters(
            [described(n, f"Coefficient of {'uv'['xy'.index(n[1])]}^{n[2:]}") for n in values]
        )
        super().__init__(**values, **kwargs)
        check_model_parameters(self)

    @property
    def x_coefficients(self):
        """Coefficients along x, the constant first (tuple of float)."""
        return tuple(float(getattr(self, n).value) for n in self._param_names[: self._n_x])

    @property
    def y_coefficients(self):
        """Coefficients along y, the constant first (tuple of float)."""
        return tuple(float(getattr(self, n).value) for n in self._param_names[self._n_x :])

    @property
    def powers(self):
        """Axis ("x" or "y") and power of the coefficients by name (dict of str to tuple)."""
        along = [("x", n) for n in range(self._n_x)]
        along += [("y", n) for n in range(len(self.param_names) - self._n_x)]
        return dict(zip(self.param_names, along, strict=True))

    def evaluate(self, x, y, *coefficients):
        """
        Response at the positions.

        Parameters
        ----------
        x, y : array_like
            Positions in pixels.
        *coefficients : array_like
            The parameters, in their order.

        Returns
        -------
        response : `~numpy.ndarray`
            Dimensionless.
        """
        along_x = _polynomial(_offset(x), coefficients[: self._n_x])
        return along_x * _polynomial(_offset(y), coefficients[self._n_x :])

    def fit_deriv(self, x, y, *coefficients):
        """
        Derivatives of the response with respect to the coefficients.

        Parameters
        ----------
        x, y : array_like
            Positions in pixels.
        *coefficients : array_like
            The parameters, in their order.

        Returns
        -------
        derivatives : list of `~numpy.ndarray`
            One array per parameter, in their order.
        """
        u, v = _offset(x), _offset(y)
        along_x = _polynomial(u, coefficients[: self._n_x])
        along_y = _polynomial(v, coefficients[self._n_x :])
        n_y = len(coefficients) - self._n_x
        return [u**n * along_y for n in range(self._n_x)] + [along_x * v**n for n in range(n_y)]

    def _parameter_units_for_data_units(self, inputs_unit, outputs_unit):  # noqa: ARG002
        return {}


def _polynomial(u, coefficients):
    value = np.zeros_like(u)
    for coefficient in coefficients[::-1]:
        value = value * u + coefficient
    return value
