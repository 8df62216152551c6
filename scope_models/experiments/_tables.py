"""The tables of a study, and what their files say about where they come from."""

import json

import numpy as np
from astropy.table import MaskedColumn, Table

from scope_models._version import __version__

__all__ = ["SCALARS", "failures_table", "results_table", "study_meta"]

#: Types of the values of tasks and results.
SCALARS = (bool, int, float, str)


def study_meta(study):
    """Return where a table comes from: package, version and configuration."""
    config = study.config()
    return {"creator": f"scope_models {__version__}", "study": config.pop("study"), **config}


def results_table(study, tasks, store):
    """Return the results of all stars that did not fail, in the order of the tasks.

    Parameters
    ----------
    study : Study
        The study.
    tasks : list of dict
        All tasks.
    store : Store
        The rows.

    Returns
    -------
    astropy.table.Table
        The columns of the tasks, then those of the results. Where a star lacks a column, its
        value is masked.
    """
    columns, n_rows = {}, 0
    for task in tasks:
        if task["key"] not in store.rows:
            continue
        for name, value in (task | store.row(task["key"])).items():
            column = columns.setdefault(name, [])
            column += [None] * (n_rows - len(column))
            column.append(value)
        n_rows += 1
    table = Table({name: _column(values, n_rows) for name, values in columns.items()})
    for name, unit in study.units.items():
        if name in table.colnames:
            table[name].unit = unit
    table.meta.update(study_meta(study))
    return table


def failures_table(study, failures):
    """Return the stars that failed, each with its configuration and traceback.

    Parameters
    ----------
    study : Study
        The study.
    failures : list of dict
        "task", "error" and "traceback" of each.

    Returns
    -------
    astropy.table.Table
        Columns key, error, task (JSON) and traceback; the study's configuration is in ``meta``.
    """
    columns = {
        "key": [failure["task"]["key"] for failure in failures],
        "error": [failure["error"] for failure in failures],
        "task": [json.dumps(failure["task"]) for failure in failures],
        "traceback": [failure["traceback"] for failure in failures],
    }
    table = Table({name: np.array(values, dtype=str) for name, values in columns.items()})
    table.meta.update(study_meta(study))
    return table


def _column(values, n_rows):
    """Return values as a column; None, and what is lacking at the end, is masked."""
    values = values + [None] * (n_rows - len(values))
    missing = [value is None for value in values]
    if not any(missing):
        return np.array(values)
    filler = type(next(value for value in values if value is not None))()
    filled = [filler if value is None else value for value in values]
    return MaskedColumn(np.array(filled), mask=missing)
