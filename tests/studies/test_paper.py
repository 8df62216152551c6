"""Each study of the paper runs with two stars; arithmetic and stored tables of those of effects."""

import csv
import importlib
import os
import re
import runpy
import shlex
import subprocess
import sys
from dataclasses import asdict
from functools import partial
from types import SimpleNamespace

import _study
import numpy as np
import pytest
from _correctors import METHODS, SURVIVALS, corrected_noise
from _study import grid, largest
from astropy.table import Table
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from matplotlib.image import imread

from scope_models import Detector, Motion, Star, simulate
from scope_models._arrays import plain_tree

#: Arguments of two stars, and a column that must be positive; test_recovery.py runs its study.
SMALL = {
    "table1": ("--scales 1 5 --cadences 100", "maximum"),
    "no_motion": ("--magnitudes 12 14 --stars 1 --cadences 100", "cdpp"),
    "k2_motion": ("--magnitudes 12 --stars 1 --cadences 100", "cdpp"),
    "motion": (
        "--magnitudes 12 --scales 1 5 --stars 1 --cadences 150 --no-lightkurve-sff", "pld_everest",
    ),
    "tess": ("--magnitudes 9 13 --neighbors 0 --cadences 120", "pld"),
    "breathing": ("--amplitudes 0.01 --periods 1 4 --cadences 120", "pld"),
    "ground": ("--flats 0.002 0.01 --drifts 0.03 --stars 1 --cadences 60", "floor"),
    "last_campaigns": ("--magnitudes 12 14 --parts", "kept"),
}  # fmt: skip
#: The paper's row of 1x motion in pixels: EPIC 205998445, campaign 3, 1000 cadences.
PAPER_PIXELS = {"mean": 0.17, "std": 0.12, "maximum": 0.59}
STORED = ("tess", "breathing", "last_campaigns")


@pytest.fixture(autouse=True)
def _close(monkeypatch):
    small = partial(Figure.savefig, dpi=30)  # fewer pixels take less time
    monkeypatch.setattr("scope_models.plotting._style.save_figure", small)
    yield
    plt.close("all")


@pytest.mark.parametrize("name", SMALL)
def test_two_stars(name, tmp_path, capsys):
    arguments, column = SMALL[name]
    arguments = arguments.split()
    if name == "last_campaigns":
        arguments.append("C19 nominal")
    study = importlib.import_module(name)
    result = study.main([*arguments, "--directory", str(tmp_path / "run")])
    assert len(result.table) == 2
    assert np.all(np.asarray(result.table[column]) > 0)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{study.main.args[0]}: 2 stars, 0 failed"
    names = ["results.ecsv", "summary.ecsv", "figure.png"]
    if name == "table1":
        del names[1:]
        # The same call goes on from what is there.
        assert study.main([*arguments, "--directory", str(tmp_path / "run")]).n_computed == 0
    else:
        assert 1 <= len(result.summary) <= 2
        assert imread(result.files[2]).std() > 0
    assert [path.name for path in result.files] == names


@pytest.mark.slow
def test_workers(repository, tmp_path):
    """Functions of the script reach the workers, and the tables are the same."""
    paths = [str(tmp_path / name) for name in ("one", "two")]
    for path, workers in zip(paths, "12", strict=True):
        subprocess.run(
            [sys.executable, repository / "studies" / "paper" / "no_motion.py", "--workers",
             workers, "--directory", path, "--magnitudes", "12", "--stars", "2"],
            check=True, env=os.environ | {"PYTHONPATH": str(repository)},
        )  # fmt: skip
    one, two = ((tmp_path / name / "results.ecsv").read_bytes() for name in ("one", "two"))
    assert one == two


