"""The studies beside the paper's run with two stars."""

import drop
import fitting
import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.image import imread

from scope_models import Detector, Motion, Star, simulate


def numbers_after(text, word):
    """Return the numbers that follow a word in a text."""
    parts = text.partition(word)[2].replace(",", " ").split()
    return [float(part) for part in parts if part.replace(".", "", 1).lstrip("-").isdigit()]


@pytest.mark.parametrize("n_stars", [1, 2])
def test_pulls_of_fits(n_stars):
    row = fitting.scene_pulls(n_stars, seed=1)
    assert row["converged"]
    assert row["chi2"] == pytest.approx(1, abs=0.1)
    names = [f"{name}_{star}" for star in range(n_stars) for name in ("x", "y", "flux")]
    assert list(row["cadence"]) == names
    assert len(row["star"]) == 2 * (n_stars - 1)
    pulls = np.concatenate([np.ravel([*row[part].values()]) for part in ("shared", "cadence")])
    assert np.abs(pulls).max() < 4.5


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.FitWarning")
def test_drop_within_a_pixel(tmp_path, monkeypatch, capsys):
    """Two stars on pixels that respond evenly: their drop is 0 within the errors."""
    files = {f"EPIC {number}": f"{number}.fits" for number in (1, 2)}
    for number, name in enumerate(files.values(), start=1):
        detector = Detector.k2(shape=(9, 9)).without_sensitivity()
        star = Star(12.0, 4 + 0.1 * number, 4.0)
        simulate(star, detector, Motion.k2_roll(200, seed=number), seed=number).write(
            tmp_path / name
        )
    monkeypatch.setattr(drop, "FILES", files)
    drop.report(tmp_path).savefig(tmp_path / "drop.png")
    plt.close("all")
    text = capsys.readouterr().out
    assert [line.partition(":")[0] for line in text.splitlines() if "EPIC" in line] == list(files)
    value, error = numbers_after(text, "Both K2 stars:")[:2]
    assert abs(value) < 4 * error
    assert imread(tmp_path / "drop.png").std() > 0


@pytest.mark.filterwarnings("ignore::scope_models.exceptions.FitWarning")
def test_drop_of_stars_of_one_ccd(capsys):
    """Two simulated stars of K2 give the known amplitude; together it is known better."""
    motion = Motion.k2_roll(100, seed=1)
    motion, numbers = motion[motion.quality == 0], []
    for star in range(2):
        tpf, truth = drop.simulated(star, motion)
        value, error = drop.measured(f"star {star}", tpf)[0][:2]
        assert abs(value - truth) < 4 * error
        numbers.append((value, error))
    drop.together("both", numbers)
    value, error = numbers_after(capsys.readouterr().out, "both:")[:2]
    assert 1e-6 * error < min(error for _, error in numbers)
    assert abs(1e-6 * value - truth) < 4e-6 * error
