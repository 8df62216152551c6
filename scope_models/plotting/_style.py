"""Style, panels and labels of all figures, and how they are saved."""

import inspect
from functools import partial, wraps
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.transforms import Bbox

from scope_models._arrays import plain_array
from scope_models._docstrings import documented

__all__ = [
    "DARK", "FLUX", "GRAY", "LIGHT", "STYLE", "check_figure_format", "given_or_new", "label_places",
    "legend_above", "mark_outside", "save_figure", "scale_to", "show_image", "styled",
]  # fmt: skip

STYLE = "scope_models.plotting.scope_models"
# Far apart in lightness too, so that figures can be read in black and white.
DARK, LIGHT, GRAY = "#08306b", "#f08a24", "0.65"
FLUX = "Flux (e$^-$ s$^{-1}$)"
_SHARED_DOCS = {
    "time_label": "time_label : str, optional\n    Label of the times.",
    "mask": """aperture : array_like of bool, optional
    Mask ``(ny, nx)`` whose outline is drawn.""",
    "title": "title : str, optional\n    Title of the Axes.",
}


def styled(function=None, /, **units):
    """Decorate a plotting function: the style of the package, shared docs, arrays in their units.

    The arguments that are named become arrays, None stays; a unit of None stands for any.
    """
    if function is None:
        return partial(styled, **units)
    signature = inspect.signature(function)

    @documented(**_SHARED_DOCS)
    @wraps(function)
    def draw(*args, **kwargs):
        given = signature.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            if name in units and value is not None:
                given.arguments[name] = plain_array(value, units[name], name)
        with plt.style.context(STYLE):
            return function(*given.args, **given.kwargs)

    return draw


def given_or_new(ax, width, height):
    return plt.subplots(figsize=(width, height), layout="constrained")[1] if ax is None else ax


def show_image(ax, image, title, label=None, *, cmap="viridis", **options):
    """Draw an image of pixels and, if it has a label, its color bar, which is returned."""
    shown = ax.imshow(image, origin="lower", cmap=cmap, **options)
    ax.set(title=title, xlabel="Column (pixel)", ylabel="Row (pixel)")
    return None if label is None else ax.figure.colorbar(shown, ax=ax, label=label, shrink=0.85)


def legend_above(ax, **options):
    """Draw the legend above the Axes, where it hides no data."""
    ax.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, **options)


def scale_to(ax, *series):
    """Scale the ordinate to all but the outermost half percent of the values."""
    values = np.concatenate([np.ravel(part) for part in series]).astype(float)
    values = values[np.isfinite(values)]
    if values.size:
        low, high = np.percentile(values, (0.5, 99.5))
        margin = 0.3 * (high - low) or 0.01 * abs(high) or 1.0
        ax.set_ylim(low - margin, high + margin)


def mark_outside(ax, x, values):
    """Draw arrows at the borders of the Axes toward values beyond them."""
    low, high = ax.get_ylim()
    for beyond, border, marker in ((values > high, high, "^"), (values < low, low, "v")):
        if np.any(beyond):
            at = np.full(np.count_nonzero(beyond), border)
            ax.plot(np.asarray(x)[beyond], at, marker, ms=5, color=LIGHT, clip_on=False)


def label_places(ax, places, texts, radii):
    """Write texts beside places without overlaps; markers have radii in points."""
    point, centers = ax.figure.dpi / 72, ax.transData.transform(places)
    taken = [Bbox([c - r * point, c + r * point]) for c, r in zip(centers, radii, strict=True)]
    for place, text, radius in zip(places, texts, radii, strict=True):
        for ha, va in (("left", "bottom"), ("left", "top"), ("right", "bottom"), ("right", "top")):
            gap = np.where([ha == "left", va == "bottom"], radius + 1, -radius - 1)
            where = {"ha": ha, "va": va, "textcoords": "offset points", "zorder": 6}
            note = ax.annotate(text, place, gap, fontsize="small", **where)
            box = note.get_window_extent()
            inside = all(ax.bbox.contains(*corner) for corner in box.get_points())
            if inside and not box.count_overlaps(taken):
                taken.append(box)
                break
            note.remove()


def check_figure_format(path):
    """Refuse a file whose suffix is not a figure format, before any work is done."""
    formats = FigureCanvasBase.get_supported_filetypes()
    if Path(path).suffix[1:].lower() not in formats:
        raise ValueError(f"cannot write {path}: the formats of figures are {', '.join(formats)}")


def save_figure(figure, path):
    """Write a figure to a file, and give its memory back."""
    figure.savefig(path, dpi=150)
    plt.close(figure)
