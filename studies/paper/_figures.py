"""Figures of the studies: noise against magnitude, maps of a grid, statistics of motions."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import FuncFormatter, NullLocator

from scope_models.plotting._style import given_or_new, styled

MARKERS = "os^Dvp*X"
RESIDUALS = "Residual over noise"


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
        if "low" in reference:
            ax.fill_between(
                reference["mag"], reference["low"], reference["high"], color="0.85", lw=0,
                zorder=0, label=reference.get("band_label"),
            )  # fmt: skip
        ax.plot(reference["mag"], reference["median"], "k--", lw=1.3, zorder=1,
                label=reference.get("label"))  # fmt: skip
    shades = plt.get_cmap("viridis_r")(np.linspace(0.15, 1, max(len(series), 2)))
    for number, (label, values) in enumerate(series.items()):
        mag, cdpp, *bars = (np.asarray(value, dtype=float) for value in values)
        # As lists: matplotlib 3.10 takes the first element of arrays in a deprecated way.
        errors = (
            [np.maximum(d, 0).tolist() for d in (cdpp - bars[0], bars[1] - cdpp)] if bars else None
        )
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
    """Return a figure of so many panels of a size, which share what ``options`` name."""
    columns = min(columns, number)
    rows = -(-number // columns)
    options["figsize"] = size[0] + size[1] * columns, size[2] + size[3] * rows
    figure, grid = plt.subplots(rows, columns, squeeze=False, layout="constrained", **options)
    for ax in grid.flat[number:]:
        ax.remove()
    return figure, list(grid.flat[:number])


@styled
def plot_cdpp_panels(panels, reference=None, *, limits=(), residuals=None, columns=2):
    """Draw `plot_cdpp` once per title on one scale; return the Axes by their titles.

    `residuals` has for each label magnitudes and the noise that is left over that which must be
    there, for a last panel.
    """
    titles = [*panels, *([RESIDUALS] if residuals else [])]
    columns = min(columns, len(titles))
    _, drawn = make_panels(len(titles), columns, (0.7, 4.1, 0.3, 3.9), sharex=True)
    axes = dict(zip(titles, drawn, strict=True))
    first = axes[titles[0]]
    for title, series in panels.items():
        if axes[title] is not first:
            axes[title].sharey(first)
        plot_cdpp(series, reference, limits=limits, title=title, legend=False, ax=axes[title])
    handles, labels = first.get_legend_handles_labels()
    if residuals:
        ax = plot_cdpp(residuals, title=RESIDUALS, legend=False, ax=axes[RESIDUALS])
        ax.axhline(1, color="k", lw=0.8, ls="--", zorder=0)
        ax.set(yscale="linear", ylabel="CDPP / CDPP of the noise alone", ylim=(0, None))
        ax.legend(loc="lower left", fontsize="small")
        shown = [number for number, label in enumerate(labels) if label not in residuals]
        handles, labels = [handles[k] for k in shown], [labels[k] for k in shown]
        if labels:
            first.legend(handles, labels, loc="lower right", fontsize="small")
    else:
        first.figure.legend(handles, labels, loc="outside lower center", ncols=3)
    for number, title in enumerate(titles):
        lowest = number + columns >= len(titles)
        axes[title].tick_params(labelbottom=lowest)
        axes[title].xaxis.label.set_visible(lowest)
    return axes


@styled
def plot_map(
    values, rows, columns, *, row_label, column_label, label, text=".2f", span=None, title="",
    ax=None,
):  # fmt: skip
    """Draw a map with the number in each cell; the first row is the lowest, NaN stays empty.

    `text` is the format of the numbers or a function that writes them, `span` the ends of the
    colors.
    """
    values = np.asarray(values, dtype=float)
    size = 2.4 + 0.55 * len(columns), 1.6 + 0.45 * len(rows)
    ax = given_or_new(ax, *np.clip(size, 3.6, 12))
    low, high = (None, None) if span is None else span
    shown = ax.imshow(values, origin="lower", aspect="auto", cmap="viridis", vmin=low, vmax=high)
    ax.set_xticks(range(len(columns)), [f"{value:g}" for value in columns])
    ax.set_yticks(range(len(rows)), [f"{value:g}" for value in rows])
    ax.set(xlabel=column_label, ylabel=row_label, title=title)
    ax.figure.colorbar(shown, ax=ax, label=label)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            number = text(value) if callable(text) else format(value, text)
            color = "w" if shown.norm(value) < 0.55 else "k"
            ax.text(column, row, number, ha="center", va="center", fontsize="small", color=color)
    return ax


@styled
def plot_maps(maps, rows, columns, *, text, label, **labels):
    """Draw maps of one grid, by their titles, on one logarithmic scale of colors."""
    values = np.log10([np.asarray(value, dtype=float) for value in maps.values()])
    span = float(np.nanmin(values)), float(np.nanmax(values))
    figure, axes = make_panels(len(maps), 2, (9, 0, 0.4, 3.4))
    for ax, title, value in zip(axes, maps, values, strict=True):
        plot_map(
            value, rows, columns, **labels, label=f"log10 ({label.lower()})", span=span,
            title=title, ax=ax, text=lambda number: format(10**number, text),
        )  # fmt: skip
    return figure


@styled
def plot_motion_statistics(series, paper):
    """Draw "mean", "std" and "maximum" of the distance against "scale", beside the paper's."""
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), sharey=True, layout="constrained")
    shades = np.linspace(0, 0.7, max(len(series), 2))
    ticks = sorted({float(scale) for values in series.values() for scale in values["scale"]})
    titles = {"mean": "Mean", "std": "Standard deviation", "maximum": "Maximum"}
    for ax, (name, title) in zip(axes, titles.items(), strict=True):
        ax.plot(paper["scale"], paper[name], "-", color="#f08a24", lw=2, label="paper")
        for i, (label, values) in enumerate(series.items()):
            ax.plot(np.array(values["scale"]), np.array(values[name]), MARKERS[i % len(MARKERS)],
                    color=str(shades[i]), mfc="none", label=label)  # fmt: skip
        ax.set(title=title, xlabel="Factor on the motion", xscale="log", yscale="log")
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.grid(axis="y", color="0.9")
    axes[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[0].set_ylabel("Distance from the reference position (pixel)")
    axes[0].legend(fontsize="small")
    return figure


@styled
def plot_degeneracy(grids, marks):
    """Draw how well the response within and between pixels explains the noise.

    `grids` has for each part of the light in the wings a_2, the standard deviation of b, and the
    chi square; `marks` points to mark in each panel.
    """
    figure, axes = make_panels(len(grids), 3, (1, 3.4, 0.6, 3.2), sharex=True, sharey=True)
    lowest = min(np.min(cost) for _, _, cost in grids.values())
    levels = [0, 2.3, 6.2, 11.8, 20, 40, 80]
    for ax, (wings, (a_2, scatter, cost)) in zip(axes, sorted(grids.items()), strict=True):
        order = np.argsort(a_2)
        place = np.asarray(a_2)[order], 100 * np.asarray(scatter)
        excess = (np.asarray(cost) - lowest)[order].T
        shown = ax.contourf(*place, excess, levels, cmap="Blues_r", extend="max")
        ax.contour(*place, excess, levels[1:4], colors="k", linewidths=0.7)
        for marker, (label, point) in zip("*o^s", marks.items(), strict=False):
            ax.plot(point[0], 100 * point[1], marker, color="#d95f02", mec="k", ms=9, ls="none",
                    label=label, clip_on=False, zorder=5)  # fmt: skip
        ax.set_title(f"{100 * wings:.0f} % in the wings")
        ax.set(xlabel="$a_2$")
        ax.label_outer()
    for ax in axes[::3]:
        ax.set_ylabel("Standard deviation of $b$ (%)")
    axes[0].legend(fontsize="small", loc="upper left")
    figure.colorbar(shown, ax=axes, label=r"$\chi^2$ above the lowest")
    return figure
