"""One page about a run over many files: noise, outliers, warnings and failures."""

import base64
import html
import io
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
from astropy.io import fits

from scope_models._arrays import values_of, without_unit
from scope_models._values import html_table
from scope_models._version import __version__
from scope_models.batch._store import listed, read_records
from scope_models.batch.results import read_light_curve, read_results
from scope_models.io import read_pixels
from scope_models.io._opening import atomic_path
from scope_models.missions import MISSIONS

__all__ = ["write_report"]

#: Medians by magnitude, ppm, of the stars in `_SOURCES`.
_PUBLISHED = {
    "mag": [11.5, 12.5, 13.5, 14.5, 15.5, 16.5, 17.5],
    "raw, published": [212, 217, 255, 347, 744, 1534, 2752],
    "EVEREST 2": [20.9, 27.7, 42.9, 73.0, 167, 348, 664],
    "K2SFF": [26.3, 36.9, 61.2, 106, 247, 519, 985],
    "K2SC": [30.4, 39.8, 63.1, 105, 246, 490, 957],
}
_SOURCES = (
    "Medians of the unsaturated stars of K2's campaigns 3 to 6 (79,699 stars that all pipelines "
    "have), computed in the same convention from the published light curves of EVEREST 2 "
    "(AJ 156, 99), K2SFF (PASP 126, 948) and K2SC (MNRAS 459, 2408)."
)
_CONVENTION = (
    "Noise is the 6.5-h CDPP in EVEREST's convention: median of the scatter in windows of 13 "
    "cadences over the root of 13, after a Savitzky-Golay trend of 49 cadences."
)
_OUTLIERS = 8  # as many as one looks at; the table of results has all
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
h1, h2 { font-weight: 600; } img { max-width: 100%; } table { border-collapse: collapse; }
th, td { padding: .2em .8em; text-align: right; border-bottom: 1px solid #8886; }
th { text-align: left; font-weight: 400; } pre { overflow-x: auto; background: #8882; }
figure { display: inline-block; vertical-align: top; width: 48%; min-width: min(440px, 100%); }
figure { margin: 1em 0; } figure:first-of-type { width: 100%; }
figcaption, .note { opacity: 0.8; font-size: 90%; }
div { margin: .6em 0; overflow-wrap: anywhere; }
"""


def write_report(folder, output=None):
    """Write a page about a run over many files, also of one that was interrupted.

    Parameters
    ----------
    folder : str or path-like
        The ``output_dir`` of the run.
    output : str or path-like, optional
        The page, by default ``report.html`` in the folder; one that exists is replaced.

    Returns
    -------
    pathlib.Path
        The page: HTML that holds its figures. Runs of `detrend_files` have the noise against the
        magnitude, beside published medians for K2, and the stars that are noisiest for their
        magnitude, with pixels (if the file is still there), light curve, and positions and width.

    Raises
    ------
    FileNotFoundError
        If the folder holds no results.
    OSError, ValueError
        If a run is writing to the folder, the results are damaged, or the page cannot be written.

    Examples
    --------
    >>> from scope_models.batch import simulate_table, write_report
    >>> result = simulate_table({"mag": [11.0]}, "few", cadences=50, sweep={"progress": False})
    >>> write_report("few").name
    'report.html'
    """
    folder = Path(folder)
    failures = [record for record in read_records(folder) if "error" in record]
    table = read_results(folder)
    parts = [_summary(table, failures)]
    if np.isfinite(values_of(table, "cdpp_everest")).any():
        parts += [_noise(table), _outliers(folder, table)]
    rows = table if "warnings" in table.colnames else ()
    warned = [(row["key"], row["warnings"], "") for row in rows if row["warnings"]]
    failed = [(row["task"]["key"], row["error"], row["traceback"]) for row in failures]
    parts += [_causes("Failures", failed), _causes("Warnings", warned)]
    title = f"Run of {html.escape(folder.absolute().name)}"
    page = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{title}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>{''.join(parts)}</body></html>"
    )
    output = Path(output or folder / "report.html")
    with atomic_path(output, overwrite=True) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return output


def _summary(table, failures):
    rows = {"stars": len(table), "failed": len(failures)}
    raw, now = (values_of(table, name) for name in ("raw_cdpp_everest", "cdpp_everest"))
    if np.isfinite(now / raw).any():
        rows["median noise over raw"] = f"{np.nanmedian(now / raw):.2f}"
        rows["noisier than raw"] = int(np.sum(now > raw))
    if "seconds" in table.colnames:
        seconds = without_unit(table["seconds"])
        rows["processor time per file"] = f"{np.median(seconds):.2f} s"
        rows["processor time of all"] = f"{np.sum(seconds) / 3600:.2f} h"
        memory = values_of(table, "peak_memory")
        if np.isfinite(memory).any():
            rows["peak memory"] = f"{np.nanmax(memory):.0f} MiB"
    return html_table(f"scope_models {__version__}", rows)


def _noise(table):
    from scope_models.plotting.detrending import plot_precision  # imports matplotlib

    columns = {"mag": "mag", "raw_cdpp": "raw_cdpp_everest", "cdpp": "cdpp_everest"}
    stars = {name: without_unit(table[column]) for name, column in columns.items()}
    is_k2 = bool(np.any(table["mission"] == "K2"))
    figure = plot_precision(stars, _PUBLISHED if is_k2 else None, convention="EVEREST")
    note = f"{_CONVENTION} {_SOURCES}" if is_k2 else _CONVENTION
    image = _image(figure, "Noise against magnitude")
    return f'<h2>Noise</h2>{image}<p class="note">{note}</p>'


def _outliers(folder, table):
    """Return the stars with the most noise for their magnitude, each with a figure."""
    mag, noise = (without_unit(table[name]) for name in ("mag", "cdpp_everest"))
    half, excess = np.round(2 * mag), np.full(len(table), -np.inf)
    for center in np.unique(half[np.isfinite(half)]):
        near = np.isfinite(noise) & (np.abs(half - center) <= 1)
        here = near & (half == center)
        excess[here] = noise[here] / np.median(noise[near])
    parts = ["<h2>Noisiest stars for their magnitude</h2>"]
    shown = [n for n in np.argsort(-excess)[:_OUTLIERS] if excess[n] > 0]
    for n in shown:
        row = table[n]
        text = (
            f"{row['object'] or row['key']} ({row['key']}): magnitude {mag[n]:.1f}, noise "
            f"{noise[n]:.0f} ppm, {excess[n]:.1f} times the median of stars like it. "
        )
        text += row["warnings"] if "warnings" in table.colnames else ""
        parts.append(_image(_star(folder, row), text))
    return "".join(parts)


def _star(folder, row):
    from scope_models.plotting import plot_light_curve, plot_summary  # imports matplotlib

    curve = read_light_curve(folder / row["output"])
    arrays = {name: np.asarray(curve[name]) for name in curve.colnames}
    time, raw, flux = (arrays[name] for name in ("time", "raw_flux", "flux"))
    label = {"time_label": f"Time ({MISSIONS[row['mission']].time_format.upper()})"}
    try:
        image = read_pixels(row["file"]).flux[0]
    except (OSError, ValueError):
        return plot_light_curve(time, raw, flux, **label).figure
    aperture = None
    if Path(row["output"]).suffix == ".fits":
        with fits.open(folder / row["output"]) as hdus:
            aperture = hdus["APERTURE"].data & 2 > 0
    fitted = np.isfinite(arrays["pos_fit1"]).any()
    x, y = (arrays[f"{'pos_fit' if fitted else 'mom_centr'}{axis}"] for axis in (1, 2))
    axes = plot_summary(time, image, raw, x, y, corrected=flux, aperture=aperture, **label)
    return axes["image"].figure


def _causes(title, found):
    """Return a list of messages, each with the stars that have it, but for numbers and files."""
    groups = defaultdict(list)
    for key, message, trace in found:
        cause = re.sub(r"(/[^\s:'\"]+)+", "FILE", message)
        groups[re.sub(r"\d[\d.,e+-]*", "N", cause)].append((key, message, trace))
    parts = [f"<h2>{title}</h2>"] if groups else []
    for members in sorted(groups.values(), key=len, reverse=True):
        keys, (_, message, trace) = listed([key for key, *_ in members]), members[0]
        text = f"<b>{len(members)}</b> ({html.escape(keys)}): {html.escape(message)}"
        if trace:
            trace = f"<pre>{html.escape(trace)}</pre>"
            text += f"<details><summary>Traceback of the first</summary>{trace}</details>"
        parts.append(f"<div>{text}</div>")
    return "".join(parts)


def _image(figure, caption):
    from scope_models.plotting._style import save_figure

    content = io.BytesIO()
    save_figure(figure, content)
    data = base64.b64encode(content.getvalue()).decode()
    text = html.escape(caption)
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{text}">'
        f"<figcaption>{text}</figcaption></figure>"
    )
