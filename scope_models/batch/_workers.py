"""Computes stars: in this process, or in those of Dask or of another executor."""

import itertools
import logging
import re
import signal
import traceback
import warnings
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from numbers import Integral

import numpy as np

from scope_models._checks import checked_integer
from scope_models._threads import one_thread

__all__ = ["check_client", "checked_tasks", "computed", "listed"]

_DIED = "WorkerDied: the process that computed this star died (killed, out of memory, or a crash)"
_FREE_NAME = re.compile(r"[^\W_]([\w.+=-]{0,198}[\w+=-])?")
_POLL = 5.0  # seconds between two checks of the connection to a scheduler
_ADDRESS = re.compile(r"[a-z]+://.+|[^/\\]+:[0-9]+")
_WINDOWS = re.compile(r"(CON|PRN|AUX|NUL|COM[0-9]|LPT[0-9])(\..*)?", re.IGNORECASE)


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


def checked_tasks(tasks):
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
    """Return a dictionary of numbers and strings with Python's own types."""
    if taken := [name for name in sorted(values) if name in task]:
        raise ValueError(f"a result must not be named as a value of its task: {taken}")
    plain = {k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()}
    for name, value in plain.items():
        if not isinstance(value, (bool, int, float, str)):
            raise TypeError(f"`{name}` of a {kind} must be a number or a string, got {value!r}")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ValueError(f"`{name}` of a {kind} must be an integer of at most 64 bits")
        if isinstance(value, str):
            value.encode()  # raises UnicodeEncodeError, a ValueError, for lone surrogates
    return plain


def check_client(client):
    if isinstance(client, Integral) and not isinstance(client, bool):
        checked_integer("client", client, 1)
    elif isinstance(client, str):
        if not _ADDRESS.fullmatch(client):
            raise ValueError(f"`client` must be an address such as tls://host:8786, got {client!r}")
    elif client is not None and not callable(getattr(client, "submit", None)):
        wanted = "a client of Dask, an address, a number of processes, an executor or None"
        raise TypeError(f"`client` must be {wanted}, got {client!r}")


def computed(client, measure, tasks, chunk_size, in_flight):
    """Yield the records of all tasks as they are finished; the client is as for `run_sweep`.

    Stars whose process died are computed again one at a time: only the one that kills it fails.
    A BrokenExecutor is raised if the workers, or their scheduler, are lost.
    """
    job = partial(_measured, measure)
    if client is None:
        for task in tasks:
            yield from job([task])
        return
    with ExitStack() as stack:
        if isinstance(client, Integral):
            in_flight = 2 * client
        if isinstance(client, (Integral, str)):
            client = stack.enter_context(_dask_client(client))
        suspects = []
        chunks = [tasks[i : i + chunk_size] for i in range(0, len(tasks), chunk_size)]
        for chunk, outcome in _completed(client, job, chunks, in_flight):
            if type(outcome).__name__ == "KilledWorker":
                suspects += chunk
            else:
                yield from _records(chunk, outcome)
        for chunk, outcome in _completed(client, job, [[task] for task in suspects], 1):
            yield from _records(chunk, outcome)


def _records(chunk, outcome):
    """Return the records of a chunk from what its worker returned or raised."""
    if type(outcome).__name__ == "KilledWorker":
        return [{"task": task, "error": _DIED, "traceback": _DIED} for task in chunk]
    if isinstance(outcome, Exception):
        return [_failure(task, outcome) for task in chunk]
    return outcome


def _completed(client, job, chunks, in_flight):
    """Submit chunks, a bounded number at a time; yield each with its result or exception."""
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
            # a lost scheduler leaves futures that were submitted meanwhile pending for ever
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


def listed(names):
    """Return the first names as a text."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


@contextmanager
def _dask_client(where):
    """Return a client of Dask, of workers on this machine or of a scheduler that runs already."""
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
        ExitStack() as stack,
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
        client = stack.enter_context(Client(stack.enter_context(cluster)))
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
