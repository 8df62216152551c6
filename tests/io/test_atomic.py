"""Files that are there as a whole or not at all."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from astropy.io import fits

from scope_models.io._opening import atomic_path, check_output
from scope_models.io.tpf import write_hdulist


def save(path, text="new", **options):
    with atomic_path(path, **options) as temporary:
        temporary.write_text(text)


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def test_new_file(tmp_path):
    with atomic_path(tmp_path / "a.fits.gz") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffixes == [".fits", ".gz"]
        assert not temporary.exists()
        temporary.write_text("new")
        assert not (tmp_path / "a.fits.gz").exists()
    assert names(tmp_path) == ["a.fits.gz"]
    assert (tmp_path / "a.fits.gz").read_text() == "new"


def test_permissions_are_those_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("")
    save(tmp_path / "a")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_existing_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(FileExistsError, match=r"a\.txt exists already; pass overwrite=True"):
        save(path)
    assert path.read_text() == "old"
    save(path, overwrite=True)
    assert path.read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("links", [True, False])
def test_file_that_appears_meanwhile_is_kept(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    path = tmp_path / "a.txt"

    def write_in_the_meantime():
        with atomic_path(path) as temporary:
            temporary.write_text("new")
            path.write_text("other")

    with pytest.raises(FileExistsError, match="exists already"):
        write_in_the_meantime()
    assert path.read_text() == "other"
    assert names(tmp_path) == ["a.txt"]


def no_links(*_):
    raise PermissionError(1, "Operation not permitted")


def test_file_system_without_links(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", no_links)
    save(tmp_path / "a.txt")
    assert (tmp_path / "a.txt").read_text() == "new"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_interrupted_writing_leaves_what_was_there(tmp_path, error):
    path = tmp_path / "a.txt"

    def write_half():
        with atomic_path(path, overwrite=True) as temporary:
            temporary.write_text("half")
            raise error

    for before in (None, "old"):
        if before:
            path.write_text(before)
        with pytest.raises(error):
            write_half()
        assert names(tmp_path) == (["a.txt"] if before else [])
        assert not before or path.read_text() == before


def test_fits_writer_that_fails_half_way(tmp_path, monkeypatch):
    path = tmp_path / "a.fits"
    write_hdulist(fits.HDUList([fits.PrimaryHDU(np.zeros(9))]), path)
    old = path.read_bytes()

    def fail(_, stream):
        stream.write(b"SIMPLE")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(fits.HDUList, "writeto", fail)
    with pytest.raises(OSError, match="No space left"):
        write_hdulist(fits.HDUList([fits.PrimaryHDU(np.ones(9))]), path, overwrite=True)
    assert path.read_bytes() == old
    assert names(tmp_path) == ["a.fits"]


KILLED = """
import sys, time
from scope_models.io._opening import atomic_path
one, two = (atomic_path(path, overwrite=True) for path in sys.argv[1:])
with one as first, two as second, first.open("w") as stream, second.open("w") as other:
    for half in (stream, other):
        half.write("half")
        half.flush()
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_killed_writer_leaves_what_was_there(tmp_path):
    new, path = tmp_path / "new.txt", tmp_path / "old.txt"
    path.write_text("old")
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, new, path], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "writing\n"
        process.kill()
        process.wait()
    assert not new.exists()
    assert path.read_text() == "old"


REWRITING = """
import sys
from scope_models.io._opening import atomic_path
print("begun", flush=True)
for digit in "123456789" * 20:
    with atomic_path(sys.argv[1], overwrite=True) as temporary:
        temporary.write_text(digit * 100_000)
"""


HALF = """
import os, sys
from scope_models.io._opening import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    os._exit(9)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_what_killed_writers_leave_is_removed_and_live_ones_go_on(tmp_path):
    def kill(name):
        subprocess.run([sys.executable, "-c", HALF, str(tmp_path / name)], check=False)

    with atomic_path(tmp_path / "live.txt") as temporary:
        temporary.write_text("half")
        kill("a.txt")
        assert len(names(tmp_path)) == 2
        kill("b.txt")  # removes what the first one left
        assert len(names(tmp_path)) == 2
        assert temporary.exists()
    assert names(tmp_path)[1:] == ["live.txt"]


def test_readers_see_whole_files_only(tmp_path):
    path = tmp_path / "a.txt"
    save(path, "0" * 100_000)
    command = [sys.executable, "-c", REWRITING, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == "begun\n"
        stop = time.monotonic() + 30
        while writer.poll() is None and time.monotonic() < stop:
            text = path.read_text()
            assert len(text) == 100_000
            assert len(set(text)) == 1
        assert writer.wait(timeout=30) == 0
    assert path.read_text()[0] == "9"


def test_no_place_for_a_file(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        save(tmp_path, overwrite=True)
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        save(tmp_path / "absent" / "a.txt")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        save(tmp_path / "file" / "a.txt")
    with pytest.raises(OSError, match="it is not a regular file"):
        save(os.devnull, overwrite=True)
    assert names(tmp_path) == ["file"]


def test_folder_without_permission(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # the superuser may write everywhere
    with pytest.raises(PermissionError, match=r"cannot write .*a.txt: Permission denied in folder"):
        save(tmp_path / "a.txt")


def test_symbolic_link_is_followed(tmp_path):
    (tmp_path / "target.txt").write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to("target.txt")
    save(link, overwrite=True)
    assert link.is_symlink()
    assert (tmp_path / "target.txt").read_text() == "new"


def test_permissions_are_kept(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o640)
    save(path, overwrite=True)
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_input_is_never_replaced(tmp_path, link):
    source = path = tmp_path / "a.txt"
    source.write_text("old")
    if link is not None:
        path = tmp_path / "b.txt"
        link(source, path)
    with pytest.raises(ValueError, match=rf"cannot write .*{path.name}: it is the input .*a\.txt"):
        check_output(path, overwrite=True, inputs=[tmp_path / "absent.txt", source])
    assert source.read_text() == "old"
    assert check_output(tmp_path / "c.txt", inputs=[source]) == tmp_path / "c.txt"


def test_message_names_the_file(tmp_path):
    def fail(error):
        with atomic_path(tmp_path / "a.txt") as temporary:
            temporary.write_text("part")
            raise error

    with pytest.raises(OSError, match=r"cannot write .*a\.txt: No space left on device"):
        fail(OSError(28, "No space left on device"))
    with pytest.raises(FileNotFoundError, match=r"other\.txt"):
        fail(FileNotFoundError(2, "No such file", "other.txt"))
    assert names(tmp_path) == []


def test_compressed_by_suffix_in_capitals(tmp_path):
    path = write_hdulist(fits.HDUList([fits.PrimaryHDU()]), tmp_path / "STAR.FITS.GZ")
    assert path.read_bytes()[:2] == b"\x1f\x8b"
