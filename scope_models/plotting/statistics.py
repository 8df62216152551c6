"""Figure of the statistics of motions."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import FuncFormatter, NullLocator

from scope_models.plotting._style import styled

__all__ = ["plot_motion_statistics"]

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
