"""Figure of the noise of many stars."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models.plotting._style import DARK, GRAY, LIGHT, styled

__all__ = ["plot_precision"]


@styled
def plot_precision(stars, published=None, *, convention="lightkurve"):
    """Draw the noise of stars before and after a correction over their magnitude.

    Parameters
    ----------
    stars : mapping of str to array_like
        Per star, ``(n,)`` each: "mag", "raw_cdpp" and "cdpp" (ppm). NaN is not drawn.
    published : mapping of str to array_like, optional
        "mag", and medians of other light curves at these magnitudes by their names, drawn as lines.
    convention : str, optional
        Convention of the CDPP, which the label names.

    Returns
    -------
    `~matplotlib.figure.Figure`
        The figure.

    Examples
    --------
    >>> from scope_models.plotting.noise import plot_precision
    >>> stars = {"mag": [12.0, 14.0], "raw_cdpp": [200, 300], "cdpp": [25, 60]}
    >>> plot_precision(stars).axes[0].get_xlabel()
    'Magnitude'
    """
    figure, ax = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
    mag = np.asarray(stars["mag"], dtype=float)
    ax.plot(mag, stars["raw_cdpp"], "s", ms=4, color=GRAY, label="before")
    ax.plot(mag, stars["cdpp"], "o", ms=4, color=DARK, label="corrected")
    medians = dict(published or {})
    center = medians.pop("mag", None)
    for (name, values), style in zip(medians.items(), ("-", "--", "-.", ":"), strict=False):
        ax.plot(center, values, style, color=LIGHT, label=name)
    ax.set(yscale="log", xlabel="Magnitude", ylabel=f"6.5-h CDPP (ppm, {convention})")
    ax.legend(fontsize="small")
    return figure
