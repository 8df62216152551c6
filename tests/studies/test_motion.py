"""The motion test: its stars, and its arithmetic on made-up tables."""

import csv
import pickle
import re
import runpy
from dataclasses import asdict
from functools import partial

import _correctors
import numpy as np
import pytest
from _correctors import transit_amplitude
from _reference import reference_noise
from _stars import motion_from_name
from astropy.table import Table
from matplotlib import pyplot as plt
from motion import MotionTest, draw, main, measure, observe, summarize, tasks
from numpy.testing import assert_allclose

from scope_models._arrays import plain_tree, values_of
from scope_models.batch import run_sweep

OURS = {"lightkurve_pld": False, "lightkurve_sff": False}
METHODS = ("everest", "lightkurve")


@pytest.fixture(scope="module")
def study():
    return MotionTest(magnitudes=(12, 14), scales=(1, 5), stars=1, cadences=400)


@pytest.fixture(scope="module")
def row(study):
    """Return the measurements of a star with transits and with all correctors, of two settings."""
    settings = {
        "lightkurve_pld": (("pipeline", 1), ("pipeline", 2)),
        "lightkurve_sff": ((5,), (10,)),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_correctors, "LIGHTKURVE_CORRECTORS", settings)
        return measure(study, tasks(study)[2])


def test_the_paper_grid():
    grid = tasks(MotionTest())
    keys = [task["key"] for task in grid]
    assert len(grid) == len(set(keys)) == 12 * 5 * 5
    assert all(re.fullmatch(r"[\w.+=-]+", key) for key in keys)
    assert sorted({task["mag"] for task in grid}) == list(np.arange(10, 15.6, 0.5))
    assert sorted({task["scale"] for task in grid}) == [1, 2, 4, 5, 10]
    # The first fifth has a star of each cell.
    assert {(task["mag"], task["scale"]) for task in grid[:60]} == {
        (task["mag"], task["scale"]) for task in grid
    }


def test_a_star_is_the_same_in_another_study_and_process(study, row):
    """And without lightkurve's correctors."""
    other = MotionTest(magnitudes=(14, 13, 12), scales=(5,), stars=3, cadences=400, **OURS)
    (task,) = (task for task in tasks(other) if task["key"] == tasks(study)[2]["key"])
    ours = measure(pickle.loads(pickle.dumps(other)), task)  # noqa: S301
    assert ours == {name: row[name] for name in ours}
    assert not [name for name in ours if name.startswith("lightkurve")]
    assert {name for name in row if name not in ours} == {
        f"{name}_{end}" for name in ("lightkurve_pld", "lightkurve_sff") for end in METHODS
    } | {f"survival_lightkurve_{name}" for name in ("pld", "sff")}


def test_seeds_and_keys_change_the_star(study):
    first, second = tasks(study)[:2]
    positions = [
        observe(one, task).truth.x[0, 0] % 1
        for one, task in (
            (study, first),
            (study, second),
            (MotionTest(seed=2, cadences=400), first),
        )
    ]
    assert len({round(position, 6) for position in positions}) == 3


def test_the_calibrated_detector_is_noisier_before_and_not_after():
    options = {"magnitudes": (12,), "scales": (2,), "stars": 1, "cadences": 400}
    paper, calibrated = (
        MotionTest(detector=detector, **options, **OURS) for detector in ("paper", "calibrated")
    )
    (task,) = tasks(paper)
    rows = [measure(study, task) for study in (paper, calibrated)]
    assert rows[1]["raw_everest"] > 2 * rows[0]["raw_everest"]
    assert rows[1]["residual_everest"] < 1.0  # 0.83
    # The stamp holds the wings too.
    assert observe(calibrated, task).truth.lost_fraction.max() < 1e-4


def test_noise_and_depths_of_a_star(study, row):
    observation = observe(study, tasks(study)[2])
    # The floor follows from the errors of the pixels: white noise has a CDPP of 0.23 (lightkurve)
    # and 0.257 (EVEREST) times that of a cadence.
    from scope_models.correctors import PLDCorrector

    mask = PLDCorrector(observation.to_tpf()).aperture_mask
    error = np.sqrt((observation.flux_err[:, mask] ** 2).sum(axis=1))
    per_cadence = 1e6 * np.median(error / observation.flux[:, mask].sum(axis=1))
    assert row["pixels"] == mask.sum()
    assert_allclose(row["floor_everest"], 0.257 * per_cadence, rtol=0.12)
    assert_allclose(row["floor_lightkurve"], 0.231 * per_cadence, rtol=0.12)
    for method in METHODS:
        assert row[f"raw_{method}"] > 5 * row[f"floor_{method}"]
        assert_allclose(row[f"residual_{method}"], row[f"pld_{method}"] / row[f"floor_{method}"])
        assert 0.75 < row[f"residual_{method}"] < 1.05  # 0.85 and 0.93
    for how in ("masked", "joint"):
        assert abs(row[f"depth_{how}"] - 1000) < 3 * row[f"depth_{how}_error"]  # 0.6
        assert row[f"depth_{how}_error"] < 25  # 15
    assert 0.95 < row["survival_pld"] < 1.05


