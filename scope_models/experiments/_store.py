"""The stars of a sweep in one SQLite file, written by one run at a time."""

import errno
import hashlib
import json
import sqlite3
import time
import warnings
import zlib
from contextlib import contextmanager
from pathlib import Path

from scope_models._version import __version__
from scope_models.exceptions import DamagedResultWarning

__all__ = ["FILE", "BusyError", "Store", "provenance"]

#: Name of the file in a results directory.
FILE = "results.sqlite"
_OUTPUTS = ("stars", "results.ecsv", "summary.ecsv", "failures.ecsv", "figure.png", "tpfs")
_CONTENTS = "contents of "
# Seconds of work that a power failure may cost.
_SYNC_INTERVAL = 5.0
_SCHEMA = """
    CREATE TABLE IF NOT EXISTS config (value TEXT NOT NULL);
    CREATE TABLE IF NOT EXISTS stars (key TEXT PRIMARY KEY, record TEXT NOT NULL, crc INTEGER);
"""


class BusyError(OSError):
    """Another run works in the results directory."""


class Store:
    """The records of a sweep, in a results directory or, without one, in memory.

    A record is a dictionary: "task", and either "row" or "error" and "traceback". The connection
    holds an exclusive lock on the file, which ends with the process, however it ends.

    Parameters
    ----------
    directory : pathlib.Path or None
        The results directory, which is made if need be.
    study : Study
        The study.
    tasks : list of dict
        All tasks of the study; records of other tasks are ignored.

    Raises
    ------
    OSError
        If the directory cannot be made or written to, or another run is writing to it.
    ValueError
        If it was made with another configuration, is damaged, or holds files of another origin
        that would be replaced.

    Warns
    -----
    DamagedResultWarning
        If records are damaged; they are left out.
    """

    def __init__(self, directory, study, tasks):
        self.directory = directory
        self._path = Path(":memory:") if directory is None else _file_in(directory)
        self._failed = {}
        self._synced = time.monotonic()
        self._connection = None
        with self._clear_errors():
            self._connection = sqlite3.connect(self._path, timeout=0, isolation_level=None)
            self._connection.text_factory = bytes  # damaged text may not be UTF-8
        try:
            with self._clear_errors():
                self._begin(study)
                self._load({task["key"]: task for task in tasks})
        except BaseException:
            self.close()
            raise

    def _begin(self, study):
        """Lock the file, and check that it belongs to the same study."""
        made = {"creator": f"scope_models {__version__}", **study.config()}
        made |= {_CONTENTS + path: _checksum(path) for path in study.input_files()}
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
        _check_same(self.directory, json.loads(json.dumps(made)), there)

    def _load(self, tasks):
        """Read which stars earlier runs have finished."""
        damaged = []
        for key, text, crc in self._connection.execute("SELECT key, record, crc FROM stars"):
            if crc != _crc(key, text):
                damaged.append(repr(key)[1:])
                continue
            record = json.loads(text)
            task = record["task"]
            if tasks.get(task["key"]) == task:
                self._failed[task["key"]] = "error" in record
        if damaged:
            shown = ", ".join(damaged[:5]) + (", ..." if len(damaged) > 5 else "")
            warnings.warn(
                f"{self._path}: damaged results ({shown}) are left out and computed again",
                DamagedResultWarning,
                stacklevel=5,
            )

    def is_done(self, key):
        """Return whether the star has a result."""
        return self._failed.get(key) is False

    def has_failed(self, key):
        """Return whether the star has been tried and has no result."""
        return self._failed.get(key, False)

    def __len__(self):
        """Return how many stars have results."""
        return sum(not failed for failed in self._failed.values())

    def read(self, key):
        """Return the record of a star."""
        rows = self._connection.execute("SELECT record FROM stars WHERE key = ?", (key,))
        return json.loads(rows.fetchone()[0])

    def add(self, record):
        """Keep a record in a transaction of its own; a failure does not replace a result.

        Raises
        ------
        OSError
            If it cannot be written; nothing of it is left then.
        """
        key, failed = record["task"]["key"], "error" in record
        if failed and self.is_done(key):
            return
        text = json.dumps(record).encode()
        row = key, text.decode(), _crc(key.encode(), text)
        with self._clear_errors():
            self._connection.execute("INSERT OR REPLACE INTO stars VALUES (?, ?, ?)", row)
            if time.monotonic() - self._synced > _SYNC_INTERVAL:
                self._connection.execute("PRAGMA wal_checkpoint")
                self._synced = time.monotonic()
        self._failed[key] = failed

    def close(self):
        """Release the file."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    @contextmanager
    def _clear_errors(self):
        """Raise errors of SQLite as errors about the file."""
        try:
            yield
        except sqlite3.DatabaseError as error:
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
                raise BusyError(
                    f"another run is writing to {self.directory}: wait until it has ended, or "
                    "choose another directory"
                ) from None
            if code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}:
                raise ValueError(f"{self._path} is damaged: choose another directory") from error
            clear = OSError(
                f"cannot write to {self._path}; the {len(self)} stars that are finished are kept, "
                f"and the same call goes on from there: the reason is: {error}"
            )
            clear.errno = errno.ENOSPC if code == sqlite3.SQLITE_FULL else errno.EIO
            raise clear from error


def provenance(study):
    """Return where a table comes from: package, version and configuration."""
    config = study.config()
    return {"creator": f"scope_models {__version__}", "study": config.pop("study"), **config}


def _file_in(directory):
    """Return the file of a results directory, which is made if it is not there."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(f"cannot write to {directory}: it is a file") from None
    except OSError as error:
        message = f"cannot make the folder {directory}: {error.strerror or error}"
        raise _same_error(error, message) from error
    path = directory / FILE
    if not path.exists():
        for name in _OUTPUTS:
            if (directory / name).exists():
                raise ValueError(
                    f"{directory} is not empty, and not a results directory either: it has "
                    f"{name}, but no {FILE}; choose another directory"
                )
    return path


def _same_error(error, message):
    """Return an error of the same type and number with another message."""
    other = type(error)(message)
    other.errno = error.errno
    return other


def _crc(key, text):
    """Return the checksum of a record and its key."""
    return zlib.crc32(text, zlib.crc32(key))


def _checksum(path):
    """Return the checksum of a file."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_same(directory, here, there):
    """Refuse a directory of another configuration."""
    absent = object()
    differ = []
    for name in {**here, **there}:
        new, old = (values.get(name, absent) for values in (here, there))
        if new != old:
            shown = ["absent" if value is absent else _shown(value) for value in (old, new)]
            differ.append(f"`{name}` ({shown[0]} there, {shown[1]} here)")
    if differ:
        raise ValueError(
            f"{directory} was made with another configuration, which differs in "
            f"{', '.join(differ)}; choose another directory"
        )


def _shown(value):
    """Return a value for a message, shortened."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
