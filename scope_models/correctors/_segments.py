"""Times at which the sense of the spacecraft's roll reverses."""

from itertools import pairwise

import numpy as np

__all__ = ["roll_reversals"]


def roll_reversals(time, track, window=2.0):
    """
    Find the times at which the sense of the spacecraft's roll reverses.

    Between two thruster firings the star drifts one way, and each firing
    throws it back. The sense of the drift is the sign of the median step
    within a window; a reversal counts when it lasts.

    Parameters
    ----------
    time : ndarray
        Increasing times in days.
    track : ndarray
        Position of the star along the direction in which it moves most.
    window : float, optional
        Length of the windows in days.

    Returns
    -------
    tuple of float
        Times of the reversals.
    """
    width = round(window / np.median(np.diff(time)))
    n_windows = len(time) // max(width, 1)
    if width < 16 or n_windows < 4:
        return ()
    sense = [_sense(steps) for steps in np.array_split(np.diff(track), n_windows)]
    drifting = np.flatnonzero(sense)
    reversals = []
    for i, j in pairwise(drifting):
        before = sense[max(i - 2, 0) : i + 1].count(sense[i])
        after = sense[j : j + 3].count(sense[j])
        if sense[i] != sense[j] and min(before, after) >= 2:
            reversals.append(float(time[(i + j + 1) * len(time) // (2 * n_windows)]))
    return tuple(reversals)


def _sense(steps):
    """Return the sign of the median step, 0 if it is within three standard errors of none."""
    median = np.median(steps)
    scatter = 1.4826 * np.median(np.abs(steps - median))
    error = 1.2533 * scatter / np.sqrt(len(steps))
    return int(np.sign(median)) if np.abs(median) > 3 * error else 0
