"""Figures of corrections: removed systematics, remaining light curve, pixels, and noise."""

from types import SimpleNamespace

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

from scope_models._arrays import plain_array
from scope_models.photometry import noise_of
from scope_models.plotting import _style
from scope_models.plotting._style import DARK, GRAY, LIGHT, styled
from scope_models.plotting.images import draw_outline

__all__ = [
    "plot_comparison", "plot_detrending", "plot_detrending_masks", "plot_precision", "plot_states",
]  # fmt: skip

_LEGEND = {"fontsize": "small", "ncols": 3, "markerscale": 2}


@styled(time=u.day)
def plot_comparison(time, fluxes, *, time_label="Time (d)"):
    """Draw light curves below each other on one scale.

    Parameters
    ----------
    time : array_like
        Days, ``(n_cadences,)``.
    fluxes : dict of str to array_like
        Flux by name; each is divided by its median.
    {time_label}

    Returns
    -------
    `~numpy.ndarray` of `~matplotlib.axes.Axes`
        One panel per light curve.

    Examples
    --------
    >>> from scope_models.plotting.detrending import plot_comparison
    >>> len(plot_comparison([0, 1, 2], {"raw": [99, 100, 103], "pld": [100, 101, 100]}))
    2
    """
    n, shown, shared = len(fluxes), [], {"sharex": True, "sharey": True, "squeeze": False}
    axes = plt.subplots(n, figsize=(9, 1 + 1.8 * n), layout="constrained", **shared)[1][:, 0]
    for ax, (name, flux) in zip(axes, fluxes.items(), strict=True):
        values = plain_array(flux, None, "fluxes")
        relative = values / np.nanmedian(values)
        ax.plot(time, relative, ".", ms=2, color=DARK, label=_label(name, time, values))
        _style.legend_above(ax, **_LEGEND)
        ax.set_ylabel("Relative flux")
        shown.append(relative)
    _style.scale_to(axes[0], *shown)
    axes[-1].set_xlabel(time_label)
    return axes


@styled(time=u.day, flux=None, corrected=None)
def plot_detrending(
    time, flux, corrected, *, systematics=None, trend=None, outliers=None, masked=None,
    time_label="Time (d)",
):  # fmt: skip
    """Draw a light curve before and after correction, and the model.

    Parameters
    ----------
    time, flux, corrected : array_like
        Times in days and fluxes before and after in e-/s, ``(n_cadences,)``.
    systematics, trend : array_like, optional
        The two parts of the model in the unit of the flux.
    outliers, masked : array_like of bool, optional
        Cadences that the fit left out, as outliers or by a mask.
    {time_label}

    Returns
    -------
    `~numpy.ndarray` of `~matplotlib.axes.Axes`
        Three panels: before, model, after.

    Examples
    --------
    >>> from scope_models.plotting.detrending import plot_detrending
    >>> len(plot_detrending([0, 1, 2], [99, 100, 103], [100, 101, 100]))
    3
    """
    _, axes = plt.subplots(3, 1, figsize=(9, 7), sharex=True, layout="constrained")
    for ax, values, color, label in (
        (axes[0], flux, GRAY, _label("measured", time, flux)),
        (axes[1], systematics, DARK, "systematics"),
        (axes[1], trend, LIGHT, "trend"),
        (axes[2], corrected, DARK, _label("corrected", time, corrected)),
    ):
        if values is not None:
            ax.plot(time, values, ".", ms=2, color=color, label=label)
    for mask, marker, name in ((outliers, "x", "outliers"), (masked, "+", "not in the fit")):
        if mask is not None and np.any(mask):
            axes[2].plot(time[mask], corrected[mask], marker, ms=5, color=LIGHT, label=name)
    names = ("Measured flux (e-/s)", "Model (e-/s)", "Corrected flux (e-/s)")
    shown = (flux, flux if systematics is None else systematics, corrected)
    for ax, name, values in zip(axes, names, shown, strict=True):
        _style.scale_to(ax, values)
        _style.mark_outside(ax, time, values)
        ax.set_ylabel(name)
        ax.ticklabel_format(useOffset=False)
        if ax.get_legend_handles_labels()[0]:
            _style.legend_above(ax, **_LEGEND)
    axes[2].set_xlabel(time_label)
    return axes


