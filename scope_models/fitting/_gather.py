"""How the result of a fit is gathered, and what is doubtful about it."""

import warnings
from dataclasses import asdict

import numpy as np

from scope_models.exceptions import FitWarning
from scope_models.fitting.result import FittedStar, TPFFit

__all__ = ["doubts_of", "make_results", "warn_of_fit"]

# Cards that a fit keeps: what the star is, and where the stamp is on detector and sky.
_FACTS = (
    *("OBJECT", "KEPLERID", "TICID", "RA_OBJ", "DEC_OBJ", "KEPMAG", "TESSMAG"),
    *("MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD"),
    *("1CRV5P", "2CRV5P", "1CDLT5", "2CDLT5", "12PC5", "22PC5"),
)
# The paper's sensitivity is lower by this at the edge of a pixel than at its center: a coefficient
# whose error there is larger has not been measured.
_LARGEST_EDGE_ERROR = 0.0125
# Scatter of the response between pixels, in standard deviations of its prior, that is no response.
_LARGEST_SCATTER = 3.0
# Fitted motion over that of POS_CORR that is not in doubt, and the motion, pixels, from which it is
# checked.
_SCALES, _LEAST_MOTION = (0.9, 1.1), 0.01
# Reduced chi-squared from which a model does not describe the pixels.
_LARGEST_CHI2 = 100.0


def make_results(problem, solution, errors, detectors, series):
    """Gather the fit of each file from what the solver gives."""
    fitted = problem.model(solution.state)
    return [
        _make_result(problem, solution, errors, fitted, number, detectors[number], series[number])
        for number in range(len(problem.stamps))
    ]


def _make_result(problem, solution, errors, model_pixels, number, detector, series):
    """Gather the fit of one file."""
    state, data, pixels = solution.state, problem.stamps[number], problem.slices[number]
    shared, cadence, relative = errors
    inside, s = data.pixels, problem.n_shared
    fitted = np.full(data.flux.shape, np.nan)
    fitted[:, inside] = model_pixels[:, pixels]
    fitted[~np.isfinite(data.flux)] = np.nan
    interpixel, interpixel_err = np.ones(data.shape), np.full(data.shape, np.nan)
    if problem.n_pixels:
        interpixel[inside] = 1 + state.interpixel[pixels]
        interpixel_err[inside] = np.sqrt(np.maximum(np.diag(shared)[s:][pixels], 0))
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == number]
    by_cadence = _by_cadence(problem, state, shared, cadence, relative, stars[0])
    neighbors = tuple(FittedStar(**_of_star(problem, state, shared, cadence, k)) for k in stars[1:])
    model = problem.prf.copy()
    middle = {name: float(np.median(by_cadence[name])) for name in ("x", "y", "flux")}
    places = {"x_0": middle["x"], "y_0": middle["y"], "flux": middle["flux"]}
    for name, value in (problem.values(state) | places).items():
        setattr(model, name, value)
    squares = ((data.flux - fitted) / data.flux_err) ** 2
    extra = problem.n_pixels - bool(problem.n_pixels)
    detector = detector.replace(
        sensitivity=model.sensitivity, interpixel=np.maximum(interpixel, 0.0)
    )
    n_data = int(np.isfinite(data.flux).sum())
    n_parameters = (state.cadence.size + s + extra) * n_data / problem.n_data
    covariance = shared[:s, :s].copy()
    limits = problem.limits
    at_bounds = (state.shared <= limits.lower) | (state.shared >= limits.upper)
    return TPFFit(
        model=model,
        names=problem.names,
        kinds=tuple(p.kind for p in problem.parameters),
        parameters=state.shared.copy(),
        covariance=covariance,
        at_bounds=tuple(n for n, at in zip(problem.names, at_bounds, strict=True) if at),
        neighbors=neighbors,
        focus=1 + problem.focus(state),
        interpixel=interpixel,
        interpixel_err=interpixel_err,
        time=data.time,
        cadenceno=data.cadenceno,
        quality=data.quality,
        observed=data.flux,
        observed_err=data.flux_err,
        fitted=fitted,
        pos_corr=data.pos_corr,
        chi2=float(np.nansum(squares)),
        n_data=n_data,
        n_parameters=round(n_parameters),
        error_scale=problem.error_scale,
        converged=solution.converged and not at_bounds.any(),
        n_steps=solution.n_steps,
        time_format=data.time_format,
        detector=detector,
        options=asdict(problem.options),
        meta={k: _plain(series.header[k]) for k in _FACTS if series.header.get(k) is not None},
        **by_cadence,
    )


def _of_star(problem, state, shared, cadence, star):
    """Position and flux of a star, and their errors, by name."""
    variances = np.maximum(np.einsum("nkk->nk", cadence), 0.0)
    errors = dict(zip(problem.columns, variances.T, strict=True))

    def of_shared(name):
        """Variance of a shared parameter, or nothing."""
        if name not in problem.names:
            return 0.0
        index = problem.names.index(name)
        return max(shared[index, index], 0.0)

    zero = np.zeros(len(state.cadence))
    x, y = problem.xy(state, star).T
    if problem.path:
        for axis, name in enumerate("xy"):
            block = slice(problem.n_shape + 3 * axis, problem.n_shape + 3 * axis + 3)
            errors[name] = np.einsum(
                "ni,ij,nj->n", problem.basis, shared[block, block], problem.basis
            )
    column = f"flux_{star}" if star else "flux"
    flux_error = errors.get(column, zero + of_shared(f"flux_star_{star}"))
    result = {"x": x, "y": y, "flux": problem.fluxes(state, star)}
    result["flux_err"] = np.sqrt(flux_error)
    for axis in "xy":
        variance = errors[axis] + of_shared(f"{axis}_star_{star}")
        result[f"{axis}_err"] = np.sqrt(np.maximum(variance, 0.0))
    return {name: np.array(value) for name, value in result.items()}


