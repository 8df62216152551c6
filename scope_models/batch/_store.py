"""The stars of a sweep in one SQLite file, written by one run at a time."""

import errno
import json
import sqlite3
import time
import warnings
import zlib
from contextlib import closing, contextmanager
from pathlib import Path

from scope_models.exceptions import DamagedResultWarning
from scope_models.io._light_curves import sha256

__all__ = ["FILE", "Store", "listed", "read_records"]

#: Name of the file in a results directory.
FILE = "results.sqlite"
_OUTPUTS = ("results.ecsv", "summary.ecsv", "failures.ecsv", "figure.png")
_SYNC_INTERVAL = 5.0  # seconds of work that a power failure may cost
_LOCKED = {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}
_SCHEMA = """
    CREATE TABLE IF NOT EXISTS config (value TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS stars (key TEXT PRIMARY KEY, record TEXT NOT NULL, crc INTEGER);
"""


class Store:
    """The records of a sweep, in a results directory or in memory: "task" and "row" or "error".

    The exclusive lock on the file ends with the process, however it ends.
    """

    def __init__(self, directory, config, inputs, tasks):
        self.directory = directory
        self._path = Path(":memory:") if directory is None else _file_in(directory)
        self._failed, self._synced = {}, time.monotonic()
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
        made = dict(config) | {f"contents of {path}": sha256(path) for path in inputs}
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
        differ = [
            f"`{name}` ({_shown(name, there)} there, {_shown(name, here)} here)"
            for name in {**here, **there}
            if name not in here or name not in there or here[name] != there[name]
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
                self._failed[name] = "error" in record
        if damaged:
            where = f"{self._path}: damaged results ({listed(damaged)})"
            message = f"{where} are left out and computed again"
            warnings.warn(message, DamagedResultWarning, stacklevel=5)

    def is_done(self, key):
        return self._failed.get(key) is False

    def has_failed(self, key):
        """Return whether the star has been tried and has no result."""
        return self._failed.get(key, False)

    def __len__(self):
        """Return how many stars have results."""
        return sum(not failed for failed in self._failed.values())

    def read(self, key):
        rows = self._connection.execute("SELECT record FROM stars WHERE key = ?", (key,))
        return json.loads(rows.fetchone()[0])

    def add(self, record):
        """Keep a record in a transaction of its own; a failure does not replace a result."""
        key, failed = record["task"]["key"], "error" in record
        if failed and self.is_done(key):
            return
        text = json.dumps(record)
        row = key, text, zlib.crc32(text.encode(), zlib.crc32(key.encode()))
        with self._clear_errors():
            self._connection.execute("INSERT OR REPLACE INTO stars VALUES (?, ?, ?)", row)
            if time.monotonic() - self._synced > _SYNC_INTERVAL:
                self._connection.execute("PRAGMA wal_checkpoint")
                self._synced = time.monotonic()
        self._failed[key] = failed

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


def listed(names):
    """Return the first names as a text."""
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


def _code_of(error):
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def _shown(name, values):
    text = json.dumps(values[name]) if name in values else "absent"
    return text if len(text) <= 60 else f"{text[:57]}..."
