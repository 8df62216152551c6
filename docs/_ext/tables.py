"""Tables of measurements: their origin in one line, and the scores of the correctors."""

import csv
from pathlib import Path

import constants
import numpy as np
from astropy.table import Table
from docutils import nodes
from docutils.parsers.rst import Directive

COLUMNS = {
    "raw_full": "raw",
    "full": "corrected",
    "high_passed": "high-passed",
    "pull": "pull",
    "amplitude": "amplitude",
    "depth_kept": "depth",
}
BEFORE = {"corrected": "full", "high-passed": "high_passed", "pull": "pull"}
RECORD, FIRST = "record_3cddfdb.ecsv", "record_19e5c3d.ecsv"
# Columns of stored tables that pages show, with their titles.
SHOWN = {
    "fits_scenes": None,
    "fits_files": None,
    "fits_fluxes": None,
    "motion_files": None,
    "recovery": None,
    "no_motion": {
        "mag": "Kp",
        "detector_p10_ratio": "10th percentile, detector over Kepler",
        "star_p10_ratio": "10th percentile, star over Kepler",
        "star_median_ratio": "median, star over Kepler",
        "photon": "photons (ppm)",
        "background": "background (ppm)",
        "read": "reads (ppm)",
        "n_pixels": "pixels",
    },
    "k2_calibration": {
        "wings": "light in the wings",
        "a_2": "a_2",
        "scatter": "standard deviation of b",
        "threshold": "T",
        "part": "p",
        "cost": "chi-squared",
        "worst_median": "medians within",
    },
}


class Made(Directive):
    """The date, version and command of a table: ``.. made:: data/NAME.ecsv``."""

    required_arguments = 1

    def run(self):
        """Return the line."""
        environment = self.state.document.settings.env
        _, path = environment.relfn2path(self.arguments[0])
        environment.note_dependency(path)
        meta = Table.read(path).meta
        line = nodes.paragraph(classes=["made"])
        line += nodes.Text(f"Made on {meta['date']} with version {meta['version']} by ")
        line += nodes.literal(text=meta["command"])
        line += nodes.Text(".")
        return [line]


def write_scores(source, first, folder):
    """Write the medians of each regime of a record, and its summary, beside those of another one.

    The other one counts where it has the same stars.
    """
    from record import KEY, whole

    table, other = Table.read(source), Table.read(first)
    table = table[table["positions"] == "wrong"]
    stars = set(zip(*(table[name] for name in KEY), strict=True))
    other = other[[row in stars for row in zip(*(other[name] for name in KEY), strict=True)]]
    with (folder / "scores_regimes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["regime", "stars", *COLUMNS.values(), *(f"{c} before" for c in BEFORE)])
        for regime in dict.fromkeys(table["regime"]):
            rows = table[table["regime"] == regime]
            cells = [_median(np.asarray(rows[name], float)) for name in COLUMNS]
            rows = other[other["regime"] == regime]
            cells += [_median(np.asarray(rows[name], float)) for name in BEFORE.values()]
            writer.writerow([regime + " *" * bool(rows["apart"][0]), len(rows), *cells])
    with (folder / "scores_all.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["number", "value", "before"])
        before = whole(other)
        writer.writerows(
            (text, f"{value:.3g}", f"{before[text]:.3g}") for text, value in whole(table).items()
        )


def write_stored(source, folder):
    """Write the columns of a stored table that a page shows."""
    table, columns = Table.read(source), SHOWN[source.stem]
    if source.stem == "k2_calibration":  # the lowest point for each kind of wings
        parts = [table[table["wings"] == wings] for wings in np.unique(table["wings"])]
        table = Table(rows=[part[np.argmin(part["cost"])] for part in parts])
    if source.stem == "motion_files":  # a column per file
        names = [name for name in table.colnames if name != "file"]
        turned = {row["file"][4:13]: [row[name] for name in names] for row in table}
        table = Table({"quantity": names} | turned)
    if source.stem == "recovery":  # a column per multiple of the motion
        motions = table.meta["by_motion"]
        names = list(next(iter(motions.values())))
        turned = {name: [values.get(key, "") for key in names] for name, values in motions.items()}
        table = Table({"motion": [name.replace("_", " ") for name in names]} | turned)
    columns = columns or dict(zip(table.colnames, table.colnames, strict=True))
    with (folder / f"{source.stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns.values())
        for row in table:
            cells = [row[name] for name in columns]
            writer.writerow(f"{c:.4g}" if isinstance(c, (float, np.floating)) else c for c in cells)


def _median(values):
    """Return the median of the finite values with three digits, nothing if there are none."""
    values = values[np.isfinite(values)]
    return f"{np.median(values):.3g}" if len(values) else ""


def _write(app):
    folder = Path(app.srcdir) / "_generated"
    folder.mkdir(exist_ok=True)
    data = Path(app.srcdir) / "data"
    write_scores(data / RECORD, data / FIRST, folder)
    for name in SHOWN:
        write_stored(data / f"{name}.ecsv", folder)
    constants.write(folder / "constants.csv")


def setup(app):
    """Connect the tables to the build."""
    app.add_directive("made", Made)
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
