"""Figures of the studies: noise against magnitude, maps of a grid, the calibration of K2."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patheffects import Normal, Stroke

from scope_models.plotting._style import given_or_new, styled

MARKERS = "os^Dvp*X"


@styled
def plot_cdpp(series, reference=None, *, limits=(), title="", legend=True, ax=None):
    """Draw the noise of stars against their magnitude, over that of real ones; return the Axes.

    `series` has for each label magnitudes and CDPP in ppm and, if wanted, lower and upper ends of
    bars; the first is drawn lightest. `reference` has "mag" and "median" and, if wanted, "low" and
    "high", a band, "label" and "band_label". `limits` are faintest magnitude, ppm and text of
    lines.
    """
    ax = given_or_new(ax, 5.6, 4.6)
    if reference is not None:
        mag, label = reference["mag"], reference.get("label")
        if "low" in reference:
            band = {"color": "0.85", "lw": 0, "zorder": 0, "label": reference.get("band_label")}
            ax.fill_between(mag, reference["low"], reference["high"], **band)
        ax.plot(mag, reference["median"], "k--", lw=1.3, zorder=1, label=label)
    shades = plt.get_cmap("viridis_r")(np.linspace(0.15, 1, max(len(series), 2)))
    for number, (label, values) in enumerate(series.items()):
        mag, cdpp, *bars = (np.asarray(value, dtype=float) for value in values)
        # As lists: matplotlib 3.10 takes the first element of arrays in a deprecated way.
        errors = np.maximum([cdpp - bars[0], bars[1] - cdpp], 0).tolist() if bars else None
        ax.errorbar(
            mag, cdpp, errors, color=shades[number], marker=MARKERS[number % len(MARKERS)],
            ms=4.5, mec="k", mew=0.4, lw=1.1, elinewidth=0.8, capsize=2, label=label,
        )  # fmt: skip
    for faintest, ppm, text in limits:
        brightest = min(ax.dataLim.x0, faintest)
        ax.plot([brightest, faintest], [ppm, ppm], color="0.35", lw=0.9, ls=":")
        ax.plot(faintest, ppm, marker="|", color="0.35", ms=8)
        note = ax.annotate(text, (brightest, ppm), (0, 2), textcoords="offset points",
                           fontsize="x-small", color="0.2")  # fmt: skip
        note.set_path_effects([Stroke(linewidth=2, foreground="w"), Normal()])
    ax.set(yscale="log", xlabel="Magnitude (Kp)", ylabel="6.5-h CDPP (ppm)", title=title)
    if legend:
        ax.legend(fontsize="small")
    return ax


def make_panels(number, columns, size, **options):
    """Return a figure and its panels; `size`: widths of margin and panel, heights of both (in)."""
    columns = min(columns, number)
    rows = -(-number // columns)
    options["figsize"] = size[0] + size[1] * columns, size[2] + size[3] * rows
    figure, grid = plt.subplots(rows, columns, squeeze=False, layout="constrained", **options)
    for ax in grid.flat[number:]:
        ax.remove()
    return figure, list(grid.flat[:number])


@styled
def plot_cdpp_panels(panels, reference=None, *, limits=(), residuals=None):
    """Draw `plot_cdpp` once per title on one scale; return the figure.

    `residuals` has for each label of the panels magnitudes and the noise that is left over that
    which must be there, for a last panel.
    """
    number = len(panels) + bool(residuals)
    figure, axes = make_panels(number, 2, (0.7, 4.1, 0.3, 3.9), sharex=True)
    for ax, (title, series) in zip(axes, panels.items(), strict=False):
        if ax is not axes[0]:
            ax.sharey(axes[0])
        plot_cdpp(series, reference, limits=limits, title=title, legend=False, ax=ax)
    if residuals:
        ax = plot_cdpp(residuals, title="Residual over noise", legend=False, ax=axes[-1])
        ax.axhline(1, color="k", lw=0.8, ls="--", zorder=0)
        ax.set(yscale="linear", ylabel="CDPP / CDPP of the noise alone", ylim=(0, None))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    for place, ax in enumerate(axes):
        lowest = place + 2 >= number
        ax.tick_params(labelbottom=lowest)
        ax.xaxis.label.set_visible(lowest)
    return figure


@styled
def plot_map(table, name, rows, columns, *, label, text=".2f", norm=None, title="", ax=None):
    """Draw a column of a table as a map over two others, with the number in each cell.

    `rows` and `columns` are names and labels of the others; the lowest value is the lowest row.
    Cells that the table has not and NaN stay empty. `norm` scales the colors.
    """
    (y, i), (x, j) = (np.unique(table[key], return_inverse=True) for key, _ in (rows, columns))
    values = np.full((len(y), len(x)), np.nan)
    values[i, j] = table[name]
    ax = given_or_new(ax, *np.clip((2.4 + 0.55 * len(x), 1.6 + 0.45 * len(y)), 3.6, 12))
    shown = ax.imshow(values, origin="lower", aspect="auto", cmap="viridis", norm=norm)
    ax.set_xticks(range(len(x)), [f"{value:g}" for value in x])
    ax.set_yticks(range(len(y)), [f"{value:g}" for value in y])
    ax.set(xlabel=columns[1], ylabel=rows[1], title=title)
    ax.figure.colorbar(shown, ax=ax, label=label)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            color = "w" if shown.norm(value) < 0.55 else "k"
            ax.text(column, row, format(value, text), ha="center", va="center", fontsize="small",
                    color=color)  # fmt: skip
    return ax


@styled
def plot_maps(table, names, rows, columns, **options):
    """Draw maps of columns, by their titles, on one logarithmic scale of colors."""
    figure, axes = make_panels(len(names), 2, (9, 0, 0.4, 3.4))
    values = [table[name] for name in names.values()]
    for ax, (title, name) in zip(axes, names.items(), strict=True):
        norm = LogNorm(np.nanmin(values), np.nanmax(values))
        plot_map(table, name, rows, columns, norm=norm, title=title, ax=ax, **options)
    return figure


@styled
def plot_degeneracy(table, marks):
    """Draw how well the response within and between pixels explains the noise.

    `table` is that of ``calibrate_k2_motion.py``, `marks` are points to mark by their labels.
    """
    wings, lowest = np.unique(table["wings"]), np.min(table["cost"])
    figure, axes = make_panels(len(wings), 3, (1, 3.4, 0.6, 3.2), sharex=True, sharey=True)
    levels = [0, 2.3, 6.2, 11.8, 20, 40, 80]
    for ax, part in zip(axes, wings, strict=True):
        rows = table[table["wings"] == part]
        cost = rows["a_2"], 100 * rows["scatter"], rows["cost"] - lowest
        shown = ax.tricontourf(*cost, levels, cmap="Blues_r", extend="max")
        ax.tricontour(*cost, levels[1:4], colors="k", linewidths=0.7)
        for marker, (label, point) in zip("*o^s", marks.items(), strict=False):
            ax.plot(point[0], 100 * point[1], marker, color="#d95f02", mec="k", ms=9, ls="none",
                    label=label, clip_on=False, zorder=5)  # fmt: skip
        ax.set(title=f"{100 * part:.0f} % in the wings", xlabel="$a_2$",
               ylabel="Standard deviation of $b$ (%)")  # fmt: skip
        ax.label_outer()
    axes[0].legend(fontsize="small", loc="upper left")
    figure.colorbar(shown, ax=axes, label=r"$\chi^2$ above the lowest")
    return figure
