"""The population of K2: what is drawn, and its tables."""

import csv
import os
import subprocess
import sys

import numpy as np
import pytest
from astropy.table import Table
from population import COLUMNS, PIPELINES, main, neighbors, percentiles, spotted, write_tables


def test_neighbors_have_the_density_and_slope():
    rng = np.random.default_rng(1)
    drawn = [neighbors(rng, (60, 40)) for _ in range(400)]
    mags = np.array([star.mag for stars in drawn for star in stars])
    expected = 400 * 4000 * 2400 * (3.98 / 3600) ** 2
    assert mags.size == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert np.mean(mags < 18) == pytest.approx(10 ** (-0.44), abs=4 * 0.5 / np.sqrt(mags.size))


def test_a_third_of_the_stars_has_spots():
    rng, time = np.random.default_rng(2), np.linspace(0, 80, 400)
    curves = [curve(time) for curve, has in (spotted(rng) for _ in range(900)) if has]
    assert len(curves) == pytest.approx(300, abs=4 * np.sqrt(200))
    assert np.median([np.std(c) for c in curves]) == pytest.approx(0.003 / 2**0.5, rel=0.3)


def test_tables_mark_what_does_not_fit(tmp_path):
    rng = np.random.default_rng(3)
    kp = np.repeat(np.arange(11, 18) + 0.5, 400)
    noise = 100 * np.exp(0.5 * rng.standard_normal(kp.size))
    real = Table({"kp": kp, "raw": noise, "campaign": np.full(kp.size, 4)})
    for name in PIPELINES:
        real[name] = 30.0
    factor = np.where(kp < 14, 1.0, 2.0)
    stars = Table({"kp": kp, "raw": factor * noise, "raw_file": noise, "corrected": 0.2 * noise})
    stars["held_out"] = 0.3 * noise
    write_tables(stars, real, tmp_path / "population")
    with (tmp_path / "population_raw.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["at 50 %"][:4] for row in rows] == ["1.00"] * 3 + ["2.00"] * 4
    assert ["(!)" in row["at 50 %"] for row in rows] == [False] * 3 + [True] * 4
    with (tmp_path / "population_corrected.csv").open() as file:
        row = next(csv.DictReader(file))
    assert row["EVEREST 2"] == "30.0"
    median = np.median(noise[kp == 11.5])
    assert row["its held-out windows"].startswith(f"{0.3 * median:.1f} ")
    with (tmp_path / "population_campaigns.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 7
    for row, part in zip(rows[9:12], (10, 50, 90), strict=True):
        expected = np.percentile(noise[kp == 14.5], part)
        assert (row["Kp"], row["percentile"]) == ("14-15", f"{part} %")
        assert (row["raw, campaign 4"], row["K2SFF, 4"]) == (f"{expected:.0f}", "30")
        assert row["raw, simulated"] == f"{2 * expected:.0f}"


def test_errors_of_percentiles():
    values = np.random.default_rng(4).standard_normal((200, 300))
    found = np.array([percentiles(v, np.random.default_rng(5)) for v in values])
    assert found[:, 1, 1].mean() == pytest.approx(found[:, 0, 1].std(), rel=0.2)


def test_two_stars(shared_data, tmp_path):
    arguments = [str(shared_data), str(tmp_path / "stars.csv"), "--stars", "2", "--corrected", "0"]
    assert main(arguments).n_computed == 2
    assert main(arguments).n_computed == 0  # goes on from what is there
    stars = Table.read(tmp_path / "stars.csv")
    assert stars.colnames == list(COLUMNS)
    assert np.floor(stars["kp"]).tolist() == [11, 12]
    assert np.all(stars["raw"] > 10)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["population", "injections", "rrlyrae"])
def test_workers(name, shared_data, repository, tmp_path):
    """Functions of a script reach the workers."""
    short = [] if name == "population" else ["--cadences", "200"]
    command = [sys.executable, repository / "studies" / f"{name}.py", shared_data, "stars.csv"]
    subprocess.run(
        [*command, "--stars", "2", "--workers", "2", *short],
        check=True, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(repository)},
    )  # fmt: skip
    assert len(Table.read(tmp_path / "stars.csv")) == (6 if name == "injections" else 2)
