"""Figures that go to a file and are not shown."""

import matplotlib.pyplot as plt

__all__ = ["save_figure"]


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
