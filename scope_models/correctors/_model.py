"""The model behind pixel level decorrelation: its options and its design matrix."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy import units as u

from scope_models._arrays import plain_number, plain_time
from scope_models._checks import check_fields, checked_choice, integer, number
from scope_models._values import Value, frozen
from scope_models.correctors._design import (
    DesignOptions,
    at_rows,
    clean_columns,
    given_columns,
    level_column,
    make_regressors,
)
from scope_models.correctors._injection import Source, transit_column
from scope_models.correctors._pixels import Pixels
from scope_models.correctors._result import PLDFit
from scope_models.correctors._solution import fit
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._columns import find_row_centers, rows_of_star, without_saturation
from scope_models.pixelmodel._star import StarModel, fit_star

__all__ = ["PLDModel", "PLDOptions", "Settings", "can_predict", "with_predicted_fractions"]

#: Branch: an error with fewer usable cadences.
_FEWEST_CADENCES = 30
_FRACTIONS = ("predicted", "measured")
#: Prior: number of columns of the constant and the polynomial trend.
_TRENDS = {"gp": 1, "quadratic": 3}
#: Branch: as many pixels as a cadence has unknowns show none of them: brightness, place, width and
#: background.
_STATES = 5


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
        known. A full pixel stays full when the star dims, so that its share of the light would
        reveal to the model a transit: a column with such pixels counts as one pixel, its sum,
        and the default aperture has it whole. None: all pixels count.
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

    trend: str = "gp"
    segments: object = ()
    saturation: object = "auto"
    background: int = integer(3, 1)
    background_aperture_mask: object = None
    pca_components: int | None = integer(None, 0)
    pld_aperture_mask: object = None
    sigma: float = number(5.0, positive=True)
    max_clips: int = integer(5, 0)

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
    :doc:`/explanation/pld`. Of the options, ``design`` has those of the design matrix, with what
    has been found in the file; ``clean`` is what was found about the pixels if the fractions are
    predicted ones, ``source`` the pixels as measured, into which `PLDFit.survival` puts dimmings.
    """

    pixels: Pixels
    options: PLDOptions
    design: DesignOptions
    source: Source
    clean: StarModel | None

    @classmethod
    def from_pixels(cls, pixels, options, series, cadence_mask):
        """Make the model of pixels of a `PixelSeries`, learned from the cadences of a mask."""
        source, use = (
            Source(pixels, series, cadence_mask),
            pixels.usable & pixels.lit & cadence_mask,
        )
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
            extra |= clean_columns(clean, source.share, pixels.usable, use)
            pixels, saturation = predicted, None
        else:
            if "background" not in extra:
                extra["level"] = level_column(pixels, use)
            pixels = pixels.weighted
        time = pixels.time[use & pixels.usable]
        design = DesignOptions(
            options.order,
            saturation,
            breaks=tuple(b for b in options.segments if time[0] < b <= time[-1]),
            extra=extra,
            most=options.pca_components or None,
            mask=options.pld_aperture_mask,
            predicted=clean is not None,
        )
        return cls(pixels, options, design, source, clean)

    def __repr__(self):
        return (
            f"<PLDModel: order {self.options.order}, {self.pixels.usable.sum()} cadences, "
            f"{self.pixels.aperture.sum()} pixels>"
        )

    def design_matrix(self, cadence_mask):
        """Return the `Regressors`, NaN in cadences that cannot be used.

        Means and principal components are those of the cadences of the mask.
        """
        usable = self.pixels.usable
        found = make_regressors(self.pixels, cadence_mask[usable], self.design)
        return replace(found, columns=at_rows(found.columns, usable))

    def fit(self, cadence_mask, transit_mask, transit_model=None):
        """Fit the model to cadences that may be used and are not in transit; return a `PLDFit`.

        The amplitude of the relative flux of a ``transit_model`` is fitted jointly. A ValueError is
        raised if no regressor varies, fewer than 30 cadences are left, or the covariance is
        singular.
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
                lambda use: make_regressors(pixels, use, self.design),
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


def can_predict(pixels, saturation, use):
    """Whether the pixel fractions can be predicted, learned from the cadences in ``use``.

    Not with few pixels, of which full columns, at ``saturation``, e-/s, are one each, without
    FLUX_ERR, nor for a moving aperture over full columns.
    """
    flux, error = pixels.flux[use][:, pixels.aperture], pixels.flux_err[use]
    full = pixels.full_columns(use, saturation)
    seen = _seen(pixels)
    n_pixels = (seen & full).any(axis=0).sum() + (seen & ~full).sum()
    if n_pixels <= _STATES or (pixels.weights is not None and full.any()):
        return False
    return np.ptp(flux, axis=0).max() > 0 and bool((error > 0).any())


def _seen(pixels):
    """Return the pixels with data that may show the star."""
    seen = np.zeros_like(pixels.aperture)
    seen[pixels.near] = True
    return seen & np.isfinite(pixels.flux[pixels.usable]).all(axis=0)


def with_predicted_fractions(pixels, pos_corr, learned, saturation):
    """Return the star's light with predicted pixel fractions in place of the measured pixels.

    Images are ``learned`` from some cadences. The ``total`` of the returned pixels is the light
    without background, their ``flux`` the predicted fractions at constant focus times this. Second
    comes the `StarModel`; None, with the pixels as they were, if it is singular or not one of
    light, or if there are too few cadences.
    """
    use = pixels.usable
    full = pixels.full_columns(learned, saturation)
    # others do not vary with this one
    known = _seen(pixels) & (pixels.aperture | pixels.own & ~full)
    rows, columns = np.nonzero(known)
    if pos_corr is None:
        pos_corr = np.full((len(use), 2), np.nan)
    error = pixels.flux_err[use][:, known]
    error = np.where(error > 0, error, np.nan)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # pixels without errors
        typical = np.nanmedian(error, axis=0)
    typical[np.isnan(typical)] = np.nanmedian(typical)
    error = np.where(np.isnan(error), typical, error)
    try:
        with np.errstate(all="ignore"):  # of a model that fails
            clean = fit_star(
                pixels.time[use],
                pixels.flux[use][:, known],
                error,
                pos_corr[use],
                np.stack([columns, rows], axis=1),
                pixels.aperture[known],
                use=pixels.quiet(learned)[use],
                banded=pixels.banded[use],
                full=full[columns],
            )
    except (np.linalg.LinAlgError, ValueError):  # singular, or no number
        clean = None
    if clean is None or not np.median(clean.light[learned[use]]) > 0:  # or no number
        message = (
            "the model of the pixels fails, or the star has too many places for so few cadences: "
            "measured fractions are taken"
        )
        warnings.warn(message, DetrendingWarning, stacklevel=4)
        return pixels, None
    light, light_error = clean.light, clean.light_error
    if pixels.weights is not None:
        light, light_error = _light_in_window(pixels, clean, use, known)
    flux = np.zeros_like(pixels.flux)
    cube = np.zeros((use.sum(), *known.shape))
    cube[:, known] = clean.still * light[:, None]
    if full.any():
        inside, learned = pixels.aperture & known, learned[use]
        centers = find_row_centers(np.nan_to_num(pixels.flux[use]), inside, learned, saturation)
        varies = clean.position, clean.variable, learned
        cube = without_saturation(cube, full, rows_of_star(centers, *varies), inside)
        if pixels.neighbors is not None:  # what is left of their light follows the star
            weighted = rows_of_star(clean.weighted[:, None], *varies)[:, 0]
            clean = replace(clean, misfit=rows_of_star(clean.misfit, *varies), weighted=weighted)
    flux[use] = cube
    total, total_err = at_rows(light, use), at_rows(light_error, use)
    usable = use & (np.nan_to_num(total) > 0)
    return replace(pixels, flux=flux, total=total, total_err=total_err, usable=usable), clean


def _light_in_window(pixels, clean, use, known):
    """Return the star's light from the part that a moving aperture holds, and its error."""
    weights = pixels.weights[use][:, known] * pixels.aperture[known]
    held = np.sum(weights * clean.shares, axis=1)
    measured = pixels.flux[use][:, known] - clean.background
    predicted = clean.shares * clean.light[:, None]
    light = np.sum(weights * np.where(clean.repaired, predicted, measured), axis=1) / held
    variance = np.sum((weights * pixels.flux_err[use][:, known]) ** 2, axis=1)
    return light, np.sqrt(variance) / held
