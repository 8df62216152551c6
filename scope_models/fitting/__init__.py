"""Fits of the models to target pixel files."""

from scope_models.fitting._problem import FitOptions
from scope_models.fitting._products import FittedStar
from scope_models.fitting.fit import fit_tpf
from scope_models.fitting.result import TPFFit

__all__ = ["FitOptions", "FittedStar", "TPFFit", "fit_tpf"]
