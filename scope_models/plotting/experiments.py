"""Figures of the experiments: noise against magnitude, and maps of a grid."""

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patheffects import Normal, Stroke

from scope_models._arrays import plain_array
from scope_models.plotting._style import given_or_new, make_panels, styled

__all__ = ["plot_cdpp", "plot_cdpp_panels", "plot_map"]

_MARKERS = "os^Dvp*X"
_RESIDUALS = "Residual over noise"


@styled
def plot_cdpp(series, reference=None, *, limits=(), title="", legend=True, ax=None):
    """
    Draw the noise of stars against their magnitude, over that of real ones.

    Parameters
    ----------
    series : mapping of str to sequence of array_like
        For each label magnitudes ``(n,)`` and CDPP ``(n,)`` in ppm, and, if wanted, the lower and
        upper ends ``(n,)`` of bars. The first series is drawn lightest.
    reference : mapping, optional
        Real stars: "mag", "median", and, if wanted, "low" and "high" ``(n,)`` in ppm, which are
        drawn as a band, and "label" and "band_label" for the legend.
    limits : sequence of tuple, optional
        ``(faintest magnitude, ppm, text)`` of each limit, drawn as a line that ends there.
    title : str, optional
        Title of the Axes.
    legend : bool, optional
        Whether to draw the legend.
    {draw}

    Examples
    --------
    >>> from scope_models.plotting import plot_cdpp
    >>> kepler = {"mag": [12, 13], "median": [25.6, 34.3], "label": "Kepler, median"}
    >>> ax = plot_cdpp({"1x": ([12, 13], [17, 28])}, kepler)
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['Kepler, median', '1x']
    """
    ax = given_or_new(ax, 5.6, 4.6)
    if reference is not None:
        _draw_reference(ax, reference)
    shades = plt.get_cmap("viridis_r")(np.linspace(0.15, 1, max(len(series), 2)))
    for number, (label, values) in enumerate(series.items()):
        mag, *noise = values
        mag = plain_array(mag, u.mag, "series")
        cdpp, *bars = (plain_array(value, u.Unit(1e-6), "series") for value in noise)
        errors = None
        if bars:
            # As lists: matplotlib 3.10 takes the first element of arrays in a deprecated way.
            errors = [
                np.maximum(cdpp - bars[0], 0).tolist(),
                np.maximum(bars[1] - cdpp, 0).tolist(),
            ]
        ax.errorbar(
            mag, cdpp, errors, color=shades[number], marker=_MARKERS[number % len(_MARKERS)],
            ms=4.5, mec="k", mew=0.4, lw=1.1, elinewidth=0.8, capsize=2, label=label,
        )  # fmt: skip
    for faintest, ppm, text in limits:
        _draw_limit(ax, faintest, ppm, text)
    ax.set(yscale="log", xlabel="Magnitude (Kp)", ylabel="6.5-h CDPP (ppm)", title=title)
    if legend:
        ax.legend(fontsize="small")
    return ax


def _draw_reference(ax, reference):
    mag = np.asarray(reference["mag"], dtype=float)
    if "low" in reference:
        ax.fill_between(
            mag, reference["low"], reference["high"], color="0.85", lw=0, zorder=0,
            label=reference.get("band_label"),
        )  # fmt: skip
    ax.plot(mag, reference["median"], "k--", lw=1.3, zorder=1, label=reference.get("label"))


def _draw_limit(ax, faintest, ppm, text):
    """Draw a line at a limit as far as it holds, in the units of the magnitudes."""
    brightest = min(ax.dataLim.x0, faintest)
    ax.plot([brightest, faintest], [ppm, ppm], color="0.35", lw=0.9, ls=":")
    ax.plot(faintest, ppm, marker="|", color="0.35", ms=8)
    note = ax.annotate(
        text, (brightest, ppm), (0, 2), textcoords="offset points", fontsize="x-small", color="0.2"
    )
    note.set_path_effects([Stroke(linewidth=2, foreground="w"), Normal()])


