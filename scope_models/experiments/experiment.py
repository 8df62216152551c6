"""Runs a study from its configuration to its tables and its figure."""

import json
from dataclasses import dataclass
from pathlib import Path

from astropy.table import Table
from astropy.utils.decorators import deprecated_renamed_argument

from scope_models._values import Value
from scope_models.experiments._store import provenance
from scope_models.experiments.config import make_study
from scope_models.experiments.study import Study
from scope_models.experiments.sweep import SweepError, run_sweep
from scope_models.io._atomic import atomic_path

__all__ = ["ExperimentResult", "run_experiment"]


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentResult(Value):
    """Result of an experiment, and the files that it has written.

    Attributes
    ----------
    table : astropy.table.Table
        One row per star that did not fail, ``results.ecsv``.
    summary : astropy.table.Table
        The summary, ``summary.ecsv``.
    failures : astropy.table.Table
        One row per star that failed, ``failures.ecsv``, which is there only if one did; its
        tracebacks are JSON.
    files : tuple of pathlib.Path
        The tables and ``figure.png``.

    Examples
    --------
    >>> from scope_models.experiments import run_experiment
    >>> result = run_experiment("table1", "results", progress=False)
    >>> [file.name for file in result.files]
    ['results.ecsv', 'summary.ecsv', 'figure.png']
    """

    table: Table
    summary: Table
    failures: Table
    files: tuple[Path, ...]


@deprecated_renamed_argument("executor", "client", "0.2")
def run_experiment(study, directory, client=None, **options):
    """Run a study, and write its tables and its figure.

    Parameters
    ----------
    study : Study or str
        The study, or the name of one that runs with its defaults.
    directory : str or path-like
        The folder for the results. It is made if it is not there.
    client : distributed.Client, str, int or concurrent.futures.Executor, optional
        What computes the stars: see `run_sweep`.
    **options
        Those of `run_sweep`: write_tpfs, retry_failed, progress, chunk_size and in_flight.

    Returns
    -------
    ExperimentResult
        The tables and the files.

    Raises
    ------
    SweepError
        If all stars fail.
    TypeError, ValueError, OSError
        As `run_sweep` does.

    Examples
    --------
    >>> from scope_models.experiments import run_experiment
    >>> result = run_experiment("table1", "results", progress=False)
    >>> len(result.table)
    4
    """
    if isinstance(study, str):
        study = make_study(study)
    if not isinstance(study, Study):
        raise TypeError(f"`study` must be a Study or the name of one, got {study!r}")
    from scope_models.plotting._style import save_figure  # imports matplotlib

    folder = Path(directory)
    sweep = run_sweep(study, folder, client, **options)
    failed = folder / "failures.ecsv"
    if len(sweep.failures):
        failures = sweep.failures.copy()
        # ECSV takes the blanks off the beginnings of the lines of a text
        failures["traceback"] = [json.dumps(text) for text in failures["traceback"]]
        _write(failures, failed)
    else:
        failed.unlink(missing_ok=True)
    files = [_write(sweep.table, folder / "results.ecsv")]
    if not len(sweep.table):
        raise SweepError(
            f"all {len(sweep.failures)} stars failed, the first one with "
            f"{sweep.failures['error'][0]}; see {failed}"
        )
    summary = study.summarize(sweep.table)
    summary.meta = provenance(study) | summary.meta
    files.append(_write(summary, folder / "summary.ecsv"))
    if (figure := study.draw(sweep.table, summary)) is not None:
        files.append(folder / "figure.png")
        with atomic_path(files[-1], overwrite=True) as temporary:
            save_figure(figure, temporary)
    if len(sweep.failures):
        files.append(failed)
    return ExperimentResult(sweep.table, summary, sweep.failures, tuple(files))


def _write(table, path):
    """Write a table in one step and return its path."""
    with atomic_path(path, overwrite=True) as temporary:
        table.write(temporary, format="ascii.ecsv")
    return path
