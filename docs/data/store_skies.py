"""Store what a page shows of a study: ``python docs/data/store_skies.py NAME RESULTS [OPTIONS]``.

NAME is "tess", "breathing", "last-campaigns", "ground" or "recovery", RESULTS the directory of its
script in ``studies/paper``, which ran with these options. Written are, beside this file, the
summary and the tables of the page.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from _stamp import stamp
from astropy.table import Table

FOLDER = Path(__file__).parent
NOISE = {
    "aperture": "aperture",
    "wide": "wide",
    "pld": "PLD",
}
SURVIVALS = {"pld_survival": "PLD keeps"}
COLUMNS = {
    "tess": {"neighbors": "neighbors", "mag": "T", "pixels": "pixels", "share": "share"}
    | {"model": "noise model", "floor": "light alone"}
    | NOISE
    | SURVIVALS,
    "breathing": {"amplitude": "amplitude", "period": "period (d)"}
    | {f"{name}_ratio": title for name, title in NOISE.items()}
    | SURVIVALS,
    "last-campaigns": {"part": "part", "mag": "Kp", "kept": "kept", "mission": "mission"}
    | {"floor": "light alone"}
    | NOISE
    | SURVIVALS,
    "ground": {"flat": "flat", "drift": "drift (arcsec/h)", "raw": "aperture alone"}
    | {"raw_pld": "PLD alone", "differential": "differential photometry"}
    | {"differential_pld": "PLD on differential pixels", "ratio": "the same over differential"}
    | {"ratio_error": "its error", "differential_pld_survival": "depth that it keeps"}
    | {"floor": "light alone"},
}


def _cell(value):
    """Return a cell with three digits, empty where nothing was measured."""
    if isinstance(value, str):
        return value
    return "" if not np.isfinite(value) else f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def tables(name, summary):
    """Return the rows of all tables by their names."""
    columns = COLUMNS[name]
    noise = [[_cell(row[key]) for key in columns] for row in summary]
    found = {"noise": [list(columns.values()), *noise]}
    if "claims" in summary.meta:
        claims = [
            [claim, "holds" if value <= 1 else "does not hold", _cell(value)]
            for claim, value in summary.meta["claims"].items()
        ]
        found["claims"] = [["claim", "verdict", "largest value over its limit"], *claims]
    return found


def main(name, results, *options):
    """Write the tables of a study with these options."""
    summary = Table.read(Path(results, "summary.ecsv"))
    for column in summary.colnames:
        if summary[column].dtype.kind == "f":
            summary[column][:] = [float(f"{value:.5g}") for value in np.array(summary[column])]
    stamp(summary, " ".join([f"python studies/paper/{name.replace('-', '_')}.py", *options]))
    summary.write(FOLDER / f"{name}.ecsv", overwrite=True)
    for part, rows in tables(name, summary).items() if name in COLUMNS else ():
        with (FOLDER / f"{name}_{part}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
