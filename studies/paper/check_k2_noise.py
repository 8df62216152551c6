"""Medians of the noise of many moving stars over those of K2 campaign 3, from Kp 11 to 14.5.

    OMP_NUM_THREADS=1 python studies/paper/check_k2_noise.py [--stars N]

First for the paper's PSF and response in an aperture that holds all light, then for the calibrated
ones in the apertures of the study ``k2-motion``. Stars are as in calibrate_k2_motion.py. At Kp 11
and 11.5 as many stars as in the catalog, 77 and 20 %, are taken as saturated and have the large
aperture.
"""

import argparse

import numpy as np
from _reference import read_reference
from _response import RollingStars
from calibrate_k2_motion import CHUNK, PARTS, at_part, field_stars
from k2_motion import K2MotionNoise

from scope_models import Detector

MAGNITUDES = (11.0, 11.5, 12.0, 12.5, 13.0, 13.5, 14.0, 14.5)
SATURATED = {11.0: 0.77, 11.5: 0.20}


def population(detector, responses, options):
    """Return the noise by motion (parts, stars) for each response, and white noise by magnitude."""
    motion, white = {pair: [] for pair in responses}, []
    for first in range(0, options.stars, CHUNK):
        numbers = range(first, min(first + CHUNK, options.stars))
        stars = RollingStars(detector, field_stars(detector, numbers, options), PARTS)
        for pair in responses:
            motion[pair].append(stars.systematics(*pair))
        white.append([stars.white(detector, mag) for mag in MAGNITUDES])
    return {p: np.concatenate(v, axis=1) for p, v in motion.items()}, np.concatenate(white, axis=2)


def in_aperture(motion, white, mag):
    """Return the noise of all stars in the apertures of the study."""
    law = K2MotionNoise().threshold, K2MotionNoise().exponent
    noise = np.hypot(*(np.exp(at_part(np.log(v), law, mag)) for v in (motion, white)))
    order = np.random.default_rng(1).permutation(noise.size)
    saturated = order < SATURATED.get(mag, 0.0) * noise.size
    return np.where(saturated, np.hypot(motion[0], white[0]), noise)


def show(text, noise, known):
    """Print medians, their ratios to the reference, and errors of these."""
    medians = np.median(noise, axis=1)
    rng = np.random.default_rng(0)
    picks = rng.integers(noise.shape[1], size=(200, noise.shape[1]))
    errors = np.std(np.median(noise[:, picks], axis=2), axis=1)
    print(text)
    print("  median (ppm)     ", medians.round(1))
    print("  ours / campaign 3", (medians / known).round(2), "+-", (errors / known).round(2))
    print("  campaign 3 / ours", (known / medians).round(2), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stars", type=int, default=240)
    parser.add_argument("--cadences", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=2)
    options = parser.parse_args()
    table = read_reference("k2_c03_raw", "all")
    known = np.array([float(table["median"][table["mag"] == mag][0]) for mag in MAGNITUDES])
    paper = {"b uniform within 1 %": (-0.05, 0.01 / 3**0.5), "b = 1": (-0.05, 0.0),
             "b normal, 1 %": (-0.05, 0.01)}  # fmt: skip
    motion, white = population(Detector.k2(shape=(13, 13)), paper.values(), options)
    for name, pair in paper.items():
        show(f"paper, all light, {name}", np.hypot(motion[pair][0], white[:, 0]), known)
    detector = Detector.k2_calibrated(shape=(13, 13))
    _, _, curvature = detector.sensitivity.x_coefficients
    pair = curvature / detector.sensitivity.x_coefficients[0], detector.interpixel_scatter
    motion, white = population(detector, [pair], options)
    noise = [in_aperture(motion[pair], white[k], mag) for k, mag in enumerate(MAGNITUDES)]
    show(f"calibrated, a_2 {pair[0]:.2f}, b normal, {pair[1]}", np.array(noise), known)


if __name__ == "__main__":
    main()
