"""Time and memory of fits of target pixel files.

The targets: 1000 cadences of 9 x 9 pixels with two components in 30 s and 3600 in two minutes, in
less than 2 GiB.

Run as ``OMP_NUM_THREADS=1 python benchmarks/fitting.py``.
"""

import resource
import time
import warnings

from _common import report_environment
from astropy.utils.exceptions import AstropyUserWarning

from scope_models import (
    BivariateGaussianPSF,
    Detector,
    Motion,
    SensitivityPolynomial,
    Star,
    fit_tpf,
    simulate,
)

TWO = BivariateGaussianPSF(0.75, 0, 0, 0.5, 0.45, 0.15) + BivariateGaussianPSF(
    0.25, 0.1, -0.05, 1.1, 1.2, -0.1
)


def main():
    warnings.simplefilter("ignore", AstropyUserWarning)
    report_environment()
    print("Time and memory: 9 x 9 pixels, two components, b, sensitivity")
    for n in (500, 1000, 2000, 3600):
        detector = Detector.k2(shape=(9, 9))
        motion = 5 * Motion.k2_roll(n, seed=1)
        tpf = simulate(Star(12.0, psf=TWO), detector, motion, seed=1).to_tpf()
        begin = time.perf_counter()
        fit = fit_tpf(tpf, 2, SensitivityPolynomial(fixed={"ax1": True, "ay1": True}))
        taken = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"  {n:5d} cadences {taken:6.2f} s, {1e3 * taken / n:5.2f} ms each, "
            f"{fit.n_steps} steps, process at most {peak:.2f} GiB"
        )


if __name__ == "__main__":
    main()
