"""The twin of a fitted star, and its sensitivity as a figure shows it."""

import numpy as np
from scipy.ndimage import median_filter

from scope_models.models import SensitivityPolynomial
from scope_models.motion import Motion
from scope_models.star import Star

__all__ = ["make_scene", "sensitivity_profiles"]

_SMOOTHING_DAYS = 2.0


def make_scene(fit, positions, signal):
    """Return the stars, detector and motion of a fit."""
    if positions not in {"fitted", "path"}:
        raise ValueError(f"`positions` must be 'fitted' or 'path', got {positions!r}")
    if signal not in {"smooth", "fitted", "constant"}:
        raise ValueError(f"`signal` must be 'smooth', 'fitted' or 'constant', got {signal!r}")
    x, y = fit.x, fit.y
    if positions == "path":
        if fit.pos_corr is None:
            raise ValueError("`positions` is 'path', but the file had no POS_CORR")
        basis = np.column_stack([np.ones(len(x)), fit.pos_corr])
        x, y = (basis @ np.linalg.lstsq(basis, p, rcond=None)[0] for p in (x, y))
    middle = float(np.median(x)), float(np.median(y))
    flux = float(np.median(fit.flux))
    if flux <= 0:
        raise ValueError(f"the star has no flux to simulate: its median is {flux:g} e-/s")
    detector = fit.detector
    mag = detector.zero_point_mag - 2.5 * np.log10(flux / detector.zero_point)
    star = Star(float(mag), *middle, psf=fit.psf, signal=_signal(fit, signal))
    motion = Motion(
        time=fit.time,
        x=x - middle[0],
        y=y - middle[1],
        quality=fit.quality,
        cadenceno=fit.cadenceno,
        time_format=fit.time_format,
    )
    return (star,), detector, motion


def _signal(fit, kind):
    """Relative flux of the cadences."""
    if kind == "constant":
        return None
    relative = fit.flux / np.median(fit.flux)
    if kind == "smooth":
        step = np.median(np.diff(fit.time)) if len(fit.time) > 1 else 1.0
        size = 2 * int(_SMOOTHING_DAYS / step / 2) + 1
        relative = median_filter(relative, min(size, 2 * (len(relative) // 2) + 1), mode="nearest")
    return np.maximum(relative, 0.0)


def sensitivity_profiles(fit):
    """
    The fitted sensitivity along both axes, with its uncertainty.

    Parameters
    ----------
    fit : TPFFit
        The fit.

    Returns
    -------
    profiles : dict or None
        "offset" and, by axis, value and standard deviation, all of the same shape; None if there
        is no polynomial.
    """
    model = fit.sensitivity
    if not isinstance(model, SensitivityPolynomial):
        return None
    offset = np.linspace(-0.5, 0.5, 51)
    profiles = {"offset": offset}
    for axis in "xy":
        names = [name for name in model.param_names if name[1] == axis]
        value = np.polynomial.polynomial.polyval(offset, [getattr(model, n).value for n in names])
        free = [name for name in names if name in fit.names]
        index = [fit.names.index(name) for name in free]
        powers = np.array([offset ** int(name[2:]) for name in free]).reshape(len(free), -1)
        block = fit.covariance[np.ix_(index, index)]
        variance = np.einsum("iu,ij,ju->u", powers, block, powers)
        profiles[axis] = value, np.sqrt(np.maximum(variance, 0.0))
    return profiles
