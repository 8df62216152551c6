"""The stars and the motions of the studies: how they vary, and what their names mean."""

import re
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from scope_models._checks import checked_number
from scope_models.missions import MISSIONS
from scope_models.scene import K2Roll, Motion, Star

__all__ = ["draw_star", "field_position", "motion_from_name", "stamp_around"]

# No star of K2 moves farther from its median than this in a good cadence, in pixels.
_FARTHEST = 4.0
_CADENCES = 1000
# Direction of EPIC 205998445 from the boresight, degrees from columns toward rows.
_ANGLE = 163.6
_VARIED = re.compile(r"(sigma_x|sigma_y|rho)(_\d+)?")


def draw_star(
    rng, mag, detector, *, x_0=None, y_0=None, shift=0.2, sigma_spread=0.1, rho_spread=0.4,
    signal=None,
):  # fmt: skip
    """Draw a star as the paper varies them: its place within a pixel, and the shape of its PSF.

    Five uniform deviates are used whatever the spreads are: for the place along x and y, the
    widths along x and y, and the correlation.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    mag : float
        Magnitude in the detector's band.
    detector : Detector
        Its ``psf`` is varied.
    x_0, y_0 : float, optional
        Column and row about which the star is put; the pixel in the middle of the stamp by
        default.
    shift : float, optional
        Largest distance from there along each axis in pixels. The paper has 0.2; 0.5 is a star
        anywhere on a pixel.
    sigma_spread : float, optional
        Largest relative change of the widths along each axis, below 1; all components of the PSF
        share it.
    rho_spread : float, optional
        Largest correlation that is added to that of each component; the sum stays within 0.95.
    signal : astropy.modeling.Model or callable or array_like, optional
        As for `~scope_models.Star`.

    Returns
    -------
    Star
        The star.

    Raises
    ------
    ValueError
        If the detector has no PSF, or a spread is outside its domain.

    References
    ----------
    Saunders, N. et al. 2019, "The Pointing Limits of Transiting Exoplanet Light Curve
    Characterization with Pixel Level De-correlation": centroid within 0.2 px, widths within
    10 %, rho within 40 %.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models import Detector
    >>> from scope_models.experiments.populations import draw_star
    >>> star = draw_star(np.random.default_rng(1), 12.0, Detector.k2())
    >>> print(f"{star.x_0:.3f} {star.y_0:.3f} {star.psf.sigma_x.value:.3f}")
    5.005 5.180 0.464
    """
    if detector.psf is None:
        raise ValueError("`detector` must have a PSF to draw stars from")
    shift = checked_number("shift", shift, "pix")
    for name, spread in (("sigma_spread", sigma_spread), ("rho_spread", rho_spread)):
        if not 0 <= checked_number(name, spread) < 1:
            raise ValueError(f"`{name}` must be below 1, got {spread}")
    ny, nx = detector.shape
    deviates = rng.uniform(-1.0, 1.0, 5)
    x_0 = nx // 2 if x_0 is None else checked_number("x_0", x_0, "pix", any_sign=True)
    y_0 = ny // 2 if y_0 is None else checked_number("y_0", y_0, "pix", any_sign=True)
    psf = _varied(detector.psf, 1 + sigma_spread * deviates[2:4], rho_spread * deviates[4])
    return Star(mag, x_0 + shift * deviates[0], y_0 + shift * deviates[1], psf=psf, signal=signal)


def _varied(psf, factors, tilt):
    """Return a copy of a PSF with other widths and correlations."""
    psf = psf.copy()
    factors = dict(zip(("sigma_x", "sigma_y"), factors, strict=True))
    for name in psf.param_names:
        kind = _VARIED.fullmatch(name)
        if kind is None:
            continue
        value = getattr(psf, name).value
        if kind[1] == "rho":
            setattr(psf, name, float(np.clip(value + tilt, -0.95, 0.95)))
        else:
            setattr(psf, name, float(value * factors[kind[1]]))
    return psf


def field_position(distance, angle=_ANGLE):
    """Return where a star is in the field of view.

    Parameters
    ----------
    distance : float
        Distance from the boresight in degrees.
    angle : float, optional
        Direction from the boresight in degrees, from columns toward rows. The default is that of
        EPIC 205998445.

    Returns
    -------
    tuple of float
        Distance along columns and rows in degrees, the ``field`` of
        `~scope_models.scene.motion.K2Roll`.

    Examples
    --------
    >>> from scope_models.experiments.populations import field_position
    >>> x, y = field_position(5.0, angle=30.0)
    >>> print(f"{x:.2f} {y:.2f}")
    4.33 2.50
    """
    distance = checked_number("distance", distance, "deg")
    angle = np.radians(checked_number("angle", angle, "deg", any_sign=True))
    return float(distance * np.cos(angle)), float(distance * np.sin(angle))


def motion_from_name(name, n_cadences=None):
    """Return the motion that a name stands for.

    Parameters
    ----------
    name : str or path-like
        One of:

        - the path of a target pixel or light-curve file, or of a table with the columns TIME,
          POS_CORR1 and POS_CORR2. Left out are cadences without position, those flagged in
          a way for which lightkurve leaves them out by default, and those farther than 4 px
          from the median;
        - ``"still"``;
        - ``"k2_roll"``, the generator `Motion.k2_roll <scope_models.Motion.k2_roll>`, or with
          parameters as ``"k2_roll:seed=3,distance=5.2,angle=120"``. They are ``seed``,
          ``distance`` and ``angle`` of `field_position`, and the numbers of
          `~scope_models.scene.motion.K2Roll`. Cadences in which thrusters fire are left out.
    n_cadences : int, optional
        At most so many cadences. By default all of a file and 1000 of the others.

    Returns
    -------
    Motion
        The motion, without flagged cadences.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the name, a parameter of the generator or the file cannot be read, or no cadence
        is left.

    Examples
    --------
    >>> from scope_models.experiments.populations import motion_from_name
    >>> motion_from_name("k2_roll:seed=3,distance=6.9", n_cadences=500)
    <Motion of 500 cadences, BKJD 2144.1232 to 2154.6670, x -0.115 to 0.212, y -0.635 to 0.466 px>
    """
    if n_cadences is not None and n_cadences < 1:
        raise ValueError(f"`n_cadences` must be at least 1, got {n_cadences}")
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
    """Return a stamp that holds a star wherever the motion takes it.

    Parameters
    ----------
    motion : Motion
        The motion.
    margin : int, optional
        Pixels between the star and the edge of the stamp.

    Returns
    -------
    shape : tuple of int
        Rows and columns of the stamp.
    x_0, y_0 : int
        The pixel that is the motion's reference position.

    Examples
    --------
    >>> from scope_models import Motion
    >>> from scope_models.experiments.populations import stamp_around
    >>> stamp_around(10 * Motion.k2_roll(500))
    ((18, 13), 6, 10)
    """
    margin = int(checked_number("margin", margin))
    sizes, origins = [], []
    for values in (motion.y, motion.x):
        low, high = int(np.floor(values.min() + 0.5)), int(np.ceil(values.max() - 0.5))
        sizes.append(high - low + 2 * margin + 1)
        origins.append(margin - low)
    return tuple(sizes), origins[1], origins[0]
