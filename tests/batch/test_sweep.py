"""Sweeps: the same table however they run, and nothing lost however they end."""

import contextlib
import errno
import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from sweep_studies import Numbers, blas_threads

from scope_models.batch import SweepError, run_sweep, star_rng, star_seed
from scope_models.batch import sweep as sweep_module
from scope_models.batch.results import FILE, Store
from scope_models.exceptions import DamagedResultWarning, FailedStarsWarning
from scope_models.io._opening import atomic_path

SELECT = "SELECT key, record FROM stars"


def sweep(study, client=None, directory=None, **options):
    """Run the sweep of a study: a dataclass with `tasks` and `run_star`."""
    defaults = {
        "name": "numbers", "config": study, "units": {"noise": "ppm"}, "progress": False,
        "inputs": [study.motion] if study.motion else [],
    }  # fmt: skip
    return run_sweep(study.run_star, study.tasks(), directory, client, **defaults | options)


def experiment(study, directory, client=None):
    """Run a sweep with a summary and a figure."""
    return sweep(study, client, directory, summarize=study.summarize, draw=study.draw)


def ecsv(table, path):
    table.write(path, overwrite=True)
    return path.read_bytes()


def computed(log):
    """Return the stars that were computed, in order."""
    path = Path(log)
    return [int(line.split()[0]) for line in path.read_text().splitlines()] if path.exists() else []


def records(directory):
    """Return the records on disk by the key of their star."""
    with contextlib.closing(sqlite3.connect(directory / FILE)) as connection:
        return {key: json.loads(text) for key, text in connection.execute(SELECT)}


class Backwards(Executor):
    """Runs what it was given in the opposite order, once results are requested."""

    def __init__(self):
        self.largest = 0
        self._waiting = []

    def submit(self, function, *arguments):
        future = Future()
        self._waiting.append((future, function, arguments))
        self.largest = max(self.largest, len(self._waiting))
        if len(self._waiting) == 3:
            self._run()
        return future

    def _run(self):
        while self._waiting:
            future, function, arguments = self._waiting.pop()
            future.set_result(function(*arguments))


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        yield executor


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """Return the table of the default study as a file."""
    return ecsv(sweep(Numbers()).table, tmp_path_factory.mktemp("reference") / "results.ecsv")


class TestTable:
    def test_rows_and_columns(self):
        table = sweep(Numbers(stars=3)).table
        assert table.colnames == [
            "key", "mag", "index", "noise", "undefined", "count", "name", "good", "threads",
        ]  # fmt: skip
        assert list(table["index"]) == [0, 1, 2]
        assert table["noise"].unit == "ppm"
        assert np.isnan(table["undefined"]).all()
        assert table["good"].dtype == bool
        assert table["count"].dtype == int

    def test_is_read_back(self, tmp_path):
        table = sweep(Numbers(stars=3)).table
        path = tmp_path / "results.ecsv"
        table.write(path)
        again = Table.read(path)
        assert list(again["name"]) == list(table["name"])
        np.testing.assert_array_equal(again["noise"], table["noise"])
        assert again["noise"].unit == "ppm"
        assert again.meta["study"] == "numbers"
        assert again.meta["stars"] == 3
        assert again.meta["creator"].startswith("scope_models ")

    def test_values_are_those_of_the_study(self):
        study = Numbers(stars=3)
        table = sweep(study).table
        for task, row in zip(study.tasks(), table, strict=True):
            assert row["noise"] == pytest.approx(study.run_star(task)["noise"], rel=1e-12)

    def test_more_stars_leave_the_others(self):
        few, many = (sweep(Numbers(stars=n)).table for n in (3, 6))
        assert list(few["noise"]) == list(many["noise"][:3])

    def test_columns_that_some_stars_lack(self):
        class Ragged(Numbers):
            def run_star(self, task):
                return {"odd": 2.5} if task["index"] % 2 else {"even": "x"}

        table = sweep(Ragged(stars=4)).table
        assert table["odd"].mask.tolist() == [True, False, True, False]
        assert table["even"].mask.tolist() == [False, True, False, True]
        assert table["odd"].compressed().tolist() == [2.5, 2.5]


