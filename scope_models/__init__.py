# Licensed under a 3-clause BSD style license - see LICENSE
"""Forward models of moving stars on space-telescope pixels, and de-trending with them."""

import importlib

from scope_models._version import __version__

# Where each public name lives. They are imported at first use, because astropy.modeling and what
# builds on it take longer to import than a command line should take to answer.
_SOURCES = {
    "BivariateGaussianPSF": "scope_models.models",
    "Detector": "scope_models.detector",
    "Motion": "scope_models.motion",
    "Observation": "scope_models.observation",
    "PRF": "scope_models.models",
    "Scene": "scope_models.scene",
    "SensitivityPolynomial": "scope_models.models",
    "Star": "scope_models.star",
    "TPFFit": "scope_models.fitting",
    "Target": "scope_models.target",
    "TransitModel": "scope_models.models",
    "fit_tpf": "scope_models.fitting",
    "generate_target": "scope_models.target",
    "integrate_pixels": "scope_models.models",
    "read_detector": "scope_models.scene",
    "read_scene": "scope_models.scene",
    "read_truth": "scope_models.io",
    "simulate": "scope_models.simulation",
}

__all__ = [
    "PRF",
    "BivariateGaussianPSF",
    "Detector",
    "Motion",
    "Observation",
    "Scene",
    "SensitivityPolynomial",
    "Star",
    "TPFFit",
    "Target",
    "TransitModel",
    "__version__",
    "fit_tpf",
    "generate_target",
    "integrate_pixels",
    "read_detector",
    "read_scene",
    "read_truth",
    "simulate",
]


def __getattr__(name):
    """Import a public name at its first use."""
    if name not in _SOURCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_SOURCES[name]), name)
    return value


def __dir__():
    """Names of the package, imported or not."""
    return sorted({*globals(), *_SOURCES})
