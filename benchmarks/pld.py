"""Time and memory of PLDCorrector, beside lightkurve's PLDCorrector in the same run.

First the calls without arguments, by the clock, of stars of the messy sky: with the environment's
default threads at most twice lightkurve's time at one and three times K2's motion, four times for
eclipsing stars, faint ones at 5x, and 10x. Then the same aperture, of 40 pixels, and order: time of
the processor, memory that Python holds, and noise of the corrected star, which is constant. Then
the growth of ours with cadences.

Run as ``python benchmarks/pld.py``, and with ``OMP_NUM_THREADS=1`` in the environment.
"""

import itertools
import logging
import resource
import time
import warnings
from functools import partial

import numpy as np
from _common import peak_memory, report_environment, seconds

from scope_models import Detector, Motion, Star, simulate
from scope_models.benchmark import make_sky
from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp

REPEATS = 5
REGIMES = ("k2-1x-constant", "k2-1x-spots-5d", "k2-3x-constant", "k2-3x-focus-spots-5d")
REGIMES += ("k2-1x-eclipsing", "k2-1x-rr-lyrae", "k2-5x-kp15", "k2-10x-constant", "k2-10x-spots-5d")
REGIMES += ("kepler-constant-kp14", "tess-constant")


def make_tpf(n, scale=3.0):
    """Return the target pixel file of a star of 12th magnitude on 9 x 9 pixels."""
    motion = scale * Motion.k2_roll(n, seed=10)
    return simulate(Star(12.0), Detector.k2(shape=(9, 9)), motion, seed=1).to_tpf()


def make_short_tpf(n, scale=3.0):
    """Return the same star in short cadence."""
    long = scale * Motion.k2_roll(n // 30 + 2, seed=10)
    time = long.time[0] + 58.85 / 86400 * np.arange(n)
    x, y = np.interp(time, long.time, long.x), np.interp(time, long.time, long.y)
    detector = Detector.k2(shape=(9, 9), cadence="short")
    return simulate(Star(12.0), detector, Motion.from_arrays(time, x, y), seed=1).to_tpf()


def make_aperture():
    mask = np.zeros((9, 9), dtype=bool)
    mask[2:7, 1:] = True
    return mask


def correct(tpf, order=2):
    return PLDCorrector(tpf, make_aperture()).correct(order)


def correct_by_default(corrector, tpf):
    return corrector(tpf).correct()


def correct_with_lightkurve(tpf, order=2):
    from lightkurve.correctors import PLDCorrector as LightkurveCorrector

    corrector = LightkurveCorrector(tpf, make_aperture())
    return corrector.correct(pld_order=order, pld_aperture_mask=make_aperture())


def report_defaults(cadences=3600):
    from lightkurve.correctors import PLDCorrector as LightkurveCorrector

    print(f"Calls without arguments, {cadences} cadences, median of {REPEATS}, by the clock")
    print("star                       ours (s)  other (s)  ratio")
    for name in REGIMES:
        tpf = make_sky(name, 1, n_cadences=cadences).to_tpf()
        ways = [partial(correct_by_default, k, tpf) for k in (PLDCorrector, LightkurveCorrector)]
        clock = {"repeats": REPEATS, "choose": np.median, "clock": time.perf_counter}
        ours, other = seconds(*ways, **clock)
        print(f"{name:26} {ours:8.2f} {other:10.2f} {ours / other:6.2f}", flush=True)
    print()


def report_against_lightkurve():
    print(f"{make_aperture().sum()} aperture pixels; corrector made and run, shortest of {REPEATS}")
    print(f"{'':24} {'noise (ppm)':>14} {'time (s)':>13} {'ratio':>6} {'memory (MB)':>12}")
    print("cadences  motion  order      ours  other   ours  other           ours other")
    for n, scale, order in itertools.product((1000, 3600), (1, 3), (1, 2, 3)):
        tpf = make_tpf(n, scale)
        ways = [partial(way, tpf, order) for way in (correct, correct_with_lightkurve)]
        noise = [cdpp(way(), method="everest") for way in ways]
        ours, other = seconds(*ways, repeats=REPEATS)
        memory = [peak_memory(way) for way in ways]
        print(
            f"{n:8d} {scale:6d}x {order:6d} {noise[0]:11.1f} {noise[1]:6.1f} {ours:6.2f} "
            f"{other:6.2f} {ours / other:6.2f} {memory[0]:6.0f} {memory[1]:5.0f}",
            flush=True,
        )


def report_growth():
    print("\nShort cadences, order 2, ours")
    print("cadences   time (s)   per 1000 cadences (ms)   peak memory of the process (MiB)")
    for n in (2500, 5000, 10_000, 20_000, 40_000):
        spent = seconds(partial(correct, make_short_tpf(n)), repeats=2)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{n:8d} {spent:10.2f} {1e6 * spent / n:24.1f} {peak:34.0f}", flush=True)


def main():
    report_environment("celerite2", "lightkurve")
    logging.getLogger("lightkurve").setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report_defaults()
        report_against_lightkurve()
        report_growth()


if __name__ == "__main__":
    main()
