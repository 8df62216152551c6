"""Figures of one star: its light curves, the summary, the fit to its pixels, and its twin."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import AsinhNorm, LogNorm
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from scipy.stats import binned_statistic

from scope_models._arrays import plain_array, plain_number
from scope_models.plotting import _style
from scope_models.plotting._style import DARK, FLUX, LIGHT, styled
from scope_models.plotting.images import plot_motion, plot_pixels

__all__ = ["plot_fit", "plot_fold", "plot_light_curve", "plot_summary", "plot_twin"]

_RATE = u.electron / u.s
_TITLES = {"data": "Data, median", "model": "Model, median", "residual": "Residual, median"}
# Part of the brightest pixel up to which the scale of the images is linear.
_LINEAR = 0.01


@styled(time=u.day, flux=None, corrected=None)
def plot_light_curve(
    time, flux, corrected=None, *, cdpp=None, corrected_cdpp=None, convention="lightkurve",
    model=None, time_label="Time (d)", title="Light curve", ax=None,
):  # fmt: skip
    """Draw a raw light curve and, over it, the corrected one.

    Parameters
    ----------
    time, flux : array_like
        Times in days and fluxes ``(n_cadences,)`` in any unit.
    corrected : array_like, optional
        The corrected fluxes ``(n_cadences,)``.
    cdpp, corrected_cdpp : float, optional
        Noise of the two in ppm, written into the legend.
    convention : str, optional
        Convention of the CDPP, written beside it.
    model : array_like, optional
        Expected relative flux ``(n_cadences,)``, drawn as a line.
    time_label, title : str, optional
        Label of the time axis and title of the Axes.
    {draw}

    Examples
    --------
    >>> from scope_models.plotting import plot_light_curve
    >>> plot_light_curve([0, 1, 2], [99, 100, 103], [100, 101, 100], cdpp=23.14).get_ylabel()
    'Relative flux'
    """
    ax = _style.given_or_new(ax, 8, 3.2)
    before = _with_cdpp("raw", cdpp, "cdpp", convention)
    after = _with_cdpp("corrected", corrected_cdpp, "corrected_cdpp", convention)
    ax.plot(time, flux / np.nanmedian(flux), ".", ms=3.5, color=LIGHT, label=before)
    if corrected is not None:
        relative = corrected / np.nanmedian(corrected)
        ax.plot(time, relative, ".", ms=2.5, color=DARK, label=after)
    if model is not None:
        ax.plot(time, model, "-", lw=0.9, color="k", label="model")
    _label(ax, time_label, title)
    return ax


@styled(time=u.day, flux=None)
def plot_fold(
    time, flux, period, t0, *, model=None, window=None, n_bins=60, title="Folded", ax=None
):
    """Draw a light curve folded on a period, with the means of phase bins.

    Parameters
    ----------
    time, flux : array_like
        Times in days and relative fluxes ``(n_cadences,)``.
    period, t0 : float
        Period in days and time of mid-transit.
    model : array_like, optional
        Relative flux of a model at the same times, drawn as a line.
    window : float, optional
        Hours to draw on either side of mid-transit; half a period by default.
    n_bins : int, optional
        Number of bins over the window.
    {title}
    {draw}

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_fold
    >>> time = np.arange(200) / 48
    >>> plot_fold(time, np.ones(200), 1.5, 0.5, window=6).get_xlabel()
    'Time from mid-transit (h)'
    """
    period, t0 = plain_number(period, u.day, "period"), plain_number(t0, u.day, "t0")
    if not period > 0:
        raise ValueError(f"`period` must be positive, got {period}")
    window = 12 * period if window is None else plain_number(window, u.hour, "window")
    phase = 24 * ((time - t0 + period / 2) % period - period / 2)
    near = np.isfinite(flux) & (np.abs(phase) <= window)
    if not near.any():
        raise ValueError(f"`window` of {window} h around mid-transit holds no cadence")
    ax = _style.given_or_new(ax, 6, 3.6)
    ax.plot(phase[near], flux[near], ".", ms=3, color="0.75", label="cadences")
    limits = -window, window
    means, edges, _ = binned_statistic(phase[near], flux[near], bins=n_bins, range=limits)
    ax.plot((edges[:-1] + edges[1:]) / 2, means, "o", ms=4.5, color=DARK, label="binned")
    if model is not None:
        order = np.argsort(phase[near])
        ax.plot(phase[near][order], np.asarray(model)[near][order], color=LIGHT, label="model")
    _label(ax, "Time from mid-transit (h)", title)
    return ax


@styled(time=u.day, corrected=None)
def plot_summary(
    time, image, flux, x, y, *, corrected=None, aperture=None, cdpp=None, corrected_cdpp=None,
    model=None, noise=None, time_label="Time (d)", title=None,
):  # fmt: skip
    """Draw image with aperture, motion and light curves of a star in one figure.

    Parameters
    ----------
    time : array_like
        Times ``(n_cadences,)`` in days.
    image : array_like
        First cadence ``(ny, nx)`` in e-/s.
    flux : array_like
        Raw light curve ``(n_cadences,)``.
    x, y : array_like
        Positions of the star ``(n_cadences,)`` in pixels.
    corrected : array_like, optional
        Corrected light curve ``(n_cadences,)``.
    {mask}
    cdpp, corrected_cdpp : float, optional
        Noise of the two light curves in ppm, in lightkurve's convention.
    model : array_like, optional
        Expected relative flux ``(n_cadences,)``.
    noise : float or array_like, optional
        Expected relative standard deviation, a number or ``(n_cadences,)``, drawn as a band.
    time_label, title : str, optional
        Label of the time axes and title of the figure.

    Returns
    -------
    dict
        The Axes ``"image"``, ``"motion"``, ``"light curve"`` and, with `corrected`,
        ``"corrected"``.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_summary
    >>> sorted(plot_summary([0, 1, 2], np.eye(5), [99, 100, 103], [2, 2.1, 2], [2, 2, 2.1]))
    ['image', 'light curve', 'motion']
    """
    mosaic = [["image", "motion"], ["light curve", "light curve"]]
    if corrected is not None:
        mosaic.append(["corrected", "corrected"])
    options = {"layout": "constrained", "height_ratios": [1.5] + [1] * (len(mosaic) - 1)}
    figure, axes = plt.subplot_mosaic(mosaic, figsize=(9, 2 + 2.4 * len(mosaic)), **options)
    plot_pixels(image, aperture, title="First cadence", ax=axes["image"])
    plot_motion(time, x, y, time_label=time_label, ax=axes["motion"])
    plot_light_curve(
        time, flux, corrected, cdpp=cdpp, corrected_cdpp=corrected_cdpp, time_label=time_label,
        ax=axes["light curve"],
    )  # fmt: skip
    if corrected is not None:
        _plot_corrected(axes["corrected"], time, corrected, model, noise, time_label)
    figure.suptitle(title)
    return axes


def _plot_corrected(ax, time, corrected, model, noise, time_label):
    relative = corrected / np.nanmedian(corrected)
    ax.plot(time, relative, ".", ms=2.5, color=DARK, label="corrected")
    if noise is not None:
        level = np.ones(len(relative)) if model is None else np.asarray(model, dtype=float)
        band = {"color": "0.85", "lw": 0, "zorder": 0, "label": "expected noise, 1 sigma"}
        ax.fill_between(time, level - noise, level + noise, **band)
    _style.scale_to(ax, relative)
    if model is not None:
        ax.plot(time, model, "-", lw=1.2, color=LIGHT, label="truth")
        low, high = ax.get_ylim()
        ax.set_ylim(min(low, np.nanmin(model)), max(high, np.nanmax(model)))
    _style.mark_outside(ax, time, relative)
    _label(ax, time_label, "Corrected light curve")


def _label(ax, xlabel, title):
    ax.set(xlabel=xlabel, ylabel="Relative flux")
    ax.set_title(title, loc="left")
    ax.ticklabel_format(axis="y", useOffset=False)
    _style.legend_above(ax, ncols=3, markerscale=2, fontsize="small", columnspacing=1.2)


def _with_cdpp(name, cdpp, argument, convention):
    if cdpp is None:
        return name
    return f"{name}, CDPP {plain_number(cdpp, u.Unit(1e-6), argument):.1f} ppm ({convention})"


@styled(
    data=_RATE, model=_RATE, residual=_RATE, x=u.pix, y=u.pix, pos_corr=u.pix, psf_extent=u.pix,
    time=u.day, flux=_RATE,
)  # fmt: skip
def plot_fit(
    data, model, residual, x, y, *, psf=None, psf_extent=None, psf_width=None, pos_corr=None,
    sensitivity=None, chi2=None, time=None, flux=None, time_label="Time (d)",
):  # fmt: skip
    """Draw data, model, residual and PSF, positions against POS_CORR, chi-squared, light curve.

    Parameters
    ----------
    data, model, residual : array_like
        Images ``(ny, nx)`` in e-/s. The scale of data and model is linear up to a hundredth of the
        brightest pixel and logarithmic above, that of the residual is linear.
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
        deviation there, NaN where a coefficient is at its bound; instead of the light curve.
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
    >>> sorted(plot_fit(image, image, 0 * image, path, path))
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
        bar = _style.show_image(axes["chi2"], chi2, title, "Per degree of freedom", norm=LogNorm())
        _write_numbers(bar)
    if sensitivity:
        _draw_sensitivity(axes["sensitivity"], sensitivity)
    elif flux is not None:
        _draw_flux(axes["light curve"], time, flux, time_label)
    return axes


