"""``scope-models experiment``."""

import pytest
from astropy.table import Table
from matplotlib.image import imread
from sweep_studies import Numbers, Pixels

from scope_models import experiments
from scope_models.cli import main
from scope_models.experiments import STUDIES


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Return a function that runs the command in a folder, and returns status and texts."""
    monkeypatch.chdir(tmp_path)
    for study in (Numbers, Pixels):
        monkeypatch.setitem(experiments._STUDIES, study.name, (study.__module__, study.__name__))

    def run(*arguments):
        try:
            status = main(["experiment", *arguments])
        except SystemExit as end:
            status = end.code
        return status, *capsys.readouterr()

    return run


def test_table1(run):
    status, out, err = run("table1", "--set", "scales=[1, 5]", "--set", "motions=['k2_roll']")
    assert (status, err) == (0, "")
    files = [f"table1/{name}" for name in ("results.ecsv", "summary.ecsv", "figure.png")]
    assert out.splitlines() == ["table1: 2 stars, 0 failed", *files]
    assert Table.read("table1/results.ecsv")["scale"].tolist() == [1.0, 5.0]
    assert len(Table.read("table1/summary.ecsv")) == 2
    assert imread("table1/figure.png").std() > 0


def test_file_directory_and_workers(run, tmp_path):
    (tmp_path / "study.toml").write_text('study = "numbers"\nstars = 3\n')
    arguments = ["--config", "study.toml", "--directory", "a/b"]
    status, out, _ = run(*arguments, "--workers", "2")
    assert status == 0
    assert out.splitlines()[0] == "numbers: 3 stars, 0 failed"
    assert len(Table.read("a/b/results.ecsv")) == 3
    status, out, err = run(*arguments, "--set", "stars=4")
    assert (status, out) == (2, "")
    assert "differs in `stars` (3 there, 4 here)" in err


@pytest.mark.filterwarnings("always::scope_models.exceptions.FailedStarsWarning")
def test_failures_are_told_and_found(run, tmp_path):
    arguments = ["numbers", "--set", "failing=[2]", "--set", f"curable={tmp_path / 'cure'}"]
    warning = "scope-models: warning: 1 stars failed, the first one, star2, with ZeroDivisionError"
    status, out, err = run(*arguments)
    assert status == 0
    assert out.splitlines()[0] == "numbers: 7 stars, 1 failed"
    assert out.splitlines()[-1] == "numbers/failures.ecsv"
    assert err.startswith(warning)
    (tmp_path / "cure").touch()
    status, out, err = run(*arguments, "--keep-failures")
    assert err.startswith(warning)
    status, out, _ = run(*arguments)
    assert out.splitlines()[0] == "numbers: 8 stars, 0 failed"


def test_pixels(run, tmp_path):
    status, _, err = run("pixels", "--write-tpfs", "--set", "stars=1")
    assert (status, err) == (0, "")
    assert len(list(tmp_path.glob("pixels/tpfs/*/star0.fits"))) == 1


def test_list(run):
    status, out, err = run("--list")
    assert (status, err) == (0, "")
    for name in STUDIES:
        assert f"{name}: " in out
    assert "    scales = [1.0, 2.0, 5.0, 10.0]\n" in out
    assert '    motions = ["k2_roll"]\n' in out
    assert "    unpicklable = false\n" in out


@pytest.mark.parametrize(
    "arguments, message",
    [
        ([], "name a study ("),
        (["table2"], "there is no study 'table2'; the studies are "),
        (["table1", "--set", "scale=1"], "has no field `scale`; its fields are seed, motions, sca"),
        (["table1", "--set", "scales"], "--set needs FIELD=VALUE, got 'scales'"),
        (["table1", "--set", "=3"], "--set needs FIELD=VALUE, got '=3'"),
        (["table1", "--set", "scales=1"], "`scales` must be a list, got 1"),
        (["table1", "--set", "scales=[]"], "the study `table1` has no stars"),
        (
            ["table1", "--set", "motions=['absent.fits']"],
            "all 4 stars failed, the first one with F",
        ),
        (["table1", "--workers", "0"], "--workers must be at least 1, got 0"),
        (["table1", "--write-tpfs"], "the study `table1` has no pixels that could be written"),
        (["--config", "absent.toml"], "absent.toml: No such file or directory"),
        (["table1", "--directory", "/dev/null"], "cannot write to /dev/null: it is a file"),
        (["numbers", "--set", "stars=0"], "the study `numbers` has no stars"),
    ],
)
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.FailedStarsWarning")
def test_errors_are_one_line(run, arguments, message):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert err.startswith("scope-models: error: ")
    assert message in err
    assert err.count("\n") == 1
