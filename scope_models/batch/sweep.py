"""Computes a function of many stars, here or on a cluster, and keeps finished ones.

The stars of a sweep are in one SQLite file, which one run at a time writes.
"""

import errno
import hashlib
import json
import sqlite3
import time
import warnings
import zlib
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path

import numpy as np
from astropy.table import Table
from tqdm import tqdm

from scope_models._arrays import plain_tree
from scope_models._checks import checked_integer
from scope_models._threads import one_thread
from scope_models._values import Value
from scope_models._version import __version__
from scope_models.batch._workers import check_client, checked_tasks, computed, listed
from scope_models.exceptions import DamagedResultWarning, FailedStarsWarning
from scope_models.io._atomic import atomic_path, remove_temporaries
from scope_models.io._light_curves import sha256

__all__ = ["SweepError", "SweepResult", "run_sweep", "star_rng", "star_seed"]

#: Name of the file in a results directory.
FILE = "results.sqlite"
_OUTPUTS = ("results.ecsv", "summary.ecsv", "failures.ecsv", "figure.png")
_SYNC_INTERVAL = 5.0  # seconds of work that a power failure may cost
_LOCKED = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
_SCHEMA = """
    CREATE TABLE IF NOT EXISTS config (value TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS stars (key TEXT PRIMARY KEY, record TEXT NOT NULL, crc INTEGER);
"""


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
        One row per star that failed (key, error, task and traceback): ``failures.ecsv``, only if
        one did, with the tracebacks as JSON.
    summary : astropy.table.Table or None
        What `summarize` made of the table: ``summary.ecsv``.
    files : tuple of pathlib.Path
        The tables and ``figure.png`` in the results directory; empty without one.
    n_computed : int
        Stars that this call has computed; the others were there.

    Examples
    --------
    >>> from scope_models.batch import run_sweep
    >>> tasks = [{"key": f"star{n}", "mag": 12.0 + n} for n in range(2)]
    >>> result = run_sweep(lambda task: {"flux": 10 ** (-0.4 * task["mag"])}, tasks, progress=False)
    >>> result.table.colnames, result.n_computed
    (['key', 'mag', 'flux'], 2)
    """

    table: Table
    failures: Table
    summary: Table | None
    files: tuple[Path, ...]
    n_computed: int


def star_seed(seed, key, purpose=""):
    """Return the seed of a star, which depends on nothing but the arguments.

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
        The generator, at the beginning of its stream.

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
        where an earlier one stopped, however it ended. Without one, results are in memory only.
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
        Whether stars that failed in an earlier call are tried again, and whether to show a progress
        bar on the standard error.
    chunk_size : int, optional
        Stars that a worker gets at a time; more than one saves time if stars take milliseconds.
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
    check_client(client)
    if not callable(measure):
        raise TypeError(f"`measure` must be a function of a task, got {measure!r}")
    directory = None if directory is None else Path(directory).absolute()
    fields = asdict(config) if is_dataclass(config) else dict(config or {})
    meta = {"creator": f"scope_models {__version__}", "study": name, **plain_tree(fields)}
    tasks = checked_tasks(tasks)
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
            records = computed(client, measure, missing, chunk_size, in_flight)
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