def _by_cadence(problem, state, shared, cadence, relative, star):
    """Values and errors of each cadence by name."""
    result = _of_star(problem, state, shared, cadence, star)
    i = problem.columns.index(f"flux_{star}" if star else "flux")
    result["flux_scatter"] = np.sqrt(np.maximum(relative[:, i, i], 0))
    stamp = problem.stars[star].stamp
    name = f"background_{stamp}" if stamp else "background"
    result["background"] = np.array(problem.backgrounds(state, stamp))
    variance = np.zeros(len(state.cadence))
    if name in problem.columns:
        j = problem.columns.index(name)
        variance = cadence[:, j, j]
    elif name in problem.names:
        j = problem.names.index(name)
        variance = variance + shared[j, j]
    result["background_err"] = np.sqrt(np.maximum(variance, 0.0))
    return result


def _plain(value):
    """What JSON can hold."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def warn_of_fit(fit, stacklevel):
    """
    Warn of what is doubtful about a fit.

    Parameters
    ----------
    fit : TPFFit
        The fit.
    stacklevel : int
        Whose line the warning names.
    """
    for message in doubts_of(fit):
        warnings.warn(message, FitWarning, stacklevel=stacklevel)


def doubts_of(fit):
    """
    Return what is doubtful about a fit.

    Parameters
    ----------
    fit : TPFFit
        The fit.

    Returns
    -------
    messages : list of str
        One for each doubt.
    """
    messages = [*_of_convergence(fit), *_of_sensitivity(fit), *_of_pixels(fit)]
    return [*messages, *_of_positions(fit)]


def _of_convergence(fit):
    """Doubts about where the iterations ended."""
    if not fit.converged and not fit.at_bounds:
        yield (
            f"the fit has not converged after {fit.n_steps} steps: chi-squared {fit.chi2:.6g}, "
            f"{fit.reduced_chi2:.4g} per degree of freedom; the best parameters are kept"
        )
    powers = fit.model.response_powers
    others = [f"{name} = {fit.values[name]:.3g}" for name in fit.at_bounds if name not in powers]
    if others:
        yield f"the fit ends at bounds, {', '.join(others)}: the model does not suit the pixels"


def _of_sensitivity(fit):
    """Doubts about the response within a pixel."""
    spread = {"x": np.std(fit.x), "y": np.std(fit.y)}
    for name, (axis, power) in fit.model.response_powers.items():
        if name not in fit.names:
            continue
        value, error = fit.values[name], fit.errors[name]
        if name in fit.at_bounds:
            yield (
                f"the sensitivity is at its bound, {name} = {value:.3g}: it describes "
                "errors of the PSF, and is not measured"
            )
        elif np.isnan(error):
            yield (
                f"the sensitivity is not measured: the PSF is wrong by {fit.error_scale:.2g} times "
                f"the noise, and {name} = {value:.3g} describes that"
            )
        elif not error * 0.5**power < _LARGEST_EDGE_ERROR:
            yield (
                f"the motion ({spread[axis]:.2g} px rms along {axis}) does not constrain the "
                f"sensitivity: {name} = {value:.3g} +- {error:.2g}"
            )


def _of_pixels(fit):
    """Doubts about the response between pixels, and the residuals."""
    prior, scatter = fit.options["interpixel"], np.std(fit.interpixel - 1)
    if prior and scatter > _LARGEST_SCATTER * prior:
        yield (
            f"the response between pixels scatters by {100 * scatter:.2g} % where the prior is "
            f"{100 * prior:.2g} %: it describes errors of the PSF; interpixel=0 leaves it out"
        )
    if fit.reduced_chi2 > _LARGEST_CHI2:
        row, column = np.unravel_index(np.nanargmax(fit.chi2_pixels), fit.chi2_pixels.shape)
        yield (
            f"the model does not describe the pixels: chi-squared per degree of freedom is "
            f"{fit.reduced_chi2:.4g}, and largest in column {column}, row {row}"
        )


def _of_positions(fit):
    """Doubts about where the star is, and how it moves."""
    if fit.pos_corr is not None:
        errors = np.array([np.median(fit.x_err), np.median(fit.y_err)]) / len(fit.x) ** 0.5
        for axis, path, error, slope in zip(
            "xy", fit.pos_corr.std(axis=0), errors, fit.path_scale(), strict=True
        ):
            differs = not _SCALES[0] < slope < _SCALES[1] and abs(slope - 1) * path > 3 * error
            if differs and path * max(1.0, abs(slope)) > _LEAST_MOTION:
                yield (
                    f"the fitted motion along {axis} is {slope:.2g} times that of POS_CORR: the "
                    'PSF may have absorbed it; positions="path" or a richer PSF prevents it'
                )
    ny, nx = fit.shape
    x, y = np.median(fit.x), np.median(fit.y)
    if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1):
        yield f"the star is at the edge of the pixels: x = {x:.2f}, y = {y:.2f}"