def test_transit_amplitude():
    transit = 1 - 1e-3 * (np.arange(200) % 50 < 8)
    flux = 5e4 * (1 + 0.7 * (transit - 1))
    flux[3] = np.nan
    assert_allclose(transit_amplitude(flux, transit), 0.7, rtol=1e-3)


# -- summary and figure -----------------------------------------------------------------------


def made_up(noise=20.0, **columns):
    """Return results of three stars in each of the cells of 1x and 5x motion, Kp 12 and 13."""
    rows = [
        {
            "key": f"{mag}-{scale}-{index}", "mag": mag, "scale": scale, "index": index,
            "pld_everest": noise * scale + index, "pld_lightkurve": 1.0,
            "residual_everest": 0.9,
        }
        for scale in (5.0, 2.0) for mag in (13.0, 12.0) for index in range(3)
    ]  # fmt: skip
    table = Table(rows)
    for name, values in columns.items():
        table[name] = values
    return table


def test_summary_has_medians_beside_kepler(tmp_path):
    depth = np.ma.masked_array(np.full(12, 990.0), mask=np.arange(12) >= 6)
    table = made_up(depth_masked=depth, depth_masked_error=depth / 99, survival_pld=depth / 1000)
    summary = summarize(MotionTest(), table)
    assert list(summary.iterrows("scale", "mag", "stars")) == [
        (2, 12, 3), (2, 13, 3), (5, 12, 3), (5, 13, 3)
    ]  # fmt: skip
    assert_allclose(summary["pld_everest"], [41, 41, 101, 101])
    assert_allclose(summary["pld_everest_low"], np.array([40.32, 40.32, 100.32, 100.32]))
    assert_allclose(summary["below_paper"], [200 / 41, 200 / 41, 400 / 101, 400 / 101])
    kepler = reference_noise("kepler", [12.0, 13.0])
    assert_allclose(summary["kepler_median"], np.tile(kepler, 2), atol=0.005)
    assert_allclose(summary["over_kepler"], summary["pld_everest"] / summary["kepler_median"])
    assert_allclose(summary["depth_masked"], [np.nan, np.nan, 990, 990])
    assert str(summary["pld_everest"].unit) == str(summary["kepler_p10"].unit) == "ppm"
    assert summary.meta["survival"] == {"pld": {"median": 0.99, "low": 0.99, "high": 0.99}}
    # The file keeps all of it.
    summary.write(tmp_path / "summary.ecsv")
    assert Table.read(tmp_path / "summary.ecsv").meta == summary.meta


def test_figure_shows_the_summary():
    table = made_up(
        lightkurve_sff_everest=np.linspace(30, 40, 12), residual_everest=np.linspace(0.8, 1, 12)
    )
    summary = summarize(MotionTest(), table)
    figure = draw(MotionTest(), table, summary)
    axes = [ax for ax in figure.axes if ax.get_title()]
    titles = ["PLD (scope_models)", "SFF (lightkurve)", "PLD (scope_models), residual over noise"]
    assert [ax.get_title() for ax in axes] == titles
    residual = axes.pop().containers[1].lines[0]
    assert_allclose(residual.get_ydata(), summary["residual_everest"][summary["scale"] == 5])
    for ax, name in zip(axes, ("pld", "lightkurve_sff"), strict=True):
        for container, scale in zip(ax.containers, (2, 5), strict=True):
            part = summary[summary["scale"] == scale]
            assert container.get_label() == f"{scale}x"
            assert_allclose(container.lines[0].get_xdata(), [12, 13])
            assert_allclose(container.lines[0].get_ydata(), part[f"{name}_everest"])
        kepler = next(line for line in ax.lines if line.get_label() == "Kepler, median")
        assert_allclose(kepler.get_xdata(), np.arange(11.5, 13.6, 0.5))
        assert_allclose(kepler.get_ydata(), reference_noise("kepler", kepler.get_xdata()))
        assert [note.get_text() for note in ax.texts] == ["paper, 2x", "paper, 5x"]
    plt.close(figure)


# -- lightkurve -------------------------------------------------------------------------------


