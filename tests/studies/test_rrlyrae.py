"""RR Lyrae stars: light curves, the measurement, and two stars."""

import csv

import _rows
import numpy as np
import pytest
import rrlyrae
from astropy.table import Table
from rrlyrae import LIMIT, SHAPES, main, pulsation, quality, real_stars


@pytest.mark.parametrize("kind, total", [("RRab", (0.45, 1.35)), ("RRc", (0.33, 0.6))])
def test_light_curves_have_the_shape_of_the_class(kind, total):
    phase = np.linspace(0, 1, 500, endpoint=False)
    for seed in range(20):
        curve, period = pulsation(np.random.default_rng(seed), kind)
        flux = curve(phase * period)
        assert SHAPES[kind][0][0] < period < SHAPES[kind][0][1]
        assert flux.mean() == pytest.approx(1, abs=1e-6)
        magnitudes = -2.5 * np.log10(flux)
        assert total[0] < np.ptp(magnitudes) < total[1]
        slope = np.gradient(magnitudes)
        steeper = -slope.min() / slope.max()  # the rise than the fall
        assert (steeper > 2.5) if kind == "RRab" else (1 < steeper < 2)


def test_quality_is_that_of_amplitude_and_differences():
    truth = 1000 * (1 + 0.3 * np.sin(np.arange(2000) / 7))
    noise = np.random.default_rng(1).normal(0, 6, 2000)
    flux = np.where(np.arange(2000) % 40, 1.1 * truth + 500, np.nan)
    assert quality(flux, truth)[0] == pytest.approx(1.1)
    assert quality(truth + noise, truth) == pytest.approx((1, 0.01), abs=2e-3)


def test_stars_of_the_table(shared_data):
    stars = real_stars(shared_data)
    assert len(stars) == 100
    assert np.isfinite(stars["kp"]).sum() == 64
    assert np.sum(stars["everest2"] == 1) == 66
    assert (np.sum(stars["campaign"] == 3), np.sum(stars["campaign"] == 4)) == (41, 23)


def test_motions_are_those_of_the_campaign(shared_data, monkeypatch):
    class SeenError(Exception):
        pass

    def stop(*scene, **_):
        raise SeenError(scene[2].time[0])

    monkeypatch.setattr(rrlyrae, "simulate", stop)
    campaigns = real_stars(shared_data)["campaign"]
    for number in np.flatnonzero(np.isfinite(campaigns))[:8]:
        with pytest.raises(SeenError) as found:
            rrlyrae.observe({"number": number}, data=shared_data, cadences=100)
        assert (2140 if campaigns[number] == 3 else 2225) < found.value.args[0] < 2230


def test_two_stars_are_corrected(shared_data, tmp_path, monkeypatch):
    arguments = [str(shared_data), str(tmp_path / "rows.csv"), "--cadences", "300", "--stars", "2"]
    assert main(arguments).n_computed == 2
    now = _rows.version()
    monkeypatch.setattr(_rows, "version", lambda: "another one")
    assert main(arguments).n_computed == 0  # goes on from what is there
    table = Table.read(tmp_path / "rows.csv")
    assert np.all(np.abs(table["amplitude"] - 1) < LIMIT)
    assert np.all(table["rms"] < LIMIT)
    assert np.all(table["rms"] < table["raw_rms"])
    (tmp_path / "rows.csv").unlink()  # as of a run that was interrupted
    main([*arguments, "--table", str(tmp_path / "stars")])
    stored = Table.read(tmp_path / "stars.ecsv")
    assert stored["rms"].tolist() == table["rms"].tolist()
    assert stored.meta["version"] == f"{now}, another one"  # not that of this call alone
    with (tmp_path / "stars.csv").open() as file:
        counts = {row["stars"]: row["corrected"] for row in csv.DictReader(file)}
    assert (counts["all"], counts["alone"], counts["with a neighbor"]) == ("2", "1", "1")
    with (tmp_path / "stars_judged.csv").open() as file:
        assert [row["proper by eye"] for row in csv.DictReader(file)] == ["66", "8", "4", "53"]
