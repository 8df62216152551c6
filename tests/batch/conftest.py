"""Fixtures of the tests of sweeps."""

import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure

# Worker processes import the stars of the tests by this name.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def empty_figures(monkeypatch):
    """Leave the figure of a run of corrections empty: to draw it takes as long as two stars."""
    monkeypatch.setattr("scope_models.batch.detrend._noise_figure", lambda *_: Figure())
