# Licensed under a 3-clause BSD style license - see LICENSE
"""Pixel response functions: what a fit or a renderer sees of a star, flux per pixel."""

from dataclasses import dataclass

import numpy as np
from astropy import units as u
from astropy.modeling import Fittable2DModel, Parameter

from scope_models.models._derivatives import unit_derivatives
from scope_models.models._terms import Factor, Term, expand, is_pixel_integrated
from scope_models.models._validation import check_model_parameters
from scope_models.models.integration import PixelPoints, integrate_term

__all__ = ["PRF"]

_POSITION = ("flux", "x_0", "y_0")


@dataclass(frozen=True, eq=False)
class _Component:
    """One density of the compound: which parameter of the PRF feeds which of its own."""

    model: object  # the density
    scale: float  # constant factor in the compound
    shape: dict  # own parameter -> parameter of the PRF, without flux, x_0, y_0
    fraction: str | None  # parameter that holds its part of the flux; None: the rest
    offsets: tuple  # parameters that hold its position relative to the star, or ()
    sensitivities: tuple  # indices of the sensitivities that multiply it


class PRF(Fittable2DModel):
    r"""
    Flux per pixel of a star: a compound of densities and sensitivities, integrated over pixels.

    .. math:: f_{ij} = F \int_{i-1/2}^{i+1/2} \int_{j-1/2}^{j+1/2} \sum_k \phi_k\,
              p_k(x - x_0, y - y_0)\, s(x, y)\, dy\, dx, \qquad \sum_k \phi_k = 1,

    with densities :math:`p_k` of unit integral and s the product of the sensitivities. The
    integrals are those of `~scope_models.integrate_pixels`.

    Parameters
    ----------
    compound : `~astropy.modeling.Model`
        Sum of densities with the parameters ``flux``, ``x_0`` and ``y_0`` (our PSFs, photutils'
        PSFs), each multiplied by any number of `~scope_models.SensitivityPolynomial`, such as
        ``(core + wings) * SensitivityPolynomial()``.
    flux, x_0, y_0 : float or `~astropy.units.Quantity`, optional
        Overall flux and position; by default the sum of the components' fluxes and the position
        of the first component.
    **kwargs
        Values of the other parameters, and keywords of `~astropy.modeling.Model` such as
        ``fixed`` and ``bounds``.

    Raises
    ------
    TypeError, ValueError
        If the compound is not such a sum, holds tied or array-valued parameters or a model that
        is integrated over pixels already, its fluxes do not add up to a positive number, or a
        parameter is not finite.

    Notes
    -----
    The parameters are ``flux``, ``x_0``, ``y_0`` and the components' own remaining ones. With
    several components these end in ``_0``, ``_1``, ..., and each component but the first has
    ``flux_fraction_k``, its part of the flux (the first has the rest), and ``x_offset_k``,
    ``y_offset_k``, its position relative to the first. Nothing is tied: the constraints are in
    the parametrisation.

    Bounds and fixed parameters are taken over from the components. Two kinds are fixed unless
    that is changed by, for example, ``prf.ax2.fixed = False``: the coefficients of the sensitivity
    and the offsets, because a single image hardly tells them from position, flux and width.

    Evaluated at positions that are no integers, the model gives the flux in the unit square
    around them, with the response of a pixel centred there, as photutils' PRFs do.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation", equation 1.

    Examples
    --------
    >>> from scope_models import PRF, BivariateGaussianPSF, SensitivityPolynomial
    >>> core, wings = BivariateGaussianPSF(0.8), BivariateGaussianPSF(0.2, sigma_x=1.2, sigma_y=1.2)
    >>> prf = PRF((core + wings) * SensitivityPolynomial(), flux=1000)
    >>> print(prf([-1, 0, 1], [0, 0, 0]).round(1))
    [100.1 390.8 100.1]
    >>> cube = prf.render((5, 5), flux=[1000, 990], x_0=[2, 2.1], y_0=[2, 2])
    >>> cube.shape
    (2, 5, 5)
    """

    #: Values are fluxes of pixels, not a density.
    pixel_integrated = True
    # Filled in by each instance: the parameters depend on the compound.
    _param_names = ()

    def __init__(self, compound, flux=None, x_0=None, y_0=None, **kwargs):
        terms = [term for term in expand(compound) if np.any(term.scale)]
        _check_compound(compound, terms)
        self._terms_of(terms)
        first = terms[0].densities[0].model
        fluxes = [term.scale * _value(term.densities[0].model.flux) for term in terms]
        total = sum(fluxes[1:], start=fluxes[0])
        if not np.isfinite(total) or total <= 0:
            raise ValueError(f"the components' fluxes must add up to a positive sum, got {total}")
        values = {
            "flux": total if flux is None else flux,
            "x_0": _value(first.x_0) if x_0 is None else x_0,
            "y_0": _value(first.y_0) if y_0 is None else y_0,
        }
        parameters = self._overall_parameters(first, alone=len(terms) == 1)
        for k, component in enumerate(self._components):
            for own, name in component.shape.items():
                source = getattr(component.model, own)
                parameters[name] = _like(source, name)
                values[name] = _value(source)
            if component.fraction:
                parameters[component.fraction] = Parameter(
                    component.fraction,
                    bounds=(0.0, 1.0),
                    description=f"Part of the flux in component {k}",
                )
                values[component.fraction] = float(fluxes[k] / total)
                for name, axis in zip(component.offsets, ("x_0", "y_0"), strict=True):
                    parameters[name] = Parameter(
                        name, fixed=True, description=f"{axis[0]} of component {k} less {axis}"
                    )
                    source, origin = getattr(component.model, axis), getattr(first, axis)
                    values[name] = _value(source) - _value(origin)
        for number, sensitivity in enumerate(self._sensitivities):
            for own, name in self._sensitivity_names(number).items():
                parameters[name] = _like(getattr(sensitivity, own), name, fixed=True)
                values[name] = _value(getattr(sensitivity, own))
        self._param_names = tuple(parameters)
        for name, parameter in parameters.items():
            parameter.model = self
            self.__dict__[name] = parameter
        super().__init__(**(values | kwargs))
        check_model_parameters(self)
        if any(getattr(c.model, "fit_deriv", None) is None for c in self._components):
            self.fit_deriv = None  # fitters then estimate the derivatives

    # -----------------------------------------------------------------------------------------
    # Construction
    # -----------------------------------------------------------------------------------------
    def _terms_of(self, terms):
        """Note the distinct sensitivities and the components of the compound."""
        self._sensitivities = []
        self._components = []
        several = len(terms) > 1
        for k, term in enumerate(terms):
            numbers = []
            for factor in term.sensitivities:
                known = [s is factor.model for s in self._sensitivities]
                if not any(known):
                    self._sensitivities.append(factor.model)
                    known.append(True)
                numbers.append(known.index(True))
            model = term.densities[0].model
            own = [name for name in model.param_names if name not in _POSITION]
            suffix = f"_{k}" if several else ""
            self._components.append(
                _Component(
                    model=model.copy(),
                    scale=float(term.scale),
                    shape={name: name + suffix for name in own},
                    fraction=f"flux_fraction_{k}" if k else None,
                    offsets=(f"x_offset_{k}", f"y_offset_{k}") if k else (),
                    sensitivities=tuple(numbers),
                )
            )
        self._sensitivities = [s.copy() for s in self._sensitivities]

    def _sensitivity_names(self, number):
        """Own parameter to parameter of the PRF, for one of the sensitivities."""
        suffix = f"_s{number}" if len(self._sensitivities) > 1 else ""
        return {name: name + suffix for name in self._sensitivities[number].param_names}

    @staticmethod
    def _overall_parameters(first, *, alone):
        descriptions = {
            "flux": "Flux of the star in all components",
            "x_0": "Column of the star (pixel)",
            "y_0": "Row of the star (pixel)",
        }
        if alone:
            return {n: _like(getattr(first, n), n, description=d) for n, d in descriptions.items()}
        return {name: Parameter(name, description=text) for name, text in descriptions.items()}

    @property
    def param_names(self):
        """Names of the parameters: flux, x_0, y_0, then those of the components."""
        return self._param_names

    # -----------------------------------------------------------------------------------------
    # Evaluation
    # -----------------------------------------------------------------------------------------
    def _fraction(self, component, values):
        if component.fraction:
            return values[component.fraction]
        return 1.0 - sum(values[c.fraction] for c in self._components if c.fraction)

    def _term(self, component, values, flux=1.0):
        """The term of one component at the given parameter values."""
        own = {name: values[source] for name, source in component.shape.items()}
        own["flux"] = flux
        for name, offset in zip(("x_0", "y_0"), component.offsets or (None, None), strict=True):
            own[name] = values[name] + values[offset] if offset else values[name]
        own = {name: np.asarray(own[name]) for name in component.model.param_names}
        sensitivities = []
        for number in component.sensitivities:
            names = self._sensitivity_names(number)
            numbers = {name: np.asarray(values[source]) for name, source in names.items()}
            sensitivities.append(Factor(self._sensitivities[number], numbers))
        return Term(densities=(Factor(component.model, own),), sensitivities=tuple(sensitivities))

    def _images(self, points, values):
        """Images of the star at the given parameter values."""
        total = None
        for component in self._components:
            flux = values["flux"] * self._fraction(component, values)
            image = integrate_term(self._term(component, values, flux), points)
            total = image if total is None else np.add(total, image, out=total)
        return total

    def evaluate(self, x, y, *parameters):
        """
        Flux in the pixels.

        Parameters
        ----------
        x, y : array_like
            Columns and rows of the pixels.
        *parameters : array_like
            The parameters, in their order; arrays broadcast with x and y.

        Returns
        -------
        flux : `~numpy.ndarray` or `~astropy.units.Quantity`
            Of the common shape.
        """
        values = dict(zip(self.param_names, parameters, strict=True))
        unit = getattr(values["flux"], "unit", None)
        x, y = _plain(x), _plain(y)
        values = {name: _plain(value) for name, value in values.items()}
        if all(np.size(value) == 1 for value in values.values()):
            values = {name: float(np.reshape(value, -1)[0]) for name, value in values.items()}
            images = self._images(PixelPoints(x, y), values)
            return images if unit is None else images * unit
        # One star per pixel, seen from that pixel.
        x, y, *arrays = np.broadcast_arrays(x, y, *values.values())
        values = {name: a.reshape(-1) for name, a in zip(values, arrays, strict=True)}
        values["x_0"], values["y_0"] = values["x_0"] - x.ravel(), values["y_0"] - y.ravel()
        for number in range(len(self._sensitivities)):
            for name in self._sensitivity_names(number).values():
                values[name] = _only(name, values[name])
        images = self._images(PixelPoints(0.0, 0.0), values).reshape(x.shape)
        return images if unit is None else images * unit

    def fit_deriv(self, x, y, *parameters):
        """
        Derivatives of the flux in the pixels with respect to the parameters.

        Parameters
        ----------
        x, y : array_like
            Columns and rows of the pixels.
        *parameters : float
            The parameters, in their order.

        Returns
        -------
        derivatives : list of `~numpy.ndarray`
            One array per parameter, in their order.
        """
        values = {
            name: float(np.reshape(_plain(value), -1)[0])
            for name, value in zip(self.param_names, parameters, strict=True)
        }
        points = PixelPoints(_plain(x), _plain(y))
        image, derivatives = unit_derivatives(self, points, values)
        names = self.param_names[1:]
        return [image, *(values["flux"] * derivatives[name] for name in names)]

    def render(self, shape, flux=None, x_0=None, y_0=None):
        """
        Draw images of a star at many positions and fluxes.

        Parameters
        ----------
        shape : tuple of int
            Shape (ny, nx) of an image.
        flux, x_0, y_0 : float or array_like, optional
            Flux, column and row at each of n cadences, shape ``(n,)``; a number serves for all
            of them. The default is the parameter's value.

        Returns
        -------
        cube : `~numpy.ndarray` or `~astropy.units.Quantity`
            Shape ``(n, ny, nx)``, or ``(ny, nx)`` if all three are numbers.

        Raises
        ------
        ValueError
            If the shapes do not agree or a value is not finite.
        """
        values = {name: _plain(_value(getattr(self, name))) for name in self.param_names}
        given = {"flux": flux, "x_0": x_0, "y_0": y_0}
        given = {k: _value(getattr(self, k)) if v is None else v for k, v in given.items()}
        flux = given["flux"] if isinstance(given["flux"], u.Quantity) else np.asarray(given["flux"])
        values |= {name: np.asarray(_plain(given[name]), dtype=float) for name in ("x_0", "y_0")}
        for name, value in {
            "flux": _plain(flux),
            "x_0": values["x_0"],
            "y_0": values["y_0"],
        }.items():
            if value.ndim > 1 or not np.all(np.isfinite(value)):
                raise ValueError(f"`{name}` must be finite, a number or of shape (n,)")
        try:
            np.broadcast_shapes(np.shape(flux), values["x_0"].shape, values["y_0"].shape)
        except ValueError as error:
            raise ValueError(
                "`flux`, `x_0` and `y_0` must have the same length, got shapes "
                f"{np.shape(flux)}, {values['x_0'].shape} and {values['y_0'].shape}"
            ) from error
        values["flux"] = _plain(flux)
        images = self._images(PixelPoints.from_shape(shape), values)
        return images * flux.unit if isinstance(flux, u.Quantity) else images

    # -----------------------------------------------------------------------------------------
    # Extent and units
    # -----------------------------------------------------------------------------------------
    def bounding_box(self):
        """
        Rectangle that holds all pixels that the components' bounding boxes reach.

        Returns
        -------
        bounding_box : tuple
            ``((y_low, y_high), (x_low, x_high))``, as astropy orders it.
        """
        values = {name: _value(getattr(self, name)) for name in self.param_names}
        boxes = []
        for component in self._components:
            model = component.model.copy()
            for name, value in self._term(component, values).densities[0].values.items():
                if name != "flux":
                    setattr(model, name, value)
            boxes.append(model.bounding_box.bounding_box())
        half = 0.5 * u.pixel if isinstance(boxes[0][0][0], u.Quantity) else 0.5
        return tuple(
            (min(b[axis][0] for b in boxes) - half, max(b[axis][1] for b in boxes) + half)
            for axis in range(2)
        )

    @property
    def input_units(self):
        """Units of x and y, or None."""
        unit = self.x_0.input_unit
        if unit is None:
            return None
        return {self.inputs[0]: unit, self.inputs[1]: self.y_0.input_unit}

    def _parameter_units_for_data_units(self, inputs_unit, outputs_unit):
        unit = inputs_unit[self.inputs[0]]
        units = {"flux": outputs_unit[self.outputs[0]], "x_0": unit, "y_0": unit}
        for component in self._components:
            convert = component.model._parameter_units_for_data_units  # noqa: SLF001
            own = convert(inputs_unit, outputs_unit)
            units |= {component.shape[n]: value for n, value in own.items() if n in component.shape}
            units |= dict.fromkeys(component.offsets, unit)
        return units


