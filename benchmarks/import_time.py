"""Time `import scope_models` in fresh interpreters, less an empty one, beside its dependencies."""

import statistics
import subprocess
import sys
import time

from _common import report_environment

REPEATS = 9


def seconds(code):
    """Return the median time of a fresh interpreter that runs the code."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main():
    """Print the environment and the times, less that of an empty interpreter."""
    report_environment()
    print(f"Median of {REPEATS} fresh interpreters")
    empty = seconds("pass")
    print(f"{'empty interpreter':28s} {empty:6.3f} s")
    for module in ["numpy", "astropy.modeling.models", "scope_models"]:
        print(f"import {module:21s} {seconds(f'import {module}') - empty:6.3f} s")


if __name__ == "__main__":
    main()
