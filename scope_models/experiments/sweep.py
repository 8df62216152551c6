"""Computes the stars of a study: one after the other, or many at a time, here or elsewhere."""

import traceback
import warnings
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from numbers import Integral
from pathlib import Path

from astropy.table import Table
from tqdm import tqdm

from scope_models._checks import checked_integer
from scope_models.exceptions import FailedStarsWarning
from scope_models.experiments._store import Store
from scope_models.experiments._tables import failures_table, results_table
from scope_models.experiments._workers import (
    Job,
    PixelsNotWrittenError,
    WorkersDieError,
    checked_tasks,
    completed,
    cut,
    failure,
    in_processes,
    one_thread,
    tpf_path,
)
from scope_models.experiments.study import Study

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
        One row per star that failed: key, error, task and traceback.
    n_computed : int
        Stars that this call has computed; the others were there.
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
    n_computed: int
    directory: Path | None


def run_sweep(
    config,
    executor=None,
    directory=None,
    *,
    write_tpfs=False,
    retry_failed=True,
    progress=True,
    chunk_size=1,
    in_flight=256,
):
    """Compute all stars of a study.

    The result of a star depends on the study and the star alone, not on the order, the executor,
    the number of workers or the cuts between calls.

    Parameters
    ----------
    config : Study
        The study, which is its own configuration.
    executor : concurrent.futures.Executor or int, optional
        What computes the stars: None is this process, a number that many processes, each with
        one thread for linear algebra. Executors are also those of Dask,
        ``distributed.Client(...).get_executor()``, and of mpi4py. They are left open.
    directory : str or path-like, optional
        Results directory. Each star that is finished is kept there, so that the same call goes on
        where an earlier one stopped, however it ended. Without one, results are in memory only.
    write_tpfs : bool, optional
        Whether to write the pixels of each star as ``tpfs/*/KEY.fits`` in the directory, which
        the workers must share.
    retry_failed : bool, optional
        Whether stars that failed in an earlier call are tried again.
    progress : bool, optional
        Whether to show a progress bar on the standard error.
    chunk_size : int, optional
        Stars that a worker gets at a time; more than one saves time if a star takes less than
        some milliseconds.
    in_flight : int, optional
        Chunks that are given to an executor and not finished, at most; at least twice the number
        of its workers. Processes of our own have two each.

    Returns
    -------
    SweepResult
        The tables.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If the study has no stars, or no pixels to write, or if the directory was made with
        another configuration.
    OSError
        If the directory cannot be written to, or the disk is full. Stars that are finished
        are kept.
    SweepError
        If the executor breaks because a worker process died, or processes cannot be begun.

    Warns
    -----
    FailedStarsWarning
        If stars have failed; the others go on.
    DamagedResultWarning
        If results of an earlier call are damaged; they are computed again.

    Examples
    --------
    >>> from scope_models.experiments import make_study, run_sweep
    >>> study = make_study("table1", {"scales": [1, 10]})
    >>> result = run_sweep(study, directory="results", progress=False)
    >>> result.table["maximum"].round(2).tolist(), result.n_computed
    ([0.59, 5.95], 2)
    >>> run_sweep(study, directory="results", progress=False).n_computed
    0
    """
    chunk_size = checked_integer("chunk_size", chunk_size, 1)
    in_flight = checked_integer("in_flight", in_flight, 1)
    directory = None if directory is None else Path(directory).absolute()
    job = _checked_job(config, executor, directory, write_tpfs=write_tpfs)
    tasks = checked_tasks(config)
    store = Store(directory)
    store.begin(config)
    store.load(tasks)
    missing = _missing(tasks, store, job, retry_failed=retry_failed)
    if missing:
        records = _records(executor, job, cut(missing, chunk_size), in_flight)
        bar = tqdm(total=len(tasks), initial=len(tasks) - len(missing), desc=config.name,
                   unit="star", smoothing=0.05, disable=not progress)  # fmt: skip
        with closing(store), one_thread(), bar, closing(records):
            store.open()
            _keep(records, store, bar)
    failures = [store.failures[task["key"]] for task in tasks if task["key"] in store.failures]
    _warn_of(failures)
    table = results_table(config, tasks, store)
    return SweepResult(table, failures_table(config, failures), len(missing), directory)


