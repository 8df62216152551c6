"""The model behind pixel level decorrelation: its options and its design matrix."""

import warnings
from dataclasses import dataclass, replace
from numbers import Real
from os import PathLike

import numpy as np
from astropy import units as u

from scope_models._arrays import plain_array, plain_number, plain_time
from scope_models._checks import check_fields, checked_choice, integer, number
from scope_models._values import Value, frozen
from scope_models.correctors._result import PLDFit
from scope_models.correctors._signals import transit_column
from scope_models.exceptions import DetrendingWarning
from scope_models.io import read_pixels
from scope_models.pixelmodel._pixels import Pixels, aperture_pixels, at_rows
from scope_models.pixelmodel._smooth import MOST, Smoother, quantile
from scope_models.pixelmodel._source import Source, can_predict, with_predicted_fractions
from scope_models.pixelmodel._stamp import find_row_centers, full_columns, without_saturation
from scope_models.pixelmodel._star import StarModel
from scope_models.regression._columns import (
    Regressors,
    contrast_columns,
    fraction_columns,
    least_square,
    principal_columns,
)
from scope_models.regression._solution import DEFAULT, fit

__all__ = ["PLDModel", "PLDOptions", "Settings"]

#: Branch: an error with fewer usable cadences.
_FEWEST_CADENCES = 30
_FRACTIONS = ("predicted", "measured")
#: Prior: number of columns of the constant and the polynomial trend.
_TRENDS = {"gp": 1, "quadratic": 3}
#: Prior: number of components of files of other stars.
_OTHER_COMPONENTS = 10


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PLDOptions(Value):
    """
    Options of `PLDCorrector.correct` that are rarely set.

    Parameters
    ----------
    trend : {"gp", "quadratic"}, optional
        Long-term variability: a Gaussian process or a polynomial.
    segments : sequence of float, optional
        Times (days) at which the coefficients of order 1 may change. The change has a prior
        variance of its own, which vanishes if nothing changes.
    saturation : "auto", None or float, optional
        Flux in e-/s above which a pixel is saturated, by default that of the mission if it is
        known. A full pixel stays full when the star dims: a column with such pixels counts as one
        pixel, its sum, and the default aperture has it whole. None: all pixels count.
    background : int, optional
        Number of principal components of the pixels outside of the aperture, if these are
        regressors.
    background_aperture_mask : array_like of bool or str, optional
        Pixels that these are taken from, by default all outside of the aperture; with a mask they
        are regressors.
    pca_components : int, optional
        Largest number of columns per order: the first principal components; 0 and None: as many as
        can change the flux. The prior variance keeps the unneeded ones small.
    pld_aperture_mask : array_like of bool or str, optional
        Pixels whose fractions are regressors, by default those of the aperture.
    sigma : float, optional
        Cadences that deviate by more standard deviations from what all others predict are outliers.
    max_clips : int, optional
        Largest number of times that outliers are searched.

    Raises
    ------
    TypeError, ValueError
        If an option is outside its domain.

    Examples
    --------
    >>> from scope_models.correctors import PLDOptions
    >>> PLDOptions(trend="quadratic").sigma
    5.0
    """

    trend: str = DEFAULT.trend
    segments: object = ()
    saturation: object = "auto"
    background: int = integer(3, 1)
    background_aperture_mask: object = None
    pca_components: int | None = integer(None, 0)
    pld_aperture_mask: object = None
    sigma: float = number(DEFAULT.sigma, positive=True)
    max_clips: int = integer(DEFAULT.max_clips, 0)

    def __post_init__(self):
        check_fields(self)
        checked_choice("trend", self.trend, tuple(_TRENDS))
        for name in ("pld_aperture_mask", "background_aperture_mask"):
            if isinstance(getattr(self, name), np.ndarray):
                object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "segments", _checked_segments(self.segments))
        object.__setattr__(self, "saturation", _checked_saturation(self.saturation))

    @property
    def n_trend(self):
        """Number of columns of the constant and the polynomial trend."""
        return _TRENDS[self.trend]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Settings(PLDOptions):
    """All options of a correction, as `PLDCorrector.correct` describes them."""

    order: int = integer(2, 1)
    fractions: str = "predicted"
    regressors: object = ()

    def __post_init__(self):
        super().__post_init__()
        checked_choice("fractions", self.fractions, _FRACTIONS)

    def full_flux(self, series):
        """Return the flux above which pixels of a file are full, e-/s, or None."""
        if self.saturation == "auto":
            return series.mission and series.mission.full_flux
        return self.saturation


def _checked_segments(segments):
    """Return times in days."""
    if segments is None:
        return ()
    try:
        breaks = np.atleast_1d(plain_time(segments, None, "segments")).ravel()
    except TypeError:
        breaks = np.array([np.nan])
    if not np.isfinite(breaks).all():
        raise ValueError(f"`segments` must be None or a sequence of times, got {segments!r}")
    return tuple(np.sort(breaks).tolist())


