"""The stars and the motions of the studies."""

from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from scope_models.missions import MISSIONS
from scope_models.scene import K2Roll, Motion, Star

# No star of K2 moves farther from its median than this in a good cadence, in pixels.
_FARTHEST = 4.0
_CADENCES = 1000
# Direction of EPIC 205998445 from the boresight, degrees from columns toward rows.
_ANGLE = 163.6


def draw_star(
    rng, mag, detector, *, x_0=None, y_0=None, shift=0.2, sigma_spread=0.1, rho_spread=0.4,
    signal=None,
):  # fmt: skip
    """Draw a star as the paper varies them: its place within a pixel, and the shape of its PSF.

    The place is within `shift` (px) of x_0 and y_0, by default the pixel in the middle of the
    stamp, the widths within a part `sigma_spread`, the correlation within `rho_spread` of the
    detector's PSF. Five uniform deviates are used whatever the spreads are.
    """
    ny, nx = detector.shape
    deviates = rng.uniform(-1.0, 1.0, 5)
    x_0, y_0 = nx // 2 if x_0 is None else x_0, ny // 2 if y_0 is None else y_0
    psf = _varied(detector.psf, 1 + sigma_spread * deviates[2:4], rho_spread * deviates[4])
    return Star(mag, x_0 + shift * deviates[0], y_0 + shift * deviates[1], psf=psf, signal=signal)


def _varied(psf, factors, tilt):
    """Return a copy of a PSF with other widths and correlations."""
    psf = psf.copy()
    factors = dict(zip(("sigma_x", "sigma_y"), factors, strict=True))
    for name, value in zip(psf.param_names, psf.parameters.tolist(), strict=True):
        kind = name.rstrip("_0123456789")
        if kind in factors:
            setattr(psf, name, float(value * factors[kind]))
        elif kind == "rho":
            setattr(psf, name, float(np.clip(value + tilt, -0.95, 0.95)))
    return psf


def field_position(distance, angle=_ANGLE):
    """Return the `field` of K2Roll, degrees along columns and rows, of a place in the field.

    Distance from the boresight and direction from columns toward rows are in degrees.
    """
    angle = np.radians(angle)
    return float(distance * np.cos(angle)), float(distance * np.sin(angle))


def motion_from_name(name, n_cadences=None):
    """Return the motion that a name stands for, without flagged cadences.

    It is the path of a target pixel or light-curve file (without cadences farther than 4 px from
    the median), "still", "k2_roll", or "k2_roll:seed=3,distance=5.2,angle=120": a seed, distance
    and angle of `field_position`, and the numbers of `scope_models.scene.motion.K2Roll`.
    """
    text = str(name)
    kind, _, options = text.partition(":")
    if text == "still":
        return Motion.still(n_cadences or _CADENCES)
    if kind == "k2_roll":
        return _generated(text, options, n_cadences or _CADENCES)
    return _usable(Motion.from_file(Path(name), bad="drop"), name)[:n_cadences]


#: `motion_from_name` for studies, in which all stars have the same motion.
cached_motion = lru_cache(maxsize=8)(motion_from_name)


def _usable(motion, name):
    """Return a motion without flagged cadences and without absurd positions."""
    keep = (motion.quality & MISSIONS["K2"].quality.rejected) == 0
    if not keep.any():
        raise ValueError(f"{name}: no cadence is without a quality flag")
    x, y = (values - np.median(values[keep]) for values in (motion.x, motion.y))
    return motion[keep & (np.hypot(x, y) < _FARTHEST)]


def _generated(text, options, n_cadences):
    """Return a generated motion of so many cadences without thruster firings."""
    parameters = {}
    known = {"seed", "distance", "angle"} | {field.name for field in fields(K2Roll)} - {"field"}
    for option in filter(None, options.split(",")):
        key, equals, value = (part.strip() for part in option.partition("="))
        if key not in known or not equals:
            raise ValueError(
                f"`motion` must be like 'k2_roll:seed=3,distance=5', got {text!r}; the parameters "
                f"are {', '.join(sorted(known))}"
            )
        try:
            parameters[key] = int(value) if key == "seed" else float(value)
        except ValueError:
            raise ValueError(f"`{key}` must be a number, got {value!r} in {text!r}") from None
    if "angle" in parameters and "distance" not in parameters:
        raise ValueError(f"`angle` needs a `distance`, got {text!r}")
    if "distance" in parameters:
        position = parameters.pop("distance"), parameters.pop("angle", _ANGLE)
        parameters["field"] = field_position(*position)
    # Thrusters fire in one cadence of twelve at most, and a firing may fall into two cadences.
    motion = Motion.k2_roll(n_cadences + n_cadences // 4 + 12, **parameters)
    return _usable(motion, text)[:n_cadences]


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