def test_commands_of_the_pages(repository, monkeypatch, tmp_path):
    """Each study is on a page, with arguments that it takes."""

    def accepted(*_, **__):
        raise StopIteration("the arguments are accepted")

    monkeypatch.setattr(_study, "run_sweep", accepted)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "FILE").touch()
    pages = [*repository.glob("docs/**/*.rst"), *repository.glob("docs/data/*.ecsv")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    commands = re.findall(r"python studies/paper/(\w+)\.py((?: [^\n`}]*\\\n|[^\n`}])*)", text)
    assert {*SMALL, "recovery"} <= {name for name, _ in commands}
    for name, arguments in commands:
        study = importlib.import_module(name)
        if isinstance(study.main, partial):
            with pytest.raises(StopIteration, match="the arguments are accepted"):
                study.main(shlex.split(arguments.replace("\\\n", " ")))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scales", "many"], "argument --scales: invalid float value: 'many'"),
        (["--scale"], "argument --scales"),
        (["--workers", "0"], "--workers must be at least 1, got 0"),
        (["--config", "absent.toml"], "No such file or directory: 'absent.toml'"),
        (["--scales"], "`tasks` must hold at least one star"),
        (["--motions", "absent.fits"], "all 4 stars failed, the first one with FileNotFoundError"),
    ],
)
@pytest.mark.filterwarnings("ignore::scope_models.exceptions.FailedStarsWarning")
def test_errors_name_the_argument(arguments, message, tmp_path, capsys):
    table1 = importlib.import_module("table1")
    if arguments == ["--scale"]:
        arguments = ["--scale", "x"]
    with pytest.raises(SystemExit):
        table1.main([*arguments, "--directory", str(tmp_path)])
    assert message in capsys.readouterr().err


def test_another_configuration_is_refused(tmp_path, capsys):
    table1 = importlib.import_module("table1")
    table1.main(["--scales", "1", "--directory", str(tmp_path)])
    with pytest.raises(SystemExit):
        table1.main(["--scales", "1", "--cadences", "50", "--directory", str(tmp_path)])
    assert "differs in `cadences` (1000 there, 50 here)" in capsys.readouterr().err


def test_tasks_are_the_cells_of_the_grid():
    study = SimpleNamespace(stars=2, magnitudes=(12, 13.5), kinds=("B",))
    tasks = grid("kp{mag:g}-{kind}-{index}", index="stars", mag="magnitudes", kind="kinds")(study)
    assert [task["key"] for task in tasks] == [
        "kp12-b-0", "kp13.5-b-0", "kp12-b-1", "kp13.5-b-1",
    ]  # fmt: skip
    assert list(tasks[1]) == ["key", "mag", "kind", "index"]


def test_claims_are_the_largest_ratio_to_a_limit():
    assert largest({"a": [0.5, 1.0], "b": 1.1, "c": []})["claims"] == {"a": 1.0, "b": 1.1, "c": 0}
    assert np.isnan(largest({"a": [0.2, np.nan]})["claims"]["a"])


def test_generator_agrees_with_the_papers_table():
    table1 = importlib.import_module("table1")
    study = table1.Table1(scales=(1.0,))
    (task,) = table1.tasks(study)
    row = table1.measure(study, task)
    for name, paper in PAPER_PIXELS.items():
        assert row[name] == pytest.approx(paper, rel=0.05)


def test_the_papers_star(shared_data):
    table1 = importlib.import_module("table1")
    path = str(shared_data / "poscorr" / "epic205998445_c03_poscorr.fits")
    study = table1.Table1(motions=(path,), scales=(1.0,))
    row = table1.measure(study, table1.tasks(study)[0])
    for name, paper in PAPER_PIXELS.items():
        assert row[name] == pytest.approx(paper, rel=0.05)


def test_noise_model_of_tess():
    # The parts one by one, for T = 10 and 20 pixels in 4 h.
    tess_noise = importlib.import_module("tess").tess_noise
    flux, seconds = 10 ** (0.4 * (20.44 - 10)), 4 * 3600 * 0.8 * 0.99
    star, sky, read = flux * seconds, 20 * 134 * seconds, 20 * 100 * seconds / 1.98
    noise = 1e6 * np.sqrt(star + sky + read) / (flux * seconds)
    assert tess_noise(10.0, 20, 4.0) == pytest.approx(np.hypot(noise, 60 / 2), rel=1e-12)
    assert tess_noise(2.0, 500, floor=0.0) < 5


@pytest.mark.slow
def test_noise_of_a_star_at_rest_is_its_floor():
    detector = Detector.k2(shape=(7, 7)).without_sensitivity()
    observation = simulate(Star(12.0), detector, Motion.still(300), seed=1)
    row = corrected_noise(observation, 6.5)
    for end in ("", "_full"):
        assert row[f"aperture{end}"] == pytest.approx(row[f"floor{end}"], rel=1e-3)
        assert row[f"wide{end}"] == pytest.approx(row[f"floor_wide{end}"], rel=1e-3)
        assert row[f"pld{end}"] == pytest.approx(row[f"floor{end}"], rel=0.3)
    expected = observation.flux_err[:, observation.aperture].astype(float) ** 2
    expected = 1e6 * np.sqrt(expected.sum(axis=1).mean() / 13)
    target = observation.model()[0, observation.aperture].sum()
    assert row["floor_full"] == pytest.approx(expected / target, rel=4 / np.sqrt(2 * 23))
    assert (row["share"], row["kept"]) == (1.0, 1.0)
    for name in SURVIVALS:
        assert row[name] == pytest.approx(1, abs=0.1)