def _checked_saturation(saturation):
    """Return "auto", None or a flux in e-/s."""
    if saturation is None or (isinstance(saturation, str) and saturation == "auto"):
        return saturation
    message = f'`saturation` must be "auto", None or e-/s, got {saturation!r}'
    try:
        value = plain_number(saturation, u.electron / u.s, "saturation")
    except TypeError:
        raise ValueError(message) from None
    if not value > 0:
        raise ValueError(f"`saturation` must be positive, got {saturation}")
    return value


@dataclass(frozen=True, eq=False, repr=False)
class PLDModel:
    r"""The linear model of the logarithm of a star's flux.

    `PLDCorrector` makes one for each call of ``correct``. The equation is on the page
    :doc:`/explanation/pld`. ``clean`` is what was found about the pixels if the fractions are
    predicted ones, ``source`` the pixels as measured, into which `PLDFit.survival` puts dimmings.
    """

    pixels: Pixels
    options: Settings
    source: Source
    clean: StarModel | None
    saturation: float | None  # flux of a full pixel among measured ones, e-/s
    breaks: tuple  # times at which a new segment begins
    extra: dict  # further groups: columns by name, NaN where unknown

    @classmethod
    def from_pixels(cls, pixels, options, series, cadence_mask):
        """Make the model of pixels of a `PixelSeries`, learned from the cadences of a mask."""
        source = Source(pixels, series, cadence_mask)
        use = pixels.usable & pixels.lit & cadence_mask
        _check_enough(use)
        extra = given_columns(pixels, options, series.cadenceno, use)
        saturation = options.full_flux(series)
        if pixels.weights is None and pixels.loses_charge(use, saturation):
            message = "charge of full pixels bleeds out of `aperture_mask`: give it whole columns"
            warnings.warn(message, DetrendingWarning, stacklevel=5)
        clean = None
        measured = options.fractions == "measured" or options.pld_aperture_mask is not None
        if not measured and "background" not in extra and can_predict(pixels, saturation, use):
            predicted, clean = with_predicted_fractions(pixels, series.pos_corr, use, saturation)
        if clean is not None:
            found, usable = clean.columns(source.share, use[pixels.usable]), pixels.usable
            extra |= {name: at_rows(values, usable) for name, values in found.items()}
            pixels, saturation = predicted, None
        else:
            if "background" not in extra:
                extra["level"] = level_column(pixels, use)
            pixels = pixels.weighted
        time = pixels.time[use & pixels.usable]
        breaks = tuple(b for b in options.segments if time[0] < b <= time[-1])
        return cls(pixels, options, source, clean, saturation, breaks, extra)

    def __repr__(self):
        return (
            f"<PLDModel: order {self.options.order}, {self.pixels.usable.sum()} cadences, "
            f"{self.pixels.aperture.sum()} pixels>"
        )

    def regressors(self, use):
        """Return the `Regressors` of the usable cadences, centered on those in use."""
        pixels, options, usable = self.pixels, self.options, self.pixels.usable
        total, most = pixels.total[usable], options.pca_components or None
        mask = pixels.aperture if options.pld_aperture_mask is None else options.pld_aperture_mask
        images = np.where(mask, np.nan_to_num(pixels.flux[usable]), 0.0)
        full = full_columns(images, use, self.saturation)
        if full.any():
            centers = find_row_centers(images, mask, use, self.saturation)
            images = without_saturation(images, full, centers, mask)
        images /= total[:, None, None]
        least = least_square((pixels.total_err[usable] / total)[use] ** 2)
        kind = {"order": options.order, "most": most, "predicted": self.clean is not None}
        parts = fraction_columns(images, mask, use, least, **kind)
        if self.breaks:
            parts["segments"] = contrast_columns(
                parts["order 1"], pixels.time[usable], self.breaks, use
            )
        for name, columns in self.extra.items():
            parts[name] = principal_columns(columns[usable], use, least)
        return Regressors.join(parts)

    def design_matrix(self, cadence_mask):
        """Return the `Regressors`, NaN in cadences that cannot be used.

        Means and principal components are those of the cadences of the mask.
        """
        usable = self.pixels.usable
        found = self.regressors(cadence_mask[usable])
        return replace(found, columns=at_rows(found.columns, usable))

    def fit(self, cadence_mask, transit_mask, transit_model=None):
        """Fit the model to cadences that may be used and are not in transit; return a `PLDFit`.

        The amplitude of the relative flux of a ``transit_model`` is fitted jointly.
        """
        pixels, usable = self.pixels, self.pixels.usable
        mask = cadence_mask & pixels.lit & ~transit_mask
        column = np.empty((len(usable), 0))
        if transit_model is not None:
            column = transit_column(transit_model, pixels.time)
        allowed = mask[usable]
        _check_enough(allowed)
        total = pixels.total[usable]
        y = np.log(total / np.median(total[allowed]))
        variance = (pixels.total_err[usable] / total) ** 2
        try:
            solution = fit(
                self.regressors,
                pixels.time[usable],
                y,
                variance,
                allowed,
                column[usable],
                self.options,
                predicted=self.clean is not None,
            )
        except np.linalg.LinAlgError as error:
            raise ValueError(
                "the pixels' covariance is singular to working precision: check FLUX_ERR and the "
                "aperture, or lower `order`"
            ) from error
        if solution.use.sum() < 0.5 * allowed.sum():
            raise ValueError(
                f"{(allowed & ~solution.use).sum()} of {allowed.sum()} cadences deviate from any "
                "model: the star varies in a way that it cannot follow, or most pixels are "
                "damaged. Raise `sigma`, set `max_clips` to 0, or leave cadences out with "
                "`cadence_mask`"
            )
        return PLDFit(self, solution, mask, transit_mask, transit_model if column.size else None)


