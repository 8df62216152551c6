"""Time of the paper's example: one star of 1000 cadences of 7 x 7 pixels, from the call to pixels.

The paper's released code needs about 69 s for it on two cores of an x86-64 machine, as measured
once; it is not run here.

Run as ``OMP_NUM_THREADS=1 python benchmarks/appendix_a.py``.
"""

import statistics
import tempfile
from pathlib import Path

from _common import report_environment, seconds

from scope_models import generate_target

REPEATS = 7


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
        taken = seconds(function, repeats=REPEATS, choose=statistics.median)
        print(f"{name:28s} {1e3 * taken:8.0f} ms")
    print("the released code, pixels      69000 ms (measured once, not in this run)")


if __name__ == "__main__":
    main()