def _draw_images(axes, data, model, residual):
    top, largest = np.nanmax(np.abs(data)), np.nanmax(np.abs(residual)) or 1.0
    light = AsinhNorm(_LINEAR * top, -_LINEAR * top, top)
    _style.show_image(axes["data"], data, _TITLES["data"], norm=light)
    bar = _style.show_image(axes["model"], model, _TITLES["model"], FLUX, norm=light)
    _set_ticks(bar, top)
    title = f"{_TITLES['residual']}, to {100 * largest / top:.2g} %"
    scale = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
    _style.show_image(axes["residual"], residual, title, FLUX, **scale)


def _set_ticks(bar, top):
    ticks = [part * top for part in (0.0, _LINEAR, 0.1, 1)]
    bar.set_ticks(ticks, labels=[f"{float(f'{tick:.3g}'):,.10g}" for tick in ticks])
    bar.minorticks_off()


def _write_numbers(bar):
    bar.locator = LogLocator(subs=(1, 2, 5))
    bar.formatter = FuncFormatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_minor_formatter(NullFormatter())


def _draw_psf(ax, psf, extent, width):
    title, norm = "PSF" if width is None else f"PSF, {width}", AsinhNorm(_LINEAR, 0, 1)
    bar = _style.show_image(ax, psf, title, "Relative density", extent=extent, norm=norm)
    ax.set(xlabel="Column offset (pixel)", ylabel="Row offset (pixel)")
    _set_ticks(bar, 1)


