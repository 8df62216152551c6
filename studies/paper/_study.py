"""What the studies share: their command line, cells and medians of tables."""

import argparse
import dataclasses
import itertools
import string
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import Table

from scope_models._arrays import values_of
from scope_models.batch import SweepError, run_sweep
from scope_models.cli._batch import add_workers, client_of, with_config

parameters = dataclasses.dataclass(frozen=True, kw_only=True)


def study_of(name, parameters, tasks, measure, summarize=None, draw=None, units=None):
    """Return a function that runs a study with a command line, and prints where its results are.

    `parameters` is a dataclass; all functions get it first; `tasks` returns the stars, `measure` a
    row of one, `summarize` the summary of the table, and `draw` the figure of table and summary.
    """
    return partial(_run, name, parameters, tasks, measure, summarize, draw, units)


def _run(name, parameters, tasks, measure, summarize, draw, units, argv=None):
    warnings.filterwarnings("ignore", ".*tpfmodel submodule is not available", UserWarning)
    parser = argparse.ArgumentParser(prog=f"{Path(sys.argv[0]).name}", description=f"Study {name}.")
    parser.add_argument("--directory", default=name, metavar="DIR", help=f"results ({name})")
    parser.add_argument("--config", metavar="FILE", help="a TOML file with options")
    add_workers(parser)
    items = dataclasses.fields(parameters)
    for item in items:
        many = isinstance(item.default, tuple)
        one = item.default[:1] if many else (item.default,)
        options = {"type": type(*one) if one else str, "default": item.default}
        if many:
            options["nargs"] = "*"
        elif isinstance(item.default, bool):
            options = {"action": argparse.BooleanOptionalAction, "default": item.default}
        parser.add_argument(f"--{item.name.replace('_', '-')}", **options, help="%(default)s")
    try:
        given = parser.parse_args(with_config(["", *(sys.argv[1:] if argv is None else argv)])[1:])
        values = {item.name: getattr(given, item.name) for item in items}
        values = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        study = parameters(**values)
        texts = itertools.chain(*(v if isinstance(v, tuple) else [v] for v in values.values()))
        result = run_sweep(
            partial(measure, study), tasks(study), given.directory, client_of(given), name=name,
            config=study, units=units, summarize=summarize and partial(summarize, study),
            draw=draw and partial(draw, study), progress=sys.stderr.isatty(),
            inputs=[text for text in texts if isinstance(text, str) and Path(text).is_file()],
        )  # fmt: skip
    except (OSError, SweepError, TypeError, ValueError) as error:
        parser.error(str(error))
    print(f"{name}: {len(result.table)} stars, {len(result.failures)} failed")
    for file in result.files:
        print(file)
    return result


def grid(key, **columns):
    """Return the function of parameters that returns a task per cell, the first column outermost.

    The key is a format string, whose columns the tasks have in its order. Each column is named
    after the parameter that holds its values; an integer stands for as many numbers from 0.
    """
    names = [name for _, name, *_ in string.Formatter().parse(key) if name]

    def tasks(study):
        values = [getattr(study, name) for name in columns.values()]
        values = [range(v) if isinstance(v, int) else v for v in values]
        found = []
        for row in itertools.product(*values):
            task = dict(zip(columns, row, strict=True))
            text = key.format(**task).lower().replace(" ", "-")
            found.append({"key": text} | {name: task[name] for name in names})
        return found

    return tasks


def cells(table, names):
    """Yield each combination of values of columns that there is, sorted, with its rows."""
    for part in table.group_by(list(names)).groups:
        yield {name: part[name][0] for name in names}, part


def medians(table, cell, columns, spread=()):
    """Return a table of the medians of columns in each cell, with units.

    Columns of `spread` have the 16th and 84th percentiles beside them, "_low" and "_high".
    """
    rows = []
    for row, part in cells(table, cell):
        rows.append(row | {"stars": len(part)})
        for name in columns:
            low, rows[-1][name], high = percentiles(values_of(part, name))
            if name in spread:
                rows[-1] |= {f"{name}_low": low, f"{name}_high": high}
    return Table(rows, units={name: table[name].unit for name in columns})


def percentiles(values):
    """Return the 16th, 50th and 84th percentile of the values that are finite, or NaN."""
    good = values[np.isfinite(values)]
    return np.percentile(good if len(good) else [np.nan], [16, 50, 84]).tolist()


def largest(claims):
    """Return the largest of the values over their limit of each claim, at most 1 where it holds."""
    return {"claims": {name: float(np.max(values, initial=0)) for name, values in claims.items()}}
