"""Pixel level decorrelation of target pixel files."""

import warnings

import numpy as np
from lightkurve.correctors.corrector import Corrector

from scope_models._checks import checked_cadences, checked_mask, solvable
from scope_models._docstrings import documented
from scope_models._threads import one_thread
from scope_models._values import frozen
from scope_models.correctors._model import PLDModel, PLDOptions, Settings
from scope_models.correctors._neighbors import (
    given_neighbors,
    light_of_neighbors,
    without_neighbors,
)
from scope_models.correctors._result import PLDFit
from scope_models.exceptions import DetrendingWarning
from scope_models.io import read_pixels, read_tpf
from scope_models.pixelmodel._pixels import (
    NOISIER,
    WORSE,
    aperture_pixels,
    credible_flux,
    noise_ratios,
    warn_of_pipeline,
)
from scope_models.pixelmodel._source import can_predict
from scope_models.regression._solution import NothingToCorrectError
from scope_models.scene.motion import Motion

__all__ = ["PLDCorrector"]


# Arguments of lightkurve's corrector: other names, the same ones, and what replaces the others.
_RENAMED = {"pld_order": "order", "n_pca_terms": "pca_components", "niters": "max_clips"}
_SAME = ("pca_components", "pld_aperture_mask", "background_aperture_mask", "sigma")
_SUCCESSORS = {
    "spline_n_knots": 'the trend has no knots: `trend="gp"` fits its time scale to the data, '
    '`trend="quadratic"` is a polynomial',
    "spline_degree": 'the trend is no spline: choose `trend="gp"` or `trend="quadratic"`',
    "sparse": "matrices are small: leave it out",
    "normalize_background_pixels": "the columns of `background` are divided by the star's flux: "
    "leave it out, or pass columns of your own as `regressors`",
    "n_samples": "errors are computed in closed form, without samples: leave it out",
    "use_gp": 'choose `trend="gp"` or `trend="quadratic"`',
    "gp_timescale": 'the time scale of `trend="gp"` is fitted to the data: leave it out',
}
_FOUND = "`print(corrector.result)` and `corrector.result.to_table()` have what the fit found"
_ATTRIBUTES = {
    "dmc": "call `create_design_matrix()`",
    "design_matrix_collection": "call `create_design_matrix()`",
    "X": "call `create_design_matrix()`",
    "coefficients": _FOUND,
    "coefficients_err": _FOUND,
    "diagnose_priors": f"prior widths follow from the data; {_FOUND}",
    "diagnostic_lightcurves": "`diagnose()` draws the systematics and the trend",
    "model_lc": "divide `original_lc` by `corrected_lc`",
    "lc": "it is `original_lc`",
}