def _check_enough(use):
    if use.sum() < _FEWEST_CADENCES:
        raise ValueError(
            f"at least {_FEWEST_CADENCES} usable cadences of `tpf` are needed, got {use.sum()}"
        )


def given_columns(pixels, options, cadenceno, use):
    """Return groups of columns by name that a user wants, as `PLDCorrector.correct` takes them."""
    given, groups = options.regressors, {}
    several = isinstance(given, list | tuple) and not any(isinstance(one, Real) for one in given)
    background, others, columns = options.background_aperture_mask is not None, [], []
    for one in given if several else [given]:
        if isinstance(one, str) and one == "background":
            background = True
        elif hasattr(one, "flux") or isinstance(one, (str, PathLike)):
            others.append(_fractions_of(one, cadenceno))
        else:
            columns.append(_columns_of(one, cadenceno))
    if background:
        groups["background"] = _background_columns(pixels, options, use)
    if others:
        groups["other_targets"] = np.concatenate(others, axis=1)
    if columns:
        columns = np.concatenate(columns, axis=1)
        spread = np.nanstd(columns, axis=0)
        groups["regressors"] = columns[:, spread > 0] / spread[spread > 0]
    return groups


def _background_columns(pixels, options, use):
    """Return the principal components of pixels over the flux, by default all outside."""
    usable, outside = pixels.usable, options.background_aperture_mask
    outside = ~pixels.aperture if outside is None else outside
    outside = outside & np.isfinite(pixels.flux[usable]).all(axis=0)
    if not outside.any():
        raise ValueError("the background needs pixels with data outside of `aperture_mask`")
    relative = pixels.flux[usable][:, outside] / pixels.total[usable, None]
    found = principal_columns(relative, use[usable], 0.0)
    return at_rows(found[:, : options.background], usable)


def _fractions_of(source, cadenceno):
    """Return the first principal components of the pixel fractions of a file of another star."""
    series = read_pixels(source)
    pixels = aperture_pixels(series, None)
    usable = pixels.usable & pixels.lit
    relative = pixels.flux[usable][:, pixels.aperture] / pixels.total[usable, None]
    columns = principal_columns(relative, np.ones(len(relative), dtype=bool), 0.0)
    columns = columns[:, :_OTHER_COMPONENTS]
    return _matched(columns, series.cadenceno[usable], cadenceno, "files in `regressors`")


def _columns_of(regressor, cadenceno):
    """Return columns of a user's own, NaN where they are unknown.

    Basis vectors are matched by cadence numbers; all else must have a row per cadence.
    """
    if hasattr(regressor, "cbv_indices"):
        vectors = [regressor[f"VECTOR_{k}"] for k in regressor.cbv_indices]
        vectors = np.stack([plain_array(one, "", "regressors") for one in vectors], axis=1)
        vectors[np.asarray(regressor["GAP"], dtype=bool)] = np.nan
        return _matched(vectors, np.asarray(regressor["CADENCENO"]), cadenceno, "`regressors`")
    values = regressor.values if hasattr(regressor, "prior_sigma") else regressor
    columns = plain_array(values, "", "regressors")
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or len(columns) != len(cadenceno):
        raise ValueError(f"`regressors` must have {len(cadenceno)} rows, got shape {columns.shape}")
    return columns


def _matched(columns, number, cadenceno, name):
    """Return columns with a row per cadence, by cadence numbers; NaN where there is none."""
    _, here, there = np.intersect1d(cadenceno, number, return_indices=True)
    if not len(here):
        raise ValueError(f"{name} must share cadences with the target, got none")
    matched = np.full((len(cadenceno), columns.shape[1]), np.nan)
    matched[here] = columns[there]
    return matched


def level_column(pixels, use):
    """Return the light of a background that changes, over the flux, of the aperture.

    Its level is the median of the pixels outside that the star lights least, without what follows
    the flux.
    """
    usable, flux, fit = pixels.usable, pixels.flux[pixels.usable], use[pixels.usable]
    outside = ~pixels.aperture & np.isfinite(flux).all(axis=0)
    column = np.zeros((len(usable), 1))
    if outside.any():
        relative = pixels.total[usable] / np.median(pixels.total[usable][fit])
        light = flux[:, outside]
        most = quantile(light[fit].T, MOST)
        dark = light[:, most <= np.median(most)]
        level = np.median(dark - np.median(dark[fit], axis=0) * relative[:, None], axis=1)
        level, _ = Smoother(pixels.time[usable], fit)(level, np.ones(len(level)))
        inside = np.broadcast_to(pixels.inside, pixels.flux.shape)[usable].sum(axis=(1, 2))
        column[usable, 0] = level * inside / pixels.total[usable]
    return column
