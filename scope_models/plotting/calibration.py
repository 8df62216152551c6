"""Figures of the calibration: noise beside that of Kepler and K2, and what the fit allows."""

import matplotlib.pyplot as plt
import numpy as np

__all__ = ["plot_no_motion"]

_BAND = "0.88"
_ORANGE = "#d95f02"
_BLUE = "#2c5aa0"


def plot_no_motion(stars, summary, reference):
    """
    Draw the noise of stars at rest over Kepler's, and the ratios.

    Parameters
    ----------
    stars : mapping of str to array_like
        Per star: "kp", "detector_cdpp" and "cdpp" (ppm), ``(n,)`` each.
    summary : mapping of str to array_like
        Per bin, ``(m,)`` each: "mag", "detector_p10", "detector_p10_ratio", "star_median",
        "star_median_ratio" and "kepler_p10", "kepler_median", with the errors "detector_p10_error"
        and "star_median_error".
    reference : mapping of str to array_like
        Kepler's "mag", "p10", "median" and "p90", ``(k,)`` each.

    Returns
    -------
    `~matplotlib.figure.Figure`
        Two panels: the noise, and our percentiles over Kepler's.

    Examples
    --------
    >>> from scope_models.plotting.calibration import plot_no_motion
    >>> stars = {"kp": [12.0], "detector_cdpp": [17.0], "cdpp": [26.0]}
    >>> names = ("detector_p10", "star_median", "kepler_p10", "kepler_median")
    >>> summary = {name: [20.0] for name in names} | {"mag": [12.0]}
    >>> summary |= {f"{name}_{part}": [1.0] for name in names[:2] for part in ("ratio", "error")}
    >>> kepler = {"mag": [11.5, 12.0], "p10": [14, 17], "median": [29, 26], "p90": [99, 99]}
    >>> [ax.get_ylabel() for ax in plot_no_motion(stars, summary, kepler).axes]
    ['6.5-h CDPP (ppm)', 'Ours / Kepler']
    """
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(6.4, 6.8), sharex=True, height_ratios=(2.4, 1), layout="constrained"
    )
    mag = np.asarray(reference["mag"], dtype=float)
    top.fill_between(
        mag, reference["p10"], reference["p90"], color=_BAND, lw=0, label="Kepler, 10 % to 90 %"
    )
    top.plot(mag, reference["p10"], "-", color="0.45", lw=1, label="Kepler, 10 %")
    top.plot(mag, reference["median"], "k--", lw=1.2, label="Kepler, median")
    top.plot(stars["kp"], stars["cdpp"], ".", color=_ORANGE, ms=3, alpha=0.5,
             label="ours, with variability")  # fmt: skip
    top.plot(stars["kp"], stars["detector_cdpp"], ".", color=_BLUE, ms=3, alpha=0.7,
             label="ours, detector noise alone")  # fmt: skip
    top.set(yscale="log", ylabel="6.5-h CDPP (ppm)")
    low, high = min(stars["kp"]) - 0.2, max(stars["kp"]) + 0.2
    top.set(xlim=(low, high), ylim=(0.6 * min(stars["detector_cdpp"]), 3 * max(stars["cdpp"])))
    top.legend(fontsize="small", loc="upper left", ncols=2)
    for name, marker, color, label in (
        ("detector_p10", "o", _BLUE, "10th percentile, detector noise alone"),
        ("star_median", "s", _ORANGE, "median, with variability"),
    ):
        scale = np.asarray(summary[f"kepler_{name.split('_')[1]}"], dtype=float)
        error = np.asarray(summary[f"{name}_error"], dtype=float) / scale
        bottom.errorbar(
            summary["mag"], summary[f"{name}_ratio"], error, fmt=marker, color=color, ms=5,
            mec="k", mew=0.4, capsize=2, lw=1, label=label,
        )  # fmt: skip
    bottom.axhspan(0.9, 1.1, color=_BAND, lw=0, zorder=0)
    bottom.axhline(1, color="0.5", lw=0.8, zorder=0)
    bottom.set(xlabel="Magnitude (Kp)", ylabel="Ours / Kepler", ylim=(0.7, 1.3))
    bottom.legend(fontsize="small", loc="upper right")
    return figure
