"""Injections in EVEREST's terms: the measurement, and two stars."""

import csv

import numpy as np
import pytest
from astropy.table import Table
from injections import COLUMNS, DEPTHS, DURATION, injected_stars, recovered, simulated, write_table

from scope_models import TransitModel

pytestmark = pytest.mark.filterwarnings("ignore")  # the scripts run within quiet()


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


@pytest.mark.parametrize("number", [0, 1])
def test_deep_transits_of_a_star_survive(shared_data, tmp_path, number):
    rows = Table(rows=list(simulated(number, shared_data, 400)), names=COLUMNS)
    for name in COLUMNS[3:]:
        rows[name] = rows[name].astype(float)
    assert rows[0]["masked"] == pytest.approx(rows[0]["control"], rel=0.03)
    assert rows[0]["unmasked"] == pytest.approx(rows[0]["control"], rel=0.03)
    write_table(tmp_path / "injections", shared_data, rows)
    with (tmp_path / "injections.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 9
    assert table[3]["light curves"] == "EVEREST 2, all"
    assert table[3]["unmasked"].startswith("0.907")
