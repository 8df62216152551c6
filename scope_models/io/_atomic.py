"""Writing a file so that it is there as a whole or not at all."""

import os
import re
import secrets
import shutil
import socket
from contextlib import contextmanager
from pathlib import Path

__all__ = ["atomic_path", "check_output"]

# Temporary files are .scope-models-HOST-PROCESS-RANDOM with the suffixes of the file.
_PREFIX = ".scope-models-"


@contextmanager
def atomic_path(path, *, overwrite=False, inputs=()):
    """Give a temporary path to write to, and move the file into place at the end.

    The temporary file is in the folder of ``path`` and keeps its suffixes, so that writers
    recognize the format. When the body ends, it becomes ``path`` in one step: whoever opens
    ``path`` sees the old file, the new file or none, and never a part. When the body raises,
    the temporary file is removed and ``path`` stays as it was. A process that is killed leaves
    its temporary file, whose name begins with a dot; the next one that writes to the folder on
    the same computer removes it (not on Windows).

    Without ``overwrite``, neither a file that exists nor one that appears while the body runs is
    replaced. ``inputs`` are never replaced, also if ``path`` is a link to one of them. Errors are
    an OSError or a ValueError that names the file.
    """
    target, temporary = _checked(path, overwrite=overwrite, inputs=inputs)
    _remove_orphans(target.parent)
    try:
        yield temporary
        _move(path, temporary, target, overwrite=overwrite)
    except OSError as error:
        if error.filename not in (None, temporary, str(temporary)):
            raise
        raise type(error)(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def check_output(path, *, overwrite=False, inputs=()):
    """Raise the errors of `atomic_path` before any work is done for the file."""
    _checked(path, overwrite=overwrite, inputs=inputs)


def _checked(path, *, overwrite, inputs):
    """Return the real place of a file and a temporary path beside it, or refuse it."""
    target = Path(os.path.realpath(path))
    for source in inputs:
        if _is_same(target, source):
            raise ValueError(f"cannot write {path}: it is the input {source}")
    _check_target(path, target, overwrite=overwrite)
    name = f"{_PREFIX}{_host()}-{os.getpid()}-{secrets.token_hex(8)}"
    temporary = target.with_name(name + "".join(target.suffixes[-2:]))
    _check_folder(path, temporary)
    return target, temporary


def _is_same(target, source):
    try:
        return target.samefile(source)
    except OSError:  # one of them is not there
        return target == Path(os.path.realpath(source))


def _host():
    return re.sub("[^A-Za-z0-9]", "_", socket.gethostname()) or "host"


def _remove_orphans(folder):
    """Remove temporary files of processes of this computer that were killed."""
    if os.name == "nt":  # signal 0 would end the process there
        return
    for file in folder.glob(f"{_PREFIX}{_host()}-*"):
        found = re.match(rf"{_PREFIX}{_host()}-(\d+)-", file.name)
        if found and not _is_alive(int(found[1])):
            file.unlink(missing_ok=True)


def _is_alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True


def _check_target(path, target, *, overwrite):
    """Refuse a target that is no place for a file."""
    if target.is_dir():
        raise IsADirectoryError(f"cannot write {path}: it is a folder")
    if not target.parent.exists():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {target.parent}")
    if not target.parent.is_dir():
        raise NotADirectoryError(f"cannot write {path}: {target.parent} is not a folder")
    if target.exists():
        if not target.is_file():
            raise OSError(f"cannot write {path}: it is not a regular file")
        if not overwrite:
            raise _exists(path)


def _check_folder(path, temporary):
    """Refuse a folder in which no file can be made."""
    try:
        temporary.touch(exist_ok=False)
    except OSError as error:
        message = f"cannot write {path}: {error.strerror} in folder {temporary.parent}"
        raise type(error)(message) from error
    temporary.unlink()


def _move(path, temporary, target, *, overwrite):
    """Move a file to its place; fail if a name that must be free is taken meanwhile."""
    if overwrite:
        if target.exists():
            shutil.copymode(target, temporary)
        temporary.replace(target)
        return
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise _exists(path) from None
    except OSError:
        # The file system has no hard links: take the name first, then put the file there.
        try:
            target.touch(exist_ok=False)
        except FileExistsError:
            raise _exists(path) from None
        temporary.replace(target)


def _exists(path):
    return FileExistsError(f"{path} exists already; pass overwrite=True to replace it")