class PLDCorrector(Corrector):
    r"""
    Remove pointing systematics with the help of the target's own pixels.

    The logarithm of the flux summed over the aperture is modeled as

    .. math::

        \log F = \sum_l a_l p_l + \sum_{lm} b_{lm} p_l p_m + \dots + g(t)
                 + \mathrm{const} + \mathrm{noise}, \qquad p_l = f_l / \sum_k f_k,

    with all products of the pixel fractions up to order n. The coefficients have Gaussian priors,
    one variance per order; those of products of two have a part that depends on their offset alone,
    for the responses within pixels have much in common. The long-term variability g is a Gaussian
    process or a quadratic polynomial. Variances and time scales maximize the marginal likelihood.

    A dimming of the star changes all pixels alike and leaves the fractions as they are: the model
    can take a transit for systematics only by chance, and `PLDFit.transit_survival` estimates how
    much.

    Parameters
    ----------
    tpf : `~lightkurve.targetpixelfile.TargetPixelFile`, str or path-like
        Target pixel file, or the path of one. Cadences without a finite time or with pixels that
        are NaN are left out and stay NaN.
    aperture_mask : array_like, optional
        Pixels ``(ny, nx)`` that are summed, boolean, or weights ``(n_cadences, ny, nx)`` of a
        moving aperture. By default those whose sum is expected to be most precise, of the pixels
        that the star at the file's coordinates lights up at some time.
    neighbors : array_like, Table, `~astropy.coordinates.SkyCoord`, path-like or "find", optional
        Other stars, whose light is fitted together with the target's and taken off: columns and
        rows in the stamp ``(m, 2)`` in pixels, a table, also of pandas, with columns ``x`` and
        ``y`` or ``ra`` and ``dec``, the file of one, of which stars in the pixels are taken without
        the target, or places on the sky, relative to the target's coordinates in the file. By
        default those are found that have a peak of their own in the images (beside full pixels
        these must be given), or stay constant while the target varies; "find" takes all in the
        target's wings, too, which may be bumps of the PRF; ``[]``: none.

    Attributes
    ----------
    aperture_mask : `~numpy.ndarray`
        The pixels that are summed.
    original_lc, corrected_lc : `~lightkurve.LightCurve`
        Sum over the aperture before and after the correction.
    cadence_mask, transit_mask, outlier_mask : `~numpy.ndarray`
        Cadences that the last call of `correct` was allowed to fit, those in transit, and those
        that it left out as outliers.
    result : `PLDFit`
        Hyper-parameters and diagnostics of the last call.

    Raises
    ------
    TypeError, ValueError
        If `aperture_mask` is not a mask of pixels with data, the flux in it
        is not positive, or `neighbors` do not fit the file.

    See Also
    --------
    lightkurve.correctors.PLDCorrector

    Notes
    -----
    Luger et al. 2016, AJ 152, 100, and 2018, AJ 156, 99, describe pixel level
    decorrelation; Deming et al. 2015, ApJ 805, 132, introduced it.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, simulate
    >>> from scope_models.correctors import PLDCorrector
    >>> observation = simulate(
    ...     Star(12, 4, 4), Detector.k2(shape=(9, 9)), Motion.k2_roll(400, seed=1), seed=1
    ... )
    >>> corrector = PLDCorrector(observation.to_tpf())
    >>> lc = corrector.correct(order=2)
    >>> bool(lc.estimate_cdpp() < corrector.original_lc.estimate_cdpp())
    True
    """

    def __init__(self, tpf, aperture_mask=None, neighbors=None):
        self.tpf = read_tpf(tpf)
        self._series = read_pixels(self.tpf)
        mask = _named_mask(self.tpf, aperture_mask, "aperture_mask")
        with one_thread:
            self._pixels = pixels = aperture_pixels(self._series, mask)
        self._chosen = mask is None
        self._neighbors = None
        if neighbors is not None:
            self._neighbors = given_neighbors(neighbors, self._series, pixels)
        self.original_lc = lc = self.tpf.to_lightcurve(aperture_mask=pixels.aperture.copy())
        unit = lc.flux.unit
        lc.flux = np.where(pixels.usable, pixels.total, np.nan) * unit
        lc.flux_err = np.where(pixels.usable, pixels.total_err, np.nan) * unit
        self.outlier_mask, self.transit_mask = np.zeros((2, len(pixels.time)), dtype=bool)
        self.model = self.result = None

    @property
    def aperture_mask(self):
        """Pixels that are summed, a read-only mask of shape ``(ny, nx)``."""
        return frozen(self._pixels.aperture)

    def __repr__(self):
        return f"PLDCorrector (ID: {self.original_lc.meta.get('LABEL', 'unknown')})"

    def __getattr__(self, name):
        if name in _ATTRIBUTES:
            raise AttributeError(f"`{name}` is not an attribute here: {_ATTRIBUTES[name]}")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def correct(
        self,
        order=2,
        cadence_mask=None,
        *,
        transit_mask=None,
        transit_model=None,
        fractions="predicted",
        regressors=(),
        positions=None,
        restore_trend=True,
        options=None,
        **lightkurve_options,
    ):
        """
        Correct the light curve.

        Parameters
        ----------
        order : int, optional
            Highest number of pixel fractions that are multiplied.
        cadence_mask : array_like of bool, optional
            True where a cadence may be used in the fit, ``(n_cadences,)``; all are corrected.
        transit_mask : array_like of bool, optional
            True during transits: these cadences are not used in the fit.
        transit_model : array_like or callable, optional
            Relative flux ``(n_cadences,)``, 1 outside of transits, or what returns it for times in
            days, as an astropy model does. Its amplitude is fitted jointly, so that the correction
            leaves unmasked transits alone; see `PLDFit.transit_scale`.
        fractions : {"predicted", "measured"}, optional
            Pixel fractions as a model of the star, its motion, focus and background predicts them,
            with what pixels show beyond it as further regressors, or as they are measured, which
            follow the star where other light is in the aperture.
            ``pld_aperture_mask``, background as a regressor, a stamp of five pixels or fewer, a
            star that is at too many places for its cadences, and a moving aperture over full pixels
            allow measured ones only.
        regressors : object or list, optional
            Further columns: arrays ``(n_cadences,)`` or ``(n_cadences, n)``, lightkurve's design
            matrices, its cotrending basis vectors and target pixel files of other stars (or their
            paths), of which the pixel fractions are taken, both matched by their cadence numbers,
            and "background", principal components of the pixels outside of the aperture.
        positions : Motion, optional
            The star's motion in place of POS_CORR, as other stars of the CCD give it.
        restore_trend : bool, optional
            Whether the long-term variability stays in the light curve; periodic variability with
            parts faster than a day always does.
        options : PLDOptions, optional
            Long-term variability, segments, saturation and clipping.
        **lightkurve_options
            Options of lightkurve's corrector: ``pca_components``, ``pld_aperture_mask``,
            ``background_aperture_mask`` and ``sigma`` are fields of `PLDOptions`; ``pld_order`` is
            ``order``, ``niters`` its ``max_clips``. Others raise an error that names what replaces
            them.

        Returns
        -------
        `~lightkurve.LightCurve`
            `corrected_lc`: `original_lc` divided by the systematics. The errors hold the white
            noise and the uncertainty of the model.

        Raises
        ------
        TypeError, ValueError
            If an argument is outside its domain, or fewer than 30 cadences are left to fit.

        Warns
        -----
        DetrendingWarning
            If there is nothing to correct, data had to be replaced, the correction adds noise,
            or the fit is less reliable; see `PLDFit.remarks`.
        """
        if not isinstance(options, PLDOptions | None):
            raise TypeError(f"`options` must be PLDOptions or None, got {options!r}")
        settings = (
            vars(options or PLDOptions()) | {"order": order} | _translated(lightkurve_options)
        )
        for name in ("pld_aperture_mask", "background_aperture_mask"):
            if (mask := _named_mask(self.tpf, settings[name], name)) is not None:
                settings[name] = checked_mask(name, mask, self._series.flux.shape[1:])
        settings = Settings(**settings, fractions=fractions, regressors=regressors)
        series = self._series
        if positions is not None:
            if not isinstance(positions, Motion):
                raise TypeError(f"`positions` must be a Motion or None, got {positions!r}")
            offsets = np.float32(positions.offsets(series)[0])  # as files hold them
            series = series.replace(pos_corr=offsets.astype(float))
        n = len(self._pixels.time)
        mask = checked_cadences("cadence_mask", cadence_mask, n, default=True)
        in_transit = checked_cadences("transit_mask", transit_mask, n, default=False)
        original = self.original_lc
        with one_thread, solvable():
            try:
                pixels, series = self._alone(series, settings, mask)
                model = PLDModel.from_pixels(pixels, settings, series, mask)
                result = model.fit(mask, in_transit, transit_model)
            except NothingToCorrectError:
                message = "the pixel fractions do not vary: the light curve is left as it is"
                warnings.warn(message, DetrendingWarning, stacklevel=2)
                result = None
            lc, outliers = original.copy(), np.zeros(n, dtype=bool)
            if result is not None:
                outliers = result.outliers
                flux, flux_err = result.corrected(restore_trend=restore_trend)
                for remark in result.remarks():
                    warnings.warn(remark, DetrendingWarning, stacklevel=2)
                flux, flux_err = credible_flux(flux, flux_err, original.flux.value, outliers)
                lc.flux, lc.flux_err = flux * lc.flux.unit, flux_err * lc.flux_err.unit
                # transits that a correction uncovers are noise to one of the conventions
                share = 1 - result.contamination
                if share * min(noise_ratios(original, lc)) > WORSE:
                    warnings.warn(NOISIER, DetrendingWarning, stacklevel=2)
                elif self._chosen:
                    warn_of_pipeline(self._series, self._pixels, lc.flux.value, share)
        # nothing has failed: only now the corrector changes
        self.corrected_lc = lc
        self.result, self.model = result, result and result.model
        self.cadence_mask, self.transit_mask = mask & ~in_transit, in_transit
        self.outlier_mask, self._restore_trend = outliers, restore_trend
        return lc

    def _alone(self, series, settings, mask):
        """Return the pixels and their file without the light of neighbors, if there are any."""
        pixels, given = self._pixels, self._neighbors
        if settings.fractions == "measured" if given is None else not len(given):
            return pixels, series
        saturation, use = settings.full_flux(series), pixels.usable & pixels.lit & mask
        full = pixels.full_columns(use, saturation).any()
        beside = full and given is None and not pixels.own.all()
        if beside or not can_predict(pixels, saturation, use):
            if given is not None or beside:
                message = "pixels are full, or too few: the light of other stars stays in the flux"
                message += ", unless they are given as `neighbors`" if beside else ""
                warnings.warn(message, DetrendingWarning, stacklevel=3)
            return pixels, series
        found = light_of_neighbors(pixels, series, mask, given, saturation)
        if found is None:
            return pixels, series
        alone = without_neighbors(pixels, series, found)
        if alone[0].lit.sum() > (pixels.usable & pixels.lit).sum() / 2:
            return alone
        message = (
            "the aperture holds hardly any light of the star at the file's coordinates: give "
            "`aperture_mask`; the light of other stars stays in the flux"
        )
        warnings.warn(message, DetrendingWarning, stacklevel=3)
        return pixels, series

    def _check_corrected(self):
        if not hasattr(self, "_corrected_lc"):
            raise ValueError("call `correct` first")

    def _fitted(self):
        """Return the last fit, or raise an error."""
        self._check_corrected()
        if self.result is None:
            raise ValueError("the last correction found nothing to correct")
        return self.result

    def create_design_matrix(self, **options):
        """
        Return the regressors as lightkurve's design matrices.

        Parameters
        ----------
        **options
            Arguments of `correct`; by default those of its last call.

        Returns
        -------
        `~lightkurve.correctors.DesignMatrixCollection`
            One matrix per group, with a row per cadence of the file, NaN where it cannot be used;
            its ``prior_sigma`` are those of the fit, of the logarithm of relative flux: for
            lightkurve's corrector, the light curve is normalized. There is no constant column.

        Raises
        ------
        TypeError, ValueError
            As `correct` does.

        Examples
        --------
        >>> from scope_models import Detector, Motion, Star, simulate
        >>> from scope_models.correctors import PLDCorrector
        >>> tpf = simulate(Star(12), Detector.k2(), Motion.k2_roll(300), seed=1).to_tpf()
        >>> PLDCorrector(tpf).create_design_matrix(order=1).matrices[0].name
        'order 1'
        """
        if options or not hasattr(self, "_corrected_lc"):
            self.correct(**options)
        fitted = self._fitted()
        return _to_collection(self.model.design_matrix(fitted.used), fitted.prior_variance)

    @documented(fit_transit=PLDFit.fit_transit)
    def fit_transit(self, transit_model):
        """
        Measure the depth of a transit, with all uncertainties of the last correction.

        {fit_transit}
        """
        with one_thread, solvable():
            return self._fitted().fit_transit(transit_model)

    @documented(held_out=PLDFit.held_out)
    def held_out(self, width=None, cadences=None):
        """
        Predict windows of cadences by a model that has not seen them.

        {held_out}
        """
        with one_thread, solvable():
            return self._fitted().held_out(width, cadences)

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

        self._check_corrected()
        lc, corrected, result = self.original_lc, self.corrected_lc, self.result
        systematics = trend = np.full(len(lc), np.nan)
        if result is not None:
            level = np.nanmedian(corrected.flux.value)
            systematics = level * np.exp(result.systematics)
            trend = level * np.exp(result.trend + result.periodic)
        return plot_detrending(
            lc.time.value,
            lc.flux.value,
            corrected.flux.value,
            systematics=systematics,
            trend=trend if self._restore_trend else None,
            outliers=self.outlier_mask,
            masked=~self.cadence_mask,
            time_label=f"Time ({lc.time.format.upper()})",
        )

    def diagnose_masks(self):
        """
        Draw the aperture and the light that the model gives to each pixel.

        Returns
        -------
        `~numpy.ndarray` of `~matplotlib.axes.Axes`
            Mean image with the aperture, and scatter of the pixel fractions.

        Raises
        ------
        ValueError
            If `correct` has not been called.
        """
        from scope_models.plotting.detrending import plot_detrending_masks  # imports matplotlib

        self._check_corrected()
        pixels = self._pixels
        flux = pixels.flux[pixels.usable]
        fractions = np.where(pixels.aperture, flux, 0) / pixels.total[pixels.usable, None, None]
        return plot_detrending_masks(
            np.median(flux, axis=0), pixels.aperture, np.std(fractions, axis=0)
        )


