"""Pixel response functions: flux of a star per pixel."""

from dataclasses import dataclass
from functools import reduce
from operator import add, mul

import numpy as np
from astropy import units as u
from astropy.modeling import Parameter
from astropy.modeling.models import Const2D

from scope_models._arrays import plain_array, without_unit
from scope_models.models.integration import (
    Factor,
    PixelPoints,
    Term,
    expand,
    integrate_density,
    integrate_term,
    is_pixel_integrated,
    numbers_of,
    one_number,
    value_of,
)
from scope_models.models.psf import StarModel, make_parameters
from scope_models.models.tables import PRFGrid, TabulatedPRF

__all__ = ["PRF"]

_POSITION = ("flux", "x_0", "y_0")
# Step of central differences, relative or absolute.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class _Response:
    """A sensitivity of a PRF, and the names in the PRF of its own parameters."""

    model: object
    names: dict

    @property
    def powers(self):
        """Axis and power by name in the PRF."""
        return {self.names[own]: place for own, place in self.model.powers.items()}


@dataclass(frozen=True, eq=False)
class _Component:
    """One density or table of a PRF, and the names in the PRF of its own parameters.

    ``fraction`` and ``offsets`` name the part of the flux and the position relative to the star;
    the first component has the rest.
    """

    model: object
    shape: dict
    fraction: str | None
    offsets: dict
    responses: tuple

    def own_values(self, values, flux=1.0):
        own = {name: values[source] for name, source in self.shape.items()}
        own |= {"flux": flux, "x_0": values["x_0"], "y_0": values["y_0"]}
        for name, offset in self.offsets.items():
            own[name] = own[name] + values[offset]
        return {name: np.asarray(own[name]) for name in self.model.param_names}

    def at(self, values, flux):
        """The density or table at values of the PRF's parameters."""
        model = self.model.copy()
        model.parameters = [float(value) for value in self.own_values(values, flux).values()]
        return model

    def term(self, values, flux=1.0):
        """The product that is integrated, at values of the PRF's parameters."""
        sensitivities = []
        for response in self.responses:
            own = {name: np.asarray(values[source]) for name, source in response.names.items()}
            sensitivities.append(Factor(response.model, own))
        density = Factor(self.model, self.own_values(values, flux))
        return Term(densities=(density,), sensitivities=tuple(sensitivities))

    def derivatives(self, points, values):
        """Image of unit flux ``(..., *points.shape)``, and derivatives by parameter of the PRF."""
        term, own_values = self.term(values), self.own_values(values)
        form, names = term.closed_form(), [n for n in self.model.param_names if n != "flux"]
        if form is not None and form.names:
            names = form.names  # ending in the variance of the diffusion, if there is any
            image, *parts = points.apply(form, term.polynomials(), derivatives=True)
        elif hasattr(self.model, "unit_derivatives"):
            x_0, y_0, *others = (own_values[name] for name in names)
            offsets = points.x - x_0[..., np.newaxis], points.y - y_0[..., np.newaxis]
            parts = self.model.unit_derivatives(*offsets, *map(float, others))
            image, *parts = (part.reshape((*part.shape[:-1], *points.shape)) for part in parts)
        else:
            image = integrate_term(term, points)
            parts = [self._by_quadrature(term, points, values, name) for name in names]
        own = dict(zip((self.shape.get(n, n) for n in names), parts, strict=True))
        by_variance = own.pop("variance", None)
        for response in self.responses:
            if name := response.names.get("sigma_d"):
                if not values[name]:
                    own[name] = np.zeros_like(image)
                elif by_variance is None:
                    own[name] = self._difference(points, values, name)
                else:
                    own[name] = 2 * values[name] * by_variance
            for name, (axis, _) in response.powers.items():
                # The integral is linear in it: a monomial takes the place of the polynomial.
                same = [other for other, place in response.powers.items() if place[0] == axis]
                monomial = dict.fromkeys(same, 0.0) | {name: 1.0}
                own[name] = integrate_term(self.term(values | monomial), points)
        return image, own

    def _by_quadrature(self, term, points, values, name):
        """Derivative of the image by a parameter of the density."""
        factor, number = term.densities[0], self.model.param_names.index(name)
        if self.model.fit_deriv is None or factor.size:
            return self._difference(points, values, name)
        numbers = [np.reshape(value, -1)[0] for value in factor.values.values()]

        def evaluate(x, y, _):
            parts = factor.model.fit_deriv(x.reshape(-1), y.reshape(-1), *numbers)
            return np.broadcast_to(np.asarray(parts[number]), x.size).reshape(x.shape)

        return integrate_density(term, points, evaluate)

    def _difference(self, points, values, name):
        """Central difference of the image by a parameter."""
        source = self.shape.get(name, name)
        step = _STEP * max(1.0, np.max(np.abs(values[source]))) if name in self.shape else _STEP
        changes = ({source: values[source] + size} for size in (step, -step))
        high, low = (integrate_term(self.term(values | change), points) for change in changes)
        return (high - low) / (2 * step)