def made_up(name, **columns):
    """Return a study with results in which every noise is 1 ppm but for those that are given."""
    study = importlib.import_module(name)
    parameters = {
        "tess": {"magnitudes": (9.0, 13.0), "stars": 2},
        "ground": {"stars": 2},
        "last_campaigns": {"magnitudes": (12.0, 14.0)},
    }.get(name, {})
    kind = {
        "tess": "TESSNoise", "breathing": "BreathingPSF", "last_campaigns": "LastCampaigns",
        "ground": "GroundPLD",
    }[name]  # fmt: skip
    own = getattr(study, kind)(**parameters)
    rows = []
    for task in study.tasks(own):
        values = dict.fromkeys(study.UNITS, 1.0) | {"pixels": 9, "share": 1.0, "kept": 0.5}
        values |= dict.fromkeys((*SURVIVALS, *getattr(study, "SURVIVALS", ())), 1.0)
        values["seen"] = 0.0 if task.get("part") == "C19 off target" else 1.0
        rows.append(task | values | columns)
    table = Table(rows)
    return table, study.summarize(own, table), partial(study.draw, own)


def test_tess_beside_the_noise_model():
    table, summary, draw = made_up("tess")
    assert summary["stars"].tolist() == [2] * 4
    assert summary["neighbors"].tolist() == [0, 0, 10, 10]
    tess_noise = importlib.import_module("tess").tess_noise
    np.testing.assert_allclose(summary["model"][:2], tess_noise([9, 13], [9, 9]))
    assert max(summary.meta["claims"].values()) <= 1
    noisy = made_up("tess", pld=2.0)[1]
    assert sum(value > 1 for value in noisy.meta["claims"].values()) == 1
    assert [ax.get_title() for ax in draw(table, summary).axes] == ["0 neighbors", "10 neighbors"]


def test_maps_of_breathing():
    table, summary, draw = made_up("breathing", aperture_full=6.0, wide_full=2.5)
    assert len(summary) == 16
    assert np.all(summary["aperture_ratio"] == 6)
    assert max(summary.meta["claims"].values()) <= 1
    assert [ax.get_title() for ax in draw(table, summary).axes[:3]] == list(METHODS.values())


def test_parts_of_the_last_campaigns():
    table, summary, draw = made_up("last_campaigns")
    assert len(summary) == 8
    assert max(summary.meta["claims"].values()) <= 1
    part = summary["mission"][(summary["part"] == "C18") & (summary["mag"] == 12)]
    assert part.tolist() == [83.8]
    parts = importlib.import_module("last_campaigns").PARTS
    assert [ax.get_title() for ax in draw(table, summary).axes] == list(parts)


def test_ratios_of_ground():
    noise = {"raw": 2e4, "raw_pld": 2e4, "differential": 600.0, "differential_pld": 300.0}
    _, summary, draw = made_up("ground", **noise)
    np.testing.assert_allclose(summary["ratio"], 0.5)
    methods = importlib.import_module("ground").METHODS
    titles = [ax.get_title() for ax in draw(None, summary).axes[: len(methods)]]
    assert titles == list(methods.values())


@pytest.mark.parametrize("name", STORED)
def test_tables_of_the_page(name, repository, monkeypatch):
    folder = repository / "docs" / "data"
    monkeypatch.syspath_prepend(folder)
    stored = runpy.run_path(str(folder / "store_skies.py"))
    study = importlib.import_module(name)
    summary = Table.read(folder / f"{study.main.args[0]}.ecsv")
    kind = {"tess": "TESSNoise", "breathing": "BreathingPSF", "last_campaigns": "LastCampaigns"}
    own = getattr(study, kind[name])()
    config = plain_tree(asdict(own))
    assert {key: summary.meta[key] for key in config} == config
    study.draw(own, None, summary)
    for part, rows in stored["tables"](study.main.args[0], summary).items():
        with (folder / f"{study.main.args[0]}_{part}.csv").open(encoding="utf-8") as file:
            assert list(csv.reader(file)) == rows