class Store:
    """The records of a sweep, in a results directory or in memory: "task" and "row" or "error".

    Stars that were tried are in ``failed``, true without a result. The exclusive lock on the file
    ends with the process, however it ends.
    """

    def __init__(self, directory, config, inputs, tasks):
        self.directory = directory
        self._path = Path(":memory:") if directory is None else _file_in(directory)
        self.failed, self._synced = {}, time.monotonic()
        with self._clear_errors():
            self._connection = sqlite3.connect(self._path, timeout=0, isolation_level=None)
            self._connection.text_factory = bytes  # damaged text may not be UTF-8
            try:
                self._begin(config, inputs)
                self._load({task["key"]: task for task in tasks})
            except BaseException:
                self.close()
                raise

    def _begin(self, config, inputs):
        """Lock the file, and check that it belongs to the same configuration and inputs."""
        made = config | {f"contents of {path}": sha256(path) for path in inputs}
        execute = self._connection.execute
        # An exclusive lock needs no shared memory, so that network file systems serve too.
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA journal_mode = WAL")
        execute("PRAGMA synchronous = NORMAL")
        self._connection.executescript(f"BEGIN IMMEDIATE; {_SCHEMA} COMMIT;")
        found = execute("SELECT value FROM config").fetchone()
        if found is None:
            execute("INSERT INTO config VALUES (?)", (json.dumps(made),))
            return
        try:
            there = dict(json.loads(found[0]))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{self._path} is damaged: choose another directory") from error
        here = json.loads(json.dumps(made))
        absent = object()
        differ = [
            f"`{name}` ({_shown(name, there)} there, {_shown(name, here)} here)"
            for name in here | there
            if here.get(name, absent) != there.get(name, absent)
        ]
        if differ:
            raise ValueError(
                f"{self.directory} was made with another configuration, which differs in "
                f"{', '.join(differ)}; choose another directory"
            )

    def _load(self, tasks):
        """Read which stars earlier runs have finished."""
        damaged = []
        for key, record in _records(self._connection):
            if record is None:
                damaged.append(repr(key)[1:])
            elif record["task"] == tasks.get(name := record["task"]["key"]):
                self.failed[name] = "error" in record
        if damaged:
            results = f"{self._path}: damaged results ({listed(damaged)})"
            message = f"{results} are left out and computed again"
            warnings.warn(message, DamagedResultWarning, stacklevel=5)

    def __len__(self):
        """Return how many stars have results."""
        return sum(not failed for failed in self.failed.values())

    def read(self, key):
        rows = self._connection.execute("SELECT record FROM stars WHERE key = ?", (key,))
        return json.loads(rows.fetchone()[0])

    def add(self, record):
        """Keep a record in a transaction of its own; a failure does not replace a result."""
        key, failed = record["task"]["key"], "error" in record
        if failed and self.failed.get(key) is False:
            return
        text = json.dumps(record)
        row = key, text, zlib.crc32(text.encode(), zlib.crc32(key.encode()))
        with self._clear_errors():
            self._connection.execute("INSERT OR REPLACE INTO stars VALUES (?, ?, ?)", row)
            if time.monotonic() - self._synced > _SYNC_INTERVAL:
                self._connection.execute("PRAGMA wal_checkpoint")
                self._synced = time.monotonic()
        self.failed[key] = failed

    def close(self):
        self._connection.close()

    @contextmanager
    def _clear_errors(self):
        """Raise errors of SQLite as errors about the file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            code = _code_of(error)
            if code in _LOCKED:
                raise OSError(
                    f"another run is writing to {self.directory}: wait until it has ended, or "
                    "choose another directory"
                ) from None
            if code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}:
                raise ValueError(f"{self._path} is damaged: choose another directory") from error
            failure = OSError(  # its text would begin with a number given here
                f"cannot write to {self._path}; the {len(self)} stars that are finished are kept, "
                f"and the same call resumes there: the reason is: {error}"
            )
            failure.errno = errno.ENOSPC if code == sqlite3.SQLITE_FULL else errno.EIO
            raise failure from error


def read_records(directory):
    """Return all records of a results directory, also of a run that was interrupted."""
    path = Path(directory) / FILE
    if not path.is_file():
        raise FileNotFoundError(f"{directory} is not a results directory: it has no {FILE}")
    try:
        with closing(sqlite3.connect(path, timeout=0)) as connection:
            connection.text_factory = bytes
            return [record for _, record in _records(connection) if record is not None]
    except sqlite3.DatabaseError as error:
        if _code_of(error) in _LOCKED:
            raise OSError(f"a run is writing to {directory}: wait until it has ended") from None
        raise ValueError(f"{path} is damaged") from error


def _records(connection):
    """Yield the key and the record of each star, None if it is damaged."""
    for key, text, crc in connection.execute("SELECT key, record, crc FROM stars"):
        yield key, json.loads(text) if crc == zlib.crc32(text, zlib.crc32(key)) else None


def _file_in(directory):
    """Return the file of a results directory, which is made if it is not there."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(f"cannot write to {directory}: it is a file") from None
    except OSError as error:
        message = f"cannot make the folder {directory}: {error.strerror or error}"
        raise type(error)(message) from error
    path = directory / FILE
    for name in () if path.exists() else _OUTPUTS:
        if (directory / name).exists():
            raise ValueError(
                f"{directory} is not empty, and not a results directory either: it has "
                f"{name}, but no {FILE}; choose another directory"
            )
    return path


def _code_of(error):
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _shown(name, values):
    text = json.dumps(values[name]) if name in values else "absent"
    return text if len(text) <= 60 else f"{text[:57]}..."
