"""Point spread functions, and the response within pixels."""

from functools import partial, reduce
from operator import add
from typing import ClassVar

import numpy as np
from astropy import units as u
from astropy.modeling import Fittable2DModel, Parameter
from astropy.units import UnitsError
from numpy.polynomial.polynomial import polyval
from scipy.special import roots_genlaguerre

from scope_models._arrays import is_angle, plain_array, without_unit
from scope_models._checks import checked_integer, checked_number
from scope_models.models._gaussian import (
    flattened,
    gaussian_pixels,
    hermite_functions,
    separable_images,
    slope_pairs,
)
from scope_models.models.integration import ClosedForm, collected, one_number, pixels_of

__all__ = [
    "BivariateGaussianPSF", "DiffusionSensitivity", "GaussHermitePSF", "SensitivityPolynomial",
    "moffat_psf",
]  # fmt: skip

_LEAST_WIDTH = float(np.finfo(np.float32).tiny)
_RHO = (-1 + 1e-9, 1 - 1e-9)  # bounds of a correlation
# Of the flux, in a component of a Moffat PSF.
_LEAST_FRACTION = 1e-5

_TESTS = {
    "finite": np.isfinite,
    "positive": lambda value: np.isfinite(value) & (value > 0),
    "inside (-1, 1)": lambda value: np.abs(value) < 1,
    "from -1 to 1": lambda value: np.abs(value) <= 1,
    "at least 0": lambda value: np.isfinite(value) & (value >= 0),
    "at least 0 and below 1": lambda value: (value >= 0) & (value < 1),
}


class StarModel(Fittable2DModel):
    """A star: its flux and position, and their units."""

    flux = Parameter(default=1.0, description="Flux of the star")
    x_0 = Parameter(default=0.0, description="Column of the star (pixel)")
    y_0 = Parameter(default=0.0, description="Row of the star (pixel)")

    #: Whether values are fluxes of pixels, not a density.
    pixel_integrated = False

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        check_model_parameters(self)
        self._check_units()

    def _check_units(self):
        """Raise unless lengths are pixels or angles; others but the flux have no unit."""
        for name in self.param_names[1:]:
            parameter, is_length = getattr(self, name), name in self._lengths
            if parameter.unit is not None and not (is_length and is_angle(parameter.unit)):
                plain_array(parameter.quantity, u.pix if is_length else u.one, name)

    @property
    def _lengths(self):
        """Parameters in the unit of x and y."""
        kinds = getattr(self, "parameter_kinds", {})
        return ("x_0", "y_0", *(n for n, kind in kinds.items() if kind in {"width", "offset"}))

    @property
    def input_units(self):
        """Units of x and y, or None."""
        unit = self.x_0.input_unit
        return unit and {self.inputs[0]: unit, self.inputs[1]: self.y_0.input_unit}

    def _parameter_units_for_data_units(self, inputs_unit, outputs_unit):
        unit, other = (inputs_unit[name] for name in self.inputs)
        if unit != other:
            raise UnitsError("units of x and y must be the same")
        flux = outputs_unit[self.outputs[0]] * (1 if self.pixel_integrated else unit**2)
        return {"flux": flux, **dict.fromkeys(self._lengths, unit)}


def make_parameters(model, parameters):
    """Give a model own parameters before its ``__init__``."""
    for parameter in parameters:
        parameter.model = model
        model.__dict__[parameter.name] = parameter
    names = (parameter.name for parameter in parameters)
    model.param_names = tuple(dict.fromkeys((*model.param_names, *names)))


def make_coefficients(model, order, function):
    """Give a model the coefficients ``c_k_m`` up to an order k + m; return all (k, m)."""
    places = [(n - m, m) for n in range(1, order + 1) for m in range(n + 1)]
    text = f"Coefficient of {function}_{{}} {function}_{{}}"
    coefficients = [
        Parameter(f"c_{k}_{m}", default=0.0, description=text.format(k, m)) for k, m in places
    ]
    make_parameters(model, coefficients)
    return places


