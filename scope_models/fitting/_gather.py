"""The result of a fit from its solution."""

from dataclasses import asdict

import numpy as np

from scope_models._arrays import plain_tree
from scope_models.fitting._parameters import FittedStar, cadence_table, parameter_table
from scope_models.fitting.result import TPFFit

__all__ = ["fitted_fields", "make_results"]

# Cards that a fit keeps: what the star is, and where the stamp is on detector and sky.
_FACTS = (
    *("OBJECT", "KEPLERID", "TICID", "RA_OBJ", "DEC_OBJ", "KEPMAG", "TESSMAG"),
    *("MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD"),
    *("1CRV5P", "2CRV5P", "1CDLT5", "2CDLT5", "12PC5", "22PC5"),
)


def make_results(problem, solution, errors, detectors, series):
    """Gather the fit of each file from the solution."""
    state, s, results = solution.state, problem.n_shared, []
    fitted, covariance = problem.model(state), errors.shared[:s, :s].copy()
    ended = zip(problem.parameters, problem.at_bounds(state), strict=True)
    at_bounds = [parameter.name for parameter, end in ended if end]
    for number, (data, pixels) in enumerate(zip(problem.stamps, problem.slices, strict=True)):
        fields = fitted_fields(problem, state, errors, number, fitted, problem.weight)
        interpixel, interpixel_err = np.ones(data.shape), np.full(data.shape, np.nan)
        if problem.n_pixels:
            interpixel[data.pixels] = 1 + state.interpixel[pixels]
            variance = np.diag(errors.shared)[s:][pixels]
            interpixel_err[data.pixels] = np.sqrt(np.maximum(variance, 0))
        model, n_data = fields["model"], int(np.isfinite(fields["observed"]).sum())
        statistics = {
            "chi2": float(np.nansum(fields.pop("squares"))), "n_data": n_data,
            "n_parameters": round(problem.n_free * n_data / problem.n_data),
            "error_scale": problem.misfit, "converged": solution.converged and not at_bounds,
            "n_steps": solution.n_steps, "chi2_held_out": np.nan,
        }  # fmt: skip
        table = parameter_table(
            model, problem.parameters, state.shared, covariance, at_bounds, statistics,
            response=False,
        )  # fmt: skip
        kept = {key: series[number].header.get(key) for key in _FACTS}
        result = TPFFit(
            **fields | {"cadences": cadence_table(fields["cadences"])},
            parameters=table,
            covariance=covariance,
            interpixel=interpixel,
            interpixel_err=interpixel_err,
            statistics=statistics,
            time_format=data.time_format,
            detector=detectors[number].replace(
                sensitivity=model.sensitivity, interpixel=np.maximum(interpixel, 0.0)
            ),
            options=asdict(problem.options),
            meta=plain_tree({key: v for key, v in kept.items() if v is not None}, str),
        )
        results.append(result)
    return results


def fitted_fields(problem, state, errors, number, fitted, weight):
    """Fields of the fit of a file: model, cadences as a dict, stars, pixels with their squares.

    ``fitted`` is the model and ``weight``, 0 where they are not used, that of all pixels, (n, p).
    """
    data, pixels = problem.stamps[number], problem.slices[number]
    observed, modeled = np.full((2, *data.flux.shape), np.nan)
    for cube, values in ((observed, problem.flux), (modeled, fitted)):
        cube[:, data.pixels] = np.where(weight[:, pixels] > 0, values[:, pixels], np.nan)
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == number]
    own, *others = (_of_star(problem, state, errors, k) for k in stars)
    model = problem.prf.copy()
    middle = {n: float(np.median(own[n.removesuffix("_0")])) for n in ("x_0", "y_0", "flux")}
    for name, value in (problem.values(state) | middle).items():
        setattr(model, name, value)
    column, background = problem.index.fluxes[stars[0]], problem.index.backgrounds
    columns = {name: getattr(data, name) for name in ("time", "cadenceno", "quality", "pos_corr")}
    columns |= own | {
        "flux_scatter": np.sqrt(np.maximum(errors.relative[:, column, column], 0.0)),
        "background": problem.backgrounds(state, number),
        "background_err": _deviation(errors, background[number]) if background else 0 * data.time,
        "focus": 1 + problem.focus(state),
    }
    return {
        "model": model, "cadences": columns,
        "neighbors": tuple(FittedStar(**values) for values in others), "observed": observed,
        "observed_err": data.flux_err, "fitted": modeled,
        "squares": ((observed - modeled) / data.flux_err) ** 2,
    }  # fmt: skip


def _of_star(problem, state, errors, star):
    """Position and flux of a star, and their errors, by name."""
    n, k, m = errors.mixed.shape
    by = np.zeros((2, n, k + m))
    for axis, column, derivative in problem.position_terms(state, star):
        by[axis, :, column] = derivative
    own, common = by[..., :k], by[..., k:]
    variances = np.einsum("ani,nij,anj->an", own, errors.cadence, own)
    variances += 2 * np.einsum("ani,nij,anj->an", own, errors.mixed, common)
    variances += np.einsum("ani,ij,anj->an", common, errors.shared, common, optimize=True)
    (x, y), flux = problem.xy(state, star).T.copy(), np.array(problem.fluxes(state, star))
    x_err, y_err = np.sqrt(np.maximum(variances, 0.0))
    flux_err = np.hypot(_deviation(errors, problem.index.fluxes[star]), flux * errors.common[star])
    return {"x": x, "y": y, "flux": flux, "x_err": x_err, "y_err": y_err, "flux_err": flux_err}


def _deviation(errors, column):
    k = errors.cadence.shape[1]
    if column < k:
        return np.sqrt(np.maximum(errors.cadence[:, column, column], 0.0))
    return np.full(len(errors.cadence), max(errors.shared[column - k, column - k], 0.0) ** 0.5)
