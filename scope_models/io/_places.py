"""Places of stars in a stamp: from columns and rows, tables, or coordinates on the sky."""

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord

from scope_models._arrays import plain_array, unmasked

__all__ = ["star_places", "target_place"]

#: Keywords of the WCS of the column FLUX, and their names in an image.
_WCS = {
    "1CTYP5": "CTYPE1", "2CTYP5": "CTYPE2", "1CRPX5": "CRPIX1", "2CRPX5": "CRPIX2",
    "1CRVL5": "CRVAL1", "2CRVL5": "CRVAL2", "1CUNI5": "CUNIT1", "2CUNI5": "CUNIT2",
    "1CDLT5": "CDELT1", "2CDLT5": "CDELT2", "11PC5": "PC1_1", "12PC5": "PC1_2",
    "21PC5": "PC2_1", "22PC5": "PC2_2",
}  # fmt: skip


def star_places(name, places, series):
    """Return columns and rows ``(k, 2)`` of stars in the stamp of a `PixelSeries`.

    ``places`` are columns and rows, a SkyCoord, or a table with the columns x and y, or ra and dec;
    ``name`` is the argument in messages.
    """
    columns = {key.lower(): key for key in getattr(places, "colnames", ())}
    if {"x", "y"} <= set(columns):
        places = np.column_stack(
            [plain_array(places[columns[k]], u.pixel, f"{name}[{k!r}]") for k in "xy"]
        )
    elif {"ra", "dec"} <= set(columns):
        ra, dec = (unmasked(places[columns[k]]) for k in ("ra", "dec"))
        places = SkyCoord(*(plain_array(v, u.deg, name) for v in (ra, dec)), unit=u.deg)
    elif columns:
        raise ValueError(f"`{name}` must have the columns x and y, or ra and dec")
    if isinstance(places, SkyCoord):
        places = np.column_stack(_wcs(series).world_to_pixel(places.reshape(-1)))
    positions = np.atleast_2d(plain_array(places, u.pixel, name))
    if positions.size == 0:
        return np.zeros((0, 2))
    if positions.ndim != 2 or positions.shape[1] != 2 or not np.isfinite(positions).all():
        raise ValueError(
            f"`{name}` must be finite positions of shape (k, 2), got shape {positions.shape}"
        )
    return positions


def target_place(series):
    """Return the target's column and row in the stamp by its coordinates; None without these."""
    place = [series.header.get(key) for key in ("RA_OBJ", "DEC_OBJ")]
    if None in place:
        return None
    return star_places("tpf", SkyCoord(*place, unit=u.deg), series)[0]


def _wcs(series):
    """The WCS of the stamp, from the cards of the table."""
    from astropy.wcs import WCS

    cards = {own: series.header.get(key) for key, own in _WCS.items()}
    if cards["CRVAL1"] is None or cards["CRPIX1"] is None:
        raise ValueError("the file has no WCS: give positions in pixels")
    return WCS({key: value for key, value in cards.items() if value is not None})