class PRF(StarModel):
    r"""Flux per pixel of a star: a compound of densities and sensitivities, integrated over pixels.

    .. math:: f_{ij} = F \int_{i-1/2}^{i+1/2} \int_{j-1/2}^{j+1/2} \sum_k \phi_k\,
              p_k(x - x_0, y - y_0)\, s(x, y)\, dy\, dx, \qquad \sum_k \phi_k = 1,

    with densities :math:`p_k` of unit integral and s the product of the sensitivities. The
    integrals are those of `~scope_models.integrate_pixels`.

    Parameters
    ----------
    compound : `~astropy.modeling.Model`
        Sum of densities with the parameters ``flux``, ``x_0`` and ``y_0`` (our PSFs, photutils'
        PSFs), each multiplied by any number of `~scope_models.SensitivityPolynomial` and
        `~scope_models.models.DiffusionSensitivity`. A `~scope_models.models.TabulatedPRF` is a
        component too, but never times a sensitivity: its fluxes hold the response of the pixels.
    flux, x_0, y_0 : float or `~astropy.units.Quantity`, optional
        Overall flux and position; by default the sum of the components' fluxes and the position
        of the first component.
    **kwargs
        Values of the other parameters, and keywords of `~astropy.modeling.Model` such as
        ``fixed`` and ``bounds``.

    Raises
    ------
    TypeError, ValueError
        If the compound is not such a sum, holds tied or array-valued parameters, its fluxes do not
        add up to a positive number, or a parameter is not finite.

    Notes
    -----
    The parameters are ``flux``, ``x_0``, ``y_0`` and the components' own remaining ones. With
    several components these end in ``_0``, ``_1``, ..., and each component but the first has
    ``flux_fraction_k``, its part of the flux (the first has the rest), and ``x_offset_k``,
    ``y_offset_k``, its position relative to the first.

    Bounds and fixed parameters are taken over from the components. The coefficients of the
    sensitivity and the offsets are fixed until, for example, ``prf.ax2.fixed = False``: a single
    image hardly separates them from position, flux and width.

    References
    ----------
    Saunders, Luger & Barnes 2019, arXiv:1903.09629, equation 1.

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

    pixel_integrated = True

    def __init__(self, compound, flux=None, x_0=None, y_0=None, **kwargs):
        if isinstance(compound, PRF):
            parts = compound.psf * compound.sensitivity if compound.sensitivity else compound.psf
            compound = Const2D(float(compound.flux.value)) * parts
        terms = [term for term in expand(compound) if np.any(term.scale)]
        _check_compound(compound, terms)
        self._components, self._responses = _parts_of(terms)
        first = terms[0].densities[0].model
        fluxes = [term.scale * value_of(term.densities[0].model.flux) for term in terms]
        total = reduce(add, fluxes)
        if not np.isfinite(total) or total <= 0:
            raise ValueError(f"the components' fluxes must add up to a positive sum, got {total}")
        values = {
            "flux": total if flux is None else flux,
            "x_0": value_of(first.x_0) if x_0 is None else x_0,
            "y_0": value_of(first.y_0) if y_0 is None else y_0,
        }
        parameters = []

        def take_over(model, names, **options):
            for own, name in names.items():
                parameters.append(_like(getattr(model, own), name, **options))
                values.setdefault(name, value_of(getattr(model, own)))

        if len(terms) == 1:
            take_over(first, {name: name for name in _POSITION})
        for k, component in enumerate(self._components):
            take_over(component.model, component.shape)
            if part := component.fraction:
                text = f"Part of the flux in component {k}"
                parameters.append(Parameter(part, bounds=(0.0, 1.0), description=text))
                values[part] = float(fluxes[k] / total)
            for axis, name in component.offsets.items():
                text = f"{axis[0]} of component {k} less {axis}"
                parameters.append(Parameter(name, fixed=True, description=text))
                place, star = (value_of(getattr(m, axis)) for m in (component.model, first))
                values[name] = place - star
        for response in self._responses:
            take_over(response.model, response.names, fixed=True)
        make_parameters(self, parameters)
        super().__init__(**(values | kwargs))
        if any(getattr(c.model, "fit_deriv", None) is None for c in self._components):
            self.fit_deriv = None  # fitters then estimate the derivatives

    @property
    def n_components(self):
        """Number of densities or tables in the compound."""
        return len(self._components)

    @property
    def table(self):
        """The `~scope_models.models.TabulatedPRF` that the PRF is, or None."""
        if self.n_components > 1 or not isinstance(self._components[0].model, TabulatedPRF):
            return None
        values = self._own_or()
        return self._components[0].at(values, values["flux"])

    @classmethod
    def from_tess(cls, path, camera=None, ccd=None, column=None, row=None):
        """Read the official PRF of TESS at a place.

        Parameters
        ----------
        path : str or path-like
            A file, or a folder of files, as for `~scope_models.models.PRFGrid.from_tess`.
        camera, ccd : int, optional
            Which CCD; not needed if there is only one.
        column, row : float or `~astropy.units.Quantity`, optional
            The place in pixels of the full-frame image; not needed for a single file.

        Returns
        -------
        prf : PRF
            Of a `~scope_models.models.TabulatedPRF`.

        Raises
        ------
        FileNotFoundError, ValueError
            If there are no such files, or they do not belong together.
        """
        return cls(PRFGrid.from_tess(path, camera, ccd).at(column, row))

    @classmethod
    def from_kepler(cls, path, column=None, row=None):
        """Read the official PRF of Kepler at a place.

        Parameters
        ----------
        path : str or path-like
            The file of a channel.
        column, row : float or `~astropy.units.Quantity`
            The place in pixels of the channel.

        Returns
        -------
        prf : PRF
            Of a `~scope_models.models.TabulatedPRF`.

        Raises
        ------
        OSError, ValueError
            If the file is of another format.
        """
        return cls(PRFGrid.from_kepler(path).at(column, row))

    @property
    def psf(self):
        """The light before the pixel, of total flux 1, or the table of a PRF."""
        values = self._own_or()
        return reduce(add, (c.at(values, fraction) for c, fraction in self._parts(values)))

    @property
    def sensitivity(self):
        """The response within a pixel: a sensitivity, a product of several, or None."""
        models, numbers = [], numbers_of(self)
        for response in self._responses:
            models.append(response.model.copy())
            models[-1].parameters = [numbers[name] for name in response.names.values()]
        return reduce(mul, models) if models else None

    @property
    def parameter_kinds(self):
        """Kinds of the parameters in a fit, where they have one (dict of str).

        "width", "correlation", "coefficient" and "fraction" are shape, "offset" is a position
        relative to the star, "response" and "diffusion" belong to sensitivities, and "correction"
        to a factor of a table.
        """
        kinds = {}
        for component in self._components:
            own = getattr(component.model, "parameter_kinds", {})
            kinds |= {source: own[name] for name, source in component.shape.items() if name in own}
            kinds |= dict.fromkeys(component.offsets.values(), "offset")
            kinds |= {component.fraction: "fraction"} if component.fraction else {}
        for response in self._responses:
            kind = "diffusion" if "sigma_d" in response.names else "response"
            kinds |= dict.fromkeys(response.names.values(), kind)
        return kinds

    @property
    def response_powers(self):
        """Axis ("x" or "y") and power of each coefficient of the sensitivities, by name (dict)."""
        return {name: p for response in self._responses for name, p in response.powers.items()}

    def _own_or(self, values=None):
        """Value of each parameter, with others in their place."""
        own = numbers_of(self)
        unknown = set(values or {}) - set(own)
        if unknown:
            raise ValueError(f"`values` has no parameter {', '.join(sorted(unknown))}")
        return own | {name: float(value) for name, value in (values or {}).items()}

    def _parts(self, values):
        """The components, each with its part of the flux."""
        others = [values[c.fraction] for c in self._components if c.fraction]
        return zip(self._components, [1.0 - sum(others), *others], strict=True)

    def _images(self, points, values):
        total = None
        for component, fraction in self._parts(values):
            image = integrate_term(component.term(values, values["flux"] * fraction), points)
            total = image if total is None else np.add(total, image, out=total)
        return total

    def evaluate(self, x, y, *parameters):
        """Flux in pixels, with whose columns and rows arrays of parameters broadcast."""
        values = dict(zip(self.param_names, parameters, strict=True))
        unit = getattr(values["flux"], "unit", None)
        x, y = plain_array(x, u.pixel, "x"), plain_array(y, u.pixel, "y")
        values = {name: without_unit(value) for name, value in values.items()}
        if all(np.size(value) == 1 for value in values.values()):
            values = {name: float(np.reshape(value, -1)[0]) for name, value in values.items()}
            images = self._images(PixelPoints(x, y), values)
        else:  # one star per pixel, seen from that pixel
            x, y, *arrays = np.broadcast_arrays(x, y, *values.values())
            values = {name: a.reshape(-1) for name, a in zip(values, arrays, strict=True)}
            values["x_0"], values["y_0"] = values["x_0"] - x.ravel(), values["y_0"] - y.ravel()
            for response in self._responses:
                values |= {n: one_number(n, values[n]) for n in response.names.values()}
            images = self._images(PixelPoints(0.0, 0.0), values).reshape(x.shape)
        return images if unit is None else images * unit

    def fit_deriv(self, x, y, *parameters):
        """Derivatives of the flux in the pixels with respect to the parameters, in their order."""
        numbers = (float(np.reshape(without_unit(value), -1)[0]) for value in parameters)
        values = dict(zip(self.param_names, numbers, strict=True))
        image, derivatives = self._unit_derivatives(PixelPoints(x, y), values)
        return [image, *(values["flux"] * derivatives[name] for name in self.param_names[1:])]

    def _unit_derivatives(self, points, values):
        """Images of unit flux, and their derivatives by parameter but the flux."""
        total, derivatives, first = 0.0, {}, None
        for component, fraction in self._parts(values):
            image, own = component.derivatives(points, values)
            first = image if first is None else first
            total = total + fraction * image
            for name, derivative in own.items():
                part = fraction * derivative
                if name in component.offsets:
                    derivatives[component.offsets[name]] = part
                derivatives[name] = derivatives[name] + part if name in derivatives else part
            if component.fraction:
                derivatives[component.fraction] = image - first
        return total, derivatives

    def unit_images(self, shape, x_0=None, y_0=None, *, values=None, derivatives=False):
        """Draw images of a star of unit flux.

        Parameters
        ----------
        shape : tuple of int
            Shape (ny, nx) of an image.
        x_0, y_0 : float or array_like, optional
            Column and row in pixels, numbers or ``(n,)``; by default the model's.
        values : dict, optional
            Numbers in place of the model's parameters, by name.
        derivatives : bool, optional
            Whether to return the derivatives too.

        Returns
        -------
        images : `~numpy.ndarray`
            Shape ``(n, ny, nx)`` or ``(ny, nx)``.
        derivatives : dict of str to `~numpy.ndarray`
            By parameter but the flux, of the same shape; only with ``derivatives=True``.

        Raises
        ------
        TypeError, ValueError
            If the shape or a name is wrong.

        Examples
        --------
        >>> from scope_models import PRF, BivariateGaussianPSF
        >>> prf = PRF(BivariateGaussianPSF())
        >>> images, derivatives = prf.unit_images((5, 5), [2, 2.1], 2, derivatives=True)
        >>> images.shape, sorted(derivatives)
        ((2, 5, 5), ['rho', 'sigma_x', 'sigma_y', 'x_0', 'y_0'])
        """
        numbers = self._own_or(values)
        for name, value in (("x_0", x_0), ("y_0", y_0)):
            if value is not None:
                numbers[name] = plain_array(value, u.pixel, name)
        points = PixelPoints.from_shape(shape)
        if derivatives:
            return self._unit_derivatives(points, numbers)
        return self._images(points, numbers | {"flux": 1.0})

    def render(self, shape=None, flux=None, x_0=None, y_0=None, *, out=None, coords=None):
        """Draw images of a star at many positions and fluxes.

        Parameters
        ----------
        shape : tuple of int
            Shape (ny, nx) of an image.
        flux, x_0, y_0 : float or array_like, optional
            Flux, column and row at n cadences, ``(n,)`` or numbers; by default the model's.
        out, coords : `~numpy.ndarray`, optional
            As for `astropy.modeling.Model.render`, as are calls without a shape or with an image.

        Returns
        -------
        cube : `~numpy.ndarray` or `~astropy.units.Quantity`
            Shape ``(n, ny, nx)``, or ``(ny, nx)`` if all three are numbers.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, the shapes do not agree or a value is not finite.
        """
        if shape is None or np.ndim(shape) > 1 or out is not None or coords is not None:
            return super().render(shape if out is None else out, flux if coords is None else coords)
        flux = value_of(self.flux) if flux is None else flux
        unit, own = getattr(flux, "unit", None), numbers_of(self)
        for name, value in zip(_POSITION, (flux, x_0, y_0), strict=True):
            if value is not None:
                own[name] = plain_array(value, None if name == "flux" else u.pixel, name)
            if np.ndim(own[name]) > 1 or not np.all(np.isfinite(own[name])):
                raise ValueError(f"`{name}` must be finite, a number or of shape (n,)")
        shapes = [np.shape(own[name]) for name in _POSITION]
        try:
            np.broadcast_shapes(*shapes)
        except ValueError as error:
            message = f"`flux`, `x_0` and `y_0` must have the same length, got shapes {shapes}"
            raise ValueError(message) from error
        images = self._images(PixelPoints.from_shape(shape), own)
        return images if unit is None else images * unit

    def bounding_box(self):
        """Rectangle ``((y_low, y_high), (x_low, x_high))`` of the star's pixels."""
        values = self._own_or()
        boxes = [c.at(values, 1.0).bounding_box.bounding_box() for c in self._components]
        half = 0.5 * u.pixel if isinstance(boxes[0][0][0], u.Quantity) else 0.5
        return tuple(
            (min(b[axis][0] for b in boxes) - half, max(b[axis][1] for b in boxes) + half)
            for axis in range(2)
        )

    def _check_units(self):
        for name in ("x_0", "y_0"):  # the components have checked theirs
            plain_array(value_of(getattr(self, name)), u.pixel, name)

    def _parameter_units_for_data_units(self, inputs_unit, outputs_unit):
        units = super()._parameter_units_for_data_units(inputs_unit, outputs_unit)
        data = {name: 1 * unit for name, unit in {**inputs_unit, **outputs_unit}.items()}
        for component in self._components:
            own = component.model.with_units_from_data(**data)
            found = {name: getattr(own, source).unit for source, name in component.shape.items()}
            units |= {name: unit for name, unit in found.items() if unit is not None}
        return units


