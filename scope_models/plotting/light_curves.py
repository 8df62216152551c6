"""Figures of light curves, and the summary of a star."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binned_statistic

from scope_models._arrays import plain_number
from scope_models.plotting import _style
from scope_models.plotting._style import DARK, LIGHT, styled
from scope_models.plotting.images import plot_motion, plot_pixels

__all__ = ["plot_fold", "plot_light_curve", "plot_summary"]


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
    >>> ax = plot_light_curve([0, 1, 2], [99, 100, 103], [100, 101, 100], cdpp=23.14)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['raw, CDPP 23.1 ppm (lightkurve)', 'corrected']
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
    limits = [(-window, window)]
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
        Pixel image ``(ny, nx)`` in e-/s, such as the first cadence.
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
        Expected relative flux ``(n_cadences,)``, drawn over the corrected light curve.
    noise : float or array_like, optional
        Expected relative standard deviation of a cadence, a number or
        ``(n_cadences,)``: a band about the corrected light curve.
    time_label, title : str, optional
        Label of the time axes and title of the figure.

    Returns
    -------
    dict
        The Axes ``"image"``, ``"motion"``, ``"light curve"`` and, with
        `corrected`, ``"corrected"``; ``axes["image"].figure`` is the figure.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting import plot_summary
    >>> axes = plot_summary([0, 1, 2], np.eye(5), [99, 100, 103], [2, 2.1, 2], [2, 2, 2.1])
    >>> sorted(axes)
    ['image', 'light curve', 'motion']
    """
    mosaic = [["image", "motion"], ["light curve", "light curve"]]
    if corrected is not None:
        mosaic.append(["corrected", "corrected"])
    options = {"layout": "constrained", "height_ratios": [1.5] + [1] * (len(mosaic) - 1)}
    figure, axes = plt.subplot_mosaic(mosaic, figsize=(9, 2 + 2.4 * len(mosaic)), **options)
    plot_pixels(image, aperture, title="First cadence", ax=axes["image"])
    plot_motion(time, x, y, time_label=time_label, ax=axes["motion"])
    given = {"cdpp": cdpp, "corrected_cdpp": corrected_cdpp, "time_label": time_label}
    plot_light_curve(time, flux, corrected, ax=axes["light curve"], **given)
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
