"""Figures of the calibration: noise beside that of Kepler and K2, and what the fit allows."""

import matplotlib.pyplot as plt
import numpy as np

from scope_models.plotting._style import make_panels, styled

__all__ = ["plot_degeneracy", "plot_k2_motion", "plot_no_motion"]

_BAND = "0.88"
_ORANGE = "#d95f02"
_BLUE = "#2c5aa0"


@styled
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


@styled
def plot_k2_motion(series, reference):
    """
    Draw the noise of moving stars over that of K2 campaign 3, and what contributes to it.

    Parameters
    ----------
    series : mapping of str to mapping
        For each label per magnitude, ``(m,)`` each: "mag", "noise_p10", "noise_median", "noise_p90"
        and the medians "white", "losses", "intrapixel" and "systematics", all in ppm. The
        contributions of the last one are drawn.
    reference : mapping of str to array_like
        Real stars: "mag", "p10", "median" and "p90", ``(k,)`` each.

    Returns
    -------
    `~matplotlib.figure.Figure`
        Two panels: noise, and contributions.

    Examples
    --------
    >>> from scope_models.plotting.calibration import plot_k2_motion
    >>> names = ("noise_p10", "noise_median", "noise_p90", "white", "losses", "intrapixel")
    >>> stars = {name: [90.0, 99.0] for name in (*names, "systematics")} | {"mag": [12.0, 13.0]}
    >>> real = {"mag": [12, 13], "p10": [57, 75], "median": [189, 203], "p90": [489, 566]}
    >>> figure = plot_k2_motion({"calibrated": stars}, real)
    >>> [ax.get_title() for ax in figure.axes]
    ['Noise before de-trending', 'What contributes: calibrated']
    """
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    mag = np.asarray(reference["mag"], dtype=float)
    for ax in (left, right):
        ax.fill_between(mag, reference["p10"], reference["p90"], color=_BAND, lw=0,
                        label="K2 campaign 3, 10 % to 90 %")  # fmt: skip
        ax.plot(mag, reference["median"], "k--", lw=1.2, label="K2 campaign 3, median")
        ax.set(yscale="log", xlabel="Magnitude (Kp)")
    colors = (_BLUE, _ORANGE, "#1b9e77")
    for number, (label, values) in enumerate(series.items()):
        low, middle, high = (
            np.asarray(values[f"noise_{name}"], dtype=float) for name in ("p10", "median", "p90")
        )
        place = np.asarray(values["mag"], dtype=float) + 0.06 * (number - (len(series) - 1) / 2)
        left.errorbar(
            place, middle, [middle - low, high - middle], fmt="os^"[number % 3], ms=5,
            color=colors[number % 3], mec="k", mew=0.4, lw=1, capsize=2,
            label=f"{label}: median, 10 % to 90 %",
        )  # fmt: skip
    label, values = list(series.items())[-1]
    for name, text, style in (
        ("white", "photons, background, reads", ":"),
        ("losses", "light leaving the aperture", "-."),
        ("intrapixel", "and response within pixels", "--"),
        ("systematics", "and response between pixels", "-"),
    ):
        right.plot(values["mag"], values[name], style, color=_ORANGE, lw=1.6, label=text)
    low, high = min(values["mag"]) - 0.3, max(values["mag"]) + 0.3
    left.set(xlim=(low, high), ylim=(8, 4000), ylabel="6.5-h CDPP (ppm)")
    left.set_title("Noise before de-trending")
    right.set_title(f"What contributes: {label}")
    for ax in (left, right):
        ax.legend(fontsize="small", loc="upper left")
    return figure


@styled
def plot_degeneracy(grids, marks=None):
    """
    Draw how well the response within and between pixels explains the noise.

    Parameters
    ----------
    grids : mapping of float to tuple
        For each part of the light in the wings: a_2 ``(n,)``, standard deviation of b ``(m,)`` and
        the cost ``(n, m)``, which is a chi square.
    marks : mapping of str to tuple, optional
        Points ``(a_2, standard deviation of b)`` to mark in each panel.

    Returns
    -------
    `~matplotlib.figure.Figure`
        One panel per wings, with contours of the cost above the lowest of all.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.plotting.calibration import plot_degeneracy
    >>> a_2, b = np.linspace(-2, 0, 5), np.linspace(0, 0.02, 4)
    >>> cost = 30 + (a_2[:, np.newaxis] + 1) ** 2 + (b / 0.01 - 1) ** 2
    >>> len(plot_degeneracy({0.1: (a_2, b, cost), 0.2: (a_2, b, cost + 5)}).axes)
    3
    """
    figure, axes = make_panels(len(grids), 3, (1, 3.4, 0.6, 3.2), sharex=True, sharey=True)
    lowest = min(np.min(cost) for _, _, cost in grids.values())
    levels = [0, 2.3, 6.2, 11.8, 20, 40, 80]
    for ax, (wings, (a_2, scatter, cost)) in zip(axes, sorted(grids.items()), strict=True):
        excess = np.asarray(cost) - lowest
        order = np.argsort(a_2)
        shown = ax.contourf(np.asarray(a_2)[order], 100 * np.asarray(scatter), excess[order].T,
                            levels, cmap="Blues_r", extend="max")  # fmt: skip
        ax.contour(np.asarray(a_2)[order], 100 * np.asarray(scatter), excess[order].T, levels[1:4],
                   colors="k", linewidths=0.7)  # fmt: skip
        for marker, (label, point) in zip("*o^s", (marks or {}).items(), strict=False):
            ax.plot(point[0], 100 * point[1], marker, color=_ORANGE, mec="k", ms=9, ls="none",
                    label=label, clip_on=False, zorder=5)  # fmt: skip
        ax.set_title(f"{100 * wings:.0f} % in the wings")
        ax.set(xlabel="$a_2$")
        ax.label_outer()
    for ax in axes[::3]:
        ax.set_ylabel("Standard deviation of $b$ (%)")
    if marks:
        axes[0].legend(fontsize="small", loc="upper left")
    figure.colorbar(shown, ax=axes, label=r"$\chi^2$ above the lowest")
    return figure
