"""Settings for the tests and for the doctests of modules and pages."""

import gc
import os
import warnings

import pytest

os.environ["MPLBACKEND"] = "Agg"
# Many small matrices: threads of the linear algebra library only get in each other's way.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(autouse=True)
def _doctests_leave_no_files(request, tmp_path_factory, monkeypatch):
    """Run each doctest in a temporary folder, and close the files that pages leave open."""
    if not isinstance(request.node, pytest.DoctestItem):
        yield
        return
    monkeypatch.chdir(tmp_path_factory.mktemp("doctest"))
    if request.node.path.suffix != ".rst":
        yield
        return
    with warnings.catch_warnings():
        # lightkurve keeps a target pixel file open as long as the object lives
        warnings.filterwarnings("ignore", "unclosed file", ResourceWarning)
        yield
        gc.collect()
