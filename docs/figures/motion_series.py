"""Compare the motion that `Motion.k2_roll` generates with that of real stars.

The build of the documentation draws the figures. Without the real files only the generated motion
is drawn.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from scope_models.scene.motion import Motion

# From the folder of this file, in which the documentation's build runs it.
FOLDER = Path("../../../shared/data/poscorr")
# Name of the file, and how the generator's parameters differ from its defaults: the place in the
# field, the sense of roll and the days of its reversals, which are those of each campaign.
STARS = {
    "EPIC 205998445, C3": ("epic205998445_c03_poscorr.fits", {}),
    "WASP-47, C3": (
        "ktwo206103150-c03_llc.fits",
        {"n_cadences": 3386, "field": (-2.61, -4.77), "seed": 1},
    ),
    "EPIC 211436265, C5": (
        "ktwo211436265-c05_llc.fits",
        {
            "n_cadences": 3663,
            "field": (3.9, -4.5),
            "solar_rate": -2.5,
            "reversal": -8.5,
            "reversal_interval": 45.0,
            "seed": 1,
        },
    ),
}
COLORS = {"real": "tab:blue", "generated": "tab:orange"}
# Quality flags of cadences without fine pointing or data; thruster firings stay.
UNUSABLE = 1 | 2 | 4 | 8 | 32 | 256 | 16384 | 32768 | 65536


def principal_axes(motion):
    """Return the motion along and across the direction of roll, about its mean, in pixels."""
    offsets = np.column_stack([motion.x - motion.x.mean(), motion.y - motion.y.mean()])
    across, along = np.linalg.eigh(offsets.T @ offsets)[1].T
    return offsets @ (along * np.sign(along[1])), offsets @ across


def hours_between_resets(motion):
    """Return the times between resets, which are jumps that stand out from the drift, in hours."""
    along = principal_axes(motion)[0]
    steps = np.diff(along)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode="edge"), 9)
    jump = np.abs(steps - np.median(windows, axis=1)) > 0.15 * np.std(along)
    begins = np.flatnonzero(jump[1:] & ~jump[:-1]) + 1
    return 24 * np.diff(motion.time[begins])


def power_spectra(motion, segment=480):
    """Return frequencies in 1/d, and the mean power along and across the roll in px^2 d."""
    step = np.median(np.diff(motion.time))
    window = np.hanning(min(segment, len(motion)))
    spectra = []
    for values in principal_axes(motion):
        pieces = np.lib.stride_tricks.sliding_window_view(values, len(window))
        pieces = pieces[:: len(window) // 2]
        pieces = (pieces - pieces.mean(axis=1, keepdims=True)) * window
        power = np.abs(np.fft.rfft(pieces, axis=1)) ** 2
        spectra.append(2 * step * power.mean(axis=0) / np.sum(window**2))
    return np.fft.rfftfreq(len(window), step)[1:], spectra[0][1:], spectra[1][1:]


def draw_series(axes, motions):
    """Draw the whole series and four days of it, real above generated."""
    height = 5 * max(np.std(principal_axes(motion)[0]) for motion in motions.values())
    for i, (label, motion) in enumerate(motions.items()):
        days = motion.time - motion.time[0]
        along, across = (values - i * height for values in principal_axes(motion))
        axes[0].plot(days, along, color=COLORS[label], lw=0.5, label=f"{label}, along the roll")
        axes[0].plot(days, across, color="black", lw=0.6, label="across" if i == 0 else None)
        part = (days > 4) & (days < 8)
        axes[1].plot(days[part], along[part], ".-", color=COLORS[label], lw=0.6, ms=2.5)
        axes[1].plot(days[part], across[part], color="black", lw=0.6)


def draw_summary(axes, motions):
    """Draw power spectra, the distribution of drift lengths, and tracks on the detector."""
    axes[0].axvline(24 / 5.885, color="0.85", lw=4, zorder=0, label="thrusters")
    for label, motion in motions.items():
        color = COLORS[label]
        frequency, along, across = power_spectra(motion)
        axes[0].loglog(frequency, along, color=color, lw=1, label=f"{label}, along roll")
        axes[0].loglog(frequency, across, color=color, lw=0.8, alpha=0.5, label=f"{label}, across")
        hours = hours_between_resets(motion)
        bins = np.arange(3, 60, 6) - 0.05
        axes[1].hist(hours, bins, density=True, histtype="step", color=color, lw=1.4)
        axes[2].plot(motion.x, motion.y, ".", color=color, ms=1.5, alpha=0.5)


def read_motions(folder, name, parameters):
    """Return the real motion, if its file is there, and the generated one."""
    motions = {}
    path = Path(folder, name)
    if path.exists():
        real = Motion.from_file(path)
        motions["real"] = real[(real.quality & UNUSABLE) == 0]
    motions["generated"] = Motion.k2_roll(**parameters)
    return motions


def make_series_figure(folder=FOLDER):
    """Return the figure of the offsets against time: one row per star."""
    figure, grid = plt.subplots(len(STARS), 2, figsize=(9, 9), layout="constrained")
    for axes, (title, star) in zip(grid, STARS.items(), strict=True):
        draw_series(axes, read_motions(folder, *star))
        axes[0].set(title=title, xlabel="Time (d)", ylabel="Offset (pixel)")
        axes[1].set(title="Four days", xlabel="Time (d)")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def make_summary_figure(folder=FOLDER):
    """Return the figure of spectra, drift lengths and tracks: one row per star."""
    figure, grid = plt.subplots(len(STARS), 3, figsize=(9, 9), layout="constrained")
    for axes, (title, star) in zip(grid, STARS.items(), strict=True):
        draw_summary(axes, read_motions(folder, *star))
        axes[0].set(title=title, xlabel="Cycles per day", ylabel="Power (pixel² d)")
        axes[1].set(title="Drift lengths", xlabel="Hours between resets", ylabel="Density")
        axes[2].set(title="Track", xlabel="x (pixel)", ylabel="y (pixel)")
        axes[2].set(aspect="equal", adjustable="datalim")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure
