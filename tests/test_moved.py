"""Module paths of the first version."""

import importlib

import pytest
from astropy.utils.exceptions import AstropyDeprecationWarning

MOVED = {
    "scope_models.detector": ("Detector", "ZERO_POINTS"),
    "scope_models.motion": ("K2Roll", "Motion", "MotionStatistics"),
    "scope_models.noise": ("poisson_counts", "stream"),
    "scope_models.observation": ("Observation", "Truth"),
    "scope_models.saturation": ("bleed",),
    "scope_models.star": ("Star",),
    "scope_models.target": ("Target", "generate_target"),
}


@pytest.mark.parametrize(
    ("path", "name"), [(path, name) for path, names in MOVED.items() for name in names]
)
def test_old_path_returns_the_same_object(path, name):
    module = importlib.import_module(path)
    with pytest.warns(AstropyDeprecationWarning, match="has moved to"):
        value = getattr(module, name)
    successor = importlib.import_module(value.__module__) if hasattr(value, "__module__") else None
    assert successor is None or getattr(successor, name) is value


def test_unknown_name_of_an_old_path():
    module = importlib.import_module("scope_models.star")
    with pytest.raises(AttributeError, match="no attribute 'Planet'"):
        _ = module.Planet


def test_renamed():
    module = importlib.import_module("scope_models.io")
    with pytest.warns(AstropyDeprecationWarning, match="TPFTruth is now scope_models.io.Truth"):
        assert module.TPFTruth is module.Truth
    with pytest.raises(AttributeError, match="no attribute 'Falsehood'"):
        _ = module.Falsehood
