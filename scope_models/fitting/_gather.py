"""How the result of a fit is gathered, and what is doubtful about it."""

import warnings
from dataclasses import asdict

import numpy as np

from scope_models.exceptions import FitWarning
from scope_models.fitting.result import TPFFit

__all__ = ["make_result", "warn_of_fit"]

_FACTS = ("OBJECT", "MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "KEPMAG")
# The paper's sensitivity is lower by this at the edge of a pixel than at its centre: a coefficient
# whose error there is larger has not been measured.
_LARGEST_EDGE_ERROR = 0.0125
# Scatter of the response between pixels, in standard deviations of its prior, that is no response.
_LARGEST_SCATTER = 3.0
# Reduced chi-squared from which a model does not describe the pixels.
_LARGEST_CHI2 = 100.0


def make_result(problem, solution, errors, detector, series):
    """Gather a fit from what the solver gives."""
    state, data = solution.state, problem.data
    shared, cadence, relative = errors
    inside, s = data.pixels, problem.n_shared
    fitted = np.full(data.flux.shape, np.nan)
    fitted[:, inside] = problem.model(state)[:, problem.slices[0]]
    fitted[~np.isfinite(data.flux)] = np.nan
    interpixel, interpixel_err = np.ones(data.shape), np.full(data.shape, np.nan)
    if problem.n_pixels:
        interpixel[inside] = 1 + state.interpixel
        interpixel_err[inside] = np.sqrt(np.maximum(np.diag(shared)[s:], 0))
    by_cadence = _by_cadence(problem, state, shared, cadence, relative)
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
    return TPFFit(
        model=model,
        names=problem.names,
        kinds=tuple(p.kind for p in problem.parameters),
        parameters=state.shared.copy(),
        covariance=shared[:s, :s].copy(),
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
        n_data=problem.n_data,
        n_parameters=state.cadence.size + s + extra,
        error_scale=problem.error_scale,
        converged=solution.converged,
        n_steps=solution.n_steps,
        time_format=data.time_format,
        detector=detector,
        options=asdict(problem.options),
        meta={k: _plain(series.header[k]) for k in _FACTS if series.header.get(k) is not None},
        **by_cadence,
    )


def _by_cadence(problem, state, shared, cadence, relative):
    """Values and errors of each cadence by name."""
    variances = np.maximum(np.einsum("nkk->nk", cadence), 0.0)
    errors = dict(zip(problem.columns, np.sqrt(variances).T, strict=True))
    i = problem.columns.index("flux")
    x, y = problem.xy(state).T
    zero = np.zeros(len(x))
    result = {"x": x, "y": y, "flux": problem.fluxes(state)}
    result["background"] = problem.backgrounds(state)
    result["flux_scatter"] = np.sqrt(np.maximum(relative[:, i, i], 0))
    if problem.path:
        for axis, name in enumerate("xy"):
            block = slice(problem.n_shape + 3 * axis, problem.n_shape + 3 * axis + 3)
            variance = np.einsum("ni,ij,nj->n", problem.basis, shared[block, block], problem.basis)
            errors[name] = np.sqrt(np.maximum(variance, 0))
    if "background" in problem.names:
        j = problem.names.index("background")
        errors["background"] = np.full(len(x), np.sqrt(max(shared[j, j], 0)))
    for name in ("x", "y", "flux", "background"):
        result[f"{name}_err"] = np.array(errors.get(name, zero))
    return {name: np.array(value) for name, value in result.items()}


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
    messages = []
    if not fit.converged:
        messages.append(
            f"the fit has not converged after {fit.n_steps} steps: chi-squared {fit.chi2:.6g}, "
            f"{fit.reduced_chi2:.4g} per degree of freedom; the best parameters are kept"
        )
    spread = {"x": np.std(fit.x), "y": np.std(fit.y)}
    for name, (axis, power) in fit.model.response_powers.items():
        if name not in fit.names:
            continue
        error = fit.errors[name] * 0.5**power
        if error == 0:
            messages.append(
                f"the sensitivity is at its bound, {name} = {fit.values[name]:.3g}: it describes "
                "errors of the PSF, and is not measured"
            )
        if not error < _LARGEST_EDGE_ERROR:
            messages.append(
                f"the motion ({spread[axis]:.2g} px rms along {axis}) does not constrain the "
                f"sensitivity: {name} = {fit.values[name]:.3g} +- {fit.errors[name]:.2g}"
            )
    prior, scatter = fit.options["interpixel"], np.std(fit.interpixel - 1)
    if prior and scatter > _LARGEST_SCATTER * prior:
        messages.append(
            f"the response between pixels scatters by {100 * scatter:.2g} % where the prior is "
            f"{100 * prior:.2g} %: it describes errors of the PSF; interpixel=0 leaves it out"
        )
    if fit.reduced_chi2 > _LARGEST_CHI2:
        row, column = np.unravel_index(np.nanargmax(fit.chi2_pixels), fit.chi2_pixels.shape)
        messages.append(
            f"the model does not describe the pixels: chi-squared per degree of freedom is "
            f"{fit.reduced_chi2:.4g}, and largest in column {column}, row {row}"
        )
    ny, nx = fit.shape
    x, y = np.median(fit.x), np.median(fit.y)
    if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1):
        messages.append(f"the star is at the edge of the pixels: x = {x:.2f}, y = {y:.2f}")
    for message in messages:
        warnings.warn(message, FitWarning, stacklevel=stacklevel)
