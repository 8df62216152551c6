"""Precision over magnitude, beside that of missions."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models.plotting._style import styled

__all__ = ["plot_precision"]


@styled
def plot_precision(stars, reference):
    """
    Draw the noise of stars before and after a correction over their magnitude.

    Parameters
    ----------
    stars : mapping of str to array_like
        Per star, ``(n,)`` each: "mag", "raw_cdpp" and "cdpp" (ppm). NaN is not drawn.
    reference : mapping of str to mapping
        For each label "mag", "p10" and "median" (ppm), ``(k,)`` each.

    Returns
    -------
    `~matplotlib.figure.Figure`
        The figure.

    Examples
    --------
    >>> from scope_models.plotting.precision import plot_precision
    >>> stars = {"mag": [12.0, 14.0], "raw_cdpp": [200, 300], "cdpp": [25, 60]}
    >>> kepler = {"mag": [12, 14], "p10": [17, 43], "median": [26, 53]}
    >>> plot_precision(stars, {"Kepler": kepler}).axes[0].get_xlabel()
    'Magnitude'
    """
    figure, axes = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
    for (label, values), style in zip(reference.items(), ("k--", "k:", "k-."), strict=False):
        axes.plot(values["mag"], values["median"], style, lw=1.2, label=f"{label}, median")
    mag = np.asarray(stars["mag"], dtype=float)
    axes.plot(mag, stars["raw_cdpp"], ".", color="0.6", label="before")
    axes.plot(mag, stars["cdpp"], ".", color="#2c5aa0", label="corrected")
    axes.set(yscale="log", xlabel="Magnitude", ylabel="6.5-h CDPP (ppm)")
    if np.isfinite(mag).any():
        axes.set_xlim(np.nanmin(mag) - 0.5, np.nanmax(mag) + 0.5)
    axes.legend(fontsize="small")
    return figure