@styled
def plot_cdpp_panels(panels, reference=None, *, limits=(), residuals=None, columns=2):
    """
    Draw the noise against magnitude once per corrector, on one scale.

    Parameters
    ----------
    panels : mapping of str to mapping
        For each title the series of a panel, see `plot_cdpp`.
    reference : mapping, optional
        Real stars, see `plot_cdpp`.
    limits : sequence of tuple, optional
        Limits to draw into each panel, see `plot_cdpp`.
    residuals : mapping of str to sequence of array_like, optional
        For each label magnitudes ``(n,)`` and the ratio ``(n,)`` of the noise that is left to that
        which must be there, drawn in a last panel.
    columns : int, optional
        Panels side by side.

    Returns
    -------
    dict of str to `~matplotlib.axes.Axes`
        The panels by their titles; that of the residuals is "Residual over noise".

    Examples
    --------
    >>> from scope_models.plotting import plot_cdpp_panels
    >>> curve = {"1x": ([12, 13], [17, 28])}
    >>> axes = plot_cdpp_panels({"PLD": curve, "SFF": curve}, residuals={"1x": ([12, 13], [1, 1])})
    >>> list(axes)
    ['PLD', 'SFF', 'Residual over noise']
    """
    titles = [*panels, *([_RESIDUALS] if residuals else [])]
    columns = min(columns, len(titles))
    _, grid = make_panels(len(titles), columns, (0.7, 4.1, 0.3, 3.9), sharex=True)
    axes = dict(zip(titles, grid, strict=True))
    first = axes[titles[0]]
    for title, series in panels.items():
        if axes[title] is not first:
            axes[title].sharey(first)
        plot_cdpp(series, reference, limits=limits, title=title, legend=False, ax=axes[title])
    handles, labels = first.get_legend_handles_labels()
    if residuals:
        ax = plot_cdpp(residuals, title=_RESIDUALS, legend=False, ax=axes[_RESIDUALS])
        ax.axhline(1, color="k", lw=0.8, ls="--", zorder=0)
        ax.set(yscale="linear", ylabel="CDPP over that of the noise", ylim=(0, None))
        ax.legend(loc="lower left", fontsize="small")
        shown = [number for number, label in enumerate(labels) if label not in residuals]
        handles, labels = [handles[k] for k in shown], [labels[k] for k in shown]
    if labels:
        first.legend(handles, labels, loc="lower right", fontsize="small")
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
    """
    Draw a map of a grid, with the number in each cell.

    Parameters
    ----------
    values : array_like
        Values ``(n_rows, n_columns)``; cells that are NaN stay empty.
    rows, columns : array_like
        What belongs to each row and column; the first row is the lowest.
    row_label, column_label, label : str
        Labels, with units, of the axes and of the colors.
    text : str or callable, optional
        Format of the numbers in the cells, or a function that writes them; "" leaves them out.
    span : tuple of float, optional
        Ends of the colors; by default those of the values.
    title : str, optional
        Title of the Axes.
    {draw}

    Raises
    ------
    ValueError
        If there is not one value per row and column.

    Examples
    --------
    >>> from scope_models.plotting import plot_map
    >>> ax = plot_map(
    ...     [[1.0, 0.5]], [100], [12, 13], row_label="Depth (ppm)", column_label="Kp",
    ...     label="Completeness",
    ... )
    >>> [text.get_text() for text in ax.texts]
    ['1.00', '0.50']
    """
    values = np.asarray(values, dtype=float)
    if values.shape != (len(rows), len(columns)):
        raise ValueError(
            f"`values` must have shape {(len(rows), len(columns))}, got {values.shape}"
        )
    size = 2.4 + 0.55 * len(columns), 1.6 + 0.45 * len(rows)
    ax = given_or_new(ax, *np.clip(size, 3.6, 12))
    low, high = (None, None) if span is None else span
    shown = ax.imshow(values, origin="lower", aspect="auto", cmap="viridis", vmin=low, vmax=high)
    ax.set_xticks(range(len(columns)), [f"{value:g}" for value in columns])
    ax.set_yticks(range(len(rows)), [f"{value:g}" for value in rows])
    ax.set(xlabel=column_label, ylabel=row_label, title=title)
    ax.figure.colorbar(shown, ax=ax, label=label)
    for (row, column), value in np.ndenumerate(values):
        if text and np.isfinite(value):
            number = text(value) if callable(text) else format(value, text)
            color = "w" if shown.norm(value) < 0.55 else "k"
            ax.text(column, row, number, ha="center", va="center", fontsize="small", color=color)
    return ax
