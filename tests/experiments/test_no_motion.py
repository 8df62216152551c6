"""Benchmark 1 of the paper: stars that do not move."""

import matplotlib as mpl
import numpy as np
import pytest
from scope_models.experiments.no_motion import NoMotion, noise_parts
from scope_models.experiments.reference import reference_noise

from scope_models.experiments import STUDIES, run_sweep
from scope_models.photometry import cdpp

mpl.use("agg")


def test_study_is_known():
    assert STUDIES["no-motion"] is NoMotion


@pytest.fixture(scope="module")
def quick():
    """Return a small study with its results."""
    study = NoMotion(magnitudes=(12.0, 14.0), stars=8, cadences=400)
    return study, run_sweep(study, progress=False).table


def test_detector_noise_is_that_of_its_parts(quick):
    _, table = quick
    parts = sum(np.asarray(table[name]) ** 2 for name in ("photon", "background", "read"))
    nominal = np.sqrt(parts + NoMotion().floor ** 2)
    # White noise in EVEREST's convention is 0.927 of the nominal one, in lightkurve's 0.834.
    ratio = np.asarray(table["detector_cdpp"]) / nominal
    assert ratio.mean() == pytest.approx(0.927, abs=0.02)
    ratio = np.asarray(table["detector_cdpp_lightkurve"]) / nominal
    assert ratio.mean() == pytest.approx(0.834, abs=0.03)


def test_variability_adds_noise(quick):
    _, table = quick
    assert np.all(table["cdpp"] > 0.98 * table["detector_cdpp"])
    loud = np.asarray(table["variability"]) > 100
    assert loud.any()
    assert np.all(table["cdpp"][loud] > 1.5 * table["detector_cdpp"][loud])


def test_magnitudes_fill_the_bins(quick):
    study, table = quick
    inside = np.asarray(table["kp"]) - np.asarray(table["mag"])
    assert np.abs(inside).max() <= study.width / 2
    assert np.ptp(inside) > 0.7 * study.width
    narrow = NoMotion(width=0.0, magnitudes=(13.0,), stars=1, cadences=100)
    assert narrow.run_star(narrow.tasks()[0])["kp"] == 13.0


def test_a_star_does_not_depend_on_the_others(quick):
    study, table = quick
    task = study.tasks()[3]
    assert study.run_star(task)["cdpp"] == table["cdpp"][3]
    more = NoMotion(magnitudes=(14.0, 12.0), stars=20, cadences=400)
    same = [t for t in more.tasks() if t["key"] == task["key"]]
    assert more.run_star(same[0])["cdpp"] == table["cdpp"][3]


def test_observation_is_the_variable_star(quick):
    study, table = quick
    task = study.tasks()[0]
    observation = study.observation(task)
    flux = observation.flux[:, observation.aperture].sum(axis=1, dtype=float)
    assert cdpp(flux, method="everest") == pytest.approx(table["cdpp"][0])
    parts = noise_parts(observation, observation.aperture)
    assert parts["photon"] == pytest.approx(table["photon"][0], rel=1e-3)


def test_populations_have_the_stated_distribution():
    study = NoMotion(stars=400, magnitudes=(12.0,))
    drawn = [study._variability(task, 12.0) for task in study.tasks()]
    level = np.array([value for value, _ in drawn])
    giant = np.array([kind for _, kind in drawn])
    assert giant.mean() == pytest.approx(study.giant_fraction * np.exp(-0.14), abs=0.01)
    for members, median, scatter in ((giant, study.giant_cdpp, study.giant_scatter),
                                     (~giant, study.dwarf_cdpp, study.dwarf_scatter)):  # fmt: skip
        assert np.median(level[members]) == pytest.approx(median, rel=0.02)
        assert np.log(level[members]).std() == pytest.approx(scatter, rel=0.05)


def test_summary_compares_with_kepler(quick):
    study, table = quick
    summary = study.summarize(table)
    assert summary["mag"].tolist() == [12.0, 14.0]
    row = summary[0]
    assert row["kepler_p10"] == pytest.approx(reference_noise("kepler", 12.0, "p10"))
    mine = np.percentile(table["detector_cdpp"][np.asarray(table["mag"]) == 12.0], 10)
    assert row["detector_p10_ratio"] == pytest.approx(mine / row["kepler_p10"])
    assert set(summary.meta["claims"].values()) <= {"holds", "does not hold"}
    assert summary.meta["fitted"]["floor"] == study.floor


def test_figure(quick):
    study, table = quick
    figure = study.draw(table, study.summarize(table))
    assert [ax.get_ylabel() for ax in figure.axes] == ["6.5-h CDPP (ppm)", "Ours / Kepler"]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("stars", 0, "`stars` must be at least 1, got 0"),
        ("cadences", 10, "`cadences` must be at least 100, got 10"),
        ("magnitudes", (), "`magnitudes` must hold at least one number"),
        ("giant_fraction", 1.5, "`giant_fraction` must not be above 1, got 1.5"),
        ("dwarf_cdpp", 0.0, "`dwarf_cdpp` must be positive, got 0.0"),
        ("floor", -1.0, "`floor` must not be negative, got -1.0"),
    ],
)
def test_fields_are_checked(field, value, message):
    with pytest.raises(ValueError, match=message):
        NoMotion(**{field: value})


@pytest.mark.slow
def test_noise_is_keplers():
    study = NoMotion()  # with fewer stars the median at Kp 11.5 is loose
    summary = study.summarize(run_sweep(study, progress=False).table)
    assert set(summary.meta["claims"].values()) == {"holds"}
