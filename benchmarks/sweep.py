"""Throughput and memory of sweeps.

Three parts, or those that are named on the command line:

throughput
    The stars of the motion test without lightkurve's correctors and without transits (simulation,
    PLD and CDPP) in one process and in two, one after the other, several times: rates, and the
    gain of the second process. The target is 1.8. The processes have begun and have imported
    everything before the clock starts; that time is given separately.
scaling
    10 to 10,000 stars in two processes: rate, memory of all processes and what is on disk. Memory
    must stay flat. So that many stars end soon, each is 100 cadences of 7 x 7 pixels, and nothing
    is de-trended.
overhead
    100,000 stars that cost nothing, so that what is left is the sweep itself: keeping the stars,
    resuming, and writing the table.

Run as ``OMP_NUM_THREADS=1 python benchmarks/sweep.py [PART ...]`` on a quiet machine.
"""

import argparse
import importlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from _common import report_environment
from distributed import Client, LocalCluster

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import run_sweep, star_rng, star_seed

sys.path.append(str(Path(__file__).parents[1] / "studies" / "paper"))
motion = importlib.import_module("motion")

REPEATS = 5
SIZES = (10, 100, 1000, 10000)


def stars(number):
    return [{"key": f"star{index}"} for index in range(number)]


def draw(task):
    """Return a star that costs nothing: a row of 15 random numbers."""
    return {f"value{i}": v for i, v in enumerate(star_rng(1, task["key"]).random(15))}


def small(task):
    """Return a star that costs little: 100 cadences of 7 x 7 pixels, and their scatter."""
    detector, still = Detector.k2(shape=(7, 7)), Motion.still(100)
    observation = simulate(Star(12.0), detector, still, seed=star_seed(1, task["key"]))
    flux = observation.flux.sum(axis=(1, 2))
    values = np.percentile(flux, np.linspace(0, 100, 14))
    return {"scatter": flux.std()} | {f"value{i}": value for i, value in enumerate(values)}


def light_study(number, cadences, magnitudes, scales):
    """Return stars of the motion test, for which lightkurve does nothing."""
    return motion.MotionTest(
        magnitudes=magnitudes, scales=scales, stars=number, cadences=cadences,
        lightkurve_pld=False, lightkurve_sff=False, transit_scales=(),
    )  # fmt: skip


def sweep_study(study, folder, client):
    tasks = motion.tasks(study)
    return run_sweep(partial(motion.measure, study), tasks, folder, client, progress=False)


def processes(number):
    """Return a client of so many processes of Dask on this machine."""
    local = {"host": "127.0.0.1", "dashboard_address": None, "memory_limit": 0}
    return Client(LocalCluster(n_workers=number, threads_per_worker=1, **local))


def report_throughput(number, cadences):
    magnitudes, scales = (10.0, 12.0, 14.0, 15.5), (1.0, 5.0)
    study = light_study(number, cadences, magnitudes, scales)
    n_stars = len(motion.tasks(study))
    print(f"Throughput: {n_stars} stars of {cadences} cadences, simulated, de-trended, measured")
    print("  one process: s, stars/s;   two processes: s, stars/s;   gain;   load at the beginning")
    with processes(1) as one, processes(2) as two:
        for client, workers in ((one, 1), (two, 2)):
            began = time.perf_counter()
            sweep_study(replace(study, seed=2, stars=1), None, client)
            print(f"  the first 8 stars of {workers} processes, with all imports: "
                  f"{time.perf_counter() - began:.1f} s")  # fmt: skip
        gains = []
        for _ in range(REPEATS):
            load = os.getloadavg()[0]
            single, double = (clock(study, client) for client in (one, two))
            gains.append(single / double)
            print(f"  {single:6.2f} {n_stars / single:7.2f}   {double:6.2f} {n_stars / double:7.2f}"
                  f"   {gains[-1]:5.2f}   {load:.1f}", flush=True)  # fmt: skip
            rate = n_stars / double
    print(f"  gain: best {max(gains):.2f}, median {np.median(gains):.2f}")
    print(f"  last pair: {rate * cadences:,.0f} stars x cadences per second in two processes\n")


def clock(study, client):
    """Return the seconds that a sweep takes."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        result = sweep_study(study, folder, client)
    assert len(result.failures) == 0  # noqa: S101
    return time.perf_counter() - began


def report_scaling(sizes):
    print("Scaling: stars of 100 cadences in two processes, all times with the start")
    print("  stars        s  stars/s   largest memory, MiB: parent, worker   on disk, kB/star")
    for size in sizes:  # each in a process of its own, because memory is a maximum so far
        command = [sys.executable, __file__, "--size", str(size)]
        print(subprocess.run(command, check=True, capture_output=True, text=True).stdout, end="",
              flush=True)  # fmt: skip
    print()


def report_size(size):
    """Print one line of the scaling."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        result = run_sweep(small, stars(size), folder, 2, progress=False)
        taken = time.perf_counter() - began
        disk = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    assert len(result.table) == size  # noqa: S101
    own, workers = (
        resource.getrusage(who).ru_maxrss / 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    print(f"  {size:5d} {taken:8.1f} {size / taken:8.1f} {own:29.0f} {workers:7.0f}"
          f" {disk / size / 1e3:18.2f}")  # fmt: skip


def report_overhead(size):
    print(f"Overhead: {size} stars that cost nothing, in this process")
    with tempfile.TemporaryDirectory() as folder:
        for title in ("computed, kept, table written", "resumed: read, table written"):
            began, processor = time.perf_counter(), time.process_time()
            run_sweep(draw, stars(size), folder, progress=False)
            taken, used = time.perf_counter() - began, time.process_time() - processor
            print(f"  {title:30s} {taken:6.1f} s, {used:6.1f} s of a core: "
                  f"{1e3 * used / size:.3f} ms per star")  # fmt: skip
        print(f"  on disk: {(Path(folder) / 'results.sqlite').stat().st_size / 1e6:.1f} MB")
        print(f"  results.ecsv: {(Path(folder) / 'results.ecsv').stat().st_size / 1e6:.1f} MB")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"  largest memory of the process: {memory:.0f} MiB")


def main():
    parts = ("throughput", "scaling", "overhead")
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(parts)} (all)")
    parser.add_argument("--stars", type=int, default=8, help="throughput: stars per cell (8)")
    parser.add_argument("--cadences", type=int, default=1000, help="throughput: cadences (1000)")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="scaling: stars")
    parser.add_argument("--empty", type=int, default=100_000, help="overhead: stars (100000)")
    parser.add_argument("--size", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.size is not None:
        report_size(options.size)
        return
    report_environment("distributed")
    for part in options.parts or parts:
        if part == "throughput":
            report_throughput(options.stars, options.cadences)
        elif part == "scaling":
            report_scaling(options.sizes)
        elif part == "overhead":
            report_overhead(options.empty)
        else:
            parser.error(f"PART must be {', '.join(parts)}, got {part!r}")


if __name__ == "__main__":
    main()
