"""Which stars a fit has: positions from pixels, sky or the image itself."""

import numpy as np

from scope_models.io._places import star_places

__all__ = ["find_stars", "star_positions"]

# A local maximum of the median image is a star if it is brighter than this part of the brightest
# pixel, and than so many errors of the median image.
_LEAST_PART, _LEAST_SIGNIFICANCE = 0.05, 10.0


def star_positions(name, places, series):
    """
    Return columns and rows of stars in a stamp, ``(k, 2)``.

    Parameters
    ----------
    name : str
        Name of the argument.
    places : array_like, SkyCoord, Table or "find"
        As in `~scope_models.io._places.star_places`, or "find".
    series : PixelSeries
        The pixels.
    """
    if isinstance(places, str):
        if places != "find":
            raise ValueError(f'`{name}` must be positions or "find", got {places!r}')
        return find_stars(series)
    return star_places(name, places, series)


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
