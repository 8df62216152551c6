"""What can be predicted at all in windows that PLDCorrector has not seen.

The corrector uses nothing but the pixels. Here it stands beside one that uses the PSF, the
position in each cadence and the response within the pixels exactly, and what the pixels' own
responses b are drawn from: only b itself it has to find, by the exact linear regression. Both
predict the same windows of 13 cadences. Where the star comes once, b has left no trace elsewhere:
such windows cannot be predicted by either, and raise the rms of the windows over their MAD. Run it
as

    OMP_NUM_THREADS=1 python studies/pld_unseen.py --data FOLDER
"""

import argparse
import itertools
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pld_grid
from astropy.stats import mad_std
from tqdm import tqdm

from scope_models import simulate
from scope_models.correctors import PLDCorrector
from scope_models.correctors._features import Regressors, center
from scope_models.correctors._regression import Hyperparameters

MAGNITUDES = (11.5, 12.5, 13.5)
SCALES = (5, 10)
#: Standard deviation of the pixels' responses.
SCATTER = {"paper": 0.01, "harsh": 0.03}


def held_out_when_known(corrector, observation, expected, scatter):
    """Return the windows' mean residuals of the regression that misses only b."""
    mask, solution = corrector.aperture_mask, corrector.result.solution
    alike = expected[:, mask]  # of pixels that are all alike
    total = alike.sum(axis=1)
    measured = np.log(observation.flux[:, mask].sum(axis=1) / total)
    shares = center(alike / total[:, None], solution.use)
    groups = np.zeros(mask.sum(), dtype=int)
    known = replace(
        solution,
        y=measured - measured[solution.use].mean(),
        variance=(np.sqrt(np.sum(observation.flux_err[:, mask] ** 2, axis=1)) / total) ** 2,
        regressors=Regressors(shares, groups, ("b",)),
        flat=np.ones((len(total), 1)),
        scale=np.ones(1),
        hyper=Hyperparameters(1.0, np.array([scatter**2]), None, 1.0),
    )
    return known.held_out(13)[0].mean(axis=1)


def run_star(detector, mag, scale, series, options):
    """Return MAD and rms of the windows over the floor, of both."""
    star, pixels, motion, seed = pld_grid.make_star(detector, mag, scale, series, 0, options)
    observation = simulate(star, pixels, motion, seed=seed)
    alike = simulate(star, replace(pixels, interpixel_scatter=0.0), motion, seed=seed)
    corrector = PLDCorrector(observation.to_tpf())
    corrector.correct()
    means = corrector.held_out()[0]
    known = held_out_when_known(corrector, observation, alike.model(), SCATTER[detector])
    scores = pld_grid.noise_scores(corrector, observation, np.ones(len(motion)))
    floor = 1e-6 * scores["floor"]
    return [f(values) / floor for values in (means, known) for f in (mad_std, np.std)]


def report(rows):
    """Print ratios of rms to MAD."""
    values = np.array([row[1] for row in rows])
    for name, part in (("ours", values[:, :2]), ("only b unknown", values[:, 2:])):
        ratio = part[:, 1] / part[:, 0]
        print(f"{name:16s} MAD {np.median(part[:, 0]):.2f}, rms {np.median(part[:, 1]):.2f} of the "
              f"floor; rms over MAD: median {np.median(ratio):.2f}, above 1.5 in "
              f"{np.sum(ratio > 1.5)} of {len(ratio)}, largest {ratio.max():.1f}")  # fmt: skip
    relative = values[:, 1] / values[:, 3]
    print(f"rms of ours over rms with only b unknown: median {np.median(relative):.2f}, "
          f"10th and 90th percentile {np.percentile(relative, 10):.2f} and "
          f"{np.percentile(relative, 90):.2f}")  # fmt: skip
    both = np.log(values[:, [1, 3]] / values[:, [0, 2]])
    print(f"correlation of the logarithms of the two ratios {np.corrcoef(both.T)[0, 1]:.2f}\n")
    print("the ten largest ratios: ours, only b unknown")
    for key, (mad, rms, known_mad, known_rms) in sorted(rows, key=lambda r: -r[1][1] / r[1][0])[
        :10
    ]:
        print(f"  {key!s:50s} {rms / mad:6.1f} {known_rms / known_mad:6.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    folder = Path("../shared/data/poscorr")
    parser.add_argument("--data", type=Path, default=folder, metavar="FOLDER")
    parser.add_argument("--cadences", type=int, default=1000)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", ".*tpfmodel submodule is not available", UserWarning)
    keys = list(itertools.product(pld_grid.DETECTORS, MAGNITUDES, SCALES, pld_grid.SERIES))
    report([(key, run_star(*key, options)) for key in tqdm(keys, unit="star")])


if __name__ == "__main__":
    main()
