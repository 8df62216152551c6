"""Orders of PLDCorrector on simulated stars.

96 stars of the grid of ``pld_grid.py``: four magnitudes, three real motions times 1, 2, 5 and 10,
two detectors. Run it as

    OMP_NUM_THREADS=1 python studies/pld_methods.py --data FOLDER
"""

import argparse
import itertools
import time
import warnings
from pathlib import Path

import numpy as np
import pld_grid
from tqdm import tqdm

from scope_models import simulate
from scope_models.correctors import PLDCorrector

MAGNITUDES = (10.0, 11.5, 13.0, 15.0)
MOTIONS = tuple(name for name, file in pld_grid.SERIES.items() if file is not None)
#: Name of a way, and the arguments of `PLDCorrector.correct` that make it.
WAYS = {
    "order 1": {"order": 1},
    "order 2": {},
    "order 3": {"order": 3},
}
SCORES = ("held_out_mad", "held_out_rms", "residual_everest", "seconds")


def run(options):
    """Return the scores: way, motion, star, score."""
    stars = list(itertools.product(pld_grid.DETECTORS, MAGNITUDES, MOTIONS))
    table = np.empty((len(WAYS), len(pld_grid.SCALES), len(stars), len(SCORES)))
    cells = itertools.product(enumerate(pld_grid.SCALES), enumerate(stars))
    total = len(pld_grid.SCALES) * len(stars)
    for (i, scale), (j, (detector, mag, motion)) in tqdm(cells, total=total, unit="star"):
        star, pixels, track, seed = pld_grid.make_star(detector, mag, scale, motion, 0, options)
        observation = simulate(star, pixels, track, seed=seed)
        tpf = observation.to_tpf()
        for k, arguments in enumerate(WAYS.values()):
            corrector = PLDCorrector(tpf)
            start = time.process_time()
            corrector.correct(**arguments)
            seconds = time.process_time() - start
            scores = pld_grid.noise_scores(corrector, observation, np.ones(len(track)))
            table[k, i, j] = [(scores | {"seconds": seconds})[name] for name in SCORES]
    return table


def report(table):
    """Print the median of each score."""
    for s, score in enumerate(SCORES):
        print(f"\n{score:20s}" + "".join(f"{scale:7d}x" for scale in pld_grid.SCALES))
        for k, way in enumerate(WAYS):
            print(f"{way:20s}" + "".join(f"{v:8.3f}" for v in np.median(table[k, :, :, s], axis=1)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    folder = Path("../shared/data/poscorr")
    parser.add_argument("--data", type=Path, default=folder, metavar="FOLDER")
    parser.add_argument("--cadences", type=int, default=1000)
    warnings.filterwarnings("ignore", ".*tpfmodel submodule is not available", UserWarning)
    report(run(parser.parse_args()))


if __name__ == "__main__":
    main()
