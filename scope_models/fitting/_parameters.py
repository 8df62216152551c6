"""The parameters of a fit: bounds, steps, priors; tables of the shared ones and of the cadences."""

from dataclasses import dataclass

import numpy as np
from astropy.table import Table

from scope_models._values import Value
from scope_models.models.integration import numbers_of

__all__ = [
    "CADENCE_UNITS", "STATISTICS", "FitParameter", "FittedStar", "cadence_table",
    "degrees_of_freedom", "fit_parameters", "parameter_table",
]  # fmt: skip

# Narrower PSFs are the same to a pixel. Tighter correlations only cost time; charge that diffuses
# farther is not collected in pixels.
_LEAST_WIDTH = 0.1
_LIMITS = {"correlation": (-0.95, 0.95), "diffusion": (0.0, 1.0), "offset": (-2.0, 2.0)}
# Standard deviations of the coefficients of an empirical term, whose first one is 1, and of the
# correction of a table.
_PRIORS = {"coefficient": 10.0, "correction": 0.1}
_LARGEST_MOVE = 0.3
_UNITS = {"width": "pix", "diffusion": "pix", "offset": "pix", "position": "pix", "flux": "e-/s"}
_RATES = ("flux", "flux_err", "flux_scatter", "background", "background_err")
# Columns of `TPFFit.cadences`, and their units.
CADENCE_UNITS = {
    "time": "d",
    **dict.fromkeys(("cadenceno", "quality", "focus", "held_out", "outliers"), ""),
    **dict.fromkeys(("x", "x_err", "y", "y_err", "pos_corr"), "pixel"),
    **dict.fromkeys(_RATES, "electron / s"),
}
# Entries of `TPFFit.statistics`.
STATISTICS = ("chi2", "n_data", "n_parameters", "error_scale", "converged", "n_steps")
STATISTICS += ("chi2_held_out",)
# Chi-squared per degree of freedom above which coefficients of a sensitivity are not measured: they
# describe errors of the PSF long before these are seen in chi-squared.
_TRUE_CHI2 = 1.1


@dataclass(frozen=True)
class FitParameter(Value):
    """A parameter that all cadences share."""

    name: str
    kind: str = "other"  # as in `PRF.parameter_kinds`, or position, slope, flux, focus
    lower: float = -np.inf
    upper: float = np.inf
    largest_step: float = np.inf
    relative: bool = False  # whether that is a part of its value
    prior: float = np.inf  # standard deviation before the fit
    center: float = 0.0  # ... and mean
    start: float = 0.0


def fit_parameters(prf, shape):
    """Return the free shared parameters of a PRF on an image, without flux and position.

    Bounds are the model's, narrowed by their kinds: a component wider than half the stamp is
    background, and no term of a response takes away all of it at a pixel's edge, or doubles it.
    """
    powers, numbers, result = prf.response_powers, numbers_of(prf), []
    for name in prf.param_names[3:]:
        parameter, kind = getattr(prf, name), prf.parameter_kinds.get(name, "other")
        if parameter.fixed:
            continue
        narrow = _LIMITS.get(kind, (-np.inf, np.inf))
        if kind == "width":
            narrow = _LEAST_WIDTH, max(shape) / 2
        elif kind == "response":
            narrow = -(2.0 ** powers[name][1]), 2.0 ** powers[name][1]
        low, high = parameter.bounds
        low = narrow[0] if low is None else max(low, narrow[0])
        high = narrow[1] if high is None else min(high, narrow[1])
        relative = kind == "width" or (kind == "other" and low > 0)
        moves = relative or kind in {"correlation", "fraction", "offset", "diffusion"}
        step, prior = _LARGEST_MOVE if moves else np.inf, _PRIORS.get(kind, np.inf)
        given = low, high, step, relative, prior
        result.append(FitParameter(name, kind, *given, start=numbers[name]))
    return tuple(result)


@dataclass(frozen=True, eq=False, repr=False)
class FittedStar(Value):
    """Another star in a fit.

    Parameters
    ----------
    x, y, flux : ndarray of shape (n,)
        Position in pixels and flux in e-/s, by cadence.
    x_err, y_err, flux_err : ndarray of shape (n,)
        Their errors.

    Examples
    --------
    >>> import numpy as np
    >>> from scope_models.fitting import FittedStar
    >>> star = FittedStar(*np.ones((6, 5)))
    >>> star.flux.shape
    (5,)
    """

    x: np.ndarray
    y: np.ndarray
    flux: np.ndarray
    x_err: np.ndarray
    y_err: np.ndarray
    flux_err: np.ndarray

    def __post_init__(self):
        for value in vars(self).values():
            value.flags.writeable = False


def parameter_table(model, parameters, values, covariance, at_bounds, statistics, *, response):
    """The shared parameters, the free ones first, as `TPFFit.parameters` describes them."""
    unknown, reduced = set(at_bounds), statistics["chi2"] / degrees_of_freedom(statistics)
    if response or statistics["error_scale"] > 1 or reduced > _TRUE_CHI2:
        unknown |= set(model.response_powers)
    free, kinds, numbers = [p.name for p in parameters], model.parameter_kinds, numbers_of(model)
    rows = [
        (p.name, value, np.nan if p.name in unknown else error, False, p.kind, p.name in at_bounds)
        for p, value, error in zip(parameters, values, np.sqrt(np.diag(covariance)), strict=True)
    ]
    others = [name for name in model.param_names[3:] if name not in free]
    rows += [(n, numbers[n], 0.0, True, kinds.get(n, "other"), False) for n in others]
    rows = [(*row[:3], _UNITS.get(row[4], ""), *row[3:]) for row in rows]
    names = ("name", "value", "error", "unit", "fixed", "kind", "at_bound")
    dtypes = ("U32", float, float, "U8", bool, "U16", bool)
    table = Table(rows=rows or None, names=names, dtype=dtypes)
    table["value"].info.format, table["error"].info.format = ".6g", ".2g"
    return table


def degrees_of_freedom(statistics):
    return max(statistics["n_data"] - statistics["n_parameters"], 1)


def cadence_table(columns):
    """Values by cadence, those that are not None, with the units of `TPFFit.cadences`."""
    names = [name for name in CADENCE_UNITS if columns.get(name) is not None]
    units = {name: CADENCE_UNITS[name] or None for name in names}
    return Table({name: columns[name] for name in names}, units=units)
