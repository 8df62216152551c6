"""Time and memory of simulating stars and writing their target pixel files.

The targets: one star, 3,600 cadences of 11 x 11 pixels, all noise terms, simulated and written 1.3
times as fast as at commit 19e5c3d; 1,000 cadences of 9 x 9 pixels without noise in 0.4 of the time
of photutils' circular Gaussian, each called ten times in a row; a default fit of 3,600 cadences in
3 s; 1,000 TESS cadences of 11 x 11 pixels with 20 stars and all effects in 2 s; memory below three
times the result; cost linear in cadences, stars and pixels.

Run as ``OMP_NUM_THREADS=1 python benchmarks/simulate.py``. With ``--against FOLDER``, another
checkout of the package, both are timed in turn, and only the first three are printed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
from _common import report_environment, seconds
from astropy.coordinates import SkyCoord
from photutils.psf import CircularGaussianPRF

from scope_models import BivariateGaussianPSF, Detector, Motion, Scene, Star, fit_tpf, simulate

N_CADENCES = 3600
REPEATS = 7
NOISE_TERMS = ("photon", "background", "read", "quantization")
ROUNDS = 6


def measure_speed():
    """Return seconds of the processor by what was done; public names of all versions only."""
    star, detector, motion = Star(12.0), Detector.k2(), Motion.k2_roll(N_CADENCES)
    tilted = star.replace(psf=BivariateGaussianPSF(rho=0.4))
    small = Detector.k2(shape=(9, 9)), motion[:1000]
    rows = {
        "simulated, default noise": lambda: simulate(star, detector, motion, seed=1),
        "simulated, all noise terms": lambda: simulate(
            star, detector, motion, seed=1, noise=NOISE_TERMS
        ),
        "simulated, no noise": lambda: simulate(star, detector, motion, seed=1, noise=False),
        "simulated, PSF with rho = 0.4": lambda: simulate(tilted, detector, motion, seed=1),
        "1000 x 9 x 9 pixels, no noise": lambda: simulate(star, *small, seed=1, noise=False),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "star.fits"
        observation = simulate(star, detector, motion, seed=1, noise=NOISE_TERMS)
        rows["written, star.fits"] = lambda: observation.write(path, overwrite=True)
        for name in ("star.fits", "star.fits.gz"):
            rows[f"simulated and written, {name}"] = lambda path=Path(folder) / name: simulate(
                star, detector, motion, seed=1, noise=NOISE_TERMS
            ).write(path, overwrite=True)
        return {name: seconds(function, repeats=REPEATS) for name, function in rows.items()}


def report_speed():
    print(f"One star, {N_CADENCES} cadences of 11 x 11 pixels")
    for name, taken in measure_speed().items():
        print(f"  {name:36s} {1e3 * taken:7.1f} ms of a core: {1 / taken:5.1f} per second")


def compare(folder):
    """Time this checkout and another one in turn, and print both."""
    here = Path(__file__).resolve().parents[1]
    times = {}
    for _ in range(ROUNDS):
        for name, place in (("before", folder), ("after", here)):
            environment = os.environ | {"PYTHONPATH": str(Path(place).resolve())}
            command = [sys.executable, "-W", "ignore", __file__, "--json"]
            output = subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            ).stdout
            for row, taken in json.loads(output).items():
                times.setdefault(row, {}).setdefault(name, []).append(taken)
    print(f"One star, {N_CADENCES} cadences of 11 x 11 pixels: ms of a core")
    print(f"  {'':36s}  before   after  ratio")
    for row, both in times.items():
        before, after = (1e3 * min(both[name]) for name in ("before", "after"))
        print(f"  {row:36s} {before:7.1f} {after:7.1f}  {before / after:5.2f}")


def in_a_row(n, function, *arguments, **options):
    for _ in range(n):
        function(*arguments, **options)


def report_goals():
    """Print times beside photutils' model of the same pixels, and that of a default fit."""
    motion, side = Motion.k2_roll(1000), 9
    detector = Detector.k2(shape=(side, side))
    y, x = (np.tile(p.ravel(), len(motion)) for p in np.mgrid[:side, :side].astype(float))
    places = (np.repeat(side // 2 + values, side**2) for values in (motion.x, motion.y))
    arguments, star, prf = (x, y, 1.0, *places, 1.2), Star(12.0), CircularGaussianPRF()
    print("\n1000 x 9 x 9 pixels, no noise; photutils' CircularGaussianPRF; 16 cadences: the setup")
    print("The goal is for calls in a row; a single call finds the other's arrays in the caches.")
    for n in (10, 1):
        ours, setup = (
            partial(in_a_row, n, simulate, star, detector, part, seed=1, noise=False)
            for part in (motion, motion[:16])
        )
        theirs = partial(in_a_row, n, prf.evaluate, *arguments)
        calls = ours, theirs, setup, theirs  # theirs before each of ours
        for clock in (time.process_time, time.perf_counter):
            taken = [1e3 * t / n for t in seconds(*calls, repeats=400 // n, clock=clock)]
            times = ", ".join(f"{each:.2f} ms" for each in taken[:3])
            turns = f"in turns of {n:2d} calls, {clock.__name__:12s}"
            print(f"  {turns}: {times}, ratio {taken[0] / taken[1]:.2f}")
    tpf = simulate(Star(12.0), Detector.k2(), Motion.k2_roll(N_CADENCES), seed=1).to_tpf()
    fit = seconds(lambda: fit_tpf(tpf), repeats=3)
    print(f"Default fit of {N_CADENCES} cadences of 11 x 11 pixels: {fit:.2f} s of a core")


def report_effects():
    from scope_models import effects

    rng = np.random.default_rng(1)
    time_ = 1325.0 + np.arange(1000) * 120 / 86400
    motion = Motion(time_, *(0.02 * rng.standard_normal((2, 1000))), time_format="btjd")
    stars = [Star(mag, *rng.uniform(0, 10, 2)) for mag in rng.uniform(9, 15, 20)]
    every = [
        effects.Focus(0.01, period=0.5),
        effects.Jitter(0.05, 10.0),
        effects.Background(10.0, drift=0.1),
        effects.ScatteredLight(),
        effects.Argabrightening(),
        effects.CosmicRays(pixel_size=15.0, rejection=True),
        effects.Throughput(0.01),
        effects.SensitivityDropouts(0.01),
        effects.Gaps([(1325.2, 1325.3)]),
        effects.Smear(),
        effects.DarkCurrent(),
        effects.BrighterFatter(full_well=2e5),
        effects.Undershoot(),
        effects.ChargeTransferInefficiency(),
        effects.RollingBands(rate=1.0),
    ]
    print("\nEffects: 1000 TESS cadences of 11 x 11 pixels with 20 stars, ms of a core")
    cases = {"none": []} | {type(effect).__name__: [effect] for effect in every} | {"all": every}
    for name, some in cases.items():
        taken = seconds(
            partial(simulate, stars, Detector.tess(), motion, seed=1, effects=some), repeats=3
        )
        print(f"  {name:20s} {1e3 * taken:7.1f}")


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
        taken = seconds(partial(simulate, stars, detector, motion, seed=1))
        per_item = 1e9 * taken / (n * n_stars * side**2)
        print(f"  {n:8d}  {n_stars:5d}  {side:2d} x {side:2d}  {1e3 * taken:8.1f}  {per_item:5.1f}")


def report_field():
    print("\nA catalog: 100 cadences of 100 x 100 pixels with 500 stars")
    rng, coord = np.random.default_rng(1), SkyCoord(150.0, 10.0, unit="deg")
    ra, dec = 150 + (rng.random((2, 500)) - 0.5) * 100 * 3.98 / 3600
    table = {"ra": ra, "dec": dec - 140, "mag": rng.uniform(12, 18, 500)}
    arguments = table, coord, Detector.k2(shape=(100, 100)), Motion.k2_roll(100)
    options = {"target": Star(12.0), "seed": 1}
    scene = Scene.from_catalog(*arguments, **options)
    for name, call in (
        ("scene of the catalog", lambda: Scene.from_catalog(*arguments, **options)),
        ("simulated", lambda: simulate(scene)),
    ):
        print(f"  {name:24s} {seconds(call, repeats=3):7.2f} s")


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
    """Return whether a field of an observation is a cube with memory of its own."""
    return isinstance(value, np.ndarray) and value.base is None


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--against", metavar="FOLDER", help="another checkout to compare with")
    parser.add_argument("--json", action="store_true", help="print the speed alone, as JSON")
    options = parser.parse_args()
    if options.json:
        print(json.dumps(measure_speed()))
        return
    report_environment()
    if options.against:
        compare(options.against)
        report_goals()
        return
    report_speed()
    report_effects()
    report_scaling()
    report_field()
    report_memory()


if __name__ == "__main__":
    main()
