"""Figure of transits that were put in and recovered."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models.plotting._style import styled
from scope_models.plotting.experiments import plot_map

__all__ = ["plot_recovery"]


@styled
def plot_recovery(panels, depths, magnitudes):
    """
    Draw maps of what is recovered of transits over depth and magnitude.

    Parameters
    ----------
    panels : mapping of str to array_like
        For each title the completeness and the found over the true depth,
        ``(2, n_depths, n_magnitudes)``; cells that are NaN stay empty.
    depths, magnitudes : array_like
        Depths in ppm and magnitudes.

    Returns
    -------
    `~matplotlib.figure.Figure`
        A column of two maps per title.

    Examples
    --------
    >>> from scope_models.plotting.recovery import plot_recovery
    >>> maps = [[0.5, 0.0]], [[1.01, float("nan")]]
    >>> figure = plot_recovery({"1x motion": maps}, [100], [12, 14])
    >>> [ax.get_title() for ax in figure.axes if ax.get_title()]
    ['1x motion', '1x motion']
    """
    size = (1.2 + len(panels) * (2.0 + 0.5 * len(magnitudes)), 2 * (1.3 + 0.42 * len(depths)))
    figure, axes = plt.subplots(
        2, len(panels), figsize=size, squeeze=False, layout="constrained"
    )  # fmt: skip
    ratios = np.array([maps[1] for maps in panels.values()], dtype=float)
    known = ratios[np.isfinite(ratios)]
    largest = max(0.1, np.max(np.abs(known - 1), initial=0.0))
    rows = (("Completeness", (0, 1)), ("Found / true depth", (1 - largest, 1 + largest)))
    for column, (title, maps) in enumerate(panels.items()):
        for ax, values, (label, span) in zip(axes[:, column], maps, rows, strict=True):
            plot_map(
                values, depths, magnitudes, row_label="Depth (ppm)", column_label="Kp (mag)",
                label=label, span=span, title=title, ax=ax,
            )  # fmt: skip
    return figure
