"""Module paths, names and arguments of the first version."""

import importlib
import inspect
import warnings
from pathlib import Path

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


NAMES = Path(__file__).parent / "values" / "names_0_1.txt"
# What was replaced, so that a call by the first version's arguments has no meaning.
MADE_BY_THE_PACKAGE = {"Observation", "PLDResult", "TPFTruth", "Truth"}


def look_up(path, names):
    """Return what a dotted name of a module is; fields of dataclasses are None."""
    value = importlib.import_module(path)
    for name in names.split("."):
        if name in getattr(value, "__dataclass_fields__", {}) and not hasattr(value, name):
            return None
        value = getattr(value, name)
    return value


def test_names_and_arguments_of_the_first_version():
    """Each line of the record is a module, a name of it, and the arguments."""
    lost = []
    for line in NAMES.read_text(encoding="utf-8").splitlines():
        path, name, *arguments = line.split()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AstropyDeprecationWarning)
            value = look_up(path, name)
        if not arguments or value is None or name in MADE_BY_THE_PACKAGE:
            continue
        known = inspect.signature(value).parameters
        if all(parameter.kind is not parameter.VAR_KEYWORD for parameter in known.values()):
            lost += [f"{path}.{name}: {item}" for item in arguments if item not in known]
    # `run_sweep` renames two with a warning, which its decorator does behind the signature.
    assert sorted({entry.partition(".run_sweep: ")[2] for entry in lost}) == ["config", "executor"]
