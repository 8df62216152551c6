"""Stars for the tests of sweeps; worker processes import this module."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from scope_models.batch import star_rng

# Other modules are imported where they are used, so that worker processes begin soon.


def blas_threads():
    """Return the number of threads of each library of linear algebra."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Stars that are random numbers, with ways to go wrong."""

    seed: int = 1
    stars: int = 8
    log: str = ""
    sleep: float = 0.0
    failing: tuple[int, ...] = ()
    deadly: tuple[int, ...] = ()
    curable: str = ""
    unpicklable: bool = False
    motion: str = ""

    def tasks(self):
        return [{"key": f"star{i}", "mag": 10 + 0.5 * i, "index": i} for i in range(self.stars)]

    def run_star(self, task):
        if self.log:
            with Path(self.log).open("a") as file:
                file.write(f"{task['index']} {os.getpid()}\n")
        if self.sleep:
            time.sleep(self.sleep)
        if task["index"] in self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        if task["index"] in self.failing and not (self.curable and Path(self.curable).exists()):
            if self.unpicklable:
                raise UnpicklableError(lambda: None)
            raise ZeroDivisionError(f"no star {task['index']}")
        rng = star_rng(self.seed, task["key"])
        matrix = rng.normal(size=(60, 60))
        return {
            "noise": float(np.linalg.slogdet(matrix @ matrix.T)[1]) / 3,
            "undefined": np.nan,
            "count": rng.integers(100),
            "name": f'nöise, "{task["index"]}"\n',
            "good": np.bool_(task["index"] % 2),
            "threads": max(blas_threads()),
        }

    def summarize(self, table):
        from astropy.table import Table

        return Table({"mean": [np.mean(table["noise"])]})

    def draw(self, table, summary):
        from matplotlib.figure import Figure

        figure = Figure()
        figure.subplots().plot(table["mag"], table["noise"] / summary["mean"])
        return figure


class UnpicklableError(Exception):
    """An exception that cannot be sent to another process."""


def write_rows(folder, numbers):
    """Write stars of a Parquet data set, as a worker of `detrend_files` does."""
    from scope_models.batch.results import DATA_SET, write_star

    for n in numbers:
        key, time = f"star{n:05d}", np.arange(20.0) + n
        curve = np.rec.fromarrays([time, 2 * time], dtype=[("TIME", "f8"), ("FLUX", ">f4")])
        output = f"{DATA_SET}/campaign=c{n % 4:02d}/channel={n % 10}/{key}.parquet"
        write_star(Path(folder) / output, {"key": key, "output": output, "mag": n / 1e3}, curve)
