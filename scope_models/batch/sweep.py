"""Computes a function of many stars, here or on a cluster, and keeps finished ones."""

import hashlib
import itertools
import json
import logging
import re
import signal
import traceback
import warnings
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from contextlib import closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass, is_dataclass
from functools import partial
from multiprocessing import resource_tracker
from numbers import Integral
from pathlib import Path

import numpy as np
from astropy.table import Table
from tqdm import tqdm

from scope_models._arrays import plain_tree
from scope_models._checks import checked_integer
from scope_models._threads import one_thread
from scope_models._values import Value
from scope_models._version import __version__
from scope_models.batch.results import Store, listed
from scope_models.exceptions import FailedStarsWarning
from scope_models.io._opening import atomic_path, remove_temporaries

__all__ = ["SweepError", "SweepResult", "run_sweep", "star_rng", "star_seed"]

_DIED = "WorkerDied: the process that computed this star died (killed, out of memory, or a crash)"
_FREE_NAME = re.compile(r"[^\W_]([\w.+=-]{0,198}[\w+=-])?")
_POLL = 5.0  # seconds between two checks of a scheduler
_ADDRESS = re.compile(r"[a-z]+://.+|[^/\\]+:[0-9]+")
_WINDOWS = re.compile(r"(CON|PRN|AUX|NUL|COM[0-9]|LPT[0-9])(\..*)?", re.IGNORECASE)


class SweepError(RuntimeError):
    """A sweep cannot go on, or all of its stars have failed.

    Examples
    --------
    >>> from scope_models.batch import SweepError
    >>> raise SweepError("all stars failed")
    Traceback (most recent call last):
    ...
    scope_models.batch.sweep.SweepError: all stars failed
    """


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult(Value):
    """The results of a sweep.

    Attributes
    ----------
    table : astropy.table.Table
        One row per star that did not fail, in the order of the tasks: ``results.ecsv``.
    failures : astropy.table.Table
        One row per star that failed (key, error, task and traceback): ``failures.ecsv``, if there
        are any, with the tracebacks as JSON.
    summary : astropy.table.Table or None
        What `summarize` made of the table: ``summary.ecsv``.
    files : tuple of pathlib.Path
        The tables and ``figure.png`` in the results directory; empty without one.
    n_computed : int
        Stars that this call has computed; the others were there.

    Examples
    --------
    >>> from scope_models.batch import run_sweep
    >>> tasks = [{"key": f"star{n}", "number": n} for n in range(3)]
    >>> result = run_sweep(lambda task: {"square": task["number"] ** 2}, tasks, progress=False)
    >>> result.table.colnames, result.n_computed
    (['key', 'number', 'square'], 3)
    """

    table: Table
    failures: Table
    summary: Table | None
    files: tuple[Path, ...]
    n_computed: int


def star_seed(seed, key, purpose=""):
    """Return the seed of a star, which depends on the arguments alone.

    Parameters
    ----------
    seed, key : int, str
        Seed of all stars, and the star's key.
    purpose : str, optional
        Another purpose gives another, independent seed.

    Returns
    -------
    int
        A seed below 2**53, so that JSON and FITS cards hold it exactly.

    Examples
    --------
    >>> from scope_models.batch import star_seed
    >>> star_seed(1, "star0")
    3551982543959318
    """
    text = f"{seed}\n{key}\n{purpose}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) >> 11


def star_rng(seed, key, purpose="star"):
    """Return a random generator for a star.

    Parameters
    ----------
    seed, key, purpose : int, str, str
        As for `star_seed`.

    Returns
    -------
    numpy.random.Generator
        The generator.

    Examples
    --------
    >>> from scope_models.batch import star_rng
    >>> star_rng(1, "star0").random() == star_rng(1, "star0").random()
    True
    """
    return np.random.default_rng(star_seed(seed, key, purpose))


