"""Counts of stars in the Galaxy."""

import astropy.units as u
import numpy as np

from scope_models._arrays import plain_array
from scope_models.models._description import check_coord

__all__ = ["star_counts"]

_LOWEST_LATITUDE = 20.0  # deg


def star_counts(mag, coord):
    r"""Return the number of stars brighter than a magnitude in a direction.

    The analytic form of Bahcall & Soneira's model of the Galaxy, good to about 15 % from V = 5 to
    30 at galactic latitudes of more than 20 degrees. Nearer to the plane the counts at 20 degrees
    are given, which are too few.

    Parameters
    ----------
    mag : float, array_like or Quantity
        Magnitude V.
    coord : SkyCoord
        The direction.

    Returns
    -------
    ndarray
        Stars per square degree.

    Raises
    ------
    TypeError
        If ``coord`` is not a place on the sky.

    References
    ----------
    Bahcall, J. N. & Soneira, R. M. 1980, ApJS 44, 73, equation B1.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> from scope_models.scene.catalog import star_counts
    >>> print(star_counts([12, 16], SkyCoord(0, 90, unit="deg", frame="galactic")).round())
    [ 11. 188.]
    """
    m = plain_array(mag, u.mag, "mag")
    check_coord(coord)
    galactic = coord.galactic
    latitude = max(abs(galactic.b.deg), _LOWEST_LATITUDE)
    sin_b, cos_b = np.sin(np.radians(latitude)), np.cos(np.radians(latitude))
    cos_l = np.cos(galactic.l.rad)
    faint = np.clip(m, 12, 20) - 12
    mu, gamma = 0.03 + 0.0075 * faint, 0.36 - 0.04 * faint
    disk = 925 * 10 ** (0.035 * (m - 15.75)) / (1 + 10 ** (-0.132 * (m - 15.75))) ** 3
    disk /= (sin_b * (1 - mu * cos_b / sin_b * cos_l)) ** (3 - 5 * gamma)
    halo = 1050 * 10 ** (0.087 * (m - 17.5)) / (1 + 10 ** (-0.18 * (m - 17.5))) ** 2.5
    return disk + halo / (1 - cos_b * cos_l) ** (1.45 - 0.2 * cos_b * cos_l)
