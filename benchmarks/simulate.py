"""Time and memory of simulating stars and writing their target pixel files.

The targets: one star, 3,600 cadences of 11 x 11 pixels, all noise terms, on one core: at least 15
stars per second simulated and 6 simulated and written; memory below three times the result; cost
linear in cadences, stars and pixels.

Run as ``OMP_NUM_THREADS=1 python benchmarks/simulate.py``.
"""

import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np
from _common import report_environment

from scope_models import BivariateGaussianPSF, Detector, Motion, Star, simulate
from scope_models.effects.noise import NOISE_TERMS

N_CADENCES = 3600
REPEATS = 7


def seconds(function, repeats=REPEATS):
    """Return the shortest of several times: on the clock, and of the processor."""
    times = []
    for _ in range(repeats):
        clock, processor = time.perf_counter(), time.process_time()
        function()
        times.append((time.perf_counter() - clock, time.process_time() - processor))
    return np.min(times, axis=0)


def report_speed(motion):
    star, detector = Star(12.0), Detector.k2()
    print(f"One star, {len(motion)} cadences of 11 x 11 pixels")
    rows = {
        "simulated, default noise": lambda: simulate(star, detector, motion, seed=1),
        "simulated, all noise terms": lambda: simulate(
            star, detector, motion, seed=1, noise=NOISE_TERMS
        ),
        "simulated, no noise": lambda: simulate(star, detector, motion, seed=1, noise=False),
    }
    tilted = star.replace(psf=BivariateGaussianPSF(rho=0.4))
    rows["simulated, PSF with rho = 0.4"] = lambda: simulate(tilted, detector, motion, seed=1)
    for name, function in rows.items():
        print_rate(name, seconds(function))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "star.fits"
        observation = simulate(star, detector, motion, seed=1, noise=NOISE_TERMS)

        def write():
            observation.write(path, overwrite=True)

        def both():
            observation = simulate(star, detector, motion, seed=1, noise=NOISE_TERMS)
            observation.write(path, overwrite=True)

        print_rate("written", seconds(write))
        print_rate("simulated (all terms) and written", seconds(both))


def print_rate(name, times):
    clock, processor = times
    print(
        f"  {name:36s} {1e3 * clock:7.1f} ms, {1e3 * processor:7.1f} ms of a core:"
        f" {1 / processor:5.1f} per second and core"
    )


def report_scaling():
    print("\nScaling: time over cadences x stars x pixels, ns; constant if the cost is linear")
    print("  cadences  stars  pixels        ms   ns")
    for n, n_stars, side in [
        *((n, 1, 11) for n in (450, 900, 1800, 3600, 7200)),
        *((1800, n_stars, 11) for n_stars in (2, 4, 8)),
        *((1800, 1, side) for side in (7, 15, 21, 31)),
    ]:
        motion, detector = Motion.k2_roll(n), Detector.k2(shape=(side, side))
        stars = [Star(12.0)] * n_stars
        taken = seconds(lambda: simulate(stars, detector, motion, seed=1), 5)[1]  # noqa: B023
        per_item = 1e9 * taken / (n * n_stars * side**2)
        print(f"  {n:8d}  {n_stars:5d}  {side:2d} x {side:2d}  {1e3 * taken:8.1f}  {per_item:5.1f}")


def report_memory():
    print("\nMemory: peak of a simulation over the size of its cubes")
    for n in (1000, 4000, 16000):
        motion = Motion.k2_roll(n)
        tracemalloc.start()
        observation = simulate(Star(12.0), Detector.k2(), motion, seed=1, noise=NOISE_TERMS)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        result = sum(cube.nbytes for cube in vars(observation).values() if is_cube(cube))
        print(f"  {n:6d} cadences  {peak / 2**20:7.1f} MiB / {result / 2**20:6.1f} MiB", end="")
        print(f" = {peak / result:.2f}")


def is_cube(value):
    """Tell whether a field of an observation is a cube with memory of its own."""
    return isinstance(value, np.ndarray) and value.base is None


def main():
    report_environment()
    report_speed(Motion.k2_roll(N_CADENCES))
    report_scaling()
    report_memory()


if __name__ == "__main__":
    main()
