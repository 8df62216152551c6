"""The pixels that are fitted: what of a target pixel file can be used."""

import warnings
from dataclasses import dataclass, replace

import numpy as np

from scope_models.exceptions import FitWarning
from scope_models.io.pixels import usable_positions
from scope_models.missions import Mission
from scope_models.scene.detector import Detector

__all__ = ["PixelData", "detector_of", "read_data"]


@dataclass(frozen=True, eq=False)
class PixelData:
    """
    Pixels and cadences of a target pixel file that a fit uses.

    Parameters
    ----------
    time : ndarray of shape (n,)
        Days.
    cadenceno, quality : ndarray of int, shape (n,)
        Numbers and flags of the cadences.
    flux, flux_err : ndarray of shape (n, ny, nx)
        e-/s; NaN where not used.
    pixels : ndarray of bool, shape (ny, nx)
        Pixels with data.
    pos_corr : ndarray of shape (n, 2) or None
        Offsets along columns and rows, interpolated where they are unusable; None if absent.
    time_format : str
        "bkjd" or "btjd".
    light : ndarray of shape (n, ny, nx)
        Flux with that of saturated pixels, for the first guess of the positions.
    """

    time: np.ndarray
    cadenceno: np.ndarray
    quality: np.ndarray
    flux: np.ndarray
    flux_err: np.ndarray
    pixels: np.ndarray
    pos_corr: np.ndarray | None
    time_format: str
    light: np.ndarray

    @property
    def shape(self):
        """Shape of an image."""
        return self.pixels.shape

    def __getitem__(self, cadences):
        """Return the data of some cadences."""
        names = ("time", "cadenceno", "quality", "flux", "flux_err", "pos_corr", "light")
        values = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v if v is None else v[cadences] for k, v in values.items()})


def read_data(tpf, flux_err, detector, n_free, *, saturation):
    """
    Take from a target pixel file what can be fitted.

    Parameters
    ----------
    tpf : lightkurve.TargetPixelFile
        The file.
    flux_err : array_like or None
        Errors in place of those of the file.
    detector : Detector
        What tells the depth of the wells.
    n_free : int
        Parameters of a cadence: it needs more pixels than these.
    saturation : bool
        Whether saturated columns are left out.

    Returns
    -------
    PixelData
        The data.

    Raises
    ------
    TypeError, ValueError
        If there is nothing to fit.
    """
    flux = _cube("flux", getattr(tpf, "flux", None))
    given = getattr(tpf, "flux_err", None) if flux_err is None else flux_err
    error = np.full(flux.shape, np.nan) if given is None else _numbers(given)
    try:
        error = np.broadcast_to(error, flux.shape).copy()
    except ValueError:
        raise ValueError(
            f"`flux_err` must broadcast to {flux.shape}, got shape {error.shape}"
        ) from None
    time = _numbers(tpf.time.value)
    _drop_bad_errors(flux, error)
    light = flux.copy()
    if saturation:
        _drop_saturated(flux, detector)
    good = np.isfinite(flux) & np.isfinite(error)
    pixels = good.any(axis=0)
    cadences = np.isfinite(time) & (good.sum(axis=(1, 2)) > n_free)
    if not cadences.any() or pixels.sum() <= n_free:
        raise ValueError("`tpf` has no cadence with enough pixels to fit")
    flux, error = np.where(good, flux, np.nan)[cadences], np.where(good, error, np.nan)[cadences]
    n = len(time)
    return PixelData(
        time=time[cadences],
        cadenceno=_integers(tpf, "cadenceno", np.arange(1, n + 1))[cadences],
        quality=_integers(tpf, "quality", np.zeros(n))[cadences],
        flux=flux,
        flux_err=error,
        pixels=np.isfinite(flux).any(axis=0),
        pos_corr=_pos_corr(tpf, cadences),
        time_format="btjd" if getattr(tpf.time, "format", "") == "btjd" else "bkjd",
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


def _numbers(values):
    """A float64 copy without unit or mask."""
    values = getattr(values, "value", values)
    if isinstance(values, np.ma.MaskedArray):
        values = values.astype(float).filled(np.nan)
    return np.array(values, dtype=float)


def _cube(name, values):
    if values is None:
        raise TypeError("`tpf` must be a target pixel file with time, flux and flux_err")
    values = _numbers(values)
    if values.ndim != 3 or not values.size:
        raise ValueError(f"`{name}` must have shape (n_cadences, ny, nx), got {values.shape}")
    if not np.isfinite(values).any():
        raise ValueError(f"`{name}` has no finite value")
    return values


def _integers(tpf, name, default):
    values = getattr(tpf, name, None)
    return np.asarray(default if values is None else values).astype(np.int64)


def _pos_corr(tpf, cadences):
    """POS_CORR of the cadences, with straight lines over unusable ones, or None."""
    try:
        columns = [tpf.pos_corr1, tpf.pos_corr2]
    except (AttributeError, KeyError):
        return None
    if any(column is None for column in columns):
        return None
    offsets = np.column_stack([_numbers(column) for column in columns])[cadences]
    good = usable_positions(offsets)
    if good.sum() < 3:
        return None
    number = np.arange(len(offsets))
    return np.column_stack([np.interp(number, number[good], u[good]) for u in offsets.T])


def detector_of(tpf):
    """
    The detector that recorded a target pixel file, as its headers tell.

    Parameters
    ----------
    tpf : lightkurve.TargetPixelFile
        The file.

    Returns
    -------
    Detector
        A preset with the file's exposure, gain, read noise and background.
    """
    unknown = Mission.from_header(tpf.meta) is None
    changes = {"mission": "Kepler"} if unknown else {}
    return Detector.from_tpf(tpf, psf=None, sensitivity=None, **changes)
