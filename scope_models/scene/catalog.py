"""Stars of catalogs: their places on the sky, proper motions, and faint stars between them."""

import warnings
from functools import cache

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from scope_models._arrays import plain_array, plain_number
from scope_models.exceptions import CatalogWarning
from scope_models.io import TPFMetadata
from scope_models.missions import MISSIONS
from scope_models.models import PRFGrid
from scope_models.models._description import check_coord
from scope_models.models._series import unit_images
from scope_models.scene.star import Star

__all__ = ["star_counts"]

# Names of columns, in lower case, in order of preference.
_RA, _DEC = ("ra", "ra_icrs", "raj2000", "_raj2000"), ("dec", "de_icrs", "dej2000", "_dej2000")
_PROPER_MOTIONS = (("pmra", "pm_ra_cosdec"), ("pmdec", "pmde", "pm_dec"))
_EPOCH = ("ref_epoch", "epoch")
_MAGNITUDES = {
    "Kp": ("kp", "kpmag", "kepmag", "k2mag"),
    "T": ("tmag", "tessmag", "t"),
    "R": ("rmag", "r"),
}
_ANY_MAGNITUDE = ("mag", "magnitude", "phot_g_mean_mag", "gmag")
_FARTHEST = 200.0  # px beyond the stamp
_MARGIN = 20  # px about the stamp in which faint stars are drawn
# A star outside matters if it adds this part of a dark pixel's noise to any pixel.
_LEAST_NOISE = 0.01
_PSF_BLOCK = 64  # px in which the PSF is taken as the same
_BATCH = 64
_BRIGHTEST, _LOWEST_LATITUDE = 5.0, 20.0


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


def star_frame(coord, shape, wcs):
    """Return the target's place, the pixel scale (arcsec) and the matrix of a scene, of a WCS."""
    x, y = (float(value) for value in wcs.world_to_pixel(coord))
    if not np.hypot(x, y) < 10 * sum(shape):
        raise ValueError(f"`coord` is far from the field of `wcs`: column {x:g}, row {y:g}")
    steps = wcs.pixel_to_world([x + 1, x], [y, y + 1])
    east, north = (q.to_value(u.arcsec) for q in coord.spherical_offsets_to(steps))
    scale = float(np.sqrt(abs(east[0] * north[1] - east[1] * north[0])))
    return (x, y), scale, tuple((np.concatenate([-east, north]) / scale).tolist())


def find_target(coord, target, places, mags, pixel_scale):
    """Return the target's place, the target, and places and magnitudes of the other stars."""
    if not isinstance(target, Star | None):
        raise TypeError(f"`target` must be a Star, got {target!r}")
    distance = coord.separation(places).arcsec
    nearest = np.argsort(distance)[:1]
    same = nearest[distance[nearest] <= pixel_scale]
    if target is None:
        if not len(same):
            far = "".join(f"; the nearest is {d / 3600:.3g} deg away" for d in distance[nearest])
            lacking = f"`table` has no star within a pixel of `coord`{far}"
            raise ValueError(f"{lacking}: give the `target`")
        coord, target = places[same[0]], Star(mags[same[0]])
    others = np.delete(np.arange(len(mags)), same)
    return coord, target.replace(coord=None), places[others], mags[others]


