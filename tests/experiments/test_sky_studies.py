"""Studies of TESS, of breathing PSFs and of K2's last campaigns."""

import csv
import re
import runpy

import numpy as np
import pytest
from astropy.table import Table
from matplotlib import pyplot as plt
from scope_models.experiments._corrected import (
    METHODS,
    SURVIVALS,
    checked_claims,
    corrected_noise,
)
from scope_models.experiments.breathing import BreathingPSF
from scope_models.experiments.last_campaigns import PARTS, LastCampaigns
from scope_models.experiments.tess import TESSNoise, tess_noise

from scope_models import Detector, Motion, Star, simulate
from scope_models.experiments import make_study, run_experiment

SMALL = {
    "tess": {"magnitudes": (9, 13), "neighbors": (0, 2), "cadences": 300, "stars": 1},
    "breathing": {"amplitudes": (0.01,), "periods": (1, 4), "cadences": 300, "stars": 1},
    "last-campaigns": {"magnitudes": (12,), "parts": ("C19 erratic", "C19 off target")},
}


def made_up(study, **columns):
    """Return results in which every noise is 1 ppm but for those that are given."""
    rows = []
    for task in study.tasks():
        values = dict.fromkeys(study.units, 1.0) | {"pixels": 9, "share": 1.0, "kept": 0.5}
        values |= dict.fromkeys(SURVIVALS, 1.0)
        values["seen"] = 0.0 if task.get("part") == "C19 off target" else 1.0
        rows.append(task | values | columns)
    return Table(rows)


def test_noise_model_of_tess():
    # The parts one by one, for T = 10 and 20 pixels in 4 h.
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
        assert row[f"scene{end}"] == pytest.approx(row[f"floor{end}"], rel=0.3)
    expected = observation.flux_err[:, observation.aperture].astype(float) ** 2
    expected = 1e6 * np.sqrt(expected.sum(axis=1).mean() / 13)
    target = observation.model()[0, observation.aperture].sum()
    assert row["floor_full"] == pytest.approx(expected / target, rel=4 / np.sqrt(2 * 23))
    assert (row["share"], row["kept"]) == (1.0, 1.0)
    for name in SURVIVALS:
        assert row[name] == pytest.approx(1, abs=0.1)


def test_claims_are_ratios_to_a_limit():
    verdicts, checked = checked_claims({"a": [0.5, 1.0], "b": 1.1, "c": [0.2, np.nan], "d": []})
    assert verdicts == {"a": "holds", "b": "does not hold", "c": "not checked", "d": "not checked"}
    assert checked == {"a": 1.0, "b": 1.1}


def test_tess_beside_the_noise_model():
    study = TESSNoise(magnitudes=(9, 13), stars=2)
    table = made_up(study)
    summary = study.summarize(table)
    assert summary["stars"].tolist() == [2] * 4
    assert summary["neighbors"].tolist() == [0, 0, 10, 10]
    np.testing.assert_allclose(summary["model"][:2], tess_noise([9, 13], [9, 9]))
    assert set(summary.meta["claims"].values()) == {"holds"}
    noisy = study.summarize(made_up(study, pld=2.0, scene=3.0))
    assert list(noisy.meta["claims"].values()).count("does not hold") == 2
    panels = [ax.get_title() for ax in study.draw(table, summary).axes]
    assert panels == ["0 neighbors", "10 neighbors"]
    plt.close("all")


def test_maps_of_breathing():
    study = BreathingPSF(stars=1)
    table = made_up(study, aperture_full=6.0, wide_full=2.5)
    summary = study.summarize(table)
    assert len(summary) == 16
    assert np.all(summary["aperture_ratio"] == 6)
    assert set(summary.meta["claims"].values()) == {"holds"}
    titles = [ax.get_title() for ax in study.draw(table, summary).axes[:4]]
    assert titles == list(METHODS.values())
    plt.close("all")
    # Only the width differs from cell to cell, in the same phase.
    tasks = BreathingPSF(cadences=200, stars=1).tasks()
    widths, noises = [], []
    for task in (tasks[0], tasks[4]):
        observation = BreathingPSF(cadences=200, stars=1).observation(task)
        widths.append(observation.truth.columns["FOCUS"] - 1)
        noises.append(observation.truth.columns["X1"])
    np.testing.assert_allclose(widths[1], 3 * widths[0], rtol=1e-9, atol=1e-15)
    assert np.array_equal(*noises)


