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
RECORD = "record_19e5c3d.ecsv"


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


def write_scores(source, folder):
    """Write the medians of each regime of a record, and the summary of its stars."""
    from record import whole

    table = Table.read(source)
    table = table[table["positions"] == "wrong"]
    with (folder / "scores_regimes.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["regime", "stars", *COLUMNS.values()])
        for regime in dict.fromkeys(table["regime"]):
            rows = table[table["regime"] == regime]
            cells = [_median(np.asarray(rows[name], float)) for name in COLUMNS]
            writer.writerow([regime + " *" * bool(rows["apart"][0]), len(rows), *cells])
    with (folder / "scores_all.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["number", "value"])
        writer.writerows((text, f"{value:.3g}") for text, value in whole(table).items())


def _median(values):
    """Return the median of the finite values with three digits, nothing if there are none."""
    values = values[np.isfinite(values)]
    return f"{np.median(values):.3g}" if len(values) else ""


def _write(app):
    folder = Path(app.srcdir) / "_generated"
    folder.mkdir(exist_ok=True)
    write_scores(Path(app.srcdir) / "data" / RECORD, folder)
    constants.write(folder / "constants.csv")


def setup(app):
    """Connect the tables to the build."""
    app.add_directive("made", Made)
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
