"""What the data cannot tell: held by a convention, or told in a warning."""

import warnings

import numpy as np

from scope_models.exceptions import FitWarning
from scope_models.models._derivatives import coefficient_names

__all__ = ["interpixel_gauge", "warn_of_fit"]

# The paper's sensitivity is lower by this at the edge of a pixel than at its centre: a coefficient
# whose error there is larger has not been measured.
_LARGEST_EDGE_ERROR = 0.0125
# Scatter of the response between pixels, in standard deviations of its prior, that is no response.
_LARGEST_SCATTER = 3.0
# Reduced chi-squared from which a model does not describe the pixels.
_LARGEST_CHI2 = 100.0


def interpixel_gauge(data):
    """
    Weights of the pixels whose mean response is 1: their parts of the light.

    Parameters
    ----------
    data : PixelData
        The pixels.

    Returns
    -------
    weights : ndarray of shape (p,)
        Of the fitted pixels; not negative, with the sum 1.
    """
    flux = np.nanmedian(data.flux[:, data.pixels], axis=0)
    weights = np.maximum(flux, 0.0)
    return weights / weights.sum()


def warn_of_fit(fit, stacklevel):
    """
    Tell what is doubtful about a fit.

    Parameters
    ----------
    fit : TPFFit
        The fit.
    stacklevel : int
        Whose line the warning names.
    """
    messages = []
    if not fit.converged:
        messages.append(
            f"the fit has not converged after {fit.n_steps} steps: chi-squared {fit.chi2:.6g}, "
            f"{fit.reduced_chi2:.4g} per degree of freedom; the best parameters are kept"
        )
    spread = {"x": np.std(fit.x), "y": np.std(fit.y)}
    for name, (axis, power) in coefficient_names(fit.model).items():
        if name not in fit.names:
            continue
        error = fit.errors[name] * 0.5**power
        if error == 0:
            messages.append(
                f"the sensitivity is at its bound, {name} = {fit.values[name]:.3g}: it describes "
                "errors of the PSF, and is not measured"
            )
        if not error < _LARGEST_EDGE_ERROR:
            messages.append(
                f"the motion ({spread[axis]:.2g} px rms along {axis}) does not constrain the "
                f"sensitivity: {name} = {fit.values[name]:.3g} +- {fit.errors[name]:.2g}"
            )
    prior, scatter = fit.options["interpixel"], np.std(fit.interpixel - 1)
    if prior and scatter > _LARGEST_SCATTER * prior:
        messages.append(
            f"the response between pixels scatters by {100 * scatter:.2g} % where the prior is "
            f"{100 * prior:.2g} %: it describes errors of the PSF; interpixel=0 leaves it out"
        )
    if fit.reduced_chi2 > _LARGEST_CHI2:
        row, column = np.unravel_index(np.nanargmax(fit.chi2_pixels), fit.chi2_pixels.shape)
        messages.append(
            f"the model does not describe the pixels: chi-squared per degree of freedom is "
            f"{fit.reduced_chi2:.4g}, and largest in column {column}, row {row}"
        )
    ny, nx = fit.shape
    x, y = np.median(fit.x), np.median(fit.y)
    if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1):
        messages.append(f"the star is at the edge of the pixels: x = {x:.2f}, y = {y:.2f}")
    for message in messages:
        warnings.warn(message, FitWarning, stacklevel=stacklevel)
