"""Kills, full disks, folders that are read-only and two writers: no damaged file, no remains."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from scope_models import Detector, Motion, Star, read_truth, simulate
from scope_models.io import read_pixels

POSIX = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


def make_observation(n=300, shape=(11, 11)):
    return simulate(Star(12.0), Detector.k2(shape=shape), Motion.k2_roll(n), seed=1)


COMMAND = "import sys; from scope_models.cli import main; sys.exit(main())"
PLANET = [
    "--period",
    "1.5",
    "--t0",
    "2145",
    "--depth",
    "0.01",
    "--duration",
    "0.2",
    "--star",
    "scene",
]
WRITE = """
import sys
from scope_models import Detector, Motion, Star, simulate
observation = simulate(Star(12.0), Detector.k2(shape=(15, 15)), Motion.k2_roll(1500), seed=1)
print("ready", flush=True)
while True:
    observation.write(sys.argv[1], overwrite=True)
"""


@POSIX
@pytest.mark.slow
@pytest.mark.parametrize("sign", ["SIGKILL", "SIGTERM"])
def test_kills_while_writing(sign, tmp_path):
    """25 kills at random moments of a loop that writes the same file."""
    rng = np.random.default_rng(1)
    path = tmp_path / "star.fits"
    expected = None
    for _ in range(25):
        command = [sys.executable, "-c", WRITE, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            time.sleep(0.1 + rng.uniform(0, 0.5))
            process.send_signal(getattr(signal, sign))
        if path.exists():
            content = path.read_bytes()
            expected = expected or content
            assert content == expected
        assert len(list(tmp_path.iterdir())) <= 2  # the file, and what the last kill left
    assert read_truth(path).seed == 1
    make_observation(10).write(tmp_path / "other.fits")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["other.fits", "star.fits"]


@POSIX
@pytest.mark.slow
@pytest.mark.parametrize("name", ["detrend", "simulate", "fit", "inject"])
def test_kills_of_commands(name, tmp_path):
    """What a killed command leaves is a whole file or none; the next run is as the first."""
    rng = np.random.default_rng(2)
    source, output = tmp_path / "in.fits", tmp_path / "out" / "out.fits"
    output.parent.mkdir()
    make_observation().write(source)
    command = {
        "detrend": ["detrend", str(source), "--order", "1", "--output", str(output)],
        "simulate": ["simulate", "--mag", "12", "--seed", "1", "--output", str(output)],
        "fit": ["fit", str(source), "--components", "1", "--output", str(output)],
        "inject": ["inject", str(source), "--output", str(output), *PLANET],
    }[name]
    command = [sys.executable, "-c", COMMAND, *command, "--overwrite"]
    start = time.monotonic()
    subprocess.run(command, check=True, capture_output=True)
    length = time.monotonic() - start
    contents = {path.name: path.read_bytes() for path in output.parent.iterdir()}
    for i in range(12):
        for path in output.parent.iterdir():
            path.unlink()
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            time.sleep(rng.uniform(0.3, 1.0) * length)
            process.send_signal(signal.SIGKILL if i % 2 else signal.SIGTERM)
            _, error = process.communicate()
        assert "Traceback" not in error
        for path in output.parent.glob("out.*"):
            if path.suffix == ".fits":
                assert path.read_bytes() == contents[path.name]
    subprocess.run(command, check=True, capture_output=True)
    assert sorted(path.name for path in output.parent.iterdir()) == sorted(contents)
    assert output.read_bytes() == contents["out.fits"]


@POSIX
@pytest.mark.slow
def test_kills_of_a_run_with_two_workers(tmp_path):
    """12 kills at random moments: no process is left, and the resumed run gives the whole."""
    rng = np.random.default_rng(3)
    paths = [str(tmp_path / f"star{i}.fits") for i in range(12)]
    for i, path in enumerate(paths):
        simulate(Star(12.0), Detector.k2(shape=(9, 9)), Motion.k2_roll(200), seed=i).write(path)

    def command(folder, workers):
        options = ["--order", "1", "--output-dir", str(folder), "--workers", str(workers)]
        return [sys.executable, "-c", COMMAND, "detrend", *paths, *options]

    subprocess.run(command(tmp_path / "whole", 1), check=True, capture_output=True)
    kills = 0
    for run in range(4):
        folder = tmp_path / f"run{run}"
        for _ in range(3):
            with subprocess.Popen(
                command(folder, 2), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                start_new_session=True,
            ) as process:  # fmt: skip
                time.sleep(rng.uniform(1, 9))
                process.send_signal(signal.SIGKILL if kills % 2 else signal.SIGTERM)
                _, error = process.communicate()
            kills += 1
            assert "Traceback" not in error
            end = time.monotonic() + 60
            while has_processes(process.pid):
                assert time.monotonic() < end, "workers outlive their parent"
                time.sleep(0.2)
        subprocess.run(command(folder, 2), check=True, capture_output=True)
        for path in (tmp_path / "whole").glob("*.fits"):
            assert (folder / path.name).read_bytes() == path.read_bytes()
        names = [{path.name for path in one.iterdir()} for one in (folder, tmp_path / "whole")]
        left = {name for name in names[0] if name.startswith(".scope-models-")}  # of killed ones
        assert names[0] - left == names[1]


def has_processes(group):
    """Return whether a process group has processes."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


