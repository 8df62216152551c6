"""Dimmings of a star: signals, and what a light curve keeps of them."""

import warnings

import numpy as np

from scope_models._arrays import plain_array
from scope_models._checks import checked_number
from scope_models._threads import one_thread
from scope_models.exceptions import DetrendingWarning

__all__ = [
    "box_signal", "checked_depth", "depth_ratio", "fitted_depth", "no_survival", "transit_column",
]  # fmt: skip

#: Tolerance: boxes are at least so many times their width apart, and there are so many at most.
_BOXES = 8


def box_signal(used, width, depth):
    """Return boxes of ``width`` used cadences; multiples of the golden ratio spread them evenly."""
    rows = np.flatnonzero(used)
    number = int(np.clip(len(rows) // (_BOXES * width), 1, _BOXES))
    signal, golden = np.ones(len(used)), (np.sqrt(5) - 1) / 2
    room = len(rows) / number - width
    for k in range(number):
        first = int(k * len(rows) / number + max(room, 0) * ((k + 1) * golden % 1))
        signal[rows[first : first + width]] -= depth
    return signal


@one_thread
def fitted_depth(fitted, column):
    """Return amplitude and error of a transit at fixed regressors, with all cadences in it."""
    usable, solution = fitted.model.pixels.usable, fitted.solution
    column, use = column[usable], solution.use | fitted.transit_mask[usable]
    solution = solution.with_flat(column, use | fitted.cadence_mask[usable] & column.any(axis=1))
    return solution.without_outliers(fitted.model.options).transit_coefficient()


def depth_ratio(signal, flux, error):
    """Return the depth of events in a flux over that in a signal, with a line about each event.

    Both are relative, the signal less 1; errors weight the cadences. Second comes the standard
    deviation of the ratio, by the scatter about the signal or, if it is more, that between the
    events; NaN without events.
    """
    edges = np.flatnonzero(np.diff(signal != 0, prepend=False, append=False)).reshape(-1, 2)
    parts = [np.empty((0, 2))]
    for start, end in edges:
        near = slice(max(2 * start - end, 0), 2 * end - start)
        both = np.column_stack([flux, signal])[near] / error[near, None]
        line = np.vander(np.arange(len(both)), 2) / error[near, None]
        parts.append(both - line @ np.linalg.lstsq(line, both)[0])
    seen, expected = np.concatenate(parts).T
    power, free = expected @ expected, len(seen) - 2 * len(edges) - 1
    if not power > 0 or free < 1:
        return np.nan, np.nan
    ratio = seen @ expected / power
    rest = seen - ratio * expected
    within = np.sum(rest**2) / free / power
    ends = np.cumsum([len(part) for part in parts])[:-1]
    events = np.array([part.sum() for part in np.split(rest * expected, ends)]) / power
    between = np.sum(events**2) * len(edges) / max(len(edges) - 1, 1)
    return float(ratio), float(np.sqrt(max(within, between)))


def checked_depth(depth):
    """Return a depth between 0 and 1."""
    depth = checked_number("depth", depth, positive=True)
    if depth >= 1:
        raise ValueError(f"`depth` must be less than 1, got {depth}")
    return depth


def transit_column(model, time):
    """Return the logarithm of a transit model at all cadences, ``(n, 1)``, 0 without a time.

    Where what returns it for times is constant, a warning is given and the shape is ``(n, 0)``.
    """
    known = np.isfinite(time)
    if callable(model):
        values = np.ones(len(time))
        values[known] = model(time[known])
    else:
        values = plain_array(model, "", "transit_model")
    if values.shape != time.shape:
        raise ValueError(f"`transit_model` must have shape {time.shape}, got {values.shape}")
    if not np.isfinite(values[known]).all() or np.any(values[known] <= 0):
        raise ValueError("`transit_model` must be positive and finite: it is a relative flux")
    column = np.log(np.where(known, values, 1.0))
    varies = np.ptp(column[known]) > 0
    if callable(model) and not varies:
        message = "`transit_model` is constant at all cadences: its event lies in a gap"
        warnings.warn(message, DetrendingWarning, stacklevel=4)
        return np.zeros((len(time), 0))
    if not varies:
        raise ValueError("`transit_model` must vary with time, got a constant")
    return column[:, None]


def no_survival(reason):
    """Return NaN twice, with a warning that has the reason."""
    warnings.warn(f"the transit survival is NaN: {reason}", DetrendingWarning, stacklevel=4)
    return np.nan, np.nan