class TestExecutors:
    def test_processes(self, reference, tmp_path):
        """Beside another cluster, whose dashboard has the usual port."""
        with socket.socket() as dashboard:
            with suppress(OSError):  # taken already
                dashboard.bind(("", 8787))
                dashboard.listen()
            result = sweep(Numbers(), 2)
        assert ecsv(result.table, tmp_path / "a.ecsv") == reference
        assert result.n_computed == 8

    def test_linear_algebra_has_one_thread(self, pool):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("OMP_NUM_THREADS", "2")
            patch.setenv("OPENBLAS_NUM_THREADS", "2")
            for executor in (None, pool):
                assert set(sweep(Numbers(), executor).table["threads"]) == {1}

    def test_executor_stays_open(self, reference, tmp_path, pool):
        for chunk_size in (1, 3, 100):
            table = sweep(Numbers(), pool, chunk_size=chunk_size).table
            assert ecsv(table, tmp_path / "a.ecsv") == reference

    def test_threads(self, reference, tmp_path):
        with ThreadPoolExecutor(3) as executor:
            table = sweep(Numbers(), executor, tmp_path / "run").table
        assert ecsv(table, tmp_path / "a.ecsv") == reference

    def test_order(self, reference, tmp_path):
        # 8 stars one by one would leave two that never run: the executor waits for three
        executor = Backwards()
        table = sweep(Numbers(stars=9), executor, in_flight=3).table
        assert executor.largest == 3
        table.remove_row(8)
        table.meta["stars"] = 8
        assert ecsv(table, tmp_path / "a.ecsv") == reference

    def test_bounded_number_in_flight(self):
        class Lazy(Executor):
            def __init__(self):
                self.pending = []

            def submit(self, function, *arguments):
                future = Future()
                self.pending.append((future, function, arguments))
                if len(self.pending) > 5:
                    raise AssertionError("more than 5 in flight")
                if len(self.pending) == 5:
                    for waiting, call, values in self.pending:
                        waiting.set_result(call(*values))
                    self.pending.clear()
                return future

        assert len(sweep(Numbers(stars=20), Lazy(), in_flight=5).table) == 20

    @pytest.mark.parametrize("executor", [True, 1.5, object()])
    def test_no_client(self, executor):
        with pytest.raises(TypeError, match="`client` must be a client of Dask, an address, a n"):
            sweep(Numbers(), executor, "run")

    def test_no_address(self):
        with pytest.raises(ValueError, match="`client` must be an address such as tls://host:8"):
            sweep(Numbers(), "2", "run")

    @pytest.mark.parametrize("options", [{"chunk_size": 0}, {"in_flight": 0}, {"client": 0}])
    def test_numbers_below_one(self, options):
        with pytest.raises(ValueError, match=f"`{next(iter(options))}` must be at least 1, got 0"):
            sweep(Numbers(), **options)

    def test_progress_bar_is_on_standard_error(self, capsys):
        sweep(Numbers(stars=3), progress=True)
        out, err = capsys.readouterr()
        assert out == ""
        assert "numbers: 100%" in err
        assert "3/3" in err

    @pytest.mark.slow
    def test_dask(self, reference, tmp_path):
        distributed = pytest.importorskip("distributed")
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # those of the cluster's own set-up
            cluster = distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=None
            )
            with cluster, distributed.Client(cluster) as client:
                executor = client.get_executor()
                result = sweep(Numbers(), executor, tmp_path / "run", in_flight=3)
                with pytest.warns(FailedStarsWarning, match="1 stars failed"):
                    failed = sweep(Numbers(failing=(3,)), executor)
        assert ecsv(result.table, tmp_path / "a.ecsv") == reference
        assert list(failed.failures["key"]) == ["star3"]
        assert sweep(Numbers(), None, tmp_path / "run").n_computed == 0

    def test_workers_without_dask(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(ModuleNotFoundError, match=r"workers need Dask: python -m pip install"):
            sweep(Numbers(), 2)


@pytest.mark.slow
class TestScheduler:
    @pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
    def test_workers_listen_on_the_loopback_only(self):
        class Listening(Numbers):
            def run_star(self, task):  # noqa: ARG002
                return {"addresses": " ".join(sorted(listening(os.getppid(), os.getpid())))}

        addresses = set(" ".join(sweep(Listening(stars=2), 1).table["addresses"]).split())
        assert addresses
        assert {address.split(":")[0] for address in addresses} == {"0100007F"}

    def test_address(self, reference, tmp_path):
        with scheduler(tmp_path) as (address, _):
            table = sweep(Numbers(), address).table
        assert ecsv(table, tmp_path / "a.ecsv") == reference

    def test_scheduler_that_dies_costs_nothing_that_is_finished(self, tmp_path):
        log = tmp_path / "log"
        study = Numbers(stars=40, sleep=0.1, log=str(log))
        with scheduler(tmp_path) as (address, process):

            def kill():
                while len(computed(log)) < 6:
                    time.sleep(0.05)
                process.kill()

            thread = threading.Thread(target=kill)
            thread.start()
            with pytest.raises(SweepError, match=r"the workers are lost, with .* are kept"):
                sweep(study, address, tmp_path / "run", in_flight=3)
            thread.join()
        done = len(records(tmp_path / "run"))
        assert 3 <= done < 40
        assert sweep(study, None, tmp_path / "run").n_computed == 40 - done


class TestResuming:
    def test_nothing_is_computed_twice(self, tmp_path, reference):
        study = Numbers()
        assert sweep(study, None, tmp_path / "run").n_computed == 8
        again = sweep(study, None, tmp_path / "run")
        assert again.n_computed == 0
        assert ecsv(again.table, tmp_path / "a.ecsv") == reference
        assert len(records(tmp_path / "run")) == 8
        names = sorted(path.name for path in (tmp_path / "run").iterdir())
        assert names == ["results.ecsv", FILE]

    @pytest.mark.slow
    def test_killed_run_goes_on(self, tmp_path):
        log, folder, whole = tmp_path / "log", tmp_path / "run", tmp_path / "whole"
        study = Numbers(stars=12, sleep=0.15, log=str(log))
        experiment(study, whole)
        log.unlink()
        for workers, started in ((None, 4), (2, 9)):
            kill_after(started, study, folder, workers)
        done = {record["task"]["index"] for record in records(folder).values()}
        assert 4 <= len(done) < 12
        log.unlink()
        experiment(study, folder)
        assert computed(log) == [i for i in range(12) if i not in done]
        for name in ("results.ecsv", "summary.ecsv"):
            assert (folder / name).read_bytes() == (whole / name).read_bytes()

    @pytest.mark.slow
    def test_workers_end_with_a_killed_parent(self, tmp_path):
        log = tmp_path / "log"
        study = Numbers(stars=50, sleep=0.1, log=str(log))
        kill_after(5, study, tmp_path / "run", 2)
        workers = {int(line.split()[1]) for line in log.read_text().splitlines()}
        end = time.monotonic() + 20
        while any(is_running(pid) for pid in workers) and time.monotonic() < end:
            time.sleep(0.05)
        assert not any(is_running(pid) for pid in workers)

    def test_second_run_in_one_directory_is_refused(self, tmp_path, reference):
        # as when a job is started twice by mistake
        folder = tmp_path / "run"

        class Twice(Numbers):
            def run_star(self, task):
                if task["index"] == 3:
                    with pytest.raises(OSError, match=r"another run is writing to .*run: wait"):
                        sweep(Twice(), None, folder)
                return super().run_star(task)

        assert ecsv(sweep(Twice(), None, folder).table, tmp_path / "a.ecsv") == reference

    def test_another_configuration_is_refused(self, tmp_path):
        sweep(Numbers(), None, tmp_path)
        before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        message = r"differs in `seed` \(1 there, 2 here\), `stars` \(8 there, 9 here\); choose"
        with pytest.raises(ValueError, match=message):
            sweep(Numbers(seed=2, stars=9), None, tmp_path)
        assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before

    def test_another_study_is_refused(self, tmp_path):
        sweep(Numbers(), None, tmp_path)
        with pytest.raises(ValueError, match=r'`study` \("numbers" there, "others" here\)'):
            sweep(Numbers(), None, tmp_path, name="others")

    def test_another_version_is_refused(self, tmp_path, monkeypatch):
        sweep(Numbers(), None, tmp_path)
        monkeypatch.setattr(sweep_module, "__version__", "99.0")
        with pytest.raises(ValueError, match=r'`creator` \(.* there, "scope_models 99.0" here\)'):
            sweep(Numbers(), None, tmp_path)

    def test_files_that_have_changed_are_refused(self, tmp_path):
        file = tmp_path / "motion.fits"
        file.write_text("old")
        study = Numbers(motion=str(file))
        sweep(study, None, tmp_path / "run")
        file.write_text("new")
        with pytest.raises(ValueError, match=r"differs in `contents of .*motion\.fits`"):
            sweep(study, None, tmp_path / "run")

    @pytest.mark.parametrize("name", ["results.ecsv", "summary.ecsv", "figure.png"])
    def test_folder_of_another_origin_is_refused(self, tmp_path, name):
        (tmp_path / name).write_text("mine")
        with pytest.raises(ValueError, match=f"it has {name}, but no results.sqlite"):
            sweep(Numbers(), None, tmp_path)
        assert (tmp_path / name).read_text() == "mine"

    def test_folder_with_other_files_is_used(self, tmp_path):
        (tmp_path / "study.toml").touch()
        assert sweep(Numbers(), None, tmp_path).n_computed == 8


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
@pytest.mark.parametrize("delay", [0.5, 2.0, 6.0])
def test_interrupt_of_the_terminal_is_one_line(tmp_path, delay):
    script = tmp_path / "script.py"
    script.write_text(
        "import signal\n"
        "import sys\n"
        "from scope_models.cli import main\n"
        "if __name__ == '__main__':\n"
        # A shell that starts the tests in the background lets them ignore it, and their children.
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    print('begun', flush=True)\n"
        f"    sys.exit(main(['simulate', '--table', {str(tmp_path / 't.csv')!r}, '--workers', '2',"
        f" '--output-dir', {str(tmp_path / 'out')!r}]))\n"
    )
    Table({"mag": np.linspace(11, 15, 500)}).write(tmp_path / "t.csv")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        [sys.executable, str(script)], env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    time.sleep(2 + delay)  # less can be within the imports
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert err == "scope-models: error: interrupted\n"
    assert process.returncode == 130


def kill_after(number, study, folder, workers):
    """Start an experiment in a process, and kill it when stars have been started."""
    fields = asdict(study)
    code = (
        "from sweep_studies import Numbers\n"
        "from test_sweep import experiment\n"
        f"if __name__ == '__main__':\n"
        f"    experiment(Numbers(**{fields!r}), {str(folder)!r}, {workers!r})\n"
    )
    script = folder.with_suffix(".py")
    script.write_text(code)
    paths = [str(Path(__file__).parent), *filter(None, sys.path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *paths])}  # noqa: PTH109
    process = subprocess.Popen([sys.executable, str(script)], env=environment)
    try:
        end = time.monotonic() + 60
        while len(computed(study.log)) < number:
            assert process.poll() is None, "the run ended by itself"
            assert time.monotonic() < end
            time.sleep(0.01)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


