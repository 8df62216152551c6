"""Style, panels and labels of all figures, and how they are saved."""

from functools import wraps
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.backend_bases import FigureCanvasBase

from scope_models._docstrings import documented

__all__ = [
    "DARK",
    "FLUX",
    "GRAY",
    "LIGHT",
    "STYLE",
    "check_figure_format",
    "given_or_new",
    "label_pixels",
    "make_panels",
    "save_figure",
    "scale_to",
    "styled",
]

STYLE = "scope_models.plotting.scope_models"
# Far apart in lightness too, so that figures can be read in black and white.
DARK, LIGHT, GRAY = "#08306b", "#f08a24", "0.65"
FLUX = "Flux (e$^-$ s$^{-1}$)"


def styled(function):
    """Return a plotting function that draws in the style of the package, with shared docs."""

    @documented()
    @wraps(function)
    def draw(*args, **kwargs):
        with plt.style.context(STYLE):
            return function(*args, **kwargs)

    return draw


def given_or_new(ax, width, height):
    """Return the given Axes, or those of a new figure."""
    return plt.subplots(figsize=(width, height), layout="constrained")[1] if ax is None else ax


def make_panels(number, columns, size, **options):
    """Return a figure of so many panels of a size, which share what ``options`` name."""
    columns = min(columns, number)
    rows = -(-number // columns)
    size = size[0] + size[1] * columns, size[2] + size[3] * rows
    figure, grid = plt.subplots(
        rows, columns, figsize=size, squeeze=False, layout="constrained", **options
    )
    for ax in grid.flat[number:]:
        ax.remove()
    return figure, list(grid.flat[:number])


def label_pixels(ax, title):
    """Label the axes of an image of pixels."""
    ax.set(title=title, xlabel="Column (pixel)", ylabel="Row (pixel)")


def scale_to(ax, *series):
    """Scale the ordinate to all but the outermost half percent of the values."""
    values = np.concatenate([np.ravel(part) for part in series]).astype(float)
    if np.isfinite(values).any():
        low, high = np.nanpercentile(values[np.isfinite(values)], (0.5, 99.5))
        margin = 0.3 * (high - low) or 0.01 * abs(high) or 1.0
        ax.set_ylim(low - margin, high + margin)


def check_figure_format(path):
    """Refuse a file whose suffix is no format of figures, before any work is done for it."""
    formats = FigureCanvasBase.get_supported_filetypes()
    if Path(path).suffix[1:].lower() not in formats:
        raise ValueError(f"cannot write {path}: the formats of figures are {', '.join(formats)}")


def save_figure(figure, path):
    """Write a figure to a file, and give its memory back."""
    figure.savefig(path, dpi=150)
    plt.close(figure)