def run_sweep(
    measure, tasks, directory=None, client=None, *, name="sweep", config=None, units=None,
    inputs=(), output=None, summarize=None, draw=None, retry_failed=True, progress=True,
    chunk_size=1, in_flight=256,
):  # fmt: skip
    """Compute a function of many stars, and keep each star that is finished.

    The result of a star must depend on its task and the configuration alone, with random numbers
    from `star_seed`; then the number of workers, the order and cuts between calls change no table.

    Parameters
    ----------
    measure : callable
        Function of a task that returns a dictionary of numbers, strings, and true or false by
        column. Workers must be able to unpickle it: a module's function, or `functools.partial`.
    tasks : sequence of dict
        Numbers and strings of each star; "key" is a unique name of letters, digits and ``._+=-``.
    directory : str or path-like, optional
        Results directory, where ``results.sqlite`` keeps each finished star: the same call goes on
        where an earlier one stopped, however it ended. By default results are in memory only.
    client : distributed.Client, str, int or concurrent.futures.Executor, optional
        What computes the stars, by default this process. A number starts that many processes with
        Dask, which are reached from this machine only. A string is the address of a Dask
        scheduler, as ``"tls://host:8786"``. Clients and executors are left open.
    name : str, optional
        Name of the sweep in tables and on the progress bar.
    config : mapping or dataclass, optional
        What the results depend on beside the tasks, as values that JSON holds.
    units : mapping of str to str, optional
        Units of columns.
    inputs : sequence of str or path-like, optional
        Files that the results depend on.
    output : callable, optional
        Function of a task that returns the path of the file that `measure` writes. Stars whose file
        is missing are computed again, and temporary files of killed runs beside it removed.
    summarize, draw : callable, optional
        Function of the table of results that returns a summary, a table; and function of table and
        summary that returns a figure or None.
    retry_failed, progress : bool, optional
        Whether stars that failed in an earlier call are tried again, and whether the standard error
        shows a progress bar.
    chunk_size : int, optional
        Stars that a worker gets at a time; more than one saves time if stars take milliseconds.
    in_flight : int, optional
        Chunks that are submitted and not finished, at most; at least twice the number of workers.

    Returns
    -------
    SweepResult
        The tables.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    ValueError
        If there are no tasks, or if the directory is damaged or was made by another version or with
        another configuration or other inputs.
    OSError
        If the directory cannot be written to, or another run is writing to it. Stars that are
        finished are kept.
    ModuleNotFoundError
        If workers are requested and Dask is not installed.
    SweepError
        If an executor breaks, a scheduler is lost, processes cannot be started, or all stars of a
        sweep with a directory fail.

    Warns
    -----
    FailedStarsWarning
        If stars have failed; the others go on.
    DamagedResultWarning
        If results of an earlier call are damaged; they are computed again.

    Examples
    --------
    >>> from scope_models.batch import run_sweep
    >>> def measure(task):
    ...     return {"square": task["number"] ** 2}
    >>> tasks = [{"key": f"star{n}", "number": n} for n in range(3)]
    >>> result = run_sweep(measure, tasks, "squares", progress=False)
    >>> result.table["square"].tolist(), result.n_computed
    ([0, 1, 4], 3)
    >>> run_sweep(measure, tasks, "squares", progress=False).n_computed
    0
    """
    chunk_size = checked_integer("chunk_size", chunk_size, 1)
    in_flight = checked_integer("in_flight", in_flight, 1)
    _check_client(client)
    if not callable(measure):
        raise TypeError(f"`measure` must be a function of a task, got {measure!r}")
    directory = None if directory is None else Path(directory).absolute()
    fields = asdict(config) if is_dataclass(config) else dict(config or {})
    meta = {"creator": f"scope_models {__version__}", "study": name, **plain_tree(fields)}
    tasks = _checked_tasks(tasks)
    outputs = {task["key"]: Path(output(task)) for task in tasks if output is not None}
    with closing(Store(directory, meta, inputs, tasks)) as store:
        for folder in {directory, *(path.parent for path in outputs.values())} - {None}:
            remove_temporaries(folder)

        def is_missing(key):
            if store.failed.get(key) is False:
                return bool(outputs) and not outputs[key].is_file()
            return retry_failed or key not in store.failed

        missing = [task for task in tasks if is_missing(task["key"])]
        if missing:
            bar = tqdm(total=len(tasks), initial=len(tasks) - len(missing), desc=name,
                       unit="star", smoothing=0.05, disable=not progress)  # fmt: skip
            records = _computed(client, measure, missing, chunk_size, in_flight)
            with one_thread, bar, closing(records):
                _keep(records, store, bar)
        records = [store.read(task["key"]) for task in tasks if task["key"] in store.failed]
    done = [record["task"] | record["row"] for record in records if "row" in record]
    failed = [record for record in records if "error" in record]
    if failed:
        key, reason = failed[0]["task"]["key"], failed[0]["error"]
        message = f"{len(failed)} stars failed, the first one, {key}, with {reason}"
        warnings.warn(message, FailedStarsWarning, stacklevel=2)
    table = _table(done, units or {}, meta)
    rows = [(r["task"]["key"], r["error"], json.dumps(r["task"]), r["traceback"]) for r in failed]
    names = "key", "error", "task", "traceback"
    failures = Table(rows=rows or None, names=names, dtype=[str] * 4, meta=dict(meta))
    if not done and directory is not None:
        where = _write(failures, directory / "failures.ecsv")
        first = f"the first one with {failed[0]['error']}"
        raise SweepError(f"all {len(failed)} stars failed, {first}; see {where}")
    summary = summarize(table) if summarize is not None and done else None
    if summary is not None:
        summary.meta = meta | summary.meta
    files = ()
    if directory is not None:
        figure = None if draw is None else draw(table, summary)
        files = _written(directory, table, summary, figure, failures)
    return SweepResult(table, failures, summary, files, len(missing))


