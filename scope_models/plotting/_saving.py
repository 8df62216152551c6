"""Figures that go to a file and are not shown."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.backend_bases import FigureCanvasBase

__all__ = ["check_figure_format", "save_figure"]


def check_figure_format(path):
    """Refuse a file whose suffix is no format of figures, before any work is done for it."""
    formats = FigureCanvasBase.get_supported_filetypes()
    if Path(path).suffix[1:].lower() not in formats:
        raise ValueError(f"cannot write {path}: the formats of figures are {', '.join(formats)}")


def save_figure(figure, path):
    """Write a figure to a file, and give its memory back."""
    figure.savefig(path, dpi=150)
    plt.close(figure)
