"""Studies whose run writes a file of rows, of which tables are made; real files of several."""

import argparse
import csv
import sys
from functools import partial
from pathlib import Path

from astropy.table import Table
from paper._correctors import quiet

from scope_models.batch import read_results, run_sweep
from scope_models.cli._batch import add_workers, client_of

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / folder) for folder in ("docs/data", "studies/paper")]
from _stamp import stamp, version  # noqa: E402 - a module beside the tables

VERSIONS, UNKNOWN = "versions.txt", "unknown\n"  # of the package, and commits, that made rows
#: Real target pixel files by the name of their star.
FILES = {
    "EPIC 211956421": "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "EPIC 211983544": "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "Kepler-62": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
}


def arguments_of(text, argv, stars, **more):
    """Return the command line of a study of rows; further arguments are numbers or described."""
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("data", help="the folder of shared data")
    parser.add_argument("file", type=Path, help="rows; a folder beside it keeps finished stars")
    parser.add_argument("--table", help="beginning of the names of the tables")
    for name, value in ({"stars": stars} | more).items():
        described = value if isinstance(value, dict) else {"type": type(value), "default": value}
        parser.add_argument(f"--{name}", **described)
    add_workers(parser)
    return parser.parse_args(argv)


def sweep_rows(options, measure, number, rows_of):
    """Compute so many stars, of which finished ones are kept, and write the rows of their table.

    `measure` is a partial function of a task; its keywords but the data are the configuration.
    """
    config = {name: value for name, value in measure.keywords.items() if name != "data"}
    folder, made = options.file.with_suffix(""), options.file.with_suffix("") / VERSIONS
    versions = made.read_text("utf-8") if made.exists() else UNKNOWN * folder.is_dir()
    folder.mkdir(parents=True, exist_ok=True)
    made.write_text(f"{versions}{version()}\n", encoding="utf-8")
    result = run_sweep(
        partial(quietly, measure), [{"key": f"star{n}", "number": n} for n in range(number)],
        folder, client_of(options), name=options.file.stem, config=config,
        progress=sys.stderr.isatty(),
    )  # fmt: skip
    rows_of(result.table).write(options.file, format="ascii.csv", overwrite=True)
    return result


def quietly(measure, task):
    """Return the row of a star, without the warnings of the libraries."""
    with quiet():
        return measure(task)


def store_rows(path, target, rows_of):
    """Write the rows of a file as a table with date, versions and command; return it.

    Of an interrupted run they are those of finished stars; versions are those of all its calls.
    """
    made = path.with_suffix("") / VERSIONS
    versions = (made.read_text("utf-8") if made.exists() else UNKNOWN).splitlines()
    if path.with_suffix("").is_dir():
        table = Table(read_results(path.with_suffix("")))
        table.sort("number")
        table = rows_of(table)
    else:
        table = Table.read(path, format="ascii.csv")
    command = ["python", f"studies/{Path(sys.argv[0]).name}", *sys.argv[1:]]
    stamp(table, " ".join(command), ", ".join(dict.fromkeys(versions)))
    table.write(target, overwrite=True)
    return table


def write_csv(path, rows):
    """Write a table that a page shows."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
