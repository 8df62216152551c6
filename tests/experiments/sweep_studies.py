"""Studies for the tests of sweeps; worker processes import this module."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from threadpoolctl import threadpool_info

from scope_models.experiments.study import Study

# Other modules are imported where they are used, so that worker processes begin soon.


def blas_threads():
    """Return the number of threads of each library of linear algebra."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@dataclass(frozen=True, kw_only=True)
class Numbers(Study):
    """Stars that are random numbers, with ways to go wrong."""

    name: ClassVar[str] = "numbers"
    units: ClassVar[dict] = {"noise": "ppm"}

    stars: int = 8
    log: str = ""
    sleep: float = 0.0
    failing: tuple[int, ...] = ()
    deadly: tuple[int, ...] = ()
    curable: str = ""
    unpicklable: bool = False
    motion: str = ""

    def input_files(self):
        return [self.motion] if self.motion else []

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
        rng = self.star_rng(task["key"])
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

    def draw(self, table, summary):  # noqa: ARG002
        from matplotlib.figure import Figure

        figure = Figure()
        figure.subplots().plot(table["mag"], table["noise"])
        return figure


class UnpicklableError(Exception):
    """An exception that cannot be sent to another process."""


@dataclass(frozen=True, kw_only=True)
class Pixels(Study):
    """Stars with pixels."""

    name: ClassVar[str] = "pixels"

    stars: int = 2

    def tasks(self):
        return [{"key": f"star{i}", "mag": 12.0 + i} for i in range(self.stars)]

    def observation(self, task):
        from scope_models import Detector, Motion, Star, simulate

        detector = Detector.k2(shape=(5, 5))
        seed = self.star_seed(task["key"])
        return simulate(Star(task["mag"]), detector, Motion.still(30), seed=seed)

    def measure(self, task, observation):  # noqa: ARG002
        return {"flux": observation.flux.sum()}

    def summarize(self, table):
        return table

    def draw(self, table, summary):  # noqa: ARG002
        from matplotlib.figure import Figure

        return Figure()