def _draw_flux(ax, time, flux, label):
    time, label = (np.arange(flux.size), "Cadence") if time is None else (time, label)
    ax.plot(time, flux, "k.", ms=2)
    ax.set(title="Light curve", xlabel=label, ylabel=FLUX)
    _style.scale_to(ax, flux)
    _style.mark_outside(ax, time, flux)
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
    label = "Offset from the pixel's center (pixel)"
    ax.set(title="Sensitivity", xlabel=label, ylabel="Relative response")
    ax.legend(fontsize="small")


@styled(time=u.day)
def plot_twin(time, real, twin, residuals, *, time_label="Time (d)", labels=None):
    """Compare a star with its simulated twin.

    Parameters
    ----------
    time : array_like
        Times ``(n_cadences,)`` in days.
    real, twin : sequence of array_like
        Light curves ``(n_cadences,)`` relative to 1: as summed, and de-trended.
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
    >>> curves, images = np.ones((2, 9)), np.ones((2, 4, 5))
    >>> sorted(plot_twin(np.arange(9), curves, curves, images))
    ['corrected', 'raw', 'real', 'twin']
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
        _style.scale_to(ax, real[number], twin[number])
        ax.legend(fontsize="small", markerscale=4)
    norm = LogNorm(*(f([f(image[image > 0]) for image in residuals]) for f in (np.min, np.max)))
    for name, image in zip(("real", "twin"), residuals, strict=True):
        title, label = name.replace("real", "star").capitalize(), "Scatter of residuals (errors)"
        _write_numbers(_style.show_image(axes[name], image, title, label, norm=norm))
    return axes
