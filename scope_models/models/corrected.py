"""Tables of PRFs times a smooth correction that pixels can constrain."""

import numpy as np
from numpy.polynomial import chebyshev

from scope_models._arrays import plain_array
from scope_models._checks import checked_integer, checked_number
from scope_models.models._parameters import make_parameters
from scope_models.models.tables import TabulatedPRF

__all__ = ["CorrectedPRF"]


class CorrectedPRF(TabulatedPRF):
    r"""A table of a PRF times a smooth function of the offset from the star.

    .. math:: f(d_x, d_y) = T(d_x, d_y) \Big[1 + \sum_{0 < k + m \le n} c_{k,m}
              \big(T_k(t_x)\, T_m(t_y) - \overline{T_k T_m}\big)\Big],
              \qquad t = \frac{d}{\sqrt{d^2 + r^2}},

    with Chebyshev polynomials. The mean over the table, weighted by it, is taken off each term, so
    that the sum of the table, and with it the meaning of the flux, does not change.

    Parameters
    ----------
    array : array_like of shape (ny, nx)
        Flux of a pixel at each offset, as for `~scope_models.models.TabulatedPRF`.
    oversampling : float or tuple of float, optional
        Samples per pixel, one number or (y, x).
    flux : float or `~astropy.units.Quantity`, optional
        Flux of the star.
    x_0, y_0 : float or `~astropy.units.Quantity`, optional
        Position of the star in pixels.
    order : int, optional
        Largest sum n of the orders k and m.
    radius : float or `~astropy.units.Quantity`, optional
        Offset r, pixels, beyond which the correction changes little.
    **kwargs
        Coefficients ``c_k_m``, 0 by default, and the other arguments of
        `~scope_models.models.TabulatedPRF`.

    Raises
    ------
    ValueError
        If an argument is outside its domain, as for `~scope_models.models.TabulatedPRF`.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.models import PRF, BivariateGaussianPSF, CorrectedPRF
    >>> y, x = np.mgrid[-45:46, -45:46] / 9
    >>> samples = PRF(BivariateGaussianPSF())(x, y)
    >>> wider = CorrectedPRF(samples, 9, order=2, c_2_0=0.1, c_0_2=0.1)
    >>> image = PRF(wider).render((9, 9), flux=100, x_0=4, y_0=4)
    >>> print(f"{image[4, 4]:.1f} {image[4, 5]:.1f} {image.sum():.1f}")
    45.3 10.9 99.8
    """

    def __init__(
        self, array, oversampling=1, flux=1.0, x_0=0.0, y_0=0.0, *, order=2, radius=2.0, **kwargs
    ):
        self.order = order = checked_integer("order", order, 1)
        self.radius = checked_number("radius", radius, "pix", positive=True)
        names = {f"c_{k}_{m}": f"Coefficient of T_{k} T_{m}" for k, m in self._orders()}
        make_parameters(self, names)
        kwargs = dict.fromkeys(names, 0.0) | kwargs
        super().__init__(array, oversampling, flux, x_0, y_0, **kwargs)
        along_x, along_y = (chebyshev.chebvander(self._t(d)[0], order) for d in self._offsets())
        means = along_y.T @ self.array @ along_x / self.array.sum()
        self._means = np.array([means[m, k] for k, m in self._orders()])

    def _orders(self):
        n = self.order
        return [(k, s - k) for s in range(1, n + 1) for k in range(s, -1, -1)]

    @property
    def arguments(self):
        """Arguments of an equal model, without its parameters (dict)."""
        return super().arguments | {"order": self.order, "radius": self.radius}

    @property
    def parameter_kinds(self):
        """Kinds of the parameters in a fit (dict of str)."""
        return dict.fromkeys(self.param_names[3:], "correction")

    def _t(self, d):
        """The bounded coordinate and its derivative."""
        square = d**2 + self.radius**2
        return d / np.sqrt(square), self.radius**2 * square**-1.5

    def unit_derivatives(self, dx, dy, *coefficients):
        """Return fluxes of unit flux and derivatives by x_0, y_0 and coefficients, at offsets."""
        dx, dy = np.broadcast_arrays(plain_array(dx, "pix", "dx"), plain_array(dy, "pix", "dy"))
        table, table_x, table_y = super().unit_derivatives(dx, dy)
        (t_x, slope_x), (t_y, slope_y) = self._t(dx), self._t(dy)
        values, slopes = [], []
        for t, slope in ((t_x, slope_x), (t_y, slope_y)):
            values.append(chebyshev.chebvander(t, self.order))
            matrix = chebyshev.chebder(np.eye(self.order + 1))
            lower = chebyshev.chebvander(t, self.order - 1)
            slopes.append((lower @ matrix) * slope[..., np.newaxis])
        factor, factor_x, factor_y, by_coefficient = 1.0, 0.0, 0.0, []
        for (k, m), mean, c in zip(self._orders(), self._means, coefficients, strict=True):
            term = values[0][..., k] * values[1][..., m] - mean
            by_coefficient.append(table * term)
            factor = factor + c * term
            factor_x = factor_x + c * slopes[0][..., k] * values[1][..., m]
            factor_y = factor_y + c * values[0][..., k] * slopes[1][..., m]
        by_x, by_y = table_x * factor - table * factor_x, table_y * factor - table * factor_y
        return [table * factor, by_x, by_y, *by_coefficient]

    def evaluate(self, x, y, flux, x_0, y_0, *coefficients):
        """Flux in the pixels."""
        axes = ("x", x, x_0), ("y", y, y_0)
        offsets = [plain_array(a, "pix", n) - plain_array(b, "pix", f"{n}_0") for n, a, b in axes]
        return flux * self.unit_derivatives(*offsets, *coefficients)[0]

    def to_photutils(self):
        """Return the corrected table as a model of photutils.

        Returns
        -------
        model : `~photutils.psf.ImagePSF`
            With the same flux and position.
        """
        return self.corrected_table().to_photutils()

    def corrected_table(self):
        """Return a plain table of the corrected PRF.

        Returns
        -------
        table : TabulatedPRF
            With the correction in its samples.
        """
        dx, dy = self._offsets()
        samples = self.unit_derivatives(dx, dy[:, np.newaxis], *self.parameters[3:])[0]
        values = (getattr(self, name).value for name in ("flux", "x_0", "y_0"))
        return TabulatedPRF(samples, self.oversampling, *values, origin=self.origin)
