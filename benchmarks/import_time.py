"""Time `import scope_models` in fresh interpreters, less an empty one, beside its dependencies."""

import statistics
import subprocess
import sys
import time
from functools import partial

from _common import report_environment, seconds

REPEATS = 9


def fresh(code):
    """Return the median time of a fresh interpreter that runs the code."""
    command = partial(subprocess.run, [sys.executable, "-c", code], check=True)
    return seconds(command, repeats=REPEATS, choose=statistics.median, clock=time.perf_counter)


def main():
    """Print the environment and the times, less that of an empty interpreter."""
    report_environment()
    print(f"Median of {REPEATS} fresh interpreters")
    empty = fresh("pass")
    print(f"{'empty interpreter':28s} {empty:6.3f} s")
    for module in ["numpy", "astropy.modeling.models", "scope_models"]:
        print(f"import {module:21s} {fresh(f'import {module}') - empty:6.3f} s")


if __name__ == "__main__":
    main()
