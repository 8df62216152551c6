"""Correction of a light curve by a model of all pixels: star, neighbors and background."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from astropy.table import QTable
from lightkurve.correctors.corrector import Corrector

from scope_models._checks import checked_cadences, checked_integer, checked_mask, checked_weights
from scope_models._threads import one_thread
from scope_models._values import frozen
from scope_models.correctors._flux_model import fit_flux
from scope_models.correctors._injection import transit_column
from scope_models.correctors._lightkurve import FixedAperture, named_mask
from scope_models.correctors._model import FLUXES
from scope_models.correctors._pixels import NOISIER, WORSE, credible_flux, noise_ratios
from scope_models.correctors._scene_fit import (
    FEWEST_CADENCES,
    WIDER,
    SceneData,
    fit_scene,
    full_columns,
)
from scope_models.correctors._scene_flux import (
    LIMITS,
    clean_background,
    make_columns,
    window_flux,
    window_weights,
)
from scope_models.correctors._scene_start import KnownNeighbors
from scope_models.correctors.pld import PLDCorrector
from scope_models.exceptions import DetrendingWarning
from scope_models.io import read_pixels, read_tpf
from scope_models.photometry import aperture_flux, crowding

__all__ = ["SceneCorrector", "SceneResult"]

#: Windows that are tried: radii in pixels, and weights in proportion to light over variance.
_WINDOWS = {
    "auto": (3.0, 4.0, "optimal"),
    "sum": (3.0, 4.0),
    "weighted": ("optimal",),
}
#: Windows with so much more white noise than the best are not tried.
_NOISIEST = 2.0
#: Factor of the variance of pixels in cadences that are masked.
_NO_WEIGHT = 1e6
_TRANSIT_HOURS = 6.5
#: Warnings: part of the cadences that are outliers, and share of the target in the window.
_MANY, _CROWDED = 0.1, 0.9


@dataclass(frozen=True, eq=False, repr=False)
class SceneResult:
    """
    Numbers of a call of `SceneCorrector.correct`.

    Parameters
    ----------
    window : float or str
        Radius (px) of the window that follows the star, ``"optimal"`` for weights in proportion
        to light over variance, ``"aperture"`` for the user's aperture, ``"PLD"`` if the light
        curve is that of ``SceneCorrector.fallback``.
    neighbors : `~astropy.table.QTable`
        Flux (e-/s), column and row in the stamp (px) of the neighbors, ``flux, x, y``.
    crowding : float
        Share of the target in the starlight of the window.
    chi_squared : float
        Mean square of the pixels' residuals over their variance: 1 for a perfect model.
    model_error : float
        Typical error of the pixels' model relative to the stars' light.
    noise_scale : float
        Variance of the white noise of the flux over what FLUX_ERR predicts.
    trend_sigma, trend_period : tuple of float
        Standard deviations and undamped periods (days) of the variability's two processes.
    periods : tuple of float
        Number of sines and cosines of each period that was found.
    groups : tuple of str
        Groups of systematics.
    explained : tuple of float
        Standard deviation of each group's part of the systematics, relative flux.
    log_evidence : float
        Logarithm of the evidence of the flux' model.
    expected_error : float
        Expected standard deviation of means of 6.5 h: white noise and systematics, relative.
        The window is that of the smallest.
    n_used, n_outliers : int
        Cadences in the fit, and those left out as outliers.
    transit_survival : float
        Part of a transit of 6.5 h that survives the whole chain if it is not masked.
    transit_scale, transit_scale_err : float
        Amplitude of the jointly fitted transit model, NaN without one.
    transit_survival_err : float
        NaN: not computed.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import SceneCorrector
    >>> observation = simulate(
    ...     Star(13, 4, 4), Detector.k2(shape=(9, 9)), Motion.k2_roll(200, seed=1), seed=1
    ... )
    >>> corrector = SceneCorrector(observation.to_tpf())
    >>> lc = corrector.correct()
    >>> len(corrector.result.neighbors)
    0
    """

    window: float | str
    neighbors: QTable
    crowding: float
    chi_squared: float
    model_error: float
    noise_scale: float
    trend_sigma: tuple
    trend_period: tuple
    periods: tuple
    groups: tuple
    explained: tuple
    log_evidence: float
    expected_error: float
    n_used: int
    n_outliers: int
    transit_survival: float
    transit_scale: float
    transit_scale_err: float
    transit_survival_err: float = np.nan

    def __repr__(self):
        return (
            f"<SceneResult: window {self.window}, {len(self.neighbors)} neighbors, "
            f"6.5-h error {1e6 * self.expected_error:.0f} ppm, "
            f"transits keep {self.transit_survival:.3f}>"
        )


@dataclass(frozen=True)
class _Flux:
    """The flux in one window, as summed and without what the scene predicts, and its model."""

    window: object
    total: np.ndarray
    flux: np.ndarray
    variance: np.ndarray
    model: object
    crowding: float

    @property
    def expected_error(self):
        """Standard deviation of means of 13 cadences: white noise and systematics."""
        _, systematic = self.model.systematics()
        white = np.median(self.model.process.noise_scale * self.model.variance)
        return float(np.sqrt(white / 13 + np.mean(systematic)))


class SceneCorrector(FixedAperture, Corrector):
    r"""
    Remove systematics with a model of all pixels.

    The pixels are modeled as

    .. math::

        F_p(t) = b_p \left[a_t\, S(p - x_t; w_t) + \sum_k n_k S(p - x_t - d_k; w_t)\right] + c_t

    with the PRF S, a tensor product of splines, the pixels' gains b, the star's flux a, position x
    and relative PRF width w, the fluxes n and distances d of its neighbors, and the background c.
    Background and neighbors are taken off; the star's flux is summed in a window that follows it.
    The logarithm of this flux, less that of what the model predicts, is a function of position,
    width and slow time with Gaussian priors, plus the star's variability (two Gaussian processes
    and the periods that the evidence supports), plus white noise.

    None of the regressors depends on the star's brightness. So variability and transits are kept,
    also where a neighbor or background lies in the aperture; see the page on correctors.

    Parameters
    ----------
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`, str or path-like
        Kepler, K2, TESS or synthetic target pixel file, or the path of one.
    aperture_mask : array_like of bool or float, or str, optional
        Pixels ``(ny, nx)`` that are summed, boolean or a name of `PLDCorrector`'s, or weights
        ``(n_cadences, ny, nx)`` of a moving aperture. By default a window that follows the star,
        the one of the smallest expected error.
    neighbors : array_like, `~astropy.table.Table` or `~astropy.coordinates.SkyCoord`, optional
        Other stars: columns and rows in the stamp ``(m, 2)`` in pixels, a table with columns ``x``
        and ``y`` or ``ra`` and ``dec``, or places on the sky, which are taken relative to the
        target's coordinates in the file. By default they are found in the images; ``[]``: none.

    Attributes
    ----------
    original_lc, corrected_lc : `~lightkurve.LightCurve`
        Sum over the aperture (the file's by default), and the star's corrected flux.
    cadence_mask, outlier_mask : `~numpy.ndarray`
        Cadences that the last call of `correct` was allowed to fit, and those of them that it left
        out as outliers.
    result : `SceneResult`
        Numbers of the last call.
    fallback : `PLDCorrector` or None
        The corrector that the light curve is taken from where pixels saturate, and where the model
        of the scene adds noise and `PLDCorrector` adds less.

    Raises
    ------
    TypeError, ValueError
        If `aperture_mask` or `neighbors` do not fit the file, or it has fewer than 30 cadences.

    See Also
    --------
    PLDCorrector

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import SceneCorrector
    >>> observation = simulate(
    ...     Star(12, 4, 4), Detector.k2(shape=(9, 9)), Motion.k2_roll(300, seed=1), seed=1
    ... )
    >>> corrector = SceneCorrector(observation.to_tpf())
    >>> lc = corrector.correct()
    >>> bool(lc.estimate_cdpp() < corrector.original_lc.estimate_cdpp())
    True
    """

    def __init__(self, tpf, aperture_mask=None, neighbors=None):
        self.tpf = read_tpf(tpf)
        series = read_pixels(self.tpf)
        aperture_mask = named_mask(self.tpf, aperture_mask, "aperture_mask")
        if np.ndim(aperture_mask) == 3:
            aperture_mask = checked_weights("aperture_mask", aperture_mask, series.flux.shape)
        elif aperture_mask is not None:
            aperture_mask = checked_mask("aperture_mask", aperture_mask, series.flux.shape[1:])
        self._data = SceneData.from_series(series, aperture_mask)
        self._known = None
        if neighbors is not None:
            origin, peak = self._data.origin, self._data.place
            self._known = KnownNeighbors.read(neighbors, series, origin, peak)
        shown = series.aperture if aperture_mask is None else aperture_mask
        shown = shown if np.any(shown) else np.ones(series.flux.shape[1:], dtype=bool)
        moving = shown.ndim == 3
        self._aperture_mask = frozen(np.nanmax(shown, axis=0) > 0 if moving else shown)
        self.original_lc = self.tpf.to_lightcurve(aperture_mask=self.aperture_mask)
        if moving:
            lc = self.original_lc
            total, error = aperture_flux(series.flux, shown, series.flux_err)
            lc.flux, lc.flux_err = total * lc.flux.unit, error * lc.flux.unit
        self.cadence_mask = np.ones(len(series), dtype=bool)
        self.outlier_mask, self.transit_mask = np.zeros((2, len(series)), dtype=bool)
        self.scene = self.result = self._chosen = self.fallback = self._bad = None
        self._given = aperture_mask

    def __repr__(self):
        return f"SceneCorrector (ID: {self.original_lc.meta.get('LABEL', 'unknown')})"

    def correct(
        self,
        cadence_mask=None,
        *,
        transit_mask=None,
        transit_model=None,
        restore_trend=True,
        flux="auto",
    ):
        """
        Correct the light curve.

        Parameters
        ----------
        cadence_mask : array_like of bool, optional
            True where a cadence may be used to fit the systematics, ``(n_cadences,)``. The others
            are corrected too.
        transit_mask : array_like of bool, optional
            True during transits: these cadences are not used in that fit.
        transit_model : array_like or callable, optional
            Relative flux ``(n_cadences,)``, 1 outside of transits, or a callable that returns it
            for times in days. Its amplitude is fitted jointly.
        restore_trend : bool, optional
            Whether the star's slow variability stays in the light curve.
        flux : {"auto", "sum", "weighted"}, optional
            Sum of the pixels in a window that follows the star, or of pixels weighted in
            proportion to the star's light over their variance, as `PLDCorrector.correct`. By
            default the one of the smallest expected error. A given aperture is summed.

        Returns
        -------
        `~lightkurve.LightCurve`
            `corrected_lc`: flux of the target alone, e-/s; NaN in cadences without data. The
            errors hold the white noise and the uncertainty of the systematics.

        Raises
        ------
        TypeError, ValueError
            If an argument is outside its domain, or fewer than 30 cadences are left to fit.

        Warns
        -----
        DetrendingWarning
            If pixels saturate, the noise of 6.5 h grows or no light is above it, many cadences
            are outliers, the window holds much light of other stars, or corrections are over a
            factor of 30: such cadences get the typical one, and errors as large as their flux.
        """
        data = self._data
        if flux not in FLUXES:
            raise ValueError(f"`flux` must be one of {FLUXES}, got {flux!r}")
        if flux == "weighted" and data.aperture is not None:
            raise ValueError('`flux="weighted"` has its own weights: leave out `aperture_mask`')
        n = len(data.usable)
        mask = checked_cadences("cadence_mask", cadence_mask, n, default=True)
        in_transit = checked_cadences("transit_mask", transit_mask, n, default=False)
        allowed = (mask & ~in_transit)[data.usable]
        if allowed.sum() < FEWEST_CADENCES:
            raise ValueError(
                f"at least {FEWEST_CADENCES} usable cadences are needed, got {allowed.sum()}"
            )
        flat = None
        if transit_model is not None:
            flat = transit_column(transit_model, data.all_times)[data.usable]
            flat = flat if flat.any() else None
        with one_thread:
            bad = ~mask[data.usable]
            if self.scene is None or (bad != self._bad).any():
                variance = np.where(bad[:, None, None], _NO_WEIGHT, 1.0) * data.variance
                self.scene = fit_scene(
                    data.time, data.flux, variance, data.pos_corr, data.peak,
                    known=self._known, well=data.well,
                )  # fmt: skip
                self._bad = bad
            self._chosen = self._best(allowed, flat, flux)
            self.cadence_mask, self.transit_mask = mask & ~in_transit, in_transit
            self._finish(allowed, has_transit=flat is not None, restore_trend=restore_trend)
            self.fallback = None
            if self.saturated or self._is_worse():
                masks = {"cadence_mask": mask, "transit_mask": in_transit}
                trend = {"transit_model": transit_model, "restore_trend": restore_trend}
                self._fall_back(masks | trend)
            if self.fallback is None:
                self._warn_of_noise()
        return self.corrected_lc

    def _best(self, allowed, flat, kind):
        """Return the flux in the window of the smallest expected error."""
        data, scene = self._data, self.scene
        background, background_variance = clean_background(scene.track.background, scene.background)
        noise = data.noise
        windows = _WINDOWS[kind] if data.aperture is None else (data.aperture,)
        found = []
        for window in windows:
            if isinstance(window, str) and scene.full.any():  # weights by light need all pixels
                continue
            weights = window_weights(scene, noise, window)
            one = window_flux(
                data.flux, data.variance, scene, weights, background, background_variance
            )
            level = np.median(one.flux)
            if not level > 0:
                continue
            other = np.median(np.sum(weights * scene.others, axis=(1, 2)))
            by_width = np.log(np.sum(weights * scene.wider, axis=(1, 2)) / one.model) / WIDER
            share = float(level / (level + other))
            found.append((np.median(one.variance) / level**2, window, one, share, by_width))
        if not found and kind == "weighted" and scene.full.any():
            raise ValueError('`flux="weighted"` needs pixels that are not full')
        if not found:
            raise ValueError("the target's flux must be positive in most cadences")
        limit = _NOISIEST**2 * min(variance for variance, *_ in found)
        time = data.time - data.time[0]
        best = None
        for variance, window, one, share, by_width in sorted(found, key=lambda f: f[0]):
            if variance > limit:
                break
            level = np.median(one.flux)
            positive = one.flux > 0.01 * level
            change = by_width * (scene.track.width - np.median(scene.track.width))
            y = np.log(np.where(positive, one.flux, level) / one.model) - change
            columns = make_columns(data.time, scene.track, one, by_width)
            relative = one.variance / np.where(positive, one.flux, level) ** 2
            model = fit_flux(
                time, y, relative, columns, allowed & positive, limits=LIMITS, flat=flat,
                start=best and best.model,
            )  # fmt: skip
            total = np.where(positive, one.flux, np.nan)
            star = total / one.model / np.exp(change)
            trial = _Flux(window, total, star, relative, model, share)
            if best is None or trial.expected_error < best.expected_error:
                best = trial
        return best

    def _finish(self, allowed, *, has_transit, restore_trend):
        """Make the corrected light curve, the mask of outliers and the result."""
        data, chosen, scene = self._data, self._chosen, self.scene
        model = chosen.model
        removed, variance = model.systematics()
        removed = removed - np.median(removed)
        if not restore_trend:
            trend = model.variability(flat=has_transit)
            removed = removed + trend - np.median(trend)
        flux = chosen.flux / np.exp(removed)
        error = flux * np.sqrt(model.process.noise_scale * model.variance + variance)
        outliers = allowed & ~model.use
        flux, error = credible_flux(flux, error, chosen.total, outliers)
        lc = self.original_lc.copy()
        for name, values in (("flux", flux), ("flux_err", error)):
            whole = np.full(len(data.usable), np.nan)
            whole[data.usable] = values
            setattr(lc, name, whole * getattr(lc, name).unit)
        self.corrected_lc = lc
        self.outlier_mask = np.zeros(len(data.usable), dtype=bool)
        self.outlier_mask[data.usable] = outliers
        scale, scale_err = model.flat_coefficient() if has_transit else (np.nan, np.nan)
        step = np.median(np.diff(data.time))
        window = int(np.clip(round(_TRANSIT_HOURS / 24 / step), 1, model.use.sum() // 2))
        named = chosen.window
        self.result = SceneResult(
            window="aperture" if isinstance(named, np.ndarray) else named,
            neighbors=data.table(scene),
            crowding=chosen.crowding,
            chi_squared=scene.chi_squared,
            model_error=scene.floor,
            noise_scale=float(model.process.noise_scale),
            trend_sigma=tuple(float(np.sqrt(a)) for a in model.process.amplitudes),
            trend_period=tuple(float(p) for p in model.process.periods),
            periods=tuple(
                int(np.sum(model.groups == k))
                for k in range(len(model.systematic), len(model.names))
            ),
            groups=model.systematic,
            explained=tuple(float(np.std(model.part([g])[0])) for g in model.systematic),
            log_evidence=model.log_evidence,
            expected_error=chosen.expected_error,
            n_used=int(model.use.sum()),
            n_outliers=int(self.outlier_mask.sum()),
            transit_survival=model.survival(window),
            transit_scale=scale,
            transit_scale_err=scale_err,
        )
        self._warn()

    def _warn(self):
        result = self.result
        if self.saturated:
            message = (
                "pixels saturate: the model of the pixels holds for the others only, and "
                "PLDCorrector corrects such stars better"
            )
            warnings.warn(message, DetrendingWarning, stacklevel=4)
        shape = self.tpf.flux.shape[1:]
        if min(shape) == 1:
            message = (
                f"pixels of shape {shape} show no motion across the strip: light that it moves off "
                "them stays in the flux; compare PLDCorrector"
            )
            warnings.warn(message, DetrendingWarning, stacklevel=4)
        if result.n_outliers > _MANY * (result.n_outliers + result.n_used):
            message = f"{result.n_outliers} cadences are left out of the fit as outliers"
            warnings.warn(message, DetrendingWarning, stacklevel=4)
        if result.crowding < _CROWDED:
            message = (
                f"other stars give {100 * (1 - result.crowding):.0f} % of the window's starlight: "
                "their light is taken off as constant, their variability is not"
            )
            warnings.warn(message, DetrendingWarning, stacklevel=4)

    def _warn_of_noise(self):
        if self._is_worse():
            message = f"{NOISIER}, and compare PLDCorrector"
            warnings.warn(message, DetrendingWarning, stacklevel=3)
        elif self._noise_ratio > WORSE:
            message = (
                f"the corrected light curve has {self._noise_ratio:.3g} times the relative noise "
                "of the sum over the aperture, of which the target is a part only"
            )
            warnings.warn(message, DetrendingWarning, stacklevel=3)

    def held_out(self, width=13, cadences=None):
        """
        Predict windows of cadences by a model that has not seen them.

        The scene and the hyper-parameters stay as they are; the coefficients and the star's
        variability are inferred again for each window from all others, in closed form.

        Parameters
        ----------
        width : int, optional
            Cadences in a window, counted among ``cadences``; 13 long cadences are 6.4 hours.
        cadences : array_like of bool, optional
            Cadences in the windows, ``(n_cadences,)``, by default those in the fit. Fits are
            compared on the same ones, with what each of them left out as an outlier.

        Returns
        -------
        residual : `~numpy.ndarray`
            Mean of measured minus predicted relative flux, per window; at most 120 windows.
        error : `~numpy.ndarray`
            Its expected standard deviation: noise and model.
        used : `~numpy.ndarray`
            Indices of the cadences in the windows, one window after the other.

        Raises
        ------
        ValueError
            If `correct` has not been called, there are fewer cadences than two windows, or
            ``cadences`` cannot be used.
        """
        if self._chosen is None:
            raise ValueError("call `correct` first")
        if self.fallback is not None:
            return self.fallback.held_out(width, cadences)
        usable, chosen = self._data.usable, self._chosen.model.use
        if cadences is not None:
            chosen = checked_cadences("cadences", cadences, len(usable), default=True)
            if not np.isfinite(self.corrected_lc.flux.value[chosen]).all():
                raise ValueError("`cadences` must have usable pixels")
            chosen = chosen[usable]
        width, most = checked_integer("width", width, 1), chosen.sum() // 2
        if width > most:
            raise ValueError(f"`width` must be at most {most}, got {width}")
        with one_thread:
            residual, error, used = self._chosen.model.held_out(width, chosen)
        return residual, error, np.flatnonzero(usable)[used]

    def crowding(self, aperture_mask):
        """
        Return the target's share in the starlight of an aperture.

        Parameters
        ----------
        aperture_mask : array_like of bool
            Pixels, ``(ny, nx)``.

        Returns
        -------
        float
            Light of the target over that of all stars of the fitted scene.

        Raises
        ------
        ValueError
            If `correct` has not been called, or the aperture has no light of the target.
        """
        if self.scene is None:
            raise ValueError("call `correct` first")
        mask = checked_mask("aperture_mask", aperture_mask, self.aperture_mask.shape)
        star = self.scene.track.flux[:, None, None] * self.scene.star
        return crowding(star, self.scene.others, mask[self._data.box])

    @property
    def positions(self):
        """Column and row of the target in the stamp, pixels, ``(n_cadences, 2)``, as fitted."""
        if self.scene is None:
            raise ValueError("call `correct` first")
        places = np.full((len(self._data.usable), 2), np.nan)
        track = self.scene.track
        places[self._data.usable] = self._data.origin + np.stack([track.x, track.y], axis=1)
        return places

    @property
    def saturated(self):
        """Whether pixels saturate: their columns are no part of the model."""
        data = self._data
        return bool(full_columns(data.flux, data.variance, data.well).any())

    def _is_worse(self):
        """Whether the correction adds noise, beyond the light of others that it takes off."""
        inside = self.aperture_mask[self._data.box]
        light = np.median(self.scene.track.flux * self.scene.star[:, inside].sum(axis=1))
        share = light / np.nanmedian(self.original_lc.flux.value)
        return not 0 < min(share, 1.0) * self._noise_ratio < WORSE

    @property
    def _noise_ratio(self):
        return max(noise_ratios(self.original_lc, self.corrected_lc))

    def _fall_back(self, options):
        """Take the light curve of PLDCorrector if it has less noise, or where pixels saturate."""
        try:
            pld = PLDCorrector(self.tpf, self._given)
            lc = pld.correct(**options)
        except ValueError:
            return
        found = pld.result
        if found is None:
            return
        if not (self.saturated or max(noise_ratios(pld.original_lc, lc)) < self._noise_ratio):
            return
        message = "the corrected light curve is that of PLDCorrector: see `fallback`"
        warnings.warn(message, DetrendingWarning, stacklevel=3)
        self.fallback, self.corrected_lc, self.outlier_mask = pld, lc, pld.outlier_mask
        self.result = replace(
            self.result,
            window="PLD",
            noise_scale=found.noise_scale,
            n_used=found.n_used,
            n_outliers=found.n_outliers,
            transit_survival=found.transit_survival,
            transit_scale=found.transit_scale,
            transit_scale_err=found.transit_scale_err,
        )

    def fit_transit(self, transit_model):
        """
        Measure the depth of a transit, with all uncertainties of the last correction.

        Parameters
        ----------
        transit_model : array_like or callable
            As in `correct`. Its amplitude is fitted jointly with systematics and variability,
            whose hyper-parameters stay as `correct` has found them; used are the cadences of the
            fit and those of ``transit_mask``.

        Returns
        -------
        scale, error : float
            Amplitude in units of the model's, and its standard deviation.

        Raises
        ------
        ValueError
            If `correct` has not been called, or the model does not vary.
        """
        if self._chosen is None:
            raise ValueError("call `correct` first")
        if self.fallback is not None:
            return self.fallback.fit_transit(transit_model)
        data, model = self._data, self._chosen.model
        column = transit_column(transit_model, data.all_times)[data.usable]
        if not column.any():
            return np.nan, np.inf
        use = model.use | self.transit_mask[data.usable]
        with one_thread:
            return model.with_flat(column, use).flat_coefficient()

    def diagnose(self):
        """
        Draw the light curve before and after the last correction, and the model.

        Returns
        -------
        `~numpy.ndarray` of `~matplotlib.axes.Axes`
            The three panels.

        Raises
        ------
        ValueError
            If `correct` has not been called.
        """
        from scope_models.plotting.detrending import plot_detrending  # imports matplotlib

        if self._chosen is None:
            raise ValueError("call `correct` first")
        if self.fallback is not None:
            return self.fallback.diagnose()
        usable, corrected = self._data.usable, self.corrected_lc.flux.value
        systematics, trend = np.full((2, len(usable)), np.nan)
        level = np.nanmedian(corrected)
        model = self._chosen.model
        removed, _ = model.systematics()
        systematics[usable] = level * np.exp(removed - np.median(removed))
        variability = model.variability(flat=False)
        trend[usable] = level * np.exp(variability - np.median(variability))
        return plot_detrending(
            self.original_lc.time.value,
            self.original_lc.flux.value,
            corrected,
            systematics=systematics,
            trend=trend,
            outliers=self.outlier_mask,
            masked=~self.cadence_mask,
            time_label=f"Time ({self.original_lc.time.format.upper()})",
        )

    def diagnose_masks(self):
        """
        Draw the aperture and the neighbors' part of the light.

        Returns
        -------
        `~numpy.ndarray` of `~matplotlib.axes.Axes`
            Mean image with the aperture, and scatter of the pixels' shares.

        Raises
        ------
        ValueError
            If `correct` has not been called.
        """
        from scope_models.plotting.detrending import plot_detrending_masks  # imports matplotlib

        if self._chosen is None:
            raise ValueError("call `correct` first")
        data = self._data
        image = np.median(data.flux, axis=0)
        scatter = np.std(self.scene.star, axis=0)
        return plot_detrending_masks(image, self.aperture_mask[data.box], scatter)
