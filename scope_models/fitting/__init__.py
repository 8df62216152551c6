"""Fits of the models to target pixel files."""

from scope_models.fitting.fit import fit_tpf
from scope_models.fitting.result import TPFFit

__all__ = ["TPFFit", "fit_tpf"]