def _translated(options):
    """Return fields of `Settings` for arguments of lightkurve's corrector."""
    found = {}
    for name, value in options.items():
        if name in (*_RENAMED, *_SAME, *_SUCCESSORS) and (value is None or value is False):
            continue  # lightkurve's defaults
        if name in (*_RENAMED, *_SAME):
            found[_RENAMED.get(name, name)] = value
        elif name == "propagate_errors":
            if not value:
                raise ValueError("`propagate_errors` cannot be False: errors are always propagated")
        elif name in _SUCCESSORS:
            raise ValueError(f"`{name}` is not an option here: {_SUCCESSORS[name]}")
        else:
            raise TypeError(f"correct() got an unexpected keyword argument {name!r}")
    return found


def _named_mask(tpf, mask, name):
    """Return a mask of pixels for one of lightkurve's names; what is none returns as it is.

    Integers are 0 and 1, or the bits of a pipeline. ``name`` is that of the argument in messages.
    """
    if not isinstance(mask, str):
        if isinstance(mask, np.ndarray) and mask.dtype.kind in "iu":
            return mask > 0 if mask.max(initial=0) < 2 else (mask & 2) > 0
        return mask
    if mask == "default":
        mask = "pipeline" if tpf.pipeline_mask.any() else "threshold"
    if mask == "pipeline":
        if not tpf.pipeline_mask.any():
            raise ValueError(f'`{name}` cannot be "pipeline": the file has no such aperture')
        return np.asarray(tpf.pipeline_mask)
    if mask == "threshold":
        return tpf.create_threshold_mask()
    if mask == "background":
        return ~tpf.create_threshold_mask(threshold=0, reference_pixel=None)
    if mask in ("all", "empty"):
        return np.full(tpf.pipeline_mask.shape, mask == "all")
    raise ValueError(
        f'`{name}` must be a mask, None, "pipeline", "threshold", "all", "background" or "empty", '
        f"got {mask!r}"
    )


def _to_collection(regressors, prior_variance):
    """Return lightkurve's design matrices of groups of regressors."""
    from lightkurve.correctors import DesignMatrix, DesignMatrixCollection

    matrices = []
    for g, (name, variance) in enumerate(zip(regressors.names, prior_variance, strict=True)):
        columns = regressors.columns[:, regressors.groups == g]
        sigma = np.full(columns.shape[1], np.sqrt(variance))
        names = [f"{name} {k}" for k in range(columns.shape[1])]
        matrices.append(DesignMatrix(columns, columns=names, name=name, prior_sigma=sigma))
    return DesignMatrixCollection(matrices)