def gaussian_box(model, factor):
    """Rectangle of so many sigma_x and sigma_y to either side."""
    d_x, d_y = factor * model.sigma_x, factor * model.sigma_y
    return ((model.y_0 - d_y, model.y_0 + d_y), (model.x_0 - d_x, model.x_0 + d_x))


def check_domain(name, condition, _model, value):
    """Raise where a value of a parameter lies outside its domain; the model is not used."""
    value = np.asarray(without_unit(value), dtype=float)
    wrong = ~_TESTS[condition](value)
    if np.any(wrong):
        raise ValueError(f"`{name}` must be {condition}, got {value[wrong].flat[0]}")


def check_model_parameters(model):
    """Raise where a parameter of a model is not finite or outside its domain."""
    for name in model.param_names:
        parameter = getattr(model, name)
        check_domain(name, "finite", model, parameter.value)
        parameter.validate(parameter.value)
        # photutils sets all parameters to 1 for a moment.
        if getattr(model, "parameter_kinds", {}).get(name) == "correlation":
            check_domain(name, "inside (-1, 1)", model, parameter.value)


def _width(axis):
    text = f"Standard deviation along {axis} (pixel)"
    parameter = Parameter(default=0.5, bounds=(_LEAST_WIDTH, None), description=text)
    return parameter.validator(partial(check_domain, f"sigma_{axis}", "positive"))


class BivariateGaussianPSF(StarModel):
    r"""Bivariate normal density times a flux.

    .. math::

        P(x, y) = \frac{F}{2 \pi \sigma_x \sigma_y \sqrt{1 - \rho^2}}
        \exp\left[-\frac{z_x^2 - 2 \rho z_x z_y + z_y^2}{2 (1 - \rho^2)}\right],
        \qquad z_x = \frac{x - x_0}{\sigma_x}, \quad z_y = \frac{y - y_0}{\sigma_y}.

    The density is the light before the pixel; `~scope_models.integrate_pixels` and
    `~scope_models.PRF` integrate it. Equation 3 of Saunders et al. (2019) has an extra factor 1/2
    on the two squared terms in print; this is the standard density.

    Parameters
    ----------
    flux : float or `~astropy.units.Quantity`
        Integral of the density over the plane.
    x_0, y_0 : float or `~astropy.units.Quantity`
        Position of the star in pixels; x is the column, y the row.
    sigma_x, sigma_y : float or `~astropy.units.Quantity`
        Standard deviations along the axes in pixels; in angles only for the ``psf`` of a
        `~scope_models.Detector`.
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
    A sum of several is a PSF of several components. Parameters of shape ``(n,)`` make
    `~scope_models.integrate_pixels` return ``n`` images.

    References
    ----------
    Saunders, Luger & Barnes 2019, arXiv:1903.09629, equation 3 (corrected).

    Examples
    --------
    >>> from scope_models import BivariateGaussianPSF
    >>> psf = BivariateGaussianPSF(flux=1000, sigma_x=0.5, sigma_y=0.4, rho=0.2)
    >>> print(f"{psf(0, 0):.1f}")
    812.2
    """

    sigma_x, sigma_y = _width("x"), _width("y")
    rho = Parameter(description="Correlation coefficient", default=0.0, bounds=_RHO)
    rho.validator(partial(check_domain, "rho", "from -1 to 1"))

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
        """Return the integrals over pixels in closed form."""
        names = ("x_0", "y_0", "sigma_x", "sigma_y")
        parameters = (*(pixels_of(values[name]) for name in names), values["rho"])
        return ClosedForm(values["flux"], parameters, gaussian_pixels, (*names, "rho"))

    def bounding_box(self, factor=6.5):
        """Rectangle outside which less than 2e-10 of the flux lies."""
        return gaussian_box(self, factor)