def test_the_best_setting_is_the_lowest_of_each_convention(monkeypatch):
    rng = np.random.default_rng(1)
    fluxes = {order: 1e5 * (1 + order * 1e-4 * rng.normal(size=500)) for order in (1, 3)}

    def fake(name, setting, tpf, aperture):
        assert (name, tpf, aperture) == ("lightkurve_pld", "tpf", "aperture")
        return fluxes.get(setting[1])  # order 2 fails

    monkeypatch.setattr(_correctors, "correct", fake)
    lowest, setting = _correctors.best_setting("lightkurve_pld", "tpf", "aperture")
    assert setting == ("whole", 1)
    assert_allclose(lowest["everest"], 25.7, rtol=0.15)
    fluxes.clear()
    assert _correctors.best_setting("lightkurve_pld", "tpf", "aperture") == ({}, None)


def test_lightkurve_is_reproducible_and_leaves_the_global_generator_alone(study):
    tpf = observe(study, tasks(study)[0]).to_tpf()
    aperture = np.ones(tpf.shape[1:], dtype=bool)
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.get_state()[1].copy()  # noqa: NPY002
    first = _correctors.correct("lightkurve_pld", ("whole", 2), tpf, aperture)
    assert (np.random.get_state()[1] == expected).all()  # noqa: NPY002
    np.random.seed(6)  # noqa: NPY002
    second = _correctors.correct("lightkurve_pld", ("whole", 2), tpf, aperture)
    assert (first == second).all()


def test_a_lightkurve_corrector_that_fails_leaves_its_columns_out(study, monkeypatch):
    from lightkurve.correctors import PLDCorrector

    def fail(*_, **__):
        raise np.linalg.LinAlgError("singular matrix")

    monkeypatch.setattr(PLDCorrector, "correct", fail)
    monkeypatch.setitem(_correctors.LIGHTKURVE_CORRECTORS, "lightkurve_sff", ((10,),))
    row = measure(study, tasks(study)[0])
    assert not [name for name in row if "lightkurve_pld" in name]
    assert row["lightkurve_sff_everest"] > 0


def test_options_of_a_file_and_of_the_command(capsys, tmp_path):
    config = tmp_path / "far.toml"
    config.write_text("magnitudes = [13]\nscales = [5]\nstars = 1\nno-lightkurve-pld = true\n")
    options = ["--scales", "2", "--cadences", "200", "--no-lightkurve-sff", "--transit-scales"]
    main(["--directory", str(tmp_path / "out"), *options, "--config", str(config)])
    assert capsys.readouterr().out.splitlines()[0] == "motion: 1 stars, 0 failed"
    meta = Table.read(tmp_path / "out" / "summary.ecsv").meta
    assert (meta["scales"], meta["transit_scales"]) == ([2.0], [])


def test_the_cached_motion_reaches_other_processes():
    assert b"motion_from_name" in pickle.dumps(motion_from_name)


def test_the_pages_show_the_stored_study(repository, monkeypatch):
    folder = repository / "docs" / "data"
    monkeypatch.syspath_prepend(folder)
    store = runpy.run_path(str(folder / "store_motion.py"))
    summary = Table.read(folder / "motion.ecsv")
    config = plain_tree(asdict(MotionTest()))
    assert {name: summary.meta[name] for name in config} == config
    for name, rows in store["tables"](summary).items():
        with (folder / f"motion_{name}.csv").open(encoding="utf-8") as file:
            assert list(csv.reader(file)) == rows


# 18 px of a real motion are more places than 1000 cadences show.
TOO_FAR = pytest.mark.filterwarnings(
    "ignore:.*the star has too many places:scope_models.exceptions.DetrendingWarning"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "motion", ["k2_roll", pytest.param("ktwo211117077-c04_llc.fits", marks=TOO_FAR)]
)
def test_the_claims_of_the_paper_hold(motion, shared_data):
    if motion != "k2_roll":
        motion = str(shared_data / "poscorr" / motion)
    study = MotionTest(
        magnitudes=(10, 11, 12, 13, 14.5, 15, 15.5),
        scales=(2, 5, 10),
        stars=2,
        motion=motion,
        **OURS,
    )
    result = run_sweep(partial(measure, study), tasks(study), progress=False)
    assert len(result.failures) == 0
    summary = summarize(study, result.table)
    below = np.array(summary["below_paper"])
    assert np.all(below[np.isfinite(below)] > 2)
    depth, error = (values_of(result.table, f"depth_masked{end}") for end in ("", "_error"))
    found = (depth > 7.1 * error) & (np.abs(depth - 1000) < 3 * error)  # Kepler's threshold
    assert np.mean(found[result.table["scale"] == 5]) >= 0.9
    # And far more than the paper: Kepler-like everywhere, at the noise or below where no pixel is
    # full.
    assert np.all(summary["over_kepler"] < 1)
    assert np.all(summary["residual_everest"][summary["mag"] > 10.9] < 1.1)
