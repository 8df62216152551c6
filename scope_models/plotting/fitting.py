"""Figures of fits to pixels."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm, LogNorm
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from scope_models._arrays import plain_array
from scope_models.plotting._style import FLUX, mark_outside, scale_to, show_image, styled

__all__ = ["plot_fit", "plot_twin"]

_RATE = u.electron / u.s
_TITLES = {"data": "Data, median", "model": "Model, median", "residual": "Residual, median"}
# Part of the brightest pixel up to which the scale of the images is linear.
_LINEAR = 0.01


@styled(
    data=_RATE, model=_RATE, residual=_RATE, x=u.pix, y=u.pix, pos_corr=u.pix, psf_extent=u.pix,
    time=u.day, flux=_RATE,
)  # fmt: skip
def plot_fit(
    data, model, residual, x, y, *, psf=None, psf_extent=None, psf_width=None, pos_corr=None,
    sensitivity=None, chi2=None, time=None, flux=None, time_label="Time (d)",
):  # fmt: skip
    """Draw data, model, residual and PSF, positions against POS_CORR, chi-squared, light curve.

    A sensitivity takes the place of the light curve.

    Parameters
    ----------
    data, model, residual : array_like
        Images ``(ny, nx)`` in e-/s. Data and model are drawn on one scale, linear for what is
        fainter than a hundredth of the brightest pixel and logarithmic above, the residual on a
        linear scale of its own.
    x, y : array_like
        Positions ``(n_cadences,)`` in pixels.
    psf : array_like, optional
        Density of the PSF on a fine grid, relative to its largest value.
    psf_extent : tuple of float, optional
        Left, right, lower and upper border of that grid in pixels.
    psf_width : str, optional
        Width of the PSF, written above it.
    pos_corr : array_like, optional
        POS_CORR ``(n_cadences, 2)`` in pixels; without it the positions are drawn as a track.
    sensitivity : dict, optional
        "offset" from the pixel's center, and for "x" and "y" the response and its standard
        deviation there, NaN where a coefficient is at its bound.
    chi2 : array_like, optional
        Chi-squared per degree of freedom of each pixel, ``(ny, nx)``.
    time, flux : array_like or `~astropy.units.Quantity`, optional
        Light curve ``(n_cadences,)`` in days and e-/s. Arrows stand for values beyond the scale.
    {time_label}

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        "data", "model", "residual", "positions" and, if given, "psf", "chi2", and "sensitivity"
        or "light curve".

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_fit
    >>> image, path = np.eye(5), np.linspace(2, 2.5, 9)
    >>> axes = plot_fit(image, image, 0 * image, path, path)
    >>> sorted(axes)
    ['data', 'model', 'positions', 'residual']
    """
    last = ("sensitivity", sensitivity) if sensitivity else ("light curve", flux)
    given = [name for name, part in (("chi2", chi2), last) if part is not None]
    above, below = [*_TITLES, *(["psf"] if psf is not None else [])], ["positions", *given]
    below += below[-1:] * (len(above) - len(below))
    figure = plt.figure(figsize=(3.7 * len(above), 6.4), layout="constrained")
    axes = figure.subplot_mosaic([above, below])
    _draw_images(axes, data, model, residual)
    if psf is not None:
        _draw_psf(axes["psf"], psf, psf_extent, psf_width)
    _draw_positions(axes["positions"], x, y, pos_corr)
    if chi2 is not None:
        title = f"Chi-squared, median {np.nanmedian(chi2):.3g}"
        bar = show_image(axes["chi2"], chi2, title, "Per degree of freedom", norm=LogNorm())
        _write_numbers(bar)
    if sensitivity:
        _draw_sensitivity(axes["sensitivity"], sensitivity)
    elif flux is not None:
        _draw_flux(axes["light curve"], time, flux, time_label)
    return axes


def _draw_images(axes, data, model, residual):
    top, largest = np.nanmax(np.abs(data)), np.nanmax(np.abs(residual)) or 1.0
    light = AsinhNorm(_LINEAR * top, -_LINEAR * top, top)
    show_image(axes["data"], data, _TITLES["data"], norm=light)
    bar = show_image(axes["model"], model, _TITLES["model"], FLUX, norm=light)
    ticks = [0.0, *(part * top for part in (_LINEAR, 0.1, 1))]
    bar.set_ticks(ticks, labels=[f"{float(f'{tick:.3g}'):,.10g}" for tick in ticks])
    bar.minorticks_off()
    title = f"{_TITLES['residual']}, to {100 * largest / top:.2g} %"
    scale = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
    show_image(axes["residual"], residual, title, FLUX, **scale)


def _write_numbers(bar):
    bar.locator = LogLocator(subs=(1, 2, 5))
    bar.formatter = FuncFormatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_minor_formatter(NullFormatter())


def _draw_psf(ax, psf, extent, width):
    title, norm = "PSF" if width is None else f"PSF, {width}", AsinhNorm(_LINEAR, 0, 1)
    bar = show_image(ax, psf, title, "Relative density", extent=extent, norm=norm)
    ax.set(xlabel="Column offset (pixel)", ylabel="Row offset (pixel)")
    bar.set_ticks([0, _LINEAR, 0.1, 1], labels=["0", f"{_LINEAR}", "0.1", "1"])
    bar.minorticks_off()


def _draw_flux(ax, time, flux, label):
    time, label = (np.arange(flux.size), "Cadence") if time is None else (time, label)
    ax.plot(time, flux, "k.", ms=2)
    ax.set(title="Light curve", xlabel=label, ylabel=FLUX)
    scale_to(ax, flux)
    mark_outside(ax, time, flux)
    ax.locator_params(axis="x", nbins=5)
    ax.ticklabel_format(useOffset=False)


def _draw_positions(ax, x, y, pos_corr):
    if pos_corr is None:
        ax.plot(x, y, "k.", ms=2)
        ax.set(title="Positions", xlabel="Column (pixel)", ylabel="Row (pixel)")
        return
    path = pos_corr - np.median(pos_corr, axis=0)
    ax.plot(path[:, 0], x - np.median(x), "k.", ms=2, label="column")
    ax.plot(path[:, 1], y - np.median(y), ".", color="0.6", ms=2, label="row")
    ax.locator_params(nbins=5)
    title = "Positions, less their medians"
    ax.set(title=title, xlabel="POS_CORR (pixel)", ylabel="Fitted (pixel)")
    ax.legend(fontsize="small", markerscale=4, loc="upper left")


def _draw_sensitivity(ax, sensitivity):
    offset = sensitivity["offset"]
    for axis, color, line in (("x", "k", "-"), ("y", "0.5", "--")):
        value, error = sensitivity[axis]
        label = f"along {'columns' if axis == 'x' else 'rows'}"
        label += ", at its bound" if np.isnan(error).any() else ""
        ax.plot(offset, value, line, color=color, label=label)
        ax.fill_between(offset, value - error, value + error, color=color, alpha=0.25, lw=0)
    ax.set(title="Sensitivity")
    ax.set(xlabel="Offset from the pixel's center (pixel)", ylabel="Relative response")
    ax.legend(fontsize="small")


@styled(time=u.day)
def plot_twin(time, real, twin, residuals, *, time_label="Time (d)", labels=None):
    """Compare a star with its simulated twin.

    Parameters
    ----------
    time : array_like
        Times ``(n_cadences,)`` in days.
    real, twin : sequence of array_like
        Light curves ``(n_cadences,)`` relative to 1: as summed, and de-trended. The axes leave out
        outliers.
    residuals : sequence of array_like
        Standard deviation of data less model, in errors, of each pixel ``(ny, nx)``: of the
        star and of its twin.
    {time_label}
    labels : dict, optional
        What is written beside "real" and "twin", as their CDPP.

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        "raw", "corrected", "real" and "twin".

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_twin
    >>> curve, image = np.ones(9), np.ones((4, 5))
    >>> axes = plot_twin(np.arange(9), [curve] * 2, [curve] * 2, [image] * 2)
    >>> axes["twin"].get_title()
    'Twin'
    """
    labels = labels or {}
    real, twin, residuals = (
        [plain_array(item, u.one, name) for item in items]
        for name, items in (("real", real), ("twin", twin), ("residuals", residuals))
    )
    figure = plt.figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplot_mosaic([["raw", "real"], ["corrected", "twin"]], width_ratios=[2.4, 1])
    for number, (name, title) in enumerate((("raw", "Summed"), ("corrected", "De-trended"))):
        ax = axes[name]
        star, other = f"star {labels.get('real', '')}", f"twin {labels.get('twin', '')}"
        ax.plot(time, real[number], "k.", ms=2, label=star)
        ax.plot(time, twin[number], ".", color="0.6", ms=1.5, label=other)
        ax.set(title=title, ylabel="Relative flux", xlabel=time_label)
        scale_to(ax, real[number], twin[number])
        ax.legend(fontsize="small", markerscale=4)
    norm = LogNorm(*(f([f(image[image > 0]) for image in residuals]) for f in (np.min, np.max)))
    for name, image in zip(("real", "twin"), residuals, strict=True):
        title, label = name.replace("real", "star").capitalize(), "Scatter of residuals (errors)"
        _write_numbers(show_image(axes[name], image, title, label, norm=norm))
    return axes
