"""What computes stars: here, in processes of our own, or in those of an executor."""

import itertools
import os
import re
import signal
import threading
import traceback
import warnings
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from multiprocessing import connection, get_context, parent_process
from pathlib import Path

import numpy as np
import scipy.linalg  # noqa: F401 - its threads are limited only once it is loaded
from threadpoolctl import threadpool_limits

from scope_models.experiments._tables import SCALARS
from scope_models.experiments.study import Study

__all__ = [
    "Job",
    "PixelsNotWrittenError",
    "WorkersDieError",
    "checked_tasks",
    "completed",
    "cut",
    "failure",
    "in_processes",
    "one_thread",
    "tpf_path",
]

_DIED = "WorkerDied: the process that computed this star died (killed, out of memory, or a crash)"
_FREE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+=-]{0,199}")


class PixelsNotWrittenError(Exception):
    """The pixels of a star cannot be written."""


class WorkersDieError(Exception):
    """Worker processes die before they have done anything."""


@dataclass(frozen=True)
class Job:
    """Computes stars of a study; a worker process gets it with its tasks.

    Parameters
    ----------
    study : Study
        The study.
    directory : pathlib.Path or None
        Results directory in which the pixels are written; None does not write them.
    """

    study: Study
    directory: Path | None = None

    def __call__(self, tasks):
        """Return the record of each task: its row, or what went wrong."""
        with one_thread():
            return [self._record(task) for task in tasks]

    def _record(self, task):
        try:
            return {"task": task, "row": checked_values(self._row(task), "result")}
        except PixelsNotWrittenError:
            raise
        except Exception as error:  # noqa: BLE001 - whatever it is, the other stars go on
            text = f"{type(error).__name__}: {error}"
            return failure(task, text, traceback.format_exc())

    def _row(self, task):
        if self.directory is None:
            return self.study.run_star(task)
        observation = self.study.observation(task)
        row = self.study.measure(task, observation)
        path = tpf_path(self.directory, task["key"])
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            observation.write(path, overwrite=True, metadata={"object_name": task["key"]})
        except OSError as error:
            raise PixelsNotWrittenError(f"{path}: {error.strerror or error}") from error
        return row


def failure(task, error, text):
    """Return the record of a star that failed."""
    return {"task": task, "error": error, "traceback": text}


def tpf_path(directory, key):
    """Return the target pixel file of a star.

    There are 256 folders, so that no folder has too many files.
    """
    return directory / "tpfs" / sha256(key.encode()).hexdigest()[:2] / f"{key}.fits"


def checked_tasks(study):
    """Return the tasks of a study after a check of what it has made.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    list of dict
        The tasks, with plain values.

    Raises
    ------
    ValueError
        If there are none, or keys are not unique or no file names.
    TypeError
        If a value is no number, string, or true or false.
    """
    tasks = [checked_values(task, "task") for task in study.tasks()]
    if not tasks:
        raise ValueError(f"the study `{study.name}` has no stars: one of its lists is empty")
    keys = set()
    for task in tasks:
        key = task.get("key")
        if not isinstance(key, str) or not _FREE_NAME.fullmatch(key):
            raise ValueError(f"the key of a task must be a short, plain name, got {key!r}")
        if key in keys:
            raise ValueError(f"the keys of the tasks must differ, got {key!r} twice")
        keys.add(key)
    return tasks


def checked_values(values, kind):
    """Return a dictionary of numbers and strings with Python's own types."""
    plain = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in values.items()
    }
    for name, value in plain.items():
        if not isinstance(value, SCALARS):
            raise TypeError(f"`{name}` of a {kind} must be a number or a string, got {value!r}")
    return plain


class _Limiter:
    """One thread for linear algebra from the first entry to the last exit of any thread."""

    def __init__(self):
        self._lock = threading.Lock()
        self._depth = 0
        self._limits = None

    def enter(self):
        with self._lock:
            if self._depth == 0:
                self._limits = threadpool_limits(1)
            self._depth += 1

    def leave(self):
        with self._lock:
            self._depth -= 1
            if self._depth == 0:
                self._limits.restore_original_limits()


_LIMITER = _Limiter()


@contextmanager
def one_thread():
    """Keep BLAS and OpenMP to one thread.

    The matrices are small, cores are better used by further stars, and the number of threads
    changes the rounding of the results.
    """
    _LIMITER.enter()
    try:
        yield
    finally:
        _LIMITER.leave()


def completed(executor, job, chunks, in_flight):
    """Submit tasks, a bounded number at a time, and yield them as they are completed.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        What runs them.
    job : callable
        What is run: it gets a list of tasks.
    chunks : iterator of list
        The lists of tasks; taken from as results come in.
    in_flight : int
        Largest number of lists that are submitted and not completed.

    Yields
    ------
    chunk : list
        The tasks.
    future : concurrent.futures.Future
        Their result, or the exception. When the executor is broken, no further chunks are taken.
    """
    waiting, broken = {}, False
    try:
        while True:
            while not broken and len(waiting) < in_flight:
                chunk = next(chunks, None)
                if chunk is None:
                    break
                try:
                    waiting[executor.submit(job, chunk)] = chunk
                except BrokenExecutor as error:
                    future, broken = Future(), True
                    future.set_exception(error)
                    waiting[future] = chunk
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                broken = broken or _is_broken(future)
                yield waiting.pop(future), future
    finally:
        for future in waiting:
            future.cancel()


def _is_broken(future):
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def in_processes(number, job, chunks, in_flight=None):
    """Run tasks in processes of our own; a process that dies costs its own star only.

    The stars that were in flight when a process died are run again one at a time, which tells
    the one that killed it.

    Parameters
    ----------
    number : int
        Number of processes.
    job : Job
        What is run.
    chunks : iterator of list
        The lists of tasks.
    in_flight : int, optional
        As in `completed`. The default is two per process.

    Yields
    ------
    list of dict
        Records.

    Raises
    ------
    WorkersDieError
        If processes die before they get a task.
    """
    chunks = iter(chunks)
    while (first := next(chunks, None)) is not None:
        suspects = []
        with _pool(number) as pool:
            rest = itertools.chain([first], chunks)
            for chunk, future in completed(pool, job, rest, in_flight or 2 * number):
                if _is_broken(future):
                    suspects += chunk
                else:
                    yield future.result()
        for task in suspects:
            yield _alone(job, task)


def _alone(job, task):
    """Return the records of a task that may kill its process."""
    with _pool(1) as pool:
        try:
            return pool.submit(job, [task]).result()
        except BrokenExecutor:
            return [failure(task, _DIED, _DIED)]


@contextmanager
def _pool(number):
    """Give a pool of processes that have begun to work."""
    # Not "fork", which copies the locks of other threads in whatever state they are.
    pool = ProcessPoolExecutor(
        number,
        mp_context=get_context("spawn"),
        initializer=_begin_worker,
        initargs=(warnings.filters[:],),
    )
    with pool:
        try:
            pool.submit(os.getpid).result()
        except BrokenExecutor as error:
            raise WorkersDieError from error
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _begin_worker(filters):
    """Leave interrupts to the parent, warn of what it warns, and end with it, however it ends."""
    warnings.filters[:] = filters
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel):
    """Wait for another process to end."""
    connection.wait([sentinel])
    os._exit(1)


def cut(tasks, size):
    """Return an iterator of lists of at most ``size`` tasks."""
    tasks = iter(tasks)
    return iter(lambda: list(itertools.islice(tasks, size)), [])
