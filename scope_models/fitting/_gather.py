"""The result of a fit from its solution."""

from dataclasses import asdict

import numpy as np

from scope_models._arrays import plain_tree
from scope_models.fitting._parameters import FittedStar, cadence_table, parameter_table
from scope_models.fitting.result import TPFFit

__all__ = ["make_results"]

# Cards that a fit keeps: what the star is, and where the stamp is on detector and sky.
_FACTS = (
    *("OBJECT", "KEPLERID", "TICID", "RA_OBJ", "DEC_OBJ", "KEPMAG", "TESSMAG"),
    *("MISSION", "TELESCOP", "CAMPAIGN", "QUARTER", "SECTOR", "CHANNEL", "CAMERA", "CCD"),
    *("1CRV5P", "2CRV5P", "1CDLT5", "2CDLT5", "12PC5", "22PC5"),
)


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
    shared = errors[0]
    inside, s = data.pixels, problem.n_shared
    fitted = np.full(data.flux.shape, np.nan)
    fitted[:, inside] = model_pixels[:, pixels]
    fitted[~np.isfinite(data.flux)] = np.nan
    interpixel, interpixel_err = np.ones(data.shape), np.full(data.shape, np.nan)
    if problem.n_pixels:
        interpixel[inside] = 1 + state.interpixel[pixels]
        interpixel_err[inside] = np.sqrt(np.maximum(np.diag(shared)[s:][pixels], 0))
    stars = [k for k, star in enumerate(problem.stars) if star.stamp == number]
    by_cadence = _by_cadence(problem, state, errors, stars[0])
    neighbors = tuple(FittedStar(**_of_star(problem, state, errors, k)) for k in stars[1:])
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
    at_bounds = np.array(problem.names)[
        (state.shared <= limits.lower) | (state.shared >= limits.upper)
    ].tolist()
    statistics = {
        "chi2": float(np.nansum(squares)),
        "n_data": n_data,
        "n_parameters": round(n_parameters),
        "error_scale": problem.misfit,
        "converged": solution.converged and not at_bounds,
        "n_steps": solution.n_steps,
        "chi2_held_out": np.nan,
    }
    columns = {name: getattr(data, name) for name in ("time", "cadenceno", "quality", "pos_corr")}
    return TPFFit(
        model=model,
        parameters=parameter_table(
            model, problem.parameters, state.shared, covariance, at_bounds, statistics,
            response=False,
        ),
        covariance=covariance,
        cadences=cadence_table(columns | by_cadence | {"focus": 1 + problem.focus(state)}),
        neighbors=neighbors,
        interpixel=interpixel,
        interpixel_err=interpixel_err,
        observed=data.flux,
        observed_err=data.flux_err,
        fitted=fitted,
        statistics=statistics,
        time_format=data.time_format,
        detector=detector,
        options=asdict(problem.options),
        meta=plain_tree({k: v for k in _FACTS if (v := series.header.get(k)) is not None}, str),
    )  # fmt: skip


def _of_star(problem, state, errors, star):
    """Position and flux of a star, and their errors, by name."""
    shared, cadence, _, mixed = errors
    n, k, m = mixed.shape
    by_cadence, by_shared = np.zeros((2, n, k)), np.zeros((2, n, m))
    for axis, of_cadence, i, derivative in problem.position_terms(state, star):
        (by_cadence if of_cadence else by_shared)[axis, :, i] = derivative
    variances = np.einsum("ani,nij,anj->an", by_cadence, cadence, by_cadence)
    variances += 2 * np.einsum("ani,nij,anj->an", by_cadence, mixed, by_shared)
    variances += np.einsum("ani,ij,anj->an", by_shared, shared, by_shared, optimize=True)
    result = problem.path_of(state, star) | {
        f"{axis}_err": variances[i] for i, axis in enumerate("xy")
    }
    column, constant = problem.index.fluxes[star], problem.stars[star].constant
    result["flux_err"] = _variance(shared, cadence, column, shared_by_all=constant)
    return _with_errors(result)


def _variance(shared, cadence, column, *, shared_by_all):
    """Variance of a column of the cadences, or of a shared parameter, in each cadence."""
    if shared_by_all:
        return np.full(len(cadence), shared[column, column])
    return cadence[:, column, column]


def _with_errors(values):
    """Arrays by name, with standard deviations for variances."""
    return {
        name: np.sqrt(np.maximum(value, 0.0)) if name.endswith("_err") else np.array(value)
        for name, value in values.items()
    }


def _by_cadence(problem, state, errors, star):
    """Values and errors of each cadence by name."""
    shared, cadence, relative, _ = errors
    result = _of_star(problem, state, errors, star)
    i = problem.index.fluxes[star]
    result["flux_scatter"] = np.sqrt(np.maximum(relative[:, i, i], 0))
    stamp = problem.stars[star].stamp
    background = {"background": problem.backgrounds(state, stamp)}
    background["background_err"] = np.zeros(len(cadence))
    if problem.index.backgrounds:
        column, constant = (
            problem.index.backgrounds[stamp],
            problem.options.background == "constant",
        )
        background["background_err"] = _variance(shared, cadence, column, shared_by_all=constant)
    return result | _with_errors(background)
