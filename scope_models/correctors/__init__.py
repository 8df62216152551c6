# Licensed under a 3-clause BSD style license - see LICENSE
"""Correctors of light curves."""

from scope_models.correctors._files import detrend_file
from scope_models.correctors._model import PLDOptions
from scope_models.correctors._result import PLDFit
from scope_models.correctors.compare import ComparisonResult, compare_correctors
from scope_models.correctors.pld import PLDCorrector

__all__ = [
    "ComparisonResult",
    "PLDCorrector",
    "PLDFit",
    "PLDOptions",
    "compare_correctors",
    "detrend_file",
]
