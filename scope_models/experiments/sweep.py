"""Computes the stars of a study, on this machine or on a cluster, and keeps what is finished."""

import json
import warnings
from contextlib import closing
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from astropy.table import Table
from astropy.utils.decorators import deprecated_renamed_argument
from astropy.utils.exceptions import AstropyDeprecationWarning
from tqdm import tqdm

from scope_models._checks import checked_integer
from scope_models._threads import one_thread
from scope_models._values import Value
from scope_models.exceptions import FailedStarsWarning
from scope_models.experiments._store import Store, provenance
from scope_models.experiments._workers import (
    Job,
    LostWorkersError,
    PixelsNotWrittenError,
    check_client,
    checked_tasks,
    computed,
    is_address,
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


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult(Value):
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


@deprecated_renamed_argument(["config", "executor"], ["study", "client"], ["0.2", "0.2"])
def run_sweep(
    study,
    directory=None,
    client=None,
    *,
    write_tpfs=False,
    retry_failed=True,
    progress=True,
    chunk_size=1,
    in_flight=256,
):
    """Compute all stars of a study.

    The result of a star depends on the study and the star alone, not on the order, the number of
    workers or the cuts between calls.

    Parameters
    ----------
    study : Study
        The study, which is its own configuration.
    directory : str or path-like, optional
        Results directory. Each star that is finished is kept there, in ``results.sqlite``, so that
        the same call goes on where an earlier one stopped, however it ended. Without one, results
        are in memory only.
    client : distributed.Client, str, int or concurrent.futures.Executor, optional
        What computes the stars. None is this process. A number starts that many processes with
        Dask, which are reached from this machine only. A string is the address of a Dask
        scheduler, as ``"tls://host:8786"``. Clients and executors are left open.
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
        Chunks that are submitted and not finished, at most; at least twice the number of workers.
        Processes of our own have two each.

    Returns
    -------
    SweepResult
        The tables.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If the study has no stars, or no pixels to write, or if the directory is damaged or was
        made with another configuration.
    OSError
        If the directory cannot be written to, the disk is full, or another run is writing to the
        directory. Stars that are finished are kept.
    ModuleNotFoundError
        If workers are requested and Dask is not installed.
    SweepError
        If an executor breaks, a scheduler is lost, or processes cannot be started.

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
    >>> result = run_sweep(study, "results", progress=False)
    >>> result.table["maximum"].round(2).tolist(), result.n_computed
    ([0.59, 5.95], 2)
    >>> run_sweep(study, "results", progress=False).n_computed
    0
    """
    directory, client = _in_order(directory, client)
    chunk_size = checked_integer("chunk_size", chunk_size, 1)
    in_flight = checked_integer("in_flight", in_flight, 1)
    check_client(client)
    directory = None if directory is None else Path(directory).absolute()
    if not isinstance(study, Study):
        raise TypeError(f"`study` must be a Study, got {study!r}")
    if write_tpfs and directory is None:
        raise ValueError("`write_tpfs` needs a `directory`")
    if write_tpfs and type(study).observation is Study.observation:
        raise ValueError(f"the study `{study.name}` has no pixels that could be written")
    job = Job(study, directory if write_tpfs else None)
    tasks = checked_tasks(study)
    with closing(Store(directory, study, tasks)) as store:
        missing = [task for task in tasks if _is_missing(task, store, job, retry=retry_failed)]
        if missing:
            bar = tqdm(total=len(tasks), initial=len(tasks) - len(missing), desc=study.name,
                       unit="star", smoothing=0.05, disable=not progress)  # fmt: skip
            records = computed(client, job, missing, chunk_size, in_flight)
            with one_thread, bar, closing(records):
                _keep(records, store, bar)
        keys = [task["key"] for task in tasks]
        done = [store.read(key) for key in keys if store.is_done(key)]
        failed = [store.read(key) for key in keys if store.has_failed(key)]
    if failed:
        warnings.warn(
            f"{len(failed)} stars failed, the first one, {failed[0]['task']['key']}, with "
            f"{failed[0]['error']}",
            FailedStarsWarning,
            stacklevel=3,
        )
    rows = [record["task"] | record["row"] for record in done]
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = Table(rows or None, names=names or None, meta=provenance(study))
    for name in study.units.keys() & set(table.colnames):
        table[name].unit = study.units[name]
    names = "key", "error", "task", "traceback"
    rows = [
        (record["task"]["key"], record["error"], json.dumps(record["task"]), record["traceback"])
        for record in failed
    ]
    failures = Table(rows=rows or None, names=names, dtype=[str] * 4, meta=provenance(study))
    return SweepResult(table, failures, len(missing), directory)


def _in_order(directory, client):
    """Return directory and client, which the first version took in the other order."""
    is_path = isinstance(client, (str, PathLike)) and not is_address(client)
    if (
        isinstance(directory, int)
        or hasattr(directory, "submit")
        or (directory is None and is_path)
    ):
        warnings.warn(
            "the directory comes before the client: run_sweep(study, directory, client)",
            AstropyDeprecationWarning,
            stacklevel=4,
        )
        return client, directory
    return directory, client


def _is_missing(task, store, job, *, retry):
    """Return whether a star is to be computed."""
    key = task["key"]
    if store.has_failed(key):
        return retry
    return (
        not store.is_done(key)
        or not job.study.has_output(task)
        or (job.directory is not None and not tpf_path(job.directory, key).is_file())
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
    except (PixelsNotWrittenError, LostWorkersError) as error:
        kept = f"the {len(store)} stars that are finished are kept, and the same call goes on from"
        if isinstance(error, LostWorkersError):
            raise SweepError(f"{error}; {kept} there") from error
        raise OSError(f"cannot write pixels; {kept} there: {error}") from error
