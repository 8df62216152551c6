"""The shared parameters of a fit as numbers: bounds, largest steps, priors."""

from dataclasses import dataclass

import numpy as np

from scope_models._values import Value
from scope_models.models._parameters import numbers_of

__all__ = ["FitParameter", "fit_parameters"]

# Narrower PSFs are the same to a pixel.
_LEAST_WIDTH = 0.1
# Tighter correlations only cost time; charge that diffuses farther is not collected in pixels.
_LIMITS = {"correlation": (-0.95, 0.95), "diffusion": (0.0, 1.0), "offset": (-2.0, 2.0)}
# Standard deviations of the coefficients of an empirical term, whose first one is 1, and of the
# correction of a table.
_PRIORS = {"coefficient": 10.0, "correction": 0.1}
_LARGEST_MOVE = 0.3
_UNITS = {"width": "pix", "diffusion": "pix", "offset": "pix", "position": "pix", "flux": "e-/s"}


@dataclass(frozen=True)
class FitParameter(Value):
    """
    A parameter that all cadences share.

    Parameters
    ----------
    name : str
        Its name.
    kind : str
        "width", "correlation", "coefficient", "fraction", "offset", "response", "diffusion" and
        "correction" as in `~scope_models.PRF.parameter_kinds`; "position", "slope", "flux" and
        "focus"; or "other".
    lower, upper : float, optional
        Bounds.
    largest_step : float, optional
        How far it may move in one step.
    relative : bool, optional
        Whether that is a part of its value.
    prior : float, optional
        Standard deviation before the fit.
    center : float, optional
        Mean before the fit.
    start : float, optional
        Starting value.

    Examples
    --------
    >>> from scope_models.fitting.parameters import FitParameter
    >>> FitParameter("sigma_x", "width", lower=0.1, start=0.5).unit
    'pix'
    """

    name: str
    kind: str = "other"
    lower: float = -np.inf
    upper: float = np.inf
    largest_step: float = np.inf
    relative: bool = False
    prior: float = np.inf
    center: float = 0.0
    start: float = 0.0

    @property
    def unit(self):
        """Unit (str)."""
        return _UNITS.get(self.kind, "")


def fit_parameters(prf, shape):
    """
    Return the free shared parameters of a PRF.

    Kinds come from the models (`~scope_models.PRF.parameter_kinds`), never from names. Bounds are
    the model's, narrowed by what a kind allows: a component that is wider than half the stamp is
    background, and at a pixel's edge no term of a response takes away all of it or doubles it.

    Parameters
    ----------
    prf : PRF
        The model.
    shape : tuple of int
        Shape (ny, nx) of the image.

    Returns
    -------
    parameters : tuple of FitParameter
        Without flux and position, and without what is fixed.

    Examples
    --------
    >>> from scope_models import PRF, BivariateGaussianPSF
    >>> from scope_models.fitting.parameters import fit_parameters
    >>> [p.name for p in fit_parameters(PRF(BivariateGaussianPSF()), (7, 7))]
    ['sigma_x', 'sigma_y', 'rho']
    """
    kinds, powers = prf.parameter_kinds, prf.response_powers
    result, start = [], numbers_of(prf)
    for name in prf.param_names[3:]:
        parameter = getattr(prf, name)
        if parameter.fixed:
            continue
        kind, step, relative = kinds.get(name, "other"), np.inf, False
        prior = _PRIORS.get(kind, np.inf)
        narrow = _LIMITS.get(kind, (-np.inf, np.inf))
        if kind == "width":
            narrow = _LEAST_WIDTH, max(shape) / 2
        elif kind == "response":
            narrow = -(2.0 ** powers[name][1]), 2.0 ** powers[name][1]
        low, high = (
            x if bound is None else bound for x, bound in zip(narrow, parameter.bounds, strict=True)
        )
        low, high = max(low, narrow[0]), min(high, narrow[1])
        if kind in {"correlation", "fraction", "offset", "diffusion"}:
            step = _LARGEST_MOVE
        elif kind == "width" or (kind == "other" and low > 0):
            step, relative = _LARGEST_MOVE, True
        result.append(FitParameter(name, kind, low, high, step, relative, prior, start=start[name]))
    return tuple(result)
