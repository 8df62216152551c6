"""The line about the machine and the versions that every benchmark prints first."""

import importlib
import os
import platform
import sys

__all__ = ["report_environment"]


def report_environment(*packages):
    """Print the machine, the number of threads, and the versions of packages."""
    sys.stdout.reconfigure(line_buffering=True)
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    print(f"{machine}, OMP_NUM_THREADS {threads}")
    names = ("scope_models", "numpy", "scipy", "astropy", *packages)
    modules = {name: importlib.import_module(name) for name in names}
    versions = ", ".join(f"{name} {module.__version__}" for name, module in modules.items())
    print(f"Python {platform.python_version()}, {versions}\n")
