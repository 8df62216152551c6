"""Throughput and memory of sweeps.

Four parts, or those that are named on the command line:

throughput
    The stars of the motion test without lightkurve's correctors and without transits (simulation,
    PLD and CDPP) in one process and in two, one after the other, several times: rates, and the
    gain of the second process. The target is 1.8. The processes have begun and have imported
    everything before the clock starts; that time is given separately.
files
    100 to 10,000 target pixel files, simulated and corrected in one process: processor time per
    file, all of it and that of the files alone, memory of the process, time of a resumed run, and
    the records of results. All must stay flat. So that many files end soon, each has 60 cadences of
    11 x 11 pixels; `--cadences` sets another number.
cost
    Files of a K2 campaign (3600 cadences) and of a TESS sector (120 s, 18,000 cadences), corrected
    with default options, a process for each mission: processor time, peak memory, bytes read and
    written, and core hours of 20,000 files.
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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from _common import report_environment
from distributed import Client, LocalCluster

from scope_models.batch import detrend_files, run_sweep, simulate_table, star_rng

sys.path.append(str(Path(__file__).parents[1] / "studies" / "paper"))
motion = importlib.import_module("motion")

REPEATS = 5
SIZES = (100, 1000, 10000)
QUIET = {"progress": False}
COSTS = {"K2": ("k2", 3600), "TESS": ("tess", 18000)}


def stars(number):
    return [{"key": f"star{index}"} for index in range(number)]


def draw(task):
    """Return a star that costs nothing: a row of 15 random numbers."""
    return {f"value{i}": v for i, v in enumerate(star_rng(1, task["key"]).random(15))}


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


def own_process(*arguments):
    """Run this script in a process of its own, because memory is a maximum so far."""
    command = [sys.executable, __file__, *map(str, arguments)]
    print(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout, end="",
          flush=True)  # fmt: skip


def size_of(folder, pattern):
    """Return the mean size of files, MiB."""
    sizes = [path.stat().st_size for path in folder.rglob(pattern)]
    return sum(sizes) / len(sizes) / 2**20


def memory():
    """Return the most memory of this process so far, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def report_files(sizes, cadences):
    print(f"Files: {cadences} cadences of 11 x 11 pixels in one process; ms of a core per file")
    print("  files  simulate  detrend  the files alone  resume  memory, MiB  results, kB/file")
    for size in sizes:
        own_process("--size", size, "--cadences", cadences)
    print()


def report_size(size, cadences):
    """Print one line about files."""
    with tempfile.TemporaryDirectory() as name:
        folder, stars = Path(name), {"mag": np.linspace(11, 15, size)}
        used = [time.process_time()]
        simulate_table(stars, folder / "pixels", cadences=cadences, sweep=QUIET)
        used.append(time.process_time())
        pixels = sorted((folder / "pixels").glob("*.fits"))
        for _ in range(2):  # the second time nothing is left to do
            result = detrend_files(pixels, folder / "out", order=1, sweep=QUIET)
            used.append(time.process_time())
        disk = (folder / "out" / "results.sqlite").stat().st_size / 1e3 / size
    assert (len(result.table), result.n_computed) == (size, 0)  # noqa: S101
    steps = 1e3 * np.diff(used) / size
    alone = 1e3 * np.mean(result.table["seconds"])
    print(f"  {size:5d} {steps[0]:9.1f} {steps[1]:8.1f} {alone:16.1f} {steps[2]:7.2f} "
          f"{memory():12.0f} {disk:16.2f}")  # fmt: skip


def report_cost(number):
    print(f"Cost: {number} simulated stars of 11 to 16 mag, default options")
    print("                             s per file   memory  file read  written  20,000 files")
    for mission in COSTS:
        own_process("--mission", mission, "--stars", number)
    print()


def report_mission(mission, number):
    """Print one line about the cost of a mission's files."""
    detector, cadences = COSTS[mission]
    with tempfile.TemporaryDirectory() as name:
        folder, stars = Path(name), {"mag": np.linspace(11, 16, number)}
        options = {"detector": detector, "cadences": cadences, "sweep": QUIET}
        # another process, because memory is a maximum so far
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
            other.submit(simulate_table, stars, folder / "pixels", **options).result()
        pixels = sorted((folder / "pixels").glob("*.fits"))
        table = detrend_files(pixels, folder / "out", sweep=QUIET).table
        read, written = size_of(folder / "pixels", "*.fits"), size_of(folder / "out", "*.fits")
    seconds = np.asarray(table["seconds"])
    title = f"{mission}, {cadences} cadences"
    hours = 20_000 * seconds.mean() / 3600
    print(f"  {title:25s} {seconds.min():5.2f}-{seconds.max():5.2f} {memory():5.0f} MiB "
          f"{read:6.1f} MiB {written:4.2f} MiB {hours:6.1f} core hours")  # fmt: skip


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
    print(f"  largest memory of the process: {memory():.0f} MiB")


def main():
    parts = ("throughput", "files", "cost", "overhead")
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(parts)} (all)")
    parser.add_argument("--stars", type=int, default=8, help="throughput, cost: stars (8)")
    parser.add_argument("--cadences", type=int, help="throughput (1000), files (60): cadences")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="files: how many")
    parser.add_argument("--empty", type=int, default=100_000, help="overhead: stars (100000)")
    parser.add_argument("--size", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--mission", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.size is not None:
        report_size(options.size, options.cadences)
        return
    if options.mission is not None:
        report_mission(options.mission, options.stars)
        return
    report_environment("distributed")
    for part in options.parts or parts:
        if part == "throughput":
            report_throughput(options.stars, options.cadences or 1000)
        elif part == "files":
            report_files(options.sizes, options.cadences or 60)
        elif part == "cost":
            report_cost(options.stars)
        elif part == "overhead":
            report_overhead(options.empty)
        else:
            parser.error(f"PART must be {', '.join(parts)}, got {part!r}")


if __name__ == "__main__":
    main()