def place_stars(base, places, mags, magnitude_limit, background_stars, psf):
    """Return the target and the stars whose light falls into the stamp of a scene of the target.

    ``psf`` varies with the place; the other arguments are those of `Scene.from_catalog`.
    """
    xy = np.column_stack([places.ra.deg, places.dec.deg])
    xy = base.wcs.wcs_world2pix(xy, 0) if len(xy) else xy
    used = np.isfinite(xy).all(axis=1)
    if magnitude_limit is not None:
        used &= mags <= plain_number(magnitude_limit, u.mag, "magnitude_limit")
    drawn_xy, drawn = _draw(base, background_stars, mags[used])
    xy, mags = np.concatenate([xy[used], drawn_xy]), np.append(mags[used], drawn)

    @cache
    def psf_at(x, y):
        column = TPFMetadata.column if base.column is None else base.column
        row = TPFMetadata.row if base.row is None else base.row
        at = psf.at if isinstance(psf, PRFGrid) else psf
        return None if at is None else at(column + x, row + y)

    target = base.stars[0]
    target = target if psf is None else target.replace(psf=psf_at(*base.positions[0]))
    kept = _lighting(base, xy, mags, target.psf or base.detector.psf)
    blocks = _PSF_BLOCK * (xy[kept] // _PSF_BLOCK + 0.5)
    found = zip(mags[kept], xy[kept], blocks, strict=True)
    return [target, *(Star(mag, *place, psf=psf_at(*block)) for mag, place, block in found)]


def _column(table, names, unit, needed=None):
    """Return the values of the first column of some names, or None if it is not needed."""
    known = {name.lower(): name for name in table.colnames}
    name = next((known[name] for name in names if name in known), None)
    if name is None and needed:
        found = ", ".join(table.colnames) or "none"
        raise ValueError(f"`table` must have a column {needed}, got {found}")
    return None if name is None else plain_array(table[name], unit, f"table[{name!r}]")


def read_catalog(table, mission, magnitude, ref_epoch, year):
    """Return places at a time (Julian year), and magnitudes, of a catalog's stars."""
    if table is None:
        return SkyCoord([], [], unit=u.deg), np.zeros(0)
    try:
        table = Table(table)
    except (TypeError, ValueError) as error:
        kind = type(table).__name__
        raise TypeError(f"`table` must be a Table or a mapping of columns, got {kind}") from error
    band = MISSIONS[mission].band if mission in MISSIONS else ""
    names = _MAGNITUDES.get(band, ()) + _ANY_MAGNITUDE
    names = names if magnitude is None else (magnitude.lower(),)
    if ref_epoch is not None:
        is_time = isinstance(ref_epoch, Time)
        ref_epoch = ref_epoch.jyear if is_time else plain_number(ref_epoch, u.yr, "ref_epoch")
    ra, dec = _column(table, _RA, u.deg, "ra"), _column(table, _DEC, u.deg, "dec")
    mags = _column(table, names, u.mag, " or ".join(names))
    if np.any(np.abs(dec) > 90):
        raise ValueError("`table` must have declinations within -90 to 90")
    good = np.isfinite(ra) & np.isfinite(dec) & np.isfinite(mags)
    if not good.all():
        lacking = f"{np.sum(~good)} of {len(good)} stars of the table have no place or no magnitude"
        warnings.warn(f"{lacking}, and are left out", CatalogWarning, stacklevel=3)
    places = SkyCoord(ra[good], dec[good], unit=u.deg)
    motions = [_column(table, names, u.mas / u.yr) for names in _PROPER_MOTIONS]
    if any(m is None for m in motions) or not good.any():
        return places, mags[good]
    epoch = _column(table, _EPOCH, u.yr) if ref_epoch is None else ref_epoch
    if epoch is None or not np.all(np.isfinite(epoch)):
        raise ValueError("`ref_epoch` must be given: `table` has proper motions, but no epoch")
    since = np.broadcast_to(year - epoch, good.shape)[good]
    offsets = (np.nan_to_num(m[good]) * since * u.mas for m in motions)
    return places.spherical_offsets_by(*offsets), mags[good]


def _draw(base, faintest, mags):
    """Return places and magnitudes of stars that are fainter than a catalog's."""
    if faintest is None:
        return np.zeros((0, 2)), np.zeros(0)
    faintest = plain_number(faintest, u.mag, "background_stars")
    generator = np.random.default_rng([base.seed or 0, 1])
    grid = np.linspace(min(max(mags, default=_BRIGHTEST), faintest), faintest, 200)
    counts = star_counts(grid, SkyCoord(base.ra, base.dec, unit=u.deg))
    size = np.array(base.detector.shape[::-1]) + 2 * _MARGIN
    area = size.prod() * (base.detector.pixel_scale / 3600) ** 2
    deviates = generator.random((generator.poisson(area * (counts[-1] - counts[0])), 3))
    drawn = np.interp(counts[0] + deviates[:, 0] * (counts[-1] - counts[0]), counts, grid)
    return deviates[:, 1:] * size - _MARGIN - 0.5, drawn


def _lighting(base, xy, mags, model):
    detector, size = base.detector, np.array(base.detector.shape[::-1])
    moved, middle = np.column_stack([base.motion.x, base.motion.y]), (size - 1) / 2
    # The place within the motion that is nearest to the middle of the stamp.
    nearest = np.clip(middle, xy + moved.min(axis=0), xy + moved.max(axis=0))
    outside = np.hypot(*np.maximum(np.abs(nearest - middle) - size / 2, 0).T)
    kept = outside == 0
    seconds = detector.exposure_time
    variance = detector.background * seconds + detector.cadence_read_noise**2
    least = _LEAST_NOISE * max(np.sqrt(variance), 1.0) / seconds
    candidates = np.flatnonzero((outside > 0) & (outside < _FARTHEST))
    for part in np.split(candidates, range(_BATCH, len(candidates), _BATCH)):
        images = unit_images(model, detector.shape, *nearest[part].T)
        brightest = images.max(axis=(1, 2), initial=0.0)
        kept[part] = brightest * detector.flux_from_mag(mags[part]) > least
    return kept