def _keep(records, store, bar):
    failed = 0
    try:
        for record in records:
            store.add(record)
            if "error" in record:
                failed += 1
                bar.set_postfix(failed=failed, refresh=False)
            bar.update()
    except BrokenExecutor as error:
        raise SweepError(
            f"{error}; the {len(store)} stars that are finished are kept, and the same call goes "
            "on from there"
        ) from error


def _table(rows, units, meta):
    names = list(dict.fromkeys(name for row in rows for name in row))
    units = {name: units[name] for name in names if name in units}
    return Table(rows or None, names=names or None, units=units, meta=dict(meta))


def _written(directory, table, summary, figure, failures):
    files = [_write(table, directory / "results.ecsv")]
    if summary is not None:
        files.append(_write(summary, directory / "summary.ecsv"))
    if figure is not None:
        from scope_models.plotting._style import save_figure  # imports matplotlib

        files.append(directory / "figure.png")
        with atomic_path(files[-1], overwrite=True) as temporary:
            save_figure(figure, temporary)
    if len(failures):
        files.append(_write(failures, directory / "failures.ecsv"))
    else:
        (directory / "failures.ecsv").unlink(missing_ok=True)
    return tuple(files)


def _write(table, path):
    if "traceback" in table.colnames:
        table = table.copy()
        # ECSV takes the blanks off the beginnings of the lines of a text
        table["traceback"] = [json.dumps(text) for text in table["traceback"]]
    with atomic_path(path, overwrite=True) as temporary:
        table.write(temporary, format="ascii.ecsv")
    return path


def _measured(measure, tasks):
    """Return the record of each task: its row, or its failure."""
    records = []
    with one_thread:
        for task in tasks:
            try:
                row = _checked_values(measure(task), "result", task)
                records.append({"task": task, "row": row})
            except Exception as error:  # noqa: BLE001 - the other stars go on
                records.append(_failure(task, error))
    return records


def _failure(task, error):
    """Return the record of a star that failed."""
    try:
        reason, trace = f"{type(error).__name__}: {error}", traceback.format_exception(error)
    except Exception:  # noqa: BLE001 - an exception that cannot be printed
        reason = trace = type(error).__name__
    return {"task": task, "error": _cut(reason, 1000), "traceback": _cut("".join(trace), 4000)}


def _cut(text, size):
    """Return a text without the middle of a long one."""
    cut = f"{text[: size // 2]} [...] {text[-size // 2 :]}" if len(text) > size else text
    return cut.encode("utf-8", "backslashreplace").decode()


def _checked_tasks(tasks):
    """Return tasks with plain values and unique keys that can be names of files."""
    tasks = [_checked_values(task, "task") for task in tasks]
    if not tasks:
        raise ValueError("`tasks` must hold at least one star")
    keys = set()
    for task in tasks:
        key = task.get("key")
        plain = isinstance(key, str) and _FREE_NAME.fullmatch(key)
        if not plain or _WINDOWS.fullmatch(key):
            wanted = "a short, plain name that can be a file's"
            raise ValueError(f"the key of a task must be {wanted}, got {key!r}")
        if key in keys:
            raise ValueError(f"the keys of the tasks must differ, got {key!r} twice")
        keys.add(key)
    return tasks


def _checked_values(values, kind, task=()):
    """Return numbers and strings with Python's own types."""
    if taken := [name for name in sorted(values) if name in task]:
        raise ValueError(f"a result must not be named as a value of its task: {taken}")
    plain = {k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()}
    for name, value in plain.items():
        if not isinstance(value, (int, float, str)):
            raise TypeError(f"`{name}` of a {kind} must be a number or a string, got {value!r}")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ValueError(f"`{name}` of a {kind} must be an integer of at most 64 bits")
        if isinstance(value, str):
            value.encode()  # raises UnicodeEncodeError, a ValueError, for lone surrogates
    return plain