def _like(source, name, *, fixed=None):
    """A parameter with the constraints of another."""
    if source.tied:
        raise ValueError(f"`{source.name}` is tied, which a PRF does not support")
    fixed, text = source.fixed if fixed is None else fixed, source.__doc__ or source.name
    parameter = Parameter(name, fixed=fixed, bounds=source.bounds, description=text)
    validator = source._validator  # noqa: SLF001 - astropy gives it out by no other way
    return parameter if validator is None else parameter.validator(validator)


def _parts_of(terms):
    """The components and the sensitivities of a compound."""
    factors = [factor for term in terms for factor in term.sensitivities]
    models = list({id(factor.model): factor.model for factor in factors}.values())
    responses = {}
    for number, model in enumerate(models):
        suffix = f"_s{number}" if len(models) > 1 else ""
        names = {name: name + suffix for name in model.param_names}
        responses[id(model)] = _Response(model.copy(), names)
    components = []
    for k, term in enumerate(terms):
        model = term.densities[0].model
        suffix = f"_{k}" if len(terms) > 1 else ""
        shape = {name: name + suffix for name in model.param_names if name not in _POSITION}
        fraction = f"flux_fraction_{k}" if k else None
        offsets = {"x_0": f"x_offset_{k}", "y_0": f"y_offset_{k}"} if k else {}
        own = tuple(responses[id(factor.model)] for factor in term.sensitivities)
        components.append(_Component(model.copy(), shape, fraction, offsets, own))
    return components, list(responses.values())


