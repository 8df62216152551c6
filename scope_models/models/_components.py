"""The components of a PRF: densities or tables with their responses, and their derivatives."""

from dataclasses import dataclass

import numpy as np

from scope_models.models._terms import Factor, Term
from scope_models.models.integration import integrate_density, integrate_term

__all__ = ["Component", "Response"]

# Step of central differences for densities without a closed form, relative or absolute.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Response:
    """A sensitivity in a PRF; ``names`` leads from its own parameters to those of the PRF."""

    model: object
    names: dict

    def factor(self, values):
        """The sensitivity at values of the PRF's parameters."""
        own = {name: np.asarray(values[source]) for name, source in self.names.items()}
        return Factor(self.model, own)

    @property
    def powers(self):
        """Axis and power by parameter of the PRF."""
        return {self.names[own]: place for own, place in self.model.powers.items()}

    @property
    def diffusion(self):
        """Parameters of the PRF that are widths of a diffusion (list of str)."""
        return [source for own, source in self.names.items() if own == "sigma_d"]


@dataclass(frozen=True, eq=False)
class Component:
    """
    One density or table of a PRF, and which parameter of the PRF feeds which of its own.

    Parameters
    ----------
    model : `~astropy.modeling.Model`
        The density.
    shape : dict of str
        Its own parameters to those of the PRF, without flux, x_0 and y_0.
    fraction : str or None
        Parameter that holds its part of the flux; None for the first component, with the rest.
    offsets : tuple of str
        Parameters that hold its position relative to the star, or ().
    responses : tuple of Response
        The sensitivities that multiply it.
    """

    model: object
    shape: dict
    fraction: str | None
    offsets: tuple
    responses: tuple

    @property
    def kinds(self):
        """Kinds of its parameters in a fit, by parameter of the PRF."""
        own = getattr(self.model, "parameter_kinds", {})
        kinds = {source: own[name] for name, source in self.shape.items() if name in own}
        kinds |= dict.fromkeys(self.offsets, "offset")
        return kinds | ({self.fraction: "fraction"} if self.fraction else {})

    def own_values(self, values, flux=1.0):
        """The density's parameters at values of the PRF's."""
        own = {name: values[source] for name, source in self.shape.items()}
        own["flux"] = flux
        for name, offset in zip(("x_0", "y_0"), self.offsets or (None, None), strict=True):
            own[name] = values[name] + values[offset] if offset else values[name]
        return {name: np.asarray(own[name]) for name in self.model.param_names}

    def term(self, values, flux=1.0):
        """The product that is integrated, at values of the PRF's parameters."""
        density = Factor(self.model, self.own_values(values, flux))
        return Term(
            densities=(density,), sensitivities=tuple(r.factor(values) for r in self.responses)
        )

    def derivatives(self, points, values):
        """Image of unit flux ``(..., *points.shape)``, and derivatives by parameter of the PRF."""
        term = self.term(values)
        along, form = term.polynomials(), term.closed_form()
        if form is not None and form.derivatives is not None:
            names = form.names  # ending in the variance of the diffusion, if there is any
            image, *parts = points.apply(form.derivatives, form.parameters, along)
        elif hasattr(self.model, "unit_derivatives"):
            names = self.model.param_names[1:]
            image, *parts = self._of_table(points, values)
        else:
            names = tuple(name for name in self.model.param_names if name != "flux")
            image = integrate_term(term, points)
            parts = [self._by_quadrature(term, points, values, name) for name in names]
        own = dict(zip((self.shape.get(n, n) for n in names), parts, strict=True))
        by_variance = own.pop("variance", None)
        for response in self.responses:
            for name in response.diffusion:
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

    def _of_table(self, points, values):
        """Image of a table and its derivatives by all but its flux."""
        own = self.own_values(values)
        x, y = (own[name][..., np.newaxis] for name in ("x_0", "y_0"))
        shape = [float(own[name]) for name in self.model.param_names[3:]]
        parts = self.model.unit_derivatives(points.x - x, points.y - y, *shape)
        return [part.reshape((*part.shape[:-1], *points.shape)) for part in parts]

    def _by_quadrature(self, term, points, values, name):
        """Derivative of the image by one of the density's parameters, by quadrature."""
        factor, number = term.densities[0], self.model.param_names.index(name)
        if self.model.fit_deriv is None or factor.size:
            return self._difference(points, values, name)
        numbers = [np.reshape(value, -1)[0] for value in factor.values.values()]

        def evaluate(x, y, _):
            parts = factor.model.fit_deriv(x.reshape(-1), y.reshape(-1), *numbers)
            return np.broadcast_to(np.asarray(parts[number]), x.size).reshape(x.shape)

        return integrate_density(term, points, evaluate)

    def _difference(self, points, values, name):
        """Central difference of the image by one of the density's parameters."""
        source = self.shape.get(name, name)
        size = float(np.max(np.abs(values[source]))) if name in self.shape else 1.0
        step = _STEP * max(1.0, size)
        high, low = (
            integrate_term(self.term(values | {source: values[source] + sign * step}), points)
            for sign in (1, -1)
        )
        return (high - low) / (2 * step)
