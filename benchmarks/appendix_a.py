"""Time of the paper's example: one star of 1000 cadences of 7 x 7 pixels, from the call to pixels.

The paper's released code needs about 69 s for it on two cores of an x86-64 machine, as measured
once; it is not run here.

Run as ``OMP_NUM_THREADS=1 python benchmarks/appendix_a.py``.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from _common import report_environment

from scope_models import generate_target

REPEATS = 7


def seconds(function):
    """Return the median of several processor times."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return np.median(times)


def main():
    report_environment()
    star = generate_target(seed=1)
    path = Path(tempfile.mkdtemp()) / "star.fits"
    steps = {
        "pixels with noise": lambda: generate_target(seed=1).targetpixelfile,
        "target pixel file written": lambda: star.write(path, overwrite=True),
        "PLD, order 2": star.detrend,
    }
    print("1000 cadences of 7 x 7 pixels, median of 7, processor time")
    for name, function in steps.items():
        print(f"{name:28s} {1e3 * seconds(function):8.0f} ms")
    print("the released code, pixels      69000 ms (measured once, not in this run)")


if __name__ == "__main__":
    main()