def _label(name, time, flux):
    """Add the noise in lightkurve's convention, where there are enough cadences."""
    noise = noise_of(SimpleNamespace(time=time, flux=flux))
    return name if np.isnan(noise) else f"{name}, CDPP {noise:.0f} ppm (lightkurve)"


@styled(image=u.electron / u.s, scatter=u.one)
def plot_detrending_masks(image, aperture, scatter):
    """Draw an aperture over the star and over the pixels' share in the systematics.

    Parameters
    ----------
    image : array_like
        Typical image in e-/s, ``(ny, nx)``.
    aperture : array_like of bool
        Pixels that are summed.
    scatter : array_like
        Standard deviation of each pixel's fraction of the light.

    Returns
    -------
    `~numpy.ndarray` of `~matplotlib.axes.Axes`
        Two panels.

    Examples
    --------
    >>> from scope_models.plotting.detrending import plot_detrending_masks
    >>> len(plot_detrending_masks([[1, 9]], [[False, True]], [[0, 0.1]]))
    2
    """
    _, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    titles = ("Flux (e-/s)", "Scatter of the pixel fractions")
    for ax, values, title in zip(axes, (image, scatter), titles, strict=True):
        _style.show_image(ax, values, title, "", cmap="cividis")
        draw_outline(ax, aperture)
    return axes


@styled(time=u.day)
def plot_states(time, states, leaks, aperture=None, *, time_label="Time (d)"):
    """Draw the states of a star's images in time, and the light that each moves between the pixels.

    Parameters
    ----------
    time : array_like
        Days, ``(n_cadences,)``.
    states : mapping of str to array_like
        Position, width or background ``(n_cadences,)`` by the label of their axis, with the unit.
    leaks : mapping of str to array_like
        By the names of states, part of the star's light that a pixel gains if this state grows by
        its standard deviation, ``(ny, nx)``.
    {mask}
    {time_label}

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        The states by their names, and the images by "leak, " and the name.

    Examples
    --------
    >>> from scope_models.plotting.detrending import plot_states
    >>> name = "Column (pixel)"
    >>> sorted(plot_states([0, 1], {name: [4.0, 4.1]}, {name: [[-0.1, 0.1]]}))
    ['Column (pixel)', 'leak, Column (pixel)']
    """
    mosaic = [[f"leak, {name}" if name in leaks else ".", name] for name in states]
    figure = plt.figure(figsize=(11, 1.2 + 2.1 * len(states)), layout="constrained")
    axes = figure.subplot_mosaic(mosaic, width_ratios=(1, 2.2))
    for name, values in states.items():
        ax, state = axes[name], plain_array(values, None, name)
        ax.plot(time, state, ".", ms=2, color=DARK)
        _style.scale_to(ax, state)
        _style.mark_outside(ax, time, state)
        ax.set_ylabel(name)
        ax.tick_params(labelbottom=False)
    ax.tick_params(labelbottom=True)
    ax.set_xlabel(time_label)
    for name, image in leaks.items():
        ax, leak = axes[f"leak, {name}"], 100 * plain_array(image, u.one, "leaks")
        most = np.nanmax(np.abs(leak))
        most = most if most > 1e-9 else 1.0  # less is rounded
        scale = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
        _style.show_image(ax, leak, "", "Light (%)", **scale)
        draw_outline(ax, aperture)
        ax.set_xlabel("Column (pixel)" if name == list(leaks)[-1] else "")
    axes[f"leak, {next(iter(leaks))}"].set_title("Light that one standard deviation moves")
    return axes


@styled
def plot_precision(stars, published=None, *, convention="lightkurve"):
    """Draw the noise of stars before and after a correction over their magnitude.

    Parameters
    ----------
    stars : mapping of str to array_like
        Per star, ``(n,)`` each: "mag", "raw_cdpp" and "cdpp" (ppm). NaN is not drawn.
    published : mapping of str to array_like, optional
        "mag", and medians of other light curves at these magnitudes by their names, drawn as lines.
    convention : str, optional
        Convention of the CDPP, which the label names.

    Returns
    -------
    `~matplotlib.figure.Figure`
        The figure.

    Examples
    --------
    >>> from scope_models.plotting.detrending import plot_precision
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
    ax.set(yscale="log", xlabel="Magnitude", ylabel=f"6.5-h CDPP (ppm, {convention})")
    ax.legend(fontsize="small")
    return figure
