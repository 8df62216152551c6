"""Rows of a study in a file to which a run that goes on appends, and their stored table."""

import sys
from pathlib import Path

from astropy.table import Table

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / folder) for folder in ("docs/data", "studies/paper")]
from _stamp import stamp  # noqa: E402 - a module beside the tables

__all__ = ["append_rows", "store_rows"]


def append_rows(path, columns, tasks, measure, each=1):
    """Append the rows, `each` for a task, that `measure` returns and a file does not have yet."""
    done = (len(path.read_text().splitlines()) - 1) // each if path.exists() else 0
    if not done:
        path.write_text(",".join(columns) + "\n")
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
