"""The studies of the paper, and what runs a study star by star, on one machine or many.

A study (`~scope_models.experiments.study.Study`) is a configuration with its stars. `STUDIES`
has all of them by name, `make_study` and `read_config` fill one, `run_experiment` runs it and
writes tables and a figure, and `run_sweep` is the part of it that computes the stars.
"""

import importlib
from collections.abc import Mapping

import lazy_loader

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

# Public names and studies are imported at first use, as in the package itself.
__getattr__, _, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "config": ["make_study", "read_config"],
        "experiment": ["ExperimentResult", "run_experiment"],
        "study": ["Study"],
        "sweep": ["SweepError", "SweepResult", "run_sweep"],
    },
)
# A new study is a line of this table.
_STUDIES = {
    "table1": ("scope_models.experiments.table1", "Table1"),
    "no-motion": ("scope_models.experiments.no_motion", "NoMotion"),
    "k2-motion": ("scope_models.experiments.k2_motion", "K2MotionNoise"),
    "motion": ("scope_models.experiments.motion", "MotionTest"),
    "recovery": ("scope_models.experiments.recovery", "Recovery"),
    "tess": ("scope_models.experiments.tess", "TESSNoise"),
    "breathing": ("scope_models.experiments.breathing", "BreathingPSF"),
    "ground": ("scope_models.experiments.ground", "GroundPLD"),
    "last-campaigns": ("scope_models.experiments.last_campaigns", "LastCampaigns"),
}


class _Studies(Mapping):
    """The classes of the studies by name; a class is imported at its first use."""

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


def __dir__():
    """Return the public names, imported or not."""
    return __all__