def _checked_job(study, executor, directory, *, write_tpfs):
    """Return what computes stars, after a check of the arguments."""
    if not isinstance(study, Study):
        raise TypeError(f"`config` must be a Study, got {study!r}")
    if isinstance(executor, Integral) and not isinstance(executor, bool):
        checked_integer("executor", executor, 1)
    elif executor is not None and not callable(getattr(executor, "submit", None)):
        raise TypeError(
            f"`executor` must be an executor, a number of processes or None, got {executor!r}"
        )
    if not write_tpfs:
        return Job(study)
    if directory is None:
        raise ValueError("`write_tpfs` needs a `directory`")
    if not (hasattr(study, "observation") and hasattr(study, "measure")):
        raise ValueError(f"the study `{study.name}` has no pixels that could be written")
    return Job(study, directory)


def _missing(tasks, store, job, *, retry_failed):
    """Return the tasks that are to be computed."""
    missing = []
    for task in tasks:
        key = task["key"]
        done = key in store.rows or (key in store.failures and not retry_failed)
        if done and job.directory is not None and key in store.rows:
            done = tpf_path(job.directory, key).is_file()
        if not done:
            missing.append(task)
    return missing


def _records(executor, job, chunks, in_flight):
    """Yield the records of all stars as they are finished."""
    if executor is None:
        for task in chain.from_iterable(chunks):
            yield from job([task])
    elif isinstance(executor, Integral):
        for records in in_processes(executor, job, chunks):
            yield from records
    else:
        yield from _records_of_executor(executor, job, chunks, in_flight)


def _records_of_executor(executor, job, chunks, in_flight):
    """Yield the records of stars that an executor computes."""
    lost = []
    for chunk, future in completed(executor, job, chunks, in_flight):
        error = CancelledError("cancelled") if future.cancelled() else future.exception()
        if error is None:
            yield from future.result()
        elif isinstance(error, BrokenExecutor):
            lost += [task["key"] for task in chunk]
        elif isinstance(error, PixelsNotWrittenError):
            raise error
        else:  # the executor gave these stars up; it may still run others
            text = "".join(traceback.format_exception(error))
            for task in chunk:
                yield failure(task, f"{type(error).__name__}: {error}", text)
    if lost:
        names = ", ".join(sorted(lost)[:4]) + (", ..." if len(lost) > 4 else "")
        raise SweepError(
            f"the executor broke: a worker died, with {len(lost)} stars in flight ({names}). What "
            "was finished is kept in the results directory. A number as `executor` makes "
            "processes whose death costs their own star only"
        )


def _keep(records, store, bar):
    """Keep each record, and show how many there are."""
    failed = 0
    try:
        for record in records:
            store.add(record)
            if "error" in record:
                failed += 1
                bar.set_postfix(failed=failed, refresh=False)
            bar.update()
    except PixelsNotWrittenError as error:
        raise OSError(
            f"cannot write pixels; the {len(store.rows)} stars that are finished are kept, and the "
            f"same call goes on from there: {error}"
        ) from error
    except WorkersDieError as error:
        raise SweepError(
            "worker processes die as they begin, see their message; a script must start its work "
            'under `if __name__ == "__main__":`'
        ) from error


def _warn_of(failures):
    """Warn of stars that failed."""
    if failures:
        first = failures[0]
        warnings.warn(
            f"{len(failures)} stars failed, the first one, {first['task']['key']}, with "
            f"{first['error']}",
            FailedStarsWarning,
            stacklevel=3,
        )
