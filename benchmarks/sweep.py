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
    resuming, and making the table.

Run as ``OMP_NUM_THREADS=1 python benchmarks/sweep.py [PART ...]`` on a quiet machine.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from _common import report_environment
from distributed import Client, LocalCluster
from scope_models.experiments.study import Study

from scope_models import Detector, Motion, Star, simulate
from scope_models.experiments import make_study, run_sweep

REPEATS = 5
SIZES = (10, 100, 1000, 10000)


@dataclass(frozen=True, kw_only=True)
class Draws(Study):
    """Stars that cost nothing: a row of 15 random numbers."""

    name: ClassVar[str] = "draws"
    grid: ClassVar[dict] = {"index": "stars"}
    key: ClassVar[str] = "star{index}"
    stars: int = 10

    def run_star(self, task):
        values = self.star_rng(task["key"]).random(15)
        return {f"value{i}": value for i, value in enumerate(values)}

    def summarize(self, table):
        return table

    def draw(self, table, summary):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Small(Draws):
    """Stars that cost little: 100 cadences of 7 x 7 pixels, and their scatter."""

    name: ClassVar[str] = "small"

    def run_star(self, task):
        seed = self.star_seed(task["key"])
        detector, motion = Detector.k2(shape=(7, 7)), Motion.still(100)
        flux = simulate(Star(12.0), detector, motion, seed=seed).flux.sum(axis=(1, 2))
        values = np.percentile(flux, np.linspace(0, 100, 14))
        return {"scatter": flux.std()} | {f"value{i}": value for i, value in enumerate(values)}


def light_study(stars, cadences, magnitudes, scales):
    """Return stars of the motion test, for which lightkurve does nothing."""
    return make_study(
        "motion",
        {
            "magnitudes": magnitudes,
            "scales": scales,
            "stars": stars,
            "cadences": cadences,
            "lightkurve_pld": False,
            "lightkurve_sff": False,
            "transit_scales": (),
        },
    )


def processes(number):
    """Return a client of so many processes of Dask on this machine."""
    local = {"host": "127.0.0.1", "dashboard_address": None, "memory_limit": 0}
    return Client(LocalCluster(n_workers=number, threads_per_worker=1, **local))


def report_throughput(stars, cadences):
    magnitudes, scales = (10.0, 12.0, 14.0, 15.5), (1.0, 5.0)
    study = light_study(stars, cadences, magnitudes, scales)
    n_stars = len(study.tasks())
    print(f"Throughput: {n_stars} stars of {cadences} cadences, simulated, de-trended, measured")
    print("  one process: s, stars/s;   two processes: s, stars/s;   gain;   load at the beginning")
    with processes(1) as one, processes(2) as two:
        for client, number in ((one, 1), (two, 2)):
            began = time.perf_counter()
            run_sweep(replace(study, seed=2, stars=1), None, client, progress=False)
            print(f"  the first 8 stars of {number} processes, with all imports: "
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
        result = run_sweep(study, folder, client, progress=False)
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
        result = run_sweep(Small(stars=size), folder, 2, progress=False)
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
    study = Draws(stars=size)
    with tempfile.TemporaryDirectory() as folder:
        for title in ("computed, kept, table made", "resumed: read, table made"):
            began, processor = time.perf_counter(), time.process_time()
            result = run_sweep(study, folder, progress=False)
            taken, used = time.perf_counter() - began, time.process_time() - processor
            print(f"  {title:28s} {taken:6.1f} s, {used:6.1f} s of a core: "
                  f"{1e3 * used / size:.3f} ms per star")  # fmt: skip
        print(f"  on disk: {(Path(folder) / 'results.sqlite').stat().st_size / 1e6:.1f} MB")
        began = time.perf_counter()
        path = Path(folder) / "results.ecsv"
        result.table.write(path)
        print(f"  results.ecsv: {time.perf_counter() - began:.1f} s, "
              f"{path.stat().st_size / 1e6:.1f} MB")  # fmt: skip
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
