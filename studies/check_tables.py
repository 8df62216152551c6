"""Compare the tables of the documentation with a new run of a fast part of each, before a release.

    python studies/check_tables.py [NAME ...] [--data FOLDER] [--limit 0.1]

Prints each number that differs by more than the limit, relative to the stored one; the exit status
is 1 if there is one. A table that differs is made again by the command in its metadata. Stars have
the seeds of the stored ones, so that the same code gives the same numbers. Of studies of rows the
first stars are computed again. The calibration of K2 and planets in real pixels have no fast part.
"""

import argparse
import importlib
import re
import subprocess
import sys
import tempfile
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table

ROOT = Path(__file__).parents[1]
DATA = ROOT / "docs" / "data"
sys.path += [str(ROOT / part) for part in ("studies", "studies/paper", "docs/data", "docs/figures")]

#: Part of each study, and the columns that name its rows.
STUDIES = {
    "breathing": ({"amplitudes": (0.01,), "periods": (1.0,)}, ("amplitude", "period")),
    "ground": ({"flats": (0.002,), "drifts": (0.03,)}, ("flat", "drift")),
    "k2_motion": ({"magnitudes": (14.0,), "detectors": ("calibrated",)}, ("detector", "mag")),
    "last-campaigns": ({"magnitudes": (12.0,), "parts": ("C18",)}, ("part", "mag")),
    "motion": ({"magnitudes": (12.0,), "scales": (5.0,), "transit_scales": (),
                "lightkurve_pld": False, "lightkurve_sff": False}, ("scale", "mag")),
    "no_motion": ({"magnitudes": (13.0,)}, ("mag",)),
    "recovery": ({"magnitudes": (12.0,), "scales": (1.0,), "depths": (200.0,)},
                 ("scale", "mag", "depth")),
    "tess": ({"magnitudes": (10.0,), "neighbors": (0,)}, ("neighbors", "mag")),
}  # fmt: skip
ROWS = {"injections": ("epic", "depth"), "population": ("number",), "rrlyrae": ("epic",)}
FAST_LAWS = ("brighter_fatter", "charge_transfer", "smear", "extinction", "seeing", "focus")
SECONDS = ("seconds",)  # differ from machine to machine


def of_study(name, _):
    """Return the stored summary of a study, a new one of a part, and what names their rows."""
    from scope_models.batch import run_sweep

    stored, (part, keys) = Table.read(DATA / f"{name}.ecsv"), STUDIES[name]
    module = importlib.import_module(name.replace("-", "_"))
    parameters = module.main.args[1]
    given = {
        field.name: tuple(value) if isinstance(value, list) else value
        for field in fields(parameters)
        for value in [stored.meta.get(field.name, field.default)]
    }
    study = parameters(**given | part)
    sweep = run_sweep(
        partial(module.measure, study), module.tasks(study), units=module.UNITS, progress=False
    )
    return stored, module.summarize(study, sweep.table), keys


def of_rows(name, data):
    """Return the stored rows of a study, those of its first two stars, and what names them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "rows.csv")
        importlib.import_module(name).main([str(data), str(path), "--stars", "2"])
        return Table.read(DATA / f"{name}.ecsv"), Table.read(path), ROWS[name]


def drop(data):
    """The amplitude of one star, ppm."""
    from drop import FILES, measured

    star, text = next(iter(FILES)), (DATA / "drop.txt").read_text(encoding="utf-8")
    new = 1e6 * measured(star, data / FILES[star])[0][0]
    values = re.search(rf"{star}: .* amplitude (\S+)", text)[1], new
    return *(Table({"star": [star], "value": [float(value)]}) for value in values), ("star",)


def fits_scenes(_):
    """Pulls of scenes of one star."""
    from store_fits import scenes

    return Table.read(DATA / "fits_scenes.ecsv"), scenes((1,)), ("stars", "parameters")


def fits_files(data):
    """The default fit of one file of K2."""
    from store_fits import fits

    paths = sorted(data.glob("k2_tpf/*.fits*"))[:1]
    return Table.read(DATA / "fits_files.ecsv"), fits(paths), ("file",)


def laws(_):
    """Laws that are measured within seconds."""
    from laws import LAWS

    with tempfile.TemporaryDirectory() as folder:
        found = {name: LAWS[name](folder)["x", "measured"] for name in FAST_LAWS}
    rows = [(name, k, *row) for name, one in found.items() for k, row in enumerate(one)]
    stored = Table.read(DATA / "laws.csv")["law", "x", "measured"]
    places = [np.count_nonzero(stored["law"][:k] == name) for k, name in enumerate(stored["law"])]
    stored.add_column(places, 1, "point")
    return stored, Table(rows=rows, names=stored.colnames), ("law", "point")


def fifty_digits(_):
    """Errors of the integrals of Gaussians."""
    from fifty_digits import gaussian_errors

    stored = Table.read(DATA / "fifty_digits.ecsv")
    new = Table(rows=[*gaussian_errors()], names=stored.colnames)
    for table in (stored, new):  # below are rounding errors
        table["error"] = np.maximum(table["error"], 1e-13)
    return stored, new, ("kind", "case", "order")


def record(_):
    """One star of the record of the correctors."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "new.ecsv")
        command = [sys.executable, ROOT / "studies" / "record.py", path, "--seeds", "2046"]
        subprocess.run([*command, "--regimes", "k2-1x-constant"], check=True, capture_output=True)
        new = Table.read(path)
    stored, keys = Table.read(DATA / "record_3cddfdb.ecsv"), ("regime", "seed", "positions")
    return stored, new[*keys, "floor", "full"], keys


CHECKS = {name: partial(of_study, name) for name in STUDIES}
CHECKS |= {name: partial(of_rows, name) for name in ROWS}
CHECKS |= {
    check.__name__: check for check in (drop, fits_scenes, fits_files, laws, fifty_digits, record)
}


def differences(stored, new, keys, limit):
    """Return how many numbers were compared, and a line for each that differs, or has no row."""
    number, lines = 0, []
    known = {tuple(row[key] for key in keys): row for row in stored}
    names = [n for n in new.colnames if n in stored.colnames and n not in {*keys, *SECONDS}]
    for row in new:
        place = tuple(row[key] for key in keys)
        text = ", ".join(f"{key} {value}" for key, value in zip(keys, place, strict=True))
        if place not in known:
            lines.append(f"{text}: no such row is stored")
            continue
        for name in names:
            old, now = known[place][name], row[name]
            form, words = (".4g", False) if new[name].dtype.kind in "if" else ("", True)
            if old != now if words else not np.isclose(now, old, limit, 0, equal_nan=True):
                lines.append(f"{text}: {name} {old:{form}} is {now:{form}} now")
        number += len(names)
    return number, lines


def main(argv=None):
    """Run the checks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help=f"of {', '.join(CHECKS)}; all by default")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--limit", type=float, default=0.1)
    options = parser.parse_args(argv)
    if unknown := set(options.names) - set(CHECKS):
        parser.error(f"no table {', '.join(sorted(unknown))}")
    wrong = 0
    for name in options.names or CHECKS:
        number, lines = differences(*CHECKS[name](options.data), options.limit)
        print(f"{name}: {number} numbers, {len(lines)} differ", flush=True)
        for line in lines:
            print(f"  {line}", flush=True)
        wrong += len(lines) > 0 or not number
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
