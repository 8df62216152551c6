"""The result of a fit."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from html import escape
from operator import attrgetter

import numpy as np
from astropy import units as u
from astropy.table import Table
from astropy.time import Time

from scope_models._arrays import plain_tree
from scope_models._checks import checked_integer, checked_number
from scope_models._docstrings import documented
from scope_models._values import Value
from scope_models.fitting import _products
from scope_models.fitting._problem import median_image
from scope_models.fitting._solver import deviation, star_columns
from scope_models.fitting._start import APART, find_stars
from scope_models.models import PRF
from scope_models.scene.detector import Detector

__all__ = ["TPFFit"]

# Cards that a fit keeps: what the star is, and where the stamp is on detector and sky.
_FACTS = (
    *("OBJECT", "KEPLERID", "TICID", "RA_OBJ", "DEC_OBJ", "KEPMAG", "TESSMAG"),
    *("MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD"),
    *("1CRV5P", "2CRV5P", "1CDLT5", "2CDLT5", "12PC5", "22PC5"),
)
# Error of a sensitivity at a pixel's edge from which it is not measured: the paper's is lower by
# this there than in the center.
_LARGEST_EDGE_ERROR = 0.0125
# Scatter, in standard deviations of its prior or its error, that has another cause.
LARGEST_SCATTER = 3.0
# Fitted motion over that of POS_CORR that is not in doubt; least motion, pixels.
_SCALES, _LEAST_MOTION = (0.9, 1.1), 0.01
# Flux, in parts of the light in the pixels, that a model has invented.
LARGEST_FLUX = 2.0
# Errors beyond which a flux is negative, or light.
CERTAIN = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class TPFFit(Value):
    """A model of all pixels and cadences of a target pixel file.

    `fit_tpf` makes it. The columns of ``cadences`` and the entries of ``statistics`` are attributes
    too: ``fit.flux`` is a read-only array, None if there is no such column, ``fit.chi2`` a number.

    Parameters
    ----------
    model : PRF
        The fitted model at the median position and flux.
    parameters : astropy.table.Table
        Parameters that all cadences share, the free ones first: name, value, error, unit, fixed,
        kind as in `~scope_models.PRF.parameter_kinds`, and at_bound. The error is NaN at a bound,
        and for a sensitivity where the PSF is wrong.
    covariance : ndarray of shape (s, s)
        Covariance of the free ones, marginalized over all others.
    cadences : astropy.table.Table
        A row per cadence: time in days, cadenceno and quality; x and y in pixels, flux and
        background in e-/s, with x_err, y_err, flux_err and background_err, which hold the
        uncertainty of the shared parameters; flux_scatter, the error of a light curve, of the flux
        less its mean; focus, the relative width of the PSF; pos_corr, of shape (n, 2), if the file
        has it. With a response of each pixel the errors of x, y and background are those between
        cadences, for it takes up what all share; held_out are cadences from which it has not
        learned, and outliers those that it does not describe, which chi-squared leaves out.
    neighbors : tuple of FittedStar
        The other stars.
    interpixel, interpixel_err : ndarray of shape (ny, nx)
        Response of each pixel and its error; 1 and NaN without data.
    observed, observed_err, fitted : ndarray of shape (n, ny, nx)
        Data, errors and model, e-/s; NaN where not used.
    statistics : mapping
        ``chi2``, of the pixels without priors; n_data, their number, and n_parameters; error_scale,
        by which errors were scaled up where the model is not true; converged and n_steps;
        chi2_held_out, per degree of freedom of the held-out cadences, NaN without a response.
    time_format : str
        "bkjd" or "btjd".
    detector : Detector
        The detector, with the fitted response.
    options : mapping
        Options of the fit.
    meta : mapping
        Cards of the file that describe star and stamp.
    response : tuple of PixelShares, optional
        Changes of each pixel's share of each star's light, if they were fitted.

    Examples
    --------
    >>> from scope_models import Detector, Motion, Star, fit_tpf, simulate
    >>> detector = Detector.k2(shape=(7, 7))
    >>> observation = simulate(Star(12.0), detector, Motion.k2_roll(100), seed=1)
    >>> fit = fit_tpf(observation.to_tpf(), psf=1)
    >>> fit.parameters["name"][:3].tolist()
    ['sigma_x', 'sigma_y', 'rho']
    >>> stars, detector, motion = fit.scene()
    >>> twin = simulate(stars, detector, motion, seed=2)
    """

    model: PRF
    parameters: Table
    covariance: np.ndarray
    cadences: Table
    neighbors: tuple
    interpixel: np.ndarray
    interpixel_err: np.ndarray
    observed: np.ndarray
    observed_err: np.ndarray
    fitted: np.ndarray
    statistics: Mapping
    time_format: str
    detector: Detector
    options: Mapping
    meta: Mapping
    response: tuple = ()

    def __post_init__(self):
        columns = [*self.parameters.itercols(), *self.cadences.itercols()]
        for value in [*vars(self).values(), *columns]:
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def __getattr__(self, name):
        if name in _products.CADENCE_UNITS:
            table = self.cadences
            return np.asarray(table[name]) if name in table.colnames else None
        if name in _products.STATISTICS:
            return self.statistics[name]
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __dir__(self):
        return [*super().__dir__(), *_products.CADENCE_UNITS, *_products.STATISTICS]

    def __repr__(self):
        n, ny, nx = self.observed.shape
        state = "" if self.converged else ", not converged"
        return (
            f"<TPFFit of {n} cadences of {ny} x {nx} pixels, {len(self.names)} shared parameters, "
            f"chi-squared per degree of freedom {self.reduced_chi2:.4g}{state}>"
        )

    def _repr_html_(self):
        lines = [escape(s) for s in self.summary().splitlines() if not s.startswith("  ")]
        return f"<p>{'<br>'.join(lines)}</p>{self.parameters._repr_html_()}"

    shape = property(attrgetter("interpixel.shape"), doc="Shape (ny, nx) of an image.")
    sensitivity = property(attrgetter("model.sensitivity"), doc="The fitted sensitivity, or None.")

    @cached_property
    def _free(self):
        return self.parameters[~self.parameters["fixed"]]

    @property
    def names(self):
        """Names of the free shared parameters (tuple of str)."""
        return tuple(self._free["name"].tolist())

    @property
    def values(self):
        """Values of the free shared parameters by name."""
        return dict(zip(self.names, self._free["value"].tolist(), strict=True))

    @property
    def errors(self):
        """Standard deviations of the free shared parameters by name; NaN where not measured."""
        return dict(zip(self.names, self._free["error"].tolist(), strict=True))

    @property
    def at_bounds(self):
        """Names of the parameters that ended at a bound (tuple of str)."""
        return tuple(self._free["name"][self._free["at_bound"]].tolist())

    @property
    def psf(self):
        """The fitted PSF, a density of flux 1 at (0, 0)."""
        model = self.model.copy()
        model.x_0, model.y_0 = 0.0, 0.0
        return model.psf

    @property
    def reduced_chi2(self):
        """Chi-squared per degree of freedom."""
        return self.chi2 / self.dof

    @property
    def dof(self):
        """Degrees of freedom: pixel values less parameters."""
        return _products.degrees_of_freedom(self.statistics)

    @cached_property
    def residual(self):
        """Data less model, e-/s, shape (n, ny, nx); NaN where not used."""
        return self.observed - self.fitted

    @cached_property
    def chi2_pixels(self):
        """Chi-squared per degree of freedom of each pixel, (ny, nx); NaN without data."""
        return self._mean_squares(0)

    @cached_property
    def chi2_cadences(self):
        """Chi-squared per degree of freedom of each cadence, (n,)."""
        return self._mean_squares((1, 2))

    def _mean_squares(self, axis):
        squares = (self.residual / self.observed_err) ** 2
        if self.outliers is not None:
            squares[self.outliers] = np.nan
        count = np.isfinite(squares).sum(axis=axis)
        total = np.nansum(squares, axis=axis) * (self.n_data / self.dof)
        return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)

    def quantity(self, name):
        """Return a shared parameter with its unit.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        astropy.units.Quantity
            The value.
        """
        row = dict(zip(self.parameters["name"], self.parameters, strict=True))[name]
        unit = u.electron / u.s if row["unit"] == "e-/s" else row["unit"]
        return u.Quantity(row["value"], unit)

    def correlation(self):
        """Return the correlations between the shared parameters.

        Returns
        -------
        astropy.table.Table
            A column of names, and one column per parameter.
        """
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        matrix = self.covariance / np.outer(deviation, deviation)
        columns = dict(zip(self.names, matrix.T, strict=True))
        return Table({"name": list(self.names)} | columns)

    def path_r2(self):
        """Return how well an affine map of POS_CORR predicts the positions.

        Returns
        -------
        tuple of float
            Explained parts of the variances of x and y; NaN without POS_CORR.
        """
        if self.pos_corr is None:
            return np.nan, np.nan
        xy = np.column_stack([self.x, self.y])
        left = (xy - _products.mapped(self.pos_corr, xy)).var(axis=0)
        variance = np.where(xy.var(axis=0) > 0, xy.var(axis=0), np.nan)
        return tuple((1 - left / variance).tolist())

    def path_scale(self):
        """Return the fitted motion over that of POS_CORR.

        Returns
        -------
        tuple of float
            Slopes of x on POS_CORR1 alone and y on POS_CORR2 alone: a fit of both has no meaning
            where a star moves along a line, as with K2's roll. NaN without POS_CORR or motion.
        """
        if self.pos_corr is None or not self.pos_corr.std(axis=0).all():
            return np.nan, np.nan
        offsets = self.pos_corr - self.pos_corr.mean(axis=0)
        pairs = zip(offsets.T, (self.x, self.y), strict=True)
        return tuple(float(path @ position / (path @ path)) for path, position in pairs)

    def psf_shape(self):
        """Measure width and ellipticity of the PSF.

        Returns
        -------
        `~astropy.table.Table`
            Name, value, error and unit of the full widths at half maximum "fwhm", of a circle of
            the same area, "fwhm_major" and "fwhm_minor", pixels; of the "ellipticity", 1 less the
            ratio of the widths; and of the "angle" from the columns to the major axis, degrees.
            They are those of the area above half of the largest density; with a response of each
            pixel, of a Gaussian fitted to the typical shares, with errors from their scatter.
        """
        return _products.psf_shape(self)

    def psf_image(self, half=3.0, samples=121):
        """Draw the density of the PSF about the star.

        Parameters
        ----------
        half : float or `~astropy.units.Quantity`, optional
            Pixels from the center to the border.
        samples : int, optional
            Points along an axis.

        Returns
        -------
        offset : ndarray of shape (samples,)
            Offsets along columns and rows, pixels.
        density, error : ndarray of shape (samples, samples)
            Density over its largest value, and its standard deviation.

        Raises
        ------
        TypeError, ValueError
            If an argument is not a positive number.
        """
        half = checked_number("half", half, "pix", positive=True)
        offset = np.linspace(-half, half, checked_integer("samples", samples, 1))
        grid = np.meshgrid(offset, offset)
        density, slopes = _products.with_slopes(self, lambda psf: np.asarray(psf(*grid)))
        error = _products.propagated(slopes, self.covariance)
        return offset, density / density.max(), error / density.max()

    def to_lightcurve(self):
        """Return the fluxes as a light curve.

        Returns
        -------
        lightkurve.LightCurve
            With the columns centroid_col, centroid_row, background, quality and cadenceno. The
            errors are ``flux_scatter``.
        """
        from lightkurve import LightCurve

        unit = u.electron / u.s
        time = Time(self.time, format=self.time_format, scale="tdb")
        curve = LightCurve(time=time, flux=self.flux * unit, flux_err=self.flux_scatter * unit)
        curve["centroid_col"], curve["centroid_row"] = self.x * u.pixel, self.y * u.pixel
        curve["background"] = self.background * unit
        curve["quality"], curve["cadenceno"] = self.quality, self.cadenceno
        curve.meta.update(self.meta)
        return curve

    def scene(self, *, positions="fitted", signal="smooth"):
        """Return the scene of the star's twin, for `~scope_models.simulate`.

        Parameters
        ----------
        positions : {"fitted", "path"} or Motion, optional
            Fitted positions, with their noise, or an affine map of POS_CORR or of a motion.
        signal : {"smooth", "fitted", "constant"}, optional
            Relative flux: the sum of the pixels smoothed over half a day, the fitted fluxes with
            their noise, or none. With a response of each pixel, "smooth" are the fitted fluxes
            with the power, in 40 bands of frequency, that their errors do not explain.

        Returns
        -------
        Scene
            Stars, positions about their median, focus, sensitivity and response as fitted, the
            read noise with which faint pixels scatter from cadence to cadence, and names and
            places of the file; with a response of each pixel also its shares, and the fitted
            background.
        """
        return _products.make_scene(self, positions, signal)

    def summary(self):
        """Return what the fit found, as text.

        Returns
        -------
        str
            Model, residuals, motion, parameters and doubts.
        """
        n, ny, nx = self.observed.shape
        state = f"{'' if self.converged else 'not '}converged after {self.n_steps} steps"
        typical = np.nanmedian(self.chi2_pixels)
        stars = 1 + len(self.neighbors)
        lines = [
            f"{n} cadences of {ny} x {nx} pixels, {stars} star{'s' * (stars > 1)}, {state}",
            f"chi-squared per degree of freedom {self.reduced_chi2:.4g}, typically {typical:.4g}",
            f"errors of the pixels scaled by {self.error_scale:.3g}",
        ]
        if self.response:
            shares, n = self.response[0], int(self.outliers.sum())
            lines.append(
                f"shares of pixels of degree {shares.degree} in position, {shares.time_degree} in "
                f"time; chi-squared of {int(self.held_out.sum())} held-out cadences "
                f"{self.chi2_held_out:.4g}; {n} outliers left out"
            )
        for star in (self, *self.neighbors):
            x, y, flux = (np.median(values) for values in (star.x, star.y, star.flux))
            name = "flux" if star is self else "other star:"
            lines.append(f"{name} {flux:.6g} e-/s at column {x:.3f}, row {y:.3f}")
        for axis, r2, scale in zip("xy", self.path_r2(), self.path_scale(), strict=True):
            if np.isfinite(scale):
                lines.append(f"motion along {axis}: {scale:.3f} of POS_CORR, R2 {r2:.3f}")
        rows = self.psf_shape()
        shape = {row["name"]: f"{row['value']:.4f} +- {row['error']:.4f}" for row in rows}
        lines.append(
            f"full width at half maximum {shape['fwhm_major']} by {shape['fwhm_minor']} pix, "
            f"ellipticity {shape['ellipticity']}"
        )
        terms = np.isin(self.parameters["kind"], ("coefficient", "correction", "focus"))
        for row in self.parameters[~(terms | (terms.any() & self.parameters["fixed"]))]:
            error = "fixed" if row["fixed"] else f"+- {row['error']:.2g}"
            lines.append(f"  {row['name']:18s} {row['value']:12.6g} {error} {row['unit']}".rstrip())
        if terms.any():
            lines.append(f"  and {terms.sum()} coefficients of smooth terms")
        return "\n".join([*lines, *(f"! {doubt}" for doubt in doubts_of(self))])

    def plot(self):
        """Draw data, model and residual, positions, chi-squared, sensitivity or light curve.

        Returns
        -------
        dict of str to matplotlib.axes.Axes
            The Axes by names.
        """
        from scope_models.plotting import plot_fit

        offset, density, _ = self.psf_image()
        border = offset[-1] + (offset[1] - offset[0]) / 2
        width, error = self.psf_shape()["value", "error"][0]
        seen = np.isfinite(self.observed).any(axis=0)
        cubes = self.observed, self.fitted, self.residual
        images = (np.where(seen, median_image(cube), np.nan) for cube in cubes)
        return plot_fit(
            *images, self.x, self.y, psf=density, psf_extent=(-border, border, -border, border),
            psf_width=f"FWHM {width:.3g} $\\pm$ {error:.1g} px", pos_corr=self.pos_corr,
            sensitivity=_products.sensitivity_profiles(self), chi2=self.chi2_pixels, time=self.time,
            flux=self.flux, time_label=f"Time ({self.time_format.upper()})",
        )  # fmt: skip

    @documented()
    def write(self, path, overwrite=False):
        """Write the fit to a FITS file.

        Parameters
        ----------
        {write}
        """
        return _products.write_fit(self, path, overwrite=overwrite)

    @classmethod
    def read(cls, path):
        """Read a fit from a FITS file.

        Parameters
        ----------
        path : str or path-like
            The file.

        Returns
        -------
        TPFFit
            The fit.

        Raises
        ------
        ValueError
            If the file does not hold a fit.
        """
        return cls(**_products.read_fit(path))


def make_results(solution, errors, detectors, series):
    problem, state, results = solution.problem, solution.state, []
    s, fitted = problem.n_shared, problem.model(state)
    covariance, ended = errors.shared[:s, :s], problem.at_bounds(state)
    at_bounds = [p.name for p, end in zip(problem.parameters, ended, strict=True) if end]
    for number, (data, pixels) in enumerate(zip(problem.stamps, problem.slices, strict=True)):
        given = problem, state, errors, number, fitted, problem.weight
        fields, columns, squares = fitted_fields(*given)
        interpixel, interpixel_err = np.ones(data.shape), np.full(data.shape, np.nan)
        if problem.n_pixels:
            interpixel[data.pixels] = 1 + state.interpixel[pixels]
            variance = np.diag(errors.shared)[s:][pixels]
            interpixel_err[data.pixels] = np.sqrt(np.maximum(variance, 0))
        n_data = int(np.isfinite(squares).sum())
        statistics = {
            "chi2": float(np.nansum(squares)), "n_data": n_data,
            "n_parameters": round(problem.n_free * n_data / problem.n_data),
            "error_scale": problem.misfit, "converged": solution.converged and not at_bounds,
            "n_steps": solution.n_steps, "chi2_held_out": np.nan,
        }  # fmt: skip
        model, cards = fields["model"], series[number].header
        detector = detectors[number].replace(
            sensitivity=model.sensitivity, interpixel=np.maximum(interpixel, 0.0)
        )
        kinds, values = {p.name: p.kind for p in problem.parameters}, state.shared
        results.append(TPFFit(
            **fields, covariance=covariance, interpixel=interpixel, interpixel_err=interpixel_err,
            parameters=_products.parameter_table(
                model, kinds, values, covariance, at_bounds, statistics
            ),
            cadences=_products.cadence_table(columns), statistics=statistics, detector=detector,
            time_format=data.time_format, options=asdict(problem.options),
            meta=plain_tree({k: cards[k] for k in _FACTS if cards.get(k) is not None}, str),
        ))  # fmt: skip
    return results


def fitted_fields(problem, state, errors, number, fitted, weight):
    """Fields, columns and squared residuals of a file, from model and weights of all pixels."""
    data, pixels = problem.stamps[number], problem.slices[number]
    observed, modeled = np.full((2, *data.flux.shape), np.nan)
    for cube, values in ((observed, problem.flux), (modeled, fitted)):
        cube[:, data.pixels] = np.where(weight[:, pixels] > 0, values[:, pixels], np.nan)
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == number]
    own, *others = (star_columns(problem, state, errors, k) for k in stars)
    model = problem.prf.copy()
    middle = {n: float(np.median(own[n.removesuffix("_0")])) for n in ("x_0", "y_0", "flux")}
    for name, value in (problem.values(state) | middle).items():
        setattr(model, name, value)
    column, background = problem.flux_number(stars[0]), problem.background_number(number)
    columns = {name: getattr(data, name) for name in ("time", "cadenceno", "quality", "pos_corr")}
    columns |= own | {
        "flux_scatter": np.sqrt(np.maximum(errors.relative[:, column, column], 0.0)),
        "background": problem.backgrounds(state, number),
        "background_err": 0 * data.time if background is None else deviation(errors, background),
        "focus": 1 + problem.focus(state),
    }
    fields = {"observed": observed, "observed_err": data.flux_err, "fitted": modeled}
    fields["neighbors"] = tuple(_products.FittedStar(**values) for values in others)
    return fields | {"model": model}, columns, ((observed - modeled) / data.flux_err) ** 2


def doubts_of(fit):
    """Return a message for each doubt about a fit."""
    return [
        *_parameter_doubts(fit),
        *_pixel_doubts(fit),
        *_position_doubts(fit),
        *_flux_doubts(fit),
    ]


def is_measured(power, error):
    """Whether the error of a coefficient, of an axis and power, is small enough."""
    return error * 0.5 ** power[1] < _LARGEST_EDGE_ERROR


def _parameter_doubts(fit):
    if not fit.converged and not fit.at_bounds:
        yield (
            f"the fit has not converged after {fit.n_steps} steps: chi-squared {fit.chi2:.6g}, "
            f"{fit.reduced_chi2:.4g} per degree of freedom; the best parameters are kept"
        )
    powers = fit.model.response_powers
    others = [f"{name} = {fit.values[name]:.3g}" for name in fit.at_bounds if name not in powers]
    if others:
        ended = f"the fit ends at bounds, {', '.join(others)}"
        yield f"{ended}: the model does not describe the pixels; try another `psf`"
    for name in filter(powers.get, fit.names):
        axis, value, error = powers[name][0], fit.values[name], fit.errors[name]
        if name in fit.at_bounds:
            yield (
                f"the sensitivity is at its bound, {name} = {value:.3g}: it describes "
                "errors of the PSF, and is not measured"
            )
        elif np.isnan(error):
            yield (
                f"the sensitivity is not measured: the PSF is wrong by {fit.error_scale:.2g} times "
                f"the noise (chi-squared {fit.reduced_chi2:.3g}), and {name} = {value:.3g} "
                "describes that"
            )
        elif not is_measured(powers[name], error):
            yield (
                f"the motion ({np.std(getattr(fit, axis)):.2g} px rms along {axis}) does not "
                f"constrain the sensitivity: {name} = {value:.3g} +- {error:.2g}"
            )


def _pixel_doubts(fit):
    prior, scatter = fit.options["interpixel"], np.std(fit.interpixel - 1)
    if prior and scatter > LARGEST_SCATTER * prior:
        yield (
            f"the response between pixels scatters by {100 * scatter:.2g} %, but its prior is "
            f"{100 * prior:.2g} %: it describes errors of the PSF; interpixel=0 leaves it out"
        )
    light, invented = np.median(_products.light_of(fit, fit.observed)), np.median(fit.flux)
    if invented > LARGEST_FLUX * light > 0:
        yield (
            f"the flux is {invented:.4g} e-/s, but the pixels hold {light:.4g}: the PSF has most "
            "of its light outside of them, or two of its terms cancel"
        )
    if fit.error_scale > 1:
        row, column = np.unravel_index(np.nanargmax(fit.chi2_pixels), fit.chi2_pixels.shape)
        yield (
            f"the model does not describe the pixels: chi-squared per degree of freedom is "
            f"{fit.reduced_chi2:.4g}, and largest in column {column}, row {row}; all errors are "
            f"{fit.error_scale:.3g} times those of the noise"
            + ("" if fit.response else '; response="pixels" fits the share of each pixel')
        )
    if fit.error_scale > 1 or fit.response:  # which takes up the light of any star
        stars = np.array([np.median([star.x, star.y], axis=1) for star in (fit, *fit.neighbors)])
        away = np.linalg.norm(find_stars(fit.observed)[:, None] - stars, axis=2).min(axis=1)
        if others := np.sum(away > APART):
            yield (
                f"{others} other maxi{'mum' if others == 1 else 'ma'} of the median image may be "
                'other stars: neighbors="find" fits them'
            )


def _position_doubts(fit):
    remedy = "" if fit.options["positions"] == "path" else 'positions="path" or '
    for axis, slope, size in zip("xy", fit.path_scale(), fit.shape[::-1], strict=True):
        position, error = getattr(fit, axis), np.median(getattr(fit, f"{axis}_err"))
        if not _SCALES[0] < slope < _SCALES[1] and np.isfinite(slope):
            path = fit.pos_corr[:, "xy".index(axis)].std()
            differs = abs(slope - 1) * path > 3 * error / len(fit.x) ** 0.5
            if differs and path * max(1.0, abs(slope)) > _LEAST_MOTION:
                why = f"the PSF may have absorbed it; {remedy}a richer PSF prevents it"
                why = "this, or the light of one star alone, may be wrong" if fit.response else why
                yield f"the fitted motion along {axis} is {slope:.2g} times that of POS_CORR: {why}"
        if not 0 <= np.median(position) <= size - 1:
            yield f"the star is at the edge of the pixels: {axis} = {np.median(position):.2f}"
        if lost := np.sum((position <= -1) | (position >= size)):
            yield f"in {lost} cadences the fitted {axis} ends at its bounds, off the pixels"


def _flux_doubts(fit):
    # A PSF that leaves the whole flux open, as on a small stamp, hides no star.
    light, error = np.mean(fit.flux), np.sqrt(np.mean(fit.flux_scatter**2) / len(fit.flux))
    if abs(light) < LARGEST_SCATTER * error:
        yield f"no star is seen: its mean flux is {light:.3g} +- {error:.2g} e-/s"
    # what all cadences have in common, which the PSF determines
    if fit.response and (part := np.median(fit.flux_err / np.abs(fit.flux))) > 1 / CERTAIN:
        yield (
            f"the flux of all cadences is uncertain by {100 * part:.2g} %, for their PSF is not "
            "known: give the `psf`; from cadence to cadence the error is `flux_scatter`"
        )
    for number, star in enumerate((fit, *fit.neighbors)):
        if negative := np.sum(star.flux < -CERTAIN * star.flux_err):
            name = f"neighbor {number}" if number else "the star"
            yield f"the flux of {name} is negative in {negative} cadences"
    if fit.response and fit.neighbors:
        yield (
            'response="pixels" divides the light of several stars between them by the PSF: the '
            "fluxes of the fainter ones have larger errors than those given"
        )
    seen = np.isfinite(fit.observed)
    whole = seen.sum(axis=(1, 2)) == seen.any(axis=0).sum()
    fluxes = np.column_stack([fit.flux, _products.light_of(fit, fit.observed)])
    steps = np.diff(fluxes[whole & _products.described(fit)], axis=0)
    ours, pixels = np.sqrt(np.sum(steps**2, axis=0) / max(len(steps), 1))
    error = float(np.sqrt(np.mean(fit.flux_scatter**2)))
    if ours > LARGEST_FLUX * np.hypot(pixels, error):
        yield (
            f"the flux changes by {ours:.3g} e-/s from cadence to cadence, and the light in "
            f"the pixels by {pixels:.3g}: the data allow several solutions"
        )
    if (explained := _products.followed(fit)) > LARGEST_SCATTER * error:
        yield (
            f"the flux varies with the position of the star by {explained:.3g} e-/s rms, but its "
            f"error is {error:.3g}: the model does not separate the two"
        )
