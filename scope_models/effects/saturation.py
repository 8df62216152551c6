"""Saturation: charge beyond the depth of a well bleeds along its column."""

import astropy.units as u
import numpy as np

from scope_models._arrays import plain_array, plain_number, refuse_unit

__all__ = ["bleed"]


def bleed(charge, well_depth, background=0.0):
    """Let the charge beyond the well depth bleed along the column, in place.

    Half of the excess of a pixel moves up its column (to larger y) and half down. It fills every
    pixel that it meets up to the well depth, so that charge is conserved; what passes the edge of
    the stamp is lost. Where streams from two saturated places meet, neither has precedence.

    Parameters
    ----------
    charge : ndarray of float, shape (..., ny, nx)
        Charge in each pixel, electrons; changed in place. Rows are y.
    well_depth : float or Quantity
        The largest charge that a pixel holds, electrons.
    background : float, Quantity or array_like of shape (ny, nx), optional
        Charge that is in the wells besides and stays where it is; less than the well depth.

    Returns
    -------
    ndarray
        ``charge``.

    Notes
    -----
    Transfer along the column is taken as perfect. The flight pipeline's constant for Kepler,
    0.9996 per pixel, would leave 0.4 % of the charge behind over ten pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.effects.saturation import bleed
    >>> column = np.array([[0.0], [0.0], [25.0], [0.0], [0.0]])
    >>> bleed(column, 10.0).ravel()
    array([ 0. ,  7.5, 10. ,  7.5,  0. ])
    """
    refuse_unit(charge, "charge")
    well_depth = plain_number(well_depth, u.electron, "well_depth")
    capacity = well_depth - plain_array(background, u.electron, "background")
    full = np.any(charge > capacity, axis=-2)
    if not full.any():
        return charge
    columns = np.moveaxis(charge, -2, -1)[full]
    capacity = np.moveaxis(np.broadcast_to(capacity, charge.shape), -2, -1)[full]
    spilled = np.maximum(columns - capacity, 0.0)
    columns -= spilled
    spilled *= 0.5
    up_first, down_first = columns.copy(), columns
    for pixels, directions in ((up_first, (1, -1)), (down_first, (-1, 1))):
        for direction in directions:
            turned = (values[:, ::direction] for values in (pixels, spilled, capacity))
            _fill(*turned)
    up_first += down_first
    up_first *= 0.5
    np.moveaxis(charge, -2, -1)[full] = up_first
    return charge


def _fill(columns, spilled, capacity):
    """Carry the spilled charge along the last axis and fill the wells on the way, in place."""
    stream = np.zeros(len(columns))
    for row in range(columns.shape[-1]):
        stream += spilled[:, row]
        taken = np.minimum(stream, capacity[:, row] - columns[:, row])
        columns[:, row] += taken
        stream -= taken
