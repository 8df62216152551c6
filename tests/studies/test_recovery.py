"""Injection and recovery of transits."""

import contextlib
import io

import numpy as np
import pytest
from _search import Found, fit_shape, flattened, isolated, search
from astropy.table import Table
from matplotlib.image import imread
from recovery import Recovery, main, measure, tasks

from scope_models import TransitModel

CADENCE = 0.0204336


@pytest.fixture(
    scope="module", params=[(5.0,), pytest.param((1.0, 5.0), marks=pytest.mark.slow)], ids=str
)
def scales(request):
    """Return the motions of a small grid."""
    return request.param


@pytest.fixture(scope="module")
def run(scales, tmp_path_factory):
    """Return the results of a small grid, and what was printed."""
    folder = str(tmp_path_factory.mktemp("recovery") / "run")
    grid = ["--magnitudes", "12", "15", "--depths", "0", "50", "1000", "--stars", "1"]
    grid += ["--cadences", "500", "--periods", "2", "4"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        result = main([*grid, "--scales", *map(str, scales), "--directory", folder])
    return result, printed.getvalue()


@pytest.fixture(scope="module")
def result(run):
    """Return the results of a small grid."""
    return run[0]


def light_curve(depth, noise=100e-6, n=1000, seed=1):
    """Return a light curve with transits in white noise, and its model."""
    time = 2144.0 + CADENCE * np.arange(n)
    planet = TransitModel.from_depth_duration(depth, 0.2, 3.3, 2145.1, exposure_time=CADENCE)
    return time, planet(time) + np.random.default_rng(seed).normal(0, noise, n), planet


class TestSearch:
    @pytest.mark.parametrize("depth", [300e-6, 2e-3])
    def test_planet_is_found(self, depth):
        time, flux, _ = light_curve(depth)
        found = search(time, flux, 0.1, 0.25)
        assert found.matches(3.3, 2145.1, 0.2, np.ptp(time))
        assert found.duration == pytest.approx(0.2, abs=0.05)
        assert found.snr > 8

    def test_ratio_grows_with_the_depth(self):
        shallow, deep = (search(*light_curve(depth)[:2], 0.1, 0.25) for depth in (5e-4, 1e-3))
        assert deep.snr == pytest.approx(2 * shallow.snr, rel=0.15)

    def test_false_alarms_in_white_noise_are_below_the_threshold(self):
        rng = np.random.default_rng(5)
        time = CADENCE * np.arange(1000)
        found = [search(time, rng.normal(1, 1e-4, 1000), 0.1, 0.25).snr for _ in range(12)]
        assert 4 < np.median(found) < 5.5
        assert max(found) < Recovery().threshold

    @pytest.mark.parametrize(
        "period, t0, expected",
        [
            (3.0, 10.0, True),
            (3.0, 10.0 - 30.0, True),
            (3.0, 10.09, True),
            (3.0, 10.11, False),
            (3.01, 10.0, True),
            (3.01, 9.94, True),
            (3.02, 10.0, False),
            (6.0, 10.0, False),
            (1.5, 10.0, False),
        ],
    )
    def test_matches(self, period, t0, expected):
        assert Found(period, t0, 0.2, 5.0).matches(3.0, 10.0, 0.2, 20.0) is expected

    def test_in_transit(self):
        found = Found(3.0, 1.0, 0.2, 5.0)
        time = np.array([-2.0, 0.85, 0.95, 1.0, 1.05, 1.15, 2.5, 4.05])
        expected = [True, False, True, True, True, False, False, True]
        assert found.in_transit(time).tolist() == expected
        assert found.in_transit(time, widths=1.0).sum() == 7

    def test_slow_trends_are_flattened_and_transits_kept(self):
        time, flux, planet = light_curve(1e-3, noise=1e-6)
        trend = 1 + 0.01 * np.sin(2 * np.pi * time / 20)
        flat = flattened(time, flux * trend, planet(time) < 1)
        inside = slice(50, -50)  # where the window of two days is whole
        np.testing.assert_allclose(flat[inside], planet(time)[inside], atol=1.5e-4)
        np.testing.assert_allclose(flat, planet(time), atol=5e-4)


def test_single_cadences_stand_out_and_transits_do_not():
    time, flux, planet = light_curve(5e-3)
    assert planet(time).min() < 1 - 40 * 100e-6
    assert not isolated(flux).any()
    flux[[0, 500, 700, 999]] += [-2e-3, 1.5e-3, -1.5e-3, 2e-3]
    assert np.flatnonzero(isolated(flux)).tolist() == [0, 500, 700, 999]


class TestShape:
    def test_depth_and_duration(self):
        time, flux, planet = light_curve(1e-3)
        found = search(time, flux, 0.1, 0.25)
        model, duration, error = fit_shape(time, flux, 100e-6, found, CADENCE)
        assert abs(duration - 0.2) < 4 * error
        assert 0.001 < error < 0.01
        assert model.depth == pytest.approx(1e-3, rel=0.1)
        assert model.period.value == pytest.approx(3.3, abs=0.005)
        np.testing.assert_allclose(model(time), planet(time), atol=1e-4)

    @pytest.mark.slow
    def test_errors_are_those_of_the_scatter(self):
        pulls = []
        for seed in range(25):
            time, flux, _ = light_curve(1e-3, seed=seed)
            found = Found(3.302, 2145.09, 0.17, 8.0)
            _, duration, error = fit_shape(time, flux, 100e-6, found, CADENCE)
            pulls.append((duration - 0.2) / error)
        assert 0.6 < np.std(pulls) < 1.5  # 25 numbers: 0.72 to 1.28 is two standard deviations
        assert abs(np.mean(pulls)) < 0.6


class TestStudy:
    def test_deep_transits_are_recovered(self, result):
        deep = result.table[result.table["depth"] == 1000.0]
        assert deep["recovered"].all()
        pulls = (deep["found_depth"] - deep["depth"]) / deep["found_depth_error"]
        assert np.abs(pulls).max() < 3.5
        assert (
            np.abs(deep["joint_depth"] - deep["depth"]).max()
            < 3.5 * deep["joint_depth_error"].max()
        )
        assert np.abs(deep["found_duration"] / deep["duration"] - 1).max() < 0.15
        assert np.abs(deep["survival"] - 1).max() < 0.12

    def test_shallow_ones_of_faint_stars_are_not(self, result, scales):
        rows = result.table[(result.table["depth"] == 50.0) & (result.table["mag"] == 15.0)]
        assert len(rows) == len(scales)
        assert not rows["recovered"].any()
        assert rows["found_depth"].mask.all()

    def test_stars_without_planet_give_no_alarm(self, result, scales):
        empty = result.table[result.table["depth"] == 0.0]
        assert not empty["detected"].any()
        assert empty["period"].mask.all()
        expected = f"0 of {2 * len(scales)} stars without planet"
        assert result.summary.meta["false_alarms"] == expected

    def test_expected_ratio_is_that_of_the_photons(self, result):
        # the search cannot beat the least noise, and comes near it
        deep = result.table[result.table["depth"] == 1000.0]
        ratio = deep["snr"] / deep["expected_snr"]
        assert np.all((ratio > 0.6) & (ratio < 1.1))
        bright = deep["white_noise"][deep["mag"] == 12.0]
        electrons = 1.74e5 * 1625.35
        assert np.all((bright > 1e6 / np.sqrt(electrons)) & (bright < 1.4e6 / np.sqrt(electrons)))

    def test_summary(self, result, scales):
        summary = result.summary
        assert len(summary) == 4 * len(scales)
        assert summary["depth"].unit == "ppm"
        rows = summary[summary["depth"] == 1000.0]
        assert rows["completeness"].tolist() == [1.0] * 2 * len(scales)
        assert np.abs(rows["depth_ratio"] - 1).max() < 0.15

    def test_motions(self, result):
        said = result.summary.meta["by_motion"]["5x"]
        rows = result.table[(result.table["scale"] == 5.0) & (result.table["depth"] > 0)]
        assert (said["planets"], said["false"]) == (4, 0)
        assert said["recovered"] == rows["recovered"].sum()
        weights = (rows["depth"] / rows["joint_depth_error"]) ** 2
        mean = np.sum(weights * rows["joint_depth"] / rows["depth"]) / np.sum(weights)
        assert said["joint_depth_ratio"] == pytest.approx(mean, abs=1e-4)
        assert abs(said["found_depth_ratio"] - 1) < 4 * said["found_depth_ratio_error"]
        assert 0.9 < said["survival"] < 1.1

    def test_files_and_what_is_printed(self, run, scales):
        result, printed = run
        assert printed.splitlines()[0] == f"recovery: {6 * len(scales)} stars, 0 failed"
        names = ["results.ecsv", "summary.ecsv", "figure.png"]
        assert [path.name for path in result.files] == names
        assert np.all(result.table["white_noise"] > 0)
        assert imread(result.files[2]).std() > 0

    def test_tables_are_read_back(self, result):
        table = Table.read(result.files[0])
        assert table["found_depth"].unit == "ppm"
        assert Table.read(result.files[1]).meta["by_motion"] == result.summary.meta["by_motion"]

    def test_stars_do_not_depend_on_the_grid(self, result):
        study = Recovery(
            magnitudes=(15.0,),
            depths=(1000.0, 50.0),
            scales=(5.0,),
            stars=1,
            cadences=500,
            periods=(2.0, 4.0),
        )
        task = tasks(study)[0]
        row = measure(study, task)
        same = result.table[result.table["key"] == task["key"]][0]
        assert row["snr"] == same["snr"]
        assert row["joint_depth"] == same["joint_depth"]


def test_periods_beyond_the_series():
    study = Recovery(periods=(19.0, 20.0))
    with pytest.raises(ValueError, match="`periods` must be at most half the time span of"):
        measure(study, tasks(study)[-1])
