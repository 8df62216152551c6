"""Which densities integrate over pixels in closed form."""

from dataclasses import dataclass

import numpy as np
from astropy import units as u
from astropy.modeling.models import Gaussian2D
from scipy.special import erf

from scope_models.models._gaussian import gaussian_pixels

__all__ = [
    "FWHM", "ClosedForm", "closed_form", "collected", "diffused", "is_photutils", "pixels_of",
]  # fmt: skip

# Full width at half maximum of a normal density, in standard deviations.
FWHM = 2 * np.sqrt(2 * np.log(2))


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Integral of a density over pixels without quadrature.

    A model has one by a method ``closed_form(values)`` that returns it; so have the Gaussians of
    astropy and photutils. The functions are ``pixels(x, y, *parameters, x_coefficients,
    y_coefficients)`` with columns, rows and the polynomial response along the axes, which returns
    images ``(..., ny, nx)`` of unit flux, and the same with their derivatives by ``names`` on a new
    first axis, after the images.
    """

    flux: object  # integral over the plane
    parameters: tuple  # numbers or arrays in pixels, x_0 and y_0 first
    pixels: object
    derivatives: object = None
    names: tuple = ()  # parameters of the model


def closed_form(model, values):
    """Return the `ClosedForm` of a density at values of its parameters, or None."""
    if hasattr(model, "closed_form"):
        return model.closed_form(values)
    gaussian = _gaussian(model, values)
    return None if gaussian is None else ClosedForm(gaussian[0], gaussian[1:], gaussian_pixels)


def diffused(form, variance):
    """Return a closed form convolved with a circular Gaussian; None if it is none itself.

    Its last derivative is by the variance, square pixels, under that name.
    """
    if form.pixels is not gaussian_pixels:
        return None
    x_0, y_0, sigma_x, sigma_y, rho = form.parameters
    wide, tall = np.sqrt(sigma_x**2 + variance), np.sqrt(sigma_y**2 + variance)
    narrowed = sigma_x * sigma_y / (wide * tall)
    parameters = (x_0, y_0, wide, tall, rho * narrowed)

    def derivatives(*arguments):
        image, by_x, by_y, by_wide, by_tall, by_tilt = form.derivatives(*arguments)
        tilt = rho * narrowed
        by_sigma_x = by_wide * sigma_x / wide + by_tilt * tilt * (1 / sigma_x - sigma_x / wide**2)
        by_sigma_y = by_tall * sigma_y / tall + by_tilt * tilt * (1 / sigma_y - sigma_y / tall**2)
        by_variance = by_wide / wide + by_tall / tall - by_tilt * tilt * (1 / wide**2 + 1 / tall**2)
        parts = [image, by_x, by_y, by_sigma_x, by_sigma_y, by_tilt * narrowed, by_variance / 2]
        return np.stack(np.broadcast_arrays(*parts))

    if form.derivatives is None:
        return ClosedForm(form.flux, parameters, form.pixels)
    names = (*form.names, "variance")
    return ClosedForm(form.flux, parameters, form.pixels, derivatives, names)


def _gaussian(model, values):
    """Flux, x_0, y_0, sigma_x, sigma_y and rho of a Gaussian of astropy or photutils, or None."""
    name = type(model).__name__
    if isinstance(model, Gaussian2D):
        long, wide = pixels_of(values["x_stddev"]), pixels_of(values["y_stddev"])
        flux = values["amplitude"] * (2 * np.pi * long * wide)
        if isinstance(values["x_mean"], u.Quantity):
            flux = flux * values["x_mean"].unit ** 2
        center = pixels_of(values["x_mean"]), pixels_of(values["y_mean"])
        return flux, *center, *_from_axes(long, wide, _radians(values["theta"], u.rad))
    if is_photutils(model) and name in {"GaussianPSF", "CircularGaussianPSF"}:
        center = pixels_of(values["x_0"]), pixels_of(values["y_0"])
        if name == "CircularGaussianPSF":
            sigma = pixels_of(values["fwhm"]) / FWHM
            return values["flux"], *center, sigma, sigma, np.asarray(0.0)
        long, wide = (pixels_of(values[n]) / FWHM for n in ("x_fwhm", "y_fwhm"))
        angle = _radians(values["theta"], u.deg)
        return values["flux"], *center, *_from_axes(long, wide, angle)
    return None


def pixels_of(value):
    return value.to_value(u.pixel) if isinstance(value, u.Quantity) else value


def _radians(angle, unit):
    angle = angle if isinstance(angle, u.Quantity) else angle * unit
    return angle.to_value(u.rad)


def _from_axes(long, wide, angle):
    """Standard deviations along x and y and their correlation, from those along the axes."""
    cos, sin = np.cos(angle), np.sin(angle)
    sigma_x = np.hypot(long * cos, wide * sin)
    sigma_y = np.hypot(long * sin, wide * cos)
    return sigma_x, sigma_y, (long**2 - wide**2) * sin * cos / (sigma_x * sigma_y)


def is_photutils(model):
    return any(base.__module__.startswith("photutils.") for base in type(model).__mro__)


def collected(offset, sigma):
    """Part of the charge that a pixel collects along one axis, and its derivative by sigma.

    The charge is set free at an offset from the pixel's center and diffuses by sigma, pixels.
    """
    offset = np.asarray(offset, dtype=float)
    edges = np.stack([offset + 0.5, offset - 0.5])
    if sigma == 0:
        inside = 0.5 * (np.sign(edges[0]) - np.sign(edges[1]))
        return inside, np.zeros_like(inside)
    scaled = edges / (np.sqrt(2) * sigma)
    part = 0.5 * (erf(scaled[0]) - erf(scaled[1]))
    slope = scaled * np.exp(-(scaled**2)) / (np.sqrt(np.pi) * sigma)
    return part, slope[1] - slope[0]
