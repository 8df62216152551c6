"""Studies with a file of rows, to which a run that goes on appends; their tables."""

import argparse
import csv
import sys
from pathlib import Path

from astropy.table import Table
from paper._correctors import quiet

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / folder) for folder in ("docs/data", "studies/paper")]
from _stamp import stamp  # noqa: E402 - a module beside the tables

#: Real target pixel files by the name of their star.
FILES = {
    "EPIC 211956421": "k2_tpf/ktwo211956421-c05_lpd-targ.fits.gz",
    "EPIC 211983544": "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz",
    "Kepler-62": "kepler_tpf/kplr009002278-2010174085026_lpd-targ.fits.gz",
}


def arguments_of(text, stars, **more):
    """Return the command line of a study of rows, with its further arguments."""
    parser = argparse.ArgumentParser(description=text.splitlines()[0])
    parser.add_argument("data", help="the folder of shared data")
    parser.add_argument("file", type=Path, help="rows, to which stars are appended")
    parser.add_argument("--stars", type=int, default=stars)
    parser.add_argument("--cadences", type=int, default=1700)
    parser.add_argument("--table", help="beginning of the names of the tables")
    for name, options in more.items():
        parser.add_argument(f"--{name}", **options)
    return parser.parse_args()


def append_rows(path, columns, tasks, measure, each=1):
    """Append the rows, `each` for a task, that `measure` returns and a file does not have yet."""
    done = (len(path.read_text().splitlines()) - 1) // each if path.exists() else 0
    if not done:
        path.write_text(",".join(columns) + "\n")
    with quiet():
        for task in list(tasks)[done:]:
            rows = "".join(",".join(map(str, row)) + "\n" for row in measure(task))
            with path.open("a") as file:
                file.write(rows)


def store_rows(path, target):
    """Write the rows of a file as a table with date, version and command; return it."""
    table = Table.read(path, format="ascii.csv")
    stamp(table, " ".join(["python", f"studies/{Path(sys.argv[0]).name}", *sys.argv[1:]]))
    table.write(target, overwrite=True)
    return table


def write_csv(path, rows):
    """Write a table that a page shows."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
