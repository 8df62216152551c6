"""Figures that go to a file and are not shown."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.backend_bases import FigureCanvasBase

__all__ = ["check_figure_format", "save_figure"]


def check_figure_format(path):
    """Refuse a file whose suffix is no format of figures, before any work is done for it.

    Parameters
    ----------
    path : str or path-like
        The file.

    Raises
    ------
    ValueError
        If no figure can be written to it.
    """
    formats = FigureCanvasBase.get_supported_filetypes()
    if Path(path).suffix[1:].lower() not in formats:
        raise ValueError(f"cannot write {path}: the formats of figures are {', '.join(formats)}")


def save_figure(figure, path):
    """Write a figure, and give its memory back.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure; it is closed.
    path : str or path-like
        The file.
    """
    figure.savefig(path, dpi=150)
    plt.close(figure)
