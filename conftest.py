"""Settings for the tests and for the doctests of modules and pages."""

import gc
import os
import re
import sys
import warnings
from pathlib import Path

import pytest

# Where the files are that pages open. A page names them in a comment, ".. needs: FILE FILE". Real
# archive files are beside the checkout.
_FOLDERS = [
    Path(__file__).resolve().parent / "docs" / "examples",
    Path(__file__).resolve().parents[1] / "shared" / "data",
]

os.environ["MPLBACKEND"] = "Agg"
# Pages and tests use the studies, which are scripts.
_STUDIES = Path(__file__).resolve().parent / "studies"
sys.path += [str(_STUDIES), str(_STUDIES / "paper")]


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Share the files of a whole run between all cores, if pytest-xdist is there and not set."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    worker = hasattr(config, "workerinput")
    if whole and not worker and getattr(config.option, "numprocesses", 0) is None:
        config.option.numprocesses, config.option.dist = "auto", "loadfile"


@pytest.hookimpl(trylast=True)
def pytest_collection_finish():
    """Leave all that is imported by now out of each later collection of garbage."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _doctests_leave_no_files(request, tmp_path_factory, monkeypatch):
    """Run each doctest in a temporary folder, and close the files and figures that it leaves open.

    The files that a page needs are in that folder; where one is absent the page is skipped.
    """
    if not isinstance(request.node, pytest.DoctestItem):
        yield
        return
    monkeypatch.chdir(tmp_path_factory.mktemp("doctest"))
    if request.node.path.suffix != ".rst":
        yield
        _close_figures()
        return
    _link_files(request.node.path)
    with warnings.catch_warnings():
        # lightkurve keeps a target pixel file open as long as the object lives
        warnings.filterwarnings("ignore", "unclosed file", ResourceWarning)
        yield
        _close_figures()
        gc.collect()


def _close_figures():
    """Close the figures of pyplot, if it was imported."""
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def _link_files(page):
    """Link the files that a page needs to the working folder, or skip the page."""
    needed = re.search(r"^\.\. needs: (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    for name in needed[1].split() if needed else ():
        found = [path for folder in _FOLDERS for path in folder.rglob(name)]
        if not found:
            pytest.skip(f"the file {name} is absent")
        Path(name).symlink_to(found[0])
