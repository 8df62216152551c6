"""Figures of many stars: their noise, and one star of them."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models.plotting._style import DARK, GRAY, LIGHT, label_pixels, scale_to, styled

__all__ = ["plot_precision", "plot_star"]

_STATES, _CENTROIDS = ("pos_fit1", "pos_fit2", "width"), ("mom_centr1", "mom_centr2")


@styled
def plot_precision(stars, published=None):
    """
    Draw the noise of stars before and after a correction over their magnitude.

    Parameters
    ----------
    stars : mapping of str to array_like
        Per star, ``(n,)`` each: "mag", "raw_cdpp" and "cdpp" (ppm). NaN is not drawn.
    published : mapping of str to array_like, optional
        "mag", and medians of other light curves at these magnitudes by their names, drawn as lines.

    Returns
    -------
    `~matplotlib.figure.Figure`
        The figure.

    Examples
    --------
    >>> from scope_models.plotting.noise import plot_precision
    >>> stars = {"mag": [12.0, 14.0], "raw_cdpp": [200, 300], "cdpp": [25, 60]}
    >>> plot_precision(stars).axes[0].get_xlabel()
    'Magnitude'
    """
    figure, ax = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
    mag = np.asarray(stars["mag"], dtype=float)
    ax.plot(mag, stars["raw_cdpp"], "s", ms=4, color=GRAY, label="before")
    ax.plot(mag, stars["cdpp"], "o", ms=4, color=DARK, label="corrected")
    medians = dict(published or {})
    center = medians.pop("mag", None)
    for (name, values), style in zip(medians.items(), ("-", "--", "-.", ":"), strict=False):
        ax.plot(center, values, style, color=LIGHT, label=name)
    ax.set(yscale="log", xlabel="Magnitude", ylabel="6.5-h CDPP (ppm)")
    ax.legend(fontsize="small")
    return figure


@styled
def plot_star(light_curve, image=None, aperture=None):
    """
    Draw a star of many: pixels, light curve before and after the correction, and motion.

    Parameters
    ----------
    light_curve : mapping of str to array_like
        "time", "raw_flux" and "flux", and what there is of "pos_fit1", "pos_fit2" and "width", or
        else "mom_centr1" and "mom_centr2"; ``(n,)`` each.
    image : array_like, optional
        Image of the star, ``(ny, nx)``.
    aperture : array_like of bool, optional
        The pixels that are summed, ``(ny, nx)``.

    Returns
    -------
    `~matplotlib.figure.Figure`
        The figure.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting.noise import plot_star
    >>> curve = {name: np.arange(5.0) for name in ("time", "raw_flux", "flux", "mom_centr1")}
    >>> len(plot_star(curve, image=np.eye(5)).axes)
    3
    """
    curve = {name: np.asarray(values, dtype=float) for name, values in light_curve.items()}
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(11, 2.6), width_ratios=(1, 2.6, 2.6), layout="constrained"
    )
    if image is not None:
        left.imshow(np.arcsinh(image / np.nanmax(image) * 50), origin="lower", cmap="magma")
    if aperture is not None:
        ny, nx = np.shape(aperture)
        fine = np.kron(aperture, np.ones((8, 8)))  # so that the outline follows the pixels
        extent = (-0.5, nx - 0.5, -0.5, ny - 0.5)
        left.contour(fine, levels=[0.5], extent=extent, colors="white", linewidths=0.8)
    label_pixels(left, "")
    for name, color in (("raw_flux", GRAY), ("flux", DARK)):
        middle.plot(curve["time"], curve[name] / np.nanmedian(curve[name]), ".", ms=2, color=color)
    scale_to(middle, *(curve[name] / np.nanmedian(curve[name]) for name in ("raw_flux", "flux")))
    middle.set(xlabel="Time (d)", ylabel="Flux, raw (gray) and corrected")
    middle.ticklabel_format(axis="y", useOffset=False)
    states = [name for name in _STATES if np.isfinite(curve.get(name, np.nan)).any()]
    states = states or [name for name in _CENTROIDS if name in curve]
    for name, color in zip(states, (DARK, LIGHT, GRAY), strict=False):
        values = curve[name] - np.nanmedian(curve[name])
        right.plot(curve["time"], values, ".", ms=2, color=color, label=name.upper())
    scale_to(right, *(curve[name] - np.nanmedian(curve[name]) for name in states))
    right.set(xlabel="Time (d)", ylabel="About the median")
    right.legend(fontsize="x-small", markerscale=3)
    return figure
