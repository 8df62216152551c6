"""What benchmarks share: the line about the machine and the versions, a clock, and memory."""

import importlib
import os
import platform
import sys
import time
import tracemalloc
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "docs" / "data"))
from _stamp import version

__all__ = ["peak_memory", "report_environment", "seconds"]


def report_environment(*packages):
    """Print the machine, the number of threads, the commit, and the versions of packages."""
    sys.stdout.reconfigure(line_buffering=True)
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    print(f"{machine}, OMP_NUM_THREADS {threads}")
    names = ("numpy", "scipy", "astropy", *packages)
    modules = {name: importlib.import_module(name) for name in names}
    versions = ", ".join(f"{name} {module.__version__}" for name, module in modules.items())
    print(f"Python {platform.python_version()}, scope_models {version()}, {versions}\n")


def seconds(*functions, repeats=5, choose=min, clock=time.process_time):
    """Return the shortest of several times of each function, called in turn; of one, a number."""
    times = [[] for _ in functions]
    for _ in range(repeats):
        for function, spent in zip(functions, times, strict=True):
            start = clock()
            function()
            spent.append(clock() - start)
    chosen = [choose(spent) for spent in times]
    return chosen[0] if len(chosen) == 1 else chosen


def peak_memory(function):
    """Return the largest memory that Python holds in a call, MB."""
    tracemalloc.start()
    function()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6