def moffat_psf(fwhm, beta=4.765, n_components=8):
    r"""Return a Moffat PSF as a sum of Gaussians, which are fast to integrate.

    A Moffat function is a mixture of Gaussians of all widths,

    .. math::

        \left(1 + \frac{r^2}{\alpha^2}\right)^{-\beta} =
        \frac{1}{\Gamma(\beta)} \int_0^\infty t^{\beta - 1} e^{-t (1 + r^2 / \alpha^2)}\, dt ,
        \qquad \mathrm{FWHM} = 2 \alpha \sqrt{2^{1 / \beta} - 1} ,

    and Gauss-Laguerre quadrature makes a sum of it. By default the flux within one FWHM is right to
    1e-5, and 0.1 percent of all is elsewhere. ``photutils.psf.MoffatPSF`` is exact.

    Parameters
    ----------
    fwhm : float or `~astropy.units.Quantity`
        Full width at half maximum in pixels.
    beta : float, optional
        Exponent, above 1. The default is that of turbulence; real images often have 2.5 to 4.
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
    Trujillo et al. 2001, MNRAS 328, 977.

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


class GaussHermitePSF(StarModel):
    r"""A Gaussian with a smooth surface of low order on it.

    .. math::

        P(x, y) = \frac{F}{\sigma_x \sigma_y} \sum_{k + m \le N} c_{km}\, h_k(z_x)\, h_m(z_y),
        \qquad h_k(z) = \frac{He_k(z)}{\sqrt{k!}} \varphi(z), \quad c_{00} = 1,

    with :math:`z_x = (x - x_0) / \sigma_x`, the probabilists' Hermite polynomials and the normal
    density :math:`\varphi`. The density may be negative somewhere.

    Parameters
    ----------
    flux : float or `~astropy.units.Quantity`
        Integral of the density over the plane.
    x_0, y_0 : float or `~astropy.units.Quantity`
        Position of the star in pixels.
    sigma_x, sigma_y : float or `~astropy.units.Quantity`
        Widths of the first term in pixels.
    order : int, optional
        Largest k + m. The default is that of the given coefficients, at least 4.
    **kwargs
        Coefficients ``c_k_m``, 0 by default, and keywords of `~astropy.modeling.Model`.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, a width is not positive, or the order is not between 1 and
        20 or too small for the coefficients.

    Examples
    --------
    >>> from scope_models.models import GaussHermitePSF, integrate_pixels
    >>> psf = GaussHermitePSF(100, sigma_x=0.6, sigma_y=0.6, order=3, c_3_0=0.1)
    >>> print(integrate_pixels(psf, x=[-1, 0, 1], y=[0, 0, 0]).round(2))
    [12.11 35.44 11.24]
    """

    sigma_x, sigma_y = _width("x"), _width("y")

    def __init__(self, flux=1.0, x_0=0.0, y_0=0.0, sigma_x=0.5, sigma_y=0.5, order=None, **kwargs):
        given = [name for name in kwargs if name.startswith("c_")]
        if order is None:
            order = max([4, *(sum(map(int, name.split("_")[1:])) for name in given)])
        self.order = checked_integer("order", order, 1, 20)
        self._places = make_coefficients(self, self.order, "h")
        unknown = set(given) - set(self.param_names)
        if unknown:
            listed = ", ".join(sorted(unknown))
            raise ValueError(f"`order` {self.order} has no coefficient {listed}")
        for name in given:
            if np.ndim(kwargs[name]):
                raise ValueError(f"`{name}` must be one number, got {np.size(kwargs[name])} values")
        super().__init__(flux, x_0, y_0, sigma_x, sigma_y, **kwargs)

    @property
    def parameter_kinds(self):
        """Kinds of the parameters in a fit: "width" or "coefficient" (dict of str)."""
        kinds = {"sigma_x": "width", "sigma_y": "width"}
        return kinds | dict.fromkeys(self.param_names[5:], "coefficient")

    def _matrix(self, coefficients):
        """Coefficients as a matrix ``[m, k]``."""
        matrix = np.zeros((self.order + 1, self.order + 1))
        matrix[0, 0] = 1.0
        for (k, m), value in zip(self._places, coefficients, strict=True):
            matrix[m, k] = one_number(f"c_{k}_{m}", value)
        return matrix

    def evaluate(self, x, y, flux, x_0, y_0, sigma_x, sigma_y, *coefficients):
        """Density at the positions, in units of flux per square pixel."""
        along_x, along_y = (
            hermite_functions(np.asarray((u - u_0) / sigma, dtype=float), self.order + 1)
            for u, u_0, sigma in ((x, x_0, sigma_x), (y, y_0, sigma_y))
        )
        density = np.einsum("lk,k...,l...->...", self._matrix(coefficients), along_x, along_y)
        return density * (flux / (sigma_x * sigma_y))

    def fit_deriv(self, x, y, flux, x_0, y_0, sigma_x, sigma_y, *coefficients):
        """Derivatives of the density with respect to the parameters, in their order."""
        z = np.broadcast_arrays((x - x_0) / sigma_x, (y - y_0) / sigma_y)
        tables = (hermite_functions(u.ravel(), self.order + 3) for u in z)
        x_table, y_table = (t / sigma for t, sigma in zip(tables, (sigma_x, sigma_y), strict=True))
        weigh = partial(np.matmul, self._matrix(coefficients).T)
        pairs = slope_pairs(x_table, y_table, sigma_x, sigma_y, weigh)
        pairs += self._terms(None, x_table, y_table)
        unit, *parts = (np.sum(a * b, axis=0).reshape(z[0].shape) for a, b in pairs)
        return [unit, *(flux * part for part in parts)]

    def _terms(self, _part, x_table, y_table):
        """Tables whose products are the derivatives by the coefficients."""
        return [(y_table[..., [m], :], x_table[..., [k], :]) for k, m in self._places]

    def _integrals(
        self, matrix, x, y, x_0, y_0, sigma_x, sigma_y, along_x, along_y, *, derivatives=False
    ):
        """Integrals of the density of unit flux, and their derivatives."""
        shape, flat = flattened((x_0, y_0, sigma_x, sigma_y))
        images = np.empty(
            (len(self.param_names) if derivatives else 1, flat[0].size, y.size, x.size)
        )
        polynomials = np.atleast_1d(along_x), np.atleast_1d(along_y)
        separable_images(
            x,
            y,
            flat,
            polynomials,
            self.order + 1,
            lambda _part, table: matrix.T @ table,
            self._terms,
            images,
        )
        images = images.reshape((len(images), *shape, y.size, x.size))
        return images if derivatives else images[0]

    def closed_form(self, values):
        """Return the integrals over pixels in closed form."""
        parameters = tuple(pixels_of(values[name]) for name in self.param_names[1:5])
        matrix = self._matrix([values[name] for name in self.param_names[5:]])
        integrals = partial(self._integrals, matrix)
        return ClosedForm(values["flux"], parameters, integrals, self.param_names[1:])

    def bounding_box(self, factor=6.5):
        """Rectangle outside which hardly any flux lies."""
        return gaussian_box(self, factor + np.sqrt(self.order))


def _offset(position):
    """Offset from the center of the pixel that holds the position, in [-1/2, 1/2)."""
    position = plain_array(position, u.pix, "position")
    return position - np.floor(position + 0.5)


class SensitivityPolynomial(Fittable2DModel):
    r"""Response within each pixel: a polynomial in x times a polynomial in y.

    .. math:: s(x, y) = \sum_n a_{x,n} u^n \; \sum_m a_{y,m} v^m,

    where (u, v), each in [-1/2, 1/2), is the offset of (x, y) from the center of the pixel that
    holds it: equation 2 of Saunders et al. (2019) without the factor :math:`b_i` of the pixel,
    which is the interpixel map of a `~scope_models.Detector`.

    Parameters
    ----------
    x_coefficients, y_coefficients : sequence of float, optional
        Coefficients along the column and along the row, the constants first, which become the
        parameters ``ax0, ax1, ...`` and ``ay0, ay1, ...``. The defaults, the paper's, lose 2.48 %
        from the center to the corner of a pixel.
    **kwargs
        Keywords of `~astropy.modeling.Model`, such as ``fixed``, ``bounds`` and ``name``.

    Raises
    ------
    ValueError
        If a coefficient is not finite, or there is none.

    References
    ----------
    Saunders, Luger & Barnes 2019, arXiv:1903.09629, equation 2.

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
        values, parameters = {}, []
        for axis, offset, given in (("x", "u", x_coefficients), ("y", "v", y_coefficients)):
            name = f"{axis}_coefficients"
            row = plain_array(given, u.one, name)
            if row.ndim != 1 or row.size == 0:
                wanted = "a sequence of at least one number"
                raise ValueError(f"`{name}` must be {wanted}, got shape {row.shape}")
            for n, value in enumerate(row):
                text = f"Coefficient of {offset}^{n}"
                parameters.append(Parameter(f"a{axis}{n}", description=text))
                values[f"a{axis}{n}"] = value
        self._n_x = len(values) - row.size
        make_parameters(self, parameters)
        super().__init__(**values, **kwargs)
        check_model_parameters(self)

    @property
    def x_coefficients(self):
        """Coefficients along x, the constant first (tuple of float)."""
        return tuple(self.parameters[: self._n_x].tolist())

    @property
    def y_coefficients(self):
        """Coefficients along y, the constant first (tuple of float)."""
        return tuple(self.parameters[self._n_x :].tolist())

    @property
    def powers(self):
        """Axis ("x" or "y") and power of each coefficient, by name (dict)."""
        return {name: (name[1], int(name[2:])) for name in self.param_names}

    def evaluate(self, x, y, *coefficients):
        """Response at the positions, dimensionless."""
        along_x = polyval(_offset(x), coefficients[: self._n_x], tensor=False)
        return along_x * polyval(_offset(y), coefficients[self._n_x :], tensor=False)

    def fit_deriv(self, x, y, *coefficients):
        """Derivatives of the response with respect to the parameters, in their order."""
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

    is the part of the charge from the offset (u, v) that a pixel collects. Its neighbors collect
    the rest: a sum of all pixels does not depend on where the star is.

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
    The integral over pixels of a density times this response is that of the density convolved with
    the diffusion. A Gaussian becomes a wider one: `~scope_models.fit_tpf` holds sigma_d where a
    width is free. A `~scope_models.SensitivityPolynomial` in the product acts before the charge
    diffuses.

    Evaluated, the model is the part that the pixel which holds (x, y) keeps.

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
    sigma_d.validator(partial(check_domain, "sigma_d", "at least 0"))

    def __init__(self, sigma_d=sigma_d.default, **kwargs):
        super().__init__(sigma_d=plain_array(sigma_d, u.pix, "sigma_d"), **kwargs)
        check_model_parameters(self)

    #: The response is not a polynomial.
    powers: ClassVar = {}

    #: Kind of the parameter in a fit.
    parameter_kinds: ClassVar = {"sigma_d": "diffusion"}

    def response(self, dx, dy):
        """Part of the charge that a pixel collects.

        Parameters
        ----------
        dx, dy : array_like or `~astropy.units.Quantity`
            Where the charge is set free, from the pixel's center, pixels.

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
        """Derivatives of the response with respect to the parameters, a list of one array."""
        sigma = float(np.ravel(sigma_d)[0])
        along_x, by_x = collected(_offset(x), sigma)
        along_y, by_y = collected(_offset(y), sigma)
        return [along_x * by_y + by_x * along_y]

    def _parameter_units_for_data_units(self, _inputs_unit, _outputs_unit):
        return {}
