"""The record of a corrector's scores: known errors come back, and two records are compared."""

import subprocess
import sys

import numpy as np
import pytest
from astropy.table import Table

from scope_models.benchmark import REGIMES, make_sky


@pytest.fixture(scope="module")
def stars():
    """Return a star beside a neighbor with other noise, and with transits."""
    regime = REGIMES["k2-1x-spots-5d-neighbor-close"]
    others = ({"noise_seed": 1}, {})
    return [make_sky(regime, 4, n_cadences=1200)] + [
        make_sky(regime.replace(depth=depth, duration=0.25), 4, n_cadences=1200, **options)
        for depth, options in zip((0.0, 0.01), others, strict=True)
    ]


def found(stars, *, dilution=1.0, leak=0.0, noise=1.0):
    """Return what a corrector with known errors finds."""
    floor = stars[0].floor()
    curves = []
    for i, sky in enumerate(stars):
        rng = np.random.default_rng([i == 1])
        flux = 1 + dilution * (sky.true_flux - 1) + leak * (sky.width - 1)
        flux = 50 * (flux + noise * floor * rng.normal(size=len(flux)))
        curves.append(
            {
                "cadenceno": sky.cadenceno.tolist(),
                "flux": flux.tolist(),
                "flux_err": np.full(len(flux), 50 * floor).tolist(),
                "seconds": 1.0 + i,
                "warnings": ["the first"],
            }
        )
    return curves


def test_truth_with_its_noise(study, stars):
    row = study["rows_of"](stars, found(stars))
    for name in ("full", "undiluted", "high_passed", "pull", "amplitude", "noise_rms"):
        assert row[name] == pytest.approx(1, abs=0.2), name
    assert row["depth_kept"] == pytest.approx(1, abs=1e-3)
    assert row["rest_change"] < 0.1
    pulls = [row[f"leak_{name}"] / row[f"leak_{name}_error"] for name in study["NUISANCES"]]
    assert np.sqrt(np.mean(np.square(pulls))) < 2
    assert (row["seconds"], row["warnings"], row["warning"]) == (2.0, 1, "the first")


def test_known_errors_come_back(study, stars):
    row = study["rows_of"](stars, found(stars, dilution=0.7, leak=0.2, noise=0.1))
    assert row["amplitude"] == pytest.approx(0.7, abs=0.006)
    assert row["depth_kept"] == pytest.approx(0.7, abs=0.002)
    alone = study["rows_of"](stars, found(stars, dilution=0.7))
    assert alone["full"] == pytest.approx(1, abs=0.2)
    assert alone["undiluted"] > 10
    # 0.2 of the flux per unit of width is 200 ppm per 0.1 %
    assert row["leak_width"] == pytest.approx(200, abs=0.5)
    assert row["leak_width"] > 10 * row["leak_width_error"]
    assert abs(row["leak_background"]) < 5 * row["leak_background_error"]


def test_an_exception_is_a_result(study, stars):
    curves = found(stars)
    curves[1] = {"error": "ValueError: nothing"}
    row = study["rows_of"](stars, curves)
    assert row["error"] == "ValueError: nothing"
    assert "full" not in row
    keys = dict.fromkeys(("apart", "scale", "neighbors"), 0) | {"share": 1.0}
    good = study["rows_of"](stars, found(stars))
    rows = [dict.fromkeys(good, np.nan) | keys | values for values in (row, good)]
    whole = study["whole"](Table(rows))
    assert whole["stars"] == 2
    assert whole["exceptions"] == 1
    assert whole["full score, median"] == good["full"]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # as -W ignore does
def test_two_stars(script, study, tmp_path, monkeypatch, capsys):
    options = "--regimes", "k2-1x-short-kp16", "--seeds", "1-2", "--method", "raw"
    command = [sys.executable, "-W", "ignore", script, tmp_path / "new.ecsv", *options]
    first = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "k2-1x-short-kp16 1 wrong" in first.stdout
    table = Table.read(tmp_path / "new.ecsv")
    assert table.meta["method"] == "raw"
    assert table["seed"].tolist() == [1, 2]
    assert table["full"].tolist() == table["raw_full"].tolist()
    command = [*command[3:], "--against", tmp_path / "new.ecsv"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in command])
    study["main"]()
    text = capsys.readouterr().out
    assert "k2-1x-short-kp16 1 wrong" not in text  # it is there already
    assert "wrong: full: ratio of medians 1.000, median of ratios 1.000" in text
