# Licensed under a 3-clause BSD style license - see LICENSE
"""Correctors of light curves."""

from scope_models.correctors._files import detrend_file
from scope_models.correctors._result import PLDResult
from scope_models.correctors.pld import PLDCorrector

__all__ = ["PLDCorrector", "PLDResult", "detrend_file"]
