"""The stars and the motions of the studies."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from scope_models import Detector, Motion, Star, simulate
from scope_models.batch import star_rng, star_seed
from scope_models.missions import MISSIONS

# No star of K2 moves farther from its median than this in a good cadence, in pixels.
FARTHEST = 4.0
DETECTORS = {"paper": Detector.k2, "calibrated": Detector.k2_calibrated}


def draw_star(rng, mag, detector, *, x_0=None, y_0=None, shift=0.2, signal=None):
    """Draw a star as the paper varies them: its place within a pixel, and the shape of its PSF.

    The place is within `shift` (px) of x_0 and y_0, by default the pixel in the middle of the
    stamp, the widths within 10 %, the correlation within 0.4 of the detector's PSF.
    """
    ny, nx = detector.shape
    deviates = rng.uniform(-1.0, 1.0, 5)
    x_0, y_0 = nx // 2 if x_0 is None else x_0, ny // 2 if y_0 is None else y_0
    psf = detector.psf.copy()
    factors = {"sigma_x": 1 + 0.1 * deviates[2], "sigma_y": 1 + 0.1 * deviates[3]}
    for name, value in zip(psf.param_names, psf.parameters.tolist(), strict=True):
        kind = name.rstrip("_0123456789")  # without the number of a component
        if kind in factors:
            setattr(psf, name, float(value * factors[kind]))
        elif kind == "rho":
            setattr(psf, name, float(np.clip(value + 0.4 * deviates[4], -0.95, 0.95)))
    return Star(mag, x_0 + shift * deviates[0], y_0 + shift * deviates[1], psf=psf, signal=signal)


@lru_cache(maxsize=8)
def motion_from_name(name, n_cadences=None, **options):
    """Return the motion that a name stands for, without flagged cadences.

    It is "k2_roll", with `options` of `scope_models.Motion.k2_roll`, or the path of a target pixel
    or light-curve file, without cadences farther than 4 px from the median.
    """
    if str(name) == "k2_roll":
        n_cadences = n_cadences or 1000
        # Thrusters fire in one cadence of twelve at most, and a firing may fall into two cadences.
        motion = Motion.k2_roll(n_cadences + n_cadences // 4 + 12, **options)
    else:
        motion = Motion.from_file(Path(name), bad="drop")
    keep = (motion.quality & MISSIONS["K2"].quality.rejected) == 0
    if not keep.any():
        raise ValueError(f"{name}: no cadence is without a quality flag")
    x, y = (values - np.median(values[keep]) for values in (motion.x, motion.y))
    return motion[keep & (np.hypot(x, y) < FARTHEST)][:n_cadences]


def stamp_around(motion, margin=5):
    """Return the shape of a stamp that holds a star wherever the motion takes it, and its place.

    `margin` pixels are between the star and the edge; the place is (x_0, y_0) without motion.
    """
    sizes, origins = [], []
    for values in (motion.y, motion.x):
        low, high = int(np.floor(values.min() + 0.5)), int(np.ceil(values.max() - 0.5))
        sizes.append(high - low + 2 * margin + 1)
        origins.append(margin - low)
    return tuple(sizes), origins[1], origins[0]


def observe_star(study, task, motion, *, detector="paper", margin=5, signal=None):
    """Return the pixels of a star, which is drawn by the key of its task, and moves on a stamp."""
    shape, x_0, y_0 = stamp_around(motion, margin)
    detector, key = DETECTORS[detector](shape=shape), task["key"]
    place = {"x_0": x_0, "y_0": y_0, "signal": signal}
    star = draw_star(star_rng(study.seed, key), task["mag"], detector, **place)
    return simulate(star, detector, motion, seed=star_seed(study.seed, key, "noise"))
