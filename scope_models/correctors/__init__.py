# Licensed under a 3-clause BSD style license - see LICENSE
"""Correctors of light curves."""

from scope_models.correctors._files import detrend_file
from scope_models.correctors._model import PLDOptions
from scope_models.correctors._result import PLDFit
from scope_models.correctors.compare import (
    ComparisonResult,
    choose_corrector,
    compare_correctors,
)
from scope_models.correctors.pld import PLDCorrector
from scope_models.correctors.scene import SceneCorrector, SceneResult

__all__ = [
    "ComparisonResult",
    "PLDCorrector",
    "PLDFit",
    "PLDOptions",
    "SceneCorrector",
    "SceneResult",
    "choose_corrector",
    "compare_correctors",
    "detrend_file",
]