_UNREADABLE = 77


def in_a_child(function):
    """Run a function in a copy of this process, and return its status."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(function())
        finally:
            os._exit(9)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@POSIX
def test_full_disk(tmp_path):
    """The limit on the size of files of a process stands for a full disk."""
    import resource

    observation = make_observation(100)

    def write():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        try:
            observation.write(tmp_path / "star.fits")
        except OSError as error:
            return 0 if str(error).startswith(f"cannot write {tmp_path / 'star.fits'}: ") else 3
        return 4

    assert in_a_child(write) == 0
    assert list(tmp_path.iterdir()) == []


@POSIX
@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root writes anywhere")
def test_read_only_folder(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(PermissionError, match=r"cannot write .*star\.fits: Permission denied"):
        make_observation(10).write(tmp_path / "star.fits")
    tmp_path.chmod(0o755)
    assert list(tmp_path.iterdir()) == []


@POSIX
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs another user")
def test_read_only_folder_of_another_user(tmp_path):
    """As root: a process of nobody writes to a folder of root."""
    observation = make_observation(10)
    observation.write(tmp_path / "star.fits")  # imports what nobody cannot read
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        if not folder.parent.stat().st_mode & 0o001:
            pytest.skip("nobody cannot reach the folder")

        def write():
            os.setuid(65534)
            if not os.access(read_pixels.__code__.co_filename, os.R_OK):
                return _UNREADABLE
            try:
                observation.write(folder / "star.fits")
            except PermissionError as error:
                return 0 if f"cannot write {folder / 'star.fits'}" in str(error) else 3
            return 4

        status = in_a_child(write)
        if status == _UNREADABLE:
            pytest.skip("another user cannot read the package, which is in a private folder")
        assert status == 0
        assert list(folder.iterdir()) == []


def test_two_writers(tmp_path):
    """Without overwrite one of them wins; with it, the file is always one of theirs."""
    observations = [make_observation(10), make_observation(20)]
    path = tmp_path / "star.fits"
    barrier, errors = threading.Barrier(2), []

    def write(observation):
        barrier.wait()
        try:
            observation.write(path)
        except FileExistsError as error:
            errors.append(error)

    threads = [threading.Thread(target=write, args=(item,)) for item in observations]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(errors) == 1
    assert len(read_pixels(path, quality_bitmask="none")) in (10, 20)
    assert [file.name for file in tmp_path.iterdir()] == ["star.fits"]


def fluxes(path):
    return read_pixels(path).flux.tobytes()


def test_threads_read_what_one_reads(tmp_path):
    path = make_observation(40, (7, 7)).write(tmp_path / "star.fits")
    expected = fluxes(path)
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(fluxes, [path] * 12)) == {expected}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_processes_read_what_one_reads(method, tmp_path):
    if method == "forkserver" and os.name != "posix":
        pytest.skip("POSIX only")
    path = make_observation(40, (7, 7)).write(tmp_path / "star.fits")
    with get_context(method).Pool(2) as pool:
        assert set(pool.map(fluxes, [path] * 4)) == {fluxes(path)}


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "2"])
def test_number_of_threads_of_the_linear_algebra(threads, tmp_path):
    """Simulated pixels are the same to the bit; corrected fluxes to 1 ppm."""
    path = tmp_path / "star.fits"
    code = (
        "import sys; from scope_models import *\n"
        "from scope_models.correctors import PLDCorrector\n"
        "o = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(400), seed=1)\n"
        "import numpy as np\n"
        "o.write(sys.argv[1]); lc = PLDCorrector(sys.argv[1]).correct(order=1)\n"
        "np.save(sys.argv[1] + '.npy', lc.flux.value)\n"
    )
    environment = {**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    subprocess.run([sys.executable, "-W", "ignore", "-c", code, path], check=True, env=environment)
    observation = simulate(Star(12.0), Detector.k2(shape=(7, 7)), Motion.k2_roll(400), seed=1)
    again = read_pixels(observation.write(tmp_path / "o.fits"))
    assert np.array_equal(read_pixels(path).flux, again.flux, equal_nan=True)
    from scope_models.correctors import PLDCorrector

    expected = PLDCorrector(path).correct(order=1).flux.value
    np.testing.assert_allclose(np.load(f"{path}.npy"), expected, rtol=1e-6)


@pytest.mark.slow
def test_nothing_needs_the_network(tmp_path):
    """Reading, correcting and fitting with sockets that refuse to connect."""
    path = make_observation(60, (7, 7)).write(tmp_path / "star.fits")
    code = (
        "import socket, sys\n"
        "class Refused(socket.socket):\n"
        "    def connect(self, *_): raise RuntimeError('network')\n"
        "    connect_ex = connect\n"
        "socket.socket = Refused\n"
        "socket.create_connection = socket.getaddrinfo = Refused.connect\n"
        "from scope_models.cli import main\n"
        "status = main(['detrend', sys.argv[1], '--order', '1', '--output', sys.argv[2]])\n"
        "sys.exit(status or main(['fit', sys.argv[1], '--components', '1', '--cadences', '20',\n"
        "                         '--output', sys.argv[3]]))\n"
    )
    names = [str(path), str(tmp_path / "lc.fits"), str(tmp_path / "fit.fits")]
    command = [sys.executable, "-c", code, *names]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
