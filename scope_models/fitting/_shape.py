"""Image, widths and ellipticity of a fitted PSF, with errors to first order in its parameters."""

import numpy as np
from astropy.table import Table
from scipy.optimize import least_squares

from scope_models.models import PRF, BivariateGaussianPSF

__all__ = ["SHAPE", "psf_image", "psf_shape"]

#: Rows of `TPFFit.psf_shape`, and their units.
SHAPE = {"fwhm": "pix", "fwhm_major": "pix", "fwhm_minor": "pix", "ellipticity": "", "angle": "deg"}
# Step of a derivative in errors of the parameter, and at most.
_STEP, _LARGEST_STEP = 0.05, 1e-3
# Pixels from the center to which the contour may reach; directions and radii in which it is sought.
_REACH, _DIRECTIONS, _RADII = 8.0, 90, 801
# Part of all light that any pixel may hold besides the image of a Gaussian.
_EVERYWHERE = 0.003


def _with_slopes(fit, measure):
    """Return a measure of the PSF, and its derivatives by the free parameters, ``(s, ...)``."""
    value = measure(fit.psf)
    slopes = np.zeros((len(fit.names), *value.shape))
    for slope, name in zip(slopes, fit.names, strict=True):
        if name in fit.model.param_names and fit.errors[name] > 0:
            model, step = fit.model.copy(), min(_STEP * fit.errors[name], _LARGEST_STEP)
            setattr(model, name, fit.values[name] + step)
            slope[:] = (measure(fit.replace(model=model).psf) - value) / step
    return value, slopes


def psf_image(fit, half=3.0, samples=121):
    """Offsets of a grid about the star, the density there over its largest value, and its error."""
    offset = np.linspace(-half, half, samples)
    density, slopes = _with_slopes(fit, lambda psf: np.asarray(psf(*np.meshgrid(offset, offset))))
    variance = np.einsum("iyx,ij,jyx->yx", slopes, fit.covariance, slopes, optimize=True)
    return offset, density / density.max(), np.sqrt(np.maximum(variance, 0.0)) / density.max()


def psf_shape(fit):
    """Return the table that `TPFFit.psf_shape` describes."""
    if fit.response:
        moments, covariance = _moments_of_shares(fit)
    else:
        offset, density, _ = psf_image(fit, 2.0, 81)
        row, column = np.unravel_index(np.argmax(density), density.shape)
        center = offset[column], offset[row]
        moments, slopes = _with_slopes(fit, lambda psf: _moments(psf, *center))
        covariance = slopes.T @ fit.covariance @ slopes
    values = _axes(moments)
    # Small steps, for the axes of a circle have no direction.
    steps = np.minimum(_STEP * np.sqrt(np.diag(covariance)) + 1e-12, _LARGEST_STEP * moments[0])
    by = np.transpose([_axes(moments + step) - values for step in np.diag(steps)])
    by[-1] = (by[-1] + 90) % 180 - 90
    errors = np.sqrt(np.einsum("ai,ij,aj->a", by / steps, covariance, by / steps))
    columns = [*SHAPE], values, errors, [*SHAPE.values()]
    table = Table(columns, names=("name", "value", "error", "unit"))
    table["value"].info.format, table["error"].info.format = ".4g", ".2g"
    return table


def _moments_of_shares(fit):
    """Moments of the Gaussian that fits the typical shares, and their covariance."""
    x, y, time = (np.median(values) for values in (fit.x, fit.y, fit.time))
    shares = fit.model.unit_images(fit.shape, x, y) + fit.response[0].changes([x], [y], [time])[0]
    used = np.isfinite(fit.fitted).any(axis=0)
    # The pixels scatter about it by one part of their light, and of all light in faint ones.
    weight = used / (np.abs(shares) + _EVERYWHERE)
    gaussian = PRF(BivariateGaussianPSF())

    def residual(values):
        gaussian.parameters = values
        return (weight * (gaussian.unit_images(fit.shape) * values[0] - shares))[used]

    lower = [0.0, x - 2, y - 2, *[0.1] * 2, -0.95]
    upper = [2.0, x + 2, y + 2, *[10.0] * 2, 0.95]
    found = least_squares(residual, [1.0, x, y, 0.5, 0.5, 0.0], bounds=(lower, upper))
    sigma_x, sigma_y, rho = found.x[3:]
    # Mostly the bright pixels determine the Gaussian: their number, and how far they scatter.
    light = np.abs(shares)[used]
    number = light.sum() ** 2 / np.sum(light**2)
    variance = (light @ found.fun**2) / light.sum() * number / max(number - len(found.x), 1)
    covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)[3:, 3:]
    # Of the area above half of the largest value, of a Gaussian.
    unit = np.log(4) / 4
    by = np.diag([2 * sigma_x, 2 * sigma_y, sigma_x * sigma_y])
    by[2, :2] = rho * sigma_y, rho * sigma_x
    moments = np.array([sigma_x**2, sigma_y**2, rho * sigma_x * sigma_y])
    return unit * moments, unit**2 * by @ covariance @ by.T


def _moments(psf, x, y):
    """Second moments xx, yy and xy of the area above half of the value in the center."""
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    cos, sin = np.cos(angle), np.sin(angle)
    radii = np.linspace(0, _REACH, _RADII)
    density = np.asarray(psf(x + np.outer(radii, cos), y + np.outer(radii, sin)))
    above = density - density[0] / 2
    first = np.argmax(above < 0, axis=0)
    if not first.all():
        return np.full(3, np.nan)
    inner, outer = np.take_along_axis(above, np.stack([first - 1, first]), axis=0)
    r = radii[first] - radii[1] * outer / (outer - inner)
    area = np.mean(r**2) / 2
    mean = [np.mean(r**3 * part) / (3 * area) for part in (cos, sin)]
    squares = [np.mean(r**4 * part) / (4 * area) for part in (cos * cos, sin * sin, cos * sin)]
    return np.array(squares) - [mean[0] ** 2, mean[1] ** 2, mean[0] * mean[1]]


def _axes(moments):
    """Return the rows of the table for an ellipse with these second moments."""
    xx, yy, xy = moments
    half, turned = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    major, minor = 4 * np.sqrt(half + turned), 4 * np.sqrt(half - turned)
    angle = np.degrees(np.arctan2(2 * xy, xx - yy)) / 2
    return np.array([np.sqrt(major * minor), major, minor, 1 - minor / major, angle])
