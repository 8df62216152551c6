"""The model behind pixel level decorrelation: its options and its design matrix."""

import warnings
from dataclasses import dataclass

import numpy as np
from astropy import units as u

from scope_models._arrays import plain_number, plain_time
from scope_models._checks import check_fields, checked_choice, checked_mask, integer, number
from scope_models._values import Value, frozen
from scope_models.correctors._design import (
    DesignOptions,
    background_columns,
    focus_columns,
    level_column,
    make_regressors,
    misfit_columns,
    other_columns,
    outside_column,
)
from scope_models.correctors._features import Regressors
from scope_models.correctors._fractions import can_predict, with_predicted_fractions
from scope_models.correctors._injection import Source, transit_column
from scope_models.correctors._lightkurve import external_columns, sorted_regressors
from scope_models.correctors._pixels import Pixels
from scope_models.correctors._result import PLDFit
from scope_models.correctors._solution import fit
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._star import StarModel

__all__ = ["PLDModel", "PLDOptions", "Settings"]

#: Branch: an error with fewer usable cadences.
_FEWEST_CADENCES = 30
_FRACTIONS = ("predicted", "measured")
#: Prior: number of columns of the constant and the polynomial trend.
_TRENDS = {"gp": 1, "quadratic": 3}


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
    clean: StarModel | None = None
    source: Source | None = None

    @classmethod
    def from_pixels(cls, pixels, options, series, cadence_mask=None):
        """Make the model of pixels of a `PixelSeries`.

        Images and components are learned from the cadences of ``cadence_mask``, by default all.
        """
        extra, source = {}, Source(pixels, series, cadence_mask)
        use = pixels.usable & pixels.lit
        if cadence_mask is not None:
            use = use & cadence_mask
        _check_enough(use)
        background, others, columns = sorted_regressors(options.regressors)
        outside = options.background_aperture_mask
        if outside is not None:
            outside = checked_mask("background_aperture_mask", outside, pixels.aperture.shape)
            background = True
        if background:
            extra["background"] = background_columns(pixels, options.background, outside, use)
        regressor_mask = options.pld_aperture_mask
        if regressor_mask is not None:
            shape = pixels.aperture.shape
            regressor_mask = checked_mask("pld_aperture_mask", regressor_mask, shape)
        if others:
            extra["other_targets"] = other_columns(series.cadenceno, others)
        if columns:
            extra["regressors"] = external_columns(columns, series.cadenceno)
        saturation = options.full_flux(series)
        if pixels.weights is None and pixels.loses_charge(use & pixels.usable, saturation):
            message = "charge of full pixels bleeds out of `aperture_mask`: give it whole columns"
            warnings.warn(message, DetrendingWarning, stacklevel=5)
        clean = None
        plain = options.fractions != "measured" and regressor_mask is None and not background
        if plain and can_predict(pixels, saturation, use):
            predicted, clean = with_predicted_fractions(pixels, series.pos_corr, use, saturation)
            if clean:
                extra["focus"] = focus_columns(clean, pixels.usable, use)
                extra["aperture"] = outside_column(clean, pixels.usable)
                share = source.share[*clean.grid.T[::-1]]
                extra["misfit"] = misfit_columns(clean, share, pixels.usable)
                pixels, saturation = predicted, None
        if clean is None:
            if "background" not in extra:
                extra["level"] = level_column(pixels, use)
            pixels = pixels.weighted
        time = pixels.time[use & pixels.usable]
        breaks = tuple(b for b in options.segments if time[0] < b <= time[-1])
        most, predicted = options.pca_components or None, clean is not None
        design = DesignOptions(
            options.order, saturation, breaks, extra, most, regressor_mask, predicted
        )
        return cls(pixels, options, design, clean, source)

    def __repr__(self):
        return (
            f"<PLDModel: order {self.options.order}, {self.pixels.usable.sum()} cadences, "
            f"{self.pixels.aperture.sum()} pixels>"
        )

    def design_matrix(self, cadence_mask=None):
        """Return the `Regressors`, NaN in cadences that cannot be used.

        Means and principal components are those of the cadences of the mask, by default all.
        """
        usable = self.pixels.usable
        use = usable if cadence_mask is None else usable & cadence_mask
        found = make_regressors(self.pixels, use[usable], self.design)
        columns = np.full((len(usable), found.columns.shape[1]), np.nan)
        columns[usable] = found.columns
        return Regressors(columns, found.groups, found.names)

    def fit(self, cadence_mask=None, *, transit_mask=None, transit_model=None):
        """Fit the model to cadences that may be used and are not in transit; return a `PLDFit`.

        The amplitude of the relative flux of a ``transit_model`` is fitted jointly. A ValueError is
        raised if no regressor varies, fewer than 30 cadences are left, or the covariance is
        singular.
        """
        pixels, n = self.pixels, len(self.pixels.time)
        usable = pixels.usable
        mask = np.ones(n, dtype=bool) if cadence_mask is None else cadence_mask
        mask = mask & pixels.lit
        in_transit = np.zeros(n, dtype=bool) if transit_mask is None else transit_mask
        column = np.empty((n, 0))
        if transit_model is not None:
            column = transit_column(transit_model, pixels.time)
        allowed = (mask & ~in_transit)[usable]
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
        if not column.size:
            transit_model = None
        return PLDFit(self, solution, mask & ~in_transit, in_transit, transit_model)


def _check_enough(use):
    if use.sum() < _FEWEST_CADENCES:
        raise ValueError(
            f"at least {_FEWEST_CADENCES} usable cadences of `tpf` are needed, got {use.sum()}"
        )
