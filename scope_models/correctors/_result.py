"""The fit of pixel level decorrelation, and what follows from it."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from astropy.table import QTable
from scipy import ndimage
from scipy.stats import norm

from scope_models._checks import checked_cadences, checked_integer
from scope_models._threads import one_thread
from scope_models._values import html_table
from scope_models.correctors._signals import (
    box_signal,
    checked_depth,
    depth_ratio,
    fitted_depth,
    no_survival,
    transit_column,
)
from scope_models.exceptions import DetrendingWarning
from scope_models.pixelmodel._pixels import LARGEST_CORRECTION, OTHER_STAR, at_rows
from scope_models.pixelmodel._smooth import TRANSIT
from scope_models.pixelmodel._source import SHARE_ERROR
from scope_models.pixelmodel._star import MISFIT, SMALL_STEP
from scope_models.regression._solution import Solution

__all__ = ["PLDFit"]

#: Warning: parts from which on a warning is given: outliers, transits outside of the mask or other
#: light, changes of the flux that measured fractions explain; and the noise's variance over
#: FLUX_ERR squared.
_MANY, _FOLLOWING, _NOISY = 0.1, 0.05, 9.0
#: Warning: smaller apertures lose light when the star moves, which the fractions explain.
_WHOLE = 9
#: Warning: nothing of a depth survives or all of it: 0 to 1, with what the light that was taken off
#: may be wrong by.
_SURVIVALS = (-0.05, 1.15)
#: Tolerance: depth of the boxes of ``PLDFit.survival``: so many errors of their mean, within these
#: bounds.
_OBVIOUS, _SHALLOW, _DEEP = 10.0, 1e-3, 0.3
#: Tolerance: largest number of times that a transit is taken out of the pixels.
_REMOVALS = 3
#: Tolerance: largest change of the flux's logarithm by which a transit is taken out at once.
_LARGEST = 0.5
#: Numbers of a fit that go into the metadata of its table.
_NUMBERS = (
    "noise_scale", "jitter", "trend_sigma", "trend_period", "frequencies", "log_likelihood",
    "n_used", "n_outliers", "window", "breaks",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class PLDFit:
    """
    The fit of `PLDCorrector`: hyper-parameters, systematics, errors and diagnostics.

    All variances are of relative flux. Arrays have one element per cadence of the file, NaN where
    a cadence cannot be used.

    Parameters
    ----------
    model : PLDModel
        The model.
    solution : Solution
        Coefficients, covariances, cadences in the fit.
    cadence_mask, transit_mask : ndarray of bool
        Cadences that the fit was allowed to use, and those in transit, ``(n_cadences,)``.
    transit_model : array_like or callable, optional
        The transit model that was fitted jointly.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import PLDCorrector
    >>> observation = simulate(Star(12.0), Detector.k2(), Motion.k2_roll(300), seed=1)
    >>> corrector = PLDCorrector(observation.to_tpf())
    >>> corrected = corrector.correct()
    >>> corrector.result.groups[:2]
    ('order 1', 'order 2')
    """

    model: object
    solution: Solution
    cadence_mask: np.ndarray
    transit_mask: np.ndarray
    transit_model: object = None

    # Hyper-parameters and diagnostics

    @property
    def groups(self):
        """Names of the groups of regressors, as ``"order 1"`` and ``"focus"``."""
        return self.solution.regressors.names

    @property
    def n_columns(self):
        """Number of columns of each group."""
        return tuple(np.bincount(self.solution.regressors.groups).tolist())

    @property
    def prior_variance(self):
        """Prior variance of each group's coefficients."""
        return tuple(self.solution.hyper.variances.tolist())

    @cached_property
    def explained_variance(self):
        """Variance of each group's part of the model; the parts are correlated."""
        return tuple(self.solution.group_variances().tolist())

    @cached_property
    def effective_parameters(self):
        """Number of parameters per group that the data determine."""
        return tuple(self.solution.effective_parameters().tolist())

    @property
    def noise_scale(self):
        """Fitted variance of the white noise over FLUX_ERR squared, that of the sum."""
        return self.solution.hyper.noise_scale

    @property
    def jitter(self):
        """White noise (relative) that adds to FLUX_ERR in quadrature; 0 if there is none."""
        return float(np.sqrt(max(self.noise_scale - 1, 0.0) * np.median(self.solution.variance)))

    @property
    def trend_sigma(self):
        """Standard deviation of the long-term process, NaN with ``trend="quadratic"``."""
        return float(np.sqrt(self.solution.hyper.amplitude or np.nan))

    @property
    def trend_period(self):
        """Undamped period of the long-term process in days, NaN with ``trend="quadratic"``."""
        return self.solution.hyper.period if self.solution.hyper.amplitude else np.nan

    @property
    def frequencies(self):
        """Frequencies of waves in cycles per day; of a rotation many, which make its bands."""
        return self.solution.frequencies

    @property
    def log_likelihood(self):
        """Logarithm of the marginal likelihood of the relative flux' logarithm."""
        return self.solution.log_likelihood

    @property
    def breaks(self):
        """Times (days) at which segments begin."""
        return self.model.breaks

    @property
    def used(self):
        """Cadences in the fit, ``(n_cadences,)``."""
        return self._whole(self.solution.counted)

    @property
    def outliers(self):
        """Cadences that were left out of the fit as outliers, ``(n_cadences,)``.

        Not those of `dips`, which are left out of the fit too, nor short brightenings.
        """
        return self._whole(self._left_out & ~self._in_dips & ~self.solution.short)

    @property
    def dips(self):
        """Cadences that were left out of the fit because the star is fainter, ``(n_cadences,)``.

        Two or more in a row, as in transits and eclipses, each or all together fainter than the
        model by more than the errors of noise and systematics allow.
        """
        return self._whole(self._in_dips)

    @property
    def _left_out(self):
        return self.cadence_mask[self.model.pixels.usable] & ~self.solution.counted

    @cached_property
    def _in_dips(self):
        left_out, sigma = self._left_out, self.model.options.sigma
        faint = left_out & (self.solution.pulls < -sigma)
        labels, _ = ndimage.label(left_out)
        size = np.bincount(labels)
        dips = (size > 1) & (np.bincount(labels, faint) == size)
        dips |= np.bincount(labels, self.solution.short * self.solution.pulls) < 0
        return left_out & dips[labels]

    @property
    def n_used(self):
        """Number of cadences in the fit."""
        return int(self.solution.counted.sum())

    @property
    def n_outliers(self):
        """Number of cadences that were left out as outliers."""
        return int(self.outliers.sum())

    @cached_property
    def window(self):
        """Number of cadences in 6.5 hours, 13 for long cadences."""
        step = np.median(np.diff(self.solution.time))
        return int(np.clip(round(TRANSIT / step), 1, self.n_used // 2))

    @property
    def transit_survival(self):
        """
        Part of a transit's depth that survives if the transit is not masked: `survival`.

        Found when it is first read, by another correction of the pixels.
        """
        return self._survival[0]

    @property
    def transit_survival_err(self):
        """Standard deviation of `transit_survival`, of the corrections and not of the noise."""
        return self._survival[1]

    @cached_property
    def _survival(self):
        return self._survival_of(None, None)

    @property
    def joint(self):
        """Whether a transit model was fitted jointly."""
        return self.transit_model is not None

    @property
    def transit_scale(self):
        """Amplitude of the jointly fitted transit model (1: as given), NaN without one.

        That of `fit_transit`, with the response of the whole chain.
        """
        return self._scale[0]

    @property
    def transit_scale_err(self):
        """Standard deviation of `transit_scale`."""
        return self._scale[1]

    @cached_property
    def _scale(self):
        return self.fit_transit(self.transit_model) if self.joint else (np.nan, np.nan)

    # The images behind the predicted fractions

    def plot_states(self):
        """
        Draw position, width and background of each cadence, and the light that they move.

        Returns
        -------
        dict of str to `~matplotlib.axes.Axes`
            The Axes, see `~scope_models.plotting.detrending.plot_states`.

        Raises
        ------
        ValueError
            If the fractions are measured ones, which have no states.
        """
        from scope_models.plotting.detrending import plot_states  # imports matplotlib

        source, clean = self.model.source, self.model.clean
        if clean is None:
            raise ValueError("the pixel fractions are measured: there are no states to draw")
        states, leaks = clean.leaks()
        images = np.full((len(leaks), *source.pixels.aperture.shape), np.nan)
        images[:, *clean.grid.T[::-1]] = list(leaks.values())
        return plot_states(
            source.pixels.time,
            {name: at_rows(values, source.pixels.usable) for name, values in states.items()},
            dict(zip(leaks, images, strict=True)),
            source.pixels.aperture,
            time_label=f"Time ({source.series.time_format.upper()})",
        )

    # The light curve's parts

    def _whole(self, values):
        """Return values of all cadences from those of usable ones."""
        return at_rows(values, self.model.pixels.usable)

    @cached_property
    def systematics(self):
        """
        Logarithm of the factor by which pointing changes the flux, ``(n_cadences,)``.

        Its median where the factor is over 30 or no number, as in the light curve.
        """
        found = self.solution.systematics
        typical = np.median(found)
        credible = np.abs(found - typical) < np.log(LARGEST_CORRECTION)
        return self._whole(np.where(credible, found, typical))

    @cached_property
    def trend(self):
        """Logarithm of the long-term variability, ``(n_cadences,)``."""
        return self._whole(self.solution.trend)

    @cached_property
    def periodic(self):
        """Logarithm of the variability faster than a day and its overtones, ``(n_cadences,)``."""
        return self._whole(self.solution.periodic)

    def corrected(self, *, restore_trend=True):
        """
        Return the corrected flux and its error.

        Parameters
        ----------
        restore_trend : bool, optional
            Whether the long-term variability stays in the flux.

        Returns
        -------
        flux, flux_err : ndarray
            In e-/s, ``(n_cadences,)``; the error holds the white noise, the uncertainty of the
            model, and what other stars and light outside add: see :doc:`/explanation/pld`.
        """
        solution = self.solution
        removed = solution.systematics + (not restore_trend) * solution.trend
        variance = solution.variance_left(trend=not restore_trend)
        with np.errstate(all="ignore"):  # see `credible_flux`
            flux = self.model.pixels.total[self.model.pixels.usable] / np.exp(removed)
            error = flux * np.sqrt(variance)
            error = np.hypot(error, self.contrast_error * (flux - np.median(flux)))
            error = np.hypot(error, self._image_error * flux)
        return self._whole(flux), self._whole(error)

    @cached_property
    def _image_error(self):
        """Relative error of the flux where the light outside changes."""
        usable = self.model.pixels.usable
        held = self.model.extra.get("aperture", np.zeros((len(usable), 1)))[usable, 0]
        return MISFIT * (held - np.median(held))

    def remarks(self):
        """
        Return sentences about what makes this fit less reliable.

        Returns
        -------
        list of str
            Many outliers, other light in the aperture, fractions that follow the star, noise far
            above FLUX_ERR. Empty if there is nothing.
        """
        found, solution = [], self.solution
        left_out = (self._left_out & ~solution.short).sum()
        if left_out > _MANY * self.cadence_mask.sum():
            found.append(
                f"{left_out} of {len(solution.use)} cadences are left out of the fit as outliers: "
                "the star varies in a way that the model cannot follow, or pixels are damaged"
            )
        other = max(1 - self.crowding, self.contrast_error)
        if self.contamination > OTHER_STAR:
            if self.contrast_error > OTHER_STAR:
                found.append(
                    f"{100 * self.contamination:.0f} % of the light in the aperture was taken off, "
                    "that of other stars: depths and amplitudes are uncertain by "
                    f"{100 * self.contrast_error:.0f} %"
                )
        elif other > _MANY or 1 - self.model.pixels.crowding > OTHER_STAR:
            found.append(
                f"about {100 * other:.0f} % of the light in the aperture is of other stars: depths "
                "and amplitudes are too small by as much"
            )
        if self.may_follow and self.model.pixels.aperture.sum() >= _WHOLE:
            found.append(
                f"measured fractions explain changes of {100 * self._change:.0f} % of the flux: "
                "with other light in the aperture they follow the star, and its variability is "
                'lost; compare `fractions="predicted"`'
            )
        step = np.median(np.diff(solution.time)) / np.median(solution.variance)
        noise = self.noise_scale + solution.hyper.walk * step
        if noise > _NOISY:
            found.append(
                f"the noise has {noise:.0f} times the variance of FLUX_ERR: the star varies from "
                "cadence to cadence, or systematics are left; `regressors` may hold these"
            )
        return found

    @cached_property
    def _change(self):
        low, high = np.quantile(self.solution.systematics[self.solution.counted], norm.cdf([-1, 1]))
        return (high - low) / 2

    @property
    def may_follow(self):
        """Whether measured fractions explain so much that they may be the star's variability."""
        return self.model.clean is None and bool(self._change > _FOLLOWING)

    @property
    def _fractions(self):
        return "measured" if self.model.clean is None else "predicted"

    @property
    def contamination(self):
        """Light of neighbors that was taken off, as a part of all light."""
        pixels = self.model.pixels
        return 1 - pixels.crowding if pixels.neighbors else 0.0

    @property
    def neighbors(self):
        """Flux (e-/s), column and row in the stamp (px) of the neighbors, a table, or None."""
        found = self.model.pixels.neighbors
        return found and found.table

    @property
    def positions(self):
        """Column and row of the target in the stamp, px, ``(n_cadences, 2)``; None if alone."""
        found = self.model.pixels.neighbors
        return found and found.positions

    @cached_property
    def contrast_error(self):
        """Relative uncertainty of depths and amplitudes due to other light in the aperture."""
        clean = self.model.clean
        return max(self.model.source.contrast_error, clean.constant if clean else 0.0)

    @property
    def crowding(self):
        """Target's share of the aperture's light, at most.

        The rest is in pixels in which other stars are brightest, of a star without a peak of its
        own, does not vary as the target does, or is stated by the file's CROWDSAP.
        """
        pixels, source, clean = self.model.pixels, self.model.source, self.model.clean
        shares = [pixels.crowding, 1 - clean.constant if clean else 1.0]
        if pixels.own.all():
            shares.append(1 - source.other_light)
        stated = source.series.header.get("CROWDSAP")
        its_own = pixels.aperture[source.series.aperture].all()  # else it is of another aperture
        if its_own and isinstance(stated, float) and 0 < stated <= 1:
            shares.append(stated)
        return min(shares)

    @one_thread
    def covariance(self, cadences):
        """
        Return the covariance of the corrected relative flux.

        It holds white noise and the uncertainty of systematics and images, which is shared by
        cadences with the star in one place.

        Parameters
        ----------
        cadences : array_like of int or bool
            Which cadences, k of them; all must be usable.

        Returns
        -------
        ndarray
            ``(k, k)``, relative flux squared.
        """
        usable = self.model.pixels.usable
        index = np.arange(len(usable))[np.asarray(cadences)]
        if not usable[index].all():
            raise ValueError("`cadences` must have usable pixels")
        rows = (np.cumsum(usable) - 1)[index]
        by_images = self._image_error[rows]
        covariance = self.solution.systematics_covariance(rows) + np.outer(by_images, by_images)
        np.fill_diagonal(covariance, self.solution.variance_left(trend=False)[rows] + by_images**2)
        return covariance

    # Questions to the data at the fitted hyper-parameters

    def survival(self, transit_model=None, *, depth=None):
        """
        Return the part of a transit's depth that survives the whole correction.

        The transit is put into the star's own light in the pixels, and everything is done again
        with the same aperture and options. Light of other stars in the aperture makes the depth
        smaller, too. A number above 1 is a transit that the correction makes deeper.

        Parameters
        ----------
        transit_model : array_like or callable, optional
            As in `PLDCorrector.correct`. By default up to eight boxes of `window` cadences, at
            places without a period.
        depth : float, optional
            Depth of the boxes, by default 0.001 or ten times the error of their mean flux, if that
            is more. With a transit model, its depth.

        Returns
        -------
        float
            Slope of the corrected flux on the model; NaN if it cannot be found.

        Raises
        ------
        TypeError, ValueError
            If an argument is outside its domain.

        Warns
        -----
        DetrendingWarning
            If the survival is NaN, with the reason; see :doc:`/explanation/pld`.
        """
        return self._survival_of(transit_model, depth)[0]

    @one_thread
    def _survival_of(self, transit_model, depth):
        """Return a survival and its standard deviation."""
        pixels = self.model.pixels
        flux, flux_err = self.corrected()
        with np.errstate(all="ignore"):  # as in `corrected`
            weight = flux_err / flux
        if transit_model is None:
            if 3 * self.window > self.n_used:
                return no_survival(f"{self.n_used} cadences are less than three of the boxes")
            if depth is None:
                noise = np.nanmedian(weight) / np.sqrt(self.window)
                depth = float(np.clip(_OBVIOUS * noise, _SHALLOW, _DEEP))
            column = np.log(box_signal(self.used, self.window, checked_depth(depth)))
        else:
            column = transit_column(transit_model, pixels.time)
            if not column.shape[1]:
                return np.nan, np.nan
            column = column[:, 0]
            if depth is not None:
                if not column.min() < 0:
                    raise ValueError("`transit_model` must dim the star where `depth` is given")
                column = column * np.log1p(-checked_depth(depth)) / column.min()
        try:
            again = self._with_signal(column)
        except ValueError as error:
            return no_survival(f"the correction with transits in the pixels fails: {error}")
        with np.errstate(all="ignore"):
            ratio = again.corrected()[0] / flux
        known = np.isfinite(ratio) & np.isfinite(weight) & (self.cadence_mask | self.transit_mask)
        ratio, weight = ratio[known] / np.median(ratio[known]), weight[known]
        found, error = depth_ratio(np.exp(column[known]) - 1, ratio, weight)
        low, high = _SURVIVALS
        if not low < found < high or not 2 * error < max(found, 1 - found):
            return no_survival(f"{found:.2f} with a standard deviation of {error:.2f}")
        return found, error

    @one_thread
    def _with_signal(self, column):
        """Return the fit of the same pixels with the star's light times ``exp(column)``."""
        model, source = self.model, self.model.source
        pixels = source.dimmed(np.exp(column), model.clean)
        options = replace(model.options, fractions=self._fractions)
        with warnings.catch_warnings(action="ignore", category=DetrendingWarning):
            again = type(model).from_pixels(pixels, options, source.series, source.cadence_mask)
            return again.fit(self.cadence_mask, self.transit_mask, self.transit_model)

    def fit_transit(self, transit_model):
        """
        Measure the depth of a transit with all uncertainties of the correction.

        The amplitude is fitted jointly with systematics and variability, whose hyper-parameters
        stay as they are, to the cadences of the fit and those of ``transit_mask`` that are no
        outliers. Then the transit is taken out of the star's light in the pixels, and everything is
        done again, up to three times: the amplitude is the one that leaves no transit in the fit.
        It is relative to all light in the aperture, less that of neighbors that was taken off.

        Parameters
        ----------
        transit_model : array_like or callable
            As in `PLDCorrector.correct`.

        Returns
        -------
        scale, error : float
            Amplitude in units of the model's, and its standard deviation; NaN and infinity if no
            cadence samples the event.

        Warns
        -----
        DetrendingWarning
            If the transits were neither masked nor fitted jointly.
        """
        column = transit_column(transit_model, self.model.pixels.time)
        usable = self.model.pixels.usable
        if not column[usable].any():
            return np.nan, np.inf
        event = np.abs(column[usable, 0] - np.median(column[usable]))
        free = self.cadence_mask[usable]
        if not self.joint and event[free].sum() > _MANY * event.sum():
            message = (
                "the transits were neither masked nor fitted jointly: part of their depth may be "
                "in the variability or the systematics; `correct` with `transit_mask=` or "
                "`transit_model=` first"
            )
            warnings.warn(message, DetrendingWarning, stacklevel=3)
        first = fitted_depth(self, column)
        if not np.isfinite(first).all():
            return first
        try:
            return self._without_response(column, *first)
        except ValueError:  # with the transit removed, the pixels cannot be corrected
            return first

    def _without_response(self, column, found, error):
        """Return the amplitude whose removal from the pixels leaves no transit, and its error."""
        share = 1 - self.model.source.other_light
        taken, left, response = [0.0], [found], share
        while len(left) <= _REMOVALS and abs(left[-1]) > SMALL_STEP * error:
            step = left[-1] / response
            step = np.clip(step, *(_LARGEST / np.abs(column).max() * np.array([-1, 1])))
            taken.append(taken[-1] + step)
            found, error = fitted_depth(self._with_signal(-taken[-1] * column[:, 0]), column)
            rate = (left[-1] - found) / step
            response = rate if rate > 0 else response
            left.append(found)
        scale = share * (taken[-1] + left[-1] / response)
        error = np.hypot(error * share / response, SHARE_ERROR * (1 - share) * scale)
        return float(scale), float(error)

    @one_thread
    def held_out(self, width=None, cadences=None):
        """
        Predict windows of cadences by a model that has not seen them.

        Coefficients and variability are inferred from all others, the hyper-parameters are not.

        Parameters
        ----------
        width : int, optional
            Cadences in a window, counted among ``cadences``; by default those of 6.5 hours, or
            half of all.
        cadences : array_like of bool, optional
            Cadences in the windows, ``(n_cadences,)``, by default those in the fit. Compare fits
            on the same ones.

        Returns
        -------
        residual : `~numpy.ndarray`
            Mean of measured minus predicted relative flux, per window.
        error : `~numpy.ndarray`
            Its expected standard deviation: noise and model.
        used : `~numpy.ndarray`
            Indices of the cadences, which are the windows one after the other.

        Raises
        ------
        ValueError
            If there are fewer cadences than two windows, or ``cadences`` cannot be used.
        """
        chosen, usable = self.used, self.model.pixels.usable
        if cadences is not None:
            chosen = checked_cadences("cadences", cadences, len(usable), default=True)
            if (chosen & ~usable).any():
                raise ValueError("`cadences` must have usable pixels")
        used = np.flatnonzero(chosen)
        width = min(self.window, len(used) // 2) if width is None else width
        width = checked_integer("width", width, 1)
        if len(used) < 2 * width:
            raise ValueError(f"`width` must be at most {len(used) // 2}, got {width}")
        residual, covariance = self.solution.held_out(width, chosen[usable])
        noise = self.solution.white_variance[chosen[usable]][: residual.size].reshape(-1, width)
        variance = np.maximum(covariance.sum(axis=(1, 2)), noise.sum(axis=1))
        return residual.mean(axis=1), np.sqrt(variance) / width, used

    # How it looks

    def to_table(self):
        """
        Return one row per group of regressors, and the rest as metadata.

        Returns
        -------
        `~astropy.table.QTable`
            Columns ``group``, ``n_columns``, ``prior_variance``, ``explained_variance`` and
            ``effective_parameters``; ``meta`` has the other numbers, ``trend_period`` and
            ``breaks`` in days, and what takes further corrections, `transit_survival` and
            `transit_scale`, once it has been read, else NaN.
        """
        names = ("n_columns", "prior_variance", "explained_variance", "effective_parameters")
        table = QTable({"group": list(self.groups), **{n: list(getattr(self, n)) for n in names}})
        table.meta.update({name: getattr(self, name) for name in _NUMBERS})
        none = (np.nan, np.nan)
        survival, scale = (vars(self).get(name, none) for name in ("_survival", "_scale"))
        table.meta.update(transit_survival=survival[0], transit_survival_err=survival[1])
        table.meta.update(transit_scale=scale[0], transit_scale_err=scale[1])
        return table

    def _rows(self):
        """Return the values of the short table by their labels."""
        rows = {
            "cadences in the fit": f"{self.n_used}",
            "outliers": f"{self.n_outliers}",
            "noise variance / FLUX_ERR^2": f"{self.noise_scale:.3f}",
            "fractions": self._fractions,
        }
        if self.contamination > 0:
            rows["light of neighbors taken off"] = f"{100 * self.contamination:.1f} %"
        if self.crowding < 1:
            rows["of other stars"] = f"{100 * (1 - self.crowding):.1f} %"
        if np.isfinite(self.trend_sigma):
            rows["trend"] = f"{1e6 * self.trend_sigma:.0f} ppm, {self.trend_period:.2f} d"
        if self.frequencies:
            rows["frequencies"] = f"{len(self.frequencies)}"
        for name, digits in (("survival", 3), ("scale", 4)):
            if f"_{name}" in vars(self):  # further corrections are not made to be shown
                both = (f"{value:.{digits}f}" for value in vars(self)[f"_{name}"])
                rows[f"transit {name}"] = " +- ".join(both)
        parts = zip(self.groups, self.n_columns, self.effective_parameters, strict=True)
        used = {name: f"{used:.1f} of {n} parameters" for name, n, used in parts if round(used, 1)}
        return rows | used

    def __repr__(self):
        order = self.model.options.order
        return f"<PLDFit: order {order}, {self.n_used} cadences, {self.n_outliers} outliers>"

    def __str__(self):
        return "\n".join(f"{label:28} {value}" for label, value in self._rows().items())

    def _repr_html_(self):
        return html_table(repr(self), self._rows())