# ---------------------------------------------------------------------------------------------
# Helpers
# ---------------------------------------------------------------------------------------------
def _value(parameter):
    return parameter.value if parameter.unit is None else parameter.quantity


def _plain(value):
    """A number or array without its unit."""
    return value.value if isinstance(value, u.Quantity) else value


def _only(name, values):
    """The one value of an array that holds the same number everywhere."""
    if np.ptp(values):
        raise ValueError(f"`{name}` must be one number, got {np.unique(values).size} values")
    return values.flat[0]


def _like(source, name, *, fixed=None, description=None):
    """A parameter with the constraints of another."""
    if source.tied:
        raise ValueError(
            f"`{source.name}` is tied, which a PRF does not support: leave it out or fix it"
        )
    parameter = Parameter(
        name,
        fixed=source.fixed if fixed is None else fixed,
        bounds=source.bounds,
        description=source.__doc__ or source.name if description is None else description,
    )
    if source._validator is not None:  # noqa: SLF001
        parameter.validator(source._validator)  # noqa: SLF001
    return parameter


def _check_compound(compound, terms):
    """Raise where a compound is not a sum of densities times sensitivities."""
    if not terms:
        raise ValueError(f"no component of the compound has any flux: {compound}")
    for term in terms:
        names = " * ".join(type(factor.model).__name__ for factor in term.densities) or "nothing"
        if len(term.densities) != 1:
            raise ValueError(f"each component must be one density times sensitivities, got {names}")
        factor = term.densities[0]
        missing = [name for name in _POSITION if name not in factor.model.param_names]
        if missing:
            raise ValueError(
                f"{names} has no parameter {', '.join(f'`{m}`' for m in missing)}: "
                "a component needs flux, x_0 and y_0"
            )
        if is_pixel_integrated(factor.model):
            raise ValueError(f"{names} is already integrated over pixels; use the density instead")
        if factor.size:
            raise ValueError("parameters with more than one value are not supported in a PRF")
        if isinstance(term.scale, u.Quantity) or np.ndim(term.scale):
            raise ValueError("constants of the compound must be plain numbers")