@contextlib.contextmanager
def scheduler(folder):
    """Start a scheduler with a worker, each a process; give its address and its process."""
    distributed = pytest.importorskip("distributed")
    paths = [str(Path(__file__).parent), *filter(None, sys.path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *paths])}  # noqa: PTH109
    options = {"env": environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    file = folder / "scheduler.json"
    common = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    first, second = (
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{part}", *own, *common], **options
        )
        for part, own in (
            ("scheduler", ["--port", "0"]),
            ("worker", ["--nthreads", "1", "--no-nanny"]),
        )
    )
    try:
        with distributed.Client(scheduler_file=str(file), timeout=60) as client:
            client.wait_for_workers(1, timeout=60)
        yield json.loads(file.read_text())["address"], first
    finally:
        for process in (first, second):
            process.kill()
            process.wait()


def listening(*pids):
    """Return the addresses on which processes listen, as Linux writes them."""
    sockets = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                sockets.add(str(link.readlink()))
    rows = []
    for table in ("tcp", "tcp6"):
        rows += Path(f"/proc/net/{table}").read_text(encoding="utf-8").splitlines()[1:]
    rows = [row.split() for row in rows]
    return {row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets}


def is_running(pid):
    """Return whether a process is there and not just waiting to be collected."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


class TestFailures:
    def test_are_recorded_and_the_rest_goes_on(self, tmp_path):
        study = Numbers(failing=(2, 5))
        with pytest.warns(FailedStarsWarning, match="2 stars failed, the first one, star2, with Z"):
            result = sweep(study, None, tmp_path / "run")
        assert list(result.table["index"]) == [0, 1, 3, 4, 6, 7]
        assert list(result.failures["key"]) == ["star2", "star5"]
        assert result.failures["error"][0] == "ZeroDivisionError: no star 2"
        assert 'raise ZeroDivisionError(f"no star' in result.failures["traceback"][0]
        assert json.loads(result.failures["task"][1]) == study.tasks()[5]
        assert result.failures.meta["failing"] == [2, 5]

    def test_are_written(self, tmp_path):
        study = Numbers(failing=(2,), curable=str(tmp_path / "cure"))
        with pytest.warns(FailedStarsWarning):
            result = experiment(study, tmp_path / "run")
        path = tmp_path / "run" / "failures.ecsv"
        assert result.files[-1] == path
        table = Table.read(path)
        assert table["key"][0] == "star2"
        assert json.loads(table["traceback"][0]) == result.failures["traceback"][0]
        (tmp_path / "cure").touch()
        result = experiment(study, tmp_path / "run")
        assert len(result.failures) == 0
        assert not path.exists()

    def test_all_stars(self, tmp_path):
        study = Numbers(stars=2, failing=(0, 1))
        with (
            pytest.warns(FailedStarsWarning),
            pytest.raises(SweepError, match=r"all 2 stars failed, the first one with ZeroDiv.*see"),
        ):
            experiment(study, tmp_path)
        assert len(Table.read(tmp_path / "failures.ecsv")) == 2

    @pytest.mark.parametrize("retry", [True, False])
    def test_are_tried_again_if_wanted(self, tmp_path, retry):
        cure, log = tmp_path / "cure", tmp_path / "log"
        study = Numbers(failing=(2,), curable=str(cure), log=str(log))
        with pytest.warns(FailedStarsWarning):
            sweep(study, None, tmp_path / "run")
        log.unlink()
        cure.mkdir()
        expected = contextlib.nullcontext() if retry else pytest.warns(FailedStarsWarning)
        with expected:
            result = sweep(study, None, tmp_path / "run", retry_failed=retry)
        assert computed(log) == ([2] if retry else [])
        assert len(result.table) == 7 + retry
        assert len(result.failures) == 1 - retry

    def test_exceptions_that_do_not_travel(self, pool):
        study = Numbers(failing=(2,), unpicklable=True)
        with pytest.warns(FailedStarsWarning, match="UnpicklableError"):
            result = sweep(study, pool)
        assert len(result.table) == 7

    @pytest.mark.parametrize("value", [None, [1, 2], np.arange(3), 1j])
    def test_results_that_are_no_numbers(self, value):
        class Odd(Numbers):
            def run_star(self, task):  # noqa: ARG002
                return {"spectrum": value}

        with pytest.warns(FailedStarsWarning, match="`spectrum` of a result must be a number"):
            result = sweep(Odd(stars=1))
        assert len(result.table) == 0

    @pytest.mark.parametrize(
        "value, message",
        [
            (10**5000, "`spectrum` of a result must be an integer of at most 64 bits"),
            ("\ud800", "surrogates not allowed"),
        ],
        ids=["integer", "surrogate"],
    )
    def test_results_that_no_table_can_hold(self, tmp_path, value, message):
        class Odd(Numbers):
            def run_star(self, task):
                return {"noise": 1.0, "spectrum": value if task["index"] else 1}

        with pytest.warns(FailedStarsWarning, match=message):
            result = experiment(Odd(stars=2), tmp_path)
        assert len(result.failures) == 1

    @pytest.mark.parametrize("name", ["key", "index"])
    def test_results_with_a_name_of_the_task(self, name):
        class Odd(Numbers):
            def run_star(self, task):  # noqa: ARG002
                return {name: 1}

        with pytest.warns(FailedStarsWarning, match=rf"named as a value of its task: \['{name}'\]"):
            assert list(sweep(Odd(stars=1)).failures["key"]) == ["star0"]

    @pytest.mark.parametrize(
        "message", ["x" * 5_000_000, "\ud800 \0", 10**5000], ids=["long", "surrogate", "integer"]
    )
    def test_messages_of_any_kind(self, tmp_path, message):
        class Odd(Numbers):
            def run_star(self, task):
                if task["index"]:
                    raise ValueError(message)
                return {"noise": 1.0}

        with pytest.warns(FailedStarsWarning, match="1 stars failed"):
            result = experiment(Odd(stars=2), tmp_path)
        table = Table.read(tmp_path / "failures.ecsv")
        assert table["error"][0].startswith("ValueError")
        assert len(table["error"][0]) < 1020
        assert len(result.failures["traceback"][0]) < 4020
        with pytest.warns(FailedStarsWarning, match="1 stars failed"):
            assert sweep(Odd(stars=2), None, tmp_path, retry_failed=False).n_computed == 0

    def test_process_that_dies_costs_its_own_star(self, tmp_path):
        study = Numbers(deadly=(3,))
        with pytest.warns(FailedStarsWarning, match="1 stars failed, the first one, star3, with W"):
            result = sweep(study, 1, tmp_path / "run")
        assert list(result.table["index"]) == [0, 1, 2, 4, 5, 6, 7]
        assert "the process that computed this star died" in result.failures["error"][0]

    def test_executor_that_breaks(self, tmp_path):
        log = tmp_path / "log"
        study = Numbers(stars=30, deadly=(20,), log=str(log))
        with (
            ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor,
            pytest.raises(
                SweepError,
                match=r"the workers are lost, with \d stars in flight \(star20, star21, ",
            ),
        ):
            sweep(study, executor, tmp_path / "run", in_flight=4)
        assert len(records(tmp_path / "run")) == 20

    def test_executor_that_gives_stars_up(self):
        class Weak(ThreadPoolExecutor):
            def submit(self, function, chunk):
                if chunk[0]["index"] == 4:
                    return super().submit(self._give_up)
                return super().submit(function, chunk)

            def _give_up(self):
                raise KeyError("worker lost")

        with Weak(1) as executor, pytest.warns(FailedStarsWarning, match="KeyError: 'worker lost'"):
            result = sweep(Numbers(), executor)
        assert list(result.failures["key"]) == ["star4"]

    @pytest.mark.slow
    def test_script_without_guard(self, tmp_path):
        script = tmp_path / "script.py"
        script.write_text(
            "from scope_models.batch import run_sweep\n"
            "run_sweep(abs, [{'key': 'a'}], None, 1, progress=False)\n"
        )
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        result = subprocess.run(
            [sys.executable, str(script)], env=environment, capture_output=True, text=True,
            check=False, timeout=100,
        )  # fmt: skip
        assert result.returncode == 1
        last = result.stderr.strip().splitlines()[-1]
        assert "worker processes die at their start; see their message; a script must" in last


class TestDamage:
    @pytest.mark.parametrize(
        "damage",
        [
            lambda text: text[:-20],
            lambda text: text.replace(b'"noise": ', b'"noise": 1'),
            lambda text: b"\0" * len(text),
            lambda text: text[:9] + b"\xff" + text[9:],
            lambda _: b"",
        ],
        ids=["torn", "digit", "zeros", "byte", "empty"],
    )
    def test_of_a_record_is_reported_and_computed_again(self, tmp_path, reference, damage):
        folder = tmp_path / "run"
        sweep(Numbers(), None, folder)
        with contextlib.closing(sqlite3.connect(folder / FILE)) as connection:
            connection.create_function("damage", 1, lambda text: damage(text.encode()))
            connection.execute("UPDATE stars SET record = damage(record) WHERE key = 'star7'")
            connection.commit()
        with pytest.warns(DamagedResultWarning, match=r"damaged results \('star7'\) are left out"):
            result = sweep(Numbers(), None, folder)
        assert result.n_computed == 1
        assert ecsv(result.table, tmp_path / "a.ecsv") == reference
        assert sweep(Numbers(), None, folder).n_computed == 0

    @pytest.mark.parametrize("place", [0, 30])
    def test_of_the_file(self, tmp_path, place):
        sweep(Numbers(), None, tmp_path)
        path = tmp_path / FILE
        content = bytearray(path.read_bytes())
        content[place : place + 20] = b"x" * 20
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"results\.sqlite is damaged: choose another dir"):
            sweep(Numbers(), None, tmp_path)
        assert path.read_bytes() == content

    @pytest.mark.parametrize("text", ["", "{", "[1, 2]", "3"])
    def test_of_the_configuration(self, tmp_path, text):
        sweep(Numbers(), None, tmp_path)
        with contextlib.closing(sqlite3.connect(tmp_path / FILE)) as connection:
            connection.execute("UPDATE config SET value = ?", (text,))
            connection.commit()
        with pytest.raises(ValueError, match=r"results\.sqlite is damaged: choose another dir"):
            sweep(Numbers(), None, tmp_path)
        assert len(records(tmp_path)) == 8


class TestDirectory:
    def test_without_permission(self, tmp_path, monkeypatch):
        # as root, permissions do not hold
        def refused(*_, **__):
            raise PermissionError(errno.EACCES, "Permission denied")

        log = tmp_path / "log"
        monkeypatch.setattr(Path, "mkdir", refused)
        with pytest.raises(PermissionError, match=r"cannot make the folder .*: Permission denied"):
            sweep(Numbers(log=str(log)), None, tmp_path / "run")
        assert computed(log) == []

    def test_file_without_permission(self, tmp_path, monkeypatch):
        def refused(*_, **__):
            raise sqlite3.OperationalError("unable to open database file")

        monkeypatch.setattr(sqlite3, "connect", refused)
        with pytest.raises(OSError, match=r"cannot write to .*sqlite; .* unable to open database"):
            sweep(Numbers(), None, tmp_path / "run")

    def test_is_a_file(self, tmp_path):
        (tmp_path / "run").touch()
        with pytest.raises(NotADirectoryError, match=r"cannot write to .*run: it is a file"):
            sweep(Numbers(), None, tmp_path / "run")

    @pytest.mark.parametrize("workers", [None, pytest.param(2, marks=pytest.mark.slow)])
    def test_full_disk_loses_nothing(self, tmp_path, monkeypatch, reference, workers):
        folder, add = tmp_path / "run", Store.add

        def full(store, record):
            pages = store._connection.execute("PRAGMA page_count").fetchone()[0]
            if len(store) == 5:
                store._connection.execute(f"PRAGMA max_page_count = {pages}")
                record = record | {"row": {"text": "x" * 10_000}}
            add(store, record)

        monkeypatch.setattr(Store, "add", full)
        message = "the 5 stars that are finished are kept, .* the reason is: .* full"
        with pytest.raises(OSError, match=message) as caught:
            sweep(Numbers(), workers, folder)
        assert caught.value.errno == errno.ENOSPC
        monkeypatch.undo()
        assert len(records(folder)) == 5
        result = sweep(Numbers(), None, folder)
        assert result.n_computed == 3
        assert ecsv(result.table, tmp_path / "a.ecsv") == reference

    def test_full_disk_at_the_tables(self, tmp_path, monkeypatch):
        @contextlib.contextmanager
        def full(path, **_):
            with atomic_path(path, overwrite=True):
                raise OSError(errno.ENOSPC, "No space left on device", str(path))
            yield

        with monkeypatch.context() as patch:
            patch.setattr(sweep_module, "atomic_path", full)
            with pytest.raises(OSError, match="No space left"):
                experiment(Numbers(), tmp_path)
        assert not list(tmp_path.glob("*.ecsv"))
        assert sweep(Numbers(), None, tmp_path).n_computed == 0


class TestTasks:
    def test_no_stars(self):
        with pytest.raises(ValueError, match="`tasks` must hold at least one star"):
            sweep(Numbers(stars=0))

    @pytest.mark.parametrize(
        "keys, message",
        [
            (["a", "a"], "must differ, got 'a' twice"),
            (["a/b"], "must be a short, plain name that can be a file's, got 'a/b'"),
            ([".."], "must be a short, plain name"),
            ([""], "must be a short, plain name"),
            (["a" * 201], "must be a short, plain name"),
            (["con"], "must be a short, plain name"),
            (["LPT1.part"], "must be a short, plain name"),
            (["star."], "must be a short, plain name"),
            ([3], "must be a short, plain name that can be a file's, got 3"),
        ],
    )
    def test_keys(self, keys, message):
        class Named(Numbers):
            def tasks(self):
                return [{"key": key} for key in keys]

        with pytest.raises(ValueError, match=message):
            sweep(Named())

    def test_values(self):
        class Listed(Numbers):
            def tasks(self):
                return [{"key": "a", "mags": [1, 2]}]

        with pytest.raises(TypeError, match=r"`mags` of a task must be a number or a string, got"):
            sweep(Listed())

    def test_no_function(self):
        with pytest.raises(TypeError, match="`measure` must be a function of a task, got 'table1'"):
            run_sweep("table1", [{"key": "a"}])


class TestSeeds:
    def test_depend_on_seed_key_and_purpose_only(self):
        seeds = {
            star_seed(seed, key, purpose)
            for seed in (1, 2)
            for key in ("a", "b")
            for purpose in ("", "motion")
        }
        assert len(seeds) == 8
        assert all(0 <= seed < 2**53 for seed in seeds)

    def test_generators_follow_the_seeds(self):
        first, again, other = (star_rng(1, key).random() for key in ("a", "a", "b"))
        assert first == again != other

    def test_are_fixed_forever(self):
        # Results that are on disk would not go with new ones.
        assert star_seed(1, "star0") == 3551982543959318


def test_thread_limits_end_with_the_last_sweep():
    before = blas_threads()
    with ThreadPoolExecutor(3) as executor:
        runs = [executor.submit(sweep, Numbers(stars=3, sleep=0.01 * k)) for k in range(3)]
        assert all(set(run.result().table["threads"]) == {1} for run in runs)
    assert blas_threads() == before
