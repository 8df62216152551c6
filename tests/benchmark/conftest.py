"""The study that records scores, for tests of its functions."""

import runpy

import pytest


@pytest.fixture(scope="module")
def script(repository):
    return repository / "studies" / "record.py"


@pytest.fixture(scope="module")
def study(script):
    return runpy.run_path(str(script), run_name="record")
