"""How the result of a fit is gathered."""

import numpy as np

from scope_models.fitting._result import TPFFit
from scope_models.models._derivatives import prf_sensitivity

__all__ = ["make_result"]

_FACTS = ("OBJECT", "MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "KEPMAG")
_AFFINE = ("x_const", "x_by_corr1", "x_by_corr2", "y_const", "y_by_corr1", "y_by_corr2")


def make_result(problem, solution, errors, detector, tpf, options):
    """Gather a fit from what the solver gives."""
    state, data = solution.state, problem.data
    shared, cadence, relative = errors
    inside, s = data.pixels, problem.n_shared
    names = (*problem.names, *_AFFINE[: problem.n_affine])
    names += ("background",) if problem.background == "constant" else ()
    fitted = np.full(data.flux.shape, np.nan)
    fitted[:, inside] = problem.model(state)
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
        sensitivity=prf_sensitivity(model), interpixel=_positive(interpixel)
    )
    return TPFFit(
        model=model,
        names=names,
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
        options=options,
        meta={k: _plain(tpf.meta[k]) for k in _FACTS if k in getattr(tpf, "meta", {})},
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
            block = slice(len(problem.names) + 3 * axis, len(problem.names) + 3 * axis + 3)
            variance = np.einsum("ni,ij,nj->n", problem.basis, shared[block, block], problem.basis)
            errors[name] = np.sqrt(np.maximum(variance, 0))
    if problem.background == "constant":
        j = problem.n_shared - 1
        errors["background"] = np.full(len(x), np.sqrt(max(shared[j, j], 0)))
    for name in ("x", "y", "flux", "background"):
        result[f"{name}_err"] = np.array(errors.get(name, zero))
    return {name: np.array(value) for name, value in result.items()}


def _positive(response):
    """A response that a detector can have."""
    return np.maximum(response, 0.0)


def _plain(value):
    """What JSON can hold."""
    if isinstance(value, np.generic):
        value = value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)
