"""The tables of the noise of real stars."""

import subprocess
import sys

import numpy as np
import pytest
from _reference import PERCENTILES, read_reference, reference_noise
from astropy.table import Table
from derive_reference import TABLES, binned

# Medians and 10th percentiles that the package's documentation quotes, as published with the
# catalogs, at Kp 12, 13, 14, 15 and 15.5.
QUOTED = {
    "kepler": [(25.6, 17.2), (34.3, 26.8), (52.5, 43.1), (92.9, 76.7), (126.8, 103.3)],
    "k2_c03_raw": [(189, 56), (202, 75), (225, 122), (442, 246), (635, 380)],
    "k2_c03_everest": [(22.4, 16.9), (31.5, 25.0), (53.2, 42.2), (108, 79.8), (156, 109)],
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_have_the_quoted_values(name):
    table = read_reference(name)
    for mag, (median, p10) in zip((12, 13, 14, 15, 15.5), QUOTED[name], strict=True):
        row = table[table["mag"] == mag]
        assert row["median"][0] == pytest.approx(median, rel=0.005)
        assert row["p10"][0] == pytest.approx(p10, rel=0.01)


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_complete(name):
    for stars in ("unsaturated", "saturated", "all"):
        table = read_reference(name, stars)
        percentiles = np.array([table[column] for column in PERCENTILES])
        assert np.all(np.diff(percentiles, axis=0) > 0)
        assert np.all(np.diff(table["mag"]) == 0.5)
        assert "EVEREST project" in table.meta["source"]
        assert "MIT" in table.meta["source"]
        assert table["median"].unit == "ppm"
    assert np.all(read_reference("kepler")["n"] >= 36)
    assert read_reference(name)["mag"][-1] == 18


def test_saturated_stars_are_apart():
    everyone, some, rest = (
        read_reference("k2_c03_raw", stars) for stars in ("all", "saturated", "unsaturated")
    )
    at_11 = [table[table["mag"] == 11.0] for table in (everyone, some, rest)]
    assert at_11[0]["n"][0] == at_11[1]["n"][0] + at_11[2]["n"][0]
    assert at_11[1]["median"][0] < at_11[0]["median"][0] < at_11[2]["median"][0]


def test_bins_hold_their_lower_edge():
    mag, noise = np.repeat([11.75, 12.0, 12.25], 25), np.repeat([1.0, 2.0, 3.0], 25)
    table = binned(Table({"KP": [*mag, 13.0], "CDPP": [*noise, 4.0]}), "CDPP")
    assert table["mag"].tolist() == [12.0, 12.5]  # one star is too few
    assert table["n"].tolist() == [50, 25]
    assert table["median"].tolist() == [1.5, 3.0]


def test_noise_between_bins():
    low, high = (reference_noise("kepler", mag) for mag in (12.0, 12.5))
    assert reference_noise("kepler", 12.25) == pytest.approx(np.sqrt(low * high))
    assert reference_noise("kepler", [12.0, 12.5]) == pytest.approx([low, high])
    assert reference_noise("kepler", 12.0, "p10") < low


def test_magnitudes_beyond_the_tables():
    with pytest.raises(ValueError, match="`mag` must be within 9 and 18"):
        reference_noise("kepler", 5.0)


def test_tables_follow_from_the_catalogs(shared_data, repository, tmp_path):
    script = repository / "studies" / "paper" / "derive_reference.py"
    subprocess.run(
        [sys.executable, script, shared_data / "cdpp", "--output", tmp_path],
        check=True, capture_output=True, cwd=repository, env={"PYTHONPATH": str(repository)},
    )  # fmt: skip
    for name in TABLES:
        text = (tmp_path / f"{name}.ecsv").read_text(encoding="utf-8")
        kept = repository / "studies" / "paper" / "data" / f"{name}.ecsv"
        assert text == kept.read_text(encoding="utf-8")
        Table.read(tmp_path / f"{name}.ecsv")
