"""Writing a file so that it is there as a whole or not at all."""

import os
import secrets
from contextlib import contextmanager
from pathlib import Path

__all__ = ["atomic_path"]


@contextmanager
def atomic_path(path, *, overwrite=False):
    """Give a temporary path to write to, and move the file into place at the end.

    The temporary file is in the folder of ``path`` and keeps its suffixes, so that writers
    recognise the format. When the body ends, it becomes ``path`` in one step: whoever opens
    ``path`` sees the old file, the new file or none, and never a part. When the body raises,
    the temporary file is removed and ``path`` stays as it was. A process that is killed leaves
    its temporary file, whose name begins with a dot.

    Parameters
    ----------
    path : str or path-like
        The file to write. A symbolic link is followed.
    overwrite : bool, optional
        Whether a file that exists is replaced. Without it, a file that appears while the
        body runs is not replaced either.

    Yields
    ------
    pathlib.Path
        The path to write to. No file is there yet.

    Raises
    ------
    FileExistsError
        If the file exists and ``overwrite`` is false.
    FileNotFoundError, NotADirectoryError
        If the folder of ``path`` is not there, or is not a folder.
    IsADirectoryError
        If ``path`` is a folder.
    PermissionError
        If the folder cannot be written to.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from scope_models.io._atomic import atomic_path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_path(Path(folder) / "numbers.txt") as temporary:
    ...         _ = temporary.write_text("1 2 3")
    ...     [file.name for file in Path(folder).iterdir()]
    ['numbers.txt']
    """
    target = Path(os.path.realpath(path))
    _check_target(path, target, overwrite=overwrite)
    temporary = target.with_name(f".{secrets.token_hex(8)}{''.join(target.suffixes[-2:])}")
    _check_folder(path, temporary)
    try:
        yield temporary
        if overwrite:
            temporary.replace(target)
        else:
            _move_new(path, temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


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


def _move_new(path, temporary, target):
    """Move a file to a name that is free, and fail if it is taken meanwhile."""
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
