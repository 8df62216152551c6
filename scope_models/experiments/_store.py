"""The stars of a sweep on disk: finished ones are there for good, whatever happens to the run.

A results directory holds ``config.json``, what the study was, and the folder ``stars`` with one
file per run. A run appends one line per star to its own file: a checksum and a JSON record. So
there are few files however many stars there are, no two runs write to one file, a run that is
killed leaves whole lines but perhaps the last, and whatever is damaged is told by its checksum.
"""

import hashlib
import json
import os
import secrets
import time
import warnings
import zlib
from pathlib import Path

from scope_models._version import __version__
from scope_models.exceptions import DamagedResultWarning
from scope_models.io._atomic import atomic_path

__all__ = ["Store"]

_CONFIG, _STARS = "config.json", "stars"
_CONTENTS = "contents of files"
_OUTPUTS = (_STARS, "results.ecsv", "summary.ecsv", "failures.ecsv", "figure.png", "tpfs")
# Seconds of work that a failure of the power may cost.
_SYNC_INTERVAL = 5.0


class Store:
    """The records of a sweep, in a results directory or, without one, in memory only.

    A record is a dictionary: "task", and either "row" or "error" and "traceback".

    Parameters
    ----------
    directory : pathlib.Path or None
        The results directory.
    """

    def __init__(self, directory):
        self.directory = directory
        self.rows = {}
        self.failures = {}
        self._file = None
        self._path = None
        self._synced = time.monotonic()

    def begin(self, study):
        """Make the directory, or check that it is one of the same study.

        Parameters
        ----------
        study : Study
            The study.

        Raises
        ------
        OSError
            If the directory cannot be made or written to.
        ValueError
            If the directory was made with another configuration, which fields are named, or it
            holds files of another origin that would be replaced.
        """
        if self.directory is None:
            return
        made = {
            "creator": f"scope_models {__version__}",
            **study.config(),
            _CONTENTS: {path: _checksum(path) for path in study.input_files()},
        }
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise NotADirectoryError(f"cannot write to {self.directory}: it is a file") from None
        except OSError as error:
            raise _clear(error, f"cannot make the folder {self.directory}") from error
        path = self.directory / _CONFIG
        if path.exists():
            _check_same(self.directory, made, _read_config(path))
            return
        for name in _OUTPUTS:
            if (self.directory / name).exists():
                raise ValueError(
                    f"{self.directory} is not empty, and not a results directory either: it has "
                    f"{name}, but no {_CONFIG}; choose another directory"
                )
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")

    def load(self, tasks):
        """Read what earlier runs have finished.

        Parameters
        ----------
        tasks : list of dict
            All tasks of the study.

        Warns
        -----
        DamagedResultWarning
            If lines are damaged, and stars are missing.
        """
        if self.directory is None:
            return
        tasks = {task["key"]: task for task in tasks}
        damaged = []
        for path in sorted((self.directory / _STARS).glob("*.jsonl")):
            bad = [n for n, line in _lines(path) if not self._take(_decoded(line), tasks)]
            damaged += [(path, bad)] if bad else []
        if len(self.rows) == len(tasks):
            return
        for path, lines in damaged:
            numbers = ", ".join(map(str, lines[:5])) + (", ..." if len(lines) > 5 else "")
            warnings.warn(
                f"{path}: damaged results (line {numbers}) are left out; stars that are not "
                "elsewhere are computed again",
                DamagedResultWarning,
                stacklevel=4,
            )

    def _take(self, record, tasks):
        """Remember a record; return whether it belongs to the study."""
        if record is None or tasks.get(record["task"]["key"]) != record["task"]:
            return False
        self._remember(record)
        return True

    def _remember(self, record):
        key = record["task"]["key"]
        if "row" in record:
            # As text: a tenth of the memory, and what was just computed is treated like what
            # was read.
            self.rows[key] = json.dumps(record["row"]).encode()
            self.failures.pop(key, None)
        elif key not in self.rows:
            self.failures[key] = record

    def row(self, key):
        """Return the result of a star."""
        return json.loads(self.rows[key])

    def open(self):
        """Make the file of this run, so that a folder without room or permission is told now."""
        if self.directory is None:
            return
        folder = self.directory / _STARS
        self._path = folder / f"{time.time_ns():020d}-{secrets.token_hex(4)}.jsonl"
        try:
            folder.mkdir(exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
            self._file = os.open(self._path, flags, 0o666)
        except OSError as error:
            raise _clear(error, f"cannot write to {folder}") from error

    def add(self, record):
        """Keep a record, on disk first.

        Raises
        ------
        OSError
            If it cannot be written; nothing of it is left then.
        """
        if self._file is not None:
            text = json.dumps(record)
            line = f"{zlib.crc32(text.encode()):08x} {text}\n".encode()
            try:
                self._append(line)
            except OSError as error:
                message = (
                    f"cannot write to {self._path}; the {len(self.rows)} stars that are finished "
                    "are kept, and the same call goes on from there: the reason is"
                )
                raise _clear(error, message) from error
        self._remember(record)

    def _append(self, line):
        """Write a line as a whole, or leave the file as it was."""
        start = os.fstat(self._file).st_size
        written = 0
        try:
            while written < len(line):
                written += os.write(self._file, line[written:])
            if time.monotonic() - self._synced > _SYNC_INTERVAL:
                os.fsync(self._file)
                self._synced = time.monotonic()
        except OSError:
            os.ftruncate(self._file, start)
            raise

    def close(self):
        """Close the file of this run, and remove it if it has remained empty."""
        if self._file is None:
            return
        empty = os.fstat(self._file).st_size == 0
        os.close(self._file)
        self._file = None
        if empty:
            self._path.unlink(missing_ok=True)


def _lines(path):
    """Yield the number and the bytes of each line."""
    with path.open("rb") as file:
        yield from enumerate(file, start=1)


def _decoded(line):
    """Return the record of a line, or None if it is damaged."""
    checksum, _, text = line.partition(b" ")
    if not text.endswith(b"\n") or checksum != b"%08x" % zlib.crc32(text[:-1]):
        return None
    return json.loads(text)


def _checksum(path):
    """Return the checksum of a file."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _read_config(path):
    """Return what a results directory was made with."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged: choose another directory") from error


def _check_same(directory, here, there):
    """Refuse a directory of another configuration."""
    here, there = _flat(json.loads(json.dumps(here))), _flat(there)
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


def _flat(made):
    """Return what a directory was made with, each file by itself."""
    files = made.get(_CONTENTS, {})
    made = {name: value for name, value in made.items() if name != _CONTENTS}
    return made | {f"contents of {path}": checksum for path, checksum in files.items()}


def _shown(value):
    """Return a value for a message, shortened."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _clear(error, message):
    """Return an error of the same type and number with another message."""
    clear = type(error)(f"{message}: {error.strerror or error}")
    clear.errno = error.errno
    return clear
