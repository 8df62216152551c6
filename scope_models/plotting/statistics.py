"""Figures of single experiments: statistics of motions, and maps of a grid."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter, NullLocator

from scope_models.plotting._style import make_panels, styled
from scope_models.plotting.experiments import plot_map

__all__ = ["plot_maps", "plot_motion_statistics"]

_MARKERS = "os^Dvp*X"
_TITLES = {"mean": "Mean", "std": "Standard deviation", "maximum": "Maximum"}


@styled
def plot_motion_statistics(series, paper=None):
    """
    Draw how far a star moves against the factor on its motion.

    Parameters
    ----------
    series : mapping of str to mapping
        For each label "scale" ``(n,)``, and "mean", "std" and "maximum" ``(n,)`` of the distance
        from the reference position in pixels.
    paper : mapping, optional
        The same of the paper, drawn as lines.

    Returns
    -------
    `~matplotlib.figure.Figure`
        Three panels.

    Examples
    --------
    >>> from scope_models.plotting.statistics import plot_motion_statistics
    >>> motion = {"scale": [1, 2], "mean": [0.2, 0.4], "std": [0.1, 0.2], "maximum": [0.6, 1.2]}
    >>> figure = plot_motion_statistics({"generated": motion})
    >>> [ax.get_title() for ax in figure.axes]
    ['Mean', 'Standard deviation', 'Maximum']
    """
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), sharey=True, layout="constrained")
    shades = np.linspace(0, 0.7, max(len(series), 2))
    ticks = sorted({float(scale) for values in series.values() for scale in values["scale"]})
    for ax, (name, title) in zip(axes, _TITLES.items(), strict=True):
        if paper is not None:
            ax.plot(paper["scale"], paper[name], "-", color="#f08a24", lw=2, label="paper")
        for i, (label, values) in enumerate(series.items()):
            marker, shade = _MARKERS[i % len(_MARKERS)], str(shades[i])
            ax.plot(values["scale"], values[name], marker, color=shade, mfc="none", label=label)
        ax.set(title=title, xlabel="Factor on the motion", xscale="log", yscale="log")
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.grid(axis="y", color="0.9")
    axes[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[0].set_ylabel("Distance from the reference position (pixel)")
    axes[0].legend(fontsize="small")
    return figure


@styled
def plot_maps(maps, rows, columns, **labels):
    """
    Draw several maps of one grid on one logarithmic scale of colors.

    Parameters
    ----------
    maps : mapping of str to array_like
        For each title positive values ``(n_rows, n_columns)``.
    rows, columns : array_like
        As for `plot_map`.
    **labels
        Its ``row_label``, ``column_label``, ``label`` and ``text``; the colors are logarithms.

    Returns
    -------
    `~matplotlib.figure.Figure`
        One panel per map, two side by side.

    Examples
    --------
    >>> from scope_models.plotting.statistics import plot_maps
    >>> labels = {"row_label": "Depth", "column_label": "Kp", "label": "Noise", "text": ".2g"}
    >>> maps = {"raw": [[3.0, 1.0]], "corrected": [[1.0, 1.0]]}
    >>> figure = plot_maps(maps, [1], [12, 13], **labels)
    >>> [ax.get_title() for ax in figure.axes[:2]]
    ['raw', 'corrected']
    """
    values = np.log10([np.asarray(value, dtype=float) for value in maps.values()])
    span = float(np.nanmin(values)), float(np.nanmax(values))
    figure, axes = make_panels(len(maps), 2, (9, 0, 0.4, 3.4))
    text, label = labels.pop("text", ".2f"), f"log10 ({labels.pop('label').lower()})"
    for ax, title, value in zip(axes, maps, values, strict=True):
        plot_map(
            value, rows, columns, **labels, label=label, span=span, title=title, ax=ax,
            text=lambda number: format(10**number, text),
        )  # fmt: skip
    return figure
