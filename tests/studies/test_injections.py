"""Injections in EVEREST's terms: the measurement, and two stars."""

import csv

import injections
import numpy as np
import pytest
from astropy.table import Table
from injections import DEPTHS, DURATION, injected_stars, main, recovered, write_table

from scope_models import TransitModel


@pytest.mark.parametrize("depth", DEPTHS)
def test_depth_beside_slow_curves(depth):
    time = 2000 + np.arange(1700) * 0.0204
    planet = TransitModel.from_depth_duration(depth, DURATION, 4.3, 2001.7, exposure_time=0.02)
    curve = 7e3 * planet(time) * (1 + 0.01 * np.sin(2 * np.pi * time / 12))
    curve[::50] = np.nan
    assert recovered(time, curve, planet) == pytest.approx(depth, rel=0.02, abs=2e-6)


def test_tables_of_everest(shared_data):
    everest, stars = injected_stars(shared_data)
    assert len(everest) == 3 * 2743
    part = everest[np.isclose(everest["depth"], 1e-3)]
    assert np.median(part["unmasked"]) == pytest.approx(0.907e-3, abs=1e-6)
    assert set(stars["epic"]) <= set(everest["epic"])


def test_deep_transits_of_two_stars_survive(shared_data, tmp_path, monkeypatch):
    depths = DEPTHS[:2]
    monkeypatch.setattr(injections, "DEPTHS", depths)
    arguments = [str(shared_data), str(tmp_path / "stars.csv"), "--cadences", "150", "--stars", "2"]
    assert main(arguments).n_computed == 2
    assert main(arguments).n_computed == 0  # goes on from what is there
    rows = Table.read(tmp_path / "stars.csv")
    assert rows["depth"].tolist() == 2 * list(depths)
    deep = rows[rows["depth"] == depths[0]]
    for run in ("masked", "unmasked"):
        assert np.asarray(deep[run]) == pytest.approx(np.asarray(deep["control"]), rel=0.03)
    write_table(tmp_path / "injections", shared_data, rows)
    with (tmp_path / "injections.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 6
    assert table[3]["light curves"] == "EVEREST 2, all"
    assert table[3]["unmasked"].startswith("0.907")
    everest = injected_stars(shared_data)[0]
    part = everest[np.isclose(everest["depth"], 1e-3)]
    for run, control in (("unmasked", "control"), ("masked", "masked_control")):
        kept, error = map(float, table[3][f"{run}, paired"].split(" ± "))
        differences = (part[run] - part[control]) / 1e-3
        assert kept == pytest.approx(1 + np.median(differences), abs=1e-4)
        picks = np.random.default_rng(1).integers(len(part), size=(200, len(part)))
        assert error == pytest.approx(np.median(differences[picks], axis=1).std(), rel=0.2)
