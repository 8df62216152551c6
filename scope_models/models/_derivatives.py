# Licensed under a 3-clause BSD style license - see LICENSE
"""What a joint fit needs of a PRF: derivatives at many positions, and its parts as models."""

import numpy as np

from scope_models.models._gaussian import gaussian_derivatives
from scope_models.models._terms import Term
from scope_models.models.integration import integrate_density, integrate_term, split_values
from scope_models.models.psf import BivariateGaussianPSF

__all__ = ["coefficient_names", "prf_psf", "prf_sensitivity", "unit_derivatives"]

# Step of central differences for densities without a closed form, relative or absolute.
_STEP = 1e-4


def unit_derivatives(prf, points, values):
    """
    Images of a star of unit flux, and their derivatives.

    Parameters
    ----------
    prf : `~scope_models.PRF`
        The model.
    points : `~scope_models.models.integration.PixelPoints`
        The pixels.
    values : dict
        Value of each parameter; x_0 and y_0 may have shape ``(n,)``, the others are numbers.

    Returns
    -------
    image : `~numpy.ndarray`
        Shape ``(..., *points.shape)``.
    derivatives : dict of str to `~numpy.ndarray`
        By parameter, without the flux.
    """
    # The functions of this package's models work hand in hand.
    total, derivatives, images = 0.0, {}, []
    for component in prf._components:  # noqa: SLF001
        image, own = _component(prf, component, points, values)
        weight = prf._fraction(component, values)  # noqa: SLF001
        images.append(image)
        total = total + weight * image
        for name, derivative in own.items():
            part = weight * derivative
            if component.offsets and name in {"x_0", "y_0"}:
                derivatives[component.offsets[name == "y_0"]] = part
            derivatives[name] = derivatives[name] + part if name in derivatives else part
    for component, image in zip(prf._components, images, strict=True):  # noqa: SLF001
        if component.fraction:
            derivatives[component.fraction] = image - images[0]
    return total, derivatives


def _component(prf, component, points, values):
    """Image of unit flux of a component, and its derivatives by parameter of the PRF."""
    term = prf._term(component, values)  # noqa: SLF001
    along, factor = term.polynomials(), term.densities[0]
    if isinstance(component.model, BivariateGaussianPSF):
        _, *parameters = factor.gaussian()
        names = ("x_0", "y_0", "sigma_x", "sigma_y", "rho")
        image, *parts = points.gaussian(gaussian_derivatives, parameters, along)
    elif hasattr(component.model, "pixel_engine"):
        _, *parameters, coefficients = split_values(factor)
        names = component.model.param_names[1:]
        engine = component.model.pixel_engine(coefficients, derivatives=True)
        image, *parts = points.closed_form(engine, *parameters, *along)
    else:
        names = tuple(name for name in component.model.param_names if name != "flux")
        image = integrate_term(term, points)
        parts = [_by_quadrature(prf, component, points, values, name) for name in names]
    own = dict(zip((component.shape.get(n, n) for n in names), parts, strict=True))
    for number in component.sensitivities:
        for name, source in prf._sensitivity_names(number).items():  # noqa: SLF001
            # The integral is linear in it: a monomial takes the place of the polynomial.
            monomial = dict.fromkeys(_same_axis(prf, number, name), 0.0) | {source: 1.0}
            term = prf._term(component, values | monomial)  # noqa: SLF001
            own[source] = integrate_term(Term(1.0, term.densities, term.sensitivities), points)
    return image, own


def _same_axis(prf, number, name):
    """Parameters of the PRF that are coefficients along the same axis."""
    names = prf._sensitivity_names(number)  # noqa: SLF001
    return [source for own, source in names.items() if own[1] == name[1]]


def _by_quadrature(prf, component, points, values, name):
    """Derivative of a component's image by one of its own parameters, by quadrature."""
    term = prf._term(component, values)  # noqa: SLF001
    factor, number = term.densities[0], component.model.param_names.index(name)
    if component.model.fit_deriv is None or factor.size:
        return _difference(prf, component, points, values, name)
    numbers = [np.reshape(value, -1)[0] for value in factor.values.values()]

    def evaluate(x, y, _):
        parts = factor.model.fit_deriv(x.reshape(-1), y.reshape(-1), *numbers)
        return np.broadcast_to(np.asarray(parts[number]), x.size).reshape(x.shape)

    return integrate_density(term, points, evaluate)


def _difference(prf, component, points, values, name):
    """Central difference of a component's image by one of its own parameters."""
    source = component.shape.get(name, name)
    step = _STEP * max(1.0, float(np.max(np.abs(values[source]))) if name in component.shape else 1)
    images = []
    for sign in (1, -1):
        term = prf._term(component, values | {source: values[source] + sign * step})  # noqa: SLF001
        images.append(integrate_term(term, points))
    return (images[0] - images[1]) / (2 * step)


def coefficient_names(prf):
    """
    Parameters of a PRF that are coefficients of its sensitivities.

    Parameters
    ----------
    prf : `~scope_models.PRF`
        The model.

    Returns
    -------
    names : dict of str to tuple
        Name to axis ("x" or "y") and power.
    """
    names = {}
    for number in range(len(prf._sensitivities)):  # noqa: SLF001
        for own, source in prf._sensitivity_names(number).items():  # noqa: SLF001
            names[source] = own[1], int(own[2:])
    return names


def prf_psf(prf, **position):
    """
    The PSF in a PRF: a sum of densities of total flux 1.

    Parameters
    ----------
    prf : `~scope_models.PRF`
        The model.
    **position
        x_0 and y_0, if they are to be others than those of the model.

    Returns
    -------
    psf : `~astropy.modeling.Model`
        A density or a sum of densities.
    """
    values = {name: float(np.ravel(getattr(prf, name).value)[0]) for name in prf.param_names}
    values |= position
    total = None
    for component in prf._components:  # noqa: SLF001
        model = component.model.copy()
        own = prf._term(component, values).densities[0].values  # noqa: SLF001
        own["flux"] = prf._fraction(component, values)  # noqa: SLF001
        for name, value in own.items():
            setattr(model, name, float(value))
        total = model if total is None else total + model
    return total


def prf_sensitivity(prf):
    """
    The sensitivity in a PRF.

    Parameters
    ----------
    prf : `~scope_models.PRF`
        The model.

    Returns
    -------
    sensitivity : `~astropy.modeling.Model` or None
        A sensitivity, or a product of several.
    """
    total = None
    for number, sensitivity in enumerate(prf._sensitivities):  # noqa: SLF001
        model = sensitivity.copy()
        for own, source in prf._sensitivity_names(number).items():  # noqa: SLF001
            setattr(model, own, float(getattr(prf, source).value))
        total = model if total is None else total * model
    return total