def _check_client(client):
    if isinstance(client, Integral) and not isinstance(client, bool):
        checked_integer("client", client, 1)
    elif isinstance(client, str):
        if not _ADDRESS.fullmatch(client):
            raise ValueError(f"`client` must be an address such as tls://host:8786, got {client!r}")
    elif client is not None and not callable(getattr(client, "submit", None)):
        wanted = "a client of Dask, an address, a number of processes, an executor or None"
        raise TypeError(f"`client` must be {wanted}, got {client!r}")


def _computed(client, measure, tasks, chunk_size, in_flight):
    """Yield the records of all tasks as they are finished.

    Stars whose process died are computed again one at a time: only the one that kills it fails.
    BrokenExecutor is raised if the workers, or their scheduler, are lost.
    """
    job = partial(_measured, measure)
    if client is None:
        for task in tasks:
            yield from job([task])
        return
    if isinstance(client, Integral):
        in_flight = 2 * client
    is_own = isinstance(client, (Integral, str))
    with _dask_client(client) if is_own else nullcontext(client) as executor:
        suspects = []
        chunks = [tasks[i : i + chunk_size] for i in range(0, len(tasks), chunk_size)]
        for chunk, outcome in _completed(executor, job, chunks, in_flight):
            if type(outcome).__name__ == "KilledWorker":
                suspects += chunk
            else:
                yield from _records(chunk, outcome)
        for chunk, outcome in _completed(executor, job, [[task] for task in suspects], 1):
            yield from _records(chunk, outcome)


def _records(chunk, outcome):
    """Return the records of a chunk from what its worker returned or raised."""
    if type(outcome).__name__ == "KilledWorker":
        return [{"task": task, "error": _DIED, "traceback": _DIED} for task in chunk]
    if isinstance(outcome, Exception):
        return [_failure(task, outcome) for task in chunk]
    return outcome


def _completed(client, job, chunks, in_flight):
    """Submit chunks; yield each with its result or exception."""
    is_dask = hasattr(client, "get_executor")
    executor = client.get_executor(pure=False) if is_dask else client
    chunks, waiting, lost = iter(chunks), {}, []
    try:
        while True:
            while not lost and len(waiting) < in_flight and (chunk := next(chunks, None)):
                try:
                    waiting[executor.submit(job, chunk)] = chunk
                except RuntimeError:  # broken or closed
                    lost += chunk
            if not waiting:
                break
            done = wait(waiting, timeout=_POLL, return_when=FIRST_COMPLETED).done
            # futures of a lost scheduler may stay pending for ever
            if not done and is_dask and client.status != "running":
                lost += itertools.chain.from_iterable(waiting.values())
                break
            for future in done:
                chunk = waiting.pop(future)
                if future.cancelled() or isinstance(future.exception(), BrokenExecutor):
                    lost += chunk
                else:
                    yield chunk, future.exception() or future.result()
    finally:
        for future in waiting:
            future.cancel()
    if lost:
        keys = listed(sorted(task["key"] for task in lost))
        raise BrokenExecutor(f"the workers are lost, with {len(lost)} stars in flight ({keys})")


@contextmanager
def _dask_client(where):
    """Return a client of Dask, of workers on this machine or of a scheduler."""
    try:
        import cryptography  # noqa: F401 - of temporary keys
        import dask
        from distributed import Client, LocalCluster
        from distributed.security import Security
    except ImportError as error:
        command = 'python -m pip install "scope_models[distributed]"'
        raise ModuleNotFoundError(f"workers need Dask: {command}") from error
    if isinstance(where, str):
        with Client(where) as client:
            yield client
        return
    with (
        # A worker that dies gives its stars back at once.
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        _later_interrupts() as allow_interrupts,
    ):
        try:
            # No port is open to other machines, nor to other users of this one.
            cluster = LocalCluster(
                n_workers=where, threads_per_worker=1, host="127.0.0.1",
                dashboard_address="127.0.0.1:0", memory_limit=0, silence_logs=logging.CRITICAL,
                security=Security.temporary(),
            )  # fmt: skip
        except RuntimeError as error:
            raise BrokenExecutor(
                "worker processes die at their start; see their message; a script must start its "
                'work under `if __name__ == "__main__":`'
            ) from error
        with cluster, Client(cluster) as client:
            client.register_worker_callbacks(partial(_begin_worker, warnings.filters[:]))
            allow_interrupts()
            yield client


@contextmanager
def _later_interrupts():
    """Block interrupts, whose tracebacks workers would print, until the function is called."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield lambda: None
        return
    resource_tracker.ensure_running()  # its start, with the first process, would allow them again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield partial(signal.pthread_sigmask, signal.SIG_SETMASK, before)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(filters):
    """Leave interrupts to the parent, and share its warning filters."""
    warnings.filters[:] = filters
    signal.signal(signal.SIGINT, signal.SIG_IGN)