def _check_compound(compound, terms):
    """Raise unless a compound is a sum of densities times sensitivities."""
    if not terms:
        raise ValueError(f"no component of the compound has any flux: {compound}")
    for term in terms:
        names = " * ".join(type(factor.model).__name__ for factor in term.densities) or "nothing"
        if len(term.densities) != 1:
            raise ValueError(f"each component must be one density times sensitivities, got {names}")
        factor = term.densities[0]
        missing = [name for name in _POSITION if name not in factor.model.param_names]
        if missing:
            lacks = f"no parameter {', '.join(f'`{name}`' for name in missing)}"
            raise ValueError(f"{names} has {lacks}: a component needs flux, x_0 and y_0")
        if is_pixel_integrated(factor.model):
            known = f"{names} is already integrated over pixels"
            if not hasattr(factor.model, "unit_derivatives"):
                wanted = "use the density instead, or read a table with TabulatedPRF.from_photutils"
                raise ValueError(f"{known}; {wanted}")
            if term.sensitivities:
                raise ValueError(
                    f"{known}, with the response of the real pixels in it. Multiplied by a "
                    "sensitivity the response would be counted twice, and outside the integral. "
                    "Leave the sensitivity out, or use the density of a TabulatedPSF"
                )
        if factor.size:
            raise ValueError("parameters with more than one value are not supported in a PRF")
        if isinstance(term.scale, u.Quantity) or np.ndim(term.scale):
            raise ValueError("constants of the compound must be plain numbers")
