"""Processor time of calls with the environment's threads of linear algebra, and with one thread.

The library limits the threads itself: both times agree within 10 %. Each call has a process of its
own, which reads the number of threads when it begins; sides take turns, and the shortest counts.
The last column is the default's processor time over that of the main thread alone: 1 if no other
thread works or spins, however busy the machine is.

Run as ``python benchmarks/threads.py [FILE]``, without ``OMP_NUM_THREADS``.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from _common import report_environment

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FILE = DATA / "k2_tpf" / "ktwo211983544-c18_lpd-targ.fits.gz"
REPEATS = 3
CALLS = {
    "PLDCorrector(tpf).correct()": "PLDCorrector(tpf).correct()",
    "fit_tpf(tpf[:500], psf=1)": "fit_tpf(tpf[:500], psf=1)",
    "simulate(scene)": "simulate(stars, Detector.k2(), Motion.k2_roll(40_000), seed=1)",
    "scope-models detrend": "main(['detrend', sys.argv[1], '--output', 'lc.fits', '--overwrite'])",
}
CODE = """
import sys, time, warnings
warnings.simplefilter("ignore")
import lightkurve
from scope_models import Detector, Motion, Star, fit_tpf, simulate
from scope_models.cli import main
from scope_models.correctors import PLDCorrector
tpf = lightkurve.read(sys.argv[1])
stars = [Star(12 + i, 5 + 0.5 * i, 5) for i in range(5)]
start = time.process_time(), time.thread_time()
{call}
print(time.process_time() - start[0], time.thread_time() - start[1])
"""


def spent(call, file, folder, threads):
    """Return processor times of a call, of all threads and of the main one; with so many, s."""
    environment = {key: value for key, value in os.environ.items() if "NUM_THREADS" not in key}
    if threads:
        environment |= {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    command = [sys.executable, "-c", CODE.format(call=call), str(file)]
    result = subprocess.run(
        command, cwd=folder, env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    return tuple(map(float, result.stdout.split()[-2:]))


def main():
    file = Path(sys.argv[1] if len(sys.argv) > 1 else FILE).resolve()
    report_environment("threadpoolctl")
    print(f"{file.name}; processor time, shortest of {REPEATS} (s)")
    print(f"{'':30}{'default':>10}{'1 thread':>10}{'ratio':>8}{'threads':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for name, call in CALLS.items():
            turns = [[spent(call, file, folder, n) for n in ("", "1")] for _ in range(REPEATS)]
            free, one = (min(times) for times in zip(*turns, strict=True))
            ratios = f"{free[0] / one[0]:8.2f}{free[0] / free[1]:9.3f}"
            print(f"{name:30}{free[0]:10.2f}{one[0]:10.2f}{ratios}", flush=True)


if __name__ == "__main__":
    main()
