"""Writing a file so that it is there as a whole or not at all."""

import os
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["atomic_path", "check_output", "identity", "remove_temporaries"]

_PREFIX = ".scope-models-"


@contextmanager
def atomic_path(path, *, overwrite=False):
    """Give a temporary path to write to, and move the file into place at the end, in one step.

    It is a hidden file beside ``path`` with the same suffixes. When the body raises, it is removed
    and ``path`` stays as it was. Without ``overwrite``, neither a file that exists nor one that
    appears meanwhile is replaced. Errors are an OSError that names the file.
    """
    target = check_output(path, overwrite=overwrite)
    temporary = target.with_name(_PREFIX + secrets.token_hex(8) + "".join(target.suffixes[-2:]))
    try:
        yield temporary
        if overwrite and target.exists():
            shutil.copymode(target, temporary)
        _move(path, temporary, target, overwrite=overwrite)
    except OSError as error:
        if error.filename not in (None, temporary, str(temporary)):
            raise
        raise type(error)(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporaries(folder):
    """Remove what processes that were killed were writing in a folder, where that is possible."""
    for path in Path(folder).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            path.unlink()


def check_output(path, *, overwrite=False, inputs=()):
    """Return the real place of a file, or raise the errors of `atomic_path`; inputs are refused."""
    target = Path(os.path.realpath(path))
    for source in inputs:
        if identity(source) == identity(target):
            raise ValueError(f"cannot write {path}: it is the input {source}")
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {target.parent}")
    if target.exists() and not target.is_file():
        raise OSError(f"cannot write {path}: it is not a regular file")
    if target.exists() and not overwrite:
        raise _exists(path)
    if not os.access(target.parent, os.W_OK):
        raise PermissionError(f"cannot write {path}: Permission denied in folder {target.parent}")
    return target


def identity(path):
    """Return a key common to all links to a file: device and inode, or the path if absent."""
    try:
        state = Path(path).stat()
    except OSError:
        return os.path.realpath(path)
    return state.st_dev, state.st_ino


def _move(path, temporary, target, *, overwrite):
    """Move a file to its place, which must be free without ``overwrite``."""
    if overwrite:
        temporary.replace(target)
        return
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # the file system has no hard links: take the name first
        try:
            target.touch(exist_ok=False)
        except FileExistsError:
            raise _exists(path) from None
        temporary.replace(target)


def _exists(path):
    return FileExistsError(f"{path} exists already; pass overwrite=True to replace it")
