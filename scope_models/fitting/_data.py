"""The pixels that are fitted: what of a target pixel file can be used, and which stars it has."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy import units as u
from scipy.ndimage import maximum_filter

from scope_models._arrays import plain_array
from scope_models.exceptions import FitWarning
from scope_models.io.pixels import read_pixels, star_places, usable_positions
from scope_models.scene.detector import Detector

__all__ = ["APART", "PixelData", "detector_of", "find_stars", "read_data", "star_positions"]

# A local maximum of the median image is a star if it is brighter than this part of the brightest
# pixel, and than so many errors of the median image.
_LEAST_PART, _LEAST_SIGNIFICANCE = 0.05, 10.0
# Most stars that are found: time goes with their square.
_MOST_FOUND = 11
# Maxima so near a star are its own, pixels.
APART = 1.5
# Given stars farther outside of the pixels have no light in them, pixels.
_FARTHEST = 5.0


@dataclass(frozen=True, eq=False)
class PixelData:
    """Pixels and cadences of a target pixel file that a fit uses."""

    time: np.ndarray  # (n,), days
    cadenceno: np.ndarray
    quality: np.ndarray
    flux: np.ndarray  # (n, ny, nx), e-/s; NaN where not used
    flux_err: np.ndarray
    pixels: np.ndarray  # (ny, nx), bool: those with data
    pos_corr: np.ndarray | None  # (n, 2), interpolated where it is unusable; None if absent
    time_format: str
    light: np.ndarray  # flux with that of saturated pixels, for the first guess of the positions

    @property
    def shape(self):
        """Shape of an image."""
        return self.pixels.shape

    def __getitem__(self, cadences):
        """Return the data of some cadences."""
        names = ("time", "cadenceno", "quality", "flux", "flux_err", "pos_corr", "light")
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v if v is None else v[cadences] for k, v in values.items()})


def read_data(series, flux_err, detector, n_free, *, saturation):
    """Take from a `PixelSeries` what can be fitted; a cadence needs more than ``n_free`` pixels."""
    flux = np.array(series.flux)
    if not np.isfinite(flux).any():
        raise ValueError("`flux` has no finite value")
    error = series.flux_err
    if flux_err is not None:
        error = plain_array(flux_err, u.electron / u.s, "flux_err")
    try:
        error = np.array(np.broadcast_to(error, flux.shape))
    except ValueError:
        raise ValueError(
            f"`flux_err` must broadcast to {flux.shape}, got shape {error.shape}"
        ) from None
    _drop_bad_errors(flux, error)
    light = flux.copy()
    if saturation:
        _drop_saturated(flux, detector)
    good = np.isfinite(flux) & np.isfinite(error)
    pixels = good.any(axis=0)
    cadences = np.isfinite(series.time) & (good.sum(axis=(1, 2)) > n_free)
    if not cadences.any() or pixels.sum() <= n_free:
        raise ValueError("`tpf` has no cadence with enough pixels to fit")
    flux, error = np.where(good, flux, np.nan)[cadences], np.where(good, error, np.nan)[cadences]
    series = series[cadences]
    return PixelData(
        time=series.time,
        cadenceno=series.cadenceno,
        quality=series.quality,
        flux=flux,
        flux_err=error,
        pixels=np.isfinite(flux).any(axis=0),
        pos_corr=_pos_corr(series.pos_corr),
        time_format=series.time_format,
        light=light[cadences],
    )


def _drop_bad_errors(flux, error):
    """Leave out pixels without a positive error."""
    with np.errstate(invalid="ignore"):
        bad = np.isfinite(flux) & ~(np.isfinite(error) & (error > 0))
    if not bad.any():
        return
    if bad.sum() == np.isfinite(flux).sum():
        raise ValueError(
            "`flux_err` must be positive: the file has no errors; pass them as flux_err=..."
        )
    warnings.warn(
        f"{bad.sum()} pixel values without a positive error are left out", FitWarning, stacklevel=4
    )
    flux[bad] = np.nan


def _drop_saturated(flux, detector):
    """Leave out the columns of pixels whose wells are full: the light runs along them."""
    limit = detector.full_flux
    with np.errstate(invalid="ignore"):
        full = flux > limit
    columns = np.flatnonzero(full.mean(axis=0).max(axis=0) > 0.01)
    if columns.size:
        warnings.warn(
            f"columns {', '.join(map(str, columns))} hold saturated pixels and are left out",
            FitWarning,
            stacklevel=4,
        )
        flux[:, :, columns] = np.nan
    flux[full] = np.nan
    if not np.isfinite(flux).any():
        raise ValueError("all columns of `tpf` hold saturated pixels or none: nothing to fit")


def _pos_corr(offsets):
    """POS_CORR with straight lines over unusable cadences, or None."""
    if offsets is None:
        return None
    good = usable_positions(offsets)
    if good.sum() < 3:
        return None
    number = np.arange(len(offsets))
    return np.column_stack([np.interp(number, number[good], column[good]) for column in offsets.T])


def detector_of(tpf):
    """The preset with the exposure, gain, read noise and background of a target pixel file."""
    series = read_pixels(tpf)
    changes = {} if series.mission else {"mission": "Kepler"}
    return Detector.from_tpf(series, psf=None, sensitivity=None, **changes)


def star_positions(name, places, series):
    """Return columns and rows of stars in a stamp, ``(k, 2)``, of `star_places` or "find"."""
    if isinstance(places, str):
        if places != "find":
            raise ValueError(f'`{name}` must be positions or "find", got {places!r}')
        found = find_stars(series.flux)
        if len(found) > _MOST_FOUND:
            message = (
                f"the {_MOST_FOUND} brightest of {len(found)} maxima of the median image are "
                f"fitted; `{name}` takes the positions of more"
            )
            warnings.warn(message, FitWarning, stacklevel=4)
        return found[:_MOST_FOUND]
    found = star_places(name, places, series)
    size = np.array(series.flux.shape[:0:-1])  # columns, rows
    far = (np.abs(found - (size - 1) / 2) - size / 2).max(axis=1, initial=-np.inf) > _FARTHEST
    if name == "stars":
        far[:1] = False  # the target, which is checked against the pixels
    if far.any():
        message = f"{far.sum()} of `{name}` are far outside of the pixels and are left out"
        warnings.warn(message, FitWarning, stacklevel=4)
    return found[~far]


def find_stars(flux):
    """Return columns and rows ``(k, 2)`` of the maxima of the median image, the brightest first."""
    good = np.isfinite(flux)
    flux = np.where(good, flux, np.nan)
    seen = good.any(axis=0)
    image, error = np.full(seen.shape, -np.inf), np.ones(seen.shape)
    image[seen] = np.nanmedian(flux[:, seen], axis=0)
    scatter = np.nanmedian(np.abs(flux[:, seen] - image[seen]), axis=0)
    error[seen] = 1.4826 * scatter / np.sqrt(np.maximum(good[:, seen].sum(axis=0), 1))
    image = image - np.median(image[seen])
    ring = np.ones((3, 3), dtype=bool)
    ring[1, 1] = False
    around = maximum_filter(image, footprint=ring, mode="constant", cval=-np.inf)
    peak = seen & (image > around)
    peak &= (image > _LEAST_PART * image[seen].max()) & (image > _LEAST_SIGNIFICANCE * error)
    rows, columns = np.nonzero(peak)
    order = np.argsort(-image[rows, columns])
    return np.column_stack([columns, rows])[order].astype(float)
