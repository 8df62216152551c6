"""The studies of the paper, and what runs a study star by star, on one machine or many.

A study (`~scope_models.experiments.study.Study`) is a configuration that knows its stars. `STUDIES`
has all of them by name, `make_study` and `read_config` fill one, `run_experiment` runs it and
writes tables and a figure, and `run_sweep` is the part of it that computes the stars.
"""

import importlib
from collections.abc import Mapping

__all__ = [
    "STUDIES",
    "ExperimentResult",
    "Study",
    "SweepError",
    "SweepResult",
    "make_study",
    "read_config",
    "run_experiment",
    "run_sweep",
]

# Where each public name lives, and each study: both are imported at first use, as in the package
# itself. A new study is a line of _STUDIES.
_SOURCES = {
    "ExperimentResult": "scope_models.experiments.experiment",
    "Study": "scope_models.experiments.study",
    "SweepError": "scope_models.experiments.sweep",
    "SweepResult": "scope_models.experiments.sweep",
    "make_study": "scope_models.experiments.config",
    "read_config": "scope_models.experiments.config",
    "run_experiment": "scope_models.experiments.experiment",
    "run_sweep": "scope_models.experiments.sweep",
}
_STUDIES = {
    "table1": ("scope_models.experiments.table1", "Table1"),
    "no-motion": ("scope_models.experiments.no_motion", "NoMotion"),
    "k2-motion": ("scope_models.experiments.k2_motion", "K2MotionNoise"),
    "motion": ("scope_models.experiments.motion", "MotionTest"),
    "recovery": ("scope_models.experiments.recovery", "Recovery"),
}


class _Studies(Mapping):
    """The classes of the studies by name; a class is imported when it is asked for."""

    def __getitem__(self, name):
        module, attribute = _STUDIES[name]
        return getattr(importlib.import_module(module), attribute)

    def __iter__(self):
        return iter(_STUDIES)

    def __len__(self):
        return len(_STUDIES)

    def __repr__(self):
        return f"<studies {', '.join(self)}>"


#: The studies by name.
STUDIES = _Studies()


def __getattr__(name):
    """Import a public name at its first use."""
    if name not in _SOURCES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_SOURCES[name]), name)
    return value


def __dir__():
    """Names of the module, imported or not."""
    return sorted({*globals(), *_SOURCES})
