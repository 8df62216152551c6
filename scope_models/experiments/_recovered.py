"""What a table of recovered transits says."""

import numpy as np

__all__ = ["by_motion", "half_complete", "percentiles", "values_of"]


def values_of(rows, name):
    """Return a column with NaN where stars lack it."""
    if name not in rows.colnames:
        return np.full(len(rows), np.nan)
    return np.ma.filled(np.ma.asarray(rows[name], dtype=float), np.nan)


def percentiles(values):
    """Return the 16th, 50th and 84th percentile, NaN without values."""
    return np.percentile(values, [16, 50, 84]) if len(values) else np.full(3, np.nan)


def half_complete(depths, completeness):
    """Return the depth at which half of the planets are recovered.

    Parameters
    ----------
    depths : array_like
        Depths, increasing.
    completeness : array_like
        Fraction that is recovered at each.

    Returns
    -------
    float
        Interpolated in the logarithm of the depth, where the completeness last rises above one
        half; 0 if it is above everywhere, infinite if it is below at the largest depth.
    """
    below = np.flatnonzero(np.asarray(completeness) < 0.5)
    if len(below) == 0:
        return 0.0
    last = int(below[-1])
    if last == len(depths) - 1:
        return float("inf")
    logarithms = np.log(depths[last : last + 2])
    ends = completeness[last : last + 2]
    return float(np.round(np.exp(np.interp(0.5, ends, logarithms)), 1))


def by_motion(rows, threshold):
    """Return what all planets at one multiple of the motion say together.

    Parameters
    ----------
    rows : astropy.table.Table
        The results of stars with planets.
    threshold : float
        Signal-to-noise ratio of a detection.

    Returns
    -------
    dict
        Numbers of planets: "planets", "recovered", "expected" (above the threshold in the least
        noise), and "false" (the strongest box is above the threshold and not the planet);
        weighted means of found over true values with their errors, of depth and duration of those
        recovered ("found_depth", "found_duration") and of the jointly fitted depth of all
        ("joint_depth"); the standard deviations of their pulls; and the medians of the survival
        and of the found over the expected ratio, of planets above twice the threshold.
    """
    recovered, detected = (np.array(rows[name]) for name in ("recovered", "detected"))
    expected = values_of(rows, "expected_snr")
    clear = expected > 2 * threshold
    said = {
        "planets": len(rows),
        "recovered": int(recovered.sum()),
        "expected": int(np.sum(expected >= threshold)),
        "false": int(np.sum(detected & ~recovered)),
        "survival": _median(values_of(rows, "survival")[clear]),
        "snr_ratio": _median((values_of(rows, "snr") / expected)[clear]),
    }
    for found, true, use in (
        ("found_depth", "depth", recovered),
        ("joint_depth", "depth", np.ones(len(rows), dtype=bool)),
        ("found_duration", "duration", recovered),
    ):
        value, error, truth = (
            values_of(rows, name)[use] for name in (found, f"{found}_error", true)
        )
        if not len(value):
            continue
        weights = (truth / error) ** 2
        said[f"{found}_ratio"] = float(np.round(np.average(value / truth, weights=weights), 4))
        said[f"{found}_ratio_error"] = float(np.round(weights.sum() ** -0.5, 4))
        said[f"{found}_pulls"] = float(np.round(np.std((value - truth) / error), 2))
    return said


def _median(values):
    """Return the median, or NaN without values."""
    return float(np.round(np.median(values), 3)) if len(values) else float("nan")