def test_parts_of_the_last_campaigns():
    study = LastCampaigns(magnitudes=(12, 14), stars=1)
    table = made_up(study)
    summary = study.summarize(table)
    assert len(summary) == 8
    assert set(summary.meta["claims"].values()) == {"holds"}
    part = summary["mission"][(summary["part"] == "C18") & (summary["mag"] == 12)]
    assert part.tolist() == [83.8]
    assert [ax.get_title() for ax in study.draw(table, summary).axes] == list(PARTS)
    plt.close("all")
    for name, (_, first, last) in PARTS.items():
        (task,) = LastCampaigns(magnitudes=(12,), parts=(name,), stars=1).tasks()
        observation = study.observation(task)
        assert (observation.cadenceno[0], observation.cadenceno[-1]) == (first, last)


@pytest.mark.parametrize(
    ("name", "field", "value", "message"),
    [
        ("tess", "stars", 0, "`stars` must be at least 1, got 0"),
        ("tess", "cadences", 10, "`cadences` must be at least 200, got 10"),
        ("tess", "neighbors", (-1,), "`neighbors` must be at least 0, got -1"),
        ("tess", "magnitudes", (), "`magnitudes` must be one or more different numbers"),
        ("tess", "cadence", "7 s", "`cadence` must be one of"),
        ("tess", "residual", -1, "`residual` must not be negative"),
        ("breathing", "amplitudes", (1.0,), "`amplitudes` must be below 1, got 1"),
        ("breathing", "periods", (0.0,), "`periods` must be positive, got 0"),
        ("breathing", "periods", (1, 1), "`periods` must be one or more different numbers"),
        ("last-campaigns", "parts", ("C20",), "`parts` must be among C18, C19 nominal"),
        ("last-campaigns", "magnitudes", (), "`magnitudes` must be one or more different values"),
    ],
)
def test_fields_are_checked(name, field, value, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make_study(name, {field: value})


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_small_runs(name, tmp_path):
    result = run_experiment(make_study(name, SMALL[name]), tmp_path, progress=False)
    assert not len(result.failures)
    summary = result.summary
    measured = (
        summary[summary["part"] != "C19 off target"] if "part" in summary.colnames else summary
    )
    for column in ("aperture", "wide", "pld", "floor"):
        assert np.all(np.asarray(measured[column]) > 0)
    assert np.all(np.asarray(measured["aperture_full"]) > 0.9 * np.asarray(measured["floor_full"]))


@pytest.mark.slow
def test_a_real_star_of_campaign_18(shared_data, tmp_path):
    path = str(shared_data / "k2_tpf/ktwo211983544-c18_lpd-targ.fits.gz")
    study = LastCampaigns(magnitudes=(16,), parts=("C18",), stars=1, motion=path, files=(path,))
    assert set(study.input_files()) == {path}
    summary = run_experiment(study, tmp_path, progress=False).summary
    real = summary[summary["part"] == "ktwo211983544-c18_lpd-targ.fits.gz"]
    assert real["pld"][0] < real["aperture"][0]


@pytest.mark.parametrize("name", SMALL)
def test_tables_of_the_page(name, repository):
    folder = repository / "docs" / "data"
    stored = runpy.run_path(str(folder / "store_skies.py"))
    summary = Table.read(folder / f"{name}.ecsv")
    study = make_study(name)
    assert {key: summary.meta[key] for key in study.config()} == study.config()
    study.draw(None, summary)
    plt.close("all")
    for part, rows in stored["tables"](name, summary).items():
        with (folder / f"{name}_{part}.csv").open(encoding="utf-8") as file:
            assert list(csv.reader(file)) == rows
