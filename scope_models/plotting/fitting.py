"""Figures of fits to pixels."""

import matplotlib.pyplot as plt
import numpy as np

__all__ = ["plot_fit", "plot_twin"]

_TITLES = {"data": "Data", "model": "Model", "residual": "Residual"}


def plot_fit(data, model, residual, x, y, *, pos_corr=None, sensitivity=None):
    """
    Draw data, model and residual, positions against POS_CORR, and the sensitivity.

    Parameters
    ----------
    data, model, residual : array_like
        Images ``(ny, nx)`` in e-/s. They are drawn on one scale.
    x, y : array_like
        Positions ``(n_cadences,)`` in pixels.
    pos_corr : array_like, optional
        POS_CORR ``(n_cadences, 2)`` in pixels; without it the positions are drawn as a track.
    sensitivity : dict, optional
        "offset" from the pixel's centre, and for "x" and "y" the response and its standard
        deviation there.

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        "data", "model", "residual", "positions" and, if given, "sensitivity".

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> import numpy as np
    >>> from scope_models.plotting import plot_fit
    >>> image, path = np.eye(5), np.linspace(2, 2.5, 9)
    >>> axes = plot_fit(image, image, 0 * image, path, path)
    >>> sorted(axes)
    ['data', 'model', 'positions', 'residual']
    """
    names = [*_TITLES, "positions", *(("sensitivity",) if sensitivity else ())]
    figure, drawn = plt.subplots(
        1, len(names), figsize=(3.4 * len(names), 3.2), layout="constrained"
    )
    axes = dict(zip(names, drawn, strict=True))
    images = {"data": data, "model": model, "residual": residual}
    top = np.nanmax(np.abs(data))
    for name, image in images.items():
        ax = axes[name]
        shown = ax.imshow(image, origin="lower", cmap="RdGy_r", vmin=-top, vmax=top)
        ax.set(title=_TITLES[name], xlabel="Column (pixel)", ylabel="Row (pixel)")
    largest = np.nanmax(np.abs(residual))
    axes["residual"].set_title(f"Residual, at most {100 * largest / top:.2g} % of the data")
    figure.colorbar(shown, ax=[axes[name] for name in images], label="Flux (e$^-$ s$^{-1}$)")
    _draw_positions(axes["positions"], np.asarray(x), np.asarray(y), pos_corr)
    if sensitivity:
        _draw_sensitivity(axes["sensitivity"], sensitivity)
    return axes


def _draw_positions(ax, x, y, pos_corr):
    """Draw positions against POS_CORR, or as a track."""
    if pos_corr is None:
        ax.plot(x, y, "k.", ms=2)
        ax.set(title="Positions", xlabel="Column (pixel)", ylabel="Row (pixel)")
        return
    offsets = np.asarray(pos_corr)
    ax.plot(offsets[:, 0], x - np.median(x), "k.", ms=2, label="column")
    ax.plot(offsets[:, 1], y - np.median(y), ".", color="0.6", ms=2, label="row")
    ax.set(title="Positions", xlabel="POS_CORR (pixel)", ylabel="Position less median (pixel)")
    ax.legend(fontsize="small", markerscale=4)


def _draw_sensitivity(ax, sensitivity):
    """Draw the response along both axes with its uncertainty."""
    offset = sensitivity["offset"]
    for axis, color, line in (("x", "k", "-"), ("y", "0.5", "--")):
        value, error = sensitivity[axis]
        ax.plot(
            offset, value, line, color=color, label=f"along {'column' if axis == 'x' else 'row'}"
        )
        ax.fill_between(offset, value - error, value + error, color=color, alpha=0.25, lw=0)
    ax.set(title="Sensitivity", xlabel="Offset from the pixel's centre", ylabel="Relative response")
    ax.legend(fontsize="small")


def plot_twin(time, real, twin, residuals, *, time_label="Time (d)", labels=None):
    """
    Compare a star with its simulated twin.

    Parameters
    ----------
    time : array_like
        Times ``(n_cadences,)`` in days.
    real, twin : sequence of array_like
        Light curves ``(n_cadences,)`` relative to 1: as summed, and de-trended.
    residuals : sequence of array_like
        Standard deviation of data less model, in errors, of each pixel ``(ny, nx)``: of the
        star and of its twin.
    time_label : str, optional
        Label of the times.
    labels : dict, optional
        What is written beside "real" and "twin", as their CDPP.

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        "raw", "corrected", "real" and "twin".

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> import numpy as np
    >>> from scope_models.plotting import plot_twin
    >>> curve, image = np.ones(9), np.ones((4, 5))
    >>> axes = plot_twin(np.arange(9), [curve] * 2, [curve] * 2, [image] * 2)
    >>> axes["twin"].get_title()
    'Twin'
    """
    labels = labels or {}
    figure = plt.figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplot_mosaic([["raw", "real"], ["corrected", "twin"]], width_ratios=[2.4, 1])
    for number, (name, title) in enumerate((("raw", "Summed"), ("corrected", "De-trended"))):
        ax = axes[name]
        ax.plot(time, real[number], "k.", ms=2, label=f"star {labels.get('real', '')}")
        ax.plot(
            time, twin[number], ".", color="0.6", ms=1.5, label=f"twin {labels.get('twin', '')}"
        )
        ax.set(title=title, ylabel="Relative flux", xlabel=time_label)
        ax.legend(fontsize="small", markerscale=4)
    top = max(float(np.nanmax(image)) for image in residuals)
    for name, image in zip(("real", "twin"), residuals, strict=True):
        shown = axes[name].imshow(image, origin="lower", cmap="viridis", vmin=0, vmax=top)
        axes[name].set(title=name.replace("real", "star").capitalize(), xlabel="Column (pixel)")
        axes[name].set_ylabel("Row (pixel)")
        figure.colorbar(shown, ax=axes[name], label="Scatter of residuals (errors)")
    return axes
