"""The scores, and a small version of the grid of simulated stars."""

import numpy as np
import pld_grid
import pytest
from _correctors import residual_cdpp, score
from _study import cells

from scope_models.correctors import PLDCorrector
from scope_models.photometry import cdpp


@pytest.mark.parametrize("method", ["lightkurve", "everest"])
def test_residual_cdpp(method):
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 1e-4, 8000)
    truth = 1 - 0.01 * (np.arange(8000) % 100 < 8)
    assert residual_cdpp(truth * (1 + noise), truth, noise, method) == pytest.approx(1)
    more = truth * (1 + noise + rng.normal(0, 1e-4, 8000))
    assert residual_cdpp(more, truth, noise, method) == pytest.approx(2**0.5, rel=0.1)


def test_score_of_a_star(star):
    corrector = PLDCorrector(star.tpf)
    corrector.correct()
    mask = corrector.aperture_mask
    noise = star.noise[:, mask].sum(axis=1) / np.median(star.expected[:, mask].sum(axis=1))
    scores = score(corrector, np.ones(400), noise)
    # 30 windows: the scatter is known to 13 percent, and what is left of the noise to 10
    assert 0.6 < scores.held_out_mad < 1.4
    assert 0.7 < scores.held_out_rms < 1.3
    assert 0.7 < scores.held_out_pull < 1.3
    expected = cdpp(corrector.corrected_lc) / cdpp(1 + noise)
    assert scores.residual_lightkurve == pytest.approx(expected, rel=0.01)
    assert scores.floor == pytest.approx(1e6 * np.std(noise) / 13**0.5, rel=0.01)


def test_held_out_needs_windows(star):
    corrector = PLDCorrector(star.tpf)
    with pytest.raises(ValueError, match="call `correct` first"):
        corrector.held_out()
    corrector.correct(order=1)
    with pytest.raises(ValueError, match="`width` must be at most 200, got 300"):
        corrector.held_out(300)


def medians(table, name, scale):
    return np.median(table[name][table["scale"] == scale])


@pytest.mark.parametrize(
    "bounds", [{5: 1.20}, pytest.param({1: 1.05, 5: 1.20}, marks=pytest.mark.slow)], ids=str
)
def test_small_grid(shared_data, tmp_path, capsys, bounds):
    """One magnitude, some motions and both detectors reach what the whole grid must reach."""
    few = ["--data", str(shared_data / "poscorr"), "--directory", str(tmp_path), "--stars", "1"]
    few += ["--magnitudes", "12", "--series", "wasp47-c3", "--cadences", "700"]
    few += ["--scales", *map(str, bounds)]
    table = pld_grid.main(few).table
    assert len(table) == 2 * len(bounds)
    for row in table:
        # 53 windows a star
        assert row["held_out_mad"] < 1.5
        assert row["residual_lightkurve"] < 1.10
        assert row["residual_everest"] < 1.10
        for how in ("masked", "joint"):
            assert abs(row[f"{how}_1000"] - 1) < 3.5 * row[f"{how}_1000_err"]
        assert row["cdpp_lightkurve"] < row["best_lightkurve"]
    for scale, largest in bounds.items():
        assert medians(table, "held_out_mad", scale) < largest + 0.15
    assert "ours lower in 100.0 % of stars" in capsys.readouterr().out
    # a second run has nothing left to do
    assert pld_grid.main(few).n_computed == 0
    assert (tmp_path / "figure.png").exists()


@pytest.mark.slow
def test_whole_grid(shared_data, tmp_path):
    """One star per cell of the grid: what the corrector is to reach, scale by scale."""
    result = pld_grid.main(
        ["--data", str(shared_data / "poscorr"), "--directory", str(tmp_path), "--stars", "1"]
    )
    table = result.table
    for scale, largest in ((1, 1.05), (2, 1.10), (5, 1.20), (10, 1.30)):
        assert medians(table, "held_out_mad", scale) <= largest
    for _, part in cells(table, ("scale", "detector", "mag")):
        for method in ("lightkurve", "everest"):
            assert np.median(part[f"residual_{method}"]) <= 1.10
    assert np.mean(table["cdpp_lightkurve"] < table["best_lightkurve"]) >= 0.95
    bright = table[table["mag"] <= 13]
    depth = np.average(bright["masked_1000"], weights=bright["masked_1000_err"] ** -2.0)
    assert depth == pytest.approx(1, abs=0.01)
