"""Which stars a fit has: positions from pixels, sky or the image itself."""

import numpy as np
from astropy import units as u
from astropy.coordinates import SkyCoord

from scope_models._arrays import plain_array, unmasked

__all__ = ["find_stars", "star_positions"]

# A local maximum of the median image is a star if it is brighter than this part of the brightest
# pixel, and than so many errors of the median image.
_LEAST_PART, _LEAST_SIGNIFICANCE = 0.05, 10.0
# Keywords of the WCS of the column FLUX, and their names in an image.
_WCS = {
    "1CTYP5": "CTYPE1", "2CTYP5": "CTYPE2", "1CRPX5": "CRPIX1", "2CRPX5": "CRPIX2",
    "1CRVL5": "CRVAL1", "2CRVL5": "CRVAL2", "1CUNI5": "CUNIT1", "2CUNI5": "CUNIT2",
    "1CDLT5": "CDELT1", "2CDLT5": "CDELT2", "11PC5": "PC1_1", "12PC5": "PC1_2",
    "21PC5": "PC2_1", "22PC5": "PC2_2",
}  # fmt: skip


def star_positions(name, places, series):
    """
    Return columns and rows of stars in a stamp.

    Parameters
    ----------
    name : str
        Name of the argument.
    places : array_like, SkyCoord, Table or "find"
        Columns and rows, shape ``(k, 2)``; places on the sky; a table with the columns x and y,
        or ra and dec; or "find".
    series : PixelSeries
        The pixels.

    Returns
    -------
    positions : ndarray of shape (k, 2)
        Column and row in pixels of the stamp.
    """
    if isinstance(places, str):
        if places != "find":
            raise ValueError(f'`{name}` must be positions or "find", got {places!r}')
        return find_stars(series)
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


def _wcs(series):
    """The WCS of the stamp, from the cards of the table."""
    from astropy.wcs import WCS

    cards = {own: series.header.get(key) for key, own in _WCS.items()}
    if cards["CRVAL1"] is None or cards["CRPIX1"] is None:
        raise ValueError("the file has no WCS: give positions in pixels")
    return WCS({key: value for key, value in cards.items() if value is not None})


def find_stars(series):
    """
    Return the local maxima of the median image, the brightest first.

    Parameters
    ----------
    series : PixelSeries
        The pixels.

    Returns
    -------
    positions : ndarray of shape (k, 2)
        Column and row of their pixels.
    """
    good = np.isfinite(series.flux)
    flux = np.where(good, series.flux, np.nan)
    seen = good.any(axis=0)
    image, error = np.full(seen.shape, -np.inf), np.ones(seen.shape)
    image[seen] = np.nanmedian(flux[:, seen], axis=0)
    scatter = np.nanmedian(np.abs(flux[:, seen] - image[seen]), axis=0)
    error[seen] = 1.4826 * scatter / np.sqrt(np.maximum(good[:, seen].sum(axis=0), 1))
    image = image - np.median(image[seen])
    padded = np.pad(image, 1, constant_values=-np.inf)
    ny, nx = image.shape
    around = [
        padded[j : j + ny, i : i + nx] for j in range(3) for i in range(3) if (i, j) != (1, 1)
    ]
    peak = seen & (image > np.max(around, axis=0))
    peak &= (image > _LEAST_PART * image[seen].max()) & (image > _LEAST_SIGNIFICANCE * error)
    rows, columns = np.nonzero(peak)
    order = np.argsort(-image[rows, columns])
    return np.column_stack([columns, rows])[order].astype(float)
